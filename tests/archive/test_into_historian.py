"""A recording in a historian: as it was read, once however often it is imported, and never against what is there."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from gateway.cli.main import main
from gateway.machine.model import recorded_scans
from gateway.store import HistorianError, machines, open_historian, reading, to_trace
from sim.lab.recordings import load_map, load_traces, split_cycles
from sim.sha import encode
from tests.traces.exports import Recording, recording, wide

MAP = """format = "wide"
temperature = "Bearing temperature"
machine = "P1"
[clock]
column = "Time"
[signals]
"Bearing temperature" = { unit = "degC", bad = [3276.7] }
"Motor current" = { unit = "A" }
Running = { boolean = true }
[alphabet]
channels = [
    { kind = "switch", signal = "Running", rising = "W_ON", falling = "W_OFF", on_change = false },
    { kind = "bins", signal = "Motor current", thresholds = [60.0, 136.0] },
]
"""


@pytest.fixture
def map_file(tmp_path: Path) -> Path:
    path = tmp_path / "m.toml"
    path.write_text(MAP)
    return path


@pytest.fixture
def take(tmp_path: Path, map_file: Path) -> Callable[..., Result]:
    """`historian import` of files into the test's historian."""

    def run(*arguments: object) -> Result:
        words = [*map(str, arguments), "--map", str(map_file), "--historian", str(tmp_path / "h.sqlite")]
        return CliRunner().invoke(main, ["historian", "import", *words])

    return run


def part(whole: Recording, rows: slice) -> Recording:
    return Recording(whole.seconds[rows], whole.heat[rows], whole.current[rows], whole.running[rows])


def test_what_is_imported_is_read_back_as_it_was_read(
    tmp_path: Path, map_file: Path, take: Callable[..., Result]
) -> None:
    plant = recording()
    plant.heat[40] = 3276.7  # no reading: it must not stand for the one before it
    file = wide(tmp_path / "a.csv", of=plant)
    done = take(file, "--json")
    assert done.exit_code == 0, done.output
    (found,) = json.loads(done.stdout)["machines"]
    assert found["rows"] == found["stored"] == 240 and found["already there"] == 0
    assert "960 cells = 959 used + 1 refused" in json.loads(done.stdout)["account"]
    (trace,), report = load_traces(file, load_map(map_file))
    back = to_trace(tmp_path / "h.sqlite", machine="P1")
    assert np.array_equal(back.times, trace.times)
    for name, values in trace.signals.items():
        assert np.array_equal(back.signals[name], values, equal_nan=True), name
    back = replace(back, events=encode(back, report.alphabet))
    assert back.events == trace.events
    assert len(split_cycles(back, report.alphabet)) == len(split_cycles(trace, report.alphabet)) == 2
    # As a running gateway stores: what has not changed is not there again with each scan.
    assert found["samples"] < 3 * 240
    with reading(tmp_path / "h.sqlite") as connection:
        assert machines(connection) == [("P1", ["Bearing temperature"])]


@pytest.mark.parametrize(
    ("every", "on_change"),
    [(2, "false"), (9, "true"), (9, "false")],
    ids=["every second", "switch lasts", "beyond gap"],
)
def test_a_reading_holds_over_rows_without_one_as_a_gateway_is_shown_the_recording(
    tmp_path: Path, map_file: Path, take: Callable[..., Result], every: int, on_change: str
) -> None:
    text = MAP.replace("[alphabet]", "[alphabet]\ngap = 50.0")
    map_file.write_text(text.replace("on_change = false", f"on_change = {on_change}"))
    lines = wide(tmp_path / "dense.csv").read_text().splitlines()
    rows = [line.split(",") for line in lines[1:]]
    # Current and switch stand in every so many rows, and once the current is refused.
    rows = [[*row[:2], *(row[2:] if at % every == 0 else ("", ""))] for at, row in enumerate(rows)]
    rows[10 * every][2] = "no reading"
    file = tmp_path / "a.csv"
    file.write_text("\n".join([lines[0], *map(",".join, rows)]) + "\n")
    assert "240 rows = 240 stored" in take(file).output
    (trace,), report = load_traces(file, load_map(map_file))
    back = to_trace(tmp_path / "h.sqlite", machine="P1")
    if every == 2:
        assert encode(back, report.alphabet) == trace.events
    scans = recorded_scans(trace, 10.0, report.alphabet)
    for scan, *values in zip(scans, *(back.signals[name].tolist() for name in trace.signals), strict=True):
        shown = [np.nan if sample.value is None else sample.value for sample in scan.samples.values()]
        assert np.array_equal(shown, values, equal_nan=True), scan
    assert "240 rows = 0 stored (in 0 samples) + 240 there already" in take(file).output


def test_it_is_stored_once_and_goes_on_where_the_recording_does(tmp_path: Path, take: Callable[..., Result]) -> None:
    whole = recording()
    first, all_of_it = wide(tmp_path / "a.csv", of=part(whole, slice(0, 100))), wide(tmp_path / "b.csv", of=whole)
    assert "100 rows = 100 stored" in take(first).output
    assert "100 rows = 0 stored (in 0 samples) + 100 there already" in take(first).output
    assert "240 rows = 140 stored" in take(all_of_it).output
    assert "+ 240 there already" in take(all_of_it).output
    assert to_trace(tmp_path / "h.sqlite").times.size == 240
    assert "Q2: 240 rows = 240 stored" in take(all_of_it, "--machine", "Q2").output


@pytest.mark.parametrize(
    ("rows", "change", "said"),
    [
        (slice(0, 240), 1.0, "(1 such readings); one of them is wrong, or they are of two machines"),
        (slice(0, 50), 0.0, ""),
        (slice(20, 240), 0.0, ""),
        (slice(0, 240, 2), 0.0, "the historian has 239 other rows of 'P1', and the recording 120"),
    ],
)
def test_what_contradicts_is_refused_before_anything_is_stored(
    tmp_path: Path, take: Callable[..., Result], rows: slice, change: float, said: str
) -> None:
    whole = recording()
    take(wide(tmp_path / "a.csv", of=whole))
    whole.heat[154] += change
    done = take(wide(tmp_path / "b.csv", of=part(whole, rows)))
    if said:
        assert done.exit_code == 2 and said in done.stderr and "Traceback" not in done.stderr
    else:
        assert done.exit_code == 0 and "there already" in done.output
    assert to_trace(tmp_path / "h.sqlite").times.size == 240


def test_rows_before_what_is_there_and_clocks_without_a_day_are_refused(
    tmp_path: Path, map_file: Path, take: Callable[..., Result]
) -> None:
    whole = recording()
    take(wide(tmp_path / "a.csv", of=part(whole, slice(100, 240))))
    done = take(wide(tmp_path / "b.csv", of=part(whole, slice(0, 120))))
    assert done.exit_code == 2 and "import recordings in the order of their times" in done.stderr
    map_file.write_text(MAP.replace('column = "Time"', 'column = "Time"\nformats = "seconds"'))
    elapsed = wide(tmp_path / "c.csv", clock=lambda moment: str(moment.timestamp() % 10_000))
    done = take(elapsed)
    assert done.exit_code == 2 and "count from its own beginning" in done.stderr


def test_a_historian_that_a_gateway_has_is_left_to_it(tmp_path: Path, take: Callable[..., Result]) -> None:
    file = wide(tmp_path / "a.csv")
    other = open_historian(tmp_path / "h.sqlite")
    try:
        done = take(file)
        assert done.exit_code == 2 and "another gateway is running on this historian" in done.stderr
    finally:
        other.close()
    (tmp_path / "h.sqlite").write_text("no database")
    assert take(file).exit_code == 2


def test_traces_of_one_machine_at_one_time_are_refused(tmp_path: Path, take: Callable[..., Result]) -> None:
    done = take(wide(tmp_path / "a.csv"), wide(tmp_path / "b.csv", of=recording(1)))
    assert done.exit_code == 2 and "at the same time; name the machines" in done.stderr
    with pytest.raises(HistorianError):
        to_trace(tmp_path / "h.sqlite")


def test_rows_of_one_time_are_refused_and_none_is_dropped(
    tmp_path: Path, map_file: Path, take: Callable[..., Result]
) -> None:
    twice = recording()
    twice.seconds[[11, 12, 40]] = twice.seconds[[10, 10, 39]]
    file = wide(tmp_path / "a.csv", of=twice)
    map_file.write_text(f'duplicates = "keep"\n{MAP}')
    done = take(file)
    assert done.exit_code == 2 and "3 rows of 'P1' have the time of the row before" in done.stderr
    assert not (tmp_path / "h.sqlite").exists()
    map_file.write_text(f'duplicates = "spread"\n{MAP}')
    assert "240 rows = 240 stored" in take(file).output
