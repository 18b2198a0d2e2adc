"""Formats of times: which of those that exports write reads a column, and whether more than one does."""

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import lru_cache
from itertools import islice
from typing import Literal

import numpy as np

from sim.lab.recordings import ClockColumns, read_clock
from sim.sha import Array

Order = Literal["year", "day", "month"]

_DATES: tuple[tuple[Order, str], ...] = (
    ("year", "%Y-%m-%d"), ("year", "%Y/%m/%d"), ("year", "%Y.%m.%d"), ("year", "%Y%m%d"),
    ("day", "%d.%m.%Y"), ("day", "%d/%m/%Y"), ("day", "%d-%m-%Y"), ("day", "%d.%m.%y"), ("day", "%d/%m/%y"),
    ("day", "%d-%b-%Y"), ("day", "%d-%b-%y"), ("day", "%d %b %Y"), ("day", "%d/%b/%Y"),
    ("month", "%m/%d/%Y"), ("month", "%m/%d/%y"), ("month", "%m-%d-%Y"), ("month", "%b %d, %Y"), ("month", "%b %d %Y"),
)  # fmt: skip
_TIMES = (
    "%H:%M:%S", "%H:%M:%S.%f", "%H:%M:%S,%f", "%H:%M:%S:%f", "%H:%M", "%H.%M.%S",
    "%I:%M:%S %p", "%I:%M:%S.%f %p", "%I:%M %p",
)  # fmt: skip
_BETWEEN = (" ", "T", ", ", "  ", "_", " - ")
_EPOCHS = (
    ("seconds", 1e9, 4e9),
    ("milliseconds", 1e12, 4e12),
    ("microseconds", 1e15, 4e15),
    ("nanoseconds", 1e18, 4e18),
)
_CHECKED = 400
_LOOKED_AT, _MOST_FORMATS, _ENOUGH = 5, 4, 0.8
_MARKS = re.compile(r"(?<!%)[-/.:, _]")
_DATED = re.compile(r"(?:\d{1,4}[-/. ]|\d{8}\b|[A-Za-z]{3} \d).*\d[:.]\d\d")
_ZONE = re.compile(r" ?(?:[+-]\d\d:?\d\d|Z)$")


@dataclass(frozen=True, slots=True)
class FoundClock:
    """A column (two, with `date`) read as times: `formats` for the map, the `order` of dates, the sample's `times`."""

    place: int
    formats: tuple[str, ...]
    order: Order
    times: Array
    date: int | None = None

    @property
    def zoned(self) -> bool:
        """Whether the formats themselves name a zone, or count since 1970."""
        return any("%z" in each or each.endswith("seconds") for each in self.formats)


def _fits(text: str, format_: str) -> bool:
    # Python compiles an expression for each format: only those whose own marks the text has are worth it.
    if not set(_MARKS.findall(format_)) <= set(text):
        return False
    try:
        datetime.strptime(text, format_)
    except ValueError:
        return False
    return True


def _iso(cell: str) -> bool:
    if not (cell[:4].isdigit() and "-" in cell[4:8] and len(cell) > 10) or "," in cell:
        return False
    try:
        datetime.fromisoformat(cell)
    except ValueError:
        return False
    return True


@lru_cache(maxsize=1024)
def formats_of(cell: str) -> tuple[tuple[Order, str], ...]:
    """The formats of date and time that read one cell, with their order; none for a number or any other text."""
    if not 8 <= len(cell) <= 40 or _DATED.match(cell) is None:
        return ()
    if _iso(cell):
        return (("year", "ISO8601"),)
    zone = _ZONE.search(cell)
    bare, suffix = (cell[: zone.start()], "%z" if zone[0][0] != " " else " %z") if zone else (cell, "")
    found: list[tuple[Order, str]] = []
    for between in _BETWEEN:
        # From the right: a month's name may be followed by the same mark as the date.
        for at in (place for place in range(len(bare)) if bare.startswith(between, place)):
            day, time = bare[:at], bare[at + len(between) :]
            times = [format_ for format_ in _TIMES if _fits(time, format_)] if time[:1].isdigit() else []
            if times:
                found += [
                    (order, f"{date}{between}{format_}{suffix}")
                    for order, date in _DATES
                    if _fits(day, date)
                    for format_ in times
                ]
    return tuple(dict.fromkeys(found))


def is_time(cell: str) -> bool:
    """Whether a cell is a date with a time of day."""
    return bool(formats_of(cell))


def pure_date(cell: str) -> tuple[tuple[Order, str], ...]:
    """The formats of a date without a time of day that read a cell."""
    if not 6 <= len(cell) <= 12 or cell.replace(".", "", 1).isdigit():
        return ()
    return tuple((order, format_) for order, format_ in _DATES if _fits(cell, format_))


def pure_time(cell: str) -> tuple[str, ...]:
    """The formats of a time of day without a date that read a cell."""
    return tuple(format_ for format_ in _TIMES if ":" in cell and _fits(cell, format_))


def clocks_of(place: int, cells: Sequence[str], date: tuple[int, Sequence[str]] | None = None) -> list[FoundClock]:
    """The ways to read a column of times (after a column of dates): one for each order of day and month that fits."""
    if date is not None:
        cells = [f"{day} {time}" for day, time in zip(date[1], cells, strict=True)]
    sample = list(cells[:_CHECKED])
    filled = sum(map(bool, sample))
    clocks: list[FoundClock] = []
    for order in dict.fromkeys(order for cell in sample[:_LOOKED_AT] for order, _ in formats_of(cell)):
        formats, times = tuple[str, ...](), np.full(len(sample), np.nan)
        # A format for the first cell, another for the first that it does not read: fractions of seconds come and go.
        while len(formats) < _MOST_FORMATS:
            unread = (cell for cell, time in zip(sample, times.tolist(), strict=True) if cell and time != time)
            own = (
                format_ for cell in islice(unread, _LOOKED_AT) for each, format_ in formats_of(cell) if each == order
            )
            further = next(own, None)
            if further is None or further in formats:
                break
            formats = (*formats, further)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # pandas' advice on formats, which are given here
                times, _ = read_clock(ClockColumns(column="t", formats=formats), [sample], "auto")
        if np.isfinite(times).sum() >= _ENOUGH * filled:
            clocks.append(FoundClock(place, formats, order, times, None if date is None else date[0]))
    return clocks


def counted_clock(place: int, values: Array, named: bool) -> FoundClock | None:
    """A column of numbers as a clock: since 1970 by its size, or elapsed seconds where its header says so."""
    finite = values[np.isfinite(values)]
    if finite.size < 2 or not (np.all(np.diff(finite) >= 0) or np.all(np.diff(finite) <= 0)):
        return None
    if finite[0] == finite[-1]:
        return None
    for format_, low, high in _EPOCHS:
        if low <= finite.min() and finite.max() < high:
            return FoundClock(place, (format_,), "year", values)
    return FoundClock(place, ("seconds",), "year", values) if named else None
