"""Verification says what is certain of a model's structure and temperatures, and whether it may be deployed."""

from dataclasses import replace
from itertools import count
from math import inf

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from sim.engine.tracker import OnlinePolicy, compile_model, next_location
from sim.lab.formats.find import find_model
from sim.lab.learning.structure import bare_sha
from sim.proof.envelope import quantiles
from sim.proof.structure import accept, components, dead_ends, edge_symbols, missing, moves, traps, unreachable
from sim.proof.verification import verify
from sim.proof.word import TimedWord, parse_word, word_text
from sim.proof.word_replay import replay
from sim.sha.automaton import SHA, Distribution, Edge, Flow, Input, Location
from sim.sha.distributions import mean
from sim.sha.events import DECANTER, alphabet_symbols
from sim.sha.model import Correction, Model
from sim.sha.trace import UNKNOWN, Event, Trace
from tests.artefacts.real import SETS, real_data
from tests.checking.verify_models import linear, models, normal, of, relaxing, thesis
from tests.gateway.support import two_modes

STILL = Flow("constant", {"noise": 0.0})
HEAVY = {"shape": 0.1, "scale": 1.0}


def graph(edges: str, names: str = "pqrs") -> SHA:
    """An automaton from edges such as "paq" (p -a-> q)."""
    return SHA(
        "graph",
        tuple(Location(name, STILL, None, "none") for name in names),
        tuple(Edge(source, symbol, target) for source, symbol, target in edges.split()),
        names[0],
    )


def trace(word: str, name: str = "t") -> Trace:
    events = tuple(Event(10.0 + place, UNKNOWN if symbol == "?" else symbol) for place, symbol in enumerate(word))
    return Trace(name, np.array([0.0]), {}, events)


# ------------------------------------------------------------------ structure


def test_every_conflict_is_listed() -> None:
    found = verify(graph("paq par qbp qbq qap")).check("determinism")
    assert found.verdict == "refuted" and found.blocking
    assert found.details == (
        "location 'p' has 2 targets on 'a': q, r",
        "location 'q' has 2 targets on 'b': p, q",
    )


def test_every_location_is_told_with_the_symbols_that_it_lacks() -> None:
    sha = graph("paq pbp qap", "pq")
    assert missing(sha, ("a", "b", UNKNOWN)) == {"q": ("b",)}
    assert missing(sha, ("a", "z")) == {"p": ("z",), "q": ("z",)}
    assert edge_symbols(sha) == ("a", "b")
    assert verify(sha).check("input-enabled").details == ("location 'q' lacks b",)
    assert verify(sha, symbols=("a",)).check("input-enabled").verdict == "proven"


def test_reachability_dead_ends_and_components_are_those_of_the_graph() -> None:
    sha = graph("paq qbp par sap")
    assert unreachable(sha) == ("s",)
    assert dead_ends(sha) == ("r",)
    assert components(sha) == (("p", "q"), ("r",), ("s",))
    assert dead_ends(graph("paq qaq", "pq")) == ("q",), "a loop to itself is no way out"
    assert traps(graph("paq qar raq", "pqr")) == (("q", "r"),)


@settings(deadline=None, max_examples=100)
@given(st.sets(st.tuples(st.sampled_from("pqrstuvw"), st.sampled_from("pqrstuvw")), max_size=16))
def test_components_are_those_that_scipy_finds(arrows: set[tuple[str, str]]) -> None:
    names = "pqrstuvw"
    rows, columns = [names.index(one) for one, _ in arrows], [names.index(other) for _, other in arrows]
    count_, labels = connected_components(
        csr_array((np.ones(len(arrows)), (rows, columns)), shape=(8, 8)), directed=True, connection="strong"
    )
    groups = [tuple(name for name, label in zip(names, labels, strict=True) if label == each) for each in range(count_)]
    found = components(graph(" ".join(f"{one}a{other}" for one, other in sorted(arrows)), names))
    assert set(found) == set(groups) and len(found) == count_
    assert [len(group) for group in found] == sorted(map(len, found), reverse=True)
    assert traps(graph("paq qap", "pq")) == ()


def test_the_learners_product_automaton_passes_all_structural_checks() -> None:
    found = verify(bare_sha(DECANTER))
    passed = {check.name for check in found.checks if check.verdict == "proven"}
    assert passed >= {"determinism", "input-enabled", "reachability", "dead ends"}


@pytest.mark.parametrize(
    ("word", "index", "places"),
    [("ab", None, ()), ("abb", 2, ("p",)), ("a?a", None, ()), ("", None, ()), ("b", 0, ("p",))],
)
def test_a_trace_is_accepted_or_told_where_it_stops(word: str, index: int | None, places: tuple[str, ...]) -> None:
    found = accept(graph("paq qbp", "pq"), trace(word).events)
    assert (found.index, found.locations) == (index, places)
    if index is not None:
        assert found.time == 10.0 + index and f"stops at event {index} of {len(word)} ('b'" in found.sentence


def test_with_several_targets_one_run_that_follows_is_enough() -> None:
    sha = graph("paq par rbp")
    assert accept(sha, trace("ab").events).index is None
    assert accept(sha, trace("aa").events).locations == ("q", "r")


def test_a_rejected_trace_keeps_a_model_from_being_deployed() -> None:
    model = two_modes()
    good = Trace("good", trace("").times, {}, (Event(1.0, "W_ON"), Event(2.0, "A_2")))
    bad = Trace("bad", trace("").times, {}, (Event(1.0, "W_ON"), Event(5.0, "bang")))
    assert verify(model, traces=[good]).deployable
    found = verify(model, traces=[good, bad])
    assert not found.deployable
    (reason,) = found.reasons
    assert "1 of 2 traces; bad: stops at event 1 of 2 ('bang' at 5.000 s), which has no edge out of 'on'" in reason


def test_what_can_happen_at_run_time_includes_unknown_and_resynchronisation() -> None:
    sha = graph("paq qbp", "pq")
    assert set(moves(sha, ("a", "b", "c"), "reject")) == {
        ("p", "a", "q"),
        ("q", "b", "p"),
        ("p", UNKNOWN, "p"),
        ("q", UNKNOWN, "p"),
    }
    jumps = set(moves(sha, ("a", "b", "c"), "resync")) - set(moves(sha, ("a", "b", "c"), "reject"))
    assert jumps == {("q", "a", "q"), ("p", "b", "p"), ("p", "c", "p"), ("q", "c", "p")}


@settings(max_examples=60, deadline=None)
@given(models(), st.sampled_from(["resync", "ignore"]))
def test_what_is_judged_are_the_moves_that_the_gateway_makes(model: Model, policy: OnlinePolicy) -> None:
    tracker = compile_model(model, policy)
    symbols = alphabet_symbols(model.alphabet)
    made = {
        (place.name, symbol, target)
        for place in model.sha.locations
        for symbol in (*symbols, UNKNOWN)
        if (target := next_location(tracker, place.name, symbol)[0]) is not None
    }
    assert set(moves(model.sha, symbols, policy)) == made


# ------------------------------------------------------------------ deployment


def test_an_automaton_with_guards_is_refused_for_running_and_told_why() -> None:
    model = two_modes()
    edges = (replace(model.sha.edges[0], guard="x > 3"), *model.sha.edges[1:])
    found = verify(replace(model, sha=replace(model.sha, edges=edges)))
    assert not found.executable and not found.deployable
    assert "has the guard 'x > 3'" in found.reasons[0]
    assert "variables that no trace carries" in found.reasons[0]
    assert found.bounds is None


def test_a_bare_structure_gives_the_reason_why_it_cannot_be_run() -> None:
    found = verify(graph("paq qbp", "pq"), refusal="no flow file")
    assert found.reasons == ("runnable refuted: no flow file",)


def test_the_model_that_reaches_700_degrees_is_refused_with_the_word_that_does_it() -> None:
    found = verify(thesis())
    assert not found.deployable and found.executable
    growth = found.check("growth")
    assert growth.verdict == "refuted" and "T grows upwards without bound" in growth.evidence
    (word,) = growth.words
    assert replay(thesis(), word).highest > 150.0


def test_a_constant_target_far_outside_is_refused_though_it_does_not_grow() -> None:
    found = verify(of(relaxing("p", 700.0)))
    assert found.check("growth").verdict == "proven"
    assert [reason.partition(" ")[0] for reason in found.reasons] == ["mean"]


def test_a_location_is_given_the_benefit_of_its_own_doubt_but_not_of_any() -> None:
    """-40 degC, give or take 20, may well be 0 degC; but certain of -40, or wildly unsure of 700, it is wrong."""
    assert verify(of(relaxing("p", -40.0, sigma=20.0))).deployable
    for target, sigma in ((-40.0, 2.0), (190.0, 2.0), (700.0, 300.0), (-200.0, 1000.0)):
        found = verify(of(relaxing("p", target, sigma=sigma)))
        assert [reason.partition(" ")[0] for reason in found.reasons] == ["mean"], (target, sigma)
        (word,) = found.check("mean course").words
        assert replay(of(relaxing("p", target, sigma=sigma)), word).leaves(0.0, 150.0) is not None


def test_the_mean_course_takes_the_mean_that_the_gateway_works_with_and_not_the_median() -> None:
    heavy = Location("p", Flow("exponential", {"k": 0.01, "noise": 0.0}), Distribution("weibull", HEAVY))
    assert quantiles(Distribution("weibull", HEAVY), 0.0)[0] < 1.0 < 1e6 < mean(Distribution("weibull", HEAVY))
    assert verify(of(heavy)).check("mean course").verdict == "refuted"


def test_a_driven_target_must_stay_inside_over_the_whole_range_of_its_input() -> None:
    flow = Flow("driven", {"k": 0.01, "noise": 0.0}, (Input("Load", 50.0, 10.0),))
    found = verify(of(Location("p", flow, normal(40.0, 0.0))))
    assert [reason.partition(" ")[0] for reason in found.reasons] == ["mean"]


def test_noise_that_is_wider_than_the_range_is_refused() -> None:
    loud = Location("p", Flow("exponential", {"k": 0.01, "noise": 20.0}), normal(50.0, 0.0))
    wandering = Location("p", Flow("constant", {"noise": 10.0}), None, "none")
    for model in (of(loud), of(wandering), replace(of(relaxing("p", 50.0)), sensor_sigma=60.0)):
        found = verify(model)
        assert [reason.partition(" ")[0] for reason in found.reasons] == ["noise"]


def test_growth_is_judged_by_the_models_own_range_whatever_is_claimed() -> None:
    found = verify(thesis(), bounds=(0.0, inf))
    assert found.check("bounds").verdict == "proven", "of course it stays below infinity"
    assert found.check("growth").verdict == "refuted" and not found.deployable


def test_a_correction_moves_the_range_with_it_and_must_be_one_of_a_sensor() -> None:
    model = of(relaxing("p", 100.0))
    assert verify(replace(model, correction=Correction(1.2, -3.0))).deployable
    for wrong in (Correction(20.0), Correction(0.4), Correction(1.0, 200.0)):
        found = verify(replace(model, correction=wrong))
        assert found.check("correction").verdict == "refuted" and not found.deployable
    hot = verify(replace(of(relaxing("p", 140.0)), correction=Correction(1.0, 60.0)), bounds=(0.0, 150.0))
    assert hot.check("bounds").verdict == "refuted", "a claim is about what the sensor reads and the PLC gets"
    assert "200" in hot.check("bounds").evidence


def test_a_target_that_only_rare_stays_carry_outside_is_told_and_does_not_block() -> None:
    model = of(relaxing("p", 10.0, sigma=8.0))
    found = verify(model)
    assert found.deployable
    assert found.check("bounds").verdict == "refuted" and not found.check("bounds").blocking
    claimed = verify(model, bounds=(0.0, 150.0))
    assert not claimed.deployable and claimed.check("bounds").blocking


def test_an_input_without_a_range_leaves_the_temperature_undecided() -> None:
    from tests.artefacts.models import decanter_model

    found = verify(decanter_model())
    assert found.check("growth").verdict == "not decided" and not found.deployable
    assert "driven by 'Coppia', whose range nobody says" in found.reasons[0]


def test_each_check_says_how_long_it_took_by_the_clock_that_is_given() -> None:
    ticks = count()
    found = verify(two_modes(), clock=lambda: float(next(ticks)))
    assert [check.seconds for check in found.checks] == [1.0] * len(found.checks)


# ------------------------------------------------------------------ words


@pytest.mark.parametrize(
    "text",
    [
        "@0,T=20,m=31 W_ON@0,m=52 A_2@30,m=80,Assorbimento=280 @600",
        'W_ON@0 "A 2@30,Volume Flow (l/min)=28" @40',
        "W_ON@1e-3 A_2@30",
        "@0 @5",
        "W_ON@0 # a comment\nA_2@30",
    ],
)
def test_a_word_is_read_and_written_back_the_same(text: str) -> None:
    word = parse_word(text)
    assert parse_word(word_text(word)) == word
    assert not word.steps[0].symbol and all(step.symbol for step in word.steps[1:])


def test_the_parts_of_a_word_are_what_they_say() -> None:
    word = parse_word("@0,T=20 W_ON@5,m=52,Load=280 @600")
    assert word.end == 600.0 and word.events == (Event(5.0, "W_ON"),)
    assert word.steps[0].temperature == 20.0
    assert (word.steps[1].m, word.steps[1].inputs) == (52.0, {"Load": 280.0})


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "the word is empty"),
        ("W_ON", "'W_ON' is no item of a word; write SYMBOL@SECONDS"),
        ("W_ON@x", "'x' is no finite number"),
        ("W_ON@inf", "'inf' is no finite number"),
        ("W_ON@-1", "never negative"),
        ("W_ON@5 A_2@3", r"goes back from 5 s to 3 s \(A_2\)"),
        ("W_ON@0,m=x", "'x' is no finite number"),
        ("W_ON@0 @5 A_2@7", "the item at 5 s has no symbol"),
        ("W_ON@0 @5,m=3", "the last item only says when the word ends"),
        ("@3 W_ON@5", "the word begins at 3 s"),
        ('"W_ON@0', "close each quotation"),
    ],
)
def test_what_is_no_word_is_one_sentence(text: str, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        parse_word(text)


def test_a_replay_moves_by_the_closed_form_and_takes_means_where_the_word_is_silent() -> None:
    done = replay(of(relaxing("p", 20.0), linear("q", 0.5)), parse_word("@0,T=20 a@100 a@200,m=80 @1e6"))
    assert [visit.location for visit in done.visits] == ["p", "q", "p"]
    assert [visit.left for visit in done.visits] == pytest.approx([20.0, 70.0, 80.0])
    assert done.leaves(0.0, 75.0) == done.visits[2] and done.leaves(0.0, 81.0) is None


def test_a_replay_follows_the_policy_for_events_without_an_edge() -> None:
    model = of(relaxing("p", 20.0), relaxing("q", 50.0))
    word = parse_word("z@10 a@20 @30")
    with pytest.raises(ValueError, match=r"event 0 \('z' at 10 s\): location 'p' of SHA 'made' has no edge for it"):
        replay(model, word, "reject")
    assert [visit.location for visit in replay(model, word, "resync").visits] == ["p", "p", "q"]
    ignored = replay(model, word, "ignore").visits
    assert [(visit.location, visit.seconds) for visit in ignored] == [("p", 20.0), ("q", 10.0)]


def test_a_word_cannot_set_a_temperature_that_the_location_does_not_draw() -> None:
    with pytest.raises(ValueError, match="entering 'q' leaves the temperature as it is"):
        replay(of(relaxing("p", 20.0), relaxing("q", 50.0)), parse_word("a@5,T=90 @9"))
    with pytest.raises(ValueError, match="the word says no start temperature"):
        replay(replace(two_modes(), initial=None), TimedWord(parse_word("W_ON@5").steps, 9.0))


# ------------------------------------------------------------------ the public learner's automata


class TestRealArtefacts:
    pytestmark = real_data

    @pytest.mark.parametrize("name", SETS)
    def test_every_public_set_has_its_structure_checked_whether_it_can_be_run_or_not(self, name: str) -> None:
        found = find_model(SETS[name] / name)
        assert found.artefacts is not None
        symbols = [symbol for symbol, _ in found.artefacts.report.events]
        done = verify(found.model or found.structure, symbols=symbols, refusal=found.refusal)
        targets: dict[tuple[str, str], set[str]] = {}
        for edge in found.structure.edges:
            targets.setdefault((edge.source, edge.symbol), set()).add(edge.target)
        conflicts = [key for key, ends in targets.items() if len(ends) > 1]
        assert len(done.check("determinism").details) == len(conflicts)
        assert done.executable == (found.model is not None and not conflicts)
