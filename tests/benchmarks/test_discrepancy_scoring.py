"""The blind benchmark's books: seeds, seal, runner with a stub in place of the tool, judging, scoring, report."""

import json
import sys
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.discrepancy.__main__ import main
from benchmarks.discrepancy.effects import EFFECTS
from benchmarks.discrepancy.generator import identifier
from benchmarks.discrepancy.judging import Answer, Judged, answer
from benchmarks.discrepancy.report import write_report
from benchmarks.discrepancy.runner import RESULTS, Outcome, by_call, by_process, case, outcomes, run_all
from benchmarks.discrepancy.scorer import Row, reliability, row, said, targets
from benchmarks.discrepancy.seal import COMMITMENT, Label, commit, committed, index, opened, write_labels
from benchmarks.discrepancy.strata import RATIOS, SETS, STRATA, TWINS, Spec, chosen, generator, specs

STUB = """
import json, pathlib, sys, time
given = dict(zip(sys.argv[2::1], sys.argv[3::1]))
out, seed = pathlib.Path(given["--out"]), int(given["--seed"])
pathlib.Path(given["--traces"]).with_name("calls").open("a").write("x")
if seed == 1:
    sys.exit("this case is refused")
if seed == 2:
    time.sleep(60)
out.mkdir(parents=True)
verdict = "nonsense" if seed == 3 else "agree"
(out / "diagnosis.json").write_text(json.dumps({"verdict": verdict, "effects": []}))
"""


def label(case: str = "c", stratum: str = "singles", effects: tuple[str, ...] = (), **other: Any) -> Label:
    spec = {"set": "development", "stratum": stratum, "number": 0, "effects": list(effects), "ratio": 3.0}
    spec |= {"rough": True, "moved": False, "learned": "before", "days": 4, "missing": [], "sampling": "regular"}
    spec |= {key: other.pop(key) for key in list(other) if key in spec}
    facts: dict[str, Any] = {"outside": (), "baseline_gap": 0.0, "sensor": 0.07, "floor": 0.2, "machine": "m"}
    ratios = {name: float(spec["ratio"]) for name in effects}
    return Label(case, spec, dict.fromkeys(effects, 1.0), ratios, **(facts | other))


def judged(what: Label, said_: Answer) -> Judged:
    return Judged(what, Outcome(what.case, "done", 1.0, {"verdict": said_.verdict}), said_)


def named(*names: str, confidence: float = 0.95, removed: float = 0.95) -> Answer:
    return Answer("named", names, (), confidence, removed)


def test_sets_have_cases_and_seeds_of_their_own() -> None:
    names = [identifier(spec) for set_ in SETS for spec in specs(set_, tuple(STRATA))]
    assert len(names) == len(set(names))
    draws = {float(generator(set_, "label", number).random()) for set_ in SETS for number in range(50)}
    assert len(draws) == 50 * len(SETS)


def test_the_same_number_is_always_the_same_case() -> None:
    assert specs("blind", ("pairs", "outside"), 5) == specs("blind", ("pairs", "outside"), 5)
    assert specs("blind", ("pairs",), 3, 5) == specs("blind", ("pairs",), 8)[5:]


def test_170_singles_hold_every_effect_at_every_ratio_on_both_kinds_of_plant() -> None:
    counts = Counter((spec.effects[0], spec.ratio, spec.rough) for spec in specs("development", ("singles",), 170))
    assert len(counts) == len(EFFECTS) * len(RATIOS) * 2
    assert set(counts.values()) == {1}


def test_the_full_benchmark_is_as_large_as_the_issue_demands() -> None:
    size = {name: stratum.size for name, stratum in STRATA.items()}
    assert size["clean-smooth"] + size["clean-rough"] >= 300
    singles = Counter((spec.effects[0], spec.ratio) for spec in specs("blind", ("singles",)))
    assert min(singles.values()) >= 5
    assert size["pairs"] >= 30 and size["outside"] >= 40


def test_no_pair_is_made_of_twins_and_current_heating_is_never_learned_from_the_same_traces() -> None:
    for spec in specs("development", tuple(STRATA)):
        assert frozenset(spec.effects) not in TWINS
        assert not ("current-heating" in spec.effects and (spec.learned == "same" or spec.base == "linear"))


def test_one_draw_more_for_one_purpose_changes_no_other() -> None:
    spec = Spec("development", "singles", 3)
    assert spec.generator("operation").random() != spec.generator("log").random()
    assert spec.generator("log").random() == spec.generator("log").random()


def test_strata_are_chosen_by_name_and_a_strange_one_is_refused() -> None:
    assert chosen("clean,singles,clean-rough") == ("clean-smooth", "clean-rough", "singles")
    with pytest.raises(ValueError, match="no stratum 'dirty'"):
        chosen("dirty")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Five cases whose seeds say how the stub behaves, with labels sealed."""
    for seed in range(5):
        case = tmp_path / "cases" / f"case{seed}"
        case.mkdir(parents=True)
        (case / "traces.csv").write_text("time\n", "utf-8")
        Label.write_config(case, {"traces": "traces.csv", "model": "models/m", "seed": seed})
    write_labels(tmp_path, "one", [label(f"case{n}", effects=("wear-drift",)) for n in range(3)])
    write_labels(tmp_path, "two", [label(f"case{n}", "clean-rough") for n in range(3, 5)])
    commit(tmp_path)
    (tmp_path / "stub.py").write_text(STUB, "utf-8")
    return tmp_path


def run_stub(folder: Path, **options: Any) -> dict[str, Outcome]:
    stub = by_process(f"{sys.executable} {folder / 'stub.py'}")
    return outcomes(run_all(folder, "stub", stub, jobs=1, **({"limit": 60.0} | options)))[1]


@pytest.mark.benchmark
def test_the_runner_keeps_what_the_tool_said_and_scores_failures_as_such(folder: Path) -> None:
    found = run_stub(folder, limit=6.0)
    assert [found[f"case{n}"].status for n in range(5)] == ["done", "error", "timeout", "error", "done"]
    assert "refused" in found["case1"].message and "nonsense" in found["case3"].message
    assert found["case4"].diagnosis["verdict"] == "agree" and found["case4"].seconds > 0


def test_a_limit_inside_the_process_is_no_error_of_the_command(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def patient(_words: object, **_options: object) -> None:
        try:
            time.sleep(60.0)
        except OSError:
            raise SystemExit(2) from None

    monkeypatch.setattr("gateway.cli.main.main", patient)
    assert by_call(case(folder, "case0"), 0.1).status == "timeout"


def test_a_finished_case_is_not_run_again_unless_it_failed_and_that_is_asked_for(folder: Path) -> None:
    run_stub(folder, only=("case0", "case1"))
    run_stub(folder, only=("case0", "case1"))
    run_stub(folder, only=("case0", "case1"), again=True)
    calls = [(folder / "cases" / f"case{n}" / "calls").read_text("utf-8") for n in (0, 1)]
    assert calls == ["x", "xx"]


def test_labels_open_only_under_the_hash_that_the_runs_were_made_under(folder: Path) -> None:
    before = committed(folder)
    assert set(opened(folder, before)) == set(index(folder)) == {f"case{n}" for n in range(5)}
    write_labels(folder, "one", [label(f"case{n}", effects=("dead-time",)) for n in range(3)])
    with pytest.raises(ValueError, match="not the labels"):
        opened(folder, before)


def test_the_cases_say_nothing_about_their_labels(folder: Path) -> None:
    open_words = "".join(path.read_text("utf-8") for path in folder.rglob("*.json")) + (folder / COMMITMENT).read_text()
    assert not any(name in open_words for name in (*EFFECTS, "clean", "rough"))
    assert all(b"wear-drift" not in path.read_bytes() for path in folder.rglob("*.gz"))


TRUTH = ("pump-cooling", "wear-drift")
PUMP, LAG = frozenset({"pump-cooling", "feed-temperature-coupling"}), frozenset({"dead-time", "sensor-lag"})


@pytest.mark.parametrize(
    ("said_", "exact", "in_class", "wrong", "first"),
    [
        (named(*TRUTH), True, True, False, False),
        (named("wear-drift"), False, False, False, False),
        (named("wear-drift", "dead-time"), False, False, True, False),
        (named("dead-time", *TRUTH), False, False, True, True),
        (Answer("class", ("wear-drift",), (PUMP,)), False, True, False, False),
        (Answer("class", (), (PUMP,)), False, False, False, False),
        (Answer("class", (), (LAG,)), False, False, True, True),
        (Answer("class", (), (PUMP, PUMP)), False, False, False, False),
        (Answer("unexplained"), False, False, False, False),
        (Answer("error"), False, False, False, False),
    ],
)
def test_an_answer_is_judged_by_the_truth(said_: Answer, exact: bool, in_class: bool, wrong: bool, first: bool) -> None:
    one = judged(label(effects=TRUTH), said_)
    assert (one.exact, one.in_class, one.wrong, one.wrong_first) == (exact, in_class, wrong, first)


def test_an_effect_whose_signal_was_not_recorded_has_no_right_name() -> None:
    one = judged(label(effects=("ambient-coupling",), missing=["TAmbiente"]), named("ambient-coupling"))
    assert one.nameless and one.wrong and not one.exact


def test_a_name_with_a_class_of_several_counts_as_a_name_only_under_the_verdict_named() -> None:
    effect = {"name": "dead-time", "class": ["dead-time", "sensor-lag"], "confidence": 0.9}
    by_class = answer(Outcome("c", "done", 1.0, {"verdict": "class", "effects": [effect]}))
    assert by_class.names == () and by_class.classes == (LAG,)
    assert answer(Outcome("c", "done", 1.0, {"verdict": "named", "effects": [effect]})).names == ("dead-time",)
    assert not answer(Outcome("c", "timeout", 1.0)).claims


def test_the_excess_by_the_true_floor_is_the_variance_form_of_the_design() -> None:
    said_ = replace(named("wear-drift", removed=float("nan")), errors=(0.61, 0.22))
    one = judged(label(effects=("wear-drift",)), said_)
    assert one.removed == pytest.approx(1 - (0.22**2 - 0.2**2) / (0.61**2 - 0.2**2))


def test_a_share_has_its_exact_interval_and_says_whether_its_target_was_met() -> None:
    nothing = Row("names something", 0, 124, (0.0, 0.01))
    assert nothing.verdict == "met" and nothing.interval[1] == pytest.approx(0.0293, abs=1e-4)
    assert Row("exact", 60, 100, (0.9, 1.0)).verdict == "MISSED"
    assert Row("exact", 8, 10, (0.9, 1.0)).verdict == "MISSED (within the interval)"
    assert Row("exact", 0, 0, (0.9, 1.0)).verdict == "not measured"
    assert Row("too sure", 100, 100, (0.93, 0.97)).verdict.startswith("MISSED")


def test_each_target_counts_its_own_cases() -> None:
    cases = [
        judged(label("a", effects=("wear-drift",), ratio=1.0), named("wear-drift")),
        judged(label("b", effects=("wear-drift",), ratio=1.0), named("dead-time", removed=float("nan"))),
        judged(label("c", effects=("wear-drift",), ratio=1.0, rough=False), Answer("agree")),
        judged(label("d", "clean-rough"), named("wear-drift", confidence=0.5)),
        judged(label("e", "clean-smooth"), Answer("agree")),
        judged(label("f", "clean-smooth", baseline_gap=0.5), named("wear-drift", confidence=0.5)),
        judged(label("g", "outside", ("belt-slip",), outside=("belt-slip",)), Answer("unexplained")),
    ]
    rows = {one.name: (one.hits, one.cases) for one in targets(cases)}
    assert rows["names something where nothing is missing"] == (1, 2)
    assert rows["wrong first name, effect in the catalogue"] == (1, 3)
    assert rows["exact at signal-to-noise 1, rough plant"] == (1, 2)
    assert rows["exact at signal-to-noise 1, smooth plant"] == (0, 1)
    assert rows["outside the catalogue: a wrong name"] == (0, 1)
    assert rows["outside, visible: unexplained"] == (1, 1)
    assert rows["rightly named: >= 90 % of the excess removed"] == (1, 1)
    assert rows["stated 95 % confidence is right"] == (1, 2)
    assert said(cases[-1]) == "unexplained"


def test_a_ratio_that_was_not_reached_does_not_count_at_that_ratio() -> None:
    short = replace(label(effects=("radiation-loss",)), ratios={"radiation-loss": 2.0})
    assert np.isnan(judged(short, Answer("agree")).ratio)


def test_reliability_sets_stated_confidence_against_what_was_right() -> None:
    cases = [judged(label(str(n), effects=("wear-drift",)), named("wear-drift", confidence=0.96)) for n in range(3)]
    cases.append(judged(label("x", effects=("wear-drift",)), named("dead-time", confidence=0.96)))
    (one,) = reliability(cases)
    assert one.stated == pytest.approx(0.96) and (one.right.hits, one.right.cases) == (3, 4)
    assert row("all", cases, lambda each: each.exact).share == 0.75


@pytest.mark.benchmark
def test_the_report_has_table_figures_and_picture_and_marks_what_was_missed(folder: Path) -> None:
    run_stub(folder, only=("case0", "case1", "case3", "case4"))
    words = write_report(folder, "stub", folder / "score")
    assert "MISSED" in words and "not measured" in words and committed(folder) in words
    figures = json.loads((folder / "score" / "figures.json").read_text("utf-8"))
    errors = next(one for one in figures["tools"]["stub"]["further"] if one["name"] == "errors")
    assert (errors["hits"], errors["cases"]) == (2, 4)
    assert (folder / "score" / "picture.png").read_bytes().startswith(b"\x89PNG")


def test_scoring_without_results_and_running_without_cases_say_what_is_missing(tmp_path: Path, folder: Path) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    told = CliRunner().invoke(main, ["run", str(empty)])
    assert told.exit_code == 1 and "make the cases first" in told.output
    told = CliRunner().invoke(main, ["score", str(folder), "--name", "nobody"])
    assert told.exit_code == 1 and "run the cases first" in told.output
    assert not (folder / RESULTS / "nobody").exists()


def test_the_command_explains_itself() -> None:
    told = CliRunner().invoke(main, ["--help"])
    assert told.exit_code == 0
    assert all(name in told.output for name in ("generate", "run", "rivals", "score"))
