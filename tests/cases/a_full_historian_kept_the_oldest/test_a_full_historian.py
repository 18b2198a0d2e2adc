"""At `max_mb` recording stopped with the oldest rows kept, and an alarm raised then had no row."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from drivers.tag import Tag
from gateway.store.read_back import reading, stored_rows, to_trace, trend
from tests.gateway.support import EPOCH, one_machine

TAGS = (Tag("T", "holding:1"), Tag("A", "holding:2"))
MB = 2.0
SECONDS = 60_000


def noise(seconds: int) -> Iterator[tuple[int, float, float]]:
    """(second, two values that no packing makes small)."""
    rng = np.random.default_rng(1)
    for second, pair in enumerate(rng.normal(60.0, 1.0, (seconds, 2)).tolist()):
        yield second, pair[0], pair[1]


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A historian of 2 MB that was given more than twice as much, with an alarm, a write and an entry now and then."""
    path = tmp_path_factory.mktemp("full") / "h.sqlite"
    store, historian = one_machine(path, TAGS, max_mb=MB)
    for second, first, other in noise(SECONDS):
        time = EPOCH + second
        historian.put("scans", [(time, 0.01, 0)])
        historian.put("samples", [("T", time, first, 0, time), ("A", time, other, 0, time)])
        if second % 100 == 0:
            historian.put("writes", [(time, second & 0xFFFF, "armed", "written", 31, 4.0, "", b"\1\2" * 24)])
        if second % 1000 == 0:
            historian.put("alarms", [(time, "over limit", "T", 1, "unacknowledged", first, "")])
            historian.put("audit", [(time, "entry", "Ada", "test")])
        if second % 3000 == 0:
            assert historian.flush(60.0), historian.failure
            assert historian.complaint == ""
    assert store.close()
    assert (historian.dropped, historian.refused) == (0, 0)
    return path


def test_the_newest_are_kept_within_the_size_and_the_oldest_have_gone(full: Path) -> None:
    assert full.stat().st_size <= MB * 1e6
    trace = to_trace(full)
    assert trace.times[-1] == EPOCH + SECONDS - 1 and EPOCH + 1000 < trace.times[0] < EPOCH + SECONDS - 5000
    newest = {second: (first, other) for second, first, other in noise(SECONDS)}
    seen = [(trace.signals["T"][-n], trace.signals["A"][-n]) for n in range(1, 5000)]
    assert seen == [newest[SECONDS - n] for n in range(1, 5000)], "to the last bit, packed or not"


def test_every_alarm_write_and_entry_is_there(full: Path) -> None:
    with reading(full) as connection:
        assert len(stored_rows(connection, "alarms", ("time",))) == SECONDS // 1000
        assert len(stored_rows(connection, "audit", ("time",))) == SECONDS // 1000
        assert len(stored_rows(connection, "writes", ("time",))) == SECONDS // 100


def test_the_tiers_tell_of_what_has_gone(full: Path) -> None:
    course = trend(full, "T", EPOCH, EPOCH + SECONDS, width=3600)
    values = np.array([first for _, first, _ in noise(SECONDS)])
    starts = np.floor((EPOCH + np.arange(SECONDS)) / 3600.0) * 3600.0
    expected = [values[starts == start] for start in np.unique(starts)]
    np.testing.assert_array_equal(course.starts, np.unique(starts))
    np.testing.assert_array_equal(course.count, [hour.size for hour in expected])
    np.testing.assert_array_equal(course.low, [hour.min() for hour in expected])
    np.testing.assert_array_equal(course.high, [hour.max() for hour in expected])
    np.testing.assert_allclose(course.mean, [hour.mean() for hour in expected], atol=1e-9)


def test_with_nothing_left_that_may_go_an_alarm_still_has_its_row(tmp_path: Path) -> None:
    """Full of alarms and entries, which stay, up to what measurements may take: the reserve is for the next alarm."""
    path = tmp_path / "h.sqlite"
    store, historian = one_machine(path, TAGS, max_mb=1.0)
    with pytest.raises(sqlite3.OperationalError, match="full"):
        while True:
            store._normal.execute("INSERT INTO audit VALUES (NULL, 0, ?, 'Ada', 'fill', 0)", ("x" * 2000,))
    historian.put("samples", [("T", EPOCH + n, float(n) + 0.1, 0, EPOCH) for n in range(5000)])
    assert not historian.flush(1.2) and "full" in historian.complaint
    historian.put("alarms", [(EPOCH, "over limit", "T", 1, "unacknowledged", 80.5, "")])
    assert not historian.flush(1.2), "the measurements wait"
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("SELECT value FROM alarms").fetchall() == [(80.5,)]
    assert not store.close(), "what had no place is admitted"
