"""Facts about an automaton's graph, found exhaustively: conflicts, gaps, reachability, dead ends, accepted traces."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sim.engine import Policy, resync_targets
from sim.moments import exact_moment
from sim.sha import SHA, UNKNOWN, Event

Move = tuple[str, str, str]
"""(source, symbol, target)."""


@dataclass(frozen=True, slots=True)
class FollowedTrace:
    """How far an automaton follows one trace. All of it is accepted where `index` is None.

    Otherwise event number `index` (counted from 0), `symbol` at `time` (absolute s), has no edge out of `locations`,
    where the automaton may be by then: one location, or several when it is not deterministic.
    """

    trace: str
    events: int
    index: int | None = None
    symbol: str = ""
    time: float = 0.0
    locations: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """What happened, in words."""
        if self.index is None:
            return f"{self.trace}: all {self.events} events accepted"
        where = " or ".join(repr(name) for name in self.locations)
        return (
            f"{self.trace}: stops at event {self.index} of {self.events} ({self.symbol!r} at "
            f"{exact_moment(self.time)}), which has no edge out of {where}"
        )


def edge_symbols(sha: SHA) -> tuple[str, ...]:
    """The symbols on the edges, in the order in which they first stand there; UNKNOWN is not among them."""
    return tuple(dict.fromkeys(edge.symbol for edge in sha.edges if edge.symbol != UNKNOWN))


def guarded_edges(sha: SHA) -> list[str]:
    """One sentence for each edge with a guard."""
    return [
        f"edge {edge.source} -{edge.symbol}-> {edge.target} has the guard {edge.guard!r}"
        for edge in sha.edges
        if edge.guard
    ]


def missing(sha: SHA, symbols: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Location -> the symbols for which it has no edge; only locations that lack some.

    UNKNOWN is never missing: it leads to the initial location from everywhere, whatever the edges say.
    """
    known: dict[str, set[str]] = {location.name: set() for location in sha.locations}
    for edge in sha.edges:
        known[edge.source].add(edge.symbol)
    lacking = {name: tuple(s for s in symbols if s != UNKNOWN and s not in has) for name, has in known.items()}
    return {name: lacks for name, lacks in lacking.items() if lacks}


def moves(sha: SHA, symbols: Sequence[str], policy: Policy, *, unknown: bool = True) -> tuple[Move, ...]:
    """All that can happen at run time, each once: the edges, then UNKNOWN, and under `resync` what has no edge.

    UNKNOWN leads to the initial location (unless not `unknown`: it never comes); a symbol without an edge to where most
    edges with it lead.
    """
    edges = dict.fromkeys((e.source, e.symbol, e.target) for e in sha.edges if e.symbol != UNKNOWN)
    lost = [(location.name, UNKNOWN, sha.initial) for location in sha.locations] if unknown else []
    jumps: list[Move] = []
    if policy == "resync":
        fallback = resync_targets(sha)
        lacking = missing(sha, tuple(dict.fromkeys((*symbols, *edge_symbols(sha)))))
        jumps = [
            (name, symbol, fallback.get(symbol, sha.initial)) for name, lacks in lacking.items() for symbol in lacks
        ]
    return (*edges, *lost, *jumps)


def unreachable(sha: SHA) -> tuple[str, ...]:
    """The locations to which no sequence of edges leads from the initial one, in the automaton's order."""
    onward = _onward(sha)
    seen, waiting = {sha.initial}, [sha.initial]
    while waiting:
        fresh = onward[waiting.pop()] - seen
        seen |= fresh
        waiting += fresh
    return tuple(location.name for location in sha.locations if location.name not in seen)


def dead_ends(sha: SHA) -> tuple[str, ...]:
    """The locations that no edge leaves (sinks); one whose edges all lead back to itself is a dead end too."""
    return tuple(name for name, onward in _onward(sha).items() if not onward - {name})


def components(sha: SHA) -> tuple[tuple[str, ...], ...]:
    """The strongly connected components, largest first: sets of locations that can all reach one another."""
    names, onward = [location.name for location in sha.locations], _onward(sha)
    backward: dict[str, set[str]] = {name: set() for name in names}
    for name, targets in onward.items():
        for target in targets:
            backward[target].add(name)
    # Kosaraju and Sharir: against the arrows, from the location that was left last on.
    left = _leave_in_order(names, onward)
    group_of: dict[str, int] = {}
    for number, name in enumerate(reversed(left)):
        waiting = [name]
        while waiting:
            place = waiting.pop()
            if place not in group_of:
                group_of[place] = number
                waiting += backward[place]
    members: dict[int, list[str]] = {}
    for name in names:
        members.setdefault(group_of[name], []).append(name)
    groups = [tuple(group) for group in members.values()]
    return tuple(sorted(groups, key=lambda group: (-len(group), names.index(group[0]))))


def _leave_in_order(names: Sequence[str], onward: Mapping[str, set[str]]) -> list[str]:
    """The names in the order in which a search in depth is done with them."""
    left, seen = [], set()
    for root in names:
        waiting = [(root, iter((root,)))]
        while waiting:
            name, targets = waiting[-1]
            fresh = next((target for target in targets if target not in seen), None)
            if fresh is None:
                waiting.pop()
                if waiting:
                    left.append(name)
            else:
                seen.add(fresh)
                waiting.append((fresh, iter(onward[fresh])))
    return left


def traps(sha: SHA) -> tuple[tuple[str, ...], ...]:
    """The components that are never left once entered, where there are others besides; dead ends are not repeated."""
    groups = components(sha)
    onward = _onward(sha)
    if len(groups) < 2:
        return ()
    ends = set(dead_ends(sha))
    closed = [group for group in groups if set().union(*(onward[name] for name in group)) <= set(group)]
    return tuple(group for group in closed if not set(group) <= ends)


def accept(sha: SHA, events: Sequence[Event], trace: str = "trace") -> FollowedTrace:
    """Whether some run of the automaton follows all events: `A<> p_1.next_i == N_E` for the trace's program.

    Guards are text and taken as true. UNKNOWN leads to the initial location.
    """
    return accept_all(sha, {trace: events})[0]


def accept_all(sha: SHA, words: Mapping[str, Sequence[Event]]) -> tuple[FollowedTrace, ...]:
    """`accept` for several traces, by name."""
    onward: dict[tuple[str, str], set[str]] = {}
    for edge in sha.edges:
        onward.setdefault((edge.source, edge.symbol), set()).add(edge.target)

    def follow_events(events: Sequence[Event], trace: str) -> FollowedTrace:
        current = {sha.initial}
        for index, event in enumerate(events):
            # All locations at once (the subset construction): the automaton need not be deterministic.
            reached = {target for place in current for target in onward.get((place, event.symbol), ())}
            if event.symbol == UNKNOWN:
                reached = {sha.initial}
            if not reached:
                return FollowedTrace(
                    trace,
                    len(events),
                    index=index,
                    symbol=event.symbol,
                    time=event.time,
                    locations=tuple(sorted(current)),
                )
            current = reached
        return FollowedTrace(trace, len(events))

    return tuple(follow_events(events, name) for name, events in words.items())


def _onward(sha: SHA) -> dict[str, set[str]]:
    onward: dict[str, set[str]] = {location.name: set() for location in sha.locations}
    for edge in sha.edges:
        onward[edge.source].add(edge.target)
    return onward
