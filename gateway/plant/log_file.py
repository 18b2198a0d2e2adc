"""A log file that is begun anew by size and age, and whose disk may be full or gone."""

import json
import os
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from datetime import datetime
from pathlib import Path

from gateway.store import RECORDS_MODE, SQLITE_HEADER

RETRY_SECONDS = 5.0
_DAY = 86_400.0
_LONGEST = 1 << 16
"""Bytes of the first line that are looked at for its time."""


class LogFile:
    """Lines appended to `path`; NAME.1 is the file before it, NAME.2 the one before that, `keep` of them at most.

    A new file is begun at `max_bytes`, and when the first line is more than `max_days` away by the wall clock. What is
    deleted goes by the number of files alone: a clock that jumped deletes nothing before its turn. A write that fails
    loses its line, is counted, and is tried again RETRY_SECONDS later; a file or a folder that somebody removed or
    moved is made anew. Nothing here raises but the constructor: OSError for a path that cannot be written, unless it is
    `patient`.
    """

    # The standard library's handlers rotate by size or by age, not by both, and go on writing into a deleted file.

    def __init__(
        self,
        path: Path,
        *,
        max_bytes: int,
        max_days: float,
        keep: int,
        patient: bool = False,
        wall: Callable[[], float] = time.time,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self.path, self.lost = path, 0
        self._max_bytes, self._max_days, self._keep = max_bytes, max_days, keep
        self._wall, self._monotonic = wall, monotonic
        self._file = -1
        self._retry_at = 0.0
        self._failure = ""
        # Reentrant: a signal's handler may log while a line is being written by the same thread.
        self._lock = threading.RLock()
        try:
            self._open()
        except OSError as error:
            if not patient:
                raise
            self._fail(error)

    def write(self, line: str) -> None:
        """Append one line (without its end); it is given to the system at once."""
        with self._lock:
            self._write(line)

    def complaint(self) -> str:
        """Why nothing can be written now, which is tried once more; "" if it can."""
        with self._lock:
            if self._failure and self._file < 0 and self._monotonic() >= self._retry_at:
                try:
                    self._open()
                    self._failure = ""
                except OSError as error:
                    self._fail(error)
            return self._failure

    def _write(self, line: str) -> None:
        if self._file < 0 and self._monotonic() < self._retry_at:
            self.lost += 1
            return
        data = line.encode("utf-8", "backslashreplace") + b"\n"
        try:
            self._follow(len(data))
            if self.lost:
                self._append(f'{{"event": "log lines were lost", "level": "error", "lines": {self.lost}}}\n'.encode())
                self.lost = 0
            self._append(data)
            self._failure = ""
        except OSError as error:
            self.lost += 1
            self._fail(error)

    def close(self) -> None:
        """Let the file go. May be called twice."""
        if self._file >= 0:
            with suppress(OSError):
                os.close(self._file)
        self._file = -1

    def _fail(self, error: OSError) -> None:
        reason = error.strerror or error
        self._failure = f"{self.path}: the log cannot be written ({reason}); see to the disk or the path"
        self._retry_at = self._monotonic() + RETRY_SECONDS
        self.close()

    def _open(self) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        # Not blocking: a named pipe that nobody reads is refused and not waited for.
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC | os.O_NONBLOCK
        self._file = os.open(self.path, flags, RECORDS_MODE)
        if self._is_database():
            self.close()
            raise OSError("it is a database, and no log")
        self._size, self._begun = os.fstat(self._file).st_size, self._first_line_time()

    def _is_database(self) -> bool:
        """Whether there is a SQLite database at the path: lines in it, and its rotation, would be its end."""
        with suppress(OSError), self.path.open("rb") as file:
            return file.read(len(SQLITE_HEADER)) == SQLITE_HEADER
        return False

    def _append(self, data: bytes) -> None:
        written = os.write(self._file, data)
        if written < len(data):
            # A disk that took half of a line: the half goes again, so that the next line begins as one.
            with suppress(OSError):
                os.ftruncate(self._file, self._size)
            raise OSError("the disk is full")
        self._size += written

    def _follow(self, more: int) -> None:
        """Have the file open that is at the path now, and begun anew if it is too large or too old for the line."""
        if self._file >= 0:
            try:
                there, own = self.path.stat(), os.fstat(self._file)
                moved = (there.st_dev, there.st_ino) != (own.st_dev, own.st_ino)
                self._size = own.st_size
            except FileNotFoundError:
                moved = True
            if moved:
                self.close()
        if self._file < 0:
            self._open()
        too_old = abs(self._wall() - self._begun) > self._max_days * _DAY
        if self._size and (self._size + more > self._max_bytes or too_old):
            self.close()
            for number in range(self._keep - 1, 0, -1):
                with suppress(FileNotFoundError):
                    self._rotated_path(number).replace(self._rotated_path(number + 1))
            self.path.replace(self._rotated_path(1))
            self._open()

    def _rotated_path(self, number: int) -> Path:
        return self.path.with_name(f"{self.path.name}.{number}")

    def _first_line_time(self) -> float:
        """When the file's first line was written (s, wall clock); now for an empty file or another kind of line."""
        faults = (OSError, ValueError, LookupError, TypeError, ArithmeticError, RecursionError)
        with suppress(*faults), self.path.open("rb") as file:
            return datetime.fromisoformat(json.loads(file.readline(_LONGEST))["timestamp"]).timestamp()
        return self._wall()
