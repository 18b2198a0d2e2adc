"""A CAN device of a few frames on a hub of its own, for the contract suite and for the driver's own tests."""

import asyncio
import tempfile
import time
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path

import can

from drivers.can.bus.access import open_bus
from drivers.can.bus.hub import Hub
from drivers.can.bus.pump import Pump
from drivers.driver import open_driver
from tests.drivers.benches import FLAG, LEVEL, MODE, SETPOINT, STATE, Bench, Tags

PERIOD = 0.05
CAN_TAGS = Tags(
    level=replace(LEVEL, address="0x181:0|16"),
    state=replace(STATE, address="0x181[31|8@0=0]:16|8"),
    flag=replace(FLAG, address="0x182:7|16@0"),
    setpoint=replace(SETPOINT, address="0x201:0|16"),
    mode=replace(MODE, address="0x00000202:8|16"),
)
ECHO = {"0x201": "0x281", "0x00000202": "0x00000282"}


class CanDevice:
    """Sends its frames every PERIOD and echoes what is written to it. Frames are (id, extended): payload."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.frames = {
            (0x181, False): bytes((125, 0, 7, 0)),
            (0x182, False): bytes((0, 2)),
            (0x281, False): bytes(2),
            (0x282, True): bytes(3),
        }
        self.echoes = {(0x201, False): (0x281, False), (0x202, True): (0x282, True)}
        self.stores = True
        self.answers = True
        self.heard: list[can.Message] = []
        self._hub: Hub | None = None
        self._pump: Pump | None = None
        self._task: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Make the bus and speak on it."""
        self._hub = Hub(self.path).__enter__()
        self._pump = Pump(open_bus("hub", str(self.path)), self._take, lambda reason: None)
        self._task = asyncio.create_task(self._speak())

    async def stop(self) -> None:
        """Silence; the bus is gone too."""
        await self.fall_silent()
        if self._hub is not None:
            await asyncio.to_thread(self._hub.__exit__, None, None, None)
            self._hub = None

    async def fall_silent(self) -> None:
        """Leave the bus, which stays."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.wait({self._task})
            self._task = None
        if self._pump is not None:
            self._pump.close()
            self._pump = None

    def send(self, number: int, data: bytes, *, extended: bool = False) -> None:
        """One data frame."""
        self.put(can.Message(arbitration_id=number, is_extended_id=extended, data=data))

    def put(self, message: can.Message) -> None:
        """One frame of any kind."""
        assert self._pump is not None
        self._pump.bus.send(message)

    def _take(self, message: can.Message) -> None:
        self.heard.append(message)
        echo = self.echoes.get((message.arbitration_id, message.is_extended_id))
        if echo is None:
            return
        if self.stores:
            self.frames[echo] = bytes(message.data)
        if self.answers:
            self.send(echo[0], self.frames[echo], extended=echo[1])

    async def _speak(self) -> None:
        while True:
            for (number, extended), data in list(self.frames.items()):
                self.send(number, data, extended=extended)
            await asyncio.sleep(PERIOD)


async def can_bench() -> AsyncIterator[Bench]:
    with tempfile.TemporaryDirectory() as folder:
        device = CanDevice(Path(folder) / "bus")
        await device.start()
        settings = {"interface": "hub", "channel": str(device.path), "echo": ECHO, "message_timeout": 10 * PERIOD}
        settings["connect_timeout"] = 20.0  # a busy machine opens a bus late
        driver = open_driver("can", settings, clock=time.time, write_map=CAN_TAGS.write_map)

        def forget() -> None:
            device.stores = False

        yield Bench(driver, device.stop, device.start, forget, tags=CAN_TAGS, period=PERIOD)
        await driver.close()
        await device.stop()
