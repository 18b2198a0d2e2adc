"""The write-back block: it saturates, never wraps, and a reader with other code finds in it what was meant."""

import struct
from dataclasses import replace
from itertools import product
from math import inf, nan

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.machine.writing.block import SessionWords, Validity, build, next_heartbeat, read_numbers, validity
from gateway.settings.devices import WritebackLayout, load_device
from tests.gateway.support import MAP

_DEVICE = load_device(MAP)
assert _DEVICE.writeback is not None
LAYOUT: WritebackLayout = _DEVICE.writeback
NAMES = [field.name for field in LAYOUT.fields]
NUMBERS = [
    f for f in LAYOUT.fields if f.name in ("age", "temperature_now", "band_low", "horizon", "p_limit", "anomaly")
]


def session(sequence: int, heartbeat: int) -> SessionWords:
    return SessionWords(challenge=77, writer=4711, sequence=sequence, heartbeat=heartbeat)


def crc_by_bits(data: bytes) -> int:
    """CRC-16/IBM-3740 by its definition."""
    register = 0xFFFF
    for octet in data:
        register ^= octet << 8
        for _ in range(8):
            register = (register << 1 ^ (0x1021 if register & 0x8000 else 0)) & 0xFFFF
    return register


def read(words: tuple[int, ...]) -> dict[str, int]:
    return dict(zip(NAMES, words, strict=True))


def test_the_crc_is_ibm_3740() -> None:
    assert crc_by_bits(b"123456789") == 0x29B1
    block = build(LAYOUT, {"temperature_now": 45.12}, Validity.USABLE, session(7, 9))
    assert block.words[-2] == crc_by_bits(struct.pack(">24H", *block.words[:-2]))


def test_the_words_are_scaled_signed_and_framed() -> None:
    values = {"temperature_now": -3.25, "p_limit": 0.0125, "age": 1.26, "model_hash": 0xBEEF, "alarms": 0b10011}
    words = read(build(LAYOUT, values, Validity.USABLE | Validity.INPUTS, session(0xFFFF, 1)).words)
    assert words["layout_version"] == 2
    assert (words["sequence"], words["sequence_copy"], words["heartbeat"]) == (0xFFFF, 0xFFFF, 1)
    assert (words["challenge"], words["writer"]) == (77, 4711)
    assert words["temperature_now"] == 0x10000 - 325
    assert (words["p_limit"], words["age"]) == (12, 13)
    assert (words["model_hash"], words["alarms"], words["validity"]) == (0xBEEF, 0b10011, 3)


def test_what_is_not_known_has_a_word_of_its_own() -> None:
    words = read(build(LAYOUT, {"age": inf, "band_low": nan, "minutes_low": inf}, Validity.NONE, session(1, 1)).words)
    assert words["temperature_now"] == words["band_low"] == 0x8000
    assert words["location"] == words["age"] == 0xFFFF
    assert words["minutes_low"] == words["minutes_median"] == LAYOUT.unknown
    other = replace(LAYOUT, unknown=40_000)
    block = build(other, {"minutes_low": inf, "age": inf}, Validity.NONE, session(5, 1))
    words = read(block.words)
    assert (words["minutes_low"], words["minutes_median"], words["age"]) == (40_000, 40_000, 0xFFFF)
    assert block.sequence == 5


@settings(max_examples=200, deadline=None)
@given(st.sampled_from(NUMBERS), st.floats(allow_nan=False, allow_infinity=False))
def test_any_number_is_within_half_a_count_or_at_the_end_of_its_word(field: object, value: float) -> None:
    field = next(f for f in NUMBERS if f is field)
    word = read(build(LAYOUT, {field.name: value}, Validity.NONE, session(1, 1)).words)[field.name]
    low, high = (-0x7FFF, 0x7FFF) if field.signed else (0, 0xFFFE)
    raw = word - 0x10000 if field.signed and word & 0x8000 else word
    if value / field.scale <= low:
        assert raw == low
    elif value / field.scale >= high:
        assert raw == high
    else:
        assert abs(raw - value / field.scale) <= 0.5 + 1e-9


@settings(max_examples=100, deadline=None)
@given(st.dictionaries(st.sampled_from(NAMES), st.none() | st.floats()), st.integers(0, 65535), st.integers(1, 65535))
def test_whatever_is_said_the_frame_is_whole(values: dict[str, float | None], sequence: int, heartbeat: int) -> None:
    values = {n: v for n, v in values.items() if n not in ("alarms", "model_hash")}
    words = build(LAYOUT, values, Validity.NONE, session(sequence, heartbeat)).words
    assert len(words) == 26 and all(0 <= word <= 0xFFFF for word in words)
    assert words[1] == words[-1] == sequence
    assert words[-2] == crc_by_bits(struct.pack(">24H", *words[:-2]))


def test_every_word_is_read_as_the_number_that_makes_it() -> None:
    by_name = {field.name: field for field in LAYOUT.fields}
    numbers = tuple(by_name[name] for name in ("temperature_now", "p_limit", "minutes_low"))
    part = replace(LAYOUT, fields=(by_name["validity"], *numbers, by_name["crc"]), unknown=0xFFFF)
    for word in range(0x10000):
        read = read_numbers(part, (1, word, word, word, 2))
        signed = int.from_bytes(word.to_bytes(2, "big"), "big", signed=True)
        whole = (None if word == 0x8000 else signed, *[None if word == 0xFFFF else word] * 2)
        assert read == {
            each.name: None if count is None else count * each.scale for each, count in zip(numbers, whole, strict=True)
        }
        if word % 31 == 0:  # what makes them costs ten times as much
            assert build(part, read, Validity(1), session(1, 1)).words[1:4] == (word,) * 3
    assert read_numbers(replace(part, unknown=7), (1, 7, 7, 7, 2)) == {
        "temperature_now": pytest.approx(0.07),
        "p_limit": pytest.approx(0.007),
        "minutes_low": None,
    }
    with pytest.raises(ValueError, match="shorter"):
        read_numbers(part, (1, 2, 3))


@pytest.mark.parametrize("unknown", [0, 1, 300, 0xFFFE, 0xFFFF])
def test_minutes_that_are_known_are_never_the_word_for_those_that_are_not(unknown: int) -> None:
    layout = replace(LAYOUT, unknown=unknown)
    for count in {0, 1, 2, 299, 300, 301, 0xFFFD, 0xFFFE, 0xFFFF, 0x10000}:
        words = read(build(layout, {"minutes_low": count * 0.1}, Validity.NONE, session(1, 1)).words)
        told = min(count, 0xFFFE)
        assert words["minutes_low"] == (told if told != unknown else told - 1 if told else 1)
        assert words["minutes_median"] == unknown


def test_the_heartbeat_counts_from_1_to_65535_and_never_says_0() -> None:
    assert next_heartbeat(0) == 1
    assert next_heartbeat(65534) == 65535
    assert next_heartbeat(65535) == 1


def test_the_validity_word_says_each_part_and_usable_only_where_nothing_is_missing() -> None:
    parts = {"inputs": 2, "location": 4, "forecast": 8, "model": 16}
    for *there, familiar, shadow in product((False, True), repeat=6):
        known = dict(zip(parts, there, strict=True))
        wanted = sum(parts[name] for name, is_there in known.items() if is_there)
        wanted += 1 * (all(there) and familiar) + 32 * shadow
        assert validity(**known, familiar=familiar, shadow=shadow) == wanted
    assert validity(**dict.fromkeys(parts, True)) == 31, "familiar and written unless it is said otherwise"
