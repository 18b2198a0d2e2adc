"""An engineer's own effect as data: one line of heat, and what its names mean. `sim.effects` makes a kind of it."""

from dataclasses import dataclass
from math import inf
from typing import Literal

LineActs = Literal["running", "anywhere"]


@dataclass(frozen=True, slots=True, kw_only=True)
class LineParameter:
    """A number of a line: its `unit` and range, and the values from which a diagnosis begins to look for it.

    `tried` are those values; `usual` names a signal of the line whose mean is the value instead. Without either they
    are spread over the range.
    """

    name: str
    unit: str
    low: float = -inf
    high: float = inf
    tried: tuple[float, ...] = ()
    usual: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class EffectLine:
    """An effect written as one line: `heat` (degC/s) over signals, parameters, `temperature` (degC) and `since` (s).

    `signals` are (name in the line, the plant's signal). `strength` is the parameter that the heat is proportional to.
    `meaning` is one phrase that says what it is, `experiment` what would tell it from others, `look` what to look at at
    the machine. A model carries the lines of its effects, so that it means the same wherever it is read.
    """

    name: str
    heat: str
    meaning: str
    strength: str
    experiment: str
    look: str = ""
    acts: LineActs = "running"
    signals: tuple[tuple[str, str], ...] = ()
    parameters: tuple[LineParameter, ...] = ()
