"""What all commands share: one sentence for an error, JSON or text, tables, progress that is quiet off a terminal."""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from enum import IntEnum
from math import isfinite
from pathlib import Path
from typing import Any, NoReturn

import click

from drivers.errors import (
    AddressError,
    DeviceException,
    DriverError,
    EncodingError,
    RecordingError,
    ReplyTimeout,
    WriteForbidden,
)
from sim.strict_json import json_text


class Exit(IntEnum):
    """Stable exit codes."""

    OK = 0
    CHECK_FAILED = 1
    USAGE = 2
    CANNOT_CONNECT = 3
    DEVICE_EXCEPTION = 4
    TIMEOUT = 5
    NOT_ARMED = 6
    INTERRUPTED = 130  # 128 + SIGINT, as a shell counts


def fail(sentence: str, code: int = Exit.USAGE) -> NoReturn:
    """Say one sentence on standard error and leave with the code."""
    click.secho(f"decanter: {sentence}", fg="red", err=True)
    sys.exit(code)


@contextmanager
def sentences() -> Iterator[None]:
    """Turn what bad input, the file system and the device cause into one sentence and its exit code.

    ValueError is what every room raises for input that cannot be used (its TraceError, ArtefactError, ConfigError and
    InputError among them), so a defect that shows as a ValueError looks the same: `decanter --traceback` tells them
    apart. Every other exception is a defect and is not caught.
    """
    try:
        yield
    except (DriverError, ValueError, OSError) as error:
        context = click.get_current_context(silent=True)
        if context is not None and context.find_root().params.get("traceback"):
            raise
        fail(sentence(error), exit_code(error))


def sentence(error: Exception) -> str:
    """What the error says; where the system only gave a word and a file, the file first and a remedy after."""
    if not isinstance(error, OSError) or error.strerror is None:
        return str(error)
    reason = error.strerror[0].lower() + error.strerror[1:]
    file = f"{error.filename}: " if error.filename else ""
    return f"{file}{reason}; give a path that is there and that this user may read or write"


_CODES: tuple[tuple[type[Exception], Exit], ...] = (
    (ReplyTimeout, Exit.TIMEOUT),
    (DeviceException, Exit.DEVICE_EXCEPTION),
    (WriteForbidden, Exit.NOT_ARMED),
    (AddressError, Exit.USAGE),
    (EncodingError, Exit.USAGE),
    (RecordingError, Exit.USAGE),
    (DriverError, Exit.CANNOT_CONNECT),
)


def exit_code(error: Exception) -> Exit:
    """The stable exit code of an error: of a driver's by its kind, of any other that of wrong input."""
    return next((code for kind, code in _CODES if isinstance(error, kind)), Exit.USAGE)


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
    return {True: "yes", False: ""}[value] if isinstance(value, bool) else str(value)


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a table; numbers are aligned to the right, and no cell is read as markup: names come from files."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

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
        click.echo(json_text(data))
    else:
        show()
