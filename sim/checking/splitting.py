"""Rare events by importance splitting: the way to the event is cut into levels, each of which is not rare.

Fixed effort (Garvels 2000; Rubino & Tuffin 2009, chapter 3): in each stage the same number of runs starts from states
drawn, with replacement, among those in which the previous level was first reached; the product of the stages' shares is
an unbiased estimate of the probability, whatever the levels. They lie on the running maximum (for `Temp <= c` minimum)
of the temperature, bridges included, and come from a pilot that takes no part in the estimate. The whole is repeated,
the repetitions being independent, and their mean has a Student interval corrected for their skewness (Hall 1992): a
product of shares is skewed to the right, and the plain interval lies too low too often.

Mode parameters of long stays are drawn where the event needs them (`sim.checking.tilting`), and their weight w is given
back on the way: a run that reached level l is chosen in proportion to w^(a_l - a_{l-1}), a_l growing from 0 to 1 at the
event, and the share of a stage is the mean of these factors over all of its runs, 0 for those that did not reach the
level. That stays unbiased for fixed a_l (it is a Feynman-Kac particle scheme: Del Moral 2004, section 7.4). A greater m
makes the next level likelier and weighs less; with both at every level the runs keep the m that the event needs.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import inf, sqrt

import numpy as np
from scipy.special import stdtrit

from sim.checking.monitor import inside
from sim.checking.monitor_formula import Lines, exists
from sim.checking.monitor_path import Watch
from sim.checking.paths import Engine, Indices, Piece, State, with_extremes
from sim.checking.query import Always, Eventually
from sim.checking.tilting import Tilts, balance, fitted, moved, neutral
from sim.sha.scores import Estimate
from sim.sha.trace import Array, Mask

SHARE = 0.2
"""The share of the pilot's runs that reach the next level."""

ENOUGH = 0.1
"""The effective share that is to reach it where runs carry weights: (sum w)^2 / sum w^2 over the number of all."""

MOST_LEVELS = 60
PILOT, PILOTS = 2000, 5
SETTLED = 0.3
"""A pilot is the last one when it moves the laws of mode parameters by less (standard deviations of their own)."""

GOOD, MORE = 0.12, 4
"""A relative standard error above GOOD: all is done again with MORE times the runs, and the first part is dropped."""

Report = Callable[[str, float], None]


class NoWay(ValueError):
    """The pilot did not come near the event."""


@dataclass(frozen=True, slots=True)
class Split:
    """The estimate of a rare event: its mean over `repetitions` with a 95 % (`level`) interval, and the way to it.

    `levels` are (degC, the chance to reach it) each; `relative` is the standard error over the mean.
    """

    estimate: Estimate
    levels: tuple[tuple[float, float], ...]
    repetitions: int
    relative: float


@dataclass(slots=True)
class _Entries:
    """n runs to go on: state, row from which, greatest sign * temperature so far, whether the event has happened.

    `spent` is the part of the logarithm of their weight that they were chosen by already.
    """

    state: State
    row: Indices
    peak: Array
    hit: Mask
    spent: Array

    def take(self, rows: Indices) -> "_Entries":
        return _Entries(self.state.take(rows), self.row[rows], self.peak[rows], self.hit[rows], self.spent[rows])


@dataclass(frozen=True, slots=True)
class _Way:
    """What all stages share. `levels` are those of sign * temperature, ascending."""

    engine: Engine
    lines: Lines
    low: float
    high: float
    sign: float
    tilts: Tilts | None = None

    def tilted(self, tilts: Tilts) -> "_Way":
        """The same with mode parameters drawn by these laws."""
        return replace(self, engine=self.engine.tilted(tilts), tilts=tilts)

    def owed(self, entries: _Entries, share: float) -> Array:
        """(n,) the logarithm of what these runs are still to be weighted by up to `share` of their whole weight."""
        if self.tilts is None:
            return np.zeros(entries.row.size)
        return share * self.tilts.log_weights(entries.state.drawn) - entries.spent


@dataclass(frozen=True, slots=True)
class _Plan:
    """What the pilots found: the way with its tilts, the levels, and the share of the weight given back by each."""

    way: _Way
    levels: list[float]
    shares: list[float]


def refusal(one: Watch) -> str:
    """Why this path has no levels on the temperature to split on; empty where it has."""
    if not isinstance(one.path, Eventually | Always):
        return "importance splitting answers <> and [] only"
    if not one.lines.lines:
        return "importance splitting needs a temperature in the formula: its levels lie on the way to it"
    if not one.lines.still or len({up for _, up in one.lines.watched}) != 1:
        return "importance splitting needs comparisons of the temperature with fixed numbers, all in one direction"
    return ""


def split(
    engine: Engine,
    one: Watch,
    rng: np.random.Generator,
    *,
    runs: int = 1000,
    repetitions: int = 40,
    confidence: float = 0.95,
    report: Report = lambda what, share: None,
) -> Split:
    """The probability that the path's formula comes true (for `[]`: that it is violated).

    `runs` start in each stage of each repetition. Raises ValueError as `refusal` says, and NoWay when the pilot does
    not come near the event.
    """
    reason = refusal(one)
    if reason:
        raise ValueError(reason)
    sign = 1.0 if next(iter(one.lines.watched))[1] else -1.0
    way = _Way(engine, one.lines, one.path.span.low, min(one.path.span.high, one.bound), sign)
    with np.errstate(over="ignore", invalid="ignore"):  # a line at infinity is never reached
        return _split(way, rng, runs, repetitions, confidence, report)


def _split(
    way: _Way, rng: np.random.Generator, runs: int, repetitions: int, confidence: float, report: Report
) -> Split:
    plan = _plan(way, rng, report)
    for size in (runs, MORE * runs):
        chances = _repeat(plan, size, repetitions, rng, report)
        mean, error = float(chances[-1].mean()), float(chances[-1].std(ddof=1)) / sqrt(repetitions)
        runs = size
        if error <= GOOD * mean:
            break
    low, high = _interval(chances[-1], confidence)
    reached = zip(plan.levels, chances[:-1].mean(axis=1).tolist(), strict=True)
    return Split(
        Estimate(mean, low, high, runs * repetitions * len(chances)),
        tuple((way.sign * level, chance) for level, chance in reached),
        repetitions,
        error / mean if mean > 0 else inf,
    )


def _interval(values: Array, confidence: float) -> tuple[float, float]:
    """An interval for the mean of independent values that may be skewed; [0, 1] where all are 0.

    Student's t for a cubic of the studentised mean that takes the skewness out (Hall 1992, J. R. Stat. Soc. B 54, 221).
    """
    mean, deviation, root = float(values.mean()), float(values.std(ddof=1)), sqrt(values.size)
    if deviation == 0.0:
        return (mean, mean) if mean > 0.0 else (0.0, 1.0)
    skewness = float(np.mean((values - mean) ** 3) / values.std() ** 3) or 1e-9
    reach = float(stdtrit(values.size - 1, 0.5 + confidence / 2.0)) / root

    def place(x: float) -> float:
        bent = float(np.cbrt(1.0 + skewness * (x - skewness / (6.0 * values.size))))
        return mean - deviation * 3.0 / skewness * (bent - 1.0)

    return min(max(place(reach), 0.0), 1.0), min(max(place(-reach), 0.0), 1.0)


def _begin(way: _Way, runs: int, rng: np.random.Generator) -> _Entries:
    state = way.engine.begin(runs, rng)
    none = np.zeros(runs, dtype=np.bool_)
    return _Entries(state, np.zeros(runs, dtype=np.intp), way.sign * state.x, none, np.zeros(runs))


def _goal(way: _Way) -> float:
    """The nearest line that the formula looks at."""
    places = [way.sign * float(line.level) for line in way.lines.lines if line.level is not None]
    return min(places)


def _plan(way: _Way, rng: np.random.Generator, report: Report) -> _Plan:
    """Levels and, where mode parameters may be drawn by laws of their own, those laws: pilots until they settle.

    Raises NoWay when the last pilot does not come near the event.
    """
    if not way.engine.columns:
        found = _pilot(way, rng, report)[0]
    else:
        tilts = neutral(way.engine.columns)
        for _ in range(PILOTS):
            found, scores = _pilot(way.tilted(tilts), rng, report)
            before, tilts = tilts, fitted(scores)
            if moved(before, tilts) < SETTLED:
                break
    if isinstance(found, NoWay):
        raise found
    return found


def _pilot(way: _Way, rng: np.random.Generator, report: Report) -> tuple[_Plan | NoWay, Array]:
    """Levels that about a fifth of the runs of each stage reach, all below the formula's nearest line.

    With it the scores (PILOT, K) of mode parameters in the runs that came to the event, or nearest to it.
    """
    goal, plan = _goal(way), _Plan(way, [], [])
    entries = _begin(way, PILOT, rng)
    levels, share = plan.levels, 0.0
    while len(levels) < MOST_LEVELS:
        report(f"looking for levels: {len(levels)}", 0.0)
        ended = _stage(way, entries, [goal], inf, rng)
        level = _next(way, ended, goal, share)
        if level >= goal:
            hits = np.flatnonzero(ended.hit)
            chosen = hits if not hits.size else _choose(way.owed(ended, 1.0), hits, PILOT, rng)
            return plan, ended.state.drawn[chosen] if way.tilts else np.empty((0, 0))
        if levels and level <= levels[-1]:
            return _no_way(way, levels), entries.state.drawn
        reached = _stage(way, entries, [level, goal], level, rng)
        rows = np.flatnonzero((reached.peak >= level) | reached.hit)
        if not rows.size:
            return plan, entries.state.drawn
        if way.tilts is not None:
            share = balance(way.tilts, reached.state.drawn[rows], reached.spent[rows], share)
        levels.append(level)
        plan.shares.append(share)
        entries = _onward(way, reached, _choose(way.owed(reached, share), rows, PILOT, rng), share)
    return NoWay(f"importance splitting needs more than {MOST_LEVELS} levels: the event is rarer than 1e-41"), (
        entries.state.drawn
    )


def _next(way: _Way, ended: _Entries, goal: float, share: float) -> float:
    """The level that SHARE of the runs reach; a lower one where few of those carry most of what is to be given back."""
    ahead = np.where(ended.hit, goal, np.minimum(ended.peak, goal))
    if way.tilts is None:
        return float(np.quantile(ahead, 1.0 - SHARE))
    for part in (SHARE, 2.0 * SHARE, 3.0 * SHARE, 4.0 * SHARE):
        level = float(np.quantile(ahead, 1.0 - part))
        rows = np.flatnonzero(ahead >= level)
        drawn, spent = ended.state.drawn[rows], ended.spent[rows]
        given = 1.0 if level >= goal else balance(way.tilts, drawn, spent, share)
        weights = np.exp(given * way.tilts.log_weights(drawn) - spent)
        if weights.sum() ** 2 >= ENOUGH * ahead.size * (weights**2).sum():
            break
    return level


def _no_way(way: _Way, levels: Sequence[float]) -> NoWay:
    return NoWay(
        f"importance splitting finds no way: {way.sign * levels[-1]:.6g} degC are reached with a chance of "
        f"about {SHARE ** len(levels):.1g}, and hardly any run comes nearer to the event from there"
    )


def _choose(owed: Array, rows: Indices, runs: int, rng: np.random.Generator) -> Indices:
    """`runs` of these rows with replacement, in proportion to exp(owed): stratified, so that chance adds little."""
    chances = np.cumsum(np.exp(owed[rows] - owed[rows].max()))
    places = (np.arange(runs) + rng.random(runs)) / runs * chances[-1]
    return np.asarray(rows[np.minimum(np.searchsorted(chances, places, side="right"), rows.size - 1)])


def _onward(way: _Way, ended: _Entries, chosen: Indices, share: float) -> _Entries:
    """The chosen runs, with `share` of their weight spent."""
    entries = ended.take(chosen)
    entries.spent += way.owed(entries, share)
    return entries


def _repeat(plan: _Plan, runs: int, repetitions: int, rng: np.random.Generator, report: Report) -> Array:
    """(stages, repetitions) each repetition's estimate of the chance to reach each level; the last is the event.

    It is the mean factor of the stage's runs, 0 for those that do not come there, times those of the stages before.
    """
    way, levels = plan.way, plan.levels
    chances, before = np.zeros((len(levels) + 1, repetitions)), np.ones(repetitions)
    group = np.repeat(np.arange(repetitions), runs)
    entries = _begin(way, group.size, rng)
    for stage, (level, share) in enumerate(zip([*levels, inf], [*plan.shares, 1.0], strict=True)):
        report(f"level {stage + 1} of {len(levels) + 1}", stage / (len(levels) + 1))
        ended = _stage(way, entries, [*levels[stage:], _goal(way)], level, rng)
        reached = ended.hit | (ended.peak >= level)
        owed, whole = way.owed(ended, share), way.owed(ended, 1.0)
        chances[stage] = before * np.bincount(group[reached], np.exp(whole[reached]), minlength=repetitions) / runs
        before *= np.bincount(group[reached], np.exp(owed[reached]), minlength=repetitions) / runs
        living = np.flatnonzero(before > 0)
        if not living.size:
            break
        chosen = [_choose(owed, np.flatnonzero(reached & (group == one)), runs, rng) for one in living.tolist()]
        entries, group = _onward(way, ended, np.concatenate(chosen), share), np.repeat(living, runs)
    return chances


def _stage(way: _Way, entries: _Entries, ahead: list[float], level: float, rng: np.random.Generator) -> _Entries:
    """The runs led on until `level` or the event is reached, or the end; each where it stopped.

    `ahead` are the levels still to come: bridges are drawn for all of them, since a run may pass several in one piece.
    """
    out = entries.take(np.arange(entries.row.size))
    waiting = ~(out.hit | (out.peak >= level))
    live = np.empty(0, dtype=np.intp)
    state = out.state.take(live)
    last = way.engine.clock.size - 1
    order = np.flatnonzero(waiting)
    order = order[np.argsort(out.row[order], kind="stable")]
    begins = np.searchsorted(out.row[order], np.arange(last + 1))
    for row in range(last):
        new = order[begins[row] : begins[row + 1]]
        if new.size:
            state, live = state.joined(out.state.take(new)), np.concatenate([live, new])
        if not live.size:
            continue
        for piece in way.engine.advance(row, state, rng):
            _note(way, piece, live if piece.rows is None else live[piece.rows], out, ahead, rng)
        stopped = out.hit[live] | (out.peak[live] >= level)
        if stopped.any():
            out.state.put(live[stopped], state.take(stopped))
            out.row[live[stopped]] = row + 1
            state, live = state.take(~stopped), live[~stopped]
    return out


def _note(way: _Way, piece: Piece, who: Indices, out: _Entries, ahead: list[float], rng: np.random.Generator) -> None:
    start, end = way.sign * piece.start, way.sign * piece.end
    top = np.maximum(start, end)
    marks = np.array([*sorted({*ahead, *(way.sign * float(line.level or 0.0) for line in way.lines.lines)}), inf])
    above = way.sign * marks[np.searchsorted(marks[:-1], top, side="right")]  # what a bridge reaches first
    up = way.sign > 0
    with_extremes(piece, [(above, above)] if up else [], [] if up else [(above, above)], rng)
    drawn = piece.rise if up else piece.fall
    if drawn is not None:
        rows, e = drawn
        bridge = piece.bridge[rows] if isinstance(piece.bridge, np.ndarray) else piece.bridge
        a, b = start[rows], end[rows]
        top[rows] = 0.5 * (a + b + np.sqrt((b - a) ** 2 + 2.0 * bridge * e))
    out.peak[who] = np.maximum(out.peak[who], top)
    if inside(piece, way.low, way.high):
        met = exists(way.lines, 0, piece)
        if met is not False:
            out.hit[who] |= met
