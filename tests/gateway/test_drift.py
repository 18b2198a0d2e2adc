"""Drift: the free run judged cycle by cycle, the alarm with its bit and its offer, and what outlives a restart."""

import asyncio
import json
from dataclasses import asdict, replace
from itertools import pairwise
from pathlib import Path
from random import Random

import numpy as np
import pytest

from gateway.machine.alarms.conditions import make_conditions
from gateway.machine.alarms.states import AlarmState, new_alarm, step
from gateway.machine.model.drift import MIN_CYCLE_READINGS, CycleDrift, follow_cycle, make_drift_rule
from gateway.machine.model.predict import Predictor, ScanPrediction
from gateway.machine.pipeline import Machine
from gateway.plant.app import run
from gateway.plant.log import open_log
from gateway.settings.config import load_config
from sim.sha.model import Model
from sim.sha.trace import UNKNOWN, Event
from tests.gateway.support import (
    CURRENT,
    EPOCH,
    RUNNING,
    TEMPERATURE,
    Bench,
    PacedClock,
    config_in,
    logged,
    plant_file,
    two_modes,
)

CYCLE, SCANS = 1000.0, 100


def prediction(time: float, error: float, *, events: tuple[str, ...] = (), sigma: float = 1.0) -> ScanPrediction:
    """A scan whose free run is `error` degC below the reading, in a model that gives it `sigma`."""
    return ScanPrediction(
        time, "on", 2, True, True, 0, 0.0, 40.0 + error, 40.0, 39.0, 41.0, 40.0, 0.0, "green",
        tuple(Event(time, symbol) for symbol in events), False, sigma,
    )  # fmt: skip


def after(
    errors: list[float], model: Model | None = None, limit: float | None = None, *, scans: int = SCANS
) -> CycleDrift:
    """What is known after a cycle of each of these errors, and the start of the next one."""
    rule, drift = make_drift_rule(model or two_modes(), limit), CycleDrift()
    assert rule is not None
    for number, error in enumerate([*errors, 0.0]):
        begin = EPOCH + number * CYCLE
        drift = follow_cycle(rule, drift, prediction(begin, 0.0, events=("W_ON",)))
        for scan in range(1, scans if number < len(errors) else 1):
            drift = follow_cycle(rule, drift, prediction(begin + scan, error))
        if number < len(errors):
            drift = follow_cycle(rule, drift, prediction(begin + CYCLE - 1, error, events=("W_OFF",)))
    return drift


def test_cycles_are_counted_while_they_are_beyond_the_models_own_band() -> None:
    assert after([0.5, 1.5]).running == 0
    assert after([0.5, 2.0, -2.0, 2.0]).running == 3
    assert after([2.0, 2.0, 2.0, 0.5]).running == 0
    last = after([2.0])
    assert last.error == pytest.approx(2.0, abs=0.02) and last.limit == pytest.approx(1.645, abs=0.001)


def test_a_wide_band_in_one_place_hides_no_error_in_another() -> None:
    rule, drift = make_drift_rule(two_modes(), None), CycleDrift()
    assert rule is not None
    for cycle in range(4):
        begin = EPOCH + cycle * CYCLE
        drift = follow_cycle(rule, drift, prediction(begin, 0.0, events=("W_ON",)))
        for scan in range(1, SCANS):
            drift = follow_cycle(rule, drift, prediction(begin + scan, 3.0))
        drift = follow_cycle(rule, drift, prediction(begin + SCANS, 1.0, events=("W_OFF",), sigma=30.0))
        for scan in range(1, SCANS):  # a long rest of which the model has seen next to nothing
            drift = follow_cycle(rule, drift, prediction(begin + SCANS + scan, 1.0, sigma=30.0))
    assert drift.running == 3
    assert drift.limit is not None and drift.error is not None
    # What is allowed is said of where the errors are, not of the rest.
    assert drift.limit == pytest.approx(1.645, rel=0.1) and drift.error > drift.limit


def test_a_cycle_without_any_error_or_without_a_band_says_so() -> None:
    assert (after([0.0]).error, after([0.0]).limit, after([0.0]).running) == (0.0, None, 0)
    rule, drift = make_drift_rule(two_modes(), None), replace(CycleDrift(), begun=EPOCH)
    assert rule is not None
    assert follow_cycle(rule, drift, prediction(EPOCH + 1, 2.0, sigma=0.0)) == drift


def test_a_configured_limit_takes_the_place_of_the_band() -> None:
    assert after([0.5, 0.5, 0.5], limit=0.4).running == 3
    assert after([5.0, 5.0, 5.0], limit=6.0).running == 0


def test_the_calibration_widens_the_band_and_never_narrows_it() -> None:
    wide = replace(two_modes(), calibration={10.0: 2.0, 60.0: 3.0})
    assert after([4.0], wide).running == 0
    narrow = replace(two_modes(), calibration={10.0: 0.2})
    assert after([1.5], narrow).running == 0


def test_the_part_before_the_first_start_and_a_cycle_of_a_few_readings_do_not_count() -> None:
    rule = make_drift_rule(two_modes(), None)
    assert rule is not None
    drift = CycleDrift()
    for scan in range(SCANS):
        drift = follow_cycle(rule, drift, prediction(EPOCH + scan, 9.0))
    assert (
        drift.readings == 0 and follow_cycle(rule, drift, prediction(EPOCH + 200, 0.0, events=("W_ON",))).running == 0
    )
    assert after([2.0, 2.0], scans=MIN_CYCLE_READINGS - 2).running == 0


def test_not_knowing_for_a_while_ends_no_cycle() -> None:
    rule, drift = make_drift_rule(two_modes(), None), CycleDrift()
    assert rule is not None
    drift = follow_cycle(rule, drift, prediction(EPOCH, 0.0, events=("W_ON",)))
    for scan in range(1, 50):
        drift = follow_cycle(rule, drift, prediction(EPOCH + scan, 2.0))
    drift = follow_cycle(rule, drift, prediction(EPOCH + 60, 2.0, events=(UNKNOWN, "W_ON")))
    assert drift.begun == EPOCH and drift.error is None and drift.readings == 51


def test_a_reading_without_a_free_run_is_left_out() -> None:
    rule, drift = make_drift_rule(two_modes(), None), replace(CycleDrift(), begun=EPOCH)
    assert rule is not None
    for lacking in (
        replace(prediction(EPOCH + 1, 2.0), free_run=None),
        replace(prediction(EPOCH + 1, 2.0), measured=None),
        replace(prediction(EPOCH + 1, 2.0), known=False),
        replace(prediction(EPOCH + 1, 2.0), free_sigma=None),
    ):
        assert follow_cycle(rule, drift, lacking) == drift


def test_what_is_known_comes_back_from_json() -> None:
    drift = after([2.0, 2.0])
    assert CycleDrift(**json.loads(json.dumps(asdict(drift)))) == drift


def test_the_alarm_has_bit_3_stands_from_the_third_cycle_on_and_names_the_command(tmp_path: Path) -> None:
    config = load_config(plant_file(tmp_path, model=two_modes()))
    condition = make_conditions(config, (TEMPERATURE,))["drift"]
    assert condition.bit == 3
    alarm, states = new_alarm(condition, EPOCH), []
    for number, cycles in enumerate((0.0, 1.0, 2.0, 3.0, 4.0, 0.0)):
        alarm = step(condition, alarm, cycles, EPOCH + number)
        states.append(alarm.active)
    assert states == [False, False, False, True, True, False] and alarm.state is AlarmState.RETURNED
    words = condition.response
    assert "decanter diagnose --model" in words and f"--historian {config.historian.path}" in words
    assert "--since 14d" in words


def test_the_number_of_cycles_is_configured(tmp_path: Path) -> None:
    config = load_config(plant_file(tmp_path, "[alarms]\ndrift = 1.5\ndrift_cycles = 5\n", model=two_modes()))
    assert make_conditions(config, (TEMPERATURE,))["drift"].limit == 4.5 and config.alarms.drift == 1.5


def test_the_predictor_says_how_sure_its_free_run_is_and_is_less_so_with_time() -> None:
    from drivers.tag import Quality, Sample
    from gateway.machine.reading.scan import Scan

    predictor, sigmas = Predictor(two_modes(), TEMPERATURE), []
    for scan in range(200):
        now = EPOCH + scan
        values = {"MarciaDecanter": 1.0, "Assorbimento": 150.0, TEMPERATURE: 30.0 + 0.02 * scan}
        samples = {name: Sample(name, value, Quality.GOOD, now, now) for name, value in values.items()}
        made = predictor.step(Scan(scan, now, samples, 0, 0.0))
        assert (made.free_sigma is None) == (made.free_run is None)
        sigmas += [] if made.free_sigma is None else [made.free_sigma]
    assert len(sigmas) > 190 and np.all(np.diff(sigmas) > -1e-12) and sigmas[-1] > 2 * sigmas[0]


async def test_a_running_gateway_raises_the_alarm_on_the_third_cycle_and_its_log_offers_a_diagnosis(
    tmp_path: Path,
) -> None:
    armed = {"mode": "armed", "armed_by": "Ada", "reason": "test", "minutes": 60.0}
    keys = {f"writeback__{name}": value for name, value in armed.items()}
    # It cools by 7 degC in a second, as no bearing does: its sensor would be found jumping, and not be believed.
    config = config_in(tmp_path, model=two_modes(), forecast__runs=50, alarms__sensors=False, **keys)
    bench = Bench(config, PacedClock(pause_s=0.002), armed=True)
    for read in range(3, 290):  # 60 s on and 20 s off again and again, and it warms twice as fast as the model
        on, age = (read - 3) % 80 < 60, (read - 3) % 80
        reading = 25.0 + 1.0 * min(age, 60) * np.exp(-max(age - 60, 0) / 8.0)
        bench.plan[read] = {RUNNING: bool(on), CURRENT: 150.0 if on else 0.0, TEMPERATURE: float(reading)}
    bench.stop_after = 290
    status = await asyncio.wait_for(run(config, clock=bench.clock, stop=bench.stop, driver=bench), 300.0)
    assert status["guards"]["drift"]["cycles"] == status["guards"]["drift"]["alarm_cycles"] == 3
    assert status["guards"]["drift"]["error"] > status["guards"]["drift"]["limit"]
    assert status["alarms"]["drift"] == "unacknowledged"
    standing = [int(block["alarms"]) >> 3 & 1 for block in bench.written]
    assert standing[230] == 0 and standing[-2] == 1 and sum(a != b for a, b in pairwise(standing)) == 1
    (offer,) = [row for row in logged(tmp_path) if row["event"] == "alarm" and row["condition"] == "drift"]
    assert "decanter diagnose --model" in offer["response"]
    with open_log(None, "error") as log:
        again = Machine(config, driver=bench, clock=bench.clock, log=log, rng=Random(0))
        assert again.model is not None and again.model.guards.drift.running == 3, "the count outlives a restart"
        again.close()
