"""RTU on a line without transaction ids: CRC, late replies, echo, noise; nothing that is not the answer is taken."""

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import pytest

from drivers.driver import open_driver
from drivers.errors import DriverError, LinkDown, ReplyTimeout
from drivers.modbus import rtu as modbus_rtu
from drivers.modbus.address import Area
from drivers.modbus.driver import ModbusDriver, open_modbus
from drivers.modbus.wire import read_request, write_request
from drivers.tag import Quality, Sample, Tag
from tests.drivers.scripted import ScriptedPlc
from tests.drivers.scripted_line import Bend, PtyLine, ScriptedLine, rtu

A, B = Tag("a", "holding:10"), Tag("b", "holding:60")
SETPOINT = Tag("setpoint", "holding:20")


@pytest.fixture
async def ends() -> AsyncIterator[PtyLine]:
    made = PtyLine(ScriptedLine())
    made.start()
    yield made
    made.stop()


Open = Callable[..., Any]


@pytest.fixture
async def opened(ends: PtyLine) -> AsyncIterator[Open]:
    drivers: list[ModbusDriver] = []

    async def open_(**settings: Any) -> ModbusDriver:
        given = {"transport": "rtu", "serial": ends.path, "parity": "N", "baud": 115200, "timeout": 0.1}
        given |= {"attempts": 1, "longest_reply": 0.5, **settings}
        driver = open_modbus(given, clock=time.time, write_map=(SETPOINT,))
        drivers.append(driver)
        await driver.open()
        return driver

    yield open_
    for driver in drivers:
        await driver.close()


async def one(driver: ModbusDriver, tag: Tag) -> Sample:
    (sample,) = await driver.read([tag])
    return sample


# ------------------------------------------------------------------ frames


@pytest.mark.parametrize(
    ("frame", "crc"),
    [
        ("0103006b0003", "7417"),  # MODBUS over Serial Line, the usual example of a read
        ("11010013 0025".replace(" ", ""), "0e84"),
        ("01100001000204000a0102", "9230"),
    ],
)
def test_the_crc_is_that_of_published_frames(frame: str, crc: str) -> None:
    assert modbus_rtu.crc(bytes.fromhex(frame)).hex() == crc
    assert rtu(int(frame[:2], 16), bytes.fromhex(frame[2:])).hex() == frame + crc


def test_a_request_frame_is_unit_pdu_and_crc() -> None:
    assert modbus_rtu.request_frame(read_request(Area.HOLDING, 0x6B, 3, 1)).hex() == "0103006b00037417"
    written = modbus_rtu.request_frame(write_request(Area.HOLDING, 1, [0x000A, 0x0102], 1))
    assert written.hex() == "01100001000204000a01029230"


def test_the_silence_between_frames_is_three_and_a_half_characters_and_fixed_above_19200() -> None:
    assert modbus_rtu.silence(9600) == pytest.approx(0.00401, abs=1e-5)
    assert modbus_rtu.silence(19200) == pytest.approx(0.002005, abs=1e-6)
    assert modbus_rtu.silence(115200) == 0.00175


# ------------------------------------------------------------------ late replies


def slower(seconds: float) -> Bend:
    """The device's honest reply, after a while."""
    return lambda line, request, honest: line.later(seconds, honest)


async def first_good(driver: ModbusDriver, tag: Tag) -> Sample:
    """The first reading that has a value; until then there is none, and not another's."""
    while (sample := await one(driver, tag)).value is None:
        assert sample.quality in (Quality.TIMEOUT, Quality.NOT_CONNECTED, Quality.COMMUNICATION_ERROR)
        await asyncio.sleep(0.005)
    return sample


@pytest.mark.parametrize("late", [0.12, 0.14, 0.16, 0.25])
async def test_a_late_reply_never_answers_the_next_request(ends: PtyLine, opened: Open, late: float) -> None:
    """Both requests ask for one register: on the wire the late reply to the first looks like one to the second.

    The device needs 80 ms for the second reply, so that the late one is there first.
    """
    driver = await opened()
    ends.line.bend = slower(late)
    first = await one(driver, A)
    assert (first.value, first.quality) == (None, Quality.TIMEOUT)
    ends.line.bend = slower(0.08)
    assert (await first_good(driver, B)).value == 60


async def test_after_the_late_reply_has_come_the_line_is_free_before_its_time_is_over(
    ends: PtyLine, opened: Open
) -> None:
    driver = await opened(longest_reply=20.0, timeout=0.4)
    ends.line.bend = lambda line, request, honest: line.later(0.5, honest)
    assert (await one(driver, A)).value is None
    ends.line.bend = None
    assert (await one(driver, B)).value == 60
    assert driver.statistics()["foreign_replies"] == 1


async def test_a_late_reply_in_pieces_is_not_taken_either(ends: PtyLine, opened: Open) -> None:
    driver = await opened()

    def in_pieces(line: ScriptedLine, request: bytes, honest: bytes) -> None:
        line.later(0.08, honest[:3])
        line.later(0.12, honest[3:5])
        line.later(0.16, honest[5:])

    ends.line.bend = in_pieces
    assert (await one(driver, A)).value is None
    ends.line.bend = slower(0.08)
    assert (await first_good(driver, B)).value == 60


async def test_the_wait_for_a_late_reply_outlives_the_connection(ends: PtyLine, opened: Open) -> None:
    driver = await opened(max_failures=1, backoff_first=0.01, longest_reply=0.4)
    ends.line.bend = slower(0.17)
    assert (await one(driver, A)).value is None
    ends.line.bend = slower(0.08)
    assert (await first_good(driver, B)).value == 60
    assert driver.statistics()["connects"] > 1


async def test_a_read_that_may_not_be_sent_yet_says_what_it_waits_for(ends: PtyLine, opened: Open) -> None:
    driver = await opened(longest_reply=5.0)
    ends.line.away = True
    assert "no reply in time" in (await one(driver, A)).reason
    assert "not asked, as holding:10 count 1 may still be answered for" in (await one(driver, B)).reason
    assert len(ends.line.requests) == 1


async def test_a_doubled_reply_costs_nothing(ends: PtyLine, opened: Open) -> None:
    driver = await opened()
    ends.line.bend = lambda line, request, honest: line.put(honest * 2)
    for tag, value in ((A, 10), (B, 60), (A, 10)):
        assert (await one(driver, tag)).value == value


# ------------------------------------------------------------------ replies that are none


@pytest.mark.parametrize(
    ("bent", "said"),
    [
        (lambda honest: honest[:-1] + bytes((honest[-1] ^ 1,)), "CRC is wrong"),
        (lambda honest: rtu(9, honest[1:-2]), "from unit 9"),
        (lambda honest: rtu(1, b"\x04" + honest[2:-2]), "of function 4"),
        (lambda honest: rtu(1, b"\x03\x04\0\1\0\2"), "2 bytes were asked, the reply announces 4"),
        (lambda honest: rtu(1, b"\x2b\x0e\x01"), "of function 43"),
        (lambda honest: honest[:-2], "no reply in time (5 bytes of one came)"),
        (lambda honest: b"", "no reply in time"),
    ],
    ids=["noise", "another unit", "another function", "another count", "a strange function", "cut short", "silence"],
)
async def test_what_is_not_the_answer_is_refused_with_a_reason(
    ends: PtyLine, opened: Open, bent: Callable[[bytes], bytes], said: str
) -> None:
    patient = {"timeout": 1.0 if "no reply" in said else 5.0}  # a busy machine brings late what is no answer, too
    driver = await opened(**patient)
    ends.line.bend = lambda line, request, honest: line.put(bent(honest))
    sample = await one(driver, A)
    assert sample.value is None and sample.quality.is_bad
    assert said in sample.reason


async def test_noise_in_one_reply_is_made_good_by_the_second_attempt(ends: PtyLine, opened: Open) -> None:
    driver = await opened(attempts=2, timeout=0.4)

    def noisy_once(line: ScriptedLine, request: bytes, honest: bytes) -> None:
        line.put(honest if len(line.requests) > 1 else honest[:3] + bytes((honest[3] ^ 0x40,)) + honest[4:])

    ends.line.bend = noisy_once
    assert (await one(driver, A)).value == 10
    assert driver.statistics()["mismatches"] == 1


async def test_a_reply_in_single_bytes_is_put_together(ends: PtyLine, opened: Open) -> None:
    driver = await opened(timeout=0.5)

    def slowly(line: ScriptedLine, request: bytes, honest: bytes) -> None:
        for index, octet in enumerate(honest):
            line.later(0.01 * index, bytes((octet,)))

    ends.line.bend = slowly
    assert (await one(driver, A)).value == 10


async def test_an_exception_of_the_device_is_read_as_such(ends: PtyLine, opened: Open) -> None:
    driver = await opened()
    ends.line.memory.illegal = {10}
    sample = await one(driver, A)
    assert sample.quality is Quality.CONFIGURATION_ERROR and "illegal data address" in sample.reason
    assert (await one(driver, B)).value == 60


# ------------------------------------------------------------------ echo


async def test_an_adapters_echo_is_taken_away_if_it_is_announced(ends: PtyLine, opened: Open) -> None:
    ends.line.echo = True
    driver = await opened(echo=True)
    assert (await one(driver, A)).value == 10
    await driver.write([(SETPOINT, 7)])
    assert ends.line.memory.registers[20] == 7


async def test_an_echo_that_was_not_announced_is_named_and_gives_no_value(ends: PtyLine, opened: Open) -> None:
    ends.line.echo = True
    driver = await opened()
    assert "set echo = true" in (await one(driver, A)).reason


async def test_an_announced_echo_that_does_not_come_or_is_another_is_named(ends: PtyLine, opened: Open) -> None:
    driver = await opened(echo=True, longest_reply=0.01)
    ends.line.away = True
    assert "set echo = false?" in (await one(driver, A)).reason
    ends.line.away, ends.line.bend = False, lambda line, request, honest: line.put(bytes(8) + honest)
    assert "does somebody else send on this line?" in (await one(driver, A)).reason


# ------------------------------------------------------------------ writes


async def test_a_write_without_an_answer_is_sent_once_and_its_late_confirmation_confirms_no_other(
    ends: PtyLine, opened: Open
) -> None:
    driver = await opened(longest_reply=0.3)
    ends.line.bend = lambda line, request, honest: line.later(0.2, honest)
    with pytest.raises(ReplyTimeout):
        await driver.write([(SETPOINT, 1)])
    ends.line.away, ends.line.bend = True, None
    for _ in range(20):
        with pytest.raises(DriverError):
            await driver.write([(SETPOINT, 2)])
        await asyncio.sleep(0.02)
    written = [request[7:9] for request in ends.line.requests if request[1] == 16]
    assert written.count(b"\0\1") == 1


# ------------------------------------------------------------------ settings


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"transport": "rtu"}, "serial must be given"),
        ({"transport": "sctp", "host": "h"}, "transport: must be 'tcp', 'tls', 'rtu', 'rtu-tcp', "),
        ({"host": "h", "serial": "/dev/ttyS0"}, "serial means nothing with transport 'tcp': it is for 'rtu' or "),
        ({"transport": "rtu", "serial": "/dev/ttyS0", "unit": 0}, "1 to 247 (0 is for all)"),
        ({"transport": "rtu", "serial": "/dev/ttyS0", "parity": "X"}, "parity: must be 'N', 'E' or 'O', got 'X'"),
        ({"transport": "rtu-tcp"}, "host must be given"),
        ({}, "host must be given"),
        ({"host": "h", "echo": True}, "echo means nothing with transport 'tcp': it is for 'rtu' or 'rtu-tcp' or"),
    ],
)
def test_settings_that_do_not_go_together_are_refused_in_one_sentence(settings: dict[str, Any], said: str) -> None:
    with pytest.raises(DriverError) as caught:
        open_driver("modbus", settings, clock=time.time)
    assert said in str(caught.value)


async def test_a_port_that_is_not_there_or_takes_no_parity_is_said(ends: PtyLine, opened: Open) -> None:
    with pytest.raises(LinkDown, match="/dev/nowhere cannot be opened"):
        await opened(serial="/dev/nowhere")


async def test_a_port_that_goes_is_noticed_at_once(ends: PtyLine, opened: Open) -> None:
    other = PtyLine(ScriptedLine(ScriptedPlc()))
    other.start()
    driver = await opened(serial=other.path)
    assert (await one(driver, A)).value == 10
    other.stop()
    await asyncio.sleep(0.05)
    sample = await one(driver, A)
    assert sample.quality is Quality.NOT_CONNECTED and Path(other.path).name in sample.reason
