"""The circle that is closed: days on which twins look alike, a machine that obeys set-points, and what is counted."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.discrepancy.experiment.again import Closed
from benchmarks.discrepancy.experiment.cases import KINDS, TwinCase, specs
from benchmarks.discrepancy.experiment.days import PlantTime, days_of, obey, one_load, part
from benchmarks.discrepancy.experiment.figures import rows, tables
from benchmarks.discrepancy.recorder.cases import RecorderCase, machine_of_type, restless
from benchmarks.discrepancy.recorder.masses import integrate
from benchmarks.discrepancy.recorder.work import DAY, STEP
from benchmarks.discrepancy.runner import Outcome
from benchmarks.discrepancy.visible import Family

HOUR = 3600.0


@pytest.fixture(scope="module")
def plant() -> PlantTime:
    return days_of(np.random.default_rng(1), 1, one_load)


def set_points(begin: float) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """An hour of rest, then two hours at 250 A and as long at 130 A, the pump on in the second."""
    times = begin + 10.0 * np.arange(5 * 360)
    hour = (times - begin) / HOUR
    return times, {
        "MarciaDecanter": (hour >= 1).astype(float),
        "Assorbimento": np.select([hour < 1, hour < 3], [0.0, 250.0], 130.0),
        "MarciaPmpFango": (hour >= 3).astype(float),
    }


def test_a_machine_does_what_is_set_and_its_surroundings_what_they_like(plant: PlantTime) -> None:
    times, columns = set_points(DAY + HOUR)
    whole, experiment = obey(plant, times, columns)
    made = part(whole, experiment)
    hour = made.seconds / HOUR
    assert made.running.size == pytest.approx(5 * HOUR / STEP, abs=2)
    assert np.array_equal(made.running > 0, hour >= 1)
    assert made.starts == (720,) and made.current[720] == 390.0
    assert abs(made.load[(hour > 1) & (hour < 3)] - 250.0).max() <= 9.0 and not made.load[hour < 1].any()
    assert np.array_equal(made.pump > 0, hour >= 3)
    assert np.ptp(made.torque[hour >= 1]) > 1.0, "nobody sets the solids"
    with pytest.raises(ValueError, match="are not among"):
        obey(plant, times - 2 * HOUR, columns)


def test_what_was_recorded_is_not_changed_by_what_is_set_later(plant: PlantTime) -> None:
    (spec,) = specs("development", "speed or square of the load", [1])
    machine = restless(machine_of_type("development", "line-1"), np.random.default_rng(0), True)
    short = slice(0, int(1.5 * DAY / STEP))
    plant = replace(plant, work=part(plant.work, short), **{
        name: getattr(plant, name)[short] for name in ("torque", "vibration", "tremble", "flow", "differential")
    })  # fmt: skip
    case = TwinCase(RecorderCase(spec, machine, plant.work), plant, Family((0, 1, 1, 1, 1), (-1, 0, 0, 0, 0)))
    whole, experiment = obey(plant, *set_points(DAY + HOUR))
    rested, made = integrate([case.task(work, strength=2.0, quiet=False) for work in (plant.work, whole)])
    assert np.array_equal(rested[: experiment.start], made[: experiment.start])
    assert np.abs(rested - made)[experiment].max() > 5.0


def test_twins_of_a_kind_meet_the_same_machines_and_each_number_is_one_case() -> None:
    every = [spec for kind in KINDS for spec in specs("fresh", kind, range(12))]
    assert len({spec.identifier for spec in every}) == len(every)
    for kind, twins in KINDS.items():
        mine = [spec for spec in every if spec.stratum == kind]
        assert {spec.acts[0] for spec in mine} == set(twins.acts)
        laws = {name: {spec.law for spec in mine if spec.acts == (name,)} for name in twins.acts}
        assert len({frozenset(each) for each in laws.values()}) == 1, "no law tells the twins apart"


def outcome(verdict: str, *classes: tuple[str, ...], gains: dict[str, float] | None = None, **more: Any) -> Outcome:
    tried = [{"name": name, "gain_nats": gain, "step": 1} for name, gain in (gains or {}).items()]
    effects = [{"name": names[0], "class": list(names)} for names in classes]
    return Outcome("a", "done", 1.0, {"verdict": verdict, "effects": effects, "candidates": tried, **more})


def way(second: Outcome | None, most: float = 90.0) -> Closed:
    pair = {"pair": ["dead-time", "sensor-lag"], "expected": 20.0, "at_most": most}
    first = outcome(
        "class",
        ("dead-time", "sensor-lag"),
        gains={"dead-time": 50.0, "sensor-lag": 52.0},
        experiment={"what": "steps", "seconds": 7200.0, "nats": [pair], "needed_nats": 17.0, "least_nats": 8.0},
    )
    return Closed(kind="lag or delay", case="a", acts="sensor-lag", ratio=1.0, first=first, second=second)


def test_what_became_of_a_class_is_counted_with_the_nats_that_were_gained() -> None:
    right = way(outcome("named", ("sensor-lag",), gains={"sensor-lag": 130.0, "dead-time": 98.0}))
    wrong, class_ = way(outcome("named", ("dead-time",))), way(outcome("class", ("dead-time", "sensor-lag")))
    both = way(outcome("named", ("sensor-lag",), ("wear-drift",)))
    withheld, beyond = way(outcome("unexplained")), way(outcome("class", ("dead-time", "sensor-lag")), most=2.0)
    ways = [right, wrong, class_, both, withheld, beyond, way(None)]
    nothing = {**withheld.first.diagnosis, "verdict": "agree", "effects": []}
    ways.append(replace(withheld, first=replace(withheld.first, diagnosis=nothing)))
    assert [one.fate for one in ways] == ["right", "wrong", "class", "wrong", "withheld", "class", "", "withheld"]
    assert (right.expected, right.gained) == (20.0, 30.0)
    assert [one.inseparable for one in ways] == [False] * 5 + [True, False, False]
    found = {one.name: (one.hits, one.cases) for one in rows(ways)}
    assert found["class to the right member"] == (1, 5)
    assert found["the same, where the experiment was said to be enough"] == (1, 5)
    assert found["the same, to a wrong one"] == (2, 5)
    assert found["agreed at first, with rivals too small to matter: not named wrongly"] == (1, 1)
    assert found["said to be beyond any experiment: not named wrongly"] == (1, 1)
    said = tables(ways, every=True)
    assert "8 cases: 7 ended in a class" in said and "expected 20, gained 30 (medians)" in said
