"""What has no name is held beside the names, so that none is given in its place."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from sim.artefacts.model_json import model_text, parse_model
from sim.effects import CHANGES_AT_A_MOMENT, DRIFTING_SURROUNDINGS
from sim.effects.rivals import _drifting
from sim.engine.moment_equations import moments
from sim.engine.open_loop_run import errors, open_loop
from sim.engine.schedules import schedule
from sim.engine.simulation import simulate
from sim.lab.discrepancy import naming
from sim.lab.discrepancy.augment import augment_model
from sim.lab.discrepancy.diagnosis import Diagnosis
from sim.lab.discrepancy.evidence import fate
from sim.lab.discrepancy.fitting import (
    build_frame,
    build_record,
    heat_and_loss,
    move_frame,
    rivals,
    run_frame,
    window_grid,
)
from sim.lab.discrepancy.fitting.candidates import catalogue, catalogue_entry
from sim.lab.discrepancy.fitting.effects import deviation
from sim.lab.discrepancy.fitting.free_run_fit import fit
from sim.lab.discrepancy.fitting.named import Named, main_effect
from sim.lab.discrepancy.judging import dubious, insignificant
from sim.lab.discrepancy.naming import ONE_CHAIN, begins, likeness, step, without_idle
from sim.lab.discrepancy.rules import RULES
from sim.lab.discrepancy.screen import Projector, refine_shape, screen
from sim.lab.discrepancy.workflow import diagnose
from sim.proof.verification import verify
from sim.sha.automaton import Effect, Flow
from sim.sha.events import encode
from sim.sha.trace import Array, Trace
from tests.discrepancy.plants import ALPHABET, PERIOD, model, plant, random_model, simulated

CURRENT = {"current": "Assorbimento"}
LATE = {"gain": 1e-5, "reference": 200.0, "lag": 300.0}


def test_late_heat_goes_on_after_a_stop() -> None:
    record = build_record(model(), [plant(1, days=1)], ("Assorbimento",))
    effect = main_effect(Named(catalogue_entry("late-current-heating"), CURRENT, LATE), record.model)
    heat, loss = heat_and_loss(record, effect, np.zeros(len(record.runs)))
    stop = int(np.flatnonzero(np.diff(record.running) < 0)[0]) + 1
    assert heat[stop] > 0 and not loss.any()
    assert heat[stop + 5] == pytest.approx(heat[stop] * np.exp(-5 * PERIOD / LATE["lag"]))


def test_what_comes_late_runs_on_through_cuts() -> None:
    record = build_record(model(), [plant(1, days=2)], ("Assorbimento",))
    effect = main_effect(Named(catalogue_entry("late-current-heating"), CURRENT, {**LATE, "lag": 3000.0}), record.model)
    whole = deviation(record, effect)
    later = record.cycle >= 3
    for cut, kept in ((record.select(later), later), (record.by_cycles(), later | True)):
        begun = np.flatnonzero(cut.runs.first)
        assert np.array_equal(deviation(cut, effect), whole[kept])
        assert np.abs(deviation(cut, effect)[begun[1:] + 1]).max(initial=0.0) > 0 or begun.size == 1
    assert deviation(record.select(later), effect)[1] != 0.0


def test_a_cooling_that_grows_less_ends_at_none_and_nothing_explodes() -> None:
    """Where a pump's switch chattered, held-out cycles were run with a loss below none, up to 1e23 degC."""
    record = build_record(model(), [plant(1, days=2)], ())
    frame = move_frame(build_frame(record), record)
    entry = next(each for each in rivals() if each.name == "less-and-less-cooling")
    begin = float(record.runs.time[0])
    params = {"loss": 1.0, "sink": 17.0, "at": begin, "over": 7000.0, "turning": 0.0, entry.strength: 3.5e-4}
    state = run_frame(
        frame,
        np.concatenate([frame.centre, [3.5e-4]]),
        record.reading[record.window_first],
        [Named(entry, {}, params)],
    )
    assert (state.k + state.loss).min() == 0.0
    assert np.abs(window_grid(frame, state).heats).max() < 1e6


def test_what_does_no_better_than_its_special_case_is_that_case() -> None:
    record = build_record(model(), [plant(3, days=2)], ("Assorbimento",))
    base = fit(move_frame(build_frame(record), record))
    (special,) = step(base, [catalogue_entry("current-heating")], CURRENT, rules=RULES).evidence
    late = replace(special, entry=catalogue_entry("late-current-heating"))
    for ahead, left in ((5.0, 1), (7.0, 2)):
        evidence = [special, replace(late, gain=special.gain + ahead)]
        assert len(without_idle(evidence, RULES)) == left


@pytest.mark.parametrize(
    ("once", "twice", "left"),
    [
        (5.0, 9.0, ["less-cooling", "current-heating"]),
        (5.0, 12.0, ["less-cooling-twice", "current-heating"]),
        (-2.0, 5.0, ["current-heating"]),
        (5.0, 5.5, ["current-heating"]),
    ],
)
def test_a_special_case_takes_the_names_place_where_the_wider_rival_does(
    once: float, twice: float, left: list[str]
) -> None:
    record = build_record(model(), [plant(3, days=2)], ("Assorbimento",))
    base = fit(move_frame(build_frame(record), record))
    (name,) = step(base, [catalogue_entry("current-heating")], CURRENT, rules=RULES).evidence
    entries = {entry.name: entry for entry in rivals()}
    ahead = {"less-cooling": once, "less-cooling-twice": twice}
    evidence = [name, *(replace(name, entry=entries[key], gain=name.gain + value) for key, value in ahead.items())]
    found = without_idle(evidence, RULES)
    assert {each.entry.name for each in found} == set(left)
    assert max(found, key=lambda each: each.gain).entry.name == left[0]


def test_a_name_that_explains_less_than_what_has_none_is_not_said_to_add_nothing() -> None:
    record = build_record(model(), [plant(3, days=2)], ("Assorbimento",))
    base = fit(move_frame(build_frame(record), record))
    made = step(base, [catalogue_entry("current-heating")], CURRENT, rules=RULES)
    (name,) = (replace(each, gain=40.0, fitted=base) for each in made.evidence)
    rival = replace(name, entry=next(entry for entry in rivals() if entry.name == "less-cooling"), gain=100.0)
    led = replace(made, evidence=(rival, name), cosines={})
    assert fate(name, led, dubious(led), kept=False) == "explains 60.0 nats less than the best"
    chance = replace(made, evidence=(replace(rival, gain=3.0), replace(name, gain=1.0)), cosines={})
    assert fate(chance.evidence[1], chance, insignificant(chance), kept=False) == "adds nothing that chance does not"


def test_special_cases_are_fitted_where_what_has_them_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(naming, "CONFIRMED", 1)
    record = build_record(model(), [plant(3, days=2, winding=0.01)], ("Assorbimento",))
    late = catalogue_entry("late-current-heating")
    special = late.candidate.special
    few = [entry for entry in catalogue() if entry.name in special]
    found = step(fit(move_frame(build_frame(record), record)), [*few, late], CURRENT, rules=RULES)
    assert {each.entry.name for each in found.evidence if each.is_joint} == {*special, "late-current-heating"}


def test_where_the_plant_is_rough_and_the_sensor_may_err_for_long_a_fit_begins_from_a_quiet_plant_too() -> None:
    record = build_record(model(), [plant(3, days=1)], ("Assorbimento",))
    fitted = fit(move_frame(build_frame(record), record))
    rough = replace(fitted, noise=replace(fitted.noise, process=0.1))
    assert begins(rough) == (rough,)
    lasting = replace(rough, noise=replace(rough.noise, lasting=0.3))
    same, quiet = begins(lasting)
    assert same is lasting and quiet.state is lasting.state
    assert quiet.noise.process < 0.01 and quiet.noise.lasting > 0
    assert begins(quiet) == (quiet,)


def test_what_the_diagnosis_gives_a_step_is_what_the_engine_executes() -> None:
    """In linear flows of no slope the temperature is the sum of the heats: nothing else can hide a difference."""
    made = model()
    still = tuple(
        replace(place, flow=Flow("linear", {"noise": 0.0, "m": 0.0}), distribution=None) for place in made.sha.locations
    )
    effect = Effect(
        "quadratic-current-heating", {"gain": 1e-8, "reference": 200.0, "lag": 75.0}, CURRENT, ("LOW", "HIGH")
    )
    made = replace(made, sha=replace(made.sha, locations=still, effects=(effect,), low=-1e9, high=1e9))
    trace = plant(1, days=2)
    record = build_record(replace(made, sha=replace(made.sha, effects=())), [trace], ("Assorbimento",))
    found = record.runs.dt * heat_and_loss(record, effect, np.zeros(len(record.runs)))[0]
    course = moments(schedule(made, trace.events, record.runs.time, inputs=trace, policy="resync"), 0.0).mean
    within = ~record.runs.first[1:]
    assert np.abs((found[1:] - np.diff(course))[within]).max() < 1e-6 * np.abs(np.diff(course)).max()


def test_a_run_begins_with_nothing_that_comes_late_and_what_was_not_read_adds_nothing() -> None:
    trace = plant(1, days=2)
    current = np.where(trace.times < trace.times[0] + 6 * 3600.0, np.nan, trace.signals["Assorbimento"])
    record = build_record(
        model(), [replace(trace, signals={**trace.signals, "Assorbimento": current})], ("Assorbimento",)
    )
    effect = Effect("quadratic-current-heating", {"gain": 1e-8, "reference": 200.0, "lag": 75.0}, CURRENT, ("LOW",))
    late = deviation(record, effect)
    begun = int(np.flatnonzero(np.isfinite(record.signal("Assorbimento")))[0])
    assert not late[: begun + 1].any() and late[begun:].any()


def named(found: Diagnosis) -> dict[str, dict[str, float]]:
    assert found.verdict == "named", found.sentence
    return {effect.name: dict(effect.params) for effect in found.effects}


def test_the_heat_of_a_winding_is_named_with_its_lag() -> None:
    """Two masses of 120 s and 60 s, rows of 30 s: one mass of their sum is the nearest form."""
    trace = plant(2, days=2, winding=0.006)
    found = diagnose(model(), [trace], seed=0)
    (params,) = named(found.diagnosis).values()
    assert 120.0 < params["lag"] < 240.0
    assert params["gain"] * 200.0**2 == pytest.approx(0.006, rel=0.25)
    assert found.fitted is not None
    made = parse_model(model_text(augment_model(found.fitted, readings=[trace])))
    assert made.sha.effects[0].params["lag"] == pytest.approx(params["lag"])
    assert verify(made).deployable
    before, after = (errors(open_loop(each, trace), trace, "T").at_samples.rmse for each in (model(), made))
    assert after < 0.2 * before


def on_its_way(delay: float, lag: float, period: float) -> Callable[[Array, Array, Array], tuple[Array, Array]]:
    """What `plant` takes: heat of the current alone that comes so late; starts, stops and losses come at once."""

    def heat(times: Array, on: Array, current: Array) -> tuple[Array, Array]:
        coming, keep = np.interp(times - delay, times, on * current, left=0.0), np.exp(-period / lag)
        return 4e-5 * lfilter([1.0 - keep], [1.0, -keep], coming), np.zeros(times.size)

    return heat


@pytest.mark.parametrize("seed", range(1, 7))
def test_heat_of_the_current_that_is_on_its_way_for_minutes_looks_like_what_it_is(seed: int) -> None:
    delay, lag = np.exp(np.random.default_rng(seed).uniform(np.log(30.0), np.log(1800.0), 2)).tolist()
    trace = plant(seed, days=2, period=60.0, more=on_its_way(delay, lag, 60.0))
    record = build_record(model(), [trace], ("Assorbimento",))
    base = fit(move_frame(build_frame(record), record), rounds=1, iterations=3)
    chain = [catalogue_entry(name) for name in ("late-current-heating", "dead-time", "sensor-lag", "current-heating")]
    clocks = [entry for entry in rivals() if entry.name in ("heat-by-the-clock", "heat-in-a-shift")]
    screened, _ = screen(base, [*chain, *clocks], CURRENT)
    best = screened.best()
    number = best["late-current-heating"]
    assert next(iter(best)) in ONE_CHAIN and screened.gain[number] > RULES.least_gain_nats
    found = refine_shape(Projector(base), screened.shapes[number], 1e-5).params
    # What is on its way is told; how it parts into heat and lateness, where both are short against the rows, is not.
    late = found.get("delay", 0.0) + found["lag"]
    assert found["gain"] * late == pytest.approx(4e-5 * (delay + lag), rel=0.4)
    assert late == pytest.approx(delay + lag, rel=0.3, abs=2.0 * 60.0)


def test_heat_that_comes_after_half_an_hour_is_named_and_executed() -> None:
    trace = plant(4, days=2, period=60.0, more=on_its_way(1500.0, 100.0, 60.0))
    found = diagnose(model(), [trace], seed=0, most=1)
    (params,) = named(found.diagnosis).values()
    assert params["delay"] == pytest.approx(1500.0, rel=0.1)
    assert found.fitted is not None
    made = parse_model(model_text(augment_model(found.fitted, readings=[trace])))
    before, after = (errors(open_loop(each, trace), trace, "T").at_samples.rmse for each in (model(), made))
    assert after < 0.2 * before and verify(made).deployable


def test_a_sensor_that_drifts_from_the_first_day_on_is_no_step_of_the_surroundings() -> None:
    trace = plant(3, days=6, period=300.0)
    drifted = trace.signals["T"] + np.linspace(0.0, 2.0, trace.times.size)
    record = build_record(model(), [replace(trace, signals={**trace.signals, "T": np.round(drifted, 1)})], ())
    base = fit(move_frame(build_frame(record), record), rounds=2)
    since = [entry for entry in rivals() if "surroundings" in entry.name or "since" in entry.name]
    found = step(base, [*since, catalogue_entry("wear-drift")], {}, rules=RULES).best
    assert found is not None and found.entry.name == DRIFTING_SURROUNDINGS
    assert found.shape.params["at"] < trace.times[0] + 86400.0


def test_what_came_twice_is_found_from_the_one_that_is_clear() -> None:
    """Greased at 17 % and at 46 % of eight days: between pairs of sixteen moments each the first one was missed."""
    size, period = int(8 * 86400 / 300.0), 300.0
    begun = int(0.172 * size), int(0.459 * size)

    def heat(times: Array, on: Array, current: Array) -> tuple[Array, Array]:
        run, row = np.cumsum(on) * period, np.arange(on.size)
        faded = sum(np.exp(-np.maximum(run - run[at], 0.0) / (6 * 3600.0)) * (row >= at) for at in begun)
        return 0.003 * on * faded, np.zeros(on.size)

    trace = plant(3, days=8, period=period, more=heat)
    record = build_record(model(), [trace], ())
    base = fit(move_frame(build_frame(record), record), rounds=2)
    events = [entry for entry in rivals() if "heat-after" in entry.name and "event" in entry.name]
    found = step(base, events, {}, rules=RULES).best
    assert found is not None and found.entry.name == "heat-after-two-events"
    moments = sorted((found.shape.params["at"], found.shape.params["again"]))
    assert moments == pytest.approx([trace.times[at] for at in begun], abs=6 * 3600.0)


def test_what_changes_at_a_moment_takes_one_of_the_places_that_are_confirmed() -> None:
    record = build_record(model(), [plant(3, days=2)], ("Assorbimento",))
    base = fit(move_frame(build_frame(record), record), rounds=1, iterations=3)
    (one,) = step(base, [catalogue_entry("current-heating")], CURRENT, rules=RULES).evidence
    entries = {entry.name: entry for entry in (*rivals(), *catalogue())}
    others = ["heat-after-an-event", "heat-after-two-events", "current-heating", "wear-drift"]
    order = [replace(one, entry=entries[name]) for name in (*CHANGES_AT_A_MOMENT, *others)]
    first = [each.entry.name for each in naming.first_kinds(order)]
    assert first == [*CHANGES_AT_A_MOMENT, *others[: naming.CONFIRMED - 1]]


def test_a_moment_that_is_looked_for_lies_in_the_record() -> None:
    trace = plant(3, days=2, period=60.0)
    record = build_record(model(), [trace], ())
    base = fit(move_frame(build_frame(record), record), rounds=1, iterations=3)
    begin, end = record.runs.time[0], record.runs.time[-1]
    less = [entry for entry in rivals() if entry.name == "less-and-less-cooling"]
    screened, _ = screen(base, less, {})
    for shape in screened.shapes:
        assert begin <= refine_shape(Projector(base), shape, 1e-5).params["at"] <= end


def heated(lag: float, kind: str = "quadratic-current-heating", gain: float = 2e-7) -> Trace:
    """Days at many currents, of the very automaton with a heat of the current that comes so late."""
    rng, rough = np.random.default_rng(5), random_model(2e-4, 400.0, 0.2)
    effect = Effect(kind, {"gain": gain, "reference": 200.0, "lag": lag}, CURRENT, ("LOW", "HIGH"))
    trace = simulated(rough, 3, days=2)
    levels = np.repeat(rng.uniform(80.0, 330.0, trace.times.size // 40 + 1), 40)[: trace.times.size]
    signals = {**trace.signals, "Assorbimento": levels * trace.signals["MarciaDecanter"]}
    driven = replace(trace, signals=signals, events=())
    driven = replace(driven, events=encode(driven, ALPHABET))
    source = replace(rough.sha, effects=(*rough.sha.effects, effect))
    course = simulate(schedule(source, driven.events, driven.times, inputs=driven, policy="resync"), 17.0, 1, rng)
    read = course.temperatures[0] + rough.sensor_sigma * rng.standard_normal(driven.times.size)
    return replace(driven, signals={**signals, "T": np.round(read, 1)})


@pytest.mark.parametrize(("lag", "least", "most"), [(0.0, 0.0, 10.0), (60.0, 50.0, 70.0)])
def test_the_lag_that_is_named_is_that_of_the_plant(lag: float, least: float, most: float) -> None:
    found = named(diagnose(random_model(2e-4, 400.0, 0.2), [heated(lag)], seed=0).diagnosis)
    assert found.keys() == {"quadratic-current-heating"}
    assert least <= found["quadratic-current-heating"].get("lag", 0.0) < most


def test_heat_of_the_current_that_comes_late_is_named() -> None:
    trace = heated(400.0, "late-current-heating", 8e-5)
    found = diagnose(random_model(2e-4, 400.0, 0.2), [trace], seed=0)
    (params,) = named(found.diagnosis).values()
    assert found.diagnosis.effects[0].plain == "heat of the current that comes late"
    assert 250.0 < params["lag"] < 600.0, params
    assert params["gain"] == pytest.approx(8e-5, rel=0.3)
    assert found.fitted is not None
    made = augment_model(found.fitted, readings=[trace])
    after = errors(open_loop(made, trace), trace, "T").at_samples.rmse
    assert after < 0.5 * errors(open_loop(random_model(2e-4, 400.0, 0.2), trace), trace, "T").at_samples.rmse


def test_a_further_name_looks_like_an_earlier_one_by_the_shape_that_it_has_there() -> None:
    """Only with a long lag does heat of the current look like a sensor that lags."""
    lag = Effect("sensor-lag", {"tau": 150.0, "order": 2.0})
    record = build_record(model(), [simulated(random_model(2e-4, 400.0, 0.2, lag), 3, days=2)], ("Assorbimento",))
    wanted = ("sensor-lag", "quadratic-current-heating")
    few = [entry for entry in catalogue() if entry.name in wanted]
    found = step(fit(move_frame(build_frame(record), record)), few, CURRENT, rules=RULES)
    by_name = {each.entry.name: each for each in found.evidence}
    assert found.best is by_name["sensor-lag"]
    heat = by_name["quadratic-current-heating"]
    alike = [
        likeness(found, replace(heat, shape=replace(heat.shape, params={"reference": 200.0, **late})))
        for late in ({}, {"lag": 15.0}, {"lag": 150.0})
    ]
    assert alike[0] < 0.6 and alike == sorted(alike) and alike[2] > 0.8


def test_a_sensor_that_lags_is_told_as_one() -> None:
    lag = Effect("sensor-lag", {"tau": 150.0, "order": 2.0})
    trace = simulated(random_model(2e-4, 400.0, 0.2, lag), 3, days=2)
    assert "sensor-lag" in named(diagnose(random_model(2e-4, 400.0, 0.2), [trace], seed=0).diagnosis)


def test_what_grows_over_no_time_is_there_at_once() -> None:
    view: Any = SimpleNamespace(rate=1e-3, time=np.array([0.0, 10.0, 20.0]))
    heat = _drifting({"rise": 2.0, "at": 10.0, "over": 0.0}, view)
    assert heat.tolist() == [0.0, 2e-3, 2e-3]
