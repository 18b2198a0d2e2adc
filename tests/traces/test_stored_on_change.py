"""The same plant stored in each row and stored on change: the same levels, events and readings."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gateway.console import shipped_file
from sim.lab.learning.bins import learn_bins
from sim.lab.learning.calibrate import score_forecasts
from sim.lab.recordings import load_map, load_traces, parse_map
from sim.plant import production
from sim.sha import DECANTER, Bins, Model, Trace, encode, holds_roughly
from tests.traces.exports import Recording, on_change, recording, wide, written
from tests.traces.test_dialects import mapped

TEMPERATURE = "TCuscinettiRiduttore"
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
    (trace,), report = load_traces(export, load_map(shipped_file("traces", "decanter")))
    assert report.alphabet.gap == 5 * step and "unknown" not in [event.symbol for event in trace.events]


@pytest.mark.parametrize("every", [60.0, 600.0, 3600.0])
@pytest.mark.parametrize("deadband", [0.5, 2.0])
def test_a_recorder_that_tells_values_anew_after_its_longest_time_is_seen_to_store_on_change(
    every: float, deadband: float, dense: tuple[Trace, tuple[float, ...]], tmp_path: Path
) -> None:
    export = written(tmp_path / "a.csv", HEADER, on_change(long_recording(), deadband, every))
    (held,), _, _ = mapped(export, tmp_path / "m.toml")
    assert load_map(tmp_path / "m.toml").stored == "on change"
    assert thresholds(tmp_path / "m.toml") == pytest.approx(dense[1], rel=0.05)
    starts = [event.time for event in held.events if event.symbol == "W_ON"]
    assert starts == [event.time for event in dense[0].events if event.symbol == "W_ON"]


@pytest.mark.parametrize("dead", [0, 1])
def test_a_tag_that_dies_while_others_speak_is_unknown_after_its_own_longest_silence(dead: int, tmp_path: Path) -> None:
    rows = on_change(long_recording(), 0.5, 600.0)
    half = len(rows) // 2
    lines = []
    for number, row in enumerate(rows):
        time, *cells = row.split(",")
        cells[dead] = "" if number > half else cells[dead]
        lines.append(",".join([time, *cells]))
    (held,), _, _ = mapped(written(tmp_path / "a.csv", HEADER, lines), tmp_path / "m.toml", "--stored", "on change")
    own = held.signals[("Bearing_temperature", "Motor_current")[dead]]
    last = held.times[np.isfinite(own)][-1]
    assert held.times[0] + 0.4 * np.ptp(held.times) < last < held.times[0] + 0.65 * np.ptp(held.times)
    others = held.signals[("Motor_current", "Bearing_temperature")[dead]]
    assert np.isfinite(others[-60:]).all()


def test_a_map_holds_each_signal_for_its_own_silence(tmp_path: Path) -> None:
    rows = ["0,20,0", "100,,1", "200,,0", "300,,1", "400,,0", "500,21,1"]
    column_map = parse_map(
        'format = "wide"\ntemperature = "T"\nstored = "on change"\nsilence = 400\ninterval = 50\n'
        '[clock]\ncolumn = "t"\nformats = "seconds"\n[signals]\nT = { silence = 150 }\nI = {}\n',
        "a map",
    )
    (trace,), _ = load_traces(written(tmp_path / "a.csv", "t,T,I", rows), column_map)
    known = np.isfinite(trace.signals["T"])
    assert known.tolist() == [time <= 150 or time == 500 for time in trace.times.tolist()]
    assert np.isfinite(trace.signals["I"]).all()


def test_what_only_holds_is_drawn_to_the_next_reading_and_rest_moves_at_its_end_only() -> None:
    times = np.arange(0.0, 130.0, 10.0)
    values = np.array([20.0] * 10 + [22.0, 24.0, 26.0])
    held = np.array([False] + [True] * 9 + [False] * 3)
    trace = Trace("a", times, {"T": values}, held={"T": held})
    course = trace.signal_course("T")
    assert course[[0, 9, 10]].tolist() == [20.0, 20.0, 22.0] and np.all(np.diff(course) >= 0)
    even = replace(trace, signals={"T": np.array([20.0, 20.0, 22.0, 22.0, 24.0])}, times=times[:5], held={})
    held_even = replace(even, held={"T": np.array([False, True, False, True, False])})
    assert held_even.signal_course("T").tolist() == [20.0, 21.0, 22.0, 23.0, 24.0]
    assert even.signal_course("T").tolist() == even.signals["T"].tolist()


@pytest.mark.parametrize(("deadband", "roughly"), [(0.0, False), (0.5, True)])
def test_whether_a_deadband_kept_changes_back_is_seen_by_the_smallest(deadband: float, roughly: bool) -> None:
    plant = long_recording()
    kept, last = list[int](), np.nan
    for row, value in enumerate(plant.heat.tolist()):
        if not abs(value - last) <= deadband:
            kept.append(row)
            last = value
    assert holds_roughly(plant.seconds[kept], plant.heat[kept]) is roughly


@pytest.fixture(scope="module")
def dense_model() -> tuple[Model, list[Trace], dict[float, float]]:
    trace = production(1, 5, seed=1, period=10.0)
    learning, test = replace(trace, events=encode(trace, DECANTER)), production(1, 3, seed=2, period=10.0)
    model = learn_bins([learning], DECANTER, TEMPERATURE, seed=0, bands=False).model
    tests = [replace(test, events=encode(test, DECANTER))]
    return model, tests, crps(model, tests)


def crps(model: Model, tests: list[Trace]) -> dict[float, float]:
    scored = score_forecasts(model, tests, [float(tests[0].times[0])], np.random.default_rng(0), origins=100)
    return {
        horizon: float(np.mean([each.crps for each in scored if each.horizon == horizon]))
        for horizon in (60.0, 300.0, 900.0)
    }


@pytest.mark.parametrize("deadband", [0.5, 2.0])
def test_a_model_of_values_on_change_forecasts_as_that_of_each_row(
    deadband: float, dense_model: tuple[Model, list[Trace], dict[float, float]]
) -> None:
    """Learned from what a deadband left, judged by each row: CRPS within 1.2 at every horizon, the same locations."""
    trace, last = production(1, 5, seed=1, period=10.0), np.nan
    heat = trace.signals[TEMPERATURE].copy()
    held = np.ones(heat.shape, dtype=bool)
    for row, value in enumerate(heat.tolist()):
        if not abs(value - last) <= deadband:
            last, held[row] = value, False
        heat[row] = last
    stored = replace(trace, signals={**trace.signals, TEMPERATURE: heat}, held={TEMPERATURE: held})
    stored = replace(stored, events=encode(stored, DECANTER))
    model = learn_bins([stored], DECANTER, TEMPERATURE, seed=0, bands=False).model
    whole, tests, best = dense_model
    assert [each.name for each in model.sha.locations] == [each.name for each in whole.sha.locations]
    found = crps(model, tests)
    assert all(found[horizon] <= 1.2 * best[horizon] for horizon in best), (found, best)
