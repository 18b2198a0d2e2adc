"""A CSV that nobody has described: its separator, where its header stands, what lies before and under it, its rows."""

import csv
import re
from collections.abc import Iterator, Sequence, Set
from contextlib import suppress
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path

import numpy as np

from sim.lab.recordings import (
    MAX_HEADER_LINE,
    MAX_ROW_LINES,
    SEPARATORS,
    UNITS,
    UNNAMED_COLUMN,
    TraceError,
    bare_cells,
    compose_names,
    decode_head,
    drop_invisible,
    fold_name,
    is_time,
    join_cells,
    number_equal_names,
    numbers,
    parse_quantity,
    read_head,
    rows_mark,
    spoken_seconds,
    tells_time,
    with_row_names,
)
from sim.lab.recordings.mapping.clocks import looks_rounded_count
from sim.lab.recordings.mapping.words import bare_unit, named_time

_HEAD_BYTES = 1 << 20
_RULED = frozenset(" \t,;|-=+_\r\n")
"""Marks of a line that is blank, or drawn under the names as databases print them."""
_SHOWN_ROWS = 5
"""Rows under a header that show whether they are numbered."""


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
    parts: str = ""
    """The pattern of the files that make the table together, one a tag or one after another; "" for a single file."""
    files: tuple[str, ...] = ()
    """Of such a table the name of the file that has the column; "" where several have it."""
    above: tuple[str, ...] = ()
    """The lines that stand above the header."""

    def column(self, place: int) -> list[str]:
        """The sample cells of a column."""
        return [row[place] for row in self.rows]


def find_table(path: Path) -> FoundTable:
    """The table in the first megabyte of a file. Raises TraceError for none, OSError where it cannot be read."""
    head = read_head(path, _HEAD_BYTES)
    if not head.strip():
        raise TraceError(f"{path}: the file is empty; give a CSV with a header and rows")
    _, text, _ = decode_head(path, head, "auto")
    lines = text.splitlines()
    if len(head) == _HEAD_BYTES:
        lines.pop()  # cut in the middle
    whole = _whole_rows(lines) if '"' in text else enumerate(lines)
    usable = [(at, line) for at, line in whole if not line.startswith("#") and set(line) - _RULED]
    # The separator under which most of the first rows have the same number of cells, and most of them.
    best: tuple[int, str, list[list[str]]] = (0, "", [])
    for name, mark in SEPARATORS.items():
        rows = [_cells(line, mark) for _, line in usable[:MAX_HEADER_LINE]]
        widths = [len(row) for row in rows if len(row) > 1]
        width = max(set(widths), key=widths.count) if widths else 0
        # A decimal comma makes rows of many cells too: what counts is in how many rows the cells say a time, or in how
        # many every cell is a number.
        own = [row for row in rows if len(row) == width]
        timed = sum(any(map(is_time, row)) for row in own)
        counted = sum(all(_numeric(cell) for cell in row if cell) for row in own)
        score = timed * 100 + counted * 50 + widths.count(width) * 2 + width
        if width and score > best[0]:
            best = (score, name, rows)
    separator, rows = best[1], best[2]
    if not separator:
        raise TraceError(f"{path}: no separator of , ; tab | makes columns of its lines; give a CSV with a header")
    first = _first_data(rows)
    if first is None:
        first = next((place for place, row in enumerate(rows) if place and _mostly_numbers(row)), None)
    if first is None:
        first = next((at for at in range(1, len(rows)) if _counts_time(rows[at - 1], rows[at])), None)
    # Words and blanks may stand in the rows above the first one that has numbers only.
    while first and first > 1 and len(rows[first - 1]) == len(rows[first]) and _mostly_numbers(rows[first - 1]):
        first -= 1
    if not first:
        raise TraceError(_no_data(path, rows))
    width = len(rows[first])
    named = next((place + 1 for place, row in enumerate(rows[:first]) if row[0].casefold() == "#names"), None)
    # Rows of readings of another width may stand between them: a column was added later, a row was cut off.
    names_at = next((at for at in range(first - 1, 0, -1) if not _is_reading(rows[at], rows[first])), 0)
    header_at, units = names_at if named is None else named, [""] * width
    # Between names and readings there may be rows of units, and of addresses and types, which leave the clock's columns
    # blank or name it alone.
    while named is None and header_at:
        above, before = rows[header_at], rows[header_at - 1]
        if not any(units) and _is_units(above) and len(before) >= len(above):
            units = [UNITS.get(bare_unit(cell), "") for cell in above] + [""] * (width - len(above))
        elif not _is_types(above) and (len(before) != width or (above[0] and any(above[1:]))):
            break
        header_at -= 1
    header = list(map(drop_invisible, rows[header_at][:width]))
    # Names under names: those of merged cells are blank, or equal ones stand below.
    beside = [at - header_at for at, _ in enumerate(usable) if abs(usable[at][0] - usable[header_at][0]) == 1]
    over, under = (rows[header_at - 1] if -1 in beside else []), rows[header_at + 1]
    if header_at + 1 < first and 1 in beside and not _is_units(under) and _lacks_names(header, under):
        rows[header_at] = header = compose_names(header, under[:width])
    elif _has_equal(header) and sum(map(bool, over)) > 1 and not all(over) and _lacks_names(over, header):
        rows[header_at] = header = compose_names(over[:width], header)
    if width > 1 and len(header) < width:
        # A header with commas over rows with semicolons.
        others = [_cells(usable[header_at][1], mark) for mark in SEPARATORS.values()]
        below = [line for _, line in usable[first:MAX_HEADER_LINE]]
        header = next((o for o in others if len(o) == width and rows_mark(below, width, ",") != ","), header)
    named_rows = with_row_names(header, rows[first : first + _SHOWN_ROWS])
    shown = rows[first : first + _SHOWN_ROWS]
    # Numbered rows have a cell more, too, and others a last mark.
    named_count = max((place + 1 for place, name in enumerate(header) if name), default=0)
    # A name that is left blank between others is that of a column.
    parted = "" not in header[1:named_count] and all(_has_commas(row, named_count) for row in shown)
    if separator == "," and len(named_rows) == len(header) and parted:
        why = "its commas are decimal marks and part the cells, too"
        if max(sum(map(bool, row)) for row in shown) == named_count + 1:
            why += ", or its last column has no name"
        raise TraceError(
            f"{path}: line {usable[first][0] + 1} has {width} cells under {named_count} names: {why}; export it with "
            "semicolons between the cells, or with decimal points, and a name for each column"
        )
    if len(named_rows) > len(header):
        # The rows between the names and the readings, and that of units, have no cell for the rows' numbers either.
        header, units = named_rows, ["", *units[: width - 1]]
        rows = [["", *row] if header_at <= place < first else row for place, row in enumerate(rows)]
    header[0] = header[0] or UNNAMED_COLUMN
    header += [""] * (width - len(header))
    while header and not header[-1]:
        header.pop()
    width = len(header)
    if not width or not any(header) or all(map(_numeric, filter(None, header))):
        raise TraceError(f"{path}: line {usable[first][0] + 1} holds data, and no line above it names its columns")
    # Where the header only counts its columns, the names stand in one of the rows below it, or above, as recorders do.
    counted = sum(map(str.isdigit, header)) > 1
    higher = [row for row in reversed(rows[:header_at]) if counted and len(row) == width]
    of_units = next((row for row in higher if _is_units(row)), None)
    if of_units is not None and not any(units):
        units = [UNITS.get(bare_unit(cell), "") for cell in of_units]
    titles = [
        next(
            (
                cell
                for row in (*rows[header_at:first], *(row for row in higher if row is not of_units))
                if (cell := drop_invisible("".join(row[at : at + 1]))) and not cell.isdigit()
            ),
            name,
        )
        for at, name in enumerate(header)
    ]
    mark = SEPARATORS[separator]
    names, sample = _tables(number_equal_names(header), [_cells(line, mark) for _, line in usable[first:]])
    more = len(names) - width
    return FoundTable(
        path=path,
        separator=separator,
        header=tuple(names),
        titles=(*(number_equal_names(titles) if titles == header else titles), *names[width:]),
        units=(*units[:width], *[""] * more),
        rows=tuple(sample),
        above=tuple(lines[: usable[header_at][0]]),
    )


_OPEN_CELL = re.compile(r'(?:^|[,;\t|]) *"(?:[^"]|"")*$')
"""A quoted cell that does not end in its line; a mark within a cell, as of inches, opens none."""


def _whole_rows(lines: Sequence[str]) -> Iterator[tuple[int, str]]:
    """The lines, those joined over which a quoted cell goes on; a mark that is never closed joins none."""
    at = 0
    while at < len(lines):
        end = at + 1
        if _OPEN_CELL.search(lines[at]):
            closed = (other for other in range(end, min(at + MAX_ROW_LINES, len(lines))) if lines[other].count('"') % 2)
            end = next(closed, at) + 1
        yield at, "\n".join(lines[at:end])
        at = end


def _first_data(rows: Sequence[Sequence[str]]) -> int | None:
    """Where the readings begin: the first row of the usual width with readings, the next row being such too.

    Lines before the header may hold a date as well, as of when an export was made.
    """
    found = [place for place, row in enumerate(rows) if _is_data(row)]
    widths = [len(rows[place]) for place in found]
    usual = max(set(widths), key=widths.count, default=0)
    own = [place for place in found if len(rows[place]) == usual]
    return next((place for place in own if place + 1 in own or place == own[-1]), None)


def _no_data(path: Path, rows: Sequence[Sequence[str]]) -> str:
    """Why no row holds readings, with the cell of the column that is named like a time."""
    most = max(map(len, rows), default=0)
    for place, row in enumerate(rows[:-1]):
        at = next((column for column, name in enumerate(row) if named_time(name)), None)
        if at is not None and len(row) >= most - 1 and len(rows[place + 1]) > at:
            shown = rows[place + 1][at]
            why = (
                "a spreadsheet has rounded it, and the seconds are lost; export it again as text"
                if looks_rounded_count(shown)
                else ("no form of a time that is known; write it as 2024-03-13 09:58:00, or as seconds")
            )
            return f"{path}: the cells of its column {row[at]!r} are no times: {shown!r} is {why}"
    return (
        f"{path}: no row with a time stands under a header in its first {len(rows)} lines; give a CSV whose "
        "columns have names, and one column (or two: date and time) of times"
    )


def _tables(header: Sequence[str], rows: Sequence[Sequence[str]]) -> tuple[list[str], list[tuple[str, ...]]]:
    """All names of a file's tables, and its rows under them; a row of names begins a table, as it does for reading."""
    names, own = list(header), list(header)
    places = straight = list(range(len(own)))
    sample: list[tuple[str, ...]] = []
    words = {fold_name(name) for name in own if not _numeric(name)}
    begins = _first_letters(words)
    for row in rows:
        # Most rows are numbers, whose first character begins no name.
        if not begins.isdisjoint([cell[:1] for cell in row]) and _is_header(row, words):
            own = number_equal_names([*row])
            while own and not own[-1]:
                own.pop()
            known = list(map(fold_name, names))
            names += [name for name in own if fold_name(name) not in known]
            known = list(map(fold_name, names))
            places, straight = [known.index(fold_name(name)) for name in own], list(range(len(own)))
            words = {fold_name(name) for name in own if not _numeric(name)}
            begins = _first_letters(words)
        elif len(row) >= len(own) and not any(row[len(own) :]):
            cells = row[: len(own)]
            if places != straight:
                cells = [""] * len(names)
                for place, cell in zip(places, row, strict=False):
                    cells[place] = cell
            sample.append(tuple(cells))
    width = len(names)
    return names, [row if len(row) == width else (*row, *[""] * (width - len(row))) for row in sample]


def _first_letters(names: Set[str]) -> frozenset[str]:
    """The first letters of folded names as they may be written."""
    return frozenset(letter for name in names for letter in (name[:1], name[:1].upper(), name[:1].title()))


def _is_header(row: Sequence[str], words: Set[str]) -> bool:
    """Whether half of a row's cells, two at least, are names of columns."""
    filled = {fold_name(cell) for cell in row if cell}
    return len(filled & words) >= max(2, len(filled) / 2)


def with_rows(table: FoundTable, kept: Sequence[bool]) -> FoundTable:
    """The table with some of its rows."""
    return replace(table, rows=tuple(row for row, keep in zip(table.rows, kept, strict=True) if keep))


def with_joined(table: FoundTable, places: Sequence[int]) -> FoundTable:
    """The table with what stands in one of the columns at `places` in the first of them."""
    if len(places) < 2:
        return table
    joined, _ = join_cells([table.column(place) for place in places])
    rows = []
    for row, cell in zip(table.rows, joined, strict=True):
        cells = ["" if at in places else each for at, each in enumerate(row)]
        cells[places[0]] = cell
        rows.append(tuple(cells))
    return replace(table, rows=tuple(rows))


def _cells(line: str, mark: str) -> list[str]:
    if line and '"' not in line:
        row = line.split(mark)
    else:
        row = next(csv.reader(line.splitlines(keepends=True), delimiter=mark, skipinitialspace=True), [])
    return [cell.strip() for cell in bare_cells(row)]


def _is_data(row: Sequence[str]) -> bool:
    """Whether a row holds readings: a date, or numbers and nothing that a header has."""
    if len(row) < 2:
        return False
    if any(tells_time(cell) for cell in row):
        return True
    if spoken_seconds(row[0]) is not None and any(map(_numeric, row[1:])):
        return True
    filled = [cell for cell in row if cell]
    return bool(row[0]) and len(filled) > 1 and all(_numeric(cell) for cell in filled)


_WHOLE = re.compile(r"[+-]?\d+")


def _has_commas(row: Sequence[str], names: int) -> bool:
    """Whether a row has more cells than `names`, and behind its time only the wholes and the decimals of numbers."""
    return sum(map(bool, row)) > names and all(map(_WHOLE.fullmatch, filter(None, row[1:])))


def _has_equal(names: Sequence[str]) -> bool:
    filled = [name for name in names if name]
    return len(set(filled)) < len(filled)


def _lacks_names(above: Sequence[str], below: Sequence[str]) -> bool:
    """Whether a row of words leaves blank what the words in the row below it name."""
    words = not any(map(_numeric, filter(None, (*above, *below))))
    blank = [place for place, cell in enumerate(below) if cell and not "".join(above[place : place + 1])]
    return words and len(blank) > 0


_TYPE = re.compile(
    r"(?:dt_)?(?:l?real|float|double|u?[sdl]?int|bool|boolean|d?word|byte|string)_?\d*|"
    r"%?db\d+\.db[xbwd]\d+(?:\.\d+)?|%[miqea][xbwd]?\d+(?:\.\d+)?",
    re.IGNORECASE,
)
"""A data type, or an address of a controller; I1 and M1 are names too."""


def _is_types(row: Sequence[str]) -> bool:
    """Whether a row under the header says types or addresses, behind what may say that it does."""
    filled = [cell for cell in row[1:] if cell]
    return len(filled) > 1 and all(map(_TYPE.fullmatch, filled))


def _is_reading(row: Sequence[str], sure: Sequence[str]) -> bool:
    """Whether a row that stands above a sure row of readings is one too, of fewer cells or with words in them."""
    return _is_data(row) or is_time(row[0]) or (_numeric(row[0]) and _numeric(sure[0]))


def _counts_time(above: Sequence[str], row: Sequence[str]) -> bool:
    """Whether a number stands under a name that speaks of time, in a row of names."""
    return (
        len(above) == len(row)
        and not any(map(_numeric, filter(None, above)))
        and any(named_time(name) and _numeric(cell) for name, cell in zip(above, row, strict=True) if cell)
    )


def _mostly_numbers(row: Sequence[str]) -> bool:
    filled = [cell for cell in row if cell]
    return len(filled) > 1 and 2 * sum(map(_numeric, filled)) > len(filled)


def has_numbers(table: FoundTable, place: int) -> bool:
    """Whether a column has readings, and not texts alone."""
    return any(cell and _numeric(cell) for cell in table.column(place))


def _numeric(cell: str) -> bool:
    # Of most numbers Python says it at once; of a cell alone an array takes longer than the number.
    with suppress(ValueError):
        if "_" not in cell and isfinite(float(cell)):
            return True
    return bool(np.isfinite(numbers([cell])[0][0])) or parse_quantity(cell, "auto")[1] != ""


def _is_units(row: Sequence[str]) -> bool:
    """Whether a row under the header says units: one that is known and nothing that is long, or several."""
    filled = [bare_unit(cell) for cell in row if cell]
    # min beside max and mean is no minute.
    parts = {"min"} if _STATISTICS.intersection(filled) else set()
    known = sum(cell in UNITS and cell not in parts for cell in filled)
    # Date, Time, sec: the clock in columns of its own.
    clocks = sum(named_time(cell) and cell not in UNITS for cell in filled)
    return known > 1 or (known == 1 and clocks < 2 and all(len(cell) <= 6 for cell in filled))


_STATISTICS = frozenset({"max", "mean", "avg", "average", "median", "std", "mittel", "mittelwert", "moy", "media"})
"""What stands beside a min that is a least one."""
