"""Each unit behind a gateway had a connection of its own: the gateway refused most, and a dead one was waited for."""

import asyncio
import time

from drivers.connections import Connections
from drivers.driver import Driver, open_driver
from drivers.tag import Quality, Sample, Tag
from tests.drivers.conftest import open_anyway
from tests.drivers.scripted import ScriptedPlc

FIVE = Tag("five", "holding:5")
LIVING, DEAD = range(1, 7), (7, 8)


async def test_six_units_behind_a_gateway_for_one_client_are_read_beside_two_dead_ones() -> None:
    gateway, refused = ScriptedPlc(), 0

    async def bend(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        nonlocal refused
        if len(plc._writers) > 1:
            refused += 1
            writer.close()
        elif request[6] not in DEAD:
            writer.write(honest)

    gateway.bend = bend
    await gateway.start()
    connections, drivers = Connections(), {}
    for unit in (*LIVING, *DEAD):
        settings = {"host": "127.0.0.1", "port": gateway.port, "unit": unit, "timeout": 0.4}
        drivers[unit] = open_driver("modbus", settings, clock=time.time, connections=connections)
        await open_anyway(drivers[unit])
    last: dict[int, Sample] = {}

    async def scans(unit: int, driver: Driver, count: int) -> None:
        for _ in range(count):
            (last[unit],) = await driver.read([FIVE])

    try:
        # The living are asked all the while, as a gateway does: by their answers the dead are told from a dead gateway.
        asking = [asyncio.create_task(scans(unit, drivers[unit], 1_000_000)) for unit in LIVING]
        await asyncio.gather(*(scans(unit, drivers[unit], 6) for unit in DEAD))
        for task in asking:
            task.cancel()
        await asyncio.gather(*asking, return_exceptions=True)
        began = asyncio.get_running_loop().time()  # which stands still while the machine does other things
        await asyncio.gather(*(scans(unit, driver, 20) for unit, driver in drivers.items()))
        took = asyncio.get_running_loop().time() - began
    finally:
        for driver in drivers.values():
            await driver.close()
        await gateway.stop()
    assert refused == 0
    assert all(last[unit].quality is Quality.GOOD and last[unit].value == 5 for unit in LIVING)
    assert {last[unit].quality for unit in DEAD} == {Quality.NOT_CONNECTED}
    # Every round would have waited twice for 0.4 s for each of the two.
    assert took < 8.0, took
