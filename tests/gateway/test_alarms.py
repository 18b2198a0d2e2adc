"""Alarms: every move is in the table, delays and deadband hold, and not knowing changes nothing."""

import json
from dataclasses import replace
from itertools import product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.machine.alarms.states import (
    CHANGE_WORDS,
    HIDDEN,
    LETTERS,
    MEANINGS,
    SHOWN,
    TRANSITIONS,
    Alarm,
    AlarmCondition,
    AlarmState,
    Change,
    acknowledge,
    apply_change,
    from_plain,
    new_alarm,
    possible,
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


STANDARD = """
normal: raise -> unacknowledged
unacknowledged: acknowledge -> acknowledged
unacknowledged: clear [plain] -> returned unacknowledged
unacknowledged: clear [latching] -> latched unacknowledged
acknowledged: clear [plain] -> normal
acknowledged: clear [latching] -> latched acknowledged
returned unacknowledged: raise -> unacknowledged
returned unacknowledged: acknowledge -> normal
latched unacknowledged: raise -> unacknowledged
latched unacknowledged: acknowledge -> latched acknowledged
latched acknowledged: raise -> unacknowledged
latched acknowledged: reset -> normal
"""
"""The moves among the states that are shown, A to F (ANSI/ISA-18.2-2016, 5.3; IEC 62682:2014, 5.3), typed from it."""


def test_the_table_is_the_one_of_isa_18_2() -> None:
    words = {None: "", True: " [latching]", False: " [plain]"}
    shown = [
        f"{row.source}: {row.change}{words[row.latching]} -> {row.target}"
        for row in TRANSITIONS
        if row.source in SHOWN and row.target in SHOWN
    ]
    assert sorted(shown) == sorted(STANDARD.split("\n")[1:-1])
    assert {state: letter for letter, state in zip("ABCDEFGHI", AlarmState, strict=True)} == LETTERS
    assert set(MEANINGS) == set(AlarmState) and set(CHANGE_WORDS) == set(Change)


@pytest.mark.parametrize("hidden", HIDDEN)
def test_every_state_can_be_hidden_and_comes_out_as_it_must(hidden: AlarmState) -> None:
    enter, leave = HIDDEN[hidden]
    for latching, state in product((False, True), SHOWN):
        if latching is False and state.name.startswith("LATCHED"):
            continue
        standing = state in (AlarmState.UNACKNOWLEDGED, AlarmState.ACKNOWLEDGED)
        alarm = Alarm("c", "T", 1, state, 5.0, standing=standing)
        inside = apply_change(alarm, enter, 6.0, "Ada", until=9.0, latching=latching)
        assert inside.state is hidden and not inside.active and inside.standing == standing
        out = apply_change(inside, leave, 7.0, "Ada", latching=latching)
        assert out.until is None
        if standing:
            assert out.state is AlarmState.UNACKNOWLEDGED, "what stands is announced anew"
            inside = apply_change(inside, Change.CLEAR, 6.5, latching=latching)
            out = apply_change(inside, leave, 7.0, latching=latching)
        # What is over comes out as it would have been had it not been hidden.
        shown = apply_change(alarm, Change.CLEAR, 6.5, latching=latching)
        assert out.state is shown.state


def test_of_every_alarm_each_change_has_one_row_at_most() -> None:
    for source, change, latching, standing, kept in product(AlarmState, Change, (0, 1), (0, 1), SHOWN):
        rows = [
            row
            for row in TRANSITIONS
            if (row.source, row.change) == (source, change)
            and row.latching in (None, bool(latching))
            and row.standing in (None, bool(standing))
            and row.kept in (None, kept)
        ]
        assert len(rows) <= 1, rows


HAS = {(row.source, row.change) for row in TRANSITIONS}


@pytest.mark.parametrize(("state", "change"), [p for p in product(AlarmState, Change) if p not in HAS])
def test_a_change_that_the_table_does_not_have_leaves_the_alarm_as_it_is(state: AlarmState, change: Change) -> None:
    alarm = Alarm("c", "T", 1, state, 5.0)
    assert apply_change(alarm, change, 9.0) == alarm


def test_every_move_keeps_account_of_who_made_it_when_and_why() -> None:
    for state, change, latching, standing, kept in product(AlarmState, Change, (False, True), (False, True), SHOWN):
        alarm = Alarm(
            *("c", "T", 1, state, 5.0, "Bea", 4.0),
            standing=standing,
            kept=kept,
            until=30.0,
            by="Bea",
            reason="old",
            raised=3.0,
            first_up=True,
        )
        after = apply_change(alarm, change, 9.0, "Ada", reason="why", latching=latching, until=20.0)
        if after is alarm:
            continue
        # What is hidden and stays hidden in the same state is not moved: only what it comes out as may change.
        stays = after.state is state
        assert (after.since, after.by, after.reason) == ((5.0, "Bea", "old") if stays else (9.0, "Ada", "why"))
        assert after.until == (30.0 if stays else 20.0 if after.state in HIDDEN else None)
        if change is Change.ACKNOWLEDGE and after.state not in HIDDEN:
            assert after.acknowledged_by == "Ada"
        else:
            anew = after.state is AlarmState.UNACKNOWLEDGED
            assert after.acknowledged_by == ("" if anew else "Bea")
        assert after.pending == (None if change in (Change.RAISE, Change.CLEAR) else 4.0)
        assert after.standing == (change is Change.RAISE or (standing and change is not Change.CLEAR))
        assert after.raised == (9.0 if after.state is AlarmState.UNACKNOWLEDGED else 3.0)
        assert after.first_up == (not (change is Change.RAISE and state is AlarmState.NORMAL))
        if after.state not in HIDDEN:
            assert after.kept is AlarmState.NORMAL
        elif stays:
            assert after.kept is (AlarmState.LATCHED_UNACKNOWLEDGED if change is Change.RAISE and latching else kept)


def test_a_shelving_has_an_end() -> None:
    with pytest.raises(ValueError, match="needs an end"):
        apply_change(new_alarm(HOT, 0.0), Change.SHELVE, 1.0, "Ada")


def test_what_a_person_does_neither_shortens_nor_lengthens_a_delay() -> None:
    begun = step(SLOW, new_alarm(SLOW, 0.0), 81.0, 1.0)
    pressed = apply_change(apply_change(begun, Change.ACKNOWLEDGE, 2.0, "Ada"), Change.RESET, 2.0, "Ada")
    assert step(SLOW, pressed, 81.0, 4.0).state is AlarmState.UNACKNOWLEDGED
    hidden = apply_change(begun, Change.REMOVE, 2.0, "Ada")
    assert apply_change(step(SLOW, hidden, 81.0, 4.0), Change.RETURN, 5.0, "Ada").state is AlarmState.UNACKNOWLEDGED


def test_a_latching_alarm_that_came_and_went_where_nobody_saw_it_is_not_forgotten() -> None:
    condition = replace(HOT, latches=True)
    alarm = apply_change(new_alarm(condition, 0.0), Change.SHELVE, 0.0, "Ada", until=9.0)
    alarm = step(condition, step(condition, alarm, 90.0, 1.0), 20.0, 2.0)
    assert apply_change(alarm, Change.UNSHELVE, 9.0, latching=True).state is AlarmState.LATCHED_UNACKNOWLEDGED


def test_an_alarm_saved_by_a_release_that_knew_four_states_is_read() -> None:
    former = {
        "condition": "over limit T",
        "tag": "T",
        "priority": 1,
        "state": "acknowledged",
        "since": 5.0,
        "acknowledged_by": "Ada",
        "pending": None,
    }
    alarm = from_plain(HOT, former)
    assert (alarm.state, alarm.standing, alarm.acknowledged_by) == (AlarmState.ACKNOWLEDGED, True, "Ada")
    assert step(HOT, alarm, 20.0, 6.0).state is AlarmState.NORMAL
    with pytest.raises((KeyError, TypeError, ValueError)):
        from_plain(HOT, {**former, "state": "shelved"})


def test_of_a_saved_alarm_tag_and_priority_are_the_conditions_and_a_delay_begins_anew() -> None:
    alarm = replace(new_alarm(HOT, 1.0), pending=3.0, kept=AlarmState.RETURNED, state=AlarmState.SHELVED, until=9.0)
    read = from_plain(replace(HOT, tag="U", priority=4), json.loads(json.dumps(to_plain(alarm))))
    assert read == replace(alarm, tag="U", priority=4, pending=None)
    assert type(read.kept) is AlarmState and type(read.state) is AlarmState


def test_when_an_alarm_was_announced_and_whether_it_was_the_first_is_kept_until_it_comes_anew() -> None:
    first = replace(step(HOT, new_alarm(HOT, 0.0), 90.0, 1.0), first_up=True)
    assert first.raised == 1.0
    taken = apply_change(first, Change.ACKNOWLEDGE, 2.0, "Ada")
    back = step(HOT, first, 20.0, 3.0)
    assert [(each.raised, each.first_up) for each in (taken, back)] == [(1.0, True)] * 2
    again = step(HOT, back, 90.0, 4.0)
    assert (again.state, again.raised, again.first_up) == (AlarmState.UNACKNOWLEDGED, 4.0, True)
    anew = step(HOT, replace(new_alarm(HOT, 0.0), first_up=True), 90.0, 5.0)
    assert (anew.raised, anew.first_up) == (5.0, False)
    shelved = apply_change(taken, Change.SHELVE, 6.0, "Ada", until=60.0)
    assert (shelved.since, shelved.raised, shelved.first_up) == (6.0, 1.0, True)
    out = apply_change(shelved, Change.UNSHELVE, 7.0)
    assert (out.state, out.since, out.raised) == (AlarmState.UNACKNOWLEDGED, 7.0, 7.0)
    removed = apply_change(shelved, Change.REMOVE, 8.0, "Ada")
    assert (removed.state, removed.kept) == (AlarmState.OUT_OF_SERVICE, shelved.kept)


def test_what_is_possible_depends_on_whether_the_alarm_latches() -> None:
    over = replace(new_alarm(HOT, 0.0), state=AlarmState.LATCHED_ACKNOWLEDGED)
    assert Change.RESET in possible(over, latching=True)
    assert set(possible(new_alarm(HOT, 0.0))) == {Change.RAISE, Change.SHELVE, Change.SUPPRESS, Change.REMOVE}
    standing = replace(new_alarm(HOT, 0.0), state=AlarmState.UNACKNOWLEDGED, standing=True)
    moves = [Change.CLEAR, Change.ACKNOWLEDGE, Change.SHELVE, Change.SUPPRESS, Change.REMOVE]
    assert {*possible(standing)} == {*possible(standing, latching=True)} == {*moves}


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
    third, silent = replace(HOT, bit=3), replace(HOT, bit=None)
    for bits in (1, 2, 4, 8, 16, 6, 0xFFF7):
        taken = acknowledge({"over limit T": third}, raised, before=0x10, bits=bits, now=2.0, by="PLC")
        assert (taken != raised) == (bits == 8), bits
        assert acknowledge({"over limit T": silent}, raised, before=0, bits=bits, now=2.0, by="PLC") == raised


def test_a_new_occurrence_forgets_who_acknowledged_the_last_one() -> None:
    alarm = apply_change(step(HOT, new_alarm(HOT, 0.0), 90.0, 1.0), Change.ACKNOWLEDGE, 2.0, "Ada")
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
    without, beside = replace(bad, bit=None), replace(other, bit=2, temperature="U")
    alarms = {name: step(bad, new_alarm(bad, 0.0), 99.0, 0.0) for name in ("over limit T", "without", "beside")}
    said = {"over limit T": HOT, "without": without, "beside": beside}
    assert [word(said, alarms, temperature) for temperature in ("", "U", "T")] == [1, 5, 1]


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(st.one_of(st.none(), st.floats(60, 100)), st.booleans()), max_size=60))
def test_an_alarm_stands_exactly_while_its_condition_does_whoever_acknowledges(
    history: list[tuple[float | None, bool]],
) -> None:
    alarm, standing = new_alarm(HOT, 0.0), False
    for second, (value, pressed) in enumerate(history):
        if pressed:
            alarm = apply_change(alarm, Change.ACKNOWLEDGE, float(second), "Ada")
        alarm = step(HOT, alarm, value, float(second))
        if value is not None:
            standing = value > 80.0 or (standing and value > 78.0)
        assert alarm.active == standing
        assert from_plain(HOT, to_plain(alarm)) == alarm
