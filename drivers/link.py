"""One owner for one connection: connect within a deadline, back off, notice a dead peer, reopen.

It knows no protocol: it is given `connect` and `disconnect`, and is told how each exchange went. Times are seconds.
"""

import asyncio
import random
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Generic, TypeVar

from drivers.errors import DriverError, LinkDown, LinkFault
from drivers.supervision import Supervisor

C = TypeVar("C")

UNDOUBLED_CONNECTIONS = 4
"""So many connections that a peer takes and never answers are given up by the rule alone: it may be starting up."""
HESITATIONS_S = (0.0, 0.0, 0.6, 1.2, 2.4, 3.0)
"""Seconds before the first question on a connection, by how many in a row before it brought no answer."""
MOST_DOUBLINGS = 3
"""Those after them are held for twice as long each time, at last for eight times the rule's silence."""


@dataclass(frozen=True, slots=True)
class Backoff:
    """Pause before the next attempt: `first`, doubling up to `cap`, each times 1 - jitter .. 1 + jitter.

    The default cap keeps the promise of a reconnection within 1 s of the peer's return: cap * (1 + jitter) and one
    connect deadline of 0.3 s are 0.9 s together.
    """

    first: float = 0.2
    cap: float = 0.5
    jitter: float = 0.2

    def delay(self, failures: int, rng: random.Random) -> float:
        """The pause after `failures` (1..) failed attempts in a row."""
        # The power is bounded: 2.0 ** 1024 is beyond any float, and a peer may be away for that many attempts.
        plain = min(self.cap, self.first * 2.0 ** min(failures - 1, 30))
        return plain * (1.0 + self.jitter * rng.uniform(-1.0, 1.0))

    @property
    def longest(self) -> float:
        """No pause is longer."""
        return self.cap * (1.0 + self.jitter)


@dataclass(frozen=True, slots=True)
class DeadPeer:
    """When a silent peer is given up: so many failed exchanges in a row, or so long asked without a valid reply."""

    max_failures: int = 3
    max_silence: float = 2.0


class Link(Generic[C]):
    """Keeps one connection up between `open` and `close`, by one task of its own, which the `supervisor` keeps going.

    `connect` makes a connection or raises DriverError or OSError; it is cancelled at `connect_deadline`. `disconnect`
    lets one go, at once. The user of the link takes `connection`, and reports each exchange over it with `note_answer`,
    `failed` or `lost`; reports about a connection that was already replaced are ignored.
    """

    def __init__(
        self,
        connect: Callable[[], Awaitable[C]],
        disconnect: Callable[[C], None],
        *,
        connect_deadline: float,
        backoff: Backoff,
        dead_peer: DeadPeer,
        seed: int,
        supervisor: Supervisor | None = None,
    ) -> None:
        self._connect = connect
        self._disconnect = disconnect
        self._connect_deadline = connect_deadline
        self._backoff = backoff
        self._dead_peer = dead_peer
        self._supervisor = supervisor or Supervisor()
        # Jitter keeps clients of one device apart; nobody needs to be unable to guess it.
        self._rng = random.Random(seed)  # noqa: S311
        self._task: asyncio.Task[None] | None = None
        self._wake = asyncio.Event()
        self._tried = asyncio.Event()
        self._connection: C | None = None
        self._proven = False
        self._failures = 0
        self._silence = 0.0
        self._attempts_in_a_row = self._silent_in_a_row = 0
        self._tried_at = 0.0
        self._hesitated = self._learned = 0.0
        self._reason, self.fault = "not opened", LinkFault.OTHER
        # Attempts that have ended, and whether the next one waits until it is asked for.
        self._ended, self._resting = 0, False
        self._counts = {"attempts": 0, "connects": 0, "losses": 0, "dead_peers": 0}

    # ------------------------------------------------------------ for the owner

    async def open(self) -> None:
        """Start and wait for the first attempt. Raises LinkDown if it failed; the link goes on trying."""
        if self._task is None:
            self._tried.clear()
            self._attempts_in_a_row = 0
            self._task = self._supervisor.task("link", self._keep)
        await self._tried.wait()
        if self._connection is None:
            raise LinkDown(self._reason, fault=self.fault)

    async def close(self) -> None:
        """Stop trying and let the connection go. May be called twice, and before `open`."""
        task, self._task = self._task, None
        if task is not None:
            task.cancel()
            await asyncio.wait({task})
        self._drop("closed")
        self._tried.set()

    def wake(self) -> None:
        """Try at once instead of waiting for the end of the pause."""
        self._wake.set()

    def rest(self) -> None:
        """Let the connection go and make no other one before `renew`: others may have it meanwhile."""
        connection, self._connection = self._connection, None
        if connection is not None:
            self._resting, self._reason = True, "closed until the next reading"
            self._disconnect(connection)

    async def renew(self) -> C | None:
        """The connection; where there is none the outcome of an attempt that is made now, or is under way."""
        ended, self._resting = self._ended, False
        while self._connection is None and self._ended == ended and self._task is not None:
            self._tried.clear()
            self._wake.set()
            await self._tried.wait()
        return self._connection

    # ------------------------------------------------------------ for the user

    @property
    def connection(self) -> C | None:
        """The connection, or None while there is none."""
        return self._connection

    @property
    def proven(self) -> bool:
        """True while the present connection has given a valid reply and no exchange since has failed the rule."""
        return (self._connection is not None or self._resting) and self._proven

    @property
    def reason(self) -> str:
        """Why there is no connection, in words; empty while there is one."""
        return self._reason

    @property
    def connects(self) -> int:
        """How many connections have been made: it tells one from the next."""
        return self._counts["connects"]

    def patience(self, deadline: float) -> float:
        """How long to wait for this reply: the deadline, or less where the rule's silence ends before it."""
        return max(0.0, min(deadline, self._longest_silence - self._silence))

    @property
    def _longest_silence(self) -> float:
        """What silence ends this connection: longer each time for a peer that takes connections and answers none.

        A PLC whose program stands still collects the connections in its system, and has to serve them all when it
        wakes. The one that is open is answered then, so that holding on to it costs no time.
        """
        doublings = min(max(0, self._silent_in_a_row - UNDOUBLED_CONNECTIONS), MOST_DOUBLINGS)
        return float(self._dead_peer.max_silence * 2.0**doublings)

    @property
    def hesitation(self) -> float:
        """Seconds to wait after a connection before the first question on it.

        A device may answer nothing for a while after a connection was made, and each new one begins that anew: so the
        pause grows with each connection in a row that brought no answer. The one that brought one is kept, and tried
        next where a connection was silent again: a peer that was away for once is asked at once.
        """
        pause = HESITATIONS_S[min(self._silent_in_a_row, len(HESITATIONS_S) - 1)]
        return max(pause, self._learned) if self._silent_in_a_row else pause

    def hesitate(self, pause: float) -> None:
        """So long has been waited before the first question on this connection."""
        self._hesitated = pause

    @property
    def suspect(self) -> bool:
        """True while the connections before this one, and this one so far, were taken and never answered."""
        return self._silent_in_a_row > 0 and not self._proven

    def note_answer(self, connection: C) -> None:
        """A valid reply has come over this connection."""
        if connection is self._connection:
            if not self._proven and self._hesitated and self._silent_in_a_row:
                self._learned = self._hesitated
            self._proven = True
            self._failures = self._attempts_in_a_row = self._silent_in_a_row = 0
            self._silence = 0.0

    def failed(self, connection: C, waited: float, reason: str) -> None:
        """An exchange gave no valid reply after `waited` seconds; by the dead-peer rule this may end the connection."""
        if connection is not self._connection:
            return
        self._failures += 1
        self._silence += waited
        rule = self._dead_peer
        # A millisecond early: `patience` lets the last wait end with the silence, and a timer may end just before it.
        many = self._failures >= rule.max_failures and self._silent_in_a_row <= UNDOUBLED_CONNECTIONS
        if many or self._silence >= self._longest_silence - 1e-3:
            self._counts["dead_peers"] += 1
            self._silent_in_a_row += 1
            count = "1 exchange" if self._failures == 1 else f"{self._failures} exchanges in a row"
            self._drop(f"the peer is dead: {count} without a valid reply, {self._silence:.2f} s waited ({reason})")

    def lost(self, connection: C, reason: str, fault: LinkFault = LinkFault.OTHER) -> None:
        """This connection is gone or no longer usable."""
        if connection is self._connection:
            self.fault = fault
            self._drop(reason)

    def statistics(self) -> Mapping[str, float]:
        """Counters: connection attempts, connections made, losses, and how many of those were dead peers.

        `pause_after_connect`: what the peer has been seen to need, in seconds.
        """
        return {**self._counts, "pause_after_connect": self._learned}

    # ------------------------------------------------------------ the one task

    async def _keep(self) -> None:
        # `close` forgets the task before it cancels it: a cancellation that arrives in the very step in which a
        # connection is made is swallowed by asyncio.wait_for of Python 3.11.
        while self._task is not None:
            if self._connection is not None or self._resting:
                await self._wake.wait()
            elif self._attempts_in_a_row:
                await self._pause(self._tried_at + self._backoff.delay(self._attempts_in_a_row, self._rng))
                await self._attempt()
            else:
                await self._attempt()
            self._wake.clear()
            self._tried.set()

    async def _attempt(self) -> None:
        self._counts["attempts"] += 1
        self._attempts_in_a_row += 1
        self.fault = LinkFault.OTHER
        try:
            async with asyncio.timeout(self._connect_deadline):
                connection = await self._connect()
        except TimeoutError:
            self._reason, self.fault = f"no connection within {self._connect_deadline:g} s", LinkFault.SILENT
        except (DriverError, OSError) as error:
            self._reason = str(error)
            self.fault = error.fault if isinstance(error, LinkDown) else LinkFault.OTHER
        except Exception as error:
            # The supervisor's to say and to begin anew; whoever waits for this attempt is not to wait for ever.
            self._reason = f"the connection could not be made: {error!r}"
            self._ended += 1
            self._tried.set()
            raise
        else:
            self._take(connection)
        self._ended += 1
        self._tried_at = asyncio.get_running_loop().time()

    def _take(self, connection: C) -> None:
        self._connection = connection
        self._counts["connects"] += 1
        self._proven, self._hesitated = False, 0.0
        self._failures = 0
        self._silence = 0.0
        self._reason = ""

    async def _pause(self, until: float) -> None:
        """Wait for the loop's time or for `wake`: what a silent connection has lasted is not waited again."""
        with suppress(TimeoutError):
            async with asyncio.timeout_at(until):
                await self._wake.wait()

    def _drop(self, reason: str) -> None:
        """Let the connection go and wake the supervisor, which tries again.

        After a connection that had worked it tries at once. One that never gave a valid reply was a failed attempt like
        any other, or a peer that accepts and closes would be called in a tight loop.
        """
        connection, self._connection = self._connection, None
        self._reason = reason
        if connection is None:
            return
        self._counts["losses"] += 1
        self._proven = False
        self._disconnect(connection)
        self._wake.set()
