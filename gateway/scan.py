"""The scan: one device read on absolute deadlines; a missed tick is skipped and counted, never queued."""

import asyncio
from collections.abc import AsyncGenerator, Mapping, Sequence
from dataclasses import dataclass
from math import floor

from drivers.driver import Driver
from drivers.tag import Sample, Tag
from gateway.clock import Clock
from gateway.quality import STALE_PERIODS, DeviceAge, Rules, judge


@dataclass(frozen=True, slots=True)
class Scan:
    """One reading of all tags.

    `time` is the moment when the last reply was complete (plant seconds UTC), `duration` the plant seconds from the
    first request to it, `missed` the ticks that were skipped since the scan before, `number` counts from 0.
    """

    number: int
    time: float
    samples: Mapping[str, Sample]
    missed: int
    duration: float

    def good(self, name: str) -> float | None:
        """The tag's value as a number when it is good, None otherwise: what is not good is not known."""
        sample = self.samples.get(name)
        if sample is None or not sample.quality.is_good or sample.value is None or isinstance(sample.value, str):
            return None
        return float(sample.value)


async def scans(
    driver: Driver, tags: Sequence[Tag], clock: Clock, rules: Rules, stop: asyncio.Event | None = None
) -> AsyncGenerator[Scan, None]:
    """Scan after scan until `stop` is set; the next one is never begun before it is asked for.

    Ticks lie at start + n * period. When reading or the consumer took longer than a period, the ticks that passed are
    skipped and the next scan begins on the next tick, so that one scan is in flight and nothing accumulates.
    Of a device with a heartbeat nothing is yielded until it was seen to move once, for three periods at most: a
    restart of the gateway shall not look like a doubt about the device.
    """
    begin, tick, missed, number = clock.now(), 0, 0, 0
    age = DeviceAge()
    stop = stop or asyncio.Event()
    while not await _stopped(clock, begin + tick * rules.period, stop):
        sent = clock.now()
        read = await driver.read(tags)
        now = clock.now()
        age, samples = judge(age, tags, read, now, rules)
        if number or not _unproven(age, rules, now - begin):
            yield Scan(number, now, samples, missed, now - sent)
            number += 1
        due = max(tick + 1, floor((clock.now() - begin) / rules.period) + 1)
        missed, tick = due - tick - 1, due


def _unproven(age: DeviceAge, rules: Rules, elapsed: float) -> bool:
    waiting = rules.heartbeat is not None and age.beat is not None and age.beat != 0 and age.beat_changed is None
    return waiting and elapsed < STALE_PERIODS * rules.beat_period


async def _stopped(clock: Clock, moment: float, stop: asyncio.Event) -> bool:
    """Wait for the moment or for the stop, whichever comes first; True for the stop."""
    sleeping, stopping = asyncio.ensure_future(clock.sleep_until(moment)), asyncio.ensure_future(stop.wait())
    try:
        await asyncio.wait((sleeping, stopping), return_when=asyncio.FIRST_COMPLETED)
    finally:
        sleeping.cancel()
        stopping.cancel()
    return stop.is_set()
