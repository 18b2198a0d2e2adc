"""Registers to values and back: type, byte and word order, bit, scale, sentinel, range, labels (pure).

A reading never raises: what the device sent is data, and data that means nothing has a quality and a reason. A value
to be written that does not fit raises EncodingError before anything is sent.

Bytes in a wrong order are numbers too, mostly such as nobody measures. What tells them apart is here, once, for
readings and for `plc guess`: a float beyond MEASURABLE_MAGNITUDES is never believed; a rarer one
(_PLAUSIBLE_MAGNITUDES) is not as long as another order makes a usual number of the same registers.
"""

import math
import struct
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

from drivers.errors import AddressError, EncodingError
from drivers.tag import DType, Order, Quality, Tag, Value

Reading = tuple[Value | None, Quality, str]

_SWAPPED_BYTES = frozenset({Order.BADC, Order.DCBA})
_SWAPPED_WORDS = frozenset({Order.CDAB, Order.DCBA})
# dtype -> bits, signed. An 8-bit number fills the low byte of one register.
_INTEGERS: dict[DType, tuple[int, bool]] = {
    DType.INT8: (8, True),
    DType.UINT8: (8, False),
    DType.INT16: (16, True),
    DType.UINT16: (16, False),
    DType.INT32: (32, True),
    DType.UINT32: (32, False),
    DType.INT64: (64, True),
    DType.UINT64: (64, False),
}
_FLOATS: dict[DType, str] = {DType.FLOAT32: ">f", DType.FLOAT64: ">d"}
_BCD_DIGITS: dict[DType, int] = {DType.BCD16: 4, DType.BCD32: 8}
_REGISTERS: dict[DType, int] = ({DType.BOOL: 1, DType.FLOAT32: 2, DType.FLOAT64: 4, DType.BCD16: 1, DType.BCD32: 2}) | {
    dtype: max(1, bits // 16) for dtype, (bits, _) in _INTEGERS.items()
}
_BIT_HOLDERS = frozenset({DType.BOOL, DType.UINT16, DType.INT16})
# A limit is met by the value nearest to it: float32 rounds by up to 2**-24 of the value, scaling by less.
_LIMIT_SLACK = 2.0**-23
_LARGEST = sys.float_info.max
MEASURABLE_MAGNITUDES = (1e-30, 1e30)
"""The magnitudes of measured numbers, in whatever unit, beside 0 itself: the radius of an electron in km is 3e-18, the
mass of the sun in kg 2e30. A float that is smaller (subnormal ones are) or larger is bytes in another order."""
_PLAUSIBLE_MAGNITUDES = (1e-6, 1e12)
"""Magnitudes of a float beyond which another order is asked, and _USUAL_MAGNITUDES, those that it must have to be
believed."""
_USUAL_MAGNITUDES = (1e-3, 1e6)
# The commonest first.
_SEVERAL_REGISTERS = (Order.ABCD, Order.CDAB, Order.BADC, Order.DCBA)
_ONE_REGISTER = (Order.ABCD, Order.BADC)


def integer_range(dtype: DType) -> tuple[int, int] | None:
    """The least and the largest number of an integer or BCD type; None for any other."""
    if dtype in _BCD_DIGITS:
        return 0, 10 ** _BCD_DIGITS[dtype] - 1
    if dtype not in _INTEGERS:
        return None
    bits, signed = _INTEGERS[dtype]
    return (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if signed else (0, 2**bits - 1)


def register_count(tag: Tag) -> int:
    """How many 16-bit registers the tag covers (1..). Raises AddressError for a bit or a length that cannot be."""
    if tag.bit is not None:
        if tag.dtype not in _BIT_HOLDERS:
            raise AddressError(f"{tag.name}: one bit is of dtype bool, not {tag.dtype}")
        if not 0 <= tag.bit <= 15:
            raise AddressError(f"{tag.name}: bit {tag.bit} is not in a register, which has bits 0 to 15")
    if tag.scale == 0.0 or not (math.isfinite(tag.scale) and math.isfinite(tag.offset)):
        raise AddressError(f"{tag.name}: scale {tag.scale} and offset {tag.offset} must be finite, and scale not 0")
    if tag.dtype is DType.STRING:
        if tag.length < 1:
            raise AddressError(f"{tag.name}: a string needs its length in bytes (length = 1 or more)")
        return (tag.length + 1) // 2
    return _REGISTERS[tag.dtype]


def decode(tag: Tag, registers: Sequence[int], *, one_order: bool = False) -> Reading:
    """Give the tag's engineering value, its quality and, unless good, the reason.

    `registers` are exactly the tag's own (0..65535 each; a coil or discrete input is one of 0 or 1). An integer type
    with scale 1 and offset 0 gives int, any other number float. OUT_OF_RANGE keeps the value, as does
    UNCERTAIN (an integer that looks swapped); NO_DATA (sentinel), SENSOR_FAILURE (NaN, infinite), DECODING_ERROR (not a
    code of this type) and DATA_ENCODING_INVALID (a float that nobody measures, or that looks swapped) give None.
    `one_order`: the bytes come from where no other order is possible, so that none is suspected.
    """
    needed = register_count(tag)
    if len(registers) != needed:
        return None, Quality.DECODING_ERROR, f"{len(registers)} registers for a {tag.dtype}, which has {needed}"
    # The registers' bytes, most significant first.
    words = reversed(registers) if _swaps_words(tag) else registers
    payload = struct.pack(f"{_endian(tag)}{needed}H", *words)
    if tag.dtype is DType.STRING:
        # Devices end a text with NUL or fill it up with blanks, and after the NUL anything may stand.
        text = payload[: tag.length].split(b"\0", 1)[0].decode("latin-1").rstrip(" ")
        return text, Quality.GOOD, ""
    if tag.bit is not None or tag.dtype is DType.BOOL:
        register = int.from_bytes(payload, "big")
        if tag.sentinel is not None and register in tag.sentinels:
            return None, Quality.NO_DATA, _not_available(register)
        return bool(register >> tag.bit & 1 if tag.bit is not None else register), Quality.GOOD, ""
    raw, reason = _RAW[tag.dtype](tag, payload)
    if raw is None:
        return None, Quality.DECODING_ERROR, reason
    # The sentinel is a raw number: it is looked for before scale and offset.
    if tag.sentinel is not None and (said := _find_sentinel(tag, raw)) is not None:
        return None, Quality.NO_DATA, _not_available(said)
    # Other orders are looked at for what cannot be, not for each of the many readings that can.
    looks = partial(_order_hint, tag, () if one_order else registers)
    if not math.isfinite(raw):
        # What a device sends on purpose has nothing but zeros behind its first register.
        return None, Quality.SENSOR_FAILURE, f"the device sent {raw}{looks() if any(payload[2:]) else ''}"
    if tag.dtype in _FLOATS:
        if reason := _unmeasurable(raw):
            return None, Quality.DATA_ENCODING_INVALID, f"the device sent {reason}{looks()}"
        if _is_rare(tag, raw) and (reason := looks()):
            remedy = "; a tag that can have such values says so by low and high"
            return None, Quality.DATA_ENCODING_INVALID, f"the device sent {_short(raw)}{reason}{remedy}"
    # A plain integer stays an int: times 1.0 it would be a float, exact only up to 2**53.
    value = raw if tag.scale == 1.0 and tag.offset == 0.0 else raw * tag.scale + tag.offset
    if not math.isfinite(value):
        return None, Quality.DECODING_ERROR, f"{raw} times scale {tag.scale} is beyond any number"
    quality, reason = judge(tag, value)
    if quality is Quality.OUT_OF_RANGE and tag.low is not None and tag.high is not None:
        reason += looks()
    elif quality is Quality.GOOD and _has_empty_end(tag, payload) and (swapped := looks()):
        quality, reason = Quality.UNCERTAIN, f"of {_short(value)} only the highest register is in use{swapped}"
    return value, quality, reason


def reader(tag: Tag) -> Callable[[Sequence[int]], Reading]:
    """`decode` for one tag, what depends on the tag alone worked out once.

    An integer of one register is read here as long as it is plainly good; all else is `decode`'s, which stays the
    definition of both.
    """
    if tag.dtype not in _INTEGERS or tag.bit is not None or tag.labels or register_count(tag) != 1:
        return partial(decode, tag)
    (bits, signed), swapped, sentinel = _INTEGERS[tag.dtype], _endian(tag) == "<", tag.sentinel
    mask, sign = (1 << bits) - 1, 1 << bits - 1 if signed else 1 << bits
    scale, offset, plain = tag.scale, tag.offset, tag.scale == 1.0 and tag.offset == 0.0
    low = -math.inf if tag.low is None else tag.low
    high = math.inf if tag.high is None else tag.high

    def read(registers: Sequence[int]) -> Reading:
        if sentinel is None and len(registers) == 1:
            word = registers[0]
            raw = (word >> 8 | (word & 0xFF) << 8 if swapped else word) & mask
            if raw >= sign:
                raw -= mask + 1
            value = raw if plain else raw * scale + offset
            # Between the very limits, which are drawn a little wider: that, and infinity, are decode's to judge.
            if low <= value <= high and math.isfinite(value):
                return value, Quality.GOOD, ""
        return decode(tag, registers)

    return read


def encoder(tag: Tag) -> Callable[[Value], list[int]]:
    """`encode` for one tag, what depends on the tag alone worked out once.

    A whole number of one register without scale, range, labels or sentinel is written here as long as it fits; all else
    is `encode`'s, which stays the definition of both.
    """
    plain = tag.scale == 1.0 and tag.offset == 0.0 and tag.low is None and tag.high is None and tag.sentinel is None
    if not plain or tag.dtype not in (DType.UINT16, DType.INT16) or tag.bit is not None or tag.labels:
        return partial(encode, tag)
    low, high = (0, 0xFFFF) if tag.dtype is DType.UINT16 else (-0x8000, 0x7FFF)
    swapped = _endian(tag) == "<"

    def words(value: Value) -> list[int]:
        if type(value) is not int or not low <= value <= high:
            return encode(tag, value)
        word = value & 0xFFFF
        return [word >> 8 | (word & 0xFF) << 8 if swapped else word]

    return words


def judge(tag: Tag, value: Value) -> tuple[Quality, str]:
    """Give the quality of an engineering value by the tag's range and labels: GOOD or OUT_OF_RANGE, with the reason."""
    if isinstance(value, bool | str):
        return Quality.GOOD, ""
    if (limit := _broken_limit(tag, value)) is not None:
        return Quality.OUT_OF_RANGE, f"{value:.6g} {tag.unit}".rstrip() + f" is {limit}"
    if tag.labels and value not in tag.labels:
        return Quality.OUT_OF_RANGE, f"{value} is not one of the labelled values {_list(tag.labels)}"
    return Quality.GOOD, ""


def encode(tag: Tag, value: Value) -> list[int]:
    """Give the registers that hold the engineering value, rounded to the tag's resolution.

    A labelled value may be given by its label. Raises EncodingError for a wrong type, a value out of the type's or the
    tag's range, NaN or infinity, a number that would read as "not available", and one bit of a register.
    """
    register_count(tag)
    if tag.bit is not None:
        raise EncodingError(f"{tag.name}: one bit of a register cannot be written without touching the other fifteen")
    if tag.dtype is DType.STRING:
        payload = _text_bytes(tag, value)
    elif tag.dtype is DType.BOOL:
        if isinstance(value, str) or value not in (0, 1):
            raise EncodingError(f"{tag.name}: {value!r} is not a bool")
        payload = struct.pack(">H", int(value))
    else:
        payload = _number_bytes(tag, value)
    words = struct.unpack(f"{_endian(tag)}{len(payload) // 2}H", payload)
    return list(reversed(words)) if _swaps_words(tag) else list(words)


# ---------------------------------------------------------------- order


def _endian(tag: Tag) -> str:
    return "<" if tag.order in _SWAPPED_BYTES else ">"


def _swaps_words(tag: Tag) -> bool:
    # Text and single registers know no word order; of text only the bytes within a register are ever swapped.
    return tag.order in _SWAPPED_WORDS and tag.dtype is not DType.STRING


# ---------------------------------------------------------------- numbers that nobody measures


def _unmeasurable(number: float) -> str:
    """The number and why nobody measures it; "" for one that may be measured. Both zeros may."""
    low, high = MEASURABLE_MAGNITUDES
    if number == 0 or low <= abs(number) <= high:
        return ""
    return f"{_short(number)}, {'smaller' if abs(number) < low else 'larger'} than anything measured"


def _is_rare(tag: Tag, raw: float) -> bool:
    """True for a float so small or large that another order is to be suspected first, and the tag does not expect it.

    A lowest plausible value above 0 is the word of somebody who expects small ones; a highest one that is large, large.
    """
    if abs(raw) < _PLAUSIBLE_MAGNITUDES[0]:
        return raw != 0 and not (tag.low is not None and tag.low > 0)
    return abs(raw) > _PLAUSIBLE_MAGNITUDES[1] and not (tag.high is not None and tag.high > _PLAUSIBLE_MAGNITUDES[1])


def _has_empty_end(tag: Tag, payload: bytes) -> bool:
    """True for a measured integer of several registers of which only the highest says anything.

    The rest is 0, or all ones under a sign: of what moves one reading in 65536, of a small number with swapped words
    each. Bits and codes, which have no unit and no scale, may stand at such a number.
    """
    if tag.dtype in _FLOATS or len(payload) < 4 or tag.labels or not (tag.unit or tag.scale != 1.0):
        return False
    top, rest = payload[:2], payload[2:]
    return (not any(rest) and any(top)) or (set(rest) == {0xFF} and top[0] >= 0x80 and top != b"\xff\xff")


def other_order(tag: Tag, registers: Sequence[int], believed: Callable[[float], bool]) -> str:
    """Say which other order makes a `believed` engineering value of the registers; "" if none.

    As "the words look swapped: as CDAB it reads 40.8". Of several a number with one decimal wins, which no wrong order
    makes by chance, then the commonest order.
    """
    found: list[tuple[bool, Order, float]] = []
    for order in _SEVERAL_REGISTERS if len(registers) > 1 else _ONE_REGISTER:
        other = replace(tag, order=order)
        words = reversed(registers) if _swaps_words(other) else registers
        raw, _ = _RAW[tag.dtype](other, struct.pack(f"{_endian(other)}{len(registers)}H", *words))
        value = math.nan if raw is None or order is tag.order else raw * tag.scale + tag.offset
        if math.isfinite(value) and believed(value):
            found.append((abs(value - round(value, 1)) > 1e-6 * abs(value), order, value))
    if not found:
        return ""
    _, order, value = min(found, key=lambda one: one[0])
    moved = {"words": _SWAPPED_WORDS, "bytes": _SWAPPED_BYTES}
    swapped = " and ".join(name for name, orders in moved.items() if (tag.order in orders) != (order in orders))
    return f"the {swapped} look swapped: as {order} it reads {_short(value)}"


def _order_hint(tag: Tag, registers: Sequence[int]) -> str:
    """What `other_order` says of usual numbers in the tag's range, to be added to a reason; "" if none."""
    if not registers:
        return ""
    reason = other_order(
        tag,
        registers,
        lambda value: _USUAL_MAGNITUDES[0] <= abs(value) <= _USUAL_MAGNITUDES[1] and _broken_limit(tag, value) is None,
    )
    return reason and f"; {reason}"


def _short(number: float) -> str:
    """Four digits with a decimal point or an exponent, by which a log knows what changes from reading to reading."""
    return f"{float(f'{number:.4g}')}"


# ---------------------------------------------------------------- values to bytes, bytes to raw numbers


def _text_bytes(tag: Tag, value: Value) -> bytes:
    if not isinstance(value, str):
        raise EncodingError(f"{tag.name}: {value!r} is not text")
    try:
        text = value.encode("latin-1")
    except UnicodeEncodeError as error:
        raise EncodingError(f"{tag.name}: {value[error.start]!r} is not a Latin-1 character") from None
    if len(text) > tag.length:
        raise EncodingError(f"{tag.name}: {len(text)} characters do not fit in {tag.length}")
    if b"\0" in text:
        raise EncodingError(f"{tag.name}: a NUL character would cut the text short")
    return text.ljust(2 * register_count(tag), b"\0")


def _number_bytes(tag: Tag, value: Value) -> bytes:
    number: int | float
    if isinstance(value, str) and value in tag.labels.values():
        number = next(number for number, label in tag.labels.items() if label == value)
    elif isinstance(value, bool | str):
        raise EncodingError(f"{tag.name}: {value!r} is not a number, which a {tag.dtype} needs")
    elif abs(value) <= _LARGEST:  # False for NaN as well, which compares with nothing
        number = value
    else:
        raise EncodingError(f"{tag.name}: it must be a finite number, not {value!r}")
    if (limit := _broken_limit(tag, number)) is not None:
        raise EncodingError(f"{tag.name}: {number:.6g} {tag.unit}".rstrip() + f" is {limit}")
    if tag.labels and number not in tag.labels:
        raise EncodingError(f"{tag.name}: {value!r} is not one of the labelled values {_list(tag.labels)}")
    plain = tag.scale == 1.0 and tag.offset == 0.0
    raw = number if plain else (number - tag.offset) / tag.scale
    if abs(raw) > _LARGEST:
        raise EncodingError(f"{tag.name}: {value!r} is beyond any number that a device holds")
    if tag.dtype in _FLOATS:
        # What is smaller than anything measured is a remainder of somebody's arithmetic, and would not be believed.
        raw = math.copysign(0.0, raw) if abs(raw) < MEASURABLE_MAGNITUDES[0] else float(raw)
        try:
            payload = struct.pack(_FLOATS[tag.dtype], raw)
        except OverflowError:
            raise EncodingError(f"{tag.name}: {raw:.6g} is beyond a {tag.dtype}") from None
        if reason := _unmeasurable(raw):
            raise EncodingError(f"{tag.name}: it would be stored as {reason}")
    else:
        count = round(raw)
        low, high = integer_range(tag.dtype) or (0, 0)
        if not low <= count <= high:
            raise EncodingError(f"{tag.name}: it would be stored as {count}, and a {tag.dtype} holds {low} to {high}")
        if tag.dtype in _BCD_DIGITS:
            # Binary-coded decimal: the decimal digits, read as hexadecimal ones.
            payload = int(str(count), 16).to_bytes(_BCD_DIGITS[tag.dtype] // 2, "big")
        else:
            # Modulo 2**bits is two's complement; an 8-bit number fills the low byte of one register.
            bits = _INTEGERS[tag.dtype][0]
            payload = (count % (1 << bits)).to_bytes(max(2, bits // 8), "big")
    # Read back as a device would: what was rounded may have become the very number that says "not available".
    stored, _ = _RAW[tag.dtype](tag, payload)
    if stored is not None and (said := _find_sentinel(tag, stored)) is not None:
        raise EncodingError(f'{tag.name}: {value!r} is stored as {said}, which says "not available"')
    return payload


def _raw_integer(tag: Tag, payload: bytes) -> tuple[int | float | None, str]:
    bits, signed = _INTEGERS[tag.dtype]
    return int.from_bytes(payload[-1:] if bits == 8 else payload, "big", signed=signed), ""


def _raw_float(tag: Tag, payload: bytes) -> tuple[int | float | None, str]:
    (number,) = struct.unpack(_FLOATS[tag.dtype], payload)
    return float(number), ""


def _raw_bcd(tag: Tag, payload: bytes) -> tuple[int | float | None, str]:
    digits = payload.hex()
    if digits.isdecimal():
        return int(digits), ""
    # A pattern that is no number can still be the device's sign for "not available" (0xFFFF).
    pattern = int(digits, 16)
    return (pattern, "") if pattern in tag.sentinels else (None, f"0x{digits} is not binary-coded decimal")


_RAW: dict[DType, Callable[[Tag, bytes], tuple[int | float | None, str]]] = {
    **dict.fromkeys(_INTEGERS, _raw_integer),
    **dict.fromkeys(_FLOATS, _raw_float),
    **dict.fromkeys(_BCD_DIGITS, _raw_bcd),
}


def _find_sentinel(tag: Tag, raw: int | float) -> int | float | None:
    """The sentinel that a raw number is: itself, a signed one's unsigned pattern, as manuals print -32768 as 0x8000, or
    what a float32 makes of it."""
    for sentinel in tag.sentinels:
        if raw == sentinel:
            return sentinel
        if tag.dtype in _INTEGERS and raw < 0 and raw + 2 ** _INTEGERS[tag.dtype][0] == sentinel:
            return sentinel
        if tag.dtype is DType.FLOAT32 and abs(raw - sentinel) <= abs(sentinel) * _LIMIT_SLACK:
            return sentinel
    return None


def _broken_limit(tag: Tag, value: int | float) -> str | None:
    slack = _LIMIT_SLACK * max(abs(tag.low or 0.0), abs(tag.high or 0.0))
    if tag.low is not None and value < tag.low - slack:
        return f"below the lowest plausible value {tag.low:g}"
    if tag.high is not None and value > tag.high + slack:
        return f"above the highest plausible value {tag.high:g}"
    return None


def _not_available(sentinel: int | float) -> str:
    return f'the device says "not available" ({sentinel})'


def _list(labels: Mapping[int, str]) -> str:
    return ", ".join(f"{number} ({label})" for number, label in labels.items())
