"""What a command found, and the one way in which it is told: a JSON object or lines and tables, then the exit code."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import click

from gateway.console.output import draw, table
from gateway.entry import Exit, fail, print_json


@dataclass(frozen=True, slots=True)
class CommandResult:
    """What a command found: `data` for JSON and the records, and a `complaint` of one sentence, "" if all is in order.

    `failing` is the exit code that goes with a complaint, and with what is not `ok`: that is said by what is shown.
    """

    data: Mapping[str, Any]
    complaint: str = ""
    failing: int = Exit.CHECK_FAILED
    ok: bool = True

    @property
    def code(self) -> int:
        """The exit code."""
        return self.failing if self.complaint or not self.ok else Exit.OK


@dataclass(frozen=True, slots=True)
class Line:
    """One line for a person, in a colour of the terminal or in bold; `aside`: on standard error, beside the result."""

    text: str
    colour: str | None = None
    bold: bool = False
    aside: bool = False


@dataclass(frozen=True, slots=True)
class LongText:
    """A text that a terminal shows page by page."""

    text: str


@dataclass(frozen=True, slots=True)
class Drawing:
    """What the library rich draws on a terminal."""

    renderable: Any


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


Part = str | Line | Rows | LongText | Drawing
View = Callable[[Mapping[str, Any]], Iterable[Part]]
"""The parts of a result's data that a person sees, in their order."""


def conclude(result: CommandResult, view: View, *, as_json: bool) -> None:
    """Print the result as one JSON object with `ok`, or as its view; where it is not in order, leave with its code."""
    if as_json:
        print_json({"ok": result.code == Exit.OK, **result.data})
    else:
        for part in view(result.data):
            _show(part)
    if result.complaint:
        fail(result.complaint, result.code)
    if result.code != Exit.OK:
        raise SystemExit(int(result.code))


def _show(part: Part) -> None:
    if isinstance(part, Rows):
        table(part.title, part.columns, part.cells())
    elif isinstance(part, LongText):
        click.echo_via_pager(part.text)
    elif isinstance(part, Drawing):
        draw(part.renderable)
    else:
        line = Line(part) if isinstance(part, str) else part
        click.secho(line.text, fg=line.colour, bold=line.bold or None, err=line.aside)
