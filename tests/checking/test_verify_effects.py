"""With effects, bounds are safe against hundreds of random runs, words lead out, and models may be deployed."""

from dataclasses import replace
from math import inf

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from sim.effects.kinds import effect_signals
from sim.engine.moment_equations import moments
from sim.engine.schedules import schedule
from sim.proof.bounds import find_bounds
from sim.proof.drift import DriftBound, add_bounds
from sim.proof.envelope import DAY_S, Assumptions, envelopes
from sim.proof.structure import moves
from sim.proof.verification import verify
from sim.proof.word import parse_word, word_text
from sim.proof.word_replay import replay
from sim.sha.automaton import Distribution, Effect
from sim.sha.events import Alphabet, Switch, alphabet_symbols
from sim.sha.model import Correction, Model, Stay
from sim.sha.trace import Event, Trace
from tests.sha.effect_reference import EFFECTS, LATE, TOGETHER, plant, without_noise
from tests.sha.models import normal

RANGES = {"I": (50.0, 200.0), "M": (-5.0, 40.0), "Ta": (10.0, 30.0), "P": (0.0, 1.0)}
RUNS = 2
ALPHABET = Alphabet((Switch("on", "W_ON", "W_OFF"),))
EVERY = {**EFFECTS, **TOGETHER, **LATE}
COMING = {name for name, many in EVERY.items() if any(one.params.get("lag", 0.0) > 0 for one in many)}


def model_of(name: str, kind: str = "exponential", **more: object) -> Model:
    sha = without_noise(plant(kind, EVERY[name]))
    return Model(replace(sha, **more), ALPHABET, "T", 0.1, normal(20.0, 1.0))  # type: ignore[arg-type]


def assumed(model: Model, **more: object) -> Assumptions:
    read = {one.signal for place in model.sha.locations for one in place.flow.inputs} | set(effect_signals(model.sha))
    return Assumptions(inputs={name: RANGES[name] for name in read}, **more)  # type: ignore[arg-type]


def random_run(model: Model, rng: np.random.Generator, shortest: float, longest: float) -> tuple[list[Event], Trace]:
    """Random starts, stops and gaps, and signals that move anywhere in their ranges at times of their own."""
    times = np.cumsum(rng.uniform(shortest, longest, int(rng.integers(1, 10))))
    symbols = rng.choice(["W_ON", "W_ON", "W_OFF", "unknown"], times.size)
    begin = float(rng.choice([0.0, 700.0, 1e6]))
    events = [Event(begin + float(time), str(symbol)) for time, symbol in zip(times, symbols, strict=True)]
    clock = np.concatenate([[0.0], np.sort(rng.uniform(0.0, times[-1], 30))]) + begin
    signals = {
        name: np.where(
            rng.random(clock.size) < 0.4, rng.choice([low, high], clock.size), rng.uniform(low, high, clock.size)
        )
        for name, (low, high) in RANGES.items()
    }
    return events, Trace("inputs", clock, signals)


KINDS = ("exponential", "driven", "logarithmic", "linear", "constant")


# Under stays of any length the bound of a transient's drive leaves every range, and no word does: only time would pass.
@pytest.mark.parametrize(
    ("kind", "sojourn"),
    [*((kind, sojourn) for kind in KINDS for sojourn in ("any", (0.0, 900.0))), ("transient", (0.0, 900.0))],
    ids=lambda value: value if isinstance(value, str) else "sojourn1",
)
def test_no_random_run_with_random_signals_leaves_the_proven_interval(kind: str, sojourn: object) -> None:
    """Runs of each effect, with jumping signals; every segment's end is looked at, also with a rate limit."""
    rng = np.random.default_rng(3)
    for number, name in enumerate(EVERY, [*KINDS, "transient"].index(kind)):
        # Each effect's bounds with a rate limit over one half of the flows, and without over the other.
        rate = 0.05 if number % 2 and name not in COMING else inf
        model = model_of(name, kind, max_rate=rate)
        given = assumed(model, sojourn=sojourn, start=(15.0, 60.0))
        found = find_bounds(model, -500.0, 500.0, given)
        assert found.settled, name
        for _ in range(RUNS):
            events, inputs = random_run(model, rng, 5.0, 890.0 if sojourn != "any" else 4000.0)
            begin = float(inputs.times[0])
            start = float(rng.uniform(15.0, 60.0))
            outputs = np.union1d(np.linspace(begin, events[-1].time, 60), [begin])
            steps = schedule(model, events, outputs, start=begin, inputs=inputs, policy="resync")
            steps = replace(steps, sha=replace(steps.sha, low=-1e9, high=1e9))
            read = moments(steps, start).mean
            places = [model.sha.locations[index].name for index in steps.output_location]
            low, high = np.array([found.intervals[place] for place in places]).T
            slack = 3e-3  # what the simulator's own course may be off by, docs/effects.md
            assert np.all(read >= low - slack) and np.all(read <= high + slack), (name, rate, start)


def test_hundreds_of_words_with_every_stays_own_parameter_stay_inside() -> None:
    rng = np.random.default_rng(5)
    count = 0
    for name in EVERY:
        model = model_of(name)
        places = tuple(
            replace(place, distribution=normal(mean, 3.0))
            for place, mean in zip(model.sha.locations, (22.0, 55.0), strict=True)
        )
        model = replace(model, sha=replace(model.sha, locations=places))
        given = assumed(model)
        found = find_bounds(model, -500.0, 500.0, given)
        rooms = {r.location: r for r in envelopes(model, given, moves(model.sha, alphabet_symbols(ALPHABET), "resync"))}
        low, high = (f(s) for f, s in zip((min, max), zip(*found.intervals.values(), strict=True), strict=True))
        slow = any(one.kind in ("radiation-loss", "thermostatic-cooling") for one in EVERY[name])
        for _ in range(2 if slow else 30):
            items, time, here = [], 0.0, "off"
            for number in range(int(rng.integers(1, 8))):
                signals = [f"{one}={rng.choice([*RANGES[one], rng.uniform(*RANGES[one])])}" for one in given.inputs]
                m = rng.choice([*rooms[here].m, rng.uniform(*rooms[here].m)])
                start = [f"T={rng.uniform(*found.start)}", f"t={rng.choice([0.0, 900.0, 1e6])}"] if not number else []
                symbol = "" if not number else "W_ON" if here == "on" else "W_OFF"
                items.append(",".join([f"{symbol}@{time}", *start, f"m={m}", *signals]))
                time += float(rng.choice([rng.uniform(0.0, 60.0), rng.uniform(0.0, 5000.0)]))
                here = "on" if here == "off" else "off"
            done = replay(model, parse_word(" ".join([*items, f"@{time}"])))
            assert low - 3e-3 <= done.lowest and done.highest <= high + 3e-3, (name, items)
            count += 1
    assert count > 500


# ------------------------------------------------------------------ bounds that are reached


def hot(**params: float) -> Model:
    """Running relaxes to 55 degC, and pump-cooling to 25 pulls at it with `loss`."""
    effect = Effect("pump-cooling", {"loss": 0.004, "sink": 25.0, **params}, {"pump": "P"})
    return Model(without_noise(plant("exponential", (effect,))), ALPHABET, "T", 0.1, normal(22.0, 0.0))


def test_a_pump_pulls_no_further_than_where_flow_and_loss_meet() -> None:
    found = find_bounds(hot(), 0.0, 150.0, Assumptions(inputs={"P": (0.5, 1.0)}))
    (low, high), both = found.intervals["on"], (0.004 * 55.0 + 0.002 * 25.0) / 0.006
    assert found.verdict == "proven"
    assert high == pytest.approx(both) and low == pytest.approx(22.0)


def test_a_thermostat_keeps_what_it_opens_at() -> None:
    model = model_of("thermostatic-cooling")
    assert find_bounds(model, 0.0, 150.0, assumed(model)).intervals["on"][1] == pytest.approx(38.0)


def test_a_lag_and_a_dead_time_read_what_was_elsewhere_and_an_offset_its_size() -> None:
    plain = find_bounds(model_of("housing-thermal-mass"), 0.0, 150.0, Assumptions())
    lagged = find_bounds(model_of("sensor-lag 3"), 0.0, 150.0, Assumptions())
    assert set(lagged.intervals.values()) == {plain.intervals["on"]}
    low, high = find_bounds(model_of("sensor-offset-step"), 0.0, 150.0, Assumptions()).intervals["on"]
    assert low == pytest.approx(plain.intervals["on"][0] - 1.5) and high == pytest.approx(plain.intervals["on"][1])


def test_start_up_heat_can_be_kept_at_its_greatest_by_starting_again_and_again() -> None:
    model = model_of("startup-churning")
    reach = find_bounds(model, 0.0, 150.0, Assumptions()).intervals["on"][1]
    assert reach == pytest.approx(55.0 + 0.1 / 0.004)
    word = " ".join(["@0,T=60", *(f"W_ON@{10.0 * n + 1.0} W_OFF@{10.0 * n + 10.0}" for n in range(40)), "@401"])
    assert 70.0 < replay(model, parse_word(word)).highest < reach


def late(lag: float, **more: object) -> Model:
    """A quadratic heat of at most 0.02 degC/s in `on`, late by `lag` s."""
    effect = Effect(
        "quadratic-current-heating", {"gain": 5e-7, "reference": 0.0, "lag": lag}, {"current": "I"}, ("on",)
    )
    sha = replace(without_noise(plant("exponential", (effect,))), **more)  # type: ignore[arg-type]
    return Model(sha, ALPHABET, "T", 0.1, normal(22.0, 0.0))


def test_what_comes_late_adds_to_a_bound_no_more_than_what_may_be_on_its_way() -> None:
    given = Assumptions(inputs={"I": (0.0, 200.0)})
    (_, at_once), (_, lagged) = (find_bounds(late(lag), 0.0, 150.0, given).intervals["on"] for lag in (0.0, 90.0))
    assert at_once == pytest.approx(55.0 + 0.02 / 0.004)
    assert at_once < lagged < at_once + 90.0 * 0.02 + 1e-9
    assert find_bounds(late(90.0), 0.0, 150.0, given).intervals["off"][1] > 22.0


@pytest.mark.parametrize(
    ("more", "why"),
    [
        ({"max_rate": 0.05}, "under a greatest rate"),
        (
            {"locations": tuple(replace(place, entry="resample") for place in plant("exponential", ()).locations)},
            "where a location draws the temperature anew",
        ),
    ],
)
def test_a_lag_that_cannot_be_bounded_is_refused_by_its_name(more: dict[str, object], why: str) -> None:
    found = verify(late(90.0, **more), assumptions=Assumptions(inputs={"I": (0.0, 200.0)}))
    assert not found.deployable
    assert f"'quadratic-current-heating' are not bounded with a lag {why}" in found.reasons[0]


# ------------------------------------------------------------------ deployment


def weak(effect: Effect) -> dict[str, float]:
    return {"gain": 1e-14} if effect.kind == "radiation-loss" else {"loss": 1e-5} if "loss" in effect.params else {}


@pytest.mark.parametrize("name", EVERY)
def test_a_model_that_runs_away_is_refused_with_the_word_whatever_effects_it_has(name: str) -> None:
    """Running warms at 0.05 degC/s: only what takes heat in proportion could hold it, so losses are made small."""
    small = tuple(replace(one, params={**one.params, **weak(one)}) for one in EVERY[name])
    sha = without_noise(plant("linear", small))
    places = (sha.locations[0], replace(sha.locations[1], distribution=normal(0.05, 0.0)))
    model = Model(replace(sha, locations=places, low=0.0, high=150.0), ALPHABET, "T", 0.1, normal(20.0, 1.0))
    found = verify(model, assumptions=assumed(model))
    assert not found.deployable
    words = [word for check in found.checks if check.blocking for word in check.words]
    assert words, [check.evidence for check in found.checks]
    assert replay(model, parse_word(word_text(words[0]))).leaves(0.0, 150.0) is not None


def test_a_signal_of_unknown_range_leaves_it_undecided_and_says_which_option_decides() -> None:
    found = verify(hot())
    assert found.check("growth").verdict == "not decided" and "--inputs P=LOW..HIGH" in found.reasons[0]
    learned = {"on": Stay(Distribution("exponential", {"mean": 9.0}), {"off": 1.0}, {"P": (0.5, 0.1)})}
    assert verify(replace(hot(), semi_markov=learned)).deployable, "what the stays elsewhere have seen decides too"
    switched = Alphabet((*ALPHABET.channels, Switch("P", "P_ON", "P_OFF")))
    assert verify(replace(hot(), alphabet=switched)).deployable


def test_a_range_for_an_effects_signal_is_taken_and_one_for_nothing_is_not() -> None:
    assert verify(hot(), assumptions=Assumptions(inputs={"P": (0.0, 1.0)})).deployable
    with pytest.raises(ValueError, match="is driven by 'Q'; they are driven by P"):
        verify(hot(), assumptions=Assumptions(inputs={"Q": (0.0, 1.0)}))


def worn(gain: float) -> Model:
    effect = Effect("wear-drift", {"gain": gain, "since": 1.75e9}, locations=("on",))
    sha = replace(without_noise(plant("exponential", (effect,))), low=0.0, high=150.0)
    return Model(sha, ALPHABET, "T", 0.1, normal(20.0, 1.0))


def test_a_wear_that_diverges_in_years_is_deployable_today_and_says_until_when() -> None:
    slow, fast, wild = (verify(worn(degrees * 0.004 / (365.0 * DAY_S))) for degrees in (40.0, 400.0, 40_000.0))
    assert slow.deployable and "365 days of wear, until 2026-06-15" in slow.check("wear").evidence
    assert fast.deployable and "90 days of wear" in fast.check("wear").evidence
    assert "not for 365" in fast.check("wear").evidence
    assert not wild.deployable
    (word,) = wild.check("mean course").words
    assert word.steps[0].clock is not None and word.steps[0].clock > 1.75e9
    strict = verify(worn(400.0 * 0.004 / (365.0 * DAY_S)), assumptions=Assumptions(horizon=365.0 * DAY_S))
    assert not strict.deployable, "a horizon that is given is not shortened"


def test_a_correction_carries_the_bounds_along() -> None:
    model = hot()
    plain = find_bounds(model, 0.0, 150.0, assumed(model)).intervals["on"]
    moved = find_bounds(
        replace(model, correction=Correction(1.2, -3.0)), 0.0, 200.0, replace(assumed(model), start=(1.2 * 22 - 3,) * 2)
    )
    assert moved.intervals["on"] == pytest.approx(tuple(1.2 * x - 3.0 for x in plain))


# ------------------------------------------------------------------ the drift's pieces


pieces = st.lists(
    st.tuples(st.floats(0.0, 0.05), st.floats(-20.0, 80.0), st.sampled_from([0.0, 0.3])), min_size=1, max_size=4
)


@settings(max_examples=80, deadline=None)
@given(pieces, st.floats(-0.5, 0.5), st.floats(0.0, 2000.0), st.sampled_from([inf, 0.05, 1.0]))
@example([(5e-324, 1.5, 0.0)], 0.5, 3.0, inf)  # losses of which no digits are left
def test_a_drift_runs_one_way_keeps_order_and_agrees_with_small_steps(
    given_pieces: list[tuple[float, float, float]], heat: float, dt: float, rate: float
) -> None:
    bends = [DriftBound((sink,), ((b * sink, b), (b * sink - drop, b))) for b, sink, drop in given_pieces]
    drift = add_bounds([DriftBound((), ((heat, 0.0),)), *bends])
    starts = np.linspace(-100.0, 150.0, 11)
    ends = np.array([drift.advance(float(x), dt, rate) for x in starts])
    assert np.all(np.diff(ends) >= -1e-9) and np.all(np.diff(ends) <= np.diff(starts) + 1e-9)
    halves = np.array([drift.advance(drift.advance(float(x), 0.5 * dt, rate), 0.5 * dt, rate) for x in starts])
    rising = ends > starts
    assert np.all(halves[rising] <= ends[rising] + 1e-6) and halves[~rising] == pytest.approx(ends[~rising], abs=1e-6)
    low, high = drift.rest
    assert np.all((ends >= starts - 1e-12) | (starts > high)) and np.all((ends <= starts + 1e-12) | (starts < low))
    assert drift.mirror().advance(-float(starts[3]), dt, inf) == pytest.approx(
        -drift.advance(float(starts[3]), dt, inf)
    )
