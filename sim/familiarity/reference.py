"""The law of a training set's cycles, and how far from it another one is.

Two distances, since either is blind where the other sees: Mahalanobis' with a covariance shrunk after Ledoit and Wolf
(2004) for what lies outside, and a kernel density (Gaussian, Scott's bandwidth, on whitened points) for what lies
between the kinds of cycles that there are. Both are counted in units of what cycles held out have: strangeness 1 is as
strange as the strangest twentieth of the training's own cycles, each judged by the others.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf, nan
from typing import Any

import numpy as np
from scipy.special import logsumexp

from sim.familiarity.features import FEATURES
from sim.sha import Array

LEAST_CYCLES = 8
"""Cycles below which nothing can be said of what is usual."""
FOLDS = 10
CENTRES = 400
"""Points that the density is made of: evenly from all, more would only cost time."""
ALIKE = 0.5
"""Root mean square over the whitened features, in standard deviations, within which two cycles are alike."""
USUAL = 0.95
"""The share of the training's cycles that are not strange."""


@dataclass(frozen=True, slots=True)
class Strangeness:
    """How strange a cycle is: `value` (1: as the strangest twentieth held out), the moment (s) at which it is, and what
    is strange in an operator's words. `p` is the share of cycles held out that were at least as strange."""

    value: float
    p: float
    time: float
    words: str


@dataclass(frozen=True, slots=True, kw_only=True)
class FamiliarityReference:
    """The law of the points of a training set. Arrays are over the `features` (F,) that all its cycles have.

    `mean` and `scale` standardise, `whitening` (F, F) makes the shrunk covariance the identity, `centres` (C, F) are
    whitened points of the density and `peak` its greatest logarithm among them. `low` and `high` are the training's
    extremes. `distance` and `density` are what strangeness 1 is in either; `held_out` (n,) the strangeness of the
    training's cycles, ascending.
    """

    features: tuple[str, ...]
    mean: Array
    scale: Array
    whitening: Array
    centres: Array
    peak: float
    low: Array
    high: Array
    distance: float
    density: float
    held_out: Array

    def strangeness(self, points: Array, times: Array) -> Strangeness:
        """Of a cycle with `points` (P, F of FEATURES) at `times` (P,): that of its strangest point.

        Points at which a feature is not known count with the mean of it: what is not measured is not strange.
        """
        own = self._own(points)
        far, rare = self.distances(own)
        values = np.maximum(far / self.distance, rare / self.density)
        if not values.size:
            return Strangeness(0.0, 1.0, nan, "")
        worst = int(np.argmax(values))
        value = float(values[worst])
        p = (1 + np.count_nonzero(self.held_out >= value)) / (self.held_out.size + 1)
        return Strangeness(value, float(p), float(times[worst]), self._words(own[worst]))

    def alike(self, points: Array, others: Array) -> bool:
        """Whether two cycles (P, F) and (Q, F) are: their mean points lie within ALIKE of one another."""
        apart = self._own(points).mean(axis=0) - self._own(others).mean(axis=0)
        return bool(np.mean((apart / self.scale @ self.whitening) ** 2) < ALIKE**2)

    def _own(self, points: Array) -> Array:
        """(P, F) the reference's own features; the mean where one is not known."""
        names = list(FEATURES)
        columns = points[:, [names.index(name) for name in self.features]]
        return np.where(np.isfinite(columns), columns, self.mean)

    def distances(self, own: Array) -> tuple[Array, Array]:
        """(P,) of own features (P, F): Mahalanobis' distance, and that of the density, sqrt(2 log(peak / density))."""
        white = (own - self.mean) / self.scale @ self.whitening
        logs = _log_density(white, self.centres)
        return np.sqrt(np.sum(white**2, axis=1)), np.sqrt(2.0 * np.maximum(self.peak - logs, 0.0))

    def _words(self, point: Array) -> str:
        """The feature that is farthest outside of the training's extremes, or the two that make the combination."""
        beyond = np.maximum(point - self.high, self.low - point) / self.scale
        place = int(np.argmax(beyond))
        if beyond[place] > 0:
            kind = FEATURES[self.features[place]]
            above = point[place] > self.high[place]
            bound = (self.high if above else self.low)[place]
            most = "at most" if above else "at least"
            return f"{kind.words} {kind.text(point[place])}: in training {most} {kind.text(bound)}"
        # Shares of the squared distance, feature by feature: z (P z) sums to it.
        z = (point - self.mean) / self.scale
        share = z * (self.whitening @ (self.whitening.T @ z))
        one, other = (FEATURES[self.features[place]] for place in np.argsort(-share)[:2])
        first, second = np.argsort(-share)[:2]
        return (
            f"{one.words} {one.text(point[first])} together with {other.words} {other.text(point[second])}: "
            "not in training together"
        )

    def as_plain(self) -> dict[str, Any]:
        """All of it as plain values for JSON."""
        arrays = ("mean", "scale", "whitening", "centres", "low", "high", "held_out")
        plain: dict[str, Any] = {name: getattr(self, name).tolist() for name in arrays}
        numbers = {"peak": self.peak, "distance": self.distance, "density": self.density}
        return {"features": list(self.features), **plain, **numbers}


def parse_reference(plain: Mapping[str, Any]) -> FamiliarityReference:
    """What `as_plain` gave. Raises KeyError, TypeError or ValueError for anything else, also for unknown features."""
    features = tuple(str(name) for name in plain["features"])
    if unknown := set(features) - set(FEATURES):
        raise ValueError(f"the feature {min(unknown)!r} is unknown")
    arrays: dict[str, Array] = {
        name: np.array(plain[name], dtype=float)
        for name in ("mean", "scale", "whitening", "centres", "low", "high", "held_out")
    }
    size = len(features)
    shapes = {"mean": (size,), "scale": (size,), "whitening": (size, size), "low": (size,), "high": (size,)}
    if any(arrays[name].shape != shape for name, shape in shapes.items()) or arrays["centres"].shape[1:] != (size,):
        raise ValueError("its arrays do not have one place a feature")
    peak, distance, density = (float(plain[name]) for name in ("peak", "distance", "density"))
    return FamiliarityReference(features=features, **arrays, peak=peak, distance=distance, density=density)


def fit_reference(cycles: Sequence[Array], groups: Sequence[str] | None = None) -> FamiliarityReference:
    """The law of cycles, each (P, F of FEATURES). It is calibrated on cycles that are held out.

    `groups` are their machines: with three at least each is held out in turn, else tenths of the cycles are. Raises
    ValueError with fewer than LEAST_CYCLES, or where they have no feature in common.
    """
    if len(cycles) < LEAST_CYCLES:
        raise ValueError(f"{len(cycles)} cycles do not tell what is usual; it takes {LEAST_CYCLES}")
    known = [bool(np.isfinite(np.vstack(cycles)[:, place]).all()) for place in range(len(FEATURES))]
    features = tuple(name for name, there in zip(FEATURES, known, strict=True) if there)
    if not features:
        raise ValueError("the cycles have no feature in common")
    own = [cycle[:, known] for cycle in cycles]
    machines = sorted(set(groups or ()))
    if groups is not None and len(machines) >= 3:
        fold = np.array([machines.index(name) for name in groups])
    else:
        fold = np.arange(len(own)) % min(FOLDS, len(own))
    far, rare = np.zeros(len(own)), np.zeros(len(own))
    for held in range(int(fold.max()) + 1):
        rest = _fitted(features, [cycle for cycle, number in zip(own, fold, strict=True) if number != held])
        for place in np.flatnonzero(fold == held).tolist():
            one, other = rest.distances(own[place])
            far[place], rare[place] = one.max(), other.max()
    distance, density = float(np.quantile(far, USUAL)), float(np.quantile(rare, USUAL))
    whole = _fitted(features, own)
    return FamiliarityReference(
        features=features,
        mean=whole.mean,
        scale=whole.scale,
        whitening=whole.whitening,
        centres=whole.centres,
        peak=whole.peak,
        low=whole.low,
        high=whole.high,
        distance=distance,
        density=density,
        held_out=np.sort(np.maximum(far / distance, rare / density)),
    )


def _fitted(features: tuple[str, ...], cycles: Sequence[Array]) -> FamiliarityReference:
    """The law of the points, not calibrated yet."""
    points = np.vstack(cycles)
    mean = points.mean(axis=0)
    scale = np.maximum(points.std(axis=0), [FEATURES[name].least for name in features])
    z = (points - mean) / scale
    # Features that the training never varied have scale `least` and no variance: shrinking towards the identity gives
    # them a finite one, and the floor keeps a single sample from being infinitely far.
    values, vectors = np.linalg.eigh(shrunk_covariance(z))
    whitening = vectors / np.sqrt(np.maximum(values, 0.05))
    white = z @ whitening
    centres = white[np.unique(np.linspace(0, len(white) - 1, CENTRES).astype(int))]
    peak = float(_log_density(centres, centres).max())
    return FamiliarityReference(
        features=features,
        mean=mean,
        scale=scale,
        whitening=whitening,
        centres=centres,
        peak=peak,
        low=points.min(axis=0),
        high=points.max(axis=0),
        distance=inf,
        density=inf,
        held_out=np.empty(0),
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
    return np.asarray(logsumexp(-0.5 * np.maximum(apart, 0.0), axis=1) - np.log(count))
