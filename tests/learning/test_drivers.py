"""What drives a temperature and what follows it: told from a plant with both, whatever loads it."""

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
import pytest

from sim.lab.learning import DriverEvidence, find_drivers
from sim.sha import Array, Trace

DT, TAU = 10.0, 1200.0
"""Seconds between rows, and the bearing's time constant."""
GAINS = {"power": 0.25, "speed": 0.004, "set point": 0.2, "ambient": 1.0}
"""degC in the end for each unit: what the plant is made of."""


@lru_cache
def plant(seed: int, rows: int = 12_000, *, regular: bool = False) -> Trace:
    """Four drivers and four followers: a fan with two thresholds, an oil that lags, a valve, another bearing."""
    rng = np.random.default_rng(seed)
    power, speed = np.zeros(rows), np.zeros(rows)
    at = 0
    while at < rows:
        on, off = (180, 120) if regular else (int(rng.integers(60, 400)), int(rng.integers(30, 200)))
        power[at : at + on] = 80.0 if regular else rng.choice([40.0, 70.0, 100.0])
        speed[at : at + on] = rng.choice([1500.0, 3000.0])
        at += on + off
    set_point = np.repeat(rng.choice([10.0, 20.0, 30.0], rows // 400 + 1), 400)[:rows]
    ambient = 20 + 5 * np.sin(np.arange(rows) * DT * 2 * np.pi / 86400) + rng.normal(0, 0.1, rows)
    heat, beside, lagging = 25.0, 25.0, 25.0
    fan = 0.0
    columns: dict[str, list[float]] = {"temperature": [], "bearing beside": [], "oil": [], "fan": [], "valve": []}
    valve = 0.0
    for row in range(rows):
        fan = 1.0 if heat > 50 else 0.0 if heat < 44 else fan
        valve += (np.clip((heat - 35.0) / 20.0, 0.0, 1.0) - valve) * 0.1
        load = GAINS["power"] * power[row] + GAINS["speed"] * speed[row] + GAINS["set point"] * set_point[row]
        heat += (ambient[row] + load - 8.0 * fan - heat) * DT / TAU + rng.normal(0, 0.01)
        beside += (ambient[row] + 0.3 * power[row] + 0.002 * speed[row] - beside) * DT / 700.0
        lagging += (heat - 5.0 - lagging) * DT / 600.0
        for name, value in zip(columns, (heat, beside, lagging, fan, valve), strict=True):
            columns[name].append(value)
    noisy = {
        name: np.array(values) + (rng.normal(0, 0.05, rows) if name not in ("fan", "valve") else 0.0)
        for name, values in columns.items()
    }
    signals: Mapping[str, Array] = {
        **noisy,
        "power": power + rng.normal(0, 1.0, rows) * (power > 0),
        "speed": speed,
        "set point": set_point,
        "ambient": ambient,
        "noise": rng.normal(0, 1.0, rows),
    }
    return Trace("plant", np.arange(rows) * DT, signals, (), {})


def evidence(trace: Trace, names: tuple[str, ...] = ()) -> dict[str, DriverEvidence]:
    wanted = names or tuple(name for name in trace.signals if name != "temperature")
    return {one.signal: one for one in find_drivers([trace], "temperature", wanted, gap=60.0)}


@pytest.mark.parametrize("regular", [False, True])
def test_drivers_are_told_from_what_follows_and_from_noise(regular: bool) -> None:
    found = evidence(plant(1, regular=regular))
    verdicts = {name: one.verdict for name, one in found.items()}
    assert verdicts == {
        **dict.fromkeys(GAINS, "drives"),
        **dict.fromkeys(("bearing beside", "oil", "fan", "valve"), "follows"),
        "noise": "adds nothing",
    }
    for name, gain in GAINS.items():
        assert found[name].gain == pytest.approx(gain, rel=0.35), name
        assert f"{name} drives it" in found[name].sentence
    assert "is no driver" in found["fan"].sentence and found["fan"].foretold > 0.2


def test_of_two_that_say_the_same_one_drives() -> None:
    trace = plant(1)
    twice = {**trace.signals, "torque": trace.signals["power"] * 2.0}
    found = evidence(Trace("twice", trace.times, twice, (), {}), ("power", "torque", "speed"))
    assert [found[name].verdict for name in ("power", "torque", "speed")] == ["drives", "adds nothing", "drives"]
    assert (
        found["torque"].alone == pytest.approx(found["power"].alone)
        and "nothing clearly beyond" in found["torque"].sentence
    )


def test_nothing_is_said_where_there_is_nothing_to_tell() -> None:
    trace = plant(1).between(0.0, 300.0)
    assert evidence(trace) == {}
    still = Trace("still", plant(1).times, {**plant(1).signals, "power": np.full(12_000, 5.0)}, (), {})
    assert evidence(still, ("power",)) == {}
    assert evidence(plant(1), ("temperature",)) == {}
