"""After a pause of the gateway a live bus was declared dead, and what waited on it was thrown away.

More frames had come than are taken in one turn of the loop: what was heard last was as old as the pause. And where the
system has no place for all of them the oldest are left, so that nothing newer is to be had at once.
"""

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path

import can
import pytest

from drivers.can import driver as can_driver
from drivers.can.bus import arrival
from drivers.can.driver import CanDriver, open_can
from drivers.canopen import driver as canopen_driver
from drivers.canopen.driver import CanopenDriver, open_canopen
from drivers.tag import Quality, Tag
from tests.cases.a_backlog_was_read_as_now.buses import QueuedBus, frame
from tests.drivers.scripted_node import NODE, eds

SPEED, LEVEL = Tag("speed", "0x181:0|16"), Tag("level", "0x2001:1")
BACKLOG = 2000
LIMIT_S = 2.0
PAUSE_S = 30.0


class Clock:
    """The wall clock and the monotonic one, as the test sets them."""

    def __init__(self) -> None:
        self.now = 500.0

    def time(self) -> float:
        return 1e9 + self.now

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
async def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """The drivers' clocks and the loop's, so that after a pause all that is due is due in one turn."""
    made = Clock()
    monkeypatch.setattr(arrival, "time", made)
    monkeypatch.setattr(arrival, "_stamps", lambda bus: True)
    monkeypatch.setattr(can_driver, "time", made)
    monkeypatch.setattr(asyncio.get_running_loop(), "time", made.monotonic)
    return made


def say(bus: QueuedBus, frames: list[can.Message], first: float, last: float) -> None:
    """Have frames wait that came evenly between two moments of the wall clock."""
    for number, message in enumerate(frames):
        message.timestamp = first + (last - first) * (number + 1) / len(frames)
    bus.say(*frames)


async def turns(number: int = 100) -> None:
    """Let the loop turn so often."""
    for _ in range(number):
        await asyncio.sleep(0)


async def taken(bus: QueuedBus) -> None:
    """Let the loop turn until nothing waits on the bus any more, and a while longer."""
    for _ in range(BACKLOG):
        if not bus.waiting:
            break
        await turns(1)
    await turns()


async def fall_behind(clock: Clock, bus: QueuedBus, message: Callable[[], can.Message]) -> None:
    """For twenty seconds, let more come in each than a loop takes that turns four times in it."""
    for _ in range(20):
        clock.now += 1.0
        say(bus, [message() for _ in range(1500)], clock.time() - 1.0, clock.time())
        await turns(4)


async def seconds_until(done: Callable[[], bool], clock: Clock, step: float) -> float:
    """Until then, where the loop turns once in `step` seconds."""
    begun = clock.now
    for _ in range(10_000):
        if done():
            return clock.now - begun
        clock.now += step
        await turns(5)
    raise AssertionError("it did not come")


# ---------------------------------------------------------------- raw CAN


Raw = tuple[CanDriver, QueuedBus]
Node = tuple[CanopenDriver, QueuedBus]


@pytest.fixture
async def raw(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Raw]:
    """A driver that has read one frame, and its first bus."""
    buses: list[QueuedBus] = []

    def opening(*_: object, **__: object) -> QueuedBus:
        buses.append(QueuedBus())
        return buses[-1]

    monkeypatch.setattr(can_driver, "open_bus", opening)
    settings = {"interface": "virtual", "channel": "queued", "message_timeout": LIMIT_S, "max_silence": LIMIT_S}
    driver = open_can({**settings, "connect_timeout": 60.0}, clock=time.time)
    await driver.open()
    await driver.read([SPEED])
    say(buses[0], [frame(0x181, 1)], clock.time(), clock.time())
    assert (await driver.read([SPEED]))[0].value == 1
    yield driver, buses[0]
    await driver.close()


async def test_what_waits_after_a_pause_is_heard_before_a_bus_is_called_dead(clock: Clock, raw: Raw) -> None:
    driver, bus = raw
    paused = clock.time()
    clock.now += PAUSE_S
    say(bus, [frame(0x181, value) for value in range(BACKLOG)], paused, clock.time())
    await taken(bus)
    assert (driver.statistics()["dead_peers"], driver.statistics()["connects"]) == (0, 1)
    assert (await driver.read([SPEED]))[0].value == BACKLOG - 1


async def test_nor_is_a_bus_dead_of_which_the_system_kept_the_oldest_frames(clock: Clock, raw: Raw) -> None:
    driver, bus = raw
    paused = clock.time()
    clock.now += PAUSE_S
    say(bus, [frame(0x181, value) for value in range(BACKLOG)], paused, paused + 0.1)
    await taken(bus)
    assert (await driver.read([SPEED]))[0].quality is Quality.TIMEOUT
    clock.now += LIMIT_S / 4
    await turns()
    say(bus, [frame(0x181, 7)], clock.time(), clock.time())
    assert (await driver.read([SPEED]))[0].value == 7
    assert (driver.statistics()["dead_peers"], driver.statistics()["connects"]) == (0, 1)


async def test_nor_is_a_bus_dead_with_which_the_loop_does_not_keep_up(clock: Clock, raw: Raw) -> None:
    driver, bus = raw
    await fall_behind(clock, bus, lambda: frame(0x181, 1))
    assert (driver.statistics()["dead_peers"], driver.statistics()["connects"]) == (0, 1)


@pytest.mark.parametrize(("step", "most"), [(0.01, LIMIT_S + 0.2), (PAUSE_S, 100 * PAUSE_S)])
async def test_a_bus_that_is_silent_is_dead_in_the_end_however_late_each_look_comes(
    clock: Clock, raw: Raw, step: float, most: float
) -> None:
    driver, _ = raw
    needed = await seconds_until(lambda: driver.statistics()["dead_peers"] > 0, clock, step)
    assert LIMIT_S < needed < most


# ---------------------------------------------------------------- CANopen


@pytest.fixture
async def node(clock: Clock, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> AsyncIterator[Node]:
    """A driver that listens to a node, and its bus."""
    bus = QueuedBus()
    monkeypatch.setattr(canopen_driver, "open_bus", lambda *_, **__: bus)
    (tmp_path / "node.eds").write_text(eds(), encoding="utf-8")
    settings = {"interface": "virtual", "channel": "queued", "node": NODE, "eds": str(tmp_path / "node.eds")}
    limits = {"listen_only": True, "connect_timeout": 60.0, "heartbeat_timeout": LIMIT_S, "pdo_timeout": LIMIT_S}
    driver = open_canopen({**settings, **limits}, clock=time.time)
    say(bus, [beat()], clock.time(), clock.time())
    await driver.open()
    await turns()
    yield driver, bus
    await driver.close()


def beat() -> can.Message:
    return can.Message(arbitration_id=0x700 + NODE, data=b"\5", is_extended_id=False)


async def test_over_canopen_what_waits_after_a_pause_is_heard_before_a_node_is_gone(clock: Clock, node: Node) -> None:
    driver, bus = node
    paused = clock.time()
    clock.now += PAUSE_S
    frames = [one for value in range(BACKLOG // 2) for one in (beat(), frame(0x180 + NODE, value, 5))]
    say(bus, frames, paused, clock.time())
    await taken(bus)
    assert driver.statistics()["node_losses"] == 0
    assert (await driver.read([LEVEL]))[0].value == BACKLOG // 2 - 1


async def test_nor_is_a_node_gone_of_which_the_system_kept_the_oldest_frames(clock: Clock, node: Node) -> None:
    driver, bus = node
    paused = clock.time()
    clock.now += PAUSE_S
    say(bus, [beat() for _ in range(BACKLOG)], paused, paused + 0.1)
    await taken(bus)
    assert (await driver.read([LEVEL]))[0].quality is Quality.TIMEOUT
    clock.now += LIMIT_S / 4
    await turns()
    say(bus, [beat(), frame(0x180 + NODE, 7, 5)], clock.time(), clock.time())
    assert (await driver.read([LEVEL]))[0].value == 7
    assert (driver.statistics()["node_losses"], driver.statistics()["starts"]) == (0, 1)


async def test_nor_is_a_node_gone_with_which_the_loop_does_not_keep_up(clock: Clock, node: Node) -> None:
    driver, bus = node
    await fall_behind(clock, bus, beat)
    assert (driver.statistics()["node_losses"], driver.statistics()["starts"]) == (0, 1)


@pytest.mark.parametrize(("step", "most"), [(0.01, LIMIT_S + 0.2), (PAUSE_S, 100 * PAUSE_S)])
async def test_a_node_that_is_silent_is_gone_in_the_end_however_late_each_look_comes(
    clock: Clock, node: Node, step: float, most: float
) -> None:
    driver, _ = node
    needed = await seconds_until(lambda: driver.statistics()["node_losses"] > 0, clock, step)
    assert LIMIT_S <= needed < most
