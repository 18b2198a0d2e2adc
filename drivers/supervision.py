"""The one supervisor: it knows every thread and task that a program keeps going, and none of them ends silently.

What fails, or ends though nobody told it to, is said, counted and begun anew with a growing pause. It stands below all
floors, so that a driver has one for its own threads and tasks (`drivers.driver.Supervised`), which the gateway's takes
in (`include`). What it says of itself (`report`, `complaints`) goes into the gateway's status, its alarms and the exit
code.
"""

import asyncio
import threading
from collections.abc import Awaitable, Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from time import monotonic
from typing import Any, TypeVar

T = TypeVar("T")

Say = Callable[[str, BaseException], None]
"""Told the part that failed and the error."""

FIRST_PAUSE, LONGEST_PAUSE = 0.2, 10.0
"""Seconds before a part is begun anew: doubled with each failure up to the longest."""
WELL_SECONDS = 30.0
"""A part that has not failed for so long is well again, and its next failure pauses briefly."""


class EndedUnasked(RuntimeError):
    """A thread or task that has returned though nobody told it to."""

    def __init__(self) -> None:
        super().__init__("it ended though nobody told it to")


@dataclass(slots=True)
class Worker:
    """One thread or task: how often it failed, why it last did ("" never) and when (monotonic s).

    `running` is false while it pauses after a failure and once it has ended for good.
    """

    name: str
    restarts: int = 0
    failure: str = ""
    running: bool = True
    failed_at: float = 0.0
    carrier: "threading.Thread | asyncio.Task[Any] | None" = None

    @property
    def well(self) -> bool:
        """True if it has not failed for a while, or never."""
        return not self.failure or monotonic() - self.failed_at >= WELL_SECONDS


class Supervisor:
    """Starts threads and tasks and keeps them going. `say` is told of each failure that is another than the last."""

    def __init__(self, say: Say | None = None) -> None:
        self.say = say
        self._workers: dict[str, Worker] = {}
        self._has_failed = False
        self._included: dict[str, Supervisor] = {}
        self._hearers: dict[tuple[Supervisor, str], Say] = {}

    def thread(self, name: str, work: Callable[[], None], *, stop: threading.Event) -> threading.Thread:
        """Run `work` in a thread, again and again until it returns with `stop` set."""

        def keep() -> None:
            pause = FIRST_PAUSE
            while True:
                try:
                    work()
                    error: BaseException = EndedUnasked()
                    if stop.is_set():
                        worker.running = False
                        return
                # SystemExit too: of a thread it would be the end without a word.
                except BaseException as caught:  # noqa: BLE001 - the supervisor: whatever it is, it is said
                    error = caught
                stopping = stop.is_set()
                pause = self._pause(self._count_failure(worker, error), pause)
                # Told to stop while it pauses, it has one more round to put away what it has; failed in that, it ends.
                if stopping:
                    return
                stop.wait(pause)
                worker.running = True

        thread = threading.Thread(target=keep, name=name, daemon=True)
        worker = self._make_worker(name, thread)
        thread.start()
        return thread

    def task(self, name: str, work: Callable[[], Awaitable[None]]) -> "asyncio.Task[None]":
        """Run `work` as a task of the running loop, again and again until the task is cancelled."""

        async def keep() -> None:
            pause = FIRST_PAUSE
            try:
                while True:
                    try:
                        await work()
                        error: BaseException = EndedUnasked()
                        if task.cancelling():  # and the cancellation was swallowed, as asyncio.wait_for may do
                            return
                    except asyncio.CancelledError as caught:
                        # Of something that it waited for, and not of itself: that is a failure like any other.
                        if task.cancelling():
                            raise
                        error = caught
                    except (Exception, SystemExit) as caught:  # noqa: BLE001 - as above
                        error = caught
                    worker.running = False
                    pause = self._pause(self._count_failure(worker, error), pause)
                    if task.cancelling():
                        return
                    await asyncio.sleep(pause)
                    worker.running = True
            finally:
                worker.running = False

        task = asyncio.create_task(keep(), name=name)
        worker = self._make_worker(name, task)
        return task

    def job(self, name: str, work: Callable[[], T], turns: asyncio.Semaphore | None = None) -> "asyncio.Task[T]":
        """Run `work` once, in a thread of the running loop's; its failure is known here, and raised to who awaits it.

        With `turns` it waits until fewer of those that share them are under way. It is for its owner to begin it anew.
        """

        async def once() -> T:
            try:
                async with turns or nullcontext():
                    return await asyncio.to_thread(work)
            except (Exception, SystemExit) as error:
                self._count_failure(worker, error)
                raise
            finally:
                worker.running = False

        task = asyncio.create_task(once(), name=name)
        worker = self._make_worker(name, task)
        return task

    def failed(self, name: str, error: BaseException) -> None:
        """Count a failure of a part that its owner begins anew."""
        worker = self._workers.get(name) or self._make_worker(name, None)
        self._count_failure(worker, error)
        worker.running = True

    @contextmanager
    def hearing_all(self) -> Iterator[None]:
        """While it lasts, what fails where nobody awaits it is known here too, each under the name of its thread.

        That is a callback of the running loop, a task whose owner never looks, and a thread that no supervisor started.
        """
        loop, before = asyncio.get_running_loop(), threading.excepthook

        def in_loop(_loop: asyncio.AbstractEventLoop, context: Mapping[str, Any]) -> None:
            self.failed("event loop", context.get("exception") or RuntimeError(context["message"]))

        def in_thread(ended: threading.ExceptHookArgs) -> None:
            name = ended.thread.name if ended.thread is not None else "a thread"
            self.failed(name, ended.exc_value or RuntimeError(ended.exc_type.__name__))

        loop.set_exception_handler(in_loop)
        threading.excepthook = in_thread
        try:
            yield
        finally:
            threading.excepthook = before
            loop.set_exception_handler(None)

    def include(self, name: str, other: "Supervisor") -> None:
        """Take in what another one keeps going, each part by this name before its own.

        Several may take in the same one, as the drivers of units that share a connection do: each hears of it.
        """
        self._included[name] = other
        other.hear((self, name), lambda part, error: self._tell(f"{name}: {part}", error))

    def exclude(self, name: str) -> None:
        """Let go of what was taken in by this name."""
        other = self._included.pop(name, None)
        if other is not None:
            other.hear((self, name), None)

    def hear(self, hearer: "tuple[Supervisor, str]", say: Say | None) -> None:
        """Have one who takes this one in told of each failure, beside all others; None: not any more."""
        self._hearers.pop(hearer, None)
        if say is not None:
            self._hearers[hearer] = say

    @property
    def complaints(self) -> dict[str, str]:
        """What cannot be relied on now, by the part's name, and why."""
        if self.all_well:
            return {}
        return {name: _complaint(name, part) for name, part in self.parts().items() if not part.well}

    @property
    def all_well(self) -> bool:
        """What every scan asks, without a name for every part."""
        # Nearly always none has failed yet, and then nothing is to be looked through.
        own = not self._has_failed or all(worker.well for worker in tuple(self._workers.values()))
        return own and all(other.all_well for other in tuple(self._included.values()))

    def part_complaints(self, parts: Iterable[str]) -> list[str]:
        """What cannot be relied on now of these parts of its own, in their order; none of what it has taken in."""
        if not self._has_failed:
            return []
        known = {name: worker for name in parts if (worker := self._workers.get(name)) is not None}
        return [_complaint(name, worker) for name, worker in known.items() if not worker.well]

    @property
    def complaint(self) -> str:
        """All of them in one sentence; "" if all is well."""
        return "; ".join(self.complaints.values())

    def report(self) -> dict[str, dict[str, str | int | bool]]:
        """Every thread and task by name, as plain values."""
        return {
            name: {
                "running": part.running,
                "restarts": part.restarts,
                "failure": part.failure,
            }
            for name, part in self.parts().items()
        }

    def knows(self, carrier: "threading.Thread | asyncio.Task[Any]") -> bool:
        """True for a thread or a task that was started here, or by a supervisor that is included."""
        return any(part.carrier is carrier for part in self.parts().values())

    def parts(self) -> dict[str, Worker]:
        """Every worker by its name, those of included supervisors too."""
        # A copy at once: threads come while this is looked at.
        own = {worker.name: worker for worker in tuple(self._workers.values())}
        for name, other in self._included.items():
            own |= {f"{name}: {part}": worker for part, worker in other.parts().items()}
        return own

    def _make_worker(self, name: str, carrier: "threading.Thread | asyncio.Task[Any] | None") -> Worker:
        """A worker of this name; one that comes after another (each connection has its reader) goes on counting."""
        before = self._workers.get(name)
        worker = Worker(name, carrier=carrier)
        if before is not None:
            worker.restarts, worker.failure, worker.failed_at = before.restarts, before.failure, before.failed_at
        self._workers[name] = worker
        return worker

    def _count_failure(self, worker: Worker, error: BaseException) -> bool:
        """Note a failure; False if the part had been well for a while."""
        reason, well, self._has_failed = repr(error), worker.well, True
        same = reason == worker.failure and not well
        worker.running, worker.restarts = False, worker.restarts + 1
        worker.failure, worker.failed_at = reason, monotonic()
        # Said by change: what fails in the same way every ten seconds is counted, and does not fill the log.
        if not same:
            self._tell(worker.name, error)
        return not well

    def _tell(self, part: str, error: BaseException) -> None:
        for say in (self.say, *tuple(self._hearers.values())):
            if say is not None:
                say(part, error)

    def _pause(self, again: bool, before: float) -> float:
        """The seconds to wait before a part is begun anew."""
        return min(2 * before, LONGEST_PAUSE) if again else FIRST_PAUSE


def _complaint(name: str, part: Worker) -> str:
    return f"{name}: {part.failure}; begun anew"
