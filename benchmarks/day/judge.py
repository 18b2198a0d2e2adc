"""What came of a day against what must: nothing missing, nothing twice, in order. Pure; each finding is a sentence."""

from bisect import bisect_left, bisect_right
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import SequenceMatcher
from itertools import pairwise
from math import inf
from typing import Any

from benchmarks.day.script import MOVES, Expected, Step

Key = tuple[str, str]
"""A machine and the name of one of its alarms, or of another signal."""


@dataclass(frozen=True, slots=True)
class Change:
    """A row of the journal: an alarm of a machine came into a state (s of the day)."""

    time: float
    machine: str
    alarm: str
    state: str
    by: str = ""


@dataclass(frozen=True, slots=True)
class Message:
    """A row as it was handed on: its signal, its time (s of the day), and what it says. `historical`: so marked."""

    machine: str
    signal: str
    time: float
    content: Any
    historical: bool = False


@dataclass(frozen=True, slots=True)
class Look:
    """What alarms a machine showed between two moments (s of the day): those that are not normal."""

    machine: str
    begin: float
    end: float
    states: Mapping[str, str]


def lives(expected: Expected, journal: Sequence[Change]) -> Iterator[str]:
    """Each alarm's rows in the journal against those that it must have."""
    for before, after in pairwise(journal):
        if before.machine == after.machine and after.time < before.time:
            yield f"journal: {_named(after)} at {after.time:.0f} s stands behind a row of {before.time:.0f} s"
    own: dict[Key, list[Change]] = defaultdict(list)
    for row in journal:
        own[row.machine, row.alarm].append(row)
    for key in sorted({*own, *expected.lives}):
        must, rows = expected.lives.get(key), own[key]
        machine, alarm = key
        if must is None and alarm not in expected.may.get(machine, ()):
            yield from (f"journal: {_named(row)} at {row.time:.0f} s was not to come" for row in rows)
        elif must is None:
            yield from _moves(rows)
        else:
            yield from _against(key, must, rows)


def _against(key: Key, must: Sequence[Step], rows: Sequence[Change]) -> Iterator[str]:
    where = f"journal: {key[0]}, {key[1]}"
    matcher = SequenceMatcher(None, [step.state for step in must], [row.state for row in rows], autojunk=False)
    for what, first, last, begin, end in matcher.get_opcodes():
        if what == "equal":
            for step, row in zip(must[first:last], rows[begin:end], strict=True):
                if not step.earliest <= row.time <= step.latest:
                    span = f"{step.earliest:.0f} to {step.latest:.0f} s"
                    yield f"{where}: {row.state} at {row.time:.0f} s and not within {span}"
                # What goes by itself bears the name of who had acknowledged it.
                if step.by and not row.by.startswith(step.by):
                    yield f"{where}: {row.state} at {row.time:.0f} s by {row.by!r} and not by {step.by!r}"
            continue
        for step in must[first:last]:
            yield f"{where}: {step.state} is missing (from {step.earliest:.0f} s on)"
        for place in range(begin, end):
            row = rows[place]
            twice = any(
                other.state == row.state for other in (*rows[max(place - 1, 0) : place], *rows[place + 1 : place + 2])
            )
            yield f"{where}: {row.state} at {row.time:.0f} s {'comes twice' if twice else 'was not to come'}"


def _moves(rows: Sequence[Change]) -> Iterator[str]:
    state = "normal"
    for row in rows:
        if row.state not in {after for (before, _), after in MOVES.items() if before == state}:
            yield f"journal: {_named(row)} at {row.time:.0f} s comes after {state}, which no move leads to"
        state = row.state


def copies(name: str, must: Sequence[Message], got: Sequence[Message], outage: tuple[float, float]) -> Iterator[str]:
    """Rows as they were handed on against those on record: each once, in order, and marked by the outage alone.

    `outage` are the moments (s) between which a row can only have been handed on later.
    """
    by_signal: dict[Key, list[Message]] = defaultdict(list)
    for message in got:
        by_signal[message.machine, message.signal].append(message)
    record: dict[Key, list[Message]] = defaultdict(list)
    for message in must:
        record[message.machine, message.signal].append(message)
    for key in sorted({*by_signal, *record}):
        where = f"{name}: {key[0]}, {key[1]}"
        wanted = Counter((_moment(one.time), one.content) for one in record[key])
        found = Counter((_moment(one.time), one.content) for one in by_signal[key])
        for (time, content), count in (wanted - found).items():
            yield f"{where}: {content} of {time:.1f} s is missing{f' {count} times' if count > 1 else ''}"
        for (time, content), _ in (found - wanted).items():
            twice = (time, content) in wanted
            yield f"{where}: {content} of {time:.1f} s {'comes twice' if twice else 'is not on record'}"
        for before, after in pairwise(by_signal[key]):
            if after.time < before.time:
                yield f"{where}: {after.content} of {after.time:.1f} s comes behind that of {before.time:.1f} s"
        for one in by_signal[key]:
            if outage[0] <= one.time <= outage[1] and not one.historical:
                yield f"{where}: {one.content} of {one.time:.1f} s, in the outage, is not marked as historical"


def marks(name: str, got: Sequence[Message], quiet: Iterable[tuple[float, float]]) -> Iterator[str]:
    """Rows that are marked as historical within spans (s) in which there was neither an outage nor a beginning."""
    spans = list(quiet)
    for one in got:
        if one.historical and any(begin <= one.time <= end for begin, end in spans):
            yield f"{name}: {one.machine}, {one.signal}: {one.content} of {one.time:.1f} s is marked as historical"


class Journal:
    """The states of alarms over time, as the journal has them."""

    def __init__(self, journal: Sequence[Change]) -> None:
        self._times: dict[Key, list[float]] = defaultdict(list)
        self._states: dict[Key, list[str]] = defaultdict(list)
        for row in journal:
            self._times[row.machine, row.alarm].append(row.time)
            self._states[row.machine, row.alarm].append(row.state)

    @property
    def alarms(self) -> list[Key]:
        """Those that have a row."""
        return sorted(self._times)

    def between(self, key: Key, begin: float, end: float) -> set[str]:
        """The states in which an alarm was between two moments."""
        times, states = self._times.get(key, []), self._states.get(key, [])
        first, last = bisect_right(times, begin), bisect_right(times, end)
        return {"normal" if first == 0 else states[first - 1], *states[first:last]}

    def stays(self, key: Key, end: float) -> Iterator[tuple[str, float, float]]:
        """Each state with its begin and end."""
        times, states = self._times[key], self._states[key]
        yield from zip(states, times, [*times[1:], end], strict=True)


def looks(name: str, journal: Journal, seen: Sequence[Look], *, lag: float, words: Mapping[str, str]) -> Iterator[str]:
    """What was shown now and then against the journal: nothing else, and everything that stood for long enough.

    `lag` (s) is how old what is shown may be; `words` are what states are shown as, by their names.
    """
    for look in seen:
        shown = {*look.states, *(alarm for machine, alarm in journal.alarms if machine == look.machine)}
        for alarm in shown:
            may = {words[state] for state in journal.between((look.machine, alarm), look.begin - lag, look.end)}
            what = look.states.get(alarm, words["normal"])
            if what not in may:
                yield (
                    f"{name}: {look.machine}, {alarm}: {what} at {look.begin:.0f} s, "
                    f"where the journal has {' or '.join(sorted(may))}"
                )
    for machine in {machine for machine, _ in journal.alarms}:
        own = [look for look in seen if look.machine == machine]
        begins = [look.begin for look in own]
        gap = max((after - before for before, after in pairwise(begins)), default=inf)
        for key in journal.alarms:
            if key[0] != machine or not own:
                continue
            for state, begin, end in journal.stays(key, begins[-1]):
                if end - begin <= 2 * gap + lag:
                    continue
                within = own[bisect_left(begins, begin) : bisect_right(begins, end)]
                if all(look.states.get(key[1], words["normal"]) != words[state] for look in within):
                    yield f"{name}: {machine}, {key[1]}: {state} from {begin:.0f} to {end:.0f} s was never shown"


def told(name: str, journal: Sequence[Change], notes: Sequence[Change], *, least: float, end: float) -> Iterator[str]:
    """Notifications of states with their own times against the journal: each is a row of it, in its order, and every
    state that stood for `least` seconds was told of; `end` is when the last look was taken."""
    rows: dict[Key, list[Change]] = defaultdict(list)
    own: dict[Key, list[Change]] = defaultdict(list)
    for row in journal:
        rows[row.machine, row.alarm].append(row)
    for note in notes:
        own[note.machine, note.alarm].append(note)
    for key in sorted({*rows, *own}):
        where, place, seen = f"{name}: {key[0]}, {key[1]}", -1, set[int]()
        for note in own[key]:
            if note.state == "normal":
                # Of what is normal the time is that of the look.
                fits = [number for number, row in enumerate(rows[key]) if row.state == "normal" and number > place]
                fits = [number for number in fits if rows[key][number].time <= note.time + 1e-3][-1:]
                if not fits and place == -1:
                    continue  # as it was in the beginning
            else:
                fits = [
                    number
                    for number, row in enumerate(rows[key])
                    if row.state == note.state and abs(row.time - note.time) < 1e-3
                ]
            if not fits:
                yield f"{where}: {note.state} of {note.time:.0f} s is not in the journal"
                continue
            if fits[0] <= place:
                yield f"{where}: {note.state} of {note.time:.0f} s comes {'twice' if fits[0] == place else 'too late'}"
            place = max(place, fits[0])
            seen.add(fits[0])
        for number, row in enumerate(rows[key]):
            until = rows[key][number + 1].time if number + 1 < len(rows[key]) else end
            same = number > 0 and rows[key][number - 1].state == row.state
            if number not in seen and not same and until - row.time > least:
                yield f"{where}: {row.state} of {row.time:.0f} s is missing"


def _moment(time: float) -> float:
    """A time without what subtracting the day's beginning leaves of rounding."""
    return round(time, 5)


def _named(row: Change) -> str:
    return f"{row.machine}, {row.alarm}: {row.state}"
