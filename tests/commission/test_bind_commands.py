"""`decanter plc bind` and `import`: new files by commands alone, changes shown and recorded, bad rows write nothing."""

import json
import tomllib
from pathlib import Path
from typing import Any

import pytest

from gateway.commission.session.records import find_break, read_records
from gateway.settings.config import load_config, load_plant
from gateway.settings.devices import load_device
from tests.commission.bench import answer, plc
from tests.plc.bench import DECANTER

LIST = "Tag;Address;Type;Unit\nTCuscinettiRiduttore;40106;REAL;°C\nPlcHeartbeat;40113;WORD;\n"


def imported(folder: Path, text: str = LIST, *more: object) -> dict[str, Any]:
    (folder / "list.csv").write_text(text, encoding="utf-8")
    where = ("--config", folder / "plant.toml", "--host", "10.0.0.7", "--port", 1502, "--unit", 3)
    return answer(folder, "import", folder / "list.csv", *where, *more)


def test_a_list_makes_both_files_with_each_setting_where_it_belongs(tmp_path: Path) -> None:
    keep = ("--keep", "max_registers=16", "--keep", "scan.period=2.5", "--timeout", 0.3)
    data = imported(tmp_path, LIST, "--shift", 1, "--order", "CDAB", "--heartbeat", "PlcHeartbeat", *keep)
    assert data["ok"] and data["written"] and len(data["new"]) == 2 and not data["backups"]
    config = load_config(tmp_path / "plant.toml")
    assert config.scan.period == 2.5
    assert config.links[0].settings | {"host": "10.0.0.7", "port": 1502, "unit": 3, "timeout": 0.3} == (
        config.links[0].settings
    )
    tag = config.map.by_name["TCuscinettiRiduttore"]
    assert (tag.address, tag.dtype, tag.order, tag.unit) == ("holding:106", "float32", "CDAB", "degC")
    assert config.map.settings == {"unit": 3, "max_registers": 16} and config.map.heartbeat == "PlcHeartbeat"


def test_the_same_list_again_changes_nothing(tmp_path: Path) -> None:
    imported(tmp_path)
    data = imported(tmp_path)
    assert data["ok"] and not data["written"] and data["diff"] == ""
    assert not list(tmp_path.rglob("*.bak"))


def test_a_bad_row_writes_nothing_unless_it_is_skipped(tmp_path: Path) -> None:
    text = LIST + "Schlecht;nowhere;INT;\n"
    data = imported(tmp_path, text)
    assert data["exit"] == 1 and "line 4" in data["problems"][0] and not (tmp_path / "plant.toml").exists()
    data = imported(tmp_path, text, "--skip-bad")
    assert data["ok"] and (tmp_path / "plant.toml").exists() and "line 4" in data["open_points"][0]


def test_a_bound_tag_keeps_what_is_not_said_and_its_comments(tmp_path: Path) -> None:
    device = tmp_path / "plc.toml"
    device.write_bytes(DECANTER.read_bytes())
    data = answer(tmp_path, "bind", "Coppia", "40201", "--type", "float32", "--order", "CDAB", "--device", device)
    assert data["ok"] and len(data["backups"]) == 1
    before, after = load_device(DECANTER).by_name["Coppia"], load_device(device).by_name["Coppia"]
    assert (after.address, after.dtype, after.order, after.scale) == ("holding:200", "float32", "CDAB", 1.0)
    assert (after.unit, after.high, after.sentinel) == (before.unit, before.high, before.sentinel)
    comments = DECANTER.read_text(encoding="utf-8").count("#")
    assert device.read_text(encoding="utf-8").count("#") == comments


def test_limits_alone_leave_the_place_as_it_is(tmp_path: Path) -> None:
    device = tmp_path / "plc.toml"
    device.write_bytes(DECANTER.read_bytes())
    assert answer(tmp_path, "bind", "Coppia", "--high", 99.5, "--device", device)["ok"]
    wanted = tomllib.loads(DECANTER.read_text(encoding="utf-8"))
    next(tag for tag in wanted["tags"] if tag["name"] == "Coppia")["high"] = 99.5
    assert tomllib.loads(device.read_text(encoding="utf-8")) == wanted


def test_a_block_takes_as_many_words_as_the_plc_does(tmp_path: Path) -> None:
    imported(tmp_path, LIST, "--keep", "max_registers=16")
    data = answer(
        tmp_path, "bind", "--block", "40402", "--keep", "writeback.mode=shadow", "--config", tmp_path / "plant.toml"
    )
    assert data["ok"], data
    config = load_config(tmp_path / "plant.toml")
    block = config.map.writeback
    assert block is not None and len(block.words) == 16 and block.words[0].address == "holding:401"
    assert [word.name for word in block.words][-2:] == ["Writeback.crc", "Writeback.sequence_copy"]
    assert config.writeback.mode == "shadow"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("X", "holding:5", "--type", "float32"), ("which file?",)),
        (("X", "house", "--device", "new.toml"), ("'house' is no register",)),
        (("X", "--guess", 1, "--device", "new.toml"), ("holds no guess",)),
        (("X", "--device", "new.toml"), ("where is 'X'?",)),
        (("--keep", "scan.period=1", "--device", "new.toml"), ("plant file", "--config")),
        (("X", "holding:5", "--bit", 3, "--type", "int16", "--scale", 0, "--device", "new.toml"), ("scale 0",)),
    ],
)
def test_what_cannot_be_bound_is_one_sentence_and_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[object, ...], words: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    result = plc(tmp_path, "bind", *arguments)
    assert result.exit_code == 2 and all(word in result.stderr for word in words), result.stderr
    assert "Traceback" not in result.output and not list(tmp_path.glob("*.toml"))


def test_every_change_is_recorded_with_its_diff_and_the_new_hash(tmp_path: Path) -> None:
    imported(tmp_path)
    config = tmp_path / "plant.toml"
    answer(tmp_path, "bind", "TCuscinettiRiduttore", "--high", 150, "--config", config)
    first, second = read_records(tmp_path / "records.jsonl")
    assert (first.command, second.command) == ("import", "bind") and second.who == "the engineer"
    assert "+high = 150.0" in second.result["diff"]
    device = str(tmp_path / "devices/plant.toml")
    assert first.configuration[device] != second.configuration[device]
    assert find_break(tmp_path / "records.jsonl") is None


def test_a_dry_run_shows_the_change_and_writes_nothing(tmp_path: Path) -> None:
    data = imported(tmp_path, LIST, "--dry-run")
    assert data["ok"] and not data["written"] and '+name = "TCuscinettiRiduttore"' in data["diff"]
    assert not (tmp_path / "plant.toml").exists()


def test_a_plant_that_names_another_temperature_says_what_to_keep(tmp_path: Path) -> None:
    data = imported(tmp_path, "Tag;Address\nTT1;40001\n")
    assert data["exit"] == 2 and "model.temperature" in data["reason"] and "is written" in data["reason"]
    assert json.loads(json.dumps(data))["reason"].count("\n") == 0
    assert imported(tmp_path, "Tag;Address\nTT1;40001\n", "--keep", "model.temperature=TT1")["ok"]


def test_links_of_other_kinds_get_their_own_table(tmp_path: Path) -> None:
    (tmp_path / "list.csv").write_text(LIST, encoding="utf-8")
    where = ("--config", tmp_path / "plant.toml", "--serial", "/dev/ttyUSB0", "--baud", 9600, "--unit", 5)
    assert answer(tmp_path, "import", tmp_path / "list.csv", *where)["ok"]
    link = load_config(tmp_path / "plant.toml").links[0]
    assert link.settings["serial"] == "/dev/ttyUSB0" and link.settings["baud"] == 9600 and link.settings["unit"] == 5


SEVERAL = """
[device]
file = "plc.toml"

[model]
temperature = "TCuscinettiRiduttore"   # of all

[[machine]]
name = "north"
device = { host = "10.0.0.7" }

[[machine]]
name = "south"

[machine.device]
host = "10.0.0.8"   # behind the switch
"""


def several(folder: Path) -> Path:
    (folder / "plc.toml").write_bytes(DECANTER.read_bytes())
    (folder / "plant.toml").write_text(SEVERAL, encoding="utf-8")
    return folder / "plant.toml"


@pytest.mark.parametrize("machine", ["north", "south"])
def test_of_several_machines_the_one_that_is_named_is_changed(tmp_path: Path, machine: str) -> None:
    path = several(tmp_path)
    before = {config.machine: config for config in load_plant(path)}
    keep = ("--keep", "scan.period=2.5", "--keep", "historian.max_mb=64.0", "--keep", "serve.unit=9")
    model = ("--keep", "temperature.TCuscinettiAlimentazione.limit=70.0")
    place = ("--host", "10.0.0.9", "--unit", 4)
    data = answer(tmp_path, "bind", "Coppia", "40201", "--config", path, "--machine", machine, *place, *keep, *model)
    assert data["ok"] and len(data["backups"]) == 2, data
    after = {config.machine: config for config in load_plant(path)}
    changed, other = after.pop(machine), next(iter(after.values()))
    assert changed.links[0].settings["host"] == "10.0.0.9" and changed.scan.period == 2.5 and changed.serve.unit == 9
    assert [row.tag for row in changed.temperatures] == ["TCuscinettiRiduttore", "TCuscinettiAlimentazione"]
    assert changed.historian.max_mb == other.historian.max_mb == 64.0
    was = before[other.machine]
    assert other.device == was.device and other.scan == was.scan and other.temperatures == was.temperatures
    assert changed.map.by_name["Coppia"].address == "holding:200"
    text = path.read_text(encoding="utf-8")
    assert "# of all" in text and "# behind the switch" in text


def test_of_several_machines_one_has_to_be_named(tmp_path: Path) -> None:
    path = several(tmp_path)
    for more, words in (((), "name one of them with --machine: north, south"), (("--machine", "w"), "no machine 'w'")):
        result = plc(tmp_path, "bind", "Coppia", "40201", "--config", path, *more)
        assert result.exit_code == 2 and words in result.stderr, result.stderr
    assert path.read_text(encoding="utf-8") == SEVERAL


def test_a_list_is_taken_into_the_device_file_of_the_machine_that_is_named(tmp_path: Path) -> None:
    path = several(tmp_path)
    path.write_text(f'{SEVERAL}file = "south.toml"\n', encoding="utf-8")
    (tmp_path / "south.toml").write_bytes(DECANTER.read_bytes())
    (tmp_path / "list.csv").write_text("Tag;Address;Type\nPressione;40301;REAL\n", encoding="utf-8")
    data = answer(tmp_path, "import", tmp_path / "list.csv", "--config", path, "--machine", "south")
    assert data["ok"] and data["files"] == [str(tmp_path / "south.toml")]
    north, south = load_plant(path)
    assert "Pressione" in south.map.by_name and "Pressione" not in north.map.by_name


def test_links_that_all_machines_have_are_not_changed_for_one(tmp_path: Path) -> None:
    path = several(tmp_path)
    links = '[[device.links]]\nname = "net"\nfile = "plc.toml"\nhost = "10.0.0.1"\n'
    path.write_text(f'{links}[[machine]]\nname = "north"\n', encoding="utf-8")
    result = plc(tmp_path, "bind", "Coppia", "40201", "--config", path, "--host", "10.0.0.2")
    assert result.exit_code == 2 and "device.links: is common to all machines" in result.stderr
