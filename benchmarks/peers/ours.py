"""Our contender: many PLCs read in one process, each by a stream of scans of its own, with quality and one historian.

`python -m benchmarks.peers.ours PORT COUNT PERIOD FOLDER` reads until its standard input ends. The streams' phases are
spread over the period.
"""

import asyncio
import sys
import threading
from pathlib import Path

import click

from benchmarks.peers import REGISTERS
from drivers.driver import open_driver
from drivers.tag import Tag
from gateway.machine.reading import PlantClock, QualityRules, plant_clock, scans
from gateway.machine.records import Keeper, Records
from gateway.plant.fleet import SWITCH_SECONDS
from gateway.store import Historian, open_historian


def tags_of(machine: int) -> tuple[Tag, ...]:
    """The ten registers of a PLC; the first counts up and proves that the PLC lives."""
    return tuple(Tag(f"m{machine}.r{number}", f"holding:{number}") for number in range(REGISTERS))


async def follow(
    port: int,
    machine: int,
    period: float,
    clock: PlantClock,
    historian: Historian,
    stop: asyncio.Event,
    begin: float,
) -> None:
    """Scan one PLC until the stop, from the moment `begin` on; each scan goes into the historian."""
    tags = tags_of(machine)
    driver = open_driver("modbus", {"host": "127.0.0.1", "port": port + machine, "timeout": 0.3}, clock=clock.now)
    rules = QualityRules(period, tags[0].name, 0.1)
    own = historian.view(f"plc{machine}", tags)
    records = Records(own, Keeper({tag.name: tag for tag in tags}, 60.0))
    await driver.open()
    await clock.sleep_until(begin)
    async for scan in scans(driver, tags, clock, rules, stop=stop):
        records.take(scan)
    await driver.close()


async def read_all(port: int, count: int, period: float, folder: Path) -> None:
    loop, stop, clock = asyncio.get_running_loop(), asyncio.Event(), plant_clock()
    threading.Thread(target=lambda: (sys.stdin.read(), loop.call_soon_threadsafe(stop.set)), daemon=True).start()
    historian = open_historian(folder / "historian.sqlite")
    begin = clock.now() + 0.5
    streams = [
        follow(port, machine, period, clock, historian, stop, begin + machine * period / count)
        for machine in range(count)
    ]
    try:
        await asyncio.gather(*streams)
    finally:
        historian.close()


@click.command(help=__doc__)
@click.argument("port", type=int)
@click.argument("count", type=int)
@click.argument("period", type=float)
@click.argument("folder", type=click.Path(path_type=Path))
def main(port: int, count: int, period: float, folder: Path) -> None:
    sys.setswitchinterval(SWITCH_SECONDS)  # as the gateway does
    asyncio.run(read_all(port, count, period, folder))


if __name__ == "__main__":
    main()
