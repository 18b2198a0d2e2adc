"""What was measured after like moments: against its mean and standard deviation a forecast is held (3 sigma).

Moments are alike in which the machine had been in the same location about as long, to a factor of two. Each counts,
from a stay's beginning to its end: a stay's first ones say nothing of a machine that has cooled since. But neighbouring
ones err together, and a machine that goes to and fro between two locations tells nothing new each time: all of an hour
are one piece of evidence.
"""

from bisect import bisect_right
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite, sqrt
from typing import Any

from sim.forecast.review import REVIEW_SIGMAS

STAY_EDGES_S = tuple(300.0 * 2.0**doubled for doubled in range(9))
"""Seconds since a location was entered at which a stay is no longer like a shorter one: 5 minutes to 21 hours."""
SAMPLE_S = 60.0
"""Seconds between two moments that are looked at."""
SPACING_S = 3600.0
"""Seconds within which all like moments are one piece of evidence."""
MIN_MOMENTS = 20
"""Moments, an hour apart, below which mean and standard deviation say nothing: by so many 3 sigma is left once in 125
times."""

Moment = tuple[str, int]
"""A location, and how many of STAY_EDGES_S the stay has passed."""


@dataclass(frozen=True, slots=True)
class PastReadings:
    """So many `readings` that came a horizon after like moments: of how many `moments` an hour apart, their `mean`
    in degC.
    """

    moments: int = 0
    readings: int = 0
    mean: float = 0.0
    squares: float = 0.0

    def take(self, reading: float, *, counts: bool) -> "PastReadings":
        """With one more reading (degC), which `counts` as a moment of its own if none of its hour has."""
        readings, off = self.readings + 1, reading - self.mean
        mean = self.mean + off / readings
        return PastReadings(self.moments + counts, readings, mean, self.squares + off * (reading - mean))

    @property
    def sigma(self) -> float:
        """The standard deviation over the readings, as so many moments tell it; 0 for fewer than two."""
        return sqrt(self.squares / self.readings * self.moments / (self.moments - 1)) if self.moments > 1 else 0.0


@dataclass(frozen=True, slots=True)
class HeldAgainstPast:
    """A forecast's median at a `horizon` (s): `deviations` times `sigma` above the `mean` (degC) of the `moments`."""

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
        self._awaited: dict[float, deque[tuple[float, Moment]]] = {horizon: deque() for horizon in self._horizons}
        self._location: str | None = None
        self._lost: float | None = -inf
        self._entered: float | None = None
        self._moments: list[tuple[float, Moment | None]] = []
        self._sampled = -inf
        self._counted: dict[tuple[Moment, float], float] = {}
        self._now = -inf

    def follow(self, time: float, location: str | None, measured: float | None) -> None:
        """A scan at `time` (s): where the machine is (None: not known), and its good reading (degC) or None."""
        if time < self._now:
            # The clock was set back: what is awaited would come twice.
            self._awaited = {horizon: deque() for horizon in self._horizons}
            self._lost, self._moments, self._sampled, self._counted = -inf, [], -inf, {}
        self._now = time
        self._settle(time, measured)
        if location is None:
            self._lost = time if self._lost is None else self._lost
        else:
            # Over a moment's doubt a stay goes on; of one that was not seen to begin nobody knows how long it lasts
            seen = self._lost is None or time - self._lost <= max(SAMPLE_S, self._tolerance)
            if location != self._location or not seen:
                self._entered = time if seen else None
            self._location, self._lost = location, None
        moment = None
        if location is not None and self._entered is not None:
            moment = location, bisect_right(STAY_EDGES_S, time - self._entered)
        changed = not self._moments or moment != self._moments[-1][1]
        if changed:
            self._moments = [*self._moments[-1:], (time, moment)]
        if moment is not None and (changed or time - self._sampled >= SAMPLE_S):
            self._sampled = time
            for horizon, awaited in self._awaited.items():
                awaited.append((time + horizon, moment))

    def _settle(self, time: float, measured: float | None) -> None:
        good = measured is not None and isfinite(measured)
        for horizon, awaited in self._awaited.items():
            while awaited and awaited[0][0] <= time:
                due, moment = awaited[0]
                in_time = time - due <= self._tolerance
                if in_time and not good:
                    break  # the next one may be good
                awaited.popleft()
                if in_time and measured is not None:
                    key = (moment, horizon)
                    counts = due - self._counted.get(key, -inf) >= SPACING_S
                    self._counted[key] = due if counts else self._counted[key]
                    self._past[key] = self._past.get(key, PastReadings()).take(measured, counts=counts)

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
            [*moment, horizon, past.moments, past.readings, past.mean, past.squares]
            for (moment, horizon), past in self._past.items()
        ]

    def restore(self, saved: Sequence[Sequence[Any]]) -> None:
        """Go on from a snapshot, for the horizons that are still asked for. Raises TypeError or ValueError."""
        for location, stay, horizon, moments, readings, mean, squares in saved:
            if horizon in self._horizons:
                past = PastReadings(int(moments), int(readings), float(mean), float(squares))
                self._past[(str(location), int(stay)), float(horizon)] = past
