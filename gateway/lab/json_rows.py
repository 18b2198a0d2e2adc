"""Files of one JSON object a line that only grow: a row is there whole or not at all, also after a kill."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from drivers.named_files import contents, name_write_errors, unusable
from drivers.settings import first_sentence
from sim.files import ArtefactError, file_error, sync_directory
from sim.strict_json import json_text

REMEDY = "restore the file from a backup, or take that line out"


class RowKeys(BaseModel):
    """The keys of a row that its reader uses, and what they hold; what else a row has is not looked at."""

    model_config = ConfigDict(extra="ignore", frozen=True, strict=True, allow_inf_nan=False)


Keys = TypeVar("Keys", bound=RowKeys)


def read_rows(path: Path) -> list[dict[str, Any]]:
    """The rows of a file, none where there is no file; a last line that a kill cut off is no row.

    Raises ArtefactError with file and line for what is no such file.
    """
    if not path.exists():
        return []
    try:
        # Only "\n" ends a row: a text in it may hold what Unicode calls the end of a line, such as U+2028.
        *whole, last = contents(path).split(b"\n")
    except OSError as error:
        raise file_error(
            path, None, f"cannot be read ({error.strerror}); make it a file that this user can read"
        ) from None
    rows: list[dict[str, Any]] = []
    for number, line in enumerate(whole, 1):
        row = _row(line)
        if row is None:
            raise file_error(path, number, f"is no JSON object; {REMEDY}")
        if problem := unusable(row):
            raise file_error(path, number, f"{problem}, or {REMEDY}")
        rows.append(row)
    # An editor may leave out the last line break; what a kill leaves of an object is none, as its brace is missing.
    ended = _row(last)
    return rows if ended is None else [*rows, ended]


def _row(line: bytes) -> dict[str, Any] | None:
    """The object that a line holds, or None."""
    try:
        row = json.loads(line.decode("utf-8-sig"))
    except (ValueError, RecursionError):
        return None
    return row if isinstance(row, dict) else None


def check_row(path: Path, number: int, row: Mapping[str, Any], keys: type[Keys], remedy: str = REMEDY) -> Keys:
    """What a reader uses of row `number` (from 1).

    Raises ArtefactError with file, line, key and `remedy` where a key lacks or is of another type. Nothing of ours
    writes such a row: somebody has edited the file.
    """
    try:
        return keys.model_validate(row)
    except ValidationError as error:
        raise ArtefactError(f"{first_sentence(keys, error, f'{path}:{number}')}, or {remedy}") from None


def append_row(path: Path, row: Mapping[str, Any]) -> None:
    """Add a row and wait until it is on the disk; whoever appends holds a lock. Raises OSError."""
    new = not path.exists()
    with name_write_errors(path), path.open("x+b" if new else "r+b") as stream:
        size = end = stream.seek(0, os.SEEK_END)
        while end and os.pread(stream.fileno(), 1, end - 1) != b"\n":
            end -= 1
        whole = _row(os.pread(stream.fileno(), size - end, end)) is not None
        if not whole:
            # What a kill left of a line would make the next one unreadable: it goes.
            stream.truncate(end)
        stream.seek(0, os.SEEK_END)
        stream.write((b"\n" if whole else b"") + json_text(row).encode() + b"\n")
        stream.flush()
        os.fsync(stream.fileno())
    if new:
        sync_directory(path.parent)
