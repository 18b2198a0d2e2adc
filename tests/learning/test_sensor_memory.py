"""An error of the sensor that lasts: what readings are then worth, that it is learned, and only where it is there."""

from dataclasses import replace
from math import exp, sqrt

import numpy as np
import pytest

from sim.artefacts.model_json import model_text, parse_model
from sim.engine.belief import observe, start
from sim.engine.tracker import compile_model, repeat_factor
from sim.files import ArtefactError
from sim.lab.learning.bins.candidates import CANDIDATES
from sim.lab.learning.bins.learn import learn_bins
from sim.sha.automaton import SHA, Distribution, Flow, Location
from sim.sha.events import DECANTER, Alphabet
from sim.sha.model import Model
from sim.sha.trace import Array, Trace
from tests.learning.plants import Truth, simulate, with_signal
from tests.rig.no_bands import without_bands

MEMORY, SIGMA = 15.0, 0.3


def lasting(times: Array, rng: np.random.Generator) -> Array:
    """(n,) errors of standard deviation SIGMA, correlated as exp(-t / MEMORY)."""
    errors = SIGMA * rng.normal(size=times.size)
    for row in range(1, times.size):
        kept = exp(-(times[row] - times[row - 1]) / MEMORY)
        errors[row] = kept * errors[row - 1] + sqrt(1.0 - kept * kept) * errors[row]
    return errors


@pytest.mark.parametrize("period", [1.0, 15.0, 90.0])
def test_many_readings_are_worth_what_their_mean_is(period: float) -> None:
    # The variance of the mean of n such errors, summed up literally.
    n = 4000
    lags = np.arange(1, n)
    of_mean = (n + 2.0 * float(np.sum((n - lags) * np.exp(-lags * period / MEMORY)))) / n**2
    assert repeat_factor(MEMORY, period) / n == pytest.approx(of_mean, rel=0.02)


def test_a_slope_learned_from_errors_that_last_is_as_uncertain_as_the_belief_says() -> None:
    place = Location("q", Flow("linear", {"noise": 0.0}), Distribution("normal", {"mu": 0.0, "sigma": 1.0}))
    model = Model(SHA("slope", (place,), (), "q"), Alphabet(()), "T", SIGMA, sensor_memory=MEMORY)
    rng, times = np.random.default_rng(3), np.arange(600.0)
    off: dict[float, list[float]] = {MEMORY: [], 0.0: []}
    for _ in range(60):
        readings = 50.0 + lasting(times, rng)
        for memory, scores in off.items():
            tracker = compile_model(replace(model, sensor_memory=memory))
            belief = start(tracker, 0.0, float(readings[0]))
            for time, value in zip(times[1:].tolist(), readings[1:].tolist(), strict=True):
                belief = observe(tracker, belief, time, value)
            scores.append(abs(belief.m) / sqrt(belief.mm))
    held = {memory: float(np.mean(np.array(scores) < 1.645)) for memory, scores in off.items()}
    assert held[MEMORY] > 0.8 and held[0.0] < 0.5


def test_it_is_learned_where_it_is_there_and_nowhere_else(monkeypatch: pytest.MonkeyPatch) -> None:
    without_bands(monkeypatch)
    # A slow plant, long in one place: what its m is has to be told from a drift that errors may imitate.
    truth = Truth(sensor=0.0, scatter=3.0, noise=0.001, tau=(3000.0, 3000.0))
    rng = np.random.default_rng(5)
    clean = simulate(truth, 2, cycles=3, rows=2000, period=2.0, hold=1500)
    white, coloured = [], []
    for each in clean:
        reading = each.signals["T"] + 0.2 * rng.normal(size=each.times.size)
        white.append(with_signal(each, T=reading + SIGMA * rng.normal(size=each.times.size)))
        coloured.append(with_signal(each, T=reading + lasting(each.times, rng)))

    def learned(traces: list[Trace]) -> Model:
        return learn_bins(traces, DECANTER, "T", seed=0, candidates=CANDIDATES[:1]).model

    assert learned(white).sensor_memory == 0.0
    model = learned(coloured)
    assert 5.0 <= model.sensor_memory <= 45.0
    assert model.sensor_sigma == pytest.approx(sqrt(SIGMA**2 + 0.2**2), rel=0.25)
    assert parse_model(model_text(model)) == model


def test_a_memory_that_is_none_is_refused() -> None:
    model = Model(
        SHA("still", (Location("q", Flow("constant", {"noise": 0.0}), entry="none"),), (), "q"), DECANTER, "T", 0.1
    )
    with pytest.raises(ValueError, match="sensor_memory must be at least 0 s, got -1"):
        compile_model(replace(model, sensor_memory=-1.0))
    text = model_text(replace(model, sensor_memory=2.0)).replace('"sensor_memory": 2.0', '"sensor_memory": "long"')
    with pytest.raises(ArtefactError, match="sensor_memory: a number is needed"):
        parse_model(text)
