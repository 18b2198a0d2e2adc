"""Bit fields of CAN frames: the notation, and values against cantools as an independent decoder."""

import math
from dataclasses import replace

import pytest
from cantools.database.can import Message, Signal
from cantools.database.conversion import BaseConversion
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from drivers.can.fields import EXTENDED, Bits, Field, decode_value, encode_raw, frame_key, frame_name, parse_field
from drivers.errors import AddressError, EncodingError
from drivers.tag import DType, Order, Quality, Tag
from tests.drivers.can_frames import lies_in

CONTAINERS = {8: (DType.INT8, DType.UINT8), 16: (DType.INT16, DType.UINT16), 32: (DType.INT32, DType.UINT32)}


def signal_of(bits: Bits, *, signed: bool, scale: float = 1.0, offset: float = 0.0) -> Signal:
    order = "big_endian" if bits.motorola else "little_endian"
    conversion = BaseConversion.factory(scale=scale, offset=offset)
    return Signal("x", bits.start, bits.length, byte_order=order, is_signed=signed, conversion=conversion)


@st.composite
def places(draw: st.DrawFn) -> tuple[Bits, Tag]:
    motorola, length = draw(st.booleans()), draw(st.integers(1, 64))
    bits = Bits(draw(st.integers(0, 63)), length, motorola)
    assume(bits.end <= 64)
    size = next((size for size in CONTAINERS if length <= size), 64)
    pair = CONTAINERS.get(size, (DType.INT64, DType.UINT64))
    return bits, Tag("x", f"0x1:{bits.start}|{length}@{int(not motorola)}", pair[draw(st.integers(0, 1))])


@settings(max_examples=150)
@given(place=places(), data=st.binary(min_size=8, max_size=8))
def test_a_number_is_read_as_cantools_reads_it(place: tuple[Bits, Tag], data: bytes) -> None:
    bits, tag = place
    field = parse_field(tag)
    assert field.bits == bits
    signal = signal_of(bits, signed=tag.dtype.startswith("int"))
    expected = Message(1, "m", 8, [signal]).decode(data)["x"]
    assert decode_value(tag, field, data) == (expected, Quality.GOOD, "")


@settings(max_examples=100)
@given(place=places(), data=st.binary(min_size=8, max_size=8), raw=st.integers(0, 2**64 - 1))
def test_a_number_is_put_where_it_is_read_and_no_other_bit_moves(
    place: tuple[Bits, Tag], data: bytes, raw: int
) -> None:
    bits, tag = place
    raw &= (1 << bits.length) - 1
    put = bits.put(data, raw)
    assert bits.get(put) == raw
    assert bits.put(put, bits.get(data)) == data
    value, quality, _ = decode_value(tag, parse_field(tag), put)
    assert quality is Quality.GOOD
    assert value is not None
    assert encode_raw(tag, parse_field(tag), value) == raw


def test_the_notation_tells_eleven_bits_from_twenty_nine() -> None:
    assert parse_field(Tag("x", "0x181:0|8")).key == 0x181
    assert parse_field(Tag("x", "0x00000181:0|8")).key == 0x181 | EXTENDED
    assert parse_field(Tag("x", "0x18FEEE00:0|8")).key == 0x18FEEE00 | EXTENDED
    assert frame_name(frame_key(0x181, extended=True)) == "0x00000181"


def test_a_multiplexed_field_lies_only_in_frames_of_its_layout() -> None:
    field = parse_field(Tag("x", "0x181[0|8=3,15|4@0=1]:16|16"))
    assert lies_in(field, bytes((3, 0x10, 0, 0)))
    assert not lies_in(field, bytes((3, 0x20, 0, 0)))
    assert not lies_in(field, bytes((4, 0x10, 0, 0)))
    assert not lies_in(field, b"\x03")


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("holding:100", "give '0x181:16|16'"),
        ("0x800:0|8", "beyond 11 bits"),
        ("0x20000000:0|8", "beyond 29 bits"),
        ("0x181:0|0", "not in a frame"),
        ("0x181:505|16", "not in a frame"),
        ("0x181[3]:0|8", "such as [0|8=3]"),
        ("0x181[0|2=4]:8|8", "can never be met"),
        ("0x181:0|17", "do not fit a uint16"),
    ],
)
def test_an_address_that_no_frame_has_is_refused_with_what_would_be_right(address: str, words: str) -> None:
    with pytest.raises(AddressError) as caught:
        parse_field(Tag("level", address))
    assert words in str(caught.value)
    assert "level" in str(caught.value)


def test_a_type_that_cannot_lie_in_the_bits_is_refused() -> None:
    for tag in (
        Tag("x", "0x1:0|31", DType.FLOAT32),
        Tag("x", "0x1:0|8", DType.BCD16),
        Tag("x", "0x1:0|16", order=Order.CDAB),
        Tag("x", "0x1:4|16", DType.STRING, length=2),
        Tag("x", "0x1:0|16", scale=0.0),
    ):
        with pytest.raises(AddressError):
            parse_field(tag)


def test_floats_texts_flags_and_sentinels_mean_what_they_mean_on_every_other_link() -> None:
    def read(tag: Tag, data: bytes) -> object:
        return decode_value(tag, parse_field(tag), data)

    assert read(Tag("x", "0x1:8|32", DType.FLOAT32), b"\0\0\0\x75\x42") == (61.25, Quality.GOOD, "")
    assert read(Tag("x", "0x1:7|32@0", DType.FLOAT32), b"\x42\x75\0\0") == (61.25, Quality.GOOD, "")
    assert read(Tag("x", "0x1:8|24", DType.STRING, length=3), b"\0abc") == ("abc", Quality.GOOD, "")
    assert read(Tag("x", "0x1:15|24@0", DType.STRING, length=3), b"\0abc") == ("abc", Quality.GOOD, "")
    assert read(Tag("x", "0x1:9|1", DType.BOOL), b"\0\2") == (True, Quality.GOOD, "")
    assert read(Tag("x", "0x1:0|16", DType.BOOL, bit=9), b"\0\2") == (True, Quality.GOOD, "")
    assert read(Tag("x", "0x1:0|16", DType.BCD16), b"\x34\x12") == (1234, Quality.GOOD, "")
    nan = read(Tag("x", "0x1:0|32", DType.FLOAT32), b"\0\0\xc0\x7f")
    assert isinstance(nan, tuple)
    assert nan[:2] == (None, Quality.SENSOR_FAILURE)
    none = read(Tag("x", "0x1:0|16", sentinel=0xFFFF), b"\xff\xff")
    assert isinstance(none, tuple)
    assert none[:2] == (None, Quality.NO_DATA)


def test_a_frame_that_is_too_short_has_no_value() -> None:
    tag = Tag("x", "0x1:8|16")
    value, quality, reason = decode_value(tag, parse_field(tag), b"\1\2")
    assert (value, quality) == (None, Quality.DECODING_ERROR)
    assert reason == "the frame has 2 bytes, and the value needs 3"


@pytest.mark.parametrize(
    ("tag", "value"),
    [
        (Tag("x", "0x1:0|12"), 4096),
        (Tag("x", "0x1:0|12", DType.INT16), -2049),
        (Tag("x", "0x1:0|12", DType.INT16), 2048),
        (Tag("x", "0x1:0|8", high=10), 11),
        (Tag("x", "0x1:0|8"), math.nan),
        (Tag("x", "0x1:0|8", DType.UINT8), 256),
    ],
)
def test_a_value_that_its_bits_do_not_hold_is_refused(tag: Tag, value: float) -> None:
    with pytest.raises(EncodingError):
        encode_raw(tag, parse_field(tag), value)


def test_negative_numbers_of_odd_widths_keep_their_sign() -> None:
    for length in range(2, 17):
        tag = Tag("x", f"0x1:3|{length}", DType.INT16)
        field = parse_field(tag)
        for number in (-(2 ** (length - 1)), -1, 0, 2 ** (length - 1) - 1):
            data = field.bits.put(bytes(8), encode_raw(tag, field, number))
            assert decode_value(tag, field, data)[0] == number


def test_scale_and_offset_are_the_tags() -> None:
    tag = Tag("x", "0x1:0|16", DType.INT16, scale=0.01, offset=-5.0)
    field = parse_field(replace(tag))
    data = field.bits.put(bytes(2), encode_raw(tag, field, 12.34))
    assert decode_value(tag, field, data)[0] == pytest.approx(12.34)
    assert field == Field(1, Bits(0, 16))
