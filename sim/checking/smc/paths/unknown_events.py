"""Runs whose events are not known: each on its own clock, from stay to stay by the model's semi-Markov law.

All runs share a grid of rows; inside a row a run stops at its own jumps, at conditions on its own clocks and where its
flow demands shorter pieces. Only the runs that still have a part of the row before them go round again.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import isfinite

import numpy as np

from sim.checking.smc.paths.known_events import MOST_ROWS, Cuts
from sim.checking.smc.paths.plan import (
    LEAST_DECAY,
    Indices,
    Piece,
    State,
    World,
    clamp,
    draw_mode,
    draw_start,
    limit,
)
from sim.checking.smc.paths.tilting import Tilts, start_at, start_tiltable
from sim.sha import (
    MOST_STAYS,
    Array,
    Chain,
    Mask,
    compile_chain,
    distributions,
    drawn_temperature,
    flows,
    input_moments,
)

ROWS = 64
"""Rows of the common grid at least: runs that are decided are left out from row to row."""


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

    def tilted(self, tilts: Tilts) -> "SemiMarkov":
        """The same with the m of the first stay drawn by this law."""
        return replace(self, tilts=tilts)

    def begin(self, runs: int, rng: np.random.Generator) -> State:
        """`runs` runs at the start, each with the time at which it leaves its first stay."""
        world, current = self.world, self.world.location
        drawn = np.empty(0) if self.tilts is None else np.full((runs, self.columns), np.nan)
        if self.tilts is None or not self.columns:
            x, mode = draw_start(world, runs, rng)
        else:
            drawn[:, 0] = self.tilts.scores(0, runs, rng)
            x, mode = start_at(world, drawn[:, 0], rng)
        mode = mode + (world.belief.offset if world.belief is not None else self._offset(current, runs, rng))
        x, outside = clamp(world.sha, x)
        law = self.chain.laws[current]
        leaves = np.full(runs, np.inf) if law is None else distributions.draw_remaining(law, world.age, runs, rng)
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
        )

    def advance(self, row: int, state: State, rng: np.random.Generator) -> Iterator[Piece]:
        """The pieces of one row; each run takes part in as many as its jumps and cuts ask for."""
        begin, end = float(self.clock[row]), float(self.clock[row + 1])
        rows: Indices | None = None
        now: Array = np.full(state.x.size, begin)
        while now.size:
            who = np.arange(state.x.size) if rows is None else rows
            stop, instant = self._stop(state, who, now, end, looked=bool(self.looked[row]))
            yield self._moved(state, rows, who, now=now, dt=stop - now, rng=rng)
            if instant.any():
                yield self._instant(state, who[instant], stop[instant])
            self._jump(state, who[state.leaves[who] <= stop], rng)
            left = stop < end
            rows, now = who[left], stop[left]

    def _stop(self, state: State, who: Indices, now: Array, end: float, *, looked: bool) -> tuple[Array, Mask]:
        """Where each run stops next, and whether a condition on its clocks changes there."""
        stop = np.minimum(state.leaves[who], end)
        entered = state.entered[who]
        if looked:
            location = state.location[who]
            for place in _visited(location):
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

    def _moved(
        self, state: State, rows: Indices | None, who: Indices, *, now: Array, dt: Array, rng: np.random.Generator
    ) -> Piece:
        start, mode, age = state.x[who], state.mode[who], now - state.entered[who]
        location = state.location[who]
        decay, pull, variance = np.empty((3, who.size))
        fast = np.zeros(who.size, dtype=np.bool_)
        mean = np.empty(who.size)
        rate = self.world.sha.max_rate
        for place in _visited(location):
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
        end, outside = clamp(self.world.sha, mean + np.sqrt(variance) * rng.standard_normal(who.size))
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
            bridge=variance / np.maximum(decay, LEAST_DECAY),
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
        u = rng.random(rows.size)
        state.location[rows] = (u[:, None] >= self.chain.cumulative[state.location[rows]]).sum(axis=1)
        state.entered[rows] = state.leaves[rows]
        state.stays[rows] += 1
        for place in _visited(state.location[rows]):
            jumps = rows[state.location[rows] == place]
            state.mode[jumps] = draw_mode(self.world.sha, place, jumps.size, rng) + self._offset(place, jumps.size, rng)
            law, fresh = self.chain.laws[place], drawn_temperature(self.world.sha.locations[place])
            lasts = np.inf if law is None else distributions.draw(law, jumps.size, rng)
            state.leaves[jumps] = np.where(state.stays[jumps] < MOST_STAYS, state.entered[jumps] + lasts, np.inf)
            if fresh is not None:
                state.x[jumps], outside = clamp(self.world.sha, distributions.draw(fresh, jumps.size, rng))
                if outside is not None:
                    state.clamps[jumps] += outside

    def _offset(self, place: int, runs: int, rng: np.random.Generator) -> Array | float:
        mean, sigma = self.inputs[place].tolist()
        return np.asarray(mean + sigma * rng.standard_normal(runs)) if sigma else float(mean)


def _visited(location: Indices) -> list[int]:
    """The locations in which some run is, ascending; counted, which for a few small numbers is far cheaper than a hash
    of all runs."""
    return [place for place, runs in enumerate(np.bincount(location).tolist()) if runs]


def semi_markov(world: World, cuts: Cuts) -> SemiMarkov:
    """The engine of unknown events. Raises ValueError for an unusable semi-Markov law or a query of too many rows."""
    model = world.tracker.model
    instants = [time for time in cuts.instants if 0.0 <= time <= cuts.bound]
    rows = int(np.ceil(cuts.bound / min(cuts.longest, cuts.bound / ROWS)))
    if rows > MOST_ROWS:
        raise ValueError(f"the query needs {rows} steps a run, above {MOST_ROWS}: ask for a shorter bound")
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
    columns = int(start_tiltable(world))
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
