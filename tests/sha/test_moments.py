"""Mean and variance in closed form against integration of their equations, step by step and with every entry mode."""

from dataclasses import replace
from math import exp, inf

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sim.engine.moment_equations import moments
from sim.engine.schedules import Schedule, schedule
from sim.sha import flows
from sim.sha.automaton import SHA, Edge, Flow, Location
from sim.sha.entry import draw_temperature, mode_parameter
from sim.sha.trace import Event, Trace
from tests.sha.models import ALL, EVERYWHERE, limited, normal

INPUTS = Trace("in", np.arange(0.0, 400.0, 7.0), {"Assorbimento": 50.0 + 40.0 * np.sin(np.arange(0.0, 400.0, 7.0))})
WORD = ("idle", "load", "load", "peak", "hold", "fresh", "idle", "plain", "off", "fresh", "peak", "settle", "spike")
EVENTS = [Event(20.0 + 30.0 * i, symbol) for i, symbol in enumerate(WORD)]
OUTPUTS = np.arange(0.0, 421.0, 4.0)


def integrated(steps: Schedule, x0: float, v0: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean, variance and covariance with m by an ODE solver, one piece a step: slow, and nothing shared."""
    mean, variance, covariance, rows = x0, v0, 0.0, []
    for k in range(steps.dt.size):
        location = steps.sha.locations[steps.location[k]]
        m, spread = mode_parameter(location)
        if steps.entry[k]:
            covariance = 0.0
        law = draw_temperature(location)
        if steps.entry[k] and k > 0 and law is not None:
            mean, variance = law.params["mu"], law.params["sigma"] ** 2
        k_rate, tau = location.flow.params.get("k", 0.0), location.flow.params.get("tau")
        target, s2 = m + steps.offset[k], location.flow.params["noise"] ** 2

        def slope(
            t, y, age=steps.age[k], kind=location.flow.kind, k_rate=k_rate, target=target, s2=s2, spread=spread, tau=tau
        ):
            gain = {"constant": 0.0, "linear": 1.0}.get(kind, k_rate)
            if kind == "logarithmic":
                gain = 1.0 / (10.0 + age + t)
            if kind == "transient":
                gain = exp(-(age + t) / tau) / tau
            return [
                gain * target - k_rate * y[0],
                2.0 * gain * y[2] - 2.0 * k_rate * y[1] + s2,
                gain * spread - k_rate * y[2],
            ]

        if steps.dt[k] > 0:
            done = solve_ivp(slope, (0.0, steps.dt[k]), [mean, variance, covariance], rtol=1e-9, atol=1e-11)
            mean, variance, covariance = done.y[:, -1]
        if steps.output[k] >= 0:
            rows.append((mean, variance))
    return np.array(rows).T


def test_all_flows_and_entry_modes_match_the_integrated_equations() -> None:
    steps = schedule(EVERYWHERE, EVENTS, OUTPUTS, inputs=INPUTS)
    foreseen = moments(steps, 20.0, 0.5)
    mean, variance = integrated(steps, 20.0, 0.5)
    np.testing.assert_allclose(foreseen.mean, mean, atol=1e-6)
    np.testing.assert_allclose(foreseen.variance, variance, rtol=1e-6)
    assert (foreseen.clamps, foreseen.limited, foreseen.flags) == (0, 0, ())
    assert {steps.sha.locations[i].name for i in foreseen.location} == {location.name for location in ALL}


def test_more_outputs_change_nothing_where_they_already_were() -> None:
    sparse = moments(schedule(EVERYWHERE, EVENTS, OUTPUTS[::5], inputs=INPUTS), 20.0)
    dense = moments(schedule(EVERYWHERE, EVENTS, OUTPUTS, inputs=INPUTS), 20.0)
    np.testing.assert_allclose(sparse.mean, dense.mean[::5], rtol=1e-12)
    np.testing.assert_allclose(sparse.variance, dense.variance[::5], rtol=1e-10)


def one(location: Location, **limits: float) -> SHA:
    return SHA("one", (location,), (Edge(location.name, "again", location.name),), location.name, **limits)


def test_the_variance_of_a_stay_keeps_the_covariance_with_its_parameter() -> None:
    # X = x0 + m D exactly: Var = sigma^2 D^2; steps taken as independent would give less.
    steps = schedule(one(Location("q", Flow("linear", {"noise": 0.0}), normal(0.1, 0.02))), [], np.arange(0.0, 101.0))
    np.testing.assert_allclose(moments(steps, 20.0).variance, (0.02 * np.arange(0.0, 101.0)) ** 2, atol=1e-14)


def test_a_new_stay_has_a_parameter_of_its_own() -> None:
    sha = one(Location("q", Flow("linear", {"noise": 0.0}), normal(0.1, 0.02)))
    split = moments(schedule(sha, [Event(50.0, "again")], [0.0, 100.0]), 20.0)
    assert split.variance[-1] == pytest.approx(2 * (0.02 * 50.0) ** 2)


def test_resample_forgets_the_temperature_on_entry_but_not_at_the_start() -> None:
    sha = one(Location("q", Flow("constant", {"noise": 0.0}), normal(45.0, 1.5), "resample"))
    run = moments(schedule(sha, [Event(5.0, "again")], [0.0, 4.0, 5.0, 9.0]), 20.0)
    assert run.mean.tolist() == [20.0, 20.0, 45.0, 45.0]
    assert run.variance.tolist() == [0.0, 0.0, 2.25, 2.25]


def stepwise(steps: Schedule, x0: float) -> tuple[list[float], int]:
    """The mean one step after the other through the limited closed form, with clamps."""
    x, clamps, rows = x0, 0, []
    for k in range(steps.dt.size):
        location = steps.sha.locations[steps.location[k]]
        law = draw_temperature(location)
        if steps.entry[k] and k > 0 and law is not None:
            x = law.params["mu"]
        target = mode_parameter(location)[0] + steps.offset[k]
        x = float(
            flows.mean_step(location.flow, x, target, age=steps.age[k], dt=steps.dt[k], max_rate=steps.sha.max_rate)
        )
        if steps.checked[k] and not steps.sha.low <= x <= steps.sha.high:
            x, clamps = min(max(x, steps.sha.low), steps.sha.high), clamps + 1
        if steps.output[k] >= 0:
            rows.append(x)
    return rows, clamps


@pytest.mark.parametrize("rate", [0.02, 0.1, 0.3, 5.0])
def test_a_rate_limit_holds_in_every_flow_of_a_long_run(rate: float) -> None:
    steps = schedule(limited(rate), EVENTS, OUTPUTS, inputs=INPUTS)
    run = moments(steps, 20.0)
    expected, _ = stepwise(steps, 20.0)
    np.testing.assert_allclose(run.mean, expected, atol=1e-9)
    assert (run.limited > 0) == (rate < 1.0)
    assert ("rate limit" in " ".join(run.flags)) == (rate < 1.0)
    jumps = np.isin(run.times[1:], [event.time for event in EVENTS if event.symbol == "fresh"])
    gaps = np.abs(np.diff(run.mean))[~jumps & (run.location[1:] == run.location[:-1])]
    assert np.all(gaps <= rate * 4.0 + 1e-9)


@pytest.mark.parametrize(("low", "high"), [(0.0, 30.0), (24.0, 150.0), (-inf, 30.0)])
def test_clamps_are_counted_and_flagged(low: float, high: float) -> None:
    steps = schedule(replace(EVERYWHERE, low=low, high=high), EVENTS, OUTPUTS, inputs=INPUTS)
    run = moments(steps, 25.0)
    expected, clamps = stepwise(steps, 25.0)
    np.testing.assert_allclose(run.mean, expected, atol=1e-9)
    assert run.clamps == clamps > 0
    assert run.flags[0].startswith(f"clamps: the temperature left the model's range {clamps} times")


def test_a_start_outside_the_range_is_a_clamp_too() -> None:
    run = moments(schedule(one(Location("q", Flow("constant", {"noise": 0.0})), low=0.0), [], [0.0, 5.0]), -3.0)
    assert run.mean.tolist() == [0.0, 0.0]
    assert run.clamps == 1


def test_clamping_happens_at_events_that_are_no_outputs_too() -> None:
    up, down = Location("up", Flow("linear", {"noise": 0.0, "m": 1.0})), normal(-1.0, 0.0)
    sha = SHA("m", (up, Location("down", Flow("linear", {"noise": 0.0}), down)), (Edge("up", "d", "down"),), "up")
    run = moments(schedule(sha, [Event(15.0, "d")], [0.0, 20.0, 30.0]), 140.0)
    assert run.mean.tolist() == [140.0, 145.0, 135.0]  # 155 at the event becomes 150
    assert run.clamps == 1


@pytest.mark.parametrize(("x0", "v0"), [(float("nan"), 0.0), (20.0, -1.0), (inf, 0.0), (20.0, inf)])
def test_an_unusable_start_is_refused(x0: float, v0: float) -> None:
    with pytest.raises(ValueError, match="start temperature"):
        moments(schedule(EVERYWHERE, [], [1.0]), x0, v0)


def test_a_model_that_cannot_be_executed_is_refused_with_its_location() -> None:
    sha = one(Location("q", Flow("linear", {"noise": -1.0})))
    with pytest.raises(ValueError, match=r"location 'q': .*noise must be at least 0"):
        moments(schedule(sha, [], [0.0, 1.0]), 20.0)


def test_policies_are_reported_with_the_result() -> None:
    run = moments(schedule(one(ALL[0]), [Event(1.0, "new")], [0.0, 2.0], policy="ignore"), 20.0)
    assert run.unmatched == (0,)
    assert run.flags == ("events: 1 had no edge and were passed over",)
