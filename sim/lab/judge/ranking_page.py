"""A ranking as pictures and as a page: pooled error distributions, the matrix of wins, and one self-contained HTML."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from drivers.named_files import name_write_errors
from sim.lab.judge.metrics import QUANTILES
from sim.lab.judge.ranking import Ranking, entrants
from sim.lab.judge.results import TraceResult
from sim.lab.pages import page_environment
from sim.lab.pictures import MEASURED, blank_figure, svg_text, write_picture
from sim.sha import Array, display_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure


COLOURS: Mapping[str, str] = {"fit": "#2a8c6a", "limited": "#b08a2e", "unfit": "#b3261e"}
SHOWN_LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)
MAX_LABEL_CHARS = 28


@dataclass(frozen=True, slots=True)
class Spread:
    """One model's errors (predicted - measured, degC) over all its readings on the common traces.

    `levels` (5,) are the 5, 25, 50, 75 and 95 % quantiles, `low` and `high` the extremes, `medians` one a trace.
    """

    entrant: str
    levels: Array
    low: float
    high: float
    medians: Array


def spreads(ranking: Ranking, results: Sequence[TraceResult]) -> list[Spread]:
    """The pooled error distribution of each ranked model, best first."""
    table = entrants(results)
    pooled = []
    for standing in ranking.standings:
        own = [table[standing.entrant][trace] for trace in ranking.common if trace in table[standing.entrant]]
        known = [result for result in own if len(result.error_quantiles) == len(QUANTILES)]
        if standing.rank is None or not known:
            continue
        # The mixture of the traces' laws, weighted by their readings; each law is linear between its quantiles, so the
        # mixture is linear between all of them together.
        rows = np.array([result.error_quantiles for result in known])
        grid = np.unique(rows)
        below = []
        for row in rows:
            # Of equal quantiles the last share counts: the law jumps there.
            errors, last = np.unique(row[::-1], return_index=True)
            below.append(np.interp(grid, errors, np.asarray(QUANTILES)[::-1][last]))
        weights = np.array([max(result.readings, 1) for result in known], dtype=float)
        shares = np.average(np.array(below), axis=0, weights=weights)
        levels = np.interp(SHOWN_LEVELS, shares, grid)
        medians = rows[:, QUANTILES.index(0.5)]
        pooled.append(Spread(standing.entrant, levels, float(grid[0]), float(grid[-1]), medians))
    return pooled


def figure(ranking: Ranking, results: Sequence[TraceResult]) -> Figure:
    """Two panels: the errors of each model, and on how many traces each is better than each other one."""
    shown = spreads(ranking, results)
    rows = max(len(ranking.standings), 2)
    canvas = blank_figure(13, 2.2 + 0.55 * rows)
    left, right = canvas.subplots(1, 2, gridspec_kw={"width_ratios": [3, 2]})
    words = {standing.entrant: standing.fitness for standing in ranking.standings}
    for row, spread in enumerate(shown):
        colour = COLOURS[words[spread.entrant]]
        stats = dict(zip(("whislo", "q1", "med", "q3", "whishi"), spread.levels.tolist(), strict=True))
        left.bxp(
            [{**stats, "fliers": []}],
            positions=[row],
            orientation="horizontal",
            widths=0.5,
            showfliers=False,
            patch_artist=True,
            boxprops={"facecolor": colour, "alpha": 0.35, "edgecolor": colour},
            medianprops={"color": colour, "linewidth": 2},
        )
        left.plot(spread.medians, np.full(spread.medians.size, row - 0.36), "|", color=colour, markersize=6)
        left.plot([spread.low, spread.high], [row, row], "x", color=colour, markersize=5)
    left.axvline(0.0, color=MEASURED, linewidth=0.8)
    left.set_yticks(range(len(shown)), [_label(spread.entrant) for spread in shown], parse_math=False)
    left.set_ylim(max(len(shown), 1) - 0.4, -0.6)
    left.set_xlabel(
        f"predicted - measured ({display_unit(ranking.unit)}): "
        "box 25-75 %, whiskers 5-95 %, x extremes, | medians of the traces"
    )
    left.grid(alpha=0.25, axis="x")
    left.set_title("errors at the readings (colour: green fit, ochre limited, red unfit)", fontsize=10, loc="left")
    names, matrix = win_matrix(ranking)
    # Coloured by the share of each pair's traces, as two pairs need not have the same ones; written is the count.
    shares = matrix / np.where(np.isnan(matrix), 1.0, np.maximum(matrix + matrix.T, 1.0))
    if names:
        right.imshow(shares, cmap="PiYG", vmin=-0.3, vmax=1.3, aspect="auto")
    for (row, column), count in np.ndenumerate(matrix):
        if np.isfinite(count):
            right.text(column, row, f"{count:g}", ha="center", va="center")
    labels = [_label(name) for name in names]
    right.set_xticks(range(len(names)), labels, rotation=25, ha="right", fontsize=8, parse_math=False)
    right.set_yticks(range(len(names)), labels, fontsize=8, parse_math=False)
    right.set_title("traces on which the row beats the column", fontsize=10, loc="left")
    note = f"{len(ranking.common)} traces"
    origins = {result.synthetic for result in results if result.trace in ranking.common and not result.failure}
    if True in origins:
        note += ", some of them SYNTHETIC" if False in origins else ", SYNTHETIC: not measured on a plant"
    canvas.suptitle("Models compared, best first", fontsize=13, x=0.01, ha="left", parse_math=False)
    canvas.supxlabel(note, fontsize=9, color=MEASURED, x=0.01, ha="left", parse_math=False)
    return canvas


def win_matrix(ranking: Ranking) -> tuple[tuple[str, ...], Array]:
    """(entrants, (n, n) on how many traces the row's score is lower than the column's); NaN without a common trace."""
    names = tuple(each.entrant for each in ranking.standings if ranking.scores[each.entrant])
    place = {name: number for number, name in enumerate(names)}
    matrix = np.full((len(names), len(names)), np.nan)
    for pair in ranking.pairs:
        if pair.difference.n:
            row, column = place[pair.one], place[pair.other]
            matrix[row, column], matrix[column, row] = pair.wins
    return names, matrix


def _label(name: str) -> str:
    return name if len(name) <= MAX_LABEL_CHARS else f"…{name[1 - MAX_LABEL_CHARS :]}"


def draw_ranking(ranking: Ranking, results: Sequence[TraceResult], path: Path) -> Path:
    """Write the picture and return the path. Raises ValueError as `check_picture`, and OSError."""
    return write_picture(figure(ranking, results), path)


def write_page(ranking: Ranking, results: Sequence[TraceResult], path: Path) -> Path:
    """Write one HTML file that needs no other, and return its path. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with name_write_errors(path):
        path.write_text(page(ranking, results), encoding="utf-8")
    return path


def page(ranking: Ranking, results: Sequence[TraceResult]) -> str:
    """The page: pictures inside, every name escaped."""
    return (
        page_environment("sim.lab.judge")
        .get_template("ranking.html")
        .render(ranking=ranking, unit=display_unit(ranking.unit), picture=svg_text(figure(ranking, results)))
    )


def as_plain(ranking: Ranking) -> dict[str, Any]:
    """The ranking as plain values for JSON, nothing left out."""
    names, matrix = win_matrix(ranking)
    models = []
    for standing in ranking.standings:
        row = asdict(standing)
        models.append({**row, "fitness": standing.fitness, "in_sample": standing.in_sample})
    return {
        "weights": asdict(ranking.weights),
        "common": list(ranking.common),
        "models": models,
        "pairs": [asdict(pair) for pair in ranking.pairs],
        "scores": {name: dict(own) for name, own in ranking.scores.items()},
        "win_matrix": {"models": list(names), "wins": matrix.tolist()},
        "notes": list(ranking.notes),
        "forecasts": ranking.skill and ranking.skill.as_plain(),
    }
