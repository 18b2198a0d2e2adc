"""The experiment that tells rival effects apart: set-points and their durations, with what each pair would differ by.

A handful of schedules of what a person can set is run through the given model under each rival's own fit. What one
rival foresees and another could not follow, even with its parameters fitted anew to the measured traces and the
experiment together, is the expected gain: half of d' (V + C N^-1 C')^-1 d, the expected log-likelihood ratio of two
Gaussian forecasts (Atkinson & Fedorov 1975, T-optimality), d being the difference of the courses, V the fitted noise, C
the sensitivities of the rival that is wrong and N what the measured traces say of its parameters.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from math import ceil, floor, hypot, inf, log10, sqrt

import numpy as np

from sim.effects import SETTABLE
from sim.lab.discrepancy.diagnosis import ExperimentStep, PairOfRivals, ProposedExperiment
from sim.lab.discrepancy.fitting import (
    CourseState,
    Fitted,
    Frame,
    Record,
    Whitener,
    build_record,
    move_frame,
    patiently,
    readings_in_window,
    restore_fit,
    run_frame,
    window_grid,
    window_sensitivity,
)
from sim.lab.discrepancy.judging import NamingResult
from sim.lab.discrepancy.naming import EffectEvidence, confirm, margin_of_class
from sim.lab.discrepancy.rules import DecisionRules
from sim.lab.discrepancy.screen import MIN_VISIBLE_ROWS, TIME_PARAMETERS, shortest_visible
from sim.lab.learning import LearningError, first_switch
from sim.sha import Array, Bins, Mask, Model, Trace

MAX_RIVALS = 4
"""Rivals that one experiment is to tell apart."""
REST_S = 3600.0
"""Seconds of rest with which an experiment begins."""
PAUSE_S = 900.0
"""Seconds between two starts that follow each other closely."""
DWELL_TAUS = (0.5, 1.5, 3.0)
"""Lengths of a dwell that are tried, in thermal time constants of the running machine."""
SHORTEST_DWELL_S, LONGEST_DWELL_S = 300.0, 3.0 * 3600.0
"""Seconds of a dwell at least and at most."""
RAMP_STEPS = 8
"""Steps of a slow ramp, one way."""
TRIED_S, LONGEST_EXPERIMENT_S = 8.0 * 3600.0, 48.0 * 3600.0
"""Seconds over which schedules are compared, each repeated until then (what one short run shows, a rival may yet
follow), and of an experiment with its repetitions at most."""
MAX_GROWTHS = 4
"""How often an experiment is made longer where it turns out to give less than its first hours promised."""
LEVEL_SHARES = (0.05, 0.95)
"""Quantiles of what a signal had while the machine ran, between which it is set."""
MIN_LOAD_CORRELATION = 0.5
"""The correlation with the load from which a signal that nobody sets is what it usually is at that load."""
MAX_ROWS = 20_000
"""Rows of a schedule at most; beyond, they lie further apart than those of the record."""
SURE_SIGMAS = 1.64
"""Standard deviations of the gain by which its mean lies above what a name needs: it is then had in 95 %."""
LEAST_TIME_SHARE = 0.25
"""Of a time as it was fitted, that it is taken to be at least where it is hardly known."""
ROWS = (1.0, 2.0, 5.0)
"""Intervals of recorders, and ten times, a tenth of these."""
EDGE_SHARE = 0.05
"""Of its range, by which a load keeps away from where the model's bins meet: it trembles, and would be in both."""
DAY_S = 86400.0
SHAPE_STEP, LEAST_SCALE = 0.05, 20.0
"""The share of its scale by which a parameter of a shape is moved for a derivative; the scale (s) is one at least."""

Phase = tuple[Mapping[str, float], float]
"""What is set, by signal, and for how many seconds."""


@dataclass(frozen=True, slots=True)
class ExperimentSchedule:
    """Set-points in words, one after the other."""

    what: str
    phases: tuple[Phase, ...]

    @property
    def seconds(self) -> float:
        """How long it takes."""
        return sum(seconds for _, seconds in self.phases)

    def starts(self, switch: str) -> int:
        """How often `switch` starts the machine in it."""
        runs = [False, *(settings[switch] > 0.5 for settings, _ in self.phases)]
        return sum(now and not before for before, now in pairwise(runs))

    def repeat(self, times: int) -> "ExperimentSchedule":
        """The same schedule so many times."""
        return ExperimentSchedule(self.what, self.phases * times)


@dataclass(frozen=True, slots=True)
class FreeCourse:
    """What a signal that nobody sets was (n,) at `times` (n,) absolute s: a room, a feed. It goes on as it went."""

    times: Array
    values: Array

    def ahead(self, times: Array) -> Array:
        """(m,) what it is at later times (absolute s): what it was whole days before, or, where less than a day was
        recorded, what it was that long before."""
        lasted = float(self.times[-1] - self.times[0])
        days = DAY_S * (lasted // DAY_S) or max(lasted, 1.0)
        back = days * np.ceil(np.maximum(times - self.times[-1], 0.0) / days)
        return np.asarray(np.interp(times - back, self.times, self.values))


@dataclass(frozen=True, slots=True, kw_only=True)
class MachineOperation:
    """What a person can set of a machine and what was seen of its signals.

    `switch` starts and stops it ("": it cannot be stopped), `load` is the signal of its load ("": none). `levels` are
    (low, high) of each signal that can be set, `running` and `resting` what all signals usually have, `near` what those
    that follow the load have at a level of it, `free` the course of each that goes its own way, whether the machine
    runs or not. `row` (s) is the interval between rows, `end` (absolute s) the last one. `barred` are the (low, high)
    between which the load is not set.
    """

    switch: str
    load: str
    levels: Mapping[str, tuple[float, float]]
    running: Mapping[str, float]
    resting: Mapping[str, float]
    near: Callable[[float], Mapping[str, float]]
    free: Mapping[str, FreeCourse]
    row: float
    end: float
    barred: tuple[tuple[float, float], ...] = ()

    def nearest_level(self, level: float) -> float:
        """The nearest level at which the load may be set."""
        low, high = self.levels[self.load]
        ends = [end for between in self.barred for end in between]
        near = [each for each in (level, low, high, *ends) if low <= each <= high and not self._is_unsettable(each)]
        return _settable(min(near, key=lambda each: abs(each - level), default=level))

    def _is_unsettable(self, level: float) -> bool:
        return any(low < level < high for low, high in self.barred)

    def at_rest(self, seconds: float) -> tuple[Phase, ...]:
        """A rest; nothing where the machine cannot be stopped."""
        return (({self.switch: 0.0}, seconds),) if self.switch else ()

    def run_phase(self, seconds: float, **settings: float) -> Phase:
        """The machine running at its usual set-points but for `settings`."""
        usual = {name: self.running[name] for name in self.levels}
        begin = {self.switch: 1.0} if self.switch else {}
        return {**begin, **usual, **settings}, seconds


def machine_operation(model: Model, traces: Sequence[Trace], roles: Mapping[str, str]) -> MachineOperation:
    """What can be set and was seen, of the traces' rows; `roles` gives the signal of each role."""
    switch = first_switch(model.alphabet)
    names = dict.fromkeys(name for trace in traces for name in trace.signals if name != model.temperature)
    columns = {name: np.concatenate([_hold_signal(trace, name) for trace in traces]) for name in names}
    size = next(iter(columns.values())).size if columns else 0
    runs = columns[switch.signal] > 0.5 if switch is not None and switch.signal in columns else np.ones(size, bool)
    stops = switch.signal if switch is not None and not runs.all() else ""
    bins = [channel.signal for channel in model.alphabet.channels if isinstance(channel, Bins)]
    can_set = [roles[role] for role in SETTABLE if role in roles]
    loads = [name for name in (*bins, *can_set[:1]) if name in columns and name != stops]
    levels = {name: _levels(columns[name][runs]) for name in (*loads[:1], *can_set) if name in columns}
    levels = {name: (low, high) for name, (low, high) in levels.items() if high > low}
    load = loads[0] if loads and loads[0] in levels else ""
    running = _usual(columns, runs)
    running |= {name: _settable(running[name]) for name in levels}
    changing = [name for name in columns if _changes(columns[name], runs)]
    resting = _usual({name: columns[name] for name in changing}, ~runs)
    follow = [
        name for name in columns if load and name not in (*levels, stops) and _follows_load(columns, name, load, runs)
    ]

    def usual_levels(level: float) -> Mapping[str, float]:
        if not load:
            return {}
        low, high = levels[load]
        rows = runs & (np.abs(columns[load] - level) <= (high - low) / 6.0)
        return _usual({name: columns[name] for name in follow}, rows) if rows.any() else {}

    times = np.concatenate([trace.times for trace in traces])
    own = [name for name in columns if name in running and name not in (*levels, stops, *follow, *changing)]
    steps = np.concatenate([np.diff(trace.times) for trace in traces])
    return MachineOperation(
        switch=stops,
        load=load,
        levels=levels,
        running=running,
        resting={**running, **resting},
        near=usual_levels,
        free={name: _free_course(times, columns[name]) for name in own},
        row=float(np.median(steps[steps > 0])),
        end=max(float(trace.times[-1]) for trace in traces),
    )


def _hold_signal(trace: Trace, name: str) -> Array:
    """(n,) a signal held from each reading to the next, NaN where there is none."""
    column = trace.signals.get(name, np.full(trace.times.size, np.nan))
    last = np.maximum.accumulate(np.where(np.isnan(column), -1, np.arange(column.size)))
    return np.where(last < 0, np.nan, column[last])


def _free_course(times: Array, column: Array) -> FreeCourse:
    order = np.argsort(times, kind="stable")
    order = order[np.isfinite(column[order])]
    return FreeCourse(times[order], column[order])


def _usual(columns: Mapping[str, Array], rows: Mask) -> dict[str, float]:
    """The median of each signal over the rows in which it was read; without those that never were."""
    seen = {name: column[rows & np.isfinite(column)] for name, column in columns.items()}
    return {name: float(np.quantile(column, 0.5, method="nearest")) for name, column in seen.items() if column.size}


def _levels(column: Array) -> tuple[float, float]:
    """(low, high) between which a signal is set: 0 and 1 of a switch, else without its rarest values."""
    seen = column[np.isfinite(column)]
    if seen.size == 0:
        return 0.0, 0.0
    if np.unique(seen).size <= 2:
        return float(seen.min()), float(seen.max())
    low, high = np.quantile(seen, LEVEL_SHARES).tolist()
    return _settable(low), _settable(high)


def _settable(value: float) -> float:
    """A set-point with no more digits than somebody would turn to."""
    return float(f"{value:.3g}")


def _changes(column: Array, runs: Mask) -> bool:
    """Whether a signal is another one at rest; what merely drifts from day to day would seem to jump at each start."""
    turning, still = (column[rows & np.isfinite(column)] for rows in (runs, ~runs))
    if turning.size == 0 or still.size == 0:
        return False
    if np.unique(turning).size <= 2:  # of a switch both values are usual while the machine runs
        return bool(np.median(still) != np.median(turning))
    low, high = np.quantile(turning, LEVEL_SHARES)
    return not low <= float(np.median(still)) <= high


def _follows_load(columns: Mapping[str, Array], name: str, load: str, runs: Mask) -> bool:
    """Whether a signal follows the load while the machine runs."""
    rows = runs & np.isfinite(columns[name]) & np.isfinite(columns[load])
    one, other = columns[name][rows], columns[load][rows]
    if one.size < 2 or np.ptp(one) == 0 or np.ptp(other) == 0:
        return False
    return bool(abs(np.corrcoef(one, other)[0, 1]) >= MIN_LOAD_CORRELATION)


def barred_loads(operation: MachineOperation, record: Record) -> tuple[tuple[float, float], ...]:
    """(low, high) of the loads about the edges of bins, and of those that were never seen in a location whose flow does
    not follow the load, where those of others do: of what they do there, nothing is known."""
    model, load = record.model, operation.load
    if not load:
        return ()
    low, high = operation.levels[load]
    edges = [
        edge
        for channel in model.alphabet.channels
        if isinstance(channel, Bins) and channel.signal == load
        for edge in channel.thresholds
    ]
    away = EDGE_SHARE * (high - low)
    barred = [(edge - away, edge + away) for edge in edges]
    driven = [any(each.signal == load for each in place.flow.inputs) for place in model.sha.locations]
    if load not in record.signals or not any(driven):
        return tuple(barred)
    bounds = [-inf, *edges, inf]
    for number in np.unique(record.runs.place).tolist():
        there = record.runs.place == number
        if driven[number] or record.running[there].mean() < 0.5:
            continue
        seen = record.signal(load)[there]
        least, most = _levels(seen)
        begin, end = bounds[int(np.searchsorted(edges, least, side="right")) :][:2]
        barred += [(begin, least), (most, end)]
    return tuple(barred)


# -------------------------------------------------------------------- schedules


def schedules(operation: MachineOperation, time_constant: float) -> tuple[ExperimentSchedule, ...]:
    """The schedules that are tried, for a running machine of that thermal time constant (s)."""
    found = []
    for share in DWELL_TAUS:
        dwell = min(max(60.0 * round(share * time_constant / 60.0), SHORTEST_DWELL_S), LONGEST_DWELL_S)
        found += [*_of_the_load(operation, dwell), *_of_others(operation, dwell), *_of_starts(operation, dwell)]
    return tuple(found)


def _of_the_load(operation: MachineOperation, dwell: float) -> list[ExperimentSchedule]:
    if not operation.load:
        return []
    low, high = operation.levels[operation.load]
    rest = operation.at_rest(REST_S)

    def loads(*levels: float, seconds: float = dwell) -> tuple[Phase, ...]:
        return tuple(
            operation.run_phase(seconds, **{operation.load: operation.nearest_level(level)}) for level in levels
        )

    middle = 0.5 * (low + high)
    ramp = np.linspace(low, high, RAMP_STEPS).tolist()
    slow = max(dwell / 2.0, SHORTEST_DWELL_S)
    return [
        ExperimentSchedule("dwell at three loads, up and down", (*rest, *loads(low, middle, high, middle))),
        ExperimentSchedule("sharp steps of the load after a rest", (*rest, *loads(high, low, high, low))),
        ExperimentSchedule("a slow ramp of the load, up and down", (*rest, *loads(*ramp, *ramp[-2::-1], seconds=slow))),
    ]


def _of_others(operation: MachineOperation, dwell: float) -> list[ExperimentSchedule]:
    rest = operation.at_rest(REST_S)
    return [
        ExperimentSchedule(
            f"{name} changed at a constant load",
            (*rest, *(operation.run_phase(dwell, **{name: value}) for value in (low, high, low, high))),
        )
        for name, (low, high) in operation.levels.items()
        if name != operation.load
    ]


def _of_starts(operation: MachineOperation, dwell: float) -> list[ExperimentSchedule]:
    if not operation.switch:
        return []
    highest = {operation.load: operation.levels[operation.load][1]} if operation.load else {}
    run, rest = operation.run_phase(dwell, **highest), operation.at_rest(REST_S)
    long = operation.run_phase(3.0 * dwell, **highest)
    return [
        ExperimentSchedule("a long run and a long rest", (*rest, long, *operation.at_rest(3.0 * dwell))),
        ExperimentSchedule("two starts that follow closely", (*rest, run, *operation.at_rest(PAUSE_S), run)),
    ]


def schedule_steps(schedule: ExperimentSchedule) -> tuple[ExperimentStep, ...]:
    """The schedule as steps in which one signal is set: what is set at once has 0 seconds but for the last of it."""
    steps = []
    last: dict[str, float] = {}
    for settings, seconds in schedule.phases:
        changed = [(name, value) for name, value in settings.items() if last.get(name) != value]
        for number, (name, value) in enumerate(changed or list(settings.items())[:1], start=1):
            steps.append(ExperimentStep(name, value, seconds if number == max(len(changed), 1) else 0.0))
        last.update(settings)
    return tuple(steps)


def schedule_trace(schedule: ExperimentSchedule, operation: MachineOperation, begin: float) -> Trace:
    """The schedule as rows from `begin` (absolute s) on: what is set, what goes its own way, and of all other signals
    what is usual then."""
    row = max(operation.row, schedule.seconds / MAX_ROWS)
    times = np.arange(0.0, schedule.seconds, row)
    names = dict.fromkeys([*([operation.switch] if operation.switch else []), *operation.running])
    columns = {name: np.empty(times.size) for name in names}
    since = 0.0
    for settings, seconds in schedule.phases:
        rows = (times >= since) & (times < since + seconds)
        rests = bool(operation.switch) and settings[operation.switch] == 0.0
        values = {**(operation.resting if rests else operation.running)}
        if not rests and operation.load:
            values |= operation.near(settings[operation.load])
        values |= settings
        for name, column in columns.items():
            column[rows] = values[name]
        since += seconds
    columns |= {name: course.ahead(begin + times) for name, course in operation.free.items()}
    return Trace("experiment", begin + times, columns, origin="a proposed experiment", synthetic=True)


# -------------------------------------------------------------------- rivals


def rivals_to_tell(path: NamingResult) -> tuple[EffectEvidence, ...]:
    """The confirmed evidence of those that these data cannot tell apart, best first; () where there are none.

    Of a name those of its class; where none is given, all that lie no further than a margin behind the best, those
    without a name among them.
    """
    for step, refusal in path.steps:
        best = step.best
        if best is None or not best.is_joint or best.gain < step.rules.least_gain_nats:
            continue
        close = margin_of_class(best.gain, step.rules)
        near = [
            each
            for each in step.evidence
            if each.entry.name in step.members or (refusal and best.gain - each.gain < close)
        ]
        if len(near) > 1:
            return tuple(each if each.is_joint else confirm(step.before, each) for each in near[:MAX_RIVALS])
    return ()


@dataclass(frozen=True, slots=True)
class _Alternative:
    """A rival's fit, and what the measured traces say of its parameters: their precision (q, q), shape included."""

    evidence: EffectEvidence
    fitted: Fitted
    precision: Array

    @property
    def name(self) -> str:
        return self.evidence.entry.name


def _alternative(evidence: EffectEvidence) -> _Alternative:
    if evidence.fitted is None:
        raise ValueError(f"{evidence.entry.name} was not fitted")
    fitted = restore_fit(evidence.fitted)
    columns = _sensitivities(fitted.frame, fitted.state, fitted.start)
    # Of a parameter of the shape nothing is believed but that it stays near its own size.
    more = columns.shape[1] - fitted.prior.size
    prior = np.concatenate([np.maximum(fitted.prior, 1e-12), np.ones(more)])
    precision = Whitener(fitted.grid, fitted.noise).gram(columns) + np.diag(prior)
    return _Alternative(evidence, fitted, precision)


def _sensitivities(frame: Frame, state: CourseState, start: Array) -> Array:
    """(m, q) what each parameter of a fit does to the windows, those of its last effect's shape after the others.

    A parameter of a shape is in units of its own scale.
    """
    columns = [window_sensitivity(frame, state, start)]
    *others, last = state.named
    for name, (_, high) in last.entry.candidate.refine.items():
        if name not in last.params or name in last.free:
            continue
        value = last.params[name]
        scale = max(abs(value), LEAST_SCALE) if name not in last.entry.candidate.widths else 10.0
        step = SHAPE_STEP * (scale if value + SHAPE_STEP * scale <= high else -scale)
        params = last.entry.candidate.settled({**last.params, name: value + step})
        trial = run_frame(frame, state.parameters, start, [*others, replace(last, params=params)], state.course)
        columns.append(frame.record.window_means((trial.mean - state.mean) * (scale / step))[:, None])
    return np.column_stack(columns)


@dataclass(frozen=True, slots=True)
class _Trial:
    """A rival along a schedule: its course in windows (m,), its sensitivities (m, q), and the noise's weigher."""

    course: Array
    columns: Array
    whitener: Whitener


def _trial(one: _Alternative, record: Record, start: float) -> _Trial:
    fitted = one.fitted
    frame = move_frame(fitted.frame, record)
    begin = np.full(int(np.count_nonzero(record.window_first)), start)
    state = run_frame(frame, fitted.state.parameters, begin, fitted.state.named)
    # The noise was fitted to windows of the measured record, in which there may be more readings.
    share = readings_in_window(fitted.frame.record) / readings_in_window(record)
    noise = replace(fitted.noise, sensor=fitted.noise.sensor * sqrt(max(share, 1e-6)))
    return _Trial(
        record.window_means(state.mean), _sensitivities(frame, state, begin), Whitener(window_grid(frame, state), noise)
    )


def _nats(true: _Trial, wrong: _Trial, precision: Array) -> float:
    """The expected gain of the true rival over the wrong one, whose parameters are fitted anew to all there is."""
    gram = true.whitener.gram(np.column_stack([true.course - wrong.course, wrong.columns]))
    scale = 1.0 / np.sqrt(np.maximum(np.diag(precision), 1e-300))
    normal = (gram[1:, 1:] + precision) * np.outer(scale, scale)
    score = gram[1:, 0] * scale
    return max(0.5 * float(gram[0, 0] - score @ np.linalg.solve(normal, score)), 0.0)


def _pairs(alternatives: Sequence[_Alternative], record: Record, start: float) -> dict[tuple[str, str], float]:
    """nats by pair of rivals, the less whichever of the two is true; a rival follows whatever is a case of it."""
    trials = [_trial(each, record, start) for each in alternatives]
    found = {}
    for (first, one), (second, other) in combinations(zip(alternatives, trials, strict=True), 2):
        special = (
            second.name in first.evidence.entry.candidate.special,
            first.name in second.evidence.entry.candidate.special,
        )
        either = (
            inf if special[1] else _nats(one, other, second.precision),
            inf if special[0] else _nats(other, one, first.precision),
        )
        found[first.name, second.name] = min(either)
    return found


# -------------------------------------------------------------------- proposal


def propose_experiment(
    path: NamingResult, traces: Sequence[Trace], roles: Mapping[str, str]
) -> ProposedExperiment | None:
    """The experiment that soonest gains enough over each pair of rivals, with cycles left to prove it, repeated until
    it does; where none does, that of the greatest least gain an hour. Pairs for which the rows must lie closer have no
    say in it beside others.

    `traces` are those that were diagnosed, `roles` the signals of the roles. None where nothing is to be told apart or
    nothing can be set.
    """
    rivals = rivals_to_tell(path)
    if not rivals:
        return None
    record = path.base.frame.record
    operation = machine_operation(record.model, traces, roles)
    operation = replace(operation, barred=barred_loads(operation, record))
    alternatives = [_alternative(each) for each in rivals]
    start = resting_temperature(record)

    def expected_gains(schedule: ExperimentSchedule, repeats: int) -> dict[tuple[str, str], float] | None:
        ahead = _record(path.base, schedule.repeat(repeats), operation, start)
        return None if ahead is None else _pairs(alternatives, ahead, start)

    tried = []
    for schedule in schedules(operation, time_constant(path.base)):
        repeats = max(round(TRIED_S / schedule.seconds), 1)
        nats = expected_gains(schedule, repeats)
        if nats is not None:
            tried.append((schedule, repeats, nats))
    if not tried:
        return None
    pairs = list(tried[0][2])
    rules = path.steps[0][0].rules
    least, needed = _least(rivals, rules), _needed_nats(rivals, rules)
    # What a rival follows it follows the better the longer it lasts: no longer experiment gives more an hour.
    most = {pair: max(nats[pair] * _longest(plan) / repeats for plan, repeats, nats in tried) for pair in pairs}
    closer = {each.name: closer_rows(each.fitted) for each in alternatives}
    rows = {pair: min((each for name in pair if (each := closer[name]) is not None), default=None) for pair in pairs}
    # A pair that nothing tells apart, or nothing in such rows, has no say in the choice, and is reported.
    apart = [pair for pair in pairs if most[pair] >= least]
    told = [pair for pair in apart if rows[pair] is None] or apart or pairs

    def seconds(trial: tuple[ExperimentSchedule, int, Mapping[tuple[str, str], float]]) -> float:
        schedule, repeats, nats = trial
        enough = repeats * needed / max(min(nats[pair] for pair in told), 1e-9)
        return schedule.seconds * max(enough, _least_repeats(schedule, operation, rules))

    schedule, repeats, nats = min(tried, key=seconds)
    longest, fewest = _longest(schedule), _least_repeats(schedule, operation, rules)
    for _ in range(MAX_GROWTHS):
        so_far = min(nats[pair] for pair in told)
        wanted = min(max(ceil(repeats * needed / max(so_far, 1e-9)), fewest), longest)
        if wanted == repeats:
            break
        repeats, nats = wanted, expected_gains(schedule, wanted) or nats
        if min(nats[pair] for pair in told) >= needed:
            break
    return ProposedExperiment(
        what=schedule.what,
        steps=schedule_steps(schedule),
        repeats=repeats,
        seconds=repeats * schedule.seconds,
        pairs=tuple(PairOfRivals(*pair, each, max(each, most[pair]), rows[pair]) for pair, each in nats.items()),
        needed=needed,
        least=least,
        trace=schedule_trace(schedule.repeat(repeats), operation, operation.end + REST_S),
    )


def closer_rows(fitted: Fitted) -> float | None:
    """s, how close rows must lie for the last effect of a fit to be seen in them, for certain; None where they do.

    That is of a time which is fitted with the parameters: no shape is looked for at one that is shorter than visible.
    """
    record, named = fitted.frame.record, fitted.state.named[-1]
    if not set(named.free) & set(TIME_PARAMETERS):
        return None
    time, error = fitted.strength(named.entry.name)
    shortest = shortest_visible(record)
    # All switches are known late by one and the same part of a row: what is taken for the time is off by that, too.
    row = shortest / MIN_VISIBLE_ROWS
    least = time - SURE_SIGMAS * hypot(error, row / sqrt(12.0))
    if least >= shortest or time <= 0:
        return None
    wanted = max(least, LEAST_TIME_SHARE * time) / MIN_VISIBLE_ROWS
    decade = 10.0 ** floor(log10(wanted))
    return max(each * decade for each in ROWS if each * decade <= wanted)


def _longest(schedule: ExperimentSchedule) -> int:
    """How often a schedule is made at most."""
    return max(int(LONGEST_EXPERIMENT_S // schedule.seconds), 1)


def _least_repeats(schedule: ExperimentSchedule, operation: MachineOperation, rules: DecisionRules) -> int:
    """How often a schedule is made at least: so that of its cycles some are held out, where two days have so many."""
    starts = schedule.starts(operation.switch) if operation.switch else 0
    least = ceil(rules.least_cycles / starts) if starts else 1
    return least if least <= _longest(schedule) else 1


def _needed_nats(rivals: Sequence[EffectEvidence], rules: DecisionRules) -> float:
    """nats that an experiment must be expected to give: what a name needs, had in 95 % whichever rival is true."""
    # A log-likelihood ratio of mean m has the variance 2 m: m - 1.64 sqrt(2 m) = what a name needs.
    half = SURE_SIGMAS / sqrt(2.0)
    return (half + sqrt(half**2 + _least(rivals, rules))) ** 2


def _least(rivals: Sequence[EffectEvidence], rules: DecisionRules) -> float:
    """nats that a name needs, whichever rival is true: expected of an experiment, it is had in half of all cases."""
    top = max(each.gain for each in rivals)
    behind = top - min(each.gain for each in rivals)
    return margin_of_class(top, rules) + behind


def resting_temperature(record: Record) -> float:
    """What is read at the end of rests, usually; of a machine that never rests, what is read at all."""
    running = record.window_means(record.running)
    ends = (running < 0.5) & np.append(running[1:] > 0.5, True)
    return float(np.median(record.reading[ends] if ends.any() else record.reading))


def time_constant(fitted: Fitted) -> float:
    """s, of the running machine; an hour where it does not relax."""
    rate = (fitted.state.k + fitted.state.loss)[fitted.frame.record.running > 0.5]
    rate = rate[rate > 0]
    return 1.0 / float(np.median(rate)) if rate.size else 3600.0


def _record(fitted: Fitted, schedule: ExperimentSchedule, operation: MachineOperation, start: float) -> Record | None:
    """The schedule laid out; None where the model does not follow it, or it leads where the measured traces never came.

    There the rivals would be told apart by parameters of which nothing is known.
    """
    record = fitted.frame.record
    model = record.model
    rows = schedule_trace(schedule, operation, operation.end + REST_S)
    read = replace(rows, signals={**rows.signals, model.temperature: np.full(rows.times.size, start)})
    try:
        ahead = build_record(model, [patiently(read, model.alphabet)], record.signals)
    except LearningError:
        return None
    return ahead if np.isin(ahead.runs.place, record.runs.place).all() else None
