"""The clock was set back, the gateway began anew, and an arming that was over wrote again."""

from dataclasses import replace
from pathlib import Path

import pytest

from gateway.machine.writing.arming import arm_in_log, next_start, sign_arming, uptime
from gateway.store.arming_rows import Uptime, armings, find_arming
from gateway.store.audit import ARMED, EXPIRED, AuditEntry, open_audit, read
from tests.gateway.support import EPOCH, JumpClock, config_in, two_modes
from tests.gateway.test_arming import SHADOW, bench_of, go

FILE = '[writeback]\nmode = "armed"\narmed_by = "Ada"\nreason = "run"\nminutes = 10\n'


@pytest.mark.parametrize("text", [SHADOW, FILE])
async def test_what_ran_out_stays_over_when_the_clock_is_set_back(tmp_path: Path, text: str) -> None:
    config = config_in(tmp_path, text, model=two_modes())
    if text is SHADOW:
        arm_in_log(config.audit, sign_arming("Ada", "run", 10, EPOCH), EPOCH)
    first = bench_of(config, JumpClock(EPOCH + 1.0))
    assert (await go(config, first, 20))["writeback"]["mode"] == "armed"
    late = bench_of(config, JumpClock(EPOCH + 595.0))
    assert (await go(config, late, 20))["writeback"]["mode"] == "shadow" and late.written[-1]["validity"] == 0
    assert [row.entry.kind for row in read(config.audit) if row.entry.kind == EXPIRED] == [EXPIRED]
    for moment in (EPOCH + 30.0, EPOCH + 400.0, EPOCH - 86_400.0, EPOCH + 616.0):
        back = bench_of(config, JumpClock(moment))
        assert (await go(config, back, 10))["writeback"]["mode"] == "shadow" and not back.written


async def test_one_that_ran_out_while_nothing_ran_is_put_on_record_by_the_next_start(tmp_path: Path) -> None:
    config = config_in(tmp_path, SHADOW, model=two_modes())
    arm_in_log(config.audit, sign_arming("Ada", "run", 10, EPOCH), EPOCH)
    assert not await written(config, EPOCH + 700.0)
    assert not await written(config, EPOCH + 60.0), "set back after it was seen to be over"


async def test_a_clock_before_the_newest_row_ends_an_arming_and_says_so(tmp_path: Path) -> None:
    config = config_in(tmp_path, SHADOW, model=two_modes())
    arm_in_log(config.audit, sign_arming("Ada", "run", 10, EPOCH), EPOCH)
    assert await written(config, EPOCH + 300.0)
    start = next_start(config, config.audit, EPOCH + 60.0, uptime())
    assert start.arming is None and "before the newest record" in start.sentence
    assert find_arming(config.audit, EPOCH + 60.0) is None, "the commands that write see it the same way"
    assert not await written(config, EPOCH + 60.0)
    assert not await written(config, EPOCH + 350.0), "and it is over for good"


async def written(config: object, moment: float) -> bool:
    bench = bench_of(config, JumpClock(moment))  # type: ignore[arg-type]
    await go(config, bench, 10)  # type: ignore[arg-type]
    return bool(bench.written)


def test_between_restarts_the_machines_own_count_bounds_what_is_left(tmp_path: Path) -> None:
    config = config_in(tmp_path, SHADOW)
    arm_in_log(config.audit, sign_arming("Ada", "run", 480, EPOCH), EPOCH)
    row = next(armings(config.audit))
    begun = Uptime(row.entry.detail["boot"], row.entry.detail["uptime"])
    assert begun.boot, "this machine says which of its starts this is"
    # Six hours and forty minutes have passed; the clock was set back to a minute after the arming.
    later = replace(begun, seconds=begun.seconds + 400 * 60.0)
    start = next_start(config, config.audit, EPOCH + 60.0, later)
    assert start.arming is not None and start.arming.until == pytest.approx(EPOCH + 60.0 + 80 * 60.0)
    over = replace(begun, seconds=begun.seconds + 481 * 60.0)
    assert next_start(config, config.audit, EPOCH + 60.0, over).arming is None
    assert find_arming(config.audit, EPOCH + 60.0, over) is None
    # After a start of the machine only the records and its clock are left.
    anew = Uptime("another", 5.0)
    whole = next_start(config, config.audit, EPOCH + 60.0, anew)
    assert whole.arming is not None and whole.arming.until == EPOCH + 480 * 60.0


def test_a_clock_that_was_ahead_when_somebody_armed_lengthens_nothing_when_it_is_put_right(tmp_path: Path) -> None:
    config = config_in(tmp_path, SHADOW)
    ahead = EPOCH + 200 * 86_400.0
    arm_in_log(config.audit, sign_arming("Ada", "run", 480, ahead), ahead)
    assert find_arming(config.audit, ahead + 1.0) is not None
    assert find_arming(config.audit, EPOCH + 1.0) is None
    assert next_start(config, config.audit, EPOCH + 1.0, uptime()).arming is None
    # And whoever arms by the right clock is armed, whatever stands in the log from before.
    arm_in_log(config.audit, sign_arming("Bea", "run", 5, EPOCH), EPOCH)
    found = find_arming(config.audit, EPOCH + 1.0)
    assert found is not None and found.entry.who == "Bea"


def test_one_in_the_file_is_used_once_whatever_became_of_the_historian(tmp_path: Path) -> None:
    config = config_in(tmp_path, FILE)
    first = next_start(config, config.audit, EPOCH, uptime())
    assert first.arming is not None and first.file is not None
    audit = open_audit(config.audit)
    detail = {"until": first.arming.until, "via": "gateway began", "file": first.file}
    assert audit.record(AuditEntry(EPOCH, ARMED, "Ada", "run", detail))
    assert audit.record(AuditEntry(first.arming.until, EXPIRED, "Ada", "over")) and audit.close()
    assert next_start(config, config.audit, EPOCH + 60.0, uptime()).arming is None
    anew = replace(config, stamp=config.stamp + 1.0)
    assert next_start(anew, config.audit, EPOCH + 60.0, uptime()).arming is not None, "saved anew it is another word"
