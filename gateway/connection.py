"""The options of every command that speaks to the device: declared here, and listed once, in the help of `plc`."""

from pathlib import Path
from typing import Any

import click

from drivers.driver import LINKS

_FILE = click.Path(path_type=Path)
RECORDS = Path("out/commissioning.jsonl")


class SharedOption(click.Option):
    """An option that many commands take and only their group's help lists; completion offers it everywhere."""

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        """Its line in the help of a group; none in that of a command."""
        return super().get_help_record(ctx) if isinstance(ctx.command, click.Group) else None


def _shared(*names: str, **settings: Any) -> Any:
    return click.option(*names, cls=SharedOption, **settings)


CONNECTION_OPTIONS = (
    _shared(
        "--config",
        "plant",
        type=_FILE,
        help="Plant file: its first link, or the one that --link names.  [default: plant.toml, config/plant.toml]",
    ),
    _shared("--machine", metavar="NAME", help="Which machine of a plant file that has several."),
    _shared("--device", type=_FILE, help="Device file (register map) instead of a plant file."),
    _shared("--link", metavar="KIND", help=f"One of {', '.join(LINKS)}; with --config also a link's name."),
    _shared("--host", help="Modbus over a network: the PLC's name or address."),
    _shared("--port", type=click.IntRange(1, 65535), help="Its TCP port (502; TLS: 802)."),
    _shared("--unit", type=click.IntRange(0, 255), help="Modbus unit (1)."),
    _shared("--timeout", type=click.FloatRange(0.001, 60), help="Deadline of one request in seconds."),
    _shared("--serial", metavar="PATH", help="Modbus RTU: the serial port."),
    _shared("--baud", type=click.IntRange(300), help="Bits a second of the serial line (19200)."),
    _shared("--parity", type=click.Choice(["N", "E", "O"]), help="Parity of the serial line (E)."),
    _shared("--tls", metavar="DIR", help="Modbus/TCP Security: folder of ca.pem, client.pem, client.key."),
    _shared("--interface", help="CAN: python-can's name of the interface (socketcan), or 'hub'."),
    _shared("--channel", help="CAN: the interface's own, such as can0, or a hub's path."),
    _shared("--bitrate", type=click.IntRange(1000), help="CAN: bits a second."),
    _shared("--node", type=click.IntRange(1, 127), help="CANopen node."),
    _shared("--eds", type=_FILE, help="CANopen: the node's EDS file."),
    _shared("--dbc", type=_FILE, help="CAN: a DBC file."),
    _shared("--set", "others", multiple=True, metavar="KEY=VALUE", help="Any other setting of the driver."),
)
"""Which device over which link: for what a plant file does not say."""

RECORD_OPTIONS = (
    _shared("--json", "as_json", is_flag=True, help="One JSON object instead of text."),
    _shared("--pcap", type=_FILE, help="Also keep the frames in this pcap file."),
    _shared(
        "--records",
        type=_FILE,
        default=RECORDS,
        show_default=True,
        envvar="DECANTER_RECORDS",
        help="Append what was done to this file.",
    ),
    _shared(
        "--by",
        default="",
        envvar="DECANTER_BY",
        help="Who asks.  [default: the login; arm wants a name]",
    ),
)
"""What is kept of a command, and by whom it was asked."""


def shared_options() -> tuple[list[click.Parameter], list[click.Parameter]]:
    """The options of the connection and those of the records, as a command has them."""

    def made(options: Any) -> list[click.Parameter]:
        command: Any = lambda **_: None  # noqa: E731
        for option in reversed(options):
            command = option(command)
        return click.command("shared")(command).params

    return made(CONNECTION_OPTIONS), made(RECORD_OPTIONS)
