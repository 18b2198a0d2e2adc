"""`plc check` of a plant with several machines asked for one of them: a plant could not be checked at once."""

from pathlib import Path

from tests.commission.bench import answer, free_port, plc
from tests.gateway.support import MAP
from tests.plc.bench import running


def plant_of(folder: Path, **ports: int) -> Path:
    rows = "\n".join(f'[[machine]]\nname = "{name}"\ndevice = {{ port = {port} }}' for name, port in ports.items())
    path = folder / "plant.toml"
    path.write_text(f'[device]\nfile = "{MAP}"\ntimeout = 1.0\nheartbeat_period = 1.0\n{rows}\n', encoding="utf-8")
    return path


def test_every_machine_is_checked_and_one_that_is_not_there_does_not_hide_the_others(tmp_path: Path) -> None:
    with running() as process:
        plant = plant_of(tmp_path, north=free_port(), south=process.port)
        data = answer(tmp_path, "check", "--config", plant)
        alone = answer(tmp_path, "check", "--config", plant, "--machine", "south")
        shown = plc(tmp_path, "check", "--config", plant, "--machine", "south").stdout
    assert data["exit"] == 3 and data["reason"].startswith("north: ") and "is the PLC there?" in data["reason"]
    north, south = (data["machines"][name] for name in ("north", "south"))
    assert (north["exit"], south["exit"]) == (3, 0)
    assert {row["quality"] for row in south["readings"]} >= {"GOOD"} and len(south["readings"]) > 20
    assert next(step["state"] for step in south["steps"] if step["step"] == "heartbeat") == "ok"
    assert alone["ok"] and len(alone["readings"]) == len(south["readings"]) and "port" in shown
    assert any(point.startswith("south: ") for point in data["open_points"]), "the report says whose they are"


def test_the_files_of_all_are_checked_without_a_device_and_by_machine(tmp_path: Path) -> None:
    plant = plant_of(tmp_path, north=1, south=2)
    data = answer(tmp_path, "check", "--offline", "--config", plant)
    assert data["ok"] and list(data["machines"]) == ["north", "south"]
    shown = plc(tmp_path, "check", "--offline", "--config", plant).stdout
    assert shown.index("north") < shown.index("port 1") < shown.index("south") < shown.index("port 2")
    refused = plc(tmp_path, "check", "--config", plant, "--host", "10.0.0.1")
    assert refused.exit_code == 2 and "--host is one machine's" in refused.stderr
    # A setting that all may have in common is all machines'.
    assert answer(tmp_path, "check", "--offline", "--timeout", 2.0, "--config", plant)["ok"]
    (tmp_path / "plant.toml").write_text(
        plant.read_text(encoding="utf-8") + "alarms = { limitt = 1 }\n", encoding="utf-8"
    )
    wrong = plc(tmp_path, "check", "--offline", "--config", plant)
    assert wrong.exit_code == 2 and "machine 'south': alarms.limitt" in wrong.stderr
