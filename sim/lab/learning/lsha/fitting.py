"""The physical parameters over a learned structure: flows of single locations, targets and rates, stays, bands.

The structure is given. `plan_fit` asks the model-identification query of each location, `fitted_model` fits everything
together (levels of a `resample` automaton, or one joint free-run fit), `bands` fits the parameters again without parts
of the readings, to see how far its forecasts of those parts are off.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sim.lab.learning import (
    RATE_PARAMETERS,
    FitShape,
    FreeRuns,
    HeldOutForecasts,
    Indices,
    MachineSpread,
    Memories,
    choose,
    cross_validate,
    drift_noise,
    fit_free_run,
    fit_noise,
    fit_stays,
    folds,
    initial_law,
    judged_part,
    learn_plain,
    machine_spread,
    next_stay,
    sample_runs,
    splits,
    with_parameters,
    with_range,
)
from sim.lab.learning.lsha.evidence import segment_scatter, weigh_segments
from sim.lab.learning.lsha.flow_hypotheses import MAX_KNOTS, Flowing, choose_flows, flow_shape, make_flow, positions
from sim.lab.learning.lsha.hypothesis import HypothesisAutomaton
from sim.lab.learning.lsha.identify import Identified, identify
from sim.lab.learning.lsha.segments import find_next_stays, levels
from sim.lab.learning.lsha.settings import LshaSettings
from sim.lab.learning.lsha.structures import Structure
from sim.lab.learning.lsha.teacher import Teacher, renumber_places
from sim.lab.learning.lsha.transients import TransientLaw
from sim.lab.learning.lsha.words import describe_class
from sim.sha import FIXED_PARAMETER, SHA, Distribution, Entry, Flow, Input, Location, Model, Trace, signal_unit


@dataclass(frozen=True, slots=True)
class LshaLocationFit:
    """What was learned about one location: `words` that lead there, its flow, and the law of its parameter.

    `mu` and `sigma` are the law's, in the parameter's unit; `mu_error` is the standard error of the mean and `scatter`
    the standard deviation between segments apart from that; NaN where nothing is known. `segments` tell the parameter,
    `readings` end a step there, `seconds` were spent there; `rate` is k (1/s) or t0 (s).
    """

    name: str
    words: tuple[str, ...]
    flow: str
    entry: str
    segments: int
    readings: int
    seconds: float
    mu: float
    mu_error: float
    sigma: float
    scatter: float
    rate: float


@dataclass(frozen=True, slots=True)
class FittedHypothesis:
    """The automaton with all parameters, the sensor's standard deviation, raw values of each law, the table, how far
    the targets of the machines lie apart (levels have none), and the memories of heat and of the sensor's error."""

    sha: SHA
    sensor: float
    values: Mapping[str, tuple[float, ...]]
    locations: tuple[LshaLocationFit, ...]
    spread: MachineSpread = field(default_factory=lambda: MachineSpread({}, 0.0, 0.0))
    memories: Memories | None = None

    @property
    def sensor_memory(self) -> float:
        """How long the sensor's error lasts, s; 0 where each reading errs by itself."""
        return max(self.memories.sensor, default=0.0) if self.memories is not None else 0.0

    @property
    def margin(self) -> float:
        """degC by which runs stray from readings: four standard deviations of sensor and drawn levels together.

        A level near the end of the usual range would be clamped half the time.
        """
        drawn = (each.sigma for each in self.locations if each.entry == "resample")
        return 4.0 * float(np.hypot(self.sensor, max(drawn, default=0.0)))


def fit_levels(
    name: str,
    teacher: Teacher,
    *,
    transient: TransientLaw | None,
    hypothesis: HypothesisAutomaton,
    modelled: Sequence[bool],
    words: Sequence[Sequence[str]],
) -> FittedHypothesis:
    """A `resample` automaton: every location draws its level anew on entry, and X stays there.

    Where the location's stays show a `transient` X begins off its level, and settles.
    """
    size = len(hypothesis.names)
    runs, amplitude, doubt = renumber_places(teacher.runs, hypothesis.place), np.zeros(size), np.zeros(size)
    if transient is not None:
        amplitude, doubt = transient.estimates(runs, size)
        runs = transient.remove_transients(runs, amplitude)
    # The words' own places again: what is alike is known of them.
    runs = replace(runs, place=teacher.runs.place)
    sample = weigh_segments(levels(runs, teacher.group), teacher.alike)
    sensor, drift = _inside(runs)
    unknown = drift_noise(teacher.runs)
    place = hypothesis.place[sample.segments.place]
    _, after = find_next_stays(teacher.runs)
    reading = np.bincount(hypothesis.place[after[np.isfinite(teacher.runs.reading)]], minlength=len(hypothesis.names))
    locations, values, table = [], {}, []
    for number, title in enumerate(hypothesis.names):
        of_location = place == number
        if not modelled[number] or not of_location.any():
            locations.append(Location(title, Flow("constant", {"noise": unknown}), entry="none"))
            law = (np.nan, np.nan, np.nan)
        else:
            mean, error, scatter = segment_scatter(sample, of_location)
            # The law is that of X on entry: the level, and what it is off there.
            off = float(amplitude[number])
            law = (mean + off, float(np.hypot(error, doubt[number])), scatter)
            distribution = Distribution("normal", {"mu": law[0], "sigma": float(np.hypot(law[1], law[2]))})
            flow = Flow("constant", {"noise": drift})
            if transient is not None and off:
                flow = Flow("transient", {"tau": transient.tau, FIXED_PARAMETER: -off, "noise": drift})
            locations.append(Location(title, flow, distribution, "resample"))
            values[title] = tuple((sample.segments.value[of_location] + off).tolist())
        table.append(
            _row(
                teacher,
                hypothesis,
                number=number,
                words=words[number],
                location=locations[-1],
                segments=int(of_location.sum()),
                readings=int(reading[number]),
                law=law,
            )
        )
    return FittedHypothesis(_sha(name, locations, hypothesis), sensor, values, tuple(table))


def _inside(runs: FreeRuns) -> tuple[float, float]:
    """(sensor's sigma, random walk in degC/sqrt(s)) inside segments, by the variogram: from the shortest lag to the
    longest one in each segment."""
    stay, _ = find_next_stays(runs)
    known = np.flatnonzero(np.isfinite(runs.reading))
    same = stay[known[1:]] == stay[known[:-1]]
    near = np.column_stack([known[:-1], known[1:]])[same]
    _, first = np.unique(stay[known], return_index=True)
    ends = np.append(first[1:], known.size) - 1
    far = np.column_stack([known[first], known[ends]])[ends - first >= 2]
    if not len(near):
        return 1e-3, 1e-3
    # Half the mean squared difference is sensor^2 at lag 0 and grows by walk^2 / 2 a second: two lags tell both.
    half, lag = _variogram(runs, near)
    sensor = max(float(np.sqrt(half)), 1e-3)
    if len(far) < 3:
        return sensor, 1e-3 * sensor
    half_far, lag_far = _variogram(runs, far)
    walk = max(half_far - half, 0.0) * 2.0 / max(lag_far - lag, 1e-9)
    return sensor, float(max(np.sqrt(walk), 1e-3 * sensor))


def _variogram(runs: FreeRuns, pairs: Indices) -> tuple[float, float]:
    """(half the robust mean squared difference, mean lag) of pairs of readings."""
    gap = np.abs(runs.reading[pairs[:, 1]] - runs.reading[pairs[:, 0]])
    # 1.4826 times the median of |differences| is their standard deviation, and gross ones do not move it.
    limit = 4.0 * max(1.4826 * float(np.median(gap)), 1e-9)
    kept = gap <= limit
    return 0.5 * float(np.mean(gap[kept] ** 2)), float(np.mean(runs.time[pairs[:, 1]] - runs.time[pairs[:, 0]]))


def fit_motion(
    name: str,
    teacher: Teacher,
    *,
    flowing: Flowing,
    hypothesis: HypothesisAutomaton,
    modelled: Sequence[bool],
    words: Sequence[Sequence[str]],
    kinds: Sequence[str],
    budget: int,
    memories: Memories | None,
) -> FittedHypothesis:
    """A `parameter` automaton: all targets, rates and gains together by the likelihood of the free runs."""
    size = len(hypothesis.names)
    place = hypothesis.place
    where = positions(teacher, place, size)
    shape, rated = flow_shape(flowing.hypothesis, teacher, where, modelled, kinds)
    whole = renumber_places(teacher.runs, place)
    runs = sample_runs(whole, budget)
    # The coarse structure's rates are a good start; with flows of their own in single locations there are rates that
    # it did not have, and the coarse scan has to find them.
    begin = flowing.group_rates(rated) if all(kind == flowing.hypothesis.kind for kind in kinds) else None
    fit = fit_free_run(runs, shape, begin=begin)
    order = sorted(set(where))
    groups = np.array([order.index(each) for each in where], dtype=np.intp)
    noise = fit_noise(runs, shape, fit, groups, whole=whole, memories=memories)
    spread = machine_spread(runs, shape, fit, noise=noise, groups=groups, machines=teacher.machines)
    bare = _bare(
        name, teacher, shape=shape, hypothesis=hypothesis, modelled=modelled, unknown=drift_noise(teacher.runs)
    )
    sha = with_parameters(bare, shape, fit)
    segments = flowing.sample.segments
    located, errors = hypothesis.place[segments.place], fit.errors_at_rates
    locations, values, table = [], {}, []
    readings = np.bincount(runs.place[np.isfinite(runs.reading) & ~runs.first], minlength=size)
    for number, location in enumerate(sha.locations):
        of_location, law = located == number, (np.nan, np.nan, np.nan)
        column = int(shape.target[number])
        if column >= 0:
            # The law of m: what is not known of its mean, and the scatter from stay to stay.
            stays = np.unique(runs.stay[(runs.place == number) & ~runs.first]).size
            scatter = next_stay(float(noise.scatter[number]), stays, location.flow.kind)
            law = (float(fit.linear[column]), float(errors[column]), scatter)
            sigma = float(np.hypot(law[1], law[2]))
            params = {**location.flow.params, "noise": float(noise.process[groups[number]])}
            distribution = Distribution("normal", {"mu": law[0], "sigma": sigma})
            location = replace(location, flow=replace(location.flow, params=params), distribution=distribution)
            # The histogram's values: the segments that are known to within twice sigma. Under another flow than that
            # of the segments theirs is another parameter, and the mean has to do.
            sharp = (
                of_location & (np.sqrt(segments.variance) <= 2.0 * sigma) & (kinds[number] == flowing.hypothesis.kind)
            )
            values[location.name] = tuple(segments.value[sharp].tolist()) or (law[0],)
        locations.append(location)
        table.append(
            _row(
                teacher,
                hypothesis,
                number=number,
                words=words[number],
                location=location,
                segments=int(of_location.sum()),
                readings=int(readings[number]),
                law=law,
            )
        )
    sha = replace(_sha(name, locations, hypothesis), effects=(*noise.effects, *spread.effects))
    return FittedHypothesis(sha, noise.sensor, values, tuple(table), spread=spread, memories=noise.memories)


def _bare(
    name: str,
    teacher: Teacher,
    *,
    shape: FitShape,
    hypothesis: HypothesisAutomaton,
    modelled: Sequence[bool],
    unknown: float,
) -> SHA:
    """The automaton with flows but without values, as `with_parameters` wants it."""
    entry: Entry = "none"
    locations = []
    for number, title in enumerate(hypothesis.names):
        if not modelled[number] or shape.target[number] < 0:
            locations.append(Location(title, Flow("constant", {"noise": unknown}), entry=entry))
            continue
        inputs = tuple(
            Input(signal, 0.0, centre)
            for place, (signal, centre) in enumerate(zip(teacher.signals, teacher.centre.tolist(), strict=True))
            if shape.gain[number, place] >= 0
        )
        locations.append(Location(title, make_flow(shape.kinds[number], teacher.prior.tau, inputs)))
    return _sha(name, locations, hypothesis)


def _sha(name: str, locations: Sequence[Location], hypothesis: HypothesisAutomaton) -> SHA:
    return SHA(name, tuple(locations), hypothesis.edges(), hypothesis.names[0])


def _row(
    teacher: Teacher,
    hypothesis: HypothesisAutomaton,
    *,
    number: int,
    words: Sequence[str],
    location: Location,
    segments: int,
    readings: int,
    law: tuple[float, float, float],
) -> LshaLocationFit:
    mu, error, scatter = law
    kind = location.flow.kind
    return LshaLocationFit(
        name=hypothesis.names[number],
        words=tuple(words),
        flow=kind,
        entry=location.entry,
        segments=segments,
        readings=readings,
        seconds=float(teacher.runs.dt[hypothesis.place[teacher.runs.place] == number].sum()),
        mu=mu,
        mu_error=error,
        sigma=float(np.hypot(error, scatter)),
        scatter=scatter,
        rate=location.flow.params.get(RATE_PARAMETERS[kind], float("nan")) if kind in RATE_PARAMETERS else float("nan"),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class FitPlan:
    """A structure ready to be fitted: the flow of each location (`kinds`) and the words that lead there (`words`)."""

    name: str
    temperature: str
    flowing: Flowing
    hypothesis: HypothesisAutomaton
    modelled: Sequence[bool]
    kinds: tuple[str, ...]
    words: tuple[tuple[str, ...], ...]
    memories: Memories | None = None
    identified: tuple[Identified, ...]


def plan_fit(
    name: str,
    temperature: str,
    *,
    teacher: Teacher,
    flowing: Flowing,
    structure: Structure,
    hypothesis: HypothesisAutomaton,
    settings: LshaSettings,
) -> FitPlan:
    """The plan, with the model-identification queries of the single locations answered."""
    size, kind = structure.partition.size, flowing.hypothesis.kind
    keys = structure.classes.keys
    words = tuple(
        tuple(dict.fromkeys(describe_class(keys[row], teacher.alphabet) for row in rows)) for rows in hypothesis.members
    )
    plan = FitPlan(
        name=name,
        temperature=temperature,
        flowing=flowing,
        hypothesis=hypothesis,
        modelled=structure.partition.modelled,
        kinds=(kind,) * size,
        words=words,
        identified=(),
    )
    if flowing.fit is None:
        return plan  # under `resample` there is nothing to ask: a level is a level
    motion, alternatives = choose_flows(flowing, teacher)
    runs = renumber_places(teacher.runs, hypothesis.place)
    answers = identify(
        runs, size, default=kind, motion=motion, alternatives=alternatives, alpha=settings.alpha, n_min=settings.n_min
    )
    return _confirm_flows(plan, answers, teacher)


def _confirm_flows(plan: FitPlan, answers: tuple[Identified, ...], teacher: Teacher) -> FitPlan:
    """Flows of single locations are only taken if the held-out free runs do not get worse by them."""
    kinds = list(plan.kinds)
    for answer in answers:
        kinds[answer.location] = answer.kind
    mixed = replace(plan, kinds=tuple(kinds), identified=answers)
    if mixed.kinds == plan.kinds:
        return mixed
    few = sample_runs(renumber_places(teacher.runs, plan.hypothesis.place), MAX_KNOTS)
    cut = folds(few)
    judged = judged_part(cut) if cut is not None else None
    scores = []
    where = positions(teacher, plan.hypothesis.place, len(plan.kinds))
    for rival in (plan, mixed):
        if cut is not None and judged is not None:
            shape, _ = flow_shape(plan.flowing.hypothesis, teacher, where, plan.modelled, rival.kinds)
            scores.append(cross_validate(cut, shape, fit_free_run(few, shape).rates, fixed=True, judged=judged))
    # The uniform plan counts as the simpler one, whatever the number of rates: mixed flows have to earn their place.
    if len(scores) == 2 and scores[1].score > scores[0].score and choose(scores, [1, 2]) == 1:
        return mixed
    refused = tuple(replace(answer, kept=True, kind=answer.default) for answer in answers)
    return replace(plan, identified=refused)


def fitted_model(
    plan: FitPlan, teacher: Teacher, traces: Sequence[Trace], budget: int
) -> tuple[FittedHypothesis, Model]:
    """All parameters by the readings of `teacher`, and the model with the stays of `traces`."""
    fitted = fit(plan, teacher, budget)
    model = Model(
        sha=with_range(fitted.sha, teacher.runs, fitted.margin),
        alphabet=teacher.alphabet,
        temperature=plan.temperature,
        sensor_sigma=fitted.sensor,
        sensor_memory=fitted.sensor_memory,
        initial=initial_law(traces, plan.temperature),
        unit=signal_unit(traces, plan.temperature),
    )
    return fitted, replace(model, semi_markov=fit_stays(model, traces))


def fit(plan: FitPlan, teacher: Teacher, budget: int) -> FittedHypothesis:
    """All parameters of the automaton by the readings of `teacher`."""
    if plan.flowing.fit is None:
        return fit_levels(
            plan.name,
            teacher,
            transient=plan.flowing.transient,
            hypothesis=plan.hypothesis,
            modelled=plan.modelled,
            words=plan.words,
        )
    return fit_motion(
        plan.name,
        teacher,
        flowing=plan.flowing,
        hypothesis=plan.hypothesis,
        modelled=plan.modelled,
        words=plan.words,
        kinds=plan.kinds,
        budget=budget,
        memories=plan.memories,
    )


MIN_KNOTS = 10


def bands(
    teacher: Teacher,
    traces: Sequence[Trace],
    *,
    temperature: str,
    fitted: Callable[[Teacher], Model],
    seed: int,
    origins: int,
) -> HeldOutForecasts:
    """The forecasts over the parts of `preparation.splits`, `origins` of them a part.

    `fitted` gives the parameters anew for the readings that are known in each part. The structure stays: what is
    learned here is how wrong flows and laws may be.
    """
    rng, runs = np.random.default_rng(seed), teacher.runs
    # `splits` leaves out traces of one row, and runs number the traces that have a temperature: both counts must meet.
    read = [trace for trace in traces if np.isfinite(trace.signals.get(temperature, np.empty(0))).any()]
    usable = np.array([number for number, trace in enumerate(read) if trace.times.size > 1], dtype=np.intp)
    rank = np.searchsorted(usable, runs.trace)
    forecasts = HeldOutForecasts(learn_plain(traces, temperature), seed)
    for part in splits(read):
        forecasts.other_days = part.held is not None
        # The same parts as those of `splits`, in knots: all but the traces held out, or the time before the cut, where
        # a run that goes on beyond it ends.
        known = runs.time < np.asarray(part.since)[rank] if part.held is None else ~np.isin(rank, list(part.held))
        if np.isfinite(runs.reading[known]).sum() >= MIN_KNOTS:
            model = fitted(replace(teacher, runs=runs.select(known), group=teacher.group[known]))
            forecasts.add(model, part.ahead, part.since, rng, origins=origins)
    return forecasts
