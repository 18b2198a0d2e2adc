"""The live panel: rows of a running gateway from its status, rows of the software PLC from its account."""

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
    LOST = "NO GOOD READING"
    ENDED = "end of the trace"


def phase_of(status: Mapping[str, Any], plc: Mapping[str, Any], before: DemoPhase) -> DemoPhase:
    """Where it is by what the gateway itself says: an outage begins when it is noticed, and not before.

    So a title never says something else than the rows under it. The PLC's faults and the phase `before` only tell an
    outage that was ordered from a loss that nobody ordered.
    """
    if plc["ended"]:
        return DemoPhase.ENDED
    if status["link"]["alive"]:
        return DemoPhase.RUNNING
    if any(fault["in_force"] for fault in plc["faults"]):
        return DemoPhase.OUTAGE
    return DemoPhase.RECOVERING if before in (DemoPhase.OUTAGE, DemoPhase.RECOVERING) else DemoPhase.LOST


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


Rows = list[tuple[str, Text]]


def gateway_rows(status: Mapping[str, Any], temperature: str) -> Rows:
    """What a running gateway says of itself, from its status alone: link, measured, predicted, forecast, alarms."""
    p, value = status.get("prediction") or {}, status["values"].get(temperature, {})
    quality, link = str(value.get("quality", "")), status["link"]
    recent = ", ".join(str(symbol) for _, symbol, _ in status["recent_events"][-6:])
    raised = [name for name, state in status["alarms"].items() if state in ALARM_STATES]
    zone = str(p.get("zone", "none"))
    scans = f"{status['scan']['count']} scans, {status['scan']['missed']} missed, {link['outage_count']} outages"
    alive = Text(f"good, {scans}", style="green")
    if not link["alive"]:
        why = f": {link['reason']}" if link.get("reason") else ""
        alive = Text(f"NO GOOD READING{why}; {scans}", style="bold red")
    now = f"{_number(p.get('mean'))} °C, 90 % band {_number(p.get('low'))} to {_number(p.get('high'))}"
    rows = [
        ("link", alive),
        ("measured", Text(f"{_number(value.get('value'))} °C  {quality}", style="" if quality == "GOOD" else "red")),
        ("predicted", Text(f"{now}; free run {_number(p.get('free_run'))}")),
        ("location", Text(f"{p.get('location', '–')}, confidence {zone}", style=ZONE_COLOURS.get(zone, ""))),
    ]
    # One row a horizon, so that the table keeps its height.
    fans = status.get("forecast")
    if not fans:
        rows.append(("forecast", Text("–")))
    else:
        for horizon, fan, p_limit in zip(fans["horizons"], fans["quantiles"], fans["p_limit"], strict=True):
            span = f"{fan[2]:.1f} °C ({fan[0]:.1f} to {fan[4]:.1f})"
            rows.append((f"in {horizon / 60:g} min", Text(f"{span}, P(limit) {p_limit:.3f}")))
    rows += [
        ("events", Text(f"{status['events']}: ... {recent}")),
        ("alarms", Text(", ".join(raised), style="bold red") if raised else Text("none")),
    ]
    return rows


def plc_rows(plc: Mapping[str, Any]) -> Rows:
    """What an operator sees on the software PLC's side: its account, whether it uses the prediction and why not."""
    block = plc.get("block") or {}
    held = f"{_number(block.get('temperature_now'))} °C, block {_number(block.get('sequence'), 0)}, usable"
    refusal = Text(f"not usable, own logic in force: {plc.get('unusable') or 'no block yet'}", style="red")
    rows = [
        ("PLC's account", Text(f"{plc.get('accepted', 0)} blocks accepted, {plc.get('refused', 0)} refused")),
        ("PLC shows", Text(held) if plc.get("usable") else refusal),
    ]
    if plant := plc.get("plant"):
        feed = f"{100 * plant['feed']:.0f} % of the feed"
        if plant["tripped"]:
            rows.append(("PLC acts", Text("the drum has TRIPPED", style="bold red")))
        else:
            reduced = plant["feed"] < 1
            words = f"{feed}: the limit is predicted" if reduced else feed
            rows.append(("PLC acts", Text(words, style="bold yellow" if reduced else "")))
    return rows


def panel(title: str, rows: Rows, style: str = "bold") -> RenderableType:
    """A title over rows of (name, text); 80 columns suffice."""
    grid = Table(box=SIMPLE, show_header=False, pad_edge=False)
    grid.add_column(style="bold", no_wrap=True)
    grid.add_column(overflow="fold")
    for name, text in rows:
        grid.add_row(name, text)  # Text is no markup: names come from files
    return Group(Text(title, style=style), grid)


def demo_table(status: Mapping[str, Any], plc: Mapping[str, Any], temperature: str, phase: DemoPhase) -> RenderableType:
    """The panel of a demonstration: where the replay is, the gateway's rows, the PLC's."""
    place = f"{_number(plc.get('position'), 0)} of {_number(plc.get('duration'), 0)} s"
    replay = Text(f"{place}, {_number(plc.get('speed'), 0)} times real time")
    rows = [("replay", replay), *gateway_rows(status, temperature), *plc_rows(plc)]
    style = "bold red" if phase in (DemoPhase.OUTAGE, DemoPhase.LOST) else "bold"
    return panel(f"decanter demo, {temperature}: {phase.value}", rows, style)
