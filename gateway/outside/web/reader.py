"""Asks the process that reads the historian (`gateway.outside.web.reader_process`), one question at a time."""

import asyncio
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from drivers.errors import OneLineError

QUICK_S, SLOW_S = 30.0, 300.0
"""How long an answer may take: of what people look at, and of scores over weeks. Then the process is ended."""
IDLE_S = 300.0
"""A process that nobody has asked for so long ends, and its memory is free; the next question begins another."""
MOST_WAITING = 32
LONGEST_ANSWER = 1 << 26


class ReaderError(OneLineError, OSError):
    """The historian's rows cannot be had; the message is one sentence."""


class ReaderProcess:
    """A process for the historian at `path`, begun with the first question; an answer takes `patience` s at most."""

    def __init__(self, path: Path, patience: float) -> None:
        self._path, self._patience = path, patience
        self._turn = asyncio.Lock()
        self._waiting = 0
        self._process: asyncio.subprocess.Process | None = None
        self._idle: asyncio.TimerHandle | None = None

    async def ask(self, question: str, **keys: Any) -> bytes:
        """The answer as JSON. Raises ReaderError with the reason where there is none."""
        if self._waiting >= MOST_WAITING:
            raise ReaderError("too many ask for records at a time; try again in a moment")
        self._waiting += 1
        try:
            async with self._turn:
                line = await self._answer(json.dumps({"question": question, "keys": keys}).encode() + b"\n")
        finally:
            self._waiting -= 1
        if line[:1] != b"+":
            raise ReaderError(line[1:].decode(errors="replace").strip() or "the records cannot be read now")
        return line[1:].rstrip(b"\n")

    async def _answer(self, line: bytes) -> bytes:
        if self._idle is not None:
            self._idle.cancel()
        try:
            async with asyncio.timeout(self._patience):
                process = await self._ensure_process()
                assert process.stdin is not None and process.stdout is not None  # noqa: S101 - as it was begun
                process.stdin.write(line)
                await process.stdin.drain()
                answered = await process.stdout.readline()
        except TimeoutError:
            await self.close()
            raise ReaderError(f"the records were not read within {self._patience:g} s; ask for less") from None
        except (OSError, ValueError, asyncio.CancelledError):
            # Half an answer, or one that nobody waits for any more: the next question is not to be answered by it.
            await self.close()
            raise
        if not answered:
            await self.close()
            raise ReaderError("the process that reads the records has ended; ask again")
        self._idle = asyncio.get_running_loop().call_later(IDLE_S, self._end)
        return answered

    async def _ensure_process(self) -> asyncio.subprocess.Process:
        if self._process is None or self._process.returncode is not None:
            # -P: a folder of the plant's that is called like one of ours is not taken for it.
            self._process = await asyncio.create_subprocess_exec(
                sys.executable,
                "-P",
                "-m",
                "gateway.outside.web.reader_process",
                str(self._path.absolute()),
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                stderr=asyncio.subprocess.DEVNULL,
                limit=LONGEST_ANSWER,
                start_new_session=True,  # Control-C is for the gateway, whose end this one hears of
            )
        return self._process

    def _end(self) -> None:
        if self._process is not None and self._process.returncode is None:
            self._process.kill()

    async def close(self) -> None:
        """End the process."""
        if self._idle is not None:
            self._idle.cancel()
        self._end()
        process, self._process = self._process, None
        if process is not None:
            await process.wait()


class HistorianReader:
    """Two processes: what people look at never waits for scores. `gap` (s) is when a trend has one."""

    def __init__(self, path: Path, gap: float) -> None:
        self._gap = gap
        self._quick, self._slow = ReaderProcess(path, QUICK_S), ReaderProcess(path, SLOW_S)

    async def trend(self, machine: str, tag: str, start: float, end: float) -> bytes:
        """See `gateway.outside.web.readings.read_trend`."""
        return await self._quick.ask("trend", machine=machine, tag=tag, start=start, end=end, gap=self._gap)

    async def forecasts(self, machine: str, temperature: str, horizon: float, start: float, end: float) -> bytes:
        """See `gateway.outside.web.readings.read_forecasts`."""
        return await self._quick.ask(
            "forecasts",
            machine=machine,
            temperature=temperature,
            horizon=horizon,
            start=start,
            end=end,
            gap=self._gap,
        )

    async def forecast(self, machine: str, temperature: str, at: float) -> bytes:
        """See `gateway.outside.web.readings.read_forecast`."""
        return await self._quick.ask("forecast", machine=machine, temperature=temperature, at=at)

    async def table(self, machine: str, tags: Sequence[str], start: float, end: float) -> str:
        """See `gateway.outside.web.readings.read_table`."""
        keys = {"machine": machine, "tags": list(tags), "start": start, "end": end}
        text: str = json.loads(await self._quick.ask("table", gap=self._gap, **keys))["text"]
        return text

    async def alarms(self, machine: str, most: int) -> bytes:
        """See `gateway.outside.web.readings.alarm_rows`."""
        return await self._quick.ask("alarms", machine=machine, most=most)

    async def rates(self, days: float) -> bytes:
        """See `gateway.outside.web.readings.rates_of_alarms`."""
        return await self._slow.ask("rates", days=days)

    async def scorecard(self, machine: str, temperature: str, weeks: int, runs: Mapping[str, bool | None]) -> bytes:
        """See `gateway.outside.web.readings.scores_by_week`."""
        asked = {"machine": machine, "temperature": temperature, "weeks": weeks}
        return await self._slow.ask("scorecard", **asked, runs=runs)

    async def notes(self, audit: Path, machine: str, start: float, end: float) -> bytes:
        """See `gateway.outside.web.readings.notes_between`."""
        return await self._quick.ask("notes", audit=str(audit.absolute()), machine=machine, start=start, end=end)

    async def shift(
        self, audit: Path, start: float, end: float, temperatures: Mapping[str, Mapping[str, float]]
    ) -> bytes:
        """See `gateway.outside.web.shift.read_shift`."""
        return await self._slow.ask(
            "shift", audit=str(audit.absolute()), start=start, end=end, gap=self._gap, temperatures=temperatures
        )

    async def close(self) -> None:
        """End the processes."""
        await self._quick.close()
        await self._slow.close()
