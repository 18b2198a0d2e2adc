"""What a person is asked about a recording, and what a person has said."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from sim.lab.recordings import TraceError, listed

NONE = "none"
"""The answer that a part is played by no column."""
BLANK = "blank"
"""The answer that a reading is good where its quality is not written."""
DUPLICATES = ("average", "last", "keep", "spread")
"""What a person may say of rows with the same time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Answers:
    """What a person has decided; "" is left to what the file shows.

    `current` are the columns of what loads the machine; `dates` is the order of dates, day or month; `on` the words of
    a switch or of states that mean running; `unit` are texts NAME=UNIT; `good` the words of good readings, or BLANK;
    `machine` and `session` are columns; the others are the map's own keys.
    """

    temperature: str = ""
    current: tuple[str, ...] = ()
    running: str = ""
    time: str = ""
    dates: str = ""
    on: tuple[str, ...] = ()
    timezone: str = ""
    machine: str = ""
    session: str = ""
    stored: str = ""
    duplicates: str = ""
    clock_back: str = ""
    unit: tuple[str, ...] = ()
    good: tuple[str, ...] = ()

    def with_answer(self, field: str, answer: str) -> "Answers":
        """The answers with one more, to the question of an Undecided."""
        name = field.replace("-", "_")
        own = getattr(self, name)
        given: Any = (*own, answer) if isinstance(own, tuple) else answer
        return replace(self, **{name: given})


class Undecided(TraceError):
    """More than one reading fits: `question`, the `choices`, the option that decides, and a `guess` ("": none)."""

    def __init__(self, where: object, question: str, field: str, choices: Sequence[str], *, guess: str = "") -> None:
        options = " or ".join(f"--{field} {choice!r}" if " " in choice else f"--{field} {choice}" for choice in choices)
        self.guess = guess if guess in choices else ""
        hint = f" (most likely {self.guess!r}, which --yes takes)" if self.guess else ""
        super().__init__(f"{where}: {question}: {listed(map(repr, choices))}{hint}; give {options}")
        self.question, self.field, self.choices = question, field, tuple(choices)
