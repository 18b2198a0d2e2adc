"""Frames from a bus into the event loop: by the bus's file descriptor where it has one, else by a thread."""

import asyncio
import select
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from math import inf

import can

from drivers.can.bus.arrival import Arrivals
from drivers.supervision import Supervisor

_BURST = 256
_POLL_S = 0.1
_BEHIND_AFTER_S = 1.5 * _POLL_S  # since the thread has last found the bus empty; after that it was held up
_CATCH_UP_TIMEOUT_S = 0.2  # seconds that a reading waits for a thread that is behind, once until that has caught up
_UNREADABLE = "the bus cannot be read any more"
_QUEUE = 10_000  # frames kept for a loop that is behind, by us or by a bus with a descriptor; a reading takes no more


class Pump:
    """Gives `take` each frame, in order, in the event loop's thread; `lost` says once that the bus is gone, and why.

    A frame's `timestamp` is then the moment (monotonic s) at which it came, however late the loop takes it, as far as
    the system or the thread has stamped it (`drivers.can.bus.arrival`).
    A burst of frames leaves the loop to others in between. `close` lets the bus go; nothing is given after that.
    """

    def __init__(
        self,
        bus: can.BusABC,
        take: Callable[[can.Message], None],
        lost: Callable[[str], None],
        supervisor: Supervisor | None = None,
    ) -> None:
        self.bus = bus
        self.dropped = 0
        self._take = take
        self._lost = lost
        self._loop = asyncio.get_running_loop()
        self._arrivals = Arrivals(bus)
        self._waiting: deque[can.Message] = deque(maxlen=_QUEUE)
        self._closed = False
        self._ended = threading.Event()
        self._looked = threading.Condition()
        self._empty, self._behind = time.monotonic(), False
        self._patience = _CATCH_UP_TIMEOUT_S
        self._thread: threading.Thread | None = None
        self._fd: int | None = None
        # An interface without a descriptor raises; that of a socket which is closed already is below 0.
        with suppress(NotImplementedError):
            self._fd = number if (number := bus.fileno()) >= 0 else None
        if self._fd is None:
            self._thread = (supervisor or Supervisor()).thread("bus receiver", self._listen, stop=self._ended)
        else:
            self._readiness = select.poll()
            self._readiness.register(self._fd, select.POLLIN)
            self._loop.add_reader(self._fd, self._readable)

    def close(self) -> None:
        """Stop giving frames and shut the bus down. May be called twice."""
        if self._closed:
            return
        self._closed = True
        self._ended.set()
        if self._fd is not None:
            self._loop.remove_reader(self._fd)
            self.bus.shutdown()

    async def join(self) -> None:
        """Wait until the bus is shut down, two seconds at most."""
        if self._thread is not None:
            await asyncio.to_thread(self._thread.join, 2.0)

    def drain(self) -> None:
        """Give all that has come by now: what is known is then as new as the bus has it, however late the loop is.

        A thread that does not catch up in time is not waited for again before it has: others need the loop too.
        """
        if self._fd is not None:
            self._readable(_QUEUE)
        else:
            asked = time.monotonic()
            with self._looked:
                caught_up = self._looked.wait_for(
                    lambda: not self._behind and asked - self._empty <= _BEHIND_AFTER_S, self._patience
                )
            self._patience = _CATCH_UP_TIMEOUT_S if caught_up else 0.0
        for _ in range(len(self._waiting)):
            if self._closed:
                return
            self._take(self._waiting.popleft())

    def _readable(self, most: int = _BURST) -> None:
        for _ in range(0 if self._closed else most):
            reason = _UNREADABLE
            try:
                begun = time.monotonic()
                message = self.bus.recv(0.0)
                reason = ""
            except (can.CanError, OSError, ValueError) as error:
                reason = str(error) or _UNREADABLE
                return
            finally:
                # Whatever has ended it, also what the loop says: a bus left as it is would be tried again at once.
                if reason:
                    self._lost(reason)
            if message is None:
                # A filter of this process answers None for a frame that it leaves out, and others wait behind it.
                if not self._readiness.poll(0):
                    self._arrivals.found_empty(begun)
                    return
                continue
            message.timestamp = self._arrivals.moment(message)
            self._take(message)
            if self._closed:
                return

    # ------------------------------------------------------------ a bus without a descriptor

    def _listen(self) -> None:
        """The thread: it alone touches the bus for receiving, and shuts it down at its end."""
        reason = _UNREADABLE
        try:
            while not self._ended.is_set():
                begun = time.monotonic()
                message = self.bus.recv(0.0)
                if message is None:
                    self._arrivals.found_empty(begun)
                    self._note_empty(begun)
                    message = self.bus.recv(_POLL_S)
                if message is None:
                    continue
                message.timestamp = self._arrivals.moment(message)
                self._behind = True
                self.dropped += len(self._waiting) == _QUEUE  # the oldest: what is newest is what is
                self._waiting.append(message)
                if len(self._waiting) == 1:
                    self._call_in_loop(self._drain)
        except (can.CanError, OSError, ValueError) as error:
            reason = str(error) or _UNREADABLE
            self._ended.set()
        finally:
            self._note_empty(inf)
            # Whatever has ended it, also what the supervisor hears of: the bus is opened anew.
            self._call_in_loop(self._report_loss, reason)
            if self._ended.is_set():
                self.bus.shutdown()

    def _note_empty(self, moment: float) -> None:
        """Say that nothing waited on the bus at a moment (monotonic)."""
        with self._looked:
            self._empty, self._behind = moment, False
            self._looked.notify_all()

    def _call_in_loop(self, function: Callable[..., None], *arguments: str) -> None:
        # The loop may have ended before the thread has noticed that it is to end.
        try:
            self._loop.call_soon_threadsafe(function, *arguments)
        except RuntimeError:
            self._closed = True
            self._ended.set()

    def _report_loss(self, reason: str) -> None:
        if not self._closed:
            self._lost(reason)

    def _drain(self) -> None:
        try:
            for _ in range(min(_BURST, len(self._waiting))):
                if self._closed:
                    return
                self._take(self._waiting.popleft())
        finally:
            # Also after a frame that could not be taken: the others do not wait for ever.
            if self._waiting and not self._closed:
                self._loop.call_soon(self._drain)
