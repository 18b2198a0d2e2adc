"""What looked alike and was read as the wrong one of two: clocks, codes, switches, parts and narrow rows."""

from pathlib import Path

import numpy as np
import pytest

from sim.lab.recordings import TraceError, find_codes, load_map, load_traces, parse_map
from tests.traces.exports import recording, wide, written
from tests.traces.test_dialects import asked, mapped

PLANT = recording()


@pytest.mark.parametrize(
    ("name", "begin", "size"), [("Time [us]", 3.2e9, 1e6), ("timestamp_ms", 1.25e9, 1e3), ("Time (s)", 40000.5, 1.0)]
)
def test_the_unit_of_a_clocks_name_decides_before_its_size(
    name: str, begin: float, size: float, tmp_path: Path
) -> None:
    export = wide(
        tmp_path / "a.csv",
        header=f"{name},Bearing temperature,Motor current,Running",
        clock=lambda moment: repr(begin + (moment - PLANT.moments[0]).total_seconds() * size),
    )
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    assert trace.times[-1] - trace.times[0] == pytest.approx(2390.0, abs=0.01)


def test_pascals_of_what_rests_at_0_are_no_codes() -> None:
    pressure = np.zeros(600)
    pressure[::10] = 2.5e7 + np.arange(60)
    assert find_codes(pressure) == {}
    pressure[::10] = 1.70141e38
    assert find_codes(pressure + np.sin(np.arange(600))) == {1.70141e38: 60}


def test_a_cold_that_a_pause_ends_is_no_code_and_a_jump_to_it_is() -> None:
    warm = 20.0 + np.sin(np.arange(900))
    cold = np.full(30, -40.0)
    times = 10.0 * np.arange(933)
    values = np.concatenate((cold, [np.nan] * 3, warm))
    assert find_codes(values, slow_at=times) == {}
    values[400:405] = -40.0
    assert find_codes(values, slow_at=times) == {-40.0: 35}
    # Every other row is of another signal.
    rows = np.insert(np.concatenate((warm[:400], cold, warm[400:])), np.arange(930), np.nan)
    assert find_codes(rows, slow_at=5.0 * np.arange(1860)) == {-40.0: 30}


def test_a_switch_is_not_the_machines_where_another_is_on_all_the_while(tmp_path: Path) -> None:
    early = np.maximum(PLANT.running, np.append(PLANT.running[8:], [0] * 8))
    columns = zip(PLANT.moments, PLANT.heat, PLANT.current, early, PLANT.running, strict=True)
    rows = [",".join(map(str, row)) for row in columns]
    export = written(tmp_path / "a.csv", "Time,Bearing temperature,Motor current,Motor running,Fan running", rows)
    assert "--running 'Motor running' or --running 'Fan running'" in asked(export, tmp_path / "m.toml")


def test_files_of_two_tags_whose_times_do_not_overlap_are_no_parts(tmp_path: Path) -> None:
    folder = tmp_path / "tags"
    folder.mkdir()
    rows = [f"{moment},{heat}" for moment, heat in zip(PLANT.moments, PLANT.heat, strict=True)]
    written(folder / "Temperature.csv", "Time,Value", rows)
    written(folder / "Current.csv", "Time,Value", ["2024-03-13 09:50:00,5.0", "2024-03-13 09:52:00,4.9"])
    (trace,), _, said = mapped(folder, tmp_path / "m.toml")
    assert said["temperature"] == "Temperature/Value" and np.nanmin(trace.signals["Temperature"]) > 10.0


def test_rows_that_lack_a_cell_are_not_shifted(tmp_path: Path) -> None:
    export = wide(tmp_path / "a.csv")
    mapped(export, tmp_path / "m.toml")
    lines = export.read_text(encoding="utf-8").splitlines()
    written(export, "Time,Ambient,Bearing temperature,Motor current,Running", lines[1:])
    with pytest.raises(TraceError, match="another number of cells than the header"):
        load_traces(export, load_map(tmp_path / "m.toml"))


@pytest.mark.parametrize("note", ["", "looked at"])
def test_a_cell_that_lacks_before_a_note_refuses_its_rows(note: str, tmp_path: Path) -> None:
    rows = [f"{moment},{current},{note}" for moment, current in zip(PLANT.moments, PLANT.current, strict=True)]
    export = written(tmp_path / "a.csv", "Time,Bearing temperature,Motor current,Note", rows)
    assert "another number of cells than the header" in asked(export, tmp_path / "m.toml")


def test_a_quality_of_its_own_file_judges_also_beside_the_numbers_of_its_rows(tmp_path: Path) -> None:
    folder = tmp_path / "tags"
    folder.mkdir()
    for tag, values in (("Bearing temperature", PLANT.heat), ("Motor current", PLANT.current)):
        rows = [f"{moment},{value}" for moment, value in zip(PLANT.moments, values, strict=True)]
        written(folder / f"{tag}.csv", "Time,Value", rows)
    words = [f"{at},{moment},{'Bad' if at in (5, 9) else 'Good'}" for at, moment in enumerate(PLANT.moments)]
    written(folder / "Quality.csv", ",Time,Value", words)
    (trace,), report, _ = mapped(folder, tmp_path / "m.toml")
    assert np.flatnonzero(np.isnan(trace.signals["Bearing_temperature"])).tolist() == [5, 9]
    assert sum(file.bad_cells for file in report.files) == 4


def test_a_quality_beside_another_reading_judges_no_other_file(tmp_path: Path) -> None:
    folder = tmp_path / "tags"
    folder.mkdir()
    rows = [f"{moment},{heat},Good" for moment, heat in zip(PLANT.moments, PLANT.heat, strict=True)]
    written(folder / "Oil.csv", "Time,Temp,Quality", rows)
    text = """
    format = "wide"
    separator = ","
    temperature = "Temp"
    parts = "*.csv"
    quality = { column = ["Quality"], good = ["Good"] }
    clock = { column = "Time", formats = ["ISO8601"], timezone = "UTC" }
    signals.Temp = { column = "Temp", unit = "degC" }
    derived.Running = { constant = 1.0 }
    [alphabet]
    gap = 30
    channels = [{ kind = "switch", signal = "Running", rising = "W_ON", falling = "W_OFF", on_change = false }]
    """
    written(folder / "Door.csv", "Time,Door,Quality", [f"{moment},0,Bad" for moment in PLANT.moments])
    (trace,), _ = load_traces(folder, parse_map(text, "map"))
    assert not np.isnan(trace.signals["Temp"]).any()


def beside(path: Path, header: str, *columns: np.ndarray) -> Path:
    """A file of the plant's clock with columns beside it."""
    rows = zip(PLANT.moments, *(column.tolist() for column in columns), strict=True)
    return written(path, header, [",".join(map(str, row)) for row in rows])


WEATHER = 8.0 + np.sin(np.arange(len(PLANT.moments)) / 50.0).round(3)
OXYGEN = -0.7 + (np.arange(len(PLANT.moments)) % 13) / 40.0


@pytest.mark.parametrize(
    "names",
    [
        ("Boiler 2 leaving water temp (°C)", "Campus temp (°C)"),
        ("Stator U1 (°C)", "Cabinet temperature (°C)"),
        ("Boiler exhaust temp", "Campus temp"),
    ],
)
def test_a_temperature_is_asked_for_where_no_bearing_is_named(names: tuple[str, str], tmp_path: Path) -> None:
    export = beside(tmp_path / "a.csv", f"Time,{','.join(names)},Power (kW)", PLANT.heat, WEATHER, PLANT.current)
    said = asked(export, tmp_path / "m.toml", "--yes")
    assert all(f"--temperature {name!r}" in said and f"{name!r} (" in said for name in names)
    assert mapped(export, tmp_path / "m.toml", "--temperature", names[0])[2]["temperature"] == names[0]


@pytest.mark.parametrize(
    "names",
    [
        ("Bearing temp (°C)", "Oil temp (°C)"),
        ("Bearing temp", "Campus temp (°C)"),
        ("Motor temp (°C)", "Ambient temp (°C)"),
        ("Water temp (°C)", "Water temp setpoint (°C)"),
    ],
)
def test_a_bearings_and_what_is_not_the_surroundings_is_no_question(names: tuple[str, str], tmp_path: Path) -> None:
    export = beside(tmp_path / "a.csv", f"Time,{','.join(names)},Power (kW)", PLANT.heat, WEATHER, PLANT.current)
    assert mapped(export, tmp_path / "m.toml")[2]["temperature"] == names[0]


@pytest.mark.parametrize(
    "sensor", ["O2 Sensor1 Wide Range Current(mA)", "Lambda I_p (A)", "Level(mA)", "Ion current (µA)"]
)
def test_a_sensors_own_current_loads_nothing(sensor: str, tmp_path: Path) -> None:
    speed = 200.0 * PLANT.current + 700.0
    header = f"Time,Bearing temperature,{sensor},Engine RPM(rpm)"
    export = beside(tmp_path / "a.csv", header, PLANT.heat, OXYGEN, speed)
    assert mapped(export, tmp_path / "m.toml")[2]["current"] == "Engine RPM(rpm)"


def test_a_current_that_a_loop_could_carry_is_asked_for(tmp_path: Path) -> None:
    export = beside(tmp_path / "a.csv", "Time,Bearing temperature,Signal(mA)", PLANT.heat, PLANT.current / 10)
    assert "--current 'Signal(mA)' or --current none" in asked(export, tmp_path / "m.toml")
    assert mapped(export, tmp_path / "n.toml", "--yes")[2]["current"] == ""
    assert mapped(export, tmp_path / "o.toml", "--current", "Signal(mA)")[2]["current"] == "Signal(mA)"


def test_a_small_motors_current_is_asked_for_beside_its_speed(tmp_path: Path) -> None:
    header = "Time,Bearing temperature,Motor current(mA),Speed(rpm)"
    export = beside(tmp_path / "a.csv", header, PLANT.heat, PLANT.current / 10, PLANT.current + 3.0)
    assert "--current 'Motor current(mA)' or --current 'Speed(rpm)'" in asked(export, tmp_path / "m.toml")


def test_a_total_is_likelier_than_its_parts_and_a_remainder_is_no_load(tmp_path: Path) -> None:
    parts = PLANT.current + 13.0, 0.1 * PLANT.current
    header = "Time,Bearing temperature,Package Power [W],Rest-of-Chip Power [W]"
    export = beside(tmp_path / "a.csv", header, PLANT.heat, *parts)
    assert mapped(export, tmp_path / "m.toml")[2]["current"] == "Package Power [W]"
    export = beside(tmp_path / "a.csv", f"{header},Total System Power [W]", PLANT.heat, *parts, sum(parts) + 5.0)
    said = asked(export, tmp_path / "n.toml")
    assert "--current 'Package Power [W]'" in said and "Rest" not in said and "(13.4 to" in said
    assert mapped(export, tmp_path / "o.toml", "--yes")[2]["current"] == "Total System Power [W]"


def test_what_only_dwells_is_no_choice_between_two_loads(tmp_path: Path) -> None:
    header = "Time,Bearing temperature,Agent Power [W],Package Power [W]"
    export = beside(tmp_path / "a.csv", header, PLANT.heat, PLANT.current, OXYGEN + 30.0)
    assert "most likely 'Agent Power [W]'" in asked(export, tmp_path / "m.toml")


@pytest.mark.parametrize("count", [2, 16, 60])
def test_a_question_of_many_long_names_says_the_option_that_answers_it(count: int, tmp_path: Path) -> None:
    names = [f"PLANT_SYS/{'chiller' * 4} {place} leaving temperature (°C)" for place in range(count)]
    header = f"Time,{','.join(names)}"
    export = beside(tmp_path / "a.csv", header, *(PLANT.heat + place for place in range(count)))
    said = asked(export, tmp_path / "m.toml")
    assert f"give --temperature {names[0]!r}" in said or f"such as --temperature {names[0]!r}" in said
    assert "give --temperature" in said and " ... " not in said


@pytest.mark.parametrize("second", ["45364.4170", "45364.4170,Bad,0.4,0", "45364.4170,,,"])
def test_a_row_that_lacks_readings_near_the_header_is_none_of_names(second: str, tmp_path: Path) -> None:
    days = 45364.0 + np.arange(len(PLANT.moments)) * 10.0 / 86400.0
    columns = zip(days.round(8).tolist(), PLANT.heat, PLANT.current, PLANT.running, strict=True)
    rows = [",".join(map(str, row)) for row in columns]
    rows[1] = second.replace("45364.4170", rows[1].split(",")[0])
    export = written(tmp_path / "a.csv", "Time,Bearing temperature,Motor current,Running", rows)
    (trace,), _, said = mapped(export, tmp_path / "m.toml")
    assert said["temperature"] == "Bearing temperature"
    assert np.isfinite(trace.signals["Bearing_temperature"]).sum() == len(rows) - 1
