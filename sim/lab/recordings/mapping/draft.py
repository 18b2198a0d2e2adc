"""A column map drafted from a file, as commented TOML that loads as it stands."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from pathlib import Path

import numpy as np

from sim.lab.recordings import Levels, levels_of, listed, load_traces, parse_map, round_to
from sim.lab.recordings.mapping.clocks import FoundClock
from sim.lab.recordings.mapping.columns import FoundColumn, column_of, decimal_of
from sim.lab.recordings.mapping.decide import Answers, Parts, clock_of, parts_of, with_words
from sim.lab.recordings.mapping.table import FoundTable, find_table
from sim.lab.recordings.mapping.words import named_name, named_value
from sim.sha import Trace

LEAST_GAP = 30.0
_STEPS_IN_GAP = 5
RUNNING = "Running"
"""The name of the switch that is derived where no column says whether the machine runs."""
_SHOWN = 30
"""Columns that are named in a comment because they say nothing usable."""


@dataclass(frozen=True, slots=True)
class DraftedMap:
    """The map's TOML `text` and what was found: header names of the clock, temperature, current and switch ("": none).

    `rows` of the file's were used with it, of `of`; `report` is what loading said.
    """

    text: str
    clock: str
    temperature: str
    current: str
    running: str
    rows: int
    of: int
    report: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _LongForm:
    """Places of the columns of a long file, and the objects that it has beside names."""

    name: int
    value: int
    object: int | None
    objects: tuple[str, ...]


def draft_map(path: Path, answers: Answers, names: Mapping[str, str] | None = None) -> DraftedMap:
    """The column map that reads a file. Raises Undecided where a person must choose, TraceError where there is none.

    `names` are the signals' names by their headers, that of a derived switch by RUNNING; others are made of the header.
    """
    names = names or {}
    table = find_table(path)
    clock = clock_of(table, answers)
    long = _long_form(table, clock)
    taken = {clock.place, *([] if clock.date is None else [clock.date])}
    places = [p for p in range(len(table.header)) if p not in taken and table.header[p]]
    if long is None:
        decimal = decimal_of([table.column(place) for place in places], table.separator)
        first = {table.header[place]: place for place in reversed(places)}  # the first of equal headers is read
        columns = [
            column_of(h, table.titles[p], table.units[p], table.column(p), decimal)
            for h, p in sorted(first.items(), key=itemgetter(1))
        ]
    else:
        decimal = decimal_of([table.column(long.value)], table.separator)
        cells: dict[str, list[str]] = {}
        for row in table.rows:
            cells.setdefault(row[long.name], []).append(row[long.value])
        columns = [column_of(name, name, "", own, decimal) for name, own in cells.items() if name]
    named = [replace(column, name=names.get(column.header, column.name)) for column in columns]
    columns = with_words(path, _named_apart(named), answers)
    parts = parts_of(path, columns, answers)
    # The current's levels and the usual step are those of all rows, which the map itself reads.
    derived = names.get(RUNNING, RUNNING)
    bare = _text(table, clock, long, columns, parts, decimal=decimal, answers=answers, derived=derived)
    traces, _ = load_traces(path, parse_map(bare, str(path)))
    steps = np.concatenate([np.diff(trace.times) for trace in traces])
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0
    gap = max(LEAST_GAP, round_to(_STEPS_IN_GAP * usual, usual))
    text = _text(
        table, clock, long, columns, parts, decimal=decimal, answers=answers, derived=derived, traces=traces, gap=gap
    )
    traces, report = load_traces(path, parse_map(text, str(path)))
    said = report.sentences() if report.refused else report.warnings
    return DraftedMap(
        text=text,
        clock=table.header[clock.place],
        temperature=parts.temperature.header,
        current="" if parts.current is None else parts.current.header,
        running="" if parts.running is None else parts.running.header,
        rows=report.used,
        of=report.rows,
        report=tuple(said),
    )


def _long_form(table: FoundTable, clock: FoundClock) -> _LongForm | None:
    """The columns of names and values, if the file has one row a reading; None for a wide one."""
    others = [place for place in range(len(table.header)) if place != clock.place]
    values = [place for place in others if named_value(table.header[place])]
    words = {place: Counter(table.column(place)) for place in others if place not in values}
    # Names come again and again; numbers, qualities and comments are none.
    names = [
        place
        for place, distinct in words.items()
        if named_name(table.header[place])
        and sum(not _plain_number(word) for word in distinct) > len(distinct) / 2
        and len(distinct) <= max(len(table.rows) / 2, 1)
    ]
    if len(values) != 1 or not names:
        return None
    name = max(names, key=lambda place: (len(words[place]), place))
    rest = [place for place in names if place != name and "object" in table.header[place].casefold()]
    if not rest:
        return _LongForm(name, values[0], None, ())
    return _LongForm(name, values[0], rest[0], tuple(words[rest[0]]))


def _plain_number(word: str) -> bool:
    return not word or word.replace(",", "").replace(".", "").lstrip("+-").isdigit()


def _named_apart(columns: Sequence[FoundColumn]) -> list[FoundColumn]:
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


def _text(
    table: FoundTable,
    clock: FoundClock,
    long: _LongForm | None,
    columns: Sequence[FoundColumn],
    parts: Parts,
    *,
    decimal: str,
    answers: Answers,
    derived: str,
    traces: Sequence[Trace] = (),
    gap: float = LEAST_GAP,
) -> str:
    """The map in TOML. Without traces its thresholds are left to the readings."""
    quoted = _quoted
    temperature, current = parts.temperature, parts.current
    lines = [
        f"# Column map drafted from {table.path.name}; look it over, above all what stands behind #.",
        "",
        f'format = "{"wide" if long is None else "long"}"',
        f"separator = {quoted(table.separator)}",
        f"decimal = {quoted(decimal)}",
        f"temperature = {quoted(temperature.name)}    # {parts.reasons['temperature']}",
        'duplicates = "last"',
        f'clock_back = "{"refuse" if long is None else "sort"}"',
    ]
    if long is not None:
        lines += ["", "[long]    # one row a reading", f"name = {quoted(table.header[long.name])}"]
        lines.append(f"value = {quoted(table.header[long.value])}")
        if long.object is not None:
            lines += [f"object = {quoted(table.header[long.object])}", f"objects = {_quoted_list(long.objects)}"]
    zoned = clock.zoned or any("Z" in cell or "+" in cell for cell in table.column(clock.place)[:1])
    lines += ["", "[clock]", f"column = {quoted(table.header[clock.place])}"]
    if clock.date is not None:
        lines.append(f"date = {quoted(table.header[clock.date])}")
    lines.append(f"formats = {_quoted_list(clock.formats)}")
    if not zoned:
        why = "" if answers.timezone else '    # the file does not say; a plant\'s local time: "Europe/Rome" ...'
        lines.append(f"timezone = {quoted(answers.timezone or 'UTC')}{why}")
    lines += ["", "[signals]"]
    for column in columns:
        if column.kind in ("number", "switch"):
            lines.append(_signal(column, parts))
    unused = [column.header for column in columns if column.kind not in ("number", "switch")]
    if unused:
        lines.append(f"# neither numbers nor switches: {listed(map(_one_line, unused), _SHOWN)}")
    lines += _derived(parts, derived)
    lines += ["", "[effects]    # for `decanter diagnose`"]
    lines += [f"current = {quoted(current.name)}"] if current is not None else []
    lines += _alphabet(table, parts, traces, gap, derived)
    return "\n".join(lines) + "\n"


def _signal(column: FoundColumn, parts: Parts) -> str:
    keys = [f"column = {_quoted(column.header)}"]
    if column.kind == "switch":
        keys.append("boolean = true")
        if column.words is not None:
            keys += [f"on = {_quoted_list(column.words[:1])}", f"off = {_quoted_list(column.words[1:])}"]
    elif column is parts.temperature and column.unit == "degF":
        keys += [f"scale = {5 / 9!r}", f"offset = {-160 / 9!r}", 'unit = "degC"']
    elif column is parts.temperature and column.unit == "K":
        keys += ["offset = -273.15", 'unit = "degC"']
    elif column is parts.current and column.unit == "mA":
        keys += ["scale = 0.001", 'unit = "A"']
    elif column.unit or column is parts.temperature:
        keys.append(f"unit = {_quoted(column.unit or 'degC')}")
    comment = ""
    finite = column.values[np.isfinite(column.values)]
    if column.kind == "number" and finite.size:
        comment = f"    # {finite.min():g} to {finite.max():g}" + (", constant" if np.ptp(finite) == 0 else "")
    return f"{_quoted(column.name)} = {{ {', '.join(keys)} }}{comment}"


def _derived(parts: Parts, name: str) -> list[str]:
    """The signal that says whether the machine runs, where no column does."""
    if parts.running is not None:
        return []
    head = ["", "[derived]    # no column says whether the machine runs"]
    if parts.current is None:
        return [
            *head,
            f"{_quoted(name)} = {{ constant = 1.0 }}    # nor does a current: it counts as running throughout",
        ]
    finite = parts.current.values[np.isfinite(parts.current.values)]
    scale = 0.001 if parts.current.unit == "mA" else 1.0
    highest = float(np.quantile(finite, 0.99)) * scale if finite.size else 1.0
    above = round_to(highest / 10, highest / 50)
    return [
        *head,
        f"{_quoted(name)} = {{ signal = {_quoted(parts.current.name)}, above = {above:g} }}    # a tenth of its most",
    ]


def _alphabet(table: FoundTable, parts: Parts, traces: Sequence[Trace], gap: float, derived: str) -> list[str]:
    running, current = parts.running, parts.current
    lines = ["", "[alphabet]    # the events that a model learns from", f"gap = {gap:g}", "channels = ["]
    name = derived if running is None else running.name
    polled = running is None or np.isfinite(running.values).mean() > 0.5
    change = ", on_change = false" if polled else ""
    why = "derived" if running is None else parts.reasons["running"]
    lines.append(
        f'    {{ kind = "switch", signal = {_quoted(name)}, rising = "W_ON", falling = "W_OFF"{change} }},    # {why}'
    )
    if current is not None:
        levels = levels_of(traces, current.name, gap) if traces else Levels()
        if levels.thresholds:
            cuts = ", ".join(repr(float(f"{cut:g}")) for cut in levels.thresholds)
            how = f"thresholds = [{cuts}], hysteresis = {levels.hysteresis:g}"
            why = f"{parts.reasons['current']}; thresholds between the levels of this file"
        else:
            how = 'thresholds = "auto"'
            why = f"{parts.reasons['current']}; this file shows one level only: those of the traces will decide"
        lines.append(f'    {{ kind = "bins", signal = {_quoted(current.name)}, {how} }},    # {why}')
    return [*lines, "]"]


def _one_line(text: str) -> str:
    return " ".join("".join(mark if mark.isprintable() else " " for mark in text).split())


def _quoted(text: str) -> str:
    # JSON's strings are TOML's, but for DEL, which no header has that is printable.
    return json.dumps(text, ensure_ascii=False)


def _quoted_list(texts: Sequence[str]) -> str:
    return f"[{', '.join(map(_quoted, texts))}]"
