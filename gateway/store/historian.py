"""The embedded historian: SQLite (WAL), written by one thread in batches; the scan never waits for the disk.

Policy of the queue: rows of measurement wait in a queue of at most QUEUE rows, and when it is full (the disk is full or
has gone) new ones are dropped and counted; rows of DURABLE tables are kept apart, and of those the oldest go beyond
URGENT. While the disk refuses, `failure` says why and the thread tries again each second; nothing else stops.

A batch with a DURABLE row is committed by a connection that waits for the disk (synchronous FULL), any other by one
that does not (NORMAL): a power cut may take the last second of measurements, but no alarm, write or audit record that
was confirmed. Killing the process loses nothing that was committed.
"""

import fcntl
import json
import os
import sqlite3
import threading
from collections import deque
from collections.abc import Iterable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

from structlog.typing import FilteringBoundLogger

from drivers.tag import Tag
from gateway.store.schema import ADDED, APPLICATION_ID, DELETES, DURABLE, INSERTS, TABLES, VERSION

QUEUE, URGENT = 200_000, 10_000
BATCH_SECONDS = 1.0
_PAGE = 4096
_CHUNK = 5_000

Row = tuple[Any, ...]


class HistorianError(OSError):
    """The historian's file cannot be used; the message is one sentence that says why and what would be right."""


class Historian:
    """An open historian: `put` and `flush` may be called from any thread, nothing else needs to be awaited."""

    def __init__(self, path: Path, connections: tuple[sqlite3.Connection, sqlite3.Connection], lock: int) -> None:
        self.path = path
        self._normal, self._full = connections
        self._lock = lock
        self._rows: deque[tuple[str, Row]] = deque()
        self._urgent: deque[tuple[str, Row]] = deque(maxlen=URGENT)
        self._wake = threading.Condition()
        self._flush = self._stopping = False
        self._forget: float | None = None
        self.dropped = 0
        self.failure = ""
        self._thread = threading.Thread(target=self._work, name="historian", daemon=True)
        self._thread.start()

    def put(self, table: str, rows: Iterable[Row]) -> None:
        """Take rows for a table of INSERTS; they are committed within about a second, durable ones at once."""
        with self._wake:
            if table in DURABLE:
                for row in rows:
                    self.dropped += len(self._urgent) == URGENT
                    self._urgent.append((table, row))
                self._wake.notify_all()
                return
            for row in rows:
                if len(self._rows) >= QUEUE:
                    self.dropped += 1
                else:
                    self._rows.append((table, row))

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

    def load(self, key: str) -> tuple[float, Any] | None:
        """A saved state: the time it was saved and its content; None if there is none or it cannot be read."""
        with closing(sqlite3.connect(f"{self.path.absolute().as_uri()}?mode=ro", uri=True)) as reader:
            row = reader.execute("SELECT time, content FROM state WHERE key = ?", (key,)).fetchone()
        return None if row is None else (float(row[0]), json.loads(row[1]))

    def save(self, key: str, now: float, content: Mapping[str, Any]) -> None:
        """Keep a state, instead of the one kept under this key before."""
        self.put("state", [(key, now, json.dumps(content))])

    def close(self) -> bool:
        """Commit what waits, stop the thread, free the file; False if rows had to be given up. May be called twice."""
        with self._wake:
            if self._stopping:
                return True
            self._stopping = True
            self._wake.notify_all()
        self._thread.join(timeout=10.0)
        complete = not self._rows and not self._urgent and not self._thread.is_alive()
        if not self._thread.is_alive():
            for connection in (self._normal, self._full):
                connection.close()
            os.close(self._lock)
        return complete

    # ---------------------------------------------------------------- the thread

    def _work(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._urgent or self._flush or self._stopping, BATCH_SECONDS)
                stopping, moment = self._stopping, self._forget
            committed = self._round()
            if stopping and (not committed or not (self._rows or self._urgent)):
                return
            if not committed:
                with self._wake:
                    self._wake.wait_for(lambda: self._stopping, BATCH_SECONDS)
            elif moment is not None:  # only on a disk that takes rows: to delete is to write as well
                self._delete_before(moment)
                with self._wake:
                    # Another moment may have been given while the deletion ran; that one is still to be done.
                    self._forget = None if self._forget == moment else self._forget

    def _round(self) -> bool:
        """Commit what waits now; False if the disk refused, and then everything still waits."""
        with self._wake:
            bulk, durable = len(self._rows), len(self._urgent)
            batch = [*self._rows, *self._urgent]
        if not self._commit(batch, durable=durable > 0):
            return False
        # Only now do they leave the queue: what a full disk has refused is tried again as it was.
        with self._wake:
            for _ in range(bulk):
                self._rows.popleft()
            # Of a full queue the oldest have gone by themselves while the batch was under way.
            for _ in range(min(durable, len(self._urgent))):
                self._urgent.popleft()
            self._flush = False
            self.failure = ""
            self._wake.notify_all()
        return True

    def _commit(self, batch: list[tuple[str, Row]], *, durable: bool) -> bool:
        if not batch:
            return True
        # One durable row makes the whole batch wait for the disk: it is one transaction.
        connection = self._full if durable else self._normal
        by_table: dict[str, list[Row]] = {}
        for table, row in batch:
            by_table.setdefault(table, []).append(row)
        try:
            with connection:
                connection.execute("BEGIN IMMEDIATE")
                for table, rows in by_table.items():
                    connection.executemany(INSERTS[table], rows)
        except sqlite3.Error as error:
            self.failure = f"{self.path}: cannot be written ({error}); make room or mend the disk"
            return False
        return True

    def _delete_before(self, moment: float) -> None:
        """In chunks, each its own transaction, so that no reader and no alarm waits long."""
        try:
            tags = [row[0] for row in self._normal.execute("SELECT id FROM tags").fetchall()]
            for table, statement in DELETES.items():
                for tag in tags if table == "samples" else [None]:
                    values = {"tag": tag, "moment": moment, "rows": _CHUNK}
                    while self._normal.execute(statement, values).rowcount > 0:
                        if self._urgent:
                            self._round()
            # 4 MB of freed pages at most go back to the system at a time: each one moved is written again.
            self._normal.execute("PRAGMA incremental_vacuum(1000)").fetchall()
        except sqlite3.Error as error:
            self.failure = f"{self.path}: old rows cannot be deleted ({error}); make room or mend the disk"


def open_historian(path: Path, tags: Iterable[Tag], *, max_mb: float = 4096.0) -> tuple[Historian, dict[str, int]]:
    """Open or make the historian at `path` for one gateway; also gives the number of each tag in its `samples`.

    Raises HistorianError, in one sentence: the path is a directory, cannot be written, is no historian or one of
    another version, or another gateway holds it.
    """
    if path.is_dir():
        raise HistorianError(f"{path}: is a directory; give the path of a file for the historian")
    lock_path = path.with_name(path.name + ".lock")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # A lock on a file of its own, since SQLite locks the database itself: the system frees it when the process
        # ends, however it ends, which a file that merely exists would not.
        lock = os.open(lock_path, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o644)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
            raise HistorianError(
                f"{lock_path}: another gateway is running on this historian; stop it, or give this one a historian of "
                "its own"
            ) from None
    except HistorianError:
        raise
    except OSError as error:
        raise HistorianError(
            f"{path}: cannot be made ({error.strerror}); give a path that this user may write"
        ) from None
    try:
        normal = _connected(path, "NORMAL", max_mb)
        numbers = _prepared(normal, path, tags)
        full = _connected(path, "FULL", max_mb)
    except sqlite3.Error as error:
        os.close(lock)
        # SQLite tells these apart by its words only, and each wants another remedy.
        remedy = "make room or give another path"
        if "not a database" in str(error):
            remedy = "give the path of a historian or of a new file"
        elif "readonly" in str(error) or "unable to open" in str(error):
            remedy = "give a path that this user may write"
        raise HistorianError(f"{path}: cannot be used ({error}); {remedy}") from None
    except HistorianError:
        os.close(lock)
        raise
    return Historian(path, (normal, full), lock), numbers


def _connected(path: Path, synchronous: str, max_mb: float) -> sqlite3.Connection:
    connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False, timeout=5.0)
    try:
        # Before anything else: a database takes up auto_vacuum only while it is empty (sqlite.org/pragma.html), and the
        # journal mode writes its first page.
        connection.execute("PRAGMA auto_vacuum = INCREMENTAL")
        connection.execute("PRAGMA journal_mode = WAL").fetchone()
        connection.execute(f"PRAGMA synchronous = {synchronous}")
        # 64 MiB: a WAL that grew while a reader held it back is cut to this once it is checkpointed.
        connection.execute("PRAGMA journal_size_limit = 67108864").fetchone()
        # The file's largest size: beyond it SQLite says that the disk is full, before the disk is.
        connection.execute(f"PRAGMA max_page_count = {int(max_mb * 1_000_000 / _PAGE)}").fetchone()
    except sqlite3.Error:
        connection.close()
        raise
    return connection


def _prepared(connection: sqlite3.Connection, path: Path, tags: Iterable[Tag]) -> dict[str, int]:
    kind = connection.execute("PRAGMA application_id").fetchone()[0]
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    empty = not connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]
    if not empty and kind != APPLICATION_ID:
        raise HistorianError(f"{path}: is a database of something else; give the path of a historian or of a new file")
    if not empty and version != VERSION:
        raise HistorianError(
            f"{path}: has layout {version}, this gateway writes {VERSION}; give the path of a new file"
        )
    connection.execute("BEGIN IMMEDIATE")
    if empty:
        for statement in TABLES.split(";"):
            connection.execute(statement)
        connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
        connection.execute(f"PRAGMA user_version = {VERSION}")
    connection.execute(ADDED)
    connection.executemany("INSERT OR IGNORE INTO tags (name, unit) VALUES (?, ?)", [(t.name, t.unit) for t in tags])
    numbers = {str(name): int(number) for number, name in connection.execute("SELECT id, name FROM tags")}
    connection.execute("COMMIT")
    return numbers


def saved_state(historian: Historian, key: str, log: FilteringBoundLogger) -> tuple[float, dict[str, Any]] | None:
    """When a state was saved and its content; None where there is none, or, logged, where it cannot be read."""
    try:
        state = historian.load(key)
    except ValueError as error:
        log.warning("a saved state cannot be read and is not used", state=key, reason=str(error))
        return None
    return state if state is not None and isinstance(state[1], dict) else None
