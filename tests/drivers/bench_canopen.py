"""The CANopen driver on the bench: a node of the canopen library on a hub, its TPDO heard and its SDO server asked."""

import asyncio
import tempfile
import time
from collections.abc import AsyncIterator
from pathlib import Path

from drivers.can.bus.hub import Hub
from drivers.driver import open_driver
from drivers.errors import LinkDown
from drivers.tag import DType, Tag
from tests.drivers.benches import Bench, Tags
from tests.drivers.scripted_node import HEARTBEAT, NODE, ScriptedNode, eds

TAGS = Tags(
    Tag("level", "0x2001:1", scale=0.1, low=0, high=100),
    Tag("state", "0x2001:2"),
    Tag("flag", "0x2001:3", DType.BOOL, bit=1),
    Tag("setpoint", "0x2100:1", scale=0.01, low=-50, high=50, dtype=DType.INT16),
    Tag("mode", "0x2100:2"),
)
DETECTION = 0.2
"""Seconds without a heartbeat after which the bench's node counts as gone."""


class CanopenBench(Bench):
    """A bench that is open when the node's TPDO has come: until then what it carries is asked for."""

    async def open(self) -> None:
        loop = asyncio.get_running_loop()
        end = loop.time() + 60.0
        while True:  # a busy machine brings a node up later than `connect_timeout`
            try:
                await super().open()
                break
            except LinkDown:
                if loop.time() > end:
                    raise
        while (await self.driver.read([self.tags.level]))[0].sent is not None:
            await asyncio.sleep(0.005)


async def canopen_bench() -> AsyncIterator[Bench]:
    """level, state and flag come by TPDO; setpoint and mode are asked for and written by SDO or by the RPDO."""
    with tempfile.TemporaryDirectory(prefix="canopen-") as name:
        folder = Path(name)
        (folder / "node.eds").write_text(eds(), encoding="utf-8")
        with Hub(folder / "bus"):
            node = ScriptedNode(folder / "bus", {1: 125, 2: 7, 3: 2})
            node.start()
            settings = {
                "interface": "hub",
                "channel": str(folder / "bus"),
                "node": NODE,
                "eds": str(folder / "node.eds"),
                "heartbeat_timeout": DETECTION,
            }
            driver = open_driver("canopen", settings, clock=time.time, write_map=TAGS.write_map)

            async def lose() -> None:
                await asyncio.to_thread(node.stop)
                # What the node said last may lie for a while on a machine that does much else.
                async with asyncio.timeout(60):
                    while driver.connected:
                        await asyncio.sleep(DETECTION / 10)
                        await driver.read(TAGS.read)

            async def restore() -> None:
                await asyncio.to_thread(node.start)

            yield CanopenBench(driver, lose, restore, node.forget_writes, TAGS, HEARTBEAT, "reads")
            await driver.close()
            await asyncio.to_thread(node.stop)
