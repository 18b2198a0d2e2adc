"""What a bearing comes to while its machine stands still: degrees Fahrenheit that nobody calls so are told by it."""

from collections.abc import Sequence

import numpy as np

from sim.lab.recordings.mapping.answers import Answers, Undecided
from sim.lab.recordings.mapping.columns import FoundColumn
from sim.lab.recordings.mapping.words import named_bearing, named_surroundings
from sim.sha import Array, Trace

_MAX_RUNNING_DEGC = 140.0
"""degC above which no bearing's usual running is: the steel of ordinary ones gives way."""
_REST_RANGE = (65.0, 95.0)
"""Degrees Fahrenheit of a heated hall and of a hot one; a rest of so many degC needs a heater."""
_MAX_ROOM_DEGC = 50.0
"""degC that no room of a plant has."""
_LEAST_COOLING = 10.0
"""Degrees below the usual running that a rest must lead to, or it shows nothing."""
_LEAST_REST_S = 3600.0
"""s of a rest, or it does not show where it leads: a bearing first comes to its housing, which is warm for hours."""
_LEAST_READINGS = 8
_LONGEST_RESTS = 5
"""Rests that are looked at."""
_MAX_DRIFT = 0.3
"""Degrees by which the second half of a rest may drift, or it still cools."""


def check_rest(
    where: object,
    temperature: FoundColumn,
    running: str,
    columns: Sequence[FoundColumn],
    traces: Sequence[Trace],
    answers: Answers,
) -> None:
    """Raises Undecided for a bearing without a unit that rests, or stays, where degrees Fahrenheit make more sense.

    Unless a person says so they are degC: a machine may be heated while it rests.
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
    low, high = _REST_RANGE
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
        guess=f"{temperature.header}=degC",
    )


def _rest_levels(times: Array, values: Array, runs: np.ndarray) -> list[float]:
    """Where the longest rests have come to; nothing of one that is short, or has not settled."""
    edges = np.flatnonzero(np.diff(np.concatenate(([True], runs, [True])).astype(np.int8)))
    rests = list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
    rests = [(begin, end) for begin, end in rests if times[end - 1] - times[begin] >= _LEAST_REST_S]
    rests.sort(key=lambda rest: times[rest[0]] - times[rest[1] - 1])
    levels = (_settled_level(times[begin:end], values[begin:end]) for begin, end in rests[:_LONGEST_RESTS])
    return [level for level in levels if level is not None]


def _settled_level(times: Array, values: Array) -> float | None:
    """What a rest's second half stays at; None where it drifts."""
    later = times >= (times[0] + times[-1]) / 2.0
    if np.count_nonzero(later) < _LEAST_READINGS:
        return None
    since = times[later] - times[later][0]
    drift = float(np.polyfit(since, values[later], 1)[0]) * float(since[-1])
    return float(np.median(values[later])) if abs(drift) <= _MAX_DRIFT else None
