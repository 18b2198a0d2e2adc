"""A worker process's end of the line to the supervisor process: JSON lines over a socket that both were born with.

A line is a request (`ask`, with `id`), its reply (`reply`, the same `id`), or a piece of news that nobody answers
(`tell`). Requests go both ways. The supervisor's end is `gateway.plant.worker_pool`.

When the line ends and nobody has closed it here, the supervisor is dead: this process ends on the spot, whatever its
loop is doing, so that nothing is written to a PLC behind which nobody stands. The PLC's own timer covers the rest.
"""

from __future__ import annotations

import json
import os
import socket
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from itertools import count
from typing import Any

from drivers.supervision import Supervisor
from drivers.tag import Quality, Sample
from gateway.machine.reading import Scan

ORPHANED = 70
"""The exit code of a worker whose supervisor is gone."""
MOST_NEWS = 1_000
"""Pieces of news (lines of the log, scans) that may wait to be sent; beyond that the oldest is dropped."""

Message = dict[str, Any]


class SupervisorChannel:
    """The line, from its making on; each method may be called from any thread, and none but `ask` and `close` waits.

    `on_request` is called, in a thread of the channel's, with what the supervisor asks.
    """

    def __init__(self, sock: socket.socket, supervisor: Supervisor, on_request: Callable[[Message], None]) -> None:
        self._sock, self._on_request = sock, on_request
        self._numbers = count(1)
        self._open: dict[int, Future[Message]] = {}
        self._messages, self._news = deque[bytes](), deque[bytes](maxlen=MOST_NEWS)
        self._wake = threading.Condition()
        self._idle, self._stop = True, threading.Event()
        self._threads = (
            supervisor.thread("to the supervisor", self._send, stop=self._stop),
            supervisor.thread("from the supervisor", self._receive, stop=self._stop),
        )

    def ask(self, what: str, **content: Any) -> Message:
        """One request and its reply, for which it waits as long as it takes: with the supervisor this process ends.

        Raises TypeError or ValueError for what is no JSON.
        """
        answer: Future[Message] = Future()
        number = next(self._numbers)
        line = packed_line({"ask": what, "id": number, **content})
        self._open[number] = answer
        self._put(line)
        return answer.result()

    def reply(self, number: int, content: Message) -> None:
        """Answer a request of the supervisor's."""
        self._put(packed_line({"reply": number, **content}))

    def tell(self, what: str, **content: Any) -> None:
        """Say something that is not answered; of what waits too long the oldest is dropped."""
        with self._wake:
            self._news.append(packed_line({"tell": what, **content}))
            self._wake.notify_all()

    def close(self, timeout: float = 5.0) -> None:
        """Send what waits, and let go of the line."""
        with self._wake:
            self._wake.wait_for(lambda: self._idle and not self._messages and not self._news, timeout)
            self._stop.set()
            self._wake.notify_all()
        self._sock.shutdown(socket.SHUT_RDWR)
        for thread in self._threads:
            thread.join(timeout)
        self._sock.close()

    def _put(self, line: bytes) -> None:
        with self._wake:
            self._messages.append(line)
            self._wake.notify_all()

    def _send(self) -> None:
        while not self._stop.is_set():
            with self._wake:
                self._idle = True
                self._wake.notify_all()
                self._wake.wait_for(lambda: self._messages or self._news or self._stop.is_set())
                lines = [*self._messages, *self._news]
                self._messages.clear()
                self._news.clear()
                self._idle = False
            try:
                for line in lines:
                    self._sock.sendall(line)
            except OSError:
                self._ended()

    def _receive(self) -> None:
        with self._sock.makefile("rb") as lines:
            try:
                for line in lines:
                    message = json.loads(line)
                    if "reply" in message:
                        self._open.pop(message["reply"]).set_result(message)
                    else:
                        self._on_request(message)
            except OSError:
                pass
        self._ended()

    def _ended(self) -> None:
        if not self._stop.is_set():
            os._exit(ORPHANED)


def packed_line(message: Message) -> bytes:
    """A message as a line. Raises TypeError or ValueError for what is no JSON."""
    return json.dumps(message, default=_plain).encode() + b"\n"


BYTES = "bytes"
"""The key of bytes, which a row may hold, in JSON: their digits."""


def _plain(value: object) -> object:
    if isinstance(value, bytes):
        return {BYTES: value.hex()}
    raise TypeError(f"{type(value).__name__} cannot be sent to the supervisor process")


def plain_rows(rows: list[list[Any]]) -> list[tuple[Any, ...]]:
    """Rows as they were before they were sent."""
    return [tuple(bytes.fromhex(v[BYTES]) if isinstance(v, dict) else v for v in row) for row in rows]


def scan_message(unit: int, scan: Scan) -> Message:
    """A scan as news for the process that shows it to peers under a unit number."""
    samples = [(name, one.value, int(one.quality), one.time) for name, one in scan.samples.items()]
    return {"unit": unit, "number": scan.number, "time": scan.time, "missed": scan.missed, "samples": samples}


def scan_from(message: Message) -> Scan:
    """The scan of `scan_message`, as far as peers are shown of it: not how long it took, nor why a reading is bad."""
    samples = {name: Sample(name, value, Quality(quality), time) for name, value, quality, time in message["samples"]}
    return Scan(message["number"], message["time"], samples, message["missed"], duration=0.0)
