"""`model regress`: every result once, and what became worse, with models and programs that were made worse."""

import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gateway.lab.regression import history as history_module
from gateway.lab.regression import regress as regress_module
from gateway.lab.regression.history import opened_history
from gateway.lab.regression.standard import CodeVersion, code_version
from gateway.lab.regression.worse import WorseForecast, regressions_of
from sim.artefacts import promote
from sim.artefacts.formats import save, write_model_directory
from sim.sha import Distribution
from sim.traces import write_trace
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
    done = decanter("model", "regress", models, *standard, *options, "--json")
    return done.exit_code, only_object(done.stdout)


def test_a_model_that_was_learned_worse_is_told_since_when_until_somebody_accepts_it(
    traces: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    models, asked = tmp_path / "models", list[str]()
    real: Callable[..., Any] = history_module.scores_along

    def counted(trace: Any, *arguments: Any, **options: Any) -> Any:
        asked.append(trace.name)
        return real(trace, *arguments, **options)

    monkeypatch.setattr(history_module, "scores_along", counted)
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
    shown = decanter("model", "regress", models, "--standard", traces, "--history", tmp_path / "history.jsonl")
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
    with opened_history(path) as history:
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
        return regressions_of("a", history, seed=0)


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
    call = ("model", "regress", tmp_path / "m", "--standard", listing, "--history", history)
    for text, sentence in (
        ("traces = []", 'traces: is no list of paths; write traces = ["cycles/*.csv"]'),
        ('traces = ["a.csv"]\nmaps = "x"', "maps: is no key of a standard set"),
        ('traces = ["a.csv"]\nmap = 1', "map: is no name"),
        ("traces = [", "cannot be read as a list of traces"),
        ('traces = ["none/*.csv"]', "there is no CSV file there"),
    ):
        listing.write_text(text, encoding="utf-8")
        refused(decanter(*call), 2, sentence)
    listing.write_text(f'traces = ["{traces}/t5.csv"]', encoding="utf-8")
    (tmp_path / "none").mkdir()
    refused(decanter("model", "regress", tmp_path / "none", *call[3:]), 2, "has no model in it")
    history.write_text('{"kind": "other"}\n', encoding="utf-8")
    refused(decanter(*call), 2, "history.jsonl:1: is no row of a history of regressions")
    history.write_text("", encoding="utf-8")
    with opened_history(history):
        refused(decanter(*call), 2, "another process is writing this history")
    assert regress_module.regress.name == "regress"
