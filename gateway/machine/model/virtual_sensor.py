"""The model in place of a bad sensor: for how long and how wide it may be, and what was believed before the failure.

A sensor that is found out has misled the model for as long as that took: a frozen one for minutes. So the model goes
back to what was believed before, and comes forward again by events and inputs alone.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from typing import Literal

from gateway.machine.reading import STALE_PERIODS
from sim.engine import Belief, Tracker, advance, on_event, with_inputs
from sim.sha import Event

Stopped = Literal["", "too long", "too wide", "state not known"]
"""Why the model does not speak for the sensor any more; "" while it does."""

LOOK_BACK_SECONDS, KEEP_PERIOD_S, INPUT_PERIOD_S = 2100.0, 30.0, 1.0
"""How far (s) the model can go back, a little more than it takes to find a sensor frozen that has no twin; how far the
kept beliefs are apart, and the inputs beside them at least, since a device that speaks by itself may do so often."""


@dataclass(frozen=True, slots=True)
class VirtualReading:
    """What the model says where its sensor is bad for a `reason`: `mean` and the 90 % band `low`..`high` (degC).

    `since` is when the last reading was taken that counted (plant s), `reason` what is wrong with the sensor, `twin`
    the tag of the bearing beside it where that has helped ("": it has not). The numbers are None once it has
    `stopped`, until the sensor is good again.
    """

    since: float
    reason: str
    mean: float | None = None
    low: float | None = None
    high: float | None = None
    stopped: Stopped = ""
    twin: str = ""


class VirtualSensor:
    """Decides from scan to scan whether the model speaks for its sensor: for `longest` s, to a band of `widest` degC.

    One late reading is no bad sensor: it begins after STALE_PERIODS of the scan's `period` (s). What has stopped
    stays so until a good reading: a state that was not known meanwhile cannot be made up for.
    """

    def __init__(self, longest: float, widest: float, period: float) -> None:
        self._longest, self._widest, self._least = longest, widest, STALE_PERIODS * period
        self.stopped: Stopped = ""

    def take(
        self,
        now: float,
        since: float,
        reason: str,
        *,
        known: bool,
        mean: float,
        half_width: float,
        twin: str = "",
    ) -> VirtualReading | None:
        """What stands at `now` for a sensor that is bad for a `reason`; None while it is only late.

        `since` is when the model was last corrected, `known` whether location and inputs are: without them it is not
        the sensor that fails, and nothing is said. `mean` and `half_width` (degC) are what is believed, perhaps with
        the help of a `twin`.
        """
        if not self.stopped and now - since <= self._least:
            return None
        if not known:
            self.stopped = "state not known"
            return None
        if not self.stopped:
            if now - since > self._longest:
                self.stopped = "too long"
            elif 2.0 * half_width > self._widest:
                self.stopped = "too wide"
        if self.stopped:
            return VirtualReading(since=since, reason=reason, stopped=self.stopped)
        return VirtualReading(since, reason, mean, mean - half_width, mean + half_width, twin=twin)


@dataclass(frozen=True, slots=True)
class PastStep:
    """What moved the model at `time` beside its reading; `belief` is what was believed then, where that was kept."""

    time: float
    events: tuple[Event, ...]
    signals: Mapping[str, float]
    belief: Belief | None


class PastBeliefs:
    """The beliefs of the last LOOK_BACK_SECONDS, KEEP_PERIOD_S seconds apart, and what has moved the model since."""

    def __init__(self, tracker: Tracker) -> None:
        self._tracker = tracker
        self._steps: deque[PastStep] = deque()
        self._kept_at = -inf
        self._signals: Mapping[str, float] = {}

    def keep(self, time: float, events: Sequence[Event], signals: Mapping[str, float], belief: Belief) -> None:
        """Remember one scan with the `belief` after it; between two kept beliefs only what is news."""
        due = time - self._kept_at >= KEEP_PERIOD_S
        news = signals != self._signals and (not self._steps or time - self._steps[-1].time >= INPUT_PERIOD_S)
        if not (due or events or news):
            return
        self._signals = signals
        self._kept_at = time if due else self._kept_at
        self._steps.append(PastStep(time, tuple(events), signals, belief if due else None))
        while self._steps[0].time < time - LOOK_BACK_SECONDS:
            self._steps.popleft()

    def without_readings(self, since: float, now: float) -> Belief | None:
        """What would be believed at `now` had there been no reading from `since` on; None where that is too long ago.

        From then on nothing before `since` is remembered: none of it was right.
        """
        belief: Belief | None = None
        after: list[PastStep] = []
        for step in self._steps:
            if step.belief is not None and step.time < since:
                belief, after = step.belief, []
            else:
                after.append(step)
        self._steps.clear()
        self._kept_at = -inf
        if belief is None:
            return None
        for step in after:
            for event in step.events:
                belief = on_event(self._tracker, belief, event)
            belief = with_inputs(self._tracker, belief, step.time, step.signals)
        return advance(self._tracker, belief, now) if belief.time < now else belief
