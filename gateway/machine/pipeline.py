"""One machine: its device, its alarms, perhaps a model and a block, and the way of a scan through them.

Several machines may live in one process: everything is an argument or belongs to the object, nothing to the module.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from random import Random
from typing import TYPE_CHECKING

from drivers.device_file import ACKNOWLEDGE_BITS
from drivers.driver import Complains, Driver, Supervised
from drivers.supervision import Supervisor
from gateway.machine.alarm_desk import AlarmDesk
from gateway.machine.alarms import (
    AlarmBoard,
    AlarmCondition,
    SensorWatch,
    acknowledge_words,
    alarm_name,
    make_conditions,
    suppressing_tags,
    without_faulty,
)
from gateway.machine.followed import FollowedTemperature
from gateway.machine.model import LoadedModel, LoadedModels, ModelUnit, ScanPrediction, load_models, recorded_scans
from gateway.machine.phase import Phase
from gateway.machine.plant_records import PlantRecords
from gateway.machine.reading import Clock, LinkHealth, PlantClock, Redundant, Scan, SwitchOver
from gateway.machine.records import Keeper, Records
from gateway.machine.trust import ClockCheck, RecordsWatch, Surroundings
from gateway.machine.writing import Arming, ArmingError, WritebackStage, end_by_mode, keep_disarming
from gateway.settings import ALARM_KINDS, Config, MachineSigns, WritebackLayout
from gateway.store import FIXED, NO_PROCESS, AuditError, HistorianError, saved_state, to_trace

if TYPE_CHECKING:
    from structlog.typing import FilteringBoundLogger


SAVE_SECONDS = 10.0
PAST_SECONDS = 3600.0
"""What is read back from the historian at a start: as far as the points of a cycle look back (record 0151)."""
MODEL_PART = "model"
"""What a machine's models are called among its parts that may be missing."""
ORDERS = ("WritePermit", ACKNOWLEDGE_BITS)
"""The tags by which the PLC gives orders to the gateway; a further block may have acknowledge bits of its own."""
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

    `followed` are its temperatures, `model` that of the first one; `writing` is None for a machine to which nothing is
    computed for writing. `rng` draws the number that tells this start's blocks from another gateway's. `models` are
    those of its temperatures, where they have been read already, and `without` says which it has to go without, and why
    ("": none), which is an alarm. `records` and `supervisor` are those of the whole
    gateway, and so are the `turns` of its forecasts; without them the machine has its own. `log_failure` says why the
    log's file cannot be written ("": it can).

    Raises ConfigError, HistorianError or AuditError when something cannot be opened; nothing is left open then.
    """

    def __init__(
        self,
        config: Config,
        *,
        driver: Driver,
        clock: Clock,
        log: FilteringBoundLogger,
        rng: Random,
        models: Sequence[LoadedModels] | None = None,
        records: PlantRecords | None = None,
        supervisor: Supervisor | None = None,
        turns: asyncio.Semaphore | None = None,
        without: str = "",
        log_failure: Callable[[], str] = lambda: "",
    ) -> None:
        self._turns, self.without = turns, without
        # Found out once: to look at what a protocol asks for takes longer than to take a reading's alarms.
        self._complains = driver if isinstance(driver, Complains) else None
        self.config, self.driver, self.clock, self.log = config, driver, clock, log
        # What can be refused is read first: a model that does not suit the plant leaves no historian behind.
        models = load_models(config) if models is None else models
        self.supervisor = supervisor or Supervisor(self.note_failure)
        if isinstance(driver, Supervised):
            self.supervisor.include("device", driver.supervisor)
        self.common = records or PlantRecords(
            [config], clock=clock, log=log, supervisor=self.supervisor, log_failure=log_failure
        )
        self._owns_records = records is None
        opened = False
        try:
            now = clock.now()
            store = self.historian = self.common.historian.view(config.machine, config.map.signals)
            self.records_watch = RecordsWatch(store, self.common.supervisor, self.supervisor, log)
            # Kept only under a clock that was believed: one that jumped is not believed at the next start either.
            believed = saved_state(store, "clock", log)
            newest = believed[0] if believed else store.newest()
            self.clock_check = ClockCheck(now, newest, config.historian.max_off_days * 86_400.0)
            self.clock_complaint = ""
            self.followed = tuple(
                self._open_temperature(one, model, members)
                for one, (model, members) in zip(config.temperature_configs, models, strict=True)
            )
            self.model = self.followed[0].model
            self.writing = self._open_writeback(rng)
            self.link, self.counters = LinkHealth(log), RunCounters()
            conditions = self._make_conditions()
            self.alarms = AlarmBoard(
                conditions,
                watched=config.watched_temperatures,
                words=acknowledge_words(config),
                historian=store,
                log=log,
                now=now,
                acknowledge_all=config.alarms.acknowledge,
                sensors=SensorWatch(config.watched_temperatures, config.twins, config.alarms.trend),
            )
            self.desk = AlarmDesk(config, self.alarms, self.common, clock=clock, historian=store, log=log)
            self.surroundings = Surroundings(store.path, config.certificate_folders, self.supervisor)
            left_out = frozenset({config.map.heartbeat} if config.map.heartbeat else ())
            self.records = Records(store, Keeper(config.map.by_name, config.historian.max_interval, left_out))
            if isinstance(driver, Redundant):
                driver.on_switch = self._note_link_switch
            self.last: Scan | None = None
            self.phase: Phase = "starting"
            self._saved = self._cleaned = now
            for one in self.followed:
                if one.model is not None:
                    one.model.restore(now)
                one.note_run(now)
            self._follow_records(now)
            opened = True
        finally:
            if not opened:
                self.close()

    def _follow_records(self, now: float) -> None:
        """Let models and sensors follow the last hour on record; what cannot be read is logged and left out."""
        models = [one.model for one in self.followed if one.model is not None]
        if not models or self.clock_check.complaint(now, offset=0.0, plc=None):
            return
        begun, tags = now - PAST_SECONDS, {*self.inputs, *self.config.watched_temperatures}
        newest = self.historian.newest()
        if newest is None or not begun < newest <= now:
            return
        try:
            trace = to_trace(self.historian.path, start=begun, end=now, machine=self.config.machine, tags=tags)
        except HistorianError as error:
            self.log.warning("the last hour cannot be read back; the model begins without it", reason=str(error))
            return
        period = max(self.config.scan.period, 1.0)
        scans = [scan for scan in recorded_scans(trace, period, models[0].loaded.model.alphabet) if scan.time <= now]
        self.alarms.follow_history(scans)
        for model in models:
            model.follow_history(scans)

    def _open_temperature(
        self, config: Config, loaded: LoadedModel | None, members: tuple[LoadedModel, ...]
    ) -> FollowedTemperature:
        store = self.common.historian.view(config.machine, config.map.signals, config.model.temperature)
        model = None
        if loaded is not None:
            model = ModelUnit(
                config,
                loaded,
                members,
                historian=store,
                log=self.log,
                supervisor=self.supervisor,
                turns=self._turns,
            )
        one = FollowedTemperature(config, store, model)
        self._rely_on_models(one)
        return one

    def _rely_on_models(self, one: FollowedTemperature) -> None:
        """Look at the files of the models that run now, as what is written back is theirs."""
        files = one.model.files if one.model is not None else ()
        self.common.files.watch(self._models_name(one.tag), dict.fromkeys(files, FIXED))

    def _models_name(self, tag: str) -> str:
        """What a temperature's models are called among the files that are relied on."""
        return f"models of {self.config.machine} {tag}"

    def _end_arming(self) -> None:
        """Have an arming end with the mode 'off', on record."""
        config = self.config
        try:
            row = end_by_mode(config, lambda: self.common.open_trail(config).audit, self.clock.now())
        except (ArmingError, AuditError, OSError) as error:
            self.log.error("an arming may come back when the mode is another one; disarm", reason=str(error))
            return
        if row is not None:
            self.log.warning("the arming is over, as writeback.mode is 'off'", by=row.entry.who)

    def _open_writeback(self, rng: Random) -> WritebackStage | None:
        """The stage of the blocks, one for each temperature of which the device takes one."""
        config = self.config
        layouts: dict[str, WritebackLayout] = {}
        for one in self.followed:
            # A lone block of which the file does not say whose it is is the first temperature's.
            if (layout := one.config.block_layout) is not None and layout not in layouts.values():
                layouts[one.tag] = layout
        if config.writeback.mode == "off":
            self._end_arming()
        if config.writeback.mode == "off" or not layouts:
            return None
        writing = WritebackStage(
            config,
            list(layouts.values()),
            self.common.open_trail(config),
            clock=self.clock,
            driver=self.driver,
            historian=self.historian,
            of_blocks=[one.historian for one in self.followed if one.tag in layouts],
            supervisor=self.supervisor,
            log=self.log,
            rng=rng,
            log_failure=self.common.log_failure,
        )
        for one in self.followed:
            one.block = next(
                (block for block, tag in zip(writing.blocks, layouts, strict=True) if tag == one.tag), None
            )
        return writing

    @property
    def inputs(self) -> tuple[str, ...]:
        """The tags that the models read; without one those that are watched."""
        read = [name for one in self.followed if one.model for name in one.model.predictor.inputs]
        return tuple(dict.fromkeys(read)) or self.config.watched_temperatures

    @property
    def alarm_words(self) -> list[int]:
        """The alarm word of each block, in their order."""
        return [self.alarms.word(one.tag) for one in self.followed if one.block is not None]

    @property
    def unverified_reason(self) -> str:
        """Why nothing may be written: a model runs although it does not verify; "" if it may."""
        return next((one.unverified_reason for one in self.followed if one.unverified_reason), "")

    # ---------------------------------------------------------------- the way of a scan

    async def take(self, scan: Scan) -> None:
        """The way of one scan, from top to bottom; each stage takes it once."""
        self.last = scan
        self.counters.take(scan)
        self.link.take(scan)

        # The threshold stands before the model: nothing that the model does or fails to do delays this alarm.
        self.alarms.take_readings(scan)

        # What a faulty sensor shows goes on being recorded and held against the threshold; no model sees it.
        faults = self.alarms.faulty_sensors(scan.time)
        believed = without_faulty(scan, faults) if faults else scan

        for one in self.followed:
            one.begin_scan()
        try:
            findings: dict[str, float | None] = {}
            for one in self.followed:
                if one.model is not None and one.model.adopt_promoted_model(scan.time):
                    self._begin_new_model(one, scan.time)
                fault = faults.get(one.tag)
                for name, value in one.predict(believed, fault.since if fault else None).items():
                    findings[alarm_name(self.config, name, one.tag)] = value
                if one.prediction is not None:
                    self.counters.take_events(one.prediction)

            self._look_at_itself(scan)
            signs = self._signs(scan)
            findings |= {
                name: find(signs)
                for name, condition in self.alarms.conditions.items()
                if (find := ALARM_KINDS[condition.kind].finding) is not None
            }
            self.alarms.on_predictions(scan, findings)
            await self._disarm_without_records(scan.time)

            # The block carries the alarm word, so that it comes after all alarms of its scan.
            if self.writing is not None:
                await self.writing.begin(scan, self.alarm_words, self.unverified_reason)
                for one in self.followed:
                    await one.write(scan, self.alarms.word(one.tag))
        finally:
            # After the block, which they would delay; and also of a scan in which a stage failed.
            self.records.take(scan)
            for one in self.followed:
                one.keep(scan)

        for one in self.followed:
            one.foresee(believed)
        if scan.time - self._saved >= SAVE_SECONDS:
            self.save(scan.time)

    @property
    def missing_parts(self) -> Mapping[str, str]:
        """What could not be begun, and why, by the parts' names: of the machine, and of the plant where it leads."""
        own = {MODEL_PART: self.without} if self.without else {}
        return {**own, **self.common.without} if self.config.leads else own

    def _look_at_itself(self, scan: Scan) -> None:
        """Whether records, clock and surroundings can be relied on at this scan; what changes is logged."""
        self.surroundings.look(scan.time)
        self.records_watch.look(scan.time, self.common.subject_complaint(self.config.subject))
        clock, before = self.clock, self.clock_complaint
        offset = clock.wall_offset() if isinstance(clock, PlantClock) and clock.speed == 1.0 else 0.0
        plc = scan.good(self.config.clock.tag) if self.config.clock.tag else None
        self.clock_complaint = self.clock_check.complaint(scan.time, offset=offset, plc=plc)
        if bool(before) != bool(self.clock_complaint):
            reason = self.clock_complaint or "it agrees with the records again"
            event = "the clock cannot be relied on" if self.clock_complaint else "the clock can be relied on again"
            self.log.warning(event, reason=reason)

    def _signs(self, scan: Scan) -> MachineSigns:
        """What the machine and its plant show their alarms at this scan."""
        predictions = [one.prediction for one in self.followed if one.prediction is not None]
        return MachineSigns(
            config=self.config,
            good=scan.good,
            worst_inputs=tuple(float(prediction.worst) for prediction in predictions),
            link_alive=self.link.alive,
            records_complaint=self.records_watch.complaint,
            failed_parts=self.records_watch.failed_parts,
            missing_parts=self.missing_parts,
            clock_complaint=self.clock_complaint,
            clock_speed=self.clock.speed,
            clock_error=self.surroundings.clock_error,
            free_mb=self.surroundings.free_mb,
            certificate_days=self.surroundings.days,
            undelivered=self.common.undelivered(),
            unreached=self.common.unreached(),
            complaints=self.complaints(),
            rival=None if self.writing is None else self.writing.rival(scan.time),
        )

    async def _disarm_without_records(self, now: float) -> None:
        """Disarm once it has been too long that a write would not be on record."""
        if self.writing is not None and self.writing.armed and (reason := self._unrecorded_reason(now)):
            await self.disarm("the gateway", reason[:200])

    def _unrecorded_reason(self, now: float) -> str:
        """Why nothing may be written, since it has not been on record for too long; "" if it may."""
        most = self.config.historian.disarm_after
        if most is None or self.records_watch.stuck_time(now) < most:
            return ""
        return f"nothing has been on record for {most:g} s: {self.historian.stuck}"

    def _make_conditions(self) -> dict[str, AlarmCondition]:
        """The alarms by their names, with the limits that go with the models that run now."""
        records = {one.tag: one.model.loaded.model.anomalies for one in self.followed if one.model is not None}
        return make_conditions(
            self.config,
            self.inputs,
            complains=self._complains is not None,
            anomaly_levels={tag: record.level for tag, record in records.items() if record is not None},
        )

    def _begin_new_model(self, one: FollowedTemperature, now: float) -> None:
        """Another model runs from this scan on: its inputs are watched, and the historian knows whose rows follow."""
        self.alarms.conditions = self._make_conditions()
        self._rely_on_models(one)
        one.note_run(now)

    def note_failure(self, part: str, error: BaseException) -> None:
        """A part has failed, in another way than the last time or after it had been well."""
        message = "a part of the gateway failed and is begun anew"
        self.log.error(message, part=part, reason=repr(error), exc_info=error)

    def _note_link_switch(self, switch: SwitchOver) -> None:
        """Another link is used from now on."""
        change = {"before": switch.before, "after": switch.after, "reason": switch.reason}
        self.log.warning("another link is used", time=switch.time, waited=round(switch.waited, 4), **change)
        self.historian.put("audit", [(switch.time, f"link {switch.after}", switch.before, switch.reason)])

    # ---------------------------------------------------------------- what is asked of it between scans

    def urgent(self) -> frozenset[str]:
        """The tags whose change is worth a scan of its own: those of the models and alarms, the PLC's orders."""
        orders = (*ORDERS, *acknowledge_words(self.config), *filter(None, (self.config.alarms.acknowledge,)))
        return frozenset(
            (*self.inputs, *self.config.watched_temperatures, *orders, *suppressing_tags(self.alarms.conditions))
        )

    def complaints(self) -> tuple[str, ...]:
        """What the device itself says is wrong with it, now."""
        return self._complains.complaints() if self._complains is not None else ()

    async def arm(
        self,
        by: str,
        reason: str,
        minutes: float,
        acknowledged: Sequence[str] = (),
        *,
        process: Mapping[str, int] = NO_PROCESS,
    ) -> Arming:
        """Let blocks be written from the next scan on; `acknowledged` are heads of lost rows. Raises ArmingError.

        `process` are `uid` and `pid` of the program by which the person asks, for the records.
        """
        if self.writing is None:
            raise ArmingError("writeback.mode is 'off' or the device file has no [writeback]; set the mode to 'shadow'")
        if why := self.common.files.complaint or self.common.log_failure():
            raise ArmingError(f"not armed: {why}")
        if why := self._unrecorded_reason(self.clock.now()):
            raise ArmingError(f"not armed, as it would disarm itself: {why}")
        return await self.writing.arm(
            by, reason, minutes, unverified=self.unverified_reason, acknowledged=acknowledged, process=process
        )

    async def disarm(self, by: str, reason: str, *, process: Mapping[str, int] = NO_PROCESS) -> bool:
        """Take everything back at the PLC, if it can be reached, and write no more; False if it was not armed.

        It is on record also where nothing can be armed now: against a file of mode "armed" that is taken over later.
        """
        if self.writing is None:
            await self._note_disarming(by, reason, process)
            return False
        # Whoever asked may go away, or the gateway stop, before it is done: it is carried to its end all the same.
        return await asyncio.shield(self.writing.disarm(by, reason, self.last, self.alarm_words, process=process))

    async def _note_disarming(self, by: str, reason: str, process: Mapping[str, int]) -> None:
        try:
            audit = (await asyncio.to_thread(self.common.open_trail, self.config)).audit
        except (AuditError, OSError) as error:
            self.log.error("a disarming could not be kept; a file of mode 'armed' may arm", reason=str(error))
            return
        await asyncio.shield(
            keep_disarming(self.config, audit, self.clock.now(), by=by, reason=reason, process=process)
        )

    async def withdraw(self, why: str) -> None:
        """Tell the PLC once, if armed and permitted, that nothing of ours is to be used any more."""
        if self.writing is not None and self.last is not None:
            await self.writing.withdraw(why, self.last, self.alarm_words)

    # ---------------------------------------------------------------- state

    def begin_anew(self) -> None:
        """After a failure: nothing of the models' state is trusted."""
        for one in self.followed:
            if one.model is not None:
                one.model.begin_anew()

    def save(self, now: float) -> None:
        """Keep what a restart goes on from, and have old measurements deleted once an hour."""
        self._saved = now
        for one in self.followed:
            if one.model is not None:
                one.model.save(now)
        self.alarms.save(now)
        if self.clock_complaint:
            return  # a clock that is not believed neither deletes nor is what the next one is held against
        self.historian.save("clock", now, {})
        if now - self._cleaned >= _HOUR:
            self._cleaned = now
            self.common.historian.delete_older(now - self.config.historian.retention_days * 86_400.0)

    async def finish(self) -> None:
        """Wait for what is being computed; what it gives is dropped. Then keep what a restart goes on from."""
        for one in self.followed:
            if one.model is not None:
                await one.model.close()
        await self.surroundings.close()
        for one in self.followed:
            await asyncio.to_thread(self.common.files.forget, self._models_name(one.tag))
        self.save(self.clock.now())

    def close(self) -> bool:
        """Store what waits and close the records that are this machine's own; False if some had to be given up."""
        return not self._owns_records or self.common.close()
