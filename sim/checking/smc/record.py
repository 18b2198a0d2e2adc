"""The record of an answer, how one is asked for, and the sentences that go with runs."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from sim.checking.query import tree as q
from sim.checking.smc.monitors.monitor import Totals
from sim.checking.smc.monitors.path import approximations
from sim.checking.smc.runs import Course, Sampler
from sim.sha.trace import Array

Rule = Literal["sequential", "fixed", "anytime"]


@dataclass(frozen=True, slots=True)
class Settings:
    """How a query is to be answered: a confidence of 1 - `alpha`, an interval of half-width `epsilon`, the `rule`.

    `delta` is half the indifference region of a test. `runs` asks for that many runs instead; `most` is where a rule
    gives up. `rare`: importance splitting at once.
    """

    alpha: float = 0.05
    epsilon: float = 0.05
    rule: Rule = "sequential"
    runs: int | None = None
    delta: float = 0.01
    most: int = 1_000_000
    seed: int = 0
    rare: bool = False


@dataclass(frozen=True, slots=True)
class Answer:
    """What a query's runs say. `verdict` is that of a hypothesis, comparison or symbolic query, None elsewhere and
    where it stays undecided. `numbers` are the figures by name, `notes` what limits them, one sentence each.

    `passages` (n,) are the moments (s) of the goal in each run, inf without; `courses` those of a simulation; `levels`
    those of importance splitting, (degC, the chance to reach it).
    """

    query: q.Query
    kind: str
    sentence: str
    verdict: bool | None
    numbers: Mapping[str, float]
    rule: str
    runs: int
    seed: int
    start: str
    notes: tuple[str, ...] = ()
    passages: Array | None = None
    courses: tuple[Course, ...] = ()
    levels: tuple[tuple[float, float], ...] = ()


def run_notes(totals: Totals) -> tuple[str, ...]:
    """What happened to the runs, in sentences."""
    said = (
        (totals.clamps, "times a run left the model's range and was put back to its border"),
        (totals.limited, "steps ran at the maximum rate: the noise in them is that of the unlimited flow"),
        (totals.cut, "runs had more stays than are followed and remained where they were"),
    )
    return tuple(f"{count} {words}" for count, words in said if count)


def sampler_notes(drawn: Sampler) -> tuple[str, ...]:
    """The engine's notes, what happened to the runs, what is approximated."""
    notes = [*drawn.engine.notes, *run_notes(drawn.totals)]
    notes += dict.fromkeys(sentence for one in drawn.watches for sentence in approximations(one))
    if drawn.unclear:
        notes.append(
            f"in {drawn.unclear} runs the goal and the end of the condition fell into one step; they count as failed"
        )
    return tuple(notes)


def percent(settings: Settings) -> str:
    """The confidence as text."""
    return f"{100.0 * (1.0 - settings.alpha):g} %"


def interval(probability: float, low: float, high: float, settings: Settings) -> str:
    """A figure with its interval as text."""
    return f"{probability:.4g}, {percent(settings)} interval [{low:.4g}, {high:.4g}]"
