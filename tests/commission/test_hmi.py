"""The HMI against the PLC: which readings agree, when a tag is proved, which lists can be read."""

from dataclasses import asdict, replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.tag import DType, Order, Tag, Value
from gateway.commission.files.cells import ListError
from gateway.commission.hmi import HmiReading, Point, compare, missing_proof, parse_points, read_hmi_list

NOW = 1_700_000_000.0
CURRENT = Tag("Assorbimento", "holding:101", DType.UINT16, scale=0.1, unit="A")
WARM = Tag("Temperatura", "holding:105", DType.FLOAT32, Order.CDAB, unit="degC")
FLAG = Tag("Marcia", "holding:100", DType.BOOL, bit=0)
STATE = Tag("Stato", "holding:110", labels={0: "fermo", 1: "in marcia", 2: "lavaggio"})


def point(tag: Tag, text: str, *values: Value, slack: float = 0.0) -> Point:
    return compare(tag, HmiReading(tag.name, text), values, NOW, slack)


@pytest.mark.parametrize(
    ("tag", "text", "value", "agrees"),
    [
        (WARM, "72,4", 72.4375, True),
        (WARM, "72.4", 72.4999, True),
        (WARM, "72.4", 72.61, False),
        (WARM, "72", 72.9, True),
        (WARM, "-3,5", -3.46, True),
        (CURRENT, "80", 80.5, True),
        (CURRENT, "80.5", 805.0, False),
        (FLAG, "on", True, True),
        (FLAG, "0", True, False),
        (FLAG, "MARCIA", True, True),
        (STATE, "Lavaggio", 2, True),
        (STATE, "fermo", 1, False),
        (STATE, "1", 1, True),
    ],
)
def test_a_reading_agrees_within_what_the_hmi_shows(tag: Tag, text: str, value: Value, agrees: bool) -> None:
    found = point(tag, text, value)
    assert found.ok is agrees
    assert bool(found.reason) is not agrees


def test_a_tag_with_its_factor_in_a_register_is_held_to_what_the_hmi_shows() -> None:
    scaled = Tag("Frequenza", "holding:2", scale_from="holding:3", unit="Hz")
    assert point(scaled, "49.98", 49.98).ok and not point(scaled, "50.30", 49.98).ok
    there, elsewhere = point(scaled, "49.98", 49.98), replace(scaled, scale_from="holding:4")
    assert there.definition != point(elsewhere, "49.98", 49.98).definition


def test_a_value_that_moves_agrees_with_what_lies_on_its_way() -> None:
    assert point(WARM, "50.0", 49.0, 51.0).ok
    assert not point(WARM, "50.0", 51.0, 52.0).ok
    assert point(WARM, "50.0", 51.0, 52.0, slack=1.5).ok


def test_without_a_good_reading_nothing_agrees() -> None:
    assert not point(WARM, "50.0").ok


@pytest.mark.parametrize(("tag", "text"), [(WARM, "warm"), (FLAG, "maybe"), (WARM, "on"), (CURRENT, "1,2,3")])
def test_a_text_that_such_a_tag_never_shows_is_refused(tag: Tag, text: str) -> None:
    with pytest.raises(ListError):
        point(tag, text, 1.0)


@settings(max_examples=200, deadline=None)
@given(st.floats(-500, 500), st.integers(0, 3), st.floats(5.0, 50.0))
def test_what_the_hmi_rounds_agrees_and_what_is_far_off_does_not(value: float, decimals: int, steps: float) -> None:
    text = f"{value:.{decimals}f}"
    assert point(WARM, text, value).ok
    assert not point(WARM, text, value + steps * 10.0**-decimals).ok


def test_a_number_is_proved_by_two_values_that_differ_and_a_flag_by_both_states() -> None:
    once, again, other = point(WARM, "40,0", 40.0), point(WARM, "40,0", 40.02), point(WARM, "55,1", 55.13)
    assert missing_proof(WARM, []) == "not compared yet"
    assert "only" in missing_proof(WARM, [once, again])
    assert missing_proof(WARM, [once, again, other]) == ""
    assert "seen on only" in missing_proof(FLAG, [point(FLAG, "1", True)])
    assert missing_proof(FLAG, [point(FLAG, "1", True), point(FLAG, "0", False)]) == ""
    wrong = point(FLAG, "0", True)
    assert "seen on only" in missing_proof(FLAG, [point(FLAG, "1", True), wrong])


def test_what_was_proved_for_another_place_is_not_proved_for_this_one() -> None:
    both = [point(FLAG, "1", True), point(FLAG, "0", False)]
    moved = Tag("Marcia", "holding:101", DType.BOOL, bit=0)
    assert missing_proof(moved, both) == "not compared yet"


def test_points_come_back_from_a_record_and_strange_ones_are_left_out() -> None:
    one = point(WARM, "40,0", 40.0)
    assert parse_points({"points": [asdict(one), {"tag": "x"}, 3]}) == [one]


def test_lists_are_read_by_rows_and_by_columns(tmp_path: Path) -> None:
    rows = tmp_path / "rows.csv"
    rows.write_text("Tag;Valore HMI;Ora\nTemperatura;72,4;2023-11-14T22:13:20+00:00\nmarcia;ON;\n", encoding="utf-8")
    first, second = read_hmi_list(rows, (WARM, FLAG), NOW)
    assert (first.tag, first.text, first.time) == ("Temperatura", "72,4", NOW)
    assert (second.tag, second.text, second.time) == ("Marcia", "ON", None)
    wide = tmp_path / "wide.csv"
    wide.write_text("time,Marcia,Temperatura\n1700000000,1,72.4\n1700000005,0,\n", encoding="utf-8")
    found = read_hmi_list(wide, (WARM, FLAG), NOW)
    assert [(one.tag, one.text, one.time) for one in found] == [
        ("Marcia", "1", NOW), ("Temperatura", "72.4", NOW), ("Marcia", "0", NOW + 5)
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("Tag;Valore\nNessuno;3\n", ("line 2", "'Nessuno' is no tag")),
        ("Tag;Valore;Ora\nMarcia;1;gestern\n", ("line 2, 'Ora'", "is no time")),
        ("a;b\n1;2\n", ("no header was recognised",)),
    ],
)
def test_a_list_that_cannot_be_used_is_one_sentence(tmp_path: Path, text: str, words: tuple[str, ...]) -> None:
    path = tmp_path / "hmi.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ListError) as error:
        read_hmi_list(path, (WARM, FLAG), NOW)
    assert all(word in str(error.value) for word in words)
