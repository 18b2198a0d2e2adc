"""What the given model's own parameters can imitate: a free run of one relaxation a stage, as columns.

For given rates the run is linear in targets, gains and starts (Golub & Pereyra 1973); the rates are found by
Gauss-Newton on their tangents. A cell is `CELL` seconds of the plant's time; drives are means over the cell before.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_banded

from benchmarks.discrepancy.operation import Array
from benchmarks.discrepancy.recorder.work import STEP, Work
from benchmarks.discrepancy.visible import Family

CELL = 20.0
"""Seconds of a cell."""
FITTED = 0.7
"""The share of the time that a tool may fit."""
ROUNDS, FAR = 4, 0.4
"""Steps of Gauss-Newton, and the largest change of a log rate in one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cells:
    """The m cells of a work from its first start on, most often those that may be fitted: rows of the plant's grid,
    share of time `running`, `drives` (m, columns) of targets then gains, the cells at which cycles begin, and each
    cell's `cycle`."""

    rows: np.ndarray
    running: Array
    drives: Array
    begins: np.ndarray
    cycle: np.ndarray
    family: Family

    def first_cycles(self, count: int) -> "Cells":
        """The cells of so many cycles from the first on."""
        kept = self.cycle < count
        return Cells(
            rows=self.rows[kept], running=self.running[kept], drives=self.drives[kept], begins=self.begins[:count],
            cycle=self.cycle[kept], family=self.family,
        )  # fmt: skip


def cut_cells(work: Work, family: Family, share: float = FITTED) -> Cells:
    """The cells that a tool may fit, or those of another `share` of the time."""
    each = int(CELL / STEP)
    rows = np.arange(work.starts[0], int(share * work.running.size), each)
    behind = np.maximum(rows[:, None] - each + np.arange(each), 0)
    stages = [(work.stage == one).astype(float) for one in range(5)]
    gains = [
        np.where(np.asarray(family.gains)[work.stage] == one, (work.load - 200.0) / 100.0, 0.0)
        for one in range(max(family.gains) + 1)
    ]
    drives = np.column_stack([column[behind].mean(axis=1) for column in (*stages, *gains)])
    starts = np.asarray(work.starts)
    begins = np.unique(np.searchsorted(rows, starts[starts <= rows[-1]]))
    cycle = np.searchsorted(begins, np.arange(rows.size), side="right") - 1
    return Cells(
        rows=rows, running=work.running[behind].mean(axis=1), drives=drives, begins=begins, cycle=cycle, family=family
    )


def pace(cells: Cells, rates: Array) -> Array:
    """(m,) 1/s for log rates of (rest, running)."""
    resting, running = np.exp(rates)
    return np.asarray(resting + (running - resting) * cells.running)


def respond(keep: Array, push: Array, begins: np.ndarray) -> Array:
    """(m, columns) of x[i] = keep[i] x[i-1] + push[i], begun anew with `push` at `begins`."""
    free = keep.copy()
    free[begins] = 0.0
    band = np.vstack([np.ones(free.size), np.append(-free[1:], 0.0)])
    return np.asarray(solve_banded((1, 0), band, push))


def columns_at(cells: Cells, rates: Array) -> Array:
    """(m, columns) responses to unit targets, gains and starts."""
    keep = np.exp(-pace(cells, rates) * CELL)
    push = (1.0 - keep)[:, None] * cells.drives
    push[cells.begins] = 0.0
    own = np.zeros((keep.size, cells.begins.size))
    own[cells.begins, np.arange(cells.begins.size)] = 1.0
    return respond(keep, np.hstack([push, own]), cells.begins)


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """`left` (m,) degC of a course, the `tangent` (m, columns) there, and log `rates`."""

    left: Array
    tangent: Array
    rates: Array


def fit_cells(cells: Cells, course: Array) -> Fit:
    """The nearest free run of the model to a course (n,) on the plant's grid."""
    values, rates = course[cells.rows], np.log([1 / 3600.0, 1 / 1400.0])
    for _ in range(ROUNDS):
        left, tangent = _tangent(cells, values, rates)
        change = np.linalg.lstsq(tangent, left, rcond=None)[0][-2:]
        rates = rates + np.clip(change, -FAR, FAR)
    left, tangent = _tangent(cells, values, rates)
    return Fit(left=left, tangent=tangent, rates=rates)


def _tangent(cells: Cells, values: Array, rates: Array) -> tuple[Array, Array]:
    basis = columns_at(cells, rates)
    return _tangent_at(cells, values, rates, basis, np.linalg.lstsq(basis, values, rcond=None)[0])


def _tangent_at(cells: Cells, values: Array, rates: Array, basis: Array, best: Array) -> tuple[Array, Array]:
    slopes = [(columns_at(cells, rates + 1e-3 * one) - basis) @ best / 1e-3 for one in np.eye(2)]
    return values - basis @ best, np.column_stack([basis, *slopes])


def fit_first_cycles(cells: Cells, count: int, course: Array) -> Fit:
    """The free run nearest to a course (n,) in its first cycles, so many, let run over all cells: each further cycle
    from where the course is as it begins."""
    fitted = cells.first_cycles(count)
    rates = fit_cells(fitted, course).rates
    values, basis = course[cells.rows], columns_at(cells, rates)
    seen, known = slice(fitted.rows.size), slice(cells.drives.shape[1] + count)
    best = np.linalg.lstsq(basis[seen, known], values[seen], rcond=None)[0]
    left, tangent = _tangent_at(cells, values, rates, basis, np.concatenate([best, values[cells.begins[count:]]]))
    return Fit(left=left, tangent=tangent, rates=rates)


def measure_left(cells: Cells, course: Array) -> float:
    """degC rms that the best free run leaves of a noise-free course."""
    return float(np.sqrt(np.mean(fit_cells(cells, course).left ** 2)))


def measure_visible(cells: Cells, without: Array, with_it: Array) -> float:
    """degC rms of the difference of two noise-free courses that the model's own parameters cannot imitate."""
    tangent = fit_cells(cells, with_it).tangent
    difference = (with_it - without)[cells.rows]
    left = difference - tangent @ np.linalg.lstsq(tangent, difference, rcond=None)[0]
    return float(np.sqrt(np.mean(left**2)))
