"""What statistical checking runs: where runs start, what drives them, and the pieces in which a run is looked at.

A piece is a stretch of a run in one location with its clocks and its temperature at both ends: short enough that the
path in between is a Brownian bridge (`sim.engine.particles` gives the formula and the change of time behind it). How
far the bridge rises above the straight line is drawn once a piece, as an exponential number e: the path has reached the
line from p0 to p1 when

    (p0 - x0) (p1 - x1) < V e / 2,    V = variance / decay,

which has exactly the bridge's probability exp(-2 (p0 - x0) (p1 - x1) / V), the same e for every line. How far it falls
is drawn apart: the joint law of a rise and a fall within one piece is that of independent ones.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from math import exp, sqrt
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sim.engine import Belief, Plant, Tracker, draw_belief, draw_states, drawn_start
from sim.lab.checking.smc.paths.tilting import Tilts, tiltable
from sim.sha import (
    RELAXING_FLOWS,
    SHA,
    Array,
    Distribution,
    Flow,
    Mask,
    Trace,
    distributions,
    draw_parameter,
    mode_parameter,
)

Indices = NDArray[np.intp]

MAX_PIECE_TAUS = 0.05
"""Longest piece in units of a flow's time constant: the bridge's straight line is then within 0.4 % of a standard
deviation of the bridge, four stationary deviations away from the target."""

MAX_PIECE_S = 4.0
"""Longest piece (s) where the order of two things within one piece counts."""

NEGLIGIBLE_EXPONENT = 40.0
"""A bridge whose (p0 - x0) (p1 - x1) exceeds 20 V reaches the line with a chance below exp(-40); nothing is drawn."""

MIN_DECAY = exp(-1.0)


@dataclass(frozen=True, slots=True)
class World:
    """What the runs live in. They start at `begin` (absolute s) in `location` (index), `age` seconds after entry.

    X starts by `first`; or X and m jointly as the `belief` has them. `trace` gives the events and inputs to come, on
    its own clock; without one they follow the model's semi-Markov law.
    """

    tracker: Tracker
    begin: float
    location: int
    first: Distribution
    belief: Belief | None = None
    trace: Trace | None = None

    @property
    def sha(self) -> SHA:
        """The automaton."""
        return self.tracker.model.sha

    @property
    def under_effects(self) -> bool:
        """Whether the runs need the engine of effects: without a trace what is only random is drawn stay by stay."""
        plant = self.tracker.plant
        return plant is not None and (self.trace is not None or not plant.is_random)

    @property
    def age(self) -> float:
        """Seconds since the present location was entered, at the start."""
        return 0.0 if self.belief is None else self.belief.age


@dataclass(slots=True)
class State:
    """Where n runs are. `x` (degC), `mode` (m; where stays are drawn, m + offset); counts of clamps and rate limits.

    `location`, `entered`, `leaves` (s since the start) and `stays` belong to runs with clocks of their own. `drawn`
    (n, K) are the standard scores of mode parameters that are drawn by laws of their own
    (`sim.lab.checking.smc.paths.tilting`).
    `hidden` (n, d + 1) are the states under effects and whether the thermostat is open; empty without effects.
    """

    x: Array
    mode: Array
    clamps: Indices
    limited: Indices
    location: Indices = field(default_factory=lambda: np.empty(0, dtype=np.intp))
    entered: Array = field(default_factory=lambda: np.empty(0))
    leaves: Array = field(default_factory=lambda: np.empty(0))
    stays: Indices = field(default_factory=lambda: np.empty(0, dtype=np.intp))
    drawn: Array = field(default_factory=lambda: np.empty(0))
    hidden: Array = field(default_factory=lambda: np.empty(0))

    def reals(self) -> tuple[Array, ...]:
        """The columns of real numbers."""
        return self.x, self.mode, self.entered, self.leaves, self.drawn, self.hidden

    def wholes(self) -> tuple[Indices, ...]:
        """The columns of whole numbers."""
        return self.clamps, self.limited, self.location, self.stays

    def take(self, rows: Indices | Mask) -> "State":
        """The runs of these rows, copied."""
        return _state(
            [column[rows] if column.size else column for column in self.reals()],
            [column[rows] if column.size else column for column in self.wholes()],
        )

    def put(self, rows: Indices, other: "State") -> None:
        """Write the runs of `other` into these rows."""
        for real, values in zip(self.reals(), other.reals(), strict=True):
            real[rows if real.size else slice(0)] = values
        for whole, count in zip(self.wholes(), other.wholes(), strict=True):
            whole[rows if whole.size else slice(0)] = count

    def concatenate(self, other: "State") -> "State":
        """These runs and the other ones."""
        return _state(
            [np.concatenate(pair) for pair in zip(self.reals(), other.reals(), strict=True)],
            [np.concatenate(pair) for pair in zip(self.wholes(), other.wholes(), strict=True)],
        )


def _state(reals: list[Array], wholes: list[Indices]) -> State:
    x, mode, entered, leaves, drawn, hidden = reals
    clamps, limited, location, stays = wholes
    return State(
        x,
        mode,
        clamps,
        limited,
        location=location,
        entered=entered,
        leaves=leaves,
        stays=stays,
        drawn=drawn,
        hidden=hidden,
    )


@dataclass(slots=True, kw_only=True)
class Piece:
    """A piece of n runs; times in s since the start. What all runs share is one number, otherwise (n,).

    `rows` are the runs' rows in their state (None: all of them). `start` and `end` are the temperatures, `bridge` is V.
    `rise` and `fall` are (rows within the piece, e) for the runs whose bridge may matter, None where none was drawn.
    """

    rows: Indices | None
    begin: float | Array
    dt: float | Array
    age: float | Array
    location: int | Indices
    start: Array
    end: Array
    bridge: float | Array
    rise: tuple[Indices, Array] | None = None
    fall: tuple[Indices, Array] | None = None

    @property
    def middle(self) -> float | Array:
        """The moment half-way, s since the start."""
        return self.begin + 0.5 * self.dt

    def opening(self) -> "Piece":
        """The piece's first instant alone."""
        return replace(self, dt=0.0 * self.dt, end=self.start, bridge=0.0 * self.bridge, rise=None, fall=None)


class Engine(Protocol):
    """Moves runs through common rows of time: `rows` many, row k from `clock[k]` to `clock[k + 1]` (s)."""

    @property
    def clock(self) -> Array:
        """(S + 1,) the ends of the rows, s since the start; equal neighbours are an instant."""
        ...

    @property
    def notes(self) -> tuple[str, ...]:
        """What limits the runs' truth, one sentence each."""
        ...

    @property
    def columns(self) -> int:
        """How many mode parameters may be drawn by laws of their own (`sim.lab.checking.smc.paths.tilting`)."""
        ...

    def tilt(self, tilts: Tilts) -> "Engine":
        """The same with those mode parameters drawn by these laws."""
        ...

    def begin(self, runs: int, rng: np.random.Generator) -> State:
        """`runs` runs at the start."""
        ...

    def advance(self, row: int, state: State, rng: np.random.Generator) -> Iterator[Piece]:
        """The pieces of one row, in the order of time; the state has moved on when they have been taken."""
        ...


def limit(flow: Flow, age: float | Array) -> float | Array:
    """The longest piece (s) of a flow whose path is looked at, `age` s after entry."""
    if flow.kind in RELAXING_FLOWS:
        return MAX_PIECE_TAUS / flow.params["k"]
    if flow.kind == "transient":
        # Pieces of MAX_PIECE_TAUS tau exp(u / 2 tau): in each the course is as far from its chord. They are equal steps
        # of exp(-u / 2 tau), so that there are 2 / MAX_PIECE_TAUS of them at most, and the last one has no end.
        twice = 2.0 * flow.params["tau"]
        step = 0.5 * MAX_PIECE_TAUS * np.exp(np.minimum(age / twice, 50.0))
        return np.where(step < 1.0, -twice * np.log1p(-np.minimum(step, 1.0 - 1e-12)), np.inf)
    return MAX_PIECE_TAUS * (flow.params["t0"] + age) if flow.kind == "logarithmic" else np.inf


def start_tiltable(world: World) -> bool:
    """Whether m at the start is normal and not known."""
    if world.belief is not None:
        return world.belief.mm > 0
    return tiltable(draw_parameter(world.sha.locations[world.location]))


def state_from_scores(world: World, scores: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """(X, m) of runs at the start whose m has these standard scores; X by its law, a belief's given m."""
    belief = world.belief
    if belief is None:
        mean, variance = mode_parameter(world.sha.locations[world.location])
        return distributions.draw(world.first, scores.size, rng), mean + sqrt(variance) * scores
    # The belief's joint normal law the other way round: X given m, as it is m that is chosen here.
    share = belief.xm / sqrt(belief.mm)
    own = sqrt(max(belief.xx - share * share, 0.0))
    return belief.x + share * scores + own * rng.standard_normal(scores.size), belief.m + sqrt(belief.mm) * scores


def draw_start(world: World, runs: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """(X, m) of `runs` runs at the start: from the belief's joint normal law, or X by `first` and m by its location."""
    belief = world.belief
    if belief is None:
        x = distributions.draw(world.first, runs, rng)
        return x, draw_mode(world.sha, world.location, runs, rng)
    return draw_belief(belief, runs, rng)


def draw_hidden_states(world: World, plant: Plant, runs: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """(states (N, d), m (N,)) at the start of runs of a plant that is random beyond its flows."""
    belief = world.belief
    if belief is not None and belief.hidden is not None:
        return draw_states(belief.hidden, runs, rng)
    x = distributions.draw(world.first, runs, rng)
    return drawn_start(plant, x, 0.0, rng), draw_mode(world.sha, world.location, runs, rng)


def draw_mode(sha: SHA, location: int, runs: int, rng: np.random.Generator) -> Array:
    """m of `runs` stays in a location, drawn by its law or fixed."""
    law = draw_parameter(sha.locations[location])
    if law is not None:
        return distributions.draw(law, runs, rng)
    return np.full(runs, mode_parameter(sha.locations[location])[0])


def clamp(sha: SHA, x: Array) -> tuple[Array, Mask | None]:
    """`x` put back into the automaton's range, and which were outside (None: none)."""
    if x.size == 0 or (x.min() >= sha.low and x.max() <= sha.high):
        return x, None
    return np.clip(x, sha.low, sha.high), (x < sha.low) | (x > sha.high)


def may_reach(piece: Piece, begin: float | Array, end: float | Array) -> Mask:
    """Whether a run's bridge may reach the line from `begin` to `end`, or an end of the piece lies beyond it."""
    product = begin - piece.start
    product *= end - piece.end
    return np.asarray(product < (NEGLIGIBLE_EXPONENT / 2.0) * piece.bridge)


def with_extremes(
    piece: Piece,
    ups: list[tuple[float | Array, float | Array]],
    downs: list[tuple[float | Array, float | Array]],
    rng: np.random.Generator,
) -> None:
    """Draw the bridge's rise and fall for the runs near a line that is looked at from below (`ups`) or from above."""
    if not (piece.bridge.any() if isinstance(piece.bridge, np.ndarray) else piece.bridge):
        return
    for lines, name in ((ups, "rise"), (downs, "fall")):
        if lines:
            candidates = may_reach(piece, *lines[0])
            for line in lines[1:]:
                candidates |= may_reach(piece, *line)
            rows = np.flatnonzero(candidates)
            if rows.size:
                setattr(piece, name, (rows, rng.standard_exponential(rows.size)))
