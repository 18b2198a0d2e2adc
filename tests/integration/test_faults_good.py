"""Under every fault of the PLC: no wrong value is good, nothing is written elsewhere or twice, and all comes back."""

import struct
from pathlib import Path

import pytest

from benchmarks.fault_matrix import (
    FAULTS,
    OUTAGES,
    TOLERATED,
    Matrix,
    Row,
    block_failed,
    judged_row,
    measure,
    outside,
    reading_lost,
    repeated,
)
from drivers.tag import Quality, Sample
from sim.plc.program.faults import FAULTS as KINDS
from sim.plc.program.faults import face_shows
from sim.plc.record.recording import PlcRecording, RequestRow
from tests.rig.pair import MAP
from tests.rig.stalls import measured_again

BY_CHANCE = ("late reply, now and then",)
ONLY_WRITES = ("write ignored",)
MOMENTS = ("half_open",)
"""A connection goes deaf once; where a block is what meets it, a new one may serve all readings."""
PAUSE_S = 0.3
"""Between two faults: three scans in which all is well."""
LASTS_S = 0.6
"""Of faults that last a second in the measured matrix: six scans, and on a busy machine until they are seen."""
BACK_S = 1.0
"""Seconds within which good readings return."""


def test_every_fault_of_the_software_plc_is_in_the_matrix() -> None:
    assert {fault["kind"] for fault in FAULTS.values()} == {kind for kind in KINDS if face_shows(kind, "tcp")}


@pytest.fixture(scope="module")
def matrix(tmp_path_factory: pytest.TempPathFactory) -> Matrix:
    """All faults, one after the other, of one PLC under one gateway."""
    # The program comes back from a restart by itself.
    by_themselves = (*TOLERATED, *BY_CHANCE, *MOMENTS, *ONLY_WRITES, "restart")
    held = dict.fromkeys((name for name in FAULTS if name not in by_themselves), reading_lost)
    held |= dict.fromkeys(ONLY_WRITES, block_failed)
    faults = {
        name: {**fault, "duration": LASTS_S} if fault.get("duration") == 1.0 else fault
        for name, fault in FAULTS.items()
    }
    folder = tmp_path_factory.mktemp("faults")

    def again(at: Path, fault: str) -> Matrix:
        return measure(at, {fault: faults[fault]}, pause=PAUSE_S, held=held)

    whole = measure(folder, faults, pause=PAUSE_S, held=held)
    return measured_again(whole, folder, dict.fromkeys(OUTAGES, BACK_S), again, TOLERATED)


@pytest.mark.timeout(1200)
def test_no_wrong_value_is_good_and_nothing_is_written_elsewhere_or_twice(matrix: Matrix) -> None:
    assert matrix.examples == ()
    assert (matrix.outside, matrix.repeated, matrix.missing, matrix.failures) == (0, 0, 0, 0)
    assert matrix.blocks > 60 and matrix.refusals == {}


@pytest.mark.timeout(1200)
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_makes_no_wrong_value_good_and_is_noticed(fault: str, matrix: Matrix) -> None:
    (row,) = (row for row in matrix.rows if row.fault == fault)
    assert row.judged > 0 and row.wrong_good == 0, row
    assert_noticed(row)
    if fault in OUTAGES:
        assert row.recovered_s is not None and row.recovered_s < BACK_S, row


def assert_noticed(row: Row) -> None:
    """A fault that takes values away is seen; one that does not costs nothing."""
    if row.fault in TOLERATED:
        assert (row.detected_s, row.not_good, row.unconfirmed) == (None, {}, 0), row
    elif row.fault in ONLY_WRITES:
        assert row.not_good == {} and row.unconfirmed > 0, row
    elif row.fault == "illegal register":
        assert set(row.not_good) == {"LivelloVibrazioni"}, "its neighbours in the block must stay good"
    elif row.fault == "words swapped in mid-run":
        assert set(row.not_good) == {"TCuscinettiRiduttore", "TCuscinettiAlimentazione"}, "other tags have one register"
    elif row.fault in MOMENTS:
        assert row.detected_s is not None, row
    elif row.fault not in BY_CHANCE:
        assert row.detected_s is not None and row.not_good, row


def test_the_judge_finds_the_wrong_values_of_a_gateway_that_does_not_watch_the_heartbeat(tmp_path: Path) -> None:
    """The control: without the rule that decision 0005 makes, the same run has wrong good values."""
    device = tmp_path / "device.toml"
    lines = MAP.read_text(encoding="utf-8").splitlines()
    device.write_text("\n".join(line for line in lines if not line.startswith("heartbeat =")), encoding="utf-8")
    matrix: Matrix = measure(tmp_path, {"frozen image": FAULTS["frozen image"]}, device)
    assert matrix.rows[0].wrong_good > 10


def test_a_block_that_meets_the_fault_after_its_scan_has_read_is_the_faults() -> None:
    """The connection went deaf between the reading, 1 ms before the fault began, and the block of the same scan."""
    moments = (9.7, 9.8, 9.9, 9.999, 10.6, 10.7, 10.8, 10.9, 11.0)
    read = [Sample("TCuscinettiRiduttore", 40.0, Quality.GOOD, moment) for moment in moments]
    before = judged_row("before", (9.0, 9.1), 10.0, read=read, unconfirmed=[9.999], wrong=())
    half_open = judged_row("half_open", (10.0, 10.1), 11.05, read=read, unconfirmed=[9.999], wrong=())
    assert (before.unconfirmed, before.detected_s) == (0, None)
    assert (half_open.unconfirmed, half_open.detected_s, half_open.judged) == (1, 0.0, 5)


def test_a_scan_that_came_too_late_to_prove_anything_is_the_computers_and_not_the_faults() -> None:
    def row(*moments: float, fault: str = "split reply") -> Row:
        scans = (9.8, 9.9, 10.7, 10.8, 10.9, 11.0)
        read = [Sample("TCuscinettiRiduttore", 40.0, Quality.GOOD, moment) for moment in scans]
        read += [Sample("TFango", 40.0, Quality.LAST_USABLE, moment) for moment in moments]
        return judged_row(fault, (9.7, 10.5), 11.1, read=read, unconfirmed=moments, wrong=())

    # The one right after it has nothing newer to prove it than what was read before the late one.
    late, next_one, punctual = row(10.701), row(10.801), row(10.901)
    assert (late.not_good, late.unconfirmed) == (next_one.not_good, next_one.unconfirmed) == ({}, 0)
    assert (punctual.not_good, punctual.unconfirmed) == ({"TFango": 1}, 1)
    # A fault that holds back replies makes scans late itself: there it is what is noticed.
    assert row(10.701, fault="wrong transaction").detected_s == pytest.approx(1.001)


def written(
    transaction: int, address: int, sequence: int, function: int = 16, exception: int | None = None
) -> RequestRow:
    """A write of 24 words as the PLC records it."""
    words = (1, sequence, *range(22))
    pdu = struct.pack(">BHHB24H", function, address, 24, 48, *words)
    place = (1.0, 1.0, "peer", transaction, 1, function, address, 24)
    return RequestRow(*place, pdu=pdu, reply=None, exception=exception, delay_s=0.0, faults=(), version=1)


@pytest.mark.parametrize(
    ("row", "count"),
    [
        (written(2, 400, 8), (0, 0)),
        (written(2, 400, 7), (0, 1)),
        (written(1, 400, 8), (0, 1)),
        (written(2, 399, 8), (1, 0)),
    ],
    ids=["another block", "the same sequence", "the same transaction", "one register too early"],
)
def test_the_check_counts_writes_elsewhere_and_blocks_that_come_twice(row: RequestRow, count: tuple[int, int]) -> None:
    rows = (written(1, 400, 7), row)
    assert (outside(PlcRecording((), (), rows, (), (), 0, 0)), repeated(rows)) == count
    assert outside(PlcRecording((), (), (written(3, 400, 9, function=6),), (), (), 0, 0)) == 1


def test_a_block_comes_again_after_a_refusal_that_says_that_nothing_was_done_and_after_no_other() -> None:
    """Modbus V1.1b3, section 7, on exception 6; what any other exception had done is not known."""
    taken = written(3, 400, 7)
    assert repeated((written(1, 400, 7, exception=6), written(2, 400, 7, exception=6), taken)) == 0
    assert repeated((written(1, 400, 7, exception=4), taken)) == 1
    assert repeated((written(1, 400, 7), written(2, 400, 7, exception=6), taken)) == 1
    assert repeated((written(3, 400, 7, exception=6), taken)) == 1, "its transaction may not"
