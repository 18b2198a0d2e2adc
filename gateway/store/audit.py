"""The audit log: every write, every refusal, every arming; only ever appended, each row bound to the one before.

Its rows are a chain (`gateway.store.chain`), so that one that was changed, put in or taken out shows (`verify`);
triggers of the database refuse to change or to delete one. What is bound by nothing is the end: keep the newest hash
(`head`) apart from the file, as the acceptance report does, and give it to `verify`.

Every row is on the disk (synchronous FULL) before it counts as stored. Several processes may append; they take turns.

Two ways in. `put` leaves a row to the log: it is committed with others within BATCH_SECONDS, and tried again for as
long as the disk refuses. `record` and `stored` wait for one row and follow it by a ticket of its own: it is committed
at once, together with all that waits, and tried once. Who gives up waiting takes the row back; where its commit is
under way already, a row of its own undoes it (`undo`). So what was reported as not stored never counts later.

An entry is about a subject: one of the blocks that a gateway writes. The first, "", is that of a gateway with one; any
other stands in the entry's detail, so that chain and confirmations are bound to it.

At most MAX_WAITING_ROWS rows of a subject wait. Beyond that those of `put` are given up and counted, except armings and
disarmings, and one row of the kind LOST says how many, as soon as the disk takes rows again. A commit takes at most
MAX_SUBJECT_ROWS_PER_COMMIT rows of a subject: however many come of one, those of another wait for no more than that.
"""

import asyncio
import json
import sqlite3
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Future
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from math import isfinite
from pathlib import Path
from typing import Any

from drivers.errors import OneLineError
from drivers.supervision import Supervisor
from gateway.store.chain import BEGIN, digest
from gateway.store.durable import make_private
from gateway.store.relied_files import GROWS, ReliedFiles, database
from sim.strict_json import escape_text, json_text

APPLICATION_ID = 0x6465_6175
"""Marks the file as a decanter audit log (SQLite's application_id)."""
VERSION = 1
MAX_WAITING_ROWS = 1_000
"""Entries of a subject that may wait for the disk; with as many of them nothing of it is written to the PLC any more.
"""
MAX_SUBJECT_ROWS_PER_COMMIT = 200
"""Entries of a subject in one commit."""
SUBJECT = "subject"
"""The key of an entry's detail that names its subject."""
LONGEST_SUBJECT = 200
NO_PROCESS: Mapping[str, int] = {}
"""No `uid` and `pid` in the detail of a row: the gateway's own doing, or a person's over the network."""
BATCH_SECONDS = 1.0
"""The longest that an entry nobody waits for is kept back for the next commit."""
PATIENCE_SECONDS = 5.0
PAGE = 1024
"""Bytes of a page of a new log: a commit writes whole pages, and a row is about 500 bytes."""

ARMED, DISARMED, EXPIRED, CANCELLED = "armed", "disarmed", "arming over", "arming cancelled"
"""Kinds of the rows that say who may write (`gateway.store.arming_rows`)."""
CONFIRMED = "confirmed"
"""Kind of the row that makes a person's word count (`gateway.store.confirming`)."""
LOST = "rows lost"
_ARMINGS = (ARMED, DISARMED, EXPIRED, CANCELLED, CONFIRMED)
_OF_ARMINGS = "kind IN ({})".format(", ".join(f"'{kind}'" for kind in _ARMINGS))
_RETRY_SECONDS = 1.0
_FILES = "audit log"
"""What its files are called among those that are relied on."""
_COLUMNS = "id, time, kind, who, reason, detail, hash"

_TABLES = """
CREATE TABLE audit (id INTEGER PRIMARY KEY, time REAL NOT NULL, kind TEXT NOT NULL, who TEXT NOT NULL,
    reason TEXT NOT NULL, detail TEXT NOT NULL, hash BLOB NOT NULL)|
CREATE INDEX audit_armings ON audit (id) WHERE {armings}|
CREATE TRIGGER audit_no_change BEFORE UPDATE ON audit
    BEGIN SELECT RAISE(ABORT, 'the audit log is only ever appended'); END|
CREATE TRIGGER audit_no_loss BEFORE DELETE ON audit
    BEGIN SELECT RAISE(ABORT, 'the audit log is only ever appended'); END|
CREATE TRIGGER audit_in_order BEFORE INSERT ON audit WHEN NEW.id IS NOT (SELECT coalesce(max(id), 0) + 1 FROM audit)
    BEGIN SELECT RAISE(ABORT, 'the audit log is only ever appended'); END
"""


class _TakenAwayError(sqlite3.OperationalError):
    """The path leads to the file no more that is open."""


class AuditError(OneLineError, OSError):
    """The audit log cannot be used; the message is one sentence that says why and what would be right."""


class UnusableAuditError(AuditError):
    """The file cannot be made, read or written now."""


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
                object.__setattr__(self, name, escape_text(value))

    def with_subject(self, subject: str) -> "AuditEntry":
        """This entry about a subject ("": the first, which no entry names). Raises ValueError for one that is no name.

        What would be stored as another text than it is could be taken for another subject: it is refused.
        """
        return replace(self, detail=subject_detail(subject, self.detail)) if subject else self

    @property
    def subject(self) -> str | None:
        """What it is about; None where the row names none rightly, and is about nothing."""
        if SUBJECT not in self.detail:
            return ""
        subject = self.detail[SUBJECT]
        return subject if isinstance(subject, str) and subject else None


def subject_detail(subject: str, detail: Mapping[str, Any]) -> Mapping[str, Any]:
    """The detail of an entry about a subject ("": the first, as it is). Raises ValueError for one that is no name."""
    if not subject:
        return detail
    if not subject.isprintable() or len(subject) > LONGEST_SUBJECT:
        raise ValueError(f"{subject!r} is no subject; give printable text of {LONGEST_SUBJECT} characters at most")
    return {**detail, SUBJECT: subject}


AuditColumns = tuple[float, str, str, str, str]
"""Time, kind, who, reason and detail of an entry, as they are hashed and stored."""


@dataclass(frozen=True, slots=True)
class _Waiting:
    """An entry with its columns and subject, and the ticket of whoever waits for it.

    Cancelled it is never stored, running it is being committed; None: nobody waits.
    """

    entry: AuditEntry
    columns: AuditColumns
    subject: str | None
    ticket: "Future[AuditRow] | None" = None


@dataclass(frozen=True, slots=True)
class AuditRow:
    """One stored entry: its number from 1 and the chain's hash at it (hexadecimal)."""

    id: int
    entry: AuditEntry
    hash: str


@dataclass(frozen=True, slots=True)
class EndedElsewhere:
    """The word of another program that takes an arming back: its row, who has said it and why."""

    row: int
    who: str
    reason: str


@dataclass(frozen=True, slots=True)
class ChainVerdict:
    """What `verify` found: the number of rows, the newest hash, and what is wrong ("" if nothing)."""

    rows: int
    head: str
    problem: str = ""


class Audit:
    """An open audit log. `put` never waits for the disk, `record` and `stored` do; each may be called from any thread.

    All blocks of a gateway share one. `failure` says why the disk does not take what waits, "" while it does.
    Without a `connection` entries wait, and `attach`, which raises AuditError, is tried again and again: it gives one,
    and the sentence that what was there was damaged ("": it was not). So it is too where the file was taken away under
    it. `note` says of both from then on. `files` are those that the gateway relies on, all
    of which are looked at before and after each commit. `ended_elsewhere` has, by subject, the newest disarming that
    another program has put into the file since it was opened: each commit takes note of those before its own rows, and
    another file has none of them.
    """

    def __init__(
        self,
        path: Path,
        connection: sqlite3.Connection | None,
        supervisor: Supervisor,
        *,
        attach: "Callable[[], tuple[sqlite3.Connection, str]] | None" = None,
        failure: str = "",
        note: str = "",
        files: ReliedFiles | None = None,
    ) -> None:
        self.path = path
        self.failure, self.note = failure, note
        self.files = files or ReliedFiles()
        self.ended_elsewhere: Mapping[str, EndedElsewhere] = {}
        self._newest: tuple[int, bytes] | None = None
        self._known_rows: int | None = None
        self._lost: Counter[str | None] = Counter()
        self._attach = attach
        self._connection = connection
        self._waiting: deque[_Waiting] = deque()
        self._backlog: Counter[str | None] = Counter()
        self._wake = threading.Condition()
        self._pressing = self._stopping = False
        self._stop = threading.Event()
        self._rely_on_file()
        self._thread = supervisor.thread("audit", self._work, stop=self._stop)

    def put(self, entry: AuditEntry) -> None:
        """Have the entry stored; an arming or disarming at once, any other within BATCH_SECONDS.

        Raises ValueError for one that no row can hold.
        """
        waiting = _Waiting(entry, _columns(entry), entry.subject)
        with self._wake:
            if self._backlog[waiting.subject] >= MAX_WAITING_ROWS and entry.kind not in _ARMINGS:
                self._lost[waiting.subject] += 1
                return
            self._append(waiting)
            self._pressing = self._pressing or entry.kind in _ARMINGS
            self._wake.notify_all()

    def record(
        self, entry: AuditEntry, timeout: float = PATIENCE_SECONDS, undo: AuditEntry | None = None
    ) -> AuditRow | None:
        """Store the entry and wait until it is on the disk: its row; None: it is not stored, and will not be.

        Where that cannot be known, as its commit was under way when the time was over or has failed, `undo` follows it.
        """
        ticket = self._submit(entry)
        try:
            return ticket.result(timeout)
        except (TimeoutError, CancelledError, sqlite3.Error):
            return self._abandon(ticket, undo)

    async def stored(
        self, entry: AuditEntry, timeout: float = PATIENCE_SECONDS, undo: AuditEntry | None = None
    ) -> AuditRow | None:
        """`record` for a task of the event loop; one that is cancelled meanwhile takes its entry back too."""
        ticket = self._submit(entry)
        if ticket.cancelled():
            return None
        loop = asyncio.get_running_loop()
        # One future and one timer, which only say that it is time to look at the ticket: a time-out must not cancel
        # that before it was looked at whether the entry is stored.
        looked_at = loop.create_future()

        def look() -> None:
            if not looked_at.done():
                looked_at.set_result(None)

        def on_decision(_ticket: "Future[AuditRow]") -> None:
            with suppress(RuntimeError):  # the loop is closed: nobody waits any more
                loop.call_soon_threadsafe(look)

        ticket.add_done_callback(on_decision)
        timer = loop.call_later(timeout, look)
        try:
            await looked_at
        except asyncio.CancelledError:
            self._abandon(ticket, undo, wanted=False)
            raise
        finally:
            timer.cancel()
        # What fails after nobody waits any more is said by `failure`.
        if ticket.done() and not ticket.cancelled() and ticket.exception() is None:
            return ticket.result()
        return self._abandon(ticket, undo)

    async def keep(self, entry: AuditEntry, timeout: float) -> None:
        """Have the entry stored and wait for it; what takes longer than `timeout` goes on with nobody waiting."""
        if await self.stored(entry, timeout) is None:
            self.put(entry)

    def _submit(self, entry: AuditEntry) -> "Future[AuditRow]":
        ticket: Future[AuditRow] = Future()
        waiting = _Waiting(entry, _columns(entry), entry.subject, ticket)
        with self._wake:
            if self._stopping:
                ticket.cancel()
                return ticket
            self._append(waiting)
            self._pressing = True
            self._wake.notify_all()
        return ticket

    def _abandon(self, ticket: "Future[AuditRow]", undo: AuditEntry | None, *, wanted: bool = True) -> AuditRow | None:
        """Nobody waits for the entry any more; its row if it was stored in this very moment, and is `wanted`."""
        if ticket.cancel():
            return None
        if wanted and ticket.done() and ticket.exception() is None:
            return ticket.result()
        # Also after a commit that failed: what it has left in the WAL may be found whole after a power cut.
        if undo is not None:
            self.put(undo)
        return None

    def _append(self, waiting: "_Waiting") -> None:
        self._waiting.append(waiting)
        self._backlog[waiting.subject] += 1

    @property
    def complaint(self) -> str:
        """`subject_complaint` the subject that has most entries waiting."""
        return self.subject_complaint(max(self._backlog, key=self._backlog.__getitem__, default=""))

    @property
    def lost(self) -> int:
        """The entries that were given up since the disk took the last."""
        return self._lost.total()

    def subject_complaint(self, subject: str | None) -> str:
        """Why nothing of a subject may be written to the PLC now, as it could not be accounted for; "" if it may."""
        if why := self.failure or self.files.complaint:
            return why
        waiting = self._backlog[subject]
        return f"{self.path}: {waiting} entries wait for the disk" if waiting >= MAX_WAITING_ROWS else ""

    def close(self) -> bool:
        """Store what waits and close the file; False if entries had to be given up. May be called twice."""
        self._stop.set()
        with self._wake:
            self._stopping = True
            self._wake.notify_all()
        self._thread.join(timeout=10.0)
        if not self._thread.is_alive():
            self._let_go()
        return not self._waiting and not self.lost

    def _work(self) -> None:
        while True:
            if not self._ensure_open():
                return
            with self._wake:
                self._wake.wait_for(lambda: self._waiting or self._stopping)
                # What somebody waits for is committed now, and takes along what would have waited.
                self._wake.wait_for(lambda: self._pressing or self._stopping, BATCH_SECONDS)
                if not self._waiting:
                    if self._stopping:
                        return
                    continue
            taken = False
            claimed: list[_Waiting] = []
            lost: Counter[str | None] = Counter()

            def claim() -> list[tuple[AuditEntry, AuditColumns]]:
                """The entries of this commit with their columns, behind those that say how many were lost before."""
                nonlocal claimed, lost
                with self._wake:
                    claimed, lost = self._claim(), self._lost.copy()
                now = claimed[0].entry.time if claimed else 0.0
                missing = [_loss_entry(subject, rows, now) for subject, rows in lost.items() if rows and claimed]
                return [
                    *((entry, _columns(entry)) for entry in missing),
                    *((one.entry, one.columns) for one in claimed),
                ]

            try:
                rows = self._commit(claim)
                rows = rows[len(rows) - len(claimed) :]
            except sqlite3.Error as error:
                stored = False
                self.failure = f"{self.path}: cannot be written ({error}); make room or mend the disk"
                if taken := isinstance(error, _TakenAwayError):
                    self.failure = self.note = str(error)
                    self._let_go()
                elif self._attach is not None and _is_read_only(error):
                    # Opened while the disk took nothing, it stays so when the disk does: it is opened anew, as the
                    # same file.
                    self._newest = None
                    self._let_go()
                with self._wake:
                    self._pressing = False
                    if not claimed:  # the lock did not come: who waits learns it now, and what can wait does
                        claimed = self._claim(len(self._waiting))
                    self._requeue(claimed)
                for one in claimed:
                    if one.ticket is not None:
                        one.ticket.set_exception(error)
            except Exception as error:
                # The supervisor says it and begins anew; what was claimed does not go with it.
                with self._wake:
                    self._requeue(claimed)
                for one in claimed:
                    if one.ticket is not None:
                        one.ticket.set_exception(sqlite3.OperationalError(str(error)))
                raise
            else:
                stored, self.failure = True, ""
                with self._wake:
                    self._lost -= lost if claimed else Counter()
                for one, row in zip(claimed, rows, strict=True):
                    if one.ticket is not None:
                        one.ticket.set_result(row)
            with self._wake:
                if self._stopping and (not stored or not self._waiting):
                    return
                if not stored and not taken:
                    self._wake.wait_for(lambda: self._stopping or self._pressing, _RETRY_SECONDS)

    def _ensure_open(self) -> bool:
        """Wait until there is a file to write to; False if it is to stop before, and a last try has failed."""
        last = False
        while self._connection is None:
            try:
                if self._attach is None:
                    raise UnusableAuditError(self.failure or f"{self.path}: is not open")
                self._connection, damaged = self._attach()
                self._rely_on_file()
                self.note = "; ".join(filter(None, (self.note, damaged, self._missing_rows())))
                self.failure, self._newest = "", None
            except AuditError as error:
                self.failure = str(error)
                if last:
                    return False
                with self._wake:
                    last = self._wake.wait_for(lambda: self._stopping, _RETRY_SECONDS)
        return True

    def _rely_on_file(self) -> None:
        """From now on the files that are open are looked at."""
        if self._connection is not None:
            self.files.watch(_FILES, database(self.path, GROWS))
            self.files.look()
            with suppress(sqlite3.Error):  # which the first commit meets, and says
                last = self._connection.execute("SELECT id FROM audit ORDER BY id DESC LIMIT 1").fetchone()
                rows = int(last[0]) if last else 0
                self._known_rows = rows if self._known_rows is None else min(rows, self._known_rows)
                # Of another file the numbers of rows say nothing of the armings in this one.
                self.ended_elsewhere = {
                    subject: ended
                    for subject, ended in self.ended_elsewhere.items()
                    if _newest_ends(self._connection, ended.row - 1).get(subject) == ended
                }

    def _let_go(self) -> None:
        self.files.forget(_FILES)
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def _missing_rows(self) -> str:
        """What of it is not in the file that is open now, after another one was; "" where none was."""
        if self._newest is None or self._connection is None:
            return ""
        row, digest = self._newest
        found = self._connection.execute("SELECT hash FROM audit WHERE id = ?", (row,)).fetchone()
        if found is not None and bytes(found[0]) == digest:
            return "what is there now has all rows that were written"
        return f"what is there now has not row {row}, which was written; it has to be acknowledged as lost"

    def _commit(self, claim: Callable[[], Sequence[tuple[AuditEntry, AuditColumns]]]) -> list[AuditRow]:
        """Commit what `claim` gives, which is asked once the write lock is had. Raises sqlite3.Error."""
        if (connection := self._connection) is None:
            raise sqlite3.OperationalError("the audit log is not open")
        # Before the file is touched, as what was cut there would end the process, and after it: what is committed to a
        # file whose name is gone is on record nowhere.
        self._check_presence()
        with connection:
            # The write lock comes first, and may take its time: until then an entry can be taken back.
            connection.execute("BEGIN IMMEDIATE")
            if why := _rollback_reason(connection, self._newest):
                self.files.tell(why)
                raise _TakenAwayError(why)
            self.ended_elsewhere = {**self.ended_elsewhere, **_newest_ends(connection, self._known_rows or 0)}
            rows = _insert(connection, claim())
        self._check_presence()
        if rows:
            self._known_rows = rows[-1].id
            self._newest = rows[-1].id, bytes.fromhex(rows[-1].hash)
        return rows

    def _check_presence(self) -> None:
        if why := self.files.look(_FILES):
            raise _TakenAwayError(why)

    def _claim(self, share: int = MAX_SUBJECT_ROWS_PER_COMMIT) -> "list[_Waiting]":
        """Take what the next commit stores: of each subject the oldest entries, `share` at most (the lock is held)."""
        taken: Counter[str | None] = Counter()
        claimed, left = [], deque[_Waiting]()
        for one in self._waiting:
            if taken[one.subject] >= share:
                left.append(one)
                continue
            self._backlog[one.subject] -= 1
            if one.ticket is None or one.ticket.set_running_or_notify_cancel():
                taken[one.subject] += 1
                claimed.append(one)
        self._waiting, self._pressing = left, bool(left)
        return claimed

    def _requeue(self, claimed: "Sequence[_Waiting]") -> None:
        """Have what nobody waits for tried again, before what has come since (the lock is held)."""
        for one in reversed(claimed):
            if one.ticket is None:
                self._waiting.appendleft(one)
                self._backlog[one.subject] += 1


def _is_read_only(error: sqlite3.Error) -> bool:
    return getattr(error, "sqlite_errorcode", 0) & 0xFF == sqlite3.SQLITE_READONLY


def _loss_entry(subject: str | None, rows: int, now: float) -> AuditEntry:
    reason = f"{rows} rows could not be kept while the disk took none"
    return AuditEntry(now, LOST, "", reason, {"rows": rows}).with_subject(subject or "")


def open_audit(path: Path, supervisor: Supervisor | None = None) -> Audit:
    """The audit log at `path`, made if there is none; `supervisor` keeps its thread going. Raises AuditError."""
    return Audit(path, connect(path), supervisor or Supervisor())


def connect(path: Path) -> sqlite3.Connection:
    """A connection to the audit log at `path`, made if there is none.

    Raises AuditError: UnusableAuditError where it cannot be made or written, which may change while a gateway runs.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        make_private(path)
        connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False, timeout=10.0)
    except (OSError, sqlite3.Error) as error:
        raise UnusableAuditError(f"{path}: cannot be made ({error}); give a path that this user may write") from None
    try:
        # Of a new file only, and before the journal mode, which writes its first page (sqlite.org/pragma.html).
        connection.execute(f"PRAGMA page_size = {PAGE}")
        connection.execute("PRAGMA journal_mode = WAL").fetchone()
        # FULL: with a WAL, NORMAL may lose the last transactions in a power cut (sqlite.org/pragma.html, synchronous).
        connection.execute("PRAGMA synchronous = FULL")
        # Looked at and made in one transaction: of two processes that begin together only one makes the tables.
        connection.execute("BEGIN IMMEDIATE")
        if not connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
            for statement in _TABLES.format(armings=_OF_ARMINGS).split("|"):
                connection.execute(statement)
            connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
            connection.execute(f"PRAGMA user_version = {VERSION}")
        connection.execute("COMMIT")
        _check(connection, path)
    except sqlite3.Error as error:
        connection.close()
        sentence = f"{path}: cannot be used ({error}); give the path of an audit log or of a new file"
        raise UnusableAuditError(sentence) from None
    except AuditError:
        connection.close()
        raise
    return connection


def read(path: Path, kinds: Sequence[str] = ()) -> list[AuditRow]:
    """The rows in their order, all or those of some kinds. Raises AuditError."""
    with _reading(path) as connection:
        return [_row(row) for row in _rows(connection, kinds)]


def read_since(path: Path, time: float, wanted: Callable[[str], bool]) -> list[AuditRow]:
    """The rows of `wanted` kinds from the first one on that is not older than `time` (s UTC). Raises AuditError.

    The first is found by halving: of a clock that was set back some older rows may follow it.
    """
    with _reading(path) as connection:
        first, end = 1, int(connection.execute("SELECT coalesce(max(id), 0) + 1 FROM audit").fetchone()[0])
        while first < end:
            middle = (first + end) // 2
            row = connection.execute("SELECT time FROM audit WHERE id = ?", (middle,)).fetchone()
            first, end = (middle + 1, end) if row is not None and row[0] < time else (first, middle)
        kinds = [str(kind) for (kind,) in connection.execute("SELECT DISTINCT kind FROM audit WHERE id >= ?", (first,))]
        marks = [kind for kind in kinds if wanted(kind)]
        chosen = f"SELECT {_COLUMNS} FROM audit WHERE id >= ? AND kind IN ({', '.join('?' * len(marks))}) ORDER BY id"  # noqa: S608
        return [_row(row) for row in connection.execute(chosen, (first, *marks))]


def arming_rows(path: Path) -> list[AuditRow]:
    """The rows that say who may write, in their order, as far as they are well formed; none without a log.

    Raises AuditError.
    """
    if not path.exists():
        return []
    with _reading(path) as connection:
        rows = connection.execute(f"SELECT {_COLUMNS} FROM audit WHERE {_OF_ARMINGS} ORDER BY id").fetchall()  # noqa: S608
    found = []
    for plain in rows:
        with suppress(ValueError, TypeError, KeyError, AttributeError, ArithmeticError):
            row = _row(plain)
            detail = dict(row.entry.detail)
            # Of an arming its end has to be there, and what else it is counted by has to be numbers.
            wanted = {"until"} | ({"uptime", "speed"} & detail.keys())
            if row.entry.kind != ARMED or all(isfinite(float(detail[key])) for key in wanted):
                found.append(row)
    return found


def newest_time(path: Path, since: int) -> float | None:
    """The latest time (s UTC) in the rows from number `since` on. Raises AuditError."""
    with _reading(path) as connection:
        newest = connection.execute("SELECT max(time) FROM audit WHERE id >= ?", (since,)).fetchone()[0]
    return None if newest is None else float(newest)


def verify(path: Path, head: str = "") -> ChainVerdict:
    """Recompute the chain; with `head`, a hash kept from before must be in it. Raises AuditError for no audit log."""
    count, before, seen = 0, BEGIN, not head
    with _reading(path) as connection:
        # The columns as they are stored: what a row means is no matter here, and every arming waits for this.
        for number, *stored, kept in _readable(_rows(connection)):
            # A gap in the numbers is told before the hash: it says what has happened, the hash only that something has.
            if number != count + 1:
                return ChainVerdict(count, before.hex(), f"row {count + 1} is missing")
            try:
                count, before = number, _hash(before, number, *stored)
            except (ValueError, TypeError):  # bytes or an infinite number, which no row was ever made of
                kept = None
            if kept != before:
                return ChainVerdict(
                    number, before.hex(), f"row {number} was changed, or one before it was put in or taken out"
                )
            seen = seen or before.hex() == head
        if reason := _tail_damage(connection, count):
            return ChainVerdict(count, before.hex(), f"nothing behind row {count} can be read: {reason}")
    return ChainVerdict(count, before.hex(), "" if seen else f"no row has the hash {head[:16]}...: the end is missing")


def head(path: Path) -> str:
    """The newest hash; that of an empty log is zeros. Raises AuditError."""
    with _reading(path) as connection:
        row = connection.execute("SELECT hash FROM audit ORDER BY id DESC LIMIT 1").fetchone()
    return bytes(row[0]).hex() if row else BEGIN.hex()


def recompute_hashes(path: Path, rows: Iterable[int]) -> dict[int, str]:
    """The hashes at these rows as they follow from what stands there and from the hash before. Raises AuditError."""
    found = {}
    with _reading(path) as connection:
        for row in rows:
            before = connection.execute("SELECT hash FROM audit WHERE id = ?", (row - 1,)).fetchone()
            plain = connection.execute(f"SELECT {_COLUMNS} FROM audit WHERE id = ?", (row,)).fetchone()  # noqa: S608
            with suppress(ValueError, TypeError):  # values which no row was ever made of
                if plain is not None and (before is not None or row == 1):
                    found[row] = _hash(bytes(before[0]) if before else BEGIN, *plain[:-1]).hex()
    return found


def hashes(path: Path, rows: Iterable[int] | None = None) -> dict[int, str]:
    """The hashes at these rows, as far as they are there; None: at the newest. Raises AuditError."""
    query = "SELECT id, hash FROM audit WHERE id = ?"
    wanted: list[tuple[int, ...]] = [(row,) for row in rows or ()]
    if rows is None:
        query, wanted = "SELECT id, hash FROM audit ORDER BY id DESC LIMIT 1", [()]
    with _reading(path) as connection:
        found = [row for each in wanted for row in connection.execute(query, each)]
    return {int(number): bytes(digest).hex() for number, digest in found}


# ---------------------------------------------------------------- the file


def _rollback_reason(connection: sqlite3.Connection, newest: tuple[int, bytes] | None) -> str:
    """That the row which was written last (number, hash) is not in the file any more; "" if it is."""
    if newest is None:
        return ""
    found = connection.execute("SELECT hash FROM audit WHERE id = ?", newest[:1]).fetchone()
    if found is not None and bytes(found[0]) == newest[1]:
        return ""
    name = str(connection.execute("PRAGMA database_list").fetchone()[2])
    return f"{name}: row {newest[0]} was written and is not in it any more, or is another one"


def _newest_ends(connection: sqlite3.Connection, row: int) -> dict[str, EndedElsewhere]:
    """The newest disarming of each subject behind a row, as far as they are well formed. To take away needs no key."""
    ended = {}
    sql = f"SELECT {_COLUMNS} FROM audit WHERE id > ? AND kind IN (?, ?) ORDER BY id"  # noqa: S608
    for plain in connection.execute(sql, (row, DISARMED, EXPIRED)):
        with suppress(ValueError, TypeError, AttributeError):
            found = _row(plain)
            if (subject := found.entry.subject) is not None:
                ended[subject] = EndedElsewhere(found.id, found.entry.who, found.entry.reason)
    return ended


def _insert(connection: sqlite3.Connection, entries: Sequence[tuple[AuditEntry, AuditColumns]]) -> list[AuditRow]:
    """Append the entries, each with its columns, within a transaction that has the write lock; gives their rows."""
    last = connection.execute("SELECT id, hash FROM audit ORDER BY id DESC LIMIT 1").fetchone()
    number, before = (int(last[0]), bytes(last[1])) if last else (0, BEGIN)
    rows = []
    for entry, plain in entries:
        number += 1
        before = _hash(before, number, *plain)
        connection.execute(f"INSERT INTO audit ({_COLUMNS}) VALUES (?, ?, ?, ?, ?, ?, ?)", (number, *plain, before))  # noqa: S608
        rows.append(AuditRow(number, entry, before.hex()))
    return rows


def _columns(entry: AuditEntry) -> AuditColumns:
    """The entry as it is hashed and stored. Raises ValueError for a time that is no number."""
    if not isfinite(entry.time):
        raise ValueError(f"an audit row needs a time, got {entry.time}")
    detail = json_text(entry.detail, sort_keys=True)
    return (float(entry.time), entry.kind, _storable(entry.who), _storable(entry.reason), _storable(detail))


def _storable(text: str) -> str:
    # A lone surrogate, as JSON can carry it, is text to Python and none to SQLite.
    return text if text.isascii() else text.encode("utf-8", "backslashreplace").decode("utf-8")


def _hash(before: bytes, *plain: object) -> bytes:
    return digest(before, json.dumps(plain, ensure_ascii=False, allow_nan=False).encode())


def _row(row: Sequence[Any]) -> AuditRow:
    number, time, kind, who, reason, detail, digest = row
    return AuditRow(int(number), AuditEntry(float(time), kind, who, reason, json.loads(detail)), bytes(digest).hex())


def _rows(connection: sqlite3.Connection, kinds: Sequence[str] = ()) -> sqlite3.Cursor:
    """The rows as they are stored, in their order: all, or those of some kinds. Raises sqlite3.Error."""
    where = f"WHERE kind IN ({', '.join('?' * len(kinds))})" if kinds else ""
    return connection.execute(f"SELECT {_COLUMNS} FROM audit {where} ORDER BY id", tuple(kinds))  # noqa: S608


def _readable(rows: sqlite3.Cursor) -> Iterator[tuple[Any, ...]]:
    """The rows up to the first damage (`_tail_damage`)."""
    with suppress(sqlite3.DatabaseError):
        while (row := rows.fetchone()) is not None:
            yield row


def _tail_damage(connection: sqlite3.Connection, row: int) -> str:
    """Why there is nothing to be read behind a row; "" where it is the last one."""
    try:
        for _ in connection.execute(f"SELECT {_COLUMNS} FROM audit WHERE id > ? ORDER BY id", (row,)):  # noqa: S608
            pass
    except sqlite3.DatabaseError as error:
        return str(error)
    return ""


@contextmanager
def _reading(path: Path) -> Iterator[sqlite3.Connection]:
    """A connection that only reads. Raises AuditError, also for what goes wrong while it is used.

    Bytes that are no text are read with escapes in their places: their row is changed, and all others are what they
    are.
    """
    if not path.is_file():
        raise AuditError(f"{path}: there is no audit log; nothing was armed or written with it")
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=10.0)) as connection:
            connection.text_factory = lambda data: data.decode("utf-8", "backslashreplace")
            _check(connection, path)
            yield connection
    except (sqlite3.Error, ValueError, TypeError) as error:
        raise AuditError(f"{path}: cannot be read ({error}); it is damaged, or was changed by something else") from None


def _check(connection: sqlite3.Connection, path: Path) -> None:
    kind = connection.execute("PRAGMA application_id").fetchone()[0]
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    if kind != APPLICATION_ID:
        raise AuditError(f"{path}: is a database of something else; give the path of an audit log or of a new file")
    if version != VERSION:
        raise AuditError(f"{path}: has layout {version}, this program reads {VERSION}; give the path of another file")
