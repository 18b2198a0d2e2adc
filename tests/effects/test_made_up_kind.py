"""A kind that is added as one row is simulated, filtered, forecast, bounded, exported, corrected, fitted and named."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from sim.artefacts.model_json import model_text, parse_model
from sim.effects.correction import in_sensor_scale
from sim.effects.kind import EffectRefusal
from sim.effects.kinds import ROLES
from sim.engine.belief import start
from sim.engine.plant import compile_plant
from sim.engine.tracker import compile_model
from sim.forecast.fan import forecast
from sim.lab.discrepancy.augment import augment_model
from sim.lab.discrepancy.fitting.candidates import catalogue_entry
from sim.lab.discrepancy.workflow import diagnose
from sim.lab.uppaal.model_export import ExportError, export
from sim.proof.envelope import Assumptions
from sim.proof.verification import verify
from sim.sha.automaton import Effect
from sim.sha.model import Correction, Model
from sim.sha.trace import Trace
from tests.discrepancy.plants import model as small_model
from tests.discrepancy.plants import plant as small_plant
from tests.effects.engines import (
    automaton,
    exported,
    filtered,
    fitted,
    model_of,
    named,
    sampled,
    trace_of,
    with_effects,
)
from tests.effects.made_up import HUMIDITY_HEATING, known, with_part

PARAMS = {"gain": 4e-4, "reference": 40.0}
RANGES = Assumptions(inputs={"U": (20.0, 90.0)})


@pytest.fixture(autouse=True)
def humid() -> Iterator[None]:
    with known(HUMIDITY_HEATING):
        yield


def humid_trace() -> Trace:
    """The record of the engines' test with a humidity."""
    trace = trace_of()
    values = 50.0 + 30.0 * np.sin(trace.times / 300.0)
    return replace(trace, signals={**trace.signals, "U": np.where(np.isfinite(trace.signals["I"]), values, np.nan)})


def humid_model() -> Model:
    return with_effects(model_of("lsha"), named("humidity-heating", {"humidity": "U"}, PARAMS))


def test_the_fit_the_automaton_the_filter_the_sampler_and_the_exported_text_have_one_course() -> None:
    trace, model = humid_trace(), humid_model()
    expected = automaton(model, trace)
    assert np.abs(expected - automaton(model_of("lsha"), trace)).max() > 0.5
    one = named("humidity-heating", {"humidity": "U"}, PARAMS)
    np.testing.assert_allclose(fitted(model_of("lsha"), one, trace), expected, atol=0.03)
    np.testing.assert_allclose(filtered(model, trace), expected, atol=1e-4)
    np.testing.assert_allclose(sampled(model, trace), expected, atol=1e-4)
    times, read = exported(model, trace)
    assert read[-1] == pytest.approx(expected[-1], abs=2e-3) and times[-1] == trace.times[-1]


def test_it_is_forecast_corrected_and_stored() -> None:
    model = humid_model()
    tracker = compile_model(model)
    wet, dry = (
        forecast(tracker, start(tracker, 0.0, 22.0, {"U": humidity}), (600.0,), np.random.default_rng(0), events=())
        for humidity in (80.0, 40.0)
    )
    assert float(wet.quantiles[1, 0] - dry.quantiles[1, 0]) == pytest.approx(
        0.016 / 0.003 * (1 - np.exp(-1.8)), rel=0.02
    )
    scaled = in_sensor_scale(replace(model, correction=Correction(2.0, 5.0)))
    assert scaled.sha.effects[0].params == {"gain": 8e-4, "reference": 40.0}
    assert parse_model(model_text(model)).sha.effects == model.sha.effects


def test_it_is_bounded() -> None:
    model = humid_model()
    found = verify(replace(model, sha=replace(model.sha, low=0.0, high=200.0)), assumptions=RANGES)
    assert found.deployable, found.reasons
    assert found.bounds is not None
    # In rest the greatest heat is gain (90 - 40), which lifts X by that over k.
    assert found.bounds.intervals["OFF/0-120"][1] >= 22.0 + 4e-4 * 50.0 / 0.003


def test_a_diagnosis_names_it_and_adds_it_to_the_model() -> None:
    trace = small_plant(3, days=2)
    rng = np.random.default_rng(5)
    slow = np.cumsum(rng.standard_normal(trace.times.size)) * 0.8
    humidity = 50.0 + 20.0 * np.sin(trace.times / 7000.0) + slow - np.linspace(0.0, slow[-1], slow.size)
    heat = 1e-4 * (humidity - 50.0)
    warmer, dt = np.zeros(trace.times.size), float(trace.times[1] - trace.times[0])
    for row in range(1, warmer.size):
        k = 1 / 1500 if trace.signals["MarciaDecanter"][row - 1] else 1 / 3600
        warmer[row] = warmer[row - 1] + dt * (heat[row - 1] - k * warmer[row - 1])
    signals = {**trace.signals, "T": np.round(trace.signals["T"] + warmer, 1), "Umidita": humidity}
    found = diagnose(small_model(), [replace(trace, signals=signals)], seed=0, roles={**ROLES, "humidity": "Umidita"})
    assert [one.name for one in found.diagnosis.effects] == ["humidity-heating"], found.diagnosis.sentence
    assert HUMIDITY_HEATING.meaning in found.diagnosis.sentence
    assert found.diagnosis.effects[0].params["gain"] == pytest.approx(1e-4, rel=0.2)
    assert found.fitted is not None
    (effect,) = augment_model(found.fitted).sha.effects
    assert (effect.kind, effect.signals) == ("humidity-heating", {"humidity": "Umidita"})


# ------------------------------------------------------------------ what an engine does not know it refuses, by name


@dataclass(frozen=True)
class StrangePart:
    """A form of law, bound or text that no engine knows."""


def test_a_kind_is_complete_or_is_not_constructed() -> None:
    parts: dict[str, Any] = {name: getattr(HUMIDITY_HEATING, name) for name in HUMIDITY_HEATING.__slots__}
    parts.pop("consistent")
    parts.pop("late")  # without it nothing of the heat comes late
    for name in parts:
        with pytest.raises(TypeError, match=name):
            type(HUMIDITY_HEATING)(**{key: value for key, value in parts.items() if key != name})
    with pytest.raises(ValueError, match=r"'humidity-heating' is scaled by 'loss', which is no parameter of it"):
        replace(HUMIDITY_HEATING, candidate=replace(HUMIDITY_HEATING.candidate, strength="loss"))


@pytest.mark.parametrize(
    ("bound", "sentence"),
    [
        (
            EffectRefusal("nobody knows how humid it gets"),
            "'humidity-heating' are not bounded: nobody knows how humid it gets",
        ),
        (StrangePart(), r"the verification does not know effects of the kind 'humidity-heating' \(StrangePart\)"),
    ],
)
def test_a_checker_that_does_not_know_says_not_decided_and_nothing_is_deployed(bound: Any, sentence: str) -> None:
    """The mean course of this model runs to the clamp at 500 degC; without its effect it would be proven."""
    model = humid_model()
    hot = Effect("humidity-heating", {"gain": 1.0, "reference": 0.0}, {"humidity": "U"})
    model = replace(model, sha=replace(model.sha, effects=(hot,)))
    assert verify(replace(model, sha=replace(model.sha, effects=())), assumptions=Assumptions()).deployable
    assert automaton(model, humid_trace()).max() == 500.0
    with known(with_part(bound=bound)):
        found = verify(model, assumptions=RANGES)
    assert not found.deployable
    assert found.check("growth").verdict == "not decided"
    assert "mean course" not in {check.name for check in found.checks}
    assert any(re.search(sentence, reason) for reason in found.reasons), found.reasons


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (EffectRefusal("it has no clock of it"), "'humidity-heating' have no text: it has no clock of it"),
        (StrangePart(), "the UPPAAL export does not know effects of the kind 'humidity-heating'"),
    ],
)
def test_the_export_refuses_a_kind_without_a_text(text: Any, sentence: str) -> None:
    with known(with_part(uppaal=text)), pytest.raises(ExportError, match=sentence):
        export(humid_model(), humid_trace(), tick=0)


def test_simulator_filter_and_fit_refuse_a_law_that_they_do_not_know() -> None:
    model = humid_model()
    strange: Any = StrangePart()
    # A row that gets past the constructor: what a later form of law would be to engines that were not told of it.
    kind = replace(HUMIDITY_HEATING)
    object.__setattr__(kind, "law", strange)
    one = named("humidity-heating", {"humidity": "U"}, PARAMS)
    with known(kind):
        for run in (
            lambda: compile_plant(model.sha),
            lambda: compile_model(model),
            lambda: automaton(model, humid_trace()),
            lambda: fitted(model_of("lsha"), one, humid_trace()),
        ):
            with pytest.raises(
                ValueError, match=r"does not know effects of the kind 'humidity-heating' \(StrangePart\)"
            ):
                run()


def test_the_correction_refuses_a_parameter_of_which_it_does_not_know_what_becomes_of_it() -> None:
    strange: Any = "squared"
    parameters = {**HUMIDITY_HEATING.parameters, "gain": replace(HUMIDITY_HEATING.parameters["gain"], rescaled=strange)}
    model = replace(humid_model(), correction=Correction(2.0, 0.0))
    with (
        known(replace(HUMIDITY_HEATING, parameters=parameters)),
        pytest.raises(
            ValueError, match=r"correction does not know effects of the kind 'humidity-heating' \(gain squared\)"
        ),
    ):
        in_sensor_scale(model)


def test_a_diagnosis_refuses_a_kind_that_is_no_candidate() -> None:
    with (
        known(replace(HUMIDITY_HEATING, candidate=None)),
        pytest.raises(ValueError, match="a diagnosis does not know effects of the kind 'humidity-heating'"),
    ):
        catalogue_entry("humidity-heating")
