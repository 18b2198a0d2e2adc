"""Where runs start: from a belief with its age, its joint law of temperature and mode parameter, or from the model."""

from dataclasses import replace
from math import exp, sqrt

import numpy as np
import pytest
from scipy.special import ndtr

from sim.lab.checking.query.tree import At, Both, Comparison, Eventually, Probability, TimeSpan
from sim.lab.checking.smc.answers import QuerySettings, Start, answer
from sim.lab.checking.smc.paths import long_steps, unknown_events
from sim.lab.checking.smc.start import believed_start, initial
from sim.sha.automaton import Distribution, Effect
from sim.sha.model import Model
from sim.sha.trace import Event, Trace
from tests.checking.worlds import AGE, TEMP, compare, eventually, flow, model, normal

FIXED = QuerySettings(rule="fixed", runs=20_000, seed=2)


def quiet_trace(seconds: float, events: tuple[Event, ...] = (), value: float = 40.0) -> Trace:
    times = np.arange(0.0, seconds + 1.0, 10.0)
    return Trace("t", times, {"T": np.full(times.size, value)}, events)


def chance_to_leave(start: Start, within: float) -> tuple[float, float, float]:
    """(share, low, high) of runs that come to the next location."""
    found = answer(eventually(At("q_1"), within), start, FIXED)
    return found.numbers["probability"], found.numbers["low"], found.numbers["high"]


@pytest.mark.parametrize("age", [0.0, 60.0, 90.0, 120.0])
def test_the_present_stay_ends_by_its_law_given_its_age(age: float) -> None:
    """Stays ~ N(100, 20^2): given that this one has lasted `age` seconds, it ends within 20 s with a known chance."""
    made = model([flow("constant")] * 2, [None, None], first=normal(40.0), stay=normal(100.0, 20.0))
    start = initial(made) if age == 0.0 else believed_start(made, quiet_trace(200.0), age)
    assert start.world.age == age
    left = ndtr((age + 20.0 - 100.0) / 20.0) - ndtr((age - 100.0) / 20.0)
    exact = left / (1.0 - ndtr((age - 100.0) / 20.0))
    share, low, high = chance_to_leave(start, 20.0)
    assert low <= exact <= high or share == pytest.approx(exact, abs=1e-3)


def test_an_exponential_stay_has_no_memory_of_its_age() -> None:
    law = Distribution("exponential", {"mean": 50.0})
    made = model([flow("constant")] * 2, [None, None], first=normal(40.0), stay=law)
    for start in (initial(made), believed_start(made, quiet_trace(200.0), 150.0)):
        _, low, high = chance_to_leave(start, 30.0)
        assert low <= 1.0 - exp(-30.0 / 50.0) <= high


def test_the_age_in_a_query_counts_from_the_entry_before_the_start() -> None:
    made = model([flow("constant")] * 2, [None, None], first=normal(40.0))
    entered = believed_start(made, quiet_trace(200.0, (Event(35.0, "next"),)), 95.0)
    assert entered.world.location == 1 and entered.world.age == pytest.approx(60.0)
    for start, limit, expected in ((entered, 79.0, 1.0), (entered, 81.0, 0.0), (initial(made), 21.0, 0.0)):
        found = answer(eventually(compare(">=", limit, AGE), 20.0), start, QuerySettings(runs=100))
        assert found.numbers["probability"] == expected
    along = believed_start(made, quiet_trace(200.0, (Event(35.0, "next"), Event(120.0, "next"))), 95.0, recorded=True)
    both = eventually(Both(compare(">=", 84.9, AGE), compare("<=", 85.0, AGE)), 60.0)
    assert answer(both, along, QuerySettings(runs=100)).numbers["probability"] == 1.0
    assert (
        answer(eventually(compare(">", 85.1, AGE), 60.0), along, QuerySettings(runs=100)).numbers["probability"] == 0.0
    )


@pytest.mark.parametrize("recorded", [True, False])
def test_a_flow_that_ages_goes_on_at_the_age_of_the_belief(recorded: bool) -> None:
    """Logarithmic, 90 s old: X rises by a ln((t0 + 90 + D) / (t0 + 90)) and not by a ln((t0 + D) / t0)."""
    made = model([flow("logarithmic", 1e-4, t0=20.0)], [normal(2.0)], first=normal(40.0))
    times = np.arange(0.0, 300.0, 10.0)
    trace = Trace("t", times, {"T": 40.0 + 2.0 * np.log1p(times / 20.0)}, ())
    start = believed_start(made, trace, 90.0, recorded=recorded)
    top = 40.0 + 2.0 * np.log1p(150.0 / 20.0)
    for limit, expected in ((top - 0.1, 1.0), (top + 0.1, 0.0)):
        found = answer(eventually(compare(">=", limit), 60.0), start, QuerySettings(runs=200))
        assert found.numbers["probability"] == expected


@pytest.mark.parametrize("recorded", [True, False])
@pytest.mark.parametrize("op", [">=", "<="])
def test_runs_from_a_belief_have_its_joint_law_of_temperature_and_mode(recorded: bool, op: Comparison) -> None:
    """X after D s is normal: F P F' of the belief's covariance, and the flow's own noise."""
    k, noise, seconds = 0.01, 0.05, 80.0
    made = model([flow("exponential", noise, k=k)], [normal(45.0, 2.0)], first=normal(40.0))
    start = believed_start(made, quiet_trace(300.0), 100.0, recorded=recorded)
    belief = start.world.belief
    assert belief is not None and abs(belief.xm) > 1e-4 and belief.mm > 0.01
    decay = exp(-k * seconds)
    mean = decay * belief.x + (1.0 - decay) * belief.m
    spread = decay**2 * belief.xx + 2.0 * decay * (1.0 - decay) * belief.xm + (1.0 - decay) ** 2 * belief.mm
    sigma = sqrt(spread + noise**2 * (1.0 - decay**2) / (2.0 * k))
    for shift in (-1.0, 0.5):
        query = Probability(seconds, Eventually(compare(op, mean + shift * sigma, TEMP), TimeSpan(seconds, seconds)))
        found = answer(query, start, FIXED)
        exact = float(ndtr(-shift if op == ">=" else shift))
        assert found.numbers["low"] <= exact <= found.numbers["high"]


def test_a_model_with_effects_is_refused_without_a_trace_that_drives_it_not_half_followed() -> None:
    made = model([flow("constant")], [None], first=normal(40.0))
    lag = Effect("sensor-lag", {"tau": 30.0, "order": 1.0})
    with_effect: Model = replace(made, sha=replace(made.sha, effects=(lag,)))
    query = Probability(10.0, Eventually(compare(">=", 50.0, TEMP), TimeSpan(0.0, 10.0)))
    for start in (initial(with_effect), believed_start(with_effect, quiet_trace(100.0), 50.0)):
        with pytest.raises(ValueError, match=r"has effects, .* let a trace drive the runs"):
            answer(query, start, FIXED)


@pytest.mark.parametrize("kind", ["linear", "exponential", "logarithmic", "transient"])
@pytest.mark.parametrize("max_rate", [float("inf"), 0.05])
def test_runs_in_one_stay_are_the_same_runs_worked_out_together_or_apart(
    kind: str, max_rate: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Together until the first run leaves the first stay; to the last bit, where steps are of one piece."""
    monkeypatch.setattr(long_steps, "MAX_PIECES", 1)
    constants = {"exponential": {"k": 0.02}, "logarithmic": {"t0": 20.0}, "transient": {"tau": 20.0}}.get(kind, {})
    law = normal(44.0, 0.5) if kind == "exponential" else normal(0.02, 0.01)
    flows = [flow(kind, **constants), flow("exponential", k=0.05)]
    made = model(flows, [law, normal(43.0)], first=normal(40.0, 0.2), stay=normal(300.0, 60.0), max_rate=max_rate)
    asked = eventually(compare(">=", {"linear": 46.0, "exponential": 45.0}.get(kind, 42.0)), 400.0)
    together = answer(asked, initial(made), replace(FIXED, runs=300))
    monkeypatch.setattr(unknown_events, "_in_one_stay", lambda state: False)
    apart = answer(asked, initial(made), replace(FIXED, runs=300))
    assert (together.numbers, together.notes) == (apart.numbers, apart.notes)
    assert together.passages is not None
    assert apart.passages is not None
    assert together.passages.tobytes() == apart.passages.tobytes()
    assert 0.02 < together.numbers["probability"] < 0.98
