"""The Modbus driver against a device whose every byte a test can bend."""

import asyncio
import random
import struct
import time
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import pytest

from drivers.driver import open_driver
from drivers.errors import (
    AddressError,
    DeviceException,
    DriverError,
    EncodingError,
    LinkDown,
    ReplyMismatch,
    ReplyTimeout,
    WriteForbidden,
    WriteUnverified,
)
from drivers.modbus.address import Area
from drivers.modbus.driver import open_modbus
from drivers.modbus.numbered import NumberedWire
from drivers.modbus.replies import TransactionIds
from drivers.modbus.wire import read_request
from drivers.tag import DType, Order, Quality, Tag
from tests.drivers.conftest import OpenModbus, read_until_good
from tests.drivers.scripted import (
    ScriptedPlc,
    always,
    first,
    late,
    mbap,
    read_reply,
    silent,
    transaction_of,
)

FIVE = Tag("five", "holding:5")
FAST: dict[str, Any] = {"timeout": 0.2}


def block_of(count: int, start: int = 0) -> list[Tag]:
    return [Tag(f"t{n}", f"holding:{n}") for n in range(start, start + count)]


# ---------------------------------------------------------------- reading


async def test_all_types_and_tables_are_read_in_the_order_asked(plc: ScriptedPlc, opened: OpenModbus) -> None:
    plc.registers.update({20: 0xF5C3, 21: 0x4148, 30: 0b1000, 40: 0x4142, 41: 0x4300})
    tags = [
        Tag("text", "holding:40", DType.STRING, length=4),
        Tag("coil", "coil:3", DType.BOOL),
        Tag("temperature", "holding:20", DType.FLOAT32, Order.CDAB),
        Tag("bit", "holding:30", DType.BOOL, bit=3),
        Tag("discrete", "discrete:4", DType.BOOL),
        Tag("input", "input:7", scale=0.1),
    ]
    before = time.time()
    samples = await (await opened()).read(tags)
    assert [sample.tag for sample in samples] == [tag.name for tag in tags]
    assert [sample.value for sample in samples] == ["ABC", True, pytest.approx(12.56), True, False, pytest.approx(0.7)]
    assert all(sample.quality is Quality.GOOD for sample in samples)
    assert all(sample.sent is not None and before <= sample.sent <= sample.time <= time.time() for sample in samples)


async def test_neighbours_share_one_request_and_one_moment(plc: ScriptedPlc, opened: OpenModbus) -> None:
    samples = await (await opened()).read(block_of(20))
    assert plc.asked() == [(3, 0, 20)]
    assert len({(sample.sent, sample.time) for sample in samples}) == 1


async def test_a_tag_that_cannot_be_read_says_what_would_be_right_and_the_others_go_on(opened: OpenModbus) -> None:
    bad = [Tag("ref", "40006"), Tag("nan", "memory:1"), Tag("wide", "holding:0", DType.FLOAT64)]
    samples = await (await opened(max_registers=2)).read([*bad, FIVE])
    assert [sample.quality for sample in samples[:3]] == [Quality.CONFIGURATION_ERROR] * 3
    assert "holding:5" in samples[0].reason
    assert samples[3].value == 5


async def test_the_plan_is_explained_with_its_worst_cycle(opened: OpenModbus) -> None:
    driver = await opened(pause_ms=100)
    lines = driver.explain([FIVE, Tag("far", "holding:150"), Tag("ref", "40006")])
    assert lines[0].endswith("write the PDU address holding:5")
    assert lines[1:] == (
        "holding:5 count 1: five",
        "holding:150 count 1: far",
        "2 requests for 2 addresses, worst case 1.3 s a cycle",
    )


async def test_requests_keep_the_devices_pause(plc: ScriptedPlc, opened: OpenModbus) -> None:
    moments: list[float] = []

    async def note(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        moments.append(asyncio.get_running_loop().time())
        writer.write(honest)

    plc.bend = note
    driver = await opened(pause_ms=80, max_gap=0)
    await driver.read([Tag("a", "holding:0"), Tag("b", "holding:10"), Tag("c", "holding:20")])
    assert all(b - a >= 0.079 for a, b in pairwise(moments))
    assert len(moments) == 3


# ---------------------------------------------------------------- replies that do not answer

WRONG = {
    "three registers for four": always(lambda request, _: read_reply(request, [9] * 3)),
    "five registers for four": always(lambda request, _: read_reply(request, [9] * 5)),
    "function 04 for function 03": always(lambda request, _: read_reply(request, [9] * 4, function=4)),
    "an exception of another function": always(lambda request, _: mbap(transaction_of(request), 1, b"\x84\x02")),
    "another unit": always(lambda request, _: read_reply(request, [9] * 4, unit=9)),
    "an unknown function": always(lambda request, _: mbap(transaction_of(request), 1, b"\x55\0\0")),
    "a byte count beyond the frame": always(
        lambda request, _: mbap(transaction_of(request), 1, b"\x03\x08" + bytes(6))
    ),
    "a byte count short of the frame": always(
        lambda request, _: mbap(transaction_of(request), 1, b"\x03\x08" + bytes(10))
    ),
    "an odd byte count": always(lambda request, _: mbap(transaction_of(request), 1, b"\x03\x07" + bytes(7))),
}


@pytest.mark.parametrize("kind", WRONG)
async def test_a_wrong_reply_is_never_a_value_and_the_next_honest_one_is(
    plc: ScriptedPlc, opened: OpenModbus, kind: str
) -> None:
    complaints: list[dict[str, object]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: complaints.append(context))
    driver = await opened(**FAST)
    plc.bend = WRONG[kind]
    samples = await driver.read(block_of(4))
    assert {(sample.value, sample.quality) for sample in samples} == {(None, Quality.COMMUNICATION_ERROR)}
    assert samples[0].reason.startswith("holding:0 count 4: ")
    assert driver.statistics()["mismatches"] == 2
    plc.bend = None
    assert [sample.value for sample in await driver.read(block_of(4))] == [0, 1, 2, 3]
    assert complaints == []


@pytest.mark.parametrize("count", [17, 21, 24])
async def test_bits_that_are_by_chance_the_bytes_of_their_request_are_read(
    plc: ScriptedPlc, opened: OpenModbus, count: int
) -> None:
    bits = [int.from_bytes(bytes((5, 0, count)), "little") >> n & 1 for n in range(count)]
    plc.coils = {0x0305 + n: bit for n, bit in enumerate(bits)}
    tags = [Tag(f"C{n}", f"coil:{0x0305 + n}", DType.BOOL) for n in range(count)]
    samples = await (await opened(timeout=10.0)).read(tags)
    assert [(sample.quality, sample.value) for sample in samples] == [(Quality.GOOD, bool(bit)) for bit in bits]


async def test_another_units_answer_to_a_first_attempt_does_not_end_the_second() -> None:
    asked: list[bytes] = []

    async def bend(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        asked.append(request)
        if len(asked) == 1:
            return
        # One behind the other, as the first one ended the question where it was taken for its answer.
        writer.write(read_reply(asked[0], [7], unit=9) + honest)

    plc = ScriptedPlc(bend=bend)
    await plc.start()
    wire = NumberedWire(
        "127.0.0.1",
        plc.port,
        ids=TransactionIds(random.Random(1)),
        clock=time.time,
        on_lost=lambda _: None,
        on_late=lambda *_: None,
    )
    try:
        await wire.connect()
        question = read_request(Area.HOLDING, 5, 1, 1)
        with pytest.raises(ReplyTimeout):
            await wire.ask(question, 0.05)
        assert (await wire.ask(question, 30.0, again=True)).words == (5,)
    finally:
        wire.abandon()
        await plc.stop()


@pytest.mark.parametrize("transaction", [0, 999, 65535])
async def test_a_reply_with_another_transaction_id_is_dropped_and_counted(
    plc: ScriptedPlc, opened: OpenModbus, transaction: int
) -> None:
    driver = await opened(**FAST)
    plc.bend = always(lambda request, honest: transaction.to_bytes(2, "big") + honest[2:])
    (sample,) = await driver.read([FIVE])
    assert (sample.value, sample.quality) == (None, Quality.TIMEOUT)
    assert "1 with another transaction id dropped" in sample.reason
    assert driver.statistics()["foreign_replies"] == 2


async def test_a_read_is_asked_again_inside_its_deadline_with_a_new_transaction_id(
    plc: ScriptedPlc, opened: OpenModbus
) -> None:
    driver = await opened(**FAST)
    plc.bend = first(1, silent)
    (sample,) = await driver.read([FIVE])
    assert (sample.value, sample.quality) == (5, Quality.GOOD)
    assert len({transaction_of(request) for request in plc.requests}) == 2
    assert sample.sent is not None
    assert sample.time - sample.sent < 0.1
    assert driver.statistics()["retries"] == 1


async def test_a_late_reply_never_satisfies_a_later_request(plc: ScriptedPlc, opened: OpenModbus) -> None:
    """The device answers each request 150 ms late, when the next one (another value, same shape) is outstanding."""
    driver = await opened(timeout=0.1, attempts=1, max_failures=100, max_silence=60)
    plc.bend = late(0.15)
    for number in range(8):
        plc.registers[5] = 1000 + number
        (sample,) = await driver.read([FIVE])
        assert sample.value is None
        assert sample.quality is Quality.TIMEOUT
    assert driver.statistics()["foreign_replies"] >= 5


async def test_a_late_reply_split_over_two_requests_ends_the_connection(plc: ScriptedPlc, opened: OpenModbus) -> None:
    """Half of the late reply comes before the next request is sent, the other half after it, then the true reply."""
    halves: list[Callable[[], None]] = []

    async def bend(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        if not halves:
            await asyncio.sleep(0.05)
            writer.write(honest[:7])
            halves.append(lambda: writer.write(honest[7:]))
        else:
            halves[0]()
            await asyncio.sleep(0.02)
            writer.write(honest)

    plc.bend = bend
    driver = await opened(timeout=0.1, attempts=1)
    assert (await driver.read([FIVE]))[0].quality is Quality.TIMEOUT
    plc.registers[5] = 77
    sample = await read_until_good(driver, FIVE)
    assert (sample.value, sample.quality) == (77, Quality.GOOD)
    assert plc.connections == 2


async def test_duplicate_replies_and_frames_nobody_asked_for_change_nothing(
    plc: ScriptedPlc, opened: OpenModbus
) -> None:
    plc.bend = always(lambda request, honest: mbap(9999, 1, b"\x03\x02\0\7") + honest + honest)
    driver = await opened(**FAST)
    for number in (3, 4, 5):
        (sample,) = await driver.read([Tag("x", f"holding:{number}")])
        assert (sample.value, sample.quality) == (number, Quality.GOOD)


async def test_a_reply_in_single_bytes_is_one_reply(plc: ScriptedPlc, opened: OpenModbus) -> None:
    async def drip(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        for byte in honest:
            writer.write(bytes([byte]))
            await asyncio.sleep(0.002)

    plc.bend = drip
    samples = await (await opened()).read(block_of(3))
    assert [sample.value for sample in samples] == [0, 1, 2]


async def test_concurrent_readers_and_writers_take_turns_and_get_their_own_replies(
    plc: ScriptedPlc, opened: OpenModbus
) -> None:
    driver = await opened(write_map=[FIVE])

    async def reader(number: int) -> None:
        for _ in range(15):
            (sample,) = await driver.read([Tag("x", f"input:{number}")])
            assert sample.value == number

    async def writer() -> None:
        for value in range(15):
            await driver.write([(FIVE, value)])

    await asyncio.gather(*(reader(number) for number in (11, 12, 13)), writer())
    assert plc.functions().count(16) == 15


# ---------------------------------------------------------------- refused addresses


async def test_a_refused_register_is_found_and_its_neighbours_go_on_in_the_same_reading(
    plc: ScriptedPlc, opened: OpenModbus
) -> None:
    plc.illegal = {13}
    driver = await opened(refused_first=30)
    for _ in range(2):
        samples = await driver.read(block_of(30))
        assert [sample.tag for sample in samples if not sample.quality.is_good] == ["t13"]
        assert samples[13].quality is Quality.CONFIGURATION_ERROR
        assert samples[13].reason.startswith("holding:13 count 1: exception 2, illegal data address")
    assert driver.statistics()["quarantined"] == 1
    plc.requests.clear()
    await driver.read(block_of(30))
    assert plc.asked() == [(3, 0, 13), (3, 14, 16)]
    assert driver.explain(block_of(30))[0].startswith("t13: in quarantine: holding:13")


async def test_a_refused_register_rejoins_its_neighbours_when_it_answers_again(
    plc: ScriptedPlc, opened: OpenModbus
) -> None:
    plc.illegal = {13}
    driver = await opened(refused_first=0.1, refused_cap=0.1)
    await driver.read(block_of(30))
    plc.illegal = set()
    await asyncio.sleep(0.12)
    assert (await driver.read(block_of(30)))[13].value == 13
    plc.requests.clear()
    assert all(sample.quality.is_good for sample in await driver.read(block_of(30)))
    assert plc.asked() == [(3, 0, 30)]
    assert driver.statistics()["quarantined"] == 0


async def test_a_refused_register_is_tried_alone_and_waits_longer_each_time(
    plc: ScriptedPlc, opened: OpenModbus
) -> None:
    plc.illegal = {3}
    driver = await opened(refused_first=0.05, refused_cap=30)
    end = asyncio.get_running_loop().time() + 1.0
    while asyncio.get_running_loop().time() < end:
        await driver.read(block_of(6))
        await asyncio.sleep(0.02)
    trials = [asked for asked in plc.asked() if asked == (3, 3, 1)]
    assert 2 <= len(trials) <= 6
    assert driver.statistics()["bisections"] == 1


async def test_after_a_reconnection_a_refused_register_is_tried_at_once(plc: ScriptedPlc, opened: OpenModbus) -> None:
    plc.illegal = {3}
    driver = await opened(refused_first=3000, refused_cap=3000)
    await driver.read(block_of(6))
    plc.illegal = set()
    await plc.stop()
    await plc.start()
    await read_until_good(driver, FIVE)
    assert (await driver.read(block_of(6)))[3].value == 3


async def test_an_unreadable_gap_only_costs_another_request(plc: ScriptedPlc, opened: OpenModbus) -> None:
    plc.illegal = {8}
    driver = await opened()
    tags = [FIVE, Tag("ten", "holding:10")]
    assert [sample.value for sample in await driver.read(tags)] == [5, 10]
    plc.requests.clear()
    assert [sample.value for sample in await driver.read(tags)] == [5, 10]
    assert plc.asked() == [(3, 5, 1), (3, 10, 1)]
    assert driver.statistics()["quarantined"] == 0


async def test_a_device_that_takes_shorter_requests_than_configured_is_read_whole(
    plc: ScriptedPlc, opened: OpenModbus
) -> None:
    plc.max_count = 20
    driver = await opened()
    for _ in range(3):
        plc.requests.clear()
        assert [sample.value for sample in await driver.read(block_of(60))] == list(range(60))
    assert plc.asked() == [(3, 0, 15), (3, 15, 15), (3, 30, 15), (3, 45, 15)]


async def test_a_device_that_refuses_everything_loses_no_tag_to_quarantine_and_is_back_at_once(
    plc: ScriptedPlc, opened: OpenModbus
) -> None:
    plc.exception = 2
    driver = await opened(refused_first=60, refused_cap=60)
    for _ in range(3):
        samples = await driver.read(block_of(8))
        assert all(sample.quality is Quality.CONFIGURATION_ERROR for sample in samples)
    assert driver.statistics()["quarantined"] == 0
    assert driver.statistics()["bisections"] == 1
    plc.exception = 0
    assert all(sample.quality.is_good for sample in await driver.read(block_of(8)))


@pytest.mark.parametrize(
    ("code", "quality"),
    [
        (5, Quality.NO_DATA),
        (6, Quality.NO_DATA),
        (10, Quality.NO_COMMUNICATION),
        (11, Quality.NO_COMMUNICATION),
        (8, Quality.DEVICE_FAILURE),
        (77, Quality.BAD),
    ],
)
async def test_an_exception_about_the_moment_is_not_bisected(
    plc: ScriptedPlc, opened: OpenModbus, code: int, quality: Quality
) -> None:
    plc.exception = code
    driver = await opened()
    samples = await driver.read(block_of(8))
    assert {(sample.value, sample.quality) for sample in samples} == {(None, quality)}
    # What is said to pass by itself is asked again within the reading.
    assert set(plc.asked()) == {(3, 0, 8)} and (len(plc.asked()) > 1) == (code in (5, 6))
    assert driver.connected


async def test_a_bisection_that_meets_a_dead_line_concludes_nothing(plc: ScriptedPlc, opened: OpenModbus) -> None:
    plc.illegal = {3}
    answers = 0

    async def die(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        nonlocal answers
        answers += 1
        if answers <= 2:
            writer.write(honest)

    plc.bend = die
    driver = await opened(**FAST)
    samples = await driver.read(block_of(8))
    assert {sample.quality for sample in samples} <= {Quality.TIMEOUT, Quality.NOT_CONNECTED, Quality.GOOD}
    assert driver.statistics()["quarantined"] == 0


# ---------------------------------------------------------------- writing

WORD = Tag("word", "holding:50")
REAL = Tag("real", "holding:51", DType.FLOAT32, Order.CDAB)
LAST = Tag("last", "holding:53", scale=0.1, low=0, high=100)
MAP = (WORD, REAL, LAST, Tag("far", "holding:60"), Tag("lamp", "coil:8", DType.BOOL), Tag("horn", "coil:9", DType.BOOL))


async def test_neighbouring_tags_are_one_request_of_function_16_and_are_read_back(
    plc: ScriptedPlc, opened: OpenModbus
) -> None:
    driver = await opened(write_map=MAP)
    await driver.write([(LAST, 12.3), (WORD, 7), (REAL, 12.56)])
    assert plc.asked() == [(16, 50, 4), (3, 50, 4)]
    assert [plc.registers[n] for n in range(50, 54)] == [7, 0xF5C3, 0x4148, 123]


async def test_neighbouring_coils_are_one_request_of_function_15(plc: ScriptedPlc, opened: OpenModbus) -> None:
    driver = await opened(write_map=MAP)
    await driver.write([(MAP[4], True), (MAP[5], True)])
    assert plc.asked() == [(15, 8, 2), (1, 8, 2)]
    assert (plc.coils[8], plc.coils[9]) == (1, 1)


@pytest.mark.parametrize(
    ("values", "error", "sentence"),
    [
        ([(Tag("other", "holding:70"), 1)], WriteForbidden, "not in the write map"),
        ([(Tag("word", "holding:70"), 1)], WriteForbidden, "not in the write map"),
        ([(Tag("word", "holding:50", scale=0.1), 1)], WriteForbidden, "not in the write map"),
        ([(WORD, 1), (Tag("real", "holding:51"), 1)], WriteForbidden, "real"),
        ([(WORD, 1), (LAST, 1)], AddressError, "not neighbours"),
        ([(WORD, 1), (WORD, 2)], AddressError, "not neighbours"),
        ([(WORD, 1), (MAP[4], True)], AddressError, "not neighbours"),
        ([(WORD, 70000)], EncodingError, "holds 0 to 65535"),
        ([(LAST, 101)], EncodingError, "above the highest"),
        ([(WORD, 1), (REAL, float("nan"))], EncodingError, "finite"),
    ],
)
async def test_a_write_that_must_not_be_sends_nothing(
    plc: ScriptedPlc, opened: OpenModbus, values: list[tuple[Tag, Any]], error: type[DriverError], sentence: str
) -> None:
    driver = await opened(write_map=MAP)
    with pytest.raises(error, match=sentence):
        await driver.write(values)
    assert plc.requests == []


async def test_without_a_write_map_nothing_can_be_written(plc: ScriptedPlc, opened: OpenModbus) -> None:
    driver = await opened()
    with pytest.raises(WriteForbidden):
        await driver.write([(WORD, 1)])
    assert plc.requests == []


async def test_a_write_longer_than_the_device_takes_is_refused(plc: ScriptedPlc, opened: OpenModbus) -> None:
    with pytest.raises(DriverError, match="the block has 4 words and the device takes 2 in one write"):
        await opened(write_map=MAP, max_write_registers=2)
    assert plc.requests == []


async def test_a_write_longer_than_one_read_is_read_back_in_parts(plc: ScriptedPlc, opened: OpenModbus) -> None:
    driver = await opened(write_map=MAP, max_registers=3, max_write_registers=100)
    await driver.write([(WORD, 1), (REAL, 2.0), (LAST, 3)])
    assert plc.asked() == [(16, 50, 4), (3, 50, 3), (3, 53, 1)]


@pytest.mark.parametrize("tag", [Tag("x", "input:5"), Tag("x", "holding:5", DType.BOOL, bit=2), Tag("x", "40006")])
def test_a_write_map_with_a_place_that_cannot_be_written_is_refused_at_start(tag: Tag) -> None:
    with pytest.raises(AddressError, match="x: "):
        open_modbus({"host": "127.0.0.1"}, clock=time.time, write_map=[tag])


async def test_a_write_without_an_answer_is_on_the_wire_once(plc: ScriptedPlc, opened: OpenModbus) -> None:
    plc.bend = silent
    driver = await opened(write_map=MAP, **FAST)
    with pytest.raises(ReplyTimeout):
        await driver.write([(WORD, 1)])
    await asyncio.sleep(0.1)
    assert plc.functions() == [16]


async def test_a_write_over_a_dead_link_says_so_and_is_not_sent_later(plc: ScriptedPlc, opened: OpenModbus) -> None:
    driver = await opened(write_map=MAP)
    await driver.read([FIVE])
    await plc.stop()
    await asyncio.sleep(0.05)
    with pytest.raises(LinkDown, match="not connected"):
        await driver.write([(WORD, 1)])
    await plc.start()
    await read_until_good(driver, FIVE)
    assert 16 not in plc.functions()


async def test_a_write_that_is_reset_is_a_broken_link_and_is_not_repeated(plc: ScriptedPlc, opened: OpenModbus) -> None:
    async def reset(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        writer.transport.abort()

    driver = await opened(write_map=MAP)
    plc.bend = reset
    with pytest.raises(LinkDown, match="closed"):
        await driver.write([(WORD, 1)])
    plc.bend = None
    await read_until_good(driver, FIVE)
    assert plc.functions().count(16) == 1


@pytest.mark.parametrize("echo", [(50, 3), (51, 4), (700, 1)])
async def test_the_echo_of_another_block_is_a_mismatch(
    plc: ScriptedPlc, opened: OpenModbus, echo: tuple[int, int]
) -> None:
    plc.bend = always(lambda request, _: mbap(transaction_of(request), 1, struct.pack(">BHH", 16, *echo)))
    driver = await opened(write_map=MAP)
    with pytest.raises(ReplyMismatch, match="confirms"):
        await driver.write([(WORD, 1), (REAL, 1.0), (LAST, 1)])


async def test_a_refused_write_has_the_devices_code(plc: ScriptedPlc, opened: OpenModbus) -> None:
    plc.exception = 3
    driver = await opened(write_map=MAP)
    with pytest.raises(DeviceException, match="illegal data value") as caught:
        await driver.write([(WORD, 1)])
    assert caught.value.code == 3


async def test_a_write_that_is_confirmed_and_not_stored_is_unverified_and_names_the_tag(
    plc: ScriptedPlc, opened: OpenModbus
) -> None:
    def forget(request: bytes, honest: bytes) -> bytes:
        plc.registers[51] = 0
        return plc.answer(request) if request[7] == 3 else honest

    plc.bend = always(forget)
    driver = await opened(write_map=MAP)
    with pytest.raises(WriteUnverified, match="real: wrote"):
        await driver.write([(WORD, 1), (REAL, 3.7)])


async def test_a_write_that_cannot_be_read_back_is_unverified(plc: ScriptedPlc, opened: OpenModbus) -> None:
    plc.bend = always(
        lambda request, honest: honest if request[7] == 16 else mbap(transaction_of(request), 1, b"\x83\x02")
    )
    driver = await opened(write_map=MAP)
    with pytest.raises(WriteUnverified, match="reading back failed"):
        await driver.write([(WORD, 1)])


# ---------------------------------------------------------------- settings


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({}, "host must be given"),
        ({"host": "a", "prot": 502}, "prot: there is no such key; did you mean 'port'"),
        ({"host": "a", "port": "502"}, "port: must be a whole number, got '502'; give a TCP port from 1 to 65535"),
        ({"host": "a", "port": 70000}, "port: must be at most 65535, got 70000; give a TCP port"),
        ({"host": "a", "unit": True}, "unit: must be a whole number, got True; give a unit id from 0 to 255"),
        ({"host": "a", "timeout": 0}, "timeout: must be at least 0.001, got 0; give the deadline"),
        ({"host": "a", "timeout": float("nan")}, "timeout: must be a finite number, got nan; give the deadline"),
        ({"host": "a", "max_registers": 126}, "at most 125"),
        ({"host": "a", "backoff_cap": 6}, "at most 5"),
        ({"host": 3}, "host: must be text, got 3; give the device's address"),
        ({"host": ""}, "host: must not be empty, got ''; give the device's address"),
    ],
)
def test_a_setting_that_cannot_be_is_refused_in_one_sentence(settings: dict[str, Any], sentence: str) -> None:
    with pytest.raises(DriverError, match=sentence) as caught:
        open_driver("modbus", settings, clock=time.time)
    assert "\n" not in str(caught.value)
