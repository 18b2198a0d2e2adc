"""One SDO channel to one server: a transfer at a time, each answer within its deadline, and none taken for another."""

import asyncio
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress

from drivers.canopen.place import ObjectPlace
from drivers.canopen.sdo import (
    BLOCK_UPLOAD_END,
    TIMED_OUT,
    UNKNOWN_COMMAND,
    SdoAbort,
    Transfer,
    abort_frame,
    block_download,
    block_upload,
    download,
    upload,
)
from drivers.errors import DriverError, LinkDown, ReplyMismatch, ReplyTimeout

DEVICE_TYPE = ObjectPlace(0x1000)
"""The one object that every CANopen device has; reading it puts requests and answers in step again."""
MIN_BLOCK_DOWNLOAD_BYTES = 64
"""Bytes from which block transfer is tried: below it the segments cost less than its beginning and end."""


class SdoChannel:
    """The client of one server. `send` puts one frame on the bus, `receive` takes the server's frames.

    SDO answers have no number: after a request that got none in time, its answer may still come, and would be taken
    for that of the next request for the same object. So a channel that has waited in vain first reads the device type,
    and what comes before that answer is dropped (a server answers in the order in which it was asked).
    """

    def __init__(self, send: Callable[[bytes], None], timeout: float) -> None:
        self._send, self._timeout = send, timeout
        self._answers: deque[bytes] = deque(maxlen=256)
        self._news = asyncio.Event()
        self._lock = asyncio.Lock()
        self._busy = self._in_step = False
        self._blocks = True
        self._closed = ""
        self._counts = dict.fromkeys(("requests", "timeouts", "mismatches", "aborts"), 0)

    def receive(self, data: bytes) -> None:
        """A frame of the server. Outside a transfer, or of another length than 8, it is no answer."""
        if self._busy and len(data) == 8:
            self._answers.append(data)
            self._news.set()

    def close(self, reason: str) -> None:
        """Let a waiting transfer fail with LinkDown."""
        self._closed = reason or "closed"
        self._news.set()

    @property
    def counts(self) -> Mapping[str, int]:
        """Transfers that were begun, those that find the step again among them, and how they failed."""
        return dict(self._counts)

    async def read(self, place: ObjectPlace, size: int | None = None, *, block: bool = False) -> bytes:
        """The object's bytes; `size` is how many they are where that is known. `block` tries a block transfer first.

        Raises LinkDown, ReplyTimeout, ReplyMismatch or SdoAbort.
        """
        if self._blocks and block:
            try:
                data = await self._run(place, block_upload(place), BLOCK_UPLOAD_END)
            except SdoAbort as abort:
                if abort.code != UNKNOWN_COMMAND:
                    raise
                self._blocks = False
            else:
                return data
        return await self._run(place, upload(place, size))

    async def write(self, place: ObjectPlace, data: bytes) -> None:
        """Write the object, once. Raises as `read` does; after a timeout it is not known whether it was written."""
        if self._blocks and len(data) >= MIN_BLOCK_DOWNLOAD_BYTES:
            try:
                await self._run(place, block_download(place, data))
            except SdoAbort as abort:
                if abort.code != UNKNOWN_COMMAND:
                    raise
                self._blocks = False
            else:
                return
        await self._run(place, download(place, data))

    async def _run(self, place: ObjectPlace, transfer: Transfer, end: bytes = b"") -> bytes:
        async with self._lock:
            if not self._in_step:
                await self._transfer(DEVICE_TYPE, upload(DEVICE_TYPE))
                self._in_step = True
            data = await self._transfer(place, transfer)
            if end:
                self._send(end)
            return data

    async def _transfer(self, place: ObjectPlace, transfer: Transfer) -> bytes:
        """Carry one transfer to its end; one that does not end well leaves the server told so."""
        self._answers.clear()
        self._counts["requests"] += 1
        self._busy, finished = True, False
        try:
            frames, deadline = next(transfer), 0.0
            while True:
                if frames is not None:
                    deadline = asyncio.get_running_loop().time() + self._timeout
                for frame in frames or ():
                    self._send(frame)
                frames = transfer.send(await self._answer(place, deadline))
        except StopIteration as stop:
            finished = True
            data: bytes = stop.value
            return data
        except SdoAbort:
            finished = True
            self._counts["aborts"] += 1
            raise
        except ReplyTimeout:
            self._counts["timeouts"] += 1
            raise
        except ReplyMismatch:
            self._counts["mismatches"] += 1
            raise
        finally:
            self._busy = False
            if not finished:
                self._in_step = False
                with suppress(DriverError):
                    self._send(abort_frame(place, TIMED_OUT))

    async def _answer(self, place: ObjectPlace, deadline: float) -> bytes:
        while not self._answers:
            if self._closed:
                raise LinkDown(self._closed)
            self._news.clear()
            try:
                async with asyncio.timeout_at(deadline):
                    await self._news.wait()
            except TimeoutError:
                raise ReplyTimeout(f"{place}: no SDO answer within {self._timeout:g} s") from None
        return self._answers.popleft()
