"""A CSV that nobody has described: its separator, where its header stands, what lies before and under it, its rows."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from drivers.csv_rows import unguarded
from drivers.named_files import regular
from sim.lab.recordings import SEPARATORS, TraceError, decode_head
from sim.lab.recordings.mapping.clocks import is_time, pure_date
from sim.lab.recordings.mapping.words import UNITS, bare_unit

_HEAD = 1 << 20
_SINCE_1970 = (10, 13, 16, 19)
"""Digits of a time since 1970 in s, ms, us and ns."""
_SEARCHED = 60
"""Lines in which a header is looked for: titles, annotations and column lists of exports are shorter."""


@dataclass(frozen=True, slots=True)
class FoundTable:
    """A file's `header` and sample `rows` (cells stripped), under `separator`; `units` by column where a row has them.

    `titles` are the header's names, or those of a row below it where the header only counts its columns.
    """

    path: Path
    separator: str
    header: tuple[str, ...]
    titles: tuple[str, ...]
    units: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def column(self, place: int) -> list[str]:
        """The sample cells of a column."""
        return [row[place] for row in self.rows]


def find_table(path: Path) -> FoundTable:
    """The table in the first megabyte of a file. Raises TraceError for none, OSError where it cannot be read."""
    with regular(path).open("rb") as stream:
        head = stream.read(_HEAD)
    if not head.strip():
        raise TraceError(f"{path}: the file is empty; give a CSV with a header and rows")
    _, text, _ = decode_head(path, head, "auto")
    lines = text.splitlines()
    if len(head) == _HEAD:
        lines.pop()  # cut in the middle
    usable = [(number, line) for number, line in enumerate(lines) if line.strip() and not line.startswith("#")]
    # The separator under which most of the first rows have the same number of cells, and most of them.
    best: tuple[int, str, list[list[str]]] = (0, "", [])
    for name, mark in SEPARATORS.items():
        rows = [_cells(line, mark) for _, line in usable[:_SEARCHED]]
        widths = [len(row) for row in rows if len(row) > 1]
        width = max(set(widths), key=widths.count) if widths else 0
        # A decimal comma makes rows of many cells too: what counts is in how many rows the cells say a time.
        timed = sum(any(map(is_time, row)) for row in rows if len(row) == width)
        score = timed * 100 + widths.count(width) * 2 + width
        if width and score > best[0]:
            best = (score, name, rows)
    separator, rows = best[1], best[2]
    if not separator:
        raise TraceError(f"{path}: no separator of , ; tab | makes columns of its lines; give a CSV with a header")
    first = next((place for place, row in enumerate(rows) if _is_data(row)), None)
    if not first:
        raise TraceError(
            f"{path}: no row with a time stands under a header in its first {len(rows)} lines; give a CSV whose "
            "columns have names, and one column (or two: date and time) of times"
        )
    width = len(rows[first])
    named = next((place + 1 for place, row in enumerate(rows[:first]) if row[0].casefold() == "#names"), None)
    header_at, units = first - 1 if named is None else named, [""] * width
    above = rows[header_at]
    if named is None and header_at and _is_units(above) and len(rows[header_at - 1]) >= len(above):
        units = [UNITS.get(bare_unit(cell), "") for cell in above] + [""] * (width - len(above))
        header_at -= 1
    # Between names and readings there may be rows of addresses and types, which leave the clock's columns blank.
    while named is None and header_at and len(rows[header_at - 1]) == width and not rows[header_at][0]:
        header_at -= 1
    header = rows[header_at][:width]
    header += [""] * (width - len(header))
    while header and not header[-1]:
        header.pop()
    width = len(header)
    if not width or not any(header) or all(map(_numeric, filter(None, header))):
        raise TraceError(f"{path}: line {usable[first][0] + 1} holds data, and no line above it names its columns")
    # Where the header only counts its columns, the names stand in one of the rows below it.
    titles = [
        next((row[at] for row in rows[header_at:first] if len(row) > at and not row[at].isdigit() and row[at]), name)
        for at, name in enumerate(header)
    ]
    mark = SEPARATORS[separator]
    below = (_cells(line, mark) for _, line in usable[first:])
    sample = tuple(tuple(row[:width]) for row in below if len(row) >= width)
    return FoundTable(
        path=path,
        separator=separator,
        header=tuple(header),
        titles=tuple(titles),
        units=tuple(units[:width]),
        rows=sample,
    )


def _cells(line: str, mark: str) -> list[str]:
    return [cell.strip() for cell in unguarded(next(csv.reader([line], delimiter=mark, skipinitialspace=True), []))]


def _is_data(row: Sequence[str]) -> bool:
    """Whether a row holds readings: a date, or numbers and nothing that a header has."""
    if len(row) < 2:
        return False
    if any(is_time(cell) or pure_date(cell) or (cell.isdigit() and len(cell) in _SINCE_1970) for cell in row):
        return True
    filled = [cell for cell in row if cell]
    return bool(row[0]) and len(filled) > 1 and all(_numeric(cell) for cell in filled)


def _numeric(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _is_units(row: Sequence[str]) -> bool:
    """Whether a row under the header says units: at least one that is known, and nothing that is long."""
    filled = [bare_unit(cell) for cell in row if cell]
    return any(cell in UNITS for cell in filled) and all(len(cell) <= 6 for cell in filled)
