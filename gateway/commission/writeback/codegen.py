"""`decanter plc codegen`: the PLC's side of the write-back contract as Structured Text."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from drivers.named_files import name_write_errors
from gateway.commission.writeback.structured_text import Program, generate
from gateway.commission.writeback.targets import TARGETS
from gateway.commission.writeback.vectors import plain
from gateway.console import CommandResult, conclude
from gateway.entry import sentences
from gateway.settings import load_device


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
    """The work of `plc codegen`."""
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
