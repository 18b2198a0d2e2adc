"""Where a tag lies in a Modbus device: its table, first address and count (pure)."""

import re
from dataclasses import dataclass
from enum import StrEnum

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
class TagSpan:
    """A tag's own addresses: `start`..`start + count - 1` of `area`, PDU addresses (0-based)."""

    tag: Tag
    area: Area
    start: int
    count: int

    @property
    def stop(self) -> int:
        """The first address after it."""
        return self.start + self.count


_NOTATION = re.compile(r"(?P<area>[a-z]+):(?P<number>\d+)")
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


def locate(tag: Tag) -> TagSpan:
    """Give the addresses that the tag covers.

    Raises AddressError if the notation is wrong, if a bit table is asked for anything but a bool, or if the tag reaches
    beyond address 65535.
    """
    try:
        area, start = parse_address(tag.address)
    except AddressError as error:
        raise AddressError(f"{tag.name}: {error}") from None
    count = register_count(tag)
    if area.is_bits and (tag.dtype is not DType.BOOL or tag.bit is not None):
        raise AddressError(f"{tag.name}: {tag.address} is a single bit: dtype must be bool, without bit")
    if start + count > 65536:
        raise AddressError(f"{tag.name}: {count} registers from {tag.address} reach beyond the last address 65535")
    return TagSpan(tag, area, start, count)


def place_of_tag(tag: Tag) -> tuple[str, int, int]:
    """The tag's table, first address and count (`Capabilities.locates`). Raises AddressError."""
    span = locate(tag)
    return str(span.area), span.start, span.count
