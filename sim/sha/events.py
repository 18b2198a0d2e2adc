"""The alphabet of events as configuration, and the one encoder that turns samples into events, batch and streaming."""

from bisect import bisect_right
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import inf, isfinite
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sim.sha.trace import UNKNOWN, Array, Event, Mask, Trace


@dataclass(frozen=True, slots=True)
class Switch:
    """A two-valued signal: `rising` at 0 -> 1, `falling` at 1 -> 0. `on_change`: it is only sent when it changes."""

    signal: str
    rising: str
    falling: str
    on_change: bool = True


@dataclass(frozen=True, slots=True)
class Bins:
    """A level signal cut at ascending `thresholds`: entering [thresholds[i-1], thresholds[i]) emits `symbols[i]`.

    One symbol more than thresholds; below the first threshold lies the first symbol, whatever the value. A bin is left
    only when its boundary is crossed by more than `hysteresis` (units of the signal).
    """

    signal: str
    thresholds: tuple[float, ...]
    symbols: tuple[str, ...]
    hysteresis: float = 0.0
    on_change: bool = False


@dataclass(frozen=True, slots=True)
class Alphabet:
    """The channels in the order in which simultaneous events are emitted, and what counts as not knowing.

    `gap` (s): no row for longer, or no reading of a channel that is not `on_change` for longer, is unknown. `debounce`
    (s): a new value must hold this long before its event, which carries the time of the confirmation. `uppaal` maps
    symbols to the channel names of UPPAAL (a__0_100 ...).
    """

    channels: tuple[Switch | Bins, ...]
    gap: float = 30.0
    debounce: float = 0.0
    uppaal: tuple[tuple[str, str], ...] = ()


DECANTER = Alphabet(
    channels=(
        Switch("MarciaDecanter", rising="W_ON", falling="W_OFF"),
        Bins("Assorbimento", thresholds=(100.0, 200.0, 300.0), symbols=("A_0", "A_1", "A_2", "A_3")),
    ),
    uppaal=(
        ("W_ON", "W_ON"),
        ("W_OFF", "W_OFF"),
        ("A_0", "a__0_100"),
        ("A_1", "a__100_200"),
        ("A_2", "a__200_300"),
        ("A_3", "a__300_plus"),
    ),
)

Mode = Literal["filtered", "full"]


@dataclass(frozen=True, slots=True, kw_only=True)
class EncoderState:
    """All that an encoder remembers, one entry a channel in alphabet order; plain values, so that JSON can carry it.

    `row` is the time of the last row, `latest` that of the last row or event. `announced` is the symbol that was last
    told (None: unknown), `seen` the one that the last reading stands for (it differs while a debounce runs), `since`
    when it was first seen and `read` the time of the last good reading.
    """

    row: float | None = None
    latest: float | None = None
    announced: tuple[str | None, ...] = ()
    seen: tuple[str | None, ...] = ()
    since: tuple[float, ...] = ()
    read: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class _ChannelLevels:
    """A channel ready to run: level i is kept while low[i] <= value < high[i]. A switch has two levels, cut at 0.5."""

    signal: str
    symbols: tuple[str, ...]
    thresholds: tuple[float, ...]
    on_change: bool
    low: tuple[float, ...]
    high: tuple[float, ...]

    def level(self, value: float, seen: int | None) -> int:
        if seen is not None and self.low[seen] <= value < self.high[seen]:
            return seen
        return bisect_right(self.thresholds, value)


def _levels(channel: Switch | Bins) -> _ChannelLevels:
    if isinstance(channel, Switch):
        channel = Bins(channel.signal, (0.5,), (channel.falling, channel.rising), on_change=channel.on_change)
    thresholds, hysteresis = channel.thresholds, channel.hysteresis
    low = (-inf, *(threshold - hysteresis for threshold in thresholds))
    high = (*(threshold + hysteresis for threshold in thresholds), inf)
    return _ChannelLevels(
        signal=channel.signal,
        symbols=channel.symbols,
        thresholds=thresholds,
        on_change=channel.on_change,
        low=low,
        high=high,
    )


def alphabet_symbols(alphabet: Alphabet) -> tuple[str, ...]:
    """The symbols of all channels in alphabet order, a switch's rising one first; UNKNOWN is not among them."""
    return tuple(
        symbol
        for channel in alphabet.channels
        for symbol in ((channel.rising, channel.falling) if isinstance(channel, Switch) else channel.symbols)
    )


def _fault_of_bins(bins: Bins) -> str | None:
    if not all(isfinite(threshold) for threshold in bins.thresholds):
        return "its thresholds must be finite numbers"
    for low, high in pairwise(bins.thresholds):
        if not low < high:
            return f"its thresholds must ascend, and {high:g} follows {low:g}"
    if len(bins.symbols) != len(bins.thresholds) + 1:
        return f"{len(bins.thresholds)} thresholds need {len(bins.thresholds) + 1} symbols; it has {len(bins.symbols)}"
    if not (isfinite(bins.hysteresis) and bins.hysteresis >= 0):
        return f"its hysteresis must be 0 or more, in the signal's unit; it is {bins.hysteresis:g}"
    return None


def check_alphabet(alphabet: Alphabet) -> None:
    """Raises ValueError with one sentence that names the channel, the reason and what would be right."""
    if not alphabet.channels:
        raise ValueError("the alphabet has no channel; it needs at least one switch or bins")
    for channel in alphabet.channels:
        if not channel.signal:
            raise ValueError("a channel of the alphabet has no signal; name the tag that it watches")
        fault = _fault_of_bins(channel) if isinstance(channel, Bins) else None
        if fault:
            raise ValueError(f"the alphabet's channel {channel.signal!r}: {fault}")
    symbols = alphabet_symbols(alphabet)
    for symbol, count in Counter(symbols).items():
        if count > 1:
            raise ValueError(f"the alphabet has the symbol {symbol!r} {count} times; each symbol must be there once")
        if symbol == UNKNOWN or not symbol or symbol != symbol.strip():
            raise ValueError(f"the alphabet's symbol {symbol!r} is empty, padded or reserved; choose another")
    if not alphabet.gap > 0:
        raise ValueError(f"the alphabet's gap must be more than 0 s; it is {alphabet.gap:g}")
    if not (isfinite(alphabet.debounce) and alphabet.debounce >= 0):
        raise ValueError(f"the alphabet's debounce must be 0 s or more; it is {alphabet.debounce:g}")
    strange = next((symbol for symbol, _ in alphabet.uppaal if symbol not in symbols), None)
    if strange is not None:
        raise ValueError(f"the alphabet's uppaal names {strange!r}, which is none of its symbols {', '.join(symbols)}")


class Encoder:
    """Rows of readings in, events out. What is not known is said once, by UNKNOWN, and never held over.

    The rules, the same ones for a row at a time and for a whole trace:

    - Each known channel announces its symbol when it becomes known and when it changes, once it has held for `debounce`
      seconds: the event bears the time of the row that confirmed it. A channel that is `on_change` needs no second
      reading; its event bears the time at which the debounce was over.
    - A bad reading makes its channel unknown at once. No row for more than `gap` seconds makes all channels unknown, no
      reading of a channel that is not `on_change` for as long makes that channel unknown; the event bears the time at
      which knowledge ended (last row or reading + gap), whoever notices it first: the next row or `tick`.
    - When a channel that had been announced becomes unknown: UNKNOWN, then the channels still known, in alphabet order.
    - Events of one time and row come in alphabet order. Rows of several devices must be put in order, and readings of
      one time into one row, before they get here.
    - A row whose time lies before the last row or event says that the clock was set back: nothing that was known can
      be dated any more, so UNKNOWN at the row's own time, and on from there. It is the only way in which event times
      can go back.
    - `full` adds to each row that has no event of its own the symbol that is present: of the first known level
      channel, else of the first known channel, else UNKNOWN.

    Raises ValueError for an unusable alphabet, for a state that belongs to another one, and for a time or mode that
    makes no sense; never for a reading.
    """

    __slots__ = (
        "_announced",
        "_channels",
        "_debounce",
        "_full",
        "_gap",
        "_latest",
        "_levels_first",
        "_read",
        "_row",
        "_seen",
        "_since",
    )

    def __init__(self, alphabet: Alphabet, mode: Mode = "filtered", state: EncoderState | None = None) -> None:
        check_alphabet(alphabet)
        if mode not in ("filtered", "full"):
            raise ValueError(f"the encoding mode is {mode!r}; it must be 'filtered' or 'full'")
        self._channels = tuple(_levels(channel) for channel in alphabet.channels)
        self._levels_first = sorted(
            range(len(self._channels)), key=lambda index: isinstance(alphabet.channels[index], Switch)
        )
        self._gap, self._debounce, self._full = alphabet.gap, alphabet.debounce, mode == "full"
        count = len(self._channels)
        nothing, never = (None,) * count, (0.0,) * count
        saved = state or EncoderState(announced=nothing, seen=nothing, since=never, read=never)
        if not len(saved.announced) == len(saved.seen) == len(saved.since) == len(saved.read) == count:
            raise ValueError(f"the encoder's state has {len(saved.announced)} channels, its alphabet {count}")
        self._row, self._latest = saved.row, saved.latest
        self._announced = [self._symbol_level(index, symbol) for index, symbol in enumerate(saved.announced)]
        self._seen = [self._symbol_level(index, symbol) for index, symbol in enumerate(saved.seen)]
        self._since, self._read = list(saved.since), list(saved.read)

    def _symbol_level(self, channel: int, symbol: str | None) -> int | None:
        symbols = self._channels[channel].symbols
        if symbol is not None and symbol not in symbols:
            raise ValueError(f"the encoder's state names {symbol!r}; channel {channel + 1} has {', '.join(symbols)}")
        return None if symbol is None else symbols.index(symbol)

    @property
    def state(self) -> EncoderState:
        """What is remembered now; an encoder that is given it goes on as this one would."""
        channels = self._channels
        return EncoderState(
            row=self._row,
            latest=self._latest,
            announced=tuple(
                None if i is None else c.symbols[i] for c, i in zip(channels, self._announced, strict=True)
            ),
            seen=tuple(None if i is None else c.symbols[i] for c, i in zip(channels, self._seen, strict=True)),
            since=tuple(self._since),
            read=tuple(self._read),
        )

    @property
    def known(self) -> bool:
        """Whether something is known of every channel."""
        return None not in self._announced

    def feed(self, time: float, readings: Mapping[str, float | None]) -> list[Event]:
        """The events of one row. A signal that is absent has no new reading; None, NaN and inf are of bad quality."""
        if not isfinite(time):
            raise ValueError(f"a row's time must be a finite number of seconds; it is {time}")
        if self._latest is not None and time < self._latest:
            unknown: list[int | None] = [None] * len(self._channels)
            self._announced, self._seen = unknown, unknown.copy()
            events = [Event(time, UNKNOWN)]
        else:
            events = self._advance(time)  # what time alone brought before this row
        self._row = self._latest = time
        of_this_row = self._take(time, readings)
        if self._full and not of_this_row:
            of_this_row = [Event(time, self._present())]
        return events + of_this_row

    def tick(self, time: float) -> list[Event]:
        """The events that the passing of time alone brings before `time`; earlier than the last row: none."""
        if not isfinite(time):
            raise ValueError(f"a tick's time must be a finite number of seconds; it is {time}")
        return self._advance(time)

    def _take(self, time: float, readings: Mapping[str, float | None]) -> list[Event]:
        lost, changed = False, []
        for index, channel in enumerate(self._channels):
            if channel.signal in readings:
                value = readings[channel.signal]
                if value is None or not isfinite(value):
                    lost |= self._announced[index] is not None
                    self._announced[index] = self._seen[index] = None
                    continue
                level = channel.level(value, self._seen[index])
                self._read[index] = time
                if level != self._seen[index]:
                    self._seen[index], self._since[index] = level, time
            elif not channel.on_change:
                continue
            if self._seen[index] != self._announced[index] and time >= self._since[index] + self._debounce:
                self._announced[index] = self._seen[index]
                changed.append(index)
        return self._lose_state(time) if lost else [self._event(time, index) for index in changed]

    def _event(self, time: float, index: int) -> Event:
        level = self._announced[index]
        return Event(time, UNKNOWN if level is None else self._channels[index].symbols[level])

    def _lose_state(self, time: float) -> list[Event]:
        known = [index for index, level in enumerate(self._announced) if level is not None]
        return [Event(time, UNKNOWN), *(self._event(time, index) for index in known)]

    def _present(self) -> str:
        known = (index for index in self._levels_first if self._announced[index] is not None)
        return next((self._event(0.0, index).symbol for index in known), UNKNOWN)

    def _deadlines(self) -> list[tuple[float, bool, int]]:
        """What time alone will do, as (when, whether knowledge is lost then, channel)."""
        deadlines = []
        for index, channel in enumerate(self._channels):
            if self._seen[index] is None or self._row is None:
                continue
            deadlines.append(((self._row if channel.on_change else self._read[index]) + self._gap, True, index))
            # A channel that is read all the time is confirmed by a reading, one that is sent on change by time alone.
            if channel.on_change and self._seen[index] != self._announced[index]:
                deadlines.append((self._since[index] + self._debounce, False, index))
        return deadlines

    def _advance(self, time: float) -> list[Event]:
        # One deadline's group at a time, earliest first, because each may move the others: a channel that is lost has
        # no debounce left. At one instant the debounces come first (False sorts before True).
        events: list[Event] = []
        while due := [deadline for deadline in self._deadlines() if deadline[0] < time]:
            when, losing = min(due)[:2]
            group = [index for other, lost, index in due if (other, lost) == (when, losing)]
            was_known = any(self._announced[index] is not None for index in group)
            for index in group:
                if losing:
                    self._announced[index] = self._seen[index] = None
                else:
                    self._announced[index] = self._seen[index]
            self._latest = when
            if not losing:
                events += [self._event(when, index) for index in group]
            elif was_known:
                events += self._lose_state(when)
        return events

    def skip_rows(self, time: float, read: Sequence[float | None]) -> str:
        """Rows up to `time` that could change nothing went by; `read` is when each channel was last read among them.

        Returns the symbol that is present meanwhile. For `encode`, which knows that nothing could change.
        """
        self._row = self._latest = time
        self._read = [old if new is None else new for old, new in zip(self._read, read, strict=True)]
        return self._present()


def encode(trace: Trace, alphabet: Alphabet, mode: Mode = "filtered") -> tuple[Event, ...]:
    """The events of a whole trace: what an Encoder fed row by row would say, in the time of a few array passes.

    Only rows at which something can change are given to the Encoder. A signal that the trace lacks is never known.
    """
    encoder = Encoder(alphabet, mode)
    if not trace.times.size:
        return ()
    columns: list[_Column] = []
    for channel in map(_levels, alphabet.channels):
        values = trace.signals.get(channel.signal, np.full(trace.times.shape, np.nan))
        bad = trace.bad.get(channel.signal, np.zeros(trace.times.shape, dtype=bool)) | np.isinf(values)
        columns.append(_Column(channel, bad | ~np.isnan(values), np.where(bad, np.nan, values)))
    rows = _rows_that_matter(trace.times, columns, alphabet)
    stamps = trace.times[rows].tolist()
    readings = [(c.channel.signal, c.has_reading[rows].tolist(), c.values[rows].tolist()) for c in columns]
    reads = list(zip(*(_previous_readings(c, trace.times, rows) for c in columns), strict=True))
    events: list[Event] = []
    previous = -1
    for position, row in enumerate(rows.tolist()):
        if row > previous + 1:
            symbol = encoder.skip_rows(float(trace.times[row - 1]), reads[position])
            if mode == "full":
                events += [Event(time, symbol) for time in trace.times[previous + 1 : row].tolist()]
        fresh = {signal: values[position] for signal, read, values in readings if read[position]}
        events += encoder.feed(stamps[position], fresh)
        previous = row
    return tuple(events)


def encode_trace(trace: Trace, alphabet: Alphabet) -> Trace:
    """The trace with the events that a model of this `alphabet` sees in it, whatever encoded it before.

    Whoever brings a trace to a model takes its events from here. Those that it has are kept only where they cannot be
    made of its signals: it lacks that of a channel of which it has events, and none of them is foreign to the alphabet.
    An alphabet without channels, as of artefacts that name none, leaves the trace as it is.
    """
    lacking = replace(
        alphabet, channels=tuple(channel for channel in alphabet.channels if channel.signal not in trace.signals)
    )
    given = {event.symbol for event in trace.events}
    stated = given <= {*alphabet_symbols(alphabet), UNKNOWN}
    if not alphabet.channels or (stated and not given.isdisjoint(alphabet_symbols(lacking))):
        return trace
    return replace(trace, events=encode(trace, alphabet))


@dataclass(frozen=True, slots=True)
class _Column:
    """A channel's readings in a trace: rows in which it has a reading; its values, NaN where they are bad."""

    channel: _ChannelLevels
    has_reading: Mask
    values: Array


def _previous_readings(column: _Column, times: Array, rows: NDArray[np.intp]) -> list[float | None]:
    """When the channel was last read well before each of `rows`; None if never."""
    last = np.maximum.accumulate(np.where(np.isnan(column.values), -1, np.arange(times.size)))
    before = np.where(rows > 0, last[rows - 1], -1)
    return [None if row < 0 else time for row, time in zip(before.tolist(), times[before].tolist(), strict=True)]


def _rows_that_matter(times: Array, columns: Sequence[_Column], alphabet: Alphabet) -> NDArray[np.intp]:
    """Rows at which an Encoder may do more than note the time; a few too many, never one too few."""
    after_gap = np.zeros(times.shape, dtype=bool)
    after_gap[1:] = times[1:] > times[:-1] + alphabet.gap
    matter = after_gap.copy()
    matter[[0, -1]] = True
    stretch = np.cumsum(after_gap)
    for column in columns:
        rows, channel = np.flatnonzero(column.has_reading), column.channel
        if not rows.size:
            continue
        values, at = column.values[rows], times[rows]
        # The level that a reading leads to depends on the level before and on the cell between the cuts in which it
        # lies, and a second reading in the same cell changes nothing: only the first reading in a cell matters, or
        # after a bad one (cell -1), or after a gap. Then come the rows at which a debounce or the readings' age runs
        # out.
        cuts = np.unique([channel.thresholds, channel.low[1:], channel.high[:-1]])
        cell = np.where(np.isnan(values), -1, np.searchsorted(cuts, values, side="right"))
        new = np.ones(rows.shape, dtype=bool)
        new[1:] = (cell[1:] != cell[:-1]) | (stretch[rows[1:]] != stretch[rows[:-1]])
        if not channel.on_change:
            until = at + alphabet.gap
            stale = np.append(at[1:], inf) > until
            new[1:] |= stale[:-1]
            _mark_rows(matter, np.searchsorted(times, until[stale], side="right"))
        matter[rows[new]] = True
        if alphabet.debounce > 0:
            # A confirmation falls on the first row at or after its time, and on the channel's own first reading there.
            confirmed = at[new] + alphabet.debounce
            _mark_rows(matter, np.searchsorted(times, confirmed, side="left"))
            reading = np.searchsorted(at, confirmed, side="left")
            matter[rows[reading[reading < rows.size]]] = True
    return np.flatnonzero(matter)


def _mark_rows(matter: Mask, rows: NDArray[np.intp]) -> None:
    """Mark `rows`, which may lie past the end."""
    matter[rows[rows < matter.size]] = True
