"""One serial line, or one TCP connection to a serial device server: RTU or ASCII requests, one at a time.

A reply on such a line names its unit and no request: one that comes late looks like the answer to whatever that unit
was asked last. So after a request without an answer that unit is asked nothing until the late one has come, or cannot
come any more (`longest_reply` after the request); what arrives meanwhile is dropped. Other units on the line may be
asked, as long as nothing of the late reply has come: a frame of the silent unit is then known by its unit, function,
length and checksum, and taken out of what arrives. That holds across reconnections: `Quiet` outlives the wire.
"""

import asyncio
import os
import stat
import termios
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, cast

import serial
from pymodbus.pdu import ModbusPDU

from drivers.driver import BeforeSending, Clock, anyhow
from drivers.errors import DeviceException, LinkDown, LinkFault, NotAsked, ReplyMismatch, ReplyTimeout
from drivers.modbus import rtu
from drivers.modbus.ascii import AsciiStream, ascii_frame
from drivers.modbus.settings import ModbusSettings
from drivers.modbus.verify import ECHOED, HEADER, REGISTER_BYTES, Asked, check_reply, split_frames, unpack_words
from drivers.modbus.wire import WIDTHS, WireReply, read_little, socket_place, system_reason
from drivers.tap import Medium, current, make_frame

GAP_S = 0.02
"""A pause that ends a reply of unknown length: long against an operating system's buffers, short against a deadline."""
TORN_REPLY_GAP_S = 5 * GAP_S
"""After a pause of so long on a serial port the rest of a reply does not come any more: its bytes follow one another
within 1.5 characters (MODBUS over serial line V1.02, 2.5.1.1). A device server's network knows no such limit."""
_MAX_NOISE_BYTES = 8
"""Bytes before a reply that are passed over: what a transceiver makes as it turns round, no frame (V1.02, 2.5.1.1)."""
_TURN_ROUND = (b"\0", b"\xff")
"""Of such bytes the first; no device has these numbers."""
_PSEUDO_TERMINALS = range(136, 144)
"""Major numbers of devices (Linux, Documentation/admin-guide/devices.txt)."""
_FLOOD = 65536
_CHUNK = 4096


@dataclass(frozen=True, slots=True)
class Owed:
    """A request without an answer, which may still come before `until` (the loop's time); `sent` by the clock."""

    question: Asked
    until: float
    sent: float


@dataclass(frozen=True, slots=True)
class Quiet:
    """What each unit of the line was asked last and has not answered."""

    owed: dict[int, Owed] = field(default_factory=dict)
    failures: dict[int, str] = field(default_factory=dict)
    """By unit, why its last question failed: what waiting for its end would hide."""


class _ByteStream(Protocol):
    """A way to move bytes: the two that exist are below."""

    @property
    def ends(self) -> tuple[str, str]: ...

    def send(self, data: bytes) -> None: ...

    def close(self) -> None: ...


class LineWire:
    """An open line, from `connect` to `abandon`, for one exchange at a time.

    `on_lost` hears why it broke, `on_late` of which unit a reply came while another one was asked.
    """

    def __init__(
        self,
        settings: ModbusSettings,
        quiet: Quiet,
        *,
        clock: Clock,
        on_lost: Callable[[str], None],
        on_late: Callable[[int, bool], None] = lambda _, __: None,
    ) -> None:
        self._settings, self._quiet, self._clock = settings, quiet, clock
        self._on_lost, self._on_late = on_lost, on_late
        self._port: _ByteStream | None = None
        self._data = b""
        self._heard = 0.0
        # The units whose question without an answer is of the present reading.
        self._asked: set[int] = set()
        # What was answered last on this connection.
        self._answered: Asked | None = None
        self._arrived = asyncio.Event()
        self._ascii = AsciiStream() if settings.transport in ("ascii", "ascii-tcp") else None
        # Over UDP a number tells a late reply from the answer, and none is waited for.
        self._longest_reply = 0.0 if settings.transport == "udp" else settings.longest_reply
        self._tap = current()
        self.foreign = 0
        self.fault = LinkFault.OTHER
        self.refusal_hint = ""

    async def connect(self) -> None:
        """Open the line; the caller sets the deadline by cancelling. Raises LinkDown with the system's own reason."""
        settings = self._settings
        try:
            if settings.serial:
                self._port = _SerialPort(settings, self)
            else:
                loop, place = asyncio.get_running_loop(), (settings.host, settings.port)
                if settings.transport == "udp":
                    _, self._port = await loop.create_datagram_endpoint(lambda: _Datagrams(self), remote_addr=place)
                else:
                    dialled = _Headed if settings.transport == "tcp" else _Dialled
                    _, self._port = await loop.create_connection(lambda: dialled(self), *place)
        except termios.error as error:
            reason = f"the port does not take these settings ({error.args[-1]}): check baud, parity and stopbits"
            raise LinkDown(f"{settings.place} cannot be opened: {reason}") from error
        except (OSError, UnicodeError, ValueError) as error:  # pyserial's SerialException is an OSError
            # What pyserial says repeats the port and the number; the number's own word is enough.
            number = error.errno if settings.serial and isinstance(error, OSError) else None
            reason = os.strerror(number).lower() if number else system_reason(error)
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
        wanted = rtu.parse_request(frame, WIDTHS.get(request.__class__, REGISTER_BYTES))
        until = _now() + deadline + self._on_line(len(frame) + rtu.reply_octets(wanted))
        if not again:
            self._asked.discard(wanted.unit)
        await self._settle(wanted, until)
        owed = self._quiet.owed.get(wanted.unit) if wanted.unit in self._asked else None
        if owed is not None and owed.question == wanted and self._holds_reply(wanted):
            late, self._data = self._data, b""
            self._check(wanted, late)
            return WireReply(unpack_words(wanted, late[3:-2]), owed.sent, self._clock())
        before_sending()
        self._data = b""
        sent = self._clock()
        # Noted before it is sent, and taken back by its reply: whatever goes wrong in between, the next request waits.
        self._quiet.owed[wanted.unit] = Owed(wanted, _now() + self._longest_reply, sent)
        self._asked.add(wanted.unit)
        moving = frame if self._ascii is None else ascii_frame(frame)
        self._live_port().send(moving)
        self._tell(moving, sent=True)
        try:
            if self._settings.echo:
                await self._skip_echo(wanted, frame, until)
            reply = await self._reply(wanted, frame, until)
            received = self._clock()
            self._data = self._data[len(reply) :]
            self._check(wanted, reply)
        except (ReplyTimeout, ReplyMismatch) as error:
            self._quiet.failures[wanted.unit] = str(error)
            raise
        self._quiet.failures.pop(wanted.unit, None)
        return WireReply(unpack_words(wanted, reply[3:-2]), sent, received)

    def _check(self, wanted: Asked, reply: bytes) -> None:
        """Raises ReplyMismatch or DeviceException; the line is free where this was the reply, whatever it said."""
        try:
            check_reply(wanted, rtu.unwrap(wanted, reply))
        except ReplyMismatch:
            if len(reply) == rtu.reply_octets(wanted) and reply[:2] == bytes((wanted.unit, wanted.function)):
                self._quiet.owed.pop(wanted.unit, None)  # it was the answer, with noise in it
            raise
        except DeviceException:
            self._quiet.owed.pop(wanted.unit, None)
            raise
        self._quiet.owed.pop(wanted.unit, None)
        self._answered = wanted

    # ------------------------------------------------------------ before sending

    async def _settle(self, wanted: Asked, until: float) -> None:
        """Wait for silence, and after an unanswered request for its late reply or the end of its time."""
        pause = rtu.silence(self._settings.baud)
        while True:
            self._take_out_late(wanted.unit)
            owed = self._find_owed_reply(wanted)
            if owed is not None and not self._holds_reply(owed.question):
                left = owed.until - _now()
                if owed.question.unit != wanted.unit and self._settings.serial:
                    left = min(left, self._heard + TORN_REPLY_GAP_S - _now())
                    if left <= 0.0:
                        self._data, self.foreign = b"", self.foreign + 1
                        continue
                if not await self._more(min(until, _now() + left)) and _now() >= until:
                    why = self._quiet.failures.get(owed.question.unit, "")
                    raise NotAsked(
                        f"{wanted}: not asked, as {owed.question} may still be answered for {left:.2f} s"
                        + (f"; what went wrong: {why}" if why else "")
                    )
                continue
            await asyncio.sleep(max(pause, self._heard + pause - _now()))
            # What has begun to come in this very pause may be the head of another unit's late reply, whose tail must
            # not meet our request.
            self._take_out_late(wanted.unit)
            owed = self._find_owed_reply(wanted)
            if owed is not None and owed.question.unit != wanted.unit:
                continue
            if owed is None and self._skip_repeats() and (silent_at := self._heard + TORN_REPLY_GAP_S) > _now():
                if not await self._more(min(until, silent_at)) and silent_at > until:
                    raise NotAsked(f"{wanted}: not asked, as the answer before it is being repeated")
                continue
            break
        self.foreign += bool(self._data)

    def _skip_repeats(self) -> bool:
        """Whether the last answer begins to come once more: it would be the next one's. Whole ones are dropped."""
        last = self._answered
        if last is None:
            return False
        while self._holds_reply(last):
            self._data = self._data[rtu.reply_length(last, self._data) :]
            self.foreign += 1
        return bool(self._data) and self._data[:2] == bytes((last.unit, last.function))[: len(self._data)]

    def _find_owed_reply(self, wanted: Asked) -> Owed | None:
        """The late reply that has to come, or to become impossible, before `wanted` may be asked: of its own unit, or
        of another one of which a part has come."""
        now = _now()
        for unit in (*self._data[:1], wanted.unit):
            owed = self._quiet.owed.get(unit)
            if owed is not None and owed.until > now:
                return owed
        return None

    def _holds_reply(self, question: Asked) -> bool:
        """True if what came in the meantime begins with a whole reply to the question."""
        return rtu.begins_reply(question, self._data)

    def _take_out_late(self, asked_unit: int) -> None:
        """Drop whole late replies of units other than the one that is asked from the front of what has come."""
        while self._data and self._data[0] != asked_unit:
            owed = self._quiet.owed.get(self._data[0])
            if owed is None or not self._holds_reply(owed.question):
                return
            self._data = self._data[rtu.reply_length(owed.question, self._data) :]
            del self._quiet.owed[owed.question.unit]
            self.foreign += 1
            self._on_late(owed.question.unit, True)

    # ------------------------------------------------------------ the reply

    async def _skip_echo(self, wanted: Asked, frame: bytes, until: float) -> None:
        """Take away our own request, which the adapter gives back. Raises ReplyMismatch if it is another one."""
        while len(self._data) < len(frame):
            if not await self._more(until):
                raise ReplyTimeout(
                    f"{wanted}: not even our own request came back: set echo = false?", remedy={"echo": False}
                )
            self._take_out_late(wanted.unit)
        if not self._data.startswith(frame):
            raise ReplyMismatch(f"{wanted}: what came back is not our request: does somebody else send on this line?")
        self._data = self._data[len(frame) :]

    async def _reply(self, wanted: Asked, frame: bytes, until: float) -> bytes:
        """The bytes of one reply. Raises ReplyTimeout, or ReplyMismatch for one that cannot be the answer."""
        while True:
            self._take_out_late(wanted.unit)
            echoed = wanted.function not in ECHOED and len(self._data) >= len(frame) and self._data.startswith(frame)
            if echoed:
                raise ReplyMismatch(
                    f"{wanted}: the line gives back what is sent: set echo = true", remedy={"echo": True}
                )
            self._pass_noise(wanted)
            try:
                length = None if self._begins_with_noise(wanted) else rtu.reply_length(wanted, self._data)
            except ReplyMismatch:
                await self._rest()
                if self._pass_noise(wanted):
                    continue
                raise
            if length is not None and len(self._data) >= length:
                return self._data[:length]
            if not await self._more(until):
                part = f" ({len(self._data)} bytes of one came)" if self._data else ""
                raise ReplyTimeout(f"{wanted}: no reply in time{part}")

    def _begins_with_noise(self, wanted: Asked) -> bool:
        if self._settings.transport in ("tcp", "udp"):
            return False  # what came with a header is whole, and from whom it says it is
        return (
            self._data[:1] in _TURN_ROUND and self._data[0] != wanted.unit and len(self._data) <= _MAX_NOISE_BYTES + 256
        )

    def _pass_noise(self, wanted: Asked) -> bool:
        """Drop what stands before the reply that was asked for, which its unit, function, length and CRC tell."""
        for at in range(1, min(_MAX_NOISE_BYTES, len(self._data) - 1) + 1):
            if rtu.begins_reply(wanted, self._data[at:]) and not self._holds_reply(wanted):
                self._data, self.foreign = self._data[at:], self.foreign + 1
                return True
        return False

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

    def _live_port(self) -> _ByteStream:
        if self._port is None:
            raise LinkDown(f"{self._settings.place} is closed")
        return self._port

    def _on_line(self, octets: int) -> float:
        characters = octets if self._ascii is None else 2 * octets + 1
        return rtu.transmission(characters, self._settings.baud) if self._settings.serial else 0.0

    # ------------------------------------------------------------ called by the port

    def receive_frame(self, plain: bytes, *, matches: bool) -> None:
        """A frame without its header has come; `matches`: the header's number was that of the last request."""
        if not matches and self._settings.transaction_id != "any":
            self.foreign += 1
            return
        if self._settings.answers_as == plain[0]:
            plain = bytes((self._settings.unit,)) + plain[1:]
        self.receive(plain + rtu.crc(plain))

    def receive(self, data: bytes) -> None:
        """Bytes have come."""
        self._tell(data, sent=False)
        if self._ascii is not None:
            spoilt = self._ascii.spoilt
            data = self._ascii.take(data)
            self.foreign += self._ascii.spoilt - spoilt
        self._data, self._heard = self._data + data, _now()
        self._arrived.set()
        if len(self._data) > _FLOOD:
            self.note_loss("somebody floods the line with bytes that nobody asked for")

    def _tell(self, data: bytes, *, sent: bool) -> None:
        """Let the evidence know, where somebody gathers it."""
        if self._tap is not None and self._port is not None:
            place, local = self._port.ends
            network: Medium = "udp" if self._settings.transport == "udp" else "tcp"
            self._tap(make_frame(network if local else "serial", place, data, sent=sent, local=local))

    def note_loss(self, reason: str, fault: LinkFault = LinkFault.OTHER) -> None:
        """The line is gone."""
        if self._port is not None:
            self.abandon()
            self.fault = fault
            self._on_lost(f"{self._settings.place}: {reason}")


class _SerialPort:
    """A serial port of the operating system, by pyserial, driven by the event loop."""

    def __init__(self, settings: ModbusSettings, wire: LineWire) -> None:
        self._wire = wire
        # A pseudo-terminal (socat, ser2net) carries bytes: it takes a parity the first time and refuses it the second.
        bare = _is_pseudo_terminal(settings.serial)
        self._serial = serial.Serial(
            settings.serial,
            settings.baud,
            parity="N" if bare else settings.parity,
            stopbits=settings.stopbits,
            bytesize=8 if bare else settings.bytesize,
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
            self._wire.note_loss(str(error))
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
            self._wire.note_loss(f"the port is gone ({error})")
            return
        if data:
            self._wire.receive(data)


class _Dialled(asyncio.Protocol):
    """A TCP connection to a serial device server."""

    def __init__(self, wire: LineWire) -> None:
        self._wire = wire
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        if isinstance(transport, asyncio.Transport):
            self._transport = transport
            read_little(transport)

    def data_received(self, data: bytes) -> None:
        self._wire.receive(data)

    def connection_lost(self, exc: Exception | None) -> None:
        self._wire.note_loss("the peer closed the connection", LinkFault.CLOSED)

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


class _Headed(_Dialled):
    """A connection of Modbus TCP whose replies are told apart as on a serial line: by their unit, function and length.

    For devices that put a number of their own into the header: each frame goes without it and comes with a checksum.
    """

    def __init__(self, wire: LineWire) -> None:
        super().__init__(wire)
        self._number, self._rest = 0, b""

    def send(self, data: bytes) -> None:
        """Send a frame with a header in the place of its checksum."""
        self._number = self._number % 0xFFFF + 1
        super().send(add_header(self._number, data[:-2]))

    def data_received(self, data: bytes) -> None:
        try:
            frames, self._rest = split_frames(self._rest + data)
        except ReplyMismatch as error:
            self._wire.note_loss(str(error), LinkFault.FOREIGN)
            return
        for frame in frames:
            self._wire.receive_frame(frame[HEADER:], matches=int.from_bytes(frame[:2], "big") == self._number)


class _Datagrams(asyncio.DatagramProtocol):
    """Modbus over UDP: each datagram is a frame with its header, and none of it comes in another one."""

    def __init__(self, wire: LineWire) -> None:
        self._wire = wire
        self._transport: asyncio.DatagramTransport | None = None
        self._number = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        # asyncio's own of Python 3.11 is none by its class.
        self._transport = cast(asyncio.DatagramTransport, transport)

    def datagram_received(self, data: bytes, addr: tuple[str | Any, int]) -> None:
        try:
            frames, rest = split_frames(data)
        except ReplyMismatch as error:
            self._wire.note_loss(str(error), LinkFault.FOREIGN)
            return
        for frame in frames if not rest else ():
            self._wire.receive_frame(frame[HEADER:], matches=int.from_bytes(frame[:2], "big") == self._number)

    def error_received(self, exc: Exception) -> None:
        self._wire.note_loss(f"nothing takes datagrams there ({exc})", LinkFault.REFUSED)

    @property
    def ends(self) -> tuple[str, str]:
        """The far end and ours."""
        names = (self._transport.get_extra_info(name) for name in ("peername", "sockname")) if self._transport else ()
        far, near = (*map(socket_place, names), "", "")[:2]
        return far, near

    def send(self, data: bytes) -> None:
        """Send a frame with a header in the place of its checksum."""
        if self._transport is not None:
            self._number = self._number % 0xFFFF + 1
            self._transport.sendto(add_header(self._number, data[:-2]))

    def close(self) -> None:
        """Close at once."""
        if self._transport is not None:
            self._transport.abort()


def add_header(number: int, plain: bytes) -> bytes:
    """Unit and PDU behind a header of Modbus TCP."""
    return number.to_bytes(2, "big") + b"\0\0" + len(plain).to_bytes(2, "big") + plain


def _is_pseudo_terminal(path: str) -> bool:
    try:
        state = Path(path).stat()
    except OSError:
        return False
    return stat.S_ISCHR(state.st_mode) and os.major(state.st_rdev) in _PSEUDO_TERMINALS


def _now() -> float:
    return asyncio.get_running_loop().time()
