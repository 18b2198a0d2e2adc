"""Hours with slow, hanging and hostile peers on every northbound side, beside a gateway that has none.

`python -m benchmarks.hostile_northbound [--hours H] [--speed X] [--quick] [--json]`. Two armed gateways run at the same
time, each with a machine of its own of one software PLC. One of them tells and serves nobody. The other one has as many
brokers, databases, web hooks and recipients of mail as there are habits, all of them of `benchmarks.northbound_peers`,
and its page, metrics, OPC UA server, Modbus server and control socket are called by such peers too. Both run the same
time, so that a busy machine harms both. NTP is none of these sides: the gateway asks the kernel, and no server.

Scans keep their real rate at every speed. Lateness is how long after its absolute deadline a scan's last reply was
complete. Once in some seconds a proper client, from another address, asks page, metrics and control socket.
"""

import http.client
import json
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click
import numpy as np

from benchmarks.figures import Figure, give, shares
from benchmarks.isolation import ARMED_MINUTES, SAMPLE_SECONDS, SETTLED_S, Stretch, arm, plant_file, watched
from benchmarks.northbound_peers import CLIENTS, SERVERS
from benchmarks.processes import family_of, growth, resident_kilobytes
from gateway.machine.alarms import AlarmState
from gateway.outside.status import ControlError, GatewayLine
from gateway.store import reading, stored_rows
from sim.artefacts.model_json import model_text
from sim.lab.recordings.trace_file import write_trace
from tests.rig.pair import (
    CYCLE_S,
    MAP,
    PATIENCE_S,
    ROOT,
    Gateway,
    end,
    known_model,
    plc_process,
    restless_trace,
)
from tests.rig.servers import answers, free_port, until

LINK = "tcp"
SERVED = tuple(side for side in CLIENTS if side != "control")
"""The sides that are called at a port."""
LEAST_SAMPLES = 40
"""Below this no growth can be said."""
PROPER_S = 5.0
"""Seconds between two calls of the proper client."""
PROPER_ADDRESS = "127.0.0.2"
QUIET, HARMED = "quiet", "harmed"
LIMIT = 50.0
"""degC, which the replayed temperature passes again and again: people are told of it."""


@dataclass
class Observed:
    """What the kernel says of one gateway's processes, by time (min): resident MB, threads, open files."""

    minutes: list[float] = field(default_factory=list)
    resident: list[float] = field(default_factory=list)
    threads: list[float] = field(default_factory=list)
    files: list[float] = field(default_factory=list)

    def look(self, minute: float, pid: int) -> None:
        """Take it down now."""
        with suppress(FileNotFoundError, ProcessLookupError):  # one of them has ended meanwhile
            family = family_of(pid)
            sizes = [resident_kilobytes(each) / 1e3 for each in family]
            threads = [len(list(Path(f"/proc/{each}/task").iterdir())) for each in family]
            files = [len(list(Path(f"/proc/{each}/fd").iterdir())) for each in family]
            self.minutes.append(minute)
            self.resident.append(sum(sizes))
            self.threads.append(float(sum(threads)))
            self.files.append(float(sum(files)))


@dataclass(frozen=True)
class Outcome:
    """Both gateways: scans and blocks, processes, alarms raised by name; the reasons that the harmed one logged, how
    often peers were met by their side, and of the proper client's calls those that were answered."""

    stretches: Mapping[str, Stretch]
    observed: Mapping[str, Observed]
    alarms: Mapping[str, Counter[str]]
    reasons: Counter[str]
    met: Mapping[str, int]
    asked: Counter[str]
    answered: Counter[str]


def northbound_text(ports: Mapping[str, Mapping[str, int]], own: Mapping[str, Any]) -> str:
    """The tables of a plant file for these peers, and for the sides that are served (`own`)."""
    parts = [
        f"[page]\nenabled = true\nport = {own['page']}",
        f"[serve]\nport = {own['serve']}",
        f'[notify.smtp]\nhost = "127.0.0.1"\nport = {ports["smtp"][""]}\nsecurity = "none"\nsender = "g@example.com"',
        f"[northbound.metrics]\nport = {own['metrics']}",
        f"[northbound.opcua]\nport = {own['opcua']}",
    ]
    for number, (behaviour, port) in enumerate(ports["webhook"].items()):
        parts.append(f'[[notify.to]]\nname = "hook {behaviour}"\nwebhook = "http://127.0.0.1:{port}/x"\npriority = 4')
        parts.append(f'[[notify.to]]\nname = "mail {number}"\nemail = "m{number}@example.com"\npriority = 4')
    for number, port in enumerate(ports["mqtt"].values()):
        payload = "sparkplug" if number % 2 == 0 else "json"
        parts.append(
            f'[[northbound.mqtt]]\nname = "broker-{number}"\nhost = "127.0.0.1"\nport = {port}\ntls = false\n'
            f'payload = "{payload}"\ncommands = true'
        )
    for number, port in enumerate(ports["postgres"].values()):
        parts.append(
            f'[[northbound.postgres]]\nname = "base-{number}"\nhost = "127.0.0.1"\nport = {port}\n'
            'database = "d"\nuser = "u"'
        )
    for number, port in enumerate(ports["influx"].values()):
        parts.append(f'[[northbound.influx]]\nname = "trend-{number}"\nurl = "http://127.0.0.1:{port}"\ndatabase = "d"')
    return "\n".join(parts) + "\n"


class _Proper:
    """The client that behaves."""

    def __init__(self, folder: Path, own: Mapping[str, Any]) -> None:
        self._folder, self._own = folder, own
        self.asked: Counter[str] = Counter()
        self.answered: Counter[str] = Counter()

    def ask_all(self) -> None:
        """Ask each side once."""
        for side, path in (("page", "/api/plant"), ("metrics", "/metrics")):
            self.asked[side] += 1
            line = http.client.HTTPConnection("127.0.0.1", self._own[side], 10.0, source_address=(PROPER_ADDRESS, 0))
            with suppress(OSError, http.client.HTTPException), closing(line):
                line.request("GET", path)
                self.answered[side] += line.getresponse().status == 200
        self.asked["control"] += 1
        with (
            suppress(OSError, ControlError),
            closing(GatewayLine(self._folder / "historian.sock", 10.0, machine=HARMED)) as line,
        ):
            line.ask("status")
            self.answered["control"] += 1


def measured(folder: Path, seconds: float, speed: float) -> Outcome:
    """Run both for `seconds`. Raises what the processes fail with."""
    names = (QUIET, HARMED)
    write_trace(restless_trace(160.0), folder / "trace.csv")
    rows = []
    for name in names:
        (folder / name).mkdir()
        (folder / name / "model.json").write_text(model_text(known_model()), encoding="utf-8")
        rows.append(f'[[machine]]\nname = "{name}"\nport = 0\nrecord = "{name}/{name}.jsonl"\n')
    (folder / "machines.toml").write_text("".join(rows), encoding="utf-8")
    own: dict[str, Any] = {side: free_port() for side in SERVED}
    own["control"] = str(folder / HARMED / "historian.sock")
    (folder / "sides.json").write_text(json.dumps(own), encoding="utf-8")
    observed = {name: Observed() for name in names}
    with ExitStack() as ending:
        plc = plc_process(
            *("--plant-file", folder / "machines.toml", "--device", MAP, "--trace", folder / "trace.csv"),
            *("--cycle", CYCLE_S, "--loop", "--stdin", "--speed", speed),
        )
        ending.callback(end, plc.process)
        pipe = subprocess.PIPE
        peers = subprocess.Popen(
            ["nice", sys.executable, "-m", "benchmarks.northbound_peers", str(folder / "sides.json")],
            stdin=pipe,
            stdout=pipe,
            text=True,
            cwd=ROOT,
        )
        ending.callback(end, peers)
        assert peers.stdin is not None and peers.stdout is not None
        ports = json.loads(peers.stdout.readline())
        gateways = {}
        for name in names:
            device = {name: f"device = {{ port = {plc.ready['machines'][name]['port']} }}"}
            file = plant_file(folder / name, LINK, device, 1, speed)
            with file.open("a", encoding="utf-8") as text:
                text.write(f"[alarms]\nlimit = {LIMIT:g}\n")
                text.write(northbound_text(ports, own) if name == HARMED else "")
            command = [sys.executable, "-m", "gateway.cli.main", "run", "--config", str(file), "--quiet"]
            status = folder / name / "status.json"
            # What it says fills no pipe that nobody reads.
            with (folder / name / "stderr.txt").open("w", encoding="utf-8") as said:
                process = subprocess.Popen(
                    [*command, "--clock", plc.clock, "--status", str(status)], stderr=said, text=True, cwd=ROOT
                )
            ending.callback(end, process)
            gateways[name] = Gateway(process, status)
        for name, gateway in gateways.items():
            gateway.wait_for(lambda now, name=name: now["machines"][name]["link"]["alive"])  # type: ignore[misc]
        # OPC UA's address space takes some seconds.
        until(lambda: all(answers(own[side]) for side in SERVED), PATIENCE_S)
        peers.stdin.write("go\n")
        peers.stdin.flush()
        time.sleep(SETTLED_S)

        def plant_time() -> float:
            return max(float(each.status["machines"][name]["time"]) for name, each in gateways.items())

        started, begun = time.monotonic(), plant_time()
        signed, asked_at, proper = float("-inf"), started, _Proper(folder / HARMED, own)
        while (elapsed := time.monotonic() - started) < seconds or len(observed[QUIET].minutes) < LEAST_SAMPLES:
            if time.monotonic() - signed > 30.0 * ARMED_MINUTES / speed:
                for name in names:
                    arm(folder / name, [name])
                signed = time.monotonic()
            if time.monotonic() >= asked_at:
                asked_at = time.monotonic() + PROPER_S
                proper.ask_all()
            for name, gateway in gateways.items():
                assert gateway.process.poll() is None, (folder / name / "stderr.txt").read_text(encoding="utf-8")
                observed[name].look(elapsed / 60.0, gateway.process.pid)
            time.sleep(min(SAMPLE_SECONDS, seconds / 100.0))
        over = plant_time()
        last, _ = peers.communicate(timeout=PATIENCE_S)
        met = json.loads(last)
        for name, gateway in gateways.items():
            code, _ = gateway.stop()
            assert code == 0, (folder / name / "stderr.txt").read_text(encoding="utf-8")
        plc.order("stop")
    stretches = {}
    for name in names:
        record = watched(folder / name, name, LINK, (begun, over), speed=speed, verdict="written")
        stretches[name] = record.between(begun, over)
    alarms = {name: _alarms(folder / name) for name in names}
    return Outcome(stretches, observed, alarms, _reasons(folder / HARMED), met, proper.asked, proper.answered)


def _alarms(folder: Path) -> Counter[str]:
    """How often each alarm was raised."""
    with reading(folder / "historian.sqlite") as connection:
        rows = stored_rows(connection, "alarms", ("time", "condition", "state"))
    return Counter(str(condition) for _, condition, state in rows if state == AlarmState.UNACKNOWLEDGED.value)


def _reasons(folder: Path) -> Counter[str]:
    """The warnings and errors of its log, and how often each was said."""
    found: Counter[str] = Counter()
    for path in folder.glob("gateway*.jsonl*"):
        for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
            with suppress(ValueError):
                row = json.loads(line)
                if row.get("level") in ("warning", "error"):
                    found[f"{row.get('event')}: {row.get('reason', '')}"[:200]] += 1
    return found


def _figures(found: Outcome, speed: float) -> Sequence[Figure]:
    harmed, quiet = found.stretches[HARMED], found.stretches[QUIET]
    figures = [
        Figure("scans due", harmed.due, "", "without peers", quiet.due),
        Figure("scans done", harmed.done, "", "without peers", quiet.done),
        *shares("lateness of a scan", "ms", harmed.lateness or (0.0,), "without peers", quiet.lateness or (0.0,)),
        Figure(
            "latest scan", max(harmed.lateness, default=0.0), "ms", "without peers", max(quiet.lateness, default=0.0)
        ),
        Figure("blocks that the PLC took", harmed.blocks, "", "without peers", quiet.blocks),
        Figure("wrong values that were good", harmed.wrong, "", "good values", harmed.good),
    ]
    for key, unit in (("resident", "MB"), ("threads", ""), ("files", "")):
        begin, last = (_tenth(found.observed[HARMED], key, at) for at in (0, 9))
        figures.append(Figure(f"{key} at the end", last, unit, "at the begin", begin))
        begin, last = (_tenth(found.observed[QUIET], key, at) for at in (0, 9))
        figures.append(Figure(f"{key} at the end, without peers", last, unit, "at the begin", begin))
    for name in (HARMED, QUIET):
        one = found.observed[name]
        slope, error = growth(np.array(one.minutes), np.array(one.resident))
        figures.append(
            Figure(
                f"growth of the last half, {name}", 60 * slope / speed, "MB/plant h", "two standard errors",
                60 * error / speed,
            )
        )  # fmt: skip
    figures += [Figure(f"connections, {side}", found.met.get(side, 0), "") for side in (*SERVERS, *CLIENTS)]
    figures += [
        Figure(f"proper calls answered, {side}", found.answered[side], "", "asked", found.asked[side])
        for side in found.asked
    ]
    names = sorted({*found.alarms[HARMED], *found.alarms[QUIET]})
    figures += [
        Figure(f"alarm raised: {name}", found.alarms[HARMED][name], "", "without peers", found.alarms[QUIET][name])
        for name in names
    ]
    return figures


def _tenth(one: Observed, key: str, at: int) -> float:
    return float(np.median(np.array_split(np.array(getattr(one, key)), 10)[at]))


@click.command(help=__doc__)
@click.option("--hours", type=click.FloatRange(0.01), default=6.0, show_default=True, help="Of plant time.")
@click.option("--speed", type=click.FloatRange(1.0, 200.0), default=40.0, show_default=True, help="Plant s a second.")
@click.option("--quick", is_flag=True, help="Three seconds.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
def main(hours: float, speed: float, quick: bool, as_json: bool) -> None:
    with tempfile.TemporaryDirectory(prefix="decanter-hostile-") as name:
        found = measured(Path(name), 3.0 if quick else 3600.0 * hours / speed, speed)
    for reason, count in found.reasons.most_common(40):
        click.echo(f"{count:6d} {reason}", err=True)
    give("hostile peers on every northbound side", _figures(found, speed), as_json=as_json)


if __name__ == "__main__":
    main()
