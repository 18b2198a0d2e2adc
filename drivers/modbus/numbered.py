"""One TCP or TLS connection that carries several requests at once, each known by its transaction id.

pymodbus asks one thing at a time over a client, and a unit that is silent behind a gateway would hold up all others.
So the bytes are moved here, by asyncio; pymodbus still makes the requests' bytes, and each reply is checked against
its request as on every other connection (`drivers.modbus.verify`).
"""

import asyncio
import ssl
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace

from pymodbus.pdu import ModbusPDU

from drivers.driver import BeforeSending, Clock, anyhow
from drivers.errors import (
    NO_WAY_TO_UNIT,
    DeviceException,
    DriverError,
    LinkDown,
    LinkFault,
    ReplyMismatch,
    ReplyTimeout,
)
from drivers.modbus.replies import ID_REUSE_DELAY_S, ReplyStream, TransactionIds
from drivers.modbus.verify import (
    REGISTER_BYTES,
    Asked,
    as_asked,
    check_reply,
    leaves_open,
    parse_request,
    unpack_words,
)
from drivers.modbus.wire import (
    ANY_ID,
    FLOOD,
    LATE,
    NOT_BEHIND_A_PART,
    OTHER_ID,
    WIDTHS,
    Secured,
    WireReply,
    discard,
    keep_alive,
    no_connection,
    read_little,
    rest_of_wait,
    socket_place,
)
from drivers.tap import current, make_frame


@dataclass(slots=True)
class _Question:
    """One request on the connection; `reply` is what waits for its answer, None once nobody does.

    `at` and `until` are the loop's times of sending and of the deadline, `sent` is the clock's of sending. What is
    asked again has the same `reading`: an answer to an earlier attempt is its answer too.
    """

    asked: Asked
    sent: float
    at: float
    reading: int
    reply: "asyncio.Future[WireReply] | None"
    until: float


class NumberedWire(asyncio.Protocol):
    """A connection, from `connect` to `abandon`.

    `on_lost` hears why it broke, `on_late` of which unit a reply came when nobody waited for it any more, and whether
    the unit gave it itself. With `answers_as` what that unit says is the answer of the one that was asked.
    """

    def __init__(
        self,
        host: str,
        port: int,
        *,
        ids: TransactionIds,
        clock: Clock,
        on_lost: Callable[[str], None],
        on_late: Callable[[int, bool], None],
        secured: Secured | None = None,
        answers_as: int | None = None,
    ) -> None:
        self._host, self._port, self._secured = host, port, secured
        self._answers_as = answers_as
        self._ids = ids
        self._clock, self._on_lost, self._on_late = clock, on_lost, on_late
        self._transport: asyncio.Transport | None = None
        self._questions: dict[int, _Question] = {}
        # By unit, the id under which what it was asked last was asked first.
        self._readings: dict[int, int] = {}
        self._stream = ReplyStream(ids, self._take, self._break_cut)
        self._unasked = 0
        # Questions by unit since anything was answered.
        self._since_answer: Counter[int] = Counter()
        self._any_answer = asyncio.Event()
        self._answered = False
        # How late (s) something came last that had been given up, by unit.
        self._late: dict[int, float] = {}
        self.foreign = 0
        self.fault = LinkFault.OTHER
        self.refusal_hint = secured.refusal_hint if secured else ""
        self._tap = current()

    async def connect(self) -> None:
        """Connect; the caller sets the deadline by cancelling. Raises LinkDown with the system's own reason."""
        secured = self._secured
        context, name = (secured.context, secured.name) if secured else (None, None)
        loop = asyncio.get_running_loop()
        try:
            await loop.create_connection(lambda: self, self._host, self._port, ssl=context, server_hostname=name)
        except (OSError, ValueError) as error:  # ValueError: a host name that DNS or TLS cannot even be asked for
            raise no_connection(f"{self._host}:{self._port}", error, secured) from error
        if self._transport is not None:
            keep_alive(self._transport)
            read_little(self._transport)

    @property
    def alive(self) -> bool:
        """False once the connection is gone. True says nothing about the peer."""
        return self._transport is not None

    def abandon(self) -> None:
        """Close at once. What an unanswered request left in the send buffer is discarded, not delivered late."""
        self._stream.close()
        transport, self._transport = self._transport, None
        if transport is not None:
            discard(transport, [question.asked for question in self._questions.values()])
        self._fail(LinkDown("the connection is closed"))

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

        `again`: it is the very request that this unit was asked last and did not answer; a late reply to that one is
        its answer. Any other waits while nothing at all has been answered since `most_open` questions to this unit: a
        peer that stands still shall not collect them, and a silent unit keeps no other from being asked. A connection
        ends on which a part of a reply has come that nobody waits for, or for which the deadline is over.

        Raises ReplyTimeout, ReplyMismatch, DeviceException, or LinkDown if the connection breaks or cannot be
        understood any more (then `alive` is False).
        """
        transport = self._live()
        loop = asyncio.get_running_loop()
        if not again:
            self._readings.pop(request.dev_id, None)
        if self._since_answer[request.dev_id] >= most_open and not again:
            began = loop.time()
            await self._any_reply(deadline)
            deadline -= loop.time() - began
            transport = self._live()
        if (part := self._stream.remainder) and not self._has_waiter(part):
            self._break_cut(reason := NOT_BEHIND_A_PART.format(len(part)))
            raise LinkDown(reason, fault=LinkFault.CUT)
        before_sending()
        now = loop.time()
        while self._questions and (oldest := next(iter(self._questions.items())))[1].at < now - ID_REUSE_DELAY_S:
            del self._questions[oldest[0]]
        number = self._ids.take(now)
        pdu = bytes((request.dev_id, request.function_code)) + request.encode()
        frame = number.to_bytes(2, "big") + b"\0\0" + len(pdu).to_bytes(2, "big") + pdu
        reply: asyncio.Future[WireReply] = loop.create_future()
        foreign = self.foreign
        self._late.pop(request.dev_id, None)
        reading = self._readings.setdefault(request.dev_id, number)
        width = WIDTHS.get(request.__class__, REGISTER_BYTES)
        question = _Question(parse_request(frame, width), self._clock(), now, reading, reply, now + deadline)
        self._questions[number] = question
        self._unasked = 0
        self._since_answer[request.dev_id] += 1
        transport.write(frame)
        self._tell(frame, sent=True)

        def too_late() -> None:
            if reply.done():
                return
            others, part = self.foreign - foreign, self._stream.remainder
            late = self._late.get(question.asked.unit)
            why = LATE.format(late) if late else OTHER_ID.format(others) if others else ""
            if part[:2] != frame[:2] and self._has_waiter(part):
                part = b""
            remedy = ANY_ID if others and not late and not part else None
            why = f" ({len(part)} bytes of one came)" if part else why
            sentence = f"{question.asked}: no reply within {deadline:.3g} s{why}"
            reply.set_exception(ReplyTimeout(sentence, remedy=remedy))
            if part:
                self._break_cut(sentence)  # bytes of the next reply would make it whole

        timer = loop.call_later(deadline, too_late)
        try:
            return await reply
        finally:
            timer.cancel()
            question.reply = None  # and the question stays: its id is not used again, and its late reply is known

    def _live(self) -> asyncio.Transport:
        if self._transport is None:
            raise LinkDown("the connection is closed")
        return self._transport

    def _has_waiter(self, part: bytes) -> bool:
        """Whether it is of a reply that somebody waits for."""
        question = self._questions.get(int.from_bytes(part[:2], "big")) if len(part) > 1 else None
        return question is not None and question.reply is not None and not question.reply.done()

    async def _any_reply(self, deadline: float) -> None:
        """Wait until something is answered. Raises ReplyTimeout, or LinkDown where the connection ends."""
        self._any_answer.clear()
        try:
            async with asyncio.timeout(deadline):
                await self._any_answer.wait()
        except TimeoutError:
            raise ReplyTimeout(
                f"{self._since_answer.total()} questions have no reply yet; nothing else is asked before one comes"
            ) from None

    # ------------------------------------------------------------ called by asyncio

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        if isinstance(transport, asyncio.Transport):
            self._transport = transport

    def data_received(self, data: bytes) -> None:
        self._tell(data, sent=False)
        try:
            self._stream.take(data, self._questions)
        except ReplyMismatch as error:
            self._break(str(error), LinkFault.FOREIGN)
            return
        if self._unasked > FLOOD:
            self._break("the peer floods the line with frames that nobody asked for")

    def connection_lost(self, exc: Exception | None) -> None:
        if self._transport is None:
            return
        where = " in the middle of a reply" if self._stream.remainder else ""
        reason, fault = f"the peer closed the connection{where}", LinkFault.CLOSED
        if self._secured is not None and isinstance(exc, ssl.SSLError):
            reason, fault = self._secured.sentence(exc), LinkFault.OTHER
        elif self._secured is not None and not self._answered and not where:
            # As in `drivers.modbus.wire`: in TLS 1.3 a refused certificate shows only as an end after the handshake.
            reason = "the peer closed the connection after the TLS handshake: it may not accept our certificate"
            fault = LinkFault.OTHER
        self._break(reason, fault)

    # ------------------------------------------------------------ replies

    def _take(self, frame: bytes) -> None:
        """One whole frame: the answer to who waits for it, or counted as nobody's."""
        number = int.from_bytes(frame[:2], "big")
        question = self._questions.pop(number, None)
        if question is not None:
            frame = as_asked(question.asked, frame, self._answers_as)
            self._ids.note_reply(number)
            self._since_answer.clear()
            self._any_answer.set()
        waiting = question
        if question is not None and question.reply is None:
            self._late[question.asked.unit] = self._clock() - question.sent
            # Late. Who has asked the same unit the same thing again takes it, and no one else: no later reading.
            same = replace(question.asked, transaction=0)
            waiting = next(
                (
                    other
                    for other in self._questions.values()
                    if other.reading == question.reading
                    and other.reply is not None
                    and replace(other.asked, transaction=0) == same
                ),
                None,
            )
            if frame[6] == question.asked.unit:
                self._on_late(question.asked.unit, not (frame[7] & 0x80 and frame[8] in NO_WAY_TO_UNIT))
        if question is None or waiting is None or waiting.reply is None or waiting.reply.done():
            self.foreign += 1
            self._unasked += len(frame)
            return
        received, self._unasked, self._answered = self._clock(), 0, True
        try:
            check_reply(question.asked, frame)
        except (ReplyMismatch, DeviceException) as error:
            if leaves_open(question.asked, frame):
                self._questions[number] = question
                # To an earlier attempt it says nothing of the one that waits.
                if waiting is question:
                    loop = asyncio.get_running_loop()
                    loop.call_later(rest_of_wait(loop.time(), question.until), self._give_up, number, error)
                return
            waiting.reply.set_exception(error)
            return
        waiting.reply.set_result(WireReply(unpack_words(question.asked, frame[9:]), question.sent, received))

    def _give_up(self, number: int, error: DriverError) -> None:
        """What came was not the answer, and nothing else has come."""
        question = self._questions.get(number)
        if question is not None and question.reply is not None and not question.reply.done():
            del self._questions[number]
            question.reply.set_exception(error)

    def _tell(self, data: bytes, *, sent: bool) -> None:
        """Let the evidence know, where somebody gathers it."""
        if self._tap is not None and self._transport is not None:
            ends = [socket_place(self._transport.get_extra_info(name)) for name in ("peername", "sockname")]
            self._tap(make_frame("tcp", ends[0], data, sent=sent, local=ends[1]))

    def _break_cut(self, reason: str) -> None:
        self._break(reason, LinkFault.CUT)

    def _break(self, reason: str, fault: LinkFault = LinkFault.OTHER) -> None:
        self.fault = fault
        self._fail(LinkDown(reason, fault=fault))
        self.abandon()
        self._on_lost(reason)

    def _fail(self, error: DriverError) -> None:
        """The connection ends for all who wait."""
        self._any_answer.set()
        for question in self._questions.values():
            if question.reply is not None and not question.reply.done():
                question.reply.set_exception(error)
