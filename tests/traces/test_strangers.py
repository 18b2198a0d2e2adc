"""Exports of programs and people that were read wrong, or refused for what they are: JSON, long times, Fahrenheit."""

import json
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from sim.lab.recordings import load_map, load_traces
from tests.traces.exports import Recording, comma, recording, wide, written
from tests.traces.test_dialects import EPOCH, asked, is_the_plant, mapped

PLANT = recording()
ROWS = list(zip(PLANT.moments, PLANT.heat.tolist(), PLANT.current.tolist(), PLANT.running.tolist(), strict=True))
BEGIN = (PLANT.moments[0] - EPOCH).total_seconds()
NAMES = ("bearing_temperature", "motor_current", "running")


def lines_of_rows() -> str:
    return "\n".join(
        json.dumps({"time": f"{moment:%Y-%m-%dT%H:%M:%S}Z", **dict(zip(NAMES, (heat, load, bool(on)), strict=True))})
        for moment, heat, load, on in ROWS
    )


def lines_of_readings() -> str:
    return "\n".join(
        json.dumps({"topic": f"plant/{name}", "payload": value, "ts": int((row[0] - EPOCH).total_seconds() * 1000)})
        for row in ROWS
        for name, value in zip(NAMES, row[1:], strict=True)
    )


def nested_lines() -> str:
    return "\n".join(
        json.dumps({"ts": (moment - EPOCH).total_seconds(), "bearing": {"temp_c": heat},
                    "motor": {"amps": load, "on": on}, **({"note": "greased, ok"} if place % 50 == 7 else {})})
        for place, (moment, heat, load, on) in enumerate(ROWS)
    )  # fmt: skip


def document() -> str:
    rows = [dict(zip(("time", *NAMES), (str(moment), *values), strict=True)) for moment, *values in ROWS]
    return json.dumps({"status": "ok", "data": rows}, indent=1)


def telemetry() -> str:
    return json.dumps(
        {
            name: [{"ts": int((row[0] - EPOCH).total_seconds() * 1000), "value": str(row[place])} for row in ROWS]
            for place, name in enumerate(NAMES, 1)
        }
    )


def states() -> str:
    units = ("°C", "A", None)
    return json.dumps(
        [
            [{"entity_id": f"sensor.{name}", "state": str(row[place]), "last_changed": f"{row[0]:%Y-%m-%dT%H:%M:%S}Z",
              "attributes": {"unit_of_measurement": unit}} for row in ROWS]
            for place, (name, unit) in enumerate(zip(NAMES, units, strict=True), 1)
        ]
    )  # fmt: skip


def columns(form: str) -> str:
    own = {"time": [str(row[0]) for row in ROWS]}
    own |= {name: [row[place] for row in ROWS] for place, name in enumerate(NAMES, 1)}
    if form == "series":
        table = {"name": "plant", "columns": list(own), "values": list(zip(*own.values(), strict=True))}
        return json.dumps({"results": [{"series": [table]}]})
    if form == "split":
        return json.dumps({"columns": list(own), "data": list(zip(*own.values(), strict=True))})
    if form == "by number":
        return json.dumps({name: {str(place): value for place, value in enumerate(own[name])} for name in own})
    return json.dumps(own)


FORMS: dict[str, Callable[[], str]] = {
    "rows.jsonl": lines_of_rows, "rows.log": lines_of_rows, "readings.ndjson": lines_of_readings,
    "nested.txt": nested_lines, "document.json": document, "telemetry.json": telemetry,
    "split.json": lambda: columns("split"), "frame.json": lambda: columns("by number"),
    "columns.json": lambda: columns("columns"), "series.json": lambda: columns("series"), "states.json": states,
}  # fmt: skip


@pytest.mark.parametrize("name", FORMS)
def test_json_has_a_row_for_each_object(name: str, tmp_path: Path) -> None:
    export = tmp_path / name
    export.write_text(FORMS[name]() + "\n", encoding="utf-8")
    (trace,), report, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")
    assert trace.times[0] == BEGIN and report.refused == 0


def lists_of_readings(form: str) -> str:
    keys = {"points": ("t", "v"), "series": ("x", "y")}.get(form, ("time", "value"))
    own = {
        name: [dict(zip(keys, (str(row[0]), row[place]), strict=True)) for row in ROWS]
        for place, name in enumerate(NAMES, 1)
    }
    tables = {name: {"columns": list(keys), "values": [list(each.values()) for each in own[name]]} for name in NAMES}
    return json.dumps(
        {
            "points": own,
            "series": {"series": [{"name": name, "data": rows} for name, rows in own.items()]},
            "tags": [{"tag": name, "values": rows} for name, rows in own.items()],
            "tables": {"results": [{"id": 0, "series": [{"name": name, **each} for name, each in tables.items()]}]},
            "tagged": {"results": [{"series": [{"name": "m", "tags": {"tag": name}, **tables[name]} for name in own]}]},
            "machines": {"p1": own, "p2": own},
            "nameless": [{"values": rows} for rows in own.values()],
        }[form]
    )


@pytest.mark.parametrize("form", ["points", "series", "tags", "tables", "tagged"])
def test_json_with_a_list_for_each_signal_has_their_names(form: str, tmp_path: Path) -> None:
    export = tmp_path / "a.json"
    export.write_text(lists_of_readings(form), encoding="utf-8")
    (trace,), report, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")
    assert trace.times[0] == BEGIN and report.refused == 0


def test_lists_of_readings_of_several_machines_are_theirs_and_nameless_ones_are_refused(tmp_path: Path) -> None:
    export = tmp_path / "a.json"
    export.write_text(lists_of_readings("machines"), encoding="utf-8")
    traces, _, _ = mapped(export, tmp_path / "m.toml")
    assert len(traces) == 2
    for trace in traces:
        is_the_plant(trace, tmp_path / "m.toml")
    export.write_text(lists_of_readings("nameless"), encoding="utf-8")
    assert "no name tells them apart" in asked(export, tmp_path / "n.toml")
    export.write_text(
        json.dumps({name: [{"time": str(row[0]), "temperature": row[1]} for row in ROWS] for name in ("p1", "p2")}),
        encoding="utf-8",
    )
    assert len(mapped(export, tmp_path / "o.toml")[0]) == 2


@pytest.mark.parametrize("more", [1, -1])
def test_a_row_of_other_than_a_cell_for_each_column_that_its_json_names_is_refused(more: int, tmp_path: Path) -> None:
    document = json.loads(columns("split"))
    width = len(document["columns"])
    document["data"][6] = [*document["data"][6], 9.0][: width + more]
    export = tmp_path / "e.json"
    export.write_text(json.dumps(document), encoding="utf-8")
    said = asked(export, tmp_path / "m.toml")
    assert f"row 7 of its JSON has {width + more} cells, and it names {width} columns" in said


def test_a_csv_is_one_below_a_line_of_json_and_under_the_name_of_json(tmp_path: Path) -> None:
    plain = wide(tmp_path / "a.csv").read_text(encoding="utf-8")
    for name, head in (("b.csv", '{"device": "X1", "serial": 12}\n'), ("c.json", "")):
        (tmp_path / name).write_text(head + plain, encoding="utf-8")
        (trace,), _, _ = mapped(tmp_path / name, tmp_path / f"{name}.toml")
        is_the_plant(trace, tmp_path / f"{name}.toml")


def test_json_beside_other_recordings_is_none_of_them(tmp_path: Path) -> None:
    folder = tmp_path / "days"
    (folder / "below").mkdir(parents=True)
    wide(folder / "day1.csv")
    for name in ("events.jsonl", "about.json"):
        (folder / name).write_text('{"time": "2024-03-13 10:00:00", "event": "greased"}\n' * 3, encoding="utf-8")
    (trace,), _, _ = mapped(folder, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")
    (folder / "day1.csv").rename(folder / "below" / "day1.csv")
    (trace,), report = load_traces(folder, load_map(tmp_path / "m.toml"))
    assert [each.path.name for each in report.files] == ["day1.csv"]
    alone = tmp_path / "alone"
    alone.mkdir()
    (alone / "day1.json").write_text(document(), encoding="utf-8")
    (trace,), _, _ = mapped(alone, tmp_path / "n.toml")
    is_the_plant(trace, tmp_path / "n.toml")


def test_a_line_that_is_cut_off_costs_its_row_and_json_without_rows_is_refused(tmp_path: Path) -> None:
    export = tmp_path / "a.jsonl"
    export.write_text('{"export": 2, "by": "me"}\n' + lines_of_rows()[:-20], encoding="utf-8")
    (trace,), report, _ = mapped(export, tmp_path / "m.toml")
    assert report.refused == 2 and trace.times.size == PLANT.heat.size - 1
    for text in ('{"version": 3}', "[1, 2, 3]", "[]", '{"a": ', "3", '[{"columns": ["a"], "data": true}]'):
        (tmp_path / "b.json").write_text(text, encoding="utf-8")
        said = asked(tmp_path / "b.json", tmp_path / "n.toml")
        assert "b.json" in said and "JSON" in said.upper() and "Traceback" not in said


def clock_of(seconds: float, form: str) -> str:
    days, rest = divmod(int(seconds), 86400)
    hours, rest = divmod(rest, 3600)
    minutes, second = divmod(rest, 60)
    return {
        "hours": f"{24 * days + hours:02d}:{minutes:02d}:{second:02d}",
        "wraps": f"{hours:02d}:{minutes:02d}:{second:02d}",
        "timespan": f"{days}.{hours:02d}:{minutes:02d}:{second:02d}",
        "timedelta": f"{days} days {hours:02d}:{minutes:02d}:{second:02d}",
        "python": f"{days} day{'s' * (days != 1)}, {hours}:{minutes:02d}:{second:02d}",
    }[form]


@pytest.mark.parametrize("begin", [85_000.0, 99 * 3600.0])
@pytest.mark.parametrize("form", ["hours", "wraps", "timespan", "timedelta", "python"])
def test_elapsed_times_go_on_beyond_a_day(form: str, begin: float, tmp_path: Path) -> None:
    first = PLANT.moments[0]
    export = wide(
        tmp_path / "a.csv",
        header='"Elapsed time","Bearing temperature","Motor current","Running"',
        clock=lambda moment: f'"{clock_of((moment - first).total_seconds() + begin, form)}"',
    )
    (trace,), report, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")
    assert report.refused == 0


def test_a_time_of_day_that_was_damaged_is_no_elapsed_one(tmp_path: Path) -> None:
    def clock(moment: datetime) -> str:
        text = f"{moment + timedelta(hours=13.7):%H:%M:%S}"
        return f"3{text[1:]}" if moment == PLANT.moments[20] else text

    (trace,), report, _ = mapped(wide(tmp_path / "a.csv", clock=clock), tmp_path / "m.toml")
    assert report.refused == 1 and np.diff(trace.times).max() == 20.0


def test_a_pause_of_days_in_elapsed_time_is_as_long_as_it_is_told(tmp_path: Path) -> None:
    first = PLANT.moments[0]

    def clock(moment: datetime) -> str:
        seconds = (moment - first).total_seconds()
        return clock_of(seconds + 80_000.0 + (200_000.0 if seconds >= 1200 else 0.0), "hours")

    (trace,), _, _ = mapped(
        wide(tmp_path / "a.csv", header="Elapsed,Bearing temperature,Motor current,Running", clock=clock),
        tmp_path / "m.toml",
    )
    assert np.diff(trace.times).max() == 200_010.0


def test_minutes_and_seconds_are_read_where_the_header_says_so(tmp_path: Path) -> None:
    first = PLANT.moments[0]
    export = wide(
        tmp_path / "a.csv",
        header="Elapsed (mm:ss),Bearing temperature,Motor current,Running",
        clock=lambda t: "{:02.0f}:{:02.0f}".format(*divmod((t - first).total_seconds() + 3000, 60)),
    )
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")


@pytest.mark.parametrize(
    ("header", "count"),
    [("Hour", 3600.0), ("Stunde [h]", 3600.0), ("Decimal hour", 3600.0), ("Time (h)", 3600.0), ("Time", 86400.0)],
)
@pytest.mark.parametrize("later", [0.0, 13.5])
def test_decimal_hours_after_a_date_are_counted_from_its_midnight(
    header: str, count: float, later: float, tmp_path: Path
) -> None:
    moments = [moment + timedelta(hours=later) for moment in PLANT.moments]
    rows = [
        f"{moment:%d.%m.%Y};{comma(round((moment.hour * 3600 + moment.minute * 60 + moment.second) / count, 7))};"
        f"{comma(heat)};{comma(load)};{on}"
        for moment, (_, heat, load, on) in zip(moments, ROWS, strict=True)
    ]
    export = written(tmp_path / "a.csv", f"Datum;{header};Lagertemperatur;Motorstrom;Ein", rows)
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    assert np.allclose(trace.times, BEGIN + 3600 * later + PLANT.seconds, atol=0.01)


def test_a_day_that_stands_in_the_first_row_alone_is_told_as_that(tmp_path: Path) -> None:
    rows = [f"{'' if at else '13/03/2024'},{row[0]:%H:%M:%S},{row[1]},{row[2]}" for at, row in enumerate(ROWS)]
    export = written(tmp_path / "a.csv", "Date,Time,Bearing temperature,Motor current", rows)
    assert "stands in 1 of 240 rows; write it in each" in asked(export, tmp_path / "m.toml")


def test_seconds_since_the_beginning_stay_what_they_are_beside_a_constant_date(tmp_path: Path) -> None:
    rows = [f"2024-03-13,{place * 10 + 0.5},{heat},{load}" for place, (_, heat, load, _) in enumerate(ROWS)]
    export = written(tmp_path / "a.csv", "Date,Time [s],Bearing temperature,Motor current", rows)
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    assert trace.times[0] == 0.5


@pytest.mark.parametrize(
    ("header", "count", "format_"),
    [("Time (s)", 1.0, "seconds"), ("Timestamp (ms)", 0.001, "milliseconds"), ("Time (h)", 3600.0, "hours")],
)
@pytest.mark.parametrize("kind", ["over midnight", "sessions"])
def test_a_count_from_the_beginning_is_none_since_the_midnight_that_it_passes(
    header: str, count: float, format_: str, kind: str, tmp_path: Path
) -> None:
    rows = []
    for place, (_, heat, load, on) in enumerate(ROWS):
        seconds = 10 * (place % 120 if kind == "sessions" else place)
        rows.append(f"2024-03-{13 + (place >= 120)},{seconds / count:.6g},{heat},{load},{on}")
    export = written(tmp_path / "a.csv", f"Date,{header},Bearing temperature,Motor current,Running", rows)
    traces, _, _ = mapped(export, tmp_path / "m.toml")
    assert load_map(tmp_path / "m.toml").clock.formats == (format_,)
    assert [trace.times[0] for trace in traces] == ([0.0, 0.0] if kind == "sessions" else [0.0])


def fahrenheit(value: float) -> str:
    return f"{value * 1.8 + 32:.1f}"


def of_hours(rest: float, *, begin: float = 60.0, rise: float = 40.0, slow: float = 0.0) -> Recording:
    """A machine that rests 2 h, runs 2 h and rests 3 h; of its rise `slow` degrees go into its housing."""
    seconds = np.arange(420) * 60.0
    running = ((seconds >= 7200) & (seconds < 14400)).astype(int)
    after = np.maximum(seconds - 14400.0, 0.0)
    cooling = (rise - slow) * np.exp(-after / 600.0) + slow * np.exp(-after / 20_000.0)
    settling = begin * np.exp(-seconds / 600.0)
    heat = np.where(running > 0, rest + rise, rest + np.where(seconds < 7200, settling, cooling)).round(2)
    return Recording(seconds, heat, np.where(running > 0, 120.0, 0.4), running)


def test_a_bearing_in_fahrenheit_that_no_one_calls_so_is_asked_for(tmp_path: Path) -> None:
    plant = of_hours(21.5)
    export = wide(tmp_path / "a.csv", cells=(fahrenheit, str, str), of=plant)
    said = asked(export, tmp_path / "m.toml")
    assert "comes to 71" in said and "--unit 'Bearing temperature=F'" in said
    (trace,), _, _ = mapped(export, tmp_path / "m.toml", "--unit", "Bearing temperature=F")
    assert np.allclose(trace.signals[load_map(tmp_path / "m.toml").temperature], plant.heat, atol=0.06)
    # Nobody's word converts nothing.
    (trace,), _, _ = mapped(export, tmp_path / "m2.toml", "--yes")
    assert np.allclose(trace.signals[load_map(tmp_path / "m2.toml").temperature], plant.heat * 1.8 + 32, atol=0.06)
    # Without rests a bearing that stays at 150 has no such degC either.
    hot = recording()
    busy = Recording(hot.seconds, hot.heat * 0 + 66 + np.sin(hot.seconds / 200), hot.current * 0 + 120, hot.running)
    export = wide(tmp_path / "b.csv", cells=(fahrenheit, str, lambda _: "1"), of=busy)
    assert "stays at 15" in asked(export, tmp_path / "m3.toml")


@pytest.mark.parametrize(
    "kind",
    [
        "hot and rests at 21",
        "short rests",
        "stops of a minute",
        "a room beside it",
        "an oven",
        "says degC",
        "begins warm",
        "warm housing",
        "hot place",
        "runs at 115",
    ],
)
def test_a_hot_machine_in_degc_is_not_asked_whether_it_is_fahrenheit(kind: str, tmp_path: Path) -> None:
    header, of, more = "Time,Bearing temperature,Motor current,Running", PLANT, ""
    if kind == "hot and rests at 21":
        of = Recording(PLANT.seconds, 21.5 + (PLANT.heat - 21.5) * 1.9, PLANT.current, PLANT.running)
    elif kind == "stops of a minute":
        warm = 68.0 + np.sin(PLANT.seconds / 200.0)
        running = (np.arange(PLANT.seconds.size) % 60 > 8).astype(int)
        of = Recording(PLANT.seconds, warm.round(2), np.where(running > 0, 120.0, 0.4), running)
    elif kind == "short rests":
        # It cools towards 21 for half of its time constant only.
        cooling = 21.5 + 80.0 * np.exp(-np.arange(30) / 60.0)
        heat = np.where(PLANT.running > 0, 103.0, np.concatenate([cooling] * 8)).round(2)
        of = Recording(PLANT.seconds, heat, PLANT.current, PLANT.running)
    elif kind == "begins warm":
        running = (np.arange(PLANT.seconds.size) >= 12).astype(int)
        heat = np.where(running > 0, 80.0, 70.0 - np.arange(PLANT.seconds.size) / 10.0)
        of = Recording(PLANT.seconds, heat, np.where(running > 0, 120.0, 0.4), running)
    elif kind == "warm housing":
        of = of_hours(25.0, slow=25.0)
        of = Recording(of.seconds[120:], of.heat[120:] + 20.0, of.current[120:], of.running[120:])
    elif kind == "hot place":
        of = of_hours(58.0, rise=35.0)
    elif kind == "runs at 115":
        of = Recording(PLANT.seconds, PLANT.heat * 0 + 115.0 + PLANT.running, PLANT.current, PLANT.running)
    else:
        of = of_hours(70.0)
        if kind == "a room beside it":
            header, more = f"{header},Ambient temperature", ",21.5"
        else:
            header = header.replace("Bearing temperature", "Oven temp" if kind == "an oven" else "Bearing temp [°C]")
    export = wide(tmp_path / "a.csv", header=header, of=of, cells=(str, str, lambda on: f"{on}{more}"))
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    assert np.allclose(trace.signals[load_map(tmp_path / "m.toml").temperature], of.heat, atol=0.01)


def test_a_unit_before_what_stands_in_brackets_is_the_columns(tmp_path: Path) -> None:
    export = wide(
        tmp_path / "a.csv",
        header='Time,"Temp, °F (LGR S/N: 10012, LBL: bearing)",Motor current,Running',
        cells=(fahrenheit, str, str),
    )
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml", within=0.06)


def test_a_year_of_two_digits_with_slashes_is_asked_for_where_else_all_would_be_ten_years_old(tmp_path: Path) -> None:
    export = wide(tmp_path / "a.csv", clock=lambda moment: moment.strftime("%y/%m/%d %H:%M:%S"))
    assert "most likely 'year'" in asked(export, tmp_path / "m.toml")
    (trace,), _, _ = mapped(export, tmp_path / "m.toml", "--dates", "year")
    assert trace.times[0] == BEGIN
    export = wide(tmp_path / "b.csv", clock=lambda moment: moment.strftime("%d/%m/%y %H:%M:%S"))
    (trace,), _, _ = mapped(export, tmp_path / "n.toml")
    assert trace.times[0] == BEGIN


def test_channels_that_a_recorder_counts_have_the_names_and_units_above_them(tmp_path: Path) -> None:
    head = ["Device Type,GX10", "Serial No.,S5X0123", "Ch.,,,0001,0002,0003", "Tag,,,Bearing temp,Motor current,Run",
            "Unit,,,degF,A,"]  # fmt: skip
    late = timedelta(hours=13.7)  # over midnight: the seconds beside the clock are none
    rows = [
        f"{row[0] + late:%Y/%m/%d},{row[0] + late:%H:%M:%S},0.000,{fahrenheit(row[1])},{row[2]},{row[3]}"
        for row in ROWS
    ]
    export = written(tmp_path / "a.csv", "\n".join([*head, "Date,Time,sec,0001,0002,0003"]), rows)
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml", within=0.06)
    assert trace.times[0] == BEGIN + late.total_seconds() and set(trace.signals) >= {
        "Bearing_temp",
        "Motor_current",
        "Run",
    }


def test_one_reading_told_twice_is_one_and_the_quality_whose_words_are_known_judges_it(tmp_path: Path) -> None:
    rows = [
        f"{row[0]:%Y-%m-%d %H:%M:%S}.000,{name},{value},{value},{int(place == 7)},{24 if place == 7 else 192}"
        for place, row in enumerate(ROWS)
        for name, value in zip(("BearingTemp", "MotorCurrent", "MotorRun"), row[1:], strict=True)
    ]
    export = written(tmp_path / "a.csv", "DateTime,TagName,Value,vValue,Quality,OPCQuality", rows)
    mapped(export, tmp_path / "m.toml")
    (trace,), report = load_traces(export, load_map(tmp_path / "m.toml"))
    assert report.files[0].bad_cells == 3 and np.flatnonzero(np.isnan(trace.signals["BearingTemp"])).tolist() == [7]


@pytest.mark.parametrize(
    ("column", "usual", "word", "good"),
    [("OPCQuality", "", "Bad", "192"), ("OPCQuality", "Bad", "Bad", "192"), ("OPCQuality", "0", "133", "192"),
     ("Status", "0", "133", "OK"), ("Status", "0", "0", "OK")],
)  # fmt: skip
def test_a_quality_beside_one_whose_words_are_known_is_heard_where_it_says_more(
    column: str, usual: str, word: str, good: str, tmp_path: Path
) -> None:
    rows = [
        f"{row[0]:%Y-%m-%d %H:%M:%S},{name},{value},{word if place == 7 else usual},{good}"
        for place, row in enumerate(ROWS)
        for name, value in zip(("BearingTemp", "MotorCurrent", "MotorRun"), row[1:], strict=True)
    ]
    export = written(tmp_path / "a.csv", f"DateTime,TagName,Value,Quality,{column}", rows)
    assert "BearingTemp" in asked(export, tmp_path / "m.toml", "--yes")
