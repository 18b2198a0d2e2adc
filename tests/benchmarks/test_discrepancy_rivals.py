"""The blind benchmark's rivals, and its cases from seed to file: strong effects are named, nothing is made up."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.discrepancy import bearings, generator, rivals
from benchmarks.discrepancy.__main__ import main
from benchmarks.discrepancy.bearings import machine
from benchmarks.discrepancy.effects import EFFECTS
from benchmarks.discrepancy.log import written_log
from benchmarks.discrepancy.operation import operate
from benchmarks.discrepancy.plant import Parts, Roughness, run
from benchmarks.discrepancy.rival_data import averaged, baseline, blocks, candidates, read_log
from benchmarks.discrepancy.rivals import METHODS, Rival, Settings
from benchmarks.discrepancy.runner import Case, case
from benchmarks.discrepancy.seal import committed, index, opened
from benchmarks.discrepancy.strata import Spec
from benchmarks.discrepancy.visible import Family
from gateway.lab.traces.load import load
from sim.lab.formats.write_model import write_model_directory
from sim.lab.learning.bins.candidates import BinsCandidate
from sim.lab.learning.bins.learn import learn_bins
from tests.rig.no_bands import without_bands

QUIET = Roughness(0.0, 400.0, 0.0, 0.02, 0.01)


def logged(folder: Path, name: str | None, strength: float = 3.0) -> Case:
    """Two days of a smooth plant with one effect or none."""
    operation = operate(np.random.default_rng(8), days=2)
    parts = EFFECTS[name].make(operation, strength, np.random.default_rng(1)) if name else Parts()
    bearing = machine("development", "stages", False, 0).bearing
    course = run([(operation, bearing, np.zeros(operation.times.size), parts)])[0]
    written_log(
        folder / "traces.csv", operation, course, QUIET, Spec("development", "test", 0), np.random.default_rng(0)
    )
    return Case("one", folder / "traces.csv", folder / "model", 0)


@pytest.fixture(autouse=True)
def stages_model(monkeypatch: pytest.MonkeyPatch) -> None:
    """The rivals read no more of the given model than its structure."""
    monkeypatch.setattr(rivals, "family_of", lambda _model: Family())


@pytest.mark.parametrize("method", METHODS)
def test_a_rival_names_a_strong_effect_and_says_how_much_smaller_the_error_became(tmp_path: Path, method: str) -> None:
    if method.startswith("sindy"):
        pytest.importorskip("pysindy", reason="the extra `bench` is not installed")
    outcome = Rival(method, Settings(threshold=0.2))(logged(tmp_path, "torque-friction"), 60.0)
    assert outcome.status == "done", outcome.message
    assert outcome.diagnosis["effects"][0]["name"] == "torque-friction"
    errors = outcome.diagnosis["held_out"]
    assert errors["rmse_after"] < 0.5 * errors["rmse_before"]


def test_the_one_step_rival_names_nothing_on_a_smooth_plant_without_effect(tmp_path: Path) -> None:
    assert Rival("one-step-bic")(logged(tmp_path, None), 60.0).diagnosis["verdict"] == "agree"


def test_the_rivals_own_terms_say_all_about_a_clean_plant(tmp_path: Path) -> None:
    log = read_log(logged(tmp_path, None).traces)
    cut = blocks(log, 120.0)
    rate = cut.differences(np.nan_to_num(log.temperature))
    own = np.stack([averaged(log, cut, one) for one in baseline(log, Family())], axis=1)
    left = rate - own @ np.linalg.lstsq(own, rate, rcond=None)[0]
    of_noise = np.sqrt(2 / 12) * QUIET.sensor / 120.0
    assert np.std(left) == pytest.approx(of_noise, rel=0.1)


def test_a_rival_is_not_offered_what_it_has_no_signal_for(tmp_path: Path) -> None:
    log = read_log(logged(tmp_path, None).traces)
    assert set(candidates(log, np.zeros(log.times.size))) | {"sensor-offset-step"} == set(EFFECTS)
    poor = type(log)(log.times, log.temperature, log.stage, log.age, {"Assorbimento": log.signals["Assorbimento"]})
    assert "pump-cooling" not in candidates(poor, np.zeros(log.times.size))


def quick_learn(traces: Path, out: Path, seed: int) -> None:
    """A model of one fixed shape, instead of the choice between eight, from one day: no more than the shape is used."""
    loaded, column_map = load([str(traces)], "decanter")
    loaded = [trace.between(-np.inf, float(trace.times[0]) + 86_400.0) for trace in loaded]
    shape = (BinsCandidate("driven" if "linear" in traces.stem else "constant", "switch", "shared"),)
    learned = learn_bins(loaded, column_map.alphabet, column_map.temperature, seed=seed, candidates=shape)
    write_model_directory(out, learned.model, learned.values)


@pytest.mark.benchmark
def test_cases_are_generated_whole_and_only_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bearings, "learn", quick_learn)
    monkeypatch.setattr(generator, "learn", quick_learn)
    without_bands(monkeypatch)
    command = ["generate", "--set", "development", "--strata", "one-day", "--count", "2", "--out", str(tmp_path)]
    told = CliRunner().invoke(main, command)
    assert told.exit_code == 0, told.output
    labels = opened(tmp_path, committed(tmp_path))
    assert set(labels) == set(index(tmp_path)) and len(labels) == 2
    effect = next(one for one in labels.values() if one.truth)
    assert effect.ratio == pytest.approx(effect.spec["ratio"], rel=0.15)
    assert all(one.baseline_gap < 0.1 and one.floor >= one.sensor for one in labels.values())
    for name in labels:
        one = case(tmp_path, name)
        assert one.traces.is_file() and json.loads((one.model / "manifest.json").read_text("utf-8"))
    again = CliRunner().invoke(main, command)
    assert "learning" not in again.output and committed(tmp_path) in again.output
