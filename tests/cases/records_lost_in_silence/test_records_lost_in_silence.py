"""A historian that did not store said so nowhere: no alarm, no line in the log, exit code 0, and the gateway armed."""

import asyncio
import sqlite3
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from gateway.cli.plant.commands import run as run_command
from gateway.plant.app import run
from gateway.settings.config import Config
from gateway.store.historian import Historian
from gateway.store.read_back import reading, stored_rows
from tests.gateway.support import Bench, PacedClock, config_in, logged, plant_file, two_modes

ARMED = {
    "writeback__mode": "armed",
    "writeback__armed_by": "Ada",
    "writeback__reason": "test",
    "writeback__minutes": 60.0,
}


def refuse(monkeypatch: pytest.MonkeyPatch, error: Exception, *, times: int = 10**9) -> None:
    real, calls = Historian._store, []

    def failing(self: Historian, *args: Any) -> None:
        calls.append(args)
        if len(calls) <= times:
            raise error
        real(self, *args)

    monkeypatch.setattr(Historian, "_store", failing)


async def go(config: Config, bench: Bench, reads: int) -> dict[str, Any]:
    bench.stop_after = reads
    return await asyncio.wait_for(run(config, clock=bench.clock, stop=bench.stop, driver=bench), 300.0)


@pytest.mark.parametrize(
    ("records", "code"),
    [
        ({"failure": "", "dropped": 0, "refused": 0}, 0),
        ({"failure": "", "dropped": 0, "refused": 1}, 1),
        ({"failure": "", "dropped": 2, "refused": 0}, 1),
        ({"failure": "the disk is full", "dropped": 0, "refused": 0}, 1),
    ],
)
def test_the_exit_code_says_whether_rows_were_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, records: dict[str, Any], code: int
) -> None:
    monkeypatch.setattr("gateway.plant.serve", lambda *_args, **_keys: {"historian": records, "parts": {}})
    assert CliRunner().invoke(run_command, ["--config", str(plant_file(tmp_path))]).exit_code == code


async def test_a_disk_that_refuses_raises_the_alarm_and_is_said_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = config_in(tmp_path)
    refuse(monkeypatch, sqlite3.OperationalError("disk I/O error"))
    status = await go(config, Bench(config, PacedClock(pause_s=0.01)), 60)
    assert status["alarms"]["records"] == "unacknowledged"
    assert "disk I/O error" in status["historian"]["failure"]
    lines = [row for row in logged(tmp_path) if row["event"] == "the records cannot be relied on"]
    assert len(lines) == 1 and "make room or mend the disk" in lines[0]["reason"]


async def test_a_thread_that_fails_raises_it_as_well_and_its_rows_come_late(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = config_in(tmp_path)
    refuse(monkeypatch, RuntimeError("nobody has thought of it"), times=1)
    status = await go(config, Bench(config, PacedClock(pause_s=0.01)), 60)
    assert status["alarms"]["records"] == "unacknowledged"
    assert status["parts"]["historian"]["restarts"] == 1
    assert status["historian"]["dropped"] == 0
    with reading(config.historian.path) as connection:
        assert len(stored_rows(connection, "scans", ("time",))) == status["scan"]["count"]
        assert ("records", "unacknowledged") in stored_rows(connection, "alarms", ("condition", "state"))


@pytest.mark.parametrize(("seconds", "armed"), [(20.0, False), (None, True)])
async def test_armed_it_disarms_itself_once_nothing_has_been_on_record_for_the_stated_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seconds: float | None, armed: bool
) -> None:
    config = config_in(tmp_path, model=two_modes(), historian__disarm_after=seconds or False, **ARMED)
    bench = Bench(config, PacedClock(pause_s=0.01), armed=True)
    real = Historian._store

    def failing(self: Historian, *args: Any) -> None:
        if bench.reads > 5:
            raise sqlite3.OperationalError("disk I/O error")
        real(self, *args)

    monkeypatch.setattr(Historian, "_store", failing)
    status = await go(config, bench, 200)
    assert (status["writeback"]["mode"] == "armed") is armed
    reasons = [row["reason"] for row in logged(tmp_path) if row["event"] == "disarmed"]
    assert bool(reasons) is not armed
    if reasons:
        assert "nothing has been on record for 20 s" in reasons[0]
        assert bench.written[-1]["validity"] == 0
