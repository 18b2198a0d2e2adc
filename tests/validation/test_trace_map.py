"""`decanter trace map` on the headers of thirty-two exports: what it finds, what it asks; its map reads them."""

import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from gateway.cli.main import main
from sim.lab.recordings import load_map, load_traces

EXPORTS = Path(__file__).parent / "exports"
ALL: list[dict[str, Any]] = tomllib.loads((EXPORTS / "exports.toml").read_text(encoding="utf-8"))["export"]
RISES, HOTTEST, ROWS = 1.7, 45.3, 24
"""What the readings of each fixture are: degC a row while the machine runs, the highest of them, times in the file."""


def mapped(export: Path, out: Path, *options: str) -> dict[str, Any]:
    done = CliRunner().invoke(main, ["trace", "map", str(export), "-o", str(out), *options, "--json"])
    assert done.exit_code == 0, done.stderr
    return dict(json.loads(done.stdout))


@pytest.mark.parametrize("export", ALL, ids=lambda export: export["file"])
def test_the_map_of_an_export_finds_its_columns_and_reads_all_its_rows(export: dict[str, Any], tmp_path: Path) -> None:
    file, out = EXPORTS / export["file"], tmp_path / "map.toml"
    found = mapped(file, out, *export["options"])
    assert (found["clock"], found["temperature"]) == (export["time"], export["temperature"])
    assert (found["current"], found["running"]) == (export["current"], export["running"])
    (trace,), report = load_traces(file, load_map(out))
    assert report.used == export["rows"]
    assert trace.times.size == ROWS and np.all(np.diff(trace.times) > 0)
    readings = trace.signals[load_map(out).temperature]
    readings = readings[np.isfinite(readings)]
    assert readings.max() == pytest.approx(HOTTEST, abs=2.0) and readings.size == ROWS
    assert [event.symbol for event in trace.events if event.symbol[0] == "W"] == ["W_OFF", "W_ON", "W_OFF"]
    assert {event.symbol for event in trace.events} >= {"A_0", "A_1"}


@pytest.mark.parametrize("export", [each for each in ALL if "question" in each], ids=lambda export: export["file"])
def test_where_two_fit_the_refusal_names_both_and_the_option(export: dict[str, Any], tmp_path: Path) -> None:
    done = CliRunner().invoke(main, ["trace", "map", str(EXPORTS / export["file"]), "-o", str(tmp_path / "m.toml")])
    assert done.exit_code == 2 and not (tmp_path / "m.toml").exists()
    assert done.stderr.count(f"--{export['question']}") == 2 and len(done.stderr.splitlines()) == 1
