"""Samples pushed as frames arrive: one bounded queue for each listener, and a sample of bad quality for silence."""

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Callable, Collection, Sequence
from contextlib import suppress

from drivers.can.reception import Slot
from drivers.tag import Quality, Sample

_MAX_QUEUED_SAMPLES = 10_000
_POLL_S = 0.05


class Stream:
    """One listener: the positions of its tags by the layout in which they come.

    `now` makes the sample of the tag at a position, as `read` would; `drain` has all heard that has come. A listener
    that is behind by more than the queue loses its oldest samples, which `dropped` counts.
    """

    def __init__(
        self, slots: Sequence[Slot | None], now: Callable[[int], Sample], catch_up: Callable[[], None]
    ) -> None:
        self.dropped = 0
        self._slots = slots
        self._now = now
        self._catch_up = catch_up
        self._positions: dict[int, list[int]] = {}
        for position, slot in enumerate(slots):
            if slot is not None:
                self._positions.setdefault(id(slot), []).append(position)
        self._queue: deque[Sample] = deque()
        self._wake = asyncio.Event()
        self._last_quality: dict[int, Quality] = {}
        self._ended = False

    def hear(self, fresh: Collection[Slot]) -> None:
        """Layouts that a frame has just brought up to date."""
        for slot in fresh:
            for position in self._positions.get(id(slot), ()):
                self._put(position, self._now(position))

    def end(self) -> None:
        """No more samples."""
        self._ended = True
        self._wake.set()

    async def samples(self) -> AsyncIterator[Sample]:
        """Samples as they arrive, until `end`; a tag that is silent or out of reach tells so once for each reason."""
        clock, next_look = asyncio.get_running_loop().time, 0.0
        while not self._ended:
            if clock() >= next_look:
                self._look()
                next_look = clock() + _POLL_S
            self._catch_up()
            while self._queue:
                yield self._queue.popleft()
            self._wake.clear()
            with suppress(TimeoutError):
                async with asyncio.timeout(_POLL_S):
                    await self._wake.wait()

    def _look(self) -> None:
        for position in range(len(self._slots)):
            sample = self._now(position)
            # What arrives is told as it comes; this look is for what no frame tells, silence above all.
            if sample.value is None and self._last_quality.get(position) is not sample.quality:
                self._put(position, sample)

    def _put(self, position: int, sample: Sample) -> None:
        if len(self._queue) >= _MAX_QUEUED_SAMPLES:
            self._queue.popleft()
            self.dropped += 1
        self._queue.append(sample)
        self._last_quality[position] = sample.quality
        self._wake.set()
