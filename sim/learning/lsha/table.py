"""The final observation table: access words of the locations, their extensions, and the suffixes that tell them apart.

The upper rows are prefix-closed: a shortest word to each location along observed edges, the first in the alphabet's
order. The lower rows are their one-event extensions. A cell is the location that word and suffix lead to, None where
that was not observed; its flow and distribution are the cell's content in the sense of L*_SHA.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from sim.learning.lsha.automaton import Skeleton
from sim.learning.lsha.words import Word


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


def observation_table(skeleton: Skeleton, suffixes: Sequence[Word], evident: Sequence[bool]) -> ObservationTable:
    """The table of an automaton; a location that is not `evident` (L,), without evidence, is an unobserved cell."""
    after = _successors(skeleton)
    access: dict[int, Word] = {0: ()}
    queue, extensions = [0], list[tuple[Word, int]]()
    for here in queue:
        for symbol, target in sorted(after[here].items()):
            word = (*access[here], symbol)
            if target in access:
                extensions.append((word, target))
            else:
                access[target] = word
                queue.append(target)
    columns = ((), *sorted({tuple(suffix) for suffix in suffixes if suffix}, key=lambda word: (len(word), word)))

    def row(word: Word, here: int) -> TableRow:
        ends = [_end(after, here, suffix) for suffix in columns]
        cells = tuple(skeleton.names[end] if end is not None and evident[end] else None for end in ends)
        return TableRow(word, skeleton.names[here], cells)

    return ObservationTable(
        columns,
        tuple(row(word, here) for here, word in access.items()),
        tuple(row(word, here) for word, here in extensions),
    )


def _successors(skeleton: Skeleton) -> list[dict[str, int]]:
    after: list[dict[str, int]] = [{} for _ in skeleton.names]
    for (source, symbol), (target, _) in skeleton.observed.items():
        after[source][symbol] = target
    return after


def _end(after: Sequence[dict[str, int]], here: int, word: Word) -> int | None:
    """Where a word leads from `here` along observed edges."""
    for symbol in word:
        target = after[here].get(symbol)
        if target is None:
            return None
        here = target
    return here
