"""Does the temperature stay within LOW..HIGH? Proven for all words, refuted by one that leaves, or not decided."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import hypot, isinf, sqrt
from typing import Literal

import numpy as np

from sim.effects import dead_time, drop_features, in_sensor_scale, of_feature
from sim.proof.counterexample import MIN_EXCESS_DEGC, escape, variants
from sim.proof.envelope import Assumptions, Envelope, Range, envelopes, start_range, wear_seconds
from sim.proof.reach import Bound, Graph, Side, climb, intervals, make_graph, make_side
from sim.proof.structure import moves
from sim.proof.word import MAX_CHARACTERS, TimedWord, parse_word, word_text
from sim.proof.word_replay import offset_range, replay
from sim.sha import RELAXING_FLOWS, Location, Model, alphabet_symbols, draw_temperature, mean, mode_parameter

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
        return any(escape.grows for escape in self.escapes)

    @property
    def excess(self) -> float:
        """degC by which the range is left at most; 0 where it is proven."""
        return max(
            (abs(excursion.reach - (self.high if excursion.up else self.low)) for excursion in self.escapes),
            default=0.0,
        )


def find_bounds(
    model: Model, low: float, high: float, assumptions: Assumptions, *, doubt: float | None = None
) -> Bounds:
    """The claim decided for a model that can be run; temperatures are the sensor's (`sim.effects.correction`).

    With `doubt` (degC) the start and what is drawn are at their means, and only a target that lies outside of
    `low`..`high` is moved towards it, by as much as the location's own law allows at z but at most by `doubt`; inputs
    and stays are as assumed. Proven means up to 0.001 degC, what rounding can hide in the slowest loops. Raises
    ValueError for an empty range, and UnboundedInput for a driven flow whose input nobody bounds.
    """
    if not low < high:
        raise ValueError(f"no temperature lies within {low:g} to {high:g} degC; give LOW below HIGH")
    model = in_sensor_scale(model)
    if doubt is not None:
        model = replace(model, sha=drop_features(model.sha, "disturbance", "machine offset"))
    symbols = alphabet_symbols(model.alphabet)
    onward = moves(model.sha, symbols, assumptions.policy, unknown=assumptions.unknown)
    rooms = envelopes(model, assumptions, onward)
    start = start_range(model, assumptions, low, high)
    if doubt is not None:
        law = model.initial if assumptions.start is None else None
        start = start if law is None else (mean(law), mean(law))
        places = zip(rooms, model.sha.locations, strict=True)
        rooms = tuple(_kindest(room, location, (low, high), doubt) for room, location in places)
    graph = make_graph(rooms, onward, model.sha.initial, model.sha.max_rate)
    # The claim is about what the sensor reads, the graph about X and what is to come: a reading less what the sensor
    # reads too much, and more by what comes late. At the start that is as the signals are there.
    least, most = offset_range(model.sha)
    (cold, warm), (begin_cold, begin_warm) = _late_ranges(graph)
    begins = start[0] - most + begin_cold, start[1] - least + begin_warm
    least, most = least - warm, most - cold
    if assumptions.start is None and model.initial is None:
        # Where a run may begin anywhere in the range, it does so with what is to come.
        begins = max(begins[0], start[0] - least), min(begins[1], start[1] - most)
    top, upper = _bound_side(graph, begins[1], up=True)
    bottom, lower = _bound_side(graph, begins[0], up=False)
    escapes = [
        _escape(
            model, side, bound, start=start[int(up)], within=(low, high), off=(least, most), assumptions=assumptions
        )
        for side, bound, up in ((top, upper, True), (bottom, lower, False))
        if bound.peak.max() > (high - most if up else least - low) + MIN_EXCESS_DEGC
    ]
    settled = upper.settled and lower.settled
    verdict: Verdict = "proven" if settled and not escapes else "not decided"
    if any(excursion.word is not None for excursion in escapes):
        verdict = "refuted"
    readings = {name: (x[0] + least, x[1] + most) for name, x in intervals(graph, upper, lower).items()}
    if of_feature(model.sha, "sensor lag") or dead_time(model.sha):
        # After a lag or a dead time the sensor still reads what was in the locations before: anywhere, for all we know.
        lows, highs = zip(*readings.values(), strict=True)
        readings = dict.fromkeys(readings, (min(lows), max(highs)))
    return Bounds(
        low=low,
        high=high,
        start=start,
        verdict=verdict,
        intervals=readings,
        escapes=tuple(escapes),
        settled=settled,
    )


def _late_ranges(graph: Graph) -> tuple[Range, Range]:
    """degC: what may be to come of all that comes late, anywhere, and at the start."""
    forcing = graph.envelopes[graph.initial].forcing
    return ((0.0, 0.0), (0.0, 0.0)) if forcing is None else (forcing.coming, forcing.settled)


_MAX_ROUNDS = 200
"""Raises of a housing's temperature before the bounds count as not settled."""


def _bound_side(graph: Graph, start: float, *, up: bool) -> tuple[Side, Bound]:
    """The side and its bounds, from X at `start` (degC).

    A housing is never beyond the farthest X. That is first looked for without any, and then raised until it holds with
    a housing that is as far; under stays of any length it holds at once.
    """
    sign = 1.0 if up else -1.0
    side = make_side(graph, up=up)
    highest = climb(side, sign * start)
    if not any(room.forcing is not None and room.forcing.coupling for room in graph.envelopes):
        return side, highest
    # An inductive argument: if all temperatures stay below `reach` with a housing at `reach`, the housing, which is a
    # moving average of them, cannot be the first to pass it.
    reach = float(highest.peak.max())
    for _ in range(_MAX_ROUNDS):
        if isinf(reach):
            return side, highest
        side = make_side(graph, up=up, housing=sign * reach)
        highest = climb(side, sign * start)
        beyond = float(highest.peak.max()) - reach
        if beyond <= 0.0:
            return side, highest
        reach += 1.5 * beyond + 1e-9  # farther than asked for: the exact step would come near in ever smaller ones
    return side, replace(highest, settled=False)


def _kindest(room: Envelope, location: Location, within: Range, doubt: float) -> Envelope:
    """The location with means for what is drawn, and its targets as near to the range as its own doubt lets them be.

    The upper and the lower side are each given the benefit apart, so that the ends of `m` may change places.
    """
    middle, law = mode_parameter(location)[0], draw_temperature(location)
    plain = replace(room, m=(middle, middle), fresh=None if law is None else (mean(law), mean(law)))
    if room.flow.kind not in RELAXING_FLOWS:
        return plain
    if room.forcing is not None:
        lowest, highest = (_nearest(room, middle, within[int(up)], doubt, up=up) for up in (False, True))
        return replace(plain, m=(lowest, highest))
    below, above = (min(max(margin, 0.0), doubt) for margin in (middle - room.m[0], room.m[1] - middle))
    up = min(max(plain.target(up=True) - within[1], 0.0), below)
    down = min(max(within[0] - plain.target(up=False), 0.0), above)
    return replace(plain, m=(middle + down, middle - up))


def _nearest(room: Envelope, middle: float, border: float, doubt: float, *, up: bool) -> float:
    """The m nearest to its mean, `middle`, at which X settles inside of `border`, among those that the doubt allows.

    Losses stand between m and where X settles, so it is looked for by bisection.
    """
    end = min(max(room.m[int(not up)], middle - doubt), middle + doubt)

    def lies_outside(m: float) -> bool:
        drift = replace(room, m=(m, m)).drift(up)
        # Where X settles nothing is to come any more: all of it is there.
        later = room.forcing.coming[int(up)] if room.forcing is not None else 0.0
        reach = middle if drift is None else (drift.rest[0] if up else drift.rest[1]) - later
        return reach > border if up else reach < border

    if not lies_outside(middle):
        return middle
    # Where X settles moves one way with m, so that `beyond` changes at most once on the way from the mean to `end`; 50
    # halvings leave less of the way than a temperature's digits show.
    for _ in range(50):
        half = 0.5 * (middle + end)
        middle, end = (half, end) if lies_outside(half) else (middle, half)
    return end


def _escape(
    model: Model, side: Side, bound: Bound, *, start: float, within: Range, off: Range, assumptions: Assumptions
) -> Escape:
    """The way out on one side; a word counts only when its text, read and replayed, really leaves.

    A reading lies `off` (degC) the graph's temperatures.
    """
    up = side.sign > 0
    shift = off[int(up)]
    reach = side.sign * float(np.max(bound.peak)) + shift
    bare = make_side(side.graph, up=up)  # a housing as hot as can be would lead ways that no run can go
    word = escape(bare, side.sign * start, side.sign * (within[int(up)] - shift))
    # Through the text and back: what is shown has 12 digits, and it is those that must leave the range.
    for variant in () if word is None else variants(model, side.graph, word, wear_seconds(assumptions)):
        text = word_text(variant)
        if len(text) > MAX_CHARACTERS:
            continue  # too long to be shown, or to be read by the commands
        read = parse_word(text)
        try:
            visit = replay(model, read, assumptions.policy).leaves(*within)
        except ValueError:
            if not model.sha.effects:
                raise
            continue  # too long to be followed under a thermostat or radiation
        if visit is not None:
            return Escape(up, reach, read, visit.location, read.end)
    return Escape(up, reach)


def noise_band(model: Model, z: float) -> tuple[float, Mapping[str, float]]:
    """(z standard deviations at which the noise of relaxing flows settles, location -> noise of the others).

    The variance of a relaxing flow tends to noise^2 / (2k) from wherever it starts; that of any other flow grows with
    the time spent, at the given degC/sqrt(s). Locations without noise are left out.
    """
    sha = in_sensor_scale(model).sha
    flows = {location.name: location.flow for location in sha.locations}
    noisy = {name: flow for name, flow in flows.items() if flow.params["noise"] > 0}
    settled = [
        flow.params["noise"] / sqrt(2.0 * flow.params["k"]) for flow in noisy.values() if flow.kind in RELAXING_FLOWS
    ]
    walking = {name: flow.params["noise"] for name, flow in noisy.items() if flow.kind not in RELAXING_FLOWS}
    # Over times longer than its memory an Ornstein-Uhlenbeck heat adds up as white noise of sigma sqrt(2 memory) does.
    for effect in of_feature(sha, "disturbance"):
        white = effect.params["sigma"] * sqrt(2.0 * effect.params["memory"])
        still = [name for name, flow in flows.items() if flow.kind not in RELAXING_FLOWS]
        walking |= {name: hypot(walking.get(name, 0.0), white) for name in still}
    return z * max(settled, default=0.0), walking
