"""A device without hardware: values set in memory or replayed from a recording, and failures on demand."""

import asyncio
import math
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from pydantic import Field

from drivers.codec import Reading, decode, encode, judge
from drivers.driver import BeforeSending, Clock, anyhow
from drivers.errors import (
    DeviceException,
    DriverError,
    LinkDown,
    ReplyMismatch,
    ReplyTimeout,
    WriteForbidden,
    WriteUnverified,
)
from drivers.settings import Section, check_settings
from drivers.soft.recorded import SoftRecording, load_csv, make_recording
from drivers.tag import DType, Quality, Sample, Tag, Value


class SoftSettings(Section):
    """What the soft device holds or plays; see `open_soft`."""

    values: dict[str, Any] | None = Field(None, description="a table of tags and what they hold at first")
    csv: str | None = Field(None, min_length=1, description="the path of a CSV file")
    time_column: str = Field("time", min_length=1, description="the name of the column of times")
    times: list[Any] | None = Field(None, description="a list of seconds")
    columns: dict[str, Any] | None = Field(None, description="a table of signals and their values")
    start: float | None = Field(None, description="the moment of the first row in seconds")
    speed: float = Field(1.0, ge=1e-6, le=1e6, description="how many times as fast as recorded, 0.000001 to 1000000")
    loop: bool = Field(False, description="true to begin anew at the end")
    max_gap: float = Field(60.0, ge=0.0, description="the seconds for which a row holds at most")
    outages: list[Any] | None = Field(None, description="a list of [from, to, fault] in seconds")
    silence: float = Field(5.0, ge=0.001, description="the seconds after which a stream says that nothing came")


# A stream looks at the clock this often (s of the event loop): the driver's clock may be any, and may jump.
_POLL_S = 0.02
_MAX_STREAM_SAMPLES = 10_000


@dataclass(frozen=True, slots=True)
class SoftFault:
    """What a failure does: the quality and the sentence of every reading, and what a write raises."""

    quality: Quality
    reason: str
    error: Callable[[str], DriverError]
    reachable: bool = True


FAULTS: dict[str, SoftFault] = {
    "refuse": SoftFault(Quality.NOT_CONNECTED, "the connection is refused", LinkDown, reachable=False),
    "silent": SoftFault(Quality.TIMEOUT, "there is no reply", ReplyTimeout, reachable=False),
    "mismatch": SoftFault(Quality.COMMUNICATION_ERROR, "the reply answers another request", ReplyMismatch),
    "busy": SoftFault(Quality.NO_DATA, "exception 6, server device busy", partial(DeviceException, 6)),
    "failure": SoftFault(Quality.DEVICE_FAILURE, "exception 4, server device failure", partial(DeviceException, 4)),
    # Readings stay good: the device answers and confirms, and keeps what it had.
    "ignore-writes": SoftFault(Quality.GOOD, "the device confirmed the write, but has not stored it", WriteUnverified),
}
_CLOSED = SoftFault(Quality.NOT_CONNECTED, "not opened", LinkDown, reachable=False)


def open_soft(
    settings: Mapping[str, Any], *, clock: Clock, write_map: Sequence[Tag] = (), seed: int = 0
) -> "SoftDriver":
    """Make a soft driver, not yet opened. It needs no seed.

    Settings: `values`, what the tags (by name) hold at first; or a recording: `csv` with its `time_column`, or `times`
    (s) and `columns` (signal: values). A row holds from its time on by the driver's clock, or from `start` on if given
    (the first row's moment), `speed` times as fast; `max_gap` seconds of the recording later it is NO_DATA; `loop`
    begins anew at the end. A tag takes the column of its name, else of its address. `outages` is a list of [from, to,
    fault], seconds since the first `open` and a key of FAULTS. `silence` (s) is a stream's deadline.

    Raises DriverError for a setting or a file that cannot be used.
    """
    checked = check_settings("soft", SoftSettings, settings)
    return SoftDriver(checked, _recording(checked), clock=clock, write_map=tuple(write_map))


class SoftDriver:
    """An in-memory or replayed device; a Driver that Writes and Streams. Made by `open_soft`."""

    def __init__(
        self, settings: SoftSettings, recording: SoftRecording | None, *, clock: Clock, write_map: tuple[Tag, ...]
    ) -> None:
        self._settings = settings
        self._recording = recording
        self._speed: float = settings.speed
        self._clock = clock
        self._write_map = write_map
        self._values: dict[str, tuple[Value | None, Quality, str]] = {}
        self._outages: list[tuple[float, float, str]] = []
        for item in settings.outages or ():
            match item:
                case [int() | float() as begin, int() | float() as end, fault] if begin <= end:
                    self._outages.append((float(begin), float(end), _known_fault(fault)))
                case _:
                    sentence = f"{item!r} is not [from, to, fault] in seconds since the first open"
                    raise DriverError(f"soft: outages: {sentence}")
        self._fault: str | None = None
        self._opened_at: float | None = None
        self._open = False
        self._listeners: set[_Listener] = set()
        self._counts = dict.fromkeys(("requests", "failed", "writes", "dropped"), 0)
        for name, value in (settings.values or {}).items():
            self.put(name, value)

    # ------------------------------------------------------------ the device's side

    def put(self, name: str, value: Value | None, quality: Quality = Quality.GOOD, reason: str = "") -> None:
        """Set what the tag of this name holds from now on (before any recorded value); listeners hear of it."""
        self._values[name] = (value, quality, reason)
        for listener in self._listeners:
            self._counts["dropped"] += listener.hear(name, self._values[name])

    def fail(self, fault: str | None) -> None:
        """Begin a failure (a key of FAULTS) or, with None, end it. Raises DriverError for an unknown one."""
        self._fault = None if fault is None else _known_fault(fault)

    # ------------------------------------------------------------ Driver

    async def open(self) -> None:
        """Begin to answer. Raises LinkDown while the device refuses (it answers once that is over)."""
        self._open = True
        if self._opened_at is None:
            self._opened_at = self._clock()
        fault = self._active_fault()
        if fault is not None and fault.quality is Quality.NOT_CONNECTED:
            raise LinkDown(fault.reason)

    async def close(self) -> None:
        """Stop answering and end all streams. May be called twice."""
        self._open = False
        for listener in self._listeners:
            listener.wake.set()

    @property
    def connected(self) -> bool:
        """True while open and the device is within reach."""
        fault = self._active_fault()
        return self._open and (fault is None or fault.reachable)

    def statistics(self) -> Mapping[str, float]:
        """Counters: readings, readings that failed, writes, and streamed changes dropped for a slow listener."""
        return dict(self._counts)

    async def read(self, tags: Sequence[Tag]) -> list[Sample]:
        """Read all tags now, in order."""
        self._counts["requests"] += 1
        now = self._clock()
        failure = self._failure()
        if failure is not None:
            self._counts["failed"] += 1
            return [Sample(tag.name, None, failure.quality, now, reason=failure.reason) for tag in tags]
        row = self._row(now)
        return [_sample(tag, self._device_value(tag, row, now), now, now) for tag in tags]

    # ------------------------------------------------------------ Writes

    async def write(self, values: Sequence[tuple[Tag, Value]], *, before_sending: BeforeSending = anyhow) -> None:
        """Store all values or none. Raises as `Writes.write` says; nothing is stored then."""
        for tag, _ in values:
            if tag not in self._write_map:
                raise WriteForbidden(f"{tag.name} ({tag.address}) is not in the write map; nothing was sent")
        # Through the registers and back, so that a value is rounded as a real device would round it.
        stored = [(tag, decode(tag, encode(tag, value), one_order=True)[0]) for tag, value in values]
        fault = self._failure() or self._active_fault()
        if fault is not None:
            raise fault.error(fault.reason)
        before_sending()
        self._counts["writes"] += 1
        for tag, value in stored:
            self.put(tag.name, value)

    # ------------------------------------------------------------ Streams

    async def stream(self, tags: Sequence[Tag]) -> AsyncIterator[Sample]:
        """Yield each change that is put and each recorded row as it falls due, from now on and until `close`.

        After `silence` seconds without either, every tag gets one sample of quality TIMEOUT.
        """
        listener = _Listener({tag.name: tag for tag in tags})
        self._listeners.add(listener)
        row, heard, quiet = self._row(self._clock()), self._clock(), False
        try:
            while self._open:
                now = self._clock()
                latest = self._row(now)
                fresh = [] if self._failure() else [*self._rows(listener, row, latest), *listener.changes(now)]
                row = latest
                for sample in fresh:
                    yield sample
                if fresh:
                    heard, quiet = now, False
                elif not quiet and now - heard >= self._settings.silence:
                    quiet = True
                    for tag in tags:
                        yield Sample(tag.name, None, Quality.TIMEOUT, now, reason=f"silent for {now - heard:.3g} s")
                await listener.wait()
        finally:
            self._listeners.discard(listener)

    def _rows(self, listener: "_Listener", after: int, last: int) -> Iterator[Sample]:
        """The recorded rows after one and up to another, signal by signal, at their own times."""
        if self._recording is None:
            return
        # A clock that jumps passes many rows at once; a reader gets the newest of them.
        for row in range(max(after + 1, last - _MAX_STREAM_SAMPLES), last + 1):
            time = self._play_time(self._recording, row)
            for tag in listener.tags.values():
                if tag.name not in self._values:
                    yield _sample(tag, self._device_value(tag, row, time), time, None)

    # ------------------------------------------------------------ inside

    def _device_value(self, tag: Tag, row: int, now: float) -> Reading:
        """What the device holds for the tag: what was put or written, else what the recording says."""
        if tag.name in self._values:
            value, quality, reason = self._values[tag.name]
            return _as_tag(tag, value) if quality is Quality.GOOD else (value, quality, reason)
        if self._recording is None:
            return None, Quality.WAITING_FOR_INITIAL_DATA, "nothing has been put yet"
        return self._recording_value(tag, self._recording, row, now)

    def _recording_value(self, tag: Tag, recording: SoftRecording, row: int, now: float) -> Reading:
        signal = next((name for name in (tag.name, tag.address) if name in recording.columns), None)
        if signal is None:
            names = ", ".join(recording.columns)
            return None, Quality.CONFIGURATION_ERROR, f"the recording has no column {tag.name}; it has {names}"
        if row < 0:
            return None, Quality.WAITING_FOR_INITIAL_DATA, "the recording has not begun"
        age = (now - self._play_time(recording, row)) * self._speed
        if age > self._settings.max_gap:
            return None, Quality.NO_DATA, f"a gap in the recording: its last row is {age:.6g} s old"
        return _as_tag(tag, recording.value(signal, row))

    def _row(self, now: float) -> int:
        if self._recording is None:
            return -1
        start = self._start(self._recording)
        return self._recording.find_row(self._recording.times[0] + (now - start) * self._speed)

    def _play_time(self, recording: SoftRecording, row: int) -> float:
        """The row's moment by the driver's clock."""
        offset = recording.row_time(row) - recording.times[0]
        return self._start(recording) + offset / self._speed

    def _start(self, recording: SoftRecording) -> float:
        start: float | None = self._settings.start
        return recording.times[0] if start is None else start

    def _failure(self) -> SoftFault | None:
        """What keeps readings from being answered at present."""
        if not self._open:
            return _CLOSED
        fault = self._active_fault()
        return fault if fault is not None and fault.quality is not Quality.GOOD else None

    def _active_fault(self) -> SoftFault | None:
        if self._fault is not None:
            return FAULTS[self._fault]
        since = 0.0 if self._opened_at is None else self._clock() - self._opened_at
        return next((FAULTS[fault] for begin, end, fault in self._outages if begin <= since < end), None)


class _Listener:
    """One reader of a stream: the changes that it has not taken yet, the oldest dropped if it is too slow."""

    def __init__(self, tags: Mapping[str, Tag]) -> None:
        self.tags = tags
        self.wake = asyncio.Event()
        self._changes: deque[tuple[Tag, Reading]] = deque(maxlen=_MAX_STREAM_SAMPLES)

    def hear(self, name: str, held: tuple[Value | None, Quality, str]) -> int:
        """Note a change; answers how many changes had to be dropped for it."""
        if name not in self.tags:
            return 0
        dropped = len(self._changes) == _MAX_STREAM_SAMPLES
        value, quality, reason = held
        tag = self.tags[name]
        self._changes.append((tag, _as_tag(tag, value) if quality is Quality.GOOD else (value, quality, reason)))
        self.wake.set()
        return int(dropped)

    def changes(self, now: float) -> list[Sample]:
        """Take what has been heard."""
        taken = [_sample(tag, reading, now, None) for tag, reading in self._changes]
        self._changes.clear()
        return taken

    async def wait(self) -> None:
        """Until something is heard, or it is time to look at the clock."""
        with suppress(TimeoutError):
            async with asyncio.timeout(_POLL_S):
                await self.wake.wait()
        self.wake.clear()


def _sample(tag: Tag, reading: Reading, time: float, sent: float | None) -> Sample:
    value, quality, reason = reading
    return Sample(tag.name, value, quality, time, sent=sent, reason=reason)


def _as_tag(tag: Tag, value: Value | None) -> Reading:
    """A value of the tag's own type, judged by its range; what cannot be one is DECODING_ERROR."""
    if value is None:
        return None, Quality.NO_DATA, "no value here"
    if isinstance(value, str) != (tag.dtype is DType.STRING):
        return None, Quality.DECODING_ERROR, f"{value!r} is not of dtype {tag.dtype}"
    if isinstance(value, str):
        return value, Quality.GOOD, ""
    if not math.isfinite(value):
        return None, Quality.SENSOR_FAILURE, f"the value is {value}"
    if tag.dtype is DType.BOOL or tag.bit is not None:
        return bool(value), Quality.GOOD, ""
    whole = tag.dtype not in (DType.FLOAT32, DType.FLOAT64) and tag.scale == 1.0 and tag.offset == 0.0
    number = int(value) if whole and value == int(value) else float(value)
    return number, *judge(tag, number)


def _recording(settings: SoftSettings) -> SoftRecording | None:
    """The recording that the settings name, if any. Raises DriverError."""
    times, columns = settings.times, settings.columns
    if settings.csv is not None:
        if times is not None or columns is not None:
            raise DriverError("soft: give either csv, or times and columns")
        return load_csv(Path(settings.csv), settings.time_column, loop=settings.loop)
    if times is None and columns is None:
        return None
    if times is None or columns is None:
        raise DriverError("soft: times and columns belong together")
    return make_recording(times, columns, loop=settings.loop)


def _known_fault(fault: object) -> str:
    if not isinstance(fault, str) or fault not in FAULTS:
        raise DriverError(f"soft: unknown fault {fault!r}: known are {', '.join(FAULTS)}")
    return fault
