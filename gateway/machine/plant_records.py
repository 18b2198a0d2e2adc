"""What the machines of a gateway have in common to be on record: the historian, the audit log, and its witnesses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from threading import Lock
from typing import TYPE_CHECKING

from drivers.supervision import Supervisor
from gateway.machine.reading import Clock
from gateway.machine.writing import AuditTrail, open_audit_trail
from gateway.settings import Config
from gateway.store import Historian, open_historian

if TYPE_CHECKING:
    from structlog.typing import FilteringBoundLogger


class PlantRecords:
    """Opened records. `trail` is None while nothing is computed for writing; `log_failure` says why the log's file
    cannot be written ("": it can), `unreached` which of the systems that are told what is on record are out of reach,
    `undelivered` which recipients of messages about alarms, and why; `without` which parts of the whole gateway could
    not be begun, and why, by their names.
    `files` are those on which a promise rests.

    Raises HistorianError.
    """

    def __init__(
        self,
        configs: Sequence[Config],
        *,
        clock: Clock,
        log: FilteringBoundLogger,
        supervisor: Supervisor,
        log_failure: Callable[[], str] = lambda: "",
    ) -> None:
        first = configs[0]
        self.supervisor, self.log_failure = supervisor, log_failure
        self.unreached: Callable[[], str] = lambda: ""
        self.undelivered: Callable[[], str] = lambda: ""
        self.without: Mapping[str, str] = {}
        self.historian: Historian = open_historian(
            first.historian.path,
            max_mb=first.historian.max_mb,
            mend=True,
            patient=True,
            supervisor=supervisor,
            heir=first.machine,
        )
        self.files = self.historian.files
        self.trail: AuditTrail | None = None
        self._clock, self._log = clock, log
        self._opening = Lock()

    def open_trail(self, config: Config) -> AuditTrail:
        """The audit log of all machines, opened with the first one that writes, or of whose alarms a person disposes.

        May be called from any thread. Raises AuditError.
        """
        with self._opening:
            if self.trail is None:
                historian = self.historian.view(config.machine)
                self.trail = open_audit_trail(
                    config, historian=historian, supervisor=self.supervisor, log=self._log, files=self.files
                )
            return self.trail

    def subject_complaint(self, subject: str) -> str:
        """Why the audit log, the files that are relied on or the log's own cannot be; "" if they can."""
        audit = self.trail.audit if self.trail is not None else None
        of_audit = () if audit is None else (audit.subject_complaint(subject), audit.note)
        said = dict.fromkeys(filter(None, (*of_audit, self.files.complaint, self.files.note)))
        return "; ".join(said) or self.log_failure()

    def close(self) -> bool:
        """Store what waits and close all; False if records had to be given up."""
        accounted = self.trail is None or self.trail.close(self._clock.now())
        complete = self.historian.close()
        self.files.close()
        return complete and accounted
