"""What one machine can do to the others: a plant of machines, one of them under every fault in turn.

`python -m benchmarks.isolation [--machines N] [--seconds S] [--link L] [--workers N] [--quick] [--json]`. The machines
are served by one software PLC, the gateway is one process (or `--workers`) with a model, a forecast and blocks in
shadow for each. It runs first without a fault, then as long with each fault of the matrix in turn on one machine; the
figures are the other machines'. Lateness is how long after its absolute deadline a scan's last reply was complete. The
PLC's own record judges every value that was good.

`--link`: each machine at a port of its own (tcp), as units behind one port (units) or on one serial line (serial), as
nodes on one CAN bus (canopen). What is shared can be taken from all by one: of these links the faults are those of a
unit or node that leave connection and bus to the others.
"""

import json
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from subprocess import PIPE, Popen
from typing import Any

import click
import numpy as np

from benchmarks.canopen_rig import DEVICE as CANOPEN
from benchmarks.canopen_rig import EVENT_TIMER_S
from benchmarks.canopen_rig import FAULTS as CANOPEN_FAULTS
from benchmarks.fault_matrix import FAULTS, TOLERANCE_S
from benchmarks.figures import Figure, give, shares
from benchmarks.processes import family_of, growth, resident_kilobytes
from gateway.demo.can_bus import can_hub
from gateway.store import reading, samples, stored_rows
from sim.artefacts.model_json import model_text
from sim.plc.record.judge import wrong_good
from sim.plc.record.recording import read_recording
from sim.traces.trace_file import write_trace
from tests.rig.pair import CYCLE_S, MAP, ROOT, TIMEOUT_S, Gateway, Plc, end, known_model, plc_process, restless_trace

PERIODS = {"tcp": 0.1, "units": 0.2, "serial": 0.5, "canopen": 0.2}
"""The links, and the seconds between two scans of a machine over each."""
_UNIT_FAULTS = (
    "silent", "late reply", "exception 4", "exception 6 (busy)", "illegal register", "frozen image",
    "words swapped in mid-run", "write ignored",
)  # fmt: skip
_BUS_FAULTS = ("babbling node", "babbling node, our identifiers")
SAMPLE_SECONDS = 0.5
SETTLED_S = 3.0
"""How long the machines run before anything is counted."""


@dataclass(frozen=True)
class Stretch:
    """What the other machines did between two moments (plant s): scans done and due, lateness (ms), blocks."""

    done: int
    due: float
    lateness: Sequence[float]
    blocks: int


@dataclass(frozen=True)
class Outcome:
    """The others without faults and under them; good values judged, wrong ones, faults ordered; memory (min, MB)."""

    without: Stretch
    under: Stretch
    judged: int
    wrong: int
    ordered: int
    minutes: list[float]
    memory: list[float]


def faults_over(link: str) -> Sequence[Mapping[str, Any]]:
    """What is ordered of the harmed machine."""
    if link == "tcp":
        return list(FAULTS.values())
    if link == "canopen":
        return [fault for name, fault in CANOPEN_FAULTS.items() if name not in _BUS_FAULTS]
    return [FAULTS[name] for name in _UNIT_FAULTS]


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


def plant_file(folder: Path, link: str, devices: Mapping[str, str], workers: int) -> Path:
    """The gateway's configuration for machines of which `devices` says where they are."""
    period = PERIODS[link]
    common = f"file = {json.dumps(str(MAP))}\ntimeout = {TIMEOUT_S:g}" if link in ("tcp", "units") else ""
    text = f"""
[plant]
workers = {workers}
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
horizons = [30]
runs = 50
period = {10 * period:g}
[log]
path = "gateway.jsonl"
"""
    text += "".join(f'[[machine]]\nname = "{name}"\n{device}\n' for name, device in devices.items())
    path = folder / "plant.toml"
    path.write_text(text, encoding="utf-8")
    return path


def resident_mb(process: "Popen[str]") -> float:
    """The resident memory of a process and of all that it has begun."""
    return sum(map(resident_kilobytes, family_of(process.pid))) / 1e3


def stretch(historian: Path, others: Sequence[str], begin: float, end_at: float, *, period: float) -> Stretch:
    """The scans and blocks of the other machines between two moments, from the records."""
    done, blocks, lateness = 0, 0, list[float]()
    with reading(historian) as connection:
        for name in others:
            times = [row[0] for row in stored_rows(connection, "scans", ("time",), begin, end_at, machine=name)]
            done += len(times)
            blocks += len(stored_rows(connection, "writes", ("time",), begin, end_at, machine=name))
            # The deadlines lie a period apart from one that is not known: the earliest phase is taken for on time.
            phases = np.mod(np.array(times) - begin, period)
            first = float(np.quantile(phases, 0.02))
            lateness += (1000.0 * np.mod(phases - first + period / 10, period) - 100.0 * period).clip(0.0).tolist()
    return Stretch(done, len(others) * (end_at - begin) / period, lateness, blocks)


def measured(folder: Path, link: str, machines: int, seconds: float, workers: int) -> Outcome:
    """Run for `seconds` without a fault and as long with every fault in turn. Raises what the processes fail with."""
    names = [f"machine{number}" for number in range(1, machines + 1)]
    # Behind one port or on one line the first one's faces are all others'.
    harmed = names[-1] if link in ("units", "serial") else names[0]
    others = [name for name in names if name != harmed]
    write_trace(restless_trace(160.0), folder / "trace.csv")
    (folder / "model.json").write_text(model_text(known_model()), encoding="utf-8")
    ordered = 0
    with ExitStack() as ending:
        bus = ending.enter_context(can_hub(folder)) if link == "canopen" else folder
        plc: Plc = plc_process(
            *plc_options(folder, link, names, bus),
            *("--trace", folder / "trace.csv", "--cycle", CYCLE_S, "--loop", "--stdin"),
        )
        ending.callback(end, plc.process)
        file = plant_file(folder, link, device_rows(link, names, plc, bus), workers)
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

        def wait(until: float) -> None:
            """Note the memory all the while."""
            while (left := until - time.monotonic()) > 0:
                minutes.append((time.monotonic() - started) / 60.0)
                memory.append(resident_mb(process))
                time.sleep(min(SAMPLE_SECONDS, seconds / 100.0, left))

        wait(started + seconds)
        middle = plant_time()
        until, faults = time.monotonic() + seconds, faults_over(link)
        while time.monotonic() < until:
            fault: dict[str, Any] = dict(faults[ordered % len(faults)])
            plc.order("fault", machine=harmed, fault=fault)
            ordered += 1
            wait(min(time.monotonic() + fault.get("duration", 0.5) + 0.5, until))
        over = plant_time()
        code, _ = gateway.stop()
        assert code == 0, gateway.words()
        plc.order("stop")
    historian = folder / "historian.sqlite"
    judged = wrong = 0
    # So much later than its count stands still a node may send the count that it stands at.
    tolerance = TOLERANCE_S + (EVENT_TIMER_S if link == "canopen" else 0.0)
    for name in names:
        good = [sample for sample in samples(historian, machine=name) if sample.quality.is_good]
        judged += len(good)
        wrong += len(wrong_good(read_recording(folder / f"{name}.jsonl"), good, tolerance))
    period = PERIODS[link]
    return Outcome(
        without=stretch(historian, others, begun, middle, period=period),
        under=stretch(historian, others, middle, over, period=period),
        judged=judged,
        wrong=wrong,
        ordered=ordered,
        minutes=minutes,
        memory=memory,
    )


@click.command()
@click.option("--machines", type=click.IntRange(2, 100), default=10, show_default=True, help="Machines of the plant.")
@click.option("--seconds", type=click.FloatRange(1.0), default=120.0, show_default=True, help="Each of the two ways.")
@click.option("--link", type=click.Choice(tuple(PERIODS)), default="tcp", show_default=True, help="To the machines.")
@click.option("--workers", type=click.IntRange(1, 16), default=1, show_default=True, help="The gateway's processes.")
@click.option("--quick", is_flag=True, help="Three machines, two seconds.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
def main(*, machines: int, seconds: float, link: str, workers: int, quick: bool, as_json: bool) -> None:
    """Set the unharmed machines' scans with every fault on another one against theirs without."""
    if quick:
        machines, seconds = 3, 2.0
    with tempfile.TemporaryDirectory(prefix="decanter-isolation-") as folder:
        found = measured(Path(folder), link, machines, seconds, workers)
    without, under, memory = found.without, found.under, np.array(found.memory)
    slope, error = growth(np.array(found.minutes), memory)
    tenth = max(memory.size // 10, 1)
    figures = [
        Figure(
            "scans done of the others",
            under.done / under.due * 100,
            "%",
            "without faults",
            without.done / without.due * 100,
        ),
        *shares("lateness of the others", "ms", under.lateness, "without faults", without.lateness),
        Figure("blocks of the others", under.blocks, "", "without faults", without.blocks),
        Figure("memory at the end", float(np.median(memory[-tenth:])), "MB", "at the start", float(memory[0])),
        Figure("its growth under faults", 1e3 * slope, "kB/min", "two standard errors of it", 1e3 * error),
        Figure("wrong values that were good, all machines", found.wrong, "", "good values", found.judged),
        Figure("faults on the harmed machine", found.ordered, "", "kinds", len(faults_over(link))),
    ]
    give(f"one of {machines} machines ({link}) under every fault in turn", figures, as_json=as_json)


if __name__ == "__main__":
    main()
