"""What follows the temperature is no cause: neither a law nor an advice may rest on it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sim.lab.discrepancy.consequence import follows
from sim.lab.discrepancy.layout import measured_signals
from sim.lab.discrepancy.rules import RULES
from sim.lab.discrepancy.workflow import diagnose
from sim.sha.trace import Array, Trace
from tests.discrepancy.plants import PERIOD, model, plant

RIG = Path(__file__).parents[3] / "shared" / "data" / "hydraulic_rig" / "rig_5s.csv"


def lagged(column: Array, lag: float) -> Array:
    """A column through a mass of so many seconds, row by row."""
    out, value = np.empty_like(column), float(column[0])
    for row, each in enumerate(column):
        value += (1.0 - np.exp(-PERIOD / lag)) * (each - value)
        out[row] = value
    return out


def beside(trace: Trace, share: float, lag: float) -> Trace:
    """The trace with a sensor S that is warmed by the machine, beside a room of its own."""
    rng, warm = np.random.default_rng(1), trace.signals["T"]
    day = 17.0 + 4.0 * np.sin(2.0 * np.pi * trace.times / 86400.0)
    own = day + share * (lagged(warm, lag) - 17.0) + 0.1 * rng.standard_normal(warm.size)
    return replace(trace, signals={**trace.signals, "S": np.round(own, 1)})


@pytest.mark.parametrize("lag", [1.0, 300.0, 1800.0, 7200.0])
def test_a_sensor_of_the_same_circuit_follows(lag: float) -> None:
    assert follows([beside(plant(3), 0.8, lag)], "T", "S", RULES)


def test_a_room_that_the_machine_hardly_warms_does_not() -> None:
    assert not follows([beside(plant(3), 0.03, 600.0)], "T", "S", RULES)


@pytest.mark.parametrize("lag", [300.0, 900.0, 1500.0, 6000.0])
@pytest.mark.parametrize("heat", [0.0, 0.1])
def test_what_the_temperature_follows_does_not_follow_it(lag: float, heat: float) -> None:
    trace, rng = plant(3), np.random.default_rng(2)
    room = 17.0 + np.cumsum(0.05 * rng.standard_normal(trace.times.size))
    warm = lagged(room, lag) + heat * (trace.signals["T"] - 17.0) + 0.06 * rng.standard_normal(room.size)
    there = replace(trace, signals={**trace.signals, "S": np.round(room, 1), "T": warm})
    assert not follows([there], "T", "S", RULES)
    if not heat:
        # What is a cause of the one is a consequence of the other: the same readings with the roles exchanged.
        assert lag > 1500.0 or follows([there], "S", "T", RULES)


@pytest.mark.parametrize("which", [{}, {"room": 3.0}, {"room": 5.0, "runs_on": True}, {"bowl": 0.05}])
def test_no_signal_that_drives_a_plant_follows_it(which: dict[str, float]) -> None:
    trace = plant(3, **which)  # type: ignore[arg-type]
    assert [name for name in trace.signals if name != "T" and follows([trace], "T", name, RULES)] == []


def test_in_a_measured_circuit_the_other_oil_temperatures_follow_and_the_cooler_does_not() -> None:
    if not RIG.exists():
        pytest.skip("no measured rig beside the project")
    rows = np.genfromtxt(RIG, delimiter=",", names=True)
    names = ("TS1", "TS2", "TS3", "TS4", "cooler", "leak")
    trace = Trace("rig", rows["time"], {name: rows[name] for name in names})
    found = {name: follows([trace], "TS1", name, RULES) for name in names[1:]}
    assert found == {"TS2": True, "TS3": True, "TS4": True, "cooler": False, "leak": False}


def test_a_consequence_is_no_room_and_drives_no_law() -> None:
    trace = beside(plant(2, days=2, pump=1e-3), 0.8, 300.0)
    trace = replace(trace, signals={**trace.signals, "TAmbiente": trace.signals["S"]})
    found = diagnose(model(), [trace], seed=0).diagnosis
    assert "ambient-coupling" not in {each.name for each in found.candidates}
    assert found.untested["ambient-coupling"] == (
        "TAmbiente (ambient) follows T in these traces: it is a consequence, and no cause"
    )
    assert measured_signals(model(), [trace], RULES) == ("MarciaDecanter", "Assorbimento", "MarciaPmpFango")
