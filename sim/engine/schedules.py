"""From timed events and output times to exact steps: where the automaton is, for how long, and what drives it."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from sim.effects import (
    check_effects,
    dead_time,
    delay_of,
    effect_signals,
    in_sensor_scale,
    late_jumps,
    late_source,
    refuse,
    remaining_share,
)
from sim.engine.cuts import Stays, cuts
from sim.engine.plant import compile_plant
from sim.engine.recursion import MAX_LOOP_STEPS, linear_recursion
from sim.engine.terms import Segments
from sim.moments import exact_moment
from sim.sha import (
    SHA,
    UNKNOWN,
    Array,
    Coefficients,
    Effect,
    Event,
    Indices,
    Mask,
    Model,
    Trace,
    by_kind,
    flows,
    transitions,
)

Policy = Literal["reject", "ignore", "resync"]
"""What an event without an edge does: ValueError; nothing; a jump to where its symbol leads most often."""


@dataclass(frozen=True, slots=True)
class Schedule:
    """n exact steps through the locations of `sha`, from `start` (absolute s) to the last output time.

    `times` (m,) are the output times in absolute seconds; all other arrays are (n,), one entry a step:
    `location` the index into `sha.locations`; `entry` whether a stay begins with the step (`entry[0]` is always true:
    the first stay has its own mode parameter, but X is given there and never resampled); `age` the seconds since the
    location was entered, at the step's start; `dt` its length in seconds (0 for a stay or output at the same instant);
    `offset` what the inputs add to the target, held over the step (degC); `output` the row of `times` at which the
    step ends, or -1; `checked` whether it ends at an event or an output, where the temperature is held against the
    model's range. Every output row ends exactly one step, after the events of that instant.

    `unmatched` are the indices of the events that had no edge and were ignored or resynchronised. `segments` has what
    the effects need of each step; None where the automaton has none, and only then are the steps exact by the flows
    alone (`step_coefficients`).
    """

    sha: SHA
    start: float
    times: Array
    location: Indices
    entry: Mask
    age: Array
    dt: Array
    offset: Array
    output: Indices
    checked: Mask
    unmatched: tuple[int, ...] = ()
    segments: Segments | None = None

    @property
    def output_location(self) -> Indices:
        """(m,) the location index at each output time, after the events of that instant."""
        return self.location[self.output >= 0]

    @property
    def stay(self) -> Indices:
        """(n,) which stay each step belongs to, counted from 0."""
        return np.cumsum(self.entry) - 1


def schedule(
    model: Model | SHA,
    events: Sequence[Event],
    outputs: ArrayLike,
    *,
    start: float | None = None,
    inputs: Trace | None = None,
    policy: Policy = "reject",
) -> Schedule:
    """The exact steps from `start` to the last of the `outputs` (m,), in absolute seconds.

    `start` is the first output time unless given. Events before it only settle where the run starts, and with which
    age; events after the last output are not looked at. At equal times events come first, in their order, each with a
    stay of its own (of length 0), then the outputs.

    `inputs` gives the signals that `driven` flows name: a reading holds until the next one, NaN is no reading, and
    before its first reading a signal counts as at its reference (it adds nothing). Steps are cut at new readings only
    where the location is driven by them, or an effect that acts there reads them. A dead time among the effects moves
    all events and readings to later times; other effects may cut steps more finely (`sim.engine.cuts`).

    UNKNOWN always leads to the initial location. An event that has no edge follows `policy`: `reject` raises
    ValueError naming index, location, symbol and time; `ignore` leaves the stay as it is; `resync` enters the location
    that most edges with its symbol lead to (the first in the model's order among equals; the initial location when no
    edge has the symbol).

    Raises ValueError on a model that is not deterministic or has guards, on output or event times that go back or are
    no numbers, on an output before `start`, and on a missing input signal. A model's correction is worked into the
    schedule's automaton: temperatures along it are the sensor's.
    """
    sha = in_sensor_scale(model).sha if isinstance(model, Model) else model
    times = np.atleast_1d(np.asarray(outputs, dtype=float))
    if times.ndim != 1 or times.size == 0:
        raise ValueError(f"output times must be a non-empty list of seconds, got the shape {times.shape}")
    if not np.all(np.isfinite(times)) or np.any(np.diff(times) < 0):
        raise ValueError("output times must be numbers and never go back")
    if start is not None and not start <= times[0]:
        raise ValueError(f"the first output time {times[0]} lies before the start {start}")
    begin = float(times[0]) if start is None else float(start)
    readings = inputs if inputs is not None else Trace("no inputs", np.empty(0), {})
    if not sha.effects:
        walk = _walk(sha, events, begin, float(times[-1]), policy)
        return _steps(sha, walk, times, readings.times, _readings(sha, walk.location, readings))
    check_effects(sha)
    delay = dead_time(sha)
    # A dead time is a shift of all that acts; from here on times are those at which things act.
    acting = [Event(event.time + delay, event.symbol) for event in events]
    later = Trace(readings.name, readings.times + delay, readings.signals)
    end = float(times[-1])
    walk, plant = _walk(sha, acting, begin, end, policy), compile_plant(sha)
    starts = tuple(
        np.array([event.time for event in acting if event.symbol == startup.effect.event], dtype=float)
        for startup in plant.startups
    )
    held = _readings(sha, walk.location, later)
    late = tuple(_Late.along_readings(effect, later.times, held) for effect in plant.late)
    changed = tuple(each.due for each in late)
    stays = Stays(
        walk.begins, np.append(walk.begins[1:], end), walk.entered, walk.location, starts=starts, changed=changed
    )
    finer = np.unique(cuts(plant, stays))
    finer = finer[(finer > walk.begins[0]) & (finer < end)]
    return _steps(sha, walk, times, later.times, held, finer=finer, starts=starts, late=late)


def since_last(times: Array, starts: Array) -> Array:
    """Seconds since the last of `starts`; inf before the first."""
    return np.asarray(times - np.append(starts, -np.inf)[np.searchsorted(starts, times, side="right") - 1])


@dataclass(frozen=True, slots=True)
class _Late:
    """What comes late along readings: its source has `jumped` (degC/s) by each of its changes, at `changed` (s), and
    what is `due` (s) then fades: `deviation` (degC/s) is that after each.

    Jumps and deviation begin with a row of 0, from before any change.
    """

    effect: Effect
    changed: Array
    due: Array
    jumped: Array
    deviation: Array

    @classmethod
    def along_readings(cls, effect: Effect, clock: Array, held: dict[str, Array]) -> "_Late":
        """Along the readings `held` from the times `clock` on."""
        source = late_source(effect, held)
        jumps = late_jumps(source[:-1], source[1:])
        rows = np.flatnonzero(jumps)
        changed = clock[1:][rows]
        kept = remaining_share(effect, np.diff(changed, prepend=changed[:1]))
        deviation = linear_recursion(kept, jumps[rows], 0.0, loop=rows.size <= MAX_LOOP_STEPS)
        jumped = np.append(0.0, np.cumsum(jumps[rows]))
        return cls(effect, changed, changed + delay_of(effect), jumped, np.append(0.0, deviation))

    def fading_at(self, times: Array) -> Array:
        """What fades at each of the times, after the readings of that instant."""
        row = np.searchsorted(self.due, times, side="right")
        return self.deviation[row] * remaining_share(self.effect, times - np.append(-np.inf, self.due)[row])

    def waiting_at(self, times: Array) -> Array:
        """What has jumped and does not fade yet at each of the times."""
        known, due = (np.searchsorted(clock, times, side="right") for clock in (self.changed, self.due))
        return self.jumped[known] - self.jumped[due]


def _steps(
    sha: SHA,
    walk: "_Walk",
    times: Array,
    clock: Array,
    held: dict[str, Array],
    *,
    finer: Array | None = None,
    starts: tuple[Array, ...] = (),
    late: tuple[_Late, ...] = (),
) -> Schedule:
    """Sorts the three kinds of boundaries; a step lies between each and the next.

    `held` are the readings at the times `clock`. With effects, `finer` are the times at which they cut further,
    `starts` the events of each start-up effect, and `late` what comes late.
    """
    inner = _input_cuts(sha, walk, clock, held, times)
    if finer is not None:
        inner = np.union1d(inner, finer[~(_among(finer, times) | _among(finer, walk.begins))])
    # A stable sort of events, then cuts, then outputs is their order at one instant: what is written out at the time of
    # an event is the temperature after it.
    marks = np.concatenate([walk.begins, inner, times])
    rank = np.repeat(np.arange(3), [walk.begins.size, inner.size, times.size])
    order = np.argsort(marks, kind="stable")
    marks, rank = marks[order], rank[order]
    entry, ends = rank[:-1] == 0, rank[1:]
    stay = np.cumsum(entry) - 1
    location = walk.location[stay]
    output = np.full(ends.size, -1, dtype=np.intp)
    output[ends == 2] = np.arange(times.size)
    steps = Schedule(
        sha=sha,
        start=float(marks[0]),
        times=times,
        location=location,
        entry=entry,
        age=marks[:-1] - walk.entered[stay],
        dt=np.diff(marks),
        offset=_offsets(sha, location, marks[:-1], clock, held),
        output=output,
        checked=ends != 1,
        unmatched=walk.unmatched,
    )
    if finer is None:
        return steps
    begin = marks[:-1]
    row = np.searchsorted(clock, begin, side="right") - 1  # row -1, before the clock begins, meets a NaN
    segments = Segments(
        location=location,
        time=begin,
        age=steps.age,
        dt=steps.dt,
        offset=steps.offset,
        signals={name: np.append(column, np.nan)[row] for name, column in held.items()},
        since=tuple(since_last(begin, times_of_event) for times_of_event in starts),
        late=tuple(each.fading_at(begin) for each in late),
        waiting=sum((each.waiting_at(begin) for each in late), np.zeros(begin.size)),
    )
    return replace(steps, segments=segments)


def step_coefficients(steps: Schedule) -> Coefficients:
    """(decay, pull, variance) of every step without saturation, each (n,). Raises ValueError where effects act."""
    refuse(steps.sha, "a calculation with the flows' closed forms")
    of_kind = by_kind([location.flow for location in steps.sha.locations])
    return flows.coefficients_along(of_kind, steps.location, steps.age, steps.dt)


def resync_targets(sha: SHA) -> dict[str, str]:
    """symbol -> the location that most edges with it lead to; the first in the model's order among equals."""
    order = {location.name: place for place, location in enumerate(sha.locations)}
    votes = Counter((edge.symbol, edge.target) for edge in sha.edges)
    targets: dict[str, str] = {}
    for symbol, target in sorted(votes, key=lambda pair: (-votes[pair], order[pair[1]])):
        targets.setdefault(symbol, target)
    return targets


@dataclass(frozen=True, slots=True)
class _Walk:
    """The stays: when each begins within the run, when its location was entered, and which location it is."""

    begins: Array
    entered: Array
    location: Indices
    unmatched: tuple[int, ...]


def _walk(sha: SHA, events: Sequence[Event], start: float, end: float, policy: Policy) -> _Walk:
    if policy not in ("reject", "ignore", "resync"):
        raise ValueError(f"unknown policy {policy!r}: known are reject, ignore, resync")
    moves, fallback = transitions(sha), resync_targets(sha)
    index = {location.name: place for place, location in enumerate(sha.locations)}
    clock = np.array([event.time for event in events], dtype=float)
    bad = ~np.isfinite(clock)
    bad[1:] |= np.diff(clock) < 0
    if bad.any():
        row = int(np.argmax(bad))
        raise ValueError(
            f"event {row} ({events[row].symbol!r} at {exact_moment(events[row].time)}): times must be numbers, never "
            "going back"
        )
    current, stays, unmatched = sha.initial, [(start, start, index[sha.initial])], []
    for number, event in enumerate(events):
        if event.time > end:
            break
        target = sha.initial if event.symbol == UNKNOWN else moves.get((current, event.symbol))
        if target is None:
            if policy == "reject":
                raise ValueError(
                    f"event {number} ({event.symbol!r} at {exact_moment(event.time)}): location {current!r} of SHA "
                    f"{sha.name!r} has no edge for it; the policies 'ignore' and 'resync' go on all the same"
                )
            unmatched.append(number)
            if policy == "ignore":
                continue
            target = fallback.get(event.symbol, sha.initial)
        current = target
        stay = (max(event.time, start), event.time, index[current])
        if event.time < start:  # only settles where the run begins, and with which age
            stays = [stay]
        else:
            stays.append(stay)
    begins, entered, location = zip(*stays, strict=True)
    return _Walk(np.array(begins), np.array(entered), np.array(location, dtype=np.intp), tuple(unmatched))


def _readings(sha: SHA, location: Indices, inputs: Trace) -> dict[str, Array]:
    """The signals that the visited flows name, each reading held until the next; NaN before the first."""
    wanted = {name: sha.locations[index].name for index, names in _reading_locations(sha, location) for name in names}
    for signal, name in wanted.items():
        if signal not in inputs.signals:
            raise ValueError(f"location {name!r} is driven by the signal {signal!r}, which the inputs do not have")
    readings = {}
    for signal in wanted:
        column = inputs.signals[signal]
        empty = np.isnan(column)
        if empty.any():
            # The row of the last reading so far; -1 before the first, which would otherwise mean the last row of all.
            last = np.maximum.accumulate(np.where(empty, -1, np.arange(column.size)))
            column = np.where(last < 0, np.nan, column[last])
        readings[signal] = column
    return readings


def _input_cuts(sha: SHA, walk: _Walk, clock: Array, held: dict[str, Array], outputs: Array) -> Array:
    """The times of changed readings at which a step must be cut: inside driven stays, where no boundary is already."""
    changed = {}
    for signal, column in held.items():
        # The first reading differs from not knowing: NaN is unequal to everything.
        before = np.concatenate([[np.nan], column[:-1]])[: column.size]
        changed[signal] = (before != column) & ~np.isnan(column)
    within = (clock > walk.begins[0]) & (clock < outputs[-1])
    times_of_change = [np.empty(0)]
    for index, names in _reading_locations(sha, walk.location):
        times = clock[within & np.any([changed[name] for name in names], axis=0)]
        times_of_change.append(times[walk.location[np.searchsorted(walk.begins, times, side="right") - 1] == index])
    wanted = np.unique(np.concatenate(times_of_change))
    return wanted[~(_among(wanted, outputs) | _among(wanted, walk.begins))]


def _offsets(sha: SHA, location: Indices, begins: Array, clock: Array, held: dict[str, Array]) -> Array:
    """What the readings held at `begins` add to the target of each step; a signal not read yet adds nothing."""
    total = np.zeros(begins.size)
    for index in np.unique(location).tolist():
        flow = sha.locations[index].flow
        if not flow.inputs:
            continue
        steps = np.flatnonzero(location == index)
        row = np.searchsorted(clock, begins[steps], side="right") - 1
        for driving in flow.inputs:
            reading = np.append(held[driving.signal], np.nan)[row]  # row -1, before the clock begins, meets the NaN
            total[steps] += np.where(np.isnan(reading), 0.0, driving.gain * (reading - driving.reference))
    return total


def _reading_locations(sha: SHA, location: Indices) -> list[tuple[int, tuple[str, ...]]]:
    """The visited locations in which something reads signals, and which."""
    read = {}
    for index in np.unique(location).tolist():
        place = sha.locations[index]
        names = dict.fromkeys(driving.signal for driving in place.flow.inputs)
        read[index] = tuple(names | dict.fromkeys(effect_signals(sha, place.name)))
    return [(index, names) for index, names in read.items() if names]


def _among(values: Array, ascending: Array) -> Mask:
    """Which of the values are among others: a boundary that is there already is not set twice."""
    place = np.minimum(np.searchsorted(ascending, values), ascending.size - 1)
    return np.asarray(ascending[place] == values)
