"""Three ways to have a model over a year, each given the days one by one as they end, and nothing of those to come."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path
from typing import Any, Protocol

from benchmarks.retraining import write_historian
from benchmarks.year.plant import DAY, TEMPERATURE, Day
from gateway.lab.retraining.cycle_library import CycleLibrary, open_library
from gateway.lab.retraining.shadow import side_by_side
from gateway.lab.retraining.study import RetrainingRequest, cut_and_rate, due, make_source, retrain
from sim.artefacts import current, is_store, load, promote
from sim.error_limits import RED, YELLOW
from sim.lab.formats import save
from sim.lab.learning.bins import learn_bins
from sim.sha import DECANTER, Model, Trace

AFTER, EVERY = 10, 60.0
"""New cycles that are not ordinary, and days, after which a retraining is due (`--after`, `--every`)."""
ROWS = 19_000
"""Scans that a retraining learns from (`--rows`): seven days, as the default's are at a scan a second."""
JUDGED = 8
"""Forecasts by which a cycle judges a model, at most."""
PROVING = 2
"""Days that were simulated after a promotion until the former version is asked once more."""
MACHINE = "decanter"


@dataclass(frozen=True, slots=True)
class Happening:
    """What the loop did on the evening of a `day` of the year: a `kind`, a version, and why, in the product's words."""

    day: float
    kind: str
    version: str
    words: str


class Arm(Protocol):
    """A way to have a model: `model` is the one that forecasts next, `evening` takes the day that has ended."""

    happenings: list[Happening]

    @property
    def model(self) -> Model:
        """What forecasts next."""

    def evening(self, day: Day) -> None:
        """Take the day's readings."""

    def to_plain(self) -> dict[str, Any]:
        """What is not in its folder and must be known to go on after this evening, as JSON can carry it."""

    def go_on(self, saved: Mapping[str, Any], past: Iterable[Day]) -> None:
        """Go on from what `to_plain` gave on the evening of the last of the `past` days."""

    def promotions(self) -> dict[float, tuple[Model, Model]]:
        """The model that ran before each promotion and the promoted one, by its day: for the judge."""


def learned(traces: Sequence[Trace], seed: int) -> Model:
    """The model of these days."""
    bare = [replace(trace, events=()) for trace in traces]
    return learn_bins(bare, DECANTER, TEMPERATURE, seed=seed, name=MACHINE).model


class Once:
    """The model that was learned at the beginning."""

    def __init__(self, model: Model) -> None:
        self._model, self.happenings = model, list[Happening]()

    @property
    def model(self) -> Model:
        """The first one."""
        return self._model

    def evening(self, day: Day) -> None:
        """Nothing is learned."""

    def to_plain(self) -> dict[str, Any]:
        """Nothing."""
        return {}

    def go_on(self, saved: Mapping[str, Any], past: Iterable[Day]) -> None:
        """As before."""

    def promotions(self) -> dict[float, tuple[Model, Model]]:
        """Nothing is promoted."""
        return {}


class Daily:
    """Learned anew each evening from all days so far; what nobody asks for is not learned."""

    def __init__(self, model: Model, begin: Sequence[Trace], seed: int) -> None:
        self._model: Model | None = model
        self.happenings = list[Happening]()
        self._traces, self._seed = list(begin), seed

    @property
    def model(self) -> Model:
        """That of everything so far."""
        if self._model is None:
            self._model = learned(self._traces, self._seed)
        return self._model

    def evening(self, day: Day) -> None:
        """Learn from everything."""
        self._traces.append(day.trace)
        self._model = None

    def to_plain(self) -> dict[str, Any]:
        """Nothing."""
        return {}

    def go_on(self, saved: Mapping[str, Any], past: Iterable[Day]) -> None:
        """Learn from all days so far."""
        self._traces += [day.trace for day in past]
        self._model = None

    def promotions(self) -> dict[float, tuple[Model, Model]]:
        """Nothing is promoted."""
        return {}


class Loop:
    """The product's own loop as a timer would call it each night, with the stated policy (`shadow --promote`).

    A candidate is held against the running version when its days of trial are over, and promoted or left; a
    promoted version against the one before it, once, PROVING days after its promotion, and rolled back where it is
    worse; and a retraining begins where one is due, from the `history` of the first model too (`--traces`). Store,
    historian and library lie in `folder`.
    """

    def __init__(self, model: Model, history: Sequence[Trace], folder: Path, seed: int, begin: float) -> None:
        self._model, self.happenings = model, list[Happening]()
        self._promoted = dict[float, tuple[str, str]]()
        self._store, self._historian, self._library = folder / "store", folder / "historian.sqlite", folder / "cycles"
        self._seed, self._candidate, self._proving = seed, "", 0
        self._history = [replace(trace, events=()) for trace in history]
        if not is_store(self._store):
            promote(self._store, save(self._store, model, created=begin))

    @property
    def model(self) -> Model:
        """The current version."""
        return self._model

    def evening(self, day: Day) -> None:
        """What the commands would do in the night after the day."""
        write_historian(self._historian, replace(day.trace, events=()))
        now = float(day.trace.times[-1])
        with open_library(self._library, machine=MACHINE, temperature=TEMPERATURE) as library:
            request = self._request()
            cut_and_rate(request, library, make_source(request, now), _silent)
            if self._candidate:
                self._shadow(library, day)
            elif self._proving:
                self._proving -= 1
                if not self._proving:
                    self._prove(library, day)
            if not self._candidate:
                self._retrain(library, day, now)
        self._model = load(self._store)

    def to_plain(self) -> dict[str, Any]:
        """The candidate, how long a promotion is still to be proven, and the promotions by their days."""
        return {"candidate": self._candidate, "proving": self._proving, "promoted": list(self._promoted.items())}

    def go_on(self, saved: Mapping[str, Any], past: Iterable[Day]) -> None:
        """Run what the store has promoted."""
        self._candidate, self._proving = saved["candidate"], saved["proving"]
        self._promoted = {day: (before, after) for day, (before, after) in saved["promoted"]}
        self._model = load(self._store)

    def promotions(self) -> dict[float, tuple[Model, Model]]:
        """Each version that a promotion replaced, and the promoted one."""
        return {
            day: (load(self._store, before), load(self._store, after))
            for day, (before, after) in self._promoted.items()
        }

    def _request(self) -> RetrainingRequest:
        return RetrainingRequest(
            store=self._store,
            historian=self._historian,
            machine=MACHINE,
            since=None,
            standard=(),
            former=self._history,
            method=None,
            seed=self._seed,
            rows=ROWS,
            trials=0,
            diagnosis=False,
            yellow=YELLOW,
            red=RED,
            forecasts=JUDGED,
        )

    def _shadow(self, library: CycleLibrary, day: Day) -> None:
        before = current(self._store)
        found = side_by_side(
            self._store,
            self._historian,
            library,
            machine=MACHINE,
            version=self._candidate,
            promotes=True,
            seed=self._seed,
            report=_silent,
            most=JUDGED,
        )
        if not found.enough:
            return
        self._note(day, "promotion" if found.promoted else "left", self._candidate, found.sentence)
        if found.promoted and found.promoted != before:
            self._promoted[day.number] = (before, found.promoted)
            self._proving = PROVING
        self._candidate = ""

    def _prove(self, library: CycleLibrary, day: Day) -> None:
        found = side_by_side(
            self._store,
            self._historian,
            library,
            machine=MACHINE,
            roll_back=True,
            seed=self._seed,
            report=_silent,
            most=JUDGED,
        )
        if found.promoted:
            self._note(day, "roll-back", found.promoted, found.sentence)

    def _retrain(self, library: CycleLibrary, day: Day, now: float) -> None:
        request = self._request()
        source = make_source(request, now)
        finished = library.fact("finished")
        age = inf if finished is None else now - finished["at"]
        if not due(request, library, source, after=AFTER, drifting=False, age=age, every=EVERY * DAY).reason:
            return
        try:
            found = retrain(request, library, source, report=_silent, clock=lambda: now)
        except ValueError as refusal:
            # Too few new cycles: the timer comes again tomorrow.
            self._note(day, "too early", "", str(refusal).split(": ", 1)[-1])
            return
        self._candidate = found.version
        self._note(day, "proposal" if found.proposed else "no proposal", found.version, found.sentence)

    def _note(self, day: Day, kind: str, version: str, words: str) -> None:
        self.happenings.append(Happening(day.number, kind, version, words))


def _silent(_what: str, _share: float) -> None:
    """A report to nobody."""
