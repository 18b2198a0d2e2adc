"""A CAN bus between processes: every frame that one client of a Unix socket sends reaches all the others.

For machines whose kernel has no CAN, and for tests. The frames are the kernel's own `struct can_frame` (16 bytes) and
`struct canfd_frame` (72 bytes), one a packet, so the order of a sender is kept. What is passed on has the moment at
which the system took the frame from its sender behind it (`struct timespec`, 16 bytes, UTC), so that what waits here
becomes no younger. A frame is kept for a client that is behind only as long as its queue has room; then its newest
frames are dropped and counted, and it is told by an error frame ("receive buffer overflow", as a controller tells),
while all the others go on. What a wire does and a hub does not: priorities, bit timing, collisions.

    python -m drivers.can.bus.hub PATH [--queue FRAMES] [--stdin]
"""

import argparse
import errno
import json
import os
import selectors
import signal
import socket
import struct
import sys
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from drivers.can.bus.hub_bus import STAMP

FRAME_SIZES = frozenset({16, 72})
_SO_TIMESTAMPNS = 35
"""linux/socket.h: the system stamps what it receives; Python's socket module does not name it."""
_STAMP_SPACE = socket.CMSG_SPACE(STAMP.size)
QUEUE = 4096
# After so many frames of one sender it is the next one's turn.
_BURST = 64
_MODE = 0o660  # who may join may say anything to the plant: the owner and the group
# linux/can/error.h: error frame, class "controller", "receive buffer overflow".
_OVERFLOW = struct.pack("=IB3x8s", 0x20000000 | 0x04, 8, b"\0\x01\0\0\0\0\0\0")
_READ, _BOTH = selectors.EVENT_READ, selectors.EVENT_READ | selectors.EVENT_WRITE


@dataclass(slots=True, eq=False)
class _Client:
    """One connection, the packets that it has not taken yet, and how many were dropped since it was told so."""

    sock: socket.socket
    waiting: deque[bytes] = field(default_factory=deque)
    dropped: int = 0
    events: int = _READ


class Hub:
    """The bus: listens at `path` from the start on, forwards while `run` runs. Use as a context manager in a program.

    Raises OSError if the path is in use by a living hub or cannot be made. `queue` is the number of frames kept for
    each client that is behind, beyond what the kernel's buffer holds.
    """

    def __init__(self, path: str | Path, *, queue: int = QUEUE) -> None:
        self._path, self._queue = Path(path), queue
        self._clients: set[_Client] = set()
        self._counts = dict.fromkeys(("frames", "delivered", "dropped", "malformed"), 0)
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            # A path that a dead hub has left behind is taken over; a living hub's answers, and is in use.
            if self._path.is_socket():
                with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as probe:
                    if probe.connect_ex(str(path)) == errno.ECONNREFUSED:
                        self._path.unlink()
            self._listener.bind(str(path))
            self._path.chmod(_MODE)
            self._listener.listen(64)
        except OSError as error:
            self._listener.close()
            raise OSError(error.errno, f"no CAN hub at {path}: {error.strerror or error}") from None
        self._listener.setblocking(False)
        self._stopped, self._stop = socket.socketpair()
        self._thread = threading.Thread(target=self.run, name="can hub", daemon=True)

    def __enter__(self) -> "Hub":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        self._thread.join()

    def stop(self) -> None:
        """End `run`; the clients see the interface go down. From any thread, or a signal handler."""
        with suppress(OSError):  # it has ended already
            self._stop.send(b"\0")

    def statistics(self) -> Mapping[str, float]:
        """Frames taken, copies delivered, copies dropped for clients that were behind, packets that were no frame."""
        return {**self._counts, "clients": len(self._clients)}

    def run(self) -> None:
        """Forward frames until `stop`."""
        with self._stopped, self._stop, self._listener, selectors.DefaultSelector() as self._selector:
            self._selector.register(self._stopped, _READ)
            self._selector.register(self._listener, _READ)
            stopping = False
            while not stopping:
                for key, mask in self._selector.select():
                    stopping = stopping or key.fileobj is self._stopped
                    if key.fileobj is self._listener:
                        self._accept()
                    # One that another's frames, or these, have found gone is a client no more.
                    if mask & selectors.EVENT_WRITE and key.data in self._clients:
                        self._flush(key.data)
                    if mask & _READ and key.data in self._clients:
                        self._forward(key.data)
            for client in tuple(self._clients):
                self._part(client)
            self._path.unlink(missing_ok=True)

    def _accept(self) -> None:
        try:
            sock, _ = self._listener.accept()
        except OSError:
            return  # whoever wanted to join has given up
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        client = _Client(sock)
        self._clients.add(client)
        self._selector.register(sock, _READ, client)

    def _forward(self, sender: _Client) -> None:
        """A burst of the sender's frames, to all the others."""
        for _ in range(_BURST):
            try:
                packet, stamps, *_ = sender.sock.recvmsg(128, _STAMP_SPACE)
            except BlockingIOError:
                return
            except OSError:
                packet, stamps = b"", []
            if not packet:  # its end; an empty packet would look the same, and is no frame either
                self._part(sender)
                return
            if len(packet) not in FRAME_SIZES:
                self._counts["malformed"] += 1
                continue
            self._counts["frames"] += 1
            # One that was sent before this connection was accepted has no stamp.
            packet += stamps[0][2] if stamps else STAMP.pack(*divmod(time.time_ns(), 1_000_000_000))
            for client in tuple(self._clients):
                if client is sender:
                    continue
                # Whoever has missed a frame misses all until it has taken the rest: the news of it stands at its place.
                if client.dropped or len(client.waiting) >= self._queue:
                    client.dropped += 1
                    self._counts["dropped"] += 1
                    continue
                client.waiting.append(packet)
                if len(client.waiting) == 1:
                    self._flush(client)

    def _flush(self, client: _Client) -> None:
        """What waits for a client, as far as the kernel takes it now; and then the news that some was dropped."""
        try:
            while client.waiting:
                client.sock.send(client.waiting[0])
                client.waiting.popleft()
                self._counts["delivered"] += 1
                if client.dropped and not client.waiting:
                    client.waiting.append(_OVERFLOW)
                    client.dropped = 0
        except BlockingIOError:
            pass
        except OSError:
            self._part(client)
            return
        events = _BOTH if client.waiting else _READ
        if events != client.events:
            client.events = events
            self._selector.modify(client.sock, events, client)

    def _part(self, client: _Client) -> None:
        self._clients.discard(client)
        self._selector.unregister(client.sock)
        client.sock.close()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a hub until SIGINT or SIGTERM; say on the first line that it is ready, on the last what it has carried."""
    parser = argparse.ArgumentParser(prog="python -m drivers.can.bus.hub", description="A CAN bus between processes.")
    parser.add_argument("path", help="Unix socket; python-can programs join with interface='hub', channel=PATH")
    parser.add_argument("--queue", type=int, default=QUEUE, help=f"frames kept for a client behind ({QUEUE})")
    parser.add_argument("--stdin", action="store_true", help="end when standard input ends")
    options = parser.parse_args(arguments)
    if options.queue < 1:
        parser.error("--queue must be at least 1")
    try:
        hub = Hub(options.path, queue=options.queue)
    except OSError as error:
        sys.stderr.write(f"{error.strerror}\n")
        return 1
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: hub.stop())
    if options.stdin:

        def stop_at_end_of_input() -> None:
            while os.read(sys.stdin.fileno(), 4096):
                pass
            hub.stop()

        threading.Thread(target=stop_at_end_of_input, daemon=True).start()
    _say(event="ready", path=options.path)
    hub.run()
    _say(event="stopped", **hub.statistics())
    return 0


def _say(**words: object) -> None:
    # Whoever started the hub may have gone before its last word.
    with suppress(OSError):
        os.write(1, json.dumps(words).encode() + b"\n")


if __name__ == "__main__":
    raise SystemExit(main())
