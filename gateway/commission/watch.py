"""`plc read --watch`: tags read again and again, live on a terminal, as plain lines elsewhere; marks in time."""

import asyncio
import signal
import sys
import time
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager, closing, contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import click
from rich.box import SIMPLE_HEAD
from rich.live import Live
from rich.table import Table
from rich.text import Text

from drivers.survey import Raw
from drivers.tag import Sample, Tag, Value
from gateway.commission.options import SharedOptions
from gateway.commission.read import How, select_tags, shown_value
from gateway.commission.session import Site, perform, read_samples, running_gateway
from gateway.commission.survey import reference_number
from gateway.console import CommandResult, Part, Rows

WIDTH = 48
"""Readings in a sparkline."""
_BARS = "▁▂▃▄▅▆▇█"
_BAD, _NOTHING = "×", " "

Look = Callable[[], Awaitable[list[Raw]]]


@dataclass(slots=True)
class WatchedTag:
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
        number = sample_number(sample)
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


def sample_number(sample: Sample) -> float | None:
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
async def open_look(site: Site, tags: Sequence[Tag]) -> AsyncIterator[Look]:
    """A way to read the tags again and again: through the running gateway, or by one connection. Raises DriverError."""
    line = running_gateway(site.target)
    if line is not None:
        by_name = {tag.name: tag for tag in tags}

        async def read_gateway() -> list[Raw]:
            _, samples = await asyncio.to_thread(read_samples, line, tags, site.target.tags)
            return [Raw(by_name[sample.tag], sample, by_name[sample.tag].address, 1) for sample in samples]

        site.notes.append("read through the running gateway, which shows values and no raw words")
        with closing(line):
            yield read_gateway
    elif site.target.capabilities.registers:
        async with site.registers() as survey:
            yield lambda: survey.tags(tags)
    else:
        async with site.driver() as driver:

            async def read_driver() -> list[Raw]:
                samples = await driver.read(tags)
                return [Raw(tag, sample, tag.address, 1) for tag, sample in zip(tags, samples, strict=True)]

            yield read_driver


async def watch_tags(
    look: Look,
    seen: Sequence[WatchedTag],
    period: float,
    stop: asyncio.Event,
    show: Callable[[Sequence[WatchedTag]], None],
) -> None:
    """Look once a period, on absolute deadlines, until `stop`; `show` gets the tags whose reading is another one."""
    due = time.monotonic()
    while not stop.is_set():
        raws = await look()
        by_name = {raw.tag.name: raw for raw in raws}
        show([watched for watched in seen if watched.tag.name in by_name and watched.take(by_name[watched.tag.name])])
        # Deadlines are absolute, so that the period holds on average; those that a slow reading overran are dropped.
        due = max(due + period, time.monotonic())
        try:
            async with asyncio.timeout(due - time.monotonic()):
                await stop.wait()
        except TimeoutError:
            continue


def make_mark(seen: Sequence[WatchedTag], number: int, now: float) -> Mark:
    """A mark of this moment."""
    return Mark(
        number, now, {watched.tag.name: watched.last.sample.value if watched.last else None for watched in seen}
    )


_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_WIDE = 150
"""Columns of a terminal from which raw words and reference numbers are shown too."""


def watch(given: SharedOptions, what: Sequence[str], how: How, period: float, seconds: float | None) -> None:
    """Carry out `decanter plc read --watch`, whose options and help are in commission/read.py."""
    arguments = {"what": list(what), "period": period, "seconds": seconds}

    async def work(site: Site) -> CommandResult:
        seen = [WatchedTag(tag) for tag in select_tags(site, what, how)]
        marks: list[Mark] = []
        live = sys.stdout.isatty() and not given.as_json

        def mark() -> bool:
            entered = bool(sys.stdin.readline())  # "" is the end of the input: Enter is not listened for any more
            if entered:
                marks.append(make_mark(seen, len(marks) + 1, time.time()))
            return entered

        with _stop_event(seconds, mark if live and sys.stdin.isatty() else None) as stop:
            async with open_look(site, [watched.tag for watched in seen]) as look:
                if live:
                    # Drawn when a reading comes, not by rich's own thread: the view is of one moment.
                    with Live(auto_refresh=False) as screen:

                        def draw(_: Sequence[WatchedTag]) -> None:
                            view = _view(site.target.place, seen, marks, screen.console.width)
                            screen.update(view, refresh=True)

                        await watch_tags(look, seen, period, stop, draw)
                else:
                    # With --json the end alone is printed.
                    await watch_tags(look, seen, period, stop, (lambda _: None) if given.as_json else _lines)
        rows = [watched.plain() for watched in seen]
        data = {"tags": rows, "marks": [{"number": m.number, "time": m.time, "values": dict(m.values)} for m in marks]}
        never = next((row for row in rows if not row["good"] and row["quality"] != "GOOD"), None)
        return CommandResult(data, f"{never['tag']} was never good: {never['reason']}" if never else "")

    perform(given, "watch", arguments, work, _final_view)


@contextmanager
def _stop_event(seconds: float | None, on_enter: Callable[[], bool] | None) -> Iterator[asyncio.Event]:
    """An event that is set by Ctrl-C, by SIGTERM, and after `seconds`; Enter calls `on_enter` while that says True."""
    stop, loop = asyncio.Event(), asyncio.get_running_loop()

    def on_input() -> None:
        if on_enter is not None and not on_enter():
            loop.remove_reader(sys.stdin)

    for number in _SIGNALS:
        loop.add_signal_handler(number, stop.set)
    if seconds is not None:
        loop.call_later(seconds, stop.set)
    if on_enter is not None:
        loop.add_reader(sys.stdin, on_input)
    try:
        yield stop
    finally:
        for number in _SIGNALS:
            loop.remove_signal_handler(number)
        if on_enter is not None:
            loop.remove_reader(sys.stdin)


def _view(place: str, seen: Sequence[WatchedTag], marks: Sequence[Mark], width: int) -> Table:
    caption = "Enter: mark   Ctrl-C: end"
    if marks:
        caption = f"mark {marks[-1].number} at {clock_time(marks[-1].time)}   {caption}"
    grid = Table(
        title=Text(place), caption=Text(caption), title_justify="left", caption_justify="left", box=SIMPLE_HEAD
    )
    wide = width >= _WIDE
    for column in ("tag", *(("address", "raw") if wide else ()), "value", "quality", "age", "min", "max"):
        grid.add_column(column, justify="right" if column in ("value", "age", "min", "max") else "left", no_wrap=True)
    if marks:
        grid.add_column("at mark", justify="right", no_wrap=True)
    grid.add_column("last readings", no_wrap=True)
    for watched in seen:
        tag, last = watched.tag, watched.last
        sample = last.sample if last else None
        cells = [tag.name]
        if wide:
            raw = " ".join(f"{word:04X}" for word in last.raw) if last and last.raw else ""
            cells += [" ".join(filter(None, (tag.address, reference_number(tag.address)))), raw]
        cells += [" ".join(filter(None, (_cell(sample.value if sample else None), tag.unit)))]
        # The device's clock may be ahead of this one, and an age is not negative.
        cells += ["", ""] if sample is None else [sample.quality.name, f"{max(0.0, time.time() - sample.time):.1f} s"]
        cells += [_cell(watched.low), _cell(watched.high)]
        if marks:
            cells += [_cell(marks[-1].values.get(tag.name))]
        cells += [tag_sparkline(watched, width)]
        style = "" if sample is not None and sample.quality.is_good else "red"
        grid.add_row(*(Text(cell, style=style) for cell in cells))
    return grid


def tag_sparkline(watched: WatchedTag, width: int) -> str:
    """As much of the last readings as a terminal of this width has room for."""
    # The other columns take about 70 characters, and 40 more with raw words and reference numbers.
    return sparkline(watched.history, max(8, min(WIDTH, width - (110 if width >= _WIDE else 70))))


def _cell(value: Any) -> str:
    return "" if value is None else str(shown_value(value))


def clock_time(moment: float) -> str:
    """The time of day with tenths, UTC."""
    return datetime.fromtimestamp(moment, UTC).strftime("%H:%M:%S.%f")[:-5]


def _lines(changed: Sequence[WatchedTag]) -> None:
    """A line for each tag that changed."""
    for watched in changed:
        tag, last = watched.tag, watched.last
        if last is None:
            continue
        sample = last.sample
        raw = " ".join(f"{word:04X}" for word in last.raw) if last.raw else ""
        words = (clock_time(sample.time), tag.name, _cell(sample.value), tag.unit, sample.quality.name)
        click.echo("  ".join(filter(None, (*words, raw, sample.reason))))


def _final_view(data: Mapping[str, Any]) -> Iterator[Part]:
    columns = ("tag", "value", "unit", "quality", "min", "max", "good", "bad", "changes")
    yield Rows(
        "watched", columns, [row | {key: _cell(row[key]) for key in ("value", "min", "max")} for row in data["tags"]]
    )
    yield from (f"mark {mark['number']} at {clock_time(mark['time'])}" for mark in data["marks"])
