"""Long files: SCADA dumps, one file a kind of signal, concatenated, filtered and pivoted."""

from pathlib import Path

import numpy as np
import pytest

from sim.lab.recordings.column_map import ColumnMap, load_map
from sim.lab.recordings.load_report import TraceError
from sim.lab.recordings.traces import load_traces
from sim.sha.trace import UNKNOWN
from tests.validation.places import MAPS

T = "TCuscinettiRiduttore"
SCADA = load_map(MAPS / "decanter_scada.toml")
HEAD = '"DataObjectName","DataObjectField","Value","TimeStamp"\n'


def row(field: str, value: object, stamp: str, name: str = "DecanterMB") -> str:
    return f'"{name}","{field}",{value},"{stamp}"\n'


@pytest.fixture
def dump(tmp_path: Path) -> Path:
    folder = tmp_path / "cd1"
    folder.mkdir()
    digital = row("MarciaDecanter", "True", "2025-01-10 09:13:29.388") + row(
        "MarciaDecanter", "False", "2025-01-10 09:13:33.000"
    )
    analogue = "".join(row(T, 18.4 + second, f"2025-01-10 09:13:{30 + second}.021") for second in range(3)) + row(
        "Assorbimento", '"150,5"', "2025-01-10 09:13:29.388"
    )
    (folder / "digital.csv").write_text(HEAD + digital)
    (folder / "analogue.csv").write_text(HEAD + analogue + row(T, 1, "2025-01-10 09:13:31.021", "PompaMB"))
    return folder


def test_the_files_of_a_folder_become_one_trace_in_order(dump: Path) -> None:
    traces, report = load_traces(dump, SCADA)
    (trace,) = traces
    assert trace.name == "cd1"
    start = np.datetime64("2025-01-10T08:13:29.388").astype("datetime64[ms]").astype(float) / 1e3
    np.testing.assert_allclose(trace.times - start, [0.0, 0.633, 1.633, 2.633, 3.612], atol=1e-6)
    np.testing.assert_array_equal(trace.signals[T], [np.nan, 18.4, 19.4, 20.4, np.nan])
    assert [event.symbol for event in trace.events] == ["W_ON", "A_1", "W_OFF"]
    assert trace.events[0].time == trace.events[1].time
    assert [(file.rows, file.used, file.aside) for file in report.files] == [(5, 4, 1), (2, 2, 0)]


@pytest.mark.parametrize("word", ["True", "TRUE", "true", "1", "1.0", '"1,0"', "VERO", "on", '" True "', "-1"])
def test_booleans_come_in_many_words(dump: Path, word: str) -> None:
    (dump / "digital.csv").write_text(HEAD + row("MarciaDecanter", word, "2025-01-10 09:13:29.388"))
    assert load_traces(dump, SCADA)[0][0].events[0].symbol == "W_ON"


def test_a_value_that_is_blank_or_out_of_range_is_bad_quality(dump: Path) -> None:
    more = row(T, "", "2025-01-10 09:13:40") + row("Assorbimento", 9999, "2025-01-10 09:13:41")
    with (dump / "analogue.csv").open("a") as stream:
        stream.write(more)
    traces, report = load_traces(dump, SCADA)
    assert traces[0].bad[T].sum() == traces[0].bad["Assorbimento"].sum() == 1
    assert report.files[0].reasons == {f"{T} is blank": 1, "Assorbimento is outside 0..350 A": 1}
    assert traces[0].events[-1].symbol == "W_OFF" and traces[0].events[-2].symbol == UNKNOWN


def test_dates_of_several_forms_in_one_file_are_read_and_others_named(dump: Path) -> None:
    more = row(T, 21, "10/01/2025 09:13:34.5") + row(T, 22, "10/01/2025 09:13:35") + row(T, 23, "Jan 10")
    with (dump / "analogue.csv").open("a") as stream:
        stream.write(more)
    traces, report = load_traces(dump, SCADA)
    assert np.nanmax(traces[0].signals[T]) == 22.0
    assert traces[0].times[-1] - traces[0].times[0] == pytest.approx(5.612)
    assert report.files[0].refused == 1 and "'Jan 10'" in report.files[0].details[0].reason


def test_rows_of_unknown_objects_only_is_a_clear_error(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(HEAD + row(T, 20, "2025-01-10 09:13:29", "OtherMB"))
    with pytest.raises(TraceError, match="none of its 1 rows can be used") as caught:
        load_traces(path, SCADA)
    assert caught.value.report is not None
    assert "another object" in caught.value.report.files[0].notes[0]


def test_the_header_of_another_dump_is_named(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("Name,Value,Time\nx,1,2025-01-10\n")
    with pytest.raises(
        TraceError, match="there is no column 'TimeStamp', 'DataObjectField', 'DataObjectName'; its col"
    ):
        load_traces(path, SCADA)


def test_a_clock_that_goes_back_inside_one_file_is_sorted_and_told(dump: Path) -> None:
    with (dump / "analogue.csv").open("a") as stream:
        stream.write(row(T, 17.0, "2025-01-10 09:13:29.900"))
    traces, report = load_traces(dump, SCADA)
    assert traces[0].signals[T][1] == 17.0
    assert any("its clock goes back 1 times; its rows are sorted" in note for note in report.files[0].notes)


def test_a_long_map_without_its_columns_is_refused() -> None:
    table = SCADA.model_dump(exclude={"alphabet", "long"})
    with pytest.raises(ValueError, match=r"needs a table \[long\]"):
        ColumnMap.model_validate(table)
