"""A Modbus TCP device of a few lines whose every byte a test can bend; it shares no code with the driver."""

import asyncio
import ssl
import struct
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field

Bend = Callable[["ScriptedPlc", bytes, bytes, asyncio.StreamWriter], Awaitable[None]]


def mbap(transaction: int, unit: int, pdu: bytes, *, protocol: int = 0) -> bytes:
    return struct.pack(">HHHB", transaction, protocol, len(pdu) + 1, unit) + pdu


def transaction_of(request: bytes) -> int:
    return int.from_bytes(request[:2], "big")


def read_reply(request: bytes, words: list[int], *, function: int | None = None, unit: int | None = None) -> bytes:
    """A well-formed reply to a register read, with whatever content."""
    body = struct.pack(f">BB{len(words)}H", function or request[7], 2 * len(words), *words)
    return mbap(transaction_of(request), request[6] if unit is None else unit, body)


@dataclass
class ScriptedPlc:
    """Registers, coils and a script: `bend(plc, request, honest_reply, writer)` sends instead of the honest reply."""

    registers: dict[int, int] = field(default_factory=lambda: {n: n for n in range(200)})
    coils: dict[int, int] = field(default_factory=lambda: {n: n % 2 for n in range(64)})
    illegal: set[int] = field(default_factory=set)
    max_count: int = 125
    exception: int = 0
    bend: Bend | None = None
    accepts: bool = True
    requests: list[bytes] = field(default_factory=list)
    connections: int = 0
    port: int = 0
    context: ssl.SSLContext | None = None
    _server: asyncio.Server | None = None
    _writers: set[asyncio.StreamWriter] = field(default_factory=set)

    async def start(self) -> None:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", self.port, ssl=self.context)
        self.port = self._server.sockets[0].getsockname()[1]

    async def stop(self, *, reset: bool = True) -> None:
        if self._server is not None:
            self._server.close()
            self._server = None
        for writer in list(self._writers):
            if reset:
                writer.transport.abort()
            else:
                writer.close()
        await asyncio.sleep(0)

    def functions(self) -> list[int]:
        return [request[7] for request in self.requests]

    def asked(self) -> list[tuple[int, int, int]]:
        return [(request[7], *struct.unpack(">HH", request[8:12])) for request in self.requests]

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.connections += 1
        self._writers.add(writer)
        try:
            while True:
                head = await reader.readexactly(6)
                request = head + await reader.readexactly(int.from_bytes(head[4:6], "big"))
                self.requests.append(request)
                honest = self.answer(request)
                if self.bend is None:
                    writer.write(honest)
                else:
                    await self.bend(self, request, honest, writer)
        except (asyncio.IncompleteReadError, ConnectionError, asyncio.CancelledError):
            pass
        finally:
            self._writers.discard(writer)
            writer.close()

    def answer(self, request: bytes) -> bytes:
        function, start, count = request[7], *struct.unpack(">HH", request[8:12])
        return mbap(transaction_of(request), request[6], self.pdu(function, start, count, request[13:]))

    def pdu(self, function: int, start: int, count: int, data: bytes) -> bytes:
        if self.exception:
            return bytes([function | 0x80, self.exception])
        if count > self.max_count and function in (3, 4):
            return bytes([function | 0x80, 3])
        numbers = range(start, start + count)
        if self.illegal.intersection(numbers):
            return bytes([function | 0x80, 2])
        if function in (1, 2):
            packed = sum(self.coils.get(n, 0) << i for i, n in enumerate(numbers))
            size = (count + 7) // 8
            return bytes([function, size]) + packed.to_bytes(size, "little")
        if function in (3, 4):
            return struct.pack(f">BB{count}H", function, 2 * count, *(self.registers.get(n, 0) for n in numbers))
        if function == 16:
            self.registers.update(zip(numbers, struct.unpack(f">{count}H", data), strict=True))
        if function == 15:
            packed = int.from_bytes(data, "little")
            self.coils.update({n: packed >> i & 1 for i, n in enumerate(numbers)})
        return struct.pack(">BHH", function, start, count)


# ---------------------------------------------------------------- scripts


async def silent(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
    """Take the request and say nothing."""


def always(reply: Callable[[bytes, bytes], bytes]) -> Bend:
    """Send what `reply(request, honest)` makes of each reply."""

    async def bend(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        writer.write(reply(request, honest))

    return bend


def first(count: int, bent: Bend) -> Bend:
    """Bend the first replies, then be honest."""
    left = count

    async def bend(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        nonlocal left
        left -= 1
        if left >= 0:
            await bent(plc, request, honest, writer)
        else:
            writer.write(honest)

    return bend


def late(seconds: float) -> Bend:
    """Send each reply after a while, without holding up the next request."""

    async def bend(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        asyncio.get_running_loop().call_later(seconds, writer.write, honest)

    return bend
