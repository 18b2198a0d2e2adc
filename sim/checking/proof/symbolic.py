"""Symbolic queries are decided exhaustively over the discrete skeleton: locations and edges, any sequence of events.

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

from sim.checking.query import tree as q
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
class _Graph:
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
    graph = _graph(sha)
    inner = satisfying(query.inner, sha)
    reached = _search(graph, {graph.initial: 0}, lambda _: True)
    notes = _notes(sha, reached.keys())
    if query.kind in ("E<>", "A[]"):
        wanted = inner if query.kind == "E<>" else frozenset(graph.following) - inner
        found = next((place for place in reached if place in wanted), None)
        lasso = None if found is None else _Lasso(_path_to(reached, found))
    else:
        lasso = _lasting(query, graph, inner, sha, reached)
    exists = query.kind.startswith("E")
    return _verdict(graph, lasso, len(reached), notes, exists)


def _lasting(query: q.Symbolic, graph: _Graph, inner: Places, sha: SHA, reached: "_Tree") -> _Lasso | None:
    """The shortest path that shows E[], or denies A<> or -->."""
    everywhere = frozenset(graph.following)
    if query.kind != "-->":
        keep = inner if query.kind == "E[]" else everywhere - inner
        return _shortest_lasso(graph, {graph.initial: 0} if graph.initial in keep else {}, keep)
    if query.then is None:
        raise ValueError("the query phi --> psi has no psi")
    keep = everywhere - satisfying(query.then, sha)
    starts = {place: steps for place, (steps, _) in reached.items() if place in inner and place in keep}
    lasso = _shortest_lasso(graph, starts, keep)
    return None if lasso is None else _Lasso(_path_to(reached, lasso.path[0])[:-1] + lasso.path, lasso.back)


def satisfying(formula: q.Formula, sha: SHA) -> Places:
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


def _graph(sha: SHA) -> _Graph:
    following: dict[str, dict[str, str]] = {location.name: {} for location in sha.locations}
    for edge in sha.edges:
        following[edge.source].setdefault(edge.target, edge.symbol)
    return _Graph(sha.initial, following)


_Tree = dict[str, tuple[int, str | None]]
"""Reached locations in the order of their distance: (distance, the one before; None for a start)."""


def _search(graph: _Graph, starts: Mapping[str, int], keep: Callable[[str], bool]) -> _Tree:
    """Shortest distances from starts that have distances of their own, over locations that `keep` accepts."""
    found: _Tree = {}
    number = count()
    queue: list[tuple[int, int, str, str | None]] = []
    for place, steps in starts.items():
        heappush(queue, (steps, next(number), place, None))
    while queue:
        steps, _, place, before = heappop(queue)
        if place in found:
            continue
        found[place] = (steps, before)
        for after in graph.following[place]:
            if after not in found and keep(after):
                heappush(queue, (steps + 1, next(number), after, place))
    return found


def _shortest_lasso(graph: _Graph, starts: Mapping[str, int], keep: Places) -> _Lasso | None:
    """The fewest events, before and around: a path inside `keep` that goes round for ever or ends in a deadlock."""
    tree = _search(graph, starts, keep.__contains__)
    cycles = _cycles(graph, keep)
    best: tuple[float, str | None] = (inf, None)
    for place, (steps, _) in tree.items():
        if steps >= best[0]:
            break  # the tree is in the order of distance: nothing shorter comes
        around = 0 if not graph.following[place] else cycles(place, best[0] - steps)
        best = min(best, (steps + around, place), key=lambda one: one[0])
    end = best[1]
    return None if end is None else _Lasso(_path_to(tree, end), _shortest_cycle(graph, end, keep))


def _cycles(graph: _Graph, keep: Places) -> Callable[[str, float], float]:
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
            front = _union(masks, front) & ~seen
            if front & start:
                return steps
            seen |= front
        return inf

    return length


def _union(masks: list[int], members: int) -> int:
    """All that the members lead to."""
    total = 0
    while members:
        lowest = members & -members
        total |= masks[lowest.bit_length() - 1]
        members ^= lowest
    return total


def _shortest_cycle(graph: _Graph, place: str, keep: Places) -> tuple[str, ...]:
    """The shortest way from a location back to itself, without its beginning; empty in a deadlock."""
    if not graph.following[place]:
        return ()
    tree = _search(graph, {after: 1 for after in graph.following[place] if after in keep}, keep.__contains__)
    return _path_to(tree, place)


def _path_to(tree: _Tree, place: str) -> tuple[str, ...]:
    """The way to a location from the start it was reached from, both included."""
    path: list[str] = []
    step: str | None = place
    while step is not None:
        path.append(step)
        step = tree[step][1]
    return tuple(reversed(path))


def _verdict(
    graph: _Graph, lasso: _Lasso | None, explored: int, notes: tuple[str, ...], exists: bool
) -> SymbolicVerdict:
    """A path is the witness of an E query, which then holds, and a counterexample to any other."""
    if lasso is None:
        return SymbolicVerdict(holds=not exists, explored=explored, notes=notes)
    return SymbolicVerdict(
        holds=exists,
        shows="witness" if exists else "counterexample",
        path=lasso.path,
        word=_symbols(graph, lasso.path),
        loop_path=lasso.back,
        loop=_symbols(graph, lasso.path[-1:] + lasso.back),
        explored=explored,
        notes=notes,
    )


def _symbols(graph: _Graph, path: Iterable[str]) -> tuple[str, ...]:
    return tuple(graph.following[here][there] for here, there in pairwise(path))


def _notes(sha: SHA, reached: Iterable[str]) -> tuple[str, ...]:
    there = frozenset(reached)
    guarded = [edge for edge in sha.edges if edge.guard and edge.source in there]
    if not guarded:
        return ()
    first = f"{guarded[0].source} -{guarded[0].symbol}-> {guarded[0].target} [{guarded[0].guard}]"
    return (f"edges with guards count as open: {len(guarded)} of them, such as {first}",)


_COMPARE: Mapping[str, Callable[[float, float], bool]] = MappingProxyType(
    {"<": lt, "<=": le, "==": eq, "!=": ne, ">=": ge, ">": gt}
)
_ARITHMETIC: Mapping[str, Callable[[float, float], float]] = MappingProxyType(
    {"+": add, "-": sub, "*": mul, "/": truediv}
)
