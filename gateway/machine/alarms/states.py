"""Alarms by ISA-18.2 (IEC 62682): one table of transitions, and the pure step by which a condition moves along it.

Engine, words, commands and the diagram in `docs/alarms.md` are made of the tables here. The threshold on the measured
temperature needs no model and no forecast; the others repeat what the model finds. A condition whose input is not
known neither raises nor clears anything: that the inputs are bad is an alarm of its own.
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
    LATCHED_UNACKNOWLEDGED = "latched unacknowledged"
    LATCHED_ACKNOWLEDGED = "latched acknowledged"
    SHELVED = "shelved"
    SUPPRESSED = "suppressed by design"
    OUT_OF_SERVICE = "out of service"


class Change(StrEnum):
    """What moves an alarm from state to state."""

    RAISE = "raise"
    CLEAR = "clear"
    ACKNOWLEDGE = "acknowledge"
    RESET = "reset"
    SHELVE = "shelve"
    UNSHELVE = "unshelve"
    SUPPRESS = "suppress"
    UNSUPPRESS = "unsuppress"
    REMOVE = "remove from service"
    RETURN = "return to service"


LETTERS: Mapping[AlarmState, str] = dict(zip(AlarmState, "ABCDEFGHI", strict=True))
"""The standard's letter of each state."""

MEANINGS: Mapping[AlarmState, str] = {
    AlarmState.NORMAL: "the condition does not stand, and nothing is to be done",
    AlarmState.UNACKNOWLEDGED: "the condition stands and nobody has said that they know",
    AlarmState.ACKNOWLEDGED: "the condition stands and somebody knows",
    AlarmState.RETURNED: "the condition is over and nobody has said that they knew of it",
    AlarmState.LATCHED_UNACKNOWLEDGED: "the condition is over and nobody knew; it stays until it is reset",
    AlarmState.LATCHED_ACKNOWLEDGED: "the condition is over and somebody knows; it stays until it is reset",
    AlarmState.SHELVED: "put aside by a person, until a stated time",
    AlarmState.SUPPRESSED: "held back while the plant is in a state in which it means nothing",
    AlarmState.OUT_OF_SERVICE: "taken out by a person for work on it, until it is returned",
}
"""What each state says to an operator."""

BY_PERSONS = {
    Change.ACKNOWLEDGE: "acknowledged",
    Change.RESET: "reset",
    Change.SHELVE: "shelved",
    Change.UNSHELVE: "unshelved",
    Change.REMOVE: "removed from service",
    Change.RETURN: "returned to service",
}
"""The changes that persons make, and the word for it when it is done."""

CHANGE_WORDS: Mapping[Change, str] = {
    Change.RAISE: "the condition stands, for its on-delay",
    Change.CLEAR: "the condition is over by its deadband, for its off-delay",
    Change.ACKNOWLEDGE: "a person or the PLC says that they know",
    Change.RESET: "a person lets go of what is latched",
    Change.SHELVE: "a person puts it aside for some minutes",
    Change.UNSHELVE: "a person takes it back, or the time is over",
    Change.SUPPRESS: "the tag that makes it meaningless says so",
    Change.UNSUPPRESS: "that tag does not say so any more, or is not known",
    Change.REMOVE: "a person takes it out for work on it",
    Change.RETURN: "a person returns it",
}
"""What each change is."""

ACTIVE = frozenset(
    {
        AlarmState.UNACKNOWLEDGED,
        AlarmState.ACKNOWLEDGED,
        AlarmState.LATCHED_UNACKNOWLEDGED,
        AlarmState.LATCHED_ACKNOWLEDGED,
    }
)
"""The states in which the alarm is shown as standing; its bit in the block is set."""
UNSEEN = frozenset({AlarmState.UNACKNOWLEDGED, AlarmState.RETURNED, AlarmState.LATCHED_UNACKNOWLEDGED})
"""The states that wait for an acknowledgement."""
HIDDEN: Mapping[AlarmState, tuple[Change, Change]] = {
    AlarmState.SHELVED: (Change.SHELVE, Change.UNSHELVE),
    AlarmState.SUPPRESSED: (Change.SUPPRESS, Change.UNSUPPRESS),
    AlarmState.OUT_OF_SERVICE: (Change.REMOVE, Change.RETURN),
}
"""The states in which an alarm is not shown, each with what leads into it and out of it."""
SHOWN = tuple(state for state in AlarmState if state not in HIDDEN)


@dataclass(frozen=True, slots=True, kw_only=True)
class Transition:
    """A row of the table. What is None does not matter; else the row is one of an alarm that latches (or does not),
    whose condition stands (or is over), or that had come to rest as `kept` when it was hidden."""

    source: AlarmState
    change: Change
    target: AlarmState
    latching: bool | None = None
    standing: bool | None = None
    kept: AlarmState | None = None


def _row(source: AlarmState, change: Change, target: AlarmState, **only: Any) -> Transition:
    return Transition(source=source, change=change, target=target, **only)


_S = AlarmState
TRANSITIONS: tuple[Transition, ...] = (
    _row(_S.NORMAL, Change.RAISE, _S.UNACKNOWLEDGED),
    _row(_S.UNACKNOWLEDGED, Change.ACKNOWLEDGE, _S.ACKNOWLEDGED),
    _row(_S.UNACKNOWLEDGED, Change.CLEAR, _S.RETURNED, latching=False),
    _row(_S.UNACKNOWLEDGED, Change.CLEAR, _S.LATCHED_UNACKNOWLEDGED, latching=True),
    _row(_S.ACKNOWLEDGED, Change.CLEAR, _S.NORMAL, latching=False),
    _row(_S.ACKNOWLEDGED, Change.CLEAR, _S.LATCHED_ACKNOWLEDGED, latching=True),
    _row(_S.RETURNED, Change.RAISE, _S.UNACKNOWLEDGED),
    _row(_S.RETURNED, Change.ACKNOWLEDGE, _S.NORMAL),
    _row(_S.LATCHED_UNACKNOWLEDGED, Change.RAISE, _S.UNACKNOWLEDGED),
    _row(_S.LATCHED_UNACKNOWLEDGED, Change.ACKNOWLEDGE, _S.LATCHED_ACKNOWLEDGED),
    _row(_S.LATCHED_ACKNOWLEDGED, Change.RAISE, _S.UNACKNOWLEDGED),
    _row(_S.LATCHED_ACKNOWLEDGED, Change.RESET, _S.NORMAL),
    # The states in which an alarm is hidden may be entered from any other. What stands when it comes out is announced
    # anew; what is over goes on as it would have come to rest: nothing that nobody has seen is lost by being hidden.
    *(_row(shown, enter, hidden) for hidden, (enter, _) in HIDDEN.items() for shown in SHOWN),
    *(_row(hidden, change, hidden) for hidden in HIDDEN for change in (Change.RAISE, Change.CLEAR)),
    *(_row(hidden, leave, _S.UNACKNOWLEDGED, standing=True) for hidden, (_, leave) in HIDDEN.items()),
    *(
        _row(hidden, leave, kept, standing=False, kept=kept)
        for hidden, (_, leave) in HIDDEN.items()
        for kept in (_S.NORMAL, _S.RETURNED, _S.LATCHED_UNACKNOWLEDGED, _S.LATCHED_ACKNOWLEDGED)
    ),
    # Who works on it takes precedence over who put it aside, and over the plant's state.
    _row(_S.SHELVED, Change.REMOVE, _S.OUT_OF_SERVICE),
    _row(_S.SUPPRESSED, Change.REMOVE, _S.OUT_OF_SERVICE),
)
"""Every move there is; a change that is not here for a state leaves it as it is."""

_BY_CHANGE: Mapping[tuple[AlarmState, Change], tuple[Transition, ...]] = {
    (source, change): tuple(row for row in TRANSITIONS if (row.source, row.change) == (source, change))
    for source in AlarmState
    for change in Change
}


@dataclass(frozen=True, slots=True)
class AlarmCondition:
    """What an alarm watches: a number of `tag` that must not exceed `limit`.

    It stands above `limit` and is over below `limit` - `deadband`; in between nothing changes. `on_delay` and
    `off_delay` (s) are how long it must stand or be over before the alarm follows. `bit` is its place in the block's
    alarm word and in the PLC's acknowledge bits (None: it has none), `priority` 1 is the most urgent. `response` is
    what an operator shall do, `consequence` what comes of not doing it. Of a machine with several blocks it is in that
    of one `temperature` only; "": in all. What `latches` stays until it is reset. While the tag of `suppressed_by` has
    the value beside it the alarm is suppressed by design. `kind` is its row of `gateway.settings.ALARM_KINDS`,
    `own_response` whether the response is another than the row's.
    """

    name: str
    tag: str
    bit: int | None
    limit: float
    deadband: float = 0.0
    on_delay: float = 0.0
    off_delay: float = 0.0
    priority: int = 2
    response: str = ""
    temperature: str = ""
    consequence: str = ""
    latches: bool = False
    suppressed_by: tuple[str, float] | None = None
    kind: str = ""
    own_response: bool = False


@dataclass(frozen=True, slots=True)
class Alarm:
    """The state of one condition `since` a time (s UTC); `pending` is when a change that waits for its delay began.

    `standing` is whether the condition stands, whatever is shown; `raised` when it was last announced (None: never).
    `kept` is what a hidden alarm comes out as once the condition is over, `until` when a shelved one comes out.
    `by` and `reason` are those of the last change that somebody made. `first_up`: it was the first of those that stand.
    """

    condition: str
    tag: str
    priority: int
    state: AlarmState = AlarmState.NORMAL
    since: float = 0.0
    acknowledged_by: str = ""
    pending: float | None = None
    standing: bool = False
    raised: float | None = None
    kept: AlarmState = AlarmState.NORMAL
    until: float | None = None
    by: str = ""
    reason: str = ""
    first_up: bool = False

    @property
    def active(self) -> bool:
        """True while the alarm is shown as standing."""
        return self.state in ACTIVE


def new_alarm(condition: AlarmCondition, now: float) -> Alarm:
    """The alarm of a condition of which nothing is known yet: normal."""
    return Alarm(condition.name, condition.tag, condition.priority, since=now)


def transition(alarm: Alarm, change: Change, *, latching: bool = False) -> Transition | None:
    """The row of the table by which the alarm would move; None: it would not."""
    own = {"latching": latching, "standing": alarm.standing, "kept": alarm.kept}
    for row in _BY_CHANGE[alarm.state, change]:
        if all(getattr(row, name) in (None, value) for name, value in own.items()):
            return row
    return None


def possible(alarm: Alarm, *, latching: bool = False) -> tuple[Change, ...]:
    """The changes that the table has for the alarm as it is."""
    return tuple(change for change in Change if transition(alarm, change, latching=latching))


def apply_change(
    alarm: Alarm,
    change: Change,
    now: float,
    by: str = "",
    *,
    reason: str = "",
    latching: bool = False,
    until: float | None = None,
) -> Alarm:
    """The alarm after a change, by the table; unchanged where the table has no such move.

    `by` and `reason` are the person's, `until` the end of a shelving (s UTC), which it must have.
    """
    row = transition(alarm, change, latching=latching)
    if row is None:
        return alarm
    if row.target is AlarmState.SHELVED and row.source is not AlarmState.SHELVED and until is None:
        raise ValueError("a shelving needs an end")
    raising = change is Change.RAISE
    after = replace(
        alarm,
        # A delay that runs is the condition's: what a person does neither shortens nor lengthens it.
        pending=None if change in (Change.RAISE, Change.CLEAR) else alarm.pending,
        standing=raising or (alarm.standing and change is not Change.CLEAR),
        raised=now if row.target is AlarmState.UNACKNOWLEDGED else alarm.raised,
        first_up=alarm.first_up and not (raising and alarm.state is AlarmState.NORMAL),
    )
    if row.target in HIDDEN and row.source is row.target:
        # A latching alarm that came meanwhile is not forgotten when it is over before it comes out.
        kept = AlarmState.LATCHED_UNACKNOWLEDGED if raising and latching else alarm.kept
        return replace(after, kept=kept)
    if row.target in HIDDEN:
        rest = transition(alarm, Change.CLEAR, latching=latching)
        kept = alarm.kept if row.source in HIDDEN else alarm.state if rest is None else rest.target
        return replace(after, state=row.target, since=now, kept=kept, until=until, by=by, reason=reason)
    acknowledged_by = alarm.acknowledged_by
    if change is Change.ACKNOWLEDGE or row.target is AlarmState.UNACKNOWLEDGED:
        acknowledged_by = by if change is Change.ACKNOWLEDGE else ""
    return replace(
        after,
        state=row.target,
        since=now,
        acknowledged_by=acknowledged_by,
        kept=AlarmState.NORMAL,
        until=None,
        by=by,
        reason=reason,
    )


def step(condition: AlarmCondition, alarm: Alarm, value: float | None, now: float) -> Alarm:
    """The alarm after reading `value` at `now`; None: not known, so nothing begins, nothing ends, no delay runs."""
    wanted: Change | None = None
    if value is not None and not alarm.standing and value > condition.limit:
        wanted = Change.RAISE
    elif value is not None and alarm.standing and value <= condition.limit - condition.deadband:
        wanted = Change.CLEAR
    # Within the deadband nothing is wanted, and a delay that ran begins anew: it asks for an unbroken time.
    if wanted is None:
        return replace(alarm, pending=None) if alarm.pending is not None else alarm
    begun = now if alarm.pending is None else alarm.pending
    delay = condition.on_delay if wanted is Change.RAISE else condition.off_delay
    if now - begun < delay:
        return alarm if alarm.pending is not None else replace(alarm, pending=begun)
    return apply_change(alarm, wanted, now, latching=condition.latches)


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
        name: apply_change(alarm, Change.ACKNOWLEDGE, now, by)
        if (bit := conditions[name].bit) is not None and edges >> bit & 1
        else alarm
        for name, alarm in alarms.items()
    }


def word(conditions: Mapping[str, AlarmCondition], alarms: Mapping[str, Alarm], temperature: str = "") -> int:
    """The alarm word of the block of a `temperature`: the bits of the alarms that are active and belong to it."""
    active = (conditions[name] for name, alarm in alarms.items() if alarm.state in ACTIVE)
    return sum(
        {1 << condition.bit for condition in active if condition.bit is not None
         and condition.temperature in ("", temperature)}
    )  # fmt: skip


def to_plain(alarm: Alarm, condition: AlarmCondition | None = None) -> dict[str, Any]:
    """The alarm as JSON can carry it, with the `limit` that it is held against."""
    return asdict(alarm) | ({} if condition is None else {"limit": condition.limit})


def from_plain(condition: AlarmCondition, saved: Mapping[str, Any]) -> Alarm:
    """A saved alarm of this condition. Raises KeyError, ValueError or TypeError for what `to_plain` did not write."""
    state = AlarmState(saved["state"])
    # A release that knew the first four states alone has saved nothing of what stands.
    known = {"standing": state in ACTIVE, **saved, "state": state}
    known.pop("limit", None)
    alarm = replace(Alarm(**known), kept=AlarmState(known.get("kept", AlarmState.NORMAL)))
    if state is AlarmState.SHELVED:
        alarm = replace(alarm, until=float(saved["until"]))
    return replace(alarm, tag=condition.tag, priority=condition.priority, pending=None)
