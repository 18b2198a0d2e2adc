"""Does every event have an edge: a walk through the automaton's structure that names what has none, and goes on."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sim.engine import Policy, resync_targets
from sim.moments import exact_moment
from sim.sha import SHA, UNKNOWN, Event, transitions

MAX_LISTED_EVENTS = 50
"""So many events without an edge are kept one by one; the rest are only counted."""
Places = frozenset[str]


@dataclass(frozen=True, slots=True)
class Missing:
    """An event (its index and absolute time) that has no edge in `location`."""

    index: int
    time: float
    location: str
    symbol: str

    def __str__(self) -> str:
        when = exact_moment(self.time)
        return f"event {self.index} ({self.symbol!r} at {when}) has no edge in location {self.location!r}"


@dataclass(frozen=True, slots=True)
class Compatibility:
    """What became of the events of a trace. `pairs` counts the missing edges by (location, symbol)."""

    events: int
    missing: int
    named: tuple[Missing, ...]
    pairs: Mapping[tuple[str, str], int]

    @property
    def accepts_all(self) -> bool:
        """Whether every event has an edge."""
        return self.missing == 0

    @property
    def sentence(self) -> str:
        """About the first event without an edge, and how many more there are; empty when all have one."""
        if self.accepts_all:
            return ""
        more = f", and {self.missing - 1} more of the {self.events} events have none" if self.missing > 1 else ""
        return f"{self.named[0]}{more}"


def compatibility(sha: SHA, events: Sequence[Event], policy: Policy = "ignore") -> Compatibility:
    """Walk the events from the initial location; UNKNOWN leads back to it, as everywhere.

    After an event without an edge the walk goes on as the policy says (`reject` as `ignore`), so that all of them are
    found. Where several edges share a symbol the automaton is in several locations at once, and an event has an edge
    when one of them has; guards are taken as true.
    """
    # Not `transitions`, which refuses several targets for one symbol: here they are walked side by side.
    moves: dict[tuple[str, str], list[str]] = {}
    for edge in sha.edges:
        moves.setdefault((edge.source, edge.symbol), []).append(edge.target)
    fallback, start = resync_targets(sha), frozenset({sha.initial})
    # Few sets of locations come up however long the trace is, so each step is worked out once.
    seen: dict[tuple[Places, str], Places] = {}
    current, missing, named, pairs = start, 0, list[Missing](), Counter[tuple[str, str]]()
    for index, event in enumerate(events):
        if event.symbol == UNKNOWN:
            current = start
            continue
        step = (current, event.symbol)
        if step not in seen:
            targets = (moves.get((place, event.symbol), ()) for place in current)
            seen[step] = frozenset(target for ends in targets for target in ends)
        if seen[step]:
            current = seen[step]
            continue
        place = " or ".join(sorted(current))
        missing += 1
        pairs[place, event.symbol] += 1
        if len(named) < MAX_LISTED_EVENTS:
            named.append(Missing(index, event.time, place, event.symbol))
        if policy == "resync":
            current = frozenset({fallback.get(event.symbol, sha.initial)})
    return Compatibility(len(events), missing, tuple(named), dict(pairs))


def dense_events(sha: SHA, full: Sequence[Event], filtered: Sequence[Event], policy: Policy) -> list[Event]:
    """The events of the full encoding without those repeats that the automaton has no edge for.

    The full encoding repeats the present symbol in every row in which nothing happens. A model learned from changes
    alone may have no edge for a repeat: then the row changes nothing. A repeat that has an edge is taken, and an event
    of the filtered encoding is always kept, whether it has an edge or not. Raises ValueError for an automaton that is
    not deterministic.
    """
    moves, fallback = transitions(sha), resync_targets(sha)
    location, place, kept = sha.initial, 0, []
    for event in full:
        real = place < len(filtered) and event == filtered[place]
        place += real
        target = sha.initial if event.symbol == UNKNOWN else moves.get((location, event.symbol))
        if target is None and not real:
            continue
        kept.append(event)
        if target is None and policy == "resync":
            target = fallback.get(event.symbol, sha.initial)
        location = target or location
    return kept


def edge_symbols(sha: SHA) -> tuple[str, ...]:
    """The symbols that stand at edges, in the order of their first."""
    return tuple(dict.fromkeys(edge.symbol for edge in sha.edges))
