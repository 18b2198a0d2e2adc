"""The cases from the field, where they are present: each gives what is right, or asks for it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from gateway.cli.main import main
from sim.lab.recordings import load_map, load_traces

CASES = Path(__file__).resolve().parents[3] / "shared" / "cases" / "recordings"
WHOLE = {"seconds": 2390.0, "rows": 240, "highest": 63.19}
"""What most of them hold: one plant for forty minutes."""
RIGHT: dict[str, dict[str, object]] = {
    **dict.fromkeys(
        (
            "base", "columns_swapped", "constant_beside", "excel_serial", "formatted_cells", "header_again",
            "inverted_stop_only", "js_dates", "kelvin", "long_described", "month_german", "ms_with_dots",
            "seconds_lost",
            "sentinel_3276", "thousands_us",
        ),
        WHOLE,
    ),
    "power_and_speed": {**WHOLE, "asks": "--current ActivePower or --current GeneratorRPM", "answer": ("--current",
    "ActivePower")},
    "same_names": {**WHOLE, "asks": "--temperature Value", "answer": ("--temperature", "Value", "--current",
    "Value_2", "--running", "Value_3")},
    "state_words_nocurrent": {**WHOLE, "asks": "--on PRODUCTION", "answer": ("--on", "PRODUCTION")},
    "dst_fall": {"seconds": 14340.0, "rows": 240, "highest": 72.06},
    "dense_long": {"seconds": 43190.0, "rows": 4320, "highest": 69.2, "thresholds": (60.0, 136.0)},
    "on_change_long": {"seconds": 43180.0, "highest": 69.18, "thresholds": (60.0, 136.0)},
    "one_file_a_tag": {"seconds": 2390.0, "highest": 63.0, "events": ["W_OFF", "W_ON", "W_OFF", "W_ON", "W_OFF"]},
    "sessions_one_file": {"seconds": 2390.0, "rows": 240, "highest": 63.19, "traces": 2},
    "two_machines_one_file": {"seconds": 2390.0, "rows": 240, "highest": 63.19, "traces": 2, "machines": ["WT1",
    "WT2"]},
}  # fmt: skip


@pytest.fixture
def invoke() -> Callable[..., object]:
    return lambda *arguments: CliRunner().invoke(main, ["trace", "map", *map(str, arguments)])


@pytest.mark.parametrize("name", RIGHT)
def test_the_case_gives_what_is_right(name: str, tmp_path: Path, invoke: Callable[..., object]) -> None:
    folder = CASES / name
    if not folder.is_dir():
        pytest.skip(f"{folder} is not here")
    export, out, right = folder / "export.csv", tmp_path / "m.toml", RIGHT[name]
    export = export if export.exists() else folder
    done = invoke(export, "-o", out)
    if "asks" in right:
        assert done.exit_code == 2 and str(right["asks"]) in done.stderr  # type: ignore[attr-defined]
        done = invoke(export, "-o", out, *right["answer"])  # type: ignore[misc]
    assert done.exit_code == 0, done.stderr  # type: ignore[attr-defined]
    column_map = load_map(out)
    traces, report = load_traces(export, column_map)
    assert len(traces) == right.get("traces", 1)
    assert [trace.machine for trace in traces] == right.get("machines", [trace.machine for trace in traces])
    first = traces[0]
    assert first.times[-1] - first.times[0] == pytest.approx(float(str(right["seconds"])), abs=1.0)
    assert first.times.size == right.get("rows", first.times.size)
    assert np.nanmax(first.signals[column_map.temperature]) == pytest.approx(float(str(right["highest"])), abs=0.01)
    if "thresholds" in right:
        assert report.alphabet.channels[1].thresholds == pytest.approx(right["thresholds"], rel=0.05)  # type: ignore[union-attr]
    assert "unknown" not in [event.symbol for trace in traces for event in trace.events] or name == "sentinel_3276"
    if "events" in right:
        assert [event.symbol for event in first.events if event.symbol[0] == "W"] == right["events"]
