"""Clocks that count: in which unit, from when, and which counts can be of our time; the one owner of that table."""

from dataclasses import dataclass

import numpy as np

from sim.sha import Array

_DAY = 86400.0


@dataclass(frozen=True, slots=True)
class Count:
    """A clock's units in a `second`, the time (s since 1970) at which it is 0, and whether that is a `local` time.

    `bare` counts are dates by their size alone, without a name that says so.
    """

    second: float
    origin: float = 0.0
    local: bool = False
    bare: bool = False

    def seconds(self, counts: Array) -> Array:
        """Seconds since 1970 (of an elapsed time since its beginning); those of days to the millisecond."""
        if self.second < 1.0 and self.origin:
            return np.round(counts / self.second + self.origin, 3)
        return counts / self.second + self.origin

    def is_dated(self, counts: Array) -> bool:
        """Whether all counts are of the years 2001 to 2049."""
        first, last = ((edge - self.origin) * self.second for edge in _OUR_TIME)
        return bool(np.all((first <= counts) & (counts < last)))


_OUR_TIME = (1e9, 2.5e9)
COUNTS = {
    "seconds": Count(1.0, bare=True), "milliseconds": Count(1e3, bare=True), "microseconds": Count(1e6, bare=True),
    "nanoseconds": Count(1e9, bare=True), "minutes": Count(1 / 60), "hours": Count(1 / 3600), "days": Count(1 / _DAY),
    "spreadsheet days": Count(1 / _DAY, -25_569 * _DAY, local=True),
    "matlab days": Count(1 / _DAY, -719_529 * _DAY, local=True),
    "seconds since 1904": Count(1.0, -2_082_844_800.0),
    "filetime": Count(1e7, -11_644_473_600.0, bare=True),
    "ticks": Count(1e7, -62_135_596_800.0, local=True, bare=True),
}  # fmt: skip
"""Formats of a clock that counts: elapsed or since 1970; days since 1899-12-30 and since the year 0; LabVIEW's seconds,
Windows' tenths of a microsecond since 1601 and .NET's since the year 1."""
_BEGINNING = 1e8


def since_1970(seconds: float) -> bool:
    """Whether a recording's time counts since 1970, and not from the recording's own beginning."""
    return seconds >= _BEGINNING


def dated_format(counts: Array, *, named: bool, unit: str = "") -> str:
    """The format in which all counts are dates; "" for none. `named` is whether the counts are called a time.

    Where a `unit` is known, one of `COUNTS`, only formats that count in it are looked at.
    """
    for name, count in COUNTS.items():
        if unit and count.second != COUNTS[unit].second:
            continue
        days = count.second < 1.0
        if (count.bare or (named and count.origin and (not days or np.any(counts % 1)))) and count.is_dated(counts):
            return name
    return ""
