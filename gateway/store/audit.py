"""The audit log: every write, every refusal, every arming; only ever appended, each row bound to the one before.

Its rows are a chain (`gateway.store.chain`), so that one that was changed, put in or taken out shows (`verify`);
triggers of the database refuse to change or to delete one. What is bound by nothing is the end: keep the newest hash
(`head`) apart from the file, as the acceptance report does, and give it to `verify`.

Every row is on the disk (synchronous FULL) before it counts as stored. Several processes may append; they take turns.
"""

import json
import sqlite3
import threading
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gateway.one_line import printable
from gateway.store.chain import BEGIN, digest
from sim.strict_json import json_text

APPLICATION_ID = 0x6465_6175
"""Marks the file as a decanter audit log (SQLite's application_id)."""
VERSION = 1
BACKLOG = 1_000
"""Entries that may wait for the disk; with more of them nothing is written to the PLC any more."""

ARMED, DISARMED, EXPIRED = "armed", "disarmed", "arming over"
_ARMINGS = (ARMED, DISARMED, EXPIRED)
_RETRY_SECONDS = 1.0
_COLUMNS = "id, time, kind, who, reason, detail, hash"

_TABLES = """
CREATE TABLE audit (id INTEGER PRIMARY KEY, time REAL NOT NULL, kind TEXT NOT NULL, who TEXT NOT NULL,
    reason TEXT NOT NULL, detail TEXT NOT NULL, hash BLOB NOT NULL)|
CREATE INDEX audit_by_kind ON audit (kind, id)|
CREATE TRIGGER audit_no_change BEFORE UPDATE ON audit
    BEGIN SELECT RAISE(ABORT, 'the audit log is only ever appended'); END|
CREATE TRIGGER audit_no_loss BEFORE DELETE ON audit
    BEGIN SELECT RAISE(ABORT, 'the audit log is only ever appended'); END|
CREATE TRIGGER audit_in_order BEFORE INSERT ON audit WHEN NEW.id IS NOT (SELECT coalesce(max(id), 0) + 1 FROM audit)
    BEGIN SELECT RAISE(ABORT, 'the audit log is only ever appended'); END
"""


class AuditError(OSError):
    """The audit log cannot be used; the message is one sentence that says why and what would be right."""


@dataclass(frozen=True, slots=True)
class AuditEntry:
    """One thing that happened: `time` (s UTC, the plant's clock), what kind, who, why, and the rest as plain values."""

    time: float
    kind: str
    who: str = ""
    reason: str = ""
    detail: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        # Names and reasons come from people and from the device: none of them breaks a line or steers a terminal.
        for name in ("kind", "who", "reason", "detail"):
            if (value := getattr(self, name)) is not None:
                object.__setattr__(self, name, printable(value))


@dataclass(frozen=True, slots=True)
class AuditRow:
    """One stored entry: its number from 1 and the chain's hash at it (hexadecimal)."""

    id: int
    entry: AuditEntry
    hash: str


@dataclass(frozen=True, slots=True)
class ChainVerdict:
    """What `verify` found: the number of rows, the newest hash, and what is wrong ("" if nothing)."""

    rows: int
    head: str
    problem: str = ""


class Audit:
    """An open audit log. `put` never waits for the disk, `record` does; both may be called from any thread.

    `failure` says why the disk does not take what waits, "" while it does.
    """

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self.path = path
        self.failure = ""
        self._connection = connection
        self._waiting: deque[AuditEntry] = deque()
        self._wake = threading.Condition()
        self._stopping = False
        self._thread = threading.Thread(target=self._work, name="audit", daemon=True)
        self._thread.start()

    def put(self, entry: AuditEntry) -> None:
        """Have the entry stored, within milliseconds while the disk takes it."""
        with self._wake:
            self._waiting.append(entry)
            self._wake.notify_all()

    def record(self, entry: AuditEntry, timeout: float = 5.0) -> bool:
        """Store the entry and wait until it is on the disk; False if that did not come about in time."""
        with self._wake:
            self._waiting.append(entry)
            self._wake.notify_all()
            return self._wake.wait_for(lambda: not self._waiting, timeout)

    @property
    def complaint(self) -> str:
        """Why nothing may be written to the PLC now, as it could not be accounted for; "" if it may."""
        if self.failure:
            return self.failure
        waiting = len(self._waiting)
        return f"{self.path}: {waiting} entries wait for the disk" if waiting > BACKLOG else ""

    def close(self) -> bool:
        """Store what waits and close the file; False if entries had to be given up. May be called twice."""
        with self._wake:
            self._stopping = True
            self._wake.notify_all()
        self._thread.join(timeout=10.0)
        if not self._thread.is_alive():
            self._connection.close()
        return not self._waiting

    def _work(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._waiting or self._stopping)
                batch, stopping = list(self._waiting), self._stopping
            try:
                append(self._connection, batch)
                stored, self.failure = True, ""
            except sqlite3.Error as error:
                stored = False
                self.failure = f"{self.path}: cannot be written ({error}); make room or mend the disk"
            with self._wake:
                # What is stored leaves only now, so that `record` waits for the disk and a refused batch waits on.
                for _ in batch if stored else ():
                    self._waiting.popleft()
                self._wake.notify_all()
                if stopping and (not stored or not self._waiting):
                    return
                if not stored:
                    self._wake.wait_for(lambda: self._stopping, _RETRY_SECONDS)


def open_audit(path: Path) -> Audit:
    """The audit log at `path`, made if there is none. Raises AuditError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False, timeout=10.0)
    except (OSError, sqlite3.Error) as error:
        raise AuditError(f"{path}: cannot be made ({error}); give a path that this user may write") from None
    try:
        connection.execute("PRAGMA journal_mode = WAL").fetchone()
        # FULL: with a WAL, NORMAL may lose the last transactions in a power cut (sqlite.org/pragma.html, synchronous).
        connection.execute("PRAGMA synchronous = FULL")
        # Looked at and made in one transaction: of two processes that begin together only one makes the tables.
        connection.execute("BEGIN IMMEDIATE")
        if not connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
            for statement in _TABLES.split("|"):
                connection.execute(statement)
            connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
            connection.execute(f"PRAGMA user_version = {VERSION}")
        connection.execute("COMMIT")
        _check(connection, path)
    except sqlite3.Error as error:
        connection.close()
        raise AuditError(f"{path}: cannot be used ({error}); give the path of an audit log or of a new file") from None
    except AuditError:
        connection.close()
        raise
    return Audit(path, connection)


def append(connection: sqlite3.Connection, entries: Sequence[AuditEntry]) -> str:
    """Append the entries in one transaction; gives the newest hash. Raises sqlite3.Error, and then none is stored."""
    with connection:
        # IMMEDIATE: the write lock is taken before the newest hash is read, so that no other process can append between
        # the two and break the chain.
        connection.execute("BEGIN IMMEDIATE")
        last = connection.execute("SELECT id, hash FROM audit ORDER BY id DESC LIMIT 1").fetchone()
        number, before = (int(last[0]), bytes(last[1])) if last else (0, BEGIN)
        for entry in entries:
            number += 1
            plain = (float(entry.time), entry.kind, entry.who, entry.reason, json_text(entry.detail, sort_keys=True))
            before = _hash(before, number, *plain)
            connection.execute(f"INSERT INTO audit ({_COLUMNS}) VALUES (?, ?, ?, ?, ?, ?, ?)", (number, *plain, before))  # noqa: S608
    return before.hex()


def read(path: Path, kinds: Sequence[str] = ()) -> list[AuditRow]:
    """The rows in their order, all or those of some kinds. Raises AuditError."""
    with closing(_reader(path)) as connection:
        return [row for row, _ in _rows(connection, path) if not kinds or row.entry.kind in kinds]


def last_arming(path: Path) -> AuditRow | None:
    """The newest row of the kinds ARMED, DISARMED and EXPIRED; None without one. Raises AuditError."""
    if not path.exists():
        return None
    with closing(_reader(path)) as connection:
        marks = ", ".join("?" * len(_ARMINGS))
        query = f"SELECT {_COLUMNS} FROM audit WHERE kind IN ({marks}) ORDER BY id DESC LIMIT 1"  # noqa: S608
        row = connection.execute(query, _ARMINGS).fetchone()
    return _row(row) if row else None


def standing(path: Path, now: float) -> AuditRow | None:
    """The arming in force at `now`; None if there is none, it was taken back, or it is over. Raises AuditError."""
    row = last_arming(path)
    if row is None or row.entry.kind != ARMED or not row.entry.time <= now < float(row.entry.detail["until"]):
        return None
    return row


def verify(path: Path, head: str = "") -> ChainVerdict:
    """Recompute the chain; with `head`, a hash kept from before must be in it. Raises AuditError for no audit log."""
    count, before, seen = 0, BEGIN, not head
    with closing(_reader(path)) as connection:
        for row, stored in _rows(connection, path):
            # A gap in the numbers is told before the hash: it says what has happened, the hash only that something has.
            if row.id != count + 1:
                return ChainVerdict(count, before.hex(), f"row {count + 1} is missing")
            count, before = row.id, _hash(before, row.id, *stored)
            if before.hex() != row.hash:
                return ChainVerdict(
                    count, row.hash, f"row {count} was changed, or one before it was put in or taken out"
                )
            seen = seen or row.hash == head
    return ChainVerdict(count, before.hex(), "" if seen else f"no row has the hash {head[:16]}...: the end is missing")


def head(path: Path) -> str:
    """The newest hash; that of an empty log is zeros. Raises AuditError."""
    with closing(_reader(path)) as connection:
        row = connection.execute("SELECT hash FROM audit ORDER BY id DESC LIMIT 1").fetchone()
    return bytes(row[0]).hex() if row else BEGIN.hex()


def hashes(path: Path, rows: Iterable[int] | None = None) -> dict[int, str]:
    """The hashes at these rows, as far as they are there; None: at the newest. Raises AuditError."""
    query = "SELECT id, hash FROM audit WHERE id = ?"
    wanted: list[tuple[int, ...]] = [(row,) for row in rows or ()]
    if rows is None:
        query, wanted = "SELECT id, hash FROM audit ORDER BY id DESC LIMIT 1", [()]
    with closing(_reader(path)) as connection:
        found = [row for each in wanted for row in connection.execute(query, each)]
    return {int(number): bytes(digest).hex() for number, digest in found}


# ---------------------------------------------------------------- the file


def _hash(before: bytes, *plain: object) -> bytes:
    return digest(before, json.dumps(plain, ensure_ascii=False, allow_nan=False).encode())


def _row(row: Sequence[Any]) -> AuditRow:
    number, time, kind, who, reason, detail, digest = row
    return AuditRow(int(number), AuditEntry(float(time), kind, who, reason, json.loads(detail)), bytes(digest).hex())


def _rows(connection: sqlite3.Connection, path: Path) -> Iterator[tuple[AuditRow, tuple[Any, ...]]]:
    try:
        for row in connection.execute(f"SELECT {_COLUMNS} FROM audit ORDER BY id"):  # noqa: S608
            yield _row(row), tuple(row[1:6])
    except (sqlite3.Error, ValueError, TypeError) as error:
        raise AuditError(f"{path}: cannot be read ({error}); it was changed by something else") from None


def _reader(path: Path) -> sqlite3.Connection:
    if not path.is_file():
        raise AuditError(f"{path}: there is no audit log; nothing was armed or written with it")
    try:
        connection = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=10.0)
        _check(connection, path)
    except sqlite3.Error as error:
        raise AuditError(f"{path}: cannot be read ({error}); give the path of an audit log") from None
    return connection


def _check(connection: sqlite3.Connection, path: Path) -> None:
    kind = connection.execute("PRAGMA application_id").fetchone()[0]
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    if kind != APPLICATION_ID:
        raise AuditError(f"{path}: is a database of something else; give the path of an audit log or of a new file")
    if version != VERSION:
        raise AuditError(f"{path}: has layout {version}, this program reads {VERSION}; give the path of another file")
