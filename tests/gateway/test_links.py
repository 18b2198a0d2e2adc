"""The plant file's links: one by the old keys, or several that must be able to stand in for one another."""

from pathlib import Path

import pytest

from drivers.modbus.driver import ModbusDriver
from drivers.settings import ConfigError
from gateway.machine.reading.clock import plant_clock
from gateway.machine.reading.redundant import Redundant
from gateway.plant.device import make_driver
from gateway.settings.config import Config, load_config
from gateway.settings.devices import load_device
from tests.drivers import certified
from tests.gateway.support import MAP


def plant(folder: Path, device: str, rest: str = "") -> Path:
    path = folder / "plant.toml"
    path.write_text(f'[device]\n{device}\n{rest}\n[historian]\npath = "h.sqlite"\n', encoding="utf-8")
    return path


def link(name: str, file: Path = MAP, **settings: object) -> str:
    rows = "\n".join(f"{key} = {value!r}".replace("True", "true") for key, value in settings.items())
    return f'[[device.links]]\nname = "{name}"\nfile = "{file}"\n{rows}\n'


def loaded(folder: Path, device: str, rest: str = "") -> Config:
    return load_config(plant(folder, device, rest))


def problems(folder: Path, device: str, rest: str = "") -> str:
    with pytest.raises(ConfigError) as caught:
        loaded(folder, device, rest)
    return "\n".join(caught.value.problems)


def test_the_old_keys_are_one_link_with_their_defaults(tmp_path: Path) -> None:
    config = loaded(tmp_path, f'file = "{MAP}"\nhost = "10.0.0.5"')
    (only,) = config.links
    assert only.map is config.map and only.settings["host"] == "10.0.0.5" and only.settings["timeout"] == 0.5
    assert "port" not in only.settings, "502 or 802 is the driver's business"
    assert isinstance(make_driver(config, plant_clock()), ModbusDriver)


def test_several_links_are_one_driver_and_the_first_is_the_primary(tmp_path: Path) -> None:
    config = loaded(tmp_path, link("main", host="h", port=1502) + link("spare", transport="rtu", serial="/dev/ttyS9"))
    assert [one.name for one in config.links] == ["main", "spare"]
    assert config.map is config.links[0].map
    assert config.links[0].place == "host h port 1502 unit 1" and "serial /dev/ttyS9" in config.links[1].place
    driver = make_driver(config, plant_clock())
    assert isinstance(driver, Redundant)
    assert [row["name"] for row in driver.report()] == ["main", "spare"]
    assert any(line.startswith("spare: holding:") for line in driver.explain(config.map.tags))


def test_paths_among_a_links_settings_are_relative_to_the_plant_file(tmp_path: Path) -> None:
    certified.folder(tmp_path / "keys")
    config = loaded(tmp_path, link("only", transport="tls", host="h", certificates="keys"))
    assert config.links[0].settings["certificates"] == str(tmp_path / "keys")
    make_driver(config, plant_clock())


def edited(folder: Path, name: str, old: str, new: str) -> Path:
    text = MAP.read_text(encoding="utf-8")
    assert old in text
    path = folder / name
    path.write_text(text.replace(old, new), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('name = "TAmbiente"', 'name = "Ambiente"', "has no tag 'TAmbiente'"),
        ('unit = "A"', 'unit = "mA"', "'Assorbimento' is in 'mA' in"),
        ('heartbeat = "PlcHeartbeat"', "", "has the heartbeat None and"),
        (
            '{ name = "age", dtype = "uint16", scale = 0.1 }',
            '{ name = "age", dtype = "uint16", scale = 0.2 }',
            "has another [writeback] block than",
        ),
    ],
)
def test_links_that_cannot_stand_in_for_one_another_are_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    other = edited(tmp_path, "other.toml", old, new)
    found = problems(tmp_path, link("main", host="a") + link("spare", other, host="b"))
    assert "device.links[1].file: " in found and said in found


@pytest.mark.parametrize(
    ("device", "said"),
    [
        ("", "device: 'file' is missing; give the path of the register map, or [[device.links]] tables"),
        ('host = "h"\n' + link("main"), "device: 'host' stands beside [[device.links]]; put it into each of them"),
        (link("main", host="a") + link("main", host="b"), "device.links[1].name: 'main' is already used"),
        ("[[device.links]]\nname = 'x'\n", "device.links[0].file: is missing; give the path of the device file"),
        ("switch_after = 0\n" + link("main", host="a"), "device.switch_after"),
    ],
)
def test_what_is_wrong_with_links_is_one_sentence_each(tmp_path: Path, device: str, said: str) -> None:
    assert said in problems(tmp_path, device)


def test_a_speed_is_refused_if_any_link_leads_to_another_machine(tmp_path: Path) -> None:
    found = problems(tmp_path, link("main", host="127.0.0.1") + link("spare", host="10.1.1.1"), "[clock]\nspeed = 2")
    assert "clock.speed" in found and "10.1.1.1" in found


def test_a_setting_that_the_driver_does_not_know_is_named_with_the_device_file(tmp_path: Path) -> None:
    config = loaded(tmp_path, link("main", host="h", prot="tcp"))
    with pytest.raises(ConfigError, match="prot: there is no such key; did you mean 'port'"):
        make_driver(config, plant_clock())


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("holding:400", ["holding:400", "holding:401"]),
        ("0x2100:1", ["0x2100:1", "0x2100:2"]),
        ("Writeback.{field}", ["Writeback.layout_version", "Writeback.sequence"]),
    ],
)
def test_the_blocks_words_are_counted_up_in_the_drivers_notation_or_named(
    tmp_path: Path, address: str, words: list[str]
) -> None:
    device = load_device(edited(tmp_path, "d.toml", 'address = "holding:400"', f'address = "{address}"'))
    assert device.writeback is not None
    assert [tag.address for tag in device.writeback.words[:2]] == words


def test_an_address_of_the_block_that_cannot_be_counted_up_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"writeback.address: .*give the first word in the driver's notation"):
        load_device(edited(tmp_path, "d.toml", 'address = "holding:400"', 'address = "Writeback"'))
