"""What the rows of a table are: whose, what equal and falling times mean, and whether silence says something."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from itertools import pairwise, product

import numpy as np

from sim.lab.recordings import TraceError, list_names, longest_rising_rows, numbers, to_utc
from sim.lab.recordings.mapping.answers import Answers, Undecided
from sim.lab.recordings.mapping.clocks import FoundClock
from sim.lab.recordings.mapping.columns import FoundColumn
from sim.lab.recordings.mapping.table import FoundTable
from sim.lab.recordings.mapping.words import named_machine, named_session, surely_machine
from sim.sha import EARLY_SHARE, Array, Mask

_ZONES = (
    "Europe/Rome", "Europe/London", "Europe/Athens", "America/New_York", "America/Chicago", "America/Denver",
    "America/Los_Angeles", "America/Sao_Paulo", "Australia/Sydney",
)  # fmt: skip
"""One zone for each hour at which summer time ends somewhere with plants; those beside it keep the same rule."""
_MAX_HICCUP_SHARE = 0.01
"""Share of rows that may be merged or refused without a question: a recorder's hiccups are fewer."""
_MAX_OWNERS = 500
"""Machines or sessions of one export: more words in a column are readings."""
_MAX_REMAINING_SHARE = 0.02
"""Of the doubled or falling times so many may be left within one machine, as of a recorder's hiccup."""
_LONGEST_STEP_S = 900.0
"""s of a step beside which an hour more is told from a pause."""
_OWNER_GAP_S = 1e12
"""s between machines or sessions whose times are looked at together: no recording lasts so long."""
_MIN_STEPS = 3
"""Steps between a column's readings below which they show no habit."""
_LONG_STEP_RATIO = 3.0
"""Of the shortest usual steps: a longer one is silence, where a lost row or two makes two or three."""
_MIN_SILENT_SHARE = 0.1
"""Share of the time in silence, at least, in a recording that is stored on change: what is seldom is a lost row."""
_MAX_REPEAT_SHARE = 0.05
"""Share of values that are those before them; a recorder of each row repeats what stands still, and noise a few."""
_MIN_POLLED = 3
"""Columns that have another value in every row, of a table that is stored row by row."""
_AT_ONCE_SHARE = 0.1
"""Of the usual step; no poll is so much sooner."""
_MAX_UNEVEN_SHARE = 0.05
"""Share of steps that differ from the usual one by half of it; nights without a recorder are few."""
_MAX_SPARSE_SHARE = 0.7
"""Share of the rows in which a column of a polled table has a cell, but for faults."""
_SMALL_MOVE_QUANTILE_RATIO = 0.2
"""The smallest moves beside the usual one: of noise a tenth, beyond a deadband nearly as large."""
_MIN_SOON_SHARE = 0.05
"""Share of steps, at least, that come sooner, or there is one usual step and no longest silence."""
_HALF_DAY = 43200.0
_SILENCE_MARGIN = 1.5
"""Of the longest silence that is seen: another export of the same recorder has a somewhat longer one."""
_WIDE_SILENCE_MARGIN = 3.0
"""The same where no longest time of the recorder shows: how long a load stays as it is has no limit, but a habit."""
_MIN_HELD_STEP_S = 10.0
"""s between held values at least: of the shortest horizon of a forecast, a minute, a sixth."""
_MAX_HELD_ROWS = 1_000_000
"""Rows that held values may make of the sample: more take longer to learn from than they teach."""
_OUTAGE_RATIO = 6.0
"""A silence so many times the next shorter one is an outage, not a value that held."""


@dataclass(frozen=True, slots=True)
class Rows:
    """Places of the columns of machine and session (None: none), and the map's keys for times; `said` is why."""

    machine: int | None
    session: int | None
    duplicates: str
    clock_back: str
    timezone: str
    said: tuple[str, ...]


def describe_rows(
    table: FoundTable, clock: FoundClock, times: Array, local: Mask, *, series: Sequence[str], answers: Answers
) -> Rows:
    """What the sample's rows are. `series` says which signal a row is of, "" for all (a wide table).

    Raises Undecided where the times contradict one another and no column explains it.
    """
    inside = _codes(series)
    if _falls(times, inside) > _rises(times, inside):
        order = np.arange(times.size)[::-1]
        times, local, inside = times[order], local[order], inside[order]
        table = replace(table, rows=table.rows[::-1])
    # An hour twice in autumn is no sign of several machines: any column that changes in it would tell them apart.
    autumn = (answers.timezone or _zone(times, local, inside)) if local.any() and _falls(times, inside) else ""
    even = to_utc(times, local, autumn) if autumn else times
    machine, session, said = _owners(table, clock, even if _trouble(even, inside) == 0 else times, inside, answers)
    for place in (machine, session):
        if place is not None:
            inside = _codes(list(zip(inside.tolist(), table.column(place), strict=True)))
    timezone = answers.timezone
    if not timezone and local.any() and _falls(times, inside):
        timezone = _zone(times, local, inside)
        if timezone:
            said.append(
                f"its clock goes back by an hour at {_moment(times, inside)}, as summer time of {timezone} "
                f"ends: it is read "
                "in that zone; --timezone names another"
            )
    if not timezone and local.any():
        timezone, jump = _zone_of_spring(times, local, inside)
        if timezone:
            said.append(
                f"its clock goes forward by an hour at {jump}, as summer time of {timezone} begins: it is read in that "
                "zone; --timezone names another"
            )
    if timezone and local.any():
        times = to_utc(times, local, timezone)
    clock_back = _backward_text(table, times, inside, answers)
    if clock_back == "split":
        inside = inside + _MAX_OWNERS * np.cumsum(np.concatenate(([False], np.diff(times) < 0)))
    duplicates = _duplicates(table, clock, times, inside, answers)
    if duplicates == "spread" and not answers.duplicates:
        said.append("its clock is coarser than its rows: those of one time are spread evenly up to the next")
    return Rows(
        machine=machine,
        session=session,
        duplicates=duplicates,
        clock_back=clock_back,
        timezone=timezone,
        said=tuple(said),
    )


def separate_times(table: FoundTable, rows: Rows, times: Array) -> Array:
    """The times with those of each machine and session far from those of others: no step leads from one to another."""
    places = [place for place in (rows.machine, rows.session) if place is not None]
    if not places:
        return times
    return times + _OWNER_GAP_S * _codes([tuple(row[place] for place in places) for row in table.rows])


def _codes(names: Sequence[object]) -> Array:
    if len(set(names)) < 2:
        return np.zeros(len(names))
    table: dict[object, int] = {}
    return np.array([table.setdefault(name, len(table)) for name in names], dtype=float)


def _steps(times: Array, inside: Array) -> Array:
    order = np.argsort(inside, kind="stable")
    return np.asarray(np.diff(times[order])[np.diff(inside[order]) == 0])


def _falls(times: Array, inside: Array) -> int:
    return int((_steps(times, inside) < 0).sum())


def _rises(times: Array, inside: Array) -> int:
    return int((_steps(times, inside) > 0).sum())


def _trouble(times: Array, inside: Array) -> int:
    return int((_steps(times, inside) <= 0).sum())


def _owners(
    table: FoundTable, clock: FoundClock, times: Array, inside: Array, answers: Answers
) -> tuple[int | None, int | None, list[str]]:
    header = table.header
    given = [_place(table, "machine", answers.machine), _place(table, "session", answers.session)]
    if answers.machine or answers.session:
        return given[0], given[1], []
    before = _trouble(times, inside)
    few = {
        place: cells
        for place, name in enumerate(header)
        if name and place not in (clock.place, clock.date) and _says_whose(cells := table.column(place), name)
    }
    codes = {place: _codes(cells) for place, cells in few.items()}

    def count_rest(places: Sequence[int]) -> int:
        return _trouble(
            times, _codes(list(zip(inside.tolist(), *(codes[place].tolist() for place in places), strict=True)))
        )

    chosen: tuple[int, ...] = ()
    if before > _MAX_REMAINING_SHARE * times.size or (before and _falls(times, inside)):
        singles = [place for place in few if count_rest([place]) <= _MAX_REMAINING_SHARE * before]
        # In autumn each machine's clock goes back once, too, for each of its signals.
        nights = {
            place: len(set(few[place])) * len(np.unique(inside)) for place in few if surely_machine(header[place])
        }
        singles += [
            place for place, most in nights.items() if place not in singles and count_rest([place]) <= most < before
        ]
        named = [place for place in singles if named_machine(header[place]) or named_session(header[place])]
        if singles:
            chosen = (min(named or singles, key=lambda place: (len(set(few[place])), place)),)
        else:
            pairs = [
                pair
                for pair in product(few, repeat=2)
                if named_machine(header[pair[0]]) and named_session(header[pair[1]]) and pair[0] != pair[1]
            ]
            chosen = next((pair for pair in pairs if count_rest(pair) <= _MAX_REMAINING_SHARE * before), ())
    else:
        # Machines one after another: nothing is doubled, and yet they are several.
        chosen = tuple(place for place in few if surely_machine(header[place]))[:1]
    if not chosen:
        return None, None, []
    said = [
        f"column {header[place]!r} says whose rows are ({list_names(map(repr, dict.fromkeys(few[place])), 4)}): each "
        + (
            f"has the same times as others ({before} times are doubled or fall without it)"
            if before
            else "comes in turn"
        )
        for place in chosen
    ]
    if len(chosen) == 2:
        return chosen[0], chosen[1], said
    blocks = int((np.diff(codes[chosen[0]]) != 0).sum()) + 1 == len(set(few[chosen[0]]))
    name = header[chosen[0]]
    is_session = named_session(name) or (blocks and not named_machine(name))
    return (None, chosen[0], said) if is_session else (chosen[0], None, said)


def _place(table: FoundTable, field: str, wanted: str) -> int | None:
    if not wanted or wanted == "none":
        return None
    if wanted not in table.header:
        raise Undecided(table.path, f"there is no column {wanted!r}", field, [name for name in table.header if name])
    return table.header.index(wanted)


def _says_whose(cells: Sequence[str], name: str) -> bool:
    """Whether a column may say whose rows are: few words or whole numbers, in every row, several rows each."""
    distinct = set(cells)
    if not 2 <= len(distinct) <= min(_MAX_OWNERS, len(cells) / 3) or "" in distinct:
        return False
    values = numbers(sorted(distinct))[0]
    return bool(np.isnan(values).any()) or (bool(np.all(values % 1 == 0)) and (len(distinct) > 2 or bool(name)))


def _moment(times: Array, inside: Array) -> str:
    at = int(np.flatnonzero(np.diff(times) < 0)[0]) if inside.max(initial=0) == 0 else 0
    return datetime.fromtimestamp(float(times[at]), UTC).strftime("%Y-%m-%d %H:%M")


def _zone(times: Array, local: Mask, inside: Array) -> str:
    """The zone in whose autumn the clock goes back, if it goes back for nothing else."""
    for zone in _ZONES:
        utc = to_utc(times, local, zone)
        if np.isfinite(utc).all() and _falls(utc, inside) == 0:
            return zone
    return ""


def _zone_of_spring(times: Array, local: Mask, inside: Array) -> tuple[str, str]:
    """The zone in whose spring the clock goes forward, and when: by an hour more than its step, which that zone leaves
    out. "" where nothing does."""
    order = np.argsort(inside, kind="stable")
    times, local = times[order], local[order]
    steps = np.where(np.diff(inside[order]) == 0, np.diff(times), np.nan)
    rising = steps[steps > 0]
    usual = float(np.median(rising)) if rising.size else np.inf
    places = np.flatnonzero(np.abs(steps - 3600.0 - usual) <= 0.5 * usual)
    if not places.size or usual > _LONGEST_STEP_S:
        return "", ""
    for zone in _ZONES:
        utc = to_utc(times, local, zone)
        # A recorder that is off for this hour on other days, too, is off on that one.
        if np.isfinite(utc).all() and np.all(np.abs(np.diff(utc)[places] - usual) <= 0.5 * usual):
            return zone, f"{datetime.fromtimestamp(float(times[places[0]]), UTC):%Y-%m-%d %H:%M}"
    return "", ""


def _backward_text(table: FoundTable, times: Array, inside: Array, answers: Answers) -> str:
    falls = _falls(times, inside)
    if answers.clock_back or not falls:
        return answers.clock_back or "refuse"
    lost = sum(int((~longest_rising_rows(times[inside == code])).sum()) for code in np.unique(inside))
    if lost <= _MAX_HICCUP_SHARE * times.size:
        return "refuse"
    steps = _steps(times, inside)
    usual = float(np.median(steps))
    # Over noon and midnight: twelve hours less the step that was made.
    if falls and np.all(np.abs(steps[steps < 0] + _HALF_DAY) <= _LONG_STEP_RATIO * abs(usual)):
        raise TraceError(
            f"{table.path}: the clock goes back by twelve hours {falls} times: its hours are those of half a day, and "
            "nothing says which half; export it with 24 hours, or with AM and PM"
        )
    # A ring is written over from its beginning on: what follows the fall ends where the file begins.
    ring = falls == 1 and 0 < float(times[0] - times[-1]) <= _LONG_STEP_RATIO * usual
    anew = falls < times.size / 10 and usual > 0 and not ring
    at = int(np.flatnonzero(np.diff(times) < 0)[0]) + 1
    raise Undecided(
        table.path,
        f"the clock goes back {falls} times, first at reading {at + 1} of the file, and no column tells "
        f"sessions apart: it may "
        "begin anew there (split), or rows may be out of order (sort)",
        "clock-back",
        ["split", "sort"],
        guess="split" if anew else "sort",
    )


def _duplicates(table: FoundTable, clock: FoundClock, times: Array, inside: Array, answers: Answers) -> str:
    if answers.duplicates:
        return answers.duplicates
    order = np.lexsort((times, inside))
    doubled = (np.diff(times[order]) == 0) & (np.diff(inside[order]) == 0)
    if not doubled.any():
        return "agree"
    rows = [tuple(c for p, c in enumerate(row) if p not in (clock.place, clock.date)) for row in table.rows]
    pairs = zip(order[:-1][doubled].tolist(), order[1:][doubled].tolist(), strict=True)
    unequal = sum(
        any(a and b and a != b for a, b in zip(rows[first], rows[second], strict=True)) for first, second in pairs
    )
    if unequal <= _MAX_HICCUP_SHARE * times.size:
        return "agree"
    lost = _lost_part(times)
    if inside.max(initial=0) == 0 and lost and (count := _rows_a_time(times)) > 1 and _is_continuous(rows, count):
        return "spread"
    raise Undecided(
        table.path,
        f"{unequal} of {times.size} rows have the time of another row and other readings, and no column tells "
        f"machines apart{'; if the clock only lost its seconds, they are spread' if lost else ''}",
        "duplicates",
        ["average", "last", *(["spread"] if lost else [])],
    )


def _lost_part(times: Array) -> bool:
    """Whether the clock may have lost what stands behind its seconds, minutes or hours: one step of it is one of those.

    A clock that shows 10 and 20 s would show 15 s.
    """
    steps = np.diff(np.unique(times))
    return bool(steps.size) and bool(np.isin(np.median(steps), (1.0, 60.0, 3600.0)))


def _rows_a_time(times: Array) -> int:
    """How many rows each time has, if all have as many and come evenly; 0 if not."""
    distinct, counts = np.unique(times, return_counts=True)
    even = distinct.size > 3 and len(set(counts[1:-1].tolist())) == 1 and np.ptp(np.diff(distinct)) == 0
    return int(counts[1]) if even and not np.any(np.diff(times) < 0) else 0


def _is_continuous(rows: Sequence[Sequence[str]], count: int) -> bool:
    """Whether readings move less from row to row than over `count` rows: of machines in turn it is the other way."""
    for cells in zip(*rows, strict=True):
        values = numbers(cells)[0]
        near, far = np.abs(np.diff(values)), np.abs(values[count:] - values[:-count])
        if np.isfinite(near).any() and np.isfinite(far).any() and np.nanmean(near) > np.nanmean(far):
            return False
    return True


@dataclass(frozen=True, slots=True)
class Stored:
    """How a recording was stored; on change, for how long silence means as before, and how often its rows come (s).

    `silence` is the recorder's, `own` that of each column's header: a tag may die while others speak.
    """

    on_change: bool
    silence: float = 0.0
    interval: float = 0.0
    own: Mapping[str, float] = field(default_factory=dict)
    why: str = ""


def find_storage(
    table: FoundTable,
    columns: Sequence[FoundColumn],
    times: Sequence[Array],
    temperature: FoundColumn,
    answers: Answers,
) -> Stored:
    """How the readings of the columns were stored; `times` are each column's.

    Raises Undecided where it may be either.
    """
    every = np.unique(np.concatenate([each[np.isfinite(each)] for each in times]))
    steps = np.diff(every)
    steps = steps[steps < _OWNER_GAP_S / 2]
    if steps.size < _MIN_STEPS or answers.stored == "each row":
        return Stored(False)
    looks = {
        column.header: _storage_look(own, column, every.size, steps)
        for column, own in zip(columns, times, strict=True)
        if column.kind in ("number", "switch", "states")
    }
    own = looks[temperature.header]
    # A column's own steps: tags of a scan may stand a second apart.
    scans = [float(np.quantile(look.steps, 0.05)) for look in looks.values() if look is not None]
    interval = _interval(min(scans, default=0.0), steps)
    kept = Stored(
        True,
        _holds(steps),
        interval,
        {name: float(steps.sum()) if look is None else look.holds for name, look in looks.items()},
    )
    if answers.stored:
        return kept
    told = [look for look in looks.values() if look is not None]
    # One that repeats what it was is polled.
    if own is None or own.repeated >= _MAX_REPEAT_SHARE:
        return Stored(False)
    if own.surely or (any(look.surely for look in told) and all(look.repeated < _MAX_REPEAT_SHARE for look in told)):
        return replace(
            kept,
            why=f"values stand where they change, repeated in {own.repeated:.0%} of the readings; {own.silent:.0%} "
            "of the time is silence",
        )
    seldom = next((name for name, look in looks.items() if look is not None and look.surely), "")
    if not seldom and (not own.may or own.silent < _MIN_SILENT_SHARE):
        return Stored(False)
    # Where one value is stored because it changed, some of those beside it in its row did not.
    beside = [
        column
        for column in columns
        if column.kind == "number" and column.values.size == every.size and np.isfinite(column.values).all()
    ]
    polled = [look for column in beside if (look := looks[column.header]) and look.repeated < _MAX_REPEAT_SHARE]
    if len(polled) >= _MIN_POLLED:
        return Stored(False)
    name = seldom or temperature.header
    silent = next(look.silent for header, look in looks.items() if look is not None and header == name)
    raise Undecided(
        table.path,
        f"{silent:.0%} of the time has no reading of {name!r}, whose values never repeat: it "
        "may be stored on change, so that silence means as before, or each row may be there and the rest unknown",
        "stored",
        ["on change", "each row"],
        guess="on change",
    )


@dataclass(frozen=True, slots=True)
class _Look:
    """Whether a column may be stored on change, and surely is; shares of repeated values and of time in silence.

    `steps` (s) are those between its readings, and `holds` (s) is for how long its silence means as before.
    """

    may: bool
    surely: bool
    repeated: float
    silent: float
    steps: Array
    holds: float


def _storage_look(times: Array, column: FoundColumn, rows: int, every: Array) -> _Look | None:
    """How the readings of a column look, beside so many `rows` of all with the steps `every`; None for too few."""
    if column.kind == "number":
        known, values = np.isfinite(column.values), column.values
    else:
        known, values = np.array([bool(cell) for cell in column.cells], dtype=bool), _codes(column.cells)
    order = np.argsort(times[known], kind="stable")
    steps, moves = np.diff(times[known][order]), np.abs(np.diff(values[known][order]))
    steps, moves = steps[(steps > 0) & (steps < _OWNER_GAP_S / 2)], moves[(steps > 0) & (steps < _OWNER_GAP_S / 2)]
    if steps.size < _MIN_STEPS:
        return None
    longest = _longest_silence(steps)
    # What is stored because so long nothing changed may repeat what it was; what comes sooner has changed.
    soon = steps < EARLY_SHARE * (longest - float(np.quantile(every, 0.05)))
    beats = int((~soon).sum()) >= _MIN_STEPS
    # Between the beats of a recorder stands only what moved farther than from beat to beat.
    between = beats and int(soon.sum()) >= _MIN_STEPS
    between = between and float(np.quantile(moves[soon], 0.05)) > float(np.quantile(moves[~soon], 0.9))
    told = soon if between or soon.mean() > _MIN_SOON_SHARE else np.ones(steps.shape, dtype=bool)
    # The same value at once again is one message sent twice, or the end of a value, told with what follows it.
    at_once = steps < _AT_ONCE_SHARE * float(np.median(steps))
    told &= (moves > 0) | ~(at_once | np.append(at_once[1:] & (moves[1:] > 0), False))
    repeated, scan = float((moves[told] == 0).mean()), float(np.quantile(steps, 0.05))
    if told.all() and scan > _LONG_STEP_RATIO * float(np.quantile(every, 0.05)):
        # It is told only when the longest time is over, or polled more slowly than others: neither speaks.
        repeated = 0.0
    silent = float(steps[steps > _LONG_STEP_RATIO * scan].sum() / steps.sum())
    sparse = known.sum() < _MAX_SPARSE_SHARE * rows
    usual = float(np.median(steps[told]))
    uneven = float((np.abs(steps - usual) > 0.5 * usual).mean()) > _MAX_UNEVEN_SHARE
    may = repeated < _MAX_REPEAT_SHARE and (uneven or between)
    # Noise makes small steps too, an exception none below its deadband.
    apart = float(np.quantile(moves[told], 0.05)) >= _SMALL_MOVE_QUANTILE_RATIO * float(np.median(moves[told]))
    # A switch that is never told anew says by its silence that it did not change, however long that is.
    holds = _holds(steps, beats=beats) if column.kind == "number" or beats else float(every.sum())
    return _Look(
        may,
        may and (between or (silent >= _MIN_SILENT_SHARE and apart) or bool(sparse)),
        repeated,
        silent,
        steps,
        holds,
    )


def _interval(scan: float, steps: Array) -> float:
    return float(f"{max(scan, float(steps.sum()) / _MAX_HELD_ROWS, _MIN_HELD_STEP_S):.3g}")


def _holds(steps: Array, *, beats: bool = True) -> float:
    """For how long silence means as before: somewhat longer than the longest one was, if that is a recorder's."""
    return float(np.ceil((_SILENCE_MARGIN if beats else _WIDE_SILENCE_MARGIN) * _longest_silence(steps)))


def _longest_silence(steps: Array) -> float:
    """The longest step that has others nearly as long: what goes far beyond them is an outage."""
    long = np.unique(steps)[-50:]
    for shorter, longer in pairwise(long):
        if longer > _OUTAGE_RATIO * shorter and shorter > 10 * float(np.median(steps)):
            return float(shorter)
    return float(long[-1])
