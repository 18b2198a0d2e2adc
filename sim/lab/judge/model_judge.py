"""The judge of a model where it is learned: may it be used, by what it foresaw unseen and by what it was taught.

One table of criteria. What speaks are independent units (cycles, days, forecasts that do not overlap), never rows. The
verdict is kept beside the model, and whoever shows, proves, promotes or runs it reads that.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import floor, inf, isfinite, log10

import numpy as np

from sim.artefacts import (
    FORECAST_CRITERION,
    ForeseenHorizon,
    ForeseenUnit,
    JudgedCriterion,
    ModelVerdict,
    rate_criteria,
)
from sim.lab.judge.days import REVERSED_LOAD_RATIO, judge_days
from sim.lab.judge.rows import MIN_FORECASTS
from sim.lab.learning import HORIZONS_S, MOST_WIDENING, Coverage, first_switch, level_signals
from sim.lab.recordings import FAHRENHEIT_REST_RANGE
from sim.proof import Verification, verify
from sim.sha import DEFAULT_UNIT, RELAXING_FLOWS, Array, Mask, Model, Trace, display_unit, distributions

WORSE_CRPS_RATIO = 1.05
"""A model is worse than persistence where its CRPS is more than so many times persistence's."""
MIN_BAND_SHARE = 0.5
"""A 90 % band that holds less than this of what it did not see was wrong about what the model knows."""
DAY_S = 86_400.0
ZERO_CELSIUS_K = 273.15
FEW_CYCLES, FEW_DAYS = 4, 2
"""Cycles and days below which nothing is known of how one differs from the next."""
CODE_DISTANCE_DEGC = 25.0
"""A reading so far (degC) from the median of the five around it is no bearing's: heat takes minutes."""
CODE_WINDOW_S = 300.0
"""Five rows within so long (s) are held against one another; others say nothing of codes."""
MIN_LEAPS = 3
"""Leaps of CODE_DISTANCE_DEGC that end at the very same reading, from which that is a code, however long it lasts."""
HEAT_STEP_DEGC = 5.0
"""Heat moves a bearing by no more from row to row (75 s at most)."""
MAX_CODE_SHARE = 0.005
"""The share of such readings above which they are no accidents but a code for "no reading", or a loose contact."""
KELVIN_REST_RANGE = (270.0, 310.0)
"""Where a machine at rest settles if its degrees are kelvin (-3 to 37 °C)."""
TENTHS_REST_RANGE, MIN_TENTHS_RISE = (100.0, 400.0), 100.0
"""Where a machine at rest settles if its readings are tenths of a degree (10 to 40 °C), and by how much it then rises:
an oven that is kept warm does not rise by so much, and no other machine rests so hot."""
NOISE_ROW_S, MIN_NOISE_DEGC, MAX_NOISE_SHARE = 60.0, 1.0, 0.1
"""Heat takes minutes: from row to row within so many seconds no bearing jumps by as many degC, and by such a share of
all that it moves (from its 5th to its 95th percentile; of noise alone that is 3.3 times its sigma)."""
MIXED_SHARE, MIXED_S = 0.1, 1800.0
"""A location mixes running and rest where both take this share of its time, and so many seconds, at least."""
MIN_SPAN = 0.05
"""Of its unit, by which readings must move in all: forecasts take a thousandth of it for nothing."""
MAX_BORROWED_SHARE = 0.5
"""The share of locations that no data have shown from which a model knows less than it has to guess."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LearnedCase:
    """What the criteria look at: a `model`, its training's encoded `traces`, and its held-out forecasts by horizon."""

    model: Model
    traces: Sequence[Trace]
    coverage: Sequence[Coverage]
    verification: Verification

    def readings(self) -> list[tuple[Array, Array]]:
        """(times, readings) of the temperature by trace, without rows that have none."""
        found = []
        for trace in self.traces:
            column = trace.signals[self.model.temperature]
            good = np.isfinite(column)
            found.append((trace.times[good], column[good]))
        return found

    def known_horizons(self) -> list[Coverage]:
        """The horizons of which enough is known, beside persistence."""
        return [
            row for row in self.coverage if row.independent >= MIN_FORECASTS and isfinite(row.persistence) and row.crps
        ]


Said = tuple[bool | None, str]


def judge_learning(model: Model, traces: Sequence[Trace], coverage: Sequence[Coverage]) -> ModelVerdict:
    """The verdict on a model by its learning: its training's encoded `traces`, and its held-out forecasts."""
    case = LearnedCase(model=model, traces=traces, coverage=coverage, verification=verify(model))
    criteria = []
    for name, (criterion, next_step) in CRITERIA.items():
        kept, sentence = criterion(case)
        criteria.append(
            JudgedCriterion(criterion=name, kept=kept, sentence=sentence, next_step="" if kept else next_step)
        )
    return ModelVerdict(
        word=rate_criteria(criteria, told=bool(case.known_horizons())),
        criteria=tuple(criteria),
        foreseen=tuple(
            ForeseenHorizon(
                horizon=row.horizon,
                units={
                    unit: ForeseenUnit(crps=round(score.crps, 6), moments=score.moments)
                    for unit, score in row.units.items()
                },
            )
            for row in coverage
        ),
    )


def _judge_proof(case: LearnedCase) -> Said:
    reasons = "; ".join(case.verification.reasons)
    return (False, f"it does not verify: {reasons}") if reasons else (True, "verified")


def _foresees(case: LearnedCase) -> Said:
    rows = case.known_horizons()
    if not rows:
        return None, "too few held-out forecasts to tell it from holding the last reading"
    unit = display_unit(case.model.unit)
    worse = [row for row in rows if row.crps > WORSE_CRPS_RATIO * row.persistence]
    said = ", ".join(
        f"{row.crps:.3g} against {row.persistence:.3g} {unit} at {row.horizon:g} s" for row in worse or rows
    )
    if len(worse) == len(rows):
        known = " of which enough is known" if len(rows) < len(HORIZONS_S) else ""
        return False, f"worse than holding the last reading at every horizon{known} (CRPS {said})"
    if worse:
        return None, f"worse than holding the last reading at some horizons (CRPS {said})"
    return True, f"as good as holding the last reading or better (CRPS {said})"


def _foresees_each_horizon(case: LearnedCase) -> Said:
    known = {row.horizon for row in case.known_horizons()}
    outcomes = {row.horizon: row.independent for row in case.coverage}
    few = [horizon for horizon in HORIZONS_S if outcomes.get(horizon, 0.0) < MIN_FORECASTS]
    alone = [horizon for horizon in HORIZONS_S if horizon not in known and horizon not in few]
    said = []
    if few:
        # What is not whole is not had.
        most = int(max(outcomes.get(horizon, 0.0) for horizon in few))
        said.append(
            f"at {_list_seconds(few)} {most} independent held-out forecasts at most had an outcome, and "
            f"{MIN_FORECASTS:g} are needed"
        )
    if alone:
        said.append(f"at {_list_seconds(alone)} nothing says what holding the last reading would have come to")
    if said:
        return None, "; ".join(said)
    return True, f"enough forecasts had an outcome at {_list_seconds(HORIZONS_S)}"


def _list_seconds(horizons: Sequence[float]) -> str:
    *most, last = (f"{horizon:g} s" for horizon in horizons)
    return f"{', '.join(most)} and {last}" if most else last


def _covers(case: LearnedCase) -> Said:
    rows = [row for row in case.coverage if row.independent >= MIN_FORECASTS]
    if not rows:
        return None, "how often its bands hold is not known"
    least = min(rows, key=lambda row: row.covered)
    said = f"the 90 % band held {100 * least.covered:.0f} % of what it did not see at {least.horizon:g} s"
    if any(row.factor >= MOST_WIDENING for row in rows):
        return False, f"{said}, which no widening mends"
    return (None if least.covered < MIN_BAND_SHARE else True), said


def _says_something(case: LearnedCase) -> Said:
    """A band that is wider than all that was ever read says less than the recording by itself."""
    rows = [row for row in case.coverage if row.width > 0]
    values = np.concatenate([column for _, column in case.readings()] or [np.zeros(0)])
    if not rows or not values.size:
        return True, "how wide its bands are was not looked at"
    span, unit = float(np.ptp(values)), display_unit(case.model.unit)
    widest = max(rows, key=lambda row: row.widening * row.width)
    wide, within = _apart(widest.widening * widest.width, span)
    said = f"its 90 % band is {wide} {unit} wide at {widest.horizon:g} s"
    if empty := [row.horizon for row in rows if row.widening * row.width > span]:
        return None, f"{said}, and its readings lie within {within} {unit}: at {_list_seconds(empty)} it says nothing"
    return True, f"{said}, of {within} {unit} within which its readings lie"


def _apart(one: float, other: float) -> tuple[str, str]:
    """Two numbers with two digits each, or as many more as they need to differ."""
    for more in range(12):
        said = [
            f"{each:.{max(0, 1 - floor(log10(each))) + more if 0 < each < inf else more}f}" for each in (one, other)
        ]
        if one == other or said[0] != said[1]:
            break
    return said[0], said[1]


def _taught_enough(case: LearnedCase) -> Said:
    switch = first_switch(case.model.alphabet)
    rises = sum(event.symbol == switch.rising for trace in case.traces for event in trace.events) if switch else None
    moments = np.concatenate([times for times, _ in case.readings()] or [np.zeros(0)])
    # Counted from the first reading: a night shift is one day, whatever the calendar says.
    days = np.unique((moments - moments.min(initial=np.inf)) // DAY_S)
    cycles = "" if rises is None else f"{rises} start{'' if rises == 1 else 's'} on "
    said = f"learned from {cycles}{days.size} day{'' if days.size == 1 else 's'}"
    if (rises is not None and rises < FEW_CYCLES) or days.size < FEW_DAYS:
        wide = ", and its bands for other days are wide" if any(not row.other_days for row in case.coverage) else ""
        return None, f"{said}: how one differs from the next is hardly known{wide}"
    return True, said


def _readings_are_readings(case: LearnedCase) -> Said:
    columns = [each for each in case.readings() if each[1].size >= 5 and case.model.unit == DEFAULT_UNIT]
    apart, values, usual = 0, list[float](), 0
    codes = _leapt_to(columns)
    for times, column in columns:
        windows = np.lib.stride_tricks.sliding_window_view
        middle = np.median(windows(column, 5), axis=1)
        # Rows that lie far apart may have all of a heating between them.
        near = times[4:] - times[:-4] <= CODE_WINDOW_S
        # A code that lasts is the median of the five itself.
        far = near & ((np.abs(column[2:-2] - middle) > CODE_DISTANCE_DEGC) | np.isin(column[2:-2], codes))
        usual, apart = usual + int(near.sum()), apart + int(far.sum())
        values += column[2:-2][far].tolist()
    if not usual or apart <= MAX_CODE_SHARE * usual:
        return True, "its readings follow one another as a bearing's do"
    ((common, count),) = Counter(values).most_common(1)
    what = f", {count} of them {common:g}: a code for no reading?" if count > apart / 2 else ""
    return False, f"{apart} of {usual} readings of {case.model.temperature} stand apart from those around them{what}"


def _leapt_to(columns: Sequence[tuple[Array, Array]]) -> list[float]:
    """The values (degC) that several leaps end at, and fewer steps as heat makes them."""
    leaps, steps, readings = [np.zeros((2, 0))], [np.zeros(0)], [np.zeros(0)]
    for times, column in columns:
        step, near = np.abs(np.diff(column)), np.diff(times) <= CODE_WINDOW_S / 4
        leaps.append(np.stack((column[:-1], column[1:]))[:, near & (step > CODE_DISTANCE_DEGC)])
        steps.append(column[1:][near & (step > 0.0) & (step <= HEAT_STEP_DEGC)])
        readings.append(column)
    values, ends = np.unique(np.concatenate(leaps, axis=1), return_inverse=True)
    ends = ends.reshape(2, -1)
    low, high = np.searchsorted(np.sort(np.concatenate(steps)), (values - MIN_NOISE_DEGC, values + MIN_NOISE_DEGC))
    found, middle = list[float](), float(np.median(np.concatenate(readings))) if ends.size else 0.0
    while ends.size:
        arrived = np.bincount(ends[1], minlength=values.size)
        codes = np.flatnonzero((arrived >= MIN_LEAPS) & (arrived > high - low))
        if not codes.size:
            break
        # There are as many leaps back as to a code, and a rounded sensor's all end at one reading: that is no code.
        whole = np.bincount(ends.ravel(), minlength=values.size)
        code = max(codes.tolist(), key=lambda at: (whole[at], abs(values[at] - middle)))
        found.append(float(values[code]))
        ends = ends[:, (ends != code).all(axis=0)]
    return found


def _move_as_heat_does(case: LearnedCase) -> Said:
    if case.model.unit != DEFAULT_UNIT:
        return True, f"in {display_unit(case.model.unit)}"
    columns = case.readings()
    jumps = [np.abs(np.diff(column))[np.diff(times) <= NOISE_ROW_S] for times, column in columns]
    if not sum(map(len, jumps)):
        apart = np.concatenate([np.diff(times) for times, _ in columns] or [np.zeros(0)])
        rows = f"its rows lie {np.median(apart):.0f} s apart" if apart.size else "it has no two readings"
        return True, f"noise was not looked for: {rows}"
    jump = float(np.median(np.concatenate(jumps)))
    # Of each trace alone: one that was taken in summer makes no other one quiet.
    span = max((float(np.ptp(np.quantile(column, (0.05, 0.95)))) for _, column in columns if column.size), default=0.0)
    if jump <= max(MIN_NOISE_DEGC, MAX_NOISE_SHARE * span):
        return True, f"from row to row it moves by {jump:.2g} °C"
    said = f"from row to row {case.model.temperature} jumps by {jump:.2g} °C, of {span:.0f} °C that it moves in all"
    return None, f"{said}: noise, a loose contact, or rows of two machines?"


def _switch_is_upright(case: LearnedCase) -> Said:
    switch = first_switch(case.model.alphabet)
    if switch is None:
        return True, "no switch is read"
    warming, cooling, loads = list[float](), list[float](), dict[str, tuple[list[Array], list[Array]]]()
    for trace in case.traces:
        if switch.signal not in trace.signals:
            continue
        running = _hold_column(trace.signals[switch.signal])
        for name in level_signals(case.model.alphabet):
            level = (
                np.abs(_hold_column(trace.signals[name])) if name in trace.signals else np.full(running.size, np.nan)
            )
            for of_it, mask in zip(loads.setdefault(name, ([], [])), (running > 0.5, running < 0.5), strict=True):
                of_it.append(level[mask & np.isfinite(level)])
        temperature = trace.signals[case.model.temperature]
        for mask, rates in ((running > 0.5, warming), (running < 0.5, cooling)):
            rates += _course(trace.times, temperature, mask)
    if not (warming and cooling and np.median(warming) < 0 < np.median(cooling)):
        return True, f"{switch.signal} is 1 while {case.model.temperature} rises, or does not tell"
    said = f"{case.model.temperature} rises while {switch.signal} is 0 and falls else"
    for name, (on, off) in loads.items():
        busy, idle = (float(np.concatenate(parts).mean()) if sum(map(len, parts)) else 0.0 for parts in (on, off))
        if idle > REVERSED_LOAD_RATIO * busy:
            levels = f"{name} is {idle:.3g} while it is 0 and {busy:.3g} else"
            return False, f"{switch.signal} is upside down: {said}, and {levels}"
    # What cools while it runs, as a cold room does, is no machine that is upside down.
    return None, f"{said}: is it upside down, or does it cool?"


def _hold_column(column: Array) -> Array:
    """Each row's newest value; NaN before the first."""
    known = np.isfinite(column)
    place = np.maximum.accumulate(np.where(known, np.arange(column.size), -1))
    return np.where(place >= 0, column[np.maximum(place, 0)], np.nan)


def _course(times: Array, values: Array, mask: Mask) -> list[float]:
    """By how much the values change over each stretch of the mask, that has at least two of them."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], mask.astype(np.int8), [0]))))
    found = []
    for begin, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        known = values[begin:end][np.isfinite(values[begin:end])]
        if known.size > 1 and times[end - 1] > times[begin]:
            found.append(float(known[-1] - known[0]))
    return found


def _from_a_plant(case: LearnedCase) -> Said:
    if any(trace.synthetic for trace in case.traces):
        return None, "learned from synthetic traces"
    return True, "learned from measured traces"


def _degrees_are_celsius(case: LearnedCase) -> Said:
    if case.model.unit != DEFAULT_UNIT:
        return True, f"in {display_unit(case.model.unit)}"
    switch = first_switch(case.model.alphabet)
    lowest = [
        float(np.nanquantile(column, 0.01))
        for trace in case.traces
        if switch is not None and switch.signal in trace.signals
        and (column := trace.signals[case.model.temperature][_hold_column(trace.signals[switch.signal]) < 0.5]).size
        and np.isfinite(column).any()
    ]  # fmt: skip
    rest = min(lowest, default=None)
    if rest is None:
        return True, "it was never seen at rest"
    said = f"at rest it is never below {rest:.0f} °C"
    columns = [column for _, column in case.readings() if column.size]
    rise = max(float(np.quantile(column, 0.99)) for column in columns) - rest
    if TENTHS_REST_RANGE[0] <= rest <= TENTHS_REST_RANGE[1] and rise >= MIN_TENTHS_RISE:
        return None, f"{said}, and it rises by {rise:.0f} °C: are these tenths of a degree ({rest / 10.0:.0f} °C)?"
    if FAHRENHEIT_REST_RANGE[0] < rest < FAHRENHEIT_REST_RANGE[1]:
        return None, f"{said}: are these degrees Fahrenheit ({(rest - 32.0) / 1.8:.0f} °C)?"
    if KELVIN_REST_RANGE[0] < rest < KELVIN_REST_RANGE[1]:
        return None, f"{said}: are these kelvin ({rest - ZERO_CELSIUS_K:.0f} °C)?"
    return True, f"{said}, which is neither in degrees Fahrenheit nor in kelvin what a machine at rest has"


def _judge_places(case: LearnedCase) -> Said:
    switch = first_switch(case.model.alphabet)
    seconds = _stays(case, switch.signal) if switch is not None else {}
    mixed = {
        name: (on, off) for name, (on, off) in seconds.items() if min(on, off) > max(MIXED_S, MIXED_SHARE * (on + off))
    }
    shown = sum(on + off > 0 for on, off in seconds.values())
    if mixed:
        name, (on, off) = max(mixed.items(), key=lambda item: min(item[1]))
        said = f"{name} holds {on / 3600:.1f} h of running and {off / 3600:.1f} h of rest as if they were the same"
        return (False if shown == 1 else None), said
    return True, f"{shown or len(case.model.sha.locations)} locations are told apart"


def _were_seen(case: LearnedCase) -> Said:
    known = [place for place in case.model.sha.locations if place.distribution is not None]
    borrowed = [place.name for place in known if place.name in case.model.borrowed]
    few = len(borrowed) <= MAX_BORROWED_SHARE * len(known)
    switch = first_switch(case.model.alphabet)
    stays = _stays(case, switch.signal) if switch is not None and not few else {}
    if unlike := [sum(stays[name]) for name in borrowed if sum(stays.get(name, ())) > MIXED_S]:
        said = (
            f"{len(borrowed)} of {len(known)} locations have no values of their own, {len(unlike)} of which were seen"
        )
        return None, f"{said}, for {sum(unlike) / 3600:.1f} h: is it one machine in one state?"
    return few or None, f"{len(borrowed)} of {len(known)} locations were never seen"


def _stays(case: LearnedCase, signal: str) -> dict[str, tuple[float, float]]:
    """location -> seconds that its traces spent there (running, at rest), by the edges alone."""
    go = {(edge.source, edge.symbol): edge.target for edge in case.model.sha.edges}
    number = {place.name: at for at, place in enumerate(case.model.sha.locations)}
    spent = np.zeros((2, len(number)))
    for trace in case.traces:
        if signal not in trace.signals or trace.times.size < 2:
            continue
        place, places = case.model.sha.initial, [number[case.model.sha.initial]]
        for event in trace.events:
            place = go.get((place, event.symbol), place)
            places.append(number[place])
        moments = np.array([event.time for event in trace.events])
        here = np.array(places)[np.searchsorted(moments, trace.times[:-1], side="right")]
        seconds = np.minimum(np.diff(trace.times), case.model.alphabet.gap)
        running = _hold_column(trace.signals[signal])[:-1]
        for row, mask in enumerate((running > 0.5, running < 0.5)):
            spent[row] += np.bincount(here[mask], seconds[mask], len(number))
    return {name: (float(spent[0, at]), float(spent[1, at])) for name, at in number.items() if spent[:, at].any()}


def _judge_range(case: LearnedCase) -> Said:
    """Targets that no data came near are guesses."""
    values = np.concatenate([column for _, column in case.readings()] or [np.zeros(0)])
    if not values.size:
        return None, "it has no readings"
    low, high = float(values.min()), float(values.max())
    reach = 2.0 * (high - low)
    wild = [
        (place.name, mean)
        for place in case.model.sha.locations
        if place.distribution is not None
        and place.flow.kind in RELAXING_FLOWS
        and place.name not in case.model.borrowed
        and not low - reach <= (mean := distributions.mean(place.distribution)) <= high + reach
    ]
    if wild:
        name, mean = wild[0]
        return None, f"{name} leads to {mean:.0f}, and its readings were {low:.0f} to {high:.0f}"
    return True, f"its targets lie where its readings were ({low:.0f} to {high:.0f})"


def _moves_in_its_unit(case: LearnedCase) -> Said:
    """Forecasts and their mixture take a thousandth of the unit for nothing, whatever the unit is."""
    values = np.concatenate([column for _, column in case.readings()] or [np.zeros(0)])
    span = float(np.ptp(np.quantile(values, (0.01, 0.99)))) if values.size else 0.0
    unit = display_unit(case.model.unit)
    said = f"its readings move by {span:.2g} {unit} in all"
    if span < MIN_SPAN:
        return None, f"{said}, and a thousandth of that unit is taken for nothing"
    return True, said


CRITERIA: Mapping[str, tuple[Callable[[LearnedCase], Said], str]] = {
    "verified": (
        _judge_proof,
        "see what `decanter model judge proof` refutes, and learn with another --method or flow",
    ),
    FORECAST_CRITERION: (_foresees, "learn with more starts and stops; `decanter diagnose` names what is missing"),
    "horizons": (_foresees_each_horizon, "learn with longer unbroken recordings"),
    "band": (_covers, "learn with more days, or look at the sensor's noise"),
    "width": (_says_something, "learn with longer recordings and more days"),
    "units": (_taught_enough, "learn with more days and starts"),
    "readings": (_readings_are_readings, "say the code for no reading in the column map (bad = [...])"),
    "noise": (_move_as_heat_does, "look at the sensor and its wiring; give each machine a file of its own"),
    "switch": (_switch_is_upright, "derive it in the column map from what says standstill: [derived], below = 0.5"),
    "days": (
        lambda case: judge_days(case.model, case.traces),
        "learn without the days that are not like the others, or mend them: units, switch, machine, sensor",
    ),
    "from a plant": (_from_a_plant, "learn from the plant's own recordings"),
    "degrees": (_degrees_are_celsius, "say the unit in the column map, or go on if the machine is kept so warm"),
    "locations": (_judge_places, "learn with --method bins, which keeps the switch's positions apart"),
    "seen": (
        _were_seen,
        "learn with traces that show them, with fewer thresholds, or with a file for each machine",
    ),
    "targets": (_judge_range, "learn with longer stays"),
    "scale": (_moves_in_its_unit, "give the readings in a smaller unit, by the column map"),
}
"""Every criterion by name: kept or not (None: limits the model, or not known), with its figure, and the next step."""
