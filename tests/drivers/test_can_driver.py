"""The raw CAN driver on a small device: loss and return of bus, device and controller; writes; streams; garbage."""

import asyncio
import random
import re
import socket
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import can
import pytest

from drivers.can import driver as can_driver
from drivers.can.bus.access import open_bus
from drivers.can.driver import CanDriver, open_can
from drivers.driver import Explains, Streams
from drivers.errors import AddressError, DriverError, LinkDown, ReplyTimeout, WriteForbidden, WriteUnverified
from drivers.tag import Quality, Sample, Tag, Value
from tests.drivers.bench_can import CAN_TAGS, ECHO, CanDevice
from tests.drivers.conftest import read_until_good

BUS_OFF, RESTARTED = 0x40, 0x100
Make = Callable[..., CanDriver]


@pytest.fixture
async def device(tmp_path: Path) -> AsyncIterator[CanDevice]:
    made = CanDevice(tmp_path / "bus")
    await made.start()
    yield made
    await made.stop()


@pytest.fixture
async def make(device: CanDevice) -> AsyncIterator[Make]:
    """Make drivers on the device's bus; they are closed at the end."""
    drivers: list[CanDriver] = []

    def make_(write_map: tuple[Tag, ...] = CAN_TAGS.write_map, **settings: Any) -> CanDriver:
        fixed = {"interface": "hub", "channel": str(device.path), "echo": ECHO, "message_timeout": 0.3}
        merged = {**fixed, "connect_timeout": 20.0, **settings}  # a busy machine opens a bus late
        drivers.append(open_can(merged, clock=time.time, write_map=write_map))
        return drivers[-1]

    yield make_
    for driver in drivers:
        await driver.close()


async def opened(driver: CanDriver, tags: tuple[Tag, ...] = CAN_TAGS.read) -> CanDriver:
    await driver.open()
    for tag in tags:
        await read_until_good(driver, tag)
    return driver


async def until(condition: Callable[[], bool], within: float = 60.0) -> None:
    end = time.monotonic() + within
    while not condition():
        assert time.monotonic() < end
        await asyncio.sleep(0.01)


async def until_not_good(driver: CanDriver, tag: Tag, within: float = 60.0, *, late: bool = True) -> Sample:
    """The first reading that is not good; without `late` none that a busy machine alone makes so."""
    end = time.monotonic() + within
    while (sample := (await driver.read([tag]))[0]).quality.is_good or (
        not late and sample.quality in (Quality.TIMEOUT, Quality.WAITING_FOR_INITIAL_DATA)
    ):
        assert time.monotonic() < end
        await asyncio.sleep(0.01)
    return sample


def error_frame(classes: int, data: bytes = bytes(8)) -> can.Message:
    return can.Message(arbitration_id=classes, is_error_frame=True, dlc=8, data=data)


# ---------------------------------------------------------------- loss and return


async def test_a_silent_device_is_a_timeout_with_a_reason_and_comes_back_by_itself(
    device: CanDevice, make: Make
) -> None:
    driver = await opened(make())
    await device.fall_silent()
    sample = await until_not_good(driver, CAN_TAGS.level)
    assert (sample.value, sample.quality) == (None, Quality.TIMEOUT)
    assert re.match(r"no frame 0x181 for (0\.[3-9]|[1-9])", sample.reason)
    await device.stop()
    await device.start()
    await read_until_good(driver, CAN_TAGS.level)


async def test_one_message_that_stops_leaves_the_others_good(device: CanDevice, make: Make) -> None:
    driver = await opened(make(timeouts={"0x182": 0.15}))
    del device.frames[(0x182, False)]
    sample = await until_not_good(driver, CAN_TAGS.flag)
    assert sample.quality is Quality.TIMEOUT
    await read_until_good(driver, CAN_TAGS.level)
    assert driver.connected


async def test_silence_opens_the_interface_anew_and_is_told_as_a_dead_peer(device: CanDevice, make: Make) -> None:
    driver = await opened(make(max_silence=0.4))
    await device.fall_silent()
    await until(lambda: driver.statistics()["dead_peers"] > 0)
    assert not driver.connected
    await until(lambda: driver.statistics()["attempts"] > 1)


async def test_an_interface_that_goes_down_is_told_at_once_and_is_joined_again(device: CanDevice, make: Make) -> None:
    driver = await opened(make())
    await device.stop()
    sample = (await driver.read([CAN_TAGS.level]))[0]
    await asyncio.sleep(0.05)
    sample = (await driver.read([CAN_TAGS.level]))[0]
    assert sample.quality is Quality.NOT_CONNECTED
    assert "no CAN hub" in sample.reason or "interface is down" in sample.reason
    await device.start()
    await read_until_good(driver, CAN_TAGS.level)
    assert driver.statistics()["losses"] >= 1


async def test_bus_off_is_told_nothing_is_sent_and_the_restarted_bus_is_used_again(
    device: CanDevice, make: Make
) -> None:
    driver = await opened(make())
    device.put(error_frame(BUS_OFF))
    sample = await until_not_good(driver, CAN_TAGS.level)
    assert sample.quality.is_bad
    assert "bus-off" in sample.reason
    assert driver.statistics()["bus_off"] == 1
    # Opening the interface anew restarts its controller.
    await read_until_good(driver, CAN_TAGS.level)


async def test_a_bus_that_stays_off_is_not_called_connected_and_no_write_goes_out(
    device: CanDevice, make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    off = False

    def opened_off(*arguments: Any, **settings: Any) -> can.BusABC:
        bus = open_bus(*arguments, **settings)
        if off:
            # Off again before it can hear or send anything: an error frame for each time might come too late.
            bus._state = can.BusState.ERROR
        return bus

    monkeypatch.setattr(can_driver, "open_bus", opened_off)
    driver = await opened(make())
    off = True
    device.put(error_frame(BUS_OFF))
    await until_not_good(driver, CAN_TAGS.level)
    device.heard.clear()
    for _ in range(10):
        with pytest.raises(DriverError):
            await driver.write([(CAN_TAGS.mode, 9)])
        assert not (await driver.read([CAN_TAGS.level]))[0].quality.is_good
        await asyncio.sleep(0.02)
    assert [frame for frame in device.heard if not frame.is_error_frame] == []
    off = False
    await read_until_good(driver, CAN_TAGS.level)


async def test_error_frames_are_counted_and_are_no_readings(device: CanDevice, make: Make) -> None:
    driver = await opened(make())
    device.put(error_frame(0x204, bytes((0, 0x11, 0, 0, 0, 0, 128, 9))))
    await until(lambda: driver.statistics()["error_frames"] == 1)
    counted = driver.statistics()
    assert [counted[name] for name in ("overruns", "passive", "transmit_errors", "receive_errors")] == [1, 1, 128, 9]


# ---------------------------------------------------------------- frames


async def test_a_frame_that_cannot_hold_the_value_is_bad_and_says_why(device: CanDevice, make: Make) -> None:
    driver = await opened(make())
    device.frames[(0x182, False)] = b"\x02"
    sample = await until_not_good(driver, CAN_TAGS.flag, late=False)
    assert sample.quality is Quality.DECODING_ERROR
    assert sample.reason == "the frame has 1 bytes, and the value needs 2"


async def test_remote_frames_and_frames_of_the_other_id_length_are_not_taken_for_data(
    device: CanDevice, make: Make
) -> None:
    silent, after = Tag("silent", "0x190:0|16"), Tag("after", "0x191:0|16")
    driver = make(message_timeout=2.0)
    await driver.open()
    await driver.read([silent, after])
    device.put(can.Message(arbitration_id=0x190, is_extended_id=False, is_remote_frame=True, dlc=4))
    device.send(0x190, bytes((9, 9, 9, 0)), extended=True)
    device.frames[0x191, False] = bytes(2)
    await read_until_good(driver, after)
    assert (await driver.read([silent]))[0].quality is Quality.WAITING_FOR_INITIAL_DATA


async def test_the_layouts_of_a_multiplexed_message_keep_their_values_apart(device: CanDevice, make: Make) -> None:
    pages = tuple(Tag(f"page{number}", f"0x190[0|8={number}]:8|8") for number in range(3))
    driver = make(message_timeout=2.0)
    await driver.open()
    await driver.read(pages)
    values: list[object] = [None]
    end = time.monotonic() + 60.0
    while None in values and time.monotonic() < end:
        for number in range(3):
            device.send(0x190, bytes((number, 10 + number)))
        await asyncio.sleep(0.02)
        values = [sample.value for sample in await driver.read(pages)]
    assert values == [10, 11, 12]


async def test_a_tag_that_no_frame_can_hold_is_a_configuration_error_and_its_neighbours_are_read(make: Make) -> None:
    driver = await opened(make())
    wrong = [Tag("a", "holding:1"), Tag("b", "dbc:Motor.Speed"), CAN_TAGS.level]
    samples = await driver.read(wrong)
    assert [sample.quality for sample in samples] == [Quality.CONFIGURATION_ERROR] * 2 + [Quality.GOOD]
    assert all(sample.reason for sample in samples[:2])


async def test_garbage_makes_no_crash_and_no_wrong_good_value(device: CanDevice, make: Make) -> None:
    """Frames of any id and length between the device's own; only a frame that could be the device's may be read."""
    driver = await opened(make())
    rng = random.Random(5)
    for place in range(1500):
        number = rng.choice((0x180, 0x183, 0x281, rng.randrange(0x800)))
        if number in (0x181, 0x182):
            continue
        device.send(number, rng.randbytes(rng.randrange(9)), extended=rng.random() < 0.3)
        if place % 25 == 0:
            await asyncio.sleep(0.001)
            for sample, true in zip(await driver.read(CAN_TAGS.read), (12.5, 7, True), strict=True):
                assert not sample.quality.is_good or sample.value == true
    await until(lambda: driver.statistics()["frames"] > 1400)
    await read_until_good(driver, CAN_TAGS.level)


async def test_only_the_frames_that_are_asked_for_are_passed_on_where_the_interface_filters(
    device: CanDevice, make: Make
) -> None:
    driver = await opened(make(only_mapped=True, write_map=()), (CAN_TAGS.level,))
    before = driver.statistics()
    for _ in range(50):
        device.send(0x555, b"abc")
    await asyncio.sleep(0.1)
    assert driver.statistics()["frames_unmapped"] - before["frames_unmapped"] <= 5
    await read_until_good(driver, CAN_TAGS.flag)


# ---------------------------------------------------------------- writes


async def test_each_frame_of_a_write_is_on_the_wire_once_and_holds_nothing_but_mapped_values(
    device: CanDevice, make: Make
) -> None:
    driver = await opened(make(pad=8), CAN_TAGS.read)
    device.heard.clear()
    await driver.write([(CAN_TAGS.setpoint, -0.01), (CAN_TAGS.mode, 0x1234)])
    await asyncio.sleep(0.1)
    sent = [(one.arbitration_id, one.is_extended_id, bytes(one.data)) for one in device.heard]
    assert sent == [(0x201, False, b"\xff\xff" + bytes(6)), (0x202, True, b"\0\x34\x12" + bytes(5))]
    assert driver.statistics()["sent"] == 2


async def test_a_device_that_does_not_answer_leaves_the_write_unknown_and_it_is_not_sent_again(
    device: CanDevice, make: Make
) -> None:
    driver = await opened(make(timeout=0.3))
    device.heard.clear()
    device.answers = device.stores = False
    del device.frames[(0x282, True)]
    with pytest.raises(ReplyTimeout, match="no echo 0x00000282 of 0x00000202"):
        await driver.write([(CAN_TAGS.mode, 9)])
    await asyncio.sleep(0.3)
    assert len(device.heard) == 1


async def test_an_echo_of_something_else_is_unverified_and_says_what_the_device_holds(
    device: CanDevice, make: Make
) -> None:
    driver = await opened(make(timeout=0.2))
    device.stores = False
    with pytest.raises(WriteUnverified, match="mode was sent as 9, and the device holds 0"):
        await driver.write([(CAN_TAGS.mode, 9)])


async def test_a_frame_that_two_tags_share_is_written_whole_or_not_at_all(device: CanDevice, make: Make) -> None:
    low, high = Tag("low", "0x201:0|8"), Tag("high", "0x201:8|8")
    driver = make(write_map=(low, high))
    await driver.open()
    device.heard.clear()
    with pytest.raises(AddressError, match="is sent whole, and high is in it too"):
        await driver.write([(low, 1)])
    assert device.heard == []
    await driver.write([(high, 2), (low, 1)])
    assert bytes(device.heard[0].data) == b"\1\2"


async def test_nothing_can_be_sent_without_a_write_map(device: CanDevice, make: Make) -> None:
    driver = await opened(make(write_map=()))
    device.heard.clear()
    for tag in (*CAN_TAGS.write_map, CAN_TAGS.level):
        with pytest.raises(WriteForbidden):
            await driver.write([(tag, 1)])
    await driver.write([])
    assert device.heard == []


@pytest.mark.parametrize(
    ("write_map", "echo", "words"),
    [
        ((CAN_TAGS.mode,), {}, "has no echo"),
        ((CAN_TAGS.mode,), {"0x00000202": "0x00000202"}, "is its own echo"),
        ((Tag("a", "0x201:0|16"), Tag("b", "0x201:8|16")), {"0x201": "0x281"}, "belongs to a already"),
        ((Tag("a", "0x201[0|8=1]:4|8"),), {"0x201": "0x281"}, "belongs to the number of the layout"),
        ((Tag("a", "holding:1"),), {}, "is not known here"),
    ],
)
def test_a_write_map_that_cannot_be_written_or_verified_is_refused_at_the_start(
    write_map: tuple[Tag, ...], echo: dict[str, str], words: str
) -> None:
    with pytest.raises(AddressError, match=words):
        open_can({"interface": "hub", "channel": "x", "echo": echo}, clock=time.time, write_map=write_map)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"interface": "nonsense"}, "'nonsense' is not known: known are"),
        ({"timeouts": {"Motor": 1.0}}, "'Motor' is no message"),
        ({"timeouts": {"0x181": "soon"}}, "must be seconds"),
        ({"bitrate": 5}, "at least 10000"),
        ({"port": 502}, "port: there is no such key; known are .*channel"),
    ],
)
def test_a_setting_that_cannot_be_used_is_one_sentence(settings: dict[str, Any], words: str) -> None:
    with pytest.raises(DriverError, match=words):
        open_can({"interface": "hub", "channel": "x", **settings}, clock=time.time)


# ---------------------------------------------------------------- streams and the rest


async def test_a_stream_has_every_frame_as_it_comes_and_tells_of_silence_once(device: CanDevice, make: Make) -> None:
    driver = await opened(make(write_map=(), message_timeout=2.0))
    assert isinstance(driver, Streams)
    received: list[tuple[Value | None, Quality]] = []

    async def listen() -> None:
        async for sample in driver.stream([CAN_TAGS.state]):
            received.append((sample.value, sample.quality))

    task = asyncio.create_task(listen())
    await asyncio.sleep(0.02)
    for number in range(100, 130):
        device.frames[(0x181, False)] = bytes((125, 0, number, 0))
        device.send(0x181, bytes((125, 0, number, 0)))
    await until(lambda: (129, Quality.GOOD) in received)
    assert [value for value, _ in dict.fromkeys(received) if value != 7] == list(range(100, 130))
    del device.frames[(0x181, False)]
    await until(lambda: received[-1][1] is Quality.TIMEOUT)
    await asyncio.sleep(0.3)
    assert [quality for _, quality in received if quality is not Quality.GOOD] == [Quality.TIMEOUT]
    await driver.close()
    await asyncio.wait_for(task, 20.0)


async def test_the_plan_names_messages_timeouts_and_what_may_be_sent(make: Make) -> None:
    driver = make(timeouts={"0x182": 0.5})
    assert isinstance(driver, Explains)
    lines = driver.explain([*CAN_TAGS.read, Tag("odd", "coil:1")])
    assert lines[0].startswith("odd: ")
    assert "0x182, any length, bad after 0.5 s: flag" in lines
    assert "0x201 may be sent, 2 bytes, echo 0x281: setpoint" in lines


async def test_a_bus_without_a_file_descriptor_is_listened_to_by_a_thread(tmp_path: Path) -> None:
    driver = open_can({"interface": "virtual", "channel": str(tmp_path)}, clock=time.time)
    with can.Bus(interface="virtual", channel=str(tmp_path)) as device:
        await driver.open()
        await driver.read([CAN_TAGS.level])
        device.send(can.Message(arbitration_id=0x181, is_extended_id=False, data=bytes((125, 0, 7, 0))))
        assert (await read_until_good(driver, CAN_TAGS.level)).value == 12.5
        await driver.close()
        assert (await driver.read([CAN_TAGS.level]))[0].quality is Quality.NOT_CONNECTED


async def test_open_raises_while_the_interface_is_missing(tmp_path: Path) -> None:
    driver = open_can({"interface": "hub", "channel": str(tmp_path / "none")}, clock=time.time)
    with pytest.raises(LinkDown, match="no CAN hub"):
        await driver.open()
    await driver.close()


async def test_the_sample_of_a_frame_is_stamped_when_it_came_and_ages_no_further(device: CanDevice, make: Make) -> None:
    began = time.time()
    driver = await opened(make())
    sample = await read_until_good(driver, CAN_TAGS.level)
    assert sample.sent is None
    assert began <= sample.time <= time.time()


def _socketcan(name: str) -> str:
    """Why there is no such interface, "" where there is one."""
    try:
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as probe:
            probe.bind((name,))
    except OSError as error:
        return f"no socketcan interface {name} here: {error.strerror}"
    return ""


@pytest.mark.socketcan
async def test_a_kernel_bus_gives_readings_and_takes_verified_writes() -> None:
    """On a machine with `ip link add dev vcan0 type vcan && ip link set up vcan0`."""
    if reason := _socketcan("vcan0"):
        pytest.skip(reason)
    tags = CAN_TAGS.read
    settings = {"interface": "socketcan", "channel": "vcan0", "echo": ECHO}
    driver = open_can(settings, clock=time.time, write_map=CAN_TAGS.write_map)
    with can.Bus(interface="socketcan", channel="vcan0") as device:
        await driver.open()
        await driver.read(tags)
        device.send(can.Message(arbitration_id=0x181, is_extended_id=False, data=bytes((125, 0, 7, 0))))
        device.send(can.Message(arbitration_id=0x182, is_extended_id=False, data=bytes((0, 2))))
        assert [(await read_until_good(driver, tag)).value for tag in tags] == [12.5, 7, True]
        writing = asyncio.create_task(driver.write([(CAN_TAGS.mode, 9)]))
        command = await asyncio.to_thread(device.recv, 2.0)
        assert command is not None
        assert (command.arbitration_id, bytes(command.data)) == (0x202, b"\0\x09\0")
        device.send(can.Message(arbitration_id=0x282, is_extended_id=True, data=command.data))
        await writing
        await driver.close()
