"""`decanter run` never said why it had no readings when the port connected: slow, frozen, exception 2 each time."""

import asyncio
from pathlib import Path
from typing import Any

import pytest

from gateway.plant.app import run
from gateway.settings import load_config
from tests.drivers.scripted import Bend, ScriptedPlc, silent
from tests.gateway.support import logged, plant_file


async def late(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
    asyncio.get_running_loop().call_later(5.0, writer.write, honest)


@pytest.mark.parametrize(
    ("exception", "bend", "words"),
    [
        (2, None, ("holding:", "exception 2, illegal data address")),
        (0, silent, ("holding:", "no reply")),
        (0, late, ("holding:", "no reply")),
    ],
    ids=["exception 2", "frozen", "slow"],
)
async def test_the_reason_is_in_log_and_status_at_once_and_not_again(
    tmp_path: Path, exception: int, bend: Bend | None, words: tuple[str, ...]
) -> None:
    plc = ScriptedPlc(exception=exception, bend=bend)
    await plc.start()
    device = f'host = "127.0.0.1"\nport = {plc.port}\ntimeout = 0.05\nattempts = 1\n[scan]\nperiod = 0.05'
    config, stop = load_config(plant_file(tmp_path, device)), asyncio.Event()
    running = asyncio.create_task(run(config, stop=stop))
    said: list[dict[str, Any]] = []
    try:
        async with asyncio.timeout(60.0):
            while not said:
                await asyncio.sleep(0.05)
                if (tmp_path / "gateway.jsonl").exists():
                    said = [row for row in logged(tmp_path) if row["event"] == "no good reading"]
        await asyncio.sleep(0.5)
    finally:
        stop.set()
        status = await running
        await plc.stop()
    assert all(word in said[0]["reason"] for word in words)
    assert status["link"]["reason"] and status["links"][0]["reason"]
    reasons = [row["reason"] for row in logged(tmp_path) if row["event"] == "no good reading"]
    assert len(reasons) <= 6  # the refusal, the quarantine, the connection given up: not one in each scan
