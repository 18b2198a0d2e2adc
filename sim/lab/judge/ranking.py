"""Several models on the same traces: composite score, wins, paired tests between them, and fitness for deployment."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from math import isfinite, nan

import numpy as np

from sim.artefacts import JudgedCriterion, Word
from sim.lab.judge.differences import Paired, compare_families, unit_differences
from sim.lab.judge.fitness import Facts, FitnessLimits, fitness_verdict, judge
from sim.lab.judge.results import TRAINED_VALUES, Seen, TraceResult
from sim.lab.judge.worth import ForecastSkill
from sim.sha import DEFAULT_UNIT

ERROR_CHANCE = 0.05


@dataclass(frozen=True, slots=True)
class Weights:
    """Of the composite score S = mae * MAE + largest * max |error| + scatter * sigma(error), all in degC.

    The defaults sum to 1, so that S is in degC too: half for the usual error, which a forecast lives on, three tenths
    for the worst one, which an alarm lives on, two for the scatter, which no offset can repair. Raises ValueError.
    """

    mae: float = 0.5
    largest: float = 0.3
    scatter: float = 0.2

    def __post_init__(self) -> None:
        values = (self.mae, self.largest, self.scatter)
        if not all(isfinite(value) and value >= 0 for value in values) or not any(values):
            raise ValueError(f"the weights of the score must be numbers of at least 0, not all 0; got {values}")


@dataclass(frozen=True, slots=True)
class Standing:
    """One model's place. All figures are means over the `common` traces of the ranking but `traces` and `failed`.

    `rank` is None and the figures are NaN without a common trace. `wins` counts the common traces on which its score
    is the lowest (one shared by k models counts 1/k). `seen` are the traces that it was trained on. `score_percent` is
    the score in per cent of each trace's readings, over the `percent_traces` whose readings are not all 0.
    """

    entrant: str
    rank: int | None
    score: float
    mae: float
    largest: float
    scatter: float
    coverage: float
    crps: float
    persistence: float
    wins: float
    traces: int
    failed: int
    seen: Mapping[str, Seen] = field(default_factory=dict)
    findings: tuple[JudgedCriterion, ...] = ()
    score_percent: float = nan
    percent_traces: int = 0

    @property
    def fitness(self) -> Word:
        """Whether it may be used."""
        return fitness_verdict(self.findings).word

    @property
    def in_sample(self) -> str:
        """The words to put beside its figures; empty when it saw none of the traces."""
        if not self.seen:
            return ""
        doubt = "" if "content" in self.seen.values() else ", by name"
        return f"in-sample ({len(self.seen)} of {self.traces} traces{doubt})"


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """Two models on the traces that both have: `difference` of the scores (one - other), degC, and what it tells.

    `p` is corrected for all pairs (Holm). `better` is the model that is shown to be better, or None; `wins` are the
    traces on which each has the lower score (equal ones count a half for both).
    """

    one: str
    other: str
    difference: Paired
    p: float
    better: str | None
    sentence: str
    wins: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Ranking:
    """The models, best first; those that could not be ranked come last. `scores`: entrant -> trace -> S in `unit`.

    `skill` is that of their forecasts along the same traces, where these were made: it stands beside the free run.
    """

    standings: tuple[Standing, ...]
    pairs: tuple[Pair, ...]
    common: tuple[str, ...]
    scores: Mapping[str, Mapping[str, float]]
    weights: Weights
    notes: tuple[str, ...] = ()
    unit: str = DEFAULT_UNIT
    skill: ForecastSkill | None = None


def rank(
    results: Sequence[TraceResult],
    facts: Mapping[str, Facts] | None = None,
    *,
    weights: Weights | None = None,
    limits: FitnessLimits | None = None,
    seed: int = 0,
    skill: ForecastSkill | None = None,
) -> Ranking:
    """Ranks the models of a campaign by their mean score over the traces that all of them got through.

    `facts` are by entrant (see `entrants`); `skill`, if given, goes into the ranking as it is. A model without any
    figure is listed without a rank and takes no trace from the others. Raises ValueError when there is no result, or
    two of one model on one trace.
    """
    by_entrant = entrants(results)
    used, known = weights or Weights(), facts or {}
    scores: dict[str, dict[str, float]] = {}
    for name, own in by_entrant.items():
        figures = {trace: score(result, used) for trace, result in own.items() if not result.failure}
        scores[name] = {trace: value for trace, value in figures.items() if isfinite(value)}
    # Only what has a score somewhere decides which traces are common: a model that failed everywhere would leave none.
    ranked = [name for name, own in scores.items() if own]
    first = scores[ranked[0]] if ranked else {}
    common = tuple(trace for trace in first if all(trace in scores[name] for name in ranked))
    wins = dict.fromkeys(by_entrant, 0.0)
    for trace in common:
        least = min(scores[name][trace] for name in ranked)
        winners = [name for name in ranked if scores[name][trace] == least]
        for name in winners:
            wins[name] += 1.0 / len(winners)
    standings = []
    for name, own in by_entrant.items():
        shared = [own[trace] for trace in common if trace in own and not own[trace].failure]
        percents = [result.percent(score(result, used)) for result in shared]
        percents = [percent for percent in percents if isfinite(percent)]
        entrant = known.get(name, Facts())
        standings.append(
            Standing(
                entrant=name,
                rank=None,
                score=_mean([score(result, used) for result in shared]),
                mae=_mean([result.at_samples.mae for result in shared]),
                largest=_mean([result.max_error for result in shared]),
                scatter=_mean([result.error_sigma for result in shared]),
                coverage=_mean([result.coverage for result in shared]),
                crps=_mean([result.crps for result in shared]),
                persistence=_mean([result.persistence for result in shared]),
                wins=wins[name],
                traces=len(own),
                failed=sum(bool(result.failure) for result in own.values()),
                seen={trace: result.seen for trace, result in own.items() if result.seen in TRAINED_VALUES},
                findings=judge(list(own.values()), entrant, limits or FitnessLimits()),
                score_percent=_mean(percents),
                percent_traces=len(percents),
            )
        )
    # Best first, those without a score last; the name decides between equal ones, so that the order does not depend on
    # that of the results. Equal scores share a rank.
    standings.sort(key=lambda each: (not isfinite(each.score), each.score, each.entrant))
    placed = tuple(
        replace(each, rank=1 + sum(rival.score < each.score for rival in standings)) if isfinite(each.score) else each
        for each in standings
    )
    return Ranking(
        standings=placed,
        pairs=_pairs([each.entrant for each in placed if scores[each.entrant]], scores, seed),
        common=common,
        scores=scores,
        weights=used,
        notes=_notes(by_entrant, scores, placed, common),
        unit=results[0].unit,
        skill=skill,
    )


def entrants(results: Sequence[TraceResult]) -> dict[str, dict[str, TraceResult]]:
    """Entrant -> trace -> result. A model that ran under several semantics is one for each, "model (resampled)".

    Raises ValueError when there is no result, or two of one model on one trace.
    """
    if not results:
        raise ValueError("there is no result to rank: give models and traces, or the results of a campaign")
    kinds: dict[str, set[str]] = {}
    for result in results:
        kinds.setdefault(result.model, set()).add(result.semantics)
    table: dict[str, dict[str, TraceResult]] = {}
    for result in results:
        several = len(kinds[result.model]) > 1 and result.semantics
        name = f"{result.model} ({result.semantics})" if several else result.model
        own = table.setdefault(name, {})
        if result.trace in own:
            raise ValueError(
                f"model {name!r} has two results on the trace {result.trace!r}; give every model and every trace a "
                "name of its own"
            )
        own[result.trace] = result
    return table


def score(result: TraceResult, weights: Weights) -> float:
    """S of one trace, degC; NaN where a figure is missing."""
    parts = (result.at_samples.mae, result.max_error, result.error_sigma)
    return sum(
        weight * part
        for weight, part in zip((weights.mae, weights.largest, weights.scatter), parts, strict=True)
        if weight
    )


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else nan


def _pairs(names: Sequence[str], scores: Mapping[str, Mapping[str, float]], seed: int) -> tuple[Pair, ...]:
    """Every two of `names` on the traces that both have, in the order of the names."""
    couples = list(combinations(names, 2))
    rng = np.random.default_rng(seed)
    differences = [unit_differences(scores[first], scores[second]) for first, second in couples]
    pairs = []
    for (first, second), values, (test, p) in zip(
        couples, differences, compare_families(differences, rng), strict=True
    ):
        below, above, ties = int((values < 0).sum()), int((values > 0).sum()), int((values == 0).sum())
        better = None
        if test.n and len(couples) * test.least > ERROR_CHANCE:
            # Even all traces on one side would not do: that is said instead of "not told apart", which sounds as if the
            # two were alike.
            sentence = (
                f"nothing can be told from {test.n} trace{'' if test.n == 1 else 's'}: even if one were better "
                f"on all, p would be {min(1.0, len(couples) * test.least):.2g} with {len(couples)} "
                f"pair{'' if len(couples) == 1 else 's'}"
            )
        elif not test.n:
            sentence = "nothing can be told: they have no trace in common"
        elif p < ERROR_CHANCE and test.excludes_zero:
            # Both: the signed-rank test knows only order and sign, the interval only the mean.
            better, worse = (first, second) if test.mean < 0 else (second, first)
            sentence = f"{better} is better than {worse}"
        else:
            sentence = "not told apart"
        pairs.append(
            Pair(
                one=first,
                other=second,
                difference=test,
                p=p,
                better=better,
                sentence=sentence,
                wins=(below + ties / 2, above + ties / 2),
            )
        )
    return tuple(pairs)


def _notes(
    by_entrant: Mapping[str, Mapping[str, TraceResult]],
    scores: Mapping[str, Mapping[str, float]],
    standings: Sequence[Standing],
    common: Sequence[str],
) -> tuple[str, ...]:
    notes = [f"{name} has no figure on any trace, so it is not ranked" for name in by_entrant if not scores[name]]
    left = sorted({trace for own in scores.values() for trace in own} - set(common))
    if left:
        lacking = {name for name, own in scores.items() if own for trace in left if trace not in own}
        notes.append(f"not compared on {', '.join(left)}: without a figure of {', '.join(sorted(lacking))}")
    if not common and any(scores.values()):
        notes.append("there is no trace on which all models have a figure, so there is no order among them")
    # Which traces these are is in the readings, so that it is the same for all models that have a score.
    without = max((len(common) - each.percent_traces for each in standings if each.rank), default=0)
    if without:
        notes.append(
            f"S % leaves out {without} of {len(common)} traces: their readings are all 0, or their size is not known"
        )
    seeing = {each.entrant: {trace for trace in each.seen if trace in common} for each in standings if each.rank}
    if len({frozenset(traces) for traces in seeing.values()}) > 1:
        favoured = ", ".join(name for name, traces in seeing.items() if traces)
        notes.append(f"in-sample: {favoured} saw some of these traces in training, which favours it against the others")
    return tuple(notes)
