"""A model that follows power and not temperature: whatever is printed, drawn or written says kW, as the column map."""

import json
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner

from gateway.console import CommandResult, conclude
from gateway.lab.gap.diagnose import DiagnosisRequest, run, show
from sim.sha.trace import Trace, signal_unit
from tests.cli.support import decanter
from tests.discrepancy.plants import model as model_of
from tests.discrepancy.plants import plant as plant_of
from tests.rig.no_bands import without_bands

MAP = """
format = "wide"
temperature = "Power"
[clock]
column = "time"
formats = ["seconds"]
[signals]
Power = { unit = "kW" }
Speed = { unit = "rpm" }
[alphabet]
gap = 60.0
channels = [{ kind = "bins", signal = "Speed", thresholds = [100.0, 1000.0], symbols = ["slow", "middle", "fast"] }]
"""


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """A column map, a folder of traces and the directory of the model learned from them."""
    home, rng = tmp_path_factory.mktemp("power"), np.random.default_rng(3)
    (home / "power.toml").write_text(MAP, encoding="utf-8")
    (home / "traces").mkdir()
    for number in range(3):
        speed = np.repeat(rng.choice([50.0, 500.0, 1500.0], 8), 15)
        power = np.convolve(speed / 300.0, np.exp(-np.arange(40) / 8.0) / 8.5)[: speed.size]
        cells = zip(np.arange(speed.size) * 5.0, power + 0.05 * rng.standard_normal(speed.size), speed, strict=True)
        text = "time,Power,Speed\n" + "".join(f"{t:g},{p:.4f},{s:g}\n" for t, p, s in cells)
        (home / "traces" / f"p{number}.csv").write_text(text, encoding="utf-8")
    command = ("model", "learn", "--traces", home / "traces", "--map", home / "power.toml", "--out", home / "model")
    with pytest.MonkeyPatch.context() as patch:
        without_bands(patch)  # a unit is none of their business
        learned = decanter(*command)
    assert learned.exit_code == 0, learned.output
    assert "kW" in learned.output and "°C" not in learned.output
    return home / "power.toml", home / "traces", home / "model"


def test_the_model_carries_the_unit_of_what_it_predicts(plant: tuple[Path, Path, Path]) -> None:
    _, _, model = plant
    assert json.loads((model / "model.json").read_text(encoding="utf-8"))["units"]["temperature"] == "kW"


def test_every_command_says_kw_and_none_says_degrees(plant: tuple[Path, Path, Path], tmp_path: Path) -> None:
    column_map, traces, model = plant
    one, run = traces / "p0.csv", ("--map", column_map, "--runs", "50")
    for command in (
        ("show", model),
        ("simulate", model, "--trace", one, *run),
        ("simulate", model, "--word", "@0,T=2 fast@30,m=4 @60"),
        ("prove", model),
        ("check", model, "Pr[<=60](<> Power > 4)", "--events", one, "--map", column_map, "--runs", "50"),
        ("rank", model, "--traces", traces, "--map", column_map, "--jobs", "1"),
    ):
        done = decanter("model", *command)
        assert done.exit_code in (0, 1), done.output
        assert "kW" in done.output, command
        assert "°C" not in done.output and "degC" not in done.output, command


def test_tuning_and_correcting_say_kw(
    plant: tuple[Path, Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_bands(monkeypatch)
    column_map, traces, model = plant
    read = ("--traces", traces, "--map", column_map)
    study = ("--study", tmp_path / "study.db", "--trials", "1", "--folds", "2")
    for command in (
        ("learn", "settings", *read, *study),
        ("learn", "correction", model, *read, "--out", tmp_path / "corrected", "--max-rate"),
    ):
        done = decanter("model", *command)
        assert done.exit_code in (0, 1), done.output
        assert "kW" in done.output, command
        assert "°C" not in done.output and "degC" not in done.output, command


def test_a_diagnosis_says_kw_and_so_does_its_report(tmp_path: Path) -> None:
    """Of a plant whose hidden churning is named and whose targets have moved, its readings called kW."""
    trace = replace(plant_of(7, days=2, churning=0.006, period=60.0), units={"T": "kW"})
    given = model_of(shift=0.06)  # says degC: the trace's unit counts
    request = DiagnosisRequest(
        where="plant", out=tmp_path / "out", source="a test", seed=0, most=1, created=0.0, report=True
    )
    result = run(request, given, [trace], {}, lambda _stage, _share: None)
    assert result.diagnosis.effects and result.diagnosis.shifts
    printed = (
        CliRunner()
        .invoke(
            click.command()(lambda: conclude(CommandResult({}), lambda _: show(result, request.out), as_json=False))
        )
        .output
    )
    files = [(request.out / name).read_text(encoding="utf-8") for name in ("diagnosis.json", "report.html")]
    for text in (printed, *files):
        assert "kW" in text and "°C" not in text and "degC" not in text
    assert (
        json.loads((request.out / "model" / "model.json").read_text(encoding="utf-8"))["units"]["temperature"] == "kW"
    )


def test_a_validation_says_kw_in_its_records_and_its_report(plant: tuple[Path, Path, Path], tmp_path: Path) -> None:
    column_map, traces, model = plant
    out = tmp_path / "out"
    command = ("validate", model, "--traces", traces / "p1.csv", "--map", column_map, "--runs", "100", "--jobs", "1")
    done = decanter("model", *command, "--out", out)
    assert done.exit_code == 0, done.output
    files = (out / "decanter" / "report.html", out / "index.html", out / "campaign.log")
    for text in (done.output, *(file.read_text(encoding="utf-8") for file in files)):
        assert "kW" in text and "°C" not in text and "degC" not in text


def test_traces_in_two_units_are_not_mixed() -> None:
    times, signals = np.zeros(1), {"P": np.zeros(1)}
    one, other = (Trace(unit, times, signals, units={"P": unit}) for unit in ("kW", "W"))
    assert signal_unit([one, Trace("none", times, signals)], "P") == "kW"
    assert signal_unit([], "P") == "degC"
    with pytest.raises(ValueError, match="in kW in trace 'kW' and in W in trace 'W'; convert"):
        signal_unit([one, other], "P")
