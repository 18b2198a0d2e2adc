"""Which tag a column of an export is: by its words, or as the only one of its kind; never by half a word."""

from pathlib import Path

import pytest

from gateway.cli.setup.init import match_columns
from sim.lab.recordings import load_map
from tests.cli.support import decanter, refused

PUMP = ("PumpRun", "MotorPower", "DE_Temp", "NDE_Temp")
FAN = ("Lüfter_Betrieb", "Motorleistung", "T_Lager_AS", "T_Lager_BS", "Ölpumpe_Ein")


@pytest.mark.parametrize(
    ("tags", "header", "tag"),
    [
        (PUMP, "Pump 3 running", "PumpRun"),
        (PUMP, "Motor power (kW)", "MotorPower"),
        (PUMP, "Bearing NDE temperature (°C)", "NDE_Temp"),
        (PUMP[:3], "Bearing NDE temperature (°C)", None),
        (PUMP, "Line 2.DE_Temp [°C]", "DE_Temp"),
        (PUMP, "Running hours", None),
        (FAN, "Lüfter in Betrieb", "Lüfter_Betrieb"),
        (FAN, "Lagertemperatur AS [°C]", "T_Lager_AS"),
        (FAN, "Lagertemperatur [°C]", None),
        (FAN, "Leistung Motor [kW]", None),
        (("T_Palier_CA", "Moteur_Puissance"), "Puissance du moteur", "Moteur_Puissance"),
        (("Pump1Run",), "Pump 12 running", None),
        (("Pump1Run",), "Pump 1 running", "Pump1Run"),
        (("BearingTemp1", "BearingTemp2"), "Bearing temp 10", None),
        (("TT101",), "TT-1011", None),
        (("MotorCurrent",), "Motor current limit", None),
        (("MotorCurrent", "MotorCurrentLimit"), "Motor current limit", "MotorCurrentLimit"),
        (PUMP, "Pump running hours", None),
        (("FeedFlow",), "Feed flow totalizer", None),
        (("TCuscinettiRiduttore",), "Linea2.TCuscinettiRiduttore [°C]", "TCuscinettiRiduttore"),
    ],
)
def test_a_column_is_the_tag_whose_words_it_has(tags: tuple[str, ...], header: str, tag: str | None) -> None:
    assert match_columns([header], tags).get(header) == tag


def test_of_two_columns_that_one_tag_might_be_neither_is_taken() -> None:
    assert match_columns(["Pump A running", "Pump B running"], PUMP) == {}
    assert match_columns(["Flow 1 in", "Flow 1 out"], ["Flow1"]) == {}
    assert match_columns(["Flow 1", "Flow 11", "Flow 1 mean"], ["Flow1"]) == {"Flow 1": "Flow1"}


def test_an_event_that_is_no_tag_is_said_of_the_map_that_is_written(tmp_path: Path) -> None:
    (tmp_path / "io.csv").write_text(
        "Tag,Address,Type,Unit\nMotorCurrent,30101,REAL,A\nBearingTemp2,30103,REAL,degC\nPump1Run,10004,BOOL,\n",
        "utf-8",
    )
    rows = [
        f"{1_700_000_000 + 5 * row},{20 + row / 10},90,{row // 30 % 2 * 80 + row % 3},{row // 30 % 2}"
        for row in range(200)
    ]
    header = "time,Bearing temp 2,Motor current limit,Motor current,Pump 12 running"
    (tmp_path / "export.csv").write_text("\n".join([header, *rows]) + "\n", "utf-8")
    words = ("init", tmp_path / "p", "--host", "192.0.2.1", "--list", tmp_path / "io.csv", "--heartbeat", "Pump1Run")
    done = decanter(*words, "--trace", tmp_path / "export.csv", "--rename", "Motor current limit=MotorCurrent")
    assert done.exit_code == 0, done.output
    assert "'Motor current' of the trace is no tag of the device" in " ".join(done.stderr.split())


def test_where_no_column_is_called_as_the_temperature_is_the_rename_that_helps_is_said(tmp_path: Path) -> None:
    (tmp_path / "io.csv").write_text(
        "Tag,Address,Type,Unit\nPumpRun,10004,BOOL,\nMotorPower,30101,REAL,kW\nDE_Temp,30103,REAL,degC\n", "utf-8"
    )
    rows = [
        f"2026-03-01 {row // 60:02d}:{row % 60:02d}:00,{row // 30 % 2},{row // 30 % 2 * 12.5},"
        f"{20 + row / 10},{30 + row / 9:.1f}"
        for row in range(200)
    ]
    header = "Time,Pump running,Motor power (kW),Bearing one (°C),Bearing two (°C)"
    (tmp_path / "export.csv").write_text("\n".join([header, *rows]) + "\n", "utf-8")
    words = ("init", tmp_path / "p", "--host", "192.0.2.1", "--list", tmp_path / "io.csv", "--temperature", "DE_Temp")
    words = (*words, "--trace", tmp_path / "export.csv")
    refused(decanter(*words), 2, "--rename 'Bearing one (°C)'=DE_Temp or --rename 'Bearing two (°C)'=DE_Temp")
    assert decanter(*words, "--rename", "Bearing two (°C)=DE_Temp").exit_code == 0
    read = load_map(tmp_path / "p" / "columns.toml")
    assert read.signal_names("DE_Temp") == ("Bearing two (°C)",) and read.temperature == "DE_Temp"


@pytest.mark.parametrize("both", [False, True])
def test_of_two_switches_the_one_that_is_a_tag_is_taken_and_of_two_tags_none(both: bool, tmp_path: Path) -> None:
    pump = "Pumpe_EIN,10005,BOOL,\n" if both else ""
    (tmp_path / "io.csv").write_text(
        f"Tag,Address,Type,Unit\nMotor_EIN,10004,BOOL,\n{pump}Strom,30101,REAL,A\nLager_T,30103,REAL,degC\n", "utf-8"
    )
    words = ("AUS", "EIN")
    rows = [
        f"{1_700_000_000 + 5 * row},{words[row // 50 % 2]},{words[row // 30 % 2]},{80 + row % 3},{20 + row / 10}"
        for row in range(200)
    ]
    text = "\n".join(["time,Pumpe EIN,Motor EIN,Strom (A),Lager T (degC)", *rows]) + "\n"
    (tmp_path / "export.csv").write_text(text, "utf-8")
    given = ("init", tmp_path / "p", "--host", "192.0.2.1", "--list", tmp_path / "io.csv", "--heartbeat", "Motor_EIN")
    done = decanter(*given, "--trace", tmp_path / "export.csv")
    if both:
        refused(done, 2, "columns that may be the running: 'Pumpe EIN', 'Motor EIN'")
        return
    assert done.exit_code == 0, done.output
    assert "'Motor EIN' of the trace is taken for the switch, the only one of several that is a tag" in done.output
    assert load_map(tmp_path / "p" / "columns.toml").signal_names("Motor_EIN") == ("Motor EIN",)


def test_a_column_that_was_renamed_takes_its_tag_away_from_the_one_that_is_called_alike(tmp_path: Path) -> None:
    (tmp_path / "io.csv").write_text(
        "Tag,Address,Type,Unit\nMotor_EIN,10004,BOOL,\nStrom,30101,REAL,A\nLager_T,30103,REAL,degC\n", "utf-8"
    )
    states = ("AUS", "EIN")
    rows = [
        f"{1_700_000_000 + 5 * row},{states[row // 50 % 2]},{states[row // 30 % 2]},{80 + row % 3},{20 + row / 10}"
        for row in range(200)
    ]
    header = "time,Pumpe EIN,%s,Strom (A),Lager T (degC)"
    trace = tmp_path / "export.csv"
    trace.write_text("\n".join([header % "Motor EIN", *rows]) + "\n", "utf-8")
    words = ("init", tmp_path / "p", "--host", "192.0.2.1", "--list", tmp_path / "io.csv", "--heartbeat", "Motor_EIN")
    done = decanter(*words, "--trace", trace, "--rename", "Pumpe EIN=Motor_EIN")
    assert done.exit_code == 0, done.output
    assert load_map(tmp_path / "p" / "columns.toml").signal_names("Motor_EIN")[0] == "Pumpe EIN"
    # A column that the trace does not have takes nothing away.
    done = decanter(*words, "--overwrite", "--trace", trace, "--rename", "Pumpe_EIN=Motor_EIN")
    assert done.exit_code == 0, done.output
    assert load_map(tmp_path / "p" / "columns.toml").signal_names("Motor_EIN")[0] == "Motor EIN"
    # Where none of them is a tag the way out is said.
    trace.write_text("\n".join([header % "Band EIN", *rows]) + "\n", "utf-8")
    refused(decanter(*words, "--overwrite", "--trace", trace), 2, "--rename 'Pumpe EIN'=TAG or --rename 'Band EIN'=TAG")
    assert decanter(*words, "--overwrite", "--trace", trace, "--rename", "Band EIN=Motor_EIN").exit_code == 0
