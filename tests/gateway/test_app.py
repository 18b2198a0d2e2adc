"""The running gateway on a device in memory: what it does when parts are missing, fail, come back or are stopped."""

import asyncio
import json
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivers.driver import BeforeSending
from drivers.errors import ReplyTimeout
from drivers.settings import ConfigError
from drivers.tag import Value
from gateway.machine.model.loading import load_models
from gateway.machine.model.predict import Predictor
from gateway.machine.reading.scan import Scan
from gateway.plant.app import run
from gateway.settings.config import Config
from gateway.store.historian import HistorianError, open_historian
from gateway.store.read_back import history, to_trace
from sim.sha.events import encode
from tests.gateway.support import (
    CURRENT,
    EPOCH,
    RUNNING,
    TEMPERATURE,
    Bench,
    JumpClock,
    PacedClock,
    at_rest,
    config_in,
    logged,
    two_modes,
)

ARMED = {
    "writeback__mode": "armed",
    "writeback__armed_by": "Ada",
    "writeback__reason": "test",
    "writeback__minutes": 60.0,
    "forecast__horizons": [10.0, 60.0],
    "forecast__runs": 50,
}


def heating(bench: Bench, first: int, last: int, start: float = 25.0) -> None:
    """Reads first..last-1 show a decanter that runs and warms as the model of the tests says."""
    temperature = start
    for read in range(first, last):
        temperature += (50.0 - temperature) * 0.00995
        bench.plan[read] = {RUNNING: True, CURRENT: 150.0, TEMPERATURE: temperature}


async def go(config: Config, bench: Bench, reads: int, **keys: Any) -> dict[str, Any]:
    bench.stop_after = reads
    return await asyncio.wait_for(run(config, clock=bench.clock, stop=bench.stop, driver=bench, **keys), 300.0)


def table(config: Config, query: str) -> list[tuple[Any, ...]]:
    with closing(sqlite3.connect(config.historian.path)) as connection:
        return connection.execute(query).fetchall()


async def test_armed_it_predicts_forecasts_writes_and_stores_side_by_side(tmp_path: Path) -> None:
    config = config_in(tmp_path, model=two_modes(), forecast__period=5.0, **ARMED)
    bench = Bench(config, PacedClock(pause_s=0.002), armed=True)
    heating(bench, 5, 200)
    status = await go(config, bench, 200, status_path=tmp_path / "status.json")
    blocks = bench.written
    assert status["writeback"]["written"] == len(blocks) > 190
    assert [b["sequence"] for b in blocks] == list(range(1, len(blocks) + 1))
    usable = [b for b in blocks if int(b["validity"]) & 1]
    assert len(usable) > 100 and all(b["validity"] == 31 for b in usable)
    assert blocks[-1]["validity"] == 0, "nothing stands valid after the stop"
    last = usable[-1]
    assert last["location"] == 2 and 2500 < int(last["temperature_now"]) < 5000
    assert int(last["horizon_low"]) <= int(last["horizon_median"]) <= int(last["horizon_high"])
    seen = history(config.historian.path)
    assert abs(seen.mean[-1] - seen.measured[-1]) < 0.5
    assert table(config, "SELECT count(*) FROM forecasts")[0][0] >= 10
    assert [row[0] for row in table(config, "SELECT verdict FROM writes")] == ["written"] * len(blocks)
    assert json.loads((tmp_path / "status.json").read_text())["phase"] == "stopped"


async def test_the_events_in_the_historian_are_those_of_its_trace_encoded_in_batch(tmp_path: Path) -> None:
    config = config_in(tmp_path, model=two_modes())
    bench = Bench(config, JumpClock())
    heating(bench, 5, 100)
    bench.plan[40] = {**bench.plan[40], "fault": "silent"}
    bench.plan[47] = {"fault": None}
    bench.plan[70] = {CURRENT: None}
    bench.plan[80] = {RUNNING: False, CURRENT: 0.0}
    await go(config, bench, 120)
    stored = table(config, "SELECT time, symbol FROM events ORDER BY id")
    again = encode(to_trace(config.historian.path), two_modes().alphabet)
    assert [(event.time, event.symbol) for event in again] == stored
    assert "unknown" in {symbol for _, symbol in stored}


async def test_without_a_model_it_monitors_and_the_threshold_alarm_works(tmp_path: Path) -> None:
    config = config_in(tmp_path, "[alarms]\noff_delay = 0", **ARMED)
    bench = Bench(config, JumpClock(), armed=True)
    for read in range(10, 30):
        bench.plan[read] = {TEMPERATURE: min(25.0 + 4.0 * (read - 9), 85.0)}
    bench.plan[50] = {"AcknowledgeBits": 1}
    for read in range(60, 70):
        bench.plan[read] = {TEMPERATURE: max(85.0 - 4.0 * (read - 59), 60.0)}
    await go(config, bench, 100)
    states = table(config, "SELECT state, acknowledged_by FROM alarms ORDER BY id")
    assert states == [("unacknowledged", ""), ("acknowledged", "PLC"), ("normal", "PLC")]
    assert {b["validity"] for b in bench.written} == {0}, "without a model nothing is to be used"
    standing = [int(b["alarms"]) & 1 for b in bench.written]
    assert standing.count(1) == pytest.approx(41, abs=3) and standing[-1] == 0


async def test_a_plc_that_is_away_at_the_start_and_lost_later_is_waited_for(tmp_path: Path) -> None:
    config = config_in(tmp_path, model=two_modes(), **ARMED)
    bench = Bench(config, JumpClock(), armed=True)
    bench.soft.fail("refuse")
    bench.plan[5] = {"fault": None}
    bench.plan[30] = {"fault": "silent"}
    bench.plan[50] = {"fault": None}
    status = await go(config, bench, 80)
    assert status["failures"] == 0
    (outage,) = status["link"]["outages"]
    # A first scan's heartbeat has moved at some time since: only the second one proves that the memory lives.
    assert outage["detected_s"] == pytest.approx(1.0) and outage["recovered_s"] == pytest.approx(22.0)
    events = [row["event"] for row in logged(tmp_path) if row["event"] != "audit head"]
    assert events[:3] == [
        "the model has no record of its anomaly scores: their alarm begins where it does without one",
        "armed",
        "the device does not answer yet; it is tried again all the time",
    ]
    bad = table(config, f"SELECT count(*) FROM alarms WHERE condition = 'inputs bad' AND time > {EPOCH + 29}")  # noqa: S608
    assert bad[0][0] == 2, "raised once and returned once"
    valid = [int(b["validity"]) & 2 for b in bench.written]
    assert len(valid) < 70 and valid[-2]


async def test_stale_readings_clear_the_validity_and_a_frozen_device_is_no_permit(tmp_path: Path) -> None:
    config = config_in(tmp_path, model=two_modes(), **ARMED)
    bench = Bench(config, JumpClock(), armed=True)
    heating(bench, 2, 60)

    async def freeze() -> None:
        while bench.reads < 30:
            await asyncio.sleep(0)
        bench.frozen = True

    freezing = asyncio.create_task(freeze())
    status = await go(config, bench, 60)
    await freezing
    assert status["writeback"]["not_permitted"] > 20
    assert len(bench.written) < 36, "only while the heartbeat was fresh"
    assert status["values"][TEMPERATURE]["quality"] == "DEVICE_FAILURE"
    assert status["values"][TEMPERATURE]["value"] is None


async def test_a_part_that_fails_is_logged_and_begun_anew_and_the_plc_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gateway.plant.fleet.RESTART_SECONDS", 0.0)
    whole, calls = Predictor.step, []

    def broken(self: Predictor, scan: Scan) -> Any:
        calls.append(scan)
        if len(calls) == 20:
            raise RuntimeError("a defect in the model")
        return whole(self, scan)

    monkeypatch.setattr(Predictor, "step", broken)
    config = config_in(tmp_path, model=two_modes(), **ARMED)
    bench = Bench(config, JumpClock(), armed=True)
    status = await go(config, bench, 60)
    assert status["failures"] == 1 and "a defect in the model" in status["last_failure"]
    (line,) = [row for row in logged(tmp_path) if row["level"] == "error"]
    assert "Traceback" in line["exception"]
    assert bench.written[19]["validity"] == 0
    assert len(bench.written) > 50 and status["scan"]["count"] > 55


async def test_arming_is_audited_and_its_time_is_not_begun_anew_by_a_restart(tmp_path: Path) -> None:
    config = config_in(tmp_path, model=two_modes(), **{**ARMED, "writeback__minutes": 1.0})
    clock = JumpClock()
    first = await go(config, Bench(config, clock, armed=True), 40)
    assert first["writeback"]["mode"] == "armed"
    bench = Bench(config, clock, armed=True)
    second = await go(config, bench, 40)
    assert second["writeback"]["mode"] == "shadow", "the minute was over half way through the second run"
    assert 15 < len(bench.written) < 25 and bench.written[-1]["validity"] == 0
    third = Bench(config, clock, armed=True)
    assert (await go(config, third, 10))["writeback"]["mode"] == "shadow"
    assert third.written == []
    audit = table(config, "SELECT what, who, reason FROM audit ORDER BY id")
    assert [what.split(" until")[0] for what, _, _ in audit] == [
        "armed",
        "validity 0: written",
        "armed",
        "validity 0: written",
        "arming is over, shadow",
    ]
    assert {who for _, who, _ in audit} == {"Ada"}
    renewed = replace(config, stamp=config.stamp + 1.0)
    fourth = Bench(config, clock, armed=True)
    assert (await go(renewed, fourth, 10))["writeback"]["mode"] == "armed"


async def test_off_by_default_it_never_writes(tmp_path: Path) -> None:
    config = config_in(tmp_path, model=two_modes())
    bench = Bench(config, JumpClock(), armed=True)
    status = await go(config, bench, 30)
    assert status["writeback"] == {"mode": "off"} and bench.written == []
    assert table(config, "SELECT count(*) FROM writes") == [(0,)]


async def test_shadow_stores_what_it_would_have_written(tmp_path: Path) -> None:
    config = config_in(tmp_path, model=two_modes(), writeback__mode="shadow")
    bench = Bench(config, JumpClock(), armed=True)
    await go(config, bench, 30)
    assert bench.written == []
    rows = table(config, "SELECT verdict, validity & 32, length(words) FROM writes")
    assert len(rows) >= 28 and set(rows) == {("shadow", 32, 52)}


async def test_a_restart_within_the_gap_goes_on_with_the_belief_and_the_alarms(tmp_path: Path) -> None:
    config = config_in(tmp_path, model=two_modes())
    clock = JumpClock()
    bench = Bench(config, clock)
    heating(bench, 2, 50)
    bench.plan[50] = {TEMPERATURE: None}
    before = await go(config, bench, 60)
    assert before["alarms"]["inputs bad"] == "unacknowledged"
    clock.time += 10.0
    again = Bench(config, clock)
    for name, value in at_rest(config).items():
        again.soft.put(name, value)
    again.plan[0] = {RUNNING: True, CURRENT: 150.0, TEMPERATURE: 35.0}
    after = await go(config, again, 12)
    assert after["events"] == 0, "nothing became unknown and nothing was announced again"
    assert after["prediction"]["location"] == "on"
    assert after["alarms"]["inputs bad"] == "returned unacknowledged"


async def test_a_saved_state_that_cannot_be_read_is_logged_and_not_used(tmp_path: Path) -> None:
    config = config_in(tmp_path, model=two_modes())
    clock = JumpClock()
    await go(config, Bench(config, clock), 20)
    with closing(sqlite3.connect(config.historian.path)) as connection, connection:
        connection.execute("UPDATE state SET content = '{\"model\": 3}' WHERE key = 'belief'")
        connection.execute("UPDATE state SET content = 'no json' WHERE key = 'bands'")
    status = await go(config, Bench(config, clock), 20)
    assert status["failures"] == 0
    assert any("cannot be read" in row["event"] for row in logged(tmp_path))


async def test_a_model_that_does_not_fit_the_plant_is_not_run_and_the_plant_is_watched(tmp_path: Path) -> None:
    wrong = replace(two_modes(), temperature="TCuscinettiAlimentazione")
    config = config_in(tmp_path, model=wrong)
    with pytest.raises(ConfigError, match=r"model\.temperature: is 'TCuscinettiRiduttore', and the model at"):
        load_models(config)
    status = await go(config, Bench(config, JumpClock()), 10)
    assert status["model"] is None and status["alarms"]["parts"] == "unacknowledged"
    assert "model.temperature: is 'TCuscinettiRiduttore'" in status["parts"]["model"]["failure"]


async def test_a_broken_model_file_is_one_sentence(tmp_path: Path) -> None:
    config = config_in(tmp_path, model=two_modes())
    (tmp_path / "model.json").write_text('{"format"')
    with pytest.raises(ConfigError) as caught:
        load_models(config)
    (problem,) = caught.value.problems
    assert "model.path" in problem and "model.json" in problem and "\n" not in problem
    bench = Bench(config, JumpClock())
    bench.plan[0] = {TEMPERATURE: 95.0}
    status = await go(config, bench, 10)
    assert status["model"] is None and status["parts"]["model"]["failure"] == problem
    assert {status["alarms"][name] for name in ("parts", f"over limit {TEMPERATURE}")} == {"unacknowledged"}


async def test_a_second_gateway_on_the_same_historian_does_not_start(tmp_path: Path) -> None:
    config = config_in(tmp_path)
    holder = open_historian(config.historian.path)
    with pytest.raises(HistorianError, match="another gateway"):
        await run(config, clock=JumpClock(), driver=Bench(config, JumpClock()))
    holder.close()


async def test_a_write_that_fails_does_not_stop_the_scan(tmp_path: Path) -> None:
    config = config_in(tmp_path, model=two_modes(), **ARMED)
    bench = Bench(config, JumpClock(), armed=True)

    async def failing(values: list[tuple[Any, Value]], *, before_sending: BeforeSending) -> None:
        before_sending()
        raise ReplyTimeout("no reply within 0.5 s")

    bench.write = failing  # type: ignore[method-assign]
    status = await go(config, bench, 30)
    assert status["scan"]["count"] >= 28 and status["writeback"]["failed"] >= 28
    assert [row["verdict"] for row in logged(tmp_path) if row["event"] == "write-back"] == ["failed"], "said once"
