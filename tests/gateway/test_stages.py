"""The stages of a scan one by one, each without the others, and what stays on record when one of them fails."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import Any, cast

import pytest

from drivers.supervision import Supervisor
from gateway.machine.alarms.board import AlarmBoard
from gateway.machine.alarms.conditions import acknowledge_words, make_conditions
from gateway.machine.followed import FollowedTemperature
from gateway.machine.model.guards import PAST
from gateway.machine.model.loading import load_model
from gateway.machine.model.predict import Predictor
from gateway.machine.model.unit import ModelUnit
from gateway.machine.pipeline import Machine
from gateway.machine.reading.link_health import LinkHealth
from gateway.machine.records import Keeper, Records
from gateway.machine.writing.block import Validity
from gateway.machine.writing.writeback_stage import WritebackStage, open_audit_trail
from gateway.plant.log import open_log
from gateway.plant.status import _forecast
from gateway.settings.config import Config
from gateway.store.historian import HistorianView
from tests.gateway.support import (
    CURRENT,
    EPOCH,
    RUNNING,
    TEMPERATURE,
    Bench,
    JumpClock,
    at_rest,
    config_in,
    logged,
    one_machine,
    scan_of,
    two_modes,
)

FORECAST = {"forecast__horizons": [10.0], "forecast__runs": 20}


@contextmanager
def stored(config: Config) -> Iterator[tuple[HistorianView, Any]]:
    """A historian and a log for one stage."""
    store, historian = one_machine(config.historian.path, config.map.tags)
    with open_log(config.log.path, "debug") as log:
        try:
            yield historian, log
        finally:
            store.close()


def rows(config: Config, query: str) -> list[tuple[Any, ...]]:
    with closing(sqlite3.connect(config.historian.path)) as connection:
        return connection.execute(query).fetchall()


def test_link_an_outage_goes_from_the_last_good_reading_to_the_first_good_one_again(tmp_path: Path) -> None:
    config = config_in(tmp_path)
    with open_log(config.log.path, "info") as log:
        link = LinkHealth(log)
        for second, value in enumerate((25.0, None, None, 26.0)):
            link.take(scan_of({TEMPERATURE: value}, EPOCH + second))
    (outage,) = link.outages
    assert link.alive and link.count == 1
    assert outage.plain(2.0) == {"last_good": EPOCH, "detected_s": 0.5, "recovered_s": 1.5}
    events = ["good readings arrive", "no good reading any more", "good readings arrive"]
    assert [line["event"] for line in logged(tmp_path)] == events


def test_alarms_the_threshold_needs_no_model_and_findings_come_after_it(tmp_path: Path) -> None:
    config = config_in(tmp_path, model=two_modes())
    with stored(config) as (historian, log):
        conditions = make_conditions(config, (TEMPERATURE,))
        board = AlarmBoard(
            conditions,
            watched=config.watched_temperatures,
            words=acknowledge_words(config),
            historian=historian,
            log=log,
            now=EPOCH,
        )
        board.take_readings(scan_of({TEMPERATURE: 85.0, "AcknowledgeBits": 0}, EPOCH))
        assert board.word("") == 1
        board.on_predictions(scan_of({TEMPERATURE: 85.0}, EPOCH), {"predicted over limit": 0.9, "inputs bad": 0.0})
        assert board.word("") == 3
        board.take_readings(scan_of({TEMPERATURE: 85.0, "AcknowledgeBits": 1}, EPOCH + 1))
        assert board.alarms[f"over limit {TEMPERATURE}"].state == "acknowledged" and board.word("") == 3
    stored_states = rows(config, "SELECT state FROM alarms ORDER BY id")
    assert [state for (state,) in stored_states] == ["unacknowledged", "unacknowledged", "acknowledged"]


def test_alarms_bits_that_could_not_be_read_are_no_edge(tmp_path: Path) -> None:
    config = config_in(tmp_path)
    with stored(config) as (historian, log):
        conditions = make_conditions(config, (TEMPERATURE,))
        board = AlarmBoard(
            conditions,
            watched=config.watched_temperatures,
            words=acknowledge_words(config),
            historian=historian,
            log=log,
            now=EPOCH,
        )
        for second, bits in enumerate((0, None, 1)):
            board.take_readings(scan_of({TEMPERATURE: 85.0, "AcknowledgeBits": bits}, EPOCH + second))
        assert board.alarms[f"over limit {TEMPERATURE}"].state == "unacknowledged"


async def test_model_follows_forecasts_and_finds_without_a_machine_around_it(tmp_path: Path) -> None:
    config = config_in(tmp_path, model=two_modes(), **FORECAST)
    loaded = load_model(config)
    assert loaded is not None
    with stored(config) as (historian, log):
        unit = ModelUnit(config, loaded, (), historian=historian, log=log)
        collected = []
        for second in range(3):
            scan = scan_of({RUNNING: True, CURRENT: 150.0, TEMPERATURE: 30.0}, EPOCH + second)
            assert not unit.adopt_promoted_model(scan.time)
            prediction = unit.follow(scan)
            collected.append(unit.settle(prediction))
            unit.foresee(scan, prediction)
            await unit.outlook.finish()
        forecast = unit.usable(prediction)
        assert prediction.location == "on" and prediction.known
        first, finished, third = collected
        assert first is None and third is None and finished is not None, "begun after the first scan, given once"
        assert forecast is finished.forecast and prediction.worst == 0
        assert unit.findings(prediction, None)["predicted over limit"] is None
        unit.begin_anew()
        assert unit.prediction is None and unit.outlook.latest is None
        await unit.close()


async def test_a_forecast_far_from_what_came_after_like_moments_is_flagged_and_a_restart_knows_them(
    tmp_path: Path,
) -> None:
    config = config_in(tmp_path, model=two_modes(), forecast__period=1.0, **FORECAST)
    loaded = load_model(config)
    assert loaded is not None
    # While this machine ran it was never warm, and at rest always.
    known = [["on", 0, 10.0, 20, 20, 10.0, 19.0], ["off", 0, 10.0, 20, 20, 30.0, 19.0]]
    with stored(config) as (historian, log):
        unit = ModelUnit(config, loaded, (), historian=historian, log=log)
        unit.guards.restore({PAST: known})
        flagged = []
        for second, on in enumerate((True, False, False, True, True)):
            scan = scan_of({RUNNING: on, CURRENT: 150.0 * on, TEMPERATURE: 30.0}, EPOCH + 2.0 * second)
            prediction = unit.follow(scan)
            unit.settle(prediction)
            unit.foresee(scan, prediction)
            await unit.outlook.finish()
            one = cast(FollowedTemperature, SimpleNamespace(model=unit, config=config))
            if (said := _forecast(one, scan, scan.time)) is not None:
                flagged.append([each and each.flagged for each in said.past])
        # Each is collected with the scan after it; of the first location nobody saw the beginning.
        assert flagged == [[None], [False], [False], [True]]
        told = [(each["moments"], each["flagged"]) for each in unit.guard_report()[PAST]]
        assert told == [(20, True)], "on record, too"
        unit.save(EPOCH + 200.0)
        kept = unit.guards.snapshot()[PAST]
        unit.settle(unit.follow(scan_of({CURRENT: 150.0, TEMPERATURE: 30.0}, EPOCH + 201.0)))
        assert unit.guard_report()[PAST] == [], "it began from what is not known any more"
        await unit.close()
    with stored(config) as (historian, log):
        again = ModelUnit(config, loaded, (), historian=historian, log=log)
        again.restore(EPOCH + 201.0)
        assert again.guards.snapshot()[PAST] == kept and len(kept) == 2


async def test_a_forecast_waits_for_half_a_period_at_most_where_scans_are_skipped(tmp_path: Path) -> None:
    config = config_in(tmp_path, model=two_modes(), forecast__period=2.0, **FORECAST)
    loaded = load_model(config)
    assert loaded is not None
    with stored(config) as (historian, log):
        unit, counts = ModelUnit(config, loaded, (), historian=historian, log=log), []

        async def follow(second: float, missed: int = 0, duration: float = 0.0) -> None:
            values = {RUNNING: True, CURRENT: 150.0, TEMPERATURE: 30.0}
            scan = replace(scan_of(values, EPOCH + second), missed=missed, duration=duration)
            prediction = unit.follow(scan)
            unit.settle(prediction)
            unit.foresee(scan, prediction)
            counts.append((unit.outlook.busy, unit.outlook.postponed))
            await unit.outlook.finish()

        await follow(0.0, missed=1)
        assert counts == [(True, 0)], "there is none yet that could be used meanwhile"
        for second in (1.0, 2.0, 2.9, 3.0):
            await follow(second, missed=1)
        assert counts[1:] == [(False, 0), (False, 1), (False, 1), (True, 1)]
        await follow(5.0, missed=1, duration=1.5)
        assert counts[-1] == (True, 1), "the device is slow, and not the box"
        await unit.close()


async def test_block_without_a_prediction_nothing_in_it_is_valid_but_the_alarms_are_there(tmp_path: Path) -> None:
    config = config_in(tmp_path, writeback__mode="shadow")
    layout, clock = config.map.writeback, JumpClock()
    assert layout is not None
    with stored(config) as (historian, log):
        bench = Bench(config, clock)
        trail = open_audit_trail(config, historian=historian, supervisor=Supervisor(), log=log)
        writing = WritebackStage(
            config,
            [layout],
            trail,
            clock=clock,
            driver=bench,
            historian=historian,
            of_blocks=[historian],
            supervisor=Supervisor(),
            log=log,
            rng=Random(0),
        )
        (stage,) = writing.blocks
        await stage.take(scan_of(at_rest(config), EPOCH), None, None, alarms=5)
        assert stage.attempt is not None and stage.attempt.verdict == "shadow"
        words = dict(zip((field.name for field in layout.fields), stage.attempt.block.words, strict=True))
        assert stage.attempt.block.validity is Validity.SHADOW and words["alarms"] == 5 and words["input_quality"] == 0
        assert trail.close(clock.now())
    assert rows(config, "SELECT verdict FROM writes") == [("shadow",)]


def test_records_of_a_scan_without_a_model_are_its_readings(tmp_path: Path) -> None:
    config = config_in(tmp_path)
    with stored(config) as (historian, _):
        records = Records(historian, Keeper(config.map.by_name, 5.0))
        records.take(scan_of({TEMPERATURE: 25.0}, EPOCH))
    assert rows(config, "SELECT time, value FROM samples") == [(EPOCH, 25.0)]
    assert rows(config, "SELECT count(*) FROM predictions") == [(0,)]


async def test_of_a_scan_in_which_the_model_fails_the_readings_and_the_threshold_alarm_are_on_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = config_in(tmp_path, model=two_modes())
    clock = JumpClock()

    def broken(*_: object) -> None:
        raise RuntimeError("a defect in the model")

    monkeypatch.setattr(Predictor, "step", broken)
    with open_log(config.log.path, "info") as log:
        machine = Machine(config, driver=Bench(config, clock), clock=clock, log=log, rng=Random(0))
        with pytest.raises(RuntimeError, match="a defect in the model"):
            await machine.take(scan_of({**at_rest(config), TEMPERATURE: 85.0}, EPOCH))
        assert machine.close()
    assert rows(config, "SELECT condition FROM alarms") == [(f"over limit {TEMPERATURE}",)]
    assert rows(config, "SELECT count(*) FROM scans") == [(1,)]
    assert (85.0,) in rows(config, "SELECT value FROM samples")
