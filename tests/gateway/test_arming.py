"""Arming: signed, limited, kept before it counts, taken back at once; every write and refusal is accounted for."""

import asyncio
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.tag import Value
from gateway.machine.writing.arming import ArmingError, arm_in_log, disarm_in_log, sign_arming
from gateway.machine.writing.block import Validity
from gateway.machine.writing.writeback import Arming, Pace, Writer
from gateway.outside.status import connect
from gateway.plant.app import run
from gateway.settings.config import Config, load_config
from gateway.store.arming_rows import find_arming
from gateway.store.audit import ARMED, CONFIRMED, DISARMED, EXPIRED, AuditEntry, open_audit, read, verify
from tests.gateway.support import EPOCH, Bench, JumpClock, PacedClock, config_in, plant_file, scan_of, two_modes
from tests.gateway.test_writeback import CLOCK, USABLE, Wire, armed, scan

SHADOW = '[writeback]\nmode = "shadow"\n'


@pytest.mark.parametrize(
    ("by", "reason", "minutes", "words"),
    [
        ("", "x", 5, "needs a name"),
        ("  ", "x", 5, "needs a name"),
        ("Ada", "", 5, "needs a reason"),
        ("Ada", "two\nlines", 5, "must be one line"),
        ("A" * 201, "x", 5, "at most 200"),
        ("Ada", "x", 0, "more than 0"),
        ("Ada", "x", -1, "more than 0"),
        ("Ada", "x", 480.1, "at most 480"),
        ("Ada", "x", float("nan"), "at most 480"),
        ("Ada", "x", float("inf"), "at most 480"),
    ],
)
def test_an_arming_without_a_name_a_reason_or_an_end_is_refused(
    by: str, reason: str, minutes: float, words: str
) -> None:
    with pytest.raises(ArmingError, match=words):
        sign_arming(by, reason, minutes, 0.0)
    assert sign_arming(" Ada ", "loop test", 5, 100.0) == Arming("Ada", "loop test", 400.0)


def test_what_is_armed_without_a_gateway_stands_in_the_log_and_can_be_taken_back(tmp_path: Path) -> None:
    path = tmp_path / "audit.sqlite"
    assert disarm_in_log(path, "Bea", "nothing there", 1.0) is None
    arm_in_log(path, sign_arming("Ada", "loop test", 5, 100.0), 100.0)
    assert find_arming(path, 399.0) is not None
    assert disarm_in_log(path, "Bea", "enough", 200.0) is not None
    assert find_arming(path, 201.0) is None and disarm_in_log(path, "Bea", "again", 202.0) is None
    kinds = [row.entry.kind for row in read(path)]
    assert kinds == [DISARMED, ARMED, CONFIRMED, DISARMED, DISARMED], "each word is on record"


# ---------------------------------------------------------------- the writer


async def accounted(tmp_path: Path, **keys: Any) -> tuple[Writer, Wire]:
    writer, wire = await armed()
    writer.audit = open_audit(tmp_path / "audit.sqlite")
    for name, value in keys.items():
        setattr(writer, name, value)
    return writer, wire


def kinds(writer: Writer) -> list[str]:
    assert writer.audit is not None and writer.audit.close()
    return [row.entry.kind for row in read(writer.audit.path)]


async def test_every_block_every_failure_and_every_refusal_is_in_the_audit_log(tmp_path: Path) -> None:
    writer, wire = await accounted(tmp_path)
    await writer.offer(scan(), {"temperature_now": 45.0}, USABLE)
    wire.soft.fail("silent")
    await writer.offer(scan(), {}, USABLE)
    wire.soft.fail(None)
    await writer.offer(scan(permit=False), {}, USABLE)
    writer.take_counts(scan(BlocksAccepted=1, BlocksRefused=0, LastRefusal=0), {3: "CRC"})
    writer.take_counts(scan(BlocksAccepted=1, BlocksRefused=2, LastRefusal=3), {3: "CRC"})
    await writer.withdraw(scan())
    await writer.disarm(CLOCK.now(), "Bea", "enough")
    await writer.offer(scan(), {}, USABLE)
    assert kinds(writer) == ["write", "write", "write failed", "write refused", "refused by the PLC", "write", DISARMED]
    assert writer.audit is not None
    rows = read(writer.audit.path)
    assert [row.entry.who for row in rows] == ["Ada"] * 4 + ["PLC", "Ada", "Bea"]
    assert rows[0].entry.detail["words"] == "".join(f"{word:04x}" for word in wire.blocks[0])
    assert rows[4].entry.detail["blocks"] == 2 and rows[4].entry.reason == "CRC"
    assert verify(writer.audit.path).problem == ""


async def test_what_cannot_be_accounted_for_is_not_written(tmp_path: Path) -> None:
    writer, wire = await accounted(tmp_path)
    assert writer.audit is not None
    writer.audit.failure = "the disk is full"
    attempt = await writer.offer(scan(), {}, USABLE)
    assert attempt is not None and attempt.verdict == "not permitted" and "no audit record" in attempt.reason
    assert wire.blocks == []
    assert writer.audit.close()


async def test_an_arming_that_is_over_writes_nothing_even_if_nobody_looked_at_the_clock(tmp_path: Path) -> None:
    writer, wire = await accounted(tmp_path, arming=Arming("Ada", "test", EPOCH))
    attempt = await writer.offer(scan(), {}, USABLE)
    assert attempt is not None and (attempt.verdict, attempt.reason) == ("not permitted", "the arming is over")
    assert wire.blocks == []
    await writer.withdraw(scan())
    assert [block[3] for block in wire.blocks] == [0], "but the block that takes everything back"
    await writer.disarm(CLOCK.now())
    assert kinds(writer)[-1] == EXPIRED


async def test_more_blocks_a_second_than_allowed_are_held_back_and_the_last_word_never_is(tmp_path: Path) -> None:
    clock = JumpClock()
    writer, wire = await accounted(tmp_path, pace=Pace(5.0), clock=clock)
    verdicts = []
    for _ in range(40):
        attempt = await writer.offer(scan_of({"WritePermit": True, "Challenge": 77}, clock.now()), {}, USABLE)
        assert attempt is not None
        verdicts.append(attempt.verdict)
        clock.time += 0.05
    written = verdicts.count("written")
    assert 5 + 9 <= written <= 5 + 10 and verdicts.count("held back") == 40 - written == writer.counters.held_back
    assert verdicts[:5] == ["written"] * 5
    for _ in range(3):
        await writer.offer(scan_of({"WritePermit": True, "Challenge": 77}, clock.now()), {}, USABLE)
    last = await writer.withdraw(scan())
    assert last is not None and last.verdict == "written" and last.block.validity is Validity.NONE
    assert len(wire.blocks) == written + 1
    assert writer.audit is not None and writer.audit.close()


@pytest.mark.parametrize(("rate", "sent"), [(0.125, 6), (0.25, 11), (0.5, 21), (1.0, 41)])
def test_a_block_every_few_seconds_is_a_pace_too(rate: float, sent: int) -> None:
    """In 40 seconds one at once, and the others as they fall due."""
    pace = Pace(rate)
    allowed = [moment for moment in np.arange(0.0, 40.125, 0.125) if pace.allows(moment)]
    assert len(allowed) == sent
    assert set(np.diff(allowed)) == {1.0 / rate}


def test_the_pace_counts_real_seconds_and_follows_the_scans(tmp_path: Path) -> None:
    config = config_in(tmp_path)
    assert config.blocks_per_second == 10.0, "ten at least"
    assert replace(config, scan=config.scan.model_copy(update={"period": 0.05})).blocks_per_second == 40.0
    given = config_in(tmp_path, "[writeback]\nmost_per_second = 2.5\n")
    assert given.blocks_per_second == 2.5
    assert config.audit == tmp_path / "audit.sqlite"


# ---------------------------------------------------------------- the gateway


async def go(config: Config, bench: Bench, scans: int, meanwhile: Any = None) -> dict[str, Any]:
    bench.stop_after = bench.reads + scans
    bench.stop = asyncio.Event()
    task = asyncio.create_task(run(config, clock=bench.clock, stop=bench.stop, driver=bench))
    if meanwhile is not None:
        await meanwhile(bench)
    return await task


def bench_of(config: Config, clock: JumpClock | None = None) -> Bench:
    return Bench(config, clock or JumpClock(), armed=True)


async def asked(config: Config, command: str, **keys: Any) -> dict[str, Any]:
    def ask() -> dict[str, Any]:
        line = connect(config.control_socket, 120.0)
        assert line is not None
        try:
            return line.ask(command, **keys)
        finally:
            line.close()

    return await asyncio.to_thread(ask)


async def until(true: Callable[[], bool]) -> None:
    async with asyncio.timeout(120.0):
        while not true():
            await asyncio.sleep(0.002)


async def test_a_gateway_in_shadow_is_armed_and_disarmed_over_its_socket(tmp_path: Path) -> None:
    config = config_in(tmp_path, SHADOW, model=two_modes())
    bench = bench_of(config, PacedClock())

    async def meanwhile(bench: Bench) -> None:
        await until(lambda: bench.reads > 5)
        assert bench.written == []
        with pytest.raises(ValueError, match="needs a name"):
            await asked(config, "arm", by="", reason="loop", minutes=60)
        told = await asked(config, "arm", by="Ada", reason="loop", minutes=60)
        assert told["until"] > EPOCH
        await until(lambda: len(bench.written) > 5)
        assert (await asked(config, "disarm", by="Bea", reason="enough"))["was_armed"]
        count = len(bench.written)
        assert bench.written[-1]["validity"] == 0
        seen = bench.reads
        await until(lambda: bench.reads > seen + 10)
        assert len(bench.written) == count
        assert not (await asked(config, "disarm", by="Bea", reason="again"))["was_armed"]
        bench.stop.set()

    status = await go(config, bench, 1_000_000, meanwhile)
    assert status["writeback"]["mode"] == "shadow"
    found = [row.entry for row in read(config.audit)]
    assert [(entry.kind, entry.who) for entry in found if entry.kind in (ARMED, DISARMED)] == [
        (ARMED, "Ada"),
        (DISARMED, "Bea"),
        (DISARMED, "Bea"),
    ]
    # A block that was on record and then stopped on its way to the wire, as the disarming came, has a second row.
    stopped = {entry.detail["sequence"] for entry in found if entry.kind == "write refused"}
    sent = [entry for entry in found if entry.kind == "write" and entry.detail["sequence"] not in stopped]
    assert len(sent) == len(bench.written)
    assert verify(config.audit).problem == ""


async def test_a_gateway_that_starts_finds_the_commands_arming_and_a_restart_goes_on_with_it(tmp_path: Path) -> None:
    config = config_in(tmp_path, SHADOW, model=two_modes())
    arm_in_log(config.audit, sign_arming("Ada", "walk", 60, EPOCH), EPOCH)
    first = bench_of(config)
    first.clock.time += 1.0
    status = await go(config, first, 30)
    assert status["writeback"]["armed_by"] == "Ada" and first.written
    second = bench_of(config, JumpClock(first.clock.time + 1.0))
    assert (await go(config, second, 30))["writeback"]["armed_until"] == status["writeback"]["armed_until"]
    late = bench_of(config, JumpClock(EPOCH + 3601.0))
    assert (await go(config, late, 30))["writeback"]["mode"] == "shadow" and not late.written


async def test_a_mode_that_was_off_in_between_does_not_bring_an_arming_back(tmp_path: Path) -> None:
    config = config_in(tmp_path, SHADOW, model=two_modes())
    arm_in_log(config.audit, sign_arming("Ada", "walk", 60, EPOCH), EPOCH)
    first = bench_of(config)
    first.clock.time += 1.0
    assert (await go(config, first, 30))["writeback"]["armed_by"] == "Ada"
    off = config_in(tmp_path, model=two_modes())
    assert (await go(off, bench_of(off, first.clock), 5))["writeback"]["mode"] == "off"
    again = bench_of(config, first.clock)
    assert (await go(config, again, 30))["writeback"]["mode"] == "shadow" and not again.written
    last = [row.entry for row in read(config.audit)][-1]
    assert (last.kind, last.who, last.reason) == (EXPIRED, "Ada", "writeback.mode was set to 'off'")
    arm_in_log(config.audit, sign_arming("Ada", "walk", 60, first.clock.now()), first.clock.now())
    signed_anew = bench_of(config, first.clock)
    assert (await go(config, signed_anew, 30))["writeback"]["mode"] == "armed" and signed_anew.written


async def test_a_reload_that_sets_the_mode_off_ends_the_arming(tmp_path: Path) -> None:
    config = config_in(tmp_path, SHADOW, model=two_modes())
    modes = []

    async def meanwhile(bench: Bench) -> None:
        await until(lambda: bench.reads > 5)
        await asked(config, "arm", by="Ada", reason="loop", minutes=60)
        await until(lambda: len(bench.written) > 5)
        for text in ("", SHADOW):
            plant_file(tmp_path, text, model=two_modes())
            assert (await asked(config, "reload"))["applied"]
            modes.append((await asked(config, "status"))["status"]["writeback"]["mode"])
        assert bench.written[-1]["validity"] == 0
        bench.stop.set()

    await go(config, bench_of(config, PacedClock()), 1_000_000, meanwhile)
    assert modes == ["off", "shadow"]
    assert [row.entry.kind for row in read(config.audit) if row.entry.kind in (ARMED, EXPIRED)] == [ARMED, EXPIRED]


async def test_what_was_disarmed_by_hand_stays_so_over_a_restart_until_it_is_signed_anew(tmp_path: Path) -> None:
    text = '[writeback]\nmode = "armed"\narmed_by = "Ada"\nreason = "run"\nminutes = 60\n'
    config = config_in(tmp_path, text, model=two_modes())
    first = bench_of(config)
    assert (await go(config, first, 30))["writeback"]["mode"] == "armed" and first.written
    log = open_audit(config.audit)
    assert log.record(AuditEntry(first.clock.now(), DISARMED, "Bea", "enough"))
    log.close()
    second = bench_of(config, first.clock)
    assert (await go(config, second, 30))["writeback"]["mode"] == "shadow" and not second.written
    anew = load_config(plant_file(tmp_path, text.replace("run", "run again"), model=two_modes()))
    third = bench_of(anew, first.clock)
    assert (await go(anew, third, 30))["writeback"]["mode"] == "armed" and third.written


@pytest.mark.parametrize("fault", [{"TCuscinettiRiduttore": None}, {"Assorbimento": None}, {"fault": "silent"}])
async def test_a_bad_or_stale_input_clears_validity(tmp_path: Path, fault: dict[str, Value | None]) -> None:
    config = config_in(tmp_path, SHADOW, model=two_modes(), forecast__runs=20)
    arm_in_log(config.audit, sign_arming("Ada", "x", 60, EPOCH), EPOCH)
    bench = bench_of(config, PacedClock())
    bench.plan = {0: {"MarciaDecanter": True, "Assorbimento": 150.0}, 60: fault, 61: {"fault": None}}
    status = await go(config, bench, 64)
    usable = [bool(block["validity"] & 1) for block in bench.written]  # type: ignore[operator]
    assert any(usable[:60]) and not all(usable[58:]), (usable, status["writeback"])


async def test_an_input_out_of_the_models_distribution_clears_validity_and_the_zone_says_red(tmp_path: Path) -> None:
    config = config_in(tmp_path, SHADOW, model=two_modes(), forecast__runs=20)
    arm_in_log(config.audit, sign_arming("Ada", "x", 60, EPOCH), EPOCH)
    bench = bench_of(config, PacedClock())
    bench.plan = {0: {"MarciaDecanter": False}} | {
        number: {"TCuscinettiRiduttore": 25.0 + (number % 2) * 4.0} for number in range(80, 130)
    }
    await go(config, bench, 130)
    red = [block for block in bench.written if block["zone"] == 3]
    assert red and not any(int(block["validity"]) & 1 for block in red)
    assert any(int(block["validity"]) & 1 for block in bench.written), "and before it was usable"
    assert all(int(block["validity"]) & 2 for block in red[:3]), "the inputs themselves are good"
