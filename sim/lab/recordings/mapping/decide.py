"""Which column plays which part: by name and unit, then by how its readings move; where two fit, a person is asked."""

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np

from drivers.errors import did_you_mean
from sim.lab.recordings import (
    CONVERTED_UNITS,
    RUN_WORDS,
    ClockColumns,
    TraceError,
    booleans,
    conversion,
    is_time,
    known_unit,
    list_names,
    numbers,
    pure_date,
    pure_time,
    read_clock,
    since_1970,
    spoken_seconds,
    unroll_midnight,
    whole_day,
)
from sim.lab.recordings.mapping.answer_words import NO_COLUMN
from sim.lab.recordings.mapping.answers import Answers, Undecided
from sim.lab.recordings.mapping.clocks import (
    FoundClock,
    bare_time,
    bare_times_clocks,
    counted_clock,
    counts_minutes,
    counts_of_day,
    daily_clock,
    find_clocks,
    looks_rounded_count,
)
from sim.lab.recordings.mapping.columns import FoundColumn, dwells, find_decimal, has_levels, is_slow
from sim.lab.recordings.mapping.elapsed import in_own_unit
from sim.lab.recordings.mapping.table import FoundTable
from sim.lab.recordings.mapping.words import (
    current_score,
    day_first,
    load_score,
    named_bearing,
    named_current,
    named_day,
    named_duration,
    named_part_time,
    named_remainder,
    named_standstill,
    named_surroundings,
    named_time,
    named_total,
    running_score,
    split_unit,
    temperature_score,
)
from sim.sha import Array, Mask, Trace

_KELVIN_REST_RANGE = (240.0, 330.0)
"""Where a temperature that nobody calls kelvin rests if it is; no bearing rests at 240 degC."""
_MAX_REST_DEGC = 150.0
"""degC above which no bearing stands still."""
COLDEST, HOTTEST = -80.0, 300.0
"""degC that no bearing reaches: its grease burns before, and no plant stands in such a cold."""
_LOOP_CURRENT = 0.025
"""A that a sensor's loop of 4 to 20 mA carries at most, out of range too."""
_LOOP_MA = (3.6, 20.5)
"""mA that a loop of 4 to 20 mA carries: below and above it says a fault."""
_IDLE_CURRENT_SHARE = 0.05
"""Of its most, a current below which no motor turns anything."""
_ALONGSIDE = 0.98
"""The share of rows in which the switch of a machine agrees with whether its load is drawn; an auxiliary's does not."""


@dataclass(frozen=True, slots=True)
class Parts:
    """The columns that play a part, and why each was taken; None where none does. `said` is what was concluded.

    `current` is what loads the machine: its current or, by name or a person's word, another signal. `standstill` is the
    switch that is on while it does not run.
    """

    temperature: FoundColumn
    current: FoundColumn | None
    running: FoundColumn | None
    standstill: FoundColumn | None
    reasons: dict[str, str]
    others: tuple[FoundColumn, ...] = ()
    """What loads the machine besides `current`, by a person's word."""


def choose_clock(table: FoundTable, answers: Answers, *, now: float) -> FoundClock:
    """The column of times, none of which is after `now` (s since 1970) where others fit.

    Raises Undecided where two fit or the day and month may be either, TraceError for none.
    """
    by_place: dict[int, list[FoundClock]] = {}
    sure: dict[int, bool] = {}
    first = [next(filter(None, table.column(place)), "") for place in range(len(table.header))]
    days = [at for at, cell in enumerate(first) if cell and _has_days(table, at)]
    bare = _bare_times(table, days)
    spans = set() if answers.time else {at for at, name in enumerate(table.header) if named_duration(name)}
    # Days that a program writes with a midnight, or as a number, are no clock beside times of day.
    timed = bool(bare) or any(pure_time(cell) and at not in spans for at, cell in enumerate(first) if at not in days)
    passed = {at for at in days if timed and not pure_date(first[at])}
    for place, header in enumerate(table.header):
        if answers.time and header != answers.time:
            continue
        _check_one_clock(table, place)
        cells = table.column(place)
        filled = [cell for cell in cells if cell]
        if not filled:
            continue
        if named_time(header) and looks_rounded_count(filled[0]) and len(set(filled)) < len(filled) / 2:
            raise TraceError(
                f"{table.path}: the times in {header!r} were rounded by a spreadsheet ({filled[0]}): the "
                f"seconds are lost; "
                "export the file again, with that column as text"
            )
        if place in passed and not answers.time:
            continue
        if is_time(filled[0]):
            by_place[place] = find_clocks(place, cells)
        elif place in bare:
            day, sure[place] = _day_beside(table, place, days, bare[place])
            by_place[place] = bare_times_clocks(place, cells, (day, table.column(day)), bare[place])
        elif named_time(header) and spoken_seconds(filled[0]) is not None:
            by_place[place] = [] if days else daily_clock(place, cells, header)
        elif (place in spans and pure_time(filled[0])) or counts_minutes(header, filled[0]):
            # How long something took is no time of the day beside it.
            moves = any(len(set(table.column(at))) > 1 for at in days)
            by_place[place] = [] if moves else daily_clock(place, cells, header)
        elif pure_time(filled[0]) and place not in days:
            if days:
                day, sure[place] = _day_beside(table, place, days, pure_time(filled[0])[0])
                by_place[place] = find_clocks(place, cells, (day, table.column(day)))
            else:
                by_place[place] = daily_clock(place, cells, header)
        else:
            decimal = find_decimal([cells], table.separator)
            if days and place not in (*days, *spans):
                date = (days[0], table.column(days[0]))
                if clocks := counts_of_day(place, cells, header, date, decimal):
                    by_place[place] = clocks
                    continue
            counted = counted_clock(
                place, numbers(cells, decimal)[0], header, named=named_time(header) or bool(answers.time)
            )
            by_place[place] = [replace(counted, decimal=decimal)] if counted is not None else []
    found = {place: clocks for place, clocks in by_place.items() if clocks}
    if not found:
        raise TraceError(_no_clock(table, answers))
    if any(place not in spans or is_time(first[place]) for place in found):
        found = {place: clocks for place, clocks in found.items() if place not in spans or not pure_time(first[place])}

    def score(place: int) -> int:
        times = found[place][0].times
        still = bool(np.all(times[np.isfinite(times)] == times[np.isfinite(times)][0]))
        counted = found[place][0].order == "year" and found[place][0].formats[0].endswith(_COUNTS) and not still
        counted &= not since_1970(float(times[np.isfinite(times)][0]))
        name = table.header[place]
        return 4 * named_time(name) + 2 * (not counted) - 8 * still - named_part_time(name)

    best = max(map(score, found))
    rivals = [place for place in found if score(place) == best]
    # Columns that tell the same instants, in another zone or another form, are no rivals: steps are compared.
    shown = min(found[place][0].times.size for place in rivals)
    steps = {place: np.diff(found[place][0].times[:shown]) for place in rivals}
    same = [p for p in rivals if np.allclose(steps[p], steps[rivals[0]], atol=1.0, equal_nan=True)]
    if len(same) < len(rivals) and not answers.time:
        raise Undecided(table.path, "columns that may be the clock", "time", [table.header[place] for place in rivals])
    _check_one_column(table, found[rivals[0]][0])
    if not answers.time:
        _check_day(table, found[rivals[0]][0])
    zoned = (place for place in same if found[place][0].has_zone or "Z" in table.column(place)[0])
    chosen = next(zoned, next((place for place in same if sure.get(place, True)), rivals[0]))
    if not sure.get(chosen, True):
        raise TraceError(
            f"{table.path}: the days of {table.header[chosen]!r} may stand in "
            f"{' or in '.join(repr(table.header[at]) for at in days)}: name that column 'Date', or export only that one"
        )
    beside = [clocks[0] for place, clocks in found.items() if place != chosen and clocks[0].formats[0] not in _COUNTS]
    return _one_order(table, [in_own_unit(table, clock, beside, answers) for clock in found[chosen]], answers, now)


def _has_days(table: FoundTable, place: int) -> bool:
    """Whether a column holds dates, alone or with their midnight, or as numbers under a name of time."""
    filled = [cell for cell in table.column(place) if cell]
    if not whole_day(filled[0]) or (filled[0].isdigit() and not named_time(table.header[place])):
        return False
    # A footer is no day; what may be a time of day as 10.11.12 may is one where others can be nothing else.
    others, most = set[str](), _FEW_OTHERS * len(filled)
    count = 0
    for cell, times in Counter(filled).items():
        if not whole_day(cell):
            others.add(cell)
            count += times
            if count > most:
                return False
    return not any(map(pure_time, others))


_FEW_OTHERS = 0.2
"""Share of the cells of a column of days that may be none."""


def _bare_times(table: FoundTable, days: Sequence[int]) -> dict[int, str]:
    """place -> format of the columns of times that are written like numbers, beside days."""
    found: dict[int, str] = {}
    for place, header in enumerate(table.header):
        hour = _PARTS_OF_TIME.fullmatch(header.strip())
        plain = (named_time(header) or hour) and not split_unit(header)[1] and not table.units[place]
        if days and place not in days and plain and not named_duration(header):
            form = bare_time(table.column(place), header)
            found |= {place: form} if form else {}
    return found


def _day_beside(table: FoundTable, place: int, days: Sequence[int], form: str) -> tuple[int, bool]:
    """The column that says the days of the times of day at `place`, and whether a midnight or a name tells that."""
    columns = [table.column(at) for at in days]
    if all(column == columns[0] for column in columns):
        return days[0], True
    times, _ = read_clock(ClockColumns(column="t", formats=(form,)), [table.column(place)], "auto")
    read = np.flatnonzero(np.isfinite(times)).tolist()
    midnights = [late < early for early, late in pairwise(times[read].tolist())]
    moving = [
        at
        for at, column in zip(days, columns, strict=True)
        if [column[early] != column[late] for early, late in pairwise(read)] == midnights
    ]
    named = [at for at in moving or days if named_day(table.header[at])]
    if len(named) == 1 or (moving and any(midnights)):
        return (named or moving)[0], True
    return days[0], False


def _check_day(table: FoundTable, clock: FoundClock) -> None:
    """Raises TraceError for times of day whose year and day stand in columns of their own: they would be lost."""
    numbered = bare_time(table.column(clock.place), table.header[clock.place])
    if clock.date is not None or not (numbered or ClockColumns(column="t", formats=clock.formats).daily):
        return
    parts = [
        name
        for at, name in enumerate(table.header)
        if at != clock.place and _PARTS_OF_DAY.fullmatch(name.strip()) and table.column(at)[0].isdigit()
    ]
    if len(parts) > 1 and any(_YEAR.fullmatch(name.strip()) for name in parts):
        raise TraceError(
            f"{table.path}: the days of its times stand in columns of their own, {list_names(parts)}: join them to "
            "one, such as 2024-03-13 or, by the day of the year, 2024-073; "
            f"--time {table.header[clock.place]!r} reads the times without their days"
        )


def _check_one_clock(table: FoundTable, place: int) -> None:
    """Raises TraceError for a clock that comes again and shows other times: each value then has its own."""
    twins = [
        other
        for other, name in enumerate(table.header)
        if other != place and _TOLD_APART.sub("", name) == _TOLD_APART.sub("", table.header[place])
    ]
    cells = table.column(place)
    if not twins or not named_time(table.header[place]) or cells == table.column(twins[0]):
        return
    raise TraceError(
        f"{table.path}: each value has a clock of its own ({table.header[place]!r}, {table.header[twins[0]]!r} ...), "
        "and these show different times: export all values by one clock, or each to a file of its own, which a folder "
        "joins"
    )


_TOLD_APART = re.compile(r"_\d+$")
"""What is added to the names of a header that are equal."""
_PARTS_OF_TIME = re.compile(
    r"(hour|hh|stunde|ora|heure|hora|minute?|minut[oi]|mm|second|sekunde|secondi?|seconde)s?n?", re.IGNORECASE
)


_PARTS_OF_DATE = re.compile(
    rf"year|yyyy|jahr|anno|année|año|month|monat|mese|mois|mes|day|tag|giorno|jour|d[ií]a|{_PARTS_OF_TIME.pattern}",
    re.IGNORECASE,
)


def _check_one_column(table: FoundTable, clock: FoundClock) -> None:
    """Raises TraceError for a clock whose hours, minutes and seconds are columns of their own: none is a clock."""
    parts = [name for name in table.header if _PARTS_OF_TIME.fullmatch(name.strip())]
    if len(parts) > 1 and table.header[clock.place] in parts:
        raise TraceError(
            f"{table.path}: its clock stands in columns of their own, {list_names(parts)}: no column alone is a "
            f"clock; write "
            "the column map by hand, with clock.time_of_day = { hour, minute, second }, as "
            "config/traces/femto.toml does"
        )


_YEAR = re.compile(r"year|yyyy|yr|jahr|anno|ann[ée]e|a[ñn]o|年", re.IGNORECASE)
_PARTS_OF_DAY = re.compile(
    rf"{_YEAR.pattern}|month|monat|mese|mois|m[eê]s|day|tag|giorno|jour|d[ií]a|doy|jday|julian.?day|yday|"
    r"day.?(?:of.?)?(?:the.?)?year|(?:jahrestag|tag.?(?:im|des).?jahre?s?)|giorno.?dell.?anno|"
    r"jour.?(?:de.?l.?ann[ée]e|julien)|d[ií]a.?del.?a[ñn]o",
    re.IGNORECASE,
)
"""What a day is told by in several columns, the day of the year too."""
_COUNTS = ("seconds", "minutes", "hours", "days")


def _no_clock(table: FoundTable, answers: Answers) -> str:
    """Why no column is a clock, with a cell of the one that is named like a time."""
    parts = [name for name in table.header if _PARTS_OF_DATE.fullmatch(name.strip())]
    if len(parts) > 1 and not answers.time:
        return (
            f"{table.path}: its clock stands in columns of their own, {list_names(parts)}: no column alone is a clock; "
            "join them to one, such as 2024-03-13 09:58:00"
        )
    wanted = answers.time or next(filter(named_time, table.header), "")
    if wanted not in table.header:
        remedy = did_you_mean(wanted, table.header) if wanted else ""
        return (
            f"{table.path}: no column{f' {wanted!r}' if wanted else ''} holds times; its columns are "
            f"{list_names(table.header)}; "
            f"{remedy or 'give --time COLUMN, or a file with times'}"
        )
    cells = table.column(table.header.index(wanted))
    shown, filled = next(filter(None, cells), ""), sum(map(bool, cells))
    why = (
        "it was rounded by a spreadsheet, and the seconds are lost; export it again as text"
        if looks_rounded_count(shown)
        else f"it is a day that stands in {filled} of {len(cells)} rows; write it in each"
        if pure_date(shown) and 2 * filled < len(cells)
        else "it is a day, and nothing says the time of day; export that too"
        if pure_date(shown)
        else "no form that is known reads it, or it does not rise; give --time COLUMN for another column"
    )
    return (
        f"{table.path}: no column holds times; its columns are {list_names(table.header)}; in {wanted!r} stands "
        f"{shown!r}: "
        f"{why}"
    )


def sample_seconds(table: FoundTable, clock: FoundClock) -> tuple[Array, Mask]:
    """The times of the sample's rows as the clock reads them (NaN: none), and which of them are local."""
    columns = ClockColumns(column="t", date="d" if clock.date is not None else (), formats=clock.formats)
    cells = [table.column(clock.place), *([] if clock.date is None else [table.column(clock.date)])]
    times, local = read_clock(columns, cells, clock.decimal)
    return (unroll_midnight(times) if columns.daily else times), local


def _one_order(table: FoundTable, clocks: Sequence[FoundClock], answers: Answers, now: float) -> FoundClock:
    """Of readings year, day and month first the one that leaves a clock in order, else what the language says."""
    wanted = [clock for clock in clocks if clock.order == answers.dates]
    if wanted or len(clocks) == 1:
        return (wanted or list(clocks))[0]
    # All rows of the sample: the first ones may all be of one day, and a later one of the 13th.
    whole = {clock.order: sample_seconds(table, clock)[0] for clock in clocks}
    read = {order: int(np.isfinite(times).sum()) for order, times in whole.items()}
    clocks = [clock for clock in clocks if read[clock.order] == max(read.values())]
    latest = {clock.order: float(np.nanmax(whole[clock.order])) for clock in clocks}
    clocks = [clock for clock in clocks if latest[clock.order] <= now + _ZONES_APART_S] or clocks
    if len(clocks) == 1:
        return clocks[0]
    steps = {clock.order: np.diff(whole[clock.order][np.isfinite(whole[clock.order])]) for clock in clocks}
    in_order = [c for c in clocks if np.all(steps[c.order] >= 0) or np.all(steps[c.order] <= 0)]
    # Days that cross a month's end jump by a month when day and month are exchanged.
    longest = {clock.order: float(np.abs(steps[clock.order]).max(initial=0.0)) for clock in clocks}
    smooth = [c for c in clocks if longest[c.order] <= 0.1 * min(longest[o.order] for o in clocks if o is not c)]
    if len(in_order) == 1 or len(smooth) == 1:
        return (in_order if len(in_order) == 1 else smooth)[0]
    later = latest.get("year", np.nan) - max(latest[clock.order] for clock in clocks if clock.order != "year")
    # A year of two digits comes first with dashes, where nothing else is as good; or what came last would be long ago.
    if not later > _LONG_AGO_S:
        clocks = [clock for clock in clocks if not any("%y/" in format_ for format_ in clock.formats)] or clocks
    orders = {clock.order: clock for clock in clocks}
    if len(orders) == 1:
        return clocks[0]
    numbers_ = find_decimal([table.column(place) for place in range(len(table.header))], table.separator)
    if "day" in orders and (numbers_ == "," or table.separator == ";" or day_first(" ".join(table.header))):
        return orders["day"]
    if "month" in orders and any("%p" in format_ for format_ in orders["month"].formats):
        return orders["month"]
    if later < -_LONG_AGO_S and "day" in orders:
        return orders["day"]
    shown = table.column(clocks[0].date if clocks[0].date is not None else clocks[0].place)[0]
    raise Undecided(
        table.path,
        f"in {shown!r} the {' or the '.join(sorted(orders))} may come first",
        "dates",
        [clock.order for clock in clocks],
        guess="year" if later > _LONG_AGO_S else "",
    )


_ZONES_APART_S = 86400.0
"""s by which a local time may be ahead of the clock of the computer that reads it."""
_LONG_AGO_S = 10 * 365.25 * 86400.0
"""s by which a reading of a date is so much older than another that the other is likelier."""


def choose_parts(where: object, columns: Sequence[FoundColumn], answers: Answers) -> Parts:
    """Temperature, load and switch.

    Raises Undecided where two fit, or only movement speaks; TraceError for no number.
    """
    counted = [column for column in columns if column.kind == "number"]
    if not counted:
        raise TraceError(
            f"{where}: none of its columns holds numbers; they are {list_names(c.header for c in columns)}"
        )
    reasons: dict[str, str] = {}
    moving = [column for column in counted if column.moves] or counted
    temperature = _answered_column(where, "temperature", answers.temperature, counted, reasons) or _best(
        where,
        "temperature",
        moving,
        lambda column: temperature_score(column.name, column.unit),
        reasons,
        near=_near_temperature,
    )
    if temperature is None:
        # What is named like a load, or measures something else, moves as slowly where it is the only one.
        unnamed = [column for column in moving if not (column.unit or _loads(column))]
        slow = [column for column in unnamed if is_slow(column.values)]
        if len(moving) != 1 or not slow:
            raise Undecided(
                where,
                "no column is named like one temperature, and these move slowly between -40 and 200"
                if slow
                else "no column is named like one temperature, or moves like one",
                "temperature",
                [column.header for column in slow or counted],
                guess=slow[0].header if len(slow) == 1 else counted[0].header if counted == unnamed[:1] else "",
            )
        temperature, reasons["temperature"] = slow[0], "the only column of numbers"
    others = [column for column in counted if column is not temperature]
    load = _load(where, others, columns, answers, reasons)
    more = [_answered_column(where, "current", name, others, reasons) for name in answers.current[1:]]
    running, standstill = _switch(where, columns, load, answers, reasons)
    return Parts(temperature, load, running, standstill, reasons, tuple(each for each in more if each is not None))


def _near_temperature(best: FoundColumn, other: FoundColumn) -> bool:
    """Whether another column may be the temperature as well as the best by name, which only a bearing's surely is."""
    if named_bearing(best.name) or named_surroundings(other.name):
        return False
    # What flows through a machine may be what it is about: a boiler's water, beside a temperature of nobody knows what.
    return temperature_score(other.name, other.unit) > 0 and bool(other.unit or not best.unit)


def _near_current(best: FoundColumn, other: FoundColumn) -> bool:
    """Whether another column has the unit of a current too: its name may only not say so."""
    return bool(best.unit and other.unit) and current_score(other.name, other.unit) > 0


def _of_loop(column: FoundColumn) -> bool:
    """Whether a current in mA never exceeds what a sensor's loop carries."""
    small = column.unit == "A" and column.scale < 1.0
    return small and float(np.nanmax(np.abs(column.values), initial=0.0)) <= _LOOP_CURRENT


def _likely_load(loads: Sequence[FoundColumn]) -> str:
    """Of several loads the one that is a total, or that alone dwells near 0 and far from it; "" where none is."""
    totals = [column.header for column in loads if named_total(column.name)]
    dwelling = [column.header for column in loads if has_levels(column.values)]
    for likely in (totals, dwelling):
        if len(likely) == 1:
            return likely[0]
    return ""


def _load(
    where: object,
    others: Sequence[FoundColumn],
    columns: Sequence[FoundColumn],
    answers: Answers,
    reasons: dict[str, str],
) -> FoundColumn | None:
    """What loads the machine: its current, else power, speed or torque by name; by movement only if a person says."""
    if NO_COLUMN in answers.current:
        return None
    moving = [column for column in others if column.moves and not _of_loop(column)]
    found = _answered_column(where, "current", next(iter(answers.current), ""), others, reasons) or _best(
        where, "current", moving, lambda column: current_score(column.name, column.unit), reasons, near=_near_current
    )
    if found is not None:
        _check_loop(where, found, answers)
        return found
    loops = [column for column in others if column.moves and current_score(column.name, column.unit)]
    # A small motor's may be as small: one that is named a current is asked for beside other loads.
    small = [column for column in loops if named_current(column.name)]
    loads = [*small, *(column for column in moving if load_score(column.name, column.unit))]
    loads = [column for column in loads if not named_remainder(column.name)] or loads
    if len(loads) > len(small):
        # How they move is evidence and no choice: the rest of a chip's power dwells near 0 as well.
        loads.sort(key=lambda column: (not named_total(column.name), not has_levels(column.values)))
        what = "columns that may say what loads the machine"
        return _best(where, "current", loads, lambda column: 1, reasons, what=what, guess=_likely_load)
    if loops:
        raise Undecided(
            where,
            f"no column is named like a load but by mA, and of these none exceeds {1e3 * _LOOP_CURRENT:g} mA, as a "
            "sensor's own current or a 4 to 20 mA loop does not",
            "current",
            [*(column.header for column in loops), NO_COLUMN],
            guess=NO_COLUMN,
        )
    levels = [column for column in moving if not column.unit and has_levels(column.values)]
    if not levels:
        return None
    raise Undecided(
        where,
        "no column is named like a current, a power or a speed; by their movement these dwell near 0 and far "
        "from it, as what "
        "loads a machine does",
        "current",
        [*(column.header for column in levels), NO_COLUMN],
        guess=levels[0].header if len(levels) == 1 else "",
    )


def _check_loop(where: object, load: FoundColumn, answers: Answers) -> None:
    """Raises Undecided for a load without a unit that rests at 4.00 and is nowhere more than a loop's mA are."""
    finite = load.values[np.isfinite(load.values)]
    if load.unit or not _fits_loop(finite) or any(text.startswith(f"{load.header}=") for text in answers.unit):
        return
    rest = finite[finite <= _LOOP_REST_MA]
    low, median, high = np.quantile(rest, (0.05, 0.5, 0.95)) if rest.size else (0.0, 0.0, 0.0)
    if (
        _LOOP_REST_SHARE * finite.size < rest.size < finite.size
        and abs(median - _LOOP_ZERO_MA) <= _LOOP_BAND_MA
        and high - low <= _LOOP_BAND_MA
    ):
        raise Undecided(
            where,
            f"{load.header!r} says no unit, rests at {median:.3g} and goes to {finite.max():.3g}, as a loop of 4 to 20 "
            "mA does: export it in A, give the map its scale and offset, or say that it is in A",
            "unit",
            [f"{load.header}=A"],
            guess=f"{load.header}=A",
        )


_LOOP_ZERO_MA, _LOOP_BAND_MA = 4.0, 0.05
"""mA by which a loop says 0, and how far from it a resting one is at most; what an idling motor draws is elsewhere."""
_LOOP_REST_MA, _LOOP_REST_SHARE = 4.4, 0.02
"""mA below which a loop says next to nothing, and the share of the readings that must."""


def _fits_loop(values: Array) -> bool:
    """Whether readings may be a loop's mA: within its range, and most of them finer than tenths, a hundredth of it."""
    if not values.size or float(values.min()) < _LOOP_MA[0] or float(values.max()) > _LOOP_MA[1]:
        return False
    return bool(np.mean(np.abs(10.0 * values - np.round(10.0 * values)) > _NO_TENTH) > 0.5)


_NO_TENTH = 1e-3
"""Of a tenth, by which a reading of few digits is none, however it was stored."""


def _switch(
    where: object,
    columns: Sequence[FoundColumn],
    load: FoundColumn | None,
    answers: Answers,
    reasons: dict[str, str],
) -> tuple[FoundColumn | None, FoundColumn | None]:
    """(the switch of running, the one of standstill), one of them at most."""
    if answers.running == NO_COLUMN:
        return None, None
    switches = [column for column in columns if column.kind == "switch"]
    running = _answered_column(where, "running", answers.running, switches, reasons)
    said = [column for column in switches if answers.on and column.words and set(column.words[0]) <= set(answers.on)]
    if running is None and said:
        running, reasons["running"] = said[0], "as --on says"
    if running is None:
        direct = [column for column in switches if not named_standstill(column.name)]
        running = _best(
            where,
            "running",
            direct,
            lambda column: _runs(column, load),
            reasons,
            settle=lambda rivals: _of_load(rivals, load),
        )
        still = [column for column in switches if named_standstill(column.name) and column.moves]
        if running is None and len(still) == 1 and not answers.on:
            reasons["running"] = f"not {still[0].name}, by its name"
            return None, still[0]
    if running is not None:
        _check_load(where, running, load, answers)
        return running, None
    if load is not None:
        return None, None
    candidates = [column for column in switches if column.moves and dwells(column.cells)]
    if candidates and not answers.running:
        raise Undecided(
            where,
            "no column is named like one that says whether the machine runs, and these have two states",
            "running",
            [*(column.header for column in candidates), NO_COLUMN],
            guess=candidates[0].header if len(candidates) == 1 else "",
        )
    return None, None


def _runs(switch: FoundColumn, load: FoundColumn | None) -> int:
    """How much a switch says by its name that the machine runs; where no name does, words that go with the load do."""
    said = any(cell.casefold() in RUN_WORDS for cell in set(switch.cells))
    return running_score(switch.name) or int(said and (load is None or _of_load([switch], load) is not None))


def _of_load(switches: Sequence[FoundColumn], load: FoundColumn | None) -> FoundColumn | None:
    """The one switch that is on while the load is drawn, and off while it is not; None where several are, or none.

    None also where another is on all the while that the load is drawn: a motor may be switched on before it is loaded.
    """
    along, rivals = list[FoundColumn](), list[FoundColumn]()
    for switch in switches:
        if load is None or switch.values.shape != load.values.shape:
            continue
        both = np.isfinite(switch.values) & np.isfinite(load.values)
        drawn = np.abs(load.values[both]) > _IDLE_CURRENT_SHARE * np.abs(load.values[both]).max(initial=0.0)
        on = switch.values[both] == 1
        if not drawn.any() or drawn.all():
            continue
        along += [switch] if np.mean(on == drawn) >= _ALONGSIDE else []
        rivals += [switch] if np.mean(on[drawn]) >= _ALONGSIDE else []
    return along[0] if len(along) == 1 and all(rival is along[0] for rival in rivals) else None


def _check_load(where: object, running: FoundColumn, load: FoundColumn | None, answers: Answers) -> None:
    """Raises Undecided for a switch that is on while the load is 0 and off while it is not."""
    if load is None or answers.on or answers.running or running.values.shape != load.values.shape:
        return
    both = np.isfinite(running.values) & np.isfinite(load.values)
    on, off = load.values[both & (running.values == 1)], load.values[both & (running.values == 0)]
    most = float(np.abs(load.values[both]).max(initial=0.0))
    if on.size < 5 or off.size < 5 or not np.median(np.abs(on)) < _IDLE_CURRENT_SHARE * most < np.median(np.abs(off)):
        return
    cells = sorted({cell for cell in running.cells if cell})
    raise Undecided(
        where,
        f"{running.header!r} is on while {load.header!r} is {np.median(on):.3g}, and off while it is "
        f"{np.median(off):.3g}; "
        "which of its words means running",
        "on",
        cells,
        guess=next(cell for cell in cells if booleans([cell])[0][0] == 0),
    )


def with_units(where: object, columns: Sequence[FoundColumn], answers: Answers, clock: str) -> list[FoundColumn]:
    """The columns in the units that a person names, but that of the `clock`. Raises TraceError for what is none, or no
    column."""
    wanted: dict[str, str] = {}
    for text in answers.unit:
        name, mark, unit = text.rpartition("=")
        if name == clock:
            continue
        known = known_unit(unit)
        if not mark or not known or name not in (column.header for column in columns):
            raise TraceError(f"{where}: --unit {text}: give it as COLUMN=UNIT, such as 'Bearing temperature=K'")
        wanted[name] = known
    return [
        _in_unit(column, wanted[column.header]) if column.header in wanted and column.kind == "number" else column
        for column in columns
    ]


def _in_unit(column: FoundColumn, unit: str) -> FoundColumn:
    kept = CONVERTED_UNITS.get(unit, unit)
    raw: Array = (column.values - column.offset) / column.scale
    scale, offset = conversion(unit, kept)
    return replace(column, unit=kept, values=raw * scale + offset, scale=scale, offset=offset)


def check_temperature(
    where: object, columns: Sequence[FoundColumn], temperature: FoundColumn, answers: Answers
) -> None:
    """Raises Undecided for a temperature in degC by nobody's word that behaves as one in another unit."""
    header = temperature.header
    finite = temperature.values[np.isfinite(temperature.values)]
    if temperature.scale != 1.0 or temperature.offset or temperature.measured or not finite.size:
        return
    if any(text.startswith(f"{header}=") for text in answers.unit):
        return
    low, high = float(finite.min()), float(finite.max())
    if not temperature.unit and _fits_loop(finite):
        raise Undecided(
            where,
            f"{header!r} says no unit, and its readings, finer than tenths, lie between {low:.4g} and {high:.4g}, as "
            "those of a loop of 4 to 20 mA do, or of a cold machine: export a loop's in degC or give the map its scale "
            "and offset, or say that it is in degC",
            "unit",
            [f"{header}=degC"],
            guess=f"{header}=degC",
        )
    whole = bool(np.all(finite % 1 == 0))
    kelvin = _KELVIN_REST_RANGE[0] < low < _KELVIN_REST_RANGE[1]
    # Whole numbers that no bearing reaches are tenths, whatever unit the header names.
    tenths = whole and (low > _MAX_REST_DEGC or high > HOTTEST)
    if (low > _MAX_REST_DEGC and not temperature.unit) or tenths:
        # Counts of a converter are whole too, and are no tenths of what a bearing can have.
        parts = whole and 0.1 * low <= _MAX_REST_DEGC and 0.1 * high <= HOTTEST
        likely = "K" if kelvin and not whole else "0.1 degC" if parts else ""
        choices = [*(["K"] if kelvin else []), *(["0.1 degC"] if parts else []), "degC"]
        raise Undecided(
            where,
            f"{header!r} goes from {low:g} to {high:g}{'' if temperature.unit else ' and says no unit'}: no bearing "
            f"{f'rests at {low:g}' if low > _MAX_REST_DEGC else f'reaches {high:g}'} degC; in "
            f"{' or '.join({'K': 'kelvin'}.get(unit, unit) for unit in choices[:-1]) or 'another unit'} it may",
            "unit",
            [f"{header}={unit}" for unit in choices],
            guess=f"{header}={likely}" if likely else "",
        )
    for twin in columns:
        if twin is temperature or twin.kind != "number" or twin.values.shape != temperature.values.shape:
            continue
        both = np.isfinite(twin.values) & np.isfinite(temperature.values)
        if both.sum() < 10 or np.ptp(twin.values[both]) < 1.0 or twin.scale != 1.0:
            continue
        for hot, cold in ((temperature, twin), (twin, temperature)):
            slope, rest = np.polyfit(cold.values[both], hot.values[both], 1)
            error = float(np.abs(hot.values[both] - slope * cold.values[both] - rest).max())
            if abs(slope - 1.8) < 0.02 and abs(rest - 32.0) < 1.0 and error < 0.5 and not temperature.unit:
                raise Undecided(
                    where,
                    f"{hot.header!r} is 1.8 times {cold.header!r} and 32 more: the same in degF; the model needs degC",
                    "unit",
                    [f"{hot.header}=F", f"{hot.header}=C"],
                    guess=f"{hot.header}=F",
                )


def check_scale(
    where: object, temperature: FoundColumn, running: str, traces: Sequence[Trace], answers: Answers
) -> None:
    """Raises Undecided for a temperature that is in another unit from some reading on, for good or for a while.

    All rows are looked at, those of each machine and session for themselves. `running` is the switch of the machine.
    """
    if (temperature.scale, temperature.offset) != (1.0, 0.0) or temperature.measured:
        return
    if any(text.startswith(f"{temperature.header}=") for text in answers.unit):
        return
    for trace in traces:
        if temperature.name not in trace.signals:
            continue
        values = trace.signals[temperature.name]
        at = np.flatnonzero(np.isfinite(values) & ~np.isin(values, temperature.bad))
        switch = trace.signals.get(running, np.zeros(0))
        said = np.flatnonzero(np.isfinite(switch))
        turned, turns = trace.times[said][1:], np.diff(switch[said])
        if change := _changed_unit(trace.times[at], values[at], turned[turns > 0], turned[turns < 0]):
            place, how = change
            before, after = values[at[place]], values[at[place + 1]]
            raise Undecided(
                where,
                f"{temperature.header!r} goes from {before:g} to {after:g} at reading {place + 2}"
                f"{f' of {trace.name}' if len(traces) > 1 else ''} and goes on there, which is the same {how}: export "
                "what is in one unit and what is in the other apart, or say that it is in one",
                "unit",
                [f"{temperature.header}=degC"],
            )


def _changed_unit(times: Array, read: Array, starts: Array, stops: Array) -> tuple[int, str] | None:
    """(place of the reading before it, how both are one) of the first step in which a temperature changes its unit.

    It is of another kind than the steps that change none, leads to where the readings go on, and is none that each of
    the machine's `starts` (or `stops`) makes. None where no step is one.
    """
    if read.size < 2 * _LEAST_BESIDE:
        return None
    spans, moves = np.diff(times), np.diff(read)
    follows = _TIMES_USUAL_SPAN * float(np.median(spans))
    close, steps = spans <= follows, np.abs(moves)
    if not close.any():
        return None
    habit = float(np.quantile(steps[close], _USUAL_SHARE, method="lower"))
    jumps = close & (steps > _TIMES_USUAL_STEP * max(habit, _UNIT_SLACK))
    low, high = np.minimum(read[:-1], read[1:]), np.maximum(read[:-1], read[1:])
    for factor, offset, how in ((1.8, 32.0, "in degC and in degF"), (1.0, 273.15, "in degC and in kelvin")):
        off = np.abs((high - offset) / factor - low)
        changes = jumps & (off <= max(habit, 1.0) + _UNIT_SLACK)
        usual = float(steps[close & ~changes].max(initial=0.0))
        changes &= steps > _TIMES_USUAL_STEP * usual
        for turns, ways in ((starts, moves > 0), (stops, moves < 0)):
            made = times[1:][changes & ways]
            if turns.size and made.size and all(np.abs(made - turn).min() <= follows for turn in turns.tolist()):
                changes &= ~ways
        for place in np.flatnonzero(changes).tolist():
            around = slice(max(place + 1 - _LEAST_BESIDE, 0), place + 1 + _LEAST_BESIDE)
            course = read[around].copy()
            if course.size < 2 * _LEAST_BESIDE or not close[around][:-1].all():
                continue
            other = course[_LEAST_BESIDE:] if moves[place] > 0 else course[:_LEAST_BESIDE]
            other[:] = (other - offset) / factor
            # In one unit the step is as those beside it are, but for how much these differ from one another.
            moved = np.diff(course)
            beside = np.delete(moved, _LEAST_BESIDE - 1)
            expected = (moved[_LEAST_BESIDE - 2] + moved[_LEAST_BESIDE]) / 2
            # A lone reading is followed by another change.
            if np.abs(beside).max() > usual + _UNIT_SLACK:
                continue
            if abs(moved[_LEAST_BESIDE - 1] - expected) <= np.abs(np.diff(beside)).max() + _UNIT_SLACK:
                return place, how
    return None


_LEAST_BESIDE = 5
"""Readings on either side of a step that may be a change of the unit."""
_TIMES_USUAL_SPAN = 3.0
"""Times the usual time between readings, up to which one follows the other: beyond it is a pause."""
_TIMES_USUAL_STEP = 3.0
"""Times the largest other step, from which on a step is of another kind."""
_USUAL_SHARE = 0.95
"""Share of the steps that are usual ones: changes of the unit are fewer than the others."""
_UNIT_SLACK = 0.1
"""degC by which two readings beside each other may differ in their last digit."""


def _answered_column(
    where: object, part: str, wanted: str, columns: Sequence[FoundColumn], reasons: dict[str, str]
) -> FoundColumn | None:
    """The column that an answer names. Raises TraceError for one that is not there or cannot play the part."""
    if not wanted:
        return None
    # With its unit or without, whole names before those.
    for name_of in (
        lambda column: column.header,
        lambda column: column.name,
        lambda column: split_unit(column.header)[0],
    ):
        fitting = [column for column in columns if name_of(column).casefold() == wanted.casefold()]
        if len(fitting) == 1:
            reasons[part] = f"as --{part} says"
            return fitting[0]
    headers = [column.header for column in columns]
    remedy = did_you_mean(wanted, headers) or f"those that can be it are {list_names(map(repr, headers)) or 'none'}"
    raise TraceError(f"{where}: --{part} {wanted}: no column of that name can be it; {remedy}")


def _span(column: FoundColumn) -> str:
    """Between what a column's readings lie; "" of a switch."""
    if column.kind != "number":
        return ""
    low, high = np.nanmin(column.values), np.nanmax(column.values)
    return f"{low:.3g} to {high:.3g}{' ' if column.unit else ''}{column.unit}"


def _best(
    where: object,
    part: str,
    columns: Sequence[FoundColumn],
    score: Callable[[FoundColumn], int],
    reasons: dict[str, str],
    *,
    what: str = "",
    settle: Callable[[Sequence[FoundColumn]], FoundColumn | None] = lambda _: None,
    near: Callable[[FoundColumn, FoundColumn], bool] = lambda best, other: False,
    guess: Callable[[Sequence[FoundColumn]], str] = lambda _: "",
) -> FoundColumn | None:
    """The column with the best score for a part, by its name and unit; None where none has any.

    Of several that are alike by name `settle` takes one by what they hold, or None. What is `near` to the best is asked
    for with it, and `guess` is the header of the one that is most likely, "" for none.
    """
    highest = max(map(score, columns), default=0)
    best = [column for column in columns if score(column) == highest] if highest > 0 else []
    if not best:
        return None
    best += [column for column in columns if all(column is not each for each in best) and near(best[0], column)]
    # Columns with the same readings, as of a setpoint and its echo, are one.
    if any(not np.array_equal(a.values, b.values, equal_nan=True) for a, b in combinations(best, 2)):
        if (settled := settle(best)) is None:
            raise Undecided(
                where,
                what or f"columns that may be the {part}",
                part,
                [column.header for column in best],
                guess=guess(best),
                seen=[_span(column) for column in best],
            )
        reasons[part] = "it is on while the load is drawn, and off while it is not"
        return settled
    reasons[part] = "by its name" + (f" and its unit {best[0].unit}" if best[0].unit else "")
    return best[0]


def with_words(
    where: object, columns: Sequence[FoundColumn], times: Sequence[Array], answers: Answers
) -> list[FoundColumn]:
    """The columns, those of a few words as the switches that they are if a name or an answer says so.

    Raises Undecided where it is not known which of the words mean running; the temperature says which are likely.
    """
    named = [column for column in columns if answers.running in (column.header, column.name) and answers.running]
    states = [column for column in columns if column.kind == "states" and running_score(column.name)]
    known = [column for column in columns if column.kind == "switch" and running_score(column.name)]
    if not named and not states and not known and not answers.running:
        loads = [column for column in columns if column.kind == "number" and _loads(column)]
        dwelling = [column for column in columns if column.kind == "states" and dwells([c for c in column.cells if c])]
        # Nothing else says whether the machine runs.
        states = [] if loads else dwelling
    of_machine = named or ([] if known or answers.running == NO_COLUMN else states)
    if len(of_machine) > 1:
        if not answers.running:
            raise Undecided(
                where,
                "columns whose words may say whether the machine runs",
                "running",
                [*(c.header for c in of_machine), NO_COLUMN],
            )
        of_machine = of_machine[:1]
    if answers.on and not of_machine:
        of_machine = [c for c in columns if c.kind in ("switch", "states") and set(answers.on) <= set(c.cells)][:1]
    switched: list[FoundColumn] = []
    for column in columns:
        cells = [cell for cell in dict.fromkeys(column.cells) if cell]
        if column in of_machine and (column.states or answers.on):
            on = [word for word in answers.on if word in cells]
            if not on:
                likely = _warming_state(column, columns, times)
                raise Undecided(
                    where,
                    f"words of {column.header!r} that may mean running"
                    + (f" (the temperature rises most in {likely!r})" if likely else ""),
                    "on",
                    cells,
                    guess=likely,
                )
            values = np.array([np.nan if not cell else float(cell in on) for cell in column.cells])
            off = tuple(cell for cell in cells if cell not in on)
            column = replace(column, kind="switch", values=values, words=(tuple(on), off), states=())
        switched.append(column)
    return switched


def _loads(column: FoundColumn) -> bool:
    return column.moves and bool(current_score(column.name, column.unit) or load_score(column.name, column.unit))


def _warming_state(states: FoundColumn, columns: Sequence[FoundColumn], times: Sequence[Array]) -> str:
    """The word in which the temperature rises fastest; "" where no temperature is named or none rises."""
    named = [
        (column, own)
        for column, own in zip(columns, times, strict=True)
        if column.kind == "number" and temperature_score(column.name, column.unit) and len(column.cells or states.cells)
    ]
    if not named or named[0][0].values.size != len(states.cells):
        return ""
    values, at = named[0][0].values, named[0][1]
    steps = np.diff(at)
    with np.errstate(divide="ignore", invalid="ignore"):
        rates = np.where(steps > 0, np.diff(values) / steps, np.nan)
    words = np.array(states.cells[:-1])
    means = {word: float(np.nanmean(own)) for word in states.states if np.isfinite(own := rates[words == word]).any()}
    best = max(means, key=lambda word: means[word], default="")
    return best if best and means[best] > 0 else ""
