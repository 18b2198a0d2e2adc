"""Whatever happens in whatever order: no alarm leaves the table, none vanishes unseen, every shelving ends."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from drivers.tag import Quality, Sample
from gateway.machine.alarms import HIDDEN, TRANSITIONS, AlarmBoard, AlarmError, AlarmState, Change
from gateway.machine.alarms.states import UNSEEN, AlarmCondition
from gateway.machine.reading import Scan

NAME, LIMIT, LONGEST = "over limit T", 80.0, 600.0
MOVES = {(row.source, row.target) for row in TRANSITIONS}
ACKNOWLEDGED_FROM = {
    AlarmState.UNACKNOWLEDGED: (AlarmState.ACKNOWLEDGED,),
    AlarmState.RETURNED: (AlarmState.NORMAL,),
    AlarmState.LATCHED_UNACKNOWLEDGED: (AlarmState.LATCHED_ACKNOWLEDGED,),
}
"""What becomes of a state by an acknowledgement, and by nothing else."""


class Kept:
    """A historian in memory: rows, and the newest state by its key, as JSON."""

    def __init__(self) -> None:
        self.rows: list[tuple[str, tuple[Any, ...]]] = []
        self.states: dict[str, tuple[float, str]] = {}

    def put(self, table: str, rows: Iterable[tuple[Any, ...]]) -> None:
        self.rows += [(table, row) for row in rows]

    def save(self, key: str, now: float, content: Mapping[str, Any]) -> None:
        self.states[key] = (now, json.dumps(content))

    def load(self, key: str) -> tuple[float, Any] | None:
        return (self.states[key][0], json.loads(self.states[key][1])) if key in self.states else None


class AlarmLife(RuleBasedStateMachine):
    """One alarm on a board, and beside it what a person who looks on has a right to know."""

    @initialize(latches=st.booleans(), on_delay=st.sampled_from((0.0, 3.0)), off_delay=st.sampled_from((0.0, 5.0)))
    def begin(self, latches: bool, on_delay: float, off_delay: float) -> None:
        self.condition = AlarmCondition(
            NAME, "T", bit=0, limit=LIMIT, deadband=2.0, on_delay=on_delay, off_delay=off_delay,
            latches=latches, suppressed_by=("Stopped", 1.0),
        )  # fmt: skip
        self.kept, self.now, self.skipped = Kept(), 1000.0, 0.0
        self.values: dict[str, float | None] = {"T": 20.0, "Stopped": 0.0, "AcknowledgeBits": 0.0, "Button": 0.0}
        self.board = self.opened()
        self.seen, self.heard = True, AlarmState.NORMAL

    def opened(self) -> AlarmBoard:
        board = AlarmBoard(
            {NAME: self.condition},
            watched=("T",),
            words={"AcknowledgeBits": frozenset({"T"})},
            historian=self.kept,  # type: ignore[arg-type]
            log=Silent(),  # type: ignore[arg-type]
            now=self.now + self.skipped,
            acknowledge_all="Button",
        )
        board.listeners.append(lambda _, before, after: self.told(before.state, after.state))
        return board

    def told(self, before: AlarmState, after: AlarmState) -> None:
        assert before == self.heard and (before, after) in MOVES
        self.heard = after
        # What latches and came where nobody was shown it comes out unseen, too.
        if after is AlarmState.UNACKNOWLEDGED or (before in HIDDEN and after in UNSEEN):
            self.seen = False
        elif before in UNSEEN and after in ACKNOWLEDGED_FROM.get(before, ()):
            self.seen = True

    @property
    def state(self) -> AlarmState:
        return self.board.alarms[NAME].state

    def scan(self, seconds: float = 1.0) -> None:
        self.now += seconds
        time = self.now + self.skipped
        samples = {
            name: Sample(name, value, Quality.GOOD if value is not None else Quality.TIMEOUT, time)
            for name, value in self.values.items()
        }
        self.board.take_readings(Scan(number=0, time=time, samples=samples, missed=0, duration=0.0))

    @rule(value=st.sampled_from((None, 20.0, 79.0, 81.0, 90.0)), seconds=st.sampled_from((0.5, 1.0, 4.0, 30.0, 700.0)))
    def read(self, value: float | None, seconds: float) -> None:
        self.values["T"] = value
        self.scan(seconds)

    @rule(stopped=st.sampled_from((None, 0.0, 1.0)))
    def design(self, stopped: float | None) -> None:
        self.values["Stopped"] = stopped
        self.scan()

    @rule(tag=st.sampled_from(("Button", "AcknowledgeBits")))
    def plc(self, tag: str) -> None:
        self.scan()
        self.values[tag] = 1.0
        self.scan()
        self.values[tag] = 0.0
        self.scan()

    @rule(tag=st.sampled_from(("Button", "AcknowledgeBits")), value=st.sampled_from((20.0, 90.0)))
    def plc_at_the_very_moment(self, tag: str, value: float) -> None:
        self.values |= {"T": value, tag: 1.0}
        self.scan()
        self.values[tag] = 0.0
        self.scan()

    @rule(change=st.sampled_from(list(Change)[2:]), seconds=st.floats(1.0, LONGEST))
    def person(self, change: Change, seconds: float) -> None:
        if change in (Change.SUPPRESS, Change.UNSUPPRESS):
            return
        before, moment = self.state, self.now + self.skipped
        until = moment + seconds if change is Change.SHELVE else None
        try:
            self.board.change(NAME, change, moment, by="Ada", reason="test", until=until)
        except AlarmError:
            assert self.state is before
            return

    @rule(jump=st.sampled_from((0.0, 5.0, -100_000.0, 400.0, 1e7)))
    def restart(self, jump: float) -> None:
        """The gateway is begun anew, under a clock that may have been set meanwhile."""
        self.board.save(self.now + self.skipped)
        self.skipped += jump
        before = self.board.alarms[NAME]
        self.board = self.opened()
        after = self.board.alarms[NAME]
        # Of an alarm that never moved nothing is kept, not even since when.
        unmoved = {"since": 0.0} if "alarms" not in self.kept.states else {}
        plain: dict[str, Any] = {"until": None, "pending": None, **unmoved}
        assert replace(after, **plain) == replace(before, **plain)
        assert (after.until is None) == (before.until is None)

    @invariant()
    def no_alarm_is_gone_unseen(self) -> None:
        if self.state in (AlarmState.NORMAL, AlarmState.ACKNOWLEDGED, AlarmState.LATCHED_ACKNOWLEDGED):
            assert self.seen
        if self.state in UNSEEN:
            assert not self.seen
        assert self.board.word("T") == int(self.board.alarms[NAME].active)

    @invariant()
    def every_shelving_ends(self) -> None:
        alarm = self.board.alarms[NAME]
        assert (alarm.until is not None) == (alarm.state is AlarmState.SHELVED)
        if alarm.until is not None:
            assert alarm.until - (self.now + self.skipped) <= LONGEST

    @invariant()
    def the_journal_has_it(self) -> None:
        rows = [row for table, row in self.kept.rows if table == "alarms"]
        assert self.state.value == (rows[-1][4] if rows else "normal") and self.heard is self.state


class Silent:
    """A log that nobody reads."""

    def __getattr__(self, _: str) -> Any:
        return lambda *_args, **_keys: None


def test_an_alarm_that_comes_off_the_shelf_while_it_waits_is_as_it_was_after_a_restart() -> None:
    life = AlarmLife()
    life.begin(latches=False, on_delay=3.0, off_delay=5.0)
    life.read(value=81.0, seconds=0.5)
    life.design(stopped=None)
    life.person(change=Change.SHELVE, seconds=3.0)
    life.plc_at_the_very_moment(tag="Button", value=90.0)
    life.plc_at_the_very_moment(tag="Button", value=20.0)
    life.restart(jump=0.0)


AlarmLife.TestCase.settings = settings(max_examples=25, stateful_step_count=30, deadline=None)
TestAlarmLife = AlarmLife.TestCase
