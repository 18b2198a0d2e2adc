"""`decanter plc read`: one reading of tags or bare addresses."""

from collections.abc import Mapping, Sequence
from typing import Any

import click

from gateway.commission.plc_options import Given, link_options
from gateway.commission.plc_perform import perform
from gateway.console.output import table

TYPES = (
    *("bool", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64"),
    *("float32", "float64", "bcd16", "bcd32", "string"),
)
ORDERS = ("ABCD", "CDAB", "BADC", "DCBA")


@click.command()
@click.argument("what", nargs=-1)
@click.option("--type", "dtype", type=click.Choice(TYPES), help="What the addresses hold; plain registers without it.")
@click.option("--order", type=click.Choice(ORDERS), default="ABCD", show_default=True, help="Byte and word order.")
@click.option("--scale", type=float, default=1.0, help="Engineering units per count.")
@click.option("--offset", type=float, default=0.0, help="Engineering units at raw 0.")
@click.option("--bit", type=click.IntRange(0, 15), help="One bit of the register.")
@click.option("--length", type=click.IntRange(1), default=2, help="Bytes of a string.")
@click.option("--count", type=click.IntRange(1, 2000), default=1, help="So many values in a row.")
@link_options
def read(
    given: Given,
    what: Sequence[str],
    dtype: str | None,
    order: str,
    scale: float,
    offset: float,
    bit: int | None,
    length: int,
    count: int,
) -> None:
    """Read tags or bare addresses once: raw words and values side by side.

    WHAT are tags of the device file, or addresses: holding:100, 40101, holding:100-119, 0x2001:1, dbc:Message.Signal.
    Without WHAT all tags are read.
    """
    from drivers.tag import DType, Order
    from gateway.commission.reading import How
    from gateway.commission.reading import read as work

    kind = DType(dtype) if dtype else None
    how = How(kind, Order(order), scale, offset, bit, length if kind is DType.STRING else 0, count)
    arguments = {"what": list(what), "type": dtype, "order": order, "scale": scale, "offset": offset, "count": count}
    perform(given, "read", arguments, lambda site: work(site, what, how), show_readings)


def show_readings(data: Mapping[str, Any]) -> None:
    """The readings as a table; columns that say nothing are left out."""
    rows = data["readings"]
    keys = ["tag", "address", "reference", "hex", "value", "unit", "int16", "bits", "quality", "reason"]
    if all(row["tag"] == row["address"] for row in rows):
        keys.remove("tag")
    keys = [key for key in keys if any(row.get(key) not in (None, "") for row in rows)]
    cells = [["" if row.get(key) is None else shown_value(row[key]) for key in keys] for row in rows]
    good = sum(row["quality"] == "GOOD" for row in rows)
    table(f"{good} of {len(rows)} good", keys, cells)


def shown_value(cell: Any) -> Any:
    """A flag is on or off; a whole number is shown whole."""
    if isinstance(cell, bool):
        return "on" if cell else "off"
    return f"{cell:.7g}" if isinstance(cell, float) else cell
