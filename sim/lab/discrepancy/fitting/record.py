"""Measured traces laid out for a diagnosis: every step of the given model's locations, and windows of readings.

The free runs of the model are formed on the fine knots (one a row). Likelihoods are formed on windows: the readings of
a window count as one, at their mean time, so that a day of 1 s samples costs no more than one of 60 s samples.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from math import inf

import numpy as np
import scipy

from sim.lab.discrepancy.fitting.noise import Grid
from sim.lab.learning import FreeRuns, Indices, LearningError, first_switch, thin_free_runs
from sim.sha import UNKNOWN, Alphabet, Array, Mask, Model, Switch, Trace, encode_trace

KNOTS, WINDOWS = 64_000, 4_000
"""Fine knots and windows at most: what lies closer together is merged. Sixteen knots a window: what a window's mean
loses by them is of second order in the rate times a sixteenth of its length."""
MIN_WINDOW_S = 20.0
"""Seconds of a window at least (or one row, where rows lie further apart)."""
LIVELY, FINER = 900.0, 4.0
"""Seconds after a start or a stop in which windows are so many times shorter."""
GAP_RATIO = 2.0
"""Times the usual interval between rows (all but one in a hundred) beyond which a recorder has a gap."""
LATE_RATIO = 1.5
"""Times the usual interval between rows from which a start or a stop in it was noticed late."""
MANY, FORGOTTEN = 8, 6.0
"""Cycles from which they are the independent pieces of evidence. Where they are fewer, a run or a rest that goes on for
twice so many of its time constants is several pieces: e^-6 of how a piece began is left at its end."""
MIN_PIECE_ROWS = 24
"""Readings of such a piece at least: of fewer neither its mean nor how it wanders can be told, and where rows are as
rare as the time constant is long there would be a piece for every second row."""
TRACE_GAP_S = 3600.0
"""Seconds that are put between traces of which nobody knows when they were recorded."""
BESIDE, STANDS_OUT = 5, 4.5
"""Rows before and after a row's end with which a change of a signal there is compared, and the times their median that
a step is: three standard deviations, since the median size of what is normal is 0.67 of one. Where a signal is restless
or on its way, half of the rows beside change as much, and nothing steps."""
INRUSH_S = 30.0
"""Seconds after a start (or two rows) in which the current may be what turns the drum up: a motor on the line is at
speed within a quarter of a minute."""
NO_START_S = 1e9
"""Seconds since a start-up that was not seen."""
CLOCK_TOLERANCE_S = 1e-3
"""Seconds by which a step may differ from what its times say: what is lost where many steps are added up."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """n knots of the traces under `model`'s locations, and m windows of readings.

    `runs` holds the knots; its `inputs` are the `signals` (n, q), held over each step. `running` (n,) is 1 in steps
    made while the machine runs (1 everywhere without a switch), `since` (n,) the seconds since its last start-up at the
    step's start, `whole` (n,) numbers the cycles, what lies before a trace's first start-up counting to its first.
    `cycle` (n,) are the independent pieces of evidence: the cycles, or, of a machine that runs on, pieces of its long
    runs (`in_pieces`). `turned` (n,) says where a start, a stop or a step
    of a load lies somewhere in the row that ends at the knot (`_turn_rows`), `rushed` (n,) where a start draws what
    turns the drum up (`_inrush_rows`).
    `window` (s) is the length of a window at rest, `rows` (r,) are the knots with a reading, `begins` (m,) the place in
    `rows` where each window begins.
    `uncut` holds the knots before anything was cut, `kept` (n,) the place of each knot there: what follows from signals
    alone runs on through cuts (`history`). `ran` (N,) are the seconds that the machine had run by then.
    What holds of every record, whatever its recorder did, is asked of it when it is made (`record_faults`).
    """

    model: Model
    signals: tuple[str, ...]
    runs: FreeRuns
    running: Array
    since: Array
    whole: Indices
    cycle: Indices
    turned: Mask
    rushed: Mask
    window: float
    rows: Indices
    begins: Indices
    uncut: FreeRuns
    kept: Indices
    ran: Array

    def __post_init__(self) -> None:
        if wrong := record_faults(self):
            raise RecordFault(f"a record in which this does not hold: {'; '.join(wrong)}")

    def window_means(self, columns: Array) -> Array:
        """The mean over each window's readings of columns (n,) or (n, c) given at the knots: (m,) or (m, c)."""
        picked = columns[self.rows]
        counts = np.diff(np.append(self.begins, self.rows.size))
        sums = np.add.reduceat(picked, self.begins, axis=0)
        return np.asarray(sums / (counts if columns.ndim == 1 else counts[:, None]))

    @property
    def times(self) -> Array:
        """(m,) the mean time of each window's readings, absolute s."""
        return self.window_means(self.runs.time)

    @property
    def reading(self) -> Array:
        """(m,) the mean reading of each window, degC."""
        return self.window_means(self.runs.reading)

    @property
    def window_cycle(self) -> Indices:
        """(m,) the piece of evidence that each window is of."""
        return self.cycle[self.rows[self.begins]]

    @property
    def window_whole(self) -> Indices:
        """(m,) the cycle of each window."""
        return self.whole[self.rows[self.begins]]

    @property
    def window_first(self) -> Mask:
        """(m,) whether a window begins a run."""
        return np.asarray(np.diff(self.runs.run[self.rows[self.begins]], prepend=-1) != 0)

    def signal(self, name: str) -> Array:
        """(n,) a signal held over each step; NaN while it was never read."""
        return self.runs.inputs[:, self.signals.index(name)]

    def history(self, name: str) -> Array:
        """(N,) a signal held over each step of `uncut`; NaN while it was never read."""
        return self.uncut.inputs[:, self.signals.index(name)]

    def grid(self, k: Array, running: Array, heats: Array, *, jumps: Array, shared: Array, inrush: Array) -> Grid:
        """The windows as the noise sees them; `k` (n,) 1/s and `running` (n,) are each step's rate and whether rough
        heat acts, `jumps` (n,) degC^2 the variance of a jump at each knot, `heats` (m, cycles) `shared` and `inrush`
        (m,) as in `Grid`."""
        passed = np.cumsum(np.column_stack([k, running]) * self.runs.dt[:, None], axis=0)
        times, mean = self.times, self.window_means(passed)
        # Rate and running share between two windows are those between their mean times: the integral over all knots,
        # averaged in each window as the readings are, then differenced.
        first = self.window_first
        dt = np.where(first, 1.0, np.diff(times, prepend=times[0] - 1.0))
        rate, share = (np.diff(mean, axis=0, prepend=mean[:1]) / dt[:, None]).T
        # A jump at a knot is in the window of its reading, or of the next one after a knot that has none.
        passed = np.cumsum(jumps)[self.rows[np.append(self.begins[1:], self.rows.size) - 1]]
        return Grid(
            dt=dt,
            k=np.where(first, 0.0, rate),
            running=share,
            first=first,
            cycle=self.window_cycle,
            heats=heats,
            late=np.where(first, 0.0, np.diff(passed, prepend=0.0)),
            shared=shared,
            inrush=inrush,
        )

    def select(self, keep: Mask) -> "Record":
        """The knots of whole cycles, of which the first of each piece begins a run of its own.

        Raises LearningError where no reading is among them.
        """
        followed = np.append(keep[1:], True)
        reading = _readings_before_turns(self.runs, self.running, ~followed)
        cut = self.runs.first | ~np.append(True, keep[:-1])
        return _build_record(self, replace(self.runs, reading=reading, run=np.cumsum(cut) - 1), keep)

    def by_cycles(self) -> "Record":
        """The record with a run of its own for each cycle."""
        begun = np.diff(self.whole, prepend=-1) != 0
        reading = _readings_before_turns(self.runs, self.running, np.append(begun[1:], False))
        run = np.cumsum(self.runs.first | begun) - 1
        return _build_record(self, replace(self.runs, run=run, reading=reading), np.ones(len(self.runs), dtype=bool))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Knots:
    """What a record says of its knots beside their runs, before it is one (`Record`)."""

    model: Model
    signals: tuple[str, ...]
    running: Array
    since: Array
    whole: Indices
    cycle: Indices
    turned: Mask
    rushed: Mask
    window: float
    uncut: FreeRuns
    kept: Indices
    ran: Array


class RecordFault(AssertionError):
    """A record that breaks what holds for every one: a fault of the program, whatever the traces are."""


def _build_record(knots: Record | _Knots, runs: FreeRuns, keep: Mask) -> Record:
    """The record of the knots to `keep`, cut into the runs that `runs` numbers: every record is made here.

    A run in which nothing was read says nothing and is left out. Raises LearningError where that is every run.
    """
    read = np.zeros(int(runs.run[-1]) + 1, dtype=bool)
    read[runs.run[keep & np.isfinite(runs.reading)]] = True
    keep = keep & read[runs.run]
    if not keep.any():
        raise LearningError(
            f"none of these cycles has a reading of {knots.model.temperature!r}, the model's temperature"
        )
    kept = _together(keep)
    runs = runs.select(kept)
    runs = replace(runs, run=np.cumsum(runs.first) - 1)
    runs = replace(runs, dt=np.where(runs.first, 0.0, runs.dt))
    running, cycle = knots.running[kept], knots.cycle[kept]
    rows, begins = _windows(runs, cycle, running, knots.window)
    return Record(
        model=knots.model,
        signals=knots.signals,
        runs=runs,
        running=running,
        since=knots.since[kept],
        whole=knots.whole[kept],
        cycle=cycle,
        turned=knots.turned[kept],
        rushed=knots.rushed[kept],
        window=knots.window,
        rows=rows,
        begins=begins,
        uncut=knots.uncut,
        kept=knots.kept[kept],
        ran=knots.ran,
    )


def _together(keep: Mask) -> Mask | slice:
    """The knots to keep, as a slice where they lie together: the first days, or the last ones, then need no copy."""
    places = np.flatnonzero(keep)
    begin, end = int(places[0]), int(places[-1]) + 1
    return slice(begin, end) if end - begin == places.size else keep


def record_faults(record: Record) -> tuple[str, ...]:
    """What does not hold of a record though it holds of every one, in words; () where all does."""
    runs, rows, begins = record.runs, record.rows, record.begins
    n, first, run = len(runs), runs.first, runs.run
    columns = [getattr(runs, each.name) for each in fields(runs) if each.name != "inputs"]
    columns += [record.running, record.since, record.whole, record.cycle, record.turned, record.rushed]
    if n == 0 or any(column.shape != (n,) for column in columns) or runs.inputs.shape != (n, len(record.signals)):
        return ("every column has one value for each knot",)
    passed = np.diff(runs.time)[~first[1:]]
    window = np.searchsorted(begins, np.arange(rows.size), side="right") - 1
    inside = np.diff(window) == 0
    holds = {
        "runs are numbered 0, 1, 2 and so on": run[0] == 0 and bool(np.isin(np.diff(run), (0, 1)).all()),
        "a run's first knot ends no step": not runs.dt[first].any(),
        "times rise within a run": bool((passed > 0).all()),
        "a row is as late as it is": bool(np.allclose(runs.dt[~first], passed, rtol=1e-6, atol=CLOCK_TOLERANCE_S)),
        "cycles follow one another": bool((np.diff(record.cycle) >= 0).all()),
        "the rows are the knots with a reading": np.array_equal(rows, np.flatnonzero(np.isfinite(runs.reading))),
        "every window has a reading": begins[:1].tolist() == [0]
        and bool((np.diff(begins, append=rows.size) > 0).all()),
        "every run has a window": np.unique(run[rows]).size == run[-1] + 1,
        "a window lies in one run and one cycle": not (np.diff(run[rows]) + np.diff(record.cycle[rows]))[inside].any(),
    }
    return tuple(words for words, true in holds.items() if not true)


def find_overlap(traces: Sequence[Trace]) -> str:
    """Which trace begins before another one ends, in words; "" where they lie one after the other."""
    ordered = sorted((trace for trace in traces if trace.times.size), key=lambda trace: float(trace.times[0]))
    for before, after in pairwise(ordered):
        if after.times[0] < before.times[-1]:
            return f"{after.name} begins before {before.name} ends"
    return ""


def in_order(traces: Sequence[Trace]) -> list[Trace]:
    """The traces by their times; those that overlap (each begins at 0, say) one after the other as they were given."""
    having = [trace for trace in traces if trace.times.size]
    if not find_overlap(having):
        return sorted(having, key=lambda trace: float(trace.times[0]))
    laid, end = list[Trace](), 0.0
    for trace in having:
        shift = end - float(trace.times[0])
        events = tuple(replace(event, time=event.time + shift) for event in trace.events)
        laid.append(replace(trace, times=trace.times + shift, events=events))
        end = float(laid[-1].times[-1]) + TRACE_GAP_S
    return laid


def patiently(trace: Trace, alphabet: Alphabet) -> Trace:
    """The trace encoded with a gap that suits its recorder: rows that usually come late leave no gap between them."""
    # The 99th percentile, not the largest: single pauses of a recorder are the gaps that the encoder must see.
    usual = GAP_RATIO * float(np.quantile(np.diff(trace.times), 0.99)) if trace.times.size > 2 else 0.0
    return encode_trace(trace, replace(alphabet, gap=max(usual, alphabet.gap)))


def build_record(
    model: Model, traces: Sequence[Trace], signals: Sequence[str], *, knots: int = KNOTS, windows: int = WINDOWS
) -> Record:
    """The encoded `traces` under the locations of `model`; a trace without a reading of the temperature is left out.

    Raises LearningError (a ValueError) when an event has no edge or nothing can be followed, and for a transient about
    a temperature that is drawn on entry.
    """
    for location in model.sha.locations:
        if location.flow.kind == "transient" and location.entry == "resample":
            raise LearningError(
                f"location {location.name!r} has a transient flow about a temperature that is drawn on entry; heat is "
                "looked for in a temperature that goes on over events, so give a model that was learned with "
                "--default-flow exponential"
            )
    having = [_each_time_once(trace) for trace in traces if _is_followable(trace, model)]
    if not having:
        raise LearningError(f"no trace has a reading of {model.temperature!r}, the model's temperature")
    runs = thin_free_runs(
        having, model.sha, model.temperature, knots, signals=tuple(signals), modelled=known_locations(model)
    )
    running, since, whole = _machine(runs, having, first_switch(model.alphabet))
    rates = np.array([location.flow.params.get("k", 0.0) for location in model.sha.locations])
    cycle = in_pieces(whole, runs, running, rates[runs.place])
    uncut, runs = runs, _cut_late(runs, running)
    laid_out = _Knots(
        model=model,
        signals=tuple(signals),
        running=running,
        since=since,
        whole=whole,
        cycle=cycle,
        turned=_turn_rows(model, runs, running, signals),
        rushed=_inrush_rows(model, runs, running, since, signals),
        window=max(float(_clock(runs, running)[-1]) / windows, MIN_WINDOW_S * FINER),
        uncut=uncut,
        kept=np.arange(len(runs)),
        ran=np.cumsum(running * uncut.dt),
    )
    return _build_record(laid_out, runs, np.ones(len(runs), dtype=bool))


def first_new_cycle(record: Record, traces: Sequence[Trace]) -> float:
    """The record's first piece of evidence (`cycle`) after the `traces` that it begins with; inf: there is none."""
    count = sum(_is_followable(trace, record.model) for trace in traces)
    later = record.cycle[record.runs.trace >= count]
    return float(later[0]) if later.size else inf


def _is_followable(trace: Trace, model: Model) -> bool:
    return bool(np.isfinite(trace.signals.get(model.temperature, np.empty(0))).any()) and trace.times.size > 1


def _each_time_once(trace: Trace) -> Trace:
    """The trace with the last row of each time: between two readings of one time nothing can have passed."""
    last = np.append(np.diff(trace.times) > 0, True)
    if last.all():
        return trace
    signals = {name: column[last] for name, column in trace.signals.items()}
    bad = {name: column[last] for name, column in trace.bad.items()}
    held = {name: column[last] for name, column in trace.held.items()}
    return replace(trace, times=trace.times[last], signals=signals, bad=bad, held=held)


def _turn_rows(model: Model, runs: FreeRuns, running: Array, signals: Sequence[str]) -> Mask:
    """(n,) where the machine starts or stops, or what the flows go by steps, between the row before and a knot's own.

    A step stands out of what its signal does from row to row beside it (`STANDS_OUT`).
    """
    turned = np.append(np.diff(running) != 0, False)
    for number in _driving_signals(model, signals):
        change = np.abs(np.append(np.diff(np.nan_to_num(runs.inputs[:, number])), 0.0))
        beside = scipy.ndimage.median_filter(change, size=2 * BESIDE + 1, mode="nearest")
        turned |= change > STANDS_OUT * beside
    return turned


def _driving_signals(model: Model, signals: Sequence[str]) -> list[int]:
    """The places in `signals` of those that the flows go by, or that decide between locations."""
    driving = {each.signal for location in model.sha.locations for each in location.flow.inputs}
    driving |= {channel.signal for channel in model.alphabet.channels}
    return [number for number, name in enumerate(signals) if name in driving]


def _inrush_rows(model: Model, runs: FreeRuns, running: Array, since: Array, signals: Sequence[str]) -> Mask:
    """(n,) where a start draws more than the machine ever does afterwards, until it stops: its first `INRUSH_S`.

    A motor on the line draws several times its current until the drum turns. A load that comes and goes is none.
    """
    seen = runs.dt[runs.dt > 0]
    row = float(np.median(seen)) if seen.size else 0.0
    starting = (running > 0.5) & (since < max(INRUSH_S, 2.0 * row))
    after = (running > 0.5) & ~starting
    stretch = np.cumsum(runs.first | (np.diff(starting, prepend=False) & starting))
    rushed = np.zeros(len(runs), dtype=bool)
    for number in _driving_signals(model, signals):
        drawn = np.nan_to_num(runs.inputs[:, number])
        most = np.full(int(stretch[-1]) + 1, np.inf)
        most[stretch[after]] = 0.0
        np.maximum.at(most, stretch[after], drawn[after])
        rushed |= starting & (drawn > most[stretch])
    return rushed


def _cut_late(runs: FreeRuns, running: Array) -> FreeRuns:
    """The runs begun anew where a start or a stop was noticed late: it lies somewhere in a step that took long.

    Heat that the model would then be given late is no heat that it lacks.
    """
    seen = runs.dt[runs.dt > 0]
    late = runs.dt > LATE_RATIO * (float(np.median(seen)) if seen.size else 0.0)
    turns = np.append(np.diff(running) != 0, False) & (np.diff(runs.run, append=-1) == 0)
    cut = late & turns & np.isfinite(runs.reading)
    run = np.cumsum(runs.first | cut) - 1
    return replace(runs, run=run, dt=np.where(runs.first | cut, 0.0, runs.dt))


def _readings_before_turns(runs: FreeRuns, running: Array, last: Mask) -> Array:
    """(n,) the readings, without those of the knots at which a piece ends (`last`) and the machine starts or stops.

    Where a switch is known to a row only, such a reading tells of what came after it and is not in the piece.
    """
    turned = np.append(np.diff(running) != 0, False)
    return np.where(last & turned, np.nan, runs.reading)


def known_locations(model: Model) -> Mask:
    """(L,) which locations say how the temperature moves.

    Not an initial one in which nothing is known yet; nor one that no data have shown (`Model.borrowed`): what another
    location lends it is no claim that a record could contradict.
    """
    sha = model.sha
    return np.array(
        [
            location.name not in model.borrowed
            and (location.name != sha.initial or location.flow.kind != "constant" or len(sha.locations) == 1)
            for location in sha.locations
        ]
    )


def _machine(runs: FreeRuns, traces: Sequence[Trace], switch: Switch | None) -> tuple[Array, Array, Indices]:
    """(running, since, cycle) of every knot, from the switch's events."""
    running, since = np.ones(len(runs)), np.full(len(runs), NO_START_S)
    cycle, count = np.zeros(len(runs), dtype=np.intp), 0
    for number, trace in enumerate(traces):
        rows = np.flatnonzero(runs.trace == number)
        if not rows.size:
            continue
        # Everything is asked at the step's start: an event at a row's own time acts from that row on, not before it.
        begin = runs.time[rows] - runs.dt[rows]
        starts = np.empty(0)
        if switch is not None:
            # After UNKNOWN the machine counts as stopped until its next start is seen.
            switching = [event for event in trace.events if event.symbol in (switch.rising, switch.falling, UNKNOWN)]
            times = np.array([event.time for event in switching])
            state = np.array([0.0, *(float(event.symbol == switch.rising) for event in switching)])
            done = np.searchsorted(times, begin, side="right")
            running[rows] = state[done]
            rises = state[1:] > state[:-1]
            starts = times[rises]
        place = np.searchsorted(starts, begin, side="right")
        if starts.size:
            since[rows] = np.where(place > 0, begin - starts[np.maximum(place, 1) - 1], NO_START_S)
        cycle[rows] = count + np.maximum(place - 1, 0)
        count += max(int(starts.size), 1)
    return running, since, cycle


def in_pieces(cycle: Indices, runs: FreeRuns, running: Array, k: Array) -> Indices:
    """(n,) the cycles; where they are few, their long runs and rests cut into equal pieces of FORGOTTEN time constants.

    `k` (n,) 1/s is the given model's rate of each step; a flow that does not relax forgets nothing and is not cut. Of
    a stretch there are so few pieces that they have MIN_PIECE_ROWS readings each, in the mean.
    """
    if np.unique(cycle).size >= MANY:
        return cycle
    passed = k * runs.dt
    changed = runs.first | (np.diff(running, prepend=-1.0) != 0) | (np.diff(cycle, prepend=-1) != 0)
    stretch = np.cumsum(changed) - 1
    whole = np.bincount(stretch, passed)
    before = np.cumsum(passed) - passed
    within = before - before[changed][stretch]
    read = np.bincount(stretch, np.isfinite(runs.reading))
    most = np.minimum(np.floor(whole / FORGOTTEN), np.floor(read / MIN_PIECE_ROWS))
    count = np.where(whole >= 2.0 * FORGOTTEN, np.maximum(most, 1.0), 1.0)
    piece = np.floor(within / np.maximum(whole, 1e-12)[stretch] * count[stretch])
    inside = (np.diff(piece, prepend=0.0) != 0) & ~changed
    return np.asarray(np.cumsum(inside | (np.diff(cycle, prepend=cycle[:1]) != 0)), dtype=np.intp)


def _clock(runs: FreeRuns, running: Array) -> Array:
    """(n,) seconds that pass FINER times faster after a start or a stop."""
    changed = (np.diff(running, prepend=running[:1]) != 0) | runs.first
    moment = (runs.time - runs.dt)[changed][np.cumsum(changed) - 1]
    return np.cumsum(runs.dt * np.where(runs.time - moment <= LIVELY, FINER, 1.0))


def _windows(runs: FreeRuns, cycle: Indices, running: Array, length: float) -> tuple[Indices, Indices]:
    """(rows, begins) of windows of `length` seconds of that clock, which end where a run or a cycle ends."""
    rows = np.flatnonzero(np.isfinite(runs.reading))
    new = np.diff(np.floor(_clock(runs, running) / length)[rows], prepend=-1) != 0
    new |= np.diff(runs.run[rows], prepend=-1) != 0
    new |= np.diff(cycle[rows], prepend=-1) != 0
    return rows, np.flatnonzero(new)
