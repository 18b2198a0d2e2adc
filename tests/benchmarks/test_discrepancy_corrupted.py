"""Corruptions of small records: the same ones each time, and what is counted of them."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.discrepancy.corrupted.cases import CLASSES, DROPPED, RECORDS, CorruptedRecord, corruptions, write_model
from benchmarks.discrepancy.corrupted.contradictions import contradictions
from benchmarks.discrepancy.corrupted.figures import rows, tables
from benchmarks.discrepancy.corrupted.habits import FILINGS
from benchmarks.discrepancy.runner import Case, Outcome, by_call

HELD: dict[str, Any] = {
    "cycles": 2, "rmse_before": 0.3, "rmse_after": 0.3, "noise_floor": 0.2, "excess_removed": None, "ci95": None,
    "per_cycle": [{"before": 0.2, "after": 0.2, "noise_floor": 0.2}, {"before": 0.4, "after": 0.4, "noise_floor": 0.2}],
    "sentence": "2 cycles",
}  # fmt: skip
AGREES: dict[str, Any] = {
    "verdict": "agree", "effects": [], "held_out": HELD, "floor": {"value": 0.2, "interval": [0.1, 0.4]},
    "settings": {"sensor_sigma": 0.05}, "sentence": "Model and data agree within noise.", "reasons": [], "look_at": [],
    "untested": {}, "laws": [], "localisation": [], "unexplained": [], "parameter_shift": [], "material": False,
}  # fmt: skip
PUMP = AGREES | {
    "verdict": "named",
    "effects": [{"name": "pump-cooling", "class": ["pump-cooling"], "confidence": 0.97, "parameters": {"loss": 1e-4}}],
    "held_out": HELD | {"rmse_after": 0.25},
}


def test_a_diagnosis_that_holds_together_contradicts_nothing() -> None:
    assert contradictions(AGREES) == contradictions(PUMP) == []


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (AGREES | {"sentence": "The error is nan °C."}, "are no words"),
        (AGREES | {"reasons": ["shorter than 1.44e+03 s"]}, "are no words"),
        (AGREES | {"sentence": "Something is"}, "is no sentence"),
        (AGREES | {"settings": {"sensor_sigma": 0.05, "rough_sigma": None}}, "settings.rough_sigma is no number"),
        (AGREES | {"floor": {"value": 0.2, "interval": [0.1, 0.25]}}, "agrees at 0.3"),
        (AGREES | {"floor": {"value": 0.2, "interval": [0.25, 0.4]}}, "outside of its interval"),
        (AGREES | {"held_out": HELD | {"rmse_before": 0.5}}, "outside of its cycles'"),
        (AGREES | {"material": True}, "agrees with what is material"),
        (AGREES | {"verdict": "unexplained"}, "without a gap that matters"),
        (PUMP | {"effects": []}, "named with 0 names"),
        (PUMP | {"held_out": HELD}, "named with 0.3 after 0.3"),
        (PUMP | {"none_of_these": 0.1}, "more than certain"),
    ],
)
def test_what_contradicts_itself_is_told(found: dict[str, Any], words: str) -> None:
    assert any(words in each for each in contradictions(found))


def test_each_class_changes_each_record_the_same_way_each_time() -> None:
    wanted = list(corruptions(2, 7))
    assert [one.kind for one in wanted].count(DROPPED) == 7 and len(wanted) == 7 + 2 * (len(CLASSES) - 1)
    assert {one.record for one in wanted if one.kind == DROPPED} == set(RECORDS)
    assert len({one.name for one in wanted}) == len(wanted)
    assert [one.number for one in corruptions(1, 1, first=1000) if one.kind == DROPPED] == [1000]
    for one in corruptions(1, 1):
        if one.kind in FILINGS:
            continue
        made, again, whole = one.trace(), one.trace(), CorruptedRecord(one.record).trace()
        assert np.array_equal(made.times, again.times) and np.all(np.diff(made.times) >= 0)
        same = made.times.size == whole.times.size and np.array_equal(made.times, whole.times)
        alike = [np.array_equal(made.signals[name], whole.signals[name], equal_nan=True) for name in whole.signals]
        assert not (same and all(alike)), one
    lost = [CorruptedRecord("nothing missing", DROPPED, number).trace().times.size for number in range(20)]
    assert abs(1.0 - np.mean(lost) / CorruptedRecord("nothing missing").trace().times.size - 0.02) < 0.005


def test_a_record_is_diagnosed_from_the_file_that_a_plant_would_give(tmp_path: Path) -> None:
    one = CorruptedRecord("nothing missing", "rows repeated")
    write_model(tmp_path / "model.json")
    short = replace(one.trace().between(1.7e9, 1.7e9 + 43200.0), events=())
    one.write(tmp_path / "traces", short)
    found = by_call(Case(one.name, tmp_path / "traces", tmp_path / "model.json", seed=0), 600.0)
    assert (found.status, found.diagnosis["verdict"]) == ("done", "too-little-data"), found.message
    assert contradictions(found.diagnosis) == []


def test_rows_out_of_order_and_files_that_overlap_are_those_of_the_record(tmp_path: Path) -> None:
    whole = tmp_path / "whole"
    CorruptedRecord("nothing missing").write(whole)
    rows = (whole / "rows.csv").read_text(encoding="utf-8").splitlines()
    for kind in FILINGS:
        CorruptedRecord("nothing missing", kind, 1).write(tmp_path / kind)
        lines = [line for path in (tmp_path / kind).iterdir() for line in path.read_text(encoding="utf-8").splitlines()]
        assert set(lines) == set(rows) and lines != rows


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
