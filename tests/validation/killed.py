"""Work that kills the process it is done in, in a module of its own: a worker has little to import before it dies."""

import os
import signal
from pathlib import Path


def twice(task: tuple[int, str, bool]) -> int:
    """2 n, in a process that is killed first: once (while the file is not there), or each time."""
    number, marker, always = task
    if marker and (always or not Path(marker).exists()):
        Path(marker).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * number


def divided(number: int) -> float | str:
    """Eight by a number."""
    return 8 / number
