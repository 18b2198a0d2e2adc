"""What differs between machines, what the last minutes say, and what no data have shown: learned from known plants."""

from dataclasses import replace

import numpy as np
import pytest

from sim.artefacts.model_json import model_text, parse_model
from sim.engine.belief import advance, machine_offset, observe, on_event, start
from sim.engine.tracker import compile_model
from sim.forecast import FAN_LEVELS, forecast
from sim.lab.learning.bins.candidates import CANDIDATES
from sim.lab.learning.bins.learn import Learned, learn_bins
from sim.lab.learning.calibrate import HORIZONS_S, PRIOR_FACTOR, UNSEEN_WIDENING, HeldOutForecasts, Scored
from sim.lab.learning.free_run import FitShape, FreeRunFit
from sim.lab.learning.machines import machine_spread, next_stay, small_sample, trace_machines
from sim.lab.learning.noise import NoiseLevels
from sim.lab.learning.plain import PERSISTENCE, TREND, learn_plain
from sim.lab.learning.preparation import splits
from sim.lab.learning.runs import free_runs
from sim.sha.automaton import SHA, Flow, Location
from sim.sha.events import DECANTER, Alphabet, Switch, encode
from sim.sha.model import PlainMember, plain_model
from sim.sha.trace import Event, Trace
from tests.learning.plants import Truth, simulate, with_signal
from tests.rig.no_bands import without_bands

OFFSETS = {"one": -6.0, "two": 0.0, "three": 5.0, "four": 2.0}


def of_machine(name: str, offset: float, seed: int, cycles: int = 2) -> list[Trace]:
    low, *others = (target + offset for target in Truth().targets)
    truth = Truth(targets=(low, others[0], others[1], others[2], others[3]), scatter=0.2)
    traces = simulate(truth, seed, cycles=cycles)
    return [replace(trace, name=f"{name}-{trace.name}", machine=name) for trace in traces]


def learned(traces: list[Trace]) -> Learned:
    with pytest.MonkeyPatch.context() as patch:
        without_bands(patch)
        return learn_bins(traces, DECANTER, "T", seed=0, candidates=CANDIDATES[:1])


@pytest.fixture(scope="module")
def different() -> Learned:
    """Of the machines of OFFSETS."""
    return learned([each for n, (name, offset) in enumerate(OFFSETS.items()) for each in of_machine(name, offset, n)])


@pytest.fixture(scope="module")
def alone() -> Learned:
    """Of one machine."""
    return learned(of_machine("m", 0.0, 1, cycles=4))


def test_the_spread_between_machines_is_found_and_its_offsets_too(different: Learned) -> None:
    spread = different.spread
    mean = np.mean(list(OFFSETS.values()))
    for name, offset in OFFSETS.items():
        assert spread.offsets[name] == pytest.approx(offset - mean, abs=1.5)
    assert spread.between == pytest.approx(np.std(list(OFFSETS.values()), ddof=1), rel=0.3)
    assert spread.sigma > 1.4 * spread.between, "four machines tell little of the fifth"


def test_machines_that_are_alike_and_a_single_one_have_no_offset(alone: Learned) -> None:
    alike = [trace for n in range(4) for trace in of_machine(f"m{n}", 0.0, n)]
    assert learned(alike).spread.between < 0.6
    assert alone.spread.sigma == 0.0
    assert not [effect for effect in alone.model.sha.effects if effect.kind == "machine-offset"]


def test_the_belief_of_a_new_machine_begins_wide_and_finds_its_offset(different: Learned) -> None:
    tracker = compile_model(different.model)
    (new,) = of_machine("new", 9.0, 11, cycles=1)
    belief, events = start(tracker, float(new.times[0])), list(new.events)
    before = machine_offset(tracker, belief)
    for time, value in zip(new.times.tolist(), new.signals["T"].tolist(), strict=True):
        while events and events[0].time <= time:
            belief = on_event(tracker, belief, events.pop(0))
        belief = observe(tracker, belief, time, value)
    after = machine_offset(tracker, belief)
    assert before is not None and after is not None
    mean = float(np.mean(list(OFFSETS.values())))
    # A disturbance with a long memory may be the reason for a part of it: one cycle does not tell the two apart.
    assert after[1] < 0.8 * before[1] and 3.0 < after[0] < 9.0 - mean + 2.5


@pytest.mark.parametrize("kind", ["linear", "logarithmic"])
def test_where_no_flow_has_a_target_that_is_why_nothing_is_known_of_how_machines_differ(kind: str) -> None:
    traces = [
        replace(trace, events=()) for n, name in enumerate(OFFSETS) for trace in of_machine(name, 0.0, n, cycles=1)
    ]
    runs = free_runs(
        traces, SHA("s", (Location("any", Flow("constant", {"noise": 0.0}), entry="none"),), (), "any"), "T"
    )
    none, nothing = np.full(1, -1, dtype=np.intp), np.zeros(0)
    shape = FitShape((kind,), none, none, np.zeros((1, 0), dtype=np.intp), np.zeros((1, 0)), *(nothing,) * 4)
    fit = FreeRunFit(
        linear=nothing,
        rates=nothing,
        covariance=np.zeros((0, 0)),
        sigma=1.0,
        correlation=1.0,
        mean=runs.reading,
        start=nothing,
    )
    noise = NoiseLevels(0.1, np.full(1, 0.1), np.zeros(1), {})
    machines = trace_machines(traces, "T")
    spread = machine_spread(runs, shape, fit, noise=noise, groups=np.zeros(1, dtype=np.intp), machines=machines)
    assert (spread.offsets, spread.told_apart, spread.has_targets) == ({}, 4, False)


def test_few_values_are_widened_as_students_t_and_many_are_left_alone() -> None:
    assert small_sample(1) > 5.0 > small_sample(2) > 1.5 > small_sample(8) > 1.1 > small_sample(100) > 1.0
    assert next_stay(0.5, 1000, "exponential") == pytest.approx(0.5, rel=0.05)
    assert next_stay(0.5, 1, "driven") > 5.0
    assert next_stay(0.001, 1, "linear") == pytest.approx(0.001 * small_sample(1)), "a drift is no temperature"


def test_parts_hold_machines_out_where_there_are_several() -> None:
    traces = [trace for n, name in enumerate(OFFSETS) for trace in of_machine(name, 0.0, n)]
    parts = splits(traces)
    assert len(parts) == 3
    for part in parts:
        assert not {trace.machine for trace in part.known} & {trace.machine for trace in part.ahead}
        assert part.held is not None and len(part.held) == len(part.ahead)
    assert sorted(trace.name for part in parts for trace in part.ahead) == sorted(trace.name for trace in traces)


# ------------------------------------------------------------------ what was never seen


def test_a_standstill_that_no_data_have_shown_cools(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine that is never seen to stop warms from 25 to 90 degC; stopped, it does not go on so."""
    without_bands(monkeypatch)
    times, rng = np.arange(0.0, 6000.0, 5.0), np.random.default_rng(0)
    readings = 90.0 - 65.0 * np.exp(-times / 900.0) + 0.05 * rng.standard_normal(times.size)
    alphabet = Alphabet((Switch("MarciaDecanter", "W_ON", "W_OFF", on_change=False),))
    warm = Trace("warm", times, {"MarciaDecanter": np.ones(times.size), "T": readings})
    warm = replace(warm, events=encode(warm, alphabet))
    model = learn_bins([warm], alphabet, "T", seed=0, candidates=CANDIDATES[:1]).model
    assert model.borrowed == {"OFF"}
    tracker = compile_model(model)
    belief = on_event(tracker, start(tracker, 0.0, 88.0), Event(0.0, "W_OFF"))
    later = advance(tracker, belief, 4.0 * 900.0)
    assert later.x < 35.0 and later.sigma > 5.0, "towards the lowest temperature, with a wide band"
    assert parse_model(model_text(model)).borrowed == {"OFF"}


# ------------------------------------------------------------------ plain members


def wandering(seed: int, memory: float, sigma: float) -> Trace:
    """A temperature that drifts at an Ornstein-Uhlenbeck rate, read to 0.02 degC."""
    rng, times = np.random.default_rng(seed), np.arange(0.0, 12_000.0, 5.0)
    keep, rate, x, readings = float(np.exp(-5.0 / memory)), 0.0, 50.0, []
    for _ in times:
        rate = keep * rate + sigma * float(np.sqrt(1 - keep**2) * rng.standard_normal())
        x += 5.0 * rate
        readings.append(x + 0.02 * float(rng.standard_normal()))
    return Trace(f"w{seed}", times, {"T": np.array(readings)})


def test_a_trend_is_learned_where_there_is_one_and_left_out_where_there_is_none() -> None:
    members = {member.name: member for member in learn_plain([wandering(1, 400.0, 0.01)], "T")}
    assert set(members) == {PERSISTENCE, TREND}
    assert members[TREND].heat == pytest.approx(0.01, rel=0.6) and members[TREND].memory in (100.0, 400.0, 1600.0)
    rng, times = np.random.default_rng(3), np.arange(0.0, 12_000.0, 5.0)
    walk = Trace("walk", times, {"T": 50.0 + np.cumsum(0.1 * rng.standard_normal(times.size))})
    assert [member.name for member in learn_plain([walk], "T")] == [PERSISTENCE]


def test_a_trend_member_goes_on_with_the_trend(alone: Learned) -> None:
    model = alone.model
    trend = compile_model(plain_model(model, PlainMember(TREND, 0.05, 0.001, heat=0.01, memory=1600.0)))
    still = compile_model(plain_model(model, PlainMember(PERSISTENCE, 0.05, 0.05)))
    ends = []
    for tracker in (trend, still):
        belief = start(tracker, 0.0, 40.0)
        for second in range(1, 301):
            belief = observe(tracker, belief, float(second), 40.0 + 0.01 * second)
        ends.append(advance(tracker, belief, 360.0).x)
    assert ends[0] == pytest.approx(43.6, abs=0.1) and ends[1] == pytest.approx(43.0, abs=0.1)


def test_beyond_the_models_range_the_trend_is_still_followed() -> None:
    hot = [with_signal(trace, T=trace.signals["T"] + 60.0) for trace in of_machine("m", 0.0, 1, cycles=3)]
    model = learned(hot).model
    hottest = max(float(trace.signals["T"].max()) for trace in hot)
    assert model.sha.high >= hottest + 50.0, "the next machine may run hotter than any before"
    trend = compile_model(plain_model(model, PlainMember(TREND, 0.05, 0.001, heat=0.01, memory=1600.0)))
    belief = start(trend, 0.0, model.sha.high + 10.0)
    for second in range(1, 301):
        belief = observe(trend, belief, float(second), model.sha.high + 10.0 + 0.01 * second)
    fan = forecast(trend, belief, (60.0,), np.random.default_rng(0), runs=64)
    assert float(fan.quantiles[FAN_LEVELS.index(0.5), 0]) == pytest.approx(model.sha.high + 13.6, abs=0.3)


def test_odds_are_for_who_was_better_on_data_held_out_and_go_through_json(alone: Learned) -> None:
    good, bad = PlainMember("good", 0.1, 0.1), PlainMember("bad", 0.1, 0.1, heat=0.01, memory=100.0)
    forecasts = HeldOutForecasts((good, bad), 0)
    dues = [100.0 * number for number in range(20)]
    forecasts.scored = [Scored(60.0, due, 1.0, 1.0, "m", f"day {due:g}") for due in dues]
    forecasts.of_plain = {
        "good": [Scored(60.0, due, 1.0, 0.5) for due in dues],
        "bad": [Scored(60.0, due, 1.0, 3.0) for due in dues],
    }
    better, worse = forecasts.members
    assert (better.odds[60.0], worse.odds[60.0]) == pytest.approx((21.0, 1.0 / 21.0)), "twenty cycles"
    forecasts.scored = [replace(each, machine="mn"[place % 2]) for place, each in enumerate(forecasts.scored)]
    assert [member.odds[60.0] for member in forecasts.members] == pytest.approx([3.0, 1.0 / 3.0]), "two machines"
    model = replace(alone.model, plain=forecasts.members)
    assert parse_model(model_text(model)).plain == forecasts.members


def test_later_times_of_the_same_recording_tell_nothing_of_another_day() -> None:
    forecasts = HeldOutForecasts((PlainMember("plain", 0.1, 0.1),), 0)
    scored = [Scored(60.0, 100.0 * number, 1.0, 0.1) for number in range(20)]
    forecasts.scored, forecasts.of_plain = scored, {"plain": [replace(each, crps=5.0) for each in scored]}
    of_other_days, (sure,) = forecasts.coverage[0], forecasts.members
    forecasts.other_days = False
    of_one_day, (unsure,) = forecasts.coverage[0], forecasts.members
    assert (of_other_days.other_days, of_one_day.other_days) == (True, False)
    assert (of_one_day.factor, of_other_days.widening) == (of_other_days.factor, of_other_days.factor)
    assert of_one_day.widening == pytest.approx(UNSEEN_WIDENING * of_other_days.factor)
    assert unsure.calibration[60.0] == pytest.approx(UNSEEN_WIDENING * sure.calibration[60.0])
    assert sure.odds[60.0] < 1.0 < unsure.odds[60.0], "however much better the model was on its own day"
    nothing = HeldOutForecasts(forecasts.plain, 0, other_days=False)
    (unseen,) = nothing.members
    assert unseen.odds == unsure.odds, "too short to see anything is no reason to be believed"
    assert nothing.calibration == dict.fromkeys(HORIZONS_S, UNSEEN_WIDENING * PRIOR_FACTOR)
    assert set(forecasts.calibration) == set(HORIZONS_S)


def test_another_day_may_drift_where_the_only_one_did_not() -> None:
    """Far off for the band a minute ahead, and near to the median at five: the latter is not believed of other days."""
    forecasts = HeldOutForecasts((), 0)
    forecasts.scored = [
        Scored(horizon, horizon * number, z, 0.1) for horizon, z in ((60.0, 3.0), (300.0, 0.8)) for number in range(40)
    ]
    sure = forecasts.calibration
    forecasts.other_days = False
    minute, five = forecasts.calibration[60.0], forecasts.calibration[300.0]
    assert minute == pytest.approx(UNSEEN_WIDENING * sure[60.0])
    assert UNSEEN_WIDENING * sure[300.0] < five < minute
    assert five == pytest.approx((UNSEEN_WIDENING * sure[300.0] * minute) ** 0.5)


def test_pieces_of_which_nothing_was_scored_are_no_witnesses(alone: Learned) -> None:
    """Forty exports of half a minute beside one day: no forecast along them comes due."""
    forecasts = HeldOutForecasts((PlainMember("plain", 0.1, 0.1),), 0)
    (day,) = of_machine("m", 0.0, 3, cycles=1)
    pieces = [replace(day.between(float(day.times[0]), float(day.times[0]) + 30.0), name=f"p{n}") for n in range(40)]
    traces = [day, *pieces]
    forecasts.add(alone.model, traces, [float(each.times[0]) for each in traces], np.random.default_rng(0), origins=20)
    assert {each.trace for each in forecasts.scored} == {day.name}
    assert all(1 / 2 <= odds <= 2 for odds in forecasts.members[0].odds.values())


def test_persistence_begins_from_the_last_reading_and_its_band_is_that_of_two_readings_apart() -> None:
    """A sensor's white noise of 0.1 about a level that stands: changes over any time have a deviation of 0.14."""
    rng, times = np.random.default_rng(3), np.arange(0.0, 12_000.0, 5.0)
    (member,) = learn_plain([Trace("still", times, {"T": 50.0 + 0.1 * rng.standard_normal(times.size)})], "T")
    assert member.sensor == 0.0
    over = np.array([60.0, 300.0, 900.0])
    assert member.walk == pytest.approx(float(np.exp(np.mean(np.log(0.14 / np.sqrt(over))))), rel=0.2)


def test_plain_members_that_cannot_be_run_are_refused() -> None:
    with pytest.raises(ValueError, match="plain member"):
        PlainMember("odd", 0.1, 0.1, heat=0.1)
    with pytest.raises(ValueError, match="plain member"):
        PlainMember("odd", -0.1, 0.1)
