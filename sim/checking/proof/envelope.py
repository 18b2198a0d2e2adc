"""What a stay may be like: the ranges of mode parameter, inputs and sojourn that a proof about temperatures assumes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import inf, isfinite
from typing import Literal

import numpy as np
from scipy.special import log_ndtr

from sim.checking.proof.drift import DriftBound
from sim.checking.proof.forcing import Forcing, drift_of, forcing_of
from sim.checking.proof.structure import Move
from sim.effects import dead_time, signals_of
from sim.engine import Policy
from sim.sha import (
    LAWS,
    UNKNOWN,
    Bins,
    Distribution,
    Flow,
    Location,
    Model,
    Switch,
    drawn_parameter,
    drawn_temperature,
    mode_parameter,
)

Range = tuple[float, float]
Sojourn = Literal["any", "law"] | Range
ANY: Range = (0.0, inf)
DAY = 86_400.0
YEAR = 365.0 * DAY


class UnboundedInput(ValueError):
    """A flow is driven by a signal whose range nobody says, so that nothing can be proven of temperatures."""


@dataclass(frozen=True, slots=True)
class Assumptions:
    """What a statement about temperatures assumes of everything that is not decided by the events.

    `z`: each random number (mode parameter, resampled temperature, start, an input's mean) lies within z standard
    deviations of its mean; for laws that are not normal, within the quantiles of the same probability. `sojourn`: every
    stay lasts any time (`any`), as its location's own law allows at z (`law`; any time where there is none), or LOW to
    HIGH seconds. `inputs` are ranges of input signals, for all locations; without one a signal is as the location's
    stay says at z, within the bin that was announced last. `start` (degC) is where a run begins; by default the model's
    initial law at z. `policy` says where an event without an edge leads: `resync` as in the running gateway; `ignore`
    and `reject` are the same here, as nothing moves. `unknown` says whether UNKNOWN, which leads to the initial
    location, may come at any time, as it may at a plant. `horizon` (s) is for how long after its beginning a wear
    among the effects is followed; None lets the verification choose (`verify.HORIZONS`). Raises ValueError.
    """

    z: float = 3.0
    sojourn: Sojourn = "any"
    inputs: Mapping[str, Range] = field(default_factory=dict)
    start: Range | None = None
    policy: Policy = "resync"
    unknown: bool = True
    horizon: float | None = None

    def __post_init__(self) -> None:
        if not (isfinite(self.z) and self.z >= 0):
            raise ValueError(f"z counts standard deviations: give a finite number of at least 0, not {self.z:g}")
        if self.horizon is not None and not (isfinite(self.horizon) and self.horizon >= 0):
            raise ValueError(f"wear is followed for a finite time of at least 0 s, not {self.horizon:g} s")
        ranges: dict[str, Range | None] = {f"the input {name!r}": given for name, given in self.inputs.items()}
        ranges["the start temperature"] = self.start
        for what, given in ranges.items():
            if given is not None and not (isfinite(given[0]) and isfinite(given[1]) and given[0] <= given[1]):
                raise ValueError(f"{what} ranges from {given[0]:g} to {given[1]:g}; give LOW and HIGH, both finite")
        if isinstance(self.sojourn, tuple) and not 0 <= self.sojourn[0] <= self.sojourn[1]:
            low, high = self.sojourn
            raise ValueError(f"stays of {low:g} to {high:g} s are none; give LOW and HIGH with 0 <= LOW <= HIGH")


@dataclass(frozen=True, slots=True)
class Envelope:
    """All stays that a location may have: ranges of m (its flow's unit), inputs, sojourn (s), and X on entry (degC).

    `fresh` is None where X goes on. Inputs may move within their ranges during a stay, m may not; what is proven holds
    for both. `forcing` is what effects add; None where none acts.
    """

    location: str
    flow: Flow
    m: Range
    inputs: Mapping[str, Range]
    sojourn: Range
    fresh: Range | None = None
    forcing: Forcing | None = None

    def corner(self, up: bool) -> tuple[float, dict[str, float]]:
        """(m, inputs) of the highest target, or of the lowest one."""
        side = int(up)
        if self.forcing is not None:
            return self.m[side], dict(self.forcing.signals[side])
        signals = {one.signal: self.inputs[one.signal][side if one.gain > 0 else 1 - side] for one in self.flow.inputs}
        return self.m[side], signals

    def target(self, up: bool) -> float:
        """The highest or the lowest value of m plus what the inputs add."""
        m, signals = self.corner(up)
        return m + sum(one.gain * (signals[one.signal] - one.reference) for one in self.flow.inputs)

    def drift(self, up: bool, housing: float | None = None) -> DriftBound | None:
        """The highest or lowest drift where effects act, with a housing at `housing` (degC); None without effects."""
        return None if self.forcing is None else drift_of(self.flow, self.m, self.forcing, up=up, housing=housing)


def worn_for(assumptions: Assumptions) -> float:
    """Seconds for which wear is followed."""
    return YEAR if assumptions.horizon is None else assumptions.horizon


def quantiles(law: Distribution, z: float) -> Range:
    """The law's quantiles at the normal probabilities of -z and +z: mu -+ z sigma for a normal law."""
    kind = LAWS[law.kind]
    low, high = (float(kind.exceeded(law.params, np.asarray(log_ndtr(sign * z)))) for sign in (1.0, -1.0))
    return low, high


def envelopes(model: Model, assumptions: Assumptions, moves: Sequence[Move]) -> tuple[Envelope, ...]:
    """The envelope of each location, in the automaton's order; `moves` are all that can happen (`structure.moves`)."""
    known = _last_announced(model, moves)
    return tuple(_envelope(model, location, assumptions, known[location.name]) for location in model.sha.locations)


def start_range(model: Model, assumptions: Assumptions, low: float, high: float) -> Range:
    """Where a run begins (degC): as given; else the initial law's range, or else all of low..high.

    A law is cut to low..high unless it lies wholly outside: a start outside the range is not the flows' doing.
    """
    if assumptions.start is not None:
        return assumptions.start
    if model.initial is None:
        return low, high
    least, most = quantiles(model.initial, assumptions.z)
    if most < low or least > high:
        return least, most
    return max(least, low), min(most, high)


def _envelope(model: Model, location: Location, assumptions: Assumptions, known: set[str]) -> Envelope:
    law, fresh = drawn_parameter(location), drawn_temperature(location)
    mean = mode_parameter(location)[0]
    m = (mean, mean) if law is None else quantiles(law, assumptions.z)

    def signal(name: str) -> Range:
        return _signal(model, location.name, name, assumptions, known)

    return Envelope(
        location=location.name,
        flow=location.flow,
        m=m,
        inputs={one.signal: signal(one.signal) for one in location.flow.inputs},
        sojourn=_sojourn(model, location.name, assumptions),
        fresh=None if fresh is None else quantiles(fresh, assumptions.z),
        forcing=forcing_of(model.sha, location, m, signal, worn_for(assumptions)),
    )


def _sojourn(model: Model, name: str, assumptions: Assumptions) -> Range:
    """The first stay is longer by a dead time, if there is one: nothing is felt before."""
    given, stay = assumptions.sojourn, model.semi_markov.get(name)
    if given == "any" or (given == "law" and stay is None):
        return ANY
    least, most = given if isinstance(given, tuple) else quantiles(stay.law, assumptions.z) if stay else ANY
    return least, most + (dead_time(model.sha) if name == model.sha.initial else 0.0)


def _signal(model: Model, name: str, signal: str, assumptions: Assumptions, known: set[str]) -> Range:
    """The range of an input in a location: as given; else the learned one, cut to the bin that was announced.

    Raises UnboundedInput when neither says anything.
    """
    if signal in assumptions.inputs:
        return assumptions.inputs[signal]
    stay = model.semi_markov.get(name)
    bins = next((c for c in model.alphabet.channels if isinstance(c, Bins) and c.signal == signal), None)
    switch = any(isinstance(channel, Switch) and channel.signal == signal for channel in model.alphabet.channels)
    announced: Range = (0.0, 1.0) if switch else (-inf, inf) if bins is None else _bin_range(bins, known)
    if stay is not None and signal in stay.inputs:
        mean, sigma = stay.inputs[signal]
        low, high = mean - assumptions.z * sigma, mean + assumptions.z * sigma
        return (max(low, announced[0]), min(high, announced[1])) if _overlap((low, high), announced) else (low, high)
    if bins is not None:
        return _closed(bins, announced)
    if switch:
        return announced
    seen = [one.inputs[signal] for one in model.semi_markov.values() if signal in one.inputs]
    if seen:
        z = assumptions.z
        return min(mean - z * sigma for mean, sigma in seen), max(mean + z * sigma for mean, sigma in seen)
    raise UnboundedInput(
        f"location {name!r} is driven by {signal!r}, whose range nobody says: it is no level of the alphabet and the "
        f"model has no inputs of its stay; give one, as --inputs {signal}=LOW..HIGH"
    )


def _overlap(one: Range, other: Range) -> bool:
    return one[0] <= other[1] and other[0] <= one[1]


def _bin_range(bins: Bins, known: set[str]) -> Range:
    """The union of the bins whose symbols may have been the last ones, hysteresis included; infinite at open ends."""
    places = [place for place, symbol in enumerate(bins.symbols) if symbol in known]
    if not places or UNKNOWN in known:
        return -inf, inf
    low, high = (-inf, *bins.thresholds), (*bins.thresholds, inf)
    return low[min(places)] - bins.hysteresis, high[max(places)] + bins.hysteresis


def _closed(bins: Bins, announced: Range) -> Range:
    """Open ends closed: at 0 below a positive first threshold, otherwise as wide as the bin beside them."""
    cuts = bins.thresholds
    if not cuts:
        return 0.0, 0.0
    widths = [high - low for low, high in pairwise(cuts)] or [abs(cuts[0]) or 1.0]
    least = min(0.0, cuts[0]) if cuts[0] > 0 else cuts[0] - widths[0]
    low = least if announced[0] == -inf else announced[0]
    return low, cuts[-1] + widths[-1] if announced[1] == inf else announced[1]


def _last_announced(model: Model, moves: Sequence[Move]) -> dict[str, set[str]]:
    """For each location all symbols that may be the last announcement of a level channel that drives some flow.

    UNKNOWN is among them where a channel may not have been announced yet.
    """
    driving = {one.signal for location in model.sha.locations for one in location.flow.inputs}
    driving |= set(signals_of(model.sha))
    known: dict[str, set[str]] = {location.name: set() for location in model.sha.locations}
    for channel in model.alphabet.channels:
        if isinstance(channel, Bins) and channel.signal in driving:
            for name, symbols in _spread(model.sha.initial, tuple(known), set(channel.symbols), moves).items():
                known[name] |= symbols
    return known


def _spread(initial: str, names: Sequence[str], own: set[str], moves: Sequence[Move]) -> dict[str, set[str]]:
    """The possible last announcements of one channel in each location, to the fixed point."""
    onward: dict[str, set[tuple[str, str]]] = {name: set() for name in names}
    for source, symbol, target in moves:
        onward[source].add((symbol if symbol in own or symbol == UNKNOWN else "", target))
    reached: dict[str, set[str]] = {name: set() for name in names}
    waiting = [(initial, UNKNOWN)]
    while waiting:
        name, last = waiting.pop()
        if last not in reached[name]:
            reached[name].add(last)
            waiting += [(target, symbol or last) for symbol, target in onward[name]]
    return reached


def describe(assumptions: Assumptions) -> tuple[str, ...]:
    """The assumptions in sentences, for people."""
    given = assumptions.sojourn
    stays = f"every stay lasts {given[0]:g} to {given[1]:g} s" if isinstance(given, tuple) else ""
    if given == "any":
        stays = "every stay lasts any time from 0 on"
    elif given == "law":
        stays = f"every stay lasts as its location's sojourn law allows at z = {assumptions.z:g}; any time without one"
    ranges = [f"{name} within {low:g} to {high:g}" for name, (low, high) in assumptions.inputs.items()]
    events = "events in any order" + (", UNKNOWN among them" if assumptions.unknown else ", but never UNKNOWN")
    return (
        events + (", those without an edge resynchronise" if assumptions.policy == "resync" else ""),
        stays,
        f"mode parameters within z = {assumptions.z:g} standard deviations, noise left out",
        *ranges,
    )
