"""Addresses of values that a vehicle tells by itself: the notation of `obd:`, `spn:`, `pgn:` and `dm1:` tags (pure).

obd:0C          engine speed, service 01, of the engine's control unit (0x7E8 or 0x18DAF110)
obd:14.voltage  one of several fields of a parameter
obd:05@7E9      of another control unit, by the identifier of its answers
obd:vin         service 09; obd:codes, obd:pending, obd:permanent: trouble codes as text; .count: how many
spn:190         J1939, a parameter of the table in drivers/vehicle/spns.py, of the device's `source`
spn:84@47       of the source address 0x47
pgn:F004/4.1/16 J1939, 16 bits from byte 4, bit 1 (counted from 1, as in J1939-71), raw
dm1:lamps       active trouble codes: codes (text), count, or a lamp (mil, stop, warning, protect)
obd:0C>100      of any number, for a tag of dtype bool: whether it is above the limit
"""

import math
import re
from dataclasses import dataclass

from drivers.codec import Reading, judge
from drivers.errors import AddressError
from drivers.tag import DType, Quality, Tag, Value

_FORM = re.compile(r"(?P<space>[a-z0-9]+):(?P<what>[^@>]+)(@(?P<source>[0-9A-Fa-f]{1,8}))?(>(?P<limit>-?[0-9.]+))?")


@dataclass(frozen=True, slots=True)
class VehicleAddress:
    """An address taken apart: `source` is the number behind @, `limit` the one behind >."""

    space: str
    what: str
    source: int | None
    limit: float | None


def place(tag: Tag) -> VehicleAddress:
    """The tag's address taken apart. Raises AddressError with an example of what would be right."""
    match = _FORM.fullmatch(tag.address.replace(" ", ""))
    if match is None:
        example = "give one such as 'obd:0C', 'obd:05@7E9', 'spn:190', 'spn:84@47' or 'pgn:F004/4.1/16'"
        raise AddressError(f"{tag.name}: {tag.address!r} is no address of this driver; {example}")
    limit, written = None, match["limit"]
    if written is not None:
        if tag.dtype is not DType.BOOL:
            raise AddressError(
                f"{tag.name}: a limit belongs to a tag of dtype bool; leave out >{written} or set the dtype"
            )
        try:
            limit = float(written)
        except ValueError:
            raise AddressError(
                f"{tag.name}: {written!r} behind > is no number; give one such as 'obd:0C>100'"
            ) from None
    source = None if match["source"] is None else int(match["source"], 16)
    return VehicleAddress(match["space"], match["what"], source, limit)


def number(tag: Tag, where: VehicleAddress, value: float, *, whole: bool) -> Reading:
    """The tag's reading for a number in the standard's unit: the tag's own scale, offset, range and limit on top.

    `whole`: the standard's formula gives whole numbers; with an integer dtype, scale 1 and offset 0 they stay so.
    """
    if tag.dtype is DType.STRING:
        return None, Quality.DECODING_ERROR, f"{value:g} is a number, and the tag's dtype is string"
    if tag.dtype is DType.BOOL:
        return (value > where.limit if where.limit is not None else value != 0), Quality.GOOD, ""
    scaled = value * tag.scale + tag.offset
    if not math.isfinite(scaled):
        return None, Quality.DECODING_ERROR, f"{scaled} is not a finite number"
    floating = tag.dtype in (DType.FLOAT32, DType.FLOAT64)
    converted: Value = int(scaled) if whole and not floating and tag.scale == 1.0 and tag.offset == 0.0 else scaled
    return converted, *judge(tag, converted)


def text(tag: Tag, words: str) -> Reading:
    """The tag's reading for a text."""
    if tag.dtype is not DType.STRING:
        return None, Quality.DECODING_ERROR, f"{words!r} is text, and the tag's dtype is {tag.dtype}"
    return words, Quality.GOOD, ""
