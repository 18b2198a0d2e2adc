"""A Modbus device asked by hand: each request sent once, each failure raised as it is (see `drivers.survey`)."""

import asyncio
import random
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from typing import Any

from pymodbus.pdu import ModbusPDU
from pymodbus.pdu.mei_message import ReadDeviceInformationRequest

from drivers.codec import decode
from drivers.driver import Clock
from drivers.errors import AddressError, DeviceException, DriverError, LinkDown, LinkFault, ReplyMismatch, ReplyTimeout
from drivers.modbus.address import Area, TagSpan, locate
from drivers.modbus.plan import AddressBlock, fitting, halves, plan_spans
from drivers.modbus.replies import TransactionIds
from drivers.modbus.settings import ModbusSettings, read_settings
from drivers.modbus.transport import AnyWire, explained, make_transport
from drivers.modbus.verify import quality_of
from drivers.modbus.wire import WireReply, read_request
from drivers.survey import Raw, ReadWords
from drivers.tag import Quality, Sample, Tag

_ABOUT_ADDRESSES = frozenset({1, 2, 3, 4})
_OBJECTS = ("vendor", "product code", "revision", "vendor URL", "product", "model", "application")
"""V1.1b3, 6.21: the objects 0 to 6 of an identification."""
_MOST_PARTS = 16
FIRST_S = 3.0
"""Seconds for which the first question to a device is asked and waited for."""
_MOST_OPEN = 8
"""Questions without an answer on a connection: somebody looks on, and ends it soon."""


@asynccontextmanager
async def open_survey(settings: Mapping[str, Any], *, clock: Clock) -> AsyncIterator["ModbusSurvey"]:
    """A connection by the Modbus driver's settings. Raises DriverError; LinkDown if it is not made."""
    survey = ModbusSurvey(read_settings(settings), clock)
    try:
        await survey.connect()
        yield survey
    finally:
        survey.close()


class ModbusSurvey:
    """One connection, made anew when the device has closed it. Made by `open_survey`."""

    def __init__(self, settings: ModbusSettings, clock: Clock) -> None:
        self._settings, self._clock = settings, clock
        self._transport = make_transport(settings, clock, TransactionIds(random.SystemRandom()))
        self._limits = settings.limits
        self._wire: AnyWire | None = None
        self._lost, self._fault = "", LinkFault.OTHER
        self._answered = self._tried = False
        self._slowest = 0.0
        self.seconds_to_first = 0.0
        self._last_exchange = float("-inf")
        self._foreign = 0
        self._counts = dict.fromkeys(("requests", "timeouts", "mismatches", "exceptions", "connects"), 0)

    async def connect(self) -> None:
        """Make the connection. Raises LinkDown with the reason."""
        wire = self._transport.wire(self._on_lost)
        deadline = self._settings.connect_timeout
        try:
            async with asyncio.timeout(deadline):
                await wire.connect()
        except TimeoutError:
            reason = f"no connection within {deadline:g} s: nobody answers there at all"
            raise LinkDown(reason, fault=LinkFault.SILENT) from None
        self._wire, self._lost = wire, ""
        self._counts["connects"] += 1
        await asyncio.sleep(self._settings.pause_after_connect)

    def close(self) -> None:
        """Let the connection go."""
        wire, self._wire = self._wire, None
        if wire is not None:
            self._foreign += wire.foreign
            wire.abandon()

    def statistics(self) -> Mapping[str, float]:
        """Counters by the names of the driver's; `seconds_to_first`: from the first question to its answer."""
        return {
            **self._counts,
            "seconds_to_first": self.seconds_to_first,
            "foreign_replies": self._foreign + (self._wire.foreign if self._wire else 0),
        }

    def cautions(self) -> tuple[str, ...]:
        """What works and should not stay as it is."""
        return self._transport.cautions()

    # ------------------------------------------------------------ asking

    async def read(self, area: str, start: int, count: int, unit: int | None = None) -> ReadWords:
        """One request for `count` registers or bits. Raises DriverError by its kinds."""
        reply = await self._exchange(read_request(Area(area), start, count, self._unit(unit)))
        return ReadWords(reply.words, reply.received - reply.sent)

    async def identity(self, unit: int | None = None) -> Mapping[str, str]:
        """What the device says of itself; raises DeviceException where it says nothing (many do not)."""
        identity: dict[str, str] = {}
        after = 0
        for _ in range(_MOST_PARTS):
            request = ReadDeviceInformationRequest(read_code=1, object_id=after, dev_id=self._unit(unit))
            await self._exchange(request)
            part, after = _identification(self._wire.last if self._wire is not None else b"")
            identity |= part
            if not after:
                break
        return identity

    async def tags(self, tags: Sequence[Tag]) -> list[Raw]:
        """Each tag with its raw words, by the fewest requests; a refused block is asked again tag by tag."""
        spans: dict[int, TagSpan] = {}
        raws: dict[int, Raw] = {}
        for tag in tags:
            try:
                spans[id(tag)] = fitting(locate(tag), self._limits)
            except AddressError as error:
                raws[id(tag)] = self._failed(tag, tag.address, 0, Quality.CONFIGURATION_ERROR, str(error))
        for block in plan_spans(spans.values(), self._limits):
            raws |= await self._block(block)
        return [raws[id(tag)] for tag in tags]

    async def _block(self, block: AddressBlock, *, alive: bool = False) -> dict[int, Raw]:
        """Its readings; where the device is silent, and `alive` elsewhere, those of its parts."""
        try:
            reply = await self._patiently(block, attempts=1 if alive else self._settings.attempts)
        except DeviceException as error:
            if error.code in _ABOUT_ADDRESSES and len(block.spans) > 1:
                parts: dict[int, Raw] = {}
                for span in block.spans:
                    parts |= await self._block(AddressBlock(span.area, span.start, span.count, (span,)))
                return parts
            return self._block_failed(block, quality_of(error.code), str(error))
        except DriverError as error:
            cut = halves(block) if isinstance(error, ReplyTimeout) else None
            if cut is not None and (alive or await self._answers_at_an_end(block)):
                return await self._block(cut[0], alive=True) | await self._block(cut[1], alive=True)
            quality = Quality.TIMEOUT if isinstance(error, ReplyTimeout) else Quality.COMMUNICATION_ERROR
            quality = Quality.NOT_CONNECTED if isinstance(error, LinkDown) else quality
            return self._block_failed(block, quality, str(error))
        raws: dict[int, Raw] = {}
        for span in block.spans:
            first = span.start - block.start
            words = reply.words[first : first + span.count]
            value, quality, reason = decode(span.tag, words)
            sample = Sample(span.tag.name, value, quality, reply.received, sent=reply.sent, reason=reason)
            raws[id(span.tag)] = Raw(span.tag, sample, f"{span.area}:{span.start}", span.count, tuple(words))
        return raws

    async def _answers_at_an_end(self, block: AddressBlock) -> bool:
        """Whether a device that is silent to a block answers its first or its last tag."""
        for span in (block.spans[0], block.spans[-1]):
            try:
                await self._exchange(read_request(span.area, span.start, span.count, self._unit(None)))
            except DeviceException:
                return True
            except DriverError:
                continue
            return True
        return False

    async def _patiently(self, block: AddressBlock, attempts: int) -> WireReply:
        """As often as the settings allow, as the driver would: a late reply to the same question answers it."""
        request = (block.area, block.start, block.count, self._unit(None))
        for attempt in range(attempts - 1):
            try:
                return await self._exchange(read_request(*request), again=attempt > 0)
            except (ReplyTimeout, ReplyMismatch):
                continue
        return await self._exchange(read_request(*request), again=attempts > 1)

    def _block_failed(self, block: AddressBlock, quality: Quality, reason: str) -> dict[int, Raw]:
        return {
            id(span.tag): self._failed(span.tag, f"{span.area}:{span.start}", span.count, quality, reason)
            for span in block.spans
        }

    def _failed(self, tag: Tag, place: str, count: int, quality: Quality, reason: str) -> Raw:
        return Raw(tag, Sample(tag.name, None, quality, self._clock(), reason=reason), place, count)

    def _unit(self, unit: int | None) -> int:
        return self._settings.unit if unit is None else unit

    async def _exchange(self, request: ModbusPDU, *, again: bool = False) -> WireReply:
        """One request; a connection that the device has closed after an answer is made anew before.

        The first question is waited for, and asked again, over FIRST_S: the device may be slow, or answer nothing for a
        while after a connection was made.
        """
        deadline = self._deadline
        if self._answered or self._tried:
            return await self._once(request, deadline, again=again)
        self._tried, began = True, _now()
        while True:
            try:
                return await self._once(request, deadline, again=again)
            except ReplyTimeout:
                again, deadline = True, min(2 * deadline, began + FIRST_S - _now())
                if deadline < self._settings.timeout:
                    raise
            finally:
                # What the answer has taken, if there is one: that of a refusal too.
                self.seconds_to_first = self._slowest = _now() - began

    @property
    def _deadline(self) -> float:
        """Seconds that an answer has: what is set, else no less than the slowest answer has taken."""
        timeout = self._settings.timeout
        return timeout if "timeout" in self._settings.model_fields_set else max(timeout, 3 * self._slowest + 0.1)

    async def _once(self, request: ModbusPDU, deadline: float, *, again: bool) -> WireReply:
        if (rest := self._last_exchange + self._settings.pause_ms / 1000 - _now()) > 0.0:
            await asyncio.sleep(rest)
        if self._wire is None:
            if not self._answered:
                raise self._turned_away()
            await self.connect()
        wire = self._wire
        if wire is None:
            raise LinkDown(self._lost)
        self._counts["requests"] += 1
        try:
            reply = await wire.ask(request, deadline, again=again, most_open=_MOST_OPEN)
        except DeviceException as error:
            self._answered = True
            self._counts["exceptions"] += 1
            raise explained(error, wire) from None
        except (ReplyTimeout, ReplyMismatch) as error:
            self._counts["timeouts" if isinstance(error, ReplyTimeout) else "mismatches"] += 1
            raise
        except LinkDown as error:
            self.close()
            self._lost, self._fault = str(error), error.fault
            raise self._turned_away() if not self._answered else LinkDown(self._lost, fault=self._fault) from None
        finally:
            self._last_exchange = _now()
        self._answered, self._slowest = True, max(self._slowest, reply.received - reply.sent)
        return reply

    def _turned_away(self) -> LinkDown:
        """The connection was made and ended before any answer: what that means."""
        if self._fault is LinkFault.CLOSED:
            return LinkDown(
                f"{self._lost} before it answered anything: it may be busy with another client (some devices serve "
                "one at a time), or it does not accept this machine's address",
                fault=self._fault,
            )
        return LinkDown(self._lost, fault=self._fault)

    def _on_lost(self, reason: str) -> None:
        wire, self._wire, self._lost = self._wire, None, reason
        if wire is not None:
            self._fault = wire.fault
            self._foreign += wire.foreign


def _now() -> float:
    return asyncio.get_running_loop().time()


def _identification(reply: bytes) -> tuple[dict[str, str], int]:
    """The objects in a reply, and the number of the one that follows in another (0: none).

    It is unit, function, MEI type, code, conformity, more, next, count, objects. What is cut short is left out.
    """
    if len(reply) < 8:
        return {}, 0
    more, following, count, at = reply[5], reply[6], reply[7], 8
    identity: dict[str, str] = {}
    for _ in range(count):
        if at + 2 > len(reply):
            break
        number, length = reply[at], reply[at + 1]
        name = _OBJECTS[number] if number < len(_OBJECTS) else f"object {number}"
        identity[name] = reply[at + 2 : at + 2 + length].decode("latin-1").strip("\0 ")
        at += 2 + length
    return identity, following if more == 0xFF else 0
