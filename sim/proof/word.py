"""A timed word as one line of text, with the parameters of each stay (`word_replay` runs it).

    @0,T=20,m=31 W_ON@0,m=52 A_2@30,m=80,Assorbimento=280 @600

Each item is SYMBOL@SECONDS and begins a stay; behind it stand, as far as they are not left out, the stay's mode
parameter (m), its input signals, and the temperature (T) at the start or where the location draws it on entry. An item
without a symbol at the very front describes the first stay, at the end it says how long the last one goes on. Seconds
count from the start; t behind the first item is the absolute time of the start, which wear and sensor steps look at.
Items are divided by blanks; one with blanks in it is put in double quotes; # begins a comment.
"""

import re
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from math import isfinite, nan

from sim.sha import Event

TEMPERATURE, MODE, CLOCK = "T", "m", "t"
MAX_CHARACTERS = 100_000
"""Of a word: dividing a text into items takes a time in the square of the longest one."""

_ITEM = re.compile(r"(?P<symbol>.*)@(?P<time>[^@,]+)(?P<rest>(?:,[^,=]+=[^,=]+)*)", re.DOTALL)


@dataclass(frozen=True, slots=True)
class WordStep:
    """One stay, begun by `symbol` (empty: the first) `time` seconds after the start.

    What is None or not in `inputs` is left to the model: m at its mean, T at the law's mean, inputs at their reference,
    signals of effects as they were last. `clock` (absolute s, 0 if None) belongs to the first stay alone.
    """

    time: float
    symbol: str = ""
    m: float | None = None
    temperature: float | None = None
    inputs: Mapping[str, float] = field(default_factory=dict)
    clock: float | None = None


@dataclass(frozen=True, slots=True)
class TimedWord:
    """The stays in order, the first one without a symbol, and the end of the last one in seconds from the start."""

    steps: tuple[WordStep, ...]
    end: float

    @property
    def events(self) -> tuple[Event, ...]:
        """The events alone, times from the start."""
        return tuple(Event(step.time, step.symbol) for step in self.steps[1:])


def parse_word(text: str) -> TimedWord:
    """The word in a text. Raises ValueError, naming the item, for what is none."""
    if len(text) > MAX_CHARACTERS:
        raise ValueError(f"the word has {len(text)} characters, and {MAX_CHARACTERS} is the most")
    try:
        items = shlex.split(text, comments=True)
    except ValueError as error:
        raise ValueError(f"the word cannot be divided into items ({error}); close each quotation") from None
    steps = [_step(item) for item in items]
    if not steps:
        raise ValueError("the word is empty; give items such as W_ON@0 A_2@30 @600")
    if steps[0].symbol or len(steps) == 1:
        steps.insert(0, WordStep(0.0))
    last = steps[-1]
    if not last.symbol and (last.m is not None or last.temperature is not None or last.inputs) and len(items) > 1:
        raise ValueError(f"{items[-1]!r}: the last item only says when the word ends; put its parameters to an event")
    stays = steps if last.symbol else steps[:-1]
    if steps[0].time != 0:
        raise ValueError(f"the word begins at {steps[0].time:g} s; seconds count from the start, which is 0")
    for before, after in pairwise(steps):
        if after.time < before.time:
            raise ValueError(f"the word goes back from {before.time:g} s to {after.time:g} s ({after.symbol or 'end'})")
    late = next((step for step in stays[1:] if step.clock is not None), None)
    if late is not None:
        raise ValueError(
            f"the item at {late.time:g} s gives {CLOCK}; only the start, @0,{CLOCK}=..., has an absolute time"
        )
    nameless = [step for step in stays[1:] if not step.symbol]
    if nameless:
        raise ValueError(f"the item at {nameless[0].time:g} s has no symbol; only the first and the last may have none")
    return TimedWord(tuple(stays), last.time)


def _step(item: str) -> WordStep:
    match = _ITEM.fullmatch(item)
    if match is None:
        raise ValueError(f"{item[:60]!r} is no item of a word; write SYMBOL@SECONDS, or SYMBOL@SECONDS,m=80,Signal=280")
    numbers = {}
    for part in filter(None, match["rest"].split(",")):
        name, _, value = part.partition("=")
        numbers[name.strip()] = _number(value, item)
    time = _number(match["time"], item)
    if time < 0:
        raise ValueError(f"{item!r}: seconds count from the start and are never negative")
    m, temperature, clock = (numbers.pop(name, None) for name in (MODE, TEMPERATURE, CLOCK))
    return WordStep(time, match["symbol"].strip(), m=m, temperature=temperature, inputs=numbers, clock=clock)


def _number(text: str, item: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = nan
    if not isfinite(value):
        raise ValueError(f"{item[:60]!r}: {text[:60]!r} is no finite number")
    return value


def word_text(word: TimedWord) -> str:
    """The word in one line, which `parse_word` reads back.

    Times have 15 digits, since a stay is the difference of two of them; other numbers have 12.
    """
    items = [_item(step) for step in word.steps]
    return " ".join((*items, f"@{word.end:.15g}"))


def _item(step: WordStep) -> str:
    parts = [f"{step.symbol}@{step.time:.15g}"]
    parts += [f"{TEMPERATURE}={step.temperature:.12g}"] if step.temperature is not None else []
    parts += [f"{CLOCK}={step.clock:.12g}"] if step.clock is not None else []
    parts += [f"{MODE}={step.m:.12g}"] if step.m is not None else []
    parts += [f"{name}={value:.12g}" for name, value in step.inputs.items()]
    text = ",".join(parts)
    plain = re.fullmatch(r"[\w@=,.+:/\-]*", text, re.ASCII)
    return text if plain else '"' + re.sub(r'(["\\])', r"\\\1", text) + '"'
