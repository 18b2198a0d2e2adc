"""Drift: whether the model's free run is too far off on several cycles running, by its own band or by a set limit.

A cycle goes from one start of the machine to the next. Its free run begins with the first reading after the start and
is never corrected. Each reading's error is divided by what is allowed there: the configured limit, or half the 90 %
band that the model itself gives to the free run at that moment, widened by its calibration. A cycle is beyond its limit
where the root mean square of that is above 1: a wide band in one location hides no error in another. A model that is
right passes that on one cycle in ten at most, and on three running once in a thousand.
"""

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from gateway.machine.model.predict import ScanPrediction
from sim.forecast import Z90
from sim.sha import Model, Switch

MIN_CYCLE_READINGS = 20
"""Readings below which a cycle says nothing."""


@dataclass(frozen=True, slots=True)
class DriftRule:
    """What counts as a start and as too far off.

    `starts` and `stops` are the symbols of the machine's switch. `limit` (degC) is None for the model's own band, and
    `horizons` (s) and `factors` are then what the band is multiplied by.
    """

    starts: str
    stops: str
    limit: float | None
    horizons: tuple[float, ...]
    factors: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class CycleDrift:
    """What is known up to now; plain values, so that JSON can carry them.

    `running` counts the cycles at the end that were beyond their limit, `error` (degC, root mean square) and `limit`
    (`cycle_limit`) are those of the last whole cycle (None before one). Of the present cycle: `begun` (s UTC, None
    before the first start), the newest symbol of the switch, `readings`, and the sums of squares of the errors,
    `missed` (degC^2), and of the errors over what was allowed, `beyond`.
    """

    running: int = 0
    error: float | None = None
    limit: float | None = None
    begun: float | None = None
    symbol: str = ""
    readings: int = 0
    missed: float = 0.0
    beyond: float = 0.0


def make_drift_rule(model: Model, limit: float | None) -> DriftRule | None:
    """The rule for a model; None where its alphabet has no switch, so that nothing says when a cycle begins."""
    switch = next((channel for channel in model.alphabet.channels if isinstance(channel, Switch)), None)
    if switch is None:
        return None
    horizons = tuple(sorted(model.calibration))
    factors = tuple(max(model.calibration[horizon], 1.0) for horizon in horizons)
    return DriftRule(switch.rising, switch.falling, limit, horizons, factors)


def cycle_limit(missed: float, beyond: float) -> float | None:
    """What is allowed (degC) where a cycle's errors are, to which the root mean square of these is held.

    From the sums of squares of the errors (degC^2) and of the errors over what was allowed; None without any error.
    """
    return sqrt(missed / beyond) if beyond > 0 else None


def follow_cycle(rule: DriftRule, drift: CycleDrift, prediction: ScanPrediction) -> CycleDrift:
    """What is known after a scan: a start closes the cycle before it, a good reading counts to the present one."""
    for event in prediction.events:
        if event.symbol == rule.starts and drift.symbol != rule.starts:
            # The start ends the cycle before it. One with too few readings is forgotten and not judged, it neither
            # counts nor breaks a run: a cycle that was begun by mistake must not clear the alarm.
            running, error, limit = drift.running, drift.error, drift.limit
            if drift.begun is not None and drift.readings >= MIN_CYCLE_READINGS:
                error, limit = sqrt(drift.missed / drift.readings), cycle_limit(drift.missed, drift.beyond)
                running = drift.running + 1 if drift.beyond > drift.readings else 0
            drift = replace(
                drift,
                running=running,
                error=error,
                limit=limit,
                begun=event.time,
                readings=0,
                missed=0.0,
                beyond=0.0,
            )
        if event.symbol in (rule.starts, rule.stops):
            drift = replace(drift, symbol=event.symbol)
    p = prediction
    if drift.begun is None or p.measured is None or p.free_run is None or p.free_sigma is None or not p.known:
        return drift
    if rule.limit is not None:
        allowed = rule.limit
    else:
        # The free run's age is the horizon of its forecast: the factor that the band needs there, held at the ends.
        factor = float(np.interp(p.time - drift.begun, rule.horizons, rule.factors)) if rule.horizons else 1.0
        allowed = Z90 * factor * p.free_sigma
        if allowed <= 0.0:
            return drift
    missed = p.measured - p.free_run
    return CycleDrift(
        running=drift.running,
        error=drift.error,
        limit=drift.limit,
        begun=drift.begun,
        symbol=drift.symbol,
        readings=drift.readings + 1,
        missed=drift.missed + missed**2,
        beyond=drift.beyond + (missed / allowed) ** 2,
    )
