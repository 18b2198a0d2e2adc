"""What serves other needs can be left out: nothing else notices, and what asks for it says what is missing."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from drivers.driver import open_driver
from drivers.settings import ConfigError
from drivers.tag import DType, Quality, Tag
from gateway.plant.shortfalls import NORTHBOUND, load_sink_secrets, of_plant
from gateway.settings import load_plant
from sim.lab.recordings import write_trace
from tests.gateway.support import ROOT, plant_file
from tests.rig.left_out import ROOMS, SINKS
from tests.rig.pair import restless_trace


def without(rooms: str, *words: object, folder: Path) -> "subprocess.CompletedProcess[str]":
    """What `decanter` says in a folder, in a process of its own that has not these rooms."""
    command = [sys.executable, "-m", "tests.rig.left_out", rooms, *map(str, words)]
    variables = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder, env=variables, timeout=300)


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a trace, a log of a vehicle, and a set of the public learner's files."""
    folder = tmp_path_factory.mktemp("home")
    write_trace(restless_trace(200.0), folder / "trace.csv")
    (folder / "log.txt").write_text("(1.000000) can0 7E8#0341057B\n", encoding="utf-8")
    (folder / "foreign").mkdir()
    for name in ("set_source.txt", "set.txt"):
        (folder / "foreign" / name).touch()
    return folder


def test_without_all_of_them_a_gateway_runs_and_a_model_is_learned_and_shown(home: Path) -> None:
    plant = plant_file(home)
    commands: list[tuple[object, ...]] = [
        ("--help",),
        ("model", "--help"),
        ("plc", "check", "--offline", "--config", ROOT / "config" / "plant.toml"),
        ("app", plant),
        ("model", "learn", "--traces", "trace.csv", "--out", "learned"),
        ("model", "show", "learned"),
    ]
    words = [word for command in commands for word in (*command, "then")][:-1]
    done = without(",".join((*ROOMS, *SINKS)), *words, folder=home)
    assert done.returncode == 0, done.stderr
    assert "fleet" in done.stdout and "ok       places" in done.stdout
    assert (home / "learned" / "model.json").is_file()
    assert not list((home / "learned").glob("*_source.txt")), "the public learner's files are what is left out"


@pytest.mark.parametrize("room", ROOMS)
def test_the_command_that_needs_it_says_what_is_missing_in_one_sentence(room: str, home: Path) -> None:
    done = without(room, *ROOMS[room], folder=home)
    said = done.stderr.strip()
    assert done.returncode in (2, 3) and said.startswith("decanter: ") and "\n" not in said, done.stderr
    assert f"needs {room}" in said and said.endswith("install decanter-gateway whole")


@pytest.mark.parametrize("sink", SINKS)
def test_a_section_that_needs_it_is_refused_by_its_name(
    sink: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant = plant_file(tmp_path, SINKS[sink])
    monkeypatch.setitem(sys.modules, sink, None)  # as the import system has it: ModuleNotFoundError
    with pytest.raises(ConfigError, match=rf"northbound\.\w+: needs {sink}, a part of the program"):
        load_sink_secrets(load_plant(plant)[0])
    # A running gateway goes without, under an alarm that stands, and the commissioning check says the same.
    assert sink in of_plant(load_plant(plant)[0])[NORTHBOUND]


async def test_a_bus_is_read_without_the_vehicles_and_their_tags_say_what_is_missing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "drivers.vehicle.live", None)
    driver = open_driver("can", {"interface": "virtual", "channel": "left out"}, clock=time.time)
    speed, field = Tag("Speed", "obd:0D", DType.FLOAT32), Tag("Load", "0x181:16|16", DType.UINT16)
    found, plain = await driver.read([speed, field])
    assert found.quality is Quality.CONFIGURATION_ERROR and "obd:0D needs drivers.vehicle.live" in found.reason
    assert plain.quality is Quality.NOT_CONNECTED
    await driver.close()
