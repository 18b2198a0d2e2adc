"""The benchmark's plant: heat balances of a bearing, integrated by Heun's method for many cases at once.

The bearing gains the drive's heat and loses heat to a hall that is kept at one temperature; both depend on the drive's
stage (`Bearing`). What acts besides is given as `Parts`: heats, losses and hidden states with forms of their own. The
plant without parts is one that the model under test can express, or else no case would be clean.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from scipy.signal import cont2discrete, lfilter

from benchmarks.discrepancy.operation import OFF, Array, Operation, wander

SUBSTEPS = 2
CELLS = 3
KELVIN = 273.15


@dataclass(frozen=True, slots=True)
class Bearing:
    """Constants of one bearing: `hall` (degC), heat of each stage (degC/s), loss rate (1/s) at rest and running.

    `slope` (degC/s per A): heat that follows the current inside the stages; then the stages' heats continue each other.
    """

    hall: float
    heat: tuple[float, ...]
    loss_rest: float
    loss_running: float
    slope: float = 0.0


@dataclass(frozen=True, slots=True)
class Roughness:
    """Disturbances: heat with memory, `coloured` (share of the running heat) and `memory` (s); `scatter` (share of the
    running heat) from start to start; the sensor's `noise` and `quantum` (degC)."""

    coloured: float
    memory: float
    scatter: float
    noise: float
    quantum: float

    @property
    def sensor(self) -> float:
        """Standard deviation of one reading (degC), rounding included."""
        return float(np.hypot(self.noise, self.quantum / np.sqrt(12)))


@dataclass(frozen=True, slots=True)
class Parts:
    """What acts on the bearing besides its own balance; the zero of every field is "not there". Parts add up.

    `heat` (degC/s), `rate` (1/s) and `pull` (degC/s, rate times sink) by row or constant; `thinned` is heat that falls
    with the bearing's warmth. `radiant` (1/s) and `convective` (1/s): losses that grow faster than linearly. `valve`
    (1/s) with `opens`, `closes`, `stroke` (s), `bath` (degC). `ladder` (1/s), `ladder_memory` (s): a housing of cells.
    `neighbour` (1/s): conduction from the second bearing, whose own heat varies by `neighbour_heat` (degC/s).
    `delay` (s): transport of the drive's heat. `lag` (s), `step` (degC): what the sensor makes of it.
    """

    heat: Array | float = 0.0
    rate: Array | float = 0.0
    pull: Array | float = 0.0
    thinned: Array | float = 0.0
    radiant: float = 0.0
    convective: float = 0.0
    valve: float = 0.0
    opens: float = 0.0
    closes: float = 0.0
    stroke: float = 0.0
    bath: float = 0.0
    ladder: float = 0.0
    ladder_memory: float = 0.0
    neighbour: float = 0.0
    neighbour_heat: Array | float = 0.0
    delay: float = 0.0
    lag: float = 0.0
    step: Array | float = 0.0


def together(parts: list[Parts]) -> Parts:
    """The sum of parts; each kind that is no plain heat or loss must come once."""
    return Parts(*(sum(getattr(one, field.name) for one in parts) for field in fields(Parts)))


def disturbance(rng: np.random.Generator, operation: Operation, bearing: Bearing, rough: Roughness) -> Array:
    """(n,) degC/s: heat with memory while running, and the scatter from start to start."""
    n, period = operation.times.size, operation.period
    nominal = float(np.mean(bearing.heat[1:]))
    coloured = wander(rng, n, period, rough.memory, rough.coloured * nominal)
    number = np.zeros(n, dtype=np.intp)
    number[list(operation.starts)] = 1
    scatter = rough.scatter * rng.normal(size=len(operation.starts) + 1)
    own = np.asarray(bearing.heat)[operation.stage]
    return np.asarray(operation.running * (coloured + scatter[np.cumsum(number)] * own))


@dataclass(frozen=True, slots=True)
class Course:
    """Temperatures of one run (n,), before noise and rounding: the bearing itself, its sensor, the second bearing."""

    bearing: Array
    sensor: Array
    second: Array


Case = tuple[Operation, Bearing, Array, Parts]
"""What one run needs: operation, bearing, disturbance and parts."""


def run(cases: Sequence[Case]) -> list[Course]:
    """Every case integrated side by side with those that have the same kinds of hidden state; all share one clock.

    Plain heats and losses take exact steps, the others `SUBSTEPS` steps of Heun's method a row; the fastest hidden
    state has a time constant of 60 s or more.
    """
    groups: dict[tuple[bool, ...], list[int]] = {}
    for number, (*_, parts) in enumerate(cases):
        groups.setdefault(_special(parts), []).append(number)
    found: dict[int, Course] = {}
    for special, numbers in groups.items():
        courses = _side_by_side([cases[number] for number in numbers], any(special))
        found.update(zip(numbers, courses, strict=True))
    return [found[number] for number in range(len(cases))]


def _special(parts: Parts) -> tuple[bool, ...]:
    """Which kinds of nonlinear or hidden state a case has."""
    radiates = parts.radiant > 0 or parts.convective > 0
    return bool(np.any(parts.thinned)), radiates, parts.valve > 0, parts.ladder > 0, parts.neighbour > 0


def _side_by_side(cases: Sequence[Case], special: bool) -> list[Course]:
    drives = [_drive(operation, bearing, noise, parts) for operation, bearing, noise, parts in cases]
    drive = {name: np.stack([one[name] for one in drives], axis=1) for name in drives[0]}
    period = cases[0][0].period
    start = np.array([bearing.hall for _, bearing, *_ in cases])
    if special:
        constants = {name: np.array([getattr(parts, name) for *_, parts in cases]) for name in _CONSTANTS}
        first, second = _integrate(drive, constants, start, period)
    else:
        first = _exact(drive["heat"] + drive["pull"], drive["rate"], start, period)
        second = _exact(drive["second_heat"], drive["second_rate"], start, period)
    return [
        Course(first[:, case], _sensed(first[:, case], parts, period), second[:, case])
        for case, (*_, parts) in enumerate(cases)
    ]


def _exact(heat: Array, rate: Array, start: Array, period: float) -> Array:
    """(n, cases): held heats and rates, each row's step in closed form."""
    keep = np.exp(-rate * period)
    gain = (1 - keep) / rate * heat
    out, now = np.empty_like(heat), start
    for row in range(heat.shape[0]):
        out[row] = now
        now = keep[row] * now + gain[row]
    return out


_CONSTANTS = (
    *("radiant", "convective", "valve", "opens", "closes", "stroke", "bath"),
    *("ladder", "ladder_memory", "neighbour"),
)


def _drive(operation: Operation, bearing: Bearing, noise: Array, parts: Parts) -> dict[str, Array]:
    """By row: heat, loss rate and pull of the bearing with its parts, and those of the second bearing."""
    n, period, stage = operation.times.size, operation.period, operation.stage
    own = np.asarray(bearing.heat)[stage]
    middle = np.array([0.0, 50.0, 150.0, 250.0, 350.0])[stage]
    own = own + bearing.slope * operation.running * (operation.current - middle)
    rate = np.where(stage == OFF, bearing.loss_rest, bearing.loss_running)
    second = 0.8 * own + parts.neighbour_heat
    if parts.delay > 0:
        own, rate = transported(own, period, parts.delay), transported(rate, period, parts.delay)
    return {
        "heat": own + noise + parts.heat + np.zeros(n),
        "rate": rate + parts.rate + np.zeros(n),
        "pull": rate * bearing.hall + parts.pull + np.zeros(n),
        "thinned": parts.thinned + np.zeros(n),
        "second_heat": second + 0.7 * noise + 0.9 * rate * bearing.hall,
        "second_rate": 0.9 * rate,
    }


def _integrate(
    drive: dict[str, Array], constants: dict[str, Array], start: Array, period: float
) -> tuple[Array, Array]:
    """Two (n, cases): the temperatures of both bearings at the rows."""
    heat = drive["heat"] + drive["pull"]
    rate, thinned = drive["rate"], drive["thinned"]
    extra = _extra(constants, bool(np.any(thinned)))
    n, step = heat.shape[0], period / SUBSTEPS
    first, second = np.empty_like(heat), np.empty_like(heat)
    cells = CELLS if np.any(constants["ladder"]) else 0
    state = np.repeat(start[None], 2 + cells, axis=0)
    valve, open_ = np.zeros_like(start), np.zeros_like(start)
    moving = bool(np.any(constants["valve"]))
    for row in range(n):
        first[row], second[row] = state[0], state[1]
        base, slope = heat[row], rate[row]
        other, other_rate = drive["second_heat"][row], drive["second_rate"][row]
        for _ in range(SUBSTEPS):
            if moving:
                open_, valve = _stroke(constants, state[0], open_, valve, step)
            one = extra(state, valve, thinned[row])
            one[0] += base - slope * state[0]
            one[1] += other - other_rate * state[1]
            ahead = state + step * one
            two = extra(ahead, valve, thinned[row])
            two[0] += base - slope * ahead[0]
            two[1] += other - other_rate * ahead[1]
            state = state + (step / 2) * (one + two)
    return first, second


def _stroke(constants: dict[str, Array], warmth: Array, open_: Array, valve: Array, step: float) -> tuple[Array, Array]:
    """The thermostat's command with its hysteresis, and the valve that follows it at its own pace."""
    command = np.where(warmth > constants["opens"], 1.0, np.where(warmth < constants["closes"], 0.0, open_))
    pace = step / np.where(constants["stroke"] > 0, constants["stroke"], 1.0)
    return command, valve + np.clip(command - valve, -pace, pace)


def _extra(constants: dict[str, Array], thinning: bool) -> Any:
    """The drift of what is no plain heat or loss, as a function of (state, valve, thinned heat); only what is there."""
    radiant, convective, ladder = constants["radiant"], constants["convective"], constants["ladder"]
    radiates, houses = bool(np.any(radiant) or np.any(convective)), bool(np.any(ladder))
    valves, conducts = bool(np.any(constants["valve"])), bool(np.any(constants["neighbour"]))
    pace = CELLS / np.where(ladder > 0, constants["ladder_memory"], 1e4)

    def drift(state: Array, valve: Array, thinned: Array) -> Array:
        change = np.zeros_like(state)
        bearing = state[0]
        if thinning:
            change[0] += thinned * np.exp(-0.006 * (bearing - 40.0))
        if radiates:
            above = np.maximum(bearing - 17.0, 0.0)
            hot = ((bearing + KELVIN) / 293.0) ** 4 - (290.15 / 293.0) ** 4
            change[0] -= radiant * 73.0 * hot + convective * above * (above / 30.0) ** 0.25
        if valves:
            change[0] -= constants["valve"] * valve * (bearing - constants["bath"])
        if conducts:
            change[0] += constants["neighbour"] * (state[1] - bearing)
        if houses:
            change[0] += ladder * (state[2] - bearing)
            change[2:] += pace * (state[[0, 2, 3]] - state[2:])
            change[2:4] += 0.5 * pace * (state[3:] - state[2:4])
        return change

    return drift


def transported(values: Array, period: float, delay: float, order: int = 6) -> Array:
    """(n,) held values through a line of `order` mixed vessels whose mean residence is `delay` seconds (Erlang)."""
    pole = order / delay
    system = (-pole * np.eye(order) + pole * np.eye(order, k=-1), pole * np.eye(order)[:, :1])
    a, b, *_ = cont2discrete((*system, np.eye(order)[-1:], np.zeros((1, 1))), period, "zoh")
    out, state = np.empty_like(values), np.full(order, values[0])
    column = b[:, 0]
    for row, value in enumerate(values):
        out[row] = state[-1]
        state = a @ state + column * value
    return out


def _sensed(bearing: Array, parts: Parts, period: float) -> Array:
    """What an ideal recorder would get from the sensor: two unequal lags in its well, then its offset."""
    reading = bearing
    if parts.lag > 0:
        for share in (0.72, 0.28):
            reading = _ramp_lag(reading, period, share * parts.lag)
    return reading + parts.step


def _ramp_lag(values: Array, period: float, memory: float) -> Array:
    """(n,) first-order lag of values that run straight from row to row (exact)."""
    keep = float(np.exp(-period / memory))
    slope = memory * (1 - keep) / period
    b0, b1 = 1 - slope, slope - keep
    out, _ = lfilter([b0, b1], [1.0, -keep], values, zi=np.array([(1 - b0) * values[0]]))
    return np.asarray(out)


def measured(rng: np.random.Generator, temperature: Array, rough: Roughness) -> Array:
    """Noise and rounding of one reading a row."""
    noisy = temperature + rng.normal(0.0, rough.noise, temperature.size)
    return np.round(noisy / rough.quantum) * rough.quantum
