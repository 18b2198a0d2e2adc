"""Our own CSV is read back as it was written; fingerprints; cycles."""

import re
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from sim.lab.recordings.auto_thresholds import suitable_gap
from sim.lab.recordings.clock import longest_rising_rows, unroll_midnight
from sim.lab.recordings.column_map import load_map
from sim.lab.recordings.cycles import split_cycles
from sim.lab.recordings.load_report import TraceError
from sim.lab.recordings.trace_file import write_trace
from sim.lab.recordings.traces import load_traces
from sim.sha.events import DECANTER, Alphabet, Bins, encode
from sim.sha.trace import UNKNOWN, Trace, joint_hash
from tests.validation.places import MAPS

T = "TCuscinettiRiduttore"
MAP = load_map(MAPS / "decanter.toml")
READINGS = st.one_of(st.just(np.nan), st.floats(allow_nan=False, allow_infinity=False))
SWITCHINGS = st.sampled_from([np.nan, 0.0, 1.0])


@st.composite
def traces(draw: st.DrawFn) -> Trace:
    steps = draw(st.lists(st.sampled_from([0.0, 0.1, 1.0, 3.3, 400.0]), min_size=1, max_size=12))
    times = draw(st.sampled_from([0.0, 1_736_499_600.123])) + np.cumsum(steps)
    n = times.size
    cells = {name: st.lists(READINGS, min_size=n, max_size=n) for name in (T, "Assorbimento", "Motor Temperature")}
    cells["MarciaDecanter"] = st.lists(SWITCHINGS, min_size=n, max_size=n)
    signals = {name: np.array(draw(column)) for name, column in cells.items()}
    signals[T][0] = 20.0
    lost = np.array(draw(st.lists(st.booleans(), min_size=n, max_size=n)), dtype=bool)
    signals["Assorbimento"] = np.where(lost, np.nan, signals["Assorbimento"])
    bad = {"Assorbimento": lost} if lost.any() else {}
    return Trace("t", times, signals, bad=bad, origin="here, or there", synthetic=draw(st.booleans()))


@settings(max_examples=75, deadline=None)
@given(traces())
def test_a_trace_that_is_written_is_read_back_to_the_last_bit(trace: Trace) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "t.csv"
        write_trace(trace, path)
        (back,), report = load_traces(path, MAP)
    np.testing.assert_array_equal(back.times, trace.times)
    assert set(back.signals) == set(trace.signals)
    for name, column in trace.signals.items():
        np.testing.assert_array_equal(back.signals[name], column)
    assert {name: mask.tolist() for name, mask in back.bad.items()} == {n: m.tolist() for n, m in trace.bad.items()}
    assert (back.name, back.origin, back.synthetic) == (trace.name, trace.origin, trace.synthetic)
    # The map names no gap: it is that of the recording's own steps.
    assert back.events == encode(trace, replace(DECANTER, gap=suitable_gap([trace])))
    assert joint_hash([back]) == joint_hash([trace])
    assert report.used == trace.times.size and report.refused == 0


CELLS = st.sampled_from(["", "0", "1", "20.5", "1e3", "nan", "x", '"', "#", " 7 ", "1,5", "inf", "\x00", "1_0"])


@settings(max_examples=100, deadline=None)
@given(st.lists(st.lists(CELLS, min_size=0, max_size=5), max_size=15))
@example([["0", "", '"'], ['"', "0"]])
def test_whatever_the_rows_hold_every_one_is_used_or_refused_with_a_reason(rows: list[list[str]]) -> None:
    lines = [",".join(cells) for cells in rows]
    with TemporaryDirectory() as folder:
        path = Path(folder) / "t.csv"
        path.write_text(f"time,MarciaDecanter,Assorbimento,{T}\n" + "".join(line + "\n" for line in lines))
        try:
            loaded, report = load_traces(path, MAP)
        except TraceError as error:
            assert error.report is not None
            loaded, report = [], error.report
            assert str(path) in report.files[0].error
    file = report.files[0]
    if loaded:
        written = sum(1 for line in lines if line.strip() and not line.startswith("#"))
        # A quoted cell may go on over lines, as in the example: then a row is more than one of them.
        assert file.rows == written or ('"' in "".join(lines) and file.rows < written)
        assert file.rows == file.used + file.refused
        assert sum(file.reasons.values()) == file.refused + file.bad_cells
        assert loaded[0].times.size == file.used
        assert all(np.isfinite(column[~np.isnan(column)]).all() for column in loaded[0].signals.values())


def test_the_replay_format_is_what_it_says(tmp_path: Path) -> None:
    signals = {T: np.array([20.5, np.nan, np.nan]), "MarciaDecanter": np.array([1.0, np.nan, 0.0])}
    trace = Trace("t", np.arange(3.0), signals, bad={T: np.array([False, False, True])}, synthetic=True)
    write_trace(trace, tmp_path / "t.csv")
    assert (tmp_path / "t.csv").read_text() == (
        "# origin: t\n# SYNTHETIC: not measured on a plant\n"
        f"time,{T},MarciaDecanter\n0.0,20.5,1.0\n1.0,,\n2.0,nan,0.0\n"
    )


@pytest.mark.parametrize("name", ["", "time", "a,b", " a", 'a"', "#a", "a\nb"])
def test_a_signal_that_cannot_be_a_column_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ValueError, match="cannot be a column's name"):
        write_trace(Trace("t", np.zeros(1), {name: np.zeros(1)}), tmp_path / "t.csv")


def test_the_fingerprint_is_of_the_content_and_not_of_order_or_names() -> None:
    one = Trace("a", np.arange(3.0), {"x": np.array([1.0, np.nan, 0.0]), "y": np.zeros(3)})
    two = Trace("b", np.arange(2.0), {"x": np.ones(2)})
    assert joint_hash([one, two]) == joint_hash([replace(two, name="c"), replace(one, origin="z")])
    assert re.fullmatch("[0-9a-f]{64}", joint_hash([one]))
    others = [
        [one],
        [one, one],
        [one, replace(two, times=np.arange(2.0) + 1e-9)],
        [one, replace(two, signals={"z": np.ones(2)})],
        [replace(one, bad={"x": np.array([False, True, False])}), two],
    ]
    hashes = {joint_hash(each) for each in [[one, two], *others]}
    assert len(hashes) == len(others) + 1


@settings(max_examples=100, deadline=None)
@given(st.lists(st.integers(0, 12), min_size=1, max_size=9))
def test_no_larger_set_of_rows_leaves_a_rising_clock(values: list[int]) -> None:
    times = np.array(values, dtype=float)
    keep = longest_rising_rows(times)
    assert np.all(np.diff(times[keep]) >= 0)
    best = max(
        bin(subset).count("1")
        for subset in range(1 << len(values))
        if np.all(np.diff([v for i, v in enumerate(values) if subset >> i & 1]) >= 0)
    )
    assert keep.sum() == best


def test_midnight_is_passed_forwards_and_backwards_and_a_long_stop_is_no_midnight() -> None:
    day = 86400.0
    seconds = np.array([day - 1, 1.0, day - 0.5, 2.0, 15 * 3600.0])
    np.testing.assert_array_equal(unroll_midnight(seconds), [day - 1, day + 1, day - 0.5, day + 2, day + 15 * 3600])


def encoded(times: list[float], run: list[float], amps: list[float], **bad: list[bool]) -> Trace:
    signals = {"MarciaDecanter": np.array(run), "Assorbimento": np.array(amps)}
    trace = Trace("t", np.array(times), signals, bad={name: np.array(mask) for name, mask in bad.items()})
    return replace(trace, events=encode(trace, DECANTER))


def symbols(trace: Trace) -> list[tuple[float, str]]:
    return [(event.time, event.symbol) for event in trace.events]


def test_a_cycle_goes_from_start_to_start_and_begins_with_what_is_known() -> None:
    trace = encoded([0, 1, 2, 3, 4, 5], [0, 1, 1, 0, 1, 1], [50, 50, 150, 50, 50, 250])
    first, second = split_cycles(trace)
    assert (first.name, first.times.tolist(), second.name, second.times.tolist()) == ("t-1", [1, 2, 3], "t-2", [4, 5])
    assert symbols(first) == [(1, "W_ON"), (1, "A_0"), (2, "A_1"), (3, "W_OFF"), (3, "A_0")]
    assert symbols(second) == [(4, "W_ON"), (4, "A_0"), (5, "A_2")]
    assert [piece.times.tolist() for piece in split_cycles(trace, lead=True)] == [[0], [1, 2, 3], [4, 5]]


def test_running_on_after_unknown_is_no_new_cycle() -> None:
    nan = np.nan
    trace = encoded([0, 1, 2], [1, 1, 1], [150, nan, 150], Assorbimento=[False, True, False])
    assert [event.symbol for event in trace.events] == ["W_ON", "A_1", UNKNOWN, "W_ON", "A_1"]
    assert len(split_cycles(trace)) == 1


def test_a_gap_cuts_a_cycle_where_that_is_asked_for() -> None:
    trace = encoded([0, 1, 500, 501], [1, 1, 1, 1], [150, 150, 150, 250])
    assert len(split_cycles(trace)) == 1
    before, after = split_cycles(trace, gap=60.0)
    assert symbols(before) == [(0, "W_ON"), (0, "A_1"), (31, UNKNOWN)]
    assert symbols(after) == [(500, "W_ON"), (500, "A_1"), (501, "A_2")]


def test_cycles_lose_no_row_after_the_first_start_and_are_none_without_a_start() -> None:
    trace = encoded([float(i) for i in range(60)], [float(i // 7 % 2) for i in range(60)], [50.0] * 60)
    assert np.concatenate([piece.times for piece in split_cycles(trace)]).tolist() == list(range(7, 60))
    assert split_cycles(encoded([0, 1], [0, 0], [1, 1])) == []
    assert split_cycles(Trace("t", np.empty(0), {})) == []
    with pytest.raises(ValueError, match="no switch"):
        split_cycles(trace, Alphabet((Bins("x", (1.0,), ("a", "b")),)))
