"""Pictures of answers: the courses of a simulation, or how the moment of the goal is distributed."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from sim.checking.query import Always, Hypothesis, Probability, Simulation

if TYPE_CHECKING:
    from sim.checking.answer import Answer

MOST_DRAWN = 100
"""Courses in one picture; more are a black surface."""

COLOUR, FAINT = "#1f6fb4", "#c65d1e"


def draw_answer(found: "Answer", text: str, path: Path) -> None:
    """Draw the answer to `path`. Raises ValueError for a query that has no picture, OSError."""
    query = found.query
    if isinstance(query, Simulation):
        figure, panels = _figure(len(query.labels))
        for row, (axes, label) in enumerate(zip(panels, query.labels, strict=True)):
            _courses(axes, found, row, label)
    elif found.passages is not None and found.passages.size:
        figure, panels = _figure(1)
        _passages(panels[0], found)
    else:
        raise ValueError("this query has no picture: --picture draws simulate, and <>, [] and U without --rare")
    title = text if len(text) <= 100 else f"{text[:97]}..."
    figure.suptitle(f"{title}\n{found.start}, {found.runs} runs, seed {found.seed}", fontsize=9)
    panels[-1].set_xlabel("s since the start")
    figure.savefig(path, dpi=130)


def _figure(rows: int) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(10, 1.4 + 3.2 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, list(figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0])


def _courses(axes: Axes, found: "Answer", row: int, label: str) -> None:
    shown = found.courses[:MOST_DRAWN]
    alpha = max(0.15, min(0.9, 6.0 / len(shown)))
    for course in shown:
        axes.plot(course.times, course.values[row], color=COLOUR, linewidth=0.8, alpha=alpha)
    unit = " (°C)" if label == "Temp" else ""
    more = f", the first {MOST_DRAWN} of {len(found.courses)}" if len(found.courses) > MOST_DRAWN else ""
    axes.set_ylabel(f"{label}{unit}{more}")
    axes.grid(alpha=0.3)


def _passages(axes: Axes, found: "Answer") -> None:
    """The share of runs in which the goal has come by each moment, with the answer's interval at the end."""
    question = found.query.question if isinstance(found.query, Hypothesis) else found.query
    if found.passages is None or not isinstance(question, Probability):
        return
    times = np.sort(found.passages[np.isfinite(found.passages)])
    share = np.arange(1, times.size + 1) / found.passages.size
    ends = [0.0, *times.tolist(), question.bound]
    axes.step(ends, [0.0, *share.tolist(), share[-1] if share.size else 0.0], where="post", color=COLOUR)
    low, high = found.numbers["low"], found.numbers["high"]
    if isinstance(question.path, Always):
        low, high = 1.0 - high, 1.0 - low
    middle = times.size / found.passages.size
    axes.errorbar(
        [question.bound], [middle], [[max(middle - low, 0.0)], [max(high - middle, 0.0)]], color=FAINT, capsize=4
    )
    axes.set_ylabel("share violated by then" if isinstance(question.path, Always) else "share reached by then")
    axes.set_xlim(0.0, 1.02 * question.bound)
    axes.set_ylim(bottom=0.0)
    axes.grid(alpha=0.3)
