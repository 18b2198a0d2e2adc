"""Traces from CSV files: rows in order on one clock, equal times merged, gaps left open, events encoded."""

import fnmatch
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sim.sha import Array, Mask, Trace, encode
from sim.traces.clock import longest_rising, unroll_midnight
from sim.traces.column_map import ColumnMap, Derived
from sim.traces.load_report import FileReport, LoadReport, TraceError
from sim.traces.readings import FileReadings, Rows, Series, joined, read_file, select

Source = str | Path | Iterable[str | Path]
SYNTHETIC = "SYNTHETIC"
"""A comment that begins with this word says that no plant made the rows."""


def load_traces(source: Source, column_map: ColumnMap) -> tuple[list[Trace], LoadReport]:
    """The traces of files, folders or patterns (`runs/*.csv`), with what became of every row.

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
        traces += [replace(one, name=f"{name}-{n}" if n > 1 else name) for n, one in enumerate(loaded, 1)]
    report = LoadReport(tuple(reports))
    if not traces:
        asked = source if isinstance(source, str | Path) else ", ".join(map(str, source))
        errors = report.errors or (f"{asked}: there is no CSV file there; give a file, a folder or a pattern",)
        more = f" (and {len(errors) - 1} more files like it)" if len(errors) > 1 else ""
        raise TraceError(errors[0] + more, report)
    return traces, report


def _files(source: Source, column_map: ColumnMap) -> list[Path]:
    given = [source] if isinstance(source, str | Path) else list(source)
    found = [path for one in given for path in _expanded(Path(one).expanduser(), column_map.parts)]
    return list(dict.fromkeys(found))


def _expanded(path: Path, parts: str) -> list[Path]:
    if path.is_dir():
        return _csv_files(path.iterdir(), parts) or _csv_files(path.rglob("*"), parts)
    if not path.exists() and any(mark in str(path) for mark in "*?["):
        anchor = Path(path.anchor)
        return sorted(one for one in anchor.glob(str(path.relative_to(anchor))) if one.is_file())
    return [path]


def _csv_files(paths: Iterable[Path], parts: str) -> list[Path]:
    files = [one for one in paths if one.suffix.lower() == ".csv" and one.is_file() and not one.name.startswith(".")]
    return sorted([one for one in files if parts and fnmatch.fnmatch(one.name, parts)] or files)


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
    origin = _comment_value(readings.comments, "origin:") or _origin([file.path for file in used])
    synthetic = column_map.synthetic or any(comment.startswith(SYNTHETIC) for comment in readings.comments)
    traces = []
    for piece in _in_order(readings, column_map, used):
        if not _has_temperature(piece, column_map, used):
            continue
        trace = Trace(used[0].path.stem, *_merged(piece, column_map, used), origin=origin, synthetic=synthetic)
        traces.append(_completed(trace, column_map))
    if not traces:
        raise TraceError(f"{used[0].path}: there is no reading of {column_map.temperature} in it that can be used")
    _note(used, traces, column_map)
    return traces


def _has_temperature(piece: FileReadings, column_map: ColumnMap, files: Sequence[FileReport]) -> bool:
    """Whether there is a temperature in these rows; if not, they are refused."""
    name = column_map.temperature
    if name in column_map.derived or (name in piece.series and not piece.series[name].bad.all()):
        return True
    for index, file in enumerate(files):
        lines = piece.lines[piece.files == index]
        file.refuse(lines.tolist(), f"there is no reading of {name} in its part of the trace")
    return False


def _comment_value(comments: Iterable[str], key: str) -> str:
    return next((comment.removeprefix(key).strip() for comment in comments if comment.startswith(key)), "")


def _origin(paths: Sequence[Path]) -> str:
    return str(paths[0]) if len(paths) == 1 else f"{paths[0].parent} ({len(paths)} files)"


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
        known = column_map.signals.get(name)
        average = column_map.duplicates == "average" and not (known is not None and known.boolean)
        signals[name], bad[name] = (_average if average else _last)(series, group[series.rows], times.size)
    return times, signals, (), {name: mask for name, mask in bad.items() if mask.any()}


def _last(series: Series, group: Rows, size: int) -> tuple[Array, Mask]:
    # Of several values assigned to one place numpy keeps the last.
    values, bad = np.full(size, np.nan), np.zeros(size, dtype=bool)
    values[group], bad[group] = series.values, series.bad
    return values, bad


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
    """With held and derived signals, and the events of the map's alphabet."""
    signals = dict(trace.signals)
    bad = dict(trace.bad)
    for name, signal in column_map.signals.items():
        if signal.hold and name in signals:
            signals[name] = _held(trace.times, signals[name], bad.get(name), column_map.alphabet.gap)
    for name, derived in column_map.derived.items():
        if name not in signals:
            _derive(name, derived, trace.times, (signals, bad), column_map.alphabet.gap)
    completed = replace(trace, signals=signals, bad=bad)
    return replace(completed, events=encode(completed, column_map.alphabet))


def _held(times: Array, values: Array, bad: Mask | None, gap: float) -> Array:
    """The last reading held over rows without one, not over bad readings and not over gaps."""
    ends = np.diff(times, prepend=-np.inf) > gap
    present = ~np.isnan(values) | ends | (np.zeros_like(ends) if bad is None else bad)
    return np.asarray(values[np.maximum.accumulate(np.where(present, np.arange(times.size), 0))])


def _derive(
    name: str, derived: Derived, times: Array, known: tuple[dict[str, Array], dict[str, Mask]], gap: float
) -> None:
    """Put a derived signal to the `known` ones (signals, bad), where its sources are among them."""
    signals, bad = known
    if derived.constant is not None:
        signals[name] = np.full(times.size, derived.constant)
    elif not all(source in signals for source in derived.sources):
        return
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


def _note(files: Sequence[FileReport], traces: Sequence[Trace], column_map: ColumnMap) -> None:
    """What a reader of the report should know beyond refused rows."""
    gap = column_map.alphabet.gap
    gaps = sum(int((np.diff(trace.times) > gap).sum()) for trace in traces)
    lacking = [channel.signal for channel in column_map.alphabet.channels if channel.signal not in traces[0].signals]
    notes = {
        f"{gaps} gaps of more than {gap:g} s are left open": gaps > 0,
        f"no signal {', '.join(lacking)}: its events cannot be seen": bool(lacking),
    }
    files[0].notes += [note for note, holds in notes.items() if holds]


def units(column_map: ColumnMap) -> Mapping[str, str]:
    """The unit of each signal that has one, for axes and tables."""
    derived = {name: one.unit for name, one in column_map.derived.items()}
    read = {name: one.unit for name, one in column_map.signals.items()}
    return {name: unit for name, unit in (derived | read).items() if unit}
