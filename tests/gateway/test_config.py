"""The configuration and the register map: what is wrong is said at once, each thing in one sentence."""

import subprocess
import sys
from pathlib import Path

import pytest

from drivers.settings import ConfigError
from gateway.settings.config import load_config
from gateway.settings.devices import load_device
from tests.gateway.support import MAP, ROOT, TEMPERATURE, config_in, plant_file, two_modes


def problems(path: Path) -> tuple[str, ...]:
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    return caught.value.problems


def written(folder: Path, text: str) -> Path:
    path = folder / "plant.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_shipped_configuration_is_valid_and_writes_nothing() -> None:
    config = load_config(ROOT / "config/plant.toml")
    assert config.writeback.mode == "off"
    assert config.model.path is None
    assert config.alarms.limit == 80.0
    assert config.map.path == ROOT / "config/devices/decanter_plc.toml"
    assert config.historian.path.is_absolute()


def test_all_that_is_wrong_is_said_at_once_with_file_key_reason_and_remedy(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        f'[device]\nfile = "{MAP}"\nport = "12"\nprt = 3\n[scan]\nperiod = -1\n[forecast]\nhorizons = [3, 2]\n'
        "[historian]\npath = 3\n[devce]\n",
    )
    found = problems(path)
    assert len(found) == 6
    assert all(problem.startswith(f"{path}: ") and "\n" not in problem and ";" in problem for problem in found)
    text = "\n".join(found)
    assert "device.port: must be a whole number, got '12'; give a TCP port from 1 to 65535" in text
    assert "device.prt: there is no such key; did you mean 'port'?" in text
    assert "devce: there is no such key; did you mean 'device'?" in text
    assert "scan.period" in text and "got -1" in text
    assert "forecast.horizons: [3.0, 2.0] must be positive and ascending" in text


def test_an_unknown_key_far_from_any_other_is_answered_by_the_known_ones(tmp_path: Path) -> None:
    (problem,) = problems(plant_file(tmp_path, "[scan]\nzzzzzz = 1"))
    assert problem.endswith("scan.zzzzzz: there is no such key; known are period, on_change")


@pytest.mark.parametrize(
    ("keys", "missing"),
    [
        ("", "armed_by, reason, minutes"),
        ('armed_by = "Ada"\nminutes = 5', "reason"),
        ('armed_by = "Ada"\nreason = "test"', "minutes"),
    ],
)
def test_arming_without_name_reason_and_minutes_is_refused(tmp_path: Path, keys: str, missing: str) -> None:
    (problem,) = problems(plant_file(tmp_path, f'[writeback]\nmode = "armed"\n{keys}'))
    assert f"mode 'armed' also needs {missing};" in problem


def test_arming_for_longer_than_480_minutes_is_refused(tmp_path: Path) -> None:
    text = '[writeback]\nmode = "armed"\narmed_by = "Ada"\nreason = "test"\nminutes = 481'
    (problem,) = problems(plant_file(tmp_path, text))
    assert "writeback.minutes" in problem and "480" in problem


@pytest.mark.parametrize("host", ["192.168.1.10", "plc.example", "0.0.0.0"])
def test_a_speed_is_refused_for_any_host_that_is_not_loopback(tmp_path: Path, host: str) -> None:
    (problem,) = problems(plant_file(tmp_path, f'host = "{host}"\n[clock]\nspeed = 60'))
    assert "clock.speed" in problem and host in problem


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "localhost"])
def test_a_speed_is_accepted_for_loopback(tmp_path: Path, host: str) -> None:
    assert config_in(tmp_path, f'host = "{host}"\n[clock]\nspeed = 60').clock.speed == 60.0


def test_names_that_are_no_tags_a_model_that_is_not_there_and_a_strange_horizon_are_named(tmp_path: Path) -> None:
    text = (
        '[model]\npath = "nowhere"\ntemperature = "T"\n[alarms]\ntags = ["TX"]\n'
        '[writeback]\nmode = "shadow"\nhorizon = 7'
    )
    found = "\n".join(problems(plant_file(tmp_path, text)))
    for part in ("model.temperature: 'T' is not a tag", "alarms.tags: 'TX'", "model.path: there is nothing at", "7 is"):
        assert part in found


def test_relative_paths_are_relative_to_the_file_and_overrides_to_the_working_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "deep").mkdir()
    config = config_in(tmp_path / "deep", model=two_modes())
    assert config.model.path == tmp_path / "deep" / "model.json"
    assert config.historian.path == tmp_path / "deep" / "history.sqlite"
    given = load_config(config.path, {"historian.path": Path("here.sqlite"), "device.port": 15020})
    assert given.historian.path == tmp_path / "here.sqlite"
    assert given.device.port == 15020


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"[device\n", "is not TOML"),
        (b"\xff\xfe", "is not UTF-8"),
        (None, "there is no such file"),
    ],
)
def test_a_file_that_cannot_be_read_is_one_sentence(tmp_path: Path, content: bytes | None, reason: str) -> None:
    path = tmp_path / "plant.toml"
    if content is not None:
        path.write_bytes(content)
    (problem,) = problems(path)
    assert problem.startswith(f"{path}: ") and reason in problem


def test_a_directory_in_place_of_the_file_is_one_sentence(tmp_path: Path) -> None:
    (problem,) = problems(tmp_path)
    assert "cannot be read" in problem


def test_the_configuration_does_not_import_plotting_or_tables() -> None:
    heavy = "{'pandas', 'matplotlib', 'numpy', 'pymodbus'}"
    code = f"import sys, gateway.settings.config; print(sorted({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "[]"


# ---------------------------------------------------------------- the register map


def test_the_shipped_register_map_gives_tags_settings_heartbeat_and_a_closed_write_map() -> None:
    device = load_device(MAP)
    assert device.settings == {"unit": 1, "max_registers": 125, "max_gap": 16}
    assert device.heartbeat == "PlcHeartbeat"
    assert device.by_name[TEMPERATURE].unit == "degC"
    assert device.by_name["LastRefusal"].labels[3] == "CRC"
    assert device.writeback is not None
    assert [word.address for word in device.writeback.words] == [f"holding:{400 + index}" for index in range(26)]
    assert all(word.writable for word in device.writeback.words)
    assert not any(tag.writable for tag in device.tags)


def edited(folder: Path, old: str, new: str) -> Path:
    text = MAP.read_text(encoding="utf-8")
    assert old in text
    path = folder / "device.toml"
    path.write_text(text.replace(old, new), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('name = "Coppia"', 'name = "Assorbimento"', "'Assorbimento' is already used"),
        ("low = 0\nhigh = 350", "low = 400\nhigh = 350", "low: 400.0 is not below high 350.0"),
        ('heartbeat = "PlcHeartbeat"', 'heartbeat = "Pulse"', "device.heartbeat: 'Pulse' is not a tag"),
        ('driver = "modbus"', 'driver = "modbsu"', "device.driver: 'modbsu' is no driver; give one of can"),
        ('dtype = "float32"\norder = "CDAB"', 'dtype = "float33"\norder = "CDAB"', "dtype: must be"),
        ("scale = 0.1\nunit", "scale = 0\nunit", "scale 0 would make every reading 0"),
        ("max_rate = 5", "max_rat = 5", "did you mean 'max_rate'?"),
        ('    { name = "crc", dtype = "uint16" },\n', "", "'crc' is missing"),
        ("[device]", '[[groups]]\nperiod = 60\ntags = ["Energy*"]\n[device]', "groups[0].tags: 'Energy*' is no tag"),
        ("max_rate = 5", 'scale_from = "holding:9"\nwritable = true', "what is written has a scale of its own"),
        ("max_rate = 5", 'scale_from = "holding:9"\nbit = 1', "scale_from: "),
        ('{ name = "zone", dtype = "uint16" }', '{ name = "zoen", dtype = "uint16" }', "writeback.fields[18].name"),
    ],
)
def test_a_register_map_that_cannot_be_meant_is_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_device(edited(tmp_path, old, new))
    assert any(said in problem and problem.startswith(str(tmp_path)) for problem in caught.value.problems)


def test_the_tags_of_a_group_have_its_period_and_the_heartbeat_and_those_of_their_own_have_none(tmp_path: Path) -> None:
    groups = '[[groups]]\nperiod = 60\ntags = ["Coppia"]\n[[groups]]\nperiod = 10\ntags = ["*"]\n[device]'
    path = edited(tmp_path, "[device]", groups)
    path.write_text(path.read_text(encoding="utf-8").replace("max_rate = 5", "max_rate = 5\nperiod = 3"), "utf-8")
    periods = {tag.name: tag.period for tag in load_device(path).tags}
    assert periods["Coppia"] == 60 and periods["PlcHeartbeat"] == 0 and periods[TEMPERATURE] == 3
    assert set(periods.values()) == {0, 3, 10, 60}


def test_what_an_arming_is_for_does_not_hang_on_how_the_plant_file_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "plant.toml"
    file.write_text(f'[device]\nfile = "{ROOT / "config/devices/decanter_canopen.toml"}"\n', encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    names = (file, Path("plant.toml"), tmp_path / ".." / tmp_path.name / "plant.toml")
    armed_for = {load_config(path).arming_hash for path in names}
    assert len(armed_for) == 1
    file.write_text(file.read_text(encoding="utf-8") + "[scan]\nperiod = 2.0\n", encoding="utf-8")
    assert load_config(file).arming_hash not in armed_for
