"""J1939 transport sessions: whole messages or none, and every frame accounted for."""

from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.vehicle.j1939_transport import BROADCAST, T1, T2, Key, Message, TransportSessions
from tests.drivers.can_frames import control, packets

BAM_KEY, PAIR = Key("can0", 0x00, BROADCAST), Key("can0", 0x03, 0x21)
BACK = Key("can0", 0x21, 0x03)
PGN = 0xFEE3


def filled(size: int, seed: int = 0) -> bytes:
    return bytes((number * 37 + seed) % 251 for number in range(size))


def accounted(transport: TransportSessions, taken: int) -> bool:
    return sum(count for name, count in transport.counts().items() if name.startswith("tp_")) == taken


@settings(max_examples=60)
@given(st.integers(9, 1785))
def test_a_broadcast_of_any_size_comes_back_whole(size: int) -> None:
    transport, payload = TransportSessions(), filled(size)
    transport.control(0.0, BAM_KEY, control(32, payload, PGN))
    made = [transport.packet(0.05 * (n + 1), BAM_KEY, data) for n, data in enumerate(packets(payload))]
    assert made[-1] == Message(PGN, 0, BROADCAST, payload)
    assert not any(made[:-1])
    assert transport.frames["complete"] == 1 + len(made)


@settings(max_examples=150)
@given(st.integers(9, 1785), st.data())
def test_with_any_frames_lost_there_is_no_message_and_no_frame_unaccounted_for(size: int, data: st.DataObject) -> None:
    transport, payload = TransportSessions(), filled(size)
    frames = packets(payload)
    lost = data.draw(st.sets(st.integers(-1, len(frames) - 1), min_size=1, max_size=10))
    taken = 0
    if -1 not in lost:
        transport.control(0.0, BAM_KEY, control(32, payload, PGN))
        taken += 1
    for number, frame in enumerate(frames):
        if number not in lost:
            assert transport.packet(0.01 * number, BAM_KEY, frame) is None
            taken += 1
    assert accounted(transport, taken)


@settings(max_examples=60)
@given(
    st.lists(st.tuples(st.integers(0, 5), st.integers(9, 200)), min_size=2, max_size=6, unique_by=lambda x: x[0]),
    st.data(),
)
def test_interleaved_sessions_do_not_touch_one_another(sessions: list[tuple[int, int]], data: st.DataObject) -> None:
    transport = TransportSessions()
    queues: dict[Key, list[bytes]] = {}
    wanted, got = {}, {}
    for source, size in sessions:
        key, payload = Key("can0", source, BROADCAST), filled(size, source)
        transport.control(0.0, key, control(32, payload, PGN + source))
        queues[key], wanted[source] = packets(payload), payload
    now = 0.0
    while queues:
        key = data.draw(st.sampled_from(sorted(queues)))
        now += 0.001
        message = transport.packet(now, key, queues[key].pop(0))
        if message is not None:
            got[message.source] = message.data
        if not queues[key]:
            del queues[key]
    assert got == wanted


def test_a_session_with_a_receiver_is_given_once_and_its_acknowledgement_counts_to_it() -> None:
    transport, payload = TransportSessions(), filled(30)
    frames = packets(payload)
    transport.control(0.0, PAIR, control(16, payload, PGN))
    transport.control(0.1, BACK, control(17, payload, PGN, bytes([2, 1, 0xFF, 0xFF])))
    assert [transport.packet(0.2, PAIR, frame) for frame in frames[:2]] == [None, None]
    transport.control(0.3, BACK, control(17, payload, PGN, bytes([0, 0xFF, 0xFF, 0xFF])))  # hold
    transport.control(1.3, BACK, control(17, payload, PGN, bytes([3, 3, 0xFF, 0xFF])))
    made = [transport.packet(1.4, PAIR, frame) for frame in frames[2:]]
    assert made[-1] == Message(PGN, 0x03, 0x21, payload)
    assert not any(made[:-1])
    assert transport.counts()["tp_complete"] == 9
    transport.control(1.5, BACK, control(19, payload, PGN))
    assert transport.sessions["complete"] == 1
    assert transport.frames["complete"] == 1 + 3 + 5 + 1
    assert transport.counts()["sessions_open"] == 0


def test_packets_that_the_receiver_asks_for_again_do_not_spoil_the_message() -> None:
    transport, payload = TransportSessions(), filled(30)
    frames = packets(payload)
    transport.control(0.0, PAIR, control(16, payload, PGN))
    for frame in frames[:3]:
        transport.packet(0.1, PAIR, frame)
    transport.control(0.2, BACK, control(17, payload, PGN, bytes([2, 2, 0xFF, 0xFF])))
    made = [transport.packet(0.3, PAIR, frame) for frame in frames[1:]]
    assert made[-1] == Message(PGN, 0x03, 0x21, payload)


def test_packets_that_the_receiver_has_and_we_have_not_end_the_session() -> None:
    transport, payload = TransportSessions(), filled(30)
    transport.control(0.0, PAIR, control(16, payload, PGN))
    transport.packet(0.1, PAIR, packets(payload)[0])
    transport.control(0.2, BACK, control(17, payload, PGN, bytes([2, 4, 0xFF, 0xFF])))
    assert transport.sessions["lost"] == 1
    assert accounted(transport, 3)


@pytest.mark.parametrize("side", [PAIR, BACK], ids=["sender", "receiver"])
def test_either_side_may_abort(side: Key) -> None:
    transport, payload = TransportSessions(), filled(30)
    transport.control(0.0, PAIR, control(16, payload, PGN))
    transport.packet(0.1, PAIR, packets(payload)[0])
    transport.control(0.2, side, control(255, payload, PGN, b"\x03\xff\xff\xff"))
    assert transport.sessions["aborted"] == 1
    assert transport.packet(0.3, PAIR, packets(payload)[1]) is None
    assert transport.frames["aborted"] == 3
    assert transport.frames["orphans"] == 1


@pytest.mark.parametrize(("key", "kind", "limit"), [(BAM_KEY, 32, T1), (PAIR, 16, T2)])
def test_a_session_that_stops_is_late_and_the_rest_of_it_is_of_none(key: Key, kind: int, limit: float) -> None:
    transport, payload = TransportSessions(), filled(30)
    transport.control(0.0, key, control(kind, payload, PGN))
    transport.packet(0.1, key, packets(payload)[0])
    assert transport.packet(0.1 + limit + 0.01, key, packets(payload)[1]) is None
    assert transport.sessions["late"] == 1
    assert transport.frames == transport.frames | {"late": 2, "orphans": 1}


def test_a_new_announcement_replaces_an_unfinished_session() -> None:
    transport, payload = TransportSessions(), filled(30)
    transport.control(0.0, BAM_KEY, control(32, filled(50), PGN))
    transport.packet(0.1, BAM_KEY, packets(filled(50))[0])
    transport.control(0.2, BAM_KEY, control(32, payload, PGN))
    made = [transport.packet(0.3, BAM_KEY, frame) for frame in packets(payload)]
    assert made[-1] is not None and made[-1].data == payload
    assert transport.sessions["replaced"] == 1


@pytest.mark.parametrize(
    "data",
    [
        control(32, filled(8), PGN),
        control(32, filled(30), PGN, bytes([30, 0, 4, 255])),
        control(32, filled(30), PGN, bytes([0xFF, 0xFF, 5, 255])),
        control(16, filled(30), PGN),
    ],
    ids=["too short", "packets do not fit the size", "too long", "RTS to everybody"],
)
def test_an_announcement_that_cannot_be_begins_no_session(data: bytes) -> None:
    transport = TransportSessions()
    transport.control(0.0, BAM_KEY, data)
    assert transport.counts()["sessions_open"] == 0
    assert transport.frames["malformed"] == 1


@settings(max_examples=100)
@given(
    st.lists(
        st.tuples(st.booleans(), st.integers(0, 2), st.sampled_from([0, 1, 255]), st.binary(max_size=8)), max_size=150
    )
)
def test_of_noise_every_frame_is_accounted_for(noise: Sequence[tuple[bool, int, int, bytes]]) -> None:
    transport = TransportSessions()
    for number, (is_control, source, destination, data) in enumerate(noise):
        key = Key("", source, destination)
        if is_control:
            transport.control(number * 0.1, key, data)
        else:
            transport.packet(number * 0.1, key, data)
    assert accounted(transport, len(noise))
