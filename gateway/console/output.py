"""What commands print: JSON or text, tables, progress that is quiet off a terminal."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from math import isfinite
from pathlib import Path
from typing import Any, Literal

LONGEST_WORD = 28
"""Characters of a table's word that is kept whole: any number, a time, an address, most names."""
MIN_TEXT_COLUMN_WIDTH = 20
"""Characters at least of a column of longer texts."""
COLUMN_GAP = 3
"""Characters between two columns."""
EDGE_WIDTH = 2
"""Characters around all of them."""
Progress = Callable[[str, float], None]
"""Takes what is being done, and the share of the work that is done (0..1)."""


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
    """Print a table as wide as the terminal, COLUMNS or 80; numbers are aligned to the right.

    Text is folded between words, numbers never: columns that do not fit follow below as a further table, which begins
    with the first column again. No cell is read as markup: names come from files.
    """
    from rich.box import SIMPLE_HEAD
    from rich.cells import cell_len
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console()
    cells = [[Text(_cell(cell)) for cell in row] for row in rows]
    heads = [Text(column) for column in columns]
    natural, least = [], []
    for index, head in enumerate(heads):
        own = [head, *(row[index] for row in cells)]
        natural.append(max(cell.cell_len for cell in own))
        words = (cell_len(word) for cell in own for word in cell.plain.split())
        # A longer word, such as a path, is folded within; a number is never that long.
        least.append(max(min(max(words, default=0), LONGEST_WORD), min(natural[-1], MIN_TEXT_COLUMN_WIDTH)))
    width = console.width - EDGE_WIDTH
    for band in bands(least, width):
        grid = Table(title=Text(title), title_justify="left", header_style="bold", box=SIMPLE_HEAD, pad_edge=False)
        left = width - COLUMN_GAP * (len(band) - 1) - sum(least[index] for index in band)
        for position, index in enumerate(sorted(band, key=lambda index: natural[index] - least[index])):
            more = min(natural[index] - least[index], left // (len(band) - position))
            least[index], left = least[index] + more, left - more
        for index in band:
            numeric = all(isinstance(row[index], int | float) for row in rows)
            justify: Literal["right", "left"] = "right" if numeric else "left"
            grid.add_column(heads[index], justify=justify, width=least[index], overflow="fold")
        for row in cells:
            grid.add_row(*(row[index] for index in band))
        console.print(grid)


def bands(least: Sequence[int], width: int) -> list[list[int]]:
    """The columns of each table, by their least widths: the first one in every table, the others each in one."""
    tables = [[0]] if least else []
    for index in range(1, len(least)):
        if len(tables[-1]) > 1 and sum(least[each] + COLUMN_GAP for each in (*tables[-1], index)) - COLUMN_GAP > width:
            tables.append([0])
        tables[-1].append(index)
    return tables


@contextmanager
def progress(title: str) -> Iterator[Progress]:
    """Yield `report(what, share)`: a bar on a terminal, nothing elsewhere; share is 0..1."""
    from rich import progress as bars
    from rich.console import Console

    console = Console(stderr=True)
    columns = (bars.TextColumn("{task.description}"), bars.BarColumn(), bars.TimeElapsedColumn())
    with bars.Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        task = bar.add_task(title, total=1.0)

        def report(what: str, share: float) -> None:
            bar.update(task, description=f"{title}: {what}", completed=share)

        yield report


def draw(renderable: Any) -> None:
    """Draw what the library rich draws, as wide as the terminal."""
    from rich.console import Console

    Console().print(renderable)
