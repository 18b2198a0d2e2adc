"""A folder of files as one table: one file a tag, or the parts of one recording one after another."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from sim.lab.recordings import UNNAMED_COLUMN, TraceError, fold_name, list_names, recording_name
from sim.lab.recordings.mapping.answers import Answers
from sim.lab.recordings.mapping.clocks import FoundClock
from sim.lab.recordings.mapping.decide import choose_clock, sample_seconds
from sim.lab.recordings.mapping.quality import is_quality
from sim.lab.recordings.mapping.table import FoundTable, find_table

_DIGITS = re.compile(r"\d+")


def one_table(folder: Path, files: Sequence[Path], answers: Answers, *, now: float) -> tuple[FoundTable, FoundClock]:
    """The rows of all files in the order of their times, under the names of all of them, and their common clock.

    Raises TraceError where the clocks differ in name or form, or there is no file; as `find_table` and `choose_clock`
    do.
    """
    if not files:
        raise TraceError(
            f"{folder}: there is no CSV file in it; give a file, or a folder of the parts of one recording"
        )
    endings = sorted({file.name.removeprefix(recording_name(file)) for file in files})
    if len(endings) > 1:
        raise TraceError(
            f"{folder}: its files end in {list_names(endings)}; give a folder in which all are of one kind"
        )
    (ending,) = endings
    tables = [find_table(file) for file in files]
    clocks = [choose_clock(table, answers, now=now) for table in tables]
    first, clock = tables[0], clocks[0]
    for table, other in zip(tables[1:], clocks[1:], strict=True):
        same = fold_name(table.header[other.place]) == fold_name(first.header[clock.place])
        if not same or other.formats[0] != clock.formats[0] or table.separator != first.separator:
            raise TraceError(
                f"{table.path}: its clock is {table.header[other.place]!r} in the form {other.formats[0]!r}, "
                f"and that of "
                f"{first.path.name} is {first.header[clock.place]!r} in {clock.formats[0]!r}: they make no "
                f"recording together; "
                "give each its own map"
            )
    clock = replace(clock, formats=tuple(dict.fromkeys(each for own in clocks for each in own.formats)))
    # A name that files share is a column of one recording; where one row of numbers only is under it, of one tag each,
    # if their times or their names are not those of days one after another.
    seen = Counter(fold_name(name) for table in tables for name in set(table.header))
    owned = [
        [
            place
            for place, name in enumerate(table.header)
            if name not in ("", UNNAMED_COLUMN) and place not in (own.place, own.date)
        ]
        for table, own in zip(tables, clocks, strict=True)
    ]
    single = all(
        sum(not is_quality(table, place) for place in own) <= 1 for table, own in zip(tables, owned, strict=True)
    )
    # One tag a file come row by row in turn; parts one after another, as the clock that is set back goes in each.
    times = [sample_seconds(table, own)[0] for table, own in zip(tables, clocks, strict=True)]
    order = np.argsort(list(map(np.nanmin, times)), kind="stable").tolist()
    overlap = any(np.nanmin(times[after]) < np.nanmax(times[before]) for before, after in pairwise(order))
    # Parts are told apart by a date or a number; files of other names are of other tags, whenever these were stored.
    single &= overlap or len({_DIGITS.sub("", recording_name(file)).casefold() for file in files}) > 1
    clock_name, date = first.header[clock.place], None if clock.date is None else first.header[clock.date]
    names: list[str] = [clock_name, *([] if date is None else [date])]
    rows: list[tuple[float, int, dict[str, str]]] = []
    titles: dict[str, str] = {}
    units: dict[str, str] = {}
    of_files: dict[str, set[str]] = {}
    for number, (table, own) in enumerate(zip(tables, clocks, strict=True)):
        keys: list[str] = []
        for place, name in enumerate(table.header):
            shared = single and len(tables) > 1 and seen[fold_name(name)] > 1 and place not in (own.place, own.date)
            shared &= name != UNNAMED_COLUMN  # the number of a row is no tag
            key = f"{recording_name(table.path)}/{name}" if shared else name
            key = next((known for known in names if fold_name(known) == fold_name(key)), key)
            names += [key] if key not in names else []
            titles.setdefault(key, recording_name(table.path) if shared else table.titles[place])
            units.setdefault(key, table.units[place])
            of_files.setdefault(key, set()).add(recording_name(table.path))
            keys.append(key)
        for row, time in zip(table.rows, times[number].tolist(), strict=True):
            rows.append((time, order.index(number), dict(zip(keys, row, strict=True))))
    rows.sort(key=(lambda row: (np.isnan(row[0]), row[0])) if single else (lambda row: (False, row[1])))
    table = replace(
        first,
        path=folder,
        header=tuple(names),
        titles=tuple(titles[name] for name in names),
        units=tuple(units[name] for name in names),
        rows=tuple(tuple(row.get(name, "") for name in names) for _, _, row in rows),
        parts=f"*{ending}",
        files=tuple(next(iter(of_files[name])) if len(of_files[name]) == 1 else "" for name in names),
    )
    return table, replace(clock, place=0, date=None if date is None else 1)
