"""Runs come in chunks of fixed sizes, one after another; threads that are handed in make large ones side by side.

A chunk depends on its number alone: what is seen depends neither on how many threads there are nor on which is first.
"""

from collections import deque
from collections.abc import Callable, Iterator
from functools import partial
from itertools import count
from math import inf
from typing import Protocol, TypeVar

T = TypeVar("T")
Made = TypeVar("Made", covariant=True)

SMALLEST, LARGEST = 64, 32768
"""Runs of the first chunk, and of the large ones: each is twice the one before it. A chunk's rows fit the cache."""

SIDE_BY_SIDE = 4096
"""Runs of a chunk from which threads help: on shorter columns numpy lets go of the interpreter for too short a time."""


class Pending(Protocol[Made]):
    """What a thread is making."""

    def result(self) -> Made:
        """What it has made, once it is there. Raises what the making raised."""
        ...


class Threads(Protocol):
    """Threads for large chunks; whoever hands them in begins and ends them (`sim.lab.workers.threads`)."""

    @property
    def count(self) -> int:
        """How many there are."""
        ...

    def wanted(self) -> bool:
        """Whether anybody still waits for what is being made."""
        ...

    def submit(self, make: Callable[[int], T], number: int) -> Pending[T]:
        """Have `make(number)` made."""
        ...


def chunk_size(number: int) -> int:
    """Runs of chunk `number`, from 0."""
    return min(SMALLEST << min(number, 20), LARGEST)  # beyond 20 the shift would only make a large number


def in_order(make: Callable[[int], T], threads: Threads | None, runs: float = inf) -> Iterator[T]:
    """`make(0)`, `make(1)` and so on, without end; threads begin no chunk ahead that lies beyond the first `runs` runs.

    Raises what `make` raises, for the chunk whose turn it is.
    """
    begun: deque[Callable[[], T]] = deque()
    following, first = 0, 0  # the chunk that is begun next, and its first run
    for number in count():
        helpers = threads if chunk_size(number) >= SIDE_BY_SIDE else None
        # One more than there are threads: none is idle while the caller looks at a chunk.
        ahead = 1 if helpers is None else helpers.count + 1
        while following <= number or (following < number + ahead and first < runs):
            mine = partial(make, following)
            begun.append(mine if helpers is None else helpers.submit(make, following).result)
            first += chunk_size(following)
            following += 1
        yield begun.popleft()()
