"""One stage of importance splitting: runs led on from where they are until they reach a level or the event."""

from dataclasses import dataclass, replace
from math import inf

import numpy as np

from sim.checking.smc.monitors.formula import Lines, exists
from sim.checking.smc.monitors.monitor import inside
from sim.checking.smc.paths.plan import Engine, Indices, Piece, State, with_extremes
from sim.checking.smc.paths.tilting import Tilts
from sim.sha.trace import Array, Mask


@dataclass(slots=True)
class Entries:
    """n runs to go on: state, row from which, greatest sign * temperature so far, whether the event has happened.

    `spent` is the part of the logarithm of their weight that they were chosen by already.
    """

    state: State
    row: Indices
    peak: Array
    hit: Mask
    spent: Array

    def take(self, rows: Indices) -> "Entries":
        return Entries(self.state.take(rows), self.row[rows], self.peak[rows], self.hit[rows], self.spent[rows])


@dataclass(frozen=True, slots=True)
class Way:
    """What all stages share: the event is `lines`' first formula coming true within low..high (s).

    With `sign` -1 it lies below: all levels are those of sign * temperature, ascending.
    """

    engine: Engine
    lines: Lines
    low: float
    high: float
    sign: float
    tilts: Tilts | None = None

    def tilted(self, tilts: Tilts) -> "Way":
        """The same with mode parameters drawn by these laws."""
        return replace(self, engine=self.engine.tilted(tilts), tilts=tilts)

    def owed(self, entries: Entries, share: float) -> Array:
        """(n,) the logarithm of what these runs are still to be weighted by up to `share` of their whole weight."""
        if self.tilts is None:
            return np.zeros(entries.row.size)
        return share * self.tilts.log_weights(entries.state.drawn) - entries.spent


def begin(way: Way, runs: int, rng: np.random.Generator) -> Entries:
    """Runs at the start."""
    state = way.engine.begin(runs, rng)
    none = np.zeros(runs, dtype=np.bool_)
    return Entries(state, np.zeros(runs, dtype=np.intp), way.sign * state.x, none, np.zeros(runs))


def goal_of(way: Way) -> float:
    """The nearest line that the formula looks at."""
    places = [way.sign * float(line.level) for line in way.lines.lines if line.level is not None]
    return min(places)


def choose(owed: Array, rows: Indices, runs: int, rng: np.random.Generator) -> Indices:
    """`runs` of these rows with replacement, in proportion to exp(owed): stratified, so that chance adds little."""
    chances = np.cumsum(np.exp(owed[rows] - owed[rows].max()))
    places = (np.arange(runs) + rng.random(runs)) / runs * chances[-1]
    return np.asarray(rows[np.minimum(np.searchsorted(chances, places, side="right"), rows.size - 1)])


def onward(way: Way, ended: Entries, chosen: Indices, share: float) -> Entries:
    """The chosen runs, with `share` of their weight spent."""
    entries = ended.take(chosen)
    entries.spent += way.owed(entries, share)
    return entries


def stage(way: Way, entries: Entries, ahead: list[float], level: float, rng: np.random.Generator) -> Entries:
    """The runs led on until `level` or the event is reached, or the end; each where it stopped.

    `ahead` are the levels still to come: bridges are drawn for all of them, since a run may pass several in one piece.
    """
    out = entries.take(np.arange(entries.row.size))
    waiting = ~(out.hit | (out.peak >= level))
    live = np.empty(0, dtype=np.intp)
    state = out.state.take(live)
    last = way.engine.clock.size - 1
    order = np.flatnonzero(waiting)
    order = order[np.argsort(out.row[order], kind="stable")]
    begins = np.searchsorted(out.row[order], np.arange(last + 1))
    marks = np.array([*sorted({*ahead, *(way.sign * float(line.level or 0.0) for line in way.lines.lines)}), inf])
    for row in range(last):
        new = order[begins[row] : begins[row + 1]]
        if new.size:
            state, live = state.joined(out.state.take(new)), np.concatenate([live, new])
        if not live.size:
            continue
        for piece in way.engine.advance(row, state, rng):
            _note(way, piece, live if piece.rows is None else live[piece.rows], out, marks, rng)
        stopped = out.hit[live] | (out.peak[live] >= level)
        if stopped.any():
            out.state.put(live[stopped], state.take(stopped))
            out.row[live[stopped]] = row + 1
            state, live = state.take(~stopped), live[~stopped]
    return out


def _note(way: Way, piece: Piece, who: Indices, out: Entries, marks: Array, rng: np.random.Generator) -> None:
    """Raise the runs' peaks and note the event; a bridge is looked at for the first of the `marks` above its run."""
    start, end = way.sign * piece.start, way.sign * piece.end
    top = np.maximum(start, end)
    above = way.sign * marks[np.searchsorted(marks[:-1], top, side="right")]
    up = way.sign > 0
    with_extremes(piece, [(above, above)] if up else [], [] if up else [(above, above)], rng)
    drawn = piece.rise if up else piece.fall
    if drawn is not None:
        rows, e = drawn
        bridge = piece.bridge[rows] if isinstance(piece.bridge, np.ndarray) else piece.bridge
        a, b = start[rows], end[rows]
        top[rows] = 0.5 * (a + b + np.sqrt((b - a) ** 2 + 2.0 * bridge * e))
    out.peak[who] = np.maximum(out.peak[who], top)
    if inside(piece, way.low, way.high):
        met = exists(way.lines, 0, piece)
        if met is not False:
            out.hit[who] |= met
