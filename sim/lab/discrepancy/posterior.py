"""How sure a name is: a posterior over what was fitted, with and without a name, and none of these.

What was fitted has its likelihood. None of these has no likelihood of its own: it shows in what the names leave. A true
name leaves little that a free learner could still explain, and little of what the free run over held-out cycles is off
by; an imitator leaves any share of both. How much that says depends on how well the cycles know the shares.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sim.lab.discrepancy.diagnosis import Ceiling, HeldOutProof
from sim.lab.discrepancy.judging import systematic, systematic_heat, systematic_whole
from sim.lab.discrepancy.naming import NamingStep
from sim.lab.discrepancy.rules import DecisionRules

PRIOR_NONE = 0.25
"""The share of gaps that no name of the catalogue stands for, before anything is seen."""
MAX_CONFIDENCE = 0.99
"""The greatest confidence that is stated."""
WRONG_REACH_RATIO = 0.4
"""How often names get as far as the held-out cycles where none is true, over how often true ones do."""
PERFECT_IMITATORS_SHARE = 0.2
"""The share of the names that are not true and got so far which leave no more than true ones do."""
RIGHT_HEAT_LEFT, RIGHT_EXCESS_LEFT = 0.02, 0.25
"""Means of the shares that true names leave: of the systematic heat, and of the held-out excess."""
HEAT_LEFT_ERROR = 0.1
"""Standard error of the share of the systematic heat that is left."""
MIN_EXCESS_LEFT_ERROR = 0.1
"""Least standard error of the share of the held-out excess that is left: a true name's shape is not quite the plant's,
nor is the floor quite known, however many cycles there are."""
NULL_ODDS = 99.0
"""Odds against "nothing is missing" at `least_gain_nats`, which chance reaches in one case of a hundred."""
INTERVAL_SIGMAS = 3.92
"""Standard errors from one end of a 95 % interval to the other."""
_GRID = (np.arange(200) + 0.5) / 200.0


@dataclass(frozen=True, slots=True, kw_only=True)
class NamesEvidence:
    """What speaks against names beside their likelihood.

    `heat_left` is the share of the systematic heat that a free learner still predicts with them, `excess_left` that of
    the held-out excess that is not removed, with its standard error; None where the data do not say.
    """

    heat_left: float | None = None
    excess_left: float | None = None
    excess_error: float = 1.0


@dataclass(frozen=True, slots=True)
class NamePosterior:
    """Shares by the name of what was fitted (what has no name included), and that of none of these; they sum to 1."""

    shares: Mapping[str, float]
    none_of_these: float

    def confidence(self, members: tuple[str, ...]) -> float:
        """The share of a claim: one of these names. At most `MAX_CONFIDENCE`, and what none of these leaves."""
        share = sum(self.shares.get(name, 0.0) for name in members)
        return min(share, MAX_CONFIDENCE, 1.0 - self.none_of_these)


def names_evidence(
    held: HeldOutProof, before: Ceiling | None, left: Ceiling | None, rules: DecisionRules
) -> NamesEvidence:
    """The evidence of names by their held-out proof, and the free learner's ceiling before and with them."""
    whole = systematic_whole(before, left)
    told = left is not None and whole > 0.0 and (systematic(before, rules) or systematic(left, rules))
    heat_left = min(systematic_heat(left) / whole, 1.0) if told else None
    if held.excess_removed is None or held.ci95 is None:
        return NamesEvidence(heat_left=heat_left)
    low, high = held.ci95
    error = (high - low) / INTERVAL_SIGMAS
    return NamesEvidence(heat_left=heat_left, excess_left=1.0 - held.excess_removed, excess_error=error)


def remaining_shares(evidence: NamesEvidence) -> dict[str, float]:
    """The shares that the names leave, by name; those that are known."""
    shares = {"heat_left": evidence.heat_left, "excess_left": evidence.excess_left}
    return {name: share for name, share in shares.items() if share is not None}


def none_odds(evidence: NamesEvidence) -> float:
    """Odds of none of these against everything that was fitted."""
    ratio = 0.0
    if evidence.heat_left is not None:
        ratio += log_ratio(evidence.heat_left, HEAT_LEFT_ERROR, RIGHT_HEAT_LEFT)
    if evidence.excess_left is not None:
        error = float(np.hypot(evidence.excess_error, MIN_EXCESS_LEFT_ERROR))
        ratio += log_ratio(evidence.excess_left, error, RIGHT_EXCESS_LEFT)
    # What does all that the true cause does leaves what that leaves: nothing in these data tells the two apart.
    likelier = PERFECT_IMITATORS_SHARE + (1.0 - PERFECT_IMITATORS_SHARE) * float(np.exp(ratio))
    return PRIOR_NONE / (1.0 - PRIOR_NONE) * WRONG_REACH_RATIO * likelier


def log_ratio(share: float, error: float, mean: float) -> float:
    """Log of how much likelier a share is left, known to so much, where none is true than where the names are.

    An imitator leaves any share from 0 to 1, equally likely; true names leave small ones, exponentially distributed
    with that mean.
    """
    # Weighed relative to the likeliest, since far from [0, 1] all of them underflow.
    fit = -0.5 * ((share - _GRID) / error) ** 2
    seen = np.exp(fit - fit.max())
    right = np.exp(-_GRID / mean)
    return float(np.log(seen.mean()) - np.log((seen * right).sum() / right.sum()))


def step_gains(step: NamingStep) -> dict[str, float]:
    """nats by the name of what was looked for in a step, with and without a name."""
    return {each.entry.name: each.gain for each in step.evidence} | dict(step.rivals)


def posterior(gains: Mapping[str, float], evidence: NamesEvidence, rules: DecisionRules) -> NamePosterior:
    """The posterior of a step: equal odds before the data for all that was looked for, a quarter for none of these.

    `gains` (nats) are those of what was looked for, of which chance alone reaches `least_gain_nats` in one case of
    a hundred. That nothing is missing is among none of these.
    """
    top = max(gains.values())
    # No shape is quite the plant's: what one name may win over its twin by is worth no more than a margin.
    scale = max(1.0, rules.margin_share * top / max(rules.margin_nats, 1.0))
    fitted = np.exp((np.array(list(gains.values())) - top) / scale)
    nothing = float(np.exp(min(rules.least_gain_nats - np.log(NULL_ODDS) - top, 0.0)))
    none = none_odds(evidence) * float(fitted.sum()) + nothing
    whole = float(fitted.sum()) + none
    return NamePosterior(dict(zip(gains, (fitted / whole).tolist(), strict=True)), none / whole)
