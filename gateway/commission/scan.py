"""`decanter plc scan`: who is there, and what can be read."""

from collections.abc import Awaitable, Callable, Mapping
from typing import Any

import click

from gateway.commission.session import CommandResult, SharedOptions, Site, link_options, make_target, perform
from gateway.commission.survey import parse_stretch, scan_can, scan_nodes, scan_registers, scan_units
from gateway.console import progress, table
from gateway.entry import sentences

Progress = Callable[[str, float], None]


async def _with_bar(title: str, work: Callable[[Progress], Awaitable[CommandResult]]) -> CommandResult:
    """The work with a bar on a terminal, which is gone before anything is printed."""
    with progress(title) as report:
        return await work(report)


def _numbers(low: int, high: int) -> Callable[[click.Context, click.Parameter, str | None], list[int] | None]:
    """A callback that reads `1-32`, `1,2,17` or both as numbers from `low` to `high`, each once; None as it is."""

    def read(_: click.Context, __: click.Parameter, text: str | None) -> list[int] | None:
        if text is None:
            return None
        numbers: list[int] = []
        for part in text.split(","):
            first, dash, last = part.strip().partition("-")
            try:
                span = range(int(first), int(last if dash else first) + 1)
            except ValueError:
                span = range(0)  # refused below, as an empty or a reversed span is
            if not span or span[0] < low or span[-1] > high:
                raise click.BadParameter(f"{part!r}: give numbers from {low} to {high}, such as 1-32 or 1,2,17")
            numbers += [number for number in span if number not in numbers]
        return numbers

    return read


@click.command(short_help="Which Modbus units answer behind this connection.")
@click.option(
    "--units", "numbers", callback=_numbers(0, 255), help="Which to ask; 1-247 until 20 in a row are silent by default."
)
@link_options
def units(given: SharedOptions, numbers: list[int] | None) -> None:
    """Which Modbus units answer behind this connection: each is asked for one register, twice at most.

    Without --units it ends after twenty silent ones in a row, and says so.
    """

    def show(data: Mapping[str, Any]) -> None:
        rows = [(row["unit"], row["ms"], row["answer"], row["identity"]) for row in data["units"]]
        table(f"{len(rows)} of {data['asked']} units answer", ("unit", "ms", "answer", "identity"), rows)

    def work(site: Site) -> Awaitable[CommandResult]:
        return _with_bar("units", lambda report: scan_units(site, numbers, report))

    _only(given, "units", "units are Modbus's")
    perform(given, "scan units", {"units": numbers}, work, show)


@click.command(short_help="Which CANopen nodes are on this bus.")
@click.option("--nodes", "numbers", default="1-127", show_default=True, callback=_numbers(1, 127), help="Which to ask.")
@click.option("--listen-only", is_flag=True, help="Send nothing: only the nodes that have a heartbeat are found.")
@link_options
def nodes(given: SharedOptions, numbers: list[int], listen_only: bool) -> None:
    """Which CANopen nodes are on this bus: by their heartbeats, and by their answers to SDO requests."""

    def show(data: Mapping[str, Any]) -> None:
        keys = list(dict.fromkeys(key for row in data["nodes"] for key in row))
        rows = [[row.get(key, "") for key in keys] for row in data["nodes"]]
        table(f"{len(rows)} of {data['asked']} nodes", keys, rows)

    def work(site: Site) -> Awaitable[CommandResult]:
        return _with_bar("nodes", lambda report: scan_nodes(site, numbers, report, listen_only=listen_only))

    _only(given, "nodes", "nodes are CANopen's")
    perform(given, "scan nodes", {"nodes": numbers, "listen_only": listen_only}, work, show)


@click.command(short_help="Which frames are on this CAN bus; nothing is sent.")
@click.option("--seconds", type=click.FloatRange(0.1, 3600), default=5.0, show_default=True, help="How long to listen.")
@link_options
def can(given: SharedOptions, seconds: float) -> None:
    """Which frames are on this CAN bus, how often, and what they may be; nothing is sent."""

    def show(data: Mapping[str, Any]) -> None:
        load = f", {data['load_percent']:.1f} % of the bus at most" if "load_percent" in data else ""
        rows = [["" if cell is None else cell for cell in row.values()] for row in data["ids"]]
        title = f"{data['heard']} frames in {data['seconds']:g} s{load}"
        table(title, list(data["ids"][0]) if rows else ["id"], rows)

    def work(site: Site) -> Awaitable[CommandResult]:
        return _with_bar("listening", lambda report: scan_can(site, seconds))

    _only(given, "can", "frames by identifier are a CAN bus's")
    perform(given, "scan can", {"seconds": seconds}, work, show)


@click.command(short_help="Which registers can be read, and how many at once.")
@click.argument("stretch", default="holding:0-999")
@click.option("--requests", type=click.IntRange(1), default=3000, show_default=True, help="The most requests to send.")
@link_options
def registers(given: SharedOptions, stretch: str, requests: int) -> None:
    """Which registers of STRETCH (holding:0-999, or 40001-41000) can be read, and how many at once.

    Blocks are asked first; refused ones are cut in halves. It reads only, and every answer counts: what the bound on
    requests leaves unasked is said.
    """
    with sentences():
        first, count = parse_stretch(stretch)

    def show(data: Mapping[str, Any]) -> None:
        keys = ("first", "last", "reference", "count")
        states = ("readable", "refused", "unknown")
        rows = [(state, *(row[key] for key in keys)) for state in states for row in data[state]]
        rows.sort(key=lambda row: int(row[1].partition(":")[2]))
        table(f"{data['requests']} requests", ("state", "from", "to", "reference", "count"), rows)
        longer = f"; {data['too_long']} are refused" if data["too_long"] else " (no longer range to try, or no limit)"
        click.echo(f"largest block: {data['largest_block']}{longer}")
        if data["seams"]:
            click.echo(f"not read across: {', '.join(data['seams'])}")
        if data["refusals"]:
            click.echo("refusals: " + ", ".join(f"{count} {reason}" for reason, count in data["refusals"].items()))

    def work(site: Site) -> Awaitable[CommandResult]:
        return _with_bar("registers", lambda report: scan_registers(site, first, count, requests, report))

    _only(given, "registers", "registers are Modbus's")
    perform(given, "scan registers", {"stretch": stretch, "requests": requests}, work, show)


def _only(given: SharedOptions, command: str, sentence: str) -> None:
    """Refuse a link that does not have the notion, with what its device has; what is not found `perform` says."""
    with sentences():
        target = make_target(given.plant, given.device, given.link, given.settings)
        own = target.capabilities
        offers = {"units": own.units, "nodes": own.nodes, "can": own.bus, "registers": own.registers}
        if not offers[command]:
            others = [f"decanter plc scan {other}" for other, offered in offers.items() if offered]
            remedy = f"here try {' or '.join(others)}" if others else f"what there is stands in {own.described_in}"
            raise ValueError(f"link {target.kind!r}: {sentence}; {remedy}")
