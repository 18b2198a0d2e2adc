"""The replay of a word under effects: the mean course of the simulator, with each stay's own m and signals.

A word says what is felt and when, so that a dead time plays no part. A signal that a stay does not name is as the stay
before had it; one that was never named counts as not read, and adds nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf, nan

import numpy as np

from sim.effects.kinds import sensor_offset, sensor_offsets, signals_of
from sim.engine.course import DrawnMoments, mean_course, start_state
from sim.engine.cuts import longest
from sim.engine.moments import stay_draws
from sim.engine.plant import compile_plant
from sim.engine.schedule import Schedule, schedule
from sim.sha.automaton import SHA, Location
from sim.sha.entry import drawn_temperature
from sim.sha.trace import Array, Event, Trace

POINTS = 32
"""Looks into each stay: with effects its highest temperature need not be at an end."""
MOST_SEGMENTS = 200_000
"""Pieces of a word's course at most, where a thermostat or radiation asks for short ones."""


@dataclass(frozen=True, slots=True)
class Given:
    """One stay as a word has it: `time` (s since the start), location, m, X where it is drawn anew (NaN), signals."""

    time: float
    symbol: str
    location: Location
    m: float
    temperature: float
    inputs: dict[str, float]


@dataclass(frozen=True, slots=True)
class Passed:
    """What the sensor reads in one stay (degC): on entering and leaving, least and most in between, with clamps."""

    entered: float
    left: float
    least: float
    most: float
    clamped: float


def passed(sha: SHA, stays: Sequence[Given], end: float, x: float, clock: float) -> list[Passed]:
    """The stays from the reading `x` (degC) to `end` (s since the start, which is at `clock`, absolute s).

    `sha` has effects besides a dead time. Raises ValueError for a word that is too long to be followed.
    """
    ends = [*(stay.time for stay in stays[1:]), end]
    _check_length(sha, stays, ends)
    steps = _steps(sha, stays, ends, clock)
    free, held = (_readings(steps, stays, x, checked=checked) for checked in (False, True))
    found, before = [], x
    for number, stay in enumerate(stays):
        rows = steps.stay == number
        fresh = drawn_temperature(stay.location) is not None and number > 0 and compile_plant(sha).lags == 0
        entered = stay.temperature + sensor_offset(sha, clock + stay.time) if fresh else before
        inside = free[rows] if rows.any() else np.array([entered])
        left = float(inside[-1])
        clamped = float(held[rows][-1]) if rows.any() else entered
        found.append(Passed(entered, left, float(inside.min()), float(inside.max()), clamped))
        before = left
    return found


def felt_at_once(sha: SHA) -> SHA:
    """The automaton without its dead time."""
    return replace(sha, effects=tuple(effect for effect in sha.effects if effect.kind != "dead-time"))


def _check_length(sha: SHA, stays: Sequence[Given], ends: Sequence[float]) -> None:
    part = dict(zip((place.name for place in sha.locations), longest(compile_plant(sha)).tolist(), strict=True))
    pieces = sum((until - stay.time) / part[stay.location.name] for stay, until in zip(stays, ends, strict=True))
    if pieces > MOST_SEGMENTS:
        raise ValueError(
            f"the word lasts {ends[-1]:.6g} s, which are {pieces:.3g} pieces of a course with thermostat or radiation; "
            f"{MOST_SEGMENTS} can be followed, so give a shorter one"
        )


def _steps(sha: SHA, stays: Sequence[Given], ends: Sequence[float], clock: float) -> Schedule:
    events = [Event(clock + stay.time, stay.symbol) for stay in stays[1:]]
    looks = [np.linspace(stay.time, until, POINTS + 1) for stay, until in zip(stays, ends, strict=True)]
    outputs = np.unique(np.concatenate([*looks, [ends[-1]]])) + clock
    names = {one.signal for place in sha.locations for one in place.flow.inputs} | set(signals_of(sha))
    times = np.array([clock + stay.time for stay in stays])
    signals = {name: np.array([stay.inputs.get(name, nan) for stay in stays]) for name in names}
    return schedule(sha, events, outputs, start=clock, inputs=Trace("word", times, signals), policy="resync")


def _readings(steps: Schedule, stays: Sequence[Given], x: float, *, checked: bool) -> Array:
    """(n,) what the sensor reads after each step."""
    plant = compile_plant(steps.sha)
    if steps.segments is None:
        raise ValueError(f"SHA {steps.sha.name!r} has no effects to follow")
    drawn: DrawnMoments = stay_draws(steps)
    mode = np.array([stay.m for stay in stays])[steps.stay]
    fresh = np.nan_to_num(np.array([stay.temperature for stay in stays]))[steps.stay]
    drawn = replace(drawn, mode=mode, fresh=fresh, checked=steps.checked & checked)
    start = start_state(plant, x, sensor_offset(steps.sha, steps.start))
    course = mean_course(plant, steps.segments, drawn, start)
    return np.asarray(course.s[:, plant.sensed] + sensor_offsets(steps.sha, steps.segments.time + steps.dt))


def offset_range(sha: SHA) -> tuple[float, float]:
    """The least and the greatest that the sensor ever reads too much (degC)."""
    times = np.array([-inf, *(one.params["at"] for one in sha.effects if one.kind == "sensor-offset-step")])
    values = sensor_offsets(sha, times)
    return float(values.min()), float(values.max())
