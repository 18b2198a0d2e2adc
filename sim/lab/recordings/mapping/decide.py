"""Which column plays which part: by name and unit, then by how its readings move; where two fit, a person is asked."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from drivers.errors import did_you_mean
from sim.lab.recordings import TraceError, listed, numbers
from sim.lab.recordings.mapping.clocks import FoundClock, clocks_of, counted_clock, is_time, pure_date, pure_time
from sim.lab.recordings.mapping.columns import FoundColumn, decimal_of, has_levels, is_slow
from sim.lab.recordings.mapping.table import FoundTable
from sim.lab.recordings.mapping.words import current_score, day_first, named_time, running_score, temperature_score

NONE = "none"
"""The answer that a part is played by no column."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Answers:
    """What a person has decided; "" is left to what the file shows.

    `dates` is the order of dates, day or month; `on` the word of a switch that means running.
    """

    temperature: str = ""
    current: str = ""
    running: str = ""
    time: str = ""
    dates: str = ""
    on: str = ""
    timezone: str = ""

    def with_answer(self, field: str, answer: str) -> "Answers":
        """The answers with one more, to the question of an Undecided."""
        return replace(self, **{field: answer})


class Undecided(TraceError):
    """Two columns (or readings of one) fit: `question`, the `choices`, and the field of Answers that decides."""

    def __init__(self, where: object, question: str, field: str, choices: Sequence[str]) -> None:
        options = " or ".join(f"--{field} {choice!r}" if " " in choice else f"--{field} {choice}" for choice in choices)
        super().__init__(f"{where}: {question}: {listed(map(repr, choices))}; give {options}")
        self.question, self.field, self.choices = question, field, tuple(choices)


@dataclass(frozen=True, slots=True)
class Parts:
    """The columns that play a part, and why each was taken; None where none does."""

    temperature: FoundColumn
    current: FoundColumn | None
    running: FoundColumn | None
    reasons: dict[str, str]


def clock_of(table: FoundTable, answers: Answers) -> FoundClock:
    """The column of times. Raises Undecided where two fit or the day and month may be either, TraceError for none."""
    by_place: dict[int, list[FoundClock]] = {}
    for place, header in enumerate(table.header):
        if answers.time and header != answers.time:
            continue
        cells = table.column(place)
        filled = [cell for cell in cells if cell]
        if not filled:
            continue
        if is_time(filled[0]):
            by_place[place] = clocks_of(place, cells)
        elif pure_time(filled[0]):
            dated = [
                at for at in range(len(table.header)) if at != place and pure_date(next(iter(table.column(at)), ""))
            ]
            if dated:
                by_place[place] = clocks_of(place, cells, (dated[0], table.column(dated[0])))
        else:
            counted = counted_clock(place, numbers(cells, decimal_of([cells], table.separator))[0], named_time(header))
            by_place[place] = [counted] if counted is not None else []
    found = {place: clocks for place, clocks in by_place.items() if clocks}
    if not found:
        named = f"column {answers.time!r}" if answers.time else "column"
        raise TraceError(
            f"{table.path}: no {named} holds times; its columns are {listed(table.header)}; "
            f"{did_you_mean(answers.time, table.header) or 'give --time COLUMN, or a file with times'}"
        )

    def score(place: int) -> int:
        times = found[place][0].times
        still = bool(np.all(times[np.isfinite(times)] == times[np.isfinite(times)][0]))
        counted = found[place][0].formats == ("seconds",) and not still and not times[np.isfinite(times)][0] > 1e9
        return 4 * named_time(table.header[place]) + 2 * (not counted) - 8 * still

    best = max(map(score, found))
    rivals = [place for place in found if score(place) == best]
    first = found[rivals[0]][0].times
    # Columns that tell the same instants, in another zone or another form, are no rivals: steps are compared.
    same = [p for p in rivals if np.allclose(np.diff(found[p][0].times), np.diff(first), atol=1.0, equal_nan=True)]
    if len(same) < len(rivals) and not answers.time:
        raise Undecided(table.path, "columns that may be the clock", "time", [table.header[place] for place in rivals])
    chosen = next((place for place in same if found[place][0].zoned or "Z" in table.column(place)[0]), rivals[0])
    return _one_order(table, found[chosen], answers)


def _one_order(table: FoundTable, clocks: Sequence[FoundClock], answers: Answers) -> FoundClock:
    """Of readings day first and month first the one that leaves a clock in order, else what the language says."""
    wanted = [clock for clock in clocks if clock.order == answers.dates]
    if wanted or len(clocks) == 1:
        return (wanted or list(clocks))[0]
    steps = {clock.order: np.diff(clock.times[np.isfinite(clock.times)]) for clock in clocks}
    in_order = [c for c in clocks if np.all(steps[c.order] >= 0) or np.all(steps[c.order] <= 0)]
    # Days that cross a month's end jump by a month when day and month are exchanged.
    longest = {clock.order: float(np.abs(steps[clock.order]).max(initial=0.0)) for clock in clocks}
    smooth = [c for c in in_order if longest[c.order] <= 0.1 * min(longest[o.order] for o in clocks if o is not c)]
    if len(in_order) == 1 or len(smooth) == 1:
        return (in_order if len(in_order) == 1 else smooth)[0]
    orders = {clock.order: clock for clock in clocks}
    numbers_ = decimal_of([table.column(place) for place in range(len(table.header))], table.separator)
    if "day" in orders and (numbers_ == "," or table.separator == ";" or day_first(" ".join(table.header))):
        return orders["day"]
    if "month" in orders and any("%p" in format_ for format_ in orders["month"].formats):
        return orders["month"]
    shown = table.column(clocks[0].date if clocks[0].date is not None else clocks[0].place)[0]
    raise Undecided(
        table.path, f"in {shown!r} the day or the month may come first", "dates", [clock.order for clock in clocks]
    )


def parts_of(where: object, columns: Sequence[FoundColumn], answers: Answers) -> Parts:
    """Temperature, current and switch. Raises Undecided where two fit, TraceError where there is no number at all."""
    counted = [column for column in columns if column.kind == "number"]
    if not counted:
        raise TraceError(f"{where}: none of its columns holds numbers; they are {listed(c.header for c in columns)}")
    reasons: dict[str, str] = {}
    temperature = _named(where, "temperature", answers.temperature, counted, reasons) or _best(
        where, "temperature", counted, lambda column: temperature_score(column.name, column.unit), reasons
    )
    if temperature is None:
        slow = [column for column in counted if is_slow(column.values)]
        if len(slow) != 1:
            raise Undecided(
                where, "columns that may be the temperature", "temperature", [c.header for c in slow or counted]
            )
        temperature, reasons["temperature"] = slow[0], "the only column that moves slowly between -40 and 200"
    others = [column for column in counted if column is not temperature]
    current = None
    if answers.current != NONE:
        current = _named(where, "current", answers.current, others, reasons) or _best(
            where, "current", others, lambda column: current_score(column.name, column.unit), reasons
        )
        levels = [column for column in others if not column.unit and has_levels(column.values)]
        if current is None and len(levels) == 1:
            current, reasons["current"] = levels[0], "the only column that dwells near 0 and far from it, in turn"
    running = None
    if answers.running != NONE:
        switches = [column for column in columns if column.kind == "switch"]
        running = _named(where, "running", answers.running, switches, reasons) or _best(
            where, "running", switches, lambda column: running_score(column.name), reasons
        )
    return Parts(temperature, current, running, reasons)


def _named(
    where: object, part: str, wanted: str, columns: Sequence[FoundColumn], reasons: dict[str, str]
) -> FoundColumn | None:
    """The column that an answer names. Raises TraceError for one that is not there or cannot play the part."""
    if not wanted:
        return None
    for column in columns:
        if wanted.casefold() in (column.header.casefold(), column.name.casefold()):
            reasons[part] = f"as --{part} says"
            return column
    headers = [column.header for column in columns]
    remedy = did_you_mean(wanted, headers) or f"those that can be it are {listed(map(repr, headers)) or 'none'}"
    raise TraceError(f"{where}: --{part} {wanted}: no column of that name can be it; {remedy}")


def _best(
    where: object,
    part: str,
    columns: Sequence[FoundColumn],
    score: Callable[[FoundColumn], int],
    reasons: dict[str, str],
) -> FoundColumn | None:
    """The column with the best score for a part, by its name and unit; None where none has any."""
    highest = max(map(score, columns), default=0)
    best = [column for column in columns if score(column) == highest] if highest > 0 else []
    if not best:
        return None
    # Columns with the same readings, as of a setpoint and its echo, are one.
    if any(not np.array_equal(a.values, b.values, equal_nan=True) for a, b in combinations(best, 2)):
        raise Undecided(where, f"columns that may be the {part}", part, [column.header for column in best])
    reasons[part] = "by its name" + (f" and its unit {best[0].unit}" if best[0].unit else "")
    return best[0]


def with_words(where: object, columns: Sequence[FoundColumn], answers: Answers) -> list[FoundColumn]:
    """The columns, those of two strange words as the switches that they are if a name or an answer says so.

    Raises Undecided where it is not known which of the words means running.
    """
    switched: list[FoundColumn] = []
    for column in columns:
        words = column.undecided
        if words is not None and (running_score(column.name) or answers.running in (column.header, column.name)):
            if answers.on not in words:
                raise Undecided(where, f"words of {column.header!r} that may mean running", "on", words)
            off = words[1] if answers.on == words[0] else words[0]
            values = np.where([cell == answers.on for cell in column.cells], 1.0, 0.0)
            column = replace(column, kind="switch", values=values, words=(answers.on, off), undecided=None)
        switched.append(column)
    return switched
