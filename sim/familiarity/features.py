"""What a cycle is like, at points along it: one table of features, the same for whole cycles and for one that grows.

A point looks back over the last half hour or hour, so a cycle that has just begun is compared with the beginnings of
others, and not with whole ones.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import nan

import numpy as np

from sim.sha import Alphabet, Array, Bins, Switch, Trace

POINT_SECONDS = 300.0
"""Seconds between two points of a cycle; its end is a point as well."""
RECENT, HOUR = 1800.0, 3600.0
"""Seconds that features look back over."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CycleView:
    """What was measured up to a point: rows of the last hour, the newest last.

    `ago` (n,) is how long before the point each row was (s), `seconds` (n,) how long it stood. `running` (n,) is 0 or
    1, `load` (n,) the level that is cut into bins (0 where there is none), `idle` the upper end of its lowest bin,
    `temperature` (n,) in degC with NaN where there was no reading. `others` are further temperatures by role. `starts`
    and `events` (k,) are how long ago events were (s).
    """

    ago: Array
    seconds: Array
    running: Array
    load: Array
    idle: float
    temperature: Array
    others: Mapping[str, Array]
    starts: Array
    events: Array

    def recent(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """(n,) the rows of the last half hour."""
        return np.asarray(self.ago <= RECENT)

    def loads(self) -> Array:
        """The level over the last half hour while it ran."""
        return self.load[self.recent() & (self.running > 0.5)]


def _mean(view: CycleView) -> float:
    where = view.recent() & (view.running > 0.5)
    stood = view.seconds[where]
    return float(view.load[where] @ stood / stood.sum()) if stood.sum() > 0 else 0.0


def _warming(view: CycleView) -> float:
    known = view.recent() & np.isfinite(view.temperature)
    readings = view.temperature[known]
    return float(readings[-1] - readings[0]) if readings.size else nan


def _newest(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(known[-1]) if known.size else nan


@dataclass(frozen=True, slots=True, kw_only=True)
class CycleFeature:
    """A row of the table. `words` name it to an operator, with its value in `unit`; `least` is a difference in it that
    means nothing, `shown` what a value is multiplied by for `unit`."""

    value: Callable[[CycleView], float]
    words: str
    unit: str
    least: float
    shown: float = 1.0

    def text(self, value: float) -> str:
        """A value as it is said."""
        return f"{value * self.shown:.3g} {self.unit}".strip()


FEATURES: Mapping[str, CycleFeature] = {
    "load": CycleFeature(value=_mean, words="a mean load of", unit="A", least=5.0),
    "peak": CycleFeature(
        value=lambda view: float(np.quantile(view.loads(), 0.98)) if view.loads().size else 0.0,
        words="a load of up to",
        unit="A",
        least=10.0,
    ),
    "swing": CycleFeature(
        value=lambda view: float(view.loads().std()) if view.loads().size else 0.0,
        words="a load that swings by",
        unit="A",
        least=5.0,
    ),
    "idling": CycleFeature(
        value=lambda view: float(view.seconds[(view.running > 0.5) & (view.load < view.idle)].sum()),
        words="idling for",
        unit="min of the last hour",
        least=180.0,
        shown=1 / 60,
    ),
    "resting": CycleFeature(
        value=lambda view: float(view.seconds[view.running < 0.5].sum()),
        words="standing for",
        unit="min of the last hour",
        least=300.0,
        shown=1 / 60,
    ),
    "dwell": CycleFeature(
        # The first hour only: how much longer nothing happens says nothing more of heat.
        value=lambda view: float(min(view.events.min(initial=HOUR), HOUR)),
        words="no event for",
        unit="min",
        least=300.0,
        shown=1 / 60,
    ),
    "starts": CycleFeature(
        value=lambda view: float(view.starts.size), words="starts in the last hour:", unit="", least=0.7
    ),
    "events": CycleFeature(
        value=lambda view: float(np.count_nonzero(view.events <= RECENT)) / (RECENT / 60.0),
        words="events:",
        unit="a minute",
        least=0.1,
    ),
    "temperature": CycleFeature(
        value=lambda view: _newest(view.temperature), words="a temperature of", unit="°C", least=2.0
    ),
    "warming": CycleFeature(value=_warming, words="a rise of", unit="°C in half an hour", least=1.0),
    "feed": CycleFeature(
        value=lambda view: _newest(view.others.get("feed", np.empty(0))), words="a feed of", unit="°C", least=2.0
    ),
    "ambient": CycleFeature(
        value=lambda view: _newest(view.others.get("ambient", np.empty(0))), words="a hall of", unit="°C", least=2.0
    ),
}


@dataclass(frozen=True, slots=True)
class CyclePoints:
    """The features of a cycle: `times` (P,) in absolute s, `values` (P, F) in the order of FEATURES (NaN: unknown)."""

    times: Array
    values: Array


def cycle_points(
    trace: Trace, alphabet: Alphabet, temperature: str, others: Mapping[str, str], *, begin: float, end: float
) -> CyclePoints:
    """The points from `begin` to `end` (absolute s) of an encoded trace, which may hold an hour before `begin`.

    `others` gives the signal of further temperatures by their role. A short cycle has its end only.
    """
    bins = next((channel for channel in alphabet.channels if isinstance(channel, Bins)), None)
    switch = next((channel for channel in alphabet.channels if isinstance(channel, Switch)), None)
    times = trace.times
    blank = np.full(times.shape, nan)

    def held(name: str | None, otherwise: float) -> Array:
        values = trace.signals.get(name, blank) if name is not None else blank
        known = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(times.size), -1))
        return np.where(known < 0, otherwise, values[known])

    running, load = (
        held(None if switch is None else switch.signal, 1.0),
        held(None if bins is None else bins.signal, 0.0),
    )
    reading = trace.signals.get(temperature, blank)
    further = {role: trace.signals[name] for role, name in others.items() if name in trace.signals}
    # A row stands until the next one, but not over a gap, of which nobody knows.
    stood = np.minimum(np.diff(times, append=times[-1:]), alphabet.gap)
    starts = np.array([e.time for e in trace.events if switch is not None and e.symbol == switch.rising])
    events = np.array([event.time for event in trace.events])
    moments = np.unique(np.append(np.arange(begin + POINT_SECONDS, end, POINT_SECONDS), end))
    rows: list[list[float]] = []
    for moment in moments.tolist():
        span = slice(*np.searchsorted(times, [moment - HOUR, moment + 1e-6]))
        view = CycleView(
            ago=moment - times[span],
            seconds=stood[span],
            running=running[span],
            load=load[span],
            idle=bins.thresholds[0] if bins is not None and bins.thresholds else 0.0,
            temperature=reading[span],
            others={role: values[span] for role, values in further.items()},
            starts=moment - starts[(starts > moment - HOUR) & (starts <= moment)],
            events=moment - events[(events > moment - HOUR) & (events <= moment)],
        )
        rows.append([feature.value(view) for feature in FEATURES.values()])
    return CyclePoints(moments, np.array(rows, dtype=float).reshape(moments.size, len(FEATURES)))
