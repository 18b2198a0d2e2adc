"""An OPC UA client that asked on and on and read no answer had all of them kept for it in the gateway's memory.

The library writes to a connection without a look at what waits there. What it wrote to one that had gone already was a
line on standard error each time.
"""

import asyncio
import struct
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest
from asyncua import ua

from gateway.outside.northbound import opcua

HELLO = b"HELF" + struct.pack("<IIIIIII", 36, 0, 65_535, 65_535, 0, 0, 4) + b"opc:"
"""A request that is answered at once, with 28 bytes."""
ANSWER_BYTES = 28
BOUND = 1_000
TIMES = 200


class Unread:
    """A transport whose other side reads nothing."""

    def __init__(self) -> None:
        self.unsent = self.told_too_late = 0
        self.ended = False

    def get_extra_info(self, name: str) -> Any:
        return ("127.0.0.1", 1)

    def get_write_buffer_size(self) -> int:
        return self.unsent

    def is_closing(self) -> bool:
        return self.ended

    def write(self, data: bytes) -> None:
        self.told_too_late += self.ended
        self.unsent += len(data)

    def close(self) -> None:
        self.ended = True

    abort = close


@asynccontextmanager
async def protocol(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Any]:
    """What the server makes of a new connection."""
    server = opcua.GatewayServer(None, 16)
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity], permission_ruleset=opcua.ReadingOnly())
    server.set_endpoint("opc.tcp://127.0.0.1:0/decanter")
    server.socket_address = "127.0.0.1", 0

    async def nothing() -> None:
        """The standard's nodes, which take seconds to load, are not asked for here."""

    monkeypatch.setattr(server.iserver, "start", nothing)
    monkeypatch.setattr(server.iserver, "stop", nothing)
    async with asyncio.timeout(120.0):
        await server.start()
        made = server.bserver._make_protocol()
        try:
            yield made
        finally:
            made.connection_lost(None)
            await server.stop()


async def processed(asked: Any) -> None:
    """Wait until it has looked at all that it was sent."""
    async with asyncio.timeout(120.0):
        while not asked.messages.empty():
            await asyncio.sleep(0)
    await asyncio.sleep(0)


async def test_what_waits_for_a_client_is_bounded_and_then_it_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opcua, "MOST_UNSENT", BOUND, raising=False)
    line = Unread()
    async with protocol(monkeypatch) as asked:
        asked.connection_made(line)
        for _ in range(TIMES):
            asked.data_received(HELLO)
            await processed(asked)
        assert BOUND <= line.unsent <= BOUND + ANSWER_BYTES
        assert line.ended


async def test_nothing_is_said_to_a_client_that_has_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    line = Unread()
    async with protocol(monkeypatch) as asked:
        asked.connection_made(line)
        asked.data_received(20 * HELLO)
        line.ended = True
        await processed(asked)
        assert line.told_too_late == 0
