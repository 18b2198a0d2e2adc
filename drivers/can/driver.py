"""The raw CAN driver: the last frames of any python-can bus as samples, and writes verified by the device's echo."""

import asyncio
import time
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import can

from drivers.can.bus import AttendedSilence, BusLoad, ClockBefore, Pump, open_bus, pause_between_looks
from drivers.can.errors_on_bus import BusErrors, ControllerState
from drivers.can.exchange import Exchange, send_frame
from drivers.can.fields import EXTENDED, decode_value, frame_key, frame_name, layout_name
from drivers.can.frame import CanFrame
from drivers.can.notations import is_message_tag, message_decoder
from drivers.can.reception import Channel, Reception, Slot
from drivers.can.settings import CanSettings
from drivers.can.signals import SignalMap, SignalPlace, describe
from drivers.can.streaming import Stream
from drivers.can.writing import WriteMap
from drivers.codec import Reading
from drivers.driver import BeforeSending, Clock, PlanKind, PlanLine, anyhow
from drivers.errors import AddressError, DriverError, LinkDown
from drivers.link import Backoff, DeadPeer, Link
from drivers.settings import check_settings
from drivers.supervision import Supervisor
from drivers.tag import Quality, Sample, Tag, Value

_POLL_S = 0.1
_PLACES_KEPT = 20_000
_BUS_OFF = "bus-off: the controller has withdrawn from the bus after too many errors"


@dataclass(slots=True, eq=False)
class _Heard:
    """One tag of the driver's user: where it comes from (or why from nowhere), and what its last frame was read as."""

    tag: Tag
    problem: str = ""
    place: SignalPlace | None = None
    channel: Channel | None = None
    slot: Slot | None = None
    frame: CanFrame | None = None
    reading: Reading = (None, Quality.WAITING_FOR_INITIAL_DATA, "")


def open_can(settings: Mapping[str, Any], *, clock: Clock, write_map: Sequence[Tag] = (), seed: int = 0) -> "CanDriver":
    """Make a raw CAN driver, not yet opened.

    The settings are those of `drivers.can.settings`.

    Raises DriverError for an unknown key, a value out of range, an interface or a DBC file that cannot be used;
    AddressError for a tag of the write map that cannot be written.
    """
    checked = check_settings("can", CanSettings, settings)
    known = {*can.interfaces.BACKENDS, "hub"}
    if checked.interface not in known:
        raise DriverError(f"can: interface {checked.interface!r} is not known: known are {', '.join(sorted(known))}")
    return CanDriver(checked, clock=clock, write_map=tuple(write_map), seed=seed)


class CanDriver:
    """One CAN bus; a Driver that Writes and Streams. Made by `open_can`."""

    def __init__(self, settings: CanSettings, *, clock: Clock, write_map: tuple[Tag, ...], seed: int) -> None:
        self._settings = settings
        self._clock = clock
        self._clock_before = ClockBefore(clock)
        self._signals = SignalMap(settings)
        self._write_map = WriteMap(write_map, self._signals, settings.echo, settings.pad)
        self._reception = Reception()
        self.supervisor = Supervisor()
        self._messages = message_decoder(settings, self._reception, self.supervisor)
        self._errors = BusErrors()
        self._off = False
        self._load = BusLoad(settings.bitrate)
        self._heard: dict[int, _Heard] = {}
        self._streams: set[Stream] = set()
        self._exchange = Exchange(self._write_map, self._reception, settings.timeout)
        self._watching: asyncio.Task[None] | None = None
        self._counts = dict.fromkeys(("requests", "frames", "dropped"), 0)
        self._link: Link[Pump] = Link(
            self._connect,
            self._leave,
            connect_deadline=settings.connect_timeout,
            backoff=Backoff(settings.backoff_first, settings.backoff_cap),
            # Silence is judged by the messages' own timeouts (_notice_silence): one verdict ends the connection.
            dead_peer=DeadPeer(1, float("inf")),
            seed=seed,
            supervisor=self.supervisor,
        )
        for tag in write_map:
            self._subscription(tag)

    # ------------------------------------------------------------ Driver

    async def open(self) -> None:
        """Open the bus and go on opening it. Raises LinkDown if the first attempt fails (it goes on trying)."""
        if self._watching is None:
            self._watching = self.supervisor.task("watch", self._watch)
        await self._link.open()

    async def close(self) -> None:
        """Leave the bus and end all streams. Never raises; may be called twice."""
        watching, self._watching = self._watching, None
        if watching is not None:
            watching.cancel()
            await asyncio.wait({watching})
        self._messages.stop()
        for stream in self._streams:
            stream.end()
        await self._link.close()

    @property
    def connected(self) -> bool:
        """True while a usable frame has come over the present connection within the longest timeout of all messages."""
        heard = self._reception.heard
        return self._link.proven and heard is not None and time.monotonic() - heard <= self._longest()

    def statistics(self) -> Mapping[str, float]:
        """Counters since the driver was made; the load of the bus and the controller's error counters as they are."""
        link = self._link.statistics()
        now = time.monotonic()
        return {
            **self._counts,
            **self._exchange.counts,
            **{f"frames_{name}": count for name, count in self._reception.counts.items()},
            **self._errors.counts,
            **self._messages.counts(),
            "bus_load_percent": self._load.percent(now),
            "bus_load_peak_percent": self._load.peak,
            "transmit_errors": self._errors.transmit_errors,
            "receive_errors": self._errors.receive_errors,
            "reconnects": max(0, link["connects"] - 1),
            **link,
        }

    async def read(self, tags: Sequence[Tag]) -> list[Sample]:
        """What the last usable frames say, each at the time when it came; a failure is a Sample of bad quality."""
        self._counts["requests"] += 1
        self._drain()
        now = time.monotonic()
        return [self._sample(self._subscription(tag), now) for tag in tags]

    def cautions(self) -> tuple[str, ...]:
        """What of the DBC file cannot be used, in sentences."""
        return self._signals.omissions

    def explain(self, tags: Sequence[Tag]) -> tuple[PlanLine, ...]:
        """In sentences: what cannot be read and why, each message with its timeout and signals, what may be sent."""
        heard = [self._subscription(tag) for tag in tags]
        left_out = [
            PlanLine(f"{listening.tag.name}: {listening.problem}", PlanKind.PROBLEM)
            for listening in heard
            if listening.problem
        ]
        sent = [
            f"{frame_name(frame.key)}{layout_name(frame.conditions)} may be sent, {frame.length} bytes, echo "
            f"{frame_name(frame.echo)}: "
            f"{', '.join(frame.places)}"
            for frame in self._write_map.frames
        ]
        places = [listening.place for listening in heard if listening.place is not None]
        plain = [PlanLine(line, PlanKind.HEARD) for line in describe(places)]
        return (*left_out, *plain, *self._messages.describe(), *map(PlanLine, sent))

    def validity_seconds(self, tags: Sequence[Tag]) -> Mapping[str, float]:
        """Seconds for which the last frame of each tag is good; without the tags that lie in no frame."""
        places = [(tag.name, self._subscription(tag).place) for tag in tags]
        return {name: place.timeout for name, place in places if place is not None}

    # ------------------------------------------------------------ Streams

    async def stream(self, tags: Sequence[Tag]) -> AsyncIterator[Sample]:
        """Yield a sample for each tag of each usable frame as it comes, until `close`; silence tells so once."""
        heard = [self._subscription(tag) for tag in tags]
        stream = Stream(
            [listening.slot for listening in heard],
            lambda position: self._sample(heard[position], time.monotonic()),
            self._drain,
        )
        self._streams.add(stream)
        try:
            async for sample in stream.samples():
                yield sample
        finally:
            self._streams.discard(stream)
            self._counts["dropped"] += stream.dropped

    # ------------------------------------------------------------ Writes

    async def write(self, values: Sequence[tuple[Tag, Value]], *, before_sending: BeforeSending = anyhow) -> None:
        """Send the frames that hold the values, each once, and wait until the device's echo confirms every one.

        Raises WriteForbidden, EncodingError, or AddressError if a frame's other tags are missing (nothing was sent);
        LinkDown, ReplyTimeout (it is not known whether the device took them); WriteUnverified. Never retries. Several
        frames are no one step to the device: what belongs together must carry its own sequence or checksum.
        """
        if not values:
            return
        composed = self._write_map.compose(values)
        pump = self._link.connection
        if pump is None:
            raise LinkDown(self._link.reason)
        for frame, data in composed:
            self._load.add(len(data), extended=frame.is_extended, now=time.monotonic())
        lost = lambda: "" if self._link.connection is pump else self._link.reason  # noqa: E731
        await self._exchange.write(pump, composed, lost, before_sending)

    # ------------------------------------------------------------ tags

    def _subscription(self, tag: Tag) -> _Heard:
        """The tag's place on the bus; it is listened for from the first time on that it is asked for."""
        listening = self._heard.get(id(tag))
        if listening is None:
            if len(self._heard) >= _PLACES_KEPT:
                self._heard.clear()
            listening = self._heard[id(tag)] = self._make_subscription(tag)
        return listening

    def _make_subscription(self, tag: Tag) -> _Heard:
        if is_message_tag(tag):
            return self._make_message_subscription(tag)
        try:
            place = self._write_map.echoes[tag.name] if self._write_map.holds(tag) else self._signals.place(tag)
        except AddressError as error:
            return _Heard(tag, problem=str(error))
        before = len(self._reception.keys)
        channel, slot = self._reception.listen(place.rules, place.field.conditions, place.timeout, time.monotonic())
        if len(self._reception.keys) > before:
            self._filter_anew()
        return _Heard(tag, "", place, channel, slot)

    def _make_message_subscription(self, tag: Tag) -> _Heard:
        """A tag without a place in frames: it has a slot of its own, for which all frames are needed."""
        try:
            channel, slot = self._messages.listen(tag, time.monotonic())
        except AddressError as error:
            return _Heard(tag, problem=str(error))
        if (pump := self._link.connection) is not None and self._settings.only_mapped:
            pump.bus.set_filters(None)
        return _Heard(tag, "", None, channel, slot)

    def _sample(self, listening: _Heard, now: float) -> Sample:
        if listening.channel is None or listening.slot is None:
            return self._no(listening.tag, Quality.CONFIGURATION_ERROR, listening.problem)
        if self._link.connection is None:
            return self._no(listening.tag, Quality.NOT_CONNECTED, self._link.reason)
        missing = self._reception.absence(listening.channel, listening.slot, now)
        frame = listening.slot.frame
        if missing is not None or frame is None:
            quality, reason = missing or (Quality.WAITING_FOR_INITIAL_DATA, "")
            return self._no(listening.tag, quality, f"{reason}; {_BUS_OFF}" if self._off else reason)
        if listening.place is None:
            listening.reading = self._messages.reading(listening.slot)
        # Decoded once for each frame, however often it is read.
        elif listening.frame is not frame:
            listening.frame, listening.reading = (
                frame,
                decode_value(listening.place.tag, listening.place.field, frame.data),
            )
        value, quality, reason = listening.reading
        return Sample(listening.tag.name, value, quality, frame.time, reason=reason)

    def _no(self, tag: Tag, quality: Quality, reason: str) -> Sample:
        return Sample(tag.name, None, quality, self._clock(), reason=reason)

    # ------------------------------------------------------------ the bus

    async def _connect(self) -> Pump:
        s = self._settings
        opening = asyncio.ensure_future(
            asyncio.to_thread(
                open_bus, s.interface, s.channel, s.bitrate, fd=s.fd, filters=self._filters(), options=s.options
            )
        )
        try:
            # The thread cannot be stopped: it goes on opening after the deadline, and what it opens then is let go.
            bus = await asyncio.shield(opening)
        except asyncio.CancelledError:
            opening.add_done_callback(_discard_bus)
            raise
        self._reception.restart(time.monotonic())
        self._errors.restart()  # the controller's last word stays in self._off until a frame proves it wrong
        # The pump may be lost before it has a name here: whom it reports is looked up when it does.
        pumps: list[Pump] = []
        pump = Pump(bus, self._take, lambda reason: self._link.lost(pumps[0], reason), self.supervisor)
        pumps.append(pump)
        self._messages.start(partial(send_frame, pump))
        return pump

    def _drain(self) -> None:
        """Take what waits on the bus: after a pause of this process a frame in the midst of it is no news."""
        if (pump := self._link.connection) is not None:
            pump.drain()

    def _leave(self, pump: Pump) -> None:
        pump.close()
        self._counts["dropped"] += pump.dropped

    def _filter_anew(self) -> None:
        """Let the interface pass on the frames of a new message too."""
        pump, filters = self._link.connection, self._filters()
        if pump is not None and filters is not None:
            pump.bus.set_filters(filters)

    def _filters(self) -> list[can.typechecking.CanFilter] | None:
        if not self._settings.only_mapped or self._messages.listens:
            return None
        return [
            {
                "can_id": key & ~EXTENDED,
                "can_mask": 0x1FFFFFFF if key & EXTENDED else 0x7FF,
                "extended": key >= EXTENDED,
            }
            for key in self._reception.keys
        ]

    def _take(self, message: can.Message) -> None:
        """One frame of the bus, in the event loop's thread."""
        came = message.timestamp
        self._counts["frames"] += 1
        if message.is_error_frame:
            self._errors.take(message.arbitration_id, bytes(message.data))
            self._drop_bus_off_link()
            return
        self._off = False
        self._load.add(len(message.data), extended=message.is_extended_id, now=came)
        if message.is_remote_frame:
            return
        data, extended, channel = bytes(message.data), message.is_extended_id, str(message.channel or "")
        frame = CanFrame(self._clock_before.clock_time(came), message.arbitration_id, extended, data, channel)
        key = frame_key(message.arbitration_id, extended=extended)
        fresh = [*self._reception.take(key, frame, came), *self._messages.take(frame, came)]
        if not fresh:
            return
        if (pump := self._link.connection) is not None:
            self._link.note_answer(pump)
        self._exchange.heard.set()
        for stream in self._streams:
            stream.hear(fresh)

    def _drop_bus_off_link(self) -> None:
        if self._errors.state is ControllerState.BUS_OFF and (pump := self._link.connection) is not None:
            self._off = True
            self._link.lost(pump, _BUS_OFF)
            self._exchange.heard.set()

    # ------------------------------------------------------------ the watch

    async def _watch(self) -> None:
        """Look now and then at what no frame tells: silence, and a controller that says only when asked."""
        pause = pause_between_looks(self._settings.max_silence, _POLL_S)
        attended = AttendedSilence(time.monotonic())
        while True:
            await asyncio.sleep(pause)
            now = time.monotonic()
            attended.look(self._silence(now), now, pause)
            pump = self._link.connection
            if pump is None:
                self._exchange.heard.set()
                continue
            with suppress(can.CanError, OSError, NotImplementedError):
                if pump.bus.state is can.BusState.ERROR:
                    self._errors.state = ControllerState.BUS_OFF
            self._drop_bus_off_link()
            if self._reception.keys and attended.seconds > self._longest():
                self._notice_silence(pump)

    def _notice_silence(self, pump: Pump) -> None:
        self._drain()
        silent = self._silence(time.monotonic())
        if silent > self._longest():
            self._link.failed(pump, silent, "no usable frame has come")

    def _silence(self, now: float) -> float:
        """Seconds since the last usable frame came, or since the bus was opened."""
        return now - max(self._reception.heard or 0.0, self._reception.since)

    def _longest(self) -> float:
        return max(self._reception.longest_timeout(), float(self._settings.max_silence))


def _discard_bus(opening: "asyncio.Future[can.BusABC]") -> None:
    """A bus that was opened after its deadline is let go."""
    if not opening.cancelled() and opening.exception() is None:
        opening.result().shutdown()
