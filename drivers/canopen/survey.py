"""A CAN bus looked at by hand: every frame that comes, and single objects of any node (see `drivers.survey`)."""

import asyncio
import time
from collections import Counter
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from typing import Any

import can

from drivers.can.bus import Pump, open_bus
from drivers.canopen.asking import error_quality
from drivers.canopen.channel import SdoChannel
from drivers.canopen.place import ObjectPlace, from_bytes, parse_place
from drivers.driver import Clock
from drivers.errors import DriverError, LinkDown
from drivers.survey import BusFrame, Raw
from drivers.tag import Quality, Sample, Tag

_SDO_ANSWER, _SDO_REQUEST = 0x580, 0x600
_SEND_TIMEOUT = 0.05
_DEFAULTS: dict[str, Any] = {"interface": "socketcan", "bitrate": None, "fd": False, "options": None}


@asynccontextmanager
async def open_survey(settings: Mapping[str, Any], *, clock: Clock) -> AsyncIterator["BusSurvey"]:
    """The bus that the settings of a CAN driver name. Raises DriverError; LinkDown if it cannot be opened now."""
    if not settings.get("channel"):
        raise DriverError("can: channel must be given")
    opening = {key: settings.get(key, default) for key, default in _DEFAULTS.items()}
    place = (opening.pop("interface"), settings["channel"], opening.pop("bitrate"))
    bus = await asyncio.to_thread(open_bus, *place, **opening)
    survey = BusSurvey(bus, clock)
    try:
        yield survey
    finally:
        survey.close()


class BusSurvey:
    """An open bus. Made by `open_survey`."""

    def __init__(self, bus: can.BusABC, clock: Clock) -> None:
        self._clock = clock
        self._lost = ""
        self._begun = time.monotonic()
        self._frames: list[BusFrame] | None = None
        self._channels: dict[tuple[int, float], SdoChannel] = {}
        self._gone = asyncio.Event()
        self._heard = self._errors = 0
        self._pump = Pump(bus, self._take, self._on_loss)

    def close(self) -> None:
        """Leave the bus."""
        self._pump.close()

    def statistics(self) -> Mapping[str, float]:
        """Counters by the names of the drivers'."""
        heard = {"frames": self._heard, "error_frames": self._errors, "dropped": self._pump.dropped}
        counts = Counter[str]()
        for channel in self._channels.values():
            counts.update(channel.counts)
        return {**dict.fromkeys(("requests", "timeouts", "mismatches", "aborts"), 0), **counts, **heard}

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
        channel = self._channels.get((node, timeout))
        if channel is None:
            channel = SdoChannel(lambda data: self._send(_SDO_REQUEST + node, data), timeout)
            self._channels[node, timeout] = channel
        return await channel.read(ObjectPlace(index, subindex))

    async def tags(self, tags: Sequence[Tag], node: int, timeout: float) -> list[Raw]:
        """Each tag of a node by SDO, with the bytes of its object; after one without an answer no more is asked."""
        raws: list[Raw] = []
        silent = ""
        for tag in tags:
            raw = self._failure(tag, Quality.TIMEOUT, silent) if silent else await self._tag(tag, node, timeout)
            silent = raw.sample.reason if raw.sample.quality is Quality.TIMEOUT else ""
            raws.append(raw)
        return raws

    async def _tag(self, tag: Tag, node: int, timeout: float) -> Raw:
        sent = self._clock()
        try:
            place = parse_place(tag.address, tag.name)
            data = await self.object(node, place.index, place.subindex, timeout)
            value, quality, reason = from_bytes(tag, data)
        except DriverError as error:
            return self._failure(tag, error_quality(error), str(error))
        sample = Sample(tag.name, value, quality, self._clock(), sent=sent, reason=reason)
        return Raw(tag, sample, str(place), len(data), tuple(data))

    def _failure(self, tag: Tag, quality: Quality, reason: str) -> Raw:
        return Raw(tag, Sample(tag.name, None, quality, self._clock(), reason=reason), tag.address, 0)

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
        if not message.is_extended_id:
            for (server, _), channel in self._channels.items():
                if server == node:
                    channel.receive(data)

    def _on_loss(self, reason: str) -> None:
        self._lost = reason
        self._gone.set()
        for channel in self._channels.values():
            channel.close(reason)
