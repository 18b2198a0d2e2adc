"""Formats of times that exports write: which of them read a cell."""

import re
from datetime import datetime
from functools import lru_cache
from typing import Literal

from sim.lab.recordings.cells import numbers
from sim.lab.recordings.clock import elapsed_seconds, join_days
from sim.lab.recordings.clock_counts import dated_format
from sim.lab.recordings.clock_words import plain_time

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
    "%H:%M:%S", "%H:%M:%S.%f", "%H:%M:%S,%f", "%H:%M:%S:%f", "%H:%M:%S;%f", "%H:%M", "%H.%M.%S", "%H.%M",
    "%H-%M-%S", "%I:%M:%S %p", "%I:%M:%S.%f %p", "%I:%M:%S;%f %p", "%I:%M:%S %p;%f", "%I:%M %p",
    "%I.%M.%S %p", "%I.%M.%S.%f %p",
)  # fmt: skip
_DATE_TIME_MARKS = (" ", "T", ", ", "  ", "_", " - ", "-", ":", "/")
_COMPACT = re.compile(
    r"((?:19|20)\d{6}|(?:19|20)\d\dW\d{3}|(?:19|20)\d{5}(?=T))([T_-]?)\d{6}(\.\d{3,6}|\d{3})?( ?(?:[+-]\d\d:?\d\d|Z))?"
)
"""Of our centuries, and with milliseconds at most: ticks and nanoseconds are as many digits."""
_COMPACT_DATES = {8: "%Y%m%d", 7: "%Y%j"}
"""By their digits; those of a week have its W."""
_MARKS = re.compile(r"(?<!%)[-/.:;, _]")
_DATED = re.compile(r"(?:\d{1,4}[-/. ]|\d{8}\b|[A-Za-z]{3}[- ]\d|\d\d?:\d\d).*\d(?:[:.]\d\d|\d [AP]M$|\d$)")
_ZONE = re.compile(r" ?(?:[+-]\d\d:?\d\d|Z)$")


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


_THOUSANDTHS = re.compile(r";\d{3}\b")
"""Behind a semicolon there are three digits: two are a reading before its decimal comma."""


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
            times = times if ";" not in time or _THOUSANDTHS.search(time) else []
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


def pure_time(cell: str) -> tuple[str, ...]:
    """The formats of a time of day without a date that read a cell."""
    marked = ":" in cell or cell.count(".") == 2
    if ":" in cell and elapsed_seconds(cell) is not None:
        return ("%H:%M:%S",)
    return tuple(format_ for format_ in _TIMES if marked and _fits(cell, format_))


def tells_time(cell: str) -> bool:
    """Whether a cell is a date, a time of day, both, or a count since a known beginning that is of our times."""
    if is_time(cell) or pure_date(cell) or pure_time(cell):
        return True
    return dated_format(numbers([cell])[0], named=False) != ""
