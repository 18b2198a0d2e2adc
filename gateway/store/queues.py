"""Rows that wait for the historian's disk, each source's in a queue of its own, and what was lost of them."""

from collections import defaultdict, deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from time import monotonic
from typing import Any

from gateway.store.numbers import Source

LOSS_SECONDS = 60.0
"""How long a lost row stays a complaint; it is counted for ever."""

Row = tuple[Any, ...]
Batch = Mapping[Source, Sequence[tuple[str, Row]]]
"""(table, row) in the order of their arrival, by source."""


@dataclass(slots=True)
class LostRows:
    """The rows that a machine has lost: `dropped` had no place in the queues, `refused` were taken by no table.

    `what` says which was the last one, `at` when (monotonic s).
    """

    dropped: int = 0
    refused: int = 0
    what: str = ""
    at: float = -inf

    def note(self, what: str) -> None:
        """One more was lost."""
        self.what, self.at = what, monotonic()

    @property
    def complaint(self) -> str:
        """What was lost of late; "" if nothing was."""
        return self.what if monotonic() - self.at < LOSS_SECONDS else ""


class RowQueues:
    """At most `most` rows; beyond that the source that has most of them gives its oldest. Locked by whoever uses it."""

    def __init__(self, most: int) -> None:
        self.rows = 0
        self._most = most
        self._by_source: defaultdict[Source, deque[tuple[str, Row]]] = defaultdict(deque)

    def put(self, source: Source, table: str, rows: Iterable[Row]) -> None:
        """Append rows of a source."""
        queue = self._by_source[source]
        for row in rows:
            queue.append((table, row))
            self.rows += 1

    @property
    def full(self) -> bool:
        """Whether there are more rows than may be: `overflow` drops what is too much."""
        return self.rows > self._most

    def take(self) -> Batch:
        """All that waits; nothing does after this."""
        batch = {source: list(queue) for source, queue in self._by_source.items() if queue}
        for source in batch:
            self._by_source[source].clear()
        self.rows = 0
        return batch

    def requeue(self, batch: Batch) -> None:
        """Put what was taken before what has come since."""
        for source, rows in batch.items():
            self._by_source[source].extendleft(reversed(rows))
            self.rows += len(rows)

    def overflow(self) -> list[tuple[Source, str]]:
        """Drop what is too much; gives the source and the table of each row."""
        dropped = []
        while self.full:
            source = max(self._by_source, key=lambda one: len(self._by_source[one]))
            dropped.append((source, self._by_source[source].popleft()[0]))
            self.rows -= 1
        return dropped
