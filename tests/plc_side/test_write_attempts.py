"""Nothing outside the write map reaches the wire: a thousand attempts by every path, judged by the PLC's recorder."""

import asyncio
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

import pytest
from click.testing import CliRunner

from drivers.can.bus.access import open_bus
from drivers.driver import Writes, open_driver
from drivers.errors import DriverError
from drivers.settings import ConfigError
from gateway.cli.main import main
from gateway.commission.writeback.vectors import vectors
from gateway.demo.can_bus import can_hub
from gateway.demo.links import LINKS
from gateway.outside.status import connect
from gateway.plant.app import run
from gateway.settings.config import load_config
from gateway.settings.devices import load_device
from sim.plc.record.recording import read_recording
from tests.drivers.conftest import read_until_good
from tests.plc.bench import Process, running
from tests.plc_side import attempts

CONFIG = Path(__file__).parents[2] / "config"
BY_DRIVER, BY_CONFIG, BY_SOCKET, BY_COMMAND = 720, 120, 120, 60
WRITE_FUNCTIONS = {5, 6, 15, 16, 21, 22, 23}
NODE, SDO_REQUEST = 1, 0x601
SDO_READS = {0x40, 0x60, 0x70, 0x80, 0xA0, 0xA1, 0xA2, 0xA3}
"""First bytes of SDO requests that read: initiate and segments of an upload, abort, block upload."""
RAW_WRITES = 0x201, 0x280, 0x281
CONNECT_DEADLINE_S = 20.0
"""For opening a link where only its coming is asked: a busy machine brings a node up late."""
PATIENT_S = 20.0
"""A reply's deadline where only its coming is asked."""


@dataclass
class Witness:
    """Another station on the CAN bus, which hears all that anyone sends."""

    path: Path
    frames: list[tuple[int, bytes]] = field(default_factory=list)

    async def watch(self, stop: asyncio.Event) -> None:
        bus = open_bus("hub", str(self.path))
        try:
            while not stop.is_set():
                message = await asyncio.to_thread(bus.recv, 0.05)
                if message is not None:
                    self.frames.append((message.arbitration_id, bytes(message.data)))
        finally:
            bus.shutdown()


@dataclass
class Plant:
    """The PLC with all its faces, what it records, and a bus on which a witness sits."""

    plc: Process
    folder: Path
    recording: Path
    hub: Path

    def written(self) -> tuple[list[Any], list[Any], list[Any]]:
        """Write requests, blocks, and CAN frames taken from us that write, by the PLC's own account."""
        found = read_recording(self.recording)
        requests = [row for row in found.requests if row.function in WRITE_FUNCTIONS]
        frames = [row for row in found.frames if not row.sent and not _reads(row.id, row.data or b"")]
        return requests, list(found.blocks), frames

    def settings(self, link: str) -> dict[str, Any]:
        given = {**LINKS[link].settings(self.folder, self.plc.ready), "connect_timeout": CONNECT_DEADLINE_S}
        given.pop("configure", None)  # what else a master writes at the start is its communication parameters
        given.pop("sync_period", None)
        return given

    async def start_node(self) -> None:
        """Have a master start the CANopen node, as the plant's own would; so nothing is refused for its state alone."""
        device = device_of("canopen")
        starting = {
            **device.settings,
            **LINKS["canopen"].settings(self.folder, self.plc.ready),
            "connect_timeout": CONNECT_DEADLINE_S,
        }
        # What a master sends last has no answer. A reading after it has one: then the PLC has taken all before it.
        for settings in (starting, {**device.settings, **self.settings("canopen")}):
            driver = open_driver("canopen", settings, clock=time.time)
            await driver.open()
            try:
                await read_until_good(driver, device.by_name["PlcHeartbeat"])
            finally:
                await driver.close()


def _reads(identifier: int, data: bytes) -> bool:
    return identifier == SDO_REQUEST and data[:1] and (data[0] in SDO_READS or data[0] & 0xEF == 0x60)


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    folder = tmp_path_factory.mktemp("all")
    recording = folder / "recording.jsonl"
    options: list[Any] = ["--record", recording]
    for name in ("modbus-tls", "modbus-rtu", "modbus-rtu-tcp"):
        options += LINKS[name].arguments(folder)
    options += LINKS["can"].arguments(folder)
    options += [*LINKS["canopen"].arguments(folder)][:2]
    with ExitStack() as stack:
        hub = stack.enter_context(can_hub(folder))
        plc = stack.enter_context(running(*options))
        made = Plant(plc, folder, recording, hub)
        asyncio.run(made.start_node())
        yield made


def device_of(link: str) -> Any:
    return load_device(CONFIG / "devices" / (LINKS[link].device or "decanter_plc.toml"))


async def by_drivers(plant: Plant, random: Random, count: int) -> Counter[str]:
    """Every link's driver with the closed write map, open and connected; the errors by their kind."""
    errors: Counter[str] = Counter()
    for link in LINKS:
        device = device_of(link)
        assert device.writeback is not None
        settings = {**device.settings, **plant.settings(link)}
        for write_map in (device.writeback.words, ()):
            driver = open_driver(device.driver, settings, clock=time.time, write_map=write_map)
            assert isinstance(driver, Writes)
            await driver.open()
            try:
                for _ in range(count // len(LINKS) // 2):
                    values = attempts.attempt(random, device)
                    with pytest.raises((DriverError, TypeError)) as caught:
                        await driver.write(values)
                    errors[type(caught.value).__name__] += 1
            finally:
                await driver.close()
    return errors


def plant_file(plant: Plant, mode: str = "shadow") -> Path:
    path = plant.folder / f"{mode}.toml"
    path.write_text(
        f'[device]\nfile = "{CONFIG / "devices/decanter_plc.toml"}"\nport = {plant.plc.port}\n'
        f'[scan]\nperiod = 0.05\n[writeback]\nmode = "{mode}"\n[historian]\npath = "{mode}.sqlite"\n'
        f'[log]\npath = "{mode}.jsonl"\n',
        encoding="utf-8",
    )
    return path


def by_configurations(plant: Plant, random: Random, count: int) -> int:
    refused = 0
    for overrides in attempts.configurations(random, count):
        with pytest.raises(ConfigError):
            load_config(plant_file(plant), overrides)
        refused += 1
    return refused


async def by_socket(plant: Plant, random: Random, count: int) -> int:
    """A gateway in shadow, which has the write map and is not armed; gives the requests that were refused."""
    config, stop = load_config(plant_file(plant)), asyncio.Event()
    running_gateway = asyncio.create_task(run(config, stop=stop))
    while (line := await asyncio.to_thread(connect, config.control_socket)) is None:
        await asyncio.sleep(0.05)
    refused = 0
    for request in attempts.requests(random, count):
        try:
            await asyncio.to_thread(lambda keys: line.ask(**keys), request)
        except ValueError:
            refused += 1
    told = await asyncio.to_thread(line.ask, "status")
    assert told["status"]["writeback"]["mode"] == "shadow"
    line.close()
    stop.set()
    status = await running_gateway
    assert status["writeback"]["written"] == 0 and status["writeback"]["shadow"] > 0
    return refused


def by_commands(plant: Plant, random: Random, count: int) -> Counter[int]:
    codes: Counter[int] = Counter()
    place = ["--host", "127.0.0.1", "--port", str(plant.plc.port), "--timeout", "0.5"]
    environment = {"DECANTER_RECORDS": str(plant.folder / "records.jsonl"), "DECANTER_BY": "Ada"}
    device = str(CONFIG / "devices/decanter_plc.toml")
    for words in attempts.commands(random, count, place, device):
        codes[CliRunner().invoke(main, words, env=environment).exit_code] += 1
    return codes


def test_a_thousand_attempts_by_every_path_and_none_reaches_the_wire(plant: Plant, monkeypatch: Any) -> None:
    random = Random(20261121)
    monkeypatch.chdir(plant.folder)
    witness, stop = Witness(plant.hub), asyncio.Event()

    before = plant.written()

    async def together() -> tuple[Counter[str], int]:
        watching = asyncio.create_task(witness.watch(stop))
        errors = await by_drivers(plant, random, BY_DRIVER)
        refused = await by_socket(plant, random, BY_SOCKET)
        stop.set()
        await watching
        return errors, refused

    errors, refused = asyncio.run(together())
    configured = by_configurations(plant, random, BY_CONFIG)
    codes = by_commands(plant, random, BY_COMMAND)
    assert errors.total() + BY_SOCKET + configured + codes.total() >= 1000
    assert errors.total() == BY_DRIVER and errors["WriteForbidden"] > BY_DRIVER / 2
    assert refused > BY_SOCKET / 2 and set(codes) >= {2, 6}
    assert plant.written() == before and before[:2] == ([], []), "by the PLC's own recorder"
    ours = [(number, data) for number, data in witness.frames if number in RAW_WRITES[:1] or 0x600 <= number <= 0x67F]
    assert witness.frames and all(_reads(*frame) for frame in ours)


async def test_the_recorder_sees_what_is_in_the_write_map(plant: Plant) -> None:
    before = [len(rows) for rows in plant.written()]
    for link in LINKS:
        device = device_of(link)
        block = next(step for step in vectors(device.writeback) if step.words)
        settings = {**device.settings, **plant.settings(link), "timeout": PATIENT_S}
        # The vector answers no challenge, so the PLC takes the words and accepts no block: they are read back instead.
        settings.pop("acknowledge", None)
        driver = open_driver(device.driver, settings, clock=time.time, write_map=device.writeback.words)
        await driver.open()
        try:
            await driver.write(list(zip(device.writeback.words, block.words, strict=True)))
        finally:
            await driver.close()
    after = [len(rows) for rows in plant.written()]
    requests, blocks, frames = (new - old for new, old in zip(after, before, strict=True))
    assert (requests, blocks) == (4, len(LINKS)) and frames >= 8 + 1
