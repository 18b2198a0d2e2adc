"""I/O lists: columns by their headers, in five languages; numbers with a comma; a sentence for each bad row."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from openpyxl import Workbook

from gateway.commission.files.cells import ListError, parse_decimal
from gateway.commission.files.io_list import IoList, Reading, read_io_list
from gateway.commission.files.io_places import MAKERS
from gateway.commission.files.io_words import type_cell
from gateway.commission.import_list import bindings
from gateway.commission.options.files import PLC_MAKERS

ITALIAN = """\
Elenco I/O - linea 2;;;;;;;
;;;;;;;
Nome tag;Descrizione;Indirizzo;Tipo dato;Fattore;Unità di misura;Min;Max
Marcia;marcia;40101.0;BOOL;;;;
Allarme;;40101.11;BOOL;;;;
Corrente;assorbimento;40102;WORD;0,1;A;0;350
Temperatura;cuscinetti;40106;REAL;;°C;-20;150
Livello;;4x0110;INT;0,01;%;;
"""


def listed(folder: Path, text: str, how: Reading | None = None, encoding: str = "utf-8") -> IoList:
    path = folder / "list.csv"
    path.write_bytes(text.encode(encoding))
    return read_io_list(path, how or Reading())


def keys(found: IoList, name: str) -> dict[str, object]:
    row = next(tag for tag in found.tags if tag.name == name)
    return {key: value for key, value in row.keys.items() if value is not None}


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16"])
def test_an_italian_list_gives_its_tags_whatever_its_encoding(tmp_path: Path, encoding: str) -> None:
    found = listed(tmp_path, ITALIAN, encoding=encoding)
    assert not found.problems
    assert keys(found, "Marcia") == {"address": "holding:100", "dtype": "bool", "bit": 0}
    assert keys(found, "Allarme")["bit"] == 11
    assert keys(found, "Corrente") == {
        "address": "holding:101", "dtype": "uint16", "scale": 0.1, "unit": "A", "low": 0.0, "high": 350.0
    }  # fmt: skip
    assert keys(found, "Temperatura")["unit"] == "degC"
    assert keys(found, "Livello")["address"] == "holding:109"
    assert found.sheet.columns["remark"] == "Descrizione" and not found.sheet.ignored


def test_an_english_list_with_commas_and_functions_is_read_too(tmp_path: Path) -> None:
    text = (
        "Tag Name,Function code,Modbus Address,Data Type,Scale Factor,Engineering Unit\n"
        'Speed,3,"100",UINT32,"0.5",rpm\nPressure,4,20,INT16,0.01,bar\nRun,2,7,BOOL,,\n'
    )
    found = listed(tmp_path, text, Reading(order="CDAB"))
    assert keys(found, "Speed") == {
        "address": "holding:100", "dtype": "uint32", "order": "CDAB", "scale": 0.5, "unit": "rpm"
    }  # fmt: skip
    assert keys(found, "Pressure")["address"] == "input:20"
    assert keys(found, "Run") == {"address": "discrete:7", "dtype": "bool"}


@pytest.mark.parametrize(
    ("header", "length"), [("Length", 128), ("Bits", 16), ("Bit length", 16), ("Size", None), ("Größe", None)]
)
def test_a_texts_length_has_the_unit_that_its_column_says(tmp_path: Path, header: str, length: int | None) -> None:
    found = listed(tmp_path, f"Tag;Address;Type;{header}\nName;40101;STRING;128\n")
    assert [tag.keys["length"] for tag in found.tags] == ([] if length is None else [length])
    assert ["bytes, characters or bits?" in problem for problem in found.problems] == [True] * (length is None)


def test_a_workbook_gives_the_same_as_its_csv(tmp_path: Path) -> None:
    book = Workbook()
    page = book.active
    assert page is not None
    for line in ITALIAN.splitlines():
        numeric = [_is_number(cell) and place > 2 for place, cell in enumerate(line.split(";"))]
        cells = zip(line.split(";"), numeric, strict=True)
        page.append([float(cell.replace(",", ".")) if number else cell or None for cell, number in cells])
    page["C6"], page["C7"] = 40102, 40106
    book.save(tmp_path / "list.xlsx")
    from_book = read_io_list(tmp_path / "list.xlsx", Reading())
    from_text = listed(tmp_path, ITALIAN)
    assert not from_book.problems
    assert [(tag.name, tag.keys, tag.line) for tag in from_book.tags] == [
        (tag.name, tag.keys, tag.line) for tag in from_text.tags
    ]


def _is_number(cell: str) -> bool:
    try:
        parse_decimal(cell)
    except ValueError:
        return False
    return True


def test_each_bad_row_is_one_sentence_with_its_line_column_and_remedy(tmp_path: Path) -> None:
    rows = (
        (";40101;INT;1", "line 2, 'Tag'", "is empty"),
        ("A;;INT;1", "line 3, 'Address'", "is empty"),
        ("B;house;INT;1", "line 4, 'Address'", "'house' is no address"),
        ("C;40103;quaternion;1", "line 5, 'Type'", "BOOL, INT"),
        ("D;40104;INT;0,,1", "line 6, 'Scale'", "no number"),
        ("E;40105;INT;0", "line 7, 'Scale'", "is 0"),
        ("F;40106.16;BOOL;", "line 8", "bit 16"),
        ("G;40107;STRING;", "line 9, 'Type'", "length"),
        ("H;70000;INT;1", "line 10, 'Address'", "outside the addresses"),
        ("Good;40120;INT;1", "", ""),
        ("Good;40121;INT;1", "line 12, 'Tag'", "line 11 already"),
        ("Other;40120;INT;1", "line 13, 'Address'", "'Good' of line 11"),
    )
    found = listed(tmp_path, "Tag;Address;Type;Scale\n" + "\n".join(row for row, _, _ in rows) + "\n")
    wanted = [(where, word) for _, where, word in rows if where]
    assert len(found.problems) == len(wanted)
    for problem, (where, word) in zip(found.problems, wanted, strict=True):
        assert where in problem and word in problem and "\n" not in problem
    assert [tag.name for tag in found.tags] == ["Good"]


def test_a_flag_without_its_bit_in_a_register_of_flags_is_refused(tmp_path: Path) -> None:
    found = listed(tmp_path, "Tag;Address;Type\nA;40101.4;BOOL\nB;40101;BOOL\nC;40101.5;BOOL\n")
    assert "line 3, 'Address'" in found.problems[0] and "bit 0" in found.problems[0]
    assert [tag.name for tag in found.tags] == ["A", "C"]


def test_a_bare_4_is_a_function_only_in_a_column_of_functions(tmp_path: Path) -> None:
    found = listed(tmp_path, "Tag;Area;Address\nA;4;100\n")
    assert "line 2, 'Area'" in found.problems[0] and "holding, input" in found.problems[0]


@pytest.mark.parametrize(
    ("header", "flag", "real"),
    [
        ("Bezeichnung;Register;Funktion;Datentyp;Wortfolge;Einheit;Skalierung", "Eingang (FC2)", "FC4"),
        (
            "Variable;Registeradresse;Registertyp;Typ;Wortreihenfolge;Einheit;Faktor",
            "Digitaleingang",
            "Eingangsregister",
        ),
        ("Nom;Adresse;Fonction;Type de donnée;Ordre des mots;Unité;Facteur", "Lire (FC2)", "Registre d'entrée"),
        (
            "Nombre;Dirección;Función;Tipo de dato;Orden de palabras;Unidad;Escala",
            "Entrada (FC2)",
            "Registro de entrada",
        ),
    ],
)
def test_a_list_in_german_french_or_spanish_is_read_as_an_italian_one(
    tmp_path: Path, header: str, flag: str, real: str
) -> None:
    found = listed(tmp_path, f"{header}\nM;3;{flag};BOOL;;;\nT;10;{real};REAL;CDAB;°C;0,1\n")
    assert not found.problems and not found.sheet.ignored
    assert keys(found, "M")["address"] == "discrete:3"
    temperature = keys(found, "T")
    assert [temperature[key] for key in ("address", "dtype", "order", "unit", "scale")] == [
        *("input:10", "float32", "CDAB", "degC", 0.1),
    ]


@pytest.mark.parametrize("remark", ["Faktor 0,1", "fattore: 0.1", "in °C, x 0.1", "/10", "scale=10", "Auflösung 0,1 K"])
def test_a_scale_in_running_text_is_said_to_be_unread(tmp_path: Path, remark: str) -> None:
    found = listed(tmp_path, f"Tag;Address;Type;Scale;Note\nT;40001;INT;;{remark}\nU;40002;INT;0,1;{remark}\n")
    assert repr(remark) in found.tags[0].unread and "line 2, 'Note'" in found.tags[0].unread
    assert not found.tags[1].unread and not found.problems


@pytest.mark.parametrize("remark", ["", "Lager 2 links", "Temperatur in 10 m Tiefe", "Motor 1/2", "Pumpe x", "M10"])
def test_a_remark_without_a_scale_is_a_remark(tmp_path: Path, remark: str) -> None:
    assert not listed(tmp_path, f"Tag;Address;Type;Note\nT;40001;INT;{remark}\n").tags[0].unread


def test_what_columns_hold_is_proposed_where_no_word_says_it(tmp_path: Path) -> None:
    with pytest.raises(ListError) as error:
        listed(tmp_path, "Plan 3;;\nKennung;Ort;Art\nTT101;100;REAL\nTT102;102;REAL\n")
    assert "line 2 has 'Kennung', 'Ort', 'Art'" in str(error.value)
    assert str(error.value).endswith("perhaps --column name='Kennung' --column address='Ort'")
    with pytest.raises(ListError) as error:
        listed(tmp_path, "Tag;Ort\nTT101;100\nTT102;102\n")
    assert "for address" in str(error.value) and "for name" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ("is empty",)),
        ("a;b\n1;2\n", ("no header was recognised", "'a', 'b'", "--column")),
        ("Tag;Address\n", ("no row under it",)),
    ],
)
def test_a_file_that_is_no_list_is_one_sentence(tmp_path: Path, text: str, words: tuple[str, ...]) -> None:
    with pytest.raises(ListError) as error:
        listed(tmp_path, text)
    assert all(word in str(error.value) for word in words)


def test_columns_can_be_named_and_tags_renamed(tmp_path: Path) -> None:
    path = tmp_path / "list.csv"
    path.write_text("Kennung;Ort\nTT101;100\n", encoding="utf-8")
    how = Reading(shift=-1, rename={"TT101": "TCuscinettiRiduttore"})
    found = read_io_list(path, how, {"name": "Kennung", "address": "Ort"})
    assert keys(found, "TCuscinettiRiduttore")["address"] == "holding:99"
    with pytest.raises(ListError, match="no column is called 'Name'"):
        read_io_list(path, how, {"name": "Name", "address": "Ort"})


def test_scale_and_offset_come_from_a_raw_range(tmp_path: Path) -> None:
    text = "Tag;Address;Raw min;Raw max;Min;Max\nP;40001;0;27648;-1;9\n"
    row = keys(listed(tmp_path, text), "P")
    assert row["scale"] == pytest.approx(10 / 27648, rel=1e-6) and row["offset"] == -1.0


@settings(max_examples=200, deadline=None)
@given(st.floats(-1e9, 1e9, allow_nan=False), st.sampled_from([",", "."]), st.sampled_from(["", "'", "other"]))
def test_a_number_is_read_as_it_was_written(value: float, decimal: str, grouping: str) -> None:
    text = f"{value:,.3f}"
    group = {"other": "." if decimal == "," else ","}.get(grouping, grouping)
    written = text.replace(",", "G").replace(".", decimal).replace("G", group)
    assert parse_decimal(written) == pytest.approx(round(value, 3), abs=5e-4)


@pytest.mark.parametrize("text", ["", "abc", "0,,1", "1.2.3", "1,23,4", "--1", "1e", "nan", "inf"])
def test_what_is_no_number_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="no number"):
        parse_decimal(text)


@pytest.mark.parametrize(
    ("words", "dtype"),
    [("real", "float32"), ("32 bit float", "float32"), ("16 bit unsigned integer", "uint16"), ("dint", "int32"),
     ("intero senza segno", "uint16"), ("word", "uint16"), ("64 bit int", "int64"), ("string 16", "string")],
)  # fmt: skip
def test_types_are_known_by_their_usual_names(words: str, dtype: str) -> None:
    found = type_cell(words)
    assert not found.unknown and found.dtype == dtype


def test_a_scale_of_the_list_takes_the_place_of_a_factor_in_a_register(tmp_path: Path) -> None:
    (own, without) = bindings(listed(tmp_path, "Tag;Address;Type;Scale\nV;40001;INT;0,1\nW;40002;INT;\n"))
    assert own.keys["scale"] == 0.1 and own.keys["scale_from"] is None
    assert "scale_from" not in without.keys, "what the list says nothing of stays"


@pytest.mark.parametrize("header", ["Bauteil", "Teilenummer", "Verteiler"])
def test_a_part_is_no_divisor(tmp_path: Path, header: str) -> None:
    assert not listed(tmp_path, f"Tag;Address;Type;{header}\nV;40001;INT;7\n").problems


def test_the_two_words_of_a_number_are_no_two_numbers(tmp_path: Path) -> None:
    head = "Name;Description;Address;Type;Scale;Unit\n"
    rows = (
        "Energy high word;;40001;UINT16;0,1;kWh\nEnergy low word;;40002;UINT16;0,1;kWh\n"
        "A;meter, LSW;40011;;;kWh\nB;meter, MSW;40012;;;kWh\nC;raw high word;40021;;;\nD;raw low word;40022;;;\n"
        "T high;;40031;INT16;0,1;°C\nT low;;40032;INT16;0,1;°C\nHigh;;40041;UINT16;;A\nLow wind;;40042;UINT16;;A\n"
    )
    found = listed(tmp_path, head + rows)
    assert [tag.name for tag in found.tags] == ["C", "D", "T high", "T low", "High", "Low wind"]
    assert len(found.problems) == 4
    assert (
        "line 2: 'Energy high word' is one word of a number of 32 bits, and the other is in line 3" in found.problems[0]
    )
    assert "order ABCD" in found.problems[0] and "order CDAB" in found.problems[2]
    # Raw words are what they say, and two limits may be named as two words are.
    (note,) = found.sheet.notes
    assert note.startswith("1 pair of rows may be the two words of one number of 32 bits, as 'T high' and 'T low'")


def test_a_bit_has_no_factor_and_no_unit_of_a_number(tmp_path: Path) -> None:
    head = "Name;Address;Type;Scale;Unit\n"
    for row in ("A;40001.2;UINT16;;0,01 Ah", "A;40001.2;UINT16;;mV", "A;40001.2;BOOL;0,1;", "A;40001.2;;10;V"):
        found = listed(tmp_path, head + row)
        assert not found.tags and "is bit 2 of a register, and has the " in found.problems[0], row
    for row in (
        "A;40001.2;UINT16;;",
        "A;40001.2;BOOL;1;bool",
        "A;40001.2;UINT16;;0=off,1=on",
        "A;40001.2;UINT16;1;0/1",
    ):
        assert keys(listed(tmp_path, head + row), "A")["bit"] == 2, row


def test_int_beside_types_of_c_is_asked_about(tmp_path: Path) -> None:
    head = "Name;Address;Type;Registers\n"
    plain = listed(tmp_path, head + "A;40001;INT;\nB;40002;UINT;\n")
    assert [tag.keys["dtype"] for tag in plain.tags] == ["int16", "uint16"]
    found = listed(tmp_path, head + "A;40001;INT;\nB;40002;USHORT;\nC;40003;UINT;2\nD;40005;INT;1\nE;40006;UINT16;\n")
    assert {tag.name: tag.keys["dtype"] for tag in found.tags} == {
        "B": "uint16", "C": "uint32", "D": "int16", "E": "uint16"
    }  # fmt: skip
    assert len(found.problems) == 1 and "'INT' has 16 bits in a PLC, and 32 where SHORT has 16" in found.problems[0]


def test_each_maker_that_may_be_named_has_its_addresses() -> None:
    assert tuple(MAKERS) == PLC_MAKERS
