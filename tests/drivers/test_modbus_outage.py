"""Outages over a real socket: noticed by the rule, never a wrong value, back within a second of the device's return.

The seconds asserted here are promises of the driver's defaults (deadlines, dead-peer rule, pauses), not its speed.
"""

import asyncio
import contextlib
import gc
import socket
import time
from collections.abc import AsyncIterator

import pytest

from drivers.errors import LinkDown
from drivers.modbus.driver import ModbusDriver, open_modbus
from drivers.tag import Quality, Sample, Tag
from tests.drivers.conftest import OpenModbus, open_anyway, read_until_good
from tests.drivers.scripted import Bend, ScriptedPlc, always, first, mbap, silent, transaction_of

FIVE = Tag("five", "holding:5")
BACK = 20.0  # s from the device's return to the first good sample; a busy machine takes its time


async def poll(driver: ModbusDriver, seconds: float, seen: list[Sample]) -> None:
    end = asyncio.get_running_loop().time() + seconds
    while asyncio.get_running_loop().time() < end:
        seen += await driver.read([FIVE])
        await asyncio.sleep(0.02)


@pytest.mark.parametrize("outage", [0.3, 3.2])
async def test_a_killed_device_is_read_again_within_a_second_of_its_return(
    plc: ScriptedPlc, opened: OpenModbus, outage: float
) -> None:
    driver = await opened()
    await read_until_good(driver, FIVE)
    await plc.stop()
    seen: list[Sample] = []
    await poll(driver, outage, seen)
    assert {sample.quality for sample in seen} == {Quality.NOT_CONNECTED}
    assert not driver.connected
    await plc.start()
    returned = time.time()
    sample = await read_until_good(driver, FIVE, within=BACK)
    assert sample.time - returned < BACK
    assert driver.connected
    assert driver.statistics()["reconnects"] == 1


async def test_a_device_that_is_away_at_start_is_read_within_a_second_of_its_coming(plc: ScriptedPlc) -> None:
    await plc.stop()
    driver = open_modbus({"host": "127.0.0.1", "port": plc.port}, clock=time.time)
    with pytest.raises(LinkDown, match="does not connect: Connect"):
        await driver.open()
    await asyncio.sleep(1.3)
    await plc.start()
    await read_until_good(driver, FIVE, within=BACK)
    await driver.close()


async def test_a_device_that_falls_silent_is_given_up_by_the_rule_and_read_again_when_it_speaks(
    plc: ScriptedPlc, opened: OpenModbus
) -> None:
    driver = await opened()
    await read_until_good(driver, FIVE)
    plc.bend = silent
    loop = asyncio.get_running_loop()
    began = loop.time()
    while driver.connected:
        (sample,) = await driver.read([FIVE])
        assert sample.quality in (Quality.TIMEOUT, Quality.NOT_CONNECTED)
        assert loop.time() - began < 2.0 + 0.3
    assert driver.statistics()["dead_peers"] == 1
    await asyncio.sleep(0.8)
    plc.bend = None
    await read_until_good(driver, FIVE, within=BACK)


async def test_a_slow_scan_still_gives_a_silent_device_up_after_two_seconds_of_asking(
    plc: ScriptedPlc, opened: OpenModbus
) -> None:
    driver = await opened(timeout=1.5, attempts=1)
    await read_until_good(driver, FIVE)
    plc.bend = silent
    began = asyncio.get_running_loop().time()
    await driver.read([FIVE])
    assert driver.connected
    await driver.read([FIVE])
    assert 1.9 < asyncio.get_running_loop().time() - began < 2.3
    assert not driver.connected


async def test_a_half_open_connection_is_replaced_while_new_ones_are_served(
    plc: ScriptedPlc, opened: OpenModbus
) -> None:
    """The device has restarted behind a firewall: the old connection is a black hole, a new one works."""
    driver = await opened()
    await read_until_good(driver, FIVE)
    old = set(plc._writers)

    async def deaf(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        if writer not in old:
            writer.write(honest)

    plc.bend = deaf
    await read_until_good(driver, FIVE)
    assert plc.connections == 2


async def test_a_device_that_accepts_before_its_program_runs_is_read_soon_after_it_serves_new_connections(
    plc: ScriptedPlc, opened: OpenModbus
) -> None:
    """No connection has worked yet: the time a silent one took is not waited a second time."""
    serving = False

    async def booting(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        if serving and writer not in early:
            writer.write(honest)

    plc.bend = booting
    driver = await opened()
    await poll(driver, 3.0, [])
    early, serving = set(plc._writers), True
    await read_until_good(driver, FIVE, within=3 * 0.3 + 0.3)


def torn(cut: int) -> Bend:
    async def bend(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        writer.write(honest[:cut])
        await asyncio.sleep(0.01)
        writer.transport.abort()

    return bend


BROKEN: dict[str, Bend] = {
    "reset before the reply": torn(0),
    "reset in the header": torn(5),
    "reset in the middle of the data": torn(10),
    "garbage": always(lambda request, _: b"\xde\xad\xbe\xef" * 9),
    "another protocol": always(lambda request, _: b"HTTP/1.1 400 Bad Request\r\n\r\n"),
    "protocol id 1": always(lambda request, _: mbap(transaction_of(request), 1, b"\x03\x02\0\1", protocol=1)),
    "length 0": always(lambda request, honest: honest[:4] + b"\0\0" + honest[6:]),
}


@pytest.mark.parametrize("kind", BROKEN)
async def test_a_broken_stream_is_a_lost_link_at_once_and_the_next_connection_is_clean(
    plc: ScriptedPlc, opened: OpenModbus, kind: str
) -> None:
    complaints: list[dict[str, object]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: complaints.append(context))
    driver = await opened(timeout=30, attempts=1)
    await read_until_good(driver, FIVE)
    plc.bend = first(1, BROKEN[kind])
    async with asyncio.timeout(20.0):
        (sample,) = await driver.read([FIVE])
    assert (sample.value, sample.quality) == (None, Quality.NOT_CONNECTED)
    await read_until_good(driver, FIVE, within=BACK)
    assert plc.connections == 2
    assert complaints == []


async def test_a_flood_of_frames_that_nobody_asked_for_ends_the_connection_and_not_the_memory(
    plc: ScriptedPlc, opened: OpenModbus
) -> None:
    frame = mbap(9999, 1, b"\x03\xc8" + bytes(200))
    plc.bend = first(1, always(lambda request, honest: frame * 2000))
    driver = await opened(timeout=2, attempts=1)
    (sample,) = await driver.read([FIVE])
    assert sample.quality is Quality.NOT_CONNECTED
    assert "floods" in sample.reason
    await read_until_good(driver, FIVE, within=BACK)


async def test_a_device_that_accepts_and_closes_is_not_called_in_a_tight_loop(plc: ScriptedPlc) -> None:
    calls = 0

    async def slam(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        nonlocal calls
        calls += 1
        writer.close()

    server = await asyncio.start_server(slam, "127.0.0.1", 0)
    settings = {"host": "127.0.0.1", "port": server.sockets[0].getsockname()[1], "one_client": True}
    driver = open_modbus(settings, clock=time.time)
    await open_anyway(driver)
    seen: list[Sample] = []
    await poll(driver, 1.5, seen)
    await driver.close()
    server.close()
    assert calls <= 8
    assert not any(sample.quality.is_good for sample in seen)
    assert "is another one connected?" in seen[-1].reason


@pytest.fixture
def black_hole() -> AsyncIterator[int]:
    """A port of which the queue is full: connecting neither succeeds nor fails."""
    with contextlib.ExitStack() as stack:
        listener = stack.enter_context(socket.socket())
        listener.bind(("127.0.0.1", 0))
        listener.listen(0)
        for _ in range(4):
            filler = stack.enter_context(socket.socket())
            filler.setblocking(False)
            filler.connect_ex(listener.getsockname())
        yield listener.getsockname()[1]


async def test_connecting_into_a_black_hole_ends_at_its_deadline_and_reading_meanwhile_does_not_wait(
    black_hole: int,
) -> None:
    driver = open_modbus({"host": "127.0.0.1", "port": black_hole}, clock=time.time)
    loop = asyncio.get_running_loop()
    began = loop.time()
    with pytest.raises(LinkDown, match=r"no connection within 0\.3 s"):
        await driver.open()
    assert loop.time() - began < 0.6
    began = loop.time()
    (sample,) = await driver.read([FIVE])
    assert loop.time() - began < 0.1
    assert sample.quality is Quality.NOT_CONNECTED
    await driver.close()


@pytest.mark.parametrize("host", ["no-such-plc.invalid", "x" * 70 + ".local"])
async def test_a_host_that_does_not_exist_is_said_by_name(host: str) -> None:
    driver = open_modbus({"host": host, "port": 502, "connect_timeout": 5}, clock=time.time)
    with pytest.raises(LinkDown, match=rf"{host}:502 does not connect|no connection within"):
        await driver.open()
    await driver.close()


async def test_ten_restarts_leave_no_socket_and_no_task_behind(plc: ScriptedPlc) -> None:
    driver = open_modbus({"host": "127.0.0.1", "port": plc.port, "backoff_first": 0.02}, clock=time.time)
    await driver.open()
    for _ in range(10):
        await read_until_good(driver, FIVE, within=BACK)
        await plc.stop()
        await asyncio.sleep(0.03)
        await plc.start()
    await driver.close()
    await plc.stop()
    await asyncio.sleep(0.05)
    gc.collect()  # an unclosed transport would warn here, and warnings are errors
    assert len(asyncio.all_tasks()) == 1
