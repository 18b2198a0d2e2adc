"""How high and how low the temperature can come in each location, under any sequence of events.

Every flow moves monotonically towards or along its target, a higher start or a higher target gives a higher end, and no
step drives two temperatures apart. So the highest temperature on entering a location follows from the highest ones of
the locations before it alone, and the lowest from the lowest: two systems of equations

    entry(q) = max over moves p -> q of exit_p(entry(p)),    exit_p monotone, of slope 1 at most

whose least solutions are the exact bounds of the flows without noise and clamps, not only safe ones: each value is
that of a run, or the limit of runs. They are found by following the moves round by round. Where the best ways close a
loop, the loop's own fixed point is put in at once (its gain shrinks with the temperature, so that bisection finds it);
a loop that still gains at FAR_DEGC grows without bound.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, isinf, nan

import numpy as np
from numpy.typing import NDArray

from sim.proof.drift import DriftBound
from sim.proof.envelope import Envelope, Range
from sim.proof.structure import Move
from sim.sha import RELAXING_FLOWS, Array, mean_step

Indices = NDArray[np.intp]

FAR_DEGC = 1e7
"""degC: a loop of stays that still gains here grows without bound."""
ROUND_GAIN, STAY_GAIN = 1e-12, 1e-15
"""What must be gained to count, as a share of 1 degC and the temperature: by a round, and by a lap for each of its
stays. Less is what floats lose. The lap's is far smaller, so that what a round still sees is settled by its loop."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Graph:
    """L envelopes and their moves; `source`, `target` (E,) and `symbol` have one entry for each pair of locations.

    They are ordered by target, and `first` is where each of the targets `reached` begins. `rate` is the maximum rate.
    """

    envelopes: tuple[Envelope, ...]
    initial: int
    rate: float
    source: Indices
    target: Indices
    symbol: tuple[str, ...]
    first: Indices
    reached: Indices


@dataclass(frozen=True, slots=True)
class Side:
    """The upper bounds (`sign` 1), or the lower ones (-1): temperatures and targets are multiplied by the sign.

    (L,) `target` is the highest one of each location, `fresh` the highest X on entry, NaN where it goes on. `drifts`
    has the bound of the drift where effects act, None elsewhere.
    """

    graph: Graph
    sign: float
    target: Array
    fresh: Array
    drifts: tuple[DriftBound | None, ...]

    def advance(self, place: int, x: float, dt: float) -> float:
        """The temperature `dt` s after an entry at `x`; `dt` may be infinite, and `x` too."""
        drift = self.drifts[place]
        if drift is not None:
            return drift.advance(x, dt, self.graph.rate)
        envelope, target = self.graph.envelopes[place], float(self.target[place])
        relaxing = envelope.flow.kind in RELAXING_FLOWS
        if dt == 0 or envelope.flow.kind == "constant" or (not relaxing and target == 0):
            return x
        # The simulator's step has no end of time: the limit is the target, or, for a drift, no bound at all. A
        # transient is over after a thousand times its tau: nothing is left of it in floats, nor of a limit on its rate.
        if isinf(dt) and envelope.flow.kind == "transient":
            dt = 1e3 * envelope.flow.params["tau"]
        if isinf(dt):
            return target if relaxing else target * inf
        return x if isinf(x) else float(mean_step(envelope.flow, x, target, age=0.0, dt=dt, max_rate=self.graph.rate))

    def leave(self, place: int, entry: float) -> float:
        """The highest temperature on leaving: the flow is monotone in time, so it is at one end of the sojourn."""
        least, most = self.graph.envelopes[place].sojourn
        return max(self.advance(place, entry, least), self.advance(place, entry, most))

    def peak(self, place: int, entry: float) -> float:
        """The highest temperature of a stay: of entering, or of the longest sojourn's end."""
        return max(entry, self.advance(place, entry, self.graph.envelopes[place].sojourn[1]))


@dataclass(frozen=True, slots=True)
class Bound:
    """(L,) the highest `entry` and `peak` of each location, times the side's sign; -inf where no move leads.

    `settled` is False where the rounds ran out; nothing is proven then. `loop` is the first loop found that grows
    without bound, as places; empty when there is none.
    """

    entry: Array
    peak: Array
    settled: bool
    loop: tuple[int, ...] = ()


def make_graph(envelopes: Sequence[Envelope], moves: Sequence[Move], initial: str, rate: float) -> Graph:
    """The graph of all moves; of several symbols between two locations the first is kept."""
    index = {envelope.location: place for place, envelope in enumerate(envelopes)}
    pairs: dict[tuple[int, int], str] = {}
    for source, symbol, target in moves:
        pairs.setdefault((index[target], index[source]), symbol)
    order = sorted(pairs)
    # Sorted by target, so that `reduceat` takes the best move into each target in one pass.
    ends = np.array(order, dtype=np.intp).reshape(-1, 2)
    reached, first = np.unique(ends[:, 0], return_index=True)
    symbols = tuple(pairs[pair] for pair in order)
    return Graph(
        envelopes=tuple(envelopes),
        initial=index[initial],
        rate=rate,
        source=ends[:, 1],
        target=ends[:, 0],
        symbol=symbols,
        first=first,
        reached=reached,
    )


def make_side(graph: Graph, *, up: bool, housing: float | None = None) -> Side:
    """The upper or the lower side of a graph; `housing` (degC) is the highest or lowest that a housing comes to."""
    sign, envelopes = (1.0 if up else -1.0), graph.envelopes
    fresh = [nan if envelope.fresh is None else sign * envelope.fresh[int(up)] for envelope in envelopes]
    drifts = [envelope.drift(up, housing) for envelope in envelopes]
    signed = tuple(drift if drift is None or up else drift.mirror() for drift in drifts)
    return Side(graph, sign, np.array([sign * envelope.target(up) for envelope in envelopes]), np.array(fresh), signed)


def best_moves(graph: Graph, leaving: Array) -> tuple[Array, Indices]:
    """(L,) the highest of `leaving` (L,) over the moves into each location, and the row of the move that has it."""
    value, row = np.full(leaving.size, -inf), np.full(leaving.size, -1, dtype=np.intp)
    if not graph.source.size:
        return value, row
    offered = leaving[graph.source]
    value[graph.reached] = np.maximum.reduceat(offered, graph.first)
    # Of equal moves the first counts: written backwards, it is the one that stays.
    hits = np.flatnonzero(offered == value[graph.target])
    row[graph.target[hits[::-1]]] = hits[::-1]
    return value, row


def climb(side: Side, start: float) -> Bound:
    """The highest temperatures, from `start` (the side's sign included) in the initial location."""
    graph = side.graph
    size = len(graph.envelopes)
    entry, leaving = np.full(size, -inf), np.full(size, -inf)
    parent = np.full(size, -1, dtype=np.intp)
    entry[graph.initial] = start
    changed: Sequence[int] = [graph.initial]
    loop: tuple[int, ...] = ()
    # Without loops a way has fewer than `size` moves, and each loop is settled by one acceleration; the rest is slack.
    for _ in range(20 * size + 100):
        for place in changed:
            leaving[place] = side.leave(place, float(entry[place]))
        offered, row = best_moves(graph, leaving)
        offered = np.where((offered > -inf) & ~np.isnan(side.fresh), side.fresh, offered)
        better = np.flatnonzero(offered > entry + ROUND_GAIN * (1.0 + np.where(entry > -inf, np.abs(entry), 0.0)))
        if not better.size:
            return Bound(entry, _peaks(side, entry), True, loop)
        entry[better] = offered[better]
        parent[better] = graph.source[row[better]]
        changed = better.tolist()
        # Round by round a loop would creep towards its fixed point for ever; put in at once, each loop costs one round.
        for circle in _circles(parent, changed):
            if _accelerate(side, circle, entry):
                changed = [*changed, *circle]
                loop = loop or (tuple(circle) if isinf(entry[circle[0]]) else ())
    return Bound(entry, _peaks(side, entry), False, loop)


def intervals(graph: Graph, upper: Bound, lower: Bound) -> dict[str, Range]:
    """Location -> lowest and highest temperature (degC), only for those that some sequence of events reaches."""
    return {
        envelope.location: (-float(lower.peak[place]), float(upper.peak[place]))
        for place, envelope in enumerate(graph.envelopes)
        if upper.entry[place] > -inf
    }


def _peaks(side: Side, entry: Array) -> Array:
    return np.array([side.peak(place, x) if x > -inf else -inf for place, x in enumerate(entry.tolist())])


def _circles(parent: Indices, changed: Sequence[int]) -> list[list[int]]:
    """The loops among the best ways that some changed location lies on, each in the direction of the moves."""
    circles: list[list[int]] = []
    state = dict[int, int]()
    # Each location has one best predecessor, so that following them from a location meets at most one loop; what an
    # earlier walk has seen need not be walked again.
    for number, begin in enumerate(changed):
        path, current = list[int](), begin
        while current >= 0 and current not in state:
            state[current] = number
            path.append(current)
            current = int(parent[current])
        if current >= 0 and state[current] == number and current in path:
            circles.append(path[path.index(current) :][::-1])
    return circles


def _accelerate(side: Side, circle: list[int], entry: Array) -> bool:
    """Puts the loop's fixed point in place of the entries along it; says whether that changed anything."""
    if not np.all(np.isnan(side.fresh[circle])):
        return False  # X is drawn anew on the way: nothing is carried round
    begin = float(entry[circle[0]])
    top = _fixed_point(side, circle, begin)
    if not top > begin:
        return False
    for place in circle:
        entry[place] = max(float(entry[place]), top)
        top = side.leave(place, top)
    return True


def _gains(side: Side, circle: Sequence[int], x: float) -> bool:
    """Whether a lap from `x` ends above it."""
    # The tolerance grows with the lap's stays, each of which rounds, but stays below what a round counts as a gain.
    end = x
    for place in circle:
        end = side.leave(place, end)
    return end > x + min(len(circle) * STAY_GAIN, 0.25 * ROUND_GAIN) * (1.0 + abs(x))


def _fixed_point(side: Side, circle: Sequence[int], begin: float) -> float:
    """The least x >= begin that a lap does not raise; inf where it still does at FAR_DEGC.

    What a lap adds never grows with x (slopes of at most 1), so that one sign change is all there is.
    """
    if isinf(begin) or not _gains(side, circle, begin):
        return begin
    low, width = begin, 1.0
    # Doubled until a lap gains nothing more: that brackets the fixed point in some 25 laps, however far it is.
    while _gains(side, circle, begin + width):
        low, width = begin + width, 2.0 * width
        if begin + width > FAR_DEGC:
            return inf
    # Bisection until the floats between the two are used up; `high` gains nothing, so the bound is on the safe side.
    high = begin + width
    for _ in range(200):
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        low, high = (middle, high) if _gains(side, circle, middle) else (low, middle)
    return high
