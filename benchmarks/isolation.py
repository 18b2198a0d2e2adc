"""What one machine can do to the others: a plant of machines, one of them under every fault in turn.

`python -m benchmarks.isolation [--machines N] [--seconds S] [--quick] [--json]`. The machines are served by one
software PLC, the gateway is one process with a model, a forecast and blocks in shadow for each. It runs first without a
fault, then as long with each fault of the matrix in turn on the first machine; the figures are the other machines'.
Lateness is how long after its absolute deadline a scan's last reply was complete. The PLC's own record judges every
value that was good.
"""

import json
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from subprocess import PIPE, Popen
from typing import Any

import click
import numpy as np

from benchmarks.fault_matrix import FAULTS, TOLERANCE_S
from benchmarks.figures import Figure, give, shares
from benchmarks.processes import growth, resident_kilobytes
from gateway.store import reading, samples, stored_rows
from sim.artefacts.model_json import model_text
from sim.plc.record.judge import wrong_good
from sim.plc.record.recording import read_recording
from sim.traces.trace_file import write_trace
from tests.rig.pair import CYCLE_S, MAP, ROOT, TIMEOUT_S, Gateway, Plc, end, known_model, plc_process, restless_trace

PERIOD = 0.1
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


def plant_file(folder: Path, ports: dict[str, int]) -> Path:
    """The gateway's configuration for machines at these ports."""
    text = f"""
[device]
file = {json.dumps(str(MAP))}
timeout = {TIMEOUT_S:g}
heartbeat_period = {5 * CYCLE_S:g}
[scan]
period = {PERIOD:g}
[model]
path = "model.json"
[writeback]
mode = "shadow"
[historian]
path = "historian.sqlite"
max_interval = {PERIOD / 100:g}
[forecast]
horizons = [30]
runs = 50
period = {10 * PERIOD:g}
[log]
path = "gateway.jsonl"
"""
    text += "".join(f'[[machine]]\nname = "{name}"\ndevice = {{ port = {port} }}\n' for name, port in ports.items())
    path = folder / "plant.toml"
    path.write_text(text, encoding="utf-8")
    return path


def stretch(historian: Path, others: Sequence[str], begin: float, end_at: float) -> Stretch:
    """The scans and blocks of the other machines between two moments, from the records."""
    done, blocks, lateness = 0, 0, list[float]()
    with reading(historian) as connection:
        for name in others:
            times = [row[0] for row in stored_rows(connection, "scans", ("time",), begin, end_at, machine=name)]
            done += len(times)
            blocks += len(stored_rows(connection, "writes", ("time",), begin, end_at, machine=name))
            # The deadlines lie a period apart from one that is not known: the earliest phase is taken for on time.
            phases = np.mod(np.array(times) - begin, PERIOD)
            first = float(np.quantile(phases, 0.02))
            lateness += (1000.0 * np.mod(phases - first + PERIOD / 10, PERIOD) - 100.0 * PERIOD).clip(0.0).tolist()
    return Stretch(done, len(others) * (end_at - begin) / PERIOD, lateness, blocks)


def measured(folder: Path, machines: int, seconds: float) -> Outcome:
    """Run for `seconds` without a fault and as long with every fault in turn. Raises what the processes fail with."""
    names = [f"machine{number}" for number in range(1, machines + 1)]
    write_trace(restless_trace(160.0), folder / "trace.csv")
    (folder / "model.json").write_text(model_text(known_model()), encoding="utf-8")
    rows = "".join(f'[[machine]]\nname = "{name}"\nport = 0\nrecord = "{name}.jsonl"\n' for name in names)
    (folder / "machines.toml").write_text(rows, encoding="utf-8")
    plc: Plc = plc_process(
        *("--plant-file", folder / "machines.toml", "--device", MAP, "--trace", folder / "trace.csv"),
        *("--cycle", CYCLE_S, "--loop", "--stdin"),
    )
    try:
        ports = {name: int(plc.ready["machines"][name]["port"]) for name in names}
        file, status = plant_file(folder, ports), folder / "status.json"
        command = [sys.executable, "-m", "gateway.cli.main", "run", "--config", str(file), "--quiet"]
        process = Popen([*command, "--clock", plc.clock, "--status", str(status)], stderr=PIPE, text=True, cwd=ROOT)
        gateway = Gateway(process, status)
        try:
            gateway.wait_for(lambda now: all(one["link"]["alive"] for one in now["machines"].values()))
            time.sleep(SETTLED_S)

            def plant_time() -> float:
                return max(float(one["time"]) for one in gateway.status["machines"].values())

            begun, started, minutes, memory = plant_time(), time.monotonic(), list[float](), list[float]()

            def wait(until: float) -> None:
                """Note the memory all the while."""
                while (left := until - time.monotonic()) > 0:
                    minutes.append((time.monotonic() - started) / 60.0)
                    memory.append(resident_kilobytes(process.pid) / 1e3)
                    time.sleep(min(SAMPLE_SECONDS, seconds / 100.0, left))

            wait(started + seconds)
            middle = plant_time()
            ordered, until, faults = 0, time.monotonic() + seconds, list(FAULTS.values())
            while time.monotonic() < until:
                fault: dict[str, Any] = dict(faults[ordered % len(faults)])
                plc.order("fault", machine=names[0], fault=fault)
                ordered += 1
                wait(min(time.monotonic() + fault.get("duration", 0.5) + 0.5, until))
            over = plant_time()
            code, _ = gateway.stop()
            assert code == 0, gateway.words()
        finally:
            end(process)
        plc.order("stop")
    finally:
        end(plc.process)
    historian = folder / "historian.sqlite"
    judged = wrong = 0
    for name in names:
        good = [sample for sample in samples(historian, machine=name) if sample.quality.is_good]
        judged += len(good)
        wrong += len(wrong_good(read_recording(folder / f"{name}.jsonl"), good, TOLERANCE_S))
    return Outcome(
        without=stretch(historian, names[1:], begun, middle),
        under=stretch(historian, names[1:], middle, over),
        judged=judged,
        wrong=wrong,
        ordered=ordered,
        minutes=minutes,
        memory=memory,
    )


@click.command()
@click.option("--machines", type=click.IntRange(2, 100), default=10, show_default=True, help="Machines of the plant.")
@click.option("--seconds", type=click.FloatRange(1.0), default=120.0, show_default=True, help="Each of the two ways.")
@click.option("--quick", is_flag=True, help="Three machines, two seconds.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
def main(*, machines: int, seconds: float, quick: bool, as_json: bool) -> None:
    """Set the unharmed machines' scans with every fault on another one against theirs without."""
    if quick:
        machines, seconds = 3, 2.0
    with tempfile.TemporaryDirectory(prefix="decanter-isolation-") as folder:
        found = measured(Path(folder), machines, seconds)
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
        Figure("faults on the first machine", found.ordered, "", "kinds", len(FAULTS)),
    ]
    give(f"one of {machines} machines under every fault in turn", figures, as_json=as_json)


if __name__ == "__main__":
    main()
