"""The records of all machines waited in one queue: one that flooded it while the disk stood had those of the others
dropped, and kept them from being written."""

import sqlite3
import threading
import time
from contextlib import closing
from pathlib import Path

import pytest

from gateway.store import open_historian, to_trace
from gateway.store.audit import (
    LOST,
    MAX_SUBJECT_ROWS_PER_COMMIT,
    MAX_WAITING_ROWS,
    AuditEntry,
    open_audit,
    read,
    verify,
)
from tests.gateway.support import EPOCH


def locked(path: Path) -> sqlite3.Connection:
    """A lock on a database: its disk stands."""
    connection = sqlite3.connect(path, isolation_level=None)
    connection.execute("BEGIN IMMEDIATE")
    return connection


def test_rows_of_the_historian_are_dropped_of_the_machine_that_floods(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gateway.store.historian.MAX_QUEUED_ROWS", 1_000)
    path = tmp_path / "h.sqlite"
    historian = open_historian(path)
    quiet, loud = historian.view("quiet"), historian.view("loud")
    quiet.put("scans", [(EPOCH, 0.0, 0)])
    assert historian.flush(60.0)
    with closing(locked(path)):
        quiet.put("scans", [(EPOCH + n, 0.0, 0) for n in range(1, 50)])
        for n in range(50):
            loud.put("scans", [(EPOCH + 100 * n + k, 0.0, 0) for k in range(100)])
        quiet.put("scans", [(EPOCH + n, 0.0, 0) for n in range(50, 100)])
    assert historian.flush(60.0)
    assert (quiet.dropped, quiet.complaint) == (0, "")
    assert loud.dropped == historian.dropped >= 3_900 and "were dropped" in loud.complaint
    assert historian.close()
    assert to_trace(path, machine="quiet").times.tolist() == [EPOCH + n for n in range(100)]
    assert to_trace(path, machine="loud").times[-1] == EPOCH + 4_999, "the newest are kept"


def test_a_flush_ends_though_other_machines_never_stop_to_put(tmp_path: Path) -> None:
    historian, stop = open_historian(tmp_path / "h.sqlite"), threading.Event()
    busy, one = historian.view("busy"), historian.view("one")

    def work() -> None:
        while not stop.wait(0.0002):
            busy.put("scans", [(EPOCH, 0.0, 0)])

    thread = threading.Thread(target=work)
    thread.start()
    try:
        one.put("alarms", [(EPOCH, "over limit", "T", 1, "normal", 81.0, "")])
        assert one.flush(60.0)
        with closing(sqlite3.connect(historian.path)) as connection:
            assert connection.execute("SELECT count(*) FROM alarms").fetchone() == (1,)
    finally:
        stop.set()
        thread.join()
        assert historian.close()


def test_entries_of_the_audit_log_are_given_up_of_the_subject_that_floods(tmp_path: Path) -> None:
    path = tmp_path / "audit.sqlite"
    audit = open_audit(path)
    with closing(locked(path)):
        for n in range(MAX_WAITING_ROWS + 70):
            audit.put(AuditEntry(EPOCH, "write refused", "", f"loud {n}").with_subject("loud"))
        for n in range(50):
            audit.put(AuditEntry(EPOCH, "write refused", "", f"quiet {n}").with_subject("quiet"))
        assert "entries wait for the disk" in audit.subject_complaint("loud") and audit.subject_complaint("quiet") == ""
    # It is tried once: a commit takes so many of the flood and no more.
    begin = time.monotonic()
    row = audit.record(AuditEntry(EPOCH, "write", "", "waited for").with_subject("quiet"), timeout=60.0)
    assert row is not None and row.id <= MAX_SUBJECT_ROWS_PER_COMMIT + 52 and time.monotonic() - begin < 60.0
    assert (
        audit.record(AuditEntry(EPOCH, "write", "", "the flood's own").with_subject("loud"), timeout=60.0) is not None
    )
    assert audit.close()
    rows = [row.entry for row in read(path)]
    assert [entry.reason for entry in rows if entry.subject == "quiet"] == [
        *(f"quiet {n}" for n in range(50)),
        "waited for",
    ]
    (lost,) = [entry for entry in rows if entry.kind == LOST]
    assert (lost.subject, lost.detail["rows"]) == ("loud", 70)
    loud = [entry.reason for entry in rows if entry.subject == "loud" and entry.kind != LOST]
    assert loud == [*(f"loud {n}" for n in range(MAX_WAITING_ROWS)), "the flood's own"], "in their order"
    assert verify(path).problem == ""


def test_many_writers_of_one_log_each_find_their_row(tmp_path: Path) -> None:
    path, failed = tmp_path / "audit.sqlite", list[str]()
    audit = open_audit(path)

    def work(subject: str) -> None:
        for n in range(20):
            row = audit.record(AuditEntry(EPOCH, "write", subject, str(n)).with_subject(subject), timeout=20.0)
            if row is None or (row.entry.subject, row.entry.reason) != (subject, str(n)):
                failed.append(f"{subject} {n}")

    threads = [threading.Thread(target=work, args=(f"machine {n}",)) for n in range(10)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert audit.close() and not failed
    rows = read(path)
    assert len(rows) == 200 and verify(path).problem == ""
    for n in range(10):
        assert [row.entry.reason for row in rows if row.entry.subject == f"machine {n}"] == [str(n) for n in range(20)]
