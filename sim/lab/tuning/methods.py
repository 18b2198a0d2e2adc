"""What can be tuned: one table entry a learning method, with its search space and how it learns by given settings."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

from sim.lab.learning import Coverage
from sim.lab.learning.bins import CANDIDATES, learn_bins
from sim.lab.learning.lsha import FLOW_KINDS, LshaSettings, learn_lsha
from sim.sha import Alphabet, Bins, Model, Switch, Trace

Value = str | float | int | bool
Settings = Mapping[str, Value]
"""Parameter -> value. No settings at all are the method's own defaults."""


@dataclass(frozen=True, slots=True)
class Real:
    """A number of `low`..`high`, searched on a logarithmic scale if `log`."""

    name: str
    low: float
    high: float
    log: bool = False


@dataclass(frozen=True, slots=True)
class Whole:
    """An integer of `low`..`high`."""

    name: str
    low: int
    high: int


@dataclass(frozen=True, slots=True)
class Choice:
    """One of several words."""

    name: str
    options: tuple[str, ...]


Parameter = Real | Whole | Choice


@dataclass(frozen=True, slots=True)
class Task:
    """What a method learns from. Traces have no events: they are encoded by the alphabet that the settings make."""

    traces: Sequence[Trace]
    alphabet: Alphabet
    temperature: str
    seed: int
    name: str = "tuned"


@dataclass(frozen=True, slots=True)
class Taught:
    """A learned model, the m of each stay by location for its histogram file, and what it foresaw unseen."""

    model: Model
    values: Mapping[str, tuple[float, ...]]
    coverage: tuple[Coverage, ...] = ()


@dataclass(frozen=True, slots=True)
class Method:
    """`learn` raises ValueError, in one sentence, where the traces cannot teach a model with these settings."""

    space: tuple[Parameter, ...]
    learn: Callable[[Task, Settings], Taught]


ANY_CHOICE = "chosen"
"""The word for a setting that the learner chooses by itself, by its held-out likelihood."""


def _learn_bins(task: Task, settings: Settings) -> Taught:
    def _allows(name: str, value: str) -> bool:
        return settings.get(name, ANY_CHOICE) in (ANY_CHOICE, value)

    learned = learn_bins(
        task.traces,
        tuned_alphabet(task.alphabet, settings),
        task.temperature,
        seed=task.seed,
        name=task.name,
        candidates=[each for each in CANDIDATES if _allows("flow", each.flow) and _allows("rates", each.rates)],
    )
    return Taught(learned.model, learned.values, learned.coverage)


def _learn_lsha(task: Task, settings: Settings) -> Taught:
    of_alphabet = {"hysteresis", "debounce"}
    own: dict[str, Any] = {
        name: None if value == ANY_CHOICE else value for name, value in settings.items() if name not in of_alphabet
    }
    learned = learn_lsha(
        task.traces,
        tuned_alphabet(task.alphabet, settings),
        task.temperature,
        seed=task.seed,
        name=task.name,
        settings=LshaSettings(**own),
    )
    return Taught(learned.model, learned.values, learned.report.coverage)


def tuned_alphabet(alphabet: Alphabet, settings: Settings) -> Alphabet:
    """The alphabet with at least the settings' `hysteresis` (widths of a channel's narrowest bin) and `debounce` (s).

    Thresholds and symbols stay: what a bin means is the plant's matter. A channel with one threshold has no width and
    keeps its own hysteresis.
    """
    share = float(settings.get("hysteresis", 0.0))
    channels: list[Switch | Bins] = []
    for channel in alphabet.channels:
        if isinstance(channel, Bins) and len(channel.thresholds) > 1:
            width = min(high - low for low, high in pairwise(channel.thresholds))
            channel = replace(channel, hysteresis=max(channel.hysteresis, share * width))
        channels.append(channel)
    debounce = max(alphabet.debounce, float(settings.get("debounce", 0.0)))
    return replace(alphabet, channels=tuple(channels), debounce=debounce)


ENCODING: tuple[Parameter, ...] = (Real("hysteresis", 0.0, 0.3), Real("debounce", 0.0, 20.0))

METHODS: Mapping[str, Method] = {
    "bins": Method(
        (
            Choice("flow", (ANY_CHOICE, "constant", "driven")),
            Choice("rates", (ANY_CHOICE, "shared", "switch", "location")),
            *ENCODING,
        ),
        _learn_bins,
    ),
    "lsha": Method(
        (
            Real("delta", 0.0, 0.6),
            Whole("n_min", 2, 20),
            Real("alpha", 0.001, 0.3, log=True),
            Choice("default_flow", (ANY_CHOICE, *FLOW_KINDS)),
            Choice("memory", (ANY_CHOICE, "context", "direction", "previous", "word")),
            *ENCODING,
        ),
        _learn_lsha,
    ),
}


def find_method(name: str) -> Method:
    """The method. Raises ValueError with the known names."""
    if name not in METHODS:
        raise ValueError(f"the method {name!r} cannot be tuned; known are {', '.join(METHODS)}")
    return METHODS[name]
