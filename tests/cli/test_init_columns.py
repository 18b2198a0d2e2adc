"""Which tag a column of an export is: by its words, or as the only one of its kind; never by half a word."""

import pytest

from gateway.cli.setup.init import match_columns

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
