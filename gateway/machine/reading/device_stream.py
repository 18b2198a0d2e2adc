"""What a device says by itself between two scans: kept by tag, and told at once where it matters."""

import asyncio
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager

from drivers.driver import Streams
from drivers.supervision import Supervisor
from drivers.tag import Sample, Tag

Urgent = Callable[[], Collection[str]]


class DeviceStream:
    """One reader of a driver's stream, from its making (in a running loop) until `close`.

    `urgent_change` returns when an urgent tag has another value or quality than when it was last looked at, but no
    sooner than the last early scan has taken: a device that talks all the time shall take half of the gateway's time
    at most.
    """

    def __init__(self, driver: Streams, tags: Sequence[Tag], urgent: Urgent, supervisor: Supervisor | None) -> None:
        self._driver, self._tags, self._urgent = driver, tags, urgent
        self._latest: dict[str, Sample] = {}
        self._seen: dict[str, Sample] = {}
        self._changed = asyncio.Event()
        self._not_before = 0.0
        name = "news of the device"
        self._task = (
            supervisor.task(name, self._listen) if supervisor else asyncio.create_task(self._listen(), name=name)
        )

    async def close(self) -> None:
        """Stop listening. Raises what the stream raised, if it did and no supervisor has begun it anew."""
        self._task.cancel()
        (result,) = await asyncio.gather(self._task, return_exceptions=True)
        if isinstance(result, Exception):
            raise result

    async def urgent_change(self) -> None:
        """Return when something urgent has changed and it is time to look at it."""
        await self._changed.wait()
        await asyncio.sleep(max(0.0, self._not_before - asyncio.get_running_loop().time()))

    def restart(self, read: Sequence[Sample]) -> None:
        """A scan has read all tags: this is what is known now."""
        self._seen = {sample.tag: sample for sample in read}
        self._latest.clear()
        self._changed.clear()

    def newest_readings(self) -> tuple[list[Sample], float]:
        """All tags as they are known now, in their order, and the time of the newest of what has been told since."""
        newest = max((sample.time for sample in self._latest.values()), default=0.0)
        self._seen |= self._latest
        self._latest.clear()
        self._changed.clear()
        return [self._seen[tag.name] for tag in self._tags], newest

    @contextmanager
    def pause(self) -> Iterator[None]:
        """Nothing is ripe for as long as the body takes, counted from its end."""
        loop = asyncio.get_running_loop()
        begun = loop.time()
        yield
        # now + (now - begun): as long again as the body took, so that it takes half of the time at most.
        self._not_before = 2.0 * loop.time() - begun

    async def _listen(self) -> None:
        async for sample in self._driver.stream(self._tags):
            self._latest[sample.tag] = sample
            before = self._seen.get(sample.tag)
            same = before is not None and (before.value, before.quality) == (sample.value, sample.quality)
            if before is not None and not same and sample.tag in self._urgent():
                self._changed.set()
