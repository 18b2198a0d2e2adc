"""How a Modbus device is reached: the settings of each transport, and the wire that they make."""

import datetime as dt
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from pymodbus.pdu import ModbusPDU

from drivers.driver import Clock
from drivers.errors import DeviceException, DriverError, LinkFault
from drivers.modbus.wire import Reply, Secured, Wire
from drivers.settings import Setting, check_settings

SETTINGS: dict[str, Setting] = {
    "transport": Setting(str, "tcp"),
    "host": Setting(str, optional=True),
    "port": Setting(int, None, 1, 65535, optional=True),
    "certificates": Setting(str, optional=True),
    "tls_name": Setting(str, optional=True),
    "serial": Setting(str, optional=True),
    "baud": Setting(int, None, 300, 4_000_000, optional=True),
    "parity": Setting(str, optional=True),
    "stopbits": Setting(int, None, 1, 2, optional=True),
    "echo": Setting(bool, None, optional=True),
    "longest_reply": Setting(float, None, 0.001, 60.0, optional=True),
    "unit": Setting(int, 1, 0, 255),
    "timeout": Setting(float, 0.6, 0.001, 60.0),
    "attempts": Setting(int, 2, 1, 5),
    "connect_timeout": Setting(float, None, 0.001, 60.0, optional=True),
    "max_registers": Setting(int, 125, 1, 125),
    "max_bits": Setting(int, 2000, 1, 2000),
    "max_write_registers": Setting(int, 123, 1, 123),
    "max_gap": Setting(int, 8, 0, 124),
    "pause_ms": Setting(float, 0.0, 0.0, 10_000.0),
    "one_client": Setting(bool, False),
    "backoff_first": Setting(float, 0.2, 0.001, 5.0),
    "backoff_cap": Setting(float, 0.5, 0.001, 5.0),
    "max_failures": Setting(int, 3, 1, 100),
    "max_silence": Setting(float, 2.0, 0.001, 60.0),
    "refused_first": Setting(float, 1.0, 0.001, 3600.0),
    "refused_cap": Setting(float, 10.0, 0.001, 86_400.0),
}
_NETWORK: dict[str, Any] = {"host": None, "port": 502, "connect_timeout": 0.3}
_LINE: dict[str, Any] = {"echo": False, "longest_reply": 2.0}
# Each transport's own settings with their defaults; None: must be given. A TLS handshake is work for a small PLC.
TRANSPORTS: dict[str, dict[str, Any]] = {
    "tcp": _NETWORK,
    "tls": _NETWORK | {"port": 802, "connect_timeout": 3.0, "certificates": None, "tls_name": ""},
    "rtu": _LINE | {"serial": None, "baud": 19200, "parity": "E", "stopbits": 1, "connect_timeout": 0.3},
    "rtu-tcp": _NETWORK | _LINE | {"baud": 19200},
}
_PARITIES = ("N", "E", "O")
_ILLEGAL_FUNCTION = 1
_LAST_UNIT = 247


class AnyWire(Protocol):
    """What every wire offers: see `Wire`."""

    foreign: int
    last: bytes
    fault: LinkFault

    async def connect(self) -> None: ...

    def abandon(self) -> None: ...

    async def ask(self, request: ModbusPDU, deadline: float) -> Reply: ...


@dataclass(frozen=True, slots=True)
class Transport:
    """`wire` makes a wire, not yet connected; `cautions` says what should not stay as it is.

    `refusal_hint` is what else exception 1 (illegal function) may mean here.
    """

    wire: Callable[[Callable[[str], None]], AnyWire]
    cautions: Callable[[], tuple[str, ...]]
    refusal_hint: str = ""

    def explained(self, error: DeviceException) -> DeviceException:
        """The device's refusal with what it may mean on this transport."""
        if error.code != _ILLEGAL_FUNCTION or not self.refusal_hint:
            return error
        return DeviceException(error.code, f"{error}; {self.refusal_hint}")


def checked(settings: Mapping[str, Any]) -> dict[str, Any]:
    """All settings with their defaults, those of other transports None. Raises DriverError in one sentence."""
    given = check_settings("modbus", settings, SETTINGS)
    kind = given["transport"]
    if kind not in TRANSPORTS:
        raise DriverError(f"modbus: transport is {kind!r} and must be one of {', '.join(TRANSPORTS)}")
    own, known = TRANSPORTS[kind], {key for keys in TRANSPORTS.values() for key in keys}
    for key in sorted(known - set(own)):
        if given[key] is not None:
            where = " or ".join(repr(other) for other, keys in TRANSPORTS.items() if key in keys)
            raise DriverError(f"modbus: {key} means nothing with transport {kind!r}: it is for {where}")
    for key, default in own.items():
        if given[key] is None and default is None:
            raise DriverError(f"modbus: {key} must be given")
        given[key] = default if given[key] is None else given[key]
    if kind in ("rtu", "rtu-tcp") and not 1 <= given["unit"] <= _LAST_UNIT:
        raise DriverError(
            f"modbus: unit is {given['unit']}, and on a serial line a device has one of 1 to 247 (0 is for all)"
        )
    if given["parity"] not in (None, *_PARITIES):
        raise DriverError(f"modbus: parity is {given['parity']!r} and must be one of {', '.join(_PARITIES)}")
    return given


def make_transport(settings: Mapping[str, Any], clock: Clock) -> Transport:
    """The transport of checked settings. Raises DriverError for certificates that cannot be used."""
    if settings["transport"] == "tls":
        return _tls(settings, clock)
    if settings["transport"] == "tcp":
        return Transport(lambda on_lost: Wire(settings["host"], settings["port"], clock=clock, on_lost=on_lost), _none)
    return _line(settings, clock)


def _none() -> tuple[str, ...]:
    return ()


def _tls(settings: Mapping[str, Any], clock: Clock) -> Transport:
    from drivers.modbus import tls

    identity = tls.load_identity(Path(settings["certificates"]))
    secured = Secured(identity.context, settings["tls_name"] or settings["host"], tls.sentence)
    place = (settings["host"], settings["port"])
    role = f"the role {identity.role!r} of" if identity.role else "the lack of a role in"
    return Transport(
        lambda on_lost: Wire(*place, clock=clock, on_lost=on_lost, secured=secured),
        lambda: tls.cautions(identity, dt.datetime.now(dt.UTC)),
        f"or {role} our certificate does not allow it",
    )


def _line(settings: Mapping[str, Any], clock: Clock) -> Transport:
    from drivers.modbus.serial_line import LineSettings, LineWire, Quiet

    line = LineSettings(
        serial=settings["serial"] or "",
        host=settings["host"] or "",
        port=settings["port"] or 0,
        baud=settings["baud"],
        parity=settings["parity"] or "N",
        stopbits=settings["stopbits"] or 1,
        echo=settings["echo"],
        longest_reply=settings["longest_reply"],
    )
    quiet = Quiet()
    return Transport(lambda on_lost: LineWire(line, quiet, clock=clock, on_lost=on_lost), _none)
