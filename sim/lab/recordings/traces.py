"""Traces from CSV files: rows in order on one clock, equal times merged, gaps left open, events encoded."""

import fnmatch
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sim.lab.recordings.auto_thresholds import with_gap, with_thresholds
from sim.lab.recordings.clock import longest_rising_rows, spread_evenly, unroll_midnight
from sim.lab.recordings.column_map import ByColumn, ColumnMap
from sim.lab.recordings.load_report import FileReport, LoadReport, TraceError
from sim.lab.recordings.readings import (
    FileReadings,
    Rows,
    Series,
    Whose,
    concatenate_readings,
    judged,
    read_file,
    refuse_rows,
    select,
)
from sim.lab.recordings.sources import UNPACK_ERRORS, is_json, is_recording, recording_name
from sim.sha import Alphabet, Array, Mask, Trace, encode, holds_roughly

Source = str | Path | Iterable[str | Path]
SYNTHETIC_MARK = "SYNTHETIC"
"""A comment that begins with this word says that no plant made the rows."""
MAX_CONTRADICTION_SHARE = 0.01
"""Share of the rows that may contradict another one of the same time before `last` would be a guess."""
MAX_HELD_ROWS = 5_000_000
"""Rows that held values may make of one trace."""


def load_traces(source: Source, column_map: ColumnMap) -> tuple[list[Trace], LoadReport]:
    """The encoded traces of files, folders or patterns (`runs/*.csv`), with what became of every row.

    A folder stands for its CSV files, or those that match the map's `parts`, or else those in the folders below. Each
    file is a trace, or each folder's `parts` are one. A file of which nothing can be used has its reason in the report,
    and the others go on. Raises TraceError, with the report, when there is no trace at all.
    """
    reports: list[FileReport] = []
    traces: list[Trace] = []
    groups: list[tuple[int, list[FileReport]]] = []
    taken: set[str] = set()
    for group in _groups(_files(source, column_map), column_map):
        files = [FileReport(path) for path in group]
        reports += files
        try:
            loaded = _load_group(files, column_map)
        except TraceError as error:
            for file in files:
                file.error = file.error or str(error)
            continue
        name = _name(group, taken)
        taken.add(name)
        counts: Counter[str] = Counter()
        for trace in loaded:
            own = f"{name}-{trace.name}" if trace.name else name
            counts[own] += 1
            traces.append(replace(trace, name=f"{own}-{counts[own]}" if counts[own] > 1 else own))
        groups += [(len(loaded), files)]
    # One alphabet for all traces, whose readings may decide its gap and its thresholds: known when all are there.
    alphabet = with_gap(column_map.alphabet, traces, column_map.interval if column_map.stored == "on change" else None)
    traces = [_complete_trace(trace, column_map, alphabet.gap) for trace in traces]
    _note_gaps(traces, groups, alphabet)
    alphabet = with_thresholds(alphabet, traces)
    traces = [replace(trace, events=encode(trace, alphabet)) for trace in traces]
    report = LoadReport(tuple(reports), alphabet)
    if not traces:
        where = source if isinstance(source, str | Path) else ", ".join(map(str, source))
        errors = report.errors or (f"{where}: there is no CSV file there; give a file, a folder or a pattern",)
        others = len(errors) - 1
        more = f" (and {others} more that {'gives' if others == 1 else 'give'} no trace)" if others else ""
        raise TraceError(errors[0] + more, report)
    return traces, report


def files_by_machine(source: Source, column_map: ColumnMap) -> dict[str, list[Path]]:
    """The files of traces, by the machine that they are of.

    Of a folder its own and those in the folders below: a file beside the machines' folders must not stand for them all.
    """
    if isinstance(column_map.machine, ByColumn):
        raise TraceError(
            "the column map takes the machine from a column, so that no file is of one; give each machine its files"
        )
    machines: dict[str, list[Path]] = {}
    for group in _groups(_files(source, column_map, below=True), column_map):
        machines.setdefault(_machine([FileReport(path) for path in group], column_map), []).extend(group)
    return machines


def _files(source: Source, column_map: ColumnMap, *, below: bool = False) -> list[Path]:
    """The files that are meant, those in the folders below a folder only where it has none itself, or if `below`."""
    files: list[Path] = []
    for path in (Path(each).expanduser() for each in ([source] if isinstance(source, str | Path) else source)):
        if path.is_dir():
            own = csv_files(path.iterdir(), column_map.parts)
            # Of what stands below .json may be anything, and beside a folder of recordings JSON tells of them.
            deeper = (each for each in path.rglob("*") if each.parent != path and each.suffix.lower() != ".json")
            deep = csv_files(deeper, column_map.parts) if below or all(map(is_json, own)) else []
            if not all(map(is_json, deep)):
                own = [each for each in own if not is_json(each)]
            elif own and not below:
                deep = []
            files += own + deep
        elif not path.exists() and is_pattern(path):
            # A file may have such a mark in its name: only what is not there is a pattern.
            anchor = Path(path.anchor)
            found = sorted(match for match in anchor.glob(str(path.relative_to(anchor))) if match.is_file())
            # A pattern that nothing is of is reported as a file that is not there.
            files += found or [path]
        else:
            files.append(path)
    # A file that is named twice, or by its folder too, is one trace and not two.
    return list(dict.fromkeys(files))


def is_pattern(path: Path) -> bool:
    """Whether there is a mark of a pattern in it."""
    return any(mark in str(path) for mark in "*?[")


def csv_files(paths: Iterable[Path], parts: str) -> list[Path]:
    """The CSV files among paths, in the order of their names; only those of the pattern `parts`, if any is."""
    files = [path for path in paths if is_recording(path) or is_json(path)]
    files = [path for path in files if path.is_file() and path.name[:1] != "."]
    # JSON beside another recording tells of it; an object in .json beside those in lines does as well.
    files = [path for path in files if not is_json(path)] or [path for path in files if is_recording(path)] or files
    # What stands packed, or as the sheet that it was exported from, beside a CSV of its name is no second recording.
    plain = {(path.parent, recording_name(path)) for path in files if path.suffix.lower() == ".csv"}
    files = [
        path for path in files if path.suffix.lower() == ".csv" or (path.parent, recording_name(path)) not in plain
    ]
    return sorted([path for path in files if parts and fnmatch.fnmatch(path.name, parts)] or files)


def _groups(files: Sequence[Path], column_map: ColumnMap) -> list[list[Path]]:
    """Files that make one trace together, in the order of their first."""
    groups: dict[Path, list[Path]] = {}
    for path in files:
        is_part = bool(column_map.parts) and fnmatch.fnmatch(path.name, column_map.parts)
        groups.setdefault(path.parent if is_part else path, []).append(path)
    return list(groups.values())


def _name(group: Sequence[Path], taken: set[str]) -> str:
    first = group[0]
    parent = first.absolute().parent.name
    name = recording_name(first) if len(group) == 1 else parent
    if name in taken:
        name = f"{parent}-{name}"
    number = 2
    while name in taken:
        name, number = f"{recording_name(first)}({number})", number + 1
    return name


def _machine(files: Sequence[FileReport], column_map: ColumnMap) -> str:
    """The machine of a group's trace. Parts of one trace lie in a folder of their own, which then is its file."""
    first = files[0].path.absolute()
    match column_map.machine:
        case "file" if len(files) == 1:
            return recording_name(first)
        case str() as name if name not in ("file", "folder"):
            return name
        case _:
            return first.parent.name


def _load_group(files: Sequence[FileReport], column_map: ColumnMap) -> list[Trace]:
    parts: dict[Whose, list[FileReadings]] = {}
    for index, file in enumerate(files):
        try:
            for readings in read_file(file.path, column_map, file):
                numbered = replace(readings, files=np.full_like(readings.files, index))
                parts.setdefault(readings.whose, []).append(numbered)
        except TraceError as error:
            file.error = str(error)
        except (OSError, *UNPACK_ERRORS) as error:
            reason = f"it cannot be read: {getattr(error, 'strerror', '') or error}"
            if isinstance(error, FileNotFoundError) and is_pattern(file.path):
                reason = "no file is of this pattern"
            file.error = f"{file.path}: {reason}"
    if not parts:
        raise TraceError(files[0].error, None)
    used = [file for file in files if not file.error]
    return [
        trace
        for own in parts.values()
        for trace in _build_traces(judged(concatenate_readings(own), files), column_map, files, used)
    ] or _load_empty(used[0].path, column_map.temperature)


def _load_empty(path: Path, name: str) -> list[Trace]:
    raise TraceError(f"{path}: there is no reading of {name} in it that can be used")


def _build_traces(
    readings: FileReadings, column_map: ColumnMap, files: Sequence[FileReport], used: Sequence[FileReport]
) -> list[Trace]:
    """The traces of one machine and session, named after them; their signals as they were read."""
    if column_map.clock.daily:
        readings = replace(readings, times=unroll_midnight(readings.times))
    first, count = used[0].path, len(used)
    own = str(first) if count == 1 else f"{first.parent} ({count} files)"
    # What `write_trace` wrote at a file's head: a trace that goes through our own CSV keeps where it came from.
    noted = next((c.removeprefix("origin:").strip() for c in readings.comments if c.startswith("origin:")), "")
    synthetic = column_map.synthetic or any(comment.startswith(SYNTHETIC_MARK) for comment in readings.comments)
    traces, name = list[Trace](), column_map.temperature
    for piece in _in_order(readings, column_map, files):
        if name not in column_map.derived and (name not in piece.series or piece.series[name].bad.all()):
            why = f"there is no reading of {name} in its part of the trace"
            refuse_rows(piece, np.ones(piece.times.shape, dtype=bool), why, files)
            continue
        machine, session = piece.whose
        traces.append(
            Trace(
                "-".join(filter(None, (machine, session))),
                *_merge_files(piece, column_map, files),
                origin=noted or own,
                synthetic=synthetic,
                machine=machine or _machine(files, column_map),
                units=units(column_map),
            )
        )
    return traces


def _note_gaps(traces: Sequence[Trace], groups: Sequence[tuple[int, list[FileReport]]], alphabet: Alphabet) -> None:
    """What a reader of the report should know beyond refused rows; traces stand in the order of the groups."""
    gap, start = alphabet.gap, 0
    for count, files in groups:
        own, first = traces[start : start + count], next(file for file in files if not file.error)
        start += count
        gaps = sum(int((np.diff(trace.times) > gap).sum()) for trace in own)
        if gaps:
            first.notes.append(f"{gaps} gaps of more than {gap:g} s are left open")
        lacking = [channel.signal for channel in alphabet.channels if channel.signal not in own[0].signals]
        if lacking:
            first.notes.append(f"no signal {', '.join(lacking)}: its events cannot be seen")


def _in_order(readings: FileReadings, column_map: ColumnMap, files: Sequence[FileReport]) -> list[FileReadings]:
    """The rows with a clock that never goes back, as the map's `clock_back` wants it."""
    back = np.flatnonzero(np.diff(readings.times) < 0) + 1
    if not back.size:
        return [readings]
    if column_map.clock_back == "split":
        files[0].notes.append(f"its clock goes back {back.size} times; a new trace begins at each")
        return [select(readings, rows) for rows in np.split(np.arange(readings.times.size), back)]
    if column_map.clock_back == "sort":
        within = readings.files[back] == readings.files[back - 1]
        for index, count in zip(*np.unique(readings.files[back[within]], return_counts=True), strict=True):
            files[index].notes.append(f"its clock goes back {count} times; its rows are sorted by time")
        return [select(readings, np.argsort(readings.times, kind="stable"))]
    keep = longest_rising_rows(readings.times)
    if keep.size > 4 and 2 * int(keep.sum()) <= keep.size:
        lost = int((~keep).sum())
        raise TraceError(
            f"{files[0].path}: its clock goes back {back.size} times, so {lost} of its {keep.size} rows would be lost; "
            'write clock_back = "sort" in the column map if the rows are only out of order, "split" if the clock '
            "starts anew, or give each its own file"
        )
    refuse_rows(readings, ~keep, "its clock is before that of the rows around it", files)
    return [select(readings, np.flatnonzero(keep))]


def _merge_files(
    readings: FileReadings, column_map: ColumnMap, files: Sequence[FileReport]
) -> tuple[Array, dict[str, Array], tuple[()], dict[str, Mask]]:
    """Times, signals and bad marks of a trace, rows of equal time made one unless the map keeps or spreads them.

    Raises TraceError where the rows of one time contradict one another and nobody has said what that means.
    """
    first = np.ones(readings.times.shape, dtype=bool)
    if column_map.duplicates == "spread":
        readings = replace(readings, times=spread_evenly(readings.times))
    elif column_map.duplicates != "keep":
        first[1:] = np.diff(readings.times) > 0
    for index, count in enumerate(np.bincount(readings.files[~first], minlength=len(files)).tolist()):
        files[index].merged += count
        files[index].merged_cells += count * readings.clock_cells
        files[index].used_cells += int((first & (readings.files == index)).sum()) * readings.clock_cells
    group = np.cumsum(first) - 1
    times = readings.times[first]
    if column_map.duplicates in ("agree", "last"):
        _contradictions(readings, group, first, files, refused=column_map.duplicates == "agree")
    signals, bad = {}, {}
    for name, series in readings.series.items():
        known, at = column_map.signals.get(name), group[series.rows]
        # Of good readings of one cell place the last is used: each of the others is merged.
        good = ~series.bad
        kept = good
        if not first.all():
            kept = np.zeros(at.shape, dtype=bool)
            kept[np.flatnonzero(good)[::-1][np.unique(at[good][::-1], return_index=True)[1]]] = True
        for index, file in enumerate(files):
            own = readings.files[series.rows] == index
            file.used_cells += int((kept & own).sum())
            file.merged_cells += int((good & ~kept & own).sum())
        if column_map.duplicates == "average" and not (known is not None and known.boolean):
            signals[name], bad[name] = _average(series, at, times.size)
        else:
            # Of several values assigned to one place numpy keeps the last.
            signals[name], bad[name] = np.full(times.size, np.nan), np.zeros(times.size, dtype=bool)
            signals[name][at], bad[name][at] = series.values, series.bad
    return times, signals, (), {name: mask for name, mask in bad.items() if mask.any()}


def _contradictions(
    readings: FileReadings, group: Rows, first: Mask, files: Sequence[FileReport], *, refused: bool
) -> None:
    """Refuse, or only say, that rows of one time have other readings than the last of them."""
    unequal = np.zeros(int(first.sum()), dtype=bool)
    for series in readings.series.values():
        good = ~series.bad
        at, values = group[series.rows[good]], series.values[good]
        order = np.argsort(at, kind="stable")
        same = np.diff(at[order]) == 0
        unequal[at[order][1:][same & (np.diff(values[order]) != 0)]] = True
    where = np.flatnonzero(unequal[group] & ~first)
    if not where.size:
        return
    file, line = files[int(readings.files[where[0]])], readings.lines[where[0]]
    said = (
        f"{where.size} of its {first.size} rows have the time of another row and other readings (the first on line "
        f"{line})"
    )
    if not refused or where.size <= MAX_CONTRADICTION_SHARE * first.size:
        file.warn(f"{said}; the last reading counts")
        return
    raise TraceError(
        f"{file.path}: {said}: if they are of several machines or sessions, name the column in the map: "
        'machine = { column = "..." } or session = { column = "..." }; if the clock lost its seconds, write '
        'duplicates = "spread"; if the readings are one, "average" or "last"'
    )


def _average(series: Series, group: Rows, size: int) -> tuple[Array, Mask]:
    """The mean of the good readings of one time; bad only where there are none but bad ones."""
    good = ~series.bad
    counts = np.bincount(group[good], minlength=size)
    values = np.full(size, np.nan)
    # A single reading stays what it was, to the last bit.
    np.divide(np.bincount(group[good], series.values[good], size), counts, out=values, where=counts > 0)
    bad = np.bincount(group[series.bad], minlength=size) > 0
    return values, bad & (counts == 0)


def _complete_trace(trace: Trace, column_map: ColumnMap, gap: float) -> Trace:
    """With held and derived signals."""
    if column_map.stored == "on change":
        trace = _expand_rows(trace, column_map)
    signals, bad = dict(trace.signals), dict(trace.bad)
    times = trace.times
    for name, signal in column_map.signals.items():
        if signal.hold and name in signals:
            signals[name] = _hold_reading(times, signals[name], bad.get(name), gap)
    # A derived signal is only there where the file has none of its own and all its sources are.
    for name, derived in column_map.derived.items():
        if name in signals:
            continue
        if derived.constant is not None:
            signals[name] = np.full(times.size, derived.constant)
        elif not all(source in signals for source in derived.sources):
            continue
        elif derived.is_switch:
            (source,) = (signals[name] for name in derived.sources)
            signals[name] = np.where(np.isnan(source), np.nan, derived.value([source]))
            if derived.signal in bad:
                bad[name] = bad[derived.signal]
        else:
            # Known in each row with a reading of one of them; the others are as they were read last.
            read = np.any([~np.isnan(signals[source]) for source in derived.product], axis=0)
            factors = [_hold_reading(times, signals[source], bad.get(source), gap) for source in derived.product]
            signals[name] = np.where(read, derived.value(factors), np.nan)
            faults = [bad[source] for source in derived.product if source in bad]
            if faults:
                bad[name] = np.any(faults, axis=0)
                signals[name][bad[name]] = np.nan
    return replace(trace, signals=signals, bad=bad)


def _expand_rows(trace: Trace, column_map: ColumnMap) -> Trace:
    """The trace of a recording on change as one that has each row: values hold, and stand there every `interval`."""
    times, step = trace.times, column_map.interval
    # Nothing holds over a silence of the recorder itself; a signal's own reading holds as long as that signal's may.
    ends = np.diff(times, prepend=-np.inf) > column_map.silence
    origin = np.maximum.accumulate(np.where(ends, np.arange(times.size), 0))
    last, until = dict[str, Rows](), np.full(times.shape, -np.inf)
    for name, values in trace.signals.items():
        said = ~np.isnan(values) | trace.bad.get(name, np.zeros(times.shape, dtype=bool))
        at = np.maximum.accumulate(np.where(said, np.arange(times.size), -1))
        last[name] = np.where(at >= origin, at, -1)
        holds = _silence(column_map, name)
        until = np.maximum(until, np.where(last[name] < 0, -np.inf, times[at] + holds))
    lasting = np.clip(np.minimum(np.diff(times, append=times[-1:]), until - times), 0.0, column_map.silence)
    # None stands within half a step of the next row, nor beyond the silence that still says something.
    more = np.maximum(np.ceil((lasting - step / 2) / step).astype(int) - 1, 0)
    if times.size + int(more.sum()) > MAX_HELD_ROWS:
        raise TraceError(
            f"{trace.origin}: held values every {step:g} s would make {times.size + int(more.sum())} rows of it; "
            "write a longer interval in the column map"
        )
    source = np.repeat(np.arange(times.size), 1 + more)
    within = np.arange(source.size) - np.repeat(np.cumsum(1 + more) - 1 - more, 1 + more)
    rows = times[source] + step * within
    signals, bad, held = dict[str, Array](), dict[str, Mask](), dict[str, Mask]()
    for name, values in trace.signals.items():
        at = last[name][source]
        known = (at >= 0) & (rows - times[at] <= _silence(column_map, name))
        faulty = known & trace.bad.get(name, np.zeros(times.shape, dtype=bool))[at]
        signals[name] = np.where(known & ~faulty, values[at], np.nan)
        if faulty.any():
            bad[name] = faulty
        # Without a deadband a value holds to the last digit, and is as good as read.
        if holds_roughly(times, values):
            held[name] = (within > 0) | (at != source)
    return replace(trace, times=rows, signals=signals, bad=bad, held=held)


def _silence(column_map: ColumnMap, signal: str) -> float:
    known = column_map.signals.get(signal)
    return known.silence if known is not None and known.silence is not None else column_map.silence


def _hold_reading(times: Array, values: Array, bad: Mask | None, gap: float | Mask) -> Array:
    """The last reading held over rows without one, not over bad ones and not over gaps (s, or the rows after one)."""
    ends = np.diff(times, prepend=-np.inf) > gap if isinstance(gap, float) else gap
    present = ~np.isnan(values) | ends | (np.zeros_like(ends) if bad is None else bad)
    return np.asarray(values[np.maximum.accumulate(np.where(present, np.arange(times.size), 0))])


def units(column_map: ColumnMap) -> Mapping[str, str]:
    """The unit of each signal that has one, for axes and tables."""
    derived = {name: column.unit for name, column in column_map.derived.items()}
    read = {name: column.unit for name, column in column_map.signals.items()}
    return {name: unit for name, unit in (derived | read).items() if unit}
