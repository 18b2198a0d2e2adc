"""How a command ends: its exit code, and one sentence on standard error.

Nothing heavy is imported here: the groups need it before they know which command is wanted.
"""

import dis
import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import IntEnum
from errno import EDQUOT, ENOSPC
from types import TracebackType
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
    missing_part,
    one_line,
    one_sentence,
)
from gateway.entry.plain import write_plainly
from sim.strict_json import json_text


class Exit(IntEnum):
    """Stable exit codes."""

    OK = 0
    CHECK_FAILED = 1
    FAULT = 1  # of the program: Python's own code for an error that nobody caught
    USAGE = 2
    CANNOT_CONNECT = 3
    DEVICE_EXCEPTION = 4
    TIMEOUT = 5
    NOT_ARMED = 6
    INTERRUPTED = 130  # 128 + SIGINT, as a shell counts


@dataclass(slots=True)
class CallAnswer:
    """How a call is answered: whether it asked for JSON, whether its one object was printed, whether it complained."""

    as_json: bool = False
    given: bool = False
    complained: bool = False


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

    `answer` is that of click's context, where there is one. What the sentence quotes steers no terminal; only the
    problems of a configuration have a line each.
    """
    sentence = "\n".join(map(one_sentence, sentence.split("\n")))
    context = click.get_current_context(silent=True)
    if answer is None and context is not None:
        answer = context.find_object(CallAnswer)
    if answer is not None:
        answer.complained = True
    if answer is not None and answer.as_json and not answer.given:
        print_json({"ok": False, "exit": int(code), "reason": sentence})
    click.secho(f"decanter: {sentence}", fg="red", err=True)
    sys.exit(code)


def _also_missing(error: click.MissingParameter, words: Sequence[str]) -> list[str]:
    """The other options without which the command does not run either: click tells of one, and then of the next."""
    if error.ctx is None:
        return []
    given = {word.partition("=")[0] for word in words}
    return [
        option.opts[0]
        for option in error.ctx.command.params
        if isinstance(option, click.Option) and option.required and option is not error.param
        and not given.intersection(option.opts) and option.value_from_envvar(error.ctx) is None
    ]  # fmt: skip


def run_command(run: Callable[..., Any], words: Sequence[str]) -> NoReturn:
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
        if isinstance(error, click.MissingParameter):
            said += "".join(f", and {option!r}" for option in _also_missing(error, words))
        context = getattr(error, "ctx", None)
        remedy = f"; see `{context.command_path} --help`" if context is not None else ""
        fail(said + remedy, error.exit_code, answer=answer)
    except ModuleNotFoundError as error:
        # What serves other needs than a plant's may be left out of an installation; what asks for it says so.
        if "--traceback" in words or not (lacking := missing_part(error)):
            raise
        fail(f"this command {lacking}", answer=answer)
    sys.exit(code if isinstance(code, int) else Exit.OK)


@contextmanager
def sentences() -> Iterator[None]:
    """Turn what bad input, the file system and the device cause into one sentence and its exit code.

    ValueError is what every room raises for input that cannot be used (its TraceError, ArtefactError, ConfigError and
    InputError among them). What a numerical library raises, and an invariant that is broken, is a fault of the program
    and said as one (`is_fault`). Every other exception is a defect as well and is not caught.
    """
    try:
        yield
    except (DriverError, ValueError, OSError, ArithmeticError, AssertionError, IndexError) as error:
        context = click.get_current_context(silent=True)
        if context is not None and context.find_root().params.get("traceback"):
            raise
        if not (is_fault(error) or isinstance(error, (DriverError, ValueError, OSError))):
            raise
        fail(sentence(error), exit_code(error))


NUMERICAL = ("numpy", "scipy", "sklearn")
"""Libraries that compute: what they refuse was given to them by the program, never by a person."""


def is_fault(error: Exception) -> bool:
    """Whether an invariant of the program is broken, or a numerical library refuses what the program gave it."""
    if isinstance(error, AssertionError):
        return True
    way = list(_way(error))
    libraries = [type(error).__module__, *(_module(each) for each in way[-1:])]
    if any(name.partition(".")[0] in NUMERICAL for name in libraries):
        return True
    raised = type(error) in (ValueError, IndexError) or isinstance(error, ArithmeticError)
    if not raised or not way or "np" not in way[-1].tb_frame.f_globals:
        return False
    # The compiled part of NumPy leaves no frame. Then the last one is of a module of ours that computes, and stands at
    # an operation or a call; a refusal of our own stands at its `raise`.
    code = way[-1].tb_frame.f_code.co_code
    return dis.opname[code[way[-1].tb_lasti]] != "RAISE_VARARGS"


def fault_sentence(error: Exception) -> str:
    """What went wrong in the program, and where."""
    own = [each for each in _way(error) if _module(each).partition(".")[0] not in NUMERICAL]
    place = f" in {_module(own[-1])}, line {own[-1].tb_lineno}" if own else ""
    return (
        f"a fault of the program, not of what it was given: {type(error).__name__}{place}: {one_line(str(error))}; "
        "`decanter --traceback` before the command shows the way there, please report it with that"
    )


def _way(error: Exception) -> Iterator[TracebackType]:
    """The frames that an error went through, the one last in which it arose."""
    at = error.__traceback__
    while at is not None:
        yield at
        at = at.tb_next


def _module(at: TracebackType) -> str:
    return str(at.tb_frame.f_globals.get("__name__", ""))


def sentence(error: Exception) -> str:
    """What the error says, or that the program is at fault; of the system's words the file first and a remedy after."""
    if is_fault(error):
        return fault_sentence(error)
    if not isinstance(error, OSError) or error.strerror is None:
        # The problems of a configuration have a line each, and are sentences already.
        return str(error) if hasattr(error, "problems") else one_sentence(str(error))
    reason = error.strerror[0].lower() + error.strerror[1:]
    file = f"{error.filename}: " if error.filename else ""
    if error.errno in (ENOSPC, EDQUOT):
        return one_sentence(f"{file}{reason}; make room there, or give a path on another disk")
    return one_sentence(f"{file}{reason}; give a path that is there and that this user may read or write")


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
    """The stable exit code of an error: of a driver's by its kind, of a fault its own, of any other wrong input's."""
    if is_fault(error):
        return Exit.FAULT
    return next((code for kind, code in _CODES if isinstance(error, kind)), Exit.USAGE)
