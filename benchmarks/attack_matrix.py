"""What was tried on the gateway's writes and records, on every link: what it did, and what was wrong (0 is right).

Gateway and software PLC are processes of their own; the PLC's recording, the audit log and the historian are the
judges. The fault matrices (`benchmarks.fault_matrix`, `benchmarks.canopen_rig`) have what the PLC does to the gateway.
"""

import asyncio
import json
import random
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from benchmarks.figures import Figure, give
from drivers.errors import DriverError
from gateway.console import config_dir, progress
from gateway.demo.links import LINKS
from gateway.entry import Exit
from gateway.machine.reading import plant_clock
from gateway.machine.writing import Validity
from gateway.outside.status import ControlError, connect
from gateway.plant.device import make_driver
from gateway.settings import load_config
from gateway.store.historian import open_historian
from gateway.store.read_back import reading, stored_rows
from sim.plc.record.recording import BlockRow, read_recording
from tests.rig.blocks import old_numbers, unaccounted
from tests.rig.pair import FOLLOWING, MAP, Gateway, Plc, Rig, end, make_rig, restless_trace

PERIOD = 0.1
LENGTH_S = 400.0
SHORTEST_FREEZE_S = 0.1
FULL_MB = 1.0
OLD_ROWS = 40_000
"""Rows of an hour ago that fill a historian of FULL_MB."""
SECONDS_200_DAYS = 200 * 86_400.0


@dataclass
class Stand:
    """One rig on one link, and its PLC, which runs all the time."""

    rig: Rig
    plc: Plc
    rng: random.Random
    freezes: int = 6
    longest_freeze_s: float = 10.0

    @property
    def audit(self) -> Path:
        """The audit log."""
        return self.rig.records / "audit.sqlite"

    @contextmanager
    def gateway(self, mode: str, *, later_s: float = 0.0, well: bool = True) -> Iterator[Gateway]:
        """The gateway, in this mode by its file; its clock is `later_s` ahead. Stopped as one should at the end."""
        text = self.rig.plant.read_text(encoding="utf-8")
        before = 'mode = "armed"\narmed_by = "rig"\nreason = "bench on loopback"\nminutes = 480'
        other = text.replace(before, f"mode = {json.dumps(mode)}") if mode != "armed" else text
        if other != text:
            self.rig.plant.write_text(other, encoding="utf-8")
        ready = self.plc.ready
        shifted = Plc(self.plc.process, {**ready, "epoch": ready["epoch"] + later_s})
        gateway = self.rig.start_gateway(shifted)
        try:
            if well:
                self.wait_well(gateway)
            yield gateway
            if gateway.process.poll() is None:
                gateway.stop()
        finally:
            end(gateway.process)

    def wait_well(self, gateway: Gateway, *verdicts: str) -> None:
        """Wait until it reads, and a block has come to one of these verdicts."""
        wanted = verdicts or ("written", "shadow", "not permitted")
        gateway.wait_for(lambda now: now["link"]["alive"] and now["writeback"].get("last_verdict") in wanted)

    def ask(self, command: str, **keys: object) -> dict[str, Any]:
        """A command to the running gateway. Raises ControlError."""
        line = connect(load_config(self.rig.plant).control_socket, timeout=30.0)
        assert line is not None, "the gateway has no control socket"
        try:
            return line.ask(command, **keys)
        finally:
            line.close()

    def arm(self, minutes: float = 60.0) -> None:
        """Arm by command."""
        self.ask("arm", by="Ada", reason="tried on it", minutes=minutes)

    def usable(self, since: float, until: float) -> list[BlockRow]:
        """The usable blocks that the PLC received between two monotonic moments."""
        rows = read_recording(self.rig.recording).blocks
        return [
            row
            for row in rows
            if since < row.monotonic < until and row.fields and int(row.fields["validity"]) & Validity.USABLE
        ]


Tried = Callable[[Stand], int]


def arming_refused(stand: Stand) -> int:
    """The audit log takes nothing, `arm` is refused: once it takes rows again, and after a restart, it is not armed."""
    wrong = 0
    with stand.gateway("shadow") as gateway:
        with closing(sqlite3.connect(stand.audit, isolation_level=None)) as other:
            other.execute("BEGIN IMMEDIATE")
            try:
                stand.arm()
                wrong += 1
            except ControlError:
                pass
            other.execute("ROLLBACK")
        time.sleep(1.0)
        wrong += gateway.status["writeback"]["mode"] == "armed"
    with stand.gateway("shadow") as gateway:
        return wrong + (gateway.status["writeback"]["mode"] == "armed")


def disarmed(stand: Stand) -> int:
    """Ten disarms at drawn moments: usable blocks that the PLC received after the reply."""
    spans = []
    with stand.gateway("shadow") as gateway:
        for _ in range(10):
            stand.arm()
            stand.wait_well(gateway, "written")
            time.sleep(stand.rng.uniform(0.0, 2.0 * PERIOD))
            stand.ask("disarm", by="Bea", reason="enough")
            since = time.monotonic()
            time.sleep(3.0 * PERIOD)
            spans.append((since, time.monotonic()))
    assert stand.usable(0.0, time.monotonic()), "nothing usable was ever written: that shows nothing"
    return sum(len(stand.usable(*span)) for span in spans)


def frozen(stand: Stand) -> int:
    """Freezes of 0.1 s and more at drawn moments: usable blocks with a temperature that was not there any more."""
    with stand.gateway("armed") as gateway:
        for _ in range(stand.freezes):
            stand.wait_well(gateway, "written")
            time.sleep(stand.rng.uniform(0.3, 0.3 + PERIOD))
            gateway.process.send_signal(signal.SIGSTOP)
            # Drawn by its order of magnitude: 0.1 to 1 s as often as 1 to 10 s.
            time.sleep(SHORTEST_FREEZE_S * (stand.longest_freeze_s / SHORTEST_FREEZE_S) ** stand.rng.random())
            gateway.process.send_signal(signal.SIGCONT)
        stand.wait_well(gateway, "written")
    assert stand.usable(0.0, time.monotonic()), "nothing usable was ever written: that shows nothing"
    return old_numbers(read_recording(stand.rig.recording))


def clock_set_back(stand: Stand) -> int:
    """An arming is over, the clock is set back by an hour, the gateway starts again: it is not armed."""
    with stand.gateway("shadow") as gateway:
        stand.arm(minutes=0.03)
        gateway.wait_for(lambda now: now["writeback"]["mode"] == "armed")
        gateway.wait_for(lambda now: now["writeback"]["mode"] == "shadow")
    with stand.gateway("shadow", later_s=-3600.0) as gateway:
        return int(gateway.status["writeback"]["mode"] == "armed")


def killed_and_set_back(stand: Stand) -> int:
    """The same, but the gateway is killed while it is armed: what is left of the time is left, and no more."""
    with stand.gateway("shadow") as gateway:
        stand.arm(minutes=0.1)
        gateway.wait_for(lambda now: now["writeback"]["mode"] == "armed")
        gateway.process.kill()
    time.sleep(8.0)
    with stand.gateway("shadow", later_s=-3600.0) as gateway:
        return int(gateway.status["writeback"]["mode"] == "armed")


def disarmed_while_none_runs(stand: Stand) -> int:
    """`decanter disarm` while no gateway runs holds against mode = "armed" in a file that was saved before."""
    with stand.gateway("armed"):
        pass
    code = _disarm(stand)
    with stand.gateway("armed") as gateway:
        return int(gateway.status["writeback"]["mode"] == "armed") + (code not in (0, 3, 4, 5))


def disarmed_without_socket(stand: Stand) -> int:
    """`decanter disarm` where the running gateway's control socket is gone: usable blocks after it has ended."""
    with stand.gateway("shadow") as gateway:
        stand.arm()
        stand.wait_well(gateway, "written")
        time.sleep(1.0)
        load_config(stand.rig.plant).control_socket.unlink()
        code = _disarm(stand)
        since = time.monotonic()
        time.sleep(5.0 * PERIOD)
        until = time.monotonic()
    assert stand.usable(0.0, since), "nothing usable was ever written: that shows nothing"
    return len(stand.usable(since, until)) + (code not in (0, 3, 4, 5))


def _disarm(stand: Stand) -> int:
    """The exit code of `decanter disarm` by hand."""
    command = [sys.executable, "-m", "gateway.cli.main", "disarm", "--config", str(stand.rig.plant)]
    return subprocess.run([*command, "--by", "Bea", "--reason", "enough"], capture_output=True, check=False).returncode


def sent_again(stand: Stand) -> int:
    """A usable block that was recorded is sent again once the gateway has gone: moments at which it was usable."""
    with stand.gateway("armed") as gateway:
        stand.wait_well(gateway, "written")
        time.sleep(1.0)
    block = stand.usable(0.0, time.monotonic())[-1]
    config = load_config(stand.rig.plant)
    assert config.map.writeback is not None
    words = list(zip(config.map.writeback.words, block.words, strict=True))

    async def again() -> int:
        driver = make_driver(config, plant_clock(1.0))
        await driver.open()
        wrong = 0
        try:
            for _ in range(20):
                with suppress(DriverError):
                    await driver.write(words)  # type: ignore[attr-defined]
                wrong += bool(stand.plc.order("status")["usable"])
                await asyncio.sleep(0.05)
        finally:
            await driver.close()
        return wrong

    return asyncio.run(again())


def disk_takes_nothing(stand: Stand) -> int:
    """The historian and the audit log take nothing for a while: it says so, and no block goes out without its row."""
    with stand.gateway("armed") as gateway:
        locks = [sqlite3.connect(path, isolation_level=None) for path in (stand.audit, stand.rig.historian)]
        for lock in locks:
            lock.execute("BEGIN IMMEDIATE")
        said = gateway.wait_for(lambda now: now["alarms"]["records"] != "normal")
        for lock in locks:
            lock.execute("ROLLBACK")
            lock.close()
        stand.wait_well(gateway, "written")
    return unaccounted(read_recording(stand.rig.recording), stand.audit) + (not said)


def row_refused(stand: Stand) -> int:
    """Each fifth scan and write is a row that cannot be stored: it costs that row, is counted and said, and no other.

    The table refuses them (by a trigger), as it would a value that it does not hold: a map has no such value on every
    link.
    """
    fifth = "CREATE TRIGGER no_{0} BEFORE INSERT ON {0} WHEN {1} % 5 = 0 BEGIN SELECT RAISE(ABORT, 'of no kind'); END"
    with stand.gateway("armed") as gateway:
        with closing(sqlite3.connect(stand.rig.historian, timeout=10.0)) as other:
            other.execute(fifth.format("scans", "CAST(NEW.time * 10 AS INTEGER)"))
            other.execute(fifth.format("writes", "NEW.sequence"))
        said = gateway.wait_for(lambda now: now["historian"]["refused"] > 10 and now["alarms"]["records"] != "normal")
        more = said["scan"]["count"] + 30
        gateway.wait_for(lambda now: now["scan"]["count"] > more)
        code, _ = gateway.stop()
    recording = read_recording(stand.rig.recording)
    sent = {int(row.fields["sequence"]) for row in recording.blocks if row.accepted and row.fields}
    stored = {int(str(row[1])) for row in _rows(stand.rig.historian)}
    lost = sum(sequence % 5 != 0 for sequence in sent - stored)
    return lost + unaccounted(recording, stand.audit) + (code != Exit.CHECK_FAILED)


def historian_full(stand: Stand) -> int:
    """A historian at max_mb: old measurements go, and the alarm, the writes and the newest scans have their rows."""
    text = stand.rig.plant.read_text(encoding="utf-8")
    whole = text.replace("[historian]", f"[alarms]\nlimit = 10\non_delay = 0\n[historian]\nmax_mb = {FULL_MB:g}")
    stand.rig.plant.write_text(whole, encoding="utf-8")
    config = load_config(stand.rig.plant)
    before = stand.plc.ready["epoch"] - 3600.0
    store, tag = open_historian(stand.rig.historian, max_mb=FULL_MB), config.watched_temperatures[0]
    historian = store.view(config.map.name, config.map.tags)
    for first in range(0, OLD_ROWS, 1000):
        times = [before + 0.05 * number for number in range(first, first + 1000)]
        historian.put("scans", [(moment, 0.01, 0) for moment in times])
        historian.put("samples", [(tag, moment, stand.rng.gauss(60.0, 1.0), 0, moment) for moment in times])
        assert historian.flush(30.0), historian.failure
    store.close()
    with stand.gateway("armed") as gateway:
        gateway.wait_for(lambda now: now["scan"]["count"] > 100)
        now = gateway.status["time"]
        stored = _rows(stand.rig.historian)
    recording = read_recording(stand.rig.recording)
    sent = {
        int(row.fields["sequence"]) for row in recording.blocks if row.accepted and row.fields and row.time < now - 3
    }
    with closing(sqlite3.connect(stand.rig.historian)) as connection:
        (raised,) = connection.execute("SELECT count(*) FROM alarms WHERE condition LIKE 'over limit%'").fetchone()
    with reading(stand.rig.historian) as connection:
        scans = [float(str(row[0])) for row in stored_rows(connection, "scans", ("time",))]
    wrong = len(sent - {int(str(row[1])) for row in stored}) + unaccounted(recording, stand.audit)
    too_large = stand.rig.historian.stat().st_size > FULL_MB * 1e6
    return wrong + (not raised) + (max(scans) < now - 3.0) + too_large + (min(scans) < before + 1.0)


def clock_ahead(stand: Stand) -> int:
    """The clock is 200 days ahead at a start: rows of the run before that are gone."""
    with stand.gateway("shadow") as gateway:
        gateway.wait_for(lambda now: now["scan"]["count"] > 20)
    before = _rows(stand.rig.historian)
    with stand.gateway("shadow", later_s=SECONDS_200_DAYS) as gateway:
        gateway.wait_for(lambda now: now["alarms"]["clock"] != "normal" and now["scan"]["count"] > 10)
    return int(not before <= _rows(stand.rig.historian))


def damaged(stand: Stand) -> int:
    """Historian and audit log are cut, or are garbage: it starts, watches the threshold, says so, and is not armed."""
    with stand.gateway("armed") as gateway:
        stand.wait_well(gateway, "written")
    stand.rig.historian.write_bytes(stand.rng.randbytes(5000))
    content = stand.audit.read_bytes()
    stand.audit.write_bytes(content[: len(content) // 2])
    with stand.gateway("armed") as gateway:
        status = gateway.wait_for(lambda now: now["alarms"]["records"] != "normal")
        return int(status["writeback"]["mode"] == "armed")


def taken_away(stand: Stand) -> int:
    """The audit log is removed under an armed gateway: usable blocks that the PLC received more than a second later."""
    with stand.gateway("armed") as gateway:
        stand.wait_well(gateway, "written")
        time.sleep(1.0)
        for path in stand.audit.parent.glob(f"{stand.audit.name}*"):
            path.unlink()
        since = time.monotonic() + 1.0
        said = gateway.wait_for(lambda now: now["alarms"]["records"] != "normal")
        time.sleep(3.0)
        until = time.monotonic()
    assert stand.usable(0.0, since), "nothing usable was ever written: that shows nothing"
    return len(stand.usable(since, until)) + (not said)


def _rows(historian: Path) -> set[tuple[object, ...]]:
    with closing(sqlite3.connect(f"{historian.as_uri()}?mode=ro", uri=True)) as connection:
        return set(connection.execute("SELECT time, sequence FROM writes"))


ATTACKS: Mapping[str, Tried] = {
    "an arming that is refused": arming_refused,
    "disarming": disarmed,
    "a freeze": frozen,
    "a clock set back after the end": clock_set_back,
    "a kill, then a clock set back": killed_and_set_back,
    "disarming while none runs": disarmed_while_none_runs,
    "disarming without a control socket": disarmed_without_socket,
    "a block sent again": sent_again,
    "a disk that takes nothing": disk_takes_nothing,
    "a row that cannot be stored": row_refused,
    "a full historian": historian_full,
    "a clock 200 days ahead": clock_ahead,
    "damaged records": damaged,
    "an audit log taken away": taken_away,
}


@contextmanager
def stand(link: str, *, seed: int = 0, freezes: int = 6, longest_freeze_s: float = 10.0) -> Iterator[Stand]:
    """A rig whose gateway and PLC speak over this link of the demonstration."""
    with tempfile.TemporaryDirectory(prefix="decanter-attack-") as name:
        folder, row = Path(name), LINKS[link]
        rig = make_rig(folder, restless_trace(LENGTH_S), period=PERIOD, noise=FOLLOWING)
        with row.beside(folder), rig.plc(*map(str, row.arguments(folder)), "--loop") as plc:
            device = config_dir() / "devices" / row.device if row.device else MAP
            own = {"name": link, "file": str(device), **row.settings(folder, plc.ready)}
            rows = "\n".join(f"{key} = {json.dumps(value)}" for key, value in own.items())
            before, _, after = rig.plant.read_text(encoding="utf-8").partition("[scan]")
            kept = [line for line in before.splitlines() if line.startswith("heartbeat_period")]
            head = "\n".join(["[device]", *kept, "[[device.links]]", rows])
            rig.plant.write_text(f"{head}\n[scan]{after}", encoding="utf-8")
            yield Stand(rig, plc, random.Random(seed), freezes, longest_freeze_s)


def measure(links: Sequence[str], attacks: Sequence[str], **drawn: Any) -> list[Figure]:
    """A figure for each attack on each link; what is `drawn` (seed, freezes, longest_freeze_s) is as for `stand`."""
    figures = []
    with progress("attacks") as report:
        for number, link in enumerate(links):
            for place, attack in enumerate(attacks):
                report(f"{link}: {attack}", (number + place / len(attacks)) / len(links))
                with stand(link, **drawn) as made:
                    figures.append(Figure(f"{attack}, {link}", float(ATTACKS[attack](made)), "wrong"))
    return figures


@click.command(help=__doc__)
@click.argument("attacks", nargs=-1, type=click.Choice(list(ATTACKS)), metavar="[ATTACK]...")
@click.option("--link", "links", multiple=True, type=click.Choice(list(LINKS)), help="Only this link; may be repeated.")
@click.option("--freezes", default=6, show_default=True, help="How often its process is frozen.")
@click.option("--longest", default=10.0, show_default=True, help="The longest freeze, seconds; the shortest is 0.1 s.")
@click.option("--seed", default=0, show_default=True, help="Of the moments and lengths that are drawn.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="Only over Modbus TCP.")
def main(
    attacks: Sequence[str],
    links: Sequence[str],
    freezes: int,
    longest: float,
    seed: int,
    as_json: bool,
    quick: bool,
) -> None:
    chosen = links or (["modbus"] if quick else list(LINKS))
    figures = measure(chosen, attacks or list(ATTACKS), seed=seed, freezes=freezes, longest_freeze_s=longest)
    give("attacks on writes and records", figures, as_json=as_json)


if __name__ == "__main__":
    main()
