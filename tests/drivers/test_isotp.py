"""ISO-TP as a listener hears it: whole payloads or none."""

import time

import isotp as can_isotp
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.vehicle.isotp import N_CR, Reassembler
from tests.drivers.can_frames import isotp

PAYLOADS = st.integers(1, 4095).flatmap(lambda size: st.binary(min_size=size, max_size=size))


def heard(frames: list[bytes], reassembler: Reassembler | None = None, step: float = 0.001) -> list[bytes]:
    listener = reassembler or Reassembler()
    return [
        payload for number, data in enumerate(frames) if (payload := listener.take(number * step, data)) is not None
    ]


@settings(max_examples=60)
@given(PAYLOADS)
def test_a_payload_of_any_size_comes_back_whole(payload: bytes) -> None:
    assert heard(isotp(payload)) == [payload]


@settings(max_examples=150)
@given(st.integers(8, 4095), st.data())
def test_with_any_frames_lost_there_is_never_a_wrong_payload(size: int, data: st.DataObject) -> None:
    payload = bytes(number * 37 % 251 for number in range(size))
    frames = isotp(payload)
    lost = data.draw(st.sets(st.integers(0, len(frames) - 1), min_size=1, max_size=20))
    kept = [frame for number, frame in enumerate(frames) if number not in lost]
    assert heard(kept) == []


@settings(max_examples=80)
@given(st.lists(st.integers(0, 300), min_size=2, max_size=40), st.randoms(use_true_random=False))
def test_frames_doubled_or_out_of_order_never_give_a_wrong_payload(swaps: list[int], random: object) -> None:
    payload = bytes(number * 37 % 251 for number in range(1000))
    frames = isotp(payload)
    for place in swaps:
        index = place % (len(frames) - 1)
        frames[index], frames[index + 1] = frames[index + 1], frames[index]
    doubled = [*frames[:30], frames[29], *frames[30:]]
    assert all(made == payload for made in heard(doubled))


@settings(max_examples=100)
@given(st.lists(st.binary(max_size=8), max_size=200))
def test_noise_is_counted_and_never_raises(frames: list[bytes]) -> None:
    reassembler = Reassembler()
    for payload in heard(frames, reassembler):
        assert 1 <= len(payload) <= 4095
    assert all(count >= 0 for count in reassembler.counts.values())


@pytest.mark.parametrize("size", [8, 62, 500, 4095])
def test_frames_of_another_implementation_are_understood(size: int) -> None:
    payload = bytes(number * 7 % 256 for number in range(size))
    sent: list[bytes] = []
    waiting: list[can_isotp.CanMessage] = []

    def put(message: can_isotp.CanMessage) -> None:
        sent.append(bytes(message.data))
        if message.data[0] >> 4 == 1:
            waiting.append(can_isotp.CanMessage(arbitration_id=0x7E0, data=bytearray(b"\x30\0\0\0\0\0\0\0")))

    address = can_isotp.Address(can_isotp.AddressingMode.Normal_11bits, txid=0x7E8, rxid=0x7E0)
    layer = can_isotp.TransportLayerLogic(
        rxfn=lambda _timeout: waiting.pop() if waiting else None, txfn=put, address=address, params={"tx_padding": 0}
    )
    layer.send(payload)
    end = time.monotonic() + 120
    while layer.transmitting() and time.monotonic() < end:
        layer.process()
    assert heard(sent) == [payload]


def test_a_message_that_stops_is_dropped_and_the_next_one_is_whole() -> None:
    reassembler = Reassembler()
    frames = isotp(bytes(100))
    for number, data in enumerate(frames[:5]):
        assert reassembler.take(number * 0.01, data) is None
    assert reassembler.take(0.05 + N_CR, frames[5]) is None
    assert reassembler.counts["late"] == 1
    assert heard(isotp(b"x" * 50), reassembler) == [b"x" * 50]


def test_a_message_in_place_of_the_rest_of_another_is_given_and_the_other_is_not() -> None:
    reassembler = Reassembler()
    assert heard([*isotp(bytes(100))[:5], *isotp(b"short")], reassembler) == [b"short"]
    assert reassembler.counts["replaced"] == 1


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x00",
        b"\x08" + bytes(7),
        b"\x03\x41",
        b"\x10\x07" + bytes(6),
        b"\x10\x00" + bytes(6),
        b"\x10\x20\x41",
        b"\x40",
    ],
    ids=[
        "empty",
        "length 0",
        "length 8",
        "cut",
        "first frame of 7",
        "32-bit length",
        "cut first frame",
        "unknown kind",
    ],
)
def test_what_is_no_frame_of_the_protocol_is_malformed(data: bytes) -> None:
    reassembler = Reassembler()
    assert reassembler.take(0.0, data) is None
    assert reassembler.counts["malformed"] == 1
