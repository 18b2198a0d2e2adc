"""The options that all `decanter plc` commands share: which device over which link, what to keep, who asks.

They are listed once, in the help of `plc`; nothing heavy is imported for it.
"""

import tomllib
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import wraps
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from drivers.driver import LINKS
from drivers.named_files import parse_toml
from gateway.console import find_plant_file
from gateway.entry import FormerOption

_FILE = click.Path(path_type=Path)
RECORDS = Path("out/commissioning.jsonl")


class SharedOption(click.Option):
    """An option that many commands take and only their group's help lists; completion offers it everywhere."""

    listed_by = "Connection, --json and records: see `decanter plc --help`."
    """What the help of a command says instead."""

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        """Its line in the help of a group; none in that of a command."""
        return super().get_help_record(ctx) if isinstance(ctx.command, click.Group) else None


def _shared_option(*names: str, **settings: Any) -> Any:
    return click.option(*names, cls=SharedOption, **settings)


_PLANT_OPTIONS = (
    _shared_option(
        "--config",
        "plant",
        type=_FILE,
        help="Plant file: its first link, or the one that --link names.  [default: plant.toml, config/plant.toml]",
    ),
    _shared_option("--machine", metavar="NAME", help="Which machine of a plant file that has several."),
)
_DEVICE_OPTIONS = (
    _shared_option("--device", type=_FILE, help="Device file (register map) instead of a plant file."),
    _shared_option("--link", metavar="KIND", help=f"One of {', '.join(LINKS)}; with --config also a link's name."),
)
_DRIVER_OPTIONS = (
    _shared_option("--host", metavar="HOST[:PORT]", help="Modbus over a network: where the PLC is (502; TLS: 802)."),
    _shared_option("--unit", type=click.IntRange(0, 255), help="Modbus unit (1)."),
    _shared_option("--serial", metavar="PATH", help="Modbus RTU: the serial port."),
    _shared_option("--channel", help="CAN: the interface's own, such as can0, or a hub's path."),
    _shared_option("--node", type=click.IntRange(1, 127), help="CANopen node."),
)
_OTHERS = _shared_option(
    "--set",
    "others",
    multiple=True,
    metavar="KEY=VALUE",
    help="Any other key of the device file's [device]: timeout, baud, parity, interface, bitrate, eds, dbc, "
    "certificates (the folder of ca.pem, client.pem, client.key: Modbus/TCP Security).",
)


def _former_option(*names: str, now: str, **settings: Any) -> Any:
    return click.option(*names, cls=FormerOption, now=now, **settings)


_FORMER_OPTIONS = (
    _former_option("--port", type=click.IntRange(1, 65535), now="--host HOST:{}"),
    _former_option("--timeout", type=click.FloatRange(0.001, 60), now="--set timeout={}"),
    _former_option("--baud", type=click.IntRange(300), now="--set baud={}"),
    _former_option("--parity", type=click.Choice(["N", "E", "O"]), now="--set parity={}"),
    _former_option("--tls", "certificates", now="--set certificates={}"),
    _former_option("--interface", now="--set interface={}"),
    _former_option("--bitrate", type=click.IntRange(1000), now="--set bitrate={}"),
    _former_option("--eds", type=_FILE, now="--set eds={}"),
    _former_option("--dbc", type=_FILE, now="--set dbc={}"),
)
PLACE_OPTIONS = (*_DEVICE_OPTIONS, *_DRIVER_OPTIONS, *_FORMER_OPTIONS, _OTHERS)
"""Which device over which link: for what a plant file does not say."""

_JSON = _shared_option("--json", "as_json", is_flag=True, help="One JSON object instead of text.")
_PCAP = _shared_option("--pcap", type=_FILE, help="Also keep the frames in this pcap file.")
_ACCOUNT_OPTIONS = (
    _shared_option(
        "--records",
        type=_FILE,
        default=RECORDS,
        show_default=True,
        envvar="DECANTER_RECORDS",
        help="Append what was done to this file.",
    ),
    _shared_option(
        "--by",
        default="",
        envvar="DECANTER_BY",
        help="Who asks.  [default: the login; arm wants a name]",
    ),
)
"""Where a command is kept, and by whom it was asked."""
CONNECTION_OPTIONS = (*_PLANT_OPTIONS, *PLACE_OPTIONS)
RECORD_OPTIONS = (_JSON, _PCAP, *_ACCOUNT_OPTIONS)


def _collect_params(options: Any) -> list[click.Parameter]:
    command: Any = lambda **_: None  # noqa: E731
    for option in reversed(options):
        command = option(command)
    return click.command("shared")(command).params


def shared_options() -> tuple[list[click.Parameter], list[click.Parameter]]:
    """The options of the connection and those of the records, as a command has them."""
    return _collect_params(CONNECTION_OPTIONS), _collect_params(RECORD_OPTIONS)


_SETTINGS = tuple(option.name for option in _collect_params((*_DRIVER_OPTIONS, *_FORMER_OPTIONS)) if option.name)
"""The driver's settings that have an option of their own, or had one."""
_RANGES: dict[str | None, Any] = {
    option.name: option.type
    for option in _collect_params(_FORMER_OPTIONS)
    if isinstance(option.type, click.IntRange | click.FloatRange | click.Choice)
}
"""What a setting may be, for a value that is wrong before any device is asked."""
_TEXTS = frozenset(
    option.name
    for option in _collect_params(_FORMER_OPTIONS)
    if isinstance(option.type, click.Path | click.types.StringParamType)
)
"""Settings that are text, whatever else TOML may read in it: a folder called 2024."""


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


_PLACES = frozenset({"host", "serial", "channel"})
"""Settings that name a device by themselves: where one is given, the working folder's plant file is not meant."""


def link_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The command with all shared options; it gets them as one argument, `given`."""

    @wraps(command)
    def call(**options: Any) -> Any:
        given = _take_shared(options)
        if given.plant is None and given.device is None and not _PLACES & set(given.settings):
            with suppress(ValueError):  # what is missing without one the target says
                given = replace(given, plant=find_plant_file())
        return command(given=given, **options)

    return _with_options(call, *CONNECTION_OPTIONS, *RECORD_OPTIONS)


def plant_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The command with the options of a plant file and the records alone, for one that asks no device; it gets `given`.

    Where no --config says so, the plant file is the working folder's.
    """

    @wraps(command)
    def call(**options: Any) -> Any:
        given = _take_shared(options)
        if given.plant is None:
            with suppress(ValueError):  # the command says what is missing
                given = replace(given, plant=find_plant_file())
        return command(given=given, **options)

    return _with_options(call, *_PLANT_OPTIONS, _JSON, *_ACCOUNT_OPTIONS)


def place_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The command with the options of a place and --json alone, for one that makes a plant file; it gets `given`."""

    @wraps(command)
    def call(**options: Any) -> Any:
        return command(given=_take_shared(options), **options)

    return _with_options(call, *PLACE_OPTIONS, _JSON)


def _with_options(call: Callable[..., Any], *options: Any) -> Callable[..., Any]:
    for option in reversed(options):
        call = option(call)
    return call


def record_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The command with --json, --records and --by alone, for one that speaks to no device; it gets `given` too.

    Where neither --config, --audit nor --records says whose account is meant, it is the working folder's plant file's.
    """

    @wraps(command)
    def call(**options: Any) -> Any:
        filled = {"plant": None, "device": None, "link": None, "machine": None, "others": (), **options}
        given = _take_shared(filled)
        default = click.get_current_context().get_parameter_source("records") is ParameterSource.DEFAULT
        if default and given.plant is None and filled.get("audit") is None:
            with suppress(ValueError):  # without one the audit log lies beside the records
                given = replace(given, plant=find_plant_file())
        return command(given=given, **filled)

    return _with_options(call, _JSON, *_ACCOUNT_OPTIONS)


def audit_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """The command with --audit; it gets `audit`."""
    help_text = "The audit log.  [default: the plant file's; without one audit.sqlite beside the records]"
    wrapped: Callable[..., Any] = click.option("--audit", type=_FILE, help=help_text)(command)
    return wrapped


def _take_shared(options: dict[str, Any]) -> SharedOptions:
    """Take the shared options out of all options."""
    values = {name: options.pop(name, None) for name in _SETTINGS}
    settings: dict[str, Any] = {
        name: str(value) if isinstance(value, Path) else value for name, value in values.items() if value is not None
    }
    settings |= dict(map(_other, options.pop("others", ())))
    settings = _split_host(settings)
    names = ("plant", "device", "link", "machine", "as_json", "pcap", "records", "by")
    kept = {name: options.pop(name, None) for name in names}
    return SharedOptions(settings=settings, **kept)


def _split_host(settings: dict[str, Any]) -> dict[str, Any]:
    """With the port that was given with the host, which wins over that of a file. Raises BadParameter."""
    if not isinstance(settings.get("host"), str):
        return settings
    from drivers.settings import with_place  # pydantic with it, which no help needs

    try:
        return with_place(settings)
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint="--host") from None


def _other(text: str) -> tuple[str, Any]:
    """`max_registers=16` as a setting; the value is TOML, or else text."""
    key, equals, value = text.partition("=")
    if not (equals and key.strip()):
        raise click.BadParameter(f"{text!r}: give KEY=VALUE, such as max_registers=16", param_hint="--set")
    key = key.strip()
    try:
        setting = parse_toml(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        setting = value.strip()
    if key in _TEXTS and not isinstance(setting, str):
        return key, value.strip()
    if key not in _RANGES:
        return key, setting
    try:
        return key, _RANGES[key].convert(str(setting), None, None)
    except click.BadParameter as error:
        raise click.BadParameter(error.message, param_hint=f"--set {key}") from None


bit_option = click.option("--bit", type=click.IntRange(0, 15), help="One bit of the register.")
only_option = click.option("--only", multiple=True, metavar="TAG", help="Only this tag; may be given again.")
period_option = click.option(
    "--period", type=click.FloatRange(0.01), help="Seconds between two scans.  [default: the plant file's]"
)
