"""`decanter plc check hmi`: what the HMI shows against what the PLC says, now or at the time of the reading."""

import asyncio
import time
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from drivers.device_file import STATUS_TAGS
from drivers.tag import Tag, Value
from gateway.commission.files import ListError, SiteRecording, read_recording
from gateway.commission.hmi import HmiReading, Point, compare, missing_proof, parse_points, read_hmi_list
from gateway.commission.options import SharedOptions
from gateway.commission.read import read_raw, shown_value
from gateway.commission.session import Site, perform, read_records, require_device
from gateway.console import CommandResult, Part, Rows
from gateway.machine import ORDERS

LOOK_S = 0.3
_HOUR = 3600.0
Ask = Callable[[str], str]
"""Puts a question to the person and gives the answer, "" for none."""
Tell = Callable[[str], None]


def tags_to_prove(site: Site, only: Sequence[str]) -> list[Tag]:
    """The tags that an HMI shows: all but those of the write-back contract, which the loop tests prove.

    Raises ValueError for a name that is no tag.
    """
    device = require_device(site)
    if unknown := [name for name in only if name not in device.by_name]:
        raise ValueError(f"--only {unknown[0]}: is no tag of {device.path}; give one of {', '.join(device.by_name)}")
    contract = {device.heartbeat, *STATUS_TAGS, *ORDERS}
    for layout in device.writebacks:
        contract |= {layout.acknowledge_bits, *(layout.tag(name) for name in STATUS_TAGS)}
    return [tag for tag in device.tags if (tag.name in only if only else tag.name not in contract)]


def earlier_points(path: Path) -> list[Point]:
    """The comparisons of all earlier verifications. Raises RecordsError."""
    if not path.exists():
        return []
    return [
        point for record in read_records(path) if record.command == "verify" for point in parse_points(record.result)
    ]


async def compare_with_list(
    site: Site,
    path: Path,
    tags: Sequence[Tag],
    before: Sequence[Point],
    *,
    readings: Path | None,
    within: float,
    clock_offset: float,
    slack: float,
    complete: bool,
) -> CommandResult:
    """Compare a list of HMI readings: those without a time with the PLC now, those with one with what was recorded.

    `clock_offset` is by how much the HMI's clock is ahead (s). Raises ListError, HistorianError or DriverError.
    """
    now = time.time()
    known = {tag.name: tag for tag in require_device(site).tags}
    wanted = {tag.name for tag in tags}
    shown = [reading for reading in read_hmi_list(path, tuple(known.values()), now) if reading.tag in wanted]
    if not shown:
        raise ListError(f"{path}: has no reading of a tag that is to be verified; give rows of tag and value")
    present = dict.fromkeys(reading.tag for reading in shown if reading.time is None)
    live, missing = await _look_twice(site, [known[name] for name in present]) if present else ({}, {})
    times = [reading.time for reading in shown if reading.time is not None]
    config, past = site.target.config, SiteRecording(path, (), {})
    if times and readings is not None:
        past = read_recording(readings, machine=site.target.subject or None)
    elif times and config is not None and config.historian.path.is_file():
        # An hour more on both sides: the HMI's clock may be off, and what held then may have been recorded well before.
        whose = config.subject or None
        past = read_recording(config.historian.path, min(times) - _HOUR, max(times) + _HOUR, machine=whose)
    elif times:
        raise ListError(
            f"{shown[0].where}: the readings have times, and nothing was recorded to compare them with; give "
            "--readings FILE (see decanter plc check soak --record), or take the times out to compare with the PLC now"
        )
    points = []
    for reading in shown:
        if reading.time is None:
            values = live.get(reading.tag, [])
        else:
            # What was recorded within so many seconds of the moment; where all of that came later, also what held then.
            moment, column = reading.time - clock_offset, past.columns.get(reading.tag)
            first, last = bisect_left(past.times, moment - within), bisect_right(past.times, moment + within)
            held = max(0, bisect_right(past.times, moment) - 1)
            near = range(min(first, held), last) if first < last else range(0)
            # NaN, a gap in the recording, does not equal itself.
            values = [column[at] for at in near if column[at] == column[at]] if column is not None else []
        why = missing.get(reading.tag, "") if reading.time is None else ""
        points.append(compare(known[reading.tag], reading, values, now, slack, missing=why))
    return conclude_points(tags, points, before, complete=complete)


async def _look_twice(site: Site, tags: Sequence[Tag]) -> tuple[dict[str, list[Value]], dict[str, str]]:
    """Two good looks at each tag, a moment apart: a value that moves passes through what the HMI showed.

    With them the reason of the last look that was not good, by tag.
    """
    values: dict[str, list[Value]] = {tag.name: [] for tag in tags}
    reasons: dict[str, str] = {}
    for look in range(2):
        if look:
            await asyncio.sleep(LOOK_S)
        for raw in await read_raw(site, tags):
            if raw.sample.quality.is_good and raw.sample.value is not None:
                values[raw.tag.name].append(raw.sample.value)
            else:
                reasons[raw.tag.name] = raw.sample.reason
    return values, reasons


# ---------------------------------------------------------------- by questions


async def ask_for_each(
    site: Site, tags: Sequence[Tag], before: Sequence[Point], ask: Ask, tell: Tell, *, slack: float, complete: bool
) -> CommandResult:
    """Ask for each tag what the HMI shows, round by round, until all are proved or the person ends it (q).

    The PLC's value is not shown before the answer: who knows it, reads it.
    """
    points: list[Point] = []
    while left := [tag for tag in tags if missing_proof(tag, [*before, *points])]:
        for tag in left:
            missing = missing_proof(tag, [*before, *points])
            unit = f" in {tag.unit}" if tag.unit else ""
            answer = (await asyncio.to_thread(ask, f"{tag.name}{unit} ({missing}): what does the HMI show?")).strip()
            if answer.lower() == "q":
                return conclude_points(tags, points, before, complete=complete)
            if not answer:
                continue
            values, reasons = await _look_twice(site, [tag])
            try:
                reading, why = HmiReading(tag.name, answer), reasons.get(tag.name, "")
                point = compare(tag, reading, values[tag.name], time.time(), slack, missing=why)
            except ListError as error:
                tell(f"  {error}")
                continue
            points.append(point)
            tell(f"  agrees with {point.read}" if point.ok else f"  DOES NOT AGREE: {point.reason}")
        rest = any(missing_proof(tag, [*before, *points]) for tag in left)
        question = "bring the plant into another state, then press Enter (q ends)"
        if rest and (await asyncio.to_thread(ask, question)).strip().lower() == "q":
            break
    return conclude_points(tags, points, before, complete=complete)


def conclude_points(
    tags: Sequence[Tag], points: Sequence[Point], before: Sequence[Point], *, complete: bool
) -> CommandResult:
    """The comparisons, and what is still to be done for each tag; a failed check where one does not agree.

    With `complete` it is one too where something is to be done.
    """
    everything = [*before, *points]
    left = {tag.name: todo for tag in tags if (todo := missing_proof(tag, everything))}
    wrong = [point for point in points if not point.ok]
    data: dict[str, Any] = {
        "points": [asdict(point) for point in points],
        "tags": len(tags),
        "proved": len(tags) - len(left),
        "left": left,
        "open_points": [f"verify: {name}: {todo}" for name, todo in left.items()],
    }
    complaint = ""
    if wrong:
        first = f"{wrong[0].tag}: the HMI shows {wrong[0].shown}, {wrong[0].reason}"
        complaint = f"{len(wrong)} of {len(points)} readings do not agree, the first: {first}"
    elif complete and left:
        name, todo = next(iter(left.items()))
        complaint = f"{len(left)} of {len(tags)} tags are not proved, the first: {name}: {todo}"
    return CommandResult(data, complaint)


def verify(
    given: SharedOptions,
    listed: Path | None,
    only: tuple[str, ...],
    readings: Path | None,
    within: float,
    clock_offset: float,
    slack: float,
    complete: bool,
    anew: bool,
) -> None:
    """Carry out `decanter plc check hmi`; its options and its help are in commission/commands.py."""

    def tell(sentence: str) -> None:
        click.echo(sentence, err=True)

    async def work(site: Site) -> CommandResult:
        tags, before = tags_to_prove(site, only), [] if anew else earlier_points(given.records)
        if listed is None:
            return await ask_for_each(site, tags, before, _ask, tell, slack=slack, complete=complete)
        past: dict[str, Any] = {"readings": readings, "within": within, "clock_offset": clock_offset}
        return await compare_with_list(site, listed, tags, before, slack=slack, complete=complete, **past)

    arguments = {
        "against": listed and str(listed),
        "only": list(only),
        "tolerance": slack,
        "clock_offset": clock_offset,
    }
    perform(given, "verify", arguments, work, _view)


def _ask(question: str) -> str:
    """One line from the person; the end of the input is `q`."""
    try:
        return str(click.prompt(question, default="", show_default=False, err=True))
    except click.Abort:
        return "q"


def _view(data: Mapping[str, Any]) -> Iterator[Part]:
    rows = [
        (
            "agrees" if point["ok"] else "NOT",
            point["tag"],
            point["shown"],
            str(shown_value(point["read"])),
            point["reason"],
        )
        for point in data["points"]
    ]
    if rows:
        agree = sum(point["ok"] for point in data["points"])
        yield Rows(f"{agree} of {len(rows)} agree", ("", "tag", "HMI", "PLC", "why"), rows)
    yield f"{data['proved']} of {data['tags']} tags are proved"
    yield from (f"  {name}: {todo}" for name, todo in data["left"].items())
