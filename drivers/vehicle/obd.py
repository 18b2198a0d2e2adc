"""OBD-II (SAE J1979 over ISO 15765-4) as a listener hears it: the control units' answers to readings of tags (pure).

Whoever asks, the answers tell: 11-bit identifiers 0x7E8..0x7EF and 29-bit ones 0x18DAF1xx. A payload is used only when
it can be read to its last byte. Requests are watched too, as a refusal (0x7F) does not say which parameter it refuses.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from drivers.can import CanFrame, TagReading
from drivers.codec import Reading
from drivers.errors import AddressError
from drivers.tag import Quality, Tag
from drivers.vehicle import address
from drivers.vehicle.address import VehicleAddress
from drivers.vehicle.isotp import Reassembler
from drivers.vehicle.obd_pids import PidField, pids, single_frame

CURRENT, STORED, PENDING, VEHICLE, PERMANENT = 0x01, 0x03, 0x07, 0x09, 0x0A
ANSWER, REFUSAL = 0x40, 0x7F
RESPONSE_PENDING = 0x78
ENGINE = (0x7E8, 0x18DAF110)
"""The answers of the engine's control unit, 11-bit and 29-bit (ISO 15765-4); the default of an address without @."""
REFUSAL_WINDOW_S = 5.0
"""Seconds in which an answer belongs to the request before it (P2*, ISO 15765-4)."""

# Word in an address -> service, parameter, and the field of it: the list as text, or how many.
_WORDS: Mapping[str, tuple[int, int]] = {
    "vin": (VEHICLE, 0x02),
    "calibration": (VEHICLE, 0x04),
    "unit_name": (VEHICLE, 0x0A),
    "codes": (STORED, 0),
    "pending": (PENDING, 0),
    "permanent": (PERMANENT, 0),
}
# ISO 14229-1, A.1: what a refusal means for the tag's quality, and its name.
_REFUSALS: Mapping[int, tuple[Quality, str]] = {
    0x10: (Quality.DEVICE_FAILURE, "general reject"),
    0x11: (Quality.CONFIGURATION_ERROR, "service not supported"),
    0x12: (Quality.CONFIGURATION_ERROR, "sub-function not supported"),
    0x13: (Quality.CONFIGURATION_ERROR, "incorrect message length or format"),
    0x21: (Quality.NO_DATA, "busy, repeat request"),
    0x22: (Quality.NO_DATA, "conditions not correct"),
    0x31: (Quality.CONFIGURATION_ERROR, "request out of range"),
    0x33: (Quality.CONFIGURATION_ERROR, "security access denied"),
    0x7F: (Quality.NO_DATA, "service not supported in the active session"),
}
_CODE_SYSTEMS = "PCBU"


@dataclass(frozen=True, slots=True)
class ObdTag:
    """One tag: the service and parameter that hold it, and the field (none for a text or a list)."""

    tag: Tag
    where: VehicleAddress
    service: int
    parameter: int
    field: PidField | None
    count: bool = False


@dataclass(frozen=True, slots=True)
class _Request:
    """The last request that was heard: what it asked for, and when."""

    time: float
    service: int
    parameters: bytes


def parse_tag(tag: Tag) -> ObdTag:
    """What the tag's address means. Raises AddressError with what would be right."""
    where = address.place(tag)
    name, _, part = where.what.partition(".")
    if name in _WORDS:
        service, parameter = _WORDS[name]
        if part not in ("", "count") or (part and service == VEHICLE):
            raise AddressError(f"{tag.name}: {tag.address!r}: {name} has no {part!r}")
        return ObdTag(tag, where, service, parameter, field=None, count=part == "count")
    try:
        number = int(name, 16)
    except ValueError:
        known = ", ".join(_WORDS)
        raise AddressError(f"{tag.name}: {name!r} is neither a parameter such as 0C nor one of {known}") from None
    pid = pids().get(number)
    if pid is None or not pid.fields:
        raise AddressError(
            f"{tag.name}: service 01 parameter {number:02X} is not in the table (drivers/vehicle/obd.dbc)"
        )
    names = tuple(pid.fields)
    if part not in (*names, "") or (not part and len(names) > 1):
        first = f"obd:{number:02X}.{names[0]}"
        raise AddressError(f"{tag.name}: parameter {number:02X} has {', '.join(names)}; give one, such as {first!r}")
    return ObdTag(tag, where, CURRENT, number, pid.fields[part or names[0]])


class ObdListener:
    """Readings of `obd:` tags from the frames of one or more buses. Raises AddressError for a tag it cannot mean."""

    def __init__(self, tags: Sequence[Tag]) -> None:
        self._wanted: dict[tuple[int, int, int], list[ObdTag]] = {}
        self._found_units: dict[tuple[str, int], Reassembler] = {}
        self._requests: dict[tuple[str, int], _Request] = {}
        self._counts = dict.fromkeys(("answers", "unread", "refusals", "unasked_refusals", "requests"), 0)
        for tag in tags:
            obd_tag = parse_tag(tag)
            units = ENGINE if obd_tag.where.source is None else (obd_tag.where.source,)
            for unit in units:
                self._wanted.setdefault((unit, obd_tag.service, obd_tag.parameter), []).append(obd_tag)

    def take(self, frame: CanFrame) -> Sequence[TagReading]:
        """What the frame, or the answer that it completes, says of the tags."""
        if frame.fd:
            return ()
        if asks(frame.id, frame.extended):
            self._note(frame)
            return ()
        if not answers(frame.id, frame.extended):
            return ()
        key = (frame.channel, frame.id)
        unit = self._found_units.get(key)
        if unit is None:
            unit = self._found_units[key] = Reassembler()
        payload = unit.take(frame.time, frame.data)
        return () if payload is None else self._payload(frame, payload)

    def counts(self) -> Mapping[str, int]:
        """Answers used, payloads that could not be read, refusals; and of all units' ISO-TP frames what went wrong."""
        total = dict(self._counts)
        for unit in self._found_units.values():
            for name, count in unit.counts.items():
                total[f"isotp_{name}"] = total.get(f"isotp_{name}", 0) + count
        return total

    def restart(self) -> None:
        """It is another connection: no message that began before it is gone on with, no request is refused."""
        for unit in self._found_units.values():
            unit.restart()
        self._requests.clear()

    def _payload(self, frame: CanFrame, payload: bytes) -> Sequence[TagReading]:
        service = payload[0] - ANSWER
        if payload[0] == REFUSAL:
            return self._take_refusal(frame, payload)
        readings: Sequence[TagReading] | None = None
        if service == CURRENT:
            readings = self._current(frame.id, payload)
        elif service in (STORED, PENDING, PERMANENT):
            readings = self._codes(frame.id, service, payload)
        elif service == VEHICLE:
            readings = self._vehicle(frame.id, payload)
        self._counts["unread" if readings is None else "answers"] += 1
        return readings or ()

    def _current(self, unit: int, payload: bytes) -> list[TagReading] | None:
        """Service 01: one or several parameters, each number followed by its data; None if they do not add up."""
        parts, at = {}, 1
        while at < len(payload):
            pid = pids().get(payload[at])
            if pid is None or pid.number in parts or at + 1 + pid.length > len(payload):
                return self._unreadable(unit, payload)
            parts[pid.number] = payload[at + 1 : at + 1 + pid.length]
            at += 1 + pid.length
        return [
            TagReading(obd_tag.tag, _field(obd_tag, obd_tag.field, single_frame(number, data)))
            for number, data in parts.items()
            for obd_tag in self._wanted.get((unit, CURRENT, number), ())
            if obd_tag.field is not None
        ]

    def _unreadable(self, unit: int, payload: bytes) -> list[TagReading] | None:
        """An answer whose length is not that of its parameters: the first one is named, and is not good."""
        obd_tags = self._wanted.get((unit, CURRENT, payload[1]), ()) if len(payload) > 1 else ()
        if not obd_tags:
            return None
        self._counts["unread"] += 1
        self._counts["answers"] -= 1
        reason = f"the answer {payload.hex(' ')} is not as long as its parameters"
        return [TagReading(obd_tag.tag, (None, Quality.DECODING_ERROR, reason)) for obd_tag in obd_tags]

    def _codes(self, unit: int, service: int, payload: bytes) -> list[TagReading] | None:
        """Services 03, 07, 0A: how many trouble codes, then two bytes each."""
        if len(payload) < 2 or len(payload) != 2 + 2 * payload[1]:
            return None
        codes = [trouble_code(payload[at], payload[at + 1]) for at in range(2, len(payload), 2)]
        count, text = len(codes), " ".join(codes)
        return [
            TagReading(
                obd_tag.tag,
                address.number(obd_tag.tag, obd_tag.where, count, whole=True)
                if obd_tag.count
                else address.text(obd_tag.tag, text),
            )
            for obd_tag in self._wanted.get((unit, service, 0), ())
        ]

    def _vehicle(self, unit: int, payload: bytes) -> list[TagReading] | None:
        """Service 09: parameter, number of items, text."""
        if len(payload) < 4:
            return None
        words = payload[3:].strip(b"\0 ").decode("latin-1")
        obd_tags = self._wanted.get((unit, VEHICLE, payload[1]), ())
        return [TagReading(obd_tag.tag, address.text(obd_tag.tag, words)) for obd_tag in obd_tags]

    def _note(self, frame: CanFrame) -> None:
        length = frame.data[0] if frame.data else 0
        if not 1 <= length <= 7 or len(frame.data) < length + 1:
            return
        self._counts["requests"] += 1
        request = _Request(frame.time, frame.data[1], bytes(frame.data[2 : length + 1]))
        self._requests[frame.channel, asked_unit(frame.id, frame.extended)] = request

    def _take_refusal(self, frame: CanFrame, payload: bytes) -> Sequence[TagReading]:
        """A refusal makes the tags of the request that it answers bad; "response pending" changes nothing."""
        if len(payload) != 3:
            self._counts["unread"] += 1
            return ()
        service, code = payload[1], payload[2]
        self._counts["refusals"] += 1
        if code == RESPONSE_PENDING:
            return ()
        request = self._find_request(frame, service)
        if request is None:
            self._counts["unasked_refusals"] += 1
            return ()
        quality, name = _REFUSALS.get(code, (Quality.DEVICE_FAILURE, "refused"))
        reason = f"unit {frame.id:X} refuses service {service:02X}: {name} (0x{code:02X})"
        parameters = request.parameters if service in (CURRENT, VEHICLE) else b"\0"
        obd_tags = [obd_tag for number in parameters for obd_tag in self._wanted.get((frame.id, service, number), ())]
        return [TagReading(obd_tag.tag, (None, quality, reason)) for obd_tag in obd_tags]

    def _find_request(self, frame: CanFrame, service: int) -> _Request | None:
        """The latest request for the service, to this unit or to all."""
        # A refusal names the service alone: what was asked for is known only from the request.
        requests = [self._requests.get((frame.channel, unit)) for unit in (frame.id, 0)]
        fitting = [
            request
            for request in requests
            if request and request.service == service and 0 <= frame.time - request.time <= REFUSAL_WINDOW_S
        ]
        return max(fitting, key=lambda request: request.time, default=None)


def answers(number: int, extended: bool) -> bool:
    """True for the identifier of a control unit's answer."""
    return number & 0x1FFFFF00 == 0x18DAF100 if extended else 0x7E8 <= number <= 0x7EF


def asks(number: int, extended: bool) -> bool:
    """True for the identifier of a tester's request, to all units or to one."""
    if extended:
        return number == 0x18DB33F1 or number & 0x1FFF00FF == 0x18DA00F1
    return number == 0x7DF or 0x7E0 <= number <= 0x7E7


def asked_unit(number: int, extended: bool) -> int:
    """The identifier of the answer of the unit that a request asks; 0 for all."""
    if extended:
        return 0 if number == 0x18DB33F1 else 0x18DAF100 | number >> 8 & 0xFF
    return 0 if number == 0x7DF else number + 8


def trouble_code(high: int, low: int) -> str:
    """The name of a trouble code: P0133 for 0x01 0x33 (SAE J2012)."""
    return f"{_CODE_SYSTEMS[high >> 6]}{high >> 4 & 3}{high & 15:X}{low:02X}"


def _field(obd_tag: ObdTag, field: PidField, frame: bytes) -> Reading:
    if not all(condition.holds(frame) for condition in field.conditions):
        return None, Quality.NO_DATA, f"{field.name} is not there in this vehicle"
    raw = field.bits.get(frame)
    if raw in field.unused or raw in obd_tag.tag.sentinels:
        return None, Quality.NO_DATA, f'the unit says "not used" ({raw})'
    if field.signed and raw >> field.bits.length - 1:
        raw -= 1 << field.bits.length
    is_whole = field.scale.is_integer() and field.offset.is_integer()
    return address.number(obd_tag.tag, obd_tag.where, raw * field.scale + field.offset, whole=is_whole)
