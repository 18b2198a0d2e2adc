"""A folder in memory, where there is one: what a test writes durably need not wait for a busy disk."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

MEMORY = Path("/dev/shm")  # noqa: S108 - a folder of a name of its own is made there


@contextmanager
def folder_in_memory(otherwise: Path) -> Iterator[Path]:
    """A new folder that is gone afterwards; below `otherwise` where nothing can be kept in memory."""
    home = MEMORY if MEMORY.is_dir() and os.access(MEMORY, os.W_OK) else otherwise
    with tempfile.TemporaryDirectory(dir=home, prefix="decanter-") as name:
        yield Path(name)
