"""What is proven of temperatures holds on every path, and what is refuted is refuted by a word that does it."""

from dataclasses import replace
from math import exp, inf, isinf
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from sim.effects.correction import in_sensor_scale
from sim.engine.schedules import resync_targets, schedule
from sim.engine.simulation import simulate
from sim.proof.bounds import MIN_EXCESS_DEGC, Bounds, find_bounds, noise_band
from sim.proof.envelope import Assumptions, Envelope, Sojourn, UnboundedInput, envelopes, quantiles
from sim.proof.structure import Move, moves
from sim.proof.word import parse_word, word_text
from sim.proof.word_replay import replay
from sim.sha.automaton import Distribution, Edge, Flow, Input, Location
from sim.sha.events import Alphabet, Bins, alphabet_symbols
from sim.sha.flows import mean_step
from sim.sha.model import Correction, Model, Stay
from sim.sha.trace import UNKNOWN, Event
from tests.checking.verify_models import SYMBOLS, assumptions, linear, models, normal, of, relaxing, thesis

FEW = settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
    phases=[Phase.explicit, Phase.reuse, Phase.generate],  # a failing model is small enough as it is
)
RANGE = (0.0, 150.0)


def _moves(model: Model, assumed: Assumptions) -> tuple[Move, ...]:
    return moves(model.sha, alphabet_symbols(model.alphabet), assumed.policy, unknown=assumed.unknown)


def course(room: Envelope, x: float, m: float, loads: list[float], seconds: float, rate: float) -> list[float]:
    """A stay in equal pieces, each with an input of its own: the temperature at the ends of the pieces."""
    path, dt = [x], seconds / len(loads)
    for index, load in enumerate(loads):
        target = m + sum(one.gain * (load - one.reference) for one in room.flow.inputs)
        path.append(float(mean_step(room.flow, path[-1], target, age=index * dt, dt=dt, max_rate=rate)))
    return path


@FEW
@given(models(), assumptions, st.integers(0, 2**32 - 1))
def test_no_path_with_moving_inputs_leaves_the_proven_intervals(model: Model, assumed: Assumptions, seed: int) -> None:
    found = find_bounds(model, *RANGE, assumed)
    assert found.settled
    rng = np.random.default_rng(seed)
    scaled = in_sensor_scale(model)
    sha, onward = scaled.sha, {(e.source, e.symbol): e.target for e in scaled.sha.edges}
    rooms = {r.location: r for r in envelopes(scaled, assumed, _moves(scaled, assumed))}
    here, x = sha.initial, float(rng.uniform(*found.start))
    for _ in range(12):
        room, (low, high) = rooms[here], found.intervals[here]
        seconds = _seconds(room, rng)
        loads = [float(each) for each in rng.uniform(*room.inputs["Load"], 4)] if room.inputs else [0.0, 0.0]
        path = course(room, x, _edge(room.m, rng), loads, seconds, sha.max_rate)
        assert low - 1e-6 <= min(path) and max(path) <= high + 1e-6, here
        symbol = str(rng.choice([*SYMBOLS, UNKNOWN] if assumed.unknown else SYMBOLS))
        target = sha.initial if symbol == UNKNOWN else onward.get((here, symbol))
        if target is None and assumed.policy == "resync":
            target = resync_targets(sha).get(symbol, sha.initial)
        if target is None:
            return
        here, x = target, path[-1]
        fresh = rooms[here].fresh
        x = x if fresh is None else float(rng.uniform(*fresh))


def _edge(limits: tuple[float, float], rng: np.random.Generator) -> float:
    """Either end of a range, or anything between."""
    return float(rng.choice([*limits, rng.uniform(*limits)]))


def _seconds(room: Envelope, rng: np.random.Generator) -> float:
    low, high = room.sojourn
    return float(rng.uniform(low, min(high, low + 5000.0))) if rng.random() < 0.7 or isinf(high) else high


@FEW
@given(models(), assumptions)
def test_a_refuting_word_read_from_its_text_leaves_the_range_in_the_replay_and_keeps_the_assumptions(
    model: Model, assumed: Assumptions
) -> None:
    found = find_bounds(model, *RANGE, assumed)
    assert (found.verdict == "proven") == (not found.escapes)
    scaled = in_sensor_scale(model)
    rooms = {room.location: room for room in envelopes(scaled, assumed, _moves(scaled, assumed))}
    for one in found.escapes:
        if one.word is None:  # a growth of hundredths of a degree a stay takes more stays than are tried, or shown
            assert one.grows
            continue
        done = replay(model, parse_word(word_text(one.word)), assumed.policy)
        assert (done.highest > RANGE[1]) if one.up else (done.lowest < RANGE[0])
        first = done.leaves(*RANGE)
        assert first is not None and first.location == one.location
        for visit in done.visits[:-1]:
            least, most = rooms[visit.location].sojourn
            assert least * (1 - 1e-9) - 1e-6 <= visit.seconds <= most * (1 + 1e-9) + 1e-6
        for visit, step in zip(done.visits, one.word.steps, strict=True):
            low, high = rooms[visit.location].m
            assert step.m is None or low - 1e-6 <= step.m <= high + 1e-6


@FEW
@given(models(), assumptions.filter(lambda assumed: assumed.sojourn != "law"))
def test_the_bounds_are_reached_and_not_only_safe(model: Model, assumed: Assumptions) -> None:
    """A claim a little tighter than the bounds is refuted, so no bound is wider than need be."""
    assumed = replace(assumed, start=(20.0, 25.0))
    found = find_bounds(model, *RANGE, assumed)
    low, high = (f(side) for f, side in zip((min, max), zip(*found.intervals.values(), strict=True), strict=True))
    if isinf(low) or isinf(high) or high - low < 1.0:
        return
    slim = find_bounds(model, low + 0.25, high - 0.25, assumed)
    assert slim.verdict == "refuted"
    assert all(one.word is not None for one in slim.escapes) and len(slim.escapes) == 2
    assert find_bounds(model, low - 0.05, high + 0.05, assumed).verdict == "proven"


@settings(max_examples=20, deadline=None)
@given(models(), st.integers(0, 2**32 - 1))
def test_the_products_own_simulator_stays_inside_when_nothing_is_random(model: Model, seed: int) -> None:
    sha = model.sha
    still = tuple(
        replace(
            each,
            flow=replace(each.flow, params={**each.flow.params, "noise": 0.0}),
            distribution=each.distribution and normal(each.distribution.params["mu"], 0.0),
        )
        for each in sha.locations
    )
    model = replace(model, sha=replace(sha, locations=still, low=-1e9, high=1e9), correction=Correction())
    driven = any(each.flow.inputs for each in still)
    assumed = Assumptions(z=0.0, inputs={"Load": (0.0, 20.0)}, start=(20.0, 20.0))
    if driven:
        model = replace(model, sha=replace(model.sha, locations=tuple(map(_undriven, still))))
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.exponential(100.0, 15))
    events = [Event(float(time), str(rng.choice(SYMBOLS))) for time in times]
    steps = schedule(model, events, np.linspace(0.0, times[-1] + 50.0, 60), policy="resync")
    runs = simulate(steps, 20.0, 1, rng)
    found = find_bounds(model, *RANGE, assumed)
    for index, x in zip(runs.location, runs.temperatures[0], strict=True):
        low, high = found.intervals[model.sha.locations[index].name]
        assert low - 1e-6 <= x <= high + 1e-6


def _undriven(location: Location) -> Location:
    if not location.flow.inputs:
        return location
    return replace(location, flow=Flow("exponential", location.flow.params))


# ------------------------------------------------------------------ known answers


def bounds(model: Model, sojourn: Sojourn = "any", *, unknown: bool = True) -> Bounds:
    return find_bounds(model, *RANGE, Assumptions(sojourn=sojourn, policy="ignore", unknown=unknown))


def test_a_relaxing_model_lies_between_its_start_and_its_targets() -> None:
    found = bounds(of(relaxing("p", 40.0, sigma=2.0), relaxing("q", 90.0, sigma=5.0)))
    assert found.verdict == "proven"
    assert found.start == pytest.approx((17.0, 23.0))
    assert found.intervals["p"] == pytest.approx((17.0, 105.0))
    assert found.intervals["q"] == pytest.approx((17.0, 105.0))


def test_a_linear_flow_without_a_limit_on_stays_grows_without_bound_and_the_word_says_when() -> None:
    found = bounds(thesis())
    (up,) = found.escapes
    assert up.grows and up.word is not None and up.location == "run"
    assert replay(thesis(), up.word).highest == pytest.approx(151.0, abs=0.02)
    assert up.seconds == pytest.approx((151.0 - 23.0) / 0.05, abs=0.2)
    four_hours = replay(thesis(), parse_word("@0,T=20 W_ON@0 @14400"))
    assert four_hours.highest == pytest.approx(740.0)


def test_a_loop_of_bounded_stays_that_gains_each_time_is_pumped() -> None:
    model = of(linear("up", 0.05), linear("down", -0.04))
    (up,) = bounds(model, (100.0, 100.0), unknown=False).escapes
    assert up.grows and up.word is not None
    laps = 123  # 23 + 1 a lap + 5 in the last stay: 150 is touched after 122, passed after 123
    assert len(up.word.steps) == 2 * laps + 1
    assert bounds(of(linear("up", 0.05), linear("down", -0.05)), (100.0, 100.0), unknown=False).verdict == "proven"


def test_not_knowing_can_lead_back_to_warming_again_and_again() -> None:
    model = of(linear("up", 0.05), linear("down", -0.05))
    (up,) = bounds(model, (100.0, 100.0)).escapes
    assert up.grows and up.word is not None
    assert {step.symbol for step in up.word.steps[1:]} == {UNKNOWN}


def test_heating_against_cooling_settles_at_the_fixed_point_of_the_loop() -> None:
    model = of(linear("heat", 0.05), relaxing("cool", 20.0, 0.001))
    found = bounds(model, (200.0, 200.0), unknown=False)
    decay = exp(-0.001 * 200.0)
    entry = (20.0 * (1.0 - decay) + decay * 10.0) / (1.0 - decay)
    assert found.intervals["heat"][1] == pytest.approx(entry + 10.0, abs=1e-6)
    assert found.intervals["cool"][1] == pytest.approx(entry + 10.0, abs=1e-6)
    assert found.verdict == "proven"


def test_a_temperature_that_is_drawn_anew_does_not_add_up() -> None:
    drawn = Location("warm", Flow("linear", {"m": 0.05, "noise": 0.0}), normal(23.5, 1.2), "resample")
    found = bounds(of(relaxing("rest", 20.0), drawn), (0.0, 600.0))
    assert found.verdict == "proven"
    assert found.intervals["warm"] == pytest.approx((23.5 - 3.6, 23.5 + 3.6 + 30.0))


@pytest.mark.parametrize("rate", [inf, 0.1])
def test_a_transient_is_bounded_where_the_temperature_is_drawn_and_adds_up_where_it_goes_on(rate: float) -> None:
    """An endless stay moves by m in all, with a limit on the rate too: 0.1 degC/s for 4.6 s, then what is left."""
    flow = Flow("transient", {"tau": 20.0, "m": 3.0, "noise": 0.0})
    drawn = of(relaxing("rest", 20.0), Location("peak", flow, normal(40.0, 1.0), "resample"), max_rate=rate)
    found = bounds(drawn, (0.0, inf))
    ramp = 0.0 if isinf(rate) else 20.0 * np.log(3.0 / (20.0 * rate))
    whole = 3.0 if isinf(rate) else rate * ramp + 3.0 * exp(-ramp / 20.0)
    assert found.verdict == "proven"
    assert found.intervals["peak"] == pytest.approx((37.0, 43.0 + whole))
    carried = of(Location("peak", Flow("transient", {"tau": 20.0, "noise": 0.0}), normal(3.0, 0.0)))
    (up,) = bounds(carried, (0.0, inf)).escapes
    assert up.grows and up.word is not None


def test_a_logarithmic_flow_grows_slowly_but_without_bound_when_it_is_entered_again_and_again() -> None:
    slow = Location("slow", Flow("logarithmic", {"t0": 10.0, "noise": 0.0}), normal(3.0, 0.0))
    found = bounds(of(slow), (0.0, 90.0))
    (up,) = found.escapes
    assert up.grows and up.word is not None
    gain = 3.0 * np.log(10.0)
    assert len(up.word.steps) == int(np.ceil((150.0 - 23.0) / gain))


def test_the_rate_limit_holds_back_what_is_proven() -> None:
    free, slow = relaxing("p", 400.0, 0.1), of(relaxing("p", 400.0, 0.1), max_rate=0.01)
    assert bounds(of(free), (0.0, 1000.0)).verdict == "refuted"
    staying = replace(slow, sha=replace(slow.sha, edges=()))
    found = bounds(staying, (0.0, 1000.0), unknown=False)
    assert found.verdict == "proven" and found.intervals["p"][1] == pytest.approx(23.0 + 10.0)
    assert bounds(staying, (0.0, 1000.0)).verdict == "refuted", "UNKNOWN begins the stay anew"


def test_the_clamp_of_the_model_does_not_make_the_claim_empty() -> None:
    model = of(relaxing("p", 200.0))
    found = bounds(model)
    assert found.verdict == "refuted" and found.escapes[0].reach == pytest.approx(200.0)
    word = found.escapes[0].word
    assert word is not None
    assert replay(model, word).visits[-1].clamped == 150.0


def test_a_correction_is_part_of_what_is_verified() -> None:
    model = replace(of(relaxing("p", 140.0)), correction=Correction(1.1, 0.0))
    found = bounds(model)
    assert found.intervals["p"][1] == pytest.approx(154.0) and found.verdict == "refuted"


def test_a_start_outside_of_the_range_is_refuted_by_doing_nothing() -> None:
    model = replace(of(relaxing("p", 50.0)), initial=normal(300.0, 1.0))
    found = bounds(model)
    word = found.escapes[0].word
    assert word is not None and len(word.steps) == 1 and found.verdict == "refuted"


def test_only_locations_that_events_lead_to_have_intervals() -> None:
    model = of(relaxing("p", 40.0), relaxing("q", 400.0), edges=(Edge("p", "a", "p"), Edge("q", "a", "p")))
    assert set(find_bounds(model, *RANGE, Assumptions(policy="reject")).intervals) == {"p"}
    assert find_bounds(model, *RANGE, Assumptions()).verdict == "proven", "no symbol resynchronises to q"


# ------------------------------------------------------------------ assumptions


def driven(stay: Stay | None = None, bins: Bins | None = None) -> Model:
    flow = Flow("driven", {"k": 0.01, "noise": 0.0}, (Input("Load", 2.0, 10.0),))
    edges = tuple(Edge(a, s, b) for a in ("low", "high") for s, b in (("c", "low"), ("d", "high")))
    model = of(Location("low", flow, normal(40.0, 0.0)), Location("high", flow, normal(40.0, 0.0)), edges=edges)
    alphabet = Alphabet((bins or Bins("Load", (10.0,), ("c", "d"), hysteresis=1.0),))
    return replace(model, alphabet=alphabet, semi_markov={"high": stay} if stay else {})


def room(model: Model, name: str, assumed: Assumptions | None = None) -> Envelope:
    assumed = assumed or Assumptions()
    return next(each for each in envelopes(model, assumed, _moves(model, assumed)) if each.location == name)


def test_an_input_lies_in_the_bin_that_was_announced_with_its_hysteresis() -> None:
    assert room(driven(), "high").inputs["Load"] == (9.0, 20.0)
    assert room(driven(), "low").inputs["Load"] == (0.0, 20.0), "the run begins here, and nothing is announced yet"


def test_a_learned_input_is_taken_at_z_and_cut_to_its_bin() -> None:
    law = Distribution("exponential", {"mean": 10.0})
    model = driven(Stay(law, {"low": 1.0}, {"Load": (12.0, 2.0)}))
    assert room(model, "high").inputs["Load"] == (9.0, 18.0)
    assert room(model, "high", Assumptions(z=0.0)).inputs["Load"] == (12.0, 12.0)
    assert room(model, "high", Assumptions(inputs={"Load": (1.0, 2.0)})).inputs["Load"] == (1.0, 2.0)


def test_an_input_that_nobody_bounds_is_refused_by_its_name() -> None:
    with pytest.raises(UnboundedInput, match=r"driven by 'Load', whose range nobody says.*--inputs Load=LOW\.\.HIGH"):
        find_bounds(replace(driven(), alphabet=Alphabet(())), *RANGE, Assumptions())


def test_the_sojourn_law_bounds_stays_at_the_quantiles_of_z() -> None:
    stay = Stay(Distribution("exponential", {"mean": 100.0}), {"low": 1.0})
    low, high = room(driven(stay), "high", Assumptions(sojourn="law")).sojourn
    assert (1 - exp(-low / 100.0), exp(-high / 100.0)) == pytest.approx((0.0013499, 0.0013499), rel=1e-4)
    assert room(driven(stay), "low", Assumptions(sojourn="law")).sojourn == (0.0, inf)
    assert quantiles(normal(5.0, 2.0), 3.0) == pytest.approx((-1.0, 11.0))


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"z": -1.0}, "z counts standard deviations"),
        ({"z": inf}, "z counts standard deviations"),
        ({"sojourn": (5.0, 2.0)}, "stays of 5 to 2 s are none"),
        ({"sojourn": (-1.0, 2.0)}, "stays of -1 to 2 s are none"),
        ({"inputs": {"Load": (5.0, 2.0)}}, "the input 'Load' ranges from 5 to 2"),
        ({"start": (float("nan"), 2.0)}, "the start temperature ranges from nan to 2"),
    ],
)
def test_assumptions_that_are_none_are_refused(wrong: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        replace(Assumptions(), **wrong)


def test_an_empty_range_is_refused() -> None:
    with pytest.raises(ValueError, match="no temperature lies within 5 to 5"):
        find_bounds(thesis(), 5.0, 5.0, Assumptions())


def test_the_noise_band_settles_for_relaxing_flows_and_is_told_apart_for_others() -> None:
    noisy = Location("p", Flow("exponential", {"k": 0.02, "noise": 0.1}), normal(40.0, 0.0))
    walk = Location("q", Flow("constant", {"noise": 0.3}), None, "none")
    settled, walking = noise_band(of(noisy, walk), 3.0)
    assert settled == pytest.approx(3.0 * 0.1 / np.sqrt(0.04))
    assert walking == {"q": 0.3}


def test_a_border_that_is_touched_and_not_passed_is_kept() -> None:
    assert bounds(of(relaxing("p", 150.0))).verdict == "proven"
    assert bounds(of(relaxing("p", 150.0 + 10 * MIN_EXCESS_DEGC))).verdict == "refuted"


def test_a_loop_that_settles_very_slowly_under_the_rate_limit_is_settled_at_once() -> None:
    """Far from both targets each stay moves 50 degC up or down, and a lap pulls together by a few millionths."""
    model = of(relaxing("up", 200.0, 0.3), relaxing("down", -150.0, 0.2), max_rate=1.0)
    found = bounds(model, (50.0, 50.0), unknown=False)
    assert found.settled and not found.grows
    laps = " ".join(f"a@{50 * place}" for place in range(1, 2001))
    done = replay(model, parse_word(f"@0,T={found.start[1]:.12g} {laps} @100050"), "ignore")
    for visit in done.visits:
        low, high = found.intervals[visit.location]
        assert low - 1e-3 <= min(visit.entered, visit.left) and max(visit.entered, visit.left) <= high + 1e-3
