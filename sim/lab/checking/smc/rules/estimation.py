"""How many runs are enough to estimate a probability.

A draw gives the next n outcomes of independent runs, 0.0 or 1.0 (weights in [0, 1] where a rule says so). Every rule
looks at the runs one by one, in their order, however many are drawn at once: the batch changes what is wasted at the
end and nothing else. `sprt` tests a probability against a bound, `paired` compares two of them.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import log

import numpy as np
import scipy
from numpy.typing import NDArray

from sim.scores import Estimate, clopper_pearson
from sim.sha import Array, Mask

Draw = Callable[[int], Array]
"""n -> the outcomes (n,) of the next n runs."""

Progress = Callable[[str, float], None]
"""What is being done, and the share that is done, 0..1."""

Interval = Callable[[Array, NDArray[np.int_], float], tuple[Array, Array]]
"""(successes (n,), runs (n,), level) -> low and high (n,)."""

BATCH_RUNS = 1000
MAX_RUNS = 1_000_000
UNDERCOVERAGE_NOTE = (
    "the rule stops where the interval happens to be narrow, so it holds the truth less often than its level says: "
    "92.7 % for a nominal 95 % at p = 0.1 and a half-width of 0.05"
)

_BLOCK_RUNS = 1024
"""Runs that are looked at in one piece of arithmetic."""


@dataclass(frozen=True, slots=True)
class RuleOutcome:
    """What a rule found: its name and `level`, the estimate with its interval at the stop, and how it ended.

    `decided` is False where the runs ran out first. `holds` is the answer of a test, None for an estimation and where
    nothing was decided. `note` says what the level does not say.
    """

    rule: str
    level: float
    estimate: Estimate
    decided: bool = True
    holds: bool | None = None
    note: str = ""


def fixed_run_estimate(
    draw: Draw, runs: int, level: float = 0.95, batch: int = BATCH_RUNS, progress: Progress | None = None
) -> RuleOutcome:
    """Exact binomial interval after that many runs (Clopper & Pearson 1934); weights in [0, 1] are allowed.

    Raises ValueError for runs below 1, and for outcomes outside [0, 1].
    """
    if runs < 1:
        raise ValueError(f"{runs} runs give no estimate; ask for at least 1")
    successes, done = 0.0, 0
    while done < runs:
        outcomes = draw_outcomes(draw, min(batch, runs - done))
        successes, done = successes + float(outcomes.sum()), done + outcomes.size
        show_progress(progress, done, runs)
    estimate = clopper_pearson(min(successes, runs), runs, level)
    return RuleOutcome("Clopper-Pearson, fixed number of runs", level, estimate)


def to_half_width(
    draw: Draw,
    epsilon: float = 0.05,
    level: float = 0.95,
    *,
    most: int = MAX_RUNS,
    batch: int = BATCH_RUNS,
    progress: Progress | None = None,
) -> RuleOutcome:
    """UPPAAL's sequential rule: runs until the Clopper-Pearson interval is no wider than 2 epsilon.

    With no success, or no failure, the interval is one-sided at the full 1 - level: at epsilon = .05 and level .95 the
    rule then stops at 29 runs with [0, 0.0981446]. Weights in [0, 1] are allowed. Raises ValueError for an epsilon
    outside (0, 0.5) and for outcomes outside [0, 1].
    """
    estimate, decided = _narrow_interval(
        draw, uppaal_interval, epsilon=epsilon, level=level, most=most, batch=batch, progress=progress
    )
    return RuleOutcome("Clopper-Pearson, sequential (UPPAAL's rule)", level, estimate, decided, note=UNDERCOVERAGE_NOTE)


def anytime(
    draw: Draw,
    epsilon: float = 0.05,
    level: float = 0.95,
    *,
    most: int = MAX_RUNS,
    batch: int = BATCH_RUNS,
    progress: Progress | None = None,
) -> RuleOutcome:
    """Runs until the anytime-valid interval of `mixture_interval` is no wider than 2 epsilon.

    Whatever stops it, the truth lies in the interval with a probability of at least `level`. Weights in [0, 1] are
    allowed. Raises as `to_half_width`.
    """
    estimate, decided = _narrow_interval(
        draw, mixture_interval, epsilon=epsilon, level=level, most=most, batch=batch, progress=progress
    )
    return RuleOutcome("betting (beta mixture), valid at any time", level, estimate, decided)


def mixture_interval(successes: Array, runs: NDArray[np.int_], level: float) -> tuple[Array, Array]:
    """Anytime-valid interval for a probability, low and high (n,): holds for all numbers of runs at once.

    A gambler who bets against p by a beta(1/2, 1/2) mixture of all probabilities has the wealth
    B(s + 1/2, n - s + 1/2) / (B(1/2, 1/2) p^s (1-p)^(n-s)), a martingale when p is right; the interval holds the p
    that have not made him 1 / (1 - level) times richer (Ville 1939; Robbins 1970, Ann. Math. Statist. 41; as betting:
    Waudby-Smith & Ramdas 2024, J. R. Stat. Soc. B 86). For weights in [0, 1] the wealth is a supermartingale.
    """
    # In logarithms: the wealth itself leaves the floats after some hundred runs.
    rich = np.log(1.0 / (1.0 - level))
    wealth = scipy.special.betaln(successes + 0.5, runs - successes + 0.5) - scipy.special.betaln(0.5, 0.5) - rich
    middle = successes / runs

    def inside(p: Array) -> Mask:
        return np.asarray(wealth <= scipy.special.xlogy(successes, p) + scipy.special.xlog1py(runs - successes, -p))

    # The wealth against p falls from p = 0 to s/n and rises beyond, so that one bisection on either side is enough.
    low = np.where(successes > 0, _edge(inside, np.zeros_like(middle), middle), 0.0)
    high = np.where(successes < runs, _edge(inside, np.ones_like(middle), middle), 1.0)
    return low, high


def _edge(kept: Callable[[Array], Mask], outside: Array, inside: Array) -> Array:
    """Where `kept` begins between the two, by bisection; the outer side, so that nothing is left out."""
    for _ in range(52):  # the bits of a float's mantissa
        halfway = (outside + inside) / 2.0
        hit = kept(halfway)
        outside, inside = np.where(hit, outside, halfway), np.where(hit, halfway, inside)
    return outside


def uppaal_interval(successes: Array, runs: NDArray[np.int_], level: float) -> tuple[Array, Array]:
    """Clopper-Pearson as UPPAAL has it: with no success or no failure all of 1 - level lies on the open side."""
    extreme = (successes <= 0) | (successes >= runs)
    tail = np.where(extreme, 1.0 - level, (1.0 - level) / 2.0)
    failures = runs - successes
    # Quantiles of the beta law; 1e-9 only keeps its parameter positive where the result is not used.
    low = np.where(successes > 0, scipy.special.betaincinv(np.maximum(successes, 1e-9), failures + 1, tail), 0.0)
    high = np.where(failures > 0, scipy.special.betaincinv(successes + 1, np.maximum(failures, 1e-9), 1.0 - tail), 1.0)
    return low, high


def _narrow_interval(
    draw: Draw,
    interval: Interval,
    *,
    epsilon: float,
    level: float,
    most: int,
    batch: int,
    progress: Progress | None,
) -> tuple[Estimate, bool]:
    """Runs until the interval is no wider than 2 epsilon: the estimate there, and whether that came before `most`."""
    if not 0.0 < epsilon < 0.5 or not 0.0 < level < 1.0 or most < 1:
        raise ValueError(f"no estimate to +-{epsilon} at level {level} in {most} runs; use such as 0.05, 0.95, 1000000")
    total, runs = 0.0, 0
    while runs < most:
        batch_outcomes = draw_outcomes(draw, min(batch, most - runs))
        for first in range(0, batch_outcomes.size, _BLOCK_RUNS):
            outcomes = batch_outcomes[first : first + _BLOCK_RUNS]
            sums, counts = total + np.cumsum(outcomes), runs + np.arange(1, outcomes.size + 1)
            estimate = _first_narrow(interval, sums, counts, epsilon, level)
            if estimate is not None:
                return estimate, True
            total, runs = float(sums[-1]), int(counts[-1])
        # About how many runs an interval of this half-width takes: the normal approximation's, or, where p is near 0 or
        # 1, the number at which none in n is told from epsilon.
        p, tail = total / runs, log(2.0 / (1.0 - level))
        expected = int(min(most, max(2.0 * tail * p * (1.0 - p) / epsilon**2, tail / epsilon) + 1))
        show_progress(progress, runs, expected)
    low, high = interval(np.array([total]), np.array([runs]), level)
    return Estimate(total / runs, float(low[0]), float(high[0]), runs), False


def _first_narrow(
    interval: Interval,
    sums: Array,
    counts: NDArray[np.int_],
    epsilon: float,
    level: float,
) -> Estimate | None:
    """The estimate at the first run of a block where the interval is narrow enough.

    An interval narrows with the runs and widens towards as many successes as failures. So none in the block is
    narrower than that of its fewest successes (or failures) among all its runs, and most blocks need no more.
    """
    fewest = np.minimum(sums, counts - sums).min()
    low, high = interval(np.array([fewest]), counts[-1:], level)
    if high[0] - low[0] > 2.0 * epsilon:
        return None
    lows, highs = interval(sums, counts, level)
    narrow = np.flatnonzero(highs - lows <= 2.0 * epsilon)
    if not narrow.size:
        return None
    at = int(narrow[0])
    return Estimate(float(sums[at] / counts[at]), float(lows[at]), float(highs[at]), int(counts[at]))


def draw_outcomes(draw: Draw, runs: int) -> Array:
    """The next outcomes, checked."""
    return check_outcomes(draw(runs), runs)


def check_outcomes(outcomes: Array, runs: int) -> Array:
    """The outcomes as floats. Raises ValueError for one outside [0, 1] or NaN, and for a wrong number of them."""
    values = np.asarray(outcomes, dtype=float)
    if values.shape != (runs,):
        raise ValueError(f"{runs} runs gave outcomes of shape {values.shape}")
    if not np.all((values >= 0.0) & (values <= 1.0)):
        raise ValueError("an outcome of a run lies outside [0, 1]")
    return values


def show_progress(progress: Progress | None, done: int, of: int) -> None:
    """Say how far it is, if anybody listens."""
    if progress is not None:
        progress(f"{done} runs", min(1.0, done / of))
