"""`model regress`: every result once, and what became worse, with models and programs that were made worse."""

import json
import os
import shutil
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gateway.lab.regression import history as history_module
from gateway.lab.regression.commands import regress
from gateway.lab.regression.history import open_history
from gateway.lab.regression.standard import CodeVersion, checkout_commit, code_version
from gateway.lab.regression.worse import WorseForecast, find_regressions
from sim.artefacts import promote
from sim.lab.formats import save, write_model_directory
from sim.lab.recordings import write_trace
from sim.sha import Distribution
from tests.cli.support import decanter, only_object, refused
from tests.gateway.support import two_modes
from tests.skill.test_forecasts_along import measured


@pytest.fixture(scope="module")
def traces(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two short traces of the two modes, as a list in TOML."""
    folder = tmp_path_factory.mktemp("standard")
    for seed in (5, 6):
        write_trace(replace(measured(430.0, seed=seed), name=f"t{seed}"), folder / f"t{seed}.csv")
    (folder / "standard.toml").write_text('map = "decanter"\ntraces = ["t5.csv", "t*.csv"]\n', encoding="utf-8")
    return folder


def misled() -> Any:
    """The two modes with a target that no trace has."""
    model = two_modes()
    law = Distribution("normal", {"mu": 90.0, "sigma": 1.0})
    places = tuple(replace(each, distribution=law) if each.name == "on" else each for each in model.sha.locations)
    return replace(model, sha=replace(model.sha, locations=places))


def run(models: Path, traces: Path, *options: object) -> tuple[int, dict[str, Any]]:
    standard = ("--standard", traces / "standard.toml", "--history", models.parent / "history.jsonl")
    done = decanter("model", "judge", "regression", models, *standard, *options, "--json")
    return done.exit_code, only_object(done.stdout)


def test_a_model_that_was_learned_worse_is_told_since_when_until_somebody_accepts_it(
    traces: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    models, asked = tmp_path / "models", list[str]()
    real: Callable[..., Any] = history_module.score_trace

    def counted(trace: Any, *arguments: Any, **options: Any) -> Any:
        asked.append(trace.name)
        return real(trace, *arguments, **options)

    monkeypatch.setattr(history_module, "score_trace", counted)
    write_model_directory(models / "a", two_modes())
    code, data = run(models, traces)
    assert (code, data["worse"], asked) == (0, [], ["t5", "t6"])
    assert [(row["horizon (s)"], row["traces"]) for row in data["results"]] == [(60.0, 2), (300.0, 2)]
    assert run(models, traces)[0] == 0 and len(asked) == 2
    shutil.rmtree(models / "a")
    write_model_directory(models / "a", misled())
    code, data = run(models, traces)
    assert code == 1 and len(data["worse"]) == 2
    assert data["worse"][0].startswith("models/a: worse at 60 s since 20")
    assert "(model " in data["worse"][0] and "program" not in data["worse"][0]
    assert run(models, traces)[0] == 1 and len(asked) == 4
    code, data = run(models, traces, "--accept", "another product")
    assert code == 0 and len(data["worse"]) == 2
    shown = decanter(
        "model", "judge", "regression", models, "--standard", traces, "--history", tmp_path / "history.jsonl"
    )
    assert (shown.exit_code, len(asked)) == (0, 4)
    assert "standard set, 2 traces, CRPS in °C, program" in " ".join(shown.stdout.split())
    assert shown.stdout.endswith(f"nothing became worse; history: {tmp_path / 'history.jsonl'}\n")


def test_of_a_store_each_version_and_the_promoted_one_are_subjects(traces: Path, tmp_path: Path) -> None:
    store = tmp_path / "store"
    first = save(store, two_modes(), created=0.0)
    promote(store, first)
    code, data = run(store, traces)
    assert code == 0 and {row["model"] for row in data["results"]} == {"store", f"store@{first}"}


def scored(crps: float) -> list[dict[str, Any]]:
    figures = {"forecasts": 9, "mae": crps, "coverage": 0.9}
    return [{"horizon": 60.0, "method": method, "crps": crps, **figures} for method in ("present", "persistence")]


def regressions(path: Path, programs: Mapping[str, list[float | str]], accepted: str = "") -> list[WorseForecast | str]:
    """What a history says in which each program had these CRPS (or that reason) along traces 0, 1, ..."""
    with open_history(path) as history:
        for number, (code, figures) in enumerate(programs.items()):
            for trace, figure in enumerate(figures):
                row = {"kind": "result", "model": "m", "trace": str(trace), "code": code, "seed": 0}
                said = figure if isinstance(figure, str) else ""
                scores = [] if isinstance(figure, str) else scored(figure)
                history.add({**row, "trace_name": f"t{trace}", "scores": scores, "failed": said})
            named = [str(trace) for trace in range(len(figures))]
            about = {"kind": "run", "when": f"day {number}", "code": code, "code_name": f"1.{number}", "seed": 0}
            history.add({**about, "models": {"a": "m"}, "traces": named})
            if code == accepted:
                history.add({"kind": "accepted", "when": "then", "reason": "wanted"})
        return find_regressions("a", history, seed=0)


def test_the_first_program_that_was_worse_ever_since_is_named(tmp_path: Path) -> None:
    programs: dict[str, list[float | str]] = {
        "p0": [1.0, 2.0],
        "p1": [0.9, 1.8],  # the best
        "p2": [1.5, 1.8],  # worse, then mended
        "p3": [0.9, 1.81],
        "p4": [0.9, 2.5],
        "p5": [0.9, 2.4],
    }
    (found,) = regressions(tmp_path / "h.jsonl", programs)
    assert isinstance(found, WorseForecast)
    assert (found.best["code"], found.since["code"], found.worst_trace) == ("p1", "p4", "t1")
    assert found.sentence("degC") == (
        "a: worse at 60 s since day 4 (program 1.4, before 1.1): CRPS 1.65 °C, before 1.35, on 2 traces "
        "(p 1), most of all on t1"
    )
    assert regressions(tmp_path / "accepted.jsonl", programs, accepted="p5") == []
    assert regressions(tmp_path / "mended.jsonl", dict(list(programs.items())[:4])) == []


def test_runs_are_compared_on_the_traces_of_both_and_a_failure_is_told(tmp_path: Path) -> None:
    # A harder trace that came to the set makes no run worse; nor does one of hundred degrees that went.
    assert regressions(tmp_path / "more.jsonl", {"p0": [1.0], "p1": [1.0, 50.0]}) == []
    assert regressions(tmp_path / "less.jsonl", {"p0": [1.0, 0.1], "p1": [1.0]}) == []
    found = regressions(tmp_path / "failed.jsonl", {"p0": [1.0, 1.0], "p1": [1.0, "it lacks Load"]})
    assert found == ["a: has no forecast along t1 any more: it lacks Load"]
    assert regressions(tmp_path / "never.jsonl", {"p0": [1.0, "it lacks Load"], "p1": [1.0, "it lacks Load"]}) == []
    # What a test tells apart and nobody would act on: half a per cent on ten traces.
    slight = {"p0": [1.0 + 0.01 * n for n in range(10)], "p1": [1.005 + 0.01005 * n for n in range(10)]}
    assert regressions(tmp_path / "slight.jsonl", slight) == []
    clear = {"p0": slight["p0"], "p1": [1.03 * figure for figure in slight["p0"]]}
    (told,) = regressions(tmp_path / "clear.jsonl", clear)
    assert isinstance(told, WorseForecast) and told.comparison.p < 0.05


def test_the_program_has_a_name_and_another_source_another_hash(monkeypatch: pytest.MonkeyPatch) -> None:
    now = code_version()
    assert isinstance(now, CodeVersion) and len(now.content) == 64 and now.release in str(now)
    monkeypatch.setattr("gateway.lab.regression.standard.code_hash", lambda floor: floor)
    assert code_version().content != now.content


def test_wrong_input_has_one_sentence(traces: Path, tmp_path: Path) -> None:
    write_model_directory(tmp_path / "m", two_modes())
    listing, history = tmp_path / "standard.toml", tmp_path / "history.jsonl"
    call = ("model", "judge", "regression", tmp_path / "m", "--standard", listing, "--history", history)
    for text, sentence in (
        ("traces = []", 'traces: is no list of paths; write traces = ["cycles/*.csv"]'),
        ('traces = ["a.csv"]\nmaps = "x"', "maps: is no key of a standard set"),
        ('traces = ["a.csv"]\nmap = 1', "map: is no name"),
        ("traces = [", "cannot be read as a list of traces"),
        ('traces = ["none/*.csv"]', "no file is of this pattern"),
    ):
        listing.write_text(text, encoding="utf-8")
        refused(decanter(*call), 2, sentence)
    listing.write_text(f'traces = ["{traces}/t5.csv"]', encoding="utf-8")
    (tmp_path / "none").mkdir()
    refused(decanter("model", "judge", "regression", tmp_path / "none", *call[4:]), 2, "has no model in it")
    history.write_text('{"kind": "other"}\n', encoding="utf-8")
    refused(decanter(*call), 2, "history.jsonl:1: is no row of a history of regressions")
    history.write_text("", encoding="utf-8")
    with open_history(history):
        refused(decanter(*call), 2, "another process is writing this history")
    assert regress.name == "regress"


def two_models(models: Path) -> Path:
    write_model_directory(models / "a", two_modes())
    write_model_directory(models / "b", replace(two_modes(), sensor_sigma=0.2))
    return models


def worsened(model: Path) -> None:
    shutil.rmtree(model)
    write_model_directory(model, misled())


def test_what_is_accepted_is_the_models_and_the_seed_of_that_run(traces: Path, tmp_path: Path) -> None:
    models = two_models(tmp_path / "models")
    history = ("--standard", traces, "--history", tmp_path / "history.jsonl")
    assert run(models, traces)[0] == 0 and run(models, traces, "--seed", 1)[0] == 0
    worsened(models / "a")
    worsened(models / "b")
    accepted = decanter("model", "judge", "regression", models / "a", *history, "--accept", "another product", "--json")
    assert accepted.exit_code == 0
    row = opened_rows(tmp_path / "history.jsonl")[-1]
    assert (row["kind"], row["models"], row["seed"]) == ("accepted", ["models/a"], 0)
    code, data = run(models, traces)
    assert code == 1 and {each.partition(":")[0] for each in data["worse"]} == {"models/b"}
    code, data = run(models, traces, "--seed", 1)
    assert code == 1 and {each.partition(":")[0] for each in data["worse"]} == {"models/a", "models/b"}


def opened_rows(path: Path) -> list[dict[str, Any]]:
    with open_history(path) as history:
        return history.rows


def test_an_old_row_that_does_not_name_what_it_accepts_means_everything(tmp_path: Path) -> None:
    programs: dict[str, list[float | str]] = {"p0": [1.0, 2.0], "p1": [1.5, 3.0], "p2": [1.5, 3.0]}
    assert regressions(tmp_path / "told.jsonl", programs)
    assert regressions(tmp_path / "accepted.jsonl", programs, accepted="p1") == []


def test_a_model_that_is_gone_is_reported_where_its_place_is_asked(traces: Path, tmp_path: Path) -> None:
    models = two_models(tmp_path / "models")
    assert run(models, traces)[1]["gone"] == []
    shutil.rmtree(models / "b")
    # Another place says nothing of it, and does not make it forgotten.
    alone = decanter(
        "model",
        "judge",
        "regression",
        models / "a",
        "--standard",
        traces,
        "--history",
        tmp_path / "history.jsonl",
        "--json",
    )
    assert (alone.exit_code, only_object(alone.stdout)["gone"]) == (0, [])
    shown = decanter(
        "model", "judge", "regression", models, "--standard", traces, "--history", tmp_path / "history.jsonl"
    )
    assert shown.exit_code == 1
    assert "models/b was in the run of 20" in shown.stdout and "and is not there any more\n" in shown.stdout
    assert shown.stdout.endswith(f"nothing became worse, 1 gone; history: {tmp_path / 'history.jsonl'}\n")


def test_a_version_of_a_store_that_is_gone_is_reported_and_can_be_accepted(traces: Path, tmp_path: Path) -> None:
    store = tmp_path / "store"
    first = save(store, two_modes(), created=0.0)
    promote(store, first)
    second = save(store, replace(two_modes(), sensor_sigma=0.2), created=1.0)
    run(store, traces)
    shutil.rmtree(store / "versions" / second)
    code, data = run(store, traces, "--accept", "it was a trial")
    assert code == 0 and len(data["gone"]) == 1 and data["gone"][0].startswith(f"store@{second} was in the run of")


def test_runs_of_former_versions_that_do_not_say_what_was_asked_count_by_their_models(
    traces: Path, tmp_path: Path
) -> None:
    models, history = two_models(tmp_path / "models"), tmp_path / "history.jsonl"
    run(models, traces)
    rows = [{key: row[key] for key in row if key != "places"} for row in opened_rows(history)]
    history.write_text("".join(f"{json.dumps(row)}\n" for row in rows), encoding="utf-8")
    shutil.rmtree(models / "b")
    assert run(models, traces)[1]["gone"][0].startswith("models/b was in the run of")


def test_traces_of_the_set_that_are_missing_or_unreadable_make_the_run_fail(traces: Path, tmp_path: Path) -> None:
    write_model_directory(tmp_path / "m", two_modes())
    (tmp_path / "set").mkdir()
    shutil.copy(traces / "t5.csv", tmp_path / "set")
    (tmp_path / "set/broken.csv").write_text("x\n", encoding="utf-8")
    listing = tmp_path / "standard.toml"
    listing.write_text('traces = ["set", "none.csv", "gone/*.csv"]', encoding="utf-8")
    call = (
        "model",
        "judge",
        "regression",
        tmp_path / "m",
        "--standard",
        listing,
        "--history",
        tmp_path / "history.jsonl",
    )
    data = only_object(decanter(*call, "--json").stdout)
    named = [problem.partition(":")[0] for problem in data["trace_problems"]]
    assert sorted(named) == [f"{tmp_path}/gone/*.csv", f"{tmp_path}/none.csv", f"{tmp_path}/set/broken.csv"]
    shown = decanter(*call)
    assert shown.exit_code == 1 and decanter(*call, "--accept", "so be it").exit_code == 1
    said = f"nothing became worse, 3 of the set's traces not read; history: {tmp_path / 'history.jsonl'}\n"
    assert shown.stdout.endswith(said)


def test_a_set_without_a_trace_of_former_runs_says_that_nothing_was_compared(traces: Path, tmp_path: Path) -> None:
    write_model_directory(tmp_path / "m", two_modes())
    first, second = tmp_path / "first", tmp_path / "second"
    first.mkdir()
    second.mkdir()
    shutil.copy(traces / "t5.csv", first)
    shutil.copy(traces / "t6.csv", second)

    def notes(standard: Path) -> list[str]:
        call = ("--standard", standard, "--history", tmp_path / "history.jsonl", "--json")
        return list(only_object(decanter("model", "judge", "regression", tmp_path / "m", *call).stdout)["notes"])

    assert notes(first) == []
    assert notes(second) == ["compared with no former run: none has these traces"]
    shutil.copy(traces / "t5.csv", second)
    assert notes(second) == []
    (second / "t5.csv").unlink()
    (said,) = notes(second)
    assert said.startswith("not in the set any more since the run of 20") and said.endswith(": t5")
    shutil.copy(traces / "t5.csv", second)
    notes(second)
    lines = (second / "t5.csv").read_text(encoding="utf-8").splitlines()
    (second / "t5.csv").write_text("\n".join(lines[:-2]) + "\n", encoding="utf-8")
    assert notes(second)[0].endswith(": t5 (it has other readings now)")


def test_a_model_that_cannot_be_run_does_not_hinder_the_others(traces: Path, tmp_path: Path) -> None:
    models = two_models(tmp_path / "models")
    (models / "b/model.json").write_text("{}", encoding="utf-8")
    options = ("--standard", traces, "--history", tmp_path / "history.jsonl")
    shown = decanter("model", "judge", "regression", models / "a", models / "b", *options)
    assert shown.exit_code == 1 and f"models/b: {models / 'b'}" in " ".join(shown.stdout.split())
    end = f"nothing became worse, 1 not run along every trace; history: {tmp_path / 'history.jsonl'}\n"
    assert shown.stdout.endswith(end)
    # Below a folder it may have been so ever since: it is said.
    below = decanter("model", "judge", "regression", models, *options)
    assert below.exit_code == 0 and below.stdout.endswith(end)
    refused(decanter("model", "judge", "regression", models / "b", *options), 2, str(models / "b"))


def test_a_row_of_the_history_that_was_edited_has_one_sentence(traces: Path, tmp_path: Path) -> None:
    write_model_directory(tmp_path / "m", two_modes())
    history = tmp_path / "history.jsonl"
    call = ("model", "judge", "regression", tmp_path / "m", "--standard", traces, "--history", history)
    assert decanter(*call).exit_code == 0
    result, *_, last = opened_rows(history)
    for row, change, sentence in (
        (result, {"scores": None}, "scores: must be a list, got None"),
        (result, {"scores": [{"method": "present", "crps": 1.0, "coverage": 1.0}]}, "scores[0].horizon: is missing"),
        (result, {"trace": ["x"]}, "trace: must be text"),
        (last, {"models": []}, "models: must be a table"),
        (last, {"seed": "0"}, "seed: must be a whole number"),
        (last, {"places": "x"}, "places: must be a list"),
        ({"format": 1, "kind": "accepted", "when": "then"}, {}, "reason: is missing; add it"),
        ({"format": 1, "kind": "accepted", "when": "then", "reason": "x", "models": "m"}, {}, "models: must be a list"),
    ):
        history.write_text(json.dumps(row | change) + "\n", encoding="utf-8")
        refused(decanter(*call), 2, f"history.jsonl:1: {sentence}", "or take that line out")


def test_paths_that_are_no_utf8_or_lead_in_a_circle_are_a_sentence(traces: Path, tmp_path: Path) -> None:
    models, history = tmp_path / "models", tmp_path / "history.jsonl"
    write_model_directory(models / "a", two_modes())
    strange = tmp_path / "set" / os.fsdecode(b"t\xe9.csv")
    strange.parent.mkdir()
    shutil.copy(traces / "t5.csv", strange)
    said = refused(
        decanter("model", "judge", "regression", models, "--standard", strange.parent, "--history", history), 2
    )
    assert "t\\udce9.csv': is no UTF-8; rename" in said and not history.exists()
    write_model_directory(models / os.fsdecode(b"m\xe9"), two_modes())
    said = refused(decanter("model", "judge", "regression", models, "--standard", traces, "--history", history), 2)
    assert "m\\udce9': is no UTF-8; rename" in said and not history.exists()
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    call = ("model", "judge", "regression", models / "a", "--standard", traces, "--history")
    refused(decanter(*call, tmp_path / "loop/history.jsonl"), 2, "is a link that leads back to itself")


def test_the_commit_is_that_of_the_programs_own_checkout_and_of_no_folder_above(tmp_path: Path) -> None:
    def git(*words: str) -> None:
        subprocess.run(["git", "-C", str(tmp_path), *words], check=True, capture_output=True)

    git("init")
    identity = ("-c", "user.name=t", "-c", "user.email=t@example.com", "-c", "commit.gpgsign=false")
    git(*identity, "commit", "--allow-empty", "-m", "first")
    (tmp_path / "site-packages").mkdir()
    assert len(checkout_commit(tmp_path)) == 10 and checkout_commit(tmp_path / "site-packages") == ""
