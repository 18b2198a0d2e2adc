"""Mode parameters of long stays, drawn where a rare event needs them and weighted back (importance sampling).

A mode parameter m that is drawn once for a long stay is no matter of small steps: among some hundred runs none has the
m five standard deviations out by which the event comes, and splitting (`sim.lab.checking.smc.splitting.estimator`)
cannot make one. So runs that are split draw the standard scores z of such m from laws N(mean, 1), the means found in
pilots as those of z given the event, and carry the logarithm of the density ratio, the sum of log N(z; 0, 1) -
log N(z; mean, 1).
"""

from dataclasses import dataclass

import numpy as np
import scipy

from sim.sha import Array, Distribution

MAX_TILTED_STAYS = 6
"""Stays whose m is drawn so, at most: those on which m has the greatest effect."""

MIN_EFFECT_SHARE = 0.2
"""Stays with less than this share of the greatest effect are left alone: their m is one noise among others."""


@dataclass(frozen=True, slots=True)
class Tilts:
    """The laws N(mean, 1) of K standard scores, `mean` (K,). Being no narrower than chance's own, they leave no
    region out that would be missed for long and then weigh much."""

    mean: Array

    def scores(self, column: int, runs: int, rng: np.random.Generator) -> Array:
        """(runs,) standard scores of one mode parameter."""
        drawn: Array = self.mean[column] + rng.standard_normal(runs)
        return drawn

    def log_weights(self, drawn: Array) -> Array:
        """(runs,) the logarithm of how much more often chance draws these scores (runs, K); nan: not drawn yet."""
        # -z^2/2 + (z - mean)^2/2 of each score; one that is not drawn yet has neither law to be weighed between.
        return np.asarray(np.nansum(self.mean * (0.5 * self.mean - drawn), axis=1))

    def surplus(self, drawn: Array) -> Array:
        """(runs,) how far that logarithm lies above its mean under these laws."""
        return np.asarray(np.nansum(self.mean * (self.mean - drawn), axis=1))


def neutral(columns: int) -> Tilts:
    """The laws that chance itself has."""
    return Tilts(np.zeros(columns))


def fit_tilts(drawn: Array) -> Tilts:
    """The laws with the means of scores (runs, K) that led to the event."""
    # The mean of the scores given the event minimises the cross-entropy to their law there (Rubinstein 1999), among
    # normal laws of unit width.
    seen = np.isfinite(drawn)
    return Tilts(np.where(seen, drawn, 0.0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1))


def balance(tilts: Tilts, drawn: Array, spent: Array, least: float) -> float:
    """The part of the weight, from `least` to 1, with which runs at a level keep the mean scores that the laws have.

    A level nearer than the event is reached with smaller scores; with the whole weight they would take over there.
    `drawn` (runs, K) are the scores of those that reached it, `spent` the logarithm that was given back before.
    """
    whole, surplus = tilts.log_weights(drawn), tilts.surplus(drawn)

    def excess(part: float) -> float:
        owed = part * whole - spent
        return float(np.average(surplus, weights=np.exp(owed - owed.max())))

    if excess(least) >= 0.0:
        return least
    return 1.0 if excess(1.0) <= 0.0 else float(scipy.optimize.brentq(excess, least, 1.0, xtol=1e-3))


def tilt_distance(before: Tilts, after: Tilts) -> float:
    """The greatest difference of the means, in standard deviations of the scores."""
    return float(np.max(np.abs(before.mean - after.mean), initial=0.0))


def tiltable(law: Distribution | None) -> bool:
    """Whether m is drawn by a normal law, whose scores can be drawn elsewhere."""
    return law is not None and law.kind == "normal" and law.params["sigma"] > 0


def mode_value(law: Distribution, scores: Array) -> Array:
    """m of a normal law at these standard scores."""
    return np.asarray(law.params["mu"] + law.params["sigma"] * scores)


def choose_stays(effects: Array) -> list[int]:
    """The places of the greatest effects, in order: at most MAX_TILTED_STAYS, none below MIN_EFFECT_SHARE of the
    greatest."""
    if not effects.size or effects.max() <= 0:
        return []
    best = np.argsort(-effects, kind="stable")[:MAX_TILTED_STAYS]
    return sorted(best[effects[best] >= MIN_EFFECT_SHARE * effects.max()].tolist())
