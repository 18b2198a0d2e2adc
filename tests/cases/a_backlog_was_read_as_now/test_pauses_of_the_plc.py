"""A software PLC that stands still between stamping what is true and publishing it makes no good reading wrong.

It was suspected of three wrong values in a demonstration on a busy machine. Its program and its faces are one thread:
while it stands still it answers nothing and counts no heartbeat on, and three periods later nothing is good (the judge
allows four). Pauses of 0 to 40 periods at drawn places, of the PLC and of the gateway; times are in periods.
"""

import random
from dataclasses import dataclass, field

import pytest

from drivers.tag import Quality, Sample, Tag
from gateway.machine.reading.quality import STALE_PERIODS, DeviceAge, QualityRules, judge
from sim.plc.program.clock import EmulatorClock
from sim.plc.record.judge import wrong_good
from sim.plc.record.recording import PlcRecording, Run, TruthRow

TAGS = (Tag("beat", "holding:0"), Tag("value", "holding:1"))
CYCLE, TOLERANCE = 0.5, STALE_PERIODS + 1.0
SCANS = 400


@dataclass
class Timeline:
    """Cycles: the moment that each was stamped with, and until when it was not yet published."""

    rng: random.Random
    stamps: list[tuple[float, float]] = field(default_factory=list)

    def go_on(self, until: float) -> None:
        while not self.stamps or self.stamps[-1][1] <= until:
            begin = self.stamps[-1][1] + CYCLE if self.stamps else 0.0
            self.stamps.append((begin, begin + pause(self.rng, 0.05)))

    def answered(self, asked: float) -> tuple[float, int]:
        """When a request is answered, and from which cycle: none while the thread stands still."""
        self.go_on(asked)
        for number, (stamp, published) in enumerate(self.stamps):
            if stamp <= asked < published:
                return published, number
            if stamp > asked:
                return asked, number - 1
        return asked, len(self.stamps) - 1


def pause(rng: random.Random, share: float) -> float:
    return float(rng.uniform(0.0, 40.0) ** rng.random()) if rng.random() < share else 0.001


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("heartbeat", ["beat", None])
def test_no_pause_between_stamping_and_publishing_makes_a_good_reading_wrong(seed: int, heartbeat: str | None) -> None:
    rng = random.Random(seed)
    plc, age, now, good, late = Timeline(rng), DeviceAge(), 0.0, list[Sample](), 0
    rules = QualityRules(1.0, heartbeat)
    for _ in range(SCANS):
        read = []
        for tag in rng.sample(TAGS, 2):
            sent = now + 0.001
            moment, cycle = plc.answered(sent + pause(rng, 0.02))
            now = moment + pause(rng, 0.02)
            read.append(Sample(tag.name, cycle + 1, Quality.GOOD, now, sent))
        now += pause(rng, 0.02)
        age, judged = judge(age, TAGS, read, now, rules)
        # As the demonstration is judged: at the scan, whatever the moment of asking was.
        good += [Sample(one.tag, one.value, one.quality, now, now) for one in judged.values() if one.quality.is_good]
        late += sum("asked for" in one.reason for one in judged.values())
        now = float(int(now) + 1)
    truth = tuple(
        TruthRow(stamp, stamp, number, tag.name, number + 1)
        for tag in TAGS
        for number, (stamp, _) in enumerate(plc.stamps)
    )
    run = Run(EmulatorClock(0.0, 0.0), "decanter", None, 0, {})
    recording = PlcRecording((run,), truth, (), (), (), 0, 0)
    assert len(good) > SCANS / 4
    wrong = wrong_good(recording, good, TOLERANCE)
    # Without a heartbeat nothing else tells of an answer that was long on its way: the pauses are enough to show it.
    assert not wrong and (late > 0 or heartbeat is not None), wrong[:3]
