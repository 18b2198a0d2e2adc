"""`model rank` and `model validate` with --skill: forecasts beside persistence and rivals, said where they lose."""

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from sim.lab.formats.write_model import write_model_directory
from sim.lab.recordings.trace_file import write_trace
from tests.cli.support import decanter, misused, only_object
from tests.cli.test_skill import Clairvoyant, Past
from tests.gateway.support import TEMPERATURE, two_modes
from tests.skill.test_forecasts_along import measured


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model of two modes; `own/drawn`, drawn from it, and `still/still`, whose temperature heeds no mode."""
    folder = tmp_path_factory.mktemp("judged")
    write_model_directory(folder / "model", two_modes())
    drawn = measured(2400.0, seed=5)
    walk = 35.0 + np.cumsum(0.01 * np.random.default_rng(0).standard_normal(drawn.times.size))
    still = replace(drawn, signals={**drawn.signals, TEMPERATURE: walk})
    for name, trace in (("own/drawn", drawn), ("still/still", still)):
        (folder / name).parent.mkdir()
        write_trace(trace, folder / f"{name}.csv")
    return folder


@dataclass
class Absent:
    """A rival whose package is not there."""

    name: str

    def fit(self, training: Sequence[Past], horizons: Sequence[float]) -> Clairvoyant:
        raise ValueError("it needs what is not installed")


def test_rank_says_where_persistence_is_better_than_the_model_and_where_it_is_not(plant: Path, tmp_path: Path) -> None:
    page = tmp_path / "rank.html"
    options = ("--runs", 100, "--jobs", 1, "--skill", "--page", page, "--json")
    lost = only_object(
        decanter("model", "judge", "rank", plant / "model", "--traces", plant / "still", *options).stdout
    )
    told = [row["verdict"] for row in lost["forecasts"]["worth"]]
    assert told[0] == "worse" and [row["best"] for row in lost["forecasts"]["worth"]] == ["persistence"] * 3
    sentence = lost["forecasts"]["sentences"][0]
    assert sentence.startswith("at 60 s persistence is better (CRPS ")
    assert sentence.endswith(": the model is not worth its trouble there")
    assert sentence in page.read_text(encoding="utf-8")
    won = only_object(decanter("model", "judge", "rank", plant / "model", "--traces", plant / "own", *options).stdout)
    verdicts = {row["horizon"]: row["verdict"] for row in won["forecasts"]["worth"]}
    # Forty minutes hold no eight spans of 900 s.
    assert (verdicts[60.0], verdicts[900.0]) == ("better", "not known")
    rows = won["forecasts"]["by machine"]
    assert {(row["machine"], row["method"]) for row in rows} == {("own", "two modes"), ("own", "persistence")}
    assert all(0.0 <= row["coverage"] <= 1.0 and 0 < row["forecasts"] <= 40 for row in rows)
    without = only_object(
        decanter("model", "judge", "rank", plant / "model", "--traces", plant / "own", "--jobs", 1, "--json").stdout
    )
    assert without["forecasts"] is None


def test_validate_reports_forecasts_beside_the_rivals_that_are_there(
    plant: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rivals = (Clairvoyant(), Absent("one"), Absent("two"))
    room = SimpleNamespace(Past=Past, rivals=lambda seed: rivals)
    monkeypatch.setitem(sys.modules, "sim.lab.judge.rivals", room)  # type: ignore[arg-type]
    out = tmp_path / "out"
    command = (
        "model",
        "judge",
        "validation",
        plant / "model",
        "--traces",
        plant,
        "--training",
        plant / "own",
        "--out",
        out,
    )
    done = decanter(*command, "--runs", 100, "--no-pictures", "--jobs", 1, "--rivals")
    assert done.exit_code == 0, done.output
    found = json.loads((out / "skill.json").read_text(encoding="utf-8"))["two modes"]
    assert {row["method"] for row in found["by machine"]} == {"two modes", "persistence", "thirty"}
    assert {row["machine"] for row in found["by machine"]} == {"own", "still"}
    assert "without one, two: it needs what is not installed" in found["notes"]
    # The rivals are asked with the past alone, and not at every forecast of ours.
    assert 2 < len(rivals[0].asked) <= 80  # type: ignore[union-attr]
    report = (out / "two_modes" / "report.html").read_text(encoding="utf-8")
    index = (out / "index.html").read_text(encoding="utf-8")
    assert found["sentences"] and any("on still at 60 s persistence is better" in one for one in found["sentences"])
    for sentence in found["sentences"]:
        assert sentence in report and sentence in index and f"two modes: {sentence}" in done.stdout


def test_skill_in_a_ranking_needs_traces_and_rivals_need_training(plant: Path, tmp_path: Path) -> None:
    misused(decanter("model", "judge", "rank", "--results", tmp_path, "--skill"), "--skill forecasts along traces")
    some = (plant / "model", "--traces", plant / "own", "--rivals")
    misused(decanter("model", "judge", "rank", *some), "--rivals are fitted to traces: name them with --training")
    misused(decanter("model", "judge", "validation", *some, "--out", tmp_path / "o"), "--rivals are fitted to traces")


def test_what_has_no_forecast_is_a_note_and_the_ranking_goes_on(plant: Path, tmp_path: Path) -> None:
    write_trace(measured(50.0), tmp_path / "short.csv")
    elsewhere = replace(two_modes(), temperature="TCuscinettiAlimentazione")
    write_model_directory(tmp_path / "elsewhere", replace(elsewhere, sha=replace(elsewhere.sha, name="elsewhere")))
    options = ("--traces", tmp_path / "short.csv", "--runs", 100, "--jobs", 1, "--skill", "--json")
    found = only_object(decanter("model", "judge", "rank", plant / "model", tmp_path / "elsewhere", *options).stdout)[
        "forecasts"
    ]
    assert found["sentences"] == [] and found["by horizon"] == []
    other, short = found["notes"]
    assert other.startswith("elsewhere has no forecast along short: it forecasts another signal than the first model")
    assert short == "short: no forecast for 60, 300, 900 s came due; it lasts 40 s"
