"""Runs under effects whose events are known: the simulator's own steps, short enough that a query can look at them.

Every run has its own X, housing, lags, thermostat and m. Steps are those of `sim.engine.tables`, at most MAX_PIECE_S s
and 0.05 of the fastest time constant where the temperature counts. In between the path of X is the bridge of its
noise about a straight line; after a lag it is smooth, and its extremes are those of the steps' ends.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf

import numpy as np

from sim.effects import sensor_offsets
from sim.engine import Hidden, SamplingPlan, Schedule, augmented_plan, draw_states, drawn_start
from sim.lab.checking.smc.paths.plan import MIN_DECAY, Indices, Piece, State, World, draw_mode
from sim.lab.checking.smc.paths.tilting import Tilts
from sim.sha import SHA, Array, distributions, draw_temperature


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
            law = draw_temperature(schedule_.sha.locations[place])
            if law is not None:
                s[:, 0] = distributions.draw(law, runs, rng)
                _clamp(schedule_.sha, s, state.clamps)
            state.mode = draw_mode(schedule_.sha, place, runs, rng)
        start = s[:, plant.sensor_state] + self.before[row]
        if dt > 0:
            s, opened, met = plan.advance(row, s, state.mode, opened, rng)
            state.limited += met
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


def effects_engine(world: World, steps: Schedule, notes: tuple[str, ...]) -> KnownUnderEffects:
    """The engine along `steps`, made on a clock that is 0 at the start; `notes` are those of the trace."""
    plan = augmented_plan(steps, world.belief.x if world.belief is not None else distributions.mean(world.first))
    sha, clock = steps.sha, np.concatenate([[0.0], np.cumsum(steps.dt)])
    begins = steps.segments.time if steps.segments is not None else clock[:-1]
    closed = plan.steps.closed
    bridge = closed.noise[:, 0, 0] / np.maximum(closed.phi[:, 0, 0], MIN_DECAY)
    if plan.plant.thermostat is not None or plan.plant.radiation is not None:
        notes += ("thermostat and radiation are followed run by run, the noise of a step being that of its begin",)
    if plan.plant.lags:
        notes += ("behind the sensor's lag the path is smooth: its extremes are those of the steps' ends",)
    if sha.max_rate < inf:
        notes += ("the maximum rate holds for the mean slope of each step",)
    return KnownUnderEffects(
        world=world,
        plan=plan,
        clock=clock,
        before=sensor_offsets(sha, begins),
        # Just before the end, so that a step of the sensor's own offset there belongs to the row that follows.
        after=sensor_offsets(sha, begins + steps.dt - np.where(steps.dt > 0, 1e-9, 0.0)),
        bridge=np.zeros_like(bridge) if plan.plant.lags else bridge,
        notes=notes,
    )
