"""The historian's file: opened or made, brought from an older layout, set aside when it is damaged.

What can be read of a damaged file goes into a new one, the durable tables first; the damaged one stays under another
name. A file of something else and one of a newer layout are nobody's damage: they are refused and left alone.

Layouts 1 and 2 knew one machine and one followed temperature: their rows become those of the `heir`, a machine's name,
or of a machine named "" until a gateway that has a name for it opens the file.
"""

import os
import sqlite3
import time
from collections.abc import Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from itertools import groupby
from math import inf
from pathlib import Path
from shutil import disk_usage

from drivers.errors import OneLineError
from gateway.store.durable import DATABASE_SUFFIXES, make_private, set_aside
from gateway.store.schema import (
    APPLICATION_ID,
    COLUMNS,
    FOLLOWED,
    INDICES,
    NAMES,
    PACKED,
    VERSION,
    WITHOUT_ROWID,
    definition,
    first_key,
)
from gateway.store.sqlite_file import concerns_file, is_damage, transaction

PAGE = 1024
"""Bytes of a page of a new file. A commit writes whole pages, mostly of one row or two, and a packed column ends in the
middle of one: small pages write and waste less."""
CHECK_SECONDS = 2.0
"""How long a file is checked for damage before the gateway goes on with what it has seen of it."""
RECOVERY_SECONDS = 20.0
"""How long is read from a damaged file; what is left then stays in it."""
MOST_WAL_BYTES = 64 << 20
"""A WAL that grew while a reader held it back is cut to this once it is checkpointed."""
_RESERVE_BYTES = 16_000_000


class HistorianError(OneLineError, OSError):
    """The historian's file cannot be used; the message is one sentence that says why and what would be right."""


class DamagedHistorianError(HistorianError):
    """There is something at the path that is no database (any more)."""


class UnusableHistorianError(HistorianError):
    """Nothing can be kept there now: no room, no right, no folder."""


@dataclass(frozen=True, slots=True)
class HistorianFile:
    """An open file: a connection that does not wait for the disk, and one that does.

    `note` says what was set aside and recovered ("" nothing).
    """

    path: Path
    normal: sqlite3.Connection
    full: sqlite3.Connection
    note: str = ""

    def bytes_in_use(self) -> int:
        """The size that the file has once all is in it that is committed. Raises sqlite3.Error."""
        pages, size = (self.normal.execute(f"PRAGMA {name}").fetchone()[0] for name in ("page_count", "page_size"))
        return int(pages) * int(size)

    def close(self) -> None:
        """Close both connections."""
        for connection in (self.normal, self.full):
            connection.close()


def open_file(path: Path, *, max_mb: float, mend: bool = False, heir: str = "") -> HistorianFile:
    """Open or make the file at `path`. With `mend` a damaged one is set aside, and a new one begun with what is left.

    Raises HistorianError: DamagedHistorianError only without `mend`, UnusableHistorianError for what may pass.
    """
    emptied = path.is_file() and not path.stat().st_size
    try:
        _examine(path, whole=mend)
        file = _connect(path, max_mb, heir)
        note = f"{path}: was empty; a new one was begun, and what was in it, if anything was, is gone"
        return replace(file, note=note) if emptied else file
    except DamagedHistorianError as error:
        if not mend:
            raise
        try:
            aside, reason = set_aside(path), str(error).removeprefix(f"{path}: ")
        except OSError as failed:
            raise UnusableHistorianError(
                f"{path}: is damaged and cannot be set aside ({failed.strerror}); move it away by hand"
            ) from None
    file = _connect(path, max_mb, heir)
    rows, complete = _recover(aside, file.normal, heir)
    what = f"{rows} rows of it were recovered" + ("" if complete else ", and not all that may be left")
    note = f"{path}: was damaged ({reason}) and is set aside as {aside.name}; {what}; a new one was begun"
    return replace(file, note=note)


def _connect(path: Path, max_mb: float, heir: str) -> HistorianFile:
    if path.exists() and not path.is_file():
        what = "a directory" if path.is_dir() else "no file"
        raise DamagedHistorianError(f"{path}: is {what}; give the path of a file for the historian")
    # Of a disk that has less room than it may take, it takes nine tenths: the tenth is for alarms, log and audit.
    size = path.stat().st_size if path.exists() else 0
    limit = min(max_mb * 1_000_000, 0.9 * (size + disk_usage(path.parent).free))
    reserve = min(limit / 8, _RESERVE_BYTES)
    connections: list[sqlite3.Connection] = []
    try:
        # Measurements leave a reserve: an alarm that is raised when the file is full still has its row.
        with closing(_connection(path, "FULL", limit)) as first:
            _prepare(first, path, heir)
        connections.append(_connection(path, "NORMAL", limit - reserve))
        connections.append(_connection(path, "FULL", limit))
        return HistorianFile(path, connections[0], connections[1])
    except (sqlite3.Error, OSError) as error:
        for connection in connections:
            connection.close()
        if isinstance(error, HistorianError):
            raise
        # A WAL or its index that is no file stands in the way of any database of that name.
        strange = any(os.path.lexists(p) and not p.is_file() for p in _side_files(path)[1:])
        if strange or (isinstance(error, sqlite3.Error) and is_damage(error)):
            raise DamagedHistorianError(
                f"{path}: cannot be used ({error}); give the path of a historian or of a new file"
            ) from None
        # SQLite tells these apart by its words only, and each wants another remedy.
        rights = "readonly" in str(error) or "unable to open" in str(error)
        remedy = "give a path that this user may write" if rights else "make room or give another path"
        raise UnusableHistorianError(f"{path}: cannot be used ({error}); {remedy}") from None


def _connection(path: Path, synchronous: str, most_bytes: float) -> sqlite3.Connection:
    make_private(path)
    connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False, timeout=5.0)
    try:
        # Before anything else: a database takes up auto_vacuum only while it is empty (sqlite.org/pragma.html), and the
        # journal mode writes its first page.
        connection.execute(f"PRAGMA page_size = {PAGE}")
        connection.execute("PRAGMA auto_vacuum = INCREMENTAL")
        connection.execute("PRAGMA journal_mode = WAL").fetchone()
        connection.execute(f"PRAGMA synchronous = {synchronous}")
        connection.execute(f"PRAGMA journal_size_limit = {MOST_WAL_BYTES}").fetchone()
        # The file's largest size: beyond it SQLite says that the disk is full, before the disk is.
        page = int(connection.execute("PRAGMA page_size").fetchone()[0])
        connection.execute(f"PRAGMA max_page_count = {int(most_bytes / page)}").fetchone()
        # 4 MB: each page that was written more than once since the last checkpoint goes to its place once.
        connection.execute(f"PRAGMA wal_autocheckpoint = {4_000_000 // page}").fetchone()
    except sqlite3.Error:
        connection.close()
        raise
    return connection


def _prepare(connection: sqlite3.Connection, path: Path, heir: str) -> None:
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    tables = {str(row[0]) for row in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    if tables and version != VERSION:
        _migrate(connection, path, version, heir)
        tables = set(COLUMNS)
    with transaction(connection):
        for table in COLUMNS:
            if table not in tables:
                connection.execute(definition(table))
        if "chunks" not in tables:
            for statement in INDICES:
                connection.execute(statement)
        if not tables:
            connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
            connection.execute(f"PRAGMA user_version = {VERSION}")
        # What was brought from a former layout without a name goes to the first one that it is opened with.
        query = "SELECT machine FROM sources UNION SELECT machine FROM tags"
        named = {str(row[0]) for row in connection.execute(query)}
        if heir and "" in named and heir not in named:
            for table in ("sources", "tags"):
                connection.execute(f"UPDATE {table} SET machine = ? WHERE machine = ''", (heir,))  # noqa: S608


# ---------------------------------------------------------------- layouts


def _missing_before_3(table: str, heir: str) -> dict[str, str | int]:
    """What the rows of a table had not in the layouts of one machine: it is source 0, and bears the heir's name."""
    if table == "tags":
        return {"machine": heir}
    return {"source": 0} if table in ("runs", "alarms", "audit", "state") else {}


def _to_layout_3(connection: sqlite3.Connection, version: int, heir: str) -> None:
    """Bring a file of layout 1, which had its rows under their times and packed none, or of 2 to layout 3."""
    known = {str(row[0]) for row in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    for index in ("events_by_time", "writes_by_time"):
        connection.execute(f"DROP INDEX IF EXISTS {index}")
    for table, names in {"tags": ("id", "name", "unit"), **NAMES}.items():
        if table not in known:  # guards, in a file of the first gateways
            connection.execute(definition(table))
            continue
        numbered = version == 2 or table in ("tags", "events", "alarms", "writes", "audit")
        order = {"runs": "started", "state": "key", "forecasts": "time, horizon"}.get(table, "time")
        # By number where there was one, as what arrives in one scan bears one time. The numbers of layout 2 stay: they
        # are the keys of source 0.
        order = "rowid" if numbered and table != "state" else order
        kept = ["rowid"] if version == 2 and table in PACKED else []
        missing = _missing_before_3(table, heir)
        columns, into = ", ".join([*names, *kept]), ", ".join([*names, *kept, *missing])
        marks = "".join(f", :{name}" for name in missing)
        connection.execute(f"ALTER TABLE {table} RENAME TO former")
        connection.execute(definition(table))
        connection.execute(
            f"INSERT INTO {table} ({into}) SELECT {columns}{marks} FROM former ORDER BY {order}",  # noqa: S608
            missing,
        )
        connection.execute("DROP TABLE former")
    for table in ("sources", *sorted({"chunks", "tiers"} - known)):
        connection.execute(definition(table))
    for statement in INDICES if "chunks" not in known else ():
        connection.execute(statement)
    _name_sources(connection, heir)


def _name_sources(connection: sqlite3.Connection, heir: str) -> None:
    """Name the sources of rows that were written for one machine, and give each followed temperature its own.

    Which temperature was followed when the runs say; the one followed last is the machine's first.
    """
    connection.execute("INSERT INTO sources VALUES (0, ?, '')", (heir,))
    runs = connection.execute("SELECT started, temperature FROM runs ORDER BY started").fetchall()
    spans = [(next(group)[0], temperature) for temperature, group in groupby(runs, key=lambda run: run[1])]
    names = list(dict.fromkeys(temperature for _, temperature in reversed(spans) if temperature))
    for number, temperature in enumerate(names, start=1):
        connection.execute("INSERT INTO sources VALUES (?, ?, ?)", (number, heir, temperature))
    for place, (begin, temperature) in enumerate(spans):
        if not temperature:
            continue
        number = 1 + names.index(temperature)
        span = (-inf if place == 0 else begin, spans[place + 1][0] if place + 1 < len(spans) else inf)
        for table in FOLLOWED:
            connection.execute(
                f"UPDATE {table} SET id = id + ? WHERE id < ? AND time >= ? AND time < ?",  # noqa: S608
                (first_key(number), first_key(1), *span),
            )
            # Rows that were packed together stay so: they go with the first of them.
            connection.execute(
                "UPDATE chunks SET tag = ? WHERE kind = ? AND tag = 0 AND first >= ? AND first < ?",
                (number, table, *span),
            )
    if names:
        connection.execute("UPDATE state SET source = 1 WHERE key IN ('belief', 'bands', 'ensemble')")


def _migrate(connection: sqlite3.Connection, path: Path, version: int, heir: str) -> None:
    """Bring an older file to this layout, all or nothing, once a copy of it is kept beside it."""
    copy = path.with_name(f"{path.name}.layout{version}")
    if not copy.exists():
        draft = copy.with_name(copy.name + ".part")
        draft.unlink(missing_ok=True)
        make_private(draft)
        with closing(sqlite3.connect(draft)) as target:
            connection.backup(target)
        # In one step: a copy that was cut short by a kill never bears the name of a whole one.
        draft.replace(copy)
    # For a while every row is there twice; opened anew, the connection has its own limit again.
    connection.execute("PRAGMA max_page_count = 4294967294").fetchone()
    with transaction(connection):
        _to_layout_3(connection, version, heir)
        connection.execute(f"PRAGMA user_version = {VERSION}")


# ---------------------------------------------------------------- damage


def _side_files(path: Path) -> list[Path]:
    return [path.with_name(path.name + ending) for ending in DATABASE_SUFFIXES]


def _examine(path: Path, *, whole: bool) -> None:
    """Raise HistorianError for what is no historian of ours, DamagedHistorianError for one that SQLite finds damaged.

    It is only read: a file that is refused is left as it was, and a WAL of another database is not worked into it. With
    `whole` its pages are checked, as far as that comes in CHECK_SECONDS.
    """
    if not path.is_file() or not path.stat().st_size:
        return
    until = time.monotonic() + CHECK_SECONDS
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=1.0)) as connection:
            kind = int(connection.execute("PRAGMA application_id").fetchone()[0])
            version = int(connection.execute("PRAGMA user_version").fetchone()[0])
            # The file's own header (sqlite.org/fileformat.html, 1.3): what the WAL says may be another's.
            with path.open("rb") as stream:
                own = int.from_bytes(stream.read(72)[68:])
            if kind != APPLICATION_ID and own == APPLICATION_ID:
                raise DamagedHistorianError(f"{path}: its WAL is of another database")
            if kind != APPLICATION_ID and connection.execute("SELECT 1 FROM sqlite_master").fetchone():
                raise HistorianError(
                    f"{path}: is a database of something else; give the path of a historian or of a new file"
                )
            if version > VERSION:
                raise HistorianError(
                    f"{path}: has layout {version}, this gateway writes {VERSION}; give the path of a new file, or run "
                    "the gateway that wrote it"
                )
            connection.set_progress_handler(lambda: int(time.monotonic() > until), 10_000)
            verdict = str(connection.execute("PRAGMA quick_check(1)").fetchone()[0]) if whole else "ok"
    except sqlite3.Error as error:
        if is_damage(error):
            raise DamagedHistorianError(
                f"{path}: cannot be used ({error}); give the path of a historian or of a new file"
            ) from None
        return  # the time was over, or what opens it next says why it cannot be
    if verdict != "ok":
        raise DamagedHistorianError(f"{path}: {verdict.splitlines()[-1]}")


def _recover(aside: Path, target: sqlite3.Connection, heir: str) -> tuple[int, bool]:
    """Copy what can be read of a damaged file; gives the number of rows, and whether its end was reached.

    The durable tables come first, then the newest of the measurements: there may not be time for all.
    """
    until = time.monotonic() + RECOVERY_SECONDS
    rows, complete = 0, True
    if not aside.is_file():
        return 0, True
    wal, put_by = _side_files(aside)[1], aside.with_name(aside.name + ".wal")
    with suppress(OSError):
        wal.rename(put_by)
        # A WAL that spoils a sound file is of another one, and stays out of it; any other has the newest rows.
        with closing(_reader(aside)) as source:
            try:
                sound = source.execute("PRAGMA quick_check(1)").fetchone()[0] == "ok"
            except sqlite3.Error:
                sound = False
        if not sound:
            put_by.rename(wal)
    with suppress(sqlite3.Error), closing(_reader(aside)) as source:
        known = {str(row[0]) for row in source.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        version = int(source.execute("PRAGMA user_version").fetchone()[0])
        for table in dict.fromkeys(
            ("sources", "tags", "state", "runs", "audit", "alarms", "writes", "chunks", "tiers", *NAMES)
        ):
            names = [str(row[1]) for row in target.execute(f"PRAGMA table_info({table})")]
            missing = _missing_before_3(table, heir) if version < 3 else {}
            names = [name for name in names if name not in missing]
            if table not in WITHOUT_ROWID and (version > 1 or table in ("tags", "events", "alarms", "writes", "audit")):
                names = ["rowid", *(name for name in names if name != "id")]
            else:
                names = [name for name in names if name != "id"]
            if table in known:
                copied, whole = _copy_table(source, target, table, names, missing, until=until)
                rows, complete = rows + copied, complete and whole
        if version < 3:
            with transaction(target):
                _name_sources(target, heir)
    return rows, complete


def _reader(path: Path) -> sqlite3.Connection:
    return sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, isolation_level=None)


def _copy_table(
    source: sqlite3.Connection,
    target: sqlite3.Connection,
    table: str,
    names: list[str],
    missing: Mapping[str, str | int],
    *,
    until: float,
) -> tuple[int, bool]:
    """Copy a table from its newest row down to the damage, then from its oldest up to it; with what is `missing`."""
    columns = ", ".join(f'"{name}"' for name in names)
    given = "".join(f", :{name}" for name in missing)
    into = ", ".join([columns, *missing])
    marks = ", ".join("?" * (len(names) + len(missing)))
    before, whole = target.total_changes, True
    # A table without numbers of its own is read once, in its own order: from both ends its rows would come twice.
    for order in ("ORDER BY rowid DESC", "ORDER BY rowid") if "rowid" in names else ("",):
        try:
            rows = source.execute(f"SELECT {columns}{given} FROM {table} {order}", missing)  # noqa: S608
            while batch := rows.fetchmany(500):
                with transaction(target):
                    target.executemany(f"INSERT OR IGNORE INTO {table} ({into}) VALUES ({marks})", batch)  # noqa: S608
                if time.monotonic() > until:
                    return target.total_changes - before, False
            break  # the other end was reached
        except (sqlite3.Error, ValueError) as error:
            if isinstance(error, sqlite3.Error) and concerns_file(error) and not is_damage(error):
                return target.total_changes - before, False
            whole = False
    return target.total_changes - before, whole
