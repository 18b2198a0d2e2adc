"""Rows of CSV with the line at which each begins: what recordings and traces of a plant are split by."""

import csv
from collections.abc import Iterable, Iterator
from dataclasses import dataclass


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
            yield number - inside + 1, cells
            inside = 0
    except csv.Error as error:
        raise CsvRowError(number - inside + 1, str(error)) from None
