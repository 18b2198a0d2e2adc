"""Heat with a memory and a machine's offset: their law by the covariance equation, in every engine that executes it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sim.effects import disturbance_step
from sim.engine.belief import advance, machine_offset, observe, on_event, start, with_machine_offset
from sim.engine.moment_equations import moments
from sim.engine.plant import compile_plant
from sim.engine.response import respond
from sim.engine.schedules import schedule
from sim.engine.simulation import simulate
from sim.engine.tracker import compile_model
from sim.forecast.fan import forecast
from sim.lab.checking.smc.paths import Cuts
from sim.lab.checking.smc.runs import engine
from sim.lab.checking.smc.start import initial
from sim.lab.uppaal.model_export import export
from sim.proof.bounds import find_bounds
from sim.proof.envelope import Assumptions
from sim.sha.automaton import SHA, Effect, Flow, Location
from sim.sha.events import Alphabet, Switch
from sim.sha.model import Model, Stay
from sim.sha.trace import Array, Event, Trace
from tests.effects.engines import model_of, trace_of
from tests.sha.effect_reference import RANDOM
from tests.sha.models import normal
from tests.uppaal.support import courses

K, NOISE, SIGMA_M = 0.004, 0.01, 1.5
OUTPUTS: Array = np.array([30.0, 120.0, 600.0, 1800.0])
FIVE_SIGMA = 5.0


def sha(*effects: Effect) -> SHA:
    place = Location("on", Flow("exponential", {"k": K, "noise": NOISE}), normal(60.0, SIGMA_M))
    return SHA("one place", (place,), (), "on", low=-500.0, high=500.0, effects=effects)


def model(*effects: Effect) -> Model:
    return Model(sha(*effects), Alphabet((Switch("on", "W_ON", "W_OFF"),)), "T", 0.1, initial=normal(20.0, 0.0))


def variance(effects: tuple[Effect, ...], times: Array) -> Array:
    """(n,) Var X from the covariance equation dP/dt = A P + P A' + Q, X known at the start, integrated numerically."""
    by = {effect.kind: effect.params for effect in effects}
    disturbance, machine = by.get("heat-disturbance"), by.get("machine-offset")
    # States X, m, D, B; what is not there has no variance.
    a = np.zeros((4, 4))
    a[0] = [-K, K, 1.0, K]
    q, p = np.diag([NOISE**2, 0.0, 0.0, 0.0]), np.diag([0.0, SIGMA_M**2, 0.0, 0.0])
    if disturbance:
        a[2, 2] = -1.0 / disturbance["memory"]
        q[2, 2], p[2, 2] = 2.0 * disturbance["sigma"] ** 2 / disturbance["memory"], disturbance["sigma"] ** 2
    if machine:
        p[3, 3] = machine["sigma"] ** 2

    def slope(_: float, flat: Array) -> Array:
        covariance = flat.reshape(4, 4)
        return np.asarray((a @ covariance + covariance @ a.T + q).ravel())

    done = solve_ivp(slope, (0.0, float(times[-1])), p.ravel(), t_eval=times, rtol=1e-10, atol=1e-12, method="LSODA")
    return np.asarray(done.y[0])


@pytest.mark.parametrize("rate", [0.0, 1e-5, 1.0 / 240.0, 0.05], ids=["still", "slow", "as slow", "fast"])
def test_the_closed_step_is_that_of_the_engines_matrices(rate: float) -> None:
    """From a thousandth of a second to a day, at rates below, above and at 1 / memory, where a difference vanishes."""
    memory = RANDOM["heat-disturbance"].params["memory"]
    dt = np.array([0.0, 1e-3, 1.0, 60.0, 240.0, 7000.0, 86400.0])
    k = np.full(dt.size, rate)
    flow = Flow("exponential", {"k": 1.0, "noise": NOISE})
    plant = compile_plant(SHA("p", (Location("on", flow),), (), "on", effects=(RANDOM["heat-disturbance"],)))
    engine_law = respond(plant, k, np.zeros((dt.size, 2)), dt, 1)
    step = disturbance_step(memory, k, dt)
    assert engine_law.disturbed is not None
    sigma = RANDOM["heat-disturbance"].params["sigma"]
    for ours, theirs in (
        (step.carried, engine_law.phi[:, 0, 1]),
        (step.keep, engine_law.phi[:, 1, 1]),
        (step.xx, engine_law.disturbed[:, 0, 0] / sigma**2),
        (step.xd, engine_law.disturbed[:, 0, 1] / sigma**2),
        (step.dd, engine_law.disturbed[:, 1, 1] / sigma**2),
    ):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-300)
    # As it is drawn: what is new in D, and what of X that does not tell.
    np.testing.assert_allclose(step.coupling**2 * step.dd + step.own, step.xx, rtol=1e-12)


CASES = [pytest.param((effect,), id=name) for name, effect in RANDOM.items()]
CASES.append(pytest.param(tuple(RANDOM.values()), id="both"))


@pytest.mark.parametrize("effects", CASES)
def test_moments_and_filter_have_the_variance_of_the_equation(effects: tuple[Effect, ...]) -> None:
    expected = variance(effects, OUTPUTS)
    plain = variance((), OUTPUTS)
    assert np.all(expected[1:] > 1.03 * plain[1:]), "the effect must be seen"
    made = model(*effects)
    found = moments(schedule(made.sha, [], np.append(0.0, OUTPUTS)), 20.0)
    np.testing.assert_allclose(found.variance[1:], expected, rtol=1e-7)
    np.testing.assert_allclose(found.mean[1:], 60.0 - 40.0 * np.exp(-K * OUTPUTS), rtol=1e-12)
    tracker = compile_model(made)
    belief = start(tracker, 0.0)
    for time, wanted in zip(OUTPUTS.tolist(), expected, strict=True):
        belief = advance(tracker, belief, time)
        assert belief.xx == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize("effects", CASES)
def test_runs_forecasts_and_statistical_checking_have_it_too(effects: tuple[Effect, ...]) -> None:
    expected, runs = variance(effects, OUTPUTS), 4000
    made = model(*effects)
    tolerance = FIVE_SIGMA * np.sqrt(2.0 / runs)
    sampled = simulate(schedule(made.sha, [], np.append(0.0, OUTPUTS)), 20.0, runs, np.random.default_rng(1))
    np.testing.assert_allclose(sampled.temperatures[:, 1:].var(axis=0) / expected, 1.0, atol=tolerance)
    # Without a stay's law the location is never left: an unknown future is this one.
    levels = (0.1587, 0.5, 0.8413)
    fan = forecast(made, start(made, 0.0), OUTPUTS.tolist(), np.random.default_rng(2), runs=runs, levels=levels)
    spread = (fan.quantiles[2] - fan.quantiles[0]) / 2.0
    np.testing.assert_allclose(spread**2 / (expected + 0.1**2), 1.0, atol=1.5 * tolerance)
    world = initial(made).world
    made_engine = engine(world, Cuts(1800.0, (), (), ((0.0, 1800.0),)))
    state, rng, clock = made_engine.begin(runs, np.random.default_rng(3)), np.random.default_rng(4), made_engine.clock
    for row in range(clock.size - 1):
        for _ in made_engine.advance(row, state, rng):
            pass
    assert state.x.var() / expected[-1] == pytest.approx(1.0, abs=tolerance)


def test_a_known_future_forecast_agrees_with_the_unknown_one_of_a_place_that_is_never_left() -> None:
    made = model(*RANDOM.values())
    belief = start(made, 0.0, 20.0)
    known, unknown = (
        forecast(made, belief, (600.0,), np.random.default_rng(5), runs=4000, events=events) for events in ((), None)
    )
    np.testing.assert_allclose(known.quantiles, unknown.quantiles, atol=0.35)


def test_the_filter_finds_a_disturbance_that_the_next_minutes_confirm() -> None:
    """A plant that is heated by 0.01 degC/s from some moment on: with the state the next 5 minutes are known better."""
    memory = Effect("heat-disturbance", {"sigma": 0.01, "memory": 1000.0})
    errors = {}
    for name, effects in (("with", (memory,)), ("without", ())):
        tracker = compile_model(model(*effects))
        belief, x = start(tracker, 0.0, 60.0), 60.0
        for second in range(1, 901):
            x += K * (60.0 - x) + (0.01 if second > 600 else 0.0)
            belief = observe(tracker, belief, float(second), x)
        ahead = advance(tracker, belief, 1200.0)
        for _ in range(300):
            x += K * (60.0 - x) + 0.01
        errors[name] = abs(ahead.x - x)
    assert errors["with"] < 0.5 * errors["without"]


def test_verification_holds_them_within_z_and_takes_them_at_0_for_the_benefit_of_the_doubt() -> None:
    made, bare = model(*RANDOM.values()), model()
    assumed = Assumptions(z=3.0)
    sigma, offset = RANDOM["heat-disturbance"].params["sigma"], RANDOM["machine-offset"].params["sigma"]
    wide, narrow = (find_bounds(each, 0.0, 200.0, assumed) for each in (made, bare))
    added = 3.0 * (sigma / K + offset)
    assert wide.intervals["on"][1] == pytest.approx(narrow.intervals["on"][1] + added, abs=1e-2)
    kind, bare_kind = (find_bounds(each, 0.0, 200.0, assumed, doubt=5.0) for each in (made, bare))
    assert kind.intervals["on"] == pytest.approx(bare_kind.intervals["on"])


@pytest.mark.parametrize("effects", CASES)
def test_the_exported_text_draws_them_by_their_law(effects: tuple[Effect, ...]) -> None:
    """The interpreted document, many runs at once: the spread of the temperature is the native one's."""
    made = model_of("bins")
    made = replace(made, sha=replace(made.sha, effects=effects))
    trace = trace_of()
    native = moments(schedule(made.sha, trace.events, [0.0, 800.0], inputs=trace, policy="resync"), 22.0)
    rng, runs = np.random.default_rng(6), 300
    document = export(made, trace, tick=10)

    def draw(function: str, mean: float, sigma: float) -> Array:
        assert function == "random_normal"
        return rng.normal(mean, sigma, runs)

    _, seen = courses(document.main.xml, 800.0, draw, most=5.0)
    assert np.shape(seen[max(seen)]) == (runs,)
    ratio = float(np.var(seen[max(seen)])) / float(native.variance[-1])
    assert ratio == pytest.approx(1.0, abs=FIVE_SIGMA * np.sqrt(2.0 / runs))


def test_a_machines_offset_is_learned_over_stays_and_kept_for_the_next_belief() -> None:
    made = model(Effect("machine-offset", {"sigma": 8.0}))
    made = replace(
        made, sha=replace(made.sha, locations=(replace(made.sha.locations[0], distribution=normal(60.0, 0.3)),))
    )
    tracker = compile_model(made)
    belief, x = start(tracker, 0.0, 30.0), 30.0
    for second in range(1, 3001):
        x += K * (66.0 - x)
        belief = observe(tracker, belief, float(second), x)
    known = machine_offset(tracker, belief)
    assert known is not None and known[0] == pytest.approx(6.0, abs=0.5) and known[1] < 1.0
    begun = start(tracker, 9000.0)
    assert machine_offset(tracker, begun) == pytest.approx((0.0, 8.0))
    carried = observe(tracker, with_machine_offset(tracker, begun, *known), 9000.0, 25.0)
    assert machine_offset(tracker, carried) == pytest.approx(known, abs=1e-6)
    assert advance(tracker, carried, 12000.0).x == pytest.approx(66.0, abs=0.6)
    assert machine_offset(model(), start(model(), 0.0, 20.0)) is None


def test_an_event_keeps_both_states() -> None:
    made = model_of("bins")
    made = replace(made, sha=replace(made.sha, effects=tuple(RANDOM.values())), semi_markov=dict[str, Stay]())
    tracker = compile_model(made)
    belief = start(tracker, 0.0, 22.0)
    for second in range(1, 200):
        belief = observe(tracker, belief, float(second), 22.0 + 0.02 * second)
    after = on_event(tracker, belief, Event(199.0, "W_ON"))
    assert belief.hidden is not None and after.hidden is not None
    assert after.hidden.mean[1:3] == pytest.approx(belief.hidden.mean[1:3])


def test_a_trace_without_events_runs_through() -> None:
    trace = Trace("t", np.array([0.0, 60.0]), {"T": np.array([20.0, 21.0])})
    made = model(*RANDOM.values())
    assert np.isfinite(moments(schedule(made.sha, [], trace.times), 20.0).variance).all()
