"""Data sheets as people have them: a slip costs the object that has it; XDD is read as EDS is."""

from pathlib import Path

import pytest

from drivers.canopen.eds import DataSheet, load_sheet, locate
from drivers.canopen.place import ObjectPlace
from drivers.errors import DriverError
from drivers.tag import DType, Tag

HEAD = "[FileInfo]\nFileName=x.eds\n[DeviceInfo]\nVendorName=Ex\nVendorNumber=001\nNrOfRXPDO=\n[Comments]\nLines=99\n"
TYPE = "[1000]\nParameterName=Device type\nObjectType=0x7\nDataType=0x0007\nAccessType=ro\nDefaultValue=0x191\n"
SPEED = "[2000]\nParameterName=Speed\nDataType=0x0006\nAccessType=ro\nPDOMapping=1\nDefaultValue=007\n"
COMPACT = "[2100]\nParameterName=T\nObjectType=0x8\nDataType=0x0003\nAccessType=ro\nPDOMapping=1\nCompactSubObj=3\n"
NAMES = "[2100Name]\nNrOfEntries=1\n2=Feed side\n"
XDD = """<?xml version="1.0"?><ISO15745ProfileContainer xmlns="http://www.canopen.org/xml/1.1"><CANopenObjectList>
<CANopenObject index="1000" name="Device type" objectType="7" dataType="0007" accessType="ro" defaultValue="0x191"/>
<CANopenObject index="2100" name="T" objectType="9" subNumber="2">
<CANopenSubObject subIndex="00" name="n" objectType="7" dataType="0005" accessType="const" defaultValue="1"/>
<CANopenSubObject subIndex="01" name="Bearing" objectType="7" dataType="0003" accessType="ro" PDOmapping="TPDO"/>
</CANopenObject></CANopenObjectList></ISO15745ProfileContainer>"""


def read(folder: Path, text: str, encoding: str = "utf-8") -> DataSheet:
    path = folder / "unit.eds"
    path.write_bytes(text.encode(encoding))
    return load_sheet(path, 5)


@pytest.mark.parametrize(
    "slip",
    [
        "", TYPE, "[2001]\nno key here\n",
        "[2001\nParameterName=x\n",
        "[]\n",
        "[1018sub1]\nParameterName=x\nDataType=7\n",
        "[2001]\nParameterName=x\nDataType=seven\nAccessType=ro\n",
        "[2001]\nParameterName=x\nDataType=7\nAccessType=maybe\n",
        "[DummyUsage]\nDummy0001=yes\n",
        "[2001]\nParameterName=x\nObjectType=0x9\nSubNumber=\n",
        "[2001]\nParameterName=x\n",
    ],
)  # fmt: skip
@pytest.mark.parametrize("encoding", ["utf-8-sig", "cp1252"])
def test_a_slip_costs_the_object_that_has_it(slip: str, encoding: str, tmp_path: Path) -> None:
    sheet = read(tmp_path, HEAD + TYPE + slip + SPEED.replace("Speed", "Höhe"), encoding)
    assert sheet.value(ObjectPlace(0x1000)) == 0x191
    speed = sheet.objects[ObjectPlace(0x2000)]
    assert (speed.name, speed.size, speed.mappable, speed.value) == ("Höhe", 2, True, 7)
    if "x\nDataType=seven" in slip or slip == TYPE:
        line = (HEAD + TYPE).count("\n") + 1
        assert any(f"line {line}:" in problem for problem in sheet.left_out)
    if "seven" in slip:
        assert "DataType 'seven' is no number" in locate(Tag("X", "0x2001:0"), sheet).misplaced


def test_a_compact_array_has_all_its_members(tmp_path: Path) -> None:
    sheet = read(tmp_path, HEAD + COMPACT + NAMES)
    assert sheet.value(ObjectPlace(0x2100, 0)) == 3
    members = [sheet.objects[ObjectPlace(0x2100, sub)] for sub in (1, 2, 3)]
    assert [(member.name, member.size, member.mappable) for member in members] == [
        ("T1", 2, True), ("Feed side", 2, True), ("T3", 2, True)
    ]  # fmt: skip


def test_an_xdd_gives_the_objects_that_it_has(tmp_path: Path) -> None:
    sheet = read(tmp_path, XDD)
    assert sheet.value(ObjectPlace(0x1000)) == 0x191 and sheet.value(ObjectPlace(0x2100, 0)) == 1
    assert locate(Tag("T", "0x2100:1", DType.INT16), sheet).misplaced == ""
    assert sheet.bits(ObjectPlace(0x2100, 1)) == 16
    for text in ("<not xml", '<!DOCTYPE x [<!ENTITY a "b">]>' + XDD):
        with pytest.raises(DriverError, match="is no EDS"):
            read(tmp_path, text)


PROFILE = """<?xml version="1.0"?>
<ISO15745ProfileContainer xmlns="http://www.canopen.org/xml/1.1"><!-- <CANopenObject index="9"/>
--><CANopenObjectList>
<CANopenObject index="1000" name="Device type" objectType="7" uniqueIDRef="A"/>
<CANopenObject index="2100" name="T" objectType="9" uniqueIDRef="B">
<CANopenSubObject subIndex="00" name="n" objectType="7" uniqueIDRef="C"/>
<CANopenSubObject subIndex="01" name="Bearing" objectType="7" PDOmapping="TPDO" uniqueIDRef="D"/>
<CANopenSubObject subIndex="02" name="Bits" objectType="7" uniqueIDRef="E"/>
</CANopenObject></CANopenObjectList><q:ApplicationProcess xmlns:q="urn:q"><q:parameterList>
<q:parameter uniqueID="A"><UDINT/><q:defaultValue value="0x191"/></q:parameter>
<q:parameter uniqueID="B"><q:dataTypeIDRef uniqueIDRef="X"/></q:parameter>
<q:parameter uniqueID="C" access="const"><USINT/><q:defaultValue value="2"/></q:parameter>
<q:parameter uniqueID="D" access="readWriteInput"><INT/></q:parameter>
<q:parameter uniqueID="E" access="read"><BITSTRING/></q:parameter>
</q:parameterList></q:ApplicationProcess></ISO15745ProfileContainer>"""


def test_an_xdd_may_say_of_an_object_elsewhere_what_it_is(tmp_path: Path) -> None:
    sheet = read(tmp_path, PROFILE)
    assert sheet.value(ObjectPlace(0x1000)) == 0x191 and sheet.value(ObjectPlace(0x2100, 0)) == 2
    first, number, bearing = (sheet.objects[ObjectPlace(*at)] for at in ((0x1000, 0), (0x2100, 0), (0x2100, 1)))
    assert [(one.size, one.readable, one.writable) for one in (first, number, bearing)] == [
        (4, True, False), (1, True, False), (2, True, True)
    ]  # fmt: skip
    assert sheet.bits(ObjectPlace(0x2100, 1)) == 16
    # What is of no type that is known here costs itself, with the line of the file.
    (said,) = sheet.left_out
    assert "line 8: [2100sub2] is left out" in said


def test_the_shared_sheet_is_read() -> None:
    path = Path(__file__).parents[3] / "shared" / "cases" / "devices" / "eds_vendor_number" / "device.eds"
    if not path.is_file():
        pytest.skip("the shared cases are not here")
    assert ObjectPlace(0x1018, 1) in load_sheet(path, 5).objects
