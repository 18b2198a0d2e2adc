"""The soft driver on the bench: the device is the driver itself."""

import time
from collections.abc import AsyncIterator

from drivers.driver import open_driver
from drivers.soft.driver import SoftDriver
from tests.drivers.benches import Bench, Tags


async def soft_bench() -> AsyncIterator[Bench]:
    """A device in memory."""
    values = {"level": 12.5, "state": 7, "flag": True, "setpoint": 0, "mode": 0}
    driver = open_driver("soft", {"values": values}, clock=time.time, write_map=Tags().write_map)
    assert isinstance(driver, SoftDriver)

    async def lose() -> None:
        driver.fail("refuse")

    async def restore() -> None:
        driver.fail(None)

    yield Bench(driver, lose, restore, lambda: driver.fail("ignore-writes"))
    await driver.close()
