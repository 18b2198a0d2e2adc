"""What is stored comes back as it was: columns that were packed, files of an older layout."""

import sqlite3
import time
from collections import Counter
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.tag import Quality, Tag
from gateway.store.columns import Cell, PackedError, pack, unpack
from gateway.store.files import HistorianError
from gateway.store.historian import open_historian
from gateway.store.read_back import events, history, mature_forecasts, reading, samples, stored_rows, to_trace, trend
from gateway.store.score import scorecard
from tests.gateway.support import EPOCH, one_machine
from tests.rig.layout_1 import FormerStore

TAGS = (Tag("T", "holding:1"), Tag("A", "holding:2"), Tag("Text", "holding:3"))

whole = st.integers(-(1 << 63), (1 << 63) - 1)
number = st.floats(allow_nan=False)
cells = st.one_of(st.none(), whole, number, st.text(), st.binary())
columns = st.one_of(
    st.lists(cells, max_size=30),
    st.lists(st.one_of(st.none(), whole)),
    st.lists(number),
    st.lists(st.one_of(st.none(), st.integers(-5000, 5000).map(lambda steps: steps * 0.1))),
    st.lists(st.one_of(st.none(), st.floats(width=32, allow_nan=False))),
    st.lists(st.binary(min_size=6, max_size=6)),
)


@settings(max_examples=300, deadline=None)
@given(columns)
def test_a_packed_column_comes_back_to_the_last_bit(column: list[Cell]) -> None:
    (back,) = unpack(pack([column]))
    assert [(type(cell), repr(cell)) for cell in back] == [(type(cell), repr(cell)) for cell in column]


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=300))
def test_bytes_that_are_no_packed_table_are_refused(data: bytes) -> None:
    with pytest.raises(PackedError):
        unpack(data)


def test_a_signal_takes_the_bytes_of_its_noise() -> None:
    """Bytes a row: a register's grid, a float32, a clock's ticks, a value that stands."""
    rng = np.random.default_rng(0)
    made = {
        "grid": ((1500 + rng.integers(0, 20, 2000)) * 0.1).tolist(),
        "float32": np.float32(60 + rng.normal(0, 0.05, 2000)).astype(float).tolist(),
        "clock": (EPOCH + np.arange(2000) + rng.normal(0, 1e-4, 2000)).tolist(),
        "standing": [25.0] * 2000,
    }
    taken = {name: len(pack([column])) / 2000 for name, column in made.items()}
    assert taken["grid"] < 1.0 and taken["float32"] < 2.5 and taken["clock"] < 2.0 and taken["standing"] < 0.1


def former_file(path: Path, seconds: int = 200) -> None:
    """A file of layout 1 with rows of every table, and an event and its alarm in one and the same moment."""
    store = FormerStore(path, ["T", "A", "Text"])
    n, times = store.numbers, [EPOCH + second for second in range(seconds)]
    store.commit(
        {
            "runs": [(EPOCH, "T", "hash", 1.0, 5.0)],
            "scans": [(time, 0.01, 0) for time in times],
            "samples": [
                *((n["T"], time, 20.0 + index * 0.1, 0, time - 0.01) for index, time in enumerate(times)),
                *((n["A"], time, None, int(Quality.TIMEOUT), None) for time in times[::5]),
                (n["Text"], EPOCH, "running", 0, EPOCH),
            ],
            "predictions": [(t, "on", 1, 20.0, 20.1, 19.0, 21.0, 20.2, 0.5, "green") for t in times],
            "forecasts": [
                (time, 60.0, "[0.05, 0.5, 0.95]", "[19.0, 20.0, 21.0]", 0.1, 80.0, 20.0) for time in times[::10]
            ],
            "events": [(EPOCH + 3, "W_ON", "on"), (EPOCH + 3, "A_1", "on"), (EPOCH + 9, "W_OFF", "off")],
            "alarms": [(EPOCH + 3, "over limit", "T", 1, "unacknowledged", 81.0, "")],
            "writes": [(time, 7, "armed", "written", 31, 4.0, "", b"\1\2" * 24) for time in times],
            "audit": [(EPOCH, "armed until 5", "Ada", "test")],
            "state": [("belief", EPOCH, "{}")],
            "guards": [(EPOCH, '{"review": true}')],
        }
    )
    store.close()


def table(path: Path, query: str) -> list[tuple[object, ...]]:
    with closing(sqlite3.connect(path)) as connection:
        return connection.execute(query).fetchall()


def everything(path: Path) -> dict[str, object]:
    """All that the readers give."""
    course = history(path)
    by_horizon = mature_forecasts(path)
    return {
        "samples": [*samples(path)],
        "trace": {name: column.tolist() for name, column in to_trace(path).signals.items() if name == "T"},
        "history": (course.times.tolist(), course.mean.tolist(), course.locations),
        "matured": {horizon: one.quantiles.tolist() for horizon, one in by_horizon.items()},
        "events": events(path),
        "writes": scorecard(path).writes,
        "guards": scorecard(path).guards,
    }


def test_a_file_of_layout_1_is_converted_after_a_copy_and_says_the_same(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    former_file(path)
    before, data = everything(path), path.read_bytes()
    store, historian = one_machine(path, (*TAGS, Tag("New", "holding:9")), heir="decanter")
    assert historian.load("belief") is None and store.view("decanter", temperature="T").load("belief") == (EPOCH, {})
    assert store.close()
    assert everything(path) == before
    copy = tmp_path / "h.sqlite.layout1"
    assert everything(copy) == before
    assert table(path, "PRAGMA user_version") == [(3,)] and table(path, "PRAGMA integrity_check") == [("ok",)]
    assert table(path, "SELECT count(*) FROM alarms") == [(1,)]
    assert len(data) == copy.stat().st_size, "the copy is whole"


def test_a_conversion_that_fails_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    former_file(path)
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("CREATE TABLE former (x)")
    before = everything(path)
    with pytest.raises(HistorianError):
        open_historian(path)
    assert everything(path) == before


def test_what_is_packed_reads_as_what_was_put(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    store, historian = one_machine(path, TAGS)
    rng, seconds = np.random.default_rng(2), 16_000
    values = np.round(20.0 + np.cumsum(rng.normal(0, 0.1, seconds)), 1).tolist()
    good = (rng.random(seconds) > 0.01).tolist()
    for second in range(seconds):
        now = EPOCH + second
        value, quality = (values[second], 0) if good[second] else (None, int(Quality.TIMEOUT))
        rows = [("T", now, value, quality, now - 0.01 if good[second] else None)]
        rows += [("A", now, float(second % 2), 0, now - 0.01)]
        rows += [("Text", now, f"recipe {second}", 0, now - 0.01)] if second % 100 == 0 else []
        historian.put("samples", rows)
        historian.put("scans", [(now, 0.0123456789, 0)])
        historian.put("writes", [(now, second & 0xFFFF, "armed", "written", 31, 4.0123456, "", b"\1\2" * 24)])
        assert second % 4_000 or historian.flush(60.0)
    assert historian.flush(60.0)
    deadline = time.monotonic() + 120.0
    while len(table(path, "SELECT rowid FROM writes")) >= 3_000 and time.monotonic() < deadline:
        time.sleep(0.05)
    assert store.close() and (historian.refused, historian.dropped) == (0, 0)
    with reading(path) as connection:
        packed = dict(connection.execute("SELECT kind, sum(rows) FROM chunks GROUP BY kind").fetchall())
        assert packed["samples"] >= 20_000 and packed["scans"] >= 10_000 and packed["writes"] >= 10_000
        writes = stored_rows(connection, "writes", ("time", "sequence", "words"))
        assert writes == [(EPOCH + n, n & 0xFFFF, b"\1\2" * 24) for n in range(seconds)]
    trace = to_trace(path)
    np.testing.assert_array_equal(trace.times, EPOCH + np.arange(seconds))
    np.testing.assert_array_equal(trace.signals["T"], np.where(good, values, np.nan))
    np.testing.assert_array_equal(trace.bad["T"], ~np.array(good))
    assert Counter(sample.tag for sample in samples(path)) == {"T": seconds, "A": seconds, "Text": seconds // 100}
    begin = EPOCH + 5_000
    ten = [*samples(path, "T", begin, begin + 600.0)]
    assert [sample.time for sample in ten] == [begin + n for n in range(600)]
    minutes = trend(path, "A", EPOCH, EPOCH + seconds)
    assert minutes.count.sum() == seconds and set(minutes.low.tolist()) == {0.0} and set(minutes.high.tolist()) == {1.0}
