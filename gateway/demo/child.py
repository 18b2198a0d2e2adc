"""A child process of the demonstration: what it said last, and how it is stopped."""

import signal
import subprocess
from contextlib import suppress
from pathlib import Path
from typing import Any

from drivers.errors import OneLineError


class DemoError(OneLineError, RuntimeError):
    """A process of the demonstration did not do what it had to; the message says which, and where its words are."""


def last_words(log: Path) -> str:
    """The last line that a process wrote, and where the rest is."""
    lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines() if log.is_file() else []
    return f"{lines[-1]} ({log})" if lines else f"it left no word in {log}"


def stop(process: subprocess.Popen[Any], patience_s: float = 10.0) -> int:
    """Ask a process to end, insist after `patience_s` or when interrupted once more; returns its exit code."""
    try:
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
            with suppress(subprocess.TimeoutExpired):
                process.wait(patience_s)
    finally:
        if process.poll() is None:
            process.kill()
        code = process.wait()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with suppress(BrokenPipeError):
                    pipe.close()
    return code
