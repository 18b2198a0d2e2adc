"""The forecast beside the scan: made in a thread every period, recalibrated by the readings that came true."""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from math import inf, isfinite
from typing import Any

import numpy as np

from drivers.supervision import Supervisor
from gateway.machine.model.ensemble import Ensemble, ForecastJob, MixedForecast, bands, foresee, run_job
from gateway.machine.model.predict import Predictor
from gateway.machine.reading import Scan
from gateway.settings import ForecastSection
from sim.forecast import (
    FAN_LEVELS,
    Calibration,
    Forecast,
    Horizon,
    PendingForecast,
    factors,
    issue,
    recent_coverage,
    settle,
    thin_levels,
    widening_factors,
)

COVERAGE_AFTER = 5.0
"""So many independent forecasts must have matured before how often a band holds is said."""
FRESH_PERIODS = 3.0
"""A forecast older than three of its periods (of scans, where these are rarer) is not used any more."""
MAX_POSTPONED_PERIODS = 0.5
"""So late a forecast begins at most while scans are skipped. One that may be used stays so until the next is made: that
may take one and a half periods then, no less than where each begins when the one before it is done."""


@dataclass(frozen=True, slots=True)
class FinishedForecast:
    """A finished forecast, and the reading when it was begun (degC; None if there was none)."""

    forecast: Forecast
    measured: float | None


class Outlook:
    """The newest forecast of one predictor; at most one is being made at a time, and scans never wait for it.

    Runs are drawn from the clock and the configured seed, so that a replay of the same beliefs gives the same fans.
    `levels` are those of its fans, FAN_LEVELS among them; whoever scores them wants more. `turns` are taken with the
    forecasts of other machines, so that few are made at once. Of `postponed` ones the scans were behind when they were
    due.
    """

    def __init__(
        self,
        predictor: Predictor,
        section: ForecastSection,
        limit: float,
        scan_period: float,
        ensemble: Ensemble | None = None,
        *,
        levels: tuple[float, ...] = FAN_LEVELS,
        supervisor: Supervisor | None = None,
        turns: asyncio.Semaphore | None = None,
    ) -> None:
        self._supervisor, self._turns = supervisor or Supervisor(), turns
        self.predictor, self.section, self.limit = predictor, section, limit
        self.ensemble, self.levels = ensemble, levels
        self.latest: Forecast | None = None
        self.made = self.postponed = 0
        self.calibration: Calibration = bands(predictor.model, section, scan_period, member=ensemble is not None)
        self._task: asyncio.Task[Forecast | MixedForecast] | None = None
        self._usable_s = FRESH_PERIODS * max(section.period, scan_period)
        self._due = self._postponed_from = -inf
        self._void = False
        self._measured: float | None = None

    def coverage(self) -> list[float | None]:
        """By horizon the share of recent 90 % bands that held what came; None before enough have matured."""
        published = self.ensemble.joint if self.ensemble is not None else self.calibration
        return [
            recent_coverage(published, horizon) if state.worth >= COVERAGE_AFTER else None
            for horizon, state in published.horizons.items()
        ]

    @property
    def busy(self) -> bool:
        """Whether a forecast is being made, or waits to be collected."""
        return self._task is not None

    def settle(self, time: float, measured: float | None) -> None:
        """A reading came (or did not): forecasts that were due are scored, and the bands learn."""
        self.calibration = settle(self.calibration, time, float("nan") if measured is None else measured)

    def band_factor(self, ahead: float) -> float:
        """By how much a band of the model itself is to be widened `ahead` s after a reading, 1 or more.

        As its forecasts' bands are, by what has come true of them; beyond the last horizon as at that.
        """
        own = factors(self.calibration, integral=self.ensemble is None)
        return max(float(widening_factors(own, np.array([ahead]))[0]), 1.0)

    def void(self) -> None:
        """What was believed is no longer known: forget the forecast, and the one being made."""
        self.latest, self._void, self._due = None, self._task is not None, -inf

    def fresh(self, now: float) -> Forecast | None:
        """The newest forecast while it may be used."""
        usable = self.latest is not None and now - self.latest.time <= self._usable_s
        return self.latest if usable else None

    def collect(self) -> FinishedForecast | None:
        """A forecast that has just been finished, once. Raises what the computation raised."""
        task = self._task
        if task is None or not task.done():
            return None
        self._task = None
        made, void, self._void = task.result(), self._void, False
        if void:  # it began from what was given up while it was computed
            return None
        if isinstance(made, MixedForecast):
            # The first model's bands learn from its own forecast, as those of the others do from theirs: a band that
            # learned from the mixture would take the others' errors for its own.
            own = made.members[0]
            if self.ensemble is not None and isinstance(own, Forecast):
                self.calibration = issue(self.calibration, thin_levels(own, FAN_LEVELS))
                self.ensemble.take(made, made.mixed.time)
            made = made.mixed
        else:
            self.calibration = issue(self.calibration, thin_levels(made, FAN_LEVELS))
        self.latest, self.made = made, self.made + 1
        return FinishedForecast(made, self._measured)

    def follow(self, scan: Scan, measured: float | None) -> None:
        """Move the other models of an ensemble on; nothing without one."""
        if self.ensemble is not None:
            self.ensemble.follow(scan, measured)

    def begin(self, now: float, *, known: bool, measured: float | None, behind: bool = False) -> None:
        """Start a forecast in a thread if one is due, none is running and the state of the plant is known.

        Where the scans are `behind`, it waits: readings, alarms and blocks go first.
        """
        belief = self.predictor.belief
        if self._task is not None or now < self._due or not known or belief is None or not belief.seen:
            return
        if behind and self.fresh(now) is not None and now < self._due + MAX_POSTPONED_PERIODS * self.section.period:
            self.postponed += self._postponed_from != self._due
            self._postponed_from = self._due
            return
        # Counted from its beginning, however long it takes: a slow machine makes fewer forecasts and never a queue.
        self._due, self._measured = now + self.section.period, measured
        seed = (self.section.seed, int(belief.time * 1000.0))
        own = factors(self.calibration, integral=self.ensemble is None)
        widening = own if self.ensemble is None else self.ensemble.widen(own)
        job = ForecastJob(self.predictor.tracker, belief, widening, self.calibration, seed)
        # What the thread computes with is bound here, in the loop: beliefs and weights move on with the next scan.
        work: Callable[[], Forecast | MixedForecast]
        if (ensemble := self.ensemble) is None:
            work = partial(run_job, job, self.section, self.limit, self.levels)
        else:
            work = partial(
                foresee,
                job,
                ensemble.jobs(),
                shares=ensemble.shares(ensemble.context),
                context=ensemble.context,
                section=self.section,
                limit=self.limit,
                levels=self.levels,
            )
        self._task = self._supervisor.job("forecast", work, self._turns)

    async def finish(self) -> None:
        """Wait for the forecast being made, if any; the next `collect` gives it. For a clock that is not the wall's."""
        if self._task is not None:
            await asyncio.wait([self._task])

    async def close(self) -> None:
        """Wait for the forecast being made; its result is dropped."""
        if self._task is not None:
            await asyncio.gather(self._task, return_exceptions=True)
            self._task = None

    def snapshot(self) -> dict[str, Any]:
        """What the bands have learned, as JSON can carry it."""
        return {f"{horizon:g}": one.plain() for horizon, one in self.calibration.horizons.items()}

    def restore(self, saved: Mapping[str, Any], now: float) -> None:
        """Go on from a snapshot at `now` (s), for the horizons that are still configured. Raises KeyError or TypeError.

        What it awaits beyond its horizon was made under a clock that was ahead: it would keep all others waiting.
        """
        horizons = dict(self.calibration.horizons)
        for text, one in saved.items():
            if float(text) in horizons:
                pending = tuple(PendingForecast(**item) for item in one["pending"])
                pending = tuple(each for each in pending if each.due <= now + float(text))
                counts, shape = tuple(one["counts"]), tuple(one.get("shape", ()))
                kept = {**one, "counts": counts, "shape": shape, "pending": pending, "last": min(one["last"], now)}
                horizons[float(text)] = Horizon(**kept)
        section = self.calibration
        self.calibration = Calibration(horizons, section.memory, section.weight, section.tolerance)


def limit_probability(made: Forecast, horizon: float) -> float:
    """The probability of reaching the limit within the horizon that is nearest to `horizon` (s)."""
    return made.exceedance[_column(made, horizon)].probability


def _column(made: Forecast, horizon: float) -> int:
    apart = [abs(own - horizon) for own in made.horizons.tolist()]
    return apart.index(min(apart))


def block_values(made: Forecast, horizon: float, now: float) -> dict[str, float | None]:
    """The block's fields that a forecast fills, brought to `now`: horizon and minutes have shrunk since it was made."""
    column = _column(made, horizon)
    by_level = dict(zip(made.levels, made.quantiles[:, column].tolist(), strict=True))
    # The forecast is of fixed moments: as time goes on they come nearer, and the quantiles stay as they are.
    elapsed = now - made.time
    minutes = [max(left - elapsed / 60.0, 0.0) if isfinite(left) else inf for left in made.minutes_to_limit]
    return {
        "horizon": max(float(made.horizons[column]) - elapsed, 0.0),
        "horizon_low": by_level[0.05],
        "horizon_median": by_level[0.5],
        "horizon_high": by_level[0.95],
        "p_limit": made.exceedance[column].probability,
        "minutes_low": minutes[0],
        "minutes_median": minutes[1],
        "minutes_high": minutes[2],
    }
