"""Files of artefacts (models, reports, exports): read whole, replaced at one moment, refused in one sentence."""

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from drivers.errors import OneLineError
from drivers.named_files import contents, endless_number, name_write_errors


class ArtefactError(OneLineError, ValueError):
    """A file cannot be used or written. The message names file, line or key, the reason and what would be right."""


def file_error(file: str | Path, line: int | None, sentence: str) -> ArtefactError:
    """The error `file:line: sentence`."""
    return ArtefactError(f"{file}: {sentence}" if line is None else f"{file}:{line}: {sentence}")


def read_text(path: Path) -> str:
    """The file's text (UTF-8, with or without a byte-order mark). Raises ArtefactError when it cannot be read."""
    try:
        text = contents(path).decode("utf-8-sig")
    except FileNotFoundError:
        raise file_error(path, None, "there is no such file; give the path of an existing one") from None
    except UnicodeDecodeError as error:
        raise file_error(path, None, f"byte {error.start} is not UTF-8; save the file as UTF-8") from None
    except OSError as error:
        raise file_error(
            path, None, f"cannot be read ({error.strerror}); make it a file that this user can read"
        ) from None
    if problem := endless_number(text):
        raise file_error(path, None, problem)
    return text


def check_utf8(path: Path) -> None:
    """Raises ArtefactError for a path that is no UTF-8, as neither JSON nor a table can hold it."""
    try:
        str(path.absolute()).encode()
    except UnicodeEncodeError:
        raise file_error(repr(str(path)), None, "is no UTF-8; rename what in it shows as \\udc..") from None


def resolve_links(path: Path) -> Path:
    """The path with its links followed. Raises ArtefactError where they lead in a circle."""
    try:
        return path.resolve()
    except RuntimeError:
        raise file_error(path, None, "is a link that leads back to itself; give another path") from None


def write_error(path: Path, error: OSError) -> ArtefactError:
    """The sentence for a file or directory that the system does not let us write."""
    return file_error(
        path, None, f"cannot be written ({error.strerror}); make room there, or choose a directory where you may write"
    )


@contextmanager
def held_alone(lock: Path, busy: Exception) -> Iterator[None]:
    """Holds a lock file, made if need be, which the system releases when the process dies.

    Raises `busy` where another process holds it, and OSError.
    """
    handle = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise busy from None
        yield
    finally:
        os.close(handle)


def write_durably(path: Path, content: str) -> None:
    """Writes a new file and waits until it is on the disk. Raises OSError."""
    with name_write_errors(path), path.open("wb") as stream:
        stream.write(content.encode("utf-8"))
        stream.flush()
        os.fsync(stream.fileno())


def replace_durably(path: Path, content: str) -> None:
    """Puts `content` in place of what `path` held, at one moment: a reader sees the old or the new. Raises OSError."""
    beside = path.with_name(f".{path.name}.new")
    try:
        write_durably(beside, content)
        beside.replace(path)
    except OSError:
        with suppress(OSError):
            beside.unlink()
        raise
    sync_directory(path.parent)


def sync_directory(directory: Path) -> None:
    """Waits until the directory's own entries (names) are on the disk. Raises OSError."""
    handle = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
