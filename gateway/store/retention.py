"""What becomes of rows as they grow old: packed as columns, told of by means, and at last deleted, the oldest first.

All of it is done by the historian's thread between two batches, in steps that are each one transaction, so that no
alarm waits long and a kill at any moment loses nothing. What is oldest is told by the order of arrival, which no clock
can turn round; only deletion by age asks for times.

Rows are packed source by source: of machines that run side by side each has chunks as long as it would have alone.
"""

import sqlite3
from collections.abc import Mapping, Sequence
from math import inf, nextafter

import numpy as np

from drivers.tag import Quality
from gateway.store.columns import Cell, pack, unpack
from gateway.store.schema import MEASURED, NAMES, PACKED, first_key, number
from gateway.store.sqlite_file import concerns_file, is_damage, key_range, source_numbers, transaction
from sim.sha import Array

TIERS = (60, 3600)
"""The widths (s) of the tiers."""
STRETCHES_PER_CHUNK = 1440
"""Stretches of a tier that are packed together: of the minutes a day, of the hours sixty."""
ROWS_PER_DELETION = 5_000
"""Rows that are deleted in one transaction."""
ROUNDED: Mapping[str, Mapping[str, int]] = {
    "scans": {"duration": 6},
    "predictions": {"mean": 4, "low": 4, "high": 4, "free_run": 4, "anomaly": 4},
    "writes": {"latency_ms": 3},
}
"""Decimals that are kept of what was computed, once it is packed: a thousandth of what a sensor resolves, and half the
room. What was measured is kept to the last bit."""

_UPSERT = """INSERT INTO tiers VALUES (?, ?, ?, ?, ?, ?, ?) ON CONFLICT DO UPDATE SET
    mean = mean * (1.0 * count / (count + excluded.count))
        + excluded.mean * (1.0 * excluded.count / (count + excluded.count)),
    count = count + excluded.count, low = min(low, excluded.low), high = max(high, excluded.high)"""


def _next_batch(connection: sqlite3.Connection) -> int:
    return 1 + int(connection.execute("SELECT coalesce(max(batch), 0) FROM chunks").fetchone()[0])


def _put_chunk(
    connection: sqlite3.Connection, key: tuple[str, int, int], times: Sequence[float], columns: Sequence[Sequence[Cell]]
) -> None:
    """Store columns as the chunk of a (kind, tag, batch)."""
    connection.execute(
        "INSERT INTO chunks (kind, tag, batch, first, last, rows, data) VALUES (?, ?, ?, ?, ?, ?, ?)",
        (*key, min(times), max(times), len(times), pack(columns)),
    )


class Packer:
    """Packs the oldest rows of tables; remembers of each tag what stood when its source's last batch ended."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection
        self._standing: dict[int, tuple[float, float]] = {}
        self._aggregated_until: dict[int, float] = {}
        self._begun: dict[int, list[float]] = {}
        self._ended: list[tuple[int, int, float]] = []

    def step(self, table: str, waiting: Mapping[int, int]) -> int | None:
        """Pack one batch of a table, of a source that has enough rows for one; gives it, None if there is none.

        `waiting` has the number of rows of each source, or more.
        """
        connection, most = self._connection, PACKED[table]
        for source, rows in waiting.items():
            # Sources that fill side by side are packed one after the other, and not all within one second.
            if rows >= most + most // 2 + (source % 16) * most // 32:
                break
        else:
            return None
        names, (lowest, highest) = NAMES[table], key_range(source)
        query = f"SELECT id FROM {table} WHERE id BETWEEN ? AND ? ORDER BY id LIMIT ?"  # noqa: S608
        keys = connection.execute(query, (lowest, highest, most)).fetchall()
        if len(keys) < most:
            return source  # some were deleted
        last = keys[-1][0]
        with transaction(connection):
            batch = _next_batch(connection)
            if table == "samples":
                self._samples(batch, source, last)
            else:
                query = f"SELECT {', '.join(names)} FROM {table} WHERE id BETWEEN ? AND ? ORDER BY id"  # noqa: S608
                packed = connection.execute(query, (lowest, last)).fetchall()
                columns = dict(zip(names, map(list, zip(*packed, strict=True)), strict=True))
                for name, decimals in ROUNDED.get(table, {}).items():
                    columns[name] = [None if value is None else round(value, decimals) for value in columns[name]]
                _put_chunk(connection, (table, source, batch), columns["time"], list(columns.values()))
            connection.execute(f"DELETE FROM {table} WHERE id BETWEEN ? AND ?", (lowest, last))  # noqa: S608
        return source

    def tiers(self) -> None:
        """Pack one stretch of a tier that is over; the next one waits for the next batch of measurements.

        At midnight there is one for each tag, in a file that has none packed one for each tag and day.
        """
        if self._ended:
            pack_tier(self._connection, *self._ended[-1])
            self._ended.pop()

    def _samples(self, batch: int, source: int, until: int) -> None:
        """Pack a source's samples up to the row `until`, one tag after the other: all at once are several MB."""
        # The tags of one reply share its two moments, which are the costliest numbers of all: they are stored once.
        places: dict[tuple[float, float | None], int] = {}
        span = (first_key(source), until)
        query = "SELECT time, sent FROM samples WHERE id BETWEEN ? AND ? ORDER BY id"
        for moment in self._connection.execute(query, span):
            places.setdefault(moment, len(places))
        moments = [list(column) for column in zip(*places, strict=True)]
        times: list[float] = [float(time) for time in moments[0]]
        _put_chunk(self._connection, ("stamps", source, batch), times, moments)
        # A scan bears the moment of its last reply, later than its samples: it may lie between two batches.
        first, last = min(times), max(times)
        done = self._aggregated_until.get(source)
        if done is not None and done < first:
            first = nextafter(done, inf)
        self._aggregated_until[source] = last
        scans = self._scan_times(source, first, last)
        query = "SELECT DISTINCT tag FROM samples WHERE id BETWEEN ? AND ? ORDER BY tag"
        for (tag,) in self._connection.execute(query, span).fetchall():
            query = "SELECT time, sent, value, quality FROM samples WHERE id BETWEEN ? AND ? AND tag = ? ORDER BY id"
            rows = self._connection.execute(query, (*span, tag)).fetchall()
            own, _, values, qualities = (list(column) for column in zip(*rows, strict=True))
            columns = [[places[row[:2]] for row in rows], values, qualities]
            _put_chunk(self._connection, ("samples", tag, batch), own, columns)
            self._tell(tag, scans, np.array(own), values, qualities)
        begun = [last // (width * STRETCHES_PER_CHUNK) for width in TIERS]
        if begun != self._begun.get(source):
            self._begun[source] = begun
            self._ended += [one for one in ended_tiers(self._connection, last, source) if one not in self._ended]

    def _scan_times(self, source: int, first: float, last: float) -> Array:
        """The times of the scans of a source's machine between two moments, ascending."""
        query = "SELECT id FROM sources WHERE machine = (SELECT machine FROM sources WHERE id = ?)"
        times: list[Cell] = []
        for (one,) in self._connection.execute(query, (source,)).fetchall():
            query = "SELECT data FROM chunks WHERE kind = 'scans' AND tag = ? AND last >= ? AND first <= ?"
            for (data,) in self._connection.execute(query, (one, first, last)):
                times += unpack(data)[0]
            query = "SELECT time FROM scans WHERE id BETWEEN ? AND ?"
            times += [row[0] for row in self._connection.execute(query, key_range(one))]
        found = np.sort(np.array(times, dtype=float))
        return found[(found >= first) & (found <= last)]

    def _tell(self, tag: int, scans: Array, own: Array, values: Sequence[Cell], qualities: Sequence[int]) -> None:
        """Add to the tiers of a tag what stood at each of the scans."""
        numbers = np.array(
            [
                number(value) if Quality(quality).is_good else np.nan
                for value, quality in zip(values, qualities, strict=True)
            ]
        )
        before = self._standing.get(tag)
        self._standing[tag] = (float(own[-1]), float(numbers[-1]))
        if before is not None and before[0] <= own[0]:
            own, numbers = np.append(before[0], own), np.append(before[1], numbers)
        for width in TIERS:
            rows = means(scans, own, numbers, width).T.tolist()
            self._connection.executemany(_UPSERT, [(tag, width, *row) for row in rows])


def tier_kind(width: int) -> str:
    """The kind of the chunks that hold a tier's rows: columns start, count, low, mean, high."""
    return f"tier {width}"


def ended_tiers(connection: sqlite3.Connection, now: float, source: int) -> list[tuple[int, int, float]]:
    """(tag, width, start) of every STRETCHES_PER_CHUNK that a source's machine has in `tiers` and were over at `now` (s
    UTC)."""
    ended = []
    tags = "SELECT id FROM tags WHERE machine = (SELECT machine FROM sources WHERE id = ?)"
    query = "SELECT min(start) FROM tiers WHERE tag = ? AND width = ? AND start >= ? AND start < ?"
    for (tag,) in connection.execute(tags, (source,)).fetchall():
        for width in TIERS:
            span, start = width * STRETCHES_PER_CHUNK, -inf
            over = now // span * span
            while (first := connection.execute(query, (tag, width, start, over)).fetchone()[0]) is not None:
                ended.append((tag, width, first // span * span))
                start = max(ended[-1][2] + span, nextafter(first, inf))
    return ended


def pack_tier(connection: sqlite3.Connection, tag: int, width: int, start: float) -> None:
    """Put the rows of a tier from `start` on, STRETCHES_PER_CHUNK at most, into a chunk.

    Where a clock that was set back tells of that time once more, its rows become another chunk: `merge_rows` joins
    them.
    """
    where = "FROM tiers WHERE tag = ? AND width = ? AND start >= ? AND start < ?"
    values = (tag, width, start, start + width * STRETCHES_PER_CHUNK)
    with transaction(connection):
        query = f"SELECT start, count, low, mean, high {where} ORDER BY start"
        columns = [list(column) for column in zip(*connection.execute(query, values), strict=True)]
        if columns:
            # First, for its room: a file at its largest size has none for both.
            connection.execute(f"DELETE {where}", values)
            _put_chunk(connection, (tier_kind(width), tag, _next_batch(connection)), columns[0], columns)


def means(scans: Array, times: Array, values: Array, width: float) -> Array:
    """(5, k): start, count, least, mean, greatest of every `width` s with a good reading, ascending.

    Counted are the n `scans` (n,), ascending; what stands at each of them is the newest of the samples, `values` (m,)
    at `times` (m,), NaN where there was no good one.
    """
    order = np.argsort(times, kind="stable")
    place = np.searchsorted(times[order], scans, side="right") - 1
    standing = np.where(place < 0, np.nan, values[order][place]) if times.size else np.full(scans.size, np.nan)
    known = np.isfinite(standing)
    starts, standing = np.floor(scans[known] / width) * width, standing[known]
    return merge_rows(np.array([starts, np.ones(starts.size), standing, standing, standing]))


def merge_rows(rows: Array) -> Array:
    """Rows (5, n) of start, count, least, mean, greatest, those of one start made one: (5, k), ascending."""
    starts, count, low, mean, high = rows[:, np.argsort(rows[0], kind="stable")]
    alone, begins = np.unique(starts, return_index=True)
    if alone.size == starts.size:
        return np.array([starts, count, low, mean, high])
    counts = np.add.reduceat(count, begins)
    least, most = np.minimum.reduceat(low, begins), np.maximum.reduceat(high, begins)
    # Weights and not a sum: sixty of the largest floats have a mean too. Rounding takes no mean out of its range.
    weights = count / np.repeat(counts, np.diff(np.append(begins, starts.size)))
    mean = np.clip(np.add.reduceat(mean * weights, begins), least, most)
    return np.array([alone, counts, least, mean, most])


def delete_step(connection: sqlite3.Connection, table: str, source: int, moment: float) -> bool:
    """Delete one step of what a source has in a table, or its chunks, from before a `moment` (s UTC).

    False if there is none. Only what arrived first goes, up to the first row that is younger: rows of yesterday that
    bear the time of a clock which had lost it, 1970, are not old.
    """
    # Samples lie in chunks of their tags; which batches are this source's, and how old, its stamps say.
    values = {"kind": "stamps" if table == "samples" else table, "source": source, "moment": moment}
    values |= dict(zip(("lowest", "highest"), key_range(source), strict=True)) | {"none": (1 << 63) - 1}
    own = "FROM chunks WHERE kind = :kind AND tag = :source"
    young = f"SELECT min(batch) {own} AND last >= :moment"
    batches = f"SELECT batch {own} AND batch < coalesce(({young}), :none) ORDER BY batch LIMIT 5"
    young = f"SELECT min(id) FROM {table} WHERE id BETWEEN :lowest AND :highest AND time >= :moment"  # noqa: S608
    rows = (
        f"SELECT id FROM {table} WHERE id BETWEEN :lowest AND :highest AND id < coalesce(({young}), :none) "  # noqa: S608
        f"ORDER BY id LIMIT {ROWS_PER_DELETION}"
    )
    with transaction(connection):
        gone = connection.execute(f"DELETE FROM chunks WHERE batch IN ({batches})", values).rowcount  # noqa: S608
        # Packed rows are older than those that are not.
        if not connection.execute(f"SELECT 1 {own} LIMIT 1", values).fetchone():
            gone += connection.execute(f"DELETE FROM {table} WHERE id IN ({rows})", values).rowcount  # noqa: S608
    return gone > 0


def release_pages(connection: sqlite3.Connection) -> None:
    """Give freed pages back to the system, 4 MB at most: each one moved is written again."""
    connection.execute("PRAGMA incremental_vacuum(4000)").fetchall()


def pages(connection: sqlite3.Connection) -> tuple[int, int]:
    """(the pages of the file, those of them that are free)."""
    total, free = (connection.execute(f"PRAGMA {name}").fetchone()[0] for name in ("page_count", "freelist_count"))
    return int(total), int(free)


def make_room(connection: sqlite3.Connection, wanted: int) -> bool:
    """Delete the oldest until so many pages are free; False where there is nothing left that may go.

    Measurements go first, then the tiers, the narrow ones before the wide, last the writes. Alarms, audit record and
    runs stay.
    """
    ranges = [key_range(source) for source in source_numbers(connection)]
    # A little of each source in turn: none gives all that it has for the others.
    rows = {
        table: [
            f"DELETE FROM {table} WHERE id IN (SELECT id FROM {table} WHERE id BETWEEN {lowest} AND {highest} "  # noqa: S608
            f"ORDER BY id LIMIT {ROWS_PER_DELETION // 10})"
            for lowest, highest in ranges
        ]
        for table in (*MEASURED, "writes")
    }
    tiers = {
        width: [
            f"DELETE FROM tiers WHERE width = {width} AND start < (SELECT min(start) + {500 * width} FROM tiers "  # noqa: S608
            f"WHERE width = {width})"
        ]
        for width in TIERS
    }
    # What is packed of each is older than its rows.
    order = [
        ((*MEASURED, "stamps"), [rows[table] for table in MEASURED]),
        *(((tier_kind(width),), [tiers[width]]) for width in TIERS),
        (("writes",), [rows["writes"]]),
    ]
    for kinds, tables in order:
        _delete_chunks(connection, kinds, wanted)
        for statements in tables:
            while pages(connection)[1] < wanted and sum(_delete_rows(connection, one) for one in statements) > 0:
                pass
    return pages(connection)[1] >= wanted


def _delete_chunks(connection: sqlite3.Connection, kinds: Sequence[str], wanted: int) -> None:
    """Delete the oldest chunks of some kinds until enough pages are free, or some thousand of them have gone.

    Which they are an index knows: one that lies on a bad page is passed over, and costs no other.
    """
    marks = ", ".join(f"'{kind}'" for kind in kinds)
    query = f"SELECT rowid FROM chunks INDEXED BY chunks_by_batch WHERE kind IN ({marks}) ORDER BY batch LIMIT 4000"  # noqa: S608
    try:
        oldest = connection.execute(query).fetchall()
    except sqlite3.DatabaseError as error:
        if concerns_file(error):
            raise
        return
    for (place,) in oldest:
        if pages(connection)[1] >= wanted:
            return
        _delete_rows(connection, f"DELETE FROM chunks WHERE rowid = {place}")  # noqa: S608


def _delete_rows(connection: sqlite3.Connection, statement: str) -> int:
    """The rows that a statement deletes in a transaction of its own: none where a bad page is in the way."""
    try:
        with transaction(connection):
            return connection.execute(statement).rowcount
    except sqlite3.DatabaseError as error:
        if concerns_file(error) and not is_damage(error):
            raise
        return 0
