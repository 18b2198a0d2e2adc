"""A column map drafted from a file, as commented TOML that loads as it stands."""

import json
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from sim.lab.recordings import (
    NO_VALUES,
    UNNAMED_COLUMN,
    LoadReport,
    Points,
    TraceError,
    conversion,
    csv_files,
    find_codes,
    known_unit,
    list_names,
    load_traces,
    numbers,
    parse_map,
    rewrite_points,
    round_value,
    wall_zone,
    zone_problem,
)
from sim.lab.recordings.mapping.answers import Answers, Undecided
from sim.lab.recordings.mapping.clocks import FoundClock
from sim.lab.recordings.mapping.columns import FoundColumn, describe_column, find_decimal, find_points
from sim.lab.recordings.mapping.decide import (
    COLDEST,
    HOTTEST,
    Parts,
    check_scale,
    check_temperature,
    choose_clock,
    choose_parts,
    sample_seconds,
    with_units,
    with_words,
)
from sim.lab.recordings.mapping.folder import one_table
from sim.lab.recordings.mapping.quality import FoundQuality, find_quality
from sim.lab.recordings.mapping.rest import check_rest
from sim.lab.recordings.mapping.rows import Rows, Stored, describe_rows, find_storage, separate_times
from sim.lab.recordings.mapping.table import FoundTable, find_table, with_joined, with_rows
from sim.lab.recordings.mapping.words import (
    ROLE_WORDS,
    current_score,
    load_score,
    named_entity,
    named_name,
    named_unit,
    named_value,
)
from sim.sha import Alphabet, Array, Bins, Trace

RUNNING_SIGNAL = "Running"
"""The name of the switch that is derived where no column says whether the machine runs."""
_RARE = 0.05
"""Share of the readings that may lie beyond what a bearing reaches: more of them are of something hotter."""
_MAX_UNUSED_COLUMNS = 30
"""Columns that are named in a comment because they say nothing usable."""


@dataclass(frozen=True, slots=True)
class DraftedMap:
    """The map's TOML `text` and what was found: header names of the clock, temperature, current and switch ("": none).

    `rows` of the file's were used with it, of `of`; `account` is the line that adds up, `report` what else is to be
    said.
    """

    text: str
    clock: str
    temperature: str
    current: str
    running: str
    rows: int
    of: int
    account: tuple[str, ...]
    report: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _LongForm:
    """Places of the columns of a long file, and the objects that it has beside names."""

    name: int
    value: int
    object: int | None
    objects: tuple[str, ...]
    unit: int | None = None
    others: tuple[int, ...] = ()
    """Further columns of values, one a type, of which each row fills one."""


@dataclass(frozen=True, slots=True)
class _Marks:
    """The file's `decimal` mark, what lone points are in columns of a file with decimal commas, and by header why a
    column's numbers cannot be told."""

    decimal: Literal["auto", ".", ","]
    points: Mapping[str, Points]
    unclear: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class _Found:
    """All that a map is written from."""

    table: FoundTable
    clock: FoundClock
    long: _LongForm | None
    columns: Sequence[FoundColumn]
    parts: Parts
    rows: Rows
    quality: FoundQuality
    stored: Stored
    marks: "_Marks"
    derived: str


def draft_map(path: Path, answers: Answers, names: Mapping[str, str] | None = None, *, now: float) -> DraftedMap:
    """The column map that reads a file. Raises Undecided where a person must choose, TraceError where there is none.

    `names` are the signals' names by their headers, that of a derived switch by RUNNING_SIGNAL; others are made of the
    header. `now` is the time (s since 1970) by which dates of the future are told.
    """
    names = names or {}
    if answers.timezone and (problem := zone_problem(answers.timezone)):
        raise TraceError(f"--timezone: {problem}")
    if path.is_dir():
        table, clock = one_table(path, csv_files(path.iterdir(), ""), answers, now=now)
    else:
        table = find_table(path)
        clock = choose_clock(table, answers, now=now)
    times, local = sample_seconds(table, clock)
    # Rows without a time are refused when the map reads them: they decide nothing here either.
    timed = np.isfinite(times)
    table, times, local = with_rows(table, timed.tolist()), times[timed], local[timed]
    long = _long_form(table, clock)
    if long is not None:
        table = with_joined(table, [long.value, *long.others])
    series = [""] * times.size if long is None else [f"{row[long.name]}\n{_object(row, long)}" for row in table.rows]
    rows = describe_rows(table, clock, times, local, series=series, answers=answers)
    taken = {clock.place, clock.date, rows.machine, rows.session}
    if long is None:
        quality = find_quality(table, taken, answers)
    else:
        quality = find_quality(
            table, taken | {long.name, long.value, long.unit, *long.others}, answers, value=long.value
        )
    columns, own, marks = _columns(table, clock, long, taken | set(quality.places), separate_times(table, rows, times))
    columns = [replace(column, name=names.get(column.header, column.name)) for column in columns]
    columns = with_words(path, _number_equal_names(columns), own, answers)
    columns = with_units(path, columns, answers, table.header[clock.place])
    try:
        parts = choose_parts(path, columns, answers)
    except Undecided as open_point:
        open_point.columns = tuple(column.header for column in columns)
        raise
    columns = _without_unclear(path, columns, parts, marks, answers)
    check_temperature(path, columns, parts.temperature, answers)
    stored = find_storage(table, columns, own, parts.temperature, answers)
    derived = names.get(RUNNING_SIGNAL, RUNNING_SIGNAL)
    found = _Found(
        table=table,
        clock=clock,
        long=long,
        columns=columns,
        parts=parts,
        rows=rows,
        quality=quality,
        stored=stored,
        marks=marks,
        derived=derived,
    )
    # The current's levels, the usual step, the codes and changes of the unit are those of all rows: the map reads them.
    traces, report = _load_draft(path, _text(found))
    coded = [_with_codes(column, traces, slow=column.name == parts.temperature.name) for column in columns]
    running = derived if parts.running is None else parts.running.name
    of_bearing = coded[columns.index(parts.temperature)]
    check_scale(path, of_bearing, running, traces, answers)
    check_rest(path, of_bearing, running, coded, traces, answers)
    if any(now is not before for now, before in zip(coded, columns, strict=True)):
        found = replace(found, columns=coded)
        traces, report = _load_draft(path, _text(found))
    text = _text(found, report.alphabet)
    parse_map(text, str(path))
    said = report.sentences() if report.refused or report.errors else list(report.warnings)
    return DraftedMap(
        text=text,
        clock=table.header[clock.place],
        temperature=parts.temperature.header,
        current="" if parts.current is None else parts.current.header,
        running="" if parts.running is None else parts.running.header,
        rows=report.used,
        of=report.rows,
        account=tuple(f"{file.path}: {file.account()}" for file in report.files if not file.error),
        report=(*(f"{path}: {sentence}" for sentence in _conclusions(found)), *said),
    )


def _load_draft(path: Path, text: str) -> tuple[list[Trace], LoadReport]:
    return load_traces(path, parse_map(text, str(path)))


def _object(row: Sequence[str], long: _LongForm) -> str:
    return "" if long.object is None else row[long.object]


def _conclusions(found: _Found) -> list[str]:
    """What was concluded from the readings and not by a name: a person should look at it."""
    said = [*found.rows.said, *([found.quality.said] if found.quality.said else [])]
    if found.clock.why:
        header = found.table.header[found.clock.place]
        said.append(f"{header!r} is read in seconds: {found.clock.why}; another: --unit '{header}=min'")
    if found.stored.on_change:
        said.append(
            f"stored on change: {found.stored.why or 'as --stored says'}; values hold for up to "
            f"{found.stored.own[found.parts.temperature.header]:g} s"
        )
    for column in found.columns:
        if column.bad:
            codes = ", ".join(f"{code:g}" for code in column.bad)
            said.append(
                f"{column.header!r} holds {codes}: numbers that devices send where they have no reading; the "
                f"map's bad = "
                f"[{codes}] refuses them"
            )
        if column.beyond:
            said.append(
                f"{column.beyond} readings of {column.header!r} are below {COLDEST:g} or above {HOTTEST:g} degC, which "
                "no bearing is; the map's low and high refuse them"
            )
    said += [f"{header!r} is not used: it {why}" for header, why in found.marks.unclear.items()]
    unused = _unused(found)
    if unused:
        said.append(
            "columns that are not used, as they hold neither numbers nor a switch: "
            f"{list_names(unused, _MAX_UNUSED_COLUMNS)}"
        )
    return said


def _unused(found: _Found) -> list[str]:
    """The headers of columns that hold neither numbers nor a switch."""
    return [
        column.header
        for column in found.columns
        if column.kind not in ("number", "switch") and column.header not in found.marks.unclear
    ]


def _columns(
    table: FoundTable, clock: FoundClock, long: _LongForm | None, taken: Collection[int | None], times: Array
) -> tuple[list[FoundColumn], list[Array], _Marks]:
    """What each column, or each signal of a long file, holds, and the times of its cells; how numbers are marked."""
    if long is None:
        places = [p for p in range(len(table.header)) if p not in taken and table.header[p] not in ("", UNNAMED_COLUMN)]
        marks = _find_marks(table, places)
        _check_units(table, places)
        found = [
            describe_column(
                table.header[p],
                table.titles[p],
                table.units[p],
                _plain_cells(table, p, marks),
                decimal,
                beside=table.titles,
            )
            for p in places
            for decimal in ["." if table.header[p] in marks.unclear else marks.decimal]
        ]
        return found, [times] * len(found), marks
    marks = _find_marks(table, [long.value])
    if why := marks.unclear.get(table.header[long.value]):
        raise TraceError(f"{table.path}: {table.header[long.value]!r} {why}")
    values = _plain_cells(table, long.value, marks)
    cells: dict[str, list[str]] = {}
    own: dict[str, list[float]] = {}
    units: dict[str, str] = {}
    for row, value, time in zip(table.rows, values, times.tolist(), strict=True):
        cells.setdefault(row[long.name], []).append(value)
        own.setdefault(row[long.name], []).append(time)
        if long.unit is not None and row[long.unit]:
            unit = known_unit(row[long.unit])
            if units.setdefault(row[long.name], unit) != unit:
                raise TraceError(
                    f"{table.path}: readings of {row[long.name]!r} are in {units[row[long.name]] or 'no unit'} and in "
                    f"{row[long.unit]}: a signal has one unit; export it in one"
                )
    found = [
        describe_column(name, name, units.get(name, ""), each, marks.decimal, beside=cells)
        for name, each in cells.items()
        if name
    ]
    return found, [np.array(each) for name, each in own.items() if name], marks


def _check_units(table: FoundTable, places: Sequence[int]) -> None:
    """Raises TraceError for a column of units by which the rows of a wide file are in different ones."""
    for place in (each for each in places if named_unit(table.header[each])):
        units = {unit for cell in set(table.column(place)) if (unit := known_unit(cell))}
        # A and C are names of machines as well; only units of one quantity are surely none.
        if len(units) > 1 and not any(np.isnan(conversion(unit, min(units))[0]) for unit in units):
            raise TraceError(
                f"{table.path}: {table.header[place]!r} says that rows are in {' and in '.join(sorted(units))}: a "
                "signal has one unit; export it in one"
            )


_ONE_MARK = re.compile(r"[+-]?\d+([.,])\d+")
"""A number with one mark, which may be a decimal point or a decimal comma."""


_RARE_MARK = 0.2
"""Share of the filled cells with the rarer of two marks that makes a column unreadable; fewer are faults of cells."""


def _find_marks(table: FoundTable, places: Sequence[int]) -> _Marks:
    """How the numbers of the columns at `places` are marked."""
    decimal = find_decimal([table.column(place) for place in places], table.separator)
    points: dict[str, Points] = {}
    unclear: dict[str, str] = {}
    for place in places:
        header, cells = table.header[place], [cell for cell in table.column(place) if cell]
        meant = find_points(cells) if decimal == "," else "both"
        marked = [(cell, match[1]) for cell in cells if (match := _ONE_MARK.fullmatch(cell))]
        if decimal != ",":
            # 1,234 beside 950.5 sets thousands apart.
            marked = [(cell, mark) for cell, mark in marked if mark == "." or np.isnan(numbers([cell], ".")[0][0])]
        shown = {mark: cell for cell, mark in reversed(marked)}
        if meant == "decimal" or meant == "thousands":
            points[header] = meant
        elif meant == "either":
            unclear[header] = (
                f"has numbers like {shown['.']} in a file with decimal commas, and nothing tells whether the point is "
                f"a decimal one or sets apart thousands: export it with decimal commas"
            )
        elif meant == "both" and 2 * len(marked) > len(cells):
            rarer = min(sum(mark == each for _, mark in marked) for each in ".,")
            if rarer > _RARE_MARK * len(cells):
                unclear[header] = (
                    f"has numbers with a decimal point and with a decimal comma ({shown['.']}, {shown[',']}): export "
                    "it with one of them"
                )
    return _Marks(decimal, points, unclear)


def _plain_cells(table: FoundTable, place: int, marks: _Marks) -> list[str]:
    """A column's cells with its points as they are meant; of one that is unclear with points alone."""
    cells, header = table.column(place), table.header[place]
    if header in marks.unclear:
        return [cell.replace(",", ".") for cell in cells]
    return rewrite_points(cells, marks.points[header]) if header in marks.points else cells


def _without_unclear(
    where: object, columns: Sequence[FoundColumn], parts: Parts, marks: _Marks, answers: Answers
) -> list[FoundColumn]:
    """The columns, of which none is used whose numbers cannot be told. Raises TraceError for one that plays a part."""
    playing = {part.header for part in (parts.temperature, parts.current, parts.running, parts.standstill) if part}
    playing |= {part.header for part in parts.others}
    playing |= {answers.running, *answers.current, *(unit.rpartition("=")[0] for unit in answers.unit)}
    for header, why in marks.unclear.items():
        if header in playing:
            raise TraceError(f"{where}: {header!r} {why}")
    return [replace(each, kind="text") if each.header in marks.unclear else each for each in columns]


def _with_codes(column: FoundColumn, traces: Sequence[Trace], *, slow: bool) -> FoundColumn:
    """With the codes of all rows, which the sample may not have; a temperature's also with what no bearing reaches."""
    known = [trace for trace in traces if column.name in trace.signals]
    read = [trace.signals[column.name] for trace in known]
    if column.kind != "number" or not read:
        return column
    if slow and (beyond := int(sum(np.sum((own < COLDEST) | (own > HOTTEST)) for own in read))):
        every = sum(int(np.isfinite(own).sum()) for own in read)
        column = replace(column, beyond=beyond) if beyond <= _RARE * every else column
    if (column.scale, column.offset) != (1.0, 0.0):
        return column
    codes = {
        code
        for trace, own in zip(known, read, strict=True)
        for code in find_codes(own, slow_at=trace.times if slow else None)
    }
    if codes <= set(column.bad):
        return column
    return replace(column, bad=(*column.bad, *sorted(codes - set(column.bad))))


def _long_form(table: FoundTable, clock: FoundClock) -> _LongForm | None:
    """The columns of names and values, if the file has one row a reading; None for a wide one."""
    others = [place for place in range(len(table.header)) if place != clock.place]
    values = [place for place in others if named_value(table.header[place])]
    if not values and any(map(named_entity, table.header)):
        values = [place for place in others if table.header[place].casefold() == "state"]
    # Value and vValue: one reading told twice.
    told = [tuple(table.column(place)) for place in values]
    values = [place for number, place in enumerate(values) if told[number] not in told[:number]]
    words = {place: Counter(table.column(place)) for place in others if place not in values}
    # Names come again and again; numbers, qualities and comments are none, but where nothing else names.
    named = [
        place
        for place, distinct in words.items()
        if named_name(table.header[place])
        and not named_unit(table.header[place])
        and len(distinct) <= max(len(table.rows) / 2, 1)
    ]
    names = [p for p in named if sum(not _plain_number(word) for word in words[p]) > len(words[p]) / 2]
    names = names or [p for p in named if len(words[p]) > 1 and all(word.isdigit() for word in words[p])]
    rows = [[row[place] for place in values] for row in table.rows]
    told_of = (sum(cell.casefold() not in NO_VALUES for cell in cells) for cells in rows)
    if not values or not names or any(count > 1 for count in told_of):
        return None
    name = max(names, key=lambda place: (len(words[place]), place))
    unit = next((place for place in others if named_unit(table.header[place])), None)
    rest = [place for place in names if place not in (name, unit) and "object" in table.header[place].casefold()]
    found = _LongForm(name, values[0], None, (), unit, tuple(values[1:]))
    return replace(found, object=rest[0], objects=tuple(words[rest[0]])) if rest else found


def _plain_number(word: str) -> bool:
    return not word or word.replace(",", "").replace(".", "").lstrip("+-").isdigit()


def _number_equal_names(columns: Sequence[FoundColumn]) -> list[FoundColumn]:
    """The columns with a name each: equal ones are numbered."""
    taken: set[str] = set()
    apart: list[FoundColumn] = []
    for column in columns:
        name = column.name
        number = 2
        while name.casefold() in taken:
            name, number = f"{column.name}_{number}", number + 1
        taken.add(name.casefold())
        apart.append(replace(column, name=name))
    return apart


def _text(found: _Found, alphabet: Alphabet | None = None) -> str:
    """The map in TOML, with the thresholds and gap of an alphabet, else left to the readings."""
    quoted = _quote_text
    table, clock, long, parts = found.table, found.clock, found.long, found.parts
    temperature, rows, stored = parts.temperature, found.rows, found.stored
    decimal = found.marks.decimal if found.marks.decimal != "auto" else clock.decimal
    lines = [
        f"# Column map drafted from {table.path.name}; look it over, above all what stands behind #.",
        "",
        f'format = "{"wide" if long is None else "long"}"',
        f"separator = {quoted(table.separator)}",
        f"decimal = {quoted(decimal)}",
        *_points(found.marks),
        f"temperature = {quoted(temperature.name)}    # {parts.reasons['temperature']}",
        f"duplicates = {quoted(rows.duplicates)}",
        f"clock_back = {quoted('sort' if long is not None or table.parts else rows.clock_back)}",
    ]
    if table.parts:
        lines.append(f"parts = {quoted(table.parts)}    # the files of the folder make one recording")
    for key, place in (("machine", rows.machine), ("session", rows.session)):
        if place is not None:
            lines.append(f"{key} = {{ column = {quoted(table.header[place])} }}    # each has traces of its own")
    if found.quality.places:
        names = _quoted_list([table.header[place] for place in found.quality.places])
        lines.append(
            f"quality = {{ column = {names}, good = {_quoted_list(found.quality.good)} }}    # others are refused"
        )
    if stored.on_change:
        lines += [
            'stored = "on change"    # a value holds until the next one',
            f"silence = {stored.silence:g}    # s: of the recorder and of signals that name no other; then unknown",
            f"interval = {stored.interval:g}    # s: how often held values stand in a trace",
        ]
    if long is not None:
        lines += ["", "[long]    # one row a reading", f"name = {quoted(table.header[long.name])}"]
        values = [table.header[place] for place in (long.value, *long.others)]
        lines.append(f"value = {quoted(values[0]) if len(values) == 1 else _quoted_list(values)}")
        if long.object is not None:
            lines += [f"object = {quoted(table.header[long.object])}", f"objects = {_quoted_list(long.objects)}"]
    zoned = clock.has_zone or any("Z" in cell or "+" in cell for cell in table.column(clock.place)[:1])
    lines += ["", "[clock]", f"column = {quoted(table.header[clock.place])}"]
    if clock.date is not None:
        lines.append(f"date = {quoted(table.header[clock.date])}")
    lines.append(f"formats = {_quoted_list(clock.formats)}" + (f"    # {clock.why}" if clock.why else ""))
    if not zoned:
        zone = wall_zone(table.column(clock.place)[0])
        doubt = f"its {zone} says no offset" if zone else "the file does not say"
        why = "" if rows.timezone else f'    # {doubt}; a plant\'s local time: "Europe/Rome" ...'
        lines.append(f"timezone = {quoted(rows.timezone or 'UTC')}{why}")
    lines += ["", "[signals]"]
    for column in found.columns:
        if column.kind in ("number", "switch"):
            lines.append(_signal(column, parts, stored))
    lines += [f"# not used: {_one_line(header)}: it {why}" for header, why in found.marks.unclear.items()]
    unused = _unused(found)
    if unused:
        lines.append(f"# neither numbers nor switches: {list_names(map(_one_line, unused), _MAX_UNUSED_COLUMNS)}")
    lines += _derived_signal(parts, found.derived)
    lines += ["", "[effects]    # for `decanter diagnose`"]
    lines += [f"{role} = {quoted(signal)}" for role, signal in _roles(found.columns, parts).items()]
    lines += _alphabet(found, alphabet)
    return "\n".join(lines) + "\n"


def _points(marks: _Marks) -> list[str]:
    if not marks.points:
        return []
    columns = ", ".join(f"{_quote_text(header)} = {_quote_text(points)}" for header, points in marks.points.items())
    return [f"points = {{ {columns} }}    # what 1.234 is there"]


def _roles(columns: Sequence[FoundColumn], parts: Parts) -> dict[str, str]:
    """role -> signal: the load's, and those of which one column alone can be it, by its name and unit."""
    load = _role(parts.current)
    roles = {load: parts.current.name} if load and parts.current is not None else {}
    others = [one for one in columns if one.kind == "number" and one not in (parts.temperature, parts.current)]
    for role, plays in ROLE_WORDS.items():
        fitting = [one.name for one in others if plays(one.header, one.unit)]
        if len(fitting) == 1:
            roles[role] = fitting[0]
    return roles


def _role(load: FoundColumn | None) -> str:
    """The part that what loads the machine plays for `decanter diagnose`; "" for one that has none there."""
    if load is None or (load.unit in ("W", "kW", "MW", "%") and not current_score(load.name, "")):
        return ""
    by_unit = {"rpm": "speed", "Hz": "speed", "Nm": "torque"}
    return by_unit.get(
        load.unit, "current" if current_score(load.name, load.unit) or not load_score(load.name, "") else ""
    )


def _signal(column: FoundColumn, parts: Parts, stored: Stored) -> str:
    keys = [f"column = {_quote_text(column.header)}"]
    if column.kind == "switch":
        keys.append("boolean = true")
        if column.words is not None:
            on, off = column.words
            keys += [f"on = {_quoted_list(on)}", f"off = {_quoted_list(off)}"]
    else:
        keys += [f"scale = {column.scale!r}"] if column.scale != 1.0 else []
        keys += [f"offset = {column.offset!r}"] if column.offset else []
        unit = column.unit or ("degC" if column is parts.temperature else "")
        keys += [f"unit = {_quote_text(unit)}"] if unit else []
        keys += [f"low = {COLDEST:g}", f"high = {HOTTEST:g}"] if column.beyond else []
        keys += [f"bad = [{', '.join(map(_exact, column.bad))}]"] if column.bad else []
    if stored.on_change and stored.own.get(column.header, stored.silence) != stored.silence:
        keys.append(f"silence = {_exact(stored.own[column.header])}")
    comment = ""
    finite = column.values[np.isfinite(column.values)]
    if column.kind == "number" and finite.size:
        comment = f"    # {finite.min():g} to {finite.max():g}" + (", constant" if np.ptp(finite) == 0 else "")
    return f"{_quote_text(column.name)} = {{ {', '.join(keys)} }}{comment}"


def _exact(number: float) -> str:
    """A number as a map writes it: short where that is the very number."""
    return short if float(short := f"{number:g}") == number else repr(number)


def _derived_signal(parts: Parts, name: str) -> list[str]:
    """The signal that says whether the machine runs, where no column does."""
    if parts.running is not None:
        return []
    if parts.standstill is not None:
        return [
            "",
            "[derived]",
            f"{_quote_text(name)} = {{ signal = {_quote_text(parts.standstill.name)}, below = 0.5 }}    # "
            f"{parts.reasons['running']}",
        ]
    head = ["", "[derived]    # no column says whether the machine runs"]
    if parts.current is None:
        return [
            *head,
            f"{_quote_text(name)} = {{ constant = 1.0 }}    # nor does anything that loads it: it counts as running "
            f"throughout",
        ]
    finite = parts.current.values[np.isfinite(parts.current.values)]
    highest = float(np.quantile(finite, 0.99)) if finite.size else 1.0
    above = round_value(highest / 10, highest / 50)
    return [
        *head,
        f"{_quote_text(name)} = {{ signal = {_quote_text(parts.current.name)}, above = {above:g} }}    # a tenth of "
        "its most",
    ]


def _alphabet(found: _Found, alphabet: Alphabet | None) -> list[str]:
    parts, derived = found.parts, found.derived
    running = parts.running
    lines = ["", "[alphabet]    # the events that a model learns from"]
    lines += [f"gap = {alphabet.gap:g}", "channels = ["] if alphabet is not None else ["channels = ["]
    name = derived if running is None else running.name
    # Held values stand in each row, as polled ones do.
    polled = found.stored.on_change or running is None or np.isfinite(running.values).mean() > 0.5
    change = ", on_change = false" if polled else ""
    why = parts.reasons.get("running", "derived")
    lines.append(
        f'    {{ kind = "switch", signal = {_quote_text(name)}, rising = "W_ON", falling = "W_OFF"{change} }},    # '
        f"{why}"
    )
    for current in (each for each in (parts.current, *parts.others) if each is not None):
        channels = () if alphabet is None else alphabet.channels
        levels = next((each for each in channels if isinstance(each, Bins) and each.signal == current.name), None)
        if levels is not None and levels.thresholds:
            cuts = ", ".join(repr(float(f"{cut:g}")) for cut in levels.thresholds)
            how = f"thresholds = [{cuts}], hysteresis = {levels.hysteresis:g}"
            why = f"{parts.reasons['current']}; thresholds between the levels of this file"
        else:
            how = 'thresholds = "auto"'
            why = f"{parts.reasons['current']}; this file shows one level only: those of the traces will decide"
        lines.append(f'    {{ kind = "bins", signal = {_quote_text(current.name)}, {how} }},    # {why}')
    return [*lines, "]"]


def _one_line(text: str) -> str:
    return " ".join("".join(mark if mark.isprintable() else " " for mark in text).split())


def _quote_text(text: str) -> str:
    # JSON's strings are TOML's, but for DEL, which no header has that is printable.
    return json.dumps(text, ensure_ascii=False)


def _quoted_list(texts: Sequence[str]) -> str:
    return f"[{', '.join(map(_quote_text, texts))}]"
