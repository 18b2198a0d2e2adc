"""The historian cut into cycles, a day or two at a time, each rated against the model that runs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import pairwise
from math import inf, nan, nextafter
from pathlib import Path

import numpy as np

from gateway.lab.learning.familiar import MIN_CYCLE_READINGS, cycle_features, free_run_error, strange_words
from gateway.lab.options import Rating
from gateway.lab.retraining.cycle_library import CycleLibrary, CycleRow
from gateway.store import newest_scan, oldest_scan, reading, stored_rows, tag_names, to_trace
from sim.familiarity import MAX_CYCLE_S, FamiliarityReference
from sim.lab.recordings import split_cycles
from sim.sha import Array, Bins, Model, Switch, Trace, content_hash, encode

Progress = Callable[[str, float], None]
READ_SPAN_S = 2 * 86_400.0
"""Seconds of the historian that are in memory at a time."""
LOOK_BACK_S = 3600.0
"""What is read before a piece: features look back as far."""
SET_BACK = "the clock was set back during it: what came before and after lies in one another"
"""Why the program itself excludes a cycle."""


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

    A cycle that is not over waits for the next time; one of more than MAX_CYCLE_S is cut there. Raises HistorianError,
    and ValueError where the historian has not what the model is made of.
    """
    with reading(source.historian) as connection:
        last = newest_scan(connection, machine=source.machine)
        first = oldest_scan(connection, machine=source.machine)
        tags = tag_names(connection, machine=source.machine)
    if last is None or first is None:
        return 0
    needed = [*(channel.signal for channel in source.model.alphabet.channels), source.model.temperature]
    lacking = [name for name in needed if name not in tags]
    if lacking:
        raise ValueError(f"{source.historian}: has no tag {lacking[0]!r}, which the model is made of")
    if source.since > last:
        raise ValueError(
            f"{source.historian}: nothing is in it since {_utc(source.since)}; its newest scan is of {_utc(last)}"
        )
    cursor, within = library.fact("cursor"), bool(library.fact("within"))
    if cursor is not None and cursor > nextafter(last, inf):
        # The clock was ahead once, and has been put right: what it says now was never cut.
        earlier = [row.until for row in library.cycles() if row.until <= last]
        cursor, within = max(earlier, default=first), False
    cursor = max(source.since if cursor is None else float(cursor), first)
    begin, count = cursor, 0
    difficult = [row.points for row in library.cycles() if row.rating == "badly predicted" and not row.is_excluded]
    while cursor < last:
        report("cutting the historian into cycles", (cursor - begin) / max(last - begin, 1.0))
        until = min(cursor + READ_SPAN_S, nextafter(last, inf))
        pieces, chunk = _pieces(source, cursor, until, within=within)
        at_end = until > last
        after, within = until, False
        # The last one may go on: it is cut when its end is known. One that a gap has ended does not.
        if pieces and until - float(pieces[-1].times[-1]) <= source.model.alphabet.gap:
            after, within = float(pieces.pop().times[0]), True
        twice = _twice(source, cursor, until)
        rows: list[CycleRow] = []
        closed = {piece.name: _close_cycle(piece, chunk, source.model.alphabet.gap) for piece in pieces}
        for piece in pieces:
            row = _rate_cycle(
                source, piece, closed=closed[piece.name], chunk=chunk, reference=reference, difficult=difficult
            )
            if row is None:
                continue
            if any(row.begin <= high and low <= row.until for low, high in twice):
                row = replace(row, excluded_by="the program", reason=SET_BACK)
            rows.append(row)
            if row.rating == "badly predicted" and not row.is_excluded:
                difficult.append(row.points)
        count += len(rows)
        library.add(rows, after, within=within)
        # After their rows: a kill between the two leaves a row without readings, which the historian still has.
        for row in rows:
            if row.rating != "ordinary" and not row.is_excluded:
                library.keep(row.name, closed[row.name])
        if at_end:
            break
        cursor = after
    return count


def _pieces(source: CycleSource, start: float, end: float, *, within: bool) -> tuple[list[Trace], Trace]:
    """The cycles that begin from `start` to `end`, and all that was read, an hour before included; encoded.

    `within`: one begins at `start`, whatever the machine does then. A piece in which a tag has no reading yet has none.
    """
    machine, alphabet = source.machine, source.model.alphabet
    chunk = to_trace(source.historian, start=start - LOOK_BACK_S, end=end, machine=machine)
    if chunk.times.size < 2:
        return [], chunk
    chunk = replace(chunk, machine=machine or "")
    if any(channel.signal not in chunk.signals for channel in alphabet.channels):
        return [], chunk
    chunk = replace(chunk, events=encode(chunk, alphabet))
    found = split_cycles(chunk, alphabet, alphabet.gap, at=[start] if within else [], longest=MAX_CYCLE_S)
    named = [replace(piece, name=_name(machine, piece)) for piece in found if piece.times.size]
    return [piece for piece in named if piece.times[0] >= start], chunk


def _twice(source: CycleSource, start: float, end: float) -> list[tuple[float, float]]:
    """The stretches from `start` to `end` that the historian has twice, since the clock was set back (s UTC)."""
    with reading(source.historian) as connection:
        rows = stored_rows(connection, "scans", ("time",), start - LOOK_BACK_S, end, machine=source.machine)
    arrived = np.array([row[0] for row in rows], dtype=float)
    back = (np.flatnonzero(np.diff(arrived) < 0) + 1).tolist()
    found: list[tuple[float, float]] = []
    for place, next_place in pairwise([*back, arrived.size]):
        before, after = arrived[:place], arrived[place:next_place]
        low, high = float(after[0]), float(min(before.max(), after[-1]))
        # Rows that another source has written come out of order too; twice is what both have.
        if np.any((before >= low) & (before <= high)):
            found.append((low, high))
    return found


def _close_cycle(cycle: Trace, chunk: Trace, gap: float) -> Trace:
    """The cycle with the row that ended it, the first of the next one, without events; itself where a gap ended it.

    Without that row no rest would ever be seen to end where the next cycle is not learned from too.
    """
    begin, last = float(cycle.times[0]), float(cycle.times[-1])
    later = chunk.times[np.searchsorted(chunk.times, last, side="right") :]
    end = float(later[0]) if later.size and later[0] - last <= gap else last
    return replace(chunk.between(begin, nextafter(end, inf)), name=cycle.name, events=())


def _utc(time: float) -> str:
    return datetime.fromtimestamp(time, UTC).strftime("%Y-%m-%d %H:%M UTC")


def _name(machine: str | None, cycle: Trace) -> str:
    moment = datetime.fromtimestamp(float(cycle.times[0]), UTC).strftime("%Y%m%dT%H%M%SZ")
    return f"{machine}-{moment}" if machine else moment


def read_cycle(source: CycleSource, row: CycleRow, library: CycleLibrary) -> Trace | None:
    """The readings of a cycle, not encoded: those that were kept, else the historian's; None where neither has them.

    A kept file that is missing or damaged is made again from the historian; ValueError where that has it no more.
    """
    lost: ValueError | None = None
    if row.kept:
        try:
            return library.readings(row.content)
        except ValueError as error:
            lost = error
    found = to_trace(source.historian, start=row.begin, end=nextafter(row.until, inf), machine=source.machine)
    trace = replace(found, name=row.name, machine=source.machine or "")
    if content_hash(trace) == row.content:
        if lost is not None:
            library.keep(row.name, trace, anew=True)
        return trace
    if lost is not None:
        leave = f"decanter model version cycles {library.folder} --exclude {row.name} --reason WHY --by WHO"
        raise ValueError(f"{lost}; or leave the cycle out: {leave}") from None
    return None


def extend_cycle(source: CycleSource, cycle: Trace, seconds: float) -> Trace:
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


def _rate_cycle(
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
    if measured is None or np.count_nonzero(np.isfinite(measured)) < MIN_CYCLE_READINGS:
        return None
    begin, until = float(cycle.times[0]), float(cycle.times[-1])
    points = cycle_features(model, chunk, begin, until)
    off = free_run_error(model, cycle)
    strange = reference.strangeness(points.values, points.times) if reference is not None else None
    rating: Rating = "ordinary"
    words = ""
    if off is not None and off.error > off.allowed:
        rating, words = "badly predicted", f"off by {off.error:.2g} where {off.allowed:.2g} is usual"
    elif strange is not None and strange.value > 1.0:
        rating, words = "rare", strange_words(strange)
    elif reference is not None and any(reference.are_similar(points.values, other) for other in difficult):
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
