"""The one way in which values become JSON, byte for byte: records, status, audit log, reports and results use it."""

import json
from collections import deque
from dataclasses import asdict, dataclass
from enum import IntEnum, StrEnum
from math import inf, nan
from pathlib import PurePosixPath
from types import MappingProxyType

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.strict_json import json_text, shallow_dict, strict


@dataclass(frozen=True)
class Inner:
    value: float


@dataclass(frozen=True, slots=True)
class Outer:
    name: str
    inner: Inner
    rest: tuple[Inner, ...] = ()


class Number(IntEnum):
    TWO = 2


class Word(StrEnum):
    GOOD = "good"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (nan, "null"),
        ([1.0, inf, -inf], "[1.0, null, null]"),
        ({"a": (1, nan), 2: {"b": None}}, '{"a": [1, null], "2": {"b": null}}'),
        (deque([1, 2], maxlen=5), "[1, 2]"),
        (MappingProxyType({"x": True}), '{"x": true}'),
        (Outer("δ", Inner(inf), (Inner(1.5),)), '{"name": "δ", "inner": {"value": null}, "rest": [{"value": 1.5}]}'),
        ([Number.TWO, Word.GOOD], '[2, "good"]'),
        (PurePosixPath("out/a.csv"), '"out/a.csv"'),
        ([np.float64(1.25), np.float64("nan"), np.int64(3), np.bool_(True)], "[1.25, null, 3, true]"),
        ([np.float32(0.5), np.array([1.0, np.nan])], "[0.5, [1.0, null]]"),
        ("°C — no \\u escapes", '"°C — no \\\\u escapes"'),
    ],
)
def test_a_value_has_one_text(value: object, text: str) -> None:
    assert json_text(value) == text


def test_the_layout_is_asked_for() -> None:
    assert json_text({"b": 1, "a": [nan]}, sort_keys=True) == '{"a": [null], "b": 1}'
    assert json_text({"b": 1}, indent=1) == '{\n "b": 1\n}'


def test_a_class_is_named_and_not_opened() -> None:
    assert strict(Inner) == str(Inner)


_VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=20,
)


@given(_VALUES)
def test_what_comes_out_is_read_back_by_a_strict_reader(value: object) -> None:
    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is no JSON")

    assert json.loads(json_text(value), parse_constant=refuse) == strict(value)


def test_a_dataclass_that_is_not_copied_is_what_asdict_makes_of_it() -> None:
    held = {"a": Inner(1.0), "b": [Inner(2.0), Number.TWO]}
    outer = Outer("name", Inner(0.5), (Inner(nan), Inner(-0.0)))
    assert repr(shallow_dict(outer)) == repr(asdict(outer))
    assert shallow_dict(held) == {"a": {"value": 1.0}, "b": [{"value": 2.0}, Number.TWO]}
