"""The live panel: rows of a running gateway from its status, rows of the software PLC from its account."""

import json
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from gateway.outside.panel import frame_rows, number, status_rows
from gateway.outside.status import read_status


class DemoPhase(Enum):
    """Where a demonstration is; the value is what people read."""

    RUNNING = "running"
    OUTAGE = "OUTAGE: the PLC refuses its connections"
    RECOVERING = "recovering"
    LOST = "NO GOOD READING"
    ENDED = "end of the trace"


def demo_phase(status: Mapping[str, Any], plc: Mapping[str, Any], before: DemoPhase) -> DemoPhase:
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


def newest_status(path: Path) -> dict[str, Any] | None:
    """The newest status; None while there is none."""
    try:
        status: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, json.JSONDecodeError):
        return None
    return status


def plc_rows(plc: Mapping[str, Any]) -> dict[str, Text]:
    """What an operator sees on the software PLC's side: its account, whether it uses the prediction and why not."""
    rows: dict[str, Text] = {}
    for account in (plc, *plc.get("blocks", ())[1:]):
        block, suffix = account.get("block") or {}, f" {account['suffix']}" if account.get("suffix") else ""
        held = f"{number(block.get('temperature_now'))} °C, block {number(block.get('sequence'), 0)}, usable"
        refusal = Text(f"not usable, own logic in force: {account.get('unusable') or 'no block yet'}", style="red")
        counts = f"{account.get('accepted', 0)} blocks accepted, {account.get('refused', 0)} refused"
        rows[f"PLC's account{suffix}"] = Text(counts)
        rows[f"PLC shows{suffix}"] = Text(held) if account.get("usable") else refusal
    if plant := plc.get("plant"):
        feed = f"{100 * plant['feed']:.0f} % of the feed"
        if plant["tripped"]:
            rows["PLC acts"] = Text("the drum has TRIPPED", style="bold red")
        else:
            reduced = plant["feed"] < 1
            words = f"{feed}: the limit is predicted" if reduced else feed
            rows["PLC acts"] = Text(words, style="bold yellow" if reduced else "")
    return rows


def demo_table(status: Mapping[str, Any], plc: Mapping[str, Any], temperature: str, phase: DemoPhase) -> RenderableType:
    """The panel of a demonstration: where the replay is, the gateway's rows, the PLC's."""
    place = f"{number(plc.get('position'), 0)} of {number(plc.get('duration'), 0)} s"
    replay = Text(f"{place}, {number(plc.get('speed'), 0)} times real time")
    rows = {"replay": replay, **status_rows(read_status(status)), **plc_rows(plc)}
    style = "bold red" if phase in (DemoPhase.OUTAGE, DemoPhase.LOST) else "bold"
    return frame_rows(Text(f"decanter demo, {temperature}: {phase.value}", style=style), rows)
