"""A Modbus TCP server for peers: functions 1 to 4, everything else refused (MODBUS Application Protocol V1.1b3).

pymodbus's server answers only the first of several requests in one segment and hears nothing more after a bad protocol
id (3.16.1, measured); one that peers rely on must do neither, and reading is four functions.
"""

import asyncio
import socket
import struct
from collections.abc import Mapping
from contextlib import suppress
from typing import Protocol

from gateway.network import SharedPlaces

_TABLES = {1: "coil", 2: "discrete", 3: "holding", 4: "input"}
_BITS = (1, 2)
_MOST = {1: 2000, 2: 2000, 3: 125, 4: 125}
_ILLEGAL_FUNCTION, _ILLEGAL_ADDRESS, _ILLEGAL_VALUE, _NO_PATH = 1, 2, 3, 10
_HEADER = struct.Struct(">HHHB")
_LONGEST = 254
IDLE_S = 300.0
"""A client that asks nothing for so long makes room for another."""


_NO_UNIT = (0, 255)


class ServedImage(Protocol):
    """What is served for one unit: see `gateway.outside.serving.DeviceImage`."""

    def read(self, table: str, start: int, count: int) -> list[int] | int: ...


class PeerServer:
    """Serves each machine's image under its unit number, to `most_clients` at a time; `port` 0 takes a free one.

    Where all places are taken, one address gives way to another that has fewer.
    """

    def __init__(self, host: str, port: int, images: Mapping[int, ServedImage], *, most_clients: int = 8) -> None:
        self.host, self.port = host, port
        self.refused = self.answered = 0
        # Clients that know of no units ask 255, some 0 (MODBUS Messaging on TCP/IP V1.0b, page 23): the first machine.
        # Those that are told none ask 1: where there is one machine, it is meant.
        first = next(iter(images.values()), None)
        self._images = dict.fromkeys((*_NO_UNIT, *((1,) if len(images) == 1 else ())), first) | dict(images)
        self._clients: SharedPlaces[asyncio.StreamWriter] = SharedPlaces(most_clients, _abort)

    async def serve(self) -> None:
        """Serve until cancelled. Raises OSError where the port cannot be had."""
        try:
            server = await asyncio.start_server(self._serve_client, self.host, self.port)
        except OSError as error:
            reason = error.strerror or str(error)
            raise OSError(error.errno, f"{self.host}:{self.port} cannot be served: {reason}; see [serve]") from None
        self.port = server.sockets[0].getsockname()[1]
        try:
            await server.serve_forever()
        finally:
            server.close()
            for writer in self._clients.holders:
                writer.transport.abort()

    async def _serve_client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        peer = writer.get_extra_info("peername") or ("unknown",)  # it has gone
        if not self._clients.take(writer, str(peer[0])):
            self.refused += 1
            writer.close()
            return
        raw: socket.socket = writer.get_extra_info("socket")
        raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        # The peer has gone, asks nothing, or the server closes: nobody awaits this task for more than its end.
        with suppress(asyncio.IncompleteReadError, OSError, TimeoutError, asyncio.CancelledError):
            while True:
                async with asyncio.timeout(IDLE_S):
                    transaction, protocol, length, unit = _HEADER.unpack(await reader.readexactly(_HEADER.size))
                    if protocol != 0 or not 2 <= length <= _LONGEST:
                        break  # it is not Modbus: from here on nothing can be told apart
                    pdu = self.answer(unit, await reader.readexactly(length - 1))
                    writer.write(_HEADER.pack(transaction, 0, len(pdu) + 1, unit) + pdu)
                    await writer.drain()
        self._clients.release(writer)
        writer.close()

    def answer(self, unit: int, request: bytes) -> bytes:
        """The PDU of the reply to a request's."""
        function, image = request[0], self._images.get(unit)
        code = 0
        if image is None:
            code = _NO_PATH
        elif function not in _TABLES:
            code = _ILLEGAL_FUNCTION
        elif len(request) != 5:
            code = _ILLEGAL_VALUE
        if code or image is None:
            return bytes((function | 0x80, code))
        start, count = struct.unpack(">HH", request[1:])
        if not 1 <= count <= _MOST[function]:
            return bytes((function | 0x80, _ILLEGAL_VALUE))
        words = image.read(_TABLES[function], start, count) if start + count <= 0x10000 else _ILLEGAL_ADDRESS
        if isinstance(words, int):
            return bytes((function | 0x80, words))
        self.answered += 1
        if function in _BITS:
            size = (count + 7) // 8
            packed = sum(bool(bit) << number for number, bit in enumerate(words))
            return bytes((function, size)) + packed.to_bytes(size, "little")
        return struct.pack(f">BB{count}H", function, 2 * count, *words)


def _abort(client: asyncio.StreamWriter) -> None:
    client.transport.abort()
