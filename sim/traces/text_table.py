"""A CSV as text: its encoding, separator and header found or refused in one sentence, its rows as cells."""

import codecs
import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from sim.traces.cells import numbers
from sim.traces.column_map import ColumnMap, Names
from sim.traces.load_report import FileReport, TraceError, listed

SEPARATORS = {",": ",", ";": ";", "tab": "\t", "|": "|"}
_HEAD = 262_144
_CHUNK = 100_000
_BOMS = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))


@dataclass(frozen=True, slots=True)
class Layout:
    """How a file is written. `skip` lines come before its first row; `comments` are those of them, without the mark."""

    encoding: str
    separator: str
    header: tuple[str, ...]
    skip: int
    comments: tuple[str, ...]


def place_of(header: Sequence[str], names: Names) -> int | None:
    """Where the first of `names` that the header has stands; upper and lower case matter only if both are there."""
    folded = [name.casefold() for name in header]
    for name in names:
        if name in header:
            return header.index(name)
        if folded.count(name.casefold()) == 1:
            return folded.index(name.casefold())
    return None


def split_cells(line: str, separator: str) -> list[str]:
    """The cells of one line. Raises csv.Error when a quotation mark is not closed."""
    if '"' not in line:
        return line.split(separator)
    return next(csv.reader([line], delimiter=separator, skipinitialspace=True, strict=True))


def find_layout(path: Path, column_map: ColumnMap, needed: Sequence[Names], report: FileReport) -> Layout:
    """Encoding, separator and header of `path`. Raises TraceError, saying what is there, unless all `needed` are."""
    with path.open("rb") as stream:
        head = stream.read(_HEAD)
    if not head:
        raise TraceError(f"{path}: the file is empty; give one with a header and rows")
    encoding, text = _decode(path, head, column_map.encoding, report)
    lines = io.StringIO(text, newline=None)
    comments: list[str] = []
    for number, line in enumerate(lines, 1):
        mark = column_map.comment
        if mark and line.startswith(mark):
            comments.append(line[len(mark) :].strip())
        elif line.strip():
            return _layout(path, column_map, needed, report, (number, line), (encoding, tuple(comments)))
    raise TraceError(f"{path}: there is nothing in it but comments and blank lines; give a file with a header and rows")


def _decode(path: Path, head: bytes, encoding: str, report: FileReport) -> tuple[str, str]:
    bom = next((name for mark, name in _BOMS if head.startswith(mark)), None)
    chosen = bom or (encoding if encoding != "auto" else "utf-8")
    try:
        text = codecs.getincrementaldecoder(chosen)("strict").decode(head, False)
    except UnicodeDecodeError:
        chosen = "cp1252" if encoding == "auto" and bom is None else chosen
        text = head.decode(chosen, "replace")
        report.notes.append(f"it is not clean {encoding if bom is None else bom} text; read as {chosen}")
    strange = sum(char < " " and char not in "\t\r\n\f" for char in text[:4096])
    if "\x00" in text[:4096] or strange * 20 > len(text[:4096]):
        raise TraceError(f"{path}: this is not a text file; give the CSV, unpacked")
    return chosen, text


def _header(line: str, separator: str) -> tuple[str, ...]:
    try:
        names = [cell.strip() for cell in split_cells(line.rstrip("\n"), separator)]
    except csv.Error:
        return ()
    while names and not names[-1]:
        names.pop()
    return tuple(names)


def _layout(
    path: Path,
    column_map: ColumnMap,
    needed: Sequence[Names],
    report: FileReport,
    first: tuple[int, str],
    found: tuple[str, tuple[str, ...]],
) -> Layout:
    number, line = first
    encoding, comments = found
    headers = {separator: _header(line, separator) for separator in _in_order(column_map)}
    fits = [mark for mark, names in headers.items() if all(place_of(names, group) is not None for group in needed)]
    if fits:
        _note_separator(column_map, fits[0], report)
        return Layout(encoding, fits[0], headers[fits[0]], number, comments)
    bare = [mark for mark, cells in headers.items() if _is_bare_row(cells, column_map)]
    if len(bare) == 1:
        _note_separator(column_map, bare[0], report)
        report.notes.append(f"it has no header; its columns are taken for {listed(column_map.columns)}")
        return Layout(encoding, bare[0], column_map.columns, number - 1, comments)
    raise TraceError(_no_header(path, number, headers, needed, column_map))


def _in_order(column_map: ColumnMap) -> list[str]:
    given = SEPARATORS.get(column_map.separator)
    return sorted(SEPARATORS.values(), key=lambda mark: mark != given)


def _note_separator(column_map: ColumnMap, separator: str, report: FileReport) -> None:
    if column_map.separator != "auto" and separator != SEPARATORS[column_map.separator]:
        report.notes.append(f"its separator is {separator!r}, not {column_map.separator!r} as the map says")


def _is_bare_row(cells: Sequence[str], column_map: ColumnMap) -> bool:
    """Safe only where the map names the columns and the first line has one number for each."""
    if not cells or len(cells) != len(column_map.columns):
        return False
    values, _ = numbers(cells, column_map.decimal)
    return bool((values == values).all())


def _no_header(
    path: Path, number: int, headers: dict[str, tuple[str, ...]], needed: Sequence[Names], column_map: ColumnMap
) -> str:
    names = max(headers.values(), key=len)
    lacking = [" or ".join(map(repr, group)) for group in needed if place_of(names, group) is None]
    there = f"its columns are {listed(names)}" if len(names) > 1 else f"its only column is {line_start(names)}"
    bare = f", and it is no row of {len(column_map.columns)} numbers without header" if column_map.columns else ""
    return (
        f"{path}: line {number}: there is no column {', '.join(lacking)}; {there}{bare}; "
        "give the file for which the column map was written, or correct the map"
    )


def line_start(names: Sequence[str]) -> str:
    """The beginning of a line that is no header, fit for a sentence."""
    return repr(names[0][:60]) if names else "blank"


def read_rows(
    path: Path, layout: Layout, comment: str, report: FileReport
) -> Iterator[tuple[list[int], list[list[str]]]]:
    """The rows of a file in chunks: line numbers (from 1) and cells, as many as the header has; the others refused."""
    lines: list[int] = []
    rows: list[list[str]] = []
    # A byte that does not decode makes its cell no number, which is then told; it must not end the reading.
    with path.open(encoding=layout.encoding, errors="replace", newline=None) as stream:
        for number, line in enumerate(stream, 1):
            if number <= layout.skip or line.isspace() or (comment and line.startswith(comment)):
                continue
            report.rows += 1
            cells = _cells(line.rstrip("\n"), number, layout, report)
            if cells is not None:
                lines.append(number)
                rows.append(cells)
            if len(rows) == _CHUNK:
                yield lines, rows
                lines, rows = [], []
    if rows:
        yield lines, rows


def _cells(line: str, number: int, layout: Layout, report: FileReport) -> list[str] | None:
    try:
        cells = split_cells(line, layout.separator)
    except csv.Error as error:
        report.refuse([number], "it cannot be split into cells", [str(error)])
        return None
    width = len(layout.header)
    if len(cells) == width:
        if cells[0] == layout.header[0] and tuple(cell.strip() for cell in cells) == layout.header:
            report.refuse([number], "it is the header again")
            return None
        return cells
    if len(cells) > width and not any(cell.strip() for cell in cells[width:]):
        return cells[:width]
    report.refuse([number], "it has another number of cells than the header", [f"{len(cells)}, not {width}"])
    return None
