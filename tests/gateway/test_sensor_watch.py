"""Sensor faults by NAMUR NE 107: each is found within a stated time, and nothing on what is well."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from drivers.tag import Quality, Sample
from gateway.machine.alarms import SensorWatch
from gateway.machine.alarms.sensors import REFERENCE_SECONDS
from gateway.machine.reading import Scan
from gateway.settings import FAULT_THRESHOLD
from sim.plant import scenario

A, B = "TCuscinettiRiduttore", "TCuscinettiAlimentazione"
Reading = tuple[float, Quality]


def well(seconds: int, seed: int = 7) -> Iterator[tuple[float, float]]:
    """Two bearings that warm from 20 degC by 1 degC in five minutes, read in tenths, with the noise of a sensor."""
    rng = np.random.default_rng(seed)
    for second in range(seconds):
        warm = 20.0 + second / 300.0
        yield tuple(np.round(warm + rng.normal(0.0, 0.05, 2) + (0.0, 0.4), 1).tolist())


def raised(
    spoil: Callable[[int, float], float | Reading | None], *, seconds: int = 900, twins: bool = True
) -> dict[str, int]:
    """When (s) each alarm on `A` first stands while its readings are spoiled from second 600 on."""
    watch = SensorWatch((A, B), (A, B) if twins else (), None)
    found: dict[str, int] = {}
    for second, (a, b) in enumerate(well(seconds)):
        given = spoil(second, a) if second >= 600 else a
        value, quality = (
            given if isinstance(given, tuple) else (given, Quality.GOOD if given is not None else Quality.BAD)
        )
        samples = {A: Sample(A, value, quality, float(second)), B: Sample(B, b, Quality.GOOD, float(second))}
        scan = Scan(number=second, time=float(second), samples=samples, missed=0, duration=0.0)
        for name, number in watch.take(scan).items():
            if number is not None and number > FAULT_THRESHOLD:
                found.setdefault(name.removesuffix(f" {A}"), second)
    return found


def test_a_sensor_that_is_well_raises_nothing() -> None:
    assert raised(lambda _, value: value) == {}
    assert raised(lambda _, value: value, twins=False) == {}


def test_a_frozen_sensor_is_found_while_its_twin_moves() -> None:
    found = raised(lambda _, value: 22.0)
    assert set(found) == {"sensor frozen"} and 600 + 120 <= found["sensor frozen"] <= 600 + 240


def test_a_frozen_sensor_without_a_twin_is_found_by_how_it_was_before() -> None:
    found = raised(lambda _, value: 22.0, seconds=600 + 1900, twins=False)
    assert set(found) == {"sensor frozen"} and 2400 <= found["sensor frozen"] <= 2410


@pytest.mark.parametrize("twins", [(A, B), ()])
def test_a_gap_in_the_readings_does_not_mend_a_frozen_sensor(twins: tuple[str, ...]) -> None:
    watch = SensorWatch((A, B), twins, None)
    found: dict[int, float | None] = {}
    for second, (a, b) in enumerate(well(4000)):
        if 3000 <= second < 3100:
            continue  # the link is lost
        a = 22.0 if 600 <= second < 3500 else a
        samples = {A: Sample(A, a, Quality.GOOD, float(second)), B: Sample(B, b, Quality.GOOD, float(second))}
        scan = Scan(number=second, time=float(second), samples=samples, missed=0, duration=0.0)
        found[second] = watch.take(scan)[f"sensor frozen {A}"]
    assert found[599] == 0.0 and found[2999] == 1.0
    after = [found[second] for second in range(3100, 3500)]
    assert 0.0 not in after and after[0] is None, "it shows what it showed before"
    assert found[3500] == 0.0 and found[3999] == 0.0


def test_a_frozen_sensor_stays_found_while_its_twin_comes_back_to_where_it_stood() -> None:
    watch, found = SensorWatch((A, B), (A, B), None), list[float | None]()
    for second in range(600):
        # Ten degrees up and down again in ten minutes, read every ten seconds: too few readings to count changes alone.
        warm = 40.0 + 10.0 * (1.0 - abs(second / 300.0 - 1.0))
        if second % 10 == 0:
            samples = {A: Sample(A, 40.0, Quality.GOOD, second), B: Sample(B, warm, Quality.GOOD, second)}
            scan = Scan(number=second, time=float(second), samples=samples, missed=0, duration=0.0)
            found.append(watch.take(scan)[f"sensor frozen {A}"])
    assert found[14] == 1.0 and set(found[14:]) == {1.0}


def test_a_jumping_sensor_is_found_with_its_second_step_and_one_step_is_none() -> None:
    assert raised(lambda second, value: value + 30.0 * (second == 700)) == {"sensor jumping": 701}
    assert raised(lambda _, value: value - 6.0) == {}


def test_a_spike_that_its_rate_makes_doubtful_is_seen_too() -> None:
    spike = raised(lambda second, value: (value + 30.0, Quality.SENSOR_NOT_ACCURATE) if second == 700 else value)
    assert spike == {"sensor jumping": 701}


def test_a_noisy_sensor_is_found() -> None:
    rng = np.random.default_rng(1)
    found = raised(lambda _, value: value + rng.normal(0.0, 0.9))
    assert set(found) == {"sensor noisy"} and found["sensor noisy"] < 600 + 180


def test_heating_that_is_read_at_uneven_times_is_no_noise() -> None:
    watch, rng = SensorWatch((A,), (), None), np.random.default_rng(2)
    highest = 0.0
    for second in np.cumsum(np.tile([1.0, 1.0, 9.0], 400)).tolist():
        # Up and down at 0.3 degC/s, each for a minute: a second difference takes the gaps for noise.
        warm = 40.0 + 0.3 * (60.0 - abs(second % 120.0 - 60.0)) + rng.normal(0.0, 0.05)
        sample = Sample(A, warm, Quality.GOOD, second)
        found = watch.take(Scan(number=int(second), time=second, samples={A: sample}, missed=0, duration=0.0))
        highest = max(highest, found[f"sensor noisy {A}"] or 0.0)
    assert 0.0 < highest < FAULT_THRESHOLD


def test_a_reading_out_of_range_is_found_at_once_and_one_that_fails_is_not_judged() -> None:
    assert raised(lambda _, value: (200.0, Quality.OUT_OF_RANGE)) == {"sensor out of range": 600}
    assert raised(lambda _, value: (0.0, Quality.SENSOR_FAILURE)) == {"sensor out of range": 600}
    assert raised(lambda _, value: None) == {}


def drifted(watch: SensorWatch, hours: int, drift: float, begin: float) -> tuple[float, float | None]:
    """Two more readings a minute: the twin's difference of 0.4 degC, and `drift` (degC/h) in it from the start on."""
    time, last = begin, None
    rng = np.random.default_rng(5)
    for step in range(hours * 60):
        time += 60.0
        noise = rng.normal(0.0, 0.2)
        samples = {
            A: Sample(A, 50.4 + noise + drift * step / 60.0, Quality.GOOD, time),
            B: Sample(B, 50.0, Quality.GOOD, time),
        }
        last = watch.take(Scan(number=step, time=time, samples=samples, missed=0, duration=0.0)).get(
            f"sensor drifting {A}"
        )
    return time, last


def test_twins_that_drift_apart_are_found_and_a_restart_goes_on_from_their_reference() -> None:
    watch = SensorWatch((A, B), (A, B), None)
    time, known = drifted(watch, int(REFERENCE_SECONDS / 3600.0) + 2, 0.0, 0.0)
    assert known is not None and known < 0.2
    again = SensorWatch((A, B), (A, B), None)
    again.restore(watch.to_plain())
    time, known = drifted(again, 48, 0.1, time + 3600.0)
    assert known is not None and known > FAULT_THRESHOLD, "0.1 degC/h for two days are nearly 5 degC"
    again.compare_anew()
    assert drifted(again, 2, 0.0, time)[1] is None, "until there is a reference anew"
    other = SensorWatch((B, A), (B, A), None)
    other.restore(watch.to_plain())
    assert other.reference.seconds == 0.0, "of other twins nothing is known"


def test_a_straight_line_says_when_the_limit_is_reached() -> None:
    watch = SensorWatch((A,), (), 300.0)
    seen = {}
    for second in range(400):
        value = 60.0 + 0.05 * second
        scan = Scan(
            number=0,
            time=float(second),
            samples={A: Sample(A, value, Quality.GOOD, float(second))},
            missed=0,
            duration=0.0,
        )
        seen[second] = watch.take(scan)[f"rising {A}"]
    assert seen[149] is None
    assert seen[300] == pytest.approx(60.0 + 0.05 * 600.0)


@pytest.mark.parametrize("name", ["cd8", "cd16"])
def test_the_shipped_scenarios_raise_nothing(name: str) -> None:
    trace = scenario(name, 0)
    watch = SensorWatch((A, B), (A, B), 300.0)
    a, b = (trace.signals[tag] for tag in (A, B))
    for time, one, other in zip(trace.times.tolist(), a.tolist(), b.tolist(), strict=True):
        samples = {A: Sample(A, one, Quality.GOOD, time), B: Sample(B, other, Quality.GOOD, time)}
        found = watch.take(Scan(number=0, time=time, samples=samples, missed=0, duration=0.0))
        limits = {key: 80.0 if key.startswith("rising") else FAULT_THRESHOLD for key in found}
        assert all(value is None or value <= limits[key] for key, value in found.items())
