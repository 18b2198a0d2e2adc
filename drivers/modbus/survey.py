"""A Modbus device asked by hand, over its driver's own connection and by its rules (see `drivers.survey`).

Tags are read as the gateway reads them. A single question is sent once, and fails as it fails; the first one to a
device is waited for, and asked again, over FIRST_ANSWER_S.
"""

import asyncio
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from typing import Any

from pymodbus.pdu import ModbusPDU

from drivers.connections import Connections
from drivers.driver import Clock
from drivers.errors import NO_WAY_TO_UNIT, AddressError, DeviceException, DriverError, LinkDown, ReplyTimeout
from drivers.modbus.address import Area, locate
from drivers.modbus.driver import ModbusDriver, make_modbus
from drivers.modbus.identity import (
    MOST_PARTS,
    OBJECTS,
    identification,
    object_request,
    server_id_request,
    take_part,
    text_of_server_id,
)
from drivers.modbus.settings import ModbusSettings, read_settings
from drivers.modbus.wire import WireReply, read_request
from drivers.survey import Raw, ReadWords
from drivers.tag import Quality, Tag

FIRST_ANSWER_S = 3.0
"""Seconds for which the first question to a device is asked and waited for."""
SEARCH_S = 20.0
"""Seconds for which places are looked for that a device refuses by silence."""
_SILENT = frozenset({Quality.TIMEOUT, Quality.NOT_CONNECTED, Quality.NO_COMMUNICATION})
LINE_PAUSES_S = (0.1, 0.3)
"""After a gateway has said that its unit gave no answer (exceptions 10, 11), until it is asked again."""
_REGULAR_OBJECT_ID = 3
"""The first object of the regular category of an identification."""


@asynccontextmanager
async def open_survey(settings: Mapping[str, Any], *, clock: Clock) -> AsyncIterator["ModbusSurvey"]:
    """A connection by the Modbus driver's settings. Raises DriverError; LinkDown if it is not made."""
    survey = ModbusSurvey(read_settings(settings), clock)
    try:
        await survey.open()
        yield survey
    finally:
        await survey.close()


class ModbusSurvey:
    """A driver and who asks by hand over it. Made by `open_survey`."""

    def __init__(self, settings: ModbusSettings, clock: Clock) -> None:
        self._settings = settings
        # A person looks on: a connection is not given up while the first question is asked.
        patient = {"max_failures": 100, "max_silence": max(settings.max_silence, 2 * FIRST_ANSWER_S)}
        self.driver: ModbusDriver = make_modbus(
            settings.model_copy(update=patient), clock=clock, connections=Connections()
        )
        self._answered = self._tried = False
        self._slowest = 0.0
        self.seconds_to_first = 0.0

    async def open(self) -> None:
        """Make the connection. Raises LinkDown with the reason; why one has ended the first question tells."""
        try:
            await self.driver.open()
        except LinkDown:
            if not self.driver.statistics()["connects"]:
                raise

    async def close(self) -> None:
        """Let the connection go."""
        await self.driver.close()

    def statistics(self) -> Mapping[str, float]:
        """The driver's counters; `seconds_to_first`: from the first question to its answer."""
        return {**self.driver.statistics(), "seconds_to_first": self.seconds_to_first}

    def cautions(self) -> tuple[str, ...]:
        """What works and should not stay as it is."""
        return self.driver.cautions()

    # ------------------------------------------------------------ asking

    async def read(self, area: str, start: int, count: int, unit: int | None = None) -> ReadWords:
        """One request for `count` registers or bits. Raises DriverError by its kinds."""
        own = unit is None or unit == self._settings.unit
        # Where a block reaches over a border its first register decides, and what is not so answered is a refusal.
        wide = own and any(wide.meets(Area(area), start, start + 1) for wide in self._settings.wide_registers)
        request = read_request(Area(area), start, count, self._unit(unit), wide=wide)
        # Who names a unit asks which ones are there: a gateway's word that it is not is the answer.
        reply = await self._exchange(request, LINE_PAUSES_S if unit is None else ())
        return ReadWords(reply.words, reply.received - reply.sent)

    async def identity(self, unit: int | None = None) -> Mapping[str, str]:
        """What the device says of itself; raises DeviceException where it says nothing (many do not).

        Beside the basic objects of an identification those of the regular category, where it has them.
        """
        said = await self._objects(0, unit)
        if any(said.values()):
            regular = dict[str, str]()
            with suppress(DriverError):
                regular = await self._objects(_REGULAR_OBJECT_ID, unit)
            # Some give their own objects with them, such as how long they have been on: another one each time.
            take_part(said, {name: text for name, text in regular.items() if text and name in OBJECTS})
        return said

    async def _objects(self, wanted: int, unit: int | None) -> dict[str, str]:
        identity: dict[str, str] = {}
        after = 0
        for _ in range(MOST_PARTS):
            part, after = identification((await self._exchange(object_request(self._unit(unit), after, wanted))).words)
            take_part(identity, part)
            if not after:
                break
        return identity

    async def server_id(self, unit: int | None = None) -> str:
        """What the device answers to function 17; raises DeviceException where it has none."""
        return text_of_server_id((await self._exchange(server_id_request(self._unit(unit)))).words)

    async def stranger(self) -> str:
        """Why the device is not the one that is pinned; "" if it is, or none is. Raises DriverError."""
        return (await self.driver.who(self._settings.identity))[0] if self._settings.identity else ""

    async def tags(self, tags: Sequence[Tag]) -> list[Raw]:
        """Each tag with its raw words, as the driver reads them; a failure is a sample of bad quality.

        A device of which nothing at all comes is asked one question with all patience, and read once more if that is
        answered; one of which only a part comes, since its first answer was late, is read once more.
        """
        samples = await self.driver.read(tags)
        silent = 0 if self._tried else sum(sample.quality in _SILENT for sample in samples)
        if 0 < silent < len(samples):
            samples = await self.driver.read(tags)
        elif silent:
            pauses = list(LINE_PAUSES_S)
            if any(sample.quality is Quality.NO_COMMUNICATION for sample in samples):
                await asyncio.sleep(pauses.pop(0))  # a gateway has said it: this reading was the first question
            with suppress(DriverError, AddressError):
                span = locate(tags[0], self._settings.wide_registers)
                request = read_request(span.area, span.start, span.count, self._unit(None), wide=span.wide is not None)
                await self._exchange(request, pauses)
            if self._answered:
                samples = await self.driver.read(tags)
        until, searching = _now() + SEARCH_S, self.driver.is_searching
        while searching and _now() < until:
            searching = self.driver.is_searching
            samples = await self.driver.read(tags)  # once more after its end, for all that is not refused
        self._tried = self._tried or any(sample.sent is not None for sample in samples)
        return [self.driver.raw(tag, sample) for tag, sample in zip(tags, samples, strict=True)]

    def _unit(self, unit: int | None) -> int:
        return self._settings.unit if unit is None else unit

    async def _exchange(self, request: ModbusPDU, line_pauses: Sequence[float] = LINE_PAUSES_S) -> WireReply:
        """One question. The first one is asked again with a growing deadline: the device may be slow, or answer nothing
        for a while after a connection was made; a gateway's word that it is silent is not believed before it has been
        asked again after these pauses."""
        if self._answered or self._tried:
            return await self._once(request, self._deadline, again=False)
        self._tried, began = True, _now()
        deadline, again = self._deadline, False
        pauses = list(line_pauses)
        while True:
            try:
                return await self._once(request, deadline, again=again)
            except DeviceException as error:
                if error.code not in NO_WAY_TO_UNIT or not pauses:
                    raise
                again = False
                await asyncio.sleep(pauses.pop(0))
                began = _now()
            except ReplyTimeout:
                again, deadline = True, min(2 * deadline, began + FIRST_ANSWER_S - _now())
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
        try:
            reply = await self.driver.by_hand(request, deadline, again=again)
        except DeviceException as error:
            # What a gateway says in its place the device has not answered.
            self._answered |= error.code not in NO_WAY_TO_UNIT
            raise
        self._answered, self._slowest = True, max(self._slowest, reply.received - reply.sent)
        if self._deadline > self._settings.timeout:
            self.driver.allow(self._deadline)
        return reply


def _now() -> float:
    return asyncio.get_running_loop().time()
