"""The search for what of a table can be read: ranges, the largest block, seams; asks nothing itself (pure).

A refused block is cut in halves until the parts answer or are small, then address by address. Where a block is refused
although all its parts answer, it was too long for the device, or it crossed a seam that the device does not read
across; which of the two, a block of the same length one address further on tells.
"""

from collections.abc import Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise

Stretch = tuple[int, int]
"""First address and count."""
Search = Generator[Stretch, bool, None]
MAX_SINGLY_ASKED = 8
"""A refused block of so many addresses is asked address by address: fewer requests where nothing is there."""


@dataclass(slots=True)
class ReadableMap:
    """What is known of the stretch `first`, `count`: the state of each address, and what blocks were learned from.

    `largest` is the longest block that was answered, `too_long` the shortest known to be too long (0: none was found),
    `seams` the addresses that a block may not cross from below.
    """

    first: int
    count: int
    state: bytearray
    largest: int = 0
    too_long: int = 0
    requests: int = 0
    seams: list[int] = field(default_factory=list)

    @property
    def readable(self) -> list[Stretch]:
        """The ranges that can be read, in order."""
        return self._ranges(_READABLE)

    @property
    def refusals(self) -> list[Stretch]:
        """The ranges that the device refuses address by address."""
        return self._ranges(_REFUSED)

    @property
    def unknown(self) -> list[Stretch]:
        """The ranges that the bound on requests left unasked."""
        return self._ranges(_UNKNOWN)

    def _ranges(self, wanted: int) -> list[Stretch]:
        ranges: list[list[int]] = []
        for offset, state in enumerate(self.state):
            if state != wanted:
                continue
            if ranges and ranges[-1][0] + ranges[-1][1] == self.first + offset:
                ranges[-1][1] += 1
            else:
                ranges.append([self.first + offset, 1])
        return [(start, count) for start, count in ranges]

    def mark(self, start: int, count: int, *, readable: bool) -> None:
        """Take in an answer, or the refusal of one address."""
        offset = start - self.first
        self.state[offset : offset + count] = bytes([_READABLE if readable else _REFUSED]) * count

    def all_readable(self, start: int, count: int) -> bool:
        """True if every address of the block is known to be readable."""
        offset = start - self.first
        return self.state[offset : offset + count] == bytes([_READABLE]) * count


_UNKNOWN, _READABLE, _REFUSED = 0, 1, 2


class OutOfRequests(Exception):
    """The bound on requests is reached."""


def search(first: int, count: int, *, most: int, budget: int) -> Generator[Stretch, bool, ReadableMap]:
    """Find out what can be read of `count` addresses from `first` on, with at most `budget` requests.

    Yields the next block to ask (at most `most` addresses, the protocol's limit) and must be sent whether it was
    answered. The map is complete if `unknown` is empty.
    """
    register_map = ReadableMap(first, count, bytearray(count))
    with suppress(OutOfRequests):
        yield from _RangeSearch(register_map, most, budget).run()
    return register_map


class _RangeSearch:
    """The map as it grows, and how long a block may be as far as is known."""

    def __init__(self, register_map: ReadableMap, most: int, budget: int) -> None:
        self.map, self.limit, self.budget = register_map, most, budget

    def run(self) -> Search:
        """First whole blocks, then what was refused of them, then the largest block."""
        first, end = self.map.first, self.map.first + self.map.count
        refused: list[Stretch] = []
        for start in range(first, end, self.limit):
            block = (start, min(self.limit, end - start))
            if not (yield from self._ask(*block)):
                refused.append(block)
        for block in refused:
            yield from self._split_refusal(*block)
        yield from self._largest()

    def _ask(self, start: int, count: int) -> Generator[Stretch, bool, bool]:
        if self.map.requests >= self.budget:
            raise OutOfRequests
        self.map.requests += 1
        answered = yield start, count
        if answered:
            self.map.mark(start, count, readable=True)
            self.map.largest = max(self.map.largest, count)
        elif count == 1:
            self.map.mark(start, 1, readable=False)
        return answered

    def _split_refusal(self, start: int, count: int) -> Search:
        """Find out about a block that was refused as a whole."""
        if count == 1:
            return
        if count > self.limit:  # the limit has come down since this block was asked for
            parts = [(at, min(self.limit, start + count - at)) for at in range(start, start + count, self.limit)]
        elif count <= MAX_SINGLY_ASKED:
            parts = [(at, 1) for at in range(start, start + count)]
        else:
            parts = [(start, count // 2), (start + count // 2, count - count // 2)]
        for part in parts:
            if not (yield from self._ask(*part)):
                yield from self._split_refusal(*part)
        yield from self._explain_refusal(start, count)

    def _explain_refusal(self, start: int, count: int) -> Search:
        """Why a block was refused whose parts all answer: too long, or across a seam."""
        explained = count > self.limit or any(start < seam < start + count for seam in self.map.seams)
        if explained or not self.map.all_readable(start, count):
            return
        length = yield from self._longest_block(start, count)
        if (yield from self._is_limit(start, count, length)):
            self.map.too_long = length + 1
            self.limit = max(1, min(self.limit, length))
        else:
            self.map.seams.append(start + length)

    def _is_limit(self, start: int, count: int, length: int) -> Generator[Stretch, bool, bool]:
        """True if blocks longer than `length` are refused wherever they lie, and not just from `start` on."""
        if self.map.largest > length:
            return False
        if length == 1:
            # A single address crosses nothing, so the test is two of them. Where the block has no more than two, what
            # was seen is that it is not read across, and nothing about blocks elsewhere.
            return count > 2 and not (yield from self._ask(start + 1, 2))
        # One address further on the same length crosses a seam that lay just behind it.
        return (yield from self._ask(start + 1, length))

    def _longest_block(self, start: int, refused: int) -> Generator[Stretch, bool, int]:
        """The longest block from `start` that is answered, where `refusals` addresses are not and one is."""
        # Bisection: a block of `low` is answered and one of `high` is not, until they are neighbours.
        low, high = 1, refused
        while high - low > 1:
            middle = (low + high) // 2
            if (yield from self._ask(start, middle)):
                low = middle
            else:
                high = middle
        return low

    def _largest(self) -> Search:
        """Try a block as long as the longest range, if none that long was asked for; again if that found a seam."""
        seams = -1
        while seams != len(self.map.seams) and not self.map.too_long:
            seams = len(self.map.seams)
            ranges = [part for stretch in self.map.readable for part in _split_stretch(stretch, self.map.seams)]
            start, length = max(ranges, key=lambda stretch: stretch[1], default=(0, 0))
            wanted = min(length, self.limit)
            if wanted <= self.map.largest:
                return
            if not (yield from self._ask(start, wanted)):
                yield from self._explain_refusal(start, wanted)


def _split_stretch(stretch: Stretch, seams: Sequence[int]) -> list[Stretch]:
    """The parts of a range between the seams in it."""
    start, end = stretch[0], stretch[0] + stretch[1]
    edges = [start, *sorted(seam for seam in seams if start < seam < end), end]
    return [(left, right - left) for left, right in pairwise(edges)]
