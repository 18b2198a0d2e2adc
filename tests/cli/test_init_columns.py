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
        (("TCuscinettiRiduttore",), "Linea2.TCuscinettiRiduttore [°C]", "TCuscinettiRiduttore"),
    ],
)
def test_a_column_is_the_tag_whose_words_it_has(tags: tuple[str, ...], header: str, tag: str | None) -> None:
    assert match_columns([header], tags).get(header) == tag


def test_of_two_columns_that_one_tag_might_be_neither_is_taken() -> None:
    assert match_columns(["Pump A running", "Pump B running"], PUMP) == {}


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
