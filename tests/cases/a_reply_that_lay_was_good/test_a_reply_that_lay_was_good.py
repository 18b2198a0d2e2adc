"""A reply that lay while the gateway stood still was good when it was taken, ten scan periods after it was asked for.

The device looked at its memory at some moment between the request and the reply, and nobody knows when. A reading was
judged by when its reply was complete: where a link's deadline is longer than three periods, as in a replay in which a
second of the plant's goes by in some milliseconds, a value of long ago was good. Times are in scan periods.
"""

import pytest

from drivers.tag import Quality, Sample, Tag
from gateway.machine.reading.quality import DeviceAge, QualityRules, judge

VALUE = Tag("value", "holding:1")
BEAT = Tag("beat", "holding:0")


@pytest.mark.parametrize(
    ("asked_ago", "expected"),
    [(0.1, Quality.GOOD), (3.0, Quality.GOOD), (3.1, Quality.LAST_USABLE), (9.6, Quality.LAST_USABLE)],
)
def test_what_may_be_older_than_three_periods_is_not_good(asked_ago: float, expected: Quality) -> None:
    now = 100.0
    reading = Sample(VALUE.name, 7, Quality.GOOD, now, sent=now - asked_ago)
    _, judged = judge(DeviceAge(), (VALUE,), [reading], now, QualityRules(1.0))
    assert (judged[VALUE.name].quality, judged[VALUE.name].value) == (expected, 7)
    if expected is not Quality.GOOD:
        assert judged[VALUE.name].reason == f"was asked for {asked_ago:.1f} s ago, and may be as old"


def test_a_heartbeat_that_is_seldom_told_vouches_for_no_more() -> None:
    """A beat that is expected once in ten periods lets the memory live for thirty."""
    rules, age = QualityRules(1.0, BEAT.name, beat=10.0), DeviceAge()
    for now, asked_ago, count in ((0.0, 0.1, 1), (1.0, 0.1, 2), (11.0, 9.9, 3)):
        read = [Sample(tag.name, count, Quality.GOOD, now, sent=now - asked_ago) for tag in (BEAT, VALUE)]
        age, judged = judge(age, (BEAT, VALUE), read, now, rules)
    assert judged[VALUE.name].quality is Quality.LAST_USABLE


def test_what_a_device_says_by_itself_is_its_drivers_to_judge() -> None:
    said = Sample(VALUE.name, 7, Quality.GOOD, 90.0)
    _, judged = judge(DeviceAge(), (VALUE,), [said], 100.0, QualityRules(1.0))
    assert judged[VALUE.name].quality is Quality.GOOD
