"""A clock 200 days ahead at boot erased all measurements after an hour; one that was set back overwrote rows."""

import asyncio
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from gateway.machine.trust import ClockCheck
from gateway.plant.app import run
from gateway.settings.config import Config
from gateway.store.read_back import recent, to_trace
from tests.gateway.support import EPOCH, TEMPERATURE, Bench, JumpClock, PacedClock, config_in, one_machine

DAY = 86_400.0


@pytest.fixture(autouse=True)
def often(monkeypatch: pytest.MonkeyPatch) -> None:
    """Batches, and what follows them, come often enough for a run of half a second."""
    monkeypatch.setattr("gateway.store.historian.BATCH_SECONDS", 0.02)


async def hours(config: Config, start: float, reads: int = 130) -> dict[str, Any]:
    """The status after scans of a minute each from `start`: more than the hour after which is deleted."""
    bench = Bench(config, PacedClock(start, pause_s=0.002), stop_after=reads)
    return await asyncio.wait_for(run(config, clock=bench.clock, stop=bench.stop, driver=bench), 300.0)


def scans(config: Config) -> list[float]:
    with closing(sqlite3.connect(config.historian.path)) as connection:
        return [row[0] for row in connection.execute("SELECT time FROM scans ORDER BY rowid")]


@pytest.mark.parametrize("days", [20.0, 200.0])
async def test_nothing_is_deleted_by_a_clock_that_is_ahead_at_boot_nor_at_the_next_one(
    tmp_path: Path, days: float
) -> None:
    config = config_in(tmp_path, scan__period=60.0, historian__retention_days=10.0)
    await hours(config, EPOCH)
    before = scans(config)
    for boot in range(2):
        status = await hours(config, EPOCH + days * DAY + boot * DAY)
        assert status["alarms"]["clock"] == "unacknowledged" and not status["clock"]["believed"]
        assert set(before) < set(scans(config))
    again = await hours(config, EPOCH + DAY)
    assert again["alarms"]["clock"] in ("normal", "returned unacknowledged"), "the clock was put right"
    assert set(before) < set(scans(config))


async def test_what_is_old_under_a_clock_that_agrees_is_deleted(tmp_path: Path) -> None:
    config = config_in(tmp_path, scan__period=60.0, historian__retention_days=10.0)
    for day in (0.0, 6.0, 12.0):
        status = await hours(config, EPOCH + day * DAY)
        assert status["alarms"]["clock"] == "normal"
    assert min(scans(config)) >= EPOCH + 6.0 * DAY - 60.0


async def test_the_plcs_own_clock_settles_how_long_the_gateway_was_off(tmp_path: Path) -> None:
    check = ClockCheck(EPOCH + 200 * DAY, EPOCH, 7 * DAY)
    now = EPOCH + 200 * DAY + 60.0
    assert check.complaint(now, offset=0.0, plc=None)
    assert check.complaint(now, offset=0.0, plc=now - 30.0) == ""
    assert "ahead of the PLC's clock" in check.complaint(now, offset=0.0, plc=EPOCH)
    assert "while the gateway ran" in check.complaint(now, offset=-200 * DAY, plc=now)


async def test_a_clock_set_back_neither_overwrites_nor_hides_rows_and_the_alarm_stands(tmp_path: Path) -> None:
    config = config_in(tmp_path)
    first = Bench(config, JumpClock(EPOCH + 10 * DAY), stop_after=100)
    await asyncio.wait_for(run(config, clock=first.clock, stop=first.stop, driver=first), 300.0)
    for boot in range(2):  # the second one begins at the very same moment: its rows bear times that are there already
        bench = Bench(config, JumpClock(EPOCH), stop_after=100)
        bench.soft.put(TEMPERATURE, 30.0 + boot)
        status = await asyncio.wait_for(run(config, clock=bench.clock, stop=bench.stop, driver=bench), 300.0)
        assert status["alarms"]["clock"] == "unacknowledged"
    times = scans(config)
    assert len(times) >= 3 * 98 and len(set(times)) <= 2 * 100
    newest = recent(config.historian.path, "1h")
    assert newest.times[-1] < EPOCH + DAY, "what is recent is what came last"
    values = to_trace(config.historian.path).signals[TEMPERATURE]
    assert {25.0, 31.0} <= set(values.tolist())


def test_rows_of_a_clock_that_had_lost_its_time_are_not_old(tmp_path: Path) -> None:
    """1970 at boot, put right at the next one: what was measured an hour ago is not 50 years old."""
    path = tmp_path / "h.sqlite"
    store, historian = one_machine(path, ())
    historian.put("scans", [(EPOCH + n, 0.0, 0) for n in range(4000)])
    historian.put("scans", [(float(n), 0.0, 0) for n in range(4000)])
    historian.put("scans", [(EPOCH + 5000.0 + n, 0.0, 0) for n in range(100)])
    assert historian.flush(60.0)
    store.delete_older(EPOCH + 100.0)
    assert historian.flush(60.0) and historian.flush(60.0)
    assert store.close()
    assert to_trace(path).times.size >= 8000 - 100 + 100
