"""From scans to what the model expects: events, belief, a prediction for every scan, the free run beside it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import sqrt
from typing import Any, Literal

from drivers.tag import Quality
from gateway.machine.model.familiar import FamiliarityRating
from gateway.machine.model.virtual_sensor import PastBeliefs, VirtualReading
from gateway.machine.reading import Scan
from sim.engine import (
    Belief,
    Tracker,
    advance,
    anomaly,
    compile_model,
    machine_offset,
    observe,
    on_event,
    restart,
    restore_belief,
    start,
    with_inputs,
    with_machine_offset,
)
from sim.forecast import Z90
from sim.sha import UNKNOWN, Encoder, EncoderState, Event, Model, Switch
from sim.strict_json import shallow_dict

Zone = Literal["none", "green", "yellow", "red"]
ZONES: tuple[Zone, ...] = ("none", "green", "yellow", "red")
"""The words of the block's field `zone` by their numbers."""

YELLOW_SCORE, RED_SCORE, MIN_ERRORS = 2.0, 4.0, 10
"""Confidence: the newest standardised errors, squared and summed, are chi-square when the model is right, and the
anomaly score is -log10 of that test's p-value. Green below 2 (as bad once in 100 windows), yellow from 2, red from 4
(once in 10,000), none before ten errors or while the inputs or the location are not known."""


@dataclass(frozen=True, slots=True)
class ScanPrediction:
    """What the model says of one scan at `time`.

    `mean` and the 90 % band `low`..`high` (degC) are what a reading at this moment was expected to be by everything
    before it (events and inputs of the same scan included): the one-step prediction; None until a temperature was
    read. `measured` is the good reading or None. `free_run` is the same model let run since the cycle's start (or
    since the end of not knowing) without being corrected by readings. `inputs_good`: everything that the model reads
    was good in this scan; `worst` is 0 good, 1 uncertain, 2 bad; `age` the seconds since the oldest input was read
    (inf: never). `known`: no channel of the alphabet is unknown. `reset`: knowledge was lost in this scan. `borrowed`:
    no data have shown the location, its parameters are another's. `familiarity` is how like the training the present
    cycle is; it may have lowered the `zone`.
    """

    time: float
    location: str
    location_index: int
    known: bool
    inputs_good: bool
    worst: int
    age: float
    measured: float | None
    mean: float | None
    low: float | None
    high: float | None
    free_run: float | None
    anomaly: float
    zone: Zone
    events: tuple[Event, ...]
    reset: bool
    free_sigma: float | None = None
    borrowed: bool = False
    virtual: VirtualReading | None = None
    familiarity: FamiliarityRating | None = None

    def with_familiarity(self, rating: FamiliarityRating) -> "ScanPrediction":
        """This one with the rating of the present cycle: outside of the training the zone is no better than that's."""
        limited = self.at_best(rating.zone) if rating.outside and rating.zone != "unknown" else self
        return replace(limited, familiarity=rating)

    def at_best(self, zone: Zone) -> "ScanPrediction":
        """This one with a confidence no better than `zone`; none stays none."""
        return self if self.zone == "none" else replace(self, zone=max(self.zone, zone, key=ZONES.index))


class Predictor:
    """The encoder and the belief of one model, moved on by each scan. `temperature` is the tag that it predicts.

    `correct` takes a reading into a belief.
    """

    def __init__(
        self, model: Model, temperature: str, correct: Callable[[Tracker, Belief, float, float], Belief] = observe
    ) -> None:
        self.correct = correct
        self.model = model
        self.temperature = temperature
        self.tracker = compile_model(model)
        self.encoder = Encoder(model.alphabet)
        self.belief: Belief | None = None
        self.free: Belief | None = None
        self.past = PastBeliefs(self.tracker)
        self.events = 0
        # What is known of this machine from before a pause (mean and sigma of its offset, degC).
        self._machine: tuple[float, float] | None = None
        self._restart = True
        self._read_at: float | None = None
        self._index = {location.name: index for index, location in enumerate(model.sha.locations)}
        self._channels = tuple(channel.signal for channel in model.alphabet.channels)
        self._driving = tuple(sorted(self.tracker.inputs))
        self._inputs = tuple(dict.fromkeys((*self._channels, *self._driving, temperature)))
        self._cycle_starts = frozenset(c.rising for c in model.alphabet.channels if isinstance(c, Switch))

    @property
    def clamps(self) -> tuple[int, int]:
        """How often belief and free run were put back to the border of the model's range, since each began."""
        return (self.belief.clamps if self.belief else 0), (self.free.clamps if self.free else 0)

    @property
    def machine_offset(self) -> tuple[float, float] | None:
        """(mean, standard deviation) of what this machine's targets lie above the model's, degC; None if not asked."""
        return None if self.belief is None else machine_offset(self.tracker, self.belief)

    @property
    def inputs(self) -> tuple[str, ...]:
        """The tags that the model reads."""
        return self._inputs

    def missing_inputs(self, tags: Mapping[str, object]) -> list[str]:
        """The inputs that a register map lacks."""
        return [name for name in self._inputs if name not in tags]

    def track(self, scan: Scan) -> bool:
        """Take one scan in and say nothing of it; whether all that the model reads is good, and no channel unknown.

        Of the free run, which nothing looks at then, there is none.
        """
        self._advance(scan)
        samples = (scan.samples.get(name) for name in self._inputs)
        return self.encoder.known and all(sample is not None and sample.quality.is_good for sample in samples)

    def _advance(self, scan: Scan) -> tuple[list[Event], dict[str, float], float | None, Belief]:
        """The events, inputs and reading of one scan, and what was expected of that reading; the belief has it by now.

        Only good readings count: anything else makes its channel unknown and corrects nothing.
        """
        # The order is the model's: events change the location, inputs the flow in it, and only then does the reading
        # say how right the temperature was that all of them led to.
        events = self.encoder.feed(scan.time, {name: scan.good(name) for name in self._channels})
        # An early scan shows again what the scan before it has read: the same reading must not correct twice.
        sample = scan.samples.get(self.temperature)
        repeated = scan.early and sample is not None and sample.time == self._read_at
        self._read_at = None if sample is None else sample.time
        measured = None if repeated else scan.good(self.temperature)
        signals = {name: value for name in self._driving if (value := scan.good(name)) is not None}

        # Events may lie before the scan that shows them: a belief that begins here begins with the first of them.
        first = min((scan.time, *(event.time for event in events)))
        expected = self.belief
        if expected is None:
            expected = start(self.tracker, first)
            if self._machine is not None:
                expected = with_machine_offset(self.tracker, expected, *self._machine)
        for event in events:
            expected = on_event(self.tracker, expected, event)
        expected = with_inputs(self.tracker, expected, scan.time, signals)
        # Inputs have advanced it already where the model reads any; time never goes back.
        if expected.time < scan.time:
            expected = advance(self.tracker, expected, scan.time)
        self.belief = expected if measured is None else self.correct(self.tracker, expected, scan.time, measured)
        self.past.keep(scan.time, events, signals, self.belief)
        return events, signals, measured, expected

    def step(self, scan: Scan) -> ScanPrediction:
        """Take one scan in, and say what was expected of it."""
        events, signals, measured, expected = self._advance(scan)
        belief = expected if self.belief is None else self.belief
        free_run = self._free_run(scan.time, events, signals, expected, measured)
        self.events += len(events)

        # The input in the worst state, and the one that was read longest ago, speak for all of them.
        worst, age = 0, 0.0
        for name in self._inputs:
            sample = scan.samples.get(name)
            quality = Quality.CONFIGURATION_ERROR if sample is None else sample.quality
            worst = max(worst, 0 if quality.is_good else 2 if quality.is_bad else 1)
            readable = sample is not None and sample.value is not None
            # From when it was asked for: the device looked at its memory somewhere between that and its reply.
            if sample is None or not readable:
                age = float("inf")
            else:
                age = max(age, scan.time - (sample.time if sample.sent is None else sample.sent))
        known = self.encoder.known
        score = anomaly(belief) + 0.0  # -log10 of a p-value of 1 is -0.0, which nobody should read
        zone: Zone
        if not known or worst > 0 or len(belief.recent) < MIN_ERRORS:
            zone = "none"
        else:
            zone = "green" if score < YELLOW_SCORE else "yellow" if score < RED_SCORE else "red"
        # The band is for a reading, not for the temperature itself: the sensor's own variance comes on top.
        sigma = sqrt(expected.xx + self.tracker.sensor)
        return ScanPrediction(
            time=scan.time,
            location=belief.location,
            location_index=self._index[belief.location],
            known=known,
            inputs_good=worst == 0,
            worst=worst,
            age=age,
            measured=measured,
            mean=expected.x if expected.seen else None,
            low=expected.x - Z90 * sigma if expected.seen else None,
            high=expected.x + Z90 * sigma if expected.seen else None,
            free_run=free_run,
            anomaly=score,
            zone=zone,
            events=tuple(events),
            reset=any(event.symbol == UNKNOWN for event in events),
            free_sigma=None if free_run is None or self.free is None else sqrt(self.free.xx + self.tracker.sensor),
            borrowed=belief.location in self.model.borrowed,
        )

    def forget_readings(self, since: float) -> bool:
        """Believe what would be believed without the readings from `since` (plant s) on; False if that is too long ago.

        They were a sensor's that has been found out.
        """
        if self.belief is None or self.belief.read_at is None or self.belief.read_at < since:
            return self.belief is not None
        belief = self.past.without_readings(since, self.belief.time)
        if belief is None:
            return False
        self.belief = belief
        return True

    def _free_run(
        self, time: float, events: list[Event], signals: Mapping[str, float], expected: Belief, measured: float | None
    ) -> float | None:
        """The open loop: begun anew at a cycle's start and after not knowing, never corrected in between."""
        if any(event.symbol == UNKNOWN or event.symbol in self._cycle_starts for event in events):
            self._restart = True
        if self._restart:
            # It begins from a reading, and only in a location that is known; until both are there, there is none.
            if measured is None or not self.encoder.known:
                self.free = None
                return None
            self.free = restart(self.tracker, expected, measured)
            self._restart = False
            # The reading that it was begun from says nothing of how right it is.
            return None
        if self.free is None:
            return None
        for event in events:
            self.free = on_event(self.tracker, self.free, event)
        self.free = with_inputs(self.tracker, self.free, time, signals)
        return self.free.x

    def snapshot(self) -> dict[str, Any] | None:
        """Encoder and belief as JSON can carry them; None before the first scan."""
        if self.belief is None:
            return None
        # One that waits to be begun anew is not kept: a restart of the gateway begins it anew as well.
        free = None if self.free is None or self._restart else shallow_dict(self.free)
        return {"encoder": shallow_dict(self.encoder.state), "belief": shallow_dict(self.belief), "free": free}

    def restore(self, saved: Mapping[str, Any], now: float) -> bool:
        """Go on from a snapshot, if it is not older than the alphabet's gap and not of the future; says whether it did.

        Raises KeyError, TypeError or ValueError for a snapshot of another alphabet or model.
        """
        belief = restore_belief(saved["belief"])
        # The plant may have changed while nobody looked, but it is still the same machine.
        if belief.location in self._index:
            self._machine = machine_offset(self.tracker, belief)
        if not 0.0 <= now - belief.time <= self.model.alphabet.gap or belief.location not in self._index:
            return False
        # JSON has turned the encoder's tuples into lists.
        encoder: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in saved["encoder"].items()}
        self.encoder = Encoder(self.model.alphabet, state=EncoderState(**encoder))
        self.belief = belief
        self.free = restore_belief(saved["free"]) if saved["free"] else None
        self._restart = self.free is None
        return True
