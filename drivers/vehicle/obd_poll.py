"""Asking for OBD-II parameters on a bus, one request at a time; only where the configuration says `poll = true`.

Nothing else is ever sent than requests for the parameters of the tags, to the units whose answers they name, and the
flow control by which a unit goes on with an answer of several frames (ISO 15765-2).
"""

import asyncio
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import NamedTuple

from drivers.can import CanFrame, PollingSettings, Send
from drivers.vehicle.isotp import CONSECUTIVE, FIRST
from drivers.vehicle.obd import ANSWER, CURRENT, ENGINE, REFUSAL, RESPONSE_PENDING, VEHICLE, ObdTag

_PADDING = b"\x55"
_FLOW_CONTROL = b"\x30\x00\x00".ljust(8, _PADDING)
# A unit that says "response pending" may take this much longer (P2*, ISO 15765-4).
_PENDING_TIMEOUT_S = 5.0


class ObdRequest(NamedTuple):
    """One request: the identifiers of the unit's answers and of requests to it, and what is asked for."""

    reply_id: int
    request_id: int
    extended: bool
    service: int
    parameter: int

    @property
    def data(self) -> bytes:
        """The request's frame: a single frame of 8 bytes."""
        body = bytes([self.service, self.parameter] if self.service in (CURRENT, VEHICLE) else [self.service])
        return (bytes([len(body)]) + body).ljust(8, _PADDING)


def plan_requests(wanted: Sequence[ObdTag], *, extended: bool) -> list[ObdRequest]:
    """What to ask so that every parameter is answered once; `extended` for tags that name no unit."""
    requests: dict[ObdRequest, None] = {}
    for obd_tag in wanted:
        unit = ENGINE[extended] if obd_tag.where.source is None else obd_tag.where.source
        long = unit > 0x7FF
        request = 0x18DA00F1 | (unit & 0xFF) << 8 if long else unit - 8
        requests[ObdRequest(unit, request, long, obd_tag.service, obd_tag.parameter)] = None
    return list(requests)


class Poller:
    """Asks round by round; `take` is told of every frame of the bus."""

    def __init__(self, wanted: Callable[[], Sequence[ObdTag]], settings: PollingSettings) -> None:
        self._wanted = wanted
        self._send: Send = _nowhere
        self._settings = settings
        self._outstanding: ObdRequest | None = None
        self._answered = asyncio.Event()
        self._pending = False
        self._left = 0
        self.counts = dict.fromkeys(("polls", "polls_unanswered"), 0)

    def take(self, frame: CanFrame) -> None:
        """Notice the answer to what was asked, and let a unit go on that answers in several frames.

        Raises what `send` raises.
        """
        request = self._outstanding
        if request is None or (frame.id, frame.extended) != (request.reply_id, request.extended) or len(frame.data) < 2:
            return
        kind = frame.data[0] >> 4
        if kind == FIRST:
            self._pending, self._left = True, (int.from_bytes(frame.data[:2], "big") & 0x0FFF) - 6
            self._send(request.request_id, request.extended, _FLOW_CONTROL)
            return
        if kind == CONSECUTIVE:
            self._left -= 7
            if self._left <= 0:
                self._answered.set()
            return
        self._pending = tuple(frame.data[1:4]) == (REFUSAL, request.service, RESPONSE_PENDING)
        if not self._pending and frame.data[1] in (request.service + ANSWER, REFUSAL):
            self._answered.set()

    def describe(self) -> list[str]:
        """What is asked for, in sentences."""
        period = self._settings.poll_period
        requests = plan_requests(self._wanted(), extended=self._settings.poll_29bit)
        return [
            f"0x{request.request_id:03X} is asked every {period:g} s: {request.data[:3].hex(' ')}"
            for request in requests
        ]

    async def run(self, send: Send) -> None:
        """Ask until cancelled. What `send` raises ends it."""
        self._send = send
        loop = asyncio.get_running_loop()
        while True:
            due = loop.time() + self._settings.poll_period
            for request in plan_requests(self._wanted(), extended=self._settings.poll_29bit):
                await self._ask(request)
            await asyncio.sleep(max(0.0, due - loop.time()))

    async def _ask(self, request: ObdRequest) -> None:
        self._outstanding, self._pending = request, False
        self._answered.clear()
        self.counts["polls"] += 1
        self._send(request.request_id, request.extended, request.data)
        await self._wait(self._settings.poll_timeout)
        if self._pending and not self._answered.is_set():
            await self._wait(_PENDING_TIMEOUT_S)
        self.counts["polls_unanswered"] += not self._answered.is_set()

    async def _wait(self, seconds: float) -> None:
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await self._answered.wait()


def _nowhere(_: int, __: bool, ___: bytes) -> None:
    """Before the first connection nothing has been asked, and so nothing is sent."""
