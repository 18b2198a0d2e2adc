"""The floor under the gateway: pymodbus's asynchronous client, which reads 20 registers, writes 24, and no more.

`python -m benchmarks.bare PORT PERIOD` does so every PERIOD seconds until its standard input ends.
"""

import asyncio
import sys
import threading
from time import perf_counter

import click
from pymodbus.client import AsyncModbusTcpClient

TEST_REGISTERS, READ, WRITTEN = 600, 20, 24
"""The registers lie outside the gateway's block, so that neither client disturbs what the other one writes."""


async def connect(port: int) -> AsyncModbusTcpClient:
    """A connected client, without retries. Raises ConnectionError."""
    client = AsyncModbusTcpClient("127.0.0.1", port=port, retries=0, timeout=2.0)
    if not await client.connect():
        raise ConnectionError(f"127.0.0.1:{port} does not connect")
    return client


async def pair(client: AsyncModbusTcpClient, count: int) -> float:
    """One read (function 3) and one write (function 16), one after the other; the seconds that both took.

    Raises ConnectionError when the PLC refuses one.
    """
    begin = perf_counter()
    read = await client.read_holding_registers(TEST_REGISTERS, count=READ, device_id=1)
    written = await client.write_registers(TEST_REGISTERS, [count & 0xFFFF] * WRITTEN, device_id=1)
    seconds = perf_counter() - begin
    if read.isError() or written.isError():
        raise ConnectionError(f"the PLC refused the bare client: {read}, {written}")
    return seconds


async def _poll(port: int, period: float) -> None:
    loop, ended = asyncio.get_running_loop(), asyncio.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), loop.call_soon_threadsafe(ended.set)), daemon=True).start()
    client = await connect(port)
    due, count = loop.time(), 0
    while not ended.is_set():
        await pair(client, count)
        count += 1
        due += period
        await asyncio.sleep(due - loop.time())
    client.close()


@click.command(help=__doc__)
@click.argument("port", type=int)
@click.argument("period", type=float)
def main(port: int, period: float) -> None:
    asyncio.run(_poll(port, period))


if __name__ == "__main__":
    main()
