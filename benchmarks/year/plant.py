"""A year at a decanter: seasons, wear, a changed sensor, a new product, a swapped bearing, three operators.

So many days of each month are simulated, by the physics of `sim.plant`, from the first start to the last stop of a day,
a row every PERIOD s: the heat that is forecast moves over minutes. Each day has a seed of its own.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from math import cos, pi

import numpy as np

from sim.plant.decanter import DecanterPlant, Phase, Weather, simulate_decanter
from sim.sha import DECANTER, Array, Trace, encode

TEMPERATURE = "TCuscinettiRiduttore"
SIGNALS = ("MarciaDecanter", "Assorbimento", TEMPERATURE, "TFango", "TAmbiente")
PERIOD, STEP = 20.0, 2.0
"""s between two rows; of an integration step."""
BEGIN = datetime(2025, 1, 1, tzinfo=UTC).timestamp()
DAY, YEAR, MONTHS = 86_400.0, 365.0, 12
LIMIT = 55.0
"""degC at which a bearing overheats."""
SENSOR, PRODUCT, BEARING = 95.0, 165.0, 230.0
"""Days of the year on which the sensor is changed, a new product comes, and the bearing is swapped."""
CHANGES = {"sensor": SENSOR, "product": PRODUCT, "bearing": BEARING}
CLOGGED = 0.6
"""The share of days on which the bowl clogs in one run: its load climbs until somebody stops."""


@dataclass(frozen=True, slots=True)
class Operator:
    """How somebody runs the machine: loads (A) from `low` to `high`, `feeds` a run, s of `idling` between two."""

    low: float
    high: float
    feeds: int
    idling: float
    share: float


OPERATORS = (
    Operator(110.0, 190.0, 3, 120.0, 0.70),
    Operator(170.0, 250.0, 2, 60.0, 0.55),
    Operator(90.0, 230.0, 5, 300.0, 0.62),
)
RUNS = 5
"""Runs a day, at most."""


@dataclass(frozen=True, slots=True)
class Date:
    """A day of the `month` (from 0) and the year (`number`, days from 0).

    Forecasts are `judged` along some days only, since that costs more than to live them.
    """

    month: int
    number: float
    judged: bool = True


@dataclass(frozen=True, slots=True)
class Day:
    """A day of the `month` (from 0) and the year (`number`, days from 0): what the gateway reads, with its events."""

    month: int
    number: float
    trace: Trace


def dates_of(months: int, days: int, judged: int | None = None) -> list[Date]:
    """The first `months` of the year, `days` of each, evenly over it; `judged` of them (default: all) evenly again."""
    most = days if judged is None else min(judged, days)
    return [
        Date(
            month,
            round((month + (day + 0.5) / days) * YEAR / MONTHS),
            judged=day * most // days != (day - 1) * most // days,
        )
        for month in range(months)
        for day in range(days)
    ]


def day_of(date: Date, *, seed: int) -> Day:
    """What happens on a date."""
    return Day(date.month, date.number, _day(date.number, seed))


def days_before(count: int, *, seed: int) -> list[Trace]:
    """So many days of the three weeks before the year, from which all arms have their first model."""
    return [_day(-round(21.0 * (number + 1) / count), seed) for number in range(count)]


def plant_on(day: float) -> DecanterPlant:
    """The machine on a day: its friction grows by a quarter in 200 days, and begins anew with another bearing."""
    new = DecanterPlant()
    wear = 1.0 + 0.25 * (day if day < BEARING else day - BEARING) / 200.0
    plant = replace(new, idle_heat=new.idle_heat * wear, heat_per_ampere=new.heat_per_ampere * wear)
    if day >= BEARING:
        # Another make: it runs easier under load, and sits tighter in the housing.
        plant = replace(plant, heat_per_ampere=0.85 * plant.heat_per_ampere, bearing_to_housing=1 / 215)
    if day >= SENSOR:
        plant = replace(plant, sensor_lag=25.0, sensor_noise=0.1, sensor_step=0.2)
    return plant


def _day(day: float, seed: int) -> Trace:
    # Days before the year have negative numbers, which no generator takes.
    rng = np.random.default_rng([seed, 1000 + int(day)])
    season = -cos(2 * pi * (day - 20.0) / YEAR)
    weather = Weather(mean=17.0 + 5.0 * season + 1.5 * rng.normal(), swing=2.0 + season, slurry=18.0 + 4.0 * season)
    if day >= PRODUCT:
        weather = replace(weather, slurry=weather.slurry + 8.0)
    begin = BEGIN + DAY * day + 6.0 * 3600.0 + float(rng.uniform(0.0, 1800.0))
    trace = simulate_decanter(
        list(_phases(day, rng)),
        seed=int(rng.integers(2**31)),
        name=f"day{int(day):03d}",
        period=PERIOD,
        jitter=0.02,
        start=begin,
        bearing=weather.ambient(begin % DAY) + 3.0,
        weather=weather,
        plant=plant_on(day),
        step=STEP,
    )
    signals = {name: trace.signals[name] for name in SIGNALS}
    if day >= SENSOR:
        # The new one is calibrated otherwise: 2 % less from 20 degC on, and 1.5 degC too high.
        signals[TEMPERATURE] = np.round(20.0 + 0.98 * (signals[TEMPERATURE] - 20.0) + 1.5, 1)
    trace = replace(trace, signals=signals)
    return replace(trace, events=encode(trace, DECANTER))


def _phases(day: float, rng: np.random.Generator) -> Iterator[Phase]:
    """A shift's runs by one of the three operators, from before the first start to after the last stop."""
    operator = OPERATORS[int(rng.integers(len(OPERATORS)))]
    more = 25.0 if day >= PRODUCT else 0.0
    clogged = int(rng.integers(RUNS)) if rng.random() < CLOGGED else -1
    yield Phase(300.0, running=False, pump=False)
    for run in range(RUNS):
        length = float(rng.uniform(0.9, 1.1)) * operator.share * 3.0 * 3600.0
        for _ in range(operator.feeds):
            load = float(rng.uniform(operator.low, operator.high)) + more
            yield Phase(length / operator.feeds, running=True, load=load, swing=12.0 + more / 3.0, memory=60.0)
            yield Phase(operator.idling, running=True, load=0.0, swing=4.0, pump=False)
        if run == clogged:
            for step in range(6):
                yield Phase(600.0, running=True, load=240.0 + 20.0 * step, swing=15.0, memory=60.0)
        yield Phase((1.0 - operator.share) * 3.0 * 3600.0, running=False, pump=False)


def overheated(trace: Trace) -> list[float]:
    """When the temperature came to LIMIT (absolute s), each time from 2 degC below it: what nobody knew before."""
    moments: list[float] = []
    armed = True
    for time, value in zip(trace.times.tolist(), _smooth(trace.signals[TEMPERATURE]).tolist(), strict=True):
        if armed and value >= LIMIT:
            moments.append(time)
            armed = False
        elif value < LIMIT - 2.0:
            armed = True
    return moments


def _smooth(values: Array) -> Array:
    return np.convolve(np.pad(values, 1, mode="edge"), np.ones(3) / 3.0, mode="valid")
