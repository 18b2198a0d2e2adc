"""What every command of the commissioning did: one line of JSON each, only ever appended, each bound to the one before.

A line's `previous` is the SHA-256 of the line before it, so a changed, missing or inserted line shows (`find_break`).
"""

import fcntl
import json
import os
import platform
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from drivers.errors import OneLineError
from drivers.named_files import name_write_errors
from gateway.store import first_break, make_private, sha256_hex
from sim.strict_json import json_text

LIBRARIES = ("decanter-gateway", "pymodbus", "python-can", "canopen", "cantools", "pyserial")


class RecordsError(OneLineError, ValueError):
    """The file of records cannot be used; the message says which line and why."""


@dataclass(frozen=True, slots=True)
class CommandRecord:
    """One command that was carried out, or was tried.

    `time` is its begin and `seconds` how long it took (s UTC, s), `code` its exit code, `result` what it gave as JSON,
    `frames` what went over the wire (sent, received, bytes, sha256, pcap), `configuration` the SHA-256 of each file
    that it used, `who` the person, `machine` where.
    """

    time: float
    seconds: float
    command: str
    arguments: Mapping[str, Any]
    place: str
    code: int
    reason: str
    result: Mapping[str, Any]
    frames: Mapping[str, Any]
    configuration: Mapping[str, str]
    versions: Mapping[str, str]
    who: str
    machine: str
    previous: str = field(default="")


def append(path: Path, record: CommandRecord) -> str:
    """Append the record durably, bound to the last line; gives the SHA-256 of the new line. Raises OSError.

    Two commands at a time take their turns.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    make_private(path)
    with name_write_errors(path), path.open("a+b") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        # The last line is read backwards in blocks: a file of records grows for years, and an append must not.
        start, tail = os.lseek(file.fileno(), 0, os.SEEK_END), b""
        while start > 0 and tail.count(b"\n", 0, -1) < 1:
            size = min(65536, start)
            start -= size
            tail = os.pread(file.fileno(), size, start) + tail
        lines = tail.splitlines()
        plain = {**asdict(record), "previous": sha256_hex(lines[-1]) if lines else ""}
        line = json_text(plain).encode()
        file.write(line + b"\n")
        file.flush()
        os.fsync(file.fileno())
    return sha256_hex(line)


def check_writable(path: Path) -> None:
    """Raises OSError where no record could be appended: better before the command than after it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    make_private(path)
    with path.open("ab"):
        pass


def read_records(path: Path) -> list[CommandRecord]:
    """All records in their order. Raises RecordsError for a line that is none, OSError for a file that is not there."""
    records = []
    for number, line in enumerate(_lines(path), start=1):
        try:
            plain = json.loads(line)
            records.append(CommandRecord(**{key.name: plain[key.name] for key in fields(CommandRecord)}))
        except (ValueError, KeyError, TypeError) as error:
            raise RecordsError(
                f"{path}: line {number} is no record ({error}); the file was changed by something else"
            ) from None
    return records


def find_break(path: Path) -> int | None:
    """The number of the first line (1..) that does not follow the one before it; None for an unbroken chain.

    The last line is bound by nothing after it: keep the hash that `append` gave, or the report's. Raises RecordsError
    and OSError as `read_records` does.
    """
    before = ("", *(sha256_hex(line) for line in _lines(path)))
    return first_break(zip((record.previous for record in read_records(path)), before, strict=False))


def file_hashes(paths: Iterable[Path]) -> dict[str, str]:
    """The SHA-256 of each file that is there."""
    return {str(path): sha256_hex(path.read_bytes()) for path in paths if path.is_file()}


def versions(libraries: Sequence[str] = LIBRARIES) -> dict[str, str]:
    """What this machine runs: Python, the system and the libraries that speak to the device."""
    numbers = {"python": platform.python_version(), "system": platform.platform()}
    for name in libraries:
        try:
            numbers[name] = version(name)
        except PackageNotFoundError:
            numbers[name] = "not installed"
    return numbers


def format_moment(moment: float | None) -> str:
    """A moment (s UTC) for a person; "" for None."""
    return "" if moment is None else time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(moment))


def _lines(path: Path) -> list[bytes]:
    return path.read_bytes().splitlines()
