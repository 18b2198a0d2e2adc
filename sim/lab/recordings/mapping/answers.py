"""What a person is asked about a recording, and what a person has said."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, zip_longest
from typing import Any

from sim.lab.recordings import TraceError, list_names
from sim.lab.recordings.mapping.answer_words import CHOICES


@dataclass(frozen=True, slots=True, kw_only=True)
class Answers:
    """What a person has decided; "" is left to what the file shows.

    `current` are the columns of what loads the machine; `dates` is what comes first in dates; `on` the words of
    a switch or of states that mean running; `unit` are texts NAME=UNIT; `good` the words of good readings, or
    BLANK_IS_GOOD; `machine` and `session` are columns; the others are the map's own keys. Raises TraceError for a word
    that is none of CHOICES.
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

    def __post_init__(self) -> None:
        for name, choices in CHOICES.items():
            if (given := getattr(self, name)) and given not in choices:
                option = f"--{name.replace('_', '-')}"
                raise TraceError(f"{option} {given!r}: is no answer; give {list_names(map(repr, choices))}")

    def with_answer(self, field: str, answer: str) -> "Answers":
        """The answers with one more, to the question of an Undecided."""
        name = field.replace("-", "_")
        own = getattr(self, name)
        given: Any = (*own, answer) if isinstance(own, tuple) else answer
        return replace(self, **{name: given})


_LISTED_CHARACTERS = 400
"""Characters of a list of choices: a longer sentence would be cut in its middle, where the option stands."""
_OF_SHELLS = frozenset(" ()[]{}<>|&;*?$#!~`'")
"""What a shell reads otherwise than it is written."""


class Undecided(TraceError):
    """More than one reading fits: `question`, the `choices`, the option that decides, and a `guess` ("": none).

    `seen` is what the readings of each choice show; `columns` are the headers of all columns, (): not known yet.
    """

    columns: tuple[str, ...] = ()

    def __init__(
        self,
        where: object,
        question: str,
        field: str,
        choices: Sequence[str],
        *,
        guess: str = "",
        seen: Sequence[str] = (),
    ) -> None:
        self.guess = guess if guess in choices else ""
        quoted = [repr(choice) if set(choice) & _OF_SHELLS else choice for choice in choices]
        options = " or ".join(f"--{field} {choice}" for choice in quoted)
        if len(options) > _LISTED_CHARACTERS:
            shown = quoted[choices.index(self.guess)] if self.guess else quoted[0]
            options = f"--{field} and the name of one, such as --{field} {shown}"
        hint = f" (most likely {self.guess!r}, which --yes takes)" if self.guess else ""
        listed = [
            f"{choice!r}{f' ({evidence})' if evidence else ''}"
            for choice, evidence in zip_longest(choices, seen, fillvalue="")
        ]
        lengths = accumulate(len(each) + 2 for each in listed)
        fitting = max(sum(length <= _LISTED_CHARACTERS for length in lengths), 1)
        super().__init__(f"{where}: {question}: {list_names(listed, fitting)}{hint}; give {options}")
        self.seen = tuple(seen)
        self.question, self.field, self.choices = question, field, tuple(choices)
