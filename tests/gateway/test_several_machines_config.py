"""A plant file of several machines: what is common stands once, what is wrong is said with the machine's name."""

from pathlib import Path

import pytest

from drivers.settings import ConfigError
from gateway.commission.files import with_machine, without_machine
from gateway.settings import changed_machines, load_config, load_plant
from tests.gateway.support import MAP, TEMPERATURE, plant_file, two_modes

OTHER = "TCuscinettiAlimentazione"
COMMON = f"""
[device]
file = "{MAP}"
timeout = 0.7

[scan]
period = 2.0

[alarms]
limit = 75.0

[historian]
path = "h.sqlite"
"""
TWO = """
[[machine]]
name = "north"
device = { host = "127.0.0.1" }

[[machine]]
name = "south"
device = { host = "127.0.0.2", unit = 7 }
scan = { period = 0.5 }
writeback = { mode = "shadow" }
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "plant.toml"
    path.write_text(text, encoding="utf-8")
    return path


def problems(path: Path) -> tuple[str, ...]:
    with pytest.raises(ConfigError) as caught:
        load_plant(path)
    return caught.value.problems


def test_a_machine_has_what_is_common_but_for_what_it_says_itself(tmp_path: Path) -> None:
    path = written(tmp_path, COMMON + TWO)
    north, south = load_plant(path)
    assert [north.machine, south.machine] == ["north", "south"]
    assert (north.scan.period, south.scan.period) == (2.0, 0.5)
    assert (north.writeback.mode, south.writeback.mode) == ("off", "shadow")
    assert {config.alarms.limit for config in (north, south)} == {75.0}
    assert {config.historian.path for config in (north, south)} == {tmp_path / "h.sqlite"}
    assert south.links[0].settings["unit"] == 7 and north.links[0].settings["unit"] == 1
    assert {config.links[0].settings["timeout"] for config in (north, south)} == {0.7}
    assert load_config(path, machine="south") == south


def test_a_file_of_a_former_gateway_of_one_process_means_what_it_meant(tmp_path: Path) -> None:
    plain, former = written(tmp_path, COMMON + TWO), tmp_path / "former.toml"
    former.write_text(f"[plant]\nworkers = 1\n{COMMON}{TWO}", encoding="utf-8")
    armed_for = {config.arming_hash for config in load_plant(plain)}
    assert {config.arming_hash for config in load_plant(former)} == armed_for


@pytest.mark.parametrize("workers", ["2", "64", "0", "1.5", '"two"', "true"])
@pytest.mark.parametrize("machines", [TWO, ""])
def test_a_file_whose_machines_were_split_is_told_where_they_go_in_one_sentence(
    tmp_path: Path, workers: str, machines: str
) -> None:
    text = COMMON.replace("timeout", 'host = "127.0.0.1"\ntimeout')
    path = written(tmp_path, f"[plant]\nworkers = {workers}\n{text}{machines}")
    (problem,) = problems(path)
    assert problem.startswith(f"{path}: plant.workers: ") and ". " not in problem.removeprefix(str(path))
    for word in ("take the key out", "decanter@GROUP", "PostgreSQL, MQTT and Prometheus"):
        assert word in problem


def test_a_file_of_one_machine_means_what_it_meant(tmp_path: Path) -> None:
    path = plant_file(tmp_path, model=two_modes())
    (config,) = load_plant(path)
    assert config == load_config(path) == load_config(path, machine="decanter")
    assert (config.machine, config.subject, [row.tag for row in config.temperatures]) == ("decanter", "", [TEMPERATURE])
    (followed,) = config.temperature_configs
    assert followed == config


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ('[[machine]]\nname = "a"\nhistorian = { path = "x" }', "machine 'a': historian: is common to all machines"),
        ('[[machine]]\nname = "a"\nclock = { speed = 2.0 }', "machine 'a': clock.speed: is common to all machines"),
        ('[[machine]]\nname = "a"\nwriteback = { audit = "x" }', "writeback.audit: is common to all machines"),
        ('[[machine]]\nname = "a"\n[[machine]]\nname = "a"', "machine[1].name: 'a' is already used"),
        ('[[machine]]\nname = "page"', "machine[0].name: 'page' is what the audit log calls the gateway's own page"),
        ("[[machine]]\nscan = { period = 1.0 }", "machine[0].name: is missing"),
        ('[[machine]]\nname = "a b"', "machine[0].name: must match"),
        ("[machine]\nx = 3", "machine: must be [[machine]] tables"),
        (
            '[[machine]]\nname = "a"\nscan = { perod = 1.0 }',
            "machine 'a': scan.perod: there is no such key; did you mean",
        ),
        ('[[machine]]\nname = "a"\n[[machine]]\nname = "b"', "is at host 127.0.0.1 unit 1, as machine 'a' is"),
        (f'[[machine]]\nname = "a"\ntemperature = [{{ tag = "{OTHER}" }}, {{ tag = "{OTHER}" }}]', "already predicted"),
        ('[[machine]]\nname = "a"\ntemperature = [{ tag = "X" }]', "temperature[0].tag: 'X' is not a tag of"),
    ],
)
def test_what_is_wrong_is_said_once_with_the_machines_name(tmp_path: Path, text: str, sentence: str) -> None:
    (problem,) = problems(written(tmp_path, f"{COMMON}\n{text}\n"))
    assert sentence in problem and "; " in problem and "\n" not in problem


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ('host = "127.0.0.1"', 'host = "localhost"'),
        ('host = "127.0.0.1"', 'host = "127.0.0.1", unit = 1'),
        ("port = 502", "unit = 1"),
        ('host = "::1"', 'host = "0:0:0:0:0:0:0:1"'),
        ('host = "PLC7"', 'host = "plc7"'),
    ],
)
def test_one_device_is_not_taken_twice_however_it_is_written(tmp_path: Path, one: str, other: str) -> None:
    rows = "".join(f'[[machine]]\nname = "{name}"\ndevice = {{ {row} }}\n' for name, row in (("a", one), ("b", other)))
    (problem,) = problems(written(tmp_path, COMMON + rows))
    assert "machine 'b': device: is at" in problem and "as machine 'a' is" in problem


@pytest.mark.parametrize(("node", "taken"), [(5, True), (6, False)])
def test_one_node_of_a_bus_is_not_taken_twice(tmp_path: Path, node: int, taken: bool) -> None:
    device = (MAP.parent / "decanter_canopen.toml").as_posix()
    row = f'[[machine.device.links]]\nname = "bus"\nfile = "{device}"\nchannel = "can0"\nnode = '
    text = f'[[machine]]\nname = "a"\n{row}5\n[[machine]]\nname = "b"\n{row}{node}\ninterface = "socketcan"\n'
    path = written(tmp_path, text)
    if taken:
        (problem,) = problems(path)
        assert "as machine 'a' is" in problem
    else:
        assert len(load_plant(path)) == 2


def test_what_is_wrong_in_what_is_common_is_said_once(tmp_path: Path) -> None:
    path = written(tmp_path, COMMON.replace("limit = 75.0", "limit = true") + TWO)
    assert [problem.split("; ")[0] for problem in problems(path)] == [
        f"{path}: alarms.limit: must be a number, got True"
    ]


def test_a_command_for_one_machine_asks_which_of_several(tmp_path: Path) -> None:
    path = written(tmp_path, COMMON + TWO)
    for machine, sentence in (
        (None, "name one of them with --machine: north, south"),
        ("west", "has no machine 'west'"),
    ):
        with pytest.raises(ConfigError, match=sentence):
            load_config(path, machine=machine)
    with pytest.raises(ConfigError, match=r"device\.port: is each machine's own"):
        load_plant(path, {"device.port": 1})
    assert {config.clock.speed for config in load_plant(path, {"clock.speed": 4.0})} == {4.0}


def test_each_temperature_has_a_limit_and_a_model_of_its_own(tmp_path: Path) -> None:
    text = f'[[temperature]]\ntag = "{TEMPERATURE}"\nmodel = "m"\n[[temperature]]\ntag = "{OTHER}"\nlimit = 60.0\n'
    (tmp_path / "m").mkdir()
    config = load_config(written(tmp_path, COMMON + text))
    first, second = config.temperature_configs
    assert (first.model.path, first.alarms.limit) == (tmp_path / "m", 75.0)
    assert (second.model.path, second.model.temperature, second.alarms.limit) == (None, OTHER, 60.0)
    assert config.watched_temperatures == (TEMPERATURE, OTHER)
    assert [config.find_limit(tag) for tag in config.watched_temperatures] == [75.0, 60.0]
    (problem,) = problems(written(tmp_path, f'{COMMON}{text}[model]\ntemperature = "{TEMPERATURE}"\n'))
    assert "model.temperature: stands beside [[temperature]]" in problem


def test_a_second_machine_is_added_to_a_file_of_one_and_taken_out_again(tmp_path: Path) -> None:
    path = plant_file(tmp_path, model=two_modes())
    (before,) = load_plant(path)
    path.write_text(with_machine(path, "south", {"host": "127.0.0.2"}).after, encoding="utf-8")
    first, second = load_plant(path)
    # The first one keeps its name, under which its records are, and all that it was.
    assert (
        first.machine == before.machine
        and first.temperature_configs[0].model == before.model
        and first.links == before.links
    )
    assert second.machine == "south" and second.links[0].settings["host"] == "127.0.0.2"
    path.write_text(without_machine(path, "south").after, encoding="utf-8")
    assert [config.machine for config in load_plant(path)] == [before.machine]
    for name, sentence in (("south", "has no machine"), (before.machine, "its only machine")):
        with pytest.raises(ConfigError, match=sentence):
            without_machine(path, name)


def test_changes_are_told_by_machine_and_common_ones_refused(tmp_path: Path) -> None:
    def named(text: str) -> dict[str, object]:
        return {config.machine: config for config in load_plant(written(tmp_path, text))}

    before = named(COMMON + TWO)
    assert changed_machines(before, named(COMMON + TWO)) == {}  # type: ignore[arg-type]
    west = TWO.replace("north", "west").replace("period = 0.5", "period = 0.25")
    changes = changed_machines(before, named(COMMON + west))  # type: ignore[arg-type]
    assert changes == {"north": ("removed",), "west": ("added",), "south": ("scan.period: 0.5 -> 0.25",)}
    with pytest.raises(ConfigError, match=r"historian.path: .* is common to all machines"):
        changed_machines(before, named(COMMON.replace("h.sqlite", "g.sqlite") + TWO))  # type: ignore[arg-type]
