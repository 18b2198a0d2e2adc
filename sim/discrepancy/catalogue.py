"""The effects that can be named: what each does to the temperature, in which shapes, and what tells it from its twins.

An entry is declarative. An effect adds a heat, a loss, or a map between the bearing and its reading; its shape (time
constants, thresholds, powers, sinks) comes from `shapes`, its strength is what a likelihood finds. `drive` gives heat
and loss of one unit of strength along a course of the temperature, `sense` what the sensor makes of a course.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from sim.discrepancy.fitting.forms import (
    Drive,
    Params,
    Sense,
    Signals,
    ambient,
    ambient_drive,
    dead_time,
    feed_drive,
    housing,
    housing_drive,
    jumps,
    level,
    level_drive,
    offset_step,
    one_shape,
    pump,
    pump_drive,
    radiation,
    radiation_drive,
    saturation,
    saturation_drive,
    sense_delay,
    sense_lag,
    sense_offset,
    sensor_lag,
    startup,
    startup_drive,
    thermostat,
    thermostat_drive,
    wear,
    wear_drive,
)
from sim.discrepancy.fitting.record import Record
from sim.sha.trace import Array


@dataclass(frozen=True, slots=True)
class Entry:
    """An effect of the catalogue.

    `strength` names the parameter that scales it, `sign` what physics allows of it (0: either). `needs` are the roles
    of the signals without which it cannot be told, `may` those that it uses where there are some. `shapes(record,
    signals, smooth)` are the shapes to be tried, `smooth` (n,) degC being the reading without its noise.
    `drive(record, signals, params, course)` is (loss, heat) of one unit along a course (n,) degC: 1/s and degC/s, held
    over each step, as dX/dt += heat - loss * X. `sense(record, params, course)` is the course as it is read, given the
    whole of `params`. `refine` gives the range of each shape parameter that is searched further; `plain` says what the
    effect is, `experiment` what would tell it from its twins. `either` gives shape parameters of which every value is
    fitted, since the screen, which is linear, cannot choose among them. `scan(record, pull)` gives further shapes where
    the pull (m,) of the residual is greatest (the residual weighed by its inverse covariance); `burden` (nats) is what
    looking at so many places costs.
    """

    name: str
    strength: str
    sign: float
    needs: tuple[str, ...]
    may: tuple[str, ...]
    shapes: Callable[[Record, Signals, Array], Sequence[Params]]
    plain: str
    experiment: str
    drive: Drive | None = None
    sense: Sense | None = None
    refine: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    either: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    scan: Callable[[Record, Array], Sequence[Params]] | None = None
    burden: float = 0.0

    @property
    def whole(self) -> bool:
        """True where the strength is itself a time (of a lag, of a delay): the effect is there once, not times c."""
        return self.strength in ("delay", "tau")


ROLES: dict[str, str] = {
    "current": "Assorbimento",
    "torque": "Coppia",
    "speed": "Differenziale",
    "vibration": "LivelloVibrazioni",
    "pump": "MarciaPmpFango",
    "feed": "TFango",
    "ambient": "TAmbiente",
}
"""The plant's signal of each role; a column map gives other data's signals the plant's names."""


CATALOGUE: tuple[Entry, ...] = (
    Entry(
        "current-heating",
        "gain",
        1.0,
        ("current",),
        (),
        level("current", (1.0,)),
        "heat that grows with the current inside a bin of the current",
        "hold two currents inside one bin for half an hour each",
        drive=level_drive("current"),
    ),
    Entry(
        "quadratic-current-heating",
        "gain",
        1.0,
        ("current",),
        (),
        level("current", (2.0,)),
        "heat that grows with the square of the current",
        "dwell at three currents or more, each until the temperature settles",
        drive=level_drive("current"),
    ),
    Entry(
        "current-saturation",
        "gain",
        1.0,
        ("current",),
        (),
        saturation,
        "above some current the heat grows no further with it",
        "dwell at three currents or more, two of them near the highest",
        drive=saturation_drive,
        refine={"knee": (10.0, 350.0)},
    ),
    Entry(
        "torque-friction",
        "gain",
        1.0,
        ("torque",),
        (),
        level("torque", (1.0, 2.0)),
        "friction heat that follows the torque",
        "change the speed at constant torque, then the torque at constant speed",
        drive=level_drive("torque"),
        refine={"power": (0.5, 3.0)},
    ),
    Entry(
        "speed-friction",
        "gain",
        1.0,
        ("speed",),
        (),
        level("speed", (1.0, 2.0)),
        "friction heat that follows the speed",
        "change the speed at constant torque",
        drive=level_drive("speed"),
        refine={"power": (1.0, 3.0)},  # friction's heat is force times speed: it never grows more slowly than the speed
    ),
    Entry(
        "vibration-friction",
        "gain",
        1.0,
        ("vibration",),
        (),
        level("vibration", (1.0, 2.0)),
        "heat that follows the vibration",
        "change the speed at constant torque and watch whether heat goes with the vibration alone",
        drive=level_drive("vibration"),
        refine={"power": (0.5, 3.0)},
    ),
    Entry(
        "ambient-coupling",
        "gain",
        1.0,
        ("ambient",),
        (),
        ambient,
        "the measured part follows the room's temperature",
        "log the room for three days, with a night at rest",
        drive=ambient_drive,
    ),
    Entry(
        "feed-temperature-coupling",
        "loss",
        1.0,
        ("feed",),
        ("pump",),
        one_shape,
        "what is fed draws the measured part towards its own temperature",
        "feed at two temperatures at one load",
        drive=feed_drive,
    ),
    Entry(
        "pump-cooling",
        "loss",
        1.0,
        ("pump",),
        (),
        pump,
        "the pump cools the measured part while it runs",
        "run for half an hour at one load with the pump on, then off",
        drive=pump_drive,
        refine={"sink": (-1000.0, 100.0)},
    ),
    Entry(
        "housing-thermal-mass",
        "coupling",
        1.0,
        (),
        (),
        housing,
        "a second mass (the housing) stores heat and gives it back",
        "log the room for three days, or a second sensor: a housing lags, a room does not",
        drive=housing_drive,
        refine={"tau": (300.0, 40000.0)},
    ),
    Entry(
        "startup-churning",
        "gain",
        1.0,
        (),
        (),
        startup,
        "extra heat after each start that dies away (grease being churned)",
        "start twice within an hour, at the same load",
        drive=startup_drive,
        refine={"tau": (20.0, 3000.0), "shape": (0.5, 3.0)},
    ),
    Entry(
        "wear-drift",
        "gain",
        1.0,
        (),
        (),
        wear,
        "friction that grows from day to day",
        "compare a reading at long rest before and after: a sensor that moved shows it there, wear does not",
        drive=wear_drive,
    ),
    Entry(
        "dead-time",
        "delay",
        1.0,
        (),
        (),
        dead_time,
        "heat reaches the sensor only after a dead time",
        "one sharp step of the current, logged at 1 Hz",
        sense=sense_delay,
        either={"blur": (0.0, 0.7, 1.4)},
        refine={"delay": (1.0, 600.0)},
    ),
    Entry(
        "sensor-lag",
        "tau",
        1.0,
        (),
        (),
        sensor_lag,
        "the sensor follows what it measures with a lag",
        "one sharp step of the current, logged at 1 Hz",
        sense=sense_lag,
        either={"order": (1.0, 2.0)},
        refine={"tau": (2.0, 1500.0)},
    ),
    Entry(
        "sensor-offset-step",
        "size",
        0.0,
        (),
        (),
        offset_step,
        "from some moment on the sensor reads higher or lower by a constant",
        "a reading at long rest, against a second thermometer",
        sense=sense_offset,
        scan=jumps,
        burden=7.5,
    ),
    Entry(
        "thermostatic-cooling",
        "loss",
        1.0,
        (),
        (),
        thermostat,
        "a cooling that switches on above one temperature and off below another",
        "a slow ramp of the load up and down: a hysteresis loop",
        drive=thermostat_drive,
        refine={"opens": (-50.0, 200.0), "closes": (-50.0, 200.0)},
    ),
    Entry(
        "radiation-loss",
        "gain",
        1.0,
        (),
        ("ambient",),
        radiation,
        "a loss that grows faster than the temperature difference",
        "a slow ramp of the load up and down: no loop, but a bend",
        drive=radiation_drive,
    ),
)
NAMES = tuple(entry.name for entry in CATALOGUE)


def signals_of(entry: Entry, present: Mapping[str, str]) -> dict[str, str] | None:
    """role -> signal for an entry from the roles that are `present`; None where a needed one is missing."""
    if any(role not in present for role in entry.needs):
        return None
    return {role: present[role] for role in (*entry.needs, *entry.may) if role in present}
