"""Register lists as makers and programs write them: each row whole, or refused with its reason; nothing in silence."""

import re
from pathlib import Path
from typing import Any

import pytest
from openpyxl import Workbook

from gateway.commission.files.cells import MOST_ROWS
from gateway.commission.files.io_list import IoList, ListError, Reading, read_io_list

SHARED = Path(__file__).parents[3] / "shared" / "cases" / "devices"
_PLAIN = Reading()


def read(folder: Path, text: str, how: Reading = _PLAIN, columns: dict[str, str] | None = None) -> IoList:
    path = folder / "list.csv"
    path.write_text(text, encoding="utf-8")
    return read_io_list(path, how, columns)


def row(folder: Path, header: str, cells: str, how: Reading = _PLAIN) -> dict[str, Any] | str:
    """The keys of a list's one row, or why it was refused."""
    found = read(folder, f"Name;{header}\nT;{cells}\n", how)
    if found.problems:
        return found.problems[0]
    return {
        **{key: value for key, value in found.tags[0].keys.items() if value is not None},
        "how": found.tags[0].taken,
    }


@pytest.mark.parametrize(
    ("cell", "unit", "scale"),
    [
        ("0.1 °C", "degC", 0.1),
        ("0,1°C", "degC", 0.1),
        ("0.1A", "A", 0.1),
        ("x0.1 V", "V", 0.1),
        ("1/10 °C", "degC", 0.1),
        ("°C/10", "degC", 0.1), ("°C ÷10", "degC", 0.1), ("kWh (x 0.01)", "kWh", 0.01), ("V [0.1V]", "V", 0.1),
        ("10 W", "W", 10.0),
        ("10^-2 bar", "bar", 0.01),
        ("10⁻¹ m³/h", "m³/h", 0.1),
        ("0.1", "", 0.1),
        ("÷10", "", 0.1),
        ("0.01 m3/h", "m3/h", 0.01), ("tenths of °C", "degC", 0.1), ("A x 0.1", "A", 0.1), ("0.1 %/bit", "%", 0.1),
        ("1/min", "rpm", None), ("m3/h", "m3/h", None), ("l/100 km", "l/100 km", None), ("mg/Nm3", "mg/Nm3", None),
        ("kW", "kW", None), ("min-1", "rpm", None), ("ppm CO2", "ppm CO2", None), ("°C", "degC", None),
    ],
)  # fmt: skip
def test_a_factor_in_a_units_cell_is_the_scale(cell: str, unit: str, scale: float | None, tmp_path: Path) -> None:
    found = row(tmp_path, "Address;Type;Unit", f"100;INT16;{cell}")
    assert isinstance(found, dict), found
    assert (found.get("unit", ""), found.get("scale")) == (unit, pytest.approx(scale) if scale else None)
    assert scale is None or "from the unit" in found["how"]


@pytest.mark.parametrize("cell", ["0-10 V", "4-20 mA", "°C*10", "V x 100", "10", "3 phases", "kW/4", "°C 24"])
def test_a_digit_in_a_units_cell_that_nobody_reads_refuses_the_row(cell: str, tmp_path: Path) -> None:
    found = row(tmp_path, "Address;Type;Unit", f"100;INT16;{cell}")
    assert isinstance(found, str) and "line 2, 'Unit'" in found


@pytest.mark.parametrize(
    ("header", "cells", "scale"),
    [
        ("Scale", "0.1", 0.1), ("Scale", "/10", 0.1), ("Scale", "x 0,1", 0.1), ("Scale", "1/100", 0.01),
        ("Scale", "10^-2", 0.01),
        ("Divisor", "10", 0.1),
        ("Scale (inverse)", "100", 0.01),
        ("Multiplier", "10", 10.0),
        ("Decimals", "2", 0.01), ("Exponent", "-1", 0.1), ("Scale", "*10", 10.0), ("Scale", "raw/10", 0.1),
        ("Gain;Range", "10;-3276.8 to 3276.7", 0.1), ("Gain;Range", "10;0..300000", 10.0),
        ("Scale;Unit", "0.1;0.1 A", 0.1), ("Ratio;Min;Max", "10;0;0.5", 0.1),
    ],
)  # fmt: skip
def test_a_scale_is_what_its_cell_header_and_range_say(header: str, cells: str, scale: float, tmp_path: Path) -> None:
    found = row(tmp_path, f"Address;Type;{header}", f"100;INT16;{cells}")
    assert isinstance(found, dict), found
    assert found["scale"] == pytest.approx(scale)


@pytest.mark.parametrize(
    ("header", "cells", "word"),
    [
        ("Gain", "10", "--gain"),
        ("Scale", "100", "--gain"),
        ("Scale", "Square Root", "curve"),
        ("Scale", "Linear", "ends"),
        ("Scale;Unit", "0.01;0.1 A", "correct one"), ("Scale;Range", "0.1;0 to 10000", "beyond"),
        ("Range", "-3276.8 to 3276.7", "parts of a count"), ("Sentinel", "broken", "no number"),
    ],
)  # fmt: skip
def test_a_scale_that_contradicts_or_is_open_is_asked_for(header: str, cells: str, word: str, tmp_path: Path) -> None:
    found = row(tmp_path, f"Address;Type;{header}", f"100;INT16;{cells}")
    assert isinstance(found, str) and word in found


def test_a_gain_is_settled_by_its_option_or_by_another_row(tmp_path: Path) -> None:
    for gain, scale in (("multiply", 10.0), ("divide", 0.1)):
        found = row(tmp_path, "Address;Type;Gain", "100;INT16;10", Reading(gain=gain))
        assert isinstance(found, dict) and found["scale"] == pytest.approx(scale) and gain[:5] in found["how"]
    of_all = read(tmp_path, "Name;Address;Type;Gain;Range\nA;1;INT16;10;-3276.8 to 3276.7\nB;3;INT32;1000;\n")
    assert [tag.keys["scale"] for tag in of_all.tags] == [pytest.approx(0.1), pytest.approx(0.001)]


@pytest.mark.parametrize(
    ("cell", "dtype", "order"),
    [
        ("32 bit float, little endian", "float32", "DCBA"),
        ("FLOAT32_LE", "float32", "DCBA"),
        ("Float CD AB", "float32", "CDAB"),
        ("UINT32 (word swapped)", "uint32", "CDAB"), ("Float big-endian byte swap", "float32", "BADC"),
        ("32-bit signed little-endian byte swap", "int32", "CDAB"), ("REAL (ABCD)", "float32", "ABCD"),
        ("U32 low word first", "uint32", "CDAB"),
        ("signed 32bit", "int32", "ABCD"),
        ("64-bit unsigned integer", "uint64", "ABCD"),
        ("Unsigned (2 registers)", "uint32", "ABCD"), ("LBCD", "bcd32", "ABCD"), ("DWORD", "uint32", "ABCD"),
        ("acc32", "uint32", "ABCD"), ("Float4", "float32", "ABCD"),
    ],
)  # fmt: skip
def test_every_word_of_a_types_cell_counts(cell: str, dtype: str, order: str, tmp_path: Path) -> None:
    found = row(tmp_path, "Address;Type", f"100;{cell}")
    assert isinstance(found, dict), found
    assert (found["dtype"], found["order"]) == (dtype, order)


@pytest.mark.parametrize(
    "cell", ["Word Array", "float backwards", "INT16 packed", "date", "float 24 bit", "time of day"]
)
def test_a_type_of_which_a_word_is_unknown_is_refused(cell: str, tmp_path: Path) -> None:
    found = row(tmp_path, "Address;Type", f"100;{cell}")
    assert isinstance(found, str) and "line 2, 'Type'" in found


@pytest.mark.parametrize(
    ("header", "cells", "dtype"),
    [
        ("Type;Quantity", "Unsigned;2", "uint32"),
        ("Type;Registers", "signed;4", "int64"),
        ("Type;Words", "DINT;2", "int32"),
    ],
)
def test_a_number_of_registers_makes_a_type_wide(header: str, cells: str, dtype: str, tmp_path: Path) -> None:
    found = row(tmp_path, f"Address;{header}", f"100;{cells}")
    assert isinstance(found, dict) and found["dtype"] == dtype
    wrong = row(tmp_path, "Address;Type;Quantity", "100;UINT16;2")
    assert isinstance(wrong, str) and "1 register" in wrong


@pytest.mark.parametrize(
    ("header", "cells", "place"),
    [
        ("Function;Address;Type", "03/06/16;40101-40102;REAL", "holding:100"),
        ("Function;Address;Type", "3, 16;100~101;DINT", "holding:100"),
        ("Function;Address;Type", "FC04;3x119;INT", "input:118"),
        ("Function;Address;Type", "03h/10h;100..101;DINT", "holding:100"),
        ("Function;Address;Type", "4;100 to 101;DINT", "input:100"), ("Address;Type", "40101-02;REAL", "holding:100"),
        ("Function;Address;Type", "1/5/15;12;BOOL", "coil:12"), ("Register (HEX);Type", "0064;INT", "holding:100"),
        ("Address (hex);Type", "1F0;INT", "holding:496"), ("Register (1-based);Type", "101;INT", "holding:100"),
        ("Address;Type", "0x0064;INT", "holding:100"),
        ("Address;Type", "64h;INT", "holding:100"),
        ("Address;Type", "%MW100;INT", "holding:100"),
    ],
)  # fmt: skip
def test_an_address_is_taken_with_its_function_range_and_header(
    header: str, cells: str, place: str, tmp_path: Path
) -> None:
    found = row(tmp_path, header, cells)
    assert isinstance(found, dict), found
    assert found["address"] == place


@pytest.mark.parametrize(
    ("header", "cells", "word"),
    [
        ("Address;Type", "40101-40102;INT", "2"),
        ("Address;Type", "40101-40104;REAL", "4"),
        ("Address;Type", "100[10];INT", "array"),
        ("Function;Address;Type", "6/16;100;INT", "only writes"), ("Function;Address;Type", "04;40101;INT", "input"),
        ("Address;Type", "HR100;INT", "counts from"),
        ("Address;Type", "40101.3;DINT", "bit 3"),
        ("Function;Address;Type", "1;100;REAL", "one bit"),
        ("Address;Type", "0x0064;BOOL", "--numbers"), ("Address;Type;Access", "100;INT;WO", "cannot be read"),
    ],
)  # fmt: skip
def test_an_address_that_contradicts_is_refused(header: str, cells: str, word: str, tmp_path: Path) -> None:
    found = row(tmp_path, header, cells)
    assert isinstance(found, str) and word in found


@pytest.mark.parametrize(
    ("plc", "cell", "place", "bit"),
    [
        ("openplc", "%QX1.3", "coil:11", None),
        ("openplc", "%MD50", "holding:2148", None),
        ("openplc", "%MW5", "holding:1029", None),
        ("codesys", "%MD50", "holding:100", None),
        ("codesys", "%MX10.3", "holding:5", 3),
        ("codesys", "%MX11.3", "holding:5", 11),
        ("schneider", "%MD50", "holding:50", None),
        ("schneider", "%MW50.4", "holding:50", 4),
        ("schneider", "%M7", "coil:7", None),
        ("wago", "%MW0", "holding:12288", None),
        ("wago", "%IX2.15", "discrete:47", None),
        ("codesys", "%QX1.3", "coil:11", None),
    ],
)  # fmt: skip
def test_an_iec_address_lies_where_its_maker_says(
    plc: str, cell: str, place: str, bit: int | None, tmp_path: Path
) -> None:
    kind = "DINT" if "D" in cell else "BOOL" if bit is not None or "X" in cell or cell == "%M7" else "INT"
    found = row(tmp_path, "Address;Type", f"{cell};{kind}", Reading(plc=plc))
    assert isinstance(found, dict), found
    assert (found["address"], found.get("bit")) == (place, bit)
    if "MW" not in cell and cell != "%M7":
        assert "--plc" in str(row(tmp_path, "Address;Type", f"{cell};{kind}"))


def test_a_tag_table_of_tia_portal_is_the_process_image_and_nothing_of_its_memory(tmp_path: Path) -> None:
    header = "Name;Path;Data Type;Logical Address;Comment;Hmi Visible;Hmi Accessible;Hmi Writeable\n"
    rows = [
        ("Run", "Bool", "%I1.3"), ("Open", "Bool", "%Q0.7"), ("Level", "Int", "%IW64"), ("Flow", "Real", "%ID68"),
        ("Speed", "Int", "%MW100"), ("Total", "Real", "%MD50"), ("Flag", "Bool", "%M10.2"), ("Out", "Word", "%QW4"),
        ("Odd", "Int", "%IW65"), ("Block", "Real", "%DB1.DBD4"), ("Beside", "Bool", "%DB2.DBX0.1"),
    ]  # fmt: skip
    table = header + "".join(f"{name};Tags;{kind};{place};;True;True;True\n" for name, kind, place in rows)
    found = read(tmp_path, table)
    assert {tag.name: tag.keys["address"] for tag in found.tags} == {
        "Run": "discrete:11", "Open": "coil:7", "Level": "input:32", "Flow": "input:34"
    }  # fmt: skip
    assert sum("MB_HOLD_REG" in problem for problem in found.problems) == 6 and len(found.problems) == 7
    assert "middle of a register" in str(found.problems)


def test_numbers_that_may_be_hexadecimal_are_asked_for(tmp_path: Path) -> None:
    text = "Name;Address;Type\nA;0064;INT\nB;00A6;INT\n"
    assert all("--numbers" in problem or "no address" in problem for problem in read(tmp_path, text).problems)
    assert [tag.keys["address"] for tag in read(tmp_path, text, Reading(numbers="hex")).tags] == [
        "holding:100",
        "holding:166",
    ]
    plain = read(tmp_path, "Name;Function;Address;Type\nA;3;32080;INT\n")
    assert "--numbers plain" in plain.problems[0]
    assert read(tmp_path, "Name;Function;Address;Type\nA;3;32080;INT\n", Reading(numbers="plain")).tags[0].keys[
        "address"
    ] == ("holding:32080")


@pytest.mark.parametrize(
    ("header", "cell", "bit"), [("Bit", "3", 3), ("Bit (1-16)", "16", 15), ("Bit (MSB = 0)", "15", 0), ("Bit", "0", 0)]
)
def test_a_bit_is_counted_as_its_header_says(header: str, cell: str, bit: int, tmp_path: Path) -> None:
    found = row(tmp_path, f"Address;{header}", f"100;{cell}")
    assert isinstance(found, dict) and found["bit"] == bit


def test_a_place_that_the_list_writes_in_two_ways_is_two_tags_and_one_that_was_copied_is_none(tmp_path: Path) -> None:
    found = read(tmp_path, "Name;Address;Type\nA;40101-40102;REAL\nB;100~101;DINT\nC;40101-40102;DINT\n")
    assert [tag.keys["address"] for tag in found.tags] == ["holding:100", "holding:100"]
    assert "'A' of line 2" in found.tags[1].taken and "'40101-40102'" in found.tags[1].taken
    assert "line 4, 'Address'" in found.problems[0] and "'A' of line 2" in found.problems[0]
    bits = read(tmp_path, "Name;Address;Type\nA;40101.1;BOOL\nB;100.1;BOOL\nC;100;INT\n")
    assert len(bits.tags) == 1 and len(bits.problems) == 2, "a bit shown otherwise is a slip of the spreadsheet"


@pytest.mark.parametrize("header", ["Invalid value", "Value if invalid", "Ungültig", "Not implemented", "Fehlerwert"])
def test_a_number_for_no_reading_is_known_by_more_headers(header: str, tmp_path: Path) -> None:
    found = row(tmp_path, f"Address;Type;{header}", "100;INT16;0x7FFF")
    assert isinstance(found, dict) and found["sentinel"] == 0x7FFF


@pytest.mark.parametrize(
    ("header", "cells", "word"),
    [
        ("Address;Type;Size", "100;INT;32", "is 32, and 'INT' has 1"),
        ("Address;Type;Bits", "100;UINT;32", "is 32"),
        ("Address;Type;Range", "100;UINT16;-40..150", "-40 to 150 is beyond what a uint16"),
        ("Address (zero based);Type", "40001;INT16", "give --numbers decimal"),
        ("Register (0-based);Type", "40101;INT16", "--numbers plain"),
    ],
)
def test_a_cell_that_contradicts_the_type_or_the_header_refuses_its_row(
    header: str, cells: str, word: str, tmp_path: Path
) -> None:
    found = row(tmp_path, header, cells)
    assert isinstance(found, str) and word in found
    known = [("100;INT;16", "int16"), ("100;REAL;4", "float32"), ("100;REAL;2", "float32"), ("100;INT16;2", "int16")]
    for own, dtype in known if "Size" in header else ():
        taken = row(tmp_path, header, own)
        assert isinstance(taken, dict) and taken["dtype"] == dtype
    if "based" in header:
        assert row(tmp_path, header, "40;INT16") == row(tmp_path, "Address;Type", "40;INT16")
        plain = row(tmp_path, header, cells, Reading(numbers="plain"))
        assert isinstance(plain, dict) and plain["address"] == f"holding:{cells.partition(';')[0]}"


def test_two_numbers_that_lie_across_one_another_are_refused_and_one_in_another_is_not(tmp_path: Path) -> None:
    found = read(
        tmp_path, "Name;Address;Type\nA;100;REAL\nB;101;REAL\nC;102;REAL\nD;103;INT\nE;200;ULINT\nF;202;UDINT\n"
    )
    assert [tag.name for tag in found.tags] == ["A", "C", "D", "E", "F"]
    (said,) = found.problems
    assert "line 3: 'B', float32 at '101', shares registers with 'A' of line 2, float32 at '100'" in said
    assert "Enron" in said


@pytest.mark.parametrize(("words", "table"), [("Read Input Registers", "input"), ("Read Holding Registers", "holding")])
def test_a_function_by_its_name_is_its_table(words: str, table: str, tmp_path: Path) -> None:
    found = row(tmp_path, "Function;Address;Type", f"{words};100;INT")
    assert isinstance(found, dict) and found["address"] == f"{table}:100"


def test_several_sentinels_are_a_list(tmp_path: Path) -> None:
    found = row(tmp_path, "Address;Type;Sentinel", "100;INT16;0x7FFF / 0x8000")
    assert isinstance(found, dict) and found["sentinel"] == [0x7FFF, 0x8000]


# ---------------------------------------------------------------- the shared lists


_RIGHT: dict[str, dict[str, dict[str, Any]]] = {
    "list_factor_in_the_unit": {
        "TCuscinettiRiduttore": {"scale": 0.1, "unit": "degC"},
        "Assorbimento": {"scale": 0.1, "unit": "A"},
    },
    "list_gain_divides": {"Bearing": {"scale": 0.1}, "Power": {"scale": 0.001}},
    "list_hex_header": {
        "Bearing": {"address": "holding:100"},
        "Current": {"address": "holding:102"},
        "Speed": {"address": "holding:256"},
    },
    "list_iec_bits": {"Start": {"address": "coil:11"}, "Energy": {"address": "holding:2148"}},
    "list_of_an_opc_server": {
        "Bearing1": {"address": "holding:106", "dtype": "float32", "order": "CDAB"},
        "Current": {"address": "holding:101", "scale": pytest.approx(150 / 27648, rel=1e-5)},
        "Status": {"address": "holding:100", "bit": 3},
        "Total": {"address": "holding:119", "dtype": "bcd32"},
        "Serial": {"address": "holding:199", "dtype": "string", "length": 20},
    },
    "list_order_in_the_type": {"Bearing": {"dtype": "float32", "order": "DCBA"}},
    "list_ranges_and_functions": {
        "A": {"address": "holding:100", "dtype": "float32"},
        "B": {"address": "holding:100", "dtype": "int32"},
        "C": {"address": "input:118"},
    },
}  # fmt: skip


@pytest.mark.parametrize("case", _RIGHT)
def test_the_shared_lists_give_what_is_right(case: str) -> None:
    path = SHARED / case / "list.csv"
    if not path.is_file():
        pytest.skip("the shared cases are not here")
    found = read_io_list(path, Reading(plc="openplc" if case == "list_iec_bits" else ""))
    tags = {tag.name: tag.keys for tag in found.tags}
    assert {name: {key: tags[name][key] for key in right} for name, right in _RIGHT[case].items()} == _RIGHT[case]


@pytest.mark.parametrize(
    ("header", "cells", "wanted"),
    [
        ("Scalefactor;Range", "10;0 to 6553", {"scale": 0.1}), ("ScaleFactor", "0.1", {"scale": 0.1}),
        ("Scale;Range", "-10;-6553 to 0", {"scale": -0.1}), ("Scale", "-0.1", {"scale": -0.1}),
        ("Unit", '"0=Off;1=On"', {"how": "names of values: 0=Off;1=On"}),
    ],
)  # fmt: skip
def test_lists_of_makers_say_it_in_their_words(header: str, cells: str, wanted: dict[str, Any], tmp_path: Path) -> None:
    found = row(tmp_path, f"Address;Type;{header}", f"100;UINT16;{cells}")
    assert isinstance(found, dict), found
    assert {key: found.get(key) for key in wanted} == {
        key: pytest.approx(value) if isinstance(value, float) else value for key, value in wanted.items()
    }


def test_a_negative_gain_that_may_divide_is_asked_about(tmp_path: Path) -> None:
    assert "give --gain" in str(row(tmp_path, "Address;Type;Scale", "100;UINT16;-10"))


@pytest.mark.parametrize("header", ["Skalierwert", "Multiplikator", "Gainstufe"])
def test_a_column_that_may_scale_and_that_nobody_reads_refuses_the_list(header: str, tmp_path: Path) -> None:
    with pytest.raises(ListError, match="may say how readings are scaled"):
        read(tmp_path, f"Name;Address;{header}\nT;100;10\n")
    path = tmp_path / "list.csv"
    assert read_io_list(path, Reading(gain="divide"), {"scale": header}).tags[0].keys["scale"] == 0.1


def test_a_sheet_that_was_formatted_to_its_end_is_read(tmp_path: Path) -> None:
    book = Workbook()
    book.active.append(["Name", "Address"])
    book.active.append(["T", 100])
    book.active.cell(MOST_ROWS + 10, 2).number_format = "0.0"
    book.save(tmp_path / "list.xlsx")
    assert [tag.name for tag in read_io_list(tmp_path / "list.xlsx", Reading()).tags] == ["T"]


@pytest.mark.parametrize(
    ("address", "place"), [("%E0.1", "discrete:1"), ("%A1.0", "coil:8"), ("%EW64", "input:32"), ("%I0.1", "discrete:1")]
)
def test_a_tag_table_with_german_mnemonics_is_the_same(address: str, place: str, tmp_path: Path) -> None:
    found = read(tmp_path, f"Name;Path;Data Type;Logical Address;Hmi Visible\nT;Tags;;{address};True\n")
    assert [tag.keys["address"] for tag in found.tags] == [place], found.problems


@pytest.mark.parametrize(
    ("header", "cell"),
    [
        ("High Alarm", "80"), ("Soglia allarme max", "80"), ("Warning High", "75"), ("Hi Hi", "95"), ("Lo Lo", "3"),
        ("Max Age", "5"), ("Max Scan Rate", "100"), ("Register Range", "100-101"), ("Address Range", "100-101"),
        ("Zero Based Address", "100"), ("Register Offset", "2"), ("Byte Offset", "4"), ("Start Offset", "4"),
        ("Sort Order", "17"), ("Max Length", "4"),
    ],
)  # fmt: skip
def test_a_columns_word_among_others_may_be_no_such_column(header: str, cell: str, tmp_path: Path) -> None:
    # An alarm's limit as the end of a range would make of each hot reading a bad one.
    assert row(tmp_path, f"Address;Type;{header}", f"100;INT16;{cell}") == row(tmp_path, "Address;Type", "100;INT16")


@pytest.mark.parametrize("header", ["Poll Factor", "Display Decimals", "ADC Resolution", "Scale Register"])
def test_a_factor_of_something_else_is_asked_about(header: str, tmp_path: Path) -> None:
    with pytest.raises(ListError, match="may say how readings are scaled"):
        read(tmp_path, f"Name;Address;Type;{header}\nT;100;INT16;2\n")


def test_a_protocol_offset_is_the_address_itself(tmp_path: Path) -> None:
    text = "name,source_register,area,protocol_offset,datatype,word_span\nFlow,80003,holding-register,40002,float32,2\n"
    (tag,) = read(tmp_path, text).tags
    assert tag.keys["address"] == "holding:40002" and not tag.keys["offset"] and tag.keys["high"] is None


@pytest.mark.parametrize(("kind", "scale"), [("float", None), ("LREAL", None), ("INT16", 0.001)])
def test_decimals_are_those_of_a_number_without_a_point(kind: str, scale: float | None, tmp_path: Path) -> None:
    found = row(tmp_path, "Address;Type;Unit;Decimals", f"6;{kind};A;3")
    assert isinstance(found, dict), found
    assert found.get("scale") == scale and ("as they are shown" in found["how"]) == (scale is None)


@pytest.mark.parametrize(
    "header",
    [
        "SF", "Dec", "DP", "Digits", "Div", "Mult", "LSB", "Slope", "Increment", "Conversion", "Umrechnung", "Bias",
        "Intercept", "Signed", "Word Order 2",
    ],
)  # fmt: skip
def test_a_column_that_may_change_readings_and_that_nobody_reads_refuses_the_list(header: str, tmp_path: Path) -> None:
    kind = "" if header == "Signed" else "Type;"
    with pytest.raises(ListError, match=f"column '{header}' may say"):
        read(tmp_path, f"Name;Address;{kind}Byte Order;{header}\nT;100;{kind and 'REAL;'}ABCD;1\n")


def test_a_column_is_told_by_its_words_where_no_header_tells_it(tmp_path: Path) -> None:
    text = "Name;Type;Address;Data Type;Endian\nA;Input;100;REAL;Little\nB;Holding;100;REAL;Big\n"
    assert [(tag.keys["address"], tag.keys["order"]) for tag in read(tmp_path, text).tags] == [
        ("input:100", "DCBA"), ("holding:100", "ABCD"),
    ]  # fmt: skip
    (tag,) = read(tmp_path, "Name;Type;Address;Data Type\nA;Input;100;INT16\n").tags
    assert tag.keys["address"] == "holding:100", "it may be a signal's direction"


def test_a_scale_of_powers_of_ten_is_asked_about(tmp_path: Path) -> None:
    said = row(tmp_path, "Address;Type;Scale (10^x)", "100;INT16;-1")
    assert "power of ten" in said


@pytest.mark.parametrize(
    ("header", "cell"),
    [
        ("Alarms", "Low/High"), ("Level", "high low"), ("Contact", "Lo Hi"), ("Bearing", "Big"), ("Bearing", "little"),
        ("Mode", "swap"), ("Alarm text", "Little Endian"), ("Direction", "Input"), ("Signal", "Discrete"),
    ],
)  # fmt: skip
def test_a_word_that_may_mean_something_else_tells_no_order_and_no_table(
    header: str, cell: str, tmp_path: Path
) -> None:
    assert row(tmp_path, f"Address;Type;{header}", f"100;REAL;{cell}") == row(tmp_path, "Address;Type", "100;REAL")


def test_input_as_a_direction_is_no_table_beside_a_word_that_is_one(tmp_path: Path) -> None:
    found = read(tmp_path, "Name;Address;Type;Direction\nA;100;REAL;Input\nB;102;REAL;Input Register\n")
    assert [tag.keys["address"] for tag in found.tags] == ["holding:100", "holding:102"]


@pytest.mark.parametrize(
    ("header", "cells"),
    [
        ("Range Low;Range High", "-50;150"), ("Low Range;High Range", "-50;150"), ("Max Range;Min Range", "150;-50"),
        ("Span Low;Span High", "-50;150"), ("Measuring Range (Low);Measuring Range (High)", "-50;150"),
        ("LRV;URV", "-50;150"), ("Lower Range Value;Upper Range Value", "-50;150"), ("Eng Zero;Eng Full", "-50;150"),
        ("Range from;Range to", "-50;150"), ("Min/Max", "-50/150"), ("Min - Max", "-50..150"),
        ("Bereich (min...max)", "-50...150"), ("Range (Low - High)", "-50..150"),
    ],
)  # fmt: skip
def test_the_ends_of_a_range_are_known_by_more_headers(header: str, cells: str, tmp_path: Path) -> None:
    found = row(tmp_path, f"Address;Type;Raw Low;Raw High;{header}", f"100;UINT16;0;20000;{cells}")
    assert isinstance(found, dict), found
    assert (found["scale"], found["offset"], found["low"], found["high"]) == (0.01, -50.0, -50.0, 150.0)


@pytest.mark.parametrize(
    ("cell", "dtype", "order"),
    [
        ("U_WORD", "uint16", None), ("S_WORD", "int16", None), ("U_DWORD", "uint32", "ABCD"),
        ("S_DWORD_R", "int32", "CDAB"), ("U_QWORD_R", "uint64", "CDAB"), ("FP32", "float32", "ABCD"),
        ("FP32_R", "float32", "CDAB"),
    ],
)  # fmt: skip
def test_types_are_read_in_the_words_of_esphome(cell: str, dtype: str, order: str | None, tmp_path: Path) -> None:
    found = row(tmp_path, "Address;Type", f"100;{cell}")
    assert isinstance(found, dict) and (found["dtype"], found.get("order")) == (dtype, order), found


@pytest.mark.parametrize(
    ("cell", "ends"),
    [
        ("0 to 6553.3", (0.0, 6553.3)), ("-3276.8 to 3276.7", (-3276.8, 3276.7)), ("0..150,5 °C", (0.0, 150.5)),
        ("(0 - 1.234,5) kW", (0.0, 1234.5)), ("0..150.", (0.0, 150.0)), ("0-150%", (0.0, 150.0)),
        ("0 to 3.4E+7", (0.0, 3.4e7)), ("0 - 1e6", (0.0, 1e6)), ("-1,5E-3..1,5e-3 m/s", (-0.0015, 0.0015)),
        ("0..1 eV", (0.0, 1.0)), ("0..100 x", (0.0, 100.0)), ("0..150 m3/h", (0.0, 150.0)),
        ("0..10 (bar)", (0.0, 10.0)), ("0..10 (m3/h)", (0.0, 10.0)), ("-20..-5 °C", (-20.0, -5.0)),
    ],
)  # fmt: skip
def test_a_range_keeps_the_decimals_of_its_upper_end(cell: str, ends: tuple[float, float], tmp_path: Path) -> None:
    found = row(tmp_path, "Address;Type;Scale;Range", f"100;INT32;0,1;{cell}")
    assert isinstance(found, dict) and (found["low"], found["high"]) == ends, found


@pytest.mark.parametrize(
    ("header", "cells", "said"),
    [
        ("Raw Low;Raw High", "0;27648", "both ends of the range in units"),
        ("Raw Low;Raw High;Max", "0;27648;150", "both ends of the range in units"),
        ("Raw Low;Min;Max", "4000;0;150", "both ends of the range in units"),
        *(("Range", cell, "no range") for cell in ("1-2-3", "0..100 to 5", "0..5/10", "0..3.4 x 10^38", "0..10^6")),
        *(("Range", cell, "no range") for cell in ("0..10**6", "0..10 (x10^3)", "0..5 to -3", "0..100 .. -20")),
        *(("Range", cell, "no range") for cell in ("1 - 2 - -3", "0..10 [* 1000]", "0..10 e -6")),
        ("Range", "0..10⁶", "no range"), ("Range", "0 to 1e600", "no range"), ("Range", "150", "no range"),
        ("Span", "±50", "no range"), ("Raw Range;Range", "0..27648;0..150", "raw_low="),
    ],
)  # fmt: skip
def test_half_a_range_is_refused(header: str, cells: str, said: str, tmp_path: Path) -> None:
    try:
        found = row(tmp_path, f"Address;Type;{header}", f"100;UINT16;{cells}")
    except ListError as error:
        found = str(error)
    assert isinstance(found, str) and said in found


@pytest.mark.parametrize("cell", ["0x0000-0xFFFF", "0000h - FFFFh", "0=off;1=on", "in campo", "-"])
def test_a_range_of_other_things_than_decimal_numbers_refuses_nothing(cell: str, tmp_path: Path) -> None:
    assert row(tmp_path, "Address;Type;Range", f"100;UINT16;{cell}") == row(tmp_path, "Address;Type", "100;UINT16")


@pytest.mark.parametrize("header", ["Scale 10^", "Scale factor 10^", "Factor 10^", "Scale (10x)", "Scale x10^n", "SF"])
def test_a_power_of_ten_is_no_factor_and_its_refusal_says_how_it_is_read(header: str, tmp_path: Path) -> None:
    said = row(tmp_path, f"Address;Type;{header}", "100;INT16;-1") if header != "SF" else "--column decimals='SF'"
    assert isinstance(said, str) and f"--column decimals={header!r}" in said
    text = f"Name;Address;Type;{header}\nT;100;INT16;-1\n"
    (tag,) = read(tmp_path, text, columns={"decimals": header}).tags
    assert tag.keys["scale"] == 0.1
    assert "power of ten" in read(tmp_path, text, columns={"scale": header}).problems[0]


@pytest.mark.parametrize(
    ("header", "cell", "column", "scale"),
    [
        ("Decimal Point", "1", "decimals", 0.1), ("Dec", "2", "decimals", 0.01), ("Precision", "1", "decimals", 0.1),
        ("SF", "-1", "decimals", 0.1), ("SF", "0.1", "scale", 0.1), ("Pow10", "-2", "decimals", 0.01),
        ("10^n", "-1", "decimals", 0.1), ("10^-n", "1", "decimals", 0.1), ("Exp", "-1", "decimals", 0.1),
        ("Power of 10", "-1", "decimals", 0.1), ("Fact.", "0.1", "scale", 0.1), ("Weight", "0.1", "scale", 0.1),
        ("Unit per count", "0.1", "scale", 0.1), ("Counts per unit", "10", "scale", 0.1), ("Div", "10", "scale", 0.1),
    ],
)  # fmt: skip
def test_the_advice_of_a_refused_column_gives_the_right_scale(
    header: str, cell: str, column: str, scale: float, tmp_path: Path
) -> None:
    text = f"Name;Address;Type;Unit;{header}\nT;100;INT16;degC;{cell}\n"
    with pytest.raises(ListError, match=f"--column {column}='{re.escape(header)}'"):
        read(tmp_path, text)
    (tag,) = read(tmp_path, text, columns={column: header}).tags
    assert tag.keys["scale"] == scale


@pytest.mark.parametrize(
    ("header", "cells", "refused"),
    [
        ("Multiplier;Divisor", "1;10", True), ("Multiplier;Divisor", "10;10", True), ("Scale;Fact", "1;0,1", True),
        ("Scale;SF", "1;-1", True), ("Offset;Bias", "0;5", True), ("Offset;Sub", "40;40", True), ("Add", "-40", True),
        ("Sub", "40", True), ("Addend", "-40", True), ("Multiplier;Divisor", "0.1;1", False),
        ("Scale;SF", "0.1;-1", False), ("Decimals;Fact", "1;0,1", False), ("Offset;Add", "-40;-40", False),
        ("Scale;Factory", "0.1;3", False), ("Scale;Service Factor", "0.1;1.15", False), ("Bias", "", False),
        ("Bias", "0", False), ("Slope", "", False), ("Division", "Centrifuge", False), ("Power (kW)", "75", False),
        ("Converter", "PT100 transmitter", False), ("Precision class", "A", False), ("Exp. date", "2027-01-01", False),
        ("Response time", "500", False), ("Potenza", "75", False), ("Individual", "1", False),
        ("Scale;Division", "0.1;3", False),
    ],
)  # fmt: skip
def test_a_column_that_nobody_reads_refuses_the_list_by_its_numbers(
    header: str, cells: str, refused: bool, tmp_path: Path
) -> None:
    text = f"Name;Address;Type;{header}\nT;100;INT16;{cells}\n"
    if refused:
        with pytest.raises(ListError, match="may say"):
            read(tmp_path, text)
    else:
        assert len(read(tmp_path, text).tags) == 1


@pytest.mark.parametrize(
    ("header", "address", "place"),
    [
        ("Address (Modbus protocol)", "40101", "holding:100"), ("Protocol Register", "30101", "input:100"),
        ("Protocol Address", "100", "holding:100"), ("PDU Address", "40101", ""), ("PDU Address", "400101", ""),
        ("Modbus Protocol Address", "30101", ""), ("PDU Offset", "40101", "holding:40101"),
    ],
)  # fmt: skip
def test_reference_numbers_under_protocol_or_pdu_are_asked_about(
    header: str, address: str, place: str, tmp_path: Path
) -> None:
    found = read(tmp_path, f"Name;{header};Type\nT;{address};INT16\n")
    assert [tag.keys["address"] for tag in found.tags] == ([place] if place else [])
    assert all("--numbers" in problem for problem in found.problems)


@pytest.mark.parametrize(
    ("header", "cells", "ends"),
    [
        ("High Limit;High High Limit", "90;105", (None, None)), ("Hi;HiHi", "90;105", (None, None)),
        ("Low;High;Low Low;High High", "10;90;5;105", (None, None)), ("High;High-High Alarm", "90;105", (None, None)),
        ("Low Limit;High Limit;High Alarm Limit", "0;90;95", (None, None)), ("Limits", "90/105", (None, None)),
        ("Low;High;High Alarm", "0;150;90", (0, 150)), ("Min;Max;Hi;HiHi", "0;150;90;105", (0, 150)),
        ("EU Low;EU High;HH;LL", "0;150;105;5", (0, 150)),
    ],
)  # fmt: skip
def test_a_limit_beside_one_beyond_it_is_an_alarm(
    header: str, cells: str, ends: tuple[float | None, float | None], tmp_path: Path
) -> None:
    (tag,) = read(tmp_path, f"Name;Address;Type;{header}\nT;100;INT16;{cells}\n").tags
    assert (tag.keys["low"], tag.keys["high"]) == ends


@pytest.mark.parametrize("header", ["Purchase Order", "Order No", "Line Order"])
def test_an_order_of_something_else_is_none_of_words(header: str, tmp_path: Path) -> None:
    assert row(tmp_path, f"Address;Type;{header}", "100;REAL;4711") == row(tmp_path, "Address;Type", "100;REAL")
    found = row(tmp_path, "Address;Type;Order of words", "100;REAL;low first")
    assert isinstance(found, dict) and found["order"] == "CDAB"


@pytest.mark.parametrize(
    ("units", "unit", "count"),
    [
        (("200", "300"), None, 2),
        (("100", "200"), 1, 2),
        (("A1", "A2"), None, 2),
        (("1", "2"), 1, 1),
        (("1", "2"), None, 0),
    ],
)
def test_a_plants_unit_number_is_no_unit_of_modbus(
    units: tuple[str, str], unit: int | None, count: int, tmp_path: Path
) -> None:
    text = f"Name;Address;Type;Unit No\nA;100;INT16;{units[0]}\nB;101;INT16;{units[1]}\n"
    assert len(read(tmp_path, text, Reading(unit=unit)).tags) == count


# ---------------------------------------------------------------- maps of gateways and loggers


def test_numbers_of_a_device_whose_addresses_have_32_bits_do_not_lie_across_one_another(tmp_path: Path) -> None:
    text = "Name;Address;Type\nVolume;5001;DINT\nFlow;5002;REAL\nTemp;5003;REAL\n"
    assert [tag.name for tag in read(tmp_path, text, Reading(wide=True)).tags] == ["Volume", "Flow", "Temp"]
    (said,) = read(tmp_path, text).problems
    assert "give --keep wide_registers=RANGES" in said


def test_a_name_stands_in_another_column_of_names_where_its_own_is_empty(tmp_path: Path) -> None:
    found = read(
        tmp_path,
        "variable name,data type,register,documented name,unit\n"
        "Battery,USHORT,1,Vbat,0.1V\n,USHORT,2,Ibat,10mA\n,,3,,V\n",
    )
    assert [(tag.name, tag.keys["scale"], tag.keys["unit"]) for tag in found.tags] == [
        ("Battery", 0.1, "V"),
        ("Ibat", 10.0, "mA"),
    ]
    assert found.tags[1].taken.startswith("named by 'documented name'")
    (said,) = found.problems
    assert "line 4" in said and "is empty; give the tag's name" in said


def test_words_of_one_counter_tell_that_all_pairs_are_words(tmp_path: Path) -> None:
    head = "Name,Documented Name,Address,Type,Unit\n"
    power, energy = "PV,Ppv H,1,UINT16,0.1W\nRest,Ppv L,2,UINT16,0.1W\n", "E,Epv H,3,UINT16,kWh\nF,Epv L,4,UINT16,kWh\n"
    assert len(read(tmp_path, head + power).tags) == 2  # two limits may be named so
    found = read(tmp_path, head + power + energy)
    assert not found.tags and len(found.problems) == 4
    assert "line 2: 'PV' is one word of a number of 32 bits, and the other is in line 3" in found.problems[0]


@pytest.mark.parametrize(
    ("cells", "says"),
    [
        ("100;103;U16", "'U16' has 1 register, and the row says 4"),
        ("100;103;", "is empty, and the row has 4 registers"), ("200;190;U16", "is no range of one table"),
        ("100;;U16", "holding:100"), ("100;100;U16", "holding:100"), ("100;101;UDINT", "holding:100"),
        ("0x0100;0x0101;REAL", "holding:256"), ("40101;40102;UDINT", "holding:100"),
        ("186;197;ASCII", "holding:186"),
    ],
)  # fmt: skip
def test_an_end_address_says_how_many_registers_a_row_has(cells: str, says: str, tmp_path: Path) -> None:
    found = row(tmp_path, "Addr;Addr End;Type", cells)
    assert (says in found) if isinstance(found, str) else found["address"] == says
    assert "ASCII" not in cells or (isinstance(found, dict) and found["length"] == 24)


@pytest.mark.parametrize(
    ("header", "cells", "says"),
    [
        ("Length", "UINT;2byte", "uint16"), ("Length", "UINT;4 bytes", "'UINT' has 1 register, and the row says 2"),
        ("Length", "UDINT;2 words", "uint32"),
        ("Length", "UDINT;2 byte", "'UDINT' has 2 registers, and the row says 1"),
        ("Length", "STRING;32byte", "string"), ("Length", "ASCII;12 registers", "string"),
        ("Quantity", "REAL;2 regs", "float32"), ("Quantity", "INT16;2 registers", "has 1 register, and the row says 2"),
        ("Länge", "16 bit ohne Vorzeichen;1 Wort", "uint16"), ("Length", "STRING;12 bits", "no whole bytes"),
    ],
)  # fmt: skip
def test_a_size_may_say_in_what_it_counts(header: str, cells: str, says: str, tmp_path: Path) -> None:
    found = row(tmp_path, f"Address;Type;{header}", f"100;{cells}")
    assert (says in found) if isinstance(found, str) else found["dtype"] == says
    if isinstance(found, dict) and says == "string":
        assert found["length"] == (24 if "12" in cells else 32)


@pytest.mark.parametrize(
    ("cell", "dtype"),
    [
        ("intero 32 bit con segno", "int32"), ("32 bit con segno", "int32"), ("signed word", "int16"),
        ("DWORD signed", "int32"), ("word con segno", "int16"), ("int32 unsigned", "uint32"),
        ("entier 32 bits signé", "int32"), ("Entier non signé 16 bits", "uint16"),
        ("Ganzzahl 16 Bit mit Vorzeichen", "int16"), ("32 Bit ohne Vorzeichen", "uint32"),
        ("entero 16 bits sin signo", "uint16"), ("16 bit 2's complement", "int16"),
        ("16BIT_FLAGS", "uint16"), ("32 bit bitmap", "uint32"), ("Short16", "int16"),
        ("unsigned, big endian", "uint16"), ("16 bit", None), ("uint32 signed", None), ("8bit", None), ("HEX", None),
    ],
)  # fmt: skip
def test_a_type_has_the_sign_that_its_cell_says(cell: str, dtype: str | None, tmp_path: Path) -> None:
    found = row(tmp_path, "Address;Type", f"100;{cell}")
    assert (isinstance(found, str) and "is no type" in found) if dtype is None else found["dtype"] == dtype  # type: ignore[index]


@pytest.mark.parametrize(
    ("header", "cells", "right"),
    [
        ("Signed", "INT16;yes", True), ("Signed", "INT16;no", False), ("Signed", "WORD;Y", False),
        ("Signed", "UINT16;N", True), ("Signo", "INT;sin signo", False), ("Vorzeichen", "UINT16;ohne", True),
        ("Sign", "REAL;no", True), ("Unsigned", "INT16;yes", False), ("Unsigned", "UINT16;yes", True),
        ("Signed", ";yes", False), ("Signed", ";", True), ("Sign", "INT16;+/-", True), ("Sign", "INT16;?", True),
    ],
)  # fmt: skip
def test_a_column_of_signs_agrees_with_the_type_or_the_row_is_refused(
    header: str, cells: str, right: bool, tmp_path: Path
) -> None:
    found = row(tmp_path, f"Address;Type;{header}", f"100;{cells}")
    assert isinstance(found, dict) is right, found
    assert right or f"'{header}' says" in found


@pytest.mark.parametrize(
    ("header", "cells", "right"),
    [
        ("A';B';C'", "1;0;0", True), ("A';B';C'", "1;-1;0", False), ("m;b", "0,1;-40", False), ("m;b", "1;0", True),
        ("A;B", "L1;L2", True), ("B", "5", True), ("B;C", "5;6", True), ("M;Q", "1;20", False),
    ],
)  # fmt: skip
def test_letters_of_a_straight_line_are_not_passed_over(header: str, cells: str, right: bool, tmp_path: Path) -> None:
    text = f"Name;Address;Type;{header}\nT;100;INT16;{cells}\n"
    if right:
        assert len(read(tmp_path, text).tags) == 1
        return
    with pytest.raises(ListError, match="may say how readings are scaled"):
        read(tmp_path, text)


@pytest.mark.parametrize(
    ("cell", "table"),
    [("read_input_register", "input"), ("Read_Holding_Register", "holding"), ("Read Coil Status", "coil")],
)
def test_a_table_may_be_named_by_one_register(cell: str, table: str, tmp_path: Path) -> None:
    found = row(tmp_path, "Function;Address", f"{cell};7")
    assert isinstance(found, dict) and found["address"] == f"{table}:7"


def test_an_x_before_a_number_is_hexadecimal_where_that_is_said(tmp_path: Path) -> None:
    found = row(tmp_path, "Address;Type", "x1A;UINT16")
    assert isinstance(found, str) and "give --numbers hex" in found
    told = row(tmp_path, "Address;Type", "x1A;UINT16", Reading(numbers="hex"))
    assert isinstance(told, dict) and told["address"] == "holding:26"


@pytest.mark.parametrize(
    "header",
    [
        "Nome;Endereço;Tipo de dado;Escala;Unidade", "Naam;Adres;Gegevenstype;Schaal;Eenheid",
        "Nazwa;Adres;Typ danych;Mnożnik;Jednostka", "Nombre;Dirección;Tipo de dato;Escala;Unidades",
    ],
)  # fmt: skip
def test_lists_in_further_languages_are_read(header: str, tmp_path: Path) -> None:
    (tag,) = read(tmp_path, f"{header}\nT;40001;INT16;0,1;°C\n").tags
    assert (tag.keys["address"], tag.keys["scale"], tag.keys["unit"]) == ("holding:0", 0.1, "degC")


@pytest.mark.parametrize(
    ("header", "cell"),
    [("Mask", "0x00FF"), ("Bit mask", "0x8000"), ("Shift", "8"), ("Maske", "255"), ("Poids", "0,1"), ("Peso", "0,1"),
     ("Wert pro Digit", "0,1")],
)  # fmt: skip
def test_what_says_another_number_than_the_register_is_not_passed_over(header: str, cell: str, tmp_path: Path) -> None:
    with pytest.raises(ListError, match="is not understood"):
        read(tmp_path, f"Name;Address;Type;{header}\nT;100;UINT16;{cell}\n")
    plain = "0xFFFF" if header in ("Mask", "Bit mask", "Maske") else "0" if header == "Shift" else ""
    assert len(read(tmp_path, f"Name;Address;Type;{header}\nT;100;UINT16;{plain}\n").tags) == 1


@pytest.mark.parametrize(
    ("remark", "may"),
    [
        ("0xFFFF = not available", "a number that is no value"), ("invalid: 32767", "a number that is no value"),
        ("scaled by 10", "a scale"), ("Temperature [0.1 °C]", "a scale"), ("Temp (x100)", "a scale"),
        ("range 0 to 65535", ""), ("bearing 10", ""), ("see page 0x10", ""),
    ],
)  # fmt: skip
def test_a_scale_or_a_sentinel_in_a_remark_is_said(remark: str, may: str, tmp_path: Path) -> None:
    (tag,) = read(tmp_path, f"Name;Address;Type;Notes\nT;100;INT16;{remark}\n").tags
    assert (f"may say {may}" in tag.unread) if may else not tag.unread


@pytest.mark.parametrize(
    ("cell", "dtype"),
    [
        ("Signed value", "int16"), ("Unsigned value", "uint16"), ("Signed number", "int16"),
        ("Unsigned number", "uint16"), ("signed format", "int16"), ("unsigned register", "uint16"),
        ("Two's complement", "int16"), ("signed float", "float32"),
        ("signed BCD", None), ("signed char", None), ("unsigned char", None), ("signed string", None),
    ],
)  # fmt: skip
def test_a_sign_by_itself_is_of_16_bits_and_one_of_no_whole_number_is_none(
    cell: str, dtype: str | None, tmp_path: Path
) -> None:
    found = row(tmp_path, "Address;Type", f"100;{cell}")
    assert (isinstance(found, str) and "is no type" in found) if dtype is None else found["dtype"] == dtype  # type: ignore[index]


@pytest.mark.parametrize(
    ("what", "kind", "unit", "torn"),
    [
        ("Energy tariff", "UINT16", "kWh", 0), ("Energy alarm", "UINT16", "kWh", 0), ("Energy", "INT16", "kWh", 0),
        ("Level", "UINT16", "m3", 0), ("Service", "UINT16", "h", 0), ("Energy", "UINT16", "kWh", 2),
    ],
)  # fmt: skip
def test_two_limits_or_tariffs_are_no_words_of_one_number(
    what: str, kind: str, unit: str, torn: int, tmp_path: Path
) -> None:
    pair = "".join(f"{what} {end};{at};{kind};{unit}\n" for at, end in ((1, "high"), (2, "low")))
    temp = "Temp high;3;UINT16;degC\nTemp low;4;UINT16;degC\n"
    found = read(tmp_path, f"Name;Address;Type;Unit\n{pair}{temp}")
    assert (len(found.tags), len(found.problems)) == (4 - torn, torn)


@pytest.mark.parametrize(
    ("header", "rows", "refused"),
    [
        ("Bit;Mask", ("BOOL;0;0x01", "BOOL;1;0x02", "INT16;;"), ""), ("Bit;Bit mask", ("BOOL;3;8", "BOOL;4;16"), ""),
        ("Bit;Mask", ("BOOL;0;0x02",), "the row itself says bit 0: correct one"),
        ("Bit;Shift", ("BOOL;5;5",), ""), ("Alarm mask", ("INT16;1",), ""), ("Input mask", ("INT16;999.9",), ""),
        ("Subnet mask", ("INT16;255.255.255.0",), ""), ("Mask", ("INT16;255.255.255.0",), ""),
        ("Shift", ("INT16;A", "INT16;2"), ""), ("Shift", ("INT16;none", "INT16;8"), "give the bit"),
        ("Shift", ("INT16;1", "INT16;2"), ""),
        ("Right shift", ("INT16;2",), "give the bit"), ("Mask (hex)", ("INT16;0x0F",), "give the bit"),
        ("Mask", ("INT16;255.0",), "give the bit"),
    ],
)  # fmt: skip
def test_a_mask_that_says_the_rows_own_bit_or_is_none_is_passed_over(
    header: str, rows: tuple[str, ...], refused: str, tmp_path: Path
) -> None:
    lines = "".join(f"T{at};{100 + at};{cells}\n" for at, cells in enumerate(rows))
    text = f"Name;Address;Type;{header}\n{lines}"
    if not refused:
        assert len(read(tmp_path, text).tags) == len(rows)
        return
    with pytest.raises(ListError, match=refused):
        read(tmp_path, text)


def test_a_mask_may_say_the_bit_of_the_address(tmp_path: Path) -> None:
    text = "Name;Address;Mask\nRun;40001.{};0x08\n"
    assert len(read(tmp_path, text.format(3)).tags) == 1
    with pytest.raises(ListError, match="the row itself says bit 4"):
        read(tmp_path, text.format(4))


@pytest.mark.parametrize(
    ("header", "rows", "refused"),
    [
        ("K;B", ("0,1;-40",), "give --column offset='B'"), ("k;c", ("0,1;-40", "0,1;"), "give --column offset='c'"),
        ("a1;a0", ("0,1;-40",), "may say how readings are scaled"), ("A;B;C", ("0,5;0;0",), "may say how readings"),
        ("m;b", ("0,1;0", "0,2;0"), "may say how readings are scaled"),
        ("A;B;C", ("1;0;0", "0;1;0"), ""), ("A;B;C", ("2;0;0",), ""), ("K;B", ("0,1;1", "0,1;0"), ""),
        ("K;B", ("0,1;5", "0,1;east"), ""), ("K;Offset;B", ("0,1;-40;7",), ""), ("Scale;Q", ("0,1;7",), ""),
    ],
)  # fmt: skip
def test_a_constant_beside_a_scale_headed_k_is_not_passed_over_and_phases_are(
    header: str, rows: tuple[str, ...], refused: str, tmp_path: Path
) -> None:
    lines = "".join(f"T{at};{100 + at};INT16;{cells}\n" for at, cells in enumerate(rows))
    text = f"Name;Address;Type;{header}\n{lines}"
    if not refused:
        assert len(read(tmp_path, text).tags) == len(rows)
        return
    with pytest.raises(ListError, match=refused):
        read(tmp_path, text)


@pytest.mark.parametrize(
    ("cells", "says"),
    [
        ("40003;40003;FLOAT32", "has 2 registers, and the row says 1"), ("40003;40003;INT16", "int16"),
        ("40003;0;FLOAT32", "float32"), ("40003;gateway;FLOAT32", "float32"), ("0;0;UINT16", "uint16"),
        ("40003;0x0000;INT16", "int16"), ("10001;10001;BOOL", "bool"),
    ],
)  # fmt: skip
def test_an_end_at_the_first_address_is_one_register_and_0_or_a_word_is_none(
    cells: str, says: str, tmp_path: Path
) -> None:
    found = row(tmp_path, "Address;End address;Type", cells)
    assert (says in found) if isinstance(found, str) else found["dtype"] == says


def test_an_end_of_letters_is_a_number_in_a_hexadecimal_list(tmp_path: Path) -> None:
    found = row(tmp_path, "Address (hex);End address (hex);Type", "FE;FF;REAL")
    assert isinstance(found, dict) and found["address"] == "holding:254"
    said = row(tmp_path, "Address (hex);End address (hex);Type", "FE;FF;INT16")
    assert isinstance(said, str) and "the row says 2" in said


def test_an_end_at_the_first_address_may_be_a_register_of_32_bits(tmp_path: Path) -> None:
    found = row(tmp_path, "Address;End address;Type", "5001;5001;REAL", Reading(wide=True))
    assert isinstance(found, dict) and found["dtype"] == "float32"


@pytest.mark.parametrize("header", ["Device name", "Group name", "Machine name", "Section name"])
def test_a_row_takes_no_name_of_its_group(header: str, tmp_path: Path) -> None:
    found = read(tmp_path, f"Name;Address;Type;{header}\nT1;1;INT16;Pump\n;2;INT16;Pump\nT3;3;INT16;Fan\n")
    assert [tag.name for tag in found.tags] == ["T1", "T3"]
    assert "is empty; give the tag's name" in found.problems[0]
    single = read(tmp_path, f"Name;Address;Type;{header}\n;2;INT16;Pump\n")
    assert bool(single.tags) is (header == "Section name")
