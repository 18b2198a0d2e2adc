"""Repeated lines of a log as one line with a count: what floods a log is not what is new in it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from gateway.repeated import without_numbers

WINDOW_SECONDS = 60.0
"""For how long repetitions are gathered into one line."""
MAX_FORMS, MAX_RETURNS = 20, 10
"""In one window and of one event: so many different lines, and so many that come back after other lines, are written
at once. Beyond that an event floods, whatever it is that changes in it."""

Event = Mapping[str, Any]
_Form = tuple[tuple[str, str], ...]


@dataclass(slots=True)
class _Repeats:
    """Lines that were kept back: how many, since when (monotonic s), and the newest of them."""

    since: float
    newest: Event
    at: float
    count: int = 0


@dataclass(slots=True)
class _Window:
    """What one event has had written since `since` (monotonic s), and what is kept back of it, by form."""

    since: float
    forms: set[_Form] = field(default_factory=set)
    returns: int = 0
    repeats: dict[_Form | None, _Repeats] = field(default_factory=dict)


class Folding:
    """Says of each event what is to be written now. `due` gives what was kept back once its window is over.

    The first line of a form is written at once, and so is one that comes back after another line: it is a change. Two
    lines have the same form if they differ in numbers only. The line that stands for repetitions is the newest of them
    with `repeated` (how many were kept back) and `seconds` (over which time).
    """

    def __init__(self, window: float = WINDOW_SECONDS) -> None:
        self.window = window
        self._windows: dict[tuple[str, str], _Window] = {}
        self._last: _Form | None = None

    def take(self, event: Event, now: float) -> bool:
        """True if the event is to be written at once; else it is kept back and counted. `now` is monotonic (s)."""
        form = _form(event)
        group = (str(event.get("level")), without_numbers(str(event.get("event"))))
        window = self._windows.setdefault(group, _Window(now))
        changed, self._last = form != self._last, form
        if form not in window.forms and len(window.forms) < MAX_FORMS:
            window.forms.add(form)
            return True
        known: _Form | None = form if form in window.forms else None
        if known is not None and changed and window.returns < MAX_RETURNS:
            window.returns += 1
            return True
        repeats = window.repeats.setdefault(known, _Repeats(now, event, now))
        repeats.count, repeats.newest, repeats.at = repeats.count + 1, event, now
        return False

    def due(self, now: float, *, at_once: bool = False) -> list[Event]:
        """The lines of the windows that are over, or of all: in the order in which their newest came."""
        over = [group for group, window in self._windows.items() if at_once or now - window.since >= self.window]
        gathered = [repeats for group in over for repeats in self._windows.pop(group).repeats.values()]
        gathered.sort(key=lambda repeats: repeats.at)
        return [
            {**r.newest, "repeated": r.count, "seconds": round(r.at - r.since, 3)} if r.count > 1 else r.newest
            for r in gathered
        ]

    @property
    def waiting(self) -> bool:
        """True while something is kept back."""
        return any(window.repeats for window in self._windows.values())


def _form(event: Event) -> _Form:
    """The event without its numbers."""
    return tuple(
        (key, "#" if isinstance(value, int | float) and not isinstance(value, bool) else without_numbers(str(value)))
        for key, value in sorted(event.items())
    )
