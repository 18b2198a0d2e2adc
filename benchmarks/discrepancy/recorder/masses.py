"""The recorder's plant: race, housing, a foot where one is hidden, and the sensor's own mass.

Each mass relaxes exactly, for one step, towards the mean of what touches it, weighted by conductance and held for the
step (sequential exponential splitting): never unstable, and exact wherever nothing changes. All is in units of the
housing's heat capacity: conductances in 1/s, heats in K/s.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from benchmarks.discrepancy.operation import Array
from benchmarks.discrepancy.recorder.work import STEP, Work, follow, roam

RACE = 0.03
"""The race's heat capacity as a share of the housing's."""
AT_REST = 0.25
"""How much of the restless heat there is at rest (draughts, doors), as a share of that while running."""
ZERO = 273.15
"""K at 0 degC."""
RADIANT_SCALE = 1.0 / (4.0 * 300.0**3)
"""1/K^3: makes radiation at 300 K a conductance of its own coefficient."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Machine:
    """One machine of a type: losses (1/s) at rest and running to a hall (degC), `heats` (K above the hall at which
    the machine settles) of the four bins, `slope` (K/A) where the heat follows the load, the race's and the sensor's
    time constants (s), and how restless the heat is: `rough` and `scatter` as shares, `memory` in s."""

    resting: float
    running: float
    hall: float
    heats: tuple[float, float, float, float]
    slope: float
    race: float
    sensor: float
    rough: float
    memory: float
    scatter: float

    @property
    def usual(self) -> float:
        """K above the hall at the middle of the second and third bin."""
        return float(np.mean(self.heats[1:3])) + 200.0 * self.slope


@dataclass(frozen=True, slots=True, kw_only=True)
class Guest:
    """What acts besides; 0 is "not there". `heat` (K/s), `cooling` (1/s) towards `sink` (degC), `hall` (degC more);
    `foot` (1/s) to a foot of memory `foot_memory` (s); `radiant` (1/s at 300 K); `valve` (1/s) between `opens` and
    `closes` (degC) with a `stroke` (s); the whole heat `late` (s), the load's own heat `winding` (s) late, the
    sensor's `lag` (s) and its `shift` (degC)."""

    heat: Array | float = 0.0
    cooling: Array | float = 0.0
    sink: Array | float = 0.0
    hall: Array | float = 0.0
    foot: float = 0.0
    foot_memory: float = 0.0
    radiant: float = 0.0
    valve: float = 0.0
    opens: float = 0.0
    closes: float = 0.0
    stroke: float = 0.0
    late: float = 0.0
    winding: float = 0.0
    lag: float = 0.0
    shift: Array | float = 0.0


def join(guests: Sequence[Guest]) -> Guest:
    """All of them at once. `sink`s are weighted by their cooling; no two may have a foot or a valve."""
    total = {one.name: sum(getattr(guest, one.name) for guest in guests) for one in fields(Guest)}
    cooling = np.asarray(total["cooling"])
    drawn = sum(np.asarray(guest.cooling) * guest.sink for guest in guests)
    total["sink"] = np.divide(drawn, cooling, out=np.zeros(np.shape(drawn)), where=cooling != 0)
    return Guest(**total)


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """One run to integrate: `unrest` (n,) is the heat (K/s) that nobody knows."""

    work: Work
    machine: Machine
    guest: Guest
    unrest: Array


def drive_heat(work: Work, machine: Machine, winding: float = 0.0) -> Array:
    """(n,) K/s that the drive makes; the share that follows the load comes `winding` seconds late (two equal lags)."""
    fixed = np.asarray((0.0, *machine.heats))[work.stage]
    load = work.load
    if winding > 0:
        load = follow(follow(load, 0.5 * winding), 0.5 * winding)
    return machine.running * (fixed + machine.slope * load)


def unrest_of(rng: np.random.Generator, work: Work, machine: Machine) -> Array:
    """(n,) K/s: heat that wanders, and a scatter from cycle to cycle."""
    level = machine.running * machine.usual
    each = machine.scatter * rng.standard_normal(len(work.starts) + 1)
    wandering = roam(rng, work.running.size, machine.memory, machine.rough)
    return np.asarray(level * (stir(work.running) * wandering + work.running * each[work.cycle]))


def stir(running: Array) -> Array:
    """(n,) how much of the restless heat acts: all of it while running, some at rest."""
    return AT_REST + (1.0 - AT_REST) * running


def integrate(tasks: Sequence[Task]) -> list[Array]:
    """What an ideal recorder reads in each task (n,) degC; tasks of one length, side by side."""
    columns = [_drives(task) for task in tasks]
    heat, loss, cooling, draw, halls = (np.stack(each, axis=1) for each in zip(*columns, strict=True))
    guests = [task.guest for task in tasks]

    def constant(name: str) -> Array:
        return np.array([getattr(guest, name) for guest in guests])

    race = np.array([task.machine.race for task in tasks])
    sensor = np.array([task.machine.sensor for task in tasks])
    foot, radiant, valve = constant("foot"), constant("radiant"), constant("valve")
    opens, closes = constant("opens"), constant("closes")
    stroke = STEP / np.maximum(constant("stroke"), STEP)
    link = RACE / race
    race_keep, sensor_keep = np.exp(-STEP / race), np.exp(-STEP / sensor)
    foot_keep = np.where(foot > 0, np.exp(-STEP / np.maximum(constant("foot_memory"), STEP)), 1.0)
    has_foot, has_radiant, has_valve = bool(foot.any()), bool(radiant.any()), bool(valve.any())
    hot = wall = base = bulb = np.array([task.machine.hall for task in tasks])
    asked = opened = np.zeros(len(tasks))
    out = np.empty((heat.shape[0], len(tasks)), dtype=np.float64)
    for row in range(heat.shape[0]):
        out[row] = bulb
        settled = wall + heat[row] / link
        hot = settled + (hot - settled) * race_keep
        away = link + loss[row] + cooling[row]
        pull = link * hot + draw[row]
        hall = halls[row]
        if has_valve:
            asked = np.where(wall > opens, 1.0, np.where(wall < closes, 0.0, asked))
            opened = opened + np.clip(asked - opened, -stroke, stroke)
            away, pull = away + valve * opened, pull + valve * opened * hall
        if has_radiant:
            warm, cold = wall + ZERO, hall + ZERO
            emits = radiant * RADIANT_SCALE * (warm**2 + cold**2) * (warm + cold)
            away, pull = away + emits, pull + emits * hall
        if has_foot:
            away, pull = away + foot, pull + foot * base
            base = wall + (base - wall) * foot_keep
        settled = pull / away
        wall = settled + (wall - settled) * np.exp(-STEP * away)
        bulb = wall + (bulb - wall) * sensor_keep
    return [_read(out[:, number].copy(), guest) for number, guest in enumerate(guests)]


def _drives(task: Task) -> tuple[Array, Array, Array, Array, Array]:
    """(heat K/s, loss 1/s, cooling 1/s, what both draw towards K/s, hall degC) by row."""
    work, machine, guest = task.work, task.machine, task.guest
    heat = drive_heat(work, machine, guest.winding)
    if guest.late > 0:
        heat = _spread_late(heat, guest.late)
    loss = np.where(work.running > 0, machine.running, machine.resting)
    zero = np.zeros(work.running.size)
    hall = machine.hall + guest.hall + zero
    draw = loss * hall + guest.cooling * guest.sink
    return heat + guest.heat + task.unrest, loss, guest.cooling + zero, draw, hall


def _spread_late(column: Array, mean: float) -> Array:
    """(n,) the column felt between half and one and a half times `mean` seconds later, evenly (a plug that mixes)."""
    total = np.concatenate([[0.0], np.cumsum(column) * STEP])
    grid = STEP * np.arange(total.size)
    ends = grid[1:]
    early = np.interp(ends - 0.5 * mean, grid, total, left=0.0)
    late = np.interp(ends - 1.5 * mean, grid, total, left=0.0)
    return np.asarray((early - late) / mean)


def _read(bulb: Array, guest: Guest) -> Array:
    """Through a pocket of paste that lags (seven tenths and three tenths), then the shift."""
    if guest.lag > 0:
        bulb = follow(follow(bulb, 0.7 * guest.lag), 0.3 * guest.lag)
    return bulb + guest.shift


def move(machine: Machine, rng: np.random.Generator, by: float) -> Machine:
    """A sister: each of its constants off by up to `by` as a share, the hall by half a degree at most."""
    share = 1.0 + rng.uniform(-by, by, 7)
    heats = machine.heats
    if machine.slope:  # the law of the load stays one straight line
        moved = tuple(heat * share[0] for heat in heats)
    else:
        moved = tuple(heat * each for heat, each in zip(heats, share[:4], strict=True))
    return replace(
        machine,
        heats=(moved[0], moved[1], moved[2], moved[3]),
        slope=machine.slope * share[4],
        resting=machine.resting * share[5],
        running=machine.running * share[6],
        hall=machine.hall + 0.5 * rng.uniform(-1.0, 1.0),
    )
