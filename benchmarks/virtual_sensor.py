"""How right the model is in place of a bad sensor (record 0151): error and coverage of the 90 % band by the time since.

A model is learned as at a plant, and follows held-out days as the gateway does. From one moment after the other the
sensor is bad for two hours: the model goes on without it, alone and with what the bearing beside it tells (record
0151), and what they say is held against what the sensor would have read. Held out are days of production of the
simulated plant, whose two bearings share friction and disturbances, and each measured trace of cars, pump and bearings
(`--data`, ../shared/data by default; what is not there is left out) with a model of the others and no twin.
"""

import asyncio
from collections.abc import Sequence
from dataclasses import replace
from math import inf
from pathlib import Path

import click
import numpy as np

from benchmarks.figures import Figure, give
from drivers.tag import Quality, Sample
from gateway.machine.model.along import recorded_scans
from gateway.machine.model.outlook import Outlook
from gateway.machine.model.predict import Predictor
from gateway.machine.model.twin import TwinBearing, combine
from gateway.machine.reading import Scan
from gateway.settings import ForecastSection
from sim.forecast import Z90
from sim.lab.learning.bins import learn_bins
from sim.lab.recordings import load_map, load_traces
from sim.plant import production
from sim.sha import Model, Trace

MAPS = Path(__file__).parents[1] / "config" / "traces"
TEMPERATURE, TWIN = "TCuscinettiRiduttore", "TCuscinettiAlimentazione"
MEASURED = {"carobd": "carobd", "skab": "skab", "femto": "femto_bearing"}
"""Column maps, and the folders of their data."""
FORECASTS = ForecastSection(runs=50, period=300.0)
"""Fewer than a gateway makes: they only teach how wide the band has to be."""
FailureRow = tuple[float, float, float, float, float]
"""Seconds since the failure, what the sensor would have read then, its last reading, low and high of the band."""
AFTER = (300.0, 1800.0, 7200.0)
"""Seconds since the last good reading at which the model is held against the sensor."""


def without(scan: Scan, tag: str) -> Scan:
    """The scan with the sensor of `tag` failed."""
    bad = Sample(tag, None, Quality.SENSOR_FAILURE, scan.time)
    return replace(scan, samples={**scan.samples, tag: bad})


async def failures(
    model: Model,
    trace: Trace,
    *,
    period: float,
    every: float,
    section: ForecastSection = FORECASTS,
    twin: TwinBearing | None = None,
) -> tuple[list[FailureRow], list[FailureRow]]:
    """A row for each of AFTER and a failure every `every` seconds: of the model alone, and with the `twin`'s help.

    Forecasts are made along the trace as the gateway does, since the band is widened by what comes true of them. Where
    the twin tells nothing the model stands alone in both.
    """
    tag = model.temperature
    rows: list[FailureRow] = []
    helped: list[FailureRow] = []
    scans = list(recorded_scans(trace, period, model.alphabet))
    good = Predictor(model, tag)
    outlook = Outlook(good, section, inf, period)
    begin = scans[0].time + every / 2
    for number, scan in enumerate(scans):
        p = good.step(scan)
        if twin is not None:
            twin.take(scan.time, scan.good(tag), scan.good(twin.twin))
        outlook.settle(p.time, p.measured)
        if p.reset:
            outlook.void()
        outlook.begin(scan.time, known=p.known and p.inputs_good, measured=p.measured)
        await outlook.finish()
        outlook.collect()
        if scan.time < begin or p.measured is None or not p.known:
            continue
        saved, alone = good.snapshot(), Predictor(model, tag)
        if saved is None or not alone.restore(saved, scan.time):
            continue
        begin = scan.time + every
        due = list(AFTER)
        for later in scans[number + 1 :]:
            seconds = later.time - scan.time
            if not due or seconds > AFTER[-1] + 10.0 * period:
                break
            said, read = alone.step(without(later, tag)), later.good(tag)
            if said.reset:
                break  # the state of the plant is not known: the gateway gives up
            if seconds >= due[0] and read is not None and said.mean is not None and said.high is not None:
                half = (said.high - said.mean) * outlook.band_factor(seconds)
                after, mean = due.pop(0), said.mean
                rows.append((after, read, p.measured, mean - half, mean + half))
                told = None if twin is None else twin.estimate(later.time, scan.time, later.good(twin.twin))
                if told is not None:
                    both = combine(mean, half / Z90, told)
                    mean, half = both.mean, Z90 * both.sigma
                helped.append((after, read, p.measured, mean - half, mean + half))
    return rows, helped


def table_of(name: str, rows: Sequence[FailureRow]) -> list[Figure]:
    """Mean error, coverage and width by the time since the failure."""
    figures = []
    for after in AFTER:
        own = np.array([row[1:] for row in rows if row[0] == after])
        if not own.size:
            continue
        read, last, low, high = own.T
        what = f"{name}, after {after / 60:g} min ({len(own)} failures)"
        figures += [
            Figure(
                f"{what}, mean error",
                float(np.mean(np.abs(read - (low + high) / 2))),
                "degC",
                "the last reading held",
                float(np.mean(np.abs(read - last))),
            ),
            Figure(f"{what}, coverage", float(np.mean((low <= read) & (read <= high))), ""),
            Figure(f"{what}, width of the band", float(np.mean(high - low)), "degC"),
        ]
    return figures


@click.command()
@click.option("--days", type=click.IntRange(1, 30), default=4, show_default=True, help="Days of production held out.")
@click.option("--history", type=click.IntRange(1, 30), default=3, show_default=True, help="Days that are learned from.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@click.option("--data", type=click.Path(path_type=Path), default=Path("../shared/data"), show_default=True)
@click.option("--json", "as_json", is_flag=True)
def main(days: int, history: int, seed: int, data: Path, as_json: bool) -> None:
    """Measure the model in place of a bad sensor."""
    column_map = load_map(MAPS / "decanter.toml")
    past = [production(history, seed=2 * seed + 1)]
    model = learn_bins(past, column_map.alphabet, TEMPERATURE, name="history", seed=seed).model
    held_out = production(days, seed=2 * seed + 102)
    twin = TwinBearing(TWIN)
    for scan in recorded_scans(past[0], 10.0, model.alphabet):
        twin.take(scan.time, scan.good(TEMPERATURE), scan.good(TWIN))
    alone, helped = asyncio.run(failures(model, held_out, period=10.0, every=1800.0, twin=twin))
    figures = table_of("production", alone) + table_of("production, with the twin", helped)
    for name, folder in MEASURED.items():
        column_map = load_map(MAPS / f"{name}.toml")
        traces = load_traces(str(data / folder), column_map)[0] if (data / folder).is_dir() else []
        rows: list[FailureRow] = []
        for trace in traces:
            others = [each for each in traces if each is not trace]
            if not others:
                middle = float(trace.times[0] + trace.times[-1]) / 2
                others, trace = [trace.between(trace.times[0], middle)], trace.between(middle, trace.times[-1])
            own = learn_bins(others, column_map.alphabet, column_map.temperature, name=name, seed=seed).model
            alone, _ = asyncio.run(failures(own, trace, period=1.0 if name == "carobd" else 10.0, every=600.0))
            rows += alone
        figures += table_of(f"{name} (measured)", rows)
    give("the model in place of a bad sensor", figures, as_json=as_json)


if __name__ == "__main__":
    main()
