"""CANopen between three processes: no fault of the node, nor garbage on its bus, makes a wrong value good."""

from pathlib import Path

import can
import pytest

from benchmarks.canopen import BenchmarkError, garbage, latency
from benchmarks.canopen_rig import FAULTS, PERIOD, TOLERATED, canopen_rig, measure, outside, repeated
from benchmarks.fault_matrix import Matrix, reading_lost
from drivers.can.bus.hub_bus import HubBus
from sim.plc.program.faults import FAULT_FACES
from sim.plc.program.faults import FAULTS as KINDS
from sim.plc.record.recording import PlcRecording, read_recording
from tests.rig.pair import restless_trace
from tests.rig.stalls import STILL_S, TRIES, measured_again

SEEN = (
    *("missing heartbeat", "EMCY", "node reset", "restart", "node off the bus", "frozen image"),
    *("short PDO", "bus-off"),
)
PAUSE_S = 0.3
"""Between two faults: three scans in which all is well."""
LASTS_S = 0.6
"""Of faults that last a second in the measured matrix: six scans, and on a busy machine until they are seen."""
BACK_S = 1.5
"""Seconds within which good readings return, with what a busy test machine may add."""


def test_every_fault_of_a_canopen_node_is_in_the_matrix() -> None:
    own = {kind for kind, faces in FAULT_FACES.items() if "canopen" in faces}
    assert own <= {str(fault["kind"]) for fault in FAULTS.values()} <= set(KINDS)
    assert set(SEEN) <= set(FAULTS)


@pytest.fixture(scope="module")
def suffered(tmp_path_factory: pytest.TempPathFactory) -> tuple[Matrix, PlcRecording]:
    """All faults, one after the other, of one node under one gateway; and what the PLC has recorded."""
    folder = tmp_path_factory.mktemp("canopen")
    faults = {
        name: {**fault, "duration": LASTS_S} if fault.get("duration") == 1.0 else fault
        for name, fault in FAULTS.items()
    }
    # The program comes back from a restart by itself.
    held = dict.fromkeys(set(SEEN) - {"restart"}, reading_lost)

    def again(at: Path, fault: str) -> Matrix:
        return measure(at, {fault: faults[fault]}, pause=PAUSE_S, held=held)

    matrix = measure(folder, faults, pause=PAUSE_S, held=held)
    matrix = measured_again(matrix, folder, dict.fromkeys(FAULTS, BACK_S), again, TOLERATED)
    return matrix, read_recording(folder / "plc.jsonl")


@pytest.mark.timeout(1200)
def test_no_wrong_value_is_good_and_nothing_is_lost_or_written_elsewhere_or_twice(
    suffered: tuple[Matrix, PlcRecording],
) -> None:
    matrix, recording = suffered
    assert matrix.examples == ()
    assert (matrix.missing, matrix.failures) == (0, 0)
    assert matrix.blocks > 60
    assert outside(recording) == []
    assert repeated(recording) == 0


@pytest.mark.timeout(1200)
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_makes_no_wrong_value_good_and_all_comes_back(
    fault: str, suffered: tuple[Matrix, PlcRecording]
) -> None:
    (row,) = (row for row in suffered[0].rows if row.fault == fault)
    assert row.judged > 0 and row.wrong_good == 0
    assert row.recovered_s is None or row.recovered_s < BACK_S, row
    if fault in SEEN:
        assert row.detected_s is not None and row.not_good, row
    if fault in TOLERATED:
        assert not row.not_good and not row.unconfirmed, row


def test_a_gateway_that_may_not_configure_writes_nothing_but_the_block(tmp_path: Path) -> None:
    """Somebody else starts the node; the gateway neither remaps nor commands it, and works all the same."""
    rigged = canopen_rig(tmp_path, restless_trace(30.0), period=PERIOD, configure=False)
    with rigged as (rig, options), rig.plc(*options) as plc, rig.gateway(plc) as gateway:
        gateway.wait_for(lambda status: "pre-operational" in " ".join(status["complaints"]))
        gateway.wait_for(lambda status: status["alarms"]["device"] == "unacknowledged")
        _start_node(Path(plc.ready["faces"]["canopen"]["channel"]))
        gateway.wait_for(lambda status: status["writeback"].get("last_verdict") == "written")
        gateway.wait_for(lambda status: status["scan"]["early"] > 0 and status["complaints"] == [])
        assert gateway.stop()[0] == 0
    recording = read_recording(rig.recording)
    assert outside(recording) == []
    heard = [row for row in recording.frames if not row.sent and row.data]
    assert [row for row in heard if row.id == 0x000] == [row for row in heard if row.data == b"\x01\x01"][:1]
    assert not [row for row in heard if row.id == 0x601 and row.data and row.data[0] >> 5 in (1, 6)], "no SDO writes"
    assert any(row.accepted for row in recording.blocks)


def _start_node(hub: Path) -> None:
    bus = HubBus(str(hub))
    bus.send(can.Message(arbitration_id=0x000, data=b"\x01\x01", is_extended_id=False))
    bus.shutdown()


@pytest.mark.parametrize("own", [False, True], ids=["any frames", "the node's own identifiers and lengths"])
async def test_garbage_on_the_bus_makes_no_wrong_value_good(own: bool, tmp_path: Path) -> None:
    for number in range(TRIES):
        (at := tmp_path / f"try{number}").mkdir()
        heap = await garbage(at, 2000, own=own)
        # What is delivered late on a computer that stands still was true, but is older than any bus makes it.
        if heap.wrong == 0 or heap.still_s < STILL_S:
            break
    assert heap.good > 200
    # With the node's own identifiers and lengths, only who guesses the next counts of 65,535 is believed.
    believed = heap.frames - heap.refused if own else 0
    assert believed <= 3
    assert heap.wrong == 0 or believed > 0, heap.examples


def test_a_change_reaches_the_plc_as_a_prediction_long_before_the_next_scan(tmp_path: Path) -> None:
    """The scan period is a second: each of the changes is followed to the block that it made, or this fails."""
    try:
        followed = latency(tmp_path, 8, seed=2)
    except BenchmarkError as error:
        pytest.fail(str(error))
    assert len(followed.total) == 8
    assert sorted(followed.total)[4] < 500.0
