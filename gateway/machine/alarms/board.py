"""The alarms of one machine: what was measured and what the model finds move them, the PLC and persons acknowledge."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from drivers.errors import OneLineError, did_you_mean
from gateway.machine.alarms.conditions import DRIFTING, OVER_LIMIT, on_tag
from gateway.machine.alarms.sensors import DISTRUSTED, SensorFault, SensorWatch
from gateway.machine.alarms.states import (
    BY_PERSONS,
    CHANGE_WORDS,
    HIDDEN,
    UNSEEN,
    Alarm,
    AlarmCondition,
    AlarmState,
    Change,
    acknowledge,
    apply_change,
    from_plain,
    new_alarm,
    possible,
    step,
    to_plain,
    transition,
    word,
)
from gateway.machine.reading import Scan
from gateway.settings import LEAST_URGENT, OF_PLANT
from gateway.store import HistorianView, saved_state

if TYPE_CHECKING:
    from structlog.typing import FilteringBoundLogger

AlarmListener = Callable[[AlarmCondition, Alarm, Alarm], None]
"""Told of each change of a state: the condition, the alarm before and after. It must not wait for anything."""

GATEWAY = "the gateway"
"""Who takes an alarm off the shelf when its time is over."""


class AlarmError(OneLineError, ValueError):
    """A change that cannot be made; the message is one sentence."""


class AlarmBoard:
    """All alarms of a machine, in two stages of a scan: `take_readings` before the model, `on_predictions` after it.

    What changes is on record and in the log at once: an alarm waits for nothing that comes later in the scan. The
    alarms go on as they were when the gateway last ran; what cannot be read begins as normal, and is logged, and what
    the machine has no longer is normal on record from now on: nothing would ever clear it. One that stood against
    another limit than today's is over until a reading says otherwise. `newest` are the numbers that were last held
    against the limits, by the alarms' names, None where one was not known, and none before the first scan. `words`
    are the PLC's words of acknowledge bits, by tag, each with the temperatures whose alarms it acknowledges; the rise
    of the tag `acknowledge_all` from 0 acknowledges all. `listeners` are told of every change of a state.
    """

    def __init__(
        self,
        conditions: Mapping[str, AlarmCondition],
        *,
        watched: Sequence[str],
        words: Mapping[str, frozenset[str]],
        historian: HistorianView,
        log: FilteringBoundLogger,
        now: float,
        acknowledge_all: str | None = None,
        sensors: SensorWatch | None = None,
    ) -> None:
        self.conditions, self.watched, self._words = conditions, watched, words
        self._historian, self._log, self._sensors = historian, log, sensors
        self._acknowledge_all = acknowledge_all
        self._acknowledged: dict[str, int | None] = {}
        self._pressed: bool | None = None
        self.listeners: list[AlarmListener] = []
        self.alarms = {name: new_alarm(condition, now) for name, condition in conditions.items()}
        self.newest: dict[str, float | None] = {}
        saved = saved_state(historian, "alarms", log) or (now, {})
        if gone := {name: plain for name, plain in saved[1].items() if name not in conditions}:
            self._end_for_good(gone, now)
        for name, plain in saved[1].items():
            if name in conditions:
                try:
                    alarm = from_plain(conditions[name], plain)
                except (KeyError, TypeError, ValueError) as error:
                    log.warning("a saved alarm cannot be read and begins as normal", alarm=name, reason=str(error))
                    continue
                if alarm.until is not None:
                    # By the clock of now or by what was left when it was saved, whichever ends first: a clock that
                    # was set back meanwhile prolongs no shelving.
                    alarm = replace(alarm, until=min(alarm.until, now + max(alarm.until - saved[0], 0.0)))
                self.alarms[name] = alarm
        before = dict(self.alarms)
        for name, condition in conditions.items():
            plain = saved[1].get(name)
            # What stood against a limit that is higher now may be over; against a lower one it stands all the more.
            if isinstance(plain, dict) and condition.limit > plain.get("limit", condition.limit):
                self.alarms[name] = apply_change(self.alarms[name], Change.CLEAR, now, latching=condition.latches)
        self._publish_changes(before, {}, now)
        if gone:
            self._save_alarms(now)
        if sensors is not None and (state := saved_state(historian, "sensors", log)) is not None:
            try:
                sensors.restore(state[1])
            except (KeyError, TypeError, ValueError) as error:
                log.warning("what was known of the sensors cannot be read and begins anew", reason=repr(error))

    def _end_for_good(self, gone: Mapping[str, Any], now: float) -> None:
        """Put on record that alarms are normal which the machine had when it last ran, and has no longer."""
        reason = "the machine has no such alarm any more"
        for name, plain in gone.items():
            state = plain.get("state") if isinstance(plain, dict) else None
            if state in {each.value for each in AlarmState} - {AlarmState.NORMAL.value}:
                tag, priority = str(plain.get("tag", "")), int(plain.get("priority", LEAST_URGENT))
                self._historian.put("alarms", [(now, name, tag, priority, AlarmState.NORMAL.value, None, GATEWAY)])
                self._historian.put("audit", [(now, f"alarm {name}: ended", GATEWAY, reason)])
                self._log.warning("alarm", condition=name, state=AlarmState.NORMAL.value, reason=reason)

    def word(self, temperature: str) -> int:
        """The alarm word of the block of a temperature."""
        return word(self.conditions, self.alarms, temperature)

    # ---------------------------------------------------------------- the stages of a scan

    def take_readings(self, scan: Scan) -> None:
        """The PLC's acknowledge bits, then the thresholds and the sensors: they need neither model nor forecast."""
        before = dict(self.alarms)
        self._take_acknowledgements(scan)
        for name, condition in self.conditions.items():
            alarm = self.alarms[name]
            if condition.suppressed_by is None and alarm.until is None:
                continue
            if condition.suppressed_by is not None:
                tag, wanted = condition.suppressed_by
                value = scan.good(tag)
                # Of a tag that cannot be read nobody knows that the alarm means nothing.
                suppress = value is not None and bool(value) == bool(wanted)
                change = Change.SUPPRESS if suppress else Change.UNSUPPRESS
                alarm = apply_change(alarm, change, scan.time, GATEWAY, reason=tag, latching=condition.latches)
            if alarm.until is not None and scan.time >= alarm.until:
                change, reason = Change.UNSHELVE, "its time is over"
                alarm = apply_change(alarm, change, scan.time, GATEWAY, reason=reason, latching=condition.latches)
            self.alarms[name] = alarm
        # By itself: what is acknowledged and over in one scan went by two rows of the table, and is so on record.
        self._publish_changes(before, {}, scan.time)
        values = {on_tag(OVER_LIMIT, name): scan.good(name) for name in self.watched}
        if self._sensors is not None:
            values |= self._sensors.take(scan)
        self._step(values, scan.time, dict(self.alarms))

    def on_predictions(self, scan: Scan, findings: Mapping[str, float | None]) -> None:
        """What the models find, and the machine of itself; None for what is not known."""
        self._step(findings, scan.time, dict(self.alarms))

    def follow_history(self, scans: Iterable[Scan]) -> None:
        """Let the sensors have a past that was read before a start: no alarm changes by it.

        How the twins differed is kept over a start, and has been learned from these readings already.
        """
        if self._sensors is None:
            return
        kept = self._sensors.to_plain()
        for scan in scans:
            self._sensors.take(scan)
        self._sensors.restore(kept)

    def faulty_sensors(self, now: float) -> dict[str, SensorFault]:
        """The sensors, by their tags, whose readings are not to be believed, by the alarms that stand.

        An alarm that is shelved stands all the same; one that means nothing (by design, or out of service) takes no
        reading away.
        """
        found: dict[str, SensorFault] = {}
        for name, condition in self.conditions.items():
            alarm = self.alarms[name]
            silent = alarm.state in (AlarmState.SUPPRESSED, AlarmState.OUT_OF_SERVICE)
            if self._sensors is not None and condition.kind in DISTRUSTED and alarm.standing and not silent:
                fault = self._sensors.fault(condition.kind, condition.tag, now)
                # Of several the one that began first: from then on nothing was right.
                if condition.tag not in found or fault.since < found[condition.tag].since:
                    found[condition.tag] = fault
        return found

    def _take_acknowledgements(self, scan: Scan) -> None:
        """What the PLC acknowledges: by bits, each those alarms that share it, and by one tag all of them."""
        for tag, temperatures in self._words.items():
            bits = scan.good(tag)
            if bits is not None:
                own = {
                    name: condition
                    for name, condition in self.conditions.items()
                    if not condition.temperature or condition.temperature in temperatures
                }
                alarms = {name: self.alarms[name] for name in own}
                former = self._acknowledged.get(tag)
                self.alarms |= acknowledge(own, alarms, before=former, bits=int(bits), now=scan.time, by="PLC")
            # Bits that could not be read leave no edge to be seen when they can be again.
            self._acknowledged[tag] = None if bits is None else int(bits)
        if (tag_of_all := self._acknowledge_all) is not None:
            pressed = scan.good(tag_of_all)
            if pressed and self._pressed is False:
                for name, alarm in self.alarms.items():
                    self.alarms[name] = apply_change(alarm, Change.ACKNOWLEDGE, scan.time, "PLC")
            self._pressed = None if pressed is None else bool(pressed)

    def _step(self, values: Mapping[str, float | None], now: float, before: Mapping[str, Alarm]) -> None:
        """Let the conditions follow their values; then what has changed since `before` is made known."""
        raised = []
        for name, value in values.items():
            # One that the plant file switches off is not there.
            if (condition := self.conditions.get(name)) is None:
                continue
            self.newest[name] = value
            alarm = self.alarms[name]
            after = self.alarms[name] = step(condition, alarm, value, now)
            # One that came off the shelf in this scan stands already: it is not raised by what else moves in it.
            came = after.state is AlarmState.UNACKNOWLEDGED and alarm.state is not AlarmState.UNACKNOWLEDGED
            if came and after.raised == now:
                raised.append((now if alarm.pending is None else alarm.pending, name))
        # What stands of the plant is no cause of what comes of the machine, nor the other way round.
        for of_plant in (False, True):
            if own := [row for row in raised if self._is_of_plant(row[1]) is of_plant]:
                self._mark_first_up(own, of_plant=of_plant)
        self._publish_changes(before, values, now)

    def _is_of_plant(self, name: str) -> bool:
        return name in self.conditions and self.conditions[name].kind in OF_PLANT

    def _mark_first_up(self, raised: Sequence[tuple[float, str]], *, of_plant: bool) -> None:
        """Of alarms that come when none stands or waits, the one that began first: the others may be its doing."""
        fresh = {name for _, name in raised}
        others = {name for name in self.alarms if name not in fresh and self._is_of_plant(name) is of_plant}
        shown = (alarm for name, alarm in self.alarms.items() if name in others and alarm.state not in HIDDEN)
        if any(alarm.state is not AlarmState.NORMAL for alarm in shown):
            return
        # Of several at one moment the more urgent; `min` takes the first of equals, in the order of the stages.
        first = min(raised, key=lambda row: (row[0], self.conditions[row[1]].priority))[1]
        for name in fresh:
            self.alarms[name] = replace(self.alarms[name], first_up=name == first)

    def _publish_changes(self, before: Mapping[str, Alarm], values: Mapping[str, float | None], now: float) -> None:
        """Keep, record, log and pass on what is another state than before."""
        changes = [
            (before[name], after)
            for name, after in self.alarms.items()
            if after is not before[name]
            and (after.state, after.standing) != (before[name].state, before[name].standing)
        ]
        if not changes:
            return
        self._save_alarms(now)
        for former, after in changes:
            condition, value = self.conditions[after.condition], values.get(after.condition)
            by = after.by or after.acknowledged_by
            row = (now, after.condition, after.tag, after.priority, after.state.value, value, by)
            self._historian.put("alarms", [row])
            if after.state is former.state:
                continue  # it came or went where nobody is shown it
            response = condition.response if after.active else ""
            self._log.warning(
                "alarm", condition=after.condition, state=after.state.value, value=value, response=response
            )
            for listener in self.listeners:
                listener(condition, former, after)

    # ---------------------------------------------------------------- what persons do

    def waiting(self) -> tuple[str, ...]:
        """The alarms that wait for an acknowledgement, the most urgent first."""
        names = [name for name, alarm in self.alarms.items() if alarm.state in UNSEEN and name in self.conditions]
        return tuple(sorted(names, key=lambda name: (self.alarms[name].priority, self.alarms[name].since)))

    def check(self, name: str, change: Change) -> None:
        """See that a person may make this change now. Raises AlarmError with what could be done instead."""
        if name not in self.alarms or name not in self.conditions:
            guess = did_you_mean(name, self.alarms)
            raise AlarmError(f"there is no alarm {name[:100]!r}; {guess or 'known are ' + ', '.join(self.alarms)}")
        alarm, latching = self.alarms[name], self.conditions[name].latches
        if transition(alarm, change, latching=latching) is None:
            may = [each.value for each in possible(alarm, latching=latching) if each in BY_PERSONS]
            raise AlarmError(
                f"{name!r} is {alarm.state.value}, so that there is nothing to {change.value}; "
                f"what can be done: {', '.join(may) or 'nothing'}"
            )

    def change(
        self, name: str, change: Change, now: float, *, by: str, reason: str, until: float | None = None
    ) -> Alarm:
        """Make a person's change; `until` (s UTC) is the end of a shelving. Raises AlarmError."""
        self.check(name, change)
        before = dict(self.alarms)
        latching = self.conditions[name].latches
        self.alarms[name] = apply_change(
            self.alarms[name], change, now, by, reason=reason, latching=latching, until=until
        )
        self._log.info(CHANGE_WORDS[change], alarm=name, by=by, reason=reason)
        if change is Change.RETURN and self._sensors is not None and self.conditions[name].kind == DRIFTING:
            self._sensors.compare_anew()
        self._publish_changes(before, {}, now)
        return self.alarms[name]

    def save(self, now: float) -> None:
        """Keep what a restart goes on from, and no change has kept: what is left of shelvings, and the sensors."""
        if any(alarm.until is not None for alarm in self.alarms.values()):
            self._save_alarms(now)
        if self._sensors is not None:
            self._historian.save("sensors", now, self._sensors.to_plain())

    def _save_alarms(self, now: float) -> None:
        plain = {name: to_plain(alarm, self.conditions.get(name)) for name, alarm in self.alarms.items()}
        self._historian.save("alarms", now, plain)
