"""What pymodbus 3.16.1 does by itself: why the guards exist, and a warning when an upgrade changes it.

Every test here asserts a behaviour that would be wrong in a plant. One that fails after an upgrade means that a guard
of drivers/modbus/wire.py can be thought over, or that a hook it stands on has gone.
"""

import asyncio
import inspect
import logging
import ssl
import struct
from collections.abc import AsyncIterator
from functools import partial
from pathlib import Path
from typing import Any

import pymodbus
import pytest
from pymodbus.client import AsyncModbusTcpClient, AsyncModbusTlsClient
from pymodbus.exceptions import ConnectionException, ModbusIOException
from pymodbus.pdu import ModbusPDU
from pymodbus.pdu.register_message import ReadHoldingRegistersRequest

from tests.drivers import certified
from tests.drivers.scripted import ScriptedPlc, always, mbap, read_reply, silent, transaction_of


@pytest.fixture
async def bare(plc: ScriptedPlc) -> AsyncIterator[AsyncModbusTcpClient]:
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)
    client = AsyncModbusTcpClient("127.0.0.1", port=plc.port, timeout=0.15, retries=0, reconnect_delay=0)
    await client.connect()
    yield client
    client.close()


def test_the_version_is_the_one_that_was_examined() -> None:
    assert pymodbus.__version__ == "3.16.1"


def test_its_own_reconnection_would_back_off_to_five_minutes_and_it_retries_three_times() -> None:
    parameters = inspect.signature(AsyncModbusTcpClient).parameters
    assert parameters["reconnect_delay_max"].default == 300
    assert parameters["reconnect_delay"].default == 0.1
    assert parameters["retries"].default == 3


@pytest.mark.parametrize("count", [3, 5])
async def test_it_accepts_three_or_five_registers_for_four(
    plc: ScriptedPlc, bare: AsyncModbusTcpClient, count: int
) -> None:
    plc.bend = always(lambda request, _: read_reply(request, [9] * count))
    assert len((await bare.read_holding_registers(0, count=4)).registers) == count


async def test_it_accepts_input_registers_for_holding_registers(plc: ScriptedPlc, bare: AsyncModbusTcpClient) -> None:
    plc.bend = always(lambda request, _: read_reply(request, [9], function=4))
    reply = await bare.read_holding_registers(0, count=1)
    assert (reply.function_code, reply.registers) == (4, [9])


async def test_it_accepts_less_data_than_arrived(plc: ScriptedPlc, bare: AsyncModbusTcpClient) -> None:
    plc.bend = always(lambda request, _: mbap(transaction_of(request), 1, b"\x03\x02\0\1\0\2\0\3"))
    assert (await bare.read_holding_registers(0, count=3)).registers == [1]


async def test_it_accepts_transaction_id_zero_for_any_request(plc: ScriptedPlc, bare: AsyncModbusTcpClient) -> None:
    plc.bend = always(lambda request, honest: b"\0\0" + honest[2:])
    assert (await bare.read_holding_registers(5, count=1)).registers == [5]


async def test_it_accepts_the_echo_of_another_value_and_of_another_block(
    plc: ScriptedPlc, bare: AsyncModbusTcpClient
) -> None:
    plc.bend = always(lambda request, _: mbap(transaction_of(request), 1, struct.pack(">BHH", 6, 5, 999)))
    assert (await bare.write_register(5, 123)).registers == [999]
    plc.bend = always(lambda request, _: mbap(transaction_of(request), 1, struct.pack(">BHH", 16, 700, 1)))
    reply = await bare.write_registers(5, [1, 2, 3])
    assert not reply.isError()
    assert (reply.address, reply.count) == (700, 1)


async def test_a_reply_from_another_unit_is_no_error_to_it_but_a_time_out(
    plc: ScriptedPlc, bare: AsyncModbusTcpClient
) -> None:
    plc.bend = always(lambda request, _: read_reply(request, [1], unit=9))
    with pytest.raises(ModbusIOException, match="No response received"):
        await bare.read_holding_registers(0, count=1)


async def test_by_default_it_sends_a_write_four_times_with_one_transaction_id(plc: ScriptedPlc) -> None:
    plc.bend = silent
    client = AsyncModbusTcpClient("127.0.0.1", port=plc.port, timeout=0.05)
    await client.connect()
    with pytest.raises(ModbusIOException):
        await client.write_register(5, 123)
    client.close()
    assert plc.functions() == [6, 6, 6, 6]
    assert len({transaction_of(request) for request in plc.requests}) == 1


async def test_a_reply_to_its_first_attempt_satisfies_its_second(plc: ScriptedPlc) -> None:
    held: list[bytes] = []

    async def answer_the_attempt_before(
        plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter
    ) -> None:
        held.append(honest)
        if len(held) == 2:
            writer.write(held[0])

    plc.bend = answer_the_attempt_before
    client = AsyncModbusTcpClient("127.0.0.1", port=plc.port, timeout=0.05, retries=1)
    await client.connect()
    reply = await client.read_holding_registers(5, count=1)
    client.close()
    assert (reply.registers, reply.retries) == ([5], 1)


async def test_it_says_connected_of_a_peer_that_never_answers(plc: ScriptedPlc, bare: AsyncModbusTcpClient) -> None:
    plc.bend = silent
    for _ in range(3):
        with pytest.raises(ModbusIOException):
            await bare.read_holding_registers(0, count=1)
    assert bare.connected


async def test_a_waiting_request_does_not_notice_that_the_connection_has_gone(
    plc: ScriptedPlc, bare: AsyncModbusTcpClient
) -> None:
    plc.bend = silent
    asking = asyncio.ensure_future(bare.execute(False, _read_one()))
    await asyncio.sleep(0.03)
    await plc.stop()
    await asyncio.sleep(0.03)
    assert not bare.connected
    assert not asking.done()
    with pytest.raises(ModbusIOException):
        await asking


async def test_a_reply_of_an_unknown_function_raises_inside_the_event_loop_and_costs_the_connection(
    plc: ScriptedPlc, bare: AsyncModbusTcpClient
) -> None:
    complaints: list[dict[str, object]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: complaints.append(context))
    plc.bend = always(lambda request, _: mbap(transaction_of(request), 1, b"\x55\0\0"))
    with pytest.raises(ModbusIOException):
        await bare.read_holding_registers(0, count=1)
    assert not bare.connected
    assert len(complaints) == 1


async def test_connect_keeps_the_reason_of_a_failure_to_itself(plc: ScriptedPlc) -> None:
    await plc.stop()
    client = AsyncModbusTcpClient("127.0.0.1", port=plc.port, timeout=0.2, reconnect_delay=0)
    assert await client.connect() is False
    client.close()


async def test_the_hooks_that_the_driver_stands_on_are_there(plc: ScriptedPlc) -> None:
    seen: list[bytes] = []
    links: list[bool] = []

    def arrived(data: bytes, addr: tuple[Any, ...] | None = None) -> int:
        seen.append(data)
        return len(data)

    client = AsyncModbusTcpClient("127.0.0.1", port=plc.port, trace_connect=links.append)
    client.ctx.callback_data = arrived  # type: ignore[method-assign]
    await client.ctx.call_create()
    assert client.connected
    assert isinstance(client.ctx.transport, asyncio.Transport)
    assert client.ctx.max_buffer_size > 0
    request = _read_one()
    request.transaction_id = 0x1234
    frame = client.ctx.framer.buildFrame(request)
    assert frame == mbap(0x1234, 1, b"\x03\0\0\0\x01")
    for _ in range(2):  # what was taken in is not given again
        client.ctx.transport.write(frame)
        await asyncio.sleep(0.02)
    assert seen == [plc.answer(frame)] * 2
    await plc.stop()
    await asyncio.sleep(0.02)
    assert links == [True, False]
    client.close()


# ------------------------------------------------------------------ TLS


async def secured(folder: Path) -> tuple[ScriptedPlc, ssl.SSLContext]:
    """A device that demands certificates, and the context of a client that has one."""
    plc = ScriptedPlc(context=certified.server_context(folder))
    await plc.start()
    certified.folder(folder)
    context = ssl.create_default_context(cafile=str(folder / "ca.pem"))
    context.load_cert_chain(folder / "client.pem", folder / "client.key")
    return plc, context


async def test_a_tls_reply_split_over_two_records_fails(tmp_path: Path) -> None:
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)
    plc, context = await secured(tmp_path)

    async def in_two(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        writer.write(honest[:9])
        await asyncio.sleep(0.02)
        writer.write(honest[9:])

    plc.bend = in_two
    client = AsyncModbusTlsClient("localhost", port=plc.port, sslctx=context, timeout=0.2, retries=0, reconnect_delay=0)
    await client.connect()
    with pytest.raises(ModbusIOException):
        await client.read_holding_registers(5, count=2)
    client.close()
    await plc.stop()


async def test_without_a_client_certificate_connect_says_true_and_the_first_read_fails(tmp_path: Path) -> None:
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)
    plc, _ = await secured(tmp_path)
    bare = ssl.create_default_context(cafile=str(tmp_path / "ca.pem"))
    client = AsyncModbusTlsClient("localhost", port=plc.port, sslctx=bare, timeout=0.2, retries=0, reconnect_delay=0)
    assert await client.connect() is True
    with pytest.raises((ModbusIOException, ConnectionException)):
        await client.read_holding_registers(5, count=1)
    client.close()
    await plc.stop()


async def test_the_hooks_for_tls_are_there(tmp_path: Path) -> None:
    plc, context = await secured(tmp_path)
    client = AsyncModbusTlsClient("localhost", port=plc.port, sslctx=context, reconnect_delay=0)
    reasons: list[object] = []
    client.ctx.callback_disconnected = reasons.append  # type: ignore[method-assign]
    create = partial(client.ctx.loop.create_connection, client.ctx.handle_new_connection, "localhost", plc.port)
    client.ctx.call_create = partial(create, ssl=context, server_hostname="localhost")
    await client.ctx.call_create()
    assert isinstance(client.ctx.transport, asyncio.Transport)
    assert (await client.read_holding_registers(5, count=1)).registers == [5]
    await plc.stop()
    await asyncio.sleep(0.05)
    assert len(reasons) == 1
    client.close()


def _read_one() -> ModbusPDU:
    return ReadHoldingRegistersRequest(address=0, count=1, dev_id=1)
