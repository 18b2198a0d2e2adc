"""How well strange cycles are told from ordinary ones by `sim.familiarity`, on the plant of the gap benchmark.

The training is so many days of one machine as it is. Held against it: other days of the same machine (ordinary: every
one that is called strange is a false alarm), days on which one effect of `benchmarks.discrepancy` acts at the greatest
strength that the plant bears, and ordinary days of the other machines of the pool. Nothing was tuned on them. For each
the area under the ROC curve against the ordinary cycles, the share of cycles beyond strangeness 1, and the median delay
from a cycle's start to the first point beyond it.
"""

import click
import numpy as np

from benchmarks.discrepancy.bearings import POOL, Machine, machine
from benchmarks.discrepancy.effects import EFFECTS
from benchmarks.discrepancy.log import FIRST, signals_of
from benchmarks.discrepancy.operation import operate
from benchmarks.discrepancy.plant import Parts, disturbance, measured, run
from benchmarks.figures import Figure, give
from sim.effects import ROLES
from sim.familiarity import CyclePoints, FamiliarityReference, cycle_points, fit_reference
from sim.sha import DECANTER, Array, Trace, encode
from sim.traces import split_cycles

MONTH_CYCLES = 120
"""Cycles of a month at four a day."""


def cycles_of(own: Machine, days: int, seed: int, effect: str = "") -> list[CyclePoints]:
    """The points of the cycles of some days of a machine, with one effect or none."""
    rng = np.random.default_rng(seed)
    operation = operate(rng, days)
    parts = EFFECTS[effect].make(operation, EFFECTS[effect].high, rng) if effect else Parts()
    noise = disturbance(rng, operation, own.bearing, own.rough)
    (course,) = run([(operation, own.bearing, noise, parts)])
    signals = signals_of(operation, rng) | {FIRST: measured(rng, course.sensor, own.rough)}
    trace = Trace("days", operation.times, signals)
    trace = Trace("days", operation.times, signals, encode(trace, DECANTER))
    others = {role: ROLES[role] for role in ("feed", "ambient")}
    # The last cycle of a log has no end.
    return [
        cycle_points(trace, DECANTER, FIRST, others, begin=float(cycle.times[0]), end=float(cycle.times[-1]))
        for cycle in split_cycles(trace, DECANTER, gap=DECANTER.gap)[:-1]
    ]


def values(reference: FamiliarityReference, cycles: list[CyclePoints]) -> Array:
    """The strangeness of each cycle."""
    return np.array([reference.strangeness(cycle.values, cycle.times).value for cycle in cycles])


def delay(reference: FamiliarityReference, cycles: list[CyclePoints]) -> float:
    """The median minutes from a cycle's start to its first point beyond 1; NaN where none has one."""
    found = []
    for cycle in cycles:
        for row, time in enumerate(cycle.times):
            if reference.strangeness(cycle.values[row : row + 1], cycle.times[row : row + 1]).value > 1.0:
                found.append((float(time - cycle.times[0]) + 300.0) / 60.0)
                break
    return float(np.median(found)) if found else float("nan")


def area(strange: Array, ordinary: Array) -> float:
    """The chance that a strange cycle is stranger than an ordinary one (Mann-Whitney)."""
    above = strange[:, None] > ordinary[None, :]
    return float(np.mean(above + 0.5 * (strange[:, None] == ordinary[None, :])))


@click.command()
@click.option(
    "--days", type=click.IntRange(4), default=20, show_default=True, help="Of training, and as many ordinary."
)
@click.option(
    "--strange", type=click.IntRange(2), default=5, show_default=True, help="Days of each effect and machine."
)
@click.option("--effect", "wanted", multiple=True, type=click.Choice(list(EFFECTS)), help="Only these.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@click.option("--json", "as_json", is_flag=True)
def main(days: int, strange: int, wanted: tuple[str, ...], seed: int, as_json: bool) -> None:
    """Print AUC, share beyond 1 and delay by effect and machine, and the false alarms of ordinary days."""
    own = machine("development", "stages", True, 0)
    reference = fit_reference([cycle.values for cycle in cycles_of(own, days, 1000 + seed)])
    ordinary = values(reference, cycles_of(own, days, 2000 + seed))
    false = float(np.mean(ordinary > 1.0))
    figures = [
        Figure("ordinary cycles", ordinary.size, ""),
        Figure("ordinary cycles beyond 1", 100 * false, "%", "a twentieth", 5.0),
        Figure("false alarms a month", MONTH_CYCLES * false, ""),
    ]
    subjects = {name: (own, name) for name in wanted or EFFECTS}
    if not wanted:
        subjects |= {f"machine {n}": (machine("development", "stages", True, n), "") for n in range(1, POOL)}
    for number, (name, (other, effect)) in enumerate(subjects.items()):
        cycles = cycles_of(other, strange, 3000 + 100 * seed + number, effect)
        found = values(reference, cycles)
        figures.append(Figure(f"{name}: AUC", area(found, ordinary), ""))
        figures.append(Figure(f"{name}: beyond 1", 100 * float(np.mean(found > 1.0)), "%"))
        figures.append(Figure(f"{name}: delay", delay(reference, cycles), "min"))
    give("familiarity", figures, as_json=as_json)


if __name__ == "__main__":
    main()
