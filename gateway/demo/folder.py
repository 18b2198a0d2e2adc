"""The folder of a demonstration: its own, held by one at a time, and never one with somebody else's files."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

MARKER = ".decanter-demo"
WRITTEN = (
    "device.toml", "plant.toml", "replay.csv", "plc.jsonl", "plc.log", "gateway.out", "gateway.log.jsonl",
    "can_hub.log", "status.json", "samples.jsonl", "demo.png", "historian.sqlite", "historian.sqlite-wal",
    "historian.sqlite-shm", "historian.sqlite.lock", "certificates/ca.pem", "certificates/ca.key",
    "certificates/server.pem", "certificates/server.key", "certificates/client.pem", "certificates/client.key",
)  # fmt: skip
"""What a demonstration leaves, beside the models' folders; the next one in the same folder begins without them."""
FURTHER_PICTURE = "demo_"
"""How the picture of a replay's further bearing begins."""


@contextmanager
def hold_folder(folder: Path) -> Iterator[None]:
    """Make the folder, or take over an earlier demonstration's; freed when the process ends, however it ends.

    Raises ValueError, in one sentence, where there is something else, or another demonstration runs there.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not (folder / MARKER).exists() and any(folder.iterdir()):
            raise ValueError(f"{folder}: holds files that no demo has written; give --out a new or an empty folder")
        lock = os.open(folder / MARKER, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o644)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ValueError(f"{folder}: cannot be used ({reason}); give --out a folder that this user may write") from None
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ValueError(f"{folder}: another demo is running there; wait, or give --out another folder") from None
        yield
    finally:
        os.close(lock)


def clear(folder: Path) -> None:
    """Remove what an earlier demonstration left. Raises OSError."""
    for path in (*(folder / name for name in WRITTEN), *folder.glob(f"{FURTHER_PICTURE}*.png")):
        path.unlink(missing_ok=True)
    with suppress(OSError):  # not there, or with somebody else's files in it
        (folder / "certificates").rmdir()
