"""Slips in a plant file: each is noticed by the one judge, in a sentence with its key, and every command says it."""

import shutil
from itertools import cycle
from pathlib import Path

import pytest

from tests.cli.support import decanter, refused
from tests.rig.broken_plants import COMMANDS, judge_plant, seed_with_device, slips, spoiled_plants
from tests.rig.broken_starts import seed


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plant file that is in order."""
    folder = tmp_path_factory.mktemp("broken") / "plant"
    seed(folder)
    assert judge_plant(folder / "plant.toml").sentences == ()
    return folder / "plant.toml"


def test_no_slip_of_a_plant_file_passes_and_its_key_is_named(plant: Path) -> None:
    whole, passed, keyless = plant.read_text(encoding="utf-8"), [], []
    for slip in slips():
        plant.write_text(slip.text(whole), encoding="utf-8")
        said = judge_plant(plant)
        # A limit is said to be that of its tag, whatever the table; a file that cannot be read, by its name.
        files = [slip.value] if slip.key == "device.file" else []
        names = ("limit", *files, *(part for part in slip.key.split(".") if not part.isdigit()))
        if not said.sentences:
            passed.append(str(slip))
        elif not any(name in sentence for name in names for sentence in said.sentences):
            keyless.append(f"{slip}: {said.sentences[0]}")
    plant.write_text(whole, encoding="utf-8")
    assert passed == [] and keyless == []


@pytest.mark.parametrize(
    ("key", "value"), [("log.path", "secrets.toml"), ("alarms.tags", ["MarciaDecanter"]), ("forecast.horizons", [1e9])]
)
def test_every_command_that_reads_a_plant_file_refuses_what_one_refuses(plant: Path, key: str, value: object) -> None:
    whole = plant.read_text(encoding="utf-8")
    (slip,) = (slip for slip in slips() if (slip.key, slip.value) == (key, value))
    plant.write_text(slip.text(whole), encoding="utf-8")
    try:
        (sentence,) = judge_plant(plant).sentences
        commands = (
            "run",
            "status",
            "reload",
            "plc check --offline",
            "plc plan",
            "machine list",
            "machine remove second",
        )
        for words in map(str.split, commands):
            refused(decanter(*words, "--config", plant), 2, sentence)
    finally:
        plant.write_text(whole, encoding="utf-8")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plant with a device file of its own, in order."""
    folder = tmp_path_factory.mktemp("spoiled") / "whole"
    seed_with_device(folder)
    assert judge_plant(folder / "plant.toml").sentences == ()
    return folder


def test_what_people_mistype_is_told_with_its_place_and_its_remedy_by_every_command(
    whole: Path, tmp_path: Path
) -> None:
    missed, apart = [], []
    commands = cycle(COMMANDS)
    for number, (what, spoil, words) in enumerate(spoiled_plants()):
        folder = tmp_path / str(number)
        shutil.copytree(whole, folder, symlinks=True)
        spoil(folder)
        said = judge_plant(folder / "plant.toml")
        if not any(words in sentence for sentence in said.sentences):
            missed.append((what, words, said.sentences[:1]))
        # One command a slip, in turn: `python -m benchmarks.broken_plants` asks them all.
        if said.refused:
            command = next(commands)
            told = decanter(*command.split(), "--config", folder / "plant.toml")
            if told.exit_code != 2 or words not in " ".join(told.stderr.split()):
                apart.append((what, command, told.exit_code, told.stderr[-200:]))
    assert missed == [] and apart == []
