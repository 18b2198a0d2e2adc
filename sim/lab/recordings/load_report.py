"""What became of every row of every file: used, left aside, refused and why. Counts are exact, details bounded."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path

from drivers.errors import OneLineError
from sim.sha import DECANTER, Alphabet

_COUNTS = (
    "rows", "used", "aside", "refused", "merged", "bad_cells", "cells", "used_cells", "refused_cells", "merged_cells",
)  # fmt: skip
MAX_DETAILS = 20
"""So many refused rows or cells are named one by one for each file; the rest are only counted."""


class TraceError(OneLineError, ValueError):
    """A file, or all of them, gave nothing that can be used. `report` has the particulars when there are any."""

    def __init__(self, sentence: str, report: "LoadReport | None" = None) -> None:
        super().__init__(sentence)
        self.report = report


@dataclass(frozen=True, slots=True)
class RefusedRow:
    """A row that was not used, or a cell whose value was not: line of the file (from 1) and the reason."""

    line: int
    reason: str


@dataclass(slots=True)
class FileReport:
    """One file, filled in while it is read: rows == used + aside + refused.

    `aside` rows belong to objects or signals that the map does not name, `merged` of the used ones share their time
    with another, `bad_cells` are cells of used rows whose value cannot be used: they are of bad quality in the trace.
    `columns` are the names in its header, once one is found that has those that the map needs. `reasons` counts refused
    rows and bad cells by reason. Of the `cells` that hold something, each is used, refused (with its row or alone),
    merged (another reading of the same time stands for it) or `unused`: in a column, or of a signal,
    that the map does not name. `warnings` are notes on what was understood otherwise than
    the file says it, though no row was lost. `error` says why nothing of the file was used.
    """

    path: Path
    rows: int = 0
    aside: int = 0
    refused: int = 0
    merged: int = 0
    bad_cells: int = 0
    cells: int = 0
    used_cells: int = 0
    refused_cells: int = 0
    merged_cells: int = 0
    unused: Counter[str] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    details: list[RefusedRow] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    error: str = ""
    columns: tuple[str, ...] = ()

    @property
    def used(self) -> int:
        """Rows whose readings are in a trace."""
        return 0 if self.error else self.rows - self.aside - self.refused

    def refuse(self, lines: Sequence[int], reason: str, details: Sequence[str] = ()) -> None:
        """Count rows that cannot be used."""
        self.refused += len(lines)
        self._count(lines, reason, details)

    def refuse_cells(self, count: int) -> None:
        """Count cells of rows that are refused as they are read."""
        self.cells += count
        self.refused_cells += count

    def bad(self, lines: Sequence[int], reason: str, details: Sequence[str] = ()) -> None:
        """Count cells that cannot be used, in rows that can."""
        self.bad_cells += len(lines)
        self.refused_cells += len(lines)
        self._count(lines, reason, details)

    def warn(self, sentence: str) -> None:
        """Say something once, though several chunks of the file give occasion to it."""
        if sentence not in self.warnings:
            self.warnings.append(sentence)

    def account(self) -> str:
        """The line that adds up, and which columns it leaves out."""
        return _account([self])

    def _count(self, lines: Sequence[int], reason: str, details: Sequence[str]) -> None:
        if not lines:
            return
        self.reasons[reason] += len(lines)
        for index, line in enumerate(lines[: MAX_DETAILS - len(self.details)]):
            self.details.append(RefusedRow(line, f"{reason}: {details[index]}" if details else reason))

    def sentences(self) -> list[str]:
        """What a person wants to know of this file, one sentence a line."""
        if self.error:
            return [self.error]
        head = f"{self.path}: {self.used} of {self.rows} rows used"
        parts = [
            f"{count} {what}"
            for count, what in (
                (self.refused, "refused"),
                (self.aside, "of other objects or signals"),
                (self.merged, "merged with rows of the same time"),
                (self.bad_cells, "cells of bad quality"),
            )
            if count
        ]
        lines = [f"{', '.join([head, *parts])}; {self.account()}"]
        lines += [f"{self.path}: {count} x {reason}" for reason, count in self.reasons.most_common()]
        # What was refused for the same words stands in one line, however many rows it is.
        alike: dict[str, list[int]] = {}
        for refused in sorted(self.details, key=attrgetter("line")):
            alike.setdefault(refused.reason, []).append(refused.line)
        for reason, at in alike.items():
            more = max(self.reasons[reason] - len(at), 0)
            where = f"line {at[0]}" if len(at) == 1 and not more else f"lines {list_names(map(str, at), 8, more)}"
            lines.append(f"{self.path}: {where}: {reason}")
        return lines + [f"{self.path}: {note}" for note in (*self.warnings, *self.notes)]


@dataclass(frozen=True, slots=True)
class LoadReport:
    """All files of one load, in the order in which they were read; `alphabet` is the map's with all its thresholds."""

    files: tuple[FileReport, ...]
    alphabet: Alphabet = DECANTER

    @property
    def rows(self) -> int:
        """Rows read from all files."""
        return sum(file.rows for file in self.files)

    @property
    def used(self) -> int:
        """Rows whose readings are in a trace."""
        return sum(file.used for file in self.files)

    @property
    def refused(self) -> int:
        """Rows that could not be used, in files that otherwise could."""
        return sum(file.refused for file in self.files if not file.error)

    @property
    def warnings(self) -> tuple[str, ...]:
        """One sentence for each thing that was understood otherwise than its file says it."""
        return tuple(f"{file.path}: {warning}" for file in self.files if not file.error for warning in file.warnings)

    @property
    def errors(self) -> tuple[str, ...]:
        """One sentence for each file of which nothing was used."""
        return tuple(file.error for file in self.files if file.error)

    def account(self) -> str:
        """The line that adds up over all files of which something was used."""
        return _account([file for file in self.files if not file.error])

    def sentences(self) -> list[str]:
        """The whole report, one sentence a line."""
        return [line for file in self.files for line in file.sentences()]

    def as_table(self) -> list[dict[str, object]]:
        """The report as plain values for JSON."""
        return [
            {
                "file": str(file.path),
                **{name: getattr(file, name) for name in _COUNTS},
                "unused": dict(file.unused),
                "reasons": dict(file.reasons),
                "details": [{"line": refused.line, "reason": refused.reason} for refused in file.details],
                "notes": [*file.warnings, *file.notes],
                "error": file.error,
            }
            for file in self.files
        ]


def _account(files: Sequence[FileReport]) -> str:
    cells, used, refused, merged = (
        sum(getattr(file, name) for file in files) for name in ("cells", "used_cells", "refused_cells", "merged_cells")
    )
    columns: Counter[str] = sum((file.unused for file in files), Counter())
    line = f"{cells} cells = {used} used + {refused} refused + {merged} merged + {columns.total()} not used"
    return f"{line} (no signal of the map: {list_names(columns)})" if columns else line


def list_names(names: Iterable[str], limit: int = 30, more: int = 0) -> str:
    """Names for a sentence, the first `limit` of them; `more` are counted that nobody has listed."""
    all_names = list(names)
    more += max(len(all_names) - limit, 0)
    return ", ".join(all_names[:limit]) + (f" and {more} more" if more else "")
