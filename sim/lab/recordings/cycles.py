"""Traces cut into cycles: from one start of the machine to the next, and at gaps where that is asked for."""

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from math import ceil, inf

import numpy as np

from sim.sha import DECANTER, UNKNOWN, Alphabet, Event, Switch, Trace


def split_cycles(
    trace: Trace,
    alphabet: Alphabet = DECANTER,
    gap: float = inf,
    lead: bool = False,
    *,
    at: Sequence[float] = (),
    longest: float = inf,
) -> list[Trace]:
    """The cycles of an encoded trace: each goes from a start to the next one, or to the first row after a gap.

    A start is the rising symbol of the alphabet's first switch, unless the last that was heard of that switch was also
    rising: after "unknown" it only says that the machine still runs. Rows more than `gap` seconds apart are not in one
    cycle; what follows them is a cycle of its own. `lead` gives the rows before the first start too. It is also cut at
    the moments `at` (s), and every `longest` s where nothing else cuts. A cycle's events
    begin with what was known at its cut, in alphabet order, as an encoder's would that started there. Each is named
    trace-1, trace-2 ... Raises ValueError when the alphabet has no switch.
    """
    switch = next((channel for channel in alphabet.channels if isinstance(channel, Switch)), None)
    if switch is None:
        raise ValueError("the alphabet has no switch: nothing says when a cycle begins")
    if not trace.times.size:
        return []
    starts, last = list[float](), ""
    for event in trace.events:
        if event.symbol == switch.rising and last != switch.rising:
            starts.append(event.time)
        if event.symbol in (switch.rising, switch.falling):
            last = event.symbol
    after = (np.flatnonzero(np.diff(trace.times) > gap) + 1).tolist()
    breaks = [float(trace.times[row]) for row in after]
    cuts = sorted({*starts, *breaks, *([float(trace.times[0])] if lead else [])})
    if not lead:
        cuts = [cut for cut in cuts if starts and cut >= starts[0]]
    cuts = sorted({*cuts, *at})
    if longest < inf:
        ends = [*cuts[1:], float(trace.times[-1])]
        cuts = [
            cut + longest * part
            for cut, end in zip(cuts, ends, strict=True)
            for part in range(max(ceil((end - cut) / longest), 1))
        ]
    times = [event.time for event in trace.events]
    bounds = [*(bisect_left(times, cut) for cut in cuts), len(times)]
    channels = {
        symbol: place
        for place, channel in enumerate(alphabet.channels)
        for symbol in ((channel.rising, channel.falling) if isinstance(channel, Switch) else channel.symbols)
    }
    # What was said before the first cut still holds at it: a level that never changed is announced in the first cycle.
    known: dict[int, str] = {}
    _learn(known, trace.events[: bounds[0]], channels)
    silent, pieces = replace(trace, events=()), []
    for number, (start, end) in enumerate(pairwise([*cuts, inf])):
        own = trace.events[bounds[number] : bounds[number + 1]]
        piece = silent.between(start, end)
        name = f"{trace.name}-{number + 1}"
        pieces.append(replace(piece, name=name, events=_announce_state(start, known, own, channels)))
        _learn(known, own, channels)
    return pieces


def _learn(known: dict[int, str], events: Sequence[Event], channels: Mapping[str, int]) -> None:
    """Bring what is known of each channel up to date with `events`."""
    for event in events:
        if event.symbol == UNKNOWN:
            known.clear()
        elif event.symbol in channels:
            known[channels[event.symbol]] = event.symbol


def _announce_state(
    start: float, known: Mapping[int, str], own: tuple[Event, ...], channels: Mapping[str, int]
) -> tuple[Event, ...]:
    """A piece's own events after what was known at its start and is not told there anew, in alphabet order."""
    first = [event for event in own if event.time == start]
    if any(event.symbol == UNKNOWN or event.symbol not in channels for event in first):
        return own
    fresh = {channels[event.symbol] for event in first}
    kept = [Event(start, symbol) for place, symbol in known.items() if place not in fresh]
    return (*sorted([*kept, *first], key=lambda event: channels[event.symbol]), *own[len(first) :])
