"""Reading a historian: prediction beside measurement, forecasts beside what came, and back to traces to learn from."""

import json
import re
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from math import nan
from pathlib import Path

import numpy as np

from drivers.tag import Quality, Sample
from gateway.store.historian import HistorianError
from gateway.store.schema import APPLICATION_ID
from sim.sha import Array, Event, Mask, Trace

SPANS = {"d": 86_400.0, "h": 3600.0, "m": 60.0, "s": 1.0}
"""Seconds of a span's unit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Aligned:
    """Measured and predicted at the same n scans; arrays are (n,), NaN where there is none (degC, times in s UTC)."""

    times: Array
    measured: Array
    mean: Array
    low: Array
    high: Array
    free_run: Array
    anomaly: Array
    locations: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Matured:
    """The n forecasts for one `horizon` (s) and what was measured then; arrays are (n,), NaN where nothing was.

    `quantiles` (n, L) at `levels` (L,), degC; `persistence` is the reading when the forecast was made, `outcome` the
    one at that time plus the horizon, `p_limit` the stated probability of reaching the limit.
    """

    horizon: float
    times: Array
    levels: tuple[float, ...]
    quantiles: Array
    p_limit: Array
    persistence: Array
    outcome: Array


@contextmanager
def reading(path: Path) -> Iterator[sqlite3.Connection]:
    """A read-only connection; a running gateway is not disturbed. Raises HistorianError for what is no historian."""
    if not path.is_file():
        raise HistorianError(f"{path}: there is no historian; give the path of the file that a gateway has written")
    connection = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=5.0)
    try:
        if connection.execute("PRAGMA application_id").fetchone()[0] != APPLICATION_ID:
            raise HistorianError(f"{path}: is no historian; give the path of the file that a gateway has written")
        yield connection
    except sqlite3.Error as error:
        raise HistorianError(f"{path}: cannot be read ({error}); give the path of a historian") from None
    finally:
        connection.close()


def history(path: Path, start: float = -1e18, end: float = 1e18) -> Aligned:
    """Measured and predicted at the scans with start <= time < end. Raises HistorianError."""
    columns = "time, measured, mean, low, high, free_run, anomaly, location"
    with reading(path) as connection:
        rows = connection.execute(
            f"SELECT {columns} FROM predictions WHERE time >= ? AND time < ? ORDER BY time",  # noqa: S608
            (start, end),
        ).fetchall()
    numbers = np.array([row[:7] for row in rows], dtype=float).reshape(len(rows), 7).T
    times, measured, mean, low, high, free_run, anomaly = numbers
    return Aligned(
        times=times,
        measured=measured,
        mean=mean,
        low=low,
        high=high,
        free_run=free_run,
        anomaly=anomaly,
        locations=tuple(str(row[7]) for row in rows),
    )


def matured(path: Path, tolerance: float = 5.0) -> dict[float, Matured]:
    """By horizon (s): every forecast and the first good reading at most `tolerance` s after what it spoke of."""
    with reading(path) as connection:
        rows = connection.execute(
            "SELECT horizon, time, levels, quantiles, p_limit, measured FROM forecasts ORDER BY horizon, time"
        ).fetchall()
    seen = history(path)
    good = np.isfinite(seen.measured)
    times, values = seen.times[good], seen.measured[good]
    by_horizon: dict[float, list[tuple[float, str, str, float, float | None]]] = {}
    for horizon, *rest in rows:
        by_horizon.setdefault(float(horizon), []).append(tuple(rest))
    matured: dict[float, Matured] = {}
    for horizon, forecasts in by_horizon.items():
        made_at = np.array([row[0] for row in forecasts], dtype=float)
        # The first reading at or after what the forecast spoke of; times are sums of floats, so a microsecond counts as
        # at. Behind the last reading there is one at infinity: it is too late for any tolerance, and no index ends.
        place = np.searchsorted(times, made_at + horizon - 1e-6)
        later = np.append(times, np.inf)[place]
        outcome = np.where(later <= made_at + horizon + tolerance, np.append(values, nan)[place], nan)
        matured[horizon] = Matured(
            horizon=horizon,
            times=made_at,
            levels=tuple(json.loads(forecasts[0][1])),
            quantiles=np.array([json.loads(row[2]) for row in forecasts], dtype=float),
            p_limit=np.array([row[3] for row in forecasts], dtype=float),
            persistence=np.array([nan if row[4] is None else row[4] for row in forecasts], dtype=float),
            outcome=outcome,
        )
    return matured


def events(path: Path) -> tuple[Event, ...]:
    """The events in the order in which the gateway saw them."""
    with reading(path) as connection:
        return tuple(Event(*row) for row in connection.execute("SELECT time, symbol FROM events ORDER BY id"))


def samples(path: Path) -> Iterator[Sample]:
    """Every stored sample, tag by tag in the order of time; `sent` as the driver gave it, None where not good."""
    with reading(path) as connection:
        rows = connection.execute(
            "SELECT name, value, quality, time, sent FROM samples JOIN tags ON tags.id = samples.tag ORDER BY tag, time"
        )
        for name, value, quality, time, sent in rows:
            yield Sample(name, value, Quality(quality), time, sent)


def to_trace(path: Path, name: str = "historian", start: float = -1e18, end: float = 1e18) -> Trace:
    """The measurements as a trace with one row a scan, not encoded: what the gateway's own encoder was given.

    A reading that was not stored because it equalled the one before it is there again; one that was not good is NaN
    and marked in `bad`. Strings are left out. Raises HistorianError.
    """
    with reading(path) as connection:
        clock = connection.execute(
            "SELECT time FROM scans WHERE time >= ? AND time < ? ORDER BY time", (start, end)
        ).fetchall()
        times = np.array([row[0] for row in clock], dtype=float)
        signals: dict[str, Array] = {}
        bad: dict[str, Mask] = {}
        # A sample that did not change is kept every max_interval only: to know what stood at `start`, one has to look
        # back as far as that, and by ten scans more for those that were late. An hour where no run is on record.
        reach = connection.execute("SELECT max(max_interval + 10 * period) FROM runs").fetchone()[0] or 3600.0
        for number, tag in connection.execute("SELECT id, name FROM tags ORDER BY id").fetchall():
            rows = connection.execute(
                "SELECT time, value, quality FROM samples WHERE tag = ? AND time >= ? AND time < ? "
                "AND typeof(value) != 'text' ORDER BY time",
                (number, start - reach, end),
            ).fetchall()
            if not rows:
                continue
            kept = np.array([row[0] for row in rows], dtype=float)
            good = np.array([Quality(row[2]).is_good for row in rows])
            values = np.array([nan if row[1] is None else row[1] for row in rows], dtype=float)
            values = np.where(good, values, nan)
            # The sample in force at each scan is the last one kept; before the first one there is no reading, and its
            # place -1 would be numpy's last sample, so these rows are put right here.
            place = np.searchsorted(kept, times, side="right") - 1
            before = place < 0
            signals[tag], bad[tag] = np.where(before, nan, values[place]), ~before & ~good[place]
    return Trace(name, times, signals, bad=bad, origin=str(path))


def recent(path: Path, since: str) -> Trace:
    """The measurements `since` a time (ISO 8601, UTC where it names no zone) or over the last span (7d, 36h, 90m, 30s).

    A span ends with the newest scan. Raises HistorianError, and ValueError for another `since` or where there is
    nothing after it.
    """
    with reading(path) as connection:
        first, last = connection.execute("SELECT min(time), max(time) FROM scans").fetchone()
    if last is None:
        raise ValueError(f"{path}: this historian has no scan yet; let the gateway run first")
    start = _moment(since, float(last))
    trace = to_trace(path, start=start)
    if trace.times.size < 2:
        raise ValueError(f"{path}: there is nothing since {since}; it has {_date(first)} to {_date(last)}")
    return trace


def _moment(since: str, last: float) -> float:
    """Seconds UTC."""
    span = re.fullmatch(r"([0-9]+(?:\.[0-9]+)?)([dhms])", since.strip())
    if span is not None:
        return last - float(span[1]) * SPANS[span[2]]
    try:
        moment = datetime.fromisoformat(since.strip())
    except ValueError:
        raise ValueError(f"{since!r} is neither a time nor a span; give one like 2026-03-01T06:00, 7d or 36h") from None
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def _date(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%dT%H:%M")
