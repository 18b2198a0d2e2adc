"""Pictures of answers: the courses of a simulation, or how probable it is that the goal has come by each moment."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from drivers.named_files import name_write_errors
from sim.lab.checking.query import Always, Expression, Hypothesis, Indicator, Probability, Quantity, Simulation
from sim.lab.checking.smc import Answer
from sim.lab.checking.smc.rules import uppaal_interval
from sim.lab.pictures import blank_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


MOST_DRAWN = 100
"""Courses in one picture; more are a black surface."""

POINTS = 400
"""Moments at which means and bands are drawn."""

COLOUR, STRONG = "#1f6fb4", "#c65d1e"


def draw_answer(answer: Answer, text: str, path: Path, unit: str) -> None:
    """Draw the answer to `path`; `unit` is that of the temperature, as people read it.

    Raises ValueError for a query that has no picture, OSError.
    """
    query = answer.query
    if isinstance(query, Simulation):
        figure, panels = _figure(len(query.labels))
        for row, (axes, label) in enumerate(zip(panels, query.labels, strict=True)):
            _courses(axes, answer, row, label, query.expressions[row], unit=unit)
    elif answer.passages is not None and answer.passages.size:
        figure, panels = _figure(1)
        _passages(panels[0], answer)
    else:
        raise ValueError("this query has no picture: --picture draws simulate, and <>, [] and U without --rare")
    title = text if len(text) <= 100 else f"{text[:97]}..."
    figure.suptitle(f"{title}\n{answer.start}\n{answer.runs} runs, seed {answer.seed}", fontsize=9)
    panels[-1].set_xlabel("s since the start")
    with name_write_errors(path):
        figure.savefig(path, dpi=130)


def _figure(rows: int) -> tuple[Figure, list[Axes]]:
    figure = blank_figure(10, 1.6 + min(3.2 * rows, 60.0))
    panels = list(figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0])
    for axes in panels:
        axes.grid(alpha=0.3)
        axes.margins(x=0.0)
    return figure, panels


def _courses(axes: Axes, answer: Answer, row: int, label: str, expression: Expression, *, unit: str) -> None:
    """The courses with their mean; of a condition only the share of runs in which it holds."""
    times = np.linspace(0.0, answer.courses[0].times[-1], POINTS)
    mean = np.mean([np.interp(times, course.times, course.values[row]) for course in answer.courses], axis=0)
    shown = answer.courses[:MOST_DRAWN]
    several, condition = len(answer.courses) > 1, isinstance(expression, Indicator)
    if condition and several:
        axes.plot(times, mean, color=STRONG, linewidth=1.2)
        axes.set_ylim(-0.02, 1.02)
        axes.set_ylabel(f"{label}\nshare of {len(answer.courses)} runs")
        return
    for course in shown:
        axes.plot(
            course.times, course.values[row], color=COLOUR, linewidth=0.8, alpha=max(0.2, min(0.9, 6.0 / len(shown)))
        )
    if several:
        axes.plot(times, mean, color=STRONG, linewidth=1.6, label=f"mean of {len(answer.courses)} runs")
        axes.legend(loc="best", fontsize=8)
    own = f" ({unit if expression.kind == 'temperature' else 's'})" if isinstance(expression, Quantity) else ""
    more = f"\nthe first {MOST_DRAWN} of {len(answer.courses)}" if len(answer.courses) > MOST_DRAWN else ""
    axes.set_ylabel(f"{label}{own}{more}")


def _passages(axes: Axes, answer: Answer) -> None:
    """The share of runs in which the goal has come by each moment, with a band; at the end the answer's interval."""
    question = answer.query.question if isinstance(answer.query, Hypothesis) else answer.query
    if answer.passages is None or not isinstance(question, Probability):
        return
    runs, violated = answer.passages.size, isinstance(question.path, Always)
    times = np.unique(np.concatenate([[0.0], answer.passages[np.isfinite(answer.passages)], [question.bound]]))
    if times.size > POINTS:
        times = times[np.linspace(0, times.size - 1, POINTS).astype(int)]
    come = np.searchsorted(np.sort(answer.passages), times, side="right").astype(float)
    low, high = uppaal_interval(come, np.full(times.size, runs), 0.95)
    axes.fill_between(times, low, high, color=COLOUR, alpha=0.2, linewidth=0, label="95 % interval of each moment")
    axes.plot(times, come / runs, color=COLOUR, label="share violated by then" if violated else "share reached by then")
    ends = answer.numbers["low"], answer.numbers["high"]
    if violated:
        ends = 1.0 - ends[1], 1.0 - ends[0]
    axes.plot([question.bound] * 2, ends, color=STRONG, linewidth=5, clip_on=False, label="the answer's interval")
    axes.set_ylabel("probability of a violation" if violated else "probability")
    axes.set_xlim(0.0, question.bound)
    axes.set_ylim(0.0, min(1.0, 1.1 * float(max(high.max(), ends[1]))))
    axes.legend(loc="best", fontsize=8)
