"""The bare contender: pymodbus's asynchronous client, a connection and a loop for each PLC, and no more.

`python -m benchmarks.peers.bare PORT COUNT PERIOD` reads ten registers of each on absolute deadlines, the phases spread
over the period, until its standard input ends.
"""

import asyncio
import sys
import threading

import click

from benchmarks.bare import connect
from benchmarks.peers import REGISTERS


async def _poll(port: int, due: float, period: float, ended: asyncio.Event) -> None:
    client, loop = await connect(port), asyncio.get_running_loop()
    while not ended.is_set():
        await asyncio.sleep(due - loop.time())
        reply = await client.read_holding_registers(0, count=REGISTERS, device_id=1)
        if reply.isError():
            raise ConnectionError(f"the PLC refused the bare client: {reply}")
        due += period
    client.close()


async def _poll_all(port: int, count: int, period: float) -> None:
    loop, ended = asyncio.get_running_loop(), asyncio.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), loop.call_soon_threadsafe(ended.set)), daemon=True).start()
    begin = loop.time() + 0.5
    await asyncio.gather(
        *(_poll(port + number, begin + number * period / count, period, ended) for number in range(count))
    )


@click.command(help=__doc__)
@click.argument("port", type=int)
@click.argument("count", type=int)
@click.argument("period", type=float)
def main(port: int, count: int, period: float) -> None:
    asyncio.run(_poll_all(port, count, period))


if __name__ == "__main__":
    main()
