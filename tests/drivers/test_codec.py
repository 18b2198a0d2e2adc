import math
import struct
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.codec import decode, encode, encoder, judge, reader, register_count
from drivers.errors import AddressError, EncodingError
from drivers.tag import DType, Order, Quality, Tag, Value

# The types' own formats, most significant byte first: the reference that the codec is held against.
STRUCT = {
    DType.INT16: ">h",
    DType.UINT16: ">H",
    DType.INT32: ">i",
    DType.UINT32: ">I",
    DType.INT64: ">q",
    DType.UINT64: ">Q",
    DType.FLOAT32: ">f",
    DType.FLOAT64: ">d",
}
orders = st.sampled_from(list(Order))


def wire(payload: bytes, order: Order) -> list[int]:
    """Lay bytes A B C D .. into registers by the letters of the order, written out by hand."""
    pairs = [payload[i : i + 2] for i in range(0, len(payload), 2)]
    if order in (Order.CDAB, Order.DCBA):
        pairs.reverse()
    if order in (Order.BADC, Order.DCBA):
        pairs = [pair[::-1] for pair in pairs]
    return [pair[0] << 8 | pair[1] for pair in pairs]


def number_of(dtype: DType) -> st.SearchStrategy[int | float]:
    size = struct.calcsize(STRUCT[dtype])
    if dtype in (DType.FLOAT32, DType.FLOAT64):
        # Rarer magnitudes are believed by the order of their bytes too: tests/cases/wrong_word_order_was_good.
        least = struct.unpack(">f", struct.pack(">f", 1e-6 * (1 + 2**-23)))[0]
        most = struct.unpack(">f", struct.pack(">f", 1e12 * (1 - 2**-23)))[0]
        usual = st.floats(least, most, width=8 * size)
        return st.one_of(usual, usual.map(lambda number: -number), st.sampled_from([0.0, -0.0]))
    signed = STRUCT[dtype][1].islower()
    low = -(2 ** (8 * size - 1)) if signed else 0
    return st.integers(low, low + 2 ** (8 * size) - 1)


@pytest.mark.parametrize("dtype", STRUCT)
@settings(max_examples=60)
@given(data=st.data(), order=orders)
def test_every_number_in_every_order_decodes_as_struct_packs_it_and_encodes_back(
    dtype: DType, data: st.DataObject, order: Order
) -> None:
    number = data.draw(number_of(dtype))
    registers = wire(struct.pack(STRUCT[dtype], number), order)
    tag = Tag("x", "holding:0", dtype, order)
    value, quality, _ = decode(tag, registers)
    assert (value, quality) == (number, Quality.GOOD)
    assert type(value) is type(number)
    assert encode(tag, number) == registers
    assert len(registers) == register_count(tag)


def test_the_four_orders_of_one_number_by_hand() -> None:
    by_order = {
        Order.ABCD: [0x4148, 0xF5C3],
        Order.CDAB: [0xF5C3, 0x4148],
        Order.BADC: [0x4841, 0xC3F5],
        Order.DCBA: [0xC3F5, 0x4841],
    }
    for order, registers in by_order.items():
        value, _, _ = decode(Tag("x", "holding:0", DType.FLOAT32, order), registers)
        assert value == pytest.approx(12.56, rel=1e-7)


@settings(max_examples=60)
@given(number=st.integers(0, 255), order=orders)
def test_an_8_bit_number_lies_in_the_low_byte_or_with_swapped_bytes_in_the_high_byte(number: int, order: Order) -> None:
    other = 0xA5
    register = number << 8 | other if order in (Order.BADC, Order.DCBA) else other << 8 | number
    value, _, _ = decode(Tag("x", "holding:0", DType.UINT8, order), [register])
    assert value == number
    signed, _, _ = decode(Tag("x", "holding:0", DType.INT8, order), [register])
    assert signed == struct.unpack("b", bytes([number]))[0]
    assert decode(Tag("x", "holding:0", DType.UINT8, order), encode(Tag("x", "holding:0", DType.UINT8, order), number))[
        0
    ] == (number)


@settings(max_examples=60)
@given(register=st.integers(0, 65535), bit=st.integers(0, 15), order=orders)
def test_a_bit_is_counted_from_the_least_significant(register: int, bit: int, order: Order) -> None:
    tag = Tag("x", "holding:0", DType.BOOL, order, bit=bit)
    value, quality, _ = decode(tag, wire(struct.pack(">H", register), order))
    assert value is bool(register & 1 << bit)
    assert quality is Quality.GOOD


@settings(max_examples=60)
@given(number=st.integers(0, 99_999_999), order=orders)
def test_bcd_reads_its_digits(number: int, order: Order) -> None:
    tag = Tag("x", "holding:0", DType.BCD32, order)
    registers = wire(bytes.fromhex(f"{number:08d}"), order)
    assert decode(tag, registers) == (number, Quality.GOOD, "")
    assert encode(tag, number) == registers


@pytest.mark.parametrize("registers", [[0x00A0], [0xFFFF], [0x123F]])
def test_bcd_with_a_digit_above_nine_is_a_decoding_error(registers: list[int]) -> None:
    value, quality, reason = decode(Tag("x", "holding:0", DType.BCD16), registers)
    assert (value, quality) == (None, Quality.DECODING_ERROR)
    assert "binary-coded decimal" in reason


def test_a_bcd_sentinel_may_be_a_pattern_that_is_no_number() -> None:
    assert decode(Tag("x", "holding:0", DType.BCD16, sentinel=0xFFFF), [0xFFFF])[1] is Quality.NO_DATA
    assert decode(Tag("x", "holding:0", DType.BCD16, sentinel=4660), [0x1234])[0] == 1234


latin = st.text(st.characters(min_codepoint=1, max_codepoint=255), max_size=9)


@settings(max_examples=80)
@given(text=latin, order=orders)
def test_text_survives_and_only_its_bytes_may_be_swapped(text: str, order: Order) -> None:
    tag = Tag("x", "holding:0", DType.STRING, order, length=9)
    registers = encode(tag, text)
    assert len(registers) == 5
    assert decode(tag, registers) == (text.rstrip(" "), Quality.GOOD, "")
    swapped = order in (Order.BADC, Order.DCBA)
    assert struct.pack("<5H" if swapped else ">5H", *registers) == text.encode("latin-1").ljust(10, b"\0")


def test_text_ends_at_a_nul_and_loses_padding_blanks() -> None:
    tag = Tag("x", "holding:0", DType.STRING, length=6)
    assert decode(tag, [0x4142, 0x2020, 0x2020])[0] == "AB"
    assert decode(tag, [0x4142, 0x0058, 0x5858])[0] == "AB"


@settings(max_examples=100)
@given(
    raw=st.integers(0, 65535), scale=st.sampled_from([0.1, 0.01, 2.0, -0.5]), offset=st.sampled_from([0.0, -40.0, 7.5])
)
def test_scaled_numbers_are_floats_and_go_back_to_the_same_register(raw: int, scale: float, offset: float) -> None:
    tag = Tag("x", "holding:0", scale=scale, offset=offset)
    value, quality, _ = decode(tag, [raw])
    assert isinstance(value, float)
    assert value == raw * scale + offset
    assert quality is Quality.GOOD
    assert encode(tag, value) == [raw]


def test_a_scaled_value_is_rounded_to_the_tags_resolution() -> None:
    assert encode(Tag("x", "holding:0", scale=0.1), 23.46) == [235]


@pytest.mark.parametrize(
    ("dtype", "sentinel", "registers"),
    [
        (DType.UINT16, 65535, [0xFFFF]),
        (DType.INT16, -32768, [0x8000]),
        (DType.INT16, 0x8000, [0x8000]),
        (DType.INT32, 0x7FFFFFFF, [0x7FFF, 0xFFFF]),
        (DType.FLOAT32, -9999, list(struct.unpack(">2H", struct.pack(">f", -9999.0)))),
    ],
)
def test_the_sentinel_is_no_data_whatever_the_range_says(dtype: DType, sentinel: int, registers: list[int]) -> None:
    tag = Tag("x", "holding:0", dtype, scale=0.1, low=0, high=1, sentinel=sentinel)
    value, quality, reason = decode(tag, registers)
    assert (value, quality) == (None, Quality.NO_DATA)
    assert str(sentinel) in reason


def test_a_sentinel_in_a_register_of_bits_makes_no_bit_true() -> None:
    assert decode(Tag("x", "holding:0", DType.BOOL, bit=3, sentinel=65535), [65535])[:2] == (None, Quality.NO_DATA)


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_nan_and_infinity_are_a_failed_sensor_and_never_a_value(number: float) -> None:
    value, quality, reason = decode(
        Tag("x", "holding:0", DType.FLOAT32), list(struct.unpack(">2H", struct.pack(">f", number)))
    )
    assert (value, quality) == (None, Quality.SENSOR_FAILURE)
    assert str(number) in reason


def test_a_value_out_of_range_is_kept_and_marked() -> None:
    tag = Tag("x", "holding:0", DType.INT16, scale=0.1, unit="degC", low=-20, high=150)
    value, quality, reason = decode(tag, [1501])
    assert value == pytest.approx(150.1)
    assert quality is Quality.OUT_OF_RANGE
    assert reason == "150.1 degC is above the highest plausible value 150"
    assert decode(tag, [0xFF00])[1] is Quality.OUT_OF_RANGE


@settings(max_examples=60)
@given(limit=st.floats(0.015625, 1e6, width=32), decimals=st.integers(0, 3))
def test_a_value_exactly_at_its_limit_is_good(limit: float, decimals: int) -> None:
    limit = round(limit, decimals)
    tag = Tag("x", "holding:0", DType.FLOAT32, low=0, high=limit)
    assert decode(tag, encode(tag, limit))[1] is Quality.GOOD


def test_labels_name_values_and_an_unknown_code_is_out_of_range() -> None:
    tag = Tag("x", "holding:0", labels={0: "none", 3: "CRC"})
    assert decode(tag, [3]) == (3, Quality.GOOD, "")
    value, quality, reason = decode(tag, [9])
    assert (value, quality) == (9, Quality.OUT_OF_RANGE)
    assert "3 (CRC)" in reason
    assert encode(tag, "CRC") == [3]
    with pytest.raises(EncodingError, match="labelled"):
        encode(tag, 9)


def test_the_wrong_number_of_registers_is_a_decoding_error_and_no_exception() -> None:
    assert decode(Tag("x", "holding:0", DType.FLOAT32), [1])[:2] == (None, Quality.DECODING_ERROR)


def test_a_bool_register_is_true_unless_it_is_zero() -> None:
    tag = Tag("x", "coil:0", DType.BOOL)
    assert [decode(tag, [word])[0] for word in (0, 1, 0xFF00)] == [False, True, True]
    assert (encode(tag, True), encode(tag, False), encode(tag, 1)) == ([1], [0], [1])


@pytest.mark.parametrize(
    ("tag", "value", "sentence"),
    [
        (Tag("x", "holding:0"), 65536, "holds 0 to 65535"),
        (Tag("x", "holding:0"), -1, "holds 0 to 65535"),
        (Tag("x", "holding:0", DType.INT8), 128, "holds -128 to 127"),
        (Tag("x", "holding:0", DType.BCD16), 10_000, "holds 0 to 9999"),
        (Tag("x", "holding:0", DType.FLOAT32), 1e39, "beyond a float32"),
        (Tag("x", "holding:0", DType.FLOAT32), math.nan, "finite"),
        (Tag("x", "holding:0"), math.inf, "finite"),
        (Tag("x", "holding:0", DType.UINT64), 10**400, "finite"),
        (Tag("x", "holding:0", scale=1e-10), 1e305, "beyond any number"),
        (Tag("x", "holding:0"), True, "not a number"),
        (Tag("x", "holding:0"), "12", "not a number"),
        (Tag("x", "holding:0", high=100, unit="%"), 101, "101 % is above"),
        (Tag("x", "holding:0", sentinel=65535), 65535, "not available"),
        (Tag("x", "holding:0", DType.INT16, sentinel=0x8000), -32768, "not available"),
        (Tag("x", "holding:0", DType.BOOL), 2, "not a bool"),
        (Tag("x", "holding:0", DType.BOOL), "yes", "not a bool"),
        (Tag("x", "holding:0", DType.BOOL, bit=3), True, "other fifteen"),
        (Tag("x", "holding:0", DType.STRING, length=3), "four", "4 characters do not fit in 3"),
        (Tag("x", "holding:0", DType.STRING, length=3), "€", "Latin-1"),
        (Tag("x", "holding:0", DType.STRING, length=3), "a\0b", "NUL"),
        (Tag("x", "holding:0", DType.STRING, length=3), 3, "not text"),
    ],
)
def test_what_cannot_be_encoded_is_refused_in_one_sentence_that_names_the_tag(
    tag: Tag, value: float, sentence: str
) -> None:
    with pytest.raises(EncodingError, match=sentence) as caught:
        encode(tag, value)
    assert str(caught.value).startswith("x: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "tag",
    [
        Tag("x", "holding:0", DType.STRING),
        Tag("x", "holding:0", DType.BOOL, bit=16),
        Tag("x", "holding:0", DType.FLOAT32, bit=1),
        Tag("x", "holding:0", scale=0.0),
        Tag("x", "holding:0", scale=math.nan),
    ],
)
def test_a_tag_that_cannot_be_is_an_address_error(tag: Tag) -> None:
    with pytest.raises(AddressError, match="x: "):
        register_count(tag)


@given(data=st.data(), order=orders, words=st.lists(st.integers(0, 65535), min_size=1, max_size=4))
def test_a_reader_says_what_decode_says(data: st.DataObject, order: Order, words: list[int]) -> None:
    numbers = st.floats(-1e5, 1e5).map(lambda number: round(number, 2))
    limits = sorted(data.draw(st.lists(numbers, min_size=2, max_size=2)))
    tag = Tag(
        "t",
        "holding:0",
        data.draw(st.sampled_from([dtype for dtype in DType if dtype is not DType.STRING])),
        order,
        scale=data.draw(st.sampled_from([1.0, 0.1, -2.0, 1e304])),
        offset=data.draw(st.sampled_from([0.0, 0.5, 10.0])),
        low=data.draw(st.sampled_from([None, limits[0], 0.0])),
        high=data.draw(st.sampled_from([None, limits[1], 0.0])),
        sentinel=data.draw(st.sampled_from([None, -1, 0, 0xFFFF, words[0]])),
        labels=data.draw(st.sampled_from([{}, {1: "one"}])),
        unit="A",
    )
    for registers in (tuple(words), tuple(words[: register_count(tag)])):
        said, reference = reader(tag)(registers), decode(tag, registers)
        assert repr(said) == repr(reference) and type(said[0]) is type(reference[0])


def swapped(low: float, high: float) -> tuple[float, list[int]]:
    """A positive float32 in between, with its registers, that reads as a usual number with its words swapped."""
    for number in range(10, 100_000):
        first, second = struct.unpack(">2H", struct.pack(">f", number / 10.0))
        (value,) = struct.unpack(">f", struct.pack(">2H", second, first))
        if low < value < high:
            return value, [second, first]
    raise AssertionError("there is none")


@pytest.mark.parametrize(
    ("low", "high", "kept", "expecting"),
    [
        (1e-20, 1e-7, [{}, {"low": 0.0}, {"low": -1.0}, {"high": 1e6}], {"low": 1e-25}),
        (1e13, 1e20, [{}, {"high": 1e12}, {"low": 0.0}], {"high": 1e25}),
    ],
)
def test_a_rare_number_that_looks_swapped_is_believed_only_where_the_tag_expects_such(
    low: float, high: float, kept: list[dict[str, float]], expecting: dict[str, float]
) -> None:
    value, registers = swapped(low, high)
    for limits in kept:
        tag = Tag("x", "holding:0", DType.FLOAT32, **limits)  # type: ignore[arg-type]
        assert decode(tag, registers)[:2] == (None, Quality.DATA_ENCODING_INVALID), limits
        assert decode(tag, registers, one_order=True)[1] in (Quality.GOOD, Quality.OUT_OF_RANGE), limits
    expected = Tag("x", "holding:0", DType.FLOAT32, **expecting)  # type: ignore[arg-type]
    assert decode(expected, registers) == (value, Quality.GOOD, "")


WORDS = np.arange(0x10000, dtype=np.uint16)
FORMATS = {DType.INT8: np.int8, DType.UINT8: np.uint8, DType.INT16: np.int16, DType.UINT16: np.uint16}


@pytest.mark.parametrize("order", [Order.ABCD, Order.BADC])
@pytest.mark.parametrize("dtype", FORMATS)
def test_a_reader_gives_each_of_the_65536_words_the_number_that_it_is(dtype: DType, order: Order) -> None:
    """numpy says which number a word is."""
    numbers = (WORDS.byteswap() if order is Order.BADC else WORDS).astype(FORMATS[dtype])
    read = reader(Tag("t", "holding:0", dtype, order))
    values, qualities, reasons = zip(*(read((word,)) for word in range(0x10000)), strict=True)
    assert list(values) == numbers.tolist()
    assert (set(map(type, values)), set(qualities), set(reasons)) == ({int}, {Quality.GOOD}, {""})
    scaled = reader(Tag("t", "holding:0", dtype, order, scale=0.1, offset=-4.0, low=-50.0, high=90.0))
    some = slice(None, None, 37)
    values, qualities, _ = zip(*(scaled((word,)) for word in WORDS[some].tolist()), strict=True)
    wanted = numbers[some] * 0.1 - 4.0
    assert list(values) == wanted.tolist()
    assert [quality is Quality.GOOD for quality in qualities] == ((wanted >= -50.0) & (wanted <= 90.0)).tolist()


@pytest.mark.parametrize("order", [Order.ABCD, Order.BADC])
@pytest.mark.parametrize("dtype", [DType.INT16, DType.UINT16])
def test_an_encoder_writes_each_number_of_a_register_as_the_word_that_it_is(dtype: DType, order: Order) -> None:
    numbers = WORDS.astype(FORMATS[dtype])
    words = WORDS.byteswap() if order is Order.BADC else WORDS
    write = encoder(Tag("t", "holding:0", dtype, order))
    assert [write(number) for number in numbers.tolist()] == words[:, None].tolist()


KEYS: list[dict[str, Any]] = [
    {},
    {"scale": 0.5},
    {"scale": 2.0},
    {"offset": 1.0},
    {"low": 1.0},
    {"high": 9.0},
    {"sentinel": 0},
    {"sentinel": 0xFFFF},
    {"sentinel": -0x8000},
    {"labels": {1: "one"}},
    {"low": 1.0, "high": 9.0},
    {"bit": 3},
]
VALUES: list[Value] = [
    *(-0x8001, -0x8000, -0x7FFF, -1, 0, 1, 9, 10, 0x7FFE, 0x7FFF, 0x8000, 0xFFFE, 0xFFFF, 0x10000, 0x10001),
    *(0.0, 1.0, 1.4, -1.0, 65535.0, math.nan, math.inf, True, False, "one", "two"),
]


@pytest.mark.parametrize("more", KEYS, ids=str)
def test_an_encoder_writes_what_encode_writes(more: dict[str, Any]) -> None:
    """At the ends of every type, and with each key of a tag: the same words, or the same refusal."""

    def outcome(way: Callable[[], list[int]]) -> list[int] | str:
        try:
            return way()
        except EncodingError as error:
            return str(error)

    kinds = [DType.UINT16, DType.INT16, DType.UINT8, DType.INT32, DType.FLOAT32, DType.BOOL]
    for dtype, order in product([DType.UINT16, DType.INT16] if "bit" in more else kinds, Order):
        tag = Tag("t", "holding:1", dtype, order, **more)
        write = encoder(tag)
        for value in VALUES:
            written, wanted = outcome(partial(write, value)), outcome(partial(encode, tag, value))
            assert written == wanted, (dtype, order, value)


@pytest.mark.parametrize(
    ("tag", "words", "said"),
    [
        (Tag("T", "a", DType.INT16, sentinel=32767, other_sentinels=(-32768,)), [0x7FFF], "32767"),
        (Tag("T", "a", DType.INT16, sentinel=32767, other_sentinels=(0x8000,)), [0x8000], "32768"),
        (
            Tag("T", "a", DType.FLOAT32, sentinel=-9999.0),
            list(struct.unpack(">HH", struct.pack(">f", -9999.0))),
            "-9999",
        ),
        (
            Tag("T", "a", DType.FLOAT32, sentinel=-999.9),
            list(struct.unpack(">HH", struct.pack(">f", -999.9))),
            "-999.9",
        ),
    ],
)
def test_each_of_several_sentinels_is_no_value(tag: Tag, words: list[int], said: str) -> None:
    for read in (decode(tag, words), reader(tag)(words)):
        assert read[:2] == (None, Quality.NO_DATA) and said in read[2]
    with pytest.raises(EncodingError):
        encode(tag, tag.sentinels[-1])


def test_a_bit_beside_the_sentinel_is_a_bit_with_nothing_to_say() -> None:
    for more in ({"dtype": DType.BOOL}, {"dtype": DType.UINT16, "bit": 3}):
        tag = Tag("b", "holding:0", sentinel=0xFFFF, **more)  # type: ignore[arg-type]
        for word in (0, 1, 8, 9, 0xFFFE):
            wanted = bool(word & 8) if tag.bit is not None else bool(word)
            assert decode(tag, [word]) == (wanted, Quality.GOOD, "")
        assert decode(tag, [0xFFFF])[:2] == (None, Quality.NO_DATA)
        assert decode(replace(tag, sentinel=None), [0xFFFF]) == (True, Quality.GOOD, "")


@pytest.mark.parametrize(("unit", "scale"), [("", 1.0), ("A", 1.0), ("", 0.1), ("A", 0.1)])
def test_a_measured_number_with_an_empty_end_is_doubted_and_a_code_is_not(unit: str, scale: float) -> None:
    tag = Tag("n", "holding:0", DType.UINT32, unit=unit, scale=scale)
    value, quality, reason = decode(tag, [40, 0])
    assert value == (40 << 16) * scale
    assert quality is (Quality.UNCERTAIN if unit or scale != 1.0 else Quality.GOOD)
    if quality is Quality.UNCERTAIN:
        assert "only the highest register is in use; the words look swapped: as CDAB it reads" in reason
    assert decode(tag, [40, 1])[1] is Quality.GOOD is decode(tag, [0, 40])[1] is decode(tag, [0, 0])[1]
    assert decode(replace(tag, labels={40 << 16: "on"}), [40, 0])[1] in (Quality.GOOD, Quality.OUT_OF_RANGE)
    signed = replace(tag, dtype=DType.INT32)
    assert (decode(signed, [0xFFD8, 0xFFFF])[1] is Quality.UNCERTAIN) == bool(unit or scale != 1.0)
    assert decode(signed, [0xFFFF, 0xFFFF])[1] is Quality.GOOD is decode(signed, [0x7FD8, 0xFFFF])[1]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_least_and_the_largest_that_is_measured_is_written_and_read(sign: float) -> None:
    tag = Tag("f", "holding:0", DType.FLOAT64, low=-math.inf, high=math.inf)
    for number in (1e-30, 1e30):
        words = encode(tag, sign * number)
        assert struct.pack(">4H", *words) == struct.pack(">d", sign * number)
        assert decode(tag, words, one_order=True)[:2] == (sign * number, Quality.GOOD)
    below = encode(tag, sign * math.nextafter(1e-30, 0.0))
    assert struct.pack(">4H", *below) == struct.pack(">d", sign * 0.0)
    with pytest.raises(EncodingError, match="it would be stored as"):
        encode(tag, sign * math.nextafter(1e30, math.inf))
    assert decode(tag, list(struct.unpack(">4H", struct.pack(">d", sign * 9e-31))), one_order=True)[:2] == (
        None,
        Quality.DATA_ENCODING_INVALID,
    )


def test_what_is_swapped_is_named_by_what_must_be_swapped_back() -> None:
    payload = struct.pack(">f", 40.8)
    for read, sent in product(Order, repeat=2):
        tag = Tag("f", "holding:0", DType.FLOAT32, read, low=0.0, high=100.0)
        words = (read in (Order.CDAB, Order.DCBA)) != (sent in (Order.CDAB, Order.DCBA))
        octets = (read in (Order.BADC, Order.DCBA)) != (sent in (Order.BADC, Order.DCBA))
        swapped = " and ".join([*["words"] * words, *["bytes"] * octets])
        reason = decode(tag, wire(payload, sent))[2]
        assert f"; the {swapped} look swapped: as {sent} it reads 40.8; " in reason if swapped else reason == ""


@pytest.mark.parametrize("dtype", FORMATS)
def test_a_reader_gives_no_value_of_another_number_of_registers(dtype: DType) -> None:
    for tag in (Tag("t", "holding:0", dtype), Tag("t", "holding:0", dtype, sentinel=7)):
        for words in ([], [1, 2], [1, 2, 3]):
            value, quality, reason = reader(tag)(words)
            assert (value, quality) == (None, Quality.DECODING_ERROR)
            assert reason == f"{len(words)} registers for a {dtype}, which has 1"


def test_a_small_limit_is_drawn_as_wide_as_it_is_small() -> None:
    for limits in ({"high": 1e-6}, {"low": 0.0, "high": 1e-6}, {"low": -1e-6, "high": 0.0}, {"low": -1e-6}):
        tag = Tag("t", "holding:0", DType.FLOAT64, unit="m", **limits)  # type: ignore[arg-type]
        sign = 1.0 if limits.get("high") else -1.0
        assert judge(tag, sign * 1e-6) == (Quality.GOOD, "")
        assert judge(tag, sign * 1e-6 * (1 + 2**-24)) == (Quality.GOOD, "")
        quality, reason = judge(tag, sign * 1.001e-6)
        which = "above the highest" if sign > 0 else "below the lowest"
        assert (
            quality is Quality.OUT_OF_RANGE
            and reason == f"{sign * 1.001e-6:.6g} m is {which} plausible value {sign * 1e-6:g}"
        )
    for value in (True, False, "text"):
        assert judge(tag, value) == (Quality.GOOD, "")


@pytest.mark.parametrize("text", ["X", "MIXX", "XX XX", " x", "a b"])
def test_of_a_text_only_blanks_at_its_end_are_padding(text: str) -> None:
    tag = Tag("t", "holding:0", DType.STRING, length=len(text))
    assert register_count(tag) == (len(text) + 1) // 2
    words = encode(tag, text)
    assert decode(tag, words) == (text, Quality.GOOD, "")
    if len(text) % 2 == 0:
        assert decode(replace(tag, length=len(text) + 2), [*words, 0x2020]) == (text, Quality.GOOD, "")
