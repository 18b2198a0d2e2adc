"""The law of a heat that comes late (`kind.LatePart`), written once: a diagnosis and all engines take it from here.

Its deviation D from what is held at once jumps where the source does, stays for the delay, and then fades with the lag:

    D after a reading = D before it - (source after - source before)
    what a jump at t leaves of itself at t + u is all of it for u < delay, then exp(-(u - delay) / lag) of it

so that D is known from the signals alone: the sum of the jumps that still wait, and a deviation that fades. Before the
first reading nothing is known and D is 0, and so it is after it: the source counts as if it had been there for ever.
"""

import numpy as np

from sim.effects.kind import Signals
from sim.effects.kinds import effect_kind, heat_lag
from sim.sha import Array, Effect

SETTLED_LAGS = 30.0
"""Lags after which nothing is left of a deviation: a share of 1e-13."""


def late_source(effect: Effect, signals: Signals) -> Array:
    """The heat (degC/s) that an effect with a lag holds at once; NaN where its signals were not read."""
    late = effect_kind(effect).late
    if late is None:
        raise ValueError(f"effects of the kind {effect.kind!r} have no part that comes late")
    return late.source(effect, signals)


def late_jumps(before: Array, after: Array) -> Array:
    """By how much D (degC/s) jumps where its source goes from `before` to `after`: 0 where either was not read."""
    jump = before - after
    return np.where(np.isfinite(jump), jump, 0.0)


def remaining_share(effect: Effect, seconds: Array) -> Array:
    """The share that is left of what fades after so many seconds."""
    return np.asarray(np.exp(-np.asarray(seconds) / heat_lag(effect)))


def late_mean(effect: Effect, seconds: Array) -> Array:
    """The mean of what fades over so many seconds, as a share of what it is at their start; 1 over none."""
    part = np.asarray(seconds) / heat_lag(effect)
    return np.where(part > 0, -np.expm1(-part) / np.where(part > 0, part, 1.0), 1.0)
