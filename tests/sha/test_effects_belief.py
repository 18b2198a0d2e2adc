"""The filter with effects: sample by sample as along a schedule, its evidence against the joint Gaussian."""

import json
from dataclasses import asdict
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.stats import multivariate_normal

from gateway.machine.model.predict import Predictor
from sim.engine.belief import (
    Belief,
    advance,
    filter_trace,
    machine_offset,
    observe,
    on_event,
    restart,
    start,
    with_inputs,
    with_machine_offset,
)
from sim.engine.belief_state import Delayed, restore_belief
from sim.engine.moment_equations import moments
from sim.engine.plant import compile_plant
from sim.engine.schedules import schedule
from sim.engine.tracker import Tracker, compile_model
from sim.sha.automaton import Effect
from sim.sha.events import Alphabet, Switch
from sim.sha.model import Model
from sim.sha.trace import Array, Event, Trace
from tests.sha.effect_reference import EFFECTS, FLOWS, LATE, TOGETHER, course, plant

ALL = EFFECTS | TOGETHER | LATE


def tracker_of(kind: str, effects: tuple[Effect, ...], sensor: float = 0.1) -> Tracker:
    return compile_model(Model(plant(kind, effects), Alphabet((Switch("on", "W_ON", "W_OFF"),)), "T", sensor))


def streamed(tracker: Tracker, events: list[Event], inputs: Trace, outputs: Array, x0: float) -> tuple[Array, Array]:
    """Mean and variance at the outputs when everything comes one by one and nothing is measured after the start."""
    belief = start(tracker, float(outputs[0]), x0)
    coming = [(event.time, 0, event) for event in events]
    coming += [(time, 1, row) for row, time in enumerate(inputs.times.tolist())]
    coming += [(time, 2, None) for time in outputs.tolist()]
    found = []
    for time, rank, what in sorted(coming, key=lambda each: each[:2]):
        if isinstance(what, Event):
            belief = on_event(tracker, belief, what)
        elif rank == 1:
            news = {name: float(column[what]) for name, column in inputs.signals.items()}
            belief = with_inputs(tracker, belief, time, news)
        else:
            belief = advance(tracker, belief, time)
            found.append((belief.x, belief.xx))
    mean, variance = np.array(found).T
    return mean, variance


@settings(max_examples=40, deadline=None)
@given(st.sampled_from(sorted(ALL)), st.sampled_from(sorted(FLOWS)), st.integers(0, 10**6), st.floats(3.0, 60.0))
def test_sample_by_sample_is_the_whole_course(name: str, kind: str, seed: int, period: float) -> None:
    tracker = tracker_of(kind, ALL[name])
    events, inputs = course(seed, 900.0)
    outputs = np.arange(0.0, 900.0, period)
    expected = moments(schedule(tracker.model, events, outputs, inputs=inputs), 21.0, tracker.sensor)
    mean, variance = streamed(tracker, events, inputs, outputs, 21.0)
    nonlinear = "thermostat" in name or "radiation" in name
    np.testing.assert_allclose(mean, expected.mean, atol=3e-4 if nonlinear else 3e-5)
    np.testing.assert_allclose(variance, expected.variance, rtol=0.05 if "thermostat" in name else 1e-4, atol=1e-7)


GAUSSIAN = (
    Effect("pump-cooling", {"loss": 5e-3, "sink": 25.0}, {"pump": "P"}),
    Effect("housing-thermal-mass", {"coupling": 0.01, "tau": 900.0}),
    Effect("sensor-lag", {"tau": 30.0, "order": 2.0}),
)


def test_the_evidence_is_that_of_the_joint_gaussian() -> None:
    """X, H, two lags and m with their matrices written out: readings every 20 s, start at 100 s, pump at 200 s."""
    tracker = tracker_of("exponential", GAUSSIAN)
    times = np.arange(0.0, 401.0, 20.0)
    readings = 21.0 + 0.05 * np.cumsum(np.random.default_rng(0).normal(size=times.size))
    pump = np.where(times >= 200.0, 1.0, 0.0)
    trace = Trace("t", times, {"T": readings, "P": pump}, (Event(100.0, "W_ON"),))
    found = filter_trace(tracker, trace).belief.evidence
    mean, joint = joint_gaussian(times, readings[0], tracker.sensor)
    assert found == pytest.approx(multivariate_normal(mean, joint).logpdf(readings[1:]), abs=1e-6)


def joint_gaussian(times: Array, first: float, sensor: float) -> tuple[Array, Array]:
    """Mean and covariance of the readings after the first, all states being what the first says."""
    state, spread = np.array([first] * 4 + [22.0]), np.zeros((5, 5))
    spread[:4, :4], spread[4, 4] = sensor, 1.0
    maps, states, spreads = [np.eye(5)], [state], [spread]
    for time, after in pairwise(times.tolist()):
        on, pumped = time >= 100.0, time >= 200.0
        if time == 100.0:  # a new m: it forgets the old one
            spread = spread.copy()
            spread[4, :], spread[:, 4] = 0.0, 0.0
            state[4], spread[4, 4] = 55.0, 4.0
        phi, moved, noise = exact(on, pumped, after - time)
        state, spread = phi @ state + moved, phi @ spread @ phi.T + noise
        maps.append(phi @ np.diag([1.0, 1.0, 1.0, 1.0, 0.0 if time == 100.0 else 1.0]))
        states.append(state.copy())
        spreads.append(spread)
    joint = np.empty((times.size, times.size))
    for i in range(times.size):
        carried = spreads[i]
        for j in range(i, times.size):
            carried = carried if j == i else maps[j] @ carried
            joint[i, j] = joint[j, i] = carried[3, 3]
    return np.array([each[3] for each in states[1:]]), joint[1:, 1:] + sensor * np.eye(times.size - 1)


def exact(on: bool, pumped: bool, dt: float) -> tuple[Array, Array, Array]:
    """Transition, what a constant heat adds, noise (Van Loan) of one step."""
    k, loss = (0.004 if on else 0.003), (5e-3 if pumped else 0.0)
    a = np.zeros((5, 5))
    a[0] = [-k - loss - 0.01, 0.01, 0.0, 0.0, k]
    a[1, :2] = [1 / 900, -1 / 900]
    a[2, [0, 2]] = [2 / 30, -2 / 30]
    a[3, [2, 3]] = [2 / 30, -2 / 30]
    heated = np.zeros((6, 6))
    heated[:5, :5], heated[0, 5] = a, loss * 25.0
    white = np.zeros((5, 5))
    white[0, 0] = (0.03 if on else 0.02) ** 2
    loan = expm(np.block([[-a, white], [np.zeros((5, 5)), a.T]]) * dt)
    phi = loan[5:, 5:].T
    return phi, expm(heated * dt)[:5, 5], phi @ loan[:5, 5:]


def far(kind: str = "driven") -> tuple[Tracker, Belief]:
    tracker = tracker_of(kind, (*TOGETHER["pump, housing, lag, dead time"], *EFFECTS["startup-churning"]))
    belief = start(tracker, 0.0, 21.0, {"I": 100.0, "P": 0.0})
    belief = on_event(tracker, belief, Event(5.0, "W_ON"))
    belief = with_inputs(tracker, belief, 300.0, {"I": 140.0, "P": 1.0})
    return tracker, on_event(tracker, observe(tracker, belief, 300.0, 30.0), Event(301.0, "W_OFF"))


def test_a_belief_taken_apart_by_json_goes_on_as_if_nothing_had_happened() -> None:
    tracker, belief = far()
    again = restore_belief(json.loads(json.dumps(asdict(belief))))
    assert again == belief
    assert observe(tracker, again, 400.0, 35.0) == observe(tracker, belief, 400.0, 35.0)


def test_a_restart_moves_what_the_sensor_reads_to_the_reading_and_keeps_the_housing() -> None:
    tracker, belief = far()
    fresh = restart(tracker, belief, 40.0)
    assert (fresh.x, fresh.xx, fresh.clamps) == (pytest.approx(40.0), pytest.approx(tracker.sensor), 0)
    assert belief.hidden is not None
    assert fresh.hidden is not None
    assert fresh.hidden.mean[1] == belief.hidden.mean[1]
    assert fresh.hidden.mean[0] - belief.hidden.mean[0] == pytest.approx(40.0 - belief.x)


def test_a_late_event_is_counted_and_still_acts() -> None:
    tracker = tracker_of("linear", EFFECTS["dead-time"])
    belief = advance(tracker, start(tracker, 0.0, 21.0), 100.0)
    belief = on_event(tracker, belief, Event(90.0, "W_ON"))
    assert belief.late == 1
    assert advance(tracker, belief, 107.0).location == "off"
    assert advance(tracker, belief, 107.4).location == "on"  # 90 s and the dead time of 17.3 s


def test_an_event_without_an_edge_is_counted_when_it_is_felt() -> None:
    tracker = tracker_of("linear", EFFECTS["dead-time"])
    belief = on_event(tracker, start(tracker, 0.0, 21.0), Event(1.0, "W_OFF"))
    assert (belief.unmatched, advance(tracker, belief, 30.0).unmatched) == (0, 1)


def test_what_a_dead_time_holds_back_acts_in_its_order_and_events_before_signals() -> None:
    tracker = tracker_of("driven", (*EFFECTS["dead-time"], *EFFECTS["pump with sink"]))
    delay = EFFECTS["dead-time"][0].params["delay"]
    begun = start(tracker, 0.0, 21.0)

    def queue(belief: Belief) -> list[tuple[float, str, dict[str, float]]]:
        assert belief.hidden is not None
        return [(each.due, each.symbol, dict(each.signals)) for each in belief.hidden.pending]

    belief = with_inputs(tracker, begun, 5.0, {"P": 1.0, "I": 60.0, "other": 4.0})
    held = (5.0 + delay, "", {"P": 1.0, "I": 60.0})
    assert queue(belief) == [held] and belief.signals == {} and belief.time == 5.0
    belief = on_event(tracker, belief, Event(5.0, "W_ON"))
    assert queue(belief) == [(5.0 + delay, "W_ON", {}), held], "at one instant events come first"
    again = with_inputs(tracker, belief, 6.0, {"P": 1.0, "I": 61.0})
    assert queue(again)[2:] == [(6.0 + delay, "", {"I": 61.0})], "what is held back already is no news"
    assert queue(with_inputs(tracker, again, 7.0, {"P": 1.0, "I": 61.0})) == queue(again)
    # What comes late is due a dead time after its own moment, but not before now; of no moment at all, after now.
    far = advance(tracker, begun, 100.0)
    for time, due in ((99.0, 99.0 + delay), (50.0, 100.0), (float("nan"), 100.0 + delay)):
        late = on_event(tracker, far, Event(time, "W_ON"))
        assert queue(late) == [(due, "W_ON", {})] and (late.late, late.time) == (1, 100.0)
        assert queue(with_inputs(tracker, far, time, {"P": 1.0})) == [(due, "", {"P": 1.0})]
    # It acts at its own moment, however long the step is, and at a reading of that moment already.
    assert advance(tracker, belief, 5.0 + delay - 0.1).location == "off"
    at_once, later = advance(tracker, belief, 5.0 + delay), advance(tracker, belief, 60.0)
    for each in (at_once, later):
        assert (each.location, each.entered, dict(each.signals), queue(each)) == (
            "on",
            5.0 + delay,
            {"P": 1.0, "I": 60.0},
            [],
        )
    seen = observe(tracker, belief, 5.0 + delay, 22.0)
    assert seen.location == "on" and seen.read_at == seen.time == 5.0 + delay
    assert Delayed(1.0).symbol == "" and Delayed(1.0).signals == {}


def test_what_is_known_of_a_machine_is_put_in_and_found_again() -> None:
    tracker = tracker_of("exponential", (Effect("machine-offset", {"sigma": 4.0}),))
    begun = start(tracker, 0.0, 21.0)
    assert machine_offset(tracker, begun) == pytest.approx((0.0, 4.0))
    known = with_machine_offset(tracker, begun, 2.5, 0.5)
    assert machine_offset(tracker, known) == pytest.approx((2.5, 0.5))
    assert advance(tracker, known, 600.0).x - advance(tracker, begun, 600.0).x > 0.5, "its targets lie above"
    assert machine_offset(tracker, with_machine_offset(tracker, begun, 0.0, 0.0)) == (0.0, 0.0)


def test_with_a_late_heat_the_belief_keeps_what_it_is_late_behind() -> None:
    name = next(iter(LATE))
    tracker = tracker_of("linear", LATE[name])
    begun = start(tracker, 0.0, 21.0, {"I": 80.0})
    news = with_inputs(tracker, begun, 30.0, {"I": 120.0})
    assert begun.hidden is not None and news.hidden is not None
    assert news.hidden.late != begun.hidden.late and news.signals == {"I": 120.0}
    assert with_inputs(tracker, begun, 30.0, {"I": 80.0}) == advance(tracker, begun, 30.0)


def test_the_gateway_reads_the_signals_of_effects() -> None:
    model = Model(plant("linear", EFFECTS["pump with sink"]), Alphabet((Switch("on", "W_ON", "W_OFF"),)), "T", 0.1)
    assert {"P", "Ta"} <= set(Predictor(model, "T").inputs)


STEADY = sorted(kind for kind, effects in EFFECTS.items() if compile_plant(plant("exponential", effects)).steady_linear)


@pytest.mark.parametrize("kind", STEADY)
def test_steps_of_a_clock_that_jitters_are_exact_and_made_once(kind: str) -> None:
    tracker = tracker_of("exponential", EFFECTS[kind])
    assert tracker.plant is not None
    lengths = np.random.default_rng(1).uniform(0.099, 0.101, 400)
    times = np.concatenate([[0.0], np.cumsum(lengths)])
    begun = start(tracker, 0.0, 21.0)
    whole, stepped = advance(tracker, begun, float(times[-1])), begun
    tracker.plant.memo.clear()
    for time in times.tolist():
        stepped = advance(tracker, stepped, time)
    assert (stepped.x, stepped.xx) == pytest.approx((whole.x, whole.xx), rel=1e-10)
    assert len(tracker.plant.memo) <= 4
