"""Where the processor time of a scan goes: the gateway at work, its stacks sampled, by stage and as a flame graph.

The gateway runs as in benchmarks/footprint.py (armed, model, historian, log, alarms, a block a scan) against the
software PLC, with its main thread sampled; a share is of that thread's processor time, an idle wait's share is what the
system takes for going to sleep and waking up. Each other thread is given whole, by its own clock. `--source` takes
another checkout, to compare with; `--forecast` gives the seconds between two forecasts instead of ten scans; `--flame`
writes the picture.
"""

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from html import escape
from pathlib import Path

import click

from benchmarks.figures import Figure, give
from benchmarks.processes import ROOT, learned_model, plant_file, software_plc, until_usable

STAGES = {
    "waiting for the tick": "gateway.machine.reading.scan:_await_next",
    "reading the device": "drivers.modbus.driver:ModbusDriver.read",
    "quality": "gateway.machine.reading.quality:judge",
    "alarms": "gateway.machine.alarms.board:AlarmBoard._step",
    "the model": "gateway.machine.model.unit:ModelUnit.follow",
    "reviews and bands": "gateway.machine.model.unit:ModelUnit.settle",
    "the ensemble's members": "gateway.machine.model.ensemble:Ensemble.follow",
    "block: building, audit, write, read back": "gateway.machine.writing.block_stage:BlockStage.take",
    "records": "gateway.machine.records:Records.take",
    "saving the state": "gateway.machine.pipeline:Machine.save",
    "bytes coming in": "asyncio.selector_events:_SelectorSocketTransport._read_ready",
    "going to sleep and waking up": "selectors:EpollSelector.select",
}
"""The stages of a scan by the function that is all of it; those that are not here are the event loop's own."""
THREADS = {"<asyncio_0>": "forecasts", "<audit>": "audit log", "<historian>": "historian"}
"""What the other threads do, by their names."""
LEAST_SHARE = 0.004
"""Frames with less than this share of the time are left out of the picture."""
_WIDTH, _ROW = 1200, 16
Stacks = Counter[tuple[str, ...]]


def thread_ticks(pid: int) -> dict[int, float]:
    """Processor time of each thread so far (s)."""
    found = {}
    for task in Path(f"/proc/{pid}/task").iterdir():
        fields = (task / "stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        found[int(task.name)] = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return found


def measure(
    seconds: float, period: float, source: Path, model_folder: Path | None, forecast: float | None = None
) -> tuple[list[Figure], Stacks]:
    """The shares, and the stacks they are from. Raises BenchmarkError when the gateway does not get to work."""
    with tempfile.TemporaryDirectory(prefix="decanter-hot-spots-") as name:
        folder = Path(name)
        model, out = learned_model((model_folder or folder).resolve()), folder / "stacks.txt"
        with software_plc(folder) as plc:
            plant = plant_file(folder, model, period, forecast=forecast)
            script = [sys.executable, str(ROOT / "benchmarks/sampled.py"), str(source.resolve()), str(out)]
            command = [*script, "run", "--config", str(plant), "--port", str(plc.port), "--quiet"]
            with subprocess.Popen(command, stdin=subprocess.DEVNULL, cwd=source) as process:
                until_usable(plc, process)
                process.send_signal(signal.SIGUSR1)
                before = thread_ticks(process.pid)
                time.sleep(seconds)
                after = thread_ticks(process.pid)
                process.send_signal(signal.SIGTERM)
                process.wait(20.0)
        stacks: Stacks = Counter()
        others: Counter[str] = Counter()
        for line in out.read_text(encoding="utf-8").splitlines():
            frames, _, weight = line.rpartition(" ")
            if frames.startswith("<"):
                others[THREADS.get(frames, frames)] += int(weight)
            else:
                stacks[tuple(frames.split(";"))] += int(weight)
    # The sampling itself is in the stacks, and not in what the kernel counted for the time that is measured.
    scans, whole = seconds / period, max(sum(stacks.values()), 1)
    used = {thread: now - before.get(thread, 0.0) for thread, now in after.items()}
    main = used.pop(process.pid)
    figures = [Figure("main thread", 1e3 * main / scans, "ms a scan")]
    part = sum(used.values()) / max(sum(others.values()), 1)
    figures += [
        Figure(f"thread: {name}", 1e3 * one * part / scans, "ms a scan") for name, one in others.most_common() if one
    ]
    left = stacks
    shares = {}
    for stage, function in STAGES.items():
        own = {stack: weight for stack, weight in left.items() if function in stack}
        left = Counter({stack: weight for stack, weight in left.items() if stack not in own})
        shares[stage] = sum(own.values()) / whole
    shares["the event loop and all else"] = sum(left.values()) / whole
    ranked = sorted(shares.items(), key=lambda item: -item[1])
    return figures + [Figure(stage, 1e3 * main / scans * share, "ms a scan") for stage, share in ranked], stacks


def flame(stacks: Stacks, title: str) -> str:
    """The flame graph (Gregg 2016) as SVG: a frame's width is its share of the time, above it what it called."""
    total = sum(stacks.values())
    boxes: list[str] = []

    def draw(under: dict[tuple[str, ...], int], level: int, left: float) -> Iterator[int]:
        groups: dict[str, dict[tuple[str, ...], int]] = {}
        for stack, weight in under.items():
            if len(stack) > level:
                groups.setdefault(stack[level], {})[stack] = weight
        for frame, inner in sorted(groups.items()):
            share = sum(inner.values()) / total
            if share >= LEAST_SHARE:
                # Our own code in warm colours, libraries in cold ones.
                own = frame.startswith(("gateway", "sim", "drivers"))
                hue = 40 - 3 * (level % 8) if own else 210 + 3 * (level % 8)
                width, text = _WIDTH * share, escape(frame)
                label = escape(frame.rpartition(":")[2][: int(width / 6.2)]) if width > 20 else ""
                place = f'x="{left:.1f}" y="{{{level}}}" width="{max(width - 0.5, 0.5):.1f}" height="{_ROW - 1}"'
                boxes.append(
                    f'<g><title>{text} {100 * share:.1f} %</title><rect {place} fill="hsl({hue},70%,72%)"/>'
                    f'<text x="{left + 2:.1f}" y="{{{level}}}" dy="11">{label}</text></g>'
                )
                yield level
                yield from draw(inner, level + 1, left)
            left += _WIDTH * share

    depth = 1 + max(draw(dict(stacks), 0, 0.0), default=0)
    height = _ROW * (depth + 2)
    rows = [str(height - _ROW * (level + 1)) for level in range(depth)]
    drawn = "\n".join(box.format(*rows) for box in boxes)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {height}" font-family="sans-serif" '
        f'font-size="10"><text x="4" y="14" font-size="13">{escape(title)}</text>\n{drawn}\n</svg>\n'
    )


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="6 seconds instead of 40.")
@click.option("--seconds", type=click.FloatRange(0.5), help="How long it is sampled.")
@click.option("--period", type=click.FloatRange(0.02), default=0.1, show_default=True, help="Scan period (s).")
@click.option("--forecast", type=click.FloatRange(0.1), help="Seconds between two forecasts instead of ten scans.")
@click.option("--source", type=click.Path(path_type=Path, exists=True), default=ROOT, help="Another checkout.")
@click.option("--flame", "picture", type=click.Path(path_type=Path), help="Where the flame graph (SVG) goes.")
@click.option("--model-folder", type=click.Path(path_type=Path), help="Where the learned model is kept.")
def main(
    *,
    as_json: bool,
    quick: bool,
    seconds: float | None,
    period: float,
    forecast: float | None,
    source: Path,
    picture: Path | None,
    model_folder: Path | None,
) -> None:
    figures, stacks = measure(seconds or (6.0 if quick else 40.0), period, source, model_folder, forecast)
    if picture is not None:
        picture.write_text(flame(stacks, f"main thread, {figures[0].value:.2f} ms a scan"), encoding="utf-8")
    give(f"hot spots, scan period {1e3 * period:g} ms", figures, as_json=as_json)


if __name__ == "__main__":
    main()
