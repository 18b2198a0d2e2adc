"""Where over the cycles a gap begins: a part that was exchanged, a summer, a fault. A change point, with its interval.

The evidence is one figure a cycle: the mean error of its free run while the machine runs, or while it rests. Of a
machine that runs on there are too few cycles for that, and the figures are those of the pieces of its long runs. A gap
that grows steadily begins nowhere, and one that wanders has no beginning that could be dated.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from sim.discrepancy.diagnosis import GapBeginning
from sim.discrepancy.held_out import LEAST_WINDOWS, HeldOutRun
from sim.learning import Indices
from sim.sha import Array

LEAST_SIDE = 3
"""Cycles before and after a beginning at least."""
LEAST_P, DRAWS = 0.001, 10_000
"""The p of a beginning among draws of as many normal errors: it is looked for at all cycles and in two phases.
Permutations would do without the normal law, but of fifteen cycles there are too few ways to take the last four."""
WANDERS = 0.5
"""Correlation of neighbouring cycles, once the step is taken out, from which the error wanders."""
LIKELY = 3.84
"""The 95 % quantile of chi-square with one degree of freedom: 2 nats of the profile likelihood about the date."""


def beginning(trials: tuple[HeldOutRun, ...], least: float) -> GapBeginning | None:
    """The surest change point of the free runs' errors over all cycles, in order; None where none is sure.

    `least` (degC) is what a change must be to matter. The interval is that of the profile likelihood of the date.
    Where fewer than 2 LEAST_SIDE cycles show a phase, it is looked for over the record's pieces of long runs.
    """
    found = [_of_phase(trials, running, least) for running in (True, False)]
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


def _of_phase(trials: tuple[HeldOutRun, ...], running: bool, least: float) -> GapBeginning | None:
    phase = _errors_of(trials, running)
    if phase.errors.size < 2 * LEAST_SIDE:
        return None
    return _jump(phase, running, least) if phase.stretch else _step(phase, running, least)


def _step(phase: _PhaseErrors, running: bool, least: float) -> GapBeginning | None:
    """The cycle from which on the mean error is another one."""
    times, errors, n = phase.times, phase.errors, phase.errors.size
    gain = _split_gain(errors)
    number = int(np.argmax(gain))
    before = LEAST_SIDE + number
    step = np.where(np.arange(n) >= before, errors[before:].mean(), errors[:before].mean())
    moves = float(errors[before:].mean() - errors[:before].mean())
    left = errors - step
    line = np.polynomial.polynomial.polyfit(np.arange(n), errors, 1)
    of_line = errors - np.polynomial.polynomial.polyval(np.arange(n), line)
    size = max(float(np.sum(left**2)), 1e-300)
    if abs(moves) < least or size >= float(np.sum(of_line**2)) or float(left[1:] @ left[:-1]) / size >= WANDERS:
        return None
    # Under "nothing begins" the share of the squares that the best cut takes depends on the number of cycles alone.
    drawn = np.random.default_rng(0).standard_normal((DRAWS, n))
    shares = _split_gain(drawn).max(axis=-1) / np.sum((drawn - drawn.mean(axis=-1, keepdims=True)) ** 2, axis=-1)
    total = float(np.sum((errors - errors.mean()) ** 2))
    p = (1.0 + float(np.count_nonzero(shares >= float(gain[number]) / total))) / (1.0 + DRAWS)
    if p > LEAST_P:
        return None
    profile = n * np.log(np.maximum(total - gain, 1e-300) / max(total - float(gain[number]), 1e-300))
    likely = np.flatnonzero(profile <= LIKELY) + LEAST_SIDE
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


def _jump(phase: _PhaseErrors, running: bool, least: float) -> GapBeginning | None:
    """The first change from one neighbourhood to the next that stands out of how the error of a long run wanders.

    A model that is not quite right errs by more and less as the run goes on; a random walk, which wanders most, has
    such a change anywhere in one case of a thousand.
    """
    errors, n = phase.errors, phase.errors.size
    # A free run over held-out cycles begins anew: what changes there is not the machine.
    apart = np.abs(phase.of_trial[2 * LEAST_SIDE - 1 :] - phase.of_trial[: n - 2 * LEAST_SIDE + 1]) > 0
    changes = _local_changes(errors)
    walks = np.abs(_local_changes(np.cumsum(np.random.default_rng(0).standard_normal((DRAWS, n)), axis=-1)))
    chance = walks.max(axis=-1) / np.median(walks, axis=-1)
    sizes = np.abs(changes) / max(float(np.median(np.abs(changes))), 1e-300)
    sizes = np.where(apart, 0.0, sizes)
    greatest = scipy.ndimage.maximum_filter1d(sizes, 2 * LEAST_SIDE + 1) == sizes
    sure = greatest & (sizes > np.quantile(chance, 1.0 - LEAST_P)) & (np.abs(changes) >= least)
    places = (np.flatnonzero(sure) + LEAST_SIDE).tolist()
    if not places:
        return None
    first, before = places[0], float(errors[places[0] - LEAST_SIDE : places[0]].mean())
    then = None
    if len(places) > 1:
        then = float(phase.times[places[1]]), float(errors[places[1] : places[1] + LEAST_SIDE].mean()) - before
    return GapBeginning(
        time=float(phase.times[first]),
        interval=(float(phase.times[first - 1]), float(phase.times[first + 1])),
        before=first,
        after=n - first,
        moves=float(changes[first - LEAST_SIDE]),
        running=running,
        p=(1.0 + float(np.count_nonzero(chance >= sizes[first - LEAST_SIDE]))) / (1.0 + DRAWS),
        stretch=phase.stretch,
        then=then,
    )


def _local_changes(errors: Array) -> Array:
    """(..., n - 2 LEAST_SIDE + 1) the mean of the next LEAST_SIDE errors less that of the LEAST_SIDE before."""
    means = np.lib.stride_tricks.sliding_window_view(errors, LEAST_SIDE, axis=-1).mean(axis=-1)
    return np.asarray(means[..., LEAST_SIDE:] - means[..., :-LEAST_SIDE])


def _errors_of(trials: tuple[HeldOutRun, ...], running: bool) -> _PhaseErrors:
    """The mean error of each cycle that shows the phase; of each piece of the long runs, where these are too few."""
    cycles = _mean_errors(trials, [(trial.record.whole, trial.record.window_whole) for trial in trials], running)
    if cycles.errors.size >= 2 * LEAST_SIDE:
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
        on = record.windowed(record.running) > 0.5
        chosen = (on == running) & ~trial.early
        for part in np.unique(of_windows):
            windows = chosen & (of_windows == part)
            if np.count_nonzero(windows) >= LEAST_WINDOWS:
                knots = record.runs.time[of_knots == part]
                rows.append((knots[0], np.mean(trial.residual[windows]), number, np.ptp(knots)))
    times, errors, of_trial, seconds = np.array(rows, dtype=float).reshape(-1, 4).T
    return _PhaseErrors(times, errors, of_trial.astype(np.intp), float(np.median(seconds)) if seconds.size else 0.0)


def _split_gain(errors: Array) -> Array:
    """(..., n - 2 LEAST_SIDE + 1) by how much two means leave less of the squares than one, for each place of a cut."""
    n = errors.shape[-1]
    count = np.arange(1, n + 1)
    sums = np.cumsum(errors, axis=-1)
    whole = sums[..., -1:]
    gain = sums**2 / count + (whole - sums) ** 2 / np.maximum(n - count, 1) - whole**2 / n
    return np.asarray(gain[..., LEAST_SIDE - 1 : n - LEAST_SIDE])
