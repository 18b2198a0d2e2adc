"""What every driver promises. A new driver joins by one line in BENCHES and passes as it is."""

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import replace

import pytest

from drivers.driver import DRIVERS, Driver, Streams, Writes
from drivers.errors import DriverError, LinkDown, WriteForbidden, WriteUnverified
from drivers.tag import DType, Quality, Tag
from tests.drivers.bench_can import can_bench
from tests.drivers.bench_canopen import canopen_bench
from tests.drivers.bench_modbus import modbus_bench, rtu_bench, rtu_tcp_bench, shared_bench, tls_bench
from tests.drivers.bench_soft import soft_bench
from tests.drivers.benches import Bench, Tags
from tests.drivers.conftest import read_until_good

BENCHES: dict[str, Callable[[], AsyncIterator[Bench]]] = {
    "can": can_bench,
    "canopen": canopen_bench,
    "modbus": modbus_bench,
    "modbus over a shared connection": shared_bench,
    "modbus over TLS": tls_bench,
    "modbus over RTU": rtu_bench,
    "modbus over RTU and TCP": rtu_tcp_bench,
    "soft": soft_bench,
}
"""The driver's name, and after a blank which of its links: "modbus over TLS"."""
RECORDED = {"can-log"}
"""What plays a recording has no device to lose or to write to: tests/drivers/test_can_log.py."""


@pytest.fixture(params=sorted(BENCHES))
async def bench(request: pytest.FixtureRequest) -> AsyncIterator[Bench]:
    async for made in BENCHES[request.param]():
        yield made


def writing(bench: Bench) -> Writes:
    if not isinstance(bench.driver, Writes):  # that its row says so, too, test_its_row_says_what_it_is holds
        pytest.skip("this driver does not write")
    return bench.driver


def test_every_driver_of_the_table_is_on_a_bench() -> None:
    assert {name.partition(" ")[0] for name in BENCHES} == set(DRIVERS) - RECORDED


async def test_it_is_a_driver(bench: Bench) -> None:
    assert isinstance(bench.driver, Driver)


async def test_its_row_says_what_it_is(bench: Bench, request: pytest.FixtureRequest) -> None:
    row = DRIVERS[request.node.callspec.params["bench"].partition(" ")[0]]
    assert row.writes == isinstance(bench.driver, Writes)
    assert row.speaks == (bench.period is not None) and (isinstance(bench.driver, Streams) or not row.speaks)


async def test_a_reading_has_one_sample_a_tag_in_the_order_asked(bench: Bench) -> None:
    await bench.open()
    tags = bench.tags.read
    for asked in (tags, tags[::-1], (bench.tags.state, bench.tags.state), ()):
        samples = await bench.driver.read(asked)
        assert [sample.tag for sample in samples] == [tag.name for tag in asked]
    values = [(sample.value, sample.quality) for sample in await bench.driver.read(bench.tags.read)]
    assert values == [(12.5, Quality.GOOD), (7, Quality.GOOD), (True, Quality.GOOD)]


async def test_a_good_sample_is_stamped_between_sending_and_the_whole_reply(bench: Bench) -> None:
    await bench.open()
    before = time.time()
    for sample in await bench.driver.read(bench.tags.read):
        assert sample.reason == ""
        if bench.period is None:
            assert sample.sent is not None
            assert before <= sample.sent <= sample.time <= time.time()
        else:
            assert sample.sent is None
            assert before - 3 * bench.period <= sample.time <= time.time()


async def test_reading_before_open_and_after_close_gives_bad_samples_and_never_raises(bench: Bench) -> None:
    for _ in range(2):
        samples = await bench.driver.read(bench.tags.read)
        assert {(sample.value, sample.quality) for sample in samples} == {(None, Quality.NOT_CONNECTED)}
        await bench.open_anyway()
        await bench.driver.close()


async def test_close_may_be_called_twice_and_before_open(bench: Bench) -> None:
    await bench.driver.close()
    await bench.open()
    await bench.driver.close()
    await bench.driver.close()
    assert not bench.driver.connected


async def test_it_can_be_opened_again(bench: Bench) -> None:
    await bench.open()
    await bench.driver.close()
    await bench.open()
    assert (await bench.driver.read([bench.tags.state]))[0].value == 7


async def test_open_raises_while_the_device_is_away_and_the_driver_comes_back_by_itself(bench: Bench) -> None:
    await bench.lose()
    with pytest.raises(LinkDown):
        await bench.driver.open()
    assert not bench.driver.connected
    await bench.restore()
    await read_until_good(bench.driver, bench.tags.state)


async def test_loss_gives_bad_samples_with_a_reason_and_return_gives_good_ones(bench: Bench) -> None:
    await bench.open()
    await bench.driver.read(bench.tags.read)
    assert bench.driver.connected
    for _ in range(2):
        await bench.lose()
        for _ in range(5):
            for sample in await bench.driver.read(bench.tags.read):
                assert sample.value is None
                assert sample.quality.is_bad
                assert sample.reason
        assert not bench.driver.connected
        await bench.restore()
        await read_until_good(bench.driver, bench.tags.state)
        assert bench.driver.connected


async def test_a_write_is_read_back_as_the_device_holds_it(bench: Bench) -> None:
    await bench.open()
    await writing(bench).write([(bench.tags.setpoint, -12.344), (bench.tags.mode, 3)])
    setpoint, mode = await bench.driver.read([bench.tags.setpoint, bench.tags.mode])
    assert setpoint.value == pytest.approx(-12.34)
    assert mode.value == 3


@pytest.mark.parametrize(
    "strange",
    [
        lambda tags: tags.state,
        lambda tags: replace(tags.mode, address=tags.state.address),
        lambda tags: replace(tags.mode, name="other"),
        lambda tags: replace(tags.mode, dtype=DType.INT16),
    ],
    ids=["outside", "same name elsewhere", "same place by another name", "same place as another type"],
)
async def test_the_write_map_is_closed(bench: Bench, strange: Callable[[Tags], Tag]) -> None:
    await bench.open()
    mode, tag = bench.tags.mode, strange(bench.tags)
    with pytest.raises(WriteForbidden):
        await writing(bench).write([(tag, 1)])
    with pytest.raises(WriteForbidden):
        await writing(bench).write([(mode, 1), (tag, 1)])
    assert [sample.value for sample in await bench.driver.read([bench.tags.state, mode])] == [7, 0]


@pytest.mark.parametrize(
    ("name", "value"), [("setpoint", 51), ("setpoint", float("nan")), ("mode", -1), ("mode", "on")]
)
async def test_a_value_that_does_not_fit_writes_nothing_at_all(bench: Bench, name: str, value: float) -> None:
    await bench.open()
    setpoint, mode = bench.tags.write_map
    unfit, other = (setpoint, mode) if name == "setpoint" else (mode, setpoint)
    with pytest.raises(DriverError):
        await writing(bench).write([(other, 5), (unfit, value)])
    assert [sample.value for sample in await bench.driver.read([setpoint, mode])] == [0.0, 0]


async def test_a_write_while_the_device_is_away_raises_and_is_not_made_up_for_later(bench: Bench) -> None:
    await bench.open()
    await bench.driver.read(bench.tags.read)
    await bench.lose()
    with pytest.raises(DriverError):
        await writing(bench).write([(bench.tags.mode, 9)])
    await bench.restore()
    await read_until_good(bench.driver, bench.tags.state)
    assert (await bench.driver.read([bench.tags.mode]))[0].value == 0


async def test_a_write_that_the_device_confirms_and_forgets_is_unverified(bench: Bench) -> None:
    await bench.open()
    bench.forget_writes()
    with pytest.raises(WriteUnverified):
        await writing(bench).write([(bench.tags.mode, 9)])
    assert (await bench.driver.read([bench.tags.mode]))[0].value == 0


async def test_statistics_are_finite_counters_that_only_grow_with_use(bench: Bench) -> None:
    await bench.open()
    before = dict(bench.driver.statistics())
    if bench.period is not None:
        await asyncio.sleep(2 * bench.period)
    await bench.driver.read(bench.tags.read)
    after = bench.driver.statistics()
    assert set(after) == set(before)
    assert after[bench.counter] > before[bench.counter]
    assert all(value >= 0 for value in after.values())
