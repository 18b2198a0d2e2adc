"""A loop that ended while its gateway ran cancelled all of its tasks, and the gateway waited for ever for its scans."""

import asyncio
from pathlib import Path

from gateway.machine.reading import plant_clock
from gateway.plant.app import run
from gateway.store import newest_scan, reading
from tests.gateway.support import Bench, config_in


async def test_a_gateway_whose_tasks_are_all_cancelled_ends_and_keeps_its_records(tmp_path: Path) -> None:
    config, clock = config_in(tmp_path), plant_clock(1.0)
    bench, before = Bench(config, clock), asyncio.all_tasks()  # type: ignore[arg-type]
    gateway = asyncio.create_task(run(config, clock=clock, stop=asyncio.Event(), driver=bench))
    while bench.reads < 3:
        await asyncio.sleep(0.01)
    tasks = asyncio.all_tasks() - before
    for task in tasks:
        task.cancel()
    await asyncio.wait_for(asyncio.wait(tasks), 60.0)
    assert gateway.done()
    with reading(config.historian.path) as connection:
        assert newest_scan(connection) is not None
