"""Formats of times: which of those that exports write reads a column, and whether more than one does."""

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice, pairwise
from typing import Literal

import numpy as np

from sim.lab.recordings import (
    COUNTS,
    ELAPSED_MINUTES,
    ClockColumns,
    Order,
    dated_format,
    elapsed_seconds,
    join_days,
    numbers,
    pure_time,
    read_clock,
    since_1970,
    spoken_seconds,
    time_formats,
    unroll_midnight,
    whole_day,
)
from sim.lab.recordings.mapping.words import named_time
from sim.sha import Array

TIME_UNITS = {
    unit: tuple(words.split())
    for unit, words in {
        "seconds": "s sec secs second seconds sek sekunde sekunden secondo secondi seconde secondes segundo segundos "
        "sekunder seg",
        "milliseconds": "ms msec millisecond milliseconds millis millisekunden millisecondi millisecondes milisegundos",
        "microseconds": "us μs usec microsecond microseconds mikrosekunden microsecondi microsecondes microsegundos",
        "nanoseconds": "ns nsec nanosecond nanoseconds",
        "minutes": "min mins minute minutes minuten minuti minuto minutos",
        "hours": "h hr hrs hour hours std stunde stunden ore heures horas",
        "days": "d day days tage giorni jours",
    }.items()
}
"""Units of elapsed time, which are formats of a clock, by their words in folded case; the first is the sign."""
_UNIT_OF = {word: unit for unit, words in TIME_UNITS.items() for word in words}
_ALSO_NO_UNITS = frozenset({"second", "minute", "hour", "std", "day", "seconde", "secondo", "segundo", "minuto"})
"""Of what is a unit only where it stands for one: not in `Time of day`, `Std time` and `Hour`."""
_WORDS = re.compile(r"[^\W\d_]+")
_LAST_OF_WORD = re.compile(r"(?<=[a-z])[A-Z]+[a-z]*$")
"""The unit in timeSec and elapsedMs."""
_STANDS_FOR_A_UNIT = r"[\[(]\s*(?:in )?{0}\s*[\])]|\bin {0}\s*$"
_TENTHS_OF_US = re.compile(r"100 ?ns", re.IGNORECASE)
"""What Windows and .NET count in, which is no unit of elapsed time."""
_ROUNDED = re.compile(r"\d[.,]\d+[eE]\+?\d\d$")
_MAX_CHECKED_CELLS = 400
_LOOKED_AT, _MOST_FORMATS, _ENOUGH = 5, 4, 0.8


@dataclass(frozen=True, slots=True)
class FoundClock:
    """A column (two, with `date`) read as times: `formats` for the map, the `order` of dates, the sample's `times`.

    `why` is what the formats were concluded from where nothing says them, "" else.
    """

    place: int
    formats: tuple[str, ...]
    order: Order
    times: Array
    date: int | None = None
    decimal: Literal["auto", ".", ","] = "auto"
    why: str = ""

    @property
    def has_zone(self) -> bool:
        """Whether the formats themselves name a zone, or count since 1970."""
        return any("%z" in each or (each in COUNTS and not COUNTS[each].local) for each in self.formats)


def bare_time(cells: Sequence[str], header: str) -> str:
    """The format of a column of times of day that are written like numbers, 06.00 or 060000; "" for other numbers.

    It tells them from numbers by their digits only: they are times beside a column of days and under a name of time.
    """
    shown = set(cells) - {""}
    if len(shown) < 2 or units_named(header):
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
    if spoken_seconds(first) is not None:
        formats = ("%H:%M:%S",)
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
    units = set(units_named(header))
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
    units = units_named(header)
    sure = units[0] if says_count_unit(header) else ""
    if dated := dated_format(finite, named=named, unit=sure):
        return FoundClock(place, (dated,), "year", COUNTS[dated].seconds(values))
    if not named or not (in_order or _restarts_evenly(finite)):
        return None
    # Without one that is sure, a person is asked.
    format_ = sure or "seconds"
    times = COUNTS[format_].seconds(values)
    # So large an elapsed time is a count from a beginning that is not known.
    return None if since_1970(float(np.nanmin(times))) else FoundClock(place, (format_,), "year", times)


def says_count_unit(header: str) -> bool:
    """Whether a header says in which unit its times are counted, and in one only."""
    return len(set(units_named(header))) == 1 and not _TENTHS_OF_US.search(header)


def units_named(header: str) -> list[str]:
    """The units of time that a header has words of, each as often as it does."""
    found = []
    for word in _WORDS.findall(header):
        last = _LAST_OF_WORD.search(word)
        unit = time_unit(word) or (time_unit(last[0]) if last else "")
        sure = word.casefold() not in _ALSO_NO_UNITS
        if unit and (sure or re.search(_STANDS_FOR_A_UNIT.format(re.escape(word)), header)):
            found.append(unit)
    return found


def time_unit(word: str) -> str:
    """The unit of time that a word is, as maps call it; "" for none."""
    return _UNIT_OF.get(word.casefold(), "")


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
