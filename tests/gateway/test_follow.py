"""Following the historian's rows: each once and in order, packed or not, whatever happens between two looks."""

import random
import sqlite3
from collections import defaultdict
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from drivers.tag import Quality
from gateway.store import (
    Historian,
    RowPosition,
    find_position,
    newest_rows,
    next_rows,
    open_historian,
    reading,
    row_streams,
    samples,
    stored_rows,
)
from gateway.store.retention import delete_step
from gateway.store.schema import PACKED
from tests.gateway.support import EPOCH
from tests.gateway.test_notify import until

TAGS = ("A", "B", "C")


def packed(path: Path, kind: str) -> int:
    with reading(path) as connection:
        return int(connection.execute("SELECT count(*) FROM chunks WHERE kind = ?", (kind,)).fetchone()[0])


@pytest.fixture
def small_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    for table, rows in {"samples": 60, "predictions": 20, "events": 20, "scans": 20}.items():
        monkeypatch.setitem(PACKED, table, rows)  # type: ignore[arg-type]


def put_scan(store: Historian, machine: str, number: int, rng: random.Random) -> None:
    """One scan: two replies, so that the tags' moments are interleaved, and now and then no answer."""
    time, view = EPOCH + number, store.view(machine)
    replies = [(time + 0.1, time), (time + 0.2, time + 0.1)]
    rows: list[tuple[Any, ...]] = []
    for place, tag in enumerate(TAGS):
        if rng.random() < 0.1:
            rows.append((tag, time + 0.3, None, int(Quality.TIMEOUT), None))
        elif rng.random() < 0.8:
            moment, sent = replies[place % 2]
            rows.append((tag, moment, float(number) + place / 10, int(Quality.GOOD), sent))
    view.put("scans", [(time + 0.3, 0.3, 0)])
    view.put("samples", rows)
    own = store.view(machine, (), "A")
    own.put("predictions", [(time + 0.3, "on", 1, float(number), 1.0, 0.0, 2.0, 1.0, 0.0, "green")])
    if rng.random() < 0.3:
        view.put("alarms", [(time + 0.3, "over limit A", "A", 1, "unacknowledged", 81.0, "")])


class Reader:
    """Follows all streams of a file; keeps nothing between two looks but its positions."""

    def __init__(self, path: Path, machines: tuple[str, ...]) -> None:
        self.path, self.machines = path, machines
        self.positions: dict[Any, RowPosition] = {}
        self.seen: defaultdict[Any, list[tuple[int, float, Any]]] = defaultdict(list)
        self.gone = 0

    def look(self, most: int = 10**9) -> int:
        """Read on, and forget what comes after `most` rows of a stream; gives how many rows were taken."""
        taken = 0
        with reading(self.path) as connection:
            for stream in row_streams(connection, self.machines):
                found = next_rows(connection, stream, self.positions.get(stream, RowPosition(0, 0.0)))
                rows = list(found.rows)
                end = next((n for n in range(min(most, len(rows)), 0, -1) if rows[n - 1].position), 0)
                end = end or next((n for n, row in enumerate(rows, 1) if row.position), 0)
                self.gone += found.gone
                if not rows:
                    self.positions[stream] = found.passed
                for row in rows[:end]:
                    self.seen[stream].append((row.key, row.time, dict(row.values)))
                    if row.position is not None:
                        self.positions[stream] = row.position
                taken += end
        return taken


@pytest.mark.usefixtures("small_batches")
@pytest.mark.parametrize("seed", range(2))
def test_every_row_comes_once_and_in_order_while_rows_are_packed(tmp_path: Path, seed: int) -> None:
    rng, path = random.Random(seed), tmp_path / "h.sqlite"
    machines = ("one", "two")
    with_restart = rng.randrange(40, 160)
    store = open_historian(path)
    for machine in machines:
        store.view(machine)
    reader, number = Reader(path, machines), 0
    while number < 200:
        for _ in range(rng.choice((1, 3, 40))):
            number += 1
            for machine in machines:
                put_scan(store, machine, number, rng)
        assert store.flush(60.0)
        if with_restart and number > with_restart:
            store.close()
            store, with_restart = open_historian(path), 0
        if rng.random() < 0.7:
            reader.look(rng.choice((1, 7, 10**9)))
    store.close()
    while reader.look():
        pass
    assert reader.gone == 0
    assert packed(path, "samples") > 10
    for stream, rows in reader.seen.items():
        keys = [key for key, _, _ in rows]
        if stream.table != "alarms":
            assert keys == list(range(1, len(keys) + 1))
        else:
            assert keys == sorted(set(keys))
        if stream.table == "samples":
            for tag in TAGS:
                mine = [(time, v["value"], v["quality"]) for _, time, v in rows if v["tag"] == tag]
                kept = [(s.time, s.value, s.quality) for s in samples(path, tag, machine=stream.machine)]
                assert mine == kept and len(mine) > 100
        elif stream.table in ("predictions", "alarms") and stream.temperature == ("A" * (stream.table != "alarms")):
            names = ("time", "measured") if stream.table == "predictions" else ("time", "condition", "state")
            with reading(path) as connection:
                kept_rows = stored_rows(connection, stream.table, names, machine=stream.machine)
            assert [tuple(v[name] for name in names) for _, _, v in rows] == kept_rows and kept_rows


def test_the_newest_row_of_a_stream_is_its_own_where_another_machine_has_a_later_one(tmp_path: Path) -> None:
    """By it rows are told to be history: an alarm must not be, because another machine has one a moment later."""
    store = open_historian(tmp_path / "h.sqlite")
    try:
        for machine in ("one", "two", "one", "two"):
            store.view(machine).put("alarms", [(EPOCH, "over limit A", "A", 1, "unacknowledged", 81.0, "")])
            assert store.flush(60.0)
        with reading(store.path) as connection:
            for stream in row_streams(connection, ("one", "two")):
                if stream.table == "alarms":
                    found = next_rows(connection, stream, RowPosition(0, 0.0))
                    assert len(found.rows) == 2 and found.newest == found.rows[-1].key
                    after = found.rows[-1].position
                    assert after is not None and not next_rows(connection, stream, after).rows
                    assert not next_rows(connection, stream, next_rows(connection, stream, after).passed).rows
    finally:
        store.close()


@pytest.mark.usefixtures("small_batches")
def test_what_retention_took_first_is_counted_and_a_position_is_found_by_time(tmp_path: Path) -> None:
    rng, path = random.Random(1), tmp_path / "h.sqlite"
    store = open_historian(path)
    for number in range(1, 201):
        put_scan(store, "one", number, rng)
    store.flush(60.0)
    until(lambda: packed(path, "predictions"))
    store.close()
    every = Reader(path, ("one",))
    while every.look():
        pass
    (stream,) = (one for one in every.seen if one.table == "samples")
    times = [time for _, time, _ in every.seen[stream]]
    with reading(path) as connection:
        for moment in (EPOCH - 1, EPOCH + 20.0, EPOCH + 150.5, EPOCH + 199.9, EPOCH + 1e6):
            found = find_position(connection, stream, moment)
            later = next((key for key, time, _ in every.seen[stream] if time > moment), len(times) + 1)
            assert later <= found.key + 1 <= later + len(TAGS)
        newest, last = newest_rows(connection, stream)
        assert last == len(times) and sorted(row.values["tag"] for row in newest) == list(TAGS)
        # A file that was begun anew has fewer rows than the position says: it goes on by the time.
        lost = next_rows(connection, stream, RowPosition(10**6, EPOCH + 150.5))
        assert lost.rows and lost.rows[0].time > EPOCH + 150.5 - 1.0
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        damaged, *_ = connection.execute("SELECT id FROM chunks WHERE kind = 'predictions' ORDER BY batch").fetchone()
        connection.execute("UPDATE chunks SET data = x'00' WHERE id = ?", (damaged,))
        while delete_step(connection, "samples", stream.number, EPOCH + 100.0):
            pass
    again = Reader(path, ("one",))
    while again.look():
        pass
    left = len(again.seen[stream])
    assert 0 < left < len(times) and again.gone >= len(times) - left
    assert [row[1:] for row in again.seen[stream]] == [row[1:] for row in every.seen[stream]][-left:]
    (predictions,) = (one for one in again.seen if one.table == "predictions" and one.temperature)
    assert [key for key, *_ in again.seen[predictions]] == list(range(21, 201))
