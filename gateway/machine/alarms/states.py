"""Alarms by ISA-18.2: pure conditions with delays and deadband over one table of transitions.

The threshold on the measured temperature needs no model and no forecast; the others repeat what the model finds. A
condition whose input is not known neither raises nor clears anything: that the inputs are bad is an alarm of its own.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from typing import Any


class AlarmState(StrEnum):
    """Alarm states (ANSI/ISA-18.2-2016, 5.3)."""

    NORMAL = "normal"
    UNACKNOWLEDGED = "unacknowledged"
    ACKNOWLEDGED = "acknowledged"
    RETURNED = "returned unacknowledged"


class Change(StrEnum):
    """What moves an alarm from state to state."""

    RAISE = "raise"
    CLEAR = "clear"
    ACKNOWLEDGE = "acknowledge"


TRANSITIONS: dict[tuple[AlarmState, Change], AlarmState] = {
    (AlarmState.NORMAL, Change.RAISE): AlarmState.UNACKNOWLEDGED,
    (AlarmState.UNACKNOWLEDGED, Change.ACKNOWLEDGE): AlarmState.ACKNOWLEDGED,
    (AlarmState.UNACKNOWLEDGED, Change.CLEAR): AlarmState.RETURNED,
    (AlarmState.ACKNOWLEDGED, Change.CLEAR): AlarmState.NORMAL,
    (AlarmState.RETURNED, Change.RAISE): AlarmState.UNACKNOWLEDGED,
    (AlarmState.RETURNED, Change.ACKNOWLEDGE): AlarmState.NORMAL,
}
"""Every move there is; a change that is not here for a state leaves it as it is."""

ACTIVE = frozenset({AlarmState.UNACKNOWLEDGED, AlarmState.ACKNOWLEDGED})
"""The states in which the condition stands; its bit in the block is set."""


@dataclass(frozen=True, slots=True)
class AlarmCondition:
    """What an alarm watches: a number of `tag` that must not exceed `limit`.

    It stands above `limit` and is over below `limit` - `deadband`; in between nothing changes. `on_delay` and
    `off_delay` (s) are how long it must stand or be over before the alarm follows. `bit` is its place in the block's
    alarm word and in the PLC's acknowledge bits, `priority` 1 is the most urgent. Of a machine with several blocks it
    is in that of one `temperature` only; "": in all.
    """

    name: str
    tag: str
    bit: int
    limit: float
    deadband: float = 0.0
    on_delay: float = 0.0
    off_delay: float = 0.0
    priority: int = 2
    response: str = ""
    temperature: str = ""


@dataclass(frozen=True, slots=True)
class Alarm:
    """The state of one condition `since` a time (s UTC); `pending` is when a change that waits for its delay began."""

    condition: str
    tag: str
    priority: int
    state: AlarmState = AlarmState.NORMAL
    since: float = 0.0
    acknowledged_by: str = ""
    pending: float | None = None

    @property
    def active(self) -> bool:
        """True while the condition stands."""
        return self.state in ACTIVE


def new_alarm(condition: AlarmCondition, now: float) -> Alarm:
    """The alarm of a condition of which nothing is known yet: normal."""
    return Alarm(condition.name, condition.tag, condition.priority, since=now)


def moved(alarm: Alarm, change: Change, now: float, by: str = "") -> Alarm:
    """The alarm after a change, by the table; unchanged where the table has no such move."""
    state = TRANSITIONS.get((alarm.state, change))
    if state is None:
        return replace(alarm, pending=None)
    acknowledged_by = by if change is Change.ACKNOWLEDGE else "" if change is Change.RAISE else alarm.acknowledged_by
    return replace(alarm, state=state, since=now, acknowledged_by=acknowledged_by, pending=None)


def step(condition: AlarmCondition, alarm: Alarm, value: float | None, now: float) -> Alarm:
    """The alarm after reading `value` at `now`; None: not known, so nothing begins, nothing ends, no delay runs."""
    wanted: Change | None = None
    if value is not None and not alarm.active and value > condition.limit:
        wanted = Change.RAISE
    elif value is not None and alarm.active and value <= condition.limit - condition.deadband:
        wanted = Change.CLEAR
    # Within the deadband nothing is wanted, and a delay that ran begins anew: it asks for an unbroken time.
    if wanted is None:
        return replace(alarm, pending=None) if alarm.pending is not None else alarm
    begun = now if alarm.pending is None else alarm.pending
    delay = condition.on_delay if wanted is Change.RAISE else condition.off_delay
    return moved(alarm, wanted, now) if now - begun >= delay else replace(alarm, pending=begun)


def acknowledge(
    conditions: Mapping[str, AlarmCondition],
    alarms: Mapping[str, Alarm],
    *,
    before: int | None,
    bits: int,
    now: float,
    by: str,
) -> dict[str, Alarm]:
    """The alarms after acknowledge bits went from `before` to `bits`: a rising edge acknowledges, a level does not.

    None for `before`: the bits were not known, so no edge can be told.
    """
    edges = 0 if before is None else bits & ~before
    return {
        name: moved(alarm, Change.ACKNOWLEDGE, now, by) if edges >> conditions[name].bit & 1 else alarm
        for name, alarm in alarms.items()
    }


def word(conditions: Mapping[str, AlarmCondition], alarms: Mapping[str, Alarm], temperature: str = "") -> int:
    """The alarm word of the block of a `temperature`: the bits of the alarms that are active and belong to it."""
    active = (conditions[name] for name, alarm in alarms.items() if alarm.active)
    return sum({1 << condition.bit for condition in active if condition.temperature in ("", temperature)})


def to_plain(alarm: Alarm) -> dict[str, Any]:
    """The alarm as JSON can carry it."""
    return asdict(alarm)


def from_plain(condition: AlarmCondition, saved: Mapping[str, Any]) -> Alarm:
    """A saved alarm of this condition. Raises ValueError or TypeError for what `to_plain` did not write."""
    alarm = Alarm(**{**saved, "state": AlarmState(saved["state"])})
    return replace(alarm, tag=condition.tag, priority=condition.priority, pending=None)
