"""The software PLC's CANopen node as a state machine: no bus, no clock but the test's; and its object dictionary."""

import struct
from collections.abc import Callable
from pathlib import Path

import pytest

from sim.plc.canopen.eds import read_eds
from sim.plc.canopen.node import OPERATIONAL, PRE_OPERATIONAL, STOPPED, CanopenNode, Out
from sim.plc.canopen.objects import read_layout
from sim.plc.canopen.sdo import Abort
from sim.plc.program.checks import InputError
from sim.plc.program.clock import EmulatorClock
from sim.plc.program.disturbance import NodeDisturbance
from sim.plc.program.plc import Plc
from sim.plc.program.registers import read_map
from tests.plc.bench import DECANTER, block

MAP = DECANTER.parent / "decanter_canopen.toml"
START, STOP, PRE, RESET = b"\1\1", b"\2\1", b"\x80\1", b"\x81\1"
TPDOS = {0x181: 8, 0x281: 6, 0x381: 6, 0x481: 8, 0x1C1: 6, 0x2C1: 8, 0x4C1: 8, 0x1A1: 8, 0x3A1: 6}
"""The last two answer the second block."""
SYNCED = [0x3C1, 0x2A1]
"""The TPDOs that are sent with SYNC: the counts of either block."""
WELL = NodeDisturbance()


class Bench:
    """A PLC and its node at a moment that the test moves on."""

    def __init__(self) -> None:
        self.now = 100.0
        registers = read_map(DECANTER)
        self.plc = Plc(registers, EmulatorClock(0.0, 0.0, monotonic=lambda: self.now))
        assert registers.block is not None
        self.node = CanopenNode(read_layout(MAP, registers.tags, registers.blocks), self.plc)
        self.plc.begin(self.now)
        assert self.node.boot(self.now) == [(0x701, b"\0")]

    def step(self, seconds: float = 0.02, bend: NodeDisturbance = WELL) -> list[Out]:
        self.now += seconds
        self.plc.cycle(self.now)
        return self.node.cycle(self.now, bend)

    def take(self, identifier: int, data: bytes = b"") -> list[Out]:
        return self.node.take(identifier, data, self.now, WELL)

    def write(self, index: int, sub: int, value: int, size: int) -> None:
        self.node.objects.write((index, sub), value.to_bytes(size, "little"))

    def read(self, index: int, sub: int) -> int:
        return int.from_bytes(self.node.objects.read((index, sub)), "little")

    def put(self, words: list[int]) -> None:
        """The block as the seven RPDOs of the EDS."""
        for number, cob_id in enumerate((0x201, 0x301, 0x401, 0x501, 0x241, 0x341, 0x441)):
            part = words[4 * number : 4 * number + 4]
            self.take(cob_id, struct.pack(f"<{len(part)}H", *part))


@pytest.fixture
def bench() -> Bench:
    return Bench()


def identifiers(frames: list[Out]) -> list[int]:
    return [identifier for identifier, _ in frames]


def test_pdos_are_sent_and_taken_in_operational_only(bench: Bench) -> None:
    assert bench.node.state == PRE_OPERATIONAL
    assert identifiers(bench.step()) == []
    bench.put(block(1, 1))
    bench.take(0x000, START)
    assert {identifier: len(data) for identifier, data in bench.step()} == {**TPDOS, 0x701: 1}
    assert bench.plc.intake.accepted == 0
    bench.put(block(2, 2))
    assert bench.plc.intake.accepted == 1
    bench.take(0x000, STOP)
    assert bench.node.state == STOPPED
    assert set(identifiers(bench.step(1.0))) == {0x701}
    assert bench.node.answers(bytes.fromhex("4000100000000000")) == []
    bench.take(0x000, PRE)
    assert bench.node.answers(bytes.fromhex("4000100000000000")) == [bytes.fromhex("4300100000000000")]


def test_commands_to_other_nodes_and_half_commands_do_nothing(bench: Bench) -> None:
    for data in (b"\1\2", b"\1", b"", b"\1\1\0", b"\7\1"):
        bench.take(0x000, data)
    assert bench.node.state == PRE_OPERATIONAL
    bench.take(0x000, b"\1\0")
    assert bench.node.state == OPERATIONAL


def test_the_heartbeat_says_the_state_in_its_time(bench: Bench) -> None:
    beats = [data for _ in range(50) for identifier, data in bench.step() if identifier == 0x701]
    assert 4 <= len(beats) <= 6, "0.2 s by the EDS"
    assert set(beats) == {bytes([PRE_OPERATIONAL])}
    bench.write(0x1017, 0, 100, 2)
    assert 9 <= sum(identifier == 0x701 for _ in range(50) for identifier in identifiers(bench.step())) <= 11
    assert all(0x701 not in identifiers(bench.step(bend=NodeDisturbance(no_heartbeat=True))) for _ in range(50))


def test_a_tpdo_is_sent_on_a_change_and_with_its_event_timer_and_not_for_the_life_counter_alone(bench: Bench) -> None:
    bench.take(0x000, START)
    bench.step()
    assert [frame for frame in bench.step() if frame[0] != 0x701] == []
    bench.plc.force("Assorbimento", 123.4)
    ((identifier, data),) = [frame for frame in bench.step() if frame[0] != 0x701]
    assert (identifier, struct.unpack("<4H", data)[2]) == (0x181, 1234)
    times = [bench.now for _ in range(100) if 0x181 in identifiers(bench.step())]
    assert 3 <= len(times) <= 4, "0.5 s by the EDS"


def test_the_inhibit_time_keeps_changes_apart(bench: Bench) -> None:
    bench.write(0x1800, 3, 1000, 2)
    bench.take(0x000, START)
    sent = 0
    for number in range(50):
        bench.plc.force("Assorbimento", float(number))
        sent += 0x181 in identifiers(bench.step())
    assert sent in (9, 10), "one in 0.1 s, for 1 s"


def test_a_synchronous_tpdo_is_sent_with_sync_only(bench: Bench) -> None:
    bench.take(0x000, START)
    assert all(set(SYNCED).isdisjoint(identifiers(bench.step())) for _ in range(100))
    assert identifiers(bench.take(0x080)) == SYNCED
    bench.write(0x1809, 2, 0, 1)
    bench.write(0x1806, 2, 3, 1)
    assert [identifiers(bench.take(0x080)) for _ in range(6)] == [[], [], [0x3C1], [], [], [0x3C1]]
    bench.write(0x1806, 2, 0, 1)
    assert identifiers(bench.take(0x080)) == [], "type 0: only after a change"
    bench.put(block(1, 1))
    bench.step()
    assert identifiers(bench.take(0x080)) == [0x3C1]


def test_the_block_is_taken_when_its_last_word_comes_by_rpdo_by_sdo_and_as_a_whole(bench: Bench) -> None:
    bench.take(0x000, START)
    bench.put(block(1, 1))
    for number, word in enumerate(block(2, 2), start=1):
        assert bench.plc.intake.accepted == 1
        bench.write(0x2100, number, word, 2)
    assert bench.plc.intake.accepted == 2
    bench.node.objects.write((0x2102, 0), struct.pack("<26H", *block(3, 3)))
    assert (bench.plc.intake.accepted, bench.plc.intake.refused) == (3, 0)
    assert [bench.read(0x2100, sub) for sub in range(1, 27)] == block(3, 3)
    assert bench.node.objects.read((0x2102, 0)) == struct.pack("<26H", *block(3, 3))
    assert bench.read(0x2101, 1) == 3


def test_a_block_of_which_a_frame_is_lost_is_refused_by_its_checks(bench: Bench) -> None:
    bench.take(0x000, START)
    bench.put(block(1, 1))
    words = block(2, 2)
    for number, cob_id in enumerate((0x201, 0x301, 0x401, 0x501, 0x241, 0x341, 0x441)):
        if cob_id != 0x401:
            part = words[4 * number : 4 * number + 4]
            bench.take(cob_id, struct.pack(f"<{len(part)}H", *part))
    assert (bench.plc.intake.accepted, bench.plc.intake.refused) == (1, 1)
    bench.take(0x341, bytes(7))
    assert bench.plc.intake.refused == 1, "an RPDO of another length is not taken"


@pytest.mark.parametrize(
    ("address", "data", "code"),
    [
        ((0x3000, 0), b"\0", 0x06020000),
        ((0x2001, 99), b"\0\0", 0x06090011),
        ((0x2001, 1), b"\0\0", 0x06010002),
        ((0x2002, 2), b"\1\0", 0x06010002),
        ((0x1018, 1), bytes(4), 0x06010002),
        ((0x2100, 1), b"\0", 0x06070013),
        ((0x2100, 1), bytes(3), 0x06070012),
        ((0x2102, 0), bytes(51), 0x06070010),
        ((0x1A00, 0), b"\0", 0x08000022),
        ((0x1003, 0), b"\1", 0x06090030),
    ],
)
def test_what_may_not_be_written_is_aborted_with_cia_301s_code(
    bench: Bench, address: tuple[int, int], data: bytes, code: int
) -> None:
    with pytest.raises(Abort) as caught:
        bench.node.objects.write(address, data)
    assert caught.value.code == code


def test_a_pdo_is_remapped_while_it_is_off_and_only_with_what_fits(bench: Bench) -> None:
    off = 0x80000181
    bench.write(0x1800, 1, off, 4)
    with pytest.raises(Abort) as caught:
        bench.write(0x1A00, 1, 0x20010320, 4)
    assert caught.value.code == 0x08000022, "the number of entries must be 0 first"
    bench.write(0x1A00, 0, 0, 1)
    for entry, code in ((0x20010320, 0x06040041), (0x10000020, 0x06040041), (0x77770110, 0x06040041)):
        with pytest.raises(Abort) as caught:
            bench.write(0x1A00, 1, entry, 4)
        assert caught.value.code == code
    for sub, entry in enumerate((0x20010520, 0x20010620, 0x20010110), start=1):
        bench.write(0x1A00, sub, entry, 4)
    with pytest.raises(Abort) as caught:
        bench.write(0x1A00, 0, 3, 1)
    assert caught.value.code == 0x06040042
    bench.write(0x1A00, 0, 2, 1)
    bench.write(0x1800, 1, 0x181, 4)
    bench.take(0x000, START)
    assert {identifier: len(data) for identifier, data in bench.step()}[0x181] == 8


def test_a_reset_gives_back_the_parameters_of_the_eds(bench: Bench) -> None:
    bench.write(0x1800, 5, 100, 2)
    bench.take(0x000, START)
    assert bench.take(0x000, RESET) == [(0x701, b"\0")]
    assert bench.node.state == PRE_OPERATIONAL
    assert bench.read(0x1800, 5) == 500


@pytest.mark.parametrize(
    ("bend", "length"),
    [
        (NodeDisturbance(pdo=2, length=-2), 4),
        (NodeDisturbance(length=-9), 0),
        (NodeDisturbance(pdo=2, length=1), 7),
        (NodeDisturbance(length=5), 8),
    ],
)
def test_bent_pdos_are_shorter_or_longer_as_ordered(bench: Bench, bend: NodeDisturbance, length: int) -> None:
    bench.take(0x000, START)
    sizes = {identifier: len(data) for identifier, data in bench.step(bend=bend)}
    assert sizes[0x281] == length
    assert bend.pdo == 0 or sizes[0x381] == 6


def test_an_emergency_is_announced_once_kept_and_taken_back(bench: Bench) -> None:
    bend = NodeDisturbance(emergency=(0x5000, 0x81))
    assert (0x081, bytes.fromhex("0050810000000000")) in bench.step(bend=bend)
    assert 0x081 not in identifiers(bench.step(bend=bend))
    assert (bench.read(0x1001, 0), bench.read(0x1003, 0), bench.read(0x1003, 1)) == (0x81, 1, 0x5000)
    assert (0x081, bytes(8)) in bench.step()
    assert bench.read(0x1001, 0) == 0


def test_what_the_image_does_not_know_is_the_sentinel_and_what_it_has_lost_is_zero(bench: Bench) -> None:
    assert bench.read(0x2001, 1) == 0xFFFF
    assert bench.node.objects.read((0x2001, 5)) == struct.pack("<f", float("nan"))
    bench.plc.force("TFango", -12.5)
    bench.plc.force("PresenzaAllarme", True)
    bench.step()
    assert bench.node.objects.read((0x2001, 7)) == struct.pack("<h", -125)
    assert bench.read(0x2000, 1) == 1 << 5
    bench.plc.image.clear()
    assert (bench.read(0x2001, 1), bench.read(0x2000, 1)) == (0, 0)


def test_its_own_eds_can_be_read_from_it(bench: Bench) -> None:
    assert bench.node.objects.read((0x1021, 0)).decode() == (MAP.parents[1] / "decanter.eds").read_text()


def spoiled(tmp_path: Path, change: Callable[[str], str]) -> Path:
    path = tmp_path / "devices" / "map.toml"
    path.parent.mkdir()
    path.write_text(change(MAP.read_text(encoding="utf-8")), encoding="utf-8")
    (tmp_path / "decanter.eds").write_bytes((MAP.parents[1] / "decanter.eds").read_bytes())
    return path


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('"0x2001:1"', '"holding:1"', "tag 7: address: must match"),
        ('"0x2001:1"', '"0x2009:1"', "0x2009:1 is not in the EDS"),
        ('"0x2100:1"', '"holding:400"', r"\[writeback\]: address: must match index:sub-index, got 'holding:400'"),
        ('dtype = "bool"', 'dtyp = "bool"', r"tags\[0\]\.dtyp: there is no such key; did you mean 'dtype'"),
        ('name = "Assorbimento"', 'name = "Corrente"', "the register map has no 'Corrente'"),
        ("node = 1", "node = 100", "node: must be at most 63, got 100; give a node id"),
        ("../decanter.eds", "../none.eds", "none.eds: there is no such file"),
        ('    { name = "zone", dtype = "uint16" },', "    #", "25 words, and the register map's has 26"),
    ],
)
def test_a_device_file_that_cannot_be_used_is_one_sentence(tmp_path: Path, old: str, new: str, sentence: str) -> None:
    path = spoiled(tmp_path, lambda text: text.replace(old, new, 1))
    known = read_map(DECANTER)
    with pytest.raises(InputError, match=sentence):
        read_layout(path, known.tags, known.blocks)


@pytest.mark.parametrize(
    "text", ["", "no ini", "[1000]\nParameterName=x\n", "[1000]\nDataType=0x7\nDefaultValue=zwei\n"]
)
def test_an_eds_that_cannot_be_used_is_one_sentence(tmp_path: Path, text: str) -> None:
    path = tmp_path / "bad.eds"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"bad\.eds"):
        read_eds(path, 1)
