"""What may act on a machine of the recorder's plant: forms of its own for the catalogue's names, and what has no name.

Each makes a `Guest` of (work, machine, strength, generator for the details). At strength 1 it is of the size of a
tenth of the machine's own heat or loss, or a lag of a minute.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from benchmarks.discrepancy.operation import Array
from benchmarks.discrepancy.recorder.masses import Guest, Machine
from benchmarks.discrepancy.recorder.work import DAY, STEP, Work, follow, hold

Make = Callable[[Work, Machine, float, np.random.Generator], Guest]
Law = Literal["steps", "line", "any"]
LATE = "late-current-heating"


@dataclass(frozen=True, slots=True, kw_only=True)
class Actor:
    """`make`, the strengths up to which the plant stays one, and on which law of the drive's heat it is a gap: heat
    that is one a bin (`steps`) or follows the load in a straight `line`. `signed`: may act either way. `words`: one of
    them stands in a true description of what has no name."""

    make: Make
    most: float = 6.0
    law: Law = "any"
    signed: bool = False
    words: tuple[str, ...] = ()


def _heat(machine: Machine) -> float:
    """K/s: a tenth of what the machine usually makes."""
    return 0.1 * machine.running * machine.usual


def current_heating(work: Work, machine: Machine, s: float, rng: np.random.Generator) -> Guest:
    """Brushes: heat that follows the load inside the bins too, nearly in proportion."""
    power = rng.uniform(0.9, 1.1)
    return Guest(heat=2.0 * s * _heat(machine) * work.running * (np.maximum(work.load, 0.0) / 200.0) ** power)


def quadratic_current_heating(work: Work, machine: Machine, s: float, rng: np.random.Generator) -> Guest:
    """Copper losses, through a flange that holds them back for a minute or so."""
    return Guest(heat=2.0 * s * _heat(machine) * follow((work.load / 200.0) ** 2, rng.uniform(15.0, 80.0)))


def current_saturation(work: Work, machine: Machine, s: float, rng: np.random.Generator) -> Guest:
    """A slipping coupling: the load that reaches the bearing bends off along a hyperbola."""
    knee, width = rng.uniform(170.0, 225.0), rng.uniform(20.0, 60.0)
    passed = 0.5 * (work.load + knee - np.hypot(work.load - knee, width))
    return Guest(heat=2.0 * s * _heat(machine) * work.running * (passed - work.load) / 60.0)


def torque_friction(work: Work, machine: Machine, s: float, rng: np.random.Generator) -> Guest:
    """Thrust of the scroll: proportional, and a little with the square."""
    bend = rng.uniform(0.0, 0.25)
    x = work.torque / 45.0
    return Guest(heat=s * _heat(machine) * x * (1.0 + bend * x))


def speed_friction(work: Work, machine: Machine, s: float, rng: np.random.Generator) -> Guest:
    """Churned oil: part laminar, part turbulent."""
    share = rng.uniform(0.2, 0.8)
    x = work.differential / 15.0
    return Guest(heat=s * _heat(machine) * work.running * (share * x + (1.0 - share) * x**2))


def vibration_friction(work: Work, machine: Machine, s: float, rng: np.random.Generator) -> Guest:
    """Skidding rollers: with the energy of the shaking until they slide."""
    x = np.maximum(work.vibration - 0.9, 0.0)
    return Guest(heat=s * _heat(machine) * work.running * x**2 / (rng.uniform(1.0, 4.0) + x))


def ambient_coupling(work: Work, machine: Machine, s: float, rng: np.random.Generator) -> Guest:
    """The hall is as warm as the weather makes it, late and in part."""
    del machine
    return Guest(hall=s * follow(work.ambient - 18.0, rng.uniform(300.0, 1200.0)))


def feed_temperature_coupling(work: Work, machine: Machine, s: float, rng: np.random.Generator) -> Guest:
    """Slurry washes the hub: a film that grows with the flow."""
    film = follow((work.flow / 70.0) ** rng.uniform(0.5, 0.8), 40.0)
    return Guest(cooling=0.2 * s * machine.running * film, sink=follow(work.feed, 60.0))


def pump_cooling(work: Work, machine: Machine, s: float, rng: np.random.Generator) -> Guest:
    """A jacket on the pump's circuit that fills within two minutes and drains within one."""
    wet = np.minimum(follow(work.pump, rng.uniform(20.0, 100.0)) * 1.1, 1.0)
    return Guest(cooling=0.2 * s * machine.running * wet, sink=rng.uniform(11.0, 18.0))


def startup_churning(work: Work, machine: Machine, s: float, rng: np.random.Generator) -> Guest:
    """Cold grease: a stretched decay after each start."""
    shape = np.exp(-((work.age / rng.uniform(200.0, 600.0)) ** rng.uniform(0.75, 1.3)))
    return Guest(heat=4.0 * s * _heat(machine) * work.running * shape)


def wear_drift(work: Work, machine: Machine, s: float, rng: np.random.Generator) -> Guest:
    """Wear by turns made, each turn wearing a little more than the last one or a little less."""
    turns = np.cumsum(work.running * (5.0 + work.differential))
    return Guest(heat=2.0 * s * _heat(machine) * work.running * (turns / turns[-1]) ** rng.uniform(0.85, 1.25))


def dead_time(work: Work, machine: Machine, s: float, rng: np.random.Generator) -> Guest:
    """All the heat takes its way through an oil line."""
    del work, machine, rng
    return Guest(late=60.0 * s)


def sensor_lag(work: Work, machine: Machine, s: float, rng: np.random.Generator) -> Guest:
    """The paste about the sensor has dried out."""
    del work, machine, rng
    return Guest(lag=60.0 * s)


def sensor_offset_step(work: Work, machine: Machine, s: float, rng: np.random.Generator) -> Guest:
    """Somebody put the sensor back elsewhere."""
    del machine
    at = rng.uniform(0.2, 0.5) * work.seconds[-1]
    return Guest(shift=float(rng.choice([-1.0, 1.0])) * s * (work.seconds > at))


def housing_thermal_mass(work: Work, machine: Machine, s: float, rng: np.random.Generator) -> Guest:
    """A cast foot behind a joint."""
    del work
    return Guest(foot=0.3 * s * machine.running, foot_memory=rng.uniform(2500.0, 7000.0))


def thermostatic_cooling(work: Work, machine: Machine, s: float, rng: np.random.Generator) -> Guest:
    """A fan behind a bimetal switch, with flaps that take their time."""
    del work
    opens = machine.hall + machine.usual * rng.uniform(0.7, 0.85)
    closes = opens - rng.uniform(2.5, 6.0)
    return Guest(valve=0.3 * s * machine.running, opens=opens, closes=closes, stroke=rng.uniform(10.0, 60.0))


def radiation_loss(work: Work, machine: Machine, s: float, rng: np.random.Generator) -> Guest:
    """A bare black housing in the place of a part of the draught: as much loss at a middling temperature."""
    del work, rng
    radiant = 0.3 * s * machine.running
    warm, cold = machine.hall + 0.6 * machine.usual + 273.15, machine.hall + 273.15
    instead = radiant * (warm**2 + cold**2) * (warm + cold) / (4.0 * 300.0**3)
    return Guest(radiant=radiant, cooling=-instead, sink=machine.hall)


def late_current_heating(work: Work, machine: Machine, s: float, rng: np.random.Generator) -> Guest:
    """The load's own heat is made in a winding and comes when that has warmed."""
    del work, machine, rng
    return Guest(winding=150.0 * s)


def hour_of_day(work: Work, machine: Machine, s: float, rng: np.random.Generator) -> Guest:
    """Something hot runs in the late shift, every day at the same hours."""
    begin = rng.uniform(9.0, 15.0) * 3600.0
    at = (work.seconds - begin) % DAY
    return Guest(heat=2.0 * s * _heat(machine) * follow((at < rng.uniform(4.0, 7.0) * 3600.0).astype(float), 900.0))


def fading_grease(work: Work, machine: Machine, s: float, rng: np.random.Generator) -> Guest:
    """Greased twice: heat that fades with the hours run since."""
    hours = np.cumsum(work.running) * STEP / 3600.0
    heat, fades = np.zeros(hours.size), rng.uniform(2.5, 6.0)
    for share in (rng.uniform(0.08, 0.2), rng.uniform(0.4, 0.55)):
        since = hours - share * hours[-1]
        heat += np.where(since > 0, np.exp(-np.maximum(since, 0.0) / fades), 0.0)
    return Guest(heat=3.0 * s * _heat(machine) * work.running * heat)


def load_step_heat(work: Work, machine: Machine, s: float, rng: np.random.Generator) -> Guest:
    """Each change of the load, up or down, makes the bowl ring for some minutes."""
    jolt = np.abs(np.diff(work.load, prepend=0.0)) * work.running
    rings = rng.uniform(150.0, 500.0)
    shaken = follow(np.where(jolt > 20.0, jolt / 100.0, 0.0), rings) * rings / STEP
    return Guest(heat=2.0 * s * _heat(machine) * work.running * shaken)


def neighbour(work: Work, machine: Machine, s: float, rng: np.random.Generator) -> Guest:
    """A machine next door that nobody records, by a plan of its own."""
    n = work.running.size
    plan = (hold(rng, n, (50.0, 300.0), (0.0, 1.0)) < 0.5).astype(float)
    return Guest(heat=2.0 * s * _heat(machine) * follow(plan, 1200.0))


def failing_cooler(work: Work, machine: Machine, s: float, rng: np.random.Generator) -> Guest:
    """The cooler, a part of the machine's loss and without a signal, falls from all of it to 3 % within some hours."""
    at, taken = rng.uniform(0.25, 0.5) * work.seconds[-1], rng.uniform(2.0, 10.0) * 3600.0
    lost = 0.97 * np.clip((work.seconds - at) / taken, 0.0, 1.0)
    return Guest(cooling=-0.2 * min(s, 3.0) * machine.running * work.running * lost, sink=machine.hall)


def exchanged_bearing(work: Work, machine: Machine, s: float, rng: np.random.Generator) -> Guest:
    """A new bearing: other friction from the first start on, and a running in that is over after some hours."""
    hours = np.cumsum(work.running) * STEP / 3600.0
    running_in = rng.uniform(0.2, 0.6) * np.exp(-hours / rng.uniform(4.0, 9.0))
    return Guest(heat=s * _heat(machine) * work.running * (1.0 + running_in))


def summer(work: Work, machine: Machine, s: float, rng: np.random.Generator) -> Guest:
    """The weather changes: a warmer hall."""
    del work, machine
    return Guest(hall=s * rng.uniform(2.0, 4.0))


INSIDE: Mapping[str, Actor] = {
    "current-heating": Actor(make=current_heating, law="steps"),
    "quadratic-current-heating": Actor(make=quadratic_current_heating, most=10.0, law="line"),
    "current-saturation": Actor(make=current_saturation, most=10.0, law="line"),
    "torque-friction": Actor(make=torque_friction),
    "speed-friction": Actor(make=speed_friction),
    "vibration-friction": Actor(make=vibration_friction),
    "ambient-coupling": Actor(make=ambient_coupling),
    "feed-temperature-coupling": Actor(make=feed_temperature_coupling),
    "pump-cooling": Actor(make=pump_cooling),
    "startup-churning": Actor(make=startup_churning),
    "wear-drift": Actor(make=wear_drift),
    "dead-time": Actor(make=dead_time),
    "sensor-lag": Actor(make=sensor_lag),
    "sensor-offset-step": Actor(make=sensor_offset_step, signed=True),
    "housing-thermal-mass": Actor(make=housing_thermal_mass),
    "thermostatic-cooling": Actor(make=thermostatic_cooling),
    "radiation-loss": Actor(make=radiation_loss, most=8.0),
}
"""By the catalogue's names."""
WINDING: Mapping[str, Actor] = {LATE: Actor(make=late_current_heating, most=12.0, law="line")}
OUTSIDE: Mapping[str, Actor] = {
    "hour-of-day": Actor(
        make=hour_of_day, words=("time of day", "hour of", "hours of", "clock", "daily", "every day", "night")
    ),
    "fading-grease": Actor(make=fading_grease, words=("fad", "greas", "dies away")),
    "load-step-heat": Actor(make=load_step_heat, words=("step of the load", "load step", "each step", "steps of the")),
    "neighbour": Actor(make=neighbour, words=("neighbour", "not measured", "unmeasured", "own plan", "not recorded")),
    "failing-cooler": Actor(make=failing_cooler, words=("less cooling", "cooler", "cools less", "loses less")),
}
"""What no name of the catalogue stands for."""
BEGINNING: Mapping[str, Actor] = {
    "exchanged-bearing": Actor(make=exchanged_bearing),
    "summer": Actor(make=summer),
}
"""What has no name but a day on which it begins."""
HALF_WAY: tuple[str, ...] = (
    "exchanged-bearing", "torque-friction", "summer", "speed-friction", "startup-churning", "pump-cooling",
    "feed-temperature-coupling", "vibration-friction",
)  # fmt: skip
ACTORS: Mapping[str, Actor] = {**INSIDE, **WINDING, **OUTSIDE, **BEGINNING}
TWINS = (
    frozenset({"dead-time", "sensor-lag"}),
    frozenset({"dead-time", "startup-churning"}),
    frozenset({"sensor-lag", "startup-churning"}),
    frozenset({"quadratic-current-heating", "current-saturation"}),
    frozenset({"ambient-coupling", "housing-thermal-mass"}),
    frozenset({"wear-drift", "sensor-offset-step"}),
    frozenset({"thermostatic-cooling", "radiation-loss"}),
    frozenset({"pump-cooling", "feed-temperature-coupling"}),
)
"""No pair is made of these: a record of some days seldom tells them apart."""


def begin_at(guest: Guest, at: Array) -> Guest:
    """The guest that acts only where `at` (n,) is 1; it must have neither a lag nor a mass nor a valve."""
    if guest.foot or guest.lag or guest.late or guest.winding or guest.valve or guest.radiant:
        raise ValueError("what has a state or is part of the sensor cannot begin half-way")
    return replace(
        guest, heat=guest.heat * at, cooling=guest.cooling * at, hall=guest.hall * at, shift=guest.shift * at
    )
