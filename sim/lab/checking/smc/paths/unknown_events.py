"""Runs whose events are not known: each on its own clock, from stay to stay by the model's semi-Markov law.

All runs share a grid of rows; inside a row a run stops at its own jumps, at conditions on its own clocks and where its
flow demands shorter pieces. Only the runs that still have a part of the row before them go round again. As long as all
runs are in one and the same stay, its pieces are the same for all and are worked out once (`SemiMarkov._together`).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import ceil, isfinite, sqrt

import numpy as np

from sim.effects import disturbance_step
from sim.lab.checking.smc.paths import long_steps
from sim.lab.checking.smc.paths.known_events import MAX_ROWS, Cuts
from sim.lab.checking.smc.paths.long_steps import NestedStep
from sim.lab.checking.smc.paths.plan import (
    MIN_DECAY,
    Indices,
    Piece,
    State,
    World,
    clamp,
    draw_hidden_states,
    draw_mode,
    draw_start,
    limit,
    start_tiltable,
    state_from_scores,
)
from sim.lab.checking.smc.paths.tilting import Tilts
from sim.sha import (
    MAX_STAYS,
    Array,
    Chain,
    Mask,
    compile_chain,
    distributions,
    draw_temperature,
    flows,
    input_moments,
)

MAX_PIECE_MEMORIES = 0.1
"""Longest piece in units of a disturbance's memory: the mean of its ends is then right to a thousandth."""
MIN_ROWS = 64
"""Rows of the common grid at least: runs that are decided are left out from row to row."""

CLOCK_TOLERANCE = 1e-9
"""Relative to its constant, what a condition on clocks may be off and still change at this instant."""


@dataclass(frozen=True, slots=True)
class SemiMarkov:
    """The engine (`paths.Engine`) of unknown events. `looked` (S,) says in which rows the temperature counts."""

    world: World
    clock: Array
    looked: Mask
    cuts: Cuts
    chain: Chain
    inputs: Array
    notes: tuple[str, ...] = ()
    columns: int = 0
    tilts: Tilts | None = None

    def tilt(self, tilts: Tilts) -> "SemiMarkov":
        """The same with the m of the first stay drawn by this law."""
        return replace(self, tilts=tilts)

    def begin(self, runs: int, rng: np.random.Generator) -> State:
        """`runs` runs at the start, each with the time at which it leaves its first stay."""
        world, current = self.world, self.world.location
        drawn = np.empty(0) if self.tilts is None else np.full((runs, self.columns), np.nan)
        hidden = np.empty(0)
        if (plant := world.tracker.plant) is not None:
            hidden, mode = draw_hidden_states(world, plant, runs, rng)
            x = hidden[:, 0].copy()
        elif self.tilts is None or not self.columns:
            x, mode = draw_start(world, runs, rng)
        else:
            drawn[:, 0] = self.tilts.scores(0, runs, rng)
            x, mode = state_from_scores(world, drawn[:, 0], rng)
        mode = mode + (world.belief.offset if world.belief is not None else self._offset(current, runs, rng))
        x, outside = clamp(world.sha, x)
        law = self.chain.laws[current]
        leaves = np.full(runs, np.inf) if law is None else distributions.draw_residual(law, world.age, runs, rng)
        none = np.zeros(runs, dtype=np.intp)
        clamps = none.copy() if outside is None else outside.astype(np.intp)
        return State(
            x,
            mode,
            clamps,
            none.copy(),
            location=none + current,
            entered=np.full(runs, -world.age),
            leaves=leaves,
            stays=none.copy(),
            drawn=drawn,
            hidden=hidden,
        )

    def advance(self, row: int, state: State, rng: np.random.Generator) -> Iterator[Piece]:
        """The pieces of one row; each run takes part in as many as its jumps and cuts ask for."""
        begin, end = float(self.clock[row]), float(self.clock[row + 1])
        # A plant that is random beyond its flows has states of its own in each run, which are moved run by run.
        alike = self.world.tracker.plant is None and not self.cuts.clocks
        if alike and state.x.size and _in_one_stay(state) and float(state.leaves.min()) > end:
            yield from self._together(state, begin, end, looked=bool(self.looked[row]), rng=rng)
            return
        rows: Indices | None = None
        now: Array = np.full(state.x.size, begin)
        while now.size:
            who = np.arange(state.x.size) if rows is None else rows
            stop, instant = self._stop(state, who, now, end, looked=bool(self.looked[row]))
            yield self._advance(state, rows, who, now=now, dt=stop - now, rng=rng)
            if instant.any():
                yield self._instant(state, who[instant], stop[instant])
            jumping = state.leaves[who] <= stop
            self._jump(state, who[jumping], rng)
            # The clock of a stay begins at 0, where a condition such as `age > 0` changes: an instant by itself.
            entered = np.zeros(who.size, dtype=np.bool_)
            for c, t, _ in self.cuts.clocks:
                entered |= jumping & (np.abs(c + t * stop) <= CLOCK_TOLERANCE * (1.0 + abs(c)))
            if entered.any():
                yield self._instant(state, who[entered], stop[entered])
            left = stop < end
            rows, now = who[left], stop[left]

    def _together(
        self, state: State, begin: float, end: float, *, looked: bool, rng: np.random.Generator
    ) -> Iterator[Piece]:
        """The pieces of a row in which all runs are in one stay that none leaves: times and coefficients are numbers.

        Piece by piece it is the same arithmetic in the same order as `_stop` and `_advance` do for runs apart.
        """
        sha = self.world.sha
        place, entered = int(state.location[0]), float(state.entered[0])
        flow = sha.locations[place].flow
        mode = float(state.mode[0]) if (state.mode == state.mode[0]).all() else state.mode
        begins, ends = [begin], [end]
        while looked and (stop := begins[-1] + float(limit(flow, begins[-1] - entered))) < end:
            ends.insert(-1, stop)
            begins.append(stop)
        times = np.array(begins)
        ages, steps = times - entered, np.array(ends) - times
        columns = (times, steps, ages, *flows.coefficients(flow, ages, steps))
        parts = [
            NestedStep(
                begin=now,
                dt=dt,
                age=age,
                location=place,
                decay=decay,
                pull=pull,
                shift=0.0,
                variance=variance,
                bridge=variance / max(decay, MIN_DECAY),
            )
            for now, dt, age, decay, pull, variance in zip(*(column.tolist() for column in columns), strict=True)
        ]
        most = long_steps.MAX_PIECES if self.cuts.lines is not None and not isfinite(sha.max_rate) else 1
        each = ceil(len(parts) / ceil(len(parts) / most))  # groups of about the same size
        for first in range(0, len(parts), each):
            group = parts[first : first + each]
            if len(group) > 1 and flow.params["noise"]:
                whole = long_steps.join_steps(group).advance(state, mode, sha=sha, lines=self.cuts.lines or (), rng=rng)
                if whole is not None:
                    yield from whole
                    continue
            for part in group:
                yield self._single_piece(part, state, mode, rng)

    def _single_piece(self, step: NestedStep, state: State, mode: Array | float, rng: np.random.Generator) -> Piece:
        """A single piece of runs that are in one stay."""
        sha, start = self.world.sha, state.x
        if isfinite(sha.max_rate):
            flow = sha.locations[step.location].flow
            state.limited += (np.abs(flows.drift(flow, start, mode, step.age)) > sha.max_rate) & (step.dt > 0)
            mean = flows.mean_step(flow, start, mode, age=step.age, dt=step.dt, max_rate=sha.max_rate)
        else:
            mean = step.mean(start, mode)
        x = rng.standard_normal(start.size)
        x *= sqrt(step.variance)
        x += mean
        state.x, outside = clamp(sha, x)
        if outside is not None:
            state.clamps += outside
        return step.piece(None, start, state.x)

    def _stop(self, state: State, who: Indices, now: Array, end: float, *, looked: bool) -> tuple[Array, Mask]:
        """Where each run stops next, and whether a condition on its clocks changes there."""
        stop = np.minimum(state.leaves[who], end)
        plant = self.world.tracker.plant
        if plant is not None and plant.disturbance is not None:
            # Inside a piece the disturbance is the mean of its ends'.
            stop = np.minimum(stop, now + MAX_PIECE_MEMORIES * plant.disturbance.params["memory"])
        entered = state.entered[who]
        if looked:
            location = state.location[who]
            for place in _visited_locations(location):
                members = np.flatnonzero(location == place)
                longest = limit(self.world.sha.locations[place].flow, now[members] - entered[members])
                stop[members] = np.minimum(stop[members], now[members] + longest)
        instant = np.zeros(now.size, dtype=np.bool_)
        for c, t, g in self.cuts.clocks:
            if t + g != 0.0:
                time = (g * entered - c) / (t + g)
                sooner = (time > now) & (time < stop)
                instant = (instant & ~sooner) | sooner
                stop = np.where(sooner, time, stop)
        return stop, instant

    def _advance(
        self, state: State, rows: Indices | None, who: Indices, *, now: Array, dt: Array, rng: np.random.Generator
    ) -> Piece:
        start, mode, age = state.x[who], state.mode[who], now - state.entered[who]
        location = state.location[who]
        if (plant := self.world.tracker.plant) is not None and plant.machine is not None:
            mode = mode + (plant.rate > 0)[location] * state.hidden[who, plant.offset_state]
        decay, pull, variance = np.empty((3, who.size))
        fast = np.zeros(who.size, dtype=np.bool_)
        mean = np.empty(who.size)
        rate = self.world.sha.max_rate
        for place in _visited_locations(location):
            members = location == place
            flow = self.world.sha.locations[place].flow
            decay[members], pull[members], variance[members] = flows.coefficients(flow, age[members], dt[members])
            if isfinite(rate):
                fast[members] = np.abs(flows.drift(flow, start[members], mode[members], age[members])) > rate
                mean[members] = flows.mean_step(
                    flow, start[members], mode[members], age=age[members], dt=dt[members], max_rate=rate
                )
        if not isfinite(rate):
            mean = decay * start + pull * mode
        white = rng.standard_normal(who.size)
        noise = np.sqrt(variance) * white
        if (plant := self.world.tracker.plant) is not None and plant.disturbance is not None:
            # Beside the limit on the rate, which is that of the flow: a disturbance is noise with a memory.
            p = plant.disturbance.params
            step = disturbance_step(p["memory"], plant.rate[location], dt)
            # What of the disturbance's doing in X its own news do not tell is drawn with the white noise.
            noise = np.sqrt(variance + p["sigma"] ** 2 * step.own) * white
            fresh = p["sigma"] * np.sqrt(step.dd) * rng.standard_normal(who.size)
            heat = state.hidden[who, plant.heat_state]
            noise += step.carried * heat + step.coupling * fresh
            state.hidden[who, plant.heat_state] = step.keep * heat + fresh
        end, outside = clamp(self.world.sha, mean + noise)
        state.limited[who] += fast & (dt > 0)
        if outside is not None:
            state.clamps[who] += outside
        state.x[who] = end
        return Piece(
            rows=rows,
            begin=now,
            dt=dt,
            age=age,
            location=location,
            start=start,
            end=end,
            bridge=variance / np.maximum(decay, MIN_DECAY),
        )

    def _instant(self, state: State, rows: Indices, now: Array) -> Piece:
        x, nothing = state.x[rows], np.zeros(rows.size)
        return Piece(
            rows=rows,
            begin=now,
            dt=nothing,
            age=now - state.entered[rows],
            location=state.location[rows],
            start=x,
            end=x,
            bridge=nothing,
        )

    def _jump(self, state: State, rows: Indices, rng: np.random.Generator) -> None:
        """The runs of these rows leave their stay: next location, its m, its inputs, how long it lasts."""
        if not rows.size:
            return
        state.location[rows] = self.chain.next_locations(state.location[rows], rng.random(rows.size))
        state.entered[rows] = state.leaves[rows]
        state.stays[rows] += 1
        for place in _visited_locations(state.location[rows]):
            jumps = rows[state.location[rows] == place]
            state.mode[jumps] = draw_mode(self.world.sha, place, jumps.size, rng) + self._offset(place, jumps.size, rng)
            law, fresh = self.chain.laws[place], draw_temperature(self.world.sha.locations[place])
            lasts = np.inf if law is None else distributions.draw(law, jumps.size, rng)
            state.leaves[jumps] = np.where(state.stays[jumps] < MAX_STAYS, state.entered[jumps] + lasts, np.inf)
            if fresh is not None:
                state.x[jumps], outside = clamp(self.world.sha, distributions.draw(fresh, jumps.size, rng))
                if outside is not None:
                    state.clamps[jumps] += outside

    def _offset(self, place: int, runs: int, rng: np.random.Generator) -> Array | float:
        mean, sigma = self.inputs[place].tolist()
        return np.asarray(mean + sigma * rng.standard_normal(runs)) if sigma else float(mean)


def _in_one_stay(state: State) -> bool:
    """Whether all runs are in the same location and entered it at the same time."""
    return bool((state.location == state.location[0]).all() and (state.entered == state.entered[0]).all())


def _visited_locations(location: Indices) -> list[int]:
    """The locations in which some run is, ascending; counted, which for a few small numbers is far cheaper than a hash
    of all runs."""
    return [place for place, runs in enumerate(np.bincount(location).tolist()) if runs]


def semi_markov(world: World, cuts: Cuts) -> SemiMarkov:
    """The engine of unknown events. Raises ValueError for an unusable semi-Markov law or a query of too many rows."""
    model = world.tracker.model
    instants = [time for time in cuts.instants if 0.0 <= time <= cuts.bound]
    rows = int(np.ceil(cuts.bound / min(cuts.longest, cuts.bound / MIN_ROWS)))
    if rows > MAX_ROWS:
        raise ValueError(f"the query needs {rows} steps a run, above {MAX_ROWS}: ask for a shorter bound")
    grid = np.union1d(np.linspace(0.0, cuts.bound, rows + 1), [edge for pair in cuts.looked for edge in pair])
    grid = grid[(grid >= 0.0) & (grid <= cuts.bound)]
    clock = np.sort(np.concatenate([np.setdiff1d(grid, instants), np.repeat(np.unique(instants), 2)]))
    middle = 0.5 * (clock[:-1] + clock[1:])
    looked = np.zeros(middle.size, dtype=np.bool_)
    for low, high in cuts.looked:
        looked |= (middle >= low) & (middle <= high)
    held = world.belief.signals if world.belief is not None else {}
    chain, current = compile_chain(model), world.location
    notes: tuple[str, ...] = ()
    if chain.laws[current] is None:
        notes = (f"the runs start in {chain.names[current]!r}, for which the model has no semi-Markov law: never left",)
    # The states of a plant that is random beyond its flows are drawn together; none of them is drawn elsewhere.
    columns = int(world.tracker.plant is None and start_tiltable(world))
    return SemiMarkov(
        world=world,
        clock=clock,
        looked=looked,
        cuts=cuts,
        chain=chain,
        inputs=input_moments(model, held),
        notes=notes,
        columns=columns,
    )
