"""Rates of alarms: every figure by hand, at the borders of what the standards say."""

import random

import pytest

from gateway.machine.alarms import JournalRow, alarm_rates
from gateway.machine.alarms.rates import AlarmFlood, alarm_floods, densest_window

DAY = 86_400.0


def row(
    time: float, alarm: str = "a", state: str = "unacknowledged", *, priority: int = 3, machine: str = "m"
) -> JournalRow:
    return JournalRow(
        time=time, machine=machine, alarm=alarm, tag="T", priority=priority, state=state, value=None, by="", reason=""
    )


def test_the_average_is_per_ten_minutes_and_only_announcements_count() -> None:
    rows = [row(0.0), row(1.0), row(2.0, state="acknowledged"), row(3.0, state="normal"), row(3600.0), row(3601.0)]
    found = alarm_rates(rows, 0.0, 3600.0)
    assert found.announced == 2, "after the start, up to the end"
    assert found.per_ten_minutes == pytest.approx(2 / 6)
    assert found.verdict == "very likely acceptable" and found.ok


@pytest.mark.parametrize(
    ("alarms", "verdict"),
    [
        (6, "very likely acceptable"),
        (7, "manageable"),
        (12, "manageable"),
        (13, "likely over-demanding"),
        (30, "likely over-demanding"),
        (31, "very likely unacceptable"),
    ],
)
def test_the_verdict_is_that_of_eemua_191(alarms: int, verdict: str) -> None:
    rows = [row(100.0 * number, f"a{number}") for number in range(1, alarms + 1)]
    found = alarm_rates(rows, 0.0, 3600.0)
    assert found.verdict == verdict and bool(found.findings) == (alarms > 6)


def test_the_peak_is_of_any_ten_minutes_and_not_of_the_clocks() -> None:
    # Five just before a full ten minutes and six just after: eleven within 20 s.
    rows = [row(590.0 + n, f"a{n}") for n in range(5)] + [row(605.0 + n, f"b{n}") for n in range(6)]
    found = alarm_rates(rows, 0.0, DAY)
    assert (found.peak, found.peak_at) == (11, 610.0)
    assert [(flood.start, flood.alarms) for flood in found.floods] == [(610.0, 11)]


def test_ten_minutes_are_half_open() -> None:
    assert densest_window([0.0, 600.0], 600.0) == (1, 0.0)
    assert densest_window([0.0, 599.9], 600.0) == (2, 599.9)
    assert densest_window([], 600.0) == (0, None)


def test_a_flood_begins_with_the_eleventh_and_ends_when_fewer_than_five_are_left() -> None:
    times = [float(n) for n in range(10)]
    assert alarm_floods(times, DAY) == []
    times = [float(n) for n in range(11)]
    # Of eleven that came at 0..10 the seventh leaves at 606: four are left.
    assert alarm_floods(times, DAY) == [AlarmFlood(start=10.0, end=606.0, alarms=11)]
    assert alarm_floods(times, 300.0) == [AlarmFlood(start=10.0, end=300.0, alarms=11)]
    more = [*times, 500.0, 501.0]
    assert alarm_floods(more, DAY) == [AlarmFlood(start=10.0, end=608.0, alarms=13)]
    again = [*times, *(2000.0 + n for n in range(11))]
    assert [flood.start for flood in alarm_floods(again, DAY)] == [10.0, 2010.0]


def test_a_flood_is_what_counting_at_every_moment_finds() -> None:
    rng = random.Random(3)
    for _ in range(6):
        times = sorted(rng.randrange(0, 4000) * 1.0 for _ in range(rng.randrange(5, 60)))
        floods, flooding = [], None
        for moment in range(6000):
            inside = sum(moment - 600 < time <= moment for time in times)
            if flooding is None and inside > 10:
                flooding = moment
            elif flooding is not None and inside < 5:
                floods.append((flooding, moment))
                flooding = None
        assert [(flood.start, flood.end) for flood in alarm_floods(times, 6000.0)] == floods


def test_each_finding_begins_one_beyond_what_a_person_can_deal_with() -> None:
    # Ten within ten minutes are a person's most, eleven are too many, and a flood from the last one on.
    for count, said in [(10, []), (11, ["11 alarms within ten minutes; nobody can deal with more than 10"])]:
        rows = [row(5000.0 + n, f"a{n}") for n in range(count)]
        found = alarm_rates(rows, 2000.0, 2000.0 + 0.75 * DAY)
        assert found.findings == [*said, *["1 flood of alarms"] * bool(said)]
        assert found.per_ten_minutes == pytest.approx(count / (0.75 * 144))
        # Eleven at 5000..5010: fewer than five are left when the seventh leaves.
        assert found.flooded == pytest.approx((5606.0 - 5010.0) / (0.75 * DAY) * bool(said))
    twice = [row(start + n, f"a{n}") for start in (5000.0, 9000.0) for n in range(11)]
    assert "2 floods of alarms" in alarm_rates(twice, 0.0, DAY).findings
    cut = alarm_rates(twice, 1.0, 9100.0)
    assert (cut.start, cut.end, cut.announced) == (1.0, 9100.0, 22)
    assert cut.flooded == pytest.approx((596.0 + 90.0) / 9099.0)


def test_findings_name_the_alarms_they_are_about() -> None:
    chatter = [row(at, name) for name in ("a", "b") for at in (1.0, 2.0, 60.9)] + [row(at, "c") for at in (1.0, 61.0)]
    assert alarm_rates(chatter, 0.0, DAY).findings == ["chattering: a, b; give them a delay or a deadband"]
    old = [row(-1.0, "young"), row(-9.0, "old"), row(0.0, "on time")]
    assert alarm_rates(old, 0.5, DAY).findings == [
        "standing for more than a day: old, young; mend it, or take the alarm out of service"
    ]
    assert list(alarm_rates(old, 0.5, DAY).standing.items()) == [
        ("old", DAY + 9.0),
        ("young", DAY + 1.0),
        ("on time", DAY),
    ]
    busy = [row(100.0 * n, f"a{n}") for n in range(1, 8)]
    assert alarm_rates(busy, 0.0, 3600.0).findings == ["1.2 alarms in ten minutes on average; more than 1 is too many"]


def test_urgent_ones_are_a_share_only_of_twenty_and_more() -> None:
    for count, urgent, said in [(19, 19, False), (20, 2, False), (20, 3, True), (29, 3, True), (30, 3, False)]:
        rows = [row(2800.0 * n, f"a{n}", priority=1 if n <= urgent else 2) for n in range(1, count + 1)]
        found = alarm_rates(rows, 0.0, DAY)
        share = f"{urgent / count:.0%} of the alarms have priority 1; of many alarms that are urgent none is"
        assert found.findings == [share] * said
        assert list(found.priorities) == sorted(found.priorities)
        assert found.shares[1] == urgent / count and sum(found.shares.values()) == pytest.approx(1.0)


def test_the_ten_most_frequent_are_shown_the_most_frequent_first() -> None:
    rows = [row(700.0 * (n * 20 + m), f"a{n:02d}") for n in range(12) for m in range(n + 1)]
    found = alarm_rates(rows, -1.0, 10 * DAY).frequent
    assert list(found.items()) == [(f"a{n:02d}", n + 1) for n in range(11, 1, -1)]


def test_chattering_is_three_within_a_minute_of_one_alarm() -> None:
    rows = [row(0.5), row(30.0), row(60.4), row(100.0, "b"), row(160.0, "b"), row(219.0, "b"), row(7.0, "c")]
    found = alarm_rates(rows, 0.0, DAY)
    assert dict(found.chattering) == {"a": 3}
    assert dict(found.frequent) == {"a": 3, "b": 3, "c": 1}


def test_what_stands_is_told_from_what_is_stale_also_when_it_began_before() -> None:
    rows = [
        row(-2 * DAY, "old"),
        row(-1.5 * DAY, "old", "acknowledged"),
        row(0.0, "young"),
        row(10.0, "over"),
        row(20.0, "over", "returned unacknowledged"),
        row(-DAY, "latched"),
        row(-0.5 * DAY, "latched", "latched unacknowledged"),
        row(-3 * DAY, "from before the journal", "acknowledged"),
        row(5.0, "hidden"),
        row(6.0, "hidden", "shelved"),
    ]
    found = alarm_rates(rows, 0.0, DAY)
    assert dict(found.standing) == {
        "from before the journal": 4 * DAY,
        "old": 3 * DAY,
        "latched": 2 * DAY,
        "young": DAY,
    }
    assert set(found.stale) == {"from before the journal", "old", "latched"}, "a day exactly is not more than a day"


def test_shares_by_priority_and_machines_together() -> None:
    rows = [row(10_000.0 * n, f"a{n}", priority=3) for n in range(1, 19)]
    rows += [row(10_000.0 * n + 5.0, f"b{n}", priority=1, machine="n") for n in range(1, 3)]
    found = alarm_rates(rows, 0.0, 10 * DAY)
    assert dict(found.priorities) == {1: 2, 3: 18} and found.shares[1] == pytest.approx(0.1)
    assert "priority 1" not in " ".join(found.findings), "twice the advised share is not yet too many"
    assert "n: b1" in found.frequent
    more = [*rows, row(5.0, "c", priority=1)]
    assert "priority 1" in " ".join(alarm_rates(more, 0.0, 10 * DAY).findings)


def test_no_time_has_no_rates() -> None:
    with pytest.raises(ValueError, match="the end must be after the start"):
        alarm_rates([], 5.0, 5.0)
    empty = alarm_rates([], 0.0, DAY)
    assert (empty.announced, empty.peak, empty.ok) == (0, 0, True)
