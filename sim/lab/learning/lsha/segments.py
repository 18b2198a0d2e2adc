"""What each segment says about its own parameter, under a given flow: the measurement behind every query.

A segment lies between two events of a trace. With `parameter` entry its temperature goes on from the segment before,
so its readings and the one at its beginning are fitted by X = A x0 + B m + (what the inputs push): two unknowns, of
which m is the parameter. With `resample` entry the temperature jumps at the event, and the mean of the readings is the
parameter. The standard error comes with it: segments have very different lengths.
"""

from dataclasses import dataclass

import numpy as np

from sim.engine import linear_recursion
from sim.lab.learning import FreeRuns, Indices
from sim.sha import Array

MIN_INFORMATION_SHARE = 1e-9
"""A segment tells m if x0 leaves this share of m's information."""


@dataclass(frozen=True, slots=True)
class TraceSegments:
    """N segments that tell their parameter: `value` and `variance` (of its error), its state and its group.

    `place` (N,) is the state of the finest automaton, `group` (N,) the trace (or part of one) that it comes from,
    `readings` (N,) how many it has, `squares` (N,) the sum of squared residuals, `start` (N,) the absolute time.
    `noise` is the standard deviation of a reading about its segment's own fit.
    """

    value: Array
    variance: Array
    place: Indices
    group: Indices
    readings: Indices
    squares: Array
    start: Array
    noise: float


@dataclass(frozen=True, slots=True)
class Motion:
    """(n,) per knot: the affine step under the flow that is assumed, and what inputs add to the target."""

    decay: Array
    pull: Array
    offset: Array


def find_next_stays(runs: FreeRuns) -> tuple[Indices, Indices]:
    """(stay, place) of each knot after the events of its instant: those of the step that follows, where one does."""
    follows = np.append((runs.run[1:] == runs.run[:-1]), False)
    rows = np.arange(len(runs)) + follows
    return runs.stay[rows], runs.place[rows]


def levels(runs: FreeRuns, group: Indices) -> TraceSegments:
    """The segments' mean readings: the parameter of `resample` entry under a constant flow."""
    stay, place = find_next_stays(runs)
    known = np.isfinite(runs.reading)
    stay, place, reading = stay[known], place[known], runs.reading[known]
    _, first, inverse = np.unique(stay, return_index=True, return_inverse=True)
    count = np.bincount(inverse)
    mean = np.asarray(np.bincount(inverse, reading) / count, dtype=float)
    squares = np.asarray(np.bincount(inverse, (reading - mean[inverse]) ** 2), dtype=float)
    noise = _noise(squares, np.asarray(count - 1, dtype=float))
    return TraceSegments(
        value=mean,
        variance=noise**2 / count,
        place=place[first],
        group=group[known][first],
        readings=count,
        squares=squares,
        start=runs.time[known][first],
        noise=noise,
    )


def parameters(runs: FreeRuns, group: Indices, motion: Motion, unit: float) -> TraceSegments:
    """The segments' parameters by least squares with a free start temperature: for `parameter` entry.

    `unit` is a variance in the parameter's unit squared; segments whose own is a million times that say nothing and are
    left out.
    """
    value, information, squares, count, begin = stay_fits(runs, motion)
    good = np.isfinite(value) & (count >= 2)
    noise = _noise(squares[good], count[good] - 2)
    variance = np.where(good, noise**2 / np.where(good, information, 1.0), np.inf)
    good &= variance < 1e6 * unit
    return TraceSegments(
        value=value[good],
        variance=variance[good],
        place=runs.place[begin][good],
        group=group[begin][good],
        readings=count[good].astype(np.intp),
        squares=squares[good],
        start=(runs.time[begin] - runs.dt[begin])[good],
        noise=noise,
    )


def stay_fits(runs: FreeRuns, motion: Motion) -> tuple[Array, Array, Array, Array, Indices]:
    """Of every stay: m by least squares (NaN where it is not told), its information, the sum of squares that is left,
    the number of readings, and the stay's first knot."""
    begins = (np.diff(runs.stay, prepend=-1) != 0) | runs.first
    # Decay 0 where a stay begins: one recursion over all knots starts anew in each. `start` and `mode` are the courses
    # that a unit of a stay's start temperature and of its m would make.
    inside = np.where(begins, 0.0, motion.decay)
    start = linear_recursion(inside, np.where(begins, motion.decay, 0.0), 0.0)
    mode = linear_recursion(inside, motion.pull, 0.0)
    pushed = linear_recursion(inside, motion.pull * motion.offset, 0.0)
    stay, begin = np.cumsum(begins) - 1, np.flatnonzero(begins)
    entry = begin[~runs.first[begin]]  # stays that go on from the knot before: its reading is at their beginning
    known, before = np.isfinite(runs.reading), np.isfinite(runs.reading[entry - 1])
    of = np.concatenate([stay[known], stay[entry][before]])
    a = np.concatenate([start[known], np.ones(int(before.sum()))])
    b = np.concatenate([mode[known], np.zeros(int(before.sum()))])
    y = np.concatenate([(runs.reading - pushed)[known], runs.reading[entry - 1][before]])
    # Readings are taken relative to the stay's first one, or their squares would drown the residuals.
    size = begin.size
    origin = np.zeros(size)
    origin[of[::-1]] = y[::-1]
    y = y - a * origin[of]
    rows = (a * a, a * b, b * b, a * y, b * y, y * y, np.ones(of.size))
    ss, sm, mm, sy, my, yy, count = (np.asarray(np.bincount(of, row, size), dtype=float) for row in rows)
    # The normal equations of all stays at once, the start eliminated; a stay that does not tell both divides by 0.
    with np.errstate(divide="ignore", invalid="ignore"):
        information = mm - sm**2 / ss
        value = np.where(information > MIN_INFORMATION_SHARE * mm, (my - sm * sy / ss) / information, np.nan)
        squares = np.maximum(yy - sy**2 / ss - np.where(np.isnan(value), 0.0, information * value**2), 0.0)
    return value, information, squares, count, begin


def _noise(squares: Array, freedom: Array) -> float:
    """The pooled standard deviation of readings about their segment's fit: the median over segments, 1e-6 at least.

    Segments without a degree of freedom say nothing; the median makes the few bad ones harmless (a chi-square with f
    degrees of freedom has its median near f - 2/3).
    """
    use = freedom > 0
    if not use.any():
        return 1e-3
    f = freedom[use].astype(float)
    each = squares[use] / (f * (1.0 - 2.0 / (9.0 * f)) ** 3)
    order = np.argsort(each)
    share = np.cumsum(f[order])
    middle = order[int(np.searchsorted(share, share[-1] / 2.0))]
    return float(max(np.sqrt(each[middle]), 1e-6))
