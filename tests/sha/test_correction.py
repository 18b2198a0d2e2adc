"""The correction T' = k T + b: the identity changes nothing, any other maps what was simulated, readings are T'."""

from dataclasses import replace
from math import inf

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.artefacts.model_json import model_document, model_hash, model_text, parse_model
from sim.effects.correction import apply_correction, in_sensor_scale
from sim.engine.belief import filter_trace, start
from sim.engine.moment_equations import moments
from sim.engine.open_loop_run import open_loop
from sim.engine.schedules import schedule
from sim.engine.simulation import simulate
from sim.engine.tracker import compile_model
from sim.files import ArtefactError
from sim.forecast.fan import forecast
from sim.sha.automaton import SHA, Distribution, Location
from sim.sha.events import DECANTER
from sim.sha.model import Correction, Model
from sim.sha.trace import Event, Trace
from tests.sha.models import EVERYWHERE, limited
from tests.sha.plants import exponential_stays, relaxing, simulate_two, single, two_states

WORD = [
    Event(40.0 * (place + 1), each.name) for place, each in enumerate((*EVERYWHERE.locations, *EVERYWHERE.locations))
]
OUTPUTS = np.arange(0.0, 800.0, 20.0)
CURRENT = Trace("current", np.arange(0.0, 800.0, 10.0), {"Assorbimento": 50.0 + 40.0 * np.sin(np.arange(80.0))})

corrections = st.builds(Correction, st.floats(0.5, 2.0), st.floats(-20.0, 20.0))


def everywhere(correction: Correction, sha: SHA = EVERYWHERE) -> Model:
    return Model(sha, DECANTER, "T", 0.1, correction=correction)


@settings(max_examples=20, deadline=None)
@given(corrections, st.sampled_from([inf, 0.05]), st.floats(15.0, 60.0))
def test_simulating_a_corrected_model_is_mapping_what_the_automaton_does(
    correction: Correction, rate: float, first: float
) -> None:
    plain = everywhere(Correction(), limited(rate))
    steps, scaled = (schedule(m, WORD, OUTPUTS, inputs=CURRENT) for m in (plain, replace(plain, correction=correction)))
    own = simulate(steps, first, 20, np.random.default_rng(1))
    read = simulate(scaled, apply_correction(correction, first), 20, np.random.default_rng(1))
    expected = correction.gain * own.temperatures + correction.offset
    np.testing.assert_allclose(read.temperatures, expected, rtol=1e-9, atol=1e-7)
    assert read.clamps.tolist() == own.clamps.tolist() and read.limited.tolist() == own.limited.tolist()
    exact, mapped = moments(steps, first), moments(scaled, apply_correction(correction, first))
    np.testing.assert_allclose(mapped.mean, correction.gain * exact.mean + correction.offset, atol=1e-7)
    np.testing.assert_allclose(mapped.variance, correction.gain**2 * exact.variance, rtol=1e-9, atol=1e-9)


def test_an_identity_is_the_very_same_model_for_every_way_to_run_it() -> None:
    model = two_states(exponential_stays())
    assert in_sensor_scale(replace(model, correction=Correction(1.0, 0.0))) is not None
    assert in_sensor_scale(model) is model
    assert compile_model(model).model is model
    assert schedule(model, [], [0.0, 1.0]).sha is model.sha


@settings(max_examples=10, deadline=None)
@given(corrections)
def test_belief_of_corrected_readings_is_the_mapped_belief_and_predicts_them_as_well(correction: Correction) -> None:
    model = two_states(exponential_stays(), sensor=0.1)
    trace, _ = simulate_two(model, 120, np.random.default_rng(3))
    k, b = correction.gain, correction.offset
    scaled = replace(model, correction=correction, sensor_sigma=k * model.sensor_sigma)
    own = filter_trace(model, trace)
    read = filter_trace(scaled, replace(trace, signals={"T": k * trace.signals["T"] + b}))
    np.testing.assert_allclose(read.predicted, k * own.predicted + b, rtol=1e-8, atol=1e-7)
    np.testing.assert_allclose(read.variance, k**2 * own.variance, rtol=1e-7)
    assert read.belief.recent == pytest.approx(own.belief.recent, rel=1e-5)
    assert read.belief.evidence == pytest.approx(own.belief.evidence - (trace.times.size - 1) * np.log(k), rel=1e-6)


def test_a_forecast_and_its_limit_are_of_what_the_sensor_reads() -> None:
    plain = two_states(exponential_stays(), sensor=0.1)
    scaled = replace(plain, correction=Correction(1.1, 3.0), sensor_sigma=0.11)
    own = forecast(plain, start(plain, 0.0, 60.0), [60.0, 300.0], np.random.default_rng(5), limit=64.0)
    read = forecast(scaled, start(scaled, 0.0, 69.0), [60.0, 300.0], np.random.default_rng(5), limit=1.1 * 64.0 + 3.0)
    np.testing.assert_allclose(read.quantiles, 1.1 * own.quantiles + 3.0, atol=1e-6)
    assert [e.probability for e in read.exceedance] == pytest.approx([e.probability for e in own.exceedance], abs=1e-9)


def test_the_sensors_noise_is_that_of_the_reading_and_is_not_scaled() -> None:
    still = single(relaxing(0.01, 1e-9), Distribution("normal", {"mu": 40.0, "sigma": 0.0}), sensor=0.5)
    scaled = replace(still, correction=Correction(2.0, 0.0))
    fan = forecast(scaled, start(scaled, 0.0, 30.0), [1e5], np.random.default_rng(1), runs=4000)
    half = (fan.quantiles[-1, 0] - fan.quantiles[0, 0]) / 2.0
    assert fan.quantiles[2, 0] == pytest.approx(80.0, abs=0.05)
    assert half == pytest.approx(1.645 * 0.5, rel=0.1)


def test_an_open_loop_starts_at_the_reading_and_ends_at_the_mapped_target() -> None:
    model = replace(
        single(relaxing(0.01, 0.01), Distribution("normal", {"mu": 50.0, "sigma": 0.0})),
        correction=Correction(1.1, 2.0),
    )
    times = np.arange(0.0, 2000.0, 10.0)
    run = open_loop(model, Trace("t", times, {"T": np.full(times.size, 30.0)}))
    assert run.mean[0] == pytest.approx(30.0)
    assert run.mean[-1] == pytest.approx(1.1 * 50.0 + 2.0, abs=1e-6)


def test_an_identity_leaves_text_and_hash_as_they_were_and_any_other_comes_back() -> None:
    model = two_states(exponential_stays())
    assert "correction" not in model_document(model)
    changed = replace(model, correction=Correction(1.02, -0.5))
    assert model_hash(changed) != model_hash(model)
    assert parse_model(model_text(changed)) == changed
    assert parse_model(model_text(model)).correction == Correction()


@pytest.mark.parametrize("said", ['{"gain": 0, "offset": 1}', '{"gain": 1}', '{"gain": 1, "offset": "inf"}', "3"])
def test_a_correction_that_is_none_is_refused_with_its_place(said: str) -> None:
    text = model_text(replace(two_states(), correction=Correction(2.0, 1.0)))
    whole = '"correction": {\n    "gain": 2.0,\n    "offset": 1.0\n  }'
    assert whole in text
    with pytest.raises(ArtefactError, match="correction"):
        parse_model(text.replace(whole, f'"correction": {said}'))


def test_an_offset_is_refused_for_a_law_that_cannot_be_shifted_and_a_gain_scales_it() -> None:
    law = Distribution("weibull", {"shape": 2.0, "scale": 40.0})
    odd = Model(SHA("odd", (Location("q", relaxing(0.01, 0.1), law),), (), "q"), DECANTER, "T", 0.1)
    scaled = in_sensor_scale(replace(odd, correction=Correction(1.5, 0.0)))
    assert scaled.sha.locations[0].distribution == Distribution("weibull", {"shape": 2.0, "scale": 60.0})
    with pytest.raises(ValueError, match=r"location 'q'.*cannot shift a weibull law"):
        in_sensor_scale(replace(odd, correction=Correction(1.0, 1.0)))
