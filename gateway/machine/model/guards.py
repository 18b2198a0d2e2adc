"""The guards of the model while it runs: 3-sigma reviews of its predictions, its drift, how often it left its range."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from gateway.machine.model.drift import CycleDrift, follow_cycle, make_drift_rule
from gateway.machine.model.predict import Predictor, ScanPrediction
from sim.forecast import (
    FORECASTS,
    ONE_STEP,
    Z90,
    Calibration,
    Forecast,
    HeldAgainstPast,
    LikeMoments,
    Review,
    follow,
    follow_forecasts,
    share,
)
from sim.sha import Model
from sim.strict_json import shallow_dict

INNOVATIONS, DRIFT, PAST = "one step", "drift", "past readings"


class Guards:
    """Reviews by what is looked at: the one-step prediction, and the forecasts of each horizon ("60 s").

    `drift` follows the free run from cycle to cycle, against `limit` (degC) or the model's own band (None); the alarm
    comes from `drift_cycles` beyond it on, which is said with it so that the records tell whether it stands. `past` has
    the newest forecast by horizon beside what was measured after like moments, None where that is not known yet; a
    reading that comes `tolerance` s after its moment is of it still.
    """

    def __init__(
        self,
        model: Model,
        horizons: tuple[float, ...],
        limit: float | None = None,
        *,
        drift_cycles: int,
        tolerance: float,
    ) -> None:
        self.model = model
        self._drift_cycles = drift_cycles
        self.drift = CycleDrift()
        self._rule = make_drift_rule(model, limit)
        self._horizons = {f"{horizon:g} s": horizon for horizon in horizons}
        self.reviews = {INNOVATIONS: Review()} | {name: Review() for name in self._horizons}
        self.past: tuple[HeldAgainstPast | None, ...] = ()
        self._like = LikeMoments(horizons, model.sensor_sigma, tolerance)
        self.forecast_clamps = 0
        self.forecasts_clamped = 0

    def look(self, prediction: ScanPrediction, calibration: Calibration) -> None:
        """Take a scan's reading in, before `calibration` settles it. Without a good reading nothing is learned."""
        p = prediction
        if self._rule is not None:
            self.drift = follow_cycle(self._rule, self.drift, p)
        self._like.follow(p.time, p.location if p.known else None, p.measured)
        if not p.known:
            self.past = ()  # the forecast began from what is not known any more
        if p.measured is None:
            return
        if p.mean is not None and p.high is not None and p.high > p.mean:
            # The band is Z90 standard deviations to either side: this is the standardised error.
            z = Z90 * (p.measured - p.mean) / (p.high - p.mean)
            self.reviews[INNOVATIONS] = follow(ONE_STEP, self.reviews[INNOVATIONS], p.time, z)
        # A forecast that is due now is still pending in `calibration`; settling takes it out.
        for name, horizon in self._horizons.items():
            self.reviews[name] = follow_forecasts(self.reviews[name], calibration, horizon, p.time, p.measured)

    def take_forecast(self, forecast: Forecast) -> None:
        """Hold a finished forecast against the past, and count the clamps of its runs."""
        medians = forecast.quantiles[forecast.levels.index(0.5)].tolist()
        self.past = self._like.hold(forecast.time, dict(zip(forecast.horizons.tolist(), medians, strict=True)))
        self.forecast_clamps += forecast.clamps
        self.forecasts_clamped += forecast.clamps > 0

    @property
    def flagged(self) -> bool:
        """True while any review is."""
        return any(review.flagged for review in self.reviews.values())

    def plain(self, predictor: Predictor) -> dict[str, Any]:
        """All guards as plain values, for status and historian."""
        belief, free_run = predictor.clamps
        reviews: dict[str, Any] = {}
        for name, review in self.reviews.items():
            rule = ONE_STEP if name == INNOVATIONS else FORECASTS
            reviews[name] = {
                "flagged": review.flagged,
                "since": review.since,
                "share": share(rule, review),
                "run": review.run,
                "longest_run": review.longest,
                "readings": review.readings,
                "beyond": review.beyond,
            }
        correction = self.model.correction
        return {
            "review": self.flagged,
            "drift": {
                "cycles": self.drift.running,
                "alarm_cycles": self._drift_cycles,
                "error": self.drift.error,
                "limit": self.drift.limit,
            },
            "reviews": reviews,
            PAST: [None if each is None else asdict(each) | {"flagged": each.flagged} for each in self.past],
            "clamps": {
                "belief": belief,
                "free_run": free_run,
                "forecast_runs": self.forecast_clamps,
                "forecasts": self.forecasts_clamped,
            },
            "correction": {"gain": correction.gain, "offset": correction.offset},
            # By how much this machine is warmer than the model's, as far as it is known; none where all are alike.
            "machine": None if (own := predictor.machine_offset) is None else {"offset": own[0], "sigma": own[1]},
        }

    def snapshot(self) -> dict[str, Any]:
        """The reviews, the drift and the past as JSON can carry them."""
        reviews = {name: shallow_dict(review) for name, review in self.reviews.items()}
        return reviews | {DRIFT: shallow_dict(self.drift), PAST: self._like.snapshot()}

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Go on from a snapshot, for what is still looked at.

        Raises TypeError or ValueError for what `snapshot` did not write.
        """
        self.reviews |= {name: Review(**review) for name, review in saved.items() if name in self.reviews}
        self.drift = CycleDrift(**saved[DRIFT]) if DRIFT in saved else self.drift
        self._like.restore(saved.get(PAST, ()))
