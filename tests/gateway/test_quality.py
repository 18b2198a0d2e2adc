"""Ageing: a stale, frozen, unbelievable or unproven value is never good, and good never lasts beyond its promise."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.tag import Quality, Sample, Tag, Value
from gateway.machine.reading.quality import DeviceAge, QualityRules, judge, unread

T = Tag("T", "holding:1", unit="degC", max_rate=5.0)
BEAT = Tag("Beat", "holding:2")
PLAIN, LIVING = QualityRules(1.0), QualityRules(1.0, "Beat")


def good(name: str, value: Value, time: float) -> Sample:
    return Sample(name, value, Quality.GOOD, time, time)


def lost(name: str, time: float, quality: Quality = Quality.TIMEOUT) -> Sample:
    return Sample(name, None, quality, time, reason="no reply")


def walk(readings: list[Sample], tag: Tag = T, rules: QualityRules = PLAIN) -> list[Sample]:
    """Each reading judged at its own time."""
    age, judged = DeviceAge(), []
    for sample in readings:
        age, samples = judge(age, [tag], [sample], sample.time, rules)
        judged.append(samples[tag.name])
    return judged


def test_a_failed_read_is_last_usable_and_after_ten_periods_bad_without_a_value() -> None:
    judged = walk([good("T", 20.0, 0.0), *(lost("T", float(n)) for n in range(1, 15))])
    assert [s.value for s in judged[1:10]] == [20.0] * 9
    assert {s.quality for s in judged[1:10]} == {Quality.LAST_USABLE}
    assert all(s.value is None and s.quality is Quality.TIMEOUT for s in judged[10:])
    assert "no reply" in judged[1].reason and judged[1].time == 0.0


def test_what_the_device_itself_calls_bad_is_bad_at_once() -> None:
    judged = walk([good("T", 20.0, 0.0), lost("T", 1.0, Quality.SENSOR_FAILURE), lost("T", 2.0, Quality.OUT_OF_RANGE)])
    assert [(s.value, s.quality) for s in judged[1:]] == [(None, Quality.SENSOR_FAILURE), (None, Quality.OUT_OF_RANGE)]


def test_a_first_read_that_fails_has_nothing_to_hold() -> None:
    (judged,) = walk([lost("T", 0.0, Quality.NOT_CONNECTED)])
    assert judged.value is None and judged.quality is Quality.NOT_CONNECTED


def test_a_good_sample_that_is_old_itself_ages_too() -> None:
    age = DeviceAge()
    qualities = []
    for now in range(15):
        age, samples = judge(age, [T], [good("T", 20.0, 0.0)], float(now), PLAIN)
        qualities.append(samples["T"].quality)
    assert qualities[:3] == [Quality.GOOD] * 3
    assert set(qualities[3:10]) == {Quality.LAST_USABLE}
    assert all(quality.is_bad for quality in qualities[10:])


def test_a_tag_with_a_period_of_its_own_ages_by_that_and_never_faster_than_the_scan() -> None:
    for tag, good_for in ((replace(T, period=5.0), 12), (replace(T, period=0.1), 2)):
        age, qualities = DeviceAge(), []
        for now in range(60):
            age, samples = judge(age, [tag], [good("T", 20.0, 0.0)], float(now), PLAIN)
            qualities.append(samples["T"].quality)
        assert qualities[: good_for + 1] == [Quality.GOOD] * (good_for + 1)
        assert not any(quality.is_good for quality in qualities[good_for + 1 :])
        assert qualities[-1].is_bad


def beats(values: list[int | None], period: float = 1.0, rules: QualityRules = LIVING) -> list[Sample]:
    """A good T beside a heartbeat that reads so (None: its read fails)."""
    age, judged = DeviceAge(), []
    for n, beat in enumerate(values):
        now = n * period
        pulse = lost("Beat", now) if beat is None else good("Beat", beat, now)
        age, samples = judge(age, [T, BEAT], [good("T", 20.0, now), pulse], now, rules)
        judged.append(samples["T"])
    return judged


def test_until_the_heartbeat_was_seen_to_move_nothing_is_good() -> None:
    assert [s.quality for s in beats([5, 5, 5, 6])] == [*[Quality.UNCERTAIN] * 3, Quality.GOOD]


def test_heartbeat_zero_means_that_the_program_does_not_run() -> None:
    judged = beats([5, 6, 0, 0, 1, 2])
    assert [s.quality.is_good for s in judged] == [False, True, False, False, False, True]
    assert judged[2].quality is Quality.OUT_OF_SERVICE and judged[2].value is None


def test_a_heartbeat_that_stands_makes_everything_stale_and_then_bad() -> None:
    judged = beats([5, 6, *[6] * 12])
    assert [s.quality for s in judged[1:4]] == [Quality.GOOD] * 3
    assert {s.quality for s in judged[4:11]} == {Quality.LAST_USABLE}
    assert all(s.value is None and s.quality is Quality.DEVICE_FAILURE for s in judged[11:])


def test_a_slow_heartbeat_is_given_its_own_period() -> None:
    slow = QualityRules(1.0, "Beat", beat=4.0)
    assert all(s.quality.is_good for s in beats([1, 2, 2, 2, 2, 3, 3, 3, 3, 4], rules=slow)[1:])


@settings(max_examples=200, deadline=None)
@given(st.lists(st.sampled_from([0, 1, 2, None]), min_size=1, max_size=40), st.floats(-0.05, 0.05))
def test_good_never_outlives_the_last_heartbeat_by_three_periods(pulse: list[int | None], jitter: float) -> None:
    period = 1.0 + jitter
    judged = beats(pulse, period=period)
    proven = None
    before: int | None = None
    for n, (beat, sample) in enumerate(zip(pulse, judged, strict=True)):
        if beat is not None:
            if beat and before and beat != before:
                proven = n
            elif beat == 0:
                proven = None
            before = beat
        if sample.quality.is_good:
            assert proven is not None
            assert (n + 1 - proven) * period <= 3.0 * 1.06, "delivered as good until the next scan"


@settings(max_examples=300, deadline=None)
@given(st.lists(st.tuples(st.floats(0.2, 6.0), st.floats(0.0, 0.9)), min_size=2, max_size=30), st.integers(0, 28))
def test_a_memory_that_froze_is_good_for_three_periods_however_late_the_scans(
    scans: list[tuple[float, float]], frozen_after: int
) -> None:
    """Frozen at the very moment after one reading left the device, with one last count that nobody has seen yet."""
    age, now, count, frozen = DeviceAge(), 0.0, 1, None
    for number, (pause, took) in enumerate(scans):
        sent, now = now + pause, now + pause + took
        count += frozen is None
        pulse = Sample("Beat", count, Quality.GOOD, now, sent)
        age, samples = judge(age, [T, BEAT], [Sample("T", 20.0, Quality.GOOD, now, sent), pulse], now, LIVING)
        if samples["T"].quality.is_good and frozen is not None:
            assert now - frozen <= 3.0 + 1e-5
        if number == frozen_after:
            count, frozen = count + 1, sent


def test_a_living_device_is_good_again_with_the_second_scan_after_a_pause() -> None:
    age, qualities = DeviceAge(), []
    for count, now in enumerate((0.0, 1.0, 2.0, 9.0, 10.0), start=1):
        age, samples = judge(age, [T, BEAT], [good("T", 20.0, now), good("Beat", count, now)], now, LIVING)
        qualities.append(samples["T"].quality)
    assert qualities == [Quality.UNCERTAIN, Quality.GOOD, Quality.GOOD, Quality.LAST_USABLE, Quality.GOOD]


def test_a_change_faster_than_the_tag_allows_is_not_accurate_until_time_makes_it_believable() -> None:
    judged = walk([good("T", 20.0, 0.0), *(good("T", 32.0, float(n)) for n in range(1, 5))])
    assert [s.quality for s in judged] == [
        Quality.GOOD,
        Quality.SENSOR_NOT_ACCURATE,
        Quality.SENSOR_NOT_ACCURATE,
        Quality.GOOD,
        Quality.GOOD,
    ]
    assert "moved by 12 degC" in judged[1].reason


def test_a_spike_is_marked_and_the_reading_after_it_is_good() -> None:
    judged = walk([good("T", 20.0, 0.0), good("T", 90.0, 1.0), good("T", 20.5, 2.0)])
    assert [s.quality.is_good for s in judged] == [True, False, True]


def test_a_value_that_stands_still_for_longer_than_the_tag_allows_is_not_accurate() -> None:
    tag = Tag("T", "holding:1", frozen_after=3.0)
    judged = walk([good("T", 20.0, float(n)) for n in range(6)] + [good("T", 20.1, 6.0)], tag)
    assert [s.quality.is_good for s in judged] == [True, True, True, True, False, False, True]
    assert judged[4].quality is Quality.SENSOR_NOT_ACCURATE


def test_a_value_at_rest_is_good_for_ever_when_the_tag_does_not_say_otherwise() -> None:
    assert all(s.quality.is_good for s in walk([good("T", 20.0, float(n)) for n in range(100)]))


@pytest.mark.parametrize("value", ["text", True])
def test_text_and_switches_have_no_rate(value: Value) -> None:
    assert all(s.quality.is_good for s in walk([good("T", value, 0.0), good("T", value, 1.0)]))


@pytest.mark.parametrize("interval", [1.0, 4.0])
def test_what_nobody_reads_again_ages_by_the_limits_of_a_scan(interval: float) -> None:
    sample = Sample("T", 20.0, Quality.GOOD, 5.0, 5.5)
    assert unread(sample, 3.0 * interval, interval) == sample
    silence = 3.01 * interval
    reason = f"the device has not been read for {silence:.1f} s"
    assert unread(sample, silence, interval) == replace(sample, quality=Quality.LAST_USABLE, reason=reason)
    assert unread(sample, 10.0 * interval, interval).quality is Quality.LAST_USABLE
    gone = unread(sample, 10.1 * interval, interval)
    assert gone == replace(sample, value=None, quality=Quality.NO_DATA, reason=gone.reason) and gone.reason


def test_what_is_not_good_does_not_become_better_by_not_being_read() -> None:
    doubtful = Sample("T", 20.0, Quality.UNCERTAIN, 5.0, reason="why")
    assert unread(doubtful, 4.0, 1.0) == doubtful
    assert unread(doubtful, 11.0, 1.0).quality is Quality.NO_DATA
    bad = lost("T", 5.0, Quality.SENSOR_FAILURE)
    assert [unread(bad, silence, 1.0) for silence in (1.0, 4.0, 11.0)] == [bad] * 3
