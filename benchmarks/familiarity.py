"""How well strange cycles are told from ordinary ones by `sim.familiarity`, on the plant of the gap benchmark.

The training is so many days of one machine as it is. Held against it: other days of the same machine (ordinary: every
one that is called strange is a false alarm), days on which one effect of `benchmarks.discrepancy` acts at the greatest
strength that the plant bears, and ordinary days of the other machines of the pool. For each the area under the ROC
curve against the ordinary cycles, the share of cycles beyond the gateway's limit, and the median delay from a cycle's
start to the first point beyond it. With --model also the error of a model's free run, by the class that was expected,
and how many ordinary cycles it predicts badly; with --cost what a running gateway pays for it. Everything was chosen on
the set `development`.
"""

from collections.abc import Mapping
from time import process_time

import click
import numpy as np

from benchmarks.discrepancy.bearings import POOL, Machine, machine
from benchmarks.discrepancy.effects import EFFECTS
from benchmarks.discrepancy.log import FIRST, signals_of
from benchmarks.discrepancy.operation import operate
from benchmarks.discrepancy.plant import Parts, disturbance, measured, run
from benchmarks.discrepancy.strata import SETS
from benchmarks.figures import Figure, give
from gateway.lab.learning.familiar import ErrorPair, error_pair, free_run_error
from gateway.machine.model.familiar import CycleFamiliarity
from gateway.settings.config import AlarmSection
from sim.artefacts import Familiarity
from sim.familiarity import (
    CyclePoints,
    ExcessSoFar,
    FamiliarityReference,
    PointSource,
    cycle_points,
    fit_reference,
    measured_classes,
)
from sim.lab.learning.bins import learn_bins
from sim.lab.recordings import split_cycles
from sim.sha import DECANTER, Array, Event, Model, Trace, encode

MONTH_CYCLES = 120
"""Cycles of a month at four a day."""
LIMIT = AlarmSection().unfamiliar
"""The gateway's own, from which confidence is lowered and the alarm comes."""
LOGS = 3
"""Logs of ordinary days, each with a weather of its own."""
SCANS = 20_000


def days_of(own: Machine, days: int, seed: int, effect: str = "") -> Trace:
    """Some days of a machine, with one effect or none, encoded."""
    rng = np.random.default_rng(seed)
    operation = operate(rng, days)
    parts = EFFECTS[effect].make(operation, EFFECTS[effect].high, rng) if effect else Parts()
    noise = disturbance(rng, operation, own.bearing, own.rough)
    (course,) = run([(operation, own.bearing, noise, parts)])
    signals = signals_of(operation, rng) | {FIRST: measured(rng, course.sensor, own.rough)}
    trace = Trace("days", operation.times, signals)
    return Trace("days", operation.times, signals, encode(trace, DECANTER))


Cycle = tuple[Trace, CyclePoints]


def cycles_of(trace: Trace) -> list[Cycle]:
    """Each cycle with its points; the last one of a log has no end."""
    source = PointSource.for_alphabet(DECANTER, FIRST)
    cycles = split_cycles(trace, DECANTER, gap=DECANTER.gap)[:-1]
    points = [cycle_points(trace, source, begin=float(cycle.times[0]), end=float(cycle.times[-1])) for cycle in cycles]
    return [(cycle, each) for cycle, each in zip(cycles, points, strict=True) if len(each.times)]


def values(reference: FamiliarityReference, cycles: list[Cycle]) -> Array:
    """The strangeness of each cycle."""
    return np.array([reference.strangeness(points.values, points.times).value for _, points in cycles])


def first_beyond(reference: FamiliarityReference, cycle: Cycle) -> float | None:
    """The minutes from a cycle's start to its first point beyond the limit, as it grows; None where none is."""
    trace, points = cycle
    so_far = ExcessSoFar()
    for point, time in zip(points.values, points.times.tolist(), strict=True):
        found, so_far = reference.follow(point, time, so_far)
        if found.value > LIMIT:
            return float(time - trace.times[0]) / 60.0
    return None


def area(strange: Array, ordinary: Array) -> float:
    """The chance that a strange cycle is stranger than an ordinary one (Mann-Whitney)."""
    above = strange[:, None] > ordinary[None, :]
    return float(np.mean(above + 0.5 * (strange[:, None] == ordinary[None, :])))


def errors_by_class(reference: FamiliarityReference, model: Model, subjects: Mapping[str, list[Cycle]]) -> list[Figure]:
    """The mean relative error of the model's free run: of each class that was expected, within the limit and beyond."""
    pairs: list[ErrorPair] = []
    for cycles in subjects.values():
        found = (error_pair(reference, model, cycle, points.values) for cycle, points in cycles)
        pairs += [pair for pair in found if pair is not None]
    figures = []
    for one in measured_classes(pairs):
        figures.append(Figure(f"expected {one.name}: cycles", one.cycles, ""))
        figures.append(Figure(f"expected {one.name}: error", float("nan") if one.error is None else one.error, ""))
    for name, beyond in (("within the limit", False), ("beyond the limit", True)):
        errors = [error for strangeness, error in pairs if (strangeness > LIMIT) is beyond]
        figures.append(Figure(f"{name}: error", float(np.mean(errors)), "", "cycles", float(len(errors))))
    return figures


def badly_predicted(model: Model, cycles: list[Cycle]) -> float:
    """The share of cycles that the model's free run is off on by more than its own 90 % band, in percent."""
    found = [each for cycle, _ in cycles if (each := free_run_error(model, cycle)) is not None]
    return 100.0 * float(np.mean([each.error > each.allowed for each in found]))


class _Row:
    """A scan as the gateway's stage needs it."""

    def __init__(self, time: float, readings: Mapping[str, float]) -> None:
        self.time, self.good = time, readings.get


def cost(reference: FamiliarityReference, model: Model, trace: Trace) -> list[Figure]:
    """Microseconds of processor time per scan at 1 Hz, points and ratings included; without a reference beside it."""
    signals = {name: trace.signals[name] for name in ("MarciaDecanter", "Assorbimento", "TFango", "TAmbiente", FIRST)}
    running = np.flatnonzero(trace.signals["MarciaDecanter"])[0]
    rows = [
        _Row(
            float(trace.times[running]) + second,
            {name: float(column[running + second // 10]) for name, column in signals.items()},
        )
        for second in range(SCANS)
    ]
    begun = (Event(rows[0].time, "W_ON"),)
    figures = []
    for name, known in (("with a reference", Familiarity(reference, None)), ("without", None)):
        following = CycleFamiliarity(known, model, LIMIT)
        begin = process_time()
        for number, row in enumerate(rows):
            following.take(row, begun if not number else ())  # type: ignore[arg-type]
        spent = 1e6 * (process_time() - begin) / SCANS
        figures.append(Figure(f"a scan {name}", spent, "us", "a scan of 1 s", 1e6))
    return figures


@click.command()
@click.option("--set", "set_", type=click.Choice(list(SETS)), default="calibration", show_default=True)
@click.option(
    "--days", type=click.IntRange(4), default=20, show_default=True, help="Of training, and as many ordinary."
)
@click.option(
    "--strange", type=click.IntRange(2), default=5, show_default=True, help="Days of each effect and machine."
)
@click.option("--effect", "wanted", multiple=True, type=click.Choice(list(EFFECTS)), help="Only these.")
@click.option("--model", "with_model", is_flag=True, help="Learn a model too, and print its error by class.")
@click.option("--cost", "with_cost", is_flag=True, help="Print what a scan costs.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@click.option("--json", "as_json", is_flag=True)
def main(
    set_: str,
    days: int,
    strange: int,
    wanted: tuple[str, ...],
    with_model: bool,
    with_cost: bool,
    seed: int,
    as_json: bool,
) -> None:
    """Print AUC, share beyond the limit and delay by effect and machine, and the false alarms of ordinary days."""
    own = machine(set_, "stages", True, 0)
    training = days_of(own, days, 1000 + seed)
    reference = fit_reference([points.values for _, points in cycles_of(training)])
    logs = [cycles_of(days_of(own, days, 2000 + 10 * seed + log)) for log in range(LOGS)]
    ordinary = values(reference, [cycle for log in logs for cycle in log])
    figures = [
        Figure("ordinary cycles", ordinary.size, ""),
        Figure("ordinary cycles beyond 1", 100 * float(np.mean(ordinary > 1.0)), "%", "a twentieth", 5.0),
        Figure(f"ordinary cycles beyond {LIMIT:g}", 100 * float(np.mean(ordinary > LIMIT)), "%"),
        Figure("false alarms a month", MONTH_CYCLES * float(np.mean(ordinary > LIMIT)), ""),
    ]
    subjects = {name: (own, name) for name in wanted or EFFECTS}
    if not wanted:
        subjects |= {f"machine {n}": (machine(set_, "stages", True, n), "") for n in range(1, POOL)}
    met, areas = dict[str, list[Cycle]](), dict[str, float]()
    for number, (name, (other, effect)) in enumerate(subjects.items()):
        cycles = met[name] = cycles_of(days_of(other, strange, 3000 + 100 * seed + number, effect))
        found = values(reference, cycles)
        areas[name] = area(found, ordinary)
        delays = [each for cycle in cycles if (each := first_beyond(reference, cycle)) is not None]
        figures.append(Figure(f"{name}: AUC", areas[name], ""))
        figures.append(Figure(f"{name}: beyond {LIMIT:g}", 100 * float(np.mean(found > LIMIT)), "%"))
        figures.append(Figure(f"{name}: delay", float(np.median(delays)) if delays else float("nan"), "min"))
    for kind, own_areas in (
        ("effects", [value for name, value in areas.items() if name in EFFECTS]),
        ("other machines", [value for name, value in areas.items() if name not in EFFECTS]),
    ):
        if own_areas:
            figures.append(Figure(f"all {kind}: mean AUC", float(np.mean(own_areas)), ""))
    if with_model or with_cost:
        model = learn_bins([training], DECANTER, FIRST, name="own", seed=seed).model
        if with_model:
            share = badly_predicted(model, [cycle for log in logs for cycle in log])
            figures.append(Figure("ordinary cycles badly predicted", share, "%", "a right one at most", 10.0))
            figures += errors_by_class(reference, model, {"ordinary": logs[0]} | met)
        if with_cost:
            figures += cost(reference, model, training)
    give("familiarity", figures, as_json=as_json)


if __name__ == "__main__":
    main()
