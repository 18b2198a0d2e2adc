"""What commands print: JSON or text, tables, progress that is quiet off a terminal."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from math import isfinite
from pathlib import Path
from typing import Any

import click
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from sim.strict_json import json_text


def make_folder(path: Path) -> None:
    """Make a folder for results. Raises ValueError where there can be none."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ValueError(f"{path}: no folder can be made there ({reason}); give one that this user may write") from None


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}" if isfinite(value) else "–"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_cell(inner)}" for key, inner in value.items())
    return ("yes" if value else "no") if isinstance(value, bool) else str(value)


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a table; numbers are aligned to the right, and no cell is read as markup: names come from files."""
    grid = Table(title=Text(title), title_justify="left", header_style="bold", box=SIMPLE_HEAD, pad_edge=False)
    for index, column in enumerate(columns):
        numeric = all(isinstance(row[index], int | float) for row in rows)
        grid.add_column(Text(column), justify="right" if numeric else "left")
    for row in rows:
        grid.add_row(*(Text(_cell(cell)) for cell in row))
    console = Console()
    if not console.is_terminal:  # a file or a pipe has no width: nothing is cut off there
        console = Console(width=240)
    console.print(grid)


@contextmanager
def progress(title: str) -> Iterator[Callable[[str, float], None]]:
    """Yield `report(what, share)`: a bar on a terminal, nothing elsewhere; share is 0..1."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        task = bar.add_task(title, total=1.0)

        def report(what: str, share: float) -> None:
            bar.update(task, description=f"{title}: {what}", completed=share)

        yield report


def emit(data: Mapping[str, Any], show: Callable[[], None], *, as_json_line: bool) -> None:
    """One JSON object for machines, or what `show` prints for people."""
    if as_json_line:
        click.echo(json_text(data))
    else:
        show()
