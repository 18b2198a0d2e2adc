"""Formats of times: which of those that exports write reads a column, and whether more than one does."""

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import lru_cache
from itertools import islice, pairwise
from typing import Literal

import numpy as np

from sim.lab.recordings import (
    COUNTS,
    ELAPSED_MINUTES,
    ClockColumns,
    dated_format,
    elapsed_seconds,
    join_days,
    numbers,
    plain_time,
    read_clock,
    since_1970,
    unroll_midnight,
)
from sim.lab.recordings.mapping.words import named_time
from sim.sha import Array

Order = Literal["year", "day", "month"]

_DATES: tuple[tuple[Order, str], ...] = (
    ("year", "%Y-%m-%d"), ("year", "%Y/%m/%d"), ("year", "%Y.%m.%d"), ("year", "%Y%m%d"),
    ("year", "%G-W%V-%u"), ("year", "%Y-%j"), ("year", "%Y/%j"), ("year", "%y-%m-%d"), ("year", "%y/%m/%d"),
    ("day", "%d.%m.%Y"), ("day", "%d/%m/%Y"), ("day", "%d-%m-%Y"), ("day", "%d.%m.%y"), ("day", "%d/%m/%y"),
    ("day", "%d-%b-%Y"), ("day", "%d-%b-%y"), ("day", "%d %b %Y"), ("day", "%d/%b/%Y"),
    ("day", "%d-%m-%y"), ("day", "%d %m %Y"), ("day", "%d %b %y"), ("year", "%Y-%b-%d"), ("year", "%Y %b %d"),
    ("month", "%b-%d-%Y"), ("month", "%m/%d/%Y"), ("month", "%m/%d/%y"), ("month", "%m-%d-%Y"),
    ("month", "%b %d, %Y"), ("month", "%b %d %Y"), ("month", "%b %d %y"), ("month", "%b %d, %y"),
)  # fmt: skip
_TIMES = (
    "%H:%M:%S", "%H:%M:%S.%f", "%H:%M:%S,%f", "%H:%M:%S:%f", "%H:%M", "%H.%M.%S", "%H.%M",
    "%H-%M-%S", "%I:%M:%S %p", "%I:%M:%S.%f %p", "%I:%M %p", "%I.%M.%S %p", "%I.%M.%S.%f %p",
)  # fmt: skip
_DATE_TIME_MARKS = (" ", "T", ", ", "  ", "_", " - ", "-", ":", "/")
_COUNT_UNITS = {
    "s": "seconds", "sec": "seconds", "seconds": "seconds", "ms": "milliseconds", "msec": "milliseconds",
    "milliseconds": "milliseconds", "us": "microseconds", "µs": "microseconds", "ns": "nanoseconds", "min": "minutes",
    "minutes": "minutes", "h": "hours", "hr": "hours", "hours": "hours", "d": "days", "days": "days",
}  # fmt: skip
"""Units of elapsed time as headers write them."""
_WORDS = re.compile(r"[^\W\d_]+")
_TENTHS_OF_US = re.compile(r"100 ?ns", re.IGNORECASE)
"""What Windows and .NET count in, which is no unit of elapsed time."""
_COMPACT = re.compile(
    r"((?:19|20)\d{6}|(?:19|20)\d\dW\d{3}|(?:19|20)\d{5}(?=T))([T_-]?)\d{6}(\.\d{3,6}|\d{3})?( ?(?:[+-]\d\d:?\d\d|Z))?"
)
"""Of our centuries, and with milliseconds at most: ticks and nanoseconds are as many digits."""
_COMPACT_DATES = {8: "%Y%m%d", 7: "%Y%j"}
"""By their digits; those of a week have its W."""
_ROUNDED = re.compile(r"\d[.,]\d+[eE]\+?\d\d$")
_MAX_CHECKED_CELLS = 400
_LOOKED_AT, _MOST_FORMATS, _ENOUGH = 5, 4, 0.8
_MARKS = re.compile(r"(?<!%)[-/.:, _]")
_DATED = re.compile(r"(?:\d{1,4}[-/. ]|\d{8}\b|[A-Za-z]{3}[- ]\d|\d\d?:\d\d).*\d(?:[:.]\d\d|\d [AP]M$|\d$)")
_ZONE = re.compile(r" ?(?:[+-]\d\d:?\d\d|Z)$")


@dataclass(frozen=True, slots=True)
class FoundClock:
    """A column (two, with `date`) read as times: `formats` for the map, the `order` of dates, the sample's `times`."""

    place: int
    formats: tuple[str, ...]
    order: Order
    times: Array
    date: int | None = None
    decimal: Literal["auto", ".", ","] = "auto"

    @property
    def has_zone(self) -> bool:
        """Whether the formats themselves name a zone, or count since 1970."""
        return any("%z" in each or (each in COUNTS and not COUNTS[each].local) for each in self.formats)


def _fits(text: str, format_: str) -> bool:
    # Python compiles an expression for each format: only those whose own marks the text has are worth it.
    if not set(_MARKS.findall(format_)) <= set(text) or ("%j" in format_ and not _DAY_OF_YEAR.match(text)):
        return False
    try:
        datetime.strptime(text, format_)
    except ValueError:
        return False
    return True


_DAY_OF_YEAR = re.compile(r"\d{4}[-/]?\d{3}(?!\d)")
"""Three digits: of fewer, as in 2024-12, nobody knows whether they are a month."""


def _iso(cell: str) -> bool:
    # Weeks are ISO 8601 too, but not what reads a format of that name; nor any mark between day and time.
    if not (cell[:4].isdigit() and "-" in cell[4:8] and cell[10:11] in ("T", " ")) or "," in cell or cell[5] == "W":
        return False
    try:
        datetime.fromisoformat(cell)
    except ValueError:
        return False
    return True


@lru_cache(maxsize=1024)
def time_formats(cell: str) -> tuple[tuple[Order, str], ...]:
    """The formats of date and time that read one cell, with their order; none for a number or any other text."""
    found = _match_formats(cell)
    # Words of other languages, zones in words, the hour 24: reading knows them too.
    return found or (
        _match_formats(plain_time(cell).replace(" 24:", " 00:")) if 8 <= len(cell) <= _MAX_TIME_CHARS else ()
    )


_MAX_TIME_CHARS = 90
"""Characters of a time: JavaScript spells out the name of the zone."""


def _match_formats(cell: str) -> tuple[tuple[Order, str], ...]:
    if (match := _COMPACT.fullmatch(cell)) is not None:
        date = "%GW%V%u" if "W" in match[1] else _COMPACT_DATES[len(match[1])]
        parts = "" if match[3] is None else ".%f" if match[3].startswith(".") else "%f"
        offset = "" if match[4] is None else " %z" if match[4].startswith(" ") else "%z"
        format_ = f"{date}{match[2]}%H%M%S{parts}{offset}"
        return (("year", format_),) if _fits(cell, format_) else ()
    if not 8 <= len(cell) <= 40 or _DATED.match(cell) is None:
        return ()
    if _iso(cell):
        return (("year", "ISO8601"),)
    zone = _ZONE.search(cell)
    bare, suffix = (cell[: zone.start()], "%z" if zone[0][0] != " " else " %z") if zone else (cell, "")
    found: list[tuple[Order, str]] = []
    for between in _DATE_TIME_MARKS:
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
            elif "%" not in suffix:
                # The time before the date.
                found += [
                    (order, f"{format_}{between}{date}")
                    for order, date in _DATES
                    if ":" in day and _fits(time, date)
                    for format_ in _TIMES
                    if _fits(day, format_)
                ]
    return tuple(dict.fromkeys(found))


def is_time(cell: str) -> bool:
    """Whether a cell is a date with a time of day."""
    return bool(time_formats(cell))


def pure_date(cell: str) -> tuple[tuple[Order, str], ...]:
    """The formats of a date without a time of day that read a cell, which may have the words that times have."""
    if _IN_WORDS.fullmatch(cell):
        cell = plain_time(cell)
    if not 6 <= len(cell) <= 12 or cell.replace(".", "", 1).isdigit():
        return ()
    return tuple((order, format_) for order, format_ in _DATES if _fits(cell, format_))


_IN_WORDS = re.compile(r"(?=.*\d\d)(?=.*[^\W\d_]{2}).{8,30}")
"""What may be a date with a day of the week, or with a month of any language."""


def whole_day(cell: str) -> tuple[tuple[Order, str], ...]:
    """The formats of a date alone that read a cell: without a time, with its midnight, or as a number of our times."""
    bare = join_days([cell], [""])[0].strip()
    compact = "%Y%m%d"
    return ((("year", compact),) if _fits(bare, compact) else ()) if _COMPACT_DAY.fullmatch(bare) else pure_date(bare)


_COMPACT_DAY = re.compile(r"(?:19|20)\d{6}")


def bare_time(cells: Sequence[str], header: str) -> str:
    """The format of a column of times of day that are written like numbers, 06.00 or 060000; "" for other numbers.

    It tells them from numbers by their digits only: they are times beside a column of days and under a name of time.
    """
    shown = set(cells) - {""}
    if len(shown) < 2 or any(word in _COUNT_UNITS for word in _WORDS.findall(header.casefold())):
        return ""
    form = next((form for form, written in _BARE_TIMES.items() if all(map(written.fullmatch, shown))), "")
    # Halves of hours: minutes are not 00 and 50 alone.
    return "" if form == "%H.%M" and {cell[-2:] for cell in shown} == {"00", "50"} else form


_BARE_TIMES = {
    "%H.%M": re.compile(r"(?:[01]?\d|2[0-3])\.[0-5]\d"),
    "%H%M%S": re.compile(r"(?:[01]\d|2[0-3])[0-5]\d[0-5]\d"),
    "%H%M": re.compile(r"(?:[01]\d|2[0-3])[0-5]\d"),
}


def bare_times_clocks(place: int, cells: Sequence[str], date: tuple[int, Sequence[str]], form: str) -> list[FoundClock]:
    """The ways to read times that are written like numbers, in `form`, after a column of dates."""
    found: dict[Order, FoundClock] = {}
    joined = join_days(date[1], cells)
    for order, day in whole_day(next(filter(None, date[1]), "")):
        formats = (f"{day} {form}",)
        times, _ = read_clock(ClockColumns(column="t", formats=formats), [joined], "auto")
        if np.isfinite(times).sum() >= _ENOUGH * sum(map(bool, cells)):
            found.setdefault(order, FoundClock(place, formats, order, times, date[0]))
    return list(found.values())


def pure_time(cell: str) -> tuple[str, ...]:
    """The formats of a time of day without a date that read a cell."""
    marked = ":" in cell or cell.count(".") == 2
    if ":" in cell and elapsed_seconds(cell) is not None:
        return ("%H:%M:%S",)
    return tuple(format_ for format_ in _TIMES if marked and _fits(cell, format_))


def find_clocks(place: int, cells: Sequence[str], date: tuple[int, Sequence[str]] | None = None) -> list[FoundClock]:
    """The ways to read a column of times (after a column of dates): one for each order of day and month that fits."""
    if date is not None:
        cells = join_days(date[1], cells)
    # The last row may be that of the export's own moment, in another form.
    sample = [*cells[:_MAX_CHECKED_CELLS], *cells[_MAX_CHECKED_CELLS:][-_LOOKED_AT:]]
    filled = sum(map(bool, sample))
    clocks: list[FoundClock] = []
    for order in dict.fromkeys(order for cell in sample[:_LOOKED_AT] for order, _ in time_formats(cell)):
        formats, times = tuple[str, ...](), np.full(len(sample), np.nan)
        # A format for the first cell, another for the first that it does not read: fractions of seconds come and go.
        while len(formats) < _MOST_FORMATS:
            unread = (cell for cell, time in zip(sample, times.tolist(), strict=True) if cell and time != time)
            # A month in words stands where it wants.
            own = (
                format_
                for cell in islice(unread, _LOOKED_AT)
                for each, format_ in time_formats(cell)
                if each == order or "%b" in format_
            )
            further = next(own, None)
            if further is None or further in formats:
                break
            formats = (*formats, further)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # pandas' advice on formats, which are given here
                times, _ = read_clock(ClockColumns(column="t", formats=formats), [sample], "auto")
        if np.isfinite(times).sum() >= _ENOUGH * filled:
            # Rows that follow one another: their steps are held against another clock's.
            first = times[:_MAX_CHECKED_CELLS]
            clocks.append(FoundClock(place, formats, order, first, None if date is None else date[0]))
    return clocks


_MINUTES_NAMED = re.compile(r"(?<![a-z:])m(?:in|m)?:ss?(?:ec)?(?![a-z:])", re.IGNORECASE)
"""Two numbers with a colon that the header says are minutes and seconds."""


def counts_minutes(header: str, cell: str) -> bool:
    """Whether a cell is minutes and seconds, by what its header says."""
    return _MINUTES_NAMED.search(header) is not None and elapsed_seconds(cell, minutes=True) is not None


def daily_clock(place: int, cells: Sequence[str], header: str) -> list[FoundClock]:
    """A column of times of day of which no column says the day: they roll over at midnight, or are counted on."""
    first = next(filter(None, cells), "")
    formats = (ELAPSED_MINUTES,) if counts_minutes(header, first) else pure_time(first)[:1]
    times, _ = read_clock(ClockColumns(column="t", formats=formats), [cells], "auto")
    enough = np.isfinite(times).sum() >= _ENOUGH * sum(map(bool, cells))
    return [FoundClock(place, formats, "year", unroll_midnight(times))] if enough else []


_OF_DAY = {"hours": 24.0, "minutes": 1440.0, "seconds": 86400.0, "milliseconds": 86.4e6, "days": 1.0}
"""Counts since midnight, and how many a day has of them."""
_HOUR = re.compile(
    r"\W*(?:dec(?:imal)?[ _-]?|dezimal[ _-]?)?(?:hours?|stunden?|or[ae]|heures?|horas?)(?:[ _]of[ _](?:the[ _])?day)?"
    r"\W*h?\W*",
    re.IGNORECASE,
)


_SURE_SHARE = 0.1
"""Of a day, after which a count of a single day surely began at its midnight."""


def counts_of_day(
    place: int, cells: Sequence[str], header: str, date: tuple[int, Sequence[str]], decimal: Literal["auto", ".", ","]
) -> list[FoundClock]:
    """The ways to read counts since midnight, such as decimal hours, after a column of dates; none for other numbers.

    A header without a unit says hours, or shows the part of the day that a spreadsheet has written as a number.
    """
    values = numbers(cells, decimal)[0]
    finite = values[np.isfinite(values)]
    called = _HOUR.fullmatch(header) is not None
    if not (called or named_time(header)) or not finite.size or finite.min() < 0:
        return []
    units = {_COUNT_UNITS[word] for word in _WORDS.findall(header.casefold()) if word in _COUNT_UNITS}
    if called:
        units = {"hours"}
    elif not units and finite.max() < 1.0:
        units = {"days"}
    if len(units) != 1 or (unit := units.pop()) not in _OF_DAY or finite.max() >= _OF_DAY[unit]:
        return []
    if unit in ("hours", "days") and not np.any(finite % 1):
        return []  # the hour alone, whose minutes stand elsewhere or were not kept
    # Of one day alone, what begins at 0 may as well be counted from the recording's beginning.
    if len(set(date[1])) == 1 and not (called or unit == "days") and finite[0] < _SURE_SHARE * _OF_DAY[unit]:
        return []
    found: dict[Order, FoundClock] = {}
    for order, day in whole_day(next(filter(None, date[1]), "")):
        formats = (f"{day} {unit}",)
        times, _ = read_clock(ClockColumns(column="t", date="d", formats=formats), [cells, date[1]], decimal)
        known = times[np.isfinite(times)]
        steps = np.diff(known)
        # Seconds that stand beside a clock, and are 0 throughout, count no day.
        moves = np.count_nonzero(steps) > 0.5 * steps.size
        if (
            known.size >= _ENOUGH * finite.size
            and moves
            and (np.all(steps >= 0) or np.all(steps <= 0))
            and _begins_daily(values, times, date[1], _OF_DAY[unit], sessions=not (called or unit == "days"))
        ):
            found.setdefault(order, FoundClock(place, formats, order, times, date[0], decimal))
    return list(found.values())


def _begins_daily(values: Array, times: Array, dates: Sequence[str], of_day: float, *, sessions: bool) -> bool:
    """Whether a count falls wherever the day changes; one that may be of `sessions` also says that it is of the day.

    It does so where it goes on over midnight, or begins long after it.
    """
    known = np.isfinite(values) & np.isfinite(times)
    counts, times = values[known], times[known]
    days = [day for day, is_known in zip(dates, known.tolist(), strict=True) if is_known and day]
    if len(days) != counts.size:
        return sessions is False or counts[0] >= _SURE_SHARE * of_day
    changes = np.array([day != before for day, before in pairwise(days)], dtype=bool)
    if times[-1] < times[0]:
        counts, changes = counts[::-1], changes[::-1]
    before, after = counts[:-1][changes], counts[1:][changes]
    if np.any(after >= before):
        return False
    over_midnight = before >= (1.0 - _SURE_SHARE) * of_day
    return not sessions or bool(np.all(over_midnight | (after >= _SURE_SHARE * of_day)))


def looks_rounded_count(cell: str) -> bool:
    """Whether a cell is a count that a spreadsheet has rounded: 1.71032E+12 is the same for a quarter of an hour."""
    return _ROUNDED.match(cell) is not None


def counted_clock(place: int, values: Array, header: str, *, named: bool) -> FoundClock | None:
    """A column of numbers as a clock: a date by its size, or elapsed if its header says so and it begins near 0.

    It may fall where a machine or a session follows another, but not as readings do; or rise there, newest first.
    """
    finite = values[np.isfinite(values)]
    if finite.size < 2 or finite[0] == finite[-1] == np.median(finite):
        return None
    steps = np.diff(finite)
    in_order = bool(np.all(steps >= 0) or np.all(steps <= 0))
    falls = float((steps < 0).mean())
    if not in_order and not (named and (falls <= _MAX_FALL_SHARE or _restarts_evenly(finite[::-1]))):
        return None
    # Time (ms), elapsed_min, t [h]; of several words that are units, as of h:m:s, none is sure.
    units = [_COUNT_UNITS[word] for word in _WORDS.findall(header.casefold()) if word in _COUNT_UNITS]
    sure = units[0] if len(set(units)) == 1 and not _TENTHS_OF_US.search(header) else ""
    if dated := dated_format(finite, named=named, unit=sure):
        return FoundClock(place, (dated,), "year", COUNTS[dated].seconds(values))
    if not named or not (in_order or _restarts_evenly(finite)):
        return None
    # The last word that is a unit; without one, seconds.
    format_ = units[-1] if units else "seconds"
    times = COUNTS[format_].seconds(values)
    # So large an elapsed time is a count from a beginning that is not known.
    return None if since_1970(float(np.nanmin(times))) else FoundClock(place, (format_,), "year", times)


def _restarts_evenly(counts: Array) -> bool:
    """Whether elapsed times rise evenly and fall to their beginning only, as sessions one after another do."""
    steps = np.diff(counts)
    rises, after = steps[steps > 0], counts[1:][steps < 0]
    if not rises.size or not after.size:
        return False
    usual = float(np.median(rises))
    even = float((np.abs(rises - usual) <= 0.5 * usual).mean())
    at_beginning = float((after <= counts.min() + _SESSION_START_SHARE * np.ptp(counts)).mean())
    # Stored on change they rise unevenly; then the falls must be few.
    return (even >= _ENOUGH or after.size <= _MIN_FALL_SHARE * steps.size) and at_beginning >= _ENOUGH


_SESSION_START_SHARE = 0.2
"""Of the range of elapsed times, in which a session may begin."""
_MIN_FALL_SHARE = 0.02
"""Share of steps that go back where a session begins; readings go back as often as forward."""
_MAX_FALL_SHARE = 0.5
"""Share of steps that may go back in a column that is named like a time: of two machines in turn it is every other."""
