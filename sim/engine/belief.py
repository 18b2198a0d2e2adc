"""What is believed of the plant now: the exact Kalman filter on temperature and mode parameter in a known location.

With the location known every flow is affine (`sim.sha.flows`), so over a step of dt seconds

    (X, m) -> F (X, m) + (pull * offset, 0) + noise,    F = [[decay, pull], [0, 1]]

and the filter is exact, however long the step is. Under a saturated rate the mean takes the saturated map while the
covariance keeps the unsaturated one. At one instant events come before inputs, inputs before the reading.

With effects there are more states and the arithmetic is that of matrices (`sim.engine.state_estimate`); without them it
is written out for the two numbers X and m, some forty times as fast (`benchmarks.engines`). When events, inputs and
readings take effect is one matter for both. A dead time holds events and inputs back in a queue until they are due, so
that sample by sample the filter does what a schedule does for a whole trace.

Every function takes a `Model` or, where speed counts, its `Tracker` (`compile_model`, made once).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import inf, isfinite, log, nan, pi, sqrt
from types import MappingProxyType

import numpy as np

from sim.effects import dead_time
from sim.engine import state_estimate
from sim.engine.belief_state import Belief, Delayed, Hidden, Innovation
from sim.engine.tracker import Tracker, compile_tracker, next_location, repeat_factor
from sim.scores import surprise
from sim.sha import UNKNOWN, Array, Event, Model, Trace, distributions

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
    tracker = compile_tracker(model)
    if not isfinite(time):
        raise ValueError(f"a belief cannot start at {time} s")
    mode = tracker.modes[tracker.model.sha.initial]
    held = {name: value for name, value in signals.items() if name in tracker.inputs and isfinite(value)}
    law, low, high = tracker.model.initial, tracker.model.sha.low, tracker.model.sha.high
    if law is not None:
        x, xx = distributions.mean(law), distributions.variance(law)
    elif mode.temperature is not None:
        x, xx = mode.temperature
    else:
        # Anywhere in the range, with the moments of a uniform law; one without ends counts as 1,000 degC wide about 0,
        # which any first reading outweighs.
        if not isfinite(high - low):
            low, high = -500.0, 500.0
        x, xx = (low + high) / 2.0, (high - low) ** 2 / 12.0
    m, mm = mode.parameter
    belief = Belief(
        location=tracker.model.sha.initial,
        entered=time,
        time=time,
        x=x,
        m=m,
        xx=xx,
        xm=0.0,
        mm=mm,
        offset=mode.offset(held),
        signals=held,
    )
    if tracker.plant is not None:
        belief = state_estimate.at_reading(tracker.plant, belief)
    return belief if temperature is None else observe(tracker, belief, time, temperature)


def _prior(tracker: Tracker, belief: Belief, time: float) -> tuple[float, float, float, int]:
    """(x, xx, xm) at `time` without effects, and whether x was clamped (0 or 1); m and its variance do not move.

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
    # Only the mean knows the rate limit: the covariance of a limited step is taken as that of the free one.
    x = decay * belief.x + pull * target if rate == inf else mode.mean(belief.x, target, age, dt, rate)
    held = min(max(x, sha.low), sha.high)
    xx = decay * decay * xx + 2.0 * decay * pull * xm + pull * pull * mm + variance
    return held, xx, decay * xm + pull * mm, int(held != x)


def advance(model: Model | Tracker, belief: Belief, time: float) -> Belief:
    """The belief at a later `time` with nothing read in between: inputs held, variance grown by the flow.

    What a dead time holds back acts when it is due. Raises ValueError when `time` is before the belief's or no number.
    """
    if not belief.time <= time < inf:
        raise ValueError(f"a belief at {belief.time} s cannot be advanced to {time} s: time only goes forward")
    tracker = compile_tracker(model)
    if tracker.plant is None:
        x, xx, xm, clamped = _prior(tracker, belief, time)
        return replace(belief, time=time, x=x, xx=xx, xm=xm, clamps=belief.clamps + clamped)
    # Each delayed thing acts at its own moment, so the step up to `time` is cut there; what is due at `time` itself
    # acts now, before a reading of that instant.
    while belief.hidden is not None and belief.hidden.pending and belief.hidden.pending[0].due <= time:
        first, *rest = belief.hidden.pending
        # What waits heats until it is due.
        belief = state_estimate.predict(tracker.plant, belief, max(first.due, belief.time))
        belief = replace(belief, hidden=replace(belief.hidden or Hidden((), ()), pending=tuple(rest)))
        if first.symbol:
            belief = _take_event(tracker, belief, first.symbol)
        elif first.signals:
            belief = _take_signals(tracker, belief, first.signals)
        else:
            belief = state_estimate.fade_jumps(belief, first.jumps)
    return state_estimate.predict(tracker.plant, belief, time)


def observe(model: Model | Tracker, belief: Belief, time: float, temperature: float) -> Belief:
    """The belief after the reading `temperature` (degC) at `time`.

    The first reading of all fixes X (see `start`) and is no innovation. A reading that comes with a time before the
    belief's (or none) is counted in `late` and otherwise ignored; one that is no number only advances the belief.
    """
    tracker = compile_tracker(model)
    if not belief.time <= time < inf:
        return replace(belief, late=belief.late + 1)
    if not isfinite(temperature):
        return advance(tracker, belief, time)
    sensor = tracker.sensor
    if not belief.seen:
        moved = replace(
            advance(tracker, belief, time), x=temperature, xx=sensor, xm=0.0, samples=1, seen=True, read_at=time
        )
        return moved if tracker.plant is None else state_estimate.at_reading(tracker.plant, moved)
    if tracker.plant is None:
        x, xx, xm, clamped = _prior(tracker, belief, time)
    else:
        belief = advance(tracker, belief, time)
        x, xx, xm, clamped = belief.x, belief.xx, belief.xm, 0
    # What the reading was expected to be has the sensor's own variance, however long its error lasts; what the reading
    # corrects counts that memory.
    expected = xx + sensor
    value = temperature - x
    square = value * value / expected
    recent = (*belief.recent, square)
    if tracker.sensor_memory and belief.read_at is not None:
        sensor *= repeat_factor(tracker.sensor_memory, time - belief.read_at)
    # The Kalman update with H = (1, 0), written out. xx R / (xx + R) is xx - xx^2 / (xx + R) without its cancellation,
    # so xx stays positive after a reading far better than the prediction; mm has no such form and is held at 0.
    variance = xx + sensor
    posterior = replace(
        belief,
        time=time,
        x=x + xx / variance * value,
        m=belief.m + xm / variance * value,
        xx=xx * sensor / variance,
        xm=xm * sensor / variance,
        mm=max(belief.mm - xm * xm / variance, 0.0),
        last=Innovation(value, expected, square),
        recent=recent[-tracker.window :],
        evidence=belief.evidence - 0.5 * (log(2.0 * pi * expected) + square),
        samples=belief.samples + 1,
        seen=True,
        clamps=belief.clamps + clamped,
        read_at=time,
    )
    return posterior if tracker.plant is None else state_estimate.update(tracker.plant, posterior, value, variance)


def on_event(model: Model | Tracker, belief: Belief, event: Event) -> Belief:
    """The belief after `event`: the stay it begins has its own m, independent of X (`entry.mode_parameter`).

    X goes on, or follows the location's law (`resample`). UNKNOWN leads to the initial location. An event without an
    edge follows the tracker's policy and is counted in `unmatched`; one older than the belief takes effect at the
    belief's time and is counted in `late`. A dead time holds the event back.
    """
    tracker = compile_tracker(model)
    late = not belief.time <= event.time < inf
    moved = belief if late else advance(tracker, belief, event.time)
    delay = 0.0 if tracker.plant is None else dead_time(tracker.plant.sha)
    if delay:
        due = (event.time if isfinite(event.time) else belief.time) + delay
        return _take_delay(replace(moved, late=belief.late + late), Delayed(max(due, belief.time), event.symbol))
    return _take_event(tracker, moved, event.symbol, late=late)


def _take_event(tracker: Tracker, belief: Belief, symbol: str, *, late: bool = False) -> Belief:
    """The belief after an event that takes effect at the belief's time."""
    hidden = belief.hidden if tracker.plant is None else state_estimate.since_event(tracker.plant, belief, symbol)
    location, matched = next_location(tracker, belief.location, symbol)
    unmatched, lates = belief.unmatched + (not matched), belief.late + late
    if location is None:
        return replace(belief, unmatched=unmatched, late=lates, hidden=hidden)
    mode = tracker.modes[location]
    x, xx = mode.temperature or (belief.x, belief.xx)
    m, mm = mode.parameter
    moved = replace(
        belief,
        location=location,
        entered=belief.time,
        x=x,
        m=m,
        xx=xx,
        xm=0.0,
        mm=mm,
        offset=mode.offset(belief.signals),
        unmatched=unmatched,
        late=lates,
        hidden=hidden,
    )
    return moved if tracker.plant is None else state_estimate.enter_stay(tracker.plant, moved, mode)


def with_inputs(model: Model | Tracker, belief: Belief, time: float, signals: Mapping[str, float]) -> Belief:
    """The belief at `time` with new values of input signals, held from then on; the step up to then uses the old ones.

    Signals that neither a flow nor an effect reads are dropped, values that are no numbers are no news. A `time`
    before the belief's takes effect at the belief's time. A dead time holds the values back.
    """
    tracker = compile_tracker(model)
    # News is what differs from the last value that was read, whether that acts already or is still held back.
    known = belief.signals
    for delayed in belief.hidden.pending if belief.hidden is not None else ():
        known = {**known, **delayed.signals}
    news = {
        name: signals[name]
        for name in tracker.inputs
        if name in signals and isfinite(signals[name]) and known.get(name) != signals[name]
    }
    moved = advance(tracker, belief, time) if belief.time < time < inf else belief
    if not news:
        return moved
    delay = 0.0 if tracker.plant is None else dead_time(tracker.plant.sha)
    if delay:
        due = (time if isfinite(time) else moved.time) + delay
        return _take_delay(moved, Delayed(max(due, moved.time), "", news))
    return _take_signals(tracker, moved, news)


def _take_signals(tracker: Tracker, belief: Belief, news: Mapping[str, float]) -> Belief:
    held = {**belief.signals, **news}
    moved = replace(belief, signals=held, offset=tracker.modes[belief.location].offset(held))
    if tracker.plant is None or not tracker.plant.late:
        return moved
    hidden, waiting = state_estimate.hold_signals(tracker.plant, belief, held)
    moved = replace(moved, hidden=hidden)
    for each in waiting:
        moved = _take_delay(moved, each)
    return moved


WAITING_PARTS = 256
"""As many jumps are on their way one by one; from then on those within such a part of their delay come as one: of a
current that is read ten times a second there would else be thousands, each of which a forecast looks at."""


def _take_delay(belief: Belief, delayed: Delayed) -> Belief:
    """The belief with what a dead time holds back; at one instant events act before signals, as along a schedule.

    Where many wait already, a jump that follows another of the same effects within a part of its delay comes with that
    one: at most twice as many parts wait.
    """
    hidden = belief.hidden or Hidden((), ())
    waiting = list(hidden.pending)
    jumps = [place for place, each in enumerate(waiting) if each.jumps]
    if delayed.jumps and len(jumps) >= WAITING_PARTS:
        last = jumps[-1]
        before, part = waiting[last], (delayed.due - belief.time) / WAITING_PARTS
        same = [bool(jump) for jump in before.jumps] == [bool(jump) for jump in delayed.jumps]
        if same and 0.0 <= delayed.due - before.due < part:
            both = tuple(one + other for one, other in zip(before.jumps, delayed.jumps, strict=True))
            waiting[last] = replace(before, jumps=both)
            return replace(belief, hidden=replace(hidden, pending=tuple(waiting)))
    pending = sorted((*waiting, delayed), key=lambda each: (each.due, not each.symbol))
    return replace(belief, hidden=replace(hidden, pending=tuple(pending)))


def restart(model: Model | Tracker, belief: Belief, temperature: float) -> Belief:
    """The belief begun anew at a reading (degC) that is trusted to within the sensor; location, m and inputs stay.

    Of hidden states the housing's temperature stays as it is, and lags and X move with the reading.
    """
    tracker = compile_tracker(model)
    reading = replace(belief, x=temperature, xx=tracker.sensor, xm=0.0, seen=True, clamps=0, read_at=belief.time)
    return reading if tracker.plant is None else state_estimate.move_states(tracker.plant, belief, reading)


def machine_offset(model: Model | Tracker, belief: Belief) -> tuple[float, float] | None:
    """(mean, standard deviation), degC, of what this machine's targets lie above the model's; None if not asked."""
    plant = compile_tracker(model).plant
    known = None if plant is None else state_estimate.machine_offset(plant, belief)
    return None if known is None else (known[0], sqrt(max(known[1], 0.0)))


def with_machine_offset(model: Model | Tracker, belief: Belief, mean: float, sigma: float) -> Belief:
    """The belief with what was learned of this machine before it was begun (`machine_offset`); else as it is."""
    plant = compile_tracker(model).plant
    if plant is None or plant.machine is None:
        return belief
    return state_estimate.with_machine_offset(plant, belief, mean, sigma * sigma)


def anomaly(belief: Belief) -> float:
    """How surprising the newest readings are: -log10 of the chi-square test's p-value, 0 (as expected) to 99.

    The sum of the squares in `belief.recent` (n <= the tracker's window) is chi-square with n degrees of freedom when
    the model is right: 2 is exceeded once in a hundred windows, 3 once in a thousand. 0 before any innovation.
    """
    return surprise(sum(belief.recent), len(belief.recent)) if belief.recent else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
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
    tracker = compile_tracker(model)
    name = tracker.model.temperature
    if not trace.times.size or name not in trace.signals:
        missing = f"signal {name!r}" if trace.times.size else "row"
        raise ValueError(f"trace {trace.name!r} has no {missing} to filter")
    inputs = {signal: trace.signals[signal].tolist() for signal in tracker.inputs & trace.signals.keys()}
    events = [*trace.events, Event(inf, UNKNOWN)]  # the last one never comes due: it spares the loop a test for the end
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
        # The first reading fixes X and a missing one leaves `last` as it was: neither has a prediction to be held
        # against.
        ahead: tuple[float, float, float] = (nan, nan, nan)
        if belief.last is not None and not first and isfinite(reading):
            ahead = (reading - belief.last.value, belief.last.variance, belief.last.value)
        rows.append((*ahead, belief.x, belief.m, belief.xx, belief.mm))
        locations.append(belief.location)
    predicted, variance, innovation, x, m, xx, mm = np.asarray(rows, dtype=float).T
    return Filtered(
        times=trace.times,
        predicted=predicted,
        variance=variance,
        innovation=innovation,
        x=x,
        m=m,
        xx=xx,
        mm=mm,
        locations=tuple(locations),
        belief=belief,
    )
