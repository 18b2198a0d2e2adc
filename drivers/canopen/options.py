"""The settings of the driver `canopen`: what each key means, and the checked whole."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.canopen.life import Life
from drivers.canopen.place import ObjectPlace, parse_place
from drivers.errors import DriverError
from drivers.settings import Setting, check_settings

SETTINGS: dict[str, Setting] = {
    "interface": Setting(str, "socketcan"),
    "channel": Setting(str),
    "bitrate": Setting(int, low=1000, high=1_000_000, optional=True),
    "node": Setting(int, low=1, high=127),
    "eds": Setting(str, optional=True),
    "configure": Setting(bool, False),
    "listen_only": Setting(bool, False),
    "timeout": Setting(float, 0.3, 0.001, 60.0),
    "connect_timeout": Setting(float, 1.0, 0.001, 60.0),
    "heartbeat_time": Setting(float, 0.2, 0.0, 65.0),
    "heartbeat_timeout": Setting(float, 0.0, 0.0, 3600.0),
    "pdo_timeout": Setting(float, 0.0, 0.0, 3600.0),
    "sync_period": Setting(float, 0.0, 0.0, 60.0),
    "tpdo": Setting(list, optional=True),
    "life": Setting(dict, optional=True),
    "acknowledge": Setting(dict, optional=True),
    "emcy_ignore": Setting(list, optional=True),
    "backoff_first": Setting(float, 0.2, 0.001, 5.0),
    "backoff_cap": Setting(float, 0.5, 0.001, 5.0),
}


@dataclass(frozen=True, slots=True)
class Options:
    """The settings, checked. Times in seconds; 0 for a time-out: what the device's own periods make of it."""

    interface: str
    channel: str
    bitrate: int | None
    node: int
    eds: Path | None
    configure: bool
    listen_only: bool
    timeout: float
    connect_timeout: float
    heartbeat_time: float
    heartbeat_timeout: float
    pdo_timeout: float
    sync_period: float
    tpdo: tuple[object, ...]
    life: tuple[ObjectPlace, float] | None
    acknowledge: Mapping[ObjectPlace, ObjectPlace]
    emcy_ignore: frozenset[int]
    backoff_first: float
    backoff_cap: float

    def new_life(self) -> Life | None:
        """A life counter that knows nothing yet, if one is configured."""
        return Life(*self.life) if self.life else None


def read_options(settings: Mapping[str, Any]) -> Options:
    """The settings as options. Raises DriverError in one sentence for what cannot be used."""
    given = check_settings("canopen", settings, SETTINGS)
    if given["configure"] and given["listen_only"]:
        raise DriverError("canopen: configure and listen_only exclude each other: who only listens configures nothing")
    if given["listen_only"] and given["eds"] is None:
        raise DriverError("canopen: listen_only needs eds: the device cannot be asked for its own")
    ignored = given["emcy_ignore"] or []
    if not all(isinstance(code, int) and 0 <= code <= 0xFFFF for code in ignored):
        raise DriverError(f"canopen: emcy_ignore: {ignored!r} must be a list of error codes such as [0x8120]")
    given |= {
        "eds": None if given["eds"] is None else Path(given["eds"]),
        "tpdo": tuple(given["tpdo"] or ()),
        "life": _life(given["life"]),
        "acknowledge": _acknowledge(given["acknowledge"] or {}),
        "emcy_ignore": frozenset(ignored),
    }
    return Options(**given)


def _life(given: Mapping[str, Any] | None) -> tuple[ObjectPlace, float] | None:
    if given is None:
        return None
    match given:
        case {"object": str() as text, "rate": int() | float() as rate, **rest} if rate > 0 and not rest:
            return parse_place(text, "canopen: life"), float(rate)
    raise DriverError(f"canopen: life: {given!r} must be a table such as {{ object = '0x2002:1', rate = 60 }}")


def _acknowledge(given: Mapping[str, Any]) -> dict[ObjectPlace, ObjectPlace]:
    what = "canopen: acknowledge"
    found = {}
    for written, answered in given.items():
        if not isinstance(answered, str):
            raise DriverError(f"{what}: {answered!r} is no object; give a table such as {{ '0x2100:2' = '0x2101:1' }}")
        found[parse_place(written, what)] = parse_place(answered, what)
    return found
