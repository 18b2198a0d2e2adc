"""What a candidate is judged by was seen by none of its fits: the folds, knot by knot, and the rule that chooses."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sim.lab.learning import held_out
from sim.lab.learning.free_run import HUBER_LIMIT
from sim.lab.learning.held_out import HeldOutErrors, choose, cross_validate, folds, huber_scale, judged_part
from sim.lab.learning.runs import FreeRuns
from sim.sha import Array


def runs_of(readings: Sequence[Sequence[float]], places: Sequence[Sequence[int]] | None = None) -> FreeRuns:
    """Runs with these readings, a second apart, in these places (0)."""
    reading = np.concatenate([np.array(each, dtype=float) for each in readings])
    run = np.repeat(np.arange(len(readings)), [len(each) for each in readings])
    first = np.diff(run, prepend=-1) != 0
    zeros = np.zeros(reading.size, dtype=np.intp)
    return FreeRuns(
        time=np.arange(reading.size, dtype=float),
        dt=np.where(first, 0.0, 1.0),
        age=np.zeros(reading.size),
        place=zeros if places is None else np.concatenate([np.array(each, dtype=np.intp) for each in places]),
        inputs=np.empty((reading.size, 0)),
        reading=reading,
        stay=zeros,
        run=run,
        trace=zeros,
    )


# ---------------------------------------------------------------- the folds


def by_hand(runs: FreeRuns) -> list[bool] | None:
    """`judged_part`, one knot after the other."""
    order, numbers = [], sorted(set(runs.run.tolist()))
    order = [numbers.index(run) for run in runs.run.tolist()]
    taught = {}
    for fold in range(5):
        for place in set(runs.place.tolist()):
            taught[fold, place] = (
                sum(
                    number % 5 != fold and there == place and not first and np.isfinite(reading)
                    for number, there, first, reading in zip(
                        order, runs.place.tolist(), runs.first.tolist(), runs.reading.tolist(), strict=True
                    )
                )
                >= 10
            )
    judged: list[bool] = []
    for knot, number in enumerate(order):
        first = bool(runs.first[knot])
        judged.append(first or (judged[-1] and taught[number % 5, int(runs.place[knot])]))
    read = [
        number for number, ok, reading in zip(order, judged, runs.reading, strict=True) if ok and reading == reading
    ]
    return judged if len(read) >= 20 and len(set(read)) >= 2 else None


def test_what_is_judged_is_what_the_other_folds_have_taught() -> None:
    rng, told = np.random.default_rng(4), 0
    for _ in range(150):
        sizes = rng.integers(2, 16, size=rng.integers(1, 10))
        readings = [np.where(rng.random(size) < 0.2, np.nan, 20.0) for size in sizes]
        places = [np.sort(rng.choice(4, p=[0.5, 0.3, 0.15, 0.05], size=size)) for size in sizes]
        runs = runs_of([each.tolist() for each in readings], [each.tolist() for each in places])
        found, expected = judged_part(runs), by_hand(runs)
        told += expected is not None
        assert (None if found is None else found.tolist()) == expected
    assert 50 < told < 140, "some are told, some are not"


def test_ten_readings_teach_and_nine_do_not() -> None:
    # Two runs, each a fold of its own: what the one has taught of place 1 is what the other is judged by.
    for taught in (9, 10):
        readings = [[20.0] * (11 + taught), [20.0] * 13]
        runs = runs_of(readings, [[0] * 11 + [1] * taught, [0] * 11 + [1] * 2])
        judged = judged_part(runs)
        assert judged is not None
        assert judged[-2:].tolist() == [taught == 10] * 2 and judged[-13:-2].all()


def test_a_cross_validation_needs_twenty_readings_of_two_runs() -> None:
    # Runs of ten knots are not halved; their readings are counted, and not their knots.
    for missing in range(3):
        runs = runs_of([[20.0] * 10 + [np.nan], [np.nan] * missing + [20.0] * (10 - missing)])
        assert (folds(runs) is not None) == (missing == 0)
    assert folds(runs_of([[20.0] * 19])) is None
    halved = folds(runs_of([[20.0] * 20]))
    assert halved is not None and np.bincount(halved.run).tolist() == [10, 10]
    many = folds(runs_of([[20.0] * 400]))
    assert many is not None and np.unique(many.run).size == 10


def test_twenty_readings_of_two_runs_can_be_judged() -> None:
    found = set()
    for sizes in product(range(4, 10), repeat=3):
        runs = runs_of([[20.0] * size for size in sizes])
        judged, expected = judged_part(runs), by_hand(runs)
        assert (judged is None) == (expected is None)
        found.add((sum(sizes), judged is None))
    assert {(19, True), (20, False)} < found
    # Of the second run nothing is judged, and one run alone says nothing of what lies between runs.
    assert judged_part(runs_of([[20.0] * 30, [np.nan] * 12])) is None


@pytest.mark.parametrize("fixed", [False, True])
@pytest.mark.parametrize("count", [2, 4, 5, 6, 12])
def test_no_fit_has_seen_the_run_that_it_is_judged_by(fixed: bool, count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    begin, shape = np.array([0.5]), SimpleNamespace()
    rng = np.random.default_rng(count)
    readings = [np.where(rng.random(6) < 0.3, np.nan, rng.normal(20.0, 5.0, 6)) for _ in range(count)]
    runs = runs_of([each.tolist() for each in readings])
    runs = replace(runs, run=runs.run * 3 + 7)  # numbers are names: only their order counts
    judged = rng.random(len(runs)) < 0.6
    judged[runs.run == runs.run[-1]] = False
    predicted: list[int] = []

    def fitted(rest: FreeRuns, given: Any, rates: Array) -> SimpleNamespace:
        assert given is shape and rates is begin
        return SimpleNamespace(linear=set(rest.run.tolist()), rates=np.array([7.0]), sigma=0.25)

    def told(ahead: FreeRuns, given: Any, linear: set[int], rates: Array, sigma: float) -> Array:
        assert given is shape and sigma == 0.25 and rates.tolist() == ([0.5] if fixed else [7.0])
        numbers, own = (np.array(sorted(linear)) - 7) // 3, (ahead.run - 7) // 3
        assert set(np.arange(count)) - set(numbers) == {n for n in range(count) if n % 5 == own[0] % 5}
        assert set(own % 5) == {own[0] % 5}
        predicted.extend(ahead.time.astype(int).tolist())
        return np.asarray(ahead.reading - ahead.time)

    monkeypatch.setattr(held_out, "fit_at_rates", fitted)
    monkeypatch.setattr(held_out, "fit_free_run", lambda rest, given, *, begin: fitted(rest, given, begin))
    monkeypatch.setattr(held_out, "predict", told)
    for mask in (judged, None):
        predicted.clear()
        errors = cross_validate(runs, shape, begin, fixed=fixed, judged=mask)  # type: ignore[arg-type]
        shown = np.ones(len(runs), dtype=bool) if mask is None else mask
        rows = np.flatnonzero(shown & np.isfinite(runs.reading))
        assert sorted(predicted) == np.flatnonzero(shown).tolist(), "each once"
        np.testing.assert_allclose(errors.error, rows, atol=1e-12)
        names = np.unique(runs.run[rows]).tolist()
        assert errors.run.tolist() == [names.index(run) for run in runs.run[rows].tolist()]


# ---------------------------------------------------------------- the figures


def test_the_figures_of_errors_by_hand() -> None:
    errors = HeldOutErrors(np.array([3.0, -4.0, 3.0, 4.0, -3.0, 4.0]), np.array([0, 0, 0, 0, 1, 1]))
    assert errors.rmse == pytest.approx(12.5**0.5) and errors.mae == 3.5
    assert errors.readings.tolist() == [4, 2]
    # No error is beyond 1.345 scales, so that the scale is the root of their mean square, and the density a normal one.
    assert huber_scale(errors.error) == pytest.approx(12.5**0.5)
    usual = -0.5 * np.log(12.5) - 0.5
    assert errors.likelihood == pytest.approx([usual, usual])
    uneven = HeldOutErrors(np.array([3.0, 3.0, 3.0, -4.0, 4.0, 4.0]), np.array([0, 0, 0, 0, 1, 1]))
    low, high = 43.0 / 4 / 25.0, 16.0 / 25.0
    assert uneven.likelihood == pytest.approx([-0.5 * np.log(12.5) - low, -0.5 * np.log(12.5) - high])
    assert uneven.score == pytest.approx(-0.5 * np.log(12.5) - (4 * low + 2 * high) / 6)


def test_the_scale_is_where_the_mean_of_what_counts_is_one() -> None:
    rng = np.random.default_rng(2)
    for gross in (0.0, 50.0, 1e6):
        error = rng.normal(0.0, 0.3, 200)
        error[:20] += gross
        z = np.abs(error) / huber_scale(error)
        assert np.mean(z * np.minimum(z, HUBER_LIMIT)) == pytest.approx(1.0, rel=1e-6)
    assert huber_scale(np.zeros(5)) == 1e-6 == huber_scale(np.array([1e-9, -1e-9]))


def test_training_errors_are_of_the_readings_alone() -> None:
    runs = runs_of([[20.0, np.nan, 23.0], [16.0]])
    fit: Any = SimpleNamespace(mean=np.array([20.0, 99.0, 20.0, 20.0]))
    assert held_out.training_errors(runs, fit) == (pytest.approx((25 / 3) ** 0.5), pytest.approx(7 / 3))


# ---------------------------------------------------------------- the rule that chooses


@dataclass(frozen=True)
class Given:
    """Errors of which only this is known."""

    likelihood: Array
    readings: Array


def given(likelihood: Sequence[float], readings: Sequence[int]) -> Any:
    return Given(np.array(likelihood), np.array(readings))


def test_one_and_a_half_standard_errors_are_as_good_and_no_more() -> None:
    # Two runs that differ by 1 from their mean: the error of the mean is 1.5. Runs of 3 and 1 readings: 2.25.
    best = given([0.0, 0.0], [5, 5])
    assert choose([best, given([-2.5, -0.5], [5, 5])], [9, 3]) == 1
    assert choose([best, given([-2.5625, -0.5625], [5, 5])], [9, 3]) == 0
    best = given([0.0, 0.0], [3, 1])
    assert choose([best, given([-1.25, -5.25], [3, 1])], [9, 3]) == 1
    assert choose([best, given([-1.3125, -5.3125], [3, 1])], [9, 3]) == 0


def test_what_is_hard_for_all_is_no_part_of_the_error() -> None:
    best = given([-100.0, 0.0, 50.0], [5, 5, 5])
    assert choose([best, given([-100.5, -0.5, 49.5], [5, 5, 5])], [9, 3]) == 0


def test_of_a_single_run_the_better_one_is_taken() -> None:
    best = given([-1.0], [30])
    assert choose([best, given([-1.0], [30])], [9, 3]) == 1
    assert choose([best, given([-1.0625], [30])], [9, 3]) == 0
    assert choose([given([-1.0625], [30]), best], [3, 9]) == 1


def test_among_those_as_good_the_smallest_and_then_the_better_is_taken() -> None:
    three = [given(each, [5, 5]) for each in ([0.0, 0.0], [-2.0, 0.0], [-1.0, 0.0], [-9.0, -9.0])]
    assert choose(three, [9, 3, 3, 1]) == 2
    assert choose(three, [9, 3, 4, 1]) == 1
    assert choose(three[::-1], [1, 3, 3, 9]) == 1


def test_the_mean_is_by_readings() -> None:
    # By runs the second is better (-1 before -1.5), by readings the first.
    assert choose([given([-3.0, 0.0], [1, 9]), given([0.0, -2.0], [1, 9])], [1, 1]) == 0
