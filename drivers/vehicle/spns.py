"""Suspect parameters of J1939 as one table: parameter group, place, formula, unit (J1939-71).

Engineering value = raw * scale + offset; places as the standard writes them, byte and bit counted from 1, least
significant byte first.
"""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Spn:
    """One parameter: the group (PGN) that holds it, its first byte and bit (from 1), its bits and its formula."""

    number: int
    name: str
    pgn: int
    byte: int
    bit: int
    bits: int
    scale: float
    offset: float
    unit: str


_CELSIUS = (1.0, -40.0, "degC")
_FINE_CELSIUS = (0.03125, -273.0, "degC")
_PERCENT = (0.4, 0.0, "%")
_TORQUE = (1.0, -125.0, "%")
_SWITCH = (1.0, 0.0, "")
_VOLT = (0.05, 0.0, "V")
_SPEED = (1.0 / 256.0, 0.0, "km/h")


def _kpa(scale: float) -> tuple[float, float, str]:
    return (scale, 0.0, "kPa")


_ROWS: tuple[tuple[int, str, int, int, int, int, tuple[float, float, str]], ...] = (
    # EEC2, electronic engine controller 2
    (558, "accelerator pedal low idle switch", 0xF003, 1, 1, 2, _SWITCH),
    (559, "accelerator pedal kickdown switch", 0xF003, 1, 3, 2, _SWITCH),
    (91, "accelerator pedal position 1", 0xF003, 2, 1, 8, _PERCENT),
    (92, "engine percent load at current speed", 0xF003, 3, 1, 8, (1.0, 0.0, "%")),
    # EEC1
    (899, "engine torque mode", 0xF004, 1, 1, 4, _SWITCH),
    (512, "driver's demand engine percent torque", 0xF004, 2, 1, 8, _TORQUE),
    (513, "actual engine percent torque", 0xF004, 3, 1, 8, _TORQUE),
    (190, "engine speed", 0xF004, 4, 1, 16, (0.125, 0.0, "rpm")),
    (1675, "engine starter mode", 0xF004, 7, 1, 4, _SWITCH),
    (2432, "engine demand percent torque", 0xF004, 8, 1, 8, _TORQUE),
    # ETC2, transmission
    (524, "transmission selected gear", 0xF005, 1, 1, 8, (1.0, -125.0, "")),
    (526, "transmission actual gear ratio", 0xF005, 2, 1, 16, (0.001, 0.0, "")),
    (523, "transmission current gear", 0xF005, 4, 1, 8, (1.0, -125.0, "")),
    # AT1T1I, diesel exhaust fluid tank
    (1761, "exhaust fluid tank level", 0xFE56, 1, 1, 8, _PERCENT),
    (3031, "exhaust fluid tank temperature", 0xFE56, 2, 1, 8, _CELSIUS),
    # TCO1, EBC2
    (1624, "tachograph vehicle speed", 0xFE6C, 7, 1, 16, _SPEED),
    (904, "front axle speed", 0xFEBF, 1, 1, 16, _SPEED),
    # VDHR, EEC3, VD, HOURS, LFC
    (917, "high resolution total vehicle distance", 0xFEC1, 1, 1, 32, (0.005, 0.0, "km")),
    (918, "high resolution trip distance", 0xFEC1, 5, 1, 32, (0.005, 0.0, "km")),
    (514, "nominal friction percent torque", 0xFEDF, 1, 1, 8, _TORQUE),
    (515, "engine desired operating speed", 0xFEDF, 2, 1, 16, (0.125, 0.0, "rpm")),
    (244, "trip distance", 0xFEE0, 1, 1, 32, (0.125, 0.0, "km")),
    (245, "total vehicle distance", 0xFEE0, 5, 1, 32, (0.125, 0.0, "km")),
    (247, "engine total hours of operation", 0xFEE5, 1, 1, 32, (0.05, 0.0, "h")),
    (249, "engine total revolutions", 0xFEE5, 5, 1, 32, (1000.0, 0.0, "r")),
    (182, "trip fuel", 0xFEE9, 1, 1, 32, (0.5, 0.0, "L")),
    (250, "total fuel used", 0xFEE9, 5, 1, 32, (0.5, 0.0, "L")),
    # ET1, engine temperatures
    (110, "engine coolant temperature", 0xFEEE, 1, 1, 8, _CELSIUS),
    (174, "engine fuel temperature", 0xFEEE, 2, 1, 8, _CELSIUS),
    (175, "engine oil temperature", 0xFEEE, 3, 1, 16, _FINE_CELSIUS),
    (176, "turbocharger oil temperature", 0xFEEE, 5, 1, 16, _FINE_CELSIUS),
    (52, "engine intercooler temperature", 0xFEEE, 7, 1, 8, _CELSIUS),
    # EFL/P1, engine fluid levels and pressures
    (94, "fuel delivery pressure", 0xFEEF, 1, 1, 8, _kpa(4.0)),
    (98, "engine oil level", 0xFEEF, 3, 1, 8, _PERCENT),
    (100, "engine oil pressure", 0xFEEF, 4, 1, 8, _kpa(4.0)),
    (101, "crankcase pressure", 0xFEEF, 5, 1, 16, (1.0 / 128.0, -250.0, "kPa")),
    (109, "coolant pressure", 0xFEEF, 7, 1, 8, _kpa(2.0)),
    (111, "coolant level", 0xFEEF, 8, 1, 8, _PERCENT),
    # CCVS, cruise control and vehicle speed
    (70, "parking brake switch", 0xFEF1, 1, 3, 2, _SWITCH),
    (84, "wheel-based vehicle speed", 0xFEF1, 2, 1, 16, _SPEED),
    (595, "cruise control active", 0xFEF1, 4, 1, 2, _SWITCH),
    (597, "brake switch", 0xFEF1, 4, 5, 2, _SWITCH),
    (598, "clutch switch", 0xFEF1, 4, 7, 2, _SWITCH),
    # LFE, fuel economy
    (183, "engine fuel rate", 0xFEF2, 1, 1, 16, (0.05, 0.0, "L/h")),
    (184, "instantaneous fuel economy", 0xFEF2, 3, 1, 16, (1.0 / 512.0, 0.0, "km/L")),
    (185, "average fuel economy", 0xFEF2, 5, 1, 16, (1.0 / 512.0, 0.0, "km/L")),
    (51, "throttle position", 0xFEF2, 7, 1, 8, _PERCENT),
    # AMB, ambient conditions
    (108, "barometric pressure", 0xFEF5, 1, 1, 8, _kpa(0.5)),
    (170, "cab interior temperature", 0xFEF5, 2, 1, 16, _FINE_CELSIUS),
    (171, "ambient air temperature", 0xFEF5, 4, 1, 16, _FINE_CELSIUS),
    (172, "air inlet temperature", 0xFEF5, 6, 1, 8, _CELSIUS),
    # IC1, inlet and exhaust conditions
    (102, "boost pressure", 0xFEF6, 2, 1, 8, _kpa(2.0)),
    (105, "intake manifold temperature", 0xFEF6, 3, 1, 8, _CELSIUS),
    (106, "air inlet pressure", 0xFEF6, 4, 1, 8, _kpa(2.0)),
    (173, "exhaust gas temperature", 0xFEF6, 6, 1, 16, _FINE_CELSIUS),
    # VEP1, electrical power
    (114, "net battery current", 0xFEF7, 1, 1, 8, (1.0, -125.0, "A")),
    (115, "alternator current", 0xFEF7, 2, 1, 8, (1.0, 0.0, "A")),
    (167, "charging system potential", 0xFEF7, 3, 1, 16, _VOLT),
    (168, "battery potential", 0xFEF7, 5, 1, 16, _VOLT),
    (158, "keyswitch battery potential", 0xFEF7, 7, 1, 16, _VOLT),
    # TRF1, transmission fluids
    (127, "transmission oil pressure", 0xFEF8, 4, 1, 8, _kpa(16.0)),
    (177, "transmission oil temperature", 0xFEF8, 5, 1, 16, _FINE_CELSIUS),
    # DD, dash display
    (96, "fuel level 1", 0xFEFC, 2, 1, 8, _PERCENT),
    (38, "fuel level 2", 0xFEFC, 7, 1, 8, _PERCENT),
)

SPNS: Mapping[int, Spn] = {row[0]: Spn(*row[:6], *row[6]) for row in _ROWS}
"""By parameter number. What is missing here is given as a `pgn:` address or by a DBC file."""
