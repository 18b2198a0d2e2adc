"""What browsers are answered from the historian: trends at any zoom, forecasts beside what came, alarms, scores.

These functions run in a process of their own (`gateway.outside.web.reader_process`) and give plain values.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from drivers.csv_rows import write_rows
from drivers.tag import Quality
from gateway.machine.alarms import alarm_rates, read_journal
from gateway.outside.web.shift import read_people, read_shift
from gateway.settings import alarm_subject, parse_kind
from gateway.store import machines, newest_scan, reading, samples, scorecard, stored_rows, trend, warning_score
from sim.sha import Array
from sim.strict_json import strict

MAX_RAW_SPAN_S = 3 * 3600.0
"""Up to so long a stretch is drawn from the readings themselves; beyond it from the means by the minute or hour."""
MAX_MINUTE_SPAN_S = 4 * 86_400.0
MINUTE, HOUR, DAY, WEEK = 60, 3600, 86_400.0, 7 * 86_400.0
MOST_POINTS = 3_000
"""More than a screen has columns: of more readings each stretch shows its least, mean and greatest."""
MOST_FORECASTS = 1_000


def read_trend(path: Path, tag: str, start: float, end: float, *, machine: str, gap: float) -> dict[str, Any]:
    """Times (s UTC) with the least, mean and greatest value of a tag from `start` to `end`; None where there is a gap.

    `gap` (s) is how long after a reading nothing more is drawn; `width` is what a point stands for (s), 0 for a reading
    itself. Raises HistorianError, ValueError.
    """
    if end - start > MAX_RAW_SPAN_S:
        tier = MINUTE if end - start <= MAX_MINUTE_SPAN_S else HOUR
        seen = trend(path, tag, start, end, width=tier, machine=machine)
        return _series(seen.starts + tier / 2, seen.low, seen.mean, seen.high, width=float(tier), gap=1.5 * tier)
    rows = [
        (sample.time, float(sample.value))
        if sample.quality is Quality.GOOD and isinstance(sample.value, int | float)
        else (sample.time, np.nan)
        for sample in samples(path, tag, start - gap, end, machine=machine)
    ]
    times, values = np.array(rows, dtype=float).reshape(len(rows), 2).T
    good = np.isfinite(values)
    if times.size <= MOST_POINTS or not good.any():
        return _series(times, values, values, values, width=0.0, gap=gap)
    width = (end - start) / (MOST_POINTS / 3)
    bins = np.floor((times[good] - start) / width)
    _, first = np.unique(bins, return_index=True)
    kept = values[good]
    low, high = np.minimum.reduceat(kept, first), np.maximum.reduceat(kept, first)
    mean = np.add.reduceat(kept, first) / np.diff(np.append(first, kept.size))
    middle = start + (bins[first] + 0.5) * width
    return _series(middle, low, mean, high, width=width, gap=max(gap, 1.5 * width))


def _series(times: Array, low: Array, mean: Array, high: Array, *, width: float, gap: float) -> dict[str, Any]:
    """Plain columns; a row of None behind each point that the next one follows later than `gap` (s)."""
    holes = np.flatnonzero(np.diff(times) > gap) + 1
    columns = {"low": low, "mean": mean, "high": high}
    return {
        "width": width,
        "times": strict(np.insert(times, holes, times[holes - 1] + gap / 2)),
        **{name: strict(np.insert(values, holes, np.nan)) for name, values in columns.items()},
    }


def read_forecasts(
    path: Path, horizon: float, start: float, end: float, *, machine: str, temperature: str, gap: float
) -> dict[str, Any]:
    """What was said `horizon` s before each moment from `start` to `end`: quantiles (5, 50, 95 %) as they were made.

    Of more than MOST_FORECASTS each n-th one. Raises HistorianError.
    """
    columns = ("time", "horizon", "levels", "quantiles")
    with reading(path) as connection:
        rows = stored_rows(
            connection, "forecasts", columns, start - horizon, end - horizon, machine=machine, temperature=temperature
        )
    made = sorted((row for row in rows if row[1] == horizon), key=lambda row: row[0])
    made = made[:: len(made) // MOST_FORECASTS + 1]
    times = np.array([row[0] + horizon for row in made], dtype=float)
    bands = [dict(zip(json.loads(levels), json.loads(quantiles), strict=True)) for _, _, levels, quantiles in made]
    low, median, high = (np.array([band.get(level, np.nan) for band in bands], float) for level in (0.05, 0.5, 0.95))
    spaces = np.diff(times)
    usual = float(np.median(spaces)) if spaces.size else gap
    return {"horizon": horizon, **_series(times, low, median, high, width=0.0, gap=max(gap, 3.0 * usual))}


LONGEST_LOOK_BACK_S = 3600.0
"""How long before a moment the newest forecast may have been made that is shown as the one of that moment."""


def read_forecast(path: Path, at: float, *, machine: str, temperature: str) -> dict[str, Any]:
    """The newest forecast made up to `at` (s UTC), as it was made: quantiles (5, 50, 95 %) at each of its horizons.

    The first point is the reading then. `made` is None where there is none in the hour before. Raises HistorianError.
    """
    columns = ("time", "horizon", "levels", "quantiles", "measured")
    with reading(path) as connection:
        rows = stored_rows(
            connection,
            "forecasts",
            columns,
            at - LONGEST_LOOK_BACK_S,
            float(np.nextafter(at, np.inf)),
            machine=machine,
            temperature=temperature,
        )
    made = max((row[0] for row in rows), default=None)
    newest = sorted((row for row in rows if row[0] == made), key=lambda row: row[1])
    points = [(row[0] + row[1], dict(zip(json.loads(row[2]), json.loads(row[3]), strict=True))) for row in newest]
    if newest and newest[0][4] is not None:
        points.insert(0, (newest[0][0], dict.fromkeys((0.05, 0.5, 0.95), newest[0][4])))
    quantiles = {
        name: [quantile.get(level) for _, quantile in points]
        for name, level in (("low", 0.05), ("mean", 0.5), ("high", 0.95))
    }
    plain: dict[str, Any] = strict({"made": made, "times": [time for time, _ in points], **quantiles})
    return plain


def read_table(
    path: Path, *, machine: str, tags: Sequence[str], start: float, end: float, gap: float
) -> dict[str, Any]:
    """What trends of some tags show from `start` to `end` (s UTC), as CSV: a row a time, in UTC.

    Of a trend that is no reading itself the least and the greatest of each stretch stand beside the mean; nothing
    stands where a tag has no value at that time. Raises HistorianError, ValueError.
    """
    heads, columns = ["time"], list[dict[float, float]]()
    for tag in tags:
        seen = read_trend(path, tag, start, end, machine=machine, gap=gap)
        names = {"mean": tag} | ({"low": f"{tag} min", "high": f"{tag} max"} if seen["width"] else {})
        for name, head in names.items():
            heads.append(head)
            values = zip(seen["times"], seen[name], strict=True)
            columns.append({time: value for time, value in values if value is not None and start <= time <= end})
    sink = StringIO(newline="")
    moments = sorted(set().union(*columns))
    write_rows(sink, [heads])
    write_rows(
        sink,
        (
            [
                datetime.fromtimestamp(time, UTC).isoformat(timespec="milliseconds"),
                *(each.get(time) for each in columns),
            ]
            for time in moments
        ),
    )
    return {"text": sink.getvalue()}


def alarm_rows(path: Path, *, machine: str, most: int) -> dict[str, Any]:
    """The newest changes of alarms, the newest first, with their kinds; `of_plant` are those not of the machine alone.

    Raises HistorianError.
    """
    names = ("time", "condition", "tag", "priority", "state", "value", "acknowledged_by")
    with reading(path) as connection:
        rows = stored_rows(connection, "alarms", names, machine=machine)
    newest = sorted(rows, key=lambda row: row[0])[: -most - 1 : -1]
    plain = [dict(zip(names, row, strict=True)) for row in newest]
    for row in plain:
        row["kind"] = parse_kind(row["condition"])
        row["of_plant"] = alarm_subject(row["condition"], row["tag"], machine) != machine
    return {"rows": plain}


def rates_of_alarms(path: Path, *, days: float) -> dict[str, Any]:
    """The alarms of all machines up to the newest scan against what a person can deal with: one person has to deal
    with all of them. None where nothing was scanned. Raises HistorianError.
    """
    with reading(path) as connection:
        newest = [newest_scan(connection, machine=name) for name, _ in machines(connection)]
    last = max((time for time in newest if time is not None), default=None)
    if last is None:
        return {"rates": None}
    found = alarm_rates(read_journal(path, end=last), last - days * DAY, last)
    plain: dict[str, Any] = {"rates": strict({**asdict(found), "ok": found.ok})}
    return plain


def scores_by_week(
    path: Path, *, machine: str, temperature: str, weeks: int, runs: Mapping[str, bool | None]
) -> dict[str, Any]:
    """The scorecard of each of the last `weeks` in which there are scans, the newest first, which ends with the newest
    scan; beside it what came of the warnings. `runs` as of `scorecard`. Raises HistorianError.
    """
    with reading(path) as connection:
        last = newest_scan(connection, machine=machine)
    rows = []
    for number in range(weeks if last is not None else 0):
        end = (last or 0.0) - number * WEEK + (1.0 if number == 0 else 0.0)
        start = end - WEEK
        card = scorecard(path, machine=machine, temperature=temperature, start=start, end=end, runs=runs)
        if card.one_step.count or number == 0:
            warnings = warning_score(path, machine=machine, temperature=temperature, start=start, end=end)
            rows.append({"start": start, "end": end, "card": card, "warnings": warnings})
    plain: dict[str, Any] = {"weeks": strict(rows)}
    return plain


def notes_between(_: Path, *, audit: str, machine: str, start: float, end: float) -> dict[str, Any]:
    """What people have noted of a machine's moments from `start` to `end` (s UTC); how many older ones `left_out`."""
    found = read_people(Path(audit), start=start, end=end, machine=machine)
    return {"notes": found["notes"], "left_out": found["left_out"]["notes"]}


def shift_report(path: Path, **asked: Any) -> dict[str, Any]:
    """See `gateway.outside.web.shift.read_shift`."""
    plain: dict[str, Any] = strict(read_shift(path, **asked))
    return plain


QUESTIONS: Mapping[str, Callable[..., Mapping[str, Any]]] = {
    "trend": read_trend,
    "forecasts": read_forecasts,
    "forecast": read_forecast,
    "table": read_table,
    "alarms": alarm_rows,
    "rates": rates_of_alarms,
    "scorecard": scores_by_week,
    "notes": notes_between,
    "shift": shift_report,
}
"""All that the reading process is asked."""
