"""Requests and replies as bytes: every function, every refusal, and bytes that mean nothing."""

import struct
from collections.abc import Sequence
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.plc.program.clock import EmulatorClock
from sim.plc.program.pdu import ModbusReply, ModbusRequest
from sim.plc.program.plc import Plc, PlcSettings
from sim.plc.program.registers import Place, read_map
from tests.plc.bench import DECANTER

COILS = """
[device]
name = "coils"
driver = "modbus"
max_gap = 2
max_registers = 20
[[tags]]
name = "Running"
address = "coil:3"
dtype = "bool"
writable = true
[[tags]]
name = "Full"
address = "discrete:9"
dtype = "bool"
[[tags]]
name = "Level"
address = "input:5"
dtype = "float64"
order = "DCBA"
[[tags]]
name = "Setpoint"
address = "holding:0"
dtype = "int32"
order = "CDAB"
scale = 0.5
writable = true
[[tags]]
name = "High"
address = "holding:4"
[[tags]]
name = "Far"
address = "holding:8"
"""


def plc_of(path: Path, writable: Sequence[Place] = ()) -> Plc:
    plc = Plc(read_map(path), EmulatorClock(0.0, 0.0, monotonic=lambda: 0.0), settings=PlcSettings(writable=writable))
    plc.begin(0.0)
    return plc


@pytest.fixture
def plc(tmp_path: Path) -> Plc:
    (tmp_path / "m.toml").write_text(COILS)
    return plc_of(tmp_path / "m.toml", [Place("holding", 20, 4), Place("coil", 20, 9)])


def ask(plc: Plc, text: str) -> str:
    reply = plc.exchange(ModbusRequest("test", 1, 1, bytes.fromhex(text)), 0.0)
    assert reply is not None
    return reply.pdu.hex(" ")


def test_every_table_is_read_by_its_own_function(plc: Plc) -> None:
    for name, value in (("Running", True), ("Full", True), ("Level", 1.5), ("Setpoint", 100_000), ("High", 7)):
        plc.force(name, value)
    plc.cycle(0.0)
    assert ask(plc, "01 0003 0001") == "01 01 01"
    assert ask(plc, "02 0009 0001") == "02 01 01"
    assert ask(plc, "03 0000 0002") == "03 04 0d 40 00 03"  # 200000 = 0x00030D40, low word first
    assert bytes.fromhex(ask(plc, "04 0005 0004"))[2:] == struct.pack("<d", 1.5)
    assert ask(plc, "03 0004 0001") == "03 02 00 07"


def test_unused_registers_in_a_gap_that_the_map_allows_read_zero_and_others_are_refused(plc: Plc) -> None:
    assert ask(plc, "03 0000 0005") == "03 0a 00 00 00 00 00 00 00 00 00 00"
    assert ask(plc, "03 0004 0005") == "83 02"  # 5, 6 and 7 are one more than max_gap
    assert ask(plc, "03 0009 0001") == "83 02"


def test_writes_are_stored_where_a_client_may_write_and_refused_elsewhere(plc: Plc) -> None:
    assert ask(plc, "05 0003 ff00") == "05 00 03 ff 00"
    assert ask(plc, "01 0003 0001") == "01 01 01"
    assert ask(plc, "06 0015 1234") == "06 00 15 12 34"
    assert ask(plc, "10 0014 0002 04 00010002") == "10 00 14 00 02"
    assert ask(plc, "03 0014 0002") == "03 04 00 01 00 02"
    assert ask(plc, "16 0014 ff00 0055") == "16 00 14 ff 00 00 55"
    assert ask(plc, "17 0014 0002 0015 0001 02 abcd") == "17 04 00 55 ab cd"
    assert ask(plc, "0f 0014 0009 02 ff01") == "0f 00 14 00 09"
    assert ask(plc, "01 0014 0009") == "01 02 ff 01"
    for refused in ("05 0009 ff00", "06 0004 0001", "10 0017 0002 04 00010002", "17 0014 0001 0008 0001 02 0001"):
        assert ask(plc, refused)[3:] == "02", refused


def test_what_a_client_writes_to_a_tag_is_its_true_value_from_then_on(plc: Plc) -> None:
    ask(plc, "10 0000 0002 04 0d40 0003")
    plc.cycle(0.0)
    assert plc.image.truth["Setpoint"] == 100_000
    assert ask(plc, "03 0000 0002") == "03 04 0d 40 00 03"


@pytest.mark.parametrize(
    ("request_pdu", "reply"),
    [
        ("07", "87 01"),
        ("63 00", "e3 01"),
        ("03 0000 0000", "83 03"),
        ("03 0000 0015", "83 03"),  # 21 registers, and the map's limit is 20
        ("03 0000", "83 03"),
        ("03 0000 0001 00", "83 03"),
        ("03 ffff 0002", "83 02"),
        ("01 0003 07d1", "81 03"),
        ("05 0003 1234", "85 03"),
        ("10 0014 0002 03 000100", "90 03"),
        ("10 0014 0002 04 000100", "90 03"),
        ("0f 0014 0009 01 ff", "8f 03"),
        ("16 0014 ff", "96 03"),
        ("17 0014 0001 0014", "97 03"),
        ("2b 0d 01 00", "ab 01"),
        ("2b 0e 07 00", "ab 03"),
    ],
)
def test_a_wrong_request_gets_the_standards_exception(plc: Plc, request_pdu: str, reply: str) -> None:
    assert ask(plc, request_pdu) == reply


def test_the_device_identifies_itself(plc: Plc) -> None:
    assert bytes.fromhex(ask(plc, "2b 0e 01 00")).startswith(b"\x2b\x0e\x01\x81\x00\x00\x03\x00\x08decanter")
    assert bytes.fromhex(ask(plc, "2b 0e 04 01")).endswith(b"\x01\x01\x0csoftware PLC")


@given(st.binary(min_size=1, max_size=253))
@settings(max_examples=300)
def test_no_bytes_make_it_raise(pdu: bytes) -> None:
    plc = FUZZED
    reply = plc.exchange(ModbusRequest("test", 1, 1, pdu), 0.0)
    assert reply is not None
    assert reply.pdu[0] in (pdu[0], pdu[0] | 0x80)
    assert len(reply.pdu) <= 253


FUZZED = plc_of(DECANTER, [Place("holding", 0, 50), Place("coil", 0, 50)])


def test_a_frame_has_the_standards_header() -> None:
    assert ModbusReply(0x0102, 9, b"\x83\x02").frame() == bytes.fromhex("0102 0000 0003 09 8302")


def test_a_value_that_does_not_fit_is_served_as_not_available_or_as_its_limit_and_named_once() -> None:
    said: list[str] = []
    plc = Plc(read_map(DECANTER), EmulatorClock(0.0, 0.0), complain=said.append)
    current, heartbeat = plc.registers.tags["Assorbimento"], plc.registers.tags["AcknowledgeBits"]
    assert plc.image.representable(current, -0.3) is None
    assert plc.image.representable(current, -0.4) is None
    assert plc.image.representable(heartbeat, 70_000) == 65535
    assert len(said) == 2 and "Assorbimento cannot hold -0.3 A" in said[0] and "not available" in said[0]
