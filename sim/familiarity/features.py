"""What a cycle is like, at points along it: one table of features, the same for whole cycles and for one that grows.

A point looks back over the last half hour or hour, so a cycle that has just begun is compared with the beginnings of
others, and not with whole ones. Without an hour to look back over there is no point.
"""

from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import floor, isfinite, nan

import numpy as np

from sim.effects import usual_roles
from sim.sha import Alphabet, Array, Bins, Event, Switch, Trace

POINT_SECONDS = 300.0
"""Seconds between two points of a cycle; its end is a point as well."""
RECENT, HOUR = 1800.0, 3600.0
"""Seconds that features look back over."""
ROW_STEP_S = 10.0
"""Seconds of which the first row counts: heat is slow, and memory has to be bounded whatever the period of scans is."""
MIN_COVERED_SHARE = 0.9
"""The share of the hour that must have been read for a point to say anything."""
MAX_CYCLE_S = 86_400.0
"""A machine that is never stopped has a cycle a day."""
MAX_EVENTS = 10_000
"""Events of the last hour that are kept: more are a chattering signal, and strange enough."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CycleView:
    """What was measured up to a point: rows of the last hour, the newest last.

    `ago` (n,) is how long before the point each row was (s), `seconds` (n,) how long it stood. `running` (n,) is 0 or
    1, `load` (n,) the level that is cut into bins (0 where there is none), `idle` the upper end of its lowest bin,
    `temperature` (n,) in degC with NaN where there was no reading. `others` are further temperatures by role. `starts`
    and `events` (k,) are how long ago events were (s), `age` how old the cycle is (s).
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
    age: float

    def recent(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """(n,) the rows of the last half hour."""
        return np.asarray(self.ago <= RECENT)

    def loads(self) -> Array:
        """The level over the last half hour while it ran."""
        return self.load[self.recent() & (self.running > 0.5)]

    def fading_mean(self, values: Array, memory: float) -> float:
        """The mean of values (n,) with weights that fade over `memory` (s)."""
        weight = self.seconds * np.exp(-self.ago / memory)
        return float(values @ weight / weight.sum()) if weight.sum() > 0 else nan


def _mean(view: CycleView) -> float:
    where = view.recent() & (view.running > 0.5)
    stood = view.seconds[where]
    return float(view.load[where] @ stood / stood.sum()) if stood.sum() > 0 else 0.0


def _warming_rate(view: CycleView) -> float:
    known = view.recent() & np.isfinite(view.temperature)
    readings = view.temperature[known]
    return float(readings[-1] - readings[0]) if readings.size else nan


def _newest(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(known[-1]) if known.size else nan


@dataclass(frozen=True, slots=True, kw_only=True)
class CycleFeature:
    """A row of the table; `least` is a difference in it that means nothing. To people a value is told times `shown`,
    with so many `digits`."""

    value: Callable[[CycleView], float]
    least: float
    shown: float = 1.0
    digits: int = 0


FEATURES: Mapping[str, CycleFeature] = {
    "load": CycleFeature(value=_mean, least=5.0),
    "peak": CycleFeature(
        value=lambda view: float(np.quantile(view.loads(), 0.98)) if view.loads().size else 0.0, least=10.0
    ),
    "swing": CycleFeature(value=lambda view: float(view.loads().std()) if view.loads().size else 0.0, least=5.0),
    "idling": CycleFeature(
        value=lambda view: float(view.seconds[(view.running > 0.5) & (view.load < view.idle)].sum()),
        least=180.0,
        shown=1 / 60,
    ),
    "resting": CycleFeature(
        value=lambda view: float(view.seconds[view.running < 0.5].sum()), least=300.0, shown=1 / 60
    ),
    "dwell": CycleFeature(
        # The first hour only: how much longer nothing happens says nothing more of heat.
        value=lambda view: float(min(view.events.min(initial=HOUR), HOUR)),
        least=300.0,
        shown=1 / 60,
    ),
    "starts": CycleFeature(value=lambda view: float(view.starts.size), least=0.7),
    "events": CycleFeature(
        value=lambda view: float(np.count_nonzero(view.events <= RECENT)) / (RECENT / 60.0), least=0.1, digits=2
    ),
    "temperature": CycleFeature(value=lambda view: _newest(view.temperature), least=2.0, digits=1),
    "warming": CycleFeature(value=_warming_rate, least=1.0, digits=1),
    "feed": CycleFeature(value=lambda view: _newest(view.others.get("feed", np.empty(0))), least=2.0, digits=1),
    "ambient": CycleFeature(value=lambda view: _newest(view.others.get("ambient", np.empty(0))), least=2.0, digits=1),
}
"""What is rated, each for itself and together."""

MEMORIES_S = (900.0, 2400.0)
"""Seconds over which a bearing forgets what it was heated by: its time constants lie about them."""


def _fading_feature(power: int, memory: float) -> Callable[[CycleView], float]:
    return lambda view: view.fading_mean(view.running * (view.load / 100.0) ** power, memory)


HISTORY: Mapping[str, Callable[[CycleView], float]] = {
    f"{name} {memory:g} s": _fading_feature(power, memory)
    for memory in MEMORIES_S
    for power, name in enumerate(("running", "load", "load squared", "load cubed"))
} | {
    "running an hour": lambda view: view.fading_mean(view.running, np.inf),
    "temperature before": lambda view: _newest(view.temperature[:60][::-1]),
    "age": lambda view: view.age,
}
"""What the temperature is expected by, and how old the cycle is: nobody calls that strange by itself."""

COLUMNS = (*FEATURES, *HISTORY)
"""The columns of a cycle's points."""


@dataclass(frozen=True, slots=True)
class CyclePoints:
    """The points of a cycle: `times` (P,) in absolute s, `values` (P, C) in the order of COLUMNS (NaN: unknown)."""

    times: Array
    values: Array


@dataclass(frozen=True, slots=True)
class PointSource:
    """Of which signals points are made: the `alphabet` that cuts cycles, the `temperature`, further ones by role."""

    alphabet: Alphabet
    temperature: str
    others: Mapping[str, str]

    @classmethod
    def for_alphabet(
        cls, alphabet: Alphabet, temperature: str, roles: Mapping[str, str] | None = None
    ) -> "PointSource":
        """That of a model of the `temperature`; feed and hall by its `roles`, by the decanter's names for None."""
        named = usual_roles(roles)
        return cls(alphabet, temperature, {role: named[role] for role in ("feed", "ambient") if role in named})

    @property
    def bins(self) -> Bins | None:
        """The level channel, if there is one."""
        return next((channel for channel in self.alphabet.channels if isinstance(channel, Bins)), None)

    @property
    def switch(self) -> Switch | None:
        """The channel whose rising begins a cycle, if there is one."""
        return next((channel for channel in self.alphabet.channels if isinstance(channel, Switch)), None)

    def point(self, rows: Array, starts: Array, events: Array, *, moment: float, begin: float) -> list[float] | None:
        """The values (COLUMNS) at a moment by rows (n, 4 + others) of the hour before it; None where too few were read.

        The columns of `rows` are time, running, load, temperature and the others in their order; `starts` and `events`
        are absolute times.
        """
        times = rows[:, 0]
        # A row stands until the next one, but not over a gap, of which nobody knows.
        seconds = np.minimum(np.diff(times, append=moment), max(self.alphabet.gap, ROW_STEP_S))
        if not times.size or seconds.sum() < MIN_COVERED_SHARE * HOUR:
            return None
        bins = self.bins
        view = CycleView(
            ago=moment - times,
            seconds=seconds,
            running=rows[:, 1],
            load=rows[:, 2],
            idle=bins.thresholds[0] if bins is not None and bins.thresholds else 0.0,
            temperature=rows[:, 3],
            others={role: rows[:, 4 + place] for place, role in enumerate(self.others)},
            starts=moment - starts[(starts > moment - HOUR) & (starts <= moment)],
            events=moment - events[(events > moment - HOUR) & (events <= moment)],
            age=moment - begin,
        )
        return [*(feature.value(view) for feature in FEATURES.values()), *(value(view) for value in HISTORY.values())]


def cycle_points(trace: Trace, source: PointSource, *, begin: float, end: float) -> CyclePoints:
    """The points from `begin` to `end` (absolute s) of an encoded trace, which may hold an hour before `begin`.

    A short cycle has its end only, and one before which no hour was read has none until then.
    """
    times, switch, bins = trace.times, source.switch, source.bins
    blank = np.full(times.shape, nan)

    def hold_column(name: str | None, otherwise: float) -> Array:
        values = trace.signals.get(name, blank) if name is not None else blank
        known = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(times.size), -1))
        return np.where(known < 0, otherwise, values[known])

    columns = [
        times,
        hold_column(None if switch is None else switch.signal, 1.0),
        hold_column(None if bins is None else bins.signal, 0.0),
        *(trace.signals.get(name, blank) for name in (source.temperature, *source.others.values())),
    ]
    kept = np.unique(np.floor(times / ROW_STEP_S), return_index=True)[1]
    rows = np.column_stack(columns)[kept]
    starts = np.array([e.time for e in trace.events if switch is not None and e.symbol == switch.rising])
    events = np.array([event.time for event in trace.events])
    moments = np.unique(np.append(np.arange(begin + POINT_SECONDS, end, POINT_SECONDS), end))
    found: list[tuple[float, list[float]]] = []
    for moment in moments.tolist():
        span = slice(*np.searchsorted(rows[:, 0], [moment - HOUR, moment + 1e-6]))
        point = source.point(rows[span], starts, events, moment=moment, begin=begin)
        if point is not None:
            found.append((moment, point))
    values = np.array([point for _, point in found], dtype=float).reshape(len(found), len(COLUMNS))
    return CyclePoints(np.array([moment for moment, _ in found], dtype=float), values)


@dataclass(frozen=True, slots=True)
class CyclePoint:
    """A point at `time` of the cycle that began at `begin` (absolute s): `values` (C,), None where too little was
    read."""

    begin: float
    time: float
    values: Array | None


class GrowingCycle:
    """The present cycle as it grows: rows in, a point out every POINT_SECONDS of it, the same that `cycle_points` has.

    It keeps a row for each ROW_STEP_S of the last hour and no more. `begin` is the cycle's start (None: none was seen
    yet).
    """

    def __init__(self, source: PointSource) -> None:
        self.source = source
        switch, bins = source.switch, source.bins
        self._switch = None if switch is None else switch.signal
        self._bins = None if bins is None else bins.signal
        self._symbols = () if switch is None else (switch.rising, switch.falling)
        self._signals = (source.temperature, *source.others.values())
        self._forget()

    def _forget(self) -> None:
        self.begin: float | None = None
        self._rows: deque[tuple[float, ...]] = deque(maxlen=int(HOUR / ROW_STEP_S) + 3)
        self._starts: deque[float] = deque(maxlen=MAX_EVENTS)
        self._events: deque[float] = deque(maxlen=MAX_EVENTS)
        self._running, self._load = 1.0, 0.0
        self._last: float | None = None
        self._symbol = ""
        self._place = 0

    def take(self, time: float, readings: Callable[[str], float | None], events: Sequence[Event]) -> CyclePoint | None:
        """Take a row with its events in; the newest point that was due before it, if one was.

        `readings` gives a signal's good reading, None without one.
        """
        if self._last is not None and time < self._last:
            self._forget()  # the clock was set back: nothing that was read can be dated any more
        point = self._due(time)
        if self._last is not None and self.begin is not None and time - self._last > self.source.alphabet.gap:
            self._begin(time)
        for event in events:
            if self._symbols and event.symbol == self._symbols[0]:
                self._starts.append(event.time)
                if self._symbol != event.symbol:
                    self._begin(event.time)
            if event.symbol in self._symbols:
                self._symbol = event.symbol
            self._events.append(event.time)
        if not self._symbols and self.begin is None:
            self._begin(time)
        self._keep(time, readings)
        self._last = time
        return point

    @property
    def row_count(self) -> int:
        """How many rows are in memory."""
        return len(self._rows)

    def at_end(self) -> CyclePoint | None:
        """The point at the newest row, as if the cycle ended there; None before there is a cycle."""
        return None if self.begin is None or self._last is None else self._point(self._last, self.begin)

    def _begin(self, time: float) -> None:
        self.begin, self._place = time, 0

    def _keep(self, time: float, readings: Callable[[str], float | None]) -> None:
        running = None if self._switch is None else readings(self._switch)
        load = None if self._bins is None else readings(self._bins)
        # Held between readings: a switch that is only sent when it changes must not be missed between kept rows.
        self._running = self._running if running is None or not isfinite(running) else running
        self._load = self._load if load is None or not isfinite(load) else load
        if self._rows and floor(time / ROW_STEP_S) == floor(self._rows[-1][0] / ROW_STEP_S):
            return
        others = (readings(name) for name in self._signals)
        self._rows.append((time, self._running, self._load, *(nan if x is None else x for x in others)))

    def _due(self, time: float) -> CyclePoint | None:
        """The newest point that lies before `time`; those before it that nobody was there to see are passed over."""
        if self.begin is None or time <= self.begin + (self._place + 1) * POINT_SECONDS:
            return None
        self._place = int(np.ceil((time - self.begin) / POINT_SECONDS)) - 1
        begin, moment = self.begin, self.begin + self._place * POINT_SECONDS
        if moment - begin >= MAX_CYCLE_S:
            self._begin(moment)
        return self._point(moment, begin)

    def _point(self, moment: float, begin: float) -> CyclePoint:
        rows = np.array(self._rows, dtype=float).reshape(len(self._rows), 4 + len(self.source.others))
        rows = rows[slice(*np.searchsorted(rows[:, 0], [moment - HOUR, moment + 1e-6]))]
        values = self.source.point(rows, _array(self._starts), _array(self._events), moment=moment, begin=begin)
        return CyclePoint(begin, moment, None if values is None else np.array(values))


def _array(times: Iterable[float]) -> Array:
    return np.fromiter(times, dtype=float)
