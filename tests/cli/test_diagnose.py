"""`decanter diagnose` and `decanter demo --discrepancy`: what they write, what they refuse, what they read."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.tag import Quality, Sample, Tag
from gateway.lab.gap.diagnose import signal_roles
from gateway.machine.reading.scan import Scan
from gateway.machine.records import Keeper
from gateway.store.read_back import recent
from sim.artefacts.model_json import model_text, parse_model
from sim.effects.kinds import ROLES
from sim.lab.formats.find import find_model
from sim.lab.recordings.column_map import load_map
from sim.plant.cooled import EPOCH_S, CooledPlant, cooled_days
from sim.plant.scenarios import scenario
from sim.sha.trace import Trace
from tests.cli.support import ROOT, decanter, misused, only_object, refused
from tests.gateway.support import one_machine, two_modes


def kept(path: Path, trace: Trace) -> Path:
    """A gateway's historian with the rows of a trace, one a scan."""
    tags = [Tag(name, f"holding:{number}") for number, name in enumerate(trace.signals)]
    store, historian = one_machine(path, tags)
    keeper = Keeper({tag.name: tag for tag in tags}, 5.0)
    historian.put("runs", [(float(trace.times[0]), "TCuscinettiRiduttore", "", 1.0, 5.0)])
    for row, time in enumerate(trace.times.tolist()):
        readings = {name: float(column[row]) for name, column in trace.signals.items()}
        good = {name: Sample(name, value, Quality.GOOD, time, time) for name, value in readings.items()}
        historian.put("scans", [(time, 0.0, 0)])
        historian.put("samples", keeper.rows(Scan(row, time, good, 0, 0.0)))
    assert store.close()
    return path


def test_one_cycle_is_too_little_and_that_is_no_error(model: Path, traces: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "out"
    result = decanter("diagnose", "--model", model, "--traces", traces / "cd17.csv", "--out", out, "--json")
    assert result.exit_code == 0
    data = only_object(result.stdout)
    written = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    assert data | written == data
    assert data["verdict"] == "too-little-data" and data["effects"] == [] and data["model_after"] is None
    assert data["held_out"] is None and data["model_before"] == str(model)
    assert sorted(path.name for path in out.iterdir()) == ["diagnosis.json", "report.html"]
    assert "SYNTHETIC" in (out / "report.html").read_text(encoding="utf-8")


def test_traces_that_a_shell_has_spelled_out_are_taken_and_the_verdict_is_told(
    model: Path, traces: Path, tmp_path: Path
) -> None:
    command = ("diagnose", "--model", model, "--out", tmp_path / "out", "--traces", traces / "cd1.csv")
    result = decanter(*command, traces / "cd17.csv")
    assert result.exit_code == 0 and result.stdout.startswith("too-little-data: ")
    assert f"report: {tmp_path / 'out' / 'report.html'}" in result.stdout


def test_what_cannot_be_diagnosed_is_refused_in_one_sentence(
    model: Path, traces: Path, wrong: Path, tmp_path: Path
) -> None:
    given = ("diagnose", "--model", model, "--traces", traces / "cd1.csv", "--out")
    refused(decanter(*given, wrong / "empty"), 2, "this is a file")
    refused(decanter(*given, model.parent), 2, "would replace the one that is diagnosed")
    refused(decanter(*given, tmp_path / "o", "--map", "nomap"), 2, "nomap")
    refused(decanter(*given, tmp_path / "o", "--temperature", "Oil"), 2, "this model predicts 'TCuscinettiRiduttore'")
    with_model = ("diagnose", "--out", tmp_path / "o", "--model")
    refused(decanter(*with_model, wrong / "none", "--traces", traces / "cd1.csv"), 2, "none")
    for name in ("none.csv", "empty", "garbage", "folder", "cold.csv"):
        refused(decanter(*with_model, model, "--traces", wrong / name), 2, name.partition(".")[0])
    (tmp_path / "room.csv").write_text("time,TCuscinettiRiduttore\n0,20\n1,21\n2,22\n", encoding="utf-8")
    refused(decanter(*with_model, model, "--traces", tmp_path / "room.csv"), 2, "'MarciaDecanter', which no trace has")
    (tmp_path / "own.toml").write_text('[[effect]]\nname = "a"\nheat = "b *"\n', encoding="utf-8")
    refused(decanter(*given, tmp_path / "o", "--effects", tmp_path / "own.toml"), 2, "effect[0]: the key 'meaning'")
    refused(decanter(*given, tmp_path / "o", "--effects", tmp_path / "no.toml"), 2, "no.toml: no such file")
    assert not (tmp_path / "o").exists(), "nothing is written for what is refused"


def test_traces_and_historian_exclude_each_other(model: Path, tmp_path: Path) -> None:
    given = ("diagnose", "--model", model, "--out", tmp_path / "o")
    misused(decanter(*given), "give either --traces or --historian")
    misused(decanter(*given, "--traces", "x.csv", "--historian", "y"), "give either --traces or --historian")
    misused(decanter(*given, "--traces", "x.csv", "--since", "7d"), "--since belongs to --historian")


def test_a_historian_is_diagnosed_from_a_time_or_a_span_on(model: Path, tmp_path: Path) -> None:
    trace = scenario("cd1")
    path = kept(tmp_path / "h.sqlite", trace)
    for since, rows in (("14d", 401), ("100s", np.count_nonzero(trace.times >= trace.times[-1] - 100.0))):
        assert recent(path, since).times.size == rows
    late = recent(path, "2025-01-10T10:05")
    assert late.times[0] >= 1_736_503_500.0 and late.times.size < 401
    np.testing.assert_array_equal(late.signals["Assorbimento"], trace.signals["Assorbimento"][-late.times.size :])
    given = ("diagnose", "--model", model, "--out", tmp_path / "o", "--historian", path)
    assert only_object(decanter(*given, "--json").stdout)["verdict"] == "too-little-data"
    refused(decanter(*given, "--since", "yesterday"), 2, "'yesterday' is neither a time nor a span")
    refused(decanter(*given, "--since", "2031-01-01"), 2, "there is nothing since 2031-01-01", "2025-01-10T10:07")
    nowhere = ("diagnose", "--model", model, "--out", tmp_path / "o", "--historian", tmp_path / "none.sqlite")
    refused(decanter(*nowhere), 2, "there is no historian")


def test_roles_are_the_maps_own_or_the_models_or_the_decanters() -> None:
    maps, nobodys = ROOT / "config" / "traces", two_modes()
    decanters = load_map(maps / "decanter.toml")
    assert signal_roles(decanters, nobodys) == ROLES
    pump = replace(nobodys, roles={"ambient": "HallTemp"})
    assert signal_roles(decanters, pump) == {"ambient": "HallTemp"}
    for model in (nobodys, pump):
        car = signal_roles(load_map(maps / "carobd.toml"), model)
        assert car == {"current": "Load", "speed": "VehicleSpeed", "ambient": "IntakeAirTemperature"}
        assert signal_roles(load_map(maps / "femto.toml"), model) == {}
    assert parse_model(model_text(pump)) == pump and '"roles"' not in model_text(nobodys)
    fields = set(load_map(maps / "skab.toml").effects.__class__.model_fields)
    assert fields == set(ROLES), "a column map can give every role that the catalogue knows, and no other"


def test_the_cooled_plant_is_the_same_for_a_seed_and_colder_with_its_cooling() -> None:
    plain, again = (cooled_days(1, seed=3, period=60.0)[0] for _ in range(2))
    cooled = cooled_days(1, seed=3, period=60.0, plant=CooledPlant(cooling=1e-4))[0]
    for name, column in plain.signals.items():
        np.testing.assert_array_equal(column, again.signals[name])
    assert plain.synthetic and plain.times[0] == EPOCH_S and plain.times.size == 1440
    difference = cooled.signals["TCuscinettiRiduttore"] - plain.signals["TCuscinettiRiduttore"]
    pumping = (plain.signals["MarciaPmpFango"] > 0) & (plain.signals["MarciaDecanter"] > 0)
    assert difference[pumping].mean() < -0.5 and abs(difference[:300]).max() < 0.5
    with pytest.raises(ValueError, match="at least one day"):
        cooled_days(0, seed=1)


@pytest.mark.timeout(1200)
def test_the_demonstration_names_what_is_hidden_and_nothing_else(tmp_path: Path) -> None:
    misused(decanter("demo", "--discrepancy", "--limit", "80"), "simulates its own plant")
    result = decanter("demo", "--discrepancy", "--out", tmp_path / "demo", "--json")
    assert result.exit_code == 0
    data = only_object(result.stdout)
    assert data["right"] and not data["wrong"] and data["verdict"] in ("named", "class")
    held = data["held_out"]
    assert held["rmse_after"] < 0.7 * held["rmse_before"] and held["ci95"][0] > 0
    assert Path(data["picture"]).stat().st_size > 50_000
    assert not find_model(str(tmp_path / "demo" / "model_before")).runnable().calibration
    new = find_model(data["model_after"]).runnable()
    assert [effect.kind for effect in new.sha.effects] == ["pump-cooling"]
    assert new.provenance.parent and new.provenance.synthetic and new.provenance.method == "diagnose"
