"""Hash chains: files that were written before the chain had a module of its own verify as they did."""

from pathlib import Path

from gateway.commission.session.records import CommandRecord, append, find_break
from gateway.store.audit import AuditEntry, head, open_audit, verify
from gateway.store.chain import BEGIN, digest, first_break, sha256_hex

AUDIT = "1b5dd4b17891e76d1dcb8748a52605002a51a8e7c99ed92a54568734fdb52b23"
RECORDS = "a1bb554878644f20ffc4920b8cefc11ac846cf11f06b5cc2aa55de0992067616"
"""The newest hashes of the files below, as the code made them that wrote the first such files."""


def test_the_audit_logs_rows_are_bound_as_they_always_were(tmp_path: Path) -> None:
    path = tmp_path / "audit.sqlite"
    audit = open_audit(path)
    for number, kind in enumerate(("armed", "write", "disarmed")):
        detail = {"until": 1.7e9 + 60, "bad": float("nan"), "n": number}
        assert audit.record(AuditEntry(1.7e9 + number, kind, "Ada", "for the chain: µ", detail))
    audit.close()
    assert head(path) == AUDIT and verify(path, AUDIT).problem == ""


def test_the_records_lines_are_bound_as_they_always_were(tmp_path: Path) -> None:
    path, newest = tmp_path / "records.jsonl", ""
    for number in range(3):
        record = CommandRecord(
            time=1.7e9 + number,
            seconds=0.5,
            command="check",
            arguments={"n": number},
            place="here",
            code=0,
            reason="",
            result={"x": float("inf")},
            frames={},
            configuration={},
            versions={"python": "3"},
            who="Ada",
            machine="box",
        )
        newest = append(path, record)
    assert newest == RECORDS and find_break(path) is None
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(lines[0] + lines[1].replace(b'"code": 0', b'"code": 1') + lines[2])
    assert find_break(path) == 3, "the line after the one that was changed no longer follows it"
    path.write_bytes(lines[0] + lines[2])
    assert find_break(path) == 2


def test_a_row_is_bound_to_the_one_before_it() -> None:
    first = digest(BEGIN, b"a")
    assert digest(first, b"b") != digest(BEGIN, b"b") and digest(b"", b"a").hex() == sha256_hex(b"a")
    assert first_break([("", ""), ("x", "x"), ("x", "y"), ("z", "w")]) == 3 and first_break([]) is None
