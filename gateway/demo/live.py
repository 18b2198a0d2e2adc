"""The live table of a running gateway, made from its status file and the PLC's own account."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.box import SIMPLE
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

ZONE_COLOURS = {"green": "green", "yellow": "yellow", "red": "red"}
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


def live_table(status: Mapping[str, Any], plc: Mapping[str, Any], temperature: str, phase: str) -> RenderableType:
    """Measured, predicted with band, location, events, alarms, and what the PLC has received."""
    grid = Table(box=SIMPLE, show_header=False, pad_edge=False)
    grid.add_column(style="bold")
    grid.add_column(min_width=62)
    for name, text in _rows(status, plc, temperature):
        grid.add_row(name, text)
    return Group(Text(f"decanter demo: {phase}", style="bold"), grid)


def _rows(status: Mapping[str, Any], plc: Mapping[str, Any], temperature: str) -> list[tuple[str, RenderableType]]:
    p, value = status.get("prediction") or {}, status["values"].get(temperature, {})
    band = f"{_number(p.get('low'))} to {_number(p.get('high'))}"
    recent = ", ".join(f"{symbol}" for _, symbol, _ in status["recent_events"][-6:])
    raised = [name for name, state in status["alarms"].items() if state in ALARM_STATES]
    zone = str(p.get("zone", "none"))
    place = f"{_number(plc.get('position'), 0)} of {_number(plc.get('duration'), 0)} s"
    return [
        ("replay", f"{place}, {_number(plc.get('speed'), 0)} times real time"),
        ("link", _link(status)),
        (f"measured {temperature}", f"{_number(value.get('value'))} °C  {value.get('quality', '')}"),
        ("predicted now", f"{_number(p.get('mean'))} °C, 90 % band {band}; free run {_number(p.get('free_run'))}"),
        ("location", f"{p.get('location', '–')}  confidence {zone}"),
        ("forecast", _forecast(status)),
        ("events", f"{status['events']}: ... {recent}"),
        ("alarms", Text(", ".join(raised), style="bold red") if raised else "none"),
        ("PLC received", _received(plc)),
    ]


def _link(status: Mapping[str, Any]) -> Text:
    link = status["link"]
    words = f"{status['scan']['count']} scans, {status['scan']['missed']} missed, {link['outage_count']} outages"
    return (
        Text(f"good, {words}", style="green") if link["alive"] else Text(f"NO GOOD READING, {words}", style="bold red")
    )


def _forecast(status: Mapping[str, Any]) -> str:
    made = status.get("forecast")
    if not made:
        return "–"
    fans = zip(made["horizons"], made["quantiles"], strict=True)
    return "; ".join(f"{h / 60:.0f} min {q[2]:.1f} ({q[0]:.1f} to {q[4]:.1f})" for h, q in fans) + (
        f"; P(limit) {max(made['p_limit']):.3f}"
    )


def _received(plc: Mapping[str, Any]) -> str:
    block = plc.get("block") or {}
    usable = "usable" if plc.get("usable") else "NOT usable: the PLC falls back to its own logic"
    return (
        f"{plc.get('accepted', 0)} blocks accepted, {plc.get('refused', 0)} refused; now "
        f"{_number(block.get('temperature_now'))} °C, sequence {_number(block.get('sequence'), 0)}, {usable}"
    )
