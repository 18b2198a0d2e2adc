"""Persistence: the last reading, and a band of how far the past alone has moved over the same time."""

from collections.abc import Sequence

import numpy as np

from sim.sha import Array


def persistence(times: Array, temperature: Array, horizons: Sequence[float], levels: tuple[float, ...]) -> Array | None:
    """(L, H) quantiles in degC: the last of the readings `temperature` (n,) at `times` (n,); None without a reading.

    The band is symmetric: the quantiles of the absolute changes over the horizon so far. A past shorter than twice the
    horizon gives the changes over half of its length, times the root of the ratio, as of a random walk; a single
    reading gives no band at all.
    """
    known = np.isfinite(temperature)
    at, values = times[known], temperature[known]
    if not at.size:
        return None
    signs, shares = np.sign(np.array(levels) - 0.5), np.abs(2.0 * np.array(levels) - 1.0)
    fan = np.full((len(levels), len(horizons)), values[-1])
    for column, horizon in enumerate(horizons):
        lag = min(horizon, (at[-1] - at[0]) / 2.0)
        if lag > 0:
            starts = at <= at[-1] - lag
            changes = np.abs(np.interp(at[starts] + lag, at, values) - values[starts])
            fan[:, column] += signs * np.quantile(changes, shares) * np.sqrt(horizon / lag)
    return fan
