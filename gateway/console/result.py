"""What a command found, and the one way in which it is told: a JSON object or lines and tables, then the exit code."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import click

from gateway.console.output import table
from gateway.entry import Exit, fail, print_json


@dataclass(frozen=True, slots=True)
class CommandResult:
    """What a command found: `data` for JSON and the records, and a `complaint` of one sentence, "" if all is in order.

    `failing` is the exit code that goes with a complaint.
    """

    data: Mapping[str, Any]
    complaint: str = ""
    failing: int = Exit.CHECK_FAILED

    @property
    def code(self) -> int:
        """The exit code."""
        return self.failing if self.complaint else Exit.OK


@dataclass(frozen=True, slots=True)
class Line:
    """One line for a person, in a colour of the terminal or in bold."""

    text: str
    colour: str | None = None
    bold: bool = False


@dataclass(frozen=True, slots=True)
class Rows:
    """A table for a person: of each row its cells in order, or by the columns' names (None and absent: empty)."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[object] | Mapping[str, object]]

    def cells(self) -> list[Sequence[object]]:
        """Of each row its cells in the order of the columns."""
        return [
            ["" if row.get(name) is None else row[name] for name in self.columns] if isinstance(row, Mapping) else row
            for row in self.rows
        ]


Part = str | Line | Rows
View = Callable[[Mapping[str, Any]], Iterable[Part]]
"""The parts of a result's data that a person sees, in their order."""


def conclude(result: CommandResult, view: View, *, as_json: bool) -> None:
    """Print the result as one JSON object with `ok`, or as its view; where it has a complaint, leave with its code."""
    if as_json:
        print_json({"ok": not result.complaint, **result.data})
    else:
        for part in view(result.data):
            if isinstance(part, Rows):
                table(part.title, part.columns, part.cells())
            else:
                line = Line(part) if isinstance(part, str) else part
                click.secho(line.text, fg=line.colour, bold=line.bold or None)
    if result.complaint:
        fail(result.complaint, result.code)
