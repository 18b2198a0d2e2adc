"""Following a historian: the rows of a stream in the order of their arrival, from a position that outlives packing.

A stream is one table's rows of one source. Its rows are numbered as they arrive (`schema.first_key`), and a position is
the number of the last row that is done with. Packed rows have lost their numbers, but not their order: the batches of a
source end where its rows that are not packed begin, so that a packed row's number is counted back from there. Within a
packed batch the samples of one moment stand in the order of their tags; a position is only given after a row where both
orders have had the same rows (`FollowedRow.position`).
"""

import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from math import inf, nextafter
from typing import Any

import numpy as np

from drivers.tag import Quality
from gateway.store.columns import Cell, PackedError, unpack
from gateway.store.files import HistorianError
from gateway.store.read_back import one_moment
from gateway.store.schema import FOLLOWED, NAMES, PACKED, VERSION, restore_value
from gateway.store.sqlite_file import key_bounds, key_range

FOLLOWABLE = ("samples", "predictions", "forecasts", "events", "alarms")
"""Tables whose rows can be followed."""
MAX_ROWS_PER_READ = 2_000
"""Rows that are read at a time: more of them at once would keep the interpreter's collector of garbage busy, and with
it every thread."""
MAX_ROWS_PER_SCAN = 2_000
"""Rows that one scan of a machine may bring: so many are looked at beyond the last one, to see where a moment ends."""
_SIGNAL = {"samples": "tag", "forecasts": "horizon", "alarms": "condition"}
"""The column that tells the signals of a table apart, where it has several."""


@dataclass(frozen=True, slots=True)
class RowStream:
    """The rows of `table` of a machine, or of a `temperature` followed on it; `number` is the source's."""

    machine: str
    temperature: str
    table: str
    number: int


@dataclass(frozen=True, slots=True)
class RowPosition:
    """The last row that is done with: its number in the stream (`key`, 0: none yet) and its `time` (s UTC)."""

    key: int
    time: float


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowedRow:
    """One row: `values` by the columns of its table (`schema.NAMES`), of a sample also its tag's `unit`.

    `position` is where to go on once it and all before it are done with; None within what has to stay together.
    """

    stream: RowStream
    key: int
    time: float
    values: Mapping[str, Any]
    position: RowPosition | None


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowedRows:
    """Rows of a stream after a position; `newest` is the key of the stream's last row.

    `gone` counts those before them that there are no more: deleted by retention, or in a batch that cannot be read.
    Without rows it goes on from `passed`: a table that is not packed has other sources' rows in between.
    """

    rows: Sequence[FollowedRow]
    newest: int
    gone: int
    passed: RowPosition


def row_streams(connection: sqlite3.Connection, machines: Iterable[str]) -> list[RowStream]:
    """The streams of these machines that there are so far. Raises HistorianError for a file of an older layout."""
    layout = int(connection.execute("PRAGMA user_version").fetchone()[0])
    if layout < VERSION:
        file = connection.execute("PRAGMA database_list").fetchone()[2]
        raise HistorianError(f"{file}: has layout {layout}; a gateway of this version converts it when it starts on it")
    wanted = set(machines)
    query = "SELECT id, machine, temperature FROM sources ORDER BY id"
    return [
        RowStream(machine, temperature, table, int(number))
        for number, machine, temperature in connection.execute(query)
        if machine in wanted
        for table in FOLLOWABLE
        if table in FOLLOWED or not temperature
    ]


def next_rows(connection: sqlite3.Connection, stream: RowStream, position: RowPosition) -> FollowedRows:
    """The next rows of a stream, about MAX_ROWS_PER_READ of them.

    A position that the file does not know (it was begun anew) is found again by its time. Raises sqlite3.Error.
    """
    with one_moment(connection):
        # Mostly there is nothing new, which one look-up says.
        end = newest_position(connection, stream)
        if end in (None, position) or (ends := _ends(connection, stream)) is None:
            return FollowedRows(rows=(), newest=position.key, gone=0, passed=position)
        lowest, last = ends
        newest = last if stream.table in PACKED else _own_newest(connection, stream)
        key = position.key
        if key > last or (key >= lowest and _row_time(connection, stream, key) != position.time):
            key = find_position(connection, stream, position.time).key
        begin = key + 1
        if begin >= lowest:
            unpacked = _unpacked_rows(connection, stream, begin)
            return FollowedRows(rows=unpacked, newest=newest, gone=0, passed=end or position)
        # Packed meanwhile: of the batches that reach beyond the position the oldest that can be read comes next.
        following = []
        for batch, first, rows, _ in _packed_batches(connection, stream, lowest):
            if first + rows <= begin:
                break
            following.append((batch, first))
        for batch, first in reversed(following):
            packed = _batch_rows(connection, stream, batch, first, skip=max(begin - first, 0))
            if packed:
                return FollowedRows(rows=packed, newest=newest, gone=packed[0].key - begin, passed=position)
        unpacked = _unpacked_rows(connection, stream, lowest)
        return FollowedRows(rows=unpacked, newest=newest, gone=lowest - begin, passed=end or position)


def find_position(connection: sqlite3.Connection, stream: RowStream, time: float) -> RowPosition:
    """The position after the last row that is no later than a time (s UTC). Raises sqlite3.Error."""
    with one_moment(connection):
        ends = _ends(connection, stream)
        if ends is None:
            return RowPosition(0, time)
        lowest, _ = ends
        condition, values = _mine(stream)
        query = f"SELECT max(t.id) FROM {stream.table} t WHERE {condition} AND t.time <= ?"  # noqa: S608
        (found,) = connection.execute(query, (*values, time)).fetchone()
        if found is not None:
            key = int(found) - _base(stream)
            return RowPosition(key, _row_time(connection, stream, key))
        for batch, first, _, earliest in _packed_batches(connection, stream, lowest):
            if earliest <= time:
                packed = _batch_rows(connection, stream, batch, first, most=PACKED[stream.table])
                before = [row for row in packed if row.time <= time]
                if before:
                    return RowPosition(before[-1].key, before[-1].time)
            lowest = first
        return RowPosition(lowest - 1, -inf)


def newest_rows(connection: sqlite3.Connection, stream: RowStream) -> tuple[list[FollowedRow], int]:
    """The newest row of each signal of a stream, and the key of its last row (0: it has none). Raises sqlite3.Error.

    A sample that does not change is stored again so often that its newest row is never a packed one.
    """
    with one_moment(connection):
        ends = _ends(connection, stream)
        if ends is None:
            return [], 0
        condition, values = _mine(stream)
        signal = _SIGNAL.get(stream.table)
        group = f" GROUP BY t.{signal}" if signal else ""
        newest = f"SELECT max(t.id) FROM {stream.table} t WHERE {condition}{group}"  # noqa: S608
        return _selected_rows(connection, stream, f"t.id IN ({newest}) ORDER BY t.id", values), ends[1]


def select_rows(
    connection: sqlite3.Connection, machines: Iterable[str], table: str, start: float, end: float
) -> Iterator[FollowedRow]:
    """The rows of a table with start <= time < end, machine by machine in the order of their arrival.

    Read batch by batch: of years of rows no more than some ten thousand are held. Raises HistorianError.
    """
    for stream in row_streams(connection, machines):
        if stream.table != table:
            continue
        position = find_position(connection, stream, nextafter(start, -inf))
        while (batch := next_rows(connection, stream, position)).rows:
            yield from (row for row in batch.rows if start <= row.time < end)
            position = batch.rows[-1].position or position


# -------------------------------------------------------------------- where the rows of a stream lie


def _base(stream: RowStream) -> int:
    """What is taken from a stored id to number the rows of a stream from 1."""
    return key_range(stream.number)[0] if stream.table in PACKED else 0


def _mine(stream: RowStream) -> tuple[str, tuple[int, ...]]:
    """The condition on `t` for the rows of a stream that are not packed, and its values."""
    if stream.table in PACKED:
        return "t.id BETWEEN ? AND ?", key_range(stream.number)
    return "t.source = ?", (stream.number,)


def _ends(connection: sqlite3.Connection, stream: RowStream) -> tuple[int, int] | None:
    """The numbers of the oldest and the newest row that is not packed; None without any.

    A table that is never packed begins with 1 and has other sources' rows in between.
    """
    if stream.table in PACKED:
        keys = key_bounds(connection, stream.table, stream.number)
        return None if keys is None else (keys[0] - _base(stream), keys[1] - _base(stream))
    end = newest_position(connection, stream)
    return None if end is None else (1, end.key)


def _own_newest(connection: sqlite3.Connection, stream: RowStream) -> int:
    """The number of the stream's own last row in a table that is never packed; 0 without any."""
    condition, values = _mine(stream)
    query = f"SELECT t.id FROM {stream.table} t WHERE {condition} ORDER BY t.id DESC LIMIT 1"  # noqa: S608
    row = connection.execute(query, values).fetchone()
    return 0 if row is None else int(row[0]) - _base(stream)


def newest_position(connection: sqlite3.Connection, stream: RowStream) -> RowPosition | None:
    """The last row of a stream that is not packed, of a table that never is the last of all sources; None without."""
    condition, values = _mine(stream) if stream.table in PACKED else ("1", ())
    query = f"SELECT t.id, t.time FROM {stream.table} t WHERE {condition} ORDER BY t.id DESC LIMIT 1"  # noqa: S608
    row = connection.execute(query, values).fetchone()
    return None if row is None else RowPosition(int(row[0]) - _base(stream), float(row[1]))


def _row_time(connection: sqlite3.Connection, stream: RowStream, key: int) -> float:
    query = f"SELECT time FROM {stream.table} WHERE id = ?"  # noqa: S608
    row = connection.execute(query, (key + _base(stream),)).fetchone()
    return -inf if row is None else float(row[0])


def _packed_batches(
    connection: sqlite3.Connection, stream: RowStream, lowest: int
) -> Iterator[tuple[int, int, int, float]]:
    """(batch, number of its first row, rows, least time) of the packed batches of a stream, the newest first.

    The newest ends before `lowest`, the oldest row that is not packed.
    """
    if stream.table not in PACKED:
        return
    kind = "stamps" if stream.table == "samples" else stream.table
    query = "SELECT batch, rows, first FROM chunks WHERE kind = ? AND tag = ? ORDER BY batch DESC"
    for batch, rows, earliest in connection.execute(query, (kind, stream.number)).fetchall():
        if stream.table == "samples":  # its chunks are those of its tags
            query = "SELECT sum(rows) FROM chunks WHERE batch = ? AND kind = 'samples'"
            (rows,) = connection.execute(query, (batch,)).fetchone()
        lowest -= int(rows or 0)
        yield int(batch), lowest, int(rows or 0), float(earliest)


# -------------------------------------------------------------------- reading them


def _selected_rows(
    connection: sqlite3.Connection, stream: RowStream, condition: str, values: Sequence[int]
) -> list[FollowedRow]:
    """The rows of a stream that are not packed, under a condition on `t`."""
    names, base = NAMES[stream.table], _base(stream)
    if stream.table == "samples":
        query = "SELECT t.id, tags.name, t.time, t.value, t.quality, t.sent, tags.unit FROM samples t "
        query += f"JOIN tags ON tags.id = t.tag WHERE {condition}"
        names = (*names, "unit")
    else:
        query = f"SELECT t.id, {', '.join(f't.{name}' for name in names)} FROM {stream.table} t WHERE {condition}"  # noqa: S608
    plain = [name.strip('"') for name in names]
    stored = connection.execute(query, values).fetchall()
    return _make_rows(stream, [(int(key) - base, dict(zip(plain, row, strict=True))) for key, *row in stored])


def _unpacked_rows(connection: sqlite3.Connection, stream: RowStream, begin: int) -> list[FollowedRow]:
    """The rows from the number `begin` on, to the last position among the first MAX_ROWS_PER_READ."""
    condition, values = _mine(stream)
    condition += f" AND t.id >= ? ORDER BY t.id LIMIT {MAX_ROWS_PER_READ + MAX_ROWS_PER_SCAN}"
    rows = _selected_rows(connection, stream, condition, (*values, begin + _base(stream)))
    if len(rows) < MAX_ROWS_PER_READ + MAX_ROWS_PER_SCAN:
        return rows
    end = next((place for place in range(MAX_ROWS_PER_READ, 0, -1) if rows[place - 1].position), MAX_ROWS_PER_READ)
    return rows[:end]


def _batch_rows(
    connection: sqlite3.Connection,
    stream: RowStream,
    batch: int,
    first: int,
    *,
    skip: int = 0,
    most: int = MAX_ROWS_PER_READ,
) -> list[FollowedRow]:
    """The rows of one packed batch, whose first has the number `first`, after `skip` of them; none that cannot be
    read."""
    query = "SELECT chunks.kind, chunks.data, tags.name, tags.unit FROM chunks "
    query += "LEFT JOIN tags ON chunks.kind = 'samples' AND tags.id = chunks.tag WHERE batch = ? ORDER BY chunks.tag"
    try:
        chunks = [(kind, unpack(data), *tag) for kind, data, *tag in connection.execute(query, (batch,))]
    except PackedError:
        return []
    found: list[dict[str, Any]]
    if stream.table == "samples":
        stamps: list[list[Cell]] = next((columns for kind, columns, *_ in chunks if kind == "stamps"), [[], []])
        own = [(columns, tag, unit) for kind, columns, tag, unit in chunks if kind == "samples"]
        # By their moments, which are numbered as they came; within one by tag and then as they came.
        moments = np.concatenate([np.array(columns[0], dtype=int) for columns, *_ in own] or [np.empty(0, dtype=int)])
        begins = np.cumsum([0, *(len(columns[0]) for columns, *_ in own)])
        found = []
        for place in np.argsort(moments, kind="stable")[skip : skip + most].tolist():
            which = int(np.searchsorted(begins, place, side="right")) - 1
            (_, values, qualities), tag, unit = own[which]
            row, moment = place - int(begins[which]), int(moments[place])
            time, sent = stamps[0][moment], stamps[1][moment]
            read = {"value": values[row], "quality": qualities[row]}
            found.append({"tag": tag, "time": time, **read, "sent": sent, "unit": unit})
    else:
        plain = [name.strip('"') for name in NAMES[stream.table]]
        rows = zip(*(chunks[0][1] if chunks else []), strict=True)
        found = [dict(zip(plain, row, strict=True)) for row in islice(rows, skip, skip + most)]
    return _make_rows(stream, list(enumerate(found, first + skip)), packed=True)


def _make_rows(
    stream: RowStream, found: Sequence[tuple[int, dict[str, Any]]], *, packed: bool = False
) -> list[FollowedRow]:
    """Rows with the positions after them: none between two readings of one moment, which packing puts side by side."""
    together = stream.table == "samples" and not packed
    last = {(v["time"], v["sent"]): place for place, (_, v) in enumerate(found)} if together else {}
    rows, open_until = [], -1
    for place, (key, values) in enumerate(found):
        time = float(values["time"])
        if together:
            open_until = max(open_until, last[values["time"], values["sent"]])
        if stream.table == "samples":
            values["value"], values["quality"] = restore_value(values["value"]), Quality(values["quality"])
        position = RowPosition(key, time) if place >= open_until else None
        rows.append(FollowedRow(stream=stream, key=key, time=time, values=values, position=position))
    return rows
