"""The gateway's forecasts along a recorded trace: honest for a perfect model, blind for the future, silent in a gap."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from gateway.lab.judging.figures import scan_trace, skill_rows
from gateway.machine.model.along import estimate_offset, forecast_trace, recorded_scans
from gateway.machine.model.predict import Predictor
from gateway.settings.config import ForecastSection
from sim.lab.judge.past import persist
from sim.lab.judge.rows import skill, trace_machine
from sim.lab.learning.plain import PERSISTENCE
from sim.sha.automaton import Distribution, Effect, Flow, Location
from sim.sha.model import Model, PlainMember
from sim.sha.trace import Array, Trace
from tests.gateway.support import CURRENT, RUNNING, TEMPERATURE, two_modes

MODEL = two_modes()
SHORT = ForecastSection(horizons=(60.0,), period=100.0, runs=250)


def measured(length: float, step: float = 10.0, seed: int = 3, model: Model = MODEL) -> Trace:
    """A trace drawn from the model itself: stays, targets, flow noise and sensor noise by its own laws."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, length, step)
    places = {location.name: location for location in model.sha.locations}
    running, temperature = np.zeros(times.size), np.zeros(times.size)
    here, left, x = "off", 0.0, 25.0
    for row in range(times.size):
        if left <= 0.0:
            here = "on" if here == "off" else "off"
            law = places[here].distribution
            assert law is not None
            target = rng.normal(law.params["mu"], law.params["sigma"])
            left = rng.exponential(model.semi_markov[here].law.params["mean"])
        # Exact for the row before: the mode changes at rows only.
        running[row], temperature[row] = here == "on", x
        k, noise = places[here].flow.params["k"], places[here].flow.params["noise"]
        decay = np.exp(-k * step)
        x = target + (x - target) * decay + noise * np.sqrt((1 - decay**2) / (2 * k)) * rng.standard_normal()
        left -= step
    read = temperature + model.sensor_sigma * rng.standard_normal(times.size)
    return Trace("drawn", times, {RUNNING: running, CURRENT: np.full(times.size, 150.0), TEMPERATURE: read})


def test_a_perfect_model_covers_ninety_per_cent_and_beats_persistence() -> None:
    trace = measured(24_000.0)
    rows = skill_rows(
        trace,
        TEMPERATURE,
        MODEL.alphabet,
        models={"perfect": [MODEL]},
        others={PERSISTENCE: partial(persist, horizons=SHORT.horizons)},
        forecasts=SHORT,
        scan_period=10.0,
    )
    found, still = (skill([row for row in rows if row.method == method]) for method in ("perfect", PERSISTENCE))
    assert found.forecasts == still.forecasts > 200
    # Binomial error of forecasts that do not overlap, and as much again for that of the bands that learn.
    assert abs(found.coverage - 0.9) < 2.6 * np.sqrt(2 * 0.09 / found.forecasts)
    assert found.crps < still.crps


def test_nothing_of_the_future_is_used() -> None:
    trace = measured(3000.0)
    changed = {name: column.copy() for name, column in trace.signals.items()}
    changed[TEMPERATURE][trace.times > 1500.0] += 40.0
    changed[RUNNING][trace.times > 1500.0] = 1.0
    # With members beside it: their weights and bands learn from what has come true, and from nothing else.
    trend = PlainMember("damped trend", 0.1, 0.01, heat=0.01, memory=400.0)
    model = replace(MODEL, plain=(PlainMember("persistence", 0.0, 0.05), trend))
    made, other, cut = (
        forecast_trace([model], along, SHORT, scan_period=10.0)
        for along in (trace, replace(trace, signals=changed), trace.between(0.0, 1501.0))
    )
    before = [one for one in made if one.time <= 1500.0]
    assert len(before) == len(cut) >= 10
    for one, two, three in zip(before, other, cut, strict=False):
        np.testing.assert_array_equal(one.quantiles, two.quantiles)
        np.testing.assert_array_equal(one.quantiles, three.quantiles)
    assert not np.array_equal(made[-1].quantiles, other[-1].quantiles)


def test_the_rivals_see_the_past_alone() -> None:
    trace, asked = measured(1000.0), list[float]()

    def rival(past: object) -> Array:
        times, temperature = past.times, past.temperature  # type: ignore[attr-defined]
        assert times.shape == temperature.shape == past.inputs[RUNNING].shape  # type: ignore[attr-defined]
        assert times[-1] == asked_at[len(asked)]
        asked.append(float(times[-1]))
        return np.full((99, 1), temperature[-1])

    asked_at = [forecast.time for forecast in forecast_trace([MODEL], trace, SHORT, scan_period=10.0)]
    rows = skill_rows(
        trace,
        TEMPERATURE,
        MODEL.alphabet,
        models={"ours": [MODEL]},
        others={"rival": rival},
        forecasts=SHORT,
        scan_period=10.0,
    )
    assert asked == asked_at
    assert {row.moment for row in rows if row.method == "rival"} == {row.moment for row in rows if row.method == "ours"}


def test_bands_learn_online_from_what_came_true() -> None:
    sure = replace(MODEL, sensor_sigma=1e-3)
    sure = replace(
        sure,
        sha=replace(
            sure.sha,
            locations=tuple(
                replace(place, flow=Flow("exponential", {**place.flow.params, "noise": 1e-3}))
                for place in sure.sha.locations
            ),
        ),
    )
    made = forecast_trace([sure], measured(6000.0), SHORT, scan_period=10.0)
    assert made[0].factors[0] == 1.0
    assert made[-1].factors[0] > 2.0


def test_members_make_a_mixture() -> None:
    warm = replace(MODEL, sha=replace(MODEL.sha, name="warm"), sensor_sigma=0.5)
    (alone, mixed) = (
        forecast_trace(models, measured(1000.0), SHORT, scan_period=10.0) for models in ([MODEL], [MODEL, warm])
    )
    assert [one.time for one in alone] == [one.time for one in mixed]
    assert mixed[0].runs == 2 * alone[0].runs
    assert mixed[0].levels == alone[0].levels


def test_a_step_longer_than_the_gap_is_one_and_nothing_is_held_over_it() -> None:
    trace = measured(600.0, step=1.0)
    kept = (trace.times < 200.0) | (trace.times >= 300.0)
    signals = {name: column[kept].copy() for name, column in trace.signals.items()}
    signals[CURRENT][200:210] = np.nan
    gapped = Trace("gapped", trace.times[kept], signals)
    scans = list(recorded_scans(gapped, 1.0, MODEL.alphabet))
    assert len(scans) == 500
    predictor = Predictor(MODEL, TEMPERATURE)
    predictions = {scan.time: predictor.step(scan) for scan in scans}
    assert predictions[199.0].known and predictions[199.0].inputs_good
    assert predictions[300.0].reset and not predictions[300.0].known, "the current was not read since"
    assert not predictions[309.0].inputs_good
    assert predictions[310.0].known and predictions[310.0].inputs_good
    made = forecast_trace([MODEL], gapped, SHORT)
    assert not [one for one in made if 200.0 <= one.time < 310.0]
    rows = skill_rows(gapped, TEMPERATURE, MODEL.alphabet, models={"ours": [MODEL]}, others={}, forecasts=SHORT)
    assert not [row for row in rows if 199.0 < row.origin + 60.0 < 300.0], "the outcome lies in the gap"


def test_a_scan_shows_the_newest_rows_and_corrects_by_each_reading_once() -> None:
    times = np.arange(0.0, 30.0, 0.1)
    column = 20.0 + times
    # Read every 2.5 s: every other scan or so has no new reading.
    column[np.arange(times.size) % 25 != 0] = np.nan
    column[-1] = np.nan
    steady = {RUNNING: np.ones(times.size), CURRENT: np.full(times.size, 150.0)}
    bad = np.zeros(times.size, dtype=bool)
    bad[250:] = True
    fast = Trace("fast", times, {**steady, TEMPERATURE: np.where(bad, np.nan, column)}, bad={TEMPERATURE: bad})
    scans = list(recorded_scans(fast, 1.0, MODEL.alphabet))
    assert [scan.time for scan in scans] == pytest.approx(range(31))
    assert scans[5].good(TEMPERATURE) == pytest.approx(25.0)
    assert scans[7].good(TEMPERATURE) == pytest.approx(25.0)
    assert scans[8].good(TEMPERATURE) == pytest.approx(27.5)
    assert scans[27].good(TEMPERATURE) is None
    past = scan_trace(fast, TEMPERATURE, MODEL.alphabet, 1.0)
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(past.temperature)), [0, 3, 5, 8, 10, 13, 15, 18, 20, 23])
    predictor = Predictor(MODEL, TEMPERATURE)
    corrected = [scan.time for scan in scans if predictor.step(scan).measured is not None]
    assert corrected == [0.0, 3.0, 5.0, 8.0, 10.0, 13.0, 15.0, 18.0, 20.0, 23.0]


def test_what_the_model_reads_and_the_trace_lacks_is_said() -> None:
    trace = measured(100.0)
    less = replace(trace, signals={TEMPERATURE: trace.signals[TEMPERATURE]})
    with pytest.raises(ValueError, match="trace 'drawn': the model reads Assorbimento, MarciaDecanter; the trace has"):
        forecast_trace([MODEL], less, SHORT)
    with pytest.raises(ValueError, match="trace 'drawn': has no signal 'T', which is to be forecast"):
        skill_rows(trace, "T", MODEL.alphabet, models={}, others={}, forecasts=SHORT)


def test_without_a_model_of_ours_the_others_are_asked_every_period() -> None:
    trace = measured(1000.0)
    rows = skill_rows(
        trace,
        TEMPERATURE,
        MODEL.alphabet,
        models={},
        others={"zero": lambda past: np.zeros((99, 1))},
        forecasts=SHORT,
        scan_period=10.0,
    )
    assert [row.origin for row in rows] == [100.0 * number for number in range(10)]
    assert {row.machine for row in rows} == {trace_machine(trace)} == {"drawn"}
    assert recorded_scans(replace(trace, times=np.empty(0), signals={}), 1.0, MODEL.alphabet) is not None


def test_an_empty_trace_brings_no_scan_and_no_forecast() -> None:
    nothing = np.empty(0)
    empty = Trace("empty", nothing, {RUNNING: nothing, CURRENT: nothing, TEMPERATURE: nothing})
    assert list(recorded_scans(empty, 1.0, MODEL.alphabet)) == []
    rows = skill_rows(empty, TEMPERATURE, MODEL.alphabet, models={"ours": [MODEL]}, others={}, forecasts=SHORT)
    assert rows == []


def test_what_the_gateway_learns_of_a_machine_along_its_trace_is_its_offset() -> None:
    def moved(place: Location) -> Location:
        assert place.distribution is not None
        law = {**place.distribution.params, "mu": place.distribution.params["mu"] + 4.0}
        return replace(place, distribution=Distribution("normal", law))

    warmer = replace(MODEL, sha=replace(MODEL.sha, locations=tuple(map(moved, MODEL.sha.locations))))
    asked = replace(MODEL, sha=replace(MODEL.sha, effects=(Effect("machine-offset", {"sigma": 5.0}),)))
    along = measured(9000.0, model=warmer)
    learned = estimate_offset(asked, along, scan_period=10.0)
    assert learned is not None
    mean, sigma = learned
    assert sigma < 1.0 and abs(mean - 4.0) < 3.0 * sigma
    assert estimate_offset(MODEL, along, scan_period=10.0) is None
