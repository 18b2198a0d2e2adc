"""A fleet: what each of many machines has of its own in the model of their type, and which of them stand out where.

Each machine is judged by its own runs alone, so that ten thousand cost ten thousand times as much as one, and can be
judged anywhere.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite

import numpy as np
import scipy

from sim.engine import mean_outputs, open_loop_schedule, readings
from sim.lab.learning.correction import (
    CorrectionFit,
    correction_runs,
    drop_limits,
    fitted_readings,
    jackknife_error,
    learn_correction,
    robust_fit,
)
from sim.lab.learning.machines import MAX_OFFSET_ERROR_DEGC, MIN_OFFSET_ERROR_DEGC
from sim.lab.learning.runs import first_switch
from sim.lab.learning.structure import LearningError, contexts, labels
from sim.sha import RELAXING_FLOWS, Alphabet, Array, Correction, Model, Trace

MIN_FLEET_MACHINES = 5
"""Machines below which none is said to stand out: what the others differ by is not known then."""
FALSE_FINDING_CHANCE = 0.01
"""The chance, over the whole fleet and all groups, that any machine is said to stand out though all are alike."""
MIN_PULL_DEGC = 0.1
"""degC (root mean square) by which a degree in the targets of a group must move the readings: less tells nothing."""


@dataclass(frozen=True, slots=True)
class GroupTargets:
    """By how much (degC) a machine's targets in a group of locations lie off its type's, with its standard `error`.

    The error comes from so many `runs`.
    """

    offset: float
    error: float
    runs: int


@dataclass(frozen=True, slots=True)
class StandsOut:
    """Where a machine stands out: its targets in `group` lie `beyond` (degC) the mean of the others'.

    The others' offsets differ by `differ` (degC, standard deviation). `chance`: of any as far out, were all alike.
    """

    group: str
    beyond: float
    differ: float
    chance: float


def own_targets(model: Model, traces: Sequence[Trace]) -> CorrectionFit:
    """By how much (degC) the targets of one machine lie off those of its type's `model`: `correction.offset`.

    Off by b, an open-loop run is T(t) + b (1 - D(t)): the same course as with a correction T' = T + b, so that its
    regression and its jackknife over runs serve (`learn_correction`). Raises LearningError where fewer than two runs
    are left to learn from, and where they do not tell it.
    """
    (fit,) = learn_correction(model, traces, forms=("offset",)).fits
    if not np.isfinite(fit.offset_error):
        raise LearningError(f"its runs do not tell its targets: {fit.reason}")
    return fit


def target_groups(alphabet: Alphabet) -> dict[str, tuple[str, ...]]:
    """The groups of locations in which a machine may be odd: at rest, running, and each location in which it runs.

    By the switch's label or the location's name. Without a switch each location is a group of its own.
    """
    switch = first_switch(alphabet)
    known = {name: context for name, context in contexts(alphabet).items() if None not in context}
    if switch is None:
        return {name: (name,) for name in known}
    place = alphabet.channels.index(switch)
    rest, runs = (tuple(name for name, context in known.items() if context[place] == on) for on in (0, 1))
    off, on = labels(switch)
    single = {} if len(runs) < 2 else {name: (name,) for name in runs}
    return {off: rest, on: runs} | single


def grouped_targets(model: Model, traces: Sequence[Trace]) -> dict[str, GroupTargets]:
    """By how much one machine's targets lie off those of its type's `model`, by group of locations (`target_groups`).

    An open-loop run is linear in its targets: with those of group g higher by b_g it is T(t) + sum b_g C_g(t), and C_g
    is the course with them a degree higher less that of the model. Each group is fitted together with all other
    locations, those at rest and those in which it runs apart, so that what is odd elsewhere is not taken for it.
    Robust, with a jackknife over runs. A group of which the runs tell nothing is left out.
    """
    alphabet, sha = model.alphabet, model.sha
    groups = target_groups(alphabet)
    runs, _ = correction_runs(traces, model.temperature)
    relaxing = {location.name for location in sha.locations if location.flow.kind in RELAXING_FLOWS}
    rows = [_pulls(replace(model, correction=Correction()), run, relaxing) for run in runs]
    switch = first_switch(alphabet)
    sides = list(groups.values()) if switch is None else [groups[label] for label in labels(switch)]
    found = {}
    for name, group in groups.items():
        others = [[each for each in side if each not in group] for side in sides]
        told = _group_fit(rows, [list(group), *others])
        if told is not None:
            found[name] = told
    return found


def _pulls(bare: Model, run: Trace, relaxing: Collection[str]) -> tuple[Array, dict[str, Array]]:
    """(n,) what a run's readings lie off the model's course, and what a degree in a location's targets adds to it."""
    free = drop_limits(bare)
    times, values = readings(run, free.temperature)
    steps = open_loop_schedule(free, run, "resync")
    keep = fitted_readings(times.size)
    row = np.searchsorted(steps.times, times[keep], side="right") - 1
    place = {location.name: number for number, location in enumerate(free.sha.locations)}
    been = [name for name in sorted(relaxing) if np.any(steps.location == place[name])]
    degrees = [0.0, *((steps.location == place[name]).astype(float) for name in been)]
    mean, *higher = mean_outputs(steps, [(float(values[0]), degree) for degree in degrees])
    pulls = {name: (course - mean)[row] for name, course in zip(been, higher, strict=True)}
    return values[keep] - mean[row], {name: pull for name, pull in pulls.items() if np.any(pull)}


def _group_fit(
    rows: Sequence[tuple[Array, Mapping[str, Array]]], parts: Sequence[Sequence[str]]
) -> GroupTargets | None:
    """The offset of the first of `parts` (locations each), fitted together with those of the others; None if untold."""
    left = [rest for rest, _ in rows]
    columns = [
        [sum((pulls[name] for name in part if name in pulls), np.zeros(rest.size)) for rest, pulls in rows]
        for part in parts
    ]
    # What the machine never was in has no column.
    columns = [part for number, part in enumerate(columns) if not number or any(np.any(column) for column in part)]
    if not rows or np.sqrt(np.mean(np.concatenate(columns[0]) ** 2)) < MIN_PULL_DEGC:
        return None
    everything = range(len(rows))
    fits = [
        robust_fit(
            [np.concatenate([part[place] for place in everything if place != out]) for part in columns],
            np.concatenate([left[place] for place in everything if place != out]),
        )
        for out in (*everything, None)
        if len(rows) > 1
    ]
    if not fits or any(fit is None for fit in fits):
        return None
    *parted, whole = np.array(fits)
    error = max(float(jackknife_error(np.array(parted))[0]), MIN_OFFSET_ERROR_DEGC)
    return (
        GroupTargets(float(whole[0]), error, len(rows)) if isfinite(error) and error < MAX_OFFSET_ERROR_DEGC else None
    )


def find_outliers(fleet: Mapping[str, Mapping[str, GroupTargets]]) -> dict[str, tuple[StandsOut, ...]]:
    """The machines whose targets stand out of the others', and where, by their targets by machine and group.

    FALSE_FINDING_CHANCE is shared evenly among the groups that MIN_FLEET_MACHINES machines tell of; in each the
    machines are judged by Holm's step-down (1979). One that stands out is not among the others when the next is judged,
    since two would else hide one another. The least likely machine first, of each the least likely group.
    """
    groups = sorted({group for own in fleet.values() for group in own})
    told = {group: {name: own[group] for name, own in fleet.items() if group in own} for group in groups}
    told = {group: machines for group, machines in told.items() if len(machines) >= MIN_FLEET_MACHINES}
    found: dict[str, list[StandsOut]] = {}
    for group, machines in told.items():
        left = dict(machines)
        while len(left) >= MIN_FLEET_MACHINES:
            beyond, differ, chances = _held_against_others(list(left.values()))
            place = int(np.argmin(chances))
            chance = min(1.0, float(chances[place]) * len(left) * len(told))
            if chance > FALSE_FINDING_CHANCE:
                break
            name = list(left)[place]
            found.setdefault(name, []).append(StandsOut(group, float(beyond[place]), float(differ[place]), chance))
            del left[name]
    by_chance = {name: tuple(sorted(each, key=lambda one: one.chance)) for name, each in found.items()}
    return dict(sorted(by_chance.items(), key=lambda pair: pair[1][0].chance))


def _held_against_others(machines: Sequence[GroupTargets]) -> tuple[Array, Array, Array]:
    """Each (n,): how far (degC) a machine lies beyond the others' mean, how much those differ, and the chance of it.

    The chance is two-sided, by Student's t. The scatter of the others is what they differ by together with their own
    errors; of the machine the variance is what they differ by beyond their errors, and its own error; never less than
    the others' scatter, since an error from few runs may come out too small. Degrees of freedom by Satterthwaite (1946)
    from those of the scatter and of the error, never more than the scatter's.
    """
    offset, square = (np.array(each) for each in zip(*((one.offset, one.error**2) for one in machines), strict=True))
    runs, count = np.array([one.runs for one in machines]), len(machines)
    # All machines weigh the same: weights from errors of a few runs each would be as uncertain as these are.
    mean, error = ((values.sum() - values) / (count - 1) for values in (offset, square))
    centred = offset - offset.mean()
    scatter = ((centred**2).sum() - centred**2 * count / (count - 1)) / (count - 2)
    scatter = np.maximum(scatter, MIN_OFFSET_ERROR_DEGC**2)
    between = np.maximum(scatter - error, 0.0)
    of_mean = scatter / (count - 1)
    variance = np.maximum(between + square, scatter) + of_mean
    freedom = (between + of_mean + square) ** 2 / (
        (between + of_mean) ** 2 / (count - 2) + square**2 / np.maximum(runs - 1, 1)
    )
    distance = np.abs(offset - mean) / np.sqrt(variance)
    chance = 2.0 * scipy.special.stdtr(np.minimum(freedom, count - 2), -distance)
    return offset - mean, np.sqrt(scatter), chance
