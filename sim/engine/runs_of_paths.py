"""N runs of an automaton with effects along drawn paths of locations: what `sim.engine.particles` is for plain ones.

Every run has its own states, m, signals and thermostat. The steps are those of the common grid and of the run's jumps;
they are not cut further, so a start-up's heat is a parabola inside each, and radiation is linearised about the present
temperature with the rest taken at each step's start.
"""

from collections.abc import Mapping, Sequence
from math import inf

import numpy as np

from sim.effects.kinds import dead_time, sensor_offsets
from sim.engine.belief_state import Belief, Hidden
from sim.engine.kernel import move
from sim.engine.particles import Runs, Steps, drawn_temperatures, merge
from sim.engine.plant import Indices, Plant
from sim.engine.runs import root
from sim.engine.tables import Tables, tables
from sim.engine.terms import Segments
from sim.engine.tracker import Tracker, next_location
from sim.sha.automaton import SHA
from sim.sha.semi_markov import Paths
from sim.sha.trace import UNKNOWN, Array, Event, Mask


def felt_stays(tracker: Tracker, belief: Belief, events: Sequence[Event]) -> list[tuple[float, str]]:
    """(seconds from now, location) of the present stay and those that known events lead to, when they will be felt."""
    delay = dead_time(tracker.model.sha)
    waiting = belief.hidden.pending if belief.hidden is not None else ()
    coming = [(one.due, one.symbol) for one in waiting if one.symbol]
    later = sorted(events, key=lambda event: event.time)
    coming += [(max(event.time, belief.time) + delay, event.symbol) for event in later]
    stays, here = [(0.0, belief.location)], belief.location
    for due, symbol in coming:
        target, _ = next_location(tracker, here, symbol)
        if target is not None:
            here = target
            stays.append((due - belief.time, here))
    return stays


def real_age(plant: Plant, belief: Belief) -> float:
    """Seconds since the plant has entered the location that it is in, whether that is felt already or not."""
    waiting = belief.hidden.pending if belief.hidden is not None else ()
    felt = [one.due for one in waiting if one.symbol]
    entered = felt[-1] if felt else belief.entered
    return max(belief.time + dead_time(plant.sha) - entered, 0.0)


def felt_paths(plant: Plant, belief: Belief, known: Sequence[tuple[float, int]], drawn: Paths) -> Paths:
    """The `drawn` paths, which begin where the plant is, as they will be felt after the `known` stays."""
    runs = drawn.location.shape[1]
    first = np.array([place for _, place in known], dtype=np.intp)[:, None]
    begins = np.array([begin for begin, _ in known])[:, None]
    location = np.vstack([np.repeat(first, runs, axis=1), drawn.location[1:]])
    entered = np.vstack([np.repeat(begins, runs, axis=1), drawn.entered[1:] + dead_time(plant.sha)])
    return Paths(location, entered, belief.age, drawn.cut)


def fly(
    tracker: Tracker, plant: Plant, belief: Belief, paths: Paths, grid: Array, rng: np.random.Generator
) -> tuple[Steps, Runs]:
    """The steps along `paths` and the runs, both of what the sensor reads; `grid` (G,) as in `particles.lay_out`."""
    stay, begin, dt, first, marks = merge(paths, grid)
    states, m0 = _draw(belief, stay.shape[1], rng)
    columns = np.arange(stay.shape[1])
    location = paths.location[stay, columns]
    age = np.maximum(begin - paths.entered[stay, columns], 0.0) + np.where(stay == 0, paths.age, 0.0)
    mode = _modes(tracker, paths, m0, rng)
    signals = _signals(tracker, belief, paths, stay, begin, rng)
    segments = Segments(
        location=location.reshape(-1),
        time=(belief.time + begin).reshape(-1),
        age=age.reshape(-1),
        dt=dt.reshape(-1),
        offset=_offsets(plant.sha, location, signals).reshape(-1),
        signals={name: column.reshape(-1) for name, column in signals.items()},
        since=_since(plant, belief, paths, stay, begin),
    )
    drawn = drawn_temperatures(tracker, location, first, rng)
    about = np.full(dt.size, float(states[:, 0].mean())) if plant.radiation is not None else None
    table = tables(plant, segments, about)
    done = _run(plant, belief, table, (begin, dt), states, mode[stay, columns], drawn, rng)
    read = plant.sensed
    shape = dt.shape
    variance = np.zeros(shape) if plant.lags else table.closed.noise[:, read, read].reshape(shape)
    decay = table.closed.phi[:, 0, 0].reshape(shape)
    zero = np.zeros(shape)
    return Steps(location, begin, dt, age, zero, decay, zero, variance, zero, drawn, marks), done


def _draw(belief: Belief, runs: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """N draws of (states (N, d), m (N,)) from the belief's joint normal law."""
    hidden = belief.hidden or Hidden((), ())
    values, vectors = np.linalg.eigh(np.array(hidden.covariance))
    spread = vectors * np.sqrt(np.maximum(values, 0.0))
    drawn = np.array(hidden.mean) + rng.standard_normal((runs, len(hidden.mean))) @ spread.T
    return drawn[:, :-1], drawn[:, -1]


def _modes(tracker: Tracker, paths: Paths, m0: Array, rng: np.random.Generator) -> Array:
    """(J, N) m of each stay: the belief's in the present one, drawn by its location's law later."""
    laws = np.array([tracker.modes[location.name].parameter for location in tracker.model.sha.locations])
    mean, sigma = laws[:, 0][paths.location], np.sqrt(laws[:, 1])[paths.location]
    mode = mean + sigma * rng.standard_normal(paths.location.shape)
    mode[0] = m0
    return np.asarray(mode)


def _signals(
    tracker: Tracker, belief: Belief, paths: Paths, stay: Indices, begin: Array, rng: np.random.Generator
) -> dict[str, Array]:
    """(S, N) each signal that is read: as it is and as it waits to be felt in the present stay, drawn for later ones.

    A later stay's value follows the location's `Stay.inputs`; without one it stays as it was last.
    """
    sha, held = tracker.model.sha, dict(belief.signals)
    pending = [one for one in (belief.hidden.pending if belief.hidden is not None else ()) if not one.symbol]
    newest = held | {name: value for one in pending for name, value in one.signals.items()}
    columns, found = np.arange(stay.shape[1]), {}
    for name in sorted(tracker.inputs):
        moments = np.array([_moments(tracker, place.name, name, newest) for place in sha.locations])
        value = moments[:, 0][paths.location] + moments[:, 1][paths.location] * rng.standard_normal(
            paths.location.shape
        )
        steps = value[stay, columns]
        now = np.full(steps.shape, held.get(name, np.nan))
        for one in pending:
            if name in one.signals:
                now[begin >= one.due - belief.time] = one.signals[name]
        found[name] = np.where(stay == 0, now, steps)
    return found


def _moments(tracker: Tracker, location: str, signal: str, newest: Mapping[str, float]) -> tuple[float, float]:
    stay = tracker.model.semi_markov.get(location)
    return (stay.inputs if stay is not None else {}).get(signal, (newest.get(signal, np.nan), 0.0))


def _offsets(sha: SHA, location: Indices, signals: Mapping[str, Array]) -> Array:
    """(S, N) what the flows' inputs add to their targets; a signal never read adds nothing."""
    total = np.zeros(location.shape)
    for row, place in enumerate(sha.locations):
        for given in place.flow.inputs:
            added = given.gain * (signals[given.signal] - given.reference)
            total += np.where((location == row) & np.isfinite(added), added, 0.0)
    return total


def _since(plant: Plant, belief: Belief, paths: Paths, stay: Indices, begin: Array) -> tuple[Array, ...]:
    """(S * N,) for each start-up effect the seconds since its event, known so far or met on the way."""
    found, columns = [], np.arange(stay.shape[1])
    known = belief.hidden.since if belief.hidden is not None else ()
    for acting, last in zip(plant.startups, known, strict=True):
        meets = _meets(plant.sha, acting.effect.event)
        times = np.where(meets[paths.location[:-1], paths.location[1:]], paths.entered[1:], -inf)
        first = np.full((1, stay.shape[1]), -inf if last is None else last - belief.time)
        started = np.maximum.accumulate(np.vstack([first, times]), axis=0)
        found.append((begin - started[stay, columns]).reshape(-1))
    return tuple(found)


def _meets(sha: SHA, event: str) -> Mask:
    """(L, L) whether the shortest way of edges from one location to another has the event on it.

    Paths name locations, not events, and moves that take no time are folded into one.
    """
    index = {place.name: row for row, place in enumerate(sha.locations)}
    meets = np.zeros((len(index), len(index)), dtype=np.bool_)
    for source, row in index.items():
        seen, layer = {source}, [(source, False)]
        while layer:
            following = []
            for here, met in layer:
                for edge in sha.edges:
                    if edge.source == here and edge.target not in seen and edge.symbol != UNKNOWN:
                        seen.add(edge.target)
                        meets[row, index[edge.target]] = met or edge.symbol == event
                        following.append((edge.target, met or edge.symbol == event))
            layer = following
    return meets


def _run(
    plant: Plant,
    belief: Belief,
    table: Tables,
    clock: tuple[Array, Array],
    s: Array,
    mode: Array,
    drawn: Array | None,
    rng: np.random.Generator,
) -> Runs:
    """All runs through all rows; the range holds at the end of each."""
    begin, dt = clock
    runs, low, high = dt.shape[1], plant.sha.low, plant.sha.high
    start, end, clamps = np.empty(dt.shape), np.empty(dt.shape), 0
    before, after = (sensor_offsets(plant.sha, belief.time + at) for at in (begin, begin + dt))
    closed = root(table.closed)
    other = closed if table.open is None else root(table.open)
    hidden = belief.hidden or Hidden((), ())
    opened = np.full(runs, hidden.opened)
    for row in range(len(dt)):
        rows = slice(row * runs, (row + 1) * runs)
        if drawn is not None:
            s[:, 0] = np.where(np.isnan(drawn[row]), s[:, 0], drawn[row])
        start[row] = s[:, plant.sensed] + before[row]
        roots = np.where(opened[:, None, None], other[rows], closed[rows])
        push = (roots @ rng.standard_normal((runs, plant.size, 1)))[:, :, 0]
        moved = move(plant, table, rows, s, mode[row], opened, push)
        s, opened = moved.s, moved.opened
        held = np.clip(s[:, 0], low, high)
        clamps += int((held != s[:, 0]).sum())
        s[:, 0] = held
        end[row] = s[:, plant.sensed] + after[row]
    return Runs(start, end, clamps)
