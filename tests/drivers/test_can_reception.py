"""What counts as a reading on a CAN bus: lengths, layouts, checksums, counters and age; and the controller's state."""

import random

import pytest

from drivers.can.bus.load import BusLoad, frame_bits
from drivers.can.errors_on_bus import BusErrors, ControllerState
from drivers.can.fields import Bits, LayoutCondition
from drivers.can.frame import CanFrame
from drivers.can.protection import Count, Protection, check_frame, crc, protect_frame
from drivers.can.reception import Channel, MessageRules, Reception, Slot
from drivers.tag import Quality

GUARD = Protection(0x1234)
KEY = 0x181


def listening(rules: MessageRules, timeout: float = 1.0, page: int | None = None) -> tuple[Reception, Channel, Slot]:
    reception = Reception()
    reception.restart(0.0)
    conditions = () if page is None else (LayoutCondition(Bits(0, 8), frozenset({page})),)
    return reception, *reception.listen(rules, conditions, timeout, 0.0)


def frame(data: bytes, time: float = 0.0) -> CanFrame:
    return CanFrame(time, KEY, False, data)


def quality(reception: Reception, channel: Channel, slot: Slot, now: float) -> Quality | None:
    missing = reception.absence(channel, slot, now)
    return None if missing is None else missing[0]


def test_a_message_is_awaited_then_missing_then_there_then_too_old() -> None:
    reception, channel, slot = listening(MessageRules(KEY, "Speed"))
    assert quality(reception, channel, slot, 0.5) is Quality.WAITING_FOR_INITIAL_DATA
    assert quality(reception, channel, slot, 1.5) is Quality.TIMEOUT
    reception.take(KEY, frame(b"\1"), 2.0)
    assert quality(reception, channel, slot, 3.0) is None
    assert reception.absence(channel, slot, 3.25) == (Quality.TIMEOUT, "no frame Speed for 1.25 s (limit 1 s)")


def test_each_layout_of_a_multiplexed_message_has_an_age_of_its_own() -> None:
    reception, channel, first = listening(MessageRules(KEY, "Pages"), page=0)
    _, second = reception.listen(MessageRules(KEY, "Pages"), (LayoutCondition(Bits(0, 8), frozenset({1})),), 1.0, 0.0)
    reception.take(KEY, frame(b"\0\5"), 0.1)
    assert quality(reception, channel, first, 0.2) is None
    assert quality(reception, channel, second, 0.2) is Quality.WAITING_FOR_INITIAL_DATA
    reception.take(KEY, frame(b"\1\6"), 1.0)
    assert quality(reception, channel, first, 1.5) is Quality.TIMEOUT
    assert quality(reception, channel, second, 1.5) is None


def test_a_frame_of_another_length_is_no_reading_and_is_named_once_the_last_one_is_too_old() -> None:
    reception, channel, slot = listening(MessageRules(KEY, "Speed", length=2))
    reception.take(KEY, frame(b"\1\2"), 0.0)
    for moment in (0.5, 0.9, 1.5):
        assert not reception.take(KEY, frame(b"\1"), moment)
    assert quality(reception, channel, slot, 0.9) is None
    assert reception.absence(channel, slot, 1.5) == (
        Quality.DECODING_ERROR,
        "frame Speed cannot be used: it has 1 bytes, not 2",
    )
    assert reception.counts["refused"] == 3


def test_what_was_heard_before_a_new_connection_counts_no_more() -> None:
    reception, channel, slot = listening(MessageRules(KEY, "Speed"))
    reception.take(KEY, frame(b"\1"), 0.0)
    reception.restart(0.1)
    assert quality(reception, channel, slot, 0.2) is Quality.WAITING_FOR_INITIAL_DATA


# ---------------------------------------------------------------- protection


def test_the_checksum_is_that_of_the_profiles_published_example() -> None:
    # AUTOSAR E2E profile 5: data id 0x1234, eight bytes, all zero, as an independent Python library (e2e) has it.
    assert protect_frame(GUARD, 0, bytes(8)).hex() == "1cca000000000000"
    assert protect_frame(GUARD, 1, bytes(8)).hex() == "cf8d010000000000"


def test_frames_in_sequence_are_used_with_gaps_and_over_the_wrap() -> None:
    last: Count | None = None
    for counter in (250, 251, 253, 0, 9, 10):
        last, problem = check_frame(GUARD, last, protect_frame(GUARD, counter, bytes(8)))
        assert problem == ""


def test_a_repeated_frame_is_no_reading() -> None:
    last, _ = check_frame(GUARD, None, protect_frame(GUARD, 7, bytes(8)))
    assert check_frame(GUARD, last, protect_frame(GUARD, 7, bytes(8))) == (last, "its counter has not moved on")


def test_after_a_jump_frames_must_follow_it_before_one_is_used() -> None:
    last, _ = check_frame(GUARD, None, protect_frame(GUARD, 7, bytes(8)))
    problems = []
    for counter in (100, 101, 102, 103):
        last, problem = check_frame(GUARD, last, protect_frame(GUARD, counter, bytes(8)))
        problems.append(bool(problem))
    assert problems == [True, True, False, False]


def test_two_old_frames_repeated_in_turn_are_never_used() -> None:
    old = [protect_frame(GUARD, counter, bytes(8)) for counter in (7, 8)]
    last: Count | None = Count(8)
    for place in range(20):
        last, problem = check_frame(GUARD, last, old[place % 2])
        assert problem


def test_of_random_payloads_as_good_as_none_has_the_checksum_and_none_is_used() -> None:
    rng = random.Random(1)
    last: Count | None = Count(0)
    used = 0
    for _ in range(20_000):
        last, problem = check_frame(GUARD, last, rng.randbytes(8))
        used += not problem
    assert used == 0


def test_a_wrong_bit_anywhere_or_another_messages_frame_is_found() -> None:
    data = protect_frame(GUARD, 5, b"abcdefgh")
    for bit in range(8 * len(data)):
        wrong = (int.from_bytes(data, "big") ^ 1 << bit).to_bytes(len(data), "big")
        assert check_frame(GUARD, Count(4), wrong)[1]
    assert check_frame(Protection(0x1235), Count(4), data)[1] == "its CRC is wrong"
    assert check_frame(GUARD, Count(4), b"\1\2")[1].startswith("it has 2 bytes")
    assert crc(GUARD, data) == int.from_bytes(data[:2], "little")


# ---------------------------------------------------------------- the controller and the load


def test_error_frames_move_the_controller_through_its_states() -> None:
    errors = BusErrors()
    seen = []
    for classes, flags in ((0x04, 0x04), (0x04, 0x10), (0x04, 0x20), (0x40, 0), (0x40, 0), (0x100, 0)):
        errors.take(classes, bytes((0, flags, 0, 0, 0, 0, 130, 7)))
        seen.append(errors.state)
    assert seen == [ControllerState(name) for name in ("warning", "passive", "passive", "bus-off", "bus-off", "active")]
    assert errors.counts["bus_off"] == 1
    assert errors.counts["passive"] == 1
    assert errors.counts["error_frames"] == 6


def test_error_counters_overruns_and_missing_acknowledges_are_counted() -> None:
    errors = BusErrors()
    errors.take(0x204, bytes((0, 0x01, 0, 0, 0, 0, 96, 12)))
    errors.take(0x20, bytes(8))
    errors.take(0x88, b"")
    assert (errors.transmit_errors, errors.receive_errors) == (96, 12)
    assert [errors.counts[name] for name in ("overruns", "no_acknowledge", "bus_errors")] == [1, 1, 1]


@pytest.mark.parametrize(("length", "extended", "bits"), [(8, False, 135), (8, True, 160), (0, False, 55)])
def test_a_frames_bits_are_the_worst_case_of_the_literature(length: int, extended: bool, bits: int) -> None:
    assert frame_bits(length, extended=extended) == bits


def test_the_bus_load_is_that_of_the_last_full_second() -> None:
    load = BusLoad(125_000)
    for place in range(1001):
        load.add(8, extended=False, now=10.0 + place / 500)
    assert load.percent(12.1) == pytest.approx(500 * 135 / 1250, rel=0.01)
    assert load.percent(14.0) < 0.1
    assert load.peak == pytest.approx(500 * 135 / 1250, rel=0.01)
