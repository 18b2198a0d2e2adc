"""Runs whose events are known: one plan of exact steps for all of them, cut where a query looks at them.

The steps are made alike with and without effects; how runs take them is written here for the flows' closed forms, and
in `effects` for all that effects add to a run's state.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import ceil, inf, isfinite, log1p, nextafter, sqrt

import numpy as np

from sim.effects import ABSOLUTE_SECONDS, Structural, dead_time, effect_kind, offset_times
from sim.engine import Schedule, compile_plant, fastest, schedule, step_coefficients
from sim.lab.checking.smc.paths import long_steps
from sim.lab.checking.smc.paths.effects import KnownUnderEffects, effects_engine
from sim.lab.checking.smc.paths.long_steps import NestedStep
from sim.lab.checking.smc.paths.plan import (
    MAX_PIECE_S,
    MAX_PIECE_TAUS,
    MIN_DECAY,
    Indices,
    Piece,
    State,
    World,
    clamp,
    draw_start,
    limit,
    start_tiltable,
    state_from_scores,
)
from sim.lab.checking.smc.paths.tilting import Tilts, choose_stays, mode_value, tiltable
from sim.sha import (
    SHA,
    UNKNOWN,
    Array,
    Distribution,
    Event,
    Flow,
    Mask,
    Trace,
    distributions,
    draw_parameter,
    draw_temperature,
    flows,
    mode_parameter,
)

MAX_ROWS = 200_000
"""Steps of one run; a query that needs more is refused."""

Affine = tuple[float, float, float]

_SAME_END_S = 1e-9
"""Seconds within which two ends of steps are one."""


@dataclass(frozen=True, slots=True)
class Cuts:
    """Where the steps of a query over `bound` seconds must end: `instants` (s) and, in each stay, where an affine
    c + t * time + g * age of `clocks` is 0; those are steps of length 0 too. In `looked` ((from, to), s) the
    temperature counts: steps are as short as their flow demands, and at most `longest` (s). `lines` (degC) are all
    that the temperature is compared with: away from them runs may take several steps in one. None: they may not.
    """

    bound: float
    instants: tuple[float, ...] = ()
    clocks: tuple[Affine, ...] = ()
    looked: tuple[tuple[float, float], ...] = ()
    longest: float = inf
    lines: tuple[float, ...] | None = None


@dataclass(frozen=True, slots=True)
class _Row:
    """One exact step: X' = decay * X + pull * mode + shift + noise, after X and m were drawn anew where a law says so.

    Without `own` the mode is the same for all runs and stands in `mean`. `column` is where the drawn m's standard score
    is kept, if it may be drawn by a law of its own (`tilting`).
    """

    begin: float
    dt: float
    age: float
    location: int
    fresh: Distribution | None
    drawn: Distribution | None
    own: bool
    mean: float
    decay: float
    pull: float
    shift: float
    sigma: float
    bridge: float
    flow: Flow
    offset: float
    column: int | None = None


@dataclass(frozen=True, slots=True)
class Known:
    """The engine (`paths.Engine`) of known events.

    Row k of the `clock` has the steps `rows[firsts[k]:firsts[k + 1]]`, which are `whole[k]` in one where they may be.
    """

    world: World
    clock: Array
    rows: tuple[_Row, ...]
    firsts: tuple[int, ...]
    whole: tuple[NestedStep | None, ...]
    lines: tuple[float, ...]
    notes: tuple[str, ...]
    columns: int = 0
    tilts: Tilts | None = None

    def tilt(self, tilts: Tilts) -> "Known":
        """The same with the mode parameters of `columns` stays drawn by these laws."""
        return replace(self, tilts=tilts)

    def begin(self, runs: int, rng: np.random.Generator) -> State:
        """`runs` runs at the start."""
        drawn = np.empty(0) if self.tilts is None else np.full((runs, self.columns), np.nan)
        column = self.rows[0].column
        if self.tilts is None or column is None:
            x, mode = draw_start(self.world, runs, rng)
        else:
            drawn[:, column] = self.tilts.scores(column, runs, rng)
            x, mode = state_from_scores(self.world, drawn[:, column], rng)
        x, outside = clamp(self.world.sha, x)
        clamps = np.zeros(runs, dtype=np.intp) if outside is None else outside.astype(np.intp)
        return State(x, mode, clamps, np.zeros(runs, dtype=np.intp), drawn=drawn)

    def advance(self, row: int, state: State, rng: np.random.Generator) -> Iterator[Piece]:
        """The pieces of a row: those of its step over several, or one for each step."""
        steps, runs = self.rows[self.firsts[row] : self.firsts[row + 1]], state.x.size
        entry = steps[0]
        if entry.fresh is not None:
            state.x, outside = clamp(self.world.sha, distributions.draw(entry.fresh, runs, rng))
            _count(state.clamps, outside)
        if entry.drawn is not None:
            if self.tilts is None or entry.column is None:
                state.mode = distributions.draw(entry.drawn, runs, rng)
            else:
                state.drawn[:, entry.column] = self.tilts.scores(entry.column, runs, rng)
                state.mode = mode_value(entry.drawn, state.drawn[:, entry.column])
        if (whole := self.whole[row]) is not None:
            mode = state.mode if entry.own else 0.0
            pieces = whole.advance(state, mode, sha=self.world.sha, lines=self.lines, rng=rng)
            if pieces is not None:
                yield from pieces
                return
        for step in steps:
            start = state.x
            if step.dt > 0.0:
                state.x = self._advance(step, start, state, rng)
            yield Piece(
                rows=None,
                begin=step.begin,
                dt=step.dt,
                age=step.age,
                location=step.location,
                start=start,
                end=state.x,
                bridge=step.bridge,
            )

    def _advance(self, step: _Row, start: Array, state: State, rng: np.random.Generator) -> Array:
        rate = self.world.sha.max_rate
        if isfinite(rate):
            target = (state.mode if step.own else step.mean) + step.offset
            fast = np.abs(flows.drift(step.flow, start, target, step.age)) > rate
            if fast.any():
                state.limited += fast
                mean = flows.mean_step(step.flow, start, target, age=step.age, dt=step.dt, max_rate=rate)
                end, outside = clamp(self.world.sha, mean + step.sigma * rng.standard_normal(start.size))
                _count(state.clamps, outside)
                return end
        end = rng.standard_normal(start.size) if step.sigma else np.zeros(start.size)
        end *= step.sigma
        end += step.shift
        part = start * step.decay
        end += part
        if step.own and step.pull:
            end += np.multiply(state.mode, step.pull, out=part)
        end, outside = clamp(self.world.sha, end)
        _count(state.clamps, outside)
        return end


def _count(counts: Indices, outside: Mask | None) -> None:
    if outside is not None:
        counts += outside


def known_engine(world: World, cuts: Cuts) -> "Known | KnownUnderEffects":
    """The engine along the events and inputs of `world.trace`. Raises ValueError as `schedule` does.

    An event without an edge leads where most edges with its symbol lead (`resync`), as the gateway does; it is noted.
    """
    trace = world.trace
    if trace is None:
        raise ValueError(
            f"model {world.sha.name!r} has effects, whose signals the semi-Markov law does not give: let a trace drive "
            f"the runs (--events FILE, from its first reading or --from trace:SECONDS, --future recorded)"
        )
    # Events in s since the start. What a belief knows of only settles where and how old it is: it has acted already,
    # and lies just before 0 so that the schedule begins with what it led to.
    shift, sha = dead_time(world.sha) - world.begin, _since_start(world.sha, world.begin)
    inputs = replace(trace, times=trace.times + shift, events=())
    events = [Event(event.time + shift, event.symbol) for event in trace.events]
    if world.belief is not None:
        settled = nextafter(0.0, -1.0)
        events = [Event(settled, event.symbol) if event.time == 0.0 else event for event in events]
        if world.age > 0.0 and not any(event.time < 0.0 for event in events):
            events = [Event(-world.age, UNKNOWN), *events]  # still in the first stay, which is older than the runs
    # Twice: the coarse steps say which flow runs when, which says how fine the second ones must be.
    coarse = schedule(sha, events, [cuts.bound], start=0.0, inputs=inputs, policy="resync")
    steps = schedule(sha, events, _outputs(coarse, cuts), start=0.0, inputs=inputs, policy="resync")
    if world.belief is not None and steps.location[0] != world.location:
        raise ValueError(f"trace {trace.name!r}: its events do not lead to the location that the belief is in")
    _refuse_long_runs(steps.dt.size)
    notes = _trace_notes(trace, world, cuts.bound, len(steps.unmatched))
    return _plain_engine(world, cuts, steps, notes) if steps.segments is None else effects_engine(world, steps, notes)


def _since_start(sha: SHA, begin: float) -> SHA:
    """The automaton on a clock that is 0 at `begin` (absolute s), its dead time being in the events already."""
    effects = []
    for effect in sha.effects:
        kind = effect_kind(effect)
        absolute = {name for name, each in kind.parameters.items() if each.unit == ABSOLUTE_SECONDS}
        params = {name: value - begin if name in absolute else value for name, value in effect.params.items()}
        effects.append(replace(effect, params={"delay": 0.0} if kind.law == Structural("dead time") else params))
    return replace(sha, effects=tuple(effects))


def _plain_engine(world: World, cuts: Cuts, steps: Schedule, notes: tuple[str, ...]) -> Known:
    clock = np.concatenate([[0.0], np.cumsum(steps.dt)])
    rows, columns = _with_columns(world, _rows(world, steps, clock))
    most = 1 if cuts.lines is None or isfinite(world.sha.max_rate) else long_steps.MAX_PIECES
    firsts = [0]
    for k, (row, after) in enumerate(pairwise(rows), start=1):
        same = after.age > row.age and after.offset == row.offset  # the stay, and so m, and what the inputs add to it
        if not (same and row.sigma and after.sigma) or k - firsts[-1] == most:
            firsts.append(k)
    firsts.append(len(rows))
    return Known(
        world=world,
        clock=clock[firsts],
        rows=rows,
        firsts=tuple(firsts),
        whole=tuple(_whole(rows[first:last]) for first, last in pairwise(firsts)),
        lines=cuts.lines or (),
        notes=notes,
        columns=columns,
    )


def _trace_notes(trace: Trace, world: World, bound: float, unmatched: int) -> tuple[str, ...]:
    """What limits runs along a trace, one sentence each."""
    notes = []
    last = float(trace.times[-1]) - world.begin if trace.times.size else 0.0
    if last < bound - 1e-6:
        notes.append(f"the trace ends {last:.6g} s after the start: from there to {bound:.6g} s nothing more happens")
    if unmatched:
        notes.append(f"{unmatched} events had no edge and led where most edges with their symbol lead")
    return tuple(notes)


def _outputs(coarse: Schedule, cuts: Cuts) -> Array:
    """Where steps must end: fine points where the temperature is looked at, and twice where an instant counts."""
    sha, longest = coarse.sha, _longest_steps(coarse.sha)
    begins = np.concatenate([[0.0], np.cumsum(coarse.dt)])[:-1]
    instants = {time for time in cuts.instants if 0.0 <= time <= cuts.bound}
    instants |= {at for at in offset_times(sha) if 0.0 < at < cuts.bound}  # the sensor steps
    points: list[Array] = [np.array([cuts.bound])]
    for begin, dt, age, place in zip(
        begins.tolist(), coarse.dt.tolist(), coarse.age.tolist(), coarse.location.tolist(), strict=True
    ):
        for low, high in cuts.looked:
            first, last = max(begin, low), min(begin + dt, high)
            if last <= first:
                continue
            if longest is not None:
                fine = _even_points(last - first, min(float(longest[place]), cuts.longest))
            else:
                flow = sha.locations[place].flow
                fine = _fine(flow, age + first - begin, last - first, longest=cuts.longest)
            points.append(fine[fine > 0.0] + first)
        instants |= set(_crossings(cuts.clocks, begin, dt, age))
    # An instant twice is a step of length 0, on which the query looks at the clocks alone.
    doubled = np.repeat(np.array(sorted(instants)), 2)
    singles = np.unique(np.concatenate(points))
    ends = np.append(begins[1:], np.inf)  # steps end there anyway
    near = ends[np.clip(np.searchsorted(ends, singles - _SAME_END_S), 0, ends.size - 1)]
    singles = singles[(np.abs(singles - near) > _SAME_END_S) | (singles == cuts.bound)]
    singles = singles[~np.isin(singles, doubled)]
    return np.sort(np.concatenate([singles, doubled]))


def _longest_steps(sha: SHA) -> Array | None:
    """(L,) s of a step in each location under effects; None without effects, where the flow alone says it (`_fine`)."""
    if not sha.effects:
        return None
    # The fastest of all that moves what the sensor reads: X, the lag behind it, the housing that it exchanges with.
    plant = compile_plant(sha)
    speed = np.maximum(fastest(plant), 1e-12)
    if plant.lags:
        speed = np.maximum(speed, plant.lag_rate)
    if isfinite(plant.housing_tau):
        speed = np.maximum(speed, 1.0 / plant.housing_tau)
    if plant.disturbance is not None:
        speed = np.maximum(speed, 1.0 / plant.disturbance.params["memory"])
    return np.asarray(np.minimum(MAX_PIECE_S, MAX_PIECE_TAUS / speed))


def _refuse_long_runs(steps: int) -> None:
    if steps > MAX_ROWS:
        raise ValueError(f"the query needs {steps} steps a run, above {MAX_ROWS}: ask for a shorter bound or interval")


def _even_points(length: float, longest: float) -> Array:
    """From 0 to the end of a stretch of `length` s, at most `longest` s apart."""
    count = ceil(length / longest)
    _refuse_long_runs(count)
    return np.linspace(0.0, length, count + 1)


def _fine(flow: Flow, age: float, length: float, *, longest: float) -> Array:
    """The points from 0 to the end of a stretch of `length` s that begins `age` s after entry."""
    own = float(limit(flow, age))
    if flow.kind == "logarithmic":  # equal steps of the logarithm: they grow with the age
        begin = flow.params["t0"] + age
        ratio = log1p(length / begin)
        count = ceil(ratio / log1p(own / begin))
        points = begin * np.expm1(ratio * np.arange(count + 1) / count)
    elif flow.kind == "transient" and own < length:  # equal steps of exp(-u / 2 tau), as those of `limit`
        twice = 2.0 * flow.params["tau"]
        first, last = np.exp(-np.array([age, age + length]) / twice)
        inner = np.linspace(first, last, ceil((first - last) / (0.5 * MAX_PIECE_TAUS)) + 1)[1:-1]
        points = np.array([0.0, *(-twice * np.log(inner) - age), length])
    else:
        points = _even_points(length, own) if isfinite(own) else np.array([0.0, length])
    if np.diff(points).max() > longest:
        points = np.union1d(points, _even_points(length, longest))
    return np.asarray(points)


def _crossings(clocks: Sequence[Affine], begin: float, dt: float, age: float) -> Iterator[float]:
    """The moments (s) of a stretch at which one of the affine functions of the clocks is 0."""
    for c, t, g in clocks:
        if t + g != 0.0:
            time = (g * (begin - age) - c) / (t + g)
            if begin <= time <= begin + dt:
                yield time


def _rows(world: World, steps: Schedule, clock: Array) -> tuple[_Row, ...]:
    """The steps as the runs take them, with all that is the same for every run worked out."""
    sha = world.sha
    decay, pull, variance = step_coefficients(steps)
    mean, spread = np.array([mode_parameter(place) for place in sha.locations]).T[:, steps.location]
    bridge = variance / np.maximum(decay, MIN_DECAY)
    # A normal m on which one step alone depends is one more normal noise in that step: one draw stands for both. Under
    # a rate limit a step is not linear in m, and a belief's first m is not independent of its X: there they stay apart.
    alone = np.zeros(steps.dt.size, dtype=np.bool_)
    if not isfinite(sha.max_rate):
        laws = [draw_parameter(place) for place in sha.locations]
        normal = np.array([law is not None and law.kind == "normal" for law in laws])[steps.location]
        dependent = np.bincount(steps.stay, weights=pull != 0)[steps.stay]
        alone = normal & (dependent <= 1)
        if world.belief is not None:
            alone &= steps.stay > 0
    variance = variance + np.where(alone, pull**2 * spread, 0.0)
    own = (spread > 0) & ~alone
    if world.belief is not None:
        own |= steps.stay == 0
    shift = pull * (steps.offset + np.where(own, 0.0, mean))
    entered = steps.entry & (np.arange(steps.dt.size) > 0)
    rows = []
    for k, place in enumerate(steps.location.tolist()):
        location = sha.locations[place]
        rows.append(
            _Row(
                begin=float(clock[k]),
                dt=float(steps.dt[k]),
                age=float(steps.age[k]),
                location=place,
                fresh=draw_temperature(location) if entered[k] else None,
                drawn=draw_parameter(location) if entered[k] and own[k] else None,
                own=bool(own[k]),
                mean=float(mean[k]),
                decay=float(decay[k]),
                pull=float(pull[k]),
                shift=float(shift[k]),
                sigma=sqrt(float(variance[k])),
                bridge=float(bridge[k]),
                flow=location.flow,
                offset=float(steps.offset[k]),
            )
        )
    return tuple(rows)


def _whole(rows: Sequence[_Row]) -> NestedStep | None:
    """Several rows as one step; None for a single one."""
    if len(rows) == 1:
        return None
    return long_steps.join_steps(
        [
            NestedStep(
                begin=row.begin,
                dt=row.dt,
                age=row.age,
                location=row.location,
                decay=row.decay,
                pull=row.pull if row.own else 0.0,
                shift=row.shift,
                variance=row.sigma**2,
                bridge=row.bridge,
            )
            for row in rows
        ]
    )


def _with_columns(world: World, rows: Sequence[_Row]) -> tuple[tuple[_Row, ...], int]:
    """The rows with a column where a stay begins whose m may be drawn by a law of its own, and how many there are."""
    begins = [0, *(k for k, row in enumerate(rows) if k and row.drawn is not None)]
    effects = np.zeros(len(begins))
    for which, (first, last) in enumerate(pairwise([*begins, len(rows)])):
        law = rows[first].drawn
        free = tiltable(law) if first else start_tiltable(world) and rows[0].own
        if free and law is not None:
            sigma = law.params["sigma"]
        elif free:  # the first stay's m: the belief's, or as the location draws it
            location = world.sha.locations[world.location]
            sigma = sqrt(world.belief.mm if world.belief is not None else mode_parameter(location)[1])
        else:
            sigma = 0.0
        # How far one standard deviation of this m moves X over its stay, roughly: the pulls of its steps, added up.
        effects[which] = sigma * sum(row.pull for row in rows[first:last] if row.own)
    places = choose_stays(effects)
    columns = {begins[which]: column for column, which in enumerate(places)}
    return tuple(replace(row, column=columns.get(k)) for k, row in enumerate(rows)), len(places)
