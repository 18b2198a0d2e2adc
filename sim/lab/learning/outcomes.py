"""What came true: the readings of a trace that a forecast is held against when it is due."""

from dataclasses import dataclass

import numpy as np

from sim.lab.learning.data import resolution, without_spikes
from sim.sha import Array


@dataclass(frozen=True, slots=True)
class Outcomes:
    """Readings `values` (n,) (degC) at ascending `times` (n,), absolute s; steps above `gap` s are not bridged."""

    times: Array
    values: Array
    gap: float

    def interpolate(self, due: float) -> float | None:
        """The temperature at `due` (absolute s), linear between the readings around it; None without them."""
        after = int(np.searchsorted(self.times, due))
        if after == 0 or after == self.times.size or self.times[after] - self.times[after - 1] > self.gap:
            return None
        return float(np.interp(due, self.times[after - 1 : after + 1], self.values[after - 1 : after + 1]))


def clean_readings(times: Array, raw: Array, gap: float) -> Outcomes:
    """The good ones of the readings `raw` (n,) at `times` (n,), isolated spikes left out.

    A spike is a fault of the measurement: no forecast is right or wrong for having missed it.
    """
    reading = without_spikes(raw, resolution(raw))
    finite = np.isfinite(reading)
    return Outcomes(times[finite], reading[finite], gap)
