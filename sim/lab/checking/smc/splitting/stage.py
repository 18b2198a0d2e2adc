"""One stage of importance splitting: runs led on from where they are until they reach a level or the event."""

from dataclasses import dataclass, replace
from math import inf

import numpy as np

from sim.lab.checking.smc.monitors import CompiledFormulas, exists, inside
from sim.lab.checking.smc.paths import Engine, Indices, Piece, State, Tilts, with_extremes
from sim.sha import Array, Mask


@dataclass(slots=True)
class EntranceStates:
    """n runs to go on: state, row from which, greatest sign * temperature so far, whether the event has happened.

    `applied` is the part of the logarithm of their weight that they were chosen by already.
    """

    state: State
    row: Indices
    peak: Array
    hit: Mask
    applied: Array

    def take(self, rows: Indices) -> "EntranceStates":
        return EntranceStates(
            self.state.take(rows), self.row[rows], self.peak[rows], self.hit[rows], self.applied[rows]
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class RareEvent:
    """What all stages share: the event is the first formula of `compiled` coming true within low..high (s).

    With `sign` -1 it lies below: all levels are those of sign * temperature, ascending.
    """

    engine: Engine
    compiled: CompiledFormulas
    low: float
    high: float
    sign: float
    tilts: Tilts | None = None

    def tilt(self, tilts: Tilts) -> "RareEvent":
        """The same with mode parameters drawn by these laws."""
        return replace(self, engine=self.engine.tilt(tilts), tilts=tilts)

    def outstanding(self, entries: EntranceStates, share: float) -> Array:
        """(n,) the logarithm of what these runs are still to be weighted by up to `share` of their whole weight."""
        if self.tilts is None:
            return np.zeros(entries.row.size)
        return share * self.tilts.log_weights(entries.state.drawn) - entries.applied


def begin(event: RareEvent, runs: int, rng: np.random.Generator) -> EntranceStates:
    """Runs at the start."""
    state = event.engine.begin(runs, rng)
    none = np.zeros(runs, dtype=np.bool_)
    return EntranceStates(state, np.zeros(runs, dtype=np.intp), event.sign * state.x, none, np.zeros(runs))


def nearest_line(event: RareEvent) -> float:
    """The nearest line that the formula looks at."""
    places = [event.sign * float(line.level) for line in event.compiled.lines if line.level is not None]
    return min(places)


def resample(outstanding: Array, rows: Indices, runs: int, rng: np.random.Generator) -> Indices:
    """`runs` of these rows with replacement, in proportion to exp(outstanding).

    Stratified, so that chance adds little.
    """
    # Less the greatest, so that exp neither overflows nor makes all of them 0; shares do not change with a factor.
    chances = np.cumsum(np.exp(outstanding[rows] - outstanding[rows].max()))
    places = (np.arange(runs) + rng.random(runs)) / runs * chances[-1]
    return np.asarray(rows[np.minimum(np.searchsorted(chances, places, side="right"), rows.size - 1)])


def select_runs(event: RareEvent, ended: EntranceStates, chosen: Indices, share: float) -> EntranceStates:
    """The chosen runs, with `share` of their weight applied."""
    entries = ended.take(chosen)
    entries.applied += event.outstanding(entries, share)
    return entries


def stage(
    event: RareEvent, entries: EntranceStates, ahead: list[float], level: float, rng: np.random.Generator
) -> EntranceStates:
    """The runs led on until `level` or the event is reached, or the end; each where it stopped.

    `ahead` are the levels still to come: bridges are drawn for all of them, since a run may pass several in one piece.
    """
    # What stops is written back at its own place: the repetitions of an estimate stay apart by their places.
    out = entries.take(np.arange(entries.row.size))
    waiting = ~(out.hit | (out.peak >= level))
    live = np.empty(0, dtype=np.intp)
    state = out.state.take(live)
    last = event.engine.clock.size - 1
    # Runs wait in the order of the row at which they stopped before, and join the living when that row comes: so all
    # runs of a stage share one pass over the rows.
    order = np.flatnonzero(waiting)
    order = order[np.argsort(out.row[order], kind="stable")]
    begins = np.searchsorted(out.row[order], np.arange(last + 1))
    marks = np.array(
        [*sorted({*ahead, *(event.sign * float(line.level or 0.0) for line in event.compiled.lines)}), inf]
    )
    for row in range(last):
        new = order[begins[row] : begins[row + 1]]
        if new.size:
            state, live = state.concatenate(out.state.take(new)), np.concatenate([live, new])
        if not live.size:
            continue
        for piece in event.engine.advance(row, state, rng):
            who = live if piece.rows is None else live[piece.rows]
            _note_piece(event, piece, who, out=out, marks=marks, rng=rng)
        # A run stops at the end of the row in which it met the level, not at the meeting itself: its state there is
        # known, and where it is beyond, the next levels' bridges have been looked at already (`ahead`).
        stopped = out.hit[live] | (out.peak[live] >= level)
        if stopped.any():
            out.state.put(live[stopped], state.take(stopped))
            out.row[live[stopped]] = row + 1
            state, live = state.take(~stopped), live[~stopped]
    return out


def _note_piece(
    event: RareEvent, piece: Piece, who: Indices, *, out: EntranceStates, marks: Array, rng: np.random.Generator
) -> None:
    """Raise the runs' peaks and note the event; a bridge is looked at for the first of the `marks` above its run."""
    start, end = event.sign * piece.start, event.sign * piece.end
    top = np.maximum(start, end)
    above = event.sign * marks[np.searchsorted(marks[:-1], top, side="right")]
    up = event.sign > 0
    with_extremes(piece, [(above, above)] if up else [], [] if up else [(above, above)], rng)
    drawn = piece.rise if up else piece.fall
    if drawn is not None:
        rows, e = drawn
        bridge = piece.bridge[rows] if isinstance(piece.bridge, np.ndarray) else piece.bridge
        a, b = start[rows], end[rows]
        # The bridge's maximum from its exponential number e (`paths.plan`).
        top[rows] = 0.5 * (a + b + np.sqrt((b - a) ** 2 + 2.0 * bridge * e))
    out.peak[who] = np.maximum(out.peak[who], top)
    if inside(piece, event.low, event.high):
        met = exists(event.compiled, 0, piece)
        if met is not False:
            out.hit[who] |= met
