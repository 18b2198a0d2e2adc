"""The same plant stored in each row and stored on change: the same levels, events and readings."""

from pathlib import Path

import numpy as np
import pytest

from gateway.console import shipped
from sim.lab.recordings import load_map, load_traces
from sim.sha import Bins, Trace
from tests.traces.exports import Recording, on_change, recording, wide, written
from tests.traces.test_dialects import mapped

HEADER = "Time,Bearing temperature,Motor current,Running"


def long_recording() -> Recording:
    return recording(times=8)


def thresholds(path: Path) -> tuple[float, ...]:
    (bins,) = [channel for channel in load_map(path).alphabet.channels if isinstance(channel, Bins)]
    return bins.thresholds


@pytest.fixture(scope="module")
def dense(tmp_path_factory: pytest.TempPathFactory) -> tuple[Trace, tuple[float, ...]]:
    folder = tmp_path_factory.mktemp("dense")
    (trace,), _, _ = mapped(wide(folder / "a.csv", of=long_recording()), folder / "m.toml")
    return trace, thresholds(folder / "m.toml")


@pytest.mark.parametrize("deadband", [0.1, 0.5, 1.0, 2.0])
def test_thresholds_events_and_values_are_those_of_the_dense_recording(
    deadband: float, dense: tuple[Trace, tuple[float, ...]], tmp_path: Path
) -> None:
    trace, cuts = dense
    rows = on_change(long_recording(), deadband)
    assert len(rows) < trace.times.size
    (held,), _, said = mapped(written(tmp_path / "a.csv", HEADER, rows), tmp_path / "m.toml")
    assert any("stored on change" in line for line in said["report"])
    assert thresholds(tmp_path / "m.toml") == pytest.approx(cuts, rel=0.05)
    symbols = [event.symbol for event in held.events]
    assert "unknown" not in symbols
    # A load's noise about a threshold is not to be the same event twice; the switchings are the same.
    for mark in ("W_ON", "W_OFF"):
        assert [e.time for e in held.events if e.symbol == mark] == [e.time for e in trace.events if e.symbol == mark]
    at = np.searchsorted(held.times, trace.times, side="right") - 1
    error = held.signals["Bearing_temperature"][at] - trace.signals["Bearing_temperature"]
    # A row that nothing was stored in has the value of the one before it; within one interval it may move on.
    assert np.abs(error).max() <= deadband + 1.5 and np.median(np.abs(error)) <= deadband


@pytest.mark.parametrize("deadband", [0.1, 1.0])
def test_a_temperature_alone_that_is_stored_on_change(deadband: float, tmp_path: Path) -> None:
    plant = long_recording()
    kept = [row.rsplit(",", 2)[0] for row in on_change(plant, deadband) if row.split(",")[1]]
    (held,), _, said = mapped(
        written(tmp_path / "a.csv", "Time,Bearing temperature", kept), tmp_path / "m.toml", "--stored", "on change"
    )
    assert said["temperature"] == "Bearing temperature"
    assert np.abs(np.diff(held.times)).max() <= 15.0


def test_silence_beyond_the_longest_that_means_as_before_is_a_gap(tmp_path: Path) -> None:
    rows = on_change(long_recording(), 0.5)
    export = written(tmp_path / "a.csv", HEADER, rows)
    mapped(export, tmp_path / "m.toml")
    text = (tmp_path / "m.toml").read_text(encoding="utf-8")
    lines = ["silence = 60" if line.startswith("silence") else line for line in text.splitlines()]
    (tmp_path / "m.toml").write_text("\n".join(lines), encoding="utf-8")
    (trace,), report = load_traces(export, load_map(tmp_path / "m.toml"))
    assert np.diff(trace.times).max() > 60 and any("gaps" in note for note in report.files[0].notes)


def test_a_bad_reading_ends_what_held(tmp_path: Path) -> None:
    rows = on_change(long_recording(), 0.5)
    time = rows[40].split(",")[0]
    rows[40] = f"{time},Bad,,"
    export = written(tmp_path / "a.csv", HEADER, rows)
    (trace,), report, _ = mapped(export, tmp_path / "m.toml", "--stored", "on change")
    at = int(np.flatnonzero(trace.bad["Bearing_temperature"])[0])
    assert report.files[0].bad_cells == 1 and np.isnan(trace.signals["Bearing_temperature"][at])


def test_a_dense_recording_with_nights_off_is_not_taken_for_one(tmp_path: Path) -> None:
    plant = recording(times=4)
    seconds = plant.seconds + 40_000.0 * (np.arange(plant.seconds.size) // 240)
    export = wide(tmp_path / "a.csv", of=Recording(seconds, plant.heat, plant.current, plant.running))
    (trace,), report, said = mapped(export, tmp_path / "m.toml")
    assert trace.times.size == plant.heat.size and not any("on change" in line for line in said["report"])
    assert any("3 gaps" in note for note in report.files[0].notes)


@pytest.mark.parametrize("step", [1.0, 5.0, 10.0, 30.0, 60.0])
def test_rows_of_any_interval_show_the_same_switchings(step: float, tmp_path: Path) -> None:
    plant = recording(step=step, times=2)
    export = wide(tmp_path / "a.csv", of=plant)
    (trace,), report, _ = mapped(export, tmp_path / "m.toml")
    symbols = [event.symbol for event in trace.events if event.symbol[0] in "Wu"]
    assert symbols == ["W_OFF", "W_ON", "W_OFF", "W_ON"] + ["W_OFF", "W_ON"] * 2
    assert report.alphabet.gap == pytest.approx(max(30.0, 5 * step), rel=0.1)


@pytest.mark.parametrize("step", [10.0, 60.0, 600.0])
def test_a_map_that_names_no_gap_has_that_of_the_recording(step: float, tmp_path: Path) -> None:
    rows = [f"{place * step:g},{place % 5 > 1:d},{100 * (place % 5 > 1)},20" for place in range(60)]
    export = written(tmp_path / "a.csv", "time,MarciaDecanter,Assorbimento,TCuscinettiRiduttore", rows)
    (trace,), report = load_traces(export, load_map(shipped("traces", "decanter")))
    assert report.alphabet.gap == 5 * step and "unknown" not in [event.symbol for event in trace.events]
