"""What is wrong with a sensor (NAMUR NE 107) and where a temperature is heading, from the readings alone.

Each watch takes one reading a scan and gives numbers that the alarms look at; None is not known. What the constants are
measured against says decision record 0132; `python -m benchmarks.sensor_alarms` measures it again.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import exp, isfinite, nan, sqrt
from typing import Any

from drivers.tag import Quality, Sample
from gateway.machine.alarms.conditions import RISING, SENSOR_FAULTS, on_tag
from gateway.machine.reading import Scan
from gateway.settings import FAULT_THRESHOLD

GAP_SECONDS = 60.0
"""A reading that follows the one before by more than this says nothing of the way between them."""

FROZEN_SECONDS, FROZEN_MOVE, FROZEN_CHANGES = 120.0, 2.0, 100
"""A reading is frozen that has stood for so long (s) while its twin moved so far (degC) or so often."""
FROZEN_ALONE_SECONDS, FROZEN_ALONE_TIMES = 1800.0, 20.0
"""Without a twin: it has stood for so long (s), and so many times longer than ever before."""
JUMP_RATE, JUMP_SECONDS, MIN_JUMPS, JUMP_MEMORY = 5.0, (1.0, 5.0), 2, 600.0
"""A step of more than this (degC/s, over these seconds at least and at most) is one that no bearing takes; so many of
them within the memory (s) are a fault. A spike is two, there and back."""
MAX_NOISE_SD, NOISE_SECONDS, NOISE_STEP = 0.6, 120.0, 6.0
"""The standard deviation (degC) of a reading that is a fault, over how long (s) it is taken, and the step (degC) from
which on it is a jump and no noise."""
REFERENCE_SECONDS, DRIFT_SECONDS, MAX_DRIFT, DRIFT_SIGMAS = 3 * 86_400.0, 3600.0, 2.5, 6.0
"""Twins are compared for so long (s) before their difference is a reference; then its mean over an hour may differ from
that by so much (degC), or so many of its standard deviations."""
TREND_WINDOW, TREND_STEP, TREND_LEAST = 300.0, 5.0, 150.0
"""The straight line is laid through the readings of so many seconds, one each step, and not before there are as many
seconds of them."""


DISTRUSTED: Mapping[str, Quality] = {
    "sensor frozen": Quality.SENSOR_FAILURE,
    "sensor jumping": Quality.SENSOR_NOT_ACCURATE,
    "sensor noisy": Quality.SENSOR_NOT_ACCURATE,
}
"""What a reading is worth to a model by what is wrong with its sensor; out of range its own quality says so. One that
needs maintenance (NE 107) still measures: of two that drift apart nobody knows which one is right."""


@dataclass(frozen=True, slots=True)
class SensorFault:
    """What is wrong with a sensor (a kind of alarm), and since when (plant s) its readings have been wrong."""

    kind: str
    since: float


def without_faulty(scan: Scan, faults: Mapping[str, SensorFault]) -> Scan:
    """The scan as a model may see it: sensors that were found out show nothing. `faults` are by tag."""
    samples = dict(scan.samples)
    for name, fault in faults.items():
        if (sample := samples.get(name)) is not None and not sample.quality.is_bad:
            samples[name] = replace(sample, value=None, quality=DISTRUSTED[fault.kind], reason=fault.kind)
    return replace(scan, samples=samples)


@dataclass(slots=True)
class SensorHistory:
    """What is remembered of one sensor. Times are plant seconds, numbers degC; the last `step` took the `span`.

    `before` is the reading from before a gap, as long as the sensor has not been seen to move since (None: it has).
    """

    value: float | None = None
    before: float | None = None
    time: float = 0.0
    step: float | None = None
    span: float = 0.0
    changed: float = 0.0
    longest: float = 0.0
    twin_then: float | None = None
    twin_changes: int = 0
    twin_moved: float = 0.0
    jumps: deque[float] = field(default_factory=deque)
    variance: float = 0.0
    noise_seconds: float = 0.0
    line: deque[tuple[float, float]] = field(default_factory=deque)
    ahead: float | None = None


@dataclass(slots=True)
class TwinReference:
    """The difference of twins: its `mean` and `square` (variance) over `seconds` of comparing, and `recent` mean."""

    seconds: float = 0.0
    mean: float = 0.0
    square: float = 0.0
    recent: float | None = None

    def take(self, difference: float, seconds: float) -> float | None:
        """Take a difference that stood for some seconds; by how much it is off its reference, None before that.

        FAULT_THRESHOLD is as much as may be.
        """
        weight = 1.0 - exp(-seconds / DRIFT_SECONDS)
        self.recent = difference if self.recent is None else self.recent + weight * (difference - self.recent)
        if self.seconds < REFERENCE_SECONDS:
            # Welford's update, each difference weighing as long as it stood.
            self.seconds += seconds
            share, off = seconds / self.seconds, difference - self.mean
            self.mean += share * off
            self.square = (1.0 - share) * (self.square + share * off * off)
            return None
        return FAULT_THRESHOLD * abs(self.recent - self.mean) / max(MAX_DRIFT, DRIFT_SIGMAS * sqrt(self.square))


class SensorWatch:
    """The sensors of the `watched` temperatures of a machine; `twins` are two of them that warm alike, or none.

    `trend` (s) is how far ahead the straight line is drawn, None: not at all.
    """

    def __init__(self, watched: Sequence[str], twins: Sequence[str], trend: float | None) -> None:
        self.watched, self.twins, self._trend = tuple(watched), tuple(twins), trend
        self._histories = {name: SensorHistory() for name in watched}
        self._names = {(kind, name): on_tag(kind, name) for kind in (RISING, *SENSOR_FAULTS) for name in watched}
        self.reference = TwinReference()

    def take(self, scan: Scan) -> dict[str, float | None]:
        """What the alarms of the sensors look at, by their names."""
        found: dict[str, float | None] = {}
        names = self._names
        elapsed: dict[str, float] = {}
        for name in self.watched:
            sample, history = scan.samples.get(name), self._histories[name]
            value = _number(sample)
            quality = None if sample is None else sample.quality
            if quality in (Quality.OUT_OF_RANGE, Quality.SENSOR_FAILURE):
                found[names["sensor out of range", name]] = 1.0
            elif value is not None:
                found[names["sensor out of range", name]] = 0.0
            if value is None:
                continue
            first = history.value is None or not 0.0 < scan.time - history.time <= GAP_SECONDS
            elapsed[name] = 0.0 if first else scan.time - history.time
            if first:
                self._histories[name] = history = SensorHistory(
                    longest=history.longest,
                    jumps=history.jumps,
                    changed=scan.time,
                    before=history.value,
                )
            twin = _number(scan.samples.get(self._twin(name))) if name in self.twins else None
            found[names["sensor jumping", name]] = _count_jumps(history, value, scan.time, elapsed[name])
            found[names["sensor noisy", name]] = _noisy(history, value, elapsed[name])
            found[names["sensor frozen", name]] = _frozen_time(history, value, scan.time, twin, alone=not self.twins)
            if self._trend is not None:
                found[names[RISING, name]] = _ahead(history, scan.good(name), scan.time, self._trend)
            history.value, history.time = value, scan.time
        if len(self.twins) == 2:
            one, other = self.twins
            a, b = scan.good(one), scan.good(other)
            seconds = min(elapsed.get(one, 0.0), elapsed.get(other, 0.0))
            if a is not None and b is not None and seconds > 0.0:
                found[names["sensor drifting", one]] = self.reference.take(a - b, seconds)
        return found

    def fault(self, kind: str, name: str, now: float) -> SensorFault:
        """The fault of a kind that was found by `now`, with the time from which on the readings were wrong."""
        history = self._histories[name]
        begun = {
            "sensor frozen": history.changed,
            "sensor jumping": history.jumps[0] if history.jumps else now,
            "sensor noisy": now - NOISE_SECONDS,
        }
        return SensorFault(kind, begun.get(kind, now))

    def _twin(self, name: str) -> str:
        return self.twins[1] if name == self.twins[0] else self.twins[0]

    def compare_anew(self) -> None:
        """Forget how the twins differed: one of their sensors was worked on."""
        self.reference = TwinReference()

    def to_plain(self) -> dict[str, Any]:
        """What a restart goes on from, as JSON can carry it."""
        r = self.reference
        plain = {"seconds": r.seconds, "mean": r.mean, "square": r.square, "recent": r.recent}
        return {"twins": list(self.twins), "reference": plain}

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Go on from what `to_plain` gave, if it is of the same twins. Raises KeyError, TypeError or ValueError."""
        if list(saved["twins"]) == list(self.twins):
            plain = saved["reference"]
            recent = plain["recent"]
            self.reference = TwinReference(
                seconds=float(plain["seconds"]),
                mean=float(plain["mean"]),
                square=max(float(plain["square"]), 0.0),
                recent=None if recent is None else float(recent),
            )


def _number(sample: Sample | None) -> float | None:
    """What the sensor shows, also where its rate makes it doubtful: a fault is seen in the very readings it spoils."""
    if sample is None or sample.value is None or isinstance(sample.value, str):
        return None
    doubtful = sample.quality is Quality.SENSOR_NOT_ACCURATE
    value = float(sample.value) if doubtful or sample.quality.is_good else nan
    return value if isfinite(value) else None


def _count_jumps(history: SensorHistory, value: float, now: float, seconds: float) -> float:
    least, most = JUMP_SECONDS
    if history.value is not None and abs(value - history.value) > JUMP_RATE * min(max(seconds, least), most):
        history.jumps.append(now)
    while history.jumps and now - history.jumps[0] > JUMP_MEMORY:
        history.jumps.popleft()
    return float(len(history.jumps) >= MIN_JUMPS)


def _noisy(history: SensorHistory, value: float, seconds: float) -> float | None:
    """By how far readings lie off the straight line through the two before; heating leaves next to nothing in it.

    Of white noise that has 1 + (1 + r)^2 + r^2 times its variance, r being the time from the last reading over the time
    between the two before it: the six times of a second difference where readings come evenly.
    """
    before, span = history.step, history.span
    history.step, history.span = None if history.value is None else value - history.value, seconds
    # What is a jump is said as one.
    if history.step is None or before is None or max(abs(history.step), abs(before)) > NOISE_STEP:
        return None
    ratio = seconds / span
    off = (history.step - ratio * before) ** 2 / (1.0 + (1.0 + ratio) ** 2 + ratio**2)
    history.variance += (1.0 - exp(-seconds / NOISE_SECONDS)) * (off - history.variance)
    history.noise_seconds += seconds
    if history.noise_seconds < NOISE_SECONDS:
        return None
    return FAULT_THRESHOLD * sqrt(history.variance) / MAX_NOISE_SD


def _frozen_time(history: SensorHistory, value: float, now: float, twin: float | None, *, alone: bool) -> float | None:
    """Compared by the bit: a sensor that lives has noise, a frozen one has none.

    None: it shows after a gap what it showed before, by the bit. That is no reason to call a frozen one mended.
    """
    if value != history.before:
        history.before = None
    unmoved = 0.0 if history.before is None else None
    if history.value is None or value != history.value:
        if history.value is not None:
            history.longest = max(history.longest, now - history.changed)
        history.changed, history.twin_then = now, twin
        history.twin_changes, history.twin_moved = 0, 0.0
        return unmoved
    return 1.0 if _stands(history, now, twin, alone=alone) else unmoved


def _stands(history: SensorHistory, now: float, twin: float | None, *, alone: bool) -> bool:
    """Whether a reading that has not moved has stood for too long."""
    stood = now - history.changed
    if alone:
        # Of a sensor of which no change was seen yet nobody knows how often it should.
        usual = history.longest or float("inf")
        return stood > max(FROZEN_ALONE_SECONDS, FROZEN_ALONE_TIMES * usual)
    if twin is None:
        return False
    if history.twin_then is None:
        history.twin_then = twin
    history.twin_changes += twin != history.twin_then
    # The furthest that it was: it may come back to where it stood, and what stands still is frozen all the same.
    history.twin_moved = max(history.twin_moved, abs(twin - history.twin_then))
    moved = history.twin_moved >= FROZEN_MOVE or history.twin_changes >= FROZEN_CHANGES
    return stood > FROZEN_SECONDS and moved


def _ahead(history: SensorHistory, value: float | None, now: float, seconds: float) -> float | None:
    """Where the straight line (least squares) through the last readings is `seconds` from now; None without one."""
    line = history.line
    if value is None:
        return None
    if line and now - line[-1][0] < TREND_STEP:
        return history.ahead
    line.append((now, value))
    while now - line[0][0] > TREND_WINDOW:
        line.popleft()
    if now - line[0][0] < TREND_LEAST:
        return None
    # Times from now: the sums stay small, and the line's value ahead is its height at `seconds`.
    count = len(line)
    times = [time - now for time, _ in line]
    mean_time, mean = sum(times) / count, sum(reading for _, reading in line) / count
    spread = sum((time - mean_time) ** 2 for time in times)
    slope = sum((time - mean_time) * (reading - mean) for time, (_, reading) in zip(times, line, strict=True)) / spread
    history.ahead = mean + slope * (seconds - mean_time)
    return history.ahead
