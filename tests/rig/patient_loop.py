"""An event loop whose clock stands still while the computer gives it no time.

Of a loop that was frozen for half a second by what else the machine does, both the reply that lay ready and the
deadline that has passed meanwhile are due at once, and the deadline wins: the reply still needs some turns of the loop
to reach who waits for it. On this loop each turn counts `TURN_S` at most, however long it took. What peer and driver do
to each other in one loop then happens in the order in which it does on a quiet machine, with the same deadlines; where
the machine is quiet the clock runs as any other.
"""

import asyncio
import selectors
import time

TURN_S = 0.005
"""The most (s) by which one turn of the loop moves its clock on: less than any deadline of a test, and over ten times
what a turn takes on a quiet machine."""


class PatientSelector(selectors.DefaultSelector):
    """Waits in pieces of at most TURN_S, and counts of each no more than that."""

    def __init__(self) -> None:
        super().__init__()
        self._counted = self._seen = time.monotonic()

    def now(self) -> float:
        """Seconds that the loop was given, in those of the monotonic clock at its start."""
        return self._counted + min(time.monotonic() - self._seen, TURN_S)

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """As of any selector; nothing after a piece says only that the loop shall ask again."""
        ready = super().select(TURN_S if timeout is None else min(timeout, TURN_S))
        now = time.monotonic()
        self._counted, self._seen = self._counted + min(now - self._seen, TURN_S), now
        return ready


class PatientLoop(asyncio.SelectorEventLoop):
    """asyncio's own loop by the clock of a PatientSelector."""

    def __init__(self) -> None:
        self._patience = PatientSelector()
        super().__init__(self._patience)

    def time(self) -> float:
        return self._patience.now()
