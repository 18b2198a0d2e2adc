"""May I use this model: fit, limited or unfit, by a table of criteria with limits, judged on campaign results."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from math import isfinite

from sim.artefacts import JudgedCriterion, ModelVerdict, rate_criteria
from sim.lab.judge.results import TRAINED_VALUES, TraceResult
from sim.lab.judge.stages import Prepared
from sim.lab.judge.verdicts import mean
from sim.proof import verify
from sim.sha import DEFAULT_UNIT, Model, display_unit


@dataclass(frozen=True, slots=True)
class FitnessLimits:
    """What a model for deployment must keep, on the traces that it was not trained on where there are any.

    `coverage_low` and `coverage_high` bound the mean share of readings inside the 90 % band; `persistence` the model's
    mean MAE in units of that of the first reading held; `largest` (degC) the largest error of any trace,
    `percent` the mean error of any in per cent of its readings' mean size; `clamps` and
    `rejecting` count clamps over all traces and traces with an event that had no edge; `unseen` is the least number of
    traces that the model was not trained on; `synthetic` allows models learned from synthetic traces. Raises
    ValueError.
    """

    coverage_low: float = 0.8
    coverage_high: float = 0.99
    persistence: float = 1.0
    largest: float = 30.0
    percent: float = 70.0
    clamps: float = 0
    rejecting: float = 0
    unseen: float = 1
    synthetic: bool = False

    def __post_init__(self) -> None:
        if not 0 <= self.coverage_low < self.coverage_high <= 1:
            limits = f"{self.coverage_low:g} and {self.coverage_high:g}"
            raise ValueError(f"the limits of the coverage must be two ascending shares of 0 to 1, got {limits}")
        if not (self.persistence > 0 and self.largest > 0 and self.percent > 0):
            raise ValueError(
                "the limits of the largest error, of the error in per cent and of the MAE against persistence must be "
                "positive"
            )
        if not min(self.clamps, self.rejecting, self.unseen) >= 0:
            raise ValueError("the limits of clamps, rejecting and unseen are counts: 0 or more")


def parse_limits(pairs: Iterable[tuple[str, str]], *, synthetic: bool = False) -> FitnessLimits:
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


def model_facts(model: Model) -> Facts:
    """What a model says of itself; artefacts and models by hand do not say what they were learned from."""
    verification, origin = verify(model), model.provenance
    passed = sum(check.blocking for check in verification.checks)
    return Facts(
        synthetic=origin.synthetic if origin.data_hash or origin.traces else None,
        verified=verification.deployable,
        gate=f"verified: {passed} blocking checks are proven"
        if verification.deployable
        else "; ".join(verification.reasons),
    )


def model_facts_by_semantics(prepared: Prepared) -> dict[str, Facts]:
    """What a model at hand says of itself, by semantics ("" for all others); one that cannot be run fails the gate."""
    unfit = Facts(verified=False, gate="; ".join(prepared.refusals.values()))
    return {"": unfit} | {name: model_facts(model) for name, model in prepared.variants.items()}


@dataclass(frozen=True, slots=True)
class Case:
    """What the criteria look at: `results` on all traces, `judged` on those that were not trained on (or on all)."""

    results: Sequence[TraceResult]
    judged: Sequence[TraceResult]
    facts: Facts
    limits: FitnessLimits


def judge(results: Sequence[TraceResult], facts: Facts, limits: FitnessLimits) -> tuple[JudgedCriterion, ...]:
    """All criteria for one model, in the order of the table."""
    # What was not trained on, where there is any: errors in sample flatter. Failures count by criteria of their own.
    fresh = [result for result in results if result.seen not in TRAINED_VALUES]
    done = [result for result in fresh or results if not result.failure]
    case = Case(results, done, facts, limits)
    findings = []
    for name, (criterion, next_step) in CRITERIA.items():
        kept, sentence = criterion(case)
        findings.append(
            JudgedCriterion(criterion=name, kept=kept, sentence=sentence, next_step="" if kept else next_step)
        )
    return tuple(findings)


def judge_semantics(
    results: Sequence[TraceResult], facts: Mapping[str, Facts]
) -> dict[str, tuple[JudgedCriterion, ...]]:
    """The criteria for one model under each of its semantics; `facts` are by semantics, "" for all others."""
    by_semantics: dict[str, list[TraceResult]] = {}
    for result in results:
        by_semantics.setdefault(result.semantics, []).append(result)
    unknown = facts.get("", Facts())
    return {name: judge(own, facts.get(name, unknown), FitnessLimits()) for name, own in by_semantics.items()}


def fitness_verdict(findings: Sequence[JudgedCriterion]) -> ModelVerdict:
    """The verdict that the criteria come to; it is told, as a campaign's forecasts have all been made."""
    return ModelVerdict(word=rate_criteria(findings, told=True), criteria=tuple(findings))


Said = tuple[bool | None, str]


def _judge_proof(case: Case) -> Said:
    if case.facts.verified is None:
        return None, case.facts.gate or "not verified: the model itself is not at hand"
    return case.facts.verified, case.facts.gate or ("verified" if case.facts.verified else "refused by verification")


def _judge_passes(case: Case) -> Said:
    failed = [result for result in case.results if result.failure]
    if not failed:
        return True, f"all {len(case.results)} traces were worked through"
    first = failed[0]
    return (
        False,
        f"{len(failed)} of {len(case.results)} traces failed, {first.trace} at stage {first.stage}: {first.failure}",
    )


def _judge_acceptance(case: Case) -> Said:
    refusing = [result for result in case.results if not result.failure and not result.accepted]
    kept = len(refusing) <= case.limits.rejecting
    if not refusing:
        return True, "every event had an edge"
    first = f", {refusing[0].trace}: {refusing[0].rejected}" if refusing[0].rejected else ""
    return kept, f"{_traces(len(refusing))} with an event that has no edge (limit {case.limits.rejecting:g}){first}"


def _unit(case: Case) -> str:
    return display_unit(case.results[0].unit if case.results else DEFAULT_UNIT)


def _clamps(case: Case) -> Said:
    clamps = sum(result.clamps for result in case.results)
    return clamps <= case.limits.clamps, f"{clamps} clamps to the model's range (limit {case.limits.clamps:g})"


def _judge_divergence(case: Case) -> Said:
    errors = [(result.max_error, result.trace) for result in case.results if not result.failure]
    if not errors:
        return None, "no trace has an error"
    # An error that is no number is the largest of all, and no limit is kept with it.
    largest, trace = max(errors, key=lambda pair: pair[0] if isfinite(pair[0]) else float("inf"))
    return (
        largest <= case.limits.largest,
        f"largest error {largest:.3g} {_unit(case)} on {trace} (limit {case.limits.largest:g})",
    )


def _judge_percent(case: Case) -> Said:
    shares = [(result.percent(result.at_samples.mae), result.trace) for result in case.results if not result.failure]
    known = [pair for pair in shares if isfinite(pair[0])]
    if not known:
        return None, "no error in per cent of the readings is known"
    worst, trace = max(known)
    sentence = f"mean error {worst:.3g} % of the readings at most, on {trace} (limit {case.limits.percent:g} %)"
    return worst <= case.limits.percent, sentence


def _judge_coverage(case: Case) -> Said:
    low, high = case.limits.coverage_low, case.limits.coverage_high
    share = mean(result.coverage for result in case.judged)
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
    own, rival = (mean(column) for column in zip(*pairs, strict=True))
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


CRITERIA: Mapping[str, tuple[Callable[[Case], Said], str]] = {
    "verified": (
        _judge_proof,
        "see what `decanter model judge proof` refutes, and learn with another --method or flow",
    ),
    "passed": (_judge_passes, "mend the traces that failed, or leave them out by name"),
    "accepted": (_judge_acceptance, "learn with traces in which these events happen"),
    "clamps": (_clamps, "learn with traces that reach these temperatures"),
    "diverging": (
        _judge_divergence,
        "look at that trace's picture: the sensor, or a cause that `decanter diagnose` names",
    ),
    "acceptable": (_judge_percent, "look at that trace's picture; `decanter diagnose` names what is missing"),
    "coverage": (_judge_coverage, "learn with more traces of the kind that it misses, or look at the sensor's noise"),
    "persistence": (_persistence, "learn with more starts and stops; `decanter diagnose` names what is missing"),
    "unseen": (_unseen, "validate along traces that it has not seen"),
    "from a plant": (_from_plant, "learn from the plant's own traces"),
}
"""Every criterion by name: whether it is kept (None: not known) with its figure, and the next step where it is not."""


def _traces(count: int) -> str:
    return f"{count} trace{'' if count == 1 else 's'}"
