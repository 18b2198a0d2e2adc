"""What could be removed on cycles that were never fitted, by who knows the true form of what acts, noise and clock.

The fitted cycles are those that a tool fits, with the noise as it fell. The model's own parameters (tangents, flat
prior) and one free strength for each effect are fitted to them by generalised least squares, weighed as the ideal judge
weighs. What such a fit errs by beyond the plant's noise could not have been known.
"""

from collections.abc import Sequence

import numpy as np

from benchmarks.discrepancy.operation import Array
from benchmarks.discrepancy.recorder.baseline import Cells, Fit, fit_first_cycles
from benchmarks.discrepancy.recorder.habits import Habit, Rows
from benchmarks.discrepancy.recorder.ideal import Candidate, Removal, read_cells, respond_to_scatter, whiten
from benchmarks.discrepancy.recorder.masses import Machine
from benchmarks.discrepancy.recorder.work import STEP

HELD_OUT, LEAST_FITTED = 0.3, 3
"""The share of the cycles, the last ones, that a tool does not fit, and the cycles that it fits at least."""
START, START_CELLS = 300.0, 2
"""Seconds of a cycle, or its first cells with a reading, that say where its free run begins."""


def count_fitted(cycles: int) -> int:
    """How many of so many cycles are fitted."""
    return max(round((1.0 - HELD_OUT) * cycles), LEAST_FITTED)


def measure_removal(
    cells: Cells, machine: Machine, habit: Habit, rows: Rows, *, course: Array, quiet: Array, clean: Array,
    true: Sequence[Candidate],
) -> Removal | None:  # fmt: skip
    """What a fit with the true form removes, None where nothing acts; `cells` are those of the whole time, the rest is
    as for `judge_case`.

    What the model leaves of the machine without what acts counts to neither error: nobody could fit it.
    """
    if not true:
        return None
    count = count_fitted(cells.begins.size)
    bare, bent = fit_first_cycles(cells, count, clean), fit_first_cycles(cells, count, quiet)
    noise, variance, about = read_cells(cells, habit, rows, course, quiet)
    doing = np.column_stack([one.difference[cells.rows] for one in true])
    before = _predict(cells, count, bent, doing[:, :0], noise + bent.left - bare.left, variance, bare, machine)
    after = _predict(cells, count, bare, doing, noise, variance, bare, machine)
    at = np.isfinite(variance)
    return Removal(
        before=_measure_error(cells, count, bent, before, about, at),
        after=_measure_error(cells, count, bare, after, about, at),
    )


def _predict(
    cells: Cells, count: int, fit: Fit, doing: Array, off: Array, variance: Array, true: Fit, machine: Machine
) -> Array:
    """(m,) degC that the cells are off, `off` before, once what the first cycles say of parameters and strengths of
    what is `doing` (m, effects) is taken out; the noise is that of a machine with the `true` rates."""
    fitted = cells.first_cycles(count)
    seen, shared = fitted.rows.size, cells.drives.shape[1]
    unseen = np.arange(shared + count, shared + cells.begins.size)
    columns = np.hstack([doing, np.delete(fit.tangent, unseen, axis=1)])
    scatter = respond_to_scatter(fitted, true)
    white = whiten(np.column_stack([off[:seen], columns[:seen], scatter]), variance[:seen], fitted, true, machine)
    prior = np.zeros((count, white.shape[1]))
    prior[:, -count:] = np.eye(count) / max(machine.usual * machine.running * machine.scatter, 1e-12)
    white = np.vstack([white, prior])
    sizes = np.maximum(np.linalg.norm(white[:, 1:], axis=0), 1e-30)
    found = np.linalg.lstsq(white[:, 1:] / sizes, white[:, 0], rcond=1e-9)[0] / sizes
    return np.asarray(off - columns @ found[: columns.shape[1]])


def _measure_error(cells: Cells, count: int, fit: Fit, off: Array, about: Array, read: np.ndarray) -> float:
    """degC rms of a reading in the cycles after the first ones, each begun where its first readings say."""
    squares = []
    for cycle in range(count, cells.begins.size):
        here = np.flatnonzero(read & (cells.cycle == cycle))
        if here.size == 0:
            continue
        begun = fit.tangent[here, cells.drives.shape[1] + cycle]
        early = STEP * (cells.rows[here] - cells.rows[here[0]]) <= START
        early[:START_CELLS] = True
        start = np.sum((begun * off[here])[early]) / max(float(np.sum(begun[early] ** 2)), 1e-12)
        squares.append((off[here] - start * begun) ** 2 + about[here])
    return float(np.sqrt(np.mean(np.concatenate(squares))))
