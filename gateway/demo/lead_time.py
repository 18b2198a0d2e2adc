"""How long before the limit an alarm comes: the forecast's, persistence's, and a line through the last minutes.

All alarms have the same rules: one is raised when its condition is met and is over when it has not been met for a
while. It is true if the limit is reached soon enough after it, false if not. What comes after a false alarm counts.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from math import nan
from typing import Any

import numpy as np

from gateway.machine.model import forecast_trace
from gateway.settings import ForecastSection
from sim.sha import Array, Mask, Model, Trace, plain_model

AHEAD_S = 900.0
"""What the alarms speak of: the limit is reached within so many seconds."""
TRUE_WITHIN_S = 1200.0
"""An alarm is false if the limit is not reached within so many seconds: what it spoke of, and a third more."""
OFF_S = 60.0
"""Seconds without its condition until an alarm is over, so that what hovers about its threshold is one alarm."""
TREND_S, LEAST_TREND_S = 300.0, 120.0
"""The readings (s) that a trend alarm lays its line through, and the fewest."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmScore:
    """What became of one alarm on one day.

    `lead_s` is from the first true alarm to the limit, `usable_s` from the moment at which a PLC might act on it: None
    if none was true. `missed`: the limit was reached without one. `false` counts the alarms after which the limit was
    not reached in time; `alarm_times` are all (absolute s).
    """

    name: str
    lead_s: float | None
    usable_s: float | None
    missed: bool
    false: int
    raised: tuple[float, ...]

    def plain(self) -> dict[str, Any]:
        """As JSON can carry it."""
        return asdict(self)


def first_crossing(trace: Trace, temperature: str, limit: float) -> float | None:
    """When the reading first reaches the limit (absolute s); None if it never does."""
    reached = np.flatnonzero(trace.signals[temperature] >= limit)
    return float(trace.times[reached[0]]) if reached.size else None


def alarm_times(times: Array, met: Mask) -> tuple[float, ...]:
    """When an alarm is raised whose condition is `met` (n,) or not at `times` (n,)."""
    moments: list[float] = []
    last = -np.inf
    for time in times[met].tolist():
        if time - last > OFF_S:
            moments.append(time)
        last = time
    return tuple(moments)


def score(
    name: str, moments: Sequence[float], reached: float | None, usable: Sequence[float] | None = None
) -> AlarmScore:
    """Score the alarms raised at `moments` on a day on which the limit is `reached` (None: it is not).

    `usable` are the moments from which on a PLC might act, where those are others. What is raised after the limit is
    reached tells nobody anything and does not count.
    """
    counted = tuple(moment for moment in moments if reached is None or moment <= reached)
    true = [moment for moment in counted if reached is not None and reached - moment <= TRUE_WITHIN_S]
    return AlarmScore(
        name=name,
        lead_s=_lead(moments, reached),
        usable_s=_lead(moments if usable is None else usable, reached),
        missed=reached is not None and not true,
        false=len(counted) - len(true),
        raised=counted,
    )


def _lead(moments: Sequence[float], reached: float | None) -> float | None:
    """Seconds from the first true one of the moments to the limit."""
    leads = [] if reached is None else [reached - moment for moment in moments]
    return next((lead for lead in leads if 0 <= lead <= TRUE_WITHIN_S), None)


def trend_alarm(times: Array, readings: Array, limit: float, ahead: float) -> tuple[float, ...]:
    """When a straight line through the last TREND_S reaches the limit within `ahead` seconds (least squares)."""
    met = np.zeros(times.size, dtype=bool)
    begins = np.searchsorted(times, times - TREND_S)
    for row, begin in enumerate(begins.tolist()):
        x, y = times[begin : row + 1] - times[row], readings[begin : row + 1]
        if -x[0] < LEAST_TREND_S:
            continue
        centred = x - x.mean()
        slope = float(centred @ y / (centred @ centred))
        now = float(y.mean() - slope * x.mean())
        met[row] = max(now, now + slope * ahead) >= limit
    return alarm_times(times, met)


@dataclass(frozen=True, slots=True)
class ChancesAlong:
    """The gateway's forecasts along a trace: made at `times` (n,), the `chances` (n, H) of the limit by horizon (s).

    `scans` (m,) are the moments at which an alarm looks, `familiar` (m,) whether a block could be used then: not in
    zone red.
    """

    times: Array
    chances: Array
    horizons: tuple[float, ...]
    scans: Array
    familiar: Mask

    def alarm(self, *, ahead: float, p_limit: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """When an alarm is raised whose condition is a chance above `p_limit` within `ahead` s, one of the horizons.

        The moments at which it is raised, and those from which on its block may be used.
        """
        chances = self.chances[:, self.horizons.index(ahead)]
        # Between two forecasts the older one stands: seen at every scan as the gateway's alarm sees it.
        place = np.searchsorted(self.times, self.scans, side="right") - 1
        stands = np.where(place >= 0, chances[np.maximum(place, 0)] if chances.size else nan, nan) > p_limit
        return alarm_times(self.scans, stands), alarm_times(self.scans, stands & self.familiar)


def forecast_chances(model: Model, trace: Trace, *, limit: float, period: float, scan_period: float) -> ChancesAlong:
    """What the gateway with `model` forecasts along a trace, every `period` s, of the limit."""
    section = ForecastSection(horizons=(60.0, 300.0, AHEAD_S), period=period)
    zones: list[tuple[float, bool]] = []
    made = forecast_trace(
        [model],
        trace,
        section,
        scan_period=scan_period,
        limit=limit,
        seen=lambda prediction: zones.append((prediction.time, prediction.zone != "red")),
    )
    return ChancesAlong(
        times=np.array([forecast.time for forecast in made]),
        chances=np.array([[each.probability for each in forecast.exceedance] for forecast in made]).reshape(-1, 3),
        horizons=section.horizons,
        scans=np.array([time for time, _ in zones]),
        familiar=np.array([known for _, known in zones], dtype=bool),
    )


def rivals(
    model: Model, trace: Trace, *, temperature: str, limit: float, p_limit: float, period: float, scan_period: float
) -> dict[str, tuple[float, ...]]:
    """The alarms that need no knowledge of the machine, along the readings of a trace, by name.

    Persistence is the random walk that the model's own training gave it, at the same chance as the forecast.
    """
    known = np.isfinite(trace.signals[temperature])
    times, readings = trace.times[known], trace.signals[temperature][known]
    alarms: dict[str, tuple[float, ...]] = {}
    for member in model.plain:
        if member.name == "persistence":
            walk = plain_model(model, member)
            seen = forecast_chances(walk, trace, limit=limit, period=period, scan_period=scan_period)
            alarms["persistence"], _ = seen.alarm(ahead=AHEAD_S, p_limit=p_limit)
    for ahead in (AHEAD_S, 300.0):
        name = f"trend, {ahead / 60:.0f} min ahead"
        alarms[name] = trend_alarm(times, readings, limit, ahead)
    return alarms
