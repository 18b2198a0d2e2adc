"""Which flow the plant has: hypotheses over a coarse structure, each judged by the free runs of held-out traces."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from sim.lab.learning import (
    FOLDS,
    FitShape,
    FreeRuns,
    HeldOutErrors,
    Indices,
    LearningError,
    LinearFit,
    build_shape,
    choose,
    cross_validate,
    distance,
    fit_at_rates,
    folds,
    labels,
    predict,
    pushed_targets,
    sample_runs,
    steps,
)
from sim.lab.learning.lsha.evidence import MIN_WORD_SHARE, SegmentSample, weigh_segments
from sim.lab.learning.lsha.identify import rate_alone
from sim.lab.learning.lsha.merging import Partition, TooManyQueriesError, learn_partition
from sim.lab.learning.lsha.segments import Motion, find_next_stays, levels, parameters
from sim.lab.learning.lsha.teacher import Teacher, renumber_places
from sim.lab.learning.lsha.transients import TransientLaw, transient_law
from sim.lab.learning.lsha.words import Classes, WordHistory, build_classes
from sim.sha import SHA, Array, Entry, Flow, Input, Location, Mask, Switch

MAX_COARSE_CONTEXTS = 12
"""Contexts that the flow hypotheses are compared on; the others count as the nearest of these."""
REWEIGHTING_ROUNDS = 2
"""Rounds of reweighting while rates are compared."""
COARSE_MERGE_TOLERANCE = 0.05
"""Merge tolerance of the structures on which flows are compared."""
FEW_TRACES, FEW_EVENTS = 20, 1_000
"""Traces and events up to which each trace is held out by itself."""
MAX_KNOTS = 3_000
"""Knots to which the runs are sampled for the comparison."""
FIRST_QUERIES, QUERIES_PER_WORD = 5_000, 5
"""Queries after which the memory `word` is given up: so many, and for each word more of them. A structure that explains
the words needs little more than one a word; where there is none, each word is compared with a location for each chance.
"""
MAX_WORD_EVENTS = 1_500
"""Events up to which the memory `word` is always tried; with more, more of a word than its last move has to explain
something."""


@dataclass(frozen=True, slots=True)
class FlowHypothesis:
    """A flow for all locations, how a location is entered, and whether one rate is shared by all or by position of the
    first switch.

    `alone`: the rate is that of the single segments, before it is known which of them belong together.
    """

    kind: str
    entry: Entry = "parameter"
    by_switch: bool = False
    alone: bool = False

    @property
    def label(self) -> str:
        """In words, for tables."""
        jump = ", resampled on entry" if self.entry == "resample" else ""
        alone = ", rate of single segments" if self.alone else ""
        return self.kind + jump + (", rate per switch position" if self.by_switch else "") + alone


FLOW_HYPOTHESES: tuple[FlowHypothesis, ...] = (
    FlowHypothesis("constant", "resample"),
    FlowHypothesis("transient", "resample"),
    FlowHypothesis("linear"),
    FlowHypothesis("logarithmic"),
    FlowHypothesis("exponential"),
    FlowHypothesis("exponential", alone=True),
    FlowHypothesis("exponential", by_switch=True),
    FlowHypothesis("driven"),
    FlowHypothesis("driven", by_switch=True),
)


@dataclass(frozen=True, slots=True)
class Contender:
    """A row of a table of rivals: held-out figures are NaN when there were too few data to hold any out.

    `likelihood` is the held-out log-likelihood per reading (or segment), `parameters` how many it has; errors in degC.
    `note` says why one was not tried to the end.
    """

    label: str
    parameters: int
    likelihood: float
    held_out_rmse: float
    held_out_mae: float
    chosen: bool
    note: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Flowing:
    """A flow hypothesis with its rates and gains, and what the segments say under it.

    `shape`, `fit` and `rates` belong to the coarse structure whose location of each state `groups` (S,) tells; they
    are None under `resample`, which has no rates. `transient` is what readings have besides their stay's level.
    """

    hypothesis: FlowHypothesis
    groups: Indices
    shape: FitShape | None
    fit: LinearFit | None
    rates: Mapping[str, float]
    sample: SegmentSample
    transient: TransientLaw | None = None

    def group_rates(self, groups: Sequence[str]) -> Array:
        """(r,) the rates of the given groups; one that the coarse structure did not have gets the geometric mean."""
        usual = float(np.exp(np.mean(np.log(list(self.rates.values()))))) if self.rates else 1.0
        return np.array([self.rates.get(group, usual) for group in groups])


def choose_flow(teacher: Teacher, kind: str | None, alpha: float, n_min: int) -> tuple[Flowing, tuple[Contender, ...]]:
    """The hypothesis of greatest held-out likelihood (one-standard-error rule), of `kind` if one is given.

    Each hypothesis gets the structure that suits it: words merged with the memory `direction` or `word`, whichever is
    better, and the tolerance COARSE_MERGE_TOLERANCE.
    Raises LearningError when the data cannot show a flow of that kind.
    """
    groups, names = coarse(teacher)
    few = sample_runs(teacher.runs, MAX_KNOTS)
    cut = folds(few)
    # Only what the data can tell from a simpler hypothesis: inputs that move, two positions of the switch.
    moving = bool(teacher.prior.gain)
    switched = len({_position(key, teacher) for key in names}) > 1
    rivals = [
        rival
        for rival in FLOW_HYPOTHESES
        if kind in (None, rival.kind) and (moving or rival.kind != "driven") and (switched or not rival.by_switch)
    ]
    if not rivals:
        raise LearningError(
            f"the flow {kind!r} needs a level signal of the alphabet that moves, and there is none; "
            "choose another default flow"
        )
    candidates = [fit_hypothesis(rival, teacher, groups, names, few, alpha=alpha, n_min=n_min) for rival in rivals]
    if kind is None:
        # Without an amplitude it is the constant flow itself, and not a rival.
        candidates = [each for each in candidates if each.hypothesis.kind != "transient" or each.transient is not None]
    direction, word = build_classes(teacher.words, "direction"), build_classes(teacher.words, "word")
    scored: list[tuple[HeldOutErrors | None, int]] = []
    for candidate in candidates:
        # Each is judged by the memory that suits it best, or a flow would be refused for a structure's sake.
        over = [_judge_candidate(candidate, teacher, classes=direction, cut=cut, alpha=alpha, n_min=n_min)]
        if not why_not_word_by_word(teacher, candidate.sample):
            with suppress(TooManyQueriesError):
                over.append(_judge_candidate(candidate, teacher, classes=word, cut=cut, alpha=alpha, n_min=n_min))
        scored.append(max(over, key=lambda pair: pair[0].score if pair[0] is not None else 0.0))
    sizes = [size for _, size in scored]
    known = [held for held, _ in scored if held is not None]
    best = choose(known, sizes) if len(known) == len(scored) else sizes.index(min(sizes))
    table = (row(each.hypothesis.label, size, held) for each, (held, size) in zip(candidates, scored, strict=True))
    return candidates[best], tuple(replace(each, chosen=number == best) for number, each in enumerate(table))


def transfer_hypothesis(hypothesis: FlowHypothesis, teacher: Teacher, alpha: float, n_min: int) -> Flowing:
    """The hypothesis over other traces than those that chose it."""
    groups, names = coarse(teacher)
    return fit_hypothesis(
        hypothesis, teacher, groups, names, sample_runs(teacher.runs, MAX_KNOTS), alpha=alpha, n_min=n_min
    )


def fit_hypothesis(
    hypothesis: FlowHypothesis,
    teacher: Teacher,
    groups: Indices,
    names: Sequence[WordHistory],
    few: FreeRuns,
    *,
    alpha: float,
    n_min: int,
) -> Flowing:
    """The hypothesis fitted to the coarse structure, and every segment's parameter under it."""
    if hypothesis.entry == "resample":
        law, runs = None, teacher.runs
        if hypothesis.kind == "transient":
            # What follows a rise is another transient than what follows a fall.
            classes = build_classes(teacher.words, "direction")
            known = renumber_places(runs, classes.of_state)
            law = transient_law(known, len(classes), alpha, n_min)
            amplitude = np.zeros(len(classes)) if law is None else law.amplitudes(known, len(classes))
            law = law if amplitude.any() else None
            runs = runs if law is None else law.remove_transients(known, amplitude)
        return Flowing(
            hypothesis=hypothesis,
            groups=groups,
            shape=None,
            fit=None,
            rates={},
            sample=weigh_segments(levels(replace(runs, place=teacher.runs.place), teacher.group), teacher.alike),
            transient=law,
        )
    # One more location stands for all states without a law: runs begin where one of those ends.
    where = [*(_position(key, teacher) for key in names), ""]
    shape, rated = flow_shape(hypothesis, teacher, where, [True] * len(names) + [False])
    if hypothesis.alone:
        rates = np.full(shape.rate_centre.size, rate_alone(teacher.runs, hypothesis.kind))
        fit = fit_at_rates(renumber_places(few, groups), shape, rates)
    else:
        rates, fit = _rates(renumber_places(few, groups), shape)
    motion = _motion(renumber_places(teacher.runs, groups), shape, fit, rates)
    unit = float(np.median(shape.spread[np.unique(shape.target[shape.target >= 0])]))
    segments = parameters(teacher.runs, teacher.group, motion, unit**2)
    by_group = dict(zip(rated, rates.tolist(), strict=True))
    return Flowing(
        hypothesis=hypothesis,
        groups=groups,
        shape=shape,
        fit=fit,
        rates=by_group,
        sample=weigh_segments(segments, teacher.alike),
    )


def _rates(runs: FreeRuns, shape: FitShape) -> tuple[Array, LinearFit]:
    """The rates of least loss: all shifted together on a grid of the prior, then each by itself in halving steps."""
    best = fit_at_rates(runs, shape, np.exp(shape.rate_centre))
    logs, scale = shape.rate_centre, best.sigma
    if not logs.size:
        return np.empty(0), best
    # Losses are compared at the scale of the first fit: each at its own would call all fits nearly equal.
    best = fit_at_rates(runs, shape, np.exp(logs), REWEIGHTING_ROUNDS, scale)
    shifts = [shift * shape.rate_spread for shift in (-1.0, 1.0, 2.0, 3.0, 4.0)]
    for trial in [logs + shift for shift in shifts]:
        logs, best = _better(runs, shape, trial=trial, logs=logs, best=best, scale=scale)
    for step in (0.5, 0.25, 0.12):
        for unit in np.eye(logs.size):
            for sign in (-1.0, 1.0):
                logs, best = _better(
                    runs, shape, trial=logs + sign * step * unit * shape.rate_spread, logs=logs, best=best, scale=scale
                )
    return np.exp(logs), best


def _better(
    runs: FreeRuns, shape: FitShape, *, trial: Array, logs: Array, best: LinearFit, scale: float
) -> tuple[Array, LinearFit]:
    """The trial if its loss is less, else what was best before."""
    fit = fit_at_rates(runs, shape, np.exp(trial), REWEIGHTING_ROUNDS, scale)
    return (trial, fit) if fit.loss < best.loss else (logs, best)


def _judge_candidate(
    candidate: Flowing, teacher: Teacher, *, classes: Classes, cut: FreeRuns | None, alpha: float, n_min: int
) -> tuple[HeldOutErrors | None, int]:
    """(held-out errors over the structure by these classes, number of parameters).

    Where single words are told apart, and where events are few, the structure is learned anew without each fold of the
    traces: with a location for each chance meeting of two words, a structure that knows the held-out trace is no judge.
    Otherwise it is learned once, from so many events that one fold hardly changes it.
    """
    hypothesis, sample = candidate.hypothesis, candidate.sample
    delta = COARSE_MERGE_TOLERANCE * sample.spread
    partition = merge_classes(classes, sample, teacher, delta=delta, alpha=alpha, n_min=n_min)
    place = partition.location[classes.of_state]
    size = partition.laws
    if candidate.shape is not None:
        shape, rated = flow_shape(hypothesis, teacher, positions(teacher, place, partition.size), partition.modelled)
        size += int((shape.gain >= 0).any()) * shape.gain.shape[1] + shape.rate_centre.size
    if candidate.transient is not None:
        amplitude = candidate.transient.amplitudes(renumber_places(teacher.runs, place), partition.size)
        size += 1 + int(np.count_nonzero(amplitude))
    if cut is None:
        return None, size
    traces = np.unique(cut.trace)
    anew = classes.memory == "word" or teacher.words.events <= MAX_WORD_EVENTS
    if not (anew and traces.size >= FOLDS and np.array_equal(teacher.group, teacher.runs.trace)):
        if candidate.shape is None:
            return hold_out_levels(renumber_places(cut, place), candidate.transient), size
        return cross_validate(renumber_places(cut, place), shape, candidate.group_rates(rated), fixed=True), size
    parts = held_out_parts(teacher, traces.size, FOLDS)
    fold, part = (np.searchsorted(traces, each) % parts for each in (cut.trace, sample.segments.group))
    error, kept = np.empty(len(cut)), np.isfinite(cut.reading)
    for held in range(parts):
        fewer = merge_classes(classes, sample, teacher, delta=delta, alpha=alpha, n_min=n_min, use=part != held)
        place, in_fold = fewer.location[classes.of_state], fold == held
        runs = renumber_places(cut, place)
        if candidate.shape is None:
            error[in_fold] = _level_errors(runs, in_fold, candidate.transient)
            continue
        # Targets are those of the other runs; rates stay, as one fold hardly changes what all runs share.
        shape, rated = flow_shape(hypothesis, teacher, positions(teacher, place, fewer.size), fewer.modelled)
        rates = candidate.group_rates(rated)
        fit = fit_at_rates(runs.select(~in_fold), shape, rates)
        error[in_fold] = runs.reading[in_fold] - predict(runs.select(in_fold), shape, fit.linear, rates, fit.sigma)
    return HeldOutErrors(error[kept], np.unique(cut.run[kept], return_inverse=True)[1]), size


def why_not_word_by_word(teacher: Teacher, sample: SegmentSample) -> str:
    """Why the memory `word` is not worth its cost, in words; empty if it is tried."""
    if teacher.words.events <= MAX_WORD_EVENTS or sample.longer >= MIN_WORD_SHARE:
        return ""
    return f"not tried: more of a word than its last move explains {sample.longer:.1%} of what that leaves"


def held_out_parts(teacher: Teacher, groups: int, least: int) -> int:
    """Into how many parts the groups of the data are dealt, each held out once: `least`, or each by itself.

    That is done where they are few: which ones are held out together would decide as much as what they say.
    """
    return max(groups, least) if groups <= FEW_TRACES and teacher.words.events <= FEW_EVENTS else least


def merge_classes(
    classes: Classes,
    sample: SegmentSample,
    teacher: Teacher,
    *,
    delta: float,
    alpha: float,
    n_min: int,
    use: Mask | None = None,
    patient: bool = False,
) -> Partition:
    """The classes merged by what the segments (those to `use`) say of them; `delta` in the parameter's unit.

    Raises TooManyQueriesError where single words do not fall into few locations, unless one is `patient`.
    """
    modelled = np.zeros(len(classes), dtype=bool)
    modelled[classes.of_state[teacher.modelled]] = True
    evidence = sample.pool_classes(classes.of_state, len(classes), n_min, use)
    limited = classes.memory == "word" and not patient
    most = FIRST_QUERIES + QUERIES_PER_WORD * len(classes) if limited else inf
    return learn_partition(classes, evidence, modelled, delta=delta, alpha=alpha, n_min=n_min, most=most)


def positions(teacher: Teacher, place: Indices, size: int) -> list[str]:
    """The position of the first switch in which each location spends most of its time."""
    spent: list[dict[str, float]] = [{} for _ in range(size)]
    seconds = np.bincount(teacher.runs.place, teacher.runs.dt, place.size)
    for state, where, time in zip(teacher.words.states, place.tolist(), seconds.tolist(), strict=True):
        position = _position(state, teacher)
        spent[where][position] = spent[where].get(position, 0.0) + time
    return [max(times, key=lambda name: times[name]) for times in spent]


def row(label: str, size: int, held: HeldOutErrors | None) -> Contender:
    """A row of a table of rivals, not chosen yet."""
    nan = float("nan")
    figures = (held.score, held.rmse, held.mae) if held is not None else (nan, nan, nan)
    return Contender(label, size, *figures, chosen=False)


def coarse(teacher: Teacher) -> tuple[Indices, tuple[WordHistory, ...]]:
    """((S,) the coarse location of each state, what the states of each location have in common)."""
    words, runs = teacher.words, teacher.runs
    seconds = np.bincount(runs.place, runs.dt, len(words.states))
    total: dict[WordHistory, float] = {}
    for state, spent, modelled in zip(words.states, seconds.tolist(), teacher.modelled.tolist(), strict=True):
        if modelled:
            key = WordHistory(state.context)
            total[key] = total.get(key, 0.0) + spent
    # Those in which most time is spent: the flow is judged where there is most to be seen of it.
    first = list(total)
    kept = sorted(first, key=lambda key: (-total[key], first.index(key)))[:MAX_COARSE_CONTEXTS]
    nearest = {
        key: min(kept, key=lambda other: distance(key.context, other.context, teacher.alphabet)) for key in total
    }
    number = {key: n for n, key in enumerate(kept)}
    groups = [
        number[nearest[WordHistory(state.context)]] if modelled else len(kept)
        for state, modelled in zip(words.states, teacher.modelled.tolist(), strict=True)
    ]
    return np.array(groups, dtype=np.intp), tuple(kept)


def _position(state: WordHistory, teacher: Teacher) -> str:
    """The position of the first switch, "" where there is none or it is not known."""
    for value, channel in zip(state.context, teacher.alphabet.channels, strict=True):
        if isinstance(channel, Switch):
            return "" if value is None else labels(channel)[value]
    return ""


def flow_shape(
    hypothesis: FlowHypothesis,
    teacher: Teacher,
    positions: Sequence[str],
    free: Sequence[bool],
    kinds: Sequence[str] = (),
) -> tuple[FitShape, tuple[str, ...]]:
    """(parameter vector of the `free` of L locations with that flow, the groups that its rates belong to).

    `positions` (L,) are those of the first switch; the other locations count as constant. `kinds` (L,) are the flows of
    the single locations where they differ; a rate is shared by locations of one kind only.

    All locations share the gain of an input, and inputs count from their means over all time, so that a target means
    the same in all of them.
    """
    inputs = tuple(
        Input(signal, 0.0, centre)
        for signal, centre in zip(teacher.signals, teacher.centre.tolist(), strict=True)
        if hypothesis.kind == "driven" and signal in teacher.prior.gain
    )
    each = list(kinds) or [hypothesis.kind] * len(positions)
    names = [str(number) for number in range(len(positions))]
    locations = [
        Location(name, make_flow(kind, teacher.prior.tau, inputs if kind == "driven" else ()))
        for name, kind in zip(names, each, strict=True)
    ]
    sha = SHA("flows", tuple(locations), (), names[0])
    rates = {
        name: (position if hypothesis.by_switch else "all") + ("" if kind == hypothesis.kind else f" {kind}")
        for name, position, kind in zip(names, positions, each, strict=True)
    }
    fitted = [name for name, own in zip(names, free, strict=True) if own]
    shape, known = build_shape(
        sha, fitted, teacher.signals, teacher.prior, rates=rates, gains=dict.fromkeys(names, "all")
    )
    return shape, known.rates


def make_flow(kind: str, tau: float, inputs: tuple[Input, ...] = ()) -> Flow:
    """A flow of that kind without noise; a driven one without inputs is exponential."""
    relaxing = {"k": 1.0 / tau}
    known = {"exponential": relaxing, "driven": relaxing, "logarithmic": {"t0": tau}, "transient": {"tau": tau}}
    rate = known.get(kind, {})
    if kind == "driven" and not inputs:
        kind = "exponential"
    return Flow(kind, {**rate, "noise": 0.0}, inputs)


def hold_out_levels(runs: FreeRuns, transient: TransientLaw | None = None) -> HeldOutErrors:
    """The held-out errors of a level for each place, entered anew at each event: the free run of `resample`.

    With a `transient` each place has its amplitude besides, if the other folds show one. Folds are those of
    `cross_validate`. A place that the other folds do not have gets the level of all.
    """
    order = np.cumsum(runs.first) - 1
    error = np.empty(len(runs))
    for held in range(min(FOLDS, int(order[-1]) + 1)):
        error[order % FOLDS == held] = _level_errors(runs, order % FOLDS == held, transient)
    finite = np.isfinite(runs.reading)
    return HeldOutErrors(error[finite], np.unique(order[finite], return_inverse=True)[1])


def _level_errors(runs: FreeRuns, held: Mask, transient: TransientLaw | None) -> Array:
    """(m,) the readings of `held` (n,), less the mean of the others' in the same place (of all others without any)."""
    _, place = find_next_stays(runs)
    if transient is not None:
        runs = transient.remove_transients(runs, transient.amplitudes(runs.select(~held), int(place.max()) + 1))
    rest = ~held & np.isfinite(runs.reading)
    count = np.bincount(place[rest], minlength=int(place.max()) + 1)
    total = np.bincount(place[rest], runs.reading[rest], minlength=count.size)
    level = np.where(count > 0, total / np.maximum(count, 1), runs.reading[rest].mean())
    return np.asarray(runs.reading[held] - level[place[held]])


def _motion(runs: FreeRuns, shape: FitShape, fit: LinearFit, rates: Array) -> Motion:
    """The fitted flow's step at every knot, and what the gains add to its target."""
    decay, pull = steps(runs, shape, np.log(rates))
    decay = np.where(runs.first, 1.0, decay)
    return Motion(decay, pull, pushed_targets(runs, shape, fit.linear))


def choose_flows(flowing: Flowing, teacher: Teacher) -> tuple[Motion, dict[str, Flow]]:
    """(the motion under the chosen flow, the other flows that a location may have instead).

    The rate of an alternative comes from the median length of the segments: it is only asked whether its shape fits.
    """
    if flowing.shape is None or flowing.fit is None:
        raise ValueError("a resampled level has no motion")
    order = tuple(flowing.rates)
    motion = _motion(
        renumber_places(teacher.runs, flowing.groups), flowing.shape, flowing.fit, flowing.group_rates(order)
    )
    seconds = np.bincount(teacher.runs.stay, teacher.runs.dt)
    typical = max(float(np.median(seconds[seconds > 0])), 1e-3)
    kinds = ("constant", "linear", "logarithmic", "exponential")
    own = "exponential" if flowing.hypothesis.kind == "driven" else flowing.hypothesis.kind
    return motion, {kind: make_flow(kind, typical) for kind in kinds if kind != own}
