"""The search: it finds known settings, resumes as if never stopped, and refuses studies of something else."""

import os
import shutil
import signal
import sqlite3
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sim.lab.judge.free_run import score_fold
from sim.lab.tuning import methods as tuning_methods
from sim.lab.tuning import study
from sim.lab.tuning.methods import ANY_CHOICE, METHODS, Choice, Real, Task, Whole, find_method, tuned_alphabet
from sim.lab.tuning.search import StudyPlan, StudyTrial, Tuning, final_model, folds, summary, tune, usable
from sim.plant.scenarios import scenario
from sim.sha.events import DECANTER, Bins
from sim.sha.trace import Trace
from tests.validation.places import ROOT
from tests.validation.tuning_plant import ALPHABET, relaxing, relaxing_method, traces

PLAN = StudyPlan("bins")


@pytest.fixture
def known(monkeypatch: pytest.MonkeyPatch) -> None:
    """The method `bins` is one whose best settings are known."""
    monkeypatch.setattr(tuning_methods, "METHODS", {**METHODS, "bins": relaxing_method()})


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[object, ...]]:
    """Twelve trials of the known method in one go: what every other way to twelve trials must come to."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tuning_methods, "METHODS", {**METHODS, "bins": relaxing_method()})
        return told(search(tmp_path_factory.mktemp("whole") / "s.db", 12))


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study of the known method with its first trial, to be copied."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tuning_methods, "METHODS", {**METHODS, "bins": relaxing_method()})
        file = tmp_path_factory.mktemp("begun") / "s.db"
        search(file, 1)
    return file


def search(
    file: Path, trials: int = 12, plan: StudyPlan = PLAN, given: list[Trace] | None = None, **more: object
) -> Tuning:
    return tune(given or traces(), ALPHABET, "T", plan, file, trials=trials, **more)


def short(trace: Trace) -> Trace:
    """The first three minutes."""
    return trace.between(trace.times[0], trace.times[0] + 180.0)


def told(found: Tuning) -> list[tuple[object, ...]]:
    """All of the trials but how long they took."""
    return [
        (one.number, dict(one.settings), one.state, one.value, one.by_trace, one.reason)
        if one.state == "complete"
        else (one.number, dict(one.settings), one.state, one.reason)
        for one in found.trials
    ]


@pytest.mark.usefixtures("known")
def test_the_search_finds_the_known_target_and_says_that_it_beats_the_defaults(tmp_path: Path) -> None:
    found = search(tmp_path / "s.db", trials=20)
    assert found.best is not None and found.default is not None and found.gain is not None
    assert float(found.best.settings["target"]) == pytest.approx(50.0, abs=8.0)
    assert found.default.number == 0 and not found.default.settings
    assert found.better and found.gain.n == 6
    differences = [found.default.by_trace[name] - value for name, value in found.best.by_trace.items()]
    assert found.gain.mean == pytest.approx(np.mean(differences))
    assert found.gain.error == pytest.approx(np.std(differences, ddof=1) / np.sqrt(6))
    assert "are better than the defaults" in found.sentence
    failed = [one for one in found.trials if one.state == "failed"]
    assert failed and all(one.reason == "a broken kind teaches nothing" for one in failed)


@pytest.mark.usefixtures("known")
def test_a_grid_tries_each_of_its_points_once_and_ends(tmp_path: Path) -> None:
    plan = StudyPlan("bins", search="grid")
    search(tmp_path / "s.db", 3, plan)
    found = search(tmp_path / "s.db", 50, plan)
    points = {(each.settings["target"], each.settings["kind"]) for each in found.trials[1:]}
    assert points == {(target, kind) for target in (0.0, 50.0, 100.0) for kind in ("good", "broken")}
    assert len(found.trials) == 7 and found.notes == ("the grid has 6 points: all are tried, and the defaults",)
    assert found.best is not None and found.best.settings["target"] == 50.0
    with pytest.raises(ValueError, match=r"another search \(search: grid then, tpe now\)"):
        search(tmp_path / "s.db", 8)


@pytest.mark.usefixtures("known")
def test_evolution_crosses_what_was_best_and_is_the_same_in_parts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sim.lab.tuning.study.MIN_TRIALS_TO_PRUNE", 2)  # generations of four
    plan, few = StudyPlan("bins", search="evolutionary", fold_count=2), traces()[:2]
    whole = search(tmp_path / "whole.db", 26, plan, few)
    search(tmp_path / "parts.db", 13, plan, few)
    assert told(search(tmp_path / "parts.db", 26, plan, few)) == told(whole)
    # What cannot be learned dies out, and a child has a parent's setting, which no draw would give again.
    failed = [each.number for each in whole.trials if each.state == "failed"]
    assert sum(number <= 13 for number in failed) > sum(number > 13 for number in failed)
    targets = [each.settings["target"] for each in whole.trials[1:]]
    assert len(set(targets)) < len(targets) and whole.best is not None and whole.best.value < whole.default.value


@pytest.mark.parametrize(("lead", "better"), [(0.9, False), (1.1, True)])
def test_a_lead_within_its_standard_error_is_none(lead: float, better: bool) -> None:
    """Four traces whose differences have the standard error 1 about a mean of so many of them."""
    apart = np.array([-1.0, -1.0, 1.0, 1.0]) * np.sqrt(3.0)
    values = {"defaults": np.full(4, 9.0), "best": 9.0 - lead - apart}
    trials = [
        StudyTrial(
            number=number,
            settings={"target": 1.0} if number else {},
            state="complete",
            value=float(each.mean()),
            by_trace={str(trace): float(value) for trace, value in enumerate(each)},
        )
        for number, each in enumerate(values.values())
    ]
    found = summary(trials)
    assert found.gain is not None and found.gain.error == pytest.approx(1.0) and found.gain.mean == pytest.approx(lead)
    assert found.better is better and ("not better" in found.sentence) is not better


@pytest.mark.usefixtures("known")
def test_both_objectives_are_means_over_traces_of_means_over_readings(tmp_path: Path) -> None:
    model = relaxing(Task((), ALPHABET, "T", 0), {}).model
    scores = [score_fold(model, one) for one in traces()]
    crps = search(tmp_path / "c.db", 1).default
    likelihood = search(tmp_path / "l.db", 1, StudyPlan("bins", "likelihood")).default
    assert crps is not None and likelihood is not None
    assert crps.value == pytest.approx(np.mean([one.crps for one in scores]))
    assert likelihood.value == pytest.approx(-np.mean([one.log_likelihood for one in scores]))
    assert scores[0].readings == 29  # the run starts at the first of 30 readings, which is no prediction


@pytest.mark.usefixtures("known")
def test_a_study_that_is_gone_on_with_is_the_same_as_one_that_never_stopped(
    tmp_path: Path, whole: list[tuple[object, ...]]
) -> None:
    for trials in (1, 4, 12):
        parts = search(tmp_path / "parts.db", trials)
    assert told(parts) == whole
    assert told(search(tmp_path / "other.db", 3, StudyPlan("bins", seed=1))) != whole[:3]


@pytest.mark.usefixtures("known")
def test_a_killed_search_goes_on_as_if_it_had_not_been_killed(tmp_path: Path, whole: list[tuple[object, ...]]) -> None:
    file = tmp_path / "killed.db"
    command = [sys.executable, "-m", "tests.validation.tuning_line", str(file), "12", "2"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for trial in ("trial 3 ", "trial 5 "):
            searching = int(process.stdout.readline())
            while not (line := process.stdout.readline()).startswith(trial):
                assert line and not line.startswith("ended")
            os.kill(searching, signal.SIGKILL)
            while not line.startswith("ended"):
                line = process.stdout.readline()
                assert line
            assert line == f"ended with {-signal.SIGKILL}\n"
    found = search(file, 12)
    assert told(found) == whole
    with sqlite3.connect(file) as database:
        states = [row[0] for row in database.execute("SELECT state FROM trials ORDER BY number")]
    database.close()
    assert len(states) > 12, "no trial was met running"
    assert "RUNNING" not in states


@pytest.mark.usefixtures("known")
def test_control_c_leaves_a_study_that_goes_on(tmp_path: Path, whole: list[tuple[object, ...]]) -> None:
    def stop(what: str, _share: float) -> None:
        if what.startswith("trial 4 "):
            raise KeyboardInterrupt

    found = search(tmp_path / "s.db", 12, progress=stop)
    assert found.stopped and len(found.trials) == 3
    assert told(search(tmp_path / "s.db", 6)) == whole[:6]


@pytest.mark.usefixtures("known")
def test_control_c_while_a_trial_is_written_waits_until_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, whole: list[tuple[object, ...]]
) -> None:
    storage = pytest.importorskip("optuna.storages").RDBStorage
    write = storage.set_trial_state_values

    def pressed(*given: object, **named: object) -> object:
        monkeypatch.setattr(storage, "set_trial_state_values", write)
        signal.raise_signal(signal.SIGINT)
        return write(*given, **named)

    monkeypatch.setattr(storage, "set_trial_state_values", pressed)
    found = search(tmp_path / "s.db", 3)
    assert found.stopped and [one.state for one in found.trials] == ["complete"]
    assert told(search(tmp_path / "s.db", 3)) == whole[:3]


@pytest.mark.usefixtures("known")
def test_pruning_gives_bad_trials_up_and_keeps_the_best(tmp_path: Path) -> None:
    found = search(tmp_path / "s.db", 16, prune=True)
    pruned = [one for one in found.trials if one.state == "pruned"]
    assert pruned and all(one.reason.startswith("given up after") for one in pruned)
    assert found.best is not None and found.best.by_trace is not None and len(found.best.by_trace) == 6


@pytest.mark.usefixtures("known")
def test_the_search_is_the_same_with_one_worker_and_with_two(tmp_path: Path, whole: list[tuple[object, ...]]) -> None:
    assert told(search(tmp_path / "two.db", 5, jobs=2)) == whole[:5]


def test_bins_learns_by_the_settings_and_the_final_model_says_them() -> None:
    given = [short(scenario("cd3"))]
    trial = StudyTrial(
        number=7,
        settings={"flow": "constant", "rates": "shared", "hysteresis": 0.1, "debounce": 4.0},
        state="complete",
        value=1.5,
        error=0.5,
    )
    taught = final_model(given, DECANTER, "TCuscinettiRiduttore", PLAN, trial, "final")
    origin = taught.model.provenance
    assert (origin.settings["flow"], origin.settings["rates"], origin.settings["tuned_debounce"]) == (
        "constant",
        "shared",
        4.0,
    )
    assert (origin.scores["tuning_crps"], origin.traces) == (1.5, ("cd3",))
    assert taught.model.alphabet == tuned_alphabet(DECANTER, trial.settings)


@pytest.mark.usefixtures("known")
@pytest.mark.parametrize(
    ("plan", "count", "words"),
    [
        (PLAN, 5, "another data"),
        (StudyPlan("bins", seed=3), 6, r"another seed \(seed: 0 then, 3 now\)"),
        (StudyPlan("bins", "likelihood"), 6, "another objective"),
        (StudyPlan("bins", fold_count=3), 6, "another number of folds"),
        (StudyPlan("lsha"), 6, "another method and another search space"),
    ],
)
def test_a_study_of_something_else_is_refused(
    tmp_path: Path, begun: Path, plan: StudyPlan, count: int, words: str
) -> None:
    shutil.copy(begun, tmp_path / "s.db")
    with pytest.raises(ValueError, match=words):
        search(tmp_path / "s.db", 2, plan, traces(count))
    assert len(search(tmp_path / "s.db", 2).trials) == 2  # and nothing was spoilt


@pytest.mark.usefixtures("known")
def test_other_files_are_refused_and_left_as_they_are(tmp_path: Path) -> None:
    text, database = tmp_path / "notes.txt", tmp_path / "historian.db"
    text.write_text("hello " * 100, encoding="utf-8")
    connection = sqlite3.connect(database)
    connection.execute("CREATE TABLE samples (tag, value)")
    connection.commit()
    connection.close()
    before = database.read_bytes()
    with pytest.raises(ValueError, match=r"notes\.txt: is no study"):
        search(text)
    with pytest.raises(ValueError, match="is a database, but no study"):
        search(database)
    assert database.read_bytes() == before
    with pytest.raises(ValueError, match="is no study"):
        search(tmp_path)


@pytest.mark.usefixtures("known")
def test_two_searches_do_not_write_to_one_study(tmp_path: Path) -> None:
    file = tmp_path / "s.db"
    with study.open_study(file, {}, prune=False), pytest.raises(ValueError, match="another process is working"):
        search(file)


def test_without_optuna_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study, "find_spec", lambda _name: None)
    with pytest.raises(ValueError, match=r"pip install 'decanter-gateway\[tune\]'"):
        search(tmp_path / "s.db")


@pytest.mark.usefixtures("known")
def test_where_nothing_can_be_learned_the_learners_own_sentence_is_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tuning_methods, "METHODS", METHODS)
    found = search(tmp_path / "s.db", 2)
    assert found.best is None
    assert found.sentence.startswith("no trial was completed: ")


def test_traces_are_held_out_whole_each_once_and_in_an_order_of_their_own() -> None:
    for count, wanted in ((17, 5), (3, 5), (2, 2)):
        parts = folds(count, wanted, seed=4)
        assert sorted(place for part in parts for place in part) == list(range(count))
        assert len(parts) == min(count, wanted)
        assert max(map(len, parts)) - min(map(len, parts)) <= 1
        assert parts == folds(count, wanted, seed=4)
    assert folds(17, 5, seed=4) != folds(17, 5, seed=5)
    with pytest.raises(ValueError, match="needs 2 traces and 2 folds at least; there are 1 usable"):
        folds(1, 5, 0)


def test_copies_and_traces_without_the_temperature_are_left_out_and_equal_names_told_apart() -> None:
    first, second, third = traces(3)
    cold = Trace("cold", np.arange(3.0), {"other": np.ones(3)})
    kept, notes, digest = usable([third, first, replace(first, name="t9"), cold, replace(second, name="t0")], "T")
    assert sorted(one.name for one in kept) == ["t0", "t0 #2", "t2"]
    assert notes == ("cold is left out: it has 0 readings of 'T'", "1 copy is left out")
    assert digest == usable([replace(second, name="t0"), first, third], "T")[2]


def test_hysteresis_and_debounce_are_raised_and_never_lowered() -> None:
    tuned = tuned_alphabet(DECANTER, {"hysteresis": 0.2, "debounce": 3.0})
    assert [one.hysteresis for one in tuned.channels if isinstance(one, Bins)] == [20.0]
    assert tuned.debounce == 3.0
    assert tuned_alphabet(tuned, {"hysteresis": 0.1, "debounce": 1.0}) == tuned
    assert tuned_alphabet(DECANTER, {}) == DECANTER


def test_every_method_has_a_searchable_space_and_an_unknown_one_is_refused() -> None:
    for method in METHODS.values():
        names = [one.name for one in method.space]
        assert names and len(set(names)) == len(names)
        for one in method.space:
            assert len(one.options) > 1 if isinstance(one, Choice) else one.low < one.high
        assert {type(one) for one in method.space} <= {Real, Whole, Choice}
    assert ANY_CHOICE in METHODS["bins"].space[0].options
    with pytest.raises(ValueError, match="'magic' cannot be tuned; known are bins, lsha"):
        find_method("magic")
