"""Probabilities of paths: estimated by a sequential or a fixed rule, tested, compared, or split where they are rare."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sim.checking.query import tree as q
from sim.checking.smc.monitors.path import Watch, approximations, cuts, watch
from sim.checking.smc.record import Answer, Settings, interval, percent, sampler_notes
from sim.checking.smc.rules import paired as sequential_paired
from sim.checking.smc.rules import ratio as sequential_ratio
from sim.checking.smc.rules import sequential
from sim.checking.smc.rules.sequential import Draw, Outcome
from sim.checking.smc.runs import Report, Sampler, engine, sampler
from sim.checking.smc.splitting.levels import NoWay, refusal, split
from sim.checking.smc.start import Start
from sim.sha.trace import Array

RARE_AFTER = 10_000
"""Runs without a success (or without a failure) after which importance splitting takes over."""


SPLIT_STEPS = 200
"""Steps of a run at least when it is split: a run goes on from the end of the step in which it reached a level."""


def probability(query: q.Probability, start: Start, settings: Settings, report: Report) -> Answer:
    """The probability of a path by the settings' rule, or by importance splitting.

    Splitting is done at once if the settings ask for it, and when a rule ended without any success (for `[]`, without
    any failure) in at least RARE_AFTER runs on a path that can be split.
    """
    one = prepared(query, start)
    if settings.rare:
        return rare(one, start, query, settings, report)
    drawn = sampler(start.world, (one,), settings.seed)
    found = _RULES["fixed" if query.runs or settings.runs else settings.rule](drawn, query, settings, report)
    runs, seen = found.estimate.runs, found.estimate.probability
    never = seen == 0.0 if isinstance(query.path, q.Eventually) else seen == 1.0
    came = "the event came" if isinstance(query.path, q.Eventually) else "a violation came"
    advice: tuple[str, ...] = ()
    if never and not refusal(one) and not start.world.sha.effects:
        if runs >= RARE_AFTER:
            try:
                rarer = rare(one, start, query, settings, report)
            except NoWay as error:
                advice = (str(error),)
            else:
                why = f"{came} not once in {runs} runs, so importance splitting was used"
                return replace(rarer, notes=(why, *rarer.notes))
        else:
            advice = (f"{came} not once in {runs} runs: --rare says how rare it is, by importance splitting",)
    numbers = _numbers(found)
    said = f"Pr = {interval(numbers['probability'], numbers['low'], numbers['high'], settings)}"
    if not found.decided:
        said += f"; the runs ended before the interval was as narrow as ±{settings.epsilon:g}"
    return _answer(query, "probability", said, None, numbers, found, drawn, start, settings, advice)


def hypothesis(query: q.Hypothesis, start: Start, settings: Settings, report: Report) -> Answer:
    """Whether a probability is at least (at most) p, by Wald's sequential test."""
    drawn = sampler(start.world, (prepared(query.question, start),), settings.seed)
    test = sequential_ratio.wald_test(query.op, query.p, settings.delta, settings.alpha, settings.alpha)
    most = settings.runs or query.question.runs or settings.most
    found = sequential_ratio.sprt(_draw(drawn), test, most=most, progress=report)
    numbers = _numbers(found)
    word = {True: "holds", False: "does not hold", None: "undecided"}[found.holds]
    said = f"Pr {query.op} {query.p:g}: {word}; Pr = "
    said += interval(numbers["probability"], numbers["low"], numbers["high"], settings)
    return _answer(query, "hypothesis", said, found.holds, numbers, found, drawn, start, settings, ())


_ORDERS = {
    "greater": "the left one is greater",
    "smaller": "the left one is smaller",
    "equal": "they differ by no more than delta",
    "not decided": "undecided within the runs allowed",
}


def comparison(query: q.PairedComparison, start: Start, settings: Settings, report: Report) -> Answer:
    """Which of two probabilities is greater, both seen on the same runs (common random numbers)."""
    drawn = sampler(start.world, (prepared(query.left, start), prepared(query.right, start)), settings.seed)

    def pairs(runs: int) -> tuple[Array, Array]:
        left, right = drawn.draw(runs).T.astype(float)
        return left, right

    most, level = settings.runs or settings.most, 1.0 - settings.alpha
    found = sequential_paired.compare(pairs, settings.delta, level, most=most, progress=report)
    said = (
        f"Pr(left) - Pr(right) = {interval(found.difference, found.low, found.high, settings)}: {_ORDERS[found.answer]}"
    )
    numbers = {
        "difference": found.difference,
        "low": found.low,
        "high": found.high,
        "discordant": float(found.discordant),
    }
    for name, side in (("left", found.left), ("right", found.right)):
        numbers |= {name: side.probability, f"{name} low": side.low, f"{name} high": side.high}
    return Answer(
        query,
        "comparison",
        said,
        found.holds,
        numbers,
        f"{found.rule}, delta {found.delta:g}",
        found.left.runs,
        settings.seed,
        start.words,
        ("both sides are looked at on the same runs: common random numbers", *sampler_notes(drawn)),
    )


def rare(one: Watch, start: Start, query: q.Probability, settings: Settings, report: Report) -> Answer:
    """A probability by importance splitting; for `[]` that of the contrary is estimated."""
    if start.world.sha.effects:
        raise ValueError(
            f"importance splitting does not follow effects, and model {start.world.sha.name!r} has some; leave out "
            "--rare and ask for more runs"
        )
    where = cuts((one,), one.bound)
    made = engine(start.world, replace(where, longest=min(where.longest, one.bound / SPLIT_STEPS)))
    rng = np.random.Generator(np.random.SFC64(np.random.SeedSequence(entropy=settings.seed, spawn_key=(1 << 20,))))
    found = split(made, one, rng, confidence=1.0 - settings.alpha, report=report)
    estimate = found.estimate
    numbers = {"probability": estimate.probability, "low": estimate.low, "high": estimate.high}
    said = interval(estimate.probability, estimate.low, estimate.high, settings)
    if isinstance(query.path, q.Always):
        numbers = {"probability": 1 - estimate.probability, "low": 1 - estimate.high, "high": 1 - estimate.low}
        numbers |= {"violation": estimate.probability, "violation_low": estimate.low, "violation_high": estimate.high}
        low, high = f"1 - {estimate.high:.4g}", f"1 - {estimate.low:.4g}"
        said = f"Pr = 1 - {estimate.probability:.4g}, {percent(settings)} interval [{low}, {high}]"
    else:
        said = f"Pr = {said}"
    numbers["relative error"] = found.relative
    notes = [*made.notes, *approximations(one)]
    if settings.runs or query.runs:
        notes.append("splitting makes as many runs as it needs: the number asked for was not looked at")
    if not estimate.probability:
        notes.append("no repetition reached the event: it is rarer than can be seen, and the interval says nothing")
    return Answer(
        query,
        "probability",
        said,
        None,
        numbers,
        f"importance splitting, fixed effort, {found.repetitions} repetitions, Student's t corrected for skewness",
        estimate.runs,
        settings.seed,
        start.words,
        tuple(notes),
        levels=found.levels,
    )


def prepared(question: q.Probability, start: Start) -> Watch:
    """The path of a question, ready to be followed. Raises ValueError for what cannot be followed."""
    return watch(question.path, tuple(place.name for place in start.world.sha.locations), question.bound)


def _draw(drawn: Sampler) -> Draw:
    return lambda runs: drawn.draw(runs)[:, 0].astype(float)


def _fixed(drawn: Sampler, query: q.Probability, settings: Settings, report: Report) -> Outcome:
    runs = settings.runs or query.runs or sequential_size(settings)
    return sequential.fixed(_draw(drawn), runs, 1.0 - settings.alpha, progress=report)


def sequential_size(settings: Settings) -> int:
    """Runs of the fixed rule where none are asked for: enough for the half-width at any probability (Hoeffding)."""
    return int(np.ceil(np.log(2.0 / settings.alpha) / (2.0 * settings.epsilon**2)))


def _sequential(drawn: Sampler, _query: q.Probability, settings: Settings, report: Report) -> Outcome:
    level = 1.0 - settings.alpha
    return sequential.to_half_width(_draw(drawn), settings.epsilon, level, most=settings.most, progress=report)


def _anytime(drawn: Sampler, _query: q.Probability, settings: Settings, report: Report) -> Outcome:
    level = 1.0 - settings.alpha
    return sequential.anytime(_draw(drawn), settings.epsilon, level, most=settings.most, progress=report)


_RULES: dict[str, Callable[[Sampler, q.Probability, Settings, Report], Outcome]] = {
    "sequential": _sequential,
    "fixed": _fixed,
    "anytime": _anytime,
}


def _numbers(found: Outcome) -> dict[str, float]:
    estimate = found.estimate
    return {"probability": estimate.probability, "low": estimate.low, "high": estimate.high}


def _answer(
    query: q.Probability | q.Hypothesis,
    kind: str,
    said: str,
    verdict: bool | None,
    numbers: dict[str, float],
    found: Outcome,
    drawn: Sampler,
    start: Start,
    settings: Settings,
    advice: tuple[str, ...],
) -> Answer:
    notes = (*advice, *([found.note] if found.note else []), *sampler_notes(drawn))
    passages: Array | None = drawn.passages()[: found.estimate.runs] if drawn.when else None
    return Answer(
        query,
        kind,
        said,
        verdict,
        numbers,
        found.rule,
        found.estimate.runs,
        settings.seed,
        start.words,
        notes,
        passages,
    )
