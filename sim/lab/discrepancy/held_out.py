"""Free runs over cycles that were never fitted: before and after, beside the error that is nobody's fault.

One free run goes through each cycle, from the temperature that its first readings say; nothing else is fitted to it.
The floor that both are held against is not theirs to choose (`gap.noise_floor`).
"""

from dataclasses import dataclass, replace

import numpy as np

from sim.engine import linear_recursion
from sim.lab.discrepancy.diagnosis import HeldOutProof, NoiseFloor
from sim.lab.discrepancy.fitting import (
    LATE_TOGETHER,
    CourseState,
    Fitted,
    Record,
    Whitener,
    model_effects,
    move_frame,
    row_later,
    run_frame,
    window_grid,
    window_sensitivity,
)
from sim.lab.learning import Indices
from sim.sha import Array, Mask

RESAMPLES = 2000
START_ROUNDS = 3
"""Rounds in which the start temperatures are fitted (effects on the sensor make them slightly non-linear)."""
START_S, START_WINDOWS = 300.0, 2
"""Seconds of a cycle (or its first windows, where these take longer) whose readings say where its run begins."""
MIN_WINDOWS = 3
"""Windows of a cycle below which its start explains it: it proves nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOutRun:
    """A fit let run over a record cut by cycles.

    `state` is the free run from `start` (R,) degC, `residual` (m,) degC of its windows, in which what turns between two
    rows turns as far behind the later one as it did in the fitted cycles (`Fitted.behind`); `begun` (m,) is what one
    degree at a run's start is there, `early` (m,) which windows say where a run starts, `order` (m,) numbers the runs,
    `whitener` weighs by the fit's noise.
    """

    record: Record
    state: CourseState
    start: Array
    residual: Array
    begun: Array
    early: Mask
    order: Indices
    whitener: Whitener

    def restart_residual(self, residual: Array) -> Array:
        """(m,) or (m, c) residuals with each run begun where its own first readings say."""
        columns = residual if residual.ndim == 2 else residual[:, None]
        begun = np.where(self.early, self.begun, 0.0)[:, None]
        runs = np.flatnonzero(np.diff(self.order, prepend=-1) != 0)
        size = np.maximum(np.add.reduceat(begun**2, runs), 1e-12)
        start = np.add.reduceat(begun * columns, runs) / size
        return np.asarray(columns - self.begun[:, None] * start[self.order]).reshape(residual.shape)


def let_run(fitted: Fitted, record: Record) -> HeldOutRun:
    """The fit's parameters over another record, each run from the start that its first readings say."""
    frame = move_frame(fitted.frame, record)
    reading, first, times = record.reading, record.window_first, record.times
    order = np.cumsum(first) - 1
    number = np.arange(order.size) - np.flatnonzero(first)[order]
    early = (times - times[first][order] <= START_S) | (number < START_WINDOWS)
    start = reading[first]
    behind, unsure = fitted.behind
    state = run_frame(frame, fitted.state.parameters, start, fitted.state.named)
    residual = reading - record.window_means(state.mean + behind * row_later(frame, state))
    # Least squares in one unknown a run: the first residuals on `begun`, how a degree at the start dies away.
    for _ in range(START_ROUNDS):
        decay = np.where(record.runs.first, 0.0, np.exp(-(state.k + state.loss) * record.runs.dt))
        begun = record.window_means(linear_recursion(decay, record.runs.first.astype(float), 0.0))
        known = np.where(early, begun, 0.0)
        moved = np.bincount(order, known * residual) / np.maximum(np.bincount(order, known**2), 1e-12)
        start = start + moved
        state = run_frame(frame, fitted.state.parameters, start, fitted.state.named, state.course)
        residual = reading - record.window_means(state.mean + behind * row_later(frame, state))
        if np.max(np.abs(moved)) < 1e-3:
            break
    grid = window_grid(frame, state)
    whitener = Whitener(replace(grid, shared=unsure / LATE_TOGETHER * grid.shared), fitted.noise)
    return HeldOutRun(
        record=record,
        state=state,
        start=start,
        residual=residual,
        begun=begun,
        early=early,
        order=order,
        whitener=whitener,
    )


def foretold(fitted: Fitted, run: HeldOutRun, whitener: Whitener) -> float:
    """nats of the held-out record, but for a constant, as a fit foretells it: under the noise of `whitener`, the fit's
    parameters being as sure as the cycles that it was made of know them."""
    columns = run.restart_residual(window_sensitivity(move_frame(fitted.frame, run.record), run.state, run.start))
    gram = whitener.gram(np.column_stack([run.residual, columns]))
    # Woodbury: the residual's covariance is that of the noise and of what the parameters' errors do.
    root = np.linalg.cholesky(fitted.covariance)
    inner = np.eye(root.shape[0]) + root.T @ gram[1:, 1:] @ root
    known = root.T @ gram[1:, 0]
    misfit = float(gram[0, 0] - known @ np.linalg.solve(inner, known))
    return -0.5 * (misfit + float(np.linalg.slogdet(inner)[1]))


def given_model_run(fitted: Fitted) -> Fitted:
    """The model before any fit: its own numbers over the same record."""
    frame = fitted.frame
    named = model_effects(frame.record.model)
    point = np.concatenate([frame.centre, *(np.array(each.point) for each in named)])
    return replace(fitted, state=run_frame(frame, point, fitted.start, named))


def mean_squares(trial: HeldOutRun) -> tuple[Array, Array, Indices]:
    """(mean squares (c,) degC^2, windows (c,), cycles (c,)) of the cycles that are long enough to prove something."""
    cycles, place = np.unique(trial.record.window_whole, return_inverse=True)
    counts = np.bincount(place)
    squares = np.bincount(place, trial.residual**2) / counts
    enough = counts >= MIN_WINDOWS if (counts >= MIN_WINDOWS).any() else counts > 0
    return squares[enough], counts[enough].astype(float), cycles[enough]


def surely_nearer(one: HeldOutRun, other: HeldOutRun, seed: int) -> bool:
    """True where the first free run is nearer to the held-out cycles in 97.5 % of resamples of their pieces."""
    pieces = np.unique(one.record.window_cycle, return_inverse=True)[1]
    further = np.bincount(pieces, other.residual**2 - one.residual**2)
    picks = np.random.default_rng(seed).integers(0, further.size, size=(RESAMPLES, further.size))
    return bool(np.quantile(further[picks].sum(axis=1), 0.025) > 0)


@dataclass(frozen=True, slots=True)
class RunsBefore:
    """What runs over the held-out record before anything is added: the `refit`, and the model as it was `given`."""

    refit: HeldOutRun
    given: HeldOutRun


def reference_runs(fitted: Fitted, record: Record) -> RunsBefore:
    """The runs of a refit and of its model as given."""
    return RunsBefore(let_run(fitted, record), let_run(given_model_run(fitted), record))


def compare_fits(
    before: Fitted,
    after: Fitted,
    record: Record,
    seed: int,
    floor: NoiseFloor,
    *,
    runs: RunsBefore | None = None,
    second: HeldOutRun | None = None,
) -> tuple[HeldOutProof, HeldOutRun, HeldOutRun]:
    """Two fits let run over the held-out record, held against the floor, with the excess removed.

    Where the error before is no greater than the floor there is no excess, and none of it can have been removed; no
    more than all of it can be. `runs` are those of `before`, and `second` is that of `after`, where they are at hand.
    """
    runs = reference_runs(before, record) if runs is None else runs
    first, given = runs.refit, runs.given
    second = second or (first if after is before else let_run(after, record))
    old, counts, cycles = mean_squares(first)
    new, _, _ = mean_squares(second)
    # By the independent pieces of evidence: the cycles, or pieces of the long runs of a machine that runs on.
    kept = np.isin(record.window_whole, cycles)
    pieces = np.unique(record.window_cycle[kept], return_inverse=True)[1]
    rows = np.column_stack([np.bincount(pieces, trial.residual[kept] ** 2) for trial in (first, second)])
    weights = np.bincount(pieces).astype(float)
    allowed = np.bincount(pieces, floor.cycle_floors(record.window_whole[kept]) ** 2)
    whole = (rows - allowed[:, None]).sum(axis=0)
    removed, interval = None, None
    if before is not after and whole[0] > 0:
        removed = min(float(1.0 - whole[1] / whole[0]), 1.0)
        # The interval by resampling whole pieces (bootstrap, percentiles): windows of one are not independent. A
        # sample without an excess has nothing that a name could have removed: it counts as 0.
        picks = np.random.default_rng(seed).integers(0, weights.size, size=(RESAMPLES, weights.size))
        drawn = (rows - allowed[:, None])[picks].sum(axis=1)
        shares = np.where(drawn[:, 0] > 0, 1.0 - drawn[:, 1] / np.where(drawn[:, 0] > 0, drawn[:, 0], 1.0), 0.0)
        low, high = np.minimum(np.quantile(shares, [0.025, 0.975]), 1.0)
        interval = float(low), float(high)
    held = HeldOutProof(
        cycles=cycles.size,
        pieces=weights.size,
        rmse_given=float(np.sqrt(np.average(mean_squares(given)[0], weights=counts))),
        rmse_before=float(np.sqrt(np.average(old, weights=counts))),
        rmse_after=float(np.sqrt(np.average(new, weights=counts))),
        noise_floor=floor.error,
        excess_removed=removed,
        ci95=interval,
        per_cycle=tuple(
            (float(a), float(b), float(c))
            for a, b, c in zip(old**0.5, new**0.5, floor.cycle_floors(cycles), strict=True)
        ),
    )
    return held, first, second
