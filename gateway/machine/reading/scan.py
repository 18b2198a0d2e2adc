"""The scan: one device read on absolute deadlines; a missed tick is skipped and counted, never queued.

A device that speaks by itself is heard at once: what changes between two ticks brings a scan of its own.
"""

import asyncio
from collections.abc import AsyncGenerator, Mapping, Sequence
from dataclasses import dataclass
from math import floor
from typing import Any

from drivers.derived import Derived, with_derived
from drivers.driver import Driver, Streams
from drivers.supervision import Supervisor
from drivers.tag import Sample, Tag
from gateway.machine.reading.clock import Clock
from gateway.machine.reading.device_stream import DeviceStream, Urgent
from gateway.machine.reading.quality import STALE_PERIODS, DeviceAge, QualityRules, judge


@dataclass(frozen=True, slots=True)
class Scan:
    """One reading of all tags.

    `time` is the moment when the last reply was complete (plant seconds UTC), `duration` the plant seconds from the
    first request to it, `missed` the ticks that were skipped since the scan before, `number` counts from 0. An `early`
    scan lies between two ticks, at the time of the message that brought it.
    """

    number: int
    time: float
    samples: Mapping[str, Sample]
    missed: int
    duration: float
    early: bool = False

    def good(self, name: str) -> float | None:
        """The tag's value as a number when it is good, None otherwise: what is not good is not known."""
        sample = self.samples.get(name)
        if sample is None or not sample.quality.is_good or sample.value is None or isinstance(sample.value, str):
            return None
        return float(sample.value)


async def scans(
    driver: Driver,
    tags: Sequence[Tag],
    clock: Clock,
    rules: QualityRules,
    *,
    derived: Mapping[str, Derived] | None = None,
    stop: asyncio.Event | None = None,
    urgent: Urgent | None = None,
    supervisor: Supervisor | None = None,
) -> AsyncGenerator[Scan, None]:
    """Scan after scan until `stop` is set; the next one is never begun before it is asked for.

    Each has the tags, and the signals that are `derived` from them.

    Ticks lie at start + n * period. When reading or the consumer took longer than a period, the ticks that passed are
    skipped and the next scan begins on the next tick, so that one scan is in flight and nothing accumulates.
    Of a device with a heartbeat nothing is yielded until it was seen to move once, for three periods at most: a
    restart of the gateway shall not look like a doubt about the device.

    With `urgent`, which gives names of tags, and a driver that streams, a change of one of them brings an early scan
    between two ticks, made of what the device has told; nothing is asked for. The `supervisor` begins a
    stream that fails anew; without one it ends the scans with its reason.
    """
    begin, tick, missed, number, last = clock.now(), 0, 0, 0, 0.0
    age, stop = DeviceAge(), stop or asyncio.Event()
    stream = None
    if urgent is not None and isinstance(driver, Streams):
        stream = DeviceStream(driver, tags, urgent, supervisor)
    try:
        while (
            due := await _await_next(clock, begin + tick * rules.period, stop, stream if number else None)
        ) != "stop":
            sent = clock.now()
            if due == "news" and stream is not None:
                read, newest = stream.newest_readings()
                # The time of the message that brought it, as long as that lies between the scan before and now: the
                # device's messages may bear a clock of their own, and time must not go back for the model.
                last = max(last, min(newest, sent))
                age, samples = judge(age, tags, read, sent, rules)
                samples = with_derived(samples, derived or {}, last)
                with stream.pause():
                    yield Scan(number, last, samples, 0, 0.0, early=True)
                number += 1
                continue
            read = await driver.read(tags)
            if stream is not None:
                stream.restart(read)  # what was read holds all that was streamed up to now
            last = now = clock.now()
            age, samples = judge(age, tags, read, now, rules)
            samples = with_derived(samples, derived or {}, now)
            # Only before the first scan, and only of a program that runs (a count other than 0).
            unproven = rules.heartbeat is not None and bool(age.beat) and age.beat_changed is None
            if number or not unproven or now - begin >= STALE_PERIODS * rules.beat_period:
                yield Scan(number, now, samples, missed, now - sent)
                number += 1
            # Counted when the consumer is done, so that ticks that passed meanwhile are skipped and never caught up.
            next_tick = max(tick + 1, floor((clock.now() - begin) / rules.period) + 1)
            missed, tick = next_tick - tick - 1, next_tick
    finally:
        if stream is not None:
            await stream.close()


async def _await_next(clock: Clock, moment: float, stop: asyncio.Event, stream: DeviceStream | None) -> str:
    """Wait for the moment, the stop or something urgent; "tick", "stop" or "news", whichever comes first."""
    if stream is None:
        await clock.sleep_until(moment, stop)
        return "stop" if stop.is_set() else "tick"
    stopping = asyncio.ensure_future(stop.wait())
    tick: asyncio.Future[None] = asyncio.ensure_future(clock.sleep_until(moment))
    news = asyncio.ensure_future(stream.urgent_change())
    waits: list[asyncio.Future[Any]] = [stopping, tick, news]
    try:
        await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
        # Several may be done: the stop goes before all, the tick before the news, since it reads everything anyway.
        return "stop" if stop.is_set() else "tick" if tick.done() else "news"
    finally:
        stopping.cancel()
        tick.cancel()
        news.cancel()
