"""The forms of the effects: shapes to be tried, heats and losses along a course, what a sensor makes of one."""

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise, product

import numpy as np

from sim.discrepancy.fitting.record import Record
from sim.engine.recursion import linear_recursion
from sim.sha.trace import Array, Mask

KELVIN = 273.15
BLURRED = 2
"""First-order lags that a blurred delay is followed by."""
JUMPS, JUMP_APART = 16, 5
"""Moments at which an offset is looked for besides the regular ones, and windows between them."""

Params = dict[str, float]
Signals = Mapping[str, str]
Drive = Callable[[Record, Signals, Mapping[str, float], Array], tuple[Array, Array]]
Sense = Callable[[Record, Mapping[str, float], Array], Array]


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


def level(role: str, powers: tuple[float, ...]) -> Callable[[Record, Signals, Array], Sequence[Params]]:
    """Shapes of a heat that follows a power of a signal about its mean while the machine runs."""

    def shapes(record: Record, signals: Signals, _smooth: Array) -> Sequence[Params]:
        reference = max(_reference(record, held(record, signals[role]), running=True), 1e-9)
        return [{"reference": reference, "power": power} for power in powers]

    return shapes


def level_drive(role: str) -> Drive:
    def drive(record: Record, signals: Signals, params: Mapping[str, float], _course: Array) -> tuple[Array, Array]:
        power = params["power"]
        column = held(record, signals[role])
        raised = column if power == 1.0 else np.maximum(column, 0.0) ** power
        return _none(record), record.running * (raised - params["reference"] ** power)

    return drive


def saturation(record: Record, signals: Signals, _smooth: Array) -> Sequence[Params]:
    on = held(record, signals["current"])[record.running > 0.5]
    return [{"knee": float(np.quantile(on, share))} for share in (0.3, 0.5, 0.65, 0.8, 0.9)] if on.size else []


def saturation_drive(
    record: Record, signals: Signals, params: Mapping[str, float], _course: Array
) -> tuple[Array, Array]:
    beyond = np.maximum(held(record, signals["current"]) - params["knee"], 0.0)
    return _none(record), -record.running * beyond


def ambient(record: Record, signals: Signals, _smooth: Array) -> Sequence[Params]:
    return [{"reference": _reference(record, held(record, signals["ambient"]), running=False)}]


def ambient_drive(record: Record, signals: Signals, params: Mapping[str, float], _course: Array) -> tuple[Array, Array]:
    return _none(record), held(record, signals["ambient"]) - params["reference"]


def one_shape(_record: Record, _signals: Signals, _smooth: Array) -> Sequence[Params]:
    return [{}]


def feed_drive(record: Record, signals: Signals, _params: Mapping[str, float], _course: Array) -> tuple[Array, Array]:
    flows = held(record, signals["pump"]) if "pump" in signals else record.running
    return flows, flows * held(record, signals["feed"])


def _cold(smooth: Array) -> float:
    """degC of the bearing at rest."""
    return float(np.quantile(smooth, 0.02))


def pump(_record: Record, _signals: Signals, smooth: Array) -> Sequence[Params]:
    cold, span = _cold(smooth), float(np.ptp(smooth))
    return [{"sink": sink} for sink in (cold - 10.0 * span, cold - 0.5 * span, cold, cold + 0.3 * span)]


def pump_drive(record: Record, signals: Signals, params: Mapping[str, float], _course: Array) -> tuple[Array, Array]:
    pump = held(record, signals["pump"])
    return pump, pump * params["sink"]


def housing(_record: Record, _signals: Signals, _smooth: Array) -> Sequence[Params]:
    return [{"tau": tau} for tau in (900.0, 1800.0, 3600.0, 7200.0, 14400.0)]


def housing_drive(record: Record, _signals: Signals, params: Mapping[str, float], course: Array) -> tuple[Array, Array]:
    return np.ones(len(record.runs)), lagged(record, course, params["tau"])


def startup(_record: Record, _signals: Signals, _smooth: Array) -> Sequence[Params]:
    taus, forms = (60.0, 120.0, 240.0, 480.0, 960.0), (0.5, 1.0, 2.0)
    return [{"tau": tau, "shape": shape} for tau, shape in product(taus, forms)]


def startup_drive(
    record: Record, _signals: Signals, params: Mapping[str, float], _course: Array
) -> tuple[Array, Array]:
    age = record.since + record.runs.dt / 2.0
    decay = np.exp(-np.minimum((age / params["tau"]) ** params["shape"], 700.0))
    return _none(record), record.running * decay


def wear(record: Record, _signals: Signals, _smooth: Array) -> Sequence[Params]:
    begin, end = float(record.runs.time[0]), float(record.runs.time[-1])
    return [{"since": begin + share * (end - begin)} for share in (0.0, 0.2, 0.4, 0.6)]


def wear_drive(record: Record, _signals: Signals, params: Mapping[str, float], _course: Array) -> tuple[Array, Array]:
    return _none(record), record.running * np.maximum(record.runs.time - params["since"], 0.0)


def dead_time(_record: Record, _signals: Signals, _smooth: Array) -> Sequence[Params]:
    """A sharp delay, and delays that blur what they carry by the lags of mixed vessels."""
    delays = (10.0, 20.0, 40.0, 80.0, 160.0, 320.0)
    return [{"delay": delay, "blur": blur} for delay, blur in product(delays, (0.0, 0.7, 1.4))]


def sense_delay(record: Record, params: Mapping[str, float], course: Array) -> Array:
    course = delayed(record, course, params["delay"])
    blur = params.get("blur", 0.0) * params["delay"]
    return sense_lag(record, {"tau": blur, "order": BLURRED}, course) if blur > 0 else course


def sensor_lag(_record: Record, _signals: Signals, _smooth: Array) -> Sequence[Params]:
    return [{"tau": tau, "order": order} for tau, order in product((15.0, 30.0, 60.0, 120.0, 240.0, 480.0), (1.0, 2.0))]


def sense_lag(record: Record, params: Mapping[str, float], course: Array) -> Array:
    order = round(params["order"])
    for _ in range(order):
        course = lagged(record, course, params["tau"] / order)
    return course


def offset_step(record: Record, _signals: Signals, _smooth: Array) -> Sequence[Params]:
    time = record.runs.time
    return [{"at": float(time[int(share * time.size)])} for share in np.arange(0.05, 0.96, 0.1).tolist()]


def jumps(record: Record, pull: Array) -> Sequence[Params]:
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


def sense_offset(record: Record, params: Mapping[str, float], course: Array) -> Array:
    return course + params["size"] * (record.runs.time >= params["at"])


def thermostat(record: Record, _signals: Signals, smooth: Array) -> Sequence[Params]:
    running = record.running > 0.5
    cold = _cold(smooth)
    span = float(np.quantile(smooth[running] if running.any() else smooth, 0.98)) - cold
    return [
        {"opens": cold + share * span, "closes": cold + (share - width) * span, "sink": cold}
        for share, width in product((0.4, 0.55, 0.7, 0.8, 0.9), (0.03, 0.1, 0.2))
    ]


def thermostat_drive(
    record: Record, _signals: Signals, params: Mapping[str, float], course: Array
) -> tuple[Array, Array]:
    first = record.runs.first
    opened = hysteresis(course, params["opens"], params["closes"], first)
    # A step later, as causes are: a valve that moved within the step could close itself by opening, and no course
    # would stand still.
    opened = np.where(first, 0.0, np.concatenate([opened[:1], opened[:-1]]))
    return opened, opened * params["sink"]


def radiation(_record: Record, signals: Signals, smooth: Array) -> Sequence[Params]:
    """Against walls of one temperature, or against the room's where it is measured."""
    return [
        {"surroundings": _cold(smooth), "walls": walls} for walls in ((1.0, 0.0) if "ambient" in signals else (1.0,))
    ]


def radiation_drive(
    record: Record, signals: Signals, params: Mapping[str, float], course: Array
) -> tuple[Array, Array]:
    """The tangent of the fourth power at the course: exact on it, of second order about it."""
    room = "ambient" in signals and not params.get("walls", 0.0)
    around = held(record, signals["ambient"]) if room else np.full(course.size, params["surroundings"])
    kelvin = course + KELVIN
    loss = 4.0 * kelvin**3
    return loss, (around + KELVIN) ** 4 - kelvin**4 + loss * course
