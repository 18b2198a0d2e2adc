"""What was measured after like moments: against its mean and standard deviation a forecast is held (3 sigma).

Moments are alike in which the machine had been in the same location about as long. Of such moments one an hour counts:
neighbouring rows err together, and a machine that goes to and fro between two locations tells nothing new each time.
"""

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite, sqrt
from typing import Any

from sim.forecast.review import REVIEW_SIGMAS

STAY_EDGES_S = (300.0, 1200.0, 3600.0)
"""Seconds since a location was entered at which a stay is no longer like a shorter one."""
SPACING_S = 3600.0
"""Seconds between two moments that are alike and both count."""
MIN_MOMENTS = 20
"""Moments below which their mean and standard deviation say nothing: by so many 3 sigma is left once in 125 times."""

Moment = tuple[str, int]
"""A location, and how many of STAY_EDGES_S the stay has passed."""


@dataclass(frozen=True, slots=True)
class PastReadings:
    """Readings that came a horizon after like moments: of how many `moments`, their `mean` and `sigma` in degC."""

    moments: int = 0
    mean: float = 0.0
    squares: float = 0.0

    def take(self, reading: float) -> "PastReadings":
        """With one more reading (degC)."""
        moments, off = self.moments + 1, reading - self.mean
        mean = self.mean + off / moments
        return PastReadings(moments, mean, self.squares + off * (reading - mean))

    @property
    def sigma(self) -> float:
        """The standard deviation over the moments; 0 for fewer than two."""
        return sqrt(self.squares / (self.moments - 1)) if self.moments > 1 else 0.0


@dataclass(frozen=True, slots=True)
class HeldAgainstPast:
    """A forecast's median at a `horizon` (s): `deviations` times `sigma` above the `mean` of the `moments` (degC)."""

    horizon: float
    moments: int
    mean: float
    sigma: float
    deviations: float

    @property
    def flagged(self) -> bool:
        """Whether it lies beyond 3 standard deviations."""
        return abs(self.deviations) > REVIEW_SIGMAS


class LikeMoments:
    """What was measured the `horizons` (s) after like moments, up to now, and what is still awaited.

    A standard deviation below `sigma` (degC, of the sensor) counts as that. A reading that comes more than `tolerance`
    s after its moment is none of it.
    """

    def __init__(self, horizons: Sequence[float], sigma: float, tolerance: float) -> None:
        self._horizons, self._sigma, self._tolerance = tuple(horizons), sigma, tolerance
        self._past: dict[tuple[Moment, float], PastReadings] = {}
        self._awaited: list[tuple[float, Moment, float]] = []
        self._location: str | None = None
        self._entered: float | None = None
        self._moments: list[tuple[float, Moment | None]] = []
        self._counted: dict[Moment, float] = {}
        self._now = -inf

    def follow(self, time: float, location: str | None, measured: float | None) -> None:
        """A scan at `time` (s): where the machine is (None: not known), and its good reading (degC) or None."""
        if time < self._now:
            # The clock was set back: what is awaited would come twice.
            self._awaited, self._location, self._moments, self._counted = [], None, [], {}
        self._now = time
        self._settle(time, measured)
        if location != self._location:
            # Of one that was not seen to begin nobody knows how long it has lasted.
            self._entered = time if location is not None and self._location is not None else None
            self._location = location
        moment = None
        if location is not None and self._entered is not None:
            moment = location, bisect_right(STAY_EDGES_S, time - self._entered)
        if not self._moments or moment != self._moments[-1][1]:
            self._moments = [*self._moments[-1:], (time, moment)]
            if moment is not None and time - self._counted.get(moment, -inf) >= SPACING_S:
                self._counted[moment] = time
                self._awaited += [(time + horizon, moment, horizon) for horizon in self._horizons]

    def _settle(self, time: float, measured: float | None) -> None:
        left = []
        for due, moment, horizon in self._awaited:
            late = time - due
            if 0.0 <= late <= self._tolerance and measured is not None and isfinite(measured):
                key = (moment, horizon)
                self._past[key] = self._past.get(key, PastReadings()).take(measured)
            elif late <= self._tolerance:
                left.append((due, moment, horizon))
        self._awaited = left

    def hold(self, time: float, medians: Mapping[float, float]) -> tuple[HeldAgainstPast | None, ...]:
        """A forecast's medians (degC, by horizon in s) that was begun at `time`, each beside what came after the like.

        None where too few are known.
        """
        moment = next((moment for since, moment in reversed(self._moments) if since <= time), None)
        found: list[HeldAgainstPast | None] = []
        for horizon, median in medians.items():
            past = PastReadings() if moment is None else self._past.get((moment, horizon), PastReadings())
            sigma = max(past.sigma, self._sigma)
            if past.moments < MIN_MOMENTS or not sigma > 0.0:
                found.append(None)
                continue
            deviations = (median - past.mean) / sigma
            found.append(HeldAgainstPast(horizon, past.moments, past.mean, sigma, deviations))
        return tuple(found)

    def snapshot(self) -> list[list[Any]]:
        """What was measured, as JSON can carry it. What is awaited and the present stay begin anew."""
        return [
            [*moment, horizon, past.moments, past.mean, past.squares] for (moment, horizon), past in self._past.items()
        ]

    def restore(self, saved: Sequence[Sequence[Any]]) -> None:
        """Go on from a snapshot, for the horizons that are still asked for. Raises TypeError or ValueError."""
        for location, stay, horizon, moments, mean, squares in saved:
            if horizon in self._horizons:
                past = PastReadings(int(moments), float(mean), float(squares))
                self._past[(str(location), int(stay)), float(horizon)] = past
