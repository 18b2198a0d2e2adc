"""Files of one JSON object a line that only grow: a row is there whole or not at all, also after a kill."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from drivers.named_files import writing
from sim.files import at, read_text, sync_directory
from sim.strict_json import json_text


def read_rows(path: Path) -> list[dict[str, Any]]:
    """The rows of a file, none where there is no file; a last line that a kill cut off is no row.

    Raises ArtefactError with file and line for what is no such file.
    """
    if not path.exists():
        return []
    text = read_text(path)
    rows: list[dict[str, Any]] = []
    for number, line in enumerate(text[: text.rfind("\n") + 1].splitlines(), 1):
        try:
            row = json.loads(line)
        except (ValueError, RecursionError):
            row = None
        if not isinstance(row, dict):
            raise at(path, number, "is no JSON object; restore the file from a backup, or take that line out")
        rows.append(row)
    return rows


def append_row(path: Path, row: Mapping[str, Any]) -> None:
    """Add a row and wait until it is on the disk; whoever appends holds a lock. Raises OSError."""
    new = not path.exists()
    with writing(path), path.open("x+b" if new else "r+b") as stream:
        size = stream.seek(0, os.SEEK_END)
        # What a kill left of a line would make the next one unreadable: it goes.
        while size and os.pread(stream.fileno(), 1, size - 1) != b"\n":
            size -= 1
        stream.truncate(size)
        stream.seek(size)
        stream.write(json_text(row).encode() + b"\n")
        stream.flush()
        os.fsync(stream.fileno())
    if new:
        sync_directory(path.parent)
