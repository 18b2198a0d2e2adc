"""Traces cut into free runs: exact steps from reading to reading, with location, inputs and stay, as flat arrays."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sim.lab.learning.data import resolution, without_spikes
from sim.lab.learning.structure import LearningError
from sim.sha import SHA, UNKNOWN, Alphabet, Array, Mask, Switch, Trace, transitions

Indices = NDArray[np.intp]

WINDOW_COUNT = 20
"""Into which what is too long is cut (`sample_runs`, `stretches`)."""


@dataclass(frozen=True)
class FreeRuns:
    """n knots of several free runs, one after the other; a knot ends the step of `dt` seconds that leads to it.

    Every array is (n,), `inputs` (n, q). A run's first knot has a reading and no step (`dt` 0). `place` is the index of
    the location in which the step was made, `age` the seconds since it was entered, at the step's start; `inputs` are
    the input signals held over the step (NaN while a signal was never read). `reading` is the temperature at the knot
    (degC) or NaN. `stay` counts the uninterrupted stays in a location, `trace` and `run` say where a knot comes from.
    """

    time: Array
    dt: Array
    age: Array
    place: Indices
    inputs: Array
    reading: Array
    stay: Indices
    run: Indices
    trace: Indices

    def __len__(self) -> int:
        return self.time.size

    @cached_property
    def first(self) -> Mask:
        """(n,) whether a knot begins a run."""
        return np.asarray(np.diff(self.run, prepend=-1) != 0)

    def select(self, keep: Mask | slice) -> "FreeRuns":
        """The knots of whole runs, or of parts of runs cut by `pieces`; runs and stays keep their numbers. A slice
        copies nothing."""
        return FreeRuns(**{field.name: getattr(self, field.name)[keep] for field in fields(self)})


def _hold_column(column: Array) -> Array:
    """Each reading held until the next; NaN before the first."""
    last = np.maximum.accumulate(np.where(np.isnan(column), -1, np.arange(column.size)))
    return np.where(last < 0, np.nan, column[last])


def _cycle_starts(started: Sequence[float], begins: Array, least: float) -> Array:
    """The start-ups at which a new run begins: those at least `least` seconds after the run before them began."""
    chosen: list[float] = []
    for moment in started:
        place = int(np.searchsorted(begins, moment, side="right")) - 1
        before = max(float(begins[place]) if place >= 0 else -np.inf, chosen[-1] if chosen else -np.inf)
        if moment - before >= least:
            chosen.append(moment)
    return np.array(chosen)


def _cut_mask(time: Array, moments: Array) -> Mask:
    """(n,) whether a moment lies in (time of the knot before, time of the knot]; never at the first knot."""
    passed = np.searchsorted(moments, time, side="right")
    return np.diff(passed, prepend=passed[:1]) > 0


def _of_trace(
    trace: Trace,
    sha: SHA,
    moves: Mapping[tuple[str, str], str],
    *,
    rising: str | None,
    signals: Sequence[str],
    modelled: Mask,
    reading: Array,
    cycle: float,
) -> FreeRuns:
    """The runs of one trace with its cleaned `reading`; raises LearningError where an event has no edge."""
    # The way through the locations: `places[i]` and `entered[i]` hold after i events.
    index = {location.name: place for place, location in enumerate(sha.locations)}
    location, since = sha.initial, float(trace.times[0])
    places, entered, broken, started = [index[location]], [since], list[float](), list[float]()
    for number, event in enumerate(trace.events):
        target = sha.initial if event.symbol == UNKNOWN else moves.get((location, event.symbol))
        if target is None:
            raise LearningError(
                f"trace {trace.name!r}: event {number} ({event.symbol!r}) has no edge from location {location!r}, so "
                f"the trace cannot be followed through SHA {sha.name!r}"
            )
        if event.symbol == UNKNOWN:
            broken.append(event.time)
        elif event.symbol == rising:
            started.append(event.time)
        # An announcement that changes nothing begins no stay: its m and its age go on.
        if target != location:
            location, since = target, event.time
        places.append(index[location])
        entered.append(since)
    happened = np.array([event.time for event in trace.events], dtype=float)
    # Events between rows become knots without a reading, so that no step has an event inside.
    extra = np.setdiff1d(happened, trace.times)
    extra = extra[(extra > trace.times[0]) & (extra < trace.times[-1])]
    time = np.concatenate([trace.times, extra])
    order = np.argsort(time, kind="stable")
    time = time[order]
    nothing = np.full(extra.size, np.nan)
    # A step is made in the location in which it begins, under the inputs that were read by then.
    begin = np.concatenate([time[:1], time[:-1]])
    done = np.searchsorted(happened, begin, side="right")
    place, since_when = np.array(places, dtype=np.intp)[done], np.array(entered)[done]
    columns = [_hold_column(np.concatenate([trace.signals[name], nothing])[order]) for name in signals]
    inputs = np.column_stack(columns) if columns else np.empty((time.size, 0))
    cut = _cut_mask(time, np.array(broken)) | ~modelled[place]
    cut[0] = True
    # Start-ups last: which of them count depends on where the runs begin without them.
    cut |= _cut_mask(time, _cycle_starts(started, time[cut], cycle))
    stay = np.cumsum(cut | (np.diff(since_when, prepend=-np.inf) != 0)) - 1
    return FreeRuns(
        time=time,
        dt=np.where(cut, 0.0, time - begin),
        age=begin - since_when,
        place=place,
        inputs=np.concatenate([inputs[:1], inputs[:-1]]),
        reading=np.concatenate([reading, nothing])[order],
        stay=stay,
        run=np.cumsum(cut) - 1,
        trace=np.zeros(time.size, dtype=np.intp),
    )


def _trim_runs(runs: FreeRuns) -> FreeRuns:
    """Each run from its first reading to its last one; runs with fewer than two readings are left out."""
    known = np.isfinite(runs.reading)
    upto = np.cumsum(known)
    count = np.bincount(runs.run, weights=known, minlength=int(runs.run[-1]) + 1 if len(runs) else 1)
    before = np.concatenate([[0.0], np.cumsum(count)])[runs.run]
    total = count[runs.run]
    # `seen` readings of the run up to a knot: 0 before its first one, and after its last one all, without one here.
    seen = upto - before
    last = (seen < total) | ((seen == total) & known)
    kept = runs.select((total >= 2) & (seen >= 1) & last)
    return replace(kept, dt=np.where(kept.first, 0.0, kept.dt))


def _concatenate_runs(parts: Sequence[FreeRuns]) -> FreeRuns:
    """Several traces' runs as one, with runs and stays numbered through."""
    shifted: list[FreeRuns] = []
    run = stay = 0
    for number, part in enumerate(parts):
        if not len(part):
            continue
        runs, stays = part.run - part.run[0] + run, part.stay - part.stay[0] + stay
        shifted.append(replace(part, run=runs, stay=stays, trace=np.full(len(part), number)))
        run, stay = int(runs[-1]) + 1, int(stays[-1]) + 1
    if not shifted:
        raise LearningError(
            "no stretch of the traces has two temperature readings in a known location, so nothing can be fitted"
        )
    if len(shifted) == 1:
        return shifted[0]  # of days at 1 Hz a copy is an eighth of what learning may take
    return FreeRuns(
        **{each.name: np.concatenate([getattr(part, each.name) for part in shifted]) for each in fields(FreeRuns)}
    )


def first_switch(alphabet: Alphabet) -> Switch | None:
    """The alphabet's first two-valued channel: the plant runs or rests, and its rising edge begins a cycle."""
    return next((channel for channel in alphabet.channels if isinstance(channel, Switch)), None)


def free_runs(
    traces: Sequence[Trace],
    sha: SHA,
    temperature: str,
    *,
    signals: Sequence[str] = (),
    modelled: Mask | None = None,
    rising: str | None = None,
    cycle: float = 3600.0,
    jumps: bool = False,
) -> FreeRuns:
    """All free runs of the traces through `sha`, each from its first temperature reading to its last.

    A run ends where the trace ends, where the state becomes unknown, and where the location is not `modelled` (L,)
    (default: all but the initial one, if other locations exist). It also ends at an event `rising`, a start-up, once it
    has lasted `cycle` seconds: that is where one cycle ends and the next one's start temperature begins. Isolated
    spikes of the temperature count as no reading; with `jumps` one that comes with an event is no spike, since events
    may make the temperature jump. `signals` are the inputs to be held over the steps; a trace that lacks one has it
    never read.

    Raises LearningError when an event has no edge or no run is left, ValueError when `sha` is not deterministic.
    """
    return _concatenate_runs(
        list(
            _runs_of_each(
                traces,
                sha,
                temperature,
                signals=signals,
                modelled=modelled,
                rising=rising,
                cycle=cycle,
                jumps=jumps,
            )
        )
    )


def thin_free_runs(
    traces: Sequence[Trace],
    sha: SHA,
    temperature: str,
    budget: int,
    *,
    signals: Sequence[str] = (),
    modelled: Mask | None = None,
) -> FreeRuns:
    """`thin_runs` of all `free_runs`, which are never together: of months of fast rows they take hundreds of MB.

    Raises what `free_runs` raises.
    """
    sizes = [
        _thinning_size(part)
        for part in _runs_of_each(traces, sha, temperature, signals=signals, modelled=modelled)
        if len(part)
    ]
    window = _thinning_window(sizes, budget)
    parts = _runs_of_each(traces, sha, temperature, signals=signals, modelled=modelled)
    return _concatenate_runs([_thin_to_window(part, window) if len(part) else part for part in parts])


def _runs_of_each(
    traces: Sequence[Trace],
    sha: SHA,
    temperature: str,
    *,
    signals: Sequence[str],
    modelled: Mask | None,
    rising: str | None = None,
    cycle: float = 3600.0,
    jumps: bool = False,
) -> Iterator[FreeRuns]:
    """The free runs of each trace that has a reading, numbered for itself."""
    if modelled is None:
        modelled = np.array([location.name != sha.initial or len(sha.locations) == 1 for location in sha.locations])
    moves = transitions(sha)
    for trace in traces:
        reading = trace.signal_course(temperature) if temperature in trace.signals else np.empty(0)
        if not np.isfinite(reading).any():
            continue
        cleaned = without_spikes(reading, resolution(reading))
        if jumps:
            # Rows with an event since the row before them, up to their own time.
            times = np.array([event.time for event in trace.events], dtype=float)
            eventful = np.diff(np.searchsorted(times, trace.times, side="right"), prepend=0) > 0
            cleaned = np.where(eventful, reading, cleaned)
        missing = {name: np.full(trace.times.shape, np.nan) for name in signals if name not in trace.signals}
        runs = _of_trace(
            replace(trace, signals={**missing, **trace.signals}),
            sha,
            moves,
            rising=rising,
            signals=signals,
            modelled=modelled,
            reading=cleaned,
            cycle=cycle,
        )
        yield _trim_runs(runs)


def thin_runs(runs: FreeRuns, budget: int) -> FreeRuns:
    """The same runs with about `budget` knots at most: exact steps are merged, inputs averaged over the merged step.

    The last reading of each window of equal length stays, and so does every change of location; so time, stays and
    locations are exact, and what is lost is the scatter of the inputs inside a window (of second order in rate x
    window). Knots without a reading inside a stay are merged as well.
    """
    return _thin_to_window(runs, _thinning_window([_thinning_size(runs)], budget))


def _must_stay(runs: FreeRuns) -> Mask:
    """(n,) the knots that begin a run or end a stay."""
    return np.asarray(runs.first | np.append((np.diff(runs.stay) != 0) | runs.first[1:], True))


def _thinning_size(runs: FreeRuns) -> tuple[int, int, float]:
    """(knots that must stay, readings, seconds) of runs."""
    readings = int(np.count_nonzero(np.isfinite(runs.reading)))
    return int(_must_stay(runs).sum()), readings, float(runs.dt.sum())


def _thinning_window(sizes: Sequence[tuple[int, int, float]], budget: int) -> float:
    """s of the windows to which runs of these sizes are thinned, so that about `budget` knots are left; 0: none."""
    must, readings, seconds = (sum(column) for column in zip(*sizes, strict=True)) if sizes else (0, 0, 0.0)
    room = max(budget - int(must), budget // 4)
    return seconds / room if readings > room else 0.0


def _thin_to_window(runs: FreeRuns, window: float) -> FreeRuns:
    """The runs with one reading each `window` (s; 0: all of them), and all that must stay."""
    must, known = _must_stay(runs), np.isfinite(runs.reading)
    keep = must | known
    if window > 0:
        start = runs.time[runs.first][np.cumsum(runs.first) - 1]
        cell = np.floor((runs.time - start) / window)
        readings = np.flatnonzero(known)
        moved = (np.diff(cell[readings]) != 0) | (np.diff(runs.run[readings]) != 0)
        keep = must.copy()
        keep[readings[np.append(moved, True)]] = True
    # Steps are merged up to each kept knot, the first of them giving the age. Inputs are averaged over the time in
    # which they were known; where that is none, the last step's value stands.
    lasts = np.flatnonzero(keep)
    begins = np.concatenate([[0], lasts[:-1] + 1])
    weight = np.where(np.isnan(runs.inputs), 0.0, runs.dt[:, None])
    share = np.add.reduceat(weight, begins, axis=0)
    mass = np.add.reduceat(weight * np.nan_to_num(runs.inputs), begins, axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        inputs = np.where(share > 0, mass / share, runs.inputs[lasts])
    return replace(runs.select(keep), dt=np.add.reduceat(runs.dt, begins), inputs=inputs, age=runs.age[begins])


def sample_runs(runs: FreeRuns, budget: int) -> FreeRuns:
    """`thin_runs`, and where changes of location alone are too many, windows spread evenly over the whole time.

    There are twenty windows, each a run of its own; what lies between them is left out.
    """
    few = thin_runs(runs, budget)
    return few if len(few) <= 1.5 * budget else _windows(few, budget)


def stretches(runs: FreeRuns, budget: int, step: float) -> FreeRuns:
    """About `budget` knots whose readings are `step` s apart, or as near as they were read: for what is told from one
    reading to the next. Where the whole time is too long for that, twenty windows spread evenly over it, each a run of
    its own.
    """
    changes = int(np.count_nonzero(np.diff(runs.stay)))
    fine = thin_runs(runs, max(budget, changes + int(runs.dt.sum() / step)))
    return fine if len(fine) <= 1.5 * budget else _windows(fine, budget)


def _windows(runs: FreeRuns, budget: int) -> FreeRuns:
    """WINDOW_COUNT parts of about `budget` knots in all, spread evenly over the knots, each a run of its own."""
    count = WINDOW_COUNT * max(len(runs) // budget, 1)
    window = np.arange(len(runs)) * count // len(runs)
    kept = np.unique(np.linspace(0, int(window[-1]), WINDOW_COUNT).astype(np.intp))
    inside = np.isin(window, kept)
    part = runs.select(inside)
    # A run may span several windows, and a window several runs: each pair of the two is a run of its own.
    mark = part.run * (int(window[-1]) + 1) + window[inside]
    return _trim_runs(replace(part, run=np.cumsum(np.diff(mark, prepend=mark[:1]) != 0)))


def pieces(runs: FreeRuns, least: int) -> FreeRuns:
    """The same knots with the longest runs halved until there are `least` of them, as far as they are long enough.

    A piece begins at a reading and has at least ten of them; its first knot has no step.
    """
    known = np.isfinite(runs.reading)
    bounds = [*np.flatnonzero(runs.first).tolist(), len(runs)]
    while len(bounds) - 1 < least:
        sizes = np.add.reduceat(known, bounds[:-1])
        longest = int(np.argmax(sizes))
        if sizes[longest] < 20:
            break
        low, high = bounds[longest : longest + 2]
        half = int(np.searchsorted(np.cumsum(known[low:high]), sizes[longest] // 2 + 1))
        bounds.insert(longest + 1, low + half)
    first = np.zeros(len(runs), dtype=bool)
    first[bounds[:-1]] = True
    return replace(runs, run=np.cumsum(first) - 1, dt=np.where(first, 0.0, runs.dt))
