"""DBC files: the plant's own against its Modbus map, and what other people's files may hold."""

from pathlib import Path

import cantools
import pytest
from cantools.database.can import Database

from drivers.can.dbc import Dbc
from drivers.can.fields import decode_value
from drivers.driver import open_driver
from drivers.errors import AddressError, DriverError
from drivers.tag import DType, Quality, Tag
from gateway.settings.devices import load_device
from tests.drivers.can_frames import lies_in

CONFIG = Path(__file__).parents[2] / "config"
OTHERS = """VERSION ""
NS_ :
BS_:
BU_: ECU
BO_ 2566834688 Engine: 8 ECU
 SG_ Speed : 7|16@0+ (0.125,0) [0|8031.875] "rpm" ECU
 SG_ Torque : 23|12@0- (0.5,-10) [0|0] "%" ECU
 SG_ Gear : 39|8@0+ (1,0) [0|7] "" ECU
BO_ 100 Deep: 8 ECU
 SG_ Page M : 0|8@1+ (1,0) [0|255] "" ECU
 SG_ Sub m1M : 8|8@1+ (1,0) [0|255] "" ECU
 SG_ Plain m0 : 8|16@1+ (1,0) [0|0] "" ECU
 SG_ Inner m3 : 16|16@1- (1,0) [0|0] "" ECU
 SG_ Wide : 32|32@1- (1,0) [0|0] "" ECU
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "E2EProfile" STRING;
BA_DEF_ SG_ "x" STRING;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_DEF_DEF_ "E2EProfile" "";
BA_ "GenMsgCycleTime" BO_ 100 40;
SIG_VALTYPE_ 100 Wide : 1;
VAL_ 2566834688 Gear 7 "not available" ;
SG_MUL_VAL_ 100 Sub Page 1-1;
SG_MUL_VAL_ 100 Plain Page 0-0;
SG_MUL_VAL_ 100 Inner Sub 3-5;
"""


@pytest.fixture
def others(tmp_path: Path) -> Path:
    path = tmp_path / "others.dbc"
    path.write_text(OTHERS, encoding="latin-1")
    return path


def test_the_can_device_file_has_the_tags_units_ranges_and_steps_of_the_modbus_map() -> None:
    can, modbus = load_device(CONFIG / "devices/decanter_can.toml"), load_device(CONFIG / "devices/decanter_plc.toml")
    dbc = Dbc(CONFIG / "decanter.dbc")
    assert set(can.by_name) == set(modbus.by_name)
    for name, tag in modbus.by_name.items():
        there = dbc.locate(can.by_name[name])[0]
        is_flag = tag.dtype is DType.BOOL
        assert (there.unit, there.max_rate, there.sentinel, there.labels) == (
            *(tag.unit, tag.max_rate, tag.sentinel),
            tag.labels,
        )
        assert (there.dtype, there.scale, there.offset) == (tag.dtype, tag.scale, tag.offset)
        if tag.low is not None or is_flag:
            assert is_flag or (there.low, there.high) == (tag.low, tag.high)
    assert can.heartbeat == modbus.heartbeat
    assert can.writeback is not None
    assert modbus.writeback is not None
    assert can.writeback.fields == modbus.writeback.fields


def test_all_messages_of_the_plc_but_the_echo_are_protected_and_cyclic() -> None:
    for name, facts in Dbc(CONFIG / "decanter.dbc").messages.items():
        own = not name.startswith("Writeback")
        assert (facts.protection is not None) == own
        assert (facts.cycle is not None) == own


def test_motorola_signals_scales_and_negative_offsets_are_read_as_cantools_reads_them(others: Path) -> None:
    data = bytes.fromhex("1ac2fd3305000000")
    database = cantools.database.load_file(others)
    assert isinstance(database, Database)
    expected = database.decode_message("Engine", data, decode_choices=False)
    for name in ("Speed", "Torque", "Gear"):
        tag, field, facts = Dbc(others).locate(Tag(name, f"dbc:Engine.{name}"))
        assert facts.key == 2566834688  # a DBC file writes the flag of a 29-bit id as the kernel does
        value, quality, _ = decode_value(tag, field, data)
        assert quality is Quality.GOOD
        assert isinstance(expected, dict)
        assert value == pytest.approx(expected[name])


def test_named_special_values_do_not_make_the_ordinary_ones_wrong(others: Path) -> None:
    tag, field, _ = Dbc(others).locate(Tag("gear", "dbc:Engine.Gear", sentinel=7))
    assert decode_value(tag, field, bytes((0, 0, 0, 0, 5, 0, 0, 0)))[:2] == (5, Quality.GOOD)
    assert decode_value(tag, field, bytes((0, 0, 0, 0, 7, 0, 0, 0)))[:2] == (None, Quality.NO_DATA)


def test_extended_multiplexing_needs_every_selector_and_has_several_numbers(others: Path) -> None:
    dbc = Dbc(others)
    _, inner, facts = dbc.locate(Tag("x", "dbc:Deep.Inner"))
    assert lies_in(inner, bytes((1, 4, 9, 0, 0, 0, 0, 0)))
    assert not lies_in(inner, bytes((1, 6, 9, 0, 0, 0, 0, 0)))
    assert not lies_in(inner, bytes((0, 4, 9, 0, 0, 0, 0, 0)))
    assert facts.cycle == pytest.approx(0.04)
    assert facts.layouts > 1
    wide, field, _ = dbc.locate(Tag("w", "dbc:Deep.Wide"))
    assert field.conditions == ()
    assert wide.dtype is DType.FLOAT32


@pytest.mark.parametrize(
    ("tag", "words"),
    [
        (Tag("x", "dbc:Motor.Speed"), "no message 'Motor'; it has Engine, Deep"),
        (Tag("x", "dbc:Engine.Power"), "no signal 'Power'; it has Speed, Torque, Gear"),
        (Tag("x", "dbc:Engine.Speed", scale=0.1), "leave them out"),
        (Tag("x", "dbc:Engine.Speed", DType.BOOL), "a bool has 1 bit"),
    ],
)
def test_an_address_that_the_file_has_not_is_refused_with_what_it_has(others: Path, tag: Tag, words: str) -> None:
    with pytest.raises(AddressError, match=words):
        Dbc(others).locate(tag)


def test_a_file_that_cannot_be_used_is_one_sentence(others: Path, tmp_path: Path) -> None:
    broken = tmp_path / "broken.dbc"
    broken.write_text("BO_ nonsense", encoding="ascii")
    strange = tmp_path / "strange.dbc"
    strange.write_text(OTHERS + 'BA_ "E2EProfile" BO_ 100 "P99";\n', encoding="latin-1")
    for path, words in ((broken, "no DBC file"), (tmp_path / "none.dbc", "no DBC file"), (strange, "'P99'")):
        settings = {"interface": "hub", "channel": "x", "dbc": str(path)}
        with pytest.raises(DriverError, match=words) as caught:
            open_driver("can", settings, clock=lambda: 0.0)
        assert str(path) in str(caught.value)
        assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("SIG_VALTYPE_ 100 Wide : 1;", "SIG_VALTYPE_ 100 Wide : one;"),
        ('BA_ "E2EProfile" BO_ 100 "P01";', 'BA_ "E2EProfile" BO_ 100 P01"";'),
    ],
    ids=["float", "protection"],
)
def test_a_slip_in_what_decides_how_a_message_is_decoded_costs_the_whole_message(
    before: str, after: str, tmp_path: Path
) -> None:
    path = tmp_path / "slip.dbc"
    text = OTHERS if before in OTHERS else OTHERS + before + "\n"
    path.write_text(text.replace(before, after), encoding="latin-1")
    dbc = Dbc(path)
    with pytest.raises(AddressError, match="no message"):
        dbc.locate(Tag("w", "dbc:Deep.Wide"))
    assert any("by which it is decoded" in str(part) for part in dbc.left_out)


def test_a_slip_that_hides_whose_decoding_it_decides_costs_the_file(tmp_path: Path) -> None:
    path = tmp_path / "slip.dbc"
    path.write_text(OTHERS.replace("SIG_VALTYPE_ 100 Wide : 1;", "SIG_VALTYPE_ 1O0 Wide : 1;"), encoding="latin-1")
    settings = {"interface": "hub", "channel": "x", "dbc": str(path)}
    with pytest.raises(DriverError, match="no DBC file that can be used") as caught:
        open_driver("can", settings, clock=lambda: 0.0)
    assert "SIG_VALTYPE_ 1O0" in str(caught.value) and len(str(caught.value).splitlines()) == 1
