"""Every closed form against the differential equation that it claims to solve."""

from math import exp, inf, log

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from sim.sha import flows
from sim.sha.automaton import Flow, Input

CONSTANTS = {
    "constant": {},
    "linear": {},
    "exponential": {"k": 0.02},
    "driven": {"k": 0.02},
    "logarithmic": {"t0": 5.0},
    "transient": {"tau": 5.0},
}
DRIVEN_BY = (Input("Assorbimento", gain=0.1, reference=150.0),)


def flow(kind: str, noise: float = 0.3) -> Flow:
    return Flow(kind, {**CONSTANTS[kind], "noise": noise}, DRIVEN_BY if kind == "driven" else ())


def drift(kind: str, x: float, target: float, age: float) -> float:
    """Written anew from the table of the method, not taken from the code under test."""
    if kind in ("exponential", "driven"):
        return 0.02 * (target - x)
    if kind == "transient":
        return target / 5.0 * exp(-age / 5.0)
    return {"constant": 0.0, "linear": target, "logarithmic": target / (5.0 + age)}[kind]


def solved(kind: str, x: float, target: float, age: float, dt: float, rate: float) -> float:
    def slope(t: float, y: list[float]) -> list[float]:
        return [min(max(drift(kind, y[0], target, age + t), -rate), rate)]

    # The limited drift has a kink, so short steps rather than trust in the error estimate.
    done = solve_ivp(slope, (0.0, dt), [x], rtol=1e-9, atol=1e-11, max_step=dt / 400)
    return float(done.y[0, -1])


def target_of(kind: str, sign: int) -> float:
    return {"linear": sign * 0.08, "logarithmic": sign * 3.0, "transient": sign * 3.0}.get(kind, 40.0 + sign * 25.0)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("kind", flows.FLOWS)
@pytest.mark.parametrize("rate", [inf, 10.0, 0.1, 0.05], ids=["free", "never met", "met, then left", "met for longer"])
@pytest.mark.parametrize("dt", [3.0, 60.0], ids=["ends on the ramp", "ends after it"])
def test_mean_step_solves_the_differential_equation(kind: str, sign: int, rate: float, dt: float) -> None:
    target = target_of(kind, sign)
    step = flows.mean_step(flow(kind), 40.0, target, age=2.0, dt=dt, max_rate=rate)
    assert float(step) == pytest.approx(solved(kind, 40.0, target, 2.0, dt, rate), abs=2e-5)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("kind", ["exponential", "driven"])
@pytest.mark.parametrize("dt", [10.0, 37.5, 38.0, 500.0])
def test_relaxing_flows_leave_the_limit_at_the_closed_form_moment(kind: str, sign: int, dt: float) -> None:
    rate = 0.4  # left after (|d| - R/k) / R = (35 - 20) / 0.4 = 37.5 s
    target = 40.0 + sign * 35.0
    step = float(flows.mean_step(flow(kind), 40.0, target, age=0.0, dt=dt, max_rate=rate))
    assert step == pytest.approx(solved(kind, 40.0, target, 0.0, dt, rate), abs=2e-5)
    if dt <= 37.5:
        assert step == pytest.approx(40.0 + sign * rate * dt)


@pytest.mark.parametrize("dt", [2.0, 23.0, 30.0, 400.0])
def test_logarithmic_leaves_the_limit_when_its_drift_has_fallen_to_it(dt: float) -> None:
    # 3 / (5 + u) = 0.1 at u = 25, so 23 s after an age of 2 s
    step = float(flows.mean_step(flow("logarithmic"), 40.0, 3.0, age=2.0, dt=dt, max_rate=0.1))
    assert step == pytest.approx(solved("logarithmic", 40.0, 3.0, 2.0, dt, 0.1), abs=2e-5)
    if dt <= 23.0:
        assert step == pytest.approx(40.0 + 0.1 * dt)


@pytest.mark.parametrize("dt", [2.0, 6.9, 7.0, 400.0])
def test_transient_leaves_the_limit_when_its_drift_has_fallen_to_it(dt: float) -> None:
    # 3 / 5 exp(-u / 5) = 0.1 at u = 5 ln 6 = 8.96, so 6.96 s after an age of 2 s
    step = float(flows.mean_step(flow("transient"), 40.0, 3.0, age=2.0, dt=dt, max_rate=0.1))
    assert step == pytest.approx(solved("transient", 40.0, 3.0, 2.0, dt, 0.1), abs=2e-5)
    if dt <= 5.0 * log(6.0) - 2.0:
        assert step == pytest.approx(40.0 + 0.1 * dt)


def test_a_transient_moves_by_its_amplitude_in_all_and_is_then_over() -> None:
    entered = flows.mean_step(flow("transient"), 40.0, -3.0, age=0.0, dt=np.array([0.0, 5.0, 1e6]), max_rate=inf)
    assert entered == pytest.approx([40.0, 40.0 - 3.0 * (1.0 - exp(-1.0)), 37.0])
    assert float(flows.mean_step(flow("transient"), 40.0, 3.0, age=1e6, dt=100.0, max_rate=inf)) == 40.0


@pytest.mark.parametrize(("kind", "half"), [("logarithmic", 5.0), ("transient", 5.0 * log(2.0)), ("linear", inf)])
def test_fading_says_when_the_drift_has_fallen_to_a_part(kind: str, half: float) -> None:
    age = float(flows.fade_ages(flow(kind), 0.5))
    assert age == pytest.approx(half)
    if age < inf:
        assert drift(kind, 40.0, 3.0, age) == pytest.approx(0.5 * drift(kind, 40.0, 3.0, 0.0))


@pytest.mark.parametrize("kind", flows.FLOWS)
def test_variance_solves_its_own_equation(kind: str) -> None:
    # dV/dt = -2 k V + s^2 for a relaxing flow, s^2 otherwise
    k = CONSTANTS[kind].get("k", 0.0)
    done = solve_ivp(lambda _, v: [-2.0 * k * v[0] + 0.09], (0.0, 47.0), [0.0], rtol=1e-10, atol=1e-12)
    _, _, variance = flows.coefficients(flow(kind), 3.0, 47.0)
    assert float(variance) == pytest.approx(done.y[0, -1], rel=1e-7)


@pytest.mark.parametrize("kind", flows.FLOWS)
@pytest.mark.parametrize("rate", [inf, 0.05])
@given(
    x=st.floats(0, 150),
    pull=st.floats(-3, 3),
    age=st.floats(0, 1e4),
    first=st.floats(0, 1e3),
    second=st.floats(0, 1e3),
)
@settings(max_examples=40, deadline=None)
def test_one_step_equals_two(
    kind: str, rate: float, x: float, pull: float, age: float, first: float, second: float
) -> None:
    target = 75.0 + 25.0 * pull if kind in flows.RELAXING_FLOWS else pull
    one = flows.mean_step(flow(kind), x, target, age=age, dt=first + second, max_rate=rate)
    half = flows.mean_step(flow(kind), x, target, age=age, dt=first, max_rate=rate)
    two = flows.mean_step(flow(kind), half, target, age=age + first, dt=second, max_rate=rate)
    assert float(two) == pytest.approx(float(one), rel=1e-9, abs=1e-7)
    decay1, pull1, noise1 = flows.coefficients(flow(kind), age, first)
    decay2, pull2, noise2 = flows.coefficients(flow(kind), age + first, second)
    decay, pull_all, noise = flows.coefficients(flow(kind), age, first + second)
    assert float(decay1 * decay2) == pytest.approx(float(decay), abs=1e-12)
    assert float(decay2 * pull1 + pull2) == pytest.approx(float(pull_all), rel=1e-9, abs=1e-9)
    assert float(decay2**2 * noise1 + noise2) == pytest.approx(float(noise), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("kind", flows.FLOWS)
def test_drift_is_the_slope_of_the_mean(kind: str) -> None:
    target, h = target_of(kind, 1), 1e-6
    slope = (flows.mean_step(flow(kind), 40.0, target, age=7.0, dt=h, max_rate=inf) - 40.0) / h
    assert float(flows.drift(flow(kind), 40.0, target, 7.0)) == pytest.approx(float(slope), rel=1e-5, abs=1e-9)


def test_arguments_broadcast() -> None:
    result = flows.mean_step(flow("exponential"), np.zeros((4, 1)), np.arange(3.0), age=0.0, dt=10.0, max_rate=0.01)
    assert result.shape == (4, 3)
    assert all(part.shape == (5,) for part in flows.coefficients(flow("linear"), 0.0, np.arange(5.0)))


def test_a_very_long_or_empty_step_stays_finite() -> None:
    for kind in flows.FLOWS:
        decay, pull, variance = flows.coefficients(flow(kind), 0.0, np.array([0.0, 1e12]))
        assert decay[0] == 1.0
        assert pull[0] == variance[0] == 0.0
        assert np.all(np.isfinite([decay, pull, variance]))


def test_offset_adds_what_each_input_says() -> None:
    two = Flow("driven", {"k": 0.1, "noise": 0.0}, (Input("I", 0.1, 150.0), Input("T", 0.5, 20.0)))
    assert flows.offset(two, {"I": [150.0, 160.0], "T": 22.0}).tolist() == [1.0, 2.0]
    assert float(flows.offset(flow("linear"), {})) == 0.0


@pytest.mark.parametrize(
    ("bad", "said"),
    [
        (Flow("quadratic", {}), "unknown flow 'quadratic'"),
        (Flow("exponential", {"noise": 0.1}), "takes the constants k, noise"),
        (Flow("linear", {"noise": 0.1, "k": 1.0}), "takes the constants noise"),
        (Flow("exponential", {"k": 0.0, "noise": 0.1}), "k must be positive and finite"),
        (Flow("exponential", {"k": inf, "noise": 0.1}), "k must be positive and finite"),
        (Flow("transient", {"tau": 0.0, "noise": 0.1}), "tau must be positive and finite"),
        (Flow("transient", {"t0": 1.0, "noise": 0.1}), "takes the constants tau, noise"),
        (Flow("constant", {"noise": -0.1}), "noise must be at least 0 and finite"),
        (Flow("linear", {"noise": 0.1, "m": inf}), "m must be finite"),
        (Flow("driven", {"k": 1.0, "noise": 0.1}), "needs inputs"),
        (Flow("constant", {"noise": 0.1}, DRIVEN_BY), "takes none"),
        (Flow("driven", {"k": 1.0, "noise": 0.1}, (Input("I", inf),)), "'I': gain inf"),
        (
            Flow("driven", {"k": 1.0, "noise": 0.1}, (Input("I", 1.0, -inf),)),
            "gain 1.0 and reference -inf must be finite",
        ),
        (Flow("linear", {}), "takes the constants noise .and m, where nothing draws it.; got none"),
        (Flow("quadratic", {}), "known are constant, linear, exponential, driven, logarithmic, transient"),
    ],
)
def test_an_unusable_flow_is_refused_with_what_would_be_right(bad: Flow, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        flows.check_flow(bad)


def test_a_negative_fixed_parameter_is_a_cooling_drift_and_allowed() -> None:
    flows.check_flow(Flow("linear", {"noise": 0.0, "m": -0.05}))


@pytest.mark.parametrize("kind", CONSTANTS)
def test_whole_numbers_are_numbers_like_others(kind: str) -> None:
    given, real = flow(kind), [1.0, 2.0]
    for whole in ([1, 2], np.array([1, 2]), np.array([1, 2], dtype=np.int8)):
        for rate in (0.01, inf):
            step = flows.mean_step(given, whole, whole, age=whole, dt=whole, max_rate=rate)
            wanted = flows.mean_step(given, real, real, age=real, dt=real, max_rate=rate)
            assert step.dtype == np.float64 and step.tolist() == wanted.tolist()
        for found, wanted in zip(
            flows.coefficients(given, whole, whole), flows.coefficients(given, real, real), strict=True
        ):
            assert found.dtype == np.float64 and found.tolist() == wanted.tolist()
        slope = flows.drift(given, whole, whole, whole)
        assert slope.dtype == np.float64 and slope.tolist() == flows.drift(given, real, real, real).tolist()
    assert flows.fade_ages(given, 1).dtype == np.float64
    if kind == "driven":
        many = np.array([200], dtype=np.uint8)
        assert flows.offset(given, {"Assorbimento": many}).tolist() == [5.0]


def test_only_a_relaxing_flow_leaves_its_limit_by_distance() -> None:
    for kind in CONSTANTS:
        wanted = 0.5 / 0.02 if kind in ("exponential", "driven") else inf
        assert flows.free_distance(flow(kind), 0.5) == wanted


def test_without_noise_a_relaxing_flow_has_the_same_mean_and_no_variance() -> None:
    decay, pull, variance = flows.coefficients(flow("exponential", 0.0), 3.0, [0.0, 10.0])
    loud = flows.coefficients(flow("exponential", 0.3), 3.0, [0.0, 10.0])
    assert (decay.tolist(), pull.tolist(), variance.tolist()) == (loud[0].tolist(), loud[1].tolist(), [0.0, 0.0])
    assert loud[2][1] == pytest.approx(0.09 * (1.0 - exp(-0.4)) / 0.04)
