"""What every driver promises. A new driver joins by one line in BENCHES and passes as it is."""

import time
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass

import pytest

from drivers.driver import DRIVERS, Driver, Writes, open_driver
from drivers.errors import DriverError, LinkDown, WriteForbidden, WriteUnverified
from drivers.soft import SoftDriver
from drivers.tag import DType, Quality, Tag
from tests.drivers.conftest import open_anyway, read_until_good
from tests.drivers.scripted import ScriptedPlc, always

LEVEL = Tag("level", "holding:10", scale=0.1, low=0, high=100)
STATE = Tag("state", "holding:11")
FLAG = Tag("flag", "holding:12", DType.BOOL, bit=1)
SETPOINT = Tag("setpoint", "holding:20", scale=0.01, low=-50, high=50, dtype=DType.INT16)
MODE = Tag("mode", "holding:21")
TAGS = (LEVEL, STATE, FLAG)
WRITE_MAP = (SETPOINT, MODE)


@dataclass
class Bench:
    """A driver on a device that holds 12.5, 7 and True, and what a test can do to that device."""

    driver: Driver
    lose: Callable[[], Awaitable[None]]
    restore: Callable[[], Awaitable[None]]
    forget_writes: Callable[[], None]


async def modbus_bench() -> AsyncIterator[Bench]:
    plc = ScriptedPlc(registers={10: 125, 11: 7, 12: 2, 20: 0, 21: 0})
    await plc.start()
    driver = open_driver("modbus", {"host": "127.0.0.1", "port": plc.port}, clock=time.time, write_map=WRITE_MAP)

    def echo_only(request: bytes, honest: bytes) -> bytes:
        plc.registers.update({20: 0, 21: 0})
        return plc.answer(request) if request[7] == 3 else honest

    def forget() -> None:
        plc.bend = always(echo_only)

    async def lose() -> None:
        await plc.stop()

    yield Bench(driver, lose, plc.start, forget)
    await driver.close()
    await plc.stop()


async def soft_bench() -> AsyncIterator[Bench]:
    values = {"level": 12.5, "state": 7, "flag": True, "setpoint": 0, "mode": 0}
    driver = open_driver("soft", {"values": values}, clock=time.time, write_map=WRITE_MAP)
    assert isinstance(driver, SoftDriver)

    async def lose() -> None:
        driver.fail("refuse")

    async def restore() -> None:
        driver.fail(None)

    yield Bench(driver, lose, restore, lambda: driver.fail("ignore-writes"))
    await driver.close()


BENCHES: dict[str, Callable[[], AsyncIterator[Bench]]] = {"modbus": modbus_bench, "soft": soft_bench}


@pytest.fixture(params=sorted(BENCHES))
async def bench(request: pytest.FixtureRequest) -> AsyncIterator[Bench]:
    async for made in BENCHES[request.param]():
        yield made


def writing(bench: Bench) -> Writes:
    assert isinstance(bench.driver, Writes)
    return bench.driver


def test_every_driver_of_the_table_is_on_a_bench() -> None:
    assert set(BENCHES) == set(DRIVERS)


async def test_it_is_a_driver(bench: Bench) -> None:
    assert isinstance(bench.driver, Driver)


async def test_a_reading_has_one_sample_a_tag_in_the_order_asked(bench: Bench) -> None:
    await bench.driver.open()
    for tags in (TAGS, TAGS[::-1], (STATE, STATE), ()):
        samples = await bench.driver.read(tags)
        assert [sample.tag for sample in samples] == [tag.name for tag in tags]
    values = [(sample.value, sample.quality) for sample in await bench.driver.read(TAGS)]
    assert values == [(12.5, Quality.GOOD), (7, Quality.GOOD), (True, Quality.GOOD)]


async def test_a_good_sample_is_stamped_between_sending_and_the_whole_reply(bench: Bench) -> None:
    await bench.driver.open()
    before = time.time()
    for sample in await bench.driver.read(TAGS):
        assert sample.sent is not None
        assert before <= sample.sent <= sample.time <= time.time()
        assert sample.reason == ""


async def test_reading_before_open_and_after_close_gives_bad_samples_and_never_raises(bench: Bench) -> None:
    for _ in range(2):
        samples = await bench.driver.read(TAGS)
        assert {(sample.value, sample.quality) for sample in samples} == {(None, Quality.NOT_CONNECTED)}
        await open_anyway(bench.driver)
        await bench.driver.close()


async def test_close_may_be_called_twice_and_before_open(bench: Bench) -> None:
    await bench.driver.close()
    await bench.driver.open()
    await bench.driver.close()
    await bench.driver.close()
    assert not bench.driver.connected


async def test_it_can_be_opened_again(bench: Bench) -> None:
    await bench.driver.open()
    await bench.driver.close()
    await bench.driver.open()
    assert (await bench.driver.read([STATE]))[0].value == 7


async def test_open_raises_while_the_device_is_away_and_the_driver_comes_back_by_itself(bench: Bench) -> None:
    await bench.lose()
    with pytest.raises(LinkDown):
        await bench.driver.open()
    assert not bench.driver.connected
    await bench.restore()
    await read_until_good(bench.driver, STATE, within=1.0)


async def test_loss_gives_bad_samples_with_a_reason_and_return_gives_good_ones(bench: Bench) -> None:
    await bench.driver.open()
    await bench.driver.read(TAGS)
    assert bench.driver.connected
    for _ in range(2):
        await bench.lose()
        for _ in range(5):
            for sample in await bench.driver.read(TAGS):
                assert sample.value is None
                assert sample.quality.is_bad
                assert sample.reason
        assert not bench.driver.connected
        await bench.restore()
        await read_until_good(bench.driver, STATE, within=1.0)
        assert bench.driver.connected


async def test_a_write_is_read_back_as_the_device_holds_it(bench: Bench) -> None:
    await bench.driver.open()
    await writing(bench).write([(SETPOINT, -12.344), (MODE, 3)])
    setpoint, mode = await bench.driver.read([SETPOINT, MODE])
    assert setpoint.value == pytest.approx(-12.34)
    assert mode.value == 3


@pytest.mark.parametrize(
    "tag",
    [STATE, Tag("mode", "holding:11"), Tag("other", "holding:21"), Tag("mode", "holding:21", DType.INT16)],
    ids=["outside", "same name elsewhere", "same place by another name", "same place as another type"],
)
async def test_the_write_map_is_closed(bench: Bench, tag: Tag) -> None:
    await bench.driver.open()
    with pytest.raises(WriteForbidden):
        await writing(bench).write([(tag, 1)])
    with pytest.raises(WriteForbidden):
        await writing(bench).write([(MODE, 1), (tag, 1)])
    assert [sample.value for sample in await bench.driver.read([STATE, MODE])] == [7, 0]


@pytest.mark.parametrize(("tag", "value"), [(SETPOINT, 51), (SETPOINT, float("nan")), (MODE, -1), (MODE, "on")])
async def test_a_value_that_does_not_fit_writes_nothing_at_all(bench: Bench, tag: Tag, value: float) -> None:
    await bench.driver.open()
    other = (MODE, 5) if tag is SETPOINT else (SETPOINT, 5)
    with pytest.raises(DriverError):
        await writing(bench).write([other, (tag, value)])
    assert [sample.value for sample in await bench.driver.read([SETPOINT, MODE])] == [0.0, 0]


async def test_a_write_while_the_device_is_away_raises_and_is_not_made_up_for_later(bench: Bench) -> None:
    await bench.driver.open()
    await bench.driver.read(TAGS)
    await bench.lose()
    with pytest.raises(DriverError):
        await writing(bench).write([(MODE, 9)])
    await bench.restore()
    await read_until_good(bench.driver, STATE, within=1.0)
    assert (await bench.driver.read([MODE]))[0].value == 0


async def test_a_write_that_the_device_confirms_and_forgets_is_unverified(bench: Bench) -> None:
    await bench.driver.open()
    bench.forget_writes()
    with pytest.raises(WriteUnverified):
        await writing(bench).write([(MODE, 9)])
    assert (await bench.driver.read([MODE]))[0].value == 0


async def test_statistics_are_finite_counters_that_only_grow_with_use(bench: Bench) -> None:
    await bench.driver.open()
    before = dict(bench.driver.statistics())
    await bench.driver.read(TAGS)
    after = bench.driver.statistics()
    assert set(after) == set(before)
    assert after["requests"] > before["requests"]
    assert all(value >= 0 for value in after.values())
