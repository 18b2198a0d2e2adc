"""Transients: what is over some time after an event, in a location whose level is drawn anew on entry.

Where X jumps at an event, the readings of one stay are level + A exp(-u / tau), u being the seconds since entry. The
level is the stay's own, so that A is told by how readings of one stay differ: least squares within stays (the "within"
estimator of panel data; Wooldridge 2010, 10.5), and nothing is assumed of which levels belong together. One tau serves
all locations. A location has an amplitude only where its stays show one: by a t-test with the sandwich variance, each
stay being a cluster.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from sim.lab.learning import FreeRuns, Indices
from sim.lab.learning.lsha.segments import find_next_stays
from sim.sha import Array

COARSE, FINEST = 12, 1.03
"""Time constants of a grid, and the ratio of neighbours at which it is fine enough."""


@dataclass(frozen=True, slots=True)
class TransientLaw:
    """The shared `tau` (s), and what makes an amplitude count: `n_min` stays, and the error rate `alpha` of all
    locations together."""

    tau: float
    alpha: float
    n_min: int

    def amplitudes(self, runs: FreeRuns, size: int) -> Array:
        """(L,) how far X is from its stay's level on entry, for the places 0..`size` - 1; 0 where stays show none."""
        return self.estimates(runs, size)[0]

    def estimates(self, runs: FreeRuns, size: int) -> tuple[Array, Array]:
        """((L,) amplitudes, 0 where stays show none; (L,) their standard errors, 0 there too)."""
        within = _within_stays(runs, self.tau)
        amplitude, product = _slopes(within, size)
        score = np.bincount(within.stay, within.fading * (within.reading - amplitude[within.place] * within.fading))
        shown = np.bincount(within.stay, within.fading**2) > 0.0
        place = np.zeros(score.size, dtype=np.intp)
        place[within.stay] = within.place
        stays = np.bincount(place[shown], minlength=size)
        freedom = np.maximum(stays - 1.0, 1.0)
        # The sandwich with the correction for few clusters: readings of one stay resemble each other.
        squares = np.bincount(place[shown], score[shown] ** 2, size) * stays / freedom
        with np.errstate(divide="ignore", invalid="ignore"):
            error = np.sqrt(squares) / product
            p = 2.0 * scipy.special.stdtr(freedom, -np.abs(amplitude / error))
        asked = (stays >= self.n_min) & (product > 0.0)
        # Bonferroni over the locations that were asked.
        supported = asked & (p < self.alpha / max(int(asked.sum()), 1))
        return np.where(supported, amplitude, 0.0), np.where(supported, error, 0.0)

    def remove_transients(self, runs: FreeRuns, amplitude: Array) -> FreeRuns:
        """The runs without their transients: `amplitude` (L,) by place."""
        _, place = find_next_stays(runs)
        return replace(runs, reading=runs.reading - amplitude[place] * np.exp(-_ages(runs) / self.tau))


def transient_law(runs: FreeRuns, size: int, alpha: float, n_min: int) -> TransientLaw | None:
    """The law of least squares within stays, every place having an amplitude; None where no stay has two readings.

    tau lies between half the usual time from reading to reading and a third of the time by which nine of ten stays are
    over: outside of that a transient is a single reading, or a drift.
    """
    known = np.flatnonzero(np.isfinite(runs.reading))
    stay = find_next_stays(runs)[0][known]
    gap = np.diff(runs.time[known])[(stay[1:] == stay[:-1]) & (np.diff(runs.time[known]) > 0)]
    if not gap.size:
        return None
    least = 0.5 * float(np.median(gap))
    taus = np.geomspace(least, max(float(np.quantile(_ages(runs)[known], 0.9)) / 3.0, 2.0 * least), COARSE)
    # A grid, and ever finer ones about its best point.
    while True:
        losses = []
        for tau in taus:
            within = _within_stays(runs, tau)
            losses.append(float(np.sum((within.reading - _slopes(within, size)[0][within.place] * within.fading) ** 2)))
        best = int(np.argmin(losses))
        low, high = taus[max(best - 1, 0)], taus[min(best + 1, taus.size - 1)]
        if high < FINEST**2 * low:
            return TransientLaw(float(taus[best]), alpha, n_min)
        taus = np.geomspace(low, high, COARSE)


@dataclass(frozen=True, slots=True)
class _Within:
    """Readings and exp(-u / tau), each less its mean over the stay, with their stay and place; all (N,)."""

    reading: Array
    fading: Array
    stay: Indices
    place: Indices


def _within_stays(runs: FreeRuns, tau: float) -> _Within:
    known = np.isfinite(runs.reading)
    stay, place = find_next_stays(runs)
    _, stay = np.unique(stay[known], return_inverse=True)
    count = np.bincount(stay)
    reading, fading = (column[known] for column in (runs.reading, np.exp(-_ages(runs) / tau)))
    reading, fading = (column - (np.bincount(stay, column) / count)[stay] for column in (reading, fading))
    # What rounding leaves of a stay's single reading is not told from 0.
    fading = np.where(count[stay] > 1, fading, 0.0)
    return _Within(reading, fading, stay, place[known])


def _slopes(within: _Within, size: int) -> tuple[Array, Array]:
    """((L,) amplitudes by least squares, 0 where nothing tells one; (L,) the sums of squares they stand on)."""
    product = np.bincount(within.place, within.fading**2, size)
    total = np.bincount(within.place, within.fading * within.reading, size)
    return np.divide(total, product, out=np.zeros(size), where=product > 0.0), np.asarray(product, dtype=float)


def _ages(runs: FreeRuns) -> Array:
    """(n,) seconds since the last event at each knot, after the events of its instant."""
    follows = np.append(runs.run[1:] == runs.run[:-1], False)
    return np.where(follows, np.append(runs.age[1:], 0.0), runs.age + runs.dt)
