"""Where a tag lies in a Modbus device: its table, first address and count (pure)."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise

from drivers.codec import register_count
from drivers.errors import AddressError
from drivers.tag import DType, Tag


class Area(StrEnum):
    """The four tables of a Modbus device, by the name that addresses are written with."""

    COIL = "coil"
    DISCRETE = "discrete"
    INPUT = "input"
    HOLDING = "holding"

    @property
    def is_bits(self) -> bool:
        """True for the tables of single bits, False for those of 16-bit registers."""
        return self in (Area.COIL, Area.DISCRETE)

    @property
    def is_writable(self) -> bool:
        """True for the tables that the protocol can write."""
        return self in (Area.COIL, Area.HOLDING)


@dataclass(frozen=True, slots=True)
class WideRange:
    """Addresses `start`..`stop - 1` of which each is a register of 32 bits, as Enron's and Daniel's flow computers
    count them: a reply has four bytes for each."""

    area: Area
    start: int
    stop: int

    def meets(self, area: Area, start: int, stop: int) -> bool:
        """Whether it has any of these addresses."""
        return self.area is area and start < self.stop and self.start < stop


@dataclass(frozen=True, slots=True)
class TagSpan:
    """A tag's own addresses: `start`..`start + count - 1` of `area`, PDU addresses (0-based).

    `wide`: the range of 32-bit registers in which they lie.
    """

    tag: Tag
    area: Area
    start: int
    count: int
    wide: WideRange | None = None

    @property
    def stop(self) -> int:
        """The first address after it."""
        return self.start + self.count


_NOTATION = re.compile(r"(?P<area>[a-z]+):(?P<number>\d+)")
_STRETCH = re.compile(r"(?P<area>holding|input):(?P<first>\d{1,5})-(?P<last>\d{1,5})")
_LAST = 65535
_REMEDY = "write area:number with the PDU address (0 to 65535), for example holding:100"
# The first digit of a 5- or 6-digit reference number, as HMIs and manuals print it, and the table that it means.
_REFERENCE = re.compile(r"(?P<digit>[0134])(?P<number>\d{4,5})")
_DIGITS = {"0": Area.COIL, "1": Area.DISCRETE, "3": Area.INPUT, "4": Area.HOLDING}


def parse_address(text: str) -> tuple[Area, int]:
    """Read `holding:100`: the table and the PDU address, 0 to 65535.

    Raises AddressError for anything else; a reference number (40101) is refused with the address that it means.
    """
    text = text.strip()
    if reference := _REFERENCE.fullmatch(text):
        # Manuals count from 1 (V1.1b3, 4.4) and put the table in front as a digit. It is refused and not translated, so
        # that a file says the address that goes on the wire, and nobody has to guess who has subtracted the 1.
        counted = int(reference["number"])
        if not 1 <= counted <= 65536:
            raise AddressError(f"{text!r} is not a Modbus address: {_REMEDY}")
        meant = f"{_DIGITS[reference['digit']]}:{counted - 1}"
        raise AddressError(f"{text!r} is a reference number that counts from 1: write the PDU address {meant}")
    match = _NOTATION.fullmatch(text)
    if match is None:
        raise AddressError(f"{text!r} is not a Modbus address: {_REMEDY}")
    if match["area"] not in set(Area):
        raise AddressError(f"{text!r} names no Modbus table: the tables are {', '.join(Area)}")
    number = int(match["number"])
    if number > 65535:
        raise AddressError(f"{text!r} is beyond the last address 65535: {_REMEDY}")
    return Area(match["area"]), number


def parse_wide_ranges(given: object) -> tuple[WideRange, ...]:
    """Read `["holding:5001-5999"]`. Raises ValueError for anything else."""
    ranges: list[WideRange] = []
    for text in given if isinstance(given, list | tuple) else (given,):
        if isinstance(text, WideRange):
            ranges.append(text)
            continue
        match = _STRETCH.fullmatch(text.strip()) if isinstance(text, str) else None
        if match is None or int(match["last"]) > _LAST or int(match["first"]) > int(match["last"]):
            raise ValueError(f'is {text!r}; give ranges of PDU addresses, such as ["holding:5001-5999"]')
        ranges.append(WideRange(Area(match["area"]), int(match["first"]), int(match["last"]) + 1))
    ranges.sort(key=lambda one: (one.area, one.start))
    for left, right in pairwise(ranges):
        if left.meets(right.area, right.start, right.stop):
            raise ValueError(f"has {left.area}:{right.start} twice; give ranges that do not overlap")
    return tuple(ranges)


def locate(tag: Tag, wide: Sequence[WideRange] = ()) -> TagSpan:
    """Give the addresses that the tag covers; in one of the `wide` ranges each holds two words of it.

    Raises AddressError if the notation is wrong, if a bit table is asked for anything but a bool, if the tag is no
    whole number of 32-bit registers where there are such, or if it reaches beyond address 65535.
    """
    try:
        area, start = parse_address(tag.address)
    except AddressError as error:
        raise AddressError(f"{tag.name}: {error}") from None
    count = register_count(tag)
    if area.is_bits and (tag.dtype is not DType.BOOL or tag.bit is not None):
        raise AddressError(f"{tag.name}: {tag.address} is a single bit: dtype must be bool, without bit")
    for own in wide:
        if own.meets(area, start, start + count):
            return TagSpan(tag, area, start, _wide_count(tag, own, start, count), own)
    if start + count > 65536:
        raise AddressError(f"{tag.name}: {count} registers from {tag.address} reach beyond the last address 65535")
    return TagSpan(tag, area, start, count)


def _wide_count(tag: Tag, wide: WideRange, start: int, words: int) -> int:
    """How many registers of 32 bits the tag's words are."""
    own = f"{wide.area}:{wide.start}-{wide.stop - 1}"
    if start < wide.start:
        raise AddressError(f"{tag.name}: it begins before {own} (wide_registers) and reaches into it")
    if words % 2 or tag.bit is not None:
        kind = "one bit" if tag.bit is not None else f"{tag.dtype}, {words} x 16 bits"
        raise AddressError(
            f"{tag.name}: {tag.address} is a register of 32 bits (wide_registers {own}) and the tag is {kind}; give "
            "int32, uint32 or float32, or a text of four bytes a register"
        )
    if start + words // 2 > wide.stop:
        raise AddressError(f"{tag.name}: {words // 2} registers from {tag.address} reach beyond {own} (wide_registers)")
    return words // 2


def place_of_tag(tag: Tag) -> tuple[str, int, int]:
    """The tag's table, first address and count (`Capabilities.locates`). Raises AddressError."""
    span = locate(tag)
    return str(span.area), span.start, span.count
