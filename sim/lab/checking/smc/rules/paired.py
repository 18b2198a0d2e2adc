"""Which of two probabilities is greater? Decided on pairs of runs that share their random numbers.

Only discordant pairs, in which one run succeeds and the other does not, say which is greater (McNemar 1947). Among them
the left one succeeds with a probability q, above 1/2 exactly when the left probability is the greater; and the share r
of discordant pairs turns q into the difference of the two: r (2q - 1). Both q and r are followed by the anytime-valid
interval of `estimation.mixture_interval`, each at half the error rate, so that everything said at the stop is right
together with a probability of at least `level`. Common random numbers make r small, and the answer comes sooner.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from sim.lab.checking.smc.rules.estimation import (
    BATCH_RUNS,
    MAX_RUNS,
    Progress,
    check_outcomes,
    mixture_interval,
    show_progress,
)
from sim.scores import Estimate
from sim.sha import Array, Mask

DrawPairs = Callable[[int], tuple[Array, Array]]
"""n -> the outcomes of the next n pairs of runs, left and right, each (n,) of 0.0 and 1.0."""

Order = Literal["greater", "smaller", "equal", "not decided"]
RULE = "discordant pairs by betting (beta mixture), valid at any time"

_FIRST_LOOK, _LOOK = 50, 1.05
"""After how many pairs it is first looked whether the two are equal, and how many times more each time after that."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PairedOutcome:
    """How the left probability compares with the right one, and all that was seen, at one joint `level`.

    `answer` "equal" says that they differ by no more than `delta`. `difference` is left - right, with the interval
    `low`..`high`; `left` and `right` are the two estimates, each with an anytime-valid interval at `level` of its own.
    """

    rule: str
    level: float
    delta: float
    answer: Order
    difference: float
    low: float
    high: float
    left: Estimate
    right: Estimate
    discordant: int

    @property
    def holds(self) -> bool | None:
        """Whether left >= right, up to `delta`; None where it was not decided."""
        return None if self.answer == "not decided" else self.answer != "smaller"


@dataclass(frozen=True, slots=True)
class _PairCounts:
    """Pairs so far, the successes of each side, and in how many pairs one succeeded alone."""

    runs: int = 0
    left: int = 0
    right: int = 0
    left_alone: int = 0
    right_alone: int = 0

    def plus(self, left: Array, right: Array) -> "_PairCounts":
        """The count with these pairs added."""
        return _PairCounts(
            self.runs + left.size,
            self.left + int(left.sum()),
            self.right + int(right.sum()),
            self.left_alone + int((left > right).sum()),
            self.right_alone + int((right > left).sum()),
        )


def compare(
    draw: DrawPairs,
    delta: float = 0.01,
    level: float = 0.95,
    *,
    most: int = MAX_RUNS,
    batch: int = BATCH_RUNS,
    progress: Progress | None = None,
) -> PairedOutcome:
    """Pairs until one probability is the greater, or the two are within `delta`; at most `most` pairs.

    Greater and smaller are looked at after every pair, equality each time there are 5 % more of them. A wrong answer of
    any kind has a probability of at most 1 - level. Raises ValueError for outcomes other than 0 and 1, and unless
    0 < delta < 1 and 0 < level < 1.
    """
    if not 0.0 < delta < 1.0 or not 0.0 < level < 1.0 or most < 1:
        raise ValueError(
            f"no comparison to +-{delta} at level {level} in {most} pairs; use such as 0.01, 0.95, 1000000"
        )
    count, look = _PairCounts(), _FIRST_LOOK
    while count.runs < most:
        runs = min(batch, most - count.runs)
        left, right = (check_outcomes(side, runs) for side in draw(runs))
        if np.any((left % 1.0) + (right % 1.0)):
            raise ValueError("a comparison needs outcomes of 0 and 1; weights cannot be paired")
        while left.size:
            # Up to the next look at equality; after each of these pairs one side may be known to be the greater.
            part = look - count.runs
            wins = count.left_alone + np.cumsum(left[:part] > right[:part])
            alone = wins + count.right_alone + np.cumsum(right[:part] > left[:part])
            sided = np.flatnonzero(_rejects_fair_coin(wins, alone, level))
            if sided.size:
                stop = int(sided[0]) + 1
                return _outcome(count.plus(left[:stop], right[:stop]), delta, level)
            count = count.plus(left[:part], right[:part])
            left, right = left[part:], right[part:]
            if count.runs == look:
                look = int(look * _LOOK)
                if _is_equal(count, delta, level):
                    return _outcome(count, delta, level)
        show_progress(progress, count.runs, most)
    return _outcome(count, delta, level)


def _rejects_fair_coin(wins: NDArray[np.int_], alone: NDArray[np.int_], level: float) -> Mask:
    """Whether a fair coin is outside the interval of q: the gambler against it is 2 / (1 - level) times richer."""
    # The wealth of `estimation.mixture_interval` at p = 1/2, in logarithms, where p^s (1-p)^(n-s) is 2^-n.
    wealth = scipy.special.betaln(wins + 0.5, alone - wins + 0.5) - scipy.special.betaln(0.5, 0.5) + alone * np.log(2.0)
    return np.asarray(wealth > np.log(2.0 / (1.0 - level)))


def _difference(count: _PairCounts, level: float) -> tuple[float, float]:
    """The interval of left - right: r (2q - 1) over the intervals of r and q."""
    alone = count.left_alone + count.right_alone
    half = (1.0 + level) / 2.0
    few, many = _interval(alone, count.runs, half)
    low, high = _interval(count.left_alone, alone, half) if alone else (0.0, 1.0)
    # r (2q - 1) grows with q; with r it grows or falls by the sign of 2q - 1, so both ends of r are tried.
    worst, best = 2.0 * low - 1.0, 2.0 * high - 1.0
    return min(few * worst, many * worst), max(few * best, many * best)


def _is_equal(count: _PairCounts, delta: float, level: float) -> bool:
    """Whether both are known to differ by no more than delta; where a glance says not yet, it is not computed."""
    # Two standard deviations of the difference of successes, whose variance is about the number of discordant pairs.
    scatter = 2.0 * (count.left_alone + count.right_alone) ** 0.5
    if abs(count.left - count.right) + scatter > delta * count.runs:
        return False
    low, high = _difference(count, level)
    return -delta <= low and high <= delta


def _outcome(count: _PairCounts, delta: float, level: float) -> PairedOutcome:
    low, high = _difference(count, level)
    alone = count.left_alone + count.right_alone
    answer: Order = "equal" if _is_equal(count, delta, level) else "not decided"
    if _rejects_fair_coin(np.array([count.left_alone]), np.array([alone]), level)[0]:
        answer = "greater" if count.left_alone > count.right_alone else "smaller"
    difference = (count.left - count.right) / count.runs
    runs = count.runs
    left, right = (Estimate(each / runs, *_interval(each, runs, level), runs) for each in (count.left, count.right))
    return PairedOutcome(
        rule=RULE,
        level=level,
        delta=delta,
        answer=answer,
        difference=difference,
        low=low,
        high=high,
        left=left,
        right=right,
        discordant=alone,
    )


def _interval(successes: int, runs: int, level: float) -> tuple[float, float]:
    low, high = mixture_interval(np.array([float(successes)]), np.array([runs]), level)
    return float(low[0]), float(high[0])
