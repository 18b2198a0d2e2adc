"""OBD-II answers to readings of tags: formulas, several frames, refusals, and what cannot be read."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cantools
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.can.frame import TagReading
from drivers.codec import Reading
from drivers.errors import AddressError
from drivers.tag import DType, Quality, Tag
from drivers.vehicle.obd import ObdListener, parse_tag, trouble_code
from drivers.vehicle.obd_pids import FILE, pids
from drivers.vehicle.obd_poll import plan_requests
from tests.drivers.can_frames import isotp, timed

SPEED = Tag("speed", "obd:0C", unit="rpm")
COOLANT = Tag("coolant", "obd:05", unit="degC")
VIN = Tag("vin", "obd:vin", DType.STRING)
CODES = Tag("codes", "obd:codes", DType.STRING)


def told(tags: Sequence[Tag], payload: bytes, identifier: int = 0x7E8) -> dict[str, Reading]:
    return last(ObdListener(tags), [(identifier, data) for data in isotp(payload)])


def last(listener: ObdListener, frames: Sequence[tuple[int, bytes]]) -> dict[str, Reading]:
    found: list[TagReading] = []
    for frame in timed(frames):
        found += listener.take(frame)
    return {one.tag.name: one.reading for one in found}


# Worked examples of SAE J1979: parameter, data, value.
EXAMPLES = [
    ("04", "80", 50.196), ("05", "7B", 83), ("06", "80", 0), ("0A", "10", 48), ("0B", "63", 99), ("0C", "1AF8", 1726),
    ("0D", "FF", 255), ("0E", "94", 10), ("0F", "00", -40), ("10", "01F4", 5), ("11", "FF", 100),
    ("14.voltage", "5A80", 0.45), ("14.trim", "5A80", 0), ("1F", "0E10", 3600), ("23", "0010", 160),
    ("24.ratio", "80000000", 1), ("2F", "8C", 54.902),
    ("32", "FFFC", -1), ("34.current", "80008100", 1), ("3C", "1194", 410), ("42", "2F6C", 12.14), ("44", "8000", 1),
    ("46", "46", 30), ("4F.pressure", "00000014", 200), ("5C", "78", 80), ("5D", "6900", 0), ("5E", "0064", 5),
    ("62", "7D", 0), ("63", "01F4", 500), ("67.a", "036400", 60), ("A6", "00018769", 10020.1),
    ("01.codes", "83000000", 3),
    ("54", "FF38", -200),
]  # fmt: skip


@pytest.mark.parametrize(("place", "data", "value"), EXAMPLES)
def test_a_parameter_reads_as_the_standard_says(place: str, data: str, value: float) -> None:
    tag = Tag("it", f"obd:{place}")
    payload = bytes([0x41, int(place[:2], 16)]) + bytes.fromhex(data)
    number, quality, reason = told([tag], payload)["it"]
    assert (number, quality, reason) == (pytest.approx(value, abs=5e-4), Quality.GOOD, "")


def test_all_fields_of_the_table_lie_in_their_parameter_and_scale_upwards() -> None:
    for pid in pids().values():
        for field in pid.fields.values():
            assert 24 < field.bits.end <= 24 + 8 * pid.length, (pid.number, field.name)
            assert field.scale > 0


# What the table that stood here before the DBC file made of each parameter: zeros, ones and drawn data.
VALUES = json.loads(Path(__file__).with_name("obd_values.json").read_text())


def test_the_file_has_the_parameters_of_the_former_table() -> None:
    assert {f"{number:02X}" for number in pids()} == set(VALUES)


@pytest.mark.parametrize("number", VALUES)
def test_every_parameter_reads_as_by_the_former_table(number: str) -> None:
    pid, former = pids()[int(number, 16)], VALUES[number]
    assert pid.length == former["length"]
    assert {name: field.unit for name, field in pid.fields.items()} == former["units"]
    assert list(pid.fields) == list(former["units"])
    for dtype in (DType.UINT32, DType.FLOAT64):
        tags = [Tag(name, f"obd:{number}.{name}", dtype) for name in pid.fields]
        for data, values in former["values"] if tags else ():
            readings = told(tags, bytes((0x41, pid.number)) + bytes.fromhex(data))
            assert {name: reading[0] for name, reading in readings.items()} == values
            assert all((q is Quality.GOOD) is (v is not None) for v, q, _ in readings.values())
            assert dtype is DType.FLOAT64 or all(
                type(reading[0]) is type(values[name]) for name, reading in readings.items()
            )


def test_the_file_can_be_read_by_whoever_reads_dbc_files() -> None:
    (message,) = cantools.database.load_file(FILE).messages
    decoded = message.decode(bytes.fromhex("04410C1AF8000000"))
    assert decoded["S01P0C_engine_speed"] == 1726.0


def test_two_byte_parameters_are_whole_numbers_or_floats_as_their_formula_is() -> None:
    assert type(told([COOLANT], b"\x41\x05\x40")["coolant"][0]) is int
    assert type(told([SPEED], b"\x41\x0c\x00\x00")["speed"][0]) is float


def test_several_parameters_come_in_one_answer_of_several_frames() -> None:
    readings = told([SPEED, COOLANT], b"\x41\x0c\x1a\xf8\x0d\x00\x05\x7b\x11\x20")
    assert {name: value for name, (value, _, _) in readings.items()} == {"speed": 1726.0, "coolant": 83}


@pytest.mark.parametrize(
    "payload",
    [b"\x41\x0c\x1a", b"\x41\x0c\x1a\xf8\x99", b"\x41\x0c\x1a\xf8\x05", b"\x41\x0c\x1a\xf8\x0c\x00\x00", b"\x41\x0c"],
    ids=["cut", "an unknown parameter behind it", "a parameter without data", "twice", "no data"],
)
def test_an_answer_that_does_not_add_up_is_never_a_value(payload: bytes) -> None:
    value, quality, reason = told([SPEED, COOLANT], payload)["speed"]
    assert value is None
    assert quality is Quality.DECODING_ERROR
    assert payload.hex(" ") in reason


def test_a_name_comes_in_several_frames() -> None:
    vin = b"WVWZZZ1KZAW000001"
    assert told([VIN], b"\x49\x02\x01" + vin)["vin"] == (vin.decode(), Quality.GOOD, "")


def test_trouble_codes_come_as_text_and_as_a_number() -> None:
    payload = b"\x43\x03\x01\x33\x40\x35\xc1\x00"
    readings = told([CODES, replace(CODES, name="count", address="obd:codes.count", dtype=DType.UINT8)], payload)
    assert readings["codes"][0] == "P0133 C0035 U0100"
    assert readings["count"][0] == 3
    assert trouble_code(0x92, 0x34) == "B1234"


def test_the_answers_of_one_unit_are_not_those_of_another() -> None:
    gearbox = replace(COOLANT, name="gearbox", address="obd:05@7E9")
    assert set(told([COOLANT, gearbox], b"\x41\x05\x50", 0x7E9)) == {"gearbox"}
    assert set(told([COOLANT, gearbox], b"\x41\x05\x50", 0x7E8)) == {"coolant"}
    assert set(told([COOLANT, gearbox], b"\x41\x05\x50", 0x18DAF110)) == {"coolant"}
    assert told([replace(COOLANT, address="obd:05@18DAF1EF")], b"\x41\x05\x50", 0x18DAF1EF)["coolant"][0] == 40


def test_answers_of_two_units_may_run_interleaved() -> None:
    gearbox = replace(VIN, name="gearbox", address="obd:vin@7E9")
    ours, theirs = (isotp(b"\x49\x02\x01" + bytes([letter]) * 17) for letter in b"AB")
    mixed = [frame for a, b in zip(ours, theirs, strict=True) for frame in ((0x7E8, a), (0x7E9, b))]
    readings = last(ObdListener([VIN, gearbox]), mixed)
    assert (readings["vin"][0], readings["gearbox"][0]) == ("A" * 17, "B" * 17)


def test_a_refusal_makes_bad_what_was_asked_for_and_nothing_else() -> None:
    listener = ObdListener([SPEED, COOLANT])
    frames = [(0x7DF, b"\x02\x01\x05".ljust(8, b"\0")), (0x7E8, b"\x03\x7f\x01\x12".ljust(8, b"\0"))]
    readings = last(listener, frames)
    assert set(readings) == {"coolant"}
    value, quality, reason = readings["coolant"]
    assert (value, quality) == (None, Quality.CONFIGURATION_ERROR)
    assert reason == "unit 7E8 refuses service 01: sub-function not supported (0x12)"


def test_a_refusal_of_what_nobody_was_heard_to_ask_for_and_a_pending_one_are_only_counted() -> None:
    listener = ObdListener([COOLANT])
    refusal = (0x7E8, b"\x03\x7f\x01\x12".ljust(8, b"\0"))
    pending = (0x7E8, b"\x03\x7f\x01\x78".ljust(8, b"\0"))
    assert last(listener, [refusal, (0x7E0, b"\x02\x01\x05".ljust(8, b"\0")), pending]) == {}
    assert (listener.counts()["refusals"], listener.counts()["unasked_refusals"]) == (2, 1)


def test_a_sensor_that_is_not_there_or_not_used_has_no_number() -> None:
    assert told([Tag("b", "obd:67.b")], b"\x41\x67\x01\x64\x50")["b"][:2] == (None, Quality.NO_DATA)
    assert told([Tag("trim", "obd:15.trim")], b"\x41\x15\x50\xff")["trim"][:2] == (None, Quality.NO_DATA)


def test_a_limit_makes_a_switch_of_a_number() -> None:
    running = Tag("running", "obd:0C>100", DType.BOOL)
    assert told([running], b"\x41\x0c\x01\x90")["running"][0] is False
    assert told([running], b"\x41\x0c\x01\x91")["running"][0] is True


def test_a_value_beyond_the_tags_range_is_out_of_range_and_its_own_scale_comes_on_top() -> None:
    fahrenheit = replace(COOLANT, scale=1.8, offset=32.0, high=200.0)
    assert told([fahrenheit], b"\x41\x05\x8c")["coolant"][:2] == (pytest.approx(212.0), Quality.OUT_OF_RANGE)
    assert told([fahrenheit], b"\x41\x05\x78")["coolant"][:2] == (pytest.approx(176.0), Quality.GOOD)


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("obd:FE", "parameter FE is not in the table"),
        ("obd:zz", "neither a parameter such as 0C nor one of"),
        ("obd:14", "parameter 14 has voltage, trim; give one, such as 'obd:14.voltage'"),
        ("obd:0C.torque", "parameter 0C has engine_speed"),
        ("obd:vin.count", "vin has no 'count'"),
        ("obd:0C>x", "is no address of this driver"),
        ("obd:0C>1.2.3", "is no number"),
        ("obd", "is no address of this driver"),
    ],
)
def test_an_address_that_means_nothing_is_refused_with_what_would_be_right(address: str, words: str) -> None:
    with pytest.raises(AddressError, match=r"^it: ") as caught:
        parse_tag(Tag("it", address, DType.BOOL))
    assert words in str(caught.value)


def test_a_limit_on_a_tag_that_is_no_switch_is_refused() -> None:
    with pytest.raises(AddressError, match="a limit belongs to a tag of dtype bool"):
        parse_tag(Tag("it", "obd:0C>100"))


@settings(max_examples=200)
@given(
    st.lists(st.tuples(st.sampled_from([0x7DF, 0x7E0, 0x7E8, 0x7E9, 0x18DAF110]), st.binary(max_size=8)), max_size=60)
)
def test_noise_on_the_answers_identifiers_never_raises(frames: list[tuple[int, bytes]]) -> None:
    last(ObdListener([SPEED, COOLANT, VIN, CODES]), frames)


def test_requests_are_made_once_a_parameter_and_go_to_the_unit_that_shall_answer() -> None:
    tags = [SPEED, replace(SPEED, name="running", address="obd:0C>9", dtype=DType.BOOL), VIN, CODES]
    ones = [parse_tag(tag) for tag in (*tags, replace(COOLANT, address="obd:05@7E9"))]
    short = plan_requests(ones, extended=False)
    assert [(one.request_id, one.data[:3].hex()) for one in short] == [
        (0x7E0, "02010c"), (0x7E0, "020902"), (0x7E0, "010355"), (0x7E1, "020105"),
    ]  # fmt: skip
    assert all(len(one.data) == 8 for one in short)
    assert plan_requests(ones, extended=True)[0][:3] == (0x18DAF110, 0x18DA10F1, True)
