"""Formats of times: which of those that exports write reads a column, and whether more than one does."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import lru_cache
from itertools import product
from typing import Literal

import numpy as np

from sim.sha import Array
from sim.traces import ClockColumns, read_clock

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


@dataclass(frozen=True, slots=True)
class Clock:
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


@lru_cache(maxsize=4096)
def _fits(cell: str, format_: str) -> bool:
    try:
        datetime.strptime(cell, format_)
    except ValueError:
        return False
    return True


def _iso(cell: str) -> bool:
    if not ("-" in cell and len(cell) > 10 and cell[:4].isdigit()):
        return False
    try:
        datetime.fromisoformat(cell)
    except ValueError:
        return False
    return "," not in cell


@lru_cache(maxsize=4096)
def formats_of(cell: str) -> tuple[tuple[Order, str], ...]:
    """The formats of date and time that read one cell, with their order; none for a number or any other text."""
    if len(cell) < 8 or not any(char.isdigit() for char in cell) or len(cell) > 40:
        return ()
    if _iso(cell):
        return (("year", "ISO8601"),)
    found: list[tuple[Order, str]] = []
    for (order, date), between in product(_DATES, _BETWEEN):
        if between in cell or between == "T":
            found += [
                (order, f"{date}{between}{time}{zone}")
                for time in _TIMES
                for zone in ("", "%z", " %z")
                if _fits(cell, f"{date}{between}{time}{zone}")
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


def clocks_of(place: int, cells: Sequence[str], date: tuple[int, Sequence[str]] | None = None) -> list[Clock]:
    """The ways to read a column of times (after a column of dates): one for each order of day and month that fits."""
    if date is not None:
        cells = [f"{day} {time}" for day, time in zip(date[1], cells, strict=True)]
    sample = list(cells[:_CHECKED])
    known = [formats_of(cell) for cell in sample if cell]
    clocks: list[Clock] = []
    for order in dict.fromkeys(order for formats in known for order, _ in formats):
        chosen: list[str] = []
        for formats in known:
            own = [format_ for each, format_ in formats if each == order]
            if own and not set(own) & set(chosen):
                chosen.append(own[0])
        if not 0 < len(chosen) <= 4:
            continue
        clock = ClockColumns(column="t", formats=tuple(chosen))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # pandas' advice on formats, which are given here
            times, _ = read_clock(clock, [sample], "auto")
        if np.isfinite(times).sum() >= 0.8 * len(known):
            clocks.append(Clock(place, tuple(chosen), order, times, None if date is None else date[0]))
    return clocks


def counted_clock(place: int, values: Array, named: bool) -> Clock | None:
    """A column of numbers as a clock: since 1970 by its size, or elapsed seconds where its header says so."""
    finite = values[np.isfinite(values)]
    if finite.size < 2 or not (np.all(np.diff(finite) >= 0) or np.all(np.diff(finite) <= 0)):
        return None
    if finite[0] == finite[-1]:
        return None
    for format_, low, high in _EPOCHS:
        if low <= finite.min() and finite.max() < high:
            return Clock(place, (format_,), "year", values)
    return Clock(place, ("seconds",), "year", values) if named else None
