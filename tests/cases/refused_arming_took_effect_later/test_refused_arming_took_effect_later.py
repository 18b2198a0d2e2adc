"""The disk was full, `arm` said "not armed", and the row was stored once there was room: armed after a restart.

And the reverse: a row that was stored was reported as not stored, since others behind it still waited.
"""

import asyncio
import sqlite3
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from drivers.supervision import Supervisor
from gateway.machine.writing.arming import ArmingError, arm, arm_in_log, sign_arming
from gateway.store.arming_rows import cancel_entry, find_arming, given_words
from gateway.store.audit import (
    ARMED,
    CANCELLED,
    DISARMED,
    LOST,
    MAX_WAITING_ROWS,
    Audit,
    AuditEntry,
    open_audit,
    read,
    verify,
)
from tests.gateway.support import EPOCH
from tests.gateway.test_writeback import armed

KEY = Ed25519PrivateKey.generate()
ENTRY = AuditEntry(EPOCH, ARMED, "Ada", "test", {"until": EPOCH + 600.0})
UNDO = cancel_entry(ENTRY, "nobody waits for it any more")


@contextmanager
def refusing(audit: Audit, busy_ms: int = 30) -> Iterator[None]:
    """Another process holds the log's write lock, as long as this lasts: nothing can be committed."""
    audit._connection.execute(f"PRAGMA busy_timeout = {busy_ms}")
    other = sqlite3.connect(audit.path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    try:
        yield
    finally:
        other.execute("ROLLBACK")
        other.close()


async def test_an_arming_that_was_refused_is_not_there_once_the_disk_takes_rows_again(tmp_path: Path) -> None:
    writer, wire = await armed()
    writer.mode, writer.arming, writer.audit = "shadow", None, open_audit(tmp_path / "audit.sqlite")
    with refusing(writer.audit), pytest.raises(ArmingError, match="does not take it"):
        await arm([writer], wire, by="Ada", reason="test", minutes=10, key=KEY)  # type: ignore[arg-type]
    assert not writer.armed
    assert writer.audit.record(AuditEntry(EPOCH, "write refused"))
    assert writer.audit.close()
    assert find_arming(writer.audit.path, EPOCH + 1.0) is None and not given_words(writer.audit.path)
    assert verify(writer.audit.path).problem == ""


@pytest.mark.parametrize("patience", [0.0, 0.02, 0.3])
def test_one_that_timed_out_is_withdrawn_at_whatever_moment_that_was(tmp_path: Path, patience: float) -> None:
    audit = open_audit(tmp_path / "audit.sqlite")
    with refusing(audit, busy_ms=100):
        assert not audit.record(ENTRY, patience, UNDO)
    assert audit.record(AuditEntry(EPOCH, "write")) and audit.close()
    assert not given_words(audit.path)


async def test_a_request_that_is_given_up_while_its_row_waits_arms_nobody(tmp_path: Path) -> None:
    audit = open_audit(tmp_path / "audit.sqlite")
    with refusing(audit, busy_ms=2000):
        task = asyncio.create_task(audit.stored(ENTRY, undo=UNDO))
        await asyncio.sleep(0.05)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
    assert audit.record(AuditEntry(EPOCH, "write")) and audit.close()
    assert not given_words(audit.path)


class SlowDisk(sqlite3.Connection):
    """Its commits take until they are let go."""

    begun: threading.Event
    go: threading.Event

    def __exit__(self, *reason: object) -> bool:
        self.begun.set()
        self.go.wait(60.0)
        return bool(super().__exit__(*reason))  # type: ignore[arg-type]


def on_slow_disk(path: Path) -> tuple[Audit, SlowDisk]:
    assert open_audit(path).close()
    disk = sqlite3.connect(path, isolation_level=None, check_same_thread=False, factory=SlowDisk)
    disk.begun, disk.go = threading.Event(), threading.Event()
    return Audit(path, disk, Supervisor()), disk


def test_one_whose_commit_was_under_way_is_cancelled_by_a_row_of_its_own(tmp_path: Path) -> None:
    audit, disk = on_slow_disk(tmp_path / "audit.sqlite")
    earlier = AuditEntry(EPOCH - 60.0, ARMED, "Bea", "before", {"until": EPOCH + 60.0})
    disk.go.set()
    assert audit.record(earlier)
    disk.go.clear()
    disk.begun.clear()
    assert not audit.record(ENTRY, 0.1, UNDO), "nobody can know it, so it must not count"
    disk.go.set()
    assert audit.close()
    kinds = [row.entry.kind for row in read(audit.path)]
    assert kinds == [ARMED, ARMED, CANCELLED]
    assert [row.entry.who for row in given_words(audit.path)] == ["Bea"], "what was in force before still is"


def test_a_stored_row_is_reported_as_stored_though_others_wait_behind_it(tmp_path: Path) -> None:
    audit, disk = on_slow_disk(tmp_path / "audit.sqlite")
    disk.go.set()
    stop = threading.Event()

    def crowd() -> None:
        while not stop.is_set():
            audit.put(AuditEntry(EPOCH, "write refused"))
            stop.wait(0.0002)

    thread = threading.Thread(target=crowd)
    thread.start()
    try:
        assert all(audit.record(AuditEntry(EPOCH + number, "write"), 5.0) for number in range(20))
    finally:
        stop.set()
        thread.join()
    audit.close()
    assert sum(row.entry.kind == "write" for row in read(audit.path)) == 20


def test_the_queue_is_bounded_and_says_what_it_gave_up(tmp_path: Path) -> None:
    audit = open_audit(tmp_path / "audit.sqlite")
    with refusing(audit):
        for number in range(MAX_WAITING_ROWS + 500):
            audit.put(AuditEntry(EPOCH + number, "write refused"))
        audit.put(AuditEntry(EPOCH, DISARMED, "Bea", "never given up"))
        assert audit.complaint and len(audit._waiting) <= MAX_WAITING_ROWS + 1 and audit.lost >= 500
        lost = audit.lost
    assert audit.record(AuditEntry(EPOCH, "write"), 10.0) and audit.close()
    rows = read(audit.path)
    assert [row.entry.detail["rows"] for row in rows if row.entry.kind == LOST] == [lost]
    assert sum(row.entry.kind == DISARMED for row in rows) == 1


def test_a_name_that_no_database_can_hold_ends_no_thread(tmp_path: Path) -> None:
    audit = open_audit(tmp_path / "audit.sqlite")
    assert audit.record(AuditEntry(EPOCH, "write", "Ada \ud800", "\udfff", {"name": "\ud800"}))
    with pytest.raises(ValueError, match="needs a time"):
        audit.put(AuditEntry(float("nan"), "write"))
    assert audit.record(AuditEntry(EPOCH, "write")) and audit.close()
    assert not audit.record(AuditEntry(EPOCH, "write")), "closed"
    assert verify(audit.path).rows == 2


def test_the_command_says_that_nothing_has_changed_and_nothing_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "audit.sqlite"
    assert open_audit(path).close()
    monkeypatch.setattr("gateway.store.audit.Audit.record", lambda audit, entry, timeout=0.05, undo=None: None)
    with pytest.raises(ArmingError, match="nothing has changed"):
        arm_in_log(path, sign_arming("Ada", "test", 5, EPOCH), EPOCH)
    assert not given_words(path)
