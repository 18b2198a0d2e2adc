"""The pilots of importance splitting: levels, and laws of mode parameters where those may have laws of their own."""

from dataclasses import dataclass
from math import inf

import numpy as np

from sim.lab.checking.smc.paths import balance, fit_tilts, neutral, tilt_distance
from sim.lab.checking.smc.rules import Progress
from sim.lab.checking.smc.splitting.stage import (
    EntranceStates,
    RareEvent,
    begin,
    nearest_line,
    resample,
    select_runs,
    stage,
)
from sim.sha import Array

LEVEL_SHARE = 0.2
"""The share of the pilot's runs that reach the next level."""

MIN_EFFECTIVE_SHARE = 0.1
"""The effective share that is to reach it where runs carry weights: (sum w)^2 / sum w^2 over the number of all."""

MIN_LEVEL_STEP = 0.2
"""A level taken for that is no nearer to the last one than this, relative to the level that LEVEL_SHARE of the runs
reach."""

MAX_LEVELS = 60
PILOT, PILOTS = 2000, 5
SETTLED_SIGMAS = 0.3
"""A pilot is the last one when it moves the laws of mode parameters by less (standard deviations of their own)."""


class PilotFailed(ValueError):
    """The pilot did not come near the event."""


@dataclass(frozen=True, slots=True)
class SplittingPlan:
    """What the pilots found: the event with its tilts, the levels, and the share of the weight given back by each."""

    event: RareEvent
    levels: list[float]
    shares: list[float]


def find_plan(event: RareEvent, rng: np.random.Generator, report: Progress) -> SplittingPlan:
    """Levels and, where mode parameters may be drawn by laws of their own, those laws: pilots until they settle.

    Raises PilotFailed when the last pilot does not come near the event.
    """
    if not event.engine.columns:
        plan = _pilot(event, rng, report)[0]
    else:
        tilts = neutral(event.engine.columns)
        for _ in range(PILOTS):
            # The cross-entropy method: each pilot, drawn by the last one's laws, comes nearer to those of the event.
            plan, scores = _pilot(event.tilt(tilts), rng, report)
            before, tilts = tilts, fit_tilts(scores)
            if tilt_distance(before, tilts) < SETTLED_SIGMAS:
                break
    if isinstance(plan, PilotFailed):
        raise plan
    return plan


def _pilot(event: RareEvent, rng: np.random.Generator, report: Progress) -> tuple[SplittingPlan | PilotFailed, Array]:
    """Levels that about a fifth of the runs of each stage reach, all below the formula's nearest line.

    With it the scores (PILOT, K) of mode parameters in the runs that came to the event, or nearest to it.
    """
    goal, plan = nearest_line(event), SplittingPlan(event, [], [])
    entries = begin(event, PILOT, rng)
    levels, share = plan.levels, 0.0
    while len(levels) < MAX_LEVELS:
        report(f"looking for levels: {len(levels)}", 0.0)
        ended = stage(event, entries, [goal], inf, rng)
        level = _next(event, ended, goal, share, levels[-1] if levels else float(entries.peak.min()))
        if level >= goal:
            hits = np.flatnonzero(ended.hit)
            chosen = hits if not hits.size else resample(event.outstanding(ended, 1.0), hits, PILOT, rng)
            return plan, ended.state.drawn[chosen] if event.tilts else np.empty((0, 0))
        if levels and level <= levels[-1]:
            reached_by = "" if event.tilts else f" with a chance of about {LEVEL_SHARE ** len(levels):.1g}"
            failure = (
                f"importance splitting finds no way: {event.sign * levels[-1]:.6g} degC are reached{reached_by}, and "
                "hardly any run comes nearer to the event from there"
            )
            return PilotFailed(failure), entries.state.drawn
        # The same entrance states once more, now stopped at the level: what starts the next stage is where it was met.
        reached = stage(event, entries, [level, goal], level, rng)
        rows = np.flatnonzero((reached.peak >= level) | reached.hit)
        if not rows.size:
            return plan, entries.state.drawn
        if event.tilts is not None:
            share = balance(event.tilts, reached.state.drawn[rows], reached.applied[rows], share)
        levels.append(level)
        plan.shares.append(share)
        entries = select_runs(event, reached, resample(event.outstanding(reached, share), rows, PILOT, rng), share)
    failure = f"importance splitting needs more than {MAX_LEVELS} levels: the event is rarer than 1e-41"
    return PilotFailed(failure), entries.state.drawn


def _next(event: RareEvent, ended: EntranceStates, goal: float, share: float, before: float) -> float:
    """The level that LEVEL_SHARE of the runs reach; a lower one where few of those carry most of what is to be given
    back, if that is still a step from the level `before`."""
    ahead = np.where(ended.hit, goal, np.minimum(ended.peak, goal))
    level = float(np.quantile(ahead, 1.0 - LEVEL_SHARE))
    tilts = event.tilts
    if tilts is None:
        return level
    for part in (LEVEL_SHARE, 2.0 * LEVEL_SHARE, 3.0 * LEVEL_SHARE, 4.0 * LEVEL_SHARE):
        lower = float(np.quantile(ahead, 1.0 - part))
        if lower - before < MIN_LEVEL_STEP * (level - before):
            break
        level = lower
        rows = np.flatnonzero(ahead >= level)
        # How many runs of equal weight these are worth where they are to be weighted on: Kish's (sum w)^2 / sum w^2.
        drawn, applied = ended.state.drawn[rows], ended.applied[rows]
        exponent = 1.0 if level >= goal else balance(tilts, drawn, applied, share)
        weights = np.exp(exponent * tilts.log_weights(drawn) - applied)
        if float(weights.sum() ** 2 / np.square(weights).sum()) >= MIN_EFFECTIVE_SHARE * ahead.size:
            break
    return level
