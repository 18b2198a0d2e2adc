"""PDO parameters in the object dictionary: what they say, and what a master may write to them (CiA 301, 7.5.2)."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from sim.plc.canopen.eds import Address, EdsObject
from sim.plc.canopen.sdo import NOT_MAPPABLE, PDO_LENGTH, STATE, VALUE, Abort

RPDO, TPDO = 0x1400, 0x1800
_MAPPING = 0x200
NOT_VALID = 1 << 31

Number = Callable[[Address], int]


@dataclass(frozen=True, slots=True)
class ActivePdo:
    """One PDO that is switched on. Times in seconds; `objects` are places and bytes."""

    number: int
    cob_id: int
    transmission: int
    inhibit: float
    event_timer: float
    objects: tuple[tuple[Address, int], ...]

    @property
    def on_event(self) -> bool:
        """True if it is sent by itself, not with SYNC."""
        return self.transmission >= 254


def pdos(entries: Mapping[Address, EdsObject], first: int, number: Number) -> Iterator[ActivePdo]:
    """The PDOs from `first` (RPDO or TPDO) on that are switched on, by what the dictionary holds now."""
    for index in sorted({address[0] for address in entries if first <= address[0] < first + 0x200}):
        cob_id = number((index, 1))
        if cob_id & NOT_VALID:
            continue
        mapped = [number((index + _MAPPING, sub)) for sub in range(1, number((index + _MAPPING, 0)) + 1)]
        objects = tuple(((entry >> 16, entry >> 8 & 0xFF), (entry & 0xFF) // 8) for entry in mapped)
        inhibit = number((index, 3)) * 1e-4 if (index, 3) in entries else 0.0
        timer = number((index, 5)) * 1e-3 if (index, 5) in entries else 0.0
        yield ActivePdo(
            number=index - first + 1,
            cob_id=cob_id & 0x7FF,
            transmission=number((index, 2)),
            inhibit=inhibit,
            event_timer=timer,
            objects=objects,
        )


def check_write(entries: Mapping[Address, EdsObject], number: Number, address: Address, value: int) -> None:
    """Raises Abort for a PDO parameter that may not be written now, or not so."""
    index, sub = address
    if RPDO <= index < RPDO + 0x200 or TPDO <= index < TPDO + 0x200:
        on = not number((index, 1)) & NOT_VALID
        if sub == 1 and on and not value & NOT_VALID and value & 0x1FFFFFFF != number(address) & 0x1FFFFFFF:
            raise Abort(VALUE)
        if sub == 2 and 241 <= value <= 253:
            raise Abort(VALUE)
    elif RPDO + _MAPPING <= index < RPDO + 2 * _MAPPING or TPDO + _MAPPING <= index < TPDO + 2 * _MAPPING:
        # A mapping is changed while its PDO is off and its count is 0; the count is written last, and is the moment at
        # which the whole is judged.
        if not number((index - _MAPPING, 1)) & NOT_VALID or (sub > 0 and number((index, 0)) != 0):
            raise Abort(STATE)
        if sub > 0:
            if value:
                _check_mappable(entries, value)
            return
        bits = 0
        for entry in range(1, value + 1):
            if (index, entry) not in entries:
                raise Abort(VALUE)
            _check_mappable(entries, number((index, entry)))
            bits += number((index, entry)) & 0xFF
        if bits > 64:
            raise Abort(PDO_LENGTH)


def _check_mappable(entries: Mapping[Address, EdsObject], mapped: int) -> None:
    entry = entries.get((mapped >> 16, mapped >> 8 & 0xFF))
    if entry is None or not entry.mappable or entry.size is None or 8 * entry.size != mapped & 0xFF:
        raise Abort(NOT_MAPPABLE)
