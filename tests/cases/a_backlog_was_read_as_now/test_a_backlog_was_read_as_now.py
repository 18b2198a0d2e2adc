"""After a pause of the gateway, frames that had waited on the bus were taken in bursts, and a scan between two of them
held what the device had said long before for what it said at that moment.
"""

import asyncio
import os
import struct
import time
from collections import deque
from collections.abc import AsyncIterator

import can
import pytest

from drivers.can import driver as can_driver
from drivers.can.driver import CanDriver, open_can
from drivers.tag import Tag

SPEED = Tag("speed", "0x181:0|16")
BACKLOG = 600


class QueuedBus(can.BusABC):
    """A bus whose frames wait where the system keeps them."""

    def __init__(self) -> None:
        super().__init__("queued")
        self.waiting: deque[can.Message] = deque()
        self._descriptor = os.eventfd(1)

    def say(self, *values: int) -> None:
        for value in values:
            data = struct.pack("<H", value)
            self.waiting.append(can.Message(arbitration_id=0x181, data=data, is_extended_id=False))

    def fileno(self) -> int:
        return self._descriptor

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        return (self.waiting.popleft() if self.waiting else None), True

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise NotImplementedError

    def shutdown(self) -> None:
        super().shutdown()
        os.close(self._descriptor)


@pytest.fixture
async def bus(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[QueuedBus]:
    bus = QueuedBus()
    monkeypatch.setattr(can_driver, "open_bus", lambda *_, **__: bus)
    yield bus


@pytest.fixture
async def driver(bus: QueuedBus) -> AsyncIterator[CanDriver]:
    driver = open_can({"interface": "virtual", "channel": "queued"}, clock=time.time)
    await driver.open()
    await driver.read([SPEED])
    yield driver
    await driver.close()


async def test_what_is_read_is_the_newest_frame_of_a_backlog(bus: QueuedBus, driver: CanDriver) -> None:
    bus.say(*range(BACKLOG))
    (sample,) = await driver.read([SPEED])
    assert sample.value == BACKLOG - 1


async def test_a_stream_has_told_all_of_a_backlog_before_anybody_else_has_a_turn(
    bus: QueuedBus, driver: CanDriver
) -> None:
    told: list[object] = []

    async def listen() -> None:
        async for sample in driver.stream([SPEED]):
            told.append(sample.value)

    listening = asyncio.ensure_future(listen())
    bus.say(*range(BACKLOG))
    async with asyncio.timeout(60.0):
        while not any(isinstance(value, int) for value in told):
            await asyncio.sleep(0)
    assert told[-1] == BACKLOG - 1
    listening.cancel()
