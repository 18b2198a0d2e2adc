"""Control-C: it always arrives, and always as a sentence and the code of a stopped command."""

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

Report = Callable[[str, float], None]


class Interrupted(KeyboardInterrupt):
    """Control-C, by a type of our own.

    Where a KeyboardInterrupt itself passes through code that a C extension runs from text (imports of scipy do), Python
    remembers it as unhandled although it was caught later, and kills its own process at the end whatever the exit code.
    """


@contextmanager
def control_c() -> Iterator[list[int]]:
    """Within it Control-C raises Interrupted; gives the list of the times that it was pressed.

    An exception drawn from it by a library (an import that was broken off says "initialization failed") leaves as
    Interrupted too. Python drops an exception that a signal raises inside a destructor or a weak reference's callback,
    and says so with a traceback: that is kept quiet. In a thread other than the main one signals are not ours.
    """
    pressed: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield pressed
        return

    def press(number: int, _frame: FrameType | None) -> None:
        pressed.append(number)
        raise Interrupted

    def report_unraisable(what: "sys.UnraisableHookArgs") -> None:
        if not issubclass(what.exc_type, KeyboardInterrupt):
            loud(what)

    loud, sys.unraisablehook = sys.unraisablehook, report_unraisable
    before = signal.signal(signal.SIGINT, press)
    try:
        yield pressed
    except Exception as error:
        if pressed:
            raise Interrupted from error
        raise
    finally:
        signal.signal(signal.SIGINT, before)
        sys.unraisablehook = loud


@contextmanager
def interruptible(report: Report) -> Iterator[Report]:
    """A report that raises Interrupted when Control-C was pressed and the exception never arrived."""
    with control_c() as pressed:

        def report_unless_pressed(what: str, share: float) -> None:
            if pressed:
                raise Interrupted
            report(what, share)

        yield report_unless_pressed
