"""What every benchmark gives: figures, each set against another one, as a table or as one JSON object."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter

import click
import numpy as np
from rich.console import Console
from rich.table import Table


@dataclass(frozen=True, slots=True)
class Figure:
    """One measured `value`, and `other`, what `against` names, in the same unit and measured in the same run.

    An `against` that was not measured here says so in its words. Without `other` there is no ratio.
    """

    name: str
    value: float
    unit: str
    against: str = ""
    other: float | None = None

    @property
    def ratio(self) -> float | None:
        """value / other."""
        return self.value / self.other if self.other else None

    def plain(self) -> dict[str, str | float | None]:
        """The figure as JSON carries it."""
        own: dict[str, str | float | None] = {"name": self.name, "value": self.value, "unit": self.unit}
        return {**own, "against": self.against, "other": self.other, "ratio": self.ratio}


def best(work: Callable[[], object], repeats: int) -> float:
    """Seconds of the fastest of `repeats` calls: the other ones were disturbed."""
    times = []
    for _ in range(repeats):
        begin = perf_counter()
        work()
        times.append(perf_counter() - begin)
    return min(times)


def shares(name: str, unit: str, values: Sequence[float], against: str, others: Sequence[float]) -> list[Figure]:
    """p50 and p99 of `values`, each against the same percentile of `others`."""
    return [
        Figure(f"{name}, p{p}", percentile(values, p), unit, f"{against}, p{p}", percentile(others, p))
        for p in (50, 99)
    ]


def percentile(values: Sequence[float], share: float) -> float:
    """The value that `share` per cent of the values do not exceed (numpy, linear between neighbours)."""
    return float(np.percentile(values, share))


def show(title: str, figures: Sequence[Figure]) -> None:
    """Print a table."""
    console = Console()
    if not console.is_terminal:
        console = Console(width=170)
    console.print(as_table(title, figures))


def as_table(title: str, figures: Sequence[Figure]) -> Table:
    """Name, figure, unit, against what, ratio."""
    table = Table(title=title, title_justify="left", pad_edge=False)
    table.add_column("what")
    table.add_column("figure", justify="right")
    table.add_column("unit")
    table.add_column("against")
    table.add_column("that", justify="right")
    table.add_column("ratio", justify="right")
    for one in figures:
        other = "" if one.other is None else number(one.other)
        table.add_row(
            one.name, number(one.value), one.unit, one.against, other, "" if one.ratio is None else f"{one.ratio:.3g}"
        )
    return table


def number(value: float) -> str:
    """Three figures at least, thousands apart."""
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def give(name: str, figures: Sequence[Figure], *, as_json: bool) -> None:
    """What a benchmark prints at its end: the table, or one line of JSON."""
    if as_json:
        click.echo(json.dumps({"benchmark": name, "figures": [one.plain() for one in figures]}))
    else:
        show(name, figures)


def taken(line: str) -> list[Figure]:
    """The figures of a line that `give` has printed. Raises ValueError or KeyError for anything else."""
    keys = ("name", "value", "unit", "against", "other")
    return [Figure(*(one[key] for key in keys)) for one in json.loads(line)["figures"]]
