"""Reload of machines behind one connection: what changes is taken over, and the others keep connection and scans."""

import asyncio
import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from gateway.outside.status import ControlError, GatewayLine
from gateway.plant.app import run
from gateway.settings import load_plant
from tests.rig.pair import MAP, Plc, end, plc_process

UNITS = {"north": 1, "south": 2, "west": 3}
pytestmark = pytest.mark.timeout(300)


@contextmanager
def three_units(folder: Path) -> Iterator[Plc]:
    rows = [
        f'[[machine]]\nname = "{name}"\n' + ("port = 0\n" if unit == 1 else f'behind = "north"\nunit = {unit}\n')
        for name, unit in UNITS.items()
    ]
    (folder / "machines.toml").write_text("".join(rows), encoding="utf-8")
    with ExitStack() as ending:
        plc = plc_process("--plant-file", folder / "machines.toml", "--device", MAP, "--cycle", 0.02, "--stdin")
        ending.callback(end, plc.process)
        yield plc


def write_plant(folder: Path, port: int, *, device: str = "", **tables: str) -> Path:
    """The plant file; `tables` are added to a machine's own, `device` to its device file's settings."""
    text = MAP.read_text(encoding="utf-8").replace("[device]", f"[device]\n{device}", 1)
    (folder / "device.toml").write_text(text, encoding="utf-8")
    (folder / "other.toml").write_text(text.replace("max_failures = 5", "max_failures = 7", 1), encoding="utf-8")
    rows = "".join(
        f'[[machine]]\nname = "{name}"\n{tables.get(name, f"device = {{ unit = {unit} }}")}\n'
        for name, unit in UNITS.items()
    )
    path = folder / "plant.toml"
    path.write_text(
        f"""
[device]
file = "device.toml"
port = {port}
timeout = 1.0
heartbeat_period = 1.0
[scan]
period = 0.1
[historian]
path = "h.sqlite"
[log]
path = "log.jsonl"
{rows}""",
        encoding="utf-8",
    )
    return path


async def asked(path: Path, command: str, **keys: Any) -> dict[str, Any]:
    def ask() -> dict[str, Any]:
        line = GatewayLine(path.with_name("h.sock"), 60.0)
        try:
            return line.ask(command, **keys)
        finally:
            line.close()

    return await asyncio.to_thread(ask)


async def wait_for(path: Path, true: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """The statuses of all machines, once that is true of them."""
    async with asyncio.timeout(120.0):
        while True:
            if path.with_name("h.sock").exists():
                statuses: dict[str, Any] = (await asked(path, "plant"))["statuses"]
                if len(statuses) == len(UNITS) and true(statuses):
                    return statuses
            await asyncio.sleep(0.05)


def all_read(statuses: dict[str, Any]) -> bool:
    return all(one["scan"].get("count", 0) > 5 and one["link"]["alive"] for one in statuses.values())


async def test_machines_behind_one_port_are_changed_one_by_one_all_together_and_with_one_another(
    tmp_path: Path,
) -> None:
    with three_units(tmp_path) as plc:
        port = int(plc.ready["machines"]["north"]["port"])
        path, stop = write_plant(tmp_path, port), asyncio.Event()
        running = asyncio.create_task(run(*load_plant(path), stop=stop))
        try:
            before = await wait_for(path, all_read)

            # One alone: the others keep the connection, and go on.
            write_plant(tmp_path, port, south="device = { unit = 2 }\nscan = { period = 0.05 }")
            assert (await asked(path, "reload"))["changes"] == {"south": ["scan.period: 0.1 -> 0.05"]}
            after = await wait_for(path, lambda now: all_read(now) and now["south"]["scan"]["period"] == 0.05)
            for name in ("north", "west"):
                assert after[name]["link"]["outage_count"] == before[name]["link"]["outage_count"]
                assert after[name]["driver"]["reconnects"] == 0
                assert after[name]["scan"]["count"] > before[name]["scan"]["count"]

            # What is the connection's, for all that share it: it is made anew as they have it now.
            write_plant(tmp_path, port, device="max_failures = 5")
            changes = (await asked(path, "reload"))["changes"]
            assert set(changes) == set(UNITS)
            await wait_for(path, all_read)
            assert {config.links[0].settings["max_failures"] for config in load_plant(path)} == {5}

            # For one of them alone: refused before anything is stopped.
            before = await wait_for(path, all_read)
            write_plant(tmp_path, port, device="max_failures = 5", west='device = { unit = 3, file = "other.toml" }')
            with pytest.raises(ControlError, match=r"everything goes on as it was: .*max_failures is"):
                await asked(path, "reload")
            after = await wait_for(path, all_read)
            assert all(after[name]["scan"]["count"] >= before[name]["scan"]["count"] for name in UNITS)

            # Two that change places do so at once: nobody has the other's unit beside it.
            write_plant(
                tmp_path,
                port,
                device="max_failures = 5",
                north="device = { unit = 2 }",
                south="device = { unit = 1 }",
            )
            assert set((await asked(path, "reload"))["changes"]) == {"north", "south"}
            await wait_for(path, all_read)
        finally:
            stop.set()
            await running
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text(encoding="utf-8").splitlines()]
    assert not [line for line in lines if line["level"] == "error"], lines
