"""Noise at rest and while the machine runs are two, in the fit and in the model that comes of it."""

from dataclasses import replace

import numpy as np
import pytest

from sim.lab.discrepancy.augment import as_white, augment_model
from sim.lab.discrepancy.fitting.baseline import build_frame, move_frame, with_priors
from sim.lab.discrepancy.fitting.free_run_fit import MIN_REST_NOISE_RATIO, first_noise, fit, stated_process
from sim.lab.discrepancy.fitting.record import Record, build_record
from sim.sha.automaton import Flow
from sim.sha.events import encode
from sim.sha.model import Model
from sim.sha.trace import Trace
from tests.discrepancy.plants import ALPHABET, PERIOD, TARGETS, model, operation, random_model

MEMORY = 400.0
"""s that the rough heat of the plant lasts."""


def plant(seed: int, at_rest: float, running: float, rough: float, days: int = 2) -> Trace:
    """`days` days of three cycles: white noise (degC/sqrt(s)) of two sizes, and while it runs `rough` heat (degC/s)."""
    rng = np.random.default_rng(seed)
    size = int(days * 86400 / PERIOD)
    turns, current, _ = operation(rng, size)
    keep, x, heat, temperature = np.exp(-PERIOD / MEMORY), 17.0, 0.0, np.empty(size)
    for row in range(size):
        temperature[row] = x
        target, k = TARGETS["OFF" if not turns[row] else "LOW" if current[row] < 200 else "HIGH"]
        heat = keep * heat + rough * np.sqrt(1 - keep**2) * rng.standard_normal()
        white = (running if turns[row] else at_rest) * np.sqrt(PERIOD) * rng.standard_normal()
        x = target + (x - target) * np.exp(-k * PERIOD) + PERIOD * turns[row] * heat + white
    read = np.round(temperature + 0.06 * rng.standard_normal(size), 1)
    signals = {"MarciaDecanter": turns, "Assorbimento": current, "T": read}
    trace = Trace(f"rest{seed}", 1.7e9 + PERIOD * np.arange(size), signals, synthetic=True)
    return replace(trace, events=encode(trace, ALPHABET))


def noise_of_the_new_model(given: Model, trace: Trace) -> dict[str, float]:
    """degC/sqrt(s) by location, heat with a memory as the white noise that it amounts to."""
    record = build_record(given, [trace], ())
    new = augment_model(fit(with_priors(move_frame(build_frame(record), record))))
    white = {place.name: place.flow.params for place in new.sha.locations}
    heats = [each.params for each in new.sha.effects if each.kind == "heat-disturbance"]
    kept = {
        name: sum(as_white(each["sigma"], each["memory"], own["k"]) for each in heats) for name, own in white.items()
    }
    return {name: float(np.hypot(own["noise"], kept[name])) for name, own in white.items()}


@pytest.mark.parametrize("given", [model(), random_model(2e-5, MEMORY, 5.0)], ids=["plain", "with a little heat"])
@pytest.mark.parametrize(
    ("at_rest", "running", "rough"),
    [(0.001, 0.012, 0.0), (0.001, 0.001, 6e-4), (0.01, 0.003, 0.0)],
    ids=["rough while it runs", "rough heat while it runs", "rougher at rest"],
)
def test_a_new_model_has_the_noise_of_rest_at_rest_and_that_of_running_while_it_runs(
    given: Model, at_rest: float, running: float, rough: float
) -> None:
    found = noise_of_the_new_model(given, plant(1, at_rest, running, rough))
    assert 1 / 1.5 < found["OFF"] / at_rest < 1.5
    whole = float(np.hypot(running, as_white(rough, MEMORY, TARGETS["HIGH"][1])))
    assert 1 / 1.5 < found["HIGH"] / whole < 1.5


def test_a_new_model_keeps_heat_with_a_memory_only_as_far_as_it_acts_at_rest_too() -> None:
    record = build_record(random_model(1e-3, MEMORY, 5.0), [plant(1, 0.001, 0.001, 1e-3, days=1)], ())
    fitted = fit(move_frame(build_frame(record), record), rounds=1, iterations=1)
    for rest, sigma in ((0.9, 1e-3), (0.1, 1e-4)):
        noise = replace(fitted.noise, process=0.0, rough=1e-3, memory=MEMORY, rest=rest)
        new = augment_model(replace(fitted, noise=noise)).sha
        assert new.effects[0].params["sigma"] == pytest.approx(sigma)
        own = new.by_name["HIGH"].flow.params
        left = 0.0 if rest > 0.5 else as_white(1e-3, MEMORY, own["k"]) * np.sqrt(1.0 - rest**2)
        assert own["noise"] == pytest.approx(left, rel=1e-6, abs=1e-9)
        assert new.by_name["OFF"].flow.params["noise"] == pytest.approx(0.0, abs=1e-9)


def noisy(noise: dict[str, float], unknown: str = "") -> Model:
    """The plant's model with such noise by location, `unknown` being a location of which nothing is known."""
    made = model()
    flows = {
        place.name: Flow("constant", {"noise": 0.1})
        if place.name == unknown
        else replace(place.flow, params={**place.flow.params, "noise": noise[place.name]})
        for place in made.sha.locations
    }
    places = tuple(replace(place, flow=flows[place.name]) for place in made.sha.locations)
    return replace(made, sha=replace(made.sha, locations=places))


def record_by(given: Model) -> Record:
    return build_record(given, [plant(1, 0.001, 0.001, 0.0, days=1)], ())


def test_the_fit_begins_from_the_noise_that_the_model_states_of_rest_and_of_running() -> None:
    record = record_by(noisy({"OFF": 0.0005, "LOW": 0.005, "HIGH": 0.005}))
    assert stated_process(record) == pytest.approx((0.005, 0.0005))
    assert first_noise(record.model, record).still == pytest.approx(0.1)
    silent = record_by(noisy({"OFF": 1e-7, "LOW": 0.005, "HIGH": 0.005}))
    assert first_noise(silent.model, silent).still == MIN_REST_NOISE_RATIO


def test_what_a_model_states_of_the_unknown_is_no_noise_of_the_plant() -> None:
    record = record_by(noisy({"OFF": 0.001, "LOW": 0.005}, unknown="HIGH"))
    assert stated_process(record) == pytest.approx((0.005, 0.001))
    assert stated_process(record_by(noisy({"OFF": 0.0, "LOW": 0.005, "HIGH": 0.005}))) == pytest.approx((0.005, 0.005))
    assert stated_process(record_by(noisy({"OFF": 0.0, "LOW": 0.0, "HIGH": 0.0})))[0] > 0
