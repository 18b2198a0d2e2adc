"""How a command ends: its exit code, and one sentence on standard error.

Nothing heavy is imported here: the groups need it before they know which command is wanted.
"""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from enum import IntEnum
from errno import EDQUOT, ENOSPC
from typing import NoReturn

import click

from drivers.errors import (
    AddressError,
    DeviceException,
    DriverError,
    EncodingError,
    RecordingError,
    ReplyTimeout,
    WriteForbidden,
)


class Exit(IntEnum):
    """Stable exit codes."""

    OK = 0
    CHECK_FAILED = 1
    USAGE = 2
    CANNOT_CONNECT = 3
    DEVICE_EXCEPTION = 4
    TIMEOUT = 5
    NOT_ARMED = 6
    INTERRUPTED = 130  # 128 + SIGINT, as a shell counts


def fail(sentence: str, code: int = Exit.USAGE) -> NoReturn:
    """Say one sentence on standard error and leave with the code."""
    click.secho(f"decanter: {sentence}", fg="red", err=True)
    sys.exit(code)


@contextmanager
def sentences() -> Iterator[None]:
    """Turn what bad input, the file system and the device cause into one sentence and its exit code.

    ValueError is what every room raises for input that cannot be used (its TraceError, ArtefactError, ConfigError and
    InputError among them), so a defect that shows as a ValueError looks the same: `decanter --traceback` tells them
    apart. Every other exception is a defect and is not caught.
    """
    try:
        yield
    except (DriverError, ValueError, OSError) as error:
        context = click.get_current_context(silent=True)
        if context is not None and context.find_root().params.get("traceback"):
            raise
        fail(sentence(error), exit_code(error))


def sentence(error: Exception) -> str:
    """What the error says; where the system only gave a word and a file, the file first and a remedy after."""
    if not isinstance(error, OSError) or error.strerror is None:
        return str(error)
    reason = error.strerror[0].lower() + error.strerror[1:]
    file = f"{error.filename}: " if error.filename else ""
    if error.errno in (ENOSPC, EDQUOT):
        return f"{file}{reason}; make room there, or give a path on another disk"
    return f"{file}{reason}; give a path that is there and that this user may read or write"


_CODES: tuple[tuple[type[Exception], Exit], ...] = (
    (ReplyTimeout, Exit.TIMEOUT),
    (DeviceException, Exit.DEVICE_EXCEPTION),
    (WriteForbidden, Exit.NOT_ARMED),
    (AddressError, Exit.USAGE),
    (EncodingError, Exit.USAGE),
    (RecordingError, Exit.USAGE),
    (DriverError, Exit.CANNOT_CONNECT),
)


def exit_code(error: Exception) -> Exit:
    """The stable exit code of an error: of a driver's by its kind, of any other that of wrong input."""
    return next((code for kind, code in _CODES if isinstance(error, kind)), Exit.USAGE)
