"""Rare events by importance splitting: the way to the event is cut into levels, each of which is not rare.

Fixed effort (Garvels 2000; Rubino & Tuffin 2009, chapter 3): in each stage the same number of runs starts from states
drawn, with replacement, among those in which the previous level was first reached; the product of the stages' shares is
an unbiased estimate of the probability, whatever the levels. They lie on the running maximum (for `Temp <= c` minimum)
of the temperature, bridges included, and come from a pilot that takes no part in the estimate. The whole is repeated,
the repetitions being independent, and their mean has a Student interval corrected for their skewness (Hall 1992): a
product of shares is skewed to the right, and the plain interval lies too low too often.

Mode parameters of long stays are drawn where the event needs them (`smc.paths.tilting`), and their weight
w is given back on the way: a run that reached level l is chosen in proportion to w^(a_l - a_{l-1}), a_l growing from 0
to 1 at the event, and the share of a stage is the mean of these factors over all of its runs, 0 for those that did not
reach the level. That stays unbiased for fixed a_l (it is a Feynman-Kac particle scheme: Del Moral 2004, section 7.4).
A greater m makes the next level likelier and weighs less; with both at every level the runs keep the m that the event
needs.
"""

from dataclasses import dataclass
from math import inf, sqrt

import numpy as np
import scipy

from sim.lab.checking.query import Always, Eventually
from sim.lab.checking.smc.monitors import PreparedPath
from sim.lab.checking.smc.paths import Engine
from sim.lab.checking.smc.rules import Progress
from sim.lab.checking.smc.splitting.pilot import SplittingPlan, find_plan
from sim.lab.checking.smc.splitting.stage import RareEvent, begin, nearest_line, resample, select_runs, stage
from sim.scores import Estimate
from sim.sha import Array

MIN_SKEWNESS = 1e-4

GOOD, MORE = 0.12, 4
"""A relative standard error above GOOD: all is done again with MORE times the runs, and the first part is dropped."""


@dataclass(frozen=True, slots=True)
class SplitEstimate:
    """The estimate of a rare event: its mean over `repetitions` with its interval, and the levels on the way to it.

    `levels` are (degC, the chance to reach it) each; `relative` is the standard error over the mean.
    """

    estimate: Estimate
    levels: tuple[tuple[float, float], ...]
    repetitions: int
    relative: float


def refusal(prepared: PreparedPath) -> str:
    """Why this path has no levels on the temperature to split on; empty where it has."""
    if not isinstance(prepared.path, Eventually | Always):
        return "importance splitting answers <> and [] only"
    if not prepared.compiled.lines:
        return "importance splitting needs a temperature in the formula: its levels lie on the way to it"
    if not prepared.compiled.still or len({up for _, up in prepared.compiled.watched}) != 1:
        return "importance splitting needs comparisons of the temperature with fixed numbers, all in one direction"
    return ""


def split_estimate(
    engine: Engine,
    prepared: PreparedPath,
    rng: np.random.Generator,
    *,
    runs: int = 1000,
    repetitions: int = 40,
    confidence: float = 0.95,
    report: Progress = lambda what, share: None,
) -> SplitEstimate:
    """The probability that the path's formula comes true (for `[]`: that it is violated).

    `runs` start in each stage of each repetition. Raises ValueError as `refusal` says, and PilotFailed when the pilot
    does not come near the event.
    """
    reason = refusal(prepared)
    if reason:
        raise ValueError(reason)
    span = prepared.path.span
    event = RareEvent(
        engine=engine,
        compiled=prepared.compiled,
        low=span.low,
        high=min(span.high, prepared.bound),
        sign=1.0 if prepared.compiled.watched[0][1] else -1.0,
    )
    with np.errstate(over="ignore", invalid="ignore"):  # a line at infinity is never reached
        plan = find_plan(event, rng, report)
        # A second round draws all anew, and the first is dropped: that it was repeated depends on what it drew.
        for size in (runs, MORE * runs):
            chances = _repeat(plan, size, repetitions, rng, report)
            mean, error = float(chances[-1].mean()), float(chances[-1].std(ddof=1)) / sqrt(repetitions)
            if error <= GOOD * mean:
                break
        low, high = skewed_interval(chances[-1], confidence)
    reached = zip(plan.levels, chances[:-1].mean(axis=1).tolist(), strict=True)
    return SplitEstimate(
        Estimate(mean, low, high, size * repetitions * len(chances)),
        tuple((event.sign * level, chance) for level, chance in reached),
        repetitions,
        error / mean if mean > 0 else inf,
    )


def skewed_interval(values: Array, confidence: float) -> tuple[float, float]:
    """An interval for the mean of independent values that may be skewed; [0, 1] where all are 0.

    Student's t for a cubic of the studentised mean that takes the skewness out (Hall 1992, J. R. Stat. Soc. B 54, 221).
    """
    mean, deviation, root = float(values.mean()), float(values.std(ddof=1)), sqrt(values.size)
    if deviation == 0.0:
        return (mean, mean) if mean > 0.0 else (0.0, 1.0)
    skewness = float(np.mean((values - mean) ** 3) / values.std() ** 3)
    if abs(skewness) < MIN_SKEWNESS:  # the cubic is the straight line then, and the quotient 0 / 0
        skewness = MIN_SKEWNESS
    # The cubic in the studentised mean has one real root, in closed form: the cube root in `place`.
    reach = float(scipy.special.stdtrit(values.size - 1, 0.5 + confidence / 2.0)) / root

    def place(x: float) -> float:
        bent = float(np.cbrt(1.0 + skewness * (x - skewness / (6.0 * values.size))))
        return mean - deviation * 3.0 / skewness * (bent - 1.0)

    return min(max(place(reach), 0.0), 1.0), min(max(place(-reach), 0.0), 1.0)


def _repeat(plan: SplittingPlan, runs: int, repetitions: int, rng: np.random.Generator, report: Progress) -> Array:
    """(stages, repetitions) each repetition's estimate of the chance to reach each level; the last is the event.

    It is the mean factor of the stage's runs, 0 for those that do not come there, times those of the stages before.
    """
    event, levels = plan.event, plan.levels
    chances, before = np.zeros((len(levels) + 1, repetitions)), np.ones(repetitions)
    group = np.repeat(np.arange(repetitions), runs)
    entries = begin(event, group.size, rng)
    for number, (level, share) in enumerate(zip([*levels, inf], [*plan.shares, 1.0], strict=True)):
        report(f"level {number + 1} of {len(levels) + 1}", number / (len(levels) + 1))
        ended = stage(event, entries, [*levels[number:], nearest_line(event)], level, rng)
        reached = ended.hit | (ended.peak >= level)
        outstanding, whole = event.outstanding(ended, share), event.outstanding(ended, 1.0)
        chances[number] = before * np.bincount(group[reached], np.exp(whole[reached]), minlength=repetitions) / runs
        before *= np.bincount(group[reached], np.exp(outstanding[reached]), minlength=repetitions) / runs
        living = np.flatnonzero(before > 0)
        if not living.size:
            break
        # Within each repetition: mixing them would make their estimates dependent, and the interval too narrow.
        chosen = [
            resample(outstanding, np.flatnonzero(reached & (group == repetition)), runs, rng)
            for repetition in living.tolist()
        ]
        entries, group = select_runs(event, ended, np.concatenate(chosen), share), np.repeat(living, runs)
    return chances
