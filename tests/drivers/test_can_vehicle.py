"""OBD-II and J1939 tags on a live bus: listening, asking where it is configured, ageing, and never sending else."""

import asyncio
import random
import time
from collections.abc import AsyncIterator, Callable, Sequence
from typing import Any
from uuid import uuid4

import can
import pytest
from can.interfaces.virtual import VirtualBus

from drivers.driver import Driver, open_driver
from drivers.errors import DriverError
from drivers.tag import DType, Quality, Tag
from tests.drivers.can_frames import bam, isotp
from tests.drivers.conftest import read_until_good

SPEED = Tag("speed", "obd:0C", unit="rpm")
VIN = Tag("vin", "obd:vin", DType.STRING)
GEARBOX = Tag("gearbox", "obd:05@7E9")
ENGINE = Tag("engine", "spn:190")
CODES = Tag("codes", "dm1:codes", DType.STRING)
PLAIN = Tag("plain", "0x181:0|16")


class Car:
    """A unit on a virtual bus: it sends what it is told, notes all that it hears, and may answer requests."""

    def __init__(self, channel: str) -> None:
        self.bus = can.Bus(channel, "virtual", ignore_config=True)
        self.heard: list[can.Message] = []
        self.answers: Callable[[can.Message], Sequence[tuple[int, bytes]]] = lambda _: ()
        self._task = asyncio.create_task(self._listen())

    def send(self, identifier: int, *frames: bytes) -> None:
        for data in frames:
            self.bus.send(can.Message(arbitration_id=identifier, is_extended_id=identifier > 0x7FF, data=data))

    async def _listen(self) -> None:
        while True:
            while (message := self.bus.recv(0.0)) is not None:
                self.heard.append(message)
                for identifier, data in self.answers(message):
                    self.send(identifier, data)
            await asyncio.sleep(0.002)

    async def close(self) -> None:
        self._task.cancel()
        await asyncio.wait({self._task})
        self.bus.shutdown()


Opened = Callable[..., Any]


@pytest.fixture
async def car() -> AsyncIterator[tuple[Car, Opened]]:
    channel = f"car {uuid4()}"
    made, drivers = Car(channel), []

    async def opened(**settings: Any) -> Driver:
        driver = open_driver("can", {"interface": "virtual", "channel": channel, **settings}, clock=time.time)
        drivers.append(driver)
        await driver.open()
        return driver

    yield made, opened
    for driver in drivers:
        await driver.close()
    await made.close()


async def test_answers_to_others_requests_and_broadcasts_are_read_beside_plain_fields(car: tuple[Car, Opened]) -> None:
    unit, opened = car
    driver = await opened()
    await driver.read([SPEED, VIN, ENGINE, CODES, PLAIN])
    unit.send(0x7E8, isotp(b"\x41\x0c\x1a\xf8")[0], *isotp(b"\x49\x02\x01" + b"V" * 17))
    unit.send(0x0CF00400, b"\xff\xff\xff\x40\x1f\xff\xff\xff")
    for identifier, data in bam(bytes.fromhex("0400 6E000305 64000101"), 0xFECA):
        unit.send(identifier, data)
    unit.send(0x181, b"\x34\x12")
    values = [(await read_until_good(driver, tag)).value for tag in (SPEED, VIN, ENGINE, CODES, PLAIN)]
    assert values == [1726.0, "V" * 17, 1000.0, "SPN 110 FMI 3 OC 5; SPN 100 FMI 1 OC 1", 0x1234]
    assert driver.connected
    assert unit.heard == []


async def test_a_value_that_is_not_told_again_is_bad_after_its_timeout(car: tuple[Car, Opened]) -> None:
    unit, opened = car
    driver = await opened(answer_timeout=30.0, answer_timeouts={"speed": 1.0})
    assert (await driver.read([SPEED]))[0].quality is Quality.WAITING_FOR_INITIAL_DATA
    async with asyncio.timeout(60.0):
        while True:
            # On a busy machine it may be too old before anybody reads it, and the bus be opened anew for its silence.
            began = time.time()
            unit.send(0x7E8, isotp(b"\x41\x0c\x1a\xf8")[0])
            await asyncio.sleep(0.05)
            (before,) = await driver.read([SPEED])
            read = time.time()
            await asyncio.sleep(1.1)
            (after,) = await driver.read([SPEED])
            if before.quality.is_good and after.quality is not Quality.WAITING_FOR_INITIAL_DATA:
                break
    assert before.sent is None
    assert began <= before.time <= read
    assert (after.value, after.quality) == (None, Quality.TIMEOUT)
    assert "obd:0C" in after.reason


async def test_without_poll_nothing_is_ever_sent(car: tuple[Car, Opened]) -> None:
    unit, opened = car
    driver = await opened(poll_period=0.02)
    for _ in range(10):
        await driver.read([SPEED, VIN])
        await asyncio.sleep(0.02)
    assert unit.heard == []


async def test_with_poll_the_parameters_are_asked_for_and_a_long_answer_is_let_through(
    car: tuple[Car, Opened],
) -> None:
    unit, opened = car
    vin = isotp(b"\x49\x02\x01" + b"V" * 17)

    def answer(message: can.Message) -> Sequence[tuple[int, bytes]]:
        match message.arbitration_id, bytes(message.data[:3]):
            case 0x7E0, b"\x02\x01\x0c":
                return [(0x7E8, isotp(b"\x41\x0c\x1a\xf8")[0])]
            case 0x7E0, b"\x02\x09\x02":
                return [(0x7E8, vin[0])]
            case 0x7E0, b"\x30\x00\x00":
                return [(0x7E8, data) for data in vin[1:]]
            case 0x7E1, b"\x02\x01\x05":
                return [(0x7E9, b"\x03\x7f\x01\x12".ljust(8, b"\0"))]
        return ()

    unit.answers = answer
    driver = await opened(poll=True, poll_period=0.05, poll_timeout=0.5)
    await driver.read([SPEED, VIN, GEARBOX])
    assert (await read_until_good(driver, SPEED)).value == 1726.0
    assert (await read_until_good(driver, VIN)).value == "V" * 17
    assert {(m.arbitration_id, bytes(m.data[:3])) for m in unit.heard} <= {
        (0x7E0, b"\x02\x01\x0c"), (0x7E0, b"\x02\x09\x02"), (0x7E0, b"\x30\x00\x00"), (0x7E1, b"\x02\x01\x05"),
    }  # fmt: skip
    assert all(len(m.data) == 8 for m in unit.heard)
    assert driver.statistics()["polls"] > 0


async def test_a_unit_that_does_not_answer_holds_up_no_other_for_longer_than_the_timeout(
    car: tuple[Car, Opened],
) -> None:
    unit, opened = car
    unit.answers = lambda m: [(0x7E8, isotp(b"\x41\x0c\x1a\xf8")[0])] if m.arbitration_id == 0x7E0 else ()
    driver = await opened(poll=True, poll_period=0.02, poll_timeout=0.02)
    await driver.read([GEARBOX, SPEED])
    assert (await read_until_good(driver, SPEED)).value == 1726.0
    while driver.statistics()["polls_unanswered"] < 3:
        await asyncio.sleep(0.01)


async def test_asking_goes_on_after_the_bus_has_taken_no_frame_for_a_while(
    car: tuple[Car, Opened], monkeypatch: pytest.MonkeyPatch
) -> None:
    unit, opened = car
    unit.answers = lambda _: [(0x7E8, isotp(b"\x41\x0c\x1a\xf8")[0])]
    monkeypatch.setattr("drivers.vehicle.live._RETRY_S", 0.02)
    send, refused = VirtualBus.send, []

    def full(bus: VirtualBus, message: can.Message, timeout: float | None = None) -> None:
        if message.arbitration_id == 0x7E0 and len(refused) < 3:
            refused.append(message)
            raise can.CanOperationError("the queue is full")
        send(bus, message, timeout)

    monkeypatch.setattr(VirtualBus, "send", full)
    driver = await opened(poll=True, poll_period=0.02, poll_timeout=0.02)
    await driver.read([SPEED])
    assert (await read_until_good(driver, SPEED)).value == 1726.0
    assert len(refused) == 3


async def test_after_close_nothing_more_is_asked(car: tuple[Car, Opened]) -> None:
    unit, opened = car
    driver = await opened(poll=True, poll_period=0.02, poll_timeout=0.01)
    await driver.read([SPEED])
    while not unit.heard:
        await asyncio.sleep(0.01)
    await driver.close()
    await asyncio.sleep(0.05)
    count = len(unit.heard)
    await asyncio.sleep(0.1)
    assert len(unit.heard) == count


async def test_ten_thousand_random_frames_give_no_good_value_and_no_failure(car: tuple[Car, Opened]) -> None:
    unit, opened = car
    driver = await opened()
    tags = [Tag("speed", "obd:0C@7EA"), ENGINE, Tag("coolant", "spn:110")]
    await driver.read(tags)
    noise = random.Random(5)
    for number in range(10_000):
        # Everywhere but where the tags are told: no frame of these can be a value.
        identifier = noise.choice([0x7DF, 0x7E0, 0x7E8, 0x1CECFF01, 0x1CEBFF01, 0x18DAF110, noise.randrange(0x700)])
        unit.send(identifier, noise.randbytes(noise.randrange(9)))
        if number % 500 == 0:
            await asyncio.sleep(0.01)
    while driver.statistics()["frames"] + driver.statistics()["dropped"] < 10_000:
        await asyncio.sleep(0.01)
    assert not [sample for sample in await driver.read(tags) if sample.quality.is_good]


async def test_it_explains_what_it_listens_for_and_what_it_asks(car: tuple[Car, Opened]) -> None:
    _, opened = car
    driver = await opened(poll=True, poll_period=2.0)
    assert driver.explain([SPEED, ENGINE]) == (
        "obd:0C, bad after 10 s: speed",
        "spn:190, bad after 10 s: engine",
        "0x7E0 is asked every 2 s: 02 01 0c",
    )


async def test_an_address_that_means_nothing_is_said_of_that_tag_alone(car: tuple[Car, Opened]) -> None:
    _, opened = car
    driver = await opened()
    bad, good = await driver.read([Tag("bad", "obd:zz"), SPEED])
    assert bad.quality is Quality.CONFIGURATION_ERROR
    assert "bad: 'zz' is neither a parameter" in bad.reason
    assert good.quality is Quality.WAITING_FOR_INITIAL_DATA


async def test_a_setting_that_cannot_be_is_refused(car: tuple[Car, Opened]) -> None:
    with pytest.raises(DriverError, match="poll: must be true or false"):
        open_driver("can", {"interface": "virtual", "channel": "x", "poll": "yes"}, clock=time.time)
