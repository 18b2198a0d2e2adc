"""Buses whose frames wait where the system keeps them: one with a descriptor, and one that only a thread can read."""

import os
import struct
import threading
import time
from collections import deque

import can


class QueuedBus(can.BusABC):
    """Its descriptor can be read while a frame waits."""

    def __init__(self) -> None:
        super().__init__("queued")
        self.waiting: deque[can.Message] = deque()
        self._descriptor = os.eventfd(0, os.EFD_NONBLOCK)

    def say(self, *frames: can.Message) -> None:
        """Have frames wait."""
        self.waiting.extend(frames)
        os.eventfd_write(self._descriptor, 1)

    def fileno(self) -> int:
        """The descriptor."""
        return self._descriptor

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        message = self.waiting.popleft() if self.waiting else None
        if message is not None and not self.waiting:
            os.eventfd_read(self._descriptor)
        return message, False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Nobody sends."""
        raise NotImplementedError

    def shutdown(self) -> None:
        """Leave the bus. May be called twice."""
        super().shutdown()
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


class ThreadedBus(can.BusABC):
    """It has no descriptor: whoever wants a frame waits for it in `recv`."""

    def __init__(self) -> None:
        super().__init__("threaded")
        self.waiting: deque[can.Message] = deque()
        self._news = threading.Condition()

    def say(self, *frames: can.Message) -> None:
        """Have frames wait."""
        with self._news:
            self.waiting.extend(frames)
            self._news.notify_all()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        with self._news:
            self._news.wait_for(lambda: self.waiting, timeout)
            message = self.waiting.popleft() if self.waiting else None
        time.sleep(0)
        return message, False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Nobody sends."""
        raise NotImplementedError


def frame(number: int, value: int, length: int = 2) -> can.Message:
    """A frame whose first two bytes hold a value."""
    data = struct.pack("<H", value).ljust(length, b"\0")
    return can.Message(arbitration_id=number, data=data, is_extended_id=False)
