"""Queries about runs are answered: each kind by the rule that fits it, rare events by importance splitting.

`answer` is for queries that need runs, `decide_symbolic` for symbolic ones. Every kind has one function below, which
draws the runs, hands them to the statistical rule and says the result in one sentence.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import ceil, log, sqrt
from typing import Literal

import numpy as np
import scipy

from sim.lab.checking.query import decide
from sim.lab.checking.query import tree as q
from sim.lab.checking.smc.chunks import Threads
from sim.lab.checking.smc.monitors import PreparedPath, Totals, approximations, cuts, prepare_path
from sim.lab.checking.smc.rules import (
    Draw,
    Progress,
    RuleOutcome,
    anytime,
    fixed_run_estimate,
    paired,
    sprt,
    to_half_width,
)
from sim.lab.checking.smc.runs import Sampler, Trajectory, engine, extremes, sampler, trajectories
from sim.lab.checking.smc.splitting import PilotFailed, refusal, split_estimate
from sim.lab.checking.smc.start import Start
from sim.sha import SHA, Array

Rule = Literal["sequential", "fixed", "anytime"]

MOST_RUNS, LONGEST_RUN = 100_000_000, 1e9
"""Runs that a query may ask for, and their length (s)."""

RARE_AFTER_RUNS = 10_000
"""Runs without a success (or without a failure) after which importance splitting takes over."""

MIN_SPLIT_STEPS = 200
"""Steps of a run at least when it is split: a run goes on from the end of the step in which it reached a level."""

_ORDERS = {
    "greater": "the left one is greater",
    "smaller": "the left one is smaller",
    "equal": "they differ by no more than delta",
    "not decided": "undecided within the runs allowed",
}


@dataclass(frozen=True, slots=True)
class QuerySettings:
    """How a query is to be answered: a confidence of 1 - `alpha`, an interval of half-width `epsilon`, the `rule`.

    `delta` is half the indifference region of a test. `runs` asks for that many runs instead; `most` is where a rule
    gives up. `rare`: importance splitting at once.
    """

    alpha: float = 0.05
    epsilon: float = 0.05
    rule: Rule = "sequential"
    runs: int | None = None
    delta: float = 0.01
    most: int = 1_000_000
    seed: int = 0
    rare: bool = False

    @property
    def level(self) -> float:
        """The confidence, 0..1."""
        return 1.0 - self.alpha


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What a query's runs say. `verdict` is that of a hypothesis, comparison or symbolic query, None elsewhere and
    where it stays undecided. `numbers` are the figures by name, `notes` what limits them, one sentence each.

    `passages` (n,) are the moments (s) of the goal in each run, inf without; `courses` those of a simulation; `levels`
    those of importance splitting, (degC, the chance to reach it).
    """

    query: q.Query
    kind: str
    sentence: str
    verdict: bool | None = None
    numbers: Mapping[str, float]
    rule: str
    runs: int
    seed: int
    start: str
    notes: tuple[str, ...] = ()
    passages: Array | None = None
    courses: tuple[Trajectory, ...] = ()
    levels: tuple[tuple[float, float], ...] = ()


def answer(
    query: q.Query,
    start: Start,
    settings: QuerySettings | None = None,
    report: Progress = lambda _what, _share: None,
    threads: Threads | None = None,
) -> Answer:
    """The answer to a query about runs from `start` (`initial`, `believed`).

    Equal arguments give equal answers, whatever `threads` help with many runs. Raises ValueError for what cannot be
    answered, with the reason, and for symbolic queries, which need no runs (`decide_symbolic`).
    """
    chosen = settings or QuerySettings()
    if isinstance(query, q.Symbolic):
        raise ValueError("a symbolic query is decided over the locations, not answered by runs")
    if chosen.rare and not isinstance(query, q.Probability):
        raise ValueError("importance splitting answers Pr[...](<> ...) and Pr[...]([] ...) without a comparison")
    if isinstance(query, q.PairedComparison):
        parts: tuple[q.Probability | q.Expectation | q.Simulation, ...] = (query.left, query.right)
    else:
        parts = (query.question if isinstance(query, q.Hypothesis) else query,)
    for runs in (chosen.runs, *(part.runs for part in parts)):
        if runs is not None and not 1 <= runs <= MOST_RUNS:
            raise ValueError(f"{runs} runs cannot be made; ask for a number from 1 to {MOST_RUNS}")
    for part in parts:
        if not 0.0 < part.bound <= LONGEST_RUN:
            raise ValueError(f"a run of {part.bound:g} s cannot be made; the bound lies above 0 and at most at 1e9 s")
        path = part.path if isinstance(part, q.Probability) else None
        if isinstance(path, q.BoundedResponse) and (last := part.bound + path.span.high) > LONGEST_RUN:
            raise ValueError(f"the last answer is due after {last:g} s, and runs are followed for 1e9 s at most")
    match query:
        case q.Probability():
            return _probability(query, start, chosen, report, threads)
        case q.Hypothesis():
            return _hypothesis(query, start, chosen, report, threads)
        case q.PairedComparison():
            return _comparison(query, start, chosen, report, threads)
        case q.Expectation():
            return _expectation(query, start, chosen, report, threads)
    return _simulation(query, start, chosen, report)


def prepare_question(question: q.Probability, start: Start) -> PreparedPath:
    """The path of a question, ready to be followed. Raises ValueError for what cannot be followed."""
    return prepare_path(question.path, tuple(place.name for place in start.world.sha.locations), question.bound)


# ------------------------------------------------------------------ one function for each kind of query


def _probability(
    query: q.Probability, start: Start, settings: QuerySettings, report: Progress, threads: Threads | None
) -> Answer:
    """The probability of a path by the settings' rule, or by importance splitting.

    Splitting is done at once if the settings ask for it, and when a rule ended without any success (for `[]`, without
    any failure) in at least RARE_AFTER_RUNS runs on a path that can be split.
    """
    path = prepare_question(query, start)
    if settings.rare:
        return _rare(query, path, start, settings, report)
    # Whoever asks for a number of runs gets the fixed rule.
    fixed = bool(settings.runs or query.runs) or settings.rule == "fixed"
    runs = (settings.runs or query.runs or hoeffding_runs(settings)) if fixed else settings.most
    drawn = sampler(start.world, (path,), settings.seed, threads, runs)
    outcomes = _outcomes(drawn)
    if fixed:
        outcome = fixed_run_estimate(outcomes, runs, settings.level, progress=report)
    else:
        rule = anytime if settings.rule == "anytime" else to_half_width
        outcome = rule(outcomes, settings.epsilon, settings.level, most=runs, progress=report)
    estimate = outcome.estimate

    # The contrary of `[]` is what may be rare: there a share of exactly 1 says that no run has shown it.
    never = estimate.probability == (0.0 if isinstance(query.path, q.Eventually) else 1.0)
    what = "the event came" if isinstance(query.path, q.Eventually) else "a violation came"
    advice: tuple[str, ...] = ()
    if never and not refusal(path) and not start.world.under_effects:
        if estimate.runs >= RARE_AFTER_RUNS:
            try:
                rarer = _rare(query, path, start, settings, report)
            except PilotFailed as error:
                advice = (str(error),)
            else:
                why = f"{what} not once in {estimate.runs} runs, so importance splitting was used"
                return replace(rarer, notes=(why, *rarer.notes))
        else:
            advice = (f"{what} not once in {estimate.runs} runs: --rare says how rare it is, by importance splitting",)

    sentence = f"Pr = {_interval(estimate.probability, estimate.low, estimate.high, settings)}"
    if not outcome.decided:
        sentence += f"; the runs ended before the interval was as narrow as ±{settings.epsilon:g}"
    return _format_answer(query, "probability", sentence, outcome=outcome, drawn=drawn, start=start, advice=advice)


def hoeffding_runs(settings: QuerySettings) -> int:
    """Runs of the fixed rule where none are asked for: enough for the half-width at any probability (Hoeffding)."""
    return ceil(log(2.0 / settings.alpha) / (2.0 * settings.epsilon**2))


def _hypothesis(
    query: q.Hypothesis, start: Start, settings: QuerySettings, report: Progress, threads: Threads | None
) -> Answer:
    """Whether a probability is at least (at most) p, by Wald's sequential test."""
    most = settings.runs or query.question.runs or settings.most
    drawn = sampler(start.world, (prepare_question(query.question, start),), settings.seed, threads, most)
    test = sprt.wald_test(query.op, query.p, settings.delta, settings.alpha, settings.alpha)
    outcome = sprt.sprt(_outcomes(drawn), test, most=most, progress=report)
    word = {True: "holds", False: "does not hold", None: "undecided"}[outcome.holds]
    estimate = outcome.estimate
    sentence = f"Pr {query.op} {query.p:g}: {word}; Pr = "
    sentence += _interval(estimate.probability, estimate.low, estimate.high, settings)
    return _format_answer(query, "hypothesis", sentence, outcome=outcome, drawn=drawn, start=start)


def _comparison(
    query: q.PairedComparison, start: Start, settings: QuerySettings, report: Progress, threads: Threads | None
) -> Answer:
    """Which of two probabilities is greater, both seen on the same runs (common random numbers)."""
    most = settings.runs or settings.most
    sides = (prepare_question(query.left, start), prepare_question(query.right, start))
    drawn = sampler(start.world, sides, settings.seed, threads, most)

    def pairs(runs: int) -> tuple[Array, Array]:
        left, right = drawn.draw(runs).T.astype(float)
        return left, right

    comparison = paired.compare(pairs, settings.delta, settings.level, most=most, progress=report)
    difference = _interval(comparison.difference, comparison.low, comparison.high, settings)
    numbers = {
        "difference": comparison.difference,
        "low": comparison.low,
        "high": comparison.high,
        "discordant": float(comparison.discordant),
    }
    for name, side in (("left", comparison.left), ("right", comparison.right)):
        numbers |= {name: side.probability, f"{name} low": side.low, f"{name} high": side.high}
    numbers |= _left_out_count(drawn)
    return Answer(
        query=query,
        kind="comparison",
        sentence=f"Pr(left) - Pr(right) = {difference}: {_ORDERS[comparison.answer]}",
        verdict=comparison.holds,
        numbers=numbers,
        rule=f"{comparison.rule}, delta {comparison.delta:g}",
        runs=comparison.left.runs,
        seed=settings.seed,
        start=start.words,
        notes=("both sides are looked at on the same runs: common random numbers", *_sampler_notes(drawn)),
    )


def _rare(query: q.Probability, path: PreparedPath, start: Start, settings: QuerySettings, report: Progress) -> Answer:
    """A probability by importance splitting; for `[]` that of the contrary is estimated."""
    if start.world.under_effects:
        raise ValueError(
            f"importance splitting does not follow effects, and model {start.world.sha.name!r} has some; leave out "
            "--rare and ask for more runs"
        )
    where = cuts((path,))
    # No step over several pieces (`lines`): a run's way to the levels in between counts, wherever they are.
    made = engine(start.world, replace(where, longest=min(where.longest, path.bound / MIN_SPLIT_STEPS), lines=None))
    # The spawn key lies beyond those of the chunks of plain runs (`runs.generator`): no random number is used twice.
    rng = np.random.Generator(np.random.SFC64(np.random.SeedSequence(entropy=settings.seed, spawn_key=(1 << 20,))))
    splitting = split_estimate(made, path, rng, confidence=settings.level, report=report)
    estimate = splitting.estimate
    if isinstance(query.path, q.Always):
        # The complement is said as "1 - x": 1 - 1e-6 printed with four digits would read 1.
        numbers = {"probability": 1 - estimate.probability, "low": 1 - estimate.high, "high": 1 - estimate.low}
        numbers |= {"violation": estimate.probability, "violation_low": estimate.low, "violation_high": estimate.high}
        low, high = f"1 - {estimate.high:.4g}", f"1 - {estimate.low:.4g}"
        sentence = f"Pr = 1 - {estimate.probability:.4g}, {_percent(settings)} interval [{low}, {high}]"
    else:
        numbers = {"probability": estimate.probability, "low": estimate.low, "high": estimate.high}
        sentence = f"Pr = {_interval(estimate.probability, estimate.low, estimate.high, settings)}"
    numbers["relative error"] = splitting.relative
    notes = [*made.notes, *approximations(path)]
    if settings.runs or query.runs:
        notes.append("splitting makes as many runs as it needs: the number asked for was not looked at")
    if not estimate.probability:
        notes.append("no repetition reached the event: it is rarer than can be seen, and the interval says nothing")
    rule = (
        f"importance splitting, fixed effort, {splitting.repetitions} repetitions, Student's t corrected for skewness"
    )
    return Answer(
        query=query,
        kind="probability",
        sentence=sentence,
        numbers=numbers,
        rule=rule,
        runs=estimate.runs,
        seed=settings.seed,
        start=start.words,
        notes=tuple(notes),
        levels=splitting.levels,
    )


def _expectation(
    query: q.Expectation, start: Start, settings: QuerySettings, report: Progress, threads: Threads | None
) -> Answer:
    """The mean of a course's extreme over the runs, with a Student interval."""
    runs = settings.runs or query.runs
    statistics, totals, notes = extremes(
        start.world,
        query.expression,
        bound=query.bound,
        runs=runs,
        seed=settings.seed,
        greatest=query.extreme == "max",
        report=report,
        threads=threads,
    )
    mean, numbers = statistics.mean, {"mean": statistics.mean}
    sentence = f"E({query.extreme}) = {mean:.4g} (one run)"
    if runs > 1:
        deviation = sqrt(statistics.squares / (runs - 1))
        # Student's t: the extremes are not normal, but their mean nearly is for the runs that anybody asks for.
        half = float(scipy.special.stdtrit(runs - 1, 1.0 - settings.alpha / 2.0)) * deviation / sqrt(runs)
        numbers |= {"low": mean - half, "high": mean + half, "sigma": deviation}
        sentence = f"E({query.extreme}) = {_interval(mean, numbers['low'], numbers['high'], settings)}"
        sentence += f"; over the runs sigma {deviation:.4g}, from {statistics.least:.4g} to {statistics.greatest:.4g}"
    return Answer(
        query=query,
        kind="expectation",
        sentence=sentence,
        numbers=numbers | {"least": statistics.least, "greatest": statistics.greatest},
        rule="mean of the runs, Student's t",
        runs=runs,
        seed=settings.seed,
        start=start.words,
        notes=(*notes, *_run_notes(totals)),
    )


def _simulation(query: q.Simulation, start: Start, settings: QuerySettings, report: Progress) -> Answer:
    """The courses of the query's expressions."""
    runs = settings.runs or query.runs
    report(f"{runs} runs", 0.0)
    courses, totals, notes = trajectories(start.world, query.expressions, query.bound, runs=runs, seed=settings.seed)
    numbers: dict[str, float] = {}
    for row, label in enumerate(query.labels):
        last = np.array([course.values[row, -1] for course in courses])
        numbers |= {f"{label}: mean at the end": float(last.mean())}
        numbers |= {f"{label}: least": min(float(course.values[row].min()) for course in courses)}
        numbers |= {f"{label}: greatest": max(float(course.values[row].max()) for course in courses)}
    return Answer(
        query=query,
        kind="simulation",
        sentence=f"{runs} courses of {', '.join(query.labels)} over {query.bound:.6g} s",
        numbers=numbers,
        rule="courses of the runs, at the ends of their steps",
        runs=runs,
        seed=settings.seed,
        start=start.words,
        notes=(*notes, *_run_notes(totals)),
        courses=courses,
    )


def decide_symbolic(query: q.Symbolic, sha: SHA) -> Answer:
    """The answer to a symbolic query, with the word that shows it where one does. Raises ValueError as `decide`."""
    verdict = decide(query, sha)
    sentence = f"{query.kind}: {'holds' if verdict.holds else 'does not hold'}"
    if verdict.shows:
        sentence += f"; {verdict.shows}: {_route(verdict.path, verdict.word) or sha.initial}"
        if verdict.loop:
            sentence += f", then again and again {_route(verdict.loop_path, verdict.loop)}"
    return Answer(
        query=query,
        kind="symbolic",
        sentence=sentence,
        verdict=verdict.holds,
        numbers={"locations looked at": float(verdict.explored)},
        rule=f"exhaustive, {verdict.explored} locations looked at",
        runs=0,
        seed=0,
        start="",
        notes=verdict.notes,
    )


def _route(places: tuple[str, ...], word: tuple[str, ...]) -> str:
    """`a -e-> b -f-> c`: the path's locations with the symbols between them; a loop's path has no first location."""
    ahead = places[1:] if len(places) > len(word) else places
    begin = places[0] if len(places) > len(word) else ""
    return begin + "".join(f" -{symbol}-> {place}" for symbol, place in zip(word, ahead, strict=True))


# ------------------------------------------------------------------ what they share


def _outcomes(drawn: Sampler) -> Draw:
    """The verdicts on the first path as the rules take them."""
    return lambda runs: drawn.draw(runs)[:, 0].astype(float)


def _format_answer(
    query: q.Probability | q.Hypothesis,
    kind: str,
    sentence: str,
    *,
    outcome: RuleOutcome,
    drawn: Sampler,
    start: Start,
    advice: tuple[str, ...] = (),
) -> Answer:
    """The answer of a rule that looked at one path."""
    estimate = outcome.estimate
    return Answer(
        query=query,
        kind=kind,
        sentence=sentence,
        verdict=outcome.holds,
        numbers={"probability": estimate.probability, "low": estimate.low, "high": estimate.high}
        | _left_out_count(drawn),
        rule=outcome.rule,
        runs=estimate.runs,
        seed=drawn.seed,
        start=start.words,
        notes=(*advice, *([outcome.note] if outcome.note else []), *_sampler_notes(drawn)),
        passages=drawn.passages()[: estimate.runs] if drawn.when else None,
    )


def _left_out_count(drawn: Sampler) -> dict[str, float]:
    """How many causes the weak responses have left out; nothing where there is no such response."""
    weak = any(isinstance(path.path, q.BoundedResponse) and path.path.weak for path in drawn.paths)
    return {"causes left out": float(drawn.left_out.sum())} if weak else {}


def _sampler_notes(drawn: Sampler) -> tuple[str, ...]:
    """The engine's notes, what happened to the runs, what is approximated."""
    notes = [*drawn.engine.notes, *_run_notes(drawn.totals)]
    notes += dict.fromkeys(sentence for path in drawn.paths for sentence in approximations(path))
    for path, count in zip(drawn.paths, drawn.left_out.tolist(), strict=True):
        if isinstance(path.path, q.BoundedResponse) and path.path.weak:
            last = path.bound - path.path.span.high
            notes.append(
                f"weak: in the runs that hold, {count} causes later than {last:g} s, whose answer may be due after the "
                f"run, are left out"
            )
    if drawn.unclear:
        notes.append(
            f"in {drawn.unclear} runs the goal and the end of the condition fell into one step; they count as failed"
        )
    return tuple(notes)


def _run_notes(totals: Totals) -> tuple[str, ...]:
    """What happened to the runs, in sentences."""
    counts = (
        (totals.clamps, "times a run left the model's range and was put back to its border"),
        (totals.limited, "steps ran at the maximum rate: the noise in them is that of the unlimited flow"),
        (totals.cut, "runs had more stays than are followed and remained where they were"),
    )
    return tuple(f"{count} {words}" for count, words in counts if count)


def _percent(settings: QuerySettings) -> str:
    """The confidence as text."""
    return f"{100.0 * (1.0 - settings.alpha):g} %"


def _interval(value: float, low: float, high: float, settings: QuerySettings) -> str:
    """A figure with its interval as text."""
    return f"{value:.4g}, {_percent(settings)} interval [{low:.4g}, {high:.4g}]"
