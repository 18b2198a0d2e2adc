"""A local level with a damped slope, its smoothing estimated as it runs: what the last minutes say by themselves.

A bank of damped-trend smoothers (Gardner & McKenzie 1985), one for each of a few smoothings, follows the readings on a
grid of its own. How far each was off at each horizon is kept as a fading mean square. The forecast of a horizon is the
one of the smoother that was off least there, and its band is as wide as that one was off. Of a horizon that has not
been seen through it says what it does of the longest one that has, in a band that widens as a walk's. Nothing is
learned beforehand: a fit to other days holds for how they moved.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product
from math import inf

import numpy as np
from numpy.typing import NDArray

from sim.engine import Belief, Tracker
from sim.forecast.fan import Forecast, limit_minutes
from sim.scores import Estimate
from sim.sha import Array
from sim.special import log_normal_cdf, normal_quantile_of_log

LEVEL_GAINS = (1.0, 0.6, 0.3, 0.1)
"""The part of a reading's surprise by which the level moves: 1 is the last reading itself."""
SLOPE_GAINS = (0.02, 0.1, 0.3)
"""The part of the level's correction by which the slope moves; smoothers without a slope stand beside these."""
DAMPINGS = (0.8, 0.95, 0.99)
"""What is left of a slope after a step of the grid."""
STEPS_PER_HORIZON = 6
"""Steps of the grid in the shortest horizon."""
MAX_STEPS = 720
"""Steps that are looked back at most: a longer horizon is judged by them, its error being that of a random walk."""
ERROR_STEPS, ERROR_HORIZONS = 60.0, 4.0
"""Steps, or horizons where these are more, after which an error counts half."""
MIN_ERRORS = 5.0
"""Errors at the shortest horizon before anything is forecast."""
FRESH_STEPS, GAP_STEPS = 3.0, 30.0
"""Steps without a reading after which nothing is forecast, and after which all begins anew."""
MIN_SIGMA = 1e-3
"""degC: the least standard deviation of a forecast."""
CLOCK_STEPS = 32
"""Steps in which the way to the limit is looked at."""


def _bank() -> tuple[Array, Array, Array]:
    """(M,) the gains of level and slope and the damping of each smoother."""
    rows = [(level, 0.0, 1.0) for level in LEVEL_GAINS]
    rows += list(product(LEVEL_GAINS, SLOPE_GAINS, DAMPINGS))
    level, slope, damping = np.array(rows).T
    return level, slope, damping


class LocalTrend:
    """The bank for these `horizons` (s, ascending), fed by readings of scans that come every `scan_period` s."""

    def __init__(self, horizons: Sequence[float], scan_period: float) -> None:
        self.horizons = np.asarray(horizons, dtype=float)
        self.step = max(float(self.horizons[0]) / STEPS_PER_HORIZON, scan_period)
        self._level_gain, self._slope_gain, self._damping = _bank()
        self._ahead = np.clip(np.rint(self.horizons / self.step), 1, MAX_STEPS).astype(np.intp)
        # The slope's sum over the steps of each horizon; a smoother without one has the damping 1 and no slope.
        d, k = self._damping, self._ahead[:, None]
        self._reach = np.where(d < 1.0, d * (1.0 - d**k) / np.where(d < 1.0, 1.0 - d, 1.0), 0.0)
        self._fade = 0.5 ** (1.0 / np.maximum(ERROR_STEPS, ERROR_HORIZONS * self._ahead))
        self._now = -inf
        self._begin(-inf, 0.0)

    def _begin(self, time: float, reading: float) -> None:
        size, past = self._damping.size, int(self._ahead[-1]) + 1
        self._origin, self._last, self._cell, self._reading = time, time, 0, reading
        self._level, self._slope = np.full(size, reading), np.zeros(size)
        self._levels, self._slopes, self._closed = np.zeros((past, size)), np.zeros((past, size)), 0
        self._squares, self._errors = np.zeros((self._ahead.size, size)), np.zeros(self._ahead.size)

    def take(self, time: float, reading: float) -> None:
        """The reading (degC) of a scan at `time` (s); one that is no number says nothing, but time passes."""
        self._now = time
        if reading != reading:
            return
        if not 0.0 <= time - self._last <= GAP_STEPS * self.step:
            self._begin(time, reading)
            return
        cell = int((time - self._origin) / self.step)
        # A cell's value is its last reading, and holds until the next one.
        for _ in range(cell - self._cell):
            self._close()
        self._cell, self._last, self._reading = cell, time, reading

    def _close(self) -> None:
        expected = self._level + self._damping * self._slope
        moved = self._level_gain * (self._reading - expected)
        self._level, self._slope = expected + moved, self._damping * self._slope + self._slope_gain * moved
        row, size = self._closed % len(self._levels), len(self._levels)
        self._levels[row], self._slopes[row] = self._level, self._slope
        due = np.flatnonzero(self._ahead <= self._closed)
        if due.size:
            made = (self._closed - self._ahead[due]) % size
            error = self._reading - (self._levels[made] + self._reach[due] * self._slopes[made])
            self._squares[due] = self._fade[due, None] * self._squares[due] + error**2
            self._errors[due] = self._fade[due] * self._errors[due] + 1.0
        self._closed += 1

    def look_ahead(self) -> "LocalOutlook | None":
        """What it says of its horizons now; None before it has seen enough, and without a fresh reading."""
        if self._errors[0] < MIN_ERRORS or self._now - self._last > FRESH_STEPS * self.step:
            return None
        # The cell is not over: its reading counts as of now.
        part = (self._last - self._origin) / self.step - self._cell
        expected = self._level + part * self._damping * self._slope
        level = expected + self._level_gain * (self._reading - expected)
        mean, sigma = np.empty(self.horizons.size), np.empty(self.horizons.size)
        known, known_ahead, reach = self._squares[0] / self._errors[0], float(self._ahead[0]), self._reach[0]
        for row, ahead in enumerate(self.horizons / self.step):
            if self._errors[row] >= self._ahead[row]:
                known, known_ahead = self._squares[row] / self._errors[row], float(self._ahead[row])
                reach = self._reach[row]
            best = int(known.argmin())
            # A slope that was good over minutes says nothing of a quarter of an hour: it holds as far as it was tried.
            mean[row] = level[best] + reach[best] * self._slope[best]
            sigma[row] = max(float(np.sqrt(known[best] * max(ahead / known_ahead, 1.0))), MIN_SIGMA)
        return LocalOutlook(self._now, self._reading, self.horizons, mean, sigma)


@dataclass(frozen=True, slots=True)
class LocalOutlook:
    """Gaussian laws with `mean` and `sigma` (H,) degC at the `horizons` (s), from the `reading` (degC) at `time` on."""

    time: float
    reading: float
    horizons: Array
    mean: Array
    sigma: Array

    def forecast(self, factors: Array, *, limit: float, levels: tuple[float, ...]) -> Forecast:
        """As a forecast, its bands widened by `factors` (H,).

        The limit is reached as by a random walk with a steady drift to the mean, of which the chance is known.
        """
        sigma = factors * self.sigma
        z = np.array(normal_quantile_of_log(np.log(levels)))
        clock, at = _clock(tuple(self.horizons.tolist()))
        known = np.append(0.0, self.horizons)
        drift = np.interp(clock, known, np.append(0.0, self.mean - self.reading))
        variance = np.interp(clock, known, np.append(0.0, sigma**2))
        reached = np.append(float(self.reading >= limit), _reach_chances(limit - self.reading, drift[1:], variance[1:]))
        return Forecast(
            time=self.time,
            horizons=self.horizons,
            levels=levels,
            quantiles=self.mean + z[:, None] * sigma,
            locations=({"any": 1.0},) * self.horizons.size,
            limit=limit,
            exceedance=tuple(Estimate(chance, chance, chance, 0) for chance in reached[at].tolist()),
            minutes_to_limit=limit_minutes(clock, reached),
            runs=0,
            factors=factors,
            borrowed=(0.0,) * self.horizons.size,
        )


@cache
def _clock(horizons: tuple[float, ...]) -> tuple[Array, NDArray[np.intp]]:
    """Times (s, from 0) at which the way to the limit is looked at, close at first as a walk spreads; the horizons'."""
    clock = np.union1d(horizons[-1] * np.linspace(0.0, 1.0, CLOCK_STEPS + 1) ** 2, horizons)
    return clock, np.searchsorted(clock, horizons)


def walk_outlook(walk: Tracker, belief: Belief, horizons: Sequence[float]) -> LocalOutlook | None:
    """What a plain member that is a `walk` says from `belief` on, exactly; None of one with heat or a noisy sensor."""
    if walk.plant is not None or walk.model.sensor_sigma > 0:
        return None
    ahead, (place,) = np.asarray(horizons, dtype=float), walk.model.sha.locations
    sigma = np.sqrt(belief.xx + place.flow.params["noise"] ** 2 * ahead)
    return LocalOutlook(belief.time, belief.x, ahead, np.full(ahead.size, belief.x), np.maximum(sigma, MIN_SIGMA))


def _reach_chances(way: float, drift: Array, variance: Array) -> Array:
    """(N,) the chances that a random walk, which ends `drift` away with that `variance`, touches what is `way` above.

    None is less than the one before it: what has been reached stays so.
    """
    if way <= 0 or way == inf:
        return np.full(drift.size, float(way <= 0))
    sigma = np.sqrt(variance)
    past, mirrored = log_normal_cdf([(drift - way) / sigma, -(drift + way) / sigma])
    chances = np.exp(past) + np.exp(np.minimum(2.0 * drift * way / variance + mirrored, 0.0))
    return np.asarray(np.minimum(np.maximum.accumulate(chances), 1.0))
