"""A logger's real frames through the whole chain: the log's values to the last row, and the gateway on the log."""

import asyncio
import csv
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from drivers.driver import open_driver, open_recording
from drivers.tag import Quality, Sample
from gateway.plant.app import run
from gateway.settings.config import load_config
from gateway.settings.devices import load_device
from sim.artefacts.model_json import model_text
from sim.lab.learning.bins.learn import learn_bins
from sim.lab.recordings.column_map import load_map
from sim.lab.recordings.traces import load_traces
from sim.sha.events import Alphabet, encode
from sim.sha.trace import Trace
from tests.gateway.support import JumpClock
from tests.rig.no_bands import without_bands

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / "shared" / "data" / "can_obd2"
TRIP, DECODED = DATA / "tripA164_7E8.candump.log", DATA / "tripA164_decoded_long.csv"
TRUCK = DATA / "j1939_186s_allframes.candump.log"
LEARNED_SECONDS, PERIOD = 1200.0, 1.0

pytestmark = [
    pytest.mark.real_data,
    pytest.mark.skipif(not DATA.is_dir(), reason="the measured data (../shared/data) is not here"),
]

# What the loggers' own decoding calls each tag of config/devices/obd2.toml.
NAMES = {
    "EngineSpeed": "ENGINE_RPM", "EngineLoad": "ENGINE_LOAD", "EngineTorque": "ACTUAL_TORQUE_PCT",
    "VehicleSpeed": "VEHICLE_SPEED", "ManifoldPressure": "INTAKE_MAP", "CoolantTemperature": "COOLANT_TEMP",
    "Throttle": "THROTTLE", "BarometricPressure": "BARO", "ModuleVoltage": "CTRL_MODULE_VOLT",
    "FuelLevel": "FUEL_LEVEL",
}  # fmt: skip


def samples_of(log: Path, device: str) -> tuple[list[Sample], dict[str, int]]:
    content = load_device(ROOT / "config" / "devices" / f"{device}.toml")
    recorded = open_recording(content.driver, log, content.settings, content.tags)
    samples = list(recorded.samples(lambda _, __: None))
    return samples, dict(recorded.counts())


def rows_of(path: Path) -> list[tuple[float, str, float]]:
    with path.open(newline="") as stream:
        return [(float(row["time_s"]), row["signal"], float(row["value"])) for row in csv.DictReader(stream)]


def test_every_row_of_the_trip_is_what_the_frames_say() -> None:
    samples, counts = samples_of(TRIP, "obd2")
    ours = [sample for sample in samples if sample.tag in NAMES]
    theirs = rows_of(DECODED)
    assert len(ours) == len(theirs) == counts["log_frames"] == 28_930
    assert {sample.quality for sample in ours} == {Quality.GOOD}
    # The file counts from the start of the recording, a whole second; values and times are rounded to four decimals.
    start = round(ours[0].time - theirs[0][0])
    mismatches = [
        (sample, row)
        for sample, row in zip(ours, theirs, strict=True)
        if NAMES[sample.tag] != row[1] or round(float(sample.value or 0), 4) != row[2]
        or abs(sample.time - start - row[0]) > 1e-4
    ]  # fmt: skip
    assert mismatches == []


async def test_the_driver_that_replays_the_trip_gives_every_row_at_its_moment() -> None:
    content = load_device(ROOT / "config" / "devices" / "obd2.toml")
    tags = {name: tag for tag in content.tags if (name := NAMES.get(tag.name))}
    theirs = rows_of(DECODED)
    clock = JumpClock(0.0)
    settings = {**content.settings, "log": str(TRIP), "start": 0.0}
    driver = open_driver("can-log", settings, clock=clock.now)
    await driver.open()
    mismatches = []
    for moment, name, value in theirs:
        clock.time = moment - theirs[0][0] + 0.001
        (sample,) = await driver.read([tags[name]])
        right = sample.quality is Quality.GOOD and round(float(sample.value or 0), 4) == value
        if not right or abs(clock.time - 0.001 - sample.time) > 2e-4:
            mismatches.append((moment, name, value, sample))
    assert (len(theirs), mismatches) == (28_930, [])
    assert driver.statistics()["frames"] == 28_930


def test_every_frame_of_the_truck_is_accounted_for_and_no_message_is_lost() -> None:
    samples, counts = samples_of(TRUCK, "j1939")
    lines = TRUCK.read_text().splitlines()
    identifiers = [line.split()[2].partition("#")[0] for line in lines]
    transport = sum(name[2:4] in ("EC", "EB") for name in identifiers)
    sessions = {name: count for name, count in counts.items() if name.startswith(("sessions_", "tp_")) and count}
    assert counts["frames"] == counts["log_frames"] == len(lines) == 1815
    assert counts["single"] + counts["transport"] == counts["frames"]
    assert (counts["transport"], sessions) == (transport, {"tp_complete": 80, "sessions_complete": 16})
    by_tag = {sample.tag: sample for sample in samples}
    configurations = [sample for sample in samples if sample.tag == "ReferenceTorque"]
    assert len(configurations) == sum(line.split()[2].endswith("FFE3FE00") for line in lines) == 13
    assert {sample.value for sample in configurations} == {630}
    assert sum(sample.tag == "EngineSpeed" for sample in samples) == identifiers.count("0CF00400")
    # The pedal's bytes are all FE in this log: an error, never 101.6 %.
    assert by_tag["Pedal"].quality is Quality.SENSOR_FAILURE
    assert by_tag["Pedal"].value is None


@pytest.fixture(scope="module")
def trip() -> tuple[Trace, Alphabet]:
    column_map = load_map(ROOT / "config" / "traces" / "can_obd2.toml")
    (trace,), _ = load_traces(DECODED, column_map)
    return trace, column_map.alphabet


@pytest.fixture(scope="module")
def plant(trip: tuple[Trace, Alphabet], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plant file whose device is the log, and a model learned from the trip's first 20 minutes."""
    folder = tmp_path_factory.mktemp("car")
    trace, alphabet = trip
    first = trace.between(trace.times[0], trace.times[0] + LEARNED_SECONDS)
    with pytest.MonkeyPatch.context() as patch:
        without_bands(patch)
        model = learn_bins([first], alphabet, "CoolantTemperature", seed=0).model
    (folder / "model.json").write_text(model_text(model))
    device = (ROOT / "config" / "devices" / "obd2.toml").read_text()
    (folder / "car.toml").write_text(device.replace('# log = "trip.log"', f'log = "{TRIP}"'))
    (folder / "plant.toml").write_text(
        '[device]\nfile = "car.toml"\n[model]\npath = "model.json"\ntemperature = "CoolantTemperature"\n'
        f"[scan]\nperiod = {PERIOD}\n[alarms]\nlimit = 105.0\n"
        '[forecast]\nhorizons = [60.0, 300.0]\nruns = 50\nperiod = 60.0\n[historian]\npath = "history.sqlite"\n'
    )
    return folder / "plant.toml"


@pytest.fixture(scope="module")
def status(plant: Path) -> Iterator[dict[str, Any]]:
    """The whole trip through the gateway, on a clock that jumps from scan to scan."""
    clock, stop = JumpClock(1_000_000.0), asyncio.Event()

    async def until_the_end() -> None:
        while clock.now() < 1_000_000.0 + 2380.0:
            await asyncio.sleep(0)
        stop.set()

    async def both() -> dict[str, Any]:
        ending = asyncio.create_task(until_the_end())
        last = await run(load_config(plant), clock=clock, stop=stop)
        await ending
        return last

    yield asyncio.run(both())


def rows(plant: Path, query: str) -> list[tuple[Any, ...]]:
    with closing(sqlite3.connect(plant.with_name("history.sqlite"))) as store:
        return store.execute(query).fetchall()


def test_the_gateway_runs_on_the_log_to_its_end_without_a_failure(status: dict[str, Any]) -> None:
    assert (status["failures"], status["phase"]) == (0, "stopped")
    assert status["scan"]["count"] > 2300
    assert status["driver"]["frames"] > 28_000
    assert status["driver"]["isotp_malformed"] == status["driver"]["log_refused"] == 0


def test_what_the_historian_holds_is_what_the_trip_says(plant: Path, status: dict[str, Any]) -> None:
    decoded = {(name, round(value, 4)) for _, name, value in rows_of(DECODED)}
    stored = rows(plant, "SELECT name, value FROM samples JOIN tags ON tags.id = samples.tag WHERE quality = 0")
    known = [(NAMES[name], round(value, 4)) for name, value in stored if name in NAMES]
    assert len(known) > 5000
    assert set(known) <= decoded


def test_the_events_are_those_of_the_readings_at_the_scans(
    plant: Path, status: dict[str, Any], trip: tuple[Trace, Alphabet]
) -> None:
    import numpy as np

    stored = rows(plant, "SELECT time, symbol FROM events ORDER BY id")
    scans = np.array([time for (time,) in rows(plant, "SELECT time FROM scans ORDER BY time")])
    # The same readings taken from the other decoding of the trip: the last one at each scan.
    speed = [(time, value) for time, name, value in rows_of(DECODED) if name == "ENGINE_RPM"]
    begin = rows_of(DECODED)[0][0]
    times = np.array([time - begin + 1_000_000.0 for time, _ in speed])
    held = np.searchsorted(times, scans + 2e-4, side="right") - 1
    there = held >= 0
    column = np.array([value for _, value in speed])[held[there]]
    expected = encode(
        Trace("trip", scans[there], {"EngineSpeed": column, "EngineRunning": (column > 100.0).astype(float)}), trip[1]
    )
    assert len(stored) > 50
    assert [symbol for _, symbol in stored] == [event.symbol for event in expected]
    assert [time for time, _ in stored] == pytest.approx([event.time for event in expected], abs=PERIOD)


def test_predictions_are_made_and_stored_and_follow_the_coolant(plant: Path, status: dict[str, Any]) -> None:
    made = rows(plant, "SELECT measured, mean, low, high FROM predictions WHERE known AND mean IS NOT NULL")
    assert len(made) > 2000
    inside = [low - 0.5 <= measured <= high + 0.5 for measured, _, low, high in made if measured is not None]
    # The coolant is told in whole degC: half a step either way is not the model's.
    assert sum(inside) / len(inside) > 0.8
    assert rows(plant, "SELECT count(*) FROM forecasts")[0][0] > 0
