"""Requests are cut out of a stream, and whoever reads one can be told to stop at any time."""

import asyncio

import pytest

from sim.plc.modbus.framing import read_rtu


@pytest.mark.parametrize("turns", range(6))
async def test_a_cancellation_that_comes_with_an_octet_ends_the_reading(turns: int) -> None:
    reader = asyncio.StreamReader()
    serving = asyncio.create_task(read_rtu(reader))
    reader.feed_data(b"\1")
    await asyncio.sleep(0.002)
    reader.feed_data(b"\3")
    for _ in range(turns):
        await asyncio.sleep(0)
    serving.cancel()
    await asyncio.wait([serving], timeout=30.0)
    assert serving.cancelled()
