"""An ideal judge: what could be known of a case by who knows the true forms, the true noise and the true clock.

The readings' noise, the heat that wanders and the scatter from cycle to cycle are those that the case was made with:
readings and wandering heat are whitened by a Kalman filter, the scatter has its prior as rows beside the whitened ones,
the baseline's parameters are profiled out (tangents, flat prior). An effect's evidence is what its column (of free
strength, of the right sign) gains in log-likelihood beside the other effects of the case; its margin is how far the
best column of another form, made by the same plant in its place, stays behind.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.discrepancy.operation import Array
from benchmarks.discrepancy.recorder.baseline import CELL, Cells, Fit, fit_cells, pace, respond
from benchmarks.discrepancy.recorder.habits import Habit, Rows
from benchmarks.discrepancy.recorder.masses import Machine, stir
from benchmarks.discrepancy.recorder.work import STEP

EVIDENCE, MARGIN = 14.0, 6.0
"""Nats over nothing and over the best rival from which an ideal judge would name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Removal:
    """Errors (degC, one reading) of free runs through cycles that were never fitted: of the model's own parameters,
    fitted to the others (`before`), and of these with the true form of what acts (`after`)."""

    before: float
    after: float

    def share(self, floor: float) -> float:
        """Of the excess over a noise `floor` (degC), what is removed; NaN where there is none."""
        excess = self.before**2 - floor**2
        return 1.0 - (self.after**2 - floor**2) / excess if excess > 0 else float("nan")


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """`nats` over the case without its weakest effect, `margin` over the best rival of it, which is `rival`;
    `rival_nats` what that rival gains over the case without the effect. `removal`: what an ideal fit removes; None
    where nothing acts or it was not computed."""

    nats: float
    margin: float
    rival: str
    rival_nats: float
    removal: Removal | None = None

    @property
    def visible(self) -> bool:
        """Whether it could be known that something acts (that all of it acts)."""
        return self.nats >= EVIDENCE

    @property
    def knowable(self) -> bool:
        """Whether it could be known what acts."""
        return self.visible and self.margin >= MARGIN


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """The difference (n,) degC that an effect makes on the plant's grid; `signed`: it may act the other way too."""

    name: str
    difference: Array
    signed: bool = False


def judge_case(
    cells: Cells, machine: Machine, habit: Habit, rows: Rows, *, course: Array, quiet: Array, clean: Array,
    true: Sequence[Candidate], rivals: Sequence[Candidate],
) -> Verdict:  # fmt: skip
    """The verdict on a case: its `course` (n,) as it went, as it would have gone without what nobody knows (`quiet`),
    and without what acts, too (`clean`); `rows` are the readings of the course."""
    fitted = fit_cells(cells, quiet)
    noise, variance, _ = read_cells(cells, habit, rows, course, quiet)
    columns = [(quiet - clean)[cells.rows], *(one.difference[cells.rows] for one in (*true, *rivals))]
    responses = respond_to_scatter(cells, fitted)
    raw = np.column_stack([noise, *columns, fitted.tangent, responses])
    white = whiten(raw, variance, cells, fitted, machine)
    count = len(columns)
    level = max(machine.usual * machine.running * machine.scatter, 1e-12)
    prior = np.zeros((responses.shape[1], white.shape[1]))
    prior[:, -responses.shape[1] :] = np.eye(responses.shape[1]) / level
    white = np.vstack([white, prior])
    nuisance = white[:, 1 + count :]
    nuisance = nuisance / np.maximum(np.linalg.norm(nuisance, axis=0), 1e-30)
    basis, sizes, _ = np.linalg.svd(nuisance, full_matrices=False)
    basis = basis[:, sizes > 1e-9 * sizes[0]]
    wanted = white[:, : 1 + count]
    clear = wanted - basis @ (basis.T @ wanted)
    data = clear[:, 0] + clear[:, 1]  # the noise as it fell, and what acts
    doing = clear[:, 2:]
    return _weigh(data, doing, true, rivals)


def _weigh(data: Array, doing: Array, true: Sequence[Candidate], rivals: Sequence[Candidate]) -> Verdict:
    own = list(range(len(true)))
    signed = {number: one.signed for number, one in enumerate((*true, *rivals))}

    def gain(chosen: Sequence[int]) -> float:
        """Nats of the columns over none; one of the wrong sign counts as not there."""
        left = list(chosen)
        while left:
            strengths = np.linalg.lstsq(doing[:, left], data, rcond=1e-10)[0]
            wrong = [at for at, value in zip(left, strengths, strict=True) if value < 0 and not signed[at]]
            if not wrong:
                return 0.5 * float(np.sum((doing[:, left] @ strengths) ** 2))
            left.remove(wrong[0])
        return 0.0

    names = {one.name for one in true}
    others = [at for at, one in enumerate(rivals, start=len(true)) if one.name not in names]
    full, found = gain(own), []
    for at in own or [-1]:
        rest = [one for one in own if one != at]
        base = gain(rest)
        best = max(others, key=lambda one: gain([*rest, one]), default=None)
        against = base if best is None else gain([*rest, best])
        name = "" if best is None else rivals[best - len(true)].name
        found.append(Verdict(nats=full - base, margin=full - against, rival=name, rival_nats=against - base))
    return min(found, key=lambda one: min(one.nats - EVIDENCE, one.margin - MARGIN))


def read_cells(cells: Cells, habit: Habit, rows: Rows, course: Array, quiet: Array) -> tuple[Array, Array, Array]:
    """((m,) mean of what the readings of each cell are off the quiet course, (m,) its variance, inf: no reading,
    (m,) mean square of the same readings about that mean)."""
    grid = STEP * np.arange(course.size)
    told = np.isfinite(rows.reading)
    times, reading = rows.times[told], rows.reading[told]
    cell = np.floor((times - STEP * cells.rows[0]) / CELL + 0.5).astype(int)
    inside = (cell >= 0) & (cell < cells.rows.size)
    cell, times, reading = cell[inside], times[inside], reading[inside]
    count = np.bincount(cell, minlength=cells.rows.size)
    each = reading - np.interp(times, grid, quiet)
    off = np.bincount(cell, weights=each, minlength=cells.rows.size) / np.maximum(count, 1)
    about = np.bincount(cell, weights=(each - off[cell]) ** 2, minlength=cells.rows.size) / np.maximum(count, 1)
    # Rounding is the noise's own company only where the noise reaches over a step of it; else it lasts as long as the
    # temperature takes for a step.
    if habit.noise >= 0.4 * habit.quantum:
        variance = habit.sigma**2 / np.maximum(count, 1)
    else:
        moves = np.abs(np.gradient(course[cells.rows])) + habit.noise
        lasts = np.clip(habit.quantum / np.maximum(moves, 1e-6), 1.0, 30.0)
        variance = habit.noise**2 / np.maximum(count, 1) + habit.quantum**2 / 12.0 * lasts
    return off, np.where(count > 0, variance, np.inf), about


def respond_to_scatter(cells: Cells, fitted: Fit) -> Array:
    """(m, cycles) degC: what one K/s more in one cycle does."""
    rate = pace(cells, fitted.rates)
    keep = np.exp(-rate * CELL)
    each = (cells.cycle[:, None] == np.arange(cells.begins.size)) * cells.running[:, None]
    push = ((1.0 - keep) / rate)[:, None] * each
    push[cells.begins] = 0.0
    return respond(keep, push, cells.begins)


def whiten(raw: Array, variance: Array, cells: Cells, fitted: Fit, machine: Machine) -> Array:
    """(m, columns) innovations over their standard deviations; the filter's state is (temperature, heat) that nobody
    knows, and the columns share its gains. A cell without a reading gives a row of zeros."""
    rate = pace(cells, fitted.rates)
    keep, stays = np.exp(-rate * CELL), float(np.exp(-CELL / machine.memory))
    push = (1.0 - keep) / rate * stir(cells.running)
    level = (machine.usual * machine.running * machine.rough) ** 2
    shock = level * (1.0 - stays**2)
    fresh = np.zeros(raw.shape[0], dtype=bool)
    fresh[cells.begins] = True
    state = np.zeros((2, raw.shape[1]))
    warm, both, heat = 0.0, 0.0, level
    out = np.zeros_like(raw)
    for row in range(raw.shape[0]):
        a, b = keep[row], push[row]
        state[0] = a * state[0] + b * state[1]
        state[1] *= stays
        warm, both, heat = (
            a * a * warm + 2 * a * b * both + b * b * heat,
            stays * (a * both + b * heat),
            (stays**2 * heat + shock),
        )
        if fresh[row]:  # a start of its own is among the parameters
            state[0] = 0.0
            warm = both = 0.0
        if not np.isfinite(variance[row]):
            continue
        total = warm + variance[row]
        miss = raw[row] - state[0]
        out[row] = miss / np.sqrt(total)
        first, second = warm / total, both / total
        state[0] += first * miss
        state[1] += second * miss
        warm, both, heat = warm * (1 - first), both * (1 - first), heat - second * both
    return out
