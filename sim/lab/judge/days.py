"""Whether the days of a recording contradict one another: a unit, a machine, a switch or a sensor that changed in it.

Each day is its own witness. The temperature of one is fitted by what warms the machine, as a first-order lag of it
(level, gain, and what is left of the night before), all days with the same lag; what leaps from one day to the next is
held against what differs before and after, whatever signal explains it. A day is UTC's, of one trace.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf, nan

import numpy as np

from sim.lab.learning import Indices, first_switch, level_signals
from sim.moments import exact_moment, has_date
from sim.sha import DEFAULT_UNIT, Array, Mask, Model, Trace, display_unit

DAY_S = 86_400.0
BIN_S = 60.0
"""Readings are averaged over so long (s), or over a row where rows are rarer."""
MIN_DAY_S = 3 * 3600.0
"""Readings that a day needs to be a witness."""
MAX_ROW_S = 3600.0
"""Rows rarer than that do not tell how a machine warms in a day."""
LAGS_S = (0.0, 300.0, 900.0, 1800.0, 3600.0, 7200.0)
"""Lags (s) of a temperature behind what warms it that are tried."""
MIN_EXPLAINED = 0.6
"""The share of a day's variance that the lag explains where its gain is known."""
MIN_DRIVEN_SHARE = 0.3
"""Of the greatest range of what warms the machine, that a day must have for its gain to be known."""
GAIN_RATIO = 1.5
"""Between the nearest gains before and after a leap, from which they are no two days of one machine."""
LEVEL_STEP = 25.0
"""degC between the nearest levels before and after a leap, the same: no weather makes it overnight."""
WITHIN_RATIO = 3.0
"""The days after a leap lie so many times as far from those before as either lie from one another."""
GAIN_MISFIT, LEVEL_MISFIT, LEVEL_MISFIT_DEGC = 0.15, 0.12, 5.0
"""By which gain, and level, may differ from what another unit makes of the other days'."""
REVERSED_LOAD_RATIO = 20.0
"""The load while "off" over that while "on" from which a switch is upside down: what runs draws something. A level that
is merely lower while a machine runs, as a compressor's suction pressure is, says nothing."""
STILL_RUNS, MAX_USUALLY_STILL = 2, 0.1
"""Whole runs through which one reading stands still, and other rests, at least, of which so small a share may stand."""
MOVING_STEPS, SMALL_STEP = 5.0, 0.1
"""A reading moves by so many of its small steps, which are this quantile of the differences between its readings."""
MIN_SHARE = 0.1
"""Of the recording, or of its days, that is no small part of what was learned."""
MAX_GAP_DAYS = 2
"""Days that may be missing between two that are held against one another: a weekend."""
MAX_LISTED = 3
"""Days that a sentence names."""
OTHER_UNITS: Mapping[str, tuple[float, float]] = {
    "degrees Fahrenheit": (1.8, 32.0),
    "kelvin": (1.0, 273.15),
    "tenths of a degree": (10.0, 0.0),
}
"""Unit -> (factor, offset) by which it writes degC."""

Said = tuple[bool | None, str]


@dataclass(frozen=True, slots=True)
class Day:
    """One day of a trace by its number since the clock's zero: `rows` of the trace are its own."""

    trace: Trace
    number: int
    rows: slice

    @property
    def begin(self) -> float:
        """When it begins (absolute s)."""
        return self.number * DAY_S

    def words(self) -> str:
        """It as people call it."""
        if has_date(self.begin):
            return exact_moment(self.begin).split()[0]
        return f"day {self.number + 1} of {self.trace.name}"


@dataclass(frozen=True, slots=True)
class DayFit:
    """Of D days the `gain` (degC per unit of the signal `name` that warms it) and the `level` (degC) where that signal
    is `least`, the lowest that it usually is; (D,), NaN where they are not known."""

    name: str
    least: float
    level: Array
    gain: Array


def judge_days(model: Model, traces: Sequence[Trace]) -> Said:
    """Whether the days of the training contradict one another: False or None with what does, True where none is.

    The worst that is said of any machine counts. Days are held against one another within a stretch of them, in which
    none is missing for long: of a machine in another season nobody knows what was done to it.
    """
    machines: dict[str, list[Trace]] = {}
    for trace in traces:
        machines.setdefault(trace.machine, []).append(trace)
    found: list[Said] = []
    looked = 0
    reason = f"no machine has two days in a row with {MIN_DAY_S / 3600:g} h of readings"
    for machine, own in machines.items():
        said = [_find_still(model, own)]
        for days in _stretches(model, own) if model.unit == DEFAULT_UNIT else ():
            grid = _grid(model, days)
            fits = [fit for name in grid.drivers if (fit := _fit(grid, name)) is not None]
            looked += max((int(np.isfinite(fit.gain).sum()) for fit in fits), default=0)
            reason = f"no switch or level signal explains {MIN_EXPLAINED:.0%} of how {model.temperature} moves in a day"
            said += [_turned_switch(model, days, grid, fits), _parted(model, days, fits)]
        named = f"{machine or 'the machine without a name'}: " if len(machines) > 1 else ""
        found += [(each[0], named + each[1]) for each in said if each is not None]
    if found:
        return min(found, key=lambda each: each[0] is None)
    if model.unit != DEFAULT_UNIT:
        return True, f"the days' levels and gains were not looked at: they are in {display_unit(model.unit)}"
    if not looked:
        return True, f"not looked at: {reason}"
    return True, f"none of {looked} days contradicts the others"


def _stretches(model: Model, traces: Sequence[Trace]) -> Iterator[list[Day]]:
    """The days of a machine in their order, two at least at a time, between which at most MAX_GAP_DAYS are missing."""
    days = sorted((day for trace in traces for day in _days(model, trace)), key=lambda day: day.number)
    cuts = [at for at in range(1, len(days)) if days[at].number - days[at - 1].number > MAX_GAP_DAYS + 1]
    for first, end in zip([0, *cuts], [*cuts, len(days)], strict=True):
        if end - first > 1:
            yield days[first:end]


def _days(model: Model, trace: Trace) -> list[Day]:
    """The days of which enough readings are there."""
    known = np.isfinite(trace.signals[model.temperature])
    if known.sum() < 2:
        return []
    row_s = float(np.median(np.diff(trace.times[known])))
    if row_s > MAX_ROW_S:
        return []
    numbers = np.floor(trace.times / DAY_S).astype(int)
    found = []
    for number in np.unique(numbers).tolist():
        first, last = np.searchsorted(numbers, (number, number + 1)).tolist()
        bins = np.unique(trace.times[first:last][known[first:last]] // max(BIN_S, row_s)).size
        if bins * max(BIN_S, row_s) >= MIN_DAY_S:
            found.append(Day(trace, number, slice(first, last)))
    return found


@dataclass(frozen=True, slots=True)
class Grid:
    """D days on one grid of B bins of `step` s: `readings` (D, B), NaN where there is none, `drivers` name -> (D, B),
    each bin's newest value."""

    step: float
    readings: Array
    drivers: Mapping[str, Array]


def _grid(model: Model, days: Sequence[Day]) -> Grid:
    rows = [np.diff(day.trace.times[day.rows]) for day in days]
    step = max(BIN_S, float(np.median(np.concatenate(rows))))
    bins = int(np.ceil(DAY_S / step))
    middles = np.linspace(0.5 * step, (bins - 0.5) * step, bins)
    switch = first_switch(model.alphabet)
    names = [*([switch.signal] if switch else []), *level_signals(model.alphabet)]
    readings = np.full((len(days), bins), np.nan)
    drivers = {name: np.full((len(days), bins), np.nan) for name in names}
    for at, day in enumerate(days):
        times = day.trace.times[day.rows] - day.begin
        column = day.trace.signals[model.temperature][day.rows]
        known = np.isfinite(column)
        here = np.minimum((times[known] / step).astype(int), bins - 1)
        count = np.bincount(here, minlength=bins)
        readings[at] = np.divide(
            np.bincount(here, column[known], bins), count, out=np.full(bins, np.nan), where=count > 0
        )
        for name, filled in drivers.items():
            if name in day.trace.signals:
                filled[at] = _held_at(times, day.trace.signals[name][day.rows], middles)
    return Grid(step, readings, drivers)


def _held_at(times: Array, column: Array, moments: Array) -> Array:
    """The newest value at each moment; the first one before it."""
    known = np.flatnonzero(np.isfinite(column))
    if not known.size:
        return np.full(moments.size, np.nan)
    return column[known[np.maximum(np.searchsorted(times[known], moments, side="right") - 1, 0)]]


def _fit(grid: Grid, name: str) -> DayFit | None:
    """Level and gain of each day by a signal, with the lag that explains most of the median day; None where it does
    not explain two days."""
    column = grid.drivers[name]
    usable: Mask = np.asarray(np.isfinite(column).all(axis=1))
    reach = np.where(usable, np.ptp(np.where(usable[:, None], column, 0.0), axis=1), 0.0)
    driven = usable & (reach >= MIN_DRIVEN_SHARE * reach.max(initial=0.0)) & (reach > 0)
    if driven.sum() < 2:
        return None
    tried = [_regress(grid, column, lag) for lag in LAGS_S]
    shares = [float(np.median(np.where(np.isfinite(each[2]), each[2], 0.0)[driven])) for each in tried]
    level, gain, explained = tried[int(np.argmax(shares))]
    known = driven & (explained >= MIN_EXPLAINED)
    if max(shares) < MIN_EXPLAINED or known.sum() < 2:
        return None
    # A machine that never stops was never seen without its load: its days are held against one another where it was.
    least = float(np.median(column[known].min(axis=1)))
    return DayFit(name, least, np.where(known, level + gain * least, np.nan), np.where(known, gain, np.nan))


def _regress(grid: Grid, column: Array, lag: float) -> tuple[Array, Array, Array]:
    """(level, gain, share explained by the driver) of each day, by a first-order lag (s) of it; NaN where none is."""
    lagged, keep = column.copy(), np.exp(-grid.step / lag) if lag else 0.0
    for at in range(1, column.shape[1]):
        lagged[:, at] = keep * lagged[:, at - 1] + (1.0 - keep) * column[:, at]
    left = keep ** np.arange(column.shape[1])
    level, gain, explained = np.full((3, len(column)), np.nan)
    for day, (readings, driver) in enumerate(zip(grid.readings, lagged, strict=True)):
        rows = np.isfinite(readings) & np.isfinite(driver)
        if not rows.any():
            continue
        # What a level and the night before leave of both: the driver has to explain the rest by itself.
        base = np.column_stack([np.ones(rows.sum()), *([left[rows]] if lag else [])])
        both = np.column_stack([readings[rows], driver[rows]])
        found = np.linalg.lstsq(base, both, rcond=None)[0]
        rest, pull = (both - base @ found).T
        if not (rest.any() and pull.any()):
            continue
        gain[day] = pull @ rest / (pull @ pull)
        level[day] = found[0, 0] - gain[day] * found[0, 1]
        explained[day] = gain[day] * (pull @ rest) / (rest @ rest)
    return level, gain, explained


def _turned_switch(model: Model, days: Sequence[Day], grid: Grid, fits: Sequence[DayFit]) -> Said | None:
    """Days on which the machine warms while its switch is 1, and others on which it cools."""
    switch = first_switch(model.alphabet)
    fit = next((fit for fit in fits if switch is not None and fit.name == switch.signal), None)
    if switch is None or fit is None:
        return None
    much = np.abs(fit.gain) >= MIN_DRIVEN_SHARE * np.nanmedian(np.abs(fit.gain))
    up, down = much & (fit.gain > 0), much & (fit.gain < 0)
    if not min(up.sum(), down.sum()) >= MIN_SHARE * np.isfinite(fit.gain).sum():
        return None
    said = f"{model.temperature} rises while {switch.signal} is 1 on {_list(days, up)} and falls then on "
    said += _list(days, down)
    on = grid.drivers[switch.signal] > 0.5
    levels = level_signals(model.alphabet)
    for name in levels:
        load = np.abs(grid.drivers[name])
        # While it is 1, and while it is 0, on the days of either kind.
        busy, idle = (
            [_mean(load[mask][(on[mask] == state) & np.isfinite(load[mask])]) for mask in (up, down)]
            for state in (True, False)
        )
        if busy[0] > REVERSED_LOAD_RATIO * idle[0] and idle[1] > REVERSED_LOAD_RATIO * busy[1]:
            told = f"{name} is {busy[0]:.3g} while it is 1 on the former and {busy[1]:.3g} on the latter"
            return False, f"{said}: it is upside down there, as {told}"
    # What warms the machine at rest is no turned switch: one that turned once leaves both of its degrees as they were.
    zero, one = fit.level, fit.level + fit.gain
    mirrored = all(
        abs(np.median(right[up]) - np.median(turned[down])) <= LEVEL_MISFIT_DEGC
        for right, turned in ((zero, one), (one, zero))
    )
    if levels or not mirrored or np.count_nonzero(np.diff(up[much])) != 1:
        return None
    return None, f"{said}: is it upside down there?"


def _mean(values: Array) -> float:
    return float(values.mean()) if values.size else nan


def _parted(model: Model, days: Sequence[Day], fits: Sequence[DayFit]) -> Said | None:
    """A moment at which level or gain leaps, as by another unit or another machine, whatever they are explained by."""
    leaps = [_leap(model, days, fit) for fit in fits]
    if not leaps or None in leaps:
        return None
    return min((leap for leap in leaps if leap is not None), key=lambda each: each[0] is None)


def _leap(model: Model, days: Sequence[Day], fit: DayFit) -> Said | None:
    """What is said of the moment at which what one signal explains leaps; None where it does not."""
    known = np.flatnonzero(np.isfinite(fit.gain))
    level, gain = fit.level[known], np.abs(fit.gain[known])
    leaps = [_split(np.log(gain), np.log(GAIN_RATIO)), _split(level, LEVEL_STEP)]
    for split in leaps:
        if split is None:
            continue
        parts = known[: split[0]], known[split[1] :]
        sides = [(float(np.median(fit.level[part])), float(np.median(np.abs(fit.gain[part])))) for part in parts]
        (low, less), (high, more) = sides
        said = (
            f"on {_list(days, parts[0])} {model.temperature} is {low:.3g} °C where {fit.name} is {fit.least:.3g} and "
            f"moves {less / more:.2g} times as much by it as on {_list(days, parts[1])}, with {high:.3g} °C"
        )
        for which, one, other in (("former", sides[1], sides[0]), ("latter", sides[0], sides[1])):
            if unit := _other_unit(one, other):
                return False, f"{said}: are the {which} {unit}?"
        # Of a single day nobody knows what it is usually like, but no day is another in both.
        if min(map(len, parts)) > 1 or all(leaps):
            return None, f"{said}: another machine, product, sensor or unit, or work on it?"
    return None


def _split(values: Array, least: float) -> tuple[int, int] | None:
    """The end of those before the one moment at which the values leap, and the first after it; None without a leap.

    One value in between belongs to neither. Kinds of days that alternate do not leap, and a few are no part.
    """
    for between in (1, 2):
        for end in range(1, values.size - between + 1):
            before, after = values[:end], values[end + between - 1 :]
            if min(before.size, after.size) < MIN_SHARE * values.size:
                continue
            gap = max(after.min() - before.max(), before.min() - after.max())
            if gap >= max(least, WITHIN_RATIO * max(np.ptp(before), np.ptp(after))):
                return end, end + between - 1
    return None


def _other_unit(one: tuple[float, float], other: tuple[float, float]) -> str:
    """The unit in which the other (level, gain) would be the one that is in degC; "" where there is none."""
    (level, gain), (written, grown) = one, other
    for name, (factor, offset) in OTHER_UNITS.items():
        right = factor * level + offset
        far = max(LEVEL_MISFIT_DEGC, LEVEL_MISFIT * abs(right))
        if abs(grown / (factor * gain) - 1.0) <= GAIN_MISFIT and abs(written - right) <= far:
            return name
    return ""


def _list(days: Sequence[Day], chosen: Mask | Indices) -> str:
    """The days, by number or mask, as a list that names some of them."""
    names = list(dict.fromkeys(days[at].words() for at in np.arange(len(days))[chosen]))
    if len(names) > MAX_LISTED:
        return f"{', '.join(names[:MAX_LISTED])} and {len(names) - MAX_LISTED} more days"
    return " and ".join([", ".join(names[:-1]), names[-1]] if names[1:] else names)


def _find_still(model: Model, traces: Sequence[Trace]) -> Said | None:
    """One reading through runs of the machine and through a rest that cools it by several steps at other times."""
    switch = first_switch(model.alphabet)
    if switch is None:
        return None
    stays = [stay for trace in traces if switch.signal in trace.signals for stay in _stays(model, switch.signal, trace)]
    runs = Counter(stay.stretch for stay in stays if stay.still and stay.on)
    rests: dict[tuple[float, float], float] = {}
    for stay in stays:
        if stay.still and not stay.on and runs[stay.stretch] >= STILL_RUNS:
            rests[stay.stretch] = max(rests.get(stay.stretch, 0.0), stay.length)
    stretch = max(rests, key=lambda each: each[1] - each[0], default=(0.0, 0.0))
    spent = stretch[1] - stretch[0]
    if spent <= MIN_SHARE * sum(float(trace.times[-1] - trace.times[0]) for trace in traces if trace.times.size):
        return None
    rest = rests[stretch]
    others = [stay for stay in stays if not stay.on and stay.stretch != stretch]
    moved = sum(stay.moves_after <= rest for stay in others)
    stood = sum(stay.moves_after > rest and stay.length >= rest for stay in others)
    if moved < STILL_RUNS or stood > MAX_USUALLY_STILL * (moved + stood):
        return None
    value = next(stay.reading for stay in stays if stay.stretch == stretch)
    return None, (
        f"{model.temperature} stands still at {value:.6g} through {runs[stretch]} whole runs and the rests between "
        f"them, from {exact_moment(stretch[0])} to {exact_moment(stretch[1])}, while in {moved} of "
        f"{moved + stood} other rests it moves within {rest / 60.0:.0f} min: a frozen sensor?"
    )


@dataclass(frozen=True, slots=True)
class Stay:
    """A whole run (`on`) or rest of `length` s that began with `reading`, which stood so over `stretch` (absolute s);
    `still` where it stood through all of it, and `moves_after` s (inf: never) it was MOVING_STEPS away."""

    on: bool
    length: float
    reading: float
    stretch: tuple[float, float]
    still: bool
    moves_after: float


def _stays(model: Model, switch: str, trace: Trace) -> Iterator[Stay]:
    """The runs and rests that begin and end within the trace, with a reading at least."""
    said = np.flatnonzero(np.isfinite(trace.signals[switch]))
    read = np.flatnonzero(np.isfinite(trace.signals[model.temperature]))
    readings, times = trace.signals[model.temperature][read], trace.times[read]
    steps = np.abs(np.diff(readings))
    turns = np.flatnonzero(steps) + 1
    if not turns.size:
        return
    far = MOVING_STEPS * float(np.quantile(steps[turns - 1], SMALL_STEP))
    firsts, lasts = np.append(0, turns), np.append(turns, readings.size) - 1
    on = trace.signals[switch][said] > 0.5
    changes = np.flatnonzero(on[1:] != on[:-1]) + 1
    moments = trace.times[said[changes]]
    bounds = np.searchsorted(times, moments)
    held = np.searchsorted(firsts, bounds, side="right") - 1
    for at in range(changes.size - 1):
        values = readings[bounds[at] : bounds[at + 1]]
        if values.size:
            away = np.flatnonzero(np.abs(values - values[0]) >= far)
            yield Stay(
                on=bool(on[changes[at]]),
                length=float(moments[at + 1] - moments[at]),
                reading=float(values[0]),
                stretch=(float(times[firsts[held[at]]]), float(times[lasts[held[at]]])),
                still=bool(lasts[held[at]] >= bounds[at + 1] - 1),
                moves_after=float(times[bounds[at] + away[0]] - moments[at]) if away.size else inf,
            )
