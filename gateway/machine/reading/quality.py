"""What a reading is worth by the time it is used: staleness, the device's heartbeat, believable rates, frozen signals.

The promise of GOOD: the tag had this value at some moment within the last STALE_PERIODS scan periods, or periods of its
own where it has a longer one; of a device that
speaks by itself: it was the last that the device has said, and its driver has not found the device late. It is kept
thus:

- What was asked for counts from its request on: the device may have looked at its memory right after that. Where the
  reply came more than STALE_PERIODS later it is LAST_USABLE.
- A read that fails in the link is never held as good: the last good value goes on as LAST_USABLE, and after
  DEAD_PERIODS without a new one as bad, without a value. What the device itself says to be bad is bad at once.
- A device with a heartbeat must prove that its memory lives. Heartbeat 0: its program does not run, and nothing is
  good. Otherwise a scan's readings are good while its memory is known to have lived within STALE_PERIODS, LAST_USABLE
  after that. It lived after the last reading of the former count, and no later moment is known: it may have frozen
  right after that one, however late the next scan came. Of a device that speaks by itself it is the first reading of
  the former count: the new one may have waited on its way ever since. DEAD_PERIODS after the last seen change they
  are bad. Until a change from one living count to another is seen they are UNCERTAIN: the first cycle after a restart
  may still show what the memory was cleared to.
- A count vouches for nothing that was said before it while life was not proven. What is stamped in such a silence (a
  count of 0, or no new one for STALE_PERIODS), later than the last count before it and before the one that proves life
  again, is UNCERTAIN until it is said anew; after a 0 the memory was cleared, and whatever is older is UNCERTAIN too.
- The other limits are drawn half a period early, so that the jitter of a scan cannot add a scan to them.
- A change faster than the tag's `max_rate` since its last good reading (over one period at least) is
  SENSOR_NOT_ACCURATE; a lasting step is believed once the time that passed makes its rate believable.
- Words in a wrong order make a believable number now and then: after one that was not (DATA_ENCODING_INVALID) a tag's
  readings are UNCERTAIN until DEAD_PERIODS have passed without another.
- A value that has not moved a bit for longer than the tag's `frozen_after` is SENSOR_NOT_ACCURATE.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from typing import NamedTuple

from drivers.tag import Quality, Sample, Tag

STALE_PERIODS = 3.0
DEAD_PERIODS = 10.0
_TOLERANCE = 0.5
"""Periods by which the limits are drawn early: a scan that jitters would otherwise be a whole period beyond them."""
_ROUNDING = 1e-6
"""Periods that the sum of times may be off by: on time the third scan after a reading is three periods later."""
_UNVOUCHED = "was said while nothing proved that the device's program runs"

LINK_FAULTS = frozenset(
    {
        Quality.BAD,
        Quality.COMMUNICATION_ERROR,
        Quality.TIMEOUT,
        Quality.NO_COMMUNICATION,
        Quality.NOT_CONNECTED,
        Quality.NO_DATA,
        Quality.WAITING_FOR_INITIAL_DATA,
    }
)
"""Qualities that tell of the way to the device and not of its value: the last good value may still be used a while."""


@dataclass(frozen=True, slots=True)
class QualityRules:
    """`period` of the scan (s); `heartbeat` is the tag that proves the device's life, at least every `beat` seconds."""

    period: float
    heartbeat: str | None = None
    beat: float = 0.0

    @property
    def beat_period(self) -> float:
        """The heartbeat cannot be expected more often than it changes, nor seen more often than it is read."""
        return max(self.period, self.beat)


class TagHistory(NamedTuple):
    """What is remembered of one tag: its last good reading, and when its value last changed."""

    good: Sample
    changed: float


@dataclass(frozen=True, slots=True)
class DeviceAge:
    """What is remembered of a device: each tag's history, and the heartbeat's last value with the moment (s) of the
    last request for it, and when it was seen to change.

    `alive` is the moment after which the device's memory is known to have lived. `garbled` are the last readings of
    which the driver said that their bytes are no measurement, by tag.

    `counted` is the moment when the present living count was first read, and `said` that reading's own time. `silent`
    is the time of a sample after which nothing is vouched for while life is not proven (None: it is), `silence` the
    last such span that is over, and `doubted` the times of the tags' samples that fell into one.
    """

    tags: Mapping[str, TagHistory] = field(default_factory=dict)
    garbled: Mapping[str, Sample] = field(default_factory=dict)
    beat: int | None = None
    beat_read: float = 0.0
    beat_changed: float | None = None
    alive: float = 0.0
    counted: float | None = None
    said: float = 0.0
    silent: float | None = None
    silence: tuple[float, float] = (0.0, 0.0)
    doubted: Mapping[str, float] = field(default_factory=dict)


def judge(
    age: DeviceAge, tags: Sequence[Tag], read: Sequence[Sample], now: float, rules: QualityRules
) -> tuple[DeviceAge, dict[str, Sample]]:
    """What a scan's readings `read` (in the order of `tags`) are worth at `now`, and what to remember for the next."""
    by_name = {sample.tag: sample for sample in read}
    # The heartbeat first, by which everything else is judged.
    image = None
    if rules.heartbeat:
        age = _count_beat(age, by_name.get(rules.heartbeat), now, rules)
        image = _image(age, now, rules)
        if image is None and age.silent is not None:
            age = replace(age, silent=None, silence=(age.silent, age.said))
    histories, garbled = dict(age.tags), dict(age.garbled)
    doubted: dict[str, float] = {}
    judged: dict[str, Sample] = {}
    for tag in tags:
        sample = by_name[tag.name]
        if sample.quality is Quality.DATA_ENCODING_INVALID:
            garbled[tag.name] = sample
        last = garbled.get(tag.name) if garbled else None
        period = tag.period if tag.period > rules.period else rules.period
        if last is not None and sample.quality.is_good and _periods(last, now, period) <= DEAD_PERIODS:
            reason = f"{now - last.time:.1f} s ago {last.reason}"
            sample = replace(sample, quality=Quality.UNCERTAIN, reason=reason)
        else:
            sample = _on_its_own(tag, sample, histories, now, period)
        if age.silence[0] < sample.time < age.silence[1] or age.doubted.get(tag.name) == sample.time:
            doubted[tag.name] = sample.time
            if sample.quality.is_good:
                sample = replace(sample, quality=Quality.UNCERTAIN, reason=_UNVOUCHED)
        # The heartbeat only ever takes away: it never makes a doubtful reading better, or a bad one less bad.
        if image is not None and not sample.quality.is_bad:
            quality, reason = image
            if quality.is_bad:
                sample = Sample(tag.name, None, quality, now, sent=sample.sent, reason=reason)
            elif sample.quality.is_good:
                sample = replace(sample, quality=quality, reason=reason)
        judged[tag.name] = sample
    return replace(age, tags=histories, garbled=garbled, doubted=doubted), judged


def _count_beat(age: DeviceAge, beat: Sample | None, now: float, rules: QualityRules) -> DeviceAge:
    """What is remembered of the device after one more reading of its heartbeat, or none."""
    if beat is not None and beat.quality.is_good and isinstance(beat.value, int):
        count, changed, alive = int(beat.value), age.beat_changed, age.alive
        # Only a change from one living count to another proves life: the first cycle after a restart may still show
        # what the memory was cleared to.
        if count == 0:
            changed = None
        elif age.beat and count != age.beat:
            changed, alive = now, age.beat_read
        first = count not in (0, age.beat)
        # What a device says by itself may have waited on its way since the count before it came, however often that
        # was read meanwhile. It may be stamped by a clock of its own, too: it was there by now.
        said_before = count == age.beat and age.beat_changed is not None
        read_at = beat.sent if beat.sent is not None else age.beat_read if said_before else now
        age = replace(age, beat=count, beat_read=read_at, beat_changed=changed, alive=alive)
        if first:
            return replace(age, counted=now, said=beat.time)
    if age.beat == 0:
        return replace(age, silent=-inf)
    stands = age.counted is not None and (now - age.counted) / rules.beat_period > STALE_PERIODS + _ROUNDING
    return replace(age, silent=age.said) if stands and age.silent is None else age


def _image(age: DeviceAge, now: float, rules: QualityRules) -> tuple[Quality, str] | None:
    """What the heartbeat says of everything else that was read; None: the device's memory lives."""
    if age.beat == 0:
        return Quality.OUT_OF_SERVICE, "the device's program is not running (heartbeat 0)"
    if age.beat_changed is None:
        return Quality.UNCERTAIN, "the device's heartbeat has not been seen to change yet"
    if (now - age.beat_changed) / rules.beat_period + _TOLERANCE > DEAD_PERIODS:
        return Quality.DEVICE_FAILURE, f"the device's heartbeat has not changed for {now - age.beat_changed:.1f} s"
    if (now - age.alive) / rules.beat_period <= STALE_PERIODS + _ROUNDING:
        return None
    return Quality.LAST_USABLE, f"by the device's heartbeat what was read may be {now - age.alive:.1f} s old"


def _on_its_own(tag: Tag, sample: Sample, histories: dict[str, TagHistory], now: float, period: float) -> Sample:
    """The reading by its own merits; a good one is remembered."""
    name = tag.name
    known = histories.get(name)
    if not sample.quality.is_good:
        return _hold_sample(sample, known, now, period) if sample.quality in LINK_FAULTS else sample
    if known is not None and tag.max_rate is not None and (reason := _too_fast(tag, sample, known.good, period)):
        return replace(sample, quality=Quality.SENSOR_NOT_ACCURATE, reason=reason)
    # Compared by the bit, not by the deadband: a sensor that lives has noise, a frozen one has none.
    changed = known.changed if known is not None and known.good.value == sample.value else sample.time
    histories[name] = history = TagHistory(sample, changed)
    if tag.frozen_after and sample.time - changed > tag.frozen_after:
        reason = f"has not moved for {sample.time - changed:.0f} s (limit {tag.frozen_after:g} s)"
        return replace(sample, quality=Quality.SENSOR_NOT_ACCURATE, reason=reason)
    # What was not asked for has a deadline of its own, which the driver keeps.
    if sample.sent is None:
        return sample
    if _periods(sample, now, period) > STALE_PERIODS:
        return _hold_sample(sample, history, now, period)
    # The device looked at its memory at some moment since it was asked, however late its reply was taken.
    if (now - sample.sent) / period > STALE_PERIODS + _ROUNDING:
        reason = f"was asked for {now - sample.sent:.1f} s ago, and may be as old"
        return replace(sample, quality=Quality.LAST_USABLE, reason=reason)
    return sample


def _periods(sample: Sample, now: float, period: float) -> float:
    return (now - sample.time) / period + _TOLERANCE


def _hold_sample(sample: Sample, known: TagHistory | None, now: float, period: float) -> Sample:
    """The last good value instead of no value, as long as it is usable."""
    if known is None or _periods(known.good, now, period) > DEAD_PERIODS:
        quality = Quality.NO_DATA if sample.quality.is_good else sample.quality
        return Sample(sample.tag, None, quality, now, sent=sample.sent, reason=sample.reason or "too old")
    reason = f"last reading {now - known.good.time:.1f} s old" + (f": {sample.reason}" if sample.reason else "")
    return replace(known.good, quality=Quality.LAST_USABLE, reason=reason)


def unread(sample: Sample, silence: float, interval: float) -> Sample:
    """What a sample of the newest scan is worth `silence` seconds after it, where a scan is due every `interval`.

    By the same limits as within a scan: without a next scan nothing says any more that the value is what it was.
    """
    overdue = silence / interval
    if overdue <= STALE_PERIODS or sample.quality.is_bad:
        return sample
    reason = f"the device has not been read for {silence:.1f} s"
    if overdue > DEAD_PERIODS:
        return Sample(sample.tag, None, Quality.NO_DATA, sample.time, sent=sample.sent, reason=reason)
    return replace(sample, quality=Quality.LAST_USABLE, reason=reason) if sample.quality.is_good else sample


def _too_fast(tag: Tag, sample: Sample, before: Sample, period: float) -> str:
    if tag.max_rate is None or isinstance(sample.value, str) or isinstance(before.value, str):
        return ""
    if sample.value is None or before.value is None:
        return ""
    # Over one period at least: two readings that follow closely (an early scan) would make any step a fast one.
    step, passed = abs(sample.value - before.value), max(sample.time - before.time, period)
    if step <= tag.max_rate * passed:
        return ""
    return f"moved by {step:g} {tag.unit} in {passed:.2f} s (limit {tag.max_rate:g} {tag.unit}/s)"
