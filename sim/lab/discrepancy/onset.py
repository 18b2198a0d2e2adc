"""Since when an effect acts that did not act before: each one of the catalogue from each cycle on, by its likelihood.

`beginning` sees a gap where the mean error of a cycle steps. What heats at starts, when it shakes or while a pump turns
has no such mean; its heat from a border between two cycles on has a score all the same. The evidence for a beginning is
what the best of these explains beyond all that may have acted all along, and the cycles must agree on it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from sim.effects import DRIFTING_SURROUNDINGS, HeldLaw, VaryingLaw
from sim.lab.discrepancy.diagnosis import GapBeginning
from sim.lab.discrepancy.fitting import (
    CatalogueEntry,
    Fitted,
    automaton_effects,
    net_heat,
    rivals,
    stated_rate,
)
from sim.lab.discrepancy.rules import DecisionRules
from sim.lab.discrepancy.screen import (
    Projector,
    Shape,
    alone,
    candidate_shapes,
    screen_shapes,
    shape_columns,
)
from sim.lab.learning import Indices
from sim.sha import Array

FIRST, BORDERS = 5, 24
"""Borders between cycles at which every shape of every effect is tried, and at most those at which the best shape of
each is; in a longer record the best of all alone is tried at every one."""
CHUNK_SHAPES = 16
"""Shapes whose heats at the knots are held at a time: in a long record each is some megabytes."""
INTERVAL_NATS = 1.92
"""Nats below the best date up to which a date is in its 95 % interval: half the quantile of chi-square."""
MOMENT, LATE = "since", "lag"
"""The parameter of what has a moment of its own from which it grows, and that of what comes late: it has a state."""
DATE, BY_THE_CLOCK = "at", ("period", "length")
"""The parameter that is a date, but for those that come with the clock and have one of the others."""


@dataclass(frozen=True, slots=True)
class _MayBegin:
    """What may begin: its name, the sign that physics allows (0: either), and its heat (n,) degC/s at unit strength;
    where it is in the `reading`, what it adds to that (degC)."""

    name: str
    sign: float
    heat: Array
    reading: bool = False


def find_onset(
    fitted: Fitted, entries: Sequence[CatalogueEntry], roles: Mapping[str, str], least: float, rules: DecisionRules
) -> GapBeginning | None:
    """The cycle with which an effect begins to act; None where none surely does.

    `fitted` has all cycles, and the names that are given; `entries` with the signals of `roles` are tried. `least`
    (degC rms) is what the effect must move beside the model's own parameters.
    """
    record, side = fitted.frame.record, rules.beginning_least_cycles
    cycles = np.unique(record.window_whole)
    starts = np.array([record.runs.time[record.whole == cycle][0] for cycle in cycles])
    borders = np.arange(side, starts.size - side + 1)
    if not borders.size:
        return None
    projector = Projector(fitted)
    every = candidate_shapes(projector, (*entries, *rivals()), roles)
    lasting = tuple(shape for shape in every if _acts_all_along(shape, float(record.runs.time[0])))
    shapes = [shape for shape in lasting if _stateless(shape)]
    begins = _best_of_each(projector, shapes, starts[_evenly(borders, FIRST)])
    gains = np.array([_gains(projector, begins, start) for start in starts[_evenly(borders, BORDERS)]])
    best = begins[int(np.argmax(gains.max(axis=0)))]
    profile = np.array([_gains(projector, [best], start)[0] for start in starts[borders]])
    top = int(np.argmax(profile))
    before, gain = int(borders[top]), float(profile[top])
    # A likelihood ratio of one parameter, at each place that was looked at (Bonferroni).
    looks = borders.size * (len(shapes) + len(begins))
    p = min(float(scipy.stats.chi2.sf(2.0 * gain, 1)) * looks, 1.0)
    if p > rules.beginning_most_p or gain < rules.least_gain_nats:
        return None
    all_along = screen_shapes(projector, lasting, shape_columns(projector, lasting)).gain.max() if lasting else 0.0
    if gain - float(all_along) < rules.margin_nats:
        return None
    column = _onset_columns(projector, [best], starts[before])
    strength, carried = _agreement(projector, column)
    # What the model's own parameters imitate would be fitted away, as where an effect is named.
    left = column[:, 0] - fitted.columns @ np.linalg.lstsq(fitted.columns, column[:, 0], rcond=None)[0]
    if carried < rules.beginning_carried_share * gain or abs(strength) * float(np.sqrt(np.mean(left**2))) < least:
        return None
    running, moves = _phase_shift(fitted, strength * column[:, 0], cycles[before])
    likely = borders[np.flatnonzero(profile >= gain - INTERVAL_NATS)]
    # What begins with a cycle may have begun at any time since the cycle before it did.
    return GapBeginning(
        time=float(starts[before]),
        interval=(float(starts[likely[0] - 1]), float(starts[likely[-1]])),
        before=before,
        after=int(starts.size) - before,
        moves=moves,
        running=running,
        p=p,
        acts=best.name,
    )


def _acts_all_along(shape: Shape, begin: float) -> bool:
    """Whether an effect has no moment, comes with the clock, or is surroundings that drift from `begin` (s) on.

    A cooling that grows less is none: what begins is tried as a heat, which is no match for a loss that is there.
    """
    drifts = shape.entry.name == DRIFTING_SURROUNDINGS and shape.params[DATE] <= begin
    return DATE not in shape.params or drifts or any(name in shape.params for name in BY_THE_CLOCK)


def _stateless(shape: Shape) -> bool:
    """Whether an effect has a name and neither a state nor a course of its own: it may begin at once."""
    entry = shape.entry
    at_once = isinstance(entry.kind.law, HeldLaw | VaryingLaw) and LATE not in shape.params
    return at_once and not entry.rival and MOMENT not in shape.params


def _evenly(borders: Indices, most: int) -> Indices:
    """At most so many of the borders, evenly over all."""
    return np.asarray(borders[np.unique(np.linspace(0, borders.size - 1, min(most, borders.size)).round().astype(int))])


def _best_of_each(projector: Projector, shapes: Sequence[Shape], starts: Array) -> list[_MayBegin]:
    """Of each effect the shape of the greatest gain at some of the `starts`; heat without a signal; and an offset."""
    record, best = projector.fitted.frame.record, dict[str, tuple[float, _MayBegin]]()
    for first in range(0, len(shapes), CHUNK_SHAPES):
        some = [_shape_heat(projector, shape) for shape in shapes[first : first + CHUNK_SHAPES]]
        gains = np.max([_gains(projector, some, start) for start in starts], axis=0)
        for one, gain in zip(some, gains.tolist(), strict=True):
            if one.name not in best or gain > best[one.name][0]:
                best[one.name] = gain, one
    always = np.ones(len(record.runs))
    return [
        *(one for _, one in best.values()),
        _MayBegin("heat while the machine runs", 0.0, record.running),
        _MayBegin("heat at all times", 0.0, always),
        _MayBegin("warmer or cooler surroundings", 0.0, stated_rate(record)),
        _MayBegin("an offset of the sensor", 0.0, always, reading=True),
    ]


def _shape_heat(projector: Projector, shape: Shape) -> _MayBegin:
    """The shape with its heat along the smoothed course."""
    record = projector.fitted.frame.record
    heat = net_heat(record, automaton_effects(shape.with_strength(1.0), record.model), projector.smooth)
    return _MayBegin(shape.entry.name, shape.entry.sign, heat)


def _onset_columns(projector: Projector, begins: Sequence[_MayBegin], start: float) -> Array:
    """(m, c) degC what each does to the windows at unit strength where it acts from `start` (s) on."""
    record = projector.fitted.frame.record
    since = (record.runs.time > start).astype(float)
    return np.column_stack(
        [record.window_means(since) if each.reading else projector.added(each.heat * since) for each in begins]
    )


def _gains(projector: Projector, begins: Sequence[_MayBegin], start: float) -> Array:
    """(c,) nats of each that acts from `start` (s) on, 0 where its sign is not physics or nothing of it is visible."""
    columns = _onset_columns(projector, begins, start)
    return alone(projector, columns, np.array([each.sign for each in begins]))[0]


def _agreement(projector: Projector, column: Array) -> tuple[float, float]:
    """(the likeliest strength, nats of each cycle under the strength that the others give) of a column (m, 1)."""
    cleaned, weighed, _ = projector.clean(column)
    cycle = np.unique(projector.fitted.grid.cycle, return_inverse=True)[1]
    parts = np.bincount(cycle, cleaned[:, 0] * projector.weighed_residual)
    shares = np.maximum(np.bincount(cycle, cleaned[:, 0] * weighed[:, 0]), 0.0)
    total, mass = float(parts.sum()), max(float(shares.sum()), 1e-300)
    others = (total - parts) / np.maximum(mass - shares, 1e-300)
    return total / mass, float(np.sum(parts * others - 0.5 * shares * others**2))


def _phase_shift(fitted: Fitted, course: Array, first: Indices) -> tuple[bool, float]:
    """(whether a course (m,) degC moves the machine more while it runs than at rest, its mean there), from the cycle
    `first` on."""
    record = fitted.frame.record
    running, since = record.window_means(record.running) > 0.5, record.window_whole >= first
    phases = {phase: since & (running == phase) for phase in (True, False)}
    means = {phase: float(np.mean(course[windows])) for phase, windows in phases.items() if windows.any()}
    phase = max(means, key=lambda each: abs(means[each]))
    return phase, means[phase]
