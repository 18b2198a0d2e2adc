"""`decanter diagnose` on measured data: cold starts of a car, whose thermostat no model was told of."""

import json
from pathlib import Path
from typing import Any

import pytest

from tests.cli.support import ROOT, decanter, only_object
from tests.rig.no_bands import without_bands

REAL = ROOT.parent / "shared" / "data"
CARS = REAL / "carobd"
KNOWN = ("drive12", "idle1", "idle4", "live1", "live17")
"""The trips that the model is learned from; three more are only diagnosed."""

pytestmark = [
    pytest.mark.real_data,
    pytest.mark.skipif(not CARS.is_dir(), reason=f"the measured data are not at {REAL}"),
]


@pytest.fixture(autouse=True)
def _no_bands(monkeypatch: pytest.MonkeyPatch) -> None:
    """The bands, for which a model is fitted two or three times more, and which a diagnosis does not look at."""
    without_bands(monkeypatch)


def diagnosed(model: Path, traces: Path, column_map: str, out: Path) -> dict[str, Any]:
    command = ("diagnose", "--model", model, "--traces", traces, "--map", column_map, "--out", out, "--json")
    result = decanter(*command)
    assert result.exit_code == 0, result.stderr
    return only_object(result.stdout)


def learned(traces: Path, column_map: str, out: Path) -> Path:
    result = decanter("model", "learn", "--traces", traces, "--map", column_map, "--out", out)
    assert result.exit_code == 0, result.stderr
    return out


def test_the_thermostat_and_the_heat_of_the_load_of_a_car_are_named_and_the_decoys_are_not(tmp_path: Path) -> None:
    trips = tmp_path / "trips"
    trips.mkdir()
    for name in KNOWN:
        (trips / f"{name}.csv").symlink_to(CARS / f"{name}.csv")
    model = learned(trips, "carobd", tmp_path / "model")
    found = diagnosed(model, CARS, "carobd", tmp_path / "out")
    names = {name for effect in found["effects"] for name in effect["class"]}
    assert "thermostatic-cooling" in found["effects"][0]["class"]
    assert names.isdisjoint({"speed-friction", "ambient-coupling"})
    held = found["held_out"]
    assert found["effects"][0]["parameters"]["gradual"] == 1.0
    assert {"current-heating"} <= set(found["effects"][1]["class"])
    assert held["excess_removed"] > 0.85
    assert held["rmse_after"] < 0.9  # degC; 1.31 with the thermostat alone
    assert held["ci95"][0] > 0
    assert {"torque-friction", "pump-cooling"} <= set(found["untested"])
    report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "bearing" not in report.lower()
    assert (tmp_path / "out" / "model" / "model.json").is_file()


@pytest.mark.parametrize(
    ("column_map", "traces"),
    [("can_obd2", "can_obd2/tripA164_decoded_long.csv"), ("skab", "skab/anomaly-free.csv")],
)
def test_one_run_of_a_machine_is_too_little(column_map: str, traces: str, tmp_path: Path) -> None:
    model = learned(REAL / traces, column_map, tmp_path / "model")
    found = diagnosed(model, REAL / traces, column_map, tmp_path / "out")
    assert found["verdict"] == "too-little-data" and found["effects"] == []
    assert json.loads((tmp_path / "out" / "diagnosis.json").read_text(encoding="utf-8"))["verdict"] == found["verdict"]
