"""The historian: what was committed survives a kill, what cannot be opened is said in one sentence, nothing is bent."""

import os
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.tag import Quality, Sample, Tag
from gateway.machine.reading.scan import Scan
from gateway.machine.records import Keeper
from gateway.store.historian import Historian, HistorianError, open_historian
from gateway.store.read_back import history, reading, samples, to_trace
from tests.gateway.support import EPOCH, ROOT, one_machine

TAGS = (Tag("T", "holding:1", unit="degC"), Tag("A", "holding:2", deadband=0.5))


def audit(n: int) -> tuple[float, str, str, str]:
    return (EPOCH + n, f"entry {n}", "Ada", "test")


def count(path: Path, table: str) -> int:
    with closing(sqlite3.connect(path)) as connection:
        return len(connection.execute(f"SELECT 1 FROM {table}").fetchall())  # noqa: S608


def stored(path: Path, rows: list[tuple[Sample, ...]], max_interval: float = 5.0) -> None:
    """Each row is a scan, at the time of its first sample."""
    store, historian = one_machine(path, TAGS)
    keeper = Keeper({tag.name: tag for tag in TAGS}, max_interval)
    for number, row in enumerate(rows):
        scan = Scan(number, EPOCH + number, {sample.tag: sample for sample in row}, 0, 0.01)
        historian.put("scans", [(scan.time, scan.duration, scan.missed)])
        historian.put("samples", keeper.rows(scan))
    assert store.close()


readings = st.lists(st.one_of(st.none(), st.sampled_from([20.0, 20.1, 21.5, -3.25])), min_size=1, max_size=40)


@settings(max_examples=25, deadline=None)
@given(readings)
def test_a_trace_read_back_has_every_reading_though_repeats_were_not_stored(
    tmp_path_factory: pytest.TempPathFactory, values: list[float | None]
) -> None:
    path = tmp_path_factory.mktemp("h") / "h.sqlite"
    rows = [
        (
            Sample(
                "T", value, Quality.GOOD if value is not None else Quality.TIMEOUT, EPOCH + n - 0.01, EPOCH + n - 0.02
            ),
        )
        for n, value in enumerate(values)
    ]
    stored(path, rows)
    trace = to_trace(path)
    expected = np.array([np.nan if value is None else value for value in values])
    np.testing.assert_array_equal(trace.signals["T"], expected)
    np.testing.assert_array_equal(trace.bad["T"], np.isnan(expected))
    np.testing.assert_array_equal(trace.times, EPOCH + np.arange(len(values)))


def test_repeats_are_stored_once_in_an_interval_and_a_deadband_is_only_for_the_historian(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    drift = [
        (
            Sample("T", 20.0, Quality.GOOD, EPOCH + n, EPOCH + n),
            Sample("A", 100.0 + 0.2 * n, Quality.GOOD, EPOCH + n, EPOCH + n),
        )
        for n in range(10)
    ]
    stored(path, drift)
    kept = list(samples(path))
    assert [s.time - EPOCH for s in kept if s.tag == "T"] == [0.0, 5.0]
    assert [s.value for s in kept if s.tag == "A"] == pytest.approx([100.0, 100.6, 101.2, 101.8])


numbers = st.one_of(
    st.floats(-3.0, 3.0), st.sampled_from([np.nan, np.inf, -np.inf]), st.floats(), st.integers(-(1 << 64), 1 << 64)
)
moments = st.lists(st.sampled_from([1.0, 4.0, 5.0, 3600.0]), min_size=40, max_size=40)
qualities = st.sampled_from([Quality.GOOD, Quality.GOOD, Quality.GOOD, Quality.LAST_USABLE, Quality.TIMEOUT])


@settings(max_examples=300, deadline=None)
@given(st.lists(st.tuples(numbers, qualities), min_size=1, max_size=40), moments, st.sampled_from([0.0, 0.5, 2.0]))
def test_what_a_deadband_drops_lies_within_it_of_what_is_kept(
    readings: list[tuple[float, Quality]], gaps: list[float], deadband: float
) -> None:
    """At each scan: the quality that was read, NaN where NaN was read, and nothing older than the interval."""
    keeper = Keeper({"A": Tag("A", "holding:2", deadband=deadband)}, 5.0)
    kept, now = (0.0, 0.0, -1), EPOCH
    for number, ((value, quality), gap) in enumerate(zip(readings, gaps, strict=False)):
        now += gap
        sample = Sample("A", value, quality, now, now if quality is Quality.GOOD else None)
        for _, at, stored, code, _ in keeper.rows(Scan(number, now, {"A": sample}, 0, 0.01)):
            kept = (at, int(stored) if isinstance(stored, bytes) else stored, code)
            assert repr(kept[1]) == repr(value), "what is kept is what was read"
        at, stored, code = kept
        assert code == quality and now - at < 5.0
        assert stored == value or abs(stored - value) <= deadband or (np.isnan(stored) and np.isnan(value))


def test_a_stale_value_does_not_overwrite_the_good_reading_that_it_repeats(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    good = Sample("T", 20.0, Quality.GOOD, EPOCH, EPOCH)
    held = Sample("T", 20.0, Quality.LAST_USABLE, EPOCH)
    stored(path, [(good,), (held,)])
    assert [(s.time, s.quality) for s in samples(path)] == [
        (EPOCH, Quality.GOOD),
        (EPOCH + 1, Quality.LAST_USABLE),
    ]
    assert np.isnan(to_trace(path).signals["T"][1]) and to_trace(path).bad["T"].tolist() == [False, True]


def test_what_was_flushed_is_there_for_others_while_the_gateway_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    store, historian = one_machine(path, TAGS)
    historian.put("scans", [(EPOCH + n, 0.0, 0) for n in range(5)])
    assert historian.flush(60.0)
    with reading(path) as one, reading(path) as two:
        historian.put("scans", [(EPOCH + 9, 0.0, 0)])
        assert historian.flush(60.0)
        assert [c.execute("SELECT count(*) FROM scans").fetchone()[0] for c in (one, two)] == [6, 6]
    assert store.close() and store.close(), "closing twice is allowed"


def test_a_second_gateway_on_the_same_historian_is_refused_and_the_lock_dies_with_its_owner(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    first = open_historian(path)
    with pytest.raises(HistorianError, match="another gateway is running on this historian"):
        open_historian(path)
    first.close()
    second = open_historian(path)
    second.close()


def refused(path: Path) -> str:
    with pytest.raises(HistorianError) as caught:
        open_historian(path)
    sentence = str(caught.value)
    assert sentence.startswith(str(path)) and "\n" not in sentence and "; " in sentence
    return sentence


def test_a_directory_another_file_and_a_database_of_something_else_are_refused_and_left_alone(tmp_path: Path) -> None:
    assert "is a directory" in refused(tmp_path)
    text = tmp_path / "notes.txt"
    text.write_text("these are notes, and long enough to look like a page of a database\n" * 50)
    before = text.read_bytes()
    assert "not a database" in refused(text)
    assert text.read_bytes() == before
    foreign = tmp_path / "foreign.sqlite"
    with closing(sqlite3.connect(foreign)) as connection:
        connection.execute("CREATE TABLE t (x)")
        connection.commit()
    assert "is a database of something else" in refused(foreign)


def test_a_historian_of_another_layout_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    open_historian(path).close()
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("PRAGMA user_version = 99")
    assert "has layout 99" in refused(path)


def test_a_path_below_a_file_cannot_be_made_and_one_sentence_says_so(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    assert "cannot be made" in refused(tmp_path / "file" / "h.sqlite")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_read_only_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    open_historian(path).close()
    path.chmod(0o444)
    assert "give a path that this user may write" in refused(path)


def test_a_full_disk_stops_nothing_and_what_waited_is_stored_once_there_is_room(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    store, historian = one_machine(path, TAGS, max_mb=1.0)
    row = "x" * 1000
    historian.put("audit", [(EPOCH, row, "Ada", "fill") for _ in range(2000)])
    assert not historian.flush(timeout=1.5)
    assert "full" in historian.failure and str(path) in historian.failure
    for connection in (store._normal, store._full):
        connection.execute("PRAGMA max_page_count = 100000").fetchone()
    assert historian.flush(timeout=60.0)
    assert historian.failure == ""
    assert store.close()
    assert count(path, "audit") == 2000


def test_rows_given_up_at_the_end_are_admitted(tmp_path: Path) -> None:
    store, historian = one_machine(tmp_path / "h.sqlite", TAGS, max_mb=1.0)
    historian.put("audit", [(EPOCH, "x" * 1000, "Ada", "fill") for _ in range(2000)])
    assert not store.close()


def test_a_full_queue_drops_new_measurements_and_counts_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gateway.store.historian.MAX_QUEUED_ROWS", 10)
    monkeypatch.setattr(Historian, "_commit", lambda *_args, **_keys: False)
    store, historian = one_machine(tmp_path / "h.sqlite", TAGS)
    historian.put("scans", [(EPOCH + n, 0.0, 0) for n in range(25)])
    historian.put("audit", [audit(0)])
    assert historian.dropped == 15
    assert not store.close()


def test_old_measurements_are_deleted_and_alarms_and_audit_stay(tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    store, historian = one_machine(path, TAGS)
    historian.put("scans", [(EPOCH + n, 0.0, 0) for n in range(12_000)])
    historian.put("samples", [("T", EPOCH + n, 20.0, 0, None) for n in range(12_000)])
    historian.put("events", [(EPOCH + n, "W_ON", "on") for n in range(10)])
    historian.put("audit", [audit(n) for n in range(10)])
    assert historian.flush(60.0)
    store.delete_older(EPOCH + 11_990)
    deadline = time.monotonic() + 120.0
    while (count(path, "samples") > 10 or count(path, "events")) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert store.close()
    assert {t: count(path, t) for t in ("scans", "samples", "events", "audit")} == {
        "scans": 10,
        "samples": 10,
        "events": 0,
        "audit": 10,
    }


WRITER = """
import sys
from pathlib import Path
from gateway.store.historian import open_historian
historian = open_historian(Path(sys.argv[1])).view('decanter')
first = int(sys.argv[2])
for n in range(first, first + 1_000_000):
    historian.put("scans", [(float(n), 0.0, 0)])
    if n % 20 == 0:
        historian.put("audit", [(float(n), f"entry {n}", "Ada", "test")])
        if historian.flush(60.0):
            print(n, flush=True)
"""


@pytest.mark.parametrize("round_", [0, 3])
def test_killing_the_process_corrupts_nothing_and_loses_nothing_that_was_committed(tmp_path: Path, round_: int) -> None:
    path, promised = tmp_path / "h.sqlite", -1
    for start in (0, 1_000_000):
        command = [sys.executable, "-c", WRITER, str(path), str(start)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) as process:
            assert process.stdout is not None
            for _ in range(3 + 7 * round_):
                promised = int(process.stdout.readline())
            process.send_signal(signal.SIGKILL)
            process.wait(60.0)
            promised = max([promised, *(int(line) for line in process.stdout.read().split("\n")[:-1])])
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        scans = {int(row[0]) for row in connection.execute("SELECT time FROM scans WHERE time >= 1000000")}
        entries = {int(row[0]) for row in connection.execute("SELECT time FROM audit WHERE time >= 1000000")}
    assert set(range(1_000_000, promised + 1)) <= scans
    assert set(range(1_000_000, promised + 1, 20)) <= entries


def test_reading_what_is_no_historian_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(HistorianError, match="there is no historian"):
        history(tmp_path / "h.sqlite")
    other = tmp_path / "other.txt"
    other.write_text("no database at all, but long enough to be asked\n" * 20)
    with pytest.raises(HistorianError, match=r"other\.txt: "):
        history(other)


def test_a_saved_state_comes_back_and_the_newest_one_wins(tmp_path: Path) -> None:
    store, historian = one_machine(tmp_path / "h.sqlite", TAGS)
    historian.save("belief", EPOCH, {"x": float("-inf")})
    historian.save("belief", EPOCH + 1, {"x": [1, None, "°C"]})
    assert historian.flush(60.0)
    assert historian.load("belief") == (EPOCH + 1, {"x": [1, None, "°C"]})
    assert historian.load("nothing") is None
    store.close()
