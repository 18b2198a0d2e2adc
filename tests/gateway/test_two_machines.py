"""Two machines in one process: side by side each does what it does alone, row for row and block for block."""

import asyncio
import sqlite3
from contextlib import aclosing, closing
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

from gateway.machine.pipeline import Machine
from gateway.machine.reading.quality import QualityRules
from gateway.machine.reading.scan import scans
from gateway.plant.log import open_log
from sim.sha.model import Model
from tests.gateway.support import CURRENT, RUNNING, TEMPERATURE, Bench, JumpClock, config_in, two_modes
from tests.gateway.test_app import ARMED, heating

SCANS = 150
TABLES = ("runs", "scans", "samples", "predictions", "forecasts", "events", "alarms", "writes", "audit", "guards")
Rows = dict[str, list[tuple[Any, ...]]]
Blocks = list[dict[str, Any]]


def cooler() -> Model:
    """Another model than `two_modes`: it stops where that one goes on, and a member of no ensemble."""
    model = two_modes(gap=20.0)
    law = model.sha.locations[2].distribution
    assert law is not None
    on = replace(model.sha.locations[2], distribution=replace(law, params={"mu": 40.0, "sigma": 2.0}))
    return replace(model, sha=replace(model.sha, name="cooler", locations=(*model.sha.locations[:2], on)))


async def through(folder: Path, model: Model, *, hot: bool) -> tuple[Rows, Blocks]:
    """A machine on a device of its own, from start to end; each forecast is awaited, since no clock of a wall runs."""
    folder.mkdir(parents=True)
    config = config_in(folder, "[alarms]\nlimit = 45.0\n", model=model, **{**ARMED, "forecast__period": 5.0})
    bench = Bench(config, JumpClock(), armed=True, stop_after=SCANS)
    heating(bench, 5, 100)
    for read in range(100, SCANS):
        bench.plan[read] = {RUNNING: hot, CURRENT: 240.0 if hot else 0.0, TEMPERATURE: 60.0 if hot else 38.0}
    bench.plan[60 if hot else 30] = {CURRENT: None}
    rules = QualityRules(config.scan.period, config.map.heartbeat, config.device.heartbeat_period)
    with open_log(config.log.path, config.log.level) as log:
        machine = Machine(config, driver=bench, clock=bench.clock, log=log, rng=Random(0))
        try:
            await bench.open()
            async with aclosing(scans(bench, config.map.tags, bench.clock, rules, stop=bench.stop)) as stream:
                async for scan in stream:
                    await machine.take(scan)
                    assert machine.model is not None
                    await machine.model.outlook.finish()
        finally:
            assert machine.model is not None
            await machine.model.close()
            assert machine.close()
    with closing(sqlite3.connect(config.historian.path)) as connection:
        rows = {table: connection.execute(f"SELECT * FROM {table} ORDER BY 1, 2").fetchall() for table in TABLES}  # noqa: S608
    return rows, bench.written


async def test_side_by_side_each_machine_does_what_it_does_alone(tmp_path: Path) -> None:
    alone = [
        await through(tmp_path / "alone" / "first", two_modes(), hot=True),
        await through(tmp_path / "alone" / "second", cooler(), hot=False),
    ]
    together = await asyncio.gather(
        through(tmp_path / "together" / "first", two_modes(), hot=True),
        through(tmp_path / "together" / "second", cooler(), hot=False),
    )
    for (rows, blocks), (rows_alone, blocks_alone) in zip(together, alone, strict=True):
        assert blocks == blocks_alone and len(blocks) > 100
        for table in TABLES:
            assert rows[table] == rows_alone[table], table
        assert len(rows["forecasts"]) > 20 and len(rows["predictions"]) > 140
    (hot, _), (cold, _) = together
    assert hot["predictions"] != cold["predictions"] and hot["runs"][0][2] != cold["runs"][0][2]
    assert ("over limit " + TEMPERATURE) in {row[2] for row in hot["alarms"]}
    assert ("over limit " + TEMPERATURE) not in {row[2] for row in cold["alarms"]}
