"""Power cuts without a power switch: what a process did to its files, and the disks that a cut may leave behind.

A library that is preloaded into the process (`power_cut.c`) keeps a journal of its writes, truncations, removals and
syncs with their moments. From the journal any number of disks can be made up, for any moment: what was synced before
the moment is there, and of each file's later changes every one is there or not, as drawn, the last one perhaps in
part, by sectors. That is worse than most disks and no better than any.
"""

import os
import struct
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from random import Random

SOURCE = Path(__file__).with_name("power_cut.c")
SECTOR = 512
_HEAD = struct.Struct("<QQQII")


class DiskCall(IntEnum):
    """What was done, by the numbers of `power_cut.c`."""

    WRITE = 1
    TRUNCATE = 2
    SYNC = 3
    REMOVE = 4
    RENAME = 5


@dataclass(frozen=True, slots=True)
class DiskChange:
    """One row of the journal: its moment (s, CLOCK_MONOTONIC), what was done, to which file, where and with what."""

    time: float
    kind: DiskCall
    path: Path
    offset: int
    data: bytes


def build(folder: Path) -> Path:
    """The library to preload. Raises CalledProcessError or FileNotFoundError without a C compiler."""
    library = folder / "power_cut.so"
    command = ["cc", "-O1", "-fPIC", "-shared", "-o", str(library), str(SOURCE), "-ldl", "-lpthread"]
    subprocess.run(command, check=True, capture_output=True)
    return library


def environment(library: Path, folder: Path, journal: Path) -> dict[str, str]:
    """What a process needs in its environment so that its changes in `folder` are journalled."""
    return {"LD_PRELOAD": str(library), "JOURNAL_FOLDER": str(folder), "JOURNAL_FILE": str(journal), **os.environ}


def read_journal(path: Path) -> list[DiskChange]:
    """All rows; half a last one, of a killed process, is left out."""
    content, at, changes = path.read_bytes(), 0, []
    while at + _HEAD.size <= len(content):
        time, offset, size, kind, length = _HEAD.unpack_from(content, at)
        begin = at + _HEAD.size + length
        has_data = kind in (DiskCall.WRITE, DiskCall.RENAME)
        at = begin + (size if has_data else 0)
        if at <= len(content):
            name = content[begin - length : begin].decode()
            data = content[begin:at] if has_data else b""
            changes.append(DiskChange(time / 1e9, DiskCall(kind), Path(name), offset, data))
    return changes


def disk_after(changes: Sequence[DiskChange], moment: float, rng: Random) -> dict[Path, bytes]:
    """The files' contents that a cut at `moment` (s, monotonic) may leave, drawn from what is possible."""
    before = [change for change in changes if change.time <= moment]
    files: dict[Path, bytearray] = {}
    waiting: dict[Path, list[DiskChange]] = {}
    for change in before:
        if change.kind == DiskCall.SYNC:
            done = [*waiting.pop(change.path, ()), *_renamed_or_removed(waiting, change.path)]
            for each in done:
                _apply(files, each)
        else:
            waiting.setdefault(change.path, []).append(change)
    for later in waiting.values():
        kept = [change for change in later if rng.random() < 0.5]
        for number, change in enumerate(kept):
            _apply(files, _torn(change, rng) if number == len(kept) - 1 else change)
    return {path: bytes(content) for path, content in files.items()}


def _renamed_or_removed(waiting: dict[Path, list[DiskChange]], folder: Path) -> list[DiskChange]:
    """What the sync of a folder makes last: the removals and new names in it, taken out of what waits."""
    done = []
    for path, changes in waiting.items():
        if path.parent == folder:
            done += [change for change in changes if change.kind in (DiskCall.REMOVE, DiskCall.RENAME)]
            # What was written to a file before it was removed is of no use any more.
            last = max((number for number, change in enumerate(changes) if change.kind == DiskCall.REMOVE), default=-1)
            waiting[path] = [change for change in changes[last + 1 :] if change.kind != DiskCall.RENAME]
    return done


def write_disk(disk: Mapping[Path, bytes], was: Path, now: Path) -> None:
    """Put the files of the folder `was` into the folder `now`."""
    for path, content in disk.items():
        target = now / path.relative_to(was)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(content)


def _torn(change: DiskChange, rng: Random) -> DiskChange:
    if change.kind != DiskCall.WRITE:
        return change
    sectors = -(-len(change.data) // SECTOR)
    return DiskChange(
        change.time, DiskCall.WRITE, change.path, change.offset, change.data[: SECTOR * rng.randint(0, sectors)]
    )


def _apply(files: dict[Path, bytearray], change: DiskChange) -> None:
    match change.kind:
        case DiskCall.WRITE:
            content = files.setdefault(change.path, bytearray())
            content.extend(bytes(max(change.offset - len(content), 0)))
            content[change.offset : change.offset + len(change.data)] = change.data
        case DiskCall.TRUNCATE:
            content = files.setdefault(change.path, bytearray())
            del content[change.offset :]
            content.extend(bytes(change.offset - len(content)))
        case DiskCall.REMOVE:
            files.pop(change.path, None)
        case DiskCall.RENAME:
            if change.path in files:
                files[Path(change.data.decode())] = files.pop(change.path)
