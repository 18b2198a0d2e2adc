"""Corruptions of small records: the same ones each time, and what is counted of them."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.discrepancy.corrupted.cases import CLASSES, DROPPED, RECORDS, CorruptedRecord, corruptions, write_model
from benchmarks.discrepancy.corrupted.figures import rows, tables
from benchmarks.discrepancy.runner import Case, Outcome, by_call

AGREES = {"verdict": "agree", "effects": []}
PUMP = {"verdict": "named", "effects": [{"name": "pump-cooling", "class": ["pump-cooling"]}]}


def test_each_class_changes_each_record_the_same_way_each_time() -> None:
    wanted = list(corruptions(2, 7))
    assert [one.kind for one in wanted].count(DROPPED) == 7 and len(wanted) == 7 + 2 * (len(CLASSES) - 1)
    assert {one.record for one in wanted if one.kind == DROPPED} == set(RECORDS)
    assert len({one.name for one in wanted}) == len(wanted)
    for one in corruptions(1, 1):
        made, again, whole = one.trace(), one.trace(), CorruptedRecord(one.record).trace()
        assert np.array_equal(made.times, again.times) and np.all(np.diff(made.times) >= 0)
        same = made.times.size == whole.times.size and np.array_equal(made.times, whole.times)
        assert not (same and np.array_equal(made.signals["T"], whole.signals["T"], equal_nan=True)), one
    lost = [CorruptedRecord("nothing missing", DROPPED, number).trace().times.size for number in range(20)]
    assert abs(1.0 - np.mean(lost) / CorruptedRecord("nothing missing").trace().times.size - 0.02) < 0.005


def test_a_record_is_diagnosed_from_the_file_that_a_plant_would_give(tmp_path: Path) -> None:
    one = CorruptedRecord("nothing missing", "rows repeated")
    write_model(tmp_path / "model.json")
    short = replace(one.trace().between(1.7e9, 1.7e9 + 43200.0), events=())
    one.write(tmp_path / "rows.csv", short)
    found = by_call(Case(one.name, tmp_path / "rows.csv", tmp_path / "model.json", seed=0), 600.0)
    assert (found.status, found.diagnosis["verdict"]) == ("done", "too-little-data"), found.message


def test_changed_verdicts_names_refusals_and_faults_are_counted_apart() -> None:
    first, second = tuple(RECORDS)[:2]
    late, gaps = "rows three times as late", "gaps"
    said = {
        CorruptedRecord(first): Outcome("a", "done", 1.0, AGREES),
        CorruptedRecord(second): Outcome("b", "done", 1.0, PUMP),
        CorruptedRecord(first, DROPPED, 0): Outcome("c", "done", 1.0, AGREES),
        CorruptedRecord(second, DROPPED, 1): Outcome("d", "done", 1.0, AGREES),
        CorruptedRecord(first, late, 0): Outcome("e", "error", 1.0, message="SystemExit: 2 decanter: 7 rows at 3"),
        CorruptedRecord(second, late, 1): Outcome("f", "done", 1.0, PUMP),
        CorruptedRecord(first, gaps, 0): Outcome("g", "error", 1.0, message="SystemExit: 1 decanter: a fault"),
        CorruptedRecord(second, gaps, 1): Outcome("h", "timeout", 9.0, message="over 9 s"),
    }
    found = {one.name: (one.hits, one.cases) for one in rows(said)}
    assert found["internal errors"] == (2, 6) and found["refused in a sentence"] == (1, 6)
    assert found[f"{DROPPED}: verdict and first name unchanged"] == (1, 2)
    assert found[f"{late}: verdict and first name unchanged"] == (1, 1)
    assert found[f"{gaps}: verdict and first name unchanged"] == (0, 2)
    printed = tables(said, every=True)
    assert "N rows at N" in printed and "agree" in printed
