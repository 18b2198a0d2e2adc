"""A row of the audit log had the name that somebody gave, and not which user and process of the box had given it."""

import asyncio
import os
from pathlib import Path
from typing import Any

from click.testing import CliRunner

from gateway.cli.main import main
from gateway.outside.status import connect
from gateway.plant.app import run
from gateway.store import ARMED, DISARMED, read
from tests.gateway.support import TEMPERATURE, Bench, PacedClock, config_in, two_modes

SHADOW = '[writeback]\nmode = "shadow"\n'


def details(audit: Path, kinds: set[str]) -> list[dict[str, Any]]:
    return [dict(row.entry.detail) for row in read(audit) if row.entry.kind in kinds]


def by_commands(config_path: Path, audit: Path) -> None:
    """Arm and disarm by `decanter plc`, with a gateway that runs or without one."""
    for words in (("arm", "--minutes", "5"), ("disarm",)):
        named = ("--config", str(config_path), "--by", "Ada", "--reason", "test", "--audit", str(audit))
        done = CliRunner().invoke(main, ["plc", *words, *named])
        assert done.exit_code == 0, done.output


def forged(socket: Path) -> None:
    """What a program that speaks for itself gives as its user and process."""
    line = connect(socket, 60.0)
    assert line is not None
    try:
        asked = {"by": "Eve", "reason": "test", "peer": {"uid": 4711, "pid": 1}}
        line.ask("arm", minutes=5.0, **asked)
        line.ask("disarm", **asked)
        line.ask("shelve", alarm=f"over limit {TEMPERATURE}", minutes=5.0, **asked)
    finally:
        line.close()


async def test_a_row_of_what_a_person_does_names_user_and_process_whatever_the_request_says(tmp_path: Path) -> None:
    config = config_in(tmp_path, SHADOW, model=two_modes())
    clock = PacedClock()
    bench = Bench(config, clock, armed=True)
    running = asyncio.create_task(run(config, clock=clock, stop=bench.stop, driver=bench))
    try:
        async with asyncio.timeout(120.0):
            while not config.control_socket.exists() or bench.reads < 5:
                await asyncio.sleep(0)
            await asyncio.to_thread(by_commands, config.path, config.audit)
            await asyncio.to_thread(forged, config.control_socket)
    finally:
        bench.stop.set()
        await asyncio.wait_for(running, 300.0)
    rows = details(config.audit, {ARMED, DISARMED, "alarm shelved"})
    assert len(rows) == 5, rows
    assert {(row.get("uid"), row.get("pid")) for row in rows} == {(os.getuid(), os.getpid())}


def test_so_does_one_that_is_made_where_no_gateway_runs(tmp_path: Path) -> None:
    config = config_in(tmp_path, SHADOW, model=two_modes())
    by_commands(config.path, config.audit)
    rows = details(config.audit, {ARMED, DISARMED})
    assert len(rows) == 2 and {(row.get("uid"), row.get("pid")) for row in rows} == {(os.getuid(), os.getpid())}
