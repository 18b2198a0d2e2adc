"""The table of effects: what is refused and in which words, and how a correction carries effects along."""

from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest

from sim.effects.check import check_effect, check_effects, check_sha
from sim.effects.correction import in_sensor_scale
from sim.effects.kinds import EFFECTS, effect_summary, refusal
from sim.engine.moment_equations import moments
from sim.engine.schedules import schedule, step_coefficients
from sim.sha.automaton import SHA, Effect
from sim.sha.events import Alphabet, Switch
from sim.sha.model import Correction, Model
from tests.sha.effect_reference import EFFECTS as CASES
from tests.sha.effect_reference import LATE, RANDOM, TOGETHER, course, plant

PUMP = Effect("pump-cooling", {"loss": 0.01, "sink": 20.0}, {"pump": "P"})
LAG = Effect("sensor-lag", {"tau": 5.0, "order": 2.0})
START = Effect("startup-churning", {"gain": 0.1, "tau": 60.0, "shape": 1.0}, {}, (), "W_ON")


def test_every_kind_of_the_catalogue_is_there_and_is_exercised_by_the_tests() -> None:
    assert {effect.kind for effects in CASES.values() for effect in effects} | set(RANDOM) == set(EFFECTS)


@pytest.mark.parametrize("effects", CASES.values())
def test_a_good_effect_passes(effects: tuple[Effect, ...]) -> None:
    check_sha(plant("driven", effects))


@pytest.mark.parametrize(
    ("effect", "sentence"),
    [
        (replace(PUMP, kind="pump"), "unknown effect 'pump': known are current-heating, "),
        (replace(PUMP, params={"loss": 0.01}), "takes the parameters loss, sink, scale, shift; sink is missing"),
        (replace(PUMP, params={**PUMP.params, "k": 1.0}), "takes the parameters .*; k is unknown"),
        (replace(PUMP, params={"loss": -0.1, "sink": 20.0}), "loss must be at least 0 and finite, got -0.1"),
        (replace(PUMP, params={"loss": float("nan"), "sink": 20.0}), "loss must be at least 0 and finite, got nan"),
        (replace(PUMP, signals={}), r"takes signals for pump, sink \(optional\); pump is missing"),
        (replace(PUMP, signals={"pump": "P", "torque": "M"}), "torque is unknown"),
        (replace(PUMP, event="W_ON"), "counts from no event; leave `event` empty"),
        (replace(START, event=""), "needs the event since which it counts"),
        (replace(START, params={**START.params, "tau": 0.0}), "tau must be positive and finite, got 0"),
        (replace(LAG, params={"tau": 5.0, "order": 2.5}), "order must be 1, 2 or 3, got 2.5"),
        (replace(LAG, params={"tau": 5.0, "order": 4.0}), "order must be at least 1 and at most 3, got 4"),
        (replace(LAG, locations=("on",)), "acts everywhere; leave `locations` empty"),
        (
            Effect("thermostatic-cooling", {"loss": 0.1, "sink": 10.0, "opens": 40.0, "closes": 40.0}),
            r"or open gradually: closes and sink equal to opens\): closes 40, opens 40, sink 10 degC",
        ),
    ],
)
def test_an_unusable_effect_is_refused_with_what_would_be_right(effect: Effect, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        check_effect(effect)


@pytest.mark.parametrize(
    ("effects", "sentence"),
    [
        ((LAG, LAG), "'sensor-lag' stands there twice; one is all it can have"),
        ((replace(START, event="W"),), "counts since the event 'W', which no edge has; known are W_OFF, W_ON"),
        ((replace(PUMP, signals={}),), "SHA 'augmented': effect 'pump-cooling' takes signals"),
    ],
)
def test_effects_that_do_not_fit_the_automaton_are_refused(effects: tuple[Effect, ...], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        check_effects(plant("linear", effects))


def test_an_effect_in_a_location_that_is_not_there_is_refused_when_the_automaton_is_made() -> None:
    with pytest.raises(ValueError, match="the effect 'pump-cooling' names the location 'up', which is not defined"):
        plant("linear", (replace(PUMP, locations=("up",)),))


def test_the_signal_of_a_role_takes_the_place_of_its_parameter() -> None:
    check_effect(Effect("pump-cooling", {"loss": 0.01}, {"pump": "P", "sink": "Ta"}))
    check_effect(Effect("radiation-loss", {"gain": 1e-11}, {"ambient": "Ta"}))


def test_an_effect_is_told_in_one_line() -> None:
    assert effect_summary(replace(PUMP, locations=("on",))) == "pump-cooling: loss 0.01; sink 20; pump P; in on"
    assert effect_summary(START) == "startup-churning: gain 0.1; tau 60; shape 1; since W_ON"
    step = Effect("sensor-offset-step", {"size": 0.5, "at": 1.743e9})
    assert effect_summary(step) == "sensor-offset-step: size 0.5; at 2025-03-26 14:40 UTC"
    # A model is read and shown whatever its moment is: one in milliseconds has no date.
    for at, said in ((1.743e12, "1.743e+12 s"), (inf, "inf s"), (nan, "nan s")):
        assert effect_summary(replace(step, params={"size": 0.5, "at": at})).endswith(f"; at {said}")


def test_what_cannot_do_effects_says_so_in_one_sentence() -> None:
    sha = plant("linear", (PUMP, LAG))
    sentence = refusal(sha, "the UPPAAL export")
    assert sentence.startswith(
        "the UPPAAL export does not do effects yet, and model 'augmented' has pump-cooling, sensor-lag;"
    )
    assert refusal(plant("linear", ()), "the UPPAAL export") == ""
    with pytest.raises(ValueError, match="does not do effects yet"):
        step_coefficients(schedule(plant("linear", (LAG,)), [], np.array([0.0, 1.0])))


@pytest.mark.parametrize("effects", [*CASES.values(), *TOGETHER.values(), *LATE.values()])
def test_a_corrected_model_reads_the_corrected_temperatures(effects: tuple[Effect, ...]) -> None:
    gain, offset = 1.3, -4.0
    sha = plant("driven", effects)
    events, inputs = course(5, 1400.0)
    outputs = np.arange(0.0, 1400.0, 35.0)
    own = moments(schedule(model(sha), events, outputs, inputs=inputs), 21.0)
    read = moments(schedule(model(sha, gain, offset), events, outputs, inputs=inputs), gain * 21.0 + offset)
    np.testing.assert_allclose(read.mean, gain * own.mean + offset, atol=2e-4)
    np.testing.assert_allclose(read.variance, gain**2 * own.variance, rtol=1e-4, atol=1e-9)


def model(sha: SHA, gain: float = 1.0, offset: float = 0.0) -> Model:
    return Model(sha, Alphabet((Switch("on", "W_ON", "W_OFF"),)), "T", 0.1, correction=Correction(gain, offset))


def test_a_correction_twice_is_one_of_both() -> None:
    once = in_sensor_scale(model(plant("linear", CASES["radiation-loss"]), 2.0, 1.0))
    twice = in_sensor_scale(replace(once, correction=Correction(3.0, -1.0)))
    both = in_sensor_scale(model(plant("linear", CASES["radiation-loss"]), 6.0, 2.0))
    assert twice.sha.effects[0].params == pytest.approx(dict(both.sha.effects[0].params))
