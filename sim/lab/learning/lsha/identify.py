"""The model-identification query: which flow fits the segments of a location best.

Every segment is fitted by each flow with its start temperature and parameter free. Two flows are compared segment by
segment, by the log of their residual squares: a paired t-test over the location's segments. The flow that was chosen
for all locations is the default; another one takes its place only where it fits better at alpha / (number of queries).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt

import numpy as np
import scipy

from sim.lab.learning import RATE_PARAMETERS, FreeRuns, Indices
from sim.lab.learning.lsha.segments import Motion, stay_fits
from sim.sha import Array, Flow, coefficients

TAUS, ROUGH = (1.0, 1e5), 16
"""Time constants (s) between which a rate is looked for, and half the number of the first ones tried."""
MIN_READINGS = 4
"""Readings of a segment that can tell flows apart: two unknowns, and two more."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Identified:
    """The answer for one location: the `kind` that fits best, against the `default` one.

    `segments` could be compared; `gain` is the mean gain in log-likelihood per segment, `p` its one-sided p-value
    before the correction for `queries` of them. `kept` says that the default stays.
    """

    location: int
    default: str
    kind: str
    segments: int
    gain: float
    p: float
    queries: int
    kept: bool


def identify(
    runs: FreeRuns,
    size: int,
    *,
    default: str,
    motion: Motion,
    alternatives: Mapping[str, Flow],
    alpha: float,
    n_min: int,
) -> tuple[Identified, ...]:
    """The answers for the locations 0..size-1 that have `n_min` segments of four readings or more."""
    own, count, place = _log_squares(runs, motion)
    rivals = {kind: _log_squares(runs, _uniform(runs, flow))[0] for kind, flow in sorted(alternatives.items())}
    locations = [
        number for number in range(size) if np.count_nonzero((place == number) & (count >= MIN_READINGS)) >= n_min
    ]
    queries = max(len(locations) * len(rivals), 1)
    answers = []
    for number in locations:
        rows = (place == number) & (count >= MIN_READINGS)
        # A segment's log-likelihood with a noise of its own is -count/2 times the log of its mean squared residual.
        p, gain, kind = min(
            _compare_gains(0.5 * count[rows] * (own[rows] - logs[rows]), kind) for kind, logs in rivals.items()
        )
        # Bonferroni over all locations and rivals: the default is only given up where chance hardly explains it.
        kept = p >= alpha / queries
        answers.append(
            Identified(
                location=number,
                default=default,
                kind=default if kept else kind,
                segments=int(rows.sum()),
                gain=-gain,
                p=p,
                queries=queries,
                kept=kept,
            )
        )
    return tuple(answers)


def rate_alone(runs: FreeRuns, kind: str) -> float:
    """The rate (k in 1/s, t0, tau in s) by which the segments fit best, each with a start and a parameter of its own.

    Nothing is assumed of which segments belong together; slow flows hardly show their rate inside a segment.
    """
    taus = np.geomspace(*TAUS, 2 * ROUGH)
    # A grid over all time constants, then ever finer ones about its best point, until the points beside that are within
    # 3 % of each other.
    while True:
        losses: list[float] = []
        for tau in taus:
            motion = _uniform(runs, Flow(kind, {RATE_PARAMETERS[kind]: _rate(kind, tau), "noise": 0.0}))
            logs, count, _ = _log_squares(runs, motion)
            losses.append(float(0.5 * count @ logs))
        best = int(np.argmin(losses))
        low, high = taus[max(best - 1, 0)], taus[min(best + 1, taus.size - 1)]
        if high < 1.03 * low:
            return _rate(kind, float(taus[best]))
        taus = np.geomspace(low, high, ROUGH // 2)


def _rate(kind: str, tau: float) -> float:
    return 1.0 / tau if RATE_PARAMETERS[kind] == "k" else tau


def _compare_gains(gain: Array, kind: str) -> tuple[float, float, str]:
    """(one-sided p, minus the mean gain, kind) of paired gains in log-likelihood, each clipped to 10."""
    clipped = np.clip(gain, -10.0, 10.0)
    mean, error = float(clipped.mean()), float(clipped.std(ddof=1)) / sqrt(clipped.size)
    if error == 0:
        return (0.0 if mean > 0 else 1.0), -mean, kind
    return float(scipy.special.stdtr(clipped.size - 1, -mean / error)), -mean, kind


def _uniform(runs: FreeRuns, flow: Flow) -> Motion:
    decay, pull, _ = coefficients(flow, runs.age, runs.dt)
    return Motion(decay, pull, np.zeros(len(runs)))


def _log_squares(runs: FreeRuns, motion: Motion) -> tuple[Array, Array, Indices]:
    """(log of the mean squared residual, readings, place) of every stay; squares below 1e-9 of all are that."""
    _, _, squares, count, begin = stay_fits(runs, motion)
    mean = squares / np.maximum(count, 1.0)
    usual = float(np.median(mean[count >= MIN_READINGS])) if np.any(count >= MIN_READINGS) else 1.0
    return np.log(np.maximum(mean, 1e-3 * usual + 1e-12)), count, runs.place[begin]
