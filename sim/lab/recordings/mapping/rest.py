"""What a bearing comes to while its machine stands still: degrees Fahrenheit that nobody calls so are told by it."""

from collections.abc import Sequence

import numpy as np

from sim.lab.recordings import FAHRENHEIT_REST_RANGE
from sim.lab.recordings.mapping.answers import Answers, Undecided
from sim.lab.recordings.mapping.columns import FoundColumn
from sim.lab.recordings.mapping.words import named_bearing, named_surroundings
from sim.sha import Array, Trace

_MAX_RUNNING_DEGC = 110.0
"""degC above which no bearing's usual running is: plants stop their machines there."""
_MAX_ROOM_DEGC = 50.0
"""degC that no room of a plant has."""
_LEAST_COOLING = 10.0
"""Degrees below the usual running that a rest must lead to, or it shows nothing."""
_LEAST_READINGS = 8
_FITTED_READINGS = 500
"""Of a rest that are fitted: a day of seconds shows no more."""
_LONGEST_RESTS = 5
"""Rests that are looked at: the longest come nearest to where they lead."""
_DECAYS = np.geomspace(0.05, 4.0, 20)
"""Time constants of cooling that are tried, in lengths of the rest."""
_SHOWN_DECAY = 0.6
"""Of a slower cooling the rest's end does not show where it leads."""
_STEADY = 3.0
"""Degrees between which a rest has settled from its beginning on."""
_EXPLAINED = 0.95
"""Share of the cooling's variance that an exponential must explain, or it says no level."""


def check_rest(
    where: object,
    temperature: FoundColumn,
    running: str,
    columns: Sequence[FoundColumn],
    traces: Sequence[Trace],
    answers: Answers,
) -> None:
    """Raises Undecided for a bearing without a unit that rests, or stays, where only degrees Fahrenheit make sense.

    `running` is the switch of the machine. A room beside it of no unit too that is as cold as rooms are says degC.
    """
    if temperature.unit or (temperature.scale, temperature.offset) != (1.0, 0.0) or temperature.measured:
        return
    if not named_bearing(temperature.name) or any(text.startswith(f"{temperature.header}=") for text in answers.unit):
        return
    rooms = [each for each in columns if each.kind == "number" and not each.unit and named_surroundings(each.name)]
    rooms = [each for each in rooms if np.isfinite(each.values).any() and each is not temperature]
    if any(float(np.nanmedian(room.values)) < _MAX_ROOM_DEGC for room in rooms):
        return
    rests, runs = list[float](), list[Array]()
    for trace in traces:
        values, switch = trace.signals.get(temperature.name), trace.signals.get(running)
        if values is None or switch is None:
            continue
        known = np.isfinite(values) & np.isfinite(switch) & ~np.isin(values, temperature.bad)
        runs.append(values[known & (switch > 0)])
        rests += _rest_levels(trace.times[known], values[known], switch[known] > 0)
    low, high = FAHRENHEIT_REST_RANGE
    usual = float(np.median(np.concatenate(runs))) if any(run.size for run in runs) else np.nan
    # A stop of seconds leaves a bearing as warm as it was.
    rests = [level for level in rests if not level > usual - _LEAST_COOLING]
    if rests:
        level = float(np.median(rests))
        if not low < level < high:
            return
        seen = f"comes to {level:.0f} while its machine stands still, as one of {(level - 32.0) / 1.8:.0f} degC does"
    else:
        if not usual > _MAX_RUNNING_DEGC:
            return
        seen = f"stays at {usual:.0f}, which as degC no bearing does for long"
    raise Undecided(
        where,
        f"{temperature.header!r} says no unit and {seen} in degrees Fahrenheit",
        "unit",
        [f"{temperature.header}=F", f"{temperature.header}=degC"],
        guess=f"{temperature.header}=F",
    )


def _rest_levels(times: Array, values: Array, runs: np.ndarray) -> list[float]:
    """Where the longest rests lead; nothing of one that is too short to show it."""
    edges = np.flatnonzero(np.diff(np.concatenate(([True], runs, [True])).astype(np.int8)))
    rests = list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
    rests = [(begin, end) for begin, end in rests if end - begin >= _LEAST_READINGS]
    rests.sort(key=lambda rest: times[rest[0]] - times[rest[1] - 1])
    levels = (_settled_level(times[begin:end], values[begin:end]) for begin, end in rests[:_LONGEST_RESTS])
    return [level for level in levels if level is not None]


def _settled_level(times: Array, values: Array) -> float | None:
    """Where an exponential through a rest's readings leads; None where they show none."""
    if np.ptp(values) <= _STEADY:
        return float(np.median(values))
    thin = max(values.size // _FITTED_READINGS, 1)
    times, values = times[::thin], values[::thin]
    length = float(times[-1] - times[0])
    best, level, slowness = np.inf, 0.0, np.inf
    for decay in _DECAYS.tolist() if length > 0 else ():
        shape = np.exp(-(times - times[0]) / (decay * length))
        slope, rest = np.polyfit(shape, values, 1)
        error = float(np.mean((values - slope * shape - rest) ** 2))
        if error < best:
            best, level, slowness = error, float(rest), decay
    shown = slowness <= _SHOWN_DECAY and best <= (1.0 - _EXPLAINED) * float(np.var(values))
    return level if shown else None
