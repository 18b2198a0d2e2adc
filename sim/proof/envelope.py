"""What a stay may be like: the ranges of mode parameter, inputs and sojourn that a proof about temperatures assumes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from math import inf, isfinite
from typing import Literal

from sim.effects import dead_time, effect_signals
from sim.engine import Policy
from sim.proof.drift import DriftBound
from sim.proof.forcing import Forcing, drift_bound, location_forcing
from sim.proof.structure import Move
from sim.sha import (
    LAWS,
    UNKNOWN,
    Bins,
    Distribution,
    Flow,
    Model,
    Switch,
    draw_parameter,
    draw_temperature,
    mode_parameter,
)
from sim.special import log_normal_cdf

Range = tuple[float, float]
Sojourn = Literal["any", "law"] | Range
ANY: Range = (0.0, inf)
DAY_S = 86_400.0
YEAR_S = 365.0 * DAY_S


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
        ranges: dict[str, Range | None] = {f"the input {name!r}": limits for name, limits in self.inputs.items()}
        ranges["the start temperature"] = self.start
        for what, limits in ranges.items():
            if limits is not None and not (isfinite(limits[0]) and isfinite(limits[1]) and limits[0] <= limits[1]):
                raise ValueError(f"{what} ranges from {limits[0]:g} to {limits[1]:g}; give LOW and HIGH, both finite")
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
        drivers = self.flow.inputs
        signals = {
            driver.signal: self.inputs[driver.signal][side if driver.gain > 0 else 1 - side] for driver in drivers
        }
        return self.m[side], signals

    def target(self, up: bool) -> float:
        """The highest or the lowest value of m plus what the inputs add."""
        m, signals = self.corner(up)
        return m + sum(driver.gain * (signals[driver.signal] - driver.reference) for driver in self.flow.inputs)

    def drift(self, up: bool, housing: float | None = None) -> DriftBound | None:
        """The highest or lowest drift where effects act, with a housing at `housing` (degC); None without effects."""
        return None if self.forcing is None else drift_bound(self.flow, self.m, self.forcing, up=up, housing=housing)


def wear_seconds(assumptions: Assumptions) -> float:
    """Seconds for which wear is followed."""
    return YEAR_S if assumptions.horizon is None else assumptions.horizon


def quantiles(law: Distribution, z: float) -> Range:
    """The law's quantiles at the normal probabilities of -z and +z: mu -+ z sigma for a normal law."""
    # By the logarithm of the probability: beyond z = 8.3 the probability itself is 1 in floats, its quantile infinite.
    kind = LAWS[law.kind]
    low, high = (float(kind.exceeded(law.params, log_normal_cdf(sign * z))) for sign in (1.0, -1.0))
    return low, high


def envelopes(model: Model, assumptions: Assumptions, moves: Sequence[Move]) -> tuple[Envelope, ...]:
    """The envelope of each location, in the automaton's order; `moves` are all that can happen (`structure.moves`)."""
    announced, sojourn, late = _last_announcements(model, moves), assumptions.sojourn, dead_time(model.sha)
    signals = {
        name: partial(_signal, model, name, assumptions=assumptions, known=known) for name, known in announced.items()
    }

    def everywhere(signal: str) -> Range:
        low, high = zip(*(limits(signal) for limits in signals.values()), strict=True)
        return min(low), max(high)

    rooms: list[Envelope] = []
    for location in model.sha.locations:
        law, fresh = draw_parameter(location), draw_temperature(location)
        middle = mode_parameter(location)[0]
        m = (middle, middle) if law is None else quantiles(law, assumptions.z)
        signal = signals[location.name]
        inputs = {driver.signal: signal(driver.signal) for driver in location.flow.inputs}
        stay, lasting = model.semi_markov.get(location.name), ANY
        if isinstance(sojourn, tuple) or (sojourn == "law" and stay is not None):
            least, most = sojourn if isinstance(sojourn, tuple) else quantiles(stay.law, assumptions.z) if stay else ANY
            # The first stay is longer by a dead time, if there is one: nothing acts before it has passed.
            lasting = least, most + (late if location.name == model.sha.initial else 0.0)
        rooms.append(
            Envelope(
                location=location.name,
                flow=location.flow,
                m=m,
                inputs=inputs,
                sojourn=lasting,
                fresh=None if fresh is None else quantiles(fresh, assumptions.z),
                forcing=location_forcing(
                    model.sha,
                    location,
                    m,
                    signal,
                    everywhere=everywhere,
                    horizon=wear_seconds(assumptions),
                    z=assumptions.z,
                ),
            )
        )
    return tuple(rooms)


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


def _signal(model: Model, name: str, signal: str, *, assumptions: Assumptions, known: set[str]) -> Range:
    """The range of an input in a location: as given; else the learned one, cut to the bin that was announced.

    Raises UnboundedInput when neither says anything.
    """
    if signal in assumptions.inputs:
        return assumptions.inputs[signal]
    stay = model.semi_markov.get(name)
    bins = next((c for c in model.alphabet.channels if isinstance(c, Bins) and c.signal == signal), None)
    switch = any(isinstance(channel, Switch) and channel.signal == signal for channel in model.alphabet.channels)
    announced: Range = (0.0, 1.0) if switch else (-inf, inf)
    if bins is not None and not switch and UNKNOWN not in known:
        # The union of the bins that may have been announced last. The signal may leave its bin by the hysteresis before
        # the next one is announced.
        places = [place for place, symbol in enumerate(bins.symbols) if symbol in known]
        if places:
            borders = (-inf, *bins.thresholds, inf)
            announced = borders[min(places)] - bins.hysteresis, borders[max(places) + 1] + bins.hysteresis
    if stay is not None and signal in stay.inputs:
        mean, sigma = stay.inputs[signal]
        low, high = mean - assumptions.z * sigma, mean + assumptions.z * sigma
        # Where the two have nothing in common, the learned values are believed: no stay would be left otherwise.
        overlap = low <= announced[1] and announced[0] <= high
        return (max(low, announced[0]), min(high, announced[1])) if overlap else (low, high)
    if bins is not None:
        # Open ends are closed: at 0 below a positive first threshold, otherwise as wide as the bin beside them.
        cuts = bins.thresholds
        if not cuts:
            return 0.0, 0.0
        widths = [high - low for low, high in pairwise(cuts)] or [abs(cuts[0]) or 1.0]
        least = min(0.0, cuts[0]) if cuts[0] > 0 else cuts[0] - widths[0]
        low = least if announced[0] == -inf else announced[0]
        return low, cuts[-1] + widths[-1] if announced[1] == inf else announced[1]
    if switch:
        return announced
    # At last what other locations' stays have learned of it: the signal is the same, wherever the machine is.
    seen = [other.inputs[signal] for other in model.semi_markov.values() if signal in other.inputs]
    if seen:
        z = assumptions.z
        return min(mean - z * sigma for mean, sigma in seen), max(mean + z * sigma for mean, sigma in seen)
    raise UnboundedInput(
        f"location {name!r} is driven by {signal!r}, whose range nobody says: it is no level of the alphabet and the "
        f"model has no inputs of its stay; give one, as --inputs {signal}=LOW..HIGH"
    )


def _last_announcements(model: Model, moves: Sequence[Move]) -> dict[str, set[str]]:
    """For each location all symbols that may be the last announcement of a level channel that drives some flow.

    UNKNOWN is among them where a channel may not have been announced yet.
    """
    driving = {driver.signal for location in model.sha.locations for driver in location.flow.inputs}
    driving |= set(effect_signals(model.sha))
    known: dict[str, set[str]] = {location.name: set() for location in model.sha.locations}
    for channel in model.alphabet.channels:
        if not isinstance(channel, Bins) or channel.signal not in driving:
            continue
        # Pairs (location, last announcement) are followed to the fixed point, each channel by itself: their product
        # would grow with the number of channels, and only the single announcements are asked for.
        onward: dict[str, set[tuple[str, str]]] = {name: set() for name in known}
        for source, symbol, target in moves:
            onward[source].add((symbol if symbol in channel.symbols or symbol == UNKNOWN else "", target))
        reached: dict[str, set[str]] = {name: set() for name in known}
        waiting = [(model.sha.initial, UNKNOWN)]
        while waiting:
            name, last = waiting.pop()
            if last not in reached[name]:
                reached[name].add(last)
                waiting += [(target, symbol or last) for symbol, target in onward[name]]
        for name, symbols in reached.items():
            known[name] |= symbols
    return known


def describe(assumptions: Assumptions) -> tuple[str, ...]:
    """The assumptions in sentences, for people."""
    sojourn = assumptions.sojourn
    stays = f"every stay lasts {sojourn[0]:g} to {sojourn[1]:g} s" if isinstance(sojourn, tuple) else ""
    if sojourn == "any":
        stays = "every stay lasts any time from 0 on"
    elif sojourn == "law":
        stays = f"every stay lasts as its location's sojourn law allows at z = {assumptions.z:g}; any time without one"
    ranges = [f"{name} within {low:g} to {high:g}" for name, (low, high) in assumptions.inputs.items()]
    events = "events in any order" + (", UNKNOWN among them" if assumptions.unknown else ", but never UNKNOWN")
    return (
        events + (", those without an edge resynchronise" if assumptions.policy == "resync" else ""),
        stays,
        f"mode parameters, the machine's offset and a disturbance of heat within z = {assumptions.z:g} standard "
        "deviations, noise left out",
        *ranges,
    )
