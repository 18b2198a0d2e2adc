"""Kinds of exports that public recordings showed: each a small file of one's own, with the numbers that are right."""

from collections.abc import Callable
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest

from sim.lab.recordings import load_map
from sim.lab.recordings.clock_words import plain_time
from sim.lab.recordings.mapping.words import ROLE_WORDS, current_score, named_time, split_unit, surely_machine
from tests.traces.exports import recording, wide, written
from tests.traces.test_dialects import is_the_plant, mapped

MONTHS = ["一月", "二月", "三月", "四月"]


def test_frequencies_that_are_called_clocks_are_no_times(tmp_path: Path) -> None:
    plant = recording()
    rows = [
        f"{m},{100 + place % 3},{200 + place % 5},{heat},{current}"
        for place, (m, heat, current) in enumerate(zip(plant.moments, plant.heat, plant.current, strict=True))
    ]
    header = "Date,Core Clock [MHz],Core Clock [MHz],Bearing temperature [°C],Motor current [A]"
    (trace,), _, _ = mapped(written(tmp_path / "a.csv", header, rows), tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")


@pytest.mark.parametrize("encoding", ["utf-8", "gb18030"])
def test_chinese_months_and_halves_of_a_day_beside_24_hours(encoding: str, tmp_path: Path) -> None:
    plant = replace(recording(), seconds=recording().seconds * 12)
    half = {True: "AM", False: "PM"}
    clock = [f"{m.year}-{MONTHS[m.month - 1]}-{m.day} {m:%H:%M:%S} {half[m.hour < 12]} CT" for m in plant.moments]
    rows = [f"{m},{heat},{current}" for m, heat, current in zip(clock, plant.heat, plant.current, strict=True)]
    export = tmp_path / "a.csv"
    export.write_text("\n".join(["Timestamp,轴承温度 (°C),电机电流 (A)", *rows]) + "\n", encoding=encoding)
    (trace,), report, said = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml", plant)
    assert report.refused == 0 and said["temperature"] == "轴承温度 (°C)" and "its CT says no offset" in said["text"]


def test_western_and_cyrillic_code_pages_are_told_from_chinese(tmp_path: Path) -> None:
    rows = [f"{m},{heat}" for m, heat in zip(recording().moments, recording().heat, strict=True)]
    for header, encoding in (("Zeit,Lager München °C", "cp1252"), ("Время,Подшипник температура °C", "cp1251")):
        export = tmp_path / f"{encoding}.csv"
        export.write_text("\n".join([header, *rows]) + "\n", encoding=encoding)
        done = mapped(export, tmp_path / f"{encoding}.toml", "--time", header.split(",")[0], "--temperature",
                      header.split(",")[1])  # fmt: skip
        assert done[2]["temperature"] == header.split(",")[1]


@pytest.mark.parametrize(
    ("text", "plain"),
    [
        ("2024年3月13日 09:58:00", "2024-3-13 09:58:00"),
        ("2024/3/13 下午9:58:00", "2024/3/13 9:58:00 PM"),
        ("2024-03-13 21:58:00 PM", "2024-03-13 21:58:00"),
        ("2024-03-13 00:58:00 AM", "2024-03-13 00:58:00"),
        ("2024-03-13 09:58:00 PM", "2024-03-13 09:58:00 PM"),
        # 00:58 PM may be 12:58 or a slip, 21:58 AM is one: no time, and no half of the day made up.
        ("2024-03-13 00:58:00 PM", "2024-03-13 00:58:00 PM"),
        ("2024-03-13 21:58:00 AM", "2024-03-13 21:58:00 AM"),
        ("13-Mar-24 9:58:00 AM ET", "13-Mar-24 9:58:00 AM"),
    ],
)
def test_times_of_other_scripts_in_plain_words(text: str, plain: str) -> None:
    assert plain_time(text) == plain


def test_names_are_read_as_a_person_reads_them() -> None:
    for name in ("Campus boiler energy", "Damper", "Lamp", "zone_current_temp_c"):
        assert current_score(name, "") == 0
    for name in ("AmpsMotor", "MotorAmps", "motor_amp", "AMPS", "Ampere"):
        assert current_score(name, "") > 0
    assert not surely_machine("Vehicle speed") and not surely_machine("Android device battery level")
    assert all(map(surely_machine, ("Turbine", "machine_id", "Device ID", "SerialNumber", "AssetName")))
    assert split_unit("[Supply line (BT2)][°C][40008]") == ("Supply line (BT2)", "degC")
    assert split_unit("Current DL rate [KB/s]") == ("Current DL rate", "kB/s")
    assert named_time("Clock") and not named_time("Core Clock (MHz)_2")


def test_a_battery_that_empties_is_no_machine(tmp_path: Path) -> None:
    plant = recording()
    rows = [
        f"{m},{heat},{current},{97 - place // 40}"
        for place, (m, heat, current) in enumerate(zip(plant.moments, plant.heat, plant.current, strict=True))
    ]
    header = "Time,Bearing temperature,Motor current,Recording device battery"
    traces, _, _ = mapped(written(tmp_path / "a.csv", header, rows), tmp_path / "m.toml")
    assert len(traces) == 1


def test_marks_that_nobody_sees_do_not_part_names(tmp_path: Path) -> None:
    header = "Time,Bear\u00ading tempera\u00adture,Motor cur\u00adrent,Running"
    export = wide(tmp_path / "a.csv", header=header)
    (trace,), _, said = mapped(export, tmp_path / "m.toml", "--temperature", "Bearing temperature")
    is_the_plant(trace, tmp_path / "m.toml")
    assert "\u00ad" not in said["text"] and load_map(tmp_path / "m.toml").temperature == "Bearing_temperature"


def test_a_hundred_lines_of_settings_stand_before_the_header(tmp_path: Path) -> None:
    export = wide(tmp_path / "a.csv", header="Step time/s\tTemperature/°C\tI/A\tRunning", mark="\t")
    lines = export.read_text(encoding="utf-8").splitlines()
    begin = recording().moments[0]
    body = [
        f"{(m - begin).total_seconds():g}\t{(m - begin).total_seconds() % 100:g}\t" + line.split("\t", 1)[1]
        for m, line in zip(recording().moments, lines[1:], strict=True)
    ]
    settings = [f"Setting {number} : {number * 7}" for number in range(120)]
    written(export, settings[0], [*settings[1:], "time/s\tstep time/s\tTemperature/°C\tI/A\tRunning", *body])
    (trace,), _, said = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")
    assert said["clock"] == "time/s"


def test_a_column_that_was_added_later_costs_the_rows_before_it(tmp_path: Path) -> None:
    export = wide(tmp_path / "a.csv", header="Time,Bearing temperature,Motor current,Running,Mode")
    lines = export.read_text(encoding="utf-8").splitlines()
    written(export, lines[0], [*lines[1:41], *(f"{line},auto" for line in lines[41:])])
    (trace,), report, _ = mapped(export, tmp_path / "m.toml")
    assert trace.times.size == recording().heat.size - 40 and report.refused == 40
    assert np.allclose(trace.signals["Bearing_temperature"], recording().heat[40:], atol=0.006)


def test_a_row_that_was_cut_off_is_not_where_the_names_stand(tmp_path: Path) -> None:
    export = wide(tmp_path / "a.csv")
    lines = export.read_text(encoding="utf-8").splitlines()
    written(export, lines[0], [",°C,A,", lines[1], lines[2].split(",")[0], *lines[3:]])
    (trace,), report, said = mapped(export, tmp_path / "m.toml")
    assert said["temperature"] == "Bearing temperature" and trace.times.size == 239 and report.refused == 2


def test_the_end_of_a_value_told_with_what_follows_it_is_stored_on_change(tmp_path: Path) -> None:
    plant, rng = recording(times=4), np.random.default_rng(0)
    kept, last = [], 0
    for place in range(1, plant.heat.size):
        if abs(plant.heat[place] - plant.heat[last]) >= 0.8:
            # The old value once more, a second before the new one, as for a picture of steps; now and then not.
            before = plant.moments[place] - timedelta(seconds=1)
            kept += [f"{before},{plant.heat[last]}"] if rng.random() < 0.5 and place - last > 3 else []
            kept.append(f"{plant.moments[place]},{plant.heat[place]}")
            last = place
    _, _, said = mapped(written(tmp_path / "a.csv", "Time,Bearing temperature", kept), tmp_path / "m.toml")
    assert 'stored = "on change"' in said["text"]


def test_the_moment_of_the_export_is_its_last_row_in_another_form(tmp_path: Path) -> None:
    clock: Callable[..., str] = lambda m: f"{m:%Y-%m-%dT%H:%M:%S}+00:00"  # noqa: E731
    export = wide(tmp_path / "a.csv", clock=clock, of=recording(times=3))
    last = recording(times=3).moments[-1] + timedelta(seconds=10)
    form = last + timedelta(hours=1)
    row = f"{form:%a %b %d %Y %H:%M:%S} GMT+0100 (Central European Standard Time),30.0,0.4,0"
    export.write_text(export.read_text(encoding="utf-8") + row + "\n", encoding="utf-8")
    (trace,), report, _ = mapped(export, tmp_path / "m.toml")
    assert report.refused == 0 and trace.times[-1] - trace.times[-2] == 10.0


def test_whole_rows_of_which_nothing_repeats_are_rows_and_gaps(tmp_path: Path) -> None:
    plant, rng = recording(), np.random.default_rng(0)
    noise = rng.normal(0, 1, (plant.heat.size, 3))
    kept = [place for place in range(plant.heat.size) if place % 9 not in (3, 4, 5) or place < 60]
    rows = [
        f"{plant.moments[place]},{plant.heat[place] + 0.01 * noise[place, 0]:.4f},{plant.current[place] + 5:.2f},"
        f"{40 + noise[place, 1]:.4f},{7 + noise[place, 2]:.4f}"
        for place in kept
    ]
    header = "Time,Bearing temperature,Motor current,Flow,Pressure"
    (trace,), _, said = mapped(written(tmp_path / "a.csv", header, rows), tmp_path / "m.toml")
    assert "stored" not in said["text"] and trace.times.size == len(kept)


def test_a_role_is_drafted_for_what_its_name_says_as_a_word_and_not_for_another_part_of_the_plant() -> None:
    plays = {
        "ambient": [
            "TAmbiente",
            "AMB_TEMP",
            "Hallentemperatur",
            "Umgebungstemperatur",
            "Room temperature",
            "T_outside",
        ],
        "feed": ["TFango", "Feed temperature", "Temperatura ingresso fango", "Zulauf Temperatur"],
        "vibration": ["Vibration DE", "Schwinggeschwindigkeit"],
        "": [
            *("Chamber temperature", "Mushroom temperature", "Control room temperature", "Feed pump winding temp"),
            *("Cooling water inlet temperature", "Oil inlet temperature", "Température armoire alimentation"),
            *("Vibration threshold", "Ambient temperature setpoint", "Kühlwasser Zulauf Temperatur"),
        ],
    }
    for role, names in plays.items():
        for name in names:
            unit = "" if "ibration" in name or "Schwing" in name else "degC"
            assert [each for each, said in ROLE_WORDS.items() if said(name, unit)] == ([role] if role else []), name
