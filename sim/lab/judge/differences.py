"""Comparisons on the same traces: signed-rank test, bootstrap interval, Holm's correction, what few traces can tell."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import nan, sqrt
from typing import TypeVar

import numpy as np
import scipy
from numpy.typing import ArrayLike

from sim.sha import Array

Unit = TypeVar("Unit")

RESAMPLES = 10_000
MIN_INTERVAL_DIFFERENCES = 5
"""Differences that a bootstrap needs: fewer have too few different resamples for a 95 % interval (3^3 = 27 for 3)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Paired:
    """The differences of two figures on the same `n` traces: `mean` with its 95 % interval `low`..`high`.

    `error` is the mean's standard error (NaN for one trace), `p` the two-sided Wilcoxon signed-rank p-value, `least`
    the smallest p-value that so many traces can give at all (every difference of one sign).
    """

    n: int
    mean: float
    low: float
    high: float
    error: float
    p: float
    least: float

    @property
    def interval(self) -> bool:
        """Whether there are enough differences for an interval."""
        return self.low <= self.high

    @property
    def excludes_zero(self) -> bool:
        """Whether the whole interval lies on one side of 0; False where there is none."""
        return self.low > 0 or self.high < 0


def compare_pairs(differences: ArrayLike, rng: np.random.Generator, resamples: int = RESAMPLES) -> Paired:
    """What the differences (n,) say of their mean; those that are no numbers are left out.

    The interval is the percentile bootstrap over traces (Efron 1979): the traces are the independent units, readings
    inside one are not. The test is exact for up to 50 differences without ties (Wilcoxon 1945; differences of 0 are
    shared between both signs, Pratt 1959). With no difference but 0 the p-value is 1.
    """
    all_values = np.asarray(differences, dtype=float)
    values = all_values[np.isfinite(all_values)]
    n = int(values.size)
    if n == 0:
        return Paired(n=0, mean=nan, low=nan, high=nan, error=nan, p=nan, least=1.0)
    low, high = nan, nan
    if n >= MIN_INTERVAL_DIFFERENCES:
        means = values[rng.integers(0, n, (resamples, n))].mean(axis=1)
        low, high = (float(bound) for bound in np.quantile(means, [0.025, 0.975]))
    error = float(np.std(values, ddof=1)) / sqrt(n) if n > 1 else nan
    return Paired(
        n=n,
        mean=float(values.mean()),
        low=low,
        high=high,
        error=error,
        # With nothing but zeros there are no ranks to test.
        p=float(scipy.stats.wilcoxon(values, zero_method="pratt").pvalue) if np.any(values) else 1.0,
        # All differences of one sign are one of 2^n equally likely patterns of signs, and there are two such sides.
        least=min(1.0, 2.0 ** (1 - n)),
    )


def unit_differences(one: Mapping[Unit, float], other: Mapping[Unit, float]) -> Array:
    """(n,) one minus the other, of the independent units (traces, machines, days) that both have, in one's order."""
    return np.array([value - other[unit] for unit, value in one.items() if unit in other])


def holm(p_values: Sequence[float]) -> list[float]:
    """Adjusted p-values that keep the chance of any false finding among all tests at the level (Holm 1979)."""
    adjusted, so_far = [1.0] * len(p_values), 0.0
    # From the smallest p on, each times the number of tests still open; never below the one before it, so that their
    # order stays.
    for rank, place in enumerate(sorted(range(len(p_values)), key=lambda place: p_values[place])):
        so_far = max(so_far, (len(p_values) - rank) * p_values[place])
        adjusted[place] = min(1.0, so_far)
    return adjusted


def compare_families(families: Sequence[ArrayLike], rng: np.random.Generator) -> list[tuple[Paired, float]]:
    """What each of several sets of differences says, with its p-value corrected for all of them (`holm`)."""
    tests = [compare_pairs(differences, rng) for differences in families]
    return list(zip(tests, holm([test.p if test.n else 1.0 for test in tests]), strict=True))
