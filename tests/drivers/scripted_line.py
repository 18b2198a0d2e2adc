"""A Modbus RTU device of a few lines whose every byte a test can bend, on a pty or behind TCP: no driver code."""

import asyncio
import contextlib
import os
import pty
import struct
import tty
from collections.abc import Callable
from dataclasses import dataclass, field

from tests.drivers.scripted import ScriptedPlc

Put = Callable[[bytes], None]
Bend = Callable[["ScriptedLine", bytes, bytes], None]


def rtu(unit: int, pdu: bytes) -> bytes:
    """A frame with its CRC, bit by bit."""
    data = bytes((unit,)) + pdu
    register = 0xFFFF
    for octet in data:
        register ^= octet
        for _ in range(8):
            register = register >> 1 ^ 0xA001 if register & 1 else register >> 1
    return data + register.to_bytes(2, "little")


@dataclass
class ScriptedLine:
    """The memory of a ScriptedPlc at the far end of a line; `bend(line, request, honest)` puts instead of the reply.

    `away`: nobody is there; requests go nowhere. `others`: units that answer from the same memory.
    """

    memory: ScriptedPlc = field(default_factory=ScriptedPlc)
    unit: int = 1
    others: frozenset[int] = frozenset()
    echo: bool = False
    away: bool = False
    bend: Bend | None = None
    requests: list[bytes] = field(default_factory=list)
    put: Put = lambda _: None
    _rest: bytes = b""

    def heard(self, data: bytes) -> None:
        """Bytes from the driver."""
        if self.echo:
            self.put(data)
        self._rest += data
        while len(self._rest) >= 8 and len(self._rest) >= (size := self._size()):
            request, self._rest = self._rest[:size], self._rest[size:]
            self._take(request)

    def _size(self) -> int:
        return self._rest[6] + 9 if self._rest[1] in (15, 16) else 8

    def _take(self, request: bytes) -> None:
        assert rtu(request[0], request[1:-2]) == request, "the driver's CRC is wrong"
        self.requests.append(request)
        if self.away or request[0] not in (self.unit, *self.others):
            return
        start, count = struct.unpack(">HH", request[2:6])
        honest = rtu(request[0], self.memory.pdu(request[1], start, count, request[7:-2]))
        if self.bend is None:
            self.put(honest)
        else:
            self.bend(self, request, honest)

    def later(self, seconds: float, data: bytes) -> None:
        """Put bytes on the line after a while."""
        asyncio.get_running_loop().call_later(seconds, lambda: self.put(data))


@dataclass
class PtyLine:
    """A pair of pseudo-terminals: the device's end here, the driver's at `path`."""

    line: ScriptedLine
    path: str = ""
    _ends: tuple[int, int] = (-1, -1)

    def start(self) -> None:
        self._ends = pty.openpty()
        tty.setraw(self._ends[1])
        self.path = os.ttyname(self._ends[1])
        os.set_blocking(self._ends[0], False)
        self.line.put = self._put
        asyncio.get_running_loop().add_reader(self._ends[0], self._readable)

    def stop(self) -> None:
        asyncio.get_running_loop().remove_reader(self._ends[0])
        for end in self._ends:
            os.close(end)

    def _put(self, data: bytes) -> None:
        with contextlib.suppress(OSError):
            os.write(self._ends[0], data)

    def _readable(self) -> None:
        with contextlib.suppress(BlockingIOError):
            self.line.heard(os.read(self._ends[0], 4096))


@dataclass
class TcpLine:
    """A serial device server: RTU frames over TCP."""

    line: ScriptedLine
    port: int = 0
    _server: asyncio.Server | None = None
    _writers: set[asyncio.StreamWriter] = field(default_factory=set)

    async def start(self) -> None:
        self._server = await asyncio.start_server(self._serve, "127.0.0.1", self.port)
        self.port = self._server.sockets[0].getsockname()[1]

    async def stop(self) -> None:
        if self._server is not None:
            self._server.close()
            self._server = None
        for writer in list(self._writers):
            writer.transport.abort()
        await asyncio.sleep(0)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.add(writer)
        self.line.put = writer.write
        try:
            while data := await reader.read(4096):
                self.line.heard(data)
        except (OSError, asyncio.CancelledError):
            pass
        finally:
            self._writers.discard(writer)
            writer.close()
