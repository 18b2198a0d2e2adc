"""Kinds of exports that were once read wrong in silence, or refused for a reason that was not true."""

import zipfile
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from gateway.console import shipped_file
from sim.lab.recordings import TraceError, load_map, load_traces, parse_map, plain_time, sources
from tests.traces.exports import recording, wide, written
from tests.traces.test_dialects import asked, is_the_plant, mapped

PLANT = recording()


@pytest.mark.parametrize(
    ("good", "bad"), [("Good", "Bad"), ("192", "0"), ("Gut", "Schlecht"), ("GOOD", "BAD_COMM_FAILURE")]
)
def test_readings_of_a_quality_that_is_not_good_are_refused(good: str, bad: str, tmp_path: Path) -> None:
    lines = wide(tmp_path / "plain.csv").read_text(encoding="utf-8").splitlines()
    rows = [f"{line},{bad if number % 40 == 7 else good}" for number, line in enumerate(lines[1:])]
    rows = [f"{row.split(',')[0]},0,0,0,{bad}" if row.endswith(f",{bad}") else row for row in rows]
    export = written(tmp_path / "a.csv", f"{lines[0]},Quality", rows)
    (trace,), report, said = mapped(export, tmp_path / "m.toml")
    assert np.isnan(trace.signals["Bearing_temperature"][7::40]).all()
    assert report.files[0].bad_cells == 18 and any("not of a good quality" in line for line in said["report"])


def test_each_reading_of_a_long_file_has_its_own_quality_and_unknown_words_are_asked_for(tmp_path: Path) -> None:
    rows = []
    for number, (moment, heat, current) in enumerate(zip(PLANT.moments, PLANT.heat, PLANT.current, strict=True)):
        words = "Q7" if number % 40 == 7 else "Q1"
        rows += [f"{moment},Bearing temperature,{heat},{words}", f"{moment},Motor current,{current},Q1"]
    export = written(tmp_path / "a.csv", "Time,Tag,Value,Quality", rows)
    assert "--good Q1" in asked(export, tmp_path / "m.toml")
    (trace,), report, _ = mapped(export, tmp_path / "m.toml", "--good", "Q1")
    assert report.files[0].bad_cells == 6 and np.isnan(trace.signals["Bearing_temperature"][7::40]).all()
    assert not np.isnan(trace.signals["Motor_current"]).any()


def two_switches(path: Path, second: Sequence[int]) -> Path:
    """A German export with two switches that are both called running: the drive's, and the `second`."""
    plant = zip(PLANT.moments, PLANT.heat, PLANT.current, PLANT.running, second, strict=True)
    rows = [
        f"{moment:%d.%m.%Y %H:%M:%S};{'EIN' if on else 'AUS'};{'EIN' if other else 'AUS'};{load};{heat}".replace(
            ".", ","
        )
        for moment, heat, load, on, other in plant
    ]
    rows = [f"{row[:10].replace(',', '.')}{row[10:]}" for row in rows]
    return written(path, "Zeit;Antrieb Betrieb;Pumpe Betrieb;Motorstrom [A];Lagertemperatur [°C]", rows)


def test_of_two_switches_the_one_that_draws_the_load_is_the_machines_and_a_name_needs_no_unit(tmp_path: Path) -> None:
    late = np.concatenate(([0] * 12, PLANT.running[:-12]))
    export = two_switches(tmp_path / "a.csv", late.tolist())
    (trace,), _, _ = mapped(export, tmp_path / "m.toml", "--temperature", "Lagertemperatur")
    is_the_plant(trace, tmp_path / "m.toml")
    assert load_map(tmp_path / "m.toml").alphabet.channels[0].signal == "Antrieb_Betrieb"
    # Where both go with the load nothing tells them apart.
    nearly = PLANT.running.copy()
    nearly[-1] = 1 - nearly[-1]
    both = two_switches(tmp_path / "b.csv", nearly.tolist())
    assert "give --running 'Antrieb Betrieb' or --running 'Pumpe Betrieb'" in asked(both, tmp_path / "n.toml")


def with_quality(path: Path, words: Sequence[str]) -> Path:
    lines = wide(path.with_name("plain")).read_text(encoding="utf-8").splitlines()
    return written(path, f"{lines[0]},Quality", [f"{line},{word}" for line, word in zip(lines[1:], words, strict=True)])


@pytest.mark.parametrize("word", ["Bad", "Uncertain", "bad_comm", "Schlecht", "0"])
def test_a_quality_that_is_bad_throughout_is_asked_for_and_never_guessed_good(word: str, tmp_path: Path) -> None:
    export = with_quality(tmp_path / "a.csv", [word] * 240)
    assert f"--good {word} or --good none" in asked(export, tmp_path / "m.toml", "--yes")
    mapped(export, tmp_path / "m.toml", "--good", "none")
    most = with_quality(tmp_path / "b.csv", [word] * 200 + ["Q1"] * 40)
    assert "most likely" not in asked(most, tmp_path / "n.toml", "--yes")


def test_1_is_a_good_word_of_a_column_that_is_called_valid_and_of_no_other(tmp_path: Path) -> None:
    export = with_quality(tmp_path / "a.csv", ["0" if at == 9 else "1" for at in range(240)])
    assert "--good 1" in asked(export, tmp_path / "m.toml")
    export.write_text(export.read_text(encoding="utf-8").replace("Quality", "Validity"), encoding="utf-8")
    _, report, _ = mapped(export, tmp_path / "m.toml")
    assert report.files[0].bad_cells == 3


def test_a_quality_that_is_written_beside_few_readings_is_asked_for(tmp_path: Path) -> None:
    words = ["Bad" if at % 40 == 7 else "" for at in range(240)]
    export = with_quality(tmp_path / "a.csv", words)
    question = asked(export, tmp_path / "m.toml")
    assert "blank beside 234 of 240 readings" in question and "--good blank" in question
    (trace,), report, _ = mapped(export, tmp_path / "m.toml", "--yes")
    assert report.files[0].bad_cells == 18 and np.isnan(trace.signals["Bearing_temperature"][7::40]).all()
    both = with_quality(tmp_path / "b.csv", [word or ("Good" if at % 3 == 0 else "") for at, word in enumerate(words)])
    assert "most likely" not in asked(both, tmp_path / "n.toml", "--yes")
    _, report, _ = mapped(both, tmp_path / "n.toml", "--good", "Good", "--good", "blank")
    assert report.files[0].bad_cells == 18


def test_readings_with_a_blank_quality_are_counted_where_they_are_refused(tmp_path: Path) -> None:
    words = ["" if at % 4 == 0 else "Bad" if at == 9 else "Good" for at in range(240)]
    export = with_quality(tmp_path / "a.csv", words)
    _, report, said = mapped(export, tmp_path / "m.toml")
    assert report.files[0].bad_cells == 3 * 61
    assert any("61 readings are not of a good quality (60 x blank, 1 x 'Bad')" in line for line in said["report"])


@pytest.mark.parametrize("layout", ["wide", "long"])
def test_a_quality_of_the_map_that_the_file_does_not_have_is_said(layout: str, tmp_path: Path) -> None:
    export = with_quality(tmp_path / "a.csv", ["Bad" if at == 9 else "Good" for at in range(240)])
    if layout == "long":
        rows = [f"{at},Bearing temperature,{heat},Good" for at, heat in zip(PLANT.moments, PLANT.heat, strict=True)]
        export = written(tmp_path / "a.csv", "Time,Tag,Value,Quality", rows)
    mapped(export, tmp_path / "m.toml", "--current", "none")
    text = (tmp_path / "m.toml").read_text(encoding="utf-8")
    assert not load_traces(export, parse_map(text, "m.toml"))[1].warnings
    _, report = load_traces(export, parse_map(text.replace('["Quality"]', '["Qualty"]'), "m.toml"))
    assert len(report.warnings) == 1 and "there is no column 'Qualty'" in report.warnings[0]


def test_a_word_of_good_readings_that_stands_nowhere_is_refused(tmp_path: Path) -> None:
    plain = wide(tmp_path / "a.csv")
    assert "no column says a quality" in asked(plain, tmp_path / "m.toml", "--good", "Prima")
    export = with_quality(tmp_path / "b.csv", ["Good"] * 240)
    assert "the words of 'Quality' are Good" in asked(export, tmp_path / "m.toml", "--good", "Prima")


def tags(folder: Path, columns: dict[str, Sequence[object]], header: str = "Time,Value", more: str = "") -> Path:
    folder.mkdir()
    for name, cells in columns.items():
        rows = [f"{moment},{cell}{more}" for moment, cell in zip(PLANT.moments, cells, strict=True)]
        written(folder / f"{name}.csv", header, rows)
    return folder


def test_a_quality_in_a_file_of_its_own_is_that_of_the_readings_in_the_others(tmp_path: Path) -> None:
    words = ["Bad" if at % 40 == 7 else "Good" for at in range(240)]
    readings = {"Bearing temperature": PLANT.heat.tolist(), "Motor current": PLANT.current.tolist()}
    export = tags(tmp_path / "plant", {**readings, "Quality": words})
    (trace,), report, said = mapped(export, tmp_path / "m.toml")
    assert any("6 readings are not of a good quality" in line for line in said["report"])
    assert sum(file.bad_cells for file in report.files) == 12
    for signal in trace.signals.values():
        assert np.array_equal(np.flatnonzero(np.isnan(signal)), np.arange(7, 240, 40))
    # It holds until the next word, and before the first nothing is good.
    path = export / "Quality.csv"
    lines = path.read_text(encoding="utf-8").splitlines()
    told = [line for at, line in enumerate(lines[1:]) if at and (at % 40 in (7, 8) or at == 2)]
    written(path, lines[0], told)
    traces, _ = load_traces(export, load_map(tmp_path / "m.toml"))
    unknown = np.flatnonzero(np.isnan(traces[0].signals["Motor_current"]))
    assert unknown.tolist() == [0, 1, *range(7, 240, 40)]


def test_the_quality_of_notes_beside_it_is_not_taken_for_that_of_the_readings(tmp_path: Path) -> None:
    words = ["Bad" if at % 40 == 7 else "Good" for at in range(240)]
    readings = {"Bearing temperature": PLANT.heat.tolist(), "Motor current": PLANT.current.tolist()}
    export = tags(tmp_path / "plant", {**readings, "Quality": words})
    notes = [f"{moment}.500,note {at},Good" for at, moment in enumerate(PLANT.moments[:40])]
    written(export / "Notes.csv", "Time,Value,Quality", notes)
    (trace,), _, said = mapped(export, tmp_path / "m.toml")
    assert np.isfinite(trace.signals["Bearing_temperature"]).sum() == 240 - 6
    assert any("rows without readings" in line for line in said["report"])


@pytest.mark.parametrize("header", ["Time,Quality", "Time,Value"])
def test_a_quality_of_its_own_file_needs_no_name_that_all_share(header: str, tmp_path: Path) -> None:
    export = tags(tmp_path / "plant", {"Quality": ["Bad" if at % 40 == 7 else "Good" for at in range(240)]}, header)
    for name, values in (("Bearing temperature", PLANT.heat), ("Motor current", PLANT.current)):
        rows = [f"{moment},{value}" for moment, value in zip(PLANT.moments, values, strict=True)]
        written(export / f"{name}.csv", f"Time,{name}", rows)
    (trace,), _, said = mapped(export, tmp_path / "m.toml")
    assert any("6 readings are not of a good quality" in line for line in said["report"])
    for signal in ("Bearing_temperature", "Motor_current"):
        assert np.array_equal(np.flatnonzero(np.isnan(trace.signals[signal])), np.arange(7, 240, 40))


@pytest.mark.parametrize(
    ("of_quality", "header"), [("{} quality", "Time,Quality"), ("{}.Q", "Time,{}.Q"), ("{}.Q", "Time,Value")]
)
def test_a_quality_file_of_each_tag_judges_its_own(of_quality: str, header: str, tmp_path: Path) -> None:
    export = tmp_path / "plant"
    export.mkdir()
    for name, values, bad in (("TI10", PLANT.heat, 7), ("TI101", PLANT.heat + 9.0, 8), ("II101.PV", PLANT.current, 9)):
        rows = list(zip(PLANT.moments, values.tolist(), strict=True))
        written(export / f"{name}.csv", "Time,Value", [f"{moment},{value}" for moment, value in rows])
        words = [f"{moment},{0 if at % 40 == bad else 192}" for at, (moment, _) in enumerate(rows)]
        written(export / f"{of_quality.format(name)}.csv", header.format(name), words)
    (trace,), _, _ = mapped(export, tmp_path / "m.toml", "--temperature", "TI101/Value", "--current", "II101.PV/Value")
    for signal, bad in (("TI10", 7), ("TI101", 8), ("II101.PV", 9)):
        assert np.array_equal(np.flatnonzero(np.isnan(trace.signals[signal])), np.arange(bad, 240, 40))
    # One whose tag is not there judges no other.
    (export / "TI10.csv").unlink()
    (trace,), report = load_traces(export, load_map(tmp_path / "m.toml"))
    for signal, bad in (("TI101", 8), ("II101.PV", 9)):
        assert np.array_equal(np.flatnonzero(np.isnan(trace.signals[signal])), np.arange(bad, 240, 40))
    assert sum("its quality judges nothing" in line for line in report.warnings) == 1


def test_a_quality_that_is_named_after_one_tag_is_not_taken_for_that_of_all(tmp_path: Path) -> None:
    readings = {"TI101": PLANT.heat.tolist(), "II101": PLANT.current.tolist()}
    export = tags(tmp_path / "plant", {**readings, "TI101 quality": ["Good"] * 240})
    assert "stands in rows without readings" in asked(export, tmp_path / "m.toml", "--yes")


def test_one_file_a_tag_with_a_status_beside_each_value_and_days_of_one_tag(tmp_path: Path) -> None:
    readings = {"TI101": PLANT.heat.tolist(), "II101": PLANT.current.tolist()}
    export = tags(tmp_path / "plant", readings, "Time,Value,Status", ",Good")
    (trace,), _, said = mapped(export, tmp_path / "m.toml")
    assert said["temperature"] == "TI101/Value" and not np.isnan(trace.signals["TI101"]).any()
    days = tmp_path / "days"
    days.mkdir()
    rows = [f"{moment},{heat}" for moment, heat in zip(PLANT.moments, PLANT.heat, strict=True)]
    for part in range(3):
        written(days / f"{part}.csv", "Time,Bearing temperature", rows[part * 80 : part * 80 + 80])
    (trace,), _, _ = mapped(days, tmp_path / "n.toml")
    assert list(trace.signals)[:1] == ["Bearing_temperature"] and trace.times.size == 240


def test_each_value_with_a_clock_of_its_own_is_refused_where_these_differ(tmp_path: Path) -> None:
    cells = [
        (f"{moment}", heat, current)
        for moment, heat, current in zip(PLANT.moments, PLANT.heat, PLANT.current, strict=True)
    ]
    same = [f"{moment},{heat},{moment},{current}" for moment, heat, current in cells]
    other = [f"{a[0]},{a[1]},{b[0]},{b[2]}" for a, b in pairwise(cells)]
    header = "Time,Bearing temperature,Time,Motor current"
    assert "a clock of its own" in asked(written(tmp_path / "a.csv", header, other), tmp_path / "m.toml")
    (trace,), _, _ = mapped(written(tmp_path / "b.csv", header, same), tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")


@pytest.mark.parametrize("ambient", [14.0, 21.5])
def test_tenths_of_a_degree_are_asked_for_also_of_a_bearing_that_rests_in_the_cold(
    ambient: float, tmp_path: Path
) -> None:
    plant = recording(ambient=ambient)
    tenths = replace(plant, heat=np.round(plant.heat * 10))
    export = wide(tmp_path / "a.csv", of=tenths, cells=(lambda value: f"{value:.0f}", str, str))
    assert "0.1 degC" in asked(export, tmp_path / "m.toml")
    (trace,), _, _ = mapped(export, tmp_path / "m.toml", "--unit", "Bearing temperature=0.1 degC")
    is_the_plant(trace, tmp_path / "m.toml", plant, within=0.06)


@pytest.mark.parametrize("form", ["%a %b %d %H:%M:%S %Y", "%Y%m%dT%H%M%S"])
def test_more_clocks_that_programs_write(form: str, tmp_path: Path) -> None:
    (trace,), _, _ = mapped(wide(tmp_path / "a.csv", clock=lambda moment: moment.strftime(form)), tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")
    assert trace.times[0] == (datetime(2024, 3, 13, 9, 58) - datetime(1970, 1, 1)).total_seconds()
    assert plain_time("Sat Mar 02 00:30:00 +0100 2024") == "Mar 02 2024 00:30:00 +0100"


@pytest.mark.parametrize(("name", "size"), [("elapsed_min", 60.0), ("t_ms", 0.001)])
def test_elapsed_time_by_names_with_an_underscore(name: str, size: float, tmp_path: Path) -> None:
    begin = PLANT.moments[0]
    export = wide(
        tmp_path / "a.csv",
        header=f"{name},Bearing temperature,Motor current,Running",
        clock=lambda moment: f"{(moment - begin).total_seconds() / size:.6g}",
    )
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    assert trace.times[-1] - trace.times[0] == pytest.approx(2390.0, abs=1.0)


@pytest.mark.parametrize("name", ["TI-101.PV", "DB10.T_Bearing", "TT_204"])
def test_a_temperature_by_its_tag_is_not_passed_over_for_one_by_its_word(name: str, tmp_path: Path) -> None:
    rows = [
        f"{moment},{heat},{current},{15 + 0.01 * number:.2f}"
        for number, (moment, heat, current) in enumerate(zip(PLANT.moments, PLANT.heat, PLANT.current, strict=True))
    ]
    export = written(tmp_path / "a.csv", f"Time,{name},Motor current,Ambient temperature", rows)
    _, _, said = mapped(export, tmp_path / "m.toml")
    assert said["temperature"] == name


@pytest.mark.parametrize("header", ["Time;Bearing temperature", "Time,Bearing temperature"])
def test_decimal_commas_of_two_columns_are_no_separators(header: str, tmp_path: Path) -> None:
    rows = [f"{m:%d.%m.%Y %H:%M:%S};{heat:.2f}" for m, heat in zip(PLANT.moments, PLANT.heat, strict=True)]
    rows = [row[:20] + row[20:].replace(".", ",") for row in rows]
    export = written(tmp_path / "a.csv", header, rows)
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    assert np.allclose(trace.signals["Bearing_temperature"], PLANT.heat, atol=0.006)


def test_sessions_stored_on_change_whose_first_rows_have_words_and_blanks(tmp_path: Path) -> None:
    rows = []
    for session in (1, 2):
        for number, (heat, current, running) in enumerate(zip(PLANT.heat, PLANT.current, PLANT.running, strict=True)):
            word = "" if number % 9 and number not in (30, 150, 180) else ("Ein" if running else "Aus")
            rows.append(f"{session};{number / 6:.4f};{heat};{current if number % 3 else ''};{word}")
    export = written(tmp_path / "a.csv", "session;Time (min);Bearing temperature;Motor current;Running", rows)
    traces, _, _ = mapped(export, tmp_path / "m.toml", "--stored", "each row")
    assert len(traces) == 2 and load_map(tmp_path / "m.toml").clock.formats == ("minutes",)


def test_a_workbook_that_unpacks_to_more_than_is_opened_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sources, "MAX_UNPACKED_BYTES", 1000)
    with zipfile.ZipFile(tmp_path / "a.xlsx", "w", zipfile.ZIP_DEFLATED) as book:
        book.writestr("xl/worksheets/sheet1.xml", "0" * 100_000)
    said = asked(tmp_path / "a.xlsx", tmp_path / "m.toml")
    assert "the most that is opened" in said
    with pytest.raises(TraceError, match="the most that is opened"):
        load_traces(tmp_path / "a.xlsx", load_map(shipped_file("traces", "decanter")))


def test_the_order_of_dates_is_seen_in_all_rows_though_the_first_are_of_one_day(tmp_path: Path) -> None:
    """The language says day first; the month goes on from row to row, and the day after midnight."""
    plant = recording(step=60.0, times=45)
    export = wide(
        tmp_path / "a.csv",
        header="Zeitstempel,Lagertemperatur,Motorstrom,Betrieb",
        clock=lambda moment: moment.replace(month=5, day=moment.day - 11).strftime("%m/%d/%y %H:%M:%S"),
        of=plant,
    )
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    assert trace.times[-1] - trace.times[0] == plant.seconds[-1]
