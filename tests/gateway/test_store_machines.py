"""One historian for several machines: whose rows are whose, packed or not, and where a former file's rows go."""

import gzip
import sqlite3
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from structlog.testing import capture_logs

from drivers.tag import Quality, Tag
from gateway.store import (
    Historian,
    events,
    history,
    machines,
    mature_forecasts,
    newest_scan,
    open_historian,
    reading,
    recent,
    samples,
    saved_state,
    scorecard,
    stored_rows,
    to_trace,
    trend,
)
from gateway.store.files import HistorianError
from gateway.store.schema import PACKED
from tests.gateway.support import EPOCH

TAGS = (Tag("T", "holding:1", unit="degC"), Tag("A", "holding:2"))
FOLLOWED = ("T", "U")
SCANS = 400


def prediction(moment: float, mean: float) -> tuple[Any, ...]:
    return (moment, "on", 1, mean, mean, mean - 1.0, mean + 1.0, mean, 0.5, "green")


def put_scan(historian: Historian, machine: str, number: int, offset: float) -> None:
    """A scan of a machine with two followed temperatures; its values say whose they are."""
    now, own = EPOCH + number, historian.view(machine, TAGS)
    own.put("scans", [(now, 0.01, 0)])
    own.put("samples", [(tag.name, now, offset + number + place, 0, now) for place, tag in enumerate(TAGS)])
    for place, temperature in enumerate(FOLLOWED):
        followed, mean = historian.view(machine, temperature=temperature), offset + 10.0 * place
        followed.put("predictions", [prediction(now, mean)])
        followed.put("events", [(now, f"W_{temperature}", "on")])
        followed.put("forecasts", [(now, 5.0, "[0.05, 0.5, 0.95]", f"[{mean}, {mean}, {mean}]", 0.1, 80.0, mean)])
        followed.put("writes", [(now, number, "armed", temperature, 31, 4.0, "", b"\1\2" * 24)])


def packed_until(path: Path, enough: Callable[[sqlite3.Connection], bool]) -> None:
    deadline = time.monotonic() + 120.0
    with closing(sqlite3.connect(path)) as connection:
        while not enough(connection):
            assert time.monotonic() < deadline
            time.sleep(0.02)


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three machines side by side, the third of which has come while the others ran; most of it is packed."""
    path = tmp_path_factory.mktemp("three") / "h.sqlite"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gateway.store.historian.BATCH_SECONDS", 0.02)
        for table, rows in {"samples": 200, "scans": 100, "predictions": 100, "events": 100, "writes": 100}.items():
            patch.setitem(PACKED, table, rows)  # type: ignore[misc]
        historian = open_historian(path)
        for number in range(SCANS):
            for place in range(3 if number >= SCANS // 2 else 2):
                put_scan(historian, "abc"[place], number, 1000.0 * place)
            assert number % 100 or historian.view("a").flush(60.0)
        historian.view("b").put("alarms", [(EPOCH, "over limit", "T", 1, "normal", 81.0, "")])
        assert historian.flush(60.0)
        query = "SELECT count(*) FROM samples"
        packed_until(path, lambda connection: connection.execute(query).fetchone()[0] <= 3 * 400)
        assert (historian.dropped, historian.refused, historian.complaint) == (0, 0, "")
        assert historian.close()
    return path


def test_each_machine_has_its_own_rows_packed_or_not(three: Path) -> None:
    with reading(three) as connection:
        assert machines(connection) == [(machine, list(FOLLOWED)) for machine in "abc"]
        chunked = dict(connection.execute("SELECT kind, count(DISTINCT tag) FROM chunks GROUP BY kind").fetchall())
        assert chunked["stamps"] >= 2 and chunked["predictions"] >= 4, "packed source by source"
        assert len(stored_rows(connection, "alarms", ("time",), machine="b")) == 1
        assert stored_rows(connection, "alarms", ("time",), machine="a") == []
        assert newest_scan(connection, machine="c") == EPOCH + SCANS - 1
    for place, machine in enumerate("abc"):
        first = SCANS // 2 if machine == "c" else 0
        numbers = np.arange(first, SCANS)
        trace = to_trace(three, machine=machine)
        np.testing.assert_array_equal(trace.times, EPOCH + numbers)
        np.testing.assert_array_equal(trace.signals["T"], 1000.0 * place + numbers)
        assert [sample.value for sample in samples(three, "A", machine=machine)] == (
            1000.0 * place + numbers + 1
        ).tolist()
        hours = trend(three, "T", EPOCH - 60, EPOCH + SCANS + 60, machine=machine)
        assert hours.count.sum() == numbers.size and hours.high.max() == 1000.0 * place + SCANS - 1
        assert recent(three, "1m", machine=machine).times.size == 61


def test_each_followed_temperature_has_its_own_rows(three: Path) -> None:
    for place, temperature in ((0, None), (0, "T"), (1, "U")):
        course = history(three, machine="b", temperature=temperature)
        assert course.times.size == SCANS and set(course.mean) == {1000.0 + 10.0 * place}
        assert {event.symbol for event in events(three, machine="b", temperature=temperature)} == {
            f"W_{FOLLOWED[place]}"
        }
        (horizon,) = mature_forecasts(three, machine="b", temperature=temperature).values()
        assert set(horizon.quantiles[:, 1]) == {1000.0 + 10.0 * place}
        card = scorecard(three, machine="b", temperature=temperature)
        assert (card.scans, card.samples, card.events) == (SCANS, 2 * SCANS, SCANS)
        assert card.writes.verdicts == {FOLLOWED[place]: SCANS}


def test_with_several_machines_one_has_to_be_named(three: Path) -> None:
    for read in (history, to_trace, events, mature_forecasts, scorecard, lambda path: list(samples(path))):
        with pytest.raises(HistorianError, match="several machines; name one of a, b, c"):
            read(three)
    with pytest.raises(HistorianError, match="no rows of a machine 'd'; it has those of a, b, c"):
        to_trace(three, machine="d")
    with pytest.raises(HistorianError, match="'V' is followed on no machine 'a'; followed there: T, U"):
        history(three, machine="a", temperature="V")


def test_states_are_kept_by_source_and_the_newest_scan_by_machine(tmp_path: Path) -> None:
    historian = open_historian(tmp_path / "h.sqlite")
    a, b, followed = historian.view("a"), historian.view("b"), historian.view("a", temperature="T")
    for number, view in enumerate((a, b, followed)):
        view.save("belief", EPOCH, {"of": number})
    a.put("scans", [(EPOCH, 0.0, 0)])
    b.put("scans", [(EPOCH + 7.0, 0.0, 0)])
    assert historian.flush(60.0)
    with capture_logs():
        assert [saved_state(view, "belief", None) for view in (a, b, followed)] == [  # type: ignore[arg-type]
            (EPOCH, {"of": number}) for number in range(3)
        ]
    assert (a.newest(), b.newest(), followed.newest(), historian.view("c").newest()) == (EPOCH, EPOCH + 7, EPOCH, None)
    assert historian.close()


def test_old_rows_of_each_machine_go_by_age_packed_or_not(three: Path, tmp_path: Path) -> None:
    path = tmp_path / "h.sqlite"
    path.write_bytes(three.read_bytes())
    historian = open_historian(path)
    historian.delete_older(EPOCH + SCANS - 50)
    assert historian.flush(60.0) and historian.flush(60.0)
    assert historian.close()
    for machine in "abc":
        kept = to_trace(path, machine=machine).times
        assert 50 <= kept.size <= 350 and kept[-1] == EPOCH + SCANS - 1, "chunks go whole"
    assert to_trace(path, machine="a").times.size < SCANS


# ---------------------------------------------------------------- files of layout 2


def former(path: Path) -> Path:
    """A file that the last gateway of layout 2 has written: one machine, T followed, some of it packed."""
    path.write_bytes(gzip.decompress((Path(__file__).parents[1] / "rig/layout_2.sqlite.gz").read_bytes()))
    return path


def everything(path: Path, **whose: Any) -> dict[str, Any]:
    course, machine = history(path, **whose), {key: value for key, value in whose.items() if key == "machine"}
    with reading(path) as connection:
        durable = {
            name: stored_rows(connection, name, ("time", second), **machine)
            for name, second in (("alarms", "condition"), ("audit", "who"))
        }
    return {
        "samples": [*samples(path, **machine)],
        "times": to_trace(path, **machine).times.tolist(),
        "trend": trend(path, "T", EPOCH - 60, EPOCH + 500, **machine).mean.tolist(),
        "history": (course.times.tolist(), course.mean.tolist(), course.locations),
        "matured": {horizon: one.quantiles.tolist() for horizon, one in mature_forecasts(path, **whose).items()},
        "events": events(path, **whose),
        "score": scorecard(path, **whose),
        **durable,
    }


def test_a_file_of_layout_2_goes_to_the_heir_after_a_copy_and_says_the_same(tmp_path: Path) -> None:
    path = former(tmp_path / "h.sqlite")
    before = everything(path)
    assert len(before["times"]) == 400 and before["score"].writes.verdicts == {"written": 400}
    with reading(path) as connection:
        assert machines(connection) == [("", ["T"])]
    historian = open_historian(path, heir="first")
    first, followed, second = (
        historian.view("first", TAGS),
        historian.view("first", temperature="T"),
        historian.view("second"),
    )
    assert first.load("clock") == (EPOCH + 399, {"key": "clock"}) and first.load("writers") is not None
    assert first.load("belief") is None and followed.load("belief") == (EPOCH + 399, {"key": "belief"})
    assert first.newest() == EPOCH + 399
    second.put("scans", [(EPOCH + 1000, 0.0, 0)])
    second.put("samples", [("T", EPOCH + 1000, 5.0, 0, EPOCH)])
    assert historian.close()
    assert repr(everything(path, machine="first")) == repr(before)
    assert repr(everything(path, machine="first", temperature="T")) == repr(before)
    assert repr(everything(tmp_path / "h.sqlite.layout2")) == repr(before), "the copy is whole"
    with closing(sqlite3.connect(path)) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
    with reading(path) as connection:
        assert machines(connection) == [("first", ["T"]), ("second", [])]
    assert [sample.value for sample in samples(path, machine="second")] == [5.0]


def test_a_former_file_opened_without_an_heir_waits_for_its_name(tmp_path: Path) -> None:
    path = former(tmp_path / "h.sqlite")
    before = everything(path)
    assert open_historian(path).close()
    assert repr(everything(path)) == repr(before)
    assert open_historian(path, heir="first").close()
    assert repr(everything(path, machine="first")) == repr(before)
    assert open_historian(path, heir="another").close()
    assert repr(everything(path, machine="first")) == repr(before), "it has a name by now"


def test_rows_of_a_former_file_go_to_the_temperature_that_was_followed_then(tmp_path: Path) -> None:
    path = former(tmp_path / "h.sqlite")
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("INSERT INTO runs VALUES (?, 'U', 'hash', 1.0, 5.0)", (EPOCH + 300,))
    assert open_historian(path, heir="first").close()
    with reading(path) as connection:
        assert machines(connection) == [("first", ["U", "T"])], "the one followed last is the first"
    assert history(path, temperature="T").times.tolist() == [EPOCH + n for n in range(300)]
    assert history(path).times.tolist() == [EPOCH + n for n in range(300, 400)]


def test_what_is_left_of_a_damaged_file_of_layout_2_goes_to_the_heir(tmp_path: Path) -> None:
    path = former(tmp_path / "h.sqlite")
    before = everything(path)
    with closing(sqlite3.connect(path)) as connection:
        (page,) = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = 'alarms'").fetchone()
        (size,) = connection.execute("PRAGMA page_size").fetchone()
    with path.open("r+b") as stream:
        stream.seek((page - 1) * size)
        stream.write(b"\xff" * size)
    historian = open_historian(path, mend=True, heir="first")
    assert "rows of it were recovered" in historian.note
    assert historian.close()
    assert repr({**everything(path, machine="first"), "alarms": 0}) == repr({**before, "alarms": 0})


def test_a_value_and_its_quality_stay_with_the_tag_of_their_machine(tmp_path: Path) -> None:
    """Tags of one name on two machines; rows of a tag that nobody has announced, and what is no row at all."""
    path = tmp_path / "h.sqlite"
    historian = open_historian(path)
    a, b = historian.view("a", TAGS), historian.view("b", TAGS)
    a.put("samples", [("T", EPOCH, 1.0, 0, None), ("T",), (None, EPOCH, 1.0, 0, None), ("\ud800", EPOCH, 1.0, 0, None)])
    b.put("samples", [("T", EPOCH, None, int(Quality.TIMEOUT), None), ("new", EPOCH, 2.0, 0, None)])
    assert historian.flush(60.0)
    assert (a.refused, b.refused, historian.refused) == (3, 0, 3)
    assert "was left out" in a.complaint and b.complaint == ""
    assert historian.close()
    assert [(one.tag, one.value) for one in samples(path, machine="a")] == [("T", 1.0)]
    assert [(one.tag, one.value, one.quality) for one in samples(path, machine="b")] == [
        ("T", None, Quality.TIMEOUT),
        ("new", 2.0, Quality.GOOD),
    ]
    with closing(sqlite3.connect(path)) as connection:
        assert set(connection.execute("SELECT machine, name, unit FROM tags")) == {
            ("a", "T", "degC"),
            ("b", "T", "degC"),
            ("b", "new", ""),
        }
