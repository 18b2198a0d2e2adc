"""`decanter model fleet`: many machines, one of them odd; each result kept as it comes, the rest done after a kill."""

import csv
import json
import shutil
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from gateway.lab.fleet import study
from sim.artefacts import read_model
from sim.effects import of_machine as of_the_type
from sim.learning.bins.candidates import CANDIDATES
from sim.learning.bins.learn import learn_bins
from sim.traces import write_trace
from sim.validation import held
from tests.cli.support import ROOT, decanter, only_object, refused
from tests.learning.test_machines import of_machine
from tests.rig.no_bands import without_bands

OFFSETS = {"m0": -1.6, "m1": 2.0, "m2": 0.5, "odd": 15.0, "m4": -0.4, "m5": 0.9, "m6": -2.0}


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder of machines, a map for them, and a study of them in `out`."""
    folder = tmp_path_factory.mktemp("fleet")
    for seed, (name, offset) in enumerate(OFFSETS.items()):
        (own := folder / "machines" / name).mkdir(parents=True)
        for trace in of_machine(name, offset, 100 + seed, cycles=4):
            write_trace(trace, own / f"{trace.name}.csv")
    text = (ROOT / "config/traces/decanter.toml").read_text(encoding="utf-8")
    (folder / "map.toml").write_text(text.replace("TCuscinettiRiduttore", "T"), encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        without_bands(patch)
        patch.setattr(study, "learn_bins", partial(learn_bins, candidates=CANDIDATES[:1]))
        done = command(folder, "out")
        assert done.count("held-out error") == len(OFFSETS), done
        yield folder


def command(plant: Path, out: str, *words: object) -> str:
    place = [plant / "machines", "--map", plant / "map.toml", "--out", plant / out]
    result = decanter("model", "fleet", *place, "--sample", 3, "--jobs", 1, *words)
    assert result.exit_code == 0, result.output
    return result.stdout


def test_the_odd_machine_is_found_and_each_has_its_own_targets_in_the_types_model(plant: Path) -> None:
    said = only_object(command(plant, "out", "--json"))
    assert list(said["outstanding"]) == ["odd"] and not said["failed"]
    assert said["machines"][0]["machine"] == "odd" and "running" in said["machines"][0]["stands out"]
    assert {row["stands out"] for row in said["machines"][1:]} == {"no"}
    places = said["outstanding"]["odd"]
    assert {"at rest", "running"} <= {place["where"] for place in places}
    assert all(place["beyond"] > 5 * place["differ"] for place in places)
    assert said["machines"][0]["corrected"] < 0.5 * said["machines"][0]["type"]
    model = read_model(Path(said["model"]))
    assert set(model.machines) == set(OFFSETS)
    assert of_the_type(model, "odd").sha.high > model.sha.high
    with (plant / "out/fleet.csv").open(encoding="utf-8") as file:
        assert sorted(row["machine"] for row in csv.DictReader(file)) == sorted(OFFSETS)
    assert Path(said["picture"]).read_bytes().startswith(b"\x89PNG")


def test_after_a_kill_only_what_was_not_done_is_done(plant: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(plant / "out", plant / "killed")
    file = plant / "killed/results.jsonl"
    rows = file.read_text(encoding="utf-8").splitlines()
    file.write_text("\n".join(rows[:-2]) + "\n" + rows[-2][:40], encoding="utf-8")
    monkeypatch.setattr(study, "learn_bins", lambda *_, **__: pytest.fail("the type's model is there"))
    said = command(plant, "killed")
    assert said.startswith(f"{len(OFFSETS) - 2} of {len(OFFSETS)} machines are done already\n")
    assert said.count("held-out error") == 2
    again = [json.loads(row) for row in file.read_text(encoding="utf-8").splitlines()]
    costs = {"cpu_s": 0, "peak_mb": 0}
    assert [row | costs for row in again] == [json.loads(row) | costs for row in rows]


def test_a_machine_whose_data_changed_is_done_again_and_one_that_fails_costs_itself(plant: Path) -> None:
    shutil.copytree(plant / "out", plant / "changed")
    taught = {trace.partition(" ")[0] for trace in read_model(plant / "out/sample").provenance.traces}
    name, *_ = set(OFFSETS) - taught
    files = {file: file.read_text(encoding="utf-8") for file in (plant / "machines" / name).iterdir()}
    try:
        for file in files:
            file.write_text("time,MarciaDecanter,Assorbimento,T\n0,0,1.0,20.0\n", encoding="utf-8")
        said = command(plant, "changed")
    finally:
        for file, text in files.items():
            file.write_text(text, encoding="utf-8")
    first, failure, *_ = said.splitlines()
    assert first == f"{len(OFFSETS) - 1} of {len(OFFSETS)} machines are done already"
    assert failure.startswith(f"{name}: ") and "at least 2" in failure
    assert name not in read_model(plant / "changed/model").machines


def test_bad_places_are_one_sentence(plant: Path, tmp_path: Path) -> None:
    out = ("--out", tmp_path / "out")
    refused(decanter("model", "fleet", tmp_path, *out), 2, "no machine")
    refused(decanter("model", "fleet", "postgresql://127.0.0.1:1/x", *out), 2, "127.0.0.1:1/x", "onnection")
    refused(decanter("model", "fleet", tmp_path / "x.parquet", *out), 2, "x.parquet")
    with held(plant / "out"):
        where = ("--map", plant / "map.toml", "--out", plant / "out")
        refused(decanter("model", "fleet", plant / "machines", *where), 2, "another command is writing there")
