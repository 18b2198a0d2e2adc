"""The settings of the driver `modbus`: what each key means, and which transport has which."""

import os
from collections.abc import Hashable, Mapping
from contextlib import suppress
from ipaddress import ip_address
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from drivers.modbus.address import WideRange, parse_wide_ranges
from drivers.modbus.identity import PinnedMark, pinned_marks
from drivers.modbus.plan import RequestLimits
from drivers.settings import Reconnecting, check_settings, with_place


def _functions(given: object) -> frozenset[int]:
    """The functions that write, of registers and of coils; the usual one where none is given."""
    functions: frozenset[int] = frozenset(given if isinstance(given, list | tuple | frozenset) else (given,))
    if not functions <= {5, 6, 15, 16} or {6, 16} <= functions or {5, 15} <= functions:
        raise ValueError(f"is {given!r}; give 16 or 6 for registers, 15 or 5 for coils, or one of each in a list")
    return (functions & {6, 16} or frozenset({16})) | (functions & {5, 15} or frozenset({15}))


_NETWORK: dict[str, Any] = {"host": None, "port": 502, "connect_timeout": 0.3}
_LINE: dict[str, Any] = {"echo": False, "longest_reply": 2.0}
TRANSPORTS: dict[str, dict[str, Any]] = {
    "tcp": _NETWORK,
    # A TLS handshake is work for a small PLC.
    "tls": _NETWORK | {"port": 802, "connect_timeout": 3.0, "certificates": None, "tls_name": ""},
    "rtu": _LINE | {"serial": None, "baud": 19200, "parity": "E", "stopbits": 1, "connect_timeout": 0.3},
    "rtu-tcp": _NETWORK | _LINE | {"baud": 19200},
    # A character is seven bits on an ASCII line (V1.02, 2.5.2), and a byte two of them.
    "ascii": _LINE
    | {"serial": None, "baud": 19200, "parity": "E", "stopbits": 1, "bytesize": 7, "connect_timeout": 0.3},
    "ascii-tcp": _NETWORK | _LINE | {"baud": 19200},
    "udp": _NETWORK,
}
"""Each transport's own settings with their defaults; None: must be given."""
_LINES = ("rtu", "rtu-tcp", "ascii", "ascii-tcp")
_ONE_AT_A_TIME = (*_LINES, "udp")
_LAST_UNIT = 247
_WORDS_OF_WIDE = 2


class ModbusSettings(Reconnecting):
    """How a Modbus device is reached and what it takes; seconds unless named otherwise. See `open_modbus`."""

    transport: Literal["tcp", "tls", "rtu", "rtu-tcp", "ascii", "ascii-tcp", "udp"] = Field(
        "tcp", description="the transport's name"
    )
    host: str = Field("", min_length=1, description="the device's address or name")
    port: int = Field(502, ge=1, le=65535, description="a TCP port from 1 to 65535")
    certificates: str = Field("", min_length=1, description="the folder of ca.pem, client.pem and client.key")
    tls_name: str = Field("", description="the name in the PLC's certificate")
    serial: str = Field("", min_length=1, description="the path of the serial port")
    baud: int = Field(19200, ge=300, le=4_000_000, description="bits a second, 300 to 4000000")
    parity: Literal["N", "E", "O"] = Field("N", description="the parity of the line")
    stopbits: int = Field(1, ge=1, le=2, description="1 or 2")
    bytesize: int = Field(8, ge=7, le=8, description="the bits of a character, 7 or 8")
    echo: bool = Field(False, description="true if the adapter gives back what is sent")
    longest_reply: float = Field(
        2.0, ge=0.001, le=60.0, description="the seconds after which an answer can no longer come, 0.001 to 60"
    )
    unit: int = Field(1, ge=0, le=255, description="a unit id from 0 to 255")
    timeout: float = Field(0.3, ge=0.001, le=60.0, description="the deadline of one request in seconds, 0.001 to 60")
    attempts: int = Field(
        2, ge=1, le=5, description="how often a read is sent, each time with its own deadline, 1 to 5"
    )
    connect_timeout: float = Field(
        0.3, ge=0.001, le=60.0, description="the deadline of connecting in seconds, 0.001 to 60"
    )
    max_registers: int = Field(125, ge=1, le=125, description="the most registers of one read, 1 to 125")
    max_bits: int = Field(2000, ge=1, le=2000, description="the most bits of one read, 1 to 2000")
    max_write_registers: int = Field(123, ge=1, le=123, description="the most registers of one write, 1 to 123")
    max_gap: int = Field(8, ge=0, le=124, description="the addresses read in vain to save a request, 0 to 124")
    pause_ms: float = Field(0.0, ge=0.0, le=10_000.0, description="the milliseconds between two requests, 0 to 10000")
    pause_after_connect: float = Field(
        0.0, ge=0.0, le=60.0, description="the seconds before the first request on a connection, 0 to 60"
    )
    transaction_id: Literal["match", "any"] = Field(
        "match",
        description="'any' for a device whose answers have another transaction id than the request, else 'match'",
    )
    answers_as: int | None = Field(
        None, ge=0, le=255, description="the unit id that the device's answers have, if not the one that is asked"
    )
    identity: Annotated[tuple[PinnedMark, ...], BeforeValidator(pinned_marks)] = Field(
        (), description='a table of what the device must say, such as { "product code" = "750-8212" }'
    )
    write_with: Annotated[frozenset[int], BeforeValidator(_functions)] = Field(
        frozenset({15, 16}), description="the function that writes: 16 or 6 for registers, 15 or 5 for coils"
    )
    read_back: Literal["late", "never"] = Field(
        "late", description="'never' for a device that does not show what was written to it, else 'late'"
    )
    close_between_scans: bool = Field(
        False, description="true for a device whose connection is to be free for others between two scans"
    )
    aligned: int = Field(
        1, ge=1, le=8, description="reads begin at a multiple of it and have as many registers, 1 to 8"
    )
    wide_registers: Annotated[tuple[WideRange, ...], BeforeValidator(parse_wide_ranges)] = Field(
        (), description='the addresses whose registers have 32 bits, such as ["holding:5001-5999"] (Enron, Daniel)'
    )
    one_client: bool = Field(False, description="true if the device serves one connection only")
    max_failures: int = Field(3, ge=1, le=100, description="the failures in a row that end a connection, 1 to 100")
    max_silence: float = Field(
        2.0, ge=0.001, le=60.0, description="the seconds without a valid reply that end a connection, 0.001 to 60"
    )
    refused_first: float = Field(
        1.0, ge=0.001, le=3600.0, description="the seconds until a refused address is asked again, 0.001 to 3600"
    )
    refused_cap: float = Field(
        10.0, ge=0.001, le=86_400.0, description="the most seconds until it is asked again, 0.001 to 86400"
    )

    outstanding: int = Field(
        1, ge=1, le=16, description="the most requests under way at a time for all units of a connection, 1 to 16"
    )
    silent_first: float = Field(
        1.0, ge=0.001, le=3600.0, description="the seconds until a silent unit is asked again, 0.001 to 3600"
    )
    silent_cap: float = Field(
        10.0, ge=0.001, le=86_400.0, description="the most seconds until it is asked again, 0.001 to 86400"
    )

    @model_validator(mode="before")
    @classmethod
    def _of_one_transport(cls, settings: dict[str, Any]) -> dict[str, Any]:
        """The transport's own defaults; what only other transports have is refused, not ignored."""
        kind = settings.get("transport", "tcp")
        if isinstance(settings.get("host"), str):
            settings = with_place(settings)
        own = TRANSPORTS.get(kind) if isinstance(kind, str) else None
        if own is None:
            return settings
        for key in sorted(set().union(*TRANSPORTS.values()) - set(own)):
            if key in settings:
                where = " or ".join(repr(other) for other, keys in TRANSPORTS.items() if key in keys)
                raise ValueError(f"{key} means nothing with transport {kind!r}: it is for {where}")
        for key, default in own.items():
            if default is None and key not in settings:
                raise ValueError(f"{key} must be given; give {cls.model_fields[key].description}")
        if isinstance(most := settings.get("max_registers"), int) and "max_write_registers" not in settings:
            # A device's manual gives one limit of a request as a rule: what it says of reads holds for writes too.
            settings = {**settings, "max_write_registers": max(1, min(most, 123))}
        return {**{key: default for key, default in own.items() if default is not None}, **settings}

    @model_validator(mode="after")
    def _what_a_line_carries(self) -> "ModbusSettings":
        if self.transport in _LINES and not 1 <= self.unit <= _LAST_UNIT:
            raise ValueError(f"unit is {self.unit}, and on a serial line a device has one of 1 to 247 (0 is for all)")
        if (self.by_shape and self.transport != "tcp") or (
            self.answers_as is not None and self.transport not in ("tcp", "tls")
        ):
            raise ValueError(f"transaction_id and answers_as mean nothing with transport {self.transport!r}")
        if self.aligned > 1 and self.max_registers <= 2 * (self.aligned - 1):
            raise ValueError(f"max_registers is {self.max_registers}, too few for reads aligned to {self.aligned}")
        if self.wide_registers and self.max_registers < _WORDS_OF_WIDE:
            raise ValueError("max_registers is 1, and a register of wide_registers is two")
        if self.on_line and self.outstanding > 1:
            line = "such a connection" if self.transport == "udp" else "a serial line"
            raise ValueError(f"outstanding is {self.outstanding}, and {line} carries 1 request at a time")
        return self

    @property
    def by_shape(self) -> bool:
        """Whether replies over TCP are told apart as on a serial line, one question at a time."""
        return self.transaction_id == "any"

    @property
    def on_line(self) -> bool:
        """Whether one question is open at a time, and an old answer is waited for."""
        return self.by_shape or self.transport in _ONE_AT_A_TIME

    @property
    def singly(self) -> tuple[bool, bool]:
        """Whether registers, and coils, are written one a request."""
        return 6 in self.write_with, 5 in self.write_with

    @property
    def limits(self) -> RequestLimits:
        """What the device allows in one request."""
        # What alignment adds at either end must still fit.
        room = 2 * (self.aligned - 1)
        return RequestLimits(
            self.max_registers - room, self.max_bits, self.max_gap, self.pause_ms / 1000, self.wide_registers
        )

    @property
    def longest_read(self) -> float:
        """Seconds until a read has failed: every attempt has its own deadline."""
        return self.attempts * self.timeout

    @property
    def place(self) -> str:
        """What the far end is called in a sentence."""
        return self.serial or f"{self.host}:{self.port}"


def read_settings(settings: Mapping[str, Any]) -> ModbusSettings:
    """The settings, checked. Raises DriverError in one sentence."""
    return check_settings("modbus", ModbusSettings, settings)


def connection_place(settings: ModbusSettings) -> Hashable:
    """What tells one connection from another."""
    if settings.serial:
        return ("modbus", os.path.realpath(settings.serial))
    return ("modbus", _canonical_host(settings.host), settings.port)


def _canonical_host(host: str) -> str:
    """One text for all spellings of an address, and for this machine's own name; other names are not looked up."""
    if host.lower() == "localhost":
        return "127.0.0.1"
    with suppress(ValueError):
        return str(ip_address(host))
    return host.lower()


def shared_place(settings: Mapping[str, Any]) -> Hashable:
    """`connection_place` settings that are not checked yet (`Capabilities.shares`). Raises DriverError."""
    return connection_place(read_settings(settings))


def device_identity(settings: Mapping[str, Any]) -> Hashable:
    """What tells the device from others, also on its connection (`Capabilities.identifies`). Raises DriverError."""
    checked = read_settings(settings)
    return (connection_place(checked), checked.unit)
