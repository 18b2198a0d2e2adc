"""The effects that can be named: what each does to the temperature, in which shapes, and what tells it from its twins.

An entry is declarative. An effect adds a heat, a loss, or a map between the bearing and its reading; its shape (time
constants, thresholds, powers, sinks) comes from `shapes`, its strength is what a likelihood finds. `drive` gives heat
and loss of one unit of strength along a course of the temperature, `sense` what the sensor makes of a course.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise, product

import numpy as np

from sim.discrepancy.record import Record
from sim.sha.recursion import linear_recursion
from sim.sha.trace import Array, Mask

KELVIN = 273.15
JUMPS, JUMP_APART = 16, 5
"""Moments at which an offset is looked for besides the regular ones, and windows between them."""
DAY = 86400.0

Params = dict[str, float]
Signals = Mapping[str, str]
Drive = Callable[[Record, Signals, Mapping[str, float], Array], tuple[Array, Array]]
Sense = Callable[[Record, Mapping[str, float], Array], Array]


@dataclass(frozen=True, slots=True)
class Entry:
    """An effect of the catalogue.

    `strength` names the parameter that scales it, `sign` what physics allows of it (0: either). `needs` are the roles
    of the signals without which it cannot be told, `may` those that it uses where there are some. `shapes(record,
    signals, smooth)` are the shapes to be tried, `smooth` (n,) degC being the reading without its noise.
    `drive(record, signals, params, course)` is (loss, heat) of one unit along a course (n,) degC: 1/s and degC/s, held
    over each step, as dX/dt += heat - loss * X. `sense(record, params, course)` is the course as it is read, given the
    whole of `params`. `refine` gives the range of each shape parameter that is searched further; `plain` says what the
    effect is, `experiment` what would tell it from its twins. `scan(record, pull)` gives further shapes where the pull
    (m,) of the residual is greatest (the residual weighed by its inverse covariance); `burden` (nats) is what looking
    at so many places costs.
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


def held(record: Record, name: str) -> Array:
    """(n,) a signal over each step, its mean where it was never read yet."""
    column = record.signal(name)
    known = np.isfinite(column)
    return np.where(known, column, float(np.mean(column[known])) if known.any() else 0.0)


def lagged(record: Record, column: Array, lag: float) -> Array:
    """A column (n,) through a first-order lag (s), from its first value in each run."""
    if lag <= 0:
        return column
    runs = record.runs
    keep = np.where(runs.first, 0.0, np.exp(-runs.dt / lag))
    return linear_recursion(keep, (1.0 - keep) * column, 0.0)


def delayed(record: Record, column: Array, delay: float) -> Array:
    """A course (n,) `delay` seconds later: as its inputs would come so much later, from the same start."""
    runs = record.runs
    out = np.empty(column.size)
    edges = [*np.flatnonzero(runs.first).tolist(), len(runs)]
    for begin, end in pairwise(edges):
        part = slice(begin, end)
        out[part] = np.interp(runs.time[part] - delay, runs.time[part], column[part])
    return out


def hysteresis(course: Array, opens: float, closes: float, first: Mask) -> Array:
    """(n,) 1 while open: from a value of at least `opens` until one of at most `closes`; closed at a run's first."""
    said = np.where(course >= opens, 1, np.where(course <= closes, 0, -1))
    said = np.where(first & (said < 0), 0, said)
    last = np.maximum.accumulate(np.where(said >= 0, np.arange(said.size), 0))
    return np.maximum(said[last], 0).astype(float)


def _none(record: Record) -> Array:
    return np.zeros(len(record.runs))


def _reference(record: Record, column: Array, *, running: bool) -> float:
    weight = record.runs.dt * (record.running if running else 1.0)
    return float(np.average(column, weights=weight)) if weight.sum() > 0 else float(np.mean(column))


def _level(role: str, powers: tuple[float, ...]) -> Callable[[Record, Signals, Array], Sequence[Params]]:
    """Shapes of a heat that follows a power of a signal about its mean while the machine runs."""

    def shapes(record: Record, signals: Signals, _smooth: Array) -> Sequence[Params]:
        reference = max(_reference(record, held(record, signals[role]), running=True), 1e-9)
        return [{"reference": reference, "power": power} for power in powers]

    return shapes


def _level_drive(role: str) -> Drive:
    def drive(record: Record, signals: Signals, params: Mapping[str, float], _course: Array) -> tuple[Array, Array]:
        power = params["power"]
        column = held(record, signals[role])
        raised = column if power == 1.0 else np.maximum(column, 0.0) ** power
        return _none(record), record.running * (raised - params["reference"] ** power)

    return drive


def _saturation(record: Record, signals: Signals, _smooth: Array) -> Sequence[Params]:
    on = held(record, signals["current"])[record.running > 0.5]
    return [{"knee": float(np.quantile(on, share))} for share in (0.3, 0.5, 0.65, 0.8, 0.9)] if on.size else []


def _saturation_drive(
    record: Record, signals: Signals, params: Mapping[str, float], _course: Array
) -> tuple[Array, Array]:
    beyond = np.maximum(held(record, signals["current"]) - params["knee"], 0.0)
    return _none(record), -record.running * beyond


def _ambient(record: Record, signals: Signals, _smooth: Array) -> Sequence[Params]:
    reference = _reference(record, held(record, signals["ambient"]), running=False)
    return [{"reference": reference, "lag": lag} for lag in (0.0, 1800.0, 7200.0)]


def _ambient_drive(
    record: Record, signals: Signals, params: Mapping[str, float], _course: Array
) -> tuple[Array, Array]:
    column = lagged(record, held(record, signals["ambient"]), params["lag"])
    return _none(record), column - params["reference"]


def _one_shape(_record: Record, _signals: Signals, _smooth: Array) -> Sequence[Params]:
    return [{}]


def _feed_drive(record: Record, signals: Signals, _params: Mapping[str, float], _course: Array) -> tuple[Array, Array]:
    flows = held(record, signals["pump"]) if "pump" in signals else record.running
    return flows, flows * held(record, signals["feed"])


def _cold(smooth: Array) -> float:
    """degC of the bearing at rest."""
    return float(np.quantile(smooth, 0.02))


def _pump(_record: Record, _signals: Signals, smooth: Array) -> Sequence[Params]:
    cold, span = _cold(smooth), float(np.ptp(smooth))
    return [{"sink": sink} for sink in (cold - 10.0 * span, cold - 0.5 * span, cold, cold + 0.3 * span)]


def _pump_drive(record: Record, signals: Signals, params: Mapping[str, float], _course: Array) -> tuple[Array, Array]:
    pump = held(record, signals["pump"])
    return pump, pump * params["sink"]


def _housing(_record: Record, _signals: Signals, _smooth: Array) -> Sequence[Params]:
    return [{"tau": tau} for tau in (900.0, 1800.0, 3600.0, 7200.0, 14400.0)]


def _housing_drive(
    record: Record, _signals: Signals, params: Mapping[str, float], course: Array
) -> tuple[Array, Array]:
    return np.ones(len(record.runs)), lagged(record, course, params["tau"])


def _startup(_record: Record, _signals: Signals, _smooth: Array) -> Sequence[Params]:
    taus, forms = (60.0, 120.0, 240.0, 480.0, 960.0), (0.5, 1.0, 2.0)
    return [{"tau": tau, "shape": shape} for tau, shape in product(taus, forms)]


def _startup_drive(
    record: Record, _signals: Signals, params: Mapping[str, float], _course: Array
) -> tuple[Array, Array]:
    age = record.since + record.runs.dt / 2.0
    decay = np.exp(-np.minimum((age / params["tau"]) ** params["shape"], 700.0))
    return _none(record), record.running * decay


def _wear(record: Record, _signals: Signals, _smooth: Array) -> Sequence[Params]:
    begin, end = float(record.runs.time[0]), float(record.runs.time[-1])
    return [{"since": begin + share * (end - begin)} for share in (0.0, 0.2, 0.4, 0.6)]


def _wear_drive(record: Record, _signals: Signals, params: Mapping[str, float], _course: Array) -> tuple[Array, Array]:
    return _none(record), record.running * np.maximum(record.runs.time - params["since"], 0.0)


def _dead_time(_record: Record, _signals: Signals, _smooth: Array) -> Sequence[Params]:
    return [{"delay": delay} for delay in (10.0, 20.0, 40.0, 80.0, 160.0)]


def _sense_delay(record: Record, params: Mapping[str, float], course: Array) -> Array:
    return delayed(record, course, params["delay"])


def _sensor_lag(_record: Record, _signals: Signals, _smooth: Array) -> Sequence[Params]:
    return [{"tau": tau, "order": order} for tau, order in product((15.0, 30.0, 60.0, 120.0, 240.0, 480.0), (1.0, 2.0))]


def _sense_lag(record: Record, params: Mapping[str, float], course: Array) -> Array:
    order = round(params["order"])
    for _ in range(order):
        course = lagged(record, course, params["tau"] / order)
    return course


def _offset_step(record: Record, _signals: Signals, _smooth: Array) -> Sequence[Params]:
    time = record.runs.time
    return [{"at": float(time[int(share * time.size)])} for share in np.arange(0.05, 0.96, 0.1).tolist()]


def _jumps(record: Record, pull: Array) -> Sequence[Params]:
    """The moments from which an offset would lower the misfit most: extremes of the pull summed to the end."""
    summed = np.abs(np.cumsum(pull[::-1])[::-1])
    times = record.times
    found: list[int] = []
    for place in np.argsort(-summed, kind="stable").tolist():
        if all(abs(place - other) > JUMP_APART for other in found):
            found.append(place)
        if len(found) == JUMPS:
            break
    return [{"at": float(times[place])} for place in found]


def _sense_offset(record: Record, params: Mapping[str, float], course: Array) -> Array:
    return course + params["size"] * (record.runs.time >= params["at"])


def _thermostat(record: Record, _signals: Signals, smooth: Array) -> Sequence[Params]:
    running = record.running > 0.5
    cold = _cold(smooth)
    span = float(np.quantile(smooth[running] if running.any() else smooth, 0.98)) - cold
    return [
        {"opens": cold + share * span, "closes": cold + (share - width) * span, "sink": cold}
        for share, width in product((0.4, 0.55, 0.7, 0.8, 0.9), (0.03, 0.1, 0.2))
    ]


def _thermostat_drive(
    record: Record, _signals: Signals, params: Mapping[str, float], course: Array
) -> tuple[Array, Array]:
    opened = hysteresis(course, params["opens"], params["closes"], record.runs.first)
    return opened, opened * params["sink"]


def _radiation(_record: Record, _signals: Signals, smooth: Array) -> Sequence[Params]:
    return [{"surroundings": _cold(smooth)}]


def _radiation_drive(
    record: Record, signals: Signals, params: Mapping[str, float], course: Array
) -> tuple[Array, Array]:
    """The tangent of the fourth power at the course: exact on it, of second order about it."""
    around = held(record, signals["ambient"]) if "ambient" in signals else np.full(course.size, params["surroundings"])
    kelvin = course + KELVIN
    loss = 4.0 * kelvin**3
    return loss, (around + KELVIN) ** 4 - kelvin**4 + loss * course


CATALOGUE: tuple[Entry, ...] = (
    Entry(
        "current-heating",
        "gain",
        1.0,
        ("current",),
        (),
        _level("current", (1.0,)),
        "heat that grows with the current inside a bin of the current",
        "hold two currents inside one bin for half an hour each",
        drive=_level_drive("current"),
    ),
    Entry(
        "quadratic-current-heating",
        "gain",
        1.0,
        ("current",),
        (),
        _level("current", (2.0,)),
        "heat that grows with the square of the current",
        "dwell at three currents or more, each until the temperature settles",
        drive=_level_drive("current"),
    ),
    Entry(
        "current-saturation",
        "gain",
        1.0,
        ("current",),
        (),
        _saturation,
        "above some current the heat grows no further with it",
        "dwell at three currents or more, two of them near the highest",
        drive=_saturation_drive,
        refine={"knee": (10.0, 350.0)},
    ),
    Entry(
        "torque-friction",
        "gain",
        1.0,
        ("torque",),
        (),
        _level("torque", (1.0, 2.0)),
        "friction heat that follows the torque",
        "change the speed at constant torque, then the torque at constant speed",
        drive=_level_drive("torque"),
        refine={"power": (0.5, 3.0)},
    ),
    Entry(
        "speed-friction",
        "gain",
        1.0,
        ("speed",),
        (),
        _level("speed", (1.0, 2.0)),
        "friction heat that follows the speed",
        "change the speed at constant torque",
        drive=_level_drive("speed"),
        refine={"power": (0.5, 3.0)},
    ),
    Entry(
        "vibration-friction",
        "gain",
        1.0,
        ("vibration",),
        (),
        _level("vibration", (1.0, 2.0)),
        "heat that follows the vibration",
        "change the speed at constant torque and watch whether heat goes with the vibration alone",
        drive=_level_drive("vibration"),
        refine={"power": (0.5, 3.0)},
    ),
    Entry(
        "ambient-coupling",
        "gain",
        1.0,
        ("ambient",),
        (),
        _ambient,
        "the bearing follows the room's temperature",
        "log the room for three days, with a night at rest",
        drive=_ambient_drive,
        refine={"lag": (0.0, 20000.0)},
    ),
    Entry(
        "feed-temperature-coupling",
        "loss",
        1.0,
        ("feed",),
        ("pump",),
        _one_shape,
        "the slurry that is fed draws the bearing towards its own temperature",
        "feed at two temperatures at one load",
        drive=_feed_drive,
    ),
    Entry(
        "pump-cooling",
        "loss",
        1.0,
        ("pump",),
        (),
        _pump,
        "the slurry pump cools the bearing while it runs",
        "run for half an hour at one load with the pump on, then off",
        drive=_pump_drive,
        refine={"sink": (-1000.0, 100.0)},
    ),
    Entry(
        "housing-thermal-mass",
        "coupling",
        1.0,
        (),
        (),
        _housing,
        "a second mass (the housing) stores heat and gives it back",
        "log the room, three days, or the second bearing: a housing lags, a room does not",
        drive=_housing_drive,
        refine={"tau": (300.0, 40000.0)},
    ),
    Entry(
        "startup-churning",
        "gain",
        1.0,
        (),
        (),
        _startup,
        "extra heat after each start that dies away (grease being churned)",
        "start twice within an hour, at the same load",
        drive=_startup_drive,
        refine={"tau": (20.0, 3000.0), "shape": (0.5, 3.0)},
    ),
    Entry(
        "wear-drift",
        "gain",
        1.0,
        (),
        (),
        _wear,
        "friction that grows from day to day",
        "compare a reading at long rest before and after: a sensor that moved shows it there, wear does not",
        drive=_wear_drive,
    ),
    Entry(
        "dead-time",
        "delay",
        1.0,
        (),
        (),
        _dead_time,
        "heat reaches the sensor only after a dead time",
        "one sharp step of the current, logged at 1 Hz",
        sense=_sense_delay,
        refine={"delay": (1.0, 600.0)},
    ),
    Entry(
        "sensor-lag",
        "tau",
        1.0,
        (),
        (),
        _sensor_lag,
        "the sensor follows the bearing with a lag",
        "one sharp step of the current, logged at 1 Hz",
        sense=_sense_lag,
        refine={"tau": (2.0, 1500.0)},
    ),
    Entry(
        "sensor-offset-step",
        "size",
        0.0,
        (),
        (),
        _offset_step,
        "from some moment on the sensor reads higher or lower by a constant",
        "a reading at long rest, against a second thermometer",
        sense=_sense_offset,
        scan=_jumps,
        burden=7.5,
    ),
    Entry(
        "thermostatic-cooling",
        "loss",
        1.0,
        (),
        (),
        _thermostat,
        "a cooling that switches on above one temperature and off below another",
        "a slow ramp of the load up and down: a hysteresis loop",
        drive=_thermostat_drive,
        refine={"opens": (-50.0, 200.0), "closes": (-50.0, 200.0)},
    ),
    Entry(
        "radiation-loss",
        "gain",
        1.0,
        (),
        ("ambient",),
        _radiation,
        "a loss that grows faster than the temperature difference",
        "a slow ramp of the load up and down: no loop, but a bend",
        drive=_radiation_drive,
    ),
)
NAMES = tuple(entry.name for entry in CATALOGUE)


def signals_of(entry: Entry, present: Mapping[str, str]) -> dict[str, str] | None:
    """role -> signal for an entry from the roles that are `present`; None where a needed one is missing."""
    if any(role not in present for role in entry.needs):
        return None
    return {role: present[role] for role in (*entry.needs, *entry.may) if role in present}
