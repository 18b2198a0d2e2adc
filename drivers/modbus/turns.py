"""Who may send next on a connection that several units share, and which of them is too silent to be asked."""

import asyncio
from collections import deque
from dataclasses import dataclass, field

from drivers.modbus.plan import retry_delay

URGENT_IN_A_ROW = 8
"""So many urgent turns are given one after another while something else waits; then that has one."""
RETRY_AT_ONCE_S = 0.0
SHORT_WAIT_S = 0.05
"""A unit that has failed while others answer is waited for so long at least."""
LONG_PROBE_INTERVAL = 8
"""Each so-many-th question to a silent unit has the whole deadline: the unit may have become slower than the others."""


@dataclass(slots=True)
class _Waiter:
    """One who waits; `probe`: for a unit that is silent, or failed last while others answered."""

    unit: int
    urgent: bool
    probe: bool
    granted: "asyncio.Future[None]"


class Turns:
    """Turns for the units of one connection: at most `outstanding` at a time, by the time that each has had.

    Who waits goes in the order of start-time fair queueing (Goyal, Vin & Cheng 1996): a unit that holds the connection
    ten times as long has a tenth of the turns where there is not time for all, and one that was idle has no claim to
    what it did not use. Equal ones go round. What is urgent (a write and its reading back) goes before what is not. One
    probe is under way at a time, so that with `outstanding` 2 or more the waits of silent units hold nobody up.
    """

    def __init__(self, outstanding: int) -> None:
        self.outstanding = outstanding
        self._taken = self._probes = self._urgent_in_a_row = 0
        self._waiting: dict[int, deque[_Waiter]] = {}
        self._places = 0
        # Its order is the rotation: whose turn was longest ago stands first.
        self._order: dict[int, None] = {}
        # Virtual time (s): of the turn granted last, and until when each unit has had its share.
        self._now = 0.0
        self._had: dict[int, float] = {}

    def turn(self, unit: int, *, urgent: bool, probe: bool) -> "Turn":
        """A turn of the unit, to be waited for and held by `async with`."""
        return Turn(self, unit, urgent=urgent, probe=probe)

    async def take(self, unit: int, *, urgent: bool, probe: bool) -> bool:
        """Wait for a turn of the unit, which `end_turn` ends; True if it had to be waited for."""
        had = self._had.get(unit, 0.0)
        if not self._places and self._taken < self.outstanding and not (probe and self._probes):
            # Nobody else waits, as nearly always: what `_grant` would come to.
            self._had[unit] = max(had, self._now)
            self._note_grant(unit, urgent=urgent, probe=probe)
            return False
        place = _Waiter(unit, urgent, probe, asyncio.get_running_loop().create_future())
        self._order.setdefault(unit)
        queue = self._waiting.setdefault(unit, deque())
        if not queue:
            self._had[unit] = max(had, self._now)
        queue.append(place)
        self._places += 1
        self._grant()
        try:
            await place.granted
        except asyncio.CancelledError:
            if place.granted.cancelled():
                queue.remove(place)
                self._places -= 1
                self._grant()
            else:
                self.end_turn(unit, 0.0, probe=probe)
            raise
        return True

    def end_turn(self, unit: int, seconds: float, *, probe: bool) -> None:
        """End a turn that was held for so long."""
        self._had[unit] += seconds
        self._taken -= 1
        self._probes -= probe
        if self._places:
            self._grant()

    @property
    def busy(self) -> bool:
        """True while somebody has a turn."""
        return self._taken > 0

    def _grant(self) -> None:
        while self._taken < self.outstanding and (place := self._next()) is not None:
            self._waiting[place.unit].remove(place)
            self._places -= 1
            self._note_grant(place.unit, urgent=place.urgent, probe=place.probe)
            place.granted.set_result(None)

    def _note_grant(self, unit: int, *, urgent: bool, probe: bool) -> None:
        self._order.pop(unit, None)
        self._order[unit] = None
        self._taken += 1
        self._now = max(self._now, self._had[unit])
        self._probes += probe
        self._urgent_in_a_row = self._urgent_in_a_row + 1 if urgent else 0

    def _next(self) -> _Waiter | None:
        """Whose unit has had least, of the urgent ones if there are any and their row is not too long."""
        eligible = [
            place
            for unit in sorted(filter(self._waiting.get, self._order), key=self._had.__getitem__)
            for place in self._waiting[unit]
            if not place.granted.done() and not (place.probe and self._probes)
        ]
        preferred = self._urgent_in_a_row < URGENT_IN_A_ROW
        return next((place for place in eligible if place.urgent is preferred), eligible[0] if eligible else None)


class Turn:
    """A turn of a unit: waited for when it is entered, held until it is left. `waited`: it was not to be had at once.

    A class, since a context manager made of a generator costs several times as much, three times a scan.
    """

    __slots__ = ("_begun", "_probe", "_turns", "_unit", "_urgent", "waited")

    def __init__(self, turns: Turns, unit: int, *, urgent: bool, probe: bool) -> None:
        self._turns, self._unit, self._urgent, self._probe = turns, unit, urgent, probe
        self._begun, self.waited = 0.0, False

    async def __aenter__(self) -> "Turn":
        self.waited = await self._turns.take(self._unit, urgent=self._urgent, probe=self._probe)
        self._begun = asyncio.get_running_loop().time()
        return self

    async def __aexit__(self, *_error: object) -> None:
        held = asyncio.get_running_loop().time() - self._begun
        self._turns.end_turn(self._unit, held, probe=self._probe)


@dataclass(slots=True)
class UnitHealth:
    """Whether a unit answers; times are the loop's.

    ::

        answering --no valid reply--> failing --too often, while others answer--> silent
            ^                            |                                        |   ^ a probe fails: the next one
            |         a reply            |                a reply                 |   | after twice as long
            +----------------------------+----------------------------------------+---+

    A silent unit is probed at `retry_at`; at once, and with all patience (`late`), where something of it has come after
    its time. In each state it rests where it has `wasted` more of the others' time than a whole reading takes.

    `connection` is the number of the one on which it answered last, `asked_at` is when its newest question was first
    sent, `times` are its own replies'. An answer of another unit after `failing_since` says that the connection is not
    to blame.
    """

    connection: int = 0
    asked_at: float = 0.0
    times: "ReplyTimes" = field(default_factory=lambda: ReplyTimes())
    late: bool = False
    wasted: "WastedTime" = field(default_factory=lambda: WastedTime())
    failing_since: float = 0.0
    failures: int = 0
    waited: float = 0.0
    silent_since: float | None = None
    probes: int = 0
    retry_at: float = 0.0

    @property
    def silent(self) -> bool:
        """True for a unit that is asked rarely until it answers."""
        return self.silent_since is not None

    def note_answer(self, connection: int) -> None:
        """It has answered, over this connection."""
        self.connection, self.failures, self.waited = connection, 0, 0.0
        self.silent_since, self.probes, self.late = None, 0, False

    def failed(self, asked_at: float, waited: float) -> None:
        """No valid answer came to what was asked then, after `waited` seconds."""
        if not self.failures:
            self.failing_since = asked_at
        self.failures += 1
        self.waited += waited

    def avoid(self, now: float, first: float, cap: float) -> None:
        """Ask it rarely from now on: after `first` seconds, then after twice as long each time, up to `cap`."""
        if self.silent_since is None:
            self.silent_since = now
        self.probes += 1
        self.late, self.failing_since, self.retry_at = False, now, now + retry_delay(self.probes, first, cap)

    def note_late_answer(self) -> None:
        """Something of it has come too late for its question: it is there, and is asked at once with all patience."""
        if self.silent:
            self.retry_at, self.late = RETRY_AT_ONCE_S, True

    def patience(self, deadline: float, longest: float, usual: float) -> float:
        """How long to wait in the others' time for a unit that has failed while they answered.

        As long as its replies take as a rule, `usual` where it has given none; where something has come too late as
        long as for a whole reading, `longest`; each eighth question to a silent unit has the whole `deadline`.
        """
        if self.late:
            return longest
        if self.silent and self.probes % LONG_PROBE_INTERVAL == 0:
            return deadline
        return min(deadline, max(SHORT_WAIT_S, self.times.usual or usual))


@dataclass(slots=True)
class WastedTime:
    """Seconds for which the connection was held for a unit in vain: a leaky bucket, `level` (s) at `at` (loop's time).

    It leaks by time, of which its `share` is the unit's own. What was waited is put in once others have answered on the
    same connection: until then the connection may be to blame.
    """

    level: float = 0.0
    at: float = 0.0
    waited: float = 0.0
    connection: int = 0

    def wait(self, seconds: float, connection: int) -> None:
        """So long has been waited in vain over this connection; it is put in, or forgotten, later."""
        if connection != self.connection:
            self.connection, self.waited = connection, 0.0
        self.waited += seconds

    def fill(self, now: float, share: float, most: float, seconds: float = 0.0) -> None:
        """Put in what was waited, and `seconds` beyond it; never to more than `most`."""
        self.level, self.at = min(most, self._current_level(now, share) + self.waited + seconds), now
        self.waited = 0.0

    def rest(self, now: float, share: float, free: float) -> float:
        """Seconds until the level is no more than `free`."""
        return max(0.0, self._current_level(now, share) - free) / share

    def _current_level(self, now: float, share: float) -> float:
        return max(0.0, self.level - share * (now - self.at))


@dataclass(slots=True)
class Stall:
    """Nobody has answered since this unit's question, which was given up `since` (loop's time).

    `others`: another unit's question has been given up meanwhile.
    """

    unit: int
    since: float
    others: bool = False


@dataclass(frozen=True, slots=True)
class Suspect:
    """The unit with whose question the last connection ended: it is asked after another one, or at `until`.

    `stalled`: the connection stood still after the question; otherwise it was closed or made unreadable under it.
    """

    unit: int
    until: float
    stalled: bool


class ReplyTimes:
    """How long replies take on a connection: a smoothed mean and deviation, as TCP times its own (RFC 6298, 2)."""

    def __init__(self) -> None:
        self._mean = self._deviation = 0.0

    def take(self, seconds: float) -> None:
        """A reply has come after so many seconds."""
        if not self._mean:
            self._mean, self._deviation = seconds, seconds / 2
            return
        self._deviation += (abs(seconds - self._mean) - self._deviation) / 4
        self._mean += (seconds - self._mean) / 8

    @property
    def usual(self) -> float:
        """Seconds within which nearly all replies come."""
        return self._mean + 4 * self._deviation
