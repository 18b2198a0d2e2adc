"""What every user of a SQLite file of ours needs: what its errors mean, and a transaction."""

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager


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
