"""A CSV as text: its encoding, separator and header found or refused in one sentence, its rows as cells.

The standard library's reader splits the rows. What is added here: the line on which each row begins, comments and blank
lines between rows, and the rule that one bad row costs one row, a quotation mark that is never closed included.
"""

import csv
import io
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice, pairwise
from pathlib import Path
from unicodedata import category

import numpy as np
from numpy.typing import NDArray

from drivers.errors import did_you_mean
from sim.lab.recordings.cells import Points, bare_cells, booleans, numbers, rewrite_points
from sim.lab.recordings.column_map import ColumnMap, Names
from sim.lab.recordings.load_report import FileReport, TraceError, list_names
from sim.lab.recordings.sources import open_source, read_head, recording_name
from sim.lab.recordings.text_encoding import decode_head
from sim.lab.recordings.unit_table import known_unit

Lines = NDArray[np.intp]
"""Numbers of lines of a file, from 1."""
SEPARATORS = {",": ",", ";": ";", "tab": "\t", "|": "|"}
_HEAD_BYTES = 262_144
_CHUNK_LINES = 20_000
_BLOCK_LINES = 500
"""Lines that are split in one call where none of them has a quotation mark. One mark costs its block the short way."""
MAX_ROW_LINES = 50
"""Lines that one row may take. A quotation mark that stays open for longer is a fault of its line."""
_SURE_SEPARATORS = ";\t|"
"""Separators that no number or time has within."""
_SHOWN_ROWS = 5
"""Rows under a header that show the separator they are written with."""
_MIN_NAME_LETTERS = 3
"""Letters of a name that hardly stands in a row by chance."""
MAX_HEADER_LINE = 200
"""Lines among which a header is looked for, comments not counted: cyclers write their settings before it."""
UNNAMED_COLUMN = "column 1"
"""What a first column without a name is called: an index that a program has written beside its table."""
_VALUES = frozenset({"value", "wert", "valore", "valeur", "valor"})
"""What stands under a tag's name over its readings."""
_NOTES = frozenset({"", "comment", "comments", "note", "notes", "remark", "remarks", "kommentar", "bemerkung"})
"""Names of last columns of which rows without a note have no cell."""


@dataclass(frozen=True, slots=True)
class TextLayout:
    """How a file is written. `skip` lines come before its first row; `comments` are those of them, without the mark.

    A row with names for all `clock` columns is a header once more: what comes below is a table of its own.
    """

    encoding: str
    separator: str
    header: tuple[str, ...]
    skip: int
    comments: tuple[str, ...]
    clock: tuple[Names, ...] = ()
    points: tuple[tuple[str, Points], ...] = ()
    """Columns, and what their lone points are."""

    def is_header(self, cells: Sequence[str]) -> bool:
        """Whether a row is a header."""
        names = tuple(cell.strip() for cell in cells)
        if names == self.header or (self.header[:1] == (UNNAMED_COLUMN,) and names == ("", *self.header[1:])):
            return True
        return bool(self.clock) and all(find_column(cells, names) is not None for names in self.clock)


def drop_invisible(name: str) -> str:
    """A name without the marks that nobody sees: where it may be broken, and which way it is written."""
    return name if name.isascii() else "".join(mark for mark in name if category(mark) != "Cf")


def fold_name(name: str) -> str:
    """A name without the spelling of its blanks, of its letters' case and of what nobody sees."""
    return " ".join(drop_invisible(name).split()).casefold()


def number_equal_names(names: Sequence[str]) -> list[str]:
    """A header whose equal names are numbered: Value, Value_2, Value_3."""
    apart: list[str] = []
    for name in names:
        count = 1 + sum(name == before for before in names[: len(apart)])
        apart.append(f"{name}_{count}" if name and count > 1 and f"{name}_{count}" not in names else name)
    return apart


def compose_names(above: Sequence[str], below: Sequence[str]) -> list[str]:
    """The names in two rows, as under merged cells: what stands over several columns, and what tells these apart."""
    names, group = list[str](), ""
    for place in range(max(len(above), len(below))):
        over, own = (drop_invisible(row[place]).strip() if place < len(row) else "" for row in (above, below))
        group = over or (group if own else "")
        # Beside a quality, the value of a tag is the tag.
        told = "" if group and own.casefold() in _VALUES else own
        names.append(" ".join(filter(None, (group, told))))
    return names


def with_row_names(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """A header with a name for the numbers of the rows, where the `rows` below begin with such and have one cell more.

    R writes them so. A decimal comma makes a cell more too, but no count.
    """
    first = [row[0] for row in rows if row]
    counts = [int(cell) for cell in first if cell.isdecimal()]
    counted = len(counts) == len(first) > 1 and all(after == before + 1 for before, after in pairwise(counts))
    longer = all(len(row) == len(header) + 1 for row in rows) and any(row[-1].strip() for row in rows)
    return [UNNAMED_COLUMN, *header] if counted and longer and UNNAMED_COLUMN not in header else list(header)


def rows_mark(lines: Sequence[str], width: int, mark: str) -> str:
    """The separator of the rows under a header of `width` names: its own `mark`, unless only another fits all of them.

    Some programs write the header with commas and the rows, for their decimal commas, with semicolons.
    """
    rows = [line for line in lines if line.strip()]

    def count_numbers(each: str) -> int:
        """Cells that are numbers, less those that another mark would cut, if all rows have the width."""
        split = [_header([row], each)[0] for row in rows]
        if not all(len(cells) == width for cells in split):
            return -1
        # Cell by cell: the points of a date are no decimal points.
        every = [cell for cells in split for cell in cells]
        whole = sum(bool(np.isfinite(numbers([cell])[0][0])) for cell in every)
        return max(whole - sum(any(mark in cell for mark in _SURE_SEPARATORS) for cell in every), 0)

    best = max(SEPARATORS.values(), key=lambda each: (count_numbers(each), each == mark))
    return best if rows and count_numbers(best) > max(count_numbers(mark), 0) else mark


def find_column(header: Sequence[str], names: Names) -> int | None:
    """Where the first of `names` that the header has stands; upper and lower case matter only if both are there."""
    alike = [fold_name(name) for name in header]
    for name in names:
        if name in header:
            return header.index(name)
        if alike.count(fold_name(name)) == 1:
            return alike.index(fold_name(name))
    return None


def find_layout(
    path: Path, column_map: ColumnMap, clock: Sequence[Names], sources: Sequence[Names], report: FileReport
) -> TextLayout:
    """Encoding, separator and header of `path`.

    Raises TraceError unless all columns of `clock` and `sources` are there.
    """
    needed = [*clock, *sources]
    head = read_head(path, _HEAD_BYTES)
    if not head:
        raise TraceError(f"{path}: the file is empty; give one with a header and rows")
    encoding, text, note = decode_head(path, head, column_map.encoding)
    report.notes += [note] if note else []
    lines = list(io.StringIO(text, newline=None))
    comments: list[str] = []
    first = 0
    for line in lines:
        if column_map.comment and line.startswith(column_map.comment):
            comments.append(line[len(column_map.comment) :].strip())
        elif line.strip():
            break
        first += 1
    else:
        raise TraceError(
            f"{path}: there is nothing in it but comments and blank lines; give a file with a header and rows"
        )
    # The map's own separator first; of the others any under which the header's names fit.
    own = SEPARATORS.get(column_map.separator)
    marks = sorted(SEPARATORS.values(), key=lambda mark: mark != own)
    # An export may begin with a title, its query or a list of columns: the header is the first row that has the names.
    at, fits = first, list[str]()
    for at in range(first, min(first + MAX_HEADER_LINE, len(lines))):
        # Names in two rows first: one row of them may have those that are needed, and too few of the others.
        for header_of in (_header_of_two, _header):
            headers = {mark: header_of(lines[at : at + MAX_ROW_LINES], mark) for mark in marks}
            fits = [mark for mark in marks if all(find_column(headers[mark][0], group) is not None for group in needed)]
            if fits:
                break
        if fits:
            break
    if fits and at > first:
        report.notes.append(f"lines {first + 1} to {at} come before its header")
    if not fits:
        headers = {mark: _header(lines[first : first + MAX_ROW_LINES], mark) for mark in marks}
    # Without a header: only where the map names the columns and the first line has one number for each.
    bare: list[str] = []
    for mark, (cells, _) in headers.items():
        if cells and len(cells) == len(column_map.columns):
            values, _ = numbers(cells, column_map.decimal)
            if (values == values).all():
                bare.append(mark)
    if fits:
        (header, span) = headers[fits[0]]
        skip = at + span
        separator = rows_mark(lines[skip : skip + _SHOWN_ROWS], len(header), fits[0])
    elif len(bare) == 1:
        separator, header, skip = bare[0], column_map.columns, first
    else:
        raise TraceError(_no_header(path, first + 1, [names for names, _ in headers.values()], needed, column_map))
    if own is not None and separator != own:
        report.notes.append(f"its separator is {separator!r}, not {column_map.separator!r} as the map says")
    if not fits:
        report.notes.append(f"it has no header; its columns are taken for {list_names(column_map.columns)}")
    if fits:
        if len(clock) > 1 and _says_units(
            (units := _header(lines[skip : skip + MAX_ROW_LINES], separator))[0], header, clock
        ):
            report.notes.append(f"line {skip + 1} says the units")
            skip += units[1]
        shown = [cells for line in lines[skip : skip + _SHOWN_ROWS] if (cells := _header([line], separator)[0])]
        header = tuple(with_row_names(header, shown))
        kept = header[: _narrower(lines[skip:], separator, len(header))]
        # Which cell is missing only a column that people leave empty says, below readings up to the last kept name.
        optional = all(fold_name(name) in _NOTES for name in header[len(kept) :])
        optional &= any(len(cells) == len(kept) and _is_reading(cells[-1]) for cells in shown)
        if kept != header and optional and all(find_column(kept, names) is not None for names in needed):
            report.warn(f"none of its rows has a cell for {list_names(header[len(kept) :])}")
            header = kept
    named = tuple(number_equal_names(header))
    if named != tuple(header):
        report.warn(f"columns have the same name; they are told apart as {list_names(set(named) - set(header))}")
    report.columns = named
    own_name = f"{recording_name(path)}/" if column_map.parts else ""
    points = tuple((column.removeprefix(own_name), points) for column, points in column_map.points.items())
    absent = [column for column, _ in points if find_column(named, (column,)) is None]
    if absent and not column_map.parts:
        report.warn(f"there is no column {list_names(map(repr, absent))}, of whose points the map speaks")
    return TextLayout(encoding, separator, named, skip, tuple(comments), tuple(clock) if fits else (), points)


def _is_reading(cell: str) -> bool:
    """Whether a cell is a number or a word of a switch, and no note."""
    return bool(np.isfinite(numbers([cell])[0][0])) or not booleans([cell])[1][0]


def _narrower(lines: Sequence[str], separator: str, width: int) -> int:
    """The cells of each row, if all of the plain `lines` have as many and fewer than the header's `width`."""
    rows = [line for line in lines if line.strip()]
    counts = {line.count(separator) + 1 for line in rows}
    narrow = len(rows) > 1 and len(counts) == 1 and not any('"' in line for line in rows)
    return min(*counts, width) if narrow and min(counts) > 1 else width


def _header(lines: Sequence[str], separator: str) -> tuple[tuple[str, ...], int]:
    """The names in the row that begins with the first of `lines`, and how many lines it takes; no names: no row."""
    # A name may have marks within, as "DB1".Speed has; only an open one makes no row.
    strict = not lines or lines[0].count('"') % 2 == 1
    reader = csv.reader(lines, delimiter=separator, skipinitialspace=True, strict=strict)
    try:
        return tuple(_trim_header(bare_cells(next(reader)))), reader.line_num
    except csv.Error:
        return (), 1


def _header_of_two(lines: Sequence[str], separator: str) -> tuple[tuple[str, ...], int]:
    """The names in two lines of which the first leaves cells blank; none where it is not so."""
    rows = [bare_cells(next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])) for line in lines[:2]]
    if len(rows) < 2 or len(rows[1]) < 2 or all(map(str.strip, rows[0][: len(rows[1])])) or not any(rows[0]):
        return (), 1
    return tuple(_trim_header(compose_names(*rows))), 2


def _says_units(row: Sequence[str], header: Sequence[str], clock: Sequence[Names]) -> bool:
    """Whether the row under the header says the units of the columns, and no time."""
    times = {row[at] for names in clock if (at := find_column(header, names)) is not None and at < len(row)}
    bare = [cell.strip("[](){} ") for cell in row if cell not in ("", UNNAMED_COLUMN)]
    known = sum(map(bool, map(known_unit, bare)))
    timeless = all(cell in ("", UNNAMED_COLUMN) or known_unit(cell.strip("[](){} ")) for cell in times)
    return timeless and 2 * known >= max(len(bare), 1) and not np.isfinite(numbers(bare, "auto")[0]).any()


def _trim_header(cells: Sequence[str]) -> list[str]:
    """The names of a header, without blank ones at its end; a first one that is blank is that of an index."""
    names = [drop_invisible(cell).strip() for cell in cells]
    while names and not names[-1]:
        names.pop()
    return [names[0] or UNNAMED_COLUMN, *names[1:]] if len(names) > 1 else names


def _no_header(
    path: Path, number: int, headers: Sequence[Sequence[str]], needed: Sequence[Names], column_map: ColumnMap
) -> str:
    names = max(headers, key=len)
    lacking = [" or ".join(map(repr, group)) for group in needed if find_column(names, group) is None]
    if len(names) > 1:
        present = f"its columns are {list_names(names)}"
    else:
        present = f"its only column is {repr(names[0][:60]) if names else 'blank'}"
    # The nearest name of what is lacking, if there is one: most often a letter or a blank is the whole difference.
    questions = (did_you_mean(name, names) for group in needed if find_column(names, group) is None for name in group)
    meant = next(filter(None, questions), "")
    bare = f", and it is no row of {len(column_map.columns)} numbers without header" if column_map.columns else ""
    return (
        f"{path}: line {number}: there is no column {', '.join(lacking)}; {present}{bare}; "
        f"{meant}{' ' if meant else ''}give the file for which the column map was written, or this file's own map "
        f"(`decanter trace map` drafts one)"
    )


@dataclass(slots=True)
class _Gathered:
    """Rows under one header, not handed on yet: their line numbers and, column by column, their cells."""

    width: int
    lines: list[Lines] = field(default_factory=list)
    columns: list[list[str]] = field(default_factory=list)
    count: int = 0

    def add(self, lines: Lines, columns: Iterable[Sequence[str]]) -> None:
        if not self.columns:
            self.columns = [[] for _ in range(self.width)]
        self.lines.append(lines)
        for known, more in zip(self.columns, columns, strict=True):
            known += more
        self.count += lines.size

    def take(self) -> tuple[Lines, list[list[str]]]:
        """What is there, which is not there any more then."""
        lines, columns = np.concatenate(self.lines), self.columns
        self.lines, self.columns, self.count = [], [], 0
        return lines, columns


def read_rows(
    path: Path, layout: TextLayout, comment: str, report: FileReport
) -> Iterator[tuple[TextLayout, Lines, list[list[str]]]]:
    """The rows of a file in chunks: the layout with the header above them, line numbers (from 1), cells by column.

    Each row has as many cells as that header; the others are refused. `report` counts the cells that are filled.
    """
    rows = _Gathered(len(layout.header))
    # A byte that does not decode makes its cell no number, which is then reported; it must not end the reading.
    with io.TextIOWrapper(open_source(path), encoding=layout.encoding, errors="replace", newline=None) as stream:
        lines = islice(stream, layout.skip, None)
        below = layout.skip + 1  # the number of the next line

        def further() -> Iterator[tuple[int, str]]:
            nonlocal below
            for line in lines:
                below += 1
                yield below - 1, line

        # No block is longer than the room in the chunk, so that chunks end at the same rows whatever way they came.
        while block := list(islice(lines, min(_BLOCK_LINES, _CHUNK_LINES - rows.count))):
            # Most files have no quotation mark: their lines are rows, and one call splits a whole block. Where anything
            # is unusual, each row is looked at by itself.
            first, below = below, below + len(block)
            plain = _plain_columns(block, layout, comment)
            if plain is not None:
                report.rows += len(block)
                rows.add(np.arange(first, below), plain)
                if rows.count == _CHUNK_LINES:
                    yield _with_points(layout, *rows.take())
                continue
            width = [len(layout.header)]
            singly = split_rows(
                enumerate(block, first), further(), separator=layout.separator, comment=comment, width=width
            )
            for number, cells, fault in singly:
                report.rows += 1
                filled = sum(map(bool, map(str.strip, cells)))
                if fault:
                    report.refuse([number], "it cannot be split into cells", [fault])
                elif cells and layout.is_header(cells):
                    header = tuple(number_equal_names(_trim_header(cells)))
                    report.refuse_cells(filled)
                    if header == layout.header:
                        report.refuse([number], "it is the header again")
                        continue
                    report.refuse([number], "a header of other names, or in another order, begins here")
                    if rows.count:
                        yield _with_points(layout, *rows.take())
                    layout = replace(layout, header=header)
                    report.columns += tuple(name for name in header if find_column(report.columns, (name,)) is None)
                    width[0] = rows.width = len(header)
                elif len(cells) != len(layout.header):
                    detail = f"{len(cells)}, not {len(layout.header)}"
                    report.refuse([number], "it has another number of cells than the header", [detail])
                    report.refuse_cells(filled)
                else:
                    rows.add(np.array([number]), [[cell] for cell in cells])
                if rows.count == _CHUNK_LINES:
                    yield _with_points(layout, *rows.take())
    if rows.count:
        yield _with_points(layout, *rows.take())


def _with_points(
    layout: TextLayout, lines: Lines, columns: list[list[str]]
) -> tuple[TextLayout, Lines, list[list[str]]]:
    """The rows with points as the map says that they are meant."""
    for name, points in layout.points:
        if (place := find_column(layout.header, (name,))) is not None:
            columns[place] = rewrite_points(columns[place], points)
    return layout, lines, columns


def _plain_columns(lines: Sequence[str], layout: TextLayout, comment: str) -> Sequence[Sequence[str]] | None:
    """The columns of lines of which each is a row of the header's width; None where one may be anything else."""
    text, mark, width = "".join(lines), layout.separator, len(layout.header)
    if (comment and comment in text) or any(map(str.isspace, lines)):
        return None
    if '"' in text:
        return _quoted_columns(lines, text, layout)
    # A row of another width is refused, or loses blank cells; a header may come again. Both are looked at singly.
    if {line.count(mark) for line in lines} != {width - 1} or max(map(len, lines)) > csv.field_size_limit():
        return None
    flat = text.replace("\n", mark).split(mark)
    columns = [flat[place : len(lines) * width : width] for place in range(width)]
    if mark + " " in text or text.startswith(" ") or "\n " in text:
        columns = [list(map(_without_first_blanks, column)) for column in columns]
    if _names_a_column(columns, text, layout):
        return None
    return [bare_cells(column) for column in columns] if "'" in text or '="' in text else columns


def _quoted_columns(lines: Sequence[str], text: str, layout: TextLayout) -> Sequence[Sequence[str]] | None:
    """The same of lines with quotation marks: None also where a cell goes on over lines, or a mark is amiss."""
    try:
        rows = list(csv.reader(lines, delimiter=layout.separator, skipinitialspace=True, strict=True))
    except csv.Error:
        return None
    if len(rows) != len(lines) or set(map(len, rows)) != {len(layout.header)}:
        return None
    columns = list(zip(*rows, strict=True))
    if _names_a_column(columns, text, layout):
        return None
    return [bare_cells(column) for column in columns] if "'" in text or '="' in text else columns


def _without_first_blanks(cell: str) -> str:
    return cell.lstrip(" ")


def _names_a_column(columns: Sequence[Sequence[str]], text: str, layout: TextLayout) -> bool:
    """Whether a header may be among the rows: one has the first column's name, or one that the clock's may have."""
    if layout.header[0] in columns[0]:
        return True
    small = text.casefold()
    for names in layout.clock[:1]:
        for name in names:
            words = fold_name(name).split() or [""]
            if words[0] in small and (len(words[0]) >= _MIN_NAME_LETTERS or any(name in column for column in columns)):
                return True
    return False


def split_rows(
    block: Iterable[tuple[int, str]],
    lines: Iterator[tuple[int, str]],
    *,
    separator: str,
    comment: str,
    width: list[int],
) -> Iterator[tuple[int, list[str], str]]:
    """(number of its first line, cells, what is wrong with it) of each row; blank cells beyond `width[0]` are dropped.

    The rows that begin in `block`; the last of them may go on in `lines`, which come after it.

    A quoted cell may go on over several lines (RFC 4180), and so may its row. But a quotation mark that somebody forgot
    to close must not swallow the rows below it. So a row of several lines only counts if the mark is closed within
    MAX_ROW_LINES and `width[0]` cells come out; if not, its first line alone is the bad row, and reading resumes on the
    next.
    """
    ahead = deque(block)  # lines to be split, those included that a bad row had taken beyond its first
    taken: list[tuple[int, str]] = []  # those of the row that is being split

    def feed() -> Iterator[str]:
        while ahead or taken:
            numbered = ahead.popleft() if ahead else next(lines, None)
            if numbered is None:
                return  # the file ends inside a quoted cell, which the strict reader calls an unexpected end of data
            line = numbered[1]
            # Inside a quoted cell a blank line, or one that looks like a comment, is text.
            if not taken and (line.isspace() or (comment and line.startswith(comment))):
                continue
            taken.append(numbered)
            yield line
            if len(taken) == MAX_ROW_LINES:
                return  # inside a quoted cell, too: the same fault

    while ahead:
        try:
            for cells in csv.reader(feed(), delimiter=separator, skipinitialspace=True, strict=True):
                # The header may change on the way, and with it the width.
                if len(cells) > width[0] and not "".join(cells[width[0] :]).strip():
                    del cells[width[0] :]
                if len(taken) > 1 and len(cells) != width[0]:
                    fault = f"a quotation mark is open at its end; with the lines below it has {len(cells)} cells"
                    break
                number = taken[0][0]
                taken.clear()
                yield number, bare_cells(cells), ""
            else:
                return
        except csv.Error as error:
            fault = str(error)
        # The reader is in the middle of a row, or too far on: the next row gets a new one.
        ahead.extendleft(reversed(taken[1:]))
        number = taken[0][0]
        taken.clear()
        yield number, [], fault
