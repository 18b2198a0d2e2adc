"""Free runs over cycles that were never fitted: before and after, beside what the fitted noise alone would make.

Each cycle starts at a temperature of its own, fitted to it; nothing else is. The floor is the root mean square that the
fitted model predicts for its own noise (sensor, process, roughness, scatter of the cycle) by simulation.
"""

from dataclasses import dataclass, replace

import numpy as np

from sim.discrepancy.diagnosis import HeldOutProof
from sim.discrepancy.fitting import CourseState, Fitted, Record, Whitener, at, grid_at, on
from sim.engine import linear_recursion
from sim.learning import Indices
from sim.sha import Array

DRAWS, RESAMPLES, TRIFLE = 200, 2000, 0.02
STARTS = 3
"""Rounds in which the start temperatures are fitted (effects on the sensor make them slightly non-linear)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOutRun:
    """A fit let run over a record cut by cycles.

    `state` is the free run, `residual` (m,) degC of its windows, `begun` (m,) what one degree at a run's start is
    there, `order` (m,) numbers the runs, `whitener` weighs by the fit's noise.
    """

    record: Record
    state: CourseState
    residual: Array
    begun: Array
    order: Indices
    whitener: Whitener


def by_cycles(record: Record) -> Record:
    """The record with a run of its own for each cycle."""
    runs = record.runs
    cut = replace(runs, run=np.cumsum(runs.first | (np.diff(record.cycle, prepend=-1) != 0)) - 1)
    return replace(record, runs=replace(cut, dt=np.where(cut.first, 0.0, runs.dt)))


def let_run(fitted: Fitted, record: Record) -> HeldOutRun:
    """The fit's parameters over another record, each run from the start that suits it best."""
    frame = on(fitted.frame, record)
    reading, first = record.reading, record.window_first
    order = np.cumsum(first) - 1
    start = reading[first]
    state = at(frame, fitted.state.parameters, start, fitted.state.named)
    residual = reading - record.windowed(state.mean)
    # Least squares in one unknown a run: the residual on `begun`, how a degree at the start dies away.
    for _ in range(STARTS):
        decay = np.where(record.runs.first, 0.0, np.exp(-(state.k + state.loss) * record.runs.dt))
        begun = record.windowed(linear_recursion(decay, record.runs.first.astype(float), 0.0))
        moved = np.bincount(order, begun * residual) / np.maximum(np.bincount(order, begun**2), 1e-12)
        start = start + moved
        state = at(frame, fitted.state.parameters, start, fitted.state.named, state.course)
        residual = reading - record.windowed(state.mean)
        if np.max(np.abs(moved)) < 1e-3:
            break
    whitener = Whitener(grid_at(frame, state), fitted.noise)
    return HeldOutRun(record=record, state=state, residual=residual, begun=begun, order=order, whitener=whitener)


def floor_squares(trial: HeldOutRun, seed: int) -> Array:
    """(R,) degC^2 the mean square of each run that the noise alone makes, its start fitted as the residual's was."""
    drawn = trial.whitener.draw(np.random.default_rng(seed), DRAWS)
    count = int(trial.order[-1]) + 1
    # The start was fitted to the residual and took a part of it away; it must take the same part of the drawn noise.
    size = np.bincount(trial.order, trial.begun**2, minlength=count)
    parts = np.zeros((count, DRAWS))
    np.add.at(parts, trial.order, trial.begun[:, None] * drawn)
    left = drawn - trial.begun[:, None] * (parts / np.maximum(size, 1e-12)[:, None])[trial.order]
    squares = np.bincount(trial.order, np.mean(left**2, axis=1), minlength=count)
    return np.asarray(squares / np.maximum(np.bincount(trial.order, minlength=count), 1))


def compared(before: Fitted, after: Fitted, record: Record, seed: int) -> tuple[HeldOutProof, HeldOutRun, HeldOutRun]:
    """Two fits let run over the held-out record, with the excess removed and its interval over cycles."""
    first = let_run(before, record)
    second = first if after is before else let_run(after, record)
    floor = floor_squares(second, seed)
    # Mean squares by cycle, weighted by windows: the floor is of the fit after, under whose noise both are judged.
    counts = np.bincount(first.order).astype(float)
    old = np.bincount(first.order, first.residual**2) / counts
    new = np.bincount(second.order, second.residual**2) / counts
    rows = np.column_stack([old, new, floor])
    removed, interval = 0.0, (0.0, 0.0)
    if before is not after:
        # The interval by resampling whole cycles (bootstrap, percentiles): windows of one cycle are not independent.
        removed = _removed(rows, counts)
        picks = np.random.default_rng(seed).integers(0, counts.size, size=(RESAMPLES, counts.size))
        low, high = np.quantile([_removed(rows[pick], counts[pick]) for pick in picks], [0.025, 0.975])
        interval = float(low), float(high)
    held = HeldOutProof(
        cycles=counts.size,
        rmse_before=float(np.sqrt(np.average(old, weights=counts))),
        rmse_after=float(np.sqrt(np.average(new, weights=counts))),
        noise_floor=float(np.sqrt(np.average(floor, weights=counts))),
        excess_removed=removed,
        ci95=interval,
        per_cycle=tuple((float(a), float(b), float(c)) for a, b, c in np.sqrt(rows)),
    )
    return held, first, second


def _removed(rows: Array, counts: Array) -> float:
    """1 - (after^2 - floor^2) / (before^2 - floor^2); where nothing stood out of the floor before, -1 to 1."""
    old, new, floor = np.average(rows, axis=0, weights=counts).tolist()
    least = max(TRIFLE * floor, 1e-12)
    removed = 1.0 - (new - floor) / max(old - floor, least)
    return float(removed if old - floor > least else np.clip(removed, -1.0, 1.0))
