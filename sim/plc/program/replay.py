"""Trace replay: a wide CSV on a clock of its own that can be held, sought, looped and run at any speed.

The file is what the project's own writer makes: lines that start with `#` are comments, the first line is the header,
its first column is `time` (seconds, never going back), the others are signals. An empty cell (or `nan`) is "no new
reading": the last value holds. A position counts in seconds from the first row; the value served is that of the last
row at or before it, never an interpolated one.
"""

import math
from array import array
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from statistics import median

from drivers.csv_rows import CsvRowError, numbered_rows
from sim.moments import exact_moments
from sim.plc.program.checks import InputError, list_words, read_text

_WORDS = {"": math.nan, "nan": math.nan, "true": 1.0, "false": 0.0}


@dataclass(frozen=True, slots=True)
class TraceTable:
    """n rows: `times` in seconds as in the file, and a column of n floats a signal, held over empty cells.

    NaN stands before a signal's first reading. `period` is the time from the last row to the first of the next loop.
    """

    path: Path
    times: Sequence[float]
    columns: Mapping[str, Sequence[float]]
    period: float

    @property
    def duration(self) -> float:
        """Seconds from the first row to the last."""
        return self.times[-1] - self.times[0]


@dataclass(frozen=True, slots=True)
class TraceReplay:
    """Where in the trace the replay is: at `position` at the moment `since`, and moving at `rate` unless held."""

    table: TraceTable
    since: float
    position: float = 0.0
    rate: float = 1.0
    held: bool = False
    loop: bool = False

    def row_position(self, now: float) -> float:
        """The position (s from the first row) at a monotonic moment; stays at the end unless it loops."""
        position = self.position if self.held else self.position + (now - self.since) * self.rate
        if self.loop:
            return position % (self.table.duration + self.table.period)
        return min(position, self.table.duration)

    def row(self, now: float) -> int:
        """The last row at or before the position."""
        return bisect_right(self.table.times, self.table.times[0] + self.row_position(now)) - 1

    def values(self, now: float) -> dict[str, float | None]:
        """Every signal's value at a monotonic moment, None before its first reading."""
        row = self.row(now)
        return {
            name: None if column[row] != column[row] else column[row] for name, column in self.table.columns.items()
        }

    def at_end(self, now: float) -> bool:
        """True when the last row has been reached for good."""
        return not self.loop and self.row_position(now) >= self.table.duration

    def change(
        self, now: float, *, rate: float | None = None, held: bool | None = None, loop: bool | None = None
    ) -> "TraceReplay":
        """The same position from `now` on, with another rate, held or released, looping or not."""
        return replace(
            self,
            since=now,
            position=self.row_position(now),
            rate=self.rate if rate is None else rate,
            held=self.held if held is None else held,
            loop=self.loop if loop is None else loop,
        )

    def seek(self, now: float, position: float) -> "TraceReplay":
        """At another position. Raises InputError outside the trace."""
        if not 0 <= position <= self.table.duration:
            raise InputError(f"position {position} is outside the trace; give 0 to {self.table.duration:g} seconds")
        return replace(self, since=now, position=position)


def read_trace(path: Path) -> TraceTable:
    """The trace in `path`. Raises InputError with file, line and reason."""
    lines = _rows(path)
    try:
        number, header = next(lines)
    except StopIteration:
        raise InputError(f"{path}: has no header; the first line names the columns: time, then the signals") from None
    names = [name.strip() for name in header]
    where = f"{path}: line {number}"
    if names[0] != "time":
        raise InputError(f"{where}: the first column is {names[0]!r}; it must be 'time', in seconds")
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise InputError(f"{where}: column {list_words(twice)} occurs twice; give each signal its own name")
    if not all(names):
        raise InputError(f"{where}: column {names.index('') + 1} has no name; name it or remove it")
    times = array("d")
    columns = [array("d") for _ in names[1:]]
    held = [math.nan] * len(columns)
    for number, cells in lines:
        where = f"{path}: line {number}"
        if len(cells) != len(names):
            raise InputError(f"{where}: has {len(cells)} cells for {len(names)} columns; give one a column")
        moment = _reading(cells[0], f"{where}: column 'time'")
        if math.isnan(moment):
            raise InputError(f"{where}: column 'time': is empty; give seconds")
        if times and moment < times[-1]:
            before, then = exact_moments(times[-1], moment)
            raise InputError(f"{where}: column 'time': goes back from {before} to {then}; sort the rows by time")
        times.append(moment)
        for index, cell in enumerate(cells[1:]):
            reading = _reading(cell, f"{where}: column {names[index + 1]!r}")
            if not math.isnan(reading):
                held[index] = reading
            columns[index].append(held[index])
    if not times:
        raise InputError(f"{path}: has no rows under its header; give at least one")
    steps = [late - early for early, late in pairwise(times) if late > early]
    return TraceTable(path, times, dict(zip(names[1:], columns, strict=True)), median(steps) if steps else 1.0)


def _rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    try:
        yield from numbered_rows(read_text(path, "a trace").splitlines(keepends=True))
    except CsvRowError as error:
        raise InputError(f"{path}: line {error.line}: is not CSV: {error.reason}; correct that line") from None


def _reading(cell: str, where: str) -> float:
    word = cell.strip().lower()
    if word in _WORDS:
        return _WORDS[word]
    try:
        number = float(word)
    except ValueError:
        number = math.inf
    if not math.isfinite(number):
        raise InputError(f"{where}: {cell!r} is no finite number; give a number, true, false, or leave it empty")
    return number
