"""A driver's settings checked against a table: every key known, every value of its type and in its range."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from drivers.errors import DriverError


@dataclass(frozen=True, slots=True)
class Setting:
    """One key: its type, its default (None: it must be given, unless `optional`) and its inclusive range."""

    kind: type
    default: Any = None
    low: float | None = None
    high: float | None = None
    optional: bool = False


def check_settings(driver: str, settings: Mapping[str, Any], known: Mapping[str, Setting]) -> dict[str, Any]:
    """Give every known key its value or default.

    Raises DriverError, in one sentence, for a key that the driver does not know (it lists those that it does), a key
    that is missing, and a value of the wrong type or outside its range.
    """
    unknown = sorted(set(settings) - set(known))
    if unknown:
        raise DriverError(f"{driver}: unknown setting {unknown[0]!r}: known are {', '.join(sorted(known))}")
    return {key: _checked(f"{driver}: {key}", settings.get(key), setting) for key, setting in known.items()}


def _checked(place: str, value: Any, setting: Setting) -> Any:
    if value is None:
        if setting.default is None and not setting.optional:
            raise DriverError(f"{place} must be given")
        return setting.default
    if setting.kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if not isinstance(value, setting.kind) or (isinstance(value, bool) and setting.kind is not bool):
        raise DriverError(f"{place} must be {_NAMES[setting.kind]}, not {value!r}")
    if value == "":
        raise DriverError(f"{place} must not be empty")
    if isinstance(value, int | float):
        _check_range(place, value, setting)
    return value


def _check_range(place: str, value: int | float, setting: Setting) -> None:
    if not math.isfinite(value):
        raise DriverError(f"{place} must be a finite number, not {value!r}")
    if setting.low is not None and value < setting.low:
        raise DriverError(f"{place} is {value!r} and must be at least {setting.low:g}")
    if setting.high is not None and value > setting.high:
        raise DriverError(f"{place} is {value!r} and must be at most {setting.high:g}")


_NAMES: dict[type, str] = {
    int: "a whole number",
    float: "a number",
    str: "text",
    bool: "true or false",
    dict: "a table",
    list: "a list",
}
