"""The scan's schedule and the plant's clock."""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, field

import pytest

from drivers.tag import Quality, Sample, Tag
from gateway.machine.reading.clock import PlantClock, plant_clock
from gateway.machine.reading.quality import QualityRules
from gateway.machine.reading.scan import Scan, scans
from tests.gateway.support import EPOCH, JumpClock

TAG = Tag("T", "holding:1")


@dataclass
class Slow:
    """A device whose n-th read takes `took[n]` seconds of the clock (0 beyond the list)."""

    clock: JumpClock
    took: Sequence[float] = ()
    begun: list[float] = field(default_factory=list)
    inside: int = 0

    async def open(self) -> None: ...
    async def close(self) -> None: ...

    async def read(self, tags: Sequence[Tag]) -> list[Sample]:
        assert self.inside == 0, "two reads at once"
        self.inside += 1
        self.begun.append(self.clock.now() - EPOCH)
        await asyncio.sleep(0)
        number = len(self.begun) - 1
        self.clock.time += self.took[number] if number < len(self.took) else 0.0
        self.inside -= 1
        return [Sample(tag.name, 1.0, Quality.GOOD, self.clock.now()) for tag in tags]

    @property
    def connected(self) -> bool:
        return True

    def statistics(self) -> dict[str, float]:
        return {}


async def collect(device: Slow, count: int, consume: Sequence[float] = ()) -> list[Scan]:
    stop, found = asyncio.Event(), []
    async for scan in scans(device, [TAG], device.clock, QualityRules(1.0), stop=stop):
        found.append(scan)
        device.clock.time += consume[len(found) - 1] if len(found) <= len(consume) else 0.0
        if len(found) == count:
            stop.set()
    return found


async def test_scans_lie_on_absolute_deadlines_however_long_each_takes() -> None:
    device = Slow(JumpClock(), [0.3, 0.9, 0.1])
    found = await collect(device, 4)
    assert device.begun == pytest.approx([0.0, 1.0, 2.0, 3.0])
    assert [scan.missed for scan in found] == [0, 0, 0, 0]
    assert [scan.duration for scan in found] == pytest.approx([0.3, 0.9, 0.1, 0.0])


async def test_a_missed_tick_is_skipped_and_counted_and_never_made_up_for() -> None:
    device = Slow(JumpClock(), [0.0, 2.5])
    found = await collect(device, 4)
    assert device.begun == pytest.approx([0.0, 1.0, 4.0, 5.0])
    assert [scan.missed for scan in found] == [0, 0, 2, 0]


async def test_a_slow_consumer_delays_the_next_scan_and_nothing_queues() -> None:
    device = Slow(JumpClock())
    found = await collect(device, 3, consume=[3.2])
    assert device.begun == pytest.approx([0.0, 4.0, 5.0])
    assert [scan.missed for scan in found] == [0, 3, 0]


async def test_the_stop_ends_a_long_wait_at_once() -> None:
    stop = asyncio.Event()
    clock = plant_clock()
    device = Slow(JumpClock(clock.now()))
    stream = scans(device, [TAG], clock, QualityRules(3600.0), stop=stop)
    await anext(stream)
    waiting = asyncio.ensure_future(anext(stream, None))
    await asyncio.sleep(0)
    stop.set()
    assert await asyncio.wait_for(waiting, 60.0) is None


async def test_a_restart_waits_for_the_heartbeats_proof_and_never_for_ever() -> None:
    async def first(heartbeat: Sequence[int]) -> Scan:
        clock = JumpClock()
        tags = [TAG, Tag("Beat", "holding:2")]

        class Beating(Slow):
            async def read(self, tags: Sequence[Tag]) -> list[Sample]:
                beat = heartbeat[min(len(self.begun), len(heartbeat) - 1)]
                await super().read(tags)
                now = self.clock.now()
                return [Sample("T", 1.0, Quality.GOOD, now), Sample("Beat", beat, Quality.GOOD, now)]

        stream = scans(Beating(clock), tags, clock, QualityRules(1.0, "Beat"))
        scan = await anext(stream)
        await stream.aclose()
        return scan

    living = await first([7, 8])
    assert living.samples["T"].quality is Quality.GOOD and living.time == EPOCH + 1.0
    frozen = await first([7])
    assert frozen.samples["T"].quality is Quality.UNCERTAIN and frozen.time == EPOCH + 3.0
    stopped = await first([0])
    assert stopped.samples["T"].quality is Quality.OUT_OF_SERVICE and stopped.time == EPOCH


def test_plant_time_runs_on_the_monotonic_clock_and_scales() -> None:
    moments = iter([100.0, 101.0, 101.0])
    walls = iter([5_000.0])
    clock = PlantClock(EPOCH, 100.0, 60.0, lambda: next(moments), lambda: next(walls))
    assert clock.now() == EPOCH
    assert clock.now() == EPOCH + 60.0
    assert clock.wall_offset() == pytest.approx(5_000.0 - EPOCH - 1.0)


async def test_sleeping_until_the_past_returns_and_never_wakes_early() -> None:
    clock = plant_clock(speed=1000.0, epoch=EPOCH)
    await clock.sleep_until(EPOCH - 5.0)
    await clock.sleep_until(EPOCH + 20.0)
    assert clock.now() >= EPOCH + 20.0


async def test_the_stop_ends_a_sleep_and_a_cancelled_one_is_cancelled() -> None:
    clock, stop = plant_clock(epoch=EPOCH), asyncio.Event()
    sleeping = asyncio.create_task(clock.sleep_until(EPOCH + 3600.0, stop))
    await asyncio.sleep(0)
    assert not sleeping.done()
    stop.set()
    await asyncio.wait_for(sleeping, 60.0)
    await asyncio.wait_for(clock.sleep_until(EPOCH + 3600.0, stop), 60.0)
    stop.clear()
    await clock.sleep_until(clock.now() + 0.01, stop)
    sleeping = asyncio.create_task(clock.sleep_until(EPOCH + 3600.0, stop))
    await asyncio.sleep(0)
    sleeping.cancel()
    with pytest.raises(asyncio.CancelledError):
        await sleeping


def test_a_speed_that_is_not_positive_is_refused() -> None:
    with pytest.raises(ValueError, match="positive"):
        plant_clock(0.0)
