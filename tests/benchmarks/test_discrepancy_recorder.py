"""The benchmark's recorder: its habits, the plant behind it, what begins half-way, and the judge who knows it all."""

import ast
import gzip
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from benchmarks.discrepancy.judging import Answer, Judged, answer
from benchmarks.discrepancy.recorder import cases, masses
from benchmarks.discrepancy.recorder.actors import ACTORS, BEGINNING, HALF_WAY, INSIDE, LATE, OUTSIDE, begin_at
from benchmarks.discrepancy.recorder.baseline import cut_cells
from benchmarks.discrepancy.recorder.cases import (
    STRATA,
    RecorderSpec,
    draw_case,
    machine_of_type,
    make,
    read_verdicts,
    specs,
    write_verdicts,
)
from benchmarks.discrepancy.recorder.figures import began_at, dates_gap, describes, tables
from benchmarks.discrepancy.recorder.habits import HABITS, LATE_INTERVALS, Habit, Rows, record, write_rows
from benchmarks.discrepancy.recorder.held_out import count_fitted, measure_removal
from benchmarks.discrepancy.recorder.ideal import Candidate, Removal, Verdict
from benchmarks.discrepancy.recorder.masses import Guest, Task, integrate, unrest_of
from benchmarks.discrepancy.recorder.work import STEP, Work, work
from benchmarks.discrepancy.runner import Outcome, case
from benchmarks.discrepancy.seal import Label, commit, labels_of, write_labels
from benchmarks.discrepancy.visible import Family
from sim.effects import EFFECTS
from sim.lab.discrepancy.rules import RULES

ROOM = Path(masses.__file__).parent
STARTS = [3600.0 * hour for hour in (6, 10, 14, 18, 30, 34)]


def test_the_recorders_plant_shares_no_code_with_what_it_tests() -> None:
    for name in ("work", "masses", "actors", "habits", "baseline", "ideal", "held_out"):
        tree = ast.parse((ROOM / f"{name}.py").read_text(encoding="utf-8"))
        froms = {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
        assert not [one for one in froms if one.split(".")[0] in ("sim", "gateway", "drivers")], name


def test_what_acts_is_named_as_the_catalogue_names_it() -> None:
    assert set(INSIDE) <= set(EFFECTS)
    assert not {*OUTSIDE, *BEGINNING} & {*EFFECTS, LATE}
    assert set(HALF_WAY) <= set(ACTORS)
    assert all(actor.words for actor in OUTSIDE.values())


def test_every_stratum_meets_every_recorder_and_each_number_is_one_case() -> None:
    every = [spec for stratum in STRATA for spec in specs("final", stratum, range(64))]
    assert len({spec.identifier for spec in every}) == len(every)
    assert every == [spec for stratum in STRATA for spec in specs("final", stratum, range(64))]
    for stratum in STRATA:
        assert {spec.habit for spec in every if spec.stratum == stratum} == set(HABITS)
    assert {(spec.acts[0], spec.ratio) for spec in every if spec.stratum == "singles"} == {
        (name, ratio) for name in INSIDE for ratio in (1.5, 3.0)
    }
    assert all((spec.share > 0) == (spec.stratum == "half-way") for spec in every)
    with pytest.raises(ValueError, match="there is no stratum 'dirty'"):
        specs("final", "dirty", range(1))


@pytest.fixture(scope="module")
def day() -> Work:
    return work(np.random.default_rng(1), 1)


def kept_by(day: Work, habit: Habit) -> Rows:
    course = np.linspace(20.0, 60.0, day.running.size)
    return record(np.random.default_rng(2), course, habit)


def test_a_row_comes_early_or_late_by_its_jitter_and_now_and_then_three_intervals_later(day: Work) -> None:
    apart = np.diff(kept_by(day, Habit(jitter=0.4)).times) / 10.0
    assert 0.6 <= apart.min() < 0.7 and 1.3 < apart.max() <= 1.4
    apart = np.diff(kept_by(day, Habit(late=0.02)).times) / 10.0
    assert set(np.round(apart).astype(int)) >= {1, LATE_INTERVALS}
    assert 0.01 < np.mean(apart > 2.5) < 0.04


def test_rows_are_missing_doubled_blank_and_coarse_as_the_habit_says(day: Work) -> None:
    usual = day.running.size * STEP / 20.0
    lossy = kept_by(day, replace(HABITS["lossy"], gaps=0.0))
    assert 0.94 < lossy.times.size / usual < 0.98
    assert 0.004 < np.mean(np.diff(lossy.times) == 0) < 0.02
    assert 0.004 < np.mean(np.isnan(lossy.reading)) < 0.02
    assert np.diff(kept_by(day, replace(HABITS["lossy"], gaps=4.0)).times).max() > 240.0
    coarse = kept_by(day, HABITS["coarse"]).reading
    assert np.allclose(coarse / 0.5, np.round(coarse / 0.5))


def test_one_record_has_rows_of_several_periods_and_a_clock_that_is_set(day: Work) -> None:
    apart = np.diff(kept_by(day, replace(HABITS["mixed"], jitter=0.0, missing=0.0)).times)
    assert len(set(np.round(apart))) >= 3
    rows = kept_by(day, replace(HABITS["set"], settings=3.0, doubled=0.0))
    off = rows.stated - rows.times
    assert off[0] == 0.0 and 5.0 <= np.abs(np.diff(off)).max() <= 240.0


def test_a_file_a_day_says_what_one_file_says_and_a_repeated_row_is_the_row_before_it(
    day: Work, tmp_path: Path
) -> None:
    rows = kept_by(day, replace(HABITS["set"], settings=0.0, doubled=0.2))
    write_rows(tmp_path / "days", day, rows, HABITS["set"], np.random.default_rng(3))
    write_rows(tmp_path / "one.csv", day, rows, replace(HABITS["set"], daily=False), np.random.default_rng(3))
    whole = pd.read_csv(tmp_path / "one.csv", comment="#")
    parts = [pd.read_csv(path, comment="#") for path in sorted((tmp_path / "days").glob("*.csv"))]
    pd.testing.assert_frame_equal(whole, pd.concat(parts, ignore_index=True))
    assert whole.duplicated("time").sum() == whole.duplicated().sum() > 100


def settle(day: Work, guest: Guest, load: float = 250.0) -> tuple[float, masses.Machine]:
    held = replace(day, running=np.ones(day.running.size), load=np.full(day.running.size, load), starts=(0,))
    machine = machine_of_type("fresh", "line-0")
    return float(integrate([Task(work=held, machine=machine, guest=guest, unrest=0.0 * held.running)])[0][-1]), machine


def test_at_a_steady_load_the_machine_settles_where_its_constants_say(day: Work) -> None:
    reached, machine = settle(day, Guest())
    above = machine.heats[2] + 250.0 * machine.slope
    assert reached == pytest.approx(machine.hall + above, abs=1e-6)
    cooled, _ = settle(day, Guest(cooling=machine.running, sink=10.0))  # as much again, towards 10 degC
    assert cooled == pytest.approx((machine.hall + above + 10.0) / 2.0, abs=1e-6)
    assert settle(day, Guest(late=60.0, winding=200.0, lag=90.0))[0] == pytest.approx(reached, abs=1e-3)


def test_what_begins_half_way_does_nothing_before_and_a_state_cannot_begin(day: Work) -> None:
    at = (np.arange(day.running.size) > 9000).astype(float)
    machine = machine_of_type("fresh", "steps-0")
    guests = [ACTORS[name].make(day, machine, 1.0, np.random.default_rng(4)) for name in HALF_WAY]
    tasks = [Task(work=day, machine=machine, guest=begin_at(one, at), unrest=0.0 * at) for one in guests]
    without, *courses = integrate([Task(work=day, machine=machine, guest=Guest(), unrest=0.0 * at), *tasks])
    for course in courses:
        assert np.array_equal(course[:9001], without[:9001])
        assert np.abs(course - without).max() > 0.1
    with pytest.raises(ValueError, match="cannot begin half-way"):
        begin_at(Guest(lag=10.0), at)


def spec_of(stratum: str, number: int, **other: Any) -> RecorderSpec:
    return replace(specs("fresh", stratum, [number])[0], days=1, **other)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Verdict], list[RecorderSpec]]:
    """A strong single, a clean case and one that begins half-way, of a day each, with a model that nobody learned."""
    wanted = [
        spec_of("singles", 3, ratio=6.0, habit="uneven"),
        spec_of("clean", 0, habit="all"),
        spec_of("half-way", 0, ratio=6.0, habit="set"),
    ]
    out = tmp_path_factory.mktemp("recorder")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cases, "learn_type", lambda *_: Family((0, 1, 1, 1, 1), (-1, -1, 0, 0, 0)))
        labels, verdicts = make(wanted, out)
    write_labels(out, "made", labels)
    commit(out)
    return out, verdicts, wanted


def test_a_case_is_written_and_its_truth_is_sealed(
    made: tuple[Path, dict[str, Verdict], list[RecorderSpec]],
) -> None:
    out, _, (strong, clean, half) = made
    labels = labels_of(out)
    assert set(labels) == {strong.identifier, clean.identifier, half.identifier}
    assert labels[strong.identifier].ratio == pytest.approx(6.0, rel=0.15)
    assert labels[strong.identifier].truth == {"torque-friction"} and not labels[clean.identifier].truth
    assert labels[half.identifier].outside == ("exchanged-bearing",)
    began = labels[half.identifier].spec["began"]
    assert began["before"] + began["after"] == len(began["starts"]) == 4
    assert began["starts"][began["before"] - 1] < began["time"] < began["starts"][began["before"]]
    for name in labels:
        assert case(out, name).traces.exists()
        words = (out / "cases" / name / "case.json").read_text("utf-8")
        assert not any(told in words for told in ("torque", "clean", "half", "exchanged"))
    assert all(b"torque" not in path.read_bytes() for path in out.rglob("*.gz"))


def test_the_ideal_judge_knows_a_strong_effect_and_none_where_nothing_acts(
    made: tuple[Path, dict[str, Verdict], list[RecorderSpec]],
) -> None:
    _, verdicts, (strong, clean, _) = made
    assert verdicts[strong.identifier].knowable and verdicts[strong.identifier].rival != "torque-friction"
    assert not verdicts[clean.identifier].visible
    assert verdicts[clean.identifier].rival_nats < 14.0
    assert verdicts[strong.identifier].removal and not verdicts[clean.identifier].removal


def removed_of(days: Work, actor: str, *, rough: float, scatter: float) -> float:
    """The share that a fit with the true form removes of what an actor makes of a machine so restless."""
    machine = replace(machine_of_type("development", "line-1"), rough=rough, scatter=scatter)
    guest = ACTORS[actor].make(days, machine, 0.4, np.random.default_rng(5))
    unrest = unrest_of(np.random.default_rng(6), days, machine)
    acting = Task(work=days, machine=machine, guest=guest, unrest=0.0 * unrest)
    clean, quiet, course = integrate([replace(acting, guest=Guest()), acting, replace(acting, unrest=unrest)])
    habit = Habit(noise=0.01, quantum=0.01)
    removal = measure_removal(
        cut_cells(days, Family((0, 1, 1, 1, 1), (-1, -1, 0, 0, 0)), 1.0),
        machine,
        habit,
        record(np.random.default_rng(7), course, habit),
        course=course,
        quiet=quiet,
        clean=clean,
        true=[Candidate(name=actor, difference=quiet - clean)],
    )
    held_out = slice(days.starts[count_fitted(len(days.starts))], None)
    assert removal
    floor = np.hypot(habit.sigma, np.sqrt(np.mean((course - quiet)[held_out] ** 2)))
    return removal.share(float(floor))


def test_a_fit_with_the_true_form_removes_what_the_noise_lets_it(day: Work) -> None:
    assert removed_of(day, "torque-friction", rough=0.0, scatter=0.0) == pytest.approx(1.0, abs=0.01)
    assert removed_of(day, "torque-friction", rough=0.1, scatter=0.05) < 0.5


def test_the_cycles_that_a_tool_fits_are_fitted_and_no_others() -> None:
    kept = [max(round((1.0 - RULES.held_out_share) * cycles), RULES.least_cycles - 1) for cycles in range(4, 41)]
    assert [count_fitted(cycles) for cycles in range(4, 41)] == kept


def judged(stratum: str, said: dict[str, Any], *, acts: tuple[str, ...] = (), began: Any = None) -> Judged:
    spec = {
        "stratum": stratum, "number": 0, "acts": acts, "effects": acts, "ratio": 3.0 if acts else 0.0, "missing": (),
        "habit": "tidy", "law": "line", "learned": "other", "rough": True, "began": began, "days": 4,
    }  # fmt: skip
    outside = tuple(name for name in acts if name not in INSIDE)
    label = Label("c", spec, {}, dict.fromkeys(acts, 3.0), outside, 0.0, 0.1, 0.2, "m")
    outcome = Outcome("c", "done" if said else "error", 1.0, said, "" if said else "ValueError: shapes (12,) (13,)")
    return Judged(label, outcome, answer(outcome))


@pytest.mark.parametrize(
    ("began", "dated"),
    [
        ({"time": 12.0 * 3600}, True),  # in the rest before the third cycle, which is the first that has it
        ({"time": STARTS[2]}, True),
        ({"time": STARTS[3] + 60.0}, True),  # at the row that shows the fourth start: one cycle late
        ({"time": STARTS[3] + 600.0}, False),
        ({"time": STARTS[1]}, True),
        ({"time": STARTS[0]}, False),
        ({"time": None}, False),
        (None, False),
    ],
)
def test_a_beginning_is_dated_by_its_cycle_and_may_be_absent(began: Any, dated: bool) -> None:
    truth = {"time": 12.5 * 3600, "before": 2, "after": 4, "starts": STARTS}
    said = {"verdict": "unexplained", "began": began}
    one = judged("half-way", said, acts=("summer",), began=truth)
    assert dates_gap(one) == dated
    assert (began_at(one) is None) == (not began or began["time"] is None)


def test_a_description_counts_where_it_is_true_and_where_it_stands() -> None:
    sentence = "heat in the same hours of every day"
    assert describes(judged("outside", {"verdict": "unexplained", "sentence": sentence}, acts=("hour-of-day",)))
    assert not describes(judged("outside", {"verdict": "unexplained", "sentence": sentence}, acts=("fading-grease",)))
    assert not describes(judged("outside", {"verdict": "agree", "sentence": sentence}, acts=("hour-of-day",)))
    assert not describes(judged("outside", {"verdict": "unexplained", "reasons": [sentence]}, acts=("hour-of-day",)))
    law = {"sentence": "38 % goes with the torque; to find out: rest for a night"}
    assert not describes(judged("outside", {"verdict": "unexplained", "laws": [law]}, acts=("hour-of-day",)))


def test_the_table_says_what_was_found_of_what_could_be_known_and_each_error_in_its_words() -> None:
    known = {"c": Verdict(nats=90.0, margin=30.0, rival="wear-drift", rival_nats=60.0)}
    effect = {"name": "torque-friction", "class": ["torque-friction"], "confidence": 0.97}
    right = judged("singles", {"verdict": "named", "effects": [effect]}, acts=("torque-friction",))
    failed = judged("singles", {}, acts=("torque-friction",))
    words = tables([right, failed], known, every=True)
    assert "| singles at 3: exact | >= 90 % | 50.0 % |" in words
    assert "| internal errors | <= 0 % | 50.0 % |" in words
    assert "| singles: of these, exact |  | 50.0 % |" in words
    assert "ValueError: shapes (12,) (13,)" in words
    assert "90, margin 30 over wear-drift" in words
    assert "| the same by an ideal judge: not computed |  | - |" in words


def test_the_table_says_what_an_ideal_judge_removes_of_all_and_of_what_was_rightly_named() -> None:
    effect = {"name": "torque-friction", "class": ["torque-friction"], "confidence": 0.97}
    right = judged("singles", {"verdict": "named", "effects": [effect]}, acts=("torque-friction",))
    missed = replace(right, label=replace(right.label, case="d"), answer=Answer("agree"))
    without = replace(missed, label=replace(right.label, case="e"))
    known = Verdict(nats=90.0, margin=30.0, rival="wear-drift", rival_nats=60.0)
    floor = right.label.floor
    removed = [(3.0 * floor, 1.3 * floor), (3.0 * floor, 2.0 * floor), (0.9 * floor, floor)]
    verdicts = {
        case: replace(known, removal=Removal(before=before, after=after))
        for case, (before, after) in zip("cde", removed, strict=True)
    }
    words = tables([right, missed, without], verdicts)
    assert "| the same by an ideal judge |  | 100.0 % | 2.5-100.0 | 1/1 |" in words
    assert "| all singles, pairs and late: the same by an ideal judge |  | 50.0 % | 1.3-98.7 | 1/2 |" in words
    assert "not computed" not in words


def test_what_an_ideal_judge_said_is_read_as_it_was_written_and_older_files_too(tmp_path: Path) -> None:
    verdict = Verdict(nats=90.0, margin=30.0, rival="wear-drift", rival_nats=60.0)
    said = {"c": replace(verdict, removal=Removal(before=0.4, after=0.2)), "d": verdict}
    write_verdicts(tmp_path, "some", said)
    assert read_verdicts(tmp_path) == said
    path = tmp_path / "ideal" / "some.json.gz"
    older = {"c": {"nats": 90.0, "margin": 30.0, "rival": "wear-drift", "rival_nats": 60.0}}
    path.write_bytes(gzip.compress(json.dumps(older).encode()))
    assert read_verdicts(tmp_path) == {"c": verdict}


def test_the_same_spec_is_the_same_case() -> None:
    one, other = draw_case(spec_of("pairs", 1)), draw_case(spec_of("pairs", 1))
    assert one.machine == other.machine and np.array_equal(one.work.load, other.work.load)
    assert json.dumps(one.spec.effects) == json.dumps(other.spec.effects)
