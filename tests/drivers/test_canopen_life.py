"""The life counter: what continues it is the node's, what jumps is a stranger's, what stands still is old."""

import random

from drivers.canopen.emergency import MAX_ACTIVE_ERRORS, Emergencies
from drivers.canopen.life import MIN_CONFIRMING_FRAMES, Life
from drivers.canopen.place import ObjectPlace
from drivers.tag import Quality

RATE = 60.0
CYCLE = 0.02


def running(count: int = 100, start: int = 1) -> tuple[Life, int, float]:
    """A life counter that has followed a node for `count` cycles; its value and moment then."""
    life = Life(ObjectPlace(0x2002, 1), RATE)
    life.anchor(start, 0.0)
    value, moment = start, 0.0
    for _ in range(count):
        value, moment = value % 0xFFFF + 1, moment + CYCLE
        assert life.own(value, 1000.0 + moment, moment)
    return life, value, moment


def test_a_node_that_counts_is_believed_through_the_rollover_and_after_a_pause() -> None:
    life, value, moment = running(200, start=0xFFFF - 50)
    later = (value + 50 * 10 - 1) % 0xFFFF + 1
    assert life.own(later, 0.0, moment + 10.0)
    assert life.strangers == 0


def test_a_frame_that_jumps_is_a_strangers_and_leaves_the_course_as_it_was() -> None:
    life, value, moment = running()
    assert not life.own(value + 5000, 0.0, moment + CYCLE)
    assert not life.own(value - 1, 0.0, moment + CYCLE)
    assert life.own(value + 1, 0.0, moment + CYCLE)
    assert life.strangers == 2


def test_random_frames_are_refused_but_for_the_few_that_guess_the_very_next_counts() -> None:
    """While strangers talk, of 65,535 counts two or three are believed."""
    life, value, moment = running()
    rng = random.Random(3)
    taken = 0
    for number in range(20_000):
        moment += CYCLE / 20
        if number % 20 == 0:
            value += 1
            assert life.own(value, 0.0, moment)
        if life.own(rng.randrange(0x10000), 0.0, moment):
            taken += 1
            life.anchor(value, moment)
    assert taken <= 4
    assert life.strangers == 20_000 - taken


def test_a_program_that_has_begun_anew_is_believed_after_a_few_frames_that_continue_one_another() -> None:
    life, _, moment = running(3000)
    answers = [life.own(1 + number, 0.0, moment + number * CYCLE) for number in range(MIN_CONFIRMING_FRAMES + 1)]
    assert answers == [False] * (MIN_CONFIRMING_FRAMES - 1) + [True, True]


def test_a_program_that_stops_and_starts_is_believed_after_a_few_frames_and_one_zero_alone_is_not() -> None:
    life, value, moment = running()
    assert [life.own(0, 0.0, moment + number * CYCLE) for number in range(4)] == [False] * (
        MIN_CONFIRMING_FRAMES - 1
    ) + [True] * 2
    assert [life.own(number, 0.0, moment + 5.0) for number in (7, 7, 8)] == [False, False, True]
    life, value, moment = running()
    assert not life.own(0, 0.0, moment)
    assert not life.own(value + 7000, 0.0, moment)
    assert life.own(value + 1, 0.0, moment + CYCLE)


def test_a_count_that_is_repeated_is_as_old_as_when_it_was_first_heard() -> None:
    life, value, moment = running()
    first = life.since
    assert first == (1000.0 + moment, moment)
    for late in (0.1, 0.5, 2.0):
        assert life.own(value, 1000.0 + moment + late, moment + late)
        assert life.since == first
    assert life.own(value + 1, 1003.0 + moment, moment + 3.0)
    assert life.since == (1003.0 + moment, moment + 3.0)


def test_emergencies_are_kept_by_code_and_never_without_bound() -> None:
    emergencies = Emergencies()
    for code in range(0x8100, 0x8100 + 10 * MAX_ACTIVE_ERRORS):
        emergencies.take(code.to_bytes(2, "little") + bytes(6))
    assert len(emergencies.active) == MAX_ACTIVE_ERRORS
    emergencies.take(b"\x00\x50\x01")
    assert emergencies.malformed == 1
    verdict = emergencies.verdict()
    assert verdict is not None and verdict[0] is Quality.UNCERTAIN
    emergencies.take(bytes(8))
    assert emergencies.verdict() is None


def test_the_worst_class_of_error_decides() -> None:
    emergencies = Emergencies(frozenset({0x6100}))
    emergencies.take(bytes.fromhex("1042010000000000"))
    emergencies.take(bytes.fromhex("0061010000000000"))
    assert emergencies.verdict() == (Quality.UNCERTAIN, "the node has announced EMCY 0x4210 (temperature)")
    emergencies.take(bytes.fromhex("3052010000000000"))
    verdict = emergencies.verdict()
    assert verdict is not None and verdict[0] is Quality.UNCERTAIN, "0x52xx is no class of CiA 301's list"
    assert any("error register 0x01" in sentence for sentence in emergencies.sentences())
