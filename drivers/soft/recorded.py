"""A recorded trace for the soft driver: rows in memory or from a plain CSV, and which row holds at a time."""

import csv
import math
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

from drivers.csv_rows import strip_guards
from drivers.errors import DriverError
from drivers.named_files import regular
from drivers.tag import Value

_WORDS: dict[str, Value | None] = {"": None, "true": True, "false": False}


@dataclass(frozen=True, slots=True)
class SoftRecording:
    """Rows at rising `times` (s) and one column a signal; None where a row has no value. `loop` repeats without end."""

    times: tuple[float, ...]
    columns: Mapping[str, tuple[Value | None, ...]]
    loop: bool = False

    @property
    def period(self) -> float:
        """Seconds from one repetition to the next: the rows' span and one more mean step."""
        span = self.times[-1] - self.times[0]
        return span * len(self.times) / (len(self.times) - 1) if span > 0 else 1.0

    def find_row(self, time: float) -> int:
        """The last row at or before `time`, -1 before the first; a looped recording counts on from cycle to cycle."""
        if not self.loop or time < self.times[0]:
            return bisect_right(self.times, time) - 1
        cycle, rest = divmod(time - self.times[0], self.period)
        return int(cycle) * len(self.times) + bisect_right(self.times, self.times[0] + rest) - 1

    def row_time(self, row: int) -> float:
        """When the row is played, in the recording's own time."""
        cycle, index = divmod(row, len(self.times))
        return self.times[index] + cycle * self.period

    def value(self, signal: str, row: int) -> Value | None:
        """The signal's value in the row."""
        return self.columns[signal][row % len(self.times)]


def make_recording(
    times: Sequence[float], columns: Mapping[str, Sequence[Value | None]], *, loop: bool, source: str = "soft"
) -> SoftRecording:
    """Check rows and make a recording. Raises DriverError if there are none or they do not fit together."""
    if not times:
        raise DriverError(f"{source}: there are no rows")
    strange = next((time for time in times if not isinstance(time, int | float) or not math.isfinite(time)), None)
    if strange is not None:
        raise DriverError(f"{source}: {strange!r} is not a time in seconds")
    back = next((index for index, (a, b) in enumerate(pairwise(times)) if b < a), None)
    if back is not None:
        raise DriverError(f"{source}: row {back + 2} is at {times[back + 1]!r}, before the row above it: sort the rows")
    for name, column in columns.items():
        if len(column) != len(times):
            raise DriverError(f"{source}: {name} has {len(column)} values for {len(times)} times")
    return SoftRecording(tuple(times), {name: tuple(column) for name, column in columns.items()}, loop)


def load_csv(path: Path, time_column: str, *, loop: bool) -> SoftRecording:
    """Read a CSV with a header: a time column (seconds, or ISO 8601, UTC unless it says otherwise) and signals.

    Empty cells are missing values, true and false are bools, what is not a number is text. Raises DriverError with
    file, line and reason for anything that cannot be used.
    """
    rows = _rows(path)
    _, header = next(rows, (1, []))
    header = [name.strip() for name in header]
    if header.count(time_column) != 1:
        raise DriverError(f"{path}, line 1: one column must be called {time_column!r}; it has {', '.join(header)}")
    if len(set(header)) != len(header):
        raise DriverError(f"{path}, line 1: two columns have the same name")
    clock = header.index(time_column)
    table: list[list[Value | None]] = []
    times: list[float] = []
    for number, row in rows:
        if not row:
            continue
        if len(row) != len(header):
            raise DriverError(f"{path}, line {number}: {len(row)} cells for {len(header)} columns")
        times.append(_seconds(row[clock], f"{path}, line {number}"))
        table.append([_cell(cell) for cell in row])
    columns = {name: [row[index] for row in table] for index, name in enumerate(header) if index != clock}
    return make_recording(times, columns, loop=loop, source=str(path))


def _rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """(number of its first line, cells) of each row: a quoted cell may go on over several lines."""
    number = 1
    try:
        with regular(path).open(encoding="utf-8-sig", newline="") as stream:
            reader = csv.reader(stream, strict=True)
            for row in reader:
                yield number, strip_guards(row)
                number = reader.line_num + 1
    except csv.Error as error:
        raise DriverError(f"{path}, line {number}: is not CSV: {error}") from None
    except OSError as error:
        raise DriverError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise DriverError(f"{path}: is not UTF-8 text ({error.reason})") from None


def _seconds(text: str, place: str) -> float:
    """A cell's time: a number of seconds, or an ISO 8601 moment as seconds UTC."""
    try:
        number = float(text)
    except ValueError:
        try:
            moment = datetime.fromisoformat(text.strip())
        except ValueError:
            raise DriverError(f"{place}: {text!r} is neither seconds nor an ISO 8601 time") from None
        return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
    # "nan" and "inf" are numbers to Python, and no row can be found by them.
    if not math.isfinite(number):
        raise DriverError(f"{place}: {text!r} is not a time")
    return number


def _cell(text: str) -> Value | None:
    text = text.strip()
    if text.lower() in _WORDS:
        return _WORDS[text.lower()]
    try:
        return float(text)
    except ValueError:
        return text
