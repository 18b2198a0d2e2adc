import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivers.driver import open_driver
from drivers.errors import DriverError, LinkDown, ReplyTimeout, WriteForbidden, WriteUnverified
from drivers.soft.driver import FAULTS, SoftDriver, open_soft
from drivers.tag import DType, Quality, Sample, Tag

SPEED = Tag("speed", "holding:0", scale=0.1, low=0, high=100)
RUNNING = Tag("running", "holding:1", DType.BOOL, bit=0)
COUNT = Tag("count", "holding:2")


class Clock:
    def __init__(self, now: float = 1000.0) -> None:
        self.now = now

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


async def opened(clock: Callable[[], float], write_map: tuple[Tag, ...] = (), **settings: Any) -> SoftDriver:
    driver = open_soft(settings, clock=clock, write_map=write_map)
    await driver.open()
    return driver


async def one(driver: SoftDriver, tag: Tag) -> Sample:
    (sample,) = await driver.read([tag])
    return sample


async def test_what_is_put_is_read_with_the_tags_type_and_range(clock: Clock) -> None:
    driver = await opened(clock, values={"speed": 50, "running": 1, "count": 3.0})
    samples = await driver.read([RUNNING, SPEED, COUNT])
    assert [(s.value, type(s.value)) for s in samples] == [(True, bool), (50.0, float), (3, int)]
    assert {s.time for s in samples} == {1000.0}
    driver.put("speed", 101)
    sample = await one(driver, SPEED)
    assert (sample.value, sample.quality) == (101.0, Quality.OUT_OF_RANGE)
    driver.put("speed", None)
    assert (await one(driver, SPEED)).quality is Quality.NO_DATA
    driver.put("speed", float("nan"))
    assert (await one(driver, SPEED)).quality is Quality.SENSOR_FAILURE
    driver.put("speed", "fast")
    assert (await one(driver, SPEED)).quality is Quality.DECODING_ERROR
    driver.put("speed", 7.0, Quality.UNCERTAIN, "by hand")
    sample = await one(driver, SPEED)
    assert (sample.value, sample.quality, sample.reason) == (7.0, Quality.UNCERTAIN, "by hand")


async def test_a_tag_that_was_never_put_waits_for_initial_data(clock: Clock) -> None:
    assert (await one(await opened(clock), SPEED)).quality is Quality.WAITING_FOR_INITIAL_DATA


@pytest.mark.parametrize("fault", [fault for fault in FAULTS if fault != "ignore-writes"])
async def test_each_fault_gives_its_quality_and_the_writes_error_and_ends(clock: Clock, fault: str) -> None:
    driver = await opened(clock, (COUNT,), values={"count": 1})
    driver.fail(fault)
    sample = await one(driver, COUNT)
    assert (sample.value, sample.quality) == (None, FAULTS[fault].quality)
    assert sample.reason
    with pytest.raises(DriverError):
        await driver.write([(COUNT, 2)])
    driver.fail(None)
    assert (await one(driver, COUNT)).value == 1


async def test_ignored_writes_are_unverified_and_change_nothing(clock: Clock) -> None:
    driver = await opened(clock, (COUNT,), values={"count": 1})
    driver.fail("ignore-writes")
    with pytest.raises(WriteUnverified):
        await driver.write([(COUNT, 2)])
    assert (await one(driver, COUNT)).value == 1


async def test_scheduled_outages_begin_and_end_by_the_clock(clock: Clock) -> None:
    driver = await opened(clock, values={"count": 1}, outages=[[10, 20, "silent"], [30, 31, "refuse"]])
    qualities = []
    for now in (1000, 1009.9, 1010, 1019.9, 1020, 1030):
        clock.now = now
        qualities.append((await one(driver, COUNT)).quality)
    good, silent, refused = Quality.GOOD, Quality.TIMEOUT, Quality.NOT_CONNECTED
    assert qualities == [good, good, silent, silent, good, refused]
    with pytest.raises(LinkDown):
        await driver.open()


async def test_a_write_is_rounded_as_a_device_would_and_all_or_nothing(clock: Clock) -> None:
    driver = await opened(clock, (SPEED, COUNT), values={"count": 1})
    await driver.write([(SPEED, 12.345), (COUNT, 9)])
    assert (await one(driver, SPEED)).value == pytest.approx(12.3)
    with pytest.raises(DriverError):
        await driver.write([(COUNT, 5), (SPEED, 101)])
    assert (await one(driver, COUNT)).value == 9
    with pytest.raises(WriteForbidden):
        await driver.write([(RUNNING, True)])
    driver.fail("silent")
    with pytest.raises(ReplyTimeout):
        await driver.write([(COUNT, 5)])


ROWS: dict[str, Any] = {
    "times": [1000.0, 1010.0, 1020.0, 1200.0],
    "columns": {"count": [1, 2, None, 4], "holding:0": [10, 20, 30, 40]},
}


async def test_the_last_row_at_or_before_the_clock_holds_until_a_gap(clock: Clock) -> None:
    driver = await opened(clock, **ROWS, max_gap=60)
    seen = {}
    for now in (999.9, 1000.0, 1009.9, 1010.0, 1020.0, 1080.0, 1080.1, 1199.9, 1200.0, 1260.0, 1260.1):
        clock.now = now
        sample = await one(driver, SPEED)
        seen[now] = sample.value if sample.quality.is_good else sample.quality
    assert seen == {
        999.9: Quality.WAITING_FOR_INITIAL_DATA,
        1000.0: 10.0,
        1009.9: 10.0,
        1010.0: 20.0,
        1020.0: 30.0,
        1080.0: 30.0,
        1080.1: Quality.NO_DATA,
        1199.9: Quality.NO_DATA,
        1200.0: 40.0,
        1260.0: 40.0,
        1260.1: Quality.NO_DATA,
    }


async def test_a_missing_cell_is_no_data_and_a_missing_column_says_which_there_are(clock: Clock) -> None:
    driver = await opened(clock, **ROWS)
    clock.now = 1025.0
    assert (await one(driver, COUNT)).quality is Quality.NO_DATA
    sample = await one(driver, RUNNING)
    assert sample.quality is Quality.CONFIGURATION_ERROR
    assert "it has count, holding:0" in sample.reason


async def test_start_and_speed_move_and_stretch_the_recording(clock: Clock) -> None:
    driver = await opened(clock, **ROWS, start=5000, speed=10)
    values = []
    for now in (5000.0, 5000.9, 5001.0, 5020.0):
        clock.now = now
        values.append((await one(driver, SPEED)).value)
    assert values == [10.0, 10.0, 20.0, 40.0]


async def test_a_loop_begins_anew_one_step_after_the_last_row(clock: Clock) -> None:
    driver = await opened(clock, times=[0, 10, 20], columns={"count": [1, 2, 3]}, loop=True, start=1000)
    values = []
    for now in (1000, 1020, 1029.9, 1030, 1045, 1000 + 30 * 10_000 + 25):
        clock.now = now
        values.append((await one(driver, COUNT)).value)
    assert values == [1, 3, 3, 1, 2, 3]


def test_a_csv_is_replayed_with_its_bools_gaps_and_dates(clock: Clock, tmp_path: Path) -> None:
    path = tmp_path / "trace.csv"
    path.write_text("time,count,running\n1970-01-01 00:16:40,1,True\n1010,,false\n\n1020,3,\n", encoding="utf-8")

    async def play() -> list[object]:
        driver = await opened(clock, csv=str(path))
        values: list[object] = []
        for clock.now in (1000, 1010, 1020):
            values += [sample.value for sample in await driver.read([COUNT, RUNNING])]
        return values

    assert asyncio.run(play()) == [1, True, None, False, 3, None]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "one column must be called 'time'"),
        ("t,a\n1,2\n", "line 1: one column must be called 'time'; it has t, a"),
        ("time,a,a\n1,2,3\n", "two columns have the same name"),
        ("time,a\n", "no rows"),
        ("time,a\n1,2\n2\n", "line 3: 1 cells for 2 columns"),
        ("time,a\nsoon,2\n", "line 2: 'soon' is neither seconds nor an ISO 8601 time"),
        ("time,a\nnan,2\n", "line 2: 'nan' is not a time"),
        ("time,a\n2,1\n1,1\n", "row 2 is at 1.0, before the row above it"),
        ('time,a\n1,"2\n', "line 2: is not CSV"),
        ('time,a\n1,"2\n3"\n2\n', "line 4: 1 cells for 2 columns"),
    ],
)
def test_a_csv_that_cannot_be_used_is_refused_with_file_line_and_reason(
    tmp_path: Path, text: str, sentence: str
) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(DriverError, match=sentence) as caught:
        open_soft({"csv": str(path)}, clock=float)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"cvs": "a"}, "cvs: there is no such key; did you mean 'csv'"),
        ({"csv": "/no/such.csv"}, r"/no/such\.csv: cannot be read: No such file"),
        ({"csv": "a", "times": [1]}, "either csv, or times and columns"),
        ({"times": [1]}, "belong together"),
        ({"times": [1, 2], "columns": {"a": [1]}}, "a has 1 values for 2 times"),
        ({"times": ["x"], "columns": {}}, "'x' is not a time"),
        ({"outages": [[1, 2, "fire"]]}, "unknown fault 'fire': known are refuse"),
        ({"outages": [[2, 1, "silent"]]}, r"is not \[from, to, fault\]"),
        ({"values": [1]}, "values: must be a table"),
    ],
)
def test_a_setting_that_cannot_be_is_refused_in_one_sentence(settings: dict[str, Any], sentence: str) -> None:
    with pytest.raises(DriverError, match=sentence):
        open_driver("soft", settings, clock=float)


def test_an_unknown_driver_is_refused_with_the_known_ones() -> None:
    with pytest.raises(DriverError, match="unknown driver 'profinet': known are can, can-log, canopen, modbus, soft"):
        open_driver("profinet", {}, clock=float)


async def test_a_stream_yields_what_is_put_in_order_and_ends_with_close(clock: Clock) -> None:
    driver = await opened(clock)
    heard: list[object] = []

    async def listen() -> None:
        async for sample in driver.stream([COUNT]):
            heard.append(sample.value)

    listening = asyncio.ensure_future(listen())
    await asyncio.sleep(0.01)
    for value in range(50):
        driver.put("count", value)
        driver.put("other", value)
    await asyncio.sleep(0.05)
    await driver.close()
    await asyncio.wait_for(listening, 20)
    assert heard == list(range(50))


async def test_a_stream_yields_every_recorded_row_at_its_own_time_however_the_clock_jumps(clock: Clock) -> None:
    driver = await opened(clock, **ROWS)
    stream = driver.stream([SPEED])
    first = asyncio.ensure_future(anext(stream))
    await asyncio.sleep(0.03)
    clock.now = 1200.0
    samples = [await first, await anext(stream), await anext(stream)]
    assert [(sample.value, sample.time) for sample in samples] == [(20.0, 1010.0), (30.0, 1020.0), (40.0, 1200.0)]
    await stream.aclose()  # type: ignore[attr-defined]


async def test_a_silent_stream_says_so_once_until_it_speaks_again(clock: Clock) -> None:
    driver = await opened(clock, silence=5.0)
    stream = driver.stream([COUNT])
    first = asyncio.ensure_future(anext(stream))
    await asyncio.sleep(0.03)
    clock.now += 6
    silent = await first
    assert (silent.value, silent.quality) == (None, Quality.TIMEOUT)
    second = asyncio.ensure_future(anext(stream))
    clock.now += 60
    await asyncio.sleep(0.06)
    assert not second.done()
    driver.put("count", 4)
    assert (await second).value == 4
    await stream.aclose()  # type: ignore[attr-defined]


async def test_a_slow_listener_loses_the_oldest_and_it_is_counted(clock: Clock) -> None:
    driver = await opened(clock)
    stream = driver.stream([COUNT])
    first = asyncio.ensure_future(anext(stream))
    await asyncio.sleep(0.03)
    for value in range(10_005):
        driver.put("count", value)
    assert (await first).value == 5
    assert driver.statistics()["dropped"] == 5
    await stream.aclose()  # type: ignore[attr-defined]
