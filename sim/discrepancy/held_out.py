"""Free runs over cycles that were never fitted: before and after, beside the error that is nobody's fault.

Each cycle starts at a temperature of its own, fitted to it; nothing else is. The floor that both are held against is
not theirs to choose (`gap.floor_of`).
"""

from dataclasses import dataclass

import numpy as np

from sim.discrepancy.diagnosis import HeldOutProof
from sim.discrepancy.fitting import CourseState, Fitted, Record, Whitener, at, grid_at, on
from sim.engine import linear_recursion
from sim.learning import Indices
from sim.sha import Array

RESAMPLES = 2000
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


def compared(
    before: Fitted, after: Fitted, record: Record, seed: int, floor: float
) -> tuple[HeldOutProof, HeldOutRun, HeldOutRun]:
    """Two fits let run over the held-out record, held against the `floor` (degC), with the excess removed.

    Where the error before is no greater than the floor there is no excess, and none of it can have been removed.
    """
    first = let_run(before, record)
    second = first if after is before else let_run(after, record)
    # Mean squares by cycle, weighted by windows.
    counts = np.bincount(first.order).astype(float)
    old = np.bincount(first.order, first.residual**2) / counts
    new = np.bincount(second.order, second.residual**2) / counts
    rows = np.column_stack([old, new])
    whole = _excesses(rows, counts, floor)
    removed, interval = None, None
    if before is not after and whole[0] > 0:
        removed = float(1.0 - whole[1] / whole[0])
        # The interval by resampling whole cycles (bootstrap, percentiles): windows of one cycle are not independent. A
        # sample without an excess has nothing that a name could have removed: it counts as 0.
        picks = np.random.default_rng(seed).integers(0, counts.size, size=(RESAMPLES, counts.size))
        drawn = np.array([_excesses(rows[pick], counts[pick], floor) for pick in picks])
        shares = np.where(drawn[:, 0] > 0, 1.0 - drawn[:, 1] / np.where(drawn[:, 0] > 0, drawn[:, 0], 1.0), 0.0)
        low, high = np.quantile(shares, [0.025, 0.975])
        interval = float(low), float(high)
    held = HeldOutProof(
        cycles=counts.size,
        rmse_before=float(np.sqrt(np.average(old, weights=counts))),
        rmse_after=float(np.sqrt(np.average(new, weights=counts))),
        noise_floor=floor,
        excess_removed=removed,
        ci95=interval,
        per_cycle=tuple((float(a), float(b), floor) for a, b in np.sqrt(rows)),
    )
    return held, first, second


def _excesses(rows: Array, counts: Array, floor: float) -> Array:
    """(2,) degC^2 by which the mean squares before and after exceed the floor's."""
    return np.asarray(np.average(rows, axis=0, weights=counts) - floor**2)
