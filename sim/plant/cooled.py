"""A small plant with one thing that can be hidden: a bearing whose slurry pump cools it, by as much as a knob says.

One mass with friction that grows with the current, loss to an air-conditioned hall, coarse disturbances with a memory,
and friction that scatters from one start to the next. While the pump runs, water at its own temperature flows past the
bearing; the jacket takes a minute to fill and to run dry, so the cooling has no textbook shape. The pump is
switched apart from the load. Torque, speed, vibration and hall are measured too and heat nothing.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim.sha import Array, Trace

EPOCH_S = 1_738_540_800.0
"""2025-02-03 00:00:00 UTC, a Monday."""
DAY_S = 86_400.0
SIGNALS = (
    "MarciaDecanter",
    "MarciaPmpFango",
    "Assorbimento",
    "Coppia",
    "Differenziale",
    "LivelloVibrazioni",
    "TCuscinettiRiduttore",
    "TAmbiente",
)


@dataclass(frozen=True, slots=True)
class CooledPlant:
    """Constants: rates in 1/s, heats in degC/s (per ampere where it says so), temperatures in degC.

    `cooling` is the knob: the loss to the water while the jacket is full; 0 hides nothing. `roughness` is the standard
    deviation of the heat disturbance (degC/s) with the memory `roughness_memory` (s), `cycle_scatter` the relative
    scatter of friction from start to start.
    """

    cooling: float = 0.0
    water: float = 13.0
    filling: float = 40.0
    loss: float = 1 / 1700
    hall: float = 19.0
    idle_heat: float = 0.0045
    heat_per_ampere: float = 0.000075
    roughness: float = 0.0006
    roughness_memory: float = 500.0
    cycle_scatter: float = 0.008
    sensor_noise: float = 0.06


@dataclass(frozen=True, slots=True)
class _Stretch:
    """`seconds` of one setting: running or not, the load's current (A), pump on or off."""

    seconds: float
    running: bool
    load: float
    pump: bool


def cooled_days(
    days: int, *, seed: int, first_day: int = 0, plant: CooledPlant | None = None, period: float = 10.0
) -> list[Trace]:
    """A synthetic trace for each of `days` days of four cycles, one row every `period` seconds.

    The first begins `first_day` days after EPOCH_S. The same arguments give the same traces. Raises ValueError without
    a day or with a period that is not positive.
    """
    if days < 1 or not period > 0:
        raise ValueError("a plant needs at least one day and a positive period")
    plant, rng = plant or CooledPlant(), np.random.default_rng([seed, first_day])
    traces, bearing = [], plant.hall + 1.0
    for day in range(first_day, first_day + days):
        rows, bearing = _rows(plant, _day(rng), bearing, period, rng)
        name = f"day{day + 1}"
        traces.append(
            Trace(
                name,
                EPOCH_S + DAY_S * day + period * np.arange(rows.shape[0], dtype=np.float64),
                {signal: rows[:, column].copy() for column, signal in enumerate(SIGNALS)},
                origin=f"simulated cooled bearing {name}, seed {seed}",
                synthetic=True,
            )
        )
    return traces


def _day(rng: np.random.Generator) -> list[_Stretch]:
    """Four runs of two to three hours with loads of their own, each with rests after; the pump goes its own way."""
    day = [_Stretch(5.5 * 3600, running=False, load=0.0, pump=False)]
    for _ in range(4):
        for _ in range(3):
            load = float(rng.uniform(115, 285))
            for _ in range(3):
                day.append(
                    _Stretch(float(rng.uniform(600, 1300)), running=True, load=load, pump=bool(rng.random() < 0.5))
                )
        day.append(_Stretch(float(rng.uniform(3600, 5400)), running=False, load=0.0, pump=bool(rng.random() < 0.3)))
    rest = max(DAY_S - sum(stretch.seconds for stretch in day), 600.0)
    day.append(_Stretch(rest, running=False, load=0.0, pump=False))
    return day


def _rows(
    plant: CooledPlant, day: Sequence[_Stretch], bearing: float, period: float, rng: np.random.Generator
) -> tuple[Array, float]:
    """(n, signals) of one day, and the bearing's temperature at its end. Steps of `period`, exact in the losses."""
    # Every draw comes from one generator: the order of the lines is part of what a seed means.
    count = int(DAY_S / period)
    which = np.searchsorted(np.cumsum([each.seconds for each in day]), period * np.arange(count), side="right")
    running = np.array([each.running for each in day], dtype=float)[which]
    pump = np.array([each.pump for each in day], dtype=float)[which]
    current = np.array([each.load for each in day])[which] + 9.0 * _wander(count, period / 90.0, rng)
    current = np.where(running > 0, np.clip(current, 60.0, 340.0), 0.0)
    starts = np.cumsum(np.diff(running, prepend=0.0) > 0)
    friction = (1.0 + plant.cycle_scatter * rng.normal(size=int(starts[-1]) + 1))[starts]
    heat = running * friction * (plant.idle_heat + plant.heat_per_ampere * current)
    heat += running * plant.roughness * _wander(count, period / plant.roughness_memory, rng)
    temperature, full = np.empty(count), 0.0
    fill = -np.expm1(-period / plant.filling)
    for row in range(count):
        temperature[row] = bearing
        full += fill * (pump[row] - full)
        cooling = plant.cooling * full
        rate = plant.loss + cooling
        target = (heat[row] + plant.loss * plant.hall + cooling * plant.water) / rate
        bearing = target + (bearing - target) * float(np.exp(-rate * period))

    # What the transmitters make of it: noise, then their steps. The columns are in the order of SIGNALS.
    def noisy(values: Array, sigma: float, step: float) -> Array:
        return np.round(np.round((values + sigma * rng.normal(size=count)) / step) * step, 6)

    speed = running * (11.0 + 1.2 * _wander(count, 1 / 400.0, rng))
    readings = [
        running,
        pump,
        np.maximum(noisy(current, 0.6, 0.1), 0.0) * running,
        np.maximum(noisy(running * (0.2 * current + 4.0 * _wander(count, 1 / 60.0, rng)), 0.2, 0.1), 0.0),
        np.maximum(noisy(speed, 0.02, 0.01), 0.0),
        np.maximum(noisy(0.3 + running * (2.2 + 0.4 * _wander(count, 1 / 250.0, rng)), 0.05, 0.01), 0.0),
        noisy(temperature, plant.sensor_noise, 0.1),
        noisy(plant.hall + 0.4 * _wander(count, 1 / 700.0, rng), 0.05, 0.1),
    ]
    return np.column_stack(readings), bearing


def _wander(count: int, share: float, rng: np.random.Generator) -> Array:
    """(n,) an Ornstein-Uhlenbeck process of standard deviation 1 whose memory is 1 / `share` rows."""
    keep = float(np.exp(-share))
    drawn = rng.normal(size=count) * np.sqrt(1.0 - keep**2)
    values, state = np.empty(count), float(rng.normal())
    for row in range(count):
        state = keep * state + float(drawn[row])
        values[row] = state
    return values
