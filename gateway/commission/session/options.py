"""The options that all `decanter plc` commands share: which device over which link, what to keep, who asks."""

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import wraps
from pathlib import Path
from typing import Any

import click

from drivers.driver import LINKS
from drivers.named_files import parse_toml
from gateway.console import plant_here

_FILE = click.Path(path_type=Path)
RECORDS = Path("out/commissioning.jsonl")


@dataclass(frozen=True, slots=True)
class SharedOptions:
    """The shared options of one call; `settings` are the driver's."""

    plant: Path | None
    device: Path | None
    link: str | None
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

_OPTIONS = (
    click.option(
        "--config",
        "plant",
        type=_FILE,
        help="Plant file: its first link, or the one that --link names.  [default: plant.toml, config/plant.toml]",
    ),
    click.option("--device", type=_FILE, help="Device file (register map) instead of a plant file."),
    click.option("--link", metavar="KIND", help=f"One of {', '.join(LINKS)}; with --config also a link's name."),
    click.option("--host", help="Modbus over a network: the PLC's name or address."),
    click.option("--port", type=click.IntRange(1, 65535), help="Its TCP port (502; TLS: 802)."),
    click.option("--unit", type=click.IntRange(0, 255), help="Modbus unit (1)."),
    click.option("--timeout", type=click.FloatRange(0.001, 60), help="Deadline of one request in seconds."),
    click.option("--serial", metavar="PATH", help="Modbus RTU: the serial port."),
    click.option("--baud", type=click.IntRange(300), help="Bits a second of the serial line (19200)."),
    click.option("--parity", type=click.Choice(["N", "E", "O"]), help="Parity of the serial line (E)."),
    click.option("--tls", metavar="DIR", help="Modbus/TCP Security: folder of ca.pem, client.pem, client.key."),
    click.option("--interface", help="CAN: python-can's name of the interface (socketcan), or 'hub'."),
    click.option("--channel", help="CAN: the interface's own, such as can0, or a hub's path."),
    click.option("--bitrate", type=click.IntRange(1000), help="CAN: bits a second."),
    click.option("--node", type=click.IntRange(1, 127), help="CANopen node."),
    click.option("--eds", type=_FILE, help="CANopen: the node's EDS file."),
    click.option("--dbc", type=_FILE, help="CAN: a DBC file."),
    click.option("--set", "others", multiple=True, metavar="KEY=VALUE", help="Any other setting of the driver."),
)
_KEPT = (
    click.option("--json", "as_json", is_flag=True, help="One JSON object instead of text."),
    click.option("--pcap", type=_FILE, help="Also keep the frames in this pcap file."),
    click.option(
        "--records",
        type=_FILE,
        default=RECORDS,
        show_default=True,
        envvar="DECANTER_RECORDS",
        help="Append what was done to this file.",
    ),
    click.option("--by", default="", envvar="DECANTER_BY", help="Who asks, for the records.  [default: the login]"),
)


def link_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The command with all shared options; it gets them as one argument, `given`."""

    @wraps(command)
    def with_given(**options: Any) -> Any:
        given = _given(options)
        if given.plant is None and given.device is None and not _PLACES & set(given.settings):
            given = replace(given, plant=plant_here())
        return command(given=given, **options)

    wrapped: Callable[..., Any] = with_given
    for option in reversed((*_OPTIONS, *_KEPT)):
        wrapped = option(wrapped)
    return wrapped


def record_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The command with --json, --records and --by alone, for one that speaks to no device; it gets `given` too."""

    @wraps(command)
    def with_given(**options: Any) -> Any:
        filled = {"plant": None, "device": None, "link": None, "others": (), **options}
        return command(given=_given(filled), **filled)

    wrapped: Callable[..., Any] = with_given
    for option in reversed(_KEPT):
        wrapped = option(wrapped)
    return wrapped


def _given(options: dict[str, Any]) -> SharedOptions:
    """Take the shared options out of all options."""
    values = {setting: options.pop(name, None) for name, setting in _SETTINGS.items()}
    settings: dict[str, Any] = {
        name: str(value) if isinstance(value, Path) else value for name, value in values.items() if value is not None
    }
    settings |= dict(map(_other, options.pop("others", ())))
    if "certificates" in settings and options["link"] is None and not (options["plant"] or options["device"]):
        options["link"] = "modbus-tls"
    kept = {name: options.pop(name, None) for name in ("plant", "device", "link", "as_json", "pcap", "records", "by")}
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
