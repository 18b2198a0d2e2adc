"""Whether two links lead to the same PLC: its heartbeat must be the same count at the same time on both (pure)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from statistics import median

from drivers.tag import Sample

COUNTER_MODULUS = 0xFFFF
"""The heartbeat counts 1..65535 and round to 1."""
MAX_KEPT_BEATS = 16
"""Readings of the heartbeat that its rate is taken from."""
STILL_PERIODS = 1.5
"""Heartbeat periods without a change after which a link is left, before its readings stop being good (at 2.5)."""
COUNT_TOLERANCE = 2.0
"""Counts by which two readings may differ beside what time explains: each may lie just before or after a beat."""
RATE_MARGIN = 1.5
"""How much faster than its mean rate the heartbeat may run for a while."""


@dataclass(frozen=True, slots=True)
class Beat:
    """One reading of the heartbeat: the count, and the earliest and latest moment at which it may have stood."""

    count: int
    earliest: float
    latest: float


@dataclass(frozen=True, slots=True)
class Pulse:
    """A link's last heartbeats, oldest first, when the count was last seen to change, and when it was last read."""

    beats: Sequence[Beat] = ()
    changed: float | None = None
    read: float = 0.0


def with_beat(pulse: Pulse, sample: Sample | None) -> Pulse:
    """The pulse after one more reading of the heartbeat; what is not good says nothing."""
    if sample is None or not sample.quality.is_good or not isinstance(sample.value, int):
        return pulse
    beat = Beat(int(sample.value), sample.time if sample.sent is None else sample.sent, sample.time)
    if pulse.beats and beat.latest <= pulse.beats[-1].latest:
        return pulse
    if beat.count == 0 or (pulse.beats and pulse.beats[-1].count == 0):
        return Pulse((beat,), beat.latest, beat.latest)  # the program stands or has just begun anew: its count too
    if pulse.beats and beat.count == pulse.beats[-1].count:
        return replace(pulse, read=beat.latest)
    return Pulse((*pulse.beats, beat)[-MAX_KEPT_BEATS:], beat.latest if pulse.beats else None, beat.latest)


def still(pulse: Pulse, beat_period: float) -> bool:
    """True if the count had not changed for too long when it was last read, or is 0: the program does not run."""
    if pulse.changed is None:
        return False
    return pulse.beats[-1].count == 0 or pulse.read - pulse.changed > STILL_PERIODS * beat_period


def rate(pulse: Pulse) -> float:
    """Counts a second, the median over the readings that are kept; 0 with fewer than two."""
    steps = [((b.count - a.count) % COUNTER_MODULUS) / (b.latest - a.latest) for a, b in pairwise(pulse.beats)]
    return median(steps) if steps else 0.0


def agree(pulse: Pulse, other: Pulse) -> bool | None:
    """Whether the newest readings of two links can be of one heartbeat; None while too little is known.

    Between the two readings the count may have moved by the heartbeat's rate times the time from the earliest to the
    latest moment of both, in either direction.
    """
    if len(pulse.beats) < 2 or len(other.beats) < 2:
        return None
    a, b = pulse.beats[-1], other.beats[-1]
    apart = (b.count - a.count) % COUNTER_MODULUS
    distance = min(apart, COUNTER_MODULUS - apart)
    span = max(a.latest, b.latest) - min(a.earliest, b.earliest)
    return distance <= COUNT_TOLERANCE + RATE_MARGIN * max(rate(pulse), rate(other)) * span
