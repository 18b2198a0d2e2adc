"""UPPAAL's answers beside this program's own, for the same model, trace and jumps of the noise: one row a quantity."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import nan, sqrt

import numpy as np
import scipy

from sim.engine import Policy, Prediction, SimulatedRuns, moments, schedule, simulate
from sim.lab.checking.language import QueryError, parse_query
from sim.lab.checking.query import tree as q
from sim.lab.checking.smc import QuerySettings, Start, initial
from sim.lab.checking.smc import answer as native_answer
from sim.lab.uppaal.document import ExportedQuery
from sim.lab.uppaal.output import VerifytaAnswer
from sim.lab.uppaal.queries import compatibility
from sim.lab.uppaal.replay import ReplayedTrace
from sim.sha import Array, Model, Trace, distributions

CONFIDENCE_LEVEL = 0.95
NATIVE_RUNS = 4000
INSTANT_COUNT = 4
"""Times at which the simulated courses are compared, evenly over the replay, its end included."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparisonRow:
    """One quantity: both figures, their difference (UPPAAL - native), and the interval of each (95 %, NaN: none).

    `agree` says whether the intervals overlap; None where there is nothing to compare.
    """

    quantity: str
    native: float
    uppaal: float
    difference: float
    native_interval: tuple[float, float]
    uppaal_interval: tuple[float, float]
    agree: bool | None
    note: str = ""


@dataclass(frozen=True, slots=True)
class Native:
    """This program's own runs over the replay, at each tick and event, and the closed-form moments there.

    `answers` is where the checker's runs start; None where its policy for events without an edge is another.
    """

    replay: ReplayedTrace
    runs: SimulatedRuns
    moments: Prediction
    answers: Start | None = None


def native_runs(
    model: Model, trace: Trace, replay: ReplayedTrace, policy: Policy, tick: int, rng: np.random.Generator
) -> Native:
    """Runs with outputs where the exported model draws its noise; from the same start, along the same events."""
    begin = float(trace.times[np.isfinite(trace.signals[model.temperature])][0])
    # Outputs at each event and, from there on, every `tick` seconds: the exported clock starts anew at each event, and
    # so do the ticks.
    borders = np.unique(np.array([0.0, *replay.times, replay.duration, replay.time_bound]))
    ticks = [np.arange(low, high, tick) for low, high in pairwise(borders)] if tick else []
    outputs = np.unique(np.concatenate([borders, *ticks]))
    steps = schedule(model, trace.events, begin + outputs, inputs=trace, policy=policy)
    law = replay.x0
    own = moments(steps, distributions.mean(law), distributions.variance(law))
    known = policy == "resync" and distributions.variance(law) == 0
    return Native(replay, simulate(steps, law, NATIVE_RUNS, rng), own, initial(model, trace) if known else None)


def compare(
    questions: Sequence[ExportedQuery], answers: Sequence[VerifytaAnswer], native: Native, model: Model
) -> list[ComparisonRow]:
    """One row for each quantity that both have; a query that only UPPAAL can answer gets its verdict alone."""
    rows: list[ComparisonRow] = []
    for question, answer in zip(questions, answers, strict=False):
        try:
            query = parse_query(question.formula, model)
        except QueryError:
            query = None  # about the players and counters, which only the exported model has
        match query:
            case q.Simulation():
                rows += _courses(answer, native)
            case q.Expectation(expression=q.Quantity(kind="temperature"), extreme=extreme):
                rows.append(_expectation(question, answer, native, extreme))
            case q.Probability(path=(q.Eventually() | q.Always()) as path) if (
                seen := _count_native(path, native)
            ) is not None:
                rows.append(_probability(question, answer, seen))
            case q.Probability() | q.Hypothesis() | q.PairedComparison() if native.answers is not None:
                rows.append(_checker_row(question, query, answer, native.answers))
            case _:
                # What only the exported model can be asked: UPPAAL's figure and verdict, and ours about acceptance.
                figure = answer.mean if answer.mean is not None else nan
                row = _row(question.formula, uppaal=figure, note=_verdict_words(answer))
                if question.formula == compatibility().formula:
                    accepts = "accepts every event" if native.replay.accepted else "does not accept every event"
                    agree = answer.satisfied == native.replay.accepted
                    row = replace(row, agree=agree, note=f"{row.note}; native: {accepts}")
                rows.append(row)
    return rows


_NO_INTERVAL = (nan, nan)
"""No interval."""


def _row(
    quantity: str,
    native: float = nan,
    own: tuple[float, float] = _NO_INTERVAL,
    uppaal: float = nan,
    theirs: tuple[float, float] = _NO_INTERVAL,
    *,
    note: str = "",
) -> ComparisonRow:
    known = bool(np.isfinite([*own, *theirs]).all())
    return ComparisonRow(
        quantity=quantity,
        native=native,
        uppaal=uppaal,
        difference=uppaal - native,
        native_interval=own,
        uppaal_interval=theirs,
        agree=own[0] <= theirs[1] and theirs[0] <= own[1] if known else None,
        note=note,
    )


def _courses(answer: VerifytaAnswer, native: Native) -> list[ComparisonRow]:
    """Mean temperature over UPPAAL's runs against the closed form, at instants that every run has reached."""
    courses = answer.courses.get("m_1.Temp", ())
    if not courses or not all(course.points for course in courses):
        return [_row("simulate m_1.Temp", note="no courses were printed")]
    # A run that UPPAAL stopped early ends the comparison for all.
    span = min(native.replay.duration, *(course.points[-1][0] for course in courses))
    rows = []
    clock = native.moments.times - native.moments.times[0]
    for share in range(1, INSTANT_COUNT + 1):
        at = int(np.searchsorted(clock, span * share / INSTANT_COUNT, side="right")) - 1
        time, values = float(clock[at]), np.empty(len(courses))
        for row, course in enumerate(courses):
            instants, printed = (np.array(column) for column in zip(*course.points, strict=True))
            # Of several points at one instant the last counts, after the jump; times are printed with 6 digits.
            before = int(np.searchsorted(instants, time + 1e-6, side="right")) - 1
            if before + 1 >= instants.size or instants[max(before, 0)] >= time:
                values[row] = printed[max(before, 0)]
            else:
                values[row] = np.interp(time, instants[before : before + 2], printed[before : before + 2])
        mean, width = _mean_interval(values)
        exact = float(native.moments.mean[at])
        rows.append(_row(f"mean Temp at {clock[at]:.1f} s", exact, (exact, exact), mean, width))
    return rows


def _mean_interval(values: Array) -> tuple[float, tuple[float, float]]:
    """The mean, and its Student interval; NaN bounds for a single value."""
    mean = float(np.mean(values))
    if values.size < 2:
        return mean, (nan, nan)
    half = float(
        scipy.stats.t.ppf((1 + CONFIDENCE_LEVEL) / 2, values.size - 1) * np.std(values, ddof=1) / sqrt(values.size)
    )
    return mean, (mean - half, mean + half)


def _expectation(question: ExportedQuery, answer: VerifytaAnswer, native: Native, extreme: str) -> ComparisonRow:
    """The mean extreme of the runs; UPPAAL's interval is its half-width, or comes from its histogram."""
    values = native.runs.temperatures.max(axis=1) if extreme == "max" else native.runs.temperatures.min(axis=1)
    mean, own = _mean_interval(values)
    if answer.mean is None:
        return _row(question.formula, mean, own, note="no estimate was printed")
    half, bins = answer.half_width, answer.histogram
    if half is None:
        # Some versions print the mean alone: then its interval is that of the histogram, whose bins stand for their
        # middles. Without a histogram there is none.
        half, total = nan, sum(bins.counts) if bins else 0
        if bins is not None and total >= 2:
            counts = np.array(bins.counts)
            middles = bins.low + bins.width * (np.arange(counts.size) + 0.5)
            deviations = middles - np.average(middles, weights=counts)
            spread = float(np.sqrt(np.sum(counts * deviations**2) / (total - 1)))
            half = float(scipy.stats.t.ppf((1 + CONFIDENCE_LEVEL) / 2, total - 1)) * spread / sqrt(total)
    theirs = (answer.mean - half, answer.mean + half)
    return _row(question.formula, mean, own, answer.mean, theirs)


def _count_native(path: q.Eventually | q.Always, native: Native) -> int | None:
    """In how many of the native runs the path holds, where it is one comparison of the temperature over all time."""
    inner = path.inner
    if path.span != q.TimeSpan() or not isinstance(inner, q.Compare) or inner.left != q.Quantity("temperature"):
        return None
    if not isinstance(inner.right, q.Number):
        return None
    level, x = inner.right.value, native.runs.temperatures
    held = {"<": x < level, "<=": x <= level, ">": x > level, ">=": x >= level}.get(inner.op)
    if held is None:
        return None
    return int((held.any(axis=1) if isinstance(path, q.Eventually) else held.all(axis=1)).sum())


def _probability(question: ExportedQuery, answer: VerifytaAnswer, seen: int) -> ComparisonRow:
    """The share of runs; UPPAAL's own is successes / runs where it says so, else the middle of its interval."""
    share = scipy.stats.binomtest(seen, NATIVE_RUNS).proportion_ci(CONFIDENCE_LEVEL, method="exact")
    own = (float(share.low), float(share.high))
    if answer.low is None or answer.high is None:
        return _row(question.formula, seen / NATIVE_RUNS, own, note="no interval was printed")
    counted = answer.successes is not None and bool(answer.runs)
    theirs = (answer.successes or 0) / (answer.runs or 1) if counted else (answer.low + answer.high) / 2
    return _row(question.formula, seen / NATIVE_RUNS, own, theirs, (answer.low, answer.high))


def _checker_row(question: ExportedQuery, query: q.Query, answer: VerifytaAnswer, start: Start) -> ComparisonRow:
    """A query that only the checker (docs/checking.md) answers here: its figure, or its verdict."""
    own = native_answer(query, start, QuerySettings(runs=None if isinstance(query, q.Hypothesis) else NATIVE_RUNS))
    if own.verdict is not None:
        return replace(_row(question.formula, note=_verdict_words(answer)), agree=answer.satisfied == own.verdict)
    figures = (own.numbers.get("low", nan), own.numbers.get("high", nan))
    low, high = (nan if end is None else end for end in (answer.low, answer.high))
    return _row(question.formula, own.numbers.get("probability", nan), figures, (low + high) / 2, (low, high))


def _verdict_words(answer: VerifytaAnswer) -> str:
    return {True: "UPPAAL: satisfied", False: "UPPAAL: NOT satisfied", None: "UPPAAL: not decided"}[answer.satisfied]
