"""`decanter plc guess`: how a value lies in the registers, from what the HMI shows."""

import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click

from gateway.commission.plc_options import Given, link_options
from gateway.commission.plc_perform import perform_at
from gateway.console.output import sentences, table

if TYPE_CHECKING:
    from gateway.commission.outcome import Outcome, Site


@click.command()
@click.argument("address")
@click.argument("reading", required=False)
@click.option("--fresh", is_flag=True, help="Forget the earlier readings of this address.")
@link_options
def guess(given: Given, address: str, reading: str | None, fresh: bool) -> None:
    """Find type, word order, scale, offset and the right address from what the HMI shows.

    ADDRESS is where the value is said to be (holding:100 or 40101), READING what the HMI shows at this moment, with all
    its digits (72.4), or on and off. Neighbouring registers are tried too. A second call adds its reading to the first
    one's, from the records; on a terminal without READING it is asked for.
    """
    import time

    from gateway.commission.guessing import earlier_readings
    from gateway.commission.guessing import guess as work
    from gateway.commission.records import check_writable
    from gateway.commission.survey.addresses import parse_register
    from gateway.commission.target import make_target

    with sentences():
        register = parse_register(address)
        target = make_target(given.plant, given.device, given.link, given.settings)
        own = target.capabilities
        if not own.registers:
            raise ValueError(
                f"link {target.kind!r}: types and orders stand in {own.described_in}; guess is for registers"
            )
        check_writable(given.records)
        earlier = [] if fresh else earlier_readings(given.records, target.place, register, time.time())
        shown = _asked(reading)
    arguments = {"address": str(register), "reading": shown, "earlier": len(earlier)}

    async def guessed(site: "Site") -> "Outcome":
        return await work(site, register, shown, earlier)

    perform_at(target, given, "guess", arguments, guessed, _show)


def _asked(reading: str | None) -> str:
    """The reading as given, or as typed on the terminal. Raises ValueError where there is none."""
    if reading is not None:
        return reading
    if not sys.stdin.isatty():
        raise ValueError("what does the HMI show? Give it as the second argument, such as: guess holding:100 72.4")
    return str(click.prompt("The HMI shows"))


def _show(data: Mapping[str, Any]) -> None:
    words = " ".join(f"{word:04X}" for word in data["observation"]["words"])
    click.echo(f"registers from {data['observation']['base']}: {words}")
    if "bits" in data:
        places: dict[str, list[str]] = {}
        for one in data["bits"]:
            places.setdefault(one["address"], []).append(str(one["bit"]))
        rows = [(place, " ".join(bits)) for place, bits in places.items()]
        table(f"{data['readings']} readings, {len(data['bits'])} bits agree", ("address", "bits"), rows)
    else:
        columns = ("belief", "address", "reference", "type", "order", "scale", "offset", "it reads")
        table(f"{data['readings']} readings", columns, [_row(one) for one in data["candidates"]])
    for sentence in data["advice"]:
        click.echo(sentence)


def _row(one: Mapping[str, Any]) -> tuple[str, ...]:
    moved = f" ({one['shift']:+d})" if one["shift"] else ""
    reads = " ".join(f"{value:.6g}" for value in one["values"])
    place = f"{one['address']}{moved}"
    numbers = (f"{one['scale']:.6g}", f"{one['offset']:g}", reads)
    return (f"{one['share']:.1%}", place, one["reference"], one["dtype"], one["order"], *numbers)
