"""What the gateway costs: CPU seconds of its process per 1000 scans, largest resident size, time to its first block.

The gateway runs as `decanter run` starts it (19 registers read, 24 written and read back, model, historian, log,
alarms, a forecast of 500 runs every ten scans), armed, every 0.1 s in real time against the software PLC, whose trace
goes on. CPU time is that of the whole process with all its threads, by the kernel's own account (/proc/PID/stat, in
steps of 10 ms), from the first usable block on; scans are counted by the PLC's recording. Peak size is VmHWM of
/proc/PID/status. A tenth of a forecast is in each scan's cost; benchmarks/belief.py has the forecast alone.

The floor, a process of its own in the same run: pymodbus's asynchronous client, which reads 20 registers and writes 24
at the same period and does nothing else (benchmarks/bare.py). The gateway's third round trip, reading the block back,
is not in it.

With `--machines 1,2,5` it is as many machines of one gateway, one run after the other, each with a forecast every
FORECAST_S: processor time and memory by their number, and how they grow (the slope of their logarithms by least
squares). One software PLC serves them all; what it takes of a core is said, since it must not be what is measured.

With `--neighbours 0,1,2` it is a gateway of `--machines` (20) beside so many processes that never rest, one run after
the other: the blocks that did not come, and the age at which a block was followed by the next, by the recordings of the
PLC, which the neighbours slow as well. What is lost there shows by the bare client, which reads and writes one of the
machines beside the gateway, and is held against the same period.

With `--beside FOLDER` it is two gateways at the same time, this checkout's and that one's, each with a software PLC of
its own, of one machine or of `--machines` each: what else the machine has to do slows both alike.

With `--imports` it is where the memory of one gateway goes, by what is imported (benchmarks/import_memory.py).

For orientation only: the ThingsBoard gateway 3.8.5 took 69 % of a core and 72 MB for 50 devices with 10 tags each, read
every 100 ms, one request a tag, 485 of 500 polls/s. That is another setting (50 devices, no model, nothing written
back, no history, another day), so nothing here is a comparison with it.
"""

import json
import subprocess
import sys
import tempfile
import time
from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from benchmarks.figures import Figure, give, shares
from benchmarks.latency import scans_in
from benchmarks.processes import (
    MAP,
    ROOT,
    BenchmarkError,
    Plc,
    cpu_seconds,
    gateway,
    learned_model,
    peak_megabytes,
    recording_of,
    software_plc,
    until_usable,
)
from sim.plc.program.registers import read_map
from sim.plc.record.recording import PlcRecording, read_recording

FORECAST_S = 10.0
"""Seconds between two forecasts of a machine, where machines are counted."""
CROWD = 20
"""Machines of the gateway that has busy neighbours."""
LEAST_MB = 0.5
"""Libraries that take less are counted together."""


@contextmanager
def bare_client(port: int, period: float) -> Iterator["subprocess.Popen[bytes]"]:
    """The floor's process; it ends with its standard input."""
    command = [sys.executable, "-m", "benchmarks.bare", str(port), str(period)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, cwd=ROOT) as process:
        try:
            yield process
        finally:
            if process.stdin is not None:
                process.stdin.close()
            process.wait(10.0)


def measure(
    seconds: float, period: float, model_folder: Path | None = None, forecast: float | None = None
) -> list[Figure]:
    """Run gateway and floor side by side. Raises BenchmarkError when the gateway does not get to work."""
    with tempfile.TemporaryDirectory(prefix="decanter-footprint-") as name:
        folder = Path(name)
        model = learned_model(model_folder or folder)
        with software_plc(folder) as plc, bare_client(plc.port, period) as bare:
            begun = time.monotonic()
            with gateway(folder, plc, model, period, forecast=forecast) as process:
                until_usable(plc, process)
                if plc.order("status")["connections"] != 2:
                    raise BenchmarkError("the bare client is not connected")
                since, before = time.monotonic(), [cpu_seconds(one.pid) for one in (process, bare)]
                time.sleep(seconds)
                until, after = time.monotonic(), [cpu_seconds(one.pid) for one in (process, bare)]
                peaks = [peak_megabytes(one.pid) for one in (process, bare)]
        recording = read_recording(plc.recording)
    moments = [scan.read.monotonic for scan in scans_in(recording, read_map(MAP))]
    scans = bisect_left(moments, until) - bisect_left(moments, since)
    polls = len(_bare_polls(recording, since, until))
    cost, floor = (now - then for now, then in zip(after, before, strict=True))
    elapsed = until - since
    other = "bare pymodbus client, same period"
    return [
        Figure("CPU of the gateway per 1000 scans", 1e3 * cost / scans, "s", other, 1e3 * floor / polls),
        Figure("CPU of the gateway, share of a core", 100.0 * cost / elapsed, "%", other, 100.0 * floor / elapsed),
        Figure("peak resident size of the gateway", peaks[0], "MB", other, peaks[1]),
        Figure("scans with an accepted block", float(scans), "", f"due in {elapsed:.0f} s", elapsed / period),
        Figure("process start to first block", recording.blocks[0].monotonic - begun, "s"),
        Figure("ThingsBoard 3.8.5: 50 devices, no model", 69.0, "%", "another setting and day, no comparison"),
        Figure("ThingsBoard 3.8.5: 50 devices, no model", 72.0, "MB", "another setting and day, no comparison"),
    ]


def _bare_polls(recording: PlcRecording, since: float, until: float) -> list[float]:
    """When the writes of the floor, which alone writes outside the block, arrived in between (monotonic s)."""
    gateways = {block.peer for block in recording.blocks}
    return [
        row.monotonic
        for row in recording.requests
        if row.function == 16 and row.peer not in gateways and since <= row.monotonic < until
    ]


def growth(machines: Sequence[int], seconds: float, period: float, model_folder: Path | None) -> list[Figure]:
    """One gateway with so many machines, one number after the other.

    Raises BenchmarkError when one does not get to work.
    """
    figures, of_core, sizes = [], [], []
    for count in machines:
        with tempfile.TemporaryDirectory(prefix="decanter-footprint-") as name:
            folder = Path(name)
            model = learned_model(model_folder or folder)
            names = [f"machine{number}" for number in range(1, count + 1)]
            with (
                software_plc(folder, machines=names) as plc,
                gateway(folder, plc, model, period, forecast=FORECAST_S) as process,
            ):
                until_usable(plc, process)
                measured = (process, plc.process)
                accepted, since = _accepted(plc), time.monotonic()
                before = [cpu_seconds(one.pid) for one in measured]
                time.sleep(seconds)
                after = [cpu_seconds(one.pid) for one in measured]
                blocks, elapsed = _accepted(plc) - accepted, time.monotonic() - since
                sizes.append(peak_megabytes(process.pid))
        own, served = (now - then for now, then in zip(after, before, strict=True))
        of_core.append(100.0 * own / elapsed)
        plural = f"{count} machine{'s' if count > 1 else ''}"
        figures += [
            Figure(f"{plural}: share of a core", of_core[-1], "%", "the software PLC", 100.0 * served / elapsed),
            Figure(f"{plural}: CPU per 1000 scans", 1e3 * own / max(blocks, 1), "s"),
            Figure(f"{plural}: blocks accepted", blocks, "", "due", count * elapsed / period),
            Figure(f"{plural}: peak resident size", sizes[-1], "MB"),
        ]
    if len(set(machines)) > 1:
        for what, values in (("processor time", of_core), ("memory", sizes)):
            exponent = float(np.polyfit(np.log(machines), np.log(values), 1)[0])
            figures.append(Figure(f"{what} grows by the number of machines to the power of", exponent, ""))
    return figures


@contextmanager
def busy_neighbours(count: int) -> Iterator[None]:
    """So many processes that compute without end, at the priority that the gateway has here."""
    with ExitStack() as opened:
        for _ in range(count):
            process = opened.enter_context(subprocess.Popen([sys.executable, "-c", "while True: pass"]))
            opened.callback(process.kill)
        yield


def crowded(
    neighbours: Sequence[int], machines: int, seconds: float, period: float, model_folder: Path | None
) -> list[Figure]:
    """One gateway of `machines` beside busy processes, one number of them after the other.

    Raises BenchmarkError when it does not get to work.
    """
    figures, names = [], [f"machine{number}" for number in range(1, machines + 1)]
    for count in neighbours:
        with tempfile.TemporaryDirectory(prefix="decanter-footprint-") as name:
            folder = Path(name)
            model = learned_model(model_folder or folder)
            with (
                software_plc(folder, machines=names, recorded=True) as plc,
                gateway(folder, plc, model, period, forecast=FORECAST_S) as process,
                bare_client(int(plc.ready["machines"][names[0]]["port"]), period),
            ):
                until_usable(plc, process)
                with busy_neighbours(count):
                    since = time.monotonic()
                    time.sleep(seconds)
                    until = time.monotonic()
            recordings = [read_recording(recording_of(folder, one)) for one in names]
        accepted = [
            np.array([row.monotonic for row in one.blocks if row.accepted and since <= row.monotonic < until])
            for one in recordings
        ]
        polls = np.array(_bare_polls(recordings[0], since, until))
        blocks, due = sum(one.size for one in accepted), (until - since) / period
        ages = np.concatenate([_ages(one, since, until) for one in accepted]) / period
        alone = _ages(polls, since, until) / period
        other = "the bare client's writes"
        missed = [100.0 * (1.0 - share) for share in (blocks / (machines * due), polls.size / due)]
        figures += [
            Figure(f"{count} busy neighbours: blocks that did not come", missed[0], "% of due", other, missed[1]),
            *shares("  age of a block when followed", "scans", ages.tolist(), other, alone.tolist()),
            Figure("  longest", float(np.max(ages)), "scans", other, float(np.max(alone))),
        ]
    return figures


def _ages(moments: NDArray[np.float64], since: float, until: float) -> NDArray[np.float64]:
    """How old each became until the next; the last one stood to the end of the span, and none at all all of it (s)."""
    return np.diff(moments if moments.size else [since], append=until)


def beside(
    source: Path, machines: int, seconds: float, period: float, model_folder: Path | None, forecast: float | None
) -> list[Figure]:
    """This checkout's gateway and another one's at the same time, each of so many machines.

    Raises BenchmarkError when one does not get to work.
    """
    names = [f"machine{number}" for number in range(1, machines + 1)] if machines > 1 else []
    forecast = FORECAST_S if forecast is None and names else forecast
    with ExitStack() as opened:
        plcs, pids = [], []
        for each in (ROOT, source.resolve()):
            folder = Path(opened.enter_context(tempfile.TemporaryDirectory(prefix="decanter-footprint-")))
            model = learned_model((model_folder or folder).resolve())
            plc = opened.enter_context(software_plc(folder, machines=names))
            process = opened.enter_context(gateway(folder, plc, model, period, forecast=forecast, source=each))
            until_usable(plc, process)
            plcs.append(plc)
            pids.append(process.pid)
        before = [(cpu_seconds(pid), _accepted(plc)) for pid, plc in zip(pids, plcs, strict=True)]
        time.sleep(seconds)
        after = [(cpu_seconds(pid), _accepted(plc)) for pid, plc in zip(pids, plcs, strict=True)]
        peaks = [peak_megabytes(pid) for pid in pids]
    used = [now[0] - then[0] for now, then in zip(after, before, strict=True)]
    blocks = [now[1] - then[1] for now, then in zip(after, before, strict=True)]
    due = [1e3 * one * period / (seconds * machines) for one in used]
    written = [1e3 * one / max(count, 1) for one, count in zip(used, blocks, strict=True)]
    other = f"the gateway of {source.name}"
    return [
        Figure("CPU per 1000 scans that were due", due[0], "s", other, due[1]),
        Figure("CPU per 1000 blocks accepted", written[0], "s", other, written[1]),
        Figure("peak resident size", peaks[0], "MB", other, peaks[1]),
        Figure("blocks accepted", blocks[0], "", other, blocks[1]),
    ]


def by_import(seconds: float, period: float, model_folder: Path | None, forecast: float | None) -> list[Figure]:
    """What the gateway's libraries take of its memory, the largest first.

    Raises BenchmarkError when it does not get to work.
    """
    with tempfile.TemporaryDirectory(prefix="decanter-footprint-") as name:
        folder = Path(name)
        model, out = learned_model(model_folder or folder), folder / "imports.json"
        program = (str(ROOT / "benchmarks/import_memory.py"), str(ROOT), str(out))
        with (
            software_plc(folder) as plc,
            gateway(folder, plc, model, period, forecast=forecast, program=program) as process,
        ):
            until_usable(plc, process)
            time.sleep(seconds)
            peak = peak_megabytes(process.pid)
        grown: dict[str, float] = json.loads(out.read_text(encoding="utf-8"))
    began, loaded = grown.pop("began"), sorted(grown.items(), key=lambda row: -row[1])
    shown = [(library, size) for library, size in loaded if library and size >= LEAST_MB]
    rest = sum(size for library, size in loaded if library) - sum(size for _, size in shown)
    return [
        Figure("the interpreter", began, "MB"),
        *(Figure(library, size, "MB") for library, size in shown),
        Figure("other libraries", rest, "MB"),
        Figure("what is made of it: settings, model, records, forecasts", grown[""], "MB"),
        Figure("peak resident size of the gateway", peak, "MB"),
    ]


def _accepted(plc: Plc) -> int:
    return sum(int(one["accepted"]) for one in plc.statuses())


def _numbers(least: int) -> Callable[[click.Context, click.Parameter, str | None], tuple[int, ...]]:
    def read(_context: click.Context, _parameter: click.Parameter, text: str | None) -> tuple[int, ...]:
        try:
            numbers = tuple(int(part) for part in text.split(",")) if text else ()
        except ValueError:
            numbers = (-1,)
        if any(number < least for number in numbers):
            raise click.BadParameter(f"{text!r}: give whole numbers from {least} on with commas between, like 1,2,5")
        return numbers

    return read


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="4 seconds instead of 30.")
@click.option("--seconds", type=click.FloatRange(0.5), help="How long it is measured.")
@click.option("--period", type=click.FloatRange(0.02), default=0.1, show_default=True, help="Scan period (s).")
@click.option("--forecast", type=click.FloatRange(0.1), help="Seconds between two forecasts instead of ten scans.")
@click.option(
    "--beside", "source", type=click.Path(path_type=Path, exists=True), help="Another checkout, measured too."
)
@click.option("--machines", callback=_numbers(1), help="Numbers of machines in one gateway: 1,2,5.")
@click.option("--neighbours", callback=_numbers(0), help="Numbers of busy processes beside one gateway: 0,1,2.")
@click.option("--imports", "imported", is_flag=True, help="What each library takes of the memory.")
@click.option("--model-folder", type=click.Path(path_type=Path), help="Where the learned model is kept.")
def main(
    *,
    as_json: bool,
    quick: bool,
    seconds: float | None,
    period: float,
    forecast: float | None,
    source: Path | None,
    machines: tuple[int, ...],
    neighbours: tuple[int, ...],
    imported: bool,
    model_folder: Path | None,
) -> None:
    seconds = seconds or (4.0 if quick else 30.0)
    if neighbours:
        if len(machines) > 1:
            raise click.UsageError("--neighbours takes one number of machines: --machines 20")
        figures = crowded(neighbours, machines[0] if machines else CROWD, seconds, period, model_folder)
    elif source is not None:
        if len(machines) > 1:
            raise click.UsageError("--beside takes one number of machines: --machines 8")
        figures = beside(source, machines[0] if machines else 1, seconds, period, model_folder, forecast)
    elif machines:
        figures = growth(machines, seconds, period, model_folder)
    elif imported:
        figures = by_import(seconds, period, model_folder, forecast)
    else:
        figures = measure(seconds, period, model_folder, forecast)
    give(f"footprint, scan period {1e3 * period:g} ms", figures, as_json=as_json)


if __name__ == "__main__":
    main()
