"""A recorded CAN log as a device: its frames are played by the driver's clock, and values age as on a live bus."""

import asyncio
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import Field

from drivers.can import CanFrame, DecodingSettings
from drivers.codec import Reading
from drivers.driver import Clock, PlanKind, PlanLine
from drivers.errors import LinkDown
from drivers.settings import check_settings
from drivers.tag import Quality, Sample, Tag
from drivers.vehicle.decoding import Decoder
from drivers.vehicle.log import Log, open_log, require_frames


class CanLogSettings(DecodingSettings):
    """How a log is played and read; see `open_can_log`."""

    log: str = Field(min_length=1, description="the path of the log")
    format: str | None = Field(None, min_length=1, description="the log's format where its suffix does not say it")
    bus: str | None = Field(None, min_length=1, description="the bus to listen to, as the log names it")
    speed: float = Field(1.0, ge=1e-6, le=1e6, description="how many times as fast as recorded, 0.000001 to 1000000")
    loop: bool = Field(False, description="true to begin anew at the end")
    start: float | None = Field(None, description="the moment of the first frame in seconds")
    max_gap: float = Field(60.0, ge=0.001, description="the longest pause that is played in seconds, from 0.001")
    silence: float = Field(
        5.0, ge=0.001, description="the seconds without a frame that count as disconnected, from 0.001"
    )


# The event loop gets its turn after so many frames.
_BURST = 500
_MAX_STEP_BACK_S = 1.0
"""Seconds by which logged times may step back as buses are written in turn; more is a clock that was set back."""
_REPLAY_GAP_S = 1.0
"""Seconds between the last frame of a log and its first one when it is played anew."""


@dataclass(slots=True)
class Timeline:
    """When a recorded frame is played: seconds since the first frame, on a line that only goes forward (pure).

    A pause longer than `max_gap` (s) is played as `max_gap` long. A clock that was set back goes on without a pause.
    Counted: steps `back`, and pauses that were `shortened`.
    """

    max_gap: float
    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(("back", "shortened"), 0))
    _shift: float | None = None
    _played: float = 0.0

    def play_time(self, logged: float) -> float:
        """The frame's moment on the line: never before the one given last."""
        if self._shift is None:
            self._shift = self._played - logged
        step = logged + self._shift - self._played
        if step < 0.0:
            self.counts["back"] += 1
        if step < -_MAX_STEP_BACK_S:
            self._shift -= step
        elif step > self.max_gap:
            self.counts["shortened"] += 1
            self._shift -= step - self.max_gap
        self._played = max(self._played, logged + self._shift)
        return self._played

    def again(self) -> None:
        """The log begins anew."""
        self._shift = None
        self._played += _REPLAY_GAP_S


@dataclass(frozen=True, slots=True)
class _Held:
    """A tag's last reading, when it was played (by the driver's clock) and when on the log's line (s)."""

    reading: Reading
    time: float
    played: float


def open_can_log(
    settings: Mapping[str, Any], *, clock: Clock, write_map: Sequence[Tag] = (), seed: int = 0
) -> "CanLogDriver":
    """Make a driver that replays a log, not yet opened. It needs no seed, and cannot write.

    Settings: `log`, the file, and its `format` where the suffix does not say it; `bus`, the one to listen to as the log
    names it (all by default); `speed`; `loop`; `start`, the moment of the first frame by the driver's clock (s; the
    first `open` by default); `max_gap`, the longest pause that is played (s of the log); `silence`, the seconds of the
    log without any frame after which it counts as disconnected. How frames are read, `drivers.can.settings` says.

    Raises DriverError for a setting or a log that cannot be used, and for a log without a data frame.
    """
    checked = check_settings("can-log", CanLogSettings, settings)
    log = open_log(Path(checked.log), checked.format)
    next(log.frames(), None)
    require_frames(log)
    return CanLogDriver(checked, clock=clock)


class CanLogDriver:
    """A log that is played; a Driver. Made by `open_can_log`."""

    def __init__(self, settings: CanLogSettings, *, clock: Clock) -> None:
        self._settings = settings
        self._clock = clock
        self._speed: float = settings.speed
        self._decoder = Decoder(settings)
        self._timeline = Timeline(settings.max_gap)
        self._held: dict[str, _Held] = {}
        self._log = open_log(Path(settings.log), settings.format)
        self._frames: Iterator[CanFrame] = iter(())
        self._next: tuple[CanFrame, float] | None = None
        self._began: float | None = settings.start
        self._last = 0.0
        self._open = self._opened = False
        self._counts = dict.fromkeys(("requests", "frames", "readings", "rounds"), 0)
        self._lock = asyncio.Lock()

    # ------------------------------------------------------------ Driver

    async def open(self) -> None:
        """Begin to play, or to answer again; the log went on meanwhile. Raises LinkDown if the file has gone."""
        self._open = True
        if not self._begin():
            raise LinkDown(f"{self._log.path}: is not there any more")

    def _begin(self) -> bool:
        if not self._opened and self._log.path.is_file():
            self._opened = True
            self._began = self._clock() if self._began is None else self._began
            self._rewind()
        return self._opened

    async def close(self) -> None:
        """Stop answering. May be called twice."""
        self._open = False

    @property
    def connected(self) -> bool:
        """True while open and frames are being played."""
        return self._open and self._counts["frames"] > 0 and self._now() - self._last <= self._settings.silence

    def statistics(self) -> Mapping[str, float]:
        """Counters: readings, frames played, what of the log was no frame, and what became of the frames."""
        log = {f"log_{name}": count for name, count in self._log.counts.items()}
        return {**self._counts, **log, **self._timeline.counts, **self._decoder.counts()}

    async def read(self, tags: Sequence[Tag]) -> list[Sample]:
        """Play what is due; each tag's last value with the time when it was played."""
        self._counts["requests"] += 1
        if not self._open:
            return [self._no(tag, Quality.NOT_CONNECTED, "not opened") for tag in tags]
        if not self._begin():
            return [self._no(tag, Quality.NOT_CONNECTED, f"{self._log.path} is not there any more") for tag in tags]
        async with self._lock:
            self._decoder.listen(tags)
            await self._play()
        now = self._now()
        return [self._sample(tag, now) for tag in tags]

    def explain(self, tags: Sequence[Tag]) -> tuple[PlanLine, ...]:
        """In sentences: what cannot be read and why, the log, and each tag with its timeout."""
        self._decoder.listen(tags)
        problems = self._decoder.problems
        speed = "" if self._speed == 1.0 else f" at {self._speed:g} times its speed"
        heard = [
            PlanLine(f"{tag.address}, bad after {self._decoder.timeout(tag):.3g} s: {tag.name}", PlanKind.HEARD)
            for tag in tags
            if tag.name not in problems
        ]
        refused = [PlanLine(line, PlanKind.PROBLEM) for line in problems.values()]
        return (*refused, PlanLine(f"{self._log.path} is replayed{speed}"), *heard)

    # ------------------------------------------------------------ inside

    def _now(self) -> float:
        """Where the log is by the driver's clock: seconds since its first frame."""
        return (self._clock() - (self._began or 0.0)) * self._speed

    async def _play(self) -> None:
        """Take every frame that is due."""
        due, burst = self._now(), 0
        while self._next is not None and self._next[1] <= due:
            frame, played = self._next
            self._take(frame, played)
            self._next = self._next_frame()
            burst += 1
            if burst % _BURST == 0:
                await asyncio.sleep(0)

    def _take(self, frame: CanFrame, played: float) -> None:
        self._last = played
        self._counts["frames"] += 1
        moment = (self._began or 0.0) + played / self._speed
        # Timeouts of the transport protocols run on the line that is played, which never goes back.
        for reading in self._decoder.take(frame._replace(time=played)):
            self._counts["readings"] += 1
            self._held[reading.tag.name] = _Held(reading.reading, moment, played)

    def _next_frame(self) -> tuple[CanFrame, float] | None:
        """The next frame of the bus and its moment on the line; with `loop` the log never ends."""
        for _ in range(2):
            for frame in self._frames:
                if self._settings.bus in (None, frame.channel):
                    return frame, self._timeline.play_time(frame.time)
            if not self._settings.loop:
                return None
            self._timeline.again()
            self._rewind_log()
        return None

    def _rewind(self) -> None:
        self._rewind_log()
        self._next = self._next_frame()

    def _rewind_log(self) -> None:
        self._counts["rounds"] += 1
        log = Log(self._log.path, self._log.format, self._log.counts, self._log.problem)
        self._log, self._frames = log, log.frames()

    def _sample(self, tag: Tag, now: float) -> Sample:
        problem = self._decoder.problems.get(tag.name)
        if problem is not None:
            return self._no(tag, Quality.CONFIGURATION_ERROR, problem)
        held = self._held.get(tag.name)
        if held is None:
            return self._no(tag, Quality.WAITING_FOR_INITIAL_DATA, self._waiting("the log has not told it yet"))
        limit = self._decoder.timeout(tag)
        if now - held.played > limit:
            reason = f"told {now - held.played:.3g} s ago, limit {limit:g} s"
            return self._no(tag, Quality.TIMEOUT, self._waiting(reason))
        value, quality, reason = held.reading
        return Sample(tag.name, value, quality, held.time, reason=reason)

    def _waiting(self, reason: str) -> str:
        return reason if self._next is not None else f"{reason}; the log has ended"

    def _no(self, tag: Tag, quality: Quality, reason: str) -> Sample:
        return Sample(tag.name, None, quality, self._clock(), reason=reason)
