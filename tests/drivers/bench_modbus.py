"""The Modbus driver on the bench, over each of its links, against the scripted device."""

import asyncio
import tempfile
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

from drivers.connections import Connections
from drivers.driver import Driver, open_driver
from tests.drivers.benches import Bench, Tags
from tests.drivers.certified import folder, server_context
from tests.drivers.scripted import ScriptedPlc, always
from tests.drivers.scripted_line import PtyLine, ScriptedLine, TcpLine, rtu

REGISTERS = {10: 125, 11: 7, 12: 2, 20: 0, 21: 0}
LINE = {"longest_reply": 0.2, "timeout": 0.2}
"""A scripted device answers at once or not at all."""


def _driver(connections: Connections | None = None, **settings: Any) -> Driver:
    write_map = Tags().write_map
    return open_driver("modbus", settings, clock=time.time, write_map=write_map, connections=connections)


async def modbus_bench() -> AsyncIterator[Bench]:
    """Modbus TCP."""
    plc = ScriptedPlc(registers=dict(REGISTERS))
    async for bench in _networked(plc, {}):
        yield bench


async def shared_bench() -> AsyncIterator[Bench]:
    """Modbus TCP, on a connection that other units may join."""
    plc = ScriptedPlc(registers=dict(REGISTERS))
    async for bench in _networked(plc, {}, Connections()):
        yield bench


async def tls_bench() -> AsyncIterator[Bench]:
    """Modbus/TCP Security."""
    with tempfile.TemporaryDirectory() as place:
        path = Path(place)
        plc = ScriptedPlc(registers=dict(REGISTERS), context=server_context(path))
        settings = {"transport": "tls", "certificates": str(folder(path)), "connect_timeout": 0.5}
        async for bench in _networked(plc, settings):
            yield bench


async def _networked(
    plc: ScriptedPlc, settings: dict[str, Any], connections: Connections | None = None
) -> AsyncIterator[Bench]:
    await plc.start()
    driver = _driver(connections, host="127.0.0.1", port=plc.port, **settings)

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


def _forgetful(line: ScriptedLine) -> None:
    def bend(line: ScriptedLine, request: bytes, honest: bytes) -> None:
        line.memory.registers.update({20: 0, 21: 0})
        fresh = line.memory.pdu(3, *_span(request), b"") if request[1] == 3 else honest[1:-2]
        line.put(rtu(line.unit, fresh))

    line.bend = bend


def _span(request: bytes) -> tuple[int, int]:
    return int.from_bytes(request[2:4], "big"), int.from_bytes(request[4:6], "big")


async def rtu_bench() -> AsyncIterator[Bench]:
    """Modbus RTU on a serial port: a pseudo-terminal, whose far end goes away and comes back by the same path."""
    line = ScriptedLine(ScriptedPlc(registers=dict(REGISTERS)))
    ends = PtyLine(line)
    ends.start()
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "ttyUSB0"
        path.symlink_to(ends.path)
        driver = _driver(transport="rtu", serial=str(path), parity="N", baud=115200, **LINE)

        async def lose() -> None:
            path.unlink()
            ends.stop()
            await asyncio.sleep(0.01)

        async def restore() -> None:
            ends.start()
            path.symlink_to(ends.path)

        yield Bench(driver, lose, restore, lambda: _forgetful(line))
        await driver.close()
        ends.stop()


async def rtu_tcp_bench() -> AsyncIterator[Bench]:
    """RTU frames over TCP."""
    line = ScriptedLine(ScriptedPlc(registers=dict(REGISTERS)))
    server = TcpLine(line)
    await server.start()
    driver = _driver(transport="rtu-tcp", host="127.0.0.1", port=server.port, **LINE)
    yield Bench(driver, server.stop, server.start, lambda: _forgetful(line))
    await driver.close()
    await server.stop()
