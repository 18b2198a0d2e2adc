"""How like its model's training the present cycle is, as it grows: a rating every few minutes, and nothing per scan."""

from dataclasses import dataclass
from typing import Literal

from gateway.machine.reading import Scan
from sim.artefacts import Familiarity
from sim.familiarity import ExcessSoFar, GrowingCycle, PointSource, StrangeThing, classify_error
from sim.sha import Event, Model

FamiliarityZone = Literal["unknown", "green", "yellow", "red"]
FamiliarityWord = Literal["unknown", "familiar", "strange"]

NOTHING_STRANGE = StrangeThing()


@dataclass(frozen=True, slots=True)
class FamiliarityRating:
    """What is said of the present cycle since its newest point at `time` (plant s).

    `strangeness` is 1 where it is as strange as the strangest twentieth of the training, None where it is not known;
    beyond the `limit` it is `outside` of the training, and `thing` is what is strange. `expected_error` is the relative
    error that cycles as strange had (None: nobody measured it). `zone` is the class of that error, outside at least
    yellow; "unknown" without a reference, and until an hour of the plant was read.
    """

    zone: FamiliarityZone
    limit: float
    time: float | None = None
    strangeness: float | None = None
    expected_error: float | None = None
    outside: bool = False
    thing: StrangeThing = NOTHING_STRANGE

    @property
    def word(self) -> FamiliarityWord:
        """Whether the present cycle is like the training."""
        return "unknown" if self.zone == "unknown" else "strange" if self.outside else "familiar"


class CycleFamiliarity:
    """The present cycle held against a model's training; without `known` it follows nothing and says "unknown"."""

    def __init__(self, known: Familiarity | None, model: Model, limit: float) -> None:
        self._known, self._limit = known, limit
        self.cycle = GrowingCycle(PointSource.for_alphabet(model.alphabet, model.temperature, model.roles))
        self._excess = ExcessSoFar()
        self._begin: float | None = None
        self.rating = FamiliarityRating("unknown", limit)

    def adopt_cycle(self, former: "CycleFamiliarity") -> None:
        """Take over the hour that another model's has read, where both look at the same signals."""
        if former.cycle.source == self.cycle.source:
            self.cycle = former.cycle

    def take(self, scan: Scan, events: tuple[Event, ...]) -> FamiliarityRating:
        """Take a scan in; what is known of the present cycle by now."""
        if self._known is None:
            return self.rating
        point = self.cycle.take(scan.time, scan.good, events)
        if point is not None:
            if point.begin != self._begin:
                self._excess, self._begin = ExcessSoFar(), point.begin
            if point.values is None:
                self.rating = FamiliarityRating("unknown", self._limit)
            else:
                found, self._excess = self._known.reference.follow(point.values, point.time, self._excess)
                curve = self._known.curve
                error = None if curve is None else curve.expected_error(found.value)
                zone: FamiliarityZone = "green" if error is None else classify_error(error)
                outside = found.value > self._limit
                if outside and zone == "green":
                    zone = "yellow"
                thing = found.thing if outside else NOTHING_STRANGE
                self.rating = FamiliarityRating(
                    zone=zone,
                    limit=self._limit,
                    time=point.time,
                    strangeness=found.value,
                    expected_error=error,
                    outside=outside,
                    thing=thing,
                )
        return self.rating
