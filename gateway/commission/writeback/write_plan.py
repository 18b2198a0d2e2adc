"""`decanter plc check plan --write`: what the gateway would write, whether the contract is complete; sends nothing."""

import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from drivers.device_file import STATUS_TAGS
from drivers.driver import Writes
from drivers.errors import DriverError
from drivers.survey import read_plan
from gateway.commission.session import Site, format_moment
from gateway.commission.survey import reference_number
from gateway.commission.writeback.block_writer import require_layouts
from gateway.commission.writeback.fields import ALARM_BITS, ALARM_MEANINGS, ALWAYS_KNOWN, MEANINGS, unknown_word
from gateway.console import CommandResult, Line, Part, Rows
from gateway.machine.writing import find_places, obstacle, uptime
from gateway.settings import MIN_BLOCKS_PER_SECOND, DeviceMap
from gateway.store import find_arming

LEAST_BLOCKS_IN_TIMER = 3.0
"""So many blocks have to fit in the PLC's timer, so that one that is lost does not make it run out."""


async def plan_writing(site: Site, audit_path: Path) -> CommandResult:
    """The closed write map word by word, the rules that writing follows here, and what is missing.

    Raises ValueError for a device file without a block, AuditError.
    """
    device, layouts = require_layouts(site)
    problems = list(writing_problems(site, device))
    config = site.target.config
    places = find_places(audit_path, config)
    row = find_arming(audit_path, time.time(), uptime(), key=places.key, subject=site.target.subject)
    if row is not None and (why := obstacle(places)[0]):
        row, problems = None, [*problems, why]
    words = []
    for layout in layouts:
        for field, tag in zip(layout.fields, layout.words, strict=True):
            unit, meaning = MEANINGS[field.name]
            unknown = None if field.name in ALWAYS_KNOWN else unknown_word(field, layout)
            words.append(
                {
                    "block": layout.temperature or "",
                    "field": field.name,
                    "address": tag.address,
                    "reference": reference_number(tag.address),
                    "type": "int16" if field.signed else "uint16",
                    "scale": field.scale,
                    "unit": unit,
                    "unknown": "" if unknown is None else f"0x{unknown:04X}",
                    "meaning": meaning,
                }
            )
    plan = read_plan(site.target.driver, site.target.settings, device.tags, device.block_words)
    data: dict[str, Any] = {
        "blocks": len(layouts),
        "words": words,
        "alarm_bits": [
            {"bit": bit, "name": name, "meaning": ALARM_MEANINGS[name]} for bit, name in enumerate(ALARM_BITS)
        ],
        "mode": config.writeback.mode if config else None,
        "armed": {"by": row.entry.who, "reason": row.entry.reason, "until": row.entry.detail["until"]} if row else None,
        "layout_version": layouts[0].version,
        "plc_timer_s": layouts[0].timeout,
        "period_s": config.scan.period if config else None,
        "most_per_second": config.blocks_per_second if config else MIN_BLOCKS_PER_SECOND,
        "audit": str(audit_path),
        "written_by": plan.written_by if plan is not None else "",
        "problems": problems,
    }
    complaint = f"{len(problems)} things stand in the way of writing: {problems[0]}" if problems else ""
    return CommandResult(data, complaint)


def writing_problems(site: Site, device: DeviceMap) -> Iterator[str]:
    """What stands in the way of writing the device's blocks, one sentence each."""
    known, config = device.by_name, site.target.config
    if "WritePermit" not in known:
        yield f"{device.path} has no tag WritePermit: without the PLC's permit nothing is ever written"
    if device.heartbeat is None:
        yield f"{device.path} names no heartbeat: a PLC that stands still could not be told from one that runs"
    for layout in device.writebacks:
        for name in map(layout.tag, STATUS_TAGS):
            if name not in known:
                yield f"{device.path} has no tag {name}: what the PLC makes of the blocks could not be seen"
    words = {tag.address for tag in device.block_words}
    for tag in device.tags:
        if tag.address in words:
            yield f"{tag.name} lies at {tag.address}, within the block; move one of them"
        if tag.writable:
            yield f"{tag.name} is marked writable; the gateway writes the block and nothing else"
    timeout = device.writebacks[0].timeout  # one program keeps it for all blocks
    if config is not None and timeout < LEAST_BLOCKS_IN_TIMER * config.scan.period:
        yield (
            f"the PLC's timer of {timeout:g} s is shorter than {LEAST_BLOCKS_IN_TIMER:g} scans of "
            f"{config.scan.period:g} s: one lost block would make it run out"
        )
    try:
        if not isinstance(site.target.make_driver(device.block_words), Writes):
            yield f"driver {device.driver!r} cannot write"
    except DriverError as error:
        yield f"the driver refuses the write map: {error}"


def writing_view(data: Mapping[str, Any]) -> Iterator[Part]:
    """The result of `plan_writing` for a person."""
    columns = ("field", "address", "reference", "type", "scale", "unit", "unknown", "meaning")
    for block in dict.fromkeys(word["block"] for word in data["words"]):
        rows = [{**word, "scale": f"{word['scale']:g}"} for word in data["words"] if word["block"] == block]
        of = f" of {block}" if block else ""
        yield Rows(
            f"the closed write map{of}: {len(rows)} words, layout version {data['layout_version']}", columns, rows
        )
    bits = ", ".join(f"{bit['bit']} {bit['name']}" for bit in data["alarm_bits"])
    yield f"alarm bits: {bits}"
    period = f"a block a scan ({data['period_s']:g} s)" if data["period_s"] else "a block a scan"
    by = data["written_by"] or "one request a block"
    yield f"{by}, sent once; {period}, at most {data['most_per_second']:g} a second"
    yield f"the PLC's timer: {data['plc_timer_s']:g} s; audit log {data['audit']}"
    if armed := data["armed"]:
        yield Line(f"ARMED until {format_moment(armed['until'])} by {armed['by']}: {armed['reason']}", "yellow")
    else:
        yield f"not armed{', mode ' + data['mode'] if data['mode'] else ''}"
    yield from (Line(f"missing: {problem}", "red") for problem in data["problems"])
