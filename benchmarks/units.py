"""Twenty units behind one connection, three of them dead: what the dead cost the living.

`python -m benchmarks.units [--quick] [--json]`. A device server of this module's own (TCP with transaction ids, and RTU
on a pair of pseudo-terminals) answers for its living units after a while, one at a time on the line, and says nothing
for the dead. Each unit has a driver that is read again and again; a cycle is the time from one good reading of a living
unit to its next. It is measured with all units alive and with the dead ones, on the same place in the same run, after
the dead have been found to be silent. Over TCP time is virtual (`benchmarks.virtual_time`), so that a cycle is waiting
alone; the line's is real. What cannot be had on a connection that takes one request at a time is computed beside it:
so many replies, and for each question to the dead its wait.
"""

import asyncio
import contextlib
import os
import pty
import statistics
import struct
import tty
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

import click

from benchmarks.figures import Figure, give, shares
from benchmarks.virtual_time import virtual_loop
from drivers.connections import Connections
from drivers.modbus.driver import ModbusDriver, open_modbus
from drivers.modbus.rtu import crc
from drivers.modbus.turns import SHORT_WAIT_S
from drivers.tag import Tag

TAGS = tuple(Tag(f"value_{number}", f"holding:{number}") for number in range(10))
ANSWER_S = 0.004
"""How long a living unit takes to answer."""
TIMEOUT_S = 0.3


def _pdu(unit: int, function: int, count: int) -> bytes:
    return struct.pack(f">BBB{count}H", unit, function, 2 * count, *[unit] * count)


@asynccontextmanager
async def _over_tcp(dead: frozenset[int]) -> AsyncIterator[dict[str, Any]]:
    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError, asyncio.CancelledError):
            while True:
                request = await reader.readexactly(12)
                if request[6] in dead:
                    continue
                reply = _pdu(request[6], request[7], int.from_bytes(request[10:12], "big"))
                whole = request[:4] + len(reply).to_bytes(2, "big") + reply
                asyncio.get_running_loop().call_later(ANSWER_S, writer.write, whole)
        writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    yield {"host": "127.0.0.1", "port": server.sockets[0].getsockname()[1]}
    server.close()


@asynccontextmanager
async def _on_a_line(dead: frozenset[int]) -> AsyncIterator[dict[str, Any]]:
    near, far = pty.openpty()
    tty.setraw(far)
    os.set_blocking(near, False)
    loop, rest = asyncio.get_running_loop(), b""

    def heard() -> None:
        nonlocal rest
        rest += os.read(near, 4096)
        while len(rest) >= 8:
            request, rest = rest[:8], rest[8:]
            if request[0] not in dead:
                reply = _pdu(request[0], request[1], int.from_bytes(request[4:6], "big"))
                loop.call_later(ANSWER_S, os.write, near, reply + crc(reply))

    loop.add_reader(near, heard)
    yield {"transport": "rtu", "serial": os.ttyname(far), "parity": "N", "baud": 115200}
    loop.remove_reader(near)
    os.close(near)
    os.close(far)


PLACES: dict[str, tuple[Callable[[frozenset[int]], Any], dict[str, Any]]] = {
    "TCP, one request at a time": (_over_tcp, {"outstanding": 1}),
    "TCP, two requests at a time": (_over_tcp, {"outstanding": 2}),
    "serial line": (_on_a_line, {}),
}


async def _cycles(
    place: str, units: int, dead: frozenset[int], seconds: float, timeout: float = TIMEOUT_S
) -> tuple[list[float], int, int]:
    """The living units' cycles (s), the questions that the dead were asked meanwhile, and wrong values."""
    serve, settings = PLACES[place]
    loop, connections, cycles, wrong = asyncio.get_running_loop(), Connections(), list[float](), 0
    async with serve(dead) as where:
        drivers: list[ModbusDriver] = []
        for unit in range(1, units + 1):
            given = {**where, **settings, "unit": unit, "timeout": timeout, "longest_reply": 1.0}
            if "host" in where:
                del given["longest_reply"]
            drivers.append(open_modbus(given, clock=loop.time, connections=connections))
            await drivers[-1].open()
        measured = asyncio.Event()
        stop = asyncio.Event()

        async def scan(unit: int, driver: ModbusDriver) -> None:
            nonlocal wrong
            last = None
            while not stop.is_set():
                samples = await driver.read(TAGS)
                good = [sample.value for sample in samples if sample.quality.is_good]
                wrong += any(value != unit for value in good)
                now = loop.time()
                if good and unit not in dead:
                    if last is not None and measured.is_set():
                        cycles.append(now - last)
                    last = now
                else:
                    await asyncio.sleep(0.05)

        scans = [asyncio.ensure_future(scan(unit, driver)) for unit, driver in enumerate(drivers, start=1)]
        try:
            async with asyncio.timeout(120):  # on a connection that is always busy each has but its turn
                while any(not drivers[unit - 1].statistics()["silent"] for unit in dead):
                    await asyncio.sleep(0.05)
            before = sum(drivers[unit - 1].statistics()["requests"] for unit in dead)
            measured.set()
            await asyncio.sleep(seconds)
        finally:
            stop.set()
            await asyncio.gather(*scans)
        asked = sum(drivers[unit - 1].statistics()["requests"] for unit in dead) - before
        for driver in drivers:
            await driver.close()
    return cycles, int(asked), wrong


@click.command()
@click.option("--units", type=click.IntRange(4, 200), default=20, help="Units behind the connection.")
@click.option("--seconds", type=float, default=30.0, help="Measured for so long, each way.")
@click.option("--quick", is_flag=True, help="Six units, a fifth of a second each way.")
@click.option("--json", "as_json", is_flag=True, help="Print one line of JSON.")
def main(*, units: int, seconds: float, quick: bool, as_json: bool) -> None:
    """Measure the living units' cycle with three dead ones against all living."""
    timeout = TIMEOUT_S
    if quick:
        units, seconds, timeout = 6, 0.2, 0.05
    dead = frozenset({3, 4, units // 2 + 2})
    figures: list[Figure] = []
    for place in PLACES:
        loop = virtual_loop if "TCP" in place else None  # a pseudo-terminal's bytes take time of their own
        with asyncio.Runner(loop_factory=loop) as runner:
            alive, _, wrong = runner.run(_cycles(place, units, frozenset(), seconds, timeout))
            some, asked, also_wrong = runner.run(_cycles(place, units, dead, seconds, timeout))
        as_ms = [[1000 * cycle for cycle in cycles] for cycles in (some, alive)]
        name = f"{place}: a living unit's cycle, {len(dead)} of {units} dead"
        figures += shares(name, "ms", as_ms[0], "all living", as_ms[1])
        if PLACES[place][1].get("outstanding", 1) == 1:
            # Of eight questions to a silent unit seven have the short wait and one the deadline.
            wait = asked * (7 * min(timeout, SHORT_WAIT_S) + timeout) / 8
            bound = statistics.mean(as_ms[1]) * (units - len(dead)) / units * seconds / (seconds - wait)
            mean = f"{place}: its mean cycle"
            figures.append(Figure(mean, statistics.mean(as_ms[0]), "ms", "replies and waits, computed", bound))
        figures.append(Figure(f"{place}: questions to the dead in {seconds:g} s", asked, ""))
        figures.append(Figure(f"{place}: wrong values", wrong + also_wrong, ""))
    give("units behind one connection", figures, as_json=as_json)


if __name__ == "__main__":
    main()
