"""Several things that load a machine and several temperatures: one map, one call, and what only follows is left out."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from gateway.cli.main import main
from tests.rig.no_bands import without_bands

ROWS, STEP = 1500, 20.0


@pytest.fixture(scope="module")
def export(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight hours of two bearings that power and speed heat; the oil's cooler opens with the temperature."""
    rng = np.random.default_rng(4)
    stays = rng.integers(15, 45, ROWS // 15)
    levels = np.repeat(rng.choice([0.0, 45.0, 90.0], stays.size), stays)[:ROWS]
    turns = np.where(levels > 0, np.repeat(rng.choice([1500.0, 3000.0], stays.size), stays)[:ROWS], 0.0)
    heat, beside, cooler = 25.0, 25.0, 0.0
    lines = ["Time,DE bearing [degC],NDE bearing [degC],Power [kW],Speed [rpm],Cooler [%]"]
    for row in range(ROWS):
        load = levels[row] + (rng.normal(0, 0.8) if levels[row] else 0.0)
        cooler += (100.0 * (heat > 45.0) - cooler) * 0.5
        heat += (20 + 0.3 * levels[row] + 0.006 * turns[row] - 0.05 * cooler - heat) * STEP / 500.0
        beside += (20 + 0.2 * levels[row] + 0.003 * turns[row] - beside) * STEP / 400.0
        own, other = heat + rng.normal(0, 0.02), beside + rng.normal(0, 0.02)
        lines.append(f"{row * STEP + 1.7e9:.0f},{own:.2f},{other:.2f},{load:.2f},{turns[row]:.0f},{cooler:.1f}")
    path = tmp_path_factory.mktemp("loads") / "export.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture(scope="module")
def map_file(export: Path) -> Path:
    out = export.with_suffix(".toml")
    loads = ["--current", "Power [kW]", "--current", "Speed [rpm]", "--current", "Cooler [%]"]
    words = ["trace", "map", str(export), "-o", str(out), "--temperature", "DE bearing [degC]", *loads]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0, done.stderr
    return out


def test_each_load_that_a_person_names_is_a_level_signal(map_file: Path) -> None:
    text = map_file.read_text()
    for signal in ("Power", "Speed", "Cooler"):
        assert f'{{ kind = "bins", signal = "{signal}", thresholds = [' in text
    assert 'signal = "Power", above = ' in text  # what runs is told by the first


def test_several_temperatures_are_learned_in_one_call_without_what_follows(
    export: Path, map_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_bands(monkeypatch)
    wanted = ["--temperature", "DE_bearing", "--temperature", "NDE_bearing"]
    words = ["model", "learn", "--traces", str(export), "--map", str(map_file), "--out", str(tmp_path / "m"), *wanted]
    done = CliRunner().invoke(main, [*words, "--json"])
    assert done.exit_code == 0, done.stderr
    first, second = json.loads(done.stdout.splitlines()[-1])["models"]
    assert first["model"].endswith("m/DE_bearing") and second["model"].endswith("m/NDE_bearing")
    assert (tmp_path / "m" / "NDE_bearing" / "model.json").is_file()
    assert (first["temperature"], second["temperature"]) == ("DE_bearing", "NDE_bearing")
    own = {one["signal"]: one for one in first["drivers"]}
    assert {name: one["verdict"] for name, one in own.items()} == {
        "Power": "drives", "Speed": "drives", "Cooler": "follows", "NDE_bearing": "follows",
    }  # fmt: skip
    assert own["Power"]["gain"] == pytest.approx(0.3, rel=0.2) and own["Speed"]["gain"] == pytest.approx(0.006, rel=0.3)
    assert first["left out"] == ["Cooler"]
    assert all(place["location"].count("/") == 2 for place in first["locations"] if place["location"] != "?")


def test_a_driver_is_named_in_place_of_the_maps(
    export: Path, map_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_bands(monkeypatch)
    words = ["model", "learn", "--traces", str(export), "--map", str(map_file), "--out", str(tmp_path / "m")]
    refused = CliRunner().invoke(main, [*words, "--driver", "Torque"])
    assert refused.exit_code == 2 and "'Torque' cannot drive 'DE_bearing'; the signals are" in refused.stderr
    absent = CliRunner().invoke(main, [*words, "--temperature", "DE_bearing", "--temperature", "Oil"])
    assert absent.exit_code == 2 and "'Oil'" in absent.stderr and not (tmp_path / "m").exists()
    done = CliRunner().invoke(main, [*words, "--driver", "Power", "--json"])
    assert done.exit_code == 0, done.stderr
    learned = json.loads(done.stdout.splitlines()[-1])
    assert all(place["location"].count("/") == 1 for place in learned["locations"] if place["location"] != "?")
    assert learned["left out"] == []
