"""Scores of probabilistic forecasts, intervals for probabilities, the chi-square test of innovations: pure functions.

A forecast is judged by CRPS (in the unit of the variable, smaller is better; for a single number it is the absolute
error, so persistence's CRPS is its MAE), by the share of outcomes inside its interval, and by Brier for a probability.
"""

from dataclasses import dataclass
from math import log, log10, pi, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.special import beta_quantile, chi_square_tail

Array = NDArray[np.float64]
MAX_SURPRISE = 99.0
"""Where `surprise` ends: a p-value of 1e-99."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A probability estimated from `runs` runs, with its confidence interval `low`..`high`."""

    probability: float
    low: float
    high: float
    runs: int


def clopper_pearson(successes: float, runs: int, level: float = 0.95) -> Estimate:
    """Exact binomial interval for a probability (Clopper & Pearson 1934).

    `successes` may be a sum of per-run probabilities: their mean scatters less than a count of yes and no, so the
    interval is then too wide rather than too narrow. Raises ValueError unless runs > 0, 0 <= successes <= runs and
    0 < level < 1.
    """
    if runs <= 0 or not 0 <= successes <= runs or not 0 < level < 1:
        raise ValueError(f"no binomial interval for {successes} of {runs} at level {level}")
    tail = (1.0 - level) / 2.0
    low = 0.0 if successes == 0 else beta_quantile(successes, runs - successes + 1.0, tail)
    high = 1.0 if successes == runs else 1.0 - beta_quantile(runs - successes, successes + 1.0, tail)
    return Estimate(successes / runs, low, high, runs)


def crps_gaussian(mean: ArrayLike, sigma: ArrayLike, outcome: ArrayLike) -> Array:
    """CRPS of N(mean, sigma^2), closed form (Gneiting & Raftery 2007, eq. 21); |outcome - mean| where sigma is 0."""
    from scipy.special import ndtr  # here and below: a running gateway scores otherwise, and loads none of scipy

    error = np.asarray(outcome, dtype=float) - np.asarray(mean, dtype=float)
    spread = np.broadcast_to(np.asarray(sigma, dtype=float), error.shape)
    z = error / np.where(spread > 0, spread, 1.0)
    density = np.exp(-0.5 * z * z) / sqrt(2.0 * pi)
    score = spread * (z * (2.0 * ndtr(z) - 1.0) + 2.0 * density - 1.0 / sqrt(pi))
    return np.asarray(np.where(spread > 0, score, np.abs(error)))


def crps_sample(samples: ArrayLike, outcome: ArrayLike) -> Array:
    """CRPS of the empirical law of `samples` (..., n) at `outcome` (...): E|X - y| - E|X - X'| / 2, both over n.

    This scores the n particles as they are; against the law they were drawn from it is too high by its own
    E|X - X'| / (2n).
    """
    return sorted_crps(np.sort(np.asarray(samples, dtype=float), axis=-1), outcome)


def sorted_crps(ordered: Array, outcome: ArrayLike) -> Array:
    """`crps_sample` of samples (..., n) in ascending order, as a caller who needs their quantiles too has them."""
    n = ordered.shape[-1]
    apart = ordered - np.asarray(outcome, dtype=float)[..., None]
    error = np.abs(apart, out=apart).mean(axis=-1)
    weights = 2.0 * np.arange(1, n + 1) - n - 1.0
    return np.asarray(error - np.einsum("...j,j->...", ordered, weights) / n**2)


def crps_quantiles(levels: ArrayLike, quantiles: ArrayLike, outcome: ArrayLike) -> Array:
    """CRPS of a fan: `quantiles` (..., L) at ascending `levels` (L,) in (0, 1), `outcome` (...).

    CRPS is twice the integral of the pinball loss over all levels (Laio & Tamea 2007; Gneiting & Ranjan 2011). Each
    level stands for the levels nearer to it than to any other (so 0.05, 0.25, 0.5, 0.75, 0.95 weigh .15, .225, .25,
    .225, .15); with L = 1 at 0.5 it is the absolute error. Beside the closed form, those five levels give a Gaussian's
    expected CRPS 3 % too low, and 0.01, 0.02 .. 0.99 give it less than 0.1 % too high.
    """
    alpha = np.asarray(levels, dtype=float)
    if alpha.size == 0 or np.any(np.diff(alpha) <= 0) or not 0 < alpha[0] <= alpha[-1] < 1:
        raise ValueError("the levels of a fan must ascend inside (0, 1)")
    error = np.asarray(outcome, dtype=float)[..., None] - np.asarray(quantiles, dtype=float)
    pinball = np.where(error >= 0, alpha, alpha - 1.0) * error
    edges = np.concatenate(([0.0], (alpha[1:] + alpha[:-1]) / 2.0, [1.0]))
    return np.asarray(2.0 * (pinball * np.diff(edges)).sum(axis=-1))


def coverage(low: ArrayLike, high: ArrayLike, outcome: ArrayLike) -> float:
    """The share of outcomes inside [low, high]; NaN outcomes are left out, NaN when none is left."""
    outcomes = np.asarray(outcome, dtype=float)
    known = np.isfinite(outcomes)
    inside = (outcomes >= np.asarray(low, dtype=float)) & (outcomes <= np.asarray(high, dtype=float))
    return float(inside[known].mean()) if known.any() else float("nan")


def brier(probability: ArrayLike, happened: ArrayLike) -> float:
    """Mean squared difference of stated probabilities and what happened (1.0 or 0.0); 0.25 for always saying half."""
    return float(np.mean((np.asarray(probability, dtype=float) - np.asarray(happened, dtype=float)) ** 2))


def pit_gaussian(mean: ArrayLike, sigma: ArrayLike, outcome: ArrayLike) -> Array:
    """Probability integral transform of `outcome` under N(mean, sigma^2): uniform on (0, 1) when that is right."""
    from scipy.special import ndtr

    return np.asarray(ndtr((np.asarray(outcome, dtype=float) - np.asarray(mean, dtype=float)) / np.asarray(sigma)))


def pit_sample(samples: ArrayLike, outcome: ArrayLike) -> Array:
    """The share of `samples` (..., n) below `outcome` (...), ties counted half."""
    given = np.asarray(samples, dtype=float)
    at = np.asarray(outcome, dtype=float)[..., None]
    return np.asarray(((given < at).mean(axis=-1) + (given <= at).mean(axis=-1)) / 2.0)


def chi_square_p(squares: float, degrees: int) -> float:
    """P(a chi-square variable with `degrees` degrees of freedom exceeds `squares`)."""
    return chi_square_tail(squares, degrees)


def surprise(squares: float, degrees: int) -> float:
    """-log10 of `chi_square_p`, from 0 (as expected, or better) to 99 (a p-value of 1e-99 or less)."""
    p = chi_square_p(squares, degrees)
    return min(max(-log10(p), 0.0), MAX_SURPRISE) if p > 0.0 else MAX_SURPRISE


def log_score_gaussian(mean: ArrayLike, sigma: ArrayLike, outcome: ArrayLike) -> Array:
    """Minus the log density of `outcome` under N(mean, sigma^2), nats."""
    spread = np.asarray(sigma, dtype=float)
    z = (np.asarray(outcome, dtype=float) - np.asarray(mean, dtype=float)) / spread
    return np.asarray(0.5 * z * z + np.log(spread) + 0.5 * log(2.0 * pi))


def block_bootstrap(
    values: ArrayLike, block: int, runs: int, rng: np.random.Generator, level: float = 0.95
) -> tuple[float, float]:
    """Interval for the mean of a correlated series (n,): circular block bootstrap (Politis & Romano 1992), percentiles.

    `block` rows stay together: at least the correlation's length (overlapping forecasts: their horizon in rows).
    Raises ValueError when there are no values or the block or runs are below 1.
    """
    series = np.asarray(values, dtype=float)
    n = series.size
    if n == 0 or block < 1 or runs < 1:
        raise ValueError(f"no block bootstrap of {n} values with blocks of {block} in {runs} runs")
    size = min(block, n)
    blocks = -(-n // size)
    sums = np.concatenate(([0.0], np.cumsum(np.concatenate((series, series[:size])))))
    starts = rng.integers(0, n, (runs, blocks))
    lengths = np.full(blocks, size)
    lengths[-1] = n - (blocks - 1) * size  # the last block is cut, so that a resample has as many values as the series
    means = (sums[starts + lengths] - sums[starts]).sum(axis=1) / n
    low, high = np.quantile(means, [(1.0 - level) / 2.0, (1.0 + level) / 2.0])
    return float(low), float(high)
