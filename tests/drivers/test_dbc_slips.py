"""DBC files as people have them: a slip costs the message that has it, and is named with its line."""

from pathlib import Path

import pytest

from drivers.can.dbc import Dbc
from drivers.errors import AddressError, DriverError
from drivers.tag import Tag

HEAD = 'VERSION ""\n\nNS_ :\n\tNS_DESC_\n\tCM_\n\tBA_\n\nBS_:\n\nBU_: PLC HMI\n\n'
BEARING = (
    'BO_ 384 Bearing: 8 PLC\n SG_ Temp : 0|16@1- (0.1,0) [-40|150] "°C" HMI\n'
    ' SG_ Speed : 16|16@1+ (1,0) [0|5000] "rpm" HMI\n\n'
)
OTHER = 'BO_ 400 Other: 8 PLC\n SG_ X : 0|8@1+ (1,0) [0|0] "" HMI\n\n'


def read(folder: Path, text: str, encoding: str = "utf-8") -> Dbc:
    path = folder / "unit.dbc"
    path.write_bytes(text.encode(encoding))
    return Dbc(path)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252"])
def test_a_unit_is_read_in_the_files_own_encoding(encoding: str, tmp_path: Path) -> None:
    tag, _, _ = read(tmp_path, HEAD + BEARING, encoding).locate(Tag("T", "dbc:Bearing.Temp"))
    assert tag.unit == "°C"


def test_a_sign_that_no_encoding_has_costs_nothing(tmp_path: Path) -> None:
    path = tmp_path / "unit.dbc"
    path.write_bytes((HEAD + BEARING).encode("cp1252") + b'CM_ SG_ 384 Temp "Lager\x9d";\n')
    assert Dbc(path).locate(Tag("T", "dbc:Bearing.Temp"))[0].unit == "°C"


@pytest.mark.parametrize(
    ("slip", "lost"),
    [
        ('BO_ 419364864 Aux: 8 PLC\n SG_ X : 0|8@1+ (1,0) [0|0] "" HMI\n\n', "Aux"),  # 29 bits without their flag
        ('VAL_ 384 Gone 0 "off" 1 "on" ;\n', "Gone"),
        ('BO_ 402 Cut: 8 PLC\n SG_ X : 0|8@1+ (1,0 [0|0] "" HMI\n\n', "SG_ X"),
        ('CM_ BO_ 384 "no end of it"\n', "CM_ BO_ 384"),
        ('BA_ "GenMsgCycleTime" BO_ 384 abc;\n', "BA_"),
    ],
)
def test_a_slip_costs_what_has_it(slip: str, lost: str, tmp_path: Path) -> None:
    # In the middle of the file: what stands behind it is read too.
    dbc = read(tmp_path, HEAD + BEARING + slip + OTHER)
    assert {"Bearing", "Other"} <= set(dbc.messages)
    assert dbc.locate(Tag("T", "dbc:Bearing.Temp"))[0].scale == 0.1
    (said,) = dbc.left_out
    line = (HEAD + BEARING + slip).split("\n").index(next(row for row in slip.split("\n") if lost in row)) + 1
    assert lost in said and f"line {line}:" in said
    if lost == "Aux":
        with pytest.raises(AddressError, match=f"line {line}: BO_ 419364864"):
            dbc.locate(Tag("T", "dbc:Aux.X"))


def test_a_second_message_of_a_name_does_not_take_the_place_of_the_first(tmp_path: Path) -> None:
    dbc = read(tmp_path, HEAD + BEARING + OTHER.replace("400 Other", "401 Bearing"))
    assert dbc.messages["Bearing"].key == 384 and "second message 'Bearing'" in dbc.left_out[0]


def test_what_is_no_dbc_is_refused_whole(tmp_path: Path) -> None:
    with pytest.raises(DriverError, match="no DBC file"):
        read(tmp_path, "Sehr geehrte Damen und Herren,\nBO_ 1 und SG_ 2\n")
