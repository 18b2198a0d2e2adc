"""Wide files: what loads, what is refused, and that nothing disappears without being counted."""

from pathlib import Path

import numpy as np
import pytest

from sim.lab.recordings.column_map import ColumnMap, load_map
from sim.lab.recordings.load_report import FileReport, LoadReport, TraceError
from sim.lab.recordings.traces import load_traces, units
from sim.sha.trace import UNKNOWN, Trace
from tests.validation.places import MAPS

T = "TCuscinettiRiduttore"
DECANTER = load_map(MAPS / "decanter.toml")
SKAB = load_map(MAPS / "skab.toml")
FEMTO = load_map(MAPS / "femto.toml")
CAROBD = load_map(MAPS / "carobd.toml")
HEAD = f"time,MarciaDecanter,Assorbimento,{T}\n"


def load(path: Path, column_map: ColumnMap, content: str | bytes | None = None) -> tuple[Trace, FileReport]:
    """The only trace of the only file."""
    if content is not None:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    traces, report = load_traces(path, column_map)
    assert len(traces) == len(report.files) == 1
    one = report.files[0]
    assert one.rows == one.used + one.aside + one.refused
    return traces[0], one


def refusal(path: Path, column_map: ColumnMap, content: str | bytes) -> str:
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(TraceError) as caught:
        load_traces(path, column_map)
    assert isinstance(caught.value.report, LoadReport)
    assert str(path) in str(caught.value)
    return str(caught.value)


def test_our_own_csv_loads_with_its_comments_and_events(tmp_path: Path) -> None:
    text = f"# origin: cd1, seed 3\n# SYNTHETIC: not measured on a plant\n{HEAD}0,0,3.5,20.5\n1,1,150,20.6\n2,,,20.7\n"
    trace, report = load(tmp_path / "cd1.csv", DECANTER, text)
    assert (trace.name, trace.origin, trace.synthetic) == ("cd1", "cd1, seed 3", True)
    assert trace.times.tolist() == [0.0, 1.0, 2.0]
    assert trace.signals[T].tolist() == [20.5, 20.6, 20.7]
    assert np.isnan(trace.signals["MarciaDecanter"][2])
    assert [(e.time, e.symbol) for e in trace.events] == [(0, "W_OFF"), (0, "A_0"), (1, "W_ON"), (1, "A_1")]
    assert (report.rows, report.used, report.bad_cells) == (3, 3, 0)


def test_a_cell_that_is_no_number_is_bad_quality_named_and_unknown_to_the_encoder(tmp_path: Path) -> None:
    text = HEAD + "0,1,150,20\n1,1,#ERR,20\n2,1,nan,20\n3,maybe,150,20\n"
    trace, report = load(tmp_path / "a.csv", DECANTER, text)
    assert trace.bad["Assorbimento"].tolist() == [False, True, True, False]
    assert trace.bad["MarciaDecanter"].tolist() == [False, False, False, True]
    assert report.reasons == {"Assorbimento is no number": 2, "MarciaDecanter is neither true nor false": 1}
    assert (report.details[1].line, report.details[1].reason) == (3, "Assorbimento is no number: '#ERR'")
    assert [e.symbol for e in trace.events].count(UNKNOWN) == 2


def test_rows_that_cannot_be_used_are_counted_with_line_and_reason(tmp_path: Path) -> None:
    text = HEAD + '0,1,150,20\n\n1,1,150\n,1,150,20\nlater,1,150,20\n2,"1,150,20\n' + HEAD + "3,1,150,20,,\n4,1,1,2,7\n"
    trace, report = load(tmp_path / "a.csv", DECANTER, text)
    assert trace.times.tolist() == [0.0, 3.0]
    assert (report.rows, report.used, report.refused) == (8, 2, 6)
    assert [detail.line for detail in sorted(report.details, key=lambda one: one.line)] == [4, 5, 6, 7, 8, 10]
    assert report.reasons == {
        "it has another number of cells than the header": 2,
        "it has no time that the map's formats fit": 2,
        "it cannot be split into cells": 1,
        "it is the header again": 1,
    }
    assert any("line 4: it has another number of cells than the header: 3, not 4" in s for s in report.sentences())


def test_details_are_bounded_and_counts_exact(tmp_path: Path) -> None:
    text = HEAD + "0,1,150,20\n" + "x,1,150,20\n" * 5000
    _, report = load(tmp_path / "a.csv", DECANTER, text)
    assert (report.refused, len(report.details)) == (5000, 20)


@pytest.mark.parametrize(
    ("encoding", "bom"),
    [("utf-8", b""), ("utf-8", b"\xef\xbb\xbf"), ("utf-16-le", b"\xff\xfe"), ("utf-16-be", b"\xfe\xff")],
)
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_byte_order_marks_and_line_ends_do_not_matter(tmp_path: Path, encoding: str, bom: bytes, end: str) -> None:
    text = (HEAD + "0,1,150,20\n1,1,150,21\n").replace("\n", end)
    trace, report = load(tmp_path / "a.csv", DECANTER, bom + text.encode(encoding))
    assert trace.signals[T].tolist() == [20.0, 21.0]
    assert report.refused == 0


def test_a_header_in_another_encoding_is_read_and_told(tmp_path: Path) -> None:
    content = (HEAD.rstrip() + ",Nota °C\n0,1,150,20,3\n").encode("cp1252")
    trace, report = load(tmp_path / "a.csv", DECANTER, content)
    assert trace.signals["Nota °C"].tolist() == [3.0]
    assert any("cp1252" in note for note in report.notes)


def test_semicolons_and_decimal_commas_are_found_by_themselves_and_told(tmp_path: Path) -> None:
    text = HEAD.replace(",", ";") + "0,5;1;150,25;20,5\n1,5; 1 ; 99 ;21\n"
    trace, report = load(tmp_path / "a.csv", DECANTER, text)
    assert trace.times.tolist() == [0.5, 1.5]
    assert trace.signals["Assorbimento"].tolist() == [150.25, 99.0]
    assert any("separator is ';'" in note for note in report.notes)


def test_commas_that_group_thousands_are_not_taken_for_decimal_commas(tmp_path: Path) -> None:
    text = f'time,{T},Coppia\n0,20,"1,250"\n1,20,12.5\n'
    trace, report = load(tmp_path / "a.csv", DECANTER, text)
    assert trace.signals["Coppia"].tolist() == [1250.0, 12.5]
    assert not report.reasons


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "the file is empty"),
        ("# only\n\n# comments\n", "nothing in it but comments"),
        (HEAD, "there is only a header"),
        (bytes(range(256)) * 40, "not a text file"),
        (b"PK\x03\x04\x14\x00\x00\x00" * 99, "not a text file"),
        ("time,Assorbimento\n0,1\n", f"there is no column '{T}'; its columns are time, Assorbimento"),
        (f"clock,{T}\n0,1\n", f"there is no column 'time'; its columns are clock, {T}"),
        ("hello world\n1\n", "its only column is 'hello world'"),
        (f"time,{T}\nnever,20\n", "none of its 1 rows can be used: it has no time"),
        (f"time,{T}\n0,\n1,\n", f"no reading of {T}"),
    ],
)
def test_a_file_that_yields_nothing_says_why(tmp_path: Path, content: str | bytes, words: str) -> None:
    assert words in refusal(tmp_path / "a.csv", DECANTER, content)


def test_one_bad_file_does_not_stop_the_others_and_both_are_in_the_report(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(HEAD + "0,1,150,20\n")
    (tmp_path / "b.csv").write_bytes(b"")
    (tmp_path / "c.CSV").write_text(HEAD + "0,1,150,20\n")
    (tmp_path / "notes.txt").write_text("no trace")
    traces, report = load_traces(tmp_path, DECANTER)
    assert [trace.name for trace in traces] == ["a", "c"]
    assert [file.path.name for file in report.files] == ["a.csv", "b.csv", "c.CSV"]
    assert len(report.errors) == 1 and "b.csv: the file is empty" in report.errors[0]
    assert [row["used"] for row in report.as_table()] == [1, 0, 1]
    assert (report.rows, report.used, report.refused) == (2, 2, 0)


def test_patterns_lists_and_folders_find_files_and_names_stay_apart(tmp_path: Path) -> None:
    for folder in ("x", "y"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "a.csv").write_text(HEAD + "0,1,150,20\n")
    by_pattern, _ = load_traces(str(tmp_path / "*" / "a.csv"), DECANTER)
    by_list, _ = load_traces([tmp_path / "x" / "a.csv", tmp_path / "y", tmp_path / "x" / "a.csv"], DECANTER)
    by_folder, _ = load_traces(tmp_path, DECANTER)
    for traces in (by_pattern, by_list, by_folder):
        assert [trace.name for trace in traces] == ["a", "y-a"]


def test_nothing_there_is_one_clear_sentence(tmp_path: Path) -> None:
    with pytest.raises(TraceError, match="there is no CSV file there"):
        load_traces(tmp_path, DECANTER)
    with pytest.raises(TraceError, match=r"missing\.csv: it cannot be read: No such file"):
        load_traces(tmp_path / "missing.csv", DECANTER)


def test_a_clock_that_stutters_loses_the_fewest_rows(tmp_path: Path) -> None:
    rows = [0, 1, 2, 9000, 3, 4, 2.5, 5]
    text = HEAD + "".join(f"{time},1,150,{20 + index}\n" for index, time in enumerate(rows))
    trace, report = load(tmp_path / "a.csv", DECANTER, text)
    assert trace.times.tolist() == [0, 1, 2, 3, 4, 5]
    assert report.reasons == {"its clock is before that of the rows around it": 2}
    assert sorted(detail.line for detail in report.details) == [5, 8]


def test_a_gap_is_left_open_and_told(tmp_path: Path) -> None:
    trace, report = load(tmp_path / "a.csv", DECANTER, HEAD + "0,1,150,20\n1000,1,150,20\n")
    assert trace.times.size == 2
    assert [e.symbol for e in trace.events] == ["W_ON", "A_1", UNKNOWN, "W_ON", "A_1"]
    assert any("1 gaps of more than 30 s" in note for note in report.notes)


def test_running_is_derived_from_the_current_only_where_the_file_does_not_say(tmp_path: Path) -> None:
    text = f"time,Assorbimento,{T}\n0,3,20\n1,5,20\n2,5.1,20\n3,,20\n4,bad,20\n"
    trace, _ = load(tmp_path / "a.csv", DECANTER, text)
    np.testing.assert_array_equal(trace.signals["MarciaDecanter"], [0, 0, 1, np.nan, np.nan])
    assert trace.bad["MarciaDecanter"].tolist() == [False] * 4 + [True]
    told, _ = load(tmp_path / "b.csv", DECANTER, HEAD + "0,0,150,20\n")
    assert told.signals["MarciaDecanter"].tolist() == [0.0]


def test_rows_of_one_time_are_averaged_booleans_and_bad_ones_not(tmp_path: Path) -> None:
    averaging = DECANTER.model_copy(update={"duplicates": "average"})
    text = HEAD + "0,0,100,20\n0,1,200,21\n0,,,bad\n1,1,bad,22\n"
    trace, report = load(tmp_path / "a.csv", averaging, text)
    assert trace.signals["Assorbimento"][0] == 150.0 and trace.signals[T].tolist() == [20.5, 22.0]
    assert trace.signals["MarciaDecanter"].tolist() == [1.0, 1.0]
    assert list(trace.bad) == ["Assorbimento"] and trace.bad["Assorbimento"].tolist() == [False, True]
    assert (report.rows, report.used, report.merged) == (4, 4, 2)


def test_rows_of_one_time_can_give_the_last_reading_of_each_signal(tmp_path: Path) -> None:
    last = DECANTER.model_copy(update={"duplicates": "last"})
    trace, _ = load(tmp_path / "a.csv", last, HEAD + "0,0,100,20\n0,1,,21\n0,,bad,\n")
    assert trace.signals["MarciaDecanter"].tolist() == [1.0] and trace.signals[T].tolist() == [21.0]
    assert trace.bad["Assorbimento"].tolist() == [True]


def test_scale_limits_and_the_devices_word_for_missing(tmp_path: Path) -> None:
    table = DECANTER.model_dump(exclude={"alphabet"})
    table["signals"]["Assorbimento"] = {
        "scale": 0.1,
        "offset": 1.0,
        "low": 0,
        "high": 350,
        "missing": [65535],
        "unit": "A",
    }
    own = ColumnMap.model_validate(table)
    trace, report = load(tmp_path / "a.csv", own, HEAD + "0,1,1500,20\n1,1,65535,20\n2,1,4000,20\n")
    np.testing.assert_array_equal(trace.signals["Assorbimento"], [151.0, np.nan, np.nan])
    assert set(report.reasons) == {
        "Assorbimento is the device's word for not available",
        "Assorbimento is outside 0..350 A",
    }
    assert units(own)["Assorbimento"] == "A"


def test_a_held_signal_holds_over_empty_cells_not_over_bad_ones_and_gaps(tmp_path: Path) -> None:
    table = DECANTER.model_dump(exclude={"alphabet"})
    table["signals"]["CicloAttivo"]["hold"] = True
    text = f"time,{T},CicloAttivo\n0,1,\n1,1,1\n2,1,\n3,1,bad\n4,1,\n5,1,0\n6,1,\n99,1,\n100,1,1\n"
    trace, _ = load(tmp_path / "a.csv", ColumnMap.model_validate(table), text)
    nan = np.nan
    np.testing.assert_array_equal(trace.signals["CicloAttivo"], [nan, 1, 1, nan, nan, 0, 0, nan, 1])


def test_iso_times_with_and_without_offset_and_summer_time(tmp_path: Path) -> None:
    table = DECANTER.model_dump(exclude={"alphabet"})
    table["clock"]["timezone"] = "Europe/Rome"
    stamps = ["2025-10-26 02:59:58", "2025-10-26 02:00:03", "2025-10-26T03:00:00", "2025-10-26T02:00:01Z"]
    text = f"time,{T}\n" + "".join(f"{stamp},20\n" for stamp in stamps)
    trace, report = load(tmp_path / "a.csv", ColumnMap.model_validate(table), text)
    start = np.datetime64("2025-10-26T00:59:58").astype(float)
    assert (trace.times - start).tolist() == [0.0, 5.0, 3602.0, 3603.0]
    assert report.refused == 0


def test_a_local_time_that_spring_skipped_is_refused(tmp_path: Path) -> None:
    table = DECANTER.model_dump(exclude={"alphabet"})
    table["clock"]["timezone"] = "Europe/Rome"
    text = f"time,{T}\n2025-03-30 01:59:59,20\n2025-03-30 02:30:00,20\n2025-03-30 03:00:00,20\n"
    trace, report = load(tmp_path / "a.csv", ColumnMap.model_validate(table), text)
    assert np.diff(trace.times).tolist() == [1.0]
    assert report.reasons == {"its local time never was in Europe/Rome": 1}


def test_a_sister_file_with_more_columns_loads_by_the_same_map(tmp_path: Path) -> None:
    text = (
        "datetime;Accelerometer1RMS;Accelerometer2RMS;Current;Pressure;Temperature;Thermocouple;Voltage;"
        "Volume Flow RateRMS;anomaly;changepoint\r\n"
        "2020-03-09 10:14:33;0.026588;0.040111;1.3302;0.054711;79.3366;26.0199;233.062;32.0;0.0;0.0\r\n"
    )
    trace, report = load(tmp_path / "0.csv", SKAB, text)
    assert trace.signals["MotorTemperature"].tolist() == [79.3366]
    assert [event.symbol for event in trace.events] == ["W_ON", "A_1"]
    assert report.notes == []


@pytest.mark.parametrize("separator", [",", ";"])
def test_raw_parts_without_header_make_one_trace_over_midnight(tmp_path: Path, separator: str) -> None:
    folder = tmp_path / "Bearing1_3"
    folder.mkdir()
    parts = ["23,59,59,8,50.5\n23,59,59,9,50.6\n", "0,0,0,0,50.7\n0,0,0,1,50.8\n"]
    for number, text in enumerate(parts, 1):
        (folder / f"temp_{number:05}.csv").write_text(text.replace(",", separator))
    (folder / "acc_00001.csv").write_text("23,59,59,8,0.1,0.2\n")
    traces, report = load_traces(folder, FEMTO)
    assert [trace.name for trace in traces] == ["Bearing1_3"]
    np.testing.assert_allclose(np.diff(traces[0].times), 0.1, atol=1e-9)
    assert traces[0].signals["BearingTemperature"].tolist() == [50.5, 50.6, 50.7, 50.8]
    assert [event.symbol for event in traces[0].events] == ["W_ON"]
    assert all("no header" in " ".join(file.notes) for file in report.files)


def test_a_file_without_header_is_not_guessed_when_its_shape_is_another(tmp_path: Path) -> None:
    words = refusal(tmp_path / "temp.csv", FEMTO, "8,4,31,59.0\n8,4,32,59.0\n")
    assert "no row of 5 numbers without header" in words


def test_a_time_of_day_that_cannot_be_is_refused(tmp_path: Path) -> None:
    text = "hour,minute,second,x0.1_second,temperature\n8,4,31,9,59\n8,64,31,9,59\n8,4,32,10,59\n8,4,32,0,59\n"
    trace, report = load(tmp_path / "a.csv", FEMTO, text)
    assert trace.times.tolist() == [29071.9, 29072.0]
    assert report.refused == 2 and "'8 64 31 9'" in report.details[0].reason


def test_a_counter_that_restarts_begins_a_new_trace(tmp_path: Path) -> None:
    head = "ENGINE_RUN_TINE (),ENGINE_RPM (),COOLANT_TEMPERATURE ()\n"
    rows = "0.0, 0.0, 20.0,\r\n1.0, 900.0, 21.0,\r\n1.0, 700.0, 22.0,\r\n0.0, 0.0, 60.0,\r\n1.0, 800.0, 60.0,\r\n"
    path = tmp_path / "d.csv"
    path.write_text(head + rows)
    traces, report = load_traces(path, CAROBD)
    assert [trace.name for trace in traces] == ["d", "d-2"]
    assert traces[0].signals["EngineSpeed"].tolist() == [0.0, 800.0]
    assert report.files[0].merged == 1 and "goes back 1 times" in report.files[0].notes[-1]
