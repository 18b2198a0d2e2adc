"""Tables whose program wrote an index beside them: a clock without a name, or numbers of rows under no name."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from gateway.cli.main import main
from sim.lab.recordings import load_map, load_traces, unread_hash
from tests.traces.exports import recording, wide

NAMES = "Time,Bearing temperature,Motor current,Running"


def drafted(path: Path, *options: str) -> tuple[Path, str]:
    out = path.with_suffix(".toml")
    done = CliRunner().invoke(main, ["trace", "map", str(path), "-o", str(out), "--overwrite", *options])
    assert done.exit_code == 0, done.stderr
    return out, done.output


@pytest.mark.parametrize("quote", ["", '"'])
@pytest.mark.parametrize("again", [False, True])
def test_a_clock_in_an_index_without_a_name_is_the_clock(tmp_path: Path, quote: str, again: bool) -> None:
    header = f"{quote}{quote}," + ",".join(f"{quote}{name}{quote}" for name in NAMES.split(",")[1:])
    path = wide(tmp_path / "pandas.csv", header=header)
    if again:
        lines = path.read_text().splitlines()
        path.write_text("\n".join([*lines[:100], header, *lines[100:]]) + "\n")
    out, said = drafted(path)
    assert '[clock]\ncolumn = "column 1"' in out.read_text() and "240 of" in said
    (trace,), report = load_traces(path, load_map(out))
    assert np.array_equal(trace.signals["Bearing_temperature"], recording().heat)
    assert report.files[0].used == 240 and report.files[0].refused == again
    assert len(unread_hash(path, load_map(out))) == 64


@pytest.mark.parametrize("quote", ["", '"'])
def test_numbers_of_rows_without_a_name_move_no_column(tmp_path: Path, quote: str) -> None:
    path = wide(tmp_path / "r.csv", header=NAMES)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([NAMES, *(f"{quote}{n}{quote},{line}" for n, line in enumerate(lines[1:], 1))]) + "\n")
    out, said = drafted(path)
    assert "240 of 240 rows" in said and "1200 cells = 960 used" in said and "240 not used" in said
    (trace,), _ = load_traces(path, load_map(out))
    assert np.array_equal(trace.signals["Bearing_temperature"], recording().heat)
    assert np.array_equal(trace.signals["Motor_current"], recording().current)


def test_a_cell_more_that_counts_nothing_is_refused_as_before(tmp_path: Path) -> None:
    path = wide(tmp_path / "a.csv")
    out, _ = drafted(path)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([NAMES, *(f"x,{line}" for line in lines[1:5]), *lines[5:]]) + "\n")
    (trace,), report = load_traces(path, load_map(out))
    assert trace.times.size == 236 and report.files[0].refused == 4


def test_a_clock_in_parts_is_refused_with_its_columns(tmp_path: Path) -> None:
    rows = [f"2024,3,13,{hour},{20 + hour % 3}.5" for hour in range(24)]
    path = tmp_path / "parts.csv"
    path.write_text("\n".join(["year,month,day,hour,Bearing temperature", *rows]) + "\n")
    done = CliRunner().invoke(main, ["trace", "map", str(path)])
    assert done.exit_code == 2 and "columns of their own, year, month, day, hour" in done.stderr
