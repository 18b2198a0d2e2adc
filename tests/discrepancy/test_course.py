"""Free runs with effects: what scatters is formed as what is fitted, and a course with a valve stands still."""

from dataclasses import replace

import numpy as np
import pytest

from sim.engine import linear_recursion
from sim.lab.discrepancy.fitting import course
from sim.lab.discrepancy.fitting.baseline import Frame, build_frame
from sim.lab.discrepancy.fitting.candidates import catalogue
from sim.lab.discrepancy.fitting.course import (
    CourseState,
    run_frame,
    scatter_response,
    window_grid,
    window_response,
    window_sensitivity,
)
from sim.lab.discrepancy.fitting.named import Named
from sim.lab.discrepancy.fitting.record import build_record
from sim.sha.trace import Array
from tests.discrepancy.plants import model, plant

DELAY = {"delay": 240.0, "blur": 0.3}
VALVE = {"opens": 46.0, "closes": 44.0, "sink": 17.0, "loss": 4e-4}


@pytest.fixture(scope="module")
def frame() -> Frame:
    return build_frame(build_record(model(), [plant(5, days=2)], ()))


def state_with(frame: Frame, kind: str, params: dict[str, float], guess: Array | None = None) -> CourseState:
    named = Named(next(entry for entry in catalogue() if entry.name == kind), {}, params)
    start = frame.record.reading[frame.record.window_first]
    return run_frame(frame, np.concatenate([frame.centre, [named.strength]]), start, [named], guess)


def test_a_scatter_of_all_cycles_alike_is_a_change_of_the_targets_through_the_sensor_too(frame: Frame) -> None:
    """If they differed by ever so little, the fit would play one against the other."""
    state = state_with(frame, "dead-time", DELAY)
    start = frame.record.reading[frame.record.window_first]
    targets = dict(zip(frame.names.targets, state.linear, strict=False))
    direction = np.array([targets[name] - targets["OFF"] for name in frame.names.targets])
    both = window_sensitivity(frame, state, start)[:, : direction.size] @ direction
    columns = scatter_response(frame, state)
    assert columns.shape == (frame.record.reading.size, 6)
    np.testing.assert_allclose(columns.sum(axis=1), both, atol=2e-3 * np.max(np.abs(both)))


def test_a_cycles_scatter_begins_with_it_and_dies_away_after_it(frame: Frame) -> None:
    columns = scatter_response(frame, state_with(frame, "dead-time", DELAY))
    cycle = frame.record.window_cycle
    for number in range(columns.shape[1]):
        assert np.max(np.abs(columns[cycle < number, number]), initial=0.0) < 1e-9
        assert np.argmax(np.abs(columns[:, number])) in np.flatnonzero(cycle == number)


def test_rough_heat_is_felt_as_late_as_the_rest(frame: Frame) -> None:
    at_once = window_grid(frame, run_frame(frame, frame.centre, frame.record.reading[frame.record.window_first], []))
    late = window_grid(frame, state_with(frame, "dead-time", {"delay": 240.0, "blur": 0.0}))
    times = frame.record.times
    starts = [times[int(np.argmax(grid.running > 0.5))] for grid in (at_once, late)]
    assert starts[1] - starts[0] == pytest.approx(240.0, abs=40.0)
    assert np.sum(late.running * late.dt) == pytest.approx(np.sum(at_once.running * at_once.dt), rel=0.02)


@pytest.mark.parametrize("cut", [False, True], ids=["one run", "a run each cycle"])
def test_a_response_by_windows_is_the_windows_of_the_response(frame: Frame, cut: bool) -> None:
    record = frame.record.by_cycles() if cut else frame.record
    rng = np.random.default_rng(1)
    decay = np.where(record.runs.first, 0.0, rng.uniform(0.2, 1.0, len(record.runs)))
    pushes = rng.standard_normal(decay.size)
    expected = record.window_means(linear_recursion(decay, pushes, 0.0))
    np.testing.assert_allclose(window_response(record, decay).means(pushes), expected, rtol=1e-9, atol=1e-9)


def test_a_course_with_a_thermostat_stands_still(frame: Frame) -> None:
    state = state_with(frame, "thermostatic-cooling", VALVE)
    running = frame.record.running > 0.5
    opened = state.loss > 0
    assert 0.1 < opened[running].mean() < 0.9, "the valve opens and closes"
    again = state_with(frame, "thermostatic-cooling", VALVE, state.course)
    np.testing.assert_allclose(again.course, state.course, atol=1e-6)


def test_a_housing_is_as_warm_where_a_run_begins_as_the_readings_before_have_left_it(frame: Frame) -> None:
    """Cycles that are held out begin warm: a housing as cold as the bearing there would be missed heat."""
    whole = state_with(frame, "housing-thermal-mass", {"coupling": 2e-4, "tau": 7200.0})
    record = frame.record
    measured = replace(
        record,
        runs=replace(record.runs, reading=np.where(np.isfinite(record.runs.reading), whole.course, np.nan)),
        uncut=replace(record.uncut, reading=np.interp(record.uncut.time, record.runs.time, whole.course)),
    )
    cut = build_frame(measured.by_cycles())
    named = Named(
        next(entry for entry in catalogue() if entry.name == "housing-thermal-mass"),
        {},
        {"coupling": 2e-4, "tau": 7200.0},
    )
    first = cut.record.runs.first
    again = run_frame(cut, np.concatenate([frame.centre, [2e-4]]), whole.course[first], [named])
    assert first.sum() > 3
    np.testing.assert_allclose(again.course, whole.course, atol=0.02)


SHAPES: dict[str, tuple[dict[str, str], dict[str, float]]] = {
    "dead-time": ({}, DELAY),
    "sensor-lag": ({}, {"tau": 120.0, "order": 2.0}),
    "sensor-offset-step": ({}, {"size": 0.5, "at": 1.7e9 + 86400.0}),
    "pump-cooling": ({"pump": "MarciaPmpFango"}, {"loss": 2e-4, "sink": 19.0}),
    "quadratic-current-heating": ({"current": "Assorbimento"}, {"gain": 1e-7, "reference": 200.0, "lag": 140.0}),
    "radiation-loss": ({}, {"gain": 1e-12, "surroundings": 20.0, "zero": -273.15}),
    "housing-thermal-mass": ({}, {"coupling": 2e-4, "tau": 7200.0}),
    "thermostatic-cooling": ({}, {**VALVE, "closes": 46.0, "sink": 46.0, "gradual": 1.0}),
}


@pytest.mark.parametrize("second", [(), ("dead-time",)], ids=["alone", "read late"])
@pytest.mark.parametrize("kind", list(SHAPES))
def test_derivatives_in_closed_form_are_those_of_the_simulation(
    kind: str, second: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """By no free run of their own: one for each parameter would be most of what a diagnosis costs."""
    frame = build_frame(build_record(model(), [plant(5, days=1)], ("MarciaPmpFango", "Assorbimento")))
    entries = {entry.name: entry for entry in catalogue()}
    named = [Named(entries[name], *SHAPES[name]) for name in dict.fromkeys((kind, *second))]
    point = np.concatenate([frame.centre, *(effect.point for effect in named)])
    start = frame.record.reading[frame.record.window_first]
    state = run_frame(frame, point, start, named)
    sizes = [*(1e-4 * frame.shape.spread), *[1e-4] * frame.count[1]]
    sizes += [size for effect in named for size in (1e-4 * effect.strength, *[1e-3] * (len(effect.free) - 1))]
    moved = [point + size * (np.arange(point.size) == number) for number, size in enumerate(sizes)]
    runs = [run_frame(frame, each, start, named, state.course) for each in moved]
    changes = np.column_stack([(run.mean - state.mean) / size for run, size in zip(runs, sizes, strict=True)])
    expected = frame.record.window_means(changes)
    monkeypatch.setattr(course, "run_free", None)
    columns = window_sensitivity(frame, state, start)
    # What a valve's bend is worth in a row that it falls into is known to the row's length.
    near = 6e-3 if kind == "thermostatic-cooling" else 1e-3
    assert np.all(np.max(np.abs(columns - expected), axis=0) <= near * np.max(np.abs(expected), axis=0))
