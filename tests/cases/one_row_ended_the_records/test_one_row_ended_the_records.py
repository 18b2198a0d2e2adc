"""One uint64 value of 2^63 or more ended the historian's thread for good: no failure, no line in the log, exit 0."""

import sqlite3
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from drivers.supervision import Supervisor
from drivers.tag import Quality, Sample, Tag
from gateway.machine.reading.scan import Scan
from gateway.machine.records import Keeper
from gateway.store.historian import Historian
from gateway.store.read_back import samples, to_trace
from tests.gateway.support import EPOCH, one_machine

TAGS = (Tag("Count", "holding:1"), Tag("T", "holding:5"))


def until(condition: Callable[[], bool], seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    assert condition()


@pytest.mark.parametrize("value", [(1 << 63) - 1, 1 << 63, (1 << 64) - 1, -(1 << 63) - 1, 10**40])
def test_a_whole_number_of_any_size_is_read_back_exactly(tmp_path: Path, value: int) -> None:
    path = tmp_path / "h.sqlite"
    store, historian = one_machine(path, TAGS)
    keeper = Keeper({tag.name: tag for tag in TAGS}, 5.0)
    scan = Scan(0, EPOCH, {"Count": Sample("Count", value, Quality.GOOD, EPOCH, EPOCH)}, 0, 0.0)
    historian.put("scans", [(EPOCH, 0.0, 0)])
    historian.put("samples", keeper.rows(scan))
    assert store.close() and (historian.refused, historian.failure) == (0, "")
    assert [sample.value for sample in samples(path)] == [value]
    assert to_trace(path).signals["Count"].tolist() == [float(value)]


BAD_ROWS: dict[str, tuple[str, tuple[Any, ...]]] = {
    "a number that SQLite does not hold": ("samples", (1, EPOCH, 1 << 64, 0, None)),
    "a lone surrogate": ("samples", (1, EPOCH, "\ud800", 0, None)),
    "an object of another kind": ("samples", (1, EPOCH, object(), 0, None)),
    "a NaN where there must be a number": ("scans", (float("nan"), 0.0, 0)),
    "too few columns": ("scans", (EPOCH,)),
    "a durable row": ("audit", (EPOCH, "what", None, "who is missing")),
    "a write": ("writes", (EPOCH, 1 << 70, "armed", "written", 0, None, "", b"")),
}


@pytest.mark.parametrize("what", BAD_ROWS)
def test_a_row_that_cannot_be_stored_costs_that_row_and_is_counted_and_said(tmp_path: Path, what: str) -> None:
    table, bad = BAD_ROWS[what]
    path = tmp_path / "h.sqlite"
    store, historian = one_machine(path, TAGS)
    historian.put("scans", [(EPOCH + n, 0.0, 0) for n in range(5)])
    historian.put("audit", [(EPOCH, "before", "Ada", "test")])
    historian.put(table, [bad])
    historian.put("audit", [(EPOCH, "after", "Ada", "test")])
    assert historian.flush(60.0)
    assert (historian.refused, historian.dropped, historian.failure) == (1, 0, "")
    assert f"a row of {table} cannot be stored" in historian.complaint
    historian.put("scans", [(EPOCH + 5, 0.0, 0)])
    assert store.close() and historian.refused == 1
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("SELECT count(*) FROM scans").fetchone() == (6,)
        assert connection.execute("SELECT what FROM audit ORDER BY id").fetchall() == [("before",), ("after",)]


def test_whatever_ends_the_thread_it_is_begun_anew_and_no_row_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, calls = Historian._store, []

    def failing(self: Historian, *args: Any) -> None:
        calls.append(args)
        if len(calls) <= 2:
            raise RuntimeError("something that nobody has thought of")
        real(self, *args)

    monkeypatch.setattr(Historian, "_store", failing)
    supervisor = Supervisor()
    store, historian = one_machine(tmp_path / "h.sqlite", TAGS, supervisor=supervisor)
    historian.put("audit", [(EPOCH, "a row", "Ada", "test")])
    until(lambda: len(calls) == 3)
    assert historian.flush(60.0)
    part = supervisor.report()["historian"]
    assert part["restarts"] == 2 and part["running"] and "nobody has thought of" in str(part["failure"])
    assert "nobody has thought of" in supervisor.complaint
    assert store.close()
    assert not supervisor.report()["historian"]["running"]
    with closing(sqlite3.connect(tmp_path / "h.sqlite")) as connection:
        assert connection.execute("SELECT count(*) FROM audit").fetchone() == (1,)
