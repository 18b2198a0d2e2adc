"""One scan through the whole gateway: threshold alarm, model, block, records; and what a restart goes on from."""

from typing import Any

from structlog.typing import FilteringBoundLogger

from drivers.driver import Complains, Driver
from gateway.machine import records
from gateway.machine.alarms.states import Alarm, acknowledge, step, to_plain, word
from gateway.machine.model.ensemble import Ensemble
from gateway.machine.model.guards import Guards
from gateway.machine.model.outlook import Outlook, block_values
from gateway.machine.model.pickup import Pickup, ReadyModel
from gateway.machine.model.predict import ZONES, Predictor, ScanPrediction
from gateway.machine.reading.clock import Clock
from gateway.machine.reading.redundant import Redundant, SwitchOver
from gateway.machine.reading.scan import Scan
from gateway.machine.writing import arming
from gateway.machine.writing.block import Validity, validity
from gateway.machine.writing.writeback import Arming, Attempt
from gateway.plant.config import Config
from gateway.plant.startup import (
    DEVICE,
    LoadedModel,
    load_members,
    load_model,
    loaded,
    make_conditions,
    make_driver,
    restored_alarms,
)
from gateway.plant.status import Link, Tally
from gateway.store.audit import Audit, open_audit
from gateway.store.historian import open_historian
from sim.forecast.forecast import Forecast

SAVE_SECONDS = 10.0
ORDERS = ("WritePermit", "AcknowledgeBits")
_HOUR = 3600.0


class Gateway:
    """All parts, opened (the driver not yet): one scan after another goes through `take`.

    Raises ConfigError or HistorianError when something cannot be opened; nothing is left open then.
    """

    def __init__(self, config: Config, clock: Clock, log: FilteringBoundLogger, driver: Driver | None = None) -> None:
        self.config, self.clock, self.log = config, clock, log
        self.loaded: LoadedModel | None = load_model(config)
        self.members = load_members(config, self.loaded)
        self.driver = driver or make_driver(config, clock)
        self.historian, numbers = open_historian(config.historian.path, config.map.tags, max_mb=config.historian.max_mb)
        self.audit: Audit | None = None
        opened = False
        try:
            self._open(numbers)
            opened = True
        finally:
            if not opened:
                self.close()

    def close(self) -> bool:
        """Store what waits and close historian and audit log; False if records had to be given up."""
        accounted = self.audit is None or self.audit.close()
        return self.historian.close() and accounted

    def _open(self, numbers: dict[str, int]) -> None:
        config, now = self.config, self.clock.now()
        self.predictor, self.outlook, self.guards = self._new_model()
        self.pickup = Pickup(config, self.loaded)
        for one in (self.loaded, *self.members):
            if one is not None and one.warning:
                self.log.warning("a model runs that does not verify", reason=one.warning)
        watched = self.predictor.inputs if self.predictor else config.watched
        self.conditions = make_conditions(config, watched, complains=isinstance(self.driver, Complains))
        self.alarms = restored_alarms(self.conditions, self.historian, now, self.log)
        if config.map.writeback is not None and config.writeback.mode != "off":
            self.audit = open_audit(config.audit)
        parts = (self.driver, self.historian, self.audit, self.log)
        self.writer = arming.make_writer(config, self.clock, *parts)
        heartbeat = config.map.heartbeat
        left_out = frozenset({heartbeat} if heartbeat else ())
        self.keeper = records.Keeper(config.map.by_name, numbers, config.historian.max_interval, left_out)
        refusals = config.map.by_name.get("LastRefusal")
        self.refusals = refusals.labels if refusals else {}
        self.link, self.tally = Link(), Tally()
        if isinstance(self.driver, Redundant):
            self.driver.tell = self._switched
        self.prediction: ScanPrediction | None = None
        self.last: Scan | None = None
        self.attempt: Attempt | None = None
        self.phase = "starting"
        self._acknowledged: int | None = None
        self._clamped = False
        self._saved = self._cleaned = now
        self._restore(now)
        self._begin_run(now)

    def _begin_run(self, now: float) -> None:
        config, name = self.config, self.loaded.hash if self.loaded else ""
        run = (now, config.model.temperature, name, config.scan.period, config.historian.max_interval)
        self.historian.put("runs", [run])

    def _new_model(self, ready: Predictor | None = None) -> tuple[Predictor | None, Outlook | None, Guards | None]:
        """All that follows the loaded model, begun anew; `ready` is a predictor of it that has followed scans."""
        if self.loaded is None:
            return None, None, None
        config, period = self.config, self.config.scan.period
        predictor = ready or Predictor(self.loaded.model, config.model.temperature)
        models = [one.model for one in self.members]
        hashes = [one.hash for one in (self.loaded, *self.members)]
        ensemble = Ensemble(predictor, hashes, models, config.ensemble, config.forecast, period) if models else None
        outlook = Outlook(predictor, config.forecast, config.alarms.limit, period, ensemble)
        return predictor, outlook, Guards(self.loaded.model, config.forecast.horizons, config.alarms.drift)

    # ---------------------------------------------------------------- one scan

    async def take(self, scan: Scan) -> None:
        """Do all that a scan brings: the threshold alarm first, then the model, then the block, then the records."""
        self.last = scan
        self.tally.scans, self.tally.missed = self.tally.scans + 1, self.tally.missed + scan.missed
        self.tally.early += scan.early
        self._watch_link(scan)
        self._acknowledge(scan)
        self._alarm({f"over limit {name}": scan.good(name) for name in self.config.watched}, scan.time)
        self.historian.put("scans", [records.scan_row(scan)])
        self.historian.put("samples", self.keeper.rows(scan))
        self._pick_up(scan.time)
        made = self._predict(scan)
        self._alarm(self._findings(scan, made), scan.time)
        await self._write_back(scan, made)
        self._foresee(scan)
        self.pickup.keep(scan)
        self.pickup.look(scan.time, [one.hash for one in self.members])
        if scan.time - self._saved >= SAVE_SECONDS:
            self.save(scan.time)

    def _pick_up(self, now: float) -> None:
        """Let a model that was promoted meanwhile take over, between two scans and two forecasts."""
        refused = self.pickup.collect()
        found = None if self.outlook is None or self.outlook.busy else self.pickup.taken()
        if isinstance(found, ReadyModel):
            self._take_over(found, now)
        elif found or refused:
            reason = found or refused
            self.log.error("the promoted model is refused and the former one goes on", reason=reason)
            self.historian.put("audit", [(now, "promoted model refused", self.pickup.running, reason)])

    def _take_over(self, found: ReadyModel, now: float) -> None:
        """The other models of an ensemble go on as they are; what their evidence was held against begins anew."""
        others = self.outlook.ensemble.members if self.outlook and self.outlook.ensemble else []
        former, self.loaded = self.loaded, found.loaded
        self.predictor, self.outlook, self.guards = self._new_model(found.predictor)
        if self.outlook is not None and self.outlook.ensemble is not None:
            self.outlook.ensemble.members = others
        self.conditions = make_conditions(
            self.config, found.predictor.inputs, complains=isinstance(self.driver, Complains)
        )
        self._clamped = False
        self._begin_run(now)
        version, before = found.loaded.version, former.version if former else ""
        self.historian.put("audit", [(now, f"model {version} runs", version, f"promoted; {before} ran before")])
        self.log.info("a promoted model runs from now on", version=version, before=before, hash=found.loaded.hash)
        if found.loaded.warning:
            self.log.warning("a model runs that does not verify", reason=found.loaded.warning)

    def model_report(self) -> dict[str, Any] | None:
        """The model that runs, and why the newest promotion does not, as plain values; None without a model."""
        one = self.loaded
        if one is None:
            return None
        return {"name": one.model.sha.name, "hash": one.hash, "version": one.version, "refused": self.pickup.refused}

    def _watch_link(self, scan: Scan) -> None:
        good = any(sample.quality.is_good for sample in scan.samples.values())
        change = self.link.heard(scan.time, good=good)
        if change == "lost":
            reason = next((s.reason for s in scan.samples.values() if s.reason), "")
            self.log.warning("no good reading any more", time=scan.time, reason=reason)
        elif change == "back":
            self.log.info("good readings arrive", time=scan.time, outages=self.link.count)

    def _switched(self, switch: SwitchOver) -> None:
        """Another link is used from now on: said, and kept."""
        change = {"before": switch.before, "after": switch.after, "reason": switch.reason}
        self.log.warning("another link is used", time=switch.time, waited=round(switch.waited, 4), **change)
        self.historian.put("audit", [(switch.time, f"link {switch.after}", switch.before, switch.reason)])

    def urgent(self) -> frozenset[str]:
        """The tags whose change is worth a scan of its own: those of the model, of the alarms, the PLC's orders."""
        return frozenset((*(self.predictor.inputs if self.predictor else ()), *self.config.watched, *ORDERS))

    def complaints(self) -> tuple[str, ...]:
        """What the device itself says is wrong with it, now."""
        return self.driver.complaints() if isinstance(self.driver, Complains) else ()

    def _predict(self, scan: Scan) -> Forecast | None:
        """Move the model on; the newest forecast that may be used, if any."""
        predictor, outlook, guards = self.predictor, self.outlook, self.guards
        if predictor is None or outlook is None or guards is None:
            return None
        prediction = self.prediction = predictor.step(scan)
        self.historian.put("predictions", [records.prediction_row(prediction)])
        self.historian.put("events", records.event_rows(prediction))
        for event in prediction.events:
            self.tally.recent.append((event.time, event.symbol, prediction.location))
            self.log.debug("event", symbol=event.symbol, time=event.time, location=prediction.location)
        self.tally.events += len(prediction.events)
        self._watch_range(predictor, scan.time)
        guards.look(prediction, outlook.calibration)
        outlook.settle(scan.time, prediction.measured)
        if prediction.reset:
            outlook.void()
        finished = outlook.collect()
        if finished is not None:
            guards.made(finished.forecast)
            self.historian.put("forecasts", records.forecast_rows(finished.forecast, finished.measured))
            self.historian.put("guards", [records.guard_row(scan.time, self.guard_report())])
        return outlook.fresh(scan.time) if prediction.known else None

    def _watch_range(self, predictor: Predictor, now: float) -> None:
        """Say so when the model leaves its range for the first time."""
        clamps = predictor.clamps[0]
        if clamps and not self._clamped:
            self.log.warning("the model left its range and was put back to its border", time=now, clamps=clamps)
        self._clamped = clamps > 0

    def guard_report(self) -> dict[str, Any] | None:
        """The model's guards and the ensemble's weights as plain values; None without a model."""
        if self.guards is None or self.predictor is None or self.outlook is None:
            return None
        ensemble = self.outlook.ensemble
        return self.guards.plain(self.predictor) | ({"ensemble": ensemble.plain()} if ensemble else {})

    def _foresee(self, scan: Scan) -> None:
        """Begin the next forecast if one is due: after the block is written, since its thread would delay the block.

        The other models of an ensemble are moved on here for the same reason: only the forecast needs them.
        """
        p = self.prediction if self.predictor else None
        if p is not None and self.outlook is not None:
            self.outlook.follow(scan, p.measured)
            while self.outlook.ensemble and self.outlook.ensemble.complaints:
                name, reason = self.outlook.ensemble.complaints.pop(0)
                self.log.warning("a model of the ensemble failed and is left out for now", member=name, reason=reason)
            if self.pickup.ready is None:  # a model that waits takes over between two forecasts
                self.outlook.begin(scan.time, known=p.known and p.inputs_good, measured=p.measured)

    def _findings(self, scan: Scan, made: Forecast | None) -> dict[str, float | None]:
        """What the alarms beside the threshold look at; None where it is not known."""
        p = self.prediction if self.predictor else None
        device = {DEVICE: float(bool(self.complaints()))} if DEVICE in self.conditions else {}
        if p is None:
            bad = any(scan.good(name) is None for name in self.config.watched)
            return {"inputs bad": float(bad), **device}
        limit = None if made is None else block_values(made, self.config.block_horizon, scan.time)["p_limit"]
        return {
            "predicted over limit": limit,
            "anomaly": p.anomaly if p.known and p.inputs_good else None,
            "review": float(self.guards.flagged) if self.guards and p.known and p.inputs_good else None,
            "drift": float(self.guards.drift.running) if self.guards else None,
            "inputs bad": float(p.worst),
            **device,
        }

    def _alarm(self, values: dict[str, float | None], now: float) -> None:
        for name, value in values.items():
            before = self.alarms[name]
            self.alarms[name] = step(self.conditions[name], before, value, now)
            self._note(before, self.alarms[name], value, now)

    def _acknowledge(self, scan: Scan) -> None:
        bits = scan.good("AcknowledgeBits")
        if bits is None:
            self._acknowledged = None
            return
        before = dict(self.alarms)
        self.alarms = acknowledge(self.conditions, before, self._acknowledged, int(bits), scan.time, "PLC")
        self._acknowledged = int(bits)
        for name, alarm in self.alarms.items():
            self._note(before[name], alarm, None, scan.time)

    def _note(self, before: Alarm, after: Alarm, value: float | None, now: float) -> None:
        if after.state is before.state:
            return
        self.historian.save("alarms", now, {name: to_plain(alarm) for name, alarm in self.alarms.items()})
        self.historian.put("alarms", [records.alarm_row(after, value, now)])
        response = self.conditions[after.condition].response if after.active else ""
        self.log.warning("alarm", condition=after.condition, state=after.state.value, value=value, response=response)

    # ---------------------------------------------------------------- the block

    async def _write_back(self, scan: Scan, made: Forecast | None) -> None:
        writer = self.writer
        if writer is None:
            return
        writer.heard(scan, self.refusals)
        if over := self._disarming(scan.time):
            await self.withdraw(over, scan)
            writer.disarm(scan.time, reason=over)
        p = self.prediction if self.predictor else None
        state = Validity.NONE
        if p is not None:
            parts = {"inputs": p.inputs_good, "location": p.known, "forecast": made is not None}
            state = validity(**parts, model=True, familiar=p.zone != "red")
        self._record(await writer.offer(scan, self._values(scan, p, made), state))

    def _disarming(self, now: float) -> str:
        """Why the gateway has to disarm itself at this scan; "" if it has not."""
        if self.writer is None or not self.writer.armed:
            return ""
        if self.writer.expired(now):
            return "the arming is over"
        warning = next((one.warning for one in (self.loaded, *self.members) if one and one.warning), "")
        return f"the model that runs does not verify: {warning}" if warning else ""

    async def arm(self, by: str, reason: str, minutes: float) -> Arming:
        """Let blocks be written from the next scan on. Raises ArmingError."""
        warning = next((one.warning for one in (self.loaded, *self.members) if one and one.warning), "")
        if warning:
            raise arming.ArmingError(f"the model that runs does not verify: {warning}")
        made = await arming.arm(self.writer, self.driver, self.clock, by, reason, minutes)
        self.historian.put("audit", [(self.clock.now(), f"armed until {made.until:.0f}", made.by, made.reason)])
        self.log.warning("armed", by=made.by, reason=made.reason, until=made.until)
        return made

    async def disarm(self, by: str, reason: str) -> bool:
        """Take everything back at the PLC, if it can be reached, and write no more; False if it was not armed."""
        if self.writer is None or not self.writer.armed:
            return False
        await self.withdraw(f"disarmed by {by}: {reason}")
        self.writer.disarm(self.clock.now(), by, reason)
        self.historian.put("audit", [(self.clock.now(), "disarmed", by, reason)])
        self.log.warning("disarmed", by=by, reason=reason)
        return True

    def _values(self, scan: Scan, p: ScanPrediction | None, made: Forecast | None) -> dict[str, float | None]:
        """The block's fields; a number that is not known is left out, and the block says so."""
        values: dict[str, float | None] = {"alarms": float(word(self.conditions, self.alarms)), "zone": 0.0}
        if p is None or self.loaded is None:
            bad = any(scan.good(name) is None for name in self.config.watched)
            return values | {"input_quality": 2.0 if bad else 0.0}
        values |= {
            "input_quality": float(p.worst),
            "age": p.age,
            "location": float(p.location_index) if p.known else None,
            "temperature_now": p.mean,
            "band_low": p.low,
            "band_high": p.high,
            "zone": float(ZONES.index(p.zone)),
            "anomaly": p.anomaly,
            "model_hash": float(int(self.loaded.hash[-4:], 16)),
        }
        return values | (block_values(made, self.config.block_horizon, scan.time) if made else {})

    def _record(self, attempt: Attempt | None) -> None:
        if attempt is None:
            return
        before, self.attempt = self.attempt, attempt
        self.historian.put("writes", [records.write_row(attempt)])
        if attempt.latency_ms is not None:
            self.tally.latencies.append(attempt.latency_ms)
        if before is None or (before.verdict, before.reason) != (attempt.verdict, attempt.reason):
            say = self.log.info if attempt.verdict in ("written", "shadow") else self.log.warning
            say("write-back", verdict=attempt.verdict, reason=attempt.reason, sequence=attempt.block.sequence)

    async def withdraw(self, why: str, scan: Scan | None = None) -> None:
        """Tell the PLC once, if armed and permitted, that nothing of ours is to be used any more."""
        scan = scan or self.last
        if self.writer is None or scan is None or not self.writer.armed:
            return
        attempt = await self.writer.withdraw(scan, word(self.conditions, self.alarms))
        self._record(attempt)
        verdict = attempt.verdict if attempt else "off"
        by = self.writer.arming.by if self.writer.arming else ""
        self.historian.put("audit", [(self.clock.now(), f"validity 0: {verdict}", by, why)])

    # ---------------------------------------------------------------- state

    def save(self, now: float) -> None:
        """Keep what a restart goes on from, and have old measurements deleted once an hour."""
        self._saved = now
        snapshot = self.predictor.snapshot() if self.predictor else None
        if snapshot is not None and self.loaded is not None and self.outlook is not None:
            self.historian.save("belief", now, {"model": self.loaded.hash, **snapshot})
            reviews = self.guards.snapshot() if self.guards else {}
            bands = {"model": self.loaded.hash, "horizons": self.outlook.snapshot(), "reviews": reviews}
            self.historian.save("bands", now, bands)
            if self.outlook.ensemble is not None:
                self.historian.save("ensemble", now, self.outlook.ensemble.snapshot())
        if now - self._cleaned >= _HOUR:
            self._cleaned = now
            self.historian.forget_before(now - self.config.historian.retention_days * 86_400.0)

    def _restore(self, now: float) -> None:
        predictor, outlook, guards = self.predictor, self.outlook, self.guards
        belief, bands = (loaded(self.historian, key, self.log) for key in ("belief", "bands"))
        if predictor is None or outlook is None or guards is None or self.loaded is None:
            return
        try:
            if belief is not None and belief[1]["model"] == self.loaded.hash and predictor.restore(belief[1], now):
                self.log.info("goes on from the saved belief", age=now - belief[0])
            if bands is not None and bands[1]["model"] == self.loaded.hash:
                outlook.restore(bands[1]["horizons"])
                guards.restore(bands[1].get("reviews", {}))
                members = loaded(self.historian, "ensemble", self.log) if outlook.ensemble else None
                if members is not None and outlook.ensemble is not None:
                    outlook.ensemble.restore(members[1], now)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            self.log.warning("the saved state cannot be used; the model begins anew", reason=repr(error))
            self.predictor, self.outlook, self.guards = self._new_model()

    def begin_anew(self) -> None:
        """After a failure: nothing of the model's state is trusted."""
        self.predictor, self.outlook, self.guards = self._new_model()
        self.prediction = None
