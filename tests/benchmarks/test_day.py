"""The judge of the scripted day: a day as it must be has no finding, and each thing that is wrong with one is found."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.day.judge import Change, Journal, Look, Message, copies, lives, looks, marks, told
from benchmarks.day.script import COOL, HOT, MACHINES, MOVES, Expected, expected, plan, shown, traces
from gateway.machine.alarms.states import TRANSITIONS

LATE, RETRY = 140.0, 900.0
PLAIN = {state: state for state in {"normal", *MOVES.values()}}


@pytest.fixture(scope="module")
def must() -> Expected:
    script = plan(4.0)
    return expected(script, traces(script, 1), late=LATE, retry=RETRY)


@pytest.fixture(scope="module")
def journal(must: Expected) -> list[Change]:
    """A day as it must be: each row a second before it would be late."""
    rows = [
        Change(step.latest - 1.0, machine, alarm, step.state, step.by)
        for (machine, alarm), own in must.lives.items()
        for step in own
    ]
    return sorted(rows, key=lambda row: row.time)


def test_the_script_says_all_that_the_day_is_to_have(must: Expected) -> None:
    script = plan(4.0)
    assert {alarm for _, alarm in must.lives} == {
        *(f"{kind} {tag}" for kind in ("over limit", "rising") for tag in (HOT, COOL)),
        *(f"sensor frozen {COOL}", "link", "inputs bad", "northbound", "drift"),
    }
    # Only one bearing heats by itself; all of them do in the flood, and more than ten alarms come in ten minutes of it.
    alone = {key for key, own in must.lives.items() if key[1].startswith("over") and own[0].earliest < script.flood}
    assert alone == {("north", f"over limit {HOT}")}
    raised = [
        step.earliest
        for own in must.lives.values()
        for step in own
        if step.state == "unacknowledged" and step.earliest > script.flood
    ]
    assert len(raised) == 11 and max(raised) - min(raised) < 600.0
    with pytest.raises(ValueError, match=r"2 hours are too few .* give 4 or more"):
        plan(2.0)


@pytest.mark.benchmark
def test_a_longer_day_has_the_same_at_the_same_phase_of_its_cycles(must: Expected) -> None:
    script = plan(24.0)
    longer = expected(script, traces(script, 1), late=LATE, retry=RETRY)
    assert {key: [step.state for step in own] for key, own in longer.lives.items()} == {
        key: [step.state for step in own] for key, own in must.lives.items()
    }
    assert script.length == 86_400.0 and script.flood > 16 * 3600.0


def test_a_frozen_sensor_shows_one_value_while_the_others_go_on() -> None:
    script = plan(4.0)
    trace = traces(script, 1)["south"]
    seen = shown(script, "south", trace)
    frozen = (trace.times >= script.freeze[0]) & (trace.times < script.freeze[1])
    assert len(np.unique(seen[COOL][frozen])) == 1 and len(np.unique(seen[HOT][frozen])) > 100
    assert (seen[COOL][~frozen] == trace.signals[COOL][~frozen]).all()


def test_the_scripts_own_table_says_what_the_gateways_says() -> None:
    theirs = {(row.source.value, row.change.value, row.target.value) for row in TRANSITIONS}
    assert {(state, change, target) for (state, change), target in MOVES.items()} <= theirs


def test_a_day_as_it_must_be_has_no_finding(must: Expected, journal: Sequence[Change]) -> None:
    assert list(lives(must, journal)) == []


Spoiling = Callable[[list[Change]], list[Change]]
LINK = ("west", "link")


def _place(rows: Sequence[Change], state: str) -> int:
    return next(n for n, row in enumerate(rows) if (row.machine, row.alarm) == LINK and row.state == state)


def _without(rows: list[Change]) -> list[Change]:
    place = _place(rows, "returned unacknowledged")
    return [*rows[:place], *rows[place + 1 :]]


def _doubled(rows: list[Change]) -> list[Change]:
    place = _place(rows, "unacknowledged")
    return [*rows[: place + 1], *rows[place:]]


def _late(rows: list[Change]) -> list[Change]:
    place = _place(rows, "unacknowledged")
    return [*rows[:place], replace(rows[place], time=rows[place].time + 2.0), *rows[place + 1 :]]


def _swapped(rows: list[Change]) -> list[Change]:
    first, second = _place(rows, "unacknowledged"), _place(rows, "returned unacknowledged")
    rows[first], rows[second] = rows[second], rows[first]
    return rows


def _by_another(rows: list[Change]) -> list[Change]:
    place = _place(rows, "normal")
    return [*rows[:place], replace(rows[place], by="PLC"), *rows[place + 1 :]]


def _strange(rows: list[Change]) -> list[Change]:
    return [*rows, Change(rows[-1].time, "south", "records", "unacknowledged")]


def _impossible(rows: list[Change]) -> list[Change]:
    return [*rows, Change(rows[-1].time, "south", "anomaly", "acknowledged")]


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (_without, "west, link: returned unacknowledged is missing"),
        (_doubled, "west, link: unacknowledged at 3989 s comes twice"),
        (_late, "west, link: unacknowledged at 3991 s and not within 3840 to 3990 s"),
        (_swapped, "stands behind a row of"),
        (_by_another, "west, link: normal at .* by 'PLC' and not by 'operator'"),
        (_strange, "south, records: unacknowledged at .* was not to come"),
        (_impossible, "south, anomaly: acknowledged at .* comes after normal, which no move leads to"),
    ],
)
def test_what_is_wrong_with_a_journal_is_found(
    spoil: Spoiling, sentence: str, must: Expected, journal: Sequence[Change]
) -> None:
    findings = list(lives(must, spoil(list(journal))))
    assert findings
    with pytest.raises(AssertionError, match=sentence):
        raise AssertionError("\n".join(findings))


ROWS = [
    Message(machine, signal, 10.0 * number, (20.0 + number, "GOOD"))
    for number in range(20)
    for machine in MACHINES
    for signal in (HOT, COOL)
]
OUTAGE = (50.0, 90.0)
TOLD = [replace(row, historical=OUTAGE[0] <= row.time <= OUTAGE[1]) for row in ROWS]


def test_what_is_wrong_with_messages_is_found() -> None:
    assert list(copies("x", ROWS, TOLD, OUTAGE)) == [] and list(marks("x", TOLD, [(100.0, 200.0)])) == []
    (missing,) = copies("x", ROWS, TOLD[:7] + TOLD[8:], OUTAGE)
    assert missing == f"x: north, {COOL}: (21.0, 'GOOD') of 10.0 s is missing"
    (twice,) = copies("x", ROWS, [*TOLD[:8], *TOLD[7:]], OUTAGE)
    assert twice == f"x: north, {COOL}: (21.0, 'GOOD') of 10.0 s comes twice"
    swapped = [*TOLD[:1], TOLD[7], *TOLD[2:7], TOLD[1], *TOLD[8:]]
    (order,) = copies("x", ROWS, swapped, OUTAGE)
    assert order == f"x: north, {COOL}: (20.0, 'GOOD') of 0.0 s comes behind that of 10.0 s"
    changed = [replace(TOLD[0], content=(9.0, "GOOD")), *TOLD[1:]]
    assert sorted(copies("x", ROWS, changed, OUTAGE)) == [
        f"x: north, {HOT}: (20.0, 'GOOD') of 0.0 s is missing",
        f"x: north, {HOT}: (9.0, 'GOOD') of 0.0 s is not on record",
    ]
    unmarked = [replace(row, historical=False) for row in TOLD]
    assert len(list(copies("x", ROWS, unmarked, OUTAGE))) == 5 * 6
    wrongly = [*TOLD[:-1], replace(TOLD[-1], historical=True)]
    assert len(list(marks("x", wrongly, [(100.0, 200.0)]))) == 1


def shows(journal: Sequence[Change], *, every: float = 5.0) -> list[Look]:
    """What one sees who looks every so often."""
    book, found = Journal(journal), []
    for moment in np.arange(0.0, 15_000.0, every).tolist():
        for machine in MACHINES:
            states = {key[1]: book.between(key, moment, moment).pop() for key in book.alarms if key[0] == machine}
            shown = {alarm: state for alarm, state in states.items() if state != "normal"}
            found.append(Look(machine, moment, moment, shown))
    return found


def test_what_is_wrong_with_what_was_shown_is_found(journal: Sequence[Change]) -> None:
    book, seen = Journal(journal), shows(journal)
    assert list(looks("page", book, seen, lag=1.0, words=PLAIN)) == []
    never = [replace(look, states={a: s for a, s in look.states.items() if a != "link"}) for look in seen]
    findings = list(looks("page", book, never, lag=1.0, words=PLAIN))
    assert any("west, link: normal at" in text for text in findings)
    assert any("west, link: unacknowledged from" in text and "never shown" in text for text in findings)
    stale = [replace(look, begin=look.begin + 30.0, end=look.end + 30.0) for look in seen]
    assert list(looks("page", book, stale, lag=1.0, words=PLAIN))
    assert list(looks("page", book, stale, lag=31.0, words=PLAIN)) == []


def test_what_is_wrong_with_notifications_is_found(journal: Sequence[Change]) -> None:
    end = journal[-1].time + 1000.0
    beginning = [Change(0.0, *key, "normal") for key in Journal(journal).alarms]
    plain = [
        row
        for number, row in enumerate(journal)
        # A hidden alarm that comes and goes is told of by nothing but its history.
        if not (row.state == "shelved" and any(r.state == "shelved" for r in journal[:number]))
    ]
    right = [*beginning, *plain]
    assert list(told("opcua", journal, right, least=30.0, end=end)) == []
    (missing,) = told("opcua", journal, [row for row in right if row is not journal[0]], least=30.0, end=end)
    assert missing.endswith("is missing")
    place = next(n for n, row in enumerate(right) if row.state == "unacknowledged")
    (twice,) = told("opcua", journal, [*right[: place + 1], *right[place:]], least=30.0, end=end)
    assert "comes twice" in twice
    strange = [*right, Change(end, "west", "link", "acknowledged")]
    assert any("is not in the journal" in text for text in told("opcua", journal, strange, least=30.0, end=end))
