"""What all commands share: one sentence for an error, JSON or text, tables, progress that is quiet off a terminal."""

import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from enum import IntEnum
from math import isfinite
from typing import Any, NoReturn

import click


class Exit(IntEnum):
    """Stable exit codes."""

    OK = 0
    CHECK_FAILED = 1
    USAGE = 2
    CANNOT_CONNECT = 3
    DEVICE_EXCEPTION = 4
    TIMEOUT = 5
    NOT_ARMED = 6


def fail(sentence: str, code: Exit = Exit.USAGE) -> NoReturn:
    """Say one sentence on standard error and leave with the code."""
    click.secho(f"decanter: {sentence}", fg="red", err=True)
    sys.exit(code)


@contextmanager
def sentences() -> Iterator[None]:
    """Turn the errors that bad input causes into one sentence and exit code 2; everything else stays a defect."""
    try:
        yield
    except (ValueError, FileNotFoundError, IsADirectoryError, NotADirectoryError, PermissionError) as error:
        fail(str(error))
    except OSError as error:
        fail(f"{error.filename or 'the file system'}: {error.strerror or error}")


def _plain(value: object) -> object:
    """Numbers that JSON has no word for become null; numpy scalars become Python's."""
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float) and not isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    return value


def as_json(value: object) -> str:
    """One line of strict JSON; infinite and undefined numbers are null."""
    return json.dumps(_plain(value), ensure_ascii=False, allow_nan=False, default=str)


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}" if isfinite(value) else "–"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_cell(inner)}" for key, inner in value.items())
    return {True: "yes", False: ""}[value] if isinstance(value, bool) else str(value)


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a table; numbers are aligned to the right."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    grid = Table(title=title, title_justify="left", header_style="bold", box=SIMPLE_HEAD, pad_edge=False)
    for index, column in enumerate(columns):
        numeric = all(isinstance(row[index], int | float) for row in rows)
        grid.add_column(column, justify="right" if numeric else "left")
    for row in rows:
        grid.add_row(*(_cell(cell) for cell in row))
    console = Console()
    if not console.is_terminal:  # a file or a pipe has no width: nothing is cut off there
        console = Console(width=240)
    console.print(grid)


@contextmanager
def progress(title: str) -> Iterator[Callable[[str, float], None]]:
    """Yield `report(what, share)`: a bar on a terminal, nothing elsewhere; share is 0..1."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

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
        click.echo(as_json(data))
    else:
        show()
