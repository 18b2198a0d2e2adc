"""Tags into register words by `struct` alone: the PLC's own path, which shares nothing with the gateway's codec."""

import math
import struct
from collections.abc import Sequence
from dataclasses import replace

from drivers.tag import DType, Order, Tag, Value

_FORMATS = {
    DType.INT8: ">xb",
    DType.UINT8: ">xB",
    DType.INT16: ">h",
    DType.UINT16: ">H",
    DType.INT32: ">i",
    DType.UINT32: ">I",
    DType.INT64: ">q",
    DType.UINT64: ">Q",
    DType.FLOAT32: ">f",
    DType.FLOAT64: ">d",
}
_BCD_DIGITS = {DType.BCD16: 4, DType.BCD32: 8}
_EPSILON = {DType.FLOAT32: 2.0**-23, DType.FLOAT64: 2.0**-52}
FLOATS = (DType.FLOAT32, DType.FLOAT64)
LEAST_POWER, GREATEST_POWER = -10, 10
"""Of ten, in a register of its own (SunSpec Information Model Specification, 4.3.4, sunssf)."""


class Unrepresentable(ValueError):
    """The value does not fit the tag's type and scale; `nearest` are the words of what comes closest."""

    def __init__(self, sentence: str, nearest: Sequence[int]) -> None:
        super().__init__(sentence)
        self.nearest = tuple(nearest)


def words_of_type(tag: Tag) -> int:
    """How many 16-bit registers the tag takes (a bool and an 8-bit number take a whole one)."""
    if tag.dtype is DType.STRING:
        return (tag.length + 1) // 2
    if tag.dtype in _BCD_DIGITS:
        return _BCD_DIGITS[tag.dtype] // 4
    return struct.calcsize(_FORMATS.get(tag.dtype, ">H")) // 2


def limits(dtype: DType) -> tuple[int, int]:
    """The least and the greatest raw number of a whole-number type."""
    if dtype in _BCD_DIGITS:
        return 0, int(10 ** _BCD_DIGITS[dtype]) - 1
    bits = 8 if dtype in (DType.INT8, DType.UINT8) else 8 * struct.calcsize(_FORMATS.get(dtype, ">H"))
    if dtype in (DType.INT8, DType.INT16, DType.INT32, DType.INT64):
        return -(1 << bits - 1), (1 << bits - 1) - 1
    return 0, (1 << bits) - 1


def is_bool(tag: Tag) -> bool:
    """True if the tag reads as true or false: a bool, or one bit of a register."""
    return tag.dtype is DType.BOOL or tag.bit is not None


def with_power(tag: Tag, power: int) -> Tag:
    """The tag while its factor's register holds this power of ten; a tag without one as it is."""
    return replace(tag, scale=tag.scale * 10.0**power, scale_from="") if tag.scale_from else tag


def sentinel_fits(tag: Tag) -> bool:
    """True if the tag's sentinel can lie in its registers, as a number or as a pattern (0x8000, or 0xFFFF in BCD)."""
    if tag.sentinel is None or tag.dtype in FLOATS:
        return True
    if tag.dtype is DType.STRING or tag.bit is not None:
        return False
    return all(limits(tag.dtype)[0] <= sentinel < 1 << 16 * words_of_type(tag) for sentinel in tag.sentinels)


def encode(tag: Tag, value: Value) -> list[int]:
    """The register words of an engineering value; for a bit the one word 0 or 1, wherever the bit lies.

    Raises Unrepresentable for a number outside the type, for one that would read as the sentinel, and for a string
    that is too long.
    """
    if is_bool(tag):
        return order_registers(struct.pack(">H", bool(value)), tag.order)
    if tag.dtype is DType.STRING:
        octets = str(value).encode("latin-1", errors="replace")
        words = order_registers(octets[: tag.length].ljust(2 * words_of_type(tag), b"\0"), _string_order(tag))
        if len(octets) > tag.length:
            sentence = f"{tag.name} cannot hold {str(value)!r}: {len(octets)} bytes for {tag.length}"
            raise Unrepresentable(sentence, words)
        return words
    if tag.dtype in FLOATS:
        real = (float(value) - tag.offset) / tag.scale
        try:
            return order_registers(struct.pack(_FORMATS[tag.dtype], real), tag.order)
        except OverflowError:
            greatest = struct.unpack(">f", b"\x7f\x7f\xff\xff")[0]
            nearest = order_registers(struct.pack(">f", math.copysign(greatest, real)), tag.order)
            raise Unrepresentable(f"{tag.name} cannot hold {real!r} (float32)", nearest) from None
    number = value if isinstance(value, int) else float(value)
    # By way of a float only where there is something to scale: a 64-bit number has more digits than a float.
    exact = isinstance(number, int) and tag.offset == 0 and tag.scale == 1
    raw = int(number) if exact else round((number - tag.offset) / tag.scale)
    low, high = limits(tag.dtype)
    fitting = min(max(raw, low), high)
    # A reading that happens to be the sentinel's number must not say "not available": its neighbour comes closest.
    patterns = {_sentinel_bytes(tag, sentinel) for sentinel in tag.sentinels}
    step = 1 if fitting <= low + len(patterns) else -1
    while _pack(tag, fitting) in patterns:
        fitting += step
    words = order_registers(_pack(tag, fitting), tag.order)
    if fitting != raw:
        raise Unrepresentable(f"{tag.name} cannot hold {number!r} {tag.unit}".rstrip() + f" ({tag.dtype})", words)
    return words


def encode_absent(tag: Tag) -> list[int]:
    """The words that say "not available": the sentinel, else NaN for a float, else 0 (a PLC's memory at rest)."""
    if tag.sentinel is not None:
        return order_registers(_sentinel_bytes(tag, tag.sentinel), tag.order)
    if tag.dtype in FLOATS:
        return order_registers(struct.pack(_FORMATS[tag.dtype], math.nan), tag.order)
    return [0] * words_of_type(tag)


def value_at_rest(tag: Tag) -> Value | None:
    """What `encode_absent` reads as: None where the words say "not available"."""
    if tag.sentinel is not None or tag.dtype in FLOATS:
        return None
    return decode(tag, encode_absent(tag))


def decode(tag: Tag, words: Sequence[int]) -> Value | None:
    """The engineering value of words that a client wrote; None for the sentinel, NaN and digits that are no BCD."""
    order = _string_order(tag)
    letter = "<" if order in (Order.BADC, Order.DCBA) else ">"
    straight = words[::-1] if order in (Order.CDAB, Order.DCBA) else words
    octets = struct.pack(f"{letter}{len(straight)}H", *straight)
    if is_bool(tag):
        return bool(int.from_bytes(octets, "big") >> tag.bit & 1 if tag.bit is not None else any(octets))
    if tag.dtype is DType.STRING:
        return octets[: tag.length].rstrip(b"\0 ").decode("latin-1")
    if any(octets == _sentinel_bytes(tag, sentinel) for sentinel in tag.sentinels):
        return None
    if tag.dtype in _BCD_DIGITS:
        return _scale_value(tag, int(octets.hex())) if octets.hex().isdecimal() else None
    (raw,) = struct.unpack(_FORMATS[tag.dtype], octets)
    return _scale_value(tag, raw) if math.isfinite(raw) else None


def resolution(tag: Tag) -> tuple[float, float]:
    """By how much (absolute, relative) an engineering value may differ from its register's, by rounding alone."""
    if is_bool(tag) or tag.dtype is DType.STRING:
        return 0.0, 0.0
    if tag.dtype in FLOATS:
        return abs(tag.offset) * _EPSILON[tag.dtype], _EPSILON[tag.dtype]
    if tag.scale_from:  # the image's truth is what the register holds (`ProcessImage.learn`)
        return 1e-12 * abs(tag.offset), 1e-12
    return 0.5 * (1 + 1e-9) * abs(tag.scale), 1e-12


def order_registers(octets: bytes, order: Order) -> list[int]:
    """Big-endian bytes as register words in the given byte and word order."""
    letter = "<" if order in (Order.BADC, Order.DCBA) else ">"
    words = list(struct.unpack(f"{letter}{len(octets) // 2}H", octets))
    return words[::-1] if order in (Order.CDAB, Order.DCBA) else words


def _scale_value(tag: Tag, raw: float) -> Value:
    return raw if tag.scale == 1 and tag.offset == 0 else raw * tag.scale + tag.offset


def _sentinel_bytes(tag: Tag, sentinel: int | float) -> bytes:
    if tag.dtype in FLOATS:
        return struct.pack(_FORMATS[tag.dtype], sentinel)
    size = 2 * words_of_type(tag)
    mask = 0xFF if tag.dtype in (DType.INT8, DType.UINT8) else (1 << 8 * size) - 1
    if tag.dtype in _BCD_DIGITS and sentinel <= limits(tag.dtype)[1]:
        return _pack(tag, int(sentinel))
    return (int(sentinel) & mask).to_bytes(size, "big")


def _pack(tag: Tag, raw: int) -> bytes:
    if tag.dtype in _BCD_DIGITS:
        return bytes.fromhex(f"{raw:0{_BCD_DIGITS[tag.dtype]}d}")
    return struct.pack(_FORMATS[tag.dtype], raw)


def _string_order(tag: Tag) -> Order:
    """A string runs on register by register: only the bytes within a register may be swapped."""
    if tag.dtype is not DType.STRING:
        return tag.order
    return Order.BADC if tag.order in (Order.BADC, Order.DCBA) else Order.ABCD
