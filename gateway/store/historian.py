"""The embedded historian: SQLite (WAL), written by one thread in batches; the scan never waits for the disk.

Policy of the queue: rows of measurement wait in a queue of at most QUEUE rows, rows of DURABLE tables in one of URGENT;
when one is full (the disk is full or has gone) its oldest rows are dropped and counted. While the disk refuses,
`failure` says why and the thread tries again each second; nothing else stops. A row that cannot be stored costs that
row, a table with a bad page that table: it is counted, and `complaint` says it.

Measurements are committed once a second by a connection that does not wait for the disk (synchronous NORMAL), DURABLE
rows by one that does (FULL), those of AT_ONCE tables at once: a power cut may take the last second of measurements, but
no alarm or audit record that was confirmed. Killing the process loses nothing that was committed.

Between two batches the thread packs what has grown old and deletes what is too old or too much (`retention`).
"""

from __future__ import annotations

import fcntl
import json
import os
import sqlite3
import threading
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from functools import partial
from pathlib import Path
from shutil import disk_usage
from time import monotonic
from typing import TYPE_CHECKING, Any

from drivers.supervision import Supervisor
from drivers.tag import Tag
from gateway.store.columns import PackedError
from gateway.store.files import HistorianError, HistorianFile, UnusableHistorianError, opened
from gateway.store.retention import Packer, deleted_before, gave_back, make_room, pages
from gateway.store.schema import AT_ONCE, DURABLE, INDICES, INSERTS, MEASURED, PACKED, definition
from gateway.store.sqlite_file import concerns_file, is_damage, transaction

if TYPE_CHECKING:
    from structlog.typing import FilteringBoundLogger


QUEUE, URGENT = 200_000, 10_000
BATCH_SECONDS = 1.0
STALL_SECONDS = 10.0
"""How long rows may wait for the disk before that is a complaint."""
LOSS_SECONDS = 60.0
"""How long a lost row stays a complaint; it is counted for ever."""
DISK_MARGIN = 1_000_000
"""Bytes: with less of them left it is the disk that is full, and not the historian that has reached its size."""
ROW_ERRORS = (sqlite3.Error, ArithmeticError, LookupError, TypeError, ValueError)
"""What a row that cannot be stored raises."""

Row = tuple[Any, ...]


class Historian:
    """An open historian: `put` and `flush` may be called from any thread, nothing else needs to be awaited.

    `dropped` counts the rows that the queue had no place for, `refused` those that no table takes; `failure` says why
    nothing can be stored now ("": it can). Without a `file` rows wait in the queue, and `attach` is tried each second.
    """

    def __init__(
        self,
        path: Path,
        file: HistorianFile | None,
        attach: Callable[[], HistorianFile],
        lock: _FileLock,
        *,
        numbers: Mapping[str, int],
        supervisor: Supervisor,
        failure: str = "",
    ) -> None:
        self.path = path
        self.dropped = self.refused = 0
        self.failure = failure
        self.note = file.note if file else ""
        self._attach, self._lock, self._file = attach, lock, file
        self._numbers, self._renumbered = dict(numbers), dict[int, int]()
        self._rows: deque[tuple[str, Row]] = deque()
        self._urgent: deque[tuple[str, Row]] = deque()
        self._wake = threading.Condition()
        self._at_once = self._flush = False
        self._forget: float | None = None
        self._waits_since: float | None = None
        self._loss, self._lost_at = "", 0.0
        self._due = monotonic() + BATCH_SECONDS
        self._stop = threading.Event()
        self._thread = supervisor.thread("historian", self._work, stop=self._stop)

    def put(self, table: str, rows: Iterable[Row]) -> None:
        """Take rows for a table of INSERTS; they are committed within about a second, those of AT_ONCE at once."""
        with self._wake:
            queue = self._urgent if table in DURABLE else self._rows
            queue.extend((table, row) for row in rows)
            self._drop_beyond_the_queues()
            if self._waits_since is None and (self._rows or self._urgent):
                self._waits_since = monotonic()
            # Many writes do not wait for their second either: of a replay as fast as it goes none is to be dropped.
            if self._urgent and (table in AT_ONCE or len(self._urgent) >= URGENT // 10):
                self._at_once = True
                self._wake.notify_all()

    def flush(self, timeout: float = 5.0) -> bool:
        """Wait until everything that was put is committed; False if the disk did not take it in time."""
        with self._wake:
            self._flush = True
            self._wake.notify_all()
            return self._wake.wait_for(lambda: not self._rows and not self._urgent and not self._flush, timeout)

    def forget_before(self, moment: float) -> None:
        """Have measurements older than `moment` deleted with the next batch."""
        with self._wake:
            self._forget = moment

    @property
    def stuck(self) -> str:
        """Why nothing is stored now; "" while it is."""
        since = self._waits_since
        if self.failure or since is None or monotonic() - since <= STALL_SECONDS:
            return self.failure
        return f"{self.path}: nothing has been stored for more than {STALL_SECONDS:g} s; see to the disk"

    @property
    def complaint(self) -> str:
        """Why the records cannot be relied on: `stuck`, a row was lost of late, a file set aside; "" if they can.

        It does not change from one lost row to the next: how many they are is in `dropped` and `refused`.
        """
        lost = self._loss if monotonic() - self._lost_at < LOSS_SECONDS else ""
        return self.stuck or lost or self.note

    def load(self, key: str) -> tuple[float, Any] | None:
        """A saved state: the time it was saved and its content; None if there is none.

        Raises ValueError or HistorianError for one that cannot be read.
        """
        if self._file is None:
            return None
        try:
            with closing(sqlite3.connect(f"{self.path.absolute().as_uri()}?mode=ro", uri=True)) as reader:
                row = reader.execute("SELECT time, content FROM state WHERE key = ?", (key,)).fetchone()
        except sqlite3.Error as error:
            raise HistorianError(f"{self.path}: cannot be read ({error})") from None
        return None if row is None else (float(row[0]), json.loads(row[1]))

    def save(self, key: str, now: float, content: Mapping[str, Any]) -> None:
        """Keep a state, instead of the one kept under this key before."""
        self.put("state", [(key, now, json.dumps(content))])

    def newest(self) -> float | None:
        """The time (s UTC) of the scan that was stored last; None without one."""
        if self._file is None:
            return None
        try:
            row = self._file.normal.execute("SELECT time FROM scans ORDER BY rowid DESC LIMIT 1").fetchone()
        except sqlite3.Error:
            return None
        return float(row[0]) if row else None

    def close(self) -> bool:
        """Commit what waits, stop the thread, free the file; False if rows had to be given up. May be called twice."""
        with self._wake:
            if self._stop.is_set():
                return True
            self._stop.set()
            self._wake.notify_all()
        self._thread.join(timeout=10.0)
        complete = not self._rows and not self._urgent and not self._thread.is_alive()
        if not self._thread.is_alive():
            if self._file is not None:
                self._file.close()
            self._lock.free()
        return complete

    @property
    def _normal(self) -> sqlite3.Connection:
        return self._open_file().normal

    @property
    def _full(self) -> sqlite3.Connection:
        return self._open_file().full

    def _open_file(self) -> HistorianFile:
        if self._file is None:
            raise UnusableHistorianError(f"{self.path}: is not open")
        return self._file

    def _drop_beyond_the_queues(self) -> None:
        for queue, most in ((self._urgent, URGENT), (self._rows, QUEUE)):
            while len(queue) > most:
                table, _ = queue.popleft()
                self.dropped += 1
                self._lost(f"{self.path}: rows of {table} were dropped, as too many wait for the disk")

    def _lost(self, what: str) -> None:
        self._loss, self._lost_at = what, monotonic()

    # ---------------------------------------------------------------- the thread

    def _work(self) -> None:
        packer = None
        while True:
            with self._wake:
                self._wake.wait_for(
                    lambda: self._at_once or self._flush or self._stop.is_set(), max(self._due - monotonic(), 0.0)
                )
                stopping, moment = self._stop.is_set(), self._forget
                everything = stopping or self._flush or monotonic() >= self._due
            if everything:
                self._due = monotonic() + BATCH_SECONDS
            committed = self._attached() and self._round(everything=everything)
            if stopping and (not committed or not (self._rows or self._urgent)):
                return
            if not committed:
                packer = None
                self._stop.wait(BATCH_SECONDS)
                continue
            if not everything:
                continue
            # Only on a disk that takes rows: to pack and to delete is to write as well.
            packer = packer or Packer(self._normal)
            for table in PACKED:
                self._tended(table, partial(packer.step, table))
            self._tended("tiers", packer.tiers)
            if moment is not None:
                for table in (*MEASURED, "writes"):
                    self._tended(table, partial(deleted_before, self._normal, table, moment))
                with self._wake:
                    # Another moment may have been given while the deletion ran; that one is still to be done.
                    self._forget = None if self._forget == moment else self._forget
                self._tended("", partial(gave_back, self._normal))

    def _attached(self) -> bool:
        """Whether there is a file to write to: the one that is open, or, where it has gone, another one."""
        if self._file is not None and not self._file.moved():
            return True
        before, self._file = self._file, None
        if before is not None:
            before.close()
        try:
            self._file = self._attach()
        except HistorianError as error:
            self.failure = str(error)
            return False
        # The numbers that were given out stay; a file that has others gets its own.
        own = self._file.numbers
        self._renumbered = {given: own[name] for name, given in self._numbers.items() if own.get(name, given) != given}
        self.failure = ""
        gone = f"{self.path}: was taken away while it was written; a new one was begun" if before else ""
        self.note = self._file.note or gone or self.note
        return True

    def _round(self, *, everything: bool) -> bool:
        """Commit what waits now, of the measurements only if `everything`; False if the disk refused some of it."""
        self._at_once = False
        whole = self._commit(self._full, self._urgent)
        if everything and self._file is not None:  # it was given up if the first of the two found it damaged
            whole = self._commit(self._normal, self._rows) and whole
        with self._wake:
            if whole:
                self.failure = ""
                self._flush = self._flush and not everything
                self._waits_since = monotonic() if self._rows or self._urgent else None
            self._wake.notify_all()
        return whole

    def _commit(self, connection: sqlite3.Connection, queue: deque[tuple[str, Row]]) -> bool:
        """Commit a queue; what is not committed goes back to its front."""
        with self._wake:
            batch = list(queue)
            queue.clear()
        stored = not batch
        try:
            if batch:
                self._store(connection, batch)
                stored = True
        except sqlite3.Error as error:
            self.failure = f"{self.path}: cannot be written ({error}); make room or mend the disk"
            if is_damage(error) and self._file is not None:
                # Nothing of it can be written any more: it is opened again, which sets it aside.
                self._file.close()
                self._file = None
        finally:
            with self._wake:
                queue.extendleft(reversed(() if stored else batch))
                self._drop_beyond_the_queues()
        return stored

    def _store(self, connection: sqlite3.Connection, batch: list[tuple[str, Row]]) -> None:
        """One transaction with all rows but those that no table takes. Raises sqlite3.Error when the file refuses."""
        by_table: dict[str, list[Row]] = {}
        for table, row in batch:
            if table == "samples" and self._renumbered:
                row = (self._renumbered.get(row[0], row[0]), *row[1:])
            by_table.setdefault(table, []).append(row)
        # Each turn but the last makes room, or begins a table anew: there are no more of these than tables.
        for turn in range(len(INSERTS) + 1):
            refused: list[tuple[str, Exception]] = []
            table = ""
            try:
                with transaction(connection):
                    for table, rows in by_table.items():
                        refused += _inserted(connection, table, rows)
            except sqlite3.Error as error:
                code = getattr(error, "sqlite_errorcode", 0) & 0xFF
                # Full is the file, which may hold so much, or the disk: what others have filled is no reason to delete.
                # A fiftieth of the file, so that it is not done anew with every batch; more for one that takes more.
                total, free = pages(self._normal)
                if (
                    code == sqlite3.SQLITE_FULL
                    and disk_usage(self.path.parent).free > DISK_MARGIN
                    and make_room(self._normal, free + (max(128, total // 50) << turn))
                ):
                    continue
                # A bad page or a missing table, told by the one table that was written to.
                if code not in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_ERROR) or not table:
                    raise
                self._begin_anew(table, str(error))
                continue
            self.refused += len(refused)
            for table, reason in refused[-1:]:
                self._lost(f"{self.path}: a row of {table} cannot be stored ({reason}) and was left out")
            return
        raise sqlite3.OperationalError("there is no end to what is wrong with it")

    def _begin_anew(self, table: str, reason: str) -> None:
        """Give a damaged table another name and begin it anew: one bad page costs one table.

        At the next start what can be read of it is recovered with the whole file. Raises sqlite3.Error.
        """
        connection = self._normal
        with transaction(connection):
            known = {str(row[0]) for row in connection.execute("SELECT name FROM sqlite_master")}
            number = 1 + sum(name.startswith(f"{table}_damaged_") for name in known)
            if table in known:
                connection.execute(f"ALTER TABLE {table} RENAME TO {table}_damaged_{number}")
            connection.execute(definition(table))
            for index in INDICES if table == "chunks" else ():
                connection.execute(index.replace(" ON ", f"_{number} ON "))
        self.note = (
            f"{self.path}: table {table} is damaged ({reason}) and was begun anew; a restart recovers what is left"
        )

    def _tended(self, table: str, step: Callable[[], bool]) -> None:
        """Let `step` work until it has nothing more to do; alarms that come meanwhile are stored between its turns."""
        try:
            while not self._stop.is_set() and step():
                if self._at_once:
                    self._round(everything=False)
        except (sqlite3.Error, PackedError) as error:
            if isinstance(error, PackedError) or not concerns_file(error) or is_damage(error):
                self.note = f"{self.path}: {table or 'the file'} is damaged ({error}); a restart recovers what is left"
                return
            self.failure = f"{self.path}: old rows cannot be put away ({error}); make room or mend the disk"


def _inserted(connection: sqlite3.Connection, table: str, rows: list[Row]) -> list[tuple[str, Exception]]:
    """Insert the rows; gives those that no table takes, with the reason. Raises sqlite3.Error when the file refuses."""
    connection.execute("SAVEPOINT rows")
    try:
        connection.executemany(INSERTS[table], rows)
    except ROW_ERRORS as error:
        if _beyond_the_row(error):
            raise
        connection.execute("ROLLBACK TO rows")
    else:
        connection.execute("RELEASE rows")
        return []
    # One of them cannot be stored, and nothing says which: each is tried by itself.
    refused: list[tuple[str, Exception]] = []
    for row in rows:
        try:
            connection.execute(INSERTS[table], row)
        except ROW_ERRORS as error:
            if _beyond_the_row(error):
                raise
            refused.append((table, error))
    connection.execute("RELEASE rows")
    return refused


def _beyond_the_row(error: Exception) -> bool:
    """Whether the table or the file is at fault, and not the row that was tried."""
    return concerns_file(error) or (
        isinstance(error, sqlite3.Error)
        and getattr(error, "sqlite_errorcode", 0) & 0xFF in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_ERROR)
    )


def open_historian(
    path: Path,
    tags: Iterable[Tag],
    *,
    max_mb: float = 4096.0,
    mend: bool = False,
    supervisor: Supervisor | None = None,
) -> tuple[Historian, dict[str, int]]:
    """Open or make the historian at `path` for one gateway; also gives the number of each tag in its `samples`.

    With `mend`, which the gateway asks for, nothing that has befallen the file or its folder keeps it from running: a
    damaged file is set aside and a new one begun, and where nothing can be written the rows wait (`complaint`).

    Raises HistorianError, in one sentence: another gateway holds it, it is a database of something else or of a newer
    layout; without `mend` also where it is damaged or cannot be written.
    """
    tags, locked = tuple(tags), _FileLock(path)
    supervisor = supervisor or Supervisor()

    def attach() -> HistorianFile:
        locked.take()
        return opened(path, tags, max_mb=max_mb, mend=mend)

    file, failure = None, ""
    try:
        file = attach()
    except UnusableHistorianError as error:
        if not mend:
            locked.free()
            raise
        failure = str(error)
    except HistorianError:
        locked.free()
        raise
    # Until there is a file the tags have numbers that no file gives.
    numbers = dict(file.numbers) if file else {tag.name: -1 - place for place, tag in enumerate(tags)}
    return Historian(path, file, attach, locked, numbers=numbers, supervisor=supervisor, failure=failure), numbers


class _FileLock:
    """The lock of one gateway on a historian: on a file of its own, since SQLite locks the database itself.

    The system frees it when the process ends, however it ends, which a file that merely exists would not.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._place = path, path.with_name(path.name + ".lock")
        self._descriptor: int | None = None

    def take(self) -> None:
        """Take it, or have it already. Raises HistorianError where another process has it, or none can be made."""
        if self._descriptor is not None:
            return
        try:
            self._place.parent.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(self._place, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o644)
        except OSError as error:
            raise UnusableHistorianError(
                f"{self._path}: cannot be made ({error.strerror}); give a path that this user may write"
            ) from None
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(descriptor)
            raise HistorianError(
                f"{self._place}: another gateway is running on this historian; stop it, or give this one a historian "
                "of its own"
            ) from None
        self._descriptor = descriptor

    def free(self) -> None:
        """Give it back, if it was taken."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None


def saved_state(historian: Historian, key: str, log: FilteringBoundLogger) -> tuple[float, dict[str, Any]] | None:
    """When a state was saved and its content; None where there is none, or, logged, where it cannot be read."""
    try:
        state = historian.load(key)
    except (ValueError, HistorianError) as error:
        log.warning("a saved state cannot be read and is not used", state=key, reason=str(error))
        return None
    return state if state is not None and isinstance(state[1], dict) else None
