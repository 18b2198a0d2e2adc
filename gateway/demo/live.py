"""The live table of the demonstration: the gateway's panel from its status file, and the PLC's own account beneath."""

import json
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from gateway.panel import framed, number, status_rows
from gateway.status import read_status as status_of


class DemoPhase(Enum):
    """Where a demonstration is; the value is what people read."""

    RUNNING = "running"
    OUTAGE = "OUTAGE: the PLC refuses its connections"
    RECOVERING = "recovering"
    ENDED = "end of the trace"


def read_status(path: Path) -> dict[str, Any] | None:
    """The newest status; None while there is none."""
    try:
        status: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, json.JSONDecodeError):
        return None
    return status


def live_table(status: Mapping[str, Any], plc: Mapping[str, Any], temperature: str, phase: DemoPhase) -> RenderableType:
    """Measured, predicted with band, location, events, alarms, and what the PLC has received; 80 columns suffice."""
    place = f"{number(plc.get('position'), 0)} of {number(plc.get('duration'), 0)} s"
    # What an operator sees on the PLC's side.
    block = plc.get("block") or {}
    held = f"{number(block.get('temperature_now'))} °C, block {number(block.get('sequence'), 0)}, usable"
    rows = {
        "replay": Text(f"{place}, {number(plc.get('speed'), 0)} times real time"),
        **status_rows(status_of(status)),
        "PLC's account": Text(f"{plc.get('accepted', 0)} blocks accepted, {plc.get('refused', 0)} refused"),
        "PLC shows": Text(held)
        if plc.get("usable")
        else Text("prediction not usable, own logic in force", style="red"),
    }
    style = "bold red" if phase is DemoPhase.OUTAGE else "bold"
    return framed(Text(f"decanter demo, {temperature}: {phase.value}", style=style), rows)
