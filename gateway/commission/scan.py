"""`decanter plc scan`: who is there, and what can be read."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import click

from drivers.capabilities import Capabilities
from gateway.commission.options import SharedOptions
from gateway.commission.session import Site, find_target, perform
from gateway.commission.survey import (
    BASES,
    parse_stretch,
    scan_can,
    scan_models,
    scan_nodes,
    scan_registers,
    scan_units,
)
from gateway.console import CommandResult, Part, Rows, View, progress
from gateway.entry import sentences


def numbers(text: str, low: int, high: int) -> list[int]:
    """`1-32`, `1,2,17` or both as numbers from `low` to `high`, each once. Raises click.BadParameter."""
    found: list[int] = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        try:
            span = range(int(first), int(last if dash else first) + 1)
        except ValueError:
            span = range(0)  # refused below, as an empty or a reversed span is
        if not span or span[0] < low or span[-1] > high:
            raise click.BadParameter(f"{part!r}: give numbers from {low} to {high}, such as 1-32 or 1,2,17")
        found += [number for number in span if number not in found]
    return found


@dataclass(frozen=True, slots=True)
class ScanKind:
    """What can be looked for: `offered` by a device's capabilities or refused with `sentence`, `options` its own."""

    offered: Callable[[Capabilities], bool]
    sentence: str
    view: View
    options: tuple[str, ...] = ()


def _units(data: Mapping[str, Any]) -> Iterator[Part]:
    title = f"{len(data['units'])} of {data['asked']} units answer"
    yield Rows(title, ("unit", "ms", "answer", "identity"), data["units"])


def _nodes(data: Mapping[str, Any]) -> Iterator[Part]:
    keys = list(dict.fromkeys(key for row in data["nodes"] for key in row))
    yield Rows(f"{len(data['nodes'])} of {data['asked']} nodes", keys, data["nodes"])


def _frames(data: Mapping[str, Any]) -> Iterator[Part]:
    load = f", {data['load_percent']:.1f} % of the bus at most" if "load_percent" in data else ""
    title = f"{data['heard']} frames in {data['seconds']:g} s{load}"
    yield Rows(title, list(data["ids"][0]) if data["ids"] else ["id"], data["ids"])


def _registers(data: Mapping[str, Any]) -> Iterator[Part]:
    states = ("readable", "refused", "unknown")
    rows = [
        (state, row["first"], row["last"], row["reference"], row["count"]) for state in states for row in data[state]
    ]
    rows.sort(key=lambda row: int(row[1].partition(":")[2]))
    yield Rows(f"{data['requests']} requests", ("state", "from", "to", "reference", "count"), rows)
    longer = f"; {data['too_long']} are refused" if data["too_long"] else " (no longer range to try, or no limit)"
    yield f"largest block: {data['largest_block']}{longer}"
    if data["seams"]:
        yield f"not read across: {', '.join(data['seams'])}"
    if data["refusals"]:
        yield "refusals: " + ", ".join(f"{count} {reason}" for reason, count in data["refusals"].items())


def _models(data: Mapping[str, Any]) -> Iterator[Part]:
    if data["base"] is not None:
        keys = ("model", "first", "reference", "registers", "import")
        yield Rows(f"{len(data['models'])} models behind {data['base']}", keys, data["models"])


KINDS: dict[str, ScanKind] = {
    "units": ScanKind(lambda own: own.units, "units are Modbus's", _units),
    "nodes": ScanKind(lambda own: own.nodes, "nodes are CANopen's", _nodes, ("listen_only",)),
    "frames": ScanKind(lambda own: own.bus, "frames by identifier are a CAN bus's", _frames, ("seconds",)),
    "registers": ScanKind(lambda own: own.registers, "registers are Modbus's", _registers, ("requests",)),
    "models": ScanKind(lambda own: own.registers, "models are SunSpec's, over Modbus", _models),
}


def scan(given: SharedOptions, what: str, stretch: str | None, **options: Any) -> None:
    """The work of `plc scan`."""
    kind = KINDS[what]
    options = {name: value for name, value in options.items() if value is not None}
    if foreign := [name for name in options if name not in kind.options]:
        owner = next(other for other, each in KINDS.items() if foreign[0] in each.options)
        raise click.UsageError(f"--{foreign[0].replace('_', '-')} is for {owner}, not for {what}")
    if what == "frames" and stretch is not None:
        raise click.UsageError(f"{stretch!r}: frames have no RANGE; every one that is heard is listed")
    with sentences():
        arguments: dict[str, Any]
        if what == "units":
            arguments = {"units": numbers(stretch, 0, 255) if stretch else None}
        elif what == "nodes":
            arguments = {"nodes": numbers(stretch or "1-127", 1, 127), "listen_only": bool(options.get("listen_only"))}
        elif what == "frames":
            arguments = {"seconds": options.get("seconds", 5.0)}
        elif what == "models":
            bases = (parse_stretch(stretch)[0].number,) if stretch else BASES
            arguments = {"bases": list(bases)}
        else:
            arguments = {"stretch": stretch or "holding:0-999", "requests": options.get("requests", 3000)}
            first, count = parse_stretch(arguments["stretch"])
        target = find_target(given)
        own = target.capabilities
        if not kind.offered(own):
            others = [f"decanter plc scan {other}" for other, each in KINDS.items() if each.offered(own)]
            remedy = f"here try {' or '.join(others)}" if others else f"what there is stands in {own.described_in}"
            raise ValueError(f"link {target.kind!r}: {kind.sentence}; {remedy}")

    async def work(site: Site) -> CommandResult:
        with progress(what) as report:  # the bar is gone before anything is printed
            if what == "units":
                return await scan_units(site, arguments["units"], report)
            if what == "nodes":
                return await scan_nodes(site, arguments["nodes"], report, listen_only=arguments["listen_only"])
            if what == "frames":
                return await scan_can(site, arguments["seconds"])
            if what == "models":
                return await scan_models(site, bases)
            return await scan_registers(site, first, count, arguments["requests"], report)

    perform(given, f"scan {what}", arguments, work, kind.view, target=target)
