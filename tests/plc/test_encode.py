"""The PLC's register words against plain `struct`."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.tag import DType, Order, Tag
from sim.plc.program.encoding import (
    Unrepresentable,
    decode,
    encode,
    encode_absent,
    resolution,
    value_at_rest,
    words_of_type,
)

WHOLE = {
    DType.INT16: "h",
    DType.UINT16: "H",
    DType.INT32: "i",
    DType.UINT32: "I",
    DType.INT64: "q",
    DType.UINT64: "Q",
}
# order -> (bytes swapped in each register, registers reversed)
ORDERS = {
    Order.ABCD: (False, False),
    Order.CDAB: (False, True),
    Order.BADC: (True, False),
    Order.DCBA: (True, True),
}
orders = st.sampled_from(list(Order))


def reference(octets: bytes, order: Order) -> list[int]:
    swapped, reversed_words = ORDERS[order]
    pairs = [octets[index : index + 2] for index in range(0, len(octets), 2)]
    words = [int.from_bytes(pair[::-1] if swapped else pair, "big") for pair in pairs]
    return words[::-1] if reversed_words else words


@given(st.sampled_from(list(WHOLE)), orders, st.data())
def test_whole_numbers_lie_as_struct_packs_them(dtype: DType, order: Order, data: st.DataObject) -> None:
    size = struct.calcsize(WHOLE[dtype]) * 8
    low, high = (-(2 ** (size - 1)), 2 ** (size - 1) - 1) if WHOLE[dtype].islower() else (0, 2**size - 1)
    raw = data.draw(st.integers(low, high))
    tag = Tag("t", "holding:0", dtype, order)
    words = encode(tag, raw)
    assert words == reference(struct.pack(f">{WHOLE[dtype]}", raw), order)
    assert decode(tag, words) == raw


@given(st.sampled_from([(DType.FLOAT32, 32, "f"), (DType.FLOAT64, 64, "d")]), orders, st.data())
def test_floats_lie_as_struct_packs_them(kind: tuple[DType, int, str], order: Order, data: st.DataObject) -> None:
    dtype, width, letter = kind
    value = data.draw(st.floats(width=width, allow_nan=False, allow_infinity=False))
    tag = Tag("t", "holding:0", dtype, order)
    words = encode(tag, value)
    assert words == reference(struct.pack(f">{letter}", value), order)
    assert decode(tag, words) == value


@given(orders, st.integers(0, 99_999_999))
def test_bcd_has_one_digit_a_nibble(order: Order, number: int) -> None:
    assert encode(Tag("t", "holding:0", DType.BCD32, order), number) == reference(bytes.fromhex(f"{number:08d}"), order)
    assert encode(Tag("t", "holding:0", DType.BCD16, Order.ABCD), number % 10_000) == [int(f"{number % 10_000}", 16)]


@given(
    st.sampled_from([Order.ABCD, Order.BADC]), st.text(st.characters(min_codepoint=33, max_codepoint=126), max_size=9)
)
def test_a_string_fills_registers_from_the_left(order: Order, text: str) -> None:
    tag = Tag("t", "holding:0", DType.STRING, order, length=9)
    words = encode(tag, text)
    assert len(words) == words_of_type(tag) == 5
    assert words == reference(text.encode().ljust(10, b"\0"), order)
    assert decode(tag, words) == text


@pytest.mark.parametrize(("dtype", "value", "word"), [(DType.INT8, -2, 0x00FE), (DType.UINT8, 254, 0x00FE)])
def test_an_8_bit_number_lies_in_the_low_byte(dtype: DType, value: int, word: int) -> None:
    assert encode(Tag("t", "holding:0", dtype), value) == [word]


@given(st.floats(-3000, 3000), st.sampled_from([0.1, 0.01, -0.5, 2.0]), st.floats(-50, 50))
def test_a_scaled_value_comes_back_within_its_resolution(value: float, scale: float, offset: float) -> None:
    tag = Tag("t", "holding:0", DType.INT32, scale=scale, offset=offset)
    back = decode(tag, encode(tag, value))
    assert isinstance(back, int | float)
    absolute, relative = resolution(tag)
    assert abs(back - value) <= absolute + relative * max(abs(back), abs(value)) + 1e-9


@pytest.mark.parametrize(
    ("tag", "value", "nearest"),
    [
        (Tag("t", "holding:0", DType.UINT16, scale=0.1), -0.3, [0]),
        (Tag("t", "holding:0", DType.UINT16, scale=0.1), 7000.0, [65535]),
        (Tag("t", "holding:0", DType.UINT16, scale=0.1, sentinel=65535), 6553.5, [65534]),
        (Tag("t", "holding:0", DType.INT16, sentinel=-32768), -40000, [0x8001]),
        (Tag("t", "holding:0", DType.BCD16), 10_000, [0x9999]),
        (Tag("t", "holding:0", DType.FLOAT32), 1e39, [0x7F7F, 0xFFFF]),
        (Tag("t", "holding:0", DType.STRING, length=2), "abc", [0x6162]),
    ],
)
def test_a_value_that_does_not_fit_names_what_comes_nearest(tag: Tag, value: float, nearest: list[int]) -> None:
    with pytest.raises(Unrepresentable) as caught:
        encode(tag, value)
    assert list(caught.value.nearest) == nearest


@pytest.mark.parametrize(
    ("tag", "words"),
    [
        (Tag("t", "holding:0", DType.UINT16, sentinel=65535), [0xFFFF]),
        (Tag("t", "holding:0", DType.INT16, sentinel=-32768), [0x8000]),
        (Tag("t", "holding:0", DType.INT16, sentinel=0x8000), [0x8000]),
        (Tag("t", "holding:0", DType.INT32, Order.CDAB, sentinel=-2), [0xFFFE, 0xFFFF]),
        (Tag("t", "holding:0", DType.BCD16, sentinel=0xFFFF), [0xFFFF]),
        (Tag("t", "holding:0", DType.UINT16), [0]),
    ],
)
def test_a_tag_without_a_value_holds_its_sentinel_or_zero(tag: Tag, words: list[int]) -> None:
    assert encode_absent(tag) == words
    assert (value_at_rest(tag) is None) == (tag.sentinel is not None)
    assert decode(tag, words) == value_at_rest(tag)


def test_a_float_without_a_value_is_nan() -> None:
    tag = Tag("t", "holding:0", DType.FLOAT32)
    (value,) = struct.unpack(">f", struct.pack(">2H", *encode_absent(tag)))
    assert math.isnan(value)
    assert value_at_rest(tag) is None
