"""What happened in a shift, from the records alone: what was told and what came of it, what was hottest, who did what.

These functions run in the process that reads the records, and give plain values.
"""

import json
from bisect import bisect_left
from collections import Counter, defaultdict
from collections.abc import Collection, Mapping, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from drivers.tag import Quality
from gateway.machine.alarms import ACTIVE, GATEWAY, HIDDEN, AlarmState, JournalRow, StoredRow, read_journal
from gateway.settings import parse_kind
from gateway.store import (
    ARMED,
    DISARMED,
    EXPIRED,
    AuditError,
    machines,
    read_since,
    reading,
    samples,
    stored_rows,
    to_trace,
)

ON_SHIFT, NOTE = "page: on shift", "page: note"
"""Kinds of the audit log's rows in which people say who is there, and what they have seen."""
WARNINGS = ("predicted over limit", "rising")
"""Kinds of alarms that say that the limit is coming."""
LIMIT = "over limit"
LONGEST_SHIFT_S = 86_400.0
"""Who is on shift is asked anew each day: a name that was set before that is nobody's present."""
DEEDS = (
    ARMED,
    DISARMED,
    EXPIRED,
    "page: promote",
    "page: backup",
    "page: reload",
    "page: shift mailed",
    "page: log-in locked",
)
"""Kinds of rows in which somebody did something, or asked for it, beside those of alarms."""
MOST_LISTED = 200
"""How many notes and deeds are listed, the newest; how many were before them is said."""


def read_shift(
    path: Path, *, audit: str, start: float, end: float, gap: float, temperatures: Mapping[str, Mapping[str, float]]
) -> dict[str, Any]:
    """The report from `start` to `end` (s UTC) of the machines whose `temperatures` have these limits, by their names.

    Nothing was read where no temperature had a good reading, or none was tried for more than `gap` (s). Raises
    HistorianError.
    """
    return {
        "start": start,
        "end": end,
        "machines": {
            name: _of_machine(path, name, limits, start=start, end=end, gap=gap)
            for name, limits in temperatures.items()
        },
        **read_people(Path(audit), start=start, end=end),
    }


def read_people(audit: Path, *, start: float, end: float, machine: str | None = None) -> dict[str, Any]:
    """Who was on shift, the notes on moments from `start` to `end` (s UTC), of one machine or of all, and what people
    did, in their order; how many older ones of them were `left_out`.

    Without an audit log nobody did anything that had to be put on it.
    """
    if not audit.is_file():
        return {"on_shift": None, "notes": [], "deeds": [], "left_out": {"notes": 0, "deeds": 0}}
    try:
        rows = [row.entry for row in read_since(audit, min(start, end - LONGEST_SHIFT_S), _is_of_people)]
    except AuditError as error:
        raise ValueError(str(error)) from None
    names = [
        {"names": row.reason, "by": row.who, "time": row.time}
        for row in rows
        if row.kind == ON_SHIFT and end - LONGEST_SHIFT_S <= row.time <= end
    ]
    notes: list[dict[str, Any]] = [
        {"time": float(at), "machine": row.detail.get("machine"), "by": row.who, "text": row.reason}
        for row in rows
        if row.kind == NOTE and isinstance(at := row.detail.get("at"), int | float) and start <= at <= end
        if machine is None or row.detail.get("machine") == machine
    ]
    deeds = [
        {"time": row.time, "kind": row.kind, "by": row.who, "reason": row.reason, **_about(row.detail)}
        for row in rows
        # Who only asks what a reload would change has had nothing done.
        if row.kind not in (NOTE, ON_SHIFT) and start <= row.time <= end and not row.detail.get("dry_run")
    ]
    return {
        # Nobody's name stands for who has gone: an empty one takes the last ones back.
        "on_shift": names[-1] if names and names[-1]["names"] != NOBODY else None,
        "notes": sorted(notes, key=lambda note: note["time"])[-MOST_LISTED:],
        "deeds": deeds[-MOST_LISTED:],
        "left_out": {"notes": max(len(notes) - MOST_LISTED, 0), "deeds": max(len(deeds) - MOST_LISTED, 0)},
    }


NOBODY = "-"
"""In place of names: who was on shift has gone."""


def _is_of_people(kind: str) -> bool:
    return kind in (ON_SHIFT, NOTE, *DEEDS) or kind.startswith("alarm ")


def _about(detail: Mapping[str, Any]) -> dict[str, Any]:
    """Of what a deed was: the machine, and the alarm with its kind and tag or the version of a model; None for none."""
    name = str(detail.get("alarm") or "")
    kind = parse_kind(name)
    alarm = {"alarm": name, "kind": kind, "tag": name.removeprefix(kind).strip()} if name else None
    return {"machine": detail.get("machine"), "alarm": alarm, "version": detail.get("version")}


def _of_machine(
    path: Path, machine: str, limits: Mapping[str, float], *, start: float, end: float, gap: float
) -> dict[str, Any]:
    def rows_of(table: str, columns: Sequence[str], temperature: str | None = None) -> list[tuple[Any, ...]]:
        return stored_rows(connection, table, columns, start, end, machine=machine, temperature=temperature)

    with reading(path) as connection:
        on_record = dict(machines(connection))
        known = machine in on_record
        followed = [tag for tag in on_record.get(machine, []) if tag in limits]
        writes = [row for tag in followed for row in rows_of("writes", ("time", "verdict"), tag)]
        columns = ("time", "horizon", "levels", "quantiles", "measured")
        forecasts = {tag: rows_of("forecasts", columns, tag) for tag in followed}
        states = [rows_of("predictions", ("time", "location", "known"), tag) for tag in followed[:1]]
    return {
        "alarms": alarm_episodes(
            read_journal(path, machine=machine, end=end, select=partial(select_open, start=start)) if known else (),
            start,
            end,
        ),
        "temperatures": [
            {
                "tag": tag,
                "limit": limit,
                "hottest": _hottest(path, machine, tag, start, end) if known else None,
                "nearest": nearest_limit(forecasts.get(tag, ()), limit),
            }
            for tag, limit in limits.items()
        ],
        "states": _time_in_states(states[0] if states else (), gap),
        "unwatched": _unwatched(path, machine, limits if known else (), start=start, end=end, gap=gap),
        "writes": dict(Counter(str(verdict) for _, verdict in writes)),
    }


def select_open(rows: Sequence[StoredRow], *, start: float) -> list[StoredRow]:
    """Of an alarm journal in the order of its times those rows that a report from `start` (s UTC) is made of: of each
    alarm what came after it was last normal before, and the limits of those temperatures of which a warning stood."""
    normal = {
        row[1]: place for place, row in enumerate(rows) if row[0] < start and row[4] == AlarmState.NORMAL
    }  # the last one of each
    kinds = {alarm: parse_kind(alarm) for alarm in {row[1] for row in rows}}
    kept = [place > normal.get(row[1], -1) for place, row in enumerate(rows)]
    warned = {row[2] for row, keep in zip(rows, kept, strict=True) if keep and kinds[row[1]] in WARNINGS}
    return [row for row, keep in zip(rows, kept, strict=True) if keep or (row[2] in warned and kinds[row[1]] == LIMIT)]


def alarm_episodes(rows: Sequence[JournalRow], start: float, end: float) -> list[dict[str, Any]]:
    """The alarms that came or stood from `start` to `end` (s UTC), in the order of their coming, and what came of each.

    `ended` and `acknowledged` are None where that had not happened by `end`; of a warning `limit_after` is how long
    after it the limit was passed while it stood, None where it was not.
    """
    episodes: list[dict[str, Any]] = []
    open_ones: dict[str, dict[str, Any]] = {}
    for row in rows:
        one = open_ones.get(row.alarm)
        if row.state == AlarmState.UNACKNOWLEDGED and (one is None or one["ended"] is not None):
            one = {
                "alarm": row.alarm,
                "kind": parse_kind(row.alarm),
                "tag": row.tag,
                "priority": row.priority,
                "of_plant": row.subject != row.machine,
                "raised": row.time,
                "acknowledged": None,
                "by": "",
                "ended": None,
                "state": row.state,
            }
            open_ones[row.alarm] = one
            episodes.append(one)
        elif one is not None:
            if row.by and one["acknowledged"] is None and _acknowledges(row, one["state"]):
                one |= {"acknowledged": row.time, "by": row.by}
            one["state"] = row.state
            if one["ended"] is None and row.state not in ACTIVE and row.state not in HIDDEN:
                one["ended"] = row.time
    limits: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for one in episodes:
        if one["kind"] == LIMIT:
            limits[one["tag"]].append(one)
    shown = [one for one in episodes if one["ended"] is None or one["ended"] >= start]
    for one in shown:
        one["warning"] = one["kind"] in WARNINGS
        one["limit_after"] = _limit_after(one, limits[one["tag"]], end) if one["warning"] else None
    return shown


def _limit_after(warning: Mapping[str, Any], limits: Sequence[Mapping[str, Any]], end: float) -> float | None:
    """Seconds after a warning until the limit was passed while it stood, 0 where it was already; `limits` are the
    limit's own alarms of that temperature in their order."""
    raised, until = warning["raised"], end if warning["ended"] is None else warning["ended"]
    place = bisect_left(limits, raised, key=lambda one: one["raised"])
    if place and ((over := limits[place - 1]["ended"]) is None or over > raised):
        return 0.0
    return next((one["raised"] - raised for one in limits[place : place + 1] if one["raised"] <= until), None)


def _acknowledges(row: JournalRow, before: str) -> bool:
    """Whether a change says that somebody knew of the alarm; who hides one, or cleans up, says nothing of the kind."""
    if row.state == AlarmState.NORMAL:
        return before == AlarmState.RETURNED and row.by != GATEWAY
    return row.state in (AlarmState.ACKNOWLEDGED, AlarmState.LATCHED_ACKNOWLEDGED)


def _unwatched(
    path: Path, machine: str, tags: Collection[str], *, start: float, end: float, gap: float
) -> dict[str, float | int]:
    """How often and how long none of the tags had a good reading: a scan alone says only that it was tried."""
    times, good = np.empty(0), np.empty(0, dtype=bool)
    if tags:
        seen = to_trace(path, start=start, end=end, machine=machine, tags=tags)
        times = seen.times
        good = np.any([np.zeros(times.size, dtype=bool), *map(np.isfinite, seen.signals.values())], axis=0)
    # Between two good scans nothing was read where others lie that were not, or where there is none for too long.
    places = np.concatenate(([-1], np.flatnonzero(good), [good.size]))
    lengths = np.diff(np.concatenate(([start], times[good], [end])))
    none = lengths[(np.diff(places) > 1) | (lengths > gap)]
    return {"count": int(none.size), "seconds": float(none.sum())}


def _hottest(path: Path, machine: str, tag: str, start: float, end: float) -> dict[str, float] | None:
    """The greatest good reading and when it was."""
    good = [
        (float(sample.value), sample.time)
        for sample in samples(path, tag, start, end, machine=machine)
        if sample.quality is Quality.GOOD and isinstance(sample.value, int | float)
    ]
    value, time = max(good, default=(None, None))
    return None if value is None or time is None else {"value": value, "time": time}


def nearest_limit(rows: Sequence[tuple[Any, ...]], limit: float) -> dict[str, float | int | None]:
    """The least `minutes` after which the median of a forecast was at the limit, and the `time` at which it said so.

    `rows` are time, horizon, levels, quantiles and the reading then; between horizons the median is a line. Both are
    None where no median of the `forecasts` was; `horizon` (s) is how far they looked.
    """
    made: dict[float, list[tuple[float, float]]] = defaultdict(list)
    for time, horizon, levels, quantiles, measured in rows:
        median = dict(zip(json.loads(levels), json.loads(quantiles), strict=True)).get(0.5)
        if median is not None and measured is not None:
            made[time] = [*(made[time] or [(0.0, float(measured))]), (float(horizon), float(median))]
    crossings = [(crossing, time) for time, line in made.items() if (crossing := _crossing(line, limit)) is not None]
    least = min(crossings, default=None)
    return {
        "forecasts": len(made),
        "horizon": max((line[-1][0] for line in map(sorted, made.values())), default=None),
        "minutes": None if least is None else least[0] / 60.0,
        "time": None if least is None else least[1],
    }


def _crossing(line: Sequence[tuple[float, float]], limit: float) -> float | None:
    """Seconds until a line of (seconds, value) is at the limit."""
    ordered = sorted(line)
    if ordered[0][1] >= limit:
        return 0.0
    for (before, low), (after, high) in pairwise(ordered):
        if high >= limit:
            return before + (after - before) * (limit - low) / (high - low)
    return None


def _time_in_states(rows: Sequence[tuple[Any, ...]], gap: float) -> list[dict[str, Any]]:
    """How long the plant was in each known state and how often it came there, the longest first."""
    seconds: dict[str, float] = defaultdict(float)
    entries: Counter[str] = Counter()
    ordered = sorted(rows, key=lambda row: row[0])
    for (time, state, known), (after, then, known_then) in pairwise(ordered):
        if known and after - time <= gap:
            seconds[str(state)] += after - time
        if known_then and (then != state or not known):
            entries[str(then)] += 1
    return [
        {"state": state, "seconds": spent, "entries": entries[state]}
        for state, spent in sorted(seconds.items(), key=lambda one: -one[1])
    ]
