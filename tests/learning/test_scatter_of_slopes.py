"""How much slopes differ from stay to stay is learned in their own unit, degC/s, however few stays there are."""

import numpy as np
import pytest

from sim.lab.learning.free_run import fit_free_run
from sim.lab.learning.noise import NoiseLevels, fit_noise
from sim.lab.learning.runs import free_runs
from sim.lab.learning.shape import Prior, build_shape
from sim.sha import SHA, Distribution, Edge, Event, Flow, Location, Trace

MEAN, SENSOR, STAY_S, STEP_S = 0.002, 0.05, 1200.0, 20.0


def climbing(stays: int, scatter: float) -> Trace:
    """Stays that climb at MEAN degC/s, each by a slope of its own about it, and as long ones of no motion between."""
    rng = np.random.default_rng(3)
    times = np.arange(0.0, 2 * stays * STAY_S, STEP_S)
    slope = np.repeat(np.outer(MEAN + scatter * rng.normal(size=stays), (1.0, 0.0)), int(STAY_S / STEP_S))
    reading = 20.0 + np.concatenate([[0.0], np.cumsum(slope[:-1] * STEP_S)]) + SENSOR * rng.normal(size=times.size)
    events = tuple(Event(STAY_S * number, ("GO", "STOP")[number % 2]) for number in range(2 * stays))
    return Trace("t", times, {"T": reading}, events=events)


def learned_noise(trace: Trace) -> NoiseLevels:
    law = Distribution("normal", {"mu": 0.0, "sigma": 1.0})
    still = Location("rest", Flow("constant", {"noise": 0.0}), entry="none")
    edges = (Edge("rest", "GO", "go"), Edge("go", "STOP", "rest"))
    sha = SHA("two", (still, Location("go", Flow("linear", {"noise": 0.0}), law)), edges, "rest")
    shape, _ = build_shape(sha, ["go"], [], Prior(temperature=(20.0, 20.0)))
    runs = free_runs([trace], sha, "T")
    return fit_noise(runs, shape, fit_free_run(runs, shape), np.zeros(2, dtype=np.intp))


def test_the_scatter_of_slopes_is_that_of_the_stays() -> None:
    assert learned_noise(climbing(12, 0.001)).scatter[1] == pytest.approx(0.001, rel=0.6)


def test_a_slope_that_was_seen_in_one_stay_makes_no_hundred_degrees_an_hour_of_its_doubt() -> None:
    assert 3600.0 * learned_noise(climbing(1, 0.0)).scatter[1] < 10.0
