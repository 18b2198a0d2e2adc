"""Until when an arming lasts, and whose confirmation counts: by rows that are written out here."""

from pathlib import Path

import pytest

from gateway.store import AuditEntry, AuditRow, confirmation, load_or_make_key, open_audit
from gateway.store.arming_rows import (
    Uptime,
    armed_subjects,
    arming_end,
    armings,
    cancel_entry,
    end_reason,
    find_arming,
    given_words,
)
from gateway.store.audit import ARMED, CONFIRMED, DISARMED, EXPIRED
from tests.gateway.support import EPOCH

END = EPOCH + 300.0
DETAIL = {"until": END, "boot": "this one", "uptime": 1000.0, "speed": 2.0}


def armed(who: str = "Ada", time: float = EPOCH, **more: object) -> AuditEntry:
    return AuditEntry(time, ARMED, who, "run", {**DETAIL, **more})


def written(path: Path, *entries: AuditEntry) -> list[AuditRow]:
    log = open_audit(path)
    rows = [row for entry in entries if (row := log.record(entry)) is not None]
    assert log.close() and len(rows) == len(entries)
    return rows


def test_an_arming_lasts_until_its_time_by_either_count(tmp_path: Path) -> None:
    path = tmp_path / "audit.sqlite"
    (row,) = written(path, armed())
    assert [end_reason(path, row, now) for now in (EPOCH, END - 0.5, END)] == ["", "", "its time is over"]
    # A second of the machine's own count is two of the plant's here.
    own = "its time is over by the machine's own count, whatever the clock says"
    for spent, why in ((0.0, ""), (149.5, ""), (150.0, own), (900.0, own)):
        assert end_reason(path, row, EPOCH, Uptime("this one", 1000.0 + spent)) == why
        assert end_reason(path, row, EPOCH, Uptime("another", 1000.0 + spent)) == "" == end_reason(path, row, EPOCH)
        assert end_reason(path, row, EPOCH, Uptime("", 1000.0 + spent)) == ""
    assert arming_end(row, EPOCH + 10.0, Uptime("this one", 1050.0)) == EPOCH + 10.0 + 300.0 - 100.0
    assert arming_end(row, EPOCH + 250.0, Uptime("this one", 1050.0)) == END, "never later than its time"
    assert arming_end(row, EPOCH, Uptime("another", 9000.0)) == END


def test_rows_of_before_say_nothing_of_the_machines_count(tmp_path: Path) -> None:
    detail = {"until": END, "boot": "this one"}
    (row,) = written(tmp_path / "audit.sqlite", AuditEntry(EPOCH, ARMED, "Ada", "run", detail))
    assert arming_end(row, EPOCH, Uptime("this one", 5.0)) == END
    (row,) = written(tmp_path / "other.sqlite", AuditEntry(EPOCH, ARMED, "Ada", "run", {**detail, "uptime": 5.0}))
    assert arming_end(row, EPOCH, Uptime("this one", 65.0)) == EPOCH + 240.0, "at the clock's own pace"


def test_a_clock_that_stands_before_what_is_on_record_tells_no_time(tmp_path: Path) -> None:
    path = tmp_path / "audit.sqlite"
    row, _ = written(path, armed(), AuditEntry(EPOCH + 20.0, "write"))
    assert end_reason(path, row, EPOCH + 20.0) == ""
    why = "the clock stands 2.5 s before the newest record, so that its time cannot be told"
    assert end_reason(path, row, EPOCH + 17.5) == why


def test_a_confirmation_counts_for_its_row_and_subject_and_by_the_gateways_key(tmp_path: Path) -> None:
    path, key = tmp_path / "audit.sqlite", tmp_path / "elsewhere.key"
    first, second = written(path, armed().with_subject("two"), armed("Bea"))
    signing = load_or_make_key(key)

    def counts(subject: str) -> list[str]:
        return [row.entry.who for row in armings(path, key, subject=subject)]

    assert counts("two") == [] == counts("")
    written(path, confirmation(first, signing, EPOCH).with_subject("one"))
    assert counts("two") == [], "said of another subject"
    written(path, confirmation(second, load_or_make_key(tmp_path / "another.key"), EPOCH))
    assert counts("") == []
    (confirming,) = written(path, confirmation(first, signing, EPOCH + 1.0))
    assert counts("two") == ["Ada"] and counts("") == []
    assert find_arming(path, EPOCH + 2.0, key=key, subject="two") is not None
    assert find_arming(path, EPOCH + 2.0, subject="two") is None, "no key lies beside the log"
    assert (confirming.entry.time, confirming.entry.kind, confirming.entry.subject) == (EPOCH + 1.0, CONFIRMED, "two")
    assert confirming.entry.reason == f"row {first.id} (armed) counts" and confirming.entry.who == "Ada"
    assert (confirming.entry.detail["row"], confirming.entry.detail["hash"]) == (first.id, first.hash)
    assert armed_subjects(path) == ["two", "", "one"]
    key.unlink()
    assert counts("two") == [], "nor is there any without the key"


def test_words_are_the_newest_first_and_those_taken_back_are_none(tmp_path: Path) -> None:
    path = tmp_path / "audit.sqlite"
    signing = load_or_make_key(tmp_path / "key")
    entries = [armed(), AuditEntry(EPOCH + 1.0, DISARMED, "Bea"), armed("Cai", EPOCH + 2.0), armed("Dan", EPOCH + 3.0)]
    rows = written(path, *entries, AuditEntry(EPOCH + 4.0, EXPIRED, "Dan"))

    def words() -> list[str]:
        return [f"{row.entry.kind} {row.entry.who}" for row in given_words(path)]

    all_of_them = [f"{EXPIRED} Dan", f"{ARMED} Dan", f"{ARMED} Cai", f"{DISARMED} Bea", f"{ARMED} Ada"]
    assert words() == all_of_them
    undone = cancel_entry(entries[2], "late")
    assert (undone.time, undone.who, undone.reason) == (EPOCH + 2.0, "Cai", "late")
    assert undone.detail == {"armed": EPOCH + 2.0, "until": END}
    assert cancel_entry(armed().with_subject("two"), "late").subject == "two"
    for changed in ({"armed": EPOCH}, {"until": END + 1.0}):
        written(path, AuditEntry(undone.time, undone.kind, "Cai", "late", {**undone.detail, **changed}))
    written(path, AuditEntry(undone.time, undone.kind, "Eve", "late", undone.detail), undone.with_subject("two"))
    assert words() == all_of_them, "of another moment, end, person or subject"
    written(path, undone)
    assert words() == [word for word in all_of_them if not word.endswith("Cai")]
    written(path, confirmation(rows[2], signing, EPOCH))
    assert words() == all_of_them, "what was confirmed was in force"


@pytest.mark.parametrize("kind", [ARMED, DISARMED, EXPIRED])
def test_only_an_arming_stands(kind: str, tmp_path: Path) -> None:
    path, key = tmp_path / "audit.sqlite", tmp_path / "key"
    signing = load_or_make_key(key)
    (row,) = written(path, armed())
    written(path, confirmation(row, signing, EPOCH))
    found = find_arming(path, EPOCH + 1.0, key=key)
    assert found is not None and found.id == row.id
    if kind != ARMED:
        written(path, AuditEntry(EPOCH + 1.0, kind, "Bea"))
        assert find_arming(path, EPOCH + 1.0, key=key) is None
    assert find_arming(path, END, key=key) is None
    assert find_arming(path, EPOCH + 1.0, Uptime("this one", 1150.0), key=key) is None
