"""What all rows of a list show of cells that may mean two things each; where they show nothing it is asked."""

from pathlib import Path
from typing import Any

import pytest

from gateway.commission.files.io_list import IoList, ListError, Reading, read_io_list


def read(folder: Path, text: str, how: Reading | None = None, columns: dict[str, str] | None = None) -> IoList:
    path = folder / "list.csv"
    path.write_text(text, encoding="utf-8")
    return read_io_list(path, how or Reading(), columns)


def keys(found: IoList) -> dict[str, dict[str, Any]]:
    assert not found.problems, found.problems
    return {tag.name: {key: value for key, value in tag.keys.items() if value is not None} for tag in found.tags}


INVERTER = (
    "Address;Name;R/W;Data Type;Unit;Accuracy;Length\n35000;Version;RO;U16;N/A;1;1\n35003;Serial;RO;STR;N/A;1;8\n"
    "35103;Voltage;RO;U16;V;10;1\n35105;Power;RO;U32;W;1;2\n"
)


def test_an_inverters_accuracy_scales_its_addresses_are_asked_for_and_its_texts_have_registers(tmp_path: Path) -> None:
    asked = read(tmp_path, INVERTER)
    assert len(asked.problems) == 4 and not asked.tags
    assert all("--numbers decimal" in problem and "--numbers plain" in problem for problem in asked.problems)
    scaled = read(tmp_path, INVERTER, Reading(numbers="plain"))
    assert len(scaled.problems) == 1 and "'Accuracy'" in scaled.problems[0] and "--gain divide" in scaled.problems[0]
    found = keys(read(tmp_path, INVERTER, Reading(numbers="plain", gain="divide")))
    assert found["Voltage"] == {"address": "holding:35103", "dtype": "uint16", "scale": 0.1, "unit": "V"}
    assert found["Serial"] == {"address": "holding:35003", "dtype": "string", "length": 16}
    assert "unit" not in found["Version"]


@pytest.mark.parametrize(
    ("header", "cells", "scales"),
    [
        ("Accuracy", ("0.1", "1", "0,01"), (0.1, 1.0, 0.01)),
        ("Precision", ("0.1", "1", ""), (0.1, 1.0, None)),
        ("Precision", ("1", "2", "0"), (0.1, 0.01, 1.0)),
        ("Accuracy", ("0.1 °C", "0.5 °C", "1 °C"), (None, None, None)),
        ("Accuracy", ("class 0.5", "2 LSB", "12 bit"), (None, None, None)),
        ("Sensor accuracy", ("0.1", "0.1", "1"), (None, None, None)),
        ("Totband", ("0.1", "1", "10"), (None, None, None)),
        ("Dead band", ("0.1", "1", "10"), (None, None, None)),
        ("Hysterese", ("0.1", "1", "10"), (None, None, None)),
        ("Update rate", ("0.1", "1", "10"), (None, None, None)),
        ("Zykluszeit [s]", ("0.1", "1", "10"), (None, None, None)),
        ("Messgenauigkeit", ("0.1", "1", "10"), (None, None, None)),
        ("Class", ("0.1", "1", "10"), (None, None, None)),
        ("Accuracy", ("±0.5 %", "±1 %", "+/- 2"), (None, None, None)),
        ("Accuracy (%)", ("0.1", "1", "1"), (None, None, None)),
        ("Step size", ("5", "1", "2"), (None, None, None)),
    ],
)
def test_an_accuracy_is_what_its_cells_show(
    header: str, cells: tuple[str, ...], scales: tuple[float | None, ...], tmp_path: Path
) -> None:
    rows = "".join(f"T{at};{100 + at};INT16;{cell}\n" for at, cell in enumerate(cells))
    found = keys(read(tmp_path, f"Name;Address;Type;{header}\n{rows}"))
    assert tuple(found[f"T{at}"].get("scale") for at in range(3)) == scales


@pytest.mark.parametrize(
    ("header", "kind", "cells"),
    [
        ("Accuracy", "INT16", ("1", "1")),
        ("Accuracy", "INT16", ("0.5", "1")),
        ("Accuracy", "INT16", ("2", "5")),
        ("Accuracy", "INT16", ("0.1", "0.1")),
        ("Genauigkeit", "INT16", ("2", "2")),
        ("Precision", "INT16", ("0.5", "0.2")),
        ("Accuracy", "FLOAT32", ("0.1", "0.1")),
        ("Accuracy", "INT16", ("±0.5 %", "0.1")),
    ],
)
def test_an_accuracy_whose_cells_leave_it_open_is_asked_for(
    header: str, kind: str, cells: tuple[str, str], tmp_path: Path
) -> None:
    rows = "".join(f"T{at};{100 + 2 * at};{kind};{cell}\n" for at, cell in enumerate(cells))
    text = f"Name;Address;Type;{header}\n{rows}"
    with pytest.raises(ListError, match=f"--column scale='{header}'.*--column no_scale='{header}'"):
        read(tmp_path, text)
    assert "scale" not in keys(read(tmp_path, text, None, {"no_scale": header}))["T0"]


def test_a_column_that_is_called_as_a_scale_and_is_none_can_be_said_to_be_none(tmp_path: Path) -> None:
    text = "Name;Address;Type;Precision\nA;100;INT16;10 bit\nB;101;INT16;12 bit\n"
    with pytest.raises(ListError, match="or --column no_scale='Precision'"):
        read(tmp_path, text)
    assert "scale" not in keys(read(tmp_path, text, None, {"no_scale": "Precision"}))["A"]


def test_what_an_accuracy_was_taken_for_is_said(tmp_path: Path) -> None:
    found = read(tmp_path, "Name;Address;Type;Accuracy\nA;100;INT16;0.1\nB;101;INT16;1\n")
    assert "scale by Accuracy (0.1)" in found.tags[0].taken


def test_a_column_of_fractions_of_ten_is_not_passed_over_by_any_name(tmp_path: Path) -> None:
    text = "Name;Address;Type;{}\nA;100;INT16;0.1\nB;101;INT16;1\n"
    with pytest.raises(ListError, match="--column scale='Valenza'"):
        read(tmp_path, text.format("Valenza"))
    assert keys(read(tmp_path, text.format("Valenza"), None, {"scale": "Valenza"}))["A"]["scale"] == 0.1
    assert "scale" not in keys(read(tmp_path, text.format("Deadband")))["A"]
    with pytest.raises(ListError, match="--column scale='Step size' if so, or --column no_scale='Step size'"):
        read(tmp_path, text.format("Step size"))
    assert "scale" not in keys(read(tmp_path, text.format("Step size"), None, {"no_scale": "Step size"}))["A"]
    assert (
        "scale" not in keys(read(tmp_path, text.format("Step").replace("INT16", "FLOAT32").replace("101", "102")))["A"]
    )


@pytest.mark.parametrize(
    "addresses",
    [("45000", "45103"), ("40000", "40002"), ("35100", "47000"), ("40001", "50010"), ("40070", "100"), ("33022",)],
)
def test_numbers_that_may_be_references_or_addresses_are_asked_for(addresses: tuple[str, ...], tmp_path: Path) -> None:
    text = "Name;Address;Type\n" + "".join(f"T{at};{cell};INT16\n" for at, cell in enumerate(addresses))
    asked = read(tmp_path, text)
    long = [cell for cell in addresses if len(cell) > 4]
    assert sum("--numbers plain" in problem for problem in asked.problems) == sum(cell[0] in "34" for cell in long)
    plain = keys(read(tmp_path, text, Reading(numbers="plain")))
    assert [tag["address"] for tag in plain.values()] == [f"holding:{cell}" for cell in addresses]


@pytest.mark.parametrize(
    ("addresses", "first"),
    [
        (("40101", "45000"), "holding:100"),
        (("30001", "45000"), "input:0"),
        (("400101", "45000"), "holding:100"),
        (("00001", "45000"), "coil:0"),
        (("40101", "70000"), "holding:100"),
    ],
)
def test_numbers_near_the_first_or_of_six_digits_are_references(
    addresses: tuple[str, str], first: str, tmp_path: Path
) -> None:
    found = read(tmp_path, "Name;Address\n" + "".join(f"T{at};{cell}\n" for at, cell in enumerate(addresses)))
    assert found.tags[0].keys["address"] == first
    assert not any("--numbers" in problem for problem in found.problems)


@pytest.mark.parametrize(
    ("rows", "length"),
    [
        ("A;1;UINT16;1\nB;2;UINT32;2\nS;10;STRING;8\n", 16),
        ("A;1;UINT16;2\nB;2;UINT32;4\nS;10;STRING;8\n", 8),
        ("A;1;UINT16;16\nB;2;UINT32;32\nS;10;STRING;64\n", 8),
        ("A;1;BOOL;1\nS;10;STRING;8\n", 8),
    ],
)
def test_a_texts_length_counts_what_the_numbers_of_its_list_do(rows: str, length: int, tmp_path: Path) -> None:
    assert keys(read(tmp_path, f"Name;Address;Type;Length\n{rows}"))["S"]["length"] == length


@pytest.mark.parametrize(("behind", "length"), [("806", 12), ("803", 6), ("807", 6)])
def test_a_string_of_six_has_registers_where_the_next_row_is_right_behind_them(
    behind: str, length: int, tmp_path: Path
) -> None:
    text = f"Name;Address;Type\nSerial;800;string[6]\nRelay;{behind};uint16\n"
    assert keys(read(tmp_path, text))["Serial"]["length"] == length


def test_round_addresses_show_no_length(tmp_path: Path) -> None:
    found = keys(read(tmp_path, "Name;Address;Type\nA;100;string[10]\nB;110;string[10]\nC;120;uint16\n"))
    assert found["A"]["length"] == 10 and found["B"]["length"] == 10


def test_a_length_that_says_bytes_is_of_bytes(tmp_path: Path) -> None:
    text = "Name;Address;Type;Length in bytes\nA;1;UINT16;1\nS;10;STRING;8\n"
    assert keys(read(tmp_path, text))["S"]["length"] == 8


def test_a_header_that_says_references_and_a_bit_without_a_table_leave_no_doubt(tmp_path: Path) -> None:
    told = keys(read(tmp_path, "Name;Register 4xxxx;Type\nA;41001;INT16\nB;41003;INT16\n"))
    assert told["A"]["address"] == "holding:1000"
    beside = read(tmp_path, "Name;Address;Type\nA;40001;INT16\nB;17;BOOL\n")
    assert beside.tags[0].keys["address"] == "holding:0" and not any("--numbers" in each for each in beside.problems)


HEAT_PUMP = (
    "Title\tRegister type\tRegister\tDivision factor\tUnit\tSize of variable\tMin value\tMax value\n"
    "Outdoor\tMODBUS_INPUT_REGISTER\t1\t10\t°C\ts16\t0\t0\n"
    "Supply\tMODBUS_HOLDING_REGISTER\t32\t10\t°C\ts16\t50\t800\n"
    "Degrees\tMODBUS_HOLDING_REGISTER\t33\t10\t\ts16\t-30000\t30000\n"
    "Return\tMODBUS_HOLDING_REGISTER\t34\t10\t°C\ts16\t50\t700\n"
    "Mode\tMODBUS_HOLDING_REGISTER\t39\t1\t\tu8\t0\t0\n"
    "Odd\tMODBUS_HOLDING_REGISTER\t40\t1\t\t3\t0\t0\n"
)


def test_a_heat_pumps_list_is_read_by_its_sizes_division_and_ranges_of_counts(tmp_path: Path) -> None:
    found = read(tmp_path, HEAT_PUMP)
    outdoor, supply, degrees, _, _ = (tag.keys for tag in found.tags)
    assert (outdoor["address"], outdoor["dtype"], outdoor["scale"]) == ("input:1", "int16", 0.1)
    assert outdoor["low"] is None and "0 to 0 is no range" in found.tags[0].taken
    assert (supply["address"], supply["low"], supply["high"]) == ("holding:32", 5.0, 80.0)
    assert (degrees["low"], degrees["high"]) == (-3000.0, 3000.0)
    assert "as line 4 shows" in found.tags[1].taken
    assert len(found.problems) == 1 and "'3' is no type" in found.problems[0]


@pytest.mark.parametrize("other", ["Degrees;33;s16;10;-30000.5;30000", "Degrees;33;s16;10;-300;300", ""])
def test_ranges_of_a_list_are_in_units_unless_one_of_them_shows_counts(other: str, tmp_path: Path) -> None:
    head = "Name;Register;Type;Division factor;Min;Max\n"
    found = read(tmp_path, f"{head}Supply;32;s16;10;50;800\nReturn;34;s16;10;50;700\n{other}\n")
    assert (found.tags[0].keys["low"], found.tags[0].keys["high"]) == (50.0, 800.0)


def test_an_example_in_a_remark_says_which_way_a_scale_goes(tmp_path: Path) -> None:
    text = (
        "Name;Address;Type;Unit;Scale Factor;Description\nA;100;int16;°C;*10;Target (e.g. 450 = 45.0°C)\n"
        "B;101;int16;°C;*10;Target of circuit 2\nC;102;int16;°C;1/10;Flow (e.g. 490 = 49.0°C)\n"
        "D;103;int16;W;*100;Power\n"
    )
    found = read(tmp_path, text)
    assert [tag.keys["scale"] for tag in found.tags] == [0.1, 0.1, 0.1, 100.0]
    assert "'450 = 45.0' of line 2" in found.tags[1].taken


@pytest.mark.parametrize(("kind", "order"), [("ASCII_LE", "BADC"), ("STRING BADC", "BADC"), ("ASCII", None)])
def test_a_text_whose_type_says_low_bytes_first_is_read_so(kind: str, order: str | None, tmp_path: Path) -> None:
    found = read(tmp_path, f"Name;Address;Type;Length\nS;100;{kind};10\n")
    assert (found.tags[0].keys["dtype"], found.tags[0].keys["order"]) == ("string", order)


def test_a_text_of_swapped_words_is_refused(tmp_path: Path) -> None:
    assert "swaps words" in read(tmp_path, "Name;Address;Type;Length\nS;100;STRING CDAB;10\n").problems[0]


def test_a_type_of_r_and_rw_is_no_type(tmp_path: Path) -> None:
    found = read(tmp_path, "Name;Address;Type\nA;100;R/W\nB;101;R\nC;102;W\n")
    assert [tag.keys["dtype"] for tag in found.tags] == ["uint16", "uint16"]
    assert len(found.problems) == 1 and "cannot be read" in found.problems[0]


def test_a_list_without_headers_is_told_to_have_one_and_registers_may_be_addresses(tmp_path: Path) -> None:
    with pytest.raises(ListError, match="has no line of headers, its line 1 has '0x0000'"):
        read(tmp_path, "0x0000;v1\n0x0002;v2\n")
    with pytest.raises(ListError, match="perhaps --column address='Registers'"):
        read(tmp_path, "Name;Registers;Data Type\nA;3000;Uint16\nB;3001;Uint16\n")
