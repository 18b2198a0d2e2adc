"""One file's rows as readings: wide or long, each with its time and line, what cannot be used counted and named."""

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim.lab.recordings.cells import NO_VALUES, SWITCH_WORDS, booleans, numbers
from sim.lab.recordings.clock import clock_columns, read_clock, to_utc
from sim.lab.recordings.column_map import ColumnMap, Long, Names, SignalColumn
from sim.lab.recordings.fault_codes import find_codes
from sim.lab.recordings.load_report import FileReport, TraceError, list_names
from sim.lab.recordings.sources import named_after, recording_name
from sim.lab.recordings.text_table import UNNAMED_COLUMN, TextLayout, find_column, find_layout, read_rows
from sim.sha import Array, Mask

Rows = NDArray[np.intp]
Whose = tuple[str, str]
"""A machine and a session."""


@dataclass(frozen=True, slots=True)
class Series:
    """A signal's readings: `rows` of the file's rows that have one, `values` (NaN where `bad`)."""

    rows: Rows
    values: Array
    bad: Mask


@dataclass(frozen=True, slots=True)
class FileReadings:
    """n rows in file order: `times` in seconds, `lines` of `files`, and each signal's series over them.

    `clock_cells` is how many cells each row's time stands in; `whose` are the machine and the session ("": nobody
    says).
    """

    times: Array
    lines: Rows
    files: Rows
    series: Mapping[str, Series]
    comments: tuple[str, ...] = ()
    clock_cells: int = 1
    whose: Whose = ("", "")


@dataclass(frozen=True, slots=True)
class _Chunk:
    """Rows with a time under one header: their lines, cells by column, times, which are local yet, and whose.

    `whose` is empty where no column says it.
    """

    header: tuple[str, ...]
    lines: Rows
    columns: list[list[str]]
    seconds: Array
    local: Mask
    whose: list[Whose]

    def select(self, rows: Rows) -> "_Chunk":
        """Some of the rows."""
        kept = rows.tolist()
        columns = [[column[index] for index in kept] for column in self.columns]
        whose = [self.whose[index] for index in kept] if self.whose else []
        return replace(
            self,
            lines=self.lines[rows],
            columns=columns,
            seconds=self.seconds[rows],
            local=self.local[rows],
            whose=whose,
        )


def read_file(path: Path, column_map: ColumnMap, report: FileReport) -> list[FileReadings]:
    """The readings of one file, by machine and session where columns say them, in the order of their first rows.

    Raises TraceError when nothing of it can be used, OSError when it cannot be read.
    """
    layout = _layout(path, column_map, report)
    if column_map.long is None:
        readings = _read_wide(path, layout, column_map, report)
    else:
        readings = _read_long(path, layout, column_map, column_map.long, report)
    if not any(each.times.size for each in readings):
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
    read: set[int | None] = {_required_columns(layout.header, names) for names in clock_columns(column_map.clock)}
    read |= {find_column(layout.header, column_map.signal_names(name)) for name in column_map.signals}
    if column_map.extra:
        read |= set(range(len(layout.header)))
    # What a long file says of signals that are not in the map stands in the columns that the map does read.
    others = [index for index in range(len(layout.header)) if column_map.long is not None or index not in read]
    digests = {index: sha256(f"{layout.header[index]}\n".encode()) for index in others}
    for current, lines, columns in read_rows(path, layout, column_map.comment, report):
        places = {index: find_column(current.header, (layout.header[index],)) for index in others}
        for index, digest in digests.items():
            place = places[index]
            cells = [""] * lines.size if place is None else columns[place]
            values, _ = numbers(cells, column_map.decimal)
            pairs = zip(cells, values.tolist(), strict=True)
            plain = [repr(value) if value == value else cell.strip() for cell, value in pairs]
            digest.update("".join(f"{cell}\n" for cell in plain).encode("utf-8", "surrogatepass"))
    return sha256("".join(sorted(digest.hexdigest() for digest in digests.values())).encode()).hexdigest()


def _layout(path: Path, column_map: ColumnMap, report: FileReport) -> TextLayout:
    """How the file is written, its header found by the columns that the map cannot do without. Raises TraceError."""
    long = column_map.long
    if long is not None:
        sources = [long.name, long.value, *([long.object] if long.objects else [])]
    elif column_map.parts or column_map.temperature in column_map.derived:
        sources = []
    else:
        sources = [_aliases(path, column_map, column_map.temperature)]
    by = [names for names in column_map.by_column if names]
    return find_layout(path, column_map, clock_columns(column_map.clock), [*sources, *by], report)


def _aliases(path: Path, column_map: ColumnMap, signal: str) -> Names:
    """The names under which a signal may come in one file: of a part also those that say the file's own name."""
    return _in_file(path, column_map, column_map.signal_names(signal))


def _in_file(path: Path, column_map: ColumnMap, names: Names) -> Names:
    if not column_map.parts:
        return names
    own = f"{recording_name(path)}/"
    return (*names, *(name.removeprefix(own) for name in names if name.startswith(own)))


def _chunks(path: Path, layout: TextLayout, column_map: ColumnMap, report: FileReport) -> Iterator[_Chunk]:
    """The rows with a time. What has none is refused."""
    for current, lines, columns in read_rows(path, layout, column_map.comment, report):
        header = current.header
        places = [_required_columns(header, names) for names in clock_columns(column_map.clock)]
        seconds, local = read_clock(column_map.clock, [columns[place] for place in places], column_map.decimal)
        chunk = _Chunk(header, lines, columns, seconds, local, whose=[])
        timeless = np.flatnonzero(np.isnan(seconds)).tolist()
        if timeless:
            shown = ["'" + " ".join(columns[at][index].strip() for at in places)[:60] + "'" for index in timeless[:20]]
            report.refuse(lines[timeless].tolist(), "it has no time that the map's formats fit", shown)
            report.refuse_cells(sum(_count_cells([column[index] for index in timeless]) for column in columns))
            chunk = chunk.select(np.flatnonzero(~np.isnan(seconds)))
        by = [find_column(header, names) if names else None for names in column_map.by_column]
        if any(place is not None for place in by):
            machine, session = (
                [""] * chunk.lines.size if at is None else list(map(str.strip, chunk.columns[at])) for at in by
            )
            owned = [column for column, at in ((machine, by[0]), (session, by[1])) if at is not None]
            somebodys = np.array([all(whose) for whose in zip(*owned, strict=True)], dtype=bool)
            chunk = replace(chunk, whose=list(zip(machine, session, strict=True)))
            if not somebodys.all():
                nobodys = np.flatnonzero(~somebodys).tolist()
                report.refuse(chunk.lines[nobodys].tolist(), "it does not say its machine or session")
                report.refuse_cells(sum(_count_cells([column[index] for index in nobodys]) for column in chunk.columns))
                chunk = chunk.select(np.flatnonzero(somebodys))
        if chunk.lines.size:
            report.cells += sum(map(_count_cells, chunk.columns))
            yield chunk


def _count_cells(cells: Sequence[str]) -> int:
    """How many of some cells hold something."""
    return sum(map(bool, map(str.strip, cells)))


def _required_columns(header: Sequence[str], names: Names) -> int:
    place = find_column(header, names)
    if place is None:  # find_layout has made sure of it, as has the row that was taken for a header
        raise TraceError(f"there is no column {names[0]!r}; the columns are {list_names(header)}")
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
        plain = (signal.scale, signal.offset) == (1.0, 0.0)
        values, wrong = numbers(cells, column_map.decimal, signal.unit if plain else "")
    kind = "neither true nor false" if signal.boolean else "no number"
    absent = np.isin(values, signal.bad) if signal.bad else np.zeros(values.shape, dtype=bool)
    values = values * signal.scale + signal.offset if (signal.scale, signal.offset) != (1.0, 0.0) else values
    low = -np.inf if signal.low is None else signal.low
    high = np.inf if signal.high is None else signal.high
    outside = ~absent & ((values < low) | (values > high))
    values[absent | outside] = np.nan
    limits = f"outside {low:g}..{high:g} {signal.unit}".rstrip()
    faults = {kind: wrong, "the device's word for not available": absent, limits: outside}
    return values, {f"{name} is {why}": mask for why, mask in faults.items() if mask.any()}


def _not_good(place: int, columns: Sequence[Sequence[str]], places: Sequence[int], column_map: ColumnMap) -> Mask:
    """(n,) the rows whose reading in the column at `place` is not good, by the one of the quality `places` of it."""
    quality = column_map.quality
    if quality is None or not places:
        return np.zeros(len(columns[place]), dtype=bool)
    at = next((each for each in places if each > place), places[-1])
    good = {word.casefold() for word in quality.good}
    return np.array([cell.strip().casefold() not in good for cell in columns[at]], dtype=bool)


def _reject_values(name: str, values: Array, not_good: Mask) -> dict[str, Mask]:
    """The fault of those of the values that are not good, which become NaN."""
    mask = not_good & np.isfinite(values)
    values[mask] = np.nan
    return {f"{name} is not of a good quality": mask} if mask.any() else {}


def _quality_places(path: Path, chunk: _Chunk, column_map: ColumnMap, report: FileReport) -> list[int]:
    """The places of the columns that say how good readings are, whose cells are used up by that."""
    names = () if column_map.quality is None else column_map.quality.column
    found = {name: find_column(chunk.header, _in_file(path, column_map, (name,))) for name in names}
    places = sorted({place for place in found.values() if place is not None})
    # Of parts each has the quality of its own tags, or one that has none says it of all.
    if not column_map.parts:
        for name in (each for each, place in found.items() if place is None):
            report.warn(f"there is no column {name!r}, a quality by the map: no reading is refused by it")
    report.used_cells += sum(_count_cells(chunk.columns[place]) for place in places)
    return places


def judged(readings: FileReadings, files: Sequence[FileReport]) -> FileReadings:
    """The readings without those that a quality in a file of its own calls bad; its word holds until the next one.

    It is of the file that it is named after, or of all where it is the only one. What stands before its first word is
    judged by none, and is not good.
    """
    quality = readings.series.get(_OF_OTHERS)
    if quality is None:
        return readings
    names = {index: recording_name(file.path) for index, file in enumerate(files)}
    of_rows = readings.files[quality.rows]
    judges = set(np.unique(of_rows).tolist())
    not_good = np.zeros(readings.times.size, dtype=bool)
    for judge in judges:
        owner = named_after(names[judge], [name for index, name in names.items() if index not in judges])
        if not owner and len(judges) > 1:
            files[judge].warn("its quality judges nothing: it is named after no file, and other files have a quality")
            continue
        said, words = readings.times[quality.rows][of_rows == judge], quality.values[of_rows == judge]
        order = np.argsort(said, kind="stable")
        at = np.searchsorted(said[order], readings.times, "right")
        own = np.isin(readings.files, [index for index, name in names.items() if owner in ("", name)])
        not_good |= own & (np.concatenate(([0.0], words[order]))[at] == 0.0)
    series = {}
    for name, column in readings.series.items():
        if name == _OF_OTHERS:
            continue
        values, bad = column.values.copy(), column.bad.copy()
        for reason, mask in _reject_values(name, values, not_good[column.rows]).items():
            for index, file in enumerate(files):
                own_rows = column.rows[mask & (readings.files[column.rows] == index)]
                file.bad(readings.lines[own_rows].tolist(), reason, [])
            bad |= mask
        series[name] = Series(column.rows, values, bad)
    return replace(readings, series=series)


_OF_OTHERS = ""
"""The series of a quality in a file of its own: 1 where the readings of the other files are good, 0 where not."""


def _count_faults(report: FileReport, lines: Rows, cells: Sequence[str], faults: Mapping[str, Mask]) -> Mask:
    """Count the faults; the mask of all bad cells."""
    bad = np.zeros(lines.size, dtype=bool)
    for reason, mask in faults.items():
        where = np.flatnonzero(mask).tolist()
        report.bad(lines[where].tolist(), reason, [repr(cells[index][:60]) for index in where[:20]])
        bad |= mask
    return bad


def _read_wide(path: Path, layout: TextLayout, column_map: ColumnMap, report: FileReport) -> list[FileReadings]:
    signals = dict(column_map.signals)
    aliases = {name: _aliases(path, column_map, name) for name in signals}
    chunks: list[_Chunk] = []
    values: dict[str, list[Array]] = {}
    bad: dict[str, list[Mask]] = {}
    for chunk in _chunks(path, layout, column_map, report):
        taken = {_required_columns(chunk.header, names) for names in clock_columns(column_map.clock)}
        taken |= {place for names in column_map.by_column if (place := find_column(chunk.header, names)) is not None}
        qualities = _quality_places(path, chunk, column_map, report)
        taken.update(qualities)
        places = {name: place for name in aliases if (place := find_column(chunk.header, aliases[name])) is not None}
        if column_map.extra:
            others = [index for index in range(len(chunk.header)) if index not in {*taken, *places.values()}]
            places |= {chunk.header[index]: index for index in others}
            signals |= {chunk.header[index]: SignalColumn() for index in others}
            aliases |= {chunk.header[index]: (chunk.header[index],) for index in others}
        seen: set[int] = set()
        for name, place in places.items():
            cells = chunk.columns[place]
            column, faults = _convert(name, signals[name], cells, column_map, report)
            faults |= _reject_values(name, column, _not_good(place, chunk.columns, qualities, column_map))
            # Rows of the chunks before, under headers that did not have it.
            values.setdefault(name, [np.full(each.seconds.size, np.nan) for each in chunks]).append(column)
            own = bad.setdefault(name, [np.zeros(each.seconds.size, dtype=bool) for each in chunks])
            own.append(_count_faults(report, chunk.lines, cells, faults))
            if place in seen:
                report.cells += _count_cells(cells)  # one cell read as two signals counts twice
            seen.add(place)
        # Only a file that holds nothing else, but for the numbers of its rows, judges the others.
        alone = all(at in taken or name == UNNAMED_COLUMN for at, name in enumerate(chunk.header))
        if column_map.parts and qualities and not places and alone:
            said = np.array([bool(cell.strip()) for cell in chunk.columns[qualities[0]]], dtype=bool)
            good = 1.0 - _not_good(qualities[0] - 1, chunk.columns, qualities, column_map)
            values.setdefault(_OF_OTHERS, []).append(np.where(said, good, np.nan))
            bad.setdefault(_OF_OTHERS, []).append(np.zeros(said.shape, dtype=bool))
        for name in values.keys() - places.keys() - {_OF_OTHERS}:
            values[name].append(np.full(chunk.seconds.size, np.nan))
            bad[name].append(np.zeros(chunk.seconds.size, dtype=bool))
        for place in set(range(len(chunk.header))) - seen - taken:
            report.unused[chunk.header[place] or f"column {place + 1}"] += _count_cells(chunk.columns[place])
        chunk.columns.clear()
        chunks.append(chunk)
    # Of parts that have one tag each, a file is not asked for the tags of the others.
    if chunks and not (column_map.parts and len(values) == 1):
        for name in column_map.signals.keys() - values.keys() - column_map.derived.keys():
            names = " or ".join(map(repr, column_map.signal_names(name)))
            report.notes.append(f"there is no column {names}: no {name}")
    series = {}
    every = np.arange(sum(chunk.seconds.size for chunk in chunks))
    for name in list(values):
        column, fault = np.concatenate(values.pop(name)), np.concatenate(bad.pop(name))
        # An empty cell is no reading; one that holds something unusable is a reading of bad quality.
        present = fault | ~np.isnan(column)
        rows = every if present.all() else np.flatnonzero(present)
        series[name] = Series(rows, *((column, fault) if rows is every else (column[rows], fault[rows])))
    return _collect_readings(chunks, series, layout, column_map, report)


def _read_long(
    path: Path, layout: TextLayout, column_map: ColumnMap, long: Long, report: FileReport
) -> list[FileReadings]:
    names = {alias: name for name in column_map.signals for alias in column_map.signal_names(name)}
    pieces: dict[str, list[Series]] = {}
    chunks: list[_Chunk] = []
    unmapped: Counter[str] = Counter()
    start = 0
    for chunk in _chunks(path, layout, column_map, report):
        header, columns, lines = chunk.header, chunk.columns, chunk.lines
        name_at, value_at = _required_columns(header, long.name), _required_columns(header, long.value)
        values_at = [place for name in long.value if (place := find_column(header, (name,))) is not None]
        readings, beside = join_cells([columns[place] for place in values_at])
        for place, count in zip(values_at, beside, strict=True):
            report.unused[header[place]] += count
        object_at = _required_columns(header, long.object) if long.objects else None
        taken = {_required_columns(header, each) for each in clock_columns(column_map.clock)}
        taken |= {place for each in column_map.by_column if (place := find_column(header, each)) is not None}
        qualities = _quality_places(path, chunk, column_map, report)
        taken.update(qualities)
        for place in set(range(len(header))) - taken - set(values_at):
            # What says which reading a row is of is no reading itself.
            report.unused[header[place] or f"column {place + 1}"] += _count_cells(columns[place])
        groups: defaultdict[str, list[int]] = defaultdict(list)
        for index, field in enumerate(map(str.strip, columns[name_at])):
            known = object_at is None or columns[object_at][index].strip() in long.objects
            groups[field if known else ""].append(index)
        not_good = _not_good(value_at, columns, qualities, column_map)
        for field, where in groups.items():
            if field not in names:
                report.aside += len(where)
                what = field or "another object"
                unmapped[what] += len(where)
                cells = _count_cells([readings[index] for index in where])
                owners = len(clock_columns(column_map.clock)) + sum(map(bool, column_map.by_column))
                report.unused[what] += cells + len(where) * owners
                continue
            name, cells_ = names[field], [readings[index] for index in where]
            values, faults = _convert(name, column_map.signals[name], cells_, column_map, report)
            faults |= _reject_values(name, values, not_good[where])
            # A row of a long file is there to say something: a blank value says that there was none to be had.
            blank = np.array([not cell.strip() for cell in cells_], dtype=bool)
            if blank.any():
                faults[f"{name} is blank"] = blank
                report.cells += int(blank.sum())  # counted as bad, so counted as a cell
            bad = _count_faults(report, lines[where], cells_, faults)
            pieces.setdefault(name, []).append(Series(np.array(where, dtype=np.intp) + start, values, bad))
        start += lines.size
        chunk.columns.clear()
        chunks.append(chunk)
    if unmapped:
        report.notes.append(f"rows of {list_names(unmapped)} are not in the map")
    series = {name: _concatenate_series(parts) for name, parts in pieces.items()}
    return _collect_readings(chunks, series, layout, column_map, report)


def join_cells(columns: Sequence[Sequence[str]]) -> tuple[list[str], list[int]]:
    """Of the cells of each row the first that holds a value, the first column's where none does; and of each column how
    many of its cells hold something and stand beside one that was taken."""
    joined, beside = list(columns[0]), [0] * len(columns)
    without = [at for at, cell in enumerate(joined) if cell.strip().casefold() in NO_VALUES] if columns[1:] else []
    for place, column in enumerate(columns[1:], 1):
        free = [at for at in without if column[at].strip().casefold() not in NO_VALUES]
        for at in free:
            beside[0] += bool(joined[at].strip())
            joined[at] = column[at]
        beside[place] = sum(map(bool, map(str.strip, column))) - len(free)
        without = sorted(set(without).difference(free))
    return joined, beside


def _concatenate_series(parts: Sequence[Series]) -> Series:
    return Series(
        np.concatenate([part.rows for part in parts]),
        np.concatenate([part.values for part in parts]),
        np.concatenate([part.bad for part in parts]),
    )


def _collect_readings(
    chunks: Sequence[_Chunk],
    series: Mapping[str, Series],
    layout: TextLayout,
    column_map: ColumnMap,
    report: FileReport,
) -> list[FileReadings]:
    """By machine and session: local times to UTC, without rows whose local time never was or that no signal has."""
    if not chunks:
        return []
    lines = np.concatenate([chunk.lines for chunk in chunks])
    seconds = np.concatenate([chunk.seconds for chunk in chunks])
    local = np.concatenate([chunk.local for chunk in chunks])
    if local.any() and not local.all():
        report.warn(
            f"{int(local.sum())} of its times have no time zone (the first on line {lines[local][0]}) and "
            f"{int((~local).sum())} have one: those without are read in {column_map.clock.timezone}; "
            "if they are not, give clock.timezone"
        )
    _say_codes(series, column_map, report)
    zeros = np.zeros_like(lines)
    cells = len(clock_columns(column_map.clock)) + sum(map(bool, column_map.by_column))
    everything = FileReadings(seconds, lines, zeros, series, layout.comments, clock_cells=cells)
    if not any(column_map.by_column):
        return [_on_one_clock(everything, local, column_map, report)]
    owners: dict[Whose, list[int]] = {}
    for row, whose in enumerate(whose for chunk in chunks for whose in chunk.whose):
        owners.setdefault(whose, []).append(row)
    found = []
    for whose, rows in owners.items():
        own = np.array(rows, dtype=np.intp)
        found.append(replace(_on_one_clock(select(everything, own), local[own], column_map, report), whose=whose))
    return found


def _say_codes(series: Mapping[str, Series], column_map: ColumnMap, report: FileReport) -> None:
    for name, column in series.items():
        signal = column_map.signals.get(name)
        if signal is not None and signal.boolean:
            continue
        for code, count in find_codes(column.values).items():
            report.warn(
                f"{count} readings of {name} are {code:g}, a number that devices send where they have no reading; "
                f"if it is one, the column map's bad = [{code:g}] for {name} refuses it"
            )


def _on_one_clock(readings: FileReadings, local: Mask, column_map: ColumnMap, report: FileReport) -> FileReadings:
    seconds, lines, series = readings.times, readings.lines, readings.series
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
    everything = replace(readings, times=times, lines=lines, series=series)
    why = f"its local time never was in {column_map.clock.timezone}"
    refuse_rows(everything, never & mentioned, why, [report])
    return select(everything, np.flatnonzero(~never & mentioned))


def refuse_rows(readings: FileReadings, rows: Mask, reason: str, reports: Sequence[FileReport]) -> None:
    """Count rows that cannot be used, and their cells that could."""
    for index, report in enumerate(reports):
        own = rows & (readings.files == index)
        if own.any():
            report.refuse(readings.lines[own].tolist(), reason)
            report.refused_cells += count_usable_cells(readings, own)


def count_usable_cells(readings: FileReadings, rows: Mask) -> int:
    """The cells of some rows that can be used: those of the clock and the good readings."""
    good = sum(int((rows[series.rows] & ~series.bad).sum()) for series in readings.series.values())
    return good + readings.clock_cells * int(rows.sum())


def _newest_first(seconds: Array) -> bool:
    """Whether a clock goes back far more often than forward, and in all; a clock that was set back once does not.

    Before time zones and midnights are worked out: both need the rows in the order in which they were measured.
    """
    steps = np.diff(seconds)
    back, forward = int((steps < 0).sum()), int((steps > 0).sum())
    return back >= 2 and back > 4 * forward


def select(readings: FileReadings, order: Rows) -> FileReadings:
    """The rows `order` in that order; readings of other rows are left out."""
    if order.size == readings.times.size and np.array_equal(order, np.arange(order.size)):
        return readings  # all of them, as they are: a copy of a million rows would cost their memory again
    place = np.full(readings.times.shape, -1, dtype=np.intp)
    place[order] = np.arange(order.size)
    series = {}
    for name, column in readings.series.items():
        rows = place[column.rows]
        kept = np.flatnonzero(rows >= 0)
        # Stable: readings of one row keep the order of the file, as the last of them is the one that counts.
        kept = kept[np.argsort(rows[kept], kind="stable")]
        series[name] = Series(rows[kept], column.values[kept], column.bad[kept])
    return replace(
        readings, times=readings.times[order], lines=readings.lines[order], files=readings.files[order], series=series
    )


def concatenate_readings(parts: Sequence[FileReadings]) -> FileReadings:
    """The readings of several files, one after the other."""
    if len(parts) == 1:
        return parts[0]
    starts = np.cumsum([0, *(part.times.size for part in parts)])
    pieces: dict[str, list[Series]] = {}
    for part, start in zip(parts, starts.tolist(), strict=False):
        for name, column in part.series.items():
            pieces.setdefault(name, []).append(Series(column.rows + start, column.values, column.bad))
    return FileReadings(
        np.concatenate([part.times for part in parts]),
        np.concatenate([part.lines for part in parts]),
        np.concatenate([part.files for part in parts]),
        {name: _concatenate_series(series) for name, series in pieces.items()},
        tuple(comment for part in parts for comment in part.comments),
        clock_cells=parts[0].clock_cells,
        whose=parts[0].whose,
    )
