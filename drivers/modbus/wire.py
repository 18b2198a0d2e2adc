"""One TCP or TLS connection to a Modbus device: pymodbus 3.16.1 behind our own verification of every received byte.

pymodbus connects, moves the bytes and frames the requests. What it does with a reply is left out: its transactions cost
a task and two timers for each request, accept what they should not (tests/drivers/test_pymodbus_contract.py), and its
TLS framer takes every record for a frame. Every received byte comes here by `callback_data`; the stream is cut into
frames, and one that answers the outstanding request ends the exchange. That hook, `callback_disconnected`,
`call_create`, the framer and the transport behind `client.ctx` are all that is used beyond its everyday interface; the
same tests fail if they change.
"""

import asyncio
import errno
import os
import re
import socket
import ssl
import struct
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

from pymodbus.client import AsyncModbusTcpClient, AsyncModbusTlsClient
from pymodbus.pdu import ModbusPDU
from pymodbus.pdu.bit_message import (
    ReadCoilsRequest,
    ReadDiscreteInputsRequest,
    WriteMultipleCoilsRequest,
    WriteSingleCoilRequest,
)
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadInputRegistersRequest,
    WriteMultipleRegistersRequest,
    WriteSingleRegisterRequest,
)

from drivers.driver import BeforeSending, Clock, anyhow
from drivers.errors import DeviceException, DriverError, LinkDown, LinkFault, ReplyMismatch, ReplyTimeout
from drivers.modbus.address import Area
from drivers.modbus.replies import ReplyStream, TransactionIds
from drivers.modbus.verify import (
    REGISTER_BYTES,
    WIDE_REGISTER_BYTES,
    WRITES,
    Asked,
    as_asked,
    check_reply,
    leaves_open,
    parse_request,
    unpack_words,
)
from drivers.tap import current, make_frame

FLOOD = 65536
"""More than the longest frame (260 bytes) many times over. Beyond it a peer that nobody asked is flooding the line."""
MAX_REST_S = 0.5
"""Behind another unit's frame the answer of the one that was asked is waited for so long at most."""
NOT_BEHIND_A_PART = "of a reply that nobody waits for {} bytes have come, and nothing is asked behind them"
LATE = " (a reply came {:.2f} s after its request, too late: give a longer timeout)"
ANY_ID = {"transaction_id": "any"}
OTHER_ID = (
    ' ({} with another transaction id dropped; if all of the device\'s answers have, give transaction_id = "any")'
)
_READ_BYTES = 16_384
"""Read from a socket at once, many frames. asyncio's own 256 KiB are allocated anew for each reply and, by the state of
the heap, returned to the system: the page faults of that are a third of a scan's processor time."""
# A chunk that pymodbus finds too large it drops without a word.
_LARGEST_CHUNK = 1 << 20
_PROBE_S, _PROBES = 1, 2
# pymodbus times nothing here: every exchange and every connect has a deadline of ours, and it must not fire first.
_NO_TIMEOUT_S = 3600.0

_READS: dict[Area, type[ModbusPDU]] = {
    Area.COIL: ReadCoilsRequest,
    Area.DISCRETE: ReadDiscreteInputsRequest,
    Area.INPUT: ReadInputRegistersRequest,
    Area.HOLDING: ReadHoldingRegistersRequest,
}


class _ReadWideHoldingRegisters(ReadHoldingRegistersRequest):
    """A read of registers of 32 bits: the bytes of any read, and a reply of twice as many."""


class _ReadWideInputRegisters(ReadInputRegistersRequest):
    """As `_ReadWideHoldingRegisters`."""


_WIDE_READS: dict[Area, type[ModbusPDU]] = {
    Area.INPUT: _ReadWideInputRegisters,
    Area.HOLDING: _ReadWideHoldingRegisters,
}
WIDTHS = dict.fromkeys(_WIDE_READS.values(), WIDE_REGISTER_BYTES)
"""The bytes of a register by the kind of request, where they are not the usual ones."""


@dataclass(frozen=True, slots=True)
class WireReply:
    """The registers (or bits as 0 and 1) of one reply, with the moments of sending and of complete reception."""

    words: tuple[int, ...]
    sent: float
    received: float


@lru_cache(maxsize=1024)
def read_request(area: Area, start: int, count: int, unit: int, *, wide: bool = False) -> ModbusPDU:
    """The request that reads `count` addresses of a table; made once, as a wire numbers it when it frames it.

    `wide`: they are registers of 32 bits.
    """
    return (_WIDE_READS if wide else _READS)[area](address=start, count=count, dev_id=unit)


def write_request(area: Area, start: int, words: Sequence[int], unit: int, *, single: bool = False) -> ModbusPDU:
    """The one request (function 16, for coils 15) that writes all words; `single`: the one word, by 6 or 5."""
    if single:
        if area is Area.COIL:
            return WriteSingleCoilRequest(address=start, bits=[bool(words[0])], dev_id=unit)
        return WriteSingleRegisterRequest(address=start, registers=[words[0]], dev_id=unit)
    if area is Area.COIL:
        return WriteMultipleCoilsRequest(address=start, bits=[bool(word) for word in words], dev_id=unit)
    return WriteMultipleRegistersRequest(address=start, registers=list(words), dev_id=unit)


@dataclass(frozen=True, slots=True)
class Secured:
    """TLS for a wire: the context, the name that the server's certificate must have, and failures in words.

    `refusal_hint`: what else exception 1 (illegal function) may mean, by the certificate that the server is shown.
    """

    context: ssl.SSLContext
    name: str
    sentence: Callable[[Exception], str]
    refusal_hint: str


class Wire:
    """A connection, from `connect` to `abandon`, for one exchange at a time. `on_lost` hears why it broke.

    With `answers_as` what that unit says is the answer of the one that was asked.
    """

    def __init__(
        self,
        host: str,
        port: int,
        *,
        ids: TransactionIds,
        clock: Clock,
        on_lost: Callable[[str], None],
        secured: Secured | None = None,
        answers_as: int | None = None,
    ) -> None:
        self._ids = ids
        self._clock = clock
        self._on_lost = on_lost
        self._secured = secured
        self._answers_as = answers_as
        self._client = self._make_client(host, port, secured)
        self._client.ctx.callback_disconnected = self._on_disconnect  # type: ignore[method-assign]
        self._client.ctx.callback_data = self._take  # type: ignore[method-assign]
        self._client.ctx.max_buffer_size = _LARGEST_CHUNK
        self._request: Asked | None = None
        # The ids under which it has been sent.
        self._attempts: set[int] = set()
        # Sent on this connection and not answered, by transaction id, with the moment of sending.
        self._open: dict[int, tuple[Asked, float]] = {}
        self._any_answer = asyncio.Event()
        self._outcome: asyncio.Future[WireReply] | None = None
        # Of the present question's deadline.
        self._timer: asyncio.TimerHandle | None = None
        self._sent = self._received = 0.0
        self._stream = ReplyStream(ids, self._take_frame, self._break_cut)
        self._unasked = 0
        # How late (s) something came during this exchange that had been given up; 0: nothing did.
        self._late = 0.0
        self.foreign = 0
        self.fault = LinkFault.OTHER
        self.refusal_hint = secured.refusal_hint if secured else ""
        self._tap = current()

    def _make_client(self, host: str, port: int, secured: Secured | None) -> AsyncModbusTcpClient:
        """pymodbus's client for the connection, with everything that it does by itself turned off."""
        if secured is None:
            return AsyncModbusTcpClient(host, port=port, retries=0, reconnect_delay=0, timeout=_NO_TIMEOUT_S)
        client = AsyncModbusTlsClient(
            host, port=port, sslctx=secured.context, retries=0, reconnect_delay=0, timeout=_NO_TIMEOUT_S
        )
        create = client.ctx.loop.create_connection
        names = {"ssl": secured.context, "server_hostname": secured.name}
        client.ctx.call_create = partial(create, client.ctx.handle_new_connection, host, port, **names)
        return client

    async def connect(self) -> None:
        """Connect; the caller sets the deadline by cancelling. Raises LinkDown with the system's own reason."""
        parameters = self._client.comm_params
        try:
            # Not client.connect(): that one answers False and keeps the reason to itself.
            await self._client.ctx.call_create()
            if isinstance(transport := self._client.ctx.transport, asyncio.Transport):
                keep_alive(transport)
                read_little(transport)
        except (OSError, ValueError) as error:  # ValueError: a host name that DNS or TLS cannot even be asked for
            self._client.close()
            raise no_connection(f"{parameters.host}:{parameters.port}", error, self._secured) from error
        except asyncio.CancelledError:
            self._client.close()
            raise

    @property
    def alive(self) -> bool:
        """False once the connection is gone. True says nothing about the peer."""
        return bool(self._client.connected)

    def abandon(self) -> None:
        """Close at once. What an unanswered request left in the send buffer is discarded, not delivered late."""
        self._stream.close()
        transport = self._client.ctx.transport
        if isinstance(transport, asyncio.Transport):
            discard(transport, [question for question, _ in self._open.values()])
        self._client.close()

    async def ask(
        self,
        request: ModbusPDU,
        deadline: float,
        before_sending: BeforeSending = anyhow,
        *,
        again: bool = False,
        most_open: int = 2,
    ) -> WireReply:
        """Send the request once and wait up to `deadline` seconds for the reply that answers it.

        `again`: it is the very request that was asked last and not answered; a late reply to that one is its answer.
        Any other waits while `most_open` are on the connection without an answer: a PLC that stands still shall not
        collect questions. A connection ends on which a part of a reply has come, and no more of it within the deadline.

        Raises ReplyTimeout, ReplyMismatch, DeviceException, or LinkDown if the connection breaks or cannot be
        understood any more (then `alive` is False).
        """
        if not again:
            self._attempts.clear()
        if len(self._open) >= most_open and not again:
            began = asyncio.get_running_loop().time()
            await self._answer_to_another(deadline)
            deadline -= asyncio.get_running_loop().time() - began
        if part := self._stream.remainder:
            self._break_cut(reason := NOT_BEHIND_A_PART.format(len(part)))
            raise LinkDown(reason, fault=LinkFault.CUT)
        transport = self._client.ctx.transport
        if not isinstance(transport, asyncio.Transport):
            raise LinkDown("the connection is closed")
        loop = asyncio.get_running_loop()
        foreign, self._request, self._late = self.foreign, None, 0.0

        def too_late() -> None:
            others, part = self.foreign - foreign, self._stream.remainder
            late = self._late
            why = LATE.format(late) if late else OTHER_ID.format(others) if others else ""
            remedy = ANY_ID if others and not late and not part else None
            why = f" ({len(part)} bytes of one came)" if part else why
            sentence = f"{self._request}: no reply within {deadline:.3g} s{why}"
            self._fail(ReplyTimeout(sentence, remedy=remedy))
            if part:
                self._break_cut(sentence)  # bytes of the next reply would make it whole

        # Between the two nothing else of the event loop can run.
        before_sending()
        self._send(transport, request)
        outcome: asyncio.Future[WireReply] = loop.create_future()
        self._outcome = outcome
        timer = self._timer = loop.call_later(deadline, too_late)
        try:
            return await outcome
        finally:
            timer.cancel()
            self._outcome = None

    def _send(self, transport: asyncio.Transport, request: ModbusPDU) -> None:
        """Give the request to the system, under a transaction id of its own."""
        number = request.transaction_id = self._ids.take(asyncio.get_running_loop().time())
        self._attempts.add(number)
        data = self._client.ctx.framer.buildFrame(request)
        # Read from the very bytes that go: what was asked is what the reply is held against.
        width = WIDTHS.get(request.__class__, REGISTER_BYTES)
        self._request, self._sent, self._unasked = parse_request(data, width), self._clock(), 0
        self._open[number] = (self._request, self._sent)
        self._tell(data, sent=True)
        transport.write(data)

    async def _answer_to_another(self, deadline: float) -> None:
        """Wait until something that is open is answered. Raises ReplyTimeout, or LinkDown where the connection ends."""
        broken = self._outcome = asyncio.get_running_loop().create_future()
        self._request, before = None, len(self._open)
        self._any_answer.clear()
        waiting = asyncio.ensure_future(self._any_answer.wait())
        try:
            await asyncio.wait({waiting, broken}, timeout=deadline, return_when=asyncio.FIRST_COMPLETED)
            if broken.done():
                broken.result()  # raises: without a request of ours there is no other outcome
            if len(self._open) >= before:
                question, sent = next(iter(self._open.values()))
                raise ReplyTimeout(
                    f"{question}: no reply since {self._clock() - sent:.2f} s; nothing else is asked before it comes"
                )
        finally:
            self._outcome = None
            waiting.cancel()

    # ------------------------------------------------------------ called by pymodbus

    def _take(self, data: bytes, addr: tuple[Any, ...] | None = None) -> int:
        """Take in what has come, all of it; of the frames in it only the one that was waited for counts."""
        self._tell(data, sent=False)
        self._unasked += len(data)
        try:
            self._stream.take(data, self._open)
        except ReplyMismatch as error:
            self._break(str(error), LinkFault.FOREIGN)
            return len(data)
        if self._unasked > FLOOD:
            self._break("the peer floods the line with frames that nobody asked for")
        return len(data)

    def _tell(self, data: bytes, *, sent: bool) -> None:
        """Let the evidence know, where somebody gathers it."""
        transport = self._client.ctx.transport
        if self._tap is not None and isinstance(transport, asyncio.Transport):
            ends = [socket_place(transport.get_extra_info(name)) for name in ("peername", "sockname")]
            self._tap(make_frame("tcp", ends[0], data, sent=sent, local=ends[1]))

    def _take_frame(self, frame: bytes) -> None:
        """End the exchange with the frame if it answers the request, or with what is wrong in it."""
        request, outcome = self._request, self._outcome
        number = int.from_bytes(frame[:2], "big")
        while number in self._open and (oldest := next(iter(self._open))) != number:
            del self._open[oldest]  # what was asked before it and is silent keeps nothing else from being asked
        question, sent = self._open.pop(number, (None, 0.0))
        if question is not None:
            self._ids.note_reply(number)
        self._any_answer.set()
        # An earlier attempt at this very question is answered as well; the same asked by an earlier reading is not.
        if (
            request is None
            or outcome is None
            or outcome.done()
            or question is None
            or number not in self._attempts
            or replace(question, transaction=request.transaction) != request
        ):
            self._late = self._clock() - sent if question is not None else self._late
            self.foreign += 1
            return
        self._received, self._request = self._clock(), None
        # Whose answer it is its transaction id has shown.
        frame = as_asked(request, frame, self._answers_as)
        try:
            check_reply(request, frame)
        except (ReplyMismatch, DeviceException) as error:
            if self._timer is not None and leaves_open(request, frame):
                self._request, self._open[number] = request, (question, sent)
                loop = asyncio.get_running_loop()
                loop.call_later(rest_of_wait(loop.time(), self._timer.when()), self._give_up, number, outcome, error)
                return
            self._fail(error)
            return
        self._sent, self._unasked = sent, 0
        outcome.set_result(WireReply(unpack_words(request, frame[9:]), sent, self._received))

    def _give_up(self, number: int, outcome: "asyncio.Future[WireReply]", error: DriverError) -> None:
        """What came was not the answer, and nothing else has come."""
        if outcome is self._outcome and not outcome.done():
            self._open.pop(number, None)
            self._request = None
            self._fail(error)

    def _on_disconnect(self, exc: Exception | None) -> None:
        where = " in the middle of a reply" if self._stream.remainder else ""
        reason, self.fault = f"the peer closed the connection{where}", LinkFault.CLOSED
        if self._secured is not None and isinstance(exc, ssl.SSLError):
            reason, self.fault = self._secured.sentence(exc), LinkFault.OTHER
        elif self._secured is not None and not self._received and not where:
            # In TLS 1.3 the client's handshake is over before the server has looked at its certificate (RFC 8446, 2):
            # a refusal shows only as an end after it.
            reason = "the peer closed the connection after the TLS handshake: it may not accept our certificate"
            self.fault = LinkFault.OTHER
        self._fail(LinkDown(reason, fault=self.fault))
        self._on_lost(reason)

    def _break_cut(self, reason: str) -> None:
        self._break(reason, LinkFault.CUT)

    def _break(self, reason: str, fault: LinkFault = LinkFault.OTHER) -> None:
        self.abandon()
        self.fault = fault
        self._fail(LinkDown(reason, fault=fault))
        self._on_lost(reason)

    def _fail(self, error: DriverError) -> None:
        if self._outcome is not None and not self._outcome.done():
            self._outcome.set_exception(error)


def rest_of_wait(now: float, until: float) -> float:
    """Seconds that a question waits on behind a frame that leaves its answer open: over before its deadline is."""
    return max(0.0, min(MAX_REST_S, (until - now) / 2))


def keep_alive(transport: asyncio.Transport) -> None:
    """Let the system find out whether the host is there at all: one that is gone is not waited for.

    So a program that stands still (its host answers the probes) and a host that has gone are told apart, and a
    connection to the former can be kept (socket(7), tcp(7)).
    """
    raw = transport.get_extra_info("socket")
    if raw is not None:
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option in (socket.TCP_KEEPIDLE, socket.TCP_KEEPINTVL):
            raw.setsockopt(socket.IPPROTO_TCP, option, _PROBE_S)
        raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, _PROBES)


def read_little(transport: asyncio.Transport) -> None:
    """Have asyncio's socket read _READ_BYTES at once; another loop's transport, or that of TLS, is left as it is."""
    if isinstance(getattr(transport, "max_size", None), int):
        transport.max_size = _READ_BYTES  # type: ignore[attr-defined]


def discard(transport: asyncio.Transport, unanswered: Iterable[Asked]) -> None:
    """Close at once. A write must not be delivered late: the send buffer is thrown away with it.

    A read may: it ends with FIN, which a small PLC that wakes survives.
    """
    raw = transport.get_extra_info("socket")
    if raw is not None and any(question.function in WRITES for question in unanswered):
        # On, with no time to linger: closing throws the send buffer away and resets the connection (socket(7)).
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    transport.abort()


def no_connection(place: str, error: Exception, secured: Secured | None) -> LinkDown:
    """A failed attempt to connect, with the system's own reason."""
    reason = secured.sentence(error) if secured else system_reason(error)
    return LinkDown(f"{place} does not connect: {reason}", fault=_connect_fault(error))


def system_reason(error: Exception) -> str:
    """The system's word for a failure; of asyncio's "Connect call failed (address)" what its number means."""
    said = (error.strerror if isinstance(error, OSError) else None) or str(error)
    if isinstance(error, OSError) and error.errno and said.startswith("Connect call failed"):
        return os.strerror(error.errno)
    return said


def socket_place(name: tuple[str, int] | None) -> str:
    """A socket's name as `host:port`."""
    return f"{name[0]}:{name[1]}" if name else ""


_FAULTS = {
    errno.ECONNREFUSED: LinkFault.REFUSED,
    errno.EHOSTUNREACH: LinkFault.UNREACHABLE,
    errno.ENETUNREACH: LinkFault.UNREACHABLE,
}
_ERRNO = re.compile(r"\[Errno (-?\d+)\]")


def _connect_fault(error: Exception) -> LinkFault:
    """Why a connection was not made. A refusal by one of a host's addresses counts before anything else."""
    numbers = [error.errno] if isinstance(error, OSError) and error.errno is not None else []
    if not numbers:
        # Where a name has several addresses, asyncio of Python 3.11 keeps their errors only as the text of one OSError
        # without a number ("Multiple exceptions: ..."); from 3.12 on create_connection(all_errors=True) gives them.
        numbers = [int(number) for number in _ERRNO.findall(str(error))]
    faults = [_FAULTS[number] for number in numbers if number in _FAULTS]
    return LinkFault.REFUSED if LinkFault.REFUSED in faults else faults[0] if faults else LinkFault.OTHER
