"""The Modbus server over TCP, plain, secured or with RTU frames: bytes between sockets and the program.

The faults that only a socket can show are made here.
"""

import asyncio
import contextlib
import socket
import ssl
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from sim.plc.modbus.framing import MBAP, RTU, Framing
from sim.plc.modbus.units import ServedProgram
from sim.plc.program import CycleFaults, ModbusReply, ModbusRequest

_RESET_ON_CLOSE = struct.pack("ii", 1, 0)  # SO_LINGER on, 0 s: close sends RST
_PAUSE_S = 0.002  # between the pieces of a split reply, so that each is a segment of its own


@dataclass(eq=False, slots=True)
class _ServedClient:
    reader: asyncio.StreamReader
    writer: asyncio.StreamWriter
    peer: str
    task: asyncio.Task[None] | None
    deaf: bool = False
    refuses: Callable[[int], int | None] = lambda _: None

    def reset(self) -> None:
        """Close so that the peer sees a reset."""
        with contextlib.suppress(OSError):
            self.writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET_ON_CLOSE)
        self.writer.transport.abort()


@dataclass(frozen=True, slots=True)
class Security:
    """TLS for a server: its context, and what a connection may do by its certificate.

    `rights` gives the name of a peer's role, and the function that tells by which exception code a Modbus function is
    refused to that role (None: it is not).
    """

    context: ssl.SSLContext
    rights: Callable[[bytes | None], tuple[str, Callable[[int], int | None]]]


class ModbusServer:
    """Listens, answers each connection's requests in their order, and does what a cycle's Line says."""

    def __init__(
        self,
        plc: ServedProgram,
        host: str,
        port: int,
        max_clients: int,
        complain: Callable[[str], None],
        *,
        name: str = "tcp",
        framing: Framing = MBAP,
        security: Security | None = None,
    ) -> None:
        self.name, self.host, self.port = name, host, port
        self._plc, self._max_clients, self._complain = plc, max_clients, complain
        self._framing, self._security = framing, security
        self._listener: asyncio.Server | None = None
        self._connections: set[_ServedClient] = set()
        self._taken = False

    async def open(self) -> None:
        """Listen; with port 0 the port is chosen now and kept. Raises OSError."""
        context = self._security.context if self._security else None
        self._listener = await asyncio.start_server(self._accept, self.host, self.port, ssl=context)
        self.port = self._listener.sockets[0].getsockname()[1]

    async def apply(self, line: CycleFaults) -> None:
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

    def ready(self) -> dict[str, object]:
        """Where it listens."""
        return {"host": self.host, "port": self.port}

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
        connection = _ServedClient(reader, writer, f"{name[0]}:{name[1]}", asyncio.current_task())
        # A deaf connection takes no place: the client that gave it up comes back on another.
        served = sum(not other.deaf for other in self._connections)
        if served >= self._max_clients:
            self._event("connection turned away", connection)
            writer.close()
            return
        self._admit(connection)
        try:
            await self._serve(connection)
        except (asyncio.IncompleteReadError, OSError):
            pass  # the peer has gone; that is its right
        except asyncio.CancelledError:
            pass  # the server closes: nobody awaits this task for more than its end
        finally:
            self._connections.discard(connection)
            self._plc.connections -= 1
            self._event("disconnected", connection)
            writer.close()

    def _admit(self, connection: _ServedClient) -> None:
        self._connections.add(connection)
        self._plc.connections += 1
        detail = {}
        if self._security is not None:
            peer = connection.writer.get_extra_info("ssl_object").getpeercert(binary_form=True)
            role, connection.refuses = self._security.rights(peer)
            detail = {"role": role}
        self._event("connected", connection, detail)

    async def _serve(self, connection: _ServedClient) -> None:
        while True:
            frame = await self._framing.read(connection.reader)
            if frame.pdu is None:
                self._event("not Modbus", connection, {"bytes": frame.raw.hex()})
                if self._framing.closes:
                    return
                continue
            if connection.deaf:
                continue
            refused = connection.refuses(frame.pdu[0])
            head = (connection.peer, frame.transaction, frame.unit, frame.pdu)
            request = ModbusRequest(*head, face=self.name, rtu=self._framing.rtu, refused=refused)
            reply = self._plc.exchange(request, self._plc.clock.monotonic())
            if reply is not None and not await self._send(connection, reply):
                return

    async def _send(self, connection: _ServedClient, reply: ModbusReply) -> bool:
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

    def _event(self, what: str, connection: _ServedClient, detail: Mapping[str, object] | None = None) -> None:
        about = {"peer": connection.peer, "face": self.name, **(detail or {})}
        self._plc.event(what, self._plc.clock.monotonic(), about)


def make_rtu_tcp(plc: ServedProgram, options: Mapping[str, Any], complain: Callable[[str], None]) -> ModbusServer:
    """The face of RTU frames over TCP, as serial device servers speak them."""
    place = (options["host"], options["rtu_tcp"], options["max_clients"])
    return ModbusServer(plc, *place, complain, name="rtu-tcp", framing=RTU)
