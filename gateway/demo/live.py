"""The live table of a running gateway, made from its status file and the PLC's own account."""

import json
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Any

from rich.box import SIMPLE
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

ZONE_COLOURS = {"green": "green", "yellow": "yellow", "red": "red"}


class DemoPhase(Enum):
    """Where a demonstration is; the value is what people read."""

    RUNNING = "running"
    OUTAGE = "OUTAGE: the PLC refuses its connections"
    RECOVERING = "recovering"
    ENDED = "end of the trace"


ALARM_STATES = ("unacknowledged", "acknowledged")


def read_status(path: Path) -> dict[str, Any] | None:
    """The newest status; None while there is none."""
    try:
        status: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, json.JSONDecodeError):
        return None
    return status


def _number(value: object, digits: int = 2, unit: str = "") -> str:
    return f"{value:.{digits}f}{unit}" if isinstance(value, int | float) else "–"


def live_table(status: Mapping[str, Any], plc: Mapping[str, Any], temperature: str, phase: DemoPhase) -> RenderableType:
    """Measured, predicted with band, location, events, alarms, and what the PLC has received; 80 columns suffice."""
    p, value = status.get("prediction") or {}, status["values"].get(temperature, {})
    quality, link = str(value.get("quality", "")), status["link"]
    recent = ", ".join(str(symbol) for _, symbol, _ in status["recent_events"][-6:])
    raised = [name for name, state in status["alarms"].items() if state in ALARM_STATES]
    zone = str(p.get("zone", "none"))
    place = f"{_number(plc.get('position'), 0)} of {_number(plc.get('duration'), 0)} s"
    scans = f"{status['scan']['count']} scans, {status['scan']['missed']} missed, {link['outage_count']} outages"
    alive = Text(f"good, {scans}", style="green")
    if not link["alive"]:
        alive = Text(f"NO GOOD READING, {scans}", style="bold red")
    now = f"{_number(p.get('mean'))} °C, 90 % band {_number(p.get('low'))} to {_number(p.get('high'))}"
    rows: list[tuple[str, Text | str]] = [
        ("replay", f"{place}, {_number(plc.get('speed'), 0)} times real time"),
        ("link", alive),
        ("measured", Text(f"{_number(value.get('value'))} °C  {quality}", style="" if quality == "GOOD" else "red")),
        ("predicted", f"{now}; free run {_number(p.get('free_run'))}"),
        ("location", Text(f"{p.get('location', '–')}, confidence {zone}", style=ZONE_COLOURS.get(zone, ""))),
    ]
    # One row a horizon, so that the table keeps its height.
    fans = status.get("forecast")
    if not fans:
        rows.append(("forecast", "–"))
    else:
        for horizon, fan, p_limit in zip(fans["horizons"], fans["quantiles"], fans["p_limit"], strict=True):
            span = f"{fan[2]:.1f} °C ({fan[0]:.1f} to {fan[4]:.1f})"
            rows.append((f"in {horizon / 60:g} min", f"{span}, P(limit) {p_limit:.3f}"))
    # What an operator sees on the PLC's side.
    block = plc.get("block") or {}
    held = f"{_number(block.get('temperature_now'))} °C, block {_number(block.get('sequence'), 0)}, usable"
    refusal = Text("prediction not usable, own logic in force", style="red")
    rows += [
        ("events", f"{status['events']}: ... {recent}"),
        ("alarms", Text(", ".join(raised), style="bold red") if raised else "none"),
        ("PLC's account", f"{plc.get('accepted', 0)} blocks accepted, {plc.get('refused', 0)} refused"),
        ("PLC shows", Text(held) if plc.get("usable") else refusal),
    ]
    grid = Table(box=SIMPLE, show_header=False, pad_edge=False)
    grid.add_column(style="bold", no_wrap=True)
    grid.add_column(overflow="fold")
    for name, text in rows:
        grid.add_row(name, text if isinstance(text, Text) else Text(text))  # no markup: names come from files
    style = "bold red" if phase is DemoPhase.OUTAGE else "bold"
    return Group(Text(f"decanter demo, {temperature}: {phase.value}", style=style), grid)
