"""`model learn fleet`: many machines, one of them odd; each result kept as it comes, the rest done after a kill."""

import csv
import json
import shutil
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from gateway.lab.fleet import study
from gateway.lab.fleet.sources import find_sources
from sim.artefacts import read_model
from sim.effects import of_machine as of_the_type
from sim.lab.judge import hold_folder
from sim.lab.learning.bins.candidates import CANDIDATES
from sim.lab.learning.bins.learn import learn_bins
from sim.lab.recordings import load_map, write_trace
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
    roles = '\n[effects]\ncurrent = "Assorbimento"\n'
    (folder / "map.toml").write_text(text.replace("TCuscinettiRiduttore", "T") + roles, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        without_bands(patch)
        patch.setattr(study, "learn_bins", partial(learn_bins, candidates=CANDIDATES[:1]))
        done = command(folder, "out")
        assert done.count("held-out error") == len(OFFSETS), done
        yield folder


def command(plant: Path, out: str, *words: object) -> str:
    place = [plant / "machines", "--map", plant / "map.toml", "--out", plant / out]
    result = decanter("model", "learn", "fleet", *place, "--sample", 3, "--jobs", 1, *words)
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
    assert model.roles == {"current": "Assorbimento"}, "a diagnosis of it knows the signals as the map said them"
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


def test_a_machine_whose_data_changed_is_done_again_and_one_that_fails_costs_itself(
    plant: Path, tmp_path: Path
) -> None:
    shutil.copytree(plant / "out", plant / "changed")
    taught = {trace.partition(" ")[0] for trace in read_model(plant / "out/sample").provenance.traces}
    name, *_ = set(OFFSETS) - taught
    own = shutil.copytree(plant / "machines" / name, tmp_path / name)
    try:
        for file in (plant / "machines" / name).iterdir():
            file.write_text("time,MarciaDecanter,Assorbimento,T\n0,0,1.0,20.0\n", encoding="utf-8")
        (empty := plant / "machines" / name / "zz.csv").touch()
        said = command(plant, "changed")
    finally:
        empty.unlink(missing_ok=True)
        # With their times too, by which the other tests' machines are known as done.
        shutil.copytree(own, plant / "machines" / name, dirs_exist_ok=True)
    first, failure, *_ = said.splitlines()
    assert first == f"{len(OFFSETS) - 1} of {len(OFFSETS)} machines are done already"
    assert failure.startswith(f"{name}: ") and "at least 2" in failure
    assert f"{name}: without {empty}: the file is empty" in said, "what was passed over may be why it failed"
    assert name not in read_model(plant / "changed/model").machines


def test_a_file_that_cannot_be_read_beside_good_ones_is_told_also_when_the_machine_is_done_already(
    plant: Path,
) -> None:
    shutil.copytree(plant / "out", plant / "unread")
    taught = {trace.partition(" ")[0] for trace in read_model(plant / "out/sample").provenance.traces}
    name, *_ = set(OFFSETS) - taught
    empty = plant / "machines" / name / "zz.csv"
    empty.touch()
    try:
        new, again = command(plant, "unread"), command(plant, "unread")
        said = only_object(command(plant, "unread", "--json"))
    finally:
        empty.unlink()
    assert f"{len(OFFSETS) - 1} of {len(OFFSETS)} machines are done already\n" in new
    assert f"{len(OFFSETS)} of {len(OFFSETS)} machines are done already\n" in again
    for each in (new, again):
        assert f"{name}: without {empty}: the file is empty" in each
    assert list(said["unread"]) == [name] and not said["failed"]
    assert {row["machine"]: row["files not read"] for row in said["machines"]} == dict.fromkeys(OFFSETS) | {name: 1}


def test_bad_places_are_one_sentence(plant: Path, tmp_path: Path) -> None:
    out = ("--out", tmp_path / "out")
    refused(decanter("model", "learn", "fleet", tmp_path, *out), 2, "no machine")
    refused(decanter("model", "learn", "fleet", "postgresql://127.0.0.1:1/x", *out), 2, "127.0.0.1:1/x", "onnection")
    refused(decanter("model", "learn", "fleet", tmp_path / "x.parquet", *out), 2, "x.parquet")
    with hold_folder(plant / "out"):
        where = ("--map", plant / "map.toml", "--out", plant / "out")
        refused(decanter("model", "learn", "fleet", plant / "machines", *where), 2, "another command is writing there")


def site(plant: Path, folder: Path, *names: str) -> Path:
    """A folder of some of the plant's machines."""
    for name in names:
        shutil.copytree(plant / "machines" / name, folder / "site" / name)
    return folder / "site"


def study_of(plant: Path, place: Path, out: Path, *words: object) -> str:
    result = decanter("model", "learn", "fleet", place, "--map", plant / "map.toml", "--out", out, "--jobs", 1, *words)
    assert result.exit_code == 0, result.output
    return result.stdout


def test_a_file_beside_the_machines_folders_is_a_machine_and_the_commands_own_table_is_none(
    plant: Path, tmp_path: Path
) -> None:
    place = site(plant, tmp_path, "m0", "m1", "m2")
    (place / "summary.csv").write_text("machine,mean\nm0,20\n", encoding="utf-8")
    words = (plant, place, place, "--sample", 1)
    assert study_of(*words).count("held-out error") == 3 and (place / "fleet.csv").is_file()
    assert "3 of 4 machines are done already\n" in study_of(*words)
    said = only_object(study_of(*words, "--json"))
    assert [row["machine"] for row in said["machines"]][-1] == "site", "by this map a machine is what its folder is"
    assert "summary.csv" in said["failed"]["site"] and len(said["machines"]) == 4
    # A machine's own file may be called so too.
    (place / "m0/fleet.csv").write_text((place / "summary.csv").read_text(encoding="utf-8"), encoding="utf-8")
    column_map = load_map(plant / "map.toml")
    files = {source.machine: getattr(source, "files", ()) for source in find_sources(str(place), column_map, "")}
    assert place / "m0/fleet.csv" in files["m0"] and files["site"] == (place / "summary.csv",)


def test_a_machine_that_cannot_teach_is_left_out_of_the_sample_and_another_takes_its_place(
    plant: Path, tmp_path: Path
) -> None:
    place = site(plant, tmp_path, "m0", "m1", "m2")
    for name, content in (
        ("noise", bytes(range(256)) * 9),
        ("short", b"time,MarciaDecanter,Assorbimento,T\n0,0,1,20\n"),
    ):
        (place / name).mkdir()
        (place / name / "day.csv").write_bytes(content)
    names, bad = ["m0", "m1", "m2", "noise", "short"], {"noise", "short"}
    drawn = ([names[each] for each in np.random.default_rng(seed).permutation(5)[:2]] for seed in range(1000))
    words = ("--sample", 1, "--seed", next(seed for seed, two in enumerate(drawn) if two == ["short", "noise"]))
    first, second, *_ = study_of(plant, place, tmp_path / "out", *words).splitlines()
    assert first.startswith("short is not among the machines that teach the type: ") and "1 reading" in first
    assert second.startswith("noise is not among the machines that teach the type: ") and "day.csv" in second
    taught = {trace.split()[0] for trace in read_model(tmp_path / "out/sample").provenance.traces}
    assert len(taught) == 1 and not taught & bad
    again = only_object(study_of(plant, place, tmp_path / "out", *words, "--json"))
    assert set(again["failed"]) == set(again["left_out"]) == bad
    assert "not a text file" in again["failed"]["noise"] and "too few rows" in again["failed"]["short"]
    # One whose data were mended teaches: it is of the sample that was drawn.
    shutil.copytree(plant / "machines/m4", place / "noise", dirs_exist_ok=True)
    (place / "noise/day.csv").unlink()
    mended = only_object(study_of(plant, place, tmp_path / "out", *words, "--json"))
    assert set(mended["failed"]) == set(mended["left_out"]) == {"short"}
    assert {"noise"} == {trace.split()[0] for trace in read_model(tmp_path / "out/sample").provenance.traces}


def test_where_no_machine_can_teach_the_command_says_so_in_one_sentence(plant: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / "site" / name).mkdir(parents=True)
        (tmp_path / "site" / name / "day.csv").touch()
    where = (tmp_path / "site", "--map", plant / "map.toml", "--out", tmp_path / "out")
    refused(
        decanter("model", "learn", "fleet", *where, "--sample", 1),
        2,
        "none of 2 machines can teach",
        "day.csv",
        "is empty",
    )


Edit = Callable[[dict[str, Any]], Any]


@pytest.mark.parametrize(
    ("line", "edit", "words"),
    [
        (1, lambda row: row.pop("between"), "between: is missing"),
        (1, lambda row: row.update(between="wide"), "between: must be a number, got 'wide'"),
        (1, lambda row: row.update(type=7), "type: must be text"),
        (2, lambda row: row.pop("key"), "key: is missing"),
        (2, lambda row: row.pop("machine"), "machine: is missing"),
        (3, lambda row: row.pop("grouped"), "grouped: is missing"),
        (3, lambda row: row.update(grouped=[]), "grouped: "),
        (3, lambda row: row["grouped"]["ON"].pop("error"), "grouped.ON.error: is missing"),
        (3, lambda row: row["grouped"].update(SOMEWHERE=row["grouped"]["ON"]), "grouped: 'SOMEWHERE' is no group"),
        (4, lambda row: row.pop("offset"), "offset: is missing"),
        (4, lambda row: row.update(offset=None), "offset: must be a number"),
        (4, lambda row: row.update(offset=float("nan")), "offset: "),
        (4, lambda row: row.update(effects="ambient"), "effects: "),
        (4, lambda row: row.update(held_out={"mine": 1.0}), "held_out"),
    ],
)
def test_a_row_that_was_edited_by_hand_is_one_sentence_with_its_line_and_key(
    plant: Path, tmp_path: Path, line: int, edit: Edit, words: str
) -> None:
    shutil.copytree(plant / "out", tmp_path / "out")
    file = tmp_path / "out/results.jsonl"
    rows = [json.loads(row) for row in file.read_text(encoding="utf-8").splitlines()]
    edit(rows[line - 1])
    file.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")
    where = (plant / "machines", "--map", plant / "map.toml", "--out", tmp_path / "out", "--sample", 3)
    refused(decanter("model", "learn", "fleet", *where), 2, f"results.jsonl:{line}: ", words, "take that line out")


def test_a_row_that_is_taken_out_is_done_again_and_a_held_out_error_may_be_unknown(plant: Path, tmp_path: Path) -> None:
    shutil.copytree(plant / "out", tmp_path / "out")
    file = tmp_path / "out/results.jsonl"
    first, second, third, *others = file.read_text(encoding="utf-8").splitlines()
    row = json.loads(third)
    row["held_out"]["type"] = None
    file.write_text("\n".join((first, json.dumps(row), *others)) + "\n", encoding="utf-8")
    said = study_of(plant, plant / "machines", tmp_path / "out", "--sample", 3)
    assert said.startswith(f"{len(OFFSETS) - 1} of {len(OFFSETS)} machines are done already\n")
    assert said.count("held-out error") == 1 and f"\n{json.loads(second)['machine']}: targets" in said


def samples() -> pd.DataFrame:
    """The table `samples` of two machines with a minute of readings each, as an export has it."""
    times = pd.date_range("2026-01-01", periods=60, freq="s", tz="UTC")
    one = pd.DataFrame({"time": times, "tag": "T", "value": np.linspace(20.0, 30.0, 60), "quality": "GOOD"})
    table = pd.concat([one.assign(machine=name) for name in ("m0", "m1")], ignore_index=True)
    return table.astype({"machine": object, "tag": object, "quality": object})


@pytest.mark.parametrize(
    ("column", "values", "words"),
    [
        ("time", 1.5, ("it holds double", "timestamps are needed")),
        ("time", "yesterday", ("it holds", "string", "timestamps are needed")),
        ("value", "warm", ("it holds", "string", "numbers (null for a text) are needed")),
        ("machine", None, ("row 1 has none", "the name of its machine")),
        ("machine", 7, ("it holds int64", "texts are needed")),
        ("quality", 0, ("it holds int64", "texts are needed")),
        ("quality", "NOPE", ("'NOPE'", "'T'", "'m0'", "known are GOOD")),
        ("quality", [None] * 3 + ["GOOD"] * 117, ("3 of 60 rows of machine 'm0' have none",)),
        ("time", [pd.NaT] + [pd.Timestamp("2026-01-01", tz="UTC")] * 119, ("1 of 60 rows of machine 'm0' have none",)),
    ],
)
def test_a_parquet_column_of_another_kind_is_one_sentence_with_file_and_column(
    tmp_path: Path, column: str, values: Any, words: tuple[str, ...]
) -> None:
    table, file = samples(), tmp_path / "x.parquet"
    table[column] = values
    table.to_parquet(file)
    result = decanter("model", "learn", "fleet", file, "--out", tmp_path / "out", "--temperature", "T", "--jobs", 1)
    refused(result, 2, f"x.parquet: column '{column}': ", *words)


def test_a_machine_with_a_quality_that_is_none_costs_itself(plant: Path, tmp_path: Path) -> None:
    parts = []
    for number, name in enumerate(("m0", "m1", "wrong")):
        for trace in of_machine(name, float(number), 200 + number, cycles=4):
            times = pd.to_datetime((trace.times * 1e9).astype("int64") + 17, utc=True)
            parts += [
                pd.DataFrame({"machine": name, "time": times, "tag": tag, "value": values, "quality": "GOOD"})
                for tag, values in trace.signals.items()
            ]
    table = pd.concat(parts, ignore_index=True)
    table.loc[table["machine"] == "wrong", "quality"] = "NOPE"
    # Categories, and nanoseconds: as pandas has them.
    table.astype({"machine": "category", "tag": "category"}).to_parquet(tmp_path / "x.parquet")
    said = only_object(study_of(plant, tmp_path / "x.parquet", tmp_path / "out", "--json"))
    assert list(said["failed"]) == list(said["left_out"]) == ["wrong"]
    assert "x.parquet: column 'quality': 'NOPE'" in said["failed"]["wrong"]
