"""The CAN bus of the demonstration: a hub between the two processes, as a process of its own."""

import hashlib
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gateway.demo.child import DemoError, stop

LONGEST_PATH = 100
"""Bytes that the path of a Unix socket may have (Linux: 107)."""


def hub_path(folder: Path) -> Path:
    """The hub's socket: in the folder, or under the temporary directory where that path would be too long."""
    path = folder.absolute() / "can.hub"
    if len(str(path).encode()) <= LONGEST_PATH:
        return path
    name = hashlib.sha256(str(path).encode()).hexdigest()[:16]
    return Path(tempfile.gettempdir()) / f"decanter-{name}.hub"


@contextmanager
def can_hub(folder: Path) -> Iterator[Path]:
    """Run a hub; ended on leaving. Raises DemoError when it does not come up."""
    path, log = hub_path(folder), folder / "can_hub.log"
    with log.open("w", encoding="utf-8") as words:
        process = subprocess.Popen(
            [sys.executable, "-m", "drivers.can.bus.hub", str(path), "--stdin"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=words,
            text=True,
            process_group=0,
        )
    try:
        if process.stdout is None or not process.stdout.readline():
            raise DemoError(f"the CAN hub did not start: {log.read_text(encoding='utf-8').strip() or log}")
        yield path
    finally:
        stop(process)
