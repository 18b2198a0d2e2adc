"""Runs under effects whose events are known: the simulator's own steps, short enough that a query can look at them.

Every run has its own X, housing, lags, thermostat and m. Steps are those of `sim.engine.tables`, at most MAX_PIECE_S s
and 0.05 of the fastest time constant where the temperature counts. In between the path of X is the bridge of its
noise about a straight line; after a lag it is smooth, and its extremes are those of the steps' ends.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import inf, isfinite, nextafter

import numpy as np

from sim.effects import ABSOLUTE_SECONDS, Structural, dead_time, effect_kind, offset_times, sensor_offsets
from sim.engine import (
    Hidden,
    SamplingPlan,
    Schedule,
    augmented_plan,
    compile_plant,
    draw_states,
    drawn_start,
    fastest,
    move,
    schedule,
)
from sim.lab.checking.smc.paths.known_events import MAX_ROWS, Cuts, crossings, trace_notes
from sim.lab.checking.smc.paths.plan import (
    MAX_PIECE_S,
    MAX_PIECE_TAUS,
    MIN_DECAY,
    Indices,
    Piece,
    State,
    World,
    draw_mode,
)
from sim.lab.checking.smc.paths.tilting import Tilts
from sim.sha import SHA, UNKNOWN, Array, Event, distributions


@dataclass(frozen=True, slots=True)
class KnownUnderEffects:
    """The engine (`paths.Engine`); `clock` (s since the start) and the offsets `before` and `after` each row (degC).

    `bridge` (rows,) is V of each step's noise in X; 0 behind a lag.
    """

    world: World
    plan: SamplingPlan
    clock: Array
    before: Array
    after: Array
    bridge: Array
    notes: tuple[str, ...]
    columns: int = 0

    def tilt(self, tilts: Tilts) -> "KnownUnderEffects":
        """Never asked for: there are no columns."""
        raise ValueError("runs under effects have no mode parameters that may be drawn by laws of their own")

    def begin(self, runs: int, rng: np.random.Generator) -> State:
        """`runs` runs at the start; `State.hidden` has X, housing, lags, and whether the thermostat is open."""
        plant, belief = self.plan.plant, self.world.belief
        opened = np.zeros(runs)
        if belief is None:
            s = drawn_start(plant, distributions.draw(self.world.first, runs, rng), float(self.before[0]), rng)
            mode = draw_mode(self.plan.schedule.sha, self.world.location, runs, rng)
        else:
            hidden = belief.hidden or Hidden((), ())
            s, mode = draw_states(hidden, runs, rng)
            opened = np.full(runs, float(hidden.opened))
        clamps = np.zeros(runs, dtype=np.intp)
        _clamp(self.plan.schedule.sha, s, clamps)
        x = s[:, plant.sensor_state] + self.before[0]
        return State(x, mode, clamps, np.zeros(runs, dtype=np.intp), hidden=np.column_stack([s, opened]))

    def advance(self, row: int, state: State, rng: np.random.Generator) -> Iterator[Piece]:
        """The one piece of a row."""
        plan, schedule_ = self.plan, self.plan.schedule
        plant, place, dt = plan.plant, int(schedule_.location[row]), float(schedule_.dt[row])
        s, opened = state.hidden[:, :-1].copy(), state.hidden[:, -1] > 0.5
        runs = len(s)
        if row and schedule_.entry[row]:
            law = plan.temperature_laws[place]
            if law is not None:
                s[:, 0] = distributions.draw(law, runs, rng)
                _clamp(schedule_.sha, s, state.clamps)
            state.mode = draw_mode(schedule_.sha, place, runs, rng)
        start = s[:, plant.sensor_state] + self.before[row]
        if dt > 0:
            drawn = rng.standard_normal((runs, plant.size))
            noise = np.where(opened[:, None], drawn @ plan.open[row].T, drawn @ plan.closed[row].T)
            moved = move(plant, plan.steps, row, s=s, mode=state.mode, opened=opened, noise=noise)
            s, opened = moved.s, moved.opened
            state.limited += moved.met
            _clamp(schedule_.sha, s, state.clamps)
        state.hidden = np.column_stack([s, opened])
        state.x = s[:, plant.sensor_state] + self.after[row]
        age = float(schedule_.age[row])
        yield Piece(
            rows=None,
            begin=float(self.clock[row]),
            dt=dt,
            age=age,
            location=place,
            start=start,
            end=state.x,
            bridge=float(self.bridge[row]),
        )


def _clamp(sha: SHA, s: Array, clamps: Indices) -> None:
    """Puts X back into the range, in place, and counts."""
    outside = (s[:, 0] < sha.low) | (s[:, 0] > sha.high)
    if outside.any():
        clamps += outside
        s[:, 0] = np.clip(s[:, 0], sha.low, sha.high)


def effects_engine(world: World, cuts: Cuts) -> KnownUnderEffects:
    """The engine along the events and signals of `world.trace`. Raises ValueError as `schedule` does."""
    trace = world.trace
    if trace is None:
        raise ValueError(
            f"model {world.sha.name!r} has effects, whose signals the semi-Markov law does not give: let a trace drive "
            f"the runs (--events FILE, from its first reading or --from trace:SECONDS, --future recorded)"
        )
    delay, sha = dead_time(world.sha), relative(world.sha, world.begin)
    shift = delay - world.begin
    inputs = replace(trace, times=trace.times + shift, events=())
    events = [Event(event.time + shift, event.symbol) for event in trace.events]
    if world.belief is not None:  # what it knows of already lies before the start
        settled = nextafter(0.0, -1.0)
        events = [Event(settled, event.symbol) if event.time == 0.0 else event for event in events]
        if world.age > 0.0 and not any(event.time < 0.0 for event in events):
            events = [Event(-world.age, UNKNOWN), *events]
    coarse = schedule(sha, events, [cuts.bound], start=0.0, inputs=inputs, policy="resync")
    outputs = _outputs(coarse, cuts, sha)
    steps = schedule(sha, events, outputs, start=0.0, inputs=inputs, policy="resync")
    if world.belief is not None and steps.location[0] != world.location:
        raise ValueError(f"trace {trace.name!r}: its events do not lead to the location that the belief is in")
    if steps.dt.size > MAX_ROWS:
        raise ValueError(
            f"the query needs {steps.dt.size} steps a run, above {MAX_ROWS}: ask for a shorter bound or interval"
        )
    plan = augmented_plan(steps, world.belief.x if world.belief is not None else distributions.mean(world.first))
    clock = np.concatenate([[0.0], np.cumsum(steps.dt)])
    begins = steps.segments.time if steps.segments is not None else clock[:-1]
    closed = plan.steps.closed
    bridge = closed.noise[:, 0, 0] / np.maximum(closed.phi[:, 0, 0], MIN_DECAY)
    notes = list(trace_notes(trace, world, cuts.bound, len(steps.unmatched)))
    if plan.plant.thermostat is not None or plan.plant.radiation is not None:
        notes.append("thermostat and radiation are followed run by run, the noise of a step being that of its begin")
    if plan.plant.lags:
        notes.append("behind the sensor's lag the path is smooth: its extremes are those of the steps' ends")
    if sha.max_rate < inf:
        notes.append("the maximum rate holds for the mean slope of each step")
    return KnownUnderEffects(
        world=world,
        plan=plan,
        clock=clock,
        before=sensor_offsets(sha, begins),
        # Just before the end, so that a step of the sensor's own offset there belongs to the row that follows.
        after=sensor_offsets(sha, begins + steps.dt - np.where(steps.dt > 0, 1e-9, 0.0)),
        bridge=np.zeros_like(bridge) if plan.plant.lags else bridge,
        notes=tuple(notes),
    )


def relative(sha: SHA, begin: float) -> SHA:
    """The automaton on a clock that is 0 at `begin` (absolute s), its dead time being in the events already."""
    effects = []
    for effect in sha.effects:
        kind = effect_kind(effect)
        absolute = {name for name, each in kind.parameters.items() if each.unit == ABSOLUTE_SECONDS}
        params = {name: value - begin if name in absolute else value for name, value in effect.params.items()}
        effects.append(replace(effect, params={"delay": 0.0} if kind.law == Structural("dead time") else params))
    return replace(sha, effects=tuple(effects))


def _outputs(coarse: Schedule, cuts: Cuts, sha: SHA) -> Array:
    """Where steps must end; twice where an instant counts or the sensor steps."""
    begins = np.concatenate([[0.0], np.cumsum(coarse.dt)])[:-1]
    # The fastest of all that moves what the sensor reads: X, the lag behind it, the housing that it exchanges with.
    plant = compile_plant(sha)
    speed = fastest(plant)
    if plant.lags:
        speed = np.maximum(speed, plant.lag_rate)
    if isfinite(plant.housing_tau):
        speed = np.maximum(speed, 1.0 / plant.housing_tau)
    if plant.disturbance is not None:
        speed = np.maximum(speed, 1.0 / plant.disturbance.params["memory"])
    part = MAX_PIECE_TAUS / np.maximum(speed, 1e-12)
    points = [np.array([cuts.bound])]
    instants = {time for time in cuts.instants if 0.0 <= time <= cuts.bound}
    instants |= {at for at in offset_times(sha) if 0.0 < at < cuts.bound}
    for first, dt, age, place in zip(begins, coarse.dt, coarse.age, coarse.location, strict=True):
        longest = min(MAX_PIECE_S, float(part[place]), cuts.longest)
        for low, high in cuts.looked:
            left, right = max(float(first), low), min(float(first + dt), high)
            if right > left:
                count = int(np.ceil((right - left) / longest))
                if count > MAX_ROWS:
                    raise ValueError(f"the query needs more than {MAX_ROWS} steps a run: ask for a shorter bound")
                points.append(np.linspace(left, right, count + 1)[1:])
        instants |= set(crossings(cuts.clocks, float(first), float(dt), float(age)))
    doubled = np.repeat(np.array(sorted(instants)), 2)
    singles = np.unique(np.concatenate(points))
    near = np.isin(np.round(singles, 9), np.round(np.concatenate([doubled, begins]), 9)) & (singles < cuts.bound)
    singles = singles[~near & ~np.isin(singles, doubled)]
    return np.sort(np.concatenate([singles, doubled]))
