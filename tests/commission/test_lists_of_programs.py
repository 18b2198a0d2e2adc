"""Lists that are no tables: Home Assistant's modbus:, evcc's templates, SunSpec's models; each row whole or refused."""

import json
import socket
import struct
import tomllib
from pathlib import Path
from typing import Any

import pytest

from drivers import codec
from drivers.device_file import TagTable
from drivers.tag import Quality
from gateway.commission.files.io_list import IoList, ListError, Reading, read_io_list
from tests.commission.bench import Handler, answer, plc, server
from tests.commission.test_probed_devices import take

_PLAIN = Reading()


def read(folder: Path, name: str, text: str, how: Reading = _PLAIN, page: str | None = None) -> IoList:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return read_io_list(path, how, None, page)


def keys(found: IoList) -> dict[str, dict[str, Any]]:
    return {tag.name: {key: value for key, value in tag.keys.items() if value is not None} for tag in found.tags}


# ---------------------------------------------------------------- Home Assistant


def sensor(folder: Path, text: str) -> dict[str, Any] | str:
    """The keys of a sensor, or why it was refused."""
    lines = "".join(f"        {line}\n" for line in text.split("; "))
    found = read(folder, "m.yaml", f"modbus:\n  - name: hub\n    type: tcp\n    sensors:\n      - name: T\n{lines}")
    return found.problems[0] if found.problems else keys(found)["T"]


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("address: 100", {"address": "holding:100", "dtype": "int16"}),
        ("address: 0x10; input_type: input; data_type: uint16; scale: 10",
         {"address": "input:16", "dtype": "uint16", "scale": 10.0}),
        ("address: 1; data_type: int32; swap: word; scale: 0.1; offset: -5; unit_of_measurement: V",
         {"address": "holding:1", "dtype": "int32", "order": "CDAB", "scale": 0.1, "offset": -5.0, "unit": "V"}),
        ("address: 1; data_type: float32; swap: word_byte", {"dtype": "float32", "order": "DCBA"}),
        ("address: 1; data_type: uint16; swap: byte", {"dtype": "uint16", "order": "BADC"}),
        ("address: 1; data_type: float; count: 4", {"dtype": "float64", "order": "ABCD"}),
        ("address: 1; data_type: string; count: 5", {"dtype": "string", "length": 10}),
        ("address: 1; data_type: custom; count: 2; structure: '>f'", {"dtype": "float32", "order": "ABCD"}),
        ("address: 1; data_type: custom; count: 2; structure: '<i'", {"dtype": "int32", "order": "DCBA"}),
        ("address: 1; data_type: custom; count: 2; structure: 'f'", {"dtype": "float32", "order": "DCBA"}),
        ("address: 1; data_type: custom; count: 1; structure: '=h'", {"dtype": "int16", "order": "BADC"}),
        ("address: 1; nan_value: 0x8000; min_value: -20; max_value: 150",
         {"sentinel": 0x8000, "low": -20, "high": 150}),
        ("address: 1; scan_interval: 60", {"period": 60.0}), ("address: 1; scan_interval: 0", {"dtype": "int16"}),
        ("address: 1; unit_of_measurement: '0.1 kWh'", {"unit": "0.1 kWh"}), ("address: 1; byte_order: big", {}),
    ],
)  # fmt: skip
def test_a_sensor_of_home_assistant_is_read(text: str, wanted: dict[str, Any], tmp_path: Path) -> None:
    found = sensor(tmp_path, text)
    assert isinstance(found, dict), found
    assert {key: found.get(key) for key in wanted} == wanted
    assert "scale" in wanted or "scale" not in found


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("address: 1; bitmask: 15", "bitmask may change"), ("address: 1; bit_range: [4, 7]", "bit_range may change"),
        ("address: 1; shift_bits: 8", "shift_bits may change"), ("address: 1; byte_order: little", "byte_order may"),
        ("address: 1; scale_factor: 9", "scale_factor may change"),
        ("data_type: int16", "address '' is no number"), ("address: !secret a", "address 'a' is no number"),
        ("address: 1; data_type: float16", "data_type 'float16'"), ("address: 1; swap: nibble", "swap 'nibble'"),
        ("address: 1; data_type: custom; structure: '>2h'", "structure '>2h'"),
        ("address: 1; data_type: int16; count: 2", "count 2"), ("address: 1; input_type: file", "input_type 'file'"),
        ("address: 1; data_type: string", "needs its length"), ("address: 1; virtual_count: x", "virtual_count"),
    ],
)  # fmt: skip
def test_a_sensor_of_home_assistant_that_is_not_understood_is_refused(text: str, said: str, tmp_path: Path) -> None:
    found = sensor(tmp_path, text)
    assert isinstance(found, str) and said in found and "line 5" in found


def test_a_key_that_nothing_is_made_of_is_said_once_with_its_count(tmp_path: Path) -> None:
    first = "{name: A, address: 1, virtual_count: 1, lazy_error_count: 3, precision: 1}"
    rows = first + ", {name: B, address: 9, reverse_order: yes}"
    text = f"modbus:\n  - name: hub\n    sensors: [{rows}, {{name: C, address: 20, lazy_error_count: 3}}]\n"
    text += "    binary_sensors: [{name: D, address: 1, device_class: door, verify: x}]\n"
    found = read(tmp_path, "m.yml", text)
    notes = [
        "lazy_error_count is not taken (2 rows)",
        "reverse_order is not taken (1 row)",
        "verify is not taken (1 row)",
    ]
    assert list(found.sheet.notes) == notes and len(found.tags) == 5
    taken = answer(tmp_path, "import", tmp_path / "m.yml", "--device", tmp_path / "d.toml", "--dry-run")
    assert taken["not_taken"] == notes and taken["open_points"] == [f"import: {note}" for note in notes]


HOUSE = """
template: []
modbus:
  - name: roof
    type: tcp
    host: !secret roof
    sensors:
      - {name: A, slave: 1, address: 10, data_type: uint32, virtual_count: 2}
      - {name: B, device_address: 2, address: 7, <<: &often {scan_interval: 5}}
    binary_sensors:
      - {name: C, slave: 1, address: 3}
      - {name: D, slave: 1, address: 4, input_type: discrete_input, <<: *often}
      - {name: E, slave: 1, address: 5, input_type: holding}
    switches:
      - {name: F, slave: 1, address: 9}
  - name: cellar
    type: rtuovertcp
    sensors: [{name: G, address: 1}]
"""


def test_entities_of_several_units_and_connections_are_kept_apart(tmp_path: Path) -> None:
    with pytest.raises(ListError, match="2 connections; say which with --sheet, one of roof, cellar"):
        read(tmp_path, "m.yml", HOUSE)
    assert list(keys(read(tmp_path, "m.yml", HOUSE, page="cellar"))) == ["G"]
    every = read(tmp_path, "m.yml", HOUSE, page="roof")
    assert not every.tags and sum("give --unit" in problem for problem in every.problems) == 7
    first = read(tmp_path, "m.yml", HOUSE, Reading(unit=1), "roof")
    assert {name: row["address"] for name, row in keys(first).items()} == {
        "A": "holding:10", "A 1": "holding:12", "A 2": "holding:14",
        "C": "coil:3", "D": "discrete:4", "E": "holding:5",
    }  # fmt: skip
    assert keys(first)["E"]["bit"] == 0 and keys(first)["D"]["period"] == 5
    assert len(first.problems) == 1 and "switches, which Home Assistant writes" in first.problems[0]
    assert first.sheet.notes == ("1 row of unit 2 was left out (--unit 1)",)
    second = read(tmp_path, "m.yml", HOUSE, Reading(unit=2), "roof")
    assert second.sheet.notes == ("6 rows of unit 1 were left out (--unit 2)",)
    with pytest.raises(ListError, match="no row of unit 3; it has 1, 2"):
        read(tmp_path, "m.yml", HOUSE, Reading(unit=3), "roof")
    assert keys(second)["B"]["period"] == 5 and second.tags[0].taken == "unit 2"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a: [1", "is no YAML: line"), ("a: 1", "is no list that is known here"), ("", "is no list"),
        ("modbus: []", "has no registers"), ("a: *b", "undefined alias"), ("[" * 5000, "is no YAML"),
        ("\ufffe", "is no"), ("modbus: &a\n  <<: *a\n  sensors: []", "line 2: takes itself over by <<"),
        ("modbus: &a\n  <<: [&b {<<: *a}]", "takes itself over by <<"),
    ],
)  # fmt: skip
def test_a_yaml_file_that_is_no_list_is_one_sentence(text: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(ListError, match=said) as caught:
        read(tmp_path, "m.yaml", text)
    assert "\n" not in str(caught.value)


# ---------------------------------------------------------------- evcc

METER = """template: m
params:
  - name: usage
    choice: ["grid", "pv"]
render: |
  type: custom
  {{- if eq .usage "grid" }}
  power:
    source: modbus
    {{- include "modbus" . | indent 2 }}
    register:
      address: 0x5B14 # total
      type: holding
      decode: int32
    scale: 0.01
  currents:
    - source: modbus
      register: {address: 1, type: input, decode: uint32s}
    - source: modbus
      register: {address: 3, type: input, decode: float32s}
      scale: -1
  {{- end }}
  {{- if eq .usage "pv" }}
  power:
    source: calc
    add:
      - source: modbus
        register: {address: 7, type: holding, decode: uint16nan}
        {{- if .old }}
        scale: 10
        {{- end }}
      - source: modbus
        register: {address: 8, type: holding, decode: int16nan}
        scale: 10
      - source: const
        value: 1
  {{- if .new }}
  energy:
    source: modbus
    register: {address: 9, type: holding, decode: uint64}
  {{- else }}
  energy:
    source: modbus
    register: {address: {{ .at }}, type: holding, decode: uint64}
  {{- end }}
  {{- end }}
  soc:
    source: sunspec
    value: 124:ChaState
  batterymode:
    source: watchdog
    set:
      source: modbus
      register: {address: 5, type: writesingle, encoding: uint16}
  flag:
    source: modbus
    register: {address: 5, type: coil}
"""


def test_a_meter_template_of_evcc_is_read_row_by_row(tmp_path: Path) -> None:
    found = read(tmp_path, "m.yaml", METER)
    assert keys(found) == {
        "grid_power": {"address": "holding:23316", "dtype": "int32", "order": "ABCD", "scale": 0.01},
        "grid_currents1": {"address": "input:1", "dtype": "uint32", "order": "CDAB"},
        "grid_currents2": {"address": "input:3", "dtype": "float32", "order": "CDAB", "scale": -1.0},
        "pv_power_part2": {"address": "holding:8", "dtype": "int16", "scale": 10.0, "sentinel": [0x8000, 0x7FFF]},
        "pv_energy": {"address": "holding:9", "dtype": "uint64", "order": "ABCD"},
        "flag": {"address": "coil:5", "dtype": "bool"},
    }
    taken = {tag.name: tag.taken for tag in found.tags}
    assert taken["pv_power_part2"] == "a part of what evcc computes" and taken["pv_energy"] == "where .new"
    assert {tag.name: tag.line for tag in found.tags}["grid_power"] == 9
    reasons = "\n".join(found.problems)
    for said in ("pv_power_part1: hangs on a setting of the template, '.old'", "its address hangs on a setting",
                 "soc: names '124:ChaState'", "is written (writesingle)"):  # fmt: skip
        assert said in reasons
    assert len(found.problems) == 4


def test_what_evcc_computes_by_a_script_is_no_tag(tmp_path: Path) -> None:
    source = "source: modbus, register: {address: 100, type: holding, decode: int16}"
    script = "    source: js\n    script: -val/10\n    in:\n      - name: val\n        config: {%s}\n"
    found = read(tmp_path, "m.yaml", "render: |\n  power:\n" + script % source)
    assert not found.tags and "is a part of what evcc computes (source: js)" in found.problems[0]


@pytest.mark.parametrize(
    ("decode", "registers"),
    [
        ("int16nan", [0x8000]), ("int16nan", [0x7FFF]), ("int32nan", [0x8000, 0]), ("int32nan", [0x7FFF, 0xFFFF]),
        ("uint64nan", [0xFFFF] * 4), ("int64nan", [0x8000, 0, 0, 0]),
    ],
)  # fmt: skip
def test_what_evcc_takes_for_no_value_is_none(decode: str, registers: list[int], tmp_path: Path) -> None:
    source = f"{{source: modbus, register: {{address: 1, type: holding, decode: {decode}}}}}"
    row = keys(read(tmp_path, "m.yaml", f"render: |\n  soc: {source}\n"))["soc"]
    assert codec.decode(TagTable.model_validate({"name": "soc", **row}).tag(), registers)[1] is Quality.NO_DATA


@pytest.mark.parametrize(
    "header",
    [
        "Anzahl Nachkommastellen",
        "Anzahl Dezimalstellen",
        "Kommastellen",
        "Cantidad de decimales",
        "Nombre de decimales",
    ],
)
def test_a_column_of_decimals_scales(header: str, tmp_path: Path) -> None:
    found = read(tmp_path, "m.csv", f"Bezeichnung;Adresse;Datentyp;{header}\nT;100;INT16;1\n")
    assert keys(found)["T"]["scale"] == 0.1


@pytest.mark.parametrize("header", ["Coefficient", "Coeficiente", "Multiplikator", "Wertigkeit"])
def test_a_column_that_may_scale_and_is_not_understood_refuses_the_list(header: str, tmp_path: Path) -> None:
    with pytest.raises(ListError, match="may say how readings are scaled"):
        read(tmp_path, "m.csv", f"Nom;Adresse;Type;{header}\nT;100;INT16;0,1\n")


def test_a_slaves_address_is_no_registers(tmp_path: Path) -> None:
    text = "Nom;Adresse esclave;Adresse registre;Type\nA;1;100;INT16\nB;2;101;INT16\n"
    assert keys(read(tmp_path, "m.csv", text, Reading(unit=1)))["A"]["address"] == "holding:100"


# ---------------------------------------------------------------- modpoll and ioBroker

POLLS = """device,meter,7,,,
poll,input_register,0,4,BE_LE,60
ref,voltage,0,float32,r,V
ref,energy,0x2,uint32,rw,kWh,0.01
# a remark
poll,holding_register,10,9,LE_BE
ref,name,10,string10,r
ref,flags,16,bool16,r
ref,set,17,int16,w
poll,coil,3,1,
ref,on,3,bool,r
poll,file,3,1,BE_BE
ref,none,3,int16,r
odd,line
"""


def test_a_configuration_of_modpoll_is_read(tmp_path: Path) -> None:
    found = read(tmp_path, "m.csv", POLLS)
    assert keys(found) == {
        "voltage": {"address": "input:0", "dtype": "float32", "order": "CDAB", "unit": "V"},
        "energy": {"address": "input:2", "dtype": "uint32", "order": "CDAB", "unit": "kWh", "scale": 0.01},
        "name": {"address": "holding:10", "dtype": "string", "length": 10},
        "on": {"address": "coil:3", "dtype": "bool"},
    }
    assert len(found.problems) == 4 and found.tags[0].taken == "unit 7"
    two = read(tmp_path, "m.csv", POLLS + POLLS.replace("meter,7", "other,8"))
    assert sum("give --unit" in problem for problem in two.problems) == 8 and not two.tags


HEAD = "_address\tdeviceId\tname\tdescription\tunit\ttype\tlen\tfactor\toffset\tformula\trole\troom\tcw\tisScale\n"


def iobroker(folder: Path, address: str, cells: str, how: Reading = _PLAIN) -> dict[str, Any] | str:
    unit, kind, length, factor, offset, formula = cells.split("|")
    line = f"{address}\t1\tT\t\t{unit}\t{kind}\t{length}\t{factor}\t{offset}\t{formula}\tvalue\t\tfalse\tfalse\n"
    found = read(folder, "input-registers.tsv", HEAD + line, how)
    return found.problems[0] if found.problems else keys(found)["T"]


@pytest.mark.parametrize(
    ("cells", "wanted"),
    [
        ("V|floatbe|2|1|0|", {"dtype": "float32", "order": "ABCD", "unit": "V"}),
        ("V|uint16be|1|0.1|0|", {"dtype": "uint16", "scale": 0.1}),
        ("V|uint16be|1|10|-5|", {"scale": 10.0, "offset": -5}),
        ("|uint32sw|2|1|0|", {"dtype": "uint32", "order": "CDAB"}),
        ("|int32le|2|1|0|", {"dtype": "int32", "order": "DCBA"}),
        ("|uint16le|1|1|0|", {"dtype": "uint16", "order": "BADC"}),
        ("|doublesb|4|1|0|", {"dtype": "float64", "order": "BADC"}),
        ("|string|8|1|0|", {"dtype": "string", "length": 16}),
        ("|int16be|1|1|0|x * 0.01", {"scale": 0.01}),
        ("|int16be|1|1|0|x/50", {"scale": 0.02}),
        ("|int16be|1|1|0|x * Math.pow(10, -3)", {"scale": 0.001}),
        ("|int16be|1|1|0|x * Math.pow(10, sf['104'])", {"scale_from": "holding:104"}),
    ],
)
def test_a_table_of_iobroker_is_read_by_its_own_words(cells: str, wanted: dict[str, Any], tmp_path: Path) -> None:
    found = iobroker(tmp_path, "100", cells)
    assert isinstance(found, dict), found
    assert {key: found.get(key) for key in wanted} == wanted


@pytest.mark.parametrize(
    ("address", "cells", "said"),
    [
        ("100", "|int16be|1|1|0|x < 0 ? 0 : x", "is more than a factor"),
        ("100", "|rawhex|1|1|0|", "no type that is known"),
        ("100", "|int16be|1|0|0|", "is 0, which would make"),
        ("100", "|int16be|1|10|0|x * 0.01", "correct one of them"),
        ("40101", "|int16be|1|1|0|", "give --numbers decimal"),
    ],
)
def test_a_row_of_iobroker_that_is_not_understood_is_refused(
    address: str, cells: str, said: str, tmp_path: Path
) -> None:
    found = iobroker(tmp_path, address, cells)
    assert isinstance(found, str) and said in found


def test_whether_iobroker_counts_references_is_asked(tmp_path: Path) -> None:
    cells = "|int16be|1|1|0|x * Math.pow(10, sf['40102'])"
    plain = iobroker(tmp_path, "40101", cells, Reading(numbers="plain"))
    assert isinstance(plain, dict) and (plain["address"], plain["scale_from"]) == ("holding:40101", "holding:40102")
    alias = iobroker(tmp_path, "40101", cells, Reading(numbers="decimal"))
    assert isinstance(alias, dict) and (alias["address"], alias["scale_from"]) == ("holding:100", "holding:101")


# ---------------------------------------------------------------- SunSpec

POINTS = [
    {"name": "ID", "type": "uint16", "size": 1, "value": 64001}, {"name": "L", "type": "uint16", "size": 1},
    {"name": "V", "type": "uint16", "size": 1, "sf": "V_SF", "units": "V"},
    {"name": "V_SF", "type": "sunssf", "size": 1}, {"name": "Serial", "type": "string", "size": 8},
    {"name": "Wh", "type": "acc32", "size": 2, "sf": 2, "units": "Wh"}, {"name": "Pad", "type": "pad", "size": 1},
    {"name": "Mac", "type": "eui48", "size": 4}, {"name": "N", "type": "count", "size": 1},
]  # fmt: skip
MODEL = {
    "id": 64001,
    "group": {
        "name": "made", "type": "group", "points": POINTS,
        "groups": [
            {"name": "two", "count": 2, "points": [{"name": "A", "type": "int16", "size": 1, "sf": "V_SF"}]},
            {"name": "some", "count": "N", "points": [{"name": "B", "type": "float32", "size": 2}]},
            {"name": "rest", "count": 0, "points": [{"name": "C", "type": "int32", "size": 2, "sf": "S"},
                                                    {"name": "S", "type": "sunssf", "size": 1}]},
        ],
    },
}  # fmt: skip


def test_a_model_of_sunspec_is_read_where_the_device_has_it(tmp_path: Path) -> None:
    with pytest.raises(ListError, match="give --shift"):
        read(tmp_path, "model.json", json.dumps(MODEL))
    found = read(tmp_path, "model.json", json.dumps(MODEL), Reading(shift=40002, repeats={"N": 1, "rest": 2}))
    assert {name: (row["address"], row.get("scale_from")) for name, row in keys(found).items()} == {
        "64001_V": ("holding:40004", "holding:40005"),
        "64001_Serial": ("holding:40006", None),
        "64001_Wh": ("holding:40014", None),
        "64001_N": ("holding:40021", None),
        "64001_two1_A": ("holding:40022", "holding:40005"),
        "64001_two2_A": ("holding:40023", "holding:40005"),
        "64001_some_B": ("holding:40024", None),
        "64001_rest1_C": ("holding:40026", "holding:40028"),
        "64001_rest2_C": ("holding:40029", "holding:40031"),
    }
    assert keys(found)["64001_Wh"]["scale"] == 100 and keys(found)["64001_V"]["sentinel"] == 0xFFFF
    assert [problem.rpartition(": ")[2] for problem in found.problems] == ["a eui48 is no number and no text"]
    assert "64001_V_SF" in found.sheet.left_out and "64001_ID" in found.sheet.left_out


def test_what_stands_behind_a_group_of_unknown_length_has_no_place(tmp_path: Path) -> None:
    found = read(tmp_path, "model.json", json.dumps(MODEL), Reading(shift=2, repeats={"rest": 1}))
    assert [p for p in found.problems if "some" in p and "give --repeat some=N" in p]
    assert [p for p in found.problems if "64001_rest_C" in p and "is not known before" in p]


@pytest.mark.parametrize(
    "text",
    ["{", "[]", "{}", '{"id": 1, "group": 3}', '{"id": "1", "group": {"points": []}}',
     '{"id": 1, "group": {"points": [{"name": "A"}]}}', '{"id": 1, "group": {"points": [{"name": 1, "type": "x"}]}}',
     '{"id": 1, "group": {"points": [], "groups": [{"name": "a", "count": 9999}]}}',
     '{"id": 1, "group": {"points": [{"name": "A", "type": "int16", "size": -5}]}}'],
)  # fmt: skip
def test_a_file_that_is_no_model_is_one_sentence(text: str, tmp_path: Path) -> None:
    with pytest.raises(ListError, match="SunSpec model") as caught:
        read(tmp_path, "model.json", text, Reading(shift=2))
    assert "\n" not in str(caught.value)


def sunspec_device(base: int, models: dict[int, list[int]]) -> Handler:
    """A device with these models behind the mark at `base`; what it does not have it refuses."""
    words = [0x5375, 0x6E53]
    for number, content in models.items():
        words += [number, len(content), *content]
    words += [0xFFFF, 0]
    registers = dict(enumerate(words, start=base))

    def handle(link: socket.socket) -> None:
        while True:
            head = take(link, 7)
            pdu = take(link, int.from_bytes(head[4:6], "big") - 1)
            start, count = struct.unpack(">HH", pdu[1:5])
            if pdu[0] == 3 and all(number in registers for number in range(start, start + count)):
                reply = struct.pack(f">BB{count}H", 3, 2 * count, *(registers[start + at] for at in range(count)))
            else:
                reply = bytes((pdu[0] | 0x80, 2))
            link.sendall(head[:4] + (len(reply) + 1).to_bytes(2, "big") + head[6:7] + reply)

    return handle


@pytest.mark.parametrize("base", [40000, 0, 50000, 1234])
def test_the_models_of_a_device_are_found_imported_and_read(base: int, tmp_path: Path) -> None:
    content = [2301, 0xFFFF, *([0x4142] * 8), 0, 7, 0, 0, 0, 0, 0, 1, 50, 51, 0x42F6, 0xE979, 0xFFFF, 0xFFFE, 0xFFFD]
    file, model = tmp_path / "d.toml", tmp_path / "model_64001.json"
    file.write_text('[device]\nname = "d"\ndriver = "modbus"\n')
    model.write_text(json.dumps(MODEL))
    with server(sunspec_device(base, {1: [0] * 4, 64001: content})) as port:
        host = ("--host", f"127.0.0.1:{port}")
        at = ("--device", file, *host)
        found = answer(tmp_path, "scan", "models", *([f"holding:{base}"] if base == 1234 else []), *host)
        assert [(row["model"], row["first"], row["registers"]) for row in found["models"]] == [
            (1, f"holding:{base + 2}", 6), (64001, f"holding:{base + 8}", len(content) + 2)
        ]  # fmt: skip
        words = found["models"][1]["import"].split()[2:]
        assert words == ["import", "model_64001.json", "--shift", str(base + 8)]
        more = ("--repeat", "N=1", "--repeat", "rest=1", "--skip-bad")
        assert plc(tmp_path, "import", model, *words[2:], *more, *at).exit_code == 0
        rows = {row["name"]: row for row in tomllib.loads(file.read_text())["tags"]}
        assert rows["64001_rest_C"]["scale_from"] == f"holding:{base + 8 + len(content) + 1}"
        read_back = answer(tmp_path, "read", "64001_V", "64001_two2_A", "64001_some_B", "64001_rest_C", *at)
        values = [reading["value"] for reading in read_back["readings"]]
        assert values == [230.1, 5.1, pytest.approx(123.456, rel=1e-6), -0.002]


def test_a_device_without_models_is_said(tmp_path: Path) -> None:
    with server(sunspec_device(100, {})) as port:
        found = plc(tmp_path, "scan", "models", "--host", f"127.0.0.1:{port}")
    assert found.exit_code == 1 and "its mark 'SunS' is not at holding:40000, holding:0, holding:50000" in found.output
