"""The replay: the last row at or before the position, and the sentence for a file that is no trace."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.plc.program.checks import InputError
from sim.plc.program.replay import TraceReplay, TraceTable, read_trace
from tests.plc.bench import trace_file

ROWS = ["10,0,,1.5", "10.5,1,100,", "10.5,1,110,nan", "12,True,,2.5", "13,false,90,2.5"]


@pytest.fixture
def table(tmp_path: Path) -> TraceTable:
    return read_trace(trace_file(tmp_path, ROWS))


def test_an_empty_cell_holds_the_last_reading_and_none_stands_before_the_first(table: TraceTable) -> None:
    assert TraceReplay(table, since=0.0).values(0.0) == {"MarciaDecanter": 0.0, "Assorbimento": None, "TFango": 1.5}
    assert TraceReplay(table, since=0.0).values(2.2) == {"MarciaDecanter": 1.0, "Assorbimento": 110.0, "TFango": 2.5}


@given(st.floats(0, 3), st.floats(0.01, 100))
def test_the_row_is_the_last_at_or_before_the_position(moment: float, rate: float) -> None:
    table = TraceTable(Path("t"), [10, 10.5, 10.5, 12, 13], {}, 1.0)
    replay = TraceReplay(table, since=5.0, rate=rate)
    position = replay.row_position(5.0 + moment)
    row = replay.row(5.0 + moment)
    assert table.times[row] <= 10 + position
    assert row == 4 or table.times[row + 1] > 10 + position


def test_hold_seek_and_rate_keep_the_position(table: TraceTable) -> None:
    replay = TraceReplay(table, since=0.0, rate=2.0)
    held = replay.change(0.5, held=True)
    assert held.row_position(0.5) == held.row_position(99.0) == 1.0
    assert held.change(99.0, held=False, rate=0.5).row_position(101.0) == 2.0
    assert held.seek(99.0, 2.5).row_position(100.0) == 2.5
    with pytest.raises(InputError, match="outside the trace"):
        held.seek(99.0, 3.5)


def test_it_stays_at_the_end_or_begins_again_one_period_later(table: TraceTable) -> None:
    once, looping = TraceReplay(table, since=0.0), TraceReplay(table, since=0.0, loop=True)
    assert once.at_end(3.0) and once.row(1000.0) == 4
    assert not looping.at_end(1000.0)
    assert table.period == 1.0  # the median of 0.5, 1.5 and 1
    assert [looping.row(moment) for moment in (3.0, 3.9, 4.0, 4.6, 8.6)] == [4, 4, 0, 2, 2]


@pytest.mark.parametrize(
    ("header", "rows", "words"),
    [
        ("t,A", ["0,1"], ["line 2", "'t'", "'time'"]),
        ("time,A,A", ["0,1,2"], ["line 2", "occurs twice"]),
        ("time,A,", ["0,1,2"], ["line 2", "column 3", "no name"]),
        ("time,A", ["0,1", "1"], ["line 4", "1 cells for 2 columns"]),
        ("time,A", ["0,1", "1,x"], ["line 4", "'A'", "'x'", "no finite number"]),
        ("time,A", ["0,1", "1,inf"], ["line 4", "no finite number"]),
        ("time,A", ["1,1", "0,1"], ["line 4", "goes back"]),
        ("time,A", [",1"], ["line 3", "'time'", "empty"]),
        ("time,A", ['0,"1'], ["line 3", "CSV"]),
        ("time,A", [], ["no rows"]),
    ],
)
def test_a_bad_trace_is_refused_with_file_line_and_reason(
    tmp_path: Path, header: str, rows: list[str], words: list[str]
) -> None:
    path = trace_file(tmp_path, rows, header)
    with pytest.raises(InputError) as caught:
        read_trace(path)
    for word in (str(path), *words):
        assert word in str(caught.value)


def test_a_quoted_cell_with_a_line_break_is_one_row_and_lines_count_on(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text('time,"A"\n0,"\n\n1"\n1,2\n')
    assert list(read_trace(path).columns["A"]) == [1.0, 2.0]
    path.write_text('time,"A"\n0,"\n# no comment"\n')
    with pytest.raises(InputError, match=r"line 2: column 'A'"):
        read_trace(path)
    path.write_text('time,A\n0,"\n1"\n1,"2\n2,3\n')
    with pytest.raises(InputError, match=r"line 4: is not CSV"):
        read_trace(path)


def test_a_file_of_comments_has_no_header(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("# nothing\n\n")
    with pytest.raises(InputError, match="no header"):
        read_trace(tmp_path / "t.csv")
