"""From merged words to an automaton: names, observed edges, default edges for what was never seen, and acceptance."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim.learning.lsha.ground import Ground
from sim.learning.lsha.structures import Structure
from sim.learning.lsha.words import Classes, apart, described, remembered
from sim.learning.runs import Indices
from sim.sha.automaton import Edge
from sim.sha.events import alphabet_symbols
from sim.sha.trace import UNKNOWN, Array, Trace


@dataclass(frozen=True, slots=True)
class Skeleton:
    """Locations and edges without flows. `names` (L,), the initial one first.

    `place` (S,) is the location of each state of the finest automaton, `members` (L,) the classes of words in each.
    `observed` (location, symbol) -> (target, how often it was taken), `default` (location, symbol) -> target for the
    rest of the alphabet (empty when defaults are not wanted).
    """

    names: tuple[str, ...]
    place: Indices
    members: tuple[tuple[int, ...], ...]
    observed: Mapping[tuple[int, str], tuple[int, int]]
    default: Mapping[tuple[int, str], int]

    def edges(self) -> tuple[Edge, ...]:
        """All edges in the order of locations and symbols; UNKNOWN leads to the initial location from everywhere."""
        pairs = {**{key: target for key, (target, _) in self.observed.items()}, **self.default}
        lost = {(number, UNKNOWN): 0 for number in range(len(self.names))}
        return tuple(
            Edge(self.names[source], symbol, self.names[target])
            for (source, symbol), target in sorted({**pairs, **lost}.items())
        )


def skeleton_of(ground: Ground, structure: Structure, *, complete: bool) -> Skeleton:
    """The automaton of a structure; with `complete` every location has an edge for every symbol."""
    classes, location = structure.classes, structure.partition.location
    place = location[classes.of_state]
    size = structure.partition.size
    members = tuple(tuple(np.flatnonzero(location == number).tolist()) for number in range(size))
    observed: dict[tuple[int, str], tuple[int, int]] = {}
    for (source, symbol), (target, count) in ground.words.edges.items():
        here, there = int(place[source]), int(place[target])
        observed[here, symbol] = (there, observed.get((here, symbol), (there, 0))[1] + count)
    spent = np.bincount(classes.of_state[ground.runs.place], ground.runs.dt, len(classes))
    seconds = np.asarray(spent, dtype=float)
    names = _names(ground, classes, members, seconds)
    default = (
        _defaults(ground, classes, structure=structure, members=members, seconds=seconds, observed=observed)
        if complete
        else {}
    )
    return Skeleton(names, place, members, observed, default)


def _names(ground: Ground, classes: Classes, members: Sequence[Sequence[int]], seconds: Array) -> tuple[str, ...]:
    """Each location is called by the words it spends most of its time after; equal names are numbered."""
    taken: Counter[str] = Counter()
    names = []
    for mine in members:
        name = described(classes.keys[max(mine, key=lambda each: (seconds[each], -each))], ground.alphabet)
        taken[name] += 1
        names.append(name if taken[name] == 1 else f"{name} #{taken[name]}")
    return tuple(names)


def _defaults(
    ground: Ground,
    classes: Classes,
    *,
    structure: Structure,
    members: Sequence[Sequence[int]],
    seconds: Array,
    observed: Mapping[tuple[int, str], tuple[int, int]],
) -> dict[tuple[int, str], int]:
    """Where a symbol that was never seen in a location leads: to the class of words that it would make, or the nearest.

    The location is represented by the class in which it spends most of its time.
    """
    typical = [classes.keys[max(mine, key=lambda each: (seconds[each], -each))] for mine in members]
    missing = [
        (number, symbol)
        for number in range(len(members))
        for symbol in alphabet_symbols(ground.alphabet)
        if (number, symbol) not in observed
    ]
    table, memory = ground.words.meaning, classes.memory
    wanted = [remembered(table.after(typical[number], symbol), memory) for number, symbol in missing]
    different = tuple(dict.fromkeys(wanted))
    away = apart(different, classes.keys, table)
    # Where nothing is known is no guess, and what is seen is better than what is near.
    away[:, 0] = np.inf
    seen = {key: number for number, key in enumerate(classes.keys)}
    nearest = [seen.get(key, int(np.argmin(row))) for key, row in zip(different, away, strict=True)]
    target = dict(zip(different, nearest, strict=True))
    location = structure.partition.location
    return {pair: int(location[target[key]]) for pair, key in zip(missing, wanted, strict=True)}


@dataclass(frozen=True, slots=True)
class Acceptance:
    """How many training traces the observed edges accept from the initial location, and where the first one failed."""

    traces: int
    accepted: int
    events: int
    failure: str = ""


def acceptance(skeleton: Skeleton, traces: Sequence[Trace]) -> Acceptance:
    """Every trace followed by the observed edges alone: default edges would accept anything."""
    accepted, failure = 0, ""
    for trace in traces:
        here, fine = 0, True
        for number, event in enumerate(trace.events):
            if event.symbol == UNKNOWN:
                here = 0
                continue
            target = skeleton.observed.get((here, event.symbol))
            if target is None:
                fine, failure = False, failure or f"trace {trace.name!r}, event {number} ({event.symbol!r})"
                break
            here = target[0]
        accepted += fine
    return Acceptance(len(traces), accepted, sum(len(trace.events) for trace in traces), failure)
