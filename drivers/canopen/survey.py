"""A CAN bus looked at by hand: every frame that comes, and single objects of any node (see `drivers.survey`)."""

import asyncio
import time
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from typing import Any

import can

from drivers.can.bus import open_bus
from drivers.can.pump import Pump
from drivers.canopen.channel import SdoChannel
from drivers.canopen.place import Place
from drivers.driver import Clock
from drivers.errors import DriverError, LinkDown
from drivers.survey import BusFrame

_SDO_ANSWER, _SDO_REQUEST = 0x580, 0x600
_SEND_TIMEOUT = 0.05
_DEFAULTS: dict[str, Any] = {"interface": "socketcan", "bitrate": None, "fd": False, "options": None}


@asynccontextmanager
async def open_survey(settings: Mapping[str, Any], *, clock: Clock) -> AsyncIterator["BusSurvey"]:
    """The bus that the settings of a CAN driver name. Raises DriverError; LinkDown if it cannot be opened now."""
    del clock  # frames are timed from the beginning of listening
    if not settings.get("channel"):
        raise DriverError("can: channel must be given")
    given = {key: settings.get(key, default) for key, default in _DEFAULTS.items()}
    place = (given.pop("interface"), settings["channel"], given.pop("bitrate"))
    bus = await asyncio.to_thread(open_bus, *place, **given)
    survey = BusSurvey(bus)
    try:
        yield survey
    finally:
        survey.close()


class BusSurvey:
    """An open bus. Made by `open_survey`."""

    def __init__(self, bus: can.BusABC) -> None:
        self._lost = ""
        self._begun = time.monotonic()
        self._frames: list[BusFrame] | None = None
        self._nodes: dict[int, SdoChannel] = {}
        self._gone = asyncio.Event()
        self._heard = self._errors = 0
        self._past = dict.fromkeys(("requests", "timeouts", "mismatches", "aborts"), 0)
        self._pump = Pump(bus, self._take, self._on_lost)

    def close(self) -> None:
        """Leave the bus."""
        self._pump.close()

    def statistics(self) -> Mapping[str, float]:
        """Counters by the names of the drivers'."""
        asked = dict(self._past)
        for channel in self._nodes.values():
            asked = {name: count + channel.counts[name] for name, count in asked.items()}
        return {**asked, "frames": self._heard, "error_frames": self._errors, "dropped": self._pump.dropped}

    async def listen(self, seconds: float) -> list[BusFrame]:
        """All data frames of so many seconds. Raises LinkDown if the bus goes meanwhile."""
        self._frames, self._begun = [], time.monotonic()
        try:
            async with asyncio.timeout(seconds):
                await self._gone.wait()
        except TimeoutError:
            frames, self._frames = self._frames, None
            return frames
        raise LinkDown(self._lost)

    async def object(self, node: int, index: int, subindex: int, timeout: float) -> bytes:
        """One object of a node. Raises ReplyTimeout, DeviceException, ReplyMismatch or LinkDown."""
        channel = SdoChannel(lambda data: self._send(_SDO_REQUEST + node, data), timeout)
        self._forget(node)
        self._nodes[node] = channel
        return await channel.read(Place(index, subindex))

    def _forget(self, node: int) -> None:
        former = self._nodes.pop(node, None)
        if former is not None:
            self._past = {name: count + former.counts[name] for name, count in self._past.items()}

    def _send(self, identifier: int, data: bytes) -> None:
        message = can.Message(arbitration_id=identifier, data=data, is_extended_id=False)
        try:
            self._pump.bus.send(message, timeout=_SEND_TIMEOUT)
        except (can.CanError, OSError) as error:
            raise LinkDown(f"the bus takes no frame: {error}") from None

    def _take(self, message: can.Message) -> None:
        if message.is_error_frame:
            self._errors += 1
            return
        if message.is_remote_frame:
            return
        self._heard += 1
        number, data = message.arbitration_id, bytes(message.data)
        if self._frames is not None:
            since = time.monotonic() - self._begun
            self._frames.append(BusFrame(since, number, message.is_extended_id, data))
        node = number - _SDO_ANSWER
        if not message.is_extended_id and node in self._nodes:
            self._nodes[node].heard(data)

    def _on_lost(self, reason: str) -> None:
        self._lost = reason
        self._gone.set()
        for channel in self._nodes.values():
            channel.close(reason)
