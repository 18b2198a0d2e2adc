"""`watch` at work: tags read again and again, what each of them has done since the beginning, and marks in time."""

import asyncio
import time
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

from drivers.survey import Raw, open_registers
from drivers.tag import Sample, Tag, Value
from gateway.commission.outcome import Site
from gateway.commission.through import read_through, running_gateway

WIDTH = 48
"""Readings in a sparkline."""
_BARS = "▁▂▃▄▅▆▇█"
_BAD, _NOTHING = "×", " "

Look = Callable[[], Awaitable[list[Raw]]]


@dataclass(slots=True)
class Seen:
    """One tag since the watch began: the last readings as numbers (None: bad), extremes, counts."""

    tag: Tag
    last: Raw | None = None
    history: deque[float | None] = field(default_factory=lambda: deque(maxlen=WIDTH))
    low: float | None = None
    high: float | None = None
    good: int = 0
    bad: int = 0
    changes: int = 0

    def take(self, raw: Raw) -> bool:
        """Take in a reading; True if its value or its quality is another one than before."""
        before, sample = self.last.sample if self.last else None, raw.sample
        changed = before is None or (before.value, before.quality) != (sample.value, sample.quality)
        self.changes += before is not None and changed
        self.last = raw
        number = number_of(sample)
        self.history.append(number)
        if number is None:
            self.bad += not sample.quality.is_good
            return changed
        self.good += 1
        self.low = number if self.low is None else min(self.low, number)
        self.high = number if self.high is None else max(self.high, number)
        return changed

    def plain(self) -> dict[str, Any]:
        """As JSON."""
        sample = self.last.sample if self.last else None
        return {
            "tag": self.tag.name,
            "address": self.tag.address,
            "unit": self.tag.unit,
            "value": sample.value if sample else None,
            "quality": sample.quality.name if sample else None,
            "reason": sample.reason if sample else "",
            "min": self.low,
            "max": self.high,
            "good": self.good,
            "bad": self.bad,
            "changes": self.changes,
        }


@dataclass(frozen=True, slots=True)
class Mark:
    """A moment that the engineer marked (s UTC), and what the tags read then."""

    number: int
    time: float
    values: Mapping[str, Value | None]


def number_of(sample: Sample) -> float | None:
    """A good sample's value as a number (a flag is 0 or 1); None for a bad one, and for text."""
    if not sample.quality.is_good or sample.value is None or isinstance(sample.value, str):
        return None
    return float(sample.value)


def sparkline(history: Sequence[float | None], width: int = WIDTH) -> str:
    """The readings as bars between their least and their greatest, a cross for a bad one; `width` characters."""
    numbers = [number for number in history if number is not None]
    low, high = min(numbers, default=0.0), max(numbers, default=0.0)
    span = high - low
    bars = [
        _BAD if number is None else _BARS[0 if span == 0 else round((number - low) / span * (len(_BARS) - 1))]
        for number in list(history)[-width:]
    ]
    return "".join(bars).rjust(width, _NOTHING)


@asynccontextmanager
async def looking(site: Site, tags: Sequence[Tag]) -> AsyncIterator[Look]:
    """A way to read the tags again and again: through the running gateway, or by one connection. Raises DriverError."""
    line = running_gateway(site.target)
    if line is not None:
        by_name = {tag.name: tag for tag in tags}

        async def through() -> list[Raw]:
            _, samples = await asyncio.to_thread(read_through, line, tags, site.target.tags)
            return [Raw(by_name[sample.tag], sample, by_name[sample.tag].address, 1) for sample in samples]

        site.notes.append("read through the running gateway, which shows values and no raw words")
        try:
            yield through
        finally:
            line.close()
    elif site.target.capabilities.registers:
        async with open_registers(site.target.driver, site.target.settings, clock=time.time) as survey:
            try:
                yield lambda: survey.tags(tags)
            finally:
                site.count(survey.statistics())
    else:
        async with site.target.opened() as driver:

            async def driven() -> list[Raw]:
                samples = await driver.read(tags)
                return [Raw(tag, sample, tag.address, 1) for tag, sample in zip(tags, samples, strict=True)]

            try:
                yield driven
            finally:
                site.count(driver.statistics())


async def watch(
    look: Look, seen: Sequence[Seen], period: float, stop: asyncio.Event, show: Callable[[Sequence[Seen]], None]
) -> None:
    """Look once a period, on absolute deadlines, until `stop`; `show` gets the tags whose reading is another one."""
    due = time.monotonic()
    while not stop.is_set():
        raws = await look()
        by_name = {raw.tag.name: raw for raw in raws}
        show([one for one in seen if one.tag.name in by_name and one.take(by_name[one.tag.name])])
        due = max(due + period, time.monotonic())
        try:
            async with asyncio.timeout(due - time.monotonic()):
                await stop.wait()
        except TimeoutError:
            continue


def marked(seen: Sequence[Seen], number: int, now: float) -> Mark:
    """A mark of this moment."""
    return Mark(number, now, {one.tag.name: one.last.sample.value if one.last else None for one in seen})
