"""The parameters of OBD-II service 01 as one table: SAE J1979 / ISO 15031-5, length, bits, formula and unit.

Engineering value = raw * scale + offset. Bits are counted from the most significant bit of data byte A.
"""

from collections.abc import Mapping
from dataclasses import dataclass

PERCENT = 100.0 / 255.0
TRIM = 100.0 / 128.0


@dataclass(frozen=True, slots=True)
class Field:
    """One number inside a parameter's data.

    `unused` is the raw number that says that it does not apply, `present` the bit that says whether it is there at all.
    """

    name: str
    bit: int
    bits: int
    scale: float = 1.0
    offset: float = 0.0
    unit: str = ""
    signed: bool = False
    unused: int | None = None
    present: int | None = None


@dataclass(frozen=True, slots=True)
class Pid:
    """A parameter: its `length` in data bytes, and its fields (none for what is only needed to be skipped)."""

    number: int
    length: int
    fields: tuple[Field, ...]


def _byte(name: str, scale: float = 1.0, offset: float = 0.0, unit: str = "", at: int = 0) -> Field:
    return Field(name, at * 8, 8, scale, offset, unit)


def _word(
    name: str, scale: float = 1.0, offset: float = 0.0, unit: str = "", at: int = 0, signed: bool = False
) -> Field:
    return Field(name, at * 8, 16, scale, offset, unit, signed)


def _trim(name: str) -> Field:
    return _byte(name, TRIM, -100.0, "%")


def _oxygen(number: int) -> Pid:
    trim = Field("trim", 8, 8, TRIM, -100.0, "%", unused=0xFF)
    return Pid(number, 2, (_byte("voltage", 0.005, unit="V"), trim))


def _wide(number: int, second: Field) -> Pid:
    return Pid(number, 4, (_word("ratio", 2.0 / 65536.0), second))


# number, field: parameters with one number.
_SINGLE: tuple[tuple[int, Field], ...] = (
    (0x04, _byte("load", PERCENT, unit="%")),
    (0x05, _byte("coolant", offset=-40.0, unit="degC")),
    (0x06, _trim("short_trim_1")),
    (0x07, _trim("long_trim_1")),
    (0x08, _trim("short_trim_2")),
    (0x09, _trim("long_trim_2")),
    (0x0A, _byte("fuel_pressure", 3.0, unit="kPa")),
    (0x0B, _byte("manifold_pressure", unit="kPa")),
    (0x0C, _word("engine_speed", 0.25, unit="rpm")),
    (0x0D, _byte("vehicle_speed", unit="km/h")),
    (0x0E, _byte("timing_advance", 0.5, -64.0, "deg")),
    (0x0F, _byte("intake_air", offset=-40.0, unit="degC")),
    (0x10, _word("air_flow", 0.01, unit="g/s")),
    (0x11, _byte("throttle", PERCENT, unit="%")),
    (0x12, _byte("secondary_air")),
    (0x13, _byte("oxygen_sensors")),
    (0x1C, _byte("standard")),
    (0x1D, _byte("oxygen_sensors")),
    (0x1E, Field("power_take_off", 7, 1)),
    (0x1F, _word("run_time", unit="s")),
    (0x21, _word("distance_with_mil", unit="km")),
    (0x22, _word("rail_pressure_relative", 0.079, unit="kPa")),
    (0x23, _word("rail_pressure", 10.0, unit="kPa")),
    (0x2C, _byte("commanded_egr", PERCENT, unit="%")),
    (0x2D, _byte("egr_error", TRIM, -100.0, "%")),
    (0x2E, _byte("evaporative_purge", PERCENT, unit="%")),
    (0x2F, _byte("fuel_level", PERCENT, unit="%")),
    (0x30, _byte("warm_ups")),
    (0x31, _word("distance_since_clear", unit="km")),
    (0x32, _word("vapour_pressure", 0.25, unit="Pa", signed=True)),
    (0x33, _byte("barometric_pressure", unit="kPa")),
    (0x3C, _word("catalyst_1_1", 0.1, -40.0, "degC")),
    (0x3D, _word("catalyst_2_1", 0.1, -40.0, "degC")),
    (0x3E, _word("catalyst_1_2", 0.1, -40.0, "degC")),
    (0x3F, _word("catalyst_2_2", 0.1, -40.0, "degC")),
    (0x42, _word("module_voltage", 0.001, unit="V")),
    (0x43, _word("absolute_load", PERCENT, unit="%")),
    (0x44, _word("commanded_ratio", 2.0 / 65536.0)),
    (0x45, _byte("relative_throttle", PERCENT, unit="%")),
    (0x46, _byte("ambient_air", offset=-40.0, unit="degC")),
    (0x47, _byte("throttle_b", PERCENT, unit="%")),
    (0x48, _byte("throttle_c", PERCENT, unit="%")),
    (0x49, _byte("pedal_d", PERCENT, unit="%")),
    (0x4A, _byte("pedal_e", PERCENT, unit="%")),
    (0x4B, _byte("pedal_f", PERCENT, unit="%")),
    (0x4C, _byte("commanded_throttle", PERCENT, unit="%")),
    (0x4D, _word("time_with_mil", unit="min")),
    (0x4E, _word("time_since_clear", unit="min")),
    (0x51, _byte("fuel_type")),
    (0x52, _byte("ethanol", PERCENT, unit="%")),
    (0x53, _word("absolute_vapour_pressure", 0.005, unit="kPa")),
    (0x54, _word("vapour_pressure", 1.0, unit="Pa", signed=True)),
    (0x59, _word("rail_pressure_absolute", 10.0, unit="kPa")),
    (0x5A, _byte("relative_pedal", PERCENT, unit="%")),
    (0x5B, _byte("hybrid_battery", PERCENT, unit="%")),
    (0x5C, _byte("oil", offset=-40.0, unit="degC")),
    (0x5D, _word("injection_timing", 1.0 / 128.0, -210.0, "deg")),
    (0x5E, _word("fuel_rate", 0.05, unit="L/h")),
    (0x5F, _byte("emission_requirements")),
    (0x61, _byte("demanded_torque", offset=-125.0, unit="%")),
    (0x62, _byte("torque", offset=-125.0, unit="%")),
    (0x63, _word("reference_torque", unit="N m")),
    (0x8E, _byte("friction_torque", offset=-125.0, unit="%")),
)
_SEVERAL = (
    Pid(0x01, 4, (Field("mil", 0, 1), Field("codes", 1, 7))),
    Pid(0x02, 2, ()),
    Pid(0x03, 2, (_byte("system_1"), _byte("system_2", at=1))),
    *(_oxygen(number) for number in range(0x14, 0x1C)),
    *(_wide(number, _word("voltage", 8.0 / 65536.0, unit="V", at=2)) for number in range(0x24, 0x2C)),
    *(_wide(number, _word("current", 1.0 / 256.0, -128.0, "mA", at=2)) for number in range(0x34, 0x3C)),
    Pid(0x41, 4, ()),
    Pid(
        0x4F,
        4,
        (
            _byte("ratio"),
            _byte("voltage", unit="V", at=1),
            _byte("current", unit="mA", at=2),
            _byte("pressure", 10.0, unit="kPa", at=3),
        ),
    ),
    Pid(0x50, 4, (_byte("air_flow", 10.0, unit="g/s"),)),
    *(
        Pid(number, 2, (_byte("bank_a", TRIM, -100.0, "%"), _byte("bank_b", TRIM, -100.0, "%", at=1)))
        for number in range(0x55, 0x59)
    ),
    Pid(
        0x64,
        5,
        tuple(
            _byte(name, offset=-125.0, unit="%", at=at)
            for at, name in enumerate(("idle", "point_1", "point_2", "point_3", "point_4"))
        ),
    ),
    # A says which of the two sensors there are.
    Pid(0x66, 5, (Field("a", 8, 16, 1 / 32, 0.0, "g/s", present=7), Field("b", 24, 16, 1 / 32, 0.0, "g/s", present=6))),
    Pid(0x67, 3, (Field("a", 8, 8, 1.0, -40.0, "degC", present=7), Field("b", 16, 8, 1.0, -40.0, "degC", present=6))),
    Pid(0xA6, 4, (Field("odometer", 0, 32, 0.1, 0.0, "km"),)),
    # Every 32nd parameter says which of the next 32 there are.
    *(Pid(number, 4, (Field("supported", 0, 32),)) for number in range(0x00, 0x100, 0x20)),
)


def _single(number: int, field: Field) -> Pid:
    return Pid(number, -(-(field.bit + field.bits) // 8), (field,))


PIDS: Mapping[int, Pid] = {
    pid.number: pid for pid in (*(_single(number, field) for number, field in _SINGLE), *_SEVERAL)
}
"""Service 01 by parameter number. A number that is not here can be neither bound to a tag nor stepped over."""
