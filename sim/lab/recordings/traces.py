"""Traces from CSV files: rows in order on one clock, equal times merged, gaps left open, events encoded."""

import fnmatch
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sim.lab.recordings.auto_thresholds import with_thresholds
from sim.lab.recordings.clock import longest_rising, unroll_midnight
from sim.lab.recordings.column_map import ColumnMap
from sim.lab.recordings.load_report import FileReport, LoadReport, TraceError
from sim.lab.recordings.readings import FileReadings, Rows, Series, joined, read_file, select
from sim.sha import Array, Mask, Trace, encode

Source = str | Path | Iterable[str | Path]
SYNTHETIC = "SYNTHETIC"
"""A comment that begins with this word says that no plant made the rows."""


def load_traces(source: Source, column_map: ColumnMap) -> tuple[list[Trace], LoadReport]:
    """The encoded traces of files, folders or patterns (`runs/*.csv`), with what became of every row.

    A folder stands for its CSV files, or those that match the map's `parts`, or else those in the folders below. Each
    file is a trace, or each folder's `parts` are one. A file of which nothing can be used has its reason in the report,
    and the others go on. Raises TraceError, with the report, when there is no trace at all.
    """
    reports: list[FileReport] = []
    traces: list[Trace] = []
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
        traces += [replace(trace, name=f"{name}-{n}" if n > 1 else name) for n, trace in enumerate(loaded, 1)]
    # One alphabet for all traces, whose readings may decide its thresholds: known when all are there.
    alphabet = with_thresholds(column_map.alphabet, traces)
    traces = [replace(trace, events=encode(trace, alphabet)) for trace in traces]
    report = LoadReport(tuple(reports), alphabet)
    if not traces:
        where = source if isinstance(source, str | Path) else ", ".join(map(str, source))
        errors = report.errors or (f"{where}: there is no CSV file there; give a file, a folder or a pattern",)
        more = f" (and {len(errors) - 1} more files like it)" if len(errors) > 1 else ""
        raise TraceError(errors[0] + more, report)
    return traces, report


def files_by_machine(source: Source, column_map: ColumnMap) -> dict[str, list[Path]]:
    """The files of traces, by the machine that they are of.

    Of a folder its own and those in the folders below: a file beside the machines' folders must not stand for them all.
    """
    machines: dict[str, list[Path]] = {}
    for group in _groups(_files(source, column_map, below=True), column_map):
        machines.setdefault(_machine([FileReport(path) for path in group], column_map), []).extend(group)
    return machines


def _files(source: Source, column_map: ColumnMap, *, below: bool = False) -> list[Path]:
    """The files that are meant, those in the folders below a folder only where it has none itself, or if `below`."""
    files: list[Path] = []
    for path in (Path(each).expanduser() for each in ([source] if isinstance(source, str | Path) else source)):
        if path.is_dir():
            own = _csv_files(path.iterdir(), column_map.parts)
            files += own
            if below or not own:
                files += _csv_files((each for each in path.rglob("*") if each.parent != path), column_map.parts)
        elif not path.exists() and any(mark in str(path) for mark in "*?["):
            # A file may have such a mark in its name: only what is not there is a pattern.
            anchor = Path(path.anchor)
            files += sorted(match for match in anchor.glob(str(path.relative_to(anchor))) if match.is_file())
        else:
            files.append(path)
    # A file that is named twice, or by its folder too, is one trace and not two.
    return list(dict.fromkeys(files))


def _csv_files(paths: Iterable[Path], parts: str) -> list[Path]:
    files = [path for path in paths if path.suffix.lower() == ".csv" and path.is_file() and path.name[:1] != "."]
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
    name = first.stem if len(group) == 1 else parent
    if name in taken:
        name = f"{parent}-{name}"
    number = 2
    while name in taken:
        name, number = f"{first.stem}({number})", number + 1
    return name


def _machine(files: Sequence[FileReport], column_map: ColumnMap) -> str:
    """The machine of a group's trace. Parts of one trace lie in a folder of their own, which then is its file."""
    first = files[0].path.absolute()
    match column_map.machine:
        case "file" if len(files) == 1:
            return first.stem
        case "file" | "folder":
            return first.parent.name
        case name:
            return name


def _load_group(files: Sequence[FileReport], column_map: ColumnMap) -> list[Trace]:
    parts, used = [], []
    for file in files:
        try:
            parts.append(read_file(file.path, column_map, file))
            used.append(file)
        except TraceError as error:
            file.error = str(error)
        except OSError as error:
            file.error = f"{file.path}: it cannot be read: {error.strerror or error}"
    if not parts:
        raise TraceError(files[0].error, None)
    readings = joined(parts)
    if column_map.clock.time_of_day is not None:
        readings = replace(readings, times=unroll_midnight(readings.times))
    first, count = used[0].path, len(used)
    own = str(first) if count == 1 else f"{first.parent} ({count} files)"
    # What `write_trace` wrote at a file's head: a trace that goes through our own CSV keeps where it came from.
    noted = next((c.removeprefix("origin:").strip() for c in readings.comments if c.startswith("origin:")), "")
    synthetic = column_map.synthetic or any(comment.startswith(SYNTHETIC) for comment in readings.comments)
    traces, name = list[Trace](), column_map.temperature
    for piece in _in_order(readings, column_map, used):
        if name not in column_map.derived and (name not in piece.series or piece.series[name].bad.all()):
            for index, file in enumerate(used):
                lines = piece.lines[piece.files == index]
                file.refuse(lines.tolist(), f"there is no reading of {name} in its part of the trace")
            continue
        trace = Trace(
            first.stem,
            *_merged(piece, column_map, used),
            origin=noted or own,
            synthetic=synthetic,
            machine=_machine(files, column_map),
            units=units(column_map),
        )
        traces.append(_completed(trace, column_map))
    if not traces:
        raise TraceError(f"{first}: there is no reading of {name} in it that can be used")
    # What a reader of the report should know beyond refused rows.
    gap = column_map.alphabet.gap
    gaps = sum(int((np.diff(trace.times) > gap).sum()) for trace in traces)
    if gaps:
        used[0].notes.append(f"{gaps} gaps of more than {gap:g} s are left open")
    lacking = [channel.signal for channel in column_map.alphabet.channels if channel.signal not in traces[0].signals]
    if lacking:
        used[0].notes.append(f"no signal {', '.join(lacking)}: its events cannot be seen")
    return traces


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
    keep = longest_rising(readings.times)
    if keep.size > 4 and 2 * int(keep.sum()) <= keep.size:
        lost = int((~keep).sum())
        raise TraceError(
            f"{files[0].path}: its clock goes back {back.size} times, so {lost} of its {keep.size} rows would be lost; "
            'write clock_back = "sort" in the column map if the rows are only out of order, "split" if the clock '
            "starts anew, or give each its own file"
        )
    for index, file in enumerate(files):
        lines = readings.lines[~keep & (readings.files == index)]
        file.refuse(lines.tolist(), "its clock is before that of the rows around it")
    return [select(readings, np.flatnonzero(keep))]


def _merged(
    readings: FileReadings, column_map: ColumnMap, files: Sequence[FileReport]
) -> tuple[Array, dict[str, Array], tuple[()], dict[str, Mask]]:
    """Times, signals and bad marks of a trace, rows of equal time made one unless the map keeps them."""
    first = np.ones(readings.times.shape, dtype=bool)
    if column_map.duplicates != "keep":
        first[1:] = np.diff(readings.times) > 0
    for index, count in enumerate(np.bincount(readings.files[~first], minlength=len(files)).tolist()):
        files[index].merged += count
    group = np.cumsum(first) - 1
    times = readings.times[first]
    signals, bad = {}, {}
    for name, series in readings.series.items():
        known, at = column_map.signals.get(name), group[series.rows]
        if column_map.duplicates == "average" and not (known is not None and known.boolean):
            signals[name], bad[name] = _average(series, at, times.size)
        else:
            # Of several values assigned to one place numpy keeps the last.
            signals[name], bad[name] = np.full(times.size, np.nan), np.zeros(times.size, dtype=bool)
            signals[name][at], bad[name][at] = series.values, series.bad
    return times, signals, (), {name: mask for name, mask in bad.items() if mask.any()}


def _average(series: Series, group: Rows, size: int) -> tuple[Array, Mask]:
    """The mean of the good readings of one time; bad only where there are none but bad ones."""
    good = ~series.bad
    counts = np.bincount(group[good], minlength=size)
    values = np.full(size, np.nan)
    # A single reading stays what it was, to the last bit.
    np.divide(np.bincount(group[good], series.values[good], size), counts, out=values, where=counts > 0)
    bad = np.bincount(group[series.bad], minlength=size) > 0
    return values, bad & (counts == 0)


def _completed(trace: Trace, column_map: ColumnMap) -> Trace:
    """With held and derived signals."""
    signals, bad = dict(trace.signals), dict(trace.bad)
    times, gap = trace.times, column_map.alphabet.gap
    for name, signal in column_map.signals.items():
        if signal.hold and name in signals:
            signals[name] = _held(times, signals[name], bad.get(name), gap)
    # A derived signal is only there where the file has none of its own and all its sources are.
    for name, derived in column_map.derived.items():
        if name in signals:
            continue
        if derived.constant is not None:
            signals[name] = np.full(times.size, derived.constant)
        elif not all(source in signals for source in derived.sources):
            continue
        elif derived.signal is not None and derived.above is not None:
            source = signals[derived.signal]
            signals[name] = np.where(np.isnan(source), np.nan, source > derived.above)
            if derived.signal in bad:
                bad[name] = bad[derived.signal]
        else:
            read = np.any([~np.isnan(signals[source]) for source in derived.product], axis=0)
            factors = [_held(times, signals[source], bad.get(source), gap) for source in derived.product]
            signals[name] = np.where(read, derived.scale * np.prod(factors, axis=0), np.nan)
            faults = [bad[source] for source in derived.product if source in bad]
            if faults:
                bad[name] = np.any(faults, axis=0)
                signals[name][bad[name]] = np.nan
    return replace(trace, signals=signals, bad=bad)


def _held(times: Array, values: Array, bad: Mask | None, gap: float) -> Array:
    """The last reading held over rows without one, not over bad readings and not over gaps."""
    ends = np.diff(times, prepend=-np.inf) > gap
    present = ~np.isnan(values) | ends | (np.zeros_like(ends) if bad is None else bad)
    return np.asarray(values[np.maximum.accumulate(np.where(present, np.arange(times.size), 0))])


def units(column_map: ColumnMap) -> Mapping[str, str]:
    """The unit of each signal that has one, for axes and tables."""
    derived = {name: column.unit for name, column in column_map.derived.items()}
    read = {name: column.unit for name, column in column_map.signals.items()}
    return {name: unit for name, unit in (derived | read).items() if unit}
