"""What a broker's outage costs, and whom: a plant of many machines at full rate, Sparkplug B to a real mosquitto.

`python -m benchmarks.northbound [--machines 50] [--tags 10] [--outage 600] [--live 10] [--json]`

A task stands for the scans: each machine's readings are put once a second, the machines one after the other, as the
gateway's loop does it. It says how late it was woken while the broker is there, while it is not, and while the rows of
the outage are handed on. The readings of the outage itself are put as fast as the historian takes them. What arrives is
taken down by mosquitto's own client and decoded afterwards, by the definition of Eclipse Tahu.
"""

import asyncio
import gc
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from time import monotonic
from typing import Any

import click
import numpy as np
import structlog
from sparkplub_b_packets.core.sparkplug_b_pb2 import Payload

from benchmarks.figures import Figure, show
from drivers.supervision import Supervisor
from drivers.tag import Quality, Tag
from gateway.entry import print_json
from gateway.outside.northbound import SinkFeed
from gateway.outside.northbound.mqtt import SparkplugSink
from gateway.plant.fleet import SWITCH_SECONDS
from gateway.settings import MqttRow
from gateway.store import Historian, open_historian
from tests.rig.servers import Line, free_port, program, running, until

BEGIN = 1_700_000_000.0


class FullPlant:
    """A historian that is filled by many machines; `second` is the time that has passed."""

    def __init__(self, path: Path, machines: int, tags: int) -> None:
        self.tags = [f"t{number}" for number in range(tags)]
        self.machines = [f"m{number}" for number in range(machines)]
        self.second = 0
        self.supervisor = Supervisor()
        self.store: Historian = open_historian(path, supervisor=self.supervisor)
        for machine in self.machines:
            self.store.view(machine, [Tag(tag, "holding:0", unit="degC") for tag in self.tags])

    def now(self) -> float:
        return BEGIN + self.second

    def put(self, machine: str) -> None:
        """One scan: every reading has changed."""
        time = self.now()
        rows = [(tag, time, self.second + 0.5, int(Quality.GOOD), time - 0.01) for tag in self.tags]
        view = self.store.view(machine)
        view.put("scans", [(time, 0.01, 0)])
        view.put("samples", rows)

    async def live(self, seconds: float) -> list[float]:
        """Scan in real time; gives how late each scan was, in ms."""
        late, step, begun = [], 1.0 / len(self.machines), monotonic()
        for number in range(int(seconds / step)):
            if number % len(self.machines) == 0:
                self.second += 1
            due = begun + number * step
            await asyncio.sleep(max(due - monotonic(), 0.0))
            late.append(1000.0 * (monotonic() - due))
            self.put(self.machines[number % len(self.machines)])
        return late

    def lapse(self, seconds: int) -> None:
        """So many seconds as fast as they are stored."""
        for _ in range(seconds):
            self.second += 1
            for machine in self.machines:
                self.put(machine)
            if self.second % 100 == 0:
                self.store.flush(60.0)
        self.store.flush(60.0)


@contextmanager
def taken_down(folder: Path, port: int) -> Iterator[Path]:
    """Every message as a line of topic and hexadecimal digits."""
    path = folder / "messages.txt"
    with path.open("w", encoding="ascii") as file:
        command = [str(program("mosquitto_sub")), "-p", str(port), "-t", "spBv1.0/#", "-F", "%t %x"]
        with subprocess.Popen(command, stdout=file) as process:
            try:
                yield path
            finally:
                process.terminate()


def judged(path: Path, plant: FullPlant, outage: tuple[int, int]) -> dict[str, int]:
    """How many readings are missing, twice, out of order, or marked wrongly, of all that were put."""
    names: dict[tuple[str, int], str] = {}
    seen: defaultdict[tuple[str, str], list[tuple[int, bool]]] = defaultdict(list)
    for line in path.read_text(encoding="ascii").splitlines():
        topic, _, digits = line.partition(" ")
        kind, machine = topic.split("/")[2], topic.rpartition("/")[2]
        payload = Payload.FromString(bytes.fromhex(digits))
        for metric in payload.metrics:
            if kind == "DBIRTH":
                names[machine, metric.alias] = metric.name
            elif kind == "DDATA":
                time = metric.timestamp // 1000 - int(BEGIN)
                seen[machine, names[machine, metric.alias]].append((time, metric.is_historical))
    found: Counter[str] = Counter(missing=0, twice=0, disordered=0, wrongly_marked=0)
    for machine in plant.machines:
        for tag in plant.tags:
            rows = seen[machine, f"Measured/{tag}"]
            times = [time for time, _ in rows]
            found["missing"] += len(set(range(1, plant.second + 1)) - set(times))
            found["twice"] += len(times) - len(set(times))
            found["disordered"] += sum(later < earlier for earlier, later in pairwise(times))
            # The session begins anew somewhat after the line was mended; what came until then is history too.
            again = next((time for time, flag in rows if time > outage[1] and not flag), plant.second + 1)
            found["wrongly_marked"] += sum(flag != (outage[0] < time < again) for time, flag in rows if time > 2)
    return dict(found)


async def measured(folder: Path, machines: int, tags: int, outage: int, live: float) -> dict[str, Any]:
    """One outage from beginning to end."""
    plain = free_port()
    (folder / "mosquitto.conf").write_text(
        f"user root\nlistener {plain} 127.0.0.1\nallow_anonymous true\nmax_queued_messages 0\n", encoding="utf-8"
    )
    plant = FullPlant(folder / "h.sqlite", machines, tags)
    with running([str(program("mosquitto")), "-c", str(folder / "mosquitto.conf")], plain):
        line = Line(plain)
        row = MqttRow(name="it", host="127.0.0.1", port=line.port, tls=False, tables=("samples",))
        with taken_down(folder, plain) as messages:
            await asyncio.sleep(0.5)
            no_tags: dict[str, dict[str, Tag]] = {}
            feed = SinkFeed(
                "it",
                SparkplugSink(row, None, tags=lambda: no_tags, now=plant.now, acknowledge=lambda *_: None),
                path=plant.store.path,
                machines=lambda: plant.machines,
                view=plant.store.view,
                now=plant.now,
                tables=("samples",),
                backlog=1e9,
                supervisor=plant.supervisor,
                log=structlog.wrap_logger(None, [], structlog.make_filtering_bound_logger(50)),
            )
            await asyncio.to_thread(until, lambda: feed.connected)
            with_broker = await plant.live(live)
            begin = plant.second
            await asyncio.to_thread(plant.store.flush)
            await asyncio.to_thread(until, lambda: feed.delivered == machines * tags * plant.second)
            line.cut()
            without = await plant.live(live)
            await asyncio.to_thread(plant.lapse, outage)
            end, mended, rows = plant.second, monotonic(), feed.delivered
            line.mend()
            catching_up = await plant.live(live)
            await asyncio.to_thread(until, lambda: feed.delivered >= machines * tags * end, 600.0)
            rate = (feed.delivered - rows) / (monotonic() - mended)
            await asyncio.to_thread(plant.store.flush)
            await asyncio.to_thread(until, lambda: feed.delivered == machines * tags * plant.second, 60.0)
            feed.stop()
            feed.join()
            await asyncio.sleep(1.0)
        line.cut()
    plant.store.close()
    figures = {
        "rows": feed.delivered,
        "outage_s": end - begin,
        "rows_per_s": rate,
        **judged(messages, plant, (begin, end)),
    }
    for name, late in (("broker", with_broker), ("outage", without), ("catching_up", catching_up)):
        p50, p99 = np.percentile(late, (50, 99))
        figures |= {f"late_{name}_p50_ms": p50, f"late_{name}_p99_ms": p99, f"late_{name}_max_ms": max(late)}
    return figures


@click.command()
@click.option("--machines", default=50, show_default=True, help="How many machines.")
@click.option("--tags", default=10, show_default=True, help="Tags of each.")
@click.option("--outage", default=600, show_default=True, help="Seconds of the outage that pass as fast as they can.")
@click.option("--live", default=10.0, show_default=True, help="Real seconds of each phase.")
@click.option("--json", "as_json", is_flag=True, help="One line of JSON.")
def main(machines: int, tags: int, outage: int, live: float, as_json: bool) -> None:
    """Measure an outage of a broker at full rate."""
    if program("mosquitto") is None or program("mosquitto_sub") is None:
        raise click.ClickException("needs mosquitto and its client (apt-get install mosquitto mosquitto-clients)")
    # As `decanter run` has it (`gateway.plant.app`).
    sys.setswitchinterval(SWITCH_SECONDS)
    gc.freeze()
    with tempfile.TemporaryDirectory() as folder:
        figures = asyncio.run(measured(Path(folder), machines, tags, outage, live))
    if as_json:
        print_json(figures)
    else:
        show("a broker's outage", [Figure(name, value, "") for name, value in figures.items()])


if __name__ == "__main__":
    main()
