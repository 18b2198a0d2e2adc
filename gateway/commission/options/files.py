"""The options of the commands that change device files, and what may be said in them."""

import tomllib
from collections.abc import Callable
from typing import Any

import click

from drivers.named_files import parse_toml

TYPES = (
    *("bool", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"),
    *("float32", "float64", "bcd16", "bcd32", "string"),
)
ORDERS = ("ABCD", "CDAB", "BADC", "DCBA")
GAINS = ("multiply", "divide")
"""What is done with a reading by a gain above 1."""
NUMBERS = ("decimal", "hex", "plain")
"""How bare numbers are meant: decimal with references (40101) among them, hexadecimal, decimal and none of them one."""
PLC_MAKERS = ("openplc", "codesys", "schneider", "wago", "siemens")
"""Whose IEC addresses are known (`files.io_places.MAKERS`)."""


def pairs(_: click.Context, option: click.Parameter, texts: tuple[str, ...]) -> dict[str, str]:
    """A callback for LEFT=RIGHT, as often as it is given."""
    values = {}
    for text in texts:
        left, equals, right = text.partition("=")
        if not (equals and left.strip() and right.strip()):
            raise click.BadParameter(f"{text!r}: give {option.metavar}")
        values[left.strip()] = right.strip()
    return values


def _values(context: click.Context, option: click.Parameter, texts: tuple[str, ...]) -> dict[str, Any]:
    """A callback for KEY=VALUE whose values are TOML, or else text."""
    values: dict[str, Any] = {}
    for key, text in pairs(context, option, texts).items():
        try:
            values[key] = parse_toml(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            values[key] = text
    return values


KEEP = click.option(
    "--keep",
    multiple=True,
    metavar="KEY=VALUE",
    callback=_values,
    help="Also keep a setting: max_registers=16 in the device file, scan.period=1 in the plant file.",
)
HEARTBEAT = click.option("--heartbeat", metavar="TAG", help="The tag that counts while the PLC's program runs.")
DRY_RUN = click.option("--dry-run", is_flag=True, help="Show what would be changed; write nothing.")


def list_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The options that say how a list is meant where it does not say so itself."""
    options = (
        click.option(
            "--order",
            type=click.Choice(ORDERS),
            default=None,
            help="Order of wide values.  [default: ABCD, or the list's]",
        ),
        click.option("--shift", type=int, default=0, help="Add this to every address, such as -1 or 1."),
        click.option("--gain", type=click.Choice(GAINS), help="What a gain above 1 does to a reading."),
        click.option(
            "--numbers",
            type=click.Choice(NUMBERS),
            help="What bare addresses are: decimal, hexadecimal, or none of them a reference as 40101 (plain).",
        ),
        click.option("--plc", type=click.Choice(PLC_MAKERS), help="Whose addresses %MD50 and %QX1.3 are."),
    )
    for option in reversed(options):
        command = option(command)
    return command
