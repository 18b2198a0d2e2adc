"""The one supervisor: it knows every thread and task that the gateway keeps going, and none of them ends silently.

What fails, or ends though nobody told it to, is logged, counted and begun anew with a growing pause. What it says of
itself (`report`, `complaint`) goes into the status, the alarm "records" and the exit code.
"""

import asyncio
import threading
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from time import monotonic

from structlog.typing import FilteringBoundLogger

FIRST_PAUSE, LONGEST_PAUSE = 0.2, 10.0
"""Seconds before a part is begun anew: doubled with each failure up to the longest."""
WELL_SECONDS = 30.0
"""A part that has run for so long since it was begun anew is well again; its next failure pauses briefly."""


@dataclass(slots=True)
class Worker:
    """One thread or task: how often it was begun anew, why it last failed ("" never), since when it runs (monotonic s).

    `running` is false while it pauses after a failure and once it has ended for good.
    """

    name: str
    restarts: int = 0
    failure: str = ""
    running: bool = True
    since: float = 0.0

    @property
    def complaint(self) -> str:
        """Why it cannot be relied on now; "" once it has run for a while since its last failure."""
        if not self.failure or (self.running and monotonic() - self.since >= WELL_SECONDS):
            return ""
        return f"{self.name}: {self.failure}; begun anew"


class Supervisor:
    """Starts threads and tasks and keeps them going; `log` may come later than the first of them."""

    def __init__(self, log: FilteringBoundLogger | None = None) -> None:
        self.log = log
        self.workers: list[Worker] = []

    def thread(self, name: str, work: Callable[[], None], *, stop: threading.Event) -> threading.Thread:
        """Run `work` in a thread, again and again until it returns with `stop` set."""
        worker = self._known(name)

        def keep() -> None:
            pause = FIRST_PAUSE
            while True:
                try:
                    work()
                    error: Exception | None = None
                except Exception as caught:  # noqa: BLE001 - the supervisor: whatever it is, it is said and begun anew
                    error = caught
                if error is None and stop.is_set():
                    worker.running = False
                    return
                stopping = stop.is_set()
                pause = self._failed(worker, error, pause)
                # Told to stop while it pauses, it has one more round to put away what it has; failed in that, it ends.
                if stopping:
                    return
                stop.wait(pause)
                worker.running, worker.since = True, monotonic()

        thread = threading.Thread(target=keep, name=name, daemon=True)
        thread.start()
        return thread

    def task(self, name: str, work: Callable[[], Awaitable[None]]) -> "asyncio.Task[None]":
        """Run `work` as a task of the running loop, again and again until the task is cancelled."""
        worker = self._known(name)

        async def keep() -> None:
            pause = FIRST_PAUSE
            try:
                while True:
                    try:
                        await work()
                        error: Exception | None = None
                    except Exception as caught:  # noqa: BLE001 - as above
                        error = caught
                    pause = self._failed(worker, error, pause)
                    await asyncio.sleep(pause)
                    worker.running, worker.since = True, monotonic()
            finally:
                worker.running = False

        return asyncio.create_task(keep(), name=name)

    @property
    def complaint(self) -> str:
        """What cannot be relied on now, and why; "" if all is well."""
        return "; ".join(filter(None, (worker.complaint for worker in self.workers)))

    def report(self) -> dict[str, dict[str, str | int | bool]]:
        """Every thread and task by name, as plain values."""
        return {
            worker.name: {"running": worker.running, "restarts": worker.restarts, "failure": worker.failure}
            for worker in self.workers
        }

    def _known(self, name: str) -> Worker:
        worker = Worker(name, since=monotonic())
        self.workers.append(worker)
        return worker

    def _failed(self, worker: Worker, error: Exception | None, before: float) -> float:
        """Note a failure; the seconds to wait before it is begun anew."""
        reason = repr(error) if error is not None else "it ended though nobody told it to"
        same = reason == worker.failure
        worker.running, worker.restarts, worker.failure = False, worker.restarts + 1, reason
        # Said by change: what fails in the same way every ten seconds is counted, and does not fill the log.
        if self.log is not None and not same:
            self.log.error("a part of the gateway failed and is begun anew", part=worker.name, reason=reason)
        well = monotonic() - worker.since >= WELL_SECONDS
        return FIRST_PAUSE if well or worker.restarts == 1 else min(2 * before, LONGEST_PAUSE)
