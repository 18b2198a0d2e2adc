"""One machine: its device, its alarms, perhaps a model and a block, and the way of a scan through them.

Several machines may live in one process: everything is an argument or belongs to the object, nothing to the module.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from random import Random
from typing import TYPE_CHECKING

from drivers.driver import Complains, Driver, Supervised
from drivers.supervision import Supervisor
from gateway.machine.alarms import CLOCK, DEVICE, OTHER_WRITER, PARTS, RECORDS, AlarmBoard, make_conditions
from gateway.machine.model import ModelUnit, ScanPrediction, load_members, load_model
from gateway.machine.reading import Clock, LinkHealth, PlantClock, Redundant, Scan, SwitchOver
from gateway.machine.records import Keeper, Records
from gateway.machine.trust import ClockCheck, RecordsWatch
from gateway.machine.writing import Arming, ArmingError, AuditTrail, WritebackStage, open_audit_trail
from gateway.settings import Config
from gateway.status import Phase
from gateway.store import open_historian, saved_state

if TYPE_CHECKING:
    from structlog.typing import FilteringBoundLogger


SAVE_SECONDS = 10.0
ORDERS = ("WritePermit", "AcknowledgeBits")
"""The tags by which the PLC gives orders to the gateway."""
RECENT_EVENTS = 20
_HOUR = 3600.0


@dataclass(slots=True)
class RunCounters:
    """Counters since the start, and the newest events."""

    scans: int = 0
    early: int = 0
    missed: int = 0
    events: int = 0
    failures: int = 0
    last_failure: str = ""
    recent: deque[tuple[float, str, str]] = field(default_factory=lambda: deque(maxlen=RECENT_EVENTS))

    def take(self, scan: Scan) -> None:
        """Count a scan."""
        self.scans, self.missed, self.early = self.scans + 1, self.missed + scan.missed, self.early + scan.early

    def take_events(self, prediction: ScanPrediction) -> None:
        """Count the events of a scan."""
        self.recent.extend((event.time, event.symbol, prediction.location) for event in prediction.events)
        self.events += len(prediction.events)


class Machine:
    """All parts of one machine, opened (the driver not yet): one scan after another goes through `take`.

    `model` is None for one that is only monitored, `writing` for one to which nothing is computed for writing. `rng`
    draws the number that tells this start's blocks from another gateway's, `log_failure` says why the log's file cannot
    be written ("": it can). Raises ConfigError, HistorianError or
    AuditError when something cannot be opened; nothing is left open then.
    """

    def __init__(
        self,
        config: Config,
        *,
        driver: Driver,
        clock: Clock,
        log: FilteringBoundLogger,
        rng: Random,
        log_failure: Callable[[], str] = lambda: "",
    ) -> None:
        self._log_failure = log_failure
        self.config, self.driver, self.clock, self.log = config, driver, clock, log
        # What can be refused is read first: a model that does not suit the plant leaves no historian behind.
        loaded = load_model(config)
        members = load_members(config, loaded)
        self.supervisor = Supervisor(self._note_failure)
        if isinstance(driver, Supervised):
            self.supervisor.include("device", driver.supervisor)
        self.historian, numbers = open_historian(
            config.historian.path,
            config.map.tags,
            max_mb=config.historian.max_mb,
            mend=True,
            supervisor=self.supervisor,
        )
        self.trail: AuditTrail | None = None
        self.writing: WritebackStage | None = None
        opened = False
        try:
            now, store = clock.now(), self.historian
            self.records_watch = RecordsWatch(store, self.supervisor, log)
            # Kept only under a clock that was believed: one that jumped is not believed at the next start either.
            believed = saved_state(store, "clock", log)
            newest = believed[0] if believed else store.newest()
            self.clock_check = ClockCheck(now, newest, config.historian.max_off_days * 86_400.0)
            self.clock_complaint = ""
            self.model = (
                None
                if loaded is None
                else ModelUnit(config, loaded, members, historian=store, log=log, supervisor=self.supervisor)
            )
            self.link, self.counters = LinkHealth(log), RunCounters()
            inputs = self.model.predictor.inputs if self.model else config.watched
            conditions = make_conditions(config, inputs, complains=isinstance(driver, Complains))
            self.alarms = AlarmBoard(conditions, watched=config.watched, historian=store, log=log, now=now)
            layout = config.map.block_of(config.model.temperature)
            if layout is not None and config.writeback.mode != "off":
                self.trail = open_audit_trail(config, historian=store, supervisor=self.supervisor, log=log)
                self.writing = WritebackStage(
                    config,
                    [layout],
                    self.trail,
                    clock=clock,
                    driver=driver,
                    historian=store,
                    supervisor=self.supervisor,
                    log=log,
                    rng=rng,
                    log_failure=log_failure,
                )
            left_out = frozenset({config.map.heartbeat} if config.map.heartbeat else ())
            self.records = Records(store, Keeper(config.map.by_name, numbers, config.historian.max_interval, left_out))
            if isinstance(driver, Redundant):
                driver.on_switch = self._note_switch_over
            self.last: Scan | None = None
            self.phase: Phase = "starting"
            self._saved = self._cleaned = now
            if self.model is not None:
                self.model.restore(now)
            self._note_run(now)
            opened = True
        finally:
            if not opened:
                self.close()

    # ---------------------------------------------------------------- the way of a scan

    async def take(self, scan: Scan) -> None:
        """The way of one scan, from top to bottom; each stage takes it once."""
        self.last = scan
        self.counters.take(scan)
        self.link.take(scan)

        # The threshold stands before the model: nothing that the model does or fails to do delays this alarm.
        self.alarms.on_measured(scan)

        prediction = forecast = finished = guards = None
        try:
            if self.model is not None:
                if self.model.pick_up(scan.time):
                    self._begin_with_promoted(self.model, scan.time)
                prediction = self.model.follow(scan)
                self.counters.take_events(prediction)
                if (finished := self.model.settle(prediction)) is not None:
                    guards = self.model.guard_report()
                forecast = self.model.usable(prediction)

            self._look_at_itself(scan)
            findings = self.model.findings(prediction, forecast) if self.model and prediction else {}
            if DEVICE in self.alarms.conditions:
                findings[DEVICE] = float(bool(self.complaints()))
            if OTHER_WRITER in self.alarms.conditions and self.writing is not None:
                findings[OTHER_WRITER] = float(bool(self.writing.rival(scan.time)))
            findings[RECORDS] = float(bool(self.records_watch.complaint))
            findings[PARTS] = float(bool(self.records_watch.failed_parts))
            findings[CLOCK] = float(bool(self.clock_complaint))
            self.alarms.on_predictions(scan, findings)
            await self._disarm_without_records(scan.time)

            # The block carries the alarm word, so that it comes after all alarms of its scan.
            if self.writing is not None:
                await self.writing.begin(scan, [self.alarms.word], self.model.unverified if self.model else "")
                for block in self.writing.blocks:
                    await block.take(
                        scan,
                        prediction,
                        forecast,
                        alarms=self.alarms.word,
                        model_hash=self.model.loaded.hash if self.model else "",
                    )
        finally:
            # After the block, which they would delay; and also of a scan in which a stage failed.
            self.records.take(scan, prediction, finished, guards)

        if self.model is not None and prediction is not None:
            self.model.foresee(scan, prediction)
        if scan.time - self._saved >= SAVE_SECONDS:
            self.save(scan.time)

    def _look_at_itself(self, scan: Scan) -> None:
        """Whether records and clock can be relied on at this scan; what changes is logged."""
        audit = self.writing.audit.complaint if self.writing else ""
        self.records_watch.look(scan.time, audit or self._log_failure())
        clock, before = self.clock, self.clock_complaint
        offset = clock.wall_offset() if isinstance(clock, PlantClock) and clock.speed == 1.0 else 0.0
        plc = scan.good(self.config.clock.tag) if self.config.clock.tag else None
        self.clock_complaint = self.clock_check.complaint(scan.time, offset=offset, plc=plc)
        if bool(before) != bool(self.clock_complaint):
            reason = self.clock_complaint or "it agrees with the records again"
            self.log.warning("the clock is looked at anew", believed=not self.clock_complaint, reason=reason)

    async def _disarm_without_records(self, now: float) -> None:
        """Disarm once it has been too long that a write would not be on record."""
        most = self.config.historian.disarm_after
        if most is not None and self.records_watch.stuck_for(now) >= most:
            reason = f"nothing has been on record for {most:g} s: {self.historian.stuck}"
            await self.disarm("the gateway", reason[:200])

    def _begin_with_promoted(self, model: ModelUnit, now: float) -> None:
        """Another model runs from this scan on: its inputs are watched, and the historian knows whose rows follow."""
        inputs = model.predictor.inputs
        self.alarms.conditions = make_conditions(self.config, inputs, complains=isinstance(self.driver, Complains))
        self._note_run(now)

    def _note_run(self, now: float) -> None:
        config, model = self.config, self.model.loaded.hash if self.model else ""
        run = (now, config.model.temperature, model, config.scan.period, config.historian.max_interval)
        self.historian.put("runs", [run])

    def _note_failure(self, part: str, error: BaseException) -> None:
        """A part has failed, in another way than the last time or after it had been well."""
        message = "a part of the gateway failed and is begun anew"
        self.log.error(message, part=part, reason=repr(error), exc_info=error)

    def _note_switch_over(self, switch: SwitchOver) -> None:
        """Another link is used from now on."""
        change = {"before": switch.before, "after": switch.after, "reason": switch.reason}
        self.log.warning("another link is used", time=switch.time, waited=round(switch.waited, 4), **change)
        self.historian.put("audit", [(switch.time, f"link {switch.after}", switch.before, switch.reason)])

    # ---------------------------------------------------------------- what is asked of it between scans

    def urgent(self) -> frozenset[str]:
        """The tags whose change is worth a scan of its own: those of the model, of the alarms, the PLC's orders."""
        inputs = self.model.predictor.inputs if self.model else ()
        return frozenset((*inputs, *self.config.watched, *ORDERS))

    def complaints(self) -> tuple[str, ...]:
        """What the device itself says is wrong with it, now."""
        return self.driver.complaints() if isinstance(self.driver, Complains) else ()

    async def arm(self, by: str, reason: str, minutes: float, acknowledged: Sequence[str] = ()) -> Arming:
        """Let blocks be written from the next scan on; `acknowledged` are heads of lost rows. Raises ArmingError."""
        unverified = self.model.unverified if self.model else ""
        if self.writing is None:
            raise ArmingError("writeback.mode is 'off' or the device file has no [writeback]; set the mode to 'shadow'")
        if why := self._log_failure():
            raise ArmingError(f"not armed: {why}")
        return await self.writing.arm(by, reason, minutes, unverified=unverified, acknowledged=acknowledged)

    async def disarm(self, by: str, reason: str) -> bool:
        """Take everything back at the PLC, if it can be reached, and write no more; False if it was not armed."""
        if self.writing is None:
            return False
        # Whoever asked may go away, or the gateway stop, before it is done: it is carried to its end all the same.
        return await asyncio.shield(self.writing.disarm(by, reason, self.last, [self.alarms.word]))

    async def withdraw(self, why: str) -> None:
        """Tell the PLC once, if armed and permitted, that nothing of ours is to be used any more."""
        if self.writing is not None and self.last is not None:
            await self.writing.withdraw(why, self.last, [self.alarms.word])

    # ---------------------------------------------------------------- state

    def begin_anew(self) -> None:
        """After a failure: nothing of the model's state is trusted."""
        if self.model is not None:
            self.model.begin_anew()

    def save(self, now: float) -> None:
        """Keep what a restart goes on from, and have old measurements deleted once an hour."""
        self._saved = now
        if self.model is not None:
            self.model.save(now)
        if self.clock_complaint:
            return  # a clock that is not believed neither deletes nor is what the next one is held against
        self.historian.save("clock", now, {})
        if now - self._cleaned >= _HOUR:
            self._cleaned = now
            self.historian.forget_before(now - self.config.historian.retention_days * 86_400.0)

    def close(self) -> bool:
        """Store what waits and close historian and audit log; False if records had to be given up."""
        accounted = self.trail is None or self.trail.close(self.clock.now())
        return self.historian.close() and accounted
