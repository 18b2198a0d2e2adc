"""Headers over several rows, clocks by weeks and days of the year, typed values, and readings of a current loop."""

import os
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from sim.lab.recordings import is_time, load_map, load_traces
from sim.lab.recordings.mapping import Answers, Undecided, draft_map
from sim.lab.recordings.mapping.clocks import bare_time
from sim.lab.recordings.mapping.columns import has_levels
from sim.lab.recordings.mapping.words import split_unit
from sim.lab.recordings.text_table import compose_names
from tests.traces.exports import comma, recording, wide, written
from tests.traces.test_dialects import EPOCH, asked, is_the_plant, mapped

PLANT = recording()
ROWS = list(zip(PLANT.moments, PLANT.heat.tolist(), PLANT.current.tolist(), PLANT.running.tolist(), strict=True))
BEGIN = (PLANT.moments[0] - EPOCH).total_seconds()

CLOCKS: dict[str, Callable[[datetime], str]] = {
    "week": lambda t: t.strftime("%G-W%V-%u %H:%M:%S"),
    "week in one word": lambda t: t.strftime("%GW%V%uT%H%M%S"),
    "week with its zone": lambda t: t.strftime("%G-W%V-%uT%H:%M:%SZ"),
    "day of the year": lambda t: t.strftime("%Y-%j %H:%M:%S"),
    "day of the year in one word": lambda t: t.strftime("%Y%jT%H%M%S"),
    "compact": lambda t: t.strftime("%Y%m%d_%H%M%S"),
    "compact with milliseconds": lambda t: t.strftime("%Y%m%d%H%M%S") + "000",
    "points and half a day": lambda t: t.strftime("%d-%b-%y %I.%M.%S.000000 %p").upper(),
    "French hours": lambda t: t.strftime("%d/%m/%Y %Hh%Mm%Ss"),
    "web server": lambda t: t.strftime("[%d/%b/%Y:%H:%M:%S +0000]"),
    "controller": lambda t: t.strftime("DT#%Y-%m-%d-%H:%M:%S"),
}


@pytest.mark.parametrize("form", CLOCKS)
def test_clocks_of_weeks_days_of_the_year_and_controllers(form: str, tmp_path: Path) -> None:
    (trace,), report, _ = mapped(wide(tmp_path / "a.csv", clock=CLOCKS[form]), tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")
    assert trace.times[0] == BEGIN and report.refused == 0


def test_a_month_is_no_day_of_the_year(tmp_path: Path) -> None:
    export = wide(tmp_path / "a.csv", clock=lambda t: t.strftime("%Y-%m %H:%M:%S"))
    assert "no column holds times" in asked(export, tmp_path / "m.toml")


@pytest.mark.parametrize("day", ["2024-03-13 00:00:00", "2024-03-13", "13.03.24"])
@pytest.mark.parametrize("time", ["%H:%M:%S", "%H.%M.%S"])
def test_a_day_with_a_midnight_of_its_own_is_that_of_the_time_beside_it(day: str, time: str, tmp_path: Path) -> None:
    rows = [f"{day};{moment.strftime(time)};{comma(heat)};{comma(current)}" for moment, heat, current, _ in ROWS]
    export = written(tmp_path / "a.csv", "Datum;Zeit;Lagertemperatur;Motorstrom", rows)
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")
    assert trace.times[0] == BEGIN


def test_a_year_of_two_digits_may_come_first_and_is_none_of_the_future(tmp_path: Path) -> None:
    """24-03-13 was the 24th of March 2013."""
    export = wide(tmp_path / "a.csv", clock=lambda t: t.strftime("%y-%m-%d %H:%M:%S"))
    assert "most likely 'year'" in asked(export, tmp_path / "m.toml")
    (trace,), _, _ = mapped(export, tmp_path / "m.toml", "--dates", "year")
    assert trace.times[0] == BEGIN
    export = wide(tmp_path / "b.csv", clock=lambda t: (t + timedelta(days=18)).strftime("%d-%m-%y %H:%M:%S"))
    os.utime(export, (BEGIN + 30 * 86400.0,) * 2)
    (trace,), _, _ = mapped(export, tmp_path / "n.toml")
    assert trace.times[0] == BEGIN + 18 * 86400.0


def test_which_dates_are_of_the_future_is_told_by_the_clock_that_is_handed_in(tmp_path: Path) -> None:
    """26-03-13 is the 26th of March 2013 until 2026: the draft asked the computer's own clock."""
    export = wide(tmp_path / "a.csv", clock=lambda t: (t + timedelta(days=730)).strftime("%y-%m-%d %H:%M:%S"))
    before, after = (datetime(year, 6, 1, tzinfo=UTC).timestamp() for year in (2020, 2030))
    assert "%d-%m-%y" in draft_map(export, Answers(), now=before).text
    with pytest.raises(Undecided, match="most likely 'year'"):
        draft_map(export, Answers(), now=after)


HEADERS = {
    "merged cells": (["Zeit;Lager;;Motor;", ";Temperatur;Qualität;Strom;Qualität", ";°C;;A;"], "Lager Temperatur",
                     True),
    "tag and quality": (["Date/Time;Bearing_T;;Motor_I;", ";Value;Quality;Value;Quality"], "Bearing_T", True),
    "names apart": ([";Lagertemperatur;;Motorstrom;", "Zeit;mittel;Qualität;mittel;Qualität"], "Lagertemperatur mittel",
                    True),
    "types and addresses": (["Time;Bearing temp;Motor current", ";DB10.DBD0;DB10.DBD4", ";Real;Real", "s;°C;A",
                             "DT_DOUBLE;DT_DOUBLE;DT_DOUBLE"], "Bearing temp", False),
    "marks in names": (['Time;"DB1".Bearing_temp;"DB1".Motor_current'], "DB1.Bearing_temp", False),
}  # fmt: skip


@pytest.mark.parametrize("case", HEADERS)
def test_names_that_stand_in_several_rows(case: str, tmp_path: Path) -> None:
    """Of merged cells no column was named; of `"DB1".Speed` the map was drafted and read no file."""
    above, temperature, quality = HEADERS[case]
    word = {False: "good", True: "bad"}
    rows = [
        f"{moment};{heat};{word[place == 7]};{current};good" if quality else f"{moment};{heat};{current}"
        for place, (moment, heat, current, _) in enumerate(ROWS)
    ]
    (trace,), _, said = mapped(written(tmp_path / "a.csv", "\n".join(above), rows), tmp_path / "m.toml")
    assert said["temperature"] == temperature
    heat = trace.signals[load_map(tmp_path / "m.toml").temperature]
    expected = np.where(np.arange(PLANT.heat.size) == 7, np.nan, PLANT.heat) if quality else PLANT.heat
    assert np.array_equal(heat, expected, equal_nan=True)


def test_a_workbook_with_merged_cells_and_a_column_of_days(tmp_path: Path) -> None:
    from openpyxl import Workbook

    book = Workbook()
    for row in ([None], ["Zeit", None, "Lager", None], ["Tag", "Uhrzeit", "Temperatur °C", "Strom A"]):
        book.active.append(row)
    for moment, heat, current, _ in ROWS:
        book.active.append([moment.date(), moment.time(), heat, current])
    book.save(tmp_path / "a.xlsx")
    (trace,), _, said = mapped(tmp_path / "a.xlsx", tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")
    assert trace.times[0] == BEGIN and said["temperature"] == "Temperatur °C"


@pytest.mark.parametrize("count", ["638112150000000000", "1710123012000000000", "133548394200000000"])
def test_ticks_and_nanoseconds_are_no_compact_dates(count: str) -> None:
    assert not is_time(count)


def test_currents_that_are_called_as_inputs_are_names(tmp_path: Path) -> None:
    rows = [f"{m},{current},{heat}" for m, heat, current, _ in ROWS]
    export = written(tmp_path / "a.csv", "Logger 7,of,Hall 2\nTime,I1,T1", rows)
    (trace,), _, said = mapped(export, tmp_path / "m.toml")
    assert np.array_equal(trace.signals["T1"], PLANT.heat) and said["temperature"] == "T1"


def test_names_over_names() -> None:
    assert compose_names(["t", "A", "", "B"], ["", "Value", "Quality", "max", "min"]) == [
        "t",
        "A",
        "A Quality",
        "B max",
        "B min",
    ]


def test_a_reading_stands_in_the_column_of_its_type(tmp_path: Path) -> None:
    """The columns were signals, and the tags machines with a trace each."""
    rows = [
        line
        for moment, heat, current, running in ROWS
        for line in (f"brg_temp,{moment},{heat},,192", f"motor_current,{moment},{current},,192",
                     f"motor_run,{moment},,{running},192")
    ]  # fmt: skip
    export = written(tmp_path / "a.csv", "tagpath,t_stamp,floatvalue,intvalue,dataintegrity", rows)
    (trace,), report, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")
    # A cell beside one that was taken is counted.
    rows[5] = rows[5].replace(",,", ",3,")
    written(export, "tagpath,t_stamp,floatvalue,intvalue,dataintegrity", rows)
    text = (tmp_path / "m.toml").read_text(encoding="utf-8")
    assert 'value = ["floatvalue", "intvalue"]' in text
    assert report.files[0].unused["intvalue"] == 0


@pytest.mark.parametrize("bad", ["0x80310000", "0x40000000"])
def test_a_status_code_of_opc_ua_is_a_quality(bad: str, tmp_path: Path) -> None:
    rows = [f"{m};{heat};{bad if place == 9 else '0x00000000'};{current}" for place, (m, heat, current, _) in
            enumerate(ROWS)]  # fmt: skip
    export = written(tmp_path / "a.csv", "Time;Bearing temp;StatusCode;Motor current", rows)
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    heat = trace.signals[load_map(tmp_path / "m.toml").temperature]
    assert np.flatnonzero(np.isnan(heat)).tolist() == [9]


def test_each_of_two_columns_of_quality_judges_its_own(tmp_path: Path) -> None:
    rows = [f"{m};{heat};{24 if place == 9 else 192};{current};192" for place, (m, heat, current, _) in enumerate(ROWS)]
    export = written(tmp_path / "a.csv", "Time;Bearing temp;Q;Motor current;Q", rows)
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    assert [int(np.isnan(column).sum()) for name, column in trace.signals.items() if name != "Running"] == [1, 0]


def test_readings_of_a_current_loop_without_a_unit_are_asked_for(tmp_path: Path) -> None:
    """A bearing of 20 to 60 degC was read as one of 6 to 10 degC, and a motor that stands as one that draws 4 A."""
    loop = wide(tmp_path / "a.csv", cells=(lambda heat: f"{4 + 16 * heat / 150:.3f}", str, str))
    said = asked(loop, tmp_path / "m.toml")
    assert "4 to 20 mA" in said and "--unit 'Bearing temperature=degC'" in said
    mapped(loop, tmp_path / "m.toml", "--unit", "Bearing temperature=degC")
    loop = wide(tmp_path / "b.csv", cells=(str, lambda current: f"{4 + 16 * current / 200:.3f}", str))
    said = asked(loop, tmp_path / "n.toml")
    assert "rests at 4.03 and goes to 16.1," in said and "--unit 'Motor current=A'" in said
    mapped(loop, tmp_path / "n.toml", "--yes")


@pytest.mark.parametrize("cold", [1.0, 4.1, 10.6])
def test_a_cold_machine_is_no_loop(cold: float, tmp_path: Path) -> None:
    """Each that was never warmer than 21 degC was asked for, and without a guess."""
    export = wide(tmp_path / "a.csv", cells=(lambda heat: f"{cold + (heat - 21.0) / 5:.1f}", str, str))
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    heat = trace.signals[load_map(tmp_path / "m.toml").temperature]
    assert np.allclose(heat, cold + (PLANT.heat - 21.0) / 5, atol=0.051)


@pytest.mark.parametrize("idle", ["4.0", "4.1", "4.13"])
def test_a_motor_that_draws_4_a_without_a_load_is_no_loop(idle: str, tmp_path: Path) -> None:
    """It was asked for, without a guess."""
    export = wide(tmp_path / "a.csv", cells=(str, lambda current: idle if current < 1 else f"{current / 10:.1f}", str))
    mapped(export, tmp_path / "m.toml")


@pytest.mark.parametrize(
    ("header", "name", "unit"),
    [
        *((spelling, spelling, "degC") for spelling in ("temp_c", "TempC", "temp_deg_c", "Temperatur_GradC",
                                                         "T °C DE", "TEMP_CELSIUS")),
        ("Lagertemp. [Grad C]", "Lagertemp.", "degC"),
        ("temp_f", "temp", "degF"),
        ("T °F DE", "T DE", "degF"),
        ("BEARING TEMP DEG F", "BEARING TEMP", "degF"),
        ("Temp °C per min", "Temp °C per min", ""),
        ("tempo_c", "tempo_c", ""),
    ],
)  # fmt: skip
def test_units_of_a_temperature_in_its_name(header: str, name: str, unit: str) -> None:
    """A loop's mA, or degC, were asked of columns that say what they are in; degF were believed to be degC."""
    assert split_unit(header) == (name, unit)


@pytest.mark.parametrize("names", [("temp_a", "temp_b", "temp_c"), ("Temp F", "Temp E", "Temp D")])
def test_letters_of_places_are_no_units(names: Sequence[str], tmp_path: Path) -> None:
    rows = [f"{moment},{heat},{heat + 1},{heat + 2},{current}" for moment, heat, current, _ in ROWS]
    export = written(tmp_path / "a.csv", f"Time,{','.join(names)},Motor current", rows)
    said = asked(export, tmp_path / "m.toml")
    assert all(f"'{name}' (" in said for name in names) and "degC" not in said


@pytest.mark.parametrize(
    ("header", "units"),
    [
        ("Time,Bearing temp,Motor current,Acc DE,Acc NDE,Env", "-,degF,A,g rms,g rms,gE"),
        ("Time,Bearing temp,Motor current,Feed,Level,Text", "ISO,°F,A,pieces an hour,per cent of the tank,Text"),
    ],
)
def test_a_row_of_units_of_which_most_are_unknown_is_one(header: str, units: str, tmp_path: Path) -> None:
    """It became the header."""
    rows = [f"{moment},{1.8 * float(heat) + 32:.2f},{current},1,2,3" for moment, heat, current, _ in ROWS]
    export = written(tmp_path / "a.csv", f"{header}\n{units}", rows)
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")


def test_a_note_of_several_lines_is_one_cell(tmp_path: Path) -> None:
    rows = [f'{m},"opened\nby ""hand""",{heat},{current}' for m, heat, current, _ in ROWS]
    export = written(tmp_path / "a.csv", "Time,Note,Bearing temperature,Motor current", rows)
    (trace,), report, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")
    assert report.refused == 0


def test_inches_open_no_cell_and_lines_above_a_blank_one_are_no_names(tmp_path: Path) -> None:
    rows = [f'{m},{heat},{current},5" line' for m, heat, current, _ in ROWS]
    header = "Report,,Plant 1,\n\nTime,Value,Value,Place"
    export = written(tmp_path / "a.csv", header, rows)
    (trace,), report, _ = mapped(export, tmp_path / "m.toml", "--temperature", "Value", "--current", "Value_2")
    assert np.array_equal(trace.signals["Value"], PLANT.heat) and report.refused == 0


@pytest.mark.parametrize("header", ["Motor current", "Motor [mA]", "Bearing [V]"])
def test_a_load_is_no_temperature_where_it_is_the_only_column_of_numbers(header: str, tmp_path: Path) -> None:
    """A bearing whose cells were all blank left the motor's current, of which a model would have been learned."""
    export = written(tmp_path / "a.csv", f"Time,Bearing,{header}", [f"{m},,{current}" for m, _, current, _ in ROWS])
    assert f"--temperature '{header}'" in asked(export, tmp_path / "m.toml", "--yes")


def test_numbers_of_rows_are_no_load() -> None:
    assert not has_levels(np.arange(300.0)) and has_levels(PLANT.current)


def test_a_minus_of_typesetters_is_one(tmp_path: Path) -> None:
    export = wide(tmp_path / "a.csv", cells=(lambda heat: f"{heat - 30:.2f}".replace("-", "\N{MINUS SIGN}"), str, str))
    (trace,), report, _ = mapped(export, tmp_path / "m.toml")
    assert np.allclose(trace.signals[load_map(tmp_path / "m.toml").temperature], PLANT.heat - 30, atol=0.006)
    assert report.files[0].bad_cells == 0


def test_0_degf_is_no_temperature_of_a_warm_bearing(tmp_path: Path) -> None:
    rows = [f"{m},{-17.8 if place % 60 == 50 else heat},{current}" for place, (m, heat, current, _) in enumerate(ROWS)]
    export = written(tmp_path / "a.csv", "Time,Bearing temperature,Motor current", rows)
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    assert np.isnan(trace.signals[load_map(tmp_path / "m.toml").temperature]).sum() == 4


YEAR_FIRST, DAY_FIRST = "%y-%m-%d %H:%M:%S", "%d-%m-%y %H:%M:%S"
SEVERAL_DAYS = recording(step=600.0, times=400)
"""Eight days, with a row every ten minutes."""


@pytest.mark.parametrize("form", [YEAR_FIRST, DAY_FIRST, "%y/%m/%d %H:%M:%S", "%d/%m/%y %H:%M:%S"])
def test_a_date_that_does_not_jump_is_the_right_one_however_it_is_written(form: str, tmp_path: Path) -> None:
    """24-03-24 to 24-03-30 were six years, to 2030, by the first 400 rows."""
    later = timedelta(days=11)
    export = wide(tmp_path / "a.csv", clock=lambda t: (t + later).strftime(form), of=SEVERAL_DAYS)
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    begin = BEGIN + later.total_seconds()
    assert trace.times[0] == begin and trace.times[-1] == begin + SEVERAL_DAYS.seconds[-1]


@pytest.mark.parametrize("order", ["year", "day"])
def test_what_a_person_says_of_a_date_is_so_whatever_is_likelier(order: str, tmp_path: Path) -> None:
    form = {"year": YEAR_FIRST, "day": DAY_FIRST}[order]
    export = wide(tmp_path / "a.csv", clock=lambda t: t.replace(year=2022, day=23).strftime(form))
    assert "give --dates year or --dates day" in asked(export, tmp_path / "m.toml", "--yes")
    (trace,), _, _ = mapped(export, tmp_path / "m.toml", "--dates", order)
    assert trace.times[0] == (PLANT.moments[0].replace(year=2022, day=23) - EPOCH).total_seconds()


@pytest.mark.parametrize(
    ("form", "header", "mark"),
    [
        ("%d/%m/%y %H:%M:%S", "Date,Bearing temperature [°C],Motor current [A],Running", ","),
        (DAY_FIRST, "Data;Temperatura cuscinetto [°C];Corrente motore [A];Marcia", ";"),
        ("%d/%m/%y %H:%M:%S", "Datum;Lagertemperatur [°C];Motorstrom [A];Betrieb", ";"),
        (DAY_FIRST, "Date,Bearing temperature [°C],Motor current [A],Running", ","),
    ],
)
def test_the_day_of_one_day_comes_first_where_the_mark_or_the_language_says_so(
    form: str, header: str, mark: str, tmp_path: Path
) -> None:
    """25/03/24 was asked for, with 2025 as the likeliest."""
    later = 12 if mark == ";" or "/" in form else -10
    cell = comma if mark == ";" else str
    export = wide(
        tmp_path / "a.csv",
        header=header,
        clock=lambda t: (t + timedelta(days=later)).strftime(form),
        cells=(cell, cell, str),
        mark=mark,
    )
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    assert trace.times[0] == BEGIN + later * 86400.0


DAYS_AND_TIMES = {
    "points between hours and minutes": ("Datum;Uhrzeit", "%d.%m.%Y;%H.%M"),
    "without the zero of the hour": ("Data;Ora", "%d/%m/%Y;{hour}.%M"),
    "whole numbers": ("Date;Time", "%Y%m%d;%H%M%S"),
    "hours and minutes in one number": ("Day;Hour", "%Y-%m-%d;%H%M"),
    "the day alone a number": ("Date;Time", "%Y%m%d;%H:%M:%S"),
    "a foot below": ("Date;Time", "%Y-%m-%d;%H:%M:%S"),
    "day of the week": ("Tag;Zeit", "%a %d.%m.%Y;%H:%M:%S"),
    "day of the week and month in words": ("Tag;Zeit", "Mittwoch, %d. März %Y;%H:%M:%S"),
    "day of the week behind": ("Day;Time", "%Y-%m-%d %a;%H.%M"),
}  # fmt: skip


@pytest.mark.parametrize("case", DAYS_AND_TIMES)
def test_days_and_times_in_two_columns(case: str, tmp_path: Path) -> None:
    """06.00 beside a date was read as seconds, and the date was lost; so was that of a day of the week."""
    header, form = DAYS_AND_TIMES[case]
    rows = [
        f"{moment.strftime(form.replace('{hour}', str(moment.hour)))};{comma(heat)};{comma(current)}"
        for minute, (_, heat, current, _) in enumerate(ROWS)
        for moment in [PLANT.moments[0] + timedelta(minutes=minute)]
    ]
    foot = ["Total;;;"] if case == "a foot below" else []
    export = written(tmp_path / "a.csv", f"{header};Lagertemperatur;Motorstrom", [*rows, *foot])
    (trace,), report, _ = mapped(export, tmp_path / "m.toml")
    assert report.refused == len(foot) and np.array_equal(trace.times, BEGIN + 60.0 * np.arange(len(ROWS)))


def test_numbers_under_a_name_of_time_are_times_of_day_only_where_all_can_be() -> None:
    assert bare_time(["06.00", "06.50", "07.00"], "Zeit") == "" == bare_time(["0.25", "0.75"], "Zeit")
    assert bare_time(["06.00", "06.30"], "Time [h]") == "" == bare_time(["0600", "0600"], "Time")
    assert bare_time(["6.00", "16.30"], "Zeit") == "%H.%M" and bare_time(["0600", "2359"], "Zeit") == "%H%M"
    assert bare_time(["060000", "235960"], "Time") == "" and bare_time(["060000", "235959"], "Time") == "%H%M%S"


@pytest.mark.parametrize("name", ["Runtime", "Duration", "Laufzeit", "Durata", "Durée", "Cycle time"])
def test_how_long_something_took_is_no_time_of_the_day_beside_it(name: str, tmp_path: Path) -> None:
    """A day with 07:35:00 of runtime became half past seven of that day."""
    days = [(PLANT.moments[0].replace(hour=0, minute=0) + timedelta(days=day)) for day in range(len(ROWS))]
    rows = [f"{day},{8 + at % 3:02}:35:00,{ROWS[at][1]},{ROWS[at][2]}" for at, day in enumerate(days)]
    export = written(tmp_path / "a.csv", f"Date,{name},Bearing temperature,Motor current", rows)
    (trace,), _, said = mapped(export, tmp_path / "m.toml")
    assert said["clock"] == "Date" and np.all(np.diff(trace.times) == 86400.0)
    assert trace.times[0] == (days[0] - EPOCH).total_seconds()
    export.write_text(export.read_text().replace(" 00:00:00", ""))
    assert "nothing says the time of day" in asked(export, tmp_path / "n.toml")


def test_of_two_columns_of_days_the_one_that_moves_with_midnight_or_is_called_date(tmp_path: Path) -> None:
    """The first one was taken, whatever it was called."""
    for count, name, other in ((180, "Production day", "Batch date"), (20, "Date", "Batch date")):
        moments = [PLANT.moments[0] + timedelta(minutes=10 * at) for at in range(count)]
        rows = [f"2024-01-02,{t:%H:%M:%S},{t:%Y-%m-%d},{20 + at % 7},{at % 9}" for at, t in enumerate(moments)]
        export = written(tmp_path / f"{count}.csv", f"{other},Time,{name},Bearing temperature,Motor current", rows)
        (trace,), _, _ = mapped(export, tmp_path / f"{count}.toml")
        assert trace.times[0] == BEGIN and trace.times[-1] == BEGIN + 600.0 * (count - 1)
    export.write_text(export.read_text().replace("Date,", "Production day,", 1))
    assert "may stand in 'Batch date' or in 'Production day'" in asked(export, tmp_path / "n.toml")
    lines = export.read_text().splitlines()
    with_clock = [
        f"Timestamp,{lines[0]}",
        *(f"{t:%Y-%m-%d %H:%M:%S},{line}" for t, line in zip(moments, lines[1:], strict=True)),
    ]
    export.write_text("\n".join([*with_clock, ""]))
    assert mapped(export, tmp_path / "o.toml")[2]["clock"] == "Timestamp"


def test_a_row_of_units_under_a_day_and_a_time_is_no_row(tmp_path: Path) -> None:
    rows = [f"{moment:%d.%m.%Y;%H:%M:%S};{comma(heat)};{comma(current)}" for moment, heat, current, _ in ROWS]
    export = written(tmp_path / "a.csv", "Datum;Zeit;Lager;Motor", [";;°C;A", *rows])
    (trace,), report, _ = mapped(export, tmp_path / "m.toml")
    assert report.refused == 0 and report.rows == len(ROWS) and trace.times[0] == BEGIN
    assert trace.units["Lager"] == "degC" and trace.units["Motor"] == "A"
    export = written(tmp_path / "a.csv", "Datum;Zeit;Lager;Motor", [";;21,5;A", *rows])
    assert load_traces(export, load_map(tmp_path / "m.toml"))[1].refused == 1


@pytest.mark.parametrize("names", ["Year,DOY", "Jahr,Tag", "Year,Day of year"])
def test_a_day_of_the_year_in_a_column_of_its_own_is_not_lost_in_silence(names: str, tmp_path: Path) -> None:
    rows = [f"{moment:%Y,%j,%H:%M:%S},{heat},{current}" for moment, heat, current, _ in ROWS]
    export = written(tmp_path / "a.csv", f"{names},Time,Bearing temperature,Motor current", rows)
    said = asked(export, tmp_path / "m.toml")
    assert f"columns of their own, {names.replace(',', ', ')}: join them" in said and "--time 'Time'" in said
    (trace,), _, _ = mapped(export, tmp_path / "m.toml", "--time", "Time")
    assert np.array_equal(np.diff(trace.times), np.diff(PLANT.seconds))
