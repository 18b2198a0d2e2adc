"""Five masses of a bearing and its frame as a network of capacities and conductances, integrated at 1 s.

Friction heat (a torque that follows the load, and a viscous one that falls as the grease warms: Palmgren 1959, Harris &
Kotzalas 2006, ch. 10) is made in the rollers and their grease; inner ring and shaft store a part of it, outer ring and
housing pass it on to the hall, whose air takes more from a drum that runs than from one at rest. The sensor sits in
the housing near the seat. What is hidden in a case is an `Addition`, by physics and not by the tool's formulas.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from benchmarks.discrepancy.network.duty import Duty, smoothed, wandering
from benchmarks.discrepancy.operation import Array

CAPACITY = {"shaft": 2000.0, "inner": 1500.0, "rollers": 900.0, "outer": 1500.0, "housing": 35000.0}
"""J/K."""
CONTACT = {"shaft-inner": 260.0, "inner-rollers": 320.0, "rollers-outer": 380.0, "outer-housing": 520.0}
"""W/K: interference fits and greased rolling contacts."""
SEAT = 0.3
"""The sensor's tip lies near the outer ring's seat: so much of its reading is the ring's, the rest the housing's."""
THINNING = 0.02
"""1/K: the viscous torque goes with (kinematic viscosity)^(2/3), and that with the temperature."""
STEFAN = 5.67e-8
KELVIN = 273.15


@dataclass(frozen=True, slots=True, kw_only=True)
class Plant:
    """Constants of one machine: `idle` (W) and `slope` (W/A) of the load's friction, `viscous` (W at 40 degC),
    `resting` and `running` losses (W/K) to a hall of `hall` degC; an inrush leaves `inrush` (J) in the bearing.

    Disturbances: `rough` (share of the heat, with a `memory` in s), `scatter` (share, from start to start).
    """

    idle: float
    slope: float
    viscous: float
    resting: float
    running: float
    hall: float
    inrush: float
    rough: float
    memory: float
    scatter: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Addition:
    """What acts besides; 0 is "not there", and additions add up.

    `heat` (W), `cooling` (W/K) towards `sink` (degC), `hall` (degC beside the plant's own); `frame` (W/K) to a frame
    of `frame_capacity` (J/K); `radiating` (m2) with natural convection beside it; `fan` (W/K) that opens at `opens` and
    closes at `closes` (degC). On the sensor: `lag` (s), `shifted` (degC).
    """

    heat: Array | float = 0.0
    cooling: Array | float = 0.0
    sink: Array | float = 0.0
    hall: Array | float = 0.0
    frame: float = 0.0
    frame_capacity: float = 0.0
    radiating: float = 0.0
    fan: float = 0.0
    opens: float = 0.0
    closes: float = 0.0
    lag: float = 0.0
    shift: Array | float = 0.0


def added(additions: Sequence[Addition]) -> Addition:
    """Their sum; two of them must not have the same kind of hidden state."""
    return Addition(**{one.name: sum(getattr(each, one.name) for each in additions) for one in fields(Addition)})


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkRun:
    """One run: a duty on a plant with an addition, and the `unrest` (n,) W that nobody knows."""

    duty: Duty
    plant: Plant
    addition: Addition
    unrest: Array


def unrest_of(rng: np.random.Generator, duty: Duty, plant: Plant) -> Array:
    """(n,) W: heat with a memory, and a scatter from start to start, as shares of the mean heat."""
    mean = plant.idle + plant.slope * 200.0
    per_start = plant.scatter * rng.standard_normal(len(duty.starts) + 1)
    number = np.searchsorted(duty.starts, np.arange(duty.running.size), side="right")
    share = wandering(rng, duty.running.size, plant.memory, plant.rough) + per_start[number]
    return np.asarray(duty.running * mean * share)


def courses(runs: Sequence[NetworkRun]) -> list[Array]:
    """What an ideal sensor reads in each run (n,) degC; all of one length, integrated side by side (Euler, 1 s).

    The fastest mass has a time constant of 1.3 s, and all that is looked at lasts tens of seconds.
    """
    heat, loss, hall, pull = (np.stack(each, axis=1) for each in zip(*map(_drives, runs), strict=True))
    seconds, count = heat.shape

    def constant(name: str) -> Array:
        return np.array([getattr(run.addition, name) for run in runs])

    viscous = np.array([run.plant.viscous for run in runs])
    turning = np.stack([run.duty.running for run in runs], axis=1).astype(np.float32)
    frame, radiating, fan = constant("frame"), constant("radiating"), constant("fan")
    opens, closes = constant("opens"), constant("closes")
    frame_pace = np.divide(frame, constant("frame_capacity"), out=np.zeros(count), where=frame > 0)
    radiates, framed, fanned = bool(radiating.any()), bool(frame.any()), bool(fan.any())
    # All masses are one matrix, so that a second costs a dozen calls whatever the number of runs.
    masses, passed = np.tile([run.plant.hall for run in runs], (len(CAPACITY), 1)), _passed_on()
    rollers, housing = list(CAPACITY).index("rollers"), list(CAPACITY).index("housing")
    seat = np.zeros(len(CAPACITY))
    seat[list(CAPACITY).index("outer")], seat[housing] = SEAT, 1.0 - SEAT
    foot, blowing = masses[housing].copy(), np.zeros(count)
    out = np.empty((seconds, count), dtype=np.float32)
    for row in range(seconds):
        out[row] = seat @ masses
        warmest, wall = masses[rollers], masses[housing]
        friction = heat[row] + turning[row] * (viscous * np.exp(-THINNING * (warmest - 40.0)))
        # `pull` holds conductance times sink of all coolings; the hall's part stands by itself for the radiation.
        away = loss[row] * wall - pull[row]
        if radiates:
            warm, cold = wall + KELVIN, hall[row] + KELVIN
            above = np.maximum(wall - hall[row], 0.0)
            away = away + radiating * (0.9 * STEFAN * (warm**4 - cold**4) + 1.4 * above**1.25)
        if fanned:
            blowing = np.where(wall > opens, 1.0, np.where(wall < closes, 0.0, blowing))
            away = away + fan * blowing * (wall - hall[row])
        if framed:
            to_frame = frame * (wall - foot)
            foot = foot + frame_pace * (wall - foot) - 0.1 * frame_pace * (foot - hall[row])
            away = away + to_frame
        masses = passed @ masses
        masses[rollers] += friction / CAPACITY["rollers"]
        masses[housing] -= away / CAPACITY["housing"]
    return [_sensed(out[:, number].astype(float), run.addition) for number, run in enumerate(runs)]


def _passed_on() -> Array:
    """(masses, masses): what the masses pass on to each other in a second, as in `CAPACITY`'s order."""
    names = list(CAPACITY)
    passed = np.eye(len(names))
    for contact, conductance in CONTACT.items():
        one, other = contact.split("-")
        for here, there in ((one, other), (other, one)):
            passed[names.index(here), names.index(there)] += conductance / CAPACITY[here]
            passed[names.index(here), names.index(here)] -= conductance / CAPACITY[here]
    return passed


def _drives(run: NetworkRun) -> tuple[Array, Array, Array, Array]:
    """(friction heat without its viscous part W, loss W/K, hall degC, loss times sink W) by second, in single
    precision."""
    duty, plant, addition = run.duty, run.plant, run.addition
    inrush = np.zeros(duty.running.size)
    for start in duty.starts:
        inrush[start : start + 10] = plant.inrush / 10.0
    heat = duty.running * plant.idle + plant.slope * duty.load + inrush + run.unrest + addition.heat
    loss = np.where(duty.running > 0, plant.running, plant.resting)
    hall = plant.hall + addition.hall + np.zeros(duty.running.size)
    pull = loss * hall + addition.cooling * addition.sink
    columns = heat, loss + addition.cooling, hall, pull
    first, second, third, fourth = (np.asarray(column, dtype=np.float32) for column in columns)
    return first, second, third, fourth


def _sensed(seat: Array, addition: Addition) -> Array:
    """Through a well of two unequal lags, then the shift."""
    if addition.lag > 0:
        seat = smoothed(smoothed(seat, 0.65 * addition.lag), 0.35 * addition.lag)
    return seat + addition.shift
