"""Does the temperature stay within LOW..HIGH? Proven for all words, refuted by one that leaves, or not decided."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import isinf, sqrt
from typing import Literal

import numpy as np

from sim.checking.counterexample import BEYOND, escape
from sim.checking.envelope import Assumptions, Envelope, Range, envelopes, start_range
from sim.checking.reach import Bound, Graph, climb, intervals, make_graph, side_of
from sim.checking.structure import moves
from sim.checking.word import TimedWord, parse_word, replay, word_text
from sim.sha.automaton import Location
from sim.sha.correction import in_sensor_scale
from sim.sha.distributions import mean
from sim.sha.effects import refuse
from sim.sha.entry import drawn_temperature, mode_parameter
from sim.sha.events import alphabet_symbols
from sim.sha.flows import RELAXING
from sim.sha.model import Model

Verdict = Literal["proven", "refuted", "not decided"]


@dataclass(frozen=True, slots=True)
class Escape:
    """How one border is passed: `up` the upper one; `reach` (degC) is the highest or lowest temperature there can be.

    It is infinite where the temperature grows without bound. `word` leaves the range when it is replayed, first in
    `location`, `seconds` after the start; None where no such word was found.
    """

    up: bool
    reach: float
    word: TimedWord | None = None
    location: str = ""
    seconds: float = 0.0

    @property
    def grows(self) -> bool:
        """Whether there is no bound at all on this side."""
        return isinf(self.reach)


@dataclass(frozen=True, slots=True)
class Bounds:
    """The claim that T stays within `low`..`high` (degC), of the flows without noise and without the model's clamp.

    `intervals` has the lowest and highest temperature in each location that some sequence of events reaches; they
    hold whatever the verdict, unless `settled` is False. `start` is where runs begin.
    """

    low: float
    high: float
    start: Range
    verdict: Verdict
    intervals: Mapping[str, Range]
    escapes: tuple[Escape, ...] = ()
    settled: bool = True

    @property
    def grows(self) -> bool:
        """Whether the temperature has no bound on some side."""
        return any(one.grows for one in self.escapes)

    @property
    def excess(self) -> float:
        """degC by which the range is left at most; 0 where it is proven."""
        return max((abs(one.reach - (self.high if one.up else self.low)) for one in self.escapes), default=0.0)


def find_bounds(
    model: Model, low: float, high: float, assumptions: Assumptions, *, doubt: float | None = None
) -> Bounds:
    """The claim decided for a model that can be run; temperatures are the sensor's (`sim.sha.correction`).

    With `doubt` (degC) the start and what is drawn are at their means, and only a target that lies outside of
    `low`..`high` is moved towards it, by as much as the location's own law allows at z but at most by `doubt`; inputs
    and stays are as assumed. Proven means up to 0.001 degC, what rounding can hide in the slowest loops. Raises
    ValueError for an empty range, and UnboundedInput for a driven flow whose input nobody bounds.
    """
    if not low < high:
        raise ValueError(f"no temperature lies within {low:g} to {high:g} degC; give LOW below HIGH")
    model = in_sensor_scale(model)
    refuse(model.sha, "the proof of bounds")
    symbols = alphabet_symbols(model.alphabet)
    onward = moves(model.sha, symbols, assumptions.policy, unknown=assumptions.unknown)
    rooms = envelopes(model, assumptions, onward)
    start = start_range(model, assumptions, low, high)
    if doubt is not None:
        given = model.initial if assumptions.start is None else None
        start = start if given is None else (mean(given), mean(given))
        places = zip(rooms, model.sha.locations, strict=True)
        rooms = tuple(_kindest(room, location, (low, high), doubt) for room, location in places)
    graph = make_graph(rooms, onward, model.sha.initial, model.sha.max_rate)
    upper, lower = climb(side_of(graph, up=True), start[1]), climb(side_of(graph, up=False), -start[0])
    escapes = [
        _escape(model, graph, bound, start[int(up)], (low, high), up, assumptions)
        for up, bound in ((True, upper), (False, lower))
        if bound.peak.max() > (high if up else -low) + BEYOND
    ]
    settled = upper.settled and lower.settled
    verdict: Verdict = "proven" if settled and not escapes else "not decided"
    if any(one.word is not None for one in escapes):
        verdict = "refuted"
    return Bounds(low, high, start, verdict, intervals(graph, upper, lower), tuple(escapes), settled)


def _kindest(room: Envelope, location: Location, within: Range, doubt: float) -> Envelope:
    """The location with means for what is drawn, and its targets as near to the range as its own doubt lets them be.

    The upper and the lower side are each given the benefit apart, so that the ends of `m` may change places.
    """
    middle, law = mode_parameter(location)[0], drawn_temperature(location)
    plain = replace(room, m=(middle, middle), fresh=None if law is None else (mean(law), mean(law)))
    if room.flow.kind not in RELAXING:
        return plain
    below, above = (min(max(way, 0.0), doubt) for way in (middle - room.m[0], room.m[1] - middle))
    up = min(max(plain.target(up=True) - within[1], 0.0), below)
    down = min(max(within[0] - plain.target(up=False), 0.0), above)
    return replace(plain, m=(middle + down, middle - up))


def _escape(
    model: Model, graph: Graph, bound: Bound, start: float, within: Range, up: bool, assumptions: Assumptions
) -> Escape:
    """The way out on one side; a word counts only when its text, read and replayed, really leaves."""
    sign, border = (1.0, within[1]) if up else (-1.0, within[0])
    reach = sign * float(np.max(bound.peak))
    word = escape(side_of(graph, up=up), sign * start, sign * border)
    if word is None:
        return Escape(up, reach)
    word = parse_word(word_text(word))
    visit = replay(model, word, assumptions.policy).leaves(*within)
    return Escape(up, reach) if visit is None else Escape(up, reach, word, visit.location, word.end)


def noise_band(model: Model, z: float) -> tuple[float, Mapping[str, float]]:
    """(z standard deviations at which the noise of relaxing flows settles, location -> noise of the others).

    The variance of a relaxing flow tends to noise^2 / (2k) from wherever it starts; that of any other flow grows with
    the time spent, at the given degC/sqrt(s). Locations without noise are left out.
    """
    flows = {location.name: location.flow for location in in_sensor_scale(model).sha.locations}
    noisy = {name: flow for name, flow in flows.items() if flow.params["noise"] > 0}
    settled = [flow.params["noise"] / sqrt(2.0 * flow.params["k"]) for flow in noisy.values() if flow.kind in RELAXING]
    walking = {name: flow.params["noise"] for name, flow in noisy.items() if flow.kind not in RELAXING}
    return z * max(settled, default=0.0), walking
