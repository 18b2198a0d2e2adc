"""The law of effects over a record: the heat and the loss of each step, and what a sensor makes of a course.

The laws are those of `sim.effects`, which the automaton executes too. Here each is held over a step of the record (at
the step's middle where it varies by itself), while the automaton's own engine is exact inside a step: over steps that
are short against the plant's time constants both have one course (`tests/effects` has by how much they differ).
"""

from collections.abc import Iterable, Mapping
from itertools import pairwise

import numpy as np

from sim.effects import (
    HeldLaw,
    RecordedLaw,
    RecordView,
    Structural,
    VaryingLaw,
    affects_location,
    delay_of,
    effect_kind,
    heat_lag,
    in_scale_of_x,
    is_gradual,
    late_jumps,
    late_mean,
    late_source,
    radiation_tangent,
    remaining_share,
    unknown,
)
from sim.engine import linear_recursion
from sim.lab.discrepancy.fitting.record import Record
from sim.lab.learning import RATE_PARAMETERS
from sim.sha import Array, Effect, Mask

SENSOR_FEATURES = ("dead time", "sensor lag", "sensor offset")
"""Features that act between the temperature and its reading."""


def on_sensor(effect: Effect) -> bool:
    """Whether an effect acts between the temperature and its reading, and so has no heat."""
    law = effect_kind(effect).law
    return isinstance(law, Structural) and law.feature in SENSOR_FEATURES


def follows_course(effect: Effect) -> bool:
    """Whether an effect's heat or loss depends on the temperature itself."""
    return isinstance(effect_kind(effect).law, Structural) and not on_sensor(effect)


def net_heat(record: Record, effects: Iterable[Effect], course: Array) -> Array:
    """(n,) degC/s by which effects heat, less what they lose, along a course (n,) degC."""
    total = np.zeros(len(record.runs))
    for effect in effects:
        heat, loss = heat_and_loss(record, effect, course)
        total += heat - loss * course
    return total


def heat_and_loss(record: Record, effect: Effect, course: Array) -> tuple[Array, Array]:
    """(heat, loss) of each step (n,), degC/s and 1/s, as dX/dt += heat - loss X along a course (n,) degC.

    Nothing acts outside the effect's locations but what comes late, or before its signals were read. Raises ValueError,
    naming the kind, for a law that is not known here.
    """
    runs = record.runs
    signals = {name: record.signal(name) for name in effect.signals.values()}
    nothing = np.zeros(len(runs))
    match effect_kind(effect).law:
        case HeldLaw() as law:
            heat, loss = law.heat_and_loss(effect, signals)
        case VaryingLaw() as law:
            middle = runs.dt / 2.0
            heat, loss = law.heat(effect, runs.time - middle, record.since + middle), nothing
        case RecordedLaw() as law:
            heat, loss = law.heat_and_loss(effect, _view(record, effect))
        case Structural(feature="housing"):
            coupling, tau = effect.params["coupling"], effect.params["tau"]
            heat, loss = coupling * lag_column(record, course, tau, housing_starts(record, tau)), nothing + coupling
        case Structural(feature="thermostat"):
            if is_gradual(effect):
                opened = (course > effect.params["opens"]).astype(float)
            else:
                opened = hysteresis(course, effect.params["opens"], effect.params["closes"], runs.first)
                # A step later, as causes are: a valve that moved within the step could close itself by opening, and no
                # course would stand still.
                opened = np.where(runs.first, 0.0, np.concatenate([opened[:1], opened[:-1]]))
            loss = effect.params["loss"] * opened
            heat = loss * effect.params["sink"]
        case Structural(feature="radiation"):
            room = "ambient" in effect.signals
            around = in_scale_of_x(effect, "ambient", signals) if room else nothing + effect.params["surroundings"]
            loss, heat = radiation_tangent(effect, gain=effect.params["gain"], about=course, around=around)
        case law:
            raise unknown("a diagnosis", effect.kind, law)
    acting = np.isfinite(heat)
    if loss is not nothing:
        acting &= np.isfinite(loss)
    if effect.locations:
        acting &= _location_mask(record, effect)
    heat = np.where(acting, heat, 0.0)
    if heat_lag(effect) > 0:
        heat += deviation(record, effect)
    return heat, nothing if loss is nothing else np.where(acting, loss, 0.0)


def _location_mask(record: Record, effect: Effect) -> Mask:
    """(n,) where an effect's locations are."""
    acting = np.array([affects_location(effect, location.name) for location in record.model.sha.locations])
    return np.asarray(acting[record.runs.place])


def housing_coupling(record: Record, effect: Effect) -> Array:
    """(n,) 1/s the coupling of a housing in each step, 0 where it does not act."""
    return np.asarray(np.where(_location_mask(record, effect), effect.params["coupling"], 0.0))


def _view(record: Record, effect: Effect) -> RecordView:
    """What a law that only a diagnosis knows may read of a record."""
    runs = record.runs
    return RecordView(
        time=runs.time - runs.dt / 2.0,
        running=record.running,
        rate=stated_rate(record),
        signals={role: record.signal(signal) for role, signal in effect.signals.items()},
        late=lambda role, lag: lagged_signal(record, np.nan_to_num(record.history(effect.signals[role])), lag),
        run_since=lambda at: record.ran[record.kept] - np.interp(at, record.uncut.time, record.ran),
    )


def stated_rate(record: Record) -> Array:
    """(n,) 1/s the rate of each step's flow as the given model has it, 0 where it does not relax."""
    flows = (location.flow for location in record.model.sha.locations)
    rates = [flow.params["k"] if RATE_PARAMETERS.get(flow.kind) == "k" else 0.0 for flow in flows]
    return np.array(rates)[record.runs.place]


def deviation(record: Record, effect: Effect) -> Array:
    """(n,) degC/s: the mean over each step of what comes late (`sim.effects.late`), nothing where the traces begin.

    It follows from the signals alone, so it runs on through what was cut: over other cycles, and those held out.
    """
    return _late(record, effect, {name: record.history(name) for name in effect.signals.values()})


def late_inrush(record: Record, effect: Effect) -> Array:
    """(n,) degC/s: what comes late of that which starts draw in their first seconds (`Record.rushed`), beyond what they
    draw after them."""
    rushed = np.zeros(len(record.uncut), dtype=bool)
    rushed[record.kept] = record.rushed
    settled = np.flatnonzero(~rushed)
    after = settled[np.minimum(np.searchsorted(settled, np.arange(rushed.size)), settled.size - 1)]
    signals = {name: record.history(name) for name in effect.signals.values()}
    quiet = {name: np.where(rushed, column[after], column) for name, column in signals.items()}
    return _late(record, effect, signals) - _late(record, effect, quiet)


def _late(record: Record, effect: Effect, signals: Mapping[str, Array]) -> Array:
    uncut = record.uncut
    source = late_source(effect, {name: _hold_column(record, column) for name, column in signals.items()})
    jumps = late_jumps(np.concatenate([source[:1], source[:-1]]), source)
    jumps = np.where(uncut.first, 0.0, jumps)
    waiting = np.zeros(len(uncut))
    if delay_of(effect) > 0:
        jumped = linear_recursion(np.where(uncut.first, 0.0, 1.0), jumps, 0.0)
        due = _mean_before(record, jumped, delay_of(effect))
        waiting, jumps = jumped - due, np.where(uncut.first, 0.0, np.diff(due, prepend=0.0))
    kept = np.concatenate([[0.0], remaining_share(effect, uncut.dt[:-1])])
    begins = linear_recursion(np.where(uncut.first, 0.0, kept), jumps, 0.0)
    return np.asarray((begins * late_mean(effect, uncut.dt) + waiting)[record.kept])


def _mean_before(record: Record, column: Array, delay: float) -> Array:
    """(N,) the mean over each step of what a column (N,) held over the steps was `delay` s before; 0 before a trace."""
    uncut = record.uncut
    out = np.zeros(column.size)
    for begin, end in pairwise([*np.flatnonzero(uncut.first).tolist(), column.size]):
        part = slice(begin, end)
        ends, lengths = uncut.time[part], np.maximum(uncut.dt[part], 1e-9)
        whole = np.cumsum(column[part] * lengths)
        clock, total = np.append(ends[0] - lengths[0], ends), np.append(0.0, whole)
        earlier = np.interp(clock - delay, clock, total)
        out[part] = np.diff(earlier) / lengths
    return out


def _hold_column(record: Record, column: Array) -> Array:
    """A column (N,) held over each step of `Record.uncut`, where a run begins as it is from there on.

    Where the traces have a gap the last value before it stands there, and when in the gap it changed is not known:
    taken for a step of the first row after it, what comes late of the change would come when it is long over.
    """
    begins = np.flatnonzero(record.uncut.first[:-1])
    out = column.copy()
    out[begins] = column[begins + 1]
    return out


def sense_course(record: Record, effect: Effect, course: Array) -> Array:
    """The course (n,) degC as it is read through an effect that acts between temperature and reading."""
    match effect_kind(effect).law:
        case Structural(feature="dead time"):
            return delay_course(record, course, effect.params["delay"])
        case Structural(feature="sensor lag"):
            order = round(effect.params["order"])
            for _ in range(order):
                course = lag_column(record, course, effect.params["tau"] / order)
            return course
        case Structural(feature="sensor offset"):
            return course + effect.params["size"] * (record.runs.time >= effect.params["at"])
        case law:
            raise unknown("a diagnosis", effect.kind, law)


def hold_signal(record: Record, name: str) -> Array:
    """(n,) a signal over each step, its mean where it was never read yet."""
    column = record.signal(name)
    known = np.isfinite(column)
    return np.where(known, column, float(np.mean(column[known])) if known.any() else 0.0)


def lag_column(record: Record, column: Array, lag: float, starts: Array | None = None) -> Array:
    """A column (n,) through a first-order lag (s), in each run from its first value, or from that of `starts` (n,)."""
    if lag <= 0:
        return column
    runs = record.runs
    keep = np.where(runs.first, 0.0, np.exp(-runs.dt / lag))
    pushed = (1.0 - keep) * column
    return linear_recursion(keep, pushed if starts is None else np.where(runs.first, starts, pushed), 0.0)


def housing_starts(record: Record, tau: float) -> Array:
    """(n,) degC of a housing of time constant `tau` (s) at each knot, as the readings up to there have warmed it.

    A run may begin where a record is cut, or held-out cycles are: the housing is then as warm as what came before has
    left it. It begins with the first reading of all, and over a gap the temperature is taken to go straight on.
    """
    uncut = record.uncut
    read = np.isfinite(uncut.reading)
    time, reading = uncut.time[read], uncut.reading[read]
    # Exact for a temperature that goes straight from reading to reading (first-order hold).
    passed = np.diff(time, prepend=time[:1]) / tau
    keep = np.exp(-passed)
    mean = np.where(passed > 1e-8, -np.expm1(-passed) / np.where(passed > 1e-8, passed, 1.0), 1.0)
    before = np.concatenate([reading[:1], reading[:-1]])
    pushed = reading - keep * before - (reading - before) * mean
    pushed[0], keep[0] = reading[0], 0.0
    return np.interp(record.runs.time, time, linear_recursion(keep, pushed, 0.0))


def lagged_signal(record: Record, column: Array, lag: float) -> Array:
    """(n,) a column (N,) of `Record.uncut` through a first-order lag (s), from its first value in each trace on."""
    if lag <= 0:
        return np.asarray(column[record.kept])
    uncut = record.uncut
    keep = np.where(uncut.first, 0.0, np.exp(-uncut.dt / lag))
    pushed = (1.0 - keep) * _hold_column(record, column)
    return np.asarray(linear_recursion(keep, pushed, 0.0)[record.kept])


def delay_course(record: Record, column: Array, delay: float) -> Array:
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
    decided = np.where(course >= opens, 1, np.where(course <= closes, 0, -1))
    decided = np.where(first & (decided < 0), 0, decided)
    last = np.maximum.accumulate(np.where(decided >= 0, np.arange(decided.size), 0))
    return np.maximum(decided[last], 0).astype(float)
