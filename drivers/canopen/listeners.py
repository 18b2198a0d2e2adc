"""One reader of the driver's stream: what has come for it, and what has gone bad since it last looked."""

import asyncio
from collections import deque
from collections.abc import Sequence
from contextlib import suppress

from drivers.tag import Quality, Sample, Tag

POLL_S = 0.05
"""Seconds after which a reader looks for what has gone bad by silence alone."""
MAX_WAITING_SAMPLES = 10_000
"""Samples kept for a reader that is behind; then the oldest are dropped."""


class PdoListener:
    """The samples of one stream that its reader has not taken yet, in the order in which they came."""

    def __init__(self, tags: Sequence[Tag]) -> None:
        self.tags = tuple(tags)
        self.wake = asyncio.Event()
        self.dropped = 0
        self._waiting: deque[Sample] = deque()
        self._quality: dict[str, Quality] = {}

    def hear(self, sample: Sample) -> None:
        """A sample of one of the tags has come."""
        if len(self._waiting) >= MAX_WAITING_SAMPLES:
            self._waiting.popleft()
            self.dropped += 1
        self._quality[sample.tag] = sample.quality
        self._waiting.append(sample)
        self.wake.set()

    def look(self, sample: Sample | None) -> None:
        """What is known of a tag now: worth telling if it has gone bad since it was last told of."""
        if sample is None or not sample.quality.is_bad or self._quality.get(sample.tag) is sample.quality:
            return
        self.hear(sample)

    def take(self) -> list[Sample]:
        """What has come, once."""
        samples = list(self._waiting)
        self._waiting.clear()
        return samples

    async def wait(self) -> None:
        """Until something has come, or it is time to look."""
        with suppress(TimeoutError):
            async with asyncio.timeout(POLL_S):
                await self.wake.wait()
        self.wake.clear()
