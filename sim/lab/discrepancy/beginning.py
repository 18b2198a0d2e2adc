"""Where over the cycles a gap begins: a part that was exchanged, a summer, a fault. A change point, with its interval.

The evidence is one figure a cycle: the mean error of its free run while the machine runs, or while it rests. Of a
machine that runs on there are too few cycles for that, and the figures are those of the pieces of its long runs. A gap
that grows steadily begins nowhere, and one that wanders has no beginning that could be dated.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from sim.lab.discrepancy.diagnosis import GapBeginning
from sim.lab.discrepancy.held_out import MIN_WINDOWS, HeldOutRun
from sim.lab.discrepancy.rules import DecisionRules
from sim.lab.learning import Indices
from sim.sha import Array

DRAWS, DRAWN_AT_ONCE = 10_000, 500
"""Draws of normal errors that a beginning is held against, and how many are in memory at a time."""
CHI_SQUARE_95 = 3.84
"""The 95 % quantile of chi-square with one degree of freedom: 2 nats of the profile likelihood about the date."""


def beginning(trials: tuple[HeldOutRun, ...], least: float, rules: DecisionRules) -> GapBeginning | None:
    """The surest change point of the free runs' errors over all cycles, in order; None where none is sure.

    `least` (degC) is what a change must be to matter. The interval is that of the profile likelihood of the date.
    Where too few cycles show a phase for both sides of it, it is looked for over the record's pieces of long runs.
    """
    found = [_of_phase(trials, running, least, rules) for running in (True, False)]
    known = [each for each in found if each is not None]
    return min(known, key=lambda each: (each.p, -abs(each.moves))) if known else None


@dataclass(frozen=True, slots=True)
class _PhaseErrors:
    """Mean errors (n,) degC in one phase, with the starts (n,) s of what they are of, and the number (n,) of the trial:
    cycles, or where `stretch` is not 0, stretches of so many seconds."""

    times: Array
    errors: Array
    of_trial: Indices
    stretch: float


def _of_phase(trials: tuple[HeldOutRun, ...], running: bool, least: float, rules: DecisionRules) -> GapBeginning | None:
    phase = _phase_errors(trials, running, rules.beginning_least_cycles)
    if phase.errors.size < 2 * rules.beginning_least_cycles:
        return None
    return (_jump if phase.stretch else _step)(phase, running, least, rules)


def _step(phase: _PhaseErrors, running: bool, least: float, rules: DecisionRules) -> GapBeginning | None:
    """The cycle from which on the mean error is another one."""
    times, errors, n, side = phase.times, phase.errors, phase.errors.size, rules.beginning_least_cycles
    gain = _split_gain(errors, side)
    number = int(np.argmax(gain))
    before = side + number
    step = np.where(np.arange(n) >= before, errors[before:].mean(), errors[:before].mean())
    moves = float(errors[before:].mean() - errors[:before].mean())
    left = errors - step
    line = np.polynomial.polynomial.polyfit(np.arange(n), errors, 1)
    of_line = errors - np.polynomial.polynomial.polyval(np.arange(n), line)
    size = max(float(np.sum(left**2)), 1e-300)
    wanders = float(left[1:] @ left[:-1]) / size >= rules.beginning_wanders_from
    if abs(moves) < least or size >= float(np.sum(of_line**2)) or wanders:
        return None
    # Under "nothing begins" the share of the squares that the best cut takes depends on the number of cycles alone.
    shares = _draw(lambda drawn: _split_gain(drawn, side).max(axis=-1) / (n * drawn.var(axis=-1)), n)
    total = float(np.sum((errors - errors.mean()) ** 2))
    p = (1.0 + float(np.count_nonzero(shares >= float(gain[number]) / total))) / (1.0 + DRAWS)
    if p > rules.beginning_most_p:
        return None
    profile = n * np.log(np.maximum(total - gain, 1e-300) / max(total - float(gain[number]), 1e-300))
    likely = np.flatnonzero(profile <= CHI_SQUARE_95) + side
    # What begins with a cycle may have begun at any time since the cycle before it did.
    return GapBeginning(
        time=float(times[before]),
        interval=(float(times[likely[0] - 1]), float(times[likely[-1]])),
        before=before,
        after=n - before,
        moves=moves,
        running=running,
        p=p,
    )


def _jump(phase: _PhaseErrors, running: bool, least: float, rules: DecisionRules) -> GapBeginning | None:
    """The first change from one neighbourhood to the next that stands out of how the error of a long run wanders.

    A model that is not quite right errs by more and less as the run goes on; a random walk, which wanders most, has
    such a change anywhere in one case of a thousand.
    """
    errors, n, side = phase.errors, phase.errors.size, rules.beginning_least_cycles
    # A free run over held-out cycles begins anew: what changes there is not the machine.
    apart = np.abs(phase.of_trial[2 * side - 1 :] - phase.of_trial[: n - 2 * side + 1]) > 0
    changes = _local_changes(errors, side)
    chance = _draw(lambda drawn: _greatest_share(_local_changes(np.cumsum(drawn, axis=-1), side)), n)
    sizes = np.abs(changes) / max(float(np.median(np.abs(changes))), 1e-300)
    sizes = np.where(apart, 0.0, sizes)
    greatest = scipy.ndimage.maximum_filter1d(sizes, 2 * side + 1) == sizes
    sure = greatest & (sizes > np.quantile(chance, 1.0 - rules.beginning_most_p)) & (np.abs(changes) >= least)
    places = (np.flatnonzero(sure) + side).tolist()
    if not places:
        return None
    first, before = places[0], float(errors[places[0] - side : places[0]].mean())
    then = None
    if len(places) > 1:
        then = float(phase.times[places[1]]), float(errors[places[1] : places[1] + side].mean()) - before
    return GapBeginning(
        time=float(phase.times[first]),
        interval=(float(phase.times[first - 1]), float(phase.times[first + 1])),
        before=first,
        after=n - first,
        moves=float(changes[first - side]),
        running=running,
        p=(1.0 + float(np.count_nonzero(chance >= sizes[first - side]))) / (1.0 + DRAWS),
        stretch=phase.stretch,
        then=then,
    )


def _draw(statistic: Callable[[Array], Array], n: int) -> Array:
    """(DRAWS,) a statistic of each row of n normal errors."""
    rng = np.random.default_rng(0)
    return np.concatenate([statistic(rng.standard_normal((DRAWN_AT_ONCE, n))) for _ in range(DRAWS // DRAWN_AT_ONCE)])


def _greatest_share(changes: Array) -> Array:
    """(d,) the size of the greatest of the changes (d, c), over the usual one."""
    sizes = np.abs(changes)
    return np.asarray(sizes.max(axis=-1) / np.median(sizes, axis=-1))


def _local_changes(errors: Array, side: int) -> Array:
    """(..., n - 2 side + 1) the mean of the next side errors less that of the side before."""
    means = np.lib.stride_tricks.sliding_window_view(errors, side, axis=-1).mean(axis=-1)
    return np.asarray(means[..., side:] - means[..., :-side])


def _phase_errors(trials: tuple[HeldOutRun, ...], running: bool, side: int) -> _PhaseErrors:
    """The mean error of each cycle that shows the phase; of each piece of the long runs, where these are too few."""
    cycles = _mean_errors(trials, [(trial.record.whole, trial.record.window_whole) for trial in trials], running)
    if cycles.errors.size >= 2 * side:
        return replace(cycles, stretch=0.0)
    pieces = _mean_errors(trials, [(trial.record.cycle, trial.record.window_cycle) for trial in trials], running)
    return pieces if pieces.errors.size > cycles.errors.size else replace(cycles, stretch=0.0)


def _mean_errors(
    trials: tuple[HeldOutRun, ...], parts: Sequence[tuple[Indices, Indices]], running: bool
) -> _PhaseErrors:
    """The mean error of each part that shows the phase; `parts` numbers the knots and the windows of each trial."""
    rows = []
    for number, (trial, (of_knots, of_windows)) in enumerate(zip(trials, parts, strict=True)):
        record = trial.record
        on = record.window_means(record.running) > 0.5
        chosen = (on == running) & ~trial.early
        for part in np.unique(of_windows):
            windows = chosen & (of_windows == part)
            if np.count_nonzero(windows) >= MIN_WINDOWS:
                knots = record.runs.time[of_knots == part]
                rows.append((knots[0], np.mean(trial.residual[windows]), number, np.ptp(knots)))
    times, errors, of_trial, seconds = np.array(rows, dtype=float).reshape(-1, 4).T
    return _PhaseErrors(times, errors, of_trial.astype(np.intp), float(np.median(seconds)) if seconds.size else 0.0)


def _split_gain(errors: Array, side: int) -> Array:
    """(..., n - 2 side + 1) by how much two means leave less of the squares than one, for each place of a cut."""
    n = errors.shape[-1]
    count = np.arange(1, n + 1)
    sums = np.cumsum(errors, axis=-1)
    whole = sums[..., -1:]
    gain = sums**2 / count + (whole - sums) ** 2 / np.maximum(n - count, 1) - whole**2 / n
    return np.asarray(gain[..., side - 1 : n - side])
