"""`model version cycles`: the library's cycles, how they were rated, and what a person takes out with a reason."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import click

from gateway.console import CommandResult, Part, Rows, conclude
from gateway.entry import sentences
from gateway.lab.options import RATINGS, Rating
from gateway.lab.retraining.cycle_library import CycleRow, list_library, open_library
from gateway.lab.retraining.report import coverage_figure
from sim.lab.pictures import check_picture, save_picture


def cycles_command(
    folder: Path,
    rating: str | None,
    exclude: str | None,
    reason: str | None,
    by: str | None,
    include: str | None,
    picture: Path | None,
    as_json: bool,
) -> None:
    """Carry out `decanter model version cycles`; its options and its help are in retraining/commands.py."""
    if (exclude is None) != (reason is None) or (exclude is None) != (by is None):
        raise click.UsageError("--exclude NAME, --reason TEXT and --by WHO belong together")
    if exclude is not None and not (str(reason).strip() and str(by).strip()):
        raise click.UsageError("neither --reason nor --by may be empty")
    with sentences():
        if picture is not None:
            check_picture(picture)
        if exclude is not None or include is not None:
            with open_library(folder) as library:
                if exclude is not None:
                    library.exclude(exclude, str(by), str(reason))
                if include is not None:
                    library.exclude(include, "", "")
        with list_library(folder) as library:
            every = library.cycles()
            kept = library.kept_bytes()
            trained = frozenset(library.newest_training())
        shown = [row for row in every if rating in (None, row.rating)]
        if picture is not None:
            save_picture(coverage_figure(every, trained), picture, picture.suffix[1:].lower())
    counts = {each: sum(row.rating == each for row in every) for each in RATINGS}
    data: dict[str, Any] = {"library": str(folder), "counts": counts, "kept_bytes": kept}
    data |= {"picture": picture and str(picture), "cycles": [row.as_plain() for row in shown]}
    conclude(CommandResult(data), lambda _: _show(shown, counts, kept, picture), as_json=as_json)


def _show(rows: list[CycleRow], counts: Mapping[Rating, int], kept: int, picture: Path | None) -> Iterator[Part]:
    lines = [
        [
            row.name,
            row.region,
            row.rating,
            row.words,
            "–" if row.error is None else f"{row.error:.3g}",
            "–" if row.strangeness is None else f"{row.strangeness:.2f}",
            f"{row.reason} ({row.excluded_by})" if row.is_excluded else "",
        ]
        for row in rows
    ]
    columns = ("cycle", "region", "rating", "why", "error", "strangeness", "excluded")
    if lines:
        yield Rows("cycles", columns, lines)
    said = ", ".join(f"{count} {name}" for name, count in counts.items())
    yield f"{said}; {sum(row.kept for row in rows)} of those shown are kept, {kept / 1e6:.1f} MB in all"
    if picture is not None:
        yield f"picture: {picture}"
