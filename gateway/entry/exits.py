"""How a command ends: its exit code, and one sentence on standard error.

Nothing heavy is imported here: the groups need it before they know which command is wanted.
"""

import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import IntEnum
from errno import EDQUOT, ENOSPC
from typing import Any, NoReturn

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
from gateway.entry.plain import write_plainly
from sim.strict_json import json_text


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


@dataclass(slots=True)
class CallAnswer:
    """How a call is answered: whether it asked for JSON, and whether its one object was printed already."""

    as_json: bool = False
    given: bool = False


def print_json(data: Mapping[str, Any]) -> None:
    """The one JSON object that answers this call, on standard output; escaped where that cannot show every sign."""
    text = json_text(data)
    if not (sys.stdout.encoding or "").lower().startswith("utf"):
        text = json.dumps(json.loads(text))
    click.echo(text)
    context = click.get_current_context(silent=True)
    if context is not None and (answer := context.find_object(CallAnswer)) is not None:
        answer.given = True


def fail(sentence: str, code: int = Exit.USAGE, *, answer: CallAnswer | None = None) -> NoReturn:
    """Say one sentence on standard error, with --json also as the object that was not printed yet; leave with the code.

    `answer` is that of click's context, where there is one.
    """
    context = click.get_current_context(silent=True)
    if answer is None and context is not None:
        answer = context.find_object(CallAnswer)
    if answer is not None and answer.as_json and not answer.given:
        print_json({"ok": False, "exit": int(code), "reason": sentence})
    click.secho(f"decanter: {sentence}", fg="red", err=True)
    sys.exit(code)


def run_answered(run: Callable[..., Any], words: Sequence[str]) -> NoReturn:
    """Run a click command's `main` with these words; what click has to say is one sentence too, and the exit code.

    `run` takes the words, `standalone_mode` and `obj` as `click.Command.main` does.
    """
    for stream in (sys.stdout, sys.stderr):
        write_plainly(stream)
    answer = CallAnswer(as_json="--json" in words)
    try:
        code = run(list(words), standalone_mode=False, obj=answer)
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        sys.exit(Exit.USAGE)
    except click.Abort:
        fail("stopped before the end", Exit.INTERRUPTED, answer=answer)
    except click.ClickException as error:
        # Click breaks some of its messages into lines, and ends some with a full stop.
        said = " ".join(error.format_message().split()).rstrip(".")
        context = getattr(error, "ctx", None)
        remedy = f"; see `{context.command_path} --help`" if context is not None else ""
        fail(said + remedy, error.exit_code, answer=answer)
    sys.exit(code if isinstance(code, int) else Exit.OK)


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
