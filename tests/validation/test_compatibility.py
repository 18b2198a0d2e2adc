"""Which events have no edge, under each policy; and what the full encoding means to a model of changes."""

from dataclasses import replace

import pytest

from sim.engine.schedules import Policy
from sim.lab.judge.compatibility import compatibility, dense_events
from sim.sha.automaton import Edge
from sim.sha.events import encode
from sim.sha.trace import UNKNOWN, Event
from tests.validation.small_plant import plant_model, plant_trace, without_edge

SHA = plant_model().sha


def events(*symbols: str) -> list[Event]:
    return [Event(float(10 * index), symbol) for index, symbol in enumerate(symbols)]


def test_every_event_that_has_an_edge_is_accepted() -> None:
    found = compatibility(SHA, events("M_ON", "M_OFF", UNKNOWN, "M_ON"))
    assert found.accepts_all and found.sentence == "" and found.events == 4


def test_an_event_without_an_edge_is_named_with_index_time_location_and_symbol() -> None:
    sha = without_edge(plant_model(), "on", "M_ON").sha
    found = compatibility(sha, events("M_ON", "M_ON", "M_OFF", "M_ON", "M_ON"))
    assert (found.missing, found.pairs) == (2, {("on", "M_ON"): 2})
    assert "event 1 ('M_ON' at 10.000 s) has no edge in location 'on'" in found.sentence
    assert "('M_ON' at 2025-03-26 14:40:00.250 UTC)" in str(replace(found.named[0], time=1.743e9 + 0.25))
    assert "1 more of the 5 events" in found.sentence


def test_unknown_leads_back_to_the_start_and_needs_no_edge() -> None:
    sha = without_edge(plant_model(), "on", "M_ON").sha
    assert compatibility(sha, events("M_ON", UNKNOWN, "M_ON")).accepts_all


@pytest.mark.parametrize(("policy", "missing"), [("ignore", 2), ("reject", 2), ("resync", 1)])
def test_the_walk_goes_on_as_the_policy_says(policy: Policy, missing: int) -> None:
    sha = replace(SHA, edges=(Edge("off", "M_OFF", "off"), Edge("on", "M_ON", "on")))
    assert compatibility(sha, events("M_ON", "M_ON"), policy).missing == missing


def test_an_automaton_that_is_not_deterministic_accepts_what_one_of_its_paths_accepts() -> None:
    twice = replace(without_edge(plant_model(), "on", "M_ON").sha, edges=(Edge("off", "M_ON", "on"), *SHA.edges[:1]))
    both = replace(twice, edges=(Edge("off", "M_ON", "on"), Edge("off", "M_ON", "off")))
    assert compatibility(both, events("M_ON", "M_ON", "M_ON")).accepts_all
    assert compatibility(both, events("M_ON", "M_OFF")).named[0].location == "off or on"


def test_repeats_without_an_edge_change_nothing_and_repeats_with_one_are_taken() -> None:
    trace = plant_trace(rows=200)
    model = plant_model()
    full, filtered = encode(trace, model.alphabet, "full"), encode(trace, model.alphabet)
    assert len(full) >= 200 > len(filtered)
    assert dense_events(model.sha, full, filtered, "reject") == list(full)
    changes = without_edge(without_edge(model, "on", "M_ON"), "off", "M_OFF").sha
    assert dense_events(changes, full, filtered, "reject") == list(filtered)


def test_an_event_of_its_own_is_kept_even_without_an_edge_so_that_it_is_refused_later() -> None:
    lacking = without_edge(plant_model(), "off", "M_ON").sha
    assert dense_events(lacking, events("M_ON"), events("M_ON"), "reject") == events("M_ON")
