"""A damaged audit log is set aside and a new one begun: the alarm does not wait for the account of the writes."""

import sqlite3
import time
from contextlib import closing
from pathlib import Path

from drivers.supervision import Supervisor
from gateway.store.audit import APPLICATION_ID, Audit, AuditError, open_audit
from gateway.store.durable import set_aside

LOOK_SECONDS = 2.0
"""The longest look for damage at a start (real time); what a longer one would find is found before an arming."""


def open_or_set_aside(path: Path, supervisor: Supervisor | None = None) -> tuple[Audit, str]:
    """The audit log at `path`, and the sentence that a damaged one was set aside ("" if none was). Raises AuditError.

    Nothing may be armed on the new one until the old one's head is acknowledged (`gateway.store.witness`).
    """
    reason = damage(path)
    if not reason:
        return open_audit(path, supervisor), ""
    try:
        aside = set_aside(path)
    except OSError as error:
        raise AuditError(
            f"{path}: is damaged ({reason}) and cannot be set aside ({error.strerror}); move it away"
        ) from None
    return open_audit(
        path, supervisor
    ), f"{path}: is damaged ({reason}); it is set aside as {aside.name}, and a new one is begun"


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
