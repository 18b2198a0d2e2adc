"""Where a value lies in CAN frames, and the bits of a payload to values and back (pure).

The address of a plain field is written as a DBC file writes it, behind the frame's id:

    0x181:16|16        frame 0x181, least significant bit 16, 16 bits, Intel byte order (@1, the default)
    0x181:7|16@0       Motorola byte order: the most significant bit is bit 7, which is bit 7 of byte 0
    0x00000181:0|8     eight digits, as candump prints them: a 29-bit id; three digits or fewer: an 11-bit one
    0x181[0|8=3]:8|16  only in those frames of 0x181 whose bits 0|8 hold 3 (a multiplexed message)

Bits are numbered as in a DBC file: bit n is bit n % 8 of byte n // 8, and bit 0 of a byte is its least significant one.
The type of the number (sign, float, text) is the tag's `dtype`.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from struct import pack
from typing import Literal

from drivers.codec import Reading, decode, encode, register_count
from drivers.errors import AddressError, EncodingError
from drivers.tag import DType, Order, Quality, Tag, Value

EXTENDED = 0x80000000
"""The flag by which a key tells a 29-bit id from an 11-bit one, as in the kernel's struct can_frame."""

_NOTATION = "'0x181:16|16', '0x181:7|16@0', '0x181[0|8=3]:8|16' or, with a DBC file, 'dbc:Message.Signal'"
_BITS = r"(\d+)\|(\d+)(?:@([01]))?"
_ADDRESS = re.compile(rf"0x([0-9a-fA-F]{{1,8}})(?:\[([^\]]*)\])?:{_BITS}")
_CONDITION = re.compile(rf"{_BITS}=(\d+)")
_MOST_BITS = 512  # a CAN FD payload
_SIZES = {DType.FLOAT32: 32, DType.FLOAT64: 64, DType.BCD16: 16, DType.BCD32: 32}
_SIGNED = frozenset({DType.INT8, DType.INT16, DType.INT32, DType.INT64})
_BYTE_WIDE = frozenset({DType.INT8, DType.UINT8})


@dataclass(frozen=True, slots=True)
class Bits:
    """A stretch of a payload: `start` and `length` in bits as a DBC file counts them, Intel or Motorola order."""

    start: int
    length: int
    motorola: bool = False

    @property
    def end(self) -> int:
        """The bits of the payload, counted from its front, that must be there."""
        if self.motorola:
            return 8 * (self.start // 8) + 7 - self.start % 8 + self.length
        return self.start + self.length

    @property
    def size(self) -> int:
        """The bytes of the payload that must be there."""
        return (self.end + 7) // 8

    def get(self, data: bytes) -> int:
        """The bits as an unsigned number; the payload is long enough."""
        mask = (1 << self.length) - 1
        if self.motorola:
            return int.from_bytes(data, "big") >> 8 * len(data) - self.end & mask
        return int.from_bytes(data, "little") >> self.start & mask

    def put(self, data: bytes, raw: int) -> bytes:
        """The payload with these bits set to `raw` (0 .. 2**length - 1)."""
        order: Literal["big", "little"] = "big" if self.motorola else "little"
        shift = 8 * len(data) - self.end if self.motorola else self.start
        mask = (1 << self.length) - 1 << shift
        whole = int.from_bytes(data, order) & ~mask | raw << shift
        return whole.to_bytes(len(data), order)


@dataclass(frozen=True, slots=True)
class LayoutCondition:
    """Bits that must hold one of some numbers: which of a multiplexed message's layouts a frame has."""

    bits: Bits
    values: frozenset[int]

    def holds(self, data: bytes) -> bool:
        """True for a payload of this layout."""
        return len(data) >= self.bits.size and self.bits.get(data) in self.values


@dataclass(frozen=True, slots=True)
class Field:
    """A value's place: the frame by its `key` (id, plus EXTENDED for 29 bits), the layout, and the bits."""

    key: int
    bits: Bits
    conditions: tuple[LayoutCondition, ...] = ()

    @property
    def size(self) -> int:
        """The bytes that a frame must have to hold the value."""
        return max(self.bits.size, *(condition.bits.size for condition in self.conditions), 0)


def frame_key(number: int, *, extended: bool) -> int:
    """The key of a frame's id."""
    return number | EXTENDED if extended else number


def frame_name(key: int) -> str:
    """The id as it is written: three digits for 11 bits, eight for 29."""
    return f"0x{key & ~EXTENDED:08X}" if key & EXTENDED else f"0x{key:03X}"


def layout_name(conditions: Iterable[LayoutCondition]) -> str:
    """The layout of a multiplexed message for sentences: " [0|8=3]", "" for a message that has but one."""
    texts = [f"{c.bits.start}|{c.bits.length}={'/'.join(map(str, sorted(c.values)))}" for c in conditions]
    return f" [{', '.join(texts)}]" if texts else ""


def parse_frame(text: str, where: str) -> int:
    """The key of an id such as 0x181 (11 bits) or 0x18FEEE00 (29 bits: more than three digits). Raises AddressError."""
    match = re.fullmatch(r"0x([0-9a-fA-F]{1,8})", text)
    if match is None:
        raise AddressError(f"{where}: {text!r} is no frame id; give one such as 0x181 or 0x18FEEE00")
    return _key(match[1], where)


def parse_field(tag: Tag) -> Field:
    """The place of a tag with a plain address. Raises AddressError where no frame has it, or no value of its type."""
    match = _ADDRESS.fullmatch(tag.address)
    if match is None:
        raise AddressError(f"{tag.name}: address {tag.address!r} is not known here; give {_NOTATION}")
    conditions = () if match[2] is None else tuple(_condition(tag, text) for text in match[2].split(","))
    field = Field(_key(match[1], tag.name), _bits(tag, match[3], match[4], match[5]), conditions)
    check_type(tag, field.bits)
    return field


def check_type(tag: Tag, bits: Bits) -> None:
    """Raises AddressError if a value of the tag's type cannot lie in these bits."""
    register_count(tag)
    if tag.order is not Order.ABCD:
        raise AddressError(
            f"{tag.name}: a CAN field's byte order stands in its address (@1 Intel, @0 Motorola); leave order out"
        )
    if tag.dtype is DType.STRING:
        if bits.start % 8 != (7 if bits.motorola else 0) or bits.length != 8 * tag.length:
            raise AddressError(f"{tag.name}: a text of {tag.length} bytes begins with a byte and has 8 bits for each")
        return
    exact, most = _SIZES.get(tag.dtype), _container(tag)
    if exact is not None and bits.length != exact:
        raise AddressError(f"{tag.name}: a {tag.dtype} has {exact} bits, not {bits.length}")
    if bits.length > most:
        raise AddressError(f"{tag.name}: {bits.length} bits do not fit a {tag.dtype}, which has {most}")


def decode_value(tag: Tag, field: Field, data: bytes) -> Reading:
    """The tag's engineering value in a payload of the right layout, its quality and, unless good, the reason."""
    if len(data) < field.size:
        return None, Quality.DECODING_ERROR, f"the frame has {len(data)} bytes, and the value needs {field.size}"
    if tag.dtype is DType.STRING:
        first = field.bits.start // 8
        octets = data[first : first + tag.length]
        octets += bytes(len(octets) % 2)
        return decode(tag, [int.from_bytes(octets[at : at + 2], "big") for at in range(0, len(octets), 2)])
    raw = field.bits.get(data)
    if tag.dtype in _SIGNED and raw >> field.bits.length - 1:
        raw -= 1 << field.bits.length
    # As registers, so that scale, range, sentinel and labels are judged by the one codec; a negative number fills all
    # of them with its sign.
    count = register_count(tag)
    return decode(tag, [raw >> 16 * place & 0xFFFF for place in reversed(range(count))], one_order=True)


def encode_raw(tag: Tag, field: Field, value: Value) -> int:
    """The field's bits for an engineering value. Raises EncodingError for one that does not fit its type or bits."""
    words = encode(tag, value)
    if tag.dtype is DType.STRING:
        # Text stands in a payload from its first byte on; in Intel order that is the least one of the number.
        octets = pack(f">{len(words)}H", *words)[: tag.length]
        return int.from_bytes(octets, "big" if field.bits.motorola else "little")
    raw = int.from_bytes(pack(f">{len(words)}H", *words), "big")
    if tag.dtype in _BYTE_WIDE:
        raw &= 0xFF
    length = field.bits.length
    if tag.dtype in _SIGNED:
        container = _container(tag)
        number = raw - (1 << container) if raw >> container - 1 else raw
        if not -(1 << length - 1) <= number < 1 << length - 1:
            raise EncodingError(f"{tag.name}: {value!r} would be stored as {number}, which {length} bits do not hold")
        return number & (1 << length) - 1
    if raw >> length:
        raise EncodingError(f"{tag.name}: {value!r} would be stored as {raw}, which {length} bits do not hold")
    return raw


def _container(tag: Tag) -> int:
    """The bits of the tag's type."""
    return 8 if tag.dtype in _BYTE_WIDE else 16 * register_count(tag)


def _key(digits: str, where: str) -> int:
    number = int(digits, 16)
    if len(digits) <= 3:
        if number > 0x7FF:
            raise AddressError(f"{where}: 0x{digits} is beyond 11 bits (0x7FF); write a 29-bit id with eight digits")
        return number
    if number > 0x1FFFFFFF:
        raise AddressError(f"{where}: 0x{digits} is beyond 29 bits (0x1FFFFFFF)")
    return number | EXTENDED


def _bits(tag: Tag, start: str, length: str, order: str | None) -> Bits:
    bits = Bits(int(start), int(length), order == "0")
    if bits.length < 1 or bits.end > _MOST_BITS:
        raise AddressError(f"{tag.name}: {start}|{length} is not in a frame, which has bits 0 to {_MOST_BITS - 1}")
    return bits


def _condition(tag: Tag, text: str) -> LayoutCondition:
    match = _CONDITION.fullmatch(text.strip())
    if match is None:
        raise AddressError(f"{tag.name}: [{text}] cannot be read; give the bits and what they hold, such as [0|8=3]")
    bits, value = _bits(tag, match[1], match[2], match[3]), int(match[4])
    if value >> bits.length:
        raise AddressError(f"{tag.name}: [{text}] can never be met: {bits.length} bits do not hold {value}")
    return LayoutCondition(bits, frozenset({value}))
