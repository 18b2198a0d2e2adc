"""Elapsed times: in which unit they count, by what the file says of it; what nothing says is asked, or said as a guess.

In seconds are those in which a temperature of the file goes as one of a machine does; that is a conclusion, and told.
"""

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim.lab.recordings import COUNTS, TraceError, list_names, numbers, since_1970
from sim.lab.recordings.mapping.answers import Answers, Undecided
from sim.lab.recordings.mapping.clocks import FoundClock, says_count_unit, units_named
from sim.lab.recordings.mapping.columns import find_decimal
from sim.lab.recordings.mapping.table import FoundTable
from sim.lab.recordings.mapping.words import split_unit, temperature_score
from sim.sha import Array

_UNITS = {
    "s": "seconds", "ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds", "min": "minutes", "h": "hours",
    "d": "days",
}  # fmt: skip
"""Units of elapsed time as a person gives them, and the formats of a clock that counts in them."""
_ROW_EVERY = re.compile(
    r"(?P<what>[^\W\d]*(?:sampl|scan|abtast|interval|campion|[ée]chantillon|muestr|\bdt\b|周期|间隔)[^\d\n]*?)"
    r"(?P<count>\d+(?:[.,]\d+)?(?:[eE][+-]?\d+)?)[\s\"]*"
    r"(?P<unit>[nuµm]?s(?:ec(?:onds?)?)?\b|min\b|h\b|[kM]?Hz\b|samples?\s*(?:/|per)\s*s)?",
    re.IGNORECASE,
)
"""What a recorder says above its table of how often it writes a row."""
_IN_S = {"ns": 1e-9, "us": 1e-6, "µs": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0}
_HERTZ = {"hz": 1.0, "khz": 1e3, "mhz": 1e6}
_WORD = re.compile(r"[^\W\d_]+")
_SAME = 0.02
"""Share by which an interval may differ from what is said of it."""
_LIKELY_DEGC_PER_H = (2.0, 2000.0)
"""How fast a machine's temperature goes where it goes fastest: a bearing warms in hours, a motor's winding in minutes.
A guess follows it; it proves nothing, as a room drifts more slowly and a processor warms in seconds."""
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
    likely = _likely(table, clock)
    if likely[:1] == ["s"] and not units_named(header):
        # Seconds are what a time without a unit counts; in minutes a machine may go as slowly, so it is said.
        return replace(clock, why="nothing says its unit, and in seconds the temperature goes as one of a machine does")
    guess = next(iter(likely), "s" if usual < 3600.0 else "ms" if usual < 3.6e6 else "us" if usual < 3.6e9 else "ns")
    first = [guess, *(unit for unit in _UNITS if unit != guess)]
    raise Undecided(
        table.path,
        f"the times in {header!r} say no unit, and go on by {usual:g}",
        "unit",
        [f"{header}={unit}" for unit in first],
        guess=f"{header}={guess}",
    )


def _counting_in(clock: FoundClock, unit: str) -> FoundClock:
    format_ = _UNITS[unit]
    return replace(clock, formats=(format_,), times=COUNTS[format_].seconds(clock.times))


def _sizes() -> dict[str, float]:
    """Seconds of each unit."""
    return {unit: 1.0 / COUNTS[format_].second for unit, format_ in _UNITS.items()}


def _row_every(lines: Sequence[str]) -> float:
    """Seconds between rows as the lines above a table say, in words with a unit or in hertz; 0 for what says none."""
    for line in lines:
        for match in _ROW_EVERY.finditer(line):
            count = float(match["count"].replace(",", "."))
            # "Interval: 100 ms", "Abtastrate [Hz]; 10".
            named = [word.casefold() for word in _WORD.findall(match["what"])]
            unit = (match["unit"] or next((word for word in named if word in _IN_S or word in _HERTZ), "")).casefold()
            if not count or not unit:
                continue
            unit = "s" if unit.startswith("sec") else "hz" if unit.startswith("sample") else unit
            unit = re.sub(r"ec(?:onds?)?$", "", unit)
            return 1.0 / (count * _HERTZ[unit]) if unit in _HERTZ else count * _IN_S[unit]
    return 0.0


def _unit_beside(counts: Array, wall: Array) -> str:
    """The unit in which counts go on as another clock of the same rows does; "" for none."""
    if counts.size != wall.size:
        shown = min(counts.size, wall.size)
        counts, wall = counts[:shown], wall[:shown]
    known = np.isfinite(counts) & np.isfinite(wall)
    if np.count_nonzero(known) < 2:
        return ""
    gone, told = np.ptp(counts[known]), np.ptp(wall[known])
    fitting = [unit for unit, size in _sizes().items() if gone and abs(gone * size - told) <= _SAME * told]
    return fitting[0] if fitting and told > 0 else ""


def _likely(table: FoundTable, clock: FoundClock) -> list[str]:
    """The units in which the temperature goes as one of a machine does, seconds first; none where none is known."""
    for place, name in enumerate(table.titles):
        bare, unit = split_unit(name)
        if place == clock.place or not temperature_score(bare, unit or table.units[place]):
            continue
        cells = table.column(place)
        values = numbers(cells, find_decimal([cells], table.separator))[0]
        shown = min(values.size, clock.times.size)
        fastest = _fastest(clock.times[:shown], values[:shown])
        low, high = _LIKELY_DEGC_PER_H
        fitting = [unit for unit, size in _sizes().items() if low <= fastest * 3600.0 / size <= high]
        if fitting:
            return fitting
    return []


def _fastest(times: Array, values: Array) -> float:
    """By how much a temperature goes on in one count of time where it is fastest, over half of its way; 0 for none."""
    known = np.isfinite(times) & np.isfinite(values)
    times, values = times[known], values[known]
    rows = np.unique(np.linspace(0, times.size - 1, min(times.size, _SHOWN_READINGS)).astype(int)) if times.size else []
    times, values = times[rows], values[rows]
    if times.size < 3 or not (half := float(np.ptp(np.quantile(values, (0.02, 0.98)))) / 2.0):
        return 0.0
    session = np.cumsum(np.diff(times, prepend=times[0]) < 0)  # a clock that begins anew
    pairs = (np.abs(values[:, None] - values) >= half) & (session[:, None] == session)
    apart = np.abs(times[:, None] - times)[pairs]
    shortest = float(apart.min()) if apart.size else 0.0
    return half / shortest if shortest else 0.0
