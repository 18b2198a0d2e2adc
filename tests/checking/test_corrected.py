"""A corrected model is asked in the sensor's scale: the same answers as the mapped question to the model without it."""

from dataclasses import replace

import numpy as np
import pytest

from sim.effects.correction import in_sensor_scale
from sim.lab.checking.query.tree import (
    Always,
    At,
    BoundedResponse,
    Either,
    Expectation,
    Formula,
    Hypothesis,
    Number,
    Operation,
    Path,
    Probability,
    Simulation,
    TimeSpan,
    Until,
)
from sim.lab.checking.smc.answers import Answer, QuerySettings, Start, answer, prepare_question
from sim.lab.checking.smc.paths.known_events import Cuts
from sim.lab.checking.smc.runs import engine
from sim.lab.checking.smc.splitting.estimator import SplitEstimate, split_estimate
from sim.lab.checking.smc.start import believed_start, initial
from sim.sha.automaton import Distribution
from sim.sha.model import Correction, Model
from sim.sha.trace import Event, Trace
from tests.checking.worlds import TEMP, compare, eventually, flow, model, normal
from tests.rig.quadrature import Stretch, first_passage

GAIN, OFFSET, SECONDS, ASKED = 1.25, -7.0, 300.0, 60.0
PLAIN = model(
    [flow("exponential", k=0.01), flow("logarithmic", t0=20.0), flow("linear")],
    [normal(45.0, 2.0), normal(1.0, 0.3), normal(-0.01, 0.005)],
    first=normal(40.0, 0.5),
    stay=Distribution("exponential", {"mean": 80.0}),
    low=0.0,
    high=52.0,
)
"""Degrees of the automaton; `SENSOR` is the same plant, read by a sensor that is off."""


def read(temperature: float) -> float:
    return GAIN * temperature + OFFSET


SENSOR = replace(
    PLAIN,
    correction=Correction(GAIN, OFFSET),
    initial=normal(read(40.0), GAIN * 0.5),
    sensor_sigma=GAIN * PLAIN.sensor_sigma,
)


def trace_of(model: Model) -> Trace:
    times = np.linspace(0.0, SECONDS, 61)
    values = 40.0 + 0.01 * times + 0.05 * np.sin(times)
    if model is SENSOR:
        values = GAIN * values + OFFSET
    return Trace("t", times, {"T": values}, (Event(70.0, "next"), Event(190.0, "next")))


def starts(model: Model) -> dict[str, Start]:
    """Every start that there is, known events and unknown ones."""
    return SENSOR_STARTS if model is SENSOR else PLAIN_STARTS


def starts_of(model: Model) -> dict[str, Start]:
    trace = trace_of(model)
    return {
        "initial": initial(model),
        "location": initial(model, location="q_1"),
        "trace": initial(model, trace),
        "belief": believed_start(model, trace, 100.0),
        "belief along the trace": believed_start(model, trace, 100.0, recorded=True),
    }


PLAIN_STARTS, SENSOR_STARTS = starts_of(PLAIN), starts_of(SENSOR)


def paths(at: "dict[float, float]") -> list[Path]:
    """Each kind of path about limits that `at` maps."""
    whole = TimeSpan(0.0, ASKED)
    hot, warm, mild = compare(">=", at[43.0]), compare(">=", at[42.0]), compare("<=", at[41.0])
    within: Formula = Either(mild, At("q_1"))
    return [
        eventually(hot, ASKED).path,
        Always(compare("<=", at[42.0]), whole),
        Until(compare("<=", at[43.0]), warm, whole),
        BoundedResponse(warm, within, TimeSpan(0.0, 30.0)),
    ]


PLAIN_AT = {limit: limit for limit in (41.0, 42.0, 43.0)}
SENSOR_AT = {limit: read(limit) for limit in PLAIN_AT}


@pytest.mark.parametrize("name", list(starts(PLAIN)))
def test_probabilities_are_those_of_the_mapped_limits(name: str) -> None:
    settings = QuerySettings(rule="fixed", runs=500, seed=3)
    for plain, sensor in zip(paths(PLAIN_AT), paths(SENSOR_AT), strict=True):
        mine = answer(Probability(ASKED, sensor), starts(SENSOR)[name], settings)
        other = answer(Probability(ASKED, plain), starts(PLAIN)[name], settings)
        assert mine.numbers["probability"] == pytest.approx(other.numbers["probability"], abs=0.0021)
        assert mine.runs == other.runs


@pytest.mark.parametrize("name", list(starts(PLAIN)))
def test_means_of_extremes_and_courses_are_mapped(name: str) -> None:
    def ask(model: Model) -> tuple[Answer, Answer]:
        start = starts(model)[name]
        top = answer(Expectation(120.0, 500, "max", TEMP), start, QuerySettings(seed=4))
        return top, answer(Simulation(120.0, 5, (TEMP,), ("Temp",)), start, QuerySettings(seed=4))

    (top, courses), (plain_top, plain_courses) = ask(SENSOR), ask(PLAIN)
    assert top.numbers["mean"] == pytest.approx(read(plain_top.numbers["mean"]), abs=1e-6)
    assert top.notes == plain_top.notes
    for mine, other in zip(courses.courses, plain_courses.courses, strict=True):
        assert np.allclose(mine.values, GAIN * other.values + OFFSET, atol=1e-6)


def test_a_query_about_clocks_and_temperature_together_is_mapped_too() -> None:
    moving = Operation("-", TEMP, Operation("*", Number(0.01), TEMP))
    found = answer(Expectation(60.0, 300, "min", moving), starts(SENSOR)["initial"], QuerySettings())
    plain = answer(Expectation(60.0, 300, "min", TEMP), starts(PLAIN)["initial"], QuerySettings())
    assert found.numbers["mean"] == pytest.approx(0.99 * read(plain.numbers["mean"]), abs=1e-6)


@pytest.mark.parametrize("name", ["initial", "belief along the trace"])
def test_splitting_puts_its_levels_on_the_sensors_scale(name: str) -> None:
    def levels(model: Model, limit: float) -> SplitEstimate:
        start = starts(model)[name]
        one = prepare_question(eventually(compare(">=", limit), 60.0), start)
        made = engine(start.world, Cuts(60.0, (), (), ((0.0, 60.0),), longest=2.0))
        return split_estimate(made, one, np.random.default_rng(5), runs=100, repetitions=10)

    mine, other = levels(SENSOR, read(46.6)), levels(PLAIN, 46.6)
    assert 0.0 < mine.estimate.probability == pytest.approx(other.estimate.probability, rel=0.1)
    assert len(mine.levels) == len(other.levels) > 0
    assert np.allclose([at for at, _ in mine.levels], [read(at) for at, _ in other.levels], atol=1e-3)


def test_quadrature_of_the_corrected_flow_agrees_with_its_runs() -> None:
    one = model([flow("exponential", k=0.01)], [normal(42.0, 1.0)], first=normal(40.0))
    sensor = replace(one, correction=Correction(GAIN, OFFSET), initial=normal(read(40.0)))
    place = in_sensor_scale(sensor).sha.locations[0]
    assert place.distribution is not None
    stretch = Stretch(place.flow, place.distribution.params["mu"], 400.0, place.distribution.params["sigma"])
    exact = first_passage([stretch], read(40.0), read(43.0), points=600)
    plain = Stretch(flow("exponential", k=0.01), 42.0, 400.0, 1.0)
    assert exact == pytest.approx(first_passage([plain], 40.0, 43.0, points=600))
    found = answer(
        eventually(compare(">=", read(43.0)), 400.0), initial(sensor), QuerySettings(rule="fixed", runs=20_000, seed=1)
    )
    assert found.numbers["low"] <= exact <= found.numbers["high"]


def test_a_hypothesis_is_decided_alike() -> None:
    for name in starts(PLAIN):
        questions = (
            (SENSOR, Probability(ASKED, paths(SENSOR_AT)[0])),
            (PLAIN, Probability(ASKED, paths(PLAIN_AT)[0])),
        )
        verdicts = {
            answer(Hypothesis(question, ">=", 0.3), starts(model)[name], QuerySettings()).verdict
            for model, question in questions
        }
        assert len(verdicts) == 1
