"""What persons do with alarms: signed with a name and a reason, checked against the table, and on record."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from gateway.machine.alarms import BY_PERSONS, Alarm, AlarmBoard, AlarmError, Change
from gateway.machine.plant_records import PlantRecords
from gateway.machine.reading import Clock
from gateway.settings import Config
from gateway.store import NO_PROCESS, Audit, AuditEntry, AuditError, HistorianView

if TYPE_CHECKING:
    from structlog.typing import FilteringBoundLogger

HIDES = frozenset({Change.SHELVE, Change.REMOVE})
"""What takes an alarm out of sight: it is on record before it is done."""


class AlarmDesk:
    """The alarms of one machine as persons and programs for them may change them; for the running loop."""

    def __init__(
        self,
        config: Config,
        board: AlarmBoard,
        records: PlantRecords,
        *,
        clock: Clock,
        historian: HistorianView,
        log: FilteringBoundLogger,
    ) -> None:
        self._config, self._board, self._records = config, board, records
        self._clock, self._historian, self._log = clock, historian, log

    async def change(
        self,
        change: Change,
        names: Sequence[str] = (),
        *,
        by: str,
        reason: str,
        minutes: float | None = None,
        process: Mapping[str, int] = NO_PROCESS,
    ) -> dict[str, Alarm]:
        """Make a change of BY_PERSONS to the named alarms: all of them or, where one cannot be changed, none.

        Without names every alarm that waits for an acknowledgement is acknowledged. A shelving lasts `minutes` (of the
        plant). What hides an alarm is in the audit log before it is done; an acknowledgement waits for no disk. Gives
        the alarms as they are by then. Raises AlarmError, in one sentence.
        """
        for what, text in (("a name", by), ("a reason", reason)):
            if change is Change.ACKNOWLEDGE and not reason and text is reason:
                continue  # that somebody knows says enough
            if not text.strip() or not text.isprintable() or len(text) > 200:
                raise AlarmError(f"what is done with alarms is signed: give {what}, one line of 1 to 200 characters")
        longest = self._config.alarms.longest_shelving
        if change is Change.SHELVE and (minutes is None or not 0 < minutes <= longest):
            raise AlarmError(f"a shelving ends: give minutes, more than 0 and at most {longest:g}")
        if not names and change is not Change.ACKNOWLEDGE:
            raise AlarmError(f"which alarm? Name one of {', '.join(self._board.alarms)}")
        names = tuple(dict.fromkeys(names)) or self._board.waiting()
        for name in names:
            self._board.check(name, change)
        now = self._clock.now()
        until = now + minutes * 60.0 if change is Change.SHELVE and minutes is not None else None
        audit = await self._audit(change)
        for name in names:
            detail = {"alarm": name, "machine": self._config.machine, "until": until, **process}
            entry = AuditEntry(now, f"alarm {BY_PERSONS[change]}", by, reason, detail).with_subject(
                self._config.subject
            )
            if audit is not None and change not in HIDES:
                audit.put(entry)
            elif audit is not None and (audit.failure or await audit.stored(entry) is None):
                raise AlarmError(f"{name!r} is as it was, since the audit log does not take it: {audit.complaint}")
            moment = self._clock.now()
            self._board.change(name, change, moment, by=by, reason=reason, until=until)
            # At the very moment of the alarm's own row: so the journal finds the reason.
            self._historian.put("audit", [(moment, f"alarm {name}: {BY_PERSONS[change]}", by, reason)])
        return {name: self._board.alarms[name] for name in names}

    async def _audit(self, change: Change) -> Audit | None:
        """The audit log, opened with the first change; None, logged, where it cannot be and that is no obstacle."""
        try:
            # In a thread: to open it makes files and a key where there are none.
            trail = await asyncio.to_thread(self._records.open_trail, self._config)
        except (AuditError, ValueError) as error:
            if change in HIDES:
                raise AlarmError(f"nothing was done, since it would not be in the audit log: {error}") from None
            self._log.error("what was done with an alarm is not in the audit log", reason=str(error))
            return None
        return trail.audit
