"""What a device says between two scans: looked at once if it matters, kept for the next scan if it does not."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Mapping, Sequence

import pytest

from drivers.soft.driver import SoftDriver, open_soft
from drivers.tag import Quality, Sample, Tag, Value
from gateway.machine.model.predict import Predictor
from gateway.machine.reading.clock import plant_clock
from gateway.machine.reading.quality import QualityRules
from gateway.machine.reading.scan import Scan, scans
from tests.rig.pair import TEMPERATURE, known_model

LEVEL, COUNT = Tag("level", "x", scale=0.5), Tag("count", "y")
TAGS = (LEVEL, COUNT)


async def opened(values: Mapping[str, Value]) -> tuple[SoftDriver, object]:
    clock = plant_clock()
    driver = open_soft({"values": dict(values)}, clock=clock.now)
    await driver.open()
    return driver, clock


class Watch:
    """The scans of a driver, taken as they come; `slow` is what each of them costs its taker (s)."""

    def __init__(self, driver: SoftDriver, clock: object, *, period: float, urgent: Sequence[str] | None) -> None:
        self.seen: list[Scan] = []
        self.slow = 0.0
        self._stop = asyncio.Event()
        names = None if urgent is None else (lambda: frozenset(urgent))
        self._scans = scans(driver, TAGS, clock, QualityRules(period), stop=self._stop, urgent=names)  # type: ignore[arg-type]
        self._task = asyncio.create_task(self._take())

    async def _take(self) -> None:
        async for scan in self._scans:
            self.seen.append(scan)
            await asyncio.sleep(self.slow)

    @property
    def early(self) -> list[Scan]:
        return [scan for scan in self.seen if scan.early]

    async def until(self, count: int, within: float = 120.0) -> None:
        async with asyncio.timeout(within):
            while len(self.seen) < count:
                await asyncio.sleep(0.001)

    async def end(self) -> None:
        self._stop.set()
        await asyncio.wait_for(self._task, 20.0)


@pytest.fixture
async def driver() -> AsyncIterator[tuple[SoftDriver, object]]:
    soft, clock = await opened({"level": 1.0, "count": 0})
    yield soft, clock
    await soft.close()


async def test_an_urgent_change_is_a_scan_at_once_and_not_at_the_next_tick(driver: tuple[SoftDriver, object]) -> None:
    soft, clock = driver
    watch = Watch(soft, clock, period=30.0, urgent=["level"])
    await watch.until(1)
    await asyncio.sleep(0.05)
    soft.put("level", 2.0)
    await watch.until(2)
    await watch.end()
    assert [scan.early for scan in watch.seen] == [False, True]
    assert watch.seen[1].good("level") == 2.0
    assert watch.seen[1].good("count") == 0.0
    assert watch.seen[1].time == watch.seen[1].samples["level"].time, "the time of the message that brought it"


async def test_what_is_not_urgent_waits_and_comes_along_with_what_is(driver: tuple[SoftDriver, object]) -> None:
    soft, clock = driver
    watch = Watch(soft, clock, period=30.0, urgent=["level"])
    await watch.until(1)
    soft.put("count", 5)
    await asyncio.sleep(0.1)
    assert len(watch.seen) == 1
    soft.put("level", 2.0)
    await watch.until(2)
    await watch.end()
    assert watch.seen[1].good("count") == 5.0


async def test_a_repeated_value_is_no_news_and_a_lost_quality_is(driver: tuple[SoftDriver, object]) -> None:
    soft, clock = driver
    watch = Watch(soft, clock, period=30.0, urgent=["level"])
    await watch.until(1)
    soft.put("level", 1.0)
    await asyncio.sleep(0.1)
    assert len(watch.seen) == 1
    soft.put("level", None, Quality.SENSOR_FAILURE, "broken wire")
    await watch.until(2)
    await watch.end()
    assert watch.seen[1].good("level") is None


async def test_without_urgent_tags_scans_keep_to_their_ticks(driver: tuple[SoftDriver, object]) -> None:
    soft, clock = driver
    watch = Watch(soft, clock, period=30.0, urgent=None)
    await watch.until(1)
    soft.put("level", 2.0)
    await asyncio.sleep(0.1)
    await watch.end()
    assert len(watch.seen) == 1


async def test_a_device_that_talks_all_the_time_takes_half_of_the_gateways_time_at_most(
    driver: tuple[SoftDriver, object],
) -> None:
    soft, clock = driver
    watch = Watch(soft, clock, period=30.0, urgent=["level"])
    watch.slow = 0.05
    await watch.until(1)
    loop = asyncio.get_running_loop()
    begun = loop.time()
    number = 0
    while loop.time() - begun < 0.6:
        number += 1
        soft.put("level", float(number % 50))
        await asyncio.sleep(0.002)
    early = len(watch.early)
    await watch.end()
    assert 2 <= early <= 0.6 / (2 * 0.05) + 1
    assert all(later.time >= before.time for before, later in zip(watch.seen, watch.seen[1:], strict=False))


async def test_ticks_go_on_between_early_scans(driver: tuple[SoftDriver, object]) -> None:
    soft, clock = driver
    watch = Watch(soft, clock, period=0.1, urgent=["level"])
    for number in range(60):
        soft.put("level", float(number))
        await asyncio.sleep(0.01)
    await watch.end()
    ticks = [scan for scan in watch.seen if not scan.early]
    assert len(ticks) + sum(scan.missed for scan in ticks) >= 5
    assert watch.early
    assert [scan.number for scan in watch.seen] == list(range(len(watch.seen)))


async def test_a_stream_that_fails_ends_the_scans_with_its_reason() -> None:
    class Broken(SoftDriver):
        async def stream(self, tags: Sequence[Tag]) -> AsyncIterator[Sample]:
            raise RuntimeError("the stream has failed")
            yield

    soft, clock = await opened({"level": 1.0, "count": 0})
    soft.__class__ = Broken
    watch = Watch(soft, clock, period=0.02, urgent=["level"])
    await asyncio.sleep(0.1)
    with pytest.raises(RuntimeError, match="the stream has failed"):
        await watch.end()
    with contextlib.suppress(Exception):
        await soft.close()


def scan(number: int, time: float, *, value: float, read: float, early: bool) -> Scan:
    signals = {"MarciaDecanter": 1.0, "Assorbimento": 150.0}
    samples = {name: Sample(name, held, Quality.GOOD, read) for name, held in signals.items()}
    return Scan(number, time, samples | {TEMPERATURE: Sample(TEMPERATURE, value, Quality.GOOD, read)}, 0, 0.0, early)


def test_the_model_counts_a_reading_once_however_often_other_news_comes_with_it() -> None:
    predictor = Predictor(known_model(), TEMPERATURE)
    first = predictor.step(scan(0, 10.0, value=40.0, read=10.0, early=False))
    again = predictor.step(scan(1, 10.1, value=40.0, read=10.0, early=True))
    fresh = predictor.step(scan(2, 10.2, value=40.1, read=10.2, early=True))
    tick = predictor.step(scan(3, 11.0, value=40.1, read=10.2, early=False))
    assert [step.measured for step in (first, again, fresh, tick)] == [40.0, None, 40.1, 40.1]
