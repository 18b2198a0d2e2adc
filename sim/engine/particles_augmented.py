"""N runs of an automaton with effects along drawn paths of locations: what `sim.engine.particles` is for plain ones.

The two are a pair because the plain one is twice as fast on plain models (`benchmarks.engines`, decision 0049); a test
holds them against each other.

Every run has its own states, m, signals and thermostat. The steps are those of the common grid and of the run's jumps;
they are not cut further, so a start-up's heat and what comes late are a parabola inside each, and radiation is
linearised about the present temperature with the rest taken at each step's start.
"""

from collections.abc import Mapping, Sequence
from math import inf

import numpy as np

from sim.effects import dead_time, delay_of, late_jumps, late_source, remaining_share, sensor_offsets
from sim.engine.belief_state import Belief, Hidden
from sim.engine.kernel import move
from sim.engine.particles import PathRuns, bridges, draw_states, drawn_temperatures, merge
from sim.engine.plant import Indices, Plant
from sim.engine.tables import noise_root, tables
from sim.engine.terms import Segments
from sim.engine.tracker import Tracker, next_location
from sim.sha import SHA, UNKNOWN, Array, Event, Mask, Paths


def acting_stays(tracker: Tracker, belief: Belief, events: Sequence[Event]) -> list[tuple[float, str]]:
    """(seconds from now, location) of the present stay and those that known events lead to, when they act."""
    delay = dead_time(tracker.model.sha)
    delayed = belief.hidden.pending if belief.hidden is not None else ()
    coming = [(each.due, each.symbol) for each in delayed if each.symbol]
    later = sorted(events, key=lambda event: event.time)
    coming += [(max(event.time, belief.time) + delay, event.symbol) for event in later]
    stays, current = [(0.0, belief.location)], belief.location
    for due, symbol in coming:
        target, _ = next_location(tracker, current, symbol)
        if target is not None:
            current = target
            stays.append((due - belief.time, current))
    return stays


def real_age(plant: Plant, belief: Belief) -> float:
    """Seconds since the plant has entered the location that it is in, whether that acts already or not."""
    delayed = belief.hidden.pending if belief.hidden is not None else ()
    due = [each.due for each in delayed if each.symbol]
    entered = due[-1] if due else belief.entered
    return max(belief.time + dead_time(plant.sha) - entered, 0.0)


def acting_paths(plant: Plant, belief: Belief, known: Sequence[tuple[float, int]], drawn: Paths) -> Paths:
    """The `drawn` paths, which begin where the plant is, as they act after the `known` stays."""
    runs = drawn.location.shape[1]
    first = np.array([place for _, place in known], dtype=np.intp)[:, None]
    begins = np.array([begin for begin, _ in known])[:, None]
    location = np.vstack([np.repeat(first, runs, axis=1), drawn.location[1:]])
    entered = np.vstack([np.repeat(begins, runs, axis=1), drawn.entered[1:] + dead_time(plant.sha)])
    return Paths(location, entered, belief.age, drawn.cut)


def augmented_path_runs(
    tracker: Tracker, plant: Plant, belief: Belief, paths: Paths, *, grid: Array, rng: np.random.Generator
) -> PathRuns:
    """The runs along `paths`, of what the sensor reads; `grid` (G,) as in `particles.draw_layout`.

    The random numbers come in this order: states and m of the belief, m of the stays, signals by name, X where it is
    drawn, then each row's noise. A seed's forecast depends on it.
    """
    ends, first, marks = merge(paths, grid)
    stay, begin = np.cumsum(first, axis=0, dtype=np.intp), np.vstack([np.zeros(ends.shape[1]), ends[:-1]])
    dt = ends - begin
    sha, shape = plant.sha, dt.shape
    hidden = belief.hidden or Hidden((), ())
    s, m0 = draw_states(hidden, shape[1], rng)
    columns = np.arange(shape[1])
    location = paths.location[stay, columns]
    age = np.maximum(begin - paths.entered[stay, columns], 0.0) + np.where(stay == 0, paths.age, 0.0)

    laws = np.array([tracker.modes[place.name].parameter for place in sha.locations])
    mean, sigma = laws[:, 0][paths.location], np.sqrt(laws[:, 1])[paths.location]
    modes = mean + sigma * rng.standard_normal(paths.location.shape)
    modes[0] = m0
    mode = modes[stay, columns]

    signals = _signals(tracker, belief, paths, stay, begin, rng=rng)
    offset = np.zeros(shape)
    for row, place in enumerate(sha.locations):
        for driver in place.flow.inputs:
            added = driver.gain * (signals[driver.signal] - driver.reference)
            offset += np.where((location == row) & np.isfinite(added), added, 0.0)
    # A start-up's clock begins with its event: the last one known, or one met on the way to a later stay.
    since = []
    for acting, last in zip(plant.startups, hidden.since, strict=True):
        meets = _meets(sha, acting.effect.event)
        times = np.where(meets[paths.location[:-1], paths.location[1:]], paths.entered[1:], -inf)
        known = np.full((1, shape[1]), -inf if last is None else last - belief.time)
        started = np.maximum.accumulate(np.vstack([known, times]), axis=0)
        since.append((begin - started[stay, columns]).reshape(-1))
    fading, waiting = _late(plant, belief, signals, begin, dt)
    segments = Segments(
        location=location.reshape(-1),
        time=(belief.time + begin).reshape(-1),
        age=age.reshape(-1),
        dt=dt.reshape(-1),
        offset=offset.reshape(-1),
        signals={name: column.reshape(-1) for name, column in signals.items()},
        since=tuple(since),
        late=tuple(column.reshape(-1) for column in fading),
        waiting=waiting.reshape(-1),
    )
    drawn = drawn_temperatures(tracker, paths, first, rng)
    about = np.full(dt.size, float(s[:, 0].mean())) if plant.radiation is not None else None
    table = tables(plant, segments, about)

    start, end, clamps = np.empty(shape), np.empty(shape), 0
    before, after = (sensor_offsets(sha, belief.time + at) for at in (begin, begin + dt))
    closed = noise_root(table.closed)
    other = closed if table.open is None else noise_root(table.open)
    opened = np.full(shape[1], hidden.opened)
    for row in range(shape[0]):
        rows = slice(row * shape[1], (row + 1) * shape[1])
        if drawn is not None:
            s[:, 0] = np.where(np.isnan(drawn[row]), s[:, 0], drawn[row])
        start[row] = s[:, plant.sensor_state] + before[row]
        roots = np.where(opened[:, None, None], other[rows], closed[rows])
        noise = (roots @ rng.standard_normal((shape[1], plant.size, 1)))[:, :, 0]
        moved = move(plant, table, rows, s=s, mode=mode[row], opened=opened, noise=noise)
        s, opened = moved.s, moved.opened
        held = np.clip(s[:, 0], sha.low, sha.high)
        clamps += int((held != s[:, 0]).sum())
        s[:, 0] = held
        end[row] = s[:, plant.sensor_state] + after[row]

    # Behind a lag the path is smooth: nothing happens between the ends of a step that the ends do not show.
    variance = (
        np.zeros(shape) if plant.lags else table.closed.noise[:, plant.sensor_state, plant.sensor_state].reshape(shape)
    )
    bridge = bridges(table.closed.phi[:, 0, 0].reshape(shape), variance)
    return PathRuns(ends, start, end, bridge, marks=marks, clamps=clamps)


def _signals(
    tracker: Tracker, belief: Belief, paths: Paths, stay: Indices, begin: Array, *, rng: np.random.Generator
) -> dict[str, Array]:
    """(S, N) each signal that is read: as it is and as a dead time delays it in the present stay, drawn for later ones.

    A later stay's value follows the location's `Stay.inputs`; without one it stays as it was last.
    """
    sha, held = tracker.model.sha, dict(belief.signals)
    pending = [each for each in (belief.hidden.pending if belief.hidden is not None else ()) if not each.symbol]
    newest = held | {name: value for each in pending for name, value in each.signals.items()}
    columns, values = np.arange(stay.shape[1]), {}
    stays = [tracker.model.semi_markov.get(place.name) for place in sha.locations]
    learned = [stay_.inputs if stay_ is not None else {} for stay_ in stays]
    for name in sorted(tracker.inputs):  # by name: a set has no order, and the random numbers need one
        moments = np.array([inputs.get(name, (newest.get(name, np.nan), 0.0)) for inputs in learned])
        mean, sigma = moments[:, 0][paths.location], moments[:, 1][paths.location]
        value = mean + sigma * rng.standard_normal(paths.location.shape)
        now = np.full(stay.shape, held.get(name, np.nan))
        for each in pending:
            if name in each.signals:
                now[begin >= each.due - belief.time] = each.signals[name]
        values[name] = np.where(stay == 0, now, value[stay, columns])
    return values


def _late(
    plant: Plant, belief: Belief, signals: Mapping[str, Array], begin: Array, dt: Array
) -> tuple[list[Array], Array]:
    """What comes late: (S, N) what fades of each such effect at each step's start, as the belief has it and then along
    the signals, and (S, N) what of all of them waits, its mean over the step."""
    hidden = belief.hidden or Hidden((), ())
    columns, waiting = list[Array](), np.zeros(dt.shape)
    for number, (effect, deviation) in enumerate(zip(plant.late, hidden.late, strict=True)):
        now = {name: np.array(belief.signals.get(name, np.nan)) for name in effect.signals.values()}
        source, kept, delay = late_source(effect, signals), remaining_share(effect, dt), delay_of(effect)
        jumps = late_jumps(
            np.vstack([np.broadcast_to(late_source(effect, now), source[:1].shape), source[:-1]]), source
        )
        if delay > 0:
            jumped, known = np.cumsum(jumps, axis=0), [each for each in hidden.pending if each.jumps]
            due = _mean_before(jumped, begin, dt, delay)
            for each in known:
                since = np.clip(begin + dt - (each.due - belief.time), 0.0, dt)
                due += each.jumps[number] * since / np.where(dt > 0, dt, 1.0)
            for row in range(dt.shape[0]):  # steps of no length are as the one before
                due[row] = np.where(dt[row] > 0, due[row], due[row - 1] if row else 0.0)
            waiting += jumped + sum(each.jumps[number] for each in known) - due
            jumps = np.diff(due, axis=0, prepend=np.zeros((1, dt.shape[1])))
        column = np.empty(dt.shape)
        at: Array = np.full(dt.shape[1], deviation)
        for row in range(dt.shape[0]):
            column[row] = at = at + jumps[row]
            at = at * kept[row]
        columns.append(column)
    return columns, waiting


def _mean_before(column: Array, begin: Array, dt: Array, delay: float) -> Array:
    """(S, N) the mean over each step of what a column held `delay` s before, 0 before the first step."""
    ends = np.vstack([begin[:1], begin + dt])
    whole = np.vstack([np.zeros((1, dt.shape[1])), np.cumsum(column * dt, axis=0)])
    earlier = np.column_stack(
        [np.interp(clock - delay, clock, total) for clock, total in zip(ends.T, whole.T, strict=True)]
    )
    return np.diff(earlier, axis=0) / np.where(dt > 0, dt, 1.0)


def _meets(sha: SHA, event: str) -> Mask:
    """(L, L) whether the shortest way of edges from one location to another has the event on it.

    Paths name locations, not events, and moves that take no time are folded into one.
    """
    index = {place.name: row for row, place in enumerate(sha.locations)}
    meets = np.zeros((len(index), len(index)), dtype=np.bool_)
    for source, row in index.items():
        # Breadth first, so that the way met first is the shortest; of equally short ones that whose edges come first.
        seen, layer = {source}, [(source, False)]
        while layer:
            following = []
            for current, met in layer:
                for edge in sha.edges:
                    if edge.source == current and edge.target not in seen and edge.symbol != UNKNOWN:
                        seen.add(edge.target)
                        meets[row, index[edge.target]] = met or edge.symbol == event
                        following.append((edge.target, met or edge.symbol == event))
            layer = following
    return meets
