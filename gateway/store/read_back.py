"""Reading a historian: prediction beside measurement, forecasts beside what came, and back to traces to learn from.

Every reader speaks of one `machine` (None: the only one in the file), and where rows are about a followed temperature
of one `temperature` of it (None: the machine's first). A file of layout 1 or 2 has one machine without a name, "".
"""

import json
import re
import sqlite3
from collections.abc import Container, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from math import floor, inf, isfinite, nan, nextafter
from pathlib import Path
from typing import Any

import numpy as np

from drivers.tag import Quality, Sample
from gateway.store.columns import Cell, PackedError, unpack
from gateway.store.files import HistorianError
from gateway.store.numbers import newest_scan_time
from gateway.store.retention import TIERS, means, merge_rows, tier_kind
from gateway.store.schema import APPLICATION_ID, FOLLOWED, NAMES, PACKED, VERSION, number, restore_value
from gateway.store.sqlite_file import key_range
from sim.sha import Array, Event, Mask, Trace, holds_roughly

GOOD_CODES = frozenset(int(quality) for quality in Quality if quality.is_good)
"""The qualities of good readings, as they are stored."""

MOST_STRETCHES = 20_000
"""More stretches than any picture shows: a trend by the minute goes back a fortnight, beyond that it is by the hour."""
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
def reading(path: Path, *, immutable: bool = False) -> Iterator[sqlite3.Connection]:
    """A read-only connection; a running gateway is not disturbed. Raises HistorianError for what is no historian.

    A file that is `immutable` nobody writes meanwhile: SQLite puts no files of its own beside it.
    """
    if not path.is_file():
        raise HistorianError(f"{path}: there is no historian; give the path of the file that a gateway has written")
    how = "?mode=ro&immutable=1" if immutable else "?mode=ro"
    connection = sqlite3.connect(f"{path.absolute().as_uri()}{how}", uri=True, timeout=5.0)
    try:
        if connection.execute("PRAGMA application_id").fetchone()[0] != APPLICATION_ID:
            raise HistorianError(f"{path}: is no historian; give the path of the file that a gateway has written")
        if _layout(connection) > VERSION:
            raise HistorianError(f"{path}: has layout {_layout(connection)}, this program reads {VERSION}; update it")
        yield connection
    except sqlite3.Error as error:
        raise HistorianError(f"{path}: cannot be read ({error}); give the path of a historian") from None
    finally:
        connection.close()


def _layout(connection: sqlite3.Connection) -> int:
    return int(connection.execute("PRAGMA user_version").fetchone()[0])


def machines(connection: sqlite3.Connection) -> list[tuple[str, list[str]]]:
    """The machines in the file, in the order in which they came, and the temperatures that were followed on each."""
    if _layout(connection) < 3:
        query = "SELECT temperature FROM runs WHERE temperature != '' ORDER BY started DESC"
        return [("", list(dict.fromkeys(str(row[0]) for row in connection.execute(query))))]
    found: dict[str, list[str]] = {}
    for machine, temperature in connection.execute("SELECT machine, temperature FROM sources ORDER BY id"):
        found.setdefault(str(machine), []).extend([str(temperature)] if temperature else [])
    return list(found.items())


@dataclass(frozen=True, slots=True, kw_only=True)
class SelectedSources:
    """Whose rows are read: a machine of a file of some `layout`, its sources, and of these the followed ones."""

    layout: int
    machine: str
    own: tuple[int, ...]
    followed: tuple[int, ...]

    def table_sources(self, table: str) -> tuple[int, ...]:
        """The sources whose rows of a table are read."""
        return self.followed if table in FOLLOWED else self.own

    def where(self, table: str) -> tuple[str, tuple[int, ...]]:
        """The condition for the rows of a table that are not packed, and its values."""
        if self.layout < 3:
            return "1", ()
        sources = self.table_sources(table)
        if table in PACKED:
            condition = " OR ".join(["id BETWEEN ? AND ?"] * len(sources))
            return f"({condition or 0})", tuple(key for source in sources for key in key_range(source))
        return f"source IN ({', '.join('?' * len(sources))})", sources

    def tags(self, connection: sqlite3.Connection) -> list[tuple[int, str]]:
        """The machine's tags, (number, name)."""
        if self.layout < 3:
            return connection.execute("SELECT id, name FROM tags ORDER BY id").fetchall()
        query = "SELECT id, name FROM tags WHERE machine = ? ORDER BY id"
        return connection.execute(query, (self.machine,)).fetchall()


def select_sources(
    connection: sqlite3.Connection, machine: str | None = None, temperature: str | None = None
) -> SelectedSources:
    """The sources of a machine (None: the only one), those of a followed temperature (None: its first).

    With a `temperature` only that one's rows are read, of any table. Raises HistorianError for one that is not there,
    and without a machine where there are several.
    """
    found, file = dict(machines(connection)), _database_path(connection)
    names = ", ".join(name or "a machine without a name" for name in found)
    if machine is None:
        if len(found) > 1:
            raise HistorianError(f"{file}: has the rows of several machines; name one of {names}")
        machine = next(iter(found), "")
    elif machine not in found and found:
        raise HistorianError(f"{file}: has no rows of a machine {machine!r}; it has those of {names}")
    temperatures = found.get(machine, [])
    if temperature is not None and temperature not in temperatures:
        has = ", ".join(temperatures) or "none"
        raise HistorianError(f"{file}: {temperature!r} is followed on no machine {machine!r}; followed there: {has}")
    layout = _layout(connection)
    if layout < 3:
        return SelectedSources(layout=layout, machine=machine, own=(0,), followed=(0,))
    query = "SELECT temperature, id FROM sources WHERE machine = ? ORDER BY id"
    sources: dict[str, int] = {str(row[0]): int(row[1]) for row in connection.execute(query, (machine,))}
    first = next(iter(temperatures), None)
    # What nobody has said the temperature of is about the first.
    wanted = {first, ""} if temperature in (None, first) else {temperature}
    followed = tuple(number for name, number in sources.items() if name in wanted)
    own = tuple(sources.values()) if temperature is None else followed
    return SelectedSources(layout=layout, machine=machine, own=own, followed=followed)


def _database_path(connection: sqlite3.Connection) -> str:
    return str(connection.execute("PRAGMA database_list").fetchone()[2])


def _chunks(
    connection: sqlite3.Connection, kind: str, tag: int, start: float = -inf, end: float = inf
) -> Iterator[tuple[int, list[list[Cell]]]]:
    """(batch, columns) of the chunks that reach into start <= time < end, in the order of arrival.

    One that cannot be read costs itself: each is fetched alone, since a bad page ends whatever goes on behind it.
    """
    if _layout(connection) < 2:
        return
    query = "SELECT batch, id FROM chunks WHERE kind = ? AND tag = ? AND last >= ? AND first < ?"
    for batch, place in sorted(connection.execute(query, (kind, tag, start, end)).fetchall()):
        with suppress(PackedError, sqlite3.DatabaseError):
            row = connection.execute("SELECT data FROM chunks WHERE id = ?", (place,)).fetchone()
            if row is not None:  # packed or deleted since, by a gateway that runs
                yield batch, unpack(row[0])


def stored_rows(
    connection: sqlite3.Connection,
    table: str,
    names: Sequence[str],
    start: float = -inf,
    end: float = inf,
    *,
    machine: str | None = None,
    temperature: str | None = None,
) -> list[tuple[Any, ...]]:
    """The columns `names`, the first of them `time`, of the rows with start <= time < end, in the order of arrival.

    Of a machine's temperatures each has an order of its own. Raises HistorianError.
    """
    return _rows(connection, select_sources(connection, machine, temperature), table, names, start=start, end=end)


def _rows(
    connection: sqlite3.Connection,
    whose: SelectedSources,
    table: str,
    names: Sequence[str],
    *,
    start: float = -inf,
    end: float = inf,
) -> list[tuple[Any, ...]]:
    places = [NAMES[table].index(name) for name in names]
    rows: list[tuple[Any, ...]] = []
    # One moment for both places: a row that is packed meanwhile would be seen twice or not at all.
    with one_moment(connection):
        for source in whose.table_sources(table):
            for _, columns in _chunks(connection, table, source, start, end):
                picked = zip(*(columns[place] for place in places), strict=True)
                rows += (row for row in picked if start <= row[0] < end)
        condition, values = whose.where(table)
        query = f"SELECT {', '.join(names)} FROM {table} WHERE {condition} AND time >= ? AND time < ?"  # noqa: S608
        rows += connection.execute(query, (*values, start, end)).fetchall()
    return rows


def row_number(
    connection: sqlite3.Connection, table: str, *, machine: str | None = None, temperature: str | None = None
) -> int:
    """How many rows a table has, packed or not. Raises HistorianError."""
    whose, packed = select_sources(connection, machine, temperature), 0
    if whose.layout >= 2:
        places = [tag for tag, _ in whose.tags(connection)] if table == "samples" else whose.table_sources(table)
        query = "SELECT coalesce(sum(rows), 0) FROM chunks WHERE kind = ? AND tag = ?"
        packed = sum(connection.execute(query, (table, place)).fetchone()[0] for place in places)
    condition, values = whose.where(table)
    query = f"SELECT count(*) FROM {table} WHERE {condition}"  # noqa: S608
    return int(packed) + int(connection.execute(query, values).fetchone()[0])


def tag_names(connection: sqlite3.Connection, *, machine: str | None = None) -> list[str]:
    """The machine's tags, in the order in which they came. Raises HistorianError."""
    return [name for _, name in select_sources(connection, machine).tags(connection)]


def newest_scan(connection: sqlite3.Connection, *, machine: str | None = None) -> float | None:
    """The time (s UTC) of the scan that was stored last, whatever the clock said before; None without one.

    Raises HistorianError.
    """
    whose = select_sources(connection, machine)
    if whose.layout >= 3:
        return newest_scan_time(connection, whose.machine)
    key = "rowid" if whose.layout == 2 else "time"
    row = connection.execute(f"SELECT time FROM scans ORDER BY {key} DESC LIMIT 1").fetchone()  # noqa: S608
    return float(row[0]) if row else None


def oldest_scan(connection: sqlite3.Connection, *, machine: str | None = None) -> float | None:
    """The earliest time (s UTC) of a scan that is still there; None without one. No scan is read for it.

    Raises HistorianError.
    """
    whose = select_sources(connection, machine)
    condition, values = whose.where("scans")
    with one_moment(connection):
        query = f"SELECT min(time) FROM scans WHERE {condition}"  # noqa: S608
        found = [connection.execute(query, values).fetchone()[0]]
        if whose.layout >= 2:
            query = "SELECT min(first) FROM chunks WHERE kind = 'scans' AND tag = ?"
            found += [connection.execute(query, (source,)).fetchone()[0] for source in whose.table_sources("scans")]
    return min((float(time) for time in found if time is not None), default=None)


@contextmanager
def one_moment(connection: sqlite3.Connection) -> Iterator[None]:
    """A transaction that reads, unless there is one: all of it sees the file as it was at its beginning."""
    if connection.in_transaction:
        yield
        return
    connection.execute("BEGIN")
    try:
        yield
    finally:
        connection.execute("COMMIT")


class _SampleReader:
    """The samples of a machine, one tag after the other; the moments that tags share are unpacked once."""

    def __init__(self, connection: sqlite3.Connection, whose: SelectedSources) -> None:
        self._connection, self._where = connection, whose.where("samples")
        self._stamps: dict[int, list[list[Cell]]] = {}

    def rows(self, tag: int, start: float = -inf, end: float = inf) -> list[tuple[float, Any, int, float | None]]:
        """(time, value, quality, sent) with start <= time < end, in the order of time."""
        connection = self._connection
        rows: list[tuple[float, Any, int, float | None]] = []
        for batch, (which, values, qualities) in _chunks(connection, "samples", tag, start, end):
            if batch not in self._stamps:
                query = "SELECT data FROM chunks WHERE batch = ? AND kind = 'stamps'"
                row = connection.execute(query, (batch,)).fetchone()
                if row is None:
                    continue
                self._stamps[batch] = unpack(row[0])
            times, sent = self._stamps[batch]
            rows += [
                (time, value, quality, sent[place])  # type: ignore[misc,index]
                for place, value, quality in zip(which, values, qualities, strict=True)
                if start <= (time := times[place]) < end  # type: ignore[index,operator]
            ]
        condition, keys = self._where
        query = f"SELECT time, value, quality, sent FROM samples WHERE {condition} "  # noqa: S608
        query += "AND tag = ? AND time >= ? AND time < ?"
        rows += connection.execute(query, (*keys, tag, start, end)).fetchall()
        return sorted(rows, key=lambda row: row[0])


def history(
    path: Path,
    start: float = -1e18,
    end: float = 1e18,
    *,
    machine: str | None = None,
    temperature: str | None = None,
) -> Aligned:
    """Measured and predicted at the scans with start <= time < end. Raises HistorianError."""
    columns = ("time", "measured", "mean", "low", "high", "free_run", "anomaly", "location")
    with reading(path) as connection:
        whose = select_sources(connection, machine, temperature)
        rows = sorted(_rows(connection, whose, "predictions", columns, start=start, end=end), key=lambda row: row[0])
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


def mature_forecasts(
    path: Path,
    tolerance: float = 5.0,
    *,
    machine: str | None = None,
    temperature: str | None = None,
    start: float = -inf,
    end: float = inf,
) -> dict[float, Matured]:
    """By horizon (s): every forecast made from `start` to `end` (s UTC), and the first good reading at most `tolerance`
    s after what it spoke of."""
    with reading(path) as connection:
        columns = ("time", "horizon", "levels", "quantiles", "p_limit", "measured")
        whose = select_sources(connection, machine, temperature)
        made = _rows(connection, whose, "forecasts", columns, start=start, end=end)
        rows = sorted(made, key=lambda row: (row[1], row[0]))
    farthest = max((row[1] for row in rows), default=0.0)
    seen = history(path, start, end + farthest + tolerance, machine=machine, temperature=temperature)
    good = np.isfinite(seen.measured)
    times, values = seen.times[good], seen.measured[good]
    by_horizon: dict[float, list[tuple[float, str, str, float, float | None]]] = {}
    for time, horizon, *rest in rows:
        by_horizon.setdefault(float(horizon), []).append((time, *rest))
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


def events(path: Path, *, machine: str | None = None, temperature: str | None = None) -> tuple[Event, ...]:
    """The events in the order in which the gateway saw them. Raises HistorianError."""
    with reading(path) as connection:
        rows = stored_rows(connection, "events", ("time", "symbol"), machine=machine, temperature=temperature)
        return tuple(Event(*row) for row in rows)


def samples(
    path: Path, tag: str | None = None, start: float = -inf, end: float = inf, *, machine: str | None = None
) -> Iterator[Sample]:
    """Every stored sample with start <= time < end, of one tag or tag by tag, in the order of time.

    `sent` is as the driver gave it, None where not good. Raises HistorianError.
    """
    with reading(path) as connection:
        whose = select_sources(connection, machine)
        for number, name in whose.tags(connection):
            if tag not in (None, name):
                continue
            with one_moment(connection):
                rows = _SampleReader(connection, whose).rows(number, start, end)
            for time, value, quality, sent in rows:
                yield Sample(name, restore_value(value), Quality(quality), time, sent)


def to_trace(
    path: Path,
    title: str = "historian",
    start: float = -1e18,
    end: float = 1e18,
    *,
    machine: str | None = None,
    tags: Container[str] | None = None,
) -> Trace:
    """The measurements as a trace with one row a scan, not encoded: what the gateway's own encoder was given.

    A reading that was not stored because it equalled the one before it is there again; one that was not good is NaN and
    marked in `bad`. Where a deadband kept readings back, what only holds is marked in `held`. Strings are left out, and
    so is what is none of the `tags` (None: all). Raises HistorianError.
    """
    with reading(path) as connection:
        whose = select_sources(connection, machine)
        clock = sorted(row[0] for row in _rows(connection, whose, "scans", ("time",), start=start, end=end))
        times = np.array(clock, dtype=float)
        signals: dict[str, Array] = {}
        bad: dict[str, Mask] = {}
        held: dict[str, Mask] = {}
        # A sample that did not change is kept every max_interval only: to know what stood at `start`, one has to look
        # back as far as that, and by ten scans more for those that were late. An hour where no run is on record.
        condition, own = whose.where("runs")
        query = f"SELECT max(max_interval + 10 * period) FROM runs WHERE {condition}"  # noqa: S608
        reach = connection.execute(query, own).fetchone()[0] or 3600.0
        reader = _SampleReader(connection, whose)
        for tag, name in whose.tags(connection):
            if tags is not None and name not in tags:
                continue
            rows = [row for row in reader.rows(tag, start - reach, end) if not isinstance(row[1], str)]
            if not rows:
                continue
            kept = np.array([row[0] for row in rows], dtype=float)
            good = np.array([row[2] in GOOD_CODES for row in rows])
            values = np.where(good, np.array([number(row[1]) for row in rows]), nan)
            # The sample in force at each scan is the last one kept; before the first one there is no reading, and its
            # place -1 would be numpy's last sample, so these rows are put right here.
            place = np.searchsorted(kept, times, side="right") - 1
            before = place < 0
            signals[name], bad[name] = np.where(before, nan, values[place]), ~before & ~good[place]
            if holds_roughly(kept, values):
                held[name] = ~before & (np.diff(place, prepend=-1) == 0)
    return Trace(title, times, signals, bad=bad, origin=str(path), held=held)


def recent(path: Path, since: str, *, machine: str | None = None) -> Trace:
    """The measurements `since` a time (ISO 8601, UTC where it names no zone) or over the last span (7d, 36h, 90m, 30s).

    A span ends with the newest scan. Raises HistorianError, and ValueError for another `since` or where there is
    nothing after it.
    """
    with reading(path) as connection:
        last = newest_scan(connection, machine=machine)
    if last is None:
        raise ValueError(f"{path}: this historian has no scan yet; let the gateway run first")
    # Up to the newest scan and no further: what a clock that was ahead has left beyond it is not recent.
    trace = to_trace(path, start=parse_moment(since, last), end=nextafter(last, inf), machine=machine)
    if trace.times.size < 2:
        raise ValueError(f"{path}: there is nothing since {since}; its newest scan is of {_date(last)}")
    return trace


@dataclass(frozen=True, slots=True, kw_only=True)
class Trend:
    """What a tag did: n stretches of `width` s from `starts` (s UTC), each with the `count` of scans that had a good
    reading, their least, mean and greatest value; arrays are (n,)."""

    width: float
    starts: Array
    count: Array
    low: Array
    mean: Array
    high: Array


def trend(
    path: Path, tag: str, start: float, end: float, *, width: int | None = None, machine: str | None = None
) -> Trend:
    """The trend of a tag from `start` to `end` (s UTC), from the tier of that `width` (one of TIERS).

    Without a width it is the narrowest tier with MOST_STRETCHES at most in that time.

    Raises HistorianError, also for a file of layout 1, and ValueError for another width or a tag that it has not.
    """
    if width is None:
        width = next((one for one in TIERS if (end - start) / one <= MOST_STRETCHES), TIERS[-1])
    if width not in TIERS:
        raise ValueError(f"there is no tier of {width} s; give one of {', '.join(map(str, TIERS))}")
    with reading(path) as connection, one_moment(connection):
        whose = select_sources(connection, machine)
        found = {name: place for place, name in whose.tags(connection)}.get(tag)
        if found is None:
            raise ValueError(f"{path}: has no tag {tag!r}")
        begin = floor(start / width) * width if isfinite(start) else start
        packed = _chunks(connection, tier_kind(width), found, begin, end)
        parts = [np.array(columns, dtype=float) for _, columns in packed]
        query = "SELECT start, count, low, mean, high FROM tiers "
        query += "WHERE tag = ? AND width = ? AND start >= ? AND start < ?"
        tiers = connection.execute(query, (found, width, begin, end)).fetchall()
        parts.append(np.array(tiers, dtype=float).reshape(len(tiers), 5).T)
        # What is not packed yet is in no tier: the newest half hour or so at a scan a second.
        condition, values = whose.where("samples")
        places = ", ".join("?" * len(whose.own))
        query = f"SELECT last FROM chunks WHERE kind = 'stamps' AND tag IN ({places}) ORDER BY batch DESC LIMIT 1"  # noqa: S608
        told = connection.execute(query, whose.own).fetchone()
        # Looked for among the times that are not packed, and a minute about them, whatever the clock said before.
        query = f"SELECT min(time), max(time) FROM samples WHERE {condition}"  # noqa: S608
        lowest, highest = connection.execute(query, values).fetchone()
        since = max(start, nextafter(told[0], inf) if told else -inf, -inf if lowest is None else lowest - 60.0)
        until = min(end, -inf if highest is None else highest + 60.0)
        scans = np.sort(
            np.array([row[0] for row in _rows(connection, whose, "scans", ("time",), start=since, end=until)])
        )
        rows = _SampleReader(connection, whose).rows(found, since - 3600.0, until)
        good = np.array([number(row[1]) if row[2] in GOOD_CODES else nan for row in rows])
        parts.append(means(scans, np.array([row[0] for row in rows]), good, width))
    columns = np.hstack(parts)
    columns = merge_rows(columns[:, (columns[0] >= begin) & (columns[0] < end)])
    return Trend(width=width, **dict(zip(("starts", "count", "low", "mean", "high"), columns, strict=True)))


def parse_moment(since: str, last: float) -> float:
    """The moment (s UTC) that a date, or a span back from `last`, names. Raises ValueError for neither."""
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
