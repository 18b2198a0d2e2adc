"""What one machine can do to the others: a plant of machines, one of them under every fault in turn.

`python -m benchmarks.isolation [--machines N] [--seconds S] [--speed X] [--armed] [--link L] [--quick] [--json]`.
The machines are served by one software PLC, the gateway is one process with a model, a
forecast and blocks in shadow (or written, `--armed`) for each. It runs first without a fault, then as long with each
fault of the matrix in turn on one machine, each once that one is well again; the figures are the other machines', of
the whole time and fault by fault. Lateness is how long after its absolute deadline a scan's last reply was complete.
The PLC's own record judges every good value.

`--seconds 540 --speed 40 --armed`: six hours of the plant's without a fault, and six under them. Scans keep their real
rate at every speed, so that each is `speed` times as long for the model. Armings last 8 h of the plant's at most, and
are given again on the way. What has been done is said on standard error.

`--link`: each machine at a port of its own (tcp), as units behind one port (units) or on one serial line (serial), as
nodes on one CAN bus (canopen). Where they share a connection the faults are those of one unit's replies, also those
that stop or end the connection under all; of a CAN bus those of a node that leave the bus to the others.
"""

import json
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from subprocess import PIPE, Popen
from typing import Any

import click
import numpy as np

from benchmarks.canopen_rig import DEVICE as CANOPEN
from benchmarks.canopen_rig import EVENT_TIMER_S
from benchmarks.canopen_rig import FAULTS as CANOPEN_FAULTS
from benchmarks.fault_matrix import FAULTS
from benchmarks.figures import Figure, give, percentile, shares
from benchmarks.processes import family_of, growth, resident_kilobytes
from gateway.demo.can_bus import can_hub
from gateway.machine.reading import STALE_PERIODS
from gateway.outside.status import GatewayLine
from gateway.store import reading, samples, stored_rows
from sim.artefacts.model_json import model_text
from sim.lab.recordings.trace_file import write_trace
from sim.plc.program.faults import face_shows
from sim.plc.record.judge import wrong_good
from sim.plc.record.recording import read_recording
from sim.sha.trace import Array
from tests.rig.pair import CYCLE_S, MAP, ROOT, TIMEOUT_S, Gateway, Plc, end, known_model, plc_process, restless_trace

PERIODS = {"tcp": 0.1, "units": 0.2, "serial": 0.5, "canopen": 0.2}
"""The links, and the seconds between two scans of a machine over each."""
_FLOOD = {"flood of replies": {"kind": "duplicate", "copies": 40, "duration": 1.0}}
_NOT_A_UNITS = ("refuse", "half_open")
"""Of a unit behind another one's port the one is its silence, and the other nothing."""
_BUS_FAULTS = ("babbling node", "babbling node, our identifiers")
SAMPLE_SECONDS = 0.5
PROGRESS_S = 15.0
"""Seconds between two lines on how far it is."""
ARMED_MINUTES = 480.0
"""Of the plant's, the longest arming."""
AGAIN_S = 12.0
"""So long the harmed machine is waited for before the next fault; a silent unit is asked within 10 s."""
SETTLED_S = 3.0
"""How long the machines run before anything is counted."""


@dataclass(frozen=True)
class Stretch:
    """What the other machines did in some time (plant s): scans done and due, their lateness (real ms), blocks that
    were computed, or where they are armed, that the PLC took.

    `good` of `readings` were of good quality, and `wrong` of these were not what the PLC had.
    """

    done: int = 0
    due: float = 0.0
    lateness: tuple[float, ...] = ()
    blocks: int = 0
    readings: int = 0
    good: int = 0
    wrong: int = 0

    def __add__(self, other: "Stretch") -> "Stretch":
        """Both times together."""
        return Stretch(*(getattr(self, key) + getattr(other, key) for key in self.__dataclass_fields__))


@dataclass(frozen=True)
class Outcome:
    """The others without faults, under them, and under each by its name; good values judged of all machines, wrong ones
    of all, faults ordered; memory (min, MB)."""

    without: Stretch
    under: Stretch
    by_fault: Mapping[str, Stretch]
    judged: int
    wrong: int
    ordered: int
    minutes: list[float]
    memory: list[float]


def faults_over(link: str) -> Mapping[str, Mapping[str, Any]]:
    """What is ordered of the harmed machine, by name."""
    if link == "tcp":
        return FAULTS
    if link == "canopen":
        return {name: fault for name, fault in CANOPEN_FAULTS.items() if name not in _BUS_FAULTS}
    face = "serial" if link == "serial" else "tcp"
    all_of_them = {**FAULTS, **_FLOOD}
    return {
        name: fault
        for name, fault in all_of_them.items()
        if name not in _NOT_A_UNITS and face_shows(str(fault["kind"]), face)
    }


def plc_options(folder: Path, link: str, names: Sequence[str], bus: Path) -> list[object]:
    """Write the file of the software PLC's machines; gives the options with which they are served."""
    rows = []
    for number, name in enumerate(names, start=1):
        row = [f'name = "{name}"', f'record = "{name}.jsonl"']
        if link in ("units", "serial") and number > 1:
            row += [f'behind = "{names[0]}"', f"unit = {number}"]
        else:
            row += ["port = 0", *(['serial = "pty"'] if link == "serial" else [])]
        if link == "canopen":
            row += [f"canopen = {json.dumps(str(CANOPEN))}", f"node = {number}"]
        rows.append("\n".join(("[[machine]]", *row)))
    (folder / "machines.toml").write_text("\n".join(rows) + "\n", encoding="utf-8")
    can = ["--can-interface", "hub", "--can-channel", bus] if link == "canopen" else []
    return ["--plant-file", folder / "machines.toml", "--device", MAP, *can]


def device_rows(link: str, names: Sequence[str], plc: Plc, bus: Path) -> dict[str, str]:
    """Where each machine is, as its table of the plant file says it."""
    first, rows = plc.ready["machines"][names[0]], {}
    for number, name in enumerate(names, start=1):
        if link == "tcp":
            rows[name] = f"device = {{ port = {plc.ready['machines'][name]['port']} }}"
        elif link == "units":
            rows[name] = f"device = {{ port = {first['port']}, unit = {number} }}"
        elif link == "serial":
            port = first["faces"]["serial"]["path"]
            line = f'transport = "rtu"\nserial = "{port}"\nbaud = 115200\nparity = "N"\nunit = {number}'
            own = f'[[machine.device.links]]\nname = "line"\nfile = {json.dumps(str(MAP))}\ntimeout = {TIMEOUT_S:g}'
            rows[name] = f"{own}\n{line}"
        else:
            node = f'interface = "hub"\nchannel = "{bus}"\nnode = {number}\nconfigure = true'
            rows[name] = f'[[machine.device.links]]\nname = "bus"\nfile = {json.dumps(str(CANOPEN))}\n{node}'
    return rows


def plant_file(folder: Path, link: str, devices: Mapping[str, str], speed: float) -> Path:
    """The gateway's configuration for machines of which `devices` says where they are."""
    period = PERIODS[link] * speed
    common = f"file = {json.dumps(str(MAP))}\ntimeout = {TIMEOUT_S:g}" if link in ("tcp", "units") else ""
    text = f"""
[device]
{common}
heartbeat_period = {5 * CYCLE_S:g}
[scan]
period = {period:g}
on_change = false
[model]
path = "model.json"
[writeback]
mode = "shadow"
[historian]
path = "historian.sqlite"
max_interval = {period / 100:g}
[forecast]
horizons = [{30 * speed:g}]
runs = 50
period = {10 * period:g}
[log]
path = "gateway.jsonl"
"""
    text += "".join(f'[[machine]]\nname = "{name}"\n{device}\n' for name, device in devices.items())
    path = folder / "plant.toml"
    path.write_text(text, encoding="utf-8")
    return path


def well(machine: Mapping[str, Any]) -> bool:
    """True for a machine's status in which every reading is good."""
    return all(value["quality"] == "GOOD" for value in machine["values"].values())


def resident_mb(process: "Popen[str]") -> float:
    """The resident memory of a process and of all that it has begun."""
    return sum(map(resident_kilobytes, family_of(process.pid))) / 1e3


def arm(folder: Path, names: Sequence[str]) -> None:
    """Let blocks be written to these machines, for as long as an arming lasts."""
    for name in names:
        with closing(GatewayLine(folder / "historian.sock", 60.0, machine=name)) as line:
            line.ask("arm", by="the benchmark", reason="isolation", minutes=ARMED_MINUTES)


STOOD_STILL = "the computer stood still: measure again"
"""Why there is no figure."""


@dataclass(frozen=True)
class Watched:
    """One machine's records: the times of its scans and of its blocks, and of its readings, the good and the wrong ones
    among them (all plant s, sorted). `phase` is that of its deadlines, `speed` plant seconds a second."""

    scans: Array
    blocks: Array
    readings: Array
    good: Array
    wrong: Array
    period: float
    phase: float
    speed: float

    def between(self, begin: float, end_at: float) -> Stretch:
        """What it did from one moment to another."""

        def within(times: Array) -> Array:
            return times[np.searchsorted(times, begin) : np.searchsorted(times, end_at)]

        scans, period = within(self.scans), self.period
        late = np.mod(scans - self.phase + period / 10, period) - period / 10
        counts = [within(times).size for times in (self.blocks, self.readings, self.good, self.wrong)]
        lateness = tuple((1000.0 * late.clip(0.0) / self.speed).tolist())
        return Stretch(scans.size, (end_at - begin) / period, lateness, *counts)


def watched(folder: Path, name: str, link: str, quiet: tuple[float, float], *, speed: float, verdict: str) -> Watched:
    """The records of a machine; in the `quiet` time (plant s) no fault was in force. Blocks have the `verdict`."""
    period, historian = PERIODS[link] * speed, folder / "historian.sqlite"
    # So much later than its count stands still a node may send the count that it stands at.
    tolerance = STALE_PERIODS * period + (EVENT_TIMER_S * speed if link == "canopen" else 0.0)
    with reading(historian) as connection:
        scans = np.sort([row[0] for row in stored_rows(connection, "scans", ("time",), machine=name)])
        writes = stored_rows(connection, "writes", ("time", "verdict"), machine=name)
        blocks = np.sort([float(time) for time, said in writes if said == verdict])
    read = list(samples(historian, machine=name))
    good = [sample for sample in read if sample.quality.is_good]
    wrong = [one.sample for one in wrong_good(read_recording(folder / f"{name}.jsonl"), good, tolerance)]
    readings, proper, untrue = (np.sort([sample.time for sample in some]) for some in (read, good, wrong))
    # The deadlines lie a period apart from one that is not known: the earliest phase is taken for on time.
    at_rest = scans[np.searchsorted(scans, quiet[0]) : np.searchsorted(scans, quiet[1])]
    if not at_rest.size:
        raise click.ClickException(f"{name} was not scanned while no fault was in force; {STOOD_STILL}")
    phase = float(np.quantile(np.mod(at_rest - quiet[0], period), 0.02)) + quiet[0]
    return Watched(scans, blocks, readings, proper, untrue, period, phase, speed)


def measured(
    folder: Path,
    link: str,
    machines: int,
    seconds: float,
    faults: Mapping[str, Mapping[str, Any]],
    *,
    speed: float = 1.0,
    armed: bool = False,
) -> Outcome:
    """Run for `seconds` without a fault and as long with the `faults` in turn. Raises what the processes fail with."""
    names = [f"machine{number}" for number in range(1, machines + 1)]
    # Behind one port or on one line the first one's faces are all others'.
    harmed = names[-1] if link in ("units", "serial") else names[0]
    others = [name for name in names if name != harmed]
    write_trace(restless_trace(160.0), folder / "trace.csv")
    (folder / "model.json").write_text(model_text(known_model()), encoding="utf-8")
    ordered = list[tuple[str, float, float]]()
    with ExitStack() as ending:
        bus = ending.enter_context(can_hub(folder)) if link == "canopen" else folder
        plc: Plc = plc_process(
            *plc_options(folder, link, names, bus),
            *("--trace", folder / "trace.csv", "--cycle", CYCLE_S, "--loop", "--stdin", "--speed", speed),
        )
        ending.callback(end, plc.process)
        file = plant_file(folder, link, device_rows(link, names, plc, bus), speed)
        status = folder / "status.json"
        command = [sys.executable, "-m", "gateway.cli.main", "run", "--config", str(file), "--quiet"]
        process = Popen([*command, "--clock", plc.clock, "--status", str(status)], stderr=PIPE, text=True, cwd=ROOT)
        ending.callback(end, process)
        gateway = Gateway(process, status)
        gateway.wait_for(lambda now: all(one["link"]["alive"] for one in now["machines"].values()))
        time.sleep(SETTLED_S)

        def plant_time() -> float:
            return max(float(one["time"]) for one in gateway.status["machines"].values())

        begun, started, minutes, memory = plant_time(), time.monotonic(), list[float](), list[float]()

        signed, said = float("-inf"), started

        def wait(until: float) -> None:
            """Note the memory all the while, keep the machines armed, and say how far it is."""
            nonlocal signed, said
            while (left := until - time.monotonic()) > 0:
                if armed and time.monotonic() - signed > 30.0 * ARMED_MINUTES / speed:
                    arm(folder, names)
                    signed = time.monotonic()
                if time.monotonic() - said > PROGRESS_S:
                    said = time.monotonic()
                    way = f"{len(ordered)} faults so far" if ordered else "without faults"
                    click.echo(f"{said - started:.0f} s of {2 * seconds:.0f} s: {way}, {memory[-1]:.0f} MB", err=True)
                minutes.append((time.monotonic() - started) / 60.0)
                memory.append(resident_mb(process))
                time.sleep(min(SAMPLE_SECONDS, seconds / 100.0, left))

        wait(started + seconds)
        middle = plant_time()
        until, rows = time.monotonic() + seconds, list(faults.items())
        while time.monotonic() < until:
            kind, given = rows[len(ordered) % len(rows)]
            fault: dict[str, Any] = dict(given)
            begin = plant_time()
            plc.order("fault", machine=harmed, fault=fault)
            wait(min(time.monotonic() + fault.get("duration", 0.5) + 0.5, until))
            ordered.append((kind, begin, plant_time()))
            patience = min(time.monotonic() + AGAIN_S, until)
            while time.monotonic() < patience and not well(gateway.status["machines"][harmed]):
                wait(min(time.monotonic() + 0.1, until))
        over = plant_time()
        code, _ = gateway.stop()
        assert code == 0, gateway.words()
        plc.order("stop")
    click.echo("reading the records", err=True)
    verdict = "written" if armed else "shadow"
    records = {name: watched(folder, name, link, (begun, middle), speed=speed, verdict=verdict) for name in names}

    def others_between(begin: float, end_at: float) -> Stretch:
        return sum((records[name].between(begin, end_at) for name in others), Stretch())

    by_fault: dict[str, Stretch] = {}
    for kind, begin, end_at in ordered:
        by_fault[kind] = by_fault.get(kind, Stretch()) + others_between(begin, end_at)
    return Outcome(
        without=others_between(begun, middle),
        under=others_between(middle, over),
        by_fault=by_fault,
        judged=sum(one.good.size for one in records.values()),
        wrong=sum(one.wrong.size for one in records.values()),
        ordered=len(ordered),
        minutes=minutes,
        memory=memory,
    )


@click.command()
@click.option("--machines", type=click.IntRange(2, 100), default=10, show_default=True, help="Machines of the plant.")
@click.option("--seconds", type=click.FloatRange(1.0), default=120.0, show_default=True, help="Each of the two ways.")
@click.option("--link", type=click.Choice(tuple(PERIODS)), default="tcp", show_default=True, help="To the machines.")
@click.option("--speed", type=click.FloatRange(1.0, 200.0), default=1.0, show_default=True, help="Plant s a second.")
@click.option("--armed", is_flag=True, help="Blocks are written, and those that the PLC took are counted.")
@click.option("--fault", "only", multiple=True, metavar="NAME", help="This fault only; may be given again.")
@click.option("--quick", is_flag=True, help="Three machines, two seconds.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
def main(
    *,
    machines: int,
    seconds: float,
    link: str,
    speed: float,
    armed: bool,
    only: tuple[str, ...],
    quick: bool,
    as_json: bool,
) -> None:
    """Set the unharmed machines' scans with every fault on another one against theirs without."""
    if quick:
        machines, seconds = 3, 2.0
    faults = faults_over(link)
    if unknown := [name for name in only if name not in faults]:
        raise click.BadParameter(f"{unknown[0]!r} is none of {', '.join(faults)}", param_hint="--fault")
    faults = {name: fault for name, fault in faults.items() if not only or name in only}
    with tempfile.TemporaryDirectory(prefix="decanter-isolation-") as folder:
        found = measured(Path(folder), link, machines, seconds, faults, speed=speed, armed=armed)
    without, under, memory = found.without, found.under, np.array(found.memory)
    slope, error = growth(np.array(found.minutes), memory)
    tenth = max(memory.size // 10, 1)
    figures = [
        Figure(
            "scans done of the others",
            _share(under.done, under.due),
            "%",
            "without faults",
            _share(without.done, without.due),
        ),
        *shares("lateness of the others", "ms", under.lateness, "without faults", without.lateness),
        Figure(
            "good readings of the others",
            _share(under.good, under.readings),
            "%",
            "without faults",
            _share(without.good, without.readings),
        ),
        Figure("wrong values that were good, the others", under.wrong, "", "good values", under.good),
        Figure(
            "blocks of the others that the PLC took" if armed else "blocks of the others, in shadow",
            _share(under.blocks, under.due),
            "% of scans due",
            "without faults",
            _share(without.blocks, without.due),
        ),
        Figure("so many of them", under.blocks, "", "without faults", without.blocks),
        Figure("memory at the end", float(np.median(memory[-tenth:])), "MB", "at the start", float(memory[0])),
        Figure("its growth under faults", 1e3 * slope, "kB/min", "two standard errors of it", 1e3 * error),
        Figure("wrong values that were good, all machines", found.wrong, "", "good values", found.judged),
        Figure("faults on the harmed machine", found.ordered, "", "kinds", len(faults)),
    ]
    for kind, one in found.by_fault.items():
        figures += [
            Figure(
                f"{kind}: scans done",
                _share(one.done, one.due),
                "%",
                "without faults",
                _share(without.done, without.due),
            ),
            Figure(
                f"{kind}: lateness, p99",
                percentile(one.lateness or (0.0,), 99),
                "ms",
                "p50",
                percentile(one.lateness or (0.0,), 50),
            ),
            Figure(f"{kind}: good readings", _share(one.good, one.readings), "%", "wrong ones among them", one.wrong),
        ]
    hours = f", {seconds * speed / 3600:.1f} h of the plant's each way" if speed > 1.0 else ""
    give(f"one of {machines} machines ({link}) under every fault in turn{hours}", figures, as_json=as_json)


def _share(part: float, whole: float) -> float:
    """Per cent; 0 of nothing."""
    return 100.0 * part / whole if whole else 0.0


if __name__ == "__main__":
    main()
