"""The model in place of a bad sensor: it says so everywhere, is never taken for a reading, and stops."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest

from drivers.tag import Quality, Sample
from gateway.machine.alarms import Change
from gateway.machine.model.predict import Predictor
from gateway.machine.pipeline import Machine
from gateway.machine.writing.block import Validity
from gateway.outside.northbound.sparkplug import GOOD, STALE, row_metrics
from gateway.outside.status import findings
from gateway.outside.status.changes import topics
from gateway.outside.texts import all_words
from gateway.outside.web.views import machine_view
from gateway.plant.log import open_log
from gateway.plant.status import snapshot
from gateway.settings.config import Config
from gateway.store import FollowedRow, RowStream
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
    scan_of,
    two_modes,
)
from tests.gateway.test_twin_bearing import TWIN, taught

SETTINGS = '[writeback]\nmode = "shadow"\n[forecast]\nhorizons = [10.0]\nruns = 20\n'


class Plant:
    """A machine that warms from 25 to 50 degC as its model says, scan by scan, with noise on both sensors."""

    def __init__(self, machine: Machine, clock: JumpClock, begin: int = 0) -> None:
        self.machine, self.clock = machine, clock
        self.rng, self.seconds, self.truth = np.random.default_rng(5), begin, 25.0

    async def run(self, seconds: int, reading: float | str | None = "", **others: Any) -> None:
        """Scans one second apart; `reading` is what the sensor shows instead of the truth, None that it has failed."""
        for _ in range(seconds):
            self.seconds += 1
            self.clock.time = EPOCH + self.seconds
            self.truth += (50.0 - self.truth) * (1.0 - np.exp(-0.01))
            noise = 0.05 * self.rng.standard_normal(2)
            values = at_rest(self.machine.config) | {RUNNING: True, CURRENT: 150.0, TWIN: self.truth + 1.0 + noise[1]}
            values |= {"PlcHeartbeat": self.seconds, TEMPERATURE: self.truth + noise[0] if reading == "" else reading}
            scan = scan_of(values | others, self.clock.time)
            if reading is None:
                bad = Sample(TEMPERATURE, None, Quality.SENSOR_FAILURE, self.clock.time, reason="open circuit")
                scan = replace(scan, samples={**scan.samples, TEMPERATURE: bad})
            await self.machine.take(scan)

    @property
    def prediction(self) -> Any:
        return self.machine.followed[0].prediction

    @property
    def validity(self) -> Validity:
        block = self.machine.followed[0].block
        assert block is not None and block.attempt is not None
        return block.attempt.block.validity

    def state(self, name: str) -> str:
        return self.machine.alarms.alarms[name].state.value

    def row(self, language: str = "en") -> dict[str, Any]:
        labels = {TEMPERATURE: "gearbox bearing"}
        row: dict[str, Any] = machine_view(all_words()[language], labels, snapshot(self.machine))["temperatures"][0]
        return row


@asynccontextmanager
async def plant_in(config: Config, begin: int = 0) -> AsyncIterator[Plant]:
    clock = JumpClock(EPOCH + begin)
    with open_log(config.log.path, config.log.level) as log:
        machine = Machine(config, driver=Bench(config, clock), clock=clock, log=log, rng=Random(0))
        try:
            yield Plant(machine, clock, begin)
            await machine.finish()
        finally:
            machine.close()


async def test_a_sensor_that_fails_is_stood_for_by_the_model_with_a_growing_band_that_is_no_reading(
    tmp_path: Path,
) -> None:
    async with plant_in(config_in(tmp_path, SETTINGS, model=two_modes())) as plant:
        await plant.run(60)
        assert plant.prediction.virtual is None and plant.validity & Validity.INPUTS
        await plant.run(3, None)
        assert plant.prediction.virtual is None, "a reading that is late is no bad sensor"
        await plant.run(60, None)
        first = plant.prediction
        await plant.run(120, None)
        later = plant.prediction
        assert later.measured is None and later.virtual.since == EPOCH + 60
        assert later.high - later.low > first.high - first.low > 0.0
        assert later.low < plant.truth < later.high
        assert not plant.validity & (Validity.INPUTS | Validity.USABLE | Validity.FORECAST)
        row = plant.row()
        assert row["value"] is None and row["level"] == "attention" and row["valid"] == "doubtful"
        assert row["sentence"].startswith("decanter: gearbox bearing: sensor bad; by the model ")
        assert row["sentence"].endswith("for 3 min"), row["sentence"]
        for language, words in (
            ("it", "sensore guasto; secondo il modello"),
            ("de", "Sensor gestört; nach dem Modell"),
        ):
            assert words in plant.row(language)["sentence"]
        (finding,) = (each for each in findings(snapshot(plant.machine)) if each.check == "sensors")
        assert "sensor bad (open circuit); by the model" in finding.sentence
        assert dict(topics(snapshot(plant.machine)))[f"sensor {TEMPERATURE}"].sentence == f"sensor: {finding.sentence}"
        await plant.run(1)
        assert plant.prediction.virtual is None and plant.validity & Validity.INPUTS
        assert plant.row()["value"] is not None
    lines = [line for line in logged(tmp_path) if line["event"] == "the model in place of a bad sensor"]
    assert [line["what"] for line in lines] == ["begins", "ends"]


async def test_the_threshold_alarm_is_neither_raised_nor_cleared_by_the_model(tmp_path: Path) -> None:
    text = SETTINGS + "[alarms]\nlimit = 40.0\noff_delay = 0.0\n"
    over = f"over limit {TEMPERATURE}"
    async with plant_in(config_in(tmp_path, text, model=two_modes())) as plant:
        await plant.run(30)
        assert plant.truth < 38.0
        await plant.run(170, None)
        assert plant.prediction.low > 40.0 and plant.state(over) == "normal"
        await plant.run(2)
        assert plant.state(over) == "unacknowledged", "the reading is back, and says so itself"
        await plant.run(200, None, **{RUNNING: False})
        await plant.run(400, None, **{RUNNING: False})
        assert plant.prediction.high < 40.0 and plant.state(over) == "unacknowledged"


@pytest.mark.parametrize(("key", "stopped"), [("minutes = 1.0", "too long"), ("width = 0.3", "too wide")])
async def test_it_stops_by_time_and_by_width_and_does_not_come_back_by_itself(
    tmp_path: Path, key: str, stopped: str
) -> None:
    async with plant_in(config_in(tmp_path, f"{SETTINGS}[virtual_sensor]\n{key}\n", model=two_modes())) as plant:
        await plant.run(30)
        await plant.run(300, None)
        p = plant.prediction
        assert (p.virtual.stopped, p.mean, p.low, p.high) == (stopped, None, None, None)
        assert plant.row()["level"] == "unknown" and "not known by the model either" in plant.row()["sentence"]
        plant.machine.save(plant.clock.time)
        await plant.run(1)
        assert plant.prediction.virtual is None and plant.prediction.mean is not None


async def test_a_state_that_was_not_known_meanwhile_cannot_be_made_up_for(tmp_path: Path) -> None:
    async with plant_in(config_in(tmp_path, SETTINGS, model=two_modes())) as plant:
        await plant.run(30)
        await plant.run(30, None)
        await plant.run(2, None, **{RUNNING: None})
        assert plant.prediction.virtual is None and not plant.prediction.known, "it is not the sensor alone"
        await plant.run(5, None)
        assert plant.prediction.known and plant.prediction.virtual.stopped == "state not known"
        assert plant.prediction.mean is None


async def test_a_frozen_sensor_is_taken_from_the_model_back_to_when_it_froze(tmp_path: Path) -> None:
    text = f'{SETTINGS}[alarms]\ntags = ["{TEMPERATURE}", "{TWIN}"]\n'
    async with plant_in(config_in(tmp_path, text, model=two_modes())) as plant:
        await plant.run(60)
        stuck = plant.truth
        await plant.run(100, stuck)
        misled = plant.prediction.mean
        assert abs(misled - stuck) < 1.0 and plant.prediction.virtual is None, "nobody can know it yet"
        await plant.run(40, stuck)
        p = plant.prediction
        assert plant.state(f"sensor frozen {TEMPERATURE}") == "unacknowledged"
        assert p.measured is None and p.virtual.reason == "sensor frozen" and p.virtual.since <= EPOCH + 61
        assert p.low < plant.truth < p.high and abs(p.mean - plant.truth) < 2.0 < abs(stuck - plant.truth)
        assert not plant.validity & Validity.USABLE
        assert plant.row()["value"] is None and "sensor bad; by the model" in plant.row()["sentence"]
        sample = snapshot(plant.machine).values[TEMPERATURE]
        assert sample.value == pytest.approx(stuck), "what it shows stays on record as it is"


async def test_a_jumping_sensor_is_not_believed_unless_a_person_has_its_alarm_out_of_service(tmp_path: Path) -> None:
    text = f'{SETTINGS}[alarms]\ntags = ["{TEMPERATURE}", "{TWIN}"]\n'
    name = f"sensor jumping {TEMPERATURE}"
    async with plant_in(config_in(tmp_path, text, model=two_modes())) as plant:
        await plant.run(60)
        await plant.run(1, 70.0)
        assert plant.prediction.virtual is None, "one step is no fault yet"
        await plant.run(3)
        p = plant.prediction
        assert plant.state(name) == "unacknowledged" and p.virtual.reason == "sensor jumping"
        assert EPOCH + 30 < p.virtual.since <= EPOCH + 60
        assert abs(p.mean - plant.truth) < 0.5, "the 70 degC are forgotten"
        await plant.machine.desk.change(Change.REMOVE, [name], by="A. Rossi", reason="the cable is being moved")
        await plant.run(1)
        assert plant.prediction.virtual is None and plant.prediction.measured is not None


async def test_a_restart_neither_prolongs_it_nor_has_it_begin_again(tmp_path: Path) -> None:
    config = config_in(tmp_path, SETTINGS, model=two_modes())
    async with plant_in(config) as plant:
        await plant.run(30)
        await plant.run(20, None)
    async with plant_in(config, 50) as again:
        await again.run(2, None)
        assert again.prediction.virtual.since == EPOCH + 30
        await again.run(1, None, **{RUNNING: None})
        await again.run(2, None)
        assert again.prediction.virtual.stopped == "state not known"
    async with plant_in(config, 55) as third:
        await third.run(1, None)
        assert third.prediction.virtual.stopped == "state not known"


async def test_a_sensor_that_froze_before_a_restart_is_found_after_it_back_to_when_it_froze(tmp_path: Path) -> None:
    text = f'{SETTINGS}[alarms]\ntags = ["{TEMPERATURE}", "{TWIN}"]\n'
    config = config_in(tmp_path, text, model=two_modes())
    async with plant_in(config) as plant:
        await plant.run(60)
        stuck = plant.truth
        await plant.run(80, stuck)
        reached = plant.truth
    async with plant_in(config, 142) as again:
        again.truth = reached
        await again.run(55, stuck)
        p = again.prediction
        assert again.state(f"sensor frozen {TEMPERATURE}") == "unacknowledged"
        assert p.virtual.reason == "sensor frozen" and p.virtual.since <= EPOCH + 61
        assert abs(p.mean - again.truth) < 2.0 < abs(stuck - again.truth)


async def test_a_twin_that_is_measured_narrows_the_band_and_is_named(tmp_path: Path) -> None:
    text = f'{SETTINGS}[alarms]\ntags = ["{TEMPERATURE}", "{TWIN}"]\n'
    widths = []
    for name, teacher in (("alone", None), ("helped", taught(slope=1.0, apart=0.0003))):
        (folder := tmp_path / name).mkdir()
        async with plant_in(config_in(folder, text, model=two_modes())) as plant:
            model = plant.machine.followed[0].model
            assert model is not None and model.twin is not None
            if teacher is not None:
                model.twin.restore(teacher.to_plain())
            await plant.run(70)
            await plant.run(300, None)
            p = plant.prediction
            assert abs(p.mean - plant.truth) < 0.3
            widths.append(p.high - p.low)
            assert p.virtual.twin == ("" if teacher is None else TWIN)
            (finding,) = (each for each in findings(snapshot(plant.machine)) if each.check == "sensors")
            assert (f"by the model and {TWIN} " in finding.sentence) == (teacher is not None)
            assert ("the bearing beside it" in plant.row()["sentence"]) == (teacher is not None)
            # Without the twin's reading it is the model alone again.
            await plant.run(1, None, **{TWIN: None})
            assert plant.prediction.virtual.twin == ""
    assert widths[1] < 0.7 * widths[0]


def test_northbound_a_prediction_without_its_sensor_is_uncertain() -> None:
    values = dict.fromkeys(("mean", "low", "high", "free_run", "anomaly"), 1.0) | {"location": "on", "known": 1}
    for measured, zone, quality in ((1.0, "green", GOOD), (None, "green", GOOD), (None, "none", STALE)):
        stream = RowStream("decanter", TEMPERATURE, "predictions", 0)
        own = values | {"measured": measured, "zone": zone}
        row = FollowedRow(stream=stream, key=1, time=EPOCH, values=own, position=None)
        mean = next(row_metrics(row, {}))
        assert (mean.name, mean.quality) == (f"Predicted/{TEMPERATURE}/mean", quality)


def test_without_the_wrong_readings_the_belief_is_that_of_a_model_that_never_had_them() -> None:
    fooled, never = (Predictor(two_modes(), TEMPERATURE) for _ in range(2))
    for second in range(400):
        values: dict[str, Any] = {RUNNING: second < 200, CURRENT: 150.0, TEMPERATURE: 25.0 + 0.05 * second}
        fooled.step(scan_of(values, EPOCH + second))
        never.step(scan_of(values | ({TEMPERATURE: None} if second >= 90 else {}), EPOCH + second))
    assert fooled.forget_readings(EPOCH + 91)
    ours, theirs = fooled.belief, never.belief
    assert ours is not None and theirs is not None
    assert (ours.location, ours.time, ours.read_at) == (theirs.location, theirs.time, EPOCH + 90)
    assert ours.x == pytest.approx(theirs.x, abs=0.2) and ours.xx == pytest.approx(theirs.xx, rel=0.05)
    assert not Predictor(two_modes(), TEMPERATURE).forget_readings(EPOCH), "it has believed nothing yet"
