"""How right the model is in place of a bad sensor (record 0151): error and coverage of the 90 % band by the time since.

A model is learned as at a plant, and follows held-out days as the gateway does. From one moment after the other the
sensor is bad for two hours: the model goes on without it, and what it says is held against what the sensor would have
read. Held out are days of production of the simulated plant, and each measured trace of cars, pump and bearings
(`--data`, ../shared/data by default; what is not there is left out) with a model of the others.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import click
import numpy as np

from benchmarks.figures import Figure, give
from drivers.tag import Quality, Sample
from gateway.machine.model.along import recorded_scans
from gateway.machine.model.predict import Predictor
from gateway.machine.reading import Scan
from sim.learning.bins import learn_bins
from sim.plant import production
from sim.sha import Model, Trace
from sim.traces import load_map, load_traces

MAPS = Path(__file__).parents[1] / "config" / "traces"
TEMPERATURE = "TCuscinettiRiduttore"
MEASURED = {"carobd": "carobd", "skab": "skab", "femto": "femto_bearing"}
"""Column maps, and the folders of their data."""
AFTER = (300.0, 1800.0, 7200.0)
"""Seconds since the last good reading at which the model is held against the sensor."""


def without(scan: Scan, tag: str) -> Scan:
    """The scan with the sensor of `tag` failed."""
    bad = Sample(tag, None, Quality.SENSOR_FAILURE, scan.time)
    return replace(scan, samples={**scan.samples, tag: bad})


def failures(model: Model, trace: Trace, *, period: float, every: float) -> Iterator[tuple[float, float, float, float]]:
    """(seconds since the failure, what the sensor would have read, low, high) for a failure every `every` seconds."""
    tag = model.temperature
    scans = list(recorded_scans(trace, period, model.alphabet))
    good = Predictor(model, tag)
    begin = scans[0].time + every / 2
    for number, scan in enumerate(scans):
        p = good.step(scan)
        if scan.time < begin or p.measured is None or not p.known:
            continue
        begin = scan.time + every
        alone = Predictor(model, tag)
        saved = good.snapshot()
        if saved is None or not alone.restore(saved, scan.time):
            continue
        due = list(AFTER)
        for later in scans[number + 1 :]:
            seconds = later.time - scan.time
            if not due or seconds > AFTER[-1] + 10.0 * period:
                break
            said = alone.step(without(later, tag))
            if said.reset:
                break  # the state of the plant is not known: the gateway gives up
            read = later.good(tag)
            if seconds >= due[0] and read is not None and said.low is not None and said.high is not None:
                yield due.pop(0), read, said.low, said.high


def table_of(name: str, rows: Sequence[tuple[float, float, float, float]]) -> list[Figure]:
    """Mean error, coverage and width by the time since the failure."""
    figures = []
    for after in AFTER:
        own = np.array([row[1:] for row in rows if row[0] == after])
        if not own.size:
            continue
        read, low, high = own.T
        what = f"{name}, after {after / 60:g} min ({len(own)} failures)"
        figures += [
            Figure(f"{what}, mean error", float(np.mean(np.abs(read - (low + high) / 2))), "degC"),
            Figure(f"{what}, coverage", float(np.mean((low <= read) & (read <= high))), ""),
            Figure(f"{what}, width of the band", float(np.mean(high - low)), "degC"),
        ]
    return figures


@click.command()
@click.option("--days", type=click.IntRange(1, 30), default=4, show_default=True, help="Days of production held out.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@click.option("--data", type=click.Path(path_type=Path), default=Path("../shared/data"), show_default=True)
@click.option("--json", "as_json", is_flag=True)
def main(days: int, seed: int, data: Path, as_json: bool) -> None:
    """Measure the model in place of a bad sensor."""
    column_map = load_map(MAPS / "decanter.toml")
    history = [production(3, seed=2 * seed + 1)]
    model = learn_bins(history, column_map.alphabet, TEMPERATURE, name="history", seed=seed).model
    held_out = production(days, seed=2 * seed + 102)
    figures = table_of("production", list(failures(model, held_out, period=10.0, every=1800.0)))
    for name, folder in MEASURED.items():
        column_map = load_map(MAPS / f"{name}.toml")
        traces = load_traces(str(data / folder), column_map)[0] if (data / folder).is_dir() else []
        rows: list[tuple[float, float, float, float]] = []
        for trace in traces:
            others = [each for each in traces if each is not trace]
            if not others:
                middle = float(trace.times[0] + trace.times[-1]) / 2
                others, trace = [trace.between(trace.times[0], middle)], trace.between(middle, trace.times[-1])
            own = learn_bins(others, column_map.alphabet, column_map.temperature, name=name, seed=seed).model
            rows += failures(own, trace, period=1.0, every=300.0)
        figures += table_of(f"{name} (measured)", rows)
    give("the model in place of a bad sensor", figures, as_json=as_json)


if __name__ == "__main__":
    main()
