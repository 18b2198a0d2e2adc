import asyncio
import contextlib
import random
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from typing import Any

import pytest

from drivers.driver import Driver
from drivers.errors import DriverError
from drivers.modbus.driver import ModbusDriver, open_modbus
from drivers.tag import Sample, Tag
from tests.drivers.scripted import ScriptedPlc

OpenModbus = Callable[..., Awaitable[ModbusDriver]]


@pytest.fixture
async def plc() -> AsyncIterator[ScriptedPlc]:
    scripted = ScriptedPlc()
    await scripted.start()
    yield scripted
    await scripted.stop()


@pytest.fixture
async def opened(plc: ScriptedPlc) -> AsyncIterator[OpenModbus]:
    """Open drivers on the scripted PLC; they are closed at the end."""
    drivers: list[ModbusDriver] = []

    async def open_(write_map: Sequence[Tag] = (), **settings: Any) -> ModbusDriver:
        merged = {"host": "127.0.0.1", "port": plc.port, **settings}
        # A drawn id may be the one that a test means as another's.
        driver = open_modbus(merged, clock=time.time, write_map=write_map, rng=random.Random(1))
        drivers.append(driver)
        await driver.open()
        return driver

    yield open_
    for driver in drivers:
        await driver.close()


async def read_until_good(driver: Driver, tag: Tag, *, within: float = 60.0, pause: float = 0.02) -> Sample:
    """Poll one tag until it is good; a failed assertion names the last reason."""
    loop = asyncio.get_running_loop()
    end = loop.time() + within
    while True:
        (sample,) = await driver.read([tag])
        if sample.quality.is_good or loop.time() > end:
            assert sample.quality.is_good, sample
            return sample
        await asyncio.sleep(pause)


async def open_anyway(driver: Driver) -> None:
    """Open a driver whose device may be away."""
    with contextlib.suppress(DriverError):
        await driver.open()
