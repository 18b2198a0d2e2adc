"""A local level with a damped slope, its smoothing estimated as it runs: what the last minutes say by themselves.

A bank of damped-trend smoothers (Gardner & McKenzie 1985), one for each of a few smoothings, follows the readings on a
grid of its own. How far each was off at each horizon is kept as a fading mean square. The forecast of a horizon is the
one of the smoother that was off least there, and its band is as wide as that one was off. Nothing is learned
beforehand: a fit to other days holds for how they moved.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from math import exp, inf

import numpy as np

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
        known, known_ahead = self._squares[0] / self._errors[0], float(self._ahead[0])
        for row, ahead in enumerate(self.horizons / self.step):
            if self._errors[row] >= self._ahead[row]:
                known, known_ahead = self._squares[row] / self._errors[row], float(self._ahead[row])
            best = int(known.argmin())
            mean[row] = level[best] + self._reach[row, best] * self._slope[best]
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
        reached = np.maximum.accumulate(
            [
                _reach_chance(limit - self.reading, mean - self.reading, spread)
                for mean, spread in zip(self.mean.tolist(), sigma.tolist(), strict=True)
            ]
        )
        at_limit = float(self.reading >= limit)
        return Forecast(
            time=self.time,
            horizons=self.horizons,
            levels=levels,
            quantiles=self.mean + z[:, None] * sigma,
            locations=({"any": 1.0},) * self.horizons.size,
            limit=limit,
            exceedance=tuple(Estimate(chance, chance, chance, 0) for chance in reached.tolist()),
            minutes_to_limit=limit_minutes(np.append(0.0, self.horizons), np.append(at_limit, reached)),
            runs=0,
            factors=factors,
            borrowed=(0.0,) * self.horizons.size,
        )


def _reach_chance(way: float, drift: float, sigma: float) -> float:
    """The chance that a random walk, which ends `drift` +- `sigma` away, touches what is `way` above its beginning."""
    if way <= 0:
        return 1.0
    if way == inf:
        return 0.0
    past, mirrored = log_normal_cdf([(drift - way) / sigma, -(drift + way) / sigma]).tolist()
    return min(exp(past) + exp(min(2.0 * drift * way / sigma**2 + mirrored, 0.0)), 1.0)
