"""Monitors: what is noted of runs while they go by, piece after piece, until the answer of each is known.

A monitor sees the pieces of n runs in the order of time. `who` are the runs (rows of the monitor) that a piece's rows
stand for. `watch` says which lines the temperature is looked at for, so that bridges are drawn for no others.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Protocol

import numpy as np

from sim.lab.checking.query import Expression, Indicator, Operation
from sim.lab.checking.smc.monitors.formula import (
    CLOCK_TOLERANCE,
    CompiledFormulas,
    Value,
    WatchedLines,
    begins_true,
    combine,
    exists,
    instant_truth,
    region,
    region_truth,
    table,
    table_at_begin,
    value,
    visited_regions,
    watched_lines,
)
from sim.lab.checking.smc.paths import Engine, Indices, Piece, State, with_extremes
from sim.sha import MAX_STAYS, Array, Mask

KEEP, EVERY = 0.95, 8
"""Decided runs are left out when fewer than KEEP of them are undecided, which is looked at after EVERY rows."""


class Monitor(Protocol):
    """What the runs are given to."""

    def watch(self, piece: Piece, who: Indices) -> WatchedLines:
        """The lines looked at from below and from above, at both ends of the piece."""
        ...

    def see(self, piece: Piece, who: Indices) -> None:
        """Note what happens in the piece."""
        ...

    def open(self) -> Mask | None:
        """The runs whose answer may still change; None: all."""
        ...


@dataclass(frozen=True, slots=True)
class Totals:
    """What happened to the runs that were followed: clamps, steps at the maximum rate, runs that ran out of stays."""

    clamps: int = 0
    limited: int = 0
    cut: int = 0

    def __add__(self, other: "Totals") -> "Totals":
        return Totals(self.clamps + other.clamps, self.limited + other.limited, self.cut + other.cut)


def follow(
    engine: Engine,
    monitors: Sequence[Monitor],
    runs: int,
    rng: np.random.Generator,
    wanted: Callable[[], bool] | None = None,
) -> Totals:
    """Lead `runs` runs past the monitors from the start to the end; decided runs are left out on the way.

    Where `wanted` is given and says no, it ends on the way: nobody looks at the monitors then.
    """
    state, who, totals = engine.begin(runs, rng), np.arange(runs), Totals()
    with np.errstate(over="ignore", invalid="ignore"):  # a line at infinity is never reached, one at no number neither
        for row in range(engine.clock.size - 1):
            for piece in engine.advance(row, state, rng):
                show(piece, who if piece.rows is None else who[piece.rows], monitors, rng)
            if row % EVERY != EVERY - 1:
                continue
            if wanted is not None and not wanted():
                break
            undecided = [monitor.open() for monitor in monitors]
            if any(mask is None for mask in undecided):
                continue
            # A run goes on as long as any monitor needs it; copying the rest pays only where many can go.
            keep = np.any([mask[who] for mask in undecided if mask is not None], axis=0)
            if np.count_nonzero(keep) < KEEP * keep.size:
                totals += _totals(state.take(~keep))
                state, who = state.take(keep), who[keep]
                if not who.size:
                    break
    return totals + _totals(state)


def _totals(state: State) -> Totals:
    return Totals(int(state.clamps.sum()), int(state.limited.sum()), int((state.stays >= MAX_STAYS).sum()))


def show(piece: Piece, who: Indices, monitors: Sequence[Monitor], rng: np.random.Generator) -> None:
    """Draw the extremes that some monitor looks at, and give the piece to all."""
    ups: list[tuple[Value, Value]] = []
    downs: list[tuple[Value, Value]] = []
    for monitor in monitors:
        more_ups, more_downs = monitor.watch(piece, who)
        ups += more_ups
        downs += more_downs
    if ups or downs:
        with_extremes(piece, ups, downs, rng)
    for monitor in monitors:
        monitor.see(piece, who)


def inside(piece: Piece, low: float, high: float) -> bool:
    """Whether the piece lies in low..high; all of a piece's runs are in the same row of time, cut at both ends."""
    middle = piece.middle
    if isinstance(middle, np.ndarray):
        middle = float(middle[0])
    return low - 1e-9 <= middle <= high + 1e-9


@dataclass(slots=True)
class EventuallyMonitor:
    """Whether a formula comes true within low..high (s), and by when (s; inf where not): the end of that piece, or its
    begin where it is true from there on."""

    compiled: CompiledFormulas
    low: float
    high: float
    runs: int
    satisfied: Mask = field(init=False)
    when: Array = field(init=False)

    def __post_init__(self) -> None:
        self.satisfied, self.when = np.zeros(self.runs, dtype=np.bool_), np.full(self.runs, inf)

    def watch(self, piece: Piece, who: Indices) -> WatchedLines:
        """The formula's lines, within the span."""
        return watched_lines(self.compiled, piece) if inside(piece, self.low, self.high) else ([], [])

    def see(self, piece: Piece, who: Indices) -> None:
        """Note the runs in which the formula is true somewhere."""
        if not inside(piece, self.low, self.high):
            return
        met = exists(self.compiled, 0, piece)
        if met is False:
            return
        rows = np.arange(who.size) if met is True else np.flatnonzero(met)
        new = rows[~self.satisfied[who[rows]]]
        self.satisfied[who[new]] = True
        if new.size:
            begin, dt = _of_rows(piece.begin, new), _of_rows(piece.dt, new)
            self.when[who[new]] = np.where(begins_true(self.compiled, 0, piece, new), begin, begin + dt)

    def open(self) -> Mask | None:
        """The runs in which it has not been true."""
        return ~self.satisfied


@dataclass(slots=True)
class UntilMonitor:
    """Whether `hold` (formula 0, negated) lasts until `goal` (formula 1) within low..high (s).

    Within a piece the nearer of two lines on the same side comes first. Where goal and end of hold lie on both sides
    of the path and it reaches both in one piece, the order is not known: counted as not reached, and in `unclear`.
    """

    compiled: CompiledFormulas
    low: float
    high: float
    runs: int
    satisfied: Mask = field(init=False)
    broken: Mask = field(init=False)
    when: Array = field(init=False)
    unclear: int = 0

    def __post_init__(self) -> None:
        self.satisfied, self.broken = np.zeros((2, self.runs), dtype=np.bool_)
        self.when = np.full(self.runs, inf)

    def watch(self, piece: Piece, who: Indices) -> WatchedLines:
        """The lines of both formulas, up to the span's end."""
        return watched_lines(self.compiled, piece) if inside(piece, 0.0, self.high) else ([], [])

    def see(self, piece: Piece, who: Indices) -> None:
        """Note where the goal is reached and where hold has ended."""
        if not inside(piece, 0.0, self.high):
            return
        n = who.size
        low, high = visited_regions(self.compiled, piece)
        start_region = region(self.compiled, piece, at_end=False)
        ends, goal = (_nearest(table(self.compiled, which, piece), start_region, n) for which in (0, 1))
        up, down = ends[0] <= high, ends[1] >= low
        late = inside(piece, self.low, self.high)
        # A goal at the first instant needs no hold there; one that is true right after it (`time > 5` at 5 s) does.
        at_begin = region_truth(table_at_begin(self.compiled, 1, piece), start_region)
        ended = (ends[0] == start_region) & ~at_begin
        rise = (goal[0] <= high) & (goal[0] <= ends[0]) & ~ended & late
        fall = (goal[1] >= low) & (goal[1] >= ends[1]) & ~ended & late
        at_once = (at_begin | (goal[0] == start_region)) & ~ended & late
        # Goal on one side, end of hold on the other, both reached: the bridge does not say which came first.
        torn = ~at_once & ((rise & down & ~fall) | (fall & up & ~rise))
        alive = ~self.satisfied[who] & ~self.broken[who]
        self.unclear += int(np.count_nonzero(torn & alive))
        success = alive & (at_once | ((rise | fall) & ~torn))
        self.satisfied[who[success]] = True
        by = np.where(at_once, piece.begin, piece.begin + piece.dt)
        self.when[who[success]] = by[success]
        self.broken[who[alive & ~success & (up | down)]] = True

    def open(self) -> Mask | None:
        """The runs in which neither has come."""
        return ~(self.satisfied | self.broken)


def _nearest(truth: Mask, own: Indices, runs: int) -> tuple[Indices, Indices]:
    """(n,) the first true region at or above the runs' own, and at or below; beyond all where there is none."""
    count = truth.shape[0]
    wide = truth if truth.ndim == 2 else np.broadcast_to(truth[:, None], (count, runs))
    # One sweep up and one down, for all runs at once; the row beyond the last region stands for "none".
    above, below = np.full((count + 1, runs), count), np.full((count + 1, runs), -1)
    for index in range(count):
        below[index] = np.where(wide[index], index, below[index - 1] if index else -1)
        back = count - 1 - index
        above[back] = np.where(wide[back], back, above[back + 1])
    columns = np.arange(runs)
    return above[own, columns], below[own, columns]


def _of_rows(column: Value, rows: Indices) -> Value:
    return column[rows] if isinstance(column, np.ndarray) else column


@dataclass(slots=True)
class ExtremeMonitor:
    """The greatest (sign 1) or least (sign -1) value of factor * temperature + rest on the way, in `best` (n,)."""

    factor: float
    rest: Expression
    sign: float
    best: Array

    def _ends(self, piece: Piece, runs: int) -> tuple[Array, Array, Value, Value]:
        """sign * expression at both ends of the piece, (n,), and the parts without temperature."""
        later = piece.begin + piece.dt, piece.age + piece.dt
        rest = value(self.rest, 0.0, piece.begin, piece.age), value(self.rest, 0.0, *later)
        first, last = self.factor * piece.start + rest[0], self.factor * piece.end + rest[1]
        return self.sign * np.broadcast_to(first, (runs,)), self.sign * np.broadcast_to(last, (runs,)), *rest

    def watch(self, piece: Piece, who: Indices) -> WatchedLines:
        """The temperatures at which the expression is just beyond the best so far, the piece's ends included."""
        first, last, before, after = self._ends(piece, who.size)
        self.best[who] = np.maximum(self.best[who], np.maximum(first, last))
        if self.factor == 0.0:
            return [], []
        # A hair beyond the best: a bridge that only meets it would be drawn for nothing.
        beyond = self.best[who] + CLOCK_TOLERANCE * (1.0 + np.abs(self.best[who]))
        line = ((self.sign * beyond - before) / self.factor, (self.sign * beyond - after) / self.factor)
        return ([line], []) if self.sign * self.factor > 0 else ([], [line])

    def see(self, piece: Piece, who: Indices) -> None:
        """Raise the best so far by what the bridges reach between the piece's ends, which `watch` has seen."""
        drawn = piece.rise if self.sign * self.factor > 0 else piece.fall
        if drawn is None:
            return
        rows, e = drawn
        first, last, *_ = self._ends(piece, who.size)
        bridge = (piece.bridge[rows] if isinstance(piece.bridge, np.ndarray) else piece.bridge) * self.factor**2
        # The bridge's maximum from its exponential number e: (top - x0) (top - x1) = V e / 2 (`paths.plan`).
        top = 0.5 * (first[rows] + last[rows] + np.sqrt((last[rows] - first[rows]) ** 2 + 2.0 * bridge * e))
        self.best[who[rows]] = np.maximum(self.best[who[rows]], top)

    def open(self) -> Mask | None:
        """All."""
        return None


@dataclass(slots=True)
class TrajectoryMonitor:
    """The values of some expressions at both ends of every piece: (begin, end, who), (values at begin, at end).

    `names` are the automaton's locations in order. A condition counts 1 where it holds and 0 elsewhere.
    """

    expressions: tuple[Expression, ...]
    names: tuple[str, ...]
    times: list[tuple[Array, Array, Indices]] = field(default_factory=list)
    values: list[tuple[Array, Array]] = field(default_factory=list)

    def watch(self, piece: Piece, who: Indices) -> WatchedLines:
        """Nothing: courses are shown at the ends of pieces."""
        return [], []

    def see(self, piece: Piece, who: Indices) -> None:
        """Keep both ends."""
        begin, stop = (
            np.broadcast_to(np.asarray(time, dtype=float), who.shape) for time in (piece.begin, piece.begin + piece.dt)
        )
        self.times.append((begin, stop, who))
        self.values.append(
            (self._piece_values(piece, begin, at_end=False), self._piece_values(piece, stop, at_end=True))
        )

    def _piece_values(self, piece: Piece, time: Array, *, at_end: bool) -> Array:
        """(expressions, n) the values at one end of the piece, conditions as 0 and 1."""
        x, age = (piece.end, piece.age + piece.dt) if at_end else (piece.start, piece.age)

        def evaluate_expression(expression: Expression) -> Value:
            if isinstance(expression, Indicator):
                holds = instant_truth(
                    expression.inner, temperature=x, time=time, age=age, location=piece.location, names=self.names
                )
                return np.asarray(holds, dtype=float)
            if isinstance(expression, Operation):
                return combine(
                    expression.op, evaluate_expression(expression.left), evaluate_expression(expression.right)
                )
            return value(expression, x, time, age)

        return np.stack([np.broadcast_to(evaluate_expression(expression), x.shape) for expression in self.expressions])

    def open(self) -> Mask | None:
        """All."""
        return None
