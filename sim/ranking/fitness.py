"""Which models are fit for deployment, and why not: a table of criteria with limits, judged on campaign results."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from math import isfinite, nan
from typing import Literal

from sim.sha import DEGREES, shown_unit
from sim.validation import TRAINED_ON, TraceResult

Verdict = Literal["fit", "unfit", "open"]


@dataclass(frozen=True, slots=True)
class FitnessLimits:
    """What a model for deployment must keep, on the traces that it was not trained on where there are any.

    `coverage_low` and `coverage_high` bound the mean share of readings inside the 90 % band; `persistence` the model's
    mean MAE in units of that of the first reading held; `largest` (degC) the largest error of any trace; `clamps` and
    `rejecting` count clamps over all traces and traces with an event that had no edge; `unseen` is the least number of
    traces that the model was not trained on; `synthetic` allows models learned from synthetic traces. Raises
    ValueError.
    """

    coverage_low: float = 0.8
    coverage_high: float = 0.99
    persistence: float = 1.0
    largest: float = 30.0
    clamps: float = 0
    rejecting: float = 0
    unseen: float = 1
    synthetic: bool = False

    def __post_init__(self) -> None:
        if not 0 <= self.coverage_low < self.coverage_high <= 1:
            limits = f"{self.coverage_low:g} and {self.coverage_high:g}"
            raise ValueError(f"the limits of the coverage must be two ascending shares of 0 to 1, got {limits}")
        if not (self.persistence > 0 and self.largest > 0):
            raise ValueError("the limits of the largest error and of the MAE against persistence must be positive")
        if not min(self.clamps, self.rejecting, self.unseen) >= 0:
            raise ValueError("the limits of clamps, rejecting and unseen are counts: 0 or more")


def limits_of(pairs: Iterable[tuple[str, str]], *, synthetic: bool = False) -> FitnessLimits:
    """Limits from (name, number as text). Raises ValueError for unknown names and for what is no such number."""
    names = [limit.name for limit in fields(FitnessLimits) if limit.name != "synthetic"]
    values: dict[str, float] = {}
    for name, text in pairs:
        if name not in names:
            raise ValueError(f"there is no limit {name!r}; there are {', '.join(names)}")
        try:
            values[name] = float(text)
        except ValueError:
            raise ValueError(f"the limit {name} is {text!r}; it must be a number, as 0.5 or 3") from None
    return FitnessLimits(synthetic=synthetic, **values)


@dataclass(frozen=True, slots=True)
class Facts:
    """What is known of a model besides its results; None stands for not known.

    `synthetic`: learned from synthetic traces; `verified`: whether the gate of verification let it pass, with `gate`
    the sentence that it said; `seen`: the traces that it was trained on, among those it is judged by.
    """

    synthetic: bool | None = None
    verified: bool | None = None
    gate: str = ""


@dataclass(frozen=True, slots=True)
class Finding:
    """One criterion: kept, not kept, or None where nothing is known; `sentence` says by which figure."""

    criterion: str
    kept: bool | None
    sentence: str


@dataclass(frozen=True, slots=True)
class Case:
    """What the criteria look at: `results` on all traces, `judged` on those that were not trained on (or on all)."""

    results: Sequence[TraceResult]
    judged: Sequence[TraceResult]
    facts: Facts
    limits: FitnessLimits


def judge(results: Sequence[TraceResult], facts: Facts, limits: FitnessLimits) -> tuple[Finding, ...]:
    """All criteria for one model, in the order of the table."""
    # What was not trained on, where there is any: errors in sample flatter. Failures count by criteria of their own.
    fresh = [result for result in results if result.seen not in TRAINED_ON]
    done = [result for result in fresh or results if not result.failure]
    case = Case(results, done, facts, limits)
    return tuple(Finding(name, *criterion(case)) for name, criterion in CRITERIA.items())


def verdict(findings: Iterable[Finding]) -> Verdict:
    """ "unfit" when one criterion is not kept, "open" when one could not be looked at, else "fit"."""
    kept = {finding.kept for finding in findings}
    return "unfit" if False in kept else "open" if None in kept else "fit"


Said = tuple[bool | None, str]


def _verified(case: Case) -> Said:
    if case.facts.verified is None:
        return None, case.facts.gate or "not verified: the model itself is not at hand"
    return case.facts.verified, case.facts.gate or ("verified" if case.facts.verified else "refused by verification")


def _passed(case: Case) -> Said:
    failed = [result for result in case.results if result.failure]
    if not failed:
        return True, f"all {len(case.results)} traces were worked through"
    first = failed[0]
    return (
        False,
        f"{len(failed)} of {len(case.results)} traces failed, {first.trace} at stage {first.stage}: {first.failure}",
    )


def _accepted(case: Case) -> Said:
    refusing = [result for result in case.results if not result.failure and not result.accepted]
    kept = len(refusing) <= case.limits.rejecting
    if not refusing:
        return True, "every event had an edge"
    first = f", {refusing[0].trace}: {refusing[0].rejected}" if refusing[0].rejected else ""
    return kept, f"{_traces(len(refusing))} with an event that has no edge (limit {case.limits.rejecting:g}){first}"


def _unit(case: Case) -> str:
    return shown_unit(case.results[0].unit if case.results else DEGREES)


def _clamps(case: Case) -> Said:
    clamps = sum(result.clamps for result in case.results)
    return clamps <= case.limits.clamps, f"{clamps} clamps to the model's range (limit {case.limits.clamps:g})"


def _diverging(case: Case) -> Said:
    errors = [(result.max_error, result.trace) for result in case.results if not result.failure]
    if not errors:
        return None, "no trace has an error"
    # An error that is no number is the largest of all, and no limit is kept with it.
    largest, trace = max(errors, key=lambda pair: pair[0] if isfinite(pair[0]) else float("inf"))
    return (
        largest <= case.limits.largest,
        f"largest error {largest:.3g} {_unit(case)} on {trace} (limit {case.limits.largest:g})",
    )


def _covered(case: Case) -> Said:
    low, high = case.limits.coverage_low, case.limits.coverage_high
    share = _mean(result.coverage for result in case.judged)
    if not isfinite(share):
        return None, "no coverage is known"
    return (
        low <= share <= high,
        f"{100 * share:.1f} % of the readings in the 90 % band (limits {100 * low:g} to {100 * high:g})",
    )


def _persistence(case: Case) -> Said:
    pairs = [(result.at_samples.mae, result.persistence) for result in case.judged]
    pairs = [pair for pair in pairs if all(map(isfinite, pair))]
    if not pairs:
        return None, "no error of persistence is known"
    own, rival = (_mean(column) for column in zip(*pairs, strict=True))
    words = f"MAE {own:.3g} {_unit(case)} against {rival:.3g} {_unit(case)} of the first reading held"
    return own < case.limits.persistence * rival, f"{words} (limit {case.limits.persistence:g} times)"


def _unseen(case: Case) -> Said:
    count = sum(result.seen == "no" for result in case.results)
    if not count and any(result.seen == "unknown" for result in case.results):
        return None, "the model does not say which traces it was trained on"
    return count >= case.limits.unseen, f"{_traces(count)} that it was not trained on (at least {case.limits.unseen:g})"


def _from_plant(case: Case) -> Said:
    if case.facts.synthetic is None:
        return None, "where its training traces come from is not known"
    if not case.facts.synthetic:
        return True, "learned from measured traces"
    return case.limits.synthetic, "learned from synthetic traces" + (", which was allowed" * case.limits.synthetic)


CRITERIA: Mapping[str, Callable[[Case], Said]] = {
    "verified": _verified,
    "passed": _passed,
    "accepted": _accepted,
    "clamps": _clamps,
    "diverging": _diverging,
    "coverage": _covered,
    "persistence": _persistence,
    "unseen": _unseen,
    "from a plant": _from_plant,
}
"""Every criterion by name: whether it is kept (None: not known), and in words by which figure."""


def _mean(values: Iterable[float]) -> float:
    known = [value for value in values if isfinite(value)]
    return sum(known) / len(known) if known else nan


def _traces(count: int) -> str:
    return f"{count} trace{'' if count == 1 else 's'}"
