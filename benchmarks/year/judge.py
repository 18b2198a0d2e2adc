"""The judge: what each arm's model forecasts along a day that it has not seen, against what came."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.year.plant import LIMIT, PERIOD, TEMPERATURE, Day, overheated
from gateway.machine.model import forecast_trace
from gateway.settings import ForecastSection
from sim.forecast import DENSE_LEVELS
from sim.lab.learning import clean_readings
from sim.scores import crps_quantiles
from sim.sha import Model

LOW, MEDIAN, HIGH = (DENSE_LEVELS.index(level) for level in (0.05, 0.5, 0.95))
HORIZONS = (60.0, 300.0, 900.0)
EACH, RUNS = 300.0, 150
"""s between two forecasts, and runs of each."""
P_ALARM = 0.5
"""The chance of the limit within the longest horizon at which an alarm is raised."""
TRUE_WITHIN = 1200.0
"""s: an alarm is false where the bearing does not come to the limit within what it spoke of and a third more."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DayScore:
    """An arm's day: MAE and CRPS (degC) and coverage of the 90 % band by horizon, and its alarms.

    `overheated` counts how often the limit was reached, `leads` (s) are from the first true alarm to it, by event that
    had one; `false` counts the alarms after which it was not reached.
    """

    arm: str
    month: int
    day: float
    mae: tuple[float, ...]
    crps: tuple[float, ...]
    coverage: tuple[float, ...]
    overheated: int
    leads: tuple[float, ...]
    false: int
    alarms: int


def day_score(arm: str, model: Model, day: Day, *, seed: int) -> DayScore:
    """The day forecast as the running gateway would have, every EACH s."""
    section = ForecastSection(horizons=HORIZONS, period=EACH, runs=RUNS, seed=seed)
    made = forecast_trace([model], day.trace, section, scan_period=PERIOD, limit=LIMIT)
    outcomes = clean_readings(day.trace.times, day.trace.signals[TEMPERATURE], model.alphabet.gap)
    errors: list[list[tuple[float, float, bool]]] = [[] for _ in HORIZONS]
    for forecast in made:
        for column, horizon in enumerate(HORIZONS):
            came = outcomes.interpolate(forecast.time + horizon)
            fan = forecast.quantiles[:, column]
            if came is not None and np.all(np.isfinite(fan)):
                crps = float(crps_quantiles(DENSE_LEVELS, fan, came))
                errors[column].append((abs(fan[MEDIAN] - came), crps, bool(fan[LOW] <= came <= fan[HIGH])))
    means = [np.mean(rows, axis=0) if rows else np.full(3, np.nan) for rows in errors]
    moments = overheated(day.trace)
    raised = _raised([(each.time, each.exceedance[-1].probability >= P_ALARM) for each in made], moments)
    true = [[moment - time for time in raised if 0.0 <= moment - time <= TRUE_WITHIN] for moment in moments]
    false = [time for time in raised if not any(0.0 <= moment - time <= TRUE_WITHIN for moment in moments)]
    return DayScore(
        arm=arm,
        month=day.month,
        day=day.number,
        mae=tuple(float(mean[0]) for mean in means),
        crps=tuple(float(mean[1]) for mean in means),
        coverage=tuple(float(mean[2]) for mean in means),
        overheated=len(moments),
        leads=tuple(max(leads) for leads in true if leads),
        false=len(false),
        alarms=len(raised),
    )


def _raised(met: Sequence[tuple[float, bool]], moments: Sequence[float]) -> list[float]:
    """When an alarm is raised; what is raised within the hour after the limit was reached tells nobody anything."""
    begun, before = list[float](), False
    for time, now in met:
        if now and not before and not any(0.0 < time - moment < 3600.0 for moment in moments):
            begun.append(time)
        before = now
    return begun
