"""What the bearing beside a bad sensor says of it: the change of one temperature by the change of its twin.

While both sensors are good, the change of the first over each of a few LAGS is regressed on that of its twin over the
same time: a slope, and the variance of what is left, which grows with the lag. Where the first one's sensor is bad, its
last reading and the twin's change since then give a second opinion beside the model's.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, isfinite, sqrt
from typing import Any

import numpy as np

from gateway.machine.model.virtual_sensor import LOOK_BACK_SECONDS

LAGS = (60.0, 300.0, 900.0, 1800.0, 3600.0, 7200.0)
"""s between the two readings of a change. Beyond the longest known one the variance grows as a random walk's."""
KEEP_PERIOD_S = 60.0
"""s between two readings that are kept."""
MIN_CHANGES_PER_LAG = 10.0
"""Changes that do not overlap, from which on a lag is known."""
MEMORY_S = 30 * 86_400.0
"""s of readings after which what was learned counts by a third: a bearing may be changed."""


@dataclass(frozen=True, slots=True)
class TwinEstimate:
    """A temperature by its twin's: `mean` and standard deviation `sigma` (degC)."""

    mean: float
    sigma: float


@dataclass(frozen=True, slots=True)
class _Readings:
    time: float
    own: float
    twin: float


def combine(mean: float, sigma: float, other: TwinEstimate) -> TwinEstimate:
    """Two opinions on one temperature (degC), weighted by their inverse variances.

    Where they are further apart than they allow for, the variance is multiplied by as much (the Birge ratio): one of
    them is wrong, and nobody knows which.
    """
    own, second = sigma * sigma, other.sigma * other.sigma
    share = second / (own + second)
    apart = max((mean - other.mean) ** 2 / (own + second), 1.0)
    return TwinEstimate(share * mean + (1.0 - share) * other.mean, sqrt(apart * share * own))


class TwinBearing:
    """Learns how a temperature changes with its `twin`'s (a tag), and says what the twin tells of a sensor that is bad.

    Readings are learned from once they are LOOK_BACK_SECONDS old: a fault that is found later has taught nothing.
    """

    def __init__(self, twin: str) -> None:
        self.twin = twin
        self._kept: deque[_Readings] = deque()
        self._learned_until = -inf
        # Rows are the lags: seconds of changes, and their sums of twin^2, twin * own and own^2.
        self._sums = np.zeros((len(LAGS), 4))

    def take(self, time: float, own: float | None, twin: float | None) -> None:
        """Take the two readings of a scan (degC), None where one is not good."""
        kept = self._kept
        if kept and time < kept[-1].time:
            kept.clear()  # the clock was set back: what was read cannot be dated any more
        if time < self._learned_until:
            self._learned_until = -inf
        if own is None or twin is None or (kept and time - kept[-1].time < KEEP_PERIOD_S - 1e-3):
            return
        kept.append(_Readings(time, own, twin))
        self._learn(time - LOOK_BACK_SECONDS)
        while kept[0].time < time - LOOK_BACK_SECONDS - LAGS[-1] - 2.0 * KEEP_PERIOD_S:
            kept.popleft()

    def _learn(self, until: float) -> None:
        """Learn from the changes that end at readings not yet learned from, up to a time."""
        for last in [each for each in self._kept if self._learned_until < each.time <= until]:
            self._learned_until = last.time
            self._sums *= 1.0 - KEEP_PERIOD_S / MEMORY_S
            for row, lag in enumerate(LAGS):
                first = self._find_readings(last.time - lag)
                if first is not None:
                    x, y = last.twin - first.twin, last.own - first.own
                    self._sums[row] += (KEEP_PERIOD_S, x * x, x * y, y * y)

    def _find_readings(self, time: float) -> _Readings | None:
        """The newest readings at or before a time, None where those are more than two turns older."""
        found = next((each for each in reversed(self._kept) if each.time <= time + 0.5 * KEEP_PERIOD_S), None)
        return found if found is not None and time - found.time <= 1.5 * KEEP_PERIOD_S else None

    def forget_readings(self, since: float) -> None:
        """Forget what was read from a time on: it was a sensor's that has been found out."""
        while self._kept and self._kept[-1].time >= since:
            self._kept.pop()

    def estimate(self, now: float, since: float, twin: float | None) -> TwinEstimate | None:
        """What the `twin`'s reading (degC) at `now` tells of a temperature that was last read at `since`.

        None where no readings of both are known from then, and where too little was learned.
        """
        first = self._find_readings(since)
        known = [row for row, lag in enumerate(LAGS) if self._sums[row, 0] >= MIN_CHANGES_PER_LAG * lag]
        if twin is None or first is None or not known:
            return None
        seconds, xx, xy, yy = self._sums[known].T
        lags = np.array(LAGS)[known]
        slopes = xy / np.maximum(xx, 1e-9)
        looks = seconds / lags
        # Changes that overlap tell no more than those that do not; by Student's t for so few of them.
        variances = np.maximum(yy - slopes * xy, 0.0) / (seconds / KEEP_PERIOD_S) * looks / (looks - 2.0)
        lag = now - first.time
        slope = float(np.interp(lag, lags, slopes))
        variance = float(np.interp(lag, lags, variances)) * max(lag / lags[-1], 1.0)
        return TwinEstimate(first.own + slope * (twin - first.twin), sqrt(max(variance, 1e-6)))

    def to_plain(self) -> dict[str, Any]:
        """What was learned, as JSON can carry it."""
        until = self._learned_until if isfinite(self._learned_until) else None
        return {"twin": self.twin, "until": until, "sums": self._sums.tolist()}

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Go on from what `to_plain` gave, if it is of the same twin. Raises KeyError, TypeError or ValueError."""
        if saved["twin"] != self.twin:
            return
        sums = np.array(saved["sums"], dtype=float)
        if sums.shape != self._sums.shape or not np.all(np.isfinite(sums)) or np.any(sums[:, (0, 1, 3)] < 0.0):
            raise ValueError(f"sums of twins {sums.shape} cannot be used; {self._sums.shape} are expected")
        self._sums = sums
        # Readings that are read back from the historian have taught already.
        self._learned_until = -inf if saved["until"] is None else float(saved["until"])
