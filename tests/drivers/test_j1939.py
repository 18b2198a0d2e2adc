"""J1939: identifiers, parameters, what is no number, trouble codes, DBC files, and the count of all frames."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.can.dbc import Dbc
from drivers.codec import Reading
from drivers.errors import AddressError
from drivers.tag import DType, Quality, Tag
from drivers.vehicle.dm1 import trouble_codes
from drivers.vehicle.j1939 import Identifier, J1939Listener, identifier, parse_tag, special
from drivers.vehicle.spns import SPNS
from tests.drivers.can_frames import bam, timed

SPEED = Tag("speed", "spn:190", unit="rpm")
COOLANT = Tag("coolant", "spn:110", unit="degC")
CODES = Tag("codes", "dm1:codes", DType.STRING)
EEC1, ET1, CCVS, DM1 = 0x0CF00400, 0x18FEEE00, 0x18FEF100, 0x18FECA00

DBC = """VERSION ""
BU_: X
BO_ 2364540158 Engine1: 8 X
 SG_ Speed : 24|16@1+ (0.125,0) [0|8031.875] "rpm" X
 SG_ Torque : 16|8@1+ (1,-125) [-125|125] "%" X
BO_ 256 Short: 8 X
 SG_ Other : 0|8@1+ (1,0) [0|0] "" X
"""


def told(tags: Sequence[Tag], frames: Sequence[tuple[int, bytes]], **more: int) -> dict[str, Reading]:
    listener = J1939Listener(tags, **more)  # type: ignore[arg-type]
    return {one.tag.name: one.reading for frame in timed(frames, step=0.05) for one in listener.take(frame)}


def test_identifiers_are_taken_apart_as_broadcast_and_as_addressed() -> None:
    assert identifier(0x0CF00400) == Identifier(3, 0xF004, 0x00, 0xFF)
    assert identifier(0x18EA2103) == Identifier(6, 0xEA00, 0x03, 0x21)
    assert identifier(0x18FEF147) == Identifier(6, 0xFEF1, 0x47, 0xFF)
    assert identifier(0x19FEF147) == Identifier(6, 0x1FEF1, 0x47, 0xFF)


# Examples whose bytes and values are worked out by hand from J1939-71.
@pytest.mark.parametrize(
    ("spn", "number", "data", "value"),
    [
        (190, EEC1, "FFFFFF6813FFFFFF", 621.0),
        (513, EEC1, "F07D8C6813FFFFFF", 15),
        (899, EEC1, "F3FFFFFFFFFFFFFF", 3),
        (110, ET1, "7DFFFFFFFFFFFFFF", 85),
        (175, ET1, "FFFF202DFFFFFFFF", 88.0),
        (84, CCVS, "FF0050FFFFFFFFFF", 80.0),
        (70, CCVS, "F7FFFFFFFFFFFFFF", 1),
        (183, 0x18FEF200, "6400FFFFFFFFFFFF", 5.0),
        (168, 0x18FEF700, "FFFFFFFF1C02FFFF", 27.0),
        (247, 0x18FEE500, "40E20100FFFFFFFF", 6172.8),
        (917, 0x18FEC100, "40E20100FFFFFFFF", 617.28),
        (524, 0x18F00500, "80FFFFFFFFFFFFFF", 3),
        (96, 0x18FEFC00, "FF7DFFFFFFFFFFFF", 50.0),
    ],
)
def test_a_parameter_reads_as_the_standard_says(spn: int, number: int, data: str, value: float) -> None:
    reading = told([Tag("it", f"spn:{spn}")], [(number, bytes.fromhex(data))])["it"]
    assert reading == (pytest.approx(value), Quality.GOOD, "")


@pytest.mark.parametrize(
    ("raw", "bits", "quality"),
    [
        (0xFF, 8, Quality.NO_DATA), (0xFE, 8, Quality.SENSOR_FAILURE), (0xFB, 8, Quality.BAD), (0xFA, 8, None),
        (0xFF00, 16, Quality.NO_DATA), (0xFFFF, 16, Quality.NO_DATA), (0xFE12, 16, Quality.SENSOR_FAILURE),
        (0xFC00, 16, Quality.BAD), (0xFAFF, 16, None), (0xFFFFFFFF, 32, Quality.NO_DATA),
        (0xFE000000, 32, Quality.SENSOR_FAILURE), (0xFAFFFFFF, 32, None), (3, 2, Quality.NO_DATA),
        (2, 2, Quality.SENSOR_FAILURE), (1, 2, None), (15, 4, Quality.NO_DATA),
        (14, 4, Quality.SENSOR_FAILURE), (13, 4, None), (7, 3, Quality.NO_DATA), (6, 3, None), (1, 1, None),
    ],
)  # fmt: skip
def test_not_available_and_error_are_qualities(raw: int, bits: int, quality: Quality | None) -> None:
    found = special(raw, bits)
    assert (found and found[0]) == quality


@settings(max_examples=300)
@given(st.sampled_from(sorted(SPNS)), st.binary(min_size=8, max_size=8))
def test_no_bytes_give_a_good_number_beyond_what_the_standard_lets_a_parameter_say(spn: int, data: bytes) -> None:
    row = SPNS[spn]
    value, quality, _ = told([Tag("it", f"spn:{spn}")], [(0x18000000 | row.pgn << 8, data)])["it"]
    if quality.is_good:
        assert isinstance(value, int | float)
        raw = (value - row.offset) / row.scale
        most = 0xFB << row.bits - 8 if row.bits % 8 == 0 else (1 << row.bits) - (2 if row.bits in (2, 4) else 1)
        assert -1e-6 <= raw < most
    else:
        assert value is None


def test_the_table_has_no_parameter_that_overlaps_another() -> None:
    for one in SPNS.values():
        assert (one.byte - 1) * 8 + one.bit - 1 + one.bits <= 64
        for other in SPNS.values():
            if other is not one and other.pgn == one.pgn:
                first, second = sorted(((x.byte - 1) * 8 + x.bit - 1, x.bits) for x in (one, other))
                assert first[0] + first[1] <= second[0], (one, other)


def test_a_parameter_is_that_of_the_configured_source_or_of_the_one_in_the_address() -> None:
    frames = [(EEC1, bytes(8)), (EEC1 | 0x03, b"\0\0\0\x40\x1f\0\0\0")]
    assert told([SPEED], frames)["speed"][0] == 0.0
    assert told([SPEED], frames, source=3)["speed"][0] == 1000.0
    assert told([replace(SPEED, address="spn:190@03")], frames)["speed"][0] == 1000.0


def test_a_place_can_be_given_instead_of_a_number_of_the_table() -> None:
    tag = Tag("it", "pgn:F004/4.1/16", scale=0.125)
    assert told([tag], [(EEC1, b"\0\0\0\x40\x1f\0\0\0")])["it"][0] == 1000.0
    signed = Tag("it", "pgn:FF10/1/8", DType.INT8)
    assert told([signed], [(0x18FF1000, b"\x80" + bytes(7))])["it"][0] == -128


def test_a_message_too_short_for_the_parameter_is_no_value() -> None:
    value, quality, reason = told([SPEED], [(EEC1, bytes(4))])["speed"]
    assert (value, quality) == (None, Quality.DECODING_ERROR)
    assert reason == "the message has 4 bytes, and the value needs 5"


def test_a_signal_of_a_dbc_file_is_found_by_its_parameter_group_whatever_the_source(tmp_path: Path) -> None:
    path = tmp_path / "j.dbc"
    path.write_text(DBC)
    tags = [Tag("speed", "j1939:Engine1.Speed@05"), Tag("torque", "j1939:Engine1.Torque@05", DType.INT16)]
    listener = J1939Listener(tags, dbc=Dbc(path))
    (frame,) = timed([(0x0CF00405, bytes.fromhex("FFFF8C6813FFFFFF"))])
    assert {one.tag.name: one.reading[0] for one in listener.take(frame)} == {"speed": 621.0, "torque": 15}
    (absent,) = timed([(0x0CF00405, bytes.fromhex("FFFFFFFFFFFFFFFF"))])
    assert {one.reading[1] for one in listener.take(absent)} == {Quality.NO_DATA}
    with pytest.raises(AddressError, match="29-bit"):
        parse_tag(Tag("x", "j1939:Short.Other"), 0, Dbc(path))


DM1_ONE = bytes.fromhex("04FF6E000305FFFF")


def test_one_trouble_code_comes_in_one_frame_with_its_lamps() -> None:
    tags = [
        CODES,
        Tag("count", "dm1:count"),
        Tag("stop", "dm1:stop", DType.BOOL),
        Tag("warning", "dm1:warning", DType.BOOL),
    ]
    readings = told(tags, [(DM1, DM1_ONE)])
    assert readings["codes"] == ("SPN 110 FMI 3 OC 5", Quality.GOOD, "")
    assert (readings["count"][0], readings["stop"][0], readings["warning"][0]) == (1, False, True)


def test_several_trouble_codes_come_by_the_transport_protocol() -> None:
    payload = bytes.fromhex("4000") + bytes.fromhex("6E000305") + bytes.fromhex("64000181") + bytes.fromhex("FFFFF37F")
    readings = told([CODES], [(number | 0, data) for number, data in bam(payload, 0xFECA)])
    assert readings["codes"][0] == "SPN 110 FMI 3 OC 5; SPN ? FMI 1 OC 1; SPN 524287 FMI 19 OC 127"


def test_no_active_code_is_an_empty_list_and_a_lamp_that_is_not_available_no_state() -> None:
    tags = [CODES, Tag("count", "dm1:count"), Tag("mil", "dm1:mil", DType.BOOL)]
    readings = told(tags, [(DM1, bytes.fromhex("C0FF00000000FFFF"))])
    assert (readings["codes"][0], readings["count"][0]) == ("", 0)
    assert readings["mil"][:2] == (None, Quality.NO_DATA)


@pytest.mark.parametrize("conversion", [1, 2, 3])
def test_older_ways_to_write_an_spn_are_read_as_configured(conversion: int) -> None:
    spn, fmi = 0x5A5A5, 7
    top = spn & 7 if conversion < 3 else spn >> 16
    low, high = (spn >> 3 & 0xFF, spn >> 11) if conversion < 3 else (spn & 0xFF, spn >> 8 & 0xFF)
    pair = (high, low) if conversion == 1 else (low, high)
    quad = bytes([*pair, top << 5 | fmi, 0x80 | 9])
    (code,) = trouble_codes(b"\0\xff" + quad, conversion)
    assert (code.spn, code.fmi, code.occurrences) == (spn, fmi, 9)
    (unknown,) = trouble_codes(b"\0\xff" + quad)
    assert (unknown.spn, unknown.fmi) == (None, fmi)


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("spn:99999", "SPN 99999 is not in the table"),
        ("spn:x", "SPN x is not in the table"),
        ("pgn:F004/0/16", "is no place"),
        ("pgn:F004/4.9/16", "is no place"),
        ("pgn:F004/1/65", "is no place"),
        ("pgn:40000/1/8", "is no place"),
        ("spn:190@FE", "a source address is at most FD"),
        ("dm1:lamps", "dm1 has codes, count, protect, warning, stop, mil"),
        ("j1939:A.B", "needs a DBC file"),
    ],
)
def test_an_address_that_means_nothing_is_refused_with_what_would_be_right(address: str, words: str) -> None:
    with pytest.raises(AddressError, match=r"^it: ") as caught:
        parse_tag(Tag("it", address), 0, None)
    assert words in str(caught.value)


@settings(max_examples=150)
@given(
    st.lists(
        st.tuples(
            st.sampled_from([EEC1, DM1, 0x1CECFF00, 0x1CEBFF00, 0x1CEC0300, 0x1CEB0300, 0x123]), st.binary(max_size=8)
        ),
        max_size=80,
    )
)
def test_of_noise_every_frame_is_accounted_for_and_none_is_a_number_that_was_not_sent(
    noise: list[tuple[int, bytes]],
) -> None:
    listener = J1939Listener([SPEED, CODES, Tag("stop", "dm1:stop", DType.BOOL)])
    for frame in timed(noise):
        listener.take(frame)
    counts = listener.counts()
    transport = sum(count for name, count in counts.items() if name.startswith("tp_"))
    assert counts["frames"] == counts["single"] + counts["not_j1939"] + transport == len(noise)
