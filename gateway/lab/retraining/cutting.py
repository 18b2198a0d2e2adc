"""The historian cut into cycles, a day or two at a time, each rated against the model that runs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from math import inf, nan, nextafter
from pathlib import Path

import numpy as np

from gateway.lab.familiar import LEAST, features_of, free_run_error, strange_words
from gateway.lab.retraining.cycle_library import CycleLibrary, CycleRow, Rating
from gateway.store import newest_scan, oldest_scan, reading, to_trace
from sim.familiarity import LONGEST, FamiliarityReference
from sim.sha import Array, Bins, Model, Switch, Trace, content_hash, encode
from sim.traces import split_cycles

Progress = Callable[[str, float], None]
SPAN = 2 * 86_400.0
"""Seconds of the historian that are in memory at a time."""
BEFORE = 3600.0
"""What is read before a piece: features look back as far."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CycleSource:
    """Where cycles come from: a `machine` of the `historian` (None: its only one), by the alphabet of a `model`.

    `version` names that model in the rows; `since` (s UTC) is from when a library begins that is new.
    """

    historian: Path
    machine: str | None
    model: Model
    version: str
    since: float


def cut_new(
    library: CycleLibrary, source: CycleSource, reference: FamiliarityReference | None, report: Progress
) -> int:
    """Cut what the historian has beyond the library's cursor; how many cycles came. Those that teach are kept.

    A cycle that is not over waits for the next time. Raises HistorianError.
    """
    with reading(source.historian) as connection:
        last = newest_scan(connection, machine=source.machine)
        first = oldest_scan(connection, machine=source.machine)
    if last is None or first is None:
        return 0
    cursor = library.fact("cursor")
    cursor = max(source.since if cursor is None else float(cursor), first)
    begin, count = cursor, 0
    difficult = [row.points for row in library.cycles() if row.rating == "badly predicted"]
    while cursor < last:
        report("cutting the historian into cycles", (cursor - begin) / max(last - begin, 1.0))
        until = min(cursor + SPAN, nextafter(last, inf))
        pieces, chunk = _pieces(source, cursor, until)
        at_end = until > last
        after = until
        if pieces:
            begun, last_row = float(pieces[-1].times[0]), float(pieces[-1].times[-1])
            # The last one may go on: it is cut when its end is known. One that a gap has ended does not.
            if until - last_row <= source.model.alphabet.gap and last_row - begun < LONGEST:
                pieces.pop()
                after = begun
        rows: list[CycleRow] = []
        closed = {piece.name: _closed(piece, chunk, source.model.alphabet.gap) for piece in pieces}
        for piece in pieces:
            row = _rated(
                source, piece, closed=closed[piece.name], chunk=chunk, reference=reference, difficult=difficult
            )
            if row is None:
                continue
            rows.append(row)
            if row.rating == "badly predicted":
                difficult.append(row.points)
        count += len(rows)
        library.add(rows, after)
        # After their rows: a kill between the two leaves a row without readings, which the historian still has.
        for row in rows:
            if row.rating != "ordinary":
                library.keep(row.name, closed[row.name])
        if at_end:
            break
        cursor = after
    return count


def _pieces(source: CycleSource, start: float, end: float) -> tuple[list[Trace], Trace]:
    """The cycles that begin from `start` to `end`, and all that was read, an hour before included; encoded."""
    machine, alphabet = source.machine, source.model.alphabet
    chunk = to_trace(source.historian, start=start - BEFORE, end=end, machine=machine)
    if chunk.times.size < 2:
        return [], chunk
    chunk = replace(chunk, machine=machine or "")
    lacking = [channel.signal for channel in alphabet.channels if channel.signal not in chunk.signals]
    if lacking:
        raise ValueError(f"{source.historian}: has no tag {lacking[0]!r}, which the model's events are made of")
    chunk = replace(chunk, events=encode(chunk, alphabet))
    found = split_cycles(chunk, alphabet, gap=alphabet.gap)
    named = [replace(piece, name=_name(machine, piece)) for piece in found if piece.times.size]
    return [piece for piece in named if piece.times[0] >= start], chunk


def _closed(cycle: Trace, chunk: Trace, gap: float) -> Trace:
    """The cycle with the row that ended it, the first of the next one, without events; itself where a gap ended it.

    Without that row no rest would ever be seen to end where the next cycle is not learned from too.
    """
    begin, last = float(cycle.times[0]), float(cycle.times[-1])
    later = chunk.times[np.searchsorted(chunk.times, last, side="right") :]
    end = float(later[0]) if later.size and later[0] - last <= gap else last
    return replace(chunk.between(begin, nextafter(end, inf)), name=cycle.name, events=())


def _name(machine: str | None, cycle: Trace) -> str:
    moment = datetime.fromtimestamp(float(cycle.times[0]), UTC).strftime("%Y%m%dT%H%M%SZ")
    return f"{machine}-{moment}" if machine else moment


def cycle_of(source: CycleSource, row: CycleRow, library: CycleLibrary) -> Trace | None:
    """The readings of a cycle, not encoded: those that were kept, else the historian's; None where neither has them."""
    if row.kept:
        return library.readings(row.content)
    found = to_trace(source.historian, start=row.begin, end=nextafter(row.until, inf), machine=source.machine)
    trace = replace(found, name=row.name, machine=source.machine or "")
    return trace if content_hash(trace) == row.content else None


def and_after(source: CycleSource, cycle: Trace, seconds: float) -> Trace:
    """The readings of a cycle, with what the historian has of the `seconds` after it; itself where that has it no more.

    Whoever judges forecasts needs it: of those that were made before the end of a rest, the outcome of one that went on
    lies in its cycle and that of one that soon ended in the next. Without these a model by which rests never end is the
    better one.
    """
    begin, last = float(cycle.times[0]), float(cycle.times[-1])
    found = to_trace(source.historian, start=begin, end=nextafter(last + seconds, inf), machine=source.machine)
    if content_hash(found.between(begin, nextafter(last, inf))) != content_hash(cycle):
        return cycle
    return replace(found, name=cycle.name, machine=cycle.machine)


def _rated(
    source: CycleSource,
    cycle: Trace,
    *,
    closed: Trace,
    chunk: Trace,
    reference: FamiliarityReference | None,
    difficult: Sequence[Array],
) -> CycleRow | None:
    """The row of a cycle, whose readings are those of `closed`; None for one with too few readings."""
    model = source.model
    measured = cycle.signals.get(model.temperature)
    if measured is None or np.count_nonzero(np.isfinite(measured)) < LEAST:
        return None
    begin, until = float(cycle.times[0]), float(cycle.times[-1])
    points = features_of(model, chunk, begin, until)
    off = free_run_error(model, cycle)
    strange = reference.strangeness(points.values, points.times) if reference is not None else None
    rating: Rating = "ordinary"
    words = ""
    if off is not None and off.error > off.allowed:
        rating, words = "badly predicted", f"off by {off.error:.2g} where {off.allowed:.2g} is usual"
    elif strange is not None and strange.value > 1.0:
        rating, words = "rare", strange_words(strange)
    elif reference is not None and any(reference.alike(points.values, other) for other in difficult):
        rating, words = "near a difficult one", "it is like a cycle that was badly predicted"
    return CycleRow(
        name=cycle.name,
        begin=begin,
        until=float(closed.times[-1]),
        rows=int(closed.times.size),
        # Of what is read back: a cycle's readings are the same whenever they are asked for.
        content=content_hash(closed),
        region=_region(model, cycle),
        rating=rating,
        words=words,
        strangeness=None if strange is None else strange.value,
        error=None if off is None else off.error,
        allowed=None if off is None else off.allowed,
        moved=None if off is None else off.moved,
        model=source.version,
        points=points.values,
    )


def _region(model: Model, cycle: Trace) -> str:
    """Where in operation a cycle was: its most usual level while it ran, and the ten degrees that it began in."""
    bins = next((channel for channel in model.alphabet.channels if isinstance(channel, Bins)), None)
    switch = next((channel for channel in model.alphabet.channels if isinstance(channel, Switch)), None)
    first = cycle.signals[model.temperature]
    begin = float(first[np.isfinite(first)][0]) if np.isfinite(first).any() else nan
    tens = int(np.floor(begin / 10.0) * 10) if np.isfinite(begin) else 0
    level = "any level"
    if bins is not None:
        load, running = cycle.signals[bins.signal], np.ones(cycle.times.shape)
        if switch is not None:
            # A switch that is only sent when it changes is held.
            sent = cycle.signals[switch.signal]
            places = np.maximum.accumulate(np.where(np.isfinite(sent), np.arange(sent.size), -1))
            running = np.where(places < 0, 1.0, sent[places])
        ran = load[np.isfinite(load) & (running > 0.5)]
        if ran.size:
            numbers = np.bincount(np.searchsorted(bins.thresholds, ran, side="right"))
            level = bins.symbols[int(np.argmax(numbers))]
    return f"{level}, begun at {tens}-{tens + 10}"
