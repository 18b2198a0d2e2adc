"""The options that all `decanter plc` commands share: which device over which link, what to keep, who asks."""

import tomllib
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import wraps
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from drivers.named_files import parse_toml
from gateway.connection import CONNECTION_OPTIONS, RECORD_OPTIONS
from gateway.console import find_plant_file


@dataclass(frozen=True, slots=True)
class SharedOptions:
    """The shared options of one call; `settings` are the driver's."""

    plant: Path | None
    device: Path | None
    link: str | None
    machine: str | None
    settings: Mapping[str, Any]
    as_json: bool
    pcap: Path | None
    records: Path
    by: str


_SETTINGS: dict[str, str] = {
    "host": "host",
    "port": "port",
    "unit": "unit",
    "timeout": "timeout",
    "serial": "serial",
    "baud": "baud",
    "parity": "parity",
    "tls": "certificates",
    "interface": "interface",
    "channel": "channel",
    "bitrate": "bitrate",
    "node": "node",
    "eds": "eds",
    "dbc": "dbc",
}
"""Parameter of the command line -> the driver's setting."""

_PLACES = frozenset({"host", "serial", "channel"})
"""Settings that name a device by themselves: where one is given, the working folder's plant file is not meant."""


def link_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The command with all shared options; it gets them as one argument, `given`."""

    @wraps(command)
    def with_given(**options: Any) -> Any:
        given = _given(options)
        if given.plant is None and given.device is None and not _PLACES & set(given.settings):
            with suppress(ValueError):  # what is missing without one the target says
                given = replace(given, plant=find_plant_file())
        return command(given=given, **options)

    wrapped: Callable[..., Any] = with_given
    for option in reversed((*CONNECTION_OPTIONS, *RECORD_OPTIONS)):
        wrapped = option(wrapped)
    return wrapped


def record_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The command with --json, --records and --by alone, for one that speaks to no device; it gets `given` too.

    Where neither --config, --audit nor --records says whose account is meant, it is the working folder's plant file's.
    """

    @wraps(command)
    def with_given(**options: Any) -> Any:
        filled = {"plant": None, "device": None, "link": None, "machine": None, "others": (), **options}
        given = _given(filled)
        default = click.get_current_context().get_parameter_source("records") is ParameterSource.DEFAULT
        if default and given.plant is None and filled.get("audit") is None:
            with suppress(ValueError):  # without one the audit log lies beside the records
                given = replace(given, plant=find_plant_file())
        return command(given=given, **filled)

    wrapped: Callable[..., Any] = with_given
    for option in reversed(RECORD_OPTIONS):
        wrapped = option(wrapped)
    return wrapped


def _given(options: dict[str, Any]) -> SharedOptions:
    """Take the shared options out of all options."""
    values = {setting: options.pop(name, None) for name, setting in _SETTINGS.items()}
    settings: dict[str, Any] = {
        name: str(value) if isinstance(value, Path) else value for name, value in values.items() if value is not None
    }
    settings |= dict(map(_other, options.pop("others", ())))
    names = ("plant", "device", "link", "machine", "as_json", "pcap", "records", "by")
    kept = {name: options.pop(name, None) for name in names}
    return SharedOptions(settings=settings, **kept)


def _other(text: str) -> tuple[str, Any]:
    """`max_registers=16` as a setting; the value is TOML, or else text."""
    key, equals, value = text.partition("=")
    if not (equals and key.strip()):
        raise click.BadParameter(f"{text!r}: give KEY=VALUE, such as max_registers=16", param_hint="--set")
    try:
        return key.strip(), parse_toml(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return key.strip(), value.strip()
