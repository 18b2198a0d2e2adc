"""The heat over time that a fitted model lacks: found where and when it was put, and no more of it than was put."""

from dataclasses import replace

import numpy as np
import pytest

from sim.engine import linear_recursion
from sim.lab.discrepancy.diagnosis import MissingHeat
from sim.lab.discrepancy.fitting import Fitted, NoiseModel, build_frame, build_record, fit
from sim.lab.discrepancy.missing_heat import as_one_heat, missing_heat
from sim.sha import Trace
from tests.discrepancy.plants import PERIOD, model, plant

HOUR = 3600.0
BEGINS, ENDS, PUT = 29 * HOUR, 33 * HOUR, 15.0
"""Seconds from the first row between which a heat of so many degC/h is put into the plant."""


@pytest.fixture(scope="module")
def trace() -> Trace:
    return plant(3, days=2)


@pytest.fixture(scope="module")
def base(trace: Trace) -> Fitted:
    return fit(build_frame(build_record(model(), [trace], ())))


def heated(trace: Trace) -> Trace:
    """The trace of the same plant with the heat; one mass, so that what it adds to the temperature adds up."""
    since = trace.times - trace.times[0]
    heat = np.where((since >= BEGINS) & (since < ENDS), PUT / HOUR, 0.0)
    keep = np.exp(-PERIOD * np.where(trace.signals["MarciaDecanter"] > 0.5, 1 / 1500, 1 / 3600))
    added = linear_recursion(keep, PERIOD * heat, 0.0)
    return replace(trace, signals={**trace.signals, "T": trace.signals["T"] + added})


def of(base: Fitted, trace: Trace) -> MissingHeat:
    return missing_heat(base, build_record(model(), [trace], ()), np.array([4, 5]))


def test_a_heat_that_was_put_in_is_found_when_it_was_put_and_as_much_as_it_was(base: Fitted, trace: Trace) -> None:
    without, found = of(base, trace), of(base, heated(trace))
    since = found.times - trace.times[0]
    inside = (since > BEGINS + 1800) & (since < ENDS - 1800)
    # The plant is rough by itself: what is asked is what the heat has added to that.
    more = found.mean - without.mean
    assert np.mean(more[inside]) == pytest.approx(PUT, rel=0.1)
    assert np.max(np.abs(more[(since < BEGINS - 3600) | (since > ENDS + 7200)])) < 1.0
    assert np.mean(found.low[inside] > 0) > 0.9 and np.mean(without.low[inside] > 0) < 0.3


def test_the_band_is_about_the_mean_and_windows_say_what_they_are_of(base: Fitted, trace: Trace) -> None:
    found = of(base, trace)
    np.testing.assert_allclose(found.high - found.mean, found.mean - found.low)
    assert (found.high > found.low).all() and np.isfinite(found.mean).all() and (np.diff(found.times) > 0).all()
    assert not found.held_out[0] and found.held_out[-1] and 0.3 < found.running.mean() < 0.7


@pytest.mark.parametrize("part", [{"process": 0.02}, {"cycle": 0.04}, {"rough": 1e-3}])
def test_heat_that_the_fit_took_for_noise_of_any_kind_is_still_heat(
    base: Fitted, trace: Trace, part: dict[str, float]
) -> None:
    small = NoiseModel(sensor=0.05, process=1e-5, rough=1e-7, cycle=1e-6, memory=400.0)
    found = of(replace(base, noise=replace(small, **part)), heated(trace))
    since = found.times - trace.times[0]
    inside = (since > BEGINS + 1800) & (since < ENDS - 1800) & found.running
    assert np.mean(found.mean[inside]) == pytest.approx(PUT, rel=0.25)


@pytest.mark.parametrize("still", [1.0, 0.5])
def test_one_heat_has_the_strength_of_all_three(base: Fitted, still: float) -> None:
    white = replace(base.noise, process=0.004, rough=0.0, cycle=0.0, memory=800.0, still=still)
    noise = as_one_heat(replace(base, noise=white))
    assert noise.rough == pytest.approx(0.004 / np.sqrt(2 * 800.0)) and noise.rest == still
    assert (noise.process, noise.cycle) == (0.0, 0.0)


def test_a_heat_at_rest_says_nothing_of_the_run_before_it(base: Fitted, trace: Trace) -> None:
    on = trace.signals["MarciaDecanter"] > 0.5
    keep = np.exp(-PERIOD * np.where(on, 1 / 1500, 1 / 3600))
    added = linear_recursion(keep, PERIOD * np.where(on, 0.0, 5.0 / HOUR), 0.0)
    rests = replace(trace, signals={**trace.signals, "T": trace.signals["T"] + added})
    found, without = of(base, rests), of(base, trace)
    more = found.mean - without.mean
    assert np.mean(more[~found.running]) == pytest.approx(5.0, rel=0.1)
    assert np.quantile(np.abs(more[found.running]), 0.95) < 1.0
    # A heat of which a quarter acts at rest would have to be four times as great just before each stop.
    assert np.max(np.abs(more[found.running])) < 3.0
