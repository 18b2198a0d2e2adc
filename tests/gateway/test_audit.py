"""The audit log: on the disk before it counts, only ever appended, and a row that was touched shows."""

import json
import sqlite3
import threading
from pathlib import Path

import pytest

from gateway.store.arming_rows import find_arming, given_words
from gateway.store.audit import (
    ARMED,
    DISARMED,
    EXPIRED,
    Audit,
    AuditEntry,
    AuditError,
    _columns,
    _insert,
    head,
    open_audit,
    read,
    verify,
)
from gateway.store.audit_damage import open_or_set_aside
from gateway.store.confirming import confirmation
from gateway.store.signing import key_path, load_or_make_key


def filled(path: Path, count: int = 20) -> Audit:
    audit = open_audit(path)
    for number in range(count):
        audit.put(AuditEntry(float(number), "write", "Ada", "", {"sequence": number, "words": "ab" * 48}))
    return audit


def test_entries_come_back_as_they_were_and_the_chain_is_whole(tmp_path: Path) -> None:
    audit = filled(tmp_path / "a.sqlite")
    assert audit.record(AuditEntry(20.5, "write failed", "Ada", "no reply – è", {"latency": float("nan")}))
    assert audit.close() and audit.close()
    rows = read(tmp_path / "a.sqlite")
    assert [row.entry.detail.get("sequence") for row in rows[:-1]] == list(range(20))
    assert rows[-1].entry == AuditEntry(20.5, "write failed", "Ada", "no reply – è", {"latency": None})
    verdict = verify(tmp_path / "a.sqlite")
    assert (verdict.rows, verdict.problem) == (21, "") and verdict.head == rows[-1].hash == head(tmp_path / "a.sqlite")
    assert [row.id for row in read(tmp_path / "a.sqlite", ["write failed"])] == [21]


def test_it_goes_on_in_the_same_file_and_several_writers_take_turns(tmp_path: Path) -> None:
    path = tmp_path / "a.sqlite"
    assert filled(path, 3).close()
    before = head(path)

    def one() -> None:
        assert filled(path, 50).close()

    threads = [threading.Thread(target=one) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert verify(path, before).rows == 153 and verify(path, before).problem == ""


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE audit SET who = 'Bea' WHERE id = 2",
        "DELETE FROM audit WHERE id = 20",
        "DELETE FROM audit",
        "INSERT OR REPLACE INTO audit VALUES (5, 1, 'write', '', '', '{}', x'00')",
        "INSERT INTO audit VALUES (900, 1, 'write', '', '', '{}', x'00')",
        "INSERT INTO audit VALUES (0, 1, 'write', '', '', '{}', x'00')",
    ],
)
def test_the_file_itself_refuses_to_be_changed(tmp_path: Path, statement: str) -> None:
    assert filled(tmp_path / "a.sqlite").close()
    with sqlite3.connect(tmp_path / "a.sqlite") as raw, pytest.raises(sqlite3.Error, match="only ever appended"):
        raw.execute(statement)
    raw.close()
    assert verify(tmp_path / "a.sqlite").problem == ""


@pytest.mark.parametrize(
    ("statement", "words"),
    [
        ("UPDATE audit SET who = 'Bea' WHERE id = 7", "row 7 was changed"),
        ("UPDATE audit SET time = time + 1e-6 WHERE id = 1", "row 1 was changed"),
        ("UPDATE audit SET detail = replace(detail, '3', '4') WHERE id = 4", "row 4 was changed"),
        ("UPDATE audit SET hash = zeroblob(32) WHERE id = 9", "row 9 was changed"),
        ("DELETE FROM audit WHERE id = 11", "row 11 is missing"),
        ("DELETE FROM audit WHERE id = 1", "row 1 is missing"),
    ],
)
def test_whoever_takes_the_triggers_away_first_leaves_a_trace(tmp_path: Path, statement: str, words: str) -> None:
    path = tmp_path / "a.sqlite"
    assert filled(path).close()
    raw = sqlite3.connect(path)
    for name in ("audit_no_change", "audit_no_loss", "audit_in_order"):
        raw.execute(f"DROP TRIGGER {name}")
    raw.execute(statement)
    raw.commit()
    raw.close()
    assert words in verify(path).problem


def test_an_end_that_was_cut_off_shows_by_the_hash_that_was_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.sqlite"
    assert filled(path).close()
    kept = head(path)
    raw = sqlite3.connect(path)
    raw.execute("DROP TRIGGER audit_no_loss")
    raw.execute("DELETE FROM audit WHERE id > 15")
    raw.commit()
    raw.close()
    assert verify(path).problem == "" and "the end is missing" in verify(path, kept).problem


def confirmed(audit: Audit, entry: AuditEntry) -> None:
    row = audit.record(entry)
    assert row is not None
    assert audit.record(confirmation(row, load_or_make_key(key_path(audit.path)), entry.time))


def test_only_the_newest_arming_counts_and_only_for_its_time(tmp_path: Path) -> None:
    path = tmp_path / "a.sqlite"
    assert find_arming(path, 0.0) is None and not given_words(path)
    audit = open_audit(path)
    confirmed(audit, AuditEntry(100.0, ARMED, "Ada", "first", {"until": 200.0}))
    assert find_arming(path, 150.0) is not None
    assert find_arming(path, 200.0) is None and find_arming(path, 99.0) is None
    audit.record(AuditEntry(160.0, "write refused", "Ada", "the PLC does not permit it"))
    assert find_arming(path, 170.0) is not None
    audit.record(AuditEntry(175.0, DISARMED, "Bea", "enough"))
    assert find_arming(path, 176.0) is None
    confirmed(audit, AuditEntry(180.0, ARMED, "Bea", "second", {"until": 300.0}))
    found = find_arming(path, 181.0)
    assert found is not None and found.entry.who == "Bea"
    audit.record(AuditEntry(181.0, EXPIRED, "Bea", "over"))
    assert find_arming(path, 182.0) is None
    assert audit.close()


def test_a_disk_that_does_not_take_it_is_complained_of_and_tried_again(tmp_path: Path) -> None:
    path = tmp_path / "a.sqlite"
    audit = open_audit(path)
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    audit._connection.execute("PRAGMA busy_timeout = 50")
    assert not audit.record(AuditEntry(1.0, "write"), timeout=0.5)
    assert "cannot be written" in audit.complaint
    other.execute("ROLLBACK")
    other.close()
    assert audit.record(AuditEntry(2.0, "write"), timeout=60.0) and audit.complaint == ""
    assert audit.close()
    assert [row.entry.time for row in read(path)] == [2.0], "what was reported as not stored is not stored later"


def test_a_file_that_is_no_audit_log_is_refused_in_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(AuditError, match="there is no audit log"):
        read(tmp_path / "none.sqlite")
    text = tmp_path / "text.sqlite"
    text.write_text("no database, but long enough to be looked at by anybody who reads it")
    with pytest.raises(AuditError, match=r"text\.sqlite: cannot be used"):
        open_audit(text)
    raw = sqlite3.connect(tmp_path / "other.sqlite")
    raw.execute("CREATE TABLE audit (id INTEGER)")
    raw.close()
    with pytest.raises(AuditError, match="database of something else"):
        open_audit(tmp_path / "other.sqlite")
    with pytest.raises(AuditError, match="database of something else"):
        verify(tmp_path / "other.sqlite")


def test_a_batch_is_stored_whole_or_not_at_all(tmp_path: Path) -> None:
    audit = open_audit(tmp_path / "a.sqlite")
    with pytest.raises(sqlite3.Error), audit._connection:
        audit._connection.execute("BEGIN IMMEDIATE")
        entries = [AuditEntry(1.0, "write"), AuditEntry(2.0, None)]  # type: ignore[arg-type]
        _insert(audit._connection, [(entry, _columns(entry)) for entry in entries])
    assert audit.close() and verify(tmp_path / "a.sqlite").rows == 0
    assert json.dumps(head(tmp_path / "a.sqlite")) == f'"{"00" * 32}"'


def test_a_log_of_no_bytes_is_not_begun_anew_without_a_word(tmp_path: Path) -> None:
    path = tmp_path / "audit.sqlite"
    path.touch()
    audit = open_or_set_aside(path)
    assert audit.note == f"{path}: was empty; a new one is begun, and its rows, if it had any, are gone"
    assert audit.record(AuditEntry(1.0, "write")) and audit.close()
    again = open_or_set_aside(path)
    assert again.note == "" and again.close()
