"""One address took all places of the OPC UA server, and kept each other client out for as long as it came again.

Its places are shared as those of the page and of the other servers are: by address.
"""

import asyncio
import socket
import struct
from contextlib import ExitStack

import pytest
from asyncua import ua

from gateway.outside.northbound import opcua

HELLO = b"HELF" + struct.pack("<IIIIIII", 36, 0, 65_535, 65_535, 0, 0, 4) + b"opc:"
MOST = 4
GREEDY, OTHERS = "127.0.0.1", ("127.0.0.2", "127.0.0.3")


async def greeted(line: socket.socket) -> bool:
    """Whether the server answers a greeting, and does not end the connection."""
    loop = asyncio.get_running_loop()
    try:
        await loop.sock_sendall(line, HELLO)
        return (await loop.sock_recv(line, 64)).startswith(b"ACKF")
    except OSError:
        return False


async def ended(line: socket.socket) -> None:
    """Wait until the server has ended the connection."""
    loop = asyncio.get_running_loop()
    try:
        while await loop.sock_recv(line, 64):
            pass
    except ConnectionError:
        return


async def test_each_other_address_has_its_places(monkeypatch: pytest.MonkeyPatch) -> None:
    server = opcua.GatewayServer(None, MOST)
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity], permission_ruleset=opcua.ReadingOnly())
    server.set_endpoint("opc.tcp://127.0.0.1:0/decanter")
    server.socket_address = "127.0.0.1", 0

    async def nothing() -> None:
        """The standard's nodes, which take seconds to load, are not asked for here."""

    monkeypatch.setattr(server.iserver, "start", nothing)
    monkeypatch.setattr(server.iserver, "stop", nothing)
    loop = asyncio.get_running_loop()
    async with asyncio.timeout(120.0):
        await server.start()
        try:
            port = server.bserver._server.sockets[0].getsockname()[1]
            with ExitStack() as closing:

                async def connected(address: str) -> socket.socket:
                    line = closing.enter_context(socket.socket())
                    line.setblocking(False)
                    line.bind((address, 0))
                    await loop.sock_connect(line, ("127.0.0.1", port))
                    return line

                greedy = [await connected(GREEDY) for _ in range(MOST)]
                assert all([await greeted(line) for line in greedy])
                assert not await greeted(await connected(GREEDY)), "there is no place for more of it"
                # Its newest go for the others, who share alike.
                kept = [await connected(OTHERS[0]), await connected(OTHERS[1])]
                assert all([await greeted(line) for line in kept])
                await asyncio.gather(*map(ended, greedy[2:]))
                for _ in range(3 * MOST):
                    assert not await greeted(await connected(GREEDY))
                assert all([await greeted(line) for line in (*kept, *greedy[:2])]), "nobody who stays is disturbed"
        finally:
            await server.stop()
