"""A PLC whose program stood still got a connection every 2 s with three requests each, and died of them on waking."""

import asyncio
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass, field

import pytest

from drivers.modbus.driver import open_modbus
from drivers.tag import Tag
from tests.drivers.conftest import read_until_good
from tests.drivers.scripted import ScriptedPlc

FIVE = Tag("five", "holding:5")


@dataclass
class Freezing(asyncio.Protocol):
    """Counts the requests that each connection leaves unanswered, and how each connection ends."""

    plc: "FrozenPlc"
    unanswered: int = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self.transport = transport
        self.plc.connections.append(self)
        self.plc.most_at_once = max(
            self.plc.most_at_once, sum(not c.transport.is_closing() for c in self.plc.connections)
        )

    def data_received(self, data: bytes) -> None:
        self.unanswered += data.count(b"\x00\x00\x00\x06\x01\x03")
        self.plc.held.append((self, data))
        if not self.plc.frozen:
            self.plc.answer()

    def connection_lost(self, exc: Exception | None) -> None:
        self.plc.resets += exc is not None


@dataclass
class FrozenPlc:
    """Its system takes connections and bytes; its program answers what is there once it is not `frozen`."""

    frozen: bool = False
    connections: list[Freezing] = field(default_factory=list)
    held: list[tuple[Freezing, bytes]] = field(default_factory=list)
    most_at_once: int = 0
    resets: int = 0
    port: int = 0

    def answer(self) -> None:
        honest, self.held, held = ScriptedPlc(), [], self.held
        for connection, data in held:
            for at in range(0, len(data), 12):
                if not connection.transport.is_closing():
                    connection.unanswered -= 1
                    connection.transport.write(honest.answer(data[at : at + 12]))


@pytest.fixture
async def plc() -> AsyncIterator[FrozenPlc]:
    plc = FrozenPlc()
    server = await asyncio.get_running_loop().create_server(lambda: Freezing(plc), "127.0.0.1", 0)
    plc.port = server.sockets[0].getsockname()[1]
    yield plc
    for connection in plc.connections:
        connection.transport.abort()
    server.close()


async def test_a_plc_that_stands_still_is_spared_and_read_at_once_when_it_wakes(plc: FrozenPlc) -> None:
    settings = {"host": "127.0.0.1", "port": plc.port, "timeout": 0.05, "max_silence": 0.15}
    driver = open_modbus(settings, clock=time.time)
    await driver.open()
    try:
        await read_until_good(driver, FIVE)
        plc.frozen = True
        end = time.monotonic() + 6.0
        while time.monotonic() < end:
            assert not (await driver.read([FIVE]))[0].quality.is_good
            await asyncio.sleep(0.01)
        # One that worked, five by the rule (0.15 s and the pause), then 0.3, 0.6, 1.2 and 1.2 s: forty without that.
        assert len(plc.connections) <= 12
        assert plc.most_at_once <= 2  # the server may hear of the end of one after the beginning of the next
        assert max(connection.unanswered for connection in plc.connections) <= 2
        assert max(connection.unanswered for connection in plc.connections[2:]) <= 1
        assert plc.resets == 0  # each ended with FIN
        plc.frozen = False
        plc.answer()
        await read_until_good(driver, FIVE)
    finally:
        await driver.close()
