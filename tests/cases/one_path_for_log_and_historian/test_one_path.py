"""With `log.path` equal to `historian.path` the log's rotation put a text of 108 bytes in the historian's place."""

import asyncio
import os
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from drivers.settings import ConfigError
from gateway.plant.app import run
from gateway.settings import load_plant
from tests.gateway.support import Bench, JumpClock, config_in, plant_file

PATHS = {
    "log": "path",
    "historian": "path",
    "control": "path",
    "page": "users",
    "writeback": "audit",
}


@pytest.mark.parametrize("one", PATHS)
@pytest.mark.parametrize("other", PATHS)
def test_no_two_of_the_gateways_files_are_one(tmp_path: Path, one: str, other: str) -> None:
    if one == other:
        return
    (tmp_path / "link").symlink_to(tmp_path)
    text = "".join(
        f'[{section}]\n{PATHS[section]} = "{place}records.sqlite"\n' for section, place in ((one, ""), (other, "link/"))
    )
    with pytest.raises(ConfigError, match="too; give each a path of its own"):
        load_plant(plant_file(tmp_path, text))


async def test_where_no_check_sees_it_the_log_is_what_is_not_written(tmp_path: Path) -> None:
    """Two names of one file."""
    config = config_in(tmp_path, log__max_mb=0.001)
    bench = Bench(config, JumpClock(), stop_after=30)
    await asyncio.wait_for(run(config, clock=bench.clock, stop=bench.stop, driver=bench), 300.0)
    Path(config.log.path or "").unlink()
    os.link(config.historian.path, config.log.path or "")
    bench = Bench(config, JumpClock(2_000_000_000.0), stop_after=30)
    status = await asyncio.wait_for(run(config, clock=bench.clock, stop=bench.stop, driver=bench), 300.0)
    assert status["alarms"]["records"] == "unacknowledged"
    with closing(sqlite3.connect(config.historian.path)) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        assert connection.execute("SELECT count(*) FROM scans").fetchone()[0] >= 50
    assert not list(tmp_path.glob("*.damaged-*")) and not list(tmp_path.glob("gateway.jsonl.*"))
