"""The model of one machine and all that follows it: prediction, guards, forecast, a newer model that takes over."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.supervision import Supervisor
from gateway.machine.model.ensemble import Ensemble
from gateway.machine.model.familiar import CycleFamiliarity, FamiliarityRating
from gateway.machine.model.guards import Guards
from gateway.machine.model.loading import LoadedModel
from gateway.machine.model.outlook import FinishedForecast, Outlook, limit_probability
from gateway.machine.model.pickup import Pickup, ReadyModel
from gateway.machine.model.predict import Predictor, ScanPrediction
from gateway.machine.model.twin import TwinBearing, combine
from gateway.machine.model.virtual_sensor import VirtualReading, VirtualSensor
from gateway.machine.reading import Scan
from gateway.settings import ANOMALY_FLOOR, Config
from gateway.store import HistorianView, saved_state
from sim.artefacts import (
    FORECAST_CRITERION,
    MODEL_FILE,
    ModelVerdict,
    compare_verdicts,
    is_store,
    pair_horizons,
    read_finding,
    read_verdict,
    version_directory,
    versions,
)
from sim.files import ArtefactError
from sim.forecast import Z90, Forecast
from sim.sha import Bins, Location, Model, level_of_locations, mean, switch_locations

if TYPE_CHECKING:
    from structlog.typing import FilteringBoundLogger


class ModelUnit:
    """What a machine has that has a model: all of it is there, or (`ModelUnit | None`) none of it.

    In a scan its methods are called in their order here: `adopt_promoted_model` before anything is computed with the
    model, `follow` for the prediction, `settle` for what its reading teaches, `foresee` once the block is on its way.
    `loaded` is the model that runs, `members` those of an ensemble beside it, `prediction` what was said of the newest
    scan; `turns` are those of the gateway's forecasts.
    """

    def __init__(
        self,
        config: Config,
        loaded: LoadedModel,
        members: tuple[LoadedModel, ...],
        *,
        historian: HistorianView,
        log: FilteringBoundLogger,
        supervisor: Supervisor | None = None,
        turns: asyncio.Semaphore | None = None,
    ) -> None:
        self.config, self.loaded, self.members = config, loaded, members
        self._historian, self._log, self._supervisor = historian, log, supervisor or Supervisor()
        self._turns = turns
        tag, twins = config.model.temperature, config.twins
        # What it learned is of two sensors and not of a model: it outlives both a promotion and a failure.
        self.twin = TwinBearing(next(each for each in twins if each != tag)) if tag in twins else None
        self.pickup = Pickup(config, loaded, self._supervisor)
        self.begin_anew()
        for model in (loaded, *members):
            self._warn(model)
        if config.alarms.anomaly is None and loaded.model.anomalies is None:
            message = "the model has no record of its anomaly scores: their alarm begins where it does without one"
            log.info(message, limit=ANOMALY_FLOOR)

    def begin_anew(self, ready: Predictor | None = None) -> None:
        """Trust nothing that was believed or learned; `ready` is a predictor of this model that has followed scans."""
        config, period = self.config, self.config.scan.period
        self.predictor = ready or Predictor(self.loaded.model, config.model.temperature)
        models = [member.model for member in self.members]
        hashes = [model.hash for model in (self.loaded, *self.members)]
        ensemble = (
            Ensemble(
                self.predictor,
                hashes,
                models,
                section=config.ensemble,
                forecasts=config.forecast,
                scan_period=period,
            )
            if models or (config.ensemble.plain and self.loaded.model.plain)
            else None
        )
        self.outlook = Outlook(
            self.predictor,
            config.forecast,
            config.alarms.limit,
            period,
            ensemble,
            supervisor=self._supervisor,
            turns=self._turns,
        )
        alarms = config.alarms
        self.guards = Guards(
            self.loaded.model,
            config.forecast.horizons,
            alarms.drift,
            drift_cycles=alarms.drift_cycles,
            tolerance=self.outlook.calibration.tolerance,
        )
        section = config.virtual_sensor
        self.familiarity = CycleFamiliarity(self.loaded.familiarity, self.loaded.model, config.alarms.unfamiliar)
        self.virtual = VirtualSensor(section.minutes * 60.0, section.width, period)
        self.prediction: ScanPrediction | None = None
        self._found_out = False
        self._clamped = False

    @property
    def unverified_reason(self) -> str:
        """Why nothing of these models may be written: one of them runs although it does not verify; "" if none does."""
        return next((model.warning for model in (self.loaded, *self.members) if model.warning), "")

    @property
    def files(self) -> tuple[Path, ...]:
        """The files of the models that run."""
        return tuple(model.file for model in (self.loaded, *self.members) if model.file is not None)

    # ---------------------------------------------------------------- the stages of a scan

    def adopt_promoted_model(self, now: float) -> bool:
        """Let a model that was promoted meanwhile take over; True if one has.

        Between two scans, so that every scan is of one model, and between two forecasts, so that none is of a model
        that runs no more.
        """
        refused = self.pickup.collect()
        promoted = None if self.outlook.busy else self.pickup.take()
        if isinstance(promoted, ReadyModel):
            self._adopt(promoted, now)
            return True
        if reason := promoted or refused:
            self._log.error("the promoted model is refused and the former one goes on", reason=reason)
            self._historian.put("audit", [(now, "promoted model refused", self.pickup.running, reason)])
        return False

    def _adopt(self, promoted: ReadyModel, now: float) -> None:
        """The other models of an ensemble go on as they are; what their evidence was held against begins anew."""
        former, cycle = self.outlook.ensemble, self.familiarity
        before, self.loaded = self.loaded.version, promoted.loaded
        self.begin_anew(promoted.predictor)
        self.familiarity.adopt_cycle(cycle)
        if self.outlook.ensemble is not None and former is not None:
            self.outlook.ensemble.keep(former)
        version = self.loaded.version
        self._historian.put("audit", [(now, f"model {version} runs", version, f"promoted; {before} ran before")])
        self._log.info("a promoted model runs from now on", version=version, before=before, hash=self.loaded.hash)
        self._warn(self.loaded)

    def follow(self, scan: Scan, wrong_since: float | None = None) -> ScanPrediction:
        """Move the model on by a scan: its events, and what it expected of its reading.

        `wrong_since` (plant s): the sensor was found out, and its readings from then on were wrong.
        """
        if wrong_since is not None and not self._found_out:
            self.outlook.void()  # the forecast began from a wrong temperature, too
            if self.twin is not None:
                self.twin.forget_readings(wrong_since)
            if not self.predictor.forget_readings(wrong_since):
                self.virtual.stopped = "state not known"
        self._found_out = wrong_since is not None
        before, prediction = self.prediction, self.predictor.step(scan)
        rating = self._rate_scan(scan, prediction)
        prediction = prediction.with_familiarity(rating)
        if self.outlook.ensemble is not None:
            self.outlook.ensemble.familiarity = rating.word
        if self._unfit:
            prediction = prediction.at_best("red")
        if self.twin is not None:
            self.twin.take(scan.time, scan.good(self.predictor.temperature), scan.good(self.twin.twin))
        virtual = self._virtual_reading(scan, prediction)
        if virtual is not None:
            v = virtual
            prediction = replace(prediction, virtual=v, mean=v.mean, low=v.low, high=v.high)
        self._note_virtual(before.virtual if before is not None else None, virtual, scan.time)
        self.prediction = prediction
        for event in prediction.events:
            self._log.debug("event", symbol=event.symbol, time=event.time, location=prediction.location)
        clamps = self.predictor.clamps[0]
        if clamps and not self._clamped:
            message = "the model left its range and was put back to its border"
            self._log.warning(message, time=scan.time, clamps=clamps)
        self._clamped = clamps > 0
        return prediction

    def _rate_scan(self, scan: Scan, p: ScanPrediction) -> FamiliarityRating:
        """How familiar the present cycle is; that it begins or ceases to be is logged."""
        before, rating = self.familiarity.rating, self.familiarity.take(scan, p.events)
        if before.outside != rating.outside and rating.zone != "unknown":
            thing = {"what": rating.thing.kind, "features": rating.thing.features, "values": rating.thing.values}
            message = "the present cycle is unlike the training" if rating.outside else "the cycle is familiar again"
            self._log.warning(message, strangeness=round(rating.strangeness or 0.0, 2), **thing)
        return rating

    def _virtual_reading(self, scan: Scan, p: ScanPrediction) -> VirtualReading | None:
        """What stands for the sensor in this scan; None while it is good, and where the model never had a reading."""
        tag, belief = self.config.model.temperature, self.predictor.belief
        sample = scan.samples.get(tag)
        if sample is not None and sample.quality.is_good:
            self.virtual.stopped = ""
            return None
        if belief is None or belief.read_at is None or p.mean is None or p.high is None:
            return None
        others = (scan.samples.get(name) for name in self.predictor.inputs if name != tag)
        mean, half, helped = p.mean, (p.high - p.mean) * self.outlook.band_factor(scan.time - belief.read_at), ""
        if self.twin is not None:
            told = self.twin.estimate(scan.time, belief.read_at, scan.good(self.twin.twin))
            if told is not None:
                both = combine(mean, half / Z90, told)
                mean, half, helped = both.mean, Z90 * both.sigma, self.twin.twin
        return self.virtual.take(
            scan.time,
            belief.read_at,
            "no such reading" if sample is None else sample.reason or sample.quality.name,
            known=p.known and not p.reset and all(each is not None and each.quality.is_good for each in others),
            mean=mean,
            half_width=half,
            twin=helped,
        )

    def _note_virtual(self, before: VirtualReading | None, now: VirtualReading | None, time: float) -> None:
        """Say in log and records when the model begins and ceases to speak for the sensor."""
        if (before and before.stopped) == (now and now.stopped):
            return
        tag, shown = self.config.model.temperature, now or before
        word = "ends" if now is None else f"stops: {now.stopped}" if now.stopped else "begins"
        reason = "" if shown is None else shown.reason
        self._log.warning("the model in place of a bad sensor", sensor=tag, what=word, reason=reason)
        self._historian.put("audit", [(time, f"virtual sensor {tag} {word}"[:200], "the gateway", reason[:200])])

    def settle(self, prediction: ScanPrediction) -> FinishedForecast | None:
        """Let the guards and the forecast's bands learn from the reading; the forecast finished since, once.

        Raises what the computation of that forecast raised.
        """
        # The guards look first: they judge by the bands as they were when the forecast was made.
        self.guards.look(prediction, self.outlook.calibration)
        self.outlook.settle(prediction.time, prediction.measured)
        if prediction.reset:
            self.outlook.void()  # before it is collected: it began from what is no longer known
        finished = self.outlook.collect()
        if finished is not None:
            self.guards.take_forecast(finished.forecast)
        return finished

    def usable(self, prediction: ScanPrediction) -> Forecast | None:
        """The newest forecast, while it is fresh and the state that it began from is still known."""
        return self.outlook.fresh(prediction.time) if prediction.known else None

    @property
    def _unfit(self) -> bool:
        """Whether the model was called unfit where it was learned."""
        return self.loaded.verdict is not None and self.loaded.verdict.word == "unfit"

    def findings(self, prediction: ScanPrediction, forecast: Forecast | None) -> dict[str, float | None]:
        """What the alarms of the model look at, in the order in which they are stepped; None where it is not known."""
        p, trusted = prediction, prediction.known and prediction.inputs_good
        limit = None if forecast is None else limit_probability(forecast, self.config.block_horizon)
        return {
            "predicted over limit": limit,
            "anomaly": p.anomaly if trusted else None,
            "unfamiliar": None if p.familiarity is None else p.familiarity.strangeness,
            "review": 1.0 if self._unfit else float(self.guards.flagged) if trusted else None,
            "drift": float(self.guards.drift.running),
            # Where a reading is bad that has an alarm of its own.
            "no forecast": float(forecast is None) if p.inputs_good else None,
        }

    def foresee(self, scan: Scan, prediction: ScanPrediction) -> None:
        """Begin the next forecast if one is due, and look for a newer model now and then.

        After the block is written, since a forecast's thread would delay it. The other models of an ensemble are moved
        on here for the same reason: only the forecast needs them.
        """
        p, outlook = prediction, self.outlook
        outlook.follow(scan, p.measured)
        while outlook.ensemble and outlook.ensemble.complaints:
            name, reason = outlook.ensemble.complaints.pop(0)
            message = "a model of the ensemble failed and is left out for now"
            self._log.warning(message, member=name, reason=reason)
        if self.pickup.ready is None:  # a model that waits takes over between two forecasts
            # Ticks were skipped, and not because the device takes longer than a period to answer.
            behind = scan.missed > 0 and scan.duration < self.config.scan.period
            outlook.begin(scan.time, known=p.known and p.inputs_good, measured=p.measured, behind=behind)
        self.pickup.keep(scan)
        self.pickup.look(scan.time, [member.hash for member in self.members])

    # ---------------------------------------------------------------- what it says of itself, and what outlives it

    def report(self) -> dict[str, Any]:
        """The model that runs, and why the newest promotion does not, as plain values."""
        model = self.loaded
        return {
            "name": model.model.sha.name,
            "hash": model.hash,
            "version": model.version,
            "written": model.written,
            "refused": self.pickup.refused,
            "verdict": "" if model.verdict is None else model.verdict.word,
            "verdict_sentence": "" if model.verdict is None else model.verdict.sentence,
        }

    def description(self) -> dict[str, Any]:
        """The automaton, the present location (None where it is not known), and where the model comes from.

        `store` is that which it is promoted in, with its `versions`, oldest first; None and none for a model by itself.
        By version `findings` has what a diagnosis that proposed it found, `verdicts` whether it may be used and what it
        foresaw, `origins` when it was written and what it was learned from. A location has a `target` and a
        `time_constant` (s) where its flow goes to one, its mean `stay` (s), whether the machine `runs` there and the
        `load` there, counted from 0 in the levels of the first one; an edge the `share` of the moves from its source
        that take it. What the model does not know is None. `criteria` are those of the model's own verdict.
        """
        model, sha, now = self.loaded.model, self.loaded.model.sha, self.prediction
        path = self.config.model.path
        store = path if path is not None and is_store(path) else None
        known: Sequence[str] = ()
        with suppress(ArtefactError, OSError):  # a store that cannot be read now has none to choose from
            known = () if store is None else versions(store)
        findings: dict[str, dict[str, Any]] = {}
        verdicts: dict[str, dict[str, str]] = {}
        origins: dict[str, dict[str, Any]] = {}
        for name in known:
            # A file that was damaged costs its own words only: the version can be run without them.
            with suppress(ArtefactError, OSError):
                if store is not None and (finding := read_finding(version_directory(store, name))) is not None:
                    findings[name] = finding.plain()
            with suppress(ArtefactError, OSError):
                if store is not None and (verdict := read_verdict(version_directory(store, name))) is not None:
                    foreseen = [each.sentence for each in verdict.criteria if each.criterion == FORECAST_CRITERION]
                    foreseen += self._beside_present(name, verdict)
                    verdicts[name] = {"word": verdict.word, "sentence": verdict.sentence, "score": "; ".join(foreseen)}
        for name in known[-MOST_ORIGINS:]:
            with suppress(ArtefactError, OSError, ValueError, LookupError, TypeError):
                if store is not None:
                    file = version_directory(store, name) / MODEL_FILE
                    origins[name] = _origin(file, file.stat().st_mtime)
        edges: dict[tuple[str, str], list[str]] = {}
        for edge in sha.edges:
            edges.setdefault((edge.source, edge.target), []).append(edge.symbol)
        where = _layout(model)
        return {
            **self.report(),
            "store": None if store is None else str(store.absolute()),
            "versions": list(known),
            "findings": findings,
            "verdicts": verdicts,
            "origins": origins,
            "criteria": [] if self.loaded.verdict is None else [asdict(each) for each in self.loaded.verdict.criteria],
            "locations": [_describe_location(model, place) | where[place.name] for place in sha.locations],
            "edges": [
                {"source": a, "target": b, "symbols": symbols, "share": _move_share(model, a, b)}
                for (a, b), symbols in edges.items()
            ],
            "initial": sha.initial,
            "present": now.location if now is not None and now.known else None,
            "provenance": asdict(model.provenance),
        }

    def _beside_present(self, name: str, verdict: ModelVerdict) -> list[str]:
        """What is known of another version beside the one that runs; none where their verdicts do not tell."""
        runs = self.loaded.verdict
        if name == self.loaded.version or runs is None or not pair_horizons(verdict, runs):
            return []
        return [compare_verdicts(verdict, runs, self.loaded.model.unit, "").sentence]

    def guard_report(self) -> dict[str, Any]:
        """The model's guards and the ensemble's weights as plain values."""
        ensemble = self.outlook.ensemble
        return self.guards.plain(self.predictor) | ({"ensemble": ensemble.plain()} if ensemble else {})

    def save(self, now: float) -> None:
        """Keep what a restart goes on from; nothing before the first scan."""
        snapshot = self.predictor.snapshot()
        if snapshot is None:
            return
        self._historian.save("belief", now, {"model": self.loaded.hash, "stopped": self.virtual.stopped, **snapshot})
        bands = {
            "model": self.loaded.hash,
            "horizons": self.outlook.snapshot(),
            "reviews": self.guards.snapshot(),
        }
        self._historian.save("bands", now, bands)
        if self.twin is not None:
            self._historian.save("twin", now, self.twin.to_plain())
        if self.outlook.ensemble is not None:
            self._historian.save("ensemble", now, self.outlook.ensemble.snapshot())

    def restore(self, now: float) -> None:
        """Go on from what the historian has of this very model; what cannot be used is logged, and begins anew."""
        belief, bands = (saved_state(self._historian, key, self._log) for key in ("belief", "bands"))
        try:
            if belief is not None and belief[1]["model"] == self.loaded.hash and self.predictor.restore(belief[1], now):
                self.virtual.stopped = belief[1].get("stopped", "")
                self._log.info("goes on from the saved belief", age=now - belief[0])
            if self.twin is not None and (twin := saved_state(self._historian, "twin", self._log)) is not None:
                self.twin.restore(twin[1])
            if bands is not None and bands[1]["model"] == self.loaded.hash:
                self.outlook.restore(bands[1]["horizons"], now)
                self.guards.restore(bands[1].get("reviews", {}))
                ensemble = self.outlook.ensemble
                members = saved_state(self._historian, "ensemble", self._log) if ensemble else None
                if members is not None and ensemble is not None:
                    ensemble.restore(members[1], now)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            self._log.warning("the saved state cannot be used; the model begins anew", reason=repr(error))
            self.begin_anew()

    def follow_history(self, scans: Sequence[Scan]) -> None:
        """Follow what was read before a start, after `restore`: cycle and bearings have a past from then on.

        So has the belief, where a sensor turns out to have been wrong by then; the belief itself stays.
        """
        alone = Predictor(self.loaded.model, self.config.model.temperature)
        for scan in scans:
            self.familiarity.take(scan, alone.step(scan).events)
            if self.twin is not None:
                self.twin.take(scan.time, scan.good(alone.temperature), scan.good(self.twin.twin))
        if self.predictor.belief is not None:
            self.predictor.past = alone.past

    async def close(self) -> None:
        """Wait for the forecast and the look at the store that go on; what they give is dropped."""
        await self.outlook.close()
        await self.pickup.close()

    def _warn(self, model: LoadedModel) -> None:
        if model.warning:
            self._log.warning("a model runs that does not verify", reason=model.warning)


def _describe_location(model: Model, place: Location) -> dict[str, Any]:
    relaxes = place.flow.kind == "exponential" and place.distribution is not None
    stay, shown = model.semi_markov.get(place.name), model.correction
    return {
        "name": place.name,
        "flow": place.flow.kind,
        "borrowed": place.name in model.borrowed,
        "target": shown.gain * mean(place.distribution) + shown.offset
        if relaxes and place.distribution is not None
        else None,
        "time_constant": 1.0 / place.flow.params["k"] if relaxes else None,
        "stay": None if stay is None else mean(stay.law),
    }


def _layout(model: Model) -> dict[str, dict[str, Any]]:
    """By location, whether the machine runs there (None: either, or no word on it), and the level of the load."""
    switches = switch_locations(model.sha, model.alphabet)
    switch = next((switches[each.signal] for each in model.alphabet.channels if each.signal in switches), None)
    bins = next((each for each in model.alphabet.channels if isinstance(each, Bins)), None)
    levels = {} if bins is None else level_of_locations(model.sha, bins)
    runs = {} if switch is None else dict.fromkeys(switch.on, True) | dict.fromkeys(switch.off, False)
    return {place.name: {"runs": runs.get(place.name), "load": levels.get(place.name)} for place in model.sha.locations}


MOST_ORIGINS = 6
"""Of how many versions, the newest, it is told what they were learned from: a model is read for it."""


@lru_cache(maxsize=64)
def _origin(file: Path, written: float) -> dict[str, Any]:
    """What a version's model, `written` then (s UTC), was learned from. Raises what a file that is damaged does."""
    made = json.loads(file.read_bytes())["provenance"]
    return {
        "written": written,
        "method": str(made["method"]),
        "traces": len(made["traces"]),
        "synthetic": bool(made["synthetic"]),
    }


def _move_share(model: Model, source: str, target: str) -> float | None:
    stay = model.semi_markov.get(source)
    return None if stay is None or source == target else stay.to.get(target, 0.0)
