"""What is believed of the plant now: the exact Kalman filter on temperature and mode parameter in a known location.

With the location known every flow is affine (`sim.sha.flows`), so over a step of dt seconds

    (X, m) -> F (X, m) + (pull * offset, 0) + noise,    F = [[decay, pull], [0, 1]]

and the filter is exact, however long the step is. Under a saturated rate the mean takes the saturated map while the
covariance keeps the unsaturated one. At one instant events come before inputs, inputs before the reading.

With effects the state has more parts, and the filter is that of `sim.engine.filter`.

Every function takes a `Model` or, where speed counts, its `Tracker` (`compile_model`, made once).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import inf, isfinite, log, nan, pi
from types import MappingProxyType

import numpy as np

from sim.engine import filter as augmented
from sim.engine.belief_state import Belief, Hidden, Innovation, belief_of
from sim.engine.tracker import Mode, Tracker, compile_model, compiled, next_location
from sim.scores import surprise
from sim.sha import distributions
from sim.sha.model import Model
from sim.sha.trace import UNKNOWN, Array, Event, Trace

__all__ = [
    "Belief",
    "Filtered",
    "Hidden",
    "Innovation",
    "Tracker",
    "advance",
    "anomaly",
    "belief_of",
    "compile_model",
    "filter_trace",
    "observe",
    "on_event",
    "restarted",
    "start",
    "with_inputs",
]

_NO_SIGNALS: Mapping[str, float] = MappingProxyType({})


def start(
    model: Model | Tracker,
    time: float,
    temperature: float | None = None,
    signals: Mapping[str, float] = _NO_SIGNALS,
) -> Belief:
    """The belief at the automaton's initial location, from the first `temperature` (degC) when there is one.

    A first reading fixes X to within the sensor, whatever the model's initial law says: the plant may have been warm.
    Without it X follows that law, or the location's own (resample), or lies anywhere in low..high. A `temperature`
    that is no number counts as none. Raises ValueError when `time` is no number.
    """
    tracker = compiled(model)
    if not isfinite(time):
        raise ValueError(f"a belief cannot start at {time} s")
    mode = tracker.modes[tracker.model.sha.initial]
    held = {name: value for name, value in signals.items() if name in tracker.inputs and isfinite(value)}
    x, xx = _before_any_reading(tracker, mode)
    m, mm = mode.parameter
    belief = Belief(tracker.model.sha.initial, time, time, x, m, xx, 0.0, mm, mode.offset(held), held)
    if tracker.plant is not None:
        belief = augmented.begun(tracker.plant, belief)
    return belief if temperature is None else observe(tracker, belief, time, temperature)


def _before_any_reading(tracker: Tracker, mode: Mode) -> tuple[float, float]:
    """Mean and variance of X; a range without ends is taken to be 1,000 degC wide about 0."""
    law = tracker.model.initial
    if law is not None:
        return distributions.mean(law), distributions.variance(law)
    if mode.temperature is not None:
        return mode.temperature
    low, high = tracker.model.sha.low, tracker.model.sha.high
    if not isfinite(high - low):
        low, high = -500.0, 500.0
    return (low + high) / 2.0, (high - low) ** 2 / 12.0


def _predict(tracker: Tracker, belief: Belief, time: float) -> tuple[float, float, float, int]:
    """(x, xx, xm) at `time` and whether x was clamped (0 or 1); m and its variance do not move.

    Only a step can leave the automaton's range: a reading beyond it is what the sensor said, and is believed.
    """
    xx, xm, mm = belief.xx, belief.xm, belief.mm
    dt = time - belief.time
    if dt == 0.0:
        return belief.x, xx, xm, 0
    sha = tracker.model.sha
    mode, rate = tracker.modes[belief.location], sha.max_rate
    age, target = belief.time - belief.entered, belief.m + belief.offset
    decay, pull, variance = mode.step(age, dt)
    x = decay * belief.x + pull * target if rate == inf else mode.mean(belief.x, target, age, dt, rate)
    held = min(max(x, sha.low), sha.high)
    xx = decay * decay * xx + 2.0 * decay * pull * xm + pull * pull * mm + variance
    return held, xx, decay * xm + pull * mm, int(held != x)


def advance(model: Model | Tracker, belief: Belief, time: float) -> Belief:
    """The belief at a later `time` with nothing read in between: inputs held, variance grown by the flow.

    Raises ValueError when `time` is before the belief's or no number.
    """
    if not belief.time <= time < inf:
        raise ValueError(f"a belief at {belief.time} s cannot be advanced to {time} s: time only goes forward")
    tracker = compiled(model)
    if tracker.plant is not None:
        return augmented.advance(tracker, tracker.plant, belief, time)
    x, xx, xm, clamped = _predict(tracker, belief, time)
    return replace(belief, time=time, x=x, xx=xx, xm=xm, clamps=belief.clamps + clamped)


def observe(model: Model | Tracker, belief: Belief, time: float, temperature: float) -> Belief:
    """The belief after the reading `temperature` (degC) at `time`.

    The first reading of all fixes X (see `start`) and is no innovation. A reading that comes with a time before the
    belief's (or none) is counted in `late` and otherwise ignored; one that is no number only advances the belief.
    """
    tracker = compiled(model)
    if not belief.time <= time < inf:
        return replace(belief, late=belief.late + 1)
    if not isfinite(temperature):
        return advance(tracker, belief, time)
    sensor = tracker.sensor
    if not belief.seen:
        moved = replace(advance(tracker, belief, time), x=temperature, xx=sensor, xm=0.0, samples=1, seen=True)
        return moved if tracker.plant is None else augmented.begun(tracker.plant, moved)
    if tracker.plant is not None:
        return augmented.observe(tracker, tracker.plant, belief, time, temperature)
    x, xx, xm, clamped = _predict(tracker, belief, time)
    variance = xx + sensor
    value = temperature - x
    square = value * value / variance
    recent = (*belief.recent, square)
    return Belief(
        belief.location,
        belief.entered,
        time,
        x + xx / variance * value,
        belief.m + xm / variance * value,
        xx * sensor / variance,
        xm * sensor / variance,
        max(belief.mm - xm * xm / variance, 0.0),
        belief.offset,
        belief.signals,
        Innovation(value, variance, square),
        recent[-tracker.window :],
        belief.evidence - 0.5 * (log(2.0 * pi * variance) + square),
        belief.samples + 1,
        belief.unmatched,
        belief.late,
        True,
        belief.clamps + clamped,
    )


def on_event(model: Model | Tracker, belief: Belief, event: Event) -> Belief:
    """The belief after `event`: the stay it begins has its own m, independent of X (`entry.mode_parameter`).

    X goes on, or follows the location's law (`resample`). UNKNOWN leads to the initial location. An event without an
    edge follows the tracker's policy and is counted in `unmatched`; one older than the belief takes effect at the
    belief's time and is counted in `late`.
    """
    tracker = compiled(model)
    late = not belief.time <= event.time < inf
    moved = belief if late else advance(tracker, belief, event.time)
    if tracker.plant is not None:
        return augmented.on_event(tracker, tracker.plant, replace(moved, late=belief.late + late), event)
    location, matched = next_location(tracker, belief.location, event.symbol)
    unmatched, lates = belief.unmatched + (not matched), belief.late + late
    if location is None:
        return replace(moved, unmatched=unmatched, late=lates)
    mode = tracker.modes[location]
    x, xx = mode.temperature or (moved.x, moved.xx)
    m, mm = mode.parameter
    return replace(
        moved,
        location=location,
        entered=moved.time,
        x=x,
        m=m,
        xx=xx,
        xm=0.0,
        mm=mm,
        offset=mode.offset(belief.signals),
        unmatched=unmatched,
        late=lates,
    )


def with_inputs(model: Model | Tracker, belief: Belief, time: float, signals: Mapping[str, float]) -> Belief:
    """The belief at `time` with new values of input signals, held from then on; the step up to then uses the old ones.

    Signals that drive no flow are dropped, values that are no numbers are no news. A `time` before the belief's takes
    effect at the belief's time.
    """
    tracker = compiled(model)
    if tracker.plant is not None:
        moved = advance(tracker, belief, time) if belief.time < time < inf else belief
        return augmented.with_inputs(tracker, tracker.plant, moved, time, signals)
    held = belief.signals
    news = {
        name: signals[name]
        for name in tracker.inputs
        if name in signals and isfinite(signals[name]) and held.get(name) != signals[name]
    }
    moved = advance(tracker, belief, time) if belief.time < time < inf else belief
    if not news:
        return moved
    held = {**held, **news}
    return replace(moved, signals=held, offset=tracker.modes[belief.location].offset(held))


def restarted(model: Model | Tracker, belief: Belief, temperature: float) -> Belief:
    """The belief begun anew at a reading (degC) that is trusted to within the sensor; location, m and inputs stay.

    Of hidden states the housing's temperature stays as it is, and lags and X move with the reading.
    """
    tracker = compiled(model)
    begun = replace(belief, x=temperature, xx=tracker.sensor, xm=0.0, seen=True, clamps=0)
    return begun if tracker.plant is None else augmented.restarted(tracker.plant, belief, begun)


def anomaly(belief: Belief) -> float:
    """How surprising the newest readings are: -log10 of the chi-square test's p-value, 0 (as expected) to 99.

    The sum of the squares in `belief.recent` (n <= the tracker's window) is chi-square with n degrees of freedom when
    the model is right: 2 is exceeded once in a hundred windows, 3 once in a thousand. 0 before any innovation.
    """
    return surprise(sum(belief.recent), len(belief.recent)) if belief.recent else 0.0


@dataclass(frozen=True, slots=True)
class Filtered:
    """The filter's run over a trace of n rows; the arrays are (n,).

    `predicted` (degC) and `variance` are the one-step prediction of the reading and its variance (sensor included),
    `innovation` = reading - prediction: NaN where the row has no reading, and for the first one. `x`, `m`, `xx`, `mm`
    are the belief after the row, `locations` the names after the row's events; `belief` is the last one, with
    evidence and counts.
    """

    times: Array
    predicted: Array
    variance: Array
    innovation: Array
    x: Array
    m: Array
    xx: Array
    mm: Array
    locations: tuple[str, ...]
    belief: Belief


def filter_trace(model: Model | Tracker, trace: Trace) -> Filtered:
    """The filter over an encoded trace (its `events` must be there): events, then inputs, then the row's reading.

    Raises ValueError when the trace has no rows or lacks the model's temperature signal.
    """
    tracker = compiled(model)
    name = tracker.model.temperature
    if not trace.times.size or name not in trace.signals:
        missing = f"signal {name!r}" if trace.times.size else "row"
        raise ValueError(f"trace {trace.name!r} has no {missing} to filter")
    inputs = {signal: trace.signals[signal].tolist() for signal in tracker.inputs & trace.signals.keys()}
    events = [*trace.events, Event(inf, UNKNOWN)]
    upcoming = 0
    belief = start(tracker, min(float(trace.times[0]), events[0].time))
    rows: list[tuple[float, ...]] = []
    locations: list[str] = []
    for row, (time, reading) in enumerate(zip(trace.times.tolist(), trace.signals[name].tolist(), strict=True)):
        while events[upcoming].time <= time:
            belief = on_event(tracker, belief, events[upcoming])
            upcoming += 1
        belief = with_inputs(tracker, belief, time, {signal: column[row] for signal, column in inputs.items()})
        first = not belief.seen
        belief = observe(tracker, belief, time, reading)
        rows.append((*_one_step(belief, reading, first), belief.x, belief.m, belief.xx, belief.mm))
        locations.append(belief.location)
    predicted, variance, innovation, x, m, xx, mm = np.asarray(rows, dtype=float).T
    return Filtered(trace.times, predicted, variance, innovation, x, m, xx, mm, tuple(locations), belief)


def _one_step(belief: Belief, reading: float, first: bool) -> tuple[float, float, float]:
    """(prediction, its variance, innovation) of the reading just taken."""
    if belief.last is None or first or not isfinite(reading):
        return nan, nan, nan
    return reading - belief.last.value, belief.last.variance, belief.last.value
