"""What an exported model replays: where the run starts, the timed events, the held readings of the inputs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil

import numpy as np

from sim.effects import dead_time, delay_of, effect_signals, late_source
from sim.engine import Policy, Start, compile_plant, open_loop_schedule, resync_targets, start_law
from sim.sha import SHA, UNKNOWN, Array, Distribution, Effect, Event, Model, Trace, transitions

TIME_DIGITS = 6
"""Decimals of exported times (microseconds): a trace's clock, in seconds since 1970, has no more in a double."""


@dataclass(frozen=True, slots=True)
class InputReadings:
    """The input signals of driven flows: rows (n,) at `times` (s since the start), each held until the next.

    `first` holds the values at the start; a signal that was not read by then is missing there.
    """

    times: Array
    values: dict[str, Array]
    first: dict[str, float]


@dataclass(frozen=True, slots=True)
class Clocks:
    """Where a run begins: `start` in absolute s, seconds since each start-up's event (inf: none yet), by effect.

    `late` (degC/s) is the late part of each heat that has one: at the start, or where its signals are first read.
    """

    start: float
    since: tuple[float, ...] = ()
    late: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class ReplayedTrace:
    """One trace as the exported model plays it; times in seconds since the first reading of the temperature.

    `location` is where the run starts and `age` for how long it has been there (s); `x0` the law of the first
    temperature. `times` and `symbols` are the events from the start to the last reading, `duration` the time between
    (s), `added` the moves (source, symbol, target) that the policy makes where the automaton has no edge, `dropped`
    the number of events that it passes over and `passed_over` their symbols. Under a dead time all times are those at
    which events and readings act; `clocks` are those of the effects. `all_symbols` are those of the whole trace,
    from the automaton's own initial location on, for the compatibility model.
    """

    trace: str
    location: str
    age: float
    x0: Distribution
    times: tuple[float, ...]
    symbols: tuple[str, ...]
    duration: float
    readings: InputReadings
    added: tuple[tuple[str, str, str], ...]
    dropped: int
    passed_over: tuple[str, ...]
    clocks: Clocks
    all_symbols: tuple[str, ...]
    accepted: bool

    @property
    def time_bound(self) -> int:
        """The queries' time bound: whole seconds, at least 1, that hold the whole replay."""
        return max(1, ceil(self.duration))


def build_replay(model: Model, trace: Trace, policy: Policy = "resync", start: Start = "measured") -> ReplayedTrace:
    """The replay of an encoded trace, over the span and from the start that `open_loop` has.

    Raises ValueError as `open_loop_schedule` and `start_law` do: a model that is not deterministic or has guards, an
    event without an edge under `reject`, a missing input, a trace without a temperature.
    """
    steps = open_loop_schedule(model, trace, policy)
    law = start_law(model, trace, start)
    # Under a dead time the model follows events and readings when they act, so the exported arrays have them then.
    begin, end = steps.start, float(steps.times[-1])
    delayed, delay = trace, dead_time(model.sha)
    if delay:
        later = tuple(Event(event.time + delay, event.symbol) for event in trace.events)
        delayed = replace(trace, times=trace.times + delay, events=later)
    events = [event for event in delayed.events if begin <= event.time <= end]
    added, passed_over = _moves(model.sha, delayed.events, begin, end, policy)
    # Whether every event has an edge; UNKNOWN always leads to the initial location.
    onward, location, accepted = transitions(model.sha), model.sha.initial, True
    for event in trace.events:
        target = model.sha.initial if event.symbol == UNKNOWN else onward.get((location, event.symbol))
        if target is None:
            accepted = False
            break
        location = target
    since = () if steps.segments is None else tuple(float(column[0]) for column in steps.segments.since)
    coming = () if steps.segments is None else tuple(float(column[0]) for column in steps.segments.late)
    readings, late = _readings(model, delayed, begin, end), compile_plant(model.sha).late if coming else ()
    lates = tuple(
        _initial_late_heat(signals_before(effect), now, readings) for effect, now in zip(late, coming, strict=True)
    )
    return ReplayedTrace(
        trace=trace.name,
        location=model.sha.locations[int(steps.location[0])].name,
        age=round(float(steps.age[0]), TIME_DIGITS),
        x0=law,
        times=tuple(round(event.time - begin, TIME_DIGITS) for event in events),
        symbols=tuple(event.symbol for event in events),
        duration=round(end - begin, TIME_DIGITS),
        readings=readings,
        added=added,
        dropped=len(passed_over),
        passed_over=passed_over,
        clocks=Clocks(begin, since, lates),
        all_symbols=tuple(event.symbol for event in trace.events),
        accepted=accepted,
    )


def signals_before(effect: Effect) -> Effect:
    """The effect on signals that are as its own were its delay before: further inputs, which `InputReadings` has."""
    delay = delay_of(effect)
    if not delay:
        return effect
    return replace(effect, signals={role: f"{name} {delay:g} s before" for role, name in effect.signals.items()})


def replayed_signals(sha: SHA) -> list[str]:
    """The signals that a replay has, those of before among them."""
    driving = {driver.signal for location in sha.locations for driver in location.flow.inputs}
    before = {name for effect in sha.effects for name in signals_before(effect).signals.values()}
    return sorted(driving | {*effect_signals(sha)} | before)


def _with_before(sha: SHA, trace: Trace) -> Trace:
    """The trace with the signals of before, which until their delay is over are as they were first read."""
    for effect in (each for each in sha.effects if delay_of(each)):
        clock = np.union1d(trace.times, trace.times + delay_of(effect))
        row = np.searchsorted(trace.times, clock, side="right") - 1
        before = np.searchsorted(trace.times + delay_of(effect), clock, side="right") - 1
        signals = {name: column[row] for name, column in trace.signals.items()}
        for name, its in zip(effect.signals.values(), signals_before(effect).signals.values(), strict=True):
            if name in trace.signals:
                column = trace.signals[name]
                first = int(np.argmax(np.isfinite(column)))
                signals[its] = np.where(row < first, np.nan, column[np.maximum(before, first)])
        trace = replace(trace, times=clock, signals=signals)
    return trace


def _initial_late_heat(effect: Effect, deviation: float, readings: InputReadings) -> float:
    """degC/s: the late part of a heat at the start, or as its signals' first readings will find it; 0 without any."""
    now = {
        signal: np.append(readings.first.get(signal, np.nan), readings.values.get(signal, np.empty(0)))
        for signal in effect.signals.values()
    }
    source = late_source(effect, now)
    known = source[np.isfinite(source)]
    return float(known[0]) + deviation if known.size else 0.0


def _moves(
    sha: SHA, events: Sequence[Event], begin: float, end: float, policy: Policy
) -> tuple[tuple[tuple[str, str, str], ...], tuple[str, ...]]:
    """The moves between `begin` and `end` for which the automaton has no edge, and the events passed over."""
    moves, fallback, location = transitions(sha), resync_targets(sha), sha.initial
    added: dict[tuple[str, str, str], None] = {}
    dropped: list[str] = []
    for event in events:
        if event.time > end:
            break
        target = sha.initial if event.symbol == UNKNOWN else moves.get((location, event.symbol))
        if target is None:
            if policy == "ignore":
                dropped += [event.symbol] if event.time >= begin else []
                continue
            target = fallback.get(event.symbol, sha.initial)
        if event.time >= begin and (event.symbol == UNKNOWN or (location, event.symbol) not in moves):
            added[location, event.symbol, target] = None
        location = target
    return tuple(added), tuple(dropped)


def _readings(model: Model, trace: Trace, begin: float, end: float) -> InputReadings:
    """The rows in which a reading of a driving signal changed, from `begin` on."""
    trace = _with_before(model.sha, trace)
    present = [signal for signal in replayed_signals(model.sha) if signal in trace.signals]
    rows = np.flatnonzero((trace.times > begin) & (trace.times < end))
    held: dict[str, Array] = {}
    first: dict[str, float] = {}
    wanted = np.zeros(rows.size, dtype=bool)
    for signal in present:
        # Each reading until the next one, NaN before the first: `last` is the latest row that was read, -1 before.
        values = trace.signals[signal]
        last = np.maximum.accumulate(np.where(np.isnan(values), -1, np.arange(values.size)))
        column = np.where(last < 0, np.nan, values[last])
        before = int(np.searchsorted(trace.times, begin, side="right")) - 1
        now = column[before] if before >= 0 else np.nan
        if not np.isnan(now):
            first[signal] = float(now)
        later = column[rows]
        previous = np.concatenate([[now], later[:-1]])[: rows.size]
        wanted |= ~np.isnan(later) & (later != previous)
        held[signal] = later
    times = np.round(trace.times[rows] - begin, TIME_DIGITS)
    return InputReadings(times[wanted], {signal: column[wanted] for signal, column in held.items()}, first)
