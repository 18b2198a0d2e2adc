"""Units as exports write them, as maps call them, and what makes one of another; the one owner of both tables."""

import math

UNITS = {
    "°c": "degC", "degc": "degC", "c": "degC", "grad": "degC", "deg c": "degC", "ºc": "degC", "celsius": "degC",
    "℃": "degC", "deg_c": "degC", "grad c": "degC", "gradc": "degC", "grad_c": "degC", "grad celsius": "degC",
    "deg celsius": "degC", "degrees celsius": "degC", "degrees c": "degC",
    "°f": "degF", "degf": "degF", "f": "degF", "deg f": "degF", "ºf": "degF", "fahrenheit": "degF", "℉": "degF",
    "deg_f": "degF", "grad f": "degF", "gradf": "degF", "grad_f": "degF", "grad fahrenheit": "degF",
    "deg fahrenheit": "degF", "degrees fahrenheit": "degF", "degrees f": "degF",
    "0.1 degc": "0.1 degC", "0.1 °c": "0.1 degC",
    "k": "K", "kelvin": "K", "°k": "K", "a": "A", "amp": "A", "amps": "A", "ampere": "A", "amperes": "A", "ma": "mA",
    "milliamps": "mA", "ka": "kA",
    "v": "V", "mv": "mV", "kv": "kV", "kw": "kW", "w": "W", "mw": "MW", "watt": "W", "bar": "bar", "mbar": "mbar",
    "kpa": "kPa",
    "%": "%", "rpm": "rpm", "1/min": "rpm", "min-1": "rpm", "r/min": "rpm", "u/min": "rpm", "giri/min": "rpm",
    "tr/min": "rpm",
    "mm/s": "mm/s", "g": "g", "m3/h": "m3/h", "m³/h": "m3/h", "l/min": "l/min", "nm": "Nm", "hz": "Hz",
    "wh": "Wh", "kwh": "kWh", "mwh": "MWh", "ah": "Ah", "va": "VA", "kva": "kVA", "var": "var", "kvar": "kvar",
    "mhz": "MHz", "ghz": "GHz", "khz": "kHz", "pa": "Pa", "hpa": "hPa", "mpa": "MPa", "psi": "psi", "ppm": "ppm",
    "l/s": "l/s", "l/h": "l/h", "m3/s": "m3/s", "m³/s": "m3/s", "kg/h": "kg/h", "kg/s": "kg/s", "m/s": "m/s",
    "km/h": "km/h", "lx": "lx", "lux": "lx", "w/m2": "W/m2", "w/m²": "W/m2", "kb/s": "kB/s", "mb/s": "MB/s", "mb": "MB",
    "gb": "GB", "mib": "MiB", "gib": "GiB",
    "s": "s", "sec": "s", "ms": "ms", "us": "us", "µs": "us", "μs": "us", "h": "h", "min": "min",
}  # fmt: skip
"""Units as they are written (lower case) and as maps call them."""

_BASES = {
    "degC": ("degC", 1.0, 0.0), "degF": ("degC", 5 / 9, -160 / 9), "K": ("degC", 1.0, -273.15),
    "0.1 degC": ("degC", 0.1, 0.0),
    "A": ("A", 1.0, 0.0), "mA": ("A", 1e-3, 0.0), "kA": ("A", 1e3, 0.0),
    "W": ("W", 1.0, 0.0), "kW": ("W", 1e3, 0.0), "MW": ("W", 1e6, 0.0),
    "V": ("V", 1.0, 0.0), "mV": ("V", 1e-3, 0.0), "kV": ("V", 1e3, 0.0),
    "bar": ("bar", 1.0, 0.0), "mbar": ("bar", 1e-3, 0.0), "kPa": ("bar", 1e-2, 0.0),
}  # fmt: skip
"""unit: (its base, scale, offset), base = unit * scale + offset."""

CONVERTED_UNITS = {"degF": "degC", "K": "degC", "0.1 degC": "degC", "mA": "A", "kA": "A"}
"""Units that a drafted map converts, and to which: models count in degC and A."""
FAHRENHEIT_REST_RANGE = (50.0, 110.0)
"""Where a machine at rest settles if its degrees are Fahrenheit's (10 to 43 degC)."""


def known_unit(text: str) -> str:
    """The unit that a text writes, "" for none that is known."""
    return UNITS.get(" ".join(text.split()).casefold(), "")


def conversion(unit: str, wanted: str) -> tuple[float, float]:
    """(scale, offset) that make a value in `unit` one in `wanted`; NaN where they measure different things."""
    if unit == wanted:
        return 1.0, 0.0
    base, scale, offset = _BASES.get(unit, (unit, 1.0, 0.0))
    other, by, beyond = _BASES.get(wanted, (wanted, 1.0, 0.0))
    return (scale / by, (offset - beyond) / by) if base == other else (math.nan, math.nan)
