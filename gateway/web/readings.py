"""What the page reads of the historian: trends at any zoom, forecasts beside what came, alarms, scores.

Each question is answered in a thread, one at a time, by a connection of its own that only reads.
"""

import asyncio
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from drivers.tag import Quality
from gateway.store import reading, samples, scorecard, stored_rows, trend
from sim.sha import Array
from sim.strict_json import strict

T = TypeVar("T")

RAW_S = 3 * 3600.0
"""Up to so long a stretch is drawn from the readings themselves; beyond it from the means by the minute or hour."""
BY_MINUTE_S = 4 * 86_400.0
MINUTE, HOUR = 60, 3600
MOST_POINTS = 3_000
"""More than a screen has columns: of more readings each stretch shows its least, mean and greatest."""
MOST_FORECASTS = 1_000
LONGEST_SPAN_S = 100 * 366 * 86_400.0


class HistorianReader:
    """Reads the historian at `path` for browsers; `gap` (s) is how long after a reading nothing more is drawn."""

    def __init__(self, path: Path, gap: float) -> None:
        self._path, self._gap = path, gap
        self._turn = asyncio.Semaphore(1)

    async def _read(self, work: Callable[[], T]) -> T:
        async with self._turn:
            return await asyncio.to_thread(work)

    async def trend(self, machine: str, tag: str, start: float, end: float) -> dict[str, Any]:
        """See `trend_of`."""
        return await self._read(lambda: trend_of(self._path, tag, start, end, machine=machine, gap=self._gap))

    async def forecasts(
        self, machine: str, temperature: str, horizon: float, start: float, end: float
    ) -> dict[str, Any]:
        """See `forecasts_for`."""
        return await self._read(
            lambda: forecasts_for(
                self._path, horizon, start, end, machine=machine, temperature=temperature, gap=self._gap
            )
        )

    async def alarms(self, machine: str, start: float, end: float, most: int) -> list[dict[str, Any]]:
        """See `alarm_rows`."""
        return await self._read(lambda: alarm_rows(self._path, start, end, machine=machine, most=most))

    async def scorecard(self, machine: str, temperature: str) -> dict[str, Any]:
        """The scorecard of a followed temperature as plain values."""
        plain: dict[str, Any] = await self._read(
            lambda: strict(scorecard(self._path, machine=machine, temperature=temperature))
        )
        return plain


def trend_of(path: Path, tag: str, start: float, end: float, *, machine: str, gap: float) -> dict[str, Any]:
    """Times (s UTC) with the least, mean and greatest value of a tag from `start` to `end`; None where there is a gap.

    `width` is what a point stands for (s), 0 for a reading itself. Raises HistorianError, ValueError.
    """
    if end - start > RAW_S:
        tier = MINUTE if end - start <= BY_MINUTE_S else HOUR
        seen = trend(path, tag, start, end, width=tier, machine=machine)
        return _series(seen.starts + tier / 2, seen.low, seen.mean, seen.high, width=float(tier), gap=1.5 * tier)
    rows = [
        (sample.time, float(sample.value))
        if sample.quality is Quality.GOOD and isinstance(sample.value, int | float)
        else (sample.time, np.nan)
        for sample in samples(path, tag, start - gap, end, machine=machine)
    ]
    times, values = np.array(rows, dtype=float).reshape(len(rows), 2).T
    if times.size <= MOST_POINTS:
        return _series(times, values, values, values, width=0.0, gap=gap)
    width = (end - start) / (MOST_POINTS / 3)
    good = np.isfinite(values)
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


def forecasts_for(
    path: Path, horizon: float, start: float, end: float, *, machine: str, temperature: str, gap: float
) -> dict[str, Any]:
    """What was said `horizon` s before each moment from `start` to `end`: quantiles (5, 50, 95 %) as they were made.

    Of more than MOST_FORECASTS each n-th one. Raises HistorianError.
    """

    with reading(path) as connection:
        rows = stored_rows(
            connection,
            "forecasts",
            ("time", "horizon", "levels", "quantiles"),
            start - horizon,
            end - horizon,
            machine=machine,
            temperature=temperature,
        )
    made = sorted((row for row in rows if row[1] == horizon), key=lambda row: row[0])
    made = made[:: len(made) // MOST_FORECASTS + 1]
    times = np.array([row[0] + horizon for row in made], dtype=float)
    bands = [dict(zip(json.loads(levels), json.loads(quantiles), strict=True)) for _, _, levels, quantiles in made]
    low, median, high = (np.array([band.get(level, np.nan) for band in bands], float) for level in (0.05, 0.5, 0.95))
    spaces = np.diff(times)
    usual = float(np.median(spaces)) if spaces.size else gap
    return {"horizon": horizon, **_series(times, low, median, high, width=0.0, gap=max(gap, 3.0 * usual))}


def alarm_rows(path: Path, start: float, end: float, *, machine: str, most: int) -> list[dict[str, Any]]:
    """The newest changes of alarms, the newest first. Raises HistorianError."""
    names = ("time", "condition", "tag", "priority", "state", "value", "acknowledged_by")
    with reading(path) as connection:
        rows = stored_rows(connection, "alarms", names, start, end, machine=machine)
    return [dict(zip(names, row, strict=True)) for row in sorted(rows, key=lambda row: row[0])[: -most - 1 : -1]]
