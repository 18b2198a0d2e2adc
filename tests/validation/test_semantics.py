"""The two semantics: each model's counterpart has the promised laws, and each wins on data made by its own rule."""

from dataclasses import replace
from math import exp, sqrt

import numpy as np
import pytest

from sim.engine.open_loop_run import errors, open_loop
from sim.engine.schedules import schedule
from sim.engine.simulation import simulate
from sim.lab.judge.semantics import side_by_side
from sim.sha.automaton import SHA, Distribution, Edge, Flow, Location
from sim.sha.events import Alphabet, Switch
from sim.sha.model import Correction, Model, Stay
from sim.sha.trace import Event, Trace

K = 0.01
ALPHABET = Alphabet((Switch("run", "on", "off"),), gap=1e9)


def normal(mu: float, sigma: float) -> Distribution:
    return Distribution("normal", {"mu": mu, "sigma": sigma})


def plant(**changes: object) -> Model:
    """OFF relaxes towards 20, ON towards 80 degC; SPARE is never entered, LOST has no flow and no law."""
    flow = Flow("exponential", {"k": K, "noise": 0.0})
    locations = (
        Location("OFF", flow, normal(20.0, 1.0)),
        Location("ON", flow, normal(80.0, 2.0)),
        Location("SPARE", flow, normal(50.0, 3.0)),
        Location("LOST", Flow("constant", {"noise": 0.1}), None, "none"),
    )
    edges = (Edge("OFF", "on", "ON"), Edge("ON", "off", "OFF"), Edge("SPARE", "off", "OFF"), Edge("LOST", "on", "ON"))
    model = Model(
        sha=SHA("plant", locations, edges, "OFF"),
        alphabet=ALPHABET,
        temperature="T",
        sensor_sigma=0.1,
        initial=normal(25.0, 1.0),
        semi_markov={"OFF": Stay(normal(900.0, 1.0), {"ON": 1.0}), "ON": Stay(normal(900.0, 1.0), {"OFF": 1.0})},
    )
    return replace(model, **changes)


def trace(temperatures: list[float], events: dict[int, str], step: float = 10.0, name: str = "made") -> Trace:
    """Readings every `step` seconds from a clock far from zero; event k -> symbol at row k."""
    times = 1.7e9 + step * np.arange(len(temperatures))
    made = tuple(Event(float(times[row]), symbol) for row, symbol in events.items())
    return Trace(name, times, {"T": np.array(temperatures)}, made)


def law_of(model: Model, name: str) -> dict[str, float]:
    law = model.sha.by_name[name].distribution
    assert law is not None
    return dict(law.params)


def test_entry_laws_are_those_of_the_readings_at_the_entries() -> None:
    seen = trace([10, 20, 30, 40, 50, 60], {1: "on", 3: "off", 5: "on"})
    both = side_by_side(plant(), [seen])
    assert list(both) == ["carried", "resampled"]
    pooled = np.std([20.0, 40.0, 60.0])
    assert law_of(both["resampled"], "ON") == pytest.approx({"mu": 40.0, "sigma": sqrt((800 + pooled**2) / 2)})
    assert law_of(both["resampled"], "OFF") == pytest.approx({"mu": 40.0, "sigma": pooled})  # one entry: no certainty
    assert both["resampled"].sha.by_name["ON"].entry == "resample"
    assert both["resampled"].provenance.settings["entry_laws"] == "3 entries along 1 traces"


def test_a_location_never_entered_takes_the_law_of_all_entries_and_an_unknown_one_stays_unknown() -> None:
    thesis = side_by_side(plant(), [trace([10, 20, 30, 40], {1: "on", 3: "off"})])["resampled"]
    assert law_of(thesis, "SPARE") == pytest.approx({"mu": 30.0, "sigma": 10.0})
    assert thesis.sha.by_name["LOST"] == plant().sha.by_name["LOST"]


def test_the_thesis_counterpart_begins_at_the_law_and_follows_the_same_flow() -> None:
    model = plant()
    seen = trace([10, 20, 30, 40, 50, 60], {1: "on", 3: "off"})
    both = side_by_side(model, [seen])
    assert both["carried"] is model
    own, thesis = (open_loop(each, seen) for each in both.values())
    assert thesis.mean[1] == pytest.approx(20.0)  # the law of ON, whatever came before
    assert thesis.mean[2] == pytest.approx(80.0 + (20.0 - 80.0) * exp(-10 * K))
    assert own.mean[1] == pytest.approx(20.0 + (10.0 - 20.0) * exp(-10 * K))


def artefact(*locations: Location) -> Model:
    edges = tuple(Edge(one.name, f"to_{other.name}", other.name) for one in locations for other in locations)
    return Model(SHA("resampled", locations, edges, locations[0].name), Alphabet(()), "T", 0.0)


def test_a_model_of_the_thesis_gets_a_counterpart_that_carries_the_temperature() -> None:
    free = Location("free", Flow("exponential", {"k": K, "noise": 0.0}), normal(60.0, 2.0), "resample")
    fixed = Location("fixed", Flow("linear", {"noise": 0.0, "m": 0.05}), normal(23.5, 1.2), "resample")
    still = Location("still", Flow("constant", {"noise": 0.0}), normal(40.0, 1.0), "resample")
    model = artefact(free, fixed, still)
    both = side_by_side(model, None)
    assert both["resampled"] is model
    seen = trace([10.0] * 4, {1: "to_fixed", 2: "to_still"})
    mean = open_loop(both["carried"], seen).mean
    warmed = 60.0 + (10.0 - 60.0) * exp(-10 * K)
    assert mean == pytest.approx([10.0, warmed, warmed + 0.5, warmed + 0.5])
    assert both["carried"].sha.by_name["free"].entry == "parameter"


def test_a_correction_is_worked_into_the_counterpart() -> None:
    corrected = plant(correction=Correction(1.1, -2.0))
    seen = trace([10, 20, 30, 40, 50, 60], {1: "on", 3: "off"})
    thesis = side_by_side(corrected, [seen])["resampled"]
    mean = open_loop(thesis, seen).mean
    assert mean[1] == pytest.approx(20.0)  # as the sensor reads it
    assert mean[2] == pytest.approx(86.0 + (20.0 - 86.0) * exp(-10 * K))


def test_without_traces_the_model_itself_says_at_what_temperatures_it_is_entered() -> None:
    model = plant()
    both = side_by_side(model, None, seed=3)
    # Nine relaxation times to 900 s: a stay ends at its own target, where the next one begins. The first stays begin
    # at 25 degC and reach theirs as well.
    assert law_of(both["resampled"], "ON")["mu"] == pytest.approx(20.0, abs=0.2)
    assert law_of(both["resampled"], "OFF")["mu"] == pytest.approx(80.0, abs=0.4)
    assert side_by_side(model, None, seed=3) == both
    assert "semi-Markov" in str(both["resampled"].provenance.settings["entry_laws"])


@pytest.mark.parametrize(
    ("model", "training", "words"),
    [
        (plant(), [trace([1.0, 2.0], {})], "no location is entered in 0 entries along 1 traces"),
        (plant(), [Trace("empty", np.arange(2.0), {})], "give traces in which events happen"),
        (plant(initial=None), None, "has no law of the first temperature"),
        (plant(semi_markov={}), None, "has no law of its stays"),
    ],
)
def test_where_nothing_gives_entry_laws_the_reason_is_said(model: Model, training: list[Trace], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        side_by_side(model, training)


def simulated(model: Model, seed: int, count: int = 8) -> list[Trace]:
    """Traces that the model itself has drawn, with events every 100 to 300 s."""
    rng = np.random.default_rng(seed)
    made = []
    for number in range(count):
        rows = np.cumsum(rng.integers(10, 30, 8))
        clock = 10.0 * np.arange(int(rows[-1]) + 10)
        symbols = ("on", "off") * 4
        events = [Event(float(clock[row]), symbol) for row, symbol in zip(rows, symbols, strict=True)]
        runs = simulate(schedule(model, events, clock), float(rng.uniform(20, 60)), 1, rng)
        made.append(Trace(f"s{number}", clock, {"T": runs.temperatures[0]}, tuple(events)))
    return made


def mean_error(model: Model, traces: list[Trace]) -> float:
    return float(np.mean([errors(open_loop(model, one), one, "T").at_samples.mae for one in traces]))


def test_each_semantics_is_the_better_one_on_data_made_by_its_own_rule() -> None:
    model = plant()
    carried = simulated(model, 1)
    both = side_by_side(model, carried)
    assert mean_error(both["carried"], carried) < 0.5 * mean_error(both["resampled"], carried)
    drawn = simulated(replace(both["resampled"], initial=None), 2)
    assert mean_error(both["resampled"], drawn) < 0.9 * mean_error(both["carried"], drawn)
