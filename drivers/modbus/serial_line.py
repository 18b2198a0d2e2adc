"""One serial line, or one TCP connection to a serial device server: RTU requests, one at a time.

A reply on such a line names no request: one that comes late looks like the answer to whatever was asked last. So after
a request without an answer nothing is sent until the late one has come, or cannot come any more (`longest_reply` after
the request); what arrives meanwhile is dropped. That holds across reconnections: `Quiet` outlives the wire.
"""

import asyncio
import os
import termios
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import serial
from pymodbus.pdu import ModbusPDU

from drivers.driver import BeforeSending, Clock, anyhow
from drivers.errors import DeviceException, LinkDown, LinkFault, ReplyMismatch, ReplyTimeout
from drivers.modbus import rtu
from drivers.modbus.settings import ModbusSettings
from drivers.modbus.verify import Asked, check_reply
from drivers.modbus.wire import WireReply, socket_place
from drivers.tap import current, moved

GAP_S = 0.02
"""A pause that ends a reply of unknown length: long against an operating system's buffers, short against a deadline."""
_FLOOD = 65536
_CHUNK = 4096


@dataclass(slots=True)
class Quiet:
    """Until when nothing may be sent (the loop's time), because the request `after` may still be answered."""

    until: float = 0.0
    after: Asked | None = None


class _Port(Protocol):
    """A way to move bytes: the two that exist are below."""

    @property
    def ends(self) -> tuple[str, str]: ...

    def send(self, data: bytes) -> None: ...

    def close(self) -> None: ...


class LineWire:
    """An open line, from `connect` to `abandon`, for one exchange at a time. `on_lost` hears why it broke."""

    def __init__(self, settings: ModbusSettings, quiet: Quiet, *, clock: Clock, on_lost: Callable[[str], None]) -> None:
        self._settings, self._quiet, self._clock, self._on_lost = settings, quiet, clock, on_lost
        self._port: _Port | None = None
        self._data = b""
        self._heard = self._sent = 0.0
        self._arrived = asyncio.Event()
        self._tap = current()
        self.foreign = 0
        self.last = b""
        self.fault = LinkFault.OTHER

    async def connect(self) -> None:
        """Open the line; the caller sets the deadline by cancelling. Raises LinkDown with the system's own reason."""
        settings = self._settings
        try:
            if settings.serial:
                self._port = _SerialPort(settings, self)
            else:
                loop = asyncio.get_running_loop()
                _, self._port = await loop.create_connection(lambda: _Dialled(self), settings.host, settings.port)
        except termios.error as error:
            reason = f"the port does not take these settings ({error.args[-1]}): check baud, parity and stopbits"
            raise LinkDown(f"{settings.place} cannot be opened: {reason}") from error
        except (OSError, UnicodeError, ValueError) as error:  # pyserial's SerialException is an OSError
            # What pyserial says repeats the port and the number; the number's own word is enough.
            number = error.errno if settings.serial and isinstance(error, OSError) else None
            said = error.strerror if isinstance(error, OSError) else None
            reason = os.strerror(number).lower() if number else said or str(error)
            raise LinkDown(f"{settings.place} cannot be opened: {reason}") from error

    @property
    def alive(self) -> bool:
        """False once the line is gone. True says nothing about the device."""
        return self._port is not None

    def abandon(self) -> None:
        """Close at once."""
        port, self._port = self._port, None
        if port is not None:
            port.close()
        self._arrived.set()

    async def ask(
        self,
        request: ModbusPDU,
        deadline: float,
        before_sending: BeforeSending = anyhow,
        *,
        again: bool = False,
        most_open: int = 1,
    ) -> WireReply:
        """Send the request once and wait for its reply: `deadline` seconds, and the time that both need on the line.

        `again`: it is the very request that was asked last and not answered; a late reply to that one is its answer.
        On a line one question is open at most, whatever `most_open` says.

        Raises ReplyTimeout, ReplyMismatch, DeviceException, or LinkDown if the line is gone.
        """
        frame = rtu.request_frame(request)
        wanted = rtu.asked(frame)
        until = _now() + deadline + self._on_line(len(frame) + rtu.reply_octets(wanted))
        await self._settle(wanted, until)
        if again and self._quiet.until > 0 and self._quiet.after == wanted and self._late_reply_is_complete():
            late, self._data = self._data, b""
            self._checked(wanted, late)
            self.last = late[:-2]
            return WireReply(rtu.words_of(wanted, late), self._sent, self._clock())
        before_sending()
        self._data = b""
        # Noted before it is sent, and taken back by its reply: whatever goes wrong in between, the next request waits.
        self._quiet.until, self._quiet.after = _now() + self._settings.longest_reply, wanted
        sent = self._sent = self._clock()
        self._live_port().send(frame)
        self._tell(frame, sent=True)
        if self._settings.echo:
            await self._skip_echo(wanted, frame, until)
        reply = await self._reply(wanted, frame, until)
        received = self._clock()
        self._data = self._data[len(reply) :]
        self._checked(wanted, reply)
        self.last = reply[:-2]
        return WireReply(rtu.words_of(wanted, reply), sent, received)

    def _checked(self, wanted: Asked, reply: bytes) -> None:
        """Raises ReplyMismatch or DeviceException; the line is free where this was the reply, whatever it said."""
        try:
            check_reply(wanted, rtu.unwrapped(wanted, reply))
        except ReplyMismatch:
            if len(reply) == rtu.reply_octets(wanted) and reply[:2] == bytes((wanted.unit, wanted.function)):
                self._quiet.until = 0.0  # it was the answer, with noise in it
            raise
        except DeviceException:
            self._quiet.until = 0.0
            raise
        self._quiet.until = 0.0

    # ------------------------------------------------------------ before sending

    async def _settle(self, wanted: Asked, until: float) -> None:
        """Wait for silence, and after an unanswered request for its late reply or the end of its time."""
        while (left := self._quiet.until - _now()) > 0:
            if self._late_reply_is_complete():
                break
            if not await self._more(min(until, _now() + left)) and _now() >= until:
                after = self._quiet.after
                raise ReplyTimeout(f"{wanted}: not asked, as {after} may still be answered for {left:.2f} s")
        self.foreign += bool(self._data)
        pause = rtu.silence(self._settings.baud)
        await asyncio.sleep(max(pause, self._heard + pause - _now()))

    def _late_reply_is_complete(self) -> bool:
        """True if what came in the meantime is the whole reply that was missing."""
        after, data = self._quiet.after, self._data
        if after is None:
            return True
        try:
            length = rtu.reply_length(after, data)
        except ReplyMismatch:
            return False
        if length is None or len(data) < length:
            return False
        return data[0] == after.unit and rtu.crc(data[: length - 2]) == data[length - 2 : length]

    # ------------------------------------------------------------ the reply

    async def _skip_echo(self, wanted: Asked, frame: bytes, until: float) -> None:
        """Take away our own request, which the adapter gives back. Raises ReplyMismatch if it is another one."""
        while len(self._data) < len(frame):
            if not await self._more(until):
                raise ReplyTimeout(f"{wanted}: not even our own request came back: set echo = false?")
        if not self._data.startswith(frame):
            raise ReplyMismatch(f"{wanted}: what came back is not our request: does somebody else send on this line?")
        self._data = self._data[len(frame) :]

    async def _reply(self, wanted: Asked, frame: bytes, until: float) -> bytes:
        """The bytes of one reply. Raises ReplyTimeout, or ReplyMismatch for one that cannot be the answer."""
        while True:
            if len(self._data) >= len(frame) and self._data.startswith(frame):
                raise ReplyMismatch(f"{wanted}: the line gives back what is sent: set echo = true")
            try:
                length = rtu.reply_length(wanted, self._data)
            except ReplyMismatch:
                await self._rest()
                raise
            if length is not None and len(self._data) >= length:
                return self._data[:length]
            if not await self._more(until):
                part = f" ({len(self._data)} bytes of one came)" if self._data else ""
                raise ReplyTimeout(f"{wanted}: no reply in time{part}")

    async def _rest(self) -> None:
        """Let a frame of unknown length come to its end."""
        while await self._more(_now() + GAP_S):
            pass

    async def _more(self, until: float) -> bool:
        """Wait for more bytes, at most to the loop's time `until`. Raises LinkDown when the line goes."""
        self._live_port()
        self._arrived.clear()
        try:
            async with asyncio.timeout_at(until):
                await self._arrived.wait()
        except TimeoutError:
            return False
        self._live_port()
        return True

    def _live_port(self) -> _Port:
        if self._port is None:
            raise LinkDown(f"{self._settings.place} is closed")
        return self._port

    def _on_line(self, octets: int) -> float:
        return rtu.transmission(octets, self._settings.baud) if self._settings.serial else 0.0

    # ------------------------------------------------------------ called by the port

    def heard(self, data: bytes) -> None:
        """Bytes have come."""
        self._tell(data, sent=False)
        self._data, self._heard = self._data + data, _now()
        self._arrived.set()
        if len(self._data) > _FLOOD:
            self.broken("somebody floods the line with bytes that nobody asked for")

    def _tell(self, data: bytes, *, sent: bool) -> None:
        """Let the evidence know, where somebody gathers it."""
        if self._tap is not None and self._port is not None:
            place, local = self._port.ends
            self._tap(moved("tcp" if local else "serial", place, data, sent=sent, local=local))

    def broken(self, reason: str, fault: LinkFault = LinkFault.OTHER) -> None:
        """The line is gone."""
        if self._port is not None:
            self.abandon()
            self.fault = fault
            self._on_lost(f"{self._settings.place}: {reason}")


class _SerialPort:
    """A serial port of the operating system, by pyserial, driven by the event loop."""

    def __init__(self, settings: ModbusSettings, wire: LineWire) -> None:
        self._wire = wire
        self._serial = serial.Serial(
            settings.serial,
            settings.baud,
            parity=settings.parity,
            stopbits=settings.stopbits,
            timeout=0,
            write_timeout=0,
            exclusive=True,
        )
        self._serial.reset_input_buffer()
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._serial.fileno(), self._readable)

    @property
    def ends(self) -> tuple[str, str]:
        """The port; a serial line has no other end with a name."""
        return str(self._serial.port), ""

    def send(self, data: bytes) -> None:
        """Hand the bytes to the port; a request always fits in its buffer. Raises LinkDown."""
        try:
            if self._serial.write(data) != len(data):
                raise LinkDown(f"{self._serial.port}: the port takes no more bytes")
        except OSError as error:
            self._wire.broken(str(error))
            raise LinkDown(f"{self._serial.port}: {error}") from error

    def close(self) -> None:
        """Let the port go; what it has not sent yet is discarded."""
        if self._serial.is_open:
            self._loop.remove_reader(self._serial.fileno())
            self._serial.close()

    def _readable(self) -> None:
        try:
            data = self._serial.read(_CHUNK)
        except (OSError, TypeError) as error:  # TypeError: pyserial, when the port was closed meanwhile
            self._wire.broken(f"the port is gone ({error})")
            return
        if data:
            self._wire.heard(data)


class _Dialled(asyncio.Protocol):
    """A TCP connection to a serial device server."""

    def __init__(self, wire: LineWire) -> None:
        self._wire = wire
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        if isinstance(transport, asyncio.Transport):
            self._transport = transport

    def data_received(self, data: bytes) -> None:
        self._wire.heard(data)

    def connection_lost(self, exc: Exception | None) -> None:
        self._wire.broken("the peer closed the connection", LinkFault.CLOSED)

    @property
    def ends(self) -> tuple[str, str]:
        """The far end and ours."""
        names = (self._transport.get_extra_info(name) for name in ("peername", "sockname")) if self._transport else ()
        far, near = (*map(socket_place, names), "", "")[:2]
        return far, near

    def send(self, data: bytes) -> None:
        """Hand the bytes to the connection."""
        if self._transport is not None:
            self._transport.write(data)

    def close(self) -> None:
        """Close at once; what was not sent yet is discarded."""
        if self._transport is not None:
            self._transport.abort()


def _now() -> float:
    return asyncio.get_running_loop().time()
