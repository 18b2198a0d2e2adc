"""The dictionary that everybody may read: what a signal is, and what one reading of it is."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum

Value = bool | int | float | str


class Quality(IntEnum):
    """OPC UA status codes (OPC 10000-4, 7.39 and OPC 10000-6, A.2); the two top bits give the severity.

    `is_good` is true only for severity "good", which an uncertain value has not; what `is_bad` must not be used.
    """

    is_good: bool
    is_bad: bool

    GOOD = 0x00000000
    UNCERTAIN = 0x40000000
    LAST_USABLE = 0x40900000
    SENSOR_NOT_ACCURATE = 0x40930000
    BAD = 0x80000000
    COMMUNICATION_ERROR = 0x80050000
    DECODING_ERROR = 0x80070000
    TIMEOUT = 0x800A0000
    NO_COMMUNICATION = 0x80310000
    WAITING_FOR_INITIAL_DATA = 0x80320000
    DATA_ENCODING_INVALID = 0x80380000
    OUT_OF_RANGE = 0x803C0000
    CONFIGURATION_ERROR = 0x80890000
    NOT_CONNECTED = 0x808A0000
    DEVICE_FAILURE = 0x808B0000
    SENSOR_FAILURE = 0x808C0000
    OUT_OF_SERVICE = 0x808D0000
    NO_DATA = 0x809B0000

    def __init__(self, code: int) -> None:
        # Worked out once: every stage of a scan asks it of every tag.
        self.is_good, self.is_bad = code >> 30 == 0, code >> 30 >= 2


class DType(StrEnum):
    """How a value lies in registers or bytes."""

    BOOL = "bool"
    INT8 = "int8"
    UINT8 = "uint8"
    INT16 = "int16"
    UINT16 = "uint16"
    INT32 = "int32"
    UINT32 = "uint32"
    INT64 = "int64"
    UINT64 = "uint64"
    FLOAT32 = "float32"
    FLOAT64 = "float64"
    BCD16 = "bcd16"
    BCD32 = "bcd32"
    STRING = "string"


class Order(StrEnum):
    """Byte order inside a register (AB or BA) and register order (high word first or last).

    ABCD is big-endian throughout (the Modbus convention), DCBA little-endian throughout, CDAB swaps words, BADC swaps
    bytes. A 64-bit value follows the same rule over four registers.
    """

    ABCD = "ABCD"
    CDAB = "CDAB"
    BADC = "BADC"
    DCBA = "DCBA"


@dataclass(frozen=True, slots=True)
class Tag:
    """One signal of the plant: where it lies in the device and what its number means.

    `address` is the driver's own notation (`holding:100`, `coil:3`, `0x2001:1`). Engineering value = raw * scale +
    offset, in `unit`; `low`..`high` is the plausible range in engineering units (outside it: OUT_OF_RANGE).
    `sentinel` is the raw number by which the device says "not available", `other_sentinels` are further ones (wire
    broken, short circuit), of which none is ever written. `deadband` (engineering units) is the change
    that is worth reporting, `max_rate` (units/s) the fastest believable one. `frozen_after` (s): a reading that has not
    moved a bit for longer is SENSOR_NOT_ACCURATE; 0 turns the check off, as a signal at rest may be constant. `bit`
    picks one bit of a register, `length` is a string's length in bytes, `labels` names an enumeration's values.
    `period` (s): it is read no more often, and what was read last stands in between; 0: with every scan.
    `scale_from` is the address of a register with the power of ten by which the raw number is multiplied before `scale`
    (SunSpec's scale factor); "" for none.
    """

    name: str
    address: str
    dtype: DType = DType.UINT16
    order: Order = Order.ABCD
    scale: float = 1.0
    offset: float = 0.0
    unit: str = ""
    low: float | None = None
    high: float | None = None
    bit: int | None = None
    length: int = 0
    sentinel: int | float | None = None
    deadband: float = 0.0
    max_rate: float | None = None
    frozen_after: float = 0.0
    writable: bool = False
    labels: Mapping[int, str] = field(default_factory=dict)
    other_sentinels: tuple[int | float, ...] = ()
    period: float = 0.0
    scale_from: str = ""

    @property
    def is_switch(self) -> bool:
        """Whether it is on or off and nothing else: a boolean, or one bit of a register."""
        return self.dtype is DType.BOOL or self.bit is not None

    @property
    def sentinels(self) -> tuple[int | float, ...]:
        """All raw numbers that mean "not available"."""
        return () if self.sentinel is None else (self.sentinel, *self.other_sentinels)


@dataclass(frozen=True, slots=True)
class Sample:
    """One reading. A failed read is a sample too: value None, a bad quality and the reason.

    `time` is the moment the reply was complete, `sent` the moment the request left (both seconds UTC of the clock that
    the driver was given): the device looked at its memory somewhere in [sent, time], and nothing narrower is known.
    """

    tag: str
    value: Value | None
    quality: Quality
    time: float
    sent: float | None = None
    reason: str = ""
