"""A file sorted newest first lost 628 of 629 rows, with exit 0; times with and without a zone were mixed unsaid."""

import json
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from gateway.cli.main import main
from gateway.lab.traces.load import load
from sim.lab.recordings import ColumnMap, load_traces
from sim.lab.recordings.load_report import TraceError

ROWS = 629


def column_map(**more: object) -> ColumnMap:
    clock = more.pop("clock", {"column": "time", "formats": ["seconds", "ISO8601"]})
    table = {"format": "wide", "temperature": "T", "clock": clock, "signals": {"T": {}}}
    return ColumnMap.model_validate({**table, **more})


def written(folder: Path, times: list[str]) -> Path:
    path = folder / "a.csv"
    path.write_text("time,T\n" + "".join(f"{time},{row}\n" for row, time in enumerate(times)), encoding="utf-8")
    return path


@pytest.mark.parametrize("back", ["refuse", "split", "sort"])
def test_a_file_with_its_newest_row_first_is_read_from_its_end_and_says_so(tmp_path: Path, back: str) -> None:
    file = written(tmp_path, [str(ROWS - row) for row in range(ROWS)])
    (trace,), report = load_traces(file, column_map(clock_back=back))
    assert report.used == ROWS and np.array_equal(trace.signals["T"], np.arange(ROWS)[::-1])
    assert report.warnings == (f"{file}: its newest row comes first; it is read from its end",)


def test_commands_that_learn_say_it_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = written(tmp_path, [str(ROWS - row) for row in range(ROWS)])
    (tmp_path / "m.toml").write_text(
        'format = "wide"\ntemperature = "T"\n[clock]\ncolumn = "time"\nformats = "seconds"\n[signals]\nT = {}\n'
    )
    traces, _ = load([str(file)], str(tmp_path / "m.toml"))
    assert traces[0].times.size == ROWS and "newest row comes first" in capsys.readouterr().err


def test_equal_times_and_a_repeated_hour_of_autumn_keep_their_order(tmp_path: Path) -> None:
    begin = datetime(2024, 10, 27, 1, 30)  # local; the hour from 2 to 3 comes twice
    shown = [begin + timedelta(minutes=10 * row) for row in range(9)] + [
        datetime(2024, 10, 27, 2, 0) + timedelta(minutes=10 * row) for row in range(9)
    ]
    file = written(tmp_path, [time.strftime("%Y-%m-%d %H:%M:%S") for time in reversed(shown)])
    clock = {"column": "time", "timezone": "Europe/Rome"}
    (trace,), report = load_traces(file, column_map(clock=clock))
    assert report.used == 18 and np.array_equal(np.diff(trace.times), np.full(17, 600.0))


def test_a_clock_that_was_set_back_once_is_no_file_turned_round(tmp_path: Path) -> None:
    file = written(tmp_path, ["10", "11", "12", "2", "13", "14"])
    (trace,), report = load_traces(file, column_map())
    assert report.refused == 1 and not report.warnings and trace.times[0] == 10


def test_days_in_the_wrong_order_are_refused_with_what_would_read_them(tmp_path: Path) -> None:
    days = [str(86400 * day + 60 * minute) for day in (4, 3, 2, 1) for minute in range(50)]
    with pytest.raises(TraceError, match=r'150 of its 200 rows would be lost; write clock_back = "sort"'):
        load_traces(written(tmp_path, days), column_map())
    (trace,), report = load_traces(tmp_path / "a.csv", column_map(clock_back="sort"))
    assert report.used == 200 and trace.times.size == 200


def test_times_without_a_zone_among_times_with_one_are_counted_and_named(tmp_path: Path) -> None:
    times = ["2024-03-01T10:00:00Z", "2024-03-01 10:00:10", "2024-03-01T10:00:20Z"]
    _, report = load_traces(written(tmp_path, times), column_map())
    (warning,) = report.warnings
    assert "1 of its times have no time zone (the first on line 3) and 2 have one" in warning and "UTC" in warning


def test_one_reason_is_one_line_however_many_rows_it_is_of(tmp_path: Path) -> None:
    file = written(tmp_path, ["never"] * 400 + [str(row) for row in range(500)])
    done = CliRunner().invoke(main, ["trace", "show", str(file), "--map", "decanter", "--json"])
    assert done.exit_code == 2  # no gearbox temperature there: the map is another one's
    _, report = load_traces(file, column_map())
    about = [line for line in report.sentences() if "no time that the map's formats fit" in line]
    assert len(about) == 2 and "400 x" in about[0] and "and 12 more" in about[1]
    assert json.dumps(report.as_table())
