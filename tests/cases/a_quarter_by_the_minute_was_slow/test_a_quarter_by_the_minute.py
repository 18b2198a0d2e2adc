"""Ninety days by the minute were 129,600 rows to fetch: tiers are packed by tag and day once the day is over."""

import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.tag import Quality, Tag
from gateway.store.read_back import Trend, trend
from gateway.store.retention import (
    STRETCHES_PER_CHUNK,
    ended_tiers,
    make_room,
    means,
    merge_rows,
    pack_tier,
    pages,
    tier_kind,
)
from gateway.store.schema import PACKED
from tests.gateway.support import EPOCH, one_machine

TAGS = (Tag("T", "holding:1"), Tag("A", "holding:2"))
DAY = 86_400.0
MIDNIGHT = EPOCH // DAY * DAY


def counted(path: Path, where: str, *values: object) -> int:
    """The rows of a table, and of a condition."""
    with closing(sqlite3.connect(path)) as connection:
        return int(connection.execute(f"SELECT count(*) FROM {where}", values).fetchone()[0])  # noqa: S608


def same(one: Trend, other: Trend) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(astuple(one), astuple(other), strict=True))


@pytest.fixture
def by_rows(tmp_path: Path) -> Iterator[tuple[Path, sqlite3.Connection]]:
    """A file as it was before: ten days of both tiers as rows."""
    path = tmp_path / "h.sqlite"
    store, historian = one_machine(path, TAGS)
    historian.put("samples", [(tag.name, MIDNIGHT, None, int(Quality.TIMEOUT), None) for tag in TAGS])
    assert historian.flush(60.0)
    connection, rng = store._normal, np.random.default_rng(3)
    connection.execute("BEGIN")
    for (number,) in connection.execute("SELECT id FROM tags").fetchall():
        for width in (60, 3600):
            for start in np.arange(MIDNIGHT, MIDNIGHT + 10 * DAY, width).tolist():
                low, mean, high = np.sort(rng.normal(60.0, 5.0, 3)).tolist()
                row = (number, width, start, low, mean, high)
                connection.execute("INSERT INTO tiers VALUES (?, ?, ?, 60, ?, ?, ?)", row)
    connection.execute("COMMIT")
    yield path, connection
    store.close()


def test_what_is_over_is_packed_while_it_runs_and_today_stays_as_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gateway.store.historian.BATCH_SECONDS", 0.01)
    monkeypatch.setitem(PACKED, "samples", 1_000)  # type: ignore[misc]
    path, days = tmp_path / "h.sqlite", 4
    store, historian = one_machine(path, TAGS)
    minutes = MIDNIGHT + 60.0 * np.arange(days * STRETCHES_PER_CHUNK)
    values = np.random.default_rng(1).normal(60.0, 1.0, minutes.size)
    for minute, value in zip(minutes.tolist(), values.tolist(), strict=True):
        quality = int(Quality.TIMEOUT) if value > 62.0 else 0
        historian.put("samples", [(tag.name, minute, value, quality, minute) for tag in TAGS])
        historian.put("scans", [(minute, 0.01, 0)])
    assert historian.flush(60.0)
    deadline = time.monotonic() + 120.0
    today = MIDNIGHT + (days - 1) * DAY
    while counted(path, "samples") >= 1_500 or counted(path, "tiers WHERE width = 60 AND start < ?", today):
        assert time.monotonic() < deadline
        time.sleep(0.02)
    assert store.close()
    assert 0 < counted(path, "tiers WHERE width = 60") <= len(TAGS) * STRETCHES_PER_CHUNK
    assert counted(path, "chunks WHERE kind = ?", tier_kind(60)) == len(TAGS) * (days - 1)
    good = values <= 62.0
    for tag in TAGS:
        course = trend(path, tag.name, MIDNIGHT, MIDNIGHT + days * DAY, width=60)
        np.testing.assert_array_equal(course.starts, minutes[good])
        for column in (course.low, course.mean, course.high):
            np.testing.assert_array_equal(column, values[good])
        part = trend(path, tag.name, MIDNIGHT + 90_030.0, MIDNIGHT + 200_000.0, width=60)
        inside = good & (minutes >= MIDNIGHT + 90_000.0) & (minutes < MIDNIGHT + 200_000.0)
        np.testing.assert_array_equal(part.starts, minutes[inside])


def test_a_file_whose_tiers_are_rows_is_read_as_it_is_and_says_the_same_when_packed(
    by_rows: tuple[Path, sqlite3.Connection],
) -> None:
    path, connection = by_rows
    end = MIDNIGHT + 10 * DAY

    def all_of_it() -> list[Trend]:
        return [trend(path, tag.name, MIDNIGHT, end, width=width) for tag in TAGS for width in (60, 3600)]

    before = all_of_it()
    ended = ended_tiers(connection, end - 1.0, 0)
    assert len([one for one in ended if one[1] == 60]) == len(TAGS) * 9, "the day that goes on stays"
    for number, stretch in enumerate(ended):
        pack_tier(connection, *stretch)
        if number in (0, len(ended) // 2, len(ended) - 1):
            assert all(map(same, all_of_it(), before)), "to the last bit, however much of it is packed"
    assert ended_tiers(connection, end - 1.0, 0) == []


def test_a_packing_that_is_cut_short_leaves_the_rows(
    by_rows: tuple[Path, sqlite3.Connection], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, connection = by_rows
    before = trend(path, "T", MIDNIGHT, MIDNIGHT + DAY, width=60)

    def cut(columns: object) -> bytes:
        raise KeyboardInterrupt

    monkeypatch.setattr("gateway.store.retention.pack", cut)
    with pytest.raises(KeyboardInterrupt):
        pack_tier(connection, 1, 60, MIDNIGHT)
    assert same(trend(path, "T", MIDNIGHT, MIDNIGHT + DAY, width=60), before)


def test_a_day_that_is_told_again_by_a_clock_set_back_is_joined(by_rows: tuple[Path, sqlite3.Connection]) -> None:
    path, connection = by_rows
    before = trend(path, "T", MIDNIGHT, MIDNIGHT + DAY, width=60)
    for turn, packed in ((1, True), (2, True), (3, False)):
        pack_tier(connection, 1, 60, MIDNIGHT)
        rows = [(1, 60, start, 60, -turn, 0.0, 100.0 + turn) for start in before.starts.tolist()[::2]]
        connection.executemany("INSERT INTO tiers VALUES (?, ?, ?, ?, ?, ?, ?)", rows)
        if packed:
            pack_tier(connection, 1, 60, MIDNIGHT)
        after = trend(path, "T", MIDNIGHT, MIDNIGHT + DAY, width=60)
        np.testing.assert_array_equal(after.starts, before.starts)
        np.testing.assert_array_equal(after.count[::2], 60 * (turn + 1))
        np.testing.assert_array_equal((after.low[::2], after.high[::2]), ([-turn] * 720, [100.0 + turn] * 720))
        np.testing.assert_allclose(after.mean[::2], before.mean[::2] / (turn + 1))
        np.testing.assert_array_equal(after.mean[1::2], before.mean[1::2])


def test_a_full_file_gives_up_packed_minutes_before_hours(by_rows: tuple[Path, sqlite3.Connection]) -> None:
    path, connection = by_rows
    for stretch in ended_tiers(connection, MIDNIGHT + 100 * DAY, 0):
        pack_tier(connection, *stretch)
    assert make_room(connection, pages(connection)[1] + 1)
    oldest = trend(path, "A", MIDNIGHT, MIDNIGHT + 10 * DAY, width=60)
    assert counted(path, "chunks WHERE kind = ?", tier_kind(60)) == len(TAGS) * 10 - 1
    assert oldest.starts.size or trend(path, "T", MIDNIGHT, MIDNIGHT + 10 * DAY, width=60).starts.size
    while counted(path, "chunks WHERE kind = ?", tier_kind(60)):
        assert trend(path, "T", MIDNIGHT, MIDNIGHT + 10 * DAY, width=3600).starts.size == 240
        assert make_room(connection, pages(connection)[1] + 1)


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 400), st.floats(-1.7e308, 1.7e308)), min_size=1, max_size=60), st.integers(0, 60)
)
def test_parts_that_are_merged_say_what_the_whole_says(readings: list[tuple[int, float]], cut: int) -> None:
    """Also of the largest floats: a mean lies between the least and the greatest, and no part is counted twice."""
    times, values = np.array(sorted(readings), dtype=float).T
    times += np.arange(times.size) * 1e-3
    whole = means(times, times, values, 60.0)
    halves = [means(t, t, v, 60.0) for t, v in ((times[:cut], values[:cut]), (times[cut:], values[cut:]))]
    parts = merge_rows(np.hstack(halves))
    np.testing.assert_array_equal(parts[[0, 1, 2, 4]], whole[[0, 1, 2, 4]])
    assert ((parts[2] <= parts[3]) & (parts[3] <= parts[4])).all()
    scale = np.maximum(np.abs(whole[2]), np.abs(whole[4])).max()
    np.testing.assert_allclose(parts[3], whole[3], rtol=1e-12, atol=1e-12 * scale)
