"""What the temperature may do next: a fan of quantiles, the chance of reaching a limit, and when.

The events to come are not known, so runs are drawn: X and m from the belief, the present stay's remaining time given
its age, the stays after it by `sim.sha.semi_markov`, inputs held in the present stay and drawn anew for each later one.
Each run then takes exact flow steps on its own clock (`sim.engine.particles`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil, inf, isfinite, sqrt

import numpy as np
from scipy.special import ndtri

from sim.effects.kind import VaryingLaw
from sim.effects.kinds import kind_of
from sim.engine.belief import Belief, advance, on_event
from sim.engine.cuts import fastest as relaxation
from sim.engine.particles import Runs, Steps, lay_out, run, survival
from sim.engine.plant import Plant
from sim.engine.runs_of_paths import felt_paths, felt_stays, fly, real_age
from sim.engine.tracker import Tracker, compiled, next_location
from sim.scores import Estimate, clopper_pearson
from sim.sha.flows import RELAXING
from sim.sha.model import Model
from sim.sha.semi_markov import Indices, compile_chain, draw_paths, input_moments, known_paths
from sim.sha.trace import Array, Event

LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)
"""The levels of a fan's quantiles: median, 50 % and 90 % band."""

LEAST_GRID, MOST_GRID = 64, 256
"""Points of the common grid over the longest horizon: enough for k dt <= 0.1 with the fastest flow, in these bounds."""


@dataclass(frozen=True, slots=True)
class Forecast:
    """A forecast made at `time` (absolute s) for the H `horizons` (s from then, ascending).

    `quantiles` (L, H), degC, at `levels` (L,), are those of the *measured* temperature, sensor noise included: that is
    what a reading is compared with. `locations` gives for each horizon the probability of each location. `exceedance`
    is for each horizon the probability that the *true* temperature reaches `limit` (degC) at or before it (with a lag
    or an offset among the effects: what a sensor without noise reads), with the interval that the number of runs leaves
    (it says nothing of the model's own error). `minutes_to_limit` are the 5, 50 and 95 % quantiles of the time to the
    limit, inf where the longest horizon ends first.

    `factors` (H,) are those by which the fan was widened. `clamps` counts the times that a run left the automaton's
    range, `cut` the runs that jumped more often than `semi_markov.MOST_STAYS`: above 0, doubt the model.
    """

    time: float
    horizons: Array
    levels: tuple[float, ...]
    quantiles: Array
    locations: tuple[Mapping[str, float], ...]
    limit: float
    exceedance: tuple[Estimate, ...]
    minutes_to_limit: tuple[float, float, float]
    runs: int
    factors: Array
    clamps: int = 0
    cut: int = 0


def forecast(
    model: Model | Tracker,
    belief: Belief,
    horizons: Sequence[float],
    rng: np.random.Generator,
    *,
    limit: float = inf,
    runs: int = 256,
    events: Sequence[Event] | None = None,
    calibration: Mapping[float, float] | None = None,
    levels: tuple[float, ...] = LEVELS,
) -> Forecast:
    """The forecast from `belief` at `horizons` (s, positive, ascending), by `runs` runs.

    A location without a stay in `model.semi_markov` is never left: the fan then widens by m and the flow's noise only.
    With `events` (absolute times, after the belief's) those are all that will happen: the quantiles are then the exact
    Gaussian ones, and only `exceedance` and the minutes come from runs; with effects all does. `calibration` (horizon
    in s -> factor of the standard deviation, linear in between, constant outside) takes the place of the model's own;
    it widens the runs about their median, in the fan and on the way to the limit alike. When the belief's mean is at
    the limit already, the exceedance is 1 and the minutes are 0. `levels` are those of the fan; the median must be one
    of them.

    Raises ValueError on horizons that are not positive and ascending, levels that do not ascend inside (0, 1) or lack
    the median, runs below 2, and a model that cannot be run.
    """
    tracker = compiled(model)
    factors = tracker.model.calibration if calibration is None else calibration
    asked = _asked(tracker, horizons, factors, limit, runs, levels)
    if tracker.plant is not None:
        return _augmented(tracker, tracker.plant, belief, asked, events, runs, rng)
    inputs = input_moments(tracker.model, belief.signals)
    if events is None:
        chain = compile_chain(tracker.model)
        place = chain.names.index(belief.location)
        paths, exact = draw_paths(chain, place, belief.age, float(asked.horizons[-1]), runs, rng), None
    else:
        stays, exact = _known_future(tracker, belief, events, asked, inputs)
        paths = known_paths(stays, belief.age, runs)
    steps, x0 = lay_out(tracker, belief, paths, asked.grid, inputs, rng)
    done = run(tracker.model.sha, steps, x0)
    return _told(tracker, belief, asked, steps, done, exact, rng, paths.cut)


def _augmented(
    tracker: Tracker,
    plant: Plant,
    belief: Belief,
    asked: "_Asked",
    events: Sequence[Event] | None,
    runs: int,
    rng: np.random.Generator,
) -> Forecast:
    """The forecast of a model with effects: always by runs, also when the events to come are known."""
    index = {location.name: row for row, location in enumerate(tracker.model.sha.locations)}
    stays = felt_stays(tracker, belief, events or ())
    known = [(begin, index[name]) for begin, name in stays]
    if events is None:
        chain = compile_chain(tracker.model)
        age = real_age(plant, belief)
        drawn = draw_paths(chain, known[-1][1], age, float(asked.horizons[-1]), runs, rng)
        paths = felt_paths(plant, belief, known, drawn)
    else:
        paths = known_paths(known, belief.age, runs)
    steps, done = fly(tracker, plant, belief, paths, asked.grid, rng)
    return _told(tracker, belief, asked, steps, done, None, rng, paths.cut)


@dataclass(frozen=True, slots=True)
class _Asked:
    """What is asked: horizons and factors (H,), the common grid (G,) that holds the horizons in its rows `at` (H,)."""

    horizons: Array
    factors: Array
    grid: Array
    at: Indices
    limit: float
    levels: tuple[float, ...]


def _asked(
    tracker: Tracker,
    horizons: Sequence[float],
    calibration: Mapping[float, float],
    limit: float,
    runs: int,
    levels: tuple[float, ...],
) -> _Asked:
    asked = np.asarray(horizons, dtype=float)
    if asked.ndim != 1 or not asked.size or not np.all(np.diff(asked, prepend=0.0) > 0) or not isfinite(asked[-1]):
        raise ValueError(f"horizons must be positive seconds in ascending order, got {list(horizons)}")
    if runs < 2:
        raise ValueError(f"a forecast needs at least 2 runs, got {runs}")
    if 0.5 not in levels or not 0 < levels[0] <= levels[-1] < 1 or np.any(np.diff(levels) <= 0):
        raise ValueError(f"levels must ascend inside (0, 1) and have the median 0.5, got {list(levels)}")
    points = _points(tracker, float(asked[-1]))
    grid = np.union1d(np.linspace(0.0, asked[-1], points + 1)[1:], asked)
    return _Asked(asked, _factors(calibration, asked), grid, np.searchsorted(grid, asked), limit, levels)


def _told(
    tracker: Tracker,
    belief: Belief,
    asked: _Asked,
    steps: Steps,
    done: Runs,
    exact: Array | None,
    rng: np.random.Generator,
    cut: int,
) -> Forecast:
    """The runs told as a forecast; `exact` are the quantiles where they are known without runs."""
    rows, columns = steps.marks[asked.at], np.arange(done.end.shape[1])
    if exact is None:
        read = done.end[rows, columns] + tracker.model.sensor_sigma * rng.standard_normal(rows.shape)
        exact = np.quantile(read, asked.levels, axis=1)
    reached, names = _reached(belief, asked, steps, done), [place.name for place in tracker.model.sha.locations]
    return Forecast(
        time=belief.time,
        horizons=asked.horizons,
        levels=asked.levels,
        quantiles=_widened(exact, asked.factors, asked.levels.index(0.5)),
        locations=tuple(_shares(names, row) for row in steps.location[rows, columns]),
        limit=asked.limit,
        exceedance=tuple(clopper_pearson(float(share) * columns.size, columns.size) for share in reached[asked.at + 1]),
        minutes_to_limit=_minutes(np.concatenate([[0.0], asked.grid]), reached),
        runs=columns.size,
        factors=asked.factors,
        clamps=done.clamps,
        cut=cut,
    )


def _points(tracker: Tracker, horizon: float) -> int:
    """Points of the common grid: by the fastest relaxation and the shortest t0 of the model's flows."""
    fastest = 0.0
    for location in tracker.model.sha.locations:
        params = location.flow.params
        if location.flow.kind in RELAXING:
            fastest = max(fastest, params["k"])
        elif location.flow.kind == "logarithmic":
            fastest = max(fastest, 1.0 / params["t0"])
    if tracker.plant is not None:
        starts = [
            law.speed(acting.effect)
            for acting in tracker.plant.startups
            if isinstance(law := kind_of(acting.effect).law, VaryingLaw)
        ]
        fastest = max(fastest, float(relaxation(tracker.plant).max()), *starts)
    return int(min(max(ceil(horizon * fastest / 0.1), LEAST_GRID), MOST_GRID))


def _factors(calibration: Mapping[float, float], horizons: Array) -> Array:
    """(H,) the factors at the horizons: linear between those given, constant outside, 1 without any."""
    if not calibration:
        return np.ones(horizons.shape)
    known = sorted(calibration)
    factors = np.interp(horizons, known, [calibration[horizon] for horizon in known])
    if not np.all((factors > 0) & (factors < inf)):
        raise ValueError(f"the calibration's factors must be positive and finite, got {dict(calibration)}")
    return np.asarray(factors)


def _widened(quantiles: Array, factors: Array, middle: int) -> Array:
    median = quantiles[middle]
    return np.asarray(median + factors * (quantiles - median))


def _shares(names: Sequence[str], places: Array) -> dict[str, float]:
    counts = np.bincount(places, minlength=len(names))
    return {name: float(count) / places.size for name, count in zip(names, counts, strict=True) if count}


def _reached(belief: Belief, asked: _Asked, steps: Steps, done: Runs) -> Array:
    """(G + 1,) the chance of having reached the limit by now and by each of the grid's points.

    Runs are widened about their median as the fan is: their distance from it, at each of their steps' ends, is
    multiplied by the factor of that moment.
    """
    if belief.x >= asked.limit:
        return np.ones(asked.grid.size + 1)
    columns = np.arange(done.end.shape[1])
    start, end, widening = done.start, done.end, np.ones(())
    if np.any(asked.factors != 1.0):
        clock = np.concatenate([[0.0], asked.grid])
        median = np.concatenate([[np.median(start[0])], np.median(end[steps.marks, columns], axis=1)])
        start, _ = _stretched(asked, start, steps.begin, clock, median)
        end, widening = _stretched(asked, end, steps.begin + steps.dt, clock, median)
    alive = survival(start, end, steps, asked.limit, widening)
    first = float(np.mean(start[0] >= asked.limit))
    return np.concatenate([[first], 1.0 - alive[steps.marks, columns].mean(axis=1)])


def _stretched(asked: _Asked, x: Array, times: Array, clock: Array, median: Array) -> tuple[Array, Array]:
    middle, factor = np.interp(times, clock, median), np.interp(times, asked.horizons, asked.factors)
    return middle + factor * (x - middle), factor


def _minutes(clock: Array, reached: Array) -> tuple[float, float, float]:
    """The 5, 50 and 95 % quantiles of the time to the limit, in minutes; inf where that share is never reached."""

    def until(share: float) -> float:
        if reached[-1] < share:
            return inf
        row = int(np.searchsorted(reached, share))
        if row == 0:
            return 0.0
        part = (share - reached[row - 1]) / (reached[row] - reached[row - 1])
        return float(clock[row - 1] + part * (clock[row] - clock[row - 1])) / 60.0

    return until(0.05), until(0.5), until(0.95)


def _known_future(
    tracker: Tracker, belief: Belief, events: Sequence[Event], asked: _Asked, inputs: Array
) -> tuple[list[tuple[float, int]], Array]:
    """The stays (seconds from now, location index) that `events` lead through, and the exact quantiles (L, H)."""
    index = {location.name: row for row, location in enumerate(tracker.model.sha.locations)}
    stays = [(0.0, index[belief.location])]
    spread = np.asarray(ndtri(asked.levels))
    columns, coming, ahead = [], sorted(events, key=lambda event: event.time), belief
    for horizon in asked.horizons.tolist():
        while coming and coming[0].time <= belief.time + horizon:
            event = coming.pop(0)
            target, _ = next_location(tracker, ahead.location, event.symbol)
            ahead = on_event(tracker, ahead, event)
            if target is not None:
                place = index[target]
                added = float(inputs[place, 1]) ** 2
                ahead = replace(ahead, offset=float(inputs[place, 0]), mm=ahead.mm + added)
                stays.append((max(event.time - belief.time, 0.0), place))
        ahead = advance(tracker, ahead, belief.time + horizon)
        columns.append(ahead.x + spread * sqrt(ahead.xx + tracker.model.sensor_sigma**2))
    return stays, np.array(columns).T
