"""`decanter model judge skill` from end to end, with known rivals, and its sentences for what cannot be scored."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from sim.forecast.ensemble import DENSE_LEVELS
from sim.lab.formats.write_model import write_model_directory
from sim.lab.recordings.trace_file import write_trace
from sim.sha.trace import Array
from tests.cli.support import decanter, misused, only_object, refused
from tests.gateway.support import two_modes
from tests.skill.test_forecasts_along import measured


@dataclass(frozen=True)
class Past:
    times: Array
    temperature: Array
    inputs: Mapping[str, Array]


@dataclass
class Clairvoyant:
    """A rival that always says 30 degC without doubt; it notes what it was given."""

    name: str = "thirty"
    trained: list[Past] = field(default_factory=list)
    asked: list[Past] = field(default_factory=list)

    def fit(self, training: Sequence[Past], horizons: Sequence[float]) -> "Clairvoyant":
        self.trained += training
        return self

    def forecast(self, past: Past, horizons: Sequence[float], levels: tuple[float, ...]) -> Array:
        assert levels == DENSE_LEVELS
        self.asked.append(past)
        return np.full((len(levels), len(horizons)), 30.0)


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model directory, and three traces that were drawn from the model: `a`, `b/b` of another machine, `short`."""
    folder = tmp_path_factory.mktemp("skill")
    write_model_directory(folder / "model", two_modes())
    (folder / "b").mkdir()
    for name, length, seed in (("a", 3000.0, 1), ("b/b", 2500.0, 2), ("short", 50.0, 3)):
        write_trace(measured(length, seed=seed), folder / f"{name}.csv")
    return folder


def test_skill_speaks_by_horizon_machine_and_time_and_draws_it(plant: Path, tmp_path: Path) -> None:
    picture = tmp_path / "skill.png"
    options = (
        "--traces",
        plant / "a.csv",
        "--traces",
        plant / "b" / "b.csv",
        "--scan",
        10,
        "--horizons",
        "60,300",
        "--period",
        120,
    )
    found = only_object(
        decanter("model", "judge", "skill", plant / "model", *options, "--picture", picture, "--json").stdout
    )
    assert {row["method"] for row in found["by horizon"]} == {"decanter", "persistence"}
    assert {row["horizon"] for row in found["by horizon"]} == {60.0, 300.0}
    # A trace's machine is the one that the column map says: here, the folder of its file.
    assert {row["machine"] for row in found["by machine"]} == {plant.name, "b"}
    assert found["machine offsets"] == []
    assert {row["since start"] for row in found["by time"]} == {"0-3 min", "3-10 min", "10-30 min", "later"}
    assert all(0.0 <= row["coverage"] <= 1.0 and row["crps"] > 0.0 for row in found["by machine"])
    assert [row["best other"] for row in found["differences"]] == ["persistence"] * 2
    assert picture.stat().st_size > 10_000
    text = decanter("model", "judge", "skill", plant / "model", *options, "--horizons", 60, "--period", 600).stdout
    assert "forecasts by horizon" in text and "the same by machine" in text


def test_skill_asks_rivals_with_the_past_alone(plant: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rival = Clairvoyant()
    room = SimpleNamespace(Past=Past, rivals=lambda seed: (rival,))
    monkeypatch.setitem(sys.modules, "sim.lab.judge.rivals", room)  # type: ignore[arg-type]
    options = (
        "--traces",
        plant / "a.csv",
        "--training",
        plant / "b" / "b.csv",
        "--rivals",
        "--scan",
        10,
        "--horizons",
        60,
        "--period",
        60,
    )
    found = only_object(decanter("model", "judge", "skill", plant / "model", *options, "--json").stdout)
    rows = {row["method"]: row for row in found["by horizon"]}
    assert set(rows) == {"decanter", "persistence", "thirty"}
    assert len({row["forecasts"] for row in rows.values()}) == 1
    assert rows["thirty"]["crps"] == pytest.approx(rows["thirty"]["mae"], rel=1e-6)
    (trained,) = rival.trained
    assert trained.times.size == 250
    lengths = [past.times.size for past in rival.asked]
    assert lengths == sorted(set(lengths)) and lengths[0] < 10 and 250 < lengths[-1] <= 300
    assert all(set(past.inputs) == {"MarciaDecanter", "Assorbimento"} for past in rival.asked)


def test_skill_says_what_cannot_be_scored(plant: Path, tmp_path: Path) -> None:
    short = ("model", "judge", "skill", plant / "model", "--traces", plant / "short.csv", "--scan", 10)
    refused(decanter(*short), 2, "short: no forecast for 60, 300, 900 s came due; it lasts 40 s", "longer traces")
    both = decanter(*short, "--traces", plant / "a.csv", "--horizons", 60, "--period", 600, "--json")
    assert only_object(both.stdout)["notes"] == ["short: no forecast for 60 s came due; it lasts 40 s"]
    (tmp_path / "empty.csv").write_text("time,MarciaDecanter,Assorbimento,TCuscinettiRiduttore\n", encoding="utf-8")
    refused(decanter("model", "judge", "skill", plant / "model", "--traces", tmp_path / "empty.csv"), 2, "empty.csv")
    misused(decanter(*short, "--horizons", "300,60"), "'300,60': give positive seconds in ascending order")
    misused(decanter(*short, "--rivals"), "--rivals are fitted to traces: name them with --training")
    refused(decanter(*short, "--picture", tmp_path / "x.txt"), 2, "cannot be a picture")


def test_a_long_trace_gets_so_many_forecasts_however_fine_the_scan(
    plant: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rival = Clairvoyant()
    monkeypatch.setitem(sys.modules, "sim.lab.judge.rivals", SimpleNamespace(rivals=lambda seed: (rival,)))
    words = ("model", "judge", "skill", str(plant / "model"), "--traces", str(plant / "a.csv"), "--horizons", "60")
    rivals = ("--rivals", "--training", str(plant / "b" / "b.csv"), "--json")
    counts = []
    for scan in ("1", "0.01"):
        rival.asked.clear()
        found = only_object(decanter(*words, *rivals, "--moments", "10", "--scan", scan).stdout)
        assert "for no more than 10 moments" in found["notes"][0]
        counts.append({row["method"]: row["forecasts"] for row in found["by horizon"]} | {"asked": len(rival.asked)})
    # A scan that is finer than the rows shows nothing more, and costs nothing more.
    assert counts[0] == counts[1] and 5 <= counts[0]["decanter"] <= 10 and counts[0]["asked"] <= 11
