"""`decanter model learn fleet`: many machines of one type, each judged by itself, here or on a cluster."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from drivers.csv_rows import write_rows
from drivers.named_files import name_write_errors
from gateway.console import (
    CommandResult,
    Line,
    Part,
    Rows,
    conclude,
    progress,
    shipped_file,
)
from gateway.entry import Exit, fail, interruptible, sentences
from gateway.lab.fleet.places import place_words
from gateway.lab.fleet.sources import TABLE, find_sources
from gateway.lab.fleet.study import MODEL, RESULTS, FleetFindings, FleetRequest, study
from gateway.lab.models.show import spread_sentence
from sim.forecast import Z90
from sim.lab.judge import hold_folder
from sim.lab.learning import MachineSpread, StandsOut, offset_spread
from sim.lab.pictures import blank_figure
from sim.lab.recordings import load_map, units
from sim.lab.workers import cluster, processes
from sim.sha import display_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PICTURE = "fleet.png"
MOST_NAMED = 40
"""Machines that are named at the axis of the picture; of more only those that stand out are."""
COSTS = ("cpu_s", "peak_mb")
"""Columns that are in the file alone."""
PLAIN, STRIKING, BAND = "#1f6fb4", "#b3261e", "#e4e8ec"


def fleet(
    place: str,
    out: Path,
    map_name: str,
    temperature: str | None,
    schema: str,
    sample: int,
    own: bool,
    diagnosis: bool,
    jobs: int | None,
    address: str | None,
    seed: int,
    as_json: bool,
) -> None:
    """Carry out `decanter model learn fleet`; its options and its help are in fleet/commands.py."""
    try:
        with sentences(), progress("fleet") as bar, interruptible(bar) as report:
            column_map = load_map(shipped_file("traces", map_name))
            request = FleetRequest(
                sources=find_sources(place, column_map, schema),
                column_map=column_map,
                temperature=temperature or column_map.temperature,
                out=out,
                sample=sample,
                own=own,
                diagnosis=diagnosis,
                seed=seed,
            )
            count = jobs or len(os.sched_getaffinity(0))
            with (
                hold_folder(out),
                nullcontext(processes(count)) if address is None else cluster(address) as workers,
            ):
                found = study(request, workers, (lambda _: None) if as_json else click.echo, report)
                words = place_words(found.model.alphabet, units(column_map))
                write_table(found, words, out / TABLE)
                draw(found, words, out / PICTURE)
    except KeyboardInterrupt:
        what = f"what was done lies in {out / RESULTS}, and the same command goes on"
        fail(f"stopped before the end; {what}", Exit.INTERRUPTED)
    unit = display_unit(found.model.unit)
    failed = {name: result.failure for name, result in found.results.items() if result.failure}
    data: dict[str, Any] = {
        "model": str(out / MODEL),
        "picture": str(out / PICTURE),
        "unit": unit,
        "spread": asdict(found.spread),
        "outstanding": {
            name: [{"where": words[one.group], **asdict(one)} for one in places]
            for name, places in found.outstanding.items()
        },
        "failed": failed,
        "left_out": dict(found.left_out),
        "unread": {name: list(result.unread) for name, result in found.results.items() if result.unread},
        "machines": machine_rows(found, words),
    }

    def show() -> Iterator[Part]:
        rows = [
            {name: row[name] for name in row if name not in COSTS} for row in machine_rows(found, words)[:MOST_NAMED]
        ]
        title = f"{len(found.results)} machines: targets off the type's, held-out free-run errors, in {unit}"
        yield Rows(title, list(rows[0]), [["" if value is None else value for value in row.values()] for row in rows])
        if len(found.results) > len(rows):
            yield f"the {len(found.results) - len(rows)} that lie nearest to the type are in {out / TABLE}"
        if len(found.spread.offsets) <= MOST_NAMED:
            yield spread_sentence(found.spread, unit)
        else:
            apart, ahead = f"{found.spread.between:.3g} {unit}", f"{found.spread.sigma:.3g} {unit}"
            yield f"machines: {apart} between them, {ahead} for the next one"
        for name in found.outstanding:
            yield Line(outstanding_sentence(found, name, words, unit), "yellow")
        if not found.outstanding:
            yield "no machine stands out"
        for name, reasons in data["unread"].items():
            for each in reasons:
                yield Line(f"{name}: without {each}", "yellow")
        yield f"model of the type, with each machine's own: {out / MODEL}\npicture: {out / PICTURE}"

    conclude(CommandResult(data), lambda _: show(), as_json=as_json)


def outstanding_sentence(found: FleetFindings, name: str, words: Mapping[str, str], unit: str) -> str:
    """Where a machine stands out, in plant words, and by how much; the place where that is least likely leads."""
    parts = [
        f"{words[one.group]}: targets {one.beyond:+.2g} {unit} beyond the others' mean, which differ by "
        f"{one.differ:.2g} {unit} (chance {one.chance:.1g})"
        for one in found.outstanding[name]
    ]
    return f"{name} stands out {'; also '.join(parts)}"


def machine_rows(found: FleetFindings, words: Mapping[str, str]) -> list[dict[str, Any]]:
    """A row a machine: those that stand out, then the one furthest from the type first, those that failed last.

    `words` are those of the groups of locations.
    """

    def row(name: str) -> dict[str, Any]:
        result = found.results[name]
        errors: dict[str, float | None] = dict.fromkeys(("type", "corrected", "own"))
        errors |= {what: round(error, 2) for what, error in result.held_out.items()}
        return {
            "machine": name,
            "hours": round(result.hours, 1),
            "targets": None if result.offset is None else round(result.offset, 2),
            "+-": None if result.error is None else round(result.error, 2),
            "stands out": ", ".join(words[one.group] for one in found.outstanding.get(name, ())) or "no",
            **errors,
            "verdict": result.verdict,
            "effects": " ".join(result.effects),
            "files not read": len(result.unread) or None,
            "failure": result.failure,
            "cpu_s": round(result.cpu_s, 2),
            "peak_mb": round(result.peak_mb),
        }

    failed = [name for name, result in found.results.items() if result.offset is None]
    judged = {name: abs(result.offset) for name, result in found.results.items() if result.offset is not None}
    order = sorted(judged, key=lambda name: (name not in found.outstanding, -judged[name]))
    rows = [row(name) for name in [*order, *failed]]
    # What nothing is said of in any row is no column.
    told = [key for key in rows[0] if any(each[key] not in (None, "") for each in rows)]
    return [{key: each[key] for key in told} for each in rows]


def write_table(found: FleetFindings, words: Mapping[str, str], path: Path) -> None:
    """All machines as CSV. Raises OSError."""
    rows = machine_rows(found, words)
    with name_write_errors(path), path.open("w", newline="", encoding="utf-8") as file:
        write_rows(file, (rows[0], *(row.values() for row in rows)))


def draw(found: FleetFindings, words: Mapping[str, str], path: Path) -> None:
    """The machines' targets with their errors, and the band in which nine of ten machines of the type are expected.

    Beside them the targets of each group of locations in which a machine stands out.
    """
    groups = sorted({one.group for places in found.outstanding.values() for one in places})
    striking = {group: {name for name, each in found.outstanding.items() if group in _groups(each)} for group in groups}
    names = sorted(found.spread.offsets, key=lambda name: found.spread.offsets[name])
    size = (10 + 4 * len(groups), 1.8 + min(0.22 * len(names), 9.0))
    figure = blank_figure(*size)
    whole, *others = figure.subplots(1, 1 + len(groups), squeeze=False, sharey=True)[0]
    unit = display_unit(found.model.unit)
    _panel(whole, found.spread, names, set(found.outstanding))
    whole.set_xlabel(f"targets above the type's, {unit}")
    for axes, group in zip(others, groups, strict=True):
        known = {name: each for name in names if (each := found.results[name].grouped.get(group)) is not None}
        spread = offset_spread(
            {name: each.offset for name, each in known.items()}, {name: each.error for name, each in known.items()}
        )
        _panel(axes, spread, names, striking[group])
        axes.set_xlabel(f"{words[group]}, {unit}")
    named = [number for number, name in enumerate(names) if len(names) <= MOST_NAMED or name in found.outstanding]
    whole.set_yticks(named, [names[number] for number in named])
    whole.set_title(f"{len(names)} machines of a type")
    whole.legend(loc="lower right")
    with name_write_errors(path):
        figure.savefig(path, dpi=130)


def _groups(places: Sequence[StandsOut]) -> set[str]:
    return {one.group for one in places}


def _panel(axes: Axes, spread: MachineSpread, names: Sequence[str], striking: Collection[str]) -> None:
    """Offsets with 90 % intervals over the band of the type; a machine keeps its row in all panels."""
    offset, error = (np.array([each.get(name, np.nan) for name in names]) for each in (spread.offsets, spread.errors))
    if spread.sigma > 0:
        weight = 1.0 / (spread.between**2 + error**2)
        mean, reach = float(np.nansum(offset * weight) / np.nansum(weight)), Z90 * spread.sigma
        axes.axvspan(mean - reach, mean + reach, color=BAND, label="90 % of machines of this type", zorder=0)
    for wanted, colour, label in ((False, PLAIN, "machine, 90 % interval"), (True, STRIKING, "stands out")):
        rows = np.flatnonzero([(name in striking) == wanted for name in names])
        if rows.size:
            axes.errorbar(offset[rows], rows, xerr=Z90 * error[rows], fmt="o", color=colour, ms=4, lw=1, label=label)
    axes.axvline(0.0, color="#555555", lw=0.8)
    axes.grid(axis="x", alpha=0.3)
