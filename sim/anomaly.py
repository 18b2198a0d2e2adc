"""The anomaly score along data that a model has not seen: its peaks, and the level above which it is worth an alarm.

The score is -log10 of a chi-square test's p-value (`sim.engine.anomaly`). No learned model is so right that the test
says how often that comes: what its scores did on held-out data does.
"""

from dataclasses import dataclass, field
from math import isfinite

DEADBAND_SHARE = 1 / 3
"""Of its limit, by which the score has to fall below that before its alarm returns."""
MIN_PEAK = 2.0
"""What is lower is no peak: a right model passes this once in a hundred windows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AnomalyRecord:
    """What the score did along `seconds` of held-out data of so many `units` (recordings, or machines).

    `peaks` are the highest, in descending order; above `level` one a week at most is to be expected by them. Raises
    ValueError for numbers that no record has.
    """

    seconds: float
    units: int
    peaks: tuple[float, ...]
    level: float

    def __post_init__(self) -> None:
        known = all(isfinite(value) and value >= 0 for value in (self.seconds, self.level, *self.peaks))
        if not known or self.units < 1:
            raise ValueError("a record of anomaly scores needs at least one unit, and finite numbers of at least 0")


@dataclass(slots=True)
class ScorePeaks:
    """The `peaks` of a score as an alarm would tell them apart: a rise counts anew after a fall by the deadband."""

    peaks: list[float] = field(default_factory=list)
    _highest: float = 0.0
    _lowest: float = 0.0

    def take(self, score: float) -> None:
        """The next score."""
        back = 1.0 - DEADBAND_SHARE
        if self._highest:
            self._highest = max(self._highest, score)
            if score <= back * self._highest:
                self.end()
                self._lowest = score
        elif score >= MIN_PEAK and back * score >= self._lowest:
            self._highest = score
        else:
            self._lowest = min(self._lowest, score)

    def end(self) -> None:
        """The score is not known from here on."""
        if self._highest:
            self.peaks.append(self._highest)
        self._highest = self._lowest = 0.0
