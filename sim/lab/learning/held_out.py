"""Which of several structures to believe: the held-out likelihood of their free runs decides, by cross-validation."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.lab.learning.free_run import HUBER_LIMIT, FitShape, FreeRunFit, fit_at_rates, fit_free_run, huber_loss, predict
from sim.lab.learning.runs import FreeRuns, pieces
from sim.sha import Array, Mask

FOLDS = 5
MIN_PIECES = 10
"""Runs that a cross-validation has at least; long ones are halved for it."""
MIN_READINGS = 20
"""Readings that a cross-validation needs in all: fewer, and the simplest candidate is taken."""
MIN_LOCATION_READINGS = 10
"""Readings in a location from which its target is known well enough for a candidate to be judged there."""


@dataclass(frozen=True, slots=True)
class HeldOutErrors:
    """How one candidate predicts what it was not fitted to: `error` (N,) in degC, and the `run` (N,) of each."""

    error: Array
    run: NDArray[np.intp]

    @property
    def likelihood(self) -> Array:
        """(R,) the mean log-likelihood per reading of each run: Huber's density, at the scale that suits all errors.

        The scale is not the training folds': a candidate would be judged by its opinion of itself.
        """
        scale = huber_scale(self.error)
        # Up to the density's constant, which is the same for all candidates.
        density = np.asarray(-np.log(scale) - huber_loss(np.abs(self.error) / scale))
        return np.bincount(self.run, density) / self.readings

    @property
    def readings(self) -> NDArray[np.intp]:
        """(R,) how many readings each run has."""
        return np.bincount(self.run)

    @property
    def score(self) -> float:
        """Mean log-likelihood per reading."""
        return float(np.average(self.likelihood, weights=self.readings))

    @property
    def rmse(self) -> float:
        """Root mean square free-run error, degC."""
        return float(np.sqrt(np.mean(self.error**2)))

    @property
    def mae(self) -> float:
        """Mean absolute free-run error, degC."""
        return float(np.mean(np.abs(self.error)))


def folds(runs: FreeRuns) -> FreeRuns | None:
    """The runs of a cross-validation, long ones halved until there are MIN_PIECES; None if there are too few data."""
    cut = pieces(runs, MIN_PIECES)
    enough = np.count_nonzero(np.isfinite(cut.reading)) >= MIN_READINGS and np.unique(cut.run).size >= 2
    return cut if enough else None


def judged_part(runs: FreeRuns) -> Mask | None:
    """(n,) the knots of `folds` at which candidates over the same locations can be told apart; None if too few.

    A held-out run is judged up to where it enters a location of which the other folds have fewer than
    MIN_LOCATION_READINGS readings: its target there is the prior's, and that error, which is nobody's, would hide how
    the candidates differ elsewhere (the only rest of a campaign that runs for days).
    """
    order = _fold_order(runs)
    ending = np.isfinite(runs.reading) & ~runs.first
    strange = np.zeros(len(runs), dtype=bool)
    for held in range(min(FOLDS, int(order[-1]) + 1)):
        in_fold = order % FOLDS == held
        taught = (
            np.bincount(runs.place[ending & ~in_fold], minlength=int(runs.place.max()) + 1) >= MIN_LOCATION_READINGS
        )
        strange |= in_fold & ~runs.first & ~taught[runs.place]
    # The free run carries the error on: all that follows in the run goes with it.
    entered = np.cumsum(strange)
    judged = np.asarray(entered == np.maximum.accumulate(np.where(runs.first, entered, 0)))
    rows = judged & np.isfinite(runs.reading)
    return judged if np.count_nonzero(rows) >= MIN_READINGS and np.unique(order[rows]).size >= 2 else None


def _fold_order(runs: FreeRuns) -> NDArray[np.intp]:
    """(n,) the number of each knot's run; run i goes to fold i modulo FOLDS."""
    return np.cumsum(runs.first) - 1


def cross_validate(
    runs: FreeRuns, shape: FitShape, begin: Array, *, fixed: bool = False, judged: Mask | None = None
) -> HeldOutErrors:
    """Fits `shape` to all folds but one and scores its free runs on that one, for each; `begin` (r,) are first rates.

    With `fixed` these rates are kept, which costs a tenth: a rate that all runs share hardly changes without one fold.

    Run i goes to fold i modulo FOLDS, so every fold spans the whole time. The start temperature of a held-out run is
    its own (fitted to it), as in training: the comparison is about the flows, and all candidates are treated alike.
    Only the knots `judged` (n,) are predicted: of each run the beginning, by default all of it.
    """
    order = _fold_order(runs)
    judged = np.ones(len(runs), dtype=bool) if judged is None else judged
    mean = np.full(len(runs), np.nan)
    for held in range(min(FOLDS, int(order[-1]) + 1)):
        in_fold = order % FOLDS == held
        rest, ahead = runs.select(~in_fold), in_fold & judged
        if not ahead.any():
            continue
        if fixed:
            at_rates = fit_at_rates(rest, shape, begin)
            mean[ahead] = predict(runs.select(ahead), shape, at_rates.linear, begin, at_rates.sigma)
        else:
            fit = fit_free_run(rest, shape, begin=begin)
            mean[ahead] = predict(runs.select(ahead), shape, fit.linear, fit.rates, fit.sigma)
    rows = np.flatnonzero(judged & np.isfinite(runs.reading))
    return HeldOutErrors((runs.reading - mean)[rows], np.unique(order[rows], return_inverse=True)[1])


def huber_scale(error: Array) -> float:
    """The scale of greatest likelihood under Huber's density (degC): where the mean of z * min(z, 1.345) is 1.

    0.87 standard deviations of normal errors; gross ones count linearly, not by their squares.
    """
    size = np.abs(error)
    scale = max(float(np.sqrt(np.mean(size**2))), 1e-6)
    for _ in range(50):
        z = size / scale
        scale *= max(float(np.sqrt(np.mean(z * np.minimum(z, HUBER_LIMIT)))), 1e-3)
    return max(scale, 1e-6)


def choose(scores: Sequence[HeldOutErrors], size: Sequence[int]) -> int:
    """The simplest candidate that the held-out likelihood does not tell from the best one.

    Candidates are compared on the same held-out runs; one that is worse than the best by no more than one standard
    error of the mean difference is as good (the one-standard-error rule, Breiman et al. 1984). The folds were fitted to
    mostly the same data, so that the runs' differences are not independent: the error counts 1.5 times as much as
    theirs would (Nadeau & Bengio 2003), or of several candidates a needless one is soon ahead by chance. Among those
    as good the one with the fewest parameters (`size`) is taken, then the one with the higher score.
    """
    # Each score solves for a scale by fifty rounds over all errors: once for each candidate is enough.
    likelihoods = [each.likelihood for each in scores]
    means = [float(np.average(each, weights=rows.readings)) for each, rows in zip(likelihoods, scores, strict=True)]
    best = max(range(len(scores)), key=lambda number: means[number])
    weight = scores[best].readings / scores[best].readings.sum()
    equal: list[int] = []
    for number, likelihood in enumerate(likelihoods):
        gap = likelihoods[best] - likelihood
        mean, error = float(weight @ gap), 0.0
        # Differences run by run: what is hard for all candidates is no part of the error. A single run shows none.
        if gap.size > 1:
            spread = np.sum(weight**2 * (gap - mean) ** 2) * gap.size / (gap.size - 1)
            error = float(np.sqrt(spread * (1.0 + FOLDS / (FOLDS - 1))))
        if mean <= error:
            equal.append(number)
    return min(equal, key=lambda number: (size[number], -means[number]))


def training_errors(runs: FreeRuns, fit: FreeRunFit) -> tuple[float, float]:
    """(rmse, mae) of the free run on the readings that it was fitted to, degC."""
    error = (runs.reading - fit.mean)[np.isfinite(runs.reading)]
    return float(np.sqrt(np.mean(error**2))), float(np.mean(np.abs(error)))
