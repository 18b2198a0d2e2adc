"""Where a forecast's band is widened: fan and runs stretched about their median by the calibration's factors.

`sim.forecast.calibration` learns the factors while a gateway runs; a model may bring its own (`Model.calibration`). A
factor multiplies the standard deviation, so 1 leaves the band as the model has it.
"""

from collections.abc import Mapping
from math import inf

import numpy as np

from sim.sha import Array


def widening_factors(calibration: Mapping[float, float], horizons: Array) -> Array:
    """(H,) the factors at the horizons (s): linear between those given, constant outside, 1 without any.

    Raises ValueError for factors that are not positive and finite.
    """
    if not calibration:
        return np.ones(horizons.shape)
    known = sorted(calibration)
    factors = np.interp(horizons, known, [calibration[horizon] for horizon in known])
    if not np.all((factors > 0) & (factors < inf)):
        raise ValueError(f"the calibration's factors must be positive and finite, got {dict(calibration)}")
    return np.asarray(factors)


def widened_fan(quantiles: Array, factors: Array, median: int) -> Array:
    """The fan (L, H) with the distance of each quantile from the row `median` multiplied by the horizon's factor."""
    return np.asarray(quantiles[median] + factors * (quantiles - quantiles[median]))


def widened_runs(x: Array, factors: Array, median: Array) -> Array:
    """Temperatures of runs, of whatever shape, with their distance from the `median` of their moments multiplied."""
    return np.asarray(median + factors * (x - median))
