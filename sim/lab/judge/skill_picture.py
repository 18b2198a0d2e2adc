"""The figures of methods as one picture: errors beside persistence, and coverage by horizon and over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import nan
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sim.lab.judge.rows import NO_SKILL, NOMINAL_COVERAGE, TRACE_PARTS_S, SkillRow, group_rows, skill, stretch
from sim.lab.learning import PERSISTENCE
from sim.lab.pictures import blank_figure, write_picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


COLOURS = (
    *("#1f6fb4", "#2a8c6a", "#c65d1e", "#8c5fb0", "#b08a2e", "#b3261e"),
    *("#4a9aa5", "#7f7f7f", "#000000", "#d05a9a", "#6b8e23", "#8b4513"),
)
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "d", "*", "<", ">", "h")
MIN_COVERAGE_AXIS = 0.6
"""Where the axes of coverage begin at the latest, so that those of several sets can be compared."""
REFERENCE_COLOUR = "#555555"


def draw_skill(rows: Mapping[str, Sequence[SkillRow]], path: Path) -> Path:
    """Write the picture, a row of four panels for each title, and return the path.

    The rows of each title are those at the moments that its methods share. Raises ValueError for another ending than a
    picture's, and OSError.
    """
    return write_picture(skill_figure(rows), path)


def skill_figure(rows: Mapping[str, Sequence[SkillRow]]) -> Figure:
    """CRPS and MAE relative to persistence's and coverage by horizon; coverage by the time since a trace's start."""
    figure = blank_figure(16, 1.2 + 3.1 * max(len(rows), 1))
    methods = list(dict.fromkeys(row.method for own in rows.values() for row in own))
    axes = figure.subplots(max(len(rows), 1), 4, squeeze=False)

    def points(axis: Axes, method: str, values: Sequence[float]) -> None:
        # Beside those of the other methods, so that equal points do not hide one another.
        place = methods.index(method)
        across = np.arange(len(values)) + 0.6 * ((place + 0.5) / len(methods) - 0.5)
        colour, marker = COLOURS[place % len(COLOURS)], MARKERS[place % len(MARKERS)]
        axis.plot(across, values, linestyle="none", markersize=6, color=colour, marker=marker, label=method)

    for line, (title, own) in zip(axes, rows.items(), strict=False):
        horizons = sorted({row.horizon for row in own})
        by_horizon = {key: skill(part) for key, part in group_rows(own, lambda row: (row.method, row.horizon)).items()}
        stretches = [name for name in TRACE_PARTS_S if any(stretch(row) == name for row in own)]
        by_time = {key: skill(part) for key, part in group_rows(own, lambda row: (row.method, stretch(row))).items()}
        for method in methods:
            cells = [by_horizon.get((method, horizon), NO_SKILL) for horizon in horizons]
            if method != PERSISTENCE:
                still = [by_horizon.get((PERSISTENCE, horizon), NO_SKILL) for horizon in horizons]
                for axis, figures in ((line[0], attrgetter("crps")), (line[1], attrgetter("mae"))):
                    # Persistence may be without any error, where a trace does not move.
                    pairs = [(figures(cell), figures(other)) for cell, other in zip(cells, still, strict=True)]
                    points(axis, method, [value / other if other else nan for value, other in pairs])
            points(line[2], method, [cell.coverage for cell in cells])
            points(line[3], method, [by_time.get((method, name), NO_SKILL).coverage for name in stretches])
        titles = ("CRPS, persistence = 1", "MAE, persistence = 1", "coverage", "coverage, time since start")
        for number, (axis, what) in enumerate(zip(line, titles, strict=True)):
            axis.set_title(f"{title}: {what}", fontsize=10, loc="left", parse_math=False)
            if number < 3:
                labels = [f"{horizon:g} s" for horizon in horizons]
            else:
                # With how many forecasts: a share of a few says nothing.
                counts = [max(by_time[key].forecasts for key in by_time if key[1] == name) for name in stretches]
                labels = [f"{name}\n{count} forecasts" for name, count in zip(stretches, counts, strict=True)]
            axis.set_xticks(range(len(labels)), labels)
            axis.set_xlim(-0.5, max(len(labels), 1) - 0.5)
            axis.axhline(NOMINAL_COVERAGE if number >= 2 else 1.0, color=REFERENCE_COLOUR, linewidth=1.0)
            axis.grid(alpha=0.25, axis="y")
            if number >= 2:
                axis.set_ylim(min(axis.get_ylim()[0], MIN_COVERAGE_AXIS), 1.03)
            else:
                axis.set_ylim(0.0, max(axis.get_ylim()[1], 1.1))
    handles, labels = axes[0, 2].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=max(len(methods), 1), fontsize=9)
    figure.suptitle(
        "Forecasts beside what came true; the line in the right half is the nominal 90 %", x=0.01, ha="left"
    )
    return figure
