"""The Modbus TCP server: bytes between sockets and the program, and the faults that only a socket can show."""

import asyncio
import contextlib
import socket
import struct
from collections.abc import Callable
from dataclasses import dataclass

from sim.plc.modbus import HEADER, MAX_PDU, Reply, Request
from sim.plc.program import Line, Plc

_RESET_ON_CLOSE = struct.pack("ii", 1, 0)  # SO_LINGER on, 0 s: close sends RST
_PAUSE_S = 0.002  # between the pieces of a split reply, so that each is a segment of its own


@dataclass(eq=False, slots=True)
class _Connection:
    reader: asyncio.StreamReader
    writer: asyncio.StreamWriter
    peer: str
    task: asyncio.Task[None] | None
    deaf: bool = False

    def reset(self) -> None:
        """Close so that the peer sees a reset."""
        with contextlib.suppress(OSError):
            self.writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET_ON_CLOSE)
        self.writer.transport.abort()


class ModbusServer:
    """Listens, answers each connection's requests in their order, and does what a cycle's Line says."""

    def __init__(self, plc: Plc, host: str, port: int, max_clients: int, complain: Callable[[str], None]) -> None:
        self.host, self.port = host, port
        self._plc, self._max_clients, self._complain = plc, max_clients, complain
        self._listener: asyncio.Server | None = None
        self._connections: set[_Connection] = set()
        self._taken = False

    async def open(self) -> None:
        """Listen; with port 0 the port is chosen now and kept. Raises OSError."""
        self._listener = await asyncio.start_server(self._accept, self.host, self.port)
        self.port = self._listener.sockets[0].getsockname()[1]

    async def apply(self, line: Line) -> None:
        """Bring the listener and the connections to what the cycle asks for."""
        if not line.listen and self._listener is not None:
            self._listener.close()
            self._listener = None
        if line.reset:
            for connection in tuple(self._connections):
                connection.reset()
        if line.deafen:
            for connection in self._connections:
                connection.deaf = True
        if line.listen and self._listener is None:
            await self._reopen()

    async def close(self) -> None:
        """Stop listening and close every connection."""
        if self._listener is not None:
            self._listener.close()
        tasks = [connection.task for connection in self._connections if connection.task]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _reopen(self) -> None:
        try:
            await self.open()
        except OSError as error:
            if not self._taken:
                self._complain(f"port {self.port} cannot be listened on again ({error.strerror}); trying every cycle")
            self._taken = True
        else:
            self._taken = False

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        name = writer.get_extra_info("peername") or ("?", 0)
        connection = _Connection(reader, writer, f"{name[0]}:{name[1]}", asyncio.current_task())
        served = sum(not other.deaf for other in self._connections)
        if served >= self._max_clients:
            self._event("connection turned away", connection)
            writer.close()
            return
        self._connections.add(connection)
        self._event("connected", connection)
        try:
            await self._serve(connection)
        except (asyncio.IncompleteReadError, OSError):
            pass  # the peer has gone; that is its right
        except asyncio.CancelledError:
            pass  # the server closes: nobody awaits this task for more than its end
        finally:
            self._connections.discard(connection)
            self._event("disconnected", connection)
            writer.close()

    async def _serve(self, connection: _Connection) -> None:
        while True:
            head = await connection.reader.readexactly(HEADER.size)
            transaction, protocol, length, unit = HEADER.unpack(head)
            if protocol != 0 or not 2 <= length <= MAX_PDU + 1:
                self._event("not Modbus", connection, head.hex())
                return
            pdu = await connection.reader.readexactly(length - 1)
            if connection.deaf:
                continue
            request = Request(connection.peer, transaction, unit, pdu)
            reply = self._plc.exchange(request, self._plc.clock.monotonic())
            if reply is not None and not await self._send(connection, reply):
                return

    async def _send(self, connection: _Connection, reply: Reply) -> bool:
        """Send the reply as it says; False when that ended the connection."""
        if reply.delay_s > 0:
            await asyncio.sleep(reply.delay_s)
        if connection.deaf:
            return True
        frame = reply.frame()
        if reply.cut is not None:
            connection.writer.write(frame[: reply.cut])
            connection.reset()
            return False
        piece = reply.piece or max(1, len(frame))
        for start in range(0, len(frame), piece):
            connection.writer.write(frame[start : start + piece])
            if reply.piece is not None:
                await asyncio.sleep(_PAUSE_S)
        await connection.writer.drain()
        return True

    def _event(self, what: str, connection: _Connection, frame: str | None = None) -> None:
        self._plc.connections = len(self._connections)
        detail = {"peer": connection.peer} if frame is None else {"peer": connection.peer, "bytes": frame}
        self._plc.event(what, self._plc.clock.monotonic(), detail)
