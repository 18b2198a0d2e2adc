"""The given model's own parameters: which there are, what is believed of them, and what each does to a target.

The given values are the centre of a weak belief; where a record hardly shows a location the belief is stronger
(`with_priors`).
Locations of equal rate share it, and so do those of equal gains, as the learner left them.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sim.engine import linear_recursion
from sim.lab.discrepancy.fitting.record import Record
from sim.lab.learning import RATE_PARAMETERS, FitShape, ParameterNames, Prior, build_shape, steps
from sim.sha import Array, Model, mode_parameter

TARGET_SPREAD, DRIFT_SPREAD, FACTOR_SPREAD, LOG_RATE_SPREAD, GAIN_SPREAD = 40.0, 0.02, 10.0, 1.5, 1.0
"""How far the plant's parameters are believed to lie from the given ones: degC, degC/s, degC, 1, shares of a gain."""
SHOWN_SHARE = 0.1
"""A location is shown where the temperature has gone this share of the way to a new target of it, at least once."""
ANCHOR_SHARE = 1e-3
"""Share of its spread to which a rate or gain is held that no location shows."""


@dataclass(frozen=True, slots=True)
class Frame:
    """A record with the structure of the parameters: `shape` and their `names`."""

    record: Record
    shape: FitShape
    names: ParameterNames

    @property
    def count(self) -> tuple[int, int]:
        """How many linear parameters and how many rates."""
        return self.shape.centre.size, self.shape.rate_centre.size

    @property
    def prior(self) -> Array:
        """(p + r,) the precision of the belief in each linear parameter and each log(rate)."""
        return np.concatenate([self.shape.spread**-2.0, self.shape.rate_spread**-2.0])

    @property
    def centre(self) -> Array:
        """(p + r,) the belief's centre."""
        return np.concatenate([self.shape.centre, self.shape.rate_centre])


def build_frame(record: Record) -> Frame:
    """The parameters of the record's model that the record's traces visit; equal rates and gains are shared."""
    model = record.model
    visited = set(np.unique(record.runs.place).tolist())
    free = [location.name for place, location in enumerate(model.sha.locations) if place in visited]
    # The learner ties rates and gains of locations together by giving them equal numbers, to the last digit; equality
    # is all that is left of it in a model. The first location of a group gives it its name.
    rates: dict[str, str] = {}
    gains: dict[str, str] = {}
    of_rate: dict[tuple[str, float], str] = {}
    of_gains: dict[tuple[tuple[str, float], ...], str] = {}
    for location in model.sha.locations:
        name, flow = location.name, location.flow
        if flow.kind in RATE_PARAMETERS:
            rate = RATE_PARAMETERS[flow.kind]
            rates[name] = of_rate.setdefault((rate, flow.params[rate]), name)
        if flow.inputs:
            gains[name] = of_gains.setdefault(tuple((driving.signal, driving.gain) for driving in flow.inputs), name)
    shape, names = build_shape(model.sha, free, record.signals, Prior((20.0, TARGET_SPREAD)), rates=rates, gains=gains)
    shape = _centre_shape(model, shape, names)
    return Frame(record, shape, names)


def _centre_shape(model: Model, shape: FitShape, names: ParameterNames) -> FitShape:
    """The shape with the given model's values as the belief's centre."""
    by_name = model.sha.by_name
    centre, spread = shape.centre.copy(), shape.spread.copy()
    spreads = {"linear": DRIFT_SPREAD, "logarithmic": FACTOR_SPREAD, "transient": FACTOR_SPREAD}
    for number, name in enumerate(names.targets):
        centre[number] = mode_parameter(by_name[name])[0]
        spread[number] = spreads.get(by_name[name].flow.kind, TARGET_SPREAD)
    for number, (group, signal) in enumerate(names.gains, start=len(names.targets)):
        gain = next(driver.gain for driver in by_name[group].flow.inputs if driver.signal == signal)
        centre[number], spread[number] = gain, max(GAIN_SPREAD * abs(gain), 1e-4)
    rates = [by_name[name].flow.params[RATE_PARAMETERS[by_name[name].flow.kind]] for name in names.rates]
    return replace(
        shape,
        centre=centre,
        spread=spread,
        rate_centre=np.log(np.array(rates)) if rates else np.empty(0),
        rate_spread=np.full(len(rates), LOG_RATE_SPREAD),
    )


def move_frame(frame: Frame, record: Record) -> Frame:
    """The same parameters over another record of the same model."""
    return Frame(record, frame.shape, frame.names)


def with_priors(frame: Frame) -> Frame:
    """The frame with the given values believed in locations that its record hardly shows.

    What the free run is off by in a short visit, a tenth of a degree, is divided by the share of the way that the
    temperature goes meanwhile: 20 s at a time constant of 20 min would move a target by six degrees, and the cycles
    that are held out may stay there for an hour. Such a target lies as near to the given one as the model itself says
    (the standard deviation of its law, which is wide where it saw little or has only borrowed). A rate or gain is kept
    where no location that has it is shown.
    """
    shape, locations = frame.shape, frame.record.model.sha.locations
    shown, spread = shown_locations(frame), shape.spread.copy()
    for place in np.unique(frame.record.runs.place):
        target = shape.target[place]
        if not shown[place] and target >= 0:
            own = max(float(np.sqrt(mode_parameter(locations[place])[1])), ANCHOR_SHARE * spread[target])
            spread[target] = min(spread[target], own)
    gains = np.arange(len(frame.names.targets), spread.size)
    spread[gains] *= np.where(np.isin(gains, shape.gain[shown]), 1.0, ANCHOR_SHARE)
    rates = np.isin(np.arange(shape.rate_spread.size), shape.rate[shown])
    kept = replace(shape, spread=spread, rate_spread=shape.rate_spread * np.where(rates, 1.0, ANCHOR_SHARE))
    return replace(frame, shape=kept)


def shown_locations(frame: Frame) -> NDArray[np.bool_]:
    """(L,) True for the locations of which the record shows what their parameters are."""
    runs, shape = frame.record.runs, frame.shape
    decay, pull = steps(runs, shape, shape.rate_centre)
    shown = np.zeros(len(shape.kinds), dtype=np.bool_)
    for place in np.unique(runs.place):
        way = linear_recursion(decay, np.where(runs.place == place, pull, 0.0), 0.0)
        # Of a flow without a target to relax to nothing is said: it counts as shown.
        shown[place] = RATE_PARAMETERS.get(shape.kinds[place]) != "k" or way.max() >= SHOWN_SHARE
    return shown
