"""Rare events by importance splitting: the way to the event is cut into levels, each of which is not rare.

Fixed effort (Garvels 2000; Rubino & Tuffin 2009, chapter 3): in each stage the same number of runs starts from states
drawn, with replacement, among those in which the previous level was first reached; the product of the stages' shares is
an unbiased estimate of the probability, whatever the levels. They lie on the running maximum (for `Temp <= c` minimum)
of the temperature, bridges included, and come from a pilot that takes no part in the estimate. The whole is repeated,
the repetitions being independent, and their mean has a Student interval corrected for their skewness (Hall 1992): a
product of shares is skewed to the right, and the plain interval lies too low too often.

Mode parameters of long stays are drawn where the event needs them (`sim.checking.smc.paths.tilting`),
and their weight w is given
back on the way: a run that reached level l is chosen in proportion to w^(a_l - a_{l-1}), a_l growing from 0 to 1 at the
event, and the share of a stage is the mean of these factors over all of its runs, 0 for those that did not reach the
level. That stays unbiased for fixed a_l (it is a Feynman-Kac particle scheme: Del Moral 2004, section 7.4). A greater m
makes the next level likelier and weighs less; with both at every level the runs keep the m that the event needs.
"""

from dataclasses import dataclass
from math import inf, sqrt

import numpy as np
from scipy.special import stdtrit

from sim.checking.query.tree import Always, Eventually
from sim.checking.smc.monitors.path import Watch
from sim.checking.smc.paths.plan import Engine
from sim.checking.smc.splitting.pilot import NoWay, Plan, Report, find_plan
from sim.checking.smc.splitting.stage import Way, begin, choose, goal_of, onward, stage
from sim.scores import Estimate
from sim.sha.trace import Array

__all__ = ["NoWay", "Split", "refusal", "split"]

LEAST_SKEWNESS = 1e-4

GOOD, MORE = 0.12, 4
"""A relative standard error above GOOD: all is done again with MORE times the runs, and the first part is dropped."""


@dataclass(frozen=True, slots=True)
class Split:
    """The estimate of a rare event: its mean over `repetitions` with a 95 % (`level`) interval, and the way to it.

    `levels` are (degC, the chance to reach it) each; `relative` is the standard error over the mean.
    """

    estimate: Estimate
    levels: tuple[tuple[float, float], ...]
    repetitions: int
    relative: float


def refusal(one: Watch) -> str:
    """Why this path has no levels on the temperature to split on; empty where it has."""
    if not isinstance(one.path, Eventually | Always):
        return "importance splitting answers <> and [] only"
    if not one.lines.lines:
        return "importance splitting needs a temperature in the formula: its levels lie on the way to it"
    if not one.lines.still or len({up for _, up in one.lines.watched}) != 1:
        return "importance splitting needs comparisons of the temperature with fixed numbers, all in one direction"
    return ""


def split(
    engine: Engine,
    one: Watch,
    rng: np.random.Generator,
    *,
    runs: int = 1000,
    repetitions: int = 40,
    confidence: float = 0.95,
    report: Report = lambda what, share: None,
) -> Split:
    """The probability that the path's formula comes true (for `[]`: that it is violated).

    `runs` start in each stage of each repetition. Raises ValueError as `refusal` says, and NoWay when the pilot does
    not come near the event.
    """
    reason = refusal(one)
    if reason:
        raise ValueError(reason)
    sign = 1.0 if next(iter(one.lines.watched))[1] else -1.0
    way = Way(engine, one.lines, one.path.span.low, min(one.path.span.high, one.bound), sign)
    with np.errstate(over="ignore", invalid="ignore"):  # a line at infinity is never reached
        return _split(way, rng, runs, repetitions, confidence, report)


def _split(way: Way, rng: np.random.Generator, runs: int, repetitions: int, confidence: float, report: Report) -> Split:
    plan = find_plan(way, rng, report)
    for size in (runs, MORE * runs):
        chances = _repeat(plan, size, repetitions, rng, report)
        mean, error = float(chances[-1].mean()), float(chances[-1].std(ddof=1)) / sqrt(repetitions)
        runs = size
        if error <= GOOD * mean:
            break
    low, high = skewed_interval(chances[-1], confidence)
    reached = zip(plan.levels, chances[:-1].mean(axis=1).tolist(), strict=True)
    return Split(
        Estimate(mean, low, high, runs * repetitions * len(chances)),
        tuple((way.sign * level, chance) for level, chance in reached),
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
    if abs(skewness) < LEAST_SKEWNESS:  # the cubic is the straight line then, and the quotient 0 / 0
        skewness = LEAST_SKEWNESS
    reach = float(stdtrit(values.size - 1, 0.5 + confidence / 2.0)) / root

    def place(x: float) -> float:
        bent = float(np.cbrt(1.0 + skewness * (x - skewness / (6.0 * values.size))))
        return mean - deviation * 3.0 / skewness * (bent - 1.0)

    return min(max(place(reach), 0.0), 1.0), min(max(place(-reach), 0.0), 1.0)


def _repeat(plan: Plan, runs: int, repetitions: int, rng: np.random.Generator, report: Report) -> Array:
    """(stages, repetitions) each repetition's estimate of the chance to reach each level; the last is the event.

    It is the mean factor of the stage's runs, 0 for those that do not come there, times those of the stages before.
    """
    way, levels = plan.way, plan.levels
    chances, before = np.zeros((len(levels) + 1, repetitions)), np.ones(repetitions)
    group = np.repeat(np.arange(repetitions), runs)
    entries = begin(way, group.size, rng)
    for number, (level, share) in enumerate(zip([*levels, inf], [*plan.shares, 1.0], strict=True)):
        report(f"level {number + 1} of {len(levels) + 1}", number / (len(levels) + 1))
        ended = stage(way, entries, [*levels[number:], goal_of(way)], level, rng)
        reached = ended.hit | (ended.peak >= level)
        owed, whole = way.owed(ended, share), way.owed(ended, 1.0)
        chances[number] = before * np.bincount(group[reached], np.exp(whole[reached]), minlength=repetitions) / runs
        before *= np.bincount(group[reached], np.exp(owed[reached]), minlength=repetitions) / runs
        living = np.flatnonzero(before > 0)
        if not living.size:
            break
        chosen = [choose(owed, np.flatnonzero(reached & (group == one)), runs, rng) for one in living.tolist()]
        entries, group = onward(way, ended, np.concatenate(chosen), share), np.repeat(living, runs)
    return chances
