"""Free runs with effects: what scatters is formed as what is fitted, and a course with a valve stands still."""

import numpy as np
import pytest

from sim.discrepancy.fitting.baseline import Frame, frame_of
from sim.discrepancy.fitting.candidates import catalogue
from sim.discrepancy.fitting.course import CourseState, at, grid_at, scattered, sensitivity
from sim.discrepancy.fitting.named import Named
from sim.discrepancy.fitting.record import record_of
from sim.sha.trace import Array
from tests.discrepancy.plants import model, plant

DELAY = {"delay": 240.0, "blur": 0.3}
VALVE = {"opens": 46.0, "closes": 44.0, "sink": 17.0, "loss": 4e-4}


@pytest.fixture(scope="module")
def frame() -> Frame:
    return frame_of(record_of(model(), [plant(5, days=2)], ()))


def state_with(frame: Frame, kind: str, params: dict[str, float], guess: Array | None = None) -> CourseState:
    named = Named(next(entry for entry in catalogue() if entry.name == kind), {}, params)
    start = frame.record.reading[frame.record.window_first]
    return at(frame, np.concatenate([frame.centre, [named.strength]]), start, [named], guess)


def test_a_scatter_of_all_cycles_alike_is_a_change_of_the_targets_through_the_sensor_too(frame: Frame) -> None:
    """If they differed by ever so little, the fit would play one against the other."""
    state = state_with(frame, "dead-time", DELAY)
    start = frame.record.reading[frame.record.window_first]
    targets = dict(zip(frame.names.targets, state.linear, strict=False))
    direction = np.array([targets[name] - targets["OFF"] for name in frame.names.targets])
    both = frame.record.windowed(sensitivity(frame, state, start)[:, : direction.size] @ direction)
    columns = scattered(frame, state)
    assert columns.shape == (frame.record.reading.size, 6)
    np.testing.assert_allclose(columns.sum(axis=1), both, atol=2e-3 * np.max(np.abs(both)))


def test_a_cycles_scatter_begins_with_it_and_dies_away_after_it(frame: Frame) -> None:
    columns = scattered(frame, state_with(frame, "dead-time", DELAY))
    cycle = frame.record.window_cycle
    for number in range(columns.shape[1]):
        assert np.max(np.abs(columns[cycle < number, number]), initial=0.0) < 1e-9
        assert np.argmax(np.abs(columns[:, number])) in np.flatnonzero(cycle == number)


def test_rough_heat_is_felt_as_late_as_the_rest(frame: Frame) -> None:
    at_once = grid_at(frame, at(frame, frame.centre, frame.record.reading[frame.record.window_first], []))
    late = grid_at(frame, state_with(frame, "dead-time", {"delay": 240.0, "blur": 0.0}))
    times = frame.record.times
    starts = [times[int(np.argmax(grid.running > 0.5))] for grid in (at_once, late)]
    assert starts[1] - starts[0] == pytest.approx(240.0, abs=40.0)
    assert np.sum(late.running * late.dt) == pytest.approx(np.sum(at_once.running * at_once.dt), rel=0.02)


def test_a_course_with_a_thermostat_stands_still(frame: Frame) -> None:
    state = state_with(frame, "thermostatic-cooling", VALVE)
    running = frame.record.running > 0.5
    opened = state.loss > 0
    assert 0.1 < opened[running].mean() < 0.9, "the valve opens and closes"
    again = state_with(frame, "thermostatic-cooling", VALVE, state.course)
    np.testing.assert_allclose(again.course, state.course, atol=1e-6)
