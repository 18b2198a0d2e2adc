"""What flows and effects do in each segment: its loss and its heat, from signals, ages and time.

Inside a segment a varying heat (start-up, wear, what comes late, the drive of a flow that fades) is the parabola
through its values at the three Gauss points, which is exact to the sixth order of the segment's length where the loss
is slow, and no worse than the parabola's own error where it is fast. `cuts` makes the segments short enough for that.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sim.effects import HeldLaw, VaryingLaw, effect_kind, remaining_share, unknown
from sim.engine.plant import Indices, Plant
from sim.sha import Array, Effect, Mask, flows

GAUSS_POINTS = 0.5 + np.array([-1.0, 0.0, 1.0]) * np.sqrt(0.15)
"""The three Gauss points of a segment, as parts of its length."""

_TO_POWERS = np.linalg.inv(np.vander(GAUSS_POINTS, increasing=True)).T


@dataclass(frozen=True, slots=True)
class Segments:
    """n pieces of time in which the location and all signals stay; every array is (n,).

    `time` (absolute s) and `age` (s since the location was entered) are those at the start, `dt` the length in s,
    `offset` what the flow's inputs add to its target (degC). `signals` are the values that effects read, NaN before the
    first reading; `since` has for each start-up effect the seconds since its event at the start, inf before any, `late`
    for each late one what fades of its deviation (degC/s) there, and `waiting` what of all of them does not yet
    (`sim.effects.late`).
    """

    location: Indices
    time: Array
    age: Array
    dt: Array
    offset: Array
    signals: Mapping[str, Array]
    since: tuple[Array, ...]
    late: tuple[Array, ...]
    waiting: Array

    def rows(self, rows: slice | Indices | Mask) -> "Segments":
        """Some of the segments."""
        return Segments(
            location=self.location[rows],
            time=self.time[rows],
            age=self.age[rows],
            dt=self.dt[rows],
            offset=self.offset[rows],
            signals={name: column[rows] for name, column in self.signals.items()},
            since=tuple(column[rows] for column in self.since),
            late=tuple(column[rows] for column in self.late),
            waiting=self.waiting[rows],
        )


@dataclass(frozen=True, slots=True)
class Terms:
    """dX/dt = -`loss` X + drive m + heat: `loss` (n,) with the flow's own k, `heat` and `drive` (n, q) by powers of v.

    Thermostat and radiation are not in here (`sim.engine.tables`).
    """

    loss: Array
    heat: Array
    drive: Array

    @property
    def powers(self) -> int:
        """1 where nothing varies inside a segment, else 3."""
        return int(self.heat.shape[1])


def terms(plant: Plant, segments: Segments) -> Terms:
    """Loss, heat and drive of every segment."""
    place = segments.location
    loss, heat = plant.rate[place], plant.rate[place] * segments.offset
    for acting in plant.steady:
        if not acting.mask[place].any():
            continue  # its signals were perhaps not asked for
        gained, lost = held_terms(acting.effect, segments.signals)
        active = acting.mask[place] & np.isfinite(gained) & np.isfinite(lost)
        loss = loss + np.where(active, lost, 0.0)
        heat = heat + np.where(active, gained, 0.0)
    heat = heat + segments.waiting
    if not (plant.fading or plant.startups or plant.wears or plant.late):
        return Terms(loss, heat[:, None], plant.drive[place][:, None])
    # Each column is a Gauss point; the parabola through the three is found by one small inverse, made once.
    v = segments.dt[:, None] * GAUSS_POINTS
    time = segments.time[:, None] + v
    heats = np.repeat(heat[:, None], 3, axis=1)
    for acting, since in zip(plant.startups, segments.since, strict=True):
        heats += acting.mask[place][:, None] * varying_heat(acting.effect, time, since[:, None] + v)
    for acting in plant.wears:
        heats += acting.mask[place][:, None] * varying_heat(acting.effect, time, time)
    for effect, deviation in zip(plant.late, segments.late, strict=True):
        heats += deviation[:, None] * remaining_share(effect, v)
    drives = np.repeat(plant.drive[place][:, None], 3, axis=1)
    for index in plant.fading:
        rows = place == index
        # The drift of a unit of m, which does not depend on X.
        drives[rows] = flows.drift(plant.sha.locations[index].flow, 0.0, 1.0, (segments.age[:, None] + v)[rows])
    return Terms(loss, heats @ _TO_POWERS, drives @ _TO_POWERS)


def held_terms(effect: Effect, signals: Mapping[str, Array]) -> tuple[Array, Array]:
    """(heat, loss) of an effect that stays while its signals do: dX/dt = heat - loss X; NaN where one is not read."""
    law = effect_kind(effect).law
    if not isinstance(law, HeldLaw):
        raise unknown("a step of held signals", effect.kind, law)
    return law.heat_and_loss(effect, signals)


def varying_heat(effect: Effect, time: Array, since: Array) -> Array:
    """The heat of an effect that varies by itself at absolute times (s), `since` its event (s)."""
    law = effect_kind(effect).law
    if not isinstance(law, VaryingLaw):
        raise unknown("a step of varying heat", effect.kind, law)
    return law.heat(effect, time, since)
