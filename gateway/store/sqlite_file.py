"""What every user of a SQLite file of ours needs: what its errors mean, a transaction, the keys of a source."""

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager

from gateway.store.schema import first_key


def _primary(error: sqlite3.Error) -> int:
    """SQLite's primary result code, the low byte of the extended one (sqlite.org/rescode.html); 0 for none."""
    return int(getattr(error, "sqlite_errorcode", 0)) & 0xFF


def is_damage(error: sqlite3.Error) -> bool:
    """Whether the file's content is wrong, as against the disk, a lock or a single row."""
    return _primary(error) in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)


def concerns_file(error: Exception) -> bool:
    """Whether the whole file cannot be written now, so that nothing is wrong with the row that was tried."""
    return isinstance(error, sqlite3.Error) and _primary(error) in (
        sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED, sqlite3.SQLITE_READONLY,
        sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_NOMEM, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_PERM,
        sqlite3.SQLITE_PROTOCOL,
    )  # fmt: skip


@contextmanager
def transaction(connection: sqlite3.Connection) -> Iterator[None]:
    """A transaction that has the write lock from its beginning, committed at the end, taken back on an error."""
    connection.execute("BEGIN IMMEDIATE")
    try:
        yield
        connection.execute("COMMIT")
    finally:
        if connection.in_transaction:
            connection.execute("ROLLBACK")


def key_range(source: int) -> tuple[int, int]:
    """The lowest and the highest key that a row of a source can have in a PACKED table."""
    return first_key(source), first_key(source + 1) - 1


def key_bounds(connection: sqlite3.Connection, table: str, source: int) -> tuple[int, int] | None:
    """The keys of the oldest and of the newest row of a source in a PACKED table; None without any."""
    query = f"SELECT min(id), max(id) FROM {table} WHERE id BETWEEN ? AND ?"  # noqa: S608
    # One at a time: only alone min and max are looked up and not searched for (sqlite.org/optoverview.html, 11).
    first, last = (
        connection.execute(query.replace(gone, ""), key_range(source)).fetchone()[0]
        for gone in (", max(id)", "min(id), ")
    )
    return None if first is None else (int(first), int(last))


def source_numbers(connection: sqlite3.Connection) -> list[int]:
    """The numbers of the file's sources."""
    return [int(row[0]) for row in connection.execute("SELECT id FROM sources ORDER BY id")]
