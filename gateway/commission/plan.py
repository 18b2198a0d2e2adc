"""`decanter plc check plan`: the requests of a scan and their longest time, or what would be written; sends nothing."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from functools import partial
from math import ceil
from pathlib import Path
from typing import Any

import click

from drivers.driver import Explains, PlanKind
from drivers.survey import read_plan
from gateway.commission.options import SharedOptions
from gateway.commission.session import Site, audit_path, find_period, list_block_words, perform, require_device
from gateway.commission.survey import parse_register, reference_number
from gateway.commission.writeback.write_plan import plan_writing, writing_view
from gateway.console import CommandResult, Line, Part, Rows


async def plan_scan(site: Site, given_period: float | None) -> CommandResult:
    """The plan of a scan. A failed check where a tag cannot be read or the worst case is longer than the period."""
    device, period = require_device(site), find_period(site, given_period)
    scan_plan = read_plan(site.target.driver, site.target.settings, device.tags, list_block_words(site))
    if scan_plan is None:
        # A device that is not read in requests of its own: what its driver says of the plan.
        driver = site.target.make_driver()
        lines = driver.explain(device.tags) if isinstance(driver, Explains) else ()
        problems = [line for line in lines if line.kind is PlanKind.PROBLEM]
        sentences: list[str] = [*lines] or [f"the driver {site.target.driver!r} has no plan to show"]
        if site.target.capabilities.speaks:
            site.notes.append(
                "this device speaks by itself: a scan takes what it has said, and asks only for what is listed so"
            )
        heard = {"sentences": sentences, "tags": len(device.tags), "period_s": period, "problems": problems}
        complaint = f"{len(problems)} tags cannot be read, the first: {problems[0]}" if problems else ""
        return CommandResult(heard, complaint)
    site.notes.extend(scan_plan.cautions)
    total = scan_plan.seconds + scan_plan.write_seconds
    data: dict[str, Any] = {
        "requests": [
            {**asdict(request), "reference": _reference(request.place, request.count)} for request in scan_plan.requests
        ],
        "writes": [
            {**asdict(request), "reference": _reference(request.place, request.count)} for request in scan_plan.writes
        ],
        "registers": sum(request.count for request in scan_plan.requests),
        "in_vain": sum(request.vain for request in scan_plan.requests),
        "tags": len(device.tags),
        "worst_read_s": scan_plan.seconds,
        "worst_write_s": scan_plan.write_seconds,
        "worst_cycle_s": total,
        "period_s": period,
        "problems": [*scan_plan.problems, *scan_plan.overlaps],
    }
    complaint, longer = "", f"longer than the period of {period:g} s: ticks are missed while replies are late"
    if data["problems"]:
        complaint = f"{len(data['problems'])} things stand in the way, the first: {data['problems'][0]}"
    elif total > period and scan_plan.seconds <= period:
        # The block follows the scan and may be late by itself: that alone is no fault of the configuration.
        site.notes.append(f"with the write-back a cycle can take {total:.3g} s, {longer}")
    elif total > period:
        count = len(scan_plan.requests)
        shortest = int(1000 * period / count) // 10 / 100  # down to 10 ms, so that all requests fit
        shorter = f", or timeout to {shortest:g} s if the device is fast enough (see soak)"
        complaint = (
            f"a scan of {count} requests can take {scan_plan.seconds:.3g} s, {longer}; set scan.period to "
            f"{ceil(10 * total) / 10:g} s{shorter if 'timeout' in site.target.settings else ''}"
        )
    return CommandResult(data, complaint)


def _reference(place: str, count: int) -> str:
    first = reference_number(place)
    return f"{first}-{parse_register(place).shift(count - 1).reference}" if first and count > 1 else first


def plan(given: SharedOptions, period: float | None, write: bool, audit: Path | None) -> None:
    """Carry out `decanter plc check plan`; its options and its help are in commission/commands.py."""
    if write and period is not None:
        raise click.UsageError("--period is for the plan of a scan, not for --write")
    if audit is not None and not write:
        raise click.UsageError("--audit is for --write")

    if write:
        place = partial(audit_path, audit, given)
        perform(given, "plan --write", {}, lambda site: plan_writing(site, place(site.target)), writing_view)
    else:
        perform(given, "plan", {"period": period}, lambda site: plan_scan(site, period), _view)


def _view(data: Mapping[str, Any]) -> Iterator[Part]:
    if "sentences" in data:
        yield from data["sentences"]
        yield f"{data['tags']} tags; period {data['period_s']:g} s"
        return
    rows = []
    for request in (*data["requests"], *data["writes"]):
        names = ", ".join(request["tags"]) if request["kind"] == "read" else "the block"
        place = (request["kind"], request["place"], request["reference"])
        rows.append((*place, request["count"], request["vain"] or "", names))
    title = f"{len(data['requests'])} requests for {data['tags']} tags in {data['registers']} addresses"
    yield Rows(title, ("", "from", "reference", "count", "in vain", "tags"), rows)
    writing = f" + {data['worst_write_s']:.3g} s writing" if data["writes"] else ""
    used = 100.0 * data["worst_cycle_s"] / data["period_s"]
    yield (
        f"worst case {data['worst_read_s']:.3g} s reading{writing} = {data['worst_cycle_s']:.3g} s of a period of "
        f"{data['period_s']:g} s ({used:.0f} %)"
    )
    yield from (Line(problem, "red") for problem in data["problems"])
