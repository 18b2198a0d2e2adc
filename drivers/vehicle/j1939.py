"""J1939 as a listener hears it: 29-bit identifiers to parameter groups, and those to readings of tags (pure).

Messages of up to 8 bytes are one frame, longer ones come by the transport protocol. "Not available" and "error" are
qualities here and never numbers (J1939-71, 5.1.4).
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from drivers.can import EXTENDED, PREFIX, Bits, CanFrame, Dbc, TagReading
from drivers.codec import Reading
from drivers.errors import AddressError
from drivers.tag import DType, Quality, Tag
from drivers.vehicle import address
from drivers.vehicle import dm1 as j1939_dm1
from drivers.vehicle.address import VehicleAddress
from drivers.vehicle.j1939_transport import BROADCAST, TP_CM, TP_DT, Key, TransportSessions
from drivers.vehicle.spns import SPNS

ENGINE = 0x00
_PGN_FORM = re.compile(r"(?P<pgn>[0-9A-Fa-f]{1,5})/(?P<byte>\d{1,4})(\.(?P<bit>[1-8]))?/(?P<bits>\d{1,2})")
_SIGNED = frozenset({DType.INT8, DType.INT16, DType.INT32, DType.INT64})
_DM1_WORDS = ("codes", "count", *j1939_dm1.LAMPS)


class Identifier(NamedTuple):
    """A 29-bit identifier taken apart (J1939-21, 5.2); a broadcast's destination is 255."""

    priority: int
    pgn: int
    source: int
    destination: int


@dataclass(frozen=True, slots=True)
class GroupSignal:
    """Where a number lies in a parameter group, and its formula: value = raw * scale + offset."""

    pgn: int
    bits: Bits
    scale: float = 1.0
    offset: float = 0.0
    signed: bool = False


@dataclass(frozen=True, slots=True)
class J1939Tag:
    """One tag: its source address, and either a signal or what of DM1."""

    tag: Tag
    where: VehicleAddress
    source: int
    pgn: int
    signal: GroupSignal | None
    word: str = ""


def identifier(number: int) -> Identifier:
    """Take a 29-bit identifier apart."""
    group = number >> 8 & 0x3FFFF
    if group >> 8 & 0xFF < 240:  # PDU 1: the low byte is the destination
        return Identifier(number >> 26, group & 0x3FF00, number & 0xFF, group & 0xFF)
    return Identifier(number >> 26, group, number & 0xFF, BROADCAST)


def parse_tag(tag: Tag, source: int, dbc: Dbc | None) -> J1939Tag:
    """What the tag's address means; `source` is meant where it has no @, `dbc` is the file of `j1939:` addresses.

    Raises AddressError with what would be right.
    """
    where = address.place(tag)
    unit = source if where.source is None else where.source
    if unit > 0xFD:
        raise AddressError(f"{tag.name}: a source address is at most FD, not {unit:X}")
    if where.space == "dm1":
        if where.what not in _DM1_WORDS:
            raise AddressError(f"{tag.name}: dm1 has {', '.join(_DM1_WORDS)}, not {where.what!r}")
        return J1939Tag(tag, where, source=unit, pgn=j1939_dm1.PGN, signal=None, word=where.what)
    signal = _SPACES[where.space](tag, where, dbc)
    return J1939Tag(tag, where, source=unit, pgn=signal.pgn, signal=signal)


class J1939Listener:
    """Readings of `spn:`, `pgn:`, `j1939:` and `dm1:` tags from the frames of one or more buses.

    Raises AddressError for a tag that it cannot mean. `conversion` is for `j1939_dm1.trouble_codes`.
    """

    def __init__(
        self,
        tags: Sequence[Tag],
        *,
        source: int = ENGINE,
        dbc: Dbc | None = None,
        conversion: int | None = None,
    ) -> None:
        self.transport = TransportSessions()
        self._conversion = conversion
        self._counts = dict.fromkeys(("frames", "single", "not_j1939", "transport"), 0)
        self._wanted: dict[tuple[int, int], list[J1939Tag]] = {}
        for tag in tags:
            parameter = parse_tag(tag, source, dbc)
            self._wanted.setdefault((parameter.pgn, parameter.source), []).append(parameter)

    def take(self, frame: CanFrame) -> Sequence[TagReading]:
        """What the frame, or the message that it completes, says of the tags."""
        self._counts["frames"] += 1
        if not frame.extended or frame.fd:
            self._counts["not_j1939"] += 1
            return ()
        _, pgn, source, destination = identifier(frame.id)
        if pgn not in (TP_CM, TP_DT):
            self._counts["single"] += 1
            return self._message(pgn, source, frame.data)
        self._counts["transport"] += 1
        key = Key(frame.channel, source, destination)
        if pgn == TP_CM:
            self.transport.control(frame.time, key, frame.data)
            return ()
        message = self.transport.packet(frame.time, key, frame.data)
        return () if message is None else self._message(message.pgn, message.source, message.data)

    def counts(self) -> Mapping[str, int]:
        """Every frame by what became of it: frames = single + not_j1939 + all tp_ (frames of transport sessions)."""
        return self._counts | self.transport.counts()

    def restart(self) -> None:
        """It is another connection: no message that began before it is gone on with."""
        self.transport.restart()

    def _message(self, pgn: int, source: int, data: bytes) -> Sequence[TagReading]:
        parameters = self._wanted.get((pgn, source))
        if parameters is None:
            return ()
        return [TagReading(parameter.tag, self._reading(parameter, data)) for parameter in parameters]

    def _reading(self, parameter: J1939Tag, data: bytes) -> Reading:
        if parameter.signal is not None:
            return _number(parameter, parameter.signal, data)
        if len(data) < 2:
            return None, Quality.DECODING_ERROR, f"DM1 with {len(data)} bytes"
        if parameter.word in j1939_dm1.LAMPS:
            lamp = j1939_dm1.lamp(data, parameter.word)
            if lamp > 1:
                return None, *_SPECIAL[0xFF if lamp == 3 else 0xFE]
            return address.number(parameter.tag, parameter.where, lamp, whole=True)
        codes = j1939_dm1.trouble_codes(data, self._conversion)
        if parameter.word == "count":
            return address.number(parameter.tag, parameter.where, len(codes), whole=True)
        return address.text(parameter.tag, "; ".join(str(code) for code in codes))


def special(raw: int, bits: int) -> tuple[Quality, str] | None:
    """What a raw number says instead of a value, None for a value (J1939-71, tables 1 and 2).

    Whole bytes: the highest byte FF is "not available", FE "error", FB to FD are indicators and reserved. Fewer bits:
    all ones "not available", and one less "error" where there are two or four of them. One bit is a value.
    """
    if bits % 8 == 0:
        top = raw >> bits - 8
        if top < 0xFB:
            return None
        return _SPECIAL.get(top, (Quality.BAD, f"the unit sends an indicator and no value (0x{raw:X})"))
    if bits > 1 and raw == (1 << bits) - 1:
        return _SPECIAL[0xFF]
    return _SPECIAL[0xFE] if bits in (2, 4) and raw == (1 << bits) - 2 else None


_SPECIAL = {
    0xFF: (Quality.NO_DATA, 'the unit says "not available"'),
    0xFE: (Quality.SENSOR_FAILURE, 'the unit says "error"'),
}


def _number(parameter: J1939Tag, signal: GroupSignal, data: bytes) -> Reading:
    if len(data) < signal.bits.size:
        return (
            None,
            Quality.DECODING_ERROR,
            f"the message has {len(data)} bytes, and the value needs {signal.bits.size}",
        )
    raw = signal.bits.get(data)
    instead = special(raw, signal.bits.length)
    if instead is None and raw in parameter.tag.sentinels:
        instead = _SPECIAL[0xFF]
    if instead is not None:
        return None, *instead
    # The sign comes last: "not available" and "error" are patterns of the bits as they were sent.
    if signal.signed and raw >> signal.bits.length - 1:
        raw -= 1 << signal.bits.length
    whole = float(signal.scale).is_integer() and float(signal.offset).is_integer()
    return address.number(parameter.tag, parameter.where, raw * signal.scale + signal.offset, whole=whole)


def _spn(tag: Tag, where: VehicleAddress, _: Dbc | None) -> GroupSignal:
    spn = SPNS.get(int(where.what)) if where.what.isdecimal() else None
    if spn is None:
        raise AddressError(
            f"{tag.name}: SPN {where.what} is not in the table (drivers/vehicle/spns.py); give its place instead, "
            f"such as 'pgn:F004/4.1/16' with scale and offset"
        )
    return GroupSignal(spn.pgn, Bits((spn.byte - 1) * 8 + spn.bit - 1, spn.bits), spn.scale, spn.offset)


def _pgn(tag: Tag, where: VehicleAddress, _: Dbc | None) -> GroupSignal:
    match = _PGN_FORM.fullmatch(where.what)
    if match is None or not 1 <= int(match["bits"]) <= 64 or int(match["byte"]) < 1 or int(match["pgn"], 16) > 0x3FFFF:
        raise AddressError(
            f"{tag.name}: {tag.address!r} is no place; give the group in hexadecimal, byte.bit from 1 and the number "
            f"of bits, such as 'pgn:F004/4.1/16'"
        )
    start = (int(match["byte"]) - 1) * 8 + int(match["bit"] or 1) - 1
    return GroupSignal(int(match["pgn"], 16), Bits(start, int(match["bits"])), signed=tag.dtype in _SIGNED)


def _dbc_signal(tag: Tag, where: VehicleAddress, dbc: Dbc | None) -> GroupSignal:
    """A signal of a DBC file, in the parameter group of its message whatever the source address there."""
    if dbc is None:
        raise AddressError(f"{tag.name}: address {tag.address!r} needs a DBC file; give its path as dbc")
    completed, field, message = dbc.locate(replace(tag, address=f"{PREFIX}{where.what}"))
    if not message.key & EXTENDED or field.conditions or completed.dtype in (DType.FLOAT32, DType.FLOAT64):
        raise AddressError(f"{tag.name}: {where.what} is no plain number in a message with a 29-bit identifier")
    pgn = identifier(message.key & ~EXTENDED).pgn
    return GroupSignal(pgn, field.bits, completed.scale, completed.offset, completed.dtype in _SIGNED)


_SPACES = {"spn": _spn, "pgn": _pgn, "j1939": _dbc_signal}
