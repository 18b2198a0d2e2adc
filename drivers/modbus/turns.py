"""Who may send next on a connection that several units share, and which of them is too silent to be asked."""

import asyncio
from collections import deque
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass

from drivers.modbus.plan import retry_delay

URGENT_IN_A_ROW = 8
"""So many urgent turns are given one after another while something else waits; then that has one."""
AT_ONCE = 0.0
LONG_PROBE = 8
"""Each so-many-th question to a silent unit has the whole deadline: the unit may have become slower than the others."""


@dataclass(slots=True)
class _Place:
    """One who waits; `probe`: for a unit that is taken to be silent."""

    unit: int
    urgent: bool
    probe: bool
    granted: "asyncio.Future[None]"


class Turns:
    """Turns for the units of one connection: at most `outstanding` at a time, round robin by unit.

    What is urgent (a write and its reading back) goes before what is not, in turns among themselves. Of silent units
    one is asked at a time, so that with `outstanding` 2 or more their waits hold nobody up.
    """

    def __init__(self, outstanding: int) -> None:
        self.outstanding = outstanding
        self._taken = self._probes = self._urgent_in_a_row = 0
        self._waiting: dict[int, deque[_Place]] = {}
        # Its order is the rotation: whose turn was longest ago stands first.
        self._order: dict[int, None] = {}

    @asynccontextmanager
    async def turn(self, unit: int, *, urgent: bool, probe: bool) -> AsyncIterator[None]:
        """Wait for a turn of the unit and hold it."""
        place = _Place(unit, urgent, probe, asyncio.get_running_loop().create_future())
        self._order.setdefault(unit)
        self._waiting.setdefault(unit, deque()).append(place)
        self._grant()
        try:
            await place.granted
            yield
        finally:
            if place.granted.done() and not place.granted.cancelled():
                self._taken -= 1
                self._probes -= place.probe
            else:
                self._waiting[unit].remove(place)
            self._grant()

    def _grant(self) -> None:
        while self._taken < self.outstanding and (place := self._next()) is not None:
            self._waiting[place.unit].remove(place)
            self._order[place.unit] = self._order.pop(place.unit)
            self._taken += 1
            self._probes += place.probe
            self._urgent_in_a_row = self._urgent_in_a_row + 1 if place.urgent else 0
            place.granted.set_result(None)

    def _next(self) -> _Place | None:
        """The first in the rotation, of the urgent ones if there are any and their row is not too long."""
        eligible = [
            place
            for unit in self._order
            for place in self._waiting.get(unit, ())
            if not place.granted.done() and not (place.probe and self._probes)
        ]
        preferred = self._urgent_in_a_row < URGENT_IN_A_ROW
        return next((place for place in eligible if place.urgent is preferred), eligible[0] if eligible else None)


@dataclass(slots=True)
class UnitHealth:
    """Whether a unit answers; times are the loop's. `connection` is the number of the one on which it did last.

    `doubted_since`: an answer of another unit after this moment says that the connection is not to blame.
    """

    connection: int = 0
    doubted_since: float = 0.0
    failures: int = 0
    waited: float = 0.0
    silent_since: float | None = None
    probes: int = 0
    retry_at: float = 0.0

    @property
    def silent(self) -> bool:
        """True for a unit that is asked rarely until it answers."""
        return self.silent_since is not None

    def answered(self, connection: int) -> None:
        """It has answered, over this connection."""
        self.connection, self.failures, self.waited = connection, 0, 0.0
        self.silent_since, self.probes = None, 0

    def failed(self, asked_at: float, waited: float) -> None:
        """No valid answer came to what was asked then, after `waited` seconds."""
        if not self.failures:
            self.doubted_since = asked_at
        self.failures += 1
        self.waited += waited

    def avoid(self, now: float, first: float, cap: float) -> None:
        """Ask it rarely from now on: after `first` seconds, then after twice as long each time, up to `cap`."""
        if self.silent_since is None:
            self.silent_since = now
        self.probes += 1
        self.doubted_since, self.retry_at = now, now + retry_delay(self.probes, first, cap)

    def heard(self) -> None:
        """Something of it has come too late for its question: it is there, and is asked at once with all patience."""
        if self.silent:
            self.retry_at, self.probes = AT_ONCE, LONG_PROBE

    def probe_patience(self, deadline: float, usual: float) -> float:
        """How long a silent unit is waited for, in the others' time: what is `usual` on this connection.

        Each eighth time the whole deadline.
        """
        return deadline if self.probes % LONG_PROBE == 0 else min(deadline, usual)


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
