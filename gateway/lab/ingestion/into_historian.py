"""`decanter historian import`: a recording as rows of a historian, as if a gateway had watched it."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import pairwise
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.tag import DType, Quality, Sample, Tag
from gateway.console import CommandResult, Part, conclude, progress
from gateway.entry import sentences
from gateway.lab.traces.load import load_with_report
from gateway.machine import Keeper
from gateway.machine.model import new_readings
from gateway.machine.reading import Scan
from gateway.settings import HistorianSection
from gateway.store import Historian, HistorianError, machines, newest_scan, open_historian, reading, to_trace
from sim.lab.recordings import since_1970
from sim.sha import Alphabet, Mask, Trace

SCANS_PER_WAIT = 5_000
"""Scans that are put before the disk is waited for: the queues are never full."""
PATIENCE_S = 120.0
"""How long the disk may take for them."""
STEPS_STORED = 5
"""Usual steps between rows after which a value that has not changed is stored again."""
SAME_TIME_S = 1e-6
"""s between two times that are one."""
_Seen = dict[str, tuple[NDArray[np.intp], Mask]]
"""Of each signal, in each row, where its newest reading stands and whether it still holds."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportedRows:
    """What became of a machine's `rows`: those `there` already, those `stored`, and the `samples` that they make."""

    machine: str
    rows: int
    there: int
    stored: int
    samples: int


def import_command(paths: Sequence[str], map_name: str, path: Path, machine: str, as_json: bool) -> None:
    """The work of `historian import`."""
    with sentences(), progress("importing") as report:
        traces, column_map, account = load_with_report(paths, map_name)
        named = [replace(trace, machine=machine or trace.machine) for trace in traces]
        done = import_traces(path, named, column_map.temperature, column_map.alphabet, report)
    data: dict[str, Any] = {"historian": str(path), "account": account.account()}
    data |= {"machines": [{"machine": each.machine, "rows": each.rows, "already there": each.there,
             "stored": each.stored, "samples": each.samples} for each in done]}  # fmt: skip

    def show() -> Iterator[Part]:
        yield account.account()
        for each in done:
            yield (
                f"{each.machine}: {each.rows} rows = {each.stored} stored (in {each.samples} samples) + {each.there} "
                "there already"
            )
        yield f"historian: {path}"

    conclude(CommandResult(data), lambda _: show(), as_json=as_json)


def import_traces(
    path: Path,
    traces: Sequence[Trace],
    temperature: str,
    alphabet: Alphabet,
    report: Callable[[str, float], None] = lambda what, share: None,
) -> list[ImportedRows]:
    """The traces as rows of the historian at `path`, machine by machine.

    Over rows that have none of its signal a reading holds as `recorded_scans` shows it, up to the alphabet's gap.

    Raises ValueError, before anything is stored, for rows that contradict what is there, that are before it, or that
    have no time in UTC; HistorianError where another gateway has it or it cannot be written.
    """
    by_machine: dict[str, list[Trace]] = {}
    for trace in traces:
        by_machine.setdefault(trace.machine, []).append(trace)
    recordings = {name: _concatenate(own) for name, own in by_machine.items()}
    seen = {name: new_readings(own, alphabet, np.arange(own.times.size), own.times) for name, own in recordings.items()}
    there = {name: _there(path, recording, seen[name]) for name, recording in recordings.items()}
    historian = open_historian(path)
    try:
        done = []
        for name, recording in recordings.items():
            samples = _put_rows(historian, recording, seen[name], there[name], temperature, report=report)
            rows = int(recording.times.size)
            stored = rows - there[name]
            done.append(ImportedRows(machine=name, rows=rows, there=there[name], stored=stored, samples=samples))
    finally:
        complete = historian.close()
    if not complete or historian.dropped or historian.refused:
        raise HistorianError(f"{path}: not all rows could be stored ({historian.complaint}); make room, import again")
    return done


def _concatenate(traces: Sequence[Trace]) -> Trace:
    """A machine's traces as one.

    Raises ValueError where they overlap, have two rows of one time, or count from their own beginning.
    """
    ordered = sorted(traces, key=lambda trace: float(trace.times[0]))
    for trace in ordered:
        if not since_1970(float(trace.times[0])):
            raise ValueError(
                f"{trace.origin}: its times count from its own beginning, and a historian's are of days and hours; "
                "give a recording with dates"
            )
    for before, after in pairwise(ordered):
        if after.times[0] <= before.times[-1]:
            raise ValueError(
                f"{after.origin}: the traces {before.name} and {after.name} are of one machine, {after.machine!r}, at "
                "the same time; name the machines in the column map"
            )
    times = np.concatenate([trace.times for trace in ordered])
    names = list(dict.fromkeys(name for trace in ordered for name in trace.signals))
    signals = {
        name: np.concatenate([t.signals.get(name, np.full(t.times.size, np.nan)) for t in ordered]) for name in names
    }
    bad = {
        name: np.concatenate([t.bad.get(name, np.zeros(t.times.size, dtype=bool)) for t in ordered]) for name in names
    }
    if twice := int((np.diff(times) <= 0).sum()):
        raise ValueError(
            f"{ordered[0].origin}: {twice} rows of {ordered[0].machine!r} have the time of the row before, and a "
            'historian has one row a time; give duplicates = "average" or "spread" in the column map'
        )
    return replace(ordered[0], times=times, signals=signals, bad=bad, events=())


def _there(path: Path, recording: Trace, seen: _Seen) -> int:
    """How many of the recording's first rows the historian has. Raises ValueError where it contradicts them."""
    if not path.exists():
        return 0
    machine = recording.machine
    with reading(path) as connection:
        if machine not in dict(machines(connection)):
            return 0
        newest = newest_scan(connection, machine=machine)
    if newest is None:
        return 0
    first, count = float(recording.times[0]), int(np.searchsorted(recording.times, newest + SAME_TIME_S, side="right"))
    if not count:
        return 0
    own = recording.times[:count]
    stored = to_trace(path, start=first - SAME_TIME_S, end=float(own[-1]) + SAME_TIME_S, machine=machine)
    if stored.times.size != count or np.any(np.abs(stored.times - own) > SAME_TIME_S):
        raise ValueError(
            f"{recording.origin}: from {_utc(first)} to {_utc(float(own[-1]))} the historian has {stored.times.size} "
            f"other rows of {machine!r}, and the recording {count}; import recordings in the order of their times, or "
            "into a historian of their own"
        )
    for name, (news, held) in seen.items():
        values = np.where(held, recording.signals[name][news], np.nan)
        known = stored.signals.get(name, np.full(count, np.nan))
        unequal = np.flatnonzero(~((known == values[:count]) | (np.isnan(known) & np.isnan(values[:count]))))
        if unequal.size:
            at = int(unequal[0])
            raise ValueError(
                f"{recording.origin}: {name} is {values[at]:g} at {_utc(float(own[at]))}, and the historian has "
                f"{known[at]:g} there ({unequal.size} such readings); one of them is wrong, or they are of two machines"
            )
    return count


def _put_rows(
    historian: Historian,
    recording: Trace,
    seen: _Seen,
    first: int,
    temperature: str,
    *,
    report: Callable[[str, float], None],
) -> int:
    """Put the rows from `first` on; how many samples they make."""
    times = recording.times.tolist()[first:]
    if not times:
        return 0
    tags = {name: Tag(name, "", DType.FLOAT64, unit=recording.units.get(name, "")) for name in recording.signals}
    view = historian.view(recording.machine, tags.values())
    usual = float(np.median(np.diff(recording.times))) if recording.times.size > 1 else 1.0
    # A gateway's interval is some of its scans: so many of the recording's are as long as its rows want it.
    interval = max(HistorianSection().max_interval, STEPS_STORED * usual)
    followed = historian.view(recording.machine, temperature=temperature)
    followed.put("runs", [(times[0], temperature, "", usual, interval)])
    keeper, samples = Keeper(tags, interval), 0
    columns = []
    for name, (news, held) in seen.items():
        new = news == np.arange(news.size)
        columns.append((name, *(each[first:].tolist() for each in (recording.signals[name], new, held))))
    for begin in range(0, len(times), SCANS_PER_WAIT):
        for number in range(begin, min(begin + SCANS_PER_WAIT, len(times))):
            time = times[number]
            read = {}
            for name, values, new, held in columns:
                if new[number] and isfinite(values[number]):
                    read[name] = Sample(name, values[number], Quality.GOOD, time)
                elif new[number] or not held[number]:
                    read[name] = Sample(name, None, Quality.BAD if new[number] else Quality.NO_DATA, time)
            rows = keeper.rows(Scan(number, time, read, 0, 0.0))
            samples += len(rows)
            view.put("scans", [(time, 0.0, 0)])
            view.put("samples", rows)
        if not historian.flush(PATIENCE_S):
            raise HistorianError(f"{historian.path}: the disk takes no more rows ({historian.stuck}); make room")
        report(recording.machine, min(begin + SCANS_PER_WAIT, len(times)) / len(times))
    return samples


def _utc(time: float) -> str:
    return datetime.fromtimestamp(time, UTC).strftime("%Y-%m-%d %H:%M:%S")
