"""The pictures of a diagnosis as PNG, all of them on one sheet too.

What is missing over time comes first, before any name; then where the heat is, held-out cycles before and after.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np

from drivers.named_files import name_write_errors
from sim.effects import moment_words
from sim.lab.discrepancy import (
    Diagnosis,
    DiagnosisCourse,
    GapBeginning,
    HeatMap,
    HeldOutProof,
    MissingHeat,
    heat_map,
)
from sim.lab.pictures import DPI, Pixels, blank_figure, draw_pixels
from sim.sha import DEFAULT_UNIT, Array, display_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure


MISSING, WHERE, CYCLES = "missing_heat.png", "where.png", "held_out_cycles.png"
ERRORS, SHEET = "held_out_errors.png", "diagnosis.png"
FILES = (MISSING, WHERE, CYCLES, ERRORS, SHEET)
MEASURED, BEFORE, AFTER, FLOOR = "#555555", "#c65d1e", "#1f6fb4", "#2a8c6a"
HEAT, BEGINS, RESTING = "#8a3a7c", "#b3261e", "#dfe4e8"
MAX_CURVES = 6
"""Held-out cycles that are drawn as curves."""
MAX_ANNOTATED_CELLS = 160
"""Cells of a map at most in which the number stands too."""
MAX_NAME_CHARS = 28
"""Characters of a location's name on an axis."""
SHEET_WIDTH, MISSING_HEIGHT = 11.0, 3.6
"""Inches of the sheet, and of the picture of what is missing."""
LINE_CHARS = 118
"""Of a line of the sentence on the sheet."""
BREAK_S, BREAK_STEPS = 1800.0, 10.0
"""Seconds without a window, and steps of the usual length, from which a curve over time is broken."""
OUTLIER_SHARE = 0.005
"""Share of the windows on either side that may lie outside of what is drawn of the missing heat."""


def draw(diagnosis: Diagnosis, title: str, folder: Path) -> dict[str, Path]:
    """Draw what the diagnosis has to show into `folder`; gives the files by their names. Raises OSError."""
    from matplotlib.image import imsave

    course, held_out = _to_show(diagnosis)
    heat = None if course is None else heat_map(course)
    shown = [] if course is None else cycles_to_show(course)
    labels = [] if course is None else held_out_cycles(course)
    figures: dict[str, Figure] = {}
    unit = diagnosis.unit
    if diagnosis.missing_heat is not None:
        figures[MISSING] = figure = blank_figure(SHEET_WIDTH, MISSING_HEIGHT)
        draw_missing_heat(figure.subplots(), diagnosis.missing_heat, diagnosis.began, unit)
    if heat is not None:
        figures[WHERE] = figure = blank_figure(SHEET_WIDTH if heat.after is not None else 8.0, _map_height(heat))
        draw_heat_maps(figure, heat, unit)
    if course is not None and shown:
        figures[CYCLES] = figure = blank_figure(SHEET_WIDTH, 4.6)
        draw_cycles(figure, course, shown, held_out, unit)
    if held_out is not None and held_out.per_cycle:
        figures[ERRORS] = figure = blank_figure(8.0, 3.2)
        draw_errors(figure.subplots(), held_out, labels, unit)
    drawn = {name: draw_pixels(figure) for name, figure in figures.items()}
    if len(drawn) > 1:
        drawn[SHEET] = _sheet(title, diagnosis.sentence, drawn)
    for name, pixels in drawn.items():
        with name_write_errors(folder / name):
            imsave(folder / name, pixels, dpi=DPI)
    return {name: folder / name for name in drawn}


def _to_show(diagnosis: Diagnosis) -> tuple[DiagnosisCourse | None, HeldOutProof | None]:
    """Course and errors, without an "after" where nothing was added to the model."""
    course, held_out = diagnosis.course, diagnosis.held_out
    if not diagnosis.effects:
        if course is not None:
            nothing = np.full(course.times.shape, np.nan)
            course = replace(course, after=nothing, heat_after=nothing)
        if held_out is not None:
            per_cycle = tuple((before, np.nan, floor) for before, _, floor in held_out.per_cycle)
            held_out = replace(held_out, per_cycle=per_cycle)
    return course, held_out


def _sheet(title: str, sentence: str, drawn: Mapping[str, Pixels]) -> Pixels:
    """All of it on one sheet: what is missing over time, the sentence, and the rest."""
    lines = wrap(sentence, LINE_CHARS)
    said = _text_band("\n".join(lines), 12, 0.2 + 0.2 * len(lines))
    pictures, first = [*drawn.values()], int(MISSING in drawn)
    parts = [_text_band(title, 13, 0.4), *pictures[:first], said, *pictures[first:]]
    width = max(part.shape[1] for part in parts)
    white = [np.pad(part, ((0, 0), (0, width - part.shape[1]), (0, 0)), constant_values=255) for part in parts]
    return np.vstack(white)


def _text_band(text: str, size: int, height: float) -> Pixels:
    """Lines of text across the sheet, so many inches high."""
    figure = blank_figure(SHEET_WIDTH, height)
    figure.text(0.01, 0.5, text, fontsize=size, va="center", ha="left", parse_math=False)
    return draw_pixels(figure)


# -------------------------------------------------------------------- missing heat


def draw_missing_heat(axis: Axes, heat: MissingHeat, began: GapBeginning | None, unit: str) -> None:
    """The missing heat over time with its band, in `unit`/h: rests shaded, a dated line where it begins."""
    # Where nothing was recorded for long, NaN breaks the curves: nothing is known there.
    steps = np.diff(heat.times)
    usual = float(np.median(steps)) if steps.size else 0.0
    breaks = np.flatnonzero(steps > max(BREAK_S, BREAK_STEPS * usual)) + 1
    mean, low, high = (np.insert(column, breaks, np.nan) for column in (heat.mean, heat.low, heat.high))
    days = np.insert(_days(heat.times), breaks, _days(heat.times[breaks]))
    resting = np.insert(~heat.running, breaks, False)
    across = axis.get_xaxis_transform()
    axis.fill_between(
        days, 0, 1, where=resting, step="mid", transform=across, color=RESTING, linewidth=0, label="at rest"
    )
    axis.fill_between(days, low, high, color=HEAT, alpha=0.25, linewidth=0, label="95 % band")
    axis.plot(days, mean, color=HEAT, linewidth=1.1, label="missing heat")
    axis.axhline(0.0, color="#666666", linewidth=0.8)
    if heat.held_out.any() and not heat.held_out.all():
        border = float(_days(heat.times[heat.held_out][:1])[0])
        axis.axvline(border, color=MEASURED, linewidth=1.0, linestyle=":", label="held out from here on")
    if began is not None:
        first, moment, last = _days(np.array([began.interval[0], began.time, began.interval[1]])).tolist()
        axis.axvspan(first, last, color=BEGINS, alpha=0.15, linewidth=0)
        axis.axvline(moment, color=BEGINS, linewidth=1.6, label=f"begins {moment_words(began.time)} (95 % interval)")
    least, most = np.nanquantile(low, OUTLIER_SHARE), np.nanquantile(high, 1.0 - OUTLIER_SHARE)
    room = 0.06 * max(float(most - least), 1e-9)
    axis.set_ylim(min(float(least), 0.0) - room, max(float(most), 0.0) + room)
    axis.set_xlim(float(days[0]), float(days[-1]) if days[-1] > days[0] else float(days[0]) + 1.0)
    axis.xaxis_date()
    axis.tick_params(labelsize=8)
    axis.set_xlabel("time (UTC)", fontsize=9)
    axis.set_ylabel(f"missing heat ({display_unit(unit)}/h)", fontsize=9)
    axis.grid(alpha=0.25)
    axis.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2, ncols=5, fontsize=8, frameon=False)


def _days(times: Array) -> Array:
    """Seconds UTC as matplotlib's days since 1970."""
    return np.asarray(times / 86_400.0)


# -------------------------------------------------------------------- where


def _map_height(heat: HeatMap) -> float:
    return 1.7 + 0.34 * len(heat.locations)


def draw_heat_maps(figure: Figure | SubFigure, heat: HeatMap, unit: str) -> None:
    """The map before, and beside it the map after, on one scale of colours, in `unit`/h."""
    from matplotlib.colors import Normalize
    from matplotlib.patches import Rectangle

    maps = [("before: heat that the model leaves", heat.before)]
    if heat.after is not None:
        maps.append(("after: with what was added", heat.after))
    axes = figure.subplots(1, len(maps), sharey=True, squeeze=False)[0]
    limit = heat.largest or 1.0
    norm = Normalize(-limit, limit)
    for axis, (title, values) in zip(axes, maps, strict=True):
        image = axis.imshow(values, cmap="RdBu_r", norm=norm, aspect="auto", interpolation="nearest")
        for row, column in zip(*np.nonzero(heat.few & np.isfinite(values)), strict=True):
            frame = (float(column) - 0.5, float(row) - 0.5)
            axis.add_patch(Rectangle(frame, 1, 1, fill=False, hatch="////", edgecolor="#b8c0c8", linewidth=0))
        _numbers(axis, np.where(heat.few, np.nan, values), limit)
        axis.set_title(title, fontsize=10, loc="left")
        axis.set_xticks(range(len(heat.columns)), heat.columns, rotation=35, ha="right", fontsize=8)
        # A $ would begin a formula in matplotlib's text.
        short = [name if len(name) <= MAX_NAME_CHARS else f"{name[: MAX_NAME_CHARS - 1]}…" for name in heat.locations]
        axis.set_yticks(range(len(short)), [name.replace("$", r"\$") for name in short], fontsize=8)
        axis.set_xlabel("time since the last start or stop", fontsize=9)
        axis.set_facecolor("#eceff2")
    if heat.left_out:
        axes[0].set_ylabel(f"{heat.left_out} rarer locations are left out", fontsize=8)
    bar = figure.colorbar(image, ax=list(axes), fraction=0.03, pad=0.01)
    bar.set_label(f"mean heat, {display_unit(unit)}/h", fontsize=9)


def _numbers(axis: Axes, values: Array, limit: float) -> None:
    """The means in the cells, where there are few enough to be read."""
    if values.size > MAX_ANNOTATED_CELLS:
        return
    digits = 0 if limit >= 20 else 1 if limit >= 2 else 2
    for row, column in zip(*np.nonzero(np.isfinite(values)), strict=True):
        value = float(values[row, column])
        colour = "white" if abs(value) > 0.6 * limit else "#333333"
        text = f"{value:+.{digits}f}" if round(abs(value), digits) else "0"
        axis.text(int(column), int(row), text, ha="center", va="center", fontsize=7, color=colour)


# -------------------------------------------------------------------- cycles


def cycles_to_show(course: DiagnosisCourse, most: int = MAX_CURVES) -> list[int]:
    """The numbers of held-out cycles to draw, spread evenly; of all cycles where none is held out."""
    seen = np.isfinite(course.before) & np.isfinite(course.reading)
    chosen = seen & (course.held_out > 0.5)
    cycles = np.unique(course.cycle[chosen if chosen.any() else seen])
    counts = np.array([np.count_nonzero(course.cycle[seen] == number) for number in cycles])
    cycles = cycles[counts > 1] if cycles.size else cycles
    if cycles.size > most:
        cycles = cycles[np.round(np.linspace(0, cycles.size - 1, most)).astype(int)]
    return [int(number) for number in cycles]


def held_out_cycles(course: DiagnosisCourse) -> list[int]:
    """The numbers of the held-out cycles, in the order of time."""
    return [int(number) for number in np.unique(course.cycle[course.held_out > 0.5])]


def draw_cycles(
    figure: Figure | SubFigure, course: DiagnosisCourse, shown: Sequence[int], held_out: HeldOutProof | None, unit: str
) -> None:
    """A column a cycle: measured and free runs above, their errors below, with the noise floor as a band, in `unit`."""
    axes = figure.subplots(2, len(shown), squeeze=False, sharex="col", sharey="row", height_ratios=(1.5, 1.0))
    spans = [np.ptp(course.times[course.cycle == cycle]) for cycle in shown]
    clock_unit, size = ("min", 60.0) if max(spans) < 5400.0 else ("h", 3600.0)
    for number, (cycle, (above, below)) in enumerate(zip(shown, axes.T, strict=True)):
        rows = np.asarray(course.cycle == cycle)
        kind = "held out" if course.held_out[rows].max() > 0.5 else "fitted"
        clock = (course.times[rows] - course.times[rows][0]) / size
        reading, before, after = course.reading[rows], course.before[rows], course.after[rows]
        above.plot(clock, reading, ".", color=MEASURED, markersize=2.0, zorder=3, label="measured")
        above.plot(clock, before, color=BEFORE, linewidth=1.3, label="free run before")
        if held_out is not None and np.isfinite(held_out.noise_floor):
            floor = held_out.noise_floor
            below.axhspan(-floor, floor, color=FLOOR, alpha=0.15, linewidth=0, label="noise floor (rms)")
        below.axhline(0.0, color="#999999", linewidth=0.7)
        below.plot(clock, before - reading, color=BEFORE, linewidth=1.1)
        if np.isfinite(course.after).any():
            above.plot(clock, after, color=AFTER, linewidth=1.3, label="free run after")
            below.plot(clock, after - reading, color=AFTER, linewidth=1.1)
        above.set_title(f"cycle {cycle + 1}, {kind}", fontsize=9, loc="left")
        below.set_xlabel(clock_unit, fontsize=8)
        for axis in (above, below):
            axis.grid(alpha=0.25)
            axis.tick_params(labelsize=8)
        if not number:
            quantity = "temperature" if unit == DEFAULT_UNIT else "value"
            above.set_ylabel(f"{quantity} ({display_unit(unit)})", fontsize=9)
            below.set_ylabel(f"free run −\nmeasured ({display_unit(unit)})", fontsize=9)
            entries = [axis.get_legend_handles_labels() for axis in (above, below)]
    figure.legend(
        entries[0][0] + entries[1][0],
        entries[0][1] + entries[1][1],
        loc="outside upper left",
        ncols=4,
        fontsize=8,
        frameon=False,
    )


def draw_errors(axis: Axes, held_out: HeldOutProof, cycles: Sequence[int], unit: str) -> None:
    """A pair of bars a held-out cycle, before and after, and a line at the noise floor of each, in `unit`.

    `cycles` are their numbers; another count than there are bars, and they are counted from 1.
    """
    rows = np.array(held_out.per_cycle, dtype=float).reshape(-1, 3)
    place = np.arange(rows.shape[0])
    after = bool(np.isfinite(rows[:, 1]).any())
    width = 0.38 if after else 0.6
    shift = width / 2 if after else 0.0
    axis.bar(place - shift, rows[:, 0], width, color=BEFORE, label="before")
    if after:
        axis.bar(place + shift, rows[:, 1], width, color=AFTER, label="after")
    axis.hlines(rows[:, 2], place - 0.45, place + 0.45, color=FLOOR, linewidth=2.0, label="noise floor")
    names = [number + 1 for number in (cycles if len(cycles) == place.size else place.tolist())]
    few = place[:: max(1, place.size // 30)]
    axis.set_xticks(few, [str(names[number]) for number in few], fontsize=8)
    axis.set_xlabel("held-out cycle", fontsize=9)
    axis.set_ylabel(f"free-run rms error ({display_unit(unit)})", fontsize=9)
    axis.set_ylim(bottom=0.0)
    axis.grid(alpha=0.25, axis="y")
    axis.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2, ncols=3, fontsize=8, frameon=False)
