"""A folder that takes no audit log, or no log, kept the whole gateway from starting, threshold alarm included."""

import asyncio
import json
from pathlib import Path
from random import Random
from typing import Any

import pytest

from gateway.machine.pipeline import Machine
from gateway.machine.writing.arming import ArmingError
from gateway.plant.app import run
from gateway.plant.log import open_log
from gateway.settings.config import Config
from gateway.store.audit import verify
from tests.gateway.support import TEMPERATURE, Bench, PacedClock, config_in, two_modes

ARMED = {
    "writeback__mode": "armed",
    "writeback__armed_by": "Ada",
    "writeback__reason": "test",
    "writeback__minutes": 60.0,
}
SHADOW = {"writeback__mode": "shadow"}


@pytest.fixture
def refusing(tmp_path: Path) -> Path:
    """A folder in which nothing can be made, whoever asks: it is a file."""
    (tmp_path / "folder").write_text("no folder", encoding="utf-8")
    return tmp_path / "folder"


async def go(config: Config, bench: Bench, reads: int) -> dict[str, Any]:
    bench.stop_after = reads
    return await asyncio.wait_for(run(config, clock=bench.clock, stop=bench.stop, driver=bench), 300.0)


def where(refusing: Path, what: str) -> dict[str, Any]:
    return {"audit": {"writeback__audit": str(refusing / "a.sqlite")}, "log": {"log__path": str(refusing / "l")}}[what]


@pytest.mark.parametrize("what", ["audit", "log"])
@pytest.mark.parametrize("mode", [SHADOW, ARMED], ids=["shadow", "armed"])
async def test_it_starts_with_the_alarms_and_is_not_armed(
    tmp_path: Path, refusing: Path, mode: dict[str, Any], what: str
) -> None:
    config = config_in(tmp_path, model=two_modes(), **mode, **where(refusing, what))
    bench = Bench(config, PacedClock(pause_s=0.005), armed=True)
    bench.plan[3] = {TEMPERATURE: 85.0}
    status = await go(config, bench, 20)
    assert status["scan"]["count"] > 15 and status["writeback"]["mode"] == "shadow" and bench.written == []
    assert status["alarms"]["records"] == "unacknowledged"
    assert status["alarms"][f"over limit {TEMPERATURE}"] == "unacknowledged"


async def test_once_the_folder_takes_it_the_audit_log_is_made_and_what_waited_is_in_it(
    tmp_path: Path, refusing: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gateway.store.audit._RETRY_SECONDS", 0.01)
    config = config_in(tmp_path, model=two_modes(), **SHADOW, **where(refusing, "audit"))
    bench = Bench(config, PacedClock(pause_s=0.005), armed=True)
    with open_log(tmp_path / "log.jsonl") as log:
        machine = Machine(config, driver=bench, clock=bench.clock, log=log, rng=Random(1))
    try:
        assert machine.writing is not None and "cannot be made" in machine.writing.audit.complaint
        with pytest.raises(ArmingError):
            await machine.arm("Ada", "test", 10.0)
        assert await machine.disarm("Bea", "to be sure") is False
        refusing.unlink()
        async with asyncio.timeout(60.0):
            while machine.writing.audit.complaint:
                await asyncio.sleep(0.01)
        assert (await machine.arm("Ada", "test", 10.0)).by == "Ada" and machine.writing.armed
    finally:
        assert machine.close()
    assert not verify(config.audit).problem


async def test_a_log_that_can_be_written_again_is(
    tmp_path: Path, refusing: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gateway.plant.log_file.RETRY_SECONDS", 0.0)
    config = config_in(tmp_path, **SHADOW, alarms__off_delay=0.0, **where(refusing, "log"))
    bench = Bench(config, PacedClock(pause_s=0.005))
    bench.plan[10] = {TEMPERATURE: 25.0}
    opened = bench.open

    async def mended() -> None:
        await opened()
        refusing.unlink()

    monkeypatch.setattr(bench, "open", mended)
    status = await go(config, bench, 20)
    assert status["alarms"]["records"] in ("normal", "returned unacknowledged")
    assert config.log.path is not None
    lines = [json.loads(line) for line in config.log.path.read_text(encoding="utf-8").splitlines()]
    assert lines[-1]["event"] == "stopped"
