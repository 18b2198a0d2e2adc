"""`decanter plc codegen`: the PLC's side of the write-back contract as Structured Text."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import click

from drivers.named_files import name_write_errors
from gateway.commission.writeback.structured_text import Program, generate
from gateway.commission.writeback.targets import TARGETS
from gateway.commission.writeback.vectors import plain
from gateway.console import CommandResult, conclude, config_dir, json_option
from gateway.entry import sentences
from gateway.settings import load_device


@click.command(short_help="Generate the PLC's side of the write-back as Structured Text.")
@click.option(
    "--device",
    type=click.Path(path_type=Path),
    default=lambda: config_dir() / "devices" / "decanter_plc.toml",
    show_default="config/devices/decanter_plc.toml",
    help="The device file (register map) with the [writeback] table.",
)
@click.option(
    "--target",
    type=click.Choice(list(TARGETS)),
    default="plain",
    show_default=True,
    help="The tool that the text goes into: its names, its places of registers, its spelling.",
)
@click.option("--out", type=click.Path(path_type=Path), help="File of the Structured Text.  [default: the screen]")
@click.option("--name", default="", help="Name of the function block.  [default: made from the device's name]")
@click.option("--program/--no-program", default=True, show_default=True, help="Also an example program that calls it.")
@click.option(
    "--location", default="", help="Where registers lie in the PLC: %MW, %QW or %IW.  [default: the target's]"
)
@click.option("--permit-at", default="", metavar="LOCATION", help="The bit of the permit's switch, such as %IX0.0.")
@click.option("--cycle", type=click.IntRange(1, 10_000), default=20, show_default=True, help="The task's cycle in ms.")
@click.option("--suite", type=click.Path(path_type=Path), help="Also write the conformance suite here (JSON).")
@json_option
def codegen(
    device: Path,
    target: str,
    out: Path | None,
    name: str,
    program: bool,
    location: str,
    permit_at: str,
    cycle: int,
    suite: Path | None,
    as_json: bool,
) -> None:
    """Generate the function block that checks the gateway's blocks: plain IEC 61131-3, 2nd edition, from the map.

    It checks layout version, sequence copy, CRC, session and heartbeat, keeps a timer, and falls back to the PLC's own
    logic. What to paste where in OpenPLC, CODESYS and TIA Portal is in docs/plc_side.md.
    """
    with sentences():
        device_map = load_device(device)
        tool = TARGETS[target]
        if out is not None and tool.ending and out.suffix.lower() != tool.ending:
            raise ValueError(f"{out}: {tool.tool} imports files that end in {tool.ending}; give the file that ending")
        text = generate(device_map, name, Program(location, permit_at, cycle) if program else None, tool)
        if out is not None:
            out.parent.mkdir(parents=True, exist_ok=True)
            with name_write_errors(out):
                out.write_text(text, encoding="ascii")
        if suite is not None:
            write_suite(device, suite)
    files = {"text": str(out) if out else None, "suite": str(suite) if suite else None}
    data = {
        "device": str(device),
        "target": target,
        **files,
        "lines": text.count("\n"),
        **({} if out else {"source": text}),
    }
    conclude(CommandResult(data), _view, as_json=as_json)


def write_suite(device: Path, out: Path) -> None:
    """Write the conformance suite of a device file as JSON. Raises ConfigError, ValueError or OSError."""
    device_map = load_device(device)
    if device_map.writeback is None:
        raise ValueError(f"{device}: has no [writeback] table; there is no block to check")
    content = plain(device_map.writebacks, device_map.refusals)
    lists = {key: ",\n  ".join(json.dumps(step) for step in content.pop(key)) for key in ("steps", "together")}
    head = json.dumps(content, indent=1)[:-2]
    out.parent.mkdir(parents=True, exist_ok=True)
    tail = ",\n".join(f' "{key}": [\n  {steps}\n ]' for key, steps in lists.items())
    with name_write_errors(out):
        out.write_text(f"{head},\n{tail}\n}}\n", encoding="utf-8")


def _view(data: Mapping[str, Any]) -> Iterator[str]:
    yield (
        data["source"].removesuffix("\n")
        if data["text"] is None
        else f"{data['text']}: {data['lines']} lines of Structured Text"
    )
    if data["suite"] is not None:
        yield f"{data['suite']}: the conformance suite"
