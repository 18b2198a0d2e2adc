"""The settings of the driver `canopen`: what each key means, and the checked whole."""

from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, model_validator

from drivers.canopen.life import Life
from drivers.canopen.place import ObjectPlace, parse_place
from drivers.settings import Reconnecting, check_settings


def _life(setting: object) -> tuple[ObjectPlace, float]:
    match setting:
        case {"object": str() as text, "rate": int() | float() as rate, **rest} if rate > 0 and not rest:
            return parse_place(text), float(rate)
    raise ValueError(f"{setting!r} must be a table such as {{ object = '0x2002:1', rate = 60 }}")


def _acknowledge(given: object) -> dict[ObjectPlace, ObjectPlace]:
    if not isinstance(given, Mapping):
        raise ValueError(f"{given!r} must be a table such as {{ '0x2100:2' = '0x2101:1' }}")
    acknowledged = {}
    for written, answered in given.items():
        if not isinstance(answered, str):
            raise ValueError(f"{answered!r} is no object; give a table such as {{ '0x2100:2' = '0x2101:1' }}")
        acknowledged[parse_place(written)] = parse_place(answered)
    return acknowledged


IDENTITY = {"vendor": 1, "product": 2, "revision": 3, "serial": 4}
"""The subindices of the identity object 0x1018 (CiA 301, 7.5.2.19)."""


def _identity(given: object) -> dict[str, int]:
    numbers = dict(given) if isinstance(given, Mapping) else {}
    if not numbers or not all(
        name in IDENTITY and type(number) is int and 0 <= number < 1 << 32 for name, number in numbers.items()
    ):
        raise ValueError(f"{given!r} must be a table of {', '.join(IDENTITY)} and their numbers (decanter plc probe)")
    return numbers


def _error_codes(setting: object) -> frozenset[int]:
    if not isinstance(setting, list) or not all(isinstance(code, int) and 0 <= code <= 0xFFFF for code in setting):
        raise ValueError(f"{setting!r} must be a list of error codes such as [0x8120]")
    return frozenset(setting)


class Options(Reconnecting):
    """The settings. Times in seconds; 0 for a time-out: what the device's own periods make of it."""

    interface: str = Field("socketcan", min_length=1, description="python-can's name of the interface, or 'hub'")
    channel: str = Field(min_length=1, description="the interface's own name of the bus, such as 'can0'")
    bitrate: int | None = Field(None, ge=1000, le=1_000_000, description="bits a second, 1000 to 1000000")
    node: int = Field(ge=1, le=127, description="a node id from 1 to 127")
    eds: Annotated[Path | None, Field(strict=False)] = Field(None, description="the path of the node's EDS file")
    identity: Annotated[dict[str, int], BeforeValidator(_identity)] = Field(
        default_factory=dict, description="a table of what 0x1018 of the node must hold, such as { serial = 4711 }"
    )
    configure: bool = Field(False, description="true: this program is the node's master")
    listen_only: bool = Field(False, description="true: nothing is sent")
    timeout: float = Field(0.3, ge=0.001, le=60.0, description="the deadline of an answer in seconds, 0.001 to 60")
    connect_timeout: float = Field(
        1.0, ge=0.001, le=60.0, description="the deadline of opening the bus in seconds, 0.001 to 60"
    )
    heartbeat_time: float = Field(
        0.2, ge=0.0, le=65.0, description="the seconds between two heartbeats that the node is set to, 0 to 65"
    )
    heartbeat_timeout: float = Field(0.0, ge=0.0, le=3600.0, description="the longest time without one, 0 to 3600 s")
    pdo_timeout: float = Field(0.0, ge=0.0, le=3600.0, description="the longest time without a PDO, 0 to 3600 s")
    sync_period: float = Field(0.0, ge=0.0, le=60.0, description="the seconds between two SYNC, 0 (none) to 60")
    tpdo: Annotated[tuple[object, ...], Field(strict=False)] = Field((), description="a list of TPDOs and their maps")
    life: Annotated[tuple[ObjectPlace, float] | None, BeforeValidator(_life)] = Field(
        None, description="a life counter"
    )
    acknowledge: Annotated[dict[ObjectPlace, ObjectPlace], BeforeValidator(_acknowledge)] = Field(
        default_factory=dict, description="a table of objects and those that acknowledge them"
    )
    emcy_ignore: Annotated[frozenset[int], BeforeValidator(_error_codes)] = Field(
        frozenset(), description="a list of error codes"
    )

    @model_validator(mode="after")
    def _one_role(self) -> "Options":
        if self.configure and self.listen_only:
            raise ValueError("configure and listen_only exclude each other: who only listens configures nothing")
        if self.listen_only and self.identity:
            raise ValueError("listen_only asks nothing, and identity is asked for; give one of them")
        if self.listen_only and self.eds is None:
            raise ValueError("listen_only needs eds: the device cannot be asked for its own")
        return self

    def new_life(self) -> Life | None:
        """A life counter that knows nothing yet, if one is configured."""
        return Life(*self.life) if self.life else None


def read_options(settings: Mapping[str, Any]) -> Options:
    """The settings as options. Raises DriverError in one sentence for what cannot be used."""
    return check_settings("canopen", Options, settings)


def node_identity(settings: Mapping[str, Any]) -> Hashable:
    """What tells the node from others (`Capabilities.identifies`). Raises DriverError."""
    options = read_options(settings)
    return ("canopen", options.interface, options.channel, options.node)
