"""Two probabilities on common random numbers: which is greater, and how sure that is."""

from collections.abc import Callable

import numpy as np
import pytest

from sim.lab.checking.smc.rules.paired import PairedOutcome, compare
from sim.sha.trace import Array


def pairs(left: float, right: float, seed: int, common: bool = True) -> Callable[[int], tuple[Array, Array]]:
    rng = np.random.default_rng(seed)

    def draw(runs: int) -> tuple[Array, Array]:
        u = rng.random(runs)
        return (u < left).astype(float), ((u if common else rng.random(runs)) < right).astype(float)

    return draw


@pytest.mark.parametrize(
    ("left", "right", "answer", "holds"),
    [
        (0.5, 0.45, "greater", True),
        (0.45, 0.5, "smaller", False),
        (0.3, 0.3, "equal", True),
        (1.0, 0.0, "greater", True),
    ],
)
def test_the_greater_one_is_found(left: float, right: float, answer: str, holds: bool) -> None:
    found = compare(pairs(left, right, 1))
    assert (found.answer, found.holds) == (answer, holds)
    assert found.low <= left - right <= found.high


def test_common_random_numbers_answer_much_sooner() -> None:
    together = compare(pairs(0.52, 0.5, 2), delta=0.001)
    apart = compare(pairs(0.52, 0.5, 2, common=False), delta=0.001)
    assert together.answer == apart.answer == "greater"
    assert together.left.runs * 5 < apart.left.runs


def test_of_equal_ones_neither_is_called_greater_more_often_than_the_level_allows() -> None:
    answers = [
        compare(pairs(0.3, 0.3, seed, common=False), delta=1e-6, level=0.9, most=2000).answer for seed in range(300)
    ]
    wrong = sum(answer in ("greater", "smaller") for answer in answers)
    assert 0 < wrong <= 30
    assert answers.count("not decided") == 300 - wrong


def test_the_difference_lies_in_its_interval_as_often_as_the_level_says() -> None:
    missed = 0
    for seed in range(200):
        found = compare(pairs(0.3, 0.28, seed, common=False), delta=0.01, level=0.9, most=20_000, batch=5000)
        missed += not found.low <= 0.02 <= found.high
    assert missed <= 20


def test_a_comparison_is_the_same_whatever_is_drawn_at_once() -> None:
    left, right = pairs(0.4, 0.4, 4, common=False)(200_000)

    def recorded(batch: int) -> PairedOutcome:
        places = iter(range(left.size))

        def draw(runs: int) -> tuple[Array, Array]:
            taken = [next(places) for _ in range(runs)]
            return left[taken], right[taken]

        return compare(draw, delta=0.03, batch=batch)

    assert recorded(1) == recorded(999) == recorded(50_000)
    assert recorded(999).answer == "equal"


def test_a_comparison_that_runs_out_of_pairs_says_so() -> None:
    found = compare(pairs(0.5, 0.5, 3, common=False), most=500)
    assert (found.answer, found.holds, found.left.runs) == ("not decided", None, 500)


def test_weights_cannot_be_paired() -> None:
    with pytest.raises(ValueError, match="weights cannot be paired"):
        compare(lambda runs: (np.full(runs, 0.5), np.zeros(runs)))
    with pytest.raises(ValueError, match="no comparison"):
        compare(pairs(0.5, 0.5, 1), delta=0.0)
