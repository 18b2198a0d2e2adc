"""Peers that mean ill, at every side on which a gateway is told of or asked: slow, hanging, flooding, closing, garbled.

`python -m benchmarks.northbound_peers PLAN` is the process of them all: it reads where the gateway's own sides are from
the file, says on its first line where it listens itself, and on its last, once its input ends, how often each was met.
Before it turns, a peer speaks its protocol as far as it takes to be let in.
"""

import asyncio
import json
import random
import socket
import struct
import sys
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

BYTE_S = 3.0
"""Seconds between two bytes of a slow peer."""
FLOOD_BYTES = 1 << 16
"""Bytes that a flooding peer sends at a time."""
FLOOD_S = 0.01
"""Seconds between two of them: 6.5 MB/s at most, that the machine itself is not what gives way."""
AGAIN_S = 1.0
"""Seconds until a client comes again."""
HELD = 20
"""Connections that a hanging client holds at a time."""
STAYS_S = 60.0
"""Seconds for which a peer that neither speaks nor closes stays."""

_TOPIC = b"spBv1.0/decanter/gateway"
_PUBLISH = b"\x30" + bytes([2 + len(_TOPIC) + 1 + 20]) + struct.pack(">H", len(_TOPIC)) + _TOPIC + b"\0" + b"x" * 20
_NO_TLS, _ASKS_BYTES = b"N", 8
_POSTGRES_IN = b"R\0\0\0\x08\0\0\0\0" + b"K\0\0\0\x0c\0\0\0\1\0\0\0\1" + b"Z\0\0\0\5I"
SERVERS: Mapping[str, tuple[bytes, bytes]] = {
    "mqtt": (b"\x20\x03\0\0\0", _PUBLISH),
    "postgres": (_POSTGRES_IN, b"N\0\0\0\x0cSNOTICE\0\0"),
    "influx": (b"HTTP/1.1 200 OK\r\nX-Waiting: ", b"x\r\nX-Waiting: "),
    "webhook": (b"HTTP/1.1 200 OK\r\nX-Waiting: ", b"x\r\nX-Waiting: "),
    "smtp": (b"220 here\r\n", b"220-" + b"x" * 500 + b"\r\n"),
}
"""The sides where the gateway calls: what lets it in, and what then comes without an end."""
CLIENTS: Mapping[str, bytes] = {
    "page": b"GET /api/plant HTTP/1.1\r\nhost: localhost\r\n\r\n",
    "metrics": b"GET /metrics HTTP/1.1\r\nhost: localhost\r\n\r\n",
    "opcua": b"HELF" + struct.pack("<IIIIIII", 32 + 4, 0, 65536, 65536, 0, 0, 4) + b"opc:",
    "serve": b"\0\1\0\0\0\6\1\3\0\0\0\1",
    "control": b'{"command": "status"}\n',
}
"""The sides where the gateway is called: one proper request of each."""
BEHAVIOURS = ("slow", "silent", "let in", "refuse", "flood", "close", "garbage")
"""Silent: nothing is said from the start; let in: nothing after that; the others begin once they were let in."""
CLIENT_BEHAVIOURS = ("slow", "silent", "flood", "close", "garbage")
SMTP = "smtp"
"""A plant has one mail server: this one turns to another habit with each connection."""

_Habit = Callable[[asyncio.StreamReader, asyncio.StreamWriter, bytes, bytes], Awaitable[None]]


async def _slow(_: asyncio.StreamReader, writer: asyncio.StreamWriter, begin: bytes, endless: bytes) -> None:
    writer.write(begin)
    for number in range(round(STAYS_S / BYTE_S)):
        writer.write(endless[number % len(endless) : number % len(endless) + 1])
        await writer.drain()
        await asyncio.sleep(BYTE_S)


async def _silent(reader: asyncio.StreamReader, _: asyncio.StreamWriter, __: bytes, ___: bytes) -> None:
    await _read_on(reader)


async def _let_in(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, begin: bytes, _: bytes) -> None:
    writer.write(begin)
    await _read_on(reader)


async def _flood(_: asyncio.StreamReader, writer: asyncio.StreamWriter, begin: bytes, endless: bytes) -> None:
    writer.write(begin)
    much = endless * -(-FLOOD_BYTES // len(endless))
    while True:
        writer.write(much)
        await writer.drain()
        await asyncio.sleep(FLOOD_S)


async def _close(_: asyncio.StreamReader, writer: asyncio.StreamWriter, begin: bytes, endless: bytes) -> None:
    writer.write(begin + endless[: len(endless) // 2])
    await writer.drain()
    sock = writer.get_extra_info("socket")
    with suppress(OSError):  # a reset instead of an end
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))


async def _garbage(_: asyncio.StreamReader, writer: asyncio.StreamWriter, begin: bytes, __: bytes) -> None:
    noise = random.Random(len(begin))
    for _number in range(20):
        writer.write(noise.randbytes(noise.randrange(1, 5000)))
        await writer.drain()
        await asyncio.sleep(FLOOD_S)


async def _read_on(reader: asyncio.StreamReader) -> None:
    with suppress(TimeoutError):
        async with asyncio.timeout(STAYS_S):
            while await reader.read(FLOOD_BYTES):
                pass


_HABITS: Mapping[str, _Habit] = {
    "slow": _slow,
    "silent": _silent,
    "let in": _let_in,
    "flood": _flood,
    "close": _close,
    "garbage": _garbage,
}


class _Peers:
    """All of them in one loop, and how often each was met."""

    def __init__(self) -> None:
        self.met: Counter[str] = Counter()
        self.tasks: list[asyncio.Task[None]] = []
        self._kept: list[object] = []

    async def listen(self, side: str, behaviour: str) -> int:
        """Begin one that is called; the port that it listens at (of one that refuses, that it keeps to itself)."""
        if behaviour == "refuse":
            bound = socket.socket()
            bound.bind(("127.0.0.1", 0))
            self._kept.append(bound)
            return int(bound.getsockname()[1])

        async def meet(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            habits = list(_HABITS)
            habit = behaviour or habits[self.met[side] % len(habits)]
            self.met[side] += 1
            # The first is of the end, which asyncio's streams would complain of.
            with suppress(asyncio.CancelledError, OSError):
                # libpq asks for encryption, in 8 bytes each time, and takes nothing before the answer.
                while side == "postgres" and habit != "silent" and len(await reader.read(FLOOD_BYTES)) == _ASKS_BYTES:
                    writer.write(_NO_TLS)
                await self._misbehave(habit, (reader, writer), *SERVERS[side])

        server = await asyncio.start_server(meet, "127.0.0.1", 0)
        self._kept.append(server)
        return int(server.sockets[0].getsockname()[1])

    def call(self, side: str, behaviour: str, where: int | str) -> None:
        """Begin one that calls, over and over, at a port or at the path of a socket."""
        for _ in range(HELD if behaviour == "silent" else 1):
            self.tasks.append(asyncio.create_task(self._calling(side, behaviour, where)))

    async def _calling(self, side: str, behaviour: str, where: int | str) -> None:
        request = CLIENTS[side]
        while True:
            with suppress(OSError):
                if isinstance(where, int):
                    line = await asyncio.open_connection("127.0.0.1", where)
                else:
                    line = await asyncio.open_unix_connection(where)
                self.met[side] += 1
                # What a client sends is its request and nothing before it.
                await self._misbehave(behaviour, line, b"", request)
            await asyncio.sleep(AGAIN_S)

    async def _misbehave(
        self, habit: str, line: tuple[asyncio.StreamReader, asyncio.StreamWriter], begin: bytes, endless: bytes
    ) -> None:
        reader, writer = line
        try:
            with suppress(OSError):
                await _HABITS[habit](reader, writer, begin, endless)
        finally:
            writer.close()


async def _main(sides: Mapping[str, Any]) -> None:
    peers = _Peers()
    ports = {
        side: {name: await peers.listen(side, name) for name in (("",) if side == SMTP else BEHAVIOURS)}
        for side in SERVERS
    }
    print(json.dumps(ports), flush=True)
    # The gateway is there once a line comes; its end is the order to end.
    if await asyncio.to_thread(sys.stdin.readline):
        for side, where in sides.items():
            for behaviour in CLIENT_BEHAVIOURS:
                peers.call(side, behaviour, where)
        await asyncio.to_thread(sys.stdin.readline)
    print(json.dumps(peers.met), flush=True)
    for task in peers.tasks:
        task.cancel()


if __name__ == "__main__":
    asyncio.run(_main(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))))
