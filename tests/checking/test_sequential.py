"""How many runs are enough: known answers, exact coverage, error rates, and rules that no batch size changes."""

from collections.abc import Callable
from math import log

import numpy as np
import pytest
from numpy.typing import NDArray

from sim.lab.checking.smc.rules.estimation import (
    RuleOutcome,
    anytime,
    fixed_run_estimate,
    mixture_interval,
    to_half_width,
    uppaal_interval,
)
from sim.lab.checking.smc.rules.sprt import RatioTest, acceptance, expected_runs, sprt, wald_test
from sim.scores import clopper_pearson
from sim.sha.trace import Array

Interval = Callable[[Array, NDArray[np.int_], float], tuple[Array, Array]]


def coin(p: float, seed: int) -> Callable[[int], Array]:
    rng = np.random.default_rng(seed)
    return lambda runs: (rng.random(runs) < p).astype(float)


def given(outcomes: Array) -> Callable[[int], Array]:
    """Draws of recorded outcomes, in their order."""
    rest = iter(outcomes)
    return lambda runs: np.array([next(rest) for _ in range(runs)])


def walk(p: float, stops: Callable[[int, Array], tuple[NDArray[np.bool_], Array]], most: int) -> tuple[float, float]:
    """Exact (probability of a good stop, mean runs) of a stopping rule, over all paths of successes.

    `stops(n, s)` says for each number of successes s whether n runs stop there, and how good (0..1) that is.
    """
    mass, good, runs = np.array([1.0]), 0.0, 0.0
    for n in range(1, most + 1):
        mass = np.append(mass * (1.0 - p), 0.0) + np.append(0.0, mass * p)
        stop, value = stops(n, np.arange(n + 1.0))
        good += float((mass * stop * value).sum())
        runs += n * float(mass[stop].sum())
        mass = np.where(stop, 0.0, mass)
        if mass.sum() < 1e-12:
            return good, runs
    raise AssertionError(f"{mass.sum()} of the paths did not stop in {most} runs")


def narrow(interval: Interval, p: float, epsilon: float) -> Callable[[int, Array], tuple[NDArray[np.bool_], Array]]:
    def stops(n: int, successes: Array) -> tuple[NDArray[np.bool_], Array]:
        low, high = interval(successes, np.full(n + 1, n), 0.95)
        return high - low <= 2.0 * epsilon, ((low <= p) & (p <= high)).astype(float)

    return stops


def test_without_any_success_uppaals_rule_stops_at_29_runs_with_its_interval() -> None:
    found = to_half_width(lambda runs: np.zeros(runs))
    assert (found.estimate.runs, found.estimate.low) == (29, 0.0)
    assert found.estimate.high == pytest.approx(0.0981446, abs=5e-8)
    mirrored = to_half_width(lambda runs: np.ones(runs))
    assert (mirrored.estimate.runs, mirrored.estimate.high) == (29, 1.0)
    assert found.decided
    assert "92.7 %" in found.note


def test_uppaals_rule_under_covers_by_as_much_as_its_note_says() -> None:
    coverage, runs = walk(0.1, narrow(uppaal_interval, 0.1, 0.05), 500)
    assert coverage == pytest.approx(0.927, abs=0.0005)
    assert runs == pytest.approx(145.7, abs=0.1)


@pytest.mark.parametrize("p", [0.02, 0.1, 0.5])
def test_the_anytime_interval_covers_where_it_stops_at_least_as_often_as_it_says(p: float) -> None:
    coverage, _ = walk(p, narrow(mixture_interval, p, 0.08), 700)
    assert coverage >= 0.95


@pytest.mark.parametrize("p", [0.01, 0.1, 0.5])
def test_somebody_who_looks_at_every_run_sees_the_anytime_interval_miss_in_at_most_5_percent(p: float) -> None:
    def leaves(n: int, successes: Array) -> tuple[NDArray[np.bool_], Array]:
        low, high = mixture_interval(successes, np.full(n + 1, n), 0.95)
        missed = (p < low) | (p > high)
        return (missed | (n == 400)), missed.astype(float)

    missed, _ = walk(p, leaves, 400)
    assert 0.0 < missed <= 0.05


def test_over_many_seeds_the_anytime_interval_holds_the_truth_at_all_times_at_once() -> None:
    rng = np.random.default_rng(5)
    runs = np.arange(1, 1001)
    missed = 0
    for _ in range(200):
        successes = np.cumsum(rng.random(1000) < 0.3).astype(float)
        low, high = mixture_interval(successes, runs, 0.9)
        missed += bool(np.any((low > 0.3) | (high < 0.3)))
    assert 0 < missed <= 20


def test_weights_keep_the_anytime_interval_valid() -> None:
    rng = np.random.default_rng(6)
    runs = np.arange(1, 1001)
    missed = 0
    for _ in range(200):
        low, high = mixture_interval(np.cumsum(rng.beta(0.5, 1.5, 1000)), runs, 0.9)
        missed += bool(np.any((low > 0.25) | (high < 0.25)))
    assert missed <= 20


def test_the_fixed_rule_is_clopper_and_pearsons() -> None:
    outcomes = coin(0.2, 1)(777)
    for batch in (1, 100, 777):
        found = fixed_run_estimate(given(outcomes), 777, 0.9, batch=batch)
        assert found.estimate == clopper_pearson(outcomes.sum(), 777, 0.9)


@pytest.mark.parametrize("rule", [to_half_width, anytime])
@pytest.mark.parametrize("p", [0.0, 0.03, 0.4, 0.97])
def test_the_rule_stops_at_the_first_run_where_the_interval_is_narrow(
    rule: Callable[..., RuleOutcome], p: float
) -> None:
    interval = uppaal_interval if rule is to_half_width else mixture_interval
    outcomes = coin(p, 3)(3000)
    counts = np.arange(1, 3001)
    low, high = interval(np.cumsum(outcomes), counts, 0.95)
    first = int(np.flatnonzero(high - low <= 0.1)[0])
    for batch in (1, 7, 1000, 3000):
        found = rule(given(outcomes), 0.05, batch=batch)
        assert found.estimate.runs == first + 1
        assert (found.estimate.low, found.estimate.high) == (low[first], high[first])


def test_an_estimate_that_runs_out_of_runs_says_so() -> None:
    found = anytime(coin(0.5, 1), 0.01, most=300)
    assert not found.decided
    assert found.estimate.runs == 300
    assert found.estimate.low < 0.5 < found.estimate.high


def ended(test: RatioTest) -> Callable[[int, Array], tuple[NDArray[np.bool_], Array]]:
    """Wald's test over all paths; good is that it holds."""
    below, above = log(test.beta / (1 - test.alpha)), log((1 - test.beta) / test.alpha)

    def stops(n: int, successes: Array) -> tuple[NDArray[np.bool_], Array]:
        ratio = successes * log(test.reject / test.accept) + (n - successes) * log(
            (1 - test.reject) / (1 - test.accept)
        )
        return (ratio <= below) | (ratio >= above), (ratio <= below).astype(float)

    return stops


@pytest.mark.parametrize(("op", "p"), [(">=", 0.8), ("<=", 0.5)])
def test_walds_test_keeps_its_error_rates_and_costs_about_what_he_says(op: str, p: float) -> None:
    test = wald_test(">=" if op == ">=" else "<=", p, 0.05, 0.05, 0.02)
    holds, runs = walk(test.accept, ended(test), 4000)
    assert 0.95 <= holds <= 0.975
    assert runs == pytest.approx(expected_runs(test, test.accept), rel=0.1)
    wrong, fewer = walk(test.reject, ended(test), 4000)
    assert wrong <= 0.021
    assert fewer == pytest.approx(expected_runs(test, test.reject), rel=0.1)
    even, most = walk(p, ended(test), 8000)
    assert even == pytest.approx(acceptance(test, p), abs=0.03)
    assert most == pytest.approx(expected_runs(test, p), rel=0.1)


def test_walds_approximation_is_exact_at_the_hypotheses() -> None:
    test = wald_test(">=", 0.3, 0.03, 0.02, 0.07)
    assert acceptance(test, test.accept) == pytest.approx(0.98, abs=1e-9)
    assert acceptance(test, test.reject) == pytest.approx(0.07, abs=1e-9)
    assert (acceptance(test, 1.0), acceptance(test, 0.0)) == (1.0, 0.0)
    course = [acceptance(test, p) for p in np.linspace(0.01, 0.99, 197)]
    assert course == sorted(course)


@pytest.mark.parametrize("batch", [1, 64, 5000])
def test_walds_test_decides_run_by_run_whatever_is_drawn_at_once(batch: int) -> None:
    test = wald_test(">=", 0.7, 0.04)
    answers = {True: 0, False: 0}
    for seed in range(40):
        outcomes = coin(0.74 if seed % 2 else 0.66, seed)(5000)
        found = sprt(given(outcomes), test, most=5000, batch=batch)
        sums, counts = np.cumsum(outcomes), np.arange(1, 5001)
        ratio = sums * log(test.reject / test.accept) + (counts - sums) * log((1 - test.reject) / (1 - test.accept))
        assert found.estimate.runs == 1 + int(np.flatnonzero(np.abs(ratio) >= test.limits[1])[0])
        assert found.holds is not None
        answers[found.holds] += 1
    assert min(answers.values()) >= 15


@pytest.mark.parametrize(
    ("op", "p", "outcome", "holds"),
    [
        (">=", 1.0, 1.0, True),
        (">=", 1.0, 0.0, False),
        ("<=", 0.0, 0.0, True),
        ("<=", 0.0, 1.0, False),
        (">=", 0.0, 0.0, True),
        ("<=", 1.0, 1.0, True),
        (">=", 0.004, 0.0, False),
    ],
)
def test_a_bound_at_the_edge_is_decided(op: str, p: float, outcome: float, holds: bool) -> None:
    test = wald_test(">=" if op == ">=" else "<=", p)
    assert sprt(lambda runs: np.full(runs, outcome), test).holds is holds


def test_a_test_that_runs_out_of_runs_is_not_decided() -> None:
    found = sprt(coin(0.5, 2), wald_test(">=", 0.5), most=50)
    assert (found.holds, found.decided, found.estimate.runs) == (None, False, 50)


def test_the_region_of_indifference_shrinks_near_the_edge() -> None:
    test = wald_test("<=", 0.002, 0.01)
    assert (test.accept, test.reject) == pytest.approx((0.001, 0.003))


def test_progress_goes_up_and_ends_within_one() -> None:
    told: list[float] = []
    to_half_width(coin(0.5, 1), 0.01, progress=lambda _, share: told.append(share))
    assert told == sorted(told)
    assert 0.0 < told[0] < told[-1] <= 1.0


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: fixed_run_estimate(coin(0.5, 1), 0), "0 runs give no estimate"),
        (lambda: to_half_width(coin(0.5, 1), 0.5), "no estimate to"),
        (lambda: anytime(coin(0.5, 1), 0.1, 1.0), "no estimate to"),
        (lambda: anytime(lambda runs: np.full(runs, np.nan)), "outside"),
        (lambda: fixed_run_estimate(lambda runs: np.zeros(runs + 1), 10), "gave outcomes of shape"),
        (lambda: wald_test(">=", 1.2), "p must be in"),
        (lambda: wald_test(">=", 0.5, alpha=0.6, beta=0.5), "sum below 1"),
    ],
)
def test_what_cannot_be_asked_is_refused(call: Callable[[], object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        call()
