"""The Kalman filter on all states of an automaton with effects and on m; extended where the automaton is not linear.

Radiation is linearised about the mean, the thermostat is where the mean's is. A dead time holds events and readings
back in a queue until they are felt, so that sample by sample the filter does what a schedule does for a whole trace.
"""

from collections.abc import Mapping
from dataclasses import replace
from math import inf, isfinite, log, pi

import numpy as np

from sim.effects.kinds import dead_time, sensor_offset, signals_of
from sim.engine.belief_state import Belief, Hidden, Innovation, Pending
from sim.engine.course import Course, Drawn, mean_course
from sim.engine.cuts import Stays, cuts
from sim.engine.plant import Plant
from sim.engine.tables import chosen
from sim.engine.terms import Segments
from sim.engine.tracker import Tracker, next_location
from sim.sha.trace import Array, Event


def begun(plant: Plant, belief: Belief) -> Belief:
    """The belief with all states at what its temperature tells, as uncertain as that, and m on its own."""
    d = plant.size
    mean = np.full(d + 1, belief.x - sensor_offset(plant.sha, belief.time))
    covariance = np.full((d + 1, d + 1), belief.xx)
    mean[d], covariance[d, :], covariance[:, d] = belief.m, 0.0, 0.0
    covariance[d, d] = belief.mm
    last = belief.hidden or Hidden((), (), since=(None,) * len(plant.startups))
    return _told(plant, belief, mean, covariance, last)


def restarted(plant: Plant, before: Belief, begun: Belief) -> Belief:
    """`begun`, which has the new temperature, with the states of `before` moved along, all but the housing's."""
    mean, covariance = _arrays(before)
    moved = np.ones(plant.size + 1, dtype=np.bool_)
    moved[plant.size] = False
    if plant.housing_tau < inf:
        moved[1] = False
    mean[moved] += begun.x - before.x
    covariance[moved, :] = 0.0
    covariance[:, moved] = 0.0
    covariance[np.ix_(moved, moved)] = begun.xx
    return _told(plant, begun, mean, covariance, before.hidden or Hidden((), ()))


def _arrays(belief: Belief) -> tuple[Array, Array]:
    if belief.hidden is None:
        raise ValueError("the belief was begun with a model that has no effects; start it with this one")
    return np.array(belief.hidden.mean), np.array(belief.hidden.covariance)


def _told(plant: Plant, belief: Belief, mean: Array, covariance: Array, hidden: Hidden) -> Belief:
    """The belief with these states; its temperature is what the sensor would read."""
    d, read = plant.size, plant.sensed
    states = replace(hidden, mean=tuple(mean.tolist()), covariance=tuple(tuple(row) for row in covariance.tolist()))
    return replace(
        belief,
        x=float(mean[read]) + sensor_offset(plant.sha, belief.time),
        m=float(mean[d]),
        xx=max(float(covariance[read, read]), 0.0),
        xm=float(covariance[read, d]),
        mm=max(float(covariance[d, d]), 0.0),
        hidden=states,
    )


def advance(tracker: Tracker, plant: Plant, belief: Belief, time: float) -> Belief:
    """The belief at a later time; what is felt in between is felt when it is due."""
    while belief.hidden is not None and belief.hidden.pending and belief.hidden.pending[0].due <= time:
        first, *rest = belief.hidden.pending
        moved = _flow(plant, belief, max(first.due, belief.time))
        moved = replace(moved, hidden=replace(moved.hidden or belief.hidden, pending=tuple(rest)))
        belief = _entered(tracker, plant, moved, first.symbol) if first.symbol else _held(tracker, moved, first.signals)
    return _flow(plant, belief, time)


def _flow(plant: Plant, belief: Belief, time: float) -> Belief:
    """The belief at `time` with nothing new in between."""
    if time == belief.time:
        return belief
    mean, covariance = _arrays(belief)
    d = plant.size
    course = _course(plant, belief, time, mean)
    half = chosen(course.steps, course.opened)
    for row in range(course.opened.size):
        step = np.eye(d + 1)
        step[:d, :d], step[:d, d] = half.phi[row], half.pull[row]
        covariance = step @ covariance @ step.T
        covariance[:d, :d] += half.noise[row]
    mean[:d] = course.s[-1]
    moved = replace(belief, time=time, clamps=belief.clamps + course.clamps)
    hidden = replace(belief.hidden or Hidden((), ()), opened=course.valve)
    return _told(plant, moved, mean, (covariance + covariance.T) / 2.0, hidden)


def _course(plant: Plant, belief: Belief, time: float, mean: Array) -> Course:
    hidden = belief.hidden or Hidden((), ())
    place = next(row for row, each in enumerate(plant.sha.locations) if each.name == belief.location)
    starts = tuple(np.array([] if since is None else [since]) for since in hidden.since)
    begin, end, entered = (np.array([at]) for at in (belief.time, time, belief.entered))
    stays = Stays(begin, end, entered, np.array([place]), starts)
    marks = np.unique(np.concatenate([[belief.time, time], cuts(plant, stays)]))
    begin = marks[:-1]
    n = begin.size
    signals = {name: np.full(n, belief.signals.get(name, np.nan)) for name in signals_of(plant.sha)}
    segments = Segments(
        location=np.full(n, place),
        time=begin,
        age=begin - belief.entered,
        dt=np.diff(marks),
        offset=np.full(n, belief.offset),
        signals=signals,
        since=tuple(begin - (-inf if since is None else since) for since in hidden.since),
    )
    nothing, never = np.zeros(n), np.zeros(n, dtype=np.bool_)
    last = never.copy()
    last[-1] = True
    drawn = Drawn(np.full(n, mean[-1]), nothing, never, nothing, nothing, never, last)
    return mean_course(plant, segments, drawn, mean[:-1], valve=hidden.opened)


def observe(tracker: Tracker, plant: Plant, belief: Belief, time: float, temperature: float) -> Belief:
    """The belief after a reading at a time that is not before its own."""
    moved = advance(tracker, plant, belief, time)
    mean, covariance = _arrays(moved)
    variance = moved.xx + tracker.sensor
    value = temperature - moved.x
    square = value * value / variance
    shared = covariance[:, plant.sensed].copy()
    covariance -= np.outer(shared, shared) / variance
    recent = (*moved.recent, square)
    seen = replace(
        moved,
        last=Innovation(value, variance, square),
        recent=recent[-tracker.window :],
        evidence=moved.evidence - 0.5 * (log(2.0 * pi * variance) + square),
        samples=moved.samples + 1,
    )
    return _told(plant, seen, mean + shared / variance * value, covariance, moved.hidden or Hidden((), ()))


def on_event(tracker: Tracker, plant: Plant, belief: Belief, event: Event) -> Belief:
    """The belief after an event, which has been advanced to it unless it is late; a dead time holds it back."""
    delay = dead_time(plant.sha)
    if not delay:
        return _entered(tracker, plant, belief, event.symbol)
    time = event.time if isfinite(event.time) else belief.time
    return _waiting(belief, Pending(max(time + delay, belief.time), event.symbol))


def _waiting(belief: Belief, one: Pending) -> Belief:
    """At one instant events are felt before signals, as along a schedule."""
    hidden = belief.hidden or Hidden((), ())
    pending = sorted((*hidden.pending, one), key=lambda each: (each.due, not each.symbol))
    return replace(belief, hidden=replace(hidden, pending=tuple(pending)))


def _entered(tracker: Tracker, plant: Plant, belief: Belief, symbol: str) -> Belief:
    """The belief after an event that is felt at its time."""
    hidden = belief.hidden or Hidden((), ())
    own = [acting.effect.event for acting in plant.startups]
    since = tuple(belief.time if name == symbol else last for name, last in zip(own, hidden.since, strict=True))
    hidden = replace(hidden, since=since)
    location, matched = next_location(tracker, belief.location, symbol)
    belief = replace(belief, unmatched=belief.unmatched + (not matched), hidden=hidden)
    if location is None:
        return belief
    mode, d = tracker.modes[location], plant.size
    mean, covariance = _arrays(belief)
    drawn = {d: mode.parameter} | ({} if mode.temperature is None else {0: mode.temperature})
    for place, (value, variance) in drawn.items():
        mean[place], covariance[place, :], covariance[:, place] = value, 0.0, 0.0
        covariance[place, place] = variance
    entered = replace(belief, location=location, entered=belief.time, offset=mode.offset(belief.signals))
    return _told(plant, entered, mean, covariance, hidden)


def with_inputs(tracker: Tracker, plant: Plant, belief: Belief, time: float, signals: Mapping[str, float]) -> Belief:
    """The belief with new values of signals, from now on or after the dead time."""
    known = dict(belief.signals)
    for one in belief.hidden.pending if belief.hidden is not None else ():
        known |= one.signals
    news = {name: signals[name] for name in tracker.inputs & signals.keys() if isfinite(signals[name])}
    news = {name: value for name, value in news.items() if known.get(name) != value}
    if not news:
        return belief
    delay = dead_time(plant.sha)
    if not delay:
        return _held(tracker, belief, news)
    first = time if isfinite(time) else belief.time
    return _waiting(belief, Pending(max(first + delay, belief.time), "", news))


def _held(tracker: Tracker, belief: Belief, news: Mapping[str, float]) -> Belief:
    held = {**belief.signals, **news}
    return replace(belief, signals=held, offset=tracker.modes[belief.location].offset(held))
