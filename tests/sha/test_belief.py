"""The filter against brute force, simulation, and the things that go wrong online."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.engine.belief import (
    advance,
    anomaly,
    filter_trace,
    machine_offset,
    observe,
    on_event,
    restart,
    start,
    with_inputs,
    with_machine_offset,
)
from sim.engine.belief_state import Belief, Innovation
from sim.engine.moment_equations import moments
from sim.engine.schedules import schedule
from sim.engine.tracker import compile_model
from sim.sha import flows
from sim.sha.automaton import SHA, Distribution, Edge, Flow, Input, Location
from sim.sha.events import DECANTER
from sim.sha.model import Model
from sim.sha.trace import UNKNOWN, Event, Trace
from tests.sha.plants import normal, relaxing, simulate_two, single, two_states

KINDS = {
    "constant": {"noise": 0.05},
    "linear": {"noise": 0.05},
    "exponential": {"k": 0.01, "noise": 0.05},
    "driven": {"k": 0.01, "noise": 0.05},
    "logarithmic": {"t0": 3.0, "noise": 0.05},
    "transient": {"tau": 3.0, "noise": 0.05},
}


def flow_of(kind: str) -> Flow:
    return Flow(kind, KINDS[kind], (Input("A", 0.1, 50.0),) if kind == "driven" else ())


@pytest.mark.parametrize("kind", list(flows.FLOWS))
@settings(max_examples=40)
@given(age=st.floats(0, 1e4), dt=st.floats(0, 1e4), x=st.floats(-20, 150), target=st.floats(-50, 150))
def test_scalar_steps_equal_the_table_of_flows(kind: str, age: float, dt: float, x: float, target: float) -> None:
    flow = flow_of(kind)
    mode = compile_model(single(flow, normal(1.0, 0.1))).modes["q"]
    assert mode.step(age, dt) == pytest.approx([float(part) for part in flows.coefficients(flow, age, dt)], rel=1e-12)
    assert mode.speed(x, target, age) == pytest.approx(abs(float(flows.drift(flow, x, target, age))))
    for rate in (0.01, float("inf")):
        expected = float(flows.mean_step(flow, x, target, age=age, dt=dt, max_rate=rate))
        assert mode.mean(x, target, age, dt, rate) == pytest.approx(expected, rel=1e-9, abs=1e-9)


WIDE = 1e4
"""The brute force's prior variance of X (degC^2): the filter's is infinite, which costs a relative 1e-5 here."""


def brute_force(
    model: Model, times: list[float], readings: list[float], switch: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Posterior of (X, m of the last stay) at the last time and the log-evidence, by conditioning one joint Gaussian.

    All randomness is listed: first X, two mode parameters, the noise of every step; X at each time is linear in it.
    """
    cold, hot = model.sha.locations
    marks = sorted({*times, switch})
    size = 3 + len(marks) - 1
    mean, prior = np.zeros(size), np.eye(size)
    mean[0], mean[1], mean[2] = readings[0], 25.0, 70.0
    prior[0, 0], prior[1, 1], prior[2, 2] = WIDE, 1.0, 9.0
    row, rows = np.eye(size)[0], {marks[0]: np.eye(size)[0]}
    for number, (begin, end) in enumerate(pairwise(marks)):
        flow, parameter = (cold.flow, 1) if end <= switch else (hot.flow, 2)
        decay, pull, variance = (float(part) for part in flows.coefficients(flow, 0.0, end - begin))
        row = decay * row + pull * np.eye(size)[parameter] + np.sqrt(variance) * np.eye(size)[3 + number]
        rows[end] = row
    seen = np.array([rows[time] for time in times])
    covariance = seen @ prior @ seen.T + model.sensor_sigma**2 * np.eye(len(times))
    wanted = np.array([row, np.eye(size)[2]])
    gain = wanted @ prior @ seen.T @ np.linalg.inv(covariance)
    residual = np.asarray(readings) - seen @ mean
    posterior = wanted @ prior @ wanted.T - gain @ seen @ prior @ wanted.T
    _, logdet = np.linalg.slogdet(2 * np.pi * covariance)
    return (
        wanted @ mean + gain @ residual,
        posterior,
        -0.5 * (logdet + residual @ np.linalg.solve(covariance, residual)),
    )


def test_the_filter_is_brute_force_conditioning_of_the_joint_gaussian() -> None:
    model = two_states(sensor=0.3)
    times, readings = [0.0, 4.0, 11.0, 12.5, 40.0, 90.0], [30.0, 29.6, 30.1, 29.7, 38.0, 49.0]
    trace = Trace("t", np.array(times), {"T": np.array(readings)}, (Event(12.0, "W_ON"),))
    mean, covariance, _ = brute_force(model, times, readings, 12.0)
    belief = filter_trace(model, trace).belief
    assert [belief.x, belief.m] == pytest.approx(mean, abs=1e-4)
    assert [belief.xx, belief.xm, belief.mm] == pytest.approx(covariance[[0, 0, 1], [0, 1, 1]], rel=1e-4)


def test_evidence_is_the_log_density_of_the_readings_after_the_first() -> None:
    model = two_states(sensor=0.3)
    times, readings = [0.0, 4.0, 11.0, 12.5, 40.0], [30.0, 29.6, 30.1, 29.7, 38.0]
    trace = Trace("t", np.array(times), {"T": np.array(readings)}, (Event(12.0, "W_ON"),))
    _, _, evidence = brute_force(model, times, readings, 12.0)
    # The brute force's first X is N(30, WIDE): its first reading has that density, the filter's has none.
    first = -0.5 * np.log(2 * np.pi * (WIDE + 0.09))
    assert filter_trace(model, trace).belief.evidence == pytest.approx(evidence - first, abs=1e-4)


def test_innovations_of_the_true_model_are_white_and_chi_square() -> None:
    model = two_states(sensor=0.2)
    trace, true = simulate_two(model, 4000, np.random.default_rng(5))
    run = filter_trace(model, trace)
    z = (run.innovation / np.sqrt(run.variance))[1:]
    n = z.size
    assert abs(z.mean()) < 4 / np.sqrt(n)
    assert abs((z**2).mean() - 1) < 4 * np.sqrt(2 / n)
    for lag in (1, 2, 10):
        assert abs((z[lag:] * z[:-lag]).mean()) < 4 / np.sqrt(n)
    error = (run.x - true) / np.sqrt(run.xx)
    assert 0.85 < (error[1:] ** 2).mean() < 1.15
    assert run.belief.unmatched == run.belief.late == 0
    assert {"cold", "hot"} == set(run.locations)


def test_a_changed_plant_raises_the_anomaly_score_and_the_true_one_does_not() -> None:
    model = two_states(sensor=0.2)
    trace, _ = simulate_two(model, 600, np.random.default_rng(6))
    tracker, events = compile_model(model), list(trace.events)
    scores = []
    belief = start(tracker, 0.0)
    for time, reading in zip(trace.times.tolist(), trace.signals["T"].tolist(), strict=True):
        while events and events[0].time <= time:
            belief = on_event(tracker, belief, events.pop(0))
        belief = observe(tracker, belief, time, reading)
        scores.append(anomaly(belief))
    assert max(scores) < 4
    for step in range(30):
        belief = observe(tracker, belief, 600.0 + step, belief.x + 3.0)
    assert anomaly(belief) > 20


def test_a_silent_stretch_is_one_exact_step_and_widens_the_belief() -> None:
    model = two_states()
    belief = observe(model, start(model, 0.0, 40.0), 1.0, 40.0)
    once = advance(model, belief, 601.0)
    many = belief
    for step in range(1, 601):
        many = advance(model, many, 1.0 + step)
    assert [once.x, once.m, once.xx, once.xm, once.mm] == pytest.approx([many.x, many.m, many.xx, many.xm, many.mm])
    assert once.sigma > 10 * belief.sigma


@pytest.mark.parametrize("max_rate", [float("inf"), 0.05])
def test_a_filter_without_readings_is_the_closed_form_simulation(max_rate: float) -> None:
    model = two_states(gain=0.1, max_rate=max_rate)
    rows = np.arange(0.0, 300.0, 20.0)
    events = (Event(35.0, "W_ON"), Event(120.0, "W_OFF"), Event(120.0, "W_ON"), Event(200.0, UNKNOWN))
    current = np.where(rows < 160.0, 40.0, 90.0)
    trace = Trace("t", rows, {"T": np.r_[30.0, np.full(rows.size - 1, np.nan)], "A": current}, events)
    run = filter_trace(model, trace)
    open_loop = moments(schedule(model, events, rows, inputs=trace), 30.0, model.sensor_sigma**2)
    assert run.x == pytest.approx(open_loop.mean, rel=1e-9)
    assert run.xx == pytest.approx(open_loop.variance, rel=1e-9)


def test_inputs_act_from_their_own_time_on() -> None:
    model = single(relaxing(0.01, 0.0, [Input("A", 0.2, 50.0)]), normal(40.0, 0.0), sensor=0.0)
    belief = start(model, 0.0, 40.0, {"A": 50.0})
    belief = with_inputs(model, belief, 10.0, {"A": 100.0, "unused": 3.0, "B": float("nan")})
    assert belief.x == pytest.approx(40.0)
    assert belief.signals == {"A": 100.0}
    later = with_inputs(model, belief, 110.0, {"A": 0.0})
    assert later.x == pytest.approx(50.0 - 10.0 * np.exp(-1.0))
    assert later.offset == pytest.approx(-10.0)
    assert with_inputs(model, later, 5.0, {"A": 50.0}).time == 110.0


@pytest.mark.parametrize("sensor", [0.0, 0.2])
def test_a_perfect_sensor_and_repeated_times_work(sensor: float) -> None:
    model = two_states(sensor=sensor)
    belief = start(model, 0.0, 30.0)
    for time, reading in ((1.0, 30.1), (1.0, 30.1), (1.0, 30.2), (2.0, 30.3)):
        belief = observe(model, belief, time, reading)
    assert 0 <= belief.xx < 0.05
    assert np.isfinite(belief.evidence)
    if sensor == 0.0:
        assert belief.x == pytest.approx(30.3, abs=1e-4)


def test_a_noiseless_flow_with_a_perfect_sensor_works() -> None:
    model = single(Flow("constant", {"noise": 0.0}), None, sensor=0.0)
    belief = observe(model, observe(model, start(model, 0.0, 30.0), 5.0, 30.0), 6.0, 31.0)
    assert np.isfinite([belief.x, belief.xx, belief.evidence]).all()
    assert anomaly(belief) == 99.0


def test_what_comes_late_is_counted_and_a_late_event_still_moves() -> None:
    model = two_states()
    belief = start(model, 10.0, 30.0)
    ignored = observe(model, belief, 9.0, 99.0)
    assert replace(ignored, late=0) == belief
    assert ignored.late == 1
    moved = on_event(model, belief, Event(9.0, "W_ON"))
    assert (moved.location, moved.entered, moved.time, moved.late) == ("hot", 10.0, 10.0, 1)
    with pytest.raises(ValueError, match="only goes forward"):
        advance(model, belief, 9.0)
    assert observe(model, belief, float("nan"), 30.0).late == 1


def test_a_reading_that_is_no_number_only_advances() -> None:
    model = two_states()
    belief = start(model, 0.0, 30.0)
    assert observe(model, belief, 5.0, float("nan")) == advance(model, belief, 5.0)


def test_events_without_an_edge_follow_the_policy_and_are_counted() -> None:
    model = two_states()
    hot = on_event(model, start(model, 0.0, 30.0), Event(1.0, "W_ON"))
    resync = on_event(model, hot, Event(2.0, "W_ON"))
    assert (resync.location, resync.entered, resync.unmatched) == ("hot", 2.0, 1)
    stranger = on_event(model, hot, Event(2.0, "A_3"))
    assert (stranger.location, stranger.unmatched) == ("cold", 1)
    ignored = on_event(compile_model(model, policy="ignore"), hot, Event(2.0, "A_3"))
    assert (ignored.location, ignored.entered, ignored.unmatched) == ("hot", 1.0, 1)


def test_unknown_leads_to_the_initial_location_and_is_no_error() -> None:
    model = two_states()
    hot = on_event(model, start(model, 0.0, 30.0), Event(1.0, "W_ON"))
    lost = on_event(model, hot, Event(2.0, UNKNOWN))
    assert (lost.location, lost.entered, lost.unmatched) == ("cold", 2.0, 0)
    assert (lost.m, lost.mm, lost.xm) == (25.0, 1.0, 0.0)


def test_resample_draws_x_and_parameter_keeps_it() -> None:
    sha = SHA(
        "r",
        (
            Location("a", relaxing(0.01, 0.01), normal(30.0, 1.0)),
            Location("b", Flow("constant", {"noise": 0.01}), normal(50.0, 2.0), "resample"),
        ),
        (Edge("a", "go", "b"), Edge("b", "back", "a")),
        "a",
    )
    model = Model(sha, DECANTER, "T", 0.1)
    belief = start(model, 0.0, 20.0)
    there = on_event(model, belief, Event(1.0, "go"))
    assert (there.x, there.xx, there.xm) == (50.0, 4.0, 0.0)
    back = on_event(model, there, Event(1.0, "back"))
    assert (back.x, back.xx, back.m, back.mm) == (50.0, 4.0, 30.0, 1.0)


def test_before_any_temperature_the_belief_is_as_wide_as_the_range_and_the_first_reading_sets_it() -> None:
    model = two_states()
    blind = start(model, 0.0)
    assert not blind.seen
    assert blind.sigma == pytest.approx(150.0 / np.sqrt(12.0))
    seen = observe(model, blind, 5.0, 33.0)
    assert (seen.seen, seen.x, seen.samples, seen.last) == (True, 33.0, 1, None)
    known = start(replace(model, initial=normal(20.0, 2.0)), 0.0)
    assert (known.x, known.sigma) == (20.0, 2.0)


def test_a_saturated_rate_limits_the_mean_and_not_the_covariance() -> None:
    fast, slow = two_states(), two_states(max_rate=0.05)
    beliefs = [on_event(model, start(model, 0.0, 20.0), Event(0.0, "W_ON")) for model in (fast, slow)]
    free, limited = (advance(m, b, 100.0) for m, b in zip((fast, slow), beliefs, strict=True))
    assert limited.x == pytest.approx(25.0)
    assert free.x > 35.0
    assert limited.xx == free.xx


def test_a_trace_with_missing_readings_gives_rows_without_predictions() -> None:
    model = two_states()
    readings = np.array([np.nan, 30.0, np.nan, 30.2])
    run = filter_trace(model, Trace("t", np.arange(4.0), {"T": readings}, (Event(0.5, "W_ON"),)))
    assert np.isnan(run.predicted).tolist() == [True, True, True, False]
    assert run.locations == ("cold", "hot", "hot", "hot")
    assert run.innovation[3] == pytest.approx(30.2 - run.predicted[3])
    unread = filter_trace(two_states(gain=0.1), Trace("t", np.arange(2.0), {"T": readings[:2]}))
    assert unread.belief.signals == {} and unread.x[1] == 30.0, "an input that no row has"
    with pytest.raises(ValueError, match="no signal 'T'"):
        filter_trace(model, Trace("t", np.arange(4.0), {}))
    with pytest.raises(ValueError, match="no row"):
        filter_trace(model, Trace("t", np.empty(0), {"T": np.empty(0)}))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"sensor_sigma": -1.0}, "sensor_sigma must be at least 0"),
        ({"sha": SHA("x", (Location("q", Flow("warp", {})),), (), "q")}, "unknown flow 'warp'"),
    ],
)
def test_a_model_that_cannot_run_is_refused(change: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        compile_model(replace(two_states(), **change))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="window"):
        compile_model(two_states(), window=0)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.floats(-5, 50) | st.just(float("nan")),
            st.sampled_from(["W_ON", "W_OFF", UNKNOWN, "A_9", None]),
            st.floats(-1e3, 1e3) | st.sampled_from([float("nan"), float("inf")]),
        ),
        max_size=25,
    )
)
def test_whatever_comes_online_the_filter_goes_on_with_a_proper_covariance(
    steps: list[tuple[float, str | None, float]],
) -> None:
    tracker = compile_model(two_states(sensor=0.0, gain=0.1))
    belief = start(tracker, 0.0)
    for move, symbol, value in steps:
        time = belief.time + move
        if symbol is None:
            belief = with_inputs(tracker, observe(tracker, belief, time, value), time, {"A": value})
        else:
            belief = on_event(tracker, belief, Event(time, symbol))
        assert np.isfinite([belief.x, belief.m, belief.xx, belief.xm, belief.mm]).all()
        assert belief.xx >= 0 <= belief.mm
        assert belief.xm**2 <= belief.xx * belief.mm * (1 + 1e-9) + 1e-12
        assert 0 <= anomaly(belief) <= 99


def test_a_sojourn_law_is_no_mode_parameter_but_any_law_with_moments_may_be() -> None:
    model = single(relaxing(0.01, 0.01), Distribution("weibull", {"shape": 2.0, "scale": 40.0}))
    belief = start(model, 0.0, 20.0)
    assert belief.m == pytest.approx(40.0 * np.sqrt(np.pi) / 2)


def test_a_belief_begins_with_nothing_read_and_x_and_m_apart() -> None:
    model = single(relaxing(0.01, 0.02, [Input("A", 0.5, 50.0)]), normal(40.0, 3.0), low=-10.0, high=90.0)
    begun = start(model, 7.0, signals={"A": 60.0, "B": 1.0})
    assert begun == Belief(
        location="q",
        entered=7.0,
        time=7.0,
        x=40.0,
        m=40.0,
        xx=100.0**2 / 12.0,
        xm=0.0,
        mm=9.0,
        offset=5.0,
        signals={"A": 60.0},
    )
    assert start(model, 7.0, signals={"A": float("inf")}).signals == {}
    read = start(model, 7.0, 21.0)
    assert read == replace(start(model, 7.0), x=21.0, xx=0.1 * 0.1, samples=1, seen=True, read_at=7.0)
    endless = start(single(relaxing(0.01, 0.02), normal(40.0, 3.0), low=-float("inf"), high=90.0), 0.0)
    assert (endless.x, endless.xx) == (0.0, 1000.0**2 / 12.0)
    drawn = single(relaxing(0.01, 0.02), normal(40.0, 3.0), entry="resample")
    assert (start(drawn, 0.0).x, start(drawn, 0.0).xx) == (40.0, 9.0)
    for time in (float("nan"), float("inf")):
        with pytest.raises(ValueError, match=r"cannot start at (nan|inf) s"):
            start(model, time)


def test_a_step_beyond_the_range_is_put_back_to_its_border_and_counted() -> None:
    model = single(Flow("linear", {"noise": 0.0}), normal(1.0, 0.0), low=20.0, high=50.0)
    for rate in (1.0, -1.0):
        begun = replace(start(model, 0.0, 35.0), m=rate)
        at_border = advance(model, begun, 15.0)
        assert (at_border.x, at_border.clamps) == (35.0 + 15.0 * rate, 0), "the border itself is inside"
        beyond = advance(model, at_border, 16.0)
        assert (beyond.x, beyond.clamps) == (at_border.x, 1)
        assert advance(model, beyond, 17.0).clamps == 2 and advance(model, beyond, 16.0).clamps == 1
        seen = observe(model, beyond, 17.0, at_border.x + 3.0 * rate)
        assert seen.clamps == 2 and seen.last is not None and seen.last.value == pytest.approx(3.0 * rate)
        assert (seen.x - at_border.x) * rate > 0, "what the sensor says beyond it is believed"
        anew = restart(model, replace(seen, seen=False), 44.0)
        assert anew == replace(seen, x=44.0, xx=0.1 * 0.1, xm=0.0, clamps=0, read_at=17.0)


def test_one_step_of_the_filter_by_hand() -> None:
    # A linear flow: X gains m each second, with a noise of 0.3 degC in a second; the sensor's variance is 0.04.
    model = single(Flow("linear", {"noise": 0.3}), normal(2.0, 0.5), sensor=0.2)
    begun = replace(start(model, 0.0, 30.0), m=2.0, evidence=-7.0, recent=(4.0,))
    seen = observe(model, begun, 4.0, 41.0)
    xx, xm, mm = 0.04 + 16.0 * 0.25 + 4.0 * 0.09, 4.0 * 0.25, 0.25
    expected = xx + 0.04
    value, square = 41.0 - 38.0, 9.0 / expected
    assert seen.last is not None
    assert (seen.last.value, seen.last.variance, seen.last.square) == pytest.approx((value, expected, square))
    assert seen.recent == pytest.approx((4.0, square))
    assert (seen.x, seen.m) == pytest.approx((38.0 + xx / expected * value, 2.0 + xm / expected * value))
    assert (seen.xx, seen.xm) == pytest.approx((xx * 0.04 / expected, xm * 0.04 / expected))
    assert seen.mm == pytest.approx(mm - xm * xm / expected)
    assert seen.evidence == pytest.approx(-7.0 - 0.5 * np.log(2 * np.pi * expected) - 0.5 * square)
    assert (seen.time, seen.read_at, seen.samples, seen.late, seen.seen) == (4.0, 4.0, 2, 0, True)
    again = observe(model, seen, 5.0, 42.0)
    assert again.xm != 0.0
    carried = seen.xx + 2.0 * seen.xm + seen.mm + 0.09
    assert again.last is not None and again.last.variance == pytest.approx(carried + 0.04)


def test_errors_that_last_correct_less_and_are_expected_all_the_same() -> None:
    model = replace(single(Flow("constant", {"noise": 0.5}), None, sensor=0.2), sensor_memory=60.0)
    for read_at, since in ((0.0, 4.0), (-56.0, 60.0), (4.0, 0.06), (4.0, 0.0)):
        begun = replace(start(model, 0.0, 30.0), read_at=read_at)
        seen = observe(model, begun, 4.0, 31.0)
        xx = 0.04 + 4.0 * 0.25
        factor = 1.0 / np.tanh(0.5 * max(since / 60.0, 1e-3))
        assert seen.last == Innovation(1.0, pytest.approx(xx + 0.04), pytest.approx(1.0 / (xx + 0.04)))
        assert seen.x == pytest.approx(30.0 + xx / (xx + 0.04 * factor))
        assert seen.xx == pytest.approx(xx * 0.04 * factor / (xx + 0.04 * factor))
    unread = observe(model, replace(start(model, 0.0, 30.0), read_at=None), 4.0, 31.0)
    assert unread.x == pytest.approx(30.0 + xx / (xx + 0.04)), "nothing was read by which it could be the same error"


def test_only_times_from_now_on_are_taken() -> None:
    model = two_states(gain=0.1)
    belief = start(model, 10.0, 30.0)
    inf, nan = float("inf"), float("nan")
    for time in (9.9, inf, -inf, nan):
        assert observe(model, belief, time, 30.0) == replace(belief, late=1)
        with pytest.raises(ValueError, match="time only goes forward"):
            advance(model, belief, time)
        late = on_event(model, belief, Event(time, "W_ON"))
        assert (late.late, late.time, late.entered, late.location) == (1, 10.0, 10.0, "hot")
        held = with_inputs(model, belief, time, {"A": 60.0})
        assert held == replace(belief, signals={"A": 60.0}, offset=0.0)
    assert advance(model, belief, 10.0) == belief
    assert observe(model, belief, 10.0, 30.0).late == 0 == on_event(model, belief, Event(10.0, "W_ON")).late
    assert with_inputs(model, belief, 12.0, {"A": nan}) == advance(model, belief, 12.0)


def test_an_event_begins_a_stay_of_its_own() -> None:
    model = two_states(gain=0.1)
    begun = replace(start(model, 0.0, 30.0, {"A": 70.0}), hidden=None)
    hot = on_event(model, begun, Event(5.0, "W_ON"))
    before = advance(model, begun, 5.0)
    assert hot == replace(before, location="hot", entered=5.0, m=70.0, mm=9.0, xm=0.0, offset=0.1 * 20.0)
    ignoring = compile_model(model, policy="ignore")
    late = on_event(ignoring, hot, Event(4.0, "A_3"))
    assert late == replace(hot, late=1, unmatched=1)


def test_the_window_of_the_anomaly_test_holds_the_newest_readings() -> None:
    tracker = compile_model(two_states(), window=3)
    belief, squares = start(tracker, 0.0, 30.0), []
    for second in range(1, 6):
        belief = observe(tracker, belief, float(second), 30.0 + second)
        assert belief.last is not None
        squares.append(belief.last.square)
    assert belief.recent == tuple(squares[-3:]) and belief.samples == 6
    assert anomaly(replace(belief, recent=())) == 0.0


def test_without_effects_there_is_no_machines_offset() -> None:
    model = two_states()
    belief = start(model, 0.0, 30.0)
    assert machine_offset(model, belief) is None and with_machine_offset(model, belief, 1.0, 2.0) is belief
