"""The exported text, run by an interpreter of its own, is the same model: means, laws, times, counts."""

import re
from dataclasses import replace
from math import inf, sqrt

import numpy as np
import pytest

from sim.engine.moment_equations import moments
from sim.engine.open_loop_run import open_loop
from sim.engine.schedules import Policy, schedule
from sim.lab.uppaal.model_export import export
from sim.plant.scenarios import SCENARIOS
from sim.sha.automaton import SHA, Distribution, Edge, Entry, Flow, Location
from sim.sha.events import Alphabet
from sim.sha.flows import FLOWS as KINDS
from sim.sha.model import Correction, Model
from sim.sha.trace import UNKNOWN, Event
from tests.uppaal.interpreter import Network
from tests.uppaal.support import FLOWS, cd, courses, learned, middle, replayed, spindle, two_locations

RUNS = 4000


def test_every_flow_kind_of_the_program_is_exercised_here() -> None:
    assert set(FLOWS) == set(KINDS)


@pytest.mark.parametrize("max_rate", [inf, 0.08])
@pytest.mark.parametrize("kind", FLOWS)
def test_the_exported_rates_give_the_native_mean_at_every_event(kind: str, max_rate: float) -> None:
    model, trace = two_locations(kind, max_rate=max_rate), replayed()
    exported = export(model, trace, tick=0)
    network, seen = courses(exported.main.xml, exported.replay.duration, middle, most=0.05)
    native = open_loop(model, trace, "resync")
    clock = native.times - native.times[0]
    for time in {*exported.replay.times, exported.replay.duration}:
        mean = native.mean[np.searchsorted(clock, time + 1e-5) - 1]
        assert seen[time] == pytest.approx(mean, abs=2e-4), time
    assert native.limited > 0 or max_rate == inf or kind == "constant"
    assert ("fmin" in re.sub(r"fmin\(jump", "", exported.main.xml)) == (max_rate != inf)
    assert network.by_name["p_1"].own["next_i"] == network.by_name["m_1"].own["taken"] == len(trace.events)


@pytest.mark.parametrize("tick", [0, 3])
@pytest.mark.parametrize(
    ("kind", "entry"),
    [(kind, entry) for kind in FLOWS for entry in ("parameter", "resample", "none")],
)
def test_the_noise_and_the_draws_on_entry_have_the_exact_law_at_event_times(kind: str, entry: Entry, tick: int) -> None:
    model, trace = two_locations(kind, entry), replayed()
    exported = export(model, trace, tick=tick)
    rng = np.random.default_rng(7)

    def draw(function: str, mean: float, sigma: float) -> np.ndarray:
        assert function == "random_normal" and sigma > 0
        return rng.normal(mean, sigma, RUNS)

    _, seen = courses(exported.main.xml, exported.replay.duration, draw, most=2.0)
    begin = trace.times[0]
    events = sorted(set(exported.replay.times))
    steps = schedule(model, trace.events, begin + np.array(events), start=begin, inputs=trace)
    exact = moments(steps, 30.0)
    for row, time in enumerate(events):
        values = np.broadcast_to(seen[time], RUNS)
        sigma = sqrt(exact.variance[row])
        assert values.mean() == pytest.approx(exact.mean[row], abs=5 * sigma / sqrt(RUNS) + 1e-3), time
        assert values.std() == pytest.approx(sigma, rel=5 / sqrt(2 * RUNS), abs=1e-6), time
    assert exact.variance[-1] > 0


@pytest.mark.parametrize("name", SCENARIOS)
def test_all_events_of_a_scenario_fire_at_their_times_and_the_mean_is_ours(name: str) -> None:
    model, trace = learned(), cd(name)
    exported = export(model, trace, tick=0)
    network, seen = courses(exported.main.xml, exported.replay.duration, middle, most=5.0)
    sent = [time for time, sync in network.by_name["p_1"].fired if sync]
    assert sent == pytest.approx(exported.replay.times, abs=1e-9)
    assert len(sent) == network.by_name["m_1"].own["taken"]
    native = open_loop(model, trace, "resync")
    assert seen[max(seen)] == pytest.approx(float(native.mean[-1]), abs=1e-3)
    assert network.by_name["m_1"].own["clamps"] == native.clamps == 0


def test_a_run_that_leaves_the_range_is_put_back_and_counted() -> None:
    model, trace = two_locations("linear", high=31.0), replayed()
    exported = export(model, trace, tick=1)
    network, seen = courses(exported.main.xml, exported.replay.duration, middle)
    assert network.by_name["m_1"].own["clamps"] > 0
    assert max(float(value) for time, value in seen.items() if time in exported.replay.times) <= 31.0
    assert open_loop(model, trace).clamps > 0


def test_a_run_that_begins_inside_a_stay_keeps_its_age() -> None:
    model, trace = two_locations("logarithmic"), replayed(("up", "up", "up", "down"))
    trace.signals["Temp"][:15] = np.nan
    exported = export(model, trace, tick=0)
    _, seen = courses(exported.main.xml, exported.replay.duration, middle, most=0.05)
    assert exported.replay.location == "warm" and exported.replay.age == pytest.approx(5 * 1.73, abs=0.01)
    assert seen[max(seen)] == pytest.approx(float(open_loop(model, trace).mean[-1]), abs=1e-4)


@pytest.mark.parametrize(("policy", "taken"), [("resync", 6), ("ignore", 5)])
def test_an_event_without_an_edge_does_what_the_policy_says(policy: Policy, taken: int) -> None:
    model, trace = two_locations("exponential"), replayed(("up", "up", "down", "down", "up", "down"))
    exported = export(model, trace, policy=policy, tick=0)
    network, seen = courses(exported.main.xml, exported.replay.duration, middle, most=1.0)
    assert network.by_name["m_1"].own["taken"] == taken
    assert network.by_name["p_1"].own["next_i"] == 6
    assert seen[max(seen)] == pytest.approx(float(open_loop(model, trace, policy).mean[-1]), abs=1e-4)
    assert len(exported.main.notes) == 1
    with pytest.raises(ValueError, match=r"event 3 .'down'.*has no edge"):
        export(model, trace, policy="reject")


def test_unknown_leads_to_the_initial_location_in_both_models() -> None:
    model, trace = two_locations("exponential"), replayed(("up", "up", UNKNOWN, "up", "down", "up"))
    exported = export(model, trace, tick=0)
    _, seen = courses(exported.main.xml, exported.replay.duration, middle, most=1.0)
    assert seen[max(seen)] == pytest.approx(float(open_loop(model, trace, "reject").mean[-1]), abs=1e-4)
    assert structure_accepts(exported.minimal.xml)


def structure_accepts(xml: str) -> bool:
    """Whether `A<> p_1.next_i == N_E` holds: the structure is deterministic, so its one run decides."""
    network = Network(xml, middle)
    network.settle()
    return bool(network.by_name["p_1"].own["next_i"] == network.globals["N_E"])


def test_the_minimal_model_accepts_what_the_automaton_accepts_and_stops_at_what_it_does_not() -> None:
    model = two_locations("exponential")
    good, bad = replayed(), replayed(("up", "up", "down", "down", "up", "down"))
    for trace, accepted in ((good, True), (bad, False)):
        exported = export(model, trace)
        assert exported.replay.accepted is accepted
        assert structure_accepts(exported.minimal.xml) is accepted
        assert structure_accepts(exported.minimal.xml.replace("\nchan ", "\nbroadcast chan ")) is True  # vacuous


def test_a_signal_that_is_read_late_counts_as_at_its_reference_until_then() -> None:
    model, trace = two_locations("driven"), replayed()
    trace.signals["load"][:33] = np.nan
    exported = export(model, trace, tick=0)
    _, seen = courses(exported.main.xml, exported.replay.duration, middle, most=0.5)
    assert seen[max(seen)] == pytest.approx(float(open_loop(model, trace).mean[-1]), abs=1e-4)


@pytest.mark.parametrize(
    "law",
    [
        Distribution("exponential", {"mean": 40.0}),
        Distribution("weibull", {"shape": 2.0, "scale": 40.0}),
        Distribution("lognormal", {"mu": 3.5, "sigma": 0.2}),
    ],
)
def test_parameters_that_are_not_normal_are_drawn_from_their_own_law(law: Distribution) -> None:
    flow = Flow("exponential", {"k": 0.05, "noise": 0.0})
    sha = SHA("odd", (Location("q", flow, law),), (Edge("q", "up", "q"), Edge("q", "down", "q")), "q")
    model, trace = Model(sha, Alphabet(()), "Temp", 0.0), replayed()
    exported = export(model, trace)
    rng = np.random.default_rng(3)

    def draw(function: str, *arguments: float) -> np.ndarray:
        if function == "random":
            return rng.uniform(0.0, arguments[0], RUNS)
        return rng.normal(*arguments, RUNS)

    _, seen = courses(exported.main.xml, exported.replay.duration, draw, most=1.0)
    exact = open_loop(model, trace)
    last, sigma = seen[max(seen)], sqrt(exact.variance[-1])
    assert last.mean() == pytest.approx(exact.mean[-1], abs=5 * sigma / sqrt(RUNS))
    assert last.std() == pytest.approx(sigma, rel=0.15)


@pytest.mark.parametrize("full", [False, True], ids=["sparse", "every symbol from everywhere"])
def test_an_automaton_with_102_symbols_replays_all_of_them(full: bool) -> None:
    model, trace = spindle(full)
    exported = export(model, trace, tick=0)
    network, _ = courses(exported.main.xml, exported.replay.duration, middle, most=10.0)
    assert network.by_name["m_1"].own["taken"] == 101
    assert structure_accepts(exported.minimal.xml)


def test_a_trace_without_events_is_exported_too() -> None:
    model, trace = two_locations("exponential"), replayed()
    silent = type(trace)("silent", trace.times, trace.signals, ())
    exported = export(model, silent, tick=0)
    network, seen = courses(exported.main.xml, exported.replay.duration, middle)
    assert network.by_name["p_1"].here == "Done"
    assert seen[max(seen)] == pytest.approx(float(open_loop(model, silent).mean[-1]), abs=1e-4)
    assert structure_accepts(exported.minimal.xml)


def test_of_evenly_spaced_events_none_is_lost() -> None:
    """With cumulative times against a clock that each event resets, only 10 of 47 would fire."""
    model, trace = two_locations("exponential"), replayed()
    times = trace.times[0] + 3.0 * np.arange(1, 48)
    events = tuple(Event(float(time), "up") for time in times)
    even = type(trace)("even", trace.times[0] + np.arange(0.0, 150.0), {"Temp": np.full(150, 30.0)}, events)
    exported = export(model, even)
    network, _ = courses(exported.main.xml, exported.replay.duration, middle, most=5.0)
    assert network.by_name["m_1"].own["taken"] == 47


def test_a_correction_of_the_sensor_is_worked_into_the_exported_model() -> None:
    model, trace = replace(two_locations("driven"), correction=Correction(1.1, -2.0)), replayed()
    exported = export(model, trace, tick=0)
    _, seen = courses(exported.main.xml, exported.replay.duration, middle, most=0.5)
    assert seen[max(seen)] == pytest.approx(float(open_loop(model, trace).mean[-1]), abs=1e-4)
