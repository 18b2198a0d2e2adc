"""The candidates of method `bins`: constant targets or driven ones, and which locations share a rate or a gain."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sim.lab.learning import (
    MIN_READING_SHARE,
    FitShape,
    FreeRuns,
    Indices,
    LearningError,
    ParameterNames,
    Prior,
    build_shape,
    contexts,
    labels,
    level_signals,
    product_sha,
    reference,
)
from sim.sha import SHA, Alphabet, Flow, Input, Location, Mask, Switch

Sharing = Literal["shared", "switch", "location"]
MIN_SWING_SHARE = 0.05
"""A location is driven by an input that scatters there by this share of its scatter over all locations."""
MAX_OWN_LOCATIONS = 24
"""Locations up to which each may have a rate or a gain of its own: the search grows with their cube."""
TARGET_SPREAD_DEGC = 40.0
"""Spread of the priors of targets, in degC."""


@dataclass(frozen=True, slots=True)
class BinsCandidate:
    """One way to build the model. `flow`: targets `constant` or `driven` by the level signals.

    `rates`: one k for all locations, one for each position of the first switch, or one each; `gains` likewise.
    """

    flow: Literal["constant", "driven"]
    rates: Sharing = "shared"
    gains: Sharing = "location"

    @property
    def label(self) -> str:
        """In words, for tables."""
        words = {"shared": "one k", "switch": "k per switch position", "location": "k per location"}
        gains = {"shared": ", one gain", "switch": ", gain per switch position", "location": ", gain per location"}
        return f"{self.flow}, {words[self.rates]}{gains[self.gains] if self.flow == 'driven' else ''}"


CANDIDATES: tuple[BinsCandidate, ...] = (
    BinsCandidate("constant", "shared"),
    BinsCandidate("constant", "switch"),
    BinsCandidate("constant", "location"),
    BinsCandidate("driven", "shared", "shared"),
    BinsCandidate("driven", "switch", "shared"),
    BinsCandidate("driven", "shared", "location"),
    BinsCandidate("driven", "switch", "location"),
    BinsCandidate("driven", "location", "location"),
)


@dataclass(frozen=True, slots=True)
class Basis:
    """What the candidates are built on: the alphabet, the locations with data, and the inputs that move in each."""

    alphabet: Alphabet
    seen: tuple[str, ...]
    signals: tuple[str, ...]
    moving: Mapping[str, tuple[str, ...]]
    prior: Prior


def modelled_places(runs: FreeRuns, alphabet: Alphabet) -> Mask:
    """(L,) the locations that get parameters of their own, given runs through all but the unknown one.

    Those in which every channel is known; and those in which one is not, when they hold a tenth of the readings: a
    plant without a running signal lives in "?/100-200", and that is where it can be modelled.
    """
    count = readings_by_place(runs, len(contexts(alphabet)))
    known = np.array([None not in context for context in contexts(alphabet).values()])
    nothing = np.array([all(value is None for value in context) for context in contexts(alphabet).values()])
    return np.asarray((known | (count >= MIN_READING_SHARE * count.sum())) & ~nothing)


def readings_by_place(runs: FreeRuns, places: int) -> Indices:
    """(L,) how many readings end a step made in each location."""
    ending = np.isfinite(runs.reading) & ~runs.first
    return np.bincount(runs.place[ending], minlength=places)


def build_basis(runs: FreeRuns, alphabet: Alphabet) -> Basis:
    """What the runs say about locations and inputs; the prior's centre is the median temperature."""
    names = list(contexts(alphabet))
    signals = level_signals(alphabet)
    seen = np.unique(runs.place[~runs.first]).tolist()
    swing = {signal: _scatter(runs, number, np.ones(len(runs), bool)) for number, signal in enumerate(signals)}
    moving = {
        names[place]: tuple(
            signal
            for number, signal in enumerate(signals)
            if _scatter(runs, number, runs.place == place) > MIN_SWING_SHARE * swing[signal] > 0
        )
        for place in seen
    }
    reading = runs.reading[np.isfinite(runs.reading)]
    gains = {signal: TARGET_SPREAD_DEGC / value for signal, value in swing.items() if value > 0}
    prior = Prior((float(np.median(reading)), TARGET_SPREAD_DEGC), gains)
    return Basis(alphabet, tuple(names[place] for place in seen), signals, moving, prior)


def _scatter(runs: FreeRuns, number: int, rows: Mask) -> float:
    """Standard deviation of an input over time, in its unit; 0 where it was never read."""
    use = rows & np.isfinite(runs.inputs[:, number]) & (runs.dt > 0)
    if not use.any():
        return 0.0
    value, weight = runs.inputs[use, number], runs.dt[use]
    mean = np.average(value, weights=weight)
    return float(np.sqrt(np.average((value - mean) ** 2, weights=weight)))


def build(candidate: BinsCandidate, base: Basis) -> tuple[SHA, FitShape, ParameterNames]:
    """The candidate's automaton, still without values, and its parameter vector."""
    locations: dict[str, Location] = {}
    for name, context in contexts(base.alphabet).items():
        if name not in base.seen:
            locations[name] = Location(name, Flow("constant", {"noise": 0.0}), entry="none")
            continue
        params = {"k": 1.0 / base.prior.tau, "noise": 0.0}
        # An input that hardly moves in a location cannot show its gain there: that location is not driven by it.
        moving = base.moving[name] if candidate.flow == "driven" else ()
        inputs = tuple(Input(signal, 0.0, reference(context, base.alphabet, signal)) for signal in moving)
        locations[name] = Location(name, Flow("driven" if inputs else "exponential", params, inputs))
    sha = product_sha(base.alphabet, locations, "bins")
    rates = {name: _group(name, candidate.rates, base.alphabet) for name in base.seen}
    gains = {name: _group(name, candidate.gains, base.alphabet) for name in base.seen}
    return sha, *build_shape(sha, base.seen, base.signals, base.prior, rates=rates, gains=gains)


def _group(name: str, sharing: Sharing, alphabet: Alphabet) -> str:
    if sharing == "location":
        return name
    if sharing == "shared":
        return "all"
    context = contexts(alphabet)[name]
    place = next((n for n, channel in enumerate(alphabet.channels) if isinstance(channel, Switch)), None)
    value = None if place is None else context[place]
    return "?" if place is None or value is None else labels(alphabet.channels[place])[value]


def process_groups(alphabet: Alphabet) -> Indices:
    """(L,) the group of locations that shares one process noise: a position of the first switch."""
    groups = [_group(name, "switch", alphabet) for name in contexts(alphabet)]
    order = list(dict.fromkeys(groups))
    return np.array([order.index(group) for group in groups], dtype=np.intp)


def distinct(candidates: Sequence[BinsCandidate], base: Basis) -> list[BinsCandidate]:
    """The candidates that differ on these data: with one location, or no moving input, several are the same.

    Over more than MAX_OWN_LOCATIONS locations none has a rate or a gain of its own for each of them. Raises
    LearningError when that leaves no candidate.
    """
    many = len(base.seen) > MAX_OWN_LOCATIONS
    kept: dict[tuple[object, ...], BinsCandidate] = {}
    for candidate in candidates:
        if many and "location" in (candidate.rates, candidate.gains if candidate.flow == "driven" else ""):
            continue
        _, shape, names = build(candidate, base)
        key = (shape.kinds, tuple(shape.rate), tuple(shape.gain.ravel()), len(names.gains))
        kept.setdefault(key, candidate)
    if not kept:
        raise LearningError(
            f"the traces stay in {len(base.seen)} locations, and a rate or gain of its own for each is only fitted for "
            f"up to {MAX_OWN_LOCATIONS}; let them share one, take wider bins, or learn with method lsha, which merges "
            "locations"
        )
    return list(kept.values())
