"""Control-C in long work: it always arrives."""

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

Report = Callable[[str, float], None]


@contextmanager
def interruptible(report: Report) -> Iterator[Report]:
    """A report that raises KeyboardInterrupt when Control-C was pressed and the exception never arrived.

    Python drops an exception that a signal raises inside a destructor or a weak reference's callback, and says so with
    a traceback: that is kept quiet here, and the work ends at the next report.
    """
    pressed: list[int] = []

    def press(number: int, _frame: FrameType | None) -> None:
        pressed.append(number)
        raise KeyboardInterrupt

    def checked(what: str, share: float) -> None:
        if pressed:
            raise KeyboardInterrupt
        report(what, share)

    def dropped(what: "sys.UnraisableHookArgs") -> None:
        if what.exc_type is not KeyboardInterrupt:
            loud(what)

    loud, sys.unraisablehook = sys.unraisablehook, dropped
    before = signal.signal(signal.SIGINT, press)
    try:
        yield checked
    finally:
        signal.signal(signal.SIGINT, before)
        sys.unraisablehook = loud
