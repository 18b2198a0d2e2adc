"""Sample moments and laws of many runs against the closed forms, within stated statistical error; all seeds fixed."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from sim.engine.moment_equations import moments
from sim.engine.schedules import Schedule, schedule
from sim.engine.simulation import CHUNK_RUNS, simulate
from sim.sha.automaton import SHA, Distribution, Edge, Flow, Location
from sim.sha.trace import Array, Event, Trace
from tests.sha.models import EVERYWHERE, limited, normal
from tests.sha.test_moments import EVENTS, INPUTS, OUTPUTS

RUNS = 20_000
SIGMAS = 5.0
"""A mean may lie 5 standard errors off; with some 100 outputs the chance of a false alarm is below 1e-4."""


def assert_moments(sample: Array, mean: Array, variance: Array) -> None:
    runs = sample.shape[0]
    spread = np.sqrt(variance)
    assert np.all(np.abs(sample.mean(axis=0) - mean) <= SIGMAS * spread / np.sqrt(runs) + 1e-9)
    assert np.all(np.abs(sample.var(axis=0) - variance) <= SIGMAS * variance * np.sqrt(2.0 / runs) + 1e-9)


def run(steps: Schedule, x0: float | Distribution = 20.0, runs: int = RUNS, seed: int = 1) -> Array:
    return simulate(steps, x0, runs, np.random.default_rng(seed)).temperatures


@pytest.mark.parametrize("outputs", [OUTPUTS, OUTPUTS[::9], OUTPUTS[-1:]], ids=["dense", "sparse", "end only"])
@pytest.mark.parametrize("x0", [20.0, normal(20.0, 2.0)], ids=["known start", "law of the start"])
def test_sample_moments_are_the_closed_form(outputs: Array, x0: float | Distribution) -> None:
    steps = schedule(EVERYWHERE, EVENTS, outputs, start=0.0, inputs=INPUTS)
    foreseen = moments(steps, 20.0, 0.0 if isinstance(x0, float) else 4.0)
    assert_moments(run(steps, x0), foreseen.mean, foreseen.variance)


def test_many_input_steps_between_two_outputs_add_up_to_one() -> None:
    readings = Trace("in", np.arange(0.0, 300.0), {"Assorbimento": 50.0 + np.arange(0.0, 300.0) % 97.0})
    steps = schedule(EVERYWHERE, [Event(0.0, "idle")], [0.0, 100.0, 300.0], inputs=readings)
    assert steps.dt.size > 290
    foreseen = moments(steps, 20.0)
    assert_moments(run(steps), foreseen.mean, foreseen.variance)
    noisy = replace(EVERYWHERE, locations=tuple(_without_spread(location) for location in EVERYWHERE.locations))
    steps = schedule(noisy, [Event(0.0, "idle")], [0.0, 100.0, 300.0], inputs=readings)
    assert_moments(run(steps), moments(steps, 20.0).mean, moments(steps, 20.0).variance)


def _without_spread(location: Location) -> Location:
    law = location.distribution
    return location if law is None else replace(location, distribution=normal(law.params["mu"], 0.0))


def test_outputs_of_one_run_are_correlated_as_the_process_is() -> None:
    # X(t) = x0 + m t without noise: all outputs of a stay lie on one line per run.
    sha = SHA("m", (Location("q", Flow("linear", {"noise": 0.0}), normal(0.1, 0.02)),), (), "q")
    sample = run(schedule(sha, [], [0.0, 10.0, 30.0]))
    np.testing.assert_allclose(sample[:, 2] - 20.0, 3.0 * (sample[:, 1] - 20.0), rtol=1e-9)


def test_merging_steps_leaves_the_joint_law_of_the_outputs() -> None:
    # The covariance of two outputs three stays apart, once with only these outputs and once among many.
    few = run(schedule(EVERYWHERE, EVENTS[:4], [40.0, 140.0], start=0.0, inputs=INPUTS), seed=2)
    many = run(schedule(EVERYWHERE, EVENTS[:4], np.arange(0.0, 141.0), start=0.0, inputs=INPUTS), seed=3)[:, [40, 140]]
    one, other = np.cov(few.T), np.cov(many.T)
    assert np.all(np.abs(one - other) <= 2 * SIGMAS * np.sqrt(2.0 / RUNS) * np.sqrt(np.outer(*(np.diag(one),) * 2)))
    assert abs(one[0, 1]) > 0.1


@pytest.mark.parametrize("rate", [0.05, 10.0])
@pytest.mark.parametrize("at", [10.0, 60.0])
def test_at_a_limited_rate_each_run_moves_by_its_own_parameter(rate: float, at: float) -> None:
    # Without noise X is a monotone function of m: its law follows from m's by the closed form.
    flow = Flow("exponential", {"k": 0.02, "noise": 0.0})
    sha = SHA("m", (Location("q", flow, normal(24.0, 3.0)),), (), "q", max_rate=rate)
    result = simulate(schedule(sha, [], [0.0, at]), 20.0, RUNS, np.random.default_rng(4))

    def temperature(m: Array) -> Array:
        distance, fast = m - 20.0, np.abs(m - 20.0) > rate / 0.02
        leave = np.where(fast, (np.abs(distance) - rate / 0.02) / rate, 0.0)
        ramp = np.minimum(leave, at)
        reached = 20.0 + np.sign(distance) * rate * ramp
        return m + (reached - m) * np.exp(-0.02 * (at - ramp))

    # Dvoretzky-Kiefer-Wolfowitz: the empirical law is within 0.016 of the true one but for 1 case in 10,000.
    rank = (np.arange(RUNS) + 0.5) / RUNS
    found, m = np.sort(result.temperatures[:, 1]), stats.norm(24.0, 3.0)
    assert np.all(found >= temperature(m.ppf(np.maximum(rank - 0.016, 1e-12))) - 1e-9)
    assert np.all(found <= temperature(m.ppf(np.minimum(rank + 0.016, 1 - 1e-12))) + 1e-9)
    met = np.mean(result.limited > 0)
    expected = 1.0 - (stats.norm(24.0, 3.0).cdf(20.0 + rate / 0.02) - stats.norm(24.0, 3.0).cdf(20.0 - rate / 0.02))
    assert abs(met - expected) <= SIGMAS * np.sqrt(0.25 / RUNS)


def test_a_limit_that_is_never_met_changes_no_moment() -> None:
    steps = schedule(limited(50.0), EVENTS, OUTPUTS, inputs=INPUTS)
    foreseen = moments(steps, 20.0)
    result = simulate(steps, 20.0, RUNS, np.random.default_rng(5))
    assert_moments(result.temperatures, foreseen.mean, foreseen.variance)
    assert result.limited.sum() == 0


@pytest.mark.parametrize("rate", [None, 50.0], ids=["free", "limited"])
@pytest.mark.parametrize("entry", ["parameter", "resample"])
def test_laws_that_are_not_normal_are_drawn_as_they_are(entry: str, rate: float | None) -> None:
    law = Distribution("lognormal", {"mu": 3.4, "sigma": 0.2})
    start = Location("start", Flow("constant", {"noise": 0.0}))
    flow = Flow("exponential", {"k": 10.0, "noise": 0.0}) if entry == "parameter" else Flow("constant", {"noise": 0.0})
    sha = SHA("m", (start, Location("q", flow, law, entry)), (Edge("start", "go", "q"),), "start")
    sha = sha if rate is None else replace(sha, max_rate=rate)
    sample = run(schedule(sha, [Event(1.0, "go")], [0.0, 90.0, 100.0]))
    assert stats.kstest(sample[:, 1], stats.lognorm(0.2, scale=np.exp(3.4)).cdf).pvalue > 1e-3
    np.testing.assert_allclose(sample[:, 1], sample[:, 2], atol=1e-9)


@pytest.mark.parametrize("rate", [None, 50.0], ids=["free", "limited"])
def test_clamps_are_counted_run_by_run_and_flagged(rate: float | None) -> None:
    flow = Flow("linear", {"noise": 0.0})
    sha = SHA("m", (Location("q", flow, normal(0.0, 1.0)),), (), "q", low=10.0, high=30.0)
    sha = sha if rate is None else replace(sha, max_rate=rate)
    steps = schedule(sha, [], [0.0, 5.0, 10.0, 15.0])
    result = simulate(steps, 20.0, 4000, np.random.default_rng(6))
    assert result.temperatures.min() == pytest.approx(10.0)
    assert result.temperatures.max() == pytest.approx(30.0)
    slope = (result.temperatures[:, 1] - 20.0) / 5.0
    gone = result.clamps > 0
    # A run with |m| > 1 is out after 10 s and after 15 s, one with |m| > 2 after 5 s as well; below 2/3 never.
    assert np.all(result.clamps[np.abs(slope) < 0.66] == 0)
    assert np.all(result.clamps[(np.abs(slope) > 0.67) & (np.abs(slope) < 0.99)] == 1)
    assert np.all(result.clamps[(np.abs(slope) > 1.01) & (np.abs(slope) < 1.99)] == 2)
    assert np.mean(result.clamps == 3) == pytest.approx(2 * stats.norm.sf(2.0), abs=0.02)
    assert gone.any()
    assert result.flags[0].startswith(f"clamps: the temperature left the model's range {result.clamps.sum()} times")


def test_equal_seeds_give_equal_runs_and_others_do_not() -> None:
    steps = schedule(EVERYWHERE, EVENTS, OUTPUTS[::20], inputs=INPUTS)
    np.testing.assert_array_equal(run(steps, runs=50, seed=7), run(steps, runs=50, seed=7))
    assert np.all(run(steps, runs=50, seed=7)[:, -1] != run(steps, runs=50, seed=8)[:, -1])


def test_runs_of_different_chunks_are_independent() -> None:
    steps = schedule(EVERYWHERE, EVENTS, OUTPUTS[::20], inputs=INPUTS)
    sample = run(steps, runs=CHUNK_RUNS + 10)
    assert sample.shape == (CHUNK_RUNS + 10, OUTPUTS[::20].size)
    assert np.unique(sample[:, -1]).size == CHUNK_RUNS + 10


def test_the_result_says_where_and_when_the_runs_are() -> None:
    steps = schedule(EVERYWHERE, EVENTS, OUTPUTS, inputs=INPUTS)
    result = simulate(steps, 20.0, 3, np.random.default_rng(9))
    assert result.times.tolist() == OUTPUTS.tolist()
    assert EVERYWHERE.locations[result.final_location].name == EVENTS[-1].symbol
    np.testing.assert_array_equal(result.location, steps.output_location)
    assert np.all(result.temperatures[:, 0] == 20.0)


def test_a_given_array_takes_the_runs() -> None:
    steps = schedule(EVERYWHERE, EVENTS, OUTPUTS, inputs=INPUTS)
    out = np.empty((OUTPUTS.size, 30))
    result = simulate(steps, 20.0, 30, np.random.default_rng(10), out=out)
    assert np.shares_memory(result.temperatures, out)
    np.testing.assert_array_equal(out.T, simulate(steps, 20.0, 30, np.random.default_rng(10)).temperatures)


@pytest.mark.parametrize(
    ("x0", "runs", "shape", "said"),
    [
        (20.0, 0, None, "at least 1 run"),
        (float("nan"), 5, None, "mu=nan is out of range"),
        (Distribution("cauchy", {}), 5, None, "unknown distribution"),
        (20.0, 5, (5, 2), r"out must have the shape \(outputs, runs\) = \(2, 5\), got \(5, 2\)"),
    ],
)
def test_unusable_arguments_are_refused(
    x0: float | Distribution, runs: int, shape: tuple[int, int] | None, said: str
) -> None:
    out = None if shape is None else np.empty(shape)
    with pytest.raises(ValueError, match=said):
        simulate(schedule(EVERYWHERE, [], [0.0, 1.0]), x0, runs, np.random.default_rng(0), out=out)
