"""The figures of one comparison: errors with bootstrap intervals, and how the readings lie in the simulated law."""

from dataclasses import dataclass
from math import ceil, floor, log10, nan, sqrt

import numpy as np

from sim.lab.judge.results import Interval
from sim.scores import block_bootstrap, sorted_crps
from sim.sha import Array

BAND_LEVELS = (0.05, 0.95)
"""The levels of the 90 % band."""
SIGMAS = 3.0
MIN_INTERVAL_READINGS = 20
"""Readings below which no interval is given."""
RESAMPLES = 1000
MAX_BLOCKS = 2000
"""Blocks in a resample, at most: of a long trace the blocks grow, so that memory stays bounded."""
QUANTILES = (0.0, 0.05, 0.25, 0.5, 0.75, 0.95, 1.0)
MAX_SORTED_VALUES = 262_144
"""Numbers that are sorted together: few enough to stay in the cache."""


@dataclass(frozen=True, slots=True)
class Band:
    """The simulated law at m instants, degC, the sensor's noise included: 90 % band `low`..`high`, mean and sigma."""

    low: Array
    high: Array
    mean: Array
    sigma: Array


@dataclass(frozen=True, slots=True)
class Covered:
    """How the readings lie in the simulated law: share in the band, mean CRPS (degC), share beyond three sigma."""

    coverage: float
    crps: float
    beyond: float


def judge_band(rows: Array, readings: Array, sensor_sigma: float, rng: np.random.Generator) -> tuple[Band, Covered]:
    """The law of `rows` (m, runs), simulated temperatures: the sensor's noise is added and rows are sorted, in place.

    `readings` (m,) are what the sensor said at the same instants. Works through a few rows at a time, so that nothing
    of the size of `rows` is allocated. The CRPS is that of the runs' empirical law.
    """
    size = max(1, MAX_SORTED_VALUES // rows.shape[1])
    laws, scores = [], []
    for first in range(0, rows.shape[0], size):
        part = rows[first : first + size]
        # The readings have the sensor's noise, so the runs must have it too before the two are compared.
        if sensor_sigma > 0:
            part += sensor_sigma * rng.standard_normal(part.shape)
        part.sort(axis=1)  # once, for the quantiles and for the CRPS
        low, high = (_quantile(part, level) for level in BAND_LEVELS)
        mean = part.mean(axis=1)
        # Two passes: the mean of the squares less the square of the mean would lose the digits of a narrow band.
        centred = part - mean[:, None]
        sigma = np.sqrt(np.einsum("ij,ij->i", centred, centred) / part.shape[1])
        laws.append((low, high, mean, sigma))
        scores.append(sorted_crps(part, readings[first : first + size]))
    band = Band(*(np.concatenate(column) for column in zip(*laws, strict=True)))
    inside = (readings >= band.low) & (readings <= band.high)
    beyond = np.abs(readings - band.mean) > SIGMAS * band.sigma
    return band, Covered(float(inside.mean()), float(np.concatenate(scores).mean()), float(beyond.mean()))


def _quantile(ordered: Array, level: float) -> Array:
    """As `np.quantile` (linear between neighbours), of rows that ascend: nothing is sorted again."""
    place = level * (ordered.shape[1] - 1)
    below = floor(place)
    above = ordered[:, ceil(place)]
    return np.asarray(ordered[:, below] + (place - below) * (above - ordered[:, below]))


def mae_interval(errors: Array, rng: np.random.Generator) -> Interval:
    """The mean absolute error of `errors` (n,) with its interval."""
    sizes = np.abs(errors)
    low, high = _bounds(sizes, rng)
    return Interval(float(sizes.mean()), low, high)


def rmse_interval(errors: Array, rng: np.random.Generator) -> Interval:
    """The root mean square error of `errors` (n,), with the root of the interval of the mean square."""
    squares = errors**2
    low, high = np.sqrt(_bounds(squares, rng)).tolist()
    return Interval(sqrt(float(squares.mean())), low, high)


def _bounds(values: Array, rng: np.random.Generator) -> tuple[float, float]:
    if values.size < MIN_INTERVAL_READINGS:
        return nan, nan
    # Neighbouring errors of one run are alike: rows drawn one by one would give an interval far too narrow.
    block = max(block_length(values), ceil(values.size / MAX_BLOCKS))
    return block_bootstrap(values, block, RESAMPLES, rng)


def block_length(values: Array) -> int:
    """Rows that a circular block bootstrap must keep together, from the autocorrelation of the series (n,).

    The automatic choice of Politis & White (2004), corrected by Patton, Politis & White (2009), with their flat-top
    window; at most a third of the series. 1 where nothing is correlated or nothing varies.
    """
    n = values.size
    correlation = autocorrelation(values)
    if correlation.size < 2:
        return 1
    # M of the paper: twice the lag from which on nothing is correlated, where the window comes down to 0.
    reach = min(2 * _correlation_lag(correlation, n), correlation.size - 1)
    if reach == 0:
        return 1
    lags = np.arange(1, reach + 1)
    window = np.clip(2.0 * (1.0 - lags / reach), 0.0, 1.0)  # the flat-top window: 1 up to a half, then down to 0
    weighted = window * correlation[1 : reach + 1]
    slope, level = 2.0 * float((lags * weighted).sum()), 1.0 + 2.0 * float(weighted.sum())
    if level <= 0:  # the spectrum at 0 as estimated; a variance that came out negative gives no length
        return 1
    length = (1.5 * slope**2 / level**2) ** (1 / 3) * n ** (1 / 3)  # 2 G^2 / D with D = 4/3 g(0)^2
    return int(min(max(ceil(length), 1), max(n // 3, 1)))


def _correlation_lag(correlation: Array, n: int) -> int:
    """The lag after which a whole run of lags is within the noise of an uncorrelated series."""
    # The paper's constants: c = 2 in the threshold c sqrt(log10(n) / n), K = max(5, sqrt(log10 n)) lags in a row.
    quiet = np.abs(correlation[1:]) < 2.0 * sqrt(log10(n) / n)
    run = max(5, ceil(sqrt(log10(n))))
    if quiet.size < run:
        return int(correlation.size - 1)
    together = np.convolve(quiet, np.ones(run), mode="valid") == run
    return int(np.argmax(together)) if together.any() else int(correlation.size - 1)


def autocorrelation(values: Array) -> Array:
    """The sample autocorrelation at the lags 0 to n/2; empty for a series that does not vary."""
    # By the spectrum (Wiener-Khinchin), padded to twice the length so that the end does not run into the beginning.
    centred = values - values.mean()
    n = values.size
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(centred, size)
    covariance = np.fft.irfft(spectrum * spectrum.conjugate(), size)[: n // 2 + 1]
    # Against the square of the values: what rounding leaves of a constant series is no variation.
    return covariance / covariance[0] if covariance[0] > 1e-12 * max(1.0, float(np.mean(values**2))) else np.empty(0)


def error_quantiles(errors: Array) -> tuple[float, ...]:
    """The quantiles of QUANTILES, degC."""
    return tuple(float(value) for value in np.quantile(errors, QUANTILES))
