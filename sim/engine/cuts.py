"""Where stays must be cut into segments, besides events, outputs and changed signals, for the stated accuracy.

A heat that varies by itself is cut at the knots of its law, a drive that fades with the age where it has fallen by a
fifth, what comes late at steps that grow as it fades: between two cuts each is close to a parabola (`terms`). Where
thermostat or radiation act no segment is longer than a part of the fastest time constant of X there (`longest`), which
bounds what a tangent or a missed excursion can be wrong by.
"""

from dataclasses import dataclass
from math import exp

import numpy as np

from sim.effects import ABSOLUTE_ZERO, SETTLED_LAGS, VaryingLaw, effect_kind, heat_lag, parameter, unknown
from sim.engine.plant import Acting, Indices, Plant
from sim.engine.terms import held_terms
from sim.sha import Array, Effect, flows

_FALL, _FALLS = 1.25, 160
"""By how much a drive that fades has fallen from one cut to the next, and after how many there is nothing left of it: a
share of 1e-15."""
_LATE, _SLOWER = 0.25, 3.0
"""The first segment after a change of what comes late, in lags, and in how many lags the segments grow by a factor e:
their error goes with the third power of their length."""
_SWITCHED, _RADIATING = 0.2, 0.1
"""Parts of X's fastest time constant that a segment is long at most, under a thermostat and under radiation."""
_WARM_K = 100.0 - ABSOLUTE_ZERO
"""The temperature (K) at which radiation's speed is taken."""


def _fade_cuts() -> Array:
    ages, age = [0.0], _LATE
    while age < SETTLED_LAGS:
        ages.append(age)
        age += _LATE * exp(age / _SLOWER)
    return np.array(ages)


_FADE_LAGS = _fade_cuts()
"""The ages, in lags, at which what comes late is cut from where it begins to fade."""


@dataclass(frozen=True, slots=True)
class Stays:
    """S stays one after the other: begin, end and entry in absolute s, location; each (S,).

    `starts` has for each start-up effect the ascending times of its event, `changed` for each late one those (absolute
    s) at which a change of its source begins to fade.
    """

    begins: Array
    ends: Array
    entered: Array
    location: Indices
    starts: tuple[Array, ...]
    changed: tuple[Array, ...]


def cuts(plant: Plant, stays: Stays) -> Array:
    """The times (s) inside the stays at which a segment must end; in no order, some perhaps twice."""
    times = [np.empty(0)]
    for acting, starts in zip(plant.startups, stays.starts, strict=True):
        times.append(_acting_times(_knots(acting.effect, starts), stays, acting))
    for acting in plant.wears:
        times.append(_acting_times(_knots(acting.effect, np.empty(0)), stays, acting))
    for effect, changed in zip(plant.late, stays.changed, strict=True):
        ages = heat_lag(effect) * _FADE_LAGS
        # From one change to the next: what was before it has been cut so finely already, and is in D with it.
        row, cut = _expand_ranges(
            np.zeros(changed.size, dtype=np.intp),
            np.searchsorted(ages, np.diff(changed, append=stays.ends[-1:]), side="left"),
        )
        times.append(changed[row] + ages[cut])
    for index in plant.fading:
        flow = plant.sha.locations[index].flow
        rows = np.flatnonzero((stays.location == index) & (stays.ends > stays.begins))
        # The ages of the cuts are the same for all stays in a location, so that equal segments recur and are worked out
        # once.
        ages = flows.fade_ages(flow, _FALL ** -np.arange(1.0, _FALLS))
        first = np.searchsorted(ages, stays.begins[rows] - stays.entered[rows], side="right")
        last = np.searchsorted(ages, stays.ends[rows] - stays.entered[rows], side="left")
        stay, cut = _expand_ranges(first, last)
        times.append(stays.entered[rows][stay] + ages[cut])
    if not plant.linear:
        # Multiples of the longest segment from each stay's begin on.
        length = longest(plant)[stays.location]
        count = np.ceil((stays.ends - stays.begins) / length).astype(int)
        stay, multiple = _expand_ranges(np.ones_like(count), count)
        times.append(stays.begins[stay] + multiple * length[stay])
    return np.concatenate(times)


def _knots(effect: Effect, starts: Array) -> Array:
    law = effect_kind(effect).law
    if not isinstance(law, VaryingLaw):
        raise unknown("the cutting of stays", effect.kind, law)
    return law.knots(effect, starts)


def _acting_times(times: Array, stays: Stays, acting: Acting) -> Array:
    """Those inside a stay in which the effect acts."""
    place = np.searchsorted(stays.begins, times, side="right") - 1
    inside = (place >= 0) & (times > stays.begins[place]) & (times < stays.ends[place])
    return times[inside & acting.mask[stays.location[place]]]


def _expand_ranges(first: Indices, last: Indices) -> tuple[Indices, Indices]:
    """For each row i the numbers first[i] <= number < last[i]: (row, number) one after the other."""
    counts = np.maximum(last - first, 0)
    row = np.repeat(np.arange(counts.size), counts)
    number = np.arange(row.size) - np.repeat(np.cumsum(counts) - counts, counts) + first[row]
    return row, number


def longest(plant: Plant) -> Array:
    """(L,) the longest segment (s) by location; inf where neither thermostat nor radiation acts."""
    speed, part = fastest(plant), np.full(plant.rate.size, np.inf)
    if plant.radiation is not None:
        part[plant.radiation.mask] = _RADIATING
    if plant.thermostat is not None:
        part[plant.thermostat.mask] = np.minimum(part, _SWITCHED)[plant.thermostat.mask]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(speed > 0, part / speed, np.inf)


def fastest(plant: Plant) -> Array:
    """(L,) the greatest relaxation rate of X (1/s) by location, with every signal at 1 and every valve open."""
    speed = plant.rate + plant.couplings[:, 0]
    for acting in plant.steady:
        # A pump's signal is 0 to 1: at 1 its loss is the parameter itself.
        _, loss = held_terms(acting.effect, {name: np.ones(1) for name in acting.effect.signals.values()})
        speed = speed + acting.mask * loss
    if plant.thermostat is not None:
        speed = speed + plant.thermostat.mask * plant.thermostat.effect.params["loss"]
    if plant.radiation is not None:
        effect = plant.radiation.effect
        warm = _WARM_K * parameter(effect, "scale")
        speed = speed + plant.radiation.mask * 4.0 * effect.params["gain"] * warm**3
    return speed
