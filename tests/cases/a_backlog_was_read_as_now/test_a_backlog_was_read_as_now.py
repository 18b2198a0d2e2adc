"""After a pause of the gateway, frames that had waited on the bus were taken in bursts, and a scan between two of them
held what the device had said long before for what it said at that moment.
"""

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path

import can
import pytest

from drivers.can import driver as can_driver
from drivers.can.bus import pump
from drivers.can.driver import CanDriver, open_can
from drivers.canopen import driver as canopen_driver
from drivers.canopen.driver import CanopenDriver, open_canopen
from drivers.tag import Tag
from tests.cases.a_backlog_was_read_as_now.buses import QueuedBus, ThreadedBus, frame
from tests.drivers.scripted_node import NODE, eds

SPEED, LEVEL = Tag("speed", "0x181:0|16"), Tag("level", "0x2001:1")
BACKLOG = 600
LONG_S = 60.0

AnyBus = QueuedBus | ThreadedBus
Opened = tuple[AnyBus, CanDriver | CanopenDriver, Tag, Callable[[int], can.Message]]
Open = Callable[..., Awaitable[Opened]]


@pytest.fixture
async def opened(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> AsyncIterator[Open]:
    """Opens a driver on a bus of its own, and has it read once; a value's frame comes with it."""
    drivers: list[CanDriver | CanopenDriver] = []

    async def make(link: str, bus: AnyBus, **settings: object) -> Opened:
        if isinstance(bus, ThreadedBus):
            # What a pause of the whole process looks like to the loop: when the thread last looked is too long ago.
            monkeypatch.setattr(pump, "_BEHIND_AFTER_S", 0.0)
            monkeypatch.setattr(pump, "_CATCH_UP_TIMEOUT_S", LONG_S)
        place = {"interface": "virtual", "channel": "queued", **settings}
        if link == "can":
            monkeypatch.setattr(can_driver, "open_bus", lambda *_, filters=None, **__: filtered(bus, filters))
            raw = open_can({**place, "message_timeout": LONG_S, "max_silence": LONG_S}, clock=time.time)
            drivers.append(raw)
            await raw.open()
            await raw.read([SPEED])
            return bus, raw, SPEED, lambda value: frame(0x181, value)
        monkeypatch.setattr(canopen_driver, "open_bus", lambda *_, **__: bus)
        (tmp_path / "node.eds").write_text(eds(), encoding="utf-8")
        node = {"node": NODE, "eds": str(tmp_path / "node.eds"), "listen_only": True, "connect_timeout": LONG_S}
        driver = open_canopen({**place, **node, "heartbeat_timeout": LONG_S, "pdo_timeout": LONG_S}, clock=time.time)
        drivers.append(driver)
        bus.say(can.Message(arbitration_id=0x700 + NODE, data=b"\5", is_extended_id=False))
        await driver.open()
        return bus, driver, LEVEL, lambda value: frame(0x180 + NODE, value, 5)

    yield make
    for driver in drivers:
        await driver.close()


def filtered(bus: AnyBus, filters: can.typechecking.CanFilters | None) -> AnyBus:
    bus.set_filters(filters)
    return bus


@pytest.mark.parametrize("kind", [QueuedBus, ThreadedBus])
@pytest.mark.parametrize("link", ["can", "canopen"])
async def test_what_is_read_is_the_newest_frame_of_a_backlog(opened: Open, link: str, kind: type[AnyBus]) -> None:
    bus, driver, tag, saying = await opened(link, kind())
    bus.say(*map(saying, range(BACKLOG)))
    (sample,) = await driver.read([tag])
    assert sample.value == BACKLOG - 1


async def test_nor_do_frames_that_are_left_out_hide_what_waits_behind_them(opened: Open) -> None:
    bus, driver, tag, saying = await opened("can", QueuedBus(), only_mapped=True)
    bus.say(*(one for value in range(BACKLOG) for one in (saying(value), *[frame(0x7FF, value)] * 3)))
    (sample,) = await driver.read([tag])
    assert sample.value == BACKLOG - 1


@pytest.mark.parametrize("kind", [QueuedBus, ThreadedBus])
@pytest.mark.parametrize("link", ["can", "canopen"])
async def test_a_stream_has_told_all_of_a_backlog_before_anybody_else_has_a_turn(
    opened: Open, link: str, kind: type[AnyBus]
) -> None:
    bus, driver, tag, saying = await opened(link, kind())
    told: list[object] = []

    async def listen() -> None:
        async for sample in driver.stream([tag]):
            told.append(sample.value)

    listening = asyncio.ensure_future(listen())
    bus.say(*map(saying, range(BACKLOG)))
    async with asyncio.timeout(LONG_S):
        while not any(isinstance(value, int) for value in told):
            await asyncio.sleep(0)
    assert told[-1] == BACKLOG - 1
    listening.cancel()


@pytest.mark.parametrize("link", ["can", "canopen"])
async def test_of_more_frames_than_are_kept_the_newest_are_kept(
    opened: Open, link: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pump, "_QUEUE", 10)
    bus, driver, tag, saying = await opened(link, ThreadedBus())
    bus.say(*map(saying, range(BACKLOG)))
    (sample,) = await driver.read([tag])
    assert sample.value == BACKLOG - 1
