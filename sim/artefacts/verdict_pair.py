"""A version beside the one that runs, by what both foresaw of the same cycles of the same recordings, seen by neither.

Cycles (days, where no switch is read) are the independent units: their mean CRPS is compared one by one by a sign test,
exact for any number of them. Only units count that both foresaw from the same moments: the mean of few forecasts is
below that of many more often than not, as CRPS are skewed, and moments near a switch are harder than others. It needs
neither a recording nor scipy, so that a running gateway can say it of each version in its store.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb, floor, log2
from typing import Literal

from sim.artefacts.verdict_file import JudgedCriterion, ModelVerdict
from sim.sha import display_unit

PAIR_CRITERION = "the version that runs"
ERROR_CHANCE = 0.05
"""The chance at most that any horizon is called better or worse where both versions are alike."""
WORSE_CRPS_RATIO = 1.05
"""A mean CRPS that is less than so many times the other one's is no reason to keep a version."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HorizonPair:
    """The mean CRPS of a version and of the one that `runs` at a `horizon` (s), over `units` that both foresaw.

    `p` is the sign test's, two-sided, times the number of horizons (Bonferroni); `mostly_worse` is whether more of the
    units speak against the version than for it.
    """

    horizon: float
    crps: float
    runs: float
    units: int
    mostly_worse: bool
    p: float

    @property
    def outcome(self) -> Literal["better", "worse", ""]:
        """What is known of the version; "" where the two are not told apart, or its mean contradicts its units."""
        if self.p >= ERROR_CHANCE:
            return ""
        if self.mostly_worse:
            return "worse" if self.crps > WORSE_CRPS_RATIO * self.runs else ""
        return "better" if self.runs > WORSE_CRPS_RATIO * self.crps else ""


def pair_horizons(own: ModelVerdict, running: ModelVerdict) -> list[HorizonPair]:
    """The horizons at which both foresaw units from the same moments; none where nothing could be told of so few."""
    shared = _shared_units(own, running)
    if max(map(len, shared.values()), default=0) < _least_units(len(shared)):
        return []
    return [_pair(horizon, pairs, len(shared)) for horizon, pairs in shared.items()]


def _shared_units(own: ModelVerdict, running: ModelVerdict) -> dict[float, list[tuple[float, float]]]:
    """horizon -> the CRPS of both, of each unit that both foresaw from the same moments; only horizons with any."""
    theirs = {each.horizon: each.units for each in running.foreseen}
    found = {}
    for each in own.foreseen:
        others = theirs.get(each.horizon, {})
        pairs = [
            (unit.crps, others[name].crps)
            for name, unit in each.units.items()
            if name in others and others[name].moments == unit.moments
        ]
        if pairs:
            found[each.horizon] = pairs
    return found


def _least_units(horizons: int) -> int:
    """How many units must all say the same, for anything to be told at one of so many horizons."""
    return floor(log2(2 * horizons / ERROR_CHANCE)) + 1 if horizons else 0


def _pair(horizon: float, pairs: Sequence[tuple[float, float]], horizons: int) -> HorizonPair:
    worse, better = sum(own > theirs for own, theirs in pairs), sum(own < theirs for own, theirs in pairs)
    decided = worse + better
    tail = sum(comb(decided, count) for count in range(min(worse, better) + 1)) / 2**decided
    return HorizonPair(
        horizon=horizon,
        crps=sum(own for own, _ in pairs) / len(pairs),
        runs=sum(theirs for _, theirs in pairs) / len(pairs),
        units=len(pairs),
        mostly_worse=worse > better,
        p=min(1.0, 2.0 * tail * horizons),
    )


def _reason_against(own: ModelVerdict, running: ModelVerdict) -> str:
    """Why two verdicts do not say which version is better."""
    if not (own.foreseen and running.foreseen):
        return "the verdict of one of them keeps no figures"
    if shared := _shared_units(own, running):
        most = max(map(len, shared.values()))
        cycles = "cycle or day was" if most == 1 else "cycles or days were"
        return f"{most} {cycles} foreseen by both from the same moments, and {_least_units(len(shared))} are needed"
    names = [{name for each in verdict.foreseen for name in each.units} for verdict in (own, running)]
    if names[0] & names[1]:
        return "they foresaw the same recordings from other moments, as what else they were judged on differs"
    return "they were judged on other recordings"


def compare_verdicts(own: ModelVerdict, running: ModelVerdict, unit: str, how: str) -> JudgedCriterion:
    """A version's criterion beside the one that runs: not kept where it is known to be worse and nowhere better.

    Figures are in `unit`; `how` says what to do to compare them where their verdicts do not.
    """
    pairs = pair_horizons(own, running)
    if not pairs:
        said = f"not compared with the version that runs: {_reason_against(own, running)}"
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
