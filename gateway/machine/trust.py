"""Whether what the machine relies on beside its device can be relied on: its records, clock, disk, certificates."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from shutil import disk_usage
from time import monotonic
from typing import TYPE_CHECKING

from drivers.supervision import Supervisor
from gateway.clock_sync import clock_error
from gateway.store import HistorianView

if TYPE_CHECKING:
    from structlog.typing import FilteringBoundLogger


RECORDING = ("historian", "audit", "signing")
"""The supervisor's parts without which what happens is not on record."""
LOOK_SECONDS = 30.0
"""Real seconds between two looks at disk and certificates."""
AGREE_SECONDS = 3600.0
"""By how much clocks may differ that agree: retention counts in days."""


class RecordsWatch:
    """Says when the records begin and cease to be a cause for complaint, and since when nothing is stored.

    `failed_parts` are the parts of the gateway that failed of late and do not record ("": none); the supervisor has
    logged them. `recording` is the supervisor of the records, which all machines of a gateway have in common, `machine`
    that of the machine's own parts.
    """

    def __init__(
        self, historian: HistorianView, recording: Supervisor, machine: Supervisor, log: FilteringBoundLogger
    ) -> None:
        self._historian, self._recording, self._machine, self._log = historian, recording, machine, log
        self.complaint = self.failed_parts = ""
        self._stuck_since: float | None = None

    def look(self, now: float, others: str) -> None:
        """Look at the records at `now` (plant s); `others`: what audit log and log complain of."""
        before, historian = self.complaint, self._historian
        # Of the records' parts alone: the supervisor that has them may have those of every machine of the plant.
        recording = "; ".join(self._recording.part_complaints(RECORDING))
        self.complaint = historian.complaint or others or recording
        own = self._machine.complaints
        self.failed_parts = "; ".join(own[part] for part in own if part not in RECORDING)
        if self.complaint != before:
            counts = {"dropped": historian.dropped, "refused": historian.refused}
            if self.complaint:
                self._log.error("the records cannot be relied on", reason=self.complaint, **counts)
            else:
                self._log.info("the records can be relied on again", before=before, **counts)
        if not historian.stuck:
            self._stuck_since = None
        elif self._stuck_since is None:
            self._stuck_since = now

    def stuck_time(self, now: float) -> float:
        """For how long (plant s) nothing has been stored; 0 while it is."""
        return 0.0 if self._stuck_since is None else now - self._stuck_since


@dataclass(frozen=True, slots=True)
class ClockCheck:
    """What the clock is held against: the plant time `started`, the `newest` row that was stored before under a clock
    that was believed (s UTC; None: there is none), and for how long (s) the gateway may have been off."""

    started: float
    newest: float | None
    longest_off: float

    def complaint(self, now: float, *, offset: float, plc: float | None) -> str:
        """Why the clock is not believed at `now`; "" if it is.

        `offset` (s) is by how much the wall clock has moved since the start against the monotonic one, `plc` (s UTC)
        the PLC's own clock, where it has one: that settles how long the gateway was off, and nothing else does.
        """
        if abs(offset) > AGREE_SECONDS:
            return f"the wall clock was set by {offset:.0f} s while the gateway ran"
        if plc is not None:
            return f"it is {now - plc:.0f} s ahead of the PLC's clock" if abs(now - plc) > AGREE_SECONDS else ""
        if self.newest is None:
            return ""
        if now < self.newest - AGREE_SECONDS:
            return f"it is {self.newest - now:.0f} s behind the newest record"
        if self.started - self.newest > self.longest_off:
            days = (self.started - self.newest) / 86_400.0
            return f"at the start it was {days:.1f} days ahead of the newest record (historian.max_off_days)"
        return ""


class Surroundings:
    """The room that is left beside the `records`, the days until one of the certificates in `folders` runs out, and how
    far the clock may be from UTC (`clock_error`, s; infinite where no time server steers it).

    `free_mb`, `days` and `clock_error` are None while they are not known. Looking takes a thread: a disk may be a share
    that hangs.
    """

    def __init__(self, records: Path, folders: Sequence[Path], supervisor: Supervisor) -> None:
        self._records, self._folders, self._supervisor = records, tuple(folders), supervisor
        self.free_mb: float | None = None
        self.days: float | None = None
        self.clock_error: float | None = None
        self._due = 0.0
        self._looking: asyncio.Task[None] | None = None

    def look(self, now: float) -> None:
        """Look again if it is time; `now` is s UTC, by which certificates run out."""
        if monotonic() < self._due or (self._looking is not None and not self._looking.done()):
            return
        self._due = monotonic() + LOOK_SECONDS
        self._looking = self._supervisor.job("surroundings", lambda: self._look(now))
        self._looking.add_done_callback(lambda task: task.cancelled() or task.exception())

    def _look(self, now: float) -> None:
        # A folder that cannot be looked at says nothing; that nothing can be stored there is another alarm.
        try:
            self.free_mb = disk_usage(self._records.parent).free / 1e6
        except OSError:
            self.free_mb = None
        self.clock_error = clock_error()
        if self._folders:
            # Here: a gateway without certificates loads nothing that reads them.
            from gateway.network import remaining_days

            self.days = min((left for folder in self._folders for left in remaining_days(folder, now)), default=None)

    async def close(self) -> None:
        """Wait for a look that goes on."""
        if self._looking is not None:
            await asyncio.wait((self._looking,))
