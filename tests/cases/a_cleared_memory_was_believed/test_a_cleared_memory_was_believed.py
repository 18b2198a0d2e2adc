"""What a PLC said from the memory that its restart had cleared was good as soon as its program counted again.

A bus brings what the PLC says by itself: every message once a period, and when its content changes. One whose content
is the cleared memory's, too, is not said anew when the program runs. Times are in scan periods.
"""

import random
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import pytest

from drivers.tag import Quality, Sample, Tag
from gateway.machine.reading.quality import STALE_PERIODS, DeviceAge, QualityRules, judge
from sim.plc.program.clock import EmulatorClock
from sim.plc.record.judge import wrong_good
from sim.plc.record.recording import PlcRecording, Run, TruthRow

BEAT, VALUE = Tag("beat", "0x1:0|16"), Tag("value", "0x2:0|16")
CYCLE, BEATS_EVERY, SAID_EVERY, HELD_FOR = 0.1, 0.2, 1.5, 4.5
"""The program's cycle, how often its two messages are said, and for how long the last one counts."""
LIVED, SCANS = 30.0, 900
RULES = QualityRules(1.0, BEAT.name)


@dataclass(frozen=True, slots=True)
class State:
    """What the PLC holds from `time` on, and what of it is true; `speaks` False: nothing is on the bus."""

    time: float
    count: int
    value: int
    truth: int | None
    speaks: bool = True


def lives(rng: random.Random, *, shows_zero: bool) -> Iterator[State]:
    """Programs that run, stop, are silent, show a cleared memory, and run again with a value of 0 for a while.

    Without `shows_zero` the count is not told while the memory is cleared: nothing but the silence tells of it.
    """
    now = 0.0
    while now < SCANS:
        begun, count = now, 0
        starts = now + rng.uniform(2.0, 8.0)
        while now < begun + LIVED * rng.uniform(0.5, 1.5):
            count, now = count + 1, now + CYCLE
            value = int(max(0.0, now - starts))
            yield State(now, count, value, value)
        yield State(now := now + CYCLE, 0, 0, None, speaks=False)
        cleared, now = now + rng.uniform(3.0, 8.0), now + rng.uniform(9.0, 16.0)
        yield State(cleared, 0 if shows_zero else -1, 0, None)


def said(states: list[State]) -> Iterator[tuple[float, Tag, int]]:
    """The messages of the states: moment, tag and content."""
    due = {BEAT.name: 0.0, VALUE.name: 0.0}
    last = dict.fromkeys(due, -1)
    for state, after in pairwise(states):
        moment = state.time
        while moment < after.time and state.speaks:
            for tag, content, every in ((BEAT, state.count, BEATS_EVERY), (VALUE, state.value, SAID_EVERY)):
                if content >= 0 and (content != last[tag.name] or moment >= due[tag.name]):
                    last[tag.name], due[tag.name] = content, moment + every
                    yield moment, tag, content
            moment += CYCLE / 2


def judged(seed: int, *, shows_zero: bool) -> tuple[int, list[str]]:
    """How many readings of the value were good, and which of them the judge finds wrong."""
    rng = random.Random(seed)
    states = list(lives(rng, shows_zero=shows_zero))
    coming = list(said(states))
    heard: dict[str, Sample] = {}
    age, good, at = DeviceAge(), [], 0
    for scan in range(SCANS):
        now = scan + rng.uniform(0.0, 0.3)
        while at < len(coming) and coming[at][0] <= now:
            moment, tag, content = coming[at]
            heard[tag.name] = Sample(tag.name, content, Quality.GOOD, moment)
            at += 1
        read = [
            sample
            if (sample := heard.get(tag.name)) is not None and now - sample.time <= HELD_FOR
            else Sample(tag.name, None, Quality.TIMEOUT, now)
            for tag in (BEAT, VALUE)
        ]
        age, samples = judge(age, (BEAT, VALUE), read, now, RULES)
        good += [samples[VALUE.name]] if samples[VALUE.name].quality.is_good else []
    truth = tuple(TruthRow(one.time, one.time, number, VALUE.name, one.truth) for number, one in enumerate(states))
    run = Run(EmulatorClock(0.0, 0.0), "plc", None, 0, {})
    wrong = wrong_good(PlcRecording((run,), truth, (), (), (), 0, 0), good, STALE_PERIODS + HELD_FOR)
    return len(good), [f"{one.sample.time:.2f}: {one.reason}" for one in wrong]


@pytest.mark.parametrize("shows_zero", [True, False], ids=["count 0", "silence"])
def test_what_was_said_before_the_program_counts_again_is_not_good(*, shows_zero: bool) -> None:
    outcomes = [judged(seed, shows_zero=shows_zero) for seed in range(10)]
    assert all(good > SCANS / 3 for good, _ in outcomes)
    assert [wrong for _, wrong in outcomes if wrong] == []


def walk(*scans: tuple[float, int | None, float]) -> list[Quality]:
    """What a value is worth at each scan: its moment, the count read then (None: none came), and the value's stamp."""
    age, qualities = DeviceAge(), []
    for now, count, stamp in scans:
        quality = Quality.TIMEOUT if count is None else Quality.GOOD
        read = [Sample(BEAT.name, count, quality, now), Sample(VALUE.name, 7, Quality.GOOD, stamp)]
        age, samples = judge(age, (BEAT, VALUE), read, now, RULES)
        qualities.append(samples[VALUE.name].quality)
    return qualities


GOOD, UNCERTAIN = Quality.GOOD, Quality.UNCERTAIN
LIVING = [(0.0, 1, 0.0), (1.0, 2, 1.0), (2.0, 3, 1.9)]


def test_after_a_restart_a_value_counts_when_it_is_said_anew() -> None:
    restarted = [(3.0, 0, 2.5), (4.0, 1, 2.5), (5.0, 2, 2.5), (6.0, 3, 2.5), (7.0, 4, 6.5)]
    assert walk(*LIVING, *restarted)[-3:] == [UNCERTAIN, UNCERTAIN, GOOD]
    # Also one that was said before the restart, and one that was said in the first cycle after it.
    assert walk(*LIVING, (3.0, 0, 1.9), (4.0, 1, 1.9), (5.0, 2, 1.9))[-1] is UNCERTAIN
    assert walk(*LIVING, (3.0, 0, 1.9), (4.0, 1, 1.9), (5.0, 2, 4.0), (6.0, 3, 5.0))[-2:] == [UNCERTAIN, GOOD]


def test_what_was_said_in_a_silence_stays_doubtful_over_the_next_one() -> None:
    silent = [(float(now), None, 2.5) for now in range(3, 8)]
    again = [(float(now), None, 2.5) for now in range(11, 17)]
    scans = [*LIVING, *silent, (8.0, 9, 2.5), (9.0, 10, 2.5), (10.0, 11, 2.5), *again, (17.0, 20, 2.5), (18.0, 21, 2.5)]
    qualities = walk(*scans)
    assert GOOD not in qualities[len(LIVING) + 2 :], "it was good as long as the count that it followed"
    assert qualities[-1] is UNCERTAIN
    # What was said before it, while the count was known to live, is what the device has said last.
    assert walk(*LIVING, *((now, None, 1.9) for now in (3.0, 4.0, 5.0, 6.0)), (7.0, 9, 1.9), (8.0, 10, 1.9))[-1] is GOOD


def test_a_gateway_that_begins_or_scans_late_doubts_nothing() -> None:
    assert walk((5.0, 1, 4.0), (6.0, 2, 4.0))[-1] is GOOD
    assert walk(*LIVING, (9.0, 60, 5.0), (10.0, 70, 5.0))[-1] is GOOD
    assert walk(*LIVING, (3.0, 3, 2.5), (4.0, 4, 2.5))[-1] is GOOD, "a count that stands for two periods lives"
