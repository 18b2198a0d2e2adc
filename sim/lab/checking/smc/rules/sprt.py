"""Is a probability at least (at most) p? Wald's sequential probability ratio test, and what he says it costs."""

from dataclasses import dataclass, replace
from math import exp, expm1, inf, log
from typing import Literal

import numpy as np
import scipy

from sim.lab.checking.smc.rules.estimation import (
    BATCH_RUNS,
    MAX_RUNS,
    Draw,
    Progress,
    RuleOutcome,
    draw_outcomes,
    fixed_run_estimate,
    mixture_interval,
    show_progress,
)
from sim.scores import Estimate
from sim.sha import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class RatioTest:
    """Wald's test of `p >= accept` against `p <= reject` (for op <=, the other way round): accept is where it holds.

    Between the two, the indifference region, either answer is right. `alpha`: the chance to deny what holds at
    `accept`; `beta`: to affirm what fails at `reject`.
    """

    op: Literal["<=", ">="]
    p: float
    accept: float
    reject: float
    alpha: float
    beta: float

    @property
    def limits(self) -> tuple[float, float]:
        """The log likelihood ratio (of reject to accept) at and below which it holds, at and above which it fails."""
        return log(self.beta / (1.0 - self.alpha)), log((1.0 - self.beta) / self.alpha)

    @property
    def steps(self) -> tuple[float, float]:
        """What one success and one failure add to the log likelihood ratio; -inf and inf settle it at once."""
        with np.errstate(divide="ignore", invalid="ignore"):  # a hypothesis at 0 or 1
            success = np.log(self.reject) - np.log(self.accept)
            failure = np.log1p(-self.reject) - np.log1p(-self.accept)
        return float(success), float(failure)


def sprt(
    draw: Draw,
    test: RatioTest,
    *,
    most: int = MAX_RUNS,
    batch: int = BATCH_RUNS,
    progress: Progress | None = None,
) -> RuleOutcome:
    """Wald's sequential probability ratio test (1945) of `test`; weights in [0, 1] are allowed.

    The interval is `mixture_interval`'s at level 1 - alpha, which the stopping does not harm. A bound that every
    probability keeps (>= 0, <= 1) holds without a run that matters.
    """
    if test.accept == test.reject:
        only = fixed_run_estimate(draw, 1, 1.0 - test.alpha)
        return replace(only, rule=f"every probability is {test.op} {test.p:g}", holds=True)
    below, above = test.limits
    success, failure = test.steps
    total, runs, ratio = 0.0, 0, 0.0
    while runs < most and below < ratio < above:
        outcomes = draw_outcomes(draw, min(batch, most - runs))
        sums, counts = total + np.cumsum(outcomes), runs + np.arange(1, outcomes.size + 1)
        # The ratio after every single run of the batch, so that the batch decides nothing about where the test stops.
        ratios = _scale_counts(sums, success) + _scale_counts(counts - sums, failure)
        ends = np.flatnonzero((ratios <= below) | (ratios >= above))
        last = int(ends[0]) if ends.size else outcomes.size - 1
        total, runs, ratio = float(sums[last]), int(counts[last]), float(ratios[last])
        show_progress(progress, runs, most)
    holds = None if below < ratio < above else ratio <= below
    low, high = mixture_interval(np.array([total]), np.array([runs]), 1.0 - test.alpha)
    estimate = Estimate(total / runs, float(low[0]), float(high[0]), runs)
    rule = f"Wald's SPRT of {test.accept:g} against {test.reject:g}, alpha {test.alpha:g}, beta {test.beta:g}"
    return RuleOutcome(rule, 1.0 - test.alpha, estimate, holds is not None, holds)


def wald_test(
    op: Literal["<=", ">="], p: float, delta: float = 0.01, alpha: float = 0.05, beta: float = 0.05
) -> RatioTest:
    """The test of `Pr(...) op p` with the indifference region p - delta .. p + delta.

    Where p is nearer than 2 delta to 0 or 1 the region shrinks to half that distance, so that both hypotheses stay
    possible; at 0 and 1 themselves it lies on one side. `>= 0` and `<= 1` are no question: accept is reject then.
    Raises ValueError unless 0 <= p <= 1, 0 < delta < 0.5, and alpha and beta are positive with a sum below 1.
    """
    if not 0.0 <= p <= 1.0 or not 0.0 < delta < 0.5:
        raise ValueError(f"no test of {op} {p} with delta {delta}: p must be in [0, 1] and delta in (0, 0.5)")
    if not (alpha > 0 and beta > 0 and alpha + beta < 1):
        raise ValueError(f"no test with alpha {alpha} and beta {beta}: both must be positive and their sum below 1")
    nearest = min(p, 1.0 - p)
    half = min(delta, nearest / 2.0) if nearest > 0 else delta
    low, high = max(p - half, 0.0), min(p + half, 1.0)
    if nearest == 0.0:
        low, high = (p, p) if (op == ">=") == (p == 0.0) else (low, high)
    accept, reject = (high, low) if op == ">=" else (low, high)
    return RatioTest(op=op, p=p, accept=accept, reject=reject, alpha=alpha, beta=beta)


def expected_runs(test: RatioTest, p: float) -> float:
    """Wald's approximation of the mean number of runs when the probability is p (Wald 1945, eqs. 3:43 and 3:57).

    It leaves out how far the last run oversteps the limit, so the true mean is somewhat higher. inf where one outcome
    settles the matter at once (a hypothesis at 0 or 1) or there is no question.
    """
    below, above = test.limits
    success, failure = test.steps
    if not (np.isfinite(success) and np.isfinite(failure)) or success == failure:
        return inf
    drift, spread = _moments(p, success, failure)
    # Without drift that is 0 / 0; by Wald's second identity it is E[ratio^2] / spread, here -below * above / spread.
    if abs(drift) < 1e-4 * spread:
        return -below * above / spread
    holds = acceptance(test, p)
    return (holds * below + (1.0 - holds) * above) / drift


def acceptance(test: RatioTest, p: float) -> float:
    """Wald's approximation of the chance that the test says "holds" when the probability is p (1945, eq. 3:43).

    It is 1 - alpha at `accept` and beta at `reject`. Raises ValueError where the ratio of the hypotheses is not finite.
    """
    below, above = test.limits
    success, failure = test.steps
    if not (np.isfinite(success) and np.isfinite(failure)) or success == failure:
        raise ValueError("no approximation for a hypothesis at 0 or 1, or for two that are the same")
    # The three forms are one: each keeps its exponents negative, so that none overflows.
    power = _conjugate(p, success, failure)
    if power == 0.0:
        return above / (above - below)
    if power > 0.0:
        return -expm1(-power * above) / -expm1(power * (below - above))
    return (exp(-power * below) - exp(power * (above - below))) / -expm1(power * (above - below))


def _conjugate(p: float, success: float, failure: float) -> float:
    """The h other than 0 with p e^(h success) + (1-p) e^(h failure) = 1; 0 where the drift is 0."""
    drift, spread = _moments(p, success, failure)
    first = -2.0 * drift / spread
    if p in (0.0, 1.0):
        return float(np.copysign(inf, first))
    if abs(first) < 1e-3:
        return first  # the series' first term: there is nothing left to refine in floats

    def excess(h: float) -> float:
        return float(np.logaddexp(np.log(p) + h * success, np.log1p(-p) + h * failure))

    # excess(h) is convex with zeros at 0 and at the h looked for, which has the sign of `first`.
    near = far = 0.01 * first
    while excess(far) <= 0.0:
        near, far = far, far * 2.0
    return float(scipy.optimize.brentq(excess, min(near, far), max(near, far)))


def _moments(p: float, success: float, failure: float) -> tuple[float, float]:
    """The mean of what one run adds to the log likelihood ratio, and that of its square."""
    return p * success + (1.0 - p) * failure, p * success**2 + (1.0 - p) * failure**2


def _scale_counts(counts: Array, step: float) -> Array:
    """counts * step, where nothing times infinity is nothing."""
    return np.multiply(counts, step, out=np.zeros_like(counts), where=counts != 0)
