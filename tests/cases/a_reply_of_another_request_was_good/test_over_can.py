"""What was heard before a new connection to a bus made a reading of what came after it."""

from drivers.can.frame import CanFrame
from drivers.can.protection import Protection, protect_frame
from drivers.can.reception import MessageRules, Reception
from drivers.tag import Quality, Tag
from drivers.vehicle.isotp import Reassembler
from drivers.vehicle.j1939 import J1939Listener
from drivers.vehicle.obd import ObdListener

GUARD, KEY, PERIOD_S = Protection(0x1234), 0x181, 0.1


def test_a_frame_that_an_adapter_held_back_is_no_reading_on_the_next_connection() -> None:
    reception = Reception()
    channel, slot = reception.listen(MessageRules(KEY, "Speed", 8, GUARD), (), 3 * PERIOD_S, 0.0)

    def heard(count: int, now: float) -> bool:
        data = protect_frame(GUARD, count, bytes(8))
        return bool(reception.take(KEY, CanFrame(now, KEY, False, data), now))

    assert all(heard(count, count * PERIOD_S) for count in range(20))
    reception.restart(5.0)
    assert not heard(12, 5.0)
    missing = reception.absence(channel, slot, 5.0)
    assert missing is not None and missing[0] is Quality.DECODING_ERROR
    # The device has counted on meanwhile; the second frame that follows a jump is the first to be used.
    assert [heard(count, 5.0 + PERIOD_S * place) for place, count in enumerate((50, 51, 52, 53), start=1)] == [
        False,
        False,
        True,
        True,
    ]


def first_and_next(payload: bytes) -> tuple[bytes, bytes, bytes]:
    return b"\x10\x14" + payload[:6], b"\x21" + payload[6:13], b"\x22" + payload[13:]


ONE, OTHER = b"\x49\x02\x01" + bytes(range(1, 18)), b"\x49\x02\x01" + bytes(range(101, 118))


def test_an_isotp_message_is_not_ended_by_another_ones_frames_on_the_next_connection() -> None:
    reassembler = Reassembler()
    for frame in first_and_next(ONE)[:2]:
        assert reassembler.take(0.0, frame) is None
    reassembler.restart()
    assert reassembler.take(0.5, first_and_next(OTHER)[2]) is None
    assert [reassembler.take(0.6, frame) for frame in first_and_next(OTHER)] == [None, None, OTHER]
    assert (reassembler.counts["lost"], reassembler.counts["orphans"]) == (1, 1)


def test_nor_where_the_other_ones_first_frame_came_short() -> None:
    reassembler = Reassembler()
    first, _, last = first_and_next(OTHER)
    for frame in (*first_and_next(ONE)[:2], first[:5]):
        assert reassembler.take(0.0, frame) is None
    assert reassembler.take(0.1, last) is None


def test_the_listeners_of_a_bus_let_go_of_what_they_have_begun() -> None:
    tag = Tag("vin", "obd:vin")
    listener = ObdListener([tag])
    frames = [CanFrame(0.1, 0x7E8, False, data) for data in (*first_and_next(ONE)[:2], first_and_next(OTHER)[2])]
    for frame in frames[:2]:
        assert not listener.take(frame)
    listener.restart()
    assert not listener.take(frames[2])
    sender = J1939Listener([Tag("words", "dm1:codes")])
    begin, one, other = (
        CanFrame(0.1, 0x18ECFF00, True, bytes.fromhex("20 0e 00 02 ff ca fe 00")),
        CanFrame(0.2, 0x18EBFF00, True, b"\1" + bytes(7)),
        CanFrame(0.3, 0x18EBFF00, True, b"\2" + bytes(7)),
    )
    assert not sender.take(begin) and not sender.take(one)
    sender.restart()
    assert not sender.take(other)
    assert (sender.counts()["sessions_lost"], sender.counts()["tp_orphans"]) == (1, 1)
