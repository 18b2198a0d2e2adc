"""PDOs as they are mapped: by the EDS, by the device, or as wanted; and what must be written to get there (pure)."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from drivers.canopen.place import ObjectPlace, parse_place
from drivers.errors import AddressError, DriverError

Kind = Literal["T", "R"]
COMMUNICATION: dict[Kind, int] = {"T": 0x1800, "R": 0x1400}
MAPPING: dict[Kind, int] = {"T": 0x1A00, "R": 0x1600}
NOT_VALID, EXTENDED = 1 << 31, 1 << 29
EVENT_DRIVEN = 254
"""Transmission types from here on are sent on events; 1..240 every so many SYNCs, 0 at a SYNC after a change."""
MOST_MAPPED = 64
"""Objects in one PDO: a bit each (CiA 301, 7.5.2.36). More in sub-index 0 is no count."""
LATE_PERIODS = 3.0
"""A PDO is late after so many of its periods, so that two of them may be lost."""


@dataclass(frozen=True, slots=True)
class Mapped:
    """One object in a PDO: `bits` of it, from bit `offset` of the PDO on."""

    place: ObjectPlace
    offset: int
    bits: int

    def cut(self, payload: bytes) -> bytes:
        """The object's own bytes; a part of a byte is a byte of its own."""
        number = int.from_bytes(payload, "little") >> self.offset & (1 << self.bits) - 1
        return number.to_bytes((self.bits + 7) // 8, "little")


@dataclass(frozen=True, slots=True)
class PdoMapping:
    """One PDO of a device. Times in seconds, 0 where there is none."""

    kind: Kind
    number: int
    cob_id: int
    enabled: bool
    transmission: int
    inhibit: float
    event_timer: float
    objects: tuple[Mapped, ...]

    @property
    def name(self) -> str:
        """`TPDO 2 (0x281)`."""
        return f"{self.kind}PDO {self.number} (0x{self.cob_id:X})"

    @property
    def length(self) -> int:
        """Bytes of its frame."""
        return (sum(mapped.bits for mapped in self.objects) + 7) // 8

    @property
    def is_event_driven(self) -> bool:
        """True if it is sent by itself, not with SYNC."""
        return self.transmission >= EVENT_DRIVEN

    def timeout(self, configured: float, sync_period: float) -> float:
        """Seconds of silence after which it is late; 0: it has no period, and only the heartbeat tells of the node."""
        if configured:
            return configured
        if self.is_event_driven:
            return LATE_PERIODS * self.event_timer
        return LATE_PERIODS * max(self.transmission, 1) * sync_period if self.transmission <= 240 else 0.0


def from_objects(kind: Kind, number: int, value: Callable[[ObjectPlace], int | None]) -> PdoMapping | None:
    """The PDO that the objects describe, None where there is none. `value` gives an object's number, None: not there.

    Raises AddressError for a mapping that no frame can carry, and for a number that its object cannot hold.
    """
    communication, mapping = COMMUNICATION[kind] + number - 1, MAPPING[kind] + number - 1

    def checked_value(index: int, sub: int, most: int) -> int | None:
        place, given = ObjectPlace(index, sub), value(ObjectPlace(index, sub))
        if given is not None and not 0 <= given <= most:
            raise AddressError(f"{kind}PDO {number}: {place} is {given}, and it is 0 to {most} (CiA 301)")
        return given

    identifier = checked_value(communication, 1, 0xFFFFFFFF)
    if identifier is None:
        return None
    count = checked_value(mapping, 0, MOST_MAPPED) or 0
    entries = [checked_value(mapping, sub, 0xFFFFFFFF) or 0 for sub in range(1, count + 1)]
    transmission = checked_value(communication, 2, 0xFF)
    # CiA 301, 7.5.2.37: bit 31 of the COB-ID switches a PDO off; inhibit time counts 100 us, the event timer 1 ms.
    return PdoMapping(
        kind=kind,
        number=number,
        cob_id=identifier & 0x1FFFFFFF,
        enabled=not identifier & NOT_VALID,
        transmission=255 if transmission is None else transmission,
        inhibit=(checked_value(communication, 3, 0xFFFF) or 0) * 1e-4,
        event_timer=(checked_value(communication, 5, 0xFFFF) or 0) * 1e-3,
        objects=map_objects(
            [(ObjectPlace(entry >> 16, entry >> 8 & 0xFF), entry & 0xFF) for entry in entries], f"{kind}PDO {number}"
        ),
    )


def map_objects(objects: Iterable[tuple[ObjectPlace, int]], what: str) -> tuple[Mapped, ...]:
    """Places and bits, one after the other from bit 0 on. Raises AddressError if they exceed 64 bits."""
    mapped, offset = [], 0
    for place, bits in objects:
        mapped.append(Mapped(place, offset, bits))
        offset += bits
    if offset > 64:
        raise AddressError(f"{what}: {offset} bits are mapped, and a frame carries 64")
    return tuple(mapped)


def select_pdos(
    pdos: Sequence[PdoMapping], changes: Sequence[object], bits: Callable[[ObjectPlace], int | None]
) -> tuple[PdoMapping, ...]:
    """The TPDOs of the EDS with the changes of the setting `tpdo`. Raises DriverError for one that makes no sense."""
    by_number = {pdo.number: pdo for pdo in pdos}
    for change in changes:
        if not isinstance(change, Mapping) or change.get("number") not in by_number:
            known = ", ".join(map(str, by_number))
            raise DriverError(f"canopen: tpdo: {change!r} must be a table with a number, one of {known}")
        number = change["number"]
        by_number[number] = _apply_change(by_number[number], change, bits)
    return tuple(by_number.values())


_CHANGES: dict[str, tuple[type | tuple[type, ...], str]] = {
    "number": (int, "a whole number"),
    "transmission": (int, "a whole number from 0 to 255"),
    "event_timer": ((int, float), "seconds from 0 to 65"),
    "inhibit": ((int, float), "seconds from 0 to 6.5"),
    "map": (list, "a list of objects such as ['0x2001:1']"),
}
_MOST = {"transmission": 255, "event_timer": 65.0, "inhibit": 6.5, "number": 512}


def _apply_change(pdo: PdoMapping, change: Mapping[str, Any], bits: Callable[[ObjectPlace], int | None]) -> PdoMapping:
    what = f"canopen: tpdo {pdo.number}"
    for key, value in change.items():
        if key not in _CHANGES:
            raise DriverError(f"{what}: unknown key {key!r}: known are {', '.join(_CHANGES)}")
        kind, remedy = _CHANGES[key]
        most = _MOST.get(key)
        fits = isinstance(value, kind) and not isinstance(value, bool)
        if not fits or (most is not None and isinstance(value, int | float) and not 0 <= value <= most):
            raise DriverError(f"{what}: {key} must be {remedy}, not {value!r}")
    objects = pdo.objects
    if "map" in change:
        sized = []
        for text in change["map"]:
            place = parse_place(str(text), what)
            size = bits(place)
            if not size:
                raise DriverError(
                    f"{what}: {place} is no object of the EDS that has a fixed size, so it cannot be mapped"
                )
            sized.append((place, size))
        objects = map_objects(sized, what)
    return replace(
        pdo,
        enabled=True,
        transmission=change.get("transmission", pdo.transmission),
        event_timer=float(change.get("event_timer", pdo.event_timer)),
        inhibit=float(change.get("inhibit", pdo.inhibit)),
        objects=objects,
    )


def writes(pdo: PdoMapping, present: PdoMapping) -> list[tuple[ObjectPlace, bytes]]:
    """What must be written, in CiA 301's order, to make the `present` PDO of the device the one that is wanted.

    Empty if nothing differs. The PDO is switched off first, its mapping emptied, and both are put back last.
    """
    keys = ("cob_id", "enabled", "transmission", "objects")
    changes = {key for key in keys if getattr(pdo, key) != getattr(present, key)}
    # Half of the finest step in which a device keeps a time (the inhibit time's 100 us) is no difference.
    changes |= {key for key in ("inhibit", "event_timer") if abs(getattr(pdo, key) - getattr(present, key)) > 5e-5}
    if not changes:
        return []
    communication, mapping = COMMUNICATION[pdo.kind] + pdo.number - 1, MAPPING[pdo.kind] + pdo.number - 1
    identifier = pdo.cob_id | (EXTENDED if pdo.cob_id > 0x7FF else 0)
    # An identifier may only be changed while the PDO is off: the first write leaves it, the last one sets it.
    off = present.cob_id | (EXTENDED if present.cob_id > 0x7FF else 0) | NOT_VALID
    steps = [(ObjectPlace(communication, 1), off.to_bytes(4, "little"))]
    if "transmission" in changes:
        steps.append((ObjectPlace(communication, 2), bytes([pdo.transmission])))
    if "inhibit" in changes:
        steps.append((ObjectPlace(communication, 3), round(pdo.inhibit * 1e4).to_bytes(2, "little")))
    if "event_timer" in changes:
        steps.append((ObjectPlace(communication, 5), round(pdo.event_timer * 1e3).to_bytes(2, "little")))
    if "objects" in changes:
        steps.append((ObjectPlace(mapping, 0), b"\0"))
        for sub, mapped in enumerate(pdo.objects, start=1):
            entry = mapped.place.index << 16 | mapped.place.subindex << 8 | mapped.bits
            steps.append((ObjectPlace(mapping, sub), entry.to_bytes(4, "little")))
        steps.append((ObjectPlace(mapping, 0), bytes([len(pdo.objects)])))
    last = identifier if pdo.enabled else identifier | NOT_VALID
    if last != off:
        steps.append((ObjectPlace(communication, 1), last.to_bytes(4, "little")))
    return steps
