"""`timeout = 0.5` gave each attempt 0.25 s, so that a PLC that answers in 320 ms was never read."""

import asyncio
import json
import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from drivers.modbus.driver import open_modbus
from drivers.tag import Quality, Tag
from gateway.commission.probe import propose_timeout
from tests.commission.bench import plc as commissioned
from tests.drivers.scripted import Bend, ScriptedPlc, read_reply, transaction_of

FIVE, SIX = Tag("five", "holding:5"), Tag("six", "holding:60")


def late(seconds: float) -> Bend:
    async def bend(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        asyncio.get_running_loop().call_later(seconds, writer.write, honest)

    return bend


@pytest.fixture
async def plc() -> AsyncIterator[ScriptedPlc]:
    plc = ScriptedPlc()
    await plc.start()
    yield plc
    await plc.stop()


async def read(plc: ScriptedPlc, *tags: Tag, **settings: float) -> list[tuple[object, Quality]]:
    settings = {"port": plc.port, **settings}
    driver = open_modbus({"host": "127.0.0.1", **settings}, clock=time.time)
    await driver.open()
    try:
        return [(sample.value, sample.quality) for sample in await driver.read(tags)]
    finally:
        await driver.close()


async def test_a_plc_that_answers_in_320_ms_is_read_with_a_timeout_of_half_a_second(plc: ScriptedPlc) -> None:
    plc.bend = late(0.32)
    assert await read(plc, FIVE, timeout=0.5) == [(5, Quality.GOOD)]
    assert len(plc.requests) == 1


async def test_a_late_reply_to_the_same_question_is_its_answer(plc: ScriptedPlc) -> None:
    plc.bend = late(0.32)
    assert await read(plc, FIVE, SIX, timeout=0.2, attempts=2) == [(5, Quality.GOOD), (60, Quality.GOOD)]


async def test_a_late_reply_with_another_number_of_registers_is_none(plc: ScriptedPlc) -> None:
    """The number of an earlier attempt alone does not make it the answer."""
    first: list[bytes] = []

    async def bend(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        first.append(request)
        if len(first) == 2:
            assert transaction_of(first[0]) != transaction_of(first[1])
            writer.write(read_reply(first[0], [7, 7]))

    plc.bend = bend
    ((value, quality),) = await read(plc, FIVE, timeout=0.1, attempts=2)
    assert value is None and quality.is_bad


async def test_the_answer_to_an_earlier_reading_is_not_todays(plc: ScriptedPlc) -> None:
    """What was asked a scan ago and comes now is old: it is dropped, and the value is asked for anew."""
    kept: list[bytes] = []

    async def bend(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        kept.append(honest)
        if len(kept) == 2:
            writer.write(kept[0] + kept[1])

    plc.bend = bend
    driver = open_modbus({"host": "127.0.0.1", "port": plc.port, "timeout": 0.1, "attempts": 1}, clock=time.time)
    await driver.open()
    try:
        assert (await driver.read([FIVE]))[0].quality is Quality.TIMEOUT
        plc.registers[5] = 99
        (sample,) = await driver.read([FIVE])
        assert (sample.value, sample.quality) == (99, Quality.GOOD)
    finally:
        await driver.close()


def test_probe_proposes_a_timeout_by_what_it_measured() -> None:
    assert propose_timeout(0.002) == (0.2, 2)
    assert propose_timeout(0.32) == (0.5, 2)
    assert propose_timeout(1.2) == (2.0, 1)
    assert propose_timeout(55.0) == (60.0, 1)


async def test_soak_names_the_timeout_and_not_the_period(plc: ScriptedPlc, tmp_path: Path) -> None:
    plc.bend = late(0.32)
    file = tmp_path / "slow.toml"
    file.write_text('[device]\nname = "slow"\ndriver = "modbus"\n[[tags]]\nname = "five"\naddress = "holding:5"\n')
    words = ["soak", "--device", file, "--host", "127.0.0.1", "--port", plc.port, "--set", "attempts=1", "--json"]
    words += ["--set", "timeout=0.2", "--seconds", 1.5, "--period", 0.1]
    result = await asyncio.to_thread(commissioned, tmp_path, *words)
    answer = json.loads(result.stdout.splitlines()[0])
    assert not answer["ok"] and answer["recommended_period_s"] is None
    assert "the timeout of 0.2 s: give a longer one" in result.output
