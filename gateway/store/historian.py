"""The embedded historian: SQLite (WAL), written by one thread in batches; the scan never waits for the disk.

One historian serves all machines of a plant. Each puts its rows through a view of it, which knows whose they are; the
file's numbers of sources and tags are the thread's own matter (`numbers`).

Policy of the queues: rows of measurement wait in queues of MAX_QUEUED_ROWS rows at most, rows of DURABLE tables in
those of MAX_URGENT_ROWS, each source in its own. When there are too many (the disk is full or has gone) the oldest rows
of the source that has most of them are dropped and counted: a machine that floods costs no other a row. While the disk
refuses, `failure` says why and the thread tries again each second; nothing else stops. A row that cannot be stored
costs that row, a table with a bad page that table: it is counted, and `complaint` says it.

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
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing, suppress
from functools import partial
from pathlib import Path
from shutil import disk_usage
from time import monotonic
from typing import TYPE_CHECKING, Any

from drivers.supervision import Supervisor
from drivers.tag import Tag
from gateway.store.columns import PackedError
from gateway.store.durable import RECORDS_MODE
from gateway.store.files import MOST_WAL_BYTES, HistorianError, HistorianFile, UnusableHistorianError, open_file
from gateway.store.numbers import FileNumbers, Source, newest_scan_time
from gateway.store.queues import Batch, LostRows, Row, RowQueues
from gateway.store.relied_files import STAYS, FileRule, ReliedFiles, database
from gateway.store.retention import (
    Packer,
    delete_step,
    make_room,
    pages,
    release_pages,
)
from gateway.store.schema import AT_ONCE, DURABLE, INDICES, INSERTS, MEASURED, PACKED, definition
from gateway.store.sqlite_file import concerns_file, is_damage, source_numbers, transaction

if TYPE_CHECKING:
    from structlog.typing import FilteringBoundLogger


MAX_QUEUED_ROWS, MAX_URGENT_ROWS = 200_000, 10_000
BATCH_SECONDS = 1.0
STALL_SECONDS = 10.0
"""How long rows may wait for the disk before that is a complaint."""
DISK_MARGIN_BYTES = 1_000_000
"""Bytes: with less of them left it is the disk that is full, and not the historian that has reached its size."""
_FILES = "historian"
"""What its files are called among those that are relied on."""
LOCK = "historian's lock"
ROW_ERRORS = (sqlite3.Error, ArithmeticError, LookupError, TypeError, ValueError)
"""What a row that cannot be stored raises."""


class Historian:
    """An open historian: views of it may be had at any time (`view`), and nothing needs to be awaited.

    `failure` says why nothing can be stored now ("": it can). Without a `file` rows wait in the queues, and `attach` is
    tried each second.
    """

    def __init__(
        self,
        path: Path,
        file: HistorianFile | None,
        attach: Callable[[], HistorianFile],
        release: Callable[[], None],
        *,
        supervisor: Supervisor,
        failure: str = "",
        files: ReliedFiles | None = None,
    ) -> None:
        self.path = path
        self.failure = failure
        self.files = files or ReliedFiles()
        self._least = 0
        self.note = file.note if file else ""
        self._attach, self._release, self._file = attach, release, file
        self._sources: list[Source] = []
        self._units: dict[tuple[str, str], str] = {}
        self._numbers: FileNumbers | None = None
        self._rows, self._urgent = RowQueues(MAX_QUEUED_ROWS), RowQueues(MAX_URGENT_ROWS)
        self._lost: defaultdict[str, LostRows] = defaultdict(LostRows)
        self._wake = threading.Condition()
        self._at_once = self._flush = False
        self._begun = self._completed = 0  # rounds that commit everything
        self._forget: float | None = None
        self._waits_since: float | None = None
        self._due = monotonic() + BATCH_SECONDS
        self._packer: Packer | None = None
        self._stop = threading.Event()
        self._rely_on_file()
        self._thread = supervisor.thread("historian", self._work, stop=self._stop)

    def view(self, machine: str, tags: Iterable[Tag] = (), temperature: str = "") -> HistorianView:
        """The historian as one machine sees it, or one `temperature` that is followed on it; `tags` give the units.

        The temperatures of a machine keep the order in which they were first asked for.
        """
        with self._wake:
            self._units.update({(machine, tag.name): tag.unit for tag in tags})
            if (machine, temperature) not in self._sources:
                self._sources.append((machine, temperature))
        return HistorianView(self, machine, temperature)

    def put(self, source: Source, table: str, rows: Sequence[Row]) -> None:
        """Take rows of a source for a table of INSERTS (`HistorianView.put`)."""
        if not rows:
            return
        with self._wake:
            queues = self._urgent if table in DURABLE else self._rows
            queues.put(source, table, rows)
            if queues.full:
                self._drop_beyond_the_queues()
            if self._waits_since is None and (self._rows.rows or self._urgent.rows):
                self._waits_since = monotonic()
            # Many writes do not wait for their second either: of a replay as fast as it goes none is to be dropped.
            if self._urgent.rows and (table in AT_ONCE or self._urgent.rows >= MAX_URGENT_ROWS // 10):
                self._at_once = True
                self._wake.notify_all()

    def flush(self, timeout: float = 5.0) -> bool:
        """Wait until everything that was put is committed; False if the disk did not take it in time."""
        with self._wake:
            # The next round that begins: one that is under way may have begun without it.
            wanted = self._begun + 1
            self._flush = True
            self._wake.notify_all()
            return self._wake.wait_for(lambda: self._completed >= wanted, timeout)

    def delete_older(self, moment: float) -> None:
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

    def machine_losses(self, machine: str) -> LostRows:
        """What a machine has lost."""
        return self._lost[machine]

    @property
    def complaint(self) -> str:
        """Why the records cannot be relied on: `stuck`, a row was lost of late, a file set aside; "" if they can.

        It does not change from one lost row to the next: how many they are is in `dropped` and `refused`.
        """
        lost = max(list(self._lost.values()), key=lambda one: one.at, default=LostRows()).complaint
        return self.stuck or lost or self.note

    @property
    def dropped(self) -> int:
        """The rows of all machines that the queues had no place for."""
        return sum(lost.dropped for lost in list(self._lost.values()))

    @property
    def refused(self) -> int:
        """The rows of all machines that no table takes."""
        return sum(lost.refused for lost in list(self._lost.values()))

    def load(self, source: Source, key: str) -> tuple[float, Any] | None:
        """A saved state of a source (`HistorianView.load`)."""
        if self._file is None:
            return None
        try:
            with closing(sqlite3.connect(f"{self.path.absolute().as_uri()}?mode=ro", uri=True)) as reader:
                query = "SELECT time, content FROM state JOIN sources ON sources.id = source "
                query += "WHERE machine = ? AND temperature = ? AND key = ?"
                row = reader.execute(query, (*source, key)).fetchone()
        except sqlite3.Error as error:
            raise HistorianError(f"{self.path}: cannot be read ({error})") from None
        return None if row is None else (float(row[0]), json.loads(row[1]))

    def newest(self, machine: str) -> float | None:
        """The time (s UTC) of a machine's scan that was stored last (`HistorianView.newest`)."""
        if self._file is None:
            return None
        try:
            return newest_scan_time(self._file.normal, machine)
        except sqlite3.Error:
            return None

    def close(self) -> bool:
        """Commit what waits, stop the thread, free the file; False if rows had to be given up. May be called twice."""
        with self._wake:
            if self._stop.is_set():
                return True
            self._stop.set()
            self._wake.notify_all()
        self._thread.join(timeout=10.0)
        complete = not self._rows.rows and not self._urgent.rows and not self._thread.is_alive()
        if not self._thread.is_alive():
            self._let_go()
            self.files.forget(LOCK)
            self._release()
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
        for (machine, _), table in (*self._urgent.overflow(), *self._rows.overflow()):
            self._lost[machine].dropped += 1
            self._lost[machine].note(f"{self.path}: rows of {table} were dropped, as too many wait for the disk")

    # ---------------------------------------------------------------- the thread

    def _work(self) -> None:
        while True:
            with self._wake:
                self._wake.wait_for(
                    lambda: self._at_once or self._flush or self._stop.is_set(), max(self._due - monotonic(), 0.0)
                )
                stopping, moment = self._stop.is_set(), self._forget
                everything = stopping or self._flush or monotonic() >= self._due
                if everything:
                    self._begun, self._flush = self._begun + 1, False
            if everything:
                self._due = monotonic() + BATCH_SECONDS
            committed = self._ensure_file() and self._round(everything=everything)
            if stopping and (not committed or not (self._rows.rows or self._urgent.rows)):
                return
            if not committed:
                self._packer = None
                self._stop.wait(BATCH_SECONDS)
            elif everything:
                self._tend(moment)
                self._note_size()

    def _tend(self, moment: float | None) -> None:
        """Between two batches: pack what has grown old, and delete what is older than `moment`, if one is given."""
        # Only on a disk that takes rows: to pack and to delete is to write as well.
        packer = self._packer = self._packer or Packer(self._normal)
        for table in PACKED:
            self._tend_table(table, partial(self._pack_batch, packer, table))
        self._tend_table("tiers", packer.tiers)
        if moment is not None:
            for source in source_numbers(self._normal):
                for table in (*MEASURED, "writes"):
                    self._tend_table(table, partial(delete_step, self._normal, table, source, moment))
            with self._wake:
                # Another moment may have been given while the deletion ran; that one is still to be done.
                self._forget = None if self._forget == moment else self._forget
            self._least = 0  # it may become smaller now
            self._tend_table("", partial(release_pages, self._normal))

    def _ensure_file(self) -> bool:
        """Whether there is a file to write to: the one that is open, or, where it has gone, another one."""
        # All files that the gateway relies on: each second, also where nothing is written.
        gone = self.files.look(_FILES)
        if self._file is not None and not gone:
            return True
        before = self._file is not None
        self._let_go()
        try:
            self._file = self._attach()
        except HistorianError as error:
            self.failure = str(error)
            return False
        self._rely_on_file()
        self.failure = ""
        taken = f"{self.path}: was taken away while it was written ({gone}); a new one was begun" if before else ""
        self.note = "; ".join(filter(None, (taken, self._file.note))) or self.note
        return True

    def _rely_on_file(self) -> None:
        """From now on the files that are open are looked at."""
        self._least = 0
        if self._file is not None:
            self._note_size()
            rule = FileRule(least=lambda: self._least)
            self.files.watch(_FILES, database(self.path, rule, FileRule(grows=True, late=True, most=MOST_WAL_BYTES)))
            self.files.look()

    def _let_go(self) -> None:
        self.files.forget(_FILES)
        if self._file is not None:
            self._file.close()
        self._file = self._numbers = None

    def _note_size(self) -> None:
        """Have the file never fall below the size that it has now, but for the pages that were given back since."""
        with suppress(OSError, sqlite3.Error):  # then as before: whoever writes next says what is wrong
            if self._file is not None:
                self._least = min(self.path.stat().st_size, self._file.bytes_in_use())

    def _round(self, *, everything: bool) -> bool:
        """Commit what waits now, of the measurements only if `everything`; False if the disk refused some of it."""
        self._at_once = False
        whole = self._commit(self._urgent, durable=True)
        if everything and self._file is not None:  # it was given up if the first of the two found it damaged
            whole = self._commit(self._rows, durable=False) and whole
        with self._wake:
            if whole:
                self.failure = ""
                self._completed = self._begun if everything else self._completed
                self._waits_since = monotonic() if self._rows.rows or self._urgent.rows else None
            self._wake.notify_all()
        return whole

    def _pack_batch(self, packer: Packer, table: str) -> bool:
        """Have one batch of a table packed; False if none has enough rows for one."""
        numbers = self._numbers
        if numbers is None or (source := packer.step(table, numbers.waiting[table])) is None:
            return False
        numbers.recount(self._normal, table, source)
        return True

    def _commit(self, queues: RowQueues, *, durable: bool) -> bool:
        """Commit what waits in the queues; what is not committed goes back to their front."""
        with self._wake:
            batch = queues.take()
        stored = not batch
        try:
            if batch:
                self._store(batch, durable)
                stored = True
        except sqlite3.Error as error:
            self.failure = f"{self.path}: cannot be written ({error}); make room or mend the disk"
            if is_damage(error) and self._file is not None:
                # Nothing of it can be written any more: it is opened again, which sets it aside.
                self._let_go()
        finally:
            with self._wake:
                if not stored:
                    queues.requeue(batch)
                self._drop_beyond_the_queues()
        return stored

    def _store(self, batch: Batch, durable: bool) -> None:
        """One transaction with all rows but those that no table takes. Raises sqlite3.Error when the file refuses."""
        connection = self._full if durable else self._normal
        by_table: dict[tuple[str, Source], list[Row]] = {}
        for source, waiting in batch.items():
            for table, row in waiting:
                by_table.setdefault((table, source), []).append(row)
        with self._wake:
            sources = list(self._sources)
        # Each turn but the last makes room, or begins a table anew: there are no more of these than tables.
        for turn in range(len(INSERTS) + 1):
            refused: list[tuple[str, Source, Exception]] = []
            table = ""
            # Until it is committed nothing counts, the numbers that are given in it neither.
            numbers, self._numbers = self._numbers, None
            try:
                with transaction(connection):
                    numbers = numbers or FileNumbers(connection)
                    # All that are known, in their order: of a machine's temperatures the first stays the first.
                    for source in sources:
                        numbers.source(connection, source)
                    self._number_tags(connection, numbers, by_table)
                    for (table, source), rows in by_table.items():
                        reasons = _insert_rows(connection, numbers, table, source, rows)
                        refused += [(table, source, reason) for reason in reasons]
            except sqlite3.Error as error:
                code = getattr(error, "sqlite_errorcode", 0) & 0xFF
                # Full is the file, which may hold so much, or the disk: what others have filled is no reason to delete.
                # A fiftieth of the file, so that it is not done anew with every batch; more for one that takes more.
                total, free = pages(self._normal)
                if (
                    code == sqlite3.SQLITE_FULL
                    and disk_usage(self.path.parent).free > DISK_MARGIN_BYTES
                    and make_room(self._normal, free + (max(128, total // 50) << turn))
                ):
                    continue
                # A bad page or a missing table, told by the one table that was written to.
                if code not in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_ERROR) or not table:
                    raise
                self._begin_anew(table, str(error))
                continue
            self._numbers = numbers
            for table, source, reason in refused:
                lost = self._lost[source[0]]
                lost.refused += 1
                lost.note(f"{self.path}: a row of {table} cannot be stored ({reason}) and was left out")
            return
        raise sqlite3.OperationalError("there is no end to what is wrong with it")

    def _number_tags(
        self, connection: sqlite3.Connection, numbers: FileNumbers, by_table: Mapping[tuple[str, Source], list[Row]]
    ) -> None:
        """Give a number to each tag of the samples; what is no name has none, and its row is refused."""
        for (table, (machine, _)), rows in by_table.items():
            if table == "samples":
                names = dict.fromkeys(row[0] for row in rows if row and isinstance(row[0], str))
                for name in filter(str.isprintable, names):
                    numbers.tag(connection, machine, name, self._units.get((machine, name), ""))

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

    def _tend_table(self, table: str, step: Callable[[], bool | None]) -> None:
        """Let `step` work while it says that there is more; alarms that come meanwhile are stored between its turns."""
        try:
            while not self._stop.is_set() and step():
                if self._at_once:
                    self._round(everything=False)
        except (sqlite3.Error, PackedError) as error:
            if isinstance(error, PackedError) or not concerns_file(error) or is_damage(error):
                self.note = f"{self.path}: {table or 'the file'} is damaged ({error}); a restart recovers what is left"
                return
            self.failure = f"{self.path}: old rows cannot be put away ({error}); make room or mend the disk"


def _insert_rows(
    connection: sqlite3.Connection, numbers: FileNumbers, table: str, source: Source, rows: Sequence[Row]
) -> list[Exception]:
    """Insert the rows of a source; gives why some are taken by no table. Raises sqlite3.Error when the file refuses."""
    number = numbers.sources[source]
    key, step = (numbers.next_key(connection, table, number), 1) if table in PACKED else (number, 0)

    def to_row(place: int, row: Row) -> Row:
        if table == "samples":
            row = (numbers.tags[source[0], row[0]], *row[1:])
        return (*row, key + step * place)

    taken, refused = len(rows), list[Exception]()
    connection.execute("SAVEPOINT rows")
    try:
        connection.executemany(INSERTS[table], [to_row(place, row) for place, row in enumerate(rows)])
    except ROW_ERRORS as error:
        if _beyond_the_row(error):
            raise
        connection.execute("ROLLBACK TO rows")
        # One of them cannot be stored, and nothing says which: each is tried by itself.
        taken = 0
        for row in rows:
            try:
                connection.execute(INSERTS[table], to_row(taken, row))
                taken += 1
            except ROW_ERRORS as reason:
                if _beyond_the_row(reason):
                    raise
                refused.append(reason)
    connection.execute("RELEASE rows")
    if step:
        numbers.took(table, number, taken)
    return refused


class HistorianView:
    """The historian as one machine sees it, or one `temperature` that is followed on it ("": none in particular).

    `put` and `flush` may be called from any thread, nothing else needs to be awaited.
    """

    def __init__(self, historian: Historian, machine: str, temperature: str) -> None:
        self._historian, self.machine, self.temperature = historian, machine, temperature
        self._source = (machine, temperature)

    def put(self, table: str, rows: Sequence[Row]) -> None:
        """Take rows for a table (`schema.NAMES`); they are committed within about a second, those of AT_ONCE at once.

        A row of `samples` begins with its tag's name.
        """
        self._historian.put(self._source, table, rows)

    def flush(self, timeout: float = 5.0) -> bool:
        """Wait until everything that was put is committed; False if the disk did not take it in time."""
        return self._historian.flush(timeout)

    def save(self, key: str, now: float, content: Mapping[str, Any]) -> None:
        """Keep a state, instead of the one kept under this key before."""
        self.put("state", [(key, now, json.dumps(content))])

    def load(self, key: str) -> tuple[float, Any] | None:
        """A state that this view has saved: the time it was saved and its content; None if there is none.

        Raises ValueError or HistorianError for one that cannot be read.
        """
        return self._historian.load(self._source, key)

    def newest(self) -> float | None:
        """The time (s UTC) of the machine's scan that was stored last; None without one."""
        return self._historian.newest(self.machine)

    @property
    def path(self) -> Path:
        """The historian's file."""
        return self._historian.path

    @property
    def failure(self) -> str:
        """Why nothing can be stored now; "": it can."""
        return self._historian.failure

    @property
    def note(self) -> str:
        """What was set aside or begun anew; "" nothing."""
        return self._historian.note

    @property
    def stuck(self) -> str:
        """Why nothing is stored now; "" while it is."""
        return self._historian.stuck

    @property
    def dropped(self) -> int:
        """The machine's rows that the queue had no place for."""
        return self._historian.machine_losses(self.machine).dropped

    @property
    def refused(self) -> int:
        """The machine's rows that no table takes."""
        return self._historian.machine_losses(self.machine).refused

    @property
    def complaint(self) -> str:
        """Why the machine's records cannot be relied on: `Historian.complaint` without the rows of other machines."""
        return self.stuck or self._historian.machine_losses(self.machine).complaint or self.note


def _beyond_the_row(error: Exception) -> bool:
    """Whether the table or the file is at fault, and not the row that was tried."""
    return concerns_file(error) or (
        isinstance(error, sqlite3.Error)
        and getattr(error, "sqlite_errorcode", 0) & 0xFF in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_ERROR)
    )


def open_historian(
    path: Path,
    *,
    max_mb: float = 4096.0,
    mend: bool = False,
    patient: bool = False,
    supervisor: Supervisor | None = None,
    heir: str = "",
    files: ReliedFiles | None = None,
) -> Historian:
    """Open or make the historian at `path` for one gateway.

    `heir` is the machine to which the rows of a former file belong, whose gateway had one machine and no name for it.

    With `mend`, which the gateway asks for, nothing that has befallen the file or its folder keeps it from running: a
    damaged file is set aside and a new one begun, and where nothing can be written the rows wait (`complaint`). So they
    do, with `patient`, where there is a database of something else or of a newer layout, which is left as it is.

    Raises HistorianError, in one sentence: another gateway holds it; without `patient` it is a database of something
    else or of a newer layout; without `mend` also where it is damaged or cannot be written.
    """
    locked, files = _FileLock(path), files or ReliedFiles()

    def attach() -> HistorianFile:
        locked.take()
        if not files.knows(LOCK):
            files.watch(LOCK, {locked.place: STAYS})
        return open_file(path, max_mb=max_mb, mend=mend, heir=heir)

    file, failure = None, ""
    try:
        file = attach()
    except HistorianError as error:
        if not (mend and isinstance(error, UnusableHistorianError)) and not (patient and locked.taken):
            locked.free()
            raise
        failure = str(error)
    supervisor = supervisor or Supervisor()
    return Historian(path, file, attach, locked.free, supervisor=supervisor, failure=failure, files=files)


class _FileLock:
    """The lock of one gateway on a historian: on a file of its own, since SQLite locks the database itself.

    The system frees it when the process ends, however it ends, which a file that merely exists would not.
    """

    def __init__(self, path: Path) -> None:
        self._path, self.place = path, path.with_name(path.name + ".lock")
        self._descriptor: int | None = None

    def take(self) -> None:
        """Take it, or have it already. Raises HistorianError where another process has it, or none can be made."""
        if self._descriptor is not None:
            return
        try:
            self.place.parent.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(self.place, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, RECORDS_MODE)
        except OSError as error:
            raise UnusableHistorianError(
                f"{self._path}: cannot be made ({error.strerror}); give a path that this user may write"
            ) from None
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(descriptor)
            raise HistorianError(
                f"{self.place}: another gateway is running on this historian; stop it, or give this one a historian "
                "of its own"
            ) from None
        self._descriptor = descriptor

    @property
    def taken(self) -> bool:
        """Whether this process has it."""
        return self._descriptor is not None

    def free(self) -> None:
        """Give it back, if it was taken."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None


def saved_state(historian: HistorianView, key: str, log: FilteringBoundLogger) -> tuple[float, dict[str, Any]] | None:
    """When a state was saved and its content; None where there is none, or, logged, where it cannot be read."""
    try:
        state = historian.load(key)
    except (ValueError, HistorianError) as error:
        log.warning("a saved state cannot be read and is not used", state=key, reason=str(error))
        return None
    return state if state is not None and isinstance(state[1], dict) else None
