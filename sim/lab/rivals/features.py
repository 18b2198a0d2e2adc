"""The feature table of the direct rivals: what the last quarter of an hour says, one row an origin."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim.lab.rivals.past import Past
from sim.sha import Array

LEVEL = 5.0
"""The level is the mean over so many seconds: where readings are many, single ones are noisy."""
LAGS = (10.0, 30.0, 60.0, 300.0, 900.0)
WINDOWS = (10.0, 60.0, 300.0)
MEMORY = 1000.0
"""Rows older than this (s) are not needed at an origin: the longest lag, its level, and room for a missing reading."""
LEVEL_COLUMN = 0


def feature_table(past: Past, origins: Array, inputs: Sequence[str]) -> Array:
    """Features (n, 8 + 3 len(inputs)) at `origins` (n,) s, each from the rows up to its origin.

    Level (degC), last reading less level, change of the level over each of LAGS (back to the oldest reading where the
    past is shorter), how far the past reaches back (s, at most the longest lag), then for each input, in the order
    given, its mean over each of WINDOWS. Where a window has no reading the last one before it holds; NaN where there is
    none.
    """
    temperature = RunningMeans.of(past.times, past.temperature)
    oldest = temperature.times[0] if temperature.times.size else np.nan
    level = temperature.before(origins, LEVEL)
    columns = [level, temperature.before(origins, 0.0) - level]
    columns += [level - temperature.before(np.maximum(origins - lag, oldest), LEVEL) for lag in LAGS]
    columns.append(np.clip(origins - oldest, 0.0, LAGS[-1]))
    for name in inputs:
        if name in past.inputs:
            means = RunningMeans.of(past.times, past.inputs[name])
            columns += [means.before(origins, window) for window in WINDOWS]
        else:
            columns += [np.full(origins.shape, np.nan)] * len(WINDOWS)
    return np.stack(columns, axis=1)


@dataclass(frozen=True, slots=True)
class RunningMeans:
    """Readings (m,) at `times` (m,) with their running `sums` (m + 1,)."""

    times: Array
    values: Array
    sums: Array

    @staticmethod
    def of(times: Array, values: Array) -> "RunningMeans":
        """Of a column with NaN where nothing was read."""
        known = np.isfinite(values)
        return RunningMeans(times[known], values[known], np.concatenate(([0.0], np.cumsum(values[known]))))

    def before(self, moments: Array, width: float) -> Array:
        """(n,) the mean over the `width` seconds up to each moment, else the last reading before it, else NaN."""
        if self.values.size == 0:
            return np.full(moments.shape, np.nan)
        last = np.searchsorted(self.times, moments, side="right")
        # The last reading belongs to every window, however narrow: so a window without a reading holds it.
        first = np.minimum(np.searchsorted(self.times, moments - width, side="right"), np.maximum(last - 1, 0))
        mean = (self.sums[last] - self.sums[first]) / np.maximum(last - first, 1)
        return np.asarray(np.where(last > 0, mean, np.nan))
