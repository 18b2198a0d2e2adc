"""What a survey asks by hand: one request each, the identity in parts, and its length on a serial line."""

import time
from asyncio import StreamWriter
from collections.abc import Awaitable, Callable

import pytest

from drivers.errors import DeviceException, LinkDown, ReplyMismatch, ReplyTimeout
from drivers.modbus import rtu
from drivers.modbus.verify import IDENTIFY, Asked, check_reply
from drivers.survey import AsksRegisters, open_registers
from drivers.tag import DType, Order, Quality, Tag
from drivers.tap import TapFrame, tap_frames
from tests.drivers.scripted import ScriptedPlc, mbap, transaction_of

HEAD = bytes((1, IDENTIFY, 14, 1, 1))


def identity(more: int, following: int, *objects: tuple[int, bytes]) -> bytes:
    """Unit and PDU of an identification."""
    body = b"".join(bytes((number, len(text))) + text for number, text in objects)
    return HEAD + bytes((more, following, len(objects))) + body


async def surveyed(plc: ScriptedPlc, act: Callable[[AsksRegisters], Awaitable[None]], **settings: object) -> None:
    await plc.start()
    try:
        where = {"host": "127.0.0.1", "port": plc.port, "timeout": 0.3, **settings}
        async with open_registers("modbus", where, clock=time.time) as survey:
            await act(survey)
    finally:
        await plc.stop()


class Talker(ScriptedPlc):
    """A device that says who it is, in two parts."""

    def answer(self, request: bytes) -> bytes:
        if request[7] != IDENTIFY:
            return super().answer(request)
        part = identity(0xFF, 1, (0, b"Maker")) if request[10] == 0 else identity(0, 0, (1, b"P-1"), (2, b"v3"))
        return mbap(transaction_of(request), 1, part[1:])


async def test_an_identity_in_two_parts_is_put_together() -> None:
    async def act(survey: AsksRegisters) -> None:
        said = await survey.identity()
        assert said == {"vendor": "Maker", "product code": "P-1", "revision": "v3"}

    await surveyed(Talker(), act)


async def test_each_request_is_sent_once_and_fails_as_it_fails() -> None:
    plc = ScriptedPlc(illegal={7})

    async def act(survey: AsksRegisters) -> None:
        assert (await survey.read("holding", 3, 2)).words == (3, 4)
        with pytest.raises(DeviceException, match="exception 2"):
            await survey.read("holding", 5, 4)
        with pytest.raises(ReplyTimeout):
            await survey.read("holding", 5, 1, 9)

    async def only_unit_1(plc: ScriptedPlc, request: bytes, honest: bytes, writer: StreamWriter) -> None:
        if request[6] == 1:
            writer.write(honest)

    plc.bend = only_unit_1
    await surveyed(plc, act)
    assert len(plc.requests) == 3


async def test_tags_come_with_their_words_and_a_refused_neighbour_costs_only_itself() -> None:
    plc = ScriptedPlc(registers={10: 0x4290, 11: 0xD70A, 12: 5, 13: 6}, illegal={13})
    tags = [
        Tag("t", "holding:10", DType.FLOAT32, Order.ABCD),
        Tag("n", "holding:12"),
        Tag("gone", "holding:13"),
        Tag("wrong", "here:1"),
    ]

    async def act(survey: AsksRegisters) -> None:
        t, n, gone, wrong = await survey.tags(tags)
        assert t.raw == (0x4290, 0xD70A) and t.sample.value == pytest.approx(72.42, abs=0.01)
        assert n.raw == (5,) and n.sample.quality is Quality.GOOD
        assert gone.raw is None and "illegal data address" in gone.sample.reason
        assert wrong.sample.quality is Quality.CONFIGURATION_ERROR

    await surveyed(plc, act)


async def test_a_tap_hears_what_is_sent_and_received_and_nothing_outside_its_context() -> None:
    plc, heard = ScriptedPlc(), list[TapFrame]()

    async def act(survey: AsksRegisters) -> None:
        await survey.read("holding", 1, 1)

    with tap_frames(heard.append):
        await surveyed(plc, act)
    await plc.start()
    await plc.stop()
    assert [frame.sent for frame in heard] == [True, False]
    assert heard[0].data == plc.requests[0] and heard[0].local == heard[1].local != heard[0].place
    await surveyed(plc, act)
    assert len(heard) == 2


async def test_a_host_without_a_server_is_no_connection() -> None:
    with pytest.raises(LinkDown, match="does not connect"):
        async with open_registers("modbus", {"host": "127.0.0.1", "port": 1}, clock=time.time):
            pass


def test_the_length_of_an_identification_on_a_serial_line_is_taken_from_its_objects() -> None:
    whole = identity(0, 0, (0, b"Maker"), (1, b"")) + b"\0\0"
    asked = Asked(0, 1, IDENTIFY, 0, 0)
    for cut in range(2, len(whole)):
        known = rtu.reply_length(asked, whole[:cut])
        assert known in (None, len(whole))
    assert rtu.reply_length(asked, whole) == len(whole)


def test_a_reply_without_an_identification_is_refused() -> None:
    with pytest.raises(ReplyMismatch, match="holds no identification"):
        check_reply(Asked(1, 1, IDENTIFY, 0, 0), bytes(6) + bytes((1, IDENTIFY, 13, 0, 0, 0, 0, 0)))
