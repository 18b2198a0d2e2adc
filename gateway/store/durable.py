"""Files that are there whole or not at all, also after a power cut; damaged ones are set aside, never deleted."""

import os
from contextlib import suppress
from pathlib import Path
from threading import get_native_id

RECORDS_MODE = 0o640
"""Records are their owner's and its group's to read, whatever the umask of who starts the program."""
SQLITE_HEADER = b"SQLite format 3\0"
"""What each database of SQLite begins with (sqlite.org/fileformat.html)."""
DATABASE_SUFFIXES = ("", "-wal", "-shm", "-journal")
"""What SQLite keeps beside a database belongs to it."""


def write_durably(path: Path, data: bytes, *, mode: int = RECORDS_MODE, replace: bool = True) -> None:
    """Write a file in one step: to a temporary name, to the disk, then renamed. Raises OSError.

    Without `replace` FileExistsError is raised where there is one already.
    """
    draft = path.with_name(f".{path.name}.{os.getpid()}.{get_native_id()}")
    draft.unlink(missing_ok=True)  # of one that was killed, and had the same number
    file = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode)
    try:
        with os.fdopen(file, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        if replace:
            draft.replace(path)
        else:
            os.link(draft, path)  # fails where the name is taken, which a rename does not
        sync_folder(path.parent)
    finally:
        draft.unlink(missing_ok=True)


def make_private(path: Path) -> None:
    """Make an empty file that others cannot read, where there is none; SQLite gives what it keeps beside it its mode.

    Never raises: whoever opens the file next says better why it cannot be.
    """
    with suppress(OSError):
        os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, RECORDS_MODE))


def sync_folder(folder: Path) -> None:
    """Have the names in a folder on the disk."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def free_name(path: Path, why: str) -> Path:
    """The first of NAME.WHY-1, NAME.WHY-2 and so on beside a file that is not there yet."""
    number = 1
    while (aside := path.with_name(f"{path.name}.{why}-{number}")).exists():
        number += 1
    return aside


def set_aside(path: Path) -> Path:
    """Give a database another name beside it, NAME.damaged-1 and so on; gives that path. Raises OSError."""
    aside = free_name(path, "damaged")
    for suffix in DATABASE_SUFFIXES:
        with suppress(FileNotFoundError):
            path.with_name(path.name + suffix).rename(aside.with_name(aside.name + suffix))
    sync_folder(path.parent)
    return aside


def numbered_files(path: Path) -> list[Path]:
    """The files NAME.2, NAME.1 and NAME of a log that is begun anew now and then, as far as they are there: the oldest
    first."""
    numbered = {
        int(suffix): file
        for file in path.parent.glob(f"{path.name}.*")
        if (suffix := file.name.removeprefix(f"{path.name}.")).isdecimal()
    }
    older = [numbered[number] for number in sorted(numbered, reverse=True)]
    return [*older, path] if path.exists() else older
