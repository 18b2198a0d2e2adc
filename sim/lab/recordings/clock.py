"""Clocks of recorded files: texts to seconds, local time to UTC, midnight, and the fewest rows to refuse.

Pandas, which knows date formats and time zones, takes longer to import than most files to read, so it is imported where
a file has such a clock; our own CSV counts in seconds.
"""

import re
from bisect import bisect_right
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from sim.lab.recordings.cells import Decimal, numbers, rewrite_points
from sim.lab.recordings.clock_counts import COUNTS
from sim.lab.recordings.clock_words import plain_time
from sim.lab.recordings.column_map import ClockColumns, Names, TimeOfDay
from sim.sha import Array, Mask

if TYPE_CHECKING:
    from pandas import DatetimeIndex

_OFFSET = re.compile(r":.*(?:[Zz]|[+-]\d\d(?::?\d\d)?)\s*$")
_MAYBE_ZONED = re.compile(r"[+Zz]|:[^\n]*-")
_DATE_CHARS = 10
"""Characters of a date with its marks."""
_DAY_S = 86400.0
_MIDNIGHT = re.compile(r"(?<=[ T])24(?=[:.]00)")
"""The end of a day, which programs read as no hour of any."""


_OWN_MIDNIGHT = re.compile(r"[ T]0?0:00(?::00(?:\.0+)?)?$")
"""What stands behind a day that a program knows as a moment."""


def clock_columns(clock: ClockColumns) -> tuple[Names, ...]:
    """The columns that the clock needs, in the order in which `read_clock` wants their cells."""
    day = clock.time_of_day
    if day is None:
        return (clock.column, *([clock.date] if clock.date else []))
    return (day.hour, day.minute, day.second, *((day.fraction,) if day.fraction else ()))


def read_clock(clock: ClockColumns, columns: Sequence[Sequence[str]], decimal: Decimal) -> tuple[Array, Mask]:
    """Seconds for each row (NaN: no time there), and a mask of the rows whose time needs the map's time zone yet."""
    if clock.time_of_day is not None:
        seconds = _time_of_day(clock.time_of_day, columns, decimal)
        return seconds, np.zeros(seconds.shape, dtype=bool)
    cells = list(map(str.strip, columns[0]))
    if clock.date:
        cells = join_days(columns[1], cells)
    seconds, local = np.full(len(cells), np.nan), np.zeros(len(cells), dtype=bool)
    for format_ in clock.formats:
        left = np.flatnonzero(np.isnan(seconds))
        if not left.size:
            break
        texts = [cells[index] for index in left] if left.size < len(cells) else cells
        day, _, unit = format_.rpartition(" ")
        if (count := COUNTS.get(format_)) is not None:
            seconds[left] = count.seconds(_count(texts, decimal))
            local[left] = count.local
        elif unit in COUNTS:
            # Joined by a blank: a count since the midnight of a day.
            parts = [text.rpartition(" ") for text in texts]
            midnights, local[left] = _dates([part[0] for part in parts], day)
            seconds[left] = midnights + COUNTS[unit].seconds(_count([part[2] for part in parts], decimal))
        else:
            seconds[left], local[left] = _dates(texts, format_)
    if clock.daily:
        return _with_long_times(np.mod(seconds, _DAY_S), cells, clock.formats), np.zeros(seconds.shape, dtype=bool)
    return seconds, local


def _with_long_times(seconds: Array, cells: Sequence[str], formats: Sequence[str]) -> Array:
    """The times of day, among them what was counted on beyond a day: 25:10:00, 1.01:10:00, 1 day 01:10:00; 75:30."""
    long = seconds.copy()
    # No format reads them, or as a midnight.
    for row in np.flatnonzero(np.isnan(seconds) | (seconds == 0)).tolist():
        known = elapsed_seconds(cells[row], minutes=formats == (ELAPSED_MINUTES,))
        if known is not None or (known := spoken_seconds(cells[row])) is not None:
            long[row] = known
    # One that is far from what stands before and after it is a time of day that was damaged.
    rows = np.flatnonzero(np.isfinite(long))
    steps = np.abs(np.diff(long[rows]))
    apart = np.concatenate(([np.inf], steps, [np.inf]))
    usual = float(np.median(steps)) if steps.size else 0.0
    lone = rows[np.minimum(apart[:-1], apart[1:]) > _NEAR_STEPS * usual + _NEAR_S]
    long[lone] = seconds[lone]
    return long


_NEAR_STEPS, _NEAR_S = 5.0, 60.0
"""Usual steps, and s beyond them, within which a time has another before or after it."""


ELAPSED_MINUTES = "%M:%S"
"""The format of times that have minutes and seconds only."""
_LONG_TIME = re.compile(
    r"(?:(\d{1,4})(?: ?d(?:ays?)?,? ?|[. ]))?(?:(\d{1,5}):)?(\d{1,5}):(\d\d(?:[.,]\d{1,9})?)", re.IGNORECASE
)


def elapsed_seconds(cell: str, *, minutes: bool = False) -> float | None:
    """Seconds of an elapsed time of a day and more, or of one in `minutes` and seconds; None for any other cell."""
    if (match := _LONG_TIME.fullmatch(cell)) is None or minutes == bool(match[2]) or (match[1] and not match[2]):
        return None
    days, hours, least, second = (float((part or "0").replace(",", ".")) for part in match.groups())
    if second >= 60 or (least >= 60 and not minutes) or (match[1] and hours >= 24):
        return None
    return days * _DAY_S + hours * 3600.0 + least * 60.0 + second if minutes or match[1] or hours >= 24 else None


_SPOKEN = re.compile(
    r"(?:TIME#|T#|PT?(?=\d))?(?:(\d+(?:[.,]\d+)?) ?d(?:ays?)?[ ,_T]*)?(?:(\d+(?:[.,]\d+)?) ?h(?:(?:ou)?rs?)?[ ,_]*)?"
    r"(?:(\d+(?:[.,]\d+)?) ?m(?:in(?:ute)?s?)?[ ,_]*)?(?:(\d+(?:[.,]\d+)?) ?s(?:ec(?:ond)?s?)?[ ,_]*)?"
    r"(?:(\d+(?:[.,]\d+)?) ?ms)?",
    re.IGNORECASE,
)
"""10 sec, 1 hr 2 min, PT1M10S, a controller's T#1m10s0ms: days, hours, minutes, seconds, thousandths."""
_SPOKEN_S = (_DAY_S, 3600.0, 60.0, 1.0, 0.001)


def spoken_seconds(cell: str) -> float | None:
    """Seconds of an elapsed time whose parts say their units; None for any other cell."""
    match = _SPOKEN.fullmatch(cell)
    if match is None or not any(match.groups()):
        return None
    parts = [float((part or "0").replace(",", ".")) for part in match.groups()]
    return sum(part * size for part, size in zip(parts, _SPOKEN_S, strict=True))


def join_days(days: Sequence[str], times: Sequence[str]) -> list[str]:
    """Times of day with their days, which spreadsheets and data frames write with a midnight of their own."""
    bare = {day: _OWN_MIDNIGHT.sub("", day.strip()) for day in set(days)}
    return [f"{bare[day]} {time}" for day, time in zip(days, times, strict=True)]


def _count(cells: Sequence[str], decimal: Decimal) -> Array:
    """A clock's numbers: 199.980 is no thousands there, whatever the readings' decimal mark."""
    return numbers(rewrite_points(cells, "decimal") if decimal == "," else cells, decimal)[0]


def _time_of_day(day: TimeOfDay, columns: Sequence[Sequence[str]], decimal: Decimal) -> Array:
    parts = [_count(cells, decimal) for cells in columns]
    hour, minute, second = parts[:3]
    usable = (hour >= 0) & (hour < 24) & (minute >= 0) & (minute < 60) & (second >= 0) & (second < 61)
    whole = hour * 3600.0 + minute * 60.0 + second
    if len(parts) == 4:
        usable &= (parts[3] >= 0) & (parts[3] * day.fraction_unit < 1)
        # The count of fractions first: 31 s and 9 tenths are 319 / 10, the nearest double to 31.9.
        per_second = 1.0 / day.fraction_unit
        exact = per_second == round(per_second)
        whole = (whole * per_second + parts[3]) / per_second if exact else whole + parts[3] * day.fraction_unit
    return np.where(usable, whole, np.nan)


def _dates(texts: list[str], format_: str) -> tuple[Array, Mask]:
    if format_ == "ISO8601":
        # A bare number is no date here, though ISO 8601 would read 1999 as a year.
        texts = [text if "-" in text or ":" in text else "" for text in texts]
    seconds = _parse_times(texts, format_)
    texts = list(texts)
    # Words in other languages, and the hour 24, only where the format does not read the cell as it stands.
    for index in np.flatnonzero(np.isnan(seconds)).tolist():
        texts[index] = plain_time(texts[index])
    unread = np.array([index for index in np.flatnonzero(np.isnan(seconds)).tolist() if texts[index]], dtype=np.intp)
    if unread.size:
        left = [texts[index] for index in unread]
        late = np.array([_MIDNIGHT.search(text) is not None for text in left], dtype=bool)
        seconds[unread] = _parse_times([_MIDNIGHT.sub("00", text) for text in left], format_) + _DAY_S * late
    if format_ == "ISO8601":
        # A zone has a mark of its own behind the time's.
        if _MAYBE_ZONED.search("\n".join(texts)) is None:
            return seconds, np.ones(len(texts), dtype=bool)
        return seconds, np.array([_OFFSET.search(text) is None for text in texts], dtype=bool)
    return seconds, np.full(len(texts), "%z" not in format_)


def _parse_times(texts: list[str], format_: str) -> Array:
    # The usual writing of ISO 8601 is told by its mark between date and time.
    mark = "T" if next(iter(texts), "")[_DATE_CHARS : _DATE_CHARS + 1] == "T" else " "
    usual = f"%Y-%m-%d{mark}%H:%M:%S" if format_ == "ISO8601" else format_
    seconds = _fixed_width(texts, usual)
    left = np.flatnonzero(np.isnan(seconds))
    if not left.size:
        return seconds
    if left.size < seconds.size:
        seconds[left] = _parsed_by_pandas([texts[index] for index in left.tolist()], format_)
        return seconds
    return _parsed_by_pandas(texts, format_)


_FIELD_WIDTHS = {"Y": 4, "m": 2, "d": 2, "H": 2, "M": 2, "S": 2}
"""Digits of what a format names, where a text writes all of them."""
_NAMED = re.compile(r"%(.)|(.)", re.DOTALL)


def _fixed_width(texts: list[str], format_: str) -> Array:
    """Seconds since 1970 of the texts that write a format's date and time with all digits; NaN for all others.

    So most exports write it, and a million of them are read at once, which a library reads one by one.
    """
    seconds = np.full(len(texts), np.nan)
    fields: dict[str, slice] = {}
    marks: dict[int, int] = {}
    width = 0
    for name, mark in _NAMED.findall(format_):
        if mark:
            marks[width] = ord(mark)
            width += 1
            continue
        if name not in _FIELD_WIDTHS or name in fields:
            return seconds
        fields[name] = slice(width, width + _FIELD_WIDTHS[name])
        width += _FIELD_WIDTHS[name]
    if not {"Y", "m", "d"} <= fields.keys() or any(mark > _MAX_ASCII for mark in marks.values()):
        return seconds
    rows = np.flatnonzero(np.fromiter(map(len, texts), dtype=np.intp, count=len(texts)) == width)
    whole = "".join(texts[index] for index in rows.tolist()) if rows.size < len(texts) else "".join(texts)
    if not rows.size or not whole.isascii():
        return seconds
    letters = np.frombuffer(whole.encode("ascii"), dtype=np.uint8).reshape(-1, width)
    good = np.all([letters[:, at] == mark for at, mark in marks.items()], axis=0) if marks else np.ones(rows.size, bool)
    found = dict.fromkeys(_FIELD_WIDTHS, np.zeros(rows.size, dtype=np.int64))
    for name, place in fields.items():
        digits = letters[:, place].astype(np.int64) - ord("0")
        good &= np.all((digits >= 0) & (digits <= 9), axis=1)
        found[name] = digits @ 10 ** np.arange(_FIELD_WIDTHS[name] - 1, -1, -1)
    good &= (found["m"] >= 1) & (found["m"] <= 12) & (found["d"] >= 1) & (found["Y"] >= 1)
    good &= (found["H"] < 24) & (found["M"] < 60) & (found["S"] < 60)
    months = ((found["Y"] - 1970) * 12 + found["m"] - 1)[good].astype("datetime64[M]")
    days = months.astype("datetime64[D]") + (found["d"][good] - 1)
    clock = (found["H"] * 3600 + found["M"] * 60 + found["S"])[good]
    # The 31st of a month of thirty days lies in the next one.
    own = np.where(days.astype("datetime64[M]") == months, days.astype(np.int64) * 86400.0 + clock, np.nan)
    seconds[rows[good]] = own
    return seconds


_MAX_ASCII = 127
"""The last letter that takes one byte."""


def _parsed_by_pandas(texts: list[str], format_: str) -> Array:
    import pandas as pd

    return _seconds(
        pd.DatetimeIndex(pd.to_datetime(np.array(texts, dtype=object), format=format_, errors="coerce", utc=True))
    )


def _seconds(stamps: "DatetimeIndex") -> Array:
    micros = stamps.as_unit("us")
    return np.where(micros.isna(), np.nan, micros.asi8 / 1e6)


def to_utc(seconds: Array, local: Mask, timezone: str) -> Array:
    """Seconds since 1970 from local readings of a clock in file order; NaN where that local time never was.

    In the hour that autumn repeats, rows are summer time until the clock is seen to go back by more than half an hour.
    """
    if timezone == "UTC" or not local.any():
        return seconds
    import pandas as pd

    naive = pd.DatetimeIndex(np.round(seconds[local] * 1e6).astype("datetime64[us]"))
    ambiguous = naive.tz_localize(timezone, ambiguous="NaT", nonexistent="shift_forward").isna()
    summer = np.ones(naive.shape, dtype=bool)
    # Each run of ambiguous rows is an autumn night of its own.
    edges = np.flatnonzero(np.diff(np.concatenate(([False], np.asarray(ambiguous), [False])).astype(np.int8)))
    for start, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        summer[start:end] = np.cumsum(np.diff(seconds[local][start:end], prepend=-np.inf) < -1800.0) == 0
    utc = naive.tz_localize(timezone, ambiguous=summer, nonexistent="NaT").tz_convert("UTC")
    result = seconds.copy()
    result[local] = _seconds(utc)
    return result


def unroll_midnight(seconds: Array) -> Array:
    """A time of day that goes on over midnight: a step back of more than half a day is a midnight passed.

    A step forward of almost a day is the same midnight passed backwards, by a clock that stutters; a long stop is not.
    """
    if np.nanmax(seconds, initial=0.0) > _DAY_S:
        return seconds  # counted on beyond the day
    steps = np.diff(seconds)
    steps[np.isnan(steps)] = 0.0
    days = np.cumsum((steps < -_DAY_S / 2).astype(float) - (steps > _DAY_S - 600.0))
    return seconds + _DAY_S * np.concatenate(([0.0], days)) if steps.size else seconds


def spread_evenly(times: Array) -> Array:
    """Rows of equal times spread evenly up to the next time, as by a clock that shows minutes of rows every 10 s.

    The first group, which may have begun within its time, ends where the next begins; the last begins at its own.
    """
    distinct, at, counts = np.unique(times, return_inverse=True, return_counts=True)
    if distinct.size < 2:
        return times
    usual = int(np.median(counts))
    # Where the recorder was off, the last rows before are no farther apart than others.
    steps = np.minimum(np.append(np.diff(distinct), np.diff(distinct)[-1]), np.median(np.diff(distinct)))
    size = counts.astype(float)
    size[0], size[-1] = max(usual, counts[0]), max(usual, counts[-1])
    place = (
        np.arange(times.size) - np.concatenate(([0], np.cumsum(counts)))[at] + np.where(at == 0, size[0] - counts[0], 0)
    )
    return np.asarray(times + steps[at] * place / size[at])


def longest_rising_rows(times: Array) -> Mask:
    """A mask that keeps as many rows as can be kept so that the clock never goes back (patience sorting)."""
    if not np.any(np.diff(times) < 0):
        return np.ones(times.shape, dtype=bool)
    # tails[n] is the earliest time at which a rising row of n + 1 rows can end, ends[n] that row, and before[row] the
    # row that stands before it there: followed backwards from the longest one, these are the rows to keep.
    tails: list[float] = []
    ends: list[int] = []
    before = np.full(times.shape, -1)
    for row, time in enumerate(times.tolist()):
        place = bisect_right(tails, time)
        before[row] = ends[place - 1] if place else -1
        tails[place : place + 1] = [time]
        ends[place : place + 1] = [row]
    keep = np.zeros(times.shape, dtype=bool)
    row = ends[-1]
    while row >= 0:
        keep[row] = True
        row = int(before[row])
    return keep
