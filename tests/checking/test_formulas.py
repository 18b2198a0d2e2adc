"""Every temporal form against what owes nothing to the product: matrix exponentials, and a literal evaluator."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from sim.lab.checking.language.parse import parse_query
from sim.lab.checking.language.printing import query_text
from sim.lab.checking.query.tree import At, Constant, Formula, Not, Probability
from sim.lab.checking.smc.answers import QuerySettings, answer, prepare_question
from sim.lab.checking.smc.runs import sampler
from sim.lab.checking.smc.start import initial
from tests.rig.chain import until
from tests.rig.formulas import (
    CHAIN,
    SLOPES,
    START,
    Reference,
    random_path,
    references,
    small_model,
    traced_course,
)
from tests.rig.literal import apart, drawn_course, holds, needed

MODEL = small_model()
BOUND = 40.0


@pytest.mark.parametrize("reference", references(), ids=lambda reference: reference.text)
def test_the_answer_is_that_of_the_matrix_exponential(reference: Reference) -> None:
    """Within 4 standard errors: among 39 right answers one beyond comes once in 400 times, and seeds are fixed."""
    runs = 1000
    found = answer(reference.query(MODEL), initial(MODEL), QuerySettings(rule="fixed", runs=runs, seed=1))
    error = np.sqrt(reference.exact * (1.0 - reference.exact) / runs)
    assert abs(found.numbers["probability"] - reference.exact) < 4.0 * error


def test_100_random_formulas_are_decided_as_the_literal_evaluator_decides_them() -> None:
    """On courses along traces, whose events, intervals and clocks meet at multiples of 5 s: every tie counts."""
    rng, wrong, true = np.random.default_rng(7), [], 0
    for _ in range(100):
        path = random_path(rng, BOUND, whole=True)
        trace, course = traced_course(rng, BOUND, needed(path, BOUND))
        start = initial(MODEL, trace)
        query = Probability(BOUND, path)
        verdict = bool(sampler(start.world, (prepare_question(query, start),), 0).draw(1)[0, 0])
        expected = holds(path, course, Fraction(BOUND))
        true += expected
        if verdict != expected:
            wrong.append((query_text(query, MODEL), course))
    assert wrong == [] and 30 < true < 70


def test_random_formulas_are_as_probable_as_on_runs_drawn_apart() -> None:
    rng, own, theirs = np.random.default_rng(11), 1000, 80
    for _ in range(8):
        path = random_path(rng, BOUND, whole=False)
        query = Probability(BOUND, path)
        found = answer(query, initial(MODEL), QuerySettings(rule="fixed", runs=own, seed=2)).numbers["probability"]
        courses = (drawn_course(CHAIN, SLOPES, START, needed(path, BOUND), rng) for _ in range(theirs))
        share = float(np.mean([holds(path, course, Fraction(BOUND)) for course in courses]))
        assert apart(found, own, share, theirs) < 4.0, query_text(query, MODEL)


Q_0, Q_1 = At("q_0"), At("q_1")
COMES = until(CHAIN, Constant(True), Q_1, 0.0, 60.0)


@pytest.mark.parametrize(
    ("text", "exact"),
    [
        # Between 5 s and any later instant there is one at which `time <= 5` is over.
        ("Pr[<=60](time <= 5 U time > 5)", 0.0),
        ("Pr[<=60](time <= 5 U time >= 5)", 1.0),
        ("Pr[<=60](q_0 U q_1 && age > 0)", 0.0),
        ("Pr[<=60](q_0 U q_1 && age >= 0)", until(CHAIN, Q_0, Q_1, 0.0, 60.0)),
        # The first instant of a stay is one.
        ("Pr[<=60](<> q_1 && age <= 0)", COMES),
        ("Pr[<=60]([] q_1 imply age > 0)", 1.0 - COMES),
    ],
)
def test_single_instants_count(text: str, exact: float) -> None:
    found = answer(Reference(text, exact).query(MODEL), initial(MODEL), QuerySettings(rule="fixed", runs=3000))
    assert abs(found.numbers["probability"] - exact) <= 4.0 * np.sqrt(exact * (1.0 - exact) / 3000)


def test_the_two_references_agree_with_one_another() -> None:
    rng, query = np.random.default_rng(3), parse_query("Pr[<=60](!q_2 U[20,50] q_3)", MODEL)
    assert isinstance(query, Probability)
    share = np.mean(
        [holds(query.path, drawn_course(CHAIN, SLOPES, START, 60.0, rng), Fraction(60)) for _ in range(2000)]
    )
    exact = until(CHAIN, Not(At("q_2")), At("q_3"), 20.0, 50.0)
    assert abs(share - exact) < 4.0 * np.sqrt(exact * (1.0 - exact) / 2000)


@pytest.mark.parametrize(
    ("text", "hold", "goal", "low", "high"),
    [
        ('F<=60 "q_3"', Constant(True), At("q_3"), 0.0, 60.0),
        ('F[30,40] "q_3"', Constant(True), At("q_3"), 30.0, 40.0),
        ('!"q_2" U[20,50] "q_3"', Not(At("q_2")), At("q_3"), 20.0, 50.0),
    ],
)
def test_storm_has_the_same_probabilities(
    text: str, hold: Formula, goal: Formula, low: float, high: float, tmp_path: Path
) -> None:
    stormpy = pytest.importorskip("stormpy", reason="the extra `bench` is not installed")
    file = tmp_path / "chain.sm"
    file.write_text(CHAIN.prism(), encoding="utf-8")
    program = stormpy.parse_prism_program(str(file))
    formulas = stormpy.parse_properties(f"P=? [ {text} ]", program)
    model = stormpy.build_model(program, formulas)
    found = stormpy.model_checking(model, formulas[0]).get_value(model.initial_states[0])
    assert found == pytest.approx(until(CHAIN, hold, goal, low, high), abs=1e-9)
