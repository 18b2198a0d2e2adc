"""What the temperature may do next: a fan of quantiles, the chance of reaching a limit, and when.

The events to come are not known, so runs are drawn: X and m from the belief, the present stay's remaining time given
its age, the stays after it by `sim.sha.semi_markov`, inputs held in the present stay and drawn anew for each later one.
Each run then takes exact flow steps on its own clock (`sim.engine.particles`); `sim.forecast.band_widening`
widens fan and runs.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil, inf, isfinite, sqrt
from statistics import NormalDist

import numpy as np

from sim.effects import VaryingLaw, effect_kind, heat_lag
from sim.engine import (
    BLOCK_ROWS,
    Belief,
    Layout,
    PathRuns,
    Tracker,
    acting_paths,
    acting_stays,
    advance,
    augmented_path_runs,
    compile_tracker,
    draw_layout,
    joined,
    next_location,
    on_event,
    real_age,
    run,
    survival,
)
from sim.engine import fastest as relaxation
from sim.forecast.band_widening import widened_fan, widened_runs, widening_factors
from sim.scores import Estimate, clopper_pearson
from sim.sha import (
    RELAXING_FLOWS,
    Array,
    Event,
    Model,
    draw_paths,
    flows,
    input_moments,
    known_paths,
)

FAN_LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)
"""The levels of a fan's quantiles: median, 50 % and 90 % band."""

JOINED = 8
"""Forecasts whose runs go side by side (`fans`): more take more memory and gain nothing."""

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

    `factors` (H,) are those by which the fan was widened. `borrowed` is for each horizon the probability of a location
    that no data have shown (`Model.borrowed`). `clamps` counts the times that a run left the automaton's
    range, `cut` the runs that jumped more often than `semi_markov.MAX_STAYS`: above 0, doubt the model.
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
    borrowed: tuple[float, ...] = ()


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
    levels: tuple[float, ...] = FAN_LEVELS,
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
    tracker = compile_tracker(model)
    ahead = np.asarray(horizons, dtype=float)
    if ahead.ndim != 1 or not ahead.size or not np.all(np.diff(ahead, prepend=0.0) > 0) or not isfinite(ahead[-1]):
        raise ValueError(f"horizons must be positive seconds in ascending order, got {list(horizons)}")
    if runs < 2:
        raise ValueError(f"a forecast needs at least 2 runs, got {runs}")
    if 0.5 not in levels or not 0 < levels[0] <= levels[-1] < 1 or np.any(np.diff(levels) <= 0):
        raise ValueError(f"levels must ascend inside (0, 1) and have the median 0.5, got {list(levels)}")
    last, exact = float(ahead[-1]), None
    grid = _grid(tracker, ahead)
    at = np.searchsorted(grid, ahead)
    factors = widening_factors(tracker.model.calibration if calibration is None else calibration, ahead)
    names = [location.name for location in tracker.model.sha.locations]
    if tracker.plant is not None and (events or not tracker.plant.is_random):
        known = [(begin, names.index(name)) for begin, name in acting_stays(tracker, belief, events or ())]
        if events is None:
            # Under a dead time the plant is already where it acts only later: paths are drawn from there.
            age = real_age(tracker.plant, belief)
            drawn = draw_paths(tracker.chain, known[-1][1], age=age, horizon=last, runs=runs, rng=rng)
            paths = acting_paths(tracker.plant, belief, known, drawn)
        else:
            paths = known_paths(known, belief.age, runs)
        done = augmented_path_runs(tracker, tracker.plant, belief, paths, grid=grid, rng=rng)
    else:
        if events is None:
            layout = _unknown_future(tracker, belief, grid=grid, runs=runs, rng=rng)
        else:
            inputs = input_moments(tracker.model, belief.signals)
            stays, exact = _known_future(tracker, belief, events, horizons=ahead, levels=levels, inputs=inputs)
            paths = known_paths(stays, belief.age, runs)
            layout = draw_layout(tracker, belief, paths, grid=grid, inputs=inputs, rng=rng)
        done, paths = run(layout), layout.paths
        del layout  # half of what a forecast holds, which the chance of the limit does not ask for

    rows, columns = done.marks[at], np.arange(runs)
    if exact is None:
        exact = _quantiles(done.end[rows, columns], _reading_noise(tracker, rows.shape, rng), levels)
    # Before the row of a grid's point are the points before it, and the run's jumps.
    counts = [
        np.bincount(places, minlength=len(names)).tolist() for places in paths.location[rows - at[:, None], columns]
    ]
    locations = tuple(
        {name: float(count) / runs for name, count in zip(names, row, strict=True) if count} for row in counts
    )
    reached = _reach_chances(belief, done, limit=limit, grid=grid, horizons=ahead, factors=factors)
    return Forecast(
        time=belief.time,
        horizons=ahead,
        levels=levels,
        quantiles=widened_fan(exact, factors, levels.index(0.5)),
        locations=locations,
        limit=limit,
        exceedance=tuple(clopper_pearson(float(share) * runs, runs) for share in reached[at + 1]),
        minutes_to_limit=limit_minutes(np.concatenate([[0.0], grid]), reached),
        runs=runs,
        factors=factors,
        clamps=done.clamps,
        cut=paths.cut,
        borrowed=tuple(sum(row.get(name, 0.0) for name in tracker.model.borrowed) for row in locations),
    )


def fans(
    tracker: Tracker, origins: Sequence[tuple[Belief, tuple[float, ...]]], rng: np.random.Generator, *, runs: int
) -> list[Array]:
    """(L, H) each: the quantiles of the `forecast` from each belief at its own horizons, events unknown.

    They are those of one forecast after the other, and their runs go side by side: what a step takes besides its
    numbers is paid once for JOINED of them.
    """
    found: list[Array] = [np.empty(0)] * len(origins)
    grids = {horizons: _grid(tracker, np.array(horizons)) for horizons in {horizons for _, horizons in origins}}
    waiting: dict[tuple[float, ...], list[tuple[int, Layout, Array]]] = {horizons: [] for horizons in grids}

    def settle(horizons: tuple[float, ...]) -> None:
        numbers, layouts, noise = zip(*waiting[horizons], strict=True)
        waiting[horizons].clear()
        done, ahead = run(joined(layouts)), np.array(horizons)
        rows = done.marks[np.searchsorted(grids[horizons], ahead)]
        end = done.end[rows, np.arange(rows.shape[1])].reshape(ahead.size, len(numbers), runs)
        quantiles, factors = (
            _quantiles(end, np.stack(noise, axis=1), FAN_LEVELS),
            widening_factors(tracker.model.calibration, ahead),
        )
        for place, number in enumerate(numbers):
            found[number] = widened_fan(quantiles[:, :, place], factors, FAN_LEVELS.index(0.5))

    for number, (belief, horizons) in enumerate(origins):
        if tracker.plant is not None and not tracker.plant.is_random:
            found[number] = forecast(tracker, belief, horizons, rng, runs=runs).quantiles
            continue
        layout = _unknown_future(tracker, belief, grid=grids[horizons], runs=runs, rng=rng)
        waiting[horizons].append((number, layout, _reading_noise(tracker, (len(horizons), runs), rng)))
        if len(waiting[horizons]) == JOINED:
            settle(horizons)
    for horizons, left in waiting.items():
        if left:
            settle(horizons)
    return found


def _unknown_future(tracker: Tracker, belief: Belief, *, grid: Array, runs: int, rng: np.random.Generator) -> Layout:
    """The runs from `belief` when nothing is known of the events to come."""
    place, last = tracker.chain.names.index(belief.location), float(grid[-1])
    paths = draw_paths(tracker.chain, place, age=belief.age, horizon=last, runs=runs, rng=rng)
    inputs = input_moments(tracker.model, belief.signals)
    return draw_layout(tracker, belief, paths, grid=grid, inputs=inputs, rng=rng)


def _reading_noise(tracker: Tracker, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    # The fan is of readings, so each run's end gets a reading's noise.
    return np.asarray(tracker.model.sensor_sigma * rng.standard_normal(shape))


def _quantiles(end: Array, noise: Array, levels: tuple[float, ...]) -> Array:
    """(L, ...) the quantiles of the readings at the ends (..., N) of N runs."""
    return np.asarray(np.quantile(end + noise, levels, axis=-1))


def _grid(tracker: Tracker, horizons: Array) -> Array:
    """The times for all runs on which the chance of the limit is read off; the horizons are among them."""
    last = float(horizons[-1])
    return np.union1d(np.linspace(0.0, last, _points(tracker, last) + 1)[1:], horizons)


def _points(tracker: Tracker, horizon: float) -> int:
    """Points of the common grid: by the fastest relaxation and the fastest fading drift of the model's flows."""
    fastest = 0.0
    for location in tracker.model.sha.locations:
        params = location.flow.params
        if location.flow.kind in RELAXING_FLOWS:
            fastest = max(fastest, params["k"])
        else:
            fastest = max(fastest, 1.0 / float(flows.fade_ages(location.flow, 0.5)))
    if tracker.plant is not None:
        starts = [
            law.speed(acting.effect)
            for acting in tracker.plant.startups
            if isinstance(law := effect_kind(acting.effect).law, VaryingLaw)
        ]
        fades = [1.0 / heat_lag(effect) for effect in tracker.plant.late]
        fastest = max(fastest, float(relaxation(tracker.plant).max()), *starts, *fades)
    return int(min(max(ceil(horizon * fastest / 0.1), LEAST_GRID), MOST_GRID))


def _reach_chances(
    belief: Belief, done: PathRuns, *, limit: float, grid: Array, horizons: Array, factors: Array
) -> Array:
    """(G + 1,) the chance of having reached the limit by now and by each of the grid's points.

    Runs are widened about their median as the fan is: their distance from it, at each of their steps' ends, is
    multiplied by the factor of that moment.
    """
    if belief.x >= limit:
        return np.ones(grid.size + 1)
    if limit == inf:
        return np.zeros(grid.size + 1)  # nobody asked for one
    columns, alive = np.arange(done.end.shape[1]), np.empty(done.end.shape)
    widened = bool(np.any(factors != 1.0))
    clock = np.concatenate([[0.0], grid])
    median = np.concatenate([[np.median(done.start[0])], np.median(done.end[done.marks, columns], axis=1)])
    # What holds at the ends of the steps before the next ones: the chance so far, and how runs are widened there.
    so_far: Array = np.ones(columns.size)
    factor, middle = np.full((1, columns.size), factors[0]), np.full((1, columns.size), median[0])
    at_start = float(
        np.mean((widened_runs(done.start[0], factor[0], middle[0]) if widened else done.start[0]) >= limit)
    )
    for top in range(0, len(alive), BLOCK_ROWS):
        rows = slice(top, top + BLOCK_ROWS)
        start, end, widening = done.start[rows], done.end[rows], np.ones(())
        if widened:
            # A step begins where the one before it ends: what is looked up there holds for both.
            factor = np.vstack([factor[-1], np.interp(done.ends[rows], horizons, factors)])
            middle = np.vstack([middle[-1], np.interp(done.ends[rows], clock, median)])
            widening = factor[1:]
            start = widened_runs(start, factor[:-1], middle[:-1])
            end = widened_runs(end, widening, middle[1:])
        # A run that is below the limit at both ends of a step may have touched it in between: `survival` takes that
        # chance from the bridge, so that what is said of the limit does not depend on how fine the grid is.
        alive[rows] = survival(start, end, done.bridge[rows], limit, widening, alive=so_far)
        so_far = alive[rows][-1]
    return np.concatenate([[at_start], 1.0 - alive[done.marks, columns].mean(axis=1)])


def limit_minutes(clock: Array, reached: Array) -> tuple[float, float, float]:
    """The 5, 50 and 95 % quantiles of the time to the limit, in minutes, from the chance `reached` by `clock` (s).

    Linear in between; inf where that share is never reached.
    """

    def minutes_to_share(share: float) -> float:
        if reached[-1] < share:
            return inf
        row = int(np.searchsorted(reached, share))
        if row == 0:
            return 0.0
        part = (share - reached[row - 1]) / (reached[row] - reached[row - 1])
        return float(clock[row - 1] + part * (clock[row] - clock[row - 1])) / 60.0

    return minutes_to_share(0.05), minutes_to_share(0.5), minutes_to_share(0.95)


def _known_future(
    tracker: Tracker,
    belief: Belief,
    events: Sequence[Event],
    *,
    horizons: Array,
    levels: tuple[float, ...],
    inputs: Array,
) -> tuple[list[tuple[float, int]], Array]:
    """The stays (seconds from now, location index) that `events` lead through, and the exact quantiles (L, H)."""
    index = {location.name: row for row, location in enumerate(tracker.model.sha.locations)}
    stays = [(0.0, index[belief.location])]
    spread = np.array([NormalDist().inv_cdf(level) for level in levels])
    # The belief itself is carried forward, event by event and horizon by horizon: with the events known it stays a
    # Gaussian, and its quantiles are exact where runs would only sample them.
    columns, coming, ahead = [], sorted(events, key=lambda event: event.time), belief
    for horizon in horizons.tolist():
        while coming and coming[0].time <= belief.time + horizon:
            event = coming.pop(0)
            target, _ = next_location(tracker, ahead.location, event.symbol)
            ahead = on_event(tracker, ahead, event)
            if target is not None:
                # A later stay's inputs are not known: their mean is its offset, their spread adds to that of m.
                place = index[target]
                added = float(inputs[place, 1]) ** 2
                ahead = replace(ahead, offset=float(inputs[place, 0]), mm=ahead.mm + added)
                stays.append((max(event.time - belief.time, 0.0), place))
        ahead = advance(tracker, ahead, belief.time + horizon)
        columns.append(ahead.x + spread * sqrt(ahead.xx + tracker.model.sensor_sigma**2))
    return stays, np.array(columns).T
