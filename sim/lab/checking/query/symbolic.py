"""Symbolic queries are decided exhaustively over the discrete structure: locations and edges, any sequence of events.

A path begins in the initial location and follows edges as long as there are any: it is infinite, or it ends in a
location that no edge leaves (a deadlock, where the run stays for ever). So

    E<> phi        some path reaches phi                 A[] phi        no path reaches !phi
    E[] phi        some path keeps phi for ever          A<> phi        no path keeps !phi for ever
    phi --> psi    no path, from a phi that it reaches, keeps !psi for ever

UPPAAL may also let time pass in a location without an invariant for ever, and then denies most A<> and -->. Here events
go on as long as an edge is there; write what must not last into the query. Clocks, temperature and guards are not
looked at: an edge with a guard counts as open, and the verdict says so.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import count, pairwise
from math import inf
from operator import add, eq, ge, gt, le, lt, mul, ne, sub, truediv
from types import MappingProxyType
from typing import Literal

from sim.lab.checking.query import tree as q
from sim.sha import SHA

Places = frozenset[str]


@dataclass(frozen=True, slots=True, kw_only=True)
class SymbolicVerdict:
    """Whether the query holds, and the shortest path that shows it, where one path can.

    `shows` says what the path is: a witness of what holds, a counterexample of what does not; "" where there is none
    (E<> and E[] that fail, A[], A<> and --> that hold, speak of all paths). `path` are its locations from the initial
    one, `word` the symbols of the edges between them. For E[], A<> and --> the path goes on for ever: by `loop`, the
    symbols that lead from its last location back to itself (through `loop_path`, which ends there), or, where `loop` is
    empty, by staying in a last location that no edge leaves. `explored` counts the locations looked at; `notes` say
    what the verdict leaves open.
    """

    holds: bool
    shows: Literal["witness", "counterexample", ""] = ""
    path: tuple[str, ...] = ()
    word: tuple[str, ...] = ()
    loop_path: tuple[str, ...] = ()
    loop: tuple[str, ...] = ()
    explored: int
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class _LocationGraph:
    """For each location its next locations, in the automaton's order, with the first symbol that leads there."""

    initial: str
    following: Mapping[str, Mapping[str, str]]


@dataclass(frozen=True, slots=True)
class _Lasso:
    """A path, and the way from its last location back to it; empty where it ends, or need not go on."""

    path: tuple[str, ...]
    back: tuple[str, ...] = ()


def decide(query: q.Symbolic, sha: SHA) -> SymbolicVerdict:
    """The verdict on a symbolic query; any SHA will do, also one that cannot be run or is not deterministic.

    Raises ValueError for a quantity that changes in time, and for a location that is not the automaton's.
    """
    following: dict[str, dict[str, str]] = {location.name: {} for location in sha.locations}
    for edge in sha.edges:
        following[edge.source].setdefault(edge.target, edge.symbol)
    graph = _LocationGraph(sha.initial, following)
    everywhere, inner = frozenset(following), find_places(query.inner, sha)
    reached = _search(graph, {graph.initial: 0}, lambda _: True)

    # Each kind is the search for one path: what shows E<> and E[], or denies A[], A<> and -->.
    lasso: _Lasso | None = None
    if query.kind in ("E<>", "A[]"):
        wanted = inner if query.kind == "E<>" else everywhere - inner
        nearest = next((place for place in reached if place in wanted), None)
        lasso = None if nearest is None else _Lasso(_trace_path(reached, nearest))
    elif query.kind == "-->":
        if query.then is None:
            raise ValueError("the query phi --> psi has no psi")
        keep = everywhere - find_places(query.then, sha)
        starts = {place: steps for place, (steps, _) in reached.items() if place in inner and place in keep}
        lasso = _shortest_lasso(graph, starts, keep)
        if lasso is not None:  # it begins at a phi: the way there comes before it
            lasso = _Lasso(_trace_path(reached, lasso.path[0])[:-1] + lasso.path, lasso.back)
    else:
        keep = inner if query.kind == "E[]" else everywhere - inner
        lasso = _shortest_lasso(graph, {graph.initial: 0} if graph.initial in keep else {}, keep)

    notes: tuple[str, ...] = ()
    guarded = [edge for edge in sha.edges if edge.guard and edge.source in reached]
    if guarded:
        first = f"{guarded[0].source} -{guarded[0].symbol}-> {guarded[0].target} [{guarded[0].guard}]"
        notes = (f"edges with guards count as open: {len(guarded)} of them, such as {first}",)
    # A path is the witness of an E query, which then holds, and a counterexample to any other.
    exists = query.kind.startswith("E")
    if lasso is None:
        return SymbolicVerdict(holds=not exists, explored=len(reached), notes=notes)
    return SymbolicVerdict(
        holds=exists,
        shows="witness" if exists else "counterexample",
        path=lasso.path,
        word=_symbols(graph, lasso.path),
        loop_path=lasso.back,
        loop=_symbols(graph, lasso.path[-1:] + lasso.back),
        explored=len(reached),
        notes=notes,
    )


def find_places(formula: q.Formula, sha: SHA) -> Places:
    """The locations in which a condition over locations holds. Raises ValueError as `decide`."""
    everywhere = frozenset(location.name for location in sha.locations)
    left = frozenset(edge.source for edge in sha.edges)

    def places(part: q.Formula) -> Places:
        match part:
            case q.Constant(value=value):
                return everywhere if value else frozenset()
            case q.Compare(op=op, left=first, right=second):
                return everywhere if _COMPARE[op](_value(first), _value(second)) else frozenset()
            case q.At(location=location):
                if location not in everywhere:
                    raise ValueError(f"automaton {sha.name!r} has no location {location!r}")
                return frozenset((location,))
            case q.Deadlock():
                return everywhere - left
            case q.Not(inner=inner):
                return everywhere - places(inner)
            case q.Both():
                return places(part.left) & places(part.right)
        return places(part.left) | places(part.right)

    return places(formula)


def _value(expression: q.Expression) -> float:
    match expression:
        case q.Number(value=value):
            return value
        case q.Quantity(kind=kind):
            raise ValueError(f"the {kind} changes continuously: a symbolic query cannot speak of it, ask Pr[<=T](...)")
        case q.Indicator():
            raise ValueError("a condition stands where a number is needed; only simulate takes it for 0 or 1")
    right = _value(expression.right)
    if expression.op == "/" and right == 0.0:
        raise ValueError("the query divides by zero; correct the divisor")
    return _ARITHMETIC[expression.op](_value(expression.left), right)


_Tree = dict[str, tuple[int, str | None]]
"""Reached locations in the order of their distance: (distance, the one before; None for a start)."""


def _search(graph: _LocationGraph, starts: Mapping[str, int], keep: Callable[[str], bool]) -> _Tree:
    """Shortest distances from starts that have distances of their own, over locations that `keep` accepts."""
    # Dijkstra (1959). The running number breaks ties by the order of discovery, so that equal queries show equal paths.
    tree: _Tree = {}
    number = count()
    queue: list[tuple[int, int, str, str | None]] = []
    for place, steps in starts.items():
        heappush(queue, (steps, next(number), place, None))
    while queue:
        steps, _, place, before = heappop(queue)
        if place in tree:
            continue
        tree[place] = (steps, before)
        for after in graph.following[place]:
            if after not in tree and keep(after):
                heappush(queue, (steps + 1, next(number), after, place))
    return tree


def _shortest_lasso(graph: _LocationGraph, starts: Mapping[str, int], keep: Places) -> _Lasso | None:
    """The fewest events, before and around: a path inside `keep` that goes round for ever or ends in a deadlock."""
    tree = _search(graph, starts, keep.__contains__)
    cycles = _cycles(graph, keep)
    best: tuple[float, str | None] = (inf, None)
    for place, (steps, _) in tree.items():
        if steps >= best[0]:
            break  # the tree is in the order of distance: nothing shorter comes
        around = 0 if not graph.following[place] else cycles(place, best[0] - steps)
        best = min(best, (steps + around, place), key=lambda lasso: lasso[0])
    end = best[1]
    if end is None:
        return None
    if not graph.following[end]:
        return _Lasso(_trace_path(tree, end))  # a deadlock: the path ends there
    around_it = _search(graph, {after: 1 for after in graph.following[end] if after in keep}, keep.__contains__)
    return _Lasso(_trace_path(tree, end), _trace_path(around_it, end))


def _cycles(graph: _LocationGraph, keep: Places) -> Callable[[str, float], float]:
    """(location, limit) -> the length of the shortest cycle through it inside `keep`, inf when not below the limit.

    Sets of locations are the bits of an integer, so that a location's edges cost one operation however many they are.
    """
    number = {place: bit for bit, place in enumerate(graph.following)}
    masks = [sum(1 << number[after] for after in following if after in keep) for following in graph.following.values()]

    def length(place: str, limit: float) -> float:
        start = 1 << number[place]
        seen, front, steps = 0, start, 0
        while front and steps + 1 < limit:
            steps += 1
            ahead = 0
            while front:
                lowest = front & -front  # the lowest bit that is set
                ahead |= masks[lowest.bit_length() - 1]
                front ^= lowest
            front = ahead & ~seen
            if front & start:
                return steps
            seen |= front
        return inf

    return length


def _trace_path(tree: _Tree, place: str) -> tuple[str, ...]:
    """The way to a location from the start it was reached from, both included."""
    path: list[str] = []
    step: str | None = place
    while step is not None:
        path.append(step)
        step = tree[step][1]
    return tuple(reversed(path))


def _symbols(graph: _LocationGraph, path: Iterable[str]) -> tuple[str, ...]:
    return tuple(graph.following[source][target] for source, target in pairwise(path))


_COMPARE: Mapping[str, Callable[[float, float], bool]] = MappingProxyType(
    {"<": lt, "<=": le, "==": eq, "!=": ne, ">=": ge, ">": gt}
)
_ARITHMETIC: Mapping[str, Callable[[float, float], float]] = MappingProxyType(
    {"+": add, "-": sub, "*": mul, "/": truediv}
)
