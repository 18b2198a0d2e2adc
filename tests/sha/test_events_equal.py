"""Batch == streaming == a reference that was written from the rules alone, whatever the rows look like."""

import dataclasses
import json
from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.sha.events import Alphabet, Bins, Encoder, EncoderState, Mode, Switch, alphabet_symbols, encode
from sim.sha.trace import UNKNOWN, Event, Trace

Row = tuple[float, dict[str, float | None]]

SILENT, BAD = "silent", "bad"
MODES = st.sampled_from(["filtered", "full"])


def _level(thresholds: tuple[float, ...], hysteresis: float, value: float, seen: int | None) -> int:
    """The level by its definition: stay inside the widened band, else the bin that holds the value."""
    if seen is not None:
        above = seen == 0 or value >= thresholds[seen - 1] - hysteresis
        below = seen == len(thresholds) or value < thresholds[seen] + hysteresis
        if above and below:
            return seen
    return sum(value >= threshold for threshold in thresholds)


def _channel_instants(rows: list[Row], channel: Switch | Bins, alphabet: Alphabet) -> dict[tuple, str | None]:
    """What happens to one channel alone: (row, phase, time, 1 if lost) -> its new symbol, None when it is lost."""
    if isinstance(channel, Switch):
        cuts, hysteresis, names = (0.5,), 0.0, (channel.falling, channel.rising)
    else:
        cuts, hysteresis, names = channel.thresholds, channel.hysteresis, channel.symbols
    found: dict[tuple, str | None] = {}
    seen: int | None = None
    told: int | None = None
    since = read = 0.0
    for index, (time, readings) in enumerate(rows):
        if seen is not None:
            end = (rows[index - 1][0] if channel.on_change else read) + alphabet.gap
            over = since + alphabet.debounce
            if channel.on_change and seen != told and over < time and over <= end:
                told = seen
                found[(index, 0, over, 0)] = names[told]
            if end < time:
                if told is not None:
                    found[(index, 0, end, 1)] = None
                seen = told = None
        if channel.signal in readings:
            value = readings[channel.signal]
            if value is None:
                if told is not None:
                    found[(index, 1, time, 0)] = None
                seen = told = None
                continue
            level = _level(cuts, hysteresis, value, seen)
            if level != seen:
                seen, since = level, time
            read = time
        elif not channel.on_change:
            continue
        if seen is not None and seen != told and time >= since + alphabet.debounce:
            told = seen
            found[(index, 1, time, 0)] = names[told]
    return found


def reference(rows: list[Row], alphabet: Alphabet, mode: Mode) -> list[Event]:
    """Merge what happens to each channel alone into events."""
    alone = [_channel_instants(rows, channel, alphabet) for channel in alphabet.channels]
    instants = {key for found in alone for key in found}
    if mode == "full":
        instants |= {(index, 1, time, 0) for index, (time, _) in enumerate(rows)}
    present: list[str | None] = [None] * len(alone)
    levels = [index for index, channel in enumerate(alphabet.channels) if isinstance(channel, Bins)]
    switches = [index for index, channel in enumerate(alphabet.channels) if isinstance(channel, Switch)]
    events: list[Event] = []
    for key in sorted(instants):
        changes = {index: found[key] for index, found in enumerate(alone) if key in found}
        for index, symbol in changes.items():
            present[index] = symbol
        if None in changes.values():
            events.append(Event(key[2], UNKNOWN))
            events += [Event(key[2], symbol) for symbol in present if symbol is not None]
        else:
            events += [Event(key[2], symbol) for symbol in changes.values() if symbol is not None]
        if mode == "full" and key[1] == 1 and not changes:
            known = [present[index] for index in levels + switches if present[index] is not None]
            events.append(Event(key[2], known[0] or "" if known else UNKNOWN))
    return events


@st.composite
def alphabets(draw: st.DrawFn) -> Alphabet:
    channels = [
        Switch("run", rising="ON", falling="OFF", on_change=draw(st.booleans())),
        Bins(
            "level",
            thresholds=(10.0, 20.0, 30.0),
            symbols=("L0", "L1", "L2", "L3"),
            hysteresis=draw(st.sampled_from([0.0, 2.0, 12.0])),
            on_change=draw(st.booleans()),
        ),
        Bins("side", thresholds=(1.0,), symbols=("S0", "S1"), on_change=draw(st.booleans())),
    ]
    order = draw(st.permutations(channels))
    kept = draw(st.integers(min_value=1, max_value=3))
    return Alphabet(tuple(order[:kept]), gap=5.0, debounce=draw(st.sampled_from([0.0, 0.0, 1.0, 2.5, 7.0])))


LEVELS = st.one_of(
    st.sampled_from([-2.0, 8.0, 9.9, 10.0, 12.0, 18.0, 20.0, 21.9, 22.0, 30.0, 32.0, 42.0]), st.floats(-50.0, 80.0)
)
CELLS = {"run": st.sampled_from([0.0, 1.0]), "level": LEVELS, "side": st.sampled_from([0.0, 2.0])}


@st.composite
def runs(draw: st.DrawFn, cells: st.SearchStrategy[float], rows: int) -> list[float | str]:
    """Cells as plants give them: the same again and again, or silence, for some rows; now and then a bad one."""
    column: list[float | str] = []
    while len(column) < rows:
        cell = draw(st.one_of(cells, cells, st.just(SILENT), st.just(BAD)))
        column += [cell] * draw(st.sampled_from([1, 1, 2, 4, 9]))
    return column[:rows]


@st.composite
def traces(draw: st.DrawFn) -> Trace:
    pace = draw(st.sampled_from([[1.0, 1.0, 2.5], [0.0, 0.5, 1.0, 1.0, 5.0, 5.5], [1.0, 1.0, 1.0, 12.0]]))
    steps = draw(st.lists(st.sampled_from(pace), min_size=0, max_size=40))
    n = len(steps)
    signals, bad = {}, {}
    for name in sorted(draw(st.sets(st.sampled_from(sorted(CELLS)), min_size=1))):
        cells = draw(runs(CELLS[name], n))
        signals[name] = np.array([np.nan if isinstance(c, str) else c for c in cells], dtype=float)
        bad[name] = np.array([c == BAD for c in cells], dtype=bool)
    return Trace("t", 100.0 + np.cumsum(np.array(steps, dtype=float)), signals, bad=bad)


def rows_of(trace: Trace) -> list[Row]:
    rows: list[Row] = []
    for index, time in enumerate(trace.times.tolist()):
        readings: dict[str, float | None] = {}
        for name, column in trace.signals.items():
            if name in trace.bad and trace.bad[name][index]:
                readings[name] = None
            elif not np.isnan(column[index]):
                readings[name] = float(column[index])
        rows.append((time, readings))
    return rows


@settings(max_examples=200, deadline=None)
@given(traces(), alphabets(), MODES)
def test_batch_equals_streaming_equals_the_reference(trace: Trace, alphabet: Alphabet, mode: Mode) -> None:
    rows = rows_of(trace)
    encoder = Encoder(alphabet, mode)
    streamed = [event for time, readings in rows for event in encoder.feed(time, readings)]
    assert streamed == reference(rows, alphabet, mode)
    assert list(encode(trace, alphabet, mode)) == streamed


@settings(max_examples=100, deadline=None)
@given(traces(), alphabets(), MODES, st.data())
def test_a_restart_between_any_two_rows_and_ticks_at_any_time_change_nothing(
    trace: Trace, alphabet: Alphabet, mode: Mode, data: st.DataObject
) -> None:
    encoder = Encoder(alphabet, mode)
    told: list[Event] = []
    last = None
    for time, readings in rows_of(trace):
        if last is not None and data.draw(st.booleans()):
            for share in sorted(data.draw(st.lists(st.floats(0.0, 1.0), max_size=3))):
                told += encoder.tick(min(last + share * (time - last), time))
        if data.draw(st.booleans()):
            saved = json.loads(json.dumps(dataclasses.asdict(encoder.state)))
            fields = {name: tuple(value) if isinstance(value, list) else value for name, value in saved.items()}
            encoder = Encoder(alphabet, mode, EncoderState(**fields))
        told += encoder.feed(time, readings)
        last = time
    assert told == list(encode(trace, alphabet, mode))


@settings(max_examples=75, deadline=None)
@given(traces(), alphabets())
def test_events_never_go_back_in_time_and_name_only_symbols_of_the_alphabet(trace: Trace, alphabet: Alphabet) -> None:
    events = encode(trace, alphabet)
    assert all(early.time <= late.time for early, late in pairwise(events))
    assert {event.symbol for event in events} <= {*alphabet_symbols(alphabet), UNKNOWN}


@settings(max_examples=50, deadline=None)
@given(traces(), alphabets())
def test_full_has_the_filtered_events_and_at_least_one_a_row(trace: Trace, alphabet: Alphabet) -> None:
    filtered, full = encode(trace, alphabet), list(encode(trace, alphabet, "full"))
    assert {event.time for event in full} >= set(trace.times.tolist())
    rest = iter(full)
    assert all(event in rest for event in filtered), "the filtered events are a subsequence of the full ones"
