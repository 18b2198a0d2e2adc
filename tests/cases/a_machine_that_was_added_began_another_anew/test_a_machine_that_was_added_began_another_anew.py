"""`machine add` to a file of one machine, and a reload: that machine was begun anew, "its device file has changed".

It had not. What a reload says of a machine is so, and a machine of which nothing changes goes on as it is.
"""

import asyncio
from dataclasses import fields, replace
from pathlib import Path
from random import Random
from typing import Any

import pytest

from gateway.commission.files import with_machine
from gateway.machine.reading import plant_clock
from gateway.plant.fleet import Fleet
from gateway.plant.log import open_log
from gateway.settings import Config, changed_machines, load_plant
from tests.gateway.support import MAP, plant_file


async def reloaded(folder: Path, *additions: tuple[str, dict[str, Any]]) -> tuple[dict[str, list[str]], set[str]]:
    """What a gateway of one machine says of a file with more machines, and which machines have gone on as they were."""
    path = plant_file(folder, "port = 1\n[scan]\nperiod = 0.1")
    with open_log(folder / "log.jsonl") as log:
        fleet = Fleet(load_plant(path), clock=plant_clock(), log=log, rng=Random(0), read_anew=lambda: load_plant(path))
        stop, before = asyncio.Event(), dict(fleet.machines)
        try:
            fleet.start(stop)
            for name, device in additions:
                path.write_text(with_machine(path, name, device).after, encoding="utf-8")
            async with asyncio.timeout(120.0):
                changes = (await fleet.reload())["changes"]
                again = (await fleet.reload())["changes"]
            assert again == {}, "what was taken over is no change any more"
            return changes, {name for name, machine in before.items() if fleet.machines.get(name) is machine}
        finally:
            stop.set()
            await fleet.stop()


async def test_a_machine_beside_which_another_is_added_goes_on(tmp_path: Path) -> None:
    changes, same = await reloaded(tmp_path, ("south", {"host": "127.0.0.2"}))
    assert changes == {"south": ["added"]} and len(same) == 1


async def test_a_machine_whose_connection_is_shared_from_now_on_is_begun_anew_and_it_is_said_why(
    tmp_path: Path,
) -> None:
    changes, same = await reloaded(tmp_path, ("south", {"unit": 7}), ("west", {"host": "127.0.0.2"}))
    assert changes.pop("south") == ["added"] and changes.pop("west") == ["added"]
    assert list(changes.values()) == [["shares its connection with south"]] and not same


@pytest.mark.parametrize("change", ["device file", "text of the device file", "nothing"])
def test_a_device_file_is_said_to_have_changed_if_it_has(tmp_path: Path, change: str) -> None:
    device = tmp_path / "device.toml"
    text = MAP.read_text(encoding="utf-8")
    device.write_text(text, encoding="utf-8")
    path = plant_file(tmp_path, device=device)
    (before,) = load_plant(path)
    if change == "device file":
        device.write_text(text.replace("scale = 0.1", "scale = 0.2", 1), encoding="utf-8")
    elif change == "text of the device file":
        device.write_text(text + "\n# seen\n", encoding="utf-8")
    (after,) = load_plant(path)
    told = changed_machines({before.machine: before}, {after.machine: after})
    assert told == ({before.machine: ("its device file has changed",)} if change == "device file" else {})


def test_no_other_difference_is_said_to_be_of_the_device_file(tmp_path: Path) -> None:
    (before,) = load_plant(plant_file(tmp_path))
    known = {field.name for field in fields(Config) if field.compare} - {"machine", "links"}
    for name in sorted(known):
        value = getattr(before, name)
        if isinstance(value, bool):
            after = replace(before, **{name: not value})
            told = changed_machines({before.machine: before}, {before.machine: after})
            assert "its device file has changed" not in str(told), name
