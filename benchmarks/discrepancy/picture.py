"""The picture of the benchmark: naming by signal-to-noise, what was said of what, confidence, excess and time."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.discrepancy.effects import EFFECTS
from benchmarks.discrepancy.judging import Judged
from benchmarks.discrepancy.outside import OUTSIDE
from benchmarks.discrepancy.scorer import SPEED_LIMIT, by_ratio, confusion, excess, reliability
from benchmarks.discrepancy.strata import RATIOS

WANTED = {True: {1.0: 0.75, 1.5: 0.90, 2.0: 0.95, 3.0: 0.98}, False: {1.0: 0.90, 1.5: 0.98, 2.0: 0.99, 3.0: 0.99}}
OTHER = ("class", "wrong class", "unexplained", "agree", "too-little-data", "error", "timeout")


def draw(tools: Mapping[str, Sequence[Judged]], path: Path) -> None:
    """Write the picture (PNG); the first tool is the one under test."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(15, 14), layout="constrained")
    FigureCanvasAgg(figure)
    first = next(iter(tools.values()))
    grid = figure.add_gridspec(2, 3, height_ratios=(1.0, 2.4))
    _naming(figure.add_subplot(grid[0, 0]), tools, rough=True)
    _naming(figure.add_subplot(grid[0, 1]), tools, rough=False)
    last = grid[0, 2].subgridspec(1, 2)
    _confidence(figure.add_subplot(last[0, 0]), first)
    _shares(figure.add_subplot(last[0, 1]), first)
    _confusion(figure.add_subplot(grid[1, :]), first)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def _naming(axes: Any, tools: Mapping[str, Sequence[Judged]], *, rough: bool) -> None:
    ratios = dict.fromkeys(RATIOS, 0.0)
    for number, (name, judged) in enumerate(tools.items()):
        singles = [one for one in judged if one.stratum == "singles"]
        rows = by_ratio(singles, rough=rough, wanted=ratios)
        x = np.array([ratio for ratio, one in zip(RATIOS, rows, strict=True) if one.cases])
        y = np.array([one.share for one in rows if one.cases])
        ends = np.array([one.interval for one in rows if one.cases]).reshape(-1, 2)
        bars = np.clip(np.stack([y - ends[:, 0], ends[:, 1] - y]), 0, None) if x.size else None
        style = {"lw": 2.2, "zorder": 3} if number == 0 else {"lw": 1.0, "ls": "--"}
        axes.errorbar(x * 1.015**number, y, yerr=bars, marker="o", ms=4, capsize=2, label=name, **style)
    goal = WANTED[rough]
    axes.plot(list(goal), list(goal.values()), "k_", ms=16, mew=2, label="target")
    axes.set_xscale("log")
    axes.set_xticks(RATIOS, [f"{ratio:g}" for ratio in RATIOS])
    axes.minorticks_off()
    axes.set(ylim=(-0.03, 1.03), xlabel="signal-to-noise", ylabel="share named exactly")
    axes.set_title(f"single effects, {'rough' if rough else 'smooth'} plant", fontsize=10)
    axes.legend(fontsize=7)
    axes.grid(alpha=0.3)


def _confidence(axes: Any, judged: Sequence[Judged]) -> None:
    bins = reliability(judged)
    stated = np.array([one.stated for one in bins])
    right = np.array([one.right.share for one in bins])
    ends = np.array([one.right.interval for one in bins]).reshape(-1, 2)
    axes.plot([0, 1], [0, 1], "k:", lw=1)
    if bins:
        axes.errorbar(stated, right, yerr=np.clip([right - ends[:, 0], ends[:, 1] - right], 0, None), fmt="o", ms=4)
    axes.set(xlim=(0, 1.02), ylim=(0, 1.02), xlabel="stated\nconfidence", ylabel="first claims right")
    axes.set_title("confidence", fontsize=10)
    axes.grid(alpha=0.3)


def _shares(axes: Any, judged: Sequence[Judged]) -> None:
    removed = np.clip(excess(judged), -0.2, 1.2)
    axes.hist(removed, bins=np.linspace(-0.2, 1.2, 29), color="tab:green", alpha=0.8)
    axes.axvline(0.9, color="k", ls=":", lw=1)
    seconds = [one.outcome.seconds for one in judged if one.label.spec["days"] == 4]
    late = sum(value > SPEED_LIMIT for value in seconds)
    axes.set(xlabel="excess removed\n(rightly named)", ylabel="cases")
    median = f"median {np.median(seconds):.1f} s" if seconds else "no times"
    axes.set_title(f"{median},\n{late} over {SPEED_LIMIT:g} s", fontsize=9)


def _confusion(axes: Any, judged: Sequence[Judged]) -> None:
    table = confusion(judged)
    rows = [name for name in ("nothing", *EFFECTS, *OUTSIDE) if any(key[0] == name for key in table)]
    columns = [*EFFECTS, *OTHER]
    counts = np.array([[table.get((row, column), 0) for column in columns] for row in rows], dtype=float)
    counts = counts.reshape(len(rows), len(columns))
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    axes.imshow(shares, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    for row, column in zip(*np.nonzero(counts), strict=True):
        right = rows[row] == columns[column]
        shade = "white" if shares[row, column] > 0.6 else "black"
        axes.text(
            column, row, f"{counts[row, column]:.0f}", ha="center", va="center", fontsize=8, color=shade,
            fontweight="bold" if right else "normal",
        )  # fmt: skip
    axes.axvline(len(EFFECTS) - 0.5, color="k", lw=1)
    axes.set_xticks(range(len(columns)), columns, rotation=40, ha="right", fontsize=8)
    axes.set_yticks(range(len(rows)), rows, fontsize=8)
    axes.set(xlabel="what was said first", ylabel="what acts")
    axes.set_title("clean cases, single effects and effects outside the vocabulary", fontsize=10)
