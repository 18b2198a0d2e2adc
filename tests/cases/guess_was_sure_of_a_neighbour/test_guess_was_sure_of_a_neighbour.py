"""`guess` believed a register half of which was a neighbour's by 100 %, `bind` took it and `verify` proved it."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.guess import verdict
from drivers.codec import encode
from drivers.tag import DType, Order, Tag
from gateway.commission.encodings import Observation, ShownNumber, parse_display, rank
from gateway.commission.encodings.scoring import MAX_CONTESTED_BELIEF, EncodingCandidate
from gateway.commission.hmi import HmiReading, Point, compare, missing_proof

Reading = tuple[float, float, str]
"""What two neighbours hold, and what the HMI shows of the first."""


def seen(order: Order, *readings: Reading) -> list[Observation]:
    """Two float32 that are neighbours, from holding:105 on, among registers that are 0."""
    found = []
    for first, second, text in readings:
        words = [*encode(Tag("", "", DType.FLOAT32, order), first), *encode(Tag("", "", DType.FLOAT32, order), second)]
        shown = parse_display(text)
        assert isinstance(shown, ShownNumber)
        found.append(Observation(103, (0, 0, *words, 0, 0), shown))
    return found


def where(found: list[EncodingCandidate]) -> list[tuple[int, DType, Order]]:
    return [(one.address, one.dtype, one.order) for one in found]


def test_the_readings_of_the_report_put_the_right_register_first() -> None:
    readings = seen(Order.CDAB, (23.5, 23.0, "23.5"), (24.0, 23.6, "24.0"))
    for told in (104, 105, 106):
        found = rank(readings, told)
        assert where(found)[0] == (105, DType.FLOAT32, Order.CDAB)
        neighbour = [one for one in found if (one.address, one.order) == (106, Order.ABCD)]
        assert all(one.share < found[0].share for one in neighbour)


def test_what_no_reading_can_tell_apart_is_not_believed() -> None:
    """With whole numbers both low words are 0 for ever: the given address decides, and the belief says so."""
    readings = seen(Order.CDAB, (23.5, 23.0, "23.5"), (24.0, 22.0, "24.0"))
    for told in (105, 106):
        found = rank(readings, told)
        assert {(105, DType.FLOAT32, Order.CDAB), (106, DType.FLOAT32, Order.ABCD)} <= set(where(found))
        assert found[0].exact and found[0].share <= MAX_CONTESTED_BELIEF


@pytest.mark.parametrize("order", list(Order))
def test_an_exact_encoding_is_never_below_an_inexact_one_and_its_belief_has_a_bound(order: Order) -> None:
    rng = np.random.default_rng(15)
    for _ in range(5):
        drawn = np.round(rng.uniform(15.0, 90.0, (2, 2)), 1)
        readings = seen(order, *((float(a), float(b), f"{a:.1f}") for a, b in drawn))
        found = rank(readings, 105 + int(rng.integers(-1, 2)))
        exact = [one.exact for one in found]
        assert exact == sorted(exact, reverse=True)
        assert [one.share for one in found] == sorted((one.share for one in found), reverse=True)
        if exact[1:2] == [True]:
            assert found[0].share <= MAX_CONTESTED_BELIEF
        assert where(found)[0] == (105, DType.FLOAT32, order)


def test_of_drawn_layouts_with_rounded_floats_none_is_wrong_and_believed() -> None:
    verdicts = [verdict(seed) for seed in range(80_001, 80_013)]
    assert not any(one.deluded for one in verdicts)
    assert sum(one.reads for one in verdicts) >= len(verdicts) - 1, [one.described for one in verdicts if not one.reads]


# ---------------------------------------------------------------- verify

WRONG = Tag("T", "holding:106", DType.FLOAT32, Order.ABCD, unit="degC")
RIGHT = Tag("T", "holding:105", DType.FLOAT32, Order.CDAB, unit="degC")


def point(tag: Tag, text: str, value: float) -> Point:
    return compare(tag, HmiReading("T", text), [value], 0.0)


def test_verify_asks_for_more_where_a_reading_agrees_only_as_if_the_value_had_moved() -> None:
    readings = [point(WRONG, "23.5", 23.5), point(WRONG, "24.0", 24.1)]
    assert all(one.ok for one in readings) and not readings[1].exact
    assert "24.0 was shown where it reads 24.1" in missing_proof(WRONG, readings)
    assert "compare 2 more values" in missing_proof(WRONG, readings)
    assert missing_proof(WRONG, [*readings, point(WRONG, "30.0", 30.02), point(WRONG, "40.0", 40.04)]) == ""


@pytest.mark.parametrize(
    "tag", [WRONG, RIGHT, Tag("T", "holding:105", DType.UINT32, scale=0.1), Tag("T", "holding:105", DType.FLOAT64)]
)
def test_verify_asks_for_a_third_value_where_a_register_stood_still(tag: Tag) -> None:
    two = [point(tag, "23.5", 23.5), point(tag, "24.0", 24.0)]
    assert "a register held the same both times and may be a neighbour's: compare a third" in missing_proof(tag, two)
    assert missing_proof(tag, [*two, two[0]]) == missing_proof(tag, two)  # the same again is no third value
    assert missing_proof(tag, [*two, point(tag, "31.5", 31.5)]) == ""


def test_two_values_that_move_every_register_are_enough_and_so_they_are_for_one_register() -> None:
    assert missing_proof(RIGHT, [point(RIGHT, "23.6", 23.6), point(RIGHT, "31.3", 31.3)]) == ""
    single = Tag("T", "holding:105", DType.INT16, scale=0.1)
    assert missing_proof(single, [point(single, "23.6", 23.6), point(single, "31.3", 31.3)]) == ""


def test_what_was_compared_and_did_not_agree_is_not_called_not_compared(tmp_path: Path) -> None:
    assert missing_proof(RIGHT, []) == "not compared yet"
    left = missing_proof(RIGHT, [point(RIGHT, "23.6", 40.0)])
    assert left.startswith("compared and did not agree: the PLC has 40 degC")
    flag = Tag("T", "holding:105", DType.BOOL, bit=0)
    assert "did not agree" in missing_proof(flag, [compare(flag, HmiReading("T", "on"), [False], 0.0)])
