"""Two bearings were measured and the device took two blocks, and what was shipped, made and shown predicted one."""

import json
from pathlib import Path

import pytest

from gateway.demo.prepare import predictable_tags
from gateway.settings import load_config
from sim.plc.record.recording import BlockRow, PlcRecording
from sim.plc.record.verdict import counts
from tests.cli.support import decanter, only_object, refused
from tests.cli.test_demo_parts import made
from tests.gateway.support import MAP, ROOT

GEARBOX, FEED = "TCuscinettiRiduttore", "TCuscinettiAlimentazione"
BOTH = (GEARBOX, FEED)
DEVICE = ("--device", "decanter_plc", "--host", "192.0.2.1")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def rows(path: Path) -> list[tuple[str, str | None]]:
    config = load_config(path)
    return [(row.tag, None if row.model is None else row.model.name) for row in config.temperatures]


def test_the_shipped_plant_file_predicts_both_each_with_a_block_of_its_own() -> None:
    config = load_config(ROOT / "config/plant.toml")
    assert tuple(row.tag for row in config.temperatures) == BOTH and config.watched_temperatures == BOTH
    assert [one.block_layout.place for one in config.temperature_configs if one.block_layout] == [0, 1]


def test_init_offers_every_temperature_that_the_device_takes_blocks_of(here: Path) -> None:
    data = only_object(decanter("init", "p", *DEVICE, "--json").stdout)
    assert tuple(data["temperatures"]) == BOTH and data["temperature"] == GEARBOX
    config = load_config(here / "p/plant.toml")
    assert [row[0] for row in rows(config.path)] == list(BOTH) and config.alarms.tags == BOTH
    # One that is named is alone, in the short form of before; several that are named are those, in their order.
    assert decanter("init", "q", *DEVICE, "--temperature", FEED).exit_code == 0
    assert (
        rows(here / "q/plant.toml") == [(FEED, None)] and "[[temperature]]" not in (here / "q/plant.toml").read_text()
    )
    twice = [word for tag in (FEED, "TFango", FEED) for word in ("--temperature", tag)]
    assert decanter("init", "r", *DEVICE, *twice).exit_code == 0
    assert [row[0] for row in rows(here / "r/plant.toml")] == [FEED, "TFango"]
    refused(decanter("init", "s", *DEVICE, "--temperature", GEARBOX, "--temperature", "TT9"), 2, "TT9", "is no number")


def test_a_model_is_bound_to_each_temperature_and_a_second_makes_tables_of_the_short_form(here: Path) -> None:
    (here / "a.json").write_text("{}", encoding="utf-8")
    (here / "b.json").write_text("{}", encoding="utf-8")
    assert decanter("init", *DEVICE, "--temperature", GEARBOX).exit_code == 0
    keep = ("plc", "bind", "--keep")
    assert decanter(*keep, "model.path=a.json").exit_code == 0
    assert rows(Path("plant.toml")) == [(GEARBOX, "a.json")]
    assert decanter(*keep, f"temperature.{FEED}.model=b.json").exit_code == 0
    assert rows(Path("plant.toml")) == [(GEARBOX, "a.json"), (FEED, "b.json")]
    assert decanter(*keep, f"temperature.{FEED}.limit=75.0").exit_code == 0
    assert load_config(Path("plant.toml")).find_limit(FEED) == 75.0
    refused(
        decanter(*keep, "model.path=b.json"), 2, "model.path: stands beside [[temperature]]", "temperature.TAG.model"
    )
    refused(decanter(*keep, "temperature.limit=75"), 2, "--keep temperature.limit", "temperature.TAG.key")
    refused(decanter(*keep, "temperature.TT9.limit=75"), 2, "'TT9' is not a tag")
    assert len(rows(Path("plant.toml"))) == 2
    said = decanter("plc", "check", "--offline").output
    assert said.count("a.json") and said.count("b.json"), said


def test_the_demonstration_predicts_what_is_measured_and_has_a_block() -> None:
    assert predictable_tags(MAP, made(9, **{GEARBOX: 20.0, FEED: 20.0, "TFango": 9.0}), GEARBOX) == BOTH
    assert predictable_tags(MAP, made(9, **{GEARBOX: 20.0, FEED: 20.0}), FEED) == (FEED, GEARBOX)
    assert predictable_tags(MAP, made(9, **{GEARBOX: 20.0}), GEARBOX) == (GEARBOX,)
    assert predictable_tags(MAP, made(9, **{GEARBOX: 20.0, FEED: float("nan")}), GEARBOX) == (GEARBOX,)


def test_the_plc_s_account_is_of_each_block() -> None:
    def row(block: str, accepted: bool) -> BlockRow:
        return BlockRow(0.0, 0.0, "a", 400, (), None, "none", accepted, block)

    blocks = (row("", True), row("", True), row("Alimentazione", True), row("Alimentazione", False))
    account = counts(PlcRecording((), (), (), blocks, (), missing=0, damaged=0))
    assert (account["blocks_accepted"], account["blocks_refused"]) == (3, 1)
    assert account["blocks"] == {
        "": {"accepted": 2, "refused": 0},
        "Alimentazione": {"accepted": 1, "refused": 1},
    }
    assert json.loads(json.dumps(account)) == account
