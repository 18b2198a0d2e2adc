"""Alarms: every move is in the table, delays and deadband hold, and not knowing changes nothing."""

from itertools import product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.machine.alarms.states import (
    TRANSITIONS,
    Alarm,
    AlarmCondition,
    AlarmState,
    Change,
    acknowledge,
    from_plain,
    moved,
    new_alarm,
    step,
    to_plain,
    word,
)

HOT = AlarmCondition("over limit T", "T", bit=0, limit=80.0, deadband=2.0)
SLOW = AlarmCondition("over limit T", "T", bit=0, limit=80.0, deadband=2.0, on_delay=3.0, off_delay=5.0)


def follow(condition: AlarmCondition, values: list[float | None]) -> list[AlarmState]:
    alarm, states = new_alarm(condition, 0.0), []
    for second, value in enumerate(values):
        alarm = step(condition, alarm, value, float(second))
        states.append(alarm.state)
    return states


def test_the_table_is_the_one_of_isa_18_2() -> None:
    assert {(a.value, b.value): c.value for (a, b), c in TRANSITIONS.items()} == {
        ("normal", "raise"): "unacknowledged",
        ("unacknowledged", "acknowledge"): "acknowledged",
        ("unacknowledged", "clear"): "returned unacknowledged",
        ("acknowledged", "clear"): "normal",
        ("returned unacknowledged", "raise"): "unacknowledged",
        ("returned unacknowledged", "acknowledge"): "normal",
    }


@pytest.mark.parametrize(("state", "change"), [p for p in product(AlarmState, Change) if p not in TRANSITIONS])
def test_a_change_that_the_table_does_not_have_leaves_the_alarm_as_it_is(state: AlarmState, change: Change) -> None:
    alarm = Alarm("c", "T", 1, state, 5.0)
    assert moved(alarm, change, 9.0) == alarm


def test_exactly_at_the_limit_is_not_above_it_and_the_deadband_keeps_the_alarm() -> None:
    u, n, r = AlarmState.UNACKNOWLEDGED, AlarmState.NORMAL, AlarmState.RETURNED
    assert follow(HOT, [80.0, 80.1, 79.0, 78.1, 78.0, 79.9, 80.1]) == [n, u, u, u, r, r, u]


def test_delays_must_be_served_without_a_break() -> None:
    u, n, r = AlarmState.UNACKNOWLEDGED, AlarmState.NORMAL, AlarmState.RETURNED
    assert follow(SLOW, [81, 81, 79, 81, 81, 81, 81]) == [n, n, n, n, n, n, u]
    assert follow(SLOW, [81, 81, 81, 81, 70, 70, 70, 70, 70, 70])[3:] == [u, u, u, u, u, u, r]


def test_not_knowing_neither_raises_nor_clears_nor_lets_a_delay_run() -> None:
    u, n = AlarmState.UNACKNOWLEDGED, AlarmState.NORMAL
    assert follow(HOT, [81, None, None, None]) == [u, u, u, u]
    assert follow(SLOW, [81, 81, None, 81, 81, 81]) == [n] * 6


def test_a_rising_edge_acknowledges_and_a_standing_level_does_not() -> None:
    conditions = {"over limit T": HOT}
    raised = {"over limit T": step(HOT, new_alarm(HOT, 0.0), 90.0, 1.0)}
    for before in (None, 1, 3):
        assert acknowledge(conditions, raised, before=before, bits=1, now=2.0, by="PLC") == raised
    taken = acknowledge(conditions, raised, before=0, bits=1, now=2.0, by="PLC")["over limit T"]
    assert (taken.state, taken.acknowledged_by, taken.since) == (AlarmState.ACKNOWLEDGED, "PLC", 2.0)
    assert acknowledge(conditions, raised, before=0, bits=2, now=2.0, by="PLC") == raised, "another alarm's bit"


def test_a_new_occurrence_forgets_who_acknowledged_the_last_one() -> None:
    alarm = moved(step(HOT, new_alarm(HOT, 0.0), 90.0, 1.0), Change.ACKNOWLEDGE, 2.0, "Ada")
    alarm = step(HOT, step(HOT, alarm, 70.0, 3.0), 90.0, 4.0)
    assert (alarm.state, alarm.acknowledged_by) == (AlarmState.UNACKNOWLEDGED, "")


def test_the_word_has_the_bits_of_what_stands_and_two_tags_share_one() -> None:
    other = AlarmCondition("over limit U", "U", bit=0, limit=80.0)
    bad = AlarmCondition("inputs bad", "", bit=4, limit=0.5)
    conditions = {c.name: c for c in (HOT, other, bad)}
    alarms = {name: step(c, new_alarm(c, 0.0), 99.0, 0.0) for name, c in conditions.items()}
    assert word(conditions, alarms) == 0b10001
    alarms["inputs bad"] = step(bad, alarms["inputs bad"], 0.0, 1.0)
    assert word(conditions, alarms) == 0b00001


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(st.one_of(st.none(), st.floats(60, 100)), st.booleans()), max_size=60))
def test_an_alarm_stands_exactly_while_its_condition_does_whoever_acknowledges(
    history: list[tuple[float | None, bool]],
) -> None:
    alarm, standing = new_alarm(HOT, 0.0), False
    for second, (value, pressed) in enumerate(history):
        if pressed:
            alarm = moved(alarm, Change.ACKNOWLEDGE, float(second), "Ada")
        alarm = step(HOT, alarm, value, float(second))
        if value is not None:
            standing = value > 80.0 or (standing and value > 78.0)
        assert alarm.active == standing
        assert from_plain(HOT, to_plain(alarm)) == alarm
