"""A terminal recording made by running commands: asciinema's file format, version 2, and the same as plain text."""

import json
import os
import pty
import re
import selectors
import struct
import subprocess
import termios
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from fcntl import ioctl
from pathlib import Path

WIDTH, HEIGHT = 120, 40
_ESCAPES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")
_TYPING_S = 0.4


@dataclass(slots=True)
class Cast:
    """What was shown: (seconds since the beginning, text). Machine time only, and a moment for what is typed."""

    title: str
    events: list[tuple[float, str]] = field(default_factory=list)
    clock: float = 0.0

    def say(self, text: str) -> None:
        """Something that no command printed."""
        self.events.append((self.clock, text.replace("\n", "\r\n")))
        self.clock += _TYPING_S

    def write(self, path: Path, began: float) -> None:
        """The recording as a .cast file; `began` in s UTC."""
        head = {"version": 2, "width": WIDTH, "height": HEIGHT, "timestamp": int(began), "title": self.title}
        lines = [json.dumps(head), *(json.dumps([round(at, 3), "o", text]) for at, text in self.events)]
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")

    def plain(self) -> str:
        """The same without colours, and with no blanks at the ends of lines."""
        text = _ESCAPES.sub("", "".join(text for _, text in self.events)).replace("\r\n", "\n")
        return "\n".join(line.rpartition("\r")[2].rstrip() for line in text.split("\n")).strip() + "\n"


def show(
    cast: Cast,
    command: Sequence[str],
    *,
    cwd: Path,
    environment: Mapping[str, str],
    answers: Callable[[str], str] | None = None,
    longest_s: float = 120.0,
) -> tuple[int, str]:
    """Run a command with a terminal of WIDTH columns as its standard output; gives exit code and what it printed.

    Questions come on standard error and end with a colon and a blank; `answers` gives what is typed. Raises
    TimeoutError after `longest_s`.
    """
    ours, theirs = pty.openpty()
    ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", HEIGHT, WIDTH, 0, 0))
    process = subprocess.Popen(
        command,
        cwd=cwd,
        env={**os.environ, "COLUMNS": str(WIDTH), "TERM": "xterm-256color", **environment},
        stdin=subprocess.PIPE,
        stdout=theirs,
        stderr=subprocess.PIPE,
    )
    os.close(theirs)
    begun, start = time.monotonic(), cast.clock
    try:
        printed = _followed(cast, process, ours, answers, (begun, start, longest_s))
        return process.wait(), printed
    finally:
        process.kill()
        process.wait()
        os.close(ours)
        for pipe in (process.stdin, process.stderr):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        cast.clock = start + time.monotonic() - begun


def _followed(
    cast: Cast,
    process: "subprocess.Popen[bytes]",
    terminal: int,
    answers: Callable[[str], str] | None,
    times: tuple[float, float, float],
) -> str:
    begun, start, longest = times
    printed, asked = "", ""
    assert process.stderr is not None and process.stdin is not None
    complaints = process.stderr.fileno()
    with selectors.DefaultSelector() as waiting:
        for descriptor in (terminal, complaints):
            waiting.register(descriptor, selectors.EVENT_READ)
        while waiting.get_map():
            if time.monotonic() - begun > longest:
                raise TimeoutError(f"{process.args!r} still runs after {longest:g} s; it said: {printed[-500:]}")
            for key, _ in waiting.select(1.0):
                data = _read(key.fd)
                if not data:
                    waiting.unregister(key.fd)
                    continue
                text = data.decode("utf-8", errors="replace")
                printed += text
                shown = text if key.fd == terminal else text.replace("\n", "\r\n")
                cast.events.append((start + time.monotonic() - begun, shown))
                asked = (asked + text).rpartition("\n")[2] if key.fd == complaints else asked
                if answers is not None and key.fd == complaints and asked.endswith(": "):
                    answer = answers(asked)
                    asked = ""
                    process.stdin.write(f"{answer}\n".encode())
                    process.stdin.flush()
                    cast.events.append((start + time.monotonic() - begun, f"{answer}\r\n"))
    return printed


def _read(descriptor: int) -> bytes:
    """What there is; b"" at the end (a terminal whose other side is gone says so by an error)."""
    try:
        return os.read(descriptor, 65536)
    except OSError:
        return b""
