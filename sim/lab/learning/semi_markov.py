"""How long stays last and where they lead, learned from traces: what a forecast assumes of events to come.

A stay that the trace's end or an UNKNOWN cuts off is censored: it lasted at least so long. Moves that take no time are
folded into one. What follows an UNKNOWN until the next event says how long a gap lasted, not how the plant behaves, and
is left out.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import exp, inf, log

import numpy as np
import scipy

from sim.effects import effect_signals
from sim.engine import Tracker, compile_tracker, next_location
from sim.sha import UNKNOWN, Array, Distribution, Mask, Model, Stay, Trace

MIN_ENDED_STAYS = 12
"""Ended stays below which a location's sojourn law is exponential: two parameters are not to be had from so few."""

PRIOR_STAYS = 0.5
"""The ended stays that the mean stay of all locations counts for in each one: a mean is never 0 and never infinite."""

PRIOR_MOVES = 0.5
"""The moves that each possible next location counts for before any is seen (Krichevsky & Trofimov 1981)."""

MIN_STAY_S = 1e-3
"""Seconds; a stay is not taken to be shorter, a clock in milliseconds cannot tell."""


@dataclass(frozen=True, slots=True)
class Sojourn:
    """One stay of positive length in a trace: `start`..`end` (absolute s); `to` is None when it was cut off.

    `gap` marks a stay that begins with an UNKNOWN.
    """

    location: str
    start: float
    end: float
    to: str | None
    gap: bool = False


def sojourns(model: Model | Tracker, trace: Trace) -> tuple[Sojourn, ...]:
    """The stays of an encoded trace in order, as its events lead through the automaton, from its first row to its last.

    Events without an edge follow the tracker's policy. Raises ValueError when the trace has no rows.
    """
    tracker = compile_tracker(model)
    if not trace.times.size:
        raise ValueError(f"trace {trace.name!r} has no rows")
    location, since, gap = tracker.model.sha.initial, float(trace.times[0]), False
    stays: list[Sojourn] = []
    for event in trace.events:
        target, _ = next_location(tracker, location, event.symbol)
        if target is None:
            continue
        lost = event.symbol == UNKNOWN
        if event.time > since:
            stays.append(Sojourn(location, since, event.time, None if lost else target, gap))
            since = event.time
        elif stays and stays[-1].end == since:
            # The plant moves on at the very instant at which the newest stay ended: that one leads to where the last
            # of these moves ends. Unless it was cut off by an UNKNOWN: what is announced after that follows from it.
            last = stays[-1]
            stays[-1] = replace(last, to=None if lost or last.to is None else target)
        location, gap = target, lost
    end = float(trace.times[-1])
    return (*stays, Sojourn(location, since, end, None, gap)) if end > since else tuple(stays)


def fit_law(lengths: Sequence[float], ended: Sequence[bool], typical: float) -> Distribution:
    """The sojourn law by maximum likelihood and corrected AIC: exponential, Weibull or log-normal; times in seconds.

    `ended` says which stays were seen to end; the others are right-censored. `typical` is the mean to assume where
    nothing is known. Raises ValueError on lengths that do not match, are negative or not finite, and unless
    `typical` is positive.
    """
    times, seen = np.asarray(lengths, dtype=float), np.asarray(ended, dtype=bool)
    if times.shape != seen.shape or not np.all((times >= 0) & (times < inf)) or not 0 < typical < inf:
        raise ValueError("stays need as many ends as lengths, lengths of 0 s or more and a typical length above 0 s")
    times = np.maximum(times, MIN_STAY_S)
    count = float(seen.sum())
    mean = (float(times.sum()) + PRIOR_STAYS * typical) / (count + PRIOR_STAYS)
    simple = Distribution("exponential", {"mean": mean})
    if count < MIN_ENDED_STAYS:
        return simple
    best, lowest = simple, 2.0 * (count * log(mean) + float(times.sum()) / mean) + 2.0 + 4.0 / (count - 2.0)
    for law, loss in (_fit_weibull(times, seen), _fit_lognormal(times, seen)):
        criterion = 2.0 * loss + 4.0 + 12.0 / (count - 3.0)
        if criterion < lowest:
            best, lowest = law, criterion
    return best


def _fit_weibull(times: Array, seen: Mask) -> tuple[Distribution, float]:
    """The law and minus its log-likelihood; the scale follows from the shape, which lies between 0.2 and 20."""
    logs, count = np.log(times), float(seen.sum())
    centre = float(logs[seen].mean())

    # At a given shape the scale of greatest likelihood is known: scale^shape is the sum of all t^shape (cut off ones
    # too) by the number of ended stays. Logarithms are taken about their mean, or t^20 would overflow.
    def best_scale(shape: float) -> float:
        return float(np.log(np.exp(shape * (logs - centre)).sum() / count))

    def loss(point: Array) -> float:
        shape = exp(float(point[0]))
        return count * (best_scale(shape) - log(shape) + 1.0 + centre)

    search = scipy.optimize.minimize(loss, [0.0], method="L-BFGS-B", bounds=[(log(0.2), log(20.0))])
    shape = exp(float(search.x[0]))
    scale = exp(centre + best_scale(shape) / shape)
    return Distribution("weibull", {"shape": shape, "scale": scale}), float(search.fun)


def _fit_lognormal(times: Array, seen: Mask) -> tuple[Distribution, float]:
    """The law and minus its log-likelihood; sigma (of ln t) lies between 0.05 and 5."""
    logs = np.log(times)
    done, cut = logs[seen], logs[~seen]

    def loss(point: Array) -> float:
        mu, sigma = float(point[0]), exp(float(point[1]))
        density = 0.5 * ((done - mu) / sigma) ** 2 + log(sigma) + 0.5 * log(2.0 * np.pi) + done
        # A stay that was cut off counts with its survival; log_ndtr keeps that finite however long it was.
        return float(density.sum() - scipy.special.log_ndtr(-(cut - mu) / sigma).sum())

    first = [float(done.mean()), log(min(max(float(done.std()), 0.05), 5.0))]
    search = scipy.optimize.minimize(loss, first, method="L-BFGS-B", bounds=[(None, None), (log(0.05), log(5.0))])
    law = Distribution("lognormal", {"mu": float(search.x[0]), "sigma": exp(float(search.x[1]))})
    return law, float(search.fun)


def fit_stays(model: Model | Tracker, traces: Sequence[Trace]) -> dict[str, Stay]:
    """`Model.semi_markov` from encoded traces: law, next locations and inputs of each location that was stayed in.

    The next location's probabilities are counts plus a half for every location to which an edge leads and in which the
    traces stay at some time; a location that is never left gets no stay. The result does not depend on the traces'
    order. Raises ValueError when the model cannot be run or a trace has no rows.
    """
    tracker = compile_tracker(model)
    by_location = _stays_by_location(tracker, traces)
    lengths = [stay.end - stay.start for stays in by_location.values() for stay, _ in stays]
    ends = sum(stay.to is not None for stays in by_location.values() for stay, _ in stays)
    # Sums run over sorted values here and below: in floating point they would depend on the traces' order otherwise.
    typical = max(float(np.sum(np.sort(lengths))) / max(ends, 1), MIN_STAY_S) if lengths else 1.0
    ahead: dict[str, set[str]] = {location: set() for location in by_location}
    for edge in tracker.model.sha.edges:
        if edge.source in ahead and edge.source != edge.target and edge.symbol != UNKNOWN:
            ahead[edge.source].add(edge.target)
    fitted = {}
    for location in sorted(by_location):
        stays = sorted(
            by_location[location], key=lambda pair: (pair[0].end - pair[0].start, pair[1].name, pair[0].start)
        )
        counts = Counter(stay.to for stay, _ in stays if stay.to is not None)
        targets = sorted((ahead[location] & by_location.keys()) | set(counts))
        if targets:
            total = sum(counts.values()) + PRIOR_MOVES * len(targets)
            to = {target: (counts[target] + PRIOR_MOVES) / total for target in targets}
            law = fit_law([s.end - s.start for s, _ in stays], [s.to is not None for s, _ in stays], typical)
            fitted[location] = Stay(law, to, _inputs(tracker, location, stays))
    return fitted


def with_inputs(model: Model, traces: Sequence[Trace]) -> Model:
    """The model with the inputs of its stays fitted to encoded traces; laws and next locations stay as they are.

    For an automaton that reads more signals than before: an input of which the traces say nothing is kept.
    """
    tracker = compile_tracker(model)
    by_location = _stays_by_location(tracker, traces)
    stays = {
        name: replace(stay, inputs={**stay.inputs, **_inputs(tracker, name, by_location.get(name, []))})
        for name, stay in model.semi_markov.items()
    }
    return replace(model, semi_markov=stays)


def _stays_by_location(tracker: Tracker, traces: Sequence[Trace]) -> dict[str, list[tuple[Sojourn, Trace]]]:
    """The stays of all traces, each with its trace; those that begin with an UNKNOWN are left out."""
    by_location: dict[str, list[tuple[Sojourn, Trace]]] = {}
    for trace in traces:
        for stay in sojourns(tracker, trace):
            if not stay.gap:
                by_location.setdefault(stay.location, []).append((stay, trace))
    return by_location


def _inputs(
    tracker: Tracker, location: str, stays: Sequence[tuple[Sojourn, Trace]]
) -> Mapping[str, tuple[float, float]]:
    """Mean and standard deviation, from stay to stay, of the time average of each signal that is read there.

    Both are weighted by the stays' lengths. With a single stay the deviation is that inside it.
    """
    moments = {}
    own = [driver.signal for driver in tracker.modes[location].location.flow.inputs]
    for signal in dict.fromkeys([*own, *effect_signals(tracker.model.sha, location)]):
        # By the trace's identity: traces are compared by their arrays, and two may have one name.
        read: dict[int, tuple[Array, Array]] = {}
        for _, trace in stays:
            if signal in trace.signals and id(trace) not in read:
                finite = np.isfinite(trace.signals[signal])
                read[id(trace)] = trace.times[finite], trace.signals[signal][finite]
        rows = [_average(*read[id(trace)], stay) for stay, trace in stays if id(trace) in read]
        known = np.array([row for row in rows if np.isfinite(row[0])])
        if len(known):
            mean = float(np.average(known[:, 0], weights=known[:, 2]))
            between = float(np.average((known[:, 0] - mean) ** 2, weights=known[:, 2]))
            moments[signal] = (mean, float(np.sqrt(between if len(known) > 1 else known[0, 1])))
    return moments


def _average(times: Array, values: Array, stay: Sojourn) -> tuple[float, float, float]:
    """(mean, variance, seconds) of readings over the stay, each one held until the next; NaN without readings."""
    first, last = np.searchsorted(times, [stay.start, stay.end], side="right")
    # The reading before the stay's first one is held into it.
    rows = slice(max(int(first) - 1, 0), int(last))
    values, begins = values[rows], np.maximum(times[rows], stay.start)
    lasts = np.diff(begins, append=stay.end)
    whole = float(lasts.sum())
    if not whole > 0:
        return float("nan"), float("nan"), 0.0
    mean = float((values * lasts).sum() / whole)
    return mean, float(((values - mean) ** 2 * lasts).sum() / whole), whole
