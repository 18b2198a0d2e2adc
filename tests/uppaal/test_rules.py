"""Each rule of UPPAAL's parser holds on what is exported, and is caught when it is broken: one mutation a rule."""

import re
from collections.abc import Callable
from math import inf

import numpy as np
import pytest

from sim.lab.uppaal.document import comment_text, number
from sim.lab.uppaal.model_export import ExportError, export
from sim.lab.uppaal.rules import RULES, check_rules
from sim.plant.scenarios import SCENARIOS
from sim.sha.automaton import SHA, Distribution, Edge, Entry, Flow, Location
from sim.sha.events import Alphabet
from sim.sha.model import Model
from sim.sha.trace import Event, Trace
from tests.uppaal.interpreter import parsed
from tests.uppaal.support import FLOWS, cd, learned, replayed, spindle, two_locations

MAIN = export(two_locations("driven", max_rate=0.5), replayed()).main
MINIMAL = export(two_locations("driven"), replayed()).minimal

Change = Callable[[str], str]


def swap(old: str, new: str, count: int = 1) -> Change:
    """A mutation that must find what it changes."""

    def change(xml: str) -> str:
        assert old in xml, old
        return xml.replace(old, new, count)

    return change


def asked(query: str) -> Change:
    """A mutation that puts a query into the document."""
    escaped = query.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return swap("<queries>", f"<queries><query><formula>{escaped}</formula></query>")


BROKEN: dict[str, tuple[str, str, Change, str]] = {
    "no doctype": ("DOCTYPE", "main", swap("flat-1_6.dtd", "flat.dtd"), "flat-1_x"),
    "not well formed": ("XML", "main", swap("</nta>", ""), "not well-formed"),
    "an edge to nowhere": (
        "structure",
        "main",
        swap('<target ref="Machine_id1"/>', '<target ref="Machine_id99"/>'),
        "no location",
    ),
    "no start": ("structure", "main", swap('<init ref="Machine_id0"/>', ""), "initial"),
    "a location twice": ("structure", "main", swap(">cold</name>", ">warm</name>"), "twice"),
    "an id twice": ("structure", "main", swap('location id="Machine_id2"', 'location id="Machine_id1"'), "twice"),
    "queries first": ("structure", "main", lambda xml: _queries_first(xml), "UPPAAL reads them as"),
    "a word as a name": ("words", "main", swap(">cold</name>", ">location</name>"), "word of UPPAAL"),
    "a long name": ("words", "main", swap(">cold</name>", f">{'c' * 64}</name>"), "63"),
    "a sign for <=": ("ASCII", "main", swap("since &lt;= TICK", "since ≤ TICK"), "ASCII"),
    "a sign for <= in a query": ("ASCII", "main", asked("Pr[≤9](<> m_1.Temp >= 30.0)"), "ASCII"),
    "min": ("fmin", "main", swap("fmin(", "min("), "fmin"),
    "min in a query": ("fmin", "main", asked("Pr[<=9](<> min(m_1.Temp, 3.0) >= 30.0)"), "fmin"),
    "an undeclared name": ("declared names", "main", swap("* (m +", "* (mu +"), "nothing declares"),
    "an integer for a double": ("literals", "main", swap("const double LOW = 0.0;", "const double LOW = 0;"), "1.0"),
    "no number": ("literals", "main", swap("const double LOW = 0.0;", "const double LOW = nan;"), "nan"),
    "a draw in a guard": ("random draws", "main", swap("since &gt;= TICK", "since &gt;= random(1.0)"), "only updates"),
    "a normal without width": (
        "random draws",
        "main",
        swap("random_normal(0.0, 1.0)", "random_normal(0.0, 0.0)"),
        "width 0",
    ),
    "a clock reset at each event": (
        "replayed times",
        "main",
        swap("next_i = next_i + 1", "next_i = next_i + 1, time = 0"),
        "cumulative",
    ),
    "deltas without a reset": (
        "replayed times",
        "main",
        lambda xml: xml.replace("EVENT_TIMES", "EVENT_DELTAS"),
        "cumulative",
    ),
    "times that fall": ("replayed times", "main", swap("0.0, 0.0, 17.3", "0.0, 20.0, 17.3"), "cumulative"),
    "an event lost unseen": ("lost events", "main", swap(", taken = taken + 1", ""), "counting"),
    "statistics over a binary channel": ("channels", "main", swap("broadcast chan", "chan"), "broadcast"),
    "compatibility over broadcast": ("channels", "minimal", swap("chan up", "broadcast chan up"), "vacuous"),
    "symbolic over a hybrid clock": ("symbolic queries", "main", asked("A[] m_1.Temp <= 150"), "symbolic"),
    "the old order of simulate": ("query forms", "main", asked("simulate 10 [<=444] {m_1.Temp}"), "N] {"),
    "a single =": ("query forms", "minimal", swap("p_1.next_i == N_E", "p_1.next_i = N_E"), "write =="),
    "a final value": ("query forms", "main", asked("E[<=9; 10](final: m_1.Temp)"), "final"),
    "a bound that is no integer": ("query forms", "main", asked("Pr[<=9.5](<> m_1.Temp >= 30.0)"), "whole number"),
    "a threshold 1": ("query forms", "main", asked("Pr[<=9](<> m_1.Temp >= 30.0) >= 1"), "1.0"),
    "no runs": ("query forms", "main", asked("E[<=9](max: m_1.Temp)"), "number of runs"),
    "a bare name": ("qualified names", "main", asked("Pr[<=9](<> Temp >= 30.0)"), "m_1.Temp"),
    "a location that is not there": ("qualified names", "main", asked("Pr[<=9](<> m_1.hot)"), "does not have"),
}


def _queries_first(xml: str) -> str:
    queries = xml[xml.index("\t<queries>") : xml.index("</queries>") + len("</queries>\n")]
    return xml.replace(queries, "").replace("<nta>\n", f"<nta>\n{queries}")


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_rule_is_caught(name: str) -> None:
    rule, which, change, words = BROKEN[name]
    whole = {"main": MAIN, "minimal": MINIMAL}[which]
    assert check_rules(whole.xml, []) == []
    found = check_rules(change(whole.xml), [])
    assert any(sentence.startswith(f"{rule}: ") and words in sentence for sentence in found), found


def test_every_rule_has_its_mutation() -> None:
    assert {rule for rule, *_ in BROKEN.values()} == {*RULES, "DOCTYPE", "XML"}


def test_queries_given_beside_the_document_are_checked_like_its_own() -> None:
    assert check_rules(MAIN.xml, ["simulate 10 [<=444] {m_1.Temp}"]) != []
    assert check_rules(MAIN.xml, ["simulate [<=444; 10] {m_1.Temp}", "E[<=444; 10](max: m_1.Temp)"]) == []


def exported(model: Model, trace: Trace, tick: int = 1) -> None:
    found = export(model, trace, tick=tick)
    for document in (found.main, found.minimal):
        assert check_rules(document.xml, [question.formula for question in document.questions]) == []
        root = parsed(document.xml)
        places = {(one.get("x"), one.get("y")) for one in root.iterfind("template[1]/location")}
        assert len(places) == len(root.findall("template[1]/location")), "locations are drawn apart"


@pytest.mark.parametrize("method", ["bins", "lsha"])
@pytest.mark.parametrize("name", SCENARIOS)
def test_what_either_method_learns_follows_the_rules_along_all_scenarios(name: str, method: str) -> None:
    exported(learned(method), cd(name))


@pytest.mark.parametrize("tick", [0, 2])
@pytest.mark.parametrize("max_rate", [inf, 0.05])
@pytest.mark.parametrize("entry", ["parameter", "resample", "none"])
@pytest.mark.parametrize("kind", FLOWS)
def test_every_flow_entry_and_saturation_follows_the_rules(kind: str, entry: Entry, max_rate: float, tick: int) -> None:
    exported(two_locations(kind, entry, max_rate), replayed(), tick)


def test_large_automata_follow_the_rules() -> None:
    exported(*spindle(full=False))


ODD = [
    "ON/200-300",
    "a<b & c>d",
    "Temp",
    "m",
    "taken",
    "EVENTS",
    "Wait",
    "perchè no?",
    "]]>",
    "*/ chan x;",
    "1",
    "sin",
    "",
    "x" * 90,
]


def test_names_of_any_kind_become_legal_ones() -> None:
    flow = Flow("exponential", {"k": 0.01, "noise": 0.02})
    law = Distribution("normal", {"mu": 30.0, "sigma": 1.0})
    places = tuple(Location(name, flow, law) for name in ODD)
    edges = tuple(Edge(ODD[index - 1], name, name) for index, name in enumerate(ODD))
    model = Model(SHA("odd / <name>\n", places, edges, ODD[-1]), Alphabet(()), "Temp", 0.0)
    times = np.arange(0.0, 50.0)
    events = tuple(Event(float(index), name) for index, name in enumerate(ODD, 1))
    exported(model, Trace('../"odd" trace', times, {"Temp": np.full(50, 30.0)}, events))


def test_a_model_that_cannot_be_exported_gets_its_sentence() -> None:
    trace = replayed()
    model = two_locations("exponential")
    guarded = SHA("g", model.sha.locations, (Edge("cold", "up", "warm", "x < 3"),), "cold")
    several = SHA("n", model.sha.locations, (Edge("cold", "up", "warm"), Edge("cold", "up", "cold")), "cold")
    for sha, words in ((guarded, "guard"), (several, "not deterministic")):
        with pytest.raises(ExportError, match=rf"cannot be exported along trace 'swing': .*{words}"):
            export(Model(sha, Alphabet(()), "Temp", 0.0), trace)
    driven = two_locations("driven")
    bare = Trace("bare", trace.times, {"Temp": trace.signals["Temp"]}, trace.events)
    with pytest.raises(ExportError, match="'load'"):
        export(driven, bare)
    with pytest.raises(ExportError, match="tick"):
        export(model, trace, tick=-1)


@pytest.mark.parametrize(
    ("query", "words"),
    [
        ("Pr[<=9.5](<> Temp > 30)", "whole seconds"),
        ("Pr[<=100](<> Temp >", "query"),
        ("Pr[<=100](<> nowhere)", "nowhere"),
        ("Pr[<=100](<> p_1.nothing == 1)", "does not have"),
        ("E[<=100; 10](final: m_1.taken)", "final"),
    ],
)
def test_a_query_that_uppaal_would_refuse_is_refused_with_its_reason(query: str, words: str) -> None:
    with pytest.raises(ValueError, match=re.escape(words)):
        export(two_locations("exponential"), replayed(), formulas=[query])


def test_queries_asked_for_are_translated_and_go_where_uppaal_can_answer_them() -> None:
    found = export(
        two_locations("exponential"),
        replayed(),
        formulas=["simulate 5 [<=60] {Temp}", "Pr[≤60](◇ warm ∧ Temp > 30)", "E<> warm", "E[<=60; 9](max: p_1.next_i)"],
    )
    main = [question.formula for question in found.main.questions if question.comment == "asked for"]
    assert main == [
        "simulate [<=60; 5] {m_1.Temp}",
        "Pr[<=60](<> m_1.warm && m_1.Temp > 30.0)",
        "E[<=60; 9](max: p_1.next_i)",
    ]
    assert [question.formula for question in found.minimal.questions][1:] == ["E<> m_1.warm"]


@pytest.mark.parametrize(("value", "text"), [(1, "1.0"), (-0.0, "0.0"), (1e-7, "1e-07"), (2.5e300, "2.5e+300")])
def test_a_double_is_never_written_as_an_integer(value: float, text: str) -> None:
    assert number(value) == text and float(text) == value
    with pytest.raises(ValueError, match="no literal"):
        number(inf)


def test_free_text_cannot_end_a_comment_or_a_line() -> None:
    assert comment_text("a\nb\t*/ è") == "a b * / \\xe8"
