"""Where a value lies in a node's object dictionary, and its bytes there as a tag means them."""

import re
from dataclasses import dataclass

from drivers.codec import Reading, decode, encode, register_count
from drivers.errors import AddressError, EncodingError
from drivers.tag import DType, Order, Quality, Tag, Value

_ADDRESS = re.compile(r"0x([0-9A-Fa-f]{1,4})(?::(0x[0-9A-Fa-f]{1,2}|[0-9]{1,3}))?")


@dataclass(frozen=True, slots=True, order=True)
class ObjectPlace:
    """Index (0..0xFFFF) and sub-index (0..0xFF) of one object."""

    index: int
    subindex: int = 0

    def __str__(self) -> str:
        return f"0x{self.index:04X}:{self.subindex}"


def parse_place(text: str, what: str = "") -> ObjectPlace:
    """`0x2001:1` (or `0x1017`, sub-index 0) as a place. Raises AddressError, which begins with `what`, if given."""
    match = _ADDRESS.fullmatch(text)
    if match is not None:
        place = ObjectPlace(int(match[1], 16), int(match[2] or "0", 0))
        if place.subindex <= 0xFF:
            return place
    subject = f"{what}: " if what else ""
    raise AddressError(f"{subject}{text!r} is no object; give its index and sub-index, such as '0x2001:1'")


def object_bytes(tag: Tag) -> int:
    """How many bytes the tag's object has, 0 if one or two will do (bool). Raises AddressError."""
    registers = register_count(tag)
    if tag.dtype is DType.STRING:
        return tag.length
    if tag.dtype is DType.BOOL:
        return 0
    return 1 if tag.dtype in (DType.INT8, DType.UINT8) else 2 * registers


def from_bytes(tag: Tag, payload: bytes) -> Reading:
    """The tag's value in the bytes of its object: CANopen sends the least byte first, whatever the tag's order says.

    A number of bytes that is not the tag's own is DECODING_ERROR.
    """
    needed = object_bytes(tag)
    if tag.dtype is DType.STRING:
        if len(payload) > needed:
            return None, Quality.DECODING_ERROR, f"{len(payload)} bytes of text, and the tag has room for {needed}"
        return payload.split(b"\0", 1)[0].decode("latin-1").rstrip(" "), Quality.GOOD, ""
    if len(payload) != needed and not (needed == 0 and len(payload) in (1, 2)):
        return None, Quality.DECODING_ERROR, f"{len(payload)} bytes for a {tag.dtype}, which has {needed or '1 or 2'}"
    # The codec takes registers, most significant first; an odd byte fills the low half of one.
    words = payload[::-1].rjust((len(payload) + 1) // 2 * 2, b"\0")
    return decode(
        _straight(tag), [int.from_bytes(words[at : at + 2], "big") for at in range(0, len(words), 2)], one_order=True
    )


def to_bytes(tag: Tag, value: Value, size: int | None) -> bytes:
    """The bytes of the tag's object, `size` of them where the EDS knows. Raises EncodingError or AddressError."""
    if tag.dtype is DType.STRING:
        if not isinstance(value, str):
            raise EncodingError(f"{tag.name}: {value!r} is not text")
        text = value.encode("latin-1", errors="replace")
        if len(text) > tag.length:
            raise EncodingError(f"{tag.name}: {len(text)} characters do not fit in {tag.length}")
        return text
    words = encode(_straight(tag), value)
    whole = b"".join(word.to_bytes(2, "big") for word in words)[::-1]
    length = size if size is not None else (object_bytes(tag) or 1)
    if any(whole[length:]):
        raise EncodingError(f"{tag.name}: {value!r} does not fit in the {length} bytes of {tag.address}")
    return whole[:length]


def _straight(tag: Tag) -> Tag:
    if tag.order is Order.ABCD:
        return tag
    raise AddressError(f"{tag.name}: order {tag.order} is of registers; CANopen has one byte order, leave it out")
