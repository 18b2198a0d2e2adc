"""Under every fault of the PLC: no wrong value is good, nothing is written elsewhere or twice, and all comes back."""

import struct
from pathlib import Path

import pytest

from benchmarks.fault_matrix import FAULTS, OUTAGES, TOLERATED, Matrix, Row, judged_row, measure, outside, repeated
from drivers.tag import Quality, Sample
from sim.plc.program.faults import FAULTS as KINDS
from sim.plc.program.faults import ONLY_AT
from sim.plc.record.recording import PlcRecording, RequestRow
from tests.rig.pair import MAP

GROUPS: dict[str, tuple[str, ...]] = {
    "absence": ("refuse", "silent", "half_open", "restart", "reset in mid-frame", "frozen image", "illegal register"),
    "replies": (
        "late reply",
        "late reply, now and then",
        "wrong unit",
        "wrong function",
        "too few registers",
        "too many registers",
        "wrong byte count",
    ),
    "content": (
        "wrong transaction",
        "exception 4",
        "exception 6 (busy)",
        "garbage",
        "split reply",
        "duplicate reply",
        "write ignored",
    ),
}
_GROUPED = {name for names in GROUPS.values() for name in names}
if others := tuple(name for name in FAULTS if name not in _GROUPED):
    GROUPS["others"] = others
BY_CHANCE = ("late reply, now and then",)
ONLY_WRITES = ("write ignored",)
MOMENTS = ("half_open",)
"""A connection goes deaf once; where a block is what meets it, a new one may serve all readings."""


def test_every_fault_of_the_software_plc_is_in_the_matrix_and_every_row_is_tested() -> None:
    assert {fault["kind"] for fault in FAULTS.values()} == set(KINDS) - set(ONLY_AT)
    assert sorted(name for names in GROUPS.values() for name in names) == sorted(FAULTS)


@pytest.mark.slow
@pytest.mark.parametrize("group", GROUPS)
def test_no_wrong_value_is_good_and_nothing_is_written_elsewhere_or_twice(group: str, tmp_path: Path) -> None:
    matrix = measure(tmp_path, {name: FAULTS[name] for name in GROUPS[group]})
    assert matrix.examples == ()
    assert (matrix.outside, matrix.repeated, matrix.missing, matrix.failures) == (0, 0, 0, 0)
    assert matrix.blocks > 20 and matrix.refusals == {}
    for row in matrix.rows:
        assert row.judged > 0 and row.wrong_good == 0, row
        assert_noticed(row)
        if row.fault in OUTAGES:
            assert row.recovered_s is not None and row.recovered_s < 1.0, row


def assert_noticed(row: Row) -> None:
    """A fault that takes values away is seen; one that does not costs nothing."""
    if row.fault in TOLERATED:
        assert (row.detected_s, row.not_good, row.unconfirmed) == (None, {}, 0), row
    elif row.fault in ONLY_WRITES:
        assert row.not_good == {} and row.unconfirmed > 0, row
    elif row.fault == "illegal register":
        assert set(row.not_good) == {"LivelloVibrazioni"}, "its neighbours in the block must stay good"
    elif row.fault in MOMENTS:
        assert row.detected_s is not None, row
    elif row.fault not in BY_CHANCE:
        assert row.detected_s is not None and row.not_good, row


def test_the_judge_finds_the_wrong_values_of_a_gateway_that_does_not_watch_the_heartbeat(tmp_path: Path) -> None:
    """The control: without the rule that decision 0006 makes, the same run has wrong good values."""
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


def written(transaction: int, address: int, sequence: int, function: int = 16) -> RequestRow:
    """A write of 24 words as the PLC records it."""
    words = (1, sequence, *range(22))
    pdu = struct.pack(">BHHB24H", function, address, 24, 48, *words)
    place = (1.0, 1.0, "peer", transaction, 1, function, address, 24)
    return RequestRow(*place, pdu=pdu, reply=None, exception=None, delay_s=0.0, faults=(), version=1)


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
