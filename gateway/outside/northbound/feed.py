"""One sink's feed: a thread that follows the historian and hands its rows on, from where the sink has got to.

The historian is the store: a feed keeps no rows but the ones in its hand, and how far it is. What cannot be handed on
waits where it lies, and is handed on in its order when the sink is there again, marked as historical. The bound is the
historian's own (its age and size) and `backlog_hours`: what is older than that is left out and counted in `lost`.

A scan notices nothing of it: the file is read by a connection of its own, and of the interpreter a feed takes half the
time at most.
"""

from __future__ import annotations

import sqlite3
import threading
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from itertools import islice
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

from drivers.supervision import Supervisor
from gateway.outside.northbound.sink import OutgoingRow, RowsRefused, Sink, SinkUnreachable
from gateway.store import (
    FollowedRow,
    HistorianError,
    HistorianView,
    RowPosition,
    RowStream,
    find_position,
    newest_position,
    newest_rows,
    next_rows,
    reading,
    row_streams,
    saved_state,
)

if TYPE_CHECKING:
    from structlog.typing import FilteringBoundLogger

POLL_SECONDS = 1.0
"""How often it is looked for new rows: the historian commits them once a second."""
MAX_PENDING_ROWS = 4_000
"""Rows in hand from which on no more are read."""
ROWS_PER_DELIVERY = 1_000
"""Rows that are handed over at a time."""
FIRST_RETRY, LONGEST_RETRY = 1.0, 30.0
"""Seconds until a sink is tried again: doubled with each failure up to the longest."""
SAVE_SECONDS = 1.0
"""How often it is put on record how far the sink has got."""
CLOSE_SECONDS = 5.0
COMPLAIN_SECONDS = 60.0
"""Rows that wait while none is taken for so long are a cause for complaint, whatever keeps them."""


class SinkFeed:
    """Feeds a `sink` from its making until `stop`.

    `machines` gives the names of those whose rows are handed on, `view` a machine's historian, `now` the plant's time
    (s UTC). `delivered` counts the rows that the sink has, `refused` those that it will not have, `lost` those that
    were too old or gone before they could be handed on.
    """

    def __init__(
        self,
        name: str,
        sink: Sink,
        *,
        path: Path,
        machines: Callable[[], Iterable[str]],
        view: Callable[[str], HistorianView],
        now: Callable[[], float],
        tables: Iterable[str],
        backlog: float,
        supervisor: Supervisor,
        log: FilteringBoundLogger,
    ) -> None:
        self.name = name
        self.delivered = self.refused = self.lost = 0
        self.reason = ""
        self.connected = False
        self._sink, self._path, self._machines, self._view = sink, path, machines, view
        self._now, self._tables, self._backlog = now, frozenset(tables), backlog
        self._log = log.bind(sink=name)
        self._positions: dict[RowStream, RowPosition] = {}
        self._newest: dict[RowStream, int] = {}
        self._old_until: dict[RowStream, int] = {}
        self._restored: dict[str, Mapping[str, Any]] = {}
        self._pending: deque[FollowedRow] = deque()
        self._turn = 0
        self._unsaved: set[str] = set()
        self._saved_at = self._taken_at = monotonic()
        self._told_dropped = 0
        self._stop = threading.Event()
        self._thread = supervisor.thread(f"northbound {name}", self._work, stop=self._stop)

    @property
    def waiting(self) -> int:
        """The rows on record that the sink does not have yet, as far as is known."""
        return sum(
            max(newest - at.key, 0)
            for stream, newest in list(self._newest.items())
            if (at := self._positions.get(stream)) is not None and stream.table != "alarms"
        )

    @property
    def complaint(self) -> str:
        """Why the sink is not told what is on record; "" while it is."""
        if not self.reason and self._pending and monotonic() - self._taken_at >= COMPLAIN_SECONDS:
            return f"nothing was taken for {COMPLAIN_SECONDS:g} s"
        return self.reason

    @property
    def dropped(self) -> int:
        """The messages to this gateway that the sink has left out."""
        return self._sink.dropped

    def stop(self) -> None:
        """Have the session ended; what was not handed on is, after the next start."""
        self._stop.set()

    def join(self) -> None:
        """Wait until it has ended, and its place is on its way to the record."""
        self._thread.join(CLOSE_SECONDS)

    # ---------------------------------------------------------------- the thread

    def _work(self) -> None:
        # After a failure of this thread nothing counts but what is known to be there.
        self._pending.clear()
        pause = FIRST_RETRY
        try:
            while not self._stop.is_set():
                try:
                    self._step()
                    pause = FIRST_RETRY
                except (SinkUnreachable, HistorianError, sqlite3.Error) as error:
                    self._note_failure(str(error))
                    self._end_session()
                    self._save()
                    self._see_backlog()
                    self._stop.wait(pause)
                    pause = min(2.0 * pause, LONGEST_RETRY)
        finally:
            self._end_session()
            self._save()

    def _step(self) -> None:
        """Begin a session if there is none; hand on a piece, or wait for one."""
        if not self.connected:
            self._begin_session()
        if not self._pending:
            self._taken_at = monotonic()
            self._fill()
        if self._pending:
            begun = monotonic()
            self._deliver()
            # Half of the interpreter's time at most, also where a day is to be caught up.
            self._stop.wait(min(monotonic() - begun, 1.0))
        else:
            self._sink.idle(POLL_SECONDS, self._stop)
            self._note_success()
        if self.dropped > 2 * self._told_dropped:
            self._told_dropped = self.dropped
            self._log.warning(
                "messages to this gateway are left out: too many at a time, or not asked for", count=self.dropped
            )
        if self._unsaved and monotonic() - self._saved_at >= SAVE_SECONDS:
            self._save()

    def _see_backlog(self) -> None:
        """See how many rows wait by now, while there is nobody to hand them on to."""
        with suppress(HistorianError, sqlite3.Error), reading(self._path) as connection:
            for stream in self._streams(connection):
                if stream not in self._positions:
                    oldest = self._now() - self._backlog
                    self._positions[stream] = self._first_position(connection, stream, oldest)
                end = newest_position(connection, stream)
                self._newest[stream] = 0 if end is None else end.key

    def _begin_session(self) -> None:
        present: dict[str, list[FollowedRow]] = {name: [] for name in self._machines()}
        until: dict[RowStream, int] = {}
        with reading(self._path) as connection:
            for stream in self._streams(connection):
                rows, until[stream] = newest_rows(connection, stream)
                present[stream.machine] += rows
        self._sink.open(present)
        # What lies before the session's beginning is history to whoever has been told what stands now.
        self._old_until = until
        self.connected = True

    def _end_session(self) -> None:
        self.connected = False
        self._sink.close()

    def _note_success(self) -> None:
        if self.reason:
            self._log.info("a system is told again what is on record")
            self.reason = ""

    def _note_failure(self, reason: str) -> None:
        if reason != self.reason:
            self.reason = reason
            self._log.warning("a system cannot be told what is on record; it is tried again", reason=reason)

    def _streams(self, connection: sqlite3.Connection) -> list[RowStream]:
        return [stream for stream in row_streams(connection, self._machines()) if stream.table in self._tables]

    def _fill(self) -> None:
        """Read what comes next, of each stream in turn."""
        oldest = self._now() - self._backlog
        with reading(self._path) as connection:
            streams = self._streams(connection)
            for _ in range(len(streams)):
                if len(self._pending) >= MAX_PENDING_ROWS:
                    return
                stream = streams[self._turn % len(streams)]
                self._turn += 1
                position = self._positions.get(stream) or self._first_position(connection, stream, oldest)
                found = next_rows(connection, stream, position)
                self._positions[stream] = position if found.rows else found.passed
                self._newest[stream] = found.newest
                self._lose(found.gone, "they were deleted before they could be handed on")
                rows = deque(found.rows)
                too_old = 0
                while rows and rows[0].time < oldest:
                    row = rows.popleft()
                    too_old += 1
                    self._positions[stream] = row.position or self._positions[stream]
                self._lose(too_old, "they are older than backlog_hours")
                if rows and rows[-1].key < found.newest:
                    self._old_until[stream] = max(found.newest, self._old_until.get(stream, 0))
                self._pending += rows

    def _first_position(self, connection: sqlite3.Connection, stream: RowStream, oldest: float) -> RowPosition:
        """Where a former run has got to; a sink that is new begins with what is not too old."""
        if stream.machine not in self._restored:
            saved = saved_state(self._view(stream.machine), self._state, self._log)
            self._restored[stream.machine] = saved[1] if saved is not None else {}
        match self._restored[stream.machine].get(_position_key(stream)):
            case [int(key), int(time) | float(time)]:
                return RowPosition(key, float(time))
        return find_position(connection, stream, oldest)

    def _lose(self, count: int, why: str) -> None:
        if count:
            self.lost += count
            self._log.error("rows are not handed on", rows=count, reason=why)

    def _deliver(self) -> None:
        piece = [
            OutgoingRow(row, row.key <= self._old_until.get(row.stream, 0))
            for row in islice(self._pending, ROWS_PER_DELIVERY)
        ]
        try:
            for count in self._sink.deliver(piece):
                self._confirm_rows(count)
                self.delivered += count
                self._note_success()
                if self._stop.is_set():
                    return
        except RowsRefused as error:
            self.refused += error.count
            self._log.error("rows are refused and left out", rows=error.count, reason=str(error))
            self._confirm_rows(error.count)

    def _confirm_rows(self, count: int) -> None:
        self._taken_at = monotonic()
        for _ in range(count):
            row = self._pending.popleft()
            if row.position is not None:
                self._positions[row.stream] = row.position
                self._unsaved.add(row.stream.machine)

    # ---------------------------------------------------------------- what outlives it

    @property
    def _state(self) -> str:
        return f"northbound {self.name}"

    def _save(self) -> None:
        for machine in self._unsaved:
            own = {
                _position_key(stream): [at.key, at.time]
                for stream, at in self._positions.items()
                if stream.machine == machine
            }
            kept = self._restored.get(machine, {})
            self._view(machine).save(self._state, self._now(), {**kept, **own})
        self._unsaved.clear()
        self._saved_at = monotonic()


def _position_key(stream: RowStream) -> str:
    """By what a stream's position is saved."""
    return f"{stream.table} {stream.temperature}".strip()
