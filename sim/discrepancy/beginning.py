"""Where over the cycles a gap begins: a part that was exchanged, a summer, a fault. A change point, with its interval.

The evidence is one figure a cycle: the mean error of its free run while the machine runs, or while it rests. A gap that
grows steadily begins nowhere, and one that wanders has no beginning that could be dated.
"""

import numpy as np

from sim.discrepancy.diagnosis import GapBeginning
from sim.discrepancy.held_out import LEAST_WINDOWS, HeldOutRun
from sim.discrepancy.rules import DecisionRules
from sim.sha import Array

DRAWS = 10_000
"""Draws of normal errors that a beginning is held against."""
LIKELY = 3.84
"""The 95 % quantile of chi-square with one degree of freedom: 2 nats of the profile likelihood about the date."""


def beginning(trials: tuple[HeldOutRun, ...], least: float, rules: DecisionRules) -> GapBeginning | None:
    """The surest change point of the free runs' errors over all cycles, in order; None where none is sure.

    `least` (degC) is what a change must be to matter. The interval is that of the profile likelihood of the date.
    """
    found = [_of_phase(trials, running, least, rules) for running in (True, False)]
    known = [each for each in found if each is not None]
    return min(known, key=lambda each: (each.p, -abs(each.moves))) if known else None


def _of_phase(trials: tuple[HeldOutRun, ...], running: bool, least: float, rules: DecisionRules) -> GapBeginning | None:
    times, errors = _errors_by_cycle(trials, running)
    n, side = errors.size, rules.beginning_least_cycles
    if n < 2 * side:
        return None
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
    drawn = np.random.default_rng(0).standard_normal((DRAWS, n))
    shares = _split_gain(drawn, side).max(axis=-1) / np.sum((drawn - drawn.mean(axis=-1, keepdims=True)) ** 2, axis=-1)
    total = float(np.sum((errors - errors.mean()) ** 2))
    p = (1.0 + float(np.count_nonzero(shares >= float(gain[number]) / total))) / (1.0 + DRAWS)
    if p > rules.beginning_most_p:
        return None
    profile = n * np.log(np.maximum(total - gain, 1e-300) / max(total - float(gain[number]), 1e-300))
    likely = np.flatnonzero(profile <= LIKELY) + side
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


def _errors_by_cycle(trials: tuple[HeldOutRun, ...], running: bool) -> tuple[Array, Array]:
    """(start of each cycle s, its mean error degC in one phase), of the cycles that show it."""
    times, errors = [], []
    for trial in trials:
        record = trial.record
        on = record.windowed(record.running) > 0.5
        chosen = (on == running) & ~trial.early
        for cycle in np.unique(record.window_whole):
            rows = chosen & (record.window_whole == cycle)
            if np.count_nonzero(rows) >= LEAST_WINDOWS:
                times.append(float(record.runs.time[record.whole == cycle][0]))
                errors.append(float(np.mean(trial.residual[rows])))
    return np.array(times), np.array(errors)


def _split_gain(errors: Array, side: int) -> Array:
    """(..., n - 2 side + 1) by how much two means leave less of the squares than one, for each place of a cut."""
    n = errors.shape[-1]
    count = np.arange(1, n + 1)
    sums = np.cumsum(errors, axis=-1)
    whole = sums[..., -1:]
    gain = sums**2 / count + (whole - sums) ** 2 / np.maximum(n - count, 1) - whole**2 / n
    return np.asarray(gain[..., side - 1 : n - side])
