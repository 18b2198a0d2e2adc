"""The table of faults, the schedule, and the sentence for a fault that cannot be."""

from pathlib import Path
from random import Random

import pytest

from sim.plc.emulator import parse_stretch, read_faults
from sim.plc.program.checks import InputError
from sim.plc.program.faults import FAULTS, describe, parse_fault
from sim.plc.program.pdu import ModbusReply, ModbusRequest
from sim.plc.program.registers import Place
from sim.plc.program.schedule import FaultSchedule

REQUEST = ModbusRequest("test", 5, 1, bytes.fromhex("03 0064 0002"))
REPLY = ModbusReply(5, 1, bytes.fromhex("03 04 0001 0002"))


def bent(kind: str, **parameters: object) -> ModbusReply:
    effect = parse_fault({"kind": kind, **parameters}, "test").effect(0.0)
    alter = effect.alter or effect.answer
    assert alter is not None
    return alter(REQUEST, REPLY, Random(0))


@pytest.mark.parametrize(
    ("kind", "parameters", "frame"),
    [
        ("wrong_unit", {}, "0005 0000 0007 02 03 04 0001 0002"),
        ("wrong_unit", {"unit": 9}, "0005 0000 0007 09 03 04 0001 0002"),
        ("wrong_function", {}, "0005 0000 0007 01 04 04 0001 0002"),
        ("wrong_transaction", {"offset": -1}, "0004 0000 0007 01 03 04 0001 0002"),
        ("wrong_count", {}, "0005 0000 0005 01 03 02 0001"),
        ("wrong_count", {"delta": 1}, "0005 0000 0009 01 03 06 0001 0002 0000"),
        ("wrong_count", {"honest": False}, "0005 0000 0005 01 03 04 0001"),
        ("duplicate", {}, "0005 0000 0007 01 03 04 0001 0002" * 2),
        ("cut_short", {"missing": 2}, "0005 0000 0007 01 03 04 0001"),
        ("cut_short", {"missing": 99}, ""),
    ],
)
def test_a_fault_bends_the_reply_as_it_says(kind: str, parameters: dict[str, object], frame: str) -> None:
    assert bent(kind, **parameters).frame() == bytes.fromhex(frame)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"kind": "lte"}, ["kind: ", "'lte'", "late"]),
        ({}, ["kind: is missing"]),
        ({"kind": "late", "delay": 1}, ["(late)", "delay: there is no such key", "delay_s"]),
        ({"kind": "late", "delay_s": "1"}, ["delay_s: must be a number, got '1'"]),
        ({"kind": "late", "delay_s": float("inf")}, ["delay_s: must be a finite number"]),
        ({"kind": "late", "duration": -1}, ["duration: must be more than 0, got -1"]),
        ({"kind": "late", "probability": 2}, ["probability: ", "0..1"]),
        ({"kind": "illegal_register"}, ["registers: ", "missing"]),
        ({"kind": "illegal_register", "registers": ["h1"]}, ["registers", "'h1'", "holding:N"]),
        ({"kind": "frozen", "count": 2}, ["(frozen)", "count"]),
        ([], ["test"]),
    ],
)
def test_a_bad_fault_is_refused_in_one_sentence(data: object, words: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        parse_fault(data, "test")
    for word in words:
        assert word in str(caught.value)


def test_a_schedule_is_read_from_toml_and_from_json(tmp_path: Path) -> None:
    (tmp_path / "f.toml").write_text('[[fault]]\nkind = "late"\nstart = 2\ncount = 3\nfunctions = [16]\n')
    (tmp_path / "f.json").write_text('[{"kind": "late", "start": 2, "count": 3, "functions": [16]}]')
    for name in ("f.toml", "f.json"):
        (fault,) = read_faults(tmp_path / name)
        assert (fault.kind, fault.start, fault.count, fault.functions) == ("late", 2.0, 3, (16,))


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("f.toml", 'fault = "late"', "no list"),
        ("f.toml", "[[faults]]", "'faults'"),
        ("f.toml", '[[fault]]\nkind="no"', "fault 1"),
        ("f.json", "{", "not JSON"),
        ("f.json", "{}", "no list"),
    ],
)
def test_a_bad_file_of_faults_is_refused(tmp_path: Path, name: str, text: str, reason: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=reason):
        read_faults(tmp_path / name)


def struck(seed: int) -> list[bool]:
    schedule = FaultSchedule(seed)
    schedule.add(parse_fault({"kind": "silent", "probability": 0.5}, "test"), 0.0)
    return [bool(list(schedule.strike(3, moment / 100))) for moment in range(64)]


def test_the_draws_depend_on_the_seed_alone() -> None:
    assert struck(1) == struck(1) != struck(2)
    assert 10 < sum(struck(1)) < 54


def test_a_fault_ends_after_its_duration_its_count_or_when_it_is_cleared() -> None:
    schedule = FaultSchedule()
    schedule.add(parse_fault({"kind": "silent", "start": 1.0, "duration": 2.0}, "test"), 10.0)
    schedule.add(parse_fault({"kind": "late", "count": 2, "functions": [16]}, "test"), 10.0)
    number = schedule.add(parse_fault({"kind": "frozen"}, "test"), 10.0)
    assert [entry.fault.kind for entry in schedule.advance(10.0)[0]] == ["late", "frozen"]
    assert [len(list(schedule.strike(3, moment))) for moment in (10.9, 11.0, 12.9, 13.0)] == [0, 1, 1, 0]
    assert [len(list(schedule.strike(16, moment))) for moment in (10.0, 10.1, 10.2)] == [1, 1, 0]
    assert schedule.standing_effect(99.0).frozen
    schedule.clear(number)
    assert not schedule.standing_effect(99.0).frozen
    with pytest.raises(InputError, match="no fault 77"):
        schedule.clear(77)
    schedule.advance(99.0)
    assert schedule.entries == []


def test_a_fault_that_came_and_went_between_two_cycles_is_reported_all_the_same() -> None:
    schedule = FaultSchedule()
    schedule.add(parse_fault({"kind": "silent", "count": 1}, "test"), 10.0)
    schedule.add(parse_fault({"kind": "refuse", "duration": 0.001}, "test"), 10.0)
    assert len(list(schedule.strike(3, 10.0))) == 1
    begun, over = schedule.advance(10.02)
    assert [entry.fault.kind for entry in begun] == [entry.fault.kind for entry in over] == ["silent", "refuse"]


def test_the_documentation_lists_every_fault_with_its_parameters() -> None:
    text = describe()
    assert all(f"| `{name}` |" in text for name in FAULTS)
    assert "delay_s = 1.0" in text


def test_test_registers_are_named_by_stretches() -> None:
    assert parse_stretch("holding:300-310") == Place("holding", 300, 11)
    assert parse_stretch("coil:5") == Place("coil", 5, 1)
    for wrong in ("holding:9-3", "input:5", "holding:x", "holding:1-x", "holding:-5"):
        with pytest.raises(InputError, match="--writable"):
            parse_stretch(wrong)
