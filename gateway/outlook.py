"""The forecast beside the scan: made in a thread every period, recalibrated by the readings that came true."""

import asyncio
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from math import inf, isfinite
from typing import Any

import numpy as np

from gateway.config import ForecastSection
from gateway.predict import Predictor
from sim.sha.calibration import Calibration, Horizon, Pending, calibrate, factors, issue, settle
from sim.sha.forecast import Forecast, forecast

FRESH_PERIODS = 3.0
"""A forecast older than three of its periods is not used any more."""


@dataclass(frozen=True, slots=True)
class Made:
    """A finished forecast, and the reading when it was begun (degC; None if there was none)."""

    forecast: Forecast
    measured: float | None


class Outlook:
    """The newest forecast of one predictor; at most one is being made at a time, and scans never wait for it.

    Runs are drawn from the clock and the configured seed, so that a replay of the same beliefs gives the same fans.
    """

    def __init__(self, predictor: Predictor, section: ForecastSection, limit: float, scan_period: float) -> None:
        self.predictor, self.section, self.limit = predictor, section, limit
        self.latest: Forecast | None = None
        self.made = 0
        own = predictor.model.calibration
        known = sorted(own)
        given = {h: float(np.interp(h, known, [own[k] for k in known])) if own else 1.0 for h in section.horizons}
        self.calibration: Calibration = calibrate(given, tolerance=max(5.0, 3.0 * scan_period))
        self._task: asyncio.Task[Forecast] | None = None
        self._due = -inf
        self._void = False
        self._measured: float | None = None

    def settle(self, time: float, measured: float | None) -> None:
        """A reading came (or did not): forecasts that were due are scored, and the bands learn."""
        self.calibration = settle(self.calibration, time, float("nan") if measured is None else measured)

    def void(self) -> None:
        """What was believed is no longer known: forget the forecast, and the one being made."""
        self.latest, self._void, self._due = None, self._task is not None, -inf

    def fresh(self, now: float) -> Forecast | None:
        """The newest forecast while it may be used."""
        usable = self.latest is not None and now - self.latest.time <= FRESH_PERIODS * self.section.period
        return self.latest if usable else None

    def collect(self) -> Made | None:
        """A forecast that has just been finished, once. Raises what the computation raised."""
        task = self._task
        if task is None or not task.done():
            return None
        self._task = None
        made, void, self._void = task.result(), self._void, False
        if void:
            return None
        self.latest, self.made = made, self.made + 1
        self.calibration = issue(self.calibration, made)
        return Made(made, self._measured)

    def begin(self, now: float, *, known: bool, measured: float | None) -> None:
        """Start a forecast in a thread if one is due, none is running and the state of the plant is known."""
        belief = self.predictor.belief
        if self._task is not None or now < self._due or not known or belief is None or not belief.seen:
            return
        self._due, self._measured = now + self.section.period, measured
        work = partial(
            forecast,
            self.predictor.tracker,
            belief,
            self.section.horizons,
            np.random.default_rng([self.section.seed, int(belief.time * 1000.0)]),
            limit=self.limit,
            runs=self.section.runs,
            calibration=factors(self.calibration),
        )
        self._task = asyncio.create_task(asyncio.to_thread(work), name="forecast")

    async def close(self) -> None:
        """Wait for the forecast being made; its result is dropped."""
        if self._task is not None:
            await asyncio.gather(self._task, return_exceptions=True)
            self._task = None

    def snapshot(self) -> dict[str, Any]:
        """What the bands have learned, as JSON can carry it."""
        return {f"{horizon:g}": asdict(one) for horizon, one in self.calibration.horizons.items()}

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Go on from a snapshot, for the horizons that are still configured. Raises KeyError or TypeError."""
        horizons = dict(self.calibration.horizons)
        for text, one in saved.items():
            if float(text) in horizons:
                pending = tuple(Pending(**item) for item in one["pending"])
                horizons[float(text)] = Horizon(**{**one, "counts": tuple(one["counts"]), "pending": pending})
        section = self.calibration
        self.calibration = Calibration(horizons, section.memory, section.weight, section.tolerance)


def block_values(made: Forecast, horizon: float, now: float) -> dict[str, float | None]:
    """The block's fields that a forecast fills, brought to `now`: horizon and minutes have shrunk since it was made."""
    column = int(np.argmin(np.abs(made.horizons - horizon)))
    by_level = dict(zip(made.levels, made.quantiles[:, column].tolist(), strict=True))
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
