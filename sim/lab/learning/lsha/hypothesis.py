"""The hypothesis: merged words as an automaton, its observation table, and whether it accepts every training trace.

Locations are the rows that nothing told apart. The table's upper rows are prefix-closed: a shortest word to each
location along observed edges, the first in the alphabet's order; the lower ones are their one-event extensions. A cell
is the location that word and suffix lead to, None where that was not observed; that location's flow and distribution
are the cell's content in the sense of L*_SHA.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim.lab.learning import Indices
from sim.lab.learning.lsha.structures import Structure
from sim.lab.learning.lsha.teacher import Teacher
from sim.lab.learning.lsha.words import (
    Word,
    WordHistory,
    class_distances,
    coordinates,
    describe_shared,
    limit_history,
    switch_positions,
)
from sim.sha import UNKNOWN, Edge, Trace, alphabet_symbols


@dataclass(frozen=True, slots=True)
class HypothesisAutomaton:
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


def build_hypothesis(teacher: Teacher, structure: Structure, *, complete: bool) -> HypothesisAutomaton:
    """The automaton of a structure; with `complete` every location has an edge for every symbol."""
    classes, location = structure.classes, structure.partition.location
    place = location[classes.of_state]
    size = structure.partition.size
    members = tuple(tuple(np.flatnonzero(location == number).tolist()) for number in range(size))
    observed: dict[tuple[int, str], tuple[int, int]] = {}
    for (source, symbol), (target, count) in teacher.words.edges.items():
        start, end = int(place[source]), int(place[target])
        observed[start, symbol] = (end, observed.get((start, symbol), (end, 0))[1] + count)
    spent = np.bincount(classes.of_state[teacher.runs.place], teacher.runs.dt, len(classes))
    seconds = np.asarray(spent, dtype=float)
    # A location is represented by the class in which it spends most of its time, and called by what all of its words
    # share; equal names are numbered.
    typical = [classes.keys[max(rows, key=lambda row: (seconds[row], -row))] for rows in members]
    taken: Counter[str] = Counter()
    names = []
    for name in (describe_shared([classes.keys[row] for row in rows], teacher.alphabet) for rows in members):
        taken[name] += 1
        names.append(name if taken[name] == 1 else f"{name} #{taken[name]}")
    default = _defaults(teacher, structure, typical, observed) if complete else {}
    return HypothesisAutomaton(tuple(names), place, members, observed, default)


def _defaults(
    teacher: Teacher,
    structure: Structure,
    typical: Sequence[WordHistory],
    observed: Mapping[tuple[int, str], tuple[int, int]],
) -> dict[tuple[int, str], int]:
    """Where a symbol that was never seen in a location leads: to the class of words that it would make, or the nearest.

    `typical` (L,) is what is remembered of the words that represent each location.
    """
    classes = structure.classes
    missing = [
        (number, symbol)
        for number in range(len(typical))
        for symbol in alphabet_symbols(teacher.alphabet)
        if (number, symbol) not in observed
    ]
    table, memory = teacher.words.meaning, classes.memory
    wanted = [limit_history(table.extend_history(typical[number], symbol), memory) for number, symbol in missing]
    different = tuple(dict.fromkeys(wanted))
    away = class_distances(coordinates(different), classes.coordinates, table)
    # Where a switch stands has just been said: a class in which it stands differently comes after all others.
    said, stands = switch_positions(different, table), switch_positions(classes.keys, table)
    differs = np.array([[one != other for other in stands] for one in said], dtype=bool).reshape(away.shape)
    away[differs] += away.max(initial=0.0) + 1.0
    # Where nothing is known is no guess, and what is seen is better than what is near.
    away[:, 0] = np.inf
    seen = {key: number for number, key in enumerate(classes.keys)}
    nearest = [seen.get(key, int(np.argmin(row))) for key, row in zip(different, away, strict=True)]
    target = dict(zip(different, nearest, strict=True))
    location = structure.partition.location
    return {pair: int(location[target[key]]) for pair, key in zip(missing, wanted, strict=True)}


@dataclass(frozen=True, slots=True)
class TraceAcceptance:
    """How many training traces the observed edges accept from the initial location, and where the first one failed."""

    traces: int
    accepted: int
    events: int
    failure: str = ""


def acceptance(hypothesis: HypothesisAutomaton, traces: Sequence[Trace]) -> TraceAcceptance:
    """Every trace followed by the observed edges alone: default edges would accept anything."""
    accepted, failure = 0, ""
    for trace in traces:
        location, fine = 0, True
        for number, event in enumerate(trace.events):
            if event.symbol == UNKNOWN:
                location = 0
                continue
            target = hypothesis.observed.get((location, event.symbol))
            if target is None:
                fine, failure = False, failure or f"trace {trace.name!r}, event {number} ({event.symbol!r})"
                break
            location = target[0]
        accepted += fine
    return TraceAcceptance(len(traces), accepted, sum(len(trace.events) for trace in traces), failure)


@dataclass(frozen=True, slots=True)
class TableRow:
    """A word, the location that it leads to, and one location per suffix (None: not observed)."""

    word: Word
    location: str
    cells: tuple[str | None, ...]


@dataclass(frozen=True, slots=True)
class ObservationTable:
    """Suffixes E (the empty one first), access words S (`upper`), and S times the alphabet (`lower`)."""

    suffixes: tuple[Word, ...]
    upper: tuple[TableRow, ...]
    lower: tuple[TableRow, ...]


def observation_table(
    hypothesis: HypothesisAutomaton, suffixes: Sequence[Word], evident: Sequence[bool]
) -> ObservationTable:
    """The table of an automaton; a location that is not `evident` (L,), without evidence, is an unobserved cell."""
    after: list[dict[str, int]] = [{} for _ in hypothesis.names]
    for (source, symbol), (target, _) in hypothesis.observed.items():
        after[source][symbol] = target
    access: dict[int, Word] = {0: ()}
    queue, extensions = [0], list[tuple[Word, int]]()
    # Breadth first, and by the alphabet among equals: the first word that gets to a location is a shortest one, and
    # all its beginnings are access words too. The queue grows while it is walked.
    for location in queue:
        for symbol, target in sorted(after[location].items()):
            word = (*access[location], symbol)
            if target in access:
                extensions.append((word, target))
            else:
                access[target] = word
                queue.append(target)
    columns = ((), *sorted({tuple(suffix) for suffix in suffixes if suffix}, key=lambda word: (len(word), word)))

    def row(word: Word, location: int) -> TableRow:
        cells: list[str | None] = []
        for suffix in columns:
            end: int | None = location
            for symbol in suffix:
                end = None if end is None else after[end].get(symbol)
            cells.append(hypothesis.names[end] if end is not None and evident[end] else None)
        return TableRow(word, hypothesis.names[location], tuple(cells))

    return ObservationTable(
        columns,
        tuple(row(word, location) for location, word in access.items()),
        tuple(row(word, location) for word, location in extensions),
    )
