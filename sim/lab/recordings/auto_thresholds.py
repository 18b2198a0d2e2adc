"""Thresholds from the readings: levels at which a signal dwells, told apart only where its noise and the data allow.

The levels are the clusters of least squares (Fisher 1958, by dynamic programming; Otsu's thresholds are the same on a
histogram), which for one hump are the Lloyd-Max quantiser and for several lie in the valleys between them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise

import numpy as np

from sim.sha import Alphabet, Array, Bins, Indices, Trace

MAX_LEVELS = 4
"""Bins at most: as many as the plant's own engineers cut. More only share the same data out among more locations."""
_QUANTILE_COUNT = 256
"""Quantiles that stand for a distribution: a few wild readings are none of them."""
_MIN_SHARE = 0.03
_MIN_NOISE_SIGMAS = 3.0
"""Distance of two levels in standard deviations of the noise, below which a threshold would count noise as events."""
_MAX_WITHIN_RATIO = 4 / 3
"""Of the scatter within levels: halves of one even scatter lie 3.5 of their own deviations apart, levels over 4."""
_MAX_MOVE_SHARE = 0.2
"""How far a threshold may move when a tenth of the record is left out, as a share of the distance of its levels."""
_PARTS, _STRETCHES = 10, 50


@dataclass(frozen=True, slots=True)
class AutoBins(Bins):
    """A level signal whose thresholds its readings decide when traces are loaded; until then it is one bin.

    The bins are called `lowest`, then `prefix` + 0, 1, 2 ...; without `lowest` the first is `prefix` + 0. The
    hysteresis follows the noise unless `own_hysteresis`.
    """

    prefix: str = ""
    lowest: str = ""
    own_hysteresis: bool = False

    def make_bins(self, levels: "Levels") -> Bins:
        """The bins that these levels make."""
        first = self.lowest or f"{self.prefix}0"
        start = 0 if self.lowest else 1
        more = (f"{self.prefix}{start + index}" for index in range(len(levels.thresholds)))
        hysteresis = self.hysteresis if self.own_hysteresis else levels.hysteresis
        return Bins(self.signal, levels.thresholds, (first, *more), hysteresis, self.on_change)


@dataclass(frozen=True, slots=True)
class Levels:
    """Thresholds between a signal's levels and a hysteresis above its noise, both in its unit and in round figures.

    No thresholds: it has one level, or its readings scatter as much from one to the next as they do in all.
    """

    thresholds: tuple[float, ...] = ()
    hysteresis: float = 0.0


@dataclass(frozen=True, slots=True)
class AutoGap(Alphabet):
    """An alphabet whose gap follows the recording's own interval when traces are loaded; until then it is the least."""


MIN_GAP_S = 30.0
"""Seconds of silence, at least, after which nothing is known."""
_MIN_STEPS = 10
"""Steps between rows below which nobody knows which is the usual one."""
_STEPS_IN_GAP = 5
"""Of the usual steps between rows: so many lost in a row are no hiccup of the recorder."""


def suitable_gap(traces: Sequence[Trace], interval: float | None = None) -> float:
    """The gap (s) that suits recordings of their usual interval, or of the one given, in round figures."""
    steps = np.concatenate([np.empty(0), *(np.diff(trace.times) for trace in traces)])
    steps = steps[steps > 0]
    usual = interval or (float(np.median(steps)) if steps.size >= _MIN_STEPS else 1.0)
    return max(MIN_GAP_S, round_value(_STEPS_IN_GAP * usual, usual))


def with_gap(alphabet: Alphabet, traces: Sequence[Trace], interval: float | None = None) -> Alphabet:
    """The alphabet with the gap of the traces, where it names none."""
    if not isinstance(alphabet, AutoGap):
        return alphabet
    values = {each.name: getattr(alphabet, each.name) for each in fields(Alphabet)}
    return Alphabet(**values | {"gap": suitable_gap(traces, interval)})


def with_thresholds(alphabet: Alphabet, traces: Sequence[Trace]) -> Alphabet:
    """The alphabet with the thresholds of its AutoBins taken from the traces; itself where it has none."""
    if not any(isinstance(channel, AutoBins) for channel in alphabet.channels):
        return alphabet
    channels = [
        channel.make_bins(find_levels(traces, channel.signal, alphabet.gap))
        if isinstance(channel, AutoBins)
        else channel
        for channel in alphabet.channels
    ]
    return replace(alphabet, channels=tuple(channels))


def with_levels(alphabet: Alphabet, signals: Sequence[str], traces: Sequence[Trace]) -> Alphabet:
    """The alphabet with these level signals in place of its own, each with the thresholds of the traces."""
    levels = [
        AutoBins(signal, (), (f"{chr(ord('A') + place)}_0",), prefix=f"{chr(ord('A') + place)}_")
        for place, signal in enumerate(signals)
    ]
    switches = [channel for channel in alphabet.channels if not isinstance(channel, Bins)]
    return with_thresholds(replace(alphabet, channels=(*switches, *levels)), traces)


def find_levels(traces: Sequence[Trace], signal: str, gap: float) -> Levels:
    """The levels of a signal over all traces; `gap` (s) is the time beyond which a reading says nothing of the next.

    The order of the traces does not matter to the levels. A reading counts for the time until the next one, so that a
    signal which is sent on change counts as one that is polled.
    """
    values, weights, jumps = [np.empty(0)], [np.empty(0)], [np.empty(0)]
    for trace in traces:
        if signal not in trace.signals:
            continue
        known = np.isfinite(trace.signals[signal])
        readings, steps = trace.signals[signal][known], np.diff(trace.times[known])
        usual = float(np.median(steps)) if steps.size else 1.0
        # The last reading, and one before a gap, stand for no more than a usual step.
        values.append(readings)
        weights.append(np.append(np.where(steps > gap, usual, steps), usual))
        jumps.append(np.abs(np.diff(readings))[steps <= gap])
    readings, times = np.concatenate(values), np.concatenate(weights)
    if not readings.size or np.ptp(readings) == 0 or not times.sum() > 0:
        return Levels()
    moved = np.concatenate(jumps)
    # Of steps between readings, most are noise and few are moves: the median knows only the former. 1.4826 makes it a
    # standard deviation; two readings err, hence the root.
    noise = 1.4826 * float(np.median(moved)) / np.sqrt(2.0) if moved.size else 0.0
    # Held values do not move from one row to the next: their noise is the scatter within a level.
    held = noise == 0.0
    parts = np.arange(readings.size) * _STRETCHES // readings.size % _PARTS
    # A million readings are put in order once, not for each number of levels and each part that is left out.
    order = np.argsort(readings, kind="stable")
    whole = _Clusters(_points(readings[order], times[order], times.sum()))
    fewer: dict[int, _Clusters] = {}

    def drop_part(part: int) -> _Clusters:
        if part not in fewer:
            kept = order[parts[order] != part]
            fewer[part] = _Clusters(_points(readings[kept], times[kept], times[parts != part].sum()))
        return fewer[part]

    for count in range(MAX_LEVELS, 1, -1):
        cuts, centres = whole.cut(count)
        apart = np.diff(centres)
        level = np.searchsorted(cuts, readings, side="right")
        shares = np.bincount(level, times, count) / times.sum()
        if held and centres.size == count:
            noise = _MAX_WITHIN_RATIO * float(np.sqrt(np.average((readings - centres[level]) ** 2, weights=times)))
        if cuts.size != count - 1 or shares.min() < _MIN_SHARE or apart.min() < _MIN_NOISE_SIGMAS * noise:
            continue
        others = (drop_part(part).cut(count)[0] for part in range(_PARTS))
        if all(other.size == cuts.size and np.all(np.abs(other - cuts) <= _MAX_MOVE_SHARE * apart) for other in others):
            thresholds = tuple(dict.fromkeys(round_value(float(c), float(apart.min()) / 10) for c in cuts))
            quarter = float(apart.min()) / 4
            return Levels(thresholds, round_value(min(3.0 * noise, quarter), quarter / 10))
    return Levels()


def _points(readings: Array, times: Array, total: float) -> Array:
    """The quantiles of ascending readings that each stand for a time, `total` in all."""
    reached = np.cumsum(times) / total
    return np.asarray(
        readings[
            np.searchsorted(reached, (np.arange(_QUANTILE_COUNT) + 0.5) / _QUANTILE_COUNT).clip(max=readings.size - 1)
        ]
    )


class _Clusters:
    """The clusters of least squares of ascending points, for any number of them: what they share is worked out once."""

    def __init__(self, points: Array) -> None:
        self._points = points
        self._sums, self._squares = (np.concatenate(([0.0], np.cumsum(points**power))) for power in (1, 2))
        self._ends: Indices = np.arange(_QUANTILE_COUNT + 1, dtype=np.intp)
        # [n][j]: the least squared distances of the points before j from the means of n + 1 clusters.
        self._least: list[Array] = [self._cost(self._ends, self._ends[:1])]
        self._all: Array = np.empty(0)
        self._starts = list[Indices]()

    def _cost(self, high: Indices, low: Indices) -> Array:
        """The squared distances of points low..high-1 from their mean."""
        with np.errstate(divide="ignore", invalid="ignore"):
            squares, sums = self._squares[high] - self._squares[low], self._sums[high] - self._sums[low]
            cost = squares - sums**2 / (high - low)
        return np.where(high > low, np.maximum(cost, 0.0), np.inf)

    def cut(self, count: int) -> tuple[Array, Array]:
        """(count - 1 thresholds, count centres), fewer if there are fewer values; count is at least 2."""
        while len(self._least) < count - 1:
            if not self._all.size:
                self._all = self._cost(self._ends[:, None], self._ends)
            total = self._least[-1] + self._all
            self._starts.append(np.argmin(total, axis=1))
            self._least.append(total[self._ends, self._starts[-1]])
        # Of the last step nothing is asked but where the cluster of the greatest begins.
        end = int(np.argmin(self._least[count - 2] + self._cost(self._ends[-1:], self._ends)))
        edges = [_QUANTILE_COUNT, end]
        for start in reversed(self._starts[: count - 2]):
            end = int(start[end])
            edges.append(end)
        edges = [0, *edges[::-1]]
        centres = np.array([self._points[low:high].mean() for low, high in pairwise(edges) if high > low])
        return np.unique((centres[1:] + centres[:-1]) / 2), centres


def round_value(value: float, grain: float) -> float:
    """The value to the next 1, 2 or 5 times a power of ten that is no coarser than `grain`: 97.3 by 6 is 95."""
    if not grain > 0:
        return value
    power = 10.0 ** np.floor(np.log10(grain))
    step = next(factor for factor in (5.0, 2.0, 1.0) if factor * power <= grain * (1 + 1e-9)) * power
    return float(f"{np.round(value / step) * step:.12g}")
