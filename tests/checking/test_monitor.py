"""Formulas in continuous time: what each operator means on runs whose course is known."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from sim.lab.checking.query.tree import (
    Always,
    At,
    Both,
    BoundedResponse,
    Compare,
    Constant,
    Deadlock,
    Either,
    Eventually,
    Expectation,
    Formula,
    Indicator,
    Not,
    Number,
    Operation,
    PairedComparison,
    Path,
    Probability,
    Simulation,
    TimeSpan,
    Until,
)
from sim.lab.checking.smc.answers import QuerySettings, answer, prepare_question
from sim.lab.checking.smc.monitors.formula import compile_formulas
from sim.lab.checking.smc.runs import sampler
from sim.lab.checking.smc.start import initial
from sim.sha.automaton import Distribution
from tests.checking.worlds import AGE, TEMP, TIME, along, compare, eventually, flow, model, normal

RISING = model([flow("linear", 0.0), flow("linear", 0.0)], [normal(0.1), normal(-0.1)])
"""Up by 0.1 degC/s in q_0, down in q_1, without noise."""

WHOLE = TimeSpan(0.0, 100.0)


def holds(path: Path, events: Sequence[float] = (50.0,), bound: float = 100.0) -> bool:
    """Whether the path holds on the course 20 + 0.1 t, which turns at each event."""
    start = along(RISING, 20.0, bound, events)
    drawn = sampler(start.world, (prepare_question(Probability(bound, path), start),), 0)
    verdicts = drawn.draw(192)
    assert verdicts.all() == verdicts.any()
    return bool(verdicts.all())


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        (Eventually(compare(">=", 24.99), WHOLE), True),
        (Eventually(compare(">", 25.01), WHOLE), False),
        (Eventually(compare(">=", 24.0), TimeSpan(0.0, 39.0)), False),
        (Eventually(compare(">=", 24.0), TimeSpan(39.0, 41.0)), True),
        (Eventually(compare("<=", 21.0), TimeSpan(11.0, 100.0)), True),
        (Eventually(compare("==", 23.456), WHOLE), True),
        (Eventually(Both(compare(">=", 22.0), compare("<=", 22.001)), TimeSpan(0.0, 30.0)), True),
        (Always(compare("<=", 25.01), WHOLE), True),
        (Always(compare("<=", 24.99), WHOLE), False),
        (Always(Either(compare("<=", 23.0), compare(">=", 23.0)), WHOLE), True),
        (Always(Either(compare("<", 23.0), compare(">", 23.0)), WHOLE), False),
        (Eventually(Both(compare(">=", 60.0), compare("<=", 20.0)), WHOLE), False),
        (Always(Constant(True), WHOLE), True),
        (Eventually(Not(Constant(True)), WHOLE), False),
    ],
)
def test_temperatures_are_met_in_continuous_time(path: Path, expected: bool) -> None:
    assert holds(path) is expected


@pytest.mark.parametrize(
    ("inner", "expected"),
    [
        (Both(compare("==", 30.0, TIME), compare(">=", 22.999)), True),
        (Both(compare("==", 30.0, TIME), compare(">=", 23.001)), False),
        (Both(compare("==", 100.0, TIME), compare("<=", 20.001)), True),
        (Both(At("q_1"), compare(">=", 50.0, AGE)), True),
        (Both(At("q_1"), compare(">", 50.001, AGE)), False),
        (Both(At("q_0"), compare(">", 50.001, TIME)), False),
        (Both(At("q_1"), Both(compare("==", 10.0, AGE), compare(">=", 23.999))), True),
        (Compare(">=", Operation("-", TEMP, Operation("*", Number(0.1), TIME)), Number(20.001)), False),
        (Compare("<=", Operation("+", TEMP, Operation("*", Number(0.1), TIME)), Number(19.999)), False),
        (Compare(">=", TEMP, Operation("+", Number(22.0), Operation("*", Number(0.05), TIME))), True),
        (Compare(">=", Operation("*", Number(-2.0), TEMP), Number(-39.999)), False),
        (Compare(">", Operation("*", TIME, TIME), Number(9990.0)), True),
    ],
)
def test_clocks_and_moving_lines(inner: Formula, expected: bool) -> None:
    assert holds(Eventually(inner, WHOLE)) is expected


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        (Until(compare("<=", 24.0), compare(">=", 23.0), WHOLE), True),
        (Until(compare("<=", 22.0), compare(">=", 23.0), WHOLE), False),
        (Until(compare("<", 23.0), compare(">=", 23.0), WHOLE), True),
        (Until(At("q_0"), compare(">=", 24.9), WHOLE), True),
        (Until(At("q_0"), At("q_1"), WHOLE), True),
        (Until(At("q_0"), At("q_1"), TimeSpan(0.0, 49.0)), False),
        (Until(At("q_0"), compare("<=", 20.5), TimeSpan(60.0, 100.0)), False),
        (Until(Constant(True), compare("<=", 20.5), TimeSpan(60.0, 100.0)), True),
    ],
)
def test_until_needs_the_condition_up_to_the_goal(path: Path, expected: bool) -> None:
    assert holds(path) is expected


@pytest.mark.parametrize(
    ("cause", "effect", "low", "high", "expected"),
    [
        (At("q_1"), compare("<=", 22.5), 0.0, 30.0, True),
        (At("q_1"), compare("<=", 22.5), 0.0, 20.0, False),
        (compare(">=", 24.0), compare("<=", 22.0), 0.0, 50.0, True),
        (compare(">=", 24.0), compare("<=", 22.0), 0.0, 30.0, False),
        (compare(">=", 30.0), compare("<=", 0.0), 0.0, 1.0, True),
        (At("q_0"), At("q_1"), 0.0, 50.0, True),
        (At("q_0"), At("q_1"), 0.0, 45.0, False),
        (At("q_0"), compare(">=", 23.0), 10.0, 40.0, True),
        (At("q_0"), compare(">=", 24.5), 0.0, 20.0, False),
    ],
)
def test_every_cause_is_answered_in_time(
    cause: Formula, effect: Formula, low: float, high: float, expected: bool
) -> None:
    assert holds(BoundedResponse(cause, effect, TimeSpan(low, high))) is expected


@pytest.mark.parametrize(
    ("cause", "effect", "low", "high", "expected"),
    [
        # q_0 is over when q_1 begins, at one and the same instant.
        (At("q_1"), At("q_0"), 0.0, 3.0, False),
        (At("q_0"), At("q_1"), 0.0, 49.0, False),
        (compare("==", 50.0, TIME), At("q_0"), 0.0, 3.0, False),
        (compare("<=", 10.0, TIME), At("q_0"), 10.0, 39.0, True),
        # The first instant of a long cause is answered, the later ones are not.
        (At("q_0"), Both(At("q_0"), compare("<=", 5.0, AGE)), 0.0, 10.0, False),
        (At("q_0"), Both(compare(">=", 20.0, TIME), compare("<=", 21.0, TIME)), 10.0, 20.0, False),
        (compare("<=", 1.0, TIME), Both(compare(">=", 20.0, TIME), compare("<=", 21.0, TIME)), 19.0, 20.0, True),
        (compare("<=", 1.1, TIME), Both(compare(">=", 20.0, TIME), compare("<=", 21.0, TIME)), 19.0, 20.0, True),
        (compare("<=", 2.1, TIME), Both(compare(">=", 20.0, TIME), compare("<=", 21.0, TIME)), 19.0, 20.0, False),
        # Ends that belong, and ends that do not.
        (compare("<=", 5.0, TIME), compare(">=", 25.0, TIME), 0.0, 25.0, True),
        (compare("<=", 5.0, TIME), compare(">", 25.0, TIME), 0.0, 25.0, False),
        (Both(compare(">", 4.0, TIME), compare("<=", 5.0, TIME)), compare(">", 25.0, TIME), 0.0, 21.0, True),
        # A crossing is taken from the straight line between the ends of its step.
        (compare(">=", 22.0), At("q_1"), 0.0, 29.99, False),
        (compare(">=", 22.0), At("q_1"), 0.0, 30.01, True),
    ],
)
def test_an_effect_that_is_over_answers_nothing(
    cause: Formula, effect: Formula, low: float, high: float, expected: bool
) -> None:
    assert holds(BoundedResponse(cause, effect, TimeSpan(low, high))) is expected


def test_every_cause_up_to_the_bound_is_judged_unless_the_weak_view_is_asked_for() -> None:
    """q_1 comes at 50 s; the temperature is back at 20 degC at 100 s and at 18 degC at 120 s."""
    late, cold = compare(">=", 98.0, TIME), compare("<=", 18.0)
    assert holds(BoundedResponse(late, cold, TimeSpan(0.0, 22.01)))
    assert not holds(BoundedResponse(late, cold, TimeSpan(0.0, 21.99)))
    assert holds(BoundedResponse(late, compare(">=", 99.0), TimeSpan(0.0, 30.0), weak=True))


@pytest.mark.parametrize(
    ("events", "cause", "left_out"),
    [((50.0,), At("q_1"), 1), ((80.0, 85.0, 95.0), At("q_1"), 2), ((50.0, 65.0), At("q_1"), 0), ((), At("q_0"), 1)],
)
def test_the_causes_that_the_weak_view_leaves_out_are_counted(
    events: Sequence[float], cause: Formula, left_out: int
) -> None:
    start = along(RISING, 20.0, 100.0, events)
    path = BoundedResponse(cause, Constant(True), TimeSpan(0.0, 30.0), weak=True)
    found = answer(Probability(100.0, path), start, QuerySettings(runs=7))
    assert found.numbers["probability"] == 1.0 and found.numbers["causes left out"] == 7 * left_out
    assert any(f"{7 * left_out} causes later than 70 s" in note for note in found.notes)
    strict = answer(Probability(100.0, replace(path, weak=False)), start, QuerySettings(runs=7))
    assert "causes left out" not in strict.numbers and any("followed to 130 s" in note for note in strict.notes)


def test_a_response_that_is_due_too_late_is_refused() -> None:
    start = along(RISING, 20.0, 100.0)
    path = BoundedResponse(At("q_0"), At("q_1"), TimeSpan(0.0, 1e12))
    with pytest.raises(ValueError, match="due after 1e\\+12 s"):
        answer(Probability(100.0, path), start)


def test_each_side_of_a_comparison_ends_at_its_own_bound() -> None:
    """q_1 comes at 50 s and lasts: by 60 s it has come."""
    start = along(RISING, 20.0, 444.0, (50.0,))
    path = Eventually(At("q_1"), TimeSpan())
    both = PairedComparison(Probability(60.0, path), Probability(444.0, path))
    found = answer(both, start, QuerySettings(runs=100))
    assert found.numbers["left"] == found.numbers["right"] == 1.0


@pytest.mark.parametrize(("deadline", "expected"), [(26.0, False), (34.0, True)])
def test_the_moment_of_a_crossing_is_known_to_within_a_step_of_4_s(deadline: float, expected: bool) -> None:
    """22 degC at 20 s, q_1 at 50 s: 30 s between them."""
    assert holds(BoundedResponse(compare(">=", 22.0), At("q_1"), TimeSpan(0.0, deadline))) is expected


def test_bent_conditions_on_clocks_are_seen_to_within_a_step_of_4_s() -> None:
    square = Operation("*", TIME, TIME)
    for low, high, expected in ((4000.0, 5000.0, True), (6410.0, 6500.0, None), (10_500.0, 11_000.0, False)):
        inner = Both(Compare(">=", square, Number(low)), Compare("<=", square, Number(high)))
        if expected is not None:  # 80.1 to 80.6 s lies within one step: it may be missed
            assert holds(Eventually(inner, WHOLE)) is expected
    start = along(RISING, 20.0, 100.0, (50.0,))
    found = answer(eventually(Compare(">=", square, Number(6400.0)), 100.0), start, QuerySettings(runs=100))
    assert any("at most 4 s" in note for note in found.notes)
    arch = Operation("*", TIME, Operation("-", Number(100.0), TIME))
    top = answer(Expectation(100.0, 10, "max", arch), start, QuerySettings())
    assert top.numbers["mean"] == pytest.approx(2500.0, abs=5.0) and any("not linear" in note for note in top.notes)


def test_until_is_low_by_what_it_says_it_left_undecided() -> None:
    """X is W: up before down is an even chance (optional stopping). With the lines 1.5 steps' sigmas off both are
    reached in one step now and then: such runs count as not reached, and are counted."""
    start = along(model([flow("constant", 0.1)], [None]), 40.0, 400.0)
    for distance, most in ((0.3, 0.002), (0.6, 0.0001)):
        inside = Both(compare(">", 40.0 - distance), compare("<", 40.0 + distance))
        path = Until(inside, compare(">=", 40.0 + distance), TimeSpan(0.0, 400.0))
        query = Probability(400.0, path)
        drawn = sampler(start.world, (prepare_question(query, start),), 5)
        share = float(drawn.draw(40_000).mean())
        torn = drawn.unclear / 40_000
        assert share <= 0.5 + 0.008 and 0.5 - share <= torn + 0.008 <= most + 0.008


def test_the_noise_of_a_step_at_the_maximum_rate_is_low_by_less_than_3_percent() -> None:
    """Far below its target the flow rises at the rate; what noise has moved stays: sigma sqrt(T), no relaxation."""
    made = model([flow("exponential", 0.1, k=0.05)], [normal(400.0)], max_rate=0.1)
    start = along(made, 20.0, 300.0)
    query = Expectation(300.0, 20_000, "max", Operation("-", TEMP, Operation("*", Number(0.1), TIME)))
    found = answer(query, start, QuerySettings(seed=1))
    exact = 20.0 + 0.1 * np.sqrt(2.0 * 300.0 / np.pi)
    assert 0.97 < (found.numbers["mean"] - 20.0) / (exact - 20.0) < 1.0
    assert any("maximum rate" in note for note in found.notes)


def test_conditions_are_0_and_1_in_courses() -> None:
    start = along(RISING, 20.0, 100.0, (50.0,))
    hot, there = Indicator(compare(">=", 24.0)), Indicator(At("q_1"))
    scaled = Operation("+", Number(5.0), Operation("*", Number(2.0), Indicator(Not(Both(At("q_0"), Constant(True))))))
    query = Simulation(100.0, 3, (hot, there, scaled), ("hot", "there", "scaled"))
    for course in answer(query, start, QuerySettings()).courses:
        times, (warm, place, other) = course.times, course.values
        assert set(warm) == {0.0, 1.0} == set(place)
        assert np.all(warm[times < 36.0] == 0.0) and np.all(warm[(times > 44.0) & (times < 56.0)] == 1.0)
        assert np.all(place[times < 50.0] == 0.0) and np.all(place[times > 50.0] == 1.0)
        assert np.array_equal(other, 5.0 + 2.0 * place)
        assert sorted(place[times == 50.0]) == [0.0, 1.0]


def test_a_stay_of_no_length_is_visited() -> None:
    assert holds(Eventually(At("q_1"), WHOLE), events=(50.0, 50.0))


def test_wrong_formulas_are_refused_with_the_reason() -> None:
    square = Compare(">=", Operation("*", TEMP, TEMP), Number(900.0))
    for formula, words in ((square, "linear in the temperature"), (At("q_9"), "no location 'q_9'")):
        with pytest.raises(ValueError, match=words):
            compile_formulas((formula,), ("q_0",))
    with pytest.raises(ValueError, match="symbolic"):
        compile_formulas((Not(Deadlock()),), ("q_0",))


def test_a_drawn_stay_ends_at_its_own_time_and_clock_conditions_are_seen_there() -> None:
    """Exponential stays of 50 s: the age reaches 100 s within 400 s or not; every run's own clock counts."""
    law = Distribution("exponential", {"mean": 50.0})
    made = model([flow("constant"), flow("constant")], [None, None], first=normal(20.0), stay=law)
    first = answer(
        eventually(Both(At("q_0"), compare(">=", 100.0, AGE)), 101.0),
        initial(made),
        QuerySettings(rule="fixed", runs=40_000),
    )
    assert first.numbers["low"] <= np.exp(-2.0) <= first.numbers["high"]


def test_two_lines_on_both_sides_are_right_to_within_a_stated_error() -> None:
    """P(W stays within +-1 for T = 1) = 0.3708 (Feller's series); rise and fall in one step are drawn apart.

    In one step for all of T the error shows; in steps of 4 s, as Until has them, it is within the interval.
    """
    exact = sum(
        4.0 / np.pi * (-1.0) ** k / (2 * k + 1) * np.exp(-((2 * k + 1) ** 2) * np.pi**2 / 8.0) for k in range(20)
    )
    band = Both(compare("<=", 30.0), compare(">=", 10.0))
    start = along(model([flow("constant", 1.0)], [None]), 20.0, 100.0)
    coarse = answer(Probability(100.0, Always(band, WHOLE)), start, QuerySettings(rule="fixed", runs=100_000))
    inside = Until(band, compare("==", 100.0, TIME), WHOLE)
    fine = answer(Probability(100.0, inside), start, QuerySettings(rule="fixed", runs=100_000))
    assert abs(coarse.numbers["probability"] - exact) < 0.03
    assert fine.numbers["low"] <= exact <= fine.numbers["high"]
    assert any("independent" in note for note in coarse.notes)


def test_clamps_rate_limits_and_resampled_entries_are_followed_and_counted() -> None:
    hot = model([flow("linear", 0.1)], [normal(1.0)], high=30.0)
    found = answer(eventually(compare(">=", 29.9), 100.0), along(hot, 20.0, 100.0), QuerySettings(runs=100))
    assert found.numbers["probability"] == 1.0 and any("range" in note for note in found.notes)
    slow = model([flow("exponential", 0.0, k=0.1)], [normal(100.0)], max_rate=0.1)
    found = answer(Expectation(100.0, 10, "max", TEMP), along(slow, 20.0, 100.0), QuerySettings())
    assert found.numbers["mean"] == pytest.approx(30.0)
    assert any("maximum rate" in note for note in found.notes)
    fresh = model([flow("constant", 0.0)] * 2, [normal(40.0), normal(70.0)], entry="resample")
    found = answer(eventually(compare(">=", 69.0), 100.0), along(fresh, 20.0, 100.0, (50.0,)), QuerySettings(runs=100))
    assert found.numbers["probability"] == 1.0
