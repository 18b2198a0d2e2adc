"""The journal of alarms as the historian has it: every change of a state, by whom and why."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf
from operator import itemgetter
from pathlib import Path
from typing import Any

from gateway.settings import alarm_subject
from gateway.store import machines, reading, stored_rows


@dataclass(frozen=True, slots=True, kw_only=True)
class JournalRow:
    """An alarm of a `machine` came into a `state` at a `time` (s UTC); `value` is what its condition looked at then.

    `by` is who did it ("": the plant), `reason` why. `subject` is the machine, or the plant whose alarm that one looks
    after.
    """

    time: float
    machine: str
    alarm: str
    tag: str
    priority: int
    state: str
    value: float | None
    by: str
    reason: str

    @property
    def subject(self) -> str:
        """Whose alarm it is: the plant's or the machine's."""
        return alarm_subject(self.alarm, self.tag, self.machine)


StoredRow = tuple[Any, ...]
"""A row as it is stored: COLUMNS."""
COLUMNS = ("time", "condition", "tag", "priority", "state", "value", "acknowledged_by")


def read_journal(
    path: Path,
    *,
    machine: str | None = None,
    start: float = -inf,
    end: float = inf,
    select: Callable[[list[StoredRow]], list[StoredRow]] = list,
) -> list[JournalRow]:
    """The rows with start <= time < end of one machine, or of all, in the order of their times.

    `select` picks those that are wanted of a machine's rows, in this order. Raises HistorianError.
    """
    found: list[JournalRow] = []
    with reading(path) as connection:
        named = [name for name, _ in machines(connection)] if machine is None else [machine]
        for each in named:
            # A file of before there were several machines has one without a name.
            found += _of_machine(
                each,
                select(sorted(stored_rows(connection, "alarms", COLUMNS, start, end, machine=each), key=itemgetter(0))),
                stored_rows(connection, "audit", ("time", "what", "reason"), start, end, machine=each),
            )
    return sorted(found, key=lambda row: row.time)


def _of_machine(
    machine: str, alarms: Sequence[tuple[object, ...]], audit: Sequence[tuple[object, ...]]
) -> list[JournalRow]:
    """The rows of one machine; the reason of a change is that of the audit row of the same moment and alarm."""
    reasons = {(time, str(what).rpartition(": ")[0]): str(reason) for time, what, reason in audit}
    return [
        JournalRow(
            time=float(str(time)),
            machine=machine,
            alarm=str(alarm),
            tag=str(tag),
            priority=int(str(priority)),
            state=str(state),
            value=None if value is None else float(str(value)),
            by=str(by),
            reason=reasons.get((time, f"alarm {alarm}"), ""),
        )
        for time, alarm, tag, priority, state, value, by in alarms
    ]
