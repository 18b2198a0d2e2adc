"""A model along a trace: where it starts, where it is compared, and the three errors apart."""

from math import isnan

import numpy as np
import pytest

from sim.engine.moment_equations import moments
from sim.engine.open_loop_run import errors, open_loop, open_loop_schedule, start_law
from sim.engine.schedules import schedule
from sim.sha.automaton import SHA, Distribution, Edge, Flow, Location
from sim.sha.events import DECANTER
from sim.sha.model import Model
from sim.sha.trace import Event, Trace
from tests.sha.models import normal

SIGNAL = "TCuscinettiRiduttore"
WARM = Location("warm", Flow("linear", {"noise": 0.1, "m": 0.5}))
REST = Location("rest", Flow("constant", {"noise": 0.1}))
TWO = SHA("two", (REST, WARM), (Edge("rest", "W_ON", "warm"), Edge("warm", "W_OFF", "rest")), "rest")


def model(initial: Distribution | None = None) -> Model:
    return Model(TWO, DECANTER, SIGNAL, 0.1, initial=initial)


def trace(events: tuple[Event, ...] = (Event(3.0, "W_ON"), Event(7.0, "W_OFF"))) -> Trace:
    """Readings at 1, 2, 4, 6, 8 s; none in the other rows."""
    readings = [np.nan, 20.0, 20.0, np.nan, 21.0, np.nan, 21.0, np.nan, 23.0, np.nan]
    return Trace("t", np.arange(10.0), {SIGNAL: np.array(readings)}, events)


def test_it_starts_at_the_first_reading_and_ends_at_the_last() -> None:
    run = open_loop(model(), trace())
    assert run.times.tolist() == [1.0, 2.0, 3.0, 4.0, 6.0, 7.0, 8.0]
    assert run.mean.tolist() == [20.0, 20.0, 20.0, 20.5, 21.5, 22.0, 22.0]
    assert run.variance[0] == 0.0


def test_an_event_before_the_first_reading_settles_the_location() -> None:
    run = open_loop(model(), trace((Event(0.0, "W_ON"),)))
    assert run.mean[-1] == pytest.approx(20.0 + 7 * 0.5)


def test_the_initial_law_is_used_when_it_is_asked_for() -> None:
    run = open_loop(model(normal(30.0, 2.0)), trace(), start="law")
    assert (run.mean[0], run.variance[0]) == (30.0, 4.0)
    with pytest.raises(ValueError, match="has no initial law"):
        open_loop(model(), trace(), start="law")
    assert start_law(model(normal(30.0, 2.0)), trace()).params["mu"] == 20.0


def test_errors_at_events_at_samples_and_at_the_end_are_kept_apart() -> None:
    found = errors(open_loop(model(), trace()), trace(), SIGNAL)
    # samples: 0, 0, -0.5, 0.5, -1; events at 3 s (held 20.0) and 7 s (held 21.0): 0 and 1
    assert found.at_samples.count == 5
    assert found.at_samples.rmse == pytest.approx(np.sqrt(1.5 / 5))
    assert found.at_samples.mae == pytest.approx(2.0 / 5)
    assert found.at_samples.bias == pytest.approx(-1.0 / 5)
    assert found.at_events.count == 2
    assert found.at_events.rmse == pytest.approx(np.sqrt(0.5))
    assert found.at_events.mae == pytest.approx(0.5)
    assert found.final == pytest.approx(-1.0)
    assert found.final_percent == pytest.approx(100.0 / 23.0)


def test_a_trace_without_events_has_no_error_at_events() -> None:
    found = errors(open_loop(model(), trace(())), trace(()), SIGNAL)
    assert found.at_events.count == 0
    assert isnan(found.at_events.rmse)
    assert found.at_samples.count == 5


def test_the_percentage_of_zero_degrees_is_no_number() -> None:
    cold = Trace("t", np.arange(2.0), {SIGNAL: np.zeros(2)})
    assert isnan(errors(open_loop(model(), cold), cold, SIGNAL).final_percent)


def test_a_prediction_that_skips_a_reading_is_not_interpolated() -> None:
    coarse = moments(schedule(TWO, trace().events, [1.0, 8.0]), 20.0)
    with pytest.raises(ValueError, match=r"no value at 2\.000 s"):
        errors(coarse, trace(), SIGNAL)


def test_policies_reach_the_schedule() -> None:
    odd = trace((Event(3.0, "A_1"),))
    with pytest.raises(ValueError, match=r"event 0 .*'A_1'"):
        open_loop(model(), odd)
    assert open_loop_schedule(model(), odd, "ignore").unmatched == (0,)


@pytest.mark.parametrize(
    ("columns", "said"),
    [({"Coppia": np.zeros(2)}, "has no signal"), ({SIGNAL: np.full(2, np.nan)}, "has no reading"), ({}, "none")],
)
def test_a_trace_without_the_temperature_is_refused(columns: dict[str, np.ndarray], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        open_loop(model(), Trace("t", np.arange(2.0), columns))


def test_a_prediction_of_another_time_is_refused() -> None:
    late = moments(schedule(TWO, [], [100.0, 101.0]), 20.0)
    with pytest.raises(ValueError, match="within the prediction's time span"):
        errors(late, trace(), SIGNAL)
