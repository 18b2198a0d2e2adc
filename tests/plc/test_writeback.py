"""The PLC's side of the write-back contract, judged with blocks that the tests build themselves."""

import pytest

from sim.plc.program import writeback
from sim.plc.program.clock import EmulatorClock
from sim.plc.program.pdu import ModbusRequest
from sim.plc.program.plc import Plc
from sim.plc.program.registers import read_map
from tests.plc.bench import BLOCK, DECANTER, block, crc

REGISTERS = read_map(DECANTER)


@pytest.fixture
def plc() -> Plc:
    plc = Plc(REGISTERS, EmulatorClock(0.0, 0.0, monotonic=lambda: 0.0))
    plc.begin(0.0)
    return plc


def tell(plc: Plc, words: list[int], now: float, address: int = BLOCK) -> dict[str, object]:
    """Write a block and let the program run a cycle; the status tags afterwards."""
    head = bytes((16,)) + address.to_bytes(2, "big") + len(words).to_bytes(2, "big") + bytes((2 * len(words),))
    reply = plc.exchange(ModbusRequest("test", 1, 1, head + b"".join(word.to_bytes(2, "big") for word in words)), now)
    assert reply is not None and reply.pdu[0] == 16
    plc.cycle(now)
    return dict(plc.image.truth)


def test_the_checksum_is_the_catalogues() -> None:
    digits = b"12345678"
    words = [int.from_bytes(digits[index : index + 2], "big") for index in range(0, 8, 2)]
    assert writeback.crc16(words) == crc(words)
    assert writeback.crc16([0x3132, 0x3334, 0x3536, 0x3738]) == 0xA12B
    assert crc([]) == writeback.crc16([]) == 0xFFFF


def test_a_whole_new_block_is_accepted_and_decoded(plc: Plc) -> None:
    status = tell(plc, block(1, 1), 0.0)
    assert (status["BlocksAccepted"], status["BlocksRefused"], status["LastRefusal"]) == (1, 0, 0)
    assert status["PredictionUsable"] is True
    assert plc.intake.block["temperature_now"] == pytest.approx(45.12)
    assert plc.intake.block["location"] == 2


def test_signed_fields_go_below_zero(plc: Plc) -> None:
    tell(plc, block(1, 1, temperature=0x10000 - 250), 0.0)
    assert plc.intake.block["temperature_now"] == pytest.approx(-2.5)


def changed(words: list[int], index: int, value: int) -> list[int]:
    return [*words[:index], value, *words[index + 1 :]]


@pytest.mark.parametrize(
    ("words", "address", "code"),
    [
        (block(2, 2, version=9), BLOCK, 1),
        (changed(block(2, 2), 25, 3), BLOCK, 2),
        (changed(block(2, 2), 7, 4513), BLOCK, 3),
        (block(2, 1), BLOCK, 4),
        (block(2, 2)[:-1], BLOCK, 5),
        (block(2, 2)[1:], BLOCK + 1, 5),
        ([7], BLOCK + 5, 5),
    ],
)
def test_a_bad_block_is_refused_with_the_labels_number(plc: Plc, words: list[int], address: int, code: int) -> None:
    tell(plc, block(1, 1), 0.0)
    status = tell(plc, words, 0.1, address)
    assert (status["BlocksAccepted"], status["BlocksRefused"], status["LastRefusal"]) == (1, 1, code)
    assert plc.intake.block["sequence"] == 1
    assert tell(plc, block(3, 3), 0.2)["BlocksAccepted"] == 2


def test_the_watchdog_runs_out_unless_a_block_with_a_new_heartbeat_is_accepted(plc: Plc) -> None:
    tell(plc, block(1, 1), 0.0)
    assert tell(plc, block(2, 1), 4.0)["PredictionUsable"] is True  # refused: its heartbeat stood still
    plc.cycle(5.0)
    assert plc.image.truth["PredictionUsable"] is True
    plc.cycle(5.001)
    assert plc.image.truth["PredictionUsable"] is False
    # Of two blocks each has every second number for its challenges.
    assert tell(plc, block(3, 2, challenge=3), 6.0)["PredictionUsable"] is True


def test_validity_zero_and_a_withdrawn_permit_make_it_unusable_at_once(plc: Plc) -> None:
    assert tell(plc, block(1, 1, validity=0b1110), 0.0)["PredictionUsable"] is False
    assert tell(plc, block(2, 2, validity=0b0001), 0.1)["PredictionUsable"] is True
    plc.permit = False
    plc.cycle(0.2)
    assert plc.image.truth["PredictionUsable"] is False
    assert plc.image.truth["WritePermit"] is False


def test_the_counters_are_words_and_wrap() -> None:
    intake = writeback.Intake(accepted=65_537, refused=65_536)
    values = writeback.status(REGISTERS, intake, 0.0, permit=True, acknowledged=0)
    assert (values["BlocksAccepted"], values["BlocksRefused"]) == (1, 0)
