"""What is printed is read back as what it was."""

from dataclasses import replace
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from sim.lab.checking.language.parse import parse_query
from sim.lab.checking.language.printing import query_text
from sim.lab.checking.query import tree as q
from tests.checking.test_parse import PLANT

NUMBERS = st.floats(-1e6, 1e6).filter(lambda value: value != 0.0).map(q.Number) | st.integers(1, 9).map(
    lambda value: q.Number(float(value))
)
LEAVES = NUMBERS | st.sampled_from([q.Quantity("temperature"), q.Quantity("time"), q.Quantity("age")])
EXPRESSIONS = st.recursive(
    LEAVES, lambda part: st.builds(q.Operation, st.sampled_from("+-*/"), part, part), max_leaves=6
)
PLACES = st.sampled_from([location.name for location in PLANT.locations]).map(q.At) | st.booleans().map(q.Constant)


def formulas(leaves: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    return st.recursive(
        leaves,
        lambda part: st.builds(q.Not, part) | st.builds(q.Both, part, part) | st.builds(q.Either, part, part),
        max_leaves=8,
    )


COMPARES = st.builds(q.Compare, st.sampled_from(["<", "<=", "==", "!=", ">=", ">"]), EXPRESSIONS, EXPRESSIONS)
CHANGING, LASTING = formulas(COMPARES | PLACES), formulas(PLACES | st.just(q.Deadlock()))
COURSES = st.recursive(
    LEAVES | st.builds(q.Indicator, CHANGING),
    lambda part: st.builds(q.Operation, st.sampled_from("+-*/"), part, part),
    max_leaves=4,
)
BOUNDS = st.integers(1, 10**6).map(float) | st.floats(0.001, 1e9)
RUNS = st.integers(1, 10**9)


@st.composite
def spans(draw: st.DrawFn, bound: float, due: bool) -> q.TimeSpan:
    if not due and draw(st.booleans()):
        return q.TimeSpan()
    high = draw(st.just(bound) | st.floats(0.0, bound))
    return q.TimeSpan(draw(st.just(0.0) | st.floats(0.0, high)), high)


@st.composite
def probabilities(draw: st.DrawFn) -> q.Probability:
    bound = draw(BOUNDS)
    kind = draw(st.sampled_from([q.Eventually, q.Always, q.Until, q.BoundedResponse]))
    parts = [draw(CHANGING) for _ in range(1 if kind in (q.Eventually, q.Always) else 2)]
    path = kind(*parts, draw(spans(bound, kind is q.BoundedResponse)))
    if isinstance(path, q.BoundedResponse) and draw(st.booleans()):
        path = replace(path, weak=True)
    return q.Probability(bound, path, draw(st.none() | RUNS))


QUERIES = (
    probabilities()
    | st.builds(q.Hypothesis, probabilities(), st.sampled_from([">=", "<="]), st.floats(0.0, 1.0))
    | st.builds(q.PairedComparison, probabilities(), probabilities())
    | st.builds(q.Expectation, BOUNDS, RUNS, st.sampled_from(["max", "min"]), EXPRESSIONS)
    | st.builds(q.Simulation, BOUNDS, RUNS, st.lists(COURSES, min_size=1, max_size=3).map(tuple), st.just(()))
    | st.builds(q.Symbolic, st.sampled_from(["E<>", "E[]", "A<>", "A[]"]), LASTING)
    | st.builds(q.Symbolic, st.just("-->"), LASTING, LASTING)
)


@settings(max_examples=150, deadline=None)
@given(QUERIES)
def test_the_printed_query_is_the_query(query: q.Query) -> None:
    assert parse_query(query_text(query, PLANT), PLANT) == query
