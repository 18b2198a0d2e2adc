"""Elapsed times: in which unit they count, by what the file says of it; what nothing says is asked, or said as a guess.

In seconds are those in which a temperature of the file goes as one of a machine does; that is a conclusion, and told.
"""

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim.lab.recordings import COUNTS, TraceError, list_names, numbers, since_1970
from sim.lab.recordings.mapping.answers import Answers, Undecided
from sim.lab.recordings.mapping.clocks import TIME_UNITS, FoundClock, says_count_unit, time_unit, units_named
from sim.lab.recordings.mapping.columns import find_decimal
from sim.lab.recordings.mapping.table import FoundTable
from sim.lab.recordings.mapping.words import split_unit, temperature_score
from sim.sha import Array

_UNITS = {words[0]: unit for unit, words in TIME_UNITS.items()}
"""Units of elapsed time as a person gives them, and the formats of a clock that counts in them."""
_WRITES = (
    r"(?:sampl|scan|log|record|stor|sav|acqui|abtast|aufzeich|speicher|mess(?!age)|campion|registr|[ée]chantillon"
    r"|enregistr|muestr|采样|记录|存储)[^\W\d_]*"
)
_HOW_OFTEN = r"(?:interval|p[ée]riod|rate|every|fr[ée]q|takt|zyklus|周期|间隔)[^\W\d_]*"
_ROW_EVERY = re.compile(
    rf"(?:^\W*(?:interval[^\W\d_]*|周期|间隔)|\bdt\b|\b(?:sampling|abtastung)(?=\W+\d)"
    rf"|{_WRITES}[ _-]?{_HOW_OFTEN}|{_HOW_OFTEN} d[ei'’] ?{_WRITES})"
    r"(?P<named>[\W_]*(?:[^\W\d_]+[\W_]+)?)(?<!\.)(?P<count>\d[\d.,]*(?:e[+-]?\d+)?)[\s\"]*"
    r"(?P<unit>[^\W\d_]+)?(?:\s*(?:/|\bper\b)\s*(?P<per>[^\W\d_]+))?",
    re.IGNORECASE,
)
"""What a recorder says above its table of how often it writes a row; of other intervals, as of calibrations, not."""
_COUNT = re.compile(r"(?![1-9]\d{0,2}[.,]\d{3}$)\d+(?:[.,]\d+)?(?:e[+-]?\d+)?", re.IGNORECASE)
"""A number whose mark is no thousands mark: 1,000 may be one or a thousand, which is what units differ by."""
_LINKS = frozenset({"of", "is", "in", "ist"})
_HERTZ = {"hz": 1.0, "khz": 1e3, "mhz": 1e6}
_WORD = re.compile(r"[^\W\d_]+")
_SAME = 0.02
"""Share by which an interval may differ from what is said of it."""
_LIKELY_DEGC_PER_H = (2.0, 2000.0)
"""How fast a machine's temperature goes where it goes fastest: a bearing warms in hours, a motor's winding in minutes.
A guess follows it; it proves nothing, as a room drifts more slowly and a processor warms in seconds."""
_SLOWEST_DEGC_PER_H = 0.1
"""Slower than a room drifts; what goes so in seconds is counted in something shorter."""
_MANY_S = 100.0
"""Steps of so many seconds are of whole minutes; others are of something shorter."""
_USUAL = ("s", "ms", "min", "h")
"""Units that a question names; all are answers to it."""
_SHOWN_READINGS = 1000


def in_own_unit(table: FoundTable, clock: FoundClock, others: Sequence[FoundClock], answers: Answers) -> FoundClock:
    """The clock in the unit that a person, the file's head or another of its clocks (`others`) says.

    Raises Undecided for elapsed times of which nothing says the unit and that are no likely seconds, TraceError for a
    unit that is none of a time and for what counts rows.
    """
    header = table.header[clock.place]
    said = [text.rpartition("=")[2] for text in answers.unit if text.rpartition("=")[0] == header]
    if said and said[-1] not in _UNITS:
        raise TraceError(f"{table.path}: --unit {header}={said[-1]}: a time is in one of {list_names(_UNITS)}")
    if said:
        return replace(clock, formats=(_UNITS[said[-1]],))
    if clock.formats != ("seconds",) or since_1970(float(np.nanmin(clock.times))) or says_count_unit(header):
        return clock
    if (below := table.units[clock.place]) in _UNITS:
        return _counting_in(clock, below)
    steps = np.abs(np.diff(clock.times))
    usual = float(np.median(steps[steps > 0])) if np.any(steps > 0) else 0.0
    if any(line.startswith("LabVIEW Measurement") for line in table.above):
        return clock  # the format's own unit
    if (every := _row_every(table.above)) and usual:
        fitting = [unit for unit, size in _sizes().items() if abs(usual * size - every) <= _SAME * every]
        if fitting:
            return _counting_in(clock, fitting[0])
        if np.all(steps[steps > 0] == 1.0):
            raise TraceError(
                f"{table.path}: {header!r} counts rows, and the lines above say one every {every:g} s: write the "
                f"time of each row in it, or give its unit with --unit {header}=s"
            )
    for other in others:
        if unit := _unit_beside(clock.times, other.times):
            return _counting_in(clock, unit)
    fastest = _fastest_of_the_file(table, clock)
    likely = _likely(fastest)
    if likely[:1] == ["s"] and not units_named(header):
        # Seconds are what a time without a unit counts; in minutes a machine may go as slowly, so it is said.
        return replace(clock, why="nothing says its unit, and in seconds the temperature goes as one of a machine does")
    guess = _guess(usual, fastest)
    raise Undecided(
        table.path,
        f"the times in {header!r} say no unit, and go on by {usual:g}",
        "unit",
        [f"{header}={unit}" for unit in dict.fromkeys((guess, *likely, *_USUAL))],
        guess=f"{header}={guess}",
    )


def _guess(usual: float, fastest: float) -> str:
    """Seconds, also where in them a temperature drifts as a room's, by steps of seconds or of whole minutes.

    Where it would go faster, or more slowly than a room, the unit in which it goes as one of a machine.

    `usual` is the step of the times, `fastest` the way of the temperature in one count of them, 0 where none is known.
    """
    if not fastest:
        return "s" if usual < 3600.0 else "ms" if usual < 3.6e6 else "us" if usual < 3.6e9 else "ns"
    in_seconds = fastest * 3600.0
    of_seconds = usual < _MANY_S or (usual <= 3600.0 and usual % 60.0 == 0)
    if of_seconds and _SLOWEST_DEGC_PER_H <= in_seconds <= _LIKELY_DEGC_PER_H[1]:
        return "s"
    return next(iter(_likely(fastest)), "s")


def _counting_in(clock: FoundClock, unit: str) -> FoundClock:
    format_ = _UNITS[unit]
    return replace(clock, formats=(format_,), times=COUNTS[format_].seconds(clock.times))


def _sizes() -> dict[str, float]:
    """Seconds of each unit."""
    return {unit: 1.0 / COUNTS[format_].second for unit, format_ in _UNITS.items()}


def _row_every(lines: Sequence[str]) -> float:
    """Seconds between rows as the lines above a table say, in words with a unit or in hertz; 0 for what says none."""
    sizes = {_UNITS[unit]: size for unit, size in _sizes().items()}
    for line in lines:
        for match in _ROW_EVERY.finditer(line):
            # "Interval: 100 ms", "Abtastrate [Hz]; 10", "Rate: 10 samples/s".
            named = [word for word in _WORD.findall(match["named"]) if word.casefold() not in _LINKS]
            known = [word for word in (match["unit"] or "", *named) if time_unit(word) or word.casefold() in _HERTZ]
            count = float(match["count"].replace(",", ".")) if _COUNT.fullmatch(match["count"]) else 0.0
            if not count or not (known or match["per"]) or not set(named) <= set(known):
                continue
            if match["per"]:
                if unit := time_unit(match["per"]):
                    return sizes[unit] / count
                continue
            if (hertz := _HERTZ.get(known[0].casefold())) is not None:
                return 1.0 / (count * hertz)
            return count * sizes[time_unit(known[0])]
    return 0.0


def _unit_beside(counts: Array, wall: Array) -> str:
    """The unit in which counts go on as another clock of the same rows does; "" for none.

    Where the counts begin anew and the other goes on is no step of either.
    """
    shown = min(counts.size, wall.size)
    counts, wall = counts[:shown], wall[:shown]
    known = np.isfinite(counts) & np.isfinite(wall)
    steps, others = np.diff(counts[known]), np.diff(wall[known])
    along = steps * others >= 0
    gone, told = abs(float(steps[along].sum())), abs(float(others[along].sum()))
    fitting = [unit for unit, size in _sizes().items() if gone and abs(gone * size - told) <= _SAME * told]
    return fitting[0] if fitting and told > 0 else ""


def _fastest_of_the_file(table: FoundTable, clock: FoundClock) -> float:
    """How fast its first temperature that moves goes where it goes fastest, degC in one count of time; 0 for none."""
    for place, name in enumerate(table.titles):
        bare, unit = split_unit(name)
        if place == clock.place or not temperature_score(bare, unit or table.units[place]):
            continue
        cells = table.column(place)
        values = numbers(cells, find_decimal([cells], table.separator))[0]
        shown = min(values.size, clock.times.size)
        if fastest := _fastest(clock.times[:shown], values[:shown]):
            return fastest
    return 0.0


def _likely(fastest: float) -> list[str]:
    """The units in which a temperature goes as one of a machine does, seconds first; `fastest` in degC a count."""
    low, high = _LIKELY_DEGC_PER_H
    return [unit for unit, size in _sizes().items() if low <= fastest * 3600.0 / size <= high]


def _fastest(times: Array, values: Array) -> float:
    """By how much a temperature goes on in one count of time where it is fastest, over half of its way; 0 for none."""
    known = np.isfinite(times) & np.isfinite(values)
    times, values = times[known], values[known]
    rows = np.unique(np.linspace(0, max(times.size - 1, 0), min(times.size, _SHOWN_READINGS)).astype(int))
    times, values = times[rows], values[rows]
    if times.size < 3 or not (half := float(np.ptp(np.quantile(values, (0.02, 0.98)))) / 2.0):
        return 0.0
    session = np.cumsum(np.diff(times, prepend=times[0]) < 0)  # a clock that begins anew
    pairs = (np.abs(values[:, None] - values) >= half) & (session[:, None] == session)
    apart = np.abs(times[:, None] - times)[pairs]
    shortest = float(apart.min()) if apart.size else 0.0
    return half / shortest if shortest else 0.0
