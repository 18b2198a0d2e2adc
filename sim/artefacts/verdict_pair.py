"""A version beside the one that runs, by what both foresaw of the same cycles of the same recordings, seen by neither.

Cycles (days, where no switch is read) are the independent units: their mean CRPS is compared one by one by a sign test,
exact for any number of them. It needs neither a recording nor scipy, so that a running gateway can say it of each
version in its store.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import comb
from typing import Literal

from sim.artefacts.verdict_file import ForeseenHorizon, JudgedCriterion, ModelVerdict
from sim.sha import display_unit

PAIR_CRITERION = "the version that runs"
ERROR_CHANCE = 0.05
"""The chance at most that any horizon is called better or worse where both versions are alike."""
WORSE_CRPS_RATIO = 1.05
"""A mean CRPS that is less than so many times the other one's is no reason to keep a version."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HorizonPair:
    """The mean CRPS of a version and of the one that `runs` at a `horizon` (s), over `units` that both foresaw.

    `p` is the sign test's, two-sided, times the number of horizons (Bonferroni).
    """

    horizon: float
    crps: float
    runs: float
    units: int
    p: float

    @property
    def outcome(self) -> Literal["better", "worse", ""]:
        """What is known of the version; "" where the two are not told apart."""
        if self.p >= ERROR_CHANCE:
            return ""
        if self.crps > WORSE_CRPS_RATIO * self.runs:
            return "worse"
        return "better" if self.runs > WORSE_CRPS_RATIO * self.crps else ""


def pair_horizons(own: ModelVerdict, running: ModelVerdict) -> list[HorizonPair]:
    """The horizons at which both have units in common; none for verdicts that keep no figures."""
    theirs = {each.horizon: each.units for each in running.foreseen}
    shared = [
        (each, units)
        for each in own.foreseen
        if (units := sorted(each.units.keys() & theirs.get(each.horizon, {}).keys()))
    ]
    return [_pair(each, theirs[each.horizon], units, len(shared)) for each, units in shared]


def _pair(own: ForeseenHorizon, theirs: Mapping[str, float], units: Sequence[str], horizons: int) -> HorizonPair:
    worse = sum(own.units[unit] > theirs[unit] for unit in units)
    decided = worse + sum(own.units[unit] < theirs[unit] for unit in units)
    tail = sum(comb(decided, count) for count in range(min(worse, decided - worse) + 1)) / 2**decided
    return HorizonPair(
        horizon=own.horizon,
        crps=sum(own.units[unit] for unit in units) / len(units),
        runs=sum(theirs[unit] for unit in units) / len(units),
        units=len(units),
        p=min(1.0, 2.0 * tail * horizons),
    )


def compare_verdicts(own: ModelVerdict, running: ModelVerdict, unit: str, how: str) -> JudgedCriterion:
    """A version's criterion beside the one that runs: not kept where it is known to be worse and nowhere better.

    Figures are in `unit`; `how` says what to do to compare them where their verdicts do not.
    """
    pairs = pair_horizons(own, running)
    if not pairs:
        known = all(verdict.foreseen for verdict in (own, running))
        what = "they were judged on other recordings" if known else "the verdict of one of them keeps no figures"
        said = f"not compared with the version that runs: {what}"
        return JudgedCriterion(criterion=PAIR_CRITERION, kept=None, sentence=said, next_step=how)
    outcomes = {each.outcome for each in pairs}
    figures = ", ".join(
        f"{each.crps:.3g} against {each.runs:.3g} {display_unit(unit)} at {each.horizon:g} s over {each.units} "
        f"cycles or days (p {each.p:.2g})"
        for each in pairs
    )
    if "worse" in outcomes:
        kept = None if "better" in outcomes else False
        word = "worse than the version that runs" + (" at some horizons, and better at others" if kept is None else "")
    else:
        kept = True if "better" in outcomes else None
        word = "better than the version that runs" if kept else "not told apart from the version that runs"
    next_step = "" if kept else how
    return JudgedCriterion(
        criterion=PAIR_CRITERION, kept=kept, sentence=f"{word} (CRPS {figures})", next_step=next_step
    )
