"""`disarm` while no gateway ran, and the next start armed itself from the older signature in the file."""

import os
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from gateway.cli.main import main
from gateway.machine.writing.arming import arm_in_log, disarm_in_log, next_start, sign_arming, uptime
from gateway.settings.config import Config, load_config
from gateway.store.audit import DISARMED, read
from tests.gateway.support import EPOCH, JumpClock, config_in, plant_file, two_modes
from tests.gateway.test_arming import bench_of, go

FILE = '[writeback]\nmode = "armed"\narmed_by = "Ada"\nreason = "run"\nminutes = 60\n'
NOBODY = 'host = "127.0.0.1"\nport = 9\n'


async def mode(config: Config, moment: float = EPOCH) -> str:
    bench = bench_of(config, JumpClock(moment))
    status = await go(config, bench, 10)
    assert bool(bench.written) == (status["writeback"]["mode"] == "armed")
    return str(status["writeback"]["mode"])


async def test_a_disarming_wins_over_a_file_that_no_gateway_has_used_yet(tmp_path: Path) -> None:
    config = config_in(tmp_path, FILE, model=two_modes())
    assert disarm_in_log(config.audit, "Bea", "not today", EPOCH, config.stamp) is None
    assert await mode(config) == "shadow" and await mode(config, EPOCH + 60.0) == "shadow"
    start = next_start(config, config.audit, EPOCH, uptime())
    assert "Bea disarmed it (not today)" in start.sentence and "save it anew" in start.sentence


async def test_the_file_saved_anew_is_the_newer_word_and_one_that_was_put_back_is_not(tmp_path: Path) -> None:
    config = config_in(tmp_path, FILE, model=two_modes())
    disarm_in_log(config.audit, "Bea", "not today", EPOCH, config.stamp)
    path = plant_file(tmp_path, FILE.replace("run", "another"), model=two_modes())
    os.utime(path, (config.stamp - 100.0, config.stamp - 100.0))
    assert await mode(load_config(path)) == "shadow", "an older file, whatever it says"
    os.utime(path, (config.stamp + 100.0, config.stamp + 100.0))
    assert await mode(load_config(path)) == "armed"


async def test_words_of_the_file_that_were_taken_out_arm_nobody_any_more(tmp_path: Path) -> None:
    config = config_in(tmp_path, FILE, model=two_modes())
    assert await mode(config) == "armed"
    shadow = load_config(plant_file(tmp_path, '[writeback]\nmode = "shadow"\n', model=two_modes()))
    assert await mode(shadow, EPOCH + 60.0) == "shadow"


async def test_an_arming_by_command_after_the_disarming_is_newer_than_both(tmp_path: Path) -> None:
    config = config_in(tmp_path, FILE, model=two_modes())
    disarm_in_log(config.audit, "Bea", "not today", EPOCH, config.stamp)
    arm_in_log(config.audit, sign_arming("Cai", "after all", 5, EPOCH + 1.0), EPOCH + 1.0)
    start = next_start(replace(config), config.audit, EPOCH + 2.0, uptime())
    assert start.arming is not None


@pytest.mark.parametrize("writeback", ["shadow", "armed"])
def test_the_command_writes_its_row_where_nothing_is_in_force_and_says_what_the_next_start_does(
    tmp_path: Path, writeback: str
) -> None:
    text = FILE if writeback == "armed" else '[writeback]\nmode = "shadow"\n'
    config = config_in(tmp_path, NOBODY + text)
    options = ["disarm", "--config", str(config.path), "--by", "Bea", "--reason", "not today"]
    done = CliRunner().invoke(main, options, env={"DECANTER_RECORDS": str(tmp_path / "records.jsonl")})
    assert done.exit_code == 0, done.output
    assert [row.entry.kind for row in read(config.audit)] == [DISARMED]
    assert "the next start of the gateway: not armed (Bea disarmed it (not today)" in done.output
