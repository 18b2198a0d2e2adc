"""Rows of CSV: read with the line at which each begins, and written so that no program runs what stands in a cell.

Texts in a table come from a PLC, a device file or a person, and spreadsheet programs take one that begins with = + - or
@ for a formula. Such a text gets an apostrophe before it, which reading takes away again; numbers are left alone.
"""

import csv
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

# Where another program splits: with a comma for the decimals it splits at semicolons, whatever the quotation marks.
_BEGIN = r"(?:^|(?<=[;\t\r\n]))"
_FORMULA = r"(?=[ \v\f\xa0']*[=+\-@\uff1d\uff0b\uff0d\uff20][^;\t\r\n])"
_UNGUARDED = re.compile(_BEGIN + _FORMULA)
_GUARDED = re.compile(_BEGIN + "'" + _FORMULA)


class TextSink(Protocol):
    """A text file, or what takes text as one does."""

    def write(self, text: str, /) -> object:
        """Take a text."""


@dataclass
class CsvRowError(ValueError):
    """A row that is not CSV: the number of its first line, and what `csv` says of it."""

    line: int
    reason: str


def numbered_rows(lines: Iterable[str]) -> Iterator[tuple[int, list[str]]]:
    """(number of its first line, cells) of each row; a quoted cell may go on over several lines.

    Lines that begin with # are comments. `lines` keep their ends. Raises CsvRowError at the first row that is not CSV.
    """
    number, inside = 0, 0

    def feed() -> Iterator[str]:
        nonlocal number, inside
        for line in lines:
            number += 1
            # Between rows comments and blank lines are left out; inside a quoted cell they are its text.
            if inside or (line.strip() and not line.startswith("#")):
                inside += 1
                yield line

    try:
        for cells in csv.reader(feed(), strict=True):
            yield number - inside + 1, strip_guards(cells)
            inside = 0
    except csv.Error as error:
        raise CsvRowError(number - inside + 1, str(error)) from None


def write_rows(sink: TextSink, rows: Iterable[Iterable[object]]) -> None:
    """Write rows as CSV, a header as well: doubles to the last bit, nothing for None, no text that is a formula.

    The one owner of writing CSV. Open the file with `newline=""`. Raises OSError.
    """
    writer = csv.writer(sink, lineterminator="\n")
    writer.writerows([_guard(cell) if isinstance(cell, str) else cell for cell in row] for row in rows)


def strip_guards(cells: Sequence[str]) -> list[str]:
    """Cells as they were before they were written by `write_rows`."""
    return [_GUARDED.sub("", cell) if "'" in cell else cell for cell in cells]


def _guard(text: str) -> str:
    return text if _UNGUARDED.search(text) is None or _numbers(text) else _UNGUARDED.sub("'", text)


def _numbers(text: str) -> bool:
    """True for a number, or several between semicolons."""
    try:
        return all(float(part) is not None for part in text.split(";"))
    except ValueError:
        return False
