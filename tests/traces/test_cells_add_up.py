"""Of the cells of any file each is used, refused, merged or not used, and the line that says so adds up."""

import csv
import io
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.cli.main import main
from gateway.lab.learning import learn as learning
from sim.lab.recordings import ColumnMap, LoadReport, TraceError, load_traces, write_trace
from sim.plant import production
from sim.sha import Trace
from tests.rig.no_bands import without_bands

CELLS = st.sampled_from(["", "1", "20.5", "-4", "bad", "3276.7", "x y", "0", "1e3", " ", "nan", "2,5"])
TIMES = st.sampled_from(["0", "1", "2", "2", "3", "5", "never", "", "4", "60", "1"])
HEADS = ("time", "T", "I", "note")


@st.composite
def files(draw: st.DrawFn) -> list[list[str]]:
    """Rows of a file with all that goes wrong: headers again, rows too long or short, times that fall and double."""
    rows: list[list[str]] = []
    for _ in range(draw(st.integers(1, 25))):
        kind = draw(st.integers(0, 11))
        if kind == 0:
            rows.append(list(draw(st.permutations(HEADS))))
        elif kind == 1:
            rows.append([draw(TIMES), *draw(st.lists(CELLS, max_size=5))])
        else:
            rows.append([draw(TIMES), draw(CELLS), draw(CELLS), draw(CELLS)])
    return rows


def written(path: Path, rows: list[list[str]]) -> int:
    """The file, and how many of its cells hold something; the header above is none of them."""
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows([list(HEADS), *rows])
    path.write_text(out.getvalue(), encoding="utf-8")
    return sum(bool(cell.strip()) for row in rows if any(cell.strip() for cell in row) for cell in row)


def loaded(path: Path, column_map: ColumnMap) -> tuple[list[Trace], LoadReport]:
    """What is read, also of a file of which nothing can be used."""
    try:
        return load_traces(path, column_map)
    except TraceError as error:
        assert error.report is not None
        return [], error.report


@settings(max_examples=120, deadline=None)
@given(files(), st.sampled_from(["average", "last", "keep", "spread"]), st.sampled_from(["refuse", "split", "sort"]))
def test_cells_in_are_used_refused_merged_or_not_used(rows: list[list[str]], duplicates: str, back: str) -> None:
    column_map = ColumnMap.model_validate({
        "format": "wide", "temperature": "T", "clock": {"column": "time", "formats": "seconds"}, "decimal": ".",
        "signals": {"T": {"bad": [3276.7]}, "I": {}}, "duplicates": duplicates, "clock_back": back,
    })  # fmt: skip
    with TemporaryDirectory() as folder:
        cells = written(Path(folder) / "a.csv", rows)
        traces, report = loaded(Path(folder) / "a.csv", column_map)
    (file,) = report.files
    if file.error:
        return
    assert file.cells == cells
    assert file.cells == file.used_cells + file.refused_cells + file.merged_cells + sum(file.unused.values())
    # What is used stands in the traces: the times, and each reading that is good.
    if duplicates != "average":
        seen = sum(
            trace.times.size + sum(int(np.isfinite(s).sum()) for s in trace.signals.values()) for trace in traces
        )
        late_bad = sum(file.reasons.values())
        assert seen <= file.used_cells <= seen + late_bad
    assert f"{cells} cells = " in file.sentences()[0]


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(TIMES, st.sampled_from(["T", "I", "other"]), CELLS, CELLS), min_size=1, max_size=25))
def test_the_cells_of_a_long_file_add_up_too(rows: list[tuple[str, str, str, str]]) -> None:
    column_map = ColumnMap.model_validate({
        "format": "long", "temperature": "T", "clock": {"column": "time", "formats": "seconds"}, "decimal": ".",
        "signals": {"T": {}, "I": {}}, "long": {"name": "T", "value": "I"}, "duplicates": "last", "clock_back": "sort",
    })  # fmt: skip
    with TemporaryDirectory() as folder:
        written(Path(folder) / "a.csv", [list(row) for row in rows])
        _, report = loaded(Path(folder) / "a.csv", column_map)
    (file,) = report.files
    if not file.error:
        assert file.cells == file.used_cells + file.refused_cells + file.merged_cells + sum(file.unused.values())


def test_learn_and_ingest_say_the_line_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And of the learned tables only the rows that a person is shown."""
    without_bands(monkeypatch)
    monkeypatch.setattr(learning, "MAX_ROWS", 1)
    trace = production(1, 4, seed=1, period=120.0)
    (tmp_path / "in").mkdir()
    write_trace(trace, tmp_path / "in" / "a.csv")
    cells = sum(int(np.isfinite(column).sum()) for column in trace.signals.values()) + trace.times.size
    line = f"{cells} cells = {cells} used + 0 refused + 0 merged + 0 not used"
    learn = ["model", "learn", "--traces", str(tmp_path / "in" / "a.csv"), "--out", str(tmp_path / "model")]
    done = CliRunner().invoke(main, learn)
    assert done.exit_code == 0 and line in done.stdout, done.output
    assert "(the first 1 of 15 rows; --json has all)" in " ".join(done.stdout.split())
    done = CliRunner().invoke(main, ["trace", "ingest", str(tmp_path / "in"), "--into", str(tmp_path / "archive")])
    assert done.exit_code == 0 and line in done.stdout, done.output
