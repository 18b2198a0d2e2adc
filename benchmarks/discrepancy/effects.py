"""The 17 effects of the vocabulary as the benchmark's plant has them: forms of its own, not those of the catalogue.

Each entry makes `Parts` of the operation, a strength and a generator for the free details (shape, moment, memory). Only
the names are shared with the tool under test. Strength 1 is an effect of some degrees; `visible` scales it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from benchmarks.discrepancy.operation import Array, Operation, lagged
from benchmarks.discrepancy.plant import Parts

Maker = Callable[[Operation, float, np.random.Generator], Parts]
HEAT = 0.003
"""degC/s of an effect of strength 1: a tenth of the drive's own heat."""


@dataclass(frozen=True, slots=True)
class Kind:
    """`make` and the strengths within which the plant stays one; `base`: which kind of bearing the effect is a gap of.

    On `stages` bearings a model with one target a stage is right; on `linear` ones the heat follows the current.
    """

    make: Maker
    low: float
    high: float
    base: str = "stages"


def _age(operation: Operation, begins: tuple[int, ...] | None = None) -> Array:
    """(n,) seconds since the last start; infinite before the first."""
    rows = np.arange(operation.times.size)
    starts = np.array(operation.starts if begins is None else begins)
    last = np.searchsorted(starts, rows, side="right") - 1
    return np.where(last < 0, np.inf, operation.period * (rows - starts[np.maximum(last, 0)]))


def _dwell(on: Array, period: float) -> Array:
    """(n,) seconds since a switch went on; 0 while it is off."""
    count = np.cumsum(on)
    before = np.maximum.accumulate(np.where(on > 0, 0.0, count))
    return period * (count - before)


def current_heating(op: Operation, strength: float, rng: np.random.Generator) -> Parts:
    """Slip-ring heat that follows the current inside the stages, a little more than in proportion."""
    power = rng.uniform(0.95, 1.12)
    return Parts(heat=strength * HEAT * op.running * 2.0 * ((op.current / 200.0) ** power - 1.0))


def quadratic_current_heating(op: Operation, strength: float, rng: np.random.Generator) -> Parts:
    """Copper loss: the current squared, with a resistance that rises as the winding warms over an hour."""
    square = op.running * (op.current / 200.0) ** 2
    winding = lagged(square, op.period, rng.uniform(1500, 3000))
    return Parts(heat=strength * HEAT * op.running * (square * (1.0 + 0.04 * winding) - 1.0))


def current_saturation(op: Operation, strength: float, rng: np.random.Generator) -> Parts:
    """A coupling that slips softly: beyond a knee, heat bends away from the straight line like a hyperbolic tangent."""
    knee, width = rng.uniform(190.0, 250.0), rng.uniform(45.0, 80.0)
    over = np.maximum(op.current - knee, 0.0)
    return Parts(heat=-strength * HEAT * op.running * (over - width * np.tanh(over / width)) / 30.0)


def torque_friction(op: Operation, strength: float, rng: np.random.Generator) -> Parts:
    """Load on the bearing by the solids: torque to a power between 1.1 and 1.4."""
    power = rng.uniform(1.1, 1.4)
    return Parts(heat=strength * HEAT * op.running * 2.0 * ((op.torque / 45.0) ** power - 1.0))


def speed_friction(op: Operation, strength: float, rng: np.random.Generator) -> Parts:
    """Viscous drag of the differential speed to the 1.7th power, less in warm grease."""
    del rng
    return Parts(thinned=strength * HEAT * op.running * ((op.speed / 15.0) ** 1.7 - 1.0))


def vibration_friction(op: Operation, strength: float, rng: np.random.Generator) -> Parts:
    """Rolling elements that skid while the machine shakes, and for half a minute after."""
    shaking = lagged((op.vibration / 3.0) ** rng.uniform(1.2, 1.7), op.period, rng.uniform(15, 40))
    return Parts(heat=strength * HEAT * op.running * shaking)


def ambient_coupling(op: Operation, strength: float, rng: np.random.Generator) -> Parts:
    """The hall felt through the housing, late and with fans that run faster with the drum."""
    hall = lagged(op.hall, op.period, rng.uniform(200, 700))
    rate = strength * 2e-4 * (0.8 + 0.4 * op.running)
    return Parts(heat=rate * (hall - 17.0))


def feed_temperature_coupling(op: Operation, strength: float, rng: np.random.Generator) -> Parts:
    """Slurry in the bowl: a film that improves with the flow to the power 0.8, and a wall before the bearing."""
    wall = lagged(op.feed, op.period, rng.uniform(20, 90))
    flow = lagged((op.pump_speed / 70.0) ** 0.8, op.period, 20.0)
    rate = strength * 1.2e-4 * flow
    return Parts(rate=rate, pull=rate * wall)


def pump_cooling(op: Operation, strength: float, rng: np.random.Generator) -> Parts:
    """A cooling jacket on the pump's circuit: its film builds up while the pump runs, and it fouls over days."""
    film = 1.0 - 0.35 * np.exp(-_dwell(op.pump, op.period) / rng.uniform(60, 200))
    fouling = 1.0 / (1.0 + rng.uniform(0.0, 0.12) * op.times / op.times[-1])
    rate = strength * 1.2e-4 * op.pump * film * fouling
    return Parts(rate=rate, pull=rate * rng.uniform(16.0, 22.0))


def startup_churning(op: Operation, strength: float, rng: np.random.Generator) -> Parts:
    """Grease that is thrown out after a start: a power law or a logistic decay, more at the first start of a day."""
    age, memory = _age(op), rng.uniform(150, 500)
    power_law = (1.0 + age / memory) ** -rng.uniform(1.8, 2.6)
    logistic = 1.3 / (1.0 + 0.3 * np.exp(np.minimum(2.2 * age / memory, 50.0)))
    shape = power_law if rng.random() < 0.5 else logistic
    days = op.times[np.array(op.starts)] // 86400
    first = tuple(int(op.starts[n]) for n in np.unique(days, return_index=True)[1])
    morning = np.where(_age(op) == _age(op, first), 1.2, 1.0)
    return Parts(heat=strength * 3.0 * HEAT * op.running * morning * shape)


def wear_drift(op: Operation, strength: float, rng: np.random.Generator) -> Parts:
    """Wear by hours run, in a curve that bends a little, with small pits that come at once."""
    hours = np.cumsum(op.running) * op.period / 3600.0
    worn = (hours / hours[-1]) ** rng.uniform(0.85, 1.3)
    pits = 0.1 * np.sum([hours / hours[-1] > rng.uniform(0.1, 0.9) for _ in range(2)], axis=0)
    return Parts(heat=strength * HEAT * op.running * (worn + pits))


def dead_time(op: Operation, strength: float, rng: np.random.Generator) -> Parts:
    """The drive's heat takes its time through casing and cooler: a line of mixed vessels."""
    del op, rng
    return Parts(delay=60.0 * strength)


def sensor_lag(op: Operation, strength: float, rng: np.random.Generator) -> Parts:
    """A sensor in a deep well: two unequal lags."""
    del op, rng
    return Parts(lag=60.0 * strength)


def sensor_offset_step(op: Operation, strength: float, rng: np.random.Generator) -> Parts:
    """A sensor that was seated anew: its reading shifts within some minutes and stays shifted, up or down."""
    share, sign = rng.uniform(0.2, 0.55), rng.choice([-1.0, 1.0])
    at, taken = share * op.times[-1], rng.uniform(20, 200)
    return Parts(step=sign * strength * np.clip((op.times - at) / taken, 0.0, 1.0))


def housing_thermal_mass(op: Operation, strength: float, rng: np.random.Generator) -> Parts:
    """A thick housing that warms up layer by layer."""
    del op
    return Parts(ladder=strength * 2e-4, ladder_memory=rng.uniform(2500, 6000))


def thermostatic_cooling(op: Operation, strength: float, rng: np.random.Generator) -> Parts:
    """A water valve that opens when the bearing is warm and closes when it is cooler; it takes its time to move."""
    del op
    opens = rng.uniform(46.0, 52.0)
    return Parts(
        valve=strength * 2e-4,
        opens=opens,
        closes=opens - rng.uniform(4.0, 8.0),
        stroke=rng.uniform(15.0, 60.0),
        bath=rng.uniform(14.0, 20.0),
    )


def radiation_loss(op: Operation, strength: float, rng: np.random.Generator) -> Parts:
    """Radiation with some free convection, which also grows faster than the difference of temperatures."""
    del op
    return Parts(radiant=strength * 1e-4, convective=strength * 1e-4 * rng.uniform(0.0, 0.3))


EFFECTS: Mapping[str, Kind] = {
    "current-heating": Kind(current_heating, 0.01, 5.0),
    "quadratic-current-heating": Kind(quadratic_current_heating, 0.01, 12.0, base="linear"),
    "current-saturation": Kind(current_saturation, 0.01, 5.0, base="linear"),
    "torque-friction": Kind(torque_friction, 0.01, 4.0),
    "speed-friction": Kind(speed_friction, 0.01, 6.0),
    "vibration-friction": Kind(vibration_friction, 0.01, 6.0),
    "ambient-coupling": Kind(ambient_coupling, 0.01, 8.0),
    "feed-temperature-coupling": Kind(feed_temperature_coupling, 0.01, 8.0),
    "pump-cooling": Kind(pump_cooling, 0.01, 8.0),
    "startup-churning": Kind(startup_churning, 0.01, 6.0),
    "wear-drift": Kind(wear_drift, 0.01, 6.0),
    "dead-time": Kind(dead_time, 0.15, 8.0),
    "sensor-lag": Kind(sensor_lag, 0.15, 8.0),
    "sensor-offset-step": Kind(sensor_offset_step, 0.02, 4.0),
    "housing-thermal-mass": Kind(housing_thermal_mass, 0.01, 10.0),
    "thermostatic-cooling": Kind(thermostatic_cooling, 0.01, 10.0),
    "radiation-loss": Kind(radiation_loss, 0.05, 15.0),
}
"""By the name that the tool under test uses."""

NEEDS: Mapping[str, str] = {
    "current-heating": "Assorbimento",
    "quadratic-current-heating": "Assorbimento",
    "current-saturation": "Assorbimento",
    "torque-friction": "Coppia",
    "speed-friction": "Differenziale",
    "vibration-friction": "LivelloVibrazioni",
    "ambient-coupling": "TAmbiente",
    "feed-temperature-coupling": "TFango",
    "pump-cooling": "MarciaPmpFango",
}
"""The measured signal without which nobody could name the effect."""
