"""A fleet: what each of many machines has of its own in the model of their type, and which of them stand out.

Each machine is judged by its own runs alone, so that ten thousand cost ten thousand times as much as one, and can be
judged anywhere.
"""

from collections.abc import Sequence

import numpy as np
import scipy

from sim.learning.correction import CorrectionFit, learn_correction
from sim.learning.machines import MachineSpread
from sim.learning.structure import LearningError
from sim.sha import Array, Model, Trace

LEAST_FLEET = 5
"""Machines below which none is said to stand out: what the others differ by is not known then."""
SURE = 0.01
"""The chance, over the whole fleet, that any machine is said to stand out though all are alike (Holm 1979)."""


def own_targets(model: Model, traces: Sequence[Trace]) -> CorrectionFit:
    """By how much (degC) the targets of one machine lie off those of its type's `model`: `correction.offset`.

    Off by b, an open-loop run is T(t) + b (1 - D(t)): the same course as with a correction T' = T + b, so that its
    regression and its jackknife over runs serve (`learn_correction`). Raises LearningError where fewer than two runs
    are left to learn from, and where they do not tell it.
    """
    (fit,) = learn_correction(model, traces, forms=("offset",)).fits
    if not np.isfinite(fit.offset_error):
        raise LearningError(f"its runs do not tell its targets: {fit.reason}")
    return fit


def outstanding(spread: MachineSpread) -> dict[str, float]:
    """The machines whose targets stand out of the others, with the chance of that in a fleet of machines alike.

    A machine is held against the predictive distribution of the others' offsets (Student's t, for what so few tell of
    the spread between machines), by Holm's step-down over the fleet. One that stands out is not among the others when
    the next is judged, since two would else hide one another. Nothing below LEAST_FLEET machines.
    """
    found: dict[str, float] = {}
    names = list(spread.offsets)
    offset, error = (np.array([each[name] for name in names]) for each in (spread.offsets, spread.errors))
    while len(names) >= LEAST_FLEET:
        chances = _chances(offset, error)
        place = int(np.argmin(chances))
        chance = min(1.0, float(chances[place]) * len(names))
        if chance > SURE:
            break
        found[names.pop(place)] = chance
        offset, error = np.delete(offset, place), np.delete(error, place)
    return found


def _chances(offset: Array, error: Array) -> Array:
    """(n,) two-sided: how probable an offset as far from the others' is, if each machine in turn is one of them.

    The others' spread is `spread_of`'s, whose sums lack one machine after the other.
    """
    weight, centred = 1.0 / error**2, offset - np.median(offset)
    total, square = weight.sum() - weight, (weight**2).sum() - weight**2
    first, second = ((weight * each).sum() - weight * each for each in (centred, centred**2))
    excess = second - first**2 / total - (len(offset) - 2)
    between = np.maximum(excess / (total - square / total), 0.0)
    distance = np.empty(len(offset))
    for place, variance in enumerate(between):
        trust = 1.0 / (variance + error**2)
        trust[place] = 0.0
        mean = trust @ centred / trust.sum()
        distance[place] = abs(centred[place] - mean) / np.sqrt(variance + error[place] ** 2 + 1.0 / trust.sum())
    return np.asarray(2.0 * scipy.special.stdtr(len(offset) - 2, -distance))
