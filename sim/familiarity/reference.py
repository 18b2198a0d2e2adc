"""The law of a training set's cycles, and how far from it another one is.

Four distances, since each is blind where another sees. Mahalanobis' with a covariance shrunk after Ledoit and Wolf
(2004) sees what lies outside, a kernel density (Gaussian, Scott's bandwidth, on whitened points) what lies between the
kinds of cycles that there are. Both take a feature as it is; of a temperature that says little, since load and time
move it by far more than another machine would. So it is held against the temperature that the training had after such
an hour (least squares on load, running and temperature before), at the point and on average over the cycle so far.

All are counted in units of what cycles held out have at that age: strangeness 1 is as strange as the strangest
twentieth of the training's own cycles, each judged by the others.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil, nan
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sim.familiarity.features import COLUMNS, FEATURES, HISTORY
from sim.sha import Array

MIN_CYCLES = 8
"""Cycles below which nothing can be said of what is usual."""
FOLDS = 10
MAX_CENTRES = 400
"""Points that the density is made of: evenly from all, more would only cost time."""
SIMILAR_DISTANCE = 0.5
"""Root mean square over the whitened features, in standard deviations, within which two cycles are alike."""
USUAL_SHARE = 0.95
"""The share of the training's cycles that are not strange."""
COMMON_SHARE = 0.8
"""The share of cycles within the scale of one distance at one age. It only weighs them up: the limit itself is set on
the greatest of all, and sixteen scales from so far out in the tail would fit the very cycles that set it."""
AGE_LIMITS_S = (1800.0, 3600.0, 7200.0)
"""Seconds of a cycle's age at which another scale of the distances begins."""
MIN_SCALES = (0.1, 0.1, 1.0, 0.5)
"""The least scale of each distance: a degree more than expected is not strange, however exact the training was."""
MEAN_PRIOR_POINTS = 12
"""Points (an hour) that a cycle's mean excess is weighed down by: the first ones alone shall not make it."""
RIDGE = 1e-3

Places = NDArray[np.intp]
StrangeKind = Literal["", "above", "below", "together", "warmer", "colder"]


@dataclass(frozen=True, slots=True)
class StrangeThing:
    """What is strange of a point, for people. `above` and `below` the training's extreme: one of `features`, its value
    and that `bound`, both as they are told. `together`: two features that the training did not have together, without
    a bound. `warmer` and `colder`: the degrees by which it is so than training after such an hour. "": nothing."""

    kind: StrangeKind = ""
    features: tuple[str, ...] = ()
    values: tuple[float, ...] = ()
    bound: float | None = None


@dataclass(frozen=True, slots=True)
class Strangeness:
    """How strange a cycle is: `value` (1: as the strangest twentieth held out), the moment (s) at which it is, and what
    is strange. `p` is the share of cycles held out that were at least as strange."""

    value: float
    p: float
    time: float
    thing: StrangeThing


@dataclass(frozen=True, slots=True)
class ExcessSoFar:
    """Of a cycle so far: at how many `points` the temperature was held against the expected one, and the `total`."""

    points: int = 0
    total: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _PointLaw:
    """The law of points, not calibrated: see FamiliarityReference."""

    features: tuple[str, ...]
    mean: Array
    scale: Array
    whitening: Array
    centres: Array
    peak: float
    low: Array
    high: Array
    expectation: Array

    def own(self, points: Array) -> Array:
        """(P, F) the law's own features; the mean where one is not known."""
        columns = points[:, [COLUMNS.index(name) for name in self.features]]
        return np.where(np.isfinite(columns), columns, self.mean)

    def excess(self, points: Array) -> Array:
        """(P,) degC that a temperature is above the one that is expected after such an hour; NaN where not known."""
        if not self.expectation.size:
            return np.full(len(points), nan)
        return np.asarray(points[:, COLUMNS.index("temperature")] - _regressors(points) @ self.expectation)

    def distances(self, points: Array, before: ExcessSoFar = ExcessSoFar()) -> Array:
        """(P, 4) the distances of a cycle's points that follow on `before`: Mahalanobis' and the density's, sqrt(2
        log(peak / density)), both without unit; the excess and its mean over the cycle so far (degC)."""
        white = (self.own(points) - self.mean) / self.scale @ self.whitening
        rare = np.sqrt(2.0 * np.maximum(self.peak - _log_density(white, self.centres), 0.0))
        excess, lasting = self._mean_excess(points, before)
        return np.column_stack([np.sqrt(np.sum(white**2, axis=1)), rare, np.abs(excess), np.abs(lasting)])

    def _mean_excess(self, points: Array, before: ExcessSoFar) -> tuple[Array, Array]:
        """(P,) the excess, 0 where it is not known, and its mean over the cycle so far, weighed down by
        MEAN_PRIOR_POINTS points."""
        excess = self.excess(points)
        known = np.isfinite(excess)
        excess = np.where(known, excess, 0.0)
        return excess, (before.total + np.cumsum(excess)) / (MEAN_PRIOR_POINTS + before.points + np.cumsum(known))


@dataclass(frozen=True, slots=True, kw_only=True)
class FamiliarityReference(_PointLaw):
    """The law of the points of a training set. Arrays are over the `features` (F,) that all its cycles have.

    `mean` and `scale` standardise, `whitening` (F, F) makes the shrunk covariance the identity, `centres` (C, F) are
    whitened points of the density and `peak` its greatest logarithm among them. `low` and `high` are the training's
    extremes. `expectation` (R,) are the coefficients of the expected temperature, none where the training does not
    have all that it takes. `scales` (ages, 4) is what strangeness 1 is in each distance at each age; `held_out` (n,)
    the strangeness of the training's cycles, ascending.
    """

    scales: Array
    held_out: Array

    def strangeness(self, points: Array, times: Array) -> Strangeness:
        """Of a cycle with `points` (P, C of COLUMNS) at `times` (P,): that of its strangest point.

        Points at which a feature is not known count with the mean of it: what is not measured is not strange.
        """
        if not len(points):
            return Strangeness(0.0, 1.0, nan, StrangeThing())
        distances = self.distances(points) / self.scales[_ages(points)]
        worst = int(np.argmax(distances.max(axis=1)))
        _, lasting = self._mean_excess(points, ExcessSoFar())
        return self._rate_point(points[worst], float(times[worst]), distances[worst], float(lasting[worst]))

    def follow(self, point: Array, time: float, before: ExcessSoFar) -> tuple[Strangeness, ExcessSoFar]:
        """That of one more point (C,) of a growing cycle, and what the next one follows on."""
        points = point[None, :]
        distances = self.distances(points, before) / self.scales[_ages(points)]
        excess, lasting = self._mean_excess(points, before)
        known = int(np.isfinite(self.excess(points))[0])
        after = ExcessSoFar(before.points + known, before.total + float(excess[0]))
        return self._rate_point(point, time, distances[0], float(lasting[0])), after

    def _rate_point(self, point: Array, time: float, distances: Array, lasting: float) -> Strangeness:
        value = float(distances.max())
        p = (1 + np.count_nonzero(self.held_out >= value)) / (self.held_out.size + 1)
        which = int(np.argmax(distances))
        excess = lasting if which == 3 else float(self.excess(point[None, :])[0])
        return Strangeness(value, float(p), time, self._warmth(excess) if which >= 2 else self._thing(point))

    def are_similar(self, points: Array, others: Array) -> bool:
        """Whether two cycles (P, C) and (Q, C) are: their mean points lie within SIMILAR_DISTANCE of one another."""
        if not len(points) or not len(others):
            return False
        apart = self.own(points).mean(axis=0) - self.own(others).mean(axis=0)
        return bool(np.mean((apart / self.scale @ self.whitening) ** 2) < SIMILAR_DISTANCE**2)

    @staticmethod
    def _warmth(excess: float) -> StrangeThing:
        return StrangeThing("warmer" if excess > 0 else "colder", (), (abs(excess),))

    def _thing(self, point: Array) -> StrangeThing:
        """The feature that is farthest outside of the training's extremes, or the two that make the combination."""
        own = self.own(point[None, :])[0]
        beyond = np.maximum(own - self.high, self.low - own) / self.scale
        place = int(np.argmax(beyond))
        if beyond[place] > 0:
            above = own[place] > self.high[place]
            name = self.features[place]
            shown = FEATURES[name].shown
            bound = float((self.high if above else self.low)[place]) * shown
            return StrangeThing("above" if above else "below", (name,), (float(own[place]) * shown,), bound)
        # Shares of the squared distance, feature by feature: z (P z) sums to it.
        z = (own - self.mean) / self.scale
        share = z * (self.whitening @ (self.whitening.T @ z))
        pair = np.argsort(-share)[:2].tolist()
        names = tuple(self.features[place] for place in pair)
        values = tuple(float(own[place]) * FEATURES[self.features[place]].shown for place in pair)
        return StrangeThing("together", names, values)

    def as_plain(self) -> dict[str, Any]:
        """All of it as plain values for JSON."""
        plain: dict[str, Any] = {name: getattr(self, name).tolist() for name in _ARRAYS}
        return {"features": list(self.features), **plain, "peak": self.peak}


_ARRAYS = ("mean", "scale", "whitening", "centres", "low", "high", "expectation", "scales", "held_out")


def parse_reference(plain: Mapping[str, Any]) -> FamiliarityReference:
    """What `as_plain` gave. Raises KeyError, TypeError or ValueError for anything else, also for unknown features."""
    features = tuple(str(name) for name in plain["features"])
    if unknown := set(features) - set(FEATURES):
        raise ValueError(f"the feature {min(unknown)!r} is unknown")
    arrays: dict[str, Array] = {name: np.array(plain[name], dtype=float) for name in _ARRAYS}
    size = len(features)
    shapes = {"mean": (size,), "scale": (size,), "whitening": (size, size), "low": (size,), "high": (size,)}
    shapes |= {"scales": (len(AGE_LIMITS_S) + 1, len(MIN_SCALES))}
    if any(arrays[name].shape != shape for name, shape in shapes.items()) or arrays["centres"].shape[1:] != (size,):
        raise ValueError("its arrays do not have one place a feature")
    if arrays["expectation"].shape not in ((0,), (_REGRESSOR_COUNT,)):
        raise ValueError(f"what a temperature is expected by has not {_REGRESSOR_COUNT} coefficients")
    if not (arrays["scales"] > 0).all() or not (arrays["scale"] > 0).all():
        raise ValueError("its scales are not above 0")
    return FamiliarityReference(features=features, **arrays, peak=float(plain["peak"]))


def fit_reference(cycles: Sequence[Array], groups: Sequence[str] | None = None) -> FamiliarityReference:
    """The law of cycles, each (P, C of COLUMNS), in the order of time. It is calibrated on cycles that are held out.

    `groups` are their machines: with three at least each is held out in turn, else tenths of the cycles are, each in
    one piece: cycles of one day share its weather, and one judged by its neighbours would look too usual. Cycles
    without a point do not count. Raises ValueError with fewer than MIN_CYCLES, or where they have no feature in
    common.
    """
    pairs = [(each, "" if groups is None else groups[place]) for place, each in enumerate(cycles) if len(each)]
    if len(pairs) < MIN_CYCLES:
        raise ValueError(f"{len(pairs)} cycles do not tell what is usual; it takes {MIN_CYCLES}")
    own = [each for each, _ in pairs]
    known = np.asarray(np.isfinite(np.vstack(own)).all(axis=0))
    features = tuple(name for name in FEATURES if known[COLUMNS.index(name)])
    if not features:
        raise ValueError("the cycles have no feature in common")
    expected = all(known[COLUMNS.index(name)] for name in ("temperature", *HISTORY))
    machines = sorted({name for _, name in pairs})
    if len(machines) >= 3:
        fold = np.array([machines.index(name) for _, name in pairs])
    else:
        fold = np.arange(len(own)) * min(FOLDS, len(own)) // len(own)
    distances: list[Array] = [np.empty((0, len(MIN_SCALES)))] * len(own)
    for held in range(int(fold.max()) + 1):
        rest = _fit_law(features, [each for each, number in zip(own, fold, strict=True) if number != held], expected)
        for place in np.flatnonzero(fold == held).tolist():
            distances[place] = rest.distances(own[place])
    scales, held_out = _calibrate(distances, [_ages(each) for each in own])
    law = _fit_law(features, own, expected)
    return FamiliarityReference(
        **{name: getattr(law, name) for name in _PointLaw.__slots__}, scales=scales, held_out=np.sort(held_out)
    )


def _calibrate(distances: Sequence[Array], ages: Sequence[Places]) -> tuple[Array, Array]:
    """((ages, 4) scales, (n,) strangeness of the cycles): each age's own quantile, then the limit of the greatest.

    Several distances at several ages are each beyond their own limit in a twentieth of the cycles, and one of them in
    more: so the limit is one of the greatest, the value that a further cycle exceeds with a chance of 1 - USUAL_SHARE
    at most (a conformal quantile).
    """
    scales = np.tile(_common(distances), (len(AGE_LIMITS_S) + 1, 1))
    for age in range(len(AGE_LIMITS_S) + 1):
        parts = [each[np.flatnonzero(own == age)] for each, own in zip(distances, ages, strict=True)]
        of_age = [part for part in parts if len(part)]
        if len(of_age) >= MIN_CYCLES:
            scales[age] = _common(of_age)
    # Half of nothing, as the limit lies beyond the scales by about as much.
    scales = np.maximum(scales, 0.5 * np.array(MIN_SCALES))
    worst = np.sort([float((each / scales[own]).max()) for each, own in zip(distances, ages, strict=True)])
    limit = max(float(worst[min(ceil(USUAL_SHARE * (worst.size + 1)), worst.size) - 1]), 1e-6)
    # What was weighed up against nothing stays there: a training without any scatter makes no degree strange.
    final = np.maximum(scales * limit, MIN_SCALES)
    return final, np.array([(each / final[own]).max() for each, own in zip(distances, ages, strict=True)])


def _common(cycles: Sequence[Array]) -> Array:
    """(4,) what COMMON_SHARE of cycles, each (P, 4), do not exceed at any point."""
    return np.asarray(np.quantile([each.max(axis=0) for each in cycles], COMMON_SHARE, axis=0))


def _ages(points: Array) -> Places:
    """(P,) the number of each point's age, in the order of AGE_LIMITS_S."""
    return np.asarray(np.searchsorted(AGE_LIMITS_S, points[:, COLUMNS.index("age")], side="right"))


_HISTORY_COLUMNS = [COLUMNS.index(name) for name in HISTORY if name != "age"]
_REGRESSOR_COUNT = len(_HISTORY_COLUMNS) + 2


def _regressors(points: Array) -> Array:
    """(P, R) what the temperature is expected by: a bearing that rests forgets more slowly than one that runs."""
    table = points[:, _HISTORY_COLUMNS]
    before = points[:, COLUMNS.index("temperature before")] * points[:, COLUMNS.index("running an hour")]
    return np.column_stack([table, before, np.ones(len(points))])


def _fit_law(features: tuple[str, ...], cycles: Sequence[Array], expected: bool) -> _PointLaw:
    """The law of the points, not calibrated yet."""
    points = np.vstack(cycles)
    own = points[:, [COLUMNS.index(name) for name in features]]
    mean = own.mean(axis=0)
    scale = np.maximum(own.std(axis=0), [FEATURES[name].least for name in features])
    z = (own - mean) / scale
    # Features that the training never varied have scale `least` and no variance: shrinking towards the identity gives
    # them a finite one, and the floor keeps a single sample from being infinitely far.
    values, vectors = np.linalg.eigh(shrunk_covariance(z))
    whitening = vectors / np.sqrt(np.maximum(values, 0.05))
    white = z @ whitening
    centres = white[np.unique(np.linspace(0, len(white) - 1, MAX_CENTRES).astype(int))]
    expectation = np.empty(0)
    if expected:
        x = _regressors(points)
        # Ridge on standardised columns: a training that never varied one of them says nothing of it.
        size = np.maximum(np.sqrt(np.mean(x**2, axis=0)), 1e-6)
        x = x / size
        target = points[:, COLUMNS.index("temperature")]
        expectation = np.linalg.solve(x.T @ x + RIDGE * len(x) * np.eye(len(size)), x.T @ target) / size
    return _PointLaw(
        features=features,
        mean=mean,
        scale=scale,
        whitening=whitening,
        centres=centres,
        peak=float(_log_density(centres, centres).max()),
        low=own.min(axis=0),
        high=own.max(axis=0),
        expectation=expectation,
    )


def shrunk_covariance(z: Array) -> Array:
    """(F, F) the covariance of z (n, F), of mean 0, shrunk towards a multiple of the identity.

    The share is that of least expected squared error (Ledoit & Wolf, J. Multivariate Anal. 88, 2004).
    """
    n, size = z.shape
    z = z - z.mean(axis=0)
    sample = z.T @ z / n
    level = float(np.trace(sample)) / size
    spread = float(np.sum((sample - level * np.eye(size)) ** 2)) / size
    error = float(np.sum((z**2).T @ (z**2)) / n - np.sum(sample**2)) / (n * size)
    share = 1.0 if spread == 0 else min(error, spread) / spread
    return np.asarray(share * level * np.eye(size) + (1.0 - share) * sample)


def _log_density(white: Array, centres: Array) -> Array:
    """(P,) the logarithm of the kernel density at whitened points, up to a constant."""
    count, size = centres.shape
    width = count ** (-1.0 / (size + 4))
    apart = (
        np.sum(white**2, axis=1)[:, None] - 2.0 * white @ centres.T + np.sum(centres**2, axis=1)[None, :]
    ) / width**2
    exponents = -0.5 * np.maximum(apart, 0.0)
    most = exponents.max(axis=1)
    # Of all exponents the greatest is taken out, so that far from every centre the sum is not 0.
    return np.asarray(most + np.log(np.exp(exponents - most[:, None]).sum(axis=1)) - np.log(count))
