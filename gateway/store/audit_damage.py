"""A damaged audit log is set aside and a new one begun: the alarm does not wait for the account of the writes."""

import sqlite3
import time
from contextlib import closing
from functools import partial
from pathlib import Path

from drivers.supervision import Supervisor
from gateway.store.audit import APPLICATION_ID, Audit, AuditError, UnusableAuditError, connect
from gateway.store.durable import set_aside
from gateway.store.relied_files import ReliedFiles

LOOK_SECONDS = 2.0
"""The longest look for damage at a start (real time); what a longer one would find is found before an arming."""


def open_or_set_aside(path: Path, supervisor: Supervisor | None = None, files: ReliedFiles | None = None) -> Audit:
    """The audit log at `path`; where a damaged one was set aside its `note` says so.

    Nothing may be armed on the new one until the old one's head is acknowledged (`gateway.store.witness`). One that
    cannot be made or written now, that is something else or of another layout keeps no gateway from running: it has a
    `failure`, on which nothing is armed, is left as it is, and is tried again until it can be opened.
    """
    supervisor, attach = supervisor or Supervisor(), partial(_sound, path)
    try:
        connection, damaged = attach()
    except AuditError as error:
        return Audit(path, None, supervisor, attach=attach, failure=str(error), files=files)
    return Audit(path, connection, supervisor, attach=attach, note=damaged, files=files)


def _sound(path: Path) -> tuple[sqlite3.Connection, str]:
    """A connection to a log that is whole, and the sentence that a damaged one was set aside. Raises AuditError."""
    try:
        emptied = path.is_file() and not path.stat().st_size
        reason = damage(path)
    except OSError as error:  # not even looked at: a folder that this user may not enter
        raise UnusableAuditError(f"{path}: cannot be read ({error.strerror}); give a path that is yours") from None
    if not reason:
        begun = f"{path}: was empty; a new one is begun, and its rows, if it had any, are gone"
        return connect(path), begun if emptied else ""
    try:
        aside = set_aside(path)
    except OSError as error:
        raise UnusableAuditError(
            f"{path}: is damaged ({reason}) and cannot be set aside ({error.strerror}); move it away"
        ) from None
    return connect(path), f"{path}: is damaged ({reason}); it is set aside as {aside.name}, and a new one is begun"


def damage(path: Path) -> str:
    """What makes the file unusable as the database it was; "" if nothing does, or it is something else altogether."""
    if not path.is_file() or not path.stat().st_size:
        return ""
    deadline = time.monotonic() + LOOK_SECONDS
    try:
        with closing(sqlite3.connect(path, isolation_level=None, timeout=10.0)) as connection:
            mark = connection.execute("PRAGMA application_id").fetchone()[0]
            names = {str(row[0]) for row in connection.execute("SELECT name FROM sqlite_master")}
            ours = "audit_no_change" in names or "audit_in_order" in names
            if mark != APPLICATION_ID:
                return "its mark is gone" if ours else ""
            if "audit" not in names:
                return "its table is gone"
            connection.set_progress_handler(lambda: int(time.monotonic() > deadline), 10_000)
            found = str(connection.execute("PRAGMA quick_check(1)").fetchone()[0])
            return "" if found == "ok" else found.splitlines()[-1]
    except sqlite3.Error as error:
        # The low byte is the code, the rest says more (sqlite.org/rescode.html). An interrupted look has found nothing.
        damaged = (error.sqlite_errorcode or 0) & 0xFF in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
        return str(error) if damaged else ""
