"""One plant recorded at several intervals and stored on change: cycles, locations, thresholds and forecasts of each.

\b
python -m benchmarks.intervals [--days 3] [--rows 1,5,10,30,60,300,600,3600]
python -m benchmarks.intervals --deadbands 0.1,0.5,1,2 --exceptions 10,60,600,3600

Each is written as a plant exports it, mapped (a question gets its guess) and learned (method bins). Each model
forecasts another day of rows of 10 s: what it knows less by is what its recording did not show. The CRPS stands beside
that of the first row, which of values stored on change is the same recording with each row.
"""

import time
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import click
import numpy as np

from sim.lab.learning import LearningError
from sim.lab.learning.bins import learn_bins
from sim.lab.learning.calibrate import HORIZONS_S, score_forecasts
from sim.lab.recordings import load_traces, parse_map
from sim.lab.recordings.mapping import Answers, Undecided, draft_map
from sim.plant import production
from sim.sha import Bins, Trace, encode
from tests.traces.exports import Recording, on_change, wide, written

HEADER = "Time,Bearing temperature,Motor current,Running"
TEMPERATURE, CURRENT, RUNNING = "TCuscinettiRiduttore", "Assorbimento", "MarciaDecanter"
"""Signals of the simulated plant, in the order of the header."""
STORED_STEP = 10.0
"""s between the scans of what is stored on change."""
CYCLES_A_DAY = 5
READ_AT = 2.0e9
"""s since 1970, after all that is written: no figure depends on the day of the run."""


@dataclass(frozen=True, slots=True)
class Learned:
    """What one recording taught, or why it taught nothing."""

    rows: int
    asked: tuple[str, ...]
    stored: str
    starts: int
    locations: tuple[str, ...]
    thresholds: tuple[float, ...]
    crps: dict[float, float]
    seconds: float
    problem: str = ""


def as_recording(trace: Trace, step: float) -> Recording:
    """Every `step` s a row of the plant's `trace`, as an export has it."""
    begin = float(trace.times[0])
    grid = np.arange(0.0, float(trace.times[-1]) - begin, step)
    rows = np.minimum(np.searchsorted(trace.times - begin, grid), trace.times.size - 1)
    heat, current, running = (trace.signals[name][rows] for name in (TEMPERATURE, CURRENT, RUNNING))
    return Recording(grid, heat.round(2), current.round(1), (running > 0).astype(int))


def learn_export(export: Path, test: Trace, origins: int) -> Learned:
    """The export through map, learner and forecasts along the `test`."""
    began, answers, asked = time.process_time(), Answers(), list[str]()
    while True:
        try:
            drafted = draft_map(export, answers, now=READ_AT)
            break
        except Undecided as question:
            asked.append(f"{question.field} {question.guess}")
            if not question.guess:
                return Learned(0, tuple(asked), "", 0, (), (), {}, 0.0, str(question))
            answers = answers.with_answer(question.field, question.guess)
    column_map = parse_map(drafted.text, "drafted")
    traces, report = load_traces(export, column_map)
    alphabet = report.alphabet
    starts = sum(event.symbol == "W_ON" for trace in traces for event in trace.events)
    (bins,) = [channel for channel in alphabet.channels if isinstance(channel, Bins)]
    known = Learned(report.used, tuple(asked), column_map.stored, starts, (), bins.thresholds, {}, 0.0)
    try:
        model = learn_bins(traces, alphabet, column_map.temperature, seed=0, bands=False).model
    except LearningError as error:
        return Learned(*[getattr(known, name) for name in known.__slots__[:-2]], 0.0, str(error))
    names = {"Bearing_temperature": TEMPERATURE, "Motor_current": CURRENT, "Running": RUNNING}
    day = Trace("test", test.times, {own: test.signals[name] for own, name in names.items()})
    day = Trace("test", day.times, day.signals, events=encode(day, model.alphabet))
    scored = score_forecasts(model, [day], [float(day.times[0])], np.random.default_rng(0), origins=origins)
    crps = {at: float(np.mean([each.crps for each in scored if each.horizon == at])) for at in HORIZONS_S}
    locations = tuple(location.name for location in model.sha.locations)
    return Learned(
        known.rows, known.asked, known.stored, starts, locations, bins.thresholds, crps, time.process_time() - began
    )


def say(label: str, found: Learned, first: Learned) -> str:
    """One row of the table."""
    if found.problem:
        return f"{label:>16} {found.rows:>7} rows, {found.starts} starts: {found.problem}"
    same = "same" if found.locations == first.locations else f"{len(found.locations)} locations"
    cuts = ", ".join(f"{cut:.4g}" for cut in found.thresholds)
    crps = "  ".join(f"{value:.3f} ({value / first.crps[at]:.2f})" for at, value in found.crps.items())
    asked = f"  asked: {', '.join(found.asked)}" if found.asked else ""
    return (
        f"{label:>16} {found.rows:>7} {found.stored:>9} {found.starts:>6}  {same:>12}  [{cuts}]  {crps}  "
        f"{found.seconds:.1f} s{asked}"
    )


def numbers(_context: object, _option: object, text: str) -> list[float]:
    """Numbers between commas."""
    return [float(each) for each in text.split(",") if each]


@click.command(help=__doc__)
@click.option("--days", default=3, show_default=True, help="Days that teach.")
@click.option("--seed", default=1, show_default=True, help="Of the days that teach; the test's is the next one.")
@click.option(
    "--rows", default="1,5,10,30,60,300,600,3600", show_default=True, callback=numbers, help="s between rows."
)
@click.option("--deadbands", default="", callback=numbers, help="degC; stored on change instead.")
@click.option(
    "--exceptions", default="3600", show_default=True, callback=numbers, help="s, the longest without a value."
)
@click.option("--origins", default=100, show_default=True, help="Forecasts of each model.")
def main(
    days: int, seed: int, rows: list[float], deadbands: list[float], exceptions: list[float], origins: int
) -> None:
    """The command."""
    step = STORED_STEP if deadbands else min(rows)
    taught, test = (
        production(count, CYCLES_A_DAY, seed=own, period=period)
        for count, own, period in ((days, seed, step), (1, seed + 1, STORED_STEP))
    )
    plant = as_recording(taught, step)
    click.echo(f"{(np.diff(plant.running) == 1).sum()} starts; CRPS in degC after {HORIZONS_S} s (to the first row)")
    click.echo(f"{'':>16} {'rows':>7} {'stored':>9} {'starts':>6}  {'locations':>12}  thresholds  CRPS")
    first: Learned | None = None
    with TemporaryDirectory() as folder:
        export = Path(folder) / "export.csv"

        def show(label: str) -> None:
            nonlocal first
            found = learn_export(export, test, origins)
            first = first or found
            click.echo(say(label, found, first))

        if not deadbands:
            for every in rows:
                wide(export, of=as_recording(taught, every))
                show(f"{every:g} s")
            return
        wide(export, of=plant)
        show("each row")
        for deadband, exception in product(deadbands, exceptions):
            written(export, HEADER, on_change(plant, deadband, exception))
            show(f"{deadband:g} degC {exception:g} s")


if __name__ == "__main__":
    main()
