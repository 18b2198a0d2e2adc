"""The running gateway's local socket: who may ask, what it answers, and that a device of one client needs no second."""

import asyncio
import json
import socket
import stat
from collections.abc import AsyncIterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from gateway.commission.session.gateway_line import running_gateway
from gateway.commission.session.target import make_target
from gateway.outside.status import ControlError, connect
from gateway.plant.app import run
from gateway.plant.control import listening_socket
from gateway.settings.config import load_config
from tests.commission.bench import force, plc
from tests.gateway.support import MAP
from tests.plc.bench import running


def plant(folder: Path, port: int) -> Path:
    path = folder / "plant.toml"
    path.write_text(
        f'[device]\nfile = "{MAP}"\nhost = "127.0.0.1"\nport = {port}\n[scan]\nperiod = 0.05\n'
        f'[historian]\npath = "history.sqlite"\n',
        encoding="utf-8",
    )
    return path


@pytest.fixture
async def gateway(tmp_path: Path) -> AsyncIterator[Path]:
    """A gateway in this process beside a PLC that serves one client; gives its plant file."""
    folder = tmp_path / ("a" * 60) / ("b" * 60)  # longer than a Unix socket's path may be
    folder.mkdir(parents=True)
    with running("--max-clients", "1") as process:
        force(process, "Assorbimento", 80.5)
        config = load_config(plant(folder, process.port))
        stop = asyncio.Event()
        task = asyncio.create_task(run(config, stop=stop))
        while not config.control_socket.exists():
            await asyncio.sleep(0.01)
        async with asyncio.timeout(120.0):
            while not await read_well(config.path):
                await asyncio.sleep(0.05)
        yield config.path
        stop.set()
        await task
        assert not config.control_socket.exists()


async def read_well(path: Path) -> bool:
    """Whether the gateway has a good reading of what the PLC is forced to."""
    values = (await asked(path, "status"))["status"]["values"]
    return bool(values) and values["Assorbimento"]["quality"] == "GOOD"


async def asked(path: Path, command: str, **keys: Any) -> dict[str, Any]:
    def ask() -> dict[str, Any]:
        line = connect(load_config(path).control_socket, 120.0)
        assert line is not None
        try:
            return line.ask(command, **keys)
        finally:
            line.close()

    return await asyncio.to_thread(ask)


async def test_the_socket_is_for_this_user_alone_and_answers_status_and_readings(gateway: Path) -> None:
    mode = load_config(gateway).control_socket.stat().st_mode
    assert stat.S_ISSOCK(mode) and stat.S_IMODE(mode) == 0o600
    assert (await asked(gateway, "status"))["status"]["phase"] == "running"
    reply = await asked(gateway, "read", tags=["Assorbimento"])
    assert reply["samples"][0]["value"] == pytest.approx(80.5)
    fresh = await asked(gateway, "read", addresses=[{"address": "holding:101", "dtype": "uint16", "scale": 0.1}])
    assert fresh["samples"][0]["value"] == pytest.approx(80.5)


async def test_a_command_reads_through_the_gateway_where_the_device_serves_one_client(
    gateway: Path, tmp_path: Path
) -> None:
    result = await asyncio.to_thread(plc, tmp_path, "read", "Assorbimento", "--config", gateway, "--json")
    data = json.loads(result.stdout)
    assert data["ok"] and data["readings"][0]["value"] == pytest.approx(80.5)
    assert "through the running gateway" in data["notes"][0]
    assert data["frames"]["sent"] == 0


async def test_a_guess_goes_through_the_gateway_too(gateway: Path, tmp_path: Path) -> None:
    words = ("guess", "holding:101", "80.5", "--config", gateway, "--json")
    data = json.loads((await asyncio.to_thread(plc, tmp_path, *words)).stdout)
    assert (data["candidates"][0]["address"], data["candidates"][0]["scale"]) == ("holding:101", 0.1)
    assert data["observation"]["base"] == 100 and data["frames"]["sent"] == 0  # holding:99 does not exist


REFUSED: list[tuple[str, dict[str, Any], str]] = [
    ("open the door", {}, "known are status, plant, read"),
    ("read", {"tags": ["nobody"]}, "'nobody' is no tag"),
    ("read", {"tags": 7}, "tags: must be a list, got 7; give a list of at most 10000"),
    ("read", {"addresses": [{"where": 1}]}, r"addresses\[0\].address: is missing"),
    ("read", {"addresses": [{"address": "holding:1", "dtype": "quaternion"}]}, "quaternion"),
    ("read", {"addresses": [{"address": "holding:1", "writable": True}]}, "writable: .* nothing is written here"),
]


async def test_a_request_that_cannot_be_carried_out_is_refused_in_a_sentence(gateway: Path) -> None:
    for command, keys, words in REFUSED:
        with pytest.raises(ControlError, match=words):
            await asked(gateway, command, **keys)


async def test_what_is_no_request_does_not_stop_the_gateway(gateway: Path) -> None:
    def shout() -> dict[str, Any]:
        line = connect(load_config(gateway).control_socket)
        assert line is not None
        line._sock.sendall(b"not JSON\n")
        reply: dict[str, Any] = json.loads(line._sock.makefile("rb").readline())
        line._sock.sendall(b"[1, 2]\n")
        assert not json.loads(line._sock.makefile("rb").readline())["ok"]
        with suppress(OSError):  # the gateway hangs up on a line without end
            line._sock.sendall(b"x" * 3_000_000)
        line.close()
        return reply

    assert (await asyncio.to_thread(shout))["reason"].startswith("the request is not JSON")
    assert (await asked(gateway, "status"))["pid"] > 0


def test_where_no_gateway_runs_there_is_none_to_ask(tmp_path: Path) -> None:
    path = plant(tmp_path, 15_000)
    assert connect(load_config(path).control_socket) is None
    assert running_gateway(make_target(plant=path)) is None


def test_a_socket_that_a_killed_gateway_left_is_taken_over_and_a_living_one_is_not(tmp_path: Path) -> None:
    path = tmp_path / "gateway.sock"
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(path))
    with listening_socket(path), pytest.raises(OSError, match="no control socket at"):
        listening_socket(path)
    path.unlink()
