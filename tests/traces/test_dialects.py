"""An export in any dialect gives the plant's own numbers, or a question that names the option which answers it."""

import gzip
import json
import zipfile
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np
import pytest
from click.testing import CliRunner
from openpyxl import Workbook

from gateway.cli.main import main
from gateway.console import shipped_file
from sim.lab.recordings import LoadReport, TraceError, load_map, load_traces, numbers, parse_map
from sim.lab.recordings.clock import spread_evenly
from sim.lab.recordings.mapping.columns import find_points
from sim.sha import Trace
from tests.traces.exports import STEP, Recording, comma, recording, wide, written

EPOCH = datetime(1970, 1, 1)
MONTHS = {
    "de": ["Jan", "Feb", "Mrz", "Apr", "Mai", "Jun"],
    "it": ["gen", "feb", "mar", "apr", "mag", "giu"],
    "fr": ["janv.", "févr.", "mars", "avr.", "mai", "juin"],
}


def mapped(export: Path, out: Path, *options: str) -> tuple[list[Trace], LoadReport, dict[str, Any]]:
    """The traces that the drafted map reads, the report, and what the command said."""
    done = CliRunner().invoke(main, ["trace", "map", str(export), "-o", str(out), *options, "--json"])
    assert done.exit_code == 0, done.stderr
    traces, report = load_traces(export, load_map(out))
    for file in report.files:
        cells = file.used_cells + file.refused_cells + file.merged_cells + sum(file.unused.values())
        assert cells == file.cells, file.account()
    return traces, report, json.loads(done.stdout)


def asked(export: Path, out: Path, *options: str) -> str:
    """The question, which leaves no map behind."""
    done = CliRunner().invoke(main, ["trace", "map", str(export), "-o", str(out), *options])
    assert done.exit_code == 2 and not out.exists() and len(done.stderr.splitlines()) == 1, done.output
    return done.stderr


def is_the_plant(trace: Trace, out: Path, plant: Recording | None = None, *, within: float = 0.006) -> None:
    """The trace has the plant's temperatures and times."""
    plant = plant or recording()
    temperature = trace.signals[load_map(out).temperature]
    assert np.allclose(trace.times - trace.times[0], plant.seconds, atol=0.01)
    assert np.allclose(temperature, plant.heat, atol=within)
    assert [event.symbol for event in trace.events if event.symbol[0] == "W"] == ["W_OFF", "W_ON", "W_OFF", "W_ON"]


CLOCKS: dict[str, Callable[[datetime], str]] = {
    "javascript": lambda t: t.strftime("%a %b %d %Y %H:%M:%S GMT+0100 (Central European Standard Time)"),
    "german month": lambda t: t.strftime(f"%d. {MONTHS['de'][t.month - 1]} %Y %H:%M:%S"),
    "italian month": lambda t: t.strftime(f"%d {MONTHS['it'][t.month - 1]} %Y %H:%M:%S"),
    "french month": lambda t: t.strftime(f"%d {MONTHS['fr'][t.month - 1]} %Y à %H:%M:%S"),
    "twelve hours": lambda t: t.strftime("%m/%d/%Y %I:%M:%S ") + ("a. m." if t.hour < 12 else "p. m."),
    "time before date": lambda t: t.strftime("%H:%M:%S 13.03.2024"),
    "compact": lambda t: t.strftime("%Y%m%d%H%M%S"),
    "zone in words": lambda t: t.strftime("%Y-%m-%d %H:%M:%S UTC"),
    "epoch ms with dots": lambda t: f"{int((t - EPOCH).total_seconds() * 1000):,}".replace(",", "."),
    "epoch us": lambda t: str(int((t - EPOCH).total_seconds() * 1e6)),
}


@pytest.mark.parametrize("clock", CLOCKS)
def test_clocks_that_a_person_can_read(clock: str, tmp_path: Path) -> None:
    export = wide(
        tmp_path / "a.csv", header="Time;Bearing temperature;Motor current;Running", clock=CLOCKS[clock], mark=";"
    )
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")
    assert trace.times[0] == (datetime(2024, 3, 13, 9, 58) - EPOCH).total_seconds() - 3600 * (clock == "javascript")


@pytest.mark.parametrize("mark", [",", ";"])
def test_days_of_a_spreadsheet_also_under_a_header_with_commas(mark: str, tmp_path: Path) -> None:
    def days(moment: datetime) -> str:
        return comma(round((moment - datetime(1899, 12, 30)) / timedelta(days=1), 8))

    header = mark.join(["Time", "Bearing temperature", "Motor current", "Running"])
    export = wide(tmp_path / "a.csv", header=header, clock=days, cells=(comma, comma, str), mark=";")
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")


def test_the_hour_24_is_midnight(tmp_path: Path) -> None:
    plant = recording()
    shift = timedelta(hours=13, minutes=42)

    def clock(moment: datetime) -> str:
        moment += shift
        midnight = (moment.hour, moment.minute, moment.second) == (0, 0, 0)
        return f"{moment - timedelta(days=1):%Y-%m-%d} 24:00:00" if midnight else f"{moment:%Y-%m-%d %H:%M:%S}"

    (trace,), report, _ = mapped(wide(tmp_path / "a.csv", clock=clock), tmp_path / "m.toml")
    assert report.refused == 0 and trace.times.size == plant.heat.size
    assert np.all(np.diff(trace.times) == STEP)


@pytest.mark.parametrize(("unit", "size"), [("ms", 1000), ("min", 1 / 60), ("h", 1 / 3600)])
def test_elapsed_time_is_read_in_the_unit_that_its_name_says(unit: str, size: float, tmp_path: Path) -> None:
    begin = recording().moments[0]
    export = wide(
        tmp_path / "a.csv",
        header=f"Time ({unit}),Bearing temperature,Motor current,Running",
        clock=lambda moment: repr((moment - begin).total_seconds() * size),
    )
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")


def test_a_clock_in_columns_of_hours_minutes_and_seconds_is_no_column_of_seconds(tmp_path: Path) -> None:
    export = wide(
        tmp_path / "a.csv",
        header="hour,minute,second,Bearing temperature,Motor current,Running",
        clock=lambda moment: f"{moment.hour},{moment.minute},{moment.second}",
    )
    assert "time_of_day" in asked(export, tmp_path / "m.toml")


def test_a_temperature_that_is_called_t_is_no_clock(tmp_path: Path) -> None:
    plant = recording()
    rows = [f"{heat},{current}" for heat, current in zip(plant.heat, plant.current, strict=True)]
    assert "no times" in asked(written(tmp_path / "a.csv", "T,I", rows), tmp_path / "m.toml").replace(
        "holds times", "no times"
    )


def test_times_that_a_spreadsheet_rounded_are_refused_as_that(tmp_path: Path) -> None:
    export = wide(tmp_path / "a.csv", clock=lambda moment: "1.71032E+12")
    said = asked(export, tmp_path / "m.toml")
    assert "'Time'" in said and "1.71032E+12" in said and "rounded" in said


def test_a_clock_that_goes_back_in_autumn_is_told_as_summer_time(tmp_path: Path) -> None:
    plant = replace(recording(), seconds=recording().seconds * 6)
    utc = datetime(2025, 10, 25, 23, 30)

    def local(moment: datetime) -> str:
        own = utc + (moment - plant.moments[0])
        return f"{own + timedelta(hours=2 if own < datetime(2025, 10, 26, 1) else 1):%Y-%m-%d %H:%M:%S}"

    (trace,), report, said = mapped(wide(tmp_path / "a.csv", clock=local, of=plant), tmp_path / "m.toml")
    assert report.refused == 0 and trace.times[-1] - trace.times[0] == 239 * 60
    assert any("summer time" in line and "--timezone" in line for line in said["report"])


def test_a_state_that_changes_in_the_hour_that_comes_twice_is_no_machine(tmp_path: Path) -> None:
    """One switch with words, one state of three: each tells the two hours apart, as does whatever changes in them."""
    begin, rows = datetime(2025, 10, 25, 18, tzinfo=UTC), []
    for index, state in enumerate(["Betrieb", "Stillstand", "Spuelen"] * 320):
        moment = (begin + timedelta(minutes=index)).astimezone(ZoneInfo("Europe/Berlin"))
        on = index // 60 % 2 == 0
        hot = 40 + 20 * on + index % 7
        rows.append(f"{moment:%d.%m.%Y %H:%M:%S};{hot},5;{'42,5' if on else '0,3'};{'EIN' if on else 'AUS'};{state}")
    export = written(tmp_path / "a.csv", "Zeit;Lagertemperatur °C;Motorstrom A;Maschine läuft;Zustand", rows[::-1])
    (trace,), report, said = mapped(export, tmp_path / "m.toml")
    assert report.refused == 0 and trace.times[-1] - trace.times[0] == 959 * 60
    assert not any("whose rows" in line for line in said["report"])


CELLS: dict[str, tuple[str, tuple[Callable[[float], str], ...]]] = {
    "units in cells": ("Time;Bearing temperature;Motor power;Running", (
        lambda v: f"{v} °C", lambda v: f"{v * 20:.0f} W" if v < 100 else f"{v * 20 / 1000:.3f} kW", str,
    )),
    "thousands": ("Time;Bearing temp;Motor power W;Running", (str, lambda v: f"{v * 20:,.1f}", str)),
    "kelvin": ("Time;Bearing temperature K;Motor current A;Running", (lambda v: f"{v + 273.15:.2f}", str, str)),
    "kelvin in words": ("Time;Bearing temperature [Kelvin];Motor current;Running", (lambda v: f"{v + 273.15:.2f}",
    str, str)),
    "fahrenheit": ("Time;Bearing temperature °F;Motor current;Running", (lambda v: f"{v * 1.8 + 32:.3f}", str, str)),
    "milliamperes": ("Time;Bearing temperature;Motor current mA;Running", (str, lambda v: f"{v * 1000:.0f}", str)),
}  # fmt: skip


@pytest.mark.parametrize("cells", CELLS)
def test_cells_and_names_that_say_their_units(cells: str, tmp_path: Path) -> None:
    header, forms = CELLS[cells]
    (trace,), _, said = mapped(wide(tmp_path / "a.csv", header=header, cells=forms, mark=";"), tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")
    loads = trace.signals[next(name for name in trace.signals if name.startswith("Motor"))]
    least = recording().current.min()
    assert loads.max() / loads.min() == pytest.approx(recording().current.max() / least, rel=0.05)
    assert said["current"].startswith("Motor")


def test_kelvin_that_nobody_names_is_asked_and_the_answer_converts(tmp_path: Path) -> None:
    export = wide(tmp_path / "a.csv", cells=(lambda v: f"{v + 273.15:.2f}", str, str))
    said = asked(export, tmp_path / "m.toml")
    assert "kelvin" in said and "--unit 'Bearing temperature=K'" in said
    (trace,), _, _ = mapped(export, tmp_path / "m.toml", "--unit", "Bearing temperature=K")
    is_the_plant(trace, tmp_path / "m.toml")
    (tmp_path / "m.toml").unlink()
    (trace,), _, _ = mapped(export, tmp_path / "m.toml", "--yes")
    is_the_plant(trace, tmp_path / "m.toml")


@pytest.mark.parametrize("code", [3276.7, -127.0, 85.0, -200.0, 850.0, -32768.0, 9999.0, -999.9])
def test_numbers_that_mean_no_reading_are_named_and_refused(code: float, tmp_path: Path) -> None:
    plant = recording()
    heat = plant.heat.copy()
    at = [5, 20, 61, 100, 101, 190]
    heat[at] = code
    export = wide(tmp_path / "a.csv", of=replace(plant, heat=heat))
    (trace,), report, said = mapped(export, tmp_path / "m.toml")
    assert any(f"{code:g}" in line for line in said["report"]) and f"bad = [{code:g}]" in said["text"]
    assert report.files[0].bad_cells == len(at)
    assert np.nanmax(trace.signals["Bearing_temperature"]) == np.delete(plant.heat, at).max()


@pytest.mark.parametrize("code", [-40.0, -50.0])
def test_where_a_sensors_range_begins_is_no_reading_of_a_warm_bearing(code: float, tmp_path: Path) -> None:
    heat = recording().heat.copy()
    heat[[33, 70, 71, 150]] = code
    (trace,), _, said = mapped(wide(tmp_path / "a.csv", of=replace(recording(), heat=heat)), tmp_path / "m.toml")
    assert np.flatnonzero(np.isnan(trace.signals["Bearing_temperature"])).tolist() == [33, 70, 71, 150]
    assert any(f"holds {code:g}" in line for line in said["report"])


def test_thousands_by_points_in_a_file_of_decimal_commas_are_no_fractions(tmp_path: Path) -> None:
    cells = (comma, lambda value: f"{value * 1000:,.0f}".replace(",", "."), str)
    header = "Zeit;Lagertemperatur;Motorstrom [mA];Betrieb"
    (trace,), _, _ = mapped(wide(tmp_path / "a.csv", header=header, cells=cells, mark=";"), tmp_path / "m.toml")
    assert np.allclose(trace.signals["Motorstrom"], recording().current)


def test_hundreds_of_thousands_are_read_as_india_writes_them_and_a_mark_twice_is_no_decimal_one() -> None:
    assert numbers(["1,49,830", "99,830", "830"])[0].tolist() == [149830.0, 99830.0, 830.0]
    assert numbers(["1,234,567", "950,123", "0"])[0].tolist() == [1234567.0, 950123.0, 0.0]
    assert np.isnan(numbers(["1,49,83", "1,4983,000"])[0]).all()


def german(path: Path, name: str, own: Callable[[int], str], *, clock: Callable[[int], str] | None = None) -> Path:
    """An export with decimal commas and one column more, whose cells `own` writes, and maybe another clock."""
    plant = recording()
    clock = clock or (lambda at: f"{plant.moments[at]:%d.%m.%Y %H:%M:%S}")
    zipped = enumerate(zip(plant.heat, plant.current, plant.running, strict=True))
    rows = [f"{clock(at)};{comma(h)};{comma(c)};{r};{own(at)}" for at, (h, c, r) in zipped]
    head = "Time [s]" if clock(0)[:1] == "1" and ":" not in clock(0) else "Zeit"
    return written(path, f"{head};Lagertemperatur;Motorstrom [A];Betrieb;{name}", rows)


def test_a_clock_and_a_vibration_with_points_are_read_alike_however_their_rows_are_cut(tmp_path: Path) -> None:
    vibration = [0.812, *(2.5 + at / 1000 for at in range(1, 240))]
    path = tmp_path / "a.csv"
    clock = [f"{199.98 + at / 100:.3f}" for at in range(240)]
    export = german(path, "Vibration mm/s", lambda at: f"{vibration[at]:.3f}", clock=clock.__getitem__)
    (trace,), _, said = mapped(export, tmp_path / "m.toml")
    assert 'points = { "Vibration mm/s" = "decimal" }' in said["text"]
    assert np.allclose(trace.signals["Vibration_mm/s"], vibration)
    assert np.allclose(np.diff(trace.times), 0.01)
    # Another file by the same map, in which no cell shows any more what the point is.
    later = export.read_text(encoding="utf-8").splitlines()
    export.write_text("\n".join([later[0], *later[25:40]]) + "\n", encoding="utf-8")
    (trace,), _ = load_traces(export, load_map(tmp_path / "m.toml"))
    assert np.allclose(trace.signals["Vibration_mm/s"], vibration[24:39])
    assert np.allclose(trace.times, 199.98 + np.arange(24, 39) / 100)


def test_what_a_lone_point_is_no_batch_of_cells_decides() -> None:
    assert numbers(["0.400", "149.83", "400"], ",")[0].tolist() == [0.4, 149.83, 400.0]
    for batch in (["149.830"], ["149.830", "400"], ["149.830", "n/a"], ["149.830", "1,5", "0.5"]):
        assert np.isnan(numbers(batch, ",")[0][0])


@pytest.mark.parametrize(
    ("cells", "points"),
    [
        (["149.830", "n/a", "400"], "thousands"), (["1.234.567", "950.123"], "thousands"),
        (["1.000", "950,0"], "thousands"),
        (["1.234,5", "1.234"], "thousands"), (["0.812", "2.599"], "decimal"), (["12.5", "400"], "decimal"),
        (["2.599", "2.500"], "either"), (["149.830", "1234", "400"], "either"), (["2.500", "2,501"], "either"),
        (["12.5", "12,5"], "both"), (["400", "1,5"], ""),
    ],
)  # fmt: skip
def test_a_column_tells_what_its_points_are(cells: list[str], points: str) -> None:
    assert find_points(cells) == points


def test_a_totaliser_in_thousands_is_read_and_what_nobody_can_tell_stays_unused_unless_it_plays_a_part(
    tmp_path: Path,
) -> None:
    total = german(tmp_path / "t.csv", "Menge", lambda at: f"1.{at:03d}" if at % 3 else f"950,{at % 10}")
    (trace,), _, said = mapped(total, tmp_path / "t.toml")
    assert trace.signals["Menge"][[1, 3]].tolist() == [1001.0, 950.3]
    constant = german(tmp_path / "c.csv", "Druck", lambda at: "1.250")
    (trace,), _, said = mapped(constant, tmp_path / "c.toml")
    assert "Druck" not in trace.signals and any("'Druck' is not used" in line for line in said["report"])
    recipe = german(tmp_path / "r.csv", "Rezept", lambda at: "1.5" if at % 2 else "1,5")
    (trace,), _, said = mapped(recipe, tmp_path / "r.toml")
    assert "Rezept" not in trace.signals and any("'Rezept' is not used" in line for line in said["report"])
    unclear = german(tmp_path / "u.csv", "Leistung", lambda at: "1.250" if at % 60 else "2.250")
    assert "sets apart thousands" in asked(unclear, tmp_path / "u.toml", "--current", "Leistung")


def test_points_of_a_map_without_decimal_commas_are_refused(tmp_path: Path) -> None:
    mapped(german(tmp_path / "a.csv", "Druck", lambda at: f"{at / 100:.2f}"), tmp_path / "m.toml")
    text = (tmp_path / "m.toml").read_text(encoding="utf-8")
    with pytest.raises(TraceError, match="needs decimal = ','"):
        parse_map(text.replace('decimal = ","', 'decimal = "."'), "m.toml")


def test_a_column_unit_that_names_machines_is_none_of_units(tmp_path: Path) -> None:
    plant = recording()
    times = [f"{moment:%Y-%m-%d %H:%M:%S}" for moment in plant.moments]
    rows = zip(times, "A" * 120 + "C" * 120, plant.heat, plant.current, plant.running, strict=True)
    header = "Time,Unit,Bearing temperature,Motor current,Running"
    mapped(written(tmp_path / "a.csv", header, [",".join(map(str, row)) for row in rows]), tmp_path / "m.toml")


def test_numbers_with_both_marks_are_refused_as_that(tmp_path: Path) -> None:
    cells = (lambda value: str(value) if value > 40 else comma(value), comma, str)
    mixed = wide(tmp_path / "a.csv", cells=cells, mark=";", header="Time;Bearing temperature;Motor current;Running")
    assert "with a decimal point and with a decimal comma" in asked(mixed, tmp_path / "m.toml", "--yes")


@pytest.mark.parametrize(
    ("turned", "words"),
    [(lambda heat: heat * 1.8 + 32, "in degC and in degF"), (lambda heat: heat + 273.15, "in degC and in kelvin")],
)
@pytest.mark.parametrize("first", [True, False], ids=["before", "behind"])
def test_a_unit_that_changes_half_way_is_asked_for(
    turned: Callable[[np.ndarray], np.ndarray], words: str, first: bool, tmp_path: Path
) -> None:
    plant = recording()
    changed = (plant.seconds < 1200) == first
    heat = np.where(changed, turned(plant.heat), plant.heat).round(2)
    export = wide(tmp_path / "a.csv", of=replace(plant, heat=heat))
    assert words in asked(export, tmp_path / "m.toml", "--yes")[: 10**4]
    mapped(export, tmp_path / "m.toml", "--unit", "Bearing temperature=degC")
    units = written(
        tmp_path / "b.csv",
        "Time,Bearing temperature,Unit",
        [f"{at},{value},{'F' if new else 'C'}" for at, value, new in zip(plant.moments, heat, changed, strict=True)],
    )
    assert "rows are in degC and in degF" in asked(units, tmp_path / "n.toml", "--yes")


@pytest.mark.parametrize(("first", "last"), [(21600, 24000), (100, 140), (20000, 20500)])
def test_a_unit_that_changes_behind_the_sample_or_for_a_while_is_asked_for(
    first: int, last: int, tmp_path: Path
) -> None:
    plant = recording(times=1 if last < 240 else 100)
    heat = plant.heat.copy()
    heat[first:last] = (heat[first:last] * 1.8 + 32).round(2)
    said = asked(wide(tmp_path / "a.csv", of=replace(plant, heat=heat)), tmp_path / "m.toml", "--yes")
    assert f"at reading {first + 1} and goes on there, which is the same in degC and in degF" in said


@pytest.mark.parametrize("kind", ["weekend", "machines", "hours", "spike"])
def test_a_pause_another_machine_a_start_and_a_spike_change_no_unit(kind: str, tmp_path: Path) -> None:
    noise = np.random.default_rng(0).normal(0, 0.05, 200)
    hot, cold = (68.0 + noise).round(1), (20.0 + noise).round(1)
    hot[-1], cold[0] = 68.0, 20.0
    heat = np.concatenate((hot, cold))
    seconds = 10.0 * np.arange(400)
    running = np.repeat([1, 0], 200)
    whose = ["A"] * 400
    if kind == "weekend":
        seconds[200:] += 200000.0
    elif kind == "machines":
        seconds[200:], whose[200:] = seconds[:200], ["B"] * 200
    elif kind == "hours":
        seconds *= 360
    else:
        heat, running = np.concatenate((cold, cold)), np.ones(400, dtype=int)
        heat[150] = 68.0
    rows = [
        f"{datetime(2024, 3, 13) + timedelta(seconds=at)},{own},{value},{120 * on},{on}"
        for at, own, value, on in zip(seconds.tolist(), whose, heat.tolist(), running.tolist(), strict=True)
    ]
    header = "Time,Machine,Bearing temperature [°C],Motor current [A],Running"
    traces, _, _ = mapped(written(tmp_path / "a.csv", header, rows), tmp_path / "m.toml", "--yes")
    assert sum(trace.times.size for trace in traces) == 400


def test_counts_of_a_converter_are_no_tenths_of_a_degree(tmp_path: Path) -> None:
    counts = replace(recording(), heat=(recording().heat / 150 * 27648).round())
    said = asked(wide(tmp_path / "a.csv", of=counts), tmp_path / "m.toml", "--yes")
    assert "no bearing rests at" in said and "0.1 degC" not in said


@pytest.mark.parametrize(
    ("zone", "begin"),
    [("Europe/Rome", datetime(2024, 3, 31, 0, 40)), ("America/New_York", datetime(2024, 3, 10, 6, 40))],
)
def test_a_clock_that_goes_forward_in_spring_leaves_no_gap(zone: str, begin: datetime, tmp_path: Path) -> None:
    walls = {at: begin + timedelta(seconds=s) for at, s in zip(recording().moments, recording().seconds, strict=True)}

    def wall(at: datetime) -> str:
        return f"{walls[at].replace(tzinfo=UTC).astimezone(ZoneInfo(zone)):%Y-%m-%d %H:%M:%S}"

    (trace,), _, said = mapped(wide(tmp_path / "a.csv", clock=wall), tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")
    assert any("goes forward by an hour" in line and zone in line for line in said["report"])
    # The same pause on another day is one.
    (trace,), _, said = mapped(
        wide(tmp_path / "b.csv", clock=lambda at: wall(at).replace("-03-", "-05-")), tmp_path / "n.toml"
    )
    assert np.ptp(trace.times) == 3600 + STEP * 239 and not any("goes forward" in line for line in said["report"])


@pytest.mark.parametrize("column", ["Tag", "Machine"])
def test_summer_time_begins_for_each_tag_and_machine(column: str, tmp_path: Path) -> None:
    plant, begin = recording(), datetime(2024, 3, 31, 0, 40, tzinfo=UTC)
    rows = []
    for at, *values in zip(plant.seconds.tolist(), plant.heat, plant.current, plant.running, strict=True):
        wall = f"{(begin + timedelta(seconds=at)).astimezone(ZoneInfo('Europe/Rome')):%Y-%m-%d %H:%M:%S}"
        tags = zip(("Bearing temperature", "Motor current", "Running"), values, strict=True)
        machines = [f"{wall},{name},{','.join(map(str, values))}" for name in "AB"]
        rows += [f"{wall},{tag},{value}" for tag, value in tags] if column == "Tag" else machines
    header = f"Time,{column},{'Value' if column == 'Tag' else 'Bearing temperature,Motor current,Running'}"
    traces, _, _ = mapped(written(tmp_path / "a.csv", header, rows), tmp_path / "m.toml", "--yes")
    assert traces
    for trace in traces:
        is_the_plant(trace, tmp_path / "m.toml")


def test_a_recorder_that_is_off_for_an_hour_each_sunday_is_off_in_the_night_of_summer_time_too(tmp_path: Path) -> None:
    moments = [datetime(2024, 3, 17) + timedelta(minutes=10 * at) for at in range(21 * 144)]
    heat, current, running = recording().heat, recording().current, recording().running
    rows = [
        f"{moment},{heat[at % 240]},{current[at % 240]},{running[at % 240]}"
        for at, moment in enumerate(moments)
        if (moment.weekday(), moment.hour) != (6, 2)
    ]
    export = written(tmp_path / "a.csv", "Time,Bearing temperature,Motor current,Running", rows)
    (trace,), _, said = mapped(export, tmp_path / "m.toml")
    assert (np.diff(trace.times) == 4200.0).sum() == 3 and not any("goes forward" in line for line in said["report"])


def test_a_temperature_that_passes_85_is_no_code(tmp_path: Path) -> None:
    plant = recording(ambient=60.0)
    heat = plant.heat.round(0)
    header = "Time,Bearing temperature [°C],Motor current,Running"
    export = wide(tmp_path / "a.csv", header=header, of=replace(plant, heat=heat))
    (trace,), report, said = mapped(export, tmp_path / "m.toml")
    assert (
        85.0 in trace.signals["Bearing_temperature"] and report.files[0].bad_cells == 0 and "bad =" not in said["text"]
    )


def test_a_code_that_the_map_does_not_name_is_said_by_every_command_that_loads(tmp_path: Path) -> None:
    plant = recording()
    heat = plant.heat.copy()
    heat[[5, 9]] = 3276.7
    export = wide(tmp_path / "a.csv", of=replace(plant, heat=heat))
    mapped(export, tmp_path / "m.toml")
    text = (tmp_path / "m.toml").read_text(encoding="utf-8").replace(", bad = [3276.7]", "")
    (tmp_path / "m.toml").write_text(text, encoding="utf-8")
    _, report = load_traces(export, load_map(tmp_path / "m.toml"))
    assert any("2 readings of Bearing_temperature are 3276.7" in line for line in report.warnings)


def test_the_header_again_in_another_order_and_spelling_begins_a_table(tmp_path: Path) -> None:
    plant = recording()
    export = wide(tmp_path / "a.csv", of=plant)
    lines = export.read_text(encoding="utf-8").splitlines()
    swapped = [",".join([row.split(",")[place] for place in (0, 2, 3, 1)]) for row in lines[121:]]
    again = "Time,Motor  current,RUNNING,Bearing temperature"
    written(export, lines[0], [*lines[1:121], again, *swapped])
    (trace,), report, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")
    assert report.files[0].refused == 1
    assert load_map(tmp_path / "m.toml").signals["Running"].boolean


def test_a_new_header_with_another_number_of_columns_begins_a_table(tmp_path: Path) -> None:
    export = wide(tmp_path / "a.csv")
    lines = export.read_text(encoding="utf-8").splitlines()
    more = [f"{row},7" for row in lines[121:]]
    written(export, lines[0], [*lines[1:121], f"{lines[0]},Speed setpoint", *more])
    (trace,), report, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")
    assert report.files[0].refused == 1 and np.isnan(trace.signals["Speed_setpoint"][:120]).all()


@pytest.mark.parametrize("name", ["Turbine", "Asset", "x"])
def test_machines_of_one_file_are_traces_of_their_own(name: str, tmp_path: Path) -> None:
    first, second = recording(0), recording(1, ambient=36.0)
    rows = []
    for moment, a, b in zip(first.moments, first.heat, second.heat, strict=True):
        rows += [f"A1;{moment};{a};0.4", f"B2;{moment};{b};0.4"]
    for place, (a, b) in enumerate(zip(first.current, second.current, strict=True)):
        rows[2 * place] = rows[2 * place].rsplit(";", 1)[0] + f";{a}"
        rows[2 * place + 1] = rows[2 * place + 1].rsplit(";", 1)[0] + f";{b}"
    export = written(tmp_path / "a.csv", f"{name};Time;Bearing temperature;Motor current", rows)
    traces, report, _ = mapped(export, tmp_path / "m.toml")
    assert [trace.machine for trace in traces] == ["A1", "B2"] and report.files[0].merged == 0
    for trace, plant in zip(traces, (first, second), strict=True):
        is_the_plant(trace, tmp_path / "m.toml", plant)


def test_sessions_that_begin_anew_are_traces_of_their_own(tmp_path: Path) -> None:
    plants = (recording(0), recording(1), recording(2))
    rows = [
        f"{number},{second:g},{heat},{current}"
        for number, plant in zip((4, 6, 9), plants, strict=True)
        for second, heat, current in zip(plant.seconds, plant.heat, plant.current, strict=True)
    ]
    traces, _, _ = mapped(
        written(tmp_path / "a.csv", "profile_id,time,winding temperature,current", rows), tmp_path / "m.toml"
    )
    assert len(traces) == 3
    for trace, plant in zip(traces, plants, strict=True):
        is_the_plant(trace, tmp_path / "m.toml", plant)


def test_machines_that_nothing_tells_apart_are_never_merged_in_silence(tmp_path: Path) -> None:
    first, second = recording(0), recording(1, ambient=36.0)
    rows = [
        f"{moment};{heat};{current}"
        for moment, *both in zip(first.moments, first.heat, first.current, second.heat, second.current, strict=True)
        for heat, current in (both[:2], both[2:])
    ]
    export = written(tmp_path / "a.csv", "Time;Bearing temperature;Motor current", rows)
    assert "--duplicates average" in asked(export, tmp_path / "m.toml")
    (tmp_path / "m.toml").write_text(
        'format = "wide"\ntemperature = "T"\n[clock]\ncolumn = "Time"\n'
        '[signals]\nT = { column = "Bearing temperature" }\nI = { column = "Motor current" }\n',
        encoding="utf-8",
    )
    done = CliRunner().invoke(main, ["trace", "show", str(export), "--map", str(tmp_path / "m.toml")])
    assert done.exit_code == 2 and "240 of its 480 rows have the time of another row" in done.stderr


def test_a_clock_that_lost_its_seconds_has_its_rows_spread(tmp_path: Path) -> None:
    export = wide(tmp_path / "a.csv", clock=lambda moment: moment.strftime("%d/%m/%Y %H:%M"))
    (trace,), _, said = mapped(export, tmp_path / "m.toml", "--dates", "day")
    is_the_plant(trace, tmp_path / "m.toml")
    assert any("coarser" in line for line in said["report"])


@pytest.mark.parametrize("names", [("Bearing temperature", "Motor current", "Running"), ("Value", "Value", "Value")])
def test_a_folder_of_one_file_a_tag_is_one_recording(names: tuple[str, ...], tmp_path: Path) -> None:
    plant = recording()
    folder = tmp_path / "export"
    folder.mkdir()
    stems = ("Bearing_temperature", "Motor_current", "Running")
    for stem, name, values in zip(stems, names, (plant.heat, plant.current, plant.running), strict=True):
        rows = [f"{moment};{value}" for moment, value in zip(plant.moments, values.tolist(), strict=True)]
        written(folder / f"{stem}.csv", f"timestamp;{name}", rows)
    (trace,), _, _ = mapped(folder, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")


def test_a_folder_of_parts_is_one_recording(tmp_path: Path) -> None:
    lines = wide(tmp_path / "a.csv").read_text(encoding="utf-8").splitlines()
    folder = tmp_path / "days"
    folder.mkdir()
    for part in range(3):
        written(folder / f"part{part}.csv", lines[0], lines[1 + 80 * part : 81 + 80 * part])
    (trace,), _, _ = mapped(folder, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")


def test_one_row_a_reading_with_descriptions_and_units(tmp_path: Path) -> None:
    plant = recording()
    rows = []
    for place, (moment, heat, current, running) in enumerate(
        zip(plant.moments, plant.heat, plant.current, plant.running, strict=True)
    ):
        for code, (name, value, unit) in enumerate(
            (
                ("Lagertemperatur", heat, "°C"),
                ("Motorstrom", current, "A"),
                ("Motor Stufe 1", "Ein" if running else "Aus", ""),
            )
        ):
            rows.append(
                f"{1235285616 + 10000 * place + code};{moment:%d.%m.%Y %H:%M:%S};{8300 + code};{name};{value};{unit}"
            )
    export = written(tmp_path / "a.csv", "Milliseconds;Date;Parameter;Description;Value;Unit", rows)
    (trace,), _, said = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")
    assert (said["clock"], said["temperature"], said["current"]) == ("Date", "Lagertemperatur", "Motorstrom")


STOPPED: dict[str, tuple[str, Callable[[float], str]]] = {
    "standstill": ("Standstill", lambda v: str(int(not v))),
    "stopped, in words": ("Fermo", lambda v: "no" if v else "si"),
}


@pytest.mark.parametrize("case", STOPPED)
def test_a_switch_that_says_standstill_is_turned_round(case: str, tmp_path: Path) -> None:
    name, cell = STOPPED[case]
    plant = recording()
    rows = [
        f"{m},{heat},{cell(on)}" for m, heat, on in zip(plant.moments, plant.heat, plant.running.tolist(), strict=True)
    ]
    (trace,), _, said = mapped(
        written(tmp_path / "a.csv", f"Time,Bearing temperature,{name}", rows), tmp_path / "m.toml"
    )
    is_the_plant(trace, tmp_path / "m.toml")
    assert said["running"] == "" and f'signal = "{name}", below = 0.5' in said["text"]  # derived, not read as it is


@pytest.mark.parametrize(
    ("name", "words"), [("State", ("IDLE", "CIP", "PRODUCTION", "HOT")), ("Mode", ("0", "1", "2", "3"))]
)
def test_states_are_asked_and_several_words_may_mean_running(name: str, words: tuple[str, ...], tmp_path: Path) -> None:
    plant = recording()
    rows = []
    for place, (moment, heat, current) in enumerate(zip(plant.moments, plant.heat, plant.current, strict=True)):
        still = words[0] if place < 10 else words[1]
        rows.append(f"{moment},{heat},{still if current < 1 else words[2] if current > 135 else words[3]}")
    export = written(tmp_path / "a.csv", f"Time,Bearing temperature,{name}", rows)
    said = asked(export, tmp_path / "m.toml")
    assert all(f"--on {word}" in said for word in words)
    (trace,), _, _ = mapped(export, tmp_path / "m.toml", *("--running", name, "--on", words[2], "--on", words[3]))
    is_the_plant(trace, tmp_path / "m.toml")


def test_two_that_load_the_machine_are_asked_and_one_is_taken(tmp_path: Path) -> None:
    plant = recording()
    rows = [
        f"{moment},{10 * current - 5:.1f},{12 * current:.0f},{heat},{3 + place % 7}"
        for place, (moment, current, heat) in enumerate(zip(plant.moments, plant.current, plant.heat, strict=True))
    ]
    export = written(tmp_path / "a.csv", "Time,ActivePower,GeneratorRPM,MainBoxTemperature,WindSpeed", rows)
    said = asked(export, tmp_path / "m.toml")
    assert "--current ActivePower or --current GeneratorRPM" in said
    (trace,), _, _ = mapped(export, tmp_path / "m.toml", "--current", "GeneratorRPM")
    is_the_plant(trace, tmp_path / "m.toml")


def test_movement_alone_is_a_question(tmp_path: Path) -> None:
    export = wide(tmp_path / "a.csv", header="Time,Bearing temperature,label,b", cells=(str, str))
    lines = [line.replace(",b", "") for line in export.read_text(encoding="utf-8").splitlines()]
    said = asked(written(export, lines[0], lines[1:]), tmp_path / "m.toml")
    assert "--current label or --current none" in said and "movement" in said


def test_a_switch_that_is_on_while_nothing_flows_is_asked(tmp_path: Path) -> None:
    export = wide(tmp_path / "a.csv", cells=(str, str, lambda v: str(int(not v))))
    said = asked(export, tmp_path / "m.toml")
    assert "'Running' is on while 'Motor current' is 0.4" in said and "--on 0" in said
    (trace,), _, _ = mapped(export, tmp_path / "m.toml", "--yes")
    is_the_plant(trace, tmp_path / "m.toml")


def test_a_column_that_does_not_move_is_not_chosen_beside_one_that_does(tmp_path: Path) -> None:
    header = "Time,Average return flow temperature in °C,Feed flow temperature in °C,Overall heat load in MW"
    plant = recording()
    rows = [f"{m},50,{h},{c}" for m, h, c in zip(plant.moments, plant.heat, plant.current, strict=True)]
    (trace,), _, said = mapped(written(tmp_path / "a.csv", header, rows), tmp_path / "m.toml")
    assert said["temperature"].startswith("Feed")
    is_the_plant(trace, tmp_path / "m.toml")


def test_equal_names_are_told_apart_and_said(tmp_path: Path) -> None:
    export = wide(tmp_path / "a.csv", header="Time,Value,Value,Value")
    assert "--temperature Value" in asked(export, tmp_path / "m.toml")
    assert "--current Value_2" in asked(export, tmp_path / "m.toml", "--temperature", "Value")
    answers = ("--temperature", "Value", "--current", "Value_2", "--running", "Value_3")
    (trace,), report, _ = mapped(export, tmp_path / "m.toml", *answers)
    is_the_plant(trace, tmp_path / "m.toml")
    assert {"Value", "Value_2", "Value_3"} <= set(trace.signals)
    assert any("Value_2" in line for line in report.warnings)


def packed(plain: Path, kind: str) -> Path:
    """The same recording in another kind of file."""
    path = plain.with_name(f"a.{kind}")
    rows = [line.split(",") for line in plain.read_text(encoding="utf-8").splitlines()]
    if kind == "csv.gz":
        path.write_bytes(gzip.compress(plain.read_bytes()))
    elif kind == "zip":
        with zipfile.ZipFile(path, "w") as archive:
            archive.write(plain, "export.csv")
            archive.writestr("README.md", "how it was exported")
    elif kind == "xlsx":
        book = Workbook()
        for number, row in enumerate(rows):
            moment = [datetime.fromisoformat(row[0]), *map(float, row[1:])] if number else row
            book.active.append(moment)
        book.save(path)
    else:
        parquet = pytest.importorskip("pyarrow.parquet")
        columns = {name: [row[place] for row in rows[1:]] for place, name in enumerate(rows[0])}
        parquet.write_table(pytest.importorskip("pyarrow").table(columns), path)
    return path


@pytest.mark.parametrize("kind", ["csv.gz", "zip", "xlsx", "parquet"])
def test_packed_files_and_tables_of_other_programs(kind: str, tmp_path: Path) -> None:
    (trace,), _, _ = mapped(packed(wide(tmp_path / "plain.csv"), kind), tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")


@pytest.mark.parametrize("kind", ["csv.gz", "zip", "xlsx", "parquet"])
def test_a_packed_file_that_is_none_is_refused_in_one_sentence(kind: str, tmp_path: Path) -> None:
    path = tmp_path / f"a.{kind}"
    path.write_bytes(b"Time,T\n0,1\n")
    assert str(path) in asked(path, tmp_path / "m.toml")


def test_a_packed_file_that_ends_too_early_is_refused_in_one_sentence(tmp_path: Path) -> None:
    path = packed(wide(tmp_path / "plain.csv"), "csv.gz")
    path.write_bytes(path.read_bytes()[:900])
    assert "it ends within what was packed" in asked(path, tmp_path / "m.toml")
    with pytest.raises(TraceError, match="ends within what was packed"):
        load_traces(path, load_map(shipped_file("traces", "decanter")))


@pytest.mark.parametrize("level", [850.0, 85.0, 999.0])
def test_a_load_that_is_off_or_at_a_number_that_others_use_as_a_code_is_read(level: float, tmp_path: Path) -> None:
    plant = recording()
    current = np.where(plant.current > plant.current.mean(), level, 0.0)
    (trace,), report, said = mapped(wide(tmp_path / "a.csv", of=replace(plant, current=current)), tmp_path / "m.toml")
    assert report.files[0].bad_cells == 0 and "bad =" not in said["text"]
    assert any(level in values for values in trace.signals.values())


def test_a_code_of_many_digits_is_written_as_it_is(tmp_path: Path) -> None:
    plant = recording()
    heat = plant.heat.copy()
    heat[[5, 60]] = 2147483647.0
    (trace,), report, said = mapped(wide(tmp_path / "a.csv", of=replace(plant, heat=heat)), tmp_path / "m.toml")
    assert report.files[0].bad_cells == 2 and "2147483647" in said["text"]
    assert np.nanmax(trace.signals["Bearing_temperature"]) < 1e3


def test_rows_before_a_pause_of_the_recorder_are_spread_no_farther_than_others() -> None:
    times = np.repeat([0.0, 60.0, 120.0, 30_000.0, 30_060.0], 6)
    spread = spread_evenly(times)
    assert np.diff(spread).min() == pytest.approx(10.0) and spread[17] == pytest.approx(170.0)


def test_a_zone_that_there_is_not_is_one_sentence(tmp_path: Path) -> None:
    said = asked(wide(tmp_path / "a.csv", of=recording()), tmp_path / "m.toml", "--timezone", "Europe/Rom")
    assert "there is no time zone 'Europe/Rom'" in said


@pytest.mark.parametrize("names", [("log.2024-01.csv", "log.2024-02.csv"), ("a.1.csv", "a.2.csv")])
def test_all_parts_of_a_folder_are_read_whatever_dots_their_names_have(names: tuple[str, str], tmp_path: Path) -> None:
    lines = wide(tmp_path / "whole.csv", of=recording()).read_text(encoding="utf-8").splitlines(keepends=True)
    half = 1 + (len(lines) - 1) // 2
    folder = tmp_path / "parts"
    folder.mkdir()
    for name, rows in zip(names, (lines[1:half], lines[half:]), strict=True):
        (folder / name).write_text("".join([lines[0], *rows]), encoding="utf-8")
    (trace,), report, _ = mapped(folder, tmp_path / "m.toml")
    assert len(report.files) == 2 and trace.times.size == len(lines) - 1


def test_a_folder_of_several_kinds_of_files_is_refused_and_a_copy_beside_a_csv_is_none(tmp_path: Path) -> None:
    text = wide(tmp_path / "whole.csv", of=recording()).read_bytes()
    folder = tmp_path / "parts"
    folder.mkdir()
    (folder / "a.csv").write_bytes(text)
    (folder / "b.csv.gz").write_bytes(gzip.compress(text))
    assert "its files end in" in asked(folder, tmp_path / "m.toml")
    (folder / "b.csv.gz").rename(folder / "a.csv.gz")
    traces, _, _ = mapped(folder, tmp_path / "m.toml")
    assert len(traces) == 1
