"""The other side of the control socket: a program of the same user that asks a running gateway."""

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from time import monotonic
from typing import Any

from drivers import json_lines
from drivers.errors import OneLineError
from gateway.network import TimedSocket


class ControlError(OneLineError, ValueError):
    """A request that cannot be carried out; the sentence goes into the reply."""


@contextmanager
def short(path: Path) -> Iterator[str]:
    """The path as a Unix socket may be called: by way of its folder's descriptor, since its length is limited.

    Raises OSError where the folder is not there.
    """
    # A socket's path has 108 bytes at most (unix(7)); this one is short wherever the folder lies.
    folder = os.open(path.parent, os.O_PATH | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{folder}/{path.name}"
    finally:
        os.close(folder)


class GatewayLine:
    """A connection to the running gateway at `path` (blocking). Raises OSError where there is none.

    What is asked is asked of this `machine`; None: of the gateway's only one.
    """

    def __init__(self, path: Path, timeout: float = 5.0, *, machine: str | None = None) -> None:
        self.timeout, self._machine = timeout, machine
        self._received = b""
        self._sock = TimedSocket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._sock.end = monotonic() + timeout
        try:
            with short(path) as name:
                self._sock.connect(name)
        except OSError:
            self._sock.close()
            raise

    def ask(self, command: str, **keys: Any) -> dict[str, Any]:
        """One request; gives the reply. Raises ControlError with the gateway's reason, OSError if it is gone."""
        self.send(command, **keys)
        return self.reply(self.timeout)

    def send(self, command: str, **keys: Any) -> None:
        """One request without waiting. Raises OSError."""
        self._sock.end = monotonic() + self.timeout
        whose = {} if self._machine is None else {"machine": self._machine}
        self._sock.sendall(json_lines.format_object({"command": command, **whose, **keys}))

    def reply(self, seconds: float) -> dict[str, Any]:
        """The reply to the oldest request that has none yet. Raises as `ask`.

        After a TimeoutError it may be called again: what has come until then is kept.
        """
        self._sock.end = monotonic() + seconds
        while b"\n" not in self._received:
            part = self._sock.recv(1 << 16)
            if not part:
                raise ConnectionResetError("the gateway has closed its control socket")
            self._received += part
        line, _, self._received = self._received.partition(b"\n")
        reply = json_lines.parse_object(line)
        if not reply.pop("ok", False):
            raise ControlError(str(reply.get("reason", "the gateway refused without a reason")))
        return reply

    def close(self) -> None:
        """Let it go."""
        self._sock.close()


def connect(path: Path, timeout: float = 5.0, *, machine: str | None = None) -> GatewayLine | None:
    """The running gateway at `path`; None where none runs, or not for this user."""
    with suppress(OSError):
        return GatewayLine(path, timeout, machine=machine)
    return None
