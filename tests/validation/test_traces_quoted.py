"""Quoted cells: line breaks inside them are read, and a mark that is never closed costs its own row and no other."""

from pathlib import Path

import pytest

from sim.lab.recordings.column_map import ClockColumns, ColumnMap, SignalColumn
from sim.lab.recordings.load_report import LoadReport
from sim.lab.recordings.text_table import MAX_ROW_LINES
from sim.lab.recordings.traces import load_traces
from sim.sha.trace import Trace

MAP = ColumnMap(
    format="wide",
    temperature="T",
    clock=ClockColumns(column=("time",), formats=("seconds",)),
    signals={"T": SignalColumn(), "current": SignalColumn(column=("motor\ncurrent", "current"))},
)


def load(folder: Path, text: str) -> tuple[Trace, LoadReport]:
    path = folder / "t.csv"
    path.write_text(text, newline="")
    (trace,), report = load_traces(path, MAP)
    return trace, report


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_quoted_cell_with_line_breaks_is_read(tmp_path: Path, end: str) -> None:
    lines = ["time,T,note", '0,20,"belt', "", "# changed", 'by night, twice"', "10,21,", '20,22,"a "" mark"', ""]
    trace, report = load(tmp_path, end.join(lines))
    assert trace.signals["T"].tolist() == [20, 21, 22]
    assert (report.files[0].rows, report.files[0].refused) == (3, 0)


def test_a_fault_after_such_a_row_has_its_own_line(tmp_path: Path) -> None:
    trace, report = load(tmp_path, 'time,T,note\n0,20,"two\nlines"\nnever,21,\n20,22,"three\nmore\nlines"\n30,hot,\n')
    assert trace.times.tolist() == [0, 20, 30]
    assert [refused.line for refused in report.files[0].details] == [4, 8]


def test_a_header_may_have_line_breaks(tmp_path: Path) -> None:
    trace, report = load(tmp_path, 'time,T,"motor\ncurrent"\n0,20,100\nx,21,110\n10,22,120\n')
    assert trace.signals["current"].tolist() == [100, 120]
    assert [refused.line for refused in report.files[0].details] == [4]


@pytest.mark.parametrize("below", [1, 3, MAX_ROW_LINES - 1, MAX_ROW_LINES, 3 * MAX_ROW_LINES])
def test_a_mark_that_is_never_closed_costs_one_row(tmp_path: Path, below: int) -> None:
    rows = "".join(f"{time},21,fine\n" for time in range(1, below + 1))
    trace, report = load(tmp_path, f'time,T,note\n0,20,fine\n0.5,20,"open\n{rows}')
    assert trace.times.tolist() == [0, *range(1, below + 1)]
    file = report.files[0]
    assert (file.rows, file.refused) == (below + 2, 1)
    assert file.details[0].line == 3
    assert "cannot be split into cells" in file.details[0].reason


def test_open_marks_in_many_rows_cost_those_rows(tmp_path: Path) -> None:
    rows = "".join(f'{time},21,"open {time}\n' if time % 3 == 0 else f"{time},21,fine\n" for time in range(300))
    trace, report = load(tmp_path, "time,T,note\n" + rows)
    assert trace.times.tolist() == [time for time in range(300) if time % 3]
    assert report.files[0].refused == 100


def test_an_open_mark_before_a_quoted_row_swallows_neither(tmp_path: Path) -> None:
    # The next mark would close the open one, somewhere in the next row.
    trace, report = load(tmp_path, 'time,T,note\n0,20,"open\n"10","21","shut"\n20,22,fine\n')
    assert trace.times.tolist() == [10, 20]
    assert [refused.line for refused in report.files[0].details] == [2]


def test_a_quoted_cell_may_take_so_many_lines_and_no_more(tmp_path: Path) -> None:
    fits, too_long = "x\n" * (MAX_ROW_LINES - 1), "x\n" * MAX_ROW_LINES
    trace, report = load(tmp_path, f'time,T,note\n0,20,"{fits}"\n10,21,"{too_long}"\n20,22,\n')
    assert trace.times.tolist() == [0, 20]
    # The lines of the long cell stand for rows of their own then, and none of them is one.
    assert report.files[0].refused == MAX_ROW_LINES + 1
