"""One file's rows as readings: wide or long, each with its time and line, what cannot be used counted and named."""

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim.lab.recordings.cells import SWITCH_WORDS, booleans, numbers
from sim.lab.recordings.clock import clock_columns, read_clock, to_utc
from sim.lab.recordings.column_map import ColumnMap, Long, Names, SignalColumn
from sim.lab.recordings.load_report import FileReport, TraceError, listed
from sim.lab.recordings.text_table import TextLayout, find_layout, place_of, read_rows
from sim.sha import Array, Mask

Rows = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Series:
    """A signal's readings: `rows` of the file's rows that have one, `values` (NaN where `bad`)."""

    rows: Rows
    values: Array
    bad: Mask


@dataclass(frozen=True, slots=True)
class FileReadings:
    """n rows in file order: `times` in seconds, `lines` of `files`, and each signal's series over them."""

    times: Array
    lines: Rows
    files: Rows
    series: Mapping[str, Series]
    comments: tuple[str, ...] = ()


def read_file(path: Path, column_map: ColumnMap, report: FileReport) -> FileReadings:
    """The readings of one file. Raises TraceError when nothing of it can be used, OSError when it cannot be read."""
    layout = _layout(path, column_map, report)
    if column_map.long is None:
        readings = _read_wide(path, layout, column_map, report)
    else:
        readings = _read_long(path, layout, column_map, column_map.long, report)
    if not readings.times.size:
        why = f": {report.reasons.most_common(1)[0][0]}" if report.reasons else ""
        raise TraceError(f"{path}: none of its {report.rows} rows can be used{why or '; there is only a header'}")
    return readings


def unread_hash(path: Path, column_map: ColumnMap) -> str:
    """SHA-256 (hex) over what a file has beside the columns that a map reads; of a long one over the whole table.

    Numbers count as numbers and other cells without the blanks around them, so that separators, comments, line ends and
    the order of columns do not count. Raises TraceError for a file that the map does not fit, OSError.
    """
    report = FileReport(path)
    layout = _layout(path, column_map, report)
    read: set[int | None] = {_needed(layout, names) for names in clock_columns(column_map.clock)}
    read |= {place_of(layout.header, column_map.names_of(name)) for name in column_map.signals}
    if column_map.extra:
        read |= set(range(len(layout.header)))
    # What a long file says of signals that are not in the map stands in the columns that the map does read.
    others = [index for index in range(len(layout.header)) if column_map.long is not None or index not in read]
    digests = {index: sha256(f"{layout.header[index]}\n".encode()) for index in others}
    for _, rows in read_rows(path, layout, column_map.comment, report):
        for index, digest in digests.items():
            cells = [row[index] for row in rows]
            values, _ = numbers(cells, column_map.decimal)
            pairs = zip(cells, values.tolist(), strict=True)
            plain = [repr(value) if value == value else cell.strip() for cell, value in pairs]
            digest.update("".join(f"{cell}\n" for cell in plain).encode("utf-8", "surrogatepass"))
    return sha256("".join(sorted(digest.hexdigest() for digest in digests.values())).encode()).hexdigest()


def _layout(path: Path, column_map: ColumnMap, report: FileReport) -> TextLayout:
    """How the file is written, its header found by the columns that the map cannot do without. Raises TraceError."""
    long = column_map.long
    if long is None:
        sources = [() if column_map.temperature in column_map.derived else column_map.names_of(column_map.temperature)]
    else:
        sources = [long.name, long.value, *([long.object] if long.objects else [])]
    return find_layout(path, column_map, [*clock_columns(column_map.clock), *filter(None, sources)], report)


def _chunks(
    path: Path, layout: TextLayout, column_map: ColumnMap, report: FileReport
) -> Iterator[tuple[list[int], list[list[str]], Array, Mask]]:
    """Rows with a time, in chunks: lines, cells, seconds, and whether the time zone is to be applied yet."""
    places = [_needed(layout, names) for names in clock_columns(column_map.clock)]
    for lines, rows in read_rows(path, layout, column_map.comment, report):
        cells = [[row[place] for row in rows] for place in places]
        seconds, local = read_clock(column_map.clock, cells, column_map.decimal)
        timeless = np.flatnonzero(np.isnan(seconds)).tolist()
        if timeless:
            shown = ["'" + " ".join(column[index].strip() for column in cells)[:60] + "'" for index in timeless[:20]]
            report.refuse([lines[index] for index in timeless], "it has no time that the map's formats fit", shown)
            kept = np.flatnonzero(~np.isnan(seconds)).tolist()
            lines, rows = [lines[index] for index in kept], [rows[index] for index in kept]
            seconds, local = seconds[kept], local[kept]
        if lines:
            yield lines, rows, seconds, local


def _needed(layout: TextLayout, names: Names) -> int:
    place = place_of(layout.header, names)
    if place is None:  # find_layout has made sure of it
        raise TraceError(f"there is no column {names[0]!r}; the columns are {listed(layout.header)}")
    return place


def _convert(
    name: str, signal: SignalColumn, cells: list[str], column_map: ColumnMap, report: FileReport
) -> tuple[Array, dict[str, Mask]]:
    """Values in the signal's unit, and by reason the cells that cannot be used (their value is NaN)."""
    if signal.boolean:
        values, wrong = booleans(cells, signal.on, signal.off)
        if wrong.any():
            pairs = ([(signal.on, signal.off)] if signal.on or signal.off else []) + list(SWITCH_WORDS)
            known = ", ".join(f"{'/'.join(on)} and {'/'.join(off)}" for on, off in pairs)
            own = f'{name} = {{ on = ["..."], off = ["..."] }}'
            report.warn(f"words of {name} that are accepted are {known}; the column map can name others: {own}")
    else:
        values, wrong = numbers(cells, column_map.decimal)
    kind = "neither true nor false" if signal.boolean else "no number"
    absent = np.isin(values, signal.missing) if signal.missing else np.zeros(values.shape, dtype=bool)
    values = values * signal.scale + signal.offset if (signal.scale, signal.offset) != (1.0, 0.0) else values
    low = -np.inf if signal.low is None else signal.low
    high = np.inf if signal.high is None else signal.high
    outside = ~absent & ((values < low) | (values > high))
    values[absent | outside] = np.nan
    limits = f"outside {low:g}..{high:g} {signal.unit}".rstrip()
    faults = {kind: wrong, "the device's word for not available": absent, limits: outside}
    return values, {f"{name} is {why}": mask for why, mask in faults.items() if mask.any()}


def _count_faults(report: FileReport, lines: Sequence[int], cells: Sequence[str], faults: Mapping[str, Mask]) -> Mask:
    """Count the faults; the mask of all bad cells."""
    bad = np.zeros(len(lines), dtype=bool)
    for reason, mask in faults.items():
        where = np.flatnonzero(mask).tolist()
        report.bad([lines[index] for index in where], reason, [repr(cells[index][:60]) for index in where[:20]])
        bad |= mask
    return bad


def _read_wide(path: Path, layout: TextLayout, column_map: ColumnMap, report: FileReport) -> FileReadings:
    places: dict[str, tuple[int, SignalColumn]] = {}
    for name, signal in column_map.signals.items():
        place = place_of(layout.header, column_map.names_of(name))
        if place is not None:
            places[name] = (place, signal)
        elif name not in column_map.derived:
            report.notes.append(f"there is no column {' or '.join(map(repr, column_map.names_of(name)))}: no {name}")
    if column_map.extra:
        taken = {place for place, _ in places.values()} | {
            _needed(layout, names) for names in clock_columns(column_map.clock)
        }
        others = [index for index in range(len(layout.header)) if index not in taken]
        places.update({layout.header[index]: (index, SignalColumn()) for index in others})
    for name, count in Counter(layout.header).items():
        if count > 1:
            report.notes.append(f"there are {count} columns {name!r}; the first is taken")
    values: dict[str, list[Array]] = {name: [] for name in places}
    bad: dict[str, list[Mask]] = {name: [] for name in places}
    clock: list[tuple[list[int], Array, Mask]] = []
    for lines, rows, seconds, local in _chunks(path, layout, column_map, report):
        clock.append((lines, seconds, local))
        for name, (place, signal) in places.items():
            cells = [row[place] for row in rows]
            column, faults = _convert(name, signal, cells, column_map, report)
            values[name].append(column)
            bad[name].append(_count_faults(report, lines, cells, faults))
    series = {}
    for name in places if clock else ():
        column, fault = np.concatenate(values[name]), np.concatenate(bad[name])
        # An empty cell is no reading; one that holds something unusable is a reading of bad quality.
        present = np.flatnonzero(fault | ~np.isnan(column))
        series[name] = Series(present, column[present], fault[present])
    return _finished(clock, series, layout, column_map, report)


def _read_long(path: Path, layout: TextLayout, column_map: ColumnMap, long: Long, report: FileReport) -> FileReadings:
    names = {alias: name for name in column_map.signals for alias in column_map.names_of(name)}
    pieces: dict[str, list[Series]] = {}
    clock: list[tuple[list[int], Array, Mask]] = []
    unmapped: Counter[str] = Counter()
    start = 0
    name_at, value_at = _needed(layout, long.name), _needed(layout, long.value)
    object_at = _needed(layout, long.object) if long.objects else None
    for lines, rows, seconds, local in _chunks(path, layout, column_map, report):
        clock.append((lines, seconds, local))
        groups: defaultdict[str, list[int]] = defaultdict(list)
        for index, row in enumerate(rows):
            known = object_at is None or row[object_at].strip() in long.objects
            groups[row[name_at].strip() if known else ""].append(index)
        for field, where in groups.items():
            if field not in names:
                report.aside += len(where)
                unmapped[field or "another object"] += len(where)
                continue
            name, cells = names[field], [rows[index][value_at] for index in where]
            values, faults = _convert(name, column_map.signals[name], cells, column_map, report)
            # A row of a long file is there to say something: a blank value says that there was none to be had.
            blank = np.array([not cell.strip() for cell in cells], dtype=bool)
            if blank.any():
                faults[f"{name} is blank"] = blank
            bad = _count_faults(report, [lines[index] for index in where], cells, faults)
            pieces.setdefault(name, []).append(Series(np.array(where, dtype=np.intp) + start, values, bad))
        start += len(lines)
    if unmapped:
        report.notes.append(f"rows of {listed(unmapped)} are not in the map")
    series = {name: _joined(parts) for name, parts in pieces.items()}
    return _finished(clock, series, layout, column_map, report)


def _joined(parts: Sequence[Series]) -> Series:
    return Series(
        np.concatenate([part.rows for part in parts]),
        np.concatenate([part.values for part in parts]),
        np.concatenate([part.bad for part in parts]),
    )


def _finished(
    clock: Sequence[tuple[list[int], Array, Mask]],
    series: Mapping[str, Series],
    layout: TextLayout,
    column_map: ColumnMap,
    report: FileReport,
) -> FileReadings:
    """Local times to UTC, and without the rows whose local time never was or that no signal of the map has."""
    if not clock:
        empty = np.empty(0, dtype=np.intp)
        return FileReadings(np.empty(0), empty, empty, {}, layout.comments)
    lines = np.concatenate([np.array(chunk[0], dtype=np.intp) for chunk in clock])
    seconds = np.concatenate([chunk[1] for chunk in clock])
    local = np.concatenate([chunk[2] for chunk in clock])
    if local.any() and not local.all():
        report.warn(
            f"{int(local.sum())} of its times have no time zone (the first on line {lines[local][0]}) and "
            f"{int((~local).sum())} have one: those without are read in {column_map.clock.timezone}; "
            "if they are not, give clock.timezone"
        )
    newest_first = _newest_first(seconds)
    if newest_first:
        report.warn("its newest row comes first; it is read from its end")
        lines, seconds, local = lines[::-1], seconds[::-1], local[::-1]
        last = lines.size - 1
        series = {name: Series(last - s.rows[::-1], s.values[::-1], s.bad[::-1]) for name, s in series.items()}
    times = to_utc(seconds, local, column_map.clock.timezone)
    mentioned = np.ones(times.shape, dtype=bool)
    if column_map.format == "long":
        mentioned[:] = False
        for column in series.values():
            mentioned[column.rows] = True
    never = np.isnan(times)
    report.refuse(lines[never & mentioned].tolist(), f"its local time never was in {column_map.clock.timezone}")
    everything = FileReadings(times, lines, np.zeros_like(lines), series, layout.comments)
    return select(everything, np.flatnonzero(~never & mentioned))


def _newest_first(seconds: Array) -> bool:
    """Whether a clock goes back far more often than forward, and in all; a clock that was set back once does not.

    Before time zones and midnights are worked out: both need the rows in the order in which they were measured.
    """
    steps = np.diff(seconds)
    back, forward = int((steps < 0).sum()), int((steps > 0).sum())
    return back >= 2 and back > 4 * forward


def select(readings: FileReadings, order: Rows) -> FileReadings:
    """The rows `order` in that order; readings of other rows are left out."""
    place = np.full(readings.times.shape, -1, dtype=np.intp)
    place[order] = np.arange(order.size)
    series = {}
    for name, column in readings.series.items():
        rows = place[column.rows]
        kept = np.flatnonzero(rows >= 0)
        # Stable: readings of one row keep the order of the file, as the last of them is the one that counts.
        kept = kept[np.argsort(rows[kept], kind="stable")]
        series[name] = Series(rows[kept], column.values[kept], column.bad[kept])
    return FileReadings(readings.times[order], readings.lines[order], readings.files[order], series, readings.comments)


def joined(parts: Sequence[FileReadings]) -> FileReadings:
    """The readings of several files, one after the other; `files` counts them."""
    starts = np.cumsum([0, *(part.times.size for part in parts)])
    pieces: dict[str, list[Series]] = {}
    for part, start in zip(parts, starts.tolist(), strict=False):
        for name, column in part.series.items():
            pieces.setdefault(name, []).append(Series(column.rows + start, column.values, column.bad))
    return FileReadings(
        np.concatenate([part.times for part in parts]),
        np.concatenate([part.lines for part in parts]),
        np.concatenate([np.full(part.times.shape, index, dtype=np.intp) for index, part in enumerate(parts)]),
        {name: _joined(series) for name, series in pieces.items()},
        tuple(comment for part in parts for comment in part.comments),
    )
