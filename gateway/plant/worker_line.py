"""The supervisor process's side of one worker: the line to its present process, and what is known of it."""

from __future__ import annotations

import asyncio
import subprocess
from collections.abc import Coroutine
from contextlib import suppress
from itertools import count
from time import monotonic
from typing import Any

from drivers.errors import OneLineError
from drivers.settings import ConfigError
from gateway.plant.channel import Message, packed_line
from gateway.plant.service import ScanProgress


class WorkerEnded(OneLineError, RuntimeError):
    """A worker process that has ended though nobody told it to; the message is a sentence."""

    def __repr__(self) -> str:
        return str(self)


class WorkerLine:
    """The line to one process. What it is asked waits for its reply and for no other process's."""

    def __init__(self, process: subprocess.Popen[bytes], writer: asyncio.StreamWriter) -> None:
        self.process, self._writer = process, writer
        self._numbers = count(1)
        self._open: dict[int, asyncio.Future[Message]] = {}

    async def ask(self, what: str, timeout: float | None = None, **content: Any) -> Message:
        """One request and its reply. Raises TimeoutError, and WorkerEnded when the process ends before."""
        number, answer = next(self._numbers), asyncio.get_running_loop().create_future()
        self._open[number] = answer
        self._writer.write(packed_line({"ask": what, "id": number, **content}))
        async with asyncio.timeout(timeout):
            reply: Message = await answer
        if "failed" in reply:
            raise WorkerEnded(f"the machine's process could not do it ({reply['failed']})")
        return reply

    def replied(self, message: Message) -> None:
        """Take the reply to one request."""
        answer = self._open.pop(message["reply"])
        if not answer.done():
            answer.set_result(message)

    def reply(self, message: Message, **content: Any) -> None:
        """Answer what the process has asked."""
        if not self._writer.is_closing():
            self._writer.write(packed_line({"reply": message["id"], **content}))

    def close(self) -> None:
        """Let go of the line."""
        self._writer.close()

    def ended(self, error: WorkerEnded) -> None:
        """Nothing that is open will be answered."""
        for each in self._open.values():
            if not each.done():
                each.set_exception(error)


class PlantWorker:
    """One worker from process to process; `loaded` and `begun` are how its first one came up.

    `former` says why the one before ended, `retired` that no other follows, `undelivered` which recipients of messages
    its machines' alarms do not reach, `is_seen` that the pictures are of the present process.
    """

    def __init__(self, number: int) -> None:
        self.number, self.name = number, f"worker {number + 1}"
        self.task: asyncio.Task[None] | None = None
        self.pictures: dict[str, dict[str, Any]] = {}
        self.progress: dict[str, ScanProgress] = {}
        self.seen = monotonic()
        self.former = self.refusal = self.undelivered = ""
        self.retired = self.is_opened = self.is_seen = False
        self.is_ready, self.opening = asyncio.Event(), asyncio.Lock()
        self.audits = set[asyncio.Future[Any]]()
        self.loaded, self.begun = _awaited(), _awaited()
        self._line: WorkerLine | None = None
        self._tasks = set[asyncio.Task[None]]()

    @property
    def ready(self) -> bool:
        """Whether its machines run."""
        return self.is_ready.is_set()

    def began(self, line: WorkerLine) -> None:
        """A process has begun."""
        self._line, self.refusal = line, ""

    def ended(self, error: WorkerEnded) -> None:
        """The process has ended."""
        self.is_ready.clear()
        self.progress, self.undelivered = {}, ""
        self.is_opened = self.is_seen = False
        self.former = str(error)
        if self._line is not None:
            self._line.ended(error)
        for outcome in (self.loaded, self.begun):
            self.settle(outcome, ConfigError([f"{error}, before its machines had begun"]))

    def settle(self, outcome: asyncio.Future[None], error: Exception | None = None) -> None:
        """Say how the first process came up, unless that is said."""
        if not outcome.done():
            if error is None:
                outcome.set_result(None)
            else:
                outcome.set_exception(error)

    async def ask(self, what: str, timeout: float | None = None, **content: Any) -> Message:
        """Ask the process whose machines run (`WorkerLine.ask`)."""
        if self._line is None or not self.ready:
            raise WorkerEnded(f"{self.former or self.name}; it is being begun anew, ask again in a moment")
        return await self._line.ask(what, timeout, **content)

    def kill(self) -> None:
        """End its present process, which hangs; it is begun anew as any that has ended."""
        if self._line is not None:
            self._line.process.kill()

    async def wait_for_end(self, seconds: float) -> None:
        """Give the process so long to end by itself."""
        if self._line is not None:
            with suppress(subprocess.TimeoutExpired):
                await asyncio.to_thread(self._line.process.wait, seconds)

    def begin(self, work: Coroutine[Any, Any, None]) -> None:
        """Begin to answer the process."""
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def see(self, pictures: dict[str, dict[str, Any]]) -> None:
        """How its machines are now."""
        self.pictures, self.seen, self.is_seen = pictures, monotonic(), True


def _awaited() -> asyncio.Future[None]:
    outcome: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    # Where the first of several refusals ends the start, nobody looks at the others.
    outcome.add_done_callback(lambda done: None if done.cancelled() else done.exception())
    return outcome
