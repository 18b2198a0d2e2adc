"""A PLC's text, a tag, a unit or a machine's name in a CSV file was a formula to the spreadsheet that opened it.

All CSV of the product goes through `drivers.csv_rows.write_rows`; what its own readers read comes back as it was.
"""

import ast
import csv
import io
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from drivers.csv_rows import numbered_rows, write_rows
from drivers.tag import DType, Quality, Sample, Tag
from gateway.cli.main import main
from gateway.commission.files.recording import ScanRecorder, read_recording
from gateway.lab.traces.can import _rows
from gateway.settings import load_plant
from gateway.store import open_historian
from sim.lab.recordings import write_trace
from sim.lab.recordings.text_table import split_rows
from sim.sha import Trace
from tests.gateway.support import EPOCH, plant_file

ROOT = Path(__file__).parents[3]
FORMULAS = (
    "=cmd|'/C calc'!A0", "+SUM(A1)", "-2+3", "@SUM(A1)", "  =1+1", "\t=1+1", "x\n=1", "a;=cmd|'/C calc'!A0", "＝1+1",
    "'=1", "''=1",
)  # fmt: skip
HARMLESS = ("Motor", "-1.5", "-", "+", "nan", "-inf", "a-b", "°C", "-5; -3", "it's", "'tis", "", "2026-01-01", "x=1")


def cells_anywhere(text: str) -> list[str]:
    """Every cell of a CSV text, split at commas as it is written, or at semicolons as other programs do."""
    by_comma = [cell for row in csv.reader(io.StringIO(text, newline="")) for cell in row]
    return [*by_comma, *(cell.strip('"') for line in text.splitlines() for cell in line.split(";"))]


def is_formula(cell: str) -> bool:
    """What a spreadsheet program would compute."""
    bare = cell.strip()
    try:
        return all(float(part) is None for part in bare.split(";"))
    except ValueError:
        return len(bare) > 1 and bare[0] in "=+-@＝＋－＠"


@pytest.mark.parametrize("text", FORMULAS)
def test_no_text_is_a_formula_and_each_is_read_back(text: str) -> None:
    sink = io.StringIO()
    write_rows(sink, [(text, 1.5, None, text)])
    assert not [cell for cell in cells_anywhere(sink.getvalue()) if is_formula(cell)]
    ((_, cells),) = numbered_rows(io.StringIO(sink.getvalue(), newline=""))
    assert cells == [text, "1.5", "", text]
    lines = enumerate(sink.getvalue().splitlines(keepends=True), 1)
    ((_, cells, fault),) = split_rows(lines, iter(()), separator=",", comment="", width=[4])
    assert not fault and [cell.lstrip() for cell in cells] == [text.lstrip(), "1.5", "", text.lstrip()]


@pytest.mark.parametrize("text", HARMLESS)
def test_what_is_no_formula_is_written_as_it_is(text: str) -> None:
    sink = io.StringIO()
    write_rows(sink, [(text, "x")])
    assert next(csv.reader(io.StringIO(sink.getvalue()))) == [text, "x"]


def test_a_plc_s_text_in_an_export_is_no_formula(tmp_path: Path) -> None:
    plant = plant_file(tmp_path)
    config = load_plant(plant)[0]
    store = open_historian(config.historian.path)
    view = store.view(config.machine, [Tag("Name", "holding:1", DType.STRING, length=20, unit="=unit")])
    view.put("samples", [("Name", EPOCH, "=cmd|'/C calc'!A0", int(Quality.GOOD), EPOCH)])
    view.put("scans", [(EPOCH, 0.1, 0)])
    assert store.flush(60.0)
    store.close()
    out = tmp_path / "out.csv"
    done = CliRunner().invoke(
        main, ["historian", "export", str(out), "--table", "samples", "--since", "all", "--config", str(plant)]
    )
    assert done.exit_code == 0, done.output
    text = out.read_text(encoding="utf-8")
    assert "cmd|" in text and not [cell for cell in cells_anywhere(text) if is_formula(cell)]


def test_recordings_with_such_tags_are_no_formulas_and_are_read_back(tmp_path: Path) -> None:
    name = "=cmd|'/C calc'!A0"
    recorder = ScanRecorder(tmp_path / "soak.csv", [Tag(name, "holding:1")])
    recorder.take(1.0, [Sample(name, -3.5, Quality.GOOD, 1.0)])
    recorder.take(2.0, [Sample(name, 4.5, Quality.GOOD, 2.0)])
    recorder.close()
    assert read_recording(tmp_path / "soak.csv").columns == {name: [-3.5, 4.5]}
    write_trace(Trace("x", np.array([1.0, 2.0]), {name: np.array([-3.5, np.nan])}), tmp_path / "trace.csv")
    sink = io.StringIO()
    list(_rows(sink, [Sample(name, "+1+1", Quality.GOOD, 1.0)]))
    texts = [(tmp_path / file).read_text(encoding="utf-8") for file in ("soak.csv", "trace.csv")]
    for text in (*texts, sink.getvalue()):
        assert name in text and not [cell for cell in cells_anywhere(text) if is_formula(cell)]


def test_csv_has_one_writer_in_the_product() -> None:
    others = []
    for room in ("drivers", "sim", "gateway", "decanter_gateway"):
        for path in sorted((ROOT / room).rglob("*.py")):
            names = {"writer", "DictWriter", "to_csv", "savetxt"}
            calls = [node.func for node in ast.walk(ast.parse(path.read_text("utf-8"))) if isinstance(node, ast.Call)]
            found = [one.attr for one in calls if isinstance(one, ast.Attribute) and one.attr in names]
            others += [f"{path.relative_to(ROOT)}: {name}" for name in found]
    # A data frame goes to a file that our own reader takes at once, and no spreadsheet ever.
    assert others == ["drivers/csv_rows.py: writer", "gateway/lab/python/frames.py: to_csv"]
