"""The hypothesis-test query: whether two sets of segments have the same mean parameter.

A segment's parameter is measured with an error of known variance v, and differs from segment to segment by a scatter of
variance tau^2. Each counts with the weight 1/(tau^2 + v). The mean's variance is the sandwich estimate (Huber 1967),
which holds whatever the scatter is; so Welch's statistic with Satterthwaite's degrees of freedom is a two-sample test
that takes the errors of measurement into account. All sums are additive, so merged sets need no second look at the
data. Below `n_min` segments the scatter of the whole is assumed instead of the set's own.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf, nan, sqrt
from typing import NamedTuple

import numpy as np
import scipy

from sim.lab.learning import Indices, huber_scale
from sim.lab.learning.lsha.segments import TraceSegments
from sim.sha import Array, Mask

MEDIAN_CHI_SQUARE = 0.454936
"""The median of a chi-square with one degree of freedom."""
LEAST_TWICE, LEAST_COMPANY = 8, 0.02
"""Segments beyond the first of their classes from which these tell the scatter, and the share of all that are not alone
from which they tell whether more of a word explains anything."""
MIN_WORD_SHARE = 0.05
"""The share of what the last move leaves unexplained that more of the word has to explain."""
KNOWN_VARIANCE_DOF = 1e6
"""Degrees of freedom that stand for a known variance."""


Sums = tuple[float, float, float, float, float, float, float]
"""Over a set of segments, m relative to a common centre: count, w, w m, w^2, w^2 m, w^2 m^2, w^2 v."""


@dataclass(slots=True)
class PooledEvidence:
    """What a set of segments says: their sums, and the mean that follows (NaN without any segment).

    `variance` is that of the mean, with `freedom` degrees of freedom: the sandwich estimate from `n_min` segments on,
    below that what the common scatter makes it. Nobody changes one; not frozen, because that takes three times as long
    to make, and each merge that is tried makes many.
    """

    sums: Sums
    n_min: int
    mean: float
    variance: float
    freedom: float

    @property
    def count(self) -> float:
        """How many segments there are."""
        return self.sums[0]

    @property
    def cautious(self) -> "PooledEvidence":
        """The same, the common scatter being as uncertain as that of `n_min` segments: this set's may be another."""
        return replace(self, freedom=min(self.freedom, self.n_min - 1.0))

    def merge(self, other: "PooledEvidence") -> "PooledEvidence":
        """The evidence of both sets, each segment counted once."""
        a, b = self.sums, other.sums
        sums = (a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4], a[5] + b[5], a[6] + b[6])
        return pool_sums(sums, self.n_min)

    def subtract(self, part: "PooledEvidence") -> "PooledEvidence":
        """The evidence of the segments that are not in `part` of this set."""
        a, b = self.sums, part.sums
        sums = (a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3], a[4] - b[4], a[5] - b[5], a[6] - b[6])
        return pool_sums(sums, self.n_min)


def pool_sums(sums: Sums, n_min: int) -> PooledEvidence:
    """The evidence of a set of segments with these sums."""
    count, weight, total, square, square_total, square_square, error = sums
    if not count:
        return PooledEvidence(sums, n_min, nan, inf, KNOWN_VARIANCE_DOF)
    mean = total / weight
    # Kish's effective size: as many segments of equal weight would say as much.
    effective = weight * weight / square
    if count < n_min:
        return PooledEvidence(sums, n_min, mean, 1.0 / weight, KNOWN_VARIANCE_DOF)
    # sum w^2 (m - mean)^2 multiplied out, so that it follows from sums that can be added up. The measurement errors are
    # its floor: a few segments that agree by chance do not know their mean better than they were measured.
    sandwich = square_square - 2.0 * mean * square_total + mean * mean * square
    # Where few segments carry the weight, the degrees of freedom that are missing to those of n_min are the common
    # scatter's (Smyth 2004): the own scatter of two is hardly known, and a test by it would tell nothing apart.
    missing = max(n_min - effective, 0.0)
    freedom = effective - 1.0 + missing
    own = (sandwich * effective + missing * weight) / freedom
    return PooledEvidence(sums, n_min, mean, max(own, error) / (weight * weight), freedom)


class WelchTest(NamedTuple):
    """The answer of a hypothesis-test query: Welch's t beyond `delta`, its degrees of freedom and p (two-sided)."""

    statistic: float
    freedom: float
    p: float
    difference: float


def same_distribution(first: PooledEvidence, second: PooledEvidence, delta: float) -> WelchTest:
    """Whether the means of two sets differ by more than `delta` (in the parameter's unit); both have segments."""
    difference = second.mean - first.mean
    beyond = abs(difference) - delta
    if beyond <= 0.0:
        return WelchTest(0.0, KNOWN_VARIANCE_DOF, 1.0, difference)
    whole = first.variance + second.variance
    statistic = beyond / sqrt(whole)
    freedom = whole * whole / (first.variance**2 / first.freedom + second.variance**2 / second.freedom)
    return WelchTest(statistic, freedom, 2.0 * float(scipy.special.stdtr(freedom, -statistic)), difference)


@dataclass(frozen=True, slots=True, kw_only=True)
class SegmentSample:
    """Segments ready to be pooled: weights, values relative to `centre`, and the scatter that was assumed.

    `scatter` is the robust standard deviation of the parameter from segment to segment of one state, `spread` that of
    all segments together (both in the parameter's unit). `longer` is the share of what the last move leaves unexplained
    that more of the word explains.
    """

    segments: TraceSegments
    weight: Array
    value: Array
    centre: float
    scatter: float
    spread: float
    longer: float

    def pool_classes(self, of_state: Indices, size: int, n_min: int, use: Mask | None = None) -> list[PooledEvidence]:
        """The evidence of each of `size` classes; `of_state` gives the class of each state, `use` (N,) leaves out."""
        rows = np.ones(self.value.size, dtype=bool) if use is None else use
        place, w, m, v = (
            of_state[self.segments.place[rows]],
            self.weight[rows],
            self.value[rows],
            self.segments.variance[rows],
        )
        w2 = w * w
        columns = (np.ones_like(w), w, w * m, w2, w2 * m, w2 * m * m, w2 * v)
        sums = np.stack([np.bincount(place, column, size) for column in columns], axis=1)
        return [pool_sums((*row,), n_min) for row in sums.tolist()]


def weigh_segments(segments: TraceSegments, alike: Sequence[Indices]) -> SegmentSample:
    """The segments with weights: the scatter is the one that makes the residuals about their classes' means typical.

    `alike` (each (S,)) puts states together that are believed to resemble each other, the finest first and those of the
    same last move last.
    """
    value, variance = segments.value, segments.variance
    *finer, last = (classes[segments.place] for classes in alike)
    scatter, longer = _scatter(value, variance, last), 0.0
    # Of the finer classes that count by which the others of a segment's class foretell it better than those of the same
    # last move do: elsewhere the last move is all that matters, and a few words that all traces begin with are not
    # typical of what follows.
    weight = 1.0 / (scatter**2 + variance)
    rest, best = _alone(value, weight, last), 0.0
    for place in finer:
        error = _alone(value, weight, place)
        company, both = np.isfinite(error), np.isfinite(error) & np.isfinite(rest)
        if company.sum() - np.unique(place[company]).size < LEAST_TWICE or both.sum() < LEAST_TWICE:
            continue
        explained = 1.0 - (huber_scale(error[both]) / huber_scale(rest[both])) ** 2
        if explained > max(best, MIN_WORD_SHARE):
            best, scatter = explained, _scatter(value, variance, place)
        if company.mean() >= LEAST_COMPANY:
            longer = max(longer, explained)
    weight = 1.0 / (scatter**2 + variance)
    centre = float(np.average(value, weights=weight))
    spread = float(np.sqrt(np.average((value - centre) ** 2, weights=weight)))
    return SegmentSample(
        segments=segments,
        weight=weight,
        value=value - centre,
        centre=centre,
        scatter=scatter,
        spread=max(spread, 1e-12),
        longer=longer,
    )


def _scatter(value: Array, variance: Array, place: Indices) -> float:
    """tau by which half of (m - mean)^2 / (tau^2 + v) lie below a chi-square's median, over classes with 2 or more."""
    # Residuals about a state's own mean, by measurement errors alone: the scatter that would weigh them is what is
    # looked for. A mean of n takes 1/n of each square with it, which n / (n - 1) gives back.
    _, inverse, count = np.unique(place, return_inverse=True, return_counts=True)
    precision = 1.0 / variance
    mean = np.bincount(inverse, precision * value) / np.bincount(inverse, precision)
    several = count[inverse] >= 2
    floor = 0.1 * float(np.sqrt(np.median(variance)))
    if several.sum() < 3:
        return max(float(np.std(value)), floor)
    shrunk = count[inverse][several] / (count[inverse][several] - 1.0)
    squares, v = (value - mean[inverse])[several] ** 2 * shrunk, variance[several]
    # By bisection: the median falls as tau grows. A median, because a few segments may belong to another location.
    low, high = 0.0, float(np.sqrt(squares.max())) + floor
    for _ in range(40):
        middle = 0.5 * (low + high)
        if np.median(squares / (middle**2 + v)) > MEDIAN_CHI_SQUARE:
            low = middle
        else:
            high = middle
    return max(high, floor)


def _alone(value: Array, weight: Array, place: Indices) -> Array:
    """(N,) each segment's value less the mean of the others of its class; NaN where there are none."""
    total, count = np.bincount(place, weight), np.bincount(place)
    product = np.bincount(place, weight * value)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (product[place] - weight * value) / (total[place] - weight)
    return np.where(count[place] >= 2, value - mean, np.nan)


def segment_scatter(sample: SegmentSample, rows: Sequence[bool] | Mask) -> tuple[float, float, float]:
    """(mean, its standard error, scatter between segments apart from measurement error) of the chosen segments.

    The scatter is the moment estimate of DerSimonian & Laird (1986) with the sample's weights, drawn towards the
    sample's own scatter as if one more segment had shown that.
    """
    use = np.asarray(rows)
    w, m, v = sample.weight[use], sample.value[use], sample.segments.variance[use]
    mean = float(np.average(m, weights=w))
    n = m.size
    total = float(np.sum(w * (m - mean) ** 2)) * (n / (n - 1.0) if n > 1 else 1.0)
    own = max((total - float(np.sum(w * v))) / float(w.sum()), 0.0) if n > 1 else sample.scatter**2
    scatter = float(np.sqrt((n * own + sample.scatter**2) / (n + 1.0)))
    error = float(np.sqrt(np.sum(w**2 * (scatter**2 + v)))) / float(w.sum())
    return mean + sample.centre, error, scatter
