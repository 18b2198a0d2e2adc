"""The records as a worker process has them: rows wait here as they would for the disk, and go to the supervisor.

There is one writer of each store, in the supervisor process. What the stores' own classes do about rows that wait, are
too many, or are taken back is the same here; only where they would be committed they are sent, and wait for the word
that they are.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from drivers.supervision import Supervisor
from gateway.machine import PlantRecords
from gateway.machine.reading import Clock
from gateway.machine.writing import AuditTrail, HeadWitnessing
from gateway.plant.channel import SupervisorChannel
from gateway.settings import Config
from gateway.store import (
    Audit,
    AuditEntry,
    AuditError,
    AuditRow,
    EndedElsewhere,
    Historian,
    HistorianError,
    ReliedFiles,
)
from sim.strict_json import strict

if TYPE_CHECKING:
    from structlog.typing import FilteringBoundLogger

    from gateway.store import AuditColumns, Batch, LostRows, Row, Source


ROWS_A_LINE = 500
"""So few that the supervisor hears the others between two lines."""


@dataclass
class RecordsHealth:
    """How the supervisor's stores are, as it says with each reply about rows."""

    failure: str = ""
    stuck: str = ""
    note: str = ""
    audit: str = ""
    audit_note: str = ""
    files: tuple[str, str, int] = ("", "", 0)
    log: str = ""
    without: Mapping[str, str] = field(default_factory=dict)
    northbound: str = ""
    undelivered: str = ""
    lost: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


class SentHistorian(Historian):
    """A historian whose rows are committed by the supervisor process; a row counts as given once that has taken it."""

    def __init__(
        self,
        path: Path,
        channel: SupervisorChannel,
        supervisor: Supervisor,
        health: RecordsHealth,
        on_heard: Callable[[], None] = lambda: None,
    ) -> None:
        self._channel, self._health, self._on_heard = channel, health, on_heard
        super().__init__(path, None, _no_file, lambda: None, supervisor=supervisor)

    def flush(self, timeout: float = 5.0) -> bool:
        """Wait until everything that was put is committed; False if the disk did not take it in time."""
        return super().flush(timeout) and bool(self._channel.ask("flush", timeout=timeout)["done"])

    def load(self, source: Source, key: str) -> tuple[float, Any] | None:
        """A saved state of a source (`HistorianView.load`)."""
        reply = self._channel.ask("load", source=source, key=key)
        if reply["error"]:
            raise HistorianError(reply["error"])
        return None if reply["state"] is None else (float(reply["state"][0]), reply["state"][1])

    def newest(self, machine: str) -> float | None:
        """The time (s UTC) of a machine's scan that was stored last (`HistorianView.newest`)."""
        newest = self._channel.ask("newest", machine=machine)["newest"]
        return None if newest is None else float(newest)

    def lost_by(self, machine: str) -> LostRows:
        """What a machine has lost, here and there."""
        own, there = super().lost_by(machine), self._health.lost.get(machine)
        if there is None:
            return own
        newest = own if own.at > there["at"] else replace(own, what=there["what"], at=there["at"])
        return replace(newest, dropped=own.dropped + there["dropped"], refused=own.refused + there["refused"])

    @property
    def stuck(self) -> str:
        """Why nothing is stored now; "" while it is."""
        return self._health.stuck or super().stuck

    @property
    def _usable(self) -> bool:
        return True

    def _attached(self) -> bool:
        self.files.look()
        return True

    def _round(self, *, everything: bool) -> bool:
        whole = super()._round(everything=everything)
        if everything:
            self._heard(self._channel.ask("rows", batch=[]))
        self.failure, self.note = self._health.failure, self._health.note
        return whole

    def _store(self, batch: Batch, durable: bool) -> None:
        by_table: dict[tuple[Source, str], list[Row]] = {}
        for source, waiting in batch.items():
            for table, row in waiting:
                by_table.setdefault((source, table), []).append(row)
        line: list[tuple[Source, str, Sequence[Row]]] = []
        rows = 0
        for (source, table), own in by_table.items():
            for first in range(0, len(own), ROWS_A_LINE):
                line.append((source, table, own[first : first + ROWS_A_LINE]))
                rows += len(line[-1][2])
                if rows >= ROWS_A_LINE:
                    self._give(line)
                    line, rows = [], 0
        if line:
            self._give(line)

    def _give(self, line: Sequence[tuple[Source, str, Sequence[Row]]]) -> None:
        """Have the supervisor take rows; one that is no JSON costs that row, as it would in a table."""
        try:
            self._heard(self._channel.ask("rows", batch=line))
        except (TypeError, ValueError) as error:
            if len(line) == len(line[0][2]) == 1:
                lost = self._lost[line[0][0][0]]
                lost.refused += 1
                lost.note(f"{self.path}: a row of {line[0][1]} cannot be stored ({error}) and was left out")
                return
            for source, table, rows in line:
                for row in rows:
                    self._give([(source, table, [row])])

    def _tend(self, moment: float | None) -> None:
        if moment is not None:
            self._channel.tell("forget", moment=moment)
            self._forgotten(moment)

    def _heard(self, reply: Mapping[str, Any]) -> None:
        for name, value in reply["health"].items():
            setattr(self._health, name, value)
        self._on_heard()


def _no_file() -> NoReturn:
    raise HistorianError("a worker process has no historian's file")


class SentAudit(Audit):
    """An audit log whose rows are committed by the supervisor process: one is stored once that says so."""

    def __init__(
        self,
        path: Path,
        channel: SupervisorChannel,
        supervisor: Supervisor,
        failure: str,
        files: ReliedFiles | None = None,
    ) -> None:
        self._channel = channel
        super().__init__(path, None, supervisor, failure=failure, files=files)

    def _attached(self) -> bool:
        return True

    def _committed(self, claim: Callable[[], Sequence[tuple[AuditEntry, AuditColumns]]]) -> list[AuditRow]:
        if not (entries := [entry for entry, _ in claim()]):
            return []
        plain = [[entry.time, entry.kind, entry.who, entry.reason, strict(entry.detail)] for entry in entries]
        reply = self._channel.ask("audit", entries=plain)
        self.files.hear(*reply["files"])
        if reply["error"]:
            raise sqlite3.OperationalError(reply["error"])
        self.ended_elsewhere = {subject: EndedElsewhere(*ended) for subject, ended in reply["ended"].items()}
        return [AuditRow(number, entry, digest) for entry, (number, digest) in zip(entries, reply["rows"], strict=True)]


class WorkerRecords(PlantRecords):
    """The records of all machines, for those of one worker process."""

    def __init__(
        self,
        configs: Sequence[Config],
        channel: SupervisorChannel,
        *,
        clock: Clock,
        log: FilteringBoundLogger,
        supervisor: Supervisor,
    ) -> None:
        self._channel, self.health = channel, RecordsHealth()
        self.trail = None  # before the historian's thread hears anything
        historian = SentHistorian(configs[0].historian.path, channel, supervisor, self.health, self._on_heard)
        super().__init__(
            configs,
            clock=clock,
            log=log,
            supervisor=supervisor,
            log_failure=lambda: self.health.log,
            historian=historian,
        )
        self.unreached = lambda: self.health.northbound
        self.undelivered = lambda: self.health.undelivered

    def _on_heard(self) -> None:
        """What keeps the supervisor's audit log from being written is what keeps this one, and ends with it."""
        self.without = self.health.without
        self.files.hear(*self.health.files)
        if self.trail is not None:
            self.trail.audit.failure, self.trail.audit.note = self.health.audit, self.health.audit_note

    def open_trail(self, config: Config) -> AuditTrail:
        """The audit log of all machines, opened with the first one that writes, or might. Raises AuditError."""
        if self.trail is None:
            reply = self._channel.ask("open trail", machine=config.machine)
            if reply["error"]:
                raise AuditError(reply["error"])
            self.files.hear(*reply["files"])
            audit = SentAudit(config.audit, self._channel, self.supervisor, reply["failure"], self.files)
            witnessing = HeadWitnessing(config, self.historian.of(config.machine), self._log, self.files)
            self.trail = AuditTrail(audit, witnessing)
        return self.trail

    def close(self) -> bool:
        """Hand over what waits; False if records had to be given up. The last head is the supervisor's to sign."""
        accounted = self.trail is None or self.trail.audit.close()
        complete = self.historian.close()
        self.files.close()
        return complete and accounted
