"""The query language: what is read, as what, and the sentence about what is not."""

import re
from pathlib import Path

import pytest

from sim.lab.checking.language.parse import QueryError, parse_query
from sim.lab.checking.language.printing import query_text, uppaal_refusal
from sim.lab.checking.query import tree as q
from sim.lab.checking.query.names import RESERVED_WORDS, identifiers
from sim.sha.automaton import SHA, Flow, Location
from sim.sha.events import DECANTER
from sim.sha.model import Model

PAGE = (Path(__file__).parents[2] / "docs" / "checking.md").read_text(encoding="utf-8")
DOCS = PAGE.partition("\n## Queries\n")[2].partition("\n## ")[0]
PLANT = SHA(
    "plant",
    tuple(
        Location(name, Flow("constant"), None, "none")
        for name in ("OFF", "ON/0-100", "ON/100-200", "ON/200-300", "ON/300+")
    ),
    (),
    "OFF",
)
MODEL = Model(PLANT, DECANTER, "TCuscinettiRiduttore", 0.1)
TEMP, TIME, AGE = q.Quantity("temperature"), q.Quantity("time"), q.Quantity("age")
OFF, HIGH = q.At("OFF"), q.At("ON/300+")


def over(limit: float) -> q.Compare:
    return q.Compare(">", TEMP, q.Number(limit))


def asked(formula: str) -> q.Formula:
    """The condition as it is read inside a statistical query."""
    query = parse_query(f"Pr[<=60](<> {formula})", MODEL)
    assert isinstance(query, q.Probability)
    assert isinstance(query.path, q.Eventually)
    return query.path.inner


def refused(text: str) -> str:
    with pytest.raises(QueryError) as error:
        parse_query(text, MODEL)
    return str(error.value)


@pytest.mark.parametrize(
    ("text", "query"),
    [
        ("Pr[<=444](<> Temp > 80)", q.Probability(444.0, q.Eventually(over(80.0), q.TimeSpan()))),
        ("Pr [ <= 444 ; 10 ] ( [ ] OFF )", q.Probability(444.0, q.Always(OFF, q.TimeSpan()), 10)),
        ("Pr[<=60](<>[10, 20.5] OFF)", q.Probability(60.0, q.Eventually(OFF, q.TimeSpan(10.0, 20.5)))),
        ("Pr[<=60]([][0,60] OFF)", q.Probability(60.0, q.Always(OFF, q.TimeSpan(0.0, 60.0)))),
        ("Pr[<=60](OFF U ON_300_plus)", q.Probability(60.0, q.Until(OFF, HIGH, q.TimeSpan()))),
        ("Pr[<=60](OFF U[5,6] ON_300_plus)", q.Probability(60.0, q.Until(OFF, HIGH, q.TimeSpan(5.0, 6.0)))),
        ("Pr(OFF U[5,6] ON_300_plus)", q.Probability(6.0, q.Until(OFF, HIGH, q.TimeSpan(5.0, 6.0)))),
        (
            "Pr[<=60](OFF --> ON_300_plus within 90)",
            q.Probability(60.0, q.BoundedResponse(OFF, HIGH, q.TimeSpan(0.0, 90.0))),
        ),
        (
            "Pr[<=60](OFF --> ON_300_plus within 9 weak)",
            q.Probability(60.0, q.BoundedResponse(OFF, HIGH, q.TimeSpan(0.0, 9.0), weak=True)),
        ),
        (
            "Pr[<=60](OFF -->[1,9] ON_300_plus weak)",
            q.Probability(60.0, q.BoundedResponse(OFF, HIGH, q.TimeSpan(1.0, 9.0), weak=True)),
        ),
        ("Pr[<=60](OFF -->[1,9] ON_300_plus)", q.Probability(60.0, q.BoundedResponse(OFF, HIGH, q.TimeSpan(1.0, 9.0)))),
        (
            "Pr[<=60](OFF --> ON_300_plus within 9)",
            q.Probability(60.0, q.BoundedResponse(OFF, HIGH, q.TimeSpan(0.0, 9.0))),
        ),
        ("Pr[<=60](<> OFF) >= 1", q.Hypothesis(q.Probability(60.0, q.Eventually(OFF, q.TimeSpan())), ">=", 1.0)),
        ("Pr[<=60](<> OFF) ≤ 1e-3", q.Hypothesis(q.Probability(60.0, q.Eventually(OFF, q.TimeSpan())), "<=", 0.001)),
        ("E[<=444; 7](max: Temp)", q.Expectation(444.0, 7, "max", TEMP)),
        ("E[<=444; 7](min: time - age)", q.Expectation(444.0, 7, "min", q.Operation("-", TIME, AGE))),
        ("E<> deadlock", q.Symbolic("E<>", q.Deadlock())),
        ("E [] OFF", q.Symbolic("E[]", OFF)),
        ("A<> OFF", q.Symbolic("A<>", OFF)),
        ("A[] not false // always", q.Symbolic("A[]", q.Not(q.Constant(False)))),
        ("OFF --> ON_300_plus", q.Symbolic("-->", OFF, HIGH)),
    ],
)
def test_each_form_is_read_as_what_it_means(text: str, query: q.Query) -> None:
    assert parse_query(text, MODEL) == query


def test_a_comparison_puts_first_what_is_asked_to_be_greater() -> None:
    first, second = "Pr[<=9](<> OFF)", "Pr[<=60]([] OFF)"
    assert parse_query(f"{first} >= {second}", MODEL) == parse_query(f"{second} <= {first}", MODEL)
    read = parse_query(f"{first} >= {second}", MODEL)
    assert isinstance(read, q.PairedComparison)
    assert (read.left.bound, read.right.bound) == (9.0, 60.0)


def test_both_forms_of_simulate_are_one_and_keep_what_was_written() -> None:
    new = parse_query("simulate [<=444; 10] { m_1.Temp , 2*(Temp+1) }", MODEL)
    old = parse_query("simulate 10 [<=444] {Temp, (Temp + 1) * 2}", MODEL)
    assert isinstance(new, q.Simulation)
    assert isinstance(old, q.Simulation)
    assert (new.bound, new.runs, new.expressions[0]) == (old.bound, old.runs, old.expressions[0]) == (444.0, 10, TEMP)
    assert new.labels == ("m_1.Temp", "2*(Temp+1)")
    assert old.labels == ("Temp", "(Temp + 1) * 2")


@pytest.mark.parametrize("name", ["Temp", "m_1.Temp", "TCuscinettiRiduttore"])
def test_the_temperature_has_three_names(name: str) -> None:
    assert asked(f"{name} > 80") == over(80.0)


def test_an_automaton_alone_is_given_its_temperatures_name() -> None:
    assert parse_query("simulate [<=4] {Coolant}", PLANT, "Coolant") == parse_query("simulate [<=4] {Temp}", MODEL)


@pytest.mark.parametrize("name", ["ON_300_plus", "m_1.ON_300_plus", 'at "ON/300+"', "at 'ON/300+'"])
def test_a_location_is_named_by_its_identifier_or_in_its_own_words(name: str) -> None:
    assert asked(name) == HIGH


def test_a_location_called_like_a_keyword_is_reached_by_its_identifier() -> None:
    names = ("U", "Temp", "at", "within", "Pressure", "E_1")
    odd = SHA("odd", tuple(Location(name, Flow("constant"), None, "none") for name in names), (), "U")
    text = "E<> U_2 or Temp_2 or at or within or Pressure or E_1"
    read = parse_query(text, odd)
    assert [name for name in names if f"location='{name}'" in repr(read)] == list(names)


def test_every_location_is_reached_by_its_identifier_whatever_it_is_called() -> None:
    names = [*sorted(RESERVED_WORDS), "q 0", "200", "a.b", "at", "within", "", "è", "x" * 70, 'say "at"']
    odd = SHA("odd", tuple(Location(name, Flow("constant"), None, "none") for name in names), (), "U")
    for name, identifier in identifiers(names).items():
        assert parse_query(f"E<> m_1.{identifier}", odd) == q.Symbolic("E<>", q.At(name))
        assert parse_query(f"{identifier} --> false", odd) == q.Symbolic("-->", q.At(name), q.Constant(False))


@pytest.mark.parametrize(
    ("text", "same"),
    [
        ("OFF and ON_300_plus or OFF", "(OFF && ON_300_plus) || OFF"),
        ("OFF || ON_300_plus && OFF", "OFF || (ON_300_plus && OFF)"),
        ("OFF or OFF imply ON_300_plus", "!(OFF || OFF) || ON_300_plus"),
        ("OFF imply ON_300_plus or OFF", "(!OFF || ON_300_plus) || OFF"),
        ("!OFF and not OFF", "(!OFF) && (¬OFF)"),
        ("Temp + 2 * age > 80 - 1 - 2", "(Temp + (2 * age)) > ((80 - 1) - 2)"),
        ("Temp / 2 / 5 * 3 == 1", "((Temp / 2) / 5) * 3 == 1"),
        ("-Temp < - 3", "0 - Temp < -3"),
        ("+Temp ≥ 3 ∧ Temp ≠ .5 ∨ OFF", "Temp >= 3 && Temp != 0.5 || OFF"),
        ("Temp − 3 > 0 /* minus as typed by an editor */", "Temp - 3 > 0"),
    ],
)
def test_operators_bind_as_in_uppaals_parser(text: str, same: str) -> None:
    assert asked(text) == asked(same)


def examples() -> list[str]:
    rows = re.findall(r"^\| `.+ \| `([^`]+)` \|$", DOCS.partition("## Names")[0], flags=re.MULTILINE)
    blocks = re.findall(r"^```query\n(.*?)^```", DOCS, flags=re.MULTILINE | re.DOTALL)
    return rows + [line for block in blocks for line in block.splitlines()]


def test_every_example_of_the_documentation_is_read_and_printed() -> None:
    assert len(examples()) >= 25
    for text in examples():
        query = parse_query(text, MODEL)
        assert parse_query(query_text(query, MODEL), MODEL) == query


def sentences() -> list[tuple[str, str]]:
    return re.findall(r"^\| `([^`]+)` \| (.+) \|$", DOCS.partition("## Sentences")[2], flags=re.MULTILINE)


@pytest.mark.parametrize(("text", "sentence"), sentences())
def test_the_documentations_errors_are_the_programs_own(text: str, sentence: str) -> None:
    assert refused(text) == sentence


def test_there_are_documented_errors() -> None:
    assert len(sentences()) >= 15


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("", "the query is empty"),
        ("Temp > 80", "a condition alone"),
        ("hello world", "column 7: found 'world'"),
        ("sup: Temp", "sup is not asked here"),
        ("Pr[#<=5](<> OFF)", "column 4: found '#'; steps are not counted"),
        ("Pr[age<=5](<> OFF)", "column 4: found 'age'; right would be '<='"),
        ("Pr[<=1e999](<> OFF)", "a run of inf s cannot be made"),
        ("Pr[<=-5](<> OFF)", "a run of -5 s cannot be made"),
        ("Pr[<=5; 1.5](<> OFF)", "1.5 is no number of runs"),
        ("Pr[<=5; -1](<> OFF)", "-1 is no number of runs"),
        ("Pr[<=5](<> OFF) >= -0.1", "no probability"),
        ("Pr[<=5](<> OFF) > 0.5", "found '>'; right would be '<=' or '>='"),
        ("Pr[<=5](<>[4,3] OFF)", "[4,3] is no interval"),
        ("Pr[<=5](<>[-1,3] OFF)", "[-1,3] is no interval"),
        ("Pr[<=5](OFF --> OFF within 6 weak)", "beyond the run"),
        ("Pr[<=5](OFF --> OFF within 3 weakly)", "found 'weakly'; right would be 'within', 'weak' or ')'"),
        ("Pr[<=5](OFF -->[0,1] OFF within 1)", "within what time"),
        ("Pr[<=5](OFF --> OFF wihtin 1)", "found 'wihtin'"),
        ("Pr(<> OFF)", "how long is a run?"),
        ("Pr(<>[0,0] OFF)", "the interval ends at 0"),
        ("Pr[<=5](<> abs(Temp) > 1)", "no function is known here"),
        ("Pr[<=5](<> OFF) under S", "no strategy"),
        ("Pr[<=5](<> OFF == 1)", "OFF is a location and a number is needed"),
        ("Pr[<=5](<> (Temp > 1) + 1 > 2)", "a condition stands where a number is needed"),
        ("Pr[<=5](<> Temp + 1)", "a number stands where a condition is needed"),
        ("Pr[<=5](<> not Temp > 80)", "bind tighter than a comparison"),
        ("Pr[<=5](<> Temp / 0 > 80)", "a division by zero"),
        ("Pr[<=5](<> Temp > 1e999)", "beyond what a number can be"),
        ("Pr[<=5](<> Train.Cross)", "only the model's own names"),
        ("A<> p_1.next_i == N_E", "only the model's own names"),
        ('Pr[<=5](<> "OFF")', 'by at "ON/200-300"'),
        ("simulate 3 [<=5; 3] {Temp}", "the runs are given twice"),
        ("simulate [<=5; 3] {OFF == 1}", "OFF is a location and a number is needed"),
        ("E[<=5; 3](max: OFF)", "OFF is a location and a number is needed"),
        ("simulate [<=5; 3] {deadlock}", "deadlock is a matter of the automaton"),
        ("E[<=5; 3](final: Temp)", "right would be 'max' or 'min'"),
        ("age > 3 --> OFF", "age changes continuously"),
        ("A[] OFF\n and\n OFFF", "line 3, column 2: 'OFFF' is not known; did you mean OFF?"),
        (f"A[] {' or '.join(['OFF'] * 400)}", "300 is the most"),
        (f"A[] {'!' * 5000}OFF", "300 is the most"),
        ("Pr[<=9](<> A)", 'A is a word of the language; a location of that name is named by at "A"'),
        ("A[] not E", "column 9: found 'E'; E is a word of the language; a location of that name is named by at \"E\""),
        ("A --> OFF", 'a location called A is named by at "A"'),
    ],
)
def test_what_cannot_be_read_gets_one_sentence_with_its_place(text: str, part: str) -> None:
    sentence = refused(text)
    assert part in sentence
    assert "\n" not in sentence


def test_a_condition_is_a_number_in_a_simulation() -> None:
    found = parse_query("simulate [<=60; 3] {OFF, 14 + m_1.OFF, Temp > 30, !OFF || time > 5, 2 * (age < 3)}", MODEL)
    assert isinstance(found, q.Simulation)
    off, raised, hot, either, scaled = found.expressions
    assert (off, hot) == (q.Indicator(OFF), q.Indicator(over(30.0)))
    assert raised == q.Operation("+", q.Number(14.0), q.Indicator(OFF))
    assert either == q.Indicator(q.Either(q.Not(OFF), q.Compare(">", TIME, q.Number(5.0))))
    assert scaled == q.Operation("*", q.Number(2.0), q.Indicator(q.Compare("<", AGE, q.Number(3.0))))
    assert parse_query(query_text(found, MODEL), MODEL) == found


def test_a_long_query_in_deep_brackets_is_read() -> None:
    assert asked("(" * 3000 + "OFF" + ")" * 3000) == OFF
    long = asked(" or ".join(["OFF"] * 140))
    assert isinstance(long, q.Either)


@pytest.mark.parametrize(
    ("text", "printed", "refusal"),
    [
        ("simulate 10 [<=444] {Temp}", "simulate [<=444; 10] {m_1.Temp}", ""),
        ("Pr[<=444](<> Temp > 80) >= .9", "Pr[<=444](<> m_1.Temp > 80.0) >= 0.9", ""),
        ("Pr[<=444](<> Temp ≥ 80) <= 1", "Pr[<=444](<> m_1.Temp >= 80.0) <= 1.0", ""),
        ("Pr[<=60]([][5,60] at 'ON/300+')", "Pr([][5,60] m_1.ON_300_plus)", ""),
        ("Pr[<=444.5](<> OFF)", "Pr[<=444.5](<> m_1.OFF)", "whole seconds"),
        ("Pr[<=4e9](<> OFF)", "Pr[<=4000000000](<> m_1.OFF)", "whole seconds"),
        ("Pr[<=60](<>[5,50] OFF)", "Pr[<=60](<>[5,50] m_1.OFF)", "Pr(<>[10,60] phi)"),
        ("Pr[<=60](OFF --> OFF within 9)", "Pr[<=60](m_1.OFF -->[0,9] m_1.OFF)", "no bounded response"),
        ("Pr[<=60](OFF U OFF) >= 0.5", "Pr[<=60](m_1.OFF U m_1.OFF) >= 0.5", "tests and compares only"),
        ("Pr[<=6](<> OFF) >= Pr[<=60](OFF U OFF)", "Pr[<=6](<> m_1.OFF) >= Pr[<=60](m_1.OFF U m_1.OFF)", "compares"),
        ("A[] OFF imply not deadlock", "A[] !m_1.OFF || !deadlock", ""),
    ],
)
def test_a_query_is_printed_for_uppaal_and_what_uppaal_refuses_is_said(text: str, printed: str, refusal: str) -> None:
    query = parse_query(text, MODEL)
    assert query_text(query, MODEL) == printed
    assert refusal in uppaal_refusal(query)
    assert bool(refusal) == bool(uppaal_refusal(query))
