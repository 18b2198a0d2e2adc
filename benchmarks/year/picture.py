"""The year in one picture: error, coverage and alarms by month, and where the plant changed and the loop acted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.year.plant import CHANGES, MONTHS, YEAR
from sim.lab.judge import NOMINAL_COVERAGE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Drawing

    from benchmarks.year.__main__ import Year

COLOURS: Mapping[str, str] = {"once": "#8c8c8c", "loop": "#0b6e4f", "daily": "#c8553d"}
WORDS: Mapping[str, str] = {
    "once": "learned once",
    "loop": "this loop",
    "daily": "learned daily from everything",
}
MARKS: Mapping[str, tuple[str, str]] = {
    "promotion": ("^", "promotion"),
    "roll-back": ("v", "roll-back"),
    "no proposal": ("x", "retraining without a proposal"),
    "left": (".", "candidate not promoted"),
}


def draw_year(years: Sequence[Year]) -> Drawing:
    """Three rows over the months: MAE at 900 s, coverage of the 90 % band, false and missed alarms."""
    from matplotlib.figure import Figure as Drawing

    drawing = Drawing(figsize=(10.0, 8.0), layout="constrained")
    error, covered, alarms = drawing.subplots(3, 1, sharex=True, height_ratios=(1.5, 1.0, 1.0))
    months = sorted({score.month for score in years[0].scores})
    centres = np.array(months) + 0.5
    width = 0.8 / len(years)
    most = 0.0
    for number, year in enumerate(years):
        by_month = [[score for score in year.scores if score.month == month] for month in months]
        look = {"color": COLOURS[year.arm], "label": WORDS[year.arm]}
        mae = [float(np.mean([score.mae[-1] for score in own])) for own in by_month]
        error.plot(centres, mae, marker="o", **look)
        covered.plot(
            centres, [100.0 * float(np.mean([s.coverage[-1] for s in own])) for own in by_month], marker="o", **look
        )
        false = np.array([sum(score.false for score in own) for own in by_month])
        missed = np.array([sum(score.overheated - len(score.leads) for score in own) for own in by_month])
        place = centres + (number - (len(years) - 1) / 2.0) * width
        alarms.bar(place, false, width, color=COLOURS[year.arm])
        alarms.bar(place, -missed, width, color=COLOURS[year.arm], alpha=0.5)
        most = max(most, *mae)
        for each in year.happenings:
            if each.kind in MARKS:
                error.plot(
                    each.day * MONTHS / YEAR, 0.0, MARKS[each.kind][0], color=COLOURS[year.arm], clip_on=False, zorder=3
                )
    for kind, (mark, words) in MARKS.items():
        if any(each.kind == kind for year in years for each in year.happenings):
            error.plot([], [], mark, color=COLOURS["loop"], label=words)
    error.set(ylabel="MAE 900 s ahead (°C)", ylim=(0.0, 1.15 * most))
    drawing.suptitle("A year at the plant")
    covered.axhline(100.0 * NOMINAL_COVERAGE, color="black", linewidth=0.8, linestyle=":")
    covered.set(ylabel="in the 90 % band (%)")
    alarms.axhline(0.0, color="black", linewidth=0.8)
    alarms.yaxis.get_major_locator().set_params(integer=True)
    alarms.set(ylabel="missed below,\nfalse alarms above", xlabel="month", xlim=(0.0, max(months) + 1.0))
    alarms.set_xticks(centres, [str(month + 1) for month in months])
    for axes in (error, covered, alarms):
        _changes(axes, max(months) + 1.0, words=axes is error)
        axes.grid(axis="y", linewidth=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    # The axis begins at 0, and no month is much better than another: below the lines there is room.
    error.legend(fontsize=8, ncols=2, loc="lower left", bbox_to_anchor=(0.0, 0.08), framealpha=0.9)
    return drawing


def _changes(axes: Axes, until: float, *, words: bool) -> None:
    """Lines where the plant changed."""
    for what, day in CHANGES.items():
        at = day * MONTHS / YEAR
        if at < until:
            axes.axvline(at, color="#444444", linewidth=0.8, linestyle="--")
            if words:
                axes.annotate(
                    f"new {what}", (at, 1.0), xycoords=("data", "axes fraction"), fontsize=8, ha="left", va="bottom"
                )
