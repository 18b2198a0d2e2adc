"""The pilots of importance splitting: levels, and laws of mode parameters where those may have laws of their own."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from sim.checking.smc.paths.plan import Indices
from sim.checking.smc.paths.tilting import balance, fitted, moved, neutral
from sim.checking.smc.splitting.stage import Entries, Way, begin, choose, goal_of, onward, stage
from sim.sha.trace import Array

SHARE = 0.2
"""The share of the pilot's runs that reach the next level."""

ENOUGH = 0.1
"""The effective share that is to reach it where runs carry weights: (sum w)^2 / sum w^2 over the number of all."""

LEAST_STEP = 0.2
"""A level taken for that is no nearer to the last one than this, relative to the level that SHARE of the runs reach."""

MOST_LEVELS = 60
PILOT, PILOTS = 2000, 5
SETTLED = 0.3
"""A pilot is the last one when it moves the laws of mode parameters by less (standard deviations of their own)."""

Report = Callable[[str, float], None]


class NoWay(ValueError):
    """The pilot did not come near the event."""


@dataclass(frozen=True, slots=True)
class Plan:
    """What the pilots found: the way with its tilts, the levels, and the share of the weight given back by each."""

    way: Way
    levels: list[float]
    shares: list[float]


def find_plan(way: Way, rng: np.random.Generator, report: Report) -> Plan:
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


def _pilot(way: Way, rng: np.random.Generator, report: Report) -> tuple[Plan | NoWay, Array]:
    """Levels that about a fifth of the runs of each stage reach, all below the formula's nearest line.

    With it the scores (PILOT, K) of mode parameters in the runs that came to the event, or nearest to it.
    """
    goal, plan = goal_of(way), Plan(way, [], [])
    entries = begin(way, PILOT, rng)
    levels, share = plan.levels, 0.0
    while len(levels) < MOST_LEVELS:
        report(f"looking for levels: {len(levels)}", 0.0)
        ended = stage(way, entries, [goal], inf, rng)
        level = _next(way, ended, goal, share, levels[-1] if levels else float(entries.peak.min()))
        if level >= goal:
            hits = np.flatnonzero(ended.hit)
            chosen = hits if not hits.size else choose(way.owed(ended, 1.0), hits, PILOT, rng)
            return plan, ended.state.drawn[chosen] if way.tilts else np.empty((0, 0))
        if levels and level <= levels[-1]:
            return _no_way(way, levels), entries.state.drawn
        reached = stage(way, entries, [level, goal], level, rng)
        rows = np.flatnonzero((reached.peak >= level) | reached.hit)
        if not rows.size:
            return plan, entries.state.drawn
        if way.tilts is not None:
            share = balance(way.tilts, reached.state.drawn[rows], reached.spent[rows], share)
        levels.append(level)
        plan.shares.append(share)
        entries = onward(way, reached, choose(way.owed(reached, share), rows, PILOT, rng), share)
    return NoWay(f"importance splitting needs more than {MOST_LEVELS} levels: the event is rarer than 1e-41"), (
        entries.state.drawn
    )


def _next(way: Way, ended: Entries, goal: float, share: float, before: float) -> float:
    """The level that SHARE of the runs reach; a lower one where few of those carry most of what is to be given back,
    if that is still a step from the level `before`."""
    ahead = np.where(ended.hit, goal, np.minimum(ended.peak, goal))
    level = float(np.quantile(ahead, 1.0 - SHARE))
    for part in (SHARE, 2.0 * SHARE, 3.0 * SHARE, 4.0 * SHARE) if way.tilts is not None else ():
        lower = float(np.quantile(ahead, 1.0 - part))
        if lower - before < LEAST_STEP * (level - before):
            break
        level = lower
        rows = np.flatnonzero(ahead >= level)
        if _effective(way, ended, rows, share, last=level >= goal) >= ENOUGH * ahead.size:
            break
    return level


def _effective(way: Way, ended: Entries, rows: Indices, share: float, *, last: bool) -> float:
    """How many runs of equal weight these rows are worth where they are to be weighted on: (sum w)^2 / sum w^2."""
    if way.tilts is None:
        return float(rows.size)
    drawn, spent = ended.state.drawn[rows], ended.spent[rows]
    given = 1.0 if last else balance(way.tilts, drawn, spent, share)
    weights = np.exp(given * way.tilts.log_weights(drawn) - spent)
    return float(weights.sum() ** 2 / np.square(weights).sum())


def _no_way(way: Way, levels: Sequence[float]) -> NoWay:
    reached = "are reached" if way.tilts else f"are reached with a chance of about {SHARE ** len(levels):.1g}"
    return NoWay(
        f"importance splitting finds no way: {way.sign * levels[-1]:.6g} degC {reached}, and hardly any run comes "
        "nearer to the event from there"
    )
