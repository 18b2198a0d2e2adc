"""What loggers and historians of many makers write around, above, below and instead of readings."""

from collections.abc import Callable
from datetime import datetime, timedelta
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from sim.lab.recordings import load_map
from tests.traces.exports import comma, recording, wide, written
from tests.traces.test_dialects import EPOCH, asked, is_the_plant, mapped

PLANT = recording()
CELLS = [
    (moment, heat, current)
    for moment, heat, current in zip(PLANT.moments, PLANT.heat.tolist(), PLANT.current.tolist(), strict=True)
]
COUNTED: dict[str, Callable[[datetime], str]] = {
    "matlab days": lambda t: f"{(t - datetime(1, 1, 1)) / timedelta(days=1) + 367:.9f}",
    "seconds since 1904": lambda t: f"{(t - datetime(1904, 1, 1)).total_seconds():.3f}",
    "filetime": lambda t: str(int((t - datetime(1601, 1, 1)).total_seconds()) * 10_000_000),
    "ticks": lambda t: str(int((t - datetime(1, 1, 1)).total_seconds()) * 10_000_000),
}


@pytest.mark.parametrize("form", COUNTED)
def test_counts_from_other_beginnings_are_dates_and_no_elapsed_times(form: str, tmp_path: Path) -> None:
    """Each was read as seconds from the recording's beginning, or as a date of 2090."""
    export = wide(tmp_path / "a.csv", clock=COUNTED[form])
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")
    assert load_map(tmp_path / "m.toml").clock.formats == (form,)
    assert trace.times[0] == pytest.approx((PLANT.moments[0] - EPOCH).total_seconds(), abs=0.001)


def test_a_count_from_an_unknown_beginning_is_no_clock(tmp_path: Path) -> None:
    export = wide(tmp_path / "a.csv", clock=lambda t: str(int((t - EPOCH).total_seconds()) * 77_000))
    assert "no form that is known" in asked(export, tmp_path / "m.toml")


@pytest.mark.parametrize(("zone", "hours"), [("CET", 1), ("EST", -5), ("PDT", -7)])
def test_zones_in_words_that_have_one_meaning(zone: str, hours: int, tmp_path: Path) -> None:
    export = wide(tmp_path / "a.csv", clock=lambda t: t.strftime(f"%a %b %d %H:%M:%S {zone} %Y"))
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")
    assert trace.times[0] == (PLANT.moments[0] - EPOCH).total_seconds() - 3600 * hours
    export = wide(tmp_path / "b.csv", clock=lambda t: t.strftime("%Y-%m-%d %H:%M:%S CST"))
    assert "CST" in asked(export, tmp_path / "n.toml")


def test_twelve_hours_without_a_half_of_the_day_are_refused_as_that(tmp_path: Path) -> None:
    late = timedelta(hours=2, minutes=40)
    export = wide(tmp_path / "a.csv", clock=lambda t: (t + late).strftime("%Y-%m-%d %I:%M:%S"))
    assert "AM and PM" in asked(export, tmp_path / "m.toml", "--yes")


def test_a_ring_that_was_written_over_is_sorted(tmp_path: Path) -> None:
    rows = [f"{moment},{heat},{current}" for moment, heat, current in [*CELLS[130:], *CELLS[:130]]]
    export = written(tmp_path / "a.csv", "Time,Bearing temperature,Motor current", rows)
    assert "most likely 'sort'" in asked(export, tmp_path / "m.toml")


def test_rows_of_one_time_are_not_spread_where_the_clock_has_lost_nothing(tmp_path: Path) -> None:
    """Two machines in turn, every 10 s, were made one that is read every 5 s."""
    rows = [f"{moment},{heat + other},{current}" for moment, heat, current in CELLS for other in (0.0, 0.01)]
    export = written(tmp_path / "a.csv", "Time,Bearing temperature,Motor current", rows)
    said = asked(export, tmp_path / "m.toml")
    assert "no column tells machines apart" in said and "spread" not in said


def test_two_units_of_one_tag_are_refused(tmp_path: Path) -> None:
    rows = [f"{m},Bearing temp,{heat},{'F' if at > 120 else 'C'}" for at, (m, heat, _) in enumerate(CELLS)]
    export = written(tmp_path / "a.csv", "Time,Tag,Value,Unit", rows)
    assert "are in degC and in F" in asked(export, tmp_path / "m.toml")


@pytest.mark.parametrize(
    "header", ["ALIAS,TIME,VALUE", "entity_id,last_changed,state", "property,ts,value", "itemid,clock,value"]
)
def test_names_of_readings_are_no_machines(header: str, tmp_path: Path) -> None:
    """A name that was not known made a machine of each signal."""
    counted = header.startswith("itemid")
    names = ("23401", "23402") if counted else ("/pump/bearing_temperature", "/pump/motor_current")
    rows = [f"{name},{m},{value}" for m, *values in CELLS for name, value in zip(names, values, strict=True)]
    options = ("--temperature", names[0], "--current", names[1]) if counted else ()
    (trace,), _, said = mapped(written(tmp_path / "a.csv", header, rows), tmp_path / "m.toml", *options)
    assert said["temperature"] == names[0] and said["current"] == names[1]
    is_the_plant(trace, tmp_path / "m.toml")


@pytest.mark.parametrize("code", ["-242.02", "1372", "999.99", "8888.8", "7999", "1e10", "1.70141e38", "0.0", "-1"])
def test_what_no_bearing_is_or_jumps_to_is_no_temperature(code: str, tmp_path: Path) -> None:
    rows = [f"{m},{code if at in (50, 51, 90) else heat},{a}" for at, (m, heat, a) in enumerate(CELLS)]
    export = written(tmp_path / "a.csv", "Time,Bearing temperature,Motor current", rows)
    (trace,), _, said = mapped(export, tmp_path / "m.toml")
    heat = trace.signals["Bearing_temperature"]
    assert np.flatnonzero(np.isnan(heat)).tolist() == [50, 51, 90]
    assert any("refuse" in line for line in said["report"])


@pytest.mark.parametrize(
    ("above", "below"),
    [
        ("Report,Pump 4,,\nFrom,2024-03-13 09:58:00,To,2024-03-13 10:38:00\n\nTime,Bearing temp,Motor current", ""),
        ("Start,2024-03-13 09:58:00\nTime,Bearing temp,Motor current\n,°C,A", ""),
        ("TIME,T_brg,I_mot\nTS,Deg C,Amp\n,Avg,Avg", "Average,40.2,9.7\nTotal rows: 240"),
        ("Tag,TI101.PV,II101.PV\nDescriptor,Bearing temp,Motor current\nTimestamp,,", ""),
        ("Time,Bearing temp,Motor current\n-------------------,------,------", "\n(240 rows affected)"),
        ("Time,Bearing temp,Motor current,Comment", ""),
    ],
)
def test_lines_around_the_readings(above: str, below: str, tmp_path: Path) -> None:
    rows = [f"{moment},{heat},{current}" for moment, heat, current in CELLS]
    (trace,), _, said = mapped(written(tmp_path / "a.csv", above, [*rows, *filter(None, [below])]), tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")
    assert said["current"] in ("Motor current", "I_mot")


def test_numbered_rows_with_a_separator_at_their_end(tmp_path: Path) -> None:
    rows = [f"{at},{moment},{heat},{current}," for at, (moment, heat, current) in enumerate(CELLS)]
    (trace,), _, _ = mapped(
        written(tmp_path / "a.csv", "Record,Time,Bearing_Temp,Motor_Current", rows), tmp_path / "m.toml"
    )
    is_the_plant(trace, tmp_path / "m.toml")


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
def test_two_bytes_a_letter_without_a_mark(encoding: str, tmp_path: Path) -> None:
    rows = [f"{moment};{comma(heat)};{comma(current)}" for moment, heat, current in CELLS]
    text = "\n".join(["Zeit;Lagertemperatur [°C];Motorstrom [A]", *rows]) + "\n"
    (tmp_path / "a.csv").write_bytes(text.encode(encoding))
    (trace,), _, _ = mapped(tmp_path / "a.csv", tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")


def test_signs_that_stand_apart_and_two_clocks_of_a_long_file(tmp_path: Path) -> None:
    """The second clock was read in a sample of the rows only, and compared to the whole of the first: a traceback."""
    rows = []
    for moment, heat, current in CELLS:
        stamp = f"{int((moment - EPOCH).total_seconds())};{moment:%d/%m/%Y %H:%M:%S}"
        rows += [f"TI101;{stamp};+ {heat:6.2f}", f"II101;{stamp};+ {current:6.2f}"]
    export = written(tmp_path / "a.csv", "Tag;TimeInt;TimeStr;Value", rows)
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")
    assert all(after > before for before, after in pairwise(trace.times.tolist()))
