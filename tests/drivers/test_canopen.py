"""The CANopen driver on a hub, against a node of the canopen library; what it sends is heard by a third on the bus."""

import asyncio
import random
import re
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import can
import pytest

from drivers.can.bus.hub import Hub
from drivers.can.bus.hub_bus import HubBus
from drivers.canopen.driver import CanopenDriver, open_canopen
from drivers.canopen.options import read_options
from drivers.errors import AddressError, DriverError, LinkDown, WriteForbidden, WriteUnverified
from drivers.tag import DType, Quality, Sample, Tag
from tests.drivers.bench_canopen import TAGS
from tests.drivers.conftest import read_until_good
from tests.drivers.scripted_node import HEARTBEAT, NODE, ScriptedNode, eds

Open = Callable[..., Awaitable[CanopenDriver]]
TPDO, EMCY, BEAT = 0x180 + NODE, 0x080 + NODE, 0x700 + NODE
HELD = bytes([125, 0, 7, 0, 2])


@pytest.fixture
def bus(tmp_path: Path) -> Any:
    with Hub(tmp_path / "bus"):
        yield tmp_path / "bus"


@pytest.fixture
def node(bus: Path) -> Any:
    scripted = ScriptedNode(bus, {1: 125, 2: 7, 3: 2})
    scripted.start()
    yield scripted
    scripted.stop()


@pytest.fixture
async def opened(bus: Path, tmp_path: Path) -> AsyncIterator[Open]:
    """Open drivers on the node; they are closed at the end."""
    drivers: list[CanopenDriver] = []
    (tmp_path / "node.eds").write_text(eds(), encoding="utf-8")

    async def open_(write_map: Sequence[Tag] = (), *, wait: bool = True, **settings: Any) -> CanopenDriver:
        fixed = {"interface": "hub", "channel": str(bus), "node": NODE, "heartbeat_timeout": 0.2}
        fixed["connect_timeout"] = 20.0  # a busy machine brings a node up late; tests of the deadline give their own
        merged = {**fixed, "eds": str(tmp_path / "node.eds"), **settings}
        driver = open_canopen(merged, clock=time.time, write_map=write_map)
        drivers.append(driver)
        if wait:
            await driver.open()
        return driver

    yield open_
    for driver in drivers:
        await driver.close()


@pytest.fixture
def heard(bus: Path) -> Any:
    """A third on the bus: every data frame that anybody sends."""
    listener = HubBus(str(bus))
    yield listener
    listener.shutdown()


def frames(listener: HubBus) -> list[can.Message]:
    found = []
    while (message := listener.recv(0.0)) is not None:
        found.append(message)
    return found


async def level(driver: CanopenDriver) -> Sample:
    return (await driver.read([TAGS.level]))[0]


async def level_until(driver: CanopenDriver, true: Callable[[Sample], bool], within: float = 60.0) -> Sample:
    end = time.monotonic() + within
    while not true(sample := await level(driver)):
        assert time.monotonic() < end, sample
        await asyncio.sleep(0.002)
    return sample


# ---------------------------------------------------------------- what is sent


async def test_who_only_listens_sends_not_one_frame(node: ScriptedNode, opened: Open, heard: HubBus) -> None:
    driver = await opened(TAGS.write_map, listen_only=True)
    assert (await level_until(driver, lambda sample: sample.quality.is_good)).value == 12.5
    (asked,) = await driver.read([TAGS.setpoint])
    assert asked.quality is Quality.CONFIGURATION_ERROR
    assert "listen_only" in asked.reason
    with pytest.raises(WriteForbidden, match="listen_only"):
        await driver.write([(TAGS.mode, 1)])
    assert {message.arbitration_id for message in frames(heard)} <= {TPDO, BEAT}


async def test_without_configure_only_sdo_reads_are_sent(node: ScriptedNode, opened: Open, heard: HubBus) -> None:
    driver = await opened(sync_period=0.01)
    await read_until_good(driver, TAGS.setpoint)
    ours = [message for message in frames(heard) if message.arbitration_id in (0x000, 0x080, 0x600 + NODE)]
    assert {message.arbitration_id for message in ours} == {0x600 + NODE}
    assert {message.data[0] >> 5 for message in ours} <= {2, 3}, "upload requests and their segments"


async def test_a_node_that_beats_and_answers_nothing_is_not_called_unheard(bus: Path, opened: Open) -> None:
    driver = await opened(wait=False, connect_timeout=0.3)
    mute = HubBus(str(bus))
    beats = mute.send_periodic(can.Message(arbitration_id=BEAT, data=[127], is_extended_id=False), 0.02)
    sentence, deadline = "has not been heard yet", time.monotonic() + 60.0
    # On a busy machine the first beat may come later than `connect_timeout`.
    while "has not been heard yet" in sentence and time.monotonic() < deadline:
        with pytest.raises(LinkDown) as caught:
            await driver.open()
        sentence = str(caught.value)
    beats.stop()
    mute.shutdown()
    assert re.search(f"node {NODE} (is pre-operational|cannot be brought up)", sentence)


async def test_configure_starts_the_node_and_sends_sync(node: ScriptedNode, opened: Open, heard: HubBus) -> None:
    changed = [{"number": 1, "event_timer": 0.04, "inhibit": 0.001}]
    driver = await opened(configure=True, sync_period=0.01, heartbeat_time=0.04, tpdo=changed)
    await read_until_good(driver, TAGS.level)
    assert node.value(0x1800, 5) == 40
    assert node.value(0x1800, 3) == 10
    sent: list[tuple[int, bytes]] = []
    async with asyncio.timeout(60.0):
        while sum(number == 0x080 for number, _ in sent) < 3:
            await asyncio.sleep(0.01)
            sent += [(message.arbitration_id, bytes(message.data)) for message in frames(heard)]
    assert (0x000, bytes([128, NODE])) in sent, "pre-operational while it is configured"
    assert (0x000, bytes([1, NODE])) in sent, "start"
    writes = {data[1:3] for number, data in sent if number == 0x600 + NODE and data[0] >> 5 == 1}
    assert writes <= {b"\x00\x18", b"\x17\x10"}, "what did not differ was not written"


async def test_a_write_outside_the_map_sends_nothing(node: ScriptedNode, opened: Open, heard: HubBus) -> None:
    driver = await opened([TAGS.mode], configure=True)
    await read_until_good(driver, TAGS.level)
    frames(heard)
    with pytest.raises(WriteForbidden):
        await driver.write([(TAGS.setpoint, 1.0), (TAGS.mode, 2)])
    assert {message.arbitration_id for message in frames(heard)} <= {TPDO, BEAT, 0x080}


async def test_an_rpdo_that_carries_more_than_the_map_is_not_used(
    node: ScriptedNode, opened: Open, heard: HubBus
) -> None:
    driver = await opened([TAGS.mode])
    await driver.write([(TAGS.mode, 9)])
    assert node.value(0x2100, 2) == 9
    assert 0x200 + NODE not in {message.arbitration_id for message in frames(heard)}
    driver = await opened(TAGS.write_map)
    await driver.write([(TAGS.setpoint, -1.0), (TAGS.mode, 8)])
    assert (node.value(0x2100, 1), node.value(0x2100, 2)) == (-100, 8)
    sent = [bytes(message.data) for message in frames(heard) if message.arbitration_id == 0x200 + NODE]
    assert sent == [b"\x9c\xff\x08\x00"], "one frame, once"


async def test_an_acknowledge_that_does_not_come_leaves_a_write_unverified(node: ScriptedNode, opened: Open) -> None:
    driver = await opened(TAGS.write_map, acknowledge={"0x2100:2": "0x2001:2"}, timeout=0.1)
    await level_until(driver, lambda sample: sample.sent is None)
    with pytest.raises(WriteUnverified, match="0x2001:2 has not acknowledged"):
        await driver.write([(TAGS.setpoint, 0.0), (TAGS.mode, 8)])

    async def answer() -> None:
        await asyncio.sleep(0.02)
        node.say(TPDO, bytes([125, 0, 9, 0, 2]))

    answering = asyncio.create_task(answer())
    await driver.write([(TAGS.setpoint, 0.0), (TAGS.mode, 9)])
    await answering


# ---------------------------------------------------------------- what comes


async def test_a_tpdo_is_stamped_when_it_comes_and_streamed_at_once(node: ScriptedNode, opened: Open) -> None:
    driver = await opened()
    stream = driver.stream([TAGS.level, TAGS.setpoint])
    begun = time.time()
    samples = [await anext(stream)]
    assert (samples[0].tag, samples[0].value, samples[0].sent) == ("level", 12.5, None)
    assert begun - HEARTBEAT <= samples[0].time <= time.time()
    # Frames that a busy machine held up come together. Were one told twice, no two steps in a row would be whole ones.
    async with asyncio.timeout(60.0):
        while len(samples) < 3 or any(b.time - a.time <= 0.3 * HEARTBEAT for a, b in pairwise(samples[-3:])):
            samples.append(await anext(stream))
            assert samples[-2].time <= samples[-1].time <= time.time()


async def test_a_stream_says_once_that_the_node_has_gone(node: ScriptedNode, opened: Open) -> None:
    driver = await opened()
    told: list[Sample] = []

    async def listen() -> None:
        async for sample in driver.stream([TAGS.level]):
            told.append(sample)

    listening = asyncio.create_task(listen())
    await level_until(driver, lambda _: any(sample.quality.is_good for sample in told))
    await asyncio.to_thread(node.stop)
    async with asyncio.timeout(60.0):
        while not told or told[-1].quality is not Quality.NO_COMMUNICATION:
            await asyncio.sleep(0.01)
    await asyncio.sleep(0.5)
    listening.cancel()
    # After the last good one: on a busy machine the node may have been late, or gone, for a moment before.
    last_good = max(place for place, sample in enumerate(told) if sample.quality.is_good)
    bad = told[last_good + 1 :]
    assert [sample.quality for sample in bad] in (
        [Quality.TIMEOUT, Quality.NO_COMMUNICATION],
        [Quality.NO_COMMUNICATION],
    )
    assert all(sample.value is None and sample.reason for sample in bad)
    assert told[-1] is bad[-1]


@pytest.mark.parametrize("data", [HELD[:4], HELD + b"\0", b""])
async def test_a_tpdo_of_another_length_makes_its_tags_bad_until_a_right_one_comes(
    node: ScriptedNode, opened: Open, data: bytes
) -> None:
    driver = await opened()
    await level_until(driver, lambda sample: sample.sent is None)

    def bad_one(sample: Sample) -> bool:
        """Said anew each time: the next right one may follow before anybody looks."""
        if sample.quality is not Quality.COMMUNICATION_ERROR:
            node.say(TPDO, data)
        return sample.quality is Quality.COMMUNICATION_ERROR

    bad = await level_until(driver, bad_one)
    assert f"came with {len(data)} bytes, and 5 are mapped" in bad.reason
    assert bad.value is None
    await level_until(driver, lambda sample: sample.quality.is_good)
    assert driver.statistics()["malformed_pdos"] >= 1


async def test_a_tpdo_that_stays_away_is_late_while_the_node_lives(node: ScriptedNode, opened: Open) -> None:
    driver = await opened()
    await level_until(driver, lambda sample: sample.sent is None)
    assert node.node is not None
    node.node.tpdo.stop()
    late = await level_until(driver, lambda sample: sample.quality is Quality.TIMEOUT)
    assert "silent" in late.reason
    await level_until(driver, lambda _: driver.connected)


async def test_an_emergency_takes_the_readings_quality_and_its_end_gives_it_back(
    node: ScriptedNode, opened: Open
) -> None:
    driver = await opened()
    await level_until(driver, lambda sample: sample.quality.is_good)
    node.say(EMCY, bytes.fromhex("1081 01 0000000000"))
    doubtful = await level_until(driver, lambda sample: sample.quality is Quality.UNCERTAIN)
    assert doubtful.value == 12.5
    assert "EMCY 0x8110 (monitoring)" in doubtful.reason
    assert driver.complaints() == ("EMCY 0x8110 (monitoring), error register 0x01",)
    node.say(EMCY, bytes.fromhex("0050 01 0000000000"))
    failed = await level_until(driver, lambda sample: sample.quality is Quality.DEVICE_FAILURE)
    assert failed.value is None
    node.say(EMCY, bytes(8))
    await level_until(driver, lambda sample: sample.quality.is_good)
    assert driver.complaints() == ()


async def test_an_emergency_whose_end_was_missed_ends_with_the_error_register(node: ScriptedNode, opened: Open) -> None:
    driver = await opened()
    node.say(EMCY, bytes.fromhex("1081 01 0000000000"))
    await level_until(driver, lambda sample: not sample.quality.is_good)
    await level_until(driver, lambda sample: sample.quality.is_good)


async def test_an_ignored_emergency_is_told_and_changes_no_quality(node: ScriptedNode, opened: Open) -> None:
    driver = await opened(emcy_ignore=[0x8110])
    await level_until(driver, lambda sample: sample.quality.is_good)
    node.say(EMCY, bytes.fromhex("1081 01 0000000000"))
    await level_until(driver, lambda _: bool(driver.complaints()))
    # Late it may be on a busy machine, and nothing else.
    late = (Quality.TIMEOUT, Quality.NO_COMMUNICATION)
    assert (await level_until(driver, lambda sample: sample.quality not in late)).quality.is_good


async def test_a_boot_up_forgets_everything_and_brings_the_node_up_anew(node: ScriptedNode, opened: Open) -> None:
    driver = await opened(configure=True, heartbeat_time=0.05)
    await level_until(driver, lambda sample: sample.quality.is_good)
    before = driver.statistics()
    node.say(BEAT, b"\0")
    await level_until(driver, lambda sample: not sample.quality.is_good)
    await level_until(driver, lambda _: driver.statistics()["starts"] > before["starts"])
    await level_until(driver, lambda sample: sample.quality.is_good)
    after = driver.statistics()
    # Once, and once more for each time that a busy machine held up its heartbeat for too long.
    assert after["starts"] <= before["starts"] + 1 + after["node_losses"] - before["node_losses"]


async def test_the_bus_goes_and_comes_back(bus: Path, opened: Open, tmp_path: Path) -> None:
    other = tmp_path / "other"
    with Hub(other):
        node = ScriptedNode(other, {1: 125, 2: 7, 3: 2})
        node.start()
        driver = await opened(channel=str(other))
        await level_until(driver, lambda sample: sample.quality.is_good)
        node.stop()
    gone = await level_until(driver, lambda sample: sample.quality is Quality.NOT_CONNECTED)
    assert gone.reason
    with Hub(other):
        node.start()
        await level_until(driver, lambda sample: sample.quality.is_good)
        node.stop()
        await driver.close()


async def test_another_device_than_that_of_the_eds_is_not_read(bus: Path, opened: Open) -> None:
    node = ScriptedNode(bus, {1: 125, 2: 7, 3: 2}, vendor=0x9999)
    node.start()
    try:
        driver = await opened(wait=False, connect_timeout=1.0)
        sentence, deadline = "", time.monotonic() + 120.0
        # On a busy machine the first answers may come later than `connect_timeout`; the driver goes on trying.
        while "another device" not in sentence and time.monotonic() < deadline:
            with pytest.raises(LinkDown) as caught:
                await driver.open()
            sentence = str(caught.value)
        assert re.search(r"another device: vendor 0x00009999, and .* is of 0x00001234", sentence)
        assert not any(sample.quality.is_good for sample in await driver.read(TAGS.read))
    finally:
        node.stop()


async def test_garbage_neither_stops_the_driver_nor_makes_a_wrong_value_good(node: ScriptedNode, opened: Open) -> None:
    """Every identifier, length and kind of frame; the node's own TPDO only in lengths that it does not have."""
    driver = await opened()
    rng = random.Random(7)
    talker = HubBus(str(node.path))
    for number in range(3000):
        identifier = rng.choice([TPDO, EMCY, BEAT, 0x580 + NODE, 0, 0x80, rng.randrange(0x800)])
        size = rng.randrange(9)
        if (identifier == TPDO and size == len(HELD)) or identifier == 0 or identifier in (0x200 + NODE, 0x600 + NODE):
            continue
        extended = rng.random() < 0.1
        remote = rng.random() < 0.05
        data = None if remote else rng.randbytes(size)
        talker.send(can.Message(arbitration_id=identifier, is_extended_id=extended, is_remote_frame=remote, data=data))
        if number % 10 == 0:
            for sample in await driver.read([*TAGS.read, TAGS.setpoint]):
                if sample.quality.is_good:
                    assert sample.value == {"level": 12.5, "state": 7, "flag": True, "setpoint": 0.0}[sample.tag]
            await asyncio.sleep(0)
    talker.shutdown()
    await level_until(driver, lambda sample: sample.quality.is_good)


# ---------------------------------------------------------------- what cannot be used


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"node": 0}, "node: must be at least 1, got 0; give a node id from 1 to 127"),
        ({"nod": 1}, "nod: there is no such key; did you mean 'node'"),
        ({"configure": True, "listen_only": True}, "exclude each other"),
        ({"eds": None, "listen_only": True}, "listen_only needs eds"),
        ({"eds": "/nowhere.eds"}, "cannot be read"),
        ({"life": {"object": "2002"}}, "life"),
        ({"life": {"object": "x", "rate": 5}}, "'x' is no object"),
        ({"acknowledge": {"0x2100:1": 5}}, "is no object"),
        ({"emcy_ignore": ["all"]}, "emcy_ignore"),
        ({"tpdo": [{"number": 9}]}, "a number, one of 1"),
        ({"tpdo": [{"number": 1, "event_timer": -1}]}, "event_timer must be seconds"),
        ({"tpdo": [{"number": 1, "colour": 1}]}, "unknown key 'colour'"),
        ({"tpdo": [{"number": 1, "map": ["0x2001:4"]}]}, "cannot be mapped"),
        ({"tpdo": [{"number": 1, "map": ["0x2001:1"] * 5}]}, "80 bits are mapped"),
    ],
)
async def test_a_setting_that_cannot_be_used_is_one_sentence(
    opened: Open, settings: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(DriverError, match=sentence) as caught:
        await opened(wait=False, **settings)
    assert "\n" not in str(caught.value)


async def test_an_eds_that_is_none_is_refused_with_its_name(opened: Open, tmp_path: Path) -> None:
    for text in ("", "nonsense", "[2001]\nParameterName=x\n"):
        (tmp_path / "bad.eds").write_text(text, encoding="utf-8")
        with pytest.raises(DriverError, match=r"bad\.eds"):
            await opened(wait=False, eds=str(tmp_path / "bad.eds"))


@pytest.mark.parametrize(
    ("tag", "reason"),
    [
        (Tag("far", "0x7777:1"), "not in the EDS"),
        (Tag("registers", "holding:1"), "is no object"),
        (Tag("wide", "0x2001:1", DType.FLOAT32), "has 2 bytes, and a float32 has 4"),
        (Tag("swapped", "0x2001:1", order="CDAB"), "one byte order"),  # type: ignore[arg-type]
    ],
)
async def test_a_tag_that_lies_nowhere_is_a_configuration_error_and_the_others_go_on(
    node: ScriptedNode, opened: Open, tag: Tag, reason: str
) -> None:
    driver = await opened()
    bad, good = await driver.read([tag, TAGS.level])
    assert bad.quality is Quality.CONFIGURATION_ERROR
    assert reason in bad.reason
    assert good.quality.is_good
    assert any(reason in line for line in driver.explain([tag]))


async def test_the_write_map_needs_objects_that_can_be_written(opened: Open) -> None:
    for tag, reason in ((TAGS.level, "read-only"), (Tag("far", "0x7777:1"), "not in the EDS")):
        with pytest.raises(AddressError, match=reason):
            await opened([tag], wait=False)


async def test_the_plan_says_which_tpdo_brings_what(opened: Open) -> None:
    driver = await opened(wait=False)
    assert driver.explain([*TAGS.read, TAGS.mode]) == (
        "TPDO 1 (0x185), late after 0.15 s: level, state, flag",
        "by SDO, worst case 0.3 s a cycle: mode",
    )


async def test_another_node_than_the_pinned_one_is_not_read_and_not_written(bus: Path, opened: Open) -> None:
    node = ScriptedNode(bus, {1: 125, 2: 7, 3: 2})
    node.start()
    try:
        driver = await opened(wait=False, connect_timeout=1.0, identity={"serial": 0x1268, "product": 0x77})
        sentence, deadline = "", time.monotonic() + 120.0
        while "another device" not in sentence and time.monotonic() < deadline:
            with pytest.raises(LinkDown) as caught:
                await driver.open()
            sentence = str(caught.value)
        assert re.search(r"of its serial .* it says 0x00001267, and 0x00001268 is pinned", sentence)
        assert not any(sample.quality.is_good for sample in await driver.read(TAGS.read))
        own = await opened(identity={"serial": 0x1267, "product": 0x77})
        await level_until(own, lambda sample: sample.quality.is_good)
    finally:
        node.stop()


@pytest.mark.parametrize("given", [{}, {"colour": 1}, {"serial": -1}, {"serial": "4711"}, 3])
def test_an_identity_that_no_node_has_is_refused(given: object) -> None:
    with pytest.raises(DriverError, match="identity"):
        read_options({"channel": "can0", "node": 1, "identity": given})
