"""A reading that stands still while the machine starts and stops is a sensor's, and is told."""

from dataclasses import replace

import numpy as np
import pytest

from sim.lab.discrepancy.fitting import build_record, patiently
from sim.lab.discrepancy.rules import RULES, DecisionRules
from sim.lab.discrepancy.standing import StillReading, find_still_reading
from sim.lab.discrepancy.workflow import diagnose
from sim.sha.trace import Trace
from tests.discrepancy.plants import model, plant

ROW_S = 240.0


def starts(trace: Trace) -> np.ndarray:
    """The rows in which the machine starts."""
    return np.flatnonzero(np.diff(trace.signals["MarciaDecanter"]) > 0) + 1


def stuck(trace: Trace, first: int, last: int) -> Trace:
    """The trace with the reading of row `first` up to row `last`, which reads something else again."""
    reading = trace.signals["T"].copy()
    reading[first:last] = reading[first]
    reading[last] = reading[first] + 0.1
    return replace(trace, signals={**trace.signals, "T": reading}, events=())


def found(trace: Trace, rules: DecisionRules = RULES) -> StillReading | None:
    record = build_record(model(), [patiently(trace, model().alphabet)], ("Assorbimento",))
    return find_still_reading(record, rules)


def test_a_sensor_that_stands_still_through_runs_and_rests_is_found_with_its_time() -> None:
    trace = plant(8, days=3, period=ROW_S)
    first, last = starts(trace)[4] - 3, starts(trace)[6] + 3
    still = found(stuck(trace, first, last))
    assert still is not None and still.visits == 4
    assert (still.begin, still.end) == (trace.times[first], trace.times[last - 1])
    assert still.value == trace.signals["T"][first]


@pytest.mark.parametrize(
    "name", ["still_usual_least_moved_share", "still_least_usual", "still_least_way_share", "still_least_way_steps"]
)
def test_rules_say_from_when_a_reading_stands_still(name: str) -> None:
    trace = plant(8, days=3, period=ROW_S)
    trace = stuck(trace, starts(trace)[4] - 3, starts(trace)[6] + 3)
    assert found(trace) is not None and found(trace, replace(RULES, **{name: 1000})) is None


@pytest.mark.parametrize("step", [0.1, 0.5, 2.0])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_rounding_and_a_rest_that_has_cooled_down_are_no_sensor_that_stands_still(seed: int, step: float) -> None:
    trace = plant(seed, days=3, period=ROW_S)
    reading = step * np.round(trace.signals["T"] / step)
    assert found(replace(trace, signals={**trace.signals, "T": reading}, events=())) is None


def test_a_switch_that_chatters_over_an_even_reading_is_no_sensor_that_stands_still() -> None:
    trace = plant(4, days=3, period=ROW_S)
    switch, rng = trace.signals["MarciaDecanter"].copy(), np.random.default_rng(4)
    turned = rng.random(switch.size) < 0.2
    reading = 2.0 * np.round(trace.signals["T"] / 2.0)
    signals = {**trace.signals, "MarciaDecanter": np.where(turned, 1.0 - switch, switch), "T": reading}
    assert found(replace(trace, signals=signals, events=())) is None


def test_a_diagnosis_says_that_its_sensor_stood_still() -> None:
    trace = plant(8, days=3, period=ROW_S)
    said = diagnose(model(), [stuck(trace, starts(trace)[6] + 9, trace.times.size - 1)], seed=0, most=1).diagnosis
    assert "The reading stood still at" in said.sentence and "look at the sensor." in said.sentence


HOUR = 3600.0
DAY = [(0, 6 * HOUR), (1, 10 * HOUR), (0, 8 * HOUR)]
QUIET = {
    "a jog at the weekend": (DAY * 5 + [(0, 8 * HOUR), (1, 60.0), (0, 40 * HOUR)], 7200.0, np.inf),
    "a start that is refused": (
        [(1, 2 * HOUR), (0, 3 * HOUR)] * 5 + [(1, 2 * HOUR), (0, 6 * HOUR), (1, 30.0), (0, 3 * HOUR)],
        2400.0,
        np.inf,
    ),
    "short trips of a regulated machine": (
        [(0, 5 * HOUR), (1, 4 * HOUR), (0, 60.0), (1, 4 * HOUR), (0, 60.0), (1, 3 * HOUR)],
        2400.0,
        40.0,
    ),
}
"""Runs and rests (s) of a machine that warms by 25 degC, its time constant (s) and what it is at most."""


@pytest.mark.parametrize("what", QUIET)
def test_a_reading_with_nowhere_to_go_does_not_stand_still(what: str) -> None:
    """A rest after a start that warmed nothing was called a stuck sensor, where readings are whole degrees."""
    schedule, constant, most = QUIET[what]
    step = 30.0
    on = np.concatenate([np.full(round(seconds / step), float(runs)) for runs, seconds in schedule * 4])
    heat, now = np.empty(on.size), 20.0
    for row, runs in enumerate(on):
        now = min(now + (20.0 + 25.0 * runs - now) * step / constant, most)
        heat[row] = now
    whole = plant(1, days=1, period=ROW_S)
    signals = {name: np.zeros(on.size) for name in whole.signals}
    signals |= {"T": heat.round(), "MarciaDecanter": on, "Assorbimento": 150.0 * on}
    assert found(replace(whole, times=1.7e9 + step * np.arange(on.size), signals=signals, events=())) is None
